// The constraint solver of the profile `accurate`: Bullet sets up the rows of an island, and the solver of mixed linear
// complementarity problems (ambf_mlcp.h) solves them. C++ only.
//
// Velocities and positions are solved separately. The velocity problem has no position correction (no Baumgarte term),
// only a bias for the curvature of the motion. Its solution projects the velocities onto a convex set that contains 0,
// which cannot add kinetic energy (motors and restitution aside). Position errors are corrected by a second problem
// over the same rows. Its pseudo-velocities move the bodies in this sub-step and are then discarded (split impulse).
#ifndef AMB_ACCURATE_SOLVER_H
#define AMB_ACCURATE_SOLVER_H

#include <BulletDynamics/ConstraintSolver/btContactSolverInfo.h>
#include <BulletDynamics/ConstraintSolver/btSequentialImpulseConstraintSolver.h>
#include <BulletDynamics/Dynamics/btRigidBody.h>
#include <LinearMath/btTransformUtil.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <type_traits>

#include "accurate_context.h"
#include "approach.h"
#include "contact_cache.h"
#include "correction_damping.h"
#include "coupled_rows.h"
#include "drive_yielding.h"
#include "joint_arms.h"
#include "joint_softness.h"
#include "position_error.h"
#include "position_rows.h"
#include "spin_energy.h"
#include "articulation_solver.h"

// Base: btSequentialImpulseConstraintSolver or a subclass that keeps its rows for rigid bodies.
template <class Base>
class AccurateSolver : public Base {
  static constexpr bool HAS_ARTICULATIONS = std::is_base_of_v<ArticulationSolver, Base>;

 public:
  explicit AccurateSolver(const AccurateContext &settings) : settings_(settings), mlcp_(mlcp_table->create()) {}
  ~AccurateSolver() override { mlcp_table->destroy(mlcp_); }

  // Discards all warm-starting data.
  void reset() override {
    Base::reset();
    ++resets_;
    sub_step_ = 0;
    direct_backoff_ = 0;
    shared_budget_ = 0;
    contacts_.clear();
  }

 protected:
  void prepareSolve(int bodies, int manifolds) override {
    Base::prepareSolve(bodies, manifolds);
    ++sub_step_;
    if (!settings_.is_continued) {
      shared_budget_ = std::min(shared_budget_, settings_.max_saved_budget) + settings_.base_budget;
      settings_.parts = 0;
      settings_.work = settings_.budget = 0;
    }
    ++settings_.parts;
    part_budget_ = settings_.base_budget;
    contacts_.begin();
  }

  btScalar solveGroupCacheFriendlySetup(btCollisionObject **bodies, int n, btPersistentManifold **manifolds,
                                        int manifold_count, btTypedConstraint **constraints, int constraint_count,
                                        const btContactSolverInfo &info, btIDebugDraw *debug) override {
    // Split impulse for contacts of any penetration depth.
    btContactSolverInfo split = info;
    split.m_splitImpulse = 1;
    split.m_splitImpulsePenetrationThreshold = BT_LARGE_FLOAT;
    // The MLCP solver gets warm-starting impulses with the rows instead.
    if (settings_.direct) split.m_solverMode &= ~SOLVER_USE_ARTICULATED_WARMSTARTING;
    return Base::solveGroupCacheFriendlySetup(bodies, n, manifolds, manifold_count, constraints, constraint_count,
                                              split, debug);
  }

  void convertJoints(btTypedConstraint **constraints, int n, const btContactSolverInfo &info) override {
    Base::convertJoints(constraints, n, info);
    btConstraintArray &rows = this->m_tmpSolverNonContactConstraintPool;
    joint_errors_.assign(rows.size(), {});
    joints_.clear();
    int next = 0;
    for (int i = 0; i < n; ++i) {
      const int count = this->m_tmpConstraintSizesPool[i].m_numConstraintRows;
      load_guesses(*constraints[i], next, count);
      separate_errors(*constraints[i], next, count, info);
      find_responses(next, count, info.m_timeStep);
      average_responses(next, count);
      next += count;
    }
    // Position errors are corrected by the position problem.
    for (auto &row : this->coupled_rows_) {
      note_error(row.error, row.coupling->is_angle(0));
      row.target = 0;
    }
    if (!settings_.diagonal_cfm) return;
    // Bullet takes m_cfm as a share of the diagonal but leaves it out of the effective mass, so that soft rows
    // overshoot.
    for (int i = 0; i < rows.size(); ++i) {
      btSolverConstraint &row = rows[i];
      if (row.m_cfm <= 0) continue;
      const btScalar share = 1 / (1 + row.m_cfm);
      row.m_rhs *= share;
      row.m_jacDiagABInv *= share;
      row.m_cfm *= share;
    }
  }

  void convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) override {
    contacts_.match(manifolds, n);
    Base::convertContacts(manifolds, n, info);
    add_torques(this->m_tmpSolverContactFrictionConstraintPool);
    add_torques(this->m_tmpSolverContactRollingFrictionConstraintPool);
    warm_start_friction(info);
    apply_restitution(info);
    limit_push_out(this->m_tmpSolverContactConstraintPool, info);
    if constexpr (HAS_ARTICULATIONS) limit_push_out(this->m_multiBodyNormalContactConstraints, info);
  }

  btScalar solveSingleIteration(int iteration, btCollisionObject **bodies, int n, btPersistentManifold **manifolds,
                                int manifold_count, btTypedConstraint **constraints, int constraint_count,
                                const btContactSolverInfo &info, btIDebugDraw *debug) override {
    const btScalar residual = Base::solveSingleIteration(iteration, bodies, n, manifolds, manifold_count, constraints,
                                                         constraint_count, info, debug);
    if (settings_.release_friction) release_friction();
    return residual;
  }

  btScalar solveGroupCacheFriendlyIterations(btCollisionObject **bodies, int n, btPersistentManifold **manifolds,
                                             int manifold_count, btTypedConstraint **constraints, int constraint_count,
                                             const btContactSolverInfo &info, btIDebugDraw *debug) override {
    // Estimating the cost of a large well-conditioned island takes a third of the time of its iterations: after such an
    // island was too expensive the next 15 are not tried.
    const bool is_small =
        is_ill_conditioned() || this->m_tmpSolverContactConstraintPool.size() <= settings_.max_direct_contacts;
    if (settings_.direct && join_coupled_bodies() && (is_small || direct_backoff_-- <= 0)) {
      gather(info);
      if (row_count_ == 0) return 0;
      if (solve(info, is_small)) {
        store_contacts();
        if (!is_at_rest_) store_contact_states();
        return 0;
      }
      if (!is_small) direct_backoff_ = 15;
    }
    ++settings_.statistics.islands_iterated;
    const btScalar residual = Base::solveGroupCacheFriendlyIterations(bodies, n, manifolds, manifold_count, constraints,
                                                                      constraint_count, info, debug);
    store_contacts();
    return residual;
  }

 private:
  // Position correction, velocity bias and warm start of a joint row.
  struct JointError {
    // Pseudo-velocity that removes the position error in this sub-step, m/s or rad/s; that of a limit is clamped.
    btScalar correction = 0;
    // Velocity bias: target of J v after the solution, from restitution at a limit or the curvature of the motion, m/s
    // or rad/s.
    btScalar bias = 0;
    // Whether the row constrains a position; false: a motor or spring.
    bool is_geometric = false;
    bool is_limit = false;
    // Whether it is a limit that is not reached.
    bool is_open = false;
    // See `find_responses` and `average_responses`.
    btScalar response = 0, position_response = 0;
    // Longest lever arm of the joint, m.
    btScalar arm = 0;
    // Square of the angle by which the bodies turn relative to each other in the sub-step.
    btScalar turn_squared = 0;
    // Whether the row is a spring, which resists position corrections.
    bool is_spring = false;
    // Impulse in the last sub-step, N s or N m s, and whether it is known.
    btScalar guess = 0;
    bool is_known = false;
  };

  using RowKind = PositionRows::Kind;

  btSolverBody &body(int id) { return this->m_tmpSolverBodyPool[id]; }

  // Splits the targets of a joint's rows into a velocity bias and a position correction. Rows of motors and springs are
  // not changed.
  void separate_errors(const btTypedConstraint &constraint, int first, int count, const btContactSolverInfo &info) {
    const btScalar h = info.m_timeStep;
    btConstraintArray &rows = this->m_tmpSolverNonContactConstraintPool;
    const SoftRows *soft = soft_rows_of(constraint);
    const auto is_soft_row = [&](int k) {
      return soft && k - first >= soft->first && k - first < soft->first + soft->count;
    };
    const auto kind_of = [&](int k) {
      const btSolverConstraint &row = rows[k];
      const bool is_soft = is_soft_row(k);
      const bool low_free = row.m_lowerLimit <= -UNBOUNDED, high_free = row.m_upperLimit >= UNBOUNDED;
      if (is_soft || row.m_jacDiagABInv <= 0) return RowKind::Other;
      if (low_free && high_free) return RowKind::Geometric;
      return (low_free && row.m_upperLimit == 0) || (high_free && row.m_lowerLimit == 0) ? RowKind::Limit
                                                                                         : RowKind::Other;
    };
    JointMotion motion;
    for (int k = first; k < first + count; ++k) {
      if (kind_of(k) != RowKind::Geometric) continue;
      const btSolverConstraint &row = rows[k];
      motion.add_row(row.m_contactNormal1, row.m_relpos1CrossNormal, row.m_contactNormal2, row.m_relpos2CrossNormal);
    }
    bool has_pivots = false;
    if (count > 0) {
      const btSolverBody &a = body(rows[first].m_solverBodyIdA), &b = body(rows[first].m_solverBodyIdB);
      btVector3 arm_a, arm_b;
      has_pivots = find_joint_arms(constraint, arm_a, arm_b);
      motion.finish(a.m_linearVelocity, a.m_angularVelocity, b.m_linearVelocity, b.m_angularVelocity, h,
                    has_pivots ? &arm_a : nullptr, has_pivots ? &arm_b : nullptr);
    }
    for (int k = first; k < first + count; ++k) {
      btSolverConstraint &row = rows[k];
      const RowKind kind = kind_of(k);
      const bool is_angular = row.m_contactNormal1.isZero();
      // Part of J v that only follows the curvature of the motion.
      const btScalar curved =
          is_angular ? motion.angular_target(row.m_relpos1CrossNormal) : motion.linear_target(row.m_contactNormal2);
      if (kind == RowKind::Other) {
        if (has_pivots && !is_angular) row.m_rhs += curved * row.m_jacDiagABInv;
        joint_errors_[k].is_spring = is_soft_row(k) && row.m_jacDiagABInv > 0 &&
                                     constraint.getConstraintType() == D6_SPRING_2_CONSTRAINT_TYPE;
        continue;
      }
      btScalar before, forced;
      find_velocity(row, before, forced);
      const btScalar target = row.m_rhs / row.m_jacDiagABInv + before + forced;
      // A row that was left out of a joint is a part of the joint beyond its clearance, and not a limit.
      const bool is_limit = kind == RowKind::Limit && !(soft && soft->beyond_clearance >> (k - first) & 1);
      btScalar kept = 0;
      bool is_open = false;
      if (is_limit) {
        const btScalar side = row.m_lowerLimit == 0 ? 1 : -1;
        // Springs have rows for limits that are not reached, too: the joint may close the gap in this sub-step.
        is_open = side * target < 0;
        kept = is_open ? target / info.m_erp
                       : side * std::max(btScalar(0), std::min(side * target, -side * before * bounce_of(constraint)));
      }
      // In worlds with this solver joints have the ERP of the world.
      if (!is_limit) note_error(target * h / info.m_erp, is_angular);
      JointError &error = joint_errors_[k];
      const btScalar most = is_angular ? MAX_RETURN_RATE : MAX_RETURN_SPEED;
      error.correction = is_open ? kept : is_limit ? std::max(-most, std::min(most, target - kept)) : target;
      error.is_limit = is_limit;
      error.is_open = is_open;
      error.bias = is_limit && is_angular ? kept : kept + curved;
      error.is_geometric = true;
      row.m_rhs -= (target - error.bias) * row.m_jacDiagABInv;
    }
  }

  // Finds the response to which the CFM of each row of a joint is proportional, 1/kg or 1/(kg m^2): the diagonal
  // J M^-1 J^T, where a body has at least the inertia LEAST_INERTIA m r^2 with its mass m and its lever arm r. A body
  // of next to no inertia would else give way under its own weight: the diagonal is large because it turns easily, but
  // other rows hold its rotation.
  void find_responses(int first, int count, btScalar h) {
    constexpr btScalar LEAST_INERTIA = 1e-3, LEAST_SHARE = 1e-6;
    if (count == 0) return;
    const btConstraintArray &rows = this->m_tmpSolverNonContactConstraintPool;
    const btVector3 spin =
        body(rows[first].m_solverBodyIdA).m_angularVelocity - body(rows[first].m_solverBodyIdB).m_angularVelocity;
    const btScalar turn_squared = spin.length2() * h * h;
    btScalar arm_squared[2] = {0, 0};
    for (int k = first; k < first + count; ++k) {
      if (rows[k].m_contactNormal1.isZero()) continue;
      arm_squared[0] = std::max(arm_squared[0], rows[k].m_relpos1CrossNormal.length2());
      arm_squared[1] = std::max(arm_squared[1], rows[k].m_relpos2CrossNormal.length2());
    }
    for (int k = first; k < first + count; ++k) {
      const btSolverConstraint &row = rows[k];
      if (row.m_jacDiagABInv <= 0) continue;
      btScalar response = 0;
      for (int side = 0; side < 2; ++side) {
        const int id = dynamic_body(side ? row.m_solverBodyIdB : row.m_solverBodyIdA);
        if (id < 0) continue;
        const btScalar inverse_mass = body(id).internalGetInvMass().x();
        const btVector3 &linear = side ? row.m_contactNormal2 : row.m_contactNormal1;
        const btVector3 &angular = side ? row.m_relpos2CrossNormal : row.m_relpos1CrossNormal;
        const btScalar turned = angular.dot(side ? row.m_angularComponentB : row.m_angularComponentA);
        const btScalar least = LEAST_INERTIA * arm_squared[side], most = angular.length2() * inverse_mass;
        response += linear.length2() * inverse_mass + (turned * least > most ? most / least : turned);
      }
      const btScalar diagonal = 1 / row.m_jacDiagABInv;
      joint_errors_[k].response = std::clamp(response, LEAST_SHARE * diagonal, diagonal);
      joint_errors_[k].turn_squared = turn_squared;
      const bool moves[2] = {dynamic_body(row.m_solverBodyIdA) >= 0, dynamic_body(row.m_solverBodyIdB) >= 0};
      joint_errors_[k].arm = btSqrt(std::max(moves[0] ? arm_squared[0] : 0, moves[1] ? arm_squared[1] : 0));
    }
  }

  // Sets the response of each row in the position problem: the mean of the linear, or of the angular, rows of the joint
  // that are neither limits, motors nor springs. The sum of their squared errors over it then does not depend on the axes
  // along which Bullet resolves an error, and the compromise between joints that contradict each other is that of the
  // assembly (`src/assembly`).
  void average_responses(int first, int count) {
    const btConstraintArray &rows = this->m_tmpSolverNonContactConstraintPool;
    const auto is_averaged = [&](int k) { return joint_errors_[k].is_geometric && !joint_errors_[k].is_limit; };
    btScalar sums[2] = {0, 0};
    int counts[2] = {0, 0};
    for (int k = first; k < first + count; ++k) {
      if (!is_averaged(k)) continue;
      const int is_angular = rows[k].m_contactNormal1.isZero();
      sums[is_angular] += joint_errors_[k].response;
      ++counts[is_angular];
    }
    for (int k = first; k < first + count; ++k) {
      const int is_angular = rows[k].m_contactNormal1.isZero();
      joint_errors_[k].position_response =
          is_averaged(k) ? sums[is_angular] / counts[is_angular] : joint_errors_[k].response;
    }
  }

  void note_error(btScalar error, bool is_angle) {
    double &largest = is_angle ? settings_.statistics.joint_angle : settings_.statistics.joint_gap;
    largest = std::max(largest, double(btFabs(error)));
  }

  // Loads the impulses of the rows of a joint from the last sub-step, if it had the same number of rows.
  void load_guesses(const btTypedConstraint &constraint, int first, int count) {
    // SoftRows belong to this library's constraints and are mutable.
    auto *memory = const_cast<SoftRows *>(soft_rows_of(constraint));
    if (!memory || count == 0 || count > SoftRows::MAX_GUESSES) return;
    joints_.push_back({memory, first, count});
    if (memory->guesses != count || memory->guessed_after != resets_) return;
    for (int k = 0; k < count; ++k) {
      joint_errors_[first + k].guess = memory->guess[k];
      joint_errors_[first + k].is_known = true;
    }
  }

  void store_joint_impulses(const double *impulses) {
    for (const JointSpan &joint : joints_) {
      joint.memory->guesses = joint.count;
      joint.memory->guessed_after = resets_;
      std::copy(impulses + joint.first, impulses + joint.first + joint.count, joint.memory->guess);
    }
  }

  void store_contacts() {
    contacts_.store(this->m_tmpSolverContactConstraintPool, this->m_tmpSolverContactFrictionConstraintPool,
                    {&this->m_tmpSolverContactRollingFrictionConstraintPool});
    if constexpr (HAS_ARTICULATIONS) {
      contacts_.store(this->m_multiBodyNormalContactConstraints, this->m_multiBodyFrictionContactConstraints,
                      {&this->m_multiBodyTorsionalFrictionContactConstraints,
                       &this->m_multiBodySpinningFrictionContactConstraints});
    }
  }

  void store_contact_states() {
    const unsigned char *states = mlcp_table->states(mlcp_);
    for (const Normal &normal : normals_) normal.contact->is_closed = states[normal.row] == AMB_MLCP_FREE;
  }

  // Bullet omits the change of velocity by external torques in friction rows. The velocities J v of different rows
  // would then not be those of one motion.
  void add_torques(btConstraintArray &frictions) {
    for (int i = 0; i < frictions.size(); ++i) {
      btSolverConstraint &row = frictions[i];
      const btSolverBody &a = body(row.m_solverBodyIdA), &b = body(row.m_solverBodyIdB);
      btScalar forced = 0;
      if (a.m_originalBody) forced += row.m_relpos1CrossNormal.dot(a.m_externalTorqueImpulse);
      if (b.m_originalBody) forced += row.m_relpos2CrossNormal.dot(b.m_externalTorqueImpulse);
      row.m_rhs -= forced * row.m_jacDiagABInv;
    }
  }

  void warm_start_friction(const btContactSolverInfo &info) {
    if (!(info.m_solverMode & SOLVER_USE_WARMSTARTING)) return;
    const btConstraintArray &contacts = this->m_tmpSolverContactConstraintPool;
    const int directions = info.m_solverMode & SOLVER_USE_2_FRICTION_DIRECTIONS ? 2 : 1;
    for (int i = 0; i < contacts.size(); ++i) {
      const auto &point = *static_cast<const btManifoldPoint *>(contacts[i].m_originalContactPoint);
      const btVector3 before = contacts_.of(contacts[i]).friction;
      for (int k = 0; k < directions; ++k) {
        btSolverConstraint &row = this->m_tmpSolverContactFrictionConstraintPool[contacts[i].m_frictionIndex + k];
        row.m_appliedImpulse =
            before.dot(k ? point.m_lateralFrictionDir2 : point.m_lateralFrictionDir1) * info.m_warmstartingFactor;
        push(row, row.m_appliedImpulse);
      }
    }
  }

  void push(const btSolverConstraint &row, btScalar impulse) {
    btSolverBody &a = body(row.m_solverBodyIdA), &b = body(row.m_solverBodyIdB);
    if (a.m_originalBody)
      a.internalApplyImpulse(row.m_contactNormal1 * a.internalGetInvMass(), row.m_angularComponentA, impulse);
    if (b.m_originalBody)
      b.internalApplyImpulse(row.m_contactNormal2 * b.internalGetInvMass(), row.m_angularComponentB, impulse);
  }

  // Velocity J v of a row before the sub-step, and its change by external forces in the sub-step, m/s or rad/s.
  void find_velocity(const btSolverConstraint &row, btScalar &before, btScalar &forced) {
    const btSolverBody &a = body(row.m_solverBodyIdA), &b = body(row.m_solverBodyIdB);
    before = forced = 0;
    if (a.m_originalBody) {
      before += row.m_contactNormal1.dot(a.m_linearVelocity) + row.m_relpos1CrossNormal.dot(a.m_angularVelocity);
      forced +=
          row.m_contactNormal1.dot(a.m_externalForceImpulse) + row.m_relpos1CrossNormal.dot(a.m_externalTorqueImpulse);
    }
    if (b.m_originalBody) {
      before += row.m_contactNormal2.dot(b.m_linearVelocity) + row.m_relpos2CrossNormal.dot(b.m_angularVelocity);
      forced +=
          row.m_contactNormal2.dot(b.m_externalForceImpulse) + row.m_relpos2CrossNormal.dot(b.m_externalTorqueImpulse);
    }
  }

  // Coefficient of restitution of a joint at its limits.
  static btScalar bounce_of(const btTypedConstraint &constraint) {
    if (constraint.getConstraintType() != HINGE_CONSTRAINT_TYPE) return 0;
    const auto &hinge = static_cast<const btHingeConstraint &>(constraint);
    return hinge.getLimitRelaxationFactor() * hinge.getLimitBiasFactor();
  }

  // Whether the island has joints.
  bool has_joints() const {
    if constexpr (HAS_ARTICULATIONS) {
      if (this->m_multiBodyNonContactConstraints.size() > 0) return true;
    }
    return this->m_tmpSolverNonContactConstraintPool.size() > 0;
  }

  bool is_impact(btScalar before, const btContactSolverInfo &info) const {
    return -before >= info.m_restitutionVelocityThreshold;
  }

  // Whether `apply_restitution` treats a contact. In islands with joints only impacts are, because its push-out
  // velocity is not limited and would violate the joints.
  bool bounces(const btSolverConstraint &row, const btContactSolverInfo &info) {
    const auto &point = *static_cast<const btManifoldPoint *>(row.m_originalContactPoint);
    if (!settings_.restitution || point.m_combinedRestitution <= 0) return false;
    btScalar before, forced;
    find_velocity(row, before, forced);
    return is_impact(before, info) || !has_joints();
  }
  // Contacts of articulations have their restitution in m_rhs already, see ArticulationSolver.
  static bool bounces(const btMultiBodySolverConstraint &, const btContactSolverInfo &) { return false; }

  // Sets the separation velocity of impacts so that the energy after the impact is restitution^2 of that before,
  // wherever within the sub-step the impact is. Contacts with a positive gap have no impulse before the bodies touch, unless
  // these would get through each other (ANTICIPATED).
  void apply_restitution(const btContactSolverInfo &info) {
    btConstraintArray &contacts = this->m_tmpSolverContactConstraintPool;
    const btScalar h = info.m_timeStep;
    bounce_velocities_.assign(contacts.size(), 0);
    for (int i = 0; i < contacts.size(); ++i) {
      btSolverConstraint &row = contacts[i];
      const auto &point = *static_cast<const btManifoldPoint *>(row.m_originalContactPoint);
      bounce_velocities_[i] = std::min(btScalar(0), -(point.getDistance() + info.m_linearSlop) / h);
      if (!bounces(row, info)) continue;
      btScalar before, forced;
      find_velocity(row, before, forced);
      const btScalar gap = point.getDistance() + info.m_linearSlop, push = -gap * info.m_erp2 / h;
      if (is_impact(before, info)) {
        const btScalar pull = std::max(btScalar(0), -forced / h);
        row.m_rhsPenetration = 0;
        if (gap > 0 && !(point.m_contactPointFlags & ANTICIPATED)) {
          row.m_rhs = row.m_upperLimit = 0;
          continue;
        }
        const bool is_later = gap > -(before + forced) * h;
        const btScalar target =
            is_later ? -gap / h : separation_velocity(before, gap, pull, h, point.m_combinedRestitution);
        bounce_velocities_[i] = target;
        row.m_rhs = (target - before - forced) * row.m_jacDiagABInv;
      } else if (push > info.m_restitutionVelocityThreshold) {
        // The penetration depth that was reached in the impact is corrected by a pseudo-velocity.
        row.m_rhs = (-before - forced) * row.m_jacDiagABInv;
        row.m_rhsPenetration = push * row.m_jacDiagABInv;
      }
    }
  }

  // Velocity bias of a contact by restitution or by its gap, m/s.
  btScalar contact_bias(const btConstraintArray &, int i, btScalar, btScalar) const { return bounce_velocities_[i]; }
  btScalar contact_bias(const btMultiBodyConstraintArray &, int i, btScalar gap, btScalar h) const {
    return this->link_bounces_[i] - std::max(gap, btScalar(0)) / h;
  }

  // Clamps the push-out velocity of all other contacts, see push_out_speed.
  template <class Rows>
  void limit_push_out(Rows &rows, const btContactSolverInfo &info) {
    for (int i = 0; i < rows.size(); ++i) {
      auto &row = rows[i];
      const auto &point = *static_cast<const btManifoldPoint *>(row.m_originalContactPoint);
      const btScalar depth = -(point.getDistance() + info.m_linearSlop);
      if (depth <= 0 || row.m_jacDiagABInv <= btScalar(0) || bounces(row, info)) continue;
      const btScalar push = depth * info.m_erp2 / info.m_timeStep;
      // Contacts of articulations have the penetration correction in m_rhs: it is moved to m_rhsPenetration.
      if (row.m_rhsPenetration == btScalar(0)) row.m_rhs = row.m_rhs - push * row.m_jacDiagABInv;
      row.m_rhsPenetration = std::min(push, push_out_speed(depth)) * row.m_jacDiagABInv;
    }
  }

  // Separation velocity at the end of a sub-step of h s, m/s, of a contact with velocity before < 0, gap (m) and
  // relative acceleration `pull` towards each other, m/s^2. Free motion conserves the energy per mass v^2 / 2 + pull (x
  // + k v / 2), where k = -h for Bullet's x += v' h and k = 0 for exact integration; the impact multiplies its value at
  // the surface by restitution^2.
  btScalar separation_velocity(btScalar before, btScalar gap, btScalar pull, btScalar h, btScalar restitution) const {
    const btScalar k = settings_.exact_flight ? 0 : -h;
    const btScalar energy = before * before / 2 + pull * (gap + k * before / 2);
    const btScalar kept = restitution * restitution * std::max(btScalar(0), energy);
    // The position at the end of the step is gap + v h.
    const btScalar linear = pull * (2 * h + k);
    return std::max(btScalar(0), (btSqrt(std::max(btScalar(0), linear * linear + 8 * (kept - pull * gap))) - linear) / 2);
  }

  // Removes friction impulses of contacts whose normal impulse became 0. Bullet skips these rows and keeps their last
  // impulse.
  void release_friction() {
    btConstraintArray &frictions = this->m_tmpSolverContactFrictionConstraintPool;
    for (int i = 0; i < frictions.size(); ++i) {
      btSolverConstraint &row = frictions[i];
      const btScalar applied = row.m_appliedImpulse;
      const btSolverConstraint &normal = this->m_tmpSolverContactConstraintPool[row.m_frictionIndex];
      if (applied == 0 || normal.m_appliedImpulse > btScalar(0)) continue;
      row.m_appliedImpulse = 0;
      push(row, -applied);
    }
    if constexpr (HAS_ARTICULATIONS) {
      for (int i = 0; i < this->m_multiBodyFrictionContactConstraints.size(); ++i) {
        btMultiBodySolverConstraint &row = this->m_multiBodyFrictionContactConstraints[i];
        const btMultiBodySolverConstraint &normal = this->m_multiBodyNormalContactConstraints[row.m_frictionIndex];
        if (normal.m_appliedImpulse > btScalar(0) || row.m_appliedImpulse == btScalar(0)) continue;
        row.m_lowerLimit = row.m_upperLimit = 0;
        Base::resolveSingleConstraintRowGeneric(row);
      }
    }
  }

  int dynamic_body(int id) const {
    const btSolverBody &b = this->m_tmpSolverBodyPool[id];
    return b.m_originalBody && b.m_originalBody->getInvMass() > 0 ? id : -1;
  }

  // Sequential impulses converge slowly in islands with joints, articulations or large mass ratios.
  bool is_ill_conditioned() const {
    if (this->m_tmpSolverNonContactConstraintPool.size() > 0) return true;
    if constexpr (HAS_ARTICULATIONS) {
      if (this->m_multiBodyNonContactConstraints.size() + this->m_multiBodyNormalContactConstraints.size() > 0)
        return true;
    }
    btScalar least = BT_LARGE_FLOAT, most = 0;
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      const btRigidBody *b = this->m_tmpSolverBodyPool[i].m_originalBody;
      if (!b || b->getInvMass() <= 0) continue;
      least = std::min(least, b->getInvMass());
      most = std::max(most, b->getInvMass());
    }
    return most > settings_.mass_ratio_threshold * least;
  }

  // Loads and lever arms of the island's joints of rigid bodies.
  JointSoftness joint_softness(btScalar h) const {
    JointSoftness softness(settings_.joint_softness);
    const btConstraintArray &joints = this->m_tmpSolverNonContactConstraintPool;
    if (joints.size() == 0) return softness;
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      const btRigidBody *b = this->m_tmpSolverBodyPool[i].m_originalBody;
      if (b && b->getInvMass() > 0) softness.add_body(1 / b->getInvMass());
    }
    if constexpr (HAS_ARTICULATIONS) {
      const btMultiBodyConstraintArray &contacts = this->m_multiBodyNormalContactConstraints;
      for (int i = 0; i < contacts.size(); ++i) {
        softness.add_body(mass_of(contacts[i].m_multiBodyA, contacts[i].m_linkA));
        softness.add_body(mass_of(contacts[i].m_multiBodyB, contacts[i].m_linkB));
      }
    }
    for (int i = 0; i < joints.size(); ++i) {
      const JointError &joint = joint_errors_[i];
      softness.add_arm(joint.arm);
      if (joint.is_geometric) continue;
      const bool is_angular = joints[i].m_contactNormal1.isZero();
      if (joint.arm > 0 || !is_angular) softness.add_drive(btFabs(joint.guess) / (is_angular ? joint.arm : 1), h);
    }
    return softness;
  }

  // Adds all rows of the island to the MLCP solver.
  void gather(const btContactSolverInfo &info) {
    mlcp_table->clear(mlcp_);
    row_count_ = 0;
    articulations_.clear();
    articulation_sizes_.clear();
    articulation_rows_.clear();
    normals_.clear();
    has_drives_ = false;
    is_at_rest_ = true;
    positions_.clear();
    find_correction_share(info);
    const btConstraintArray &joints = this->m_tmpSolverNonContactConstraintPool;
    const JointSoftness softness = joint_softness(info.m_timeStep);
    for (int i = 0; i < joints.size(); ++i) {
      AmbMlcpRow row = row_of(joints[i]);
      const bool is_angular = joints[i].m_contactNormal1.isZero();
      row.cfm = std::max(row.cfm, softness.cfm(joint_errors_[i].response, is_angular, joint_errors_[i].turn_squared));
      row.in_positions = joint_errors_[i].is_geometric || joint_errors_[i].is_spring;
      row.is_drive = !joint_errors_[i].is_geometric;
      if (row.is_drive) row.yielding_cfm = DriveYielding::SOFTNESS * joint_errors_[i].response;
      row.bias = joint_errors_[i].bias;
      row.position_target = joint_errors_[i].correction * share_of(joint_errors_[i].is_limit);
      // If this guess is not the solution, pivoting starts with free rows: a drive that alternates between its bounds
      // would otherwise take many pivots in each sub-step.
      row.x = joint_errors_[i].guess;
      const bool is_limit = joint_errors_[i].is_limit;
      if (joint_errors_[i].is_open && row.x == 0) row.state = guess_of(row);
      if (is_limit && joint_errors_[i].is_known && row.x == 0) row.state = row.low == 0 ? AMB_MLCP_LOW : AMB_MLCP_HIGH;
      row.position_cfm =
          is_limit ? softness_of(joints[i], YIELDING_POSITION_SOFTNESS)
                   : POSITION_SOFTNESS * joint_errors_[i].position_response;
      if (row.is_drive) row.position_cfm = spring_position_softness(row.cfm, joint_errors_[i].response);
      row.stays_loaded = row.low == 0 || row.high == 0;
      add(row, is_limit ? RowKind::Limit : RowKind::Geometric, is_angular, MIN_CORRECTION, joint_errors_[i].arm);
    }
    // Contact softness regularises redundant contacts.
    add_contacts(this->m_tmpSolverContactConstraintPool, info);
    const btConstraintArray &frictions = this->m_tmpSolverContactFrictionConstraintPool;
    const btConstraintArray &rolling = this->m_tmpSolverContactRollingFrictionConstraintPool;
    const double kept = info.m_solverMode & SOLVER_USE_WARMSTARTING ? info.m_warmstartingFactor : 1;
    for (int i = 0; i < frictions.size(); ++i) {
      add_friction(frictions[i], joints.size(), frictions[i].m_appliedImpulse, BT_LARGE_FLOAT, kept);
    }
    for (int i = 0; i < rolling.size(); ++i) {
      const btVector3 &torque = contacts_.of(this->m_tmpSolverContactConstraintPool[rolling[i].m_frictionIndex]).torque;
      add_friction(rolling[i], joints.size(), torque.dot(rolling[i].m_relpos1CrossNormal), rolling[i].m_friction, 1);
    }
    if constexpr (HAS_ARTICULATIONS) gather_articulation_rows(info);
    for (const auto &coupled : this->coupled_rows_) add_coupled_row(coupled, softness, info);
  }

  // The bodies on which a coupling acts are one in the MLCP problem, whose rows have two sides. Returns whether none has too
  // many of them.
  bool join_coupled_bodies() {
    composites_.clear();
    composite_sizes_.clear();
    if (this->coupled_rows_.empty()) return true;
    const int bodies = this->m_tmpSolverBodyPool.size();
    // Each body refers to one of its group, the last one to itself.
    groups_.resize(bodies);
    std::iota(groups_.begin(), groups_.end(), 0);
    const auto group_of = [this](int i) {
      while (groups_[i] != i) i = groups_[i] = groups_[groups_[i]];
      return i;
    };
    const auto &parts = this->coupled_parts_;
    for (const auto &row : this->coupled_rows_) {
      for (size_t i = row.first + 1; i < row.first + row.count; ++i)
        groups_[group_of(parts[i].body)] = group_of(parts[row.first].body);
    }
    composites_.assign(bodies, {-1, -1});
    composite_of_group_.assign(bodies, -1);
    for (const auto &part : parts) {
      Composite &place = composites_[part.body];
      if (place.index >= 0) continue;
      int &index = composite_of_group_[group_of(part.body)];
      if (index < 0) {
        index = static_cast<int>(composite_sizes_.size());
        composite_sizes_.push_back(0);
      }
      place = {index, composite_sizes_[index]};
      composite_sizes_[index] += 6;
    }
    const auto is_affordable = [](int size) { return size <= 6 * MAX_COUPLED; };
    return std::all_of(composite_sizes_.begin(), composite_sizes_.end(), is_affordable);
  }

  template <class Coupled>
  void add_coupled_row(const Coupled &coupled, const JointSoftness &softness, const btContactSolverInfo &info) {
    AmbMlcpRow row{};
    row.body[0] = row.body[1] = -1;
    row.normal = -1;
    row.low = -BT_LARGE_FLOAT;
    row.high = BT_LARGE_FLOAT;
    if (!(coupled.response > 0)) return add(row, RowKind::Geometric, false, MIN_CORRECTION);
    for (size_t i = coupled.first; i < coupled.first + coupled.count; ++i) {
      const auto &part = this->coupled_parts_[i];
      fill(row, i == coupled.first ? 0 : 1, part.body, part.linear, part.angular, part.by_linear, part.by_angular);
    }
    const bool is_angular = coupled.coupling->is_angle(0);
    row.target = coupled.target - coupled.velocity;
    row.cfm = softness.cfm(coupled.response, is_angular, 0);
    row.in_positions = 1;
    row.position_target = correction_of(coupled, info) * correction_share_;
    row.position_cfm = POSITION_SOFTNESS * coupled.response;
    row.x = coupled.coupling->is_known ? coupled.coupling->guess : 0;
    add(row, RowKind::Geometric, is_angular, MIN_CORRECTION);
  }

  // Pseudo-velocity that removes the position error of a coupling, m/s or rad/s.
  template <class Coupled>
  static btScalar correction_of(const Coupled &coupled, const btContactSolverInfo &info) {
    return -info.m_erp * coupled.error / info.m_timeStep;
  }

  // Where the velocity of a rigid body stands among the results of the MLCP solver.
  int place_of(int id) const {
    if (composites_.empty() || composites_[id].index < 0) return 6 * id;
    int place = 6 * this->m_tmpSolverBodyPool.size() + composites_[id].offset;
    for (int i = 0; i < composites_[id].index; ++i) place += composite_sizes_[i];
    return place;
  }
  // Where those of articulations begin.
  int articulations_place() const {
    int place = 6 * this->m_tmpSolverBodyPool.size();
    for (const int size : composite_sizes_) place += size;
    return place;
  }

  void gather_articulation_rows(const btContactSolverInfo &info) {
    btMultiBodyConstraintArray &joints = this->m_multiBodyNonContactConstraints;
    for (int i = 0; i < joints.size(); ++i) {
      AmbMlcpRow row = row_of(joints[i]);
      // Rows of the articulation's own joints have their CFM from JointRows.
      const auto &owner = *static_cast<const EngineRows *>(joints[i].m_orgConstraint);
      row.is_drive = !owner.is_geometric(joints[i].m_orgDofIndex);
      if (row.is_drive) row.yielding_cfm = softness_of(joints[i], DriveYielding::SOFTNESS);
      row.fed = owner.fed(joints[i].m_orgDofIndex);
      row.bias = row.is_drive ? 0 : owner.bias(joints[i].m_orgDofIndex);
      row.in_positions = joints[i].m_jacDiagABInv > 0 && (!row.is_drive || owner.is_spring(joints[i].m_orgDofIndex));
      note_error(owner.error(joints[i].m_orgDofIndex), owner.is_angular(joints[i].m_orgDofIndex));
      const bool is_limit = row.low == 0 || row.high == 0;
      const double share = share_of(is_limit);
      row.position_target =
          row.in_positions && !row.is_drive ? share * joints[i].m_rhsPenetration / joints[i].m_jacDiagABInv : 0;
      row.x = owner.guess(joints[i].m_orgDofIndex);
      if (row.x == 0) row.state = guess_of(row);
      row.position_cfm = softness_of(joints[i], is_limit ? YIELDING_POSITION_SOFTNESS : POSITION_SOFTNESS);
      if (row.is_drive) row.position_cfm = spring_position_softness(row.cfm, softness_of(joints[i], 1));
      row.stays_loaded = is_limit;
      add(row, is_limit ? RowKind::Limit : RowKind::Geometric, owner.is_angular(joints[i].m_orgDofIndex),
          MIN_CORRECTION);
    }
    const int first_contact = row_count_;
    add_contacts(this->m_multiBodyNormalContactConstraints, info);
    btMultiBodyConstraintArray &frictions = this->m_multiBodyFrictionContactConstraints;
    for (int i = 0; i < frictions.size(); ++i) {
      const ContactCache::Contact &memory =
          contacts_.of(this->m_multiBodyNormalContactConstraints[frictions[i].m_frictionIndex]);
      add_friction(frictions[i], first_contact, memory.friction.dot(frictions[i].m_contactNormal1), BT_LARGE_FLOAT, 1);
    }
    for (btMultiBodyConstraintArray *rows : {&this->m_multiBodyTorsionalFrictionContactConstraints,
                                             &this->m_multiBodySpinningFrictionContactConstraints}) {
      for (int i = 0; i < rows->size(); ++i) {
        const auto &normal = this->m_multiBodyNormalContactConstraints[(*rows)[i].m_frictionIndex];
        const btVector3 &torque = contacts_.of(normal).torque;
        add_friction((*rows)[i], first_contact, torque.dot((*rows)[i].m_relpos1CrossNormal), BT_LARGE_FLOAT, 1);
      }
    }
  }

  // Finds the share of the joints' position errors that is corrected in this sub-step, so that no row exceeds the
  // largest correction velocity. It is the same for all joints of the island: a correction by a part of each error goes
  // towards the least sum of squares, and one of clamped errors does not.
  void find_correction_share(const btContactSolverInfo &info) {
    const btScalar most_turned = max_correction_rate(info.m_timeStep, settings_.recent_turn_rate);
    double fastest = 1;
    const btConstraintArray &joints = this->m_tmpSolverNonContactConstraintPool;
    for (int i = 0; i < joints.size(); ++i) {
      const JointError &error = joint_errors_[i];
      if (!error.is_geometric || error.is_limit) continue;
      const btScalar most = joints[i].m_contactNormal1.isZero() ? most_turned : MAX_CORRECTION_SPEED;
      fastest = std::max(fastest, double(btFabs(error.correction) / most));
    }
    for (const auto &coupled : this->coupled_rows_) {
      const btScalar most = coupled.coupling->is_angle(0) ? most_turned : MAX_CORRECTION_SPEED;
      fastest = std::max(fastest, double(btFabs(correction_of(coupled, info)) / most));
    }
    if constexpr (HAS_ARTICULATIONS) {
      const btMultiBodyConstraintArray &rows = this->m_multiBodyNonContactConstraints;
      for (int i = 0; i < rows.size(); ++i) {
        const btMultiBodySolverConstraint &row = rows[i];
        const auto &owner = *static_cast<const EngineRows *>(row.m_orgConstraint);
        if (row.m_jacDiagABInv <= 0 || !owner.is_geometric(row.m_orgDofIndex)) continue;
        const btScalar most = owner.is_angular(row.m_orgDofIndex) ? most_turned : MAX_CORRECTION_SPEED;
        fastest = std::max(fastest, double(btFabs(row.m_rhsPenetration / row.m_jacDiagABInv) / most));
      }
    }
    correction_share_ = 1 / fastest;
  }
  double share_of(bool is_limit) const { return is_limit ? 1 : correction_share_; }

  // Guess of the active set: a unilateral row whose target needs no impulse is at its bound.
  static int guess_of(const AmbMlcpRow &row) {
    if (row.low == 0 && row.target < 0) return AMB_MLCP_LOW;
    if (row.high == 0 && row.target > 0) return AMB_MLCP_HIGH;
    return AMB_MLCP_FREE;
  }

  // arm: of the joint, m.
  void add(const AmbMlcpRow &row, RowKind kind, bool is_angular, double least_correction, double arm = 0) {
    mlcp_table->add_row(mlcp_, &row);
    ++row_count_;
    // A contact may separate. The target of a row with a fixed impulse does not count.
    const bool is_idle =
        row.low >= row.high ? row.low == 0 : row.target <= NO_SPEED && (row.low == 0 || row.target >= -NO_SPEED);
    is_at_rest_ = is_at_rest_ && is_idle && row.low <= 0 && row.high >= 0;
    positions_.add(row, kind, is_angular, least_correction, arm);
    has_drives_ = has_drives_ || row.yielding_cfm > 0;
  }

  // The members that rows of all kinds have.
  template <class Row>
  AmbMlcpRow new_row(const Row &from) {
    AmbMlcpRow row{};
    row.body[0] = row.body[1] = -1;
    row.normal = -1;
    if (from.m_jacDiagABInv > 0) {
      row.target = from.m_rhs / from.m_jacDiagABInv;
      row.cfm = from.m_cfm / from.m_jacDiagABInv;
    }
    row.low = from.m_lowerLimit;
    row.high = from.m_upperLimit;
    return row;
  }

  // Sets one side of a row, or adds to it if it is the same coupled body. Its arrays are valid until the next row is made.
  void fill(AmbMlcpRow &row, int side, int id, const btVector3 &linear, const btVector3 &angular,
            const btVector3 &by_linear, const btVector3 &by_angular) {
    if (!composites_.empty() && composites_[id].index >= 0)
      return fill_composite(row, side, composites_[id], linear, angular, by_linear, by_angular);
    row.body[side] = id;
    row.size[side] = 6;
    for (int k = 0; k < 3; ++k) {
      jacobians_[side][k] = linear[k];
      jacobians_[side][k + 3] = angular[k];
      responses_[side][k] = by_linear[k];
      responses_[side][k + 3] = by_angular[k];
    }
    row.jacobian[side] = jacobians_[side];
    row.response[side] = responses_[side];
  }

  struct Composite {
    // Index of the coupled body of which a rigid body is a part, -1: none; and of its first velocity there.
    int index, offset;
  };

  void fill_composite(AmbMlcpRow &row, int side, const Composite &part, const btVector3 &linear, const btVector3 &angular,
                      const btVector3 &by_linear, const btVector3 &by_angular) {
    const int index = this->m_tmpSolverBodyPool.size() + part.index, size = composite_sizes_[part.index];
    if (side == 1 && row.body[0] == index) side = 0;
    Vector<double> &jacobian = wide_jacobians_[side], &response = wide_responses_[side];
    if (row.body[side] != index) {
      row.body[side] = index;
      row.size[side] = size;
      jacobian.assign(size, 0);
      response.assign(size, 0);
      row.jacobian[side] = jacobian.data();
      row.response[side] = response.data();
    }
    for (int k = 0; k < 3; ++k) {
      jacobian[part.offset + k] += linear[k];
      jacobian[part.offset + k + 3] += angular[k];
      response[part.offset + k] += by_linear[k];
      response[part.offset + k + 3] += by_angular[k];
    }
  }

  AmbMlcpRow row_of(const btSolverConstraint &from) {
    AmbMlcpRow row = new_row(from);
    for (int k = 0; k < 2; ++k) {
      const int id = dynamic_body(k ? from.m_solverBodyIdB : from.m_solverBodyIdA);
      if (id < 0) continue;
      const btVector3 &linear = k ? from.m_contactNormal2 : from.m_contactNormal1;
      fill(row, k, id, linear, k ? from.m_relpos2CrossNormal : from.m_relpos1CrossNormal,
           linear * body(id).internalGetInvMass(), k ? from.m_angularComponentB : from.m_angularComponentA);
    }
    return row;
  }

  AmbMlcpRow row_of(btMultiBodySolverConstraint &from) {
    AmbMlcpRow row = new_row(from);
    articulation_rows_.push_back(this->sides_of(from));
    // Skips rows whose articulated response is numerically zero (singular configuration).
    if (from.m_jacDiagABInv <= 0) return row;
    for (int k = 0; k < 2; ++k) {
      const auto &side = articulation_rows_.back().sides[k];
      if (side.body) {
        const int id = static_cast<int>(side.body - &this->m_tmpSolverBodyPool[0]);
        fill(row, k, id, side.linear, side.angular, side.by_linear, side.by_angular);
      } else if (side.multi_body) {
        row.body[k] = this->m_tmpSolverBodyPool.size() + static_cast<int>(composite_sizes_.size()) +
                      articulation_index(side.multi_body, side.velocity, side.n);
        row.size[k] = side.n;
        row.jacobian[k] = &this->m_data.m_jacobians[side.jacobian];
        row.response[k] = &this->m_data.m_deltaVelocitiesUnitImpulse[side.jacobian];
      }
    }
    return row;
  }

  int articulation_index(btMultiBody *multi_body, int velocity, int size) {
    for (size_t i = 0; i < articulations_.size(); ++i) {
      if (articulations_[i].velocity == velocity) return static_cast<int>(i);
    }
    articulations_.push_back({multi_body, velocity});
    articulation_sizes_.push_back(size);
    return static_cast<int>(articulations_.size()) - 1;
  }

  template <class Row>
  static void soften(AmbMlcpRow &row, const Row &from, double share) {
    row.cfm = std::max(row.cfm, softness_of(from, share));
  }

  // CFM as a share of the diagonal J M^-1 J^T.
  static double softness_of(const btSolverConstraint &from, double share) {
    return from.m_jacDiagABInv > 0 ? share / from.m_jacDiagABInv : 0;
  }

  // Mass of a link, or of the base (-1), kg; 0 without an articulation.
  static btScalar mass_of(const btMultiBody *multi_body, int link) {
    return !multi_body ? 0 : link < 0 ? multi_body->getBaseMass() : multi_body->getLinkMass(link);
  }

  // Near singular configurations the diagonal is small, and an impulse along the row would cause large velocities
  // across it. The share is therefore of at least the inverse mass of the link.
  static double softness_of(const btMultiBodySolverConstraint &from, double share) {
    if (from.m_jacDiagABInv <= 0) return 0;
    double response = 1 / from.m_jacDiagABInv;
    for (const auto &[multi_body, link] :
         {std::pair(from.m_multiBodyA, from.m_linkA), std::pair(from.m_multiBodyB, from.m_linkB)}) {
      const double mass = mass_of(multi_body, link);
      if (mass > 0) response = std::max(response, 1 / mass);
    }
    return share * response;
  }

  template <class Rows>
  void add_contacts(Rows &rows, const btContactSolverInfo &info) {
    for (int i = 0; i < rows.size(); ++i) {
      AmbMlcpRow row = row_of(rows[i]);
      const auto &point = *static_cast<const btManifoldPoint *>(rows[i].m_originalContactPoint);
      row.x = std::max(btScalar(0), point.m_appliedImpulse);
      row.position_cfm = softness_of(rows[i], YIELDING_POSITION_SOFTNESS);
      soften(row, rows[i], settings_.contact_softness);
      ContactCache::Contact &contact = contacts_.of(rows[i]);
      const bool is_open = row.x == 0 && (row.target < 0 || (contact.is_known && !contact.is_closed));
      row.state = is_open ? AMB_MLCP_LOW : AMB_MLCP_FREE;
      const btScalar gap = point.getDistance() + info.m_linearSlop;
      deepest_ = std::max(deepest_, -gap);
      row.bias = contact_bias(rows, i, gap, info.m_timeStep);
      row.in_positions = rows[i].m_jacDiagABInv > 0 && row.high > 0;
      row.position_target = gap > 0            ? -gap / info.m_timeStep
                            : row.in_positions ? rows[i].m_rhsPenetration / rows[i].m_jacDiagABInv
                                               : 0;
      normals_.push_back({row.x, row.state, row_count_, &contact});
      add(row, RowKind::Contact, false, -gap > 0 ? std::fabs(row.position_target) * MIN_DEPTH / -gap : BT_LARGE_FLOAT);
    }
  }

  // kept: `guess` is this multiple of the impulse in the last sub-step (warm-starting factor).
  template <class Row>
  void add_friction(Row &from, int first_contact, double guess, double cap, double kept) {
    AmbMlcpRow row = row_of(from);
    row.normal = first_contact + from.m_frictionIndex;
    row.friction = from.m_friction;
    row.cap = cap;
    row.x = guess / kept;
    soften(row, from, settings_.friction_softness);
    const Normal &normal = normals_[normals_.size() - contact_count(from) + from.m_frictionIndex];
    const double bound = std::min(row.friction * normal.impulse, cap) * (1 - 1e-6);
    row.state = guess >= bound * kept ? AMB_MLCP_HIGH : guess <= -bound * kept ? AMB_MLCP_LOW : AMB_MLCP_FREE;
    if (normal.state == AMB_MLCP_FREE && normal.impulse == 0) row.state = AMB_MLCP_FREE;
    add(row, RowKind::Other, false, MIN_CORRECTION);
  }
  size_t contact_count(const btSolverConstraint &) const { return this->m_tmpSolverContactConstraintPool.size(); }
  size_t contact_count(const btMultiBodySolverConstraint &) const {
    return this->m_multiBodyNormalContactConstraints.size();
  }

  // Kinetic energy of all bodies of the island after external forces and before constraint impulses, J.
  double kinetic_energy() const {
    double energy = 0;
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      const btSolverBody &b = this->m_tmpSolverBodyPool[i];
      if (!b.m_originalBody || b.m_originalBody->getInvMass() <= 0) continue;
      const btVector3 &inverse = b.m_originalBody->getInvInertiaDiagLocal();
      const btVector3 linear = b.m_linearVelocity + b.m_externalForceImpulse;
      const btVector3 angular = (b.m_angularVelocity + b.m_externalTorqueImpulse) * b.m_worldTransform.getBasis();
      energy += linear.length2() / (2 * b.m_originalBody->getInvMass());
      for (int k = 0; k < 3; ++k) energy += inverse[k] > 0 ? angular[k] * angular[k] / (2 * inverse[k]) : 0;
    }
    if constexpr (HAS_ARTICULATIONS) {
      for (const Articulation &articulation : articulations_) energy += free_energy(*articulation.multi_body);
    }
    return energy;
  }

  bool solve(const btContactSolverInfo &info, bool is_small) {
    AmbSolverStatistics &seen = settings_.statistics;
    const double budget = settings_.budget_per_row * row_count_ + settings_.base_budget;
    part_budget_ += settings_.budget_per_row * row_count_;
    settings_.budget = std::max(settings_.budget, part_budget_);
    if (is_at_rest_) {
      clear_impulses();
      ++seen.islands_solved;
      seen.rows += row_count_;
      note_depth();
      correct_positions(info, budget, false);
      return true;
    }
    const double cost = prepare();
    if (cost < 0 || (!is_small && cost > settings_.max_direct_cost_per_row * row_count_)) return false;
    mlcp_table->set_energy(mlcp_, kinetic_energy());
    const int outcome = solve_velocities(info.m_timeStep, settings_.budget_per_row * row_count_);
    if (outcome == AMB_MLCP_NOT_FINITE) return false;
    ++(outcome == AMB_MLCP_SOLVED ? seen.islands_solved : seen.islands_approximate);
    write_velocities();
    note_depth();
    correct_positions(info, budget, true);
    return true;
  }

  // Counts the last solution. Returns what it was.
  AmbMlcpStatistics count_solution() {
    AmbMlcpStatistics found;
    mlcp_table->statistics(mlcp_, &found);
    settings_.statistics.multiplications += found.multiplications;
    settings_.work += found.multiplications;
    return found;
  }

  // Solves the velocity problem, again with softer drives while these open joints and the budget lasts.
  int solve_velocities(double h, double budget) {
    AmbSolverStatistics &seen = settings_.statistics;
    AmbBody *const first = first_body(), *const island = has_drives_ ? first : nullptr;
    if (first) mlcp_table->set_guess_tolerance(mlcp_, first->guess_tolerance);
    double yielding = island ? island->drive_yielding : 0, unyielding = BT_LARGE_FLOAT;
    bool may_yield = island && DriveYielding::is_allowed(island->drives_yielded_in_vain, sub_step_);
    // Drives that contradict other rows make the problem hard to solve: it may cost as much again with softer ones.
    const double again = budget;
    budget += shared_budget_;
    for (bool is_first = true;; is_first = false) {
      const int outcome = mlcp_table->solve(mlcp_, yielding, budget);
      const AmbMlcpStatistics found = count_solution();
      budget = std::max(budget - found.multiplications, 0.0);
      may_yield = may_yield && (is_first || budget > 0);
      seen.rows += found.rows;
      seen.factorisations += found.factorisations;
      seen.pivots += found.pivots;
      seen.sweeps += found.sweeps;
      const bool is_finite = outcome != AMB_MLCP_NOT_FINITE;
      const double opened = island && is_finite ? positions_.opening(mlcp_table->impulses(mlcp_), h) : 0;
      if (yielding == 0) unyielding = opened;
      if (may_yield && DriveYielding::is_wanted(yielding, opened)) {
        yielding = DriveYielding::raised(yielding, opened);
        if (is_first) budget = std::max(budget, again);
      } else if (may_yield && !is_first && DriveYielding::is_in_vain(unyielding, opened)) {
        yielding = 0;
        may_yield = false;
        island->drives_yielded_in_vain = sub_step_;
      } else {
        seen.residual = std::max(seen.residual, found.residual);
        shared_budget_ = budget;
        if (first) first->guess_tolerance = found.guess_tolerance;
        if (!island) return outcome;
        island->drive_yielding = is_first ? DriveYielding::lowered(yielding, opened) : yielding;
        if (!is_first && yielding > 0 && DriveYielding::is_in_vain(unyielding, opened)) {
          // The budget ended.
          island->drive_yielding = 0;
          island->drives_yielded_in_vain = sub_step_;
        }
        return outcome;
      }
    }
  }

  double prepare() {
    block_sizes_ = composite_sizes_;
    block_sizes_.insert(block_sizes_.end(), articulation_sizes_.begin(), articulation_sizes_.end());
    return mlcp_table->prepare(mlcp_, this->m_tmpSolverBodyPool.size(), block_sizes_.data(),
                               static_cast<int>(block_sizes_.size()));
  }

  void note_depth() {
    settings_.statistics.penetration = std::max(settings_.statistics.penetration, double(deepest_));
    deepest_ = 0;
  }

  // Solves the position problem, unless all errors are small and this sub-step is not due.
  void correct_positions(const btContactSolverInfo &info, double budget, bool is_prepared) {
    if (!positions_.are_due(sub_step_)) return;
    if (!is_prepared && prepare() < 0) return;
    double damping = 1;
    btScalar length = 0;
    const double *left = nullptr;
    for (int round = 0;; ++round) {
      if (mlcp_table->solve_positions(mlcp_, nullptr, positions_.states(), LEAST_POSITION_SOFTNESS, damping, budget) ==
          AMB_MLCP_NOT_FINITE)
        return;
      budget -= count_solution().multiplications;
      left = mlcp_table->position_errors(mlcp_);
      length = find_correction_length(info.m_timeStep);
      if (length <= LONG_CORRECTION || round == MOST_ROUNDS || budget <= 0) break;
      damping *= RAISED_DAMPING;
    }
    ++settings_.statistics.position_problems;
    const PositionErrors asked = positions_.asked(), after = positions_.after(left);
    const double moved = positions_.correction_energy(left) / damping;
    if (is_uncorrectable(asked, after) || is_soft(asked, after, moved)) {
      scale_corrections(0);
      return;
    }
    write_corrections(info, 1 / length);
  }

  // The body that identifies an island in consecutive sub-steps: the first link of its first articulation, or its first
  // dynamic body. Null: it has none.
  AmbBody *first_body() const {
    if constexpr (HAS_ARTICULATIONS) {
      if (!articulations_.empty()) return &first_link_of(*articulations_[0].multi_body);
    }
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      if (dynamic_body(i) >= 0) return body_of(this->m_tmpSolverBodyPool[i].m_originalBody);
    }
    return nullptr;
  }

  // Sets all impulses to 0, where sequential impulses would start from those of the last sub-step.
  void clear_impulses() {
    for (btConstraintArray *pool :
         {&this->m_tmpSolverNonContactConstraintPool, &this->m_tmpSolverContactConstraintPool,
          &this->m_tmpSolverContactFrictionConstraintPool, &this->m_tmpSolverContactRollingFrictionConstraintPool}) {
      for (int i = 0; i < pool->size(); ++i) (*pool)[i].m_appliedImpulse = 0;
    }
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      body(i).internalGetDeltaLinearVelocity().setZero();
      body(i).internalGetDeltaAngularVelocity().setZero();
    }
    for (const JointSpan &joint : joints_) joint.memory->guesses = 0;
    for (auto &row : this->coupled_rows_) store_coupled_impulse(row, 0);
  }

  template <class Coupled>
  static void store_coupled_impulse(Coupled &row, btScalar impulse) {
    row.impulse = row.coupling->guess = impulse;
    row.coupling->is_known = true;
  }

  void write_velocities() {
    const double *impulses = mlcp_table->impulses(mlcp_), *velocities = mlcp_table->velocities(mlcp_);
    store_joint_impulses(impulses);
    for (btConstraintArray *pool :
         {&this->m_tmpSolverNonContactConstraintPool, &this->m_tmpSolverContactConstraintPool,
          &this->m_tmpSolverContactFrictionConstraintPool, &this->m_tmpSolverContactRollingFrictionConstraintPool}) {
      for (int i = 0; i < pool->size(); ++i) (*pool)[i].m_appliedImpulse = *impulses++;
    }
    if constexpr (HAS_ARTICULATIONS) {
      for (const auto &row : articulation_rows_) row.row->m_appliedImpulse = *impulses++;
    }
    for (auto &row : this->coupled_rows_) store_coupled_impulse(row, *impulses++);
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      // Bodies that are moved have a place in the pool, and none in the problem.
      if (dynamic_body(i) < 0) continue;
      btSolverBody &b = body(i);
      b.internalGetDeltaLinearVelocity() = vector_at(velocities + place_of(i));
      b.internalGetDeltaAngularVelocity() = vector_at(velocities + place_of(i) + 3);
    }
    if constexpr (HAS_ARTICULATIONS) {
      velocities += articulations_place();
      for (size_t i = 0; i < articulations_.size(); velocities += articulation_sizes_[i++])
        this->set_change(*articulations_[i].multi_body, articulations_[i].velocity, velocities);
    }
  }

  // Finds how fast the bodies move by the pseudo-velocities in a sub-step of h s, as a multiple of what is allowed, at
  // least 1. Hands those of articulations over to them.
  btScalar find_correction_length(btScalar h) {
    const double *const found = mlcp_table->position_velocities(mlcp_);
    const int bodies = this->m_tmpSolverBodyPool.size();
    const btScalar most = max_correction_rate(h, settings_.recent_turn_rate);
    btScalar fastest = 1;
    for (int i = 0; i < bodies; ++i) {
      if (dynamic_body(i) < 0) continue;
      fastest = std::max(fastest, vector_at(found + place_of(i)).length() / MAX_CORRECTION_SPEED);
      fastest = std::max(fastest, vector_at(found + place_of(i) + 3).length() / most);
    }
    if constexpr (HAS_ARTICULATIONS) {
      const double *velocities = found + articulations_place();
      for (size_t i = 0; i < articulations_.size(); velocities += articulation_sizes_[i++])
        fastest = std::max(fastest, set_correction(*articulations_[i].multi_body, velocities, most));
    }
    return fastest;
  }

  // Multiplies the pseudo-velocities that articulations keep until `integrate`.
  void scale_corrections(btScalar factor) {
    if constexpr (HAS_ARTICULATIONS) {
      for (const Articulation &articulation : articulations_) scale_correction(*articulation.multi_body, factor);
    }
  }

  // Writes the pseudo-velocities times `factor`, which is the same for all of the island, so that bodies keep their
  // joints closed as the solution does. Bullet moves rigid bodies by them when it writes back.
  void write_corrections(const btContactSolverInfo &info, btScalar factor) {
    scale_corrections(factor);
    const double *const found = mlcp_table->position_velocities(mlcp_);
    const btScalar turn = info.m_splitImpulseTurnErp > 0 ? factor / info.m_splitImpulseTurnErp : 0;
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      if (dynamic_body(i) < 0) continue;
      const double *const velocity = found + place_of(i);
      body(i).internalGetPushVelocity() = vector_at(velocity) * factor;
      body(i).internalGetTurnVelocity() = vector_at(velocity + 3) * turn;
      turn_velocity(body(i), vector_at(velocity + 3) * factor, info.m_timeStep);
    }
  }

  // Turns the angular velocity of a jointed body with it where the correction, at `turn_rate` rad/s for h s, would else
  // increase the kinetic energy: it takes the body to axes of more inertia. Bodies with contacts alone: free_flight.cpp.
  static void turn_velocity(btSolverBody &moved, const btVector3 &turn_rate, btScalar h) {
    const AmbBody *owner = moved.m_originalBody ? body_of(moved.m_originalBody) : nullptr;
    if (!owner || owner->constraint_count == 0 || owner->body.getInvMass() <= 0) return;
    const btVector3 omega = moved.m_angularVelocity + moved.m_deltaAngularVelocity + moved.m_externalTorqueImpulse;
    const btMatrix3x3 &from = moved.m_worldTransform.getBasis();
    btTransform to;
    btTransformUtil::integrateTransform(moved.m_worldTransform, btVector3(0, 0, 0), turn_rate, h, to);
    if (!(spin_energy(owner->body, omega, to.getBasis()) > spin_energy(owner->body, omega, from))) return;
    moved.internalGetDeltaAngularVelocity() += to.getBasis() * (omega * from) - omega;
  }
  static btVector3 vector_at(const double *v) { return {v[0], v[1], v[2]}; }

  struct Articulation {
    btMultiBody *multi_body;
    // Index of its velocities in m_data.m_deltaVelocities.
    int velocity;
  };
  // Warm start of a contact's normal row.
  struct Normal {
    double impulse;
    int state;
    int row;
    ContactCache::Contact *contact;
  };

  const AccurateContext &settings_;
  AmbMlcp *mlcp_;
  int row_count_ = 0;
  // Number of large well-conditioned islands that are solved by sequential impulses before the cost of the next one is
  // estimated.
  int direct_backoff_ = 0;
  // Budget that all islands of the sub-step share, multiplications: the base budget, and what earlier solutions have not
  // used, because expensive problems, such as impacts, are rare.
  double shared_budget_ = 0;
  // Budget of the islands of this part of the sub-step so far.
  double part_budget_ = 0;
  double jacobians_[2][6], responses_[2][6];
  // The same of coupled bodies.
  Vector<double> wide_jacobians_[2], wide_responses_[2];
  // Of each rigid body, if there are couplings; and the numbers of velocities of coupled bodies.
  Vector<Composite> composites_;
  Vector<int> composite_sizes_, composite_of_group_, groups_;
  // Those, then those of articulations.
  Vector<int> block_sizes_;
  Vector<JointError> joint_errors_;
  Vector<Normal> normals_;
  // Whether all rows are satisfied without impulses.
  bool is_at_rest_ = false;
  // Whether drives act on the island that may yield to joints.
  bool has_drives_ = false;
  unsigned sub_step_ = 0, resets_ = 0;
  double correction_share_ = 1;
  PositionRows positions_;
  // Largest penetration depth of a contact of the island, m.
  btScalar deepest_ = 0;
  // Sides of the rows that act on articulations. These rows come last.
  Vector<ArticulationSolver::Sides> articulation_rows_;
  Vector<Articulation> articulations_;
  Vector<int> articulation_sizes_;
  // Joints of the island whose impulses are stored for the next sub-step.
  struct JointSpan {
    SoftRows *memory;
    int first, count;
  };
  Vector<JointSpan> joints_;
  ContactCache contacts_;
  // Least velocity of each contact of rigid bodies after the solution, by restitution or by its gap, m/s.
  Vector<btScalar> bounce_velocities_;
};

#endif
