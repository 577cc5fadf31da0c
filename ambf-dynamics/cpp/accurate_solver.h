// The constraint solver of the profile `accurate`: Bullet sets up the rows of an island, which are read here, solved in
// Rust (ambf_island.h, src/island), and written back. C++ only.
#ifndef AMB_ACCURATE_SOLVER_H
#define AMB_ACCURATE_SOLVER_H

#include <BulletDynamics/ConstraintSolver/btContactSolverInfo.h>
#include <BulletDynamics/ConstraintSolver/btSequentialImpulseConstraintSolver.h>
#include <BulletDynamics/Dynamics/btRigidBody.h>
#include <LinearMath/btTransformUtil.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <type_traits>

#include "accurate_context.h"
#include "approach.h"
#include "contact_cache.h"
#include "coupled_rows.h"
#include "joint_arms.h"
#include "position_error.h"
#include "spin_energy.h"
#include "articulation_solver.h"

// Base: btSequentialImpulseConstraintSolver or a subclass that keeps its rows for rigid bodies.
template <class Base>
class AccurateSolver : public Base {
  static constexpr bool HAS_ARTICULATIONS = std::is_base_of_v<ArticulationSolver, Base>;

 public:
  explicit AccurateSolver(const AccurateContext &settings) : settings_(settings), island_(island_table->create()) {}
  ~AccurateSolver() override { island_table->destroy(island_); }

  // Discards all warm-starting data.
  void reset() override {
    Base::reset();
    ++resets_;
    sub_step_ = 0;
    direct_backoff_ = 0;
    settings_.budgets.shared = 0;
    contacts_.clear();
  }

 protected:
  void prepareSolve(int bodies, int manifolds) override {
    Base::prepareSolve(bodies, manifolds);
    ++sub_step_;
    const AmbBudgetLimits limits = this->limits();
    island_table->begin(&settings_.budgets, &limits, settings_.is_continued);
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
    joint_rows_.assign(rows.size(), {});
    joints_.clear();
    int next = 0;
    for (int i = 0; i < n; ++i) {
      const int count = this->m_tmpConstraintSizesPool[i].m_numConstraintRows;
      load_guesses(*constraints[i], next, count);
      separate_errors(*constraints[i], next, count, info);
      find_responses(next, count, info.m_timeStep);
      for (int k = next; k < next + count; ++k) joint_rows_[k].joint = i;
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
      const bool is_gathered = gather(info);
      if (is_gathered && (row_count_ == 0 || solve(info, is_small))) return 0;
      if (!is_small) direct_backoff_ = 15;
    }
    ++settings_.statistics.islands_iterated;
    const btScalar residual = Base::solveGroupCacheFriendlyIterations(bodies, n, manifolds, manifold_count, constraints,
                                                                      constraint_count, info, debug);
    store_contacts();
    return residual;
  }

 private:
  // What a row of a joint is, for `separate_errors`.
  enum class RowKind { Geometric, Limit, Other };

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
        joint_rows_[k].is_spring = is_soft_row(k) && row.m_jacDiagABInv > 0 &&
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
      AmbIslandRow &error = joint_rows_[k];
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
      joint_rows_[k].response = std::clamp(response, LEAST_SHARE * diagonal, diagonal);
      joint_rows_[k].turn_squared = turn_squared;
      const bool moves[2] = {dynamic_body(row.m_solverBodyIdA) >= 0, dynamic_body(row.m_solverBodyIdB) >= 0};
      joint_rows_[k].arm = btSqrt(std::max(moves[0] ? arm_squared[0] : 0, moves[1] ? arm_squared[1] : 0));
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
      joint_rows_[first + k].guess = memory->guess[k];
      joint_rows_[first + k].is_known = true;
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

  void store_contact_states(const unsigned char *states) {
    const auto store = [&](const auto &rows, int first) {
      for (int i = 0; i < rows.size(); ++i) contacts_.of(rows[i]).is_closed = states[first + i] == AMB_STATE_FREE;
    };
    store(this->m_tmpSolverContactConstraintPool, this->m_tmpSolverNonContactConstraintPool.size());
    if constexpr (HAS_ARTICULATIONS) store(this->m_multiBodyNormalContactConstraints, first_link_contact_);
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

  // Number of rows of the island.
  size_t count_rows() const {
    size_t rows = this->m_tmpSolverNonContactConstraintPool.size() + this->m_tmpSolverContactConstraintPool.size() +
                  this->m_tmpSolverContactFrictionConstraintPool.size() +
                  this->m_tmpSolverContactRollingFrictionConstraintPool.size() + this->coupled_rows_.size();
    if constexpr (HAS_ARTICULATIONS) {
      rows += this->m_multiBodyNonContactConstraints.size() + this->m_multiBodyNormalContactConstraints.size() +
              this->m_multiBodyFrictionContactConstraints.size() +
              this->m_multiBodyTorsionalFrictionContactConstraints.size() +
              this->m_multiBodySpinningFrictionContactConstraints.size();
    }
    return rows;
  }

  // Writes all rows of the island. Returns whether there is memory for them.
  bool gather(const btContactSolverInfo &info) {
    const size_t rows = count_rows();
    side_size_ = 6;
    for (const int size : composite_sizes_) side_size_ = std::max(side_size_, size);
    space_ = island_table->reserve(island_, rows, 4 * side_size_ * rows);
    if (!space_.rows) return false;
    row_count_ = 0;
    articulations_.clear();
    articulation_sizes_.clear();
    articulation_rows_.clear();
    trees_.clear();
    const btConstraintArray &joints = this->m_tmpSolverNonContactConstraintPool;
    for (int i = 0; i < joints.size(); ++i) {
      AmbIslandRow &row = add(AMB_ROW_JOINT, joint_rows_[i]);
      read(row, joints[i]);
      row.is_angular = joints[i].m_contactNormal1.isZero();
    }
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
    for (const auto &coupled : this->coupled_rows_) add_coupled_row(coupled, info);
    return true;
  }

  // The bodies on which a coupling acts are one in the island, whose rows have two sides. Returns whether none has too
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
  void add_coupled_row(const Coupled &coupled, const btContactSolverInfo &info) {
    AmbIslandRow &row = add(AMB_ROW_COUPLING);
    row.low = -BT_LARGE_FLOAT;
    row.high = BT_LARGE_FLOAT;
    // Pseudo-velocity that removes its position error, m/s or rad/s.
    row.correction = -info.m_erp * coupled.error / info.m_timeStep;
    row.is_angular = coupled.coupling->is_angle(0);
    if (!(coupled.response > 0)) return;
    for (size_t i = coupled.first; i < coupled.first + coupled.count; ++i) {
      const auto &part = this->coupled_parts_[i];
      fill(i == coupled.first ? 0 : 1, part.body, part.linear, part.angular, part.by_linear, part.by_angular);
    }
    row.response = coupled.response;
    row.target = coupled.target - coupled.velocity;
    row.guess = coupled.coupling->is_known ? coupled.coupling->guess : 0;
  }

  // Where the velocity of a rigid body stands among the results.
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
      AmbIslandRow &row = add(AMB_ROW_ARTICULATED_JOINT);
      read(row, joints[i]);
      // Rows of the articulation's own joints have their CFM from JointRows.
      const auto &owner = *static_cast<const EngineRows *>(joints[i].m_orgConstraint);
      const int index = joints[i].m_orgDofIndex;
      row.is_angular = owner.is_angular(index);
      row.is_geometric = owner.is_geometric(index);
      row.is_spring = owner.is_spring(index);
      row.fed = owner.fed(index);
      row.bias = row.is_geometric ? owner.bias(index) : 0;
      row.guess = owner.guess(index);
      note_error(owner.error(index), row.is_angular);
    }
    first_link_contact_ = row_count_;
    add_contacts(this->m_multiBodyNormalContactConstraints, info);
    btMultiBodyConstraintArray &frictions = this->m_multiBodyFrictionContactConstraints;
    for (int i = 0; i < frictions.size(); ++i) {
      const ContactCache::Contact &memory =
          contacts_.of(this->m_multiBodyNormalContactConstraints[frictions[i].m_frictionIndex]);
      add_friction(frictions[i], first_link_contact_, memory.friction.dot(frictions[i].m_contactNormal1), BT_LARGE_FLOAT,
                   1);
    }
    for (btMultiBodyConstraintArray *rows : {&this->m_multiBodyTorsionalFrictionContactConstraints,
                                             &this->m_multiBodySpinningFrictionContactConstraints}) {
      for (int i = 0; i < rows->size(); ++i) {
        const auto &normal = this->m_multiBodyNormalContactConstraints[(*rows)[i].m_frictionIndex];
        const btVector3 &torque = contacts_.of(normal).torque;
        add_friction((*rows)[i], first_link_contact_, torque.dot((*rows)[i].m_relpos1CrossNormal), BT_LARGE_FLOAT, 1);
      }
    }
  }

  // Begins the next row, without sides.
  AmbIslandRow &add(int kind, const AmbIslandRow &like = {}) {
    AmbIslandRow &row = space_.rows[row_count_];
    row = like;
    row.kind = kind;
    sides_ = space_.sides[row_count_];
    sides_[0].body = sides_[1].body = -1;
    numbers_ = space_.numbers + size_t(4) * side_size_ * row_count_;
    ++row_count_;
    return row;
  }

  // Reads the members that rows of all kinds have.
  template <class Row>
  static void read_common(AmbIslandRow &row, const Row &from) {
    if (from.m_jacDiagABInv > 0) {
      row.effective_mass = from.m_jacDiagABInv;
      row.target = from.m_rhs / from.m_jacDiagABInv;
      row.cfm = from.m_cfm / from.m_jacDiagABInv;
    }
    row.low = from.m_lowerLimit;
    row.high = from.m_upperLimit;
  }

  // Sets one side of the row, or adds to it if it is the same coupled body.
  void fill(int side, int id, const btVector3 &linear, const btVector3 &angular, const btVector3 &by_linear,
            const btVector3 &by_angular) {
    if (!composites_.empty() && composites_[id].index >= 0)
      return fill_composite(side, composites_[id], linear, angular, by_linear, by_angular);
    double *const jacobian = numbers_ + 2 * side * side_size_, *const response = jacobian + side_size_;
    for (int k = 0; k < 3; ++k) {
      jacobian[k] = linear[k];
      jacobian[k + 3] = angular[k];
      response[k] = by_linear[k];
      response[k + 3] = by_angular[k];
    }
    sides_[side] = {id, 6, jacobian, response};
  }

  struct Composite {
    // Index of the coupled body of which a rigid body is a part, -1: none; and of its first velocity there.
    int index, offset;
  };

  void fill_composite(int side, const Composite &part, const btVector3 &linear, const btVector3 &angular,
                      const btVector3 &by_linear, const btVector3 &by_angular) {
    const int index = this->m_tmpSolverBodyPool.size() + part.index, size = composite_sizes_[part.index];
    if (side == 1 && sides_[0].body == index) side = 0;
    double *const jacobian = numbers_ + 2 * side * side_size_, *const response = jacobian + side_size_;
    if (sides_[side].body != index) {
      std::fill(jacobian, jacobian + 2 * side_size_, 0);
      sides_[side] = {index, size, jacobian, response};
    }
    for (int k = 0; k < 3; ++k) {
      jacobian[part.offset + k] += linear[k];
      jacobian[part.offset + k + 3] += angular[k];
      response[part.offset + k] += by_linear[k];
      response[part.offset + k + 3] += by_angular[k];
    }
  }

  // Reads the row and its sides.
  void read(AmbIslandRow &row, const btSolverConstraint &from) {
    read_common(row, from);
    for (int k = 0; k < 2; ++k) {
      const int id = dynamic_body(k ? from.m_solverBodyIdB : from.m_solverBodyIdA);
      if (id < 0) continue;
      const btVector3 &linear = k ? from.m_contactNormal2 : from.m_contactNormal1;
      fill(k, id, linear, k ? from.m_relpos2CrossNormal : from.m_relpos1CrossNormal,
           linear * body(id).internalGetInvMass(), k ? from.m_angularComponentB : from.m_angularComponentA);
    }
  }

  void read(AmbIslandRow &row, btMultiBodySolverConstraint &from) {
    read_common(row, from);
    row.correction = from.m_rhsPenetration;
    row.is_articulated = true;
    row.link_masses[0] = mass_of(from.m_multiBodyA, from.m_linkA);
    row.link_masses[1] = mass_of(from.m_multiBodyB, from.m_linkB);
    articulation_rows_.push_back(this->sides_of(from));
    // Skips rows whose articulated response is numerically zero (singular configuration).
    if (from.m_jacDiagABInv <= 0) return;
    for (int k = 0; k < 2; ++k) {
      const auto &side = articulation_rows_.back().sides[k];
      if (side.body) {
        const int id = static_cast<int>(side.body - &this->m_tmpSolverBodyPool[0]);
        fill(k, id, side.linear, side.angular, side.by_linear, side.by_angular);
      } else if (side.multi_body) {
        const int id = this->m_tmpSolverBodyPool.size() + static_cast<int>(composite_sizes_.size()) +
                       articulation_index(side.multi_body, side.velocity, side.n);
        sides_[k] = {id, side.n, &this->m_data.m_jacobians[side.jacobian],
                     &this->m_data.m_deltaVelocitiesUnitImpulse[side.jacobian]};
      }
    }
  }

  int articulation_index(btMultiBody *multi_body, int velocity, int size) {
    for (size_t i = 0; i < articulations_.size(); ++i) {
      if (articulations_[i].velocity == velocity) return static_cast<int>(i);
    }
    articulations_.push_back({multi_body, velocity});
    articulation_sizes_.push_back(size);
    trees_.push_back(tree_of(*multi_body));
    return static_cast<int>(articulations_.size()) - 1;
  }

  // Mass of a link, or of the base (-1), kg; 0 without an articulation.
  static btScalar mass_of(const btMultiBody *multi_body, int link) {
    return !multi_body ? 0 : link < 0 ? multi_body->getBaseMass() : multi_body->getLinkMass(link);
  }

  template <class Rows>
  void add_contacts(Rows &rows, const btContactSolverInfo &info) {
    for (int i = 0; i < rows.size(); ++i) {
      AmbIslandRow &row = add(AMB_ROW_CONTACT);
      read(row, rows[i]);
      const auto &point = *static_cast<const btManifoldPoint *>(rows[i].m_originalContactPoint);
      const ContactCache::Contact &contact = contacts_.of(rows[i]);
      row.guess = point.m_appliedImpulse;
      row.was_open = contact.is_known && !contact.is_closed;
      row.correction = rows[i].m_rhsPenetration;
      row.gap = point.getDistance() + info.m_linearSlop;
      row.bias = contact_bias(rows, i, row.gap, info.m_timeStep);
    }
  }

  // kept: `guess` is this multiple of the impulse in the last sub-step (warm-starting factor).
  template <class Row>
  void add_friction(Row &from, int first_contact, double guess, double cap, double kept) {
    AmbIslandRow &row = add(AMB_ROW_FRICTION);
    read(row, from);
    row.normal = first_contact + from.m_frictionIndex;
    row.friction = from.m_friction;
    row.cap = cap;
    row.guess = guess;
    row.warm_start = kept;
  }

  // Kinetic energy of all bodies of the island after external forces and before constraint impulses, J, and the mass of the
  // heaviest rigid body, kg.
  void find_loads(AmbIslandProblem &problem) const {
    double &energy = problem.kinetic_energy;
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      const btSolverBody &b = this->m_tmpSolverBodyPool[i];
      if (!b.m_originalBody || b.m_originalBody->getInvMass() <= 0) continue;
      const btVector3 &inverse = b.m_originalBody->getInvInertiaDiagLocal();
      const btVector3 linear = b.m_linearVelocity + b.m_externalForceImpulse;
      const btVector3 angular = (b.m_angularVelocity + b.m_externalTorqueImpulse) * b.m_worldTransform.getBasis();
      energy += linear.length2() / (2 * b.m_originalBody->getInvMass());
      for (int k = 0; k < 3; ++k) energy += inverse[k] > 0 ? angular[k] * angular[k] / (2 * inverse[k]) : 0;
      problem.heaviest = std::max(problem.heaviest, double(1 / b.m_originalBody->getInvMass()));
    }
    if constexpr (HAS_ARTICULATIONS) {
      for (const Articulation &articulation : articulations_) energy += free_energy(*articulation.multi_body);
    }
  }

  AmbBudgetLimits limits() const {
    return {settings_.base_budget, settings_.budget_per_row, settings_.max_saved_budget};
  }

  // Solves the island and writes the results. Returns whether that was possible.
  bool solve(const btContactSolverInfo &info, bool is_small) {
    AmbIslandProblem problem{};
    problem.time_step = info.m_timeStep;
    problem.sub_step = sub_step_;
    problem.rigid = this->m_tmpSolverBodyPool.size();
    problem.composites = static_cast<uint32_t>(composite_sizes_.size());
    problem.turn_rate = settings_.recent_turn_rate;
    problem.joint_softness = settings_.joint_softness;
    problem.contact_softness = settings_.contact_softness;
    problem.friction_softness = settings_.friction_softness;
    problem.most_cost = is_small ? std::numeric_limits<double>::infinity() : settings_.max_direct_cost_per_row;
    problem.limits = limits();
    find_loads(problem);
    block_sizes_ = composite_sizes_;
    block_sizes_.insert(block_sizes_.end(), articulation_sizes_.begin(), articulation_sizes_.end());
    const AmbIslandBodies bodies{block_sizes_.data(), static_cast<int>(block_sizes_.size()),
                                 static_cast<int>(trees_.size()), trees_.data()};
    AmbBody *const first = first_body();
    AmbIslandMemory memory{};
    if (first) memory = {first->drive_yielding, first->drives_yielded_in_vain, first->guess_tolerance};
    AmbIslandSolution solution;
    island_table->solve(island_, row_count_, &problem, &bodies, first ? &memory : nullptr, &settings_.budgets, &solution);
    if (first) {
      first->drive_yielding = memory.drive_yielding;
      first->drives_yielded_in_vain = memory.drives_yielded_in_vain;
      first->guess_tolerance = memory.guess_tolerance;
    }
    count(solution);
    if (solution.outcome == AMB_ISLAND_REFUSED || solution.outcome == AMB_ISLAND_EXPENSIVE) return false;
    if (solution.outcome == AMB_ISLAND_AT_REST) {
      clear_impulses();
    } else {
      write_velocities(solution);
    }
    if (solution.correction > 0) write_corrections(info, solution);
    store_contacts();
    if (solution.states) store_contact_states(solution.states);
    return true;
  }

  void count(const AmbIslandSolution &solution) {
    AmbSolverStatistics &seen = settings_.statistics;
    const AmbIslandCounters &found = solution.counters;
    seen.rows += found.rows;
    seen.factorisations += found.factorisations;
    seen.pivots += found.pivots;
    seen.sweeps += found.sweeps;
    seen.position_problems += found.position_problems;
    seen.multiplications += found.multiplications;
    seen.residual = std::max(seen.residual, found.residual);
    seen.penetration = std::max(seen.penetration, found.depth);
    if (solution.outcome == AMB_ISLAND_APPROXIMATE) ++seen.islands_approximate;
    if (solution.outcome == AMB_ISLAND_SOLVED || solution.outcome == AMB_ISLAND_AT_REST) ++seen.islands_solved;
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

  void write_velocities(const AmbIslandSolution &solution) {
    const double *impulses = solution.impulses, *velocities = solution.velocities;
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

  // Writes the pseudo-velocities of rigid bodies. Bullet moves them by these when it writes back.
  void write_corrections(const btContactSolverInfo &info, const AmbIslandSolution &solution) {
    const btScalar factor = solution.correction;
    const btScalar turn = info.m_splitImpulseTurnErp > 0 ? factor / info.m_splitImpulseTurnErp : 0;
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      if (dynamic_body(i) < 0) continue;
      const double *const velocity = solution.corrections + place_of(i);
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
  const AccurateContext &settings_;
  AmbIsland *island_;
  int row_count_ = 0;
  // Number of large well-conditioned islands that are solved by sequential impulses before the cost of the next one is
  // estimated.
  int direct_backoff_ = 0;
  // Where the rows are written; of the one that is read, its sides and their numbers; and the numbers of a Jacobian there.
  AmbIslandSpace space_{};
  AmbIslandSide *sides_ = nullptr;
  double *numbers_ = nullptr;
  int side_size_ = 6;
  // Of each rigid body, if there are couplings; and the numbers of velocities of coupled bodies.
  Vector<Composite> composites_;
  Vector<int> composite_sizes_, composite_of_group_, groups_;
  // Those, then those of articulations.
  Vector<int> block_sizes_;
  // What is known of rows of joints before they are read; see `separate_errors` and `find_responses`.
  Vector<AmbIslandRow> joint_rows_;
  unsigned sub_step_ = 0, resets_ = 0;
  // Sides of the rows that act on articulations. These rows come last.
  Vector<ArticulationSolver::Sides> articulation_rows_;
  Vector<Articulation> articulations_;
  Vector<int> articulation_sizes_;
  Vector<void *> trees_;
  // Row of the first contact of an articulation.
  int first_link_contact_ = 0;
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
