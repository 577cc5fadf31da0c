// The solver of profile `accurate`: Bullet's rows, solved directly where that is cheap and by sequential impulses elsewhere. C++ only.
#ifndef AMB_ACCURATE_SOLVER_H
#define AMB_ACCURATE_SOLVER_H

#include <BulletDynamics/ConstraintSolver/btContactSolverInfo.h>
#include <BulletDynamics/ConstraintSolver/btSequentialImpulseConstraintSolver.h>
#include <BulletDynamics/Dynamics/btRigidBody.h>

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "direct.h"
#include "internal.h"
#include "tie_solver.h"

// Base: btSequentialImpulseConstraintSolver or a subclass that keeps its rows for rigid bodies.
template <class Base>
class AccurateSolver : public Base {
  static constexpr bool HAS_TREES = std::is_base_of_v<TieSolver, Base>;

 public:
  explicit AccurateSolver(const AccurateContext &settings) : settings_(settings) {}

  void reset() override {
    Base::reset();
    histories_.clear();
  }

 protected:
  void convertJoints(btTypedConstraint **constraints, int n, const btContactSolverInfo &info) override {
    Base::convertJoints(constraints, n, info);
    limit_returns(constraints, n);
    if (!settings_.diagonal_cfm) return;
    // Bullet takes m_cfm for a share of the diagonal but leaves it out of what it divides by, so that soft rows overshoot.
    btConstraintArray &rows = this->m_tmpSolverNonContactConstraintPool;
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
    remember_friction(manifolds, n);
    Base::convertContacts(manifolds, n, info);
    warm_start_friction(info);
    keep_pushes(info);
    // What bounces has a velocity of its own.
    bounce(info);
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
    hard_ = settings_.direct && is_hard();
    if (settings_.direct && !is_solved() && gather(info)) {
      if (direct_.solve(settings_.max_rounds)) {
        write_back();
        give_rest();
        if (has_deep_contacts()) {
          this->solveGroupCacheFriendlySplitImpulseIterations(bodies, n, manifolds, manifold_count, constraints, constraint_count,
                                                              info, debug);
        }
        return 0;
      }
      // What could not be solved now will hardly be in the next steps.
      history().rest = 8;
    }
    limit_pushes(info);
    if (hard_) {
      btContactSolverInfo more = info;
      more.m_numIterations *= 5;
      btConstraintArray &joints = this->m_tmpSolverNonContactConstraintPool;
      for (int i = 0; i < joints.size(); ++i) joints[i].m_overrideNumSolverIterations *= 5;
      return Base::solveGroupCacheFriendlyIterations(bodies, n, manifolds, manifold_count, constraints, constraint_count, more,
                                                     debug);
    }
    return Base::solveGroupCacheFriendlyIterations(bodies, n, manifolds, manifold_count, constraints, constraint_count, info,
                                                   debug);
  }

 private:
  btSolverBody &body(int id) { return this->m_tmpSolverBodyPool[id]; }

  // Friction of the step before, as a vector: its two directions are about to be replaced.
  void remember_friction(btPersistentManifold **manifolds, int n) {
    friction_before_.clear();
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < manifolds[i]->getNumContacts(); ++k) {
        btManifoldPoint &point = manifolds[i]->getContactPoint(k);
        point.m_userPersistentData = reinterpret_cast<void *>(friction_before_.size());
        friction_before_.push_back(point.m_appliedImpulseLateral1 * point.m_lateralFrictionDir1 +
                                   point.m_appliedImpulseLateral2 * point.m_lateralFrictionDir2);
      }
    }
  }

  void warm_start_friction(const btContactSolverInfo &info) {
    if (!(info.m_solverMode & SOLVER_USE_WARMSTARTING)) return;
    const btConstraintArray &contacts = this->m_tmpSolverContactConstraintPool;
    const int directions = info.m_solverMode & SOLVER_USE_2_FRICTION_DIRECTIONS ? 2 : 1;
    for (int i = 0; i < contacts.size(); ++i) {
      const auto &point = *static_cast<const btManifoldPoint *>(contacts[i].m_originalContactPoint);
      const btVector3 before = friction_before_[reinterpret_cast<size_t>(point.m_userPersistentData)];
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
    if (a.m_originalBody) a.internalApplyImpulse(row.m_contactNormal1 * a.internalGetInvMass(), row.m_angularComponentA, impulse);
    if (b.m_originalBody) b.internalApplyImpulse(row.m_contactNormal2 * b.internalGetInvMass(), row.m_angularComponentB, impulse);
  }

  // That of a row before the step, and what forces add to it.
  void find_velocity(const btSolverConstraint &row, btScalar &before, btScalar &forced) {
    const btSolverBody &a = body(row.m_solverBodyIdA), &b = body(row.m_solverBodyIdB);
    before = forced = 0;
    if (a.m_originalBody) {
      before += row.m_contactNormal1.dot(a.m_linearVelocity) + row.m_relpos1CrossNormal.dot(a.m_angularVelocity);
      forced += row.m_contactNormal1.dot(a.m_externalForceImpulse) + row.m_relpos1CrossNormal.dot(a.m_externalTorqueImpulse);
    }
    if (b.m_originalBody) {
      before += row.m_contactNormal2.dot(b.m_linearVelocity) + row.m_relpos2CrossNormal.dot(b.m_angularVelocity);
      forced += row.m_contactNormal2.dot(b.m_externalForceImpulse) + row.m_relpos2CrossNormal.dot(b.m_externalTorqueImpulse);
    }
  }

  // Of the speed into a limit, what a joint is asked to leave with.
  static btScalar bounce_of(const btTypedConstraint &constraint) {
    if (constraint.getConstraintType() != HINGE_CONSTRAINT_TYPE) return 0;
    const auto &hinge = static_cast<const btHingeConstraint &>(constraint);
    return hinge.getLimitRelaxationFactor() * hinge.getLimitBiasFactor();
  }

  // What brings a joint back within its limits stays as velocity, like that which takes overlap away.
  void limit_returns(btTypedConstraint **constraints, int n) {
    int next = 0;
    for (int i = 0; i < n; ++i) {
      for (int k = this->m_tmpConstraintSizesPool[i].m_numConstraintRows; k > 0; --k, ++next) {
        btSolverConstraint &row = this->m_tmpSolverNonContactConstraintPool[next];
        const bool is_low = row.m_lowerLimit == 0 && row.m_upperLimit >= BT_LARGE_FLOAT;
        const bool is_high = row.m_upperLimit == 0 && row.m_lowerLimit <= -BT_LARGE_FLOAT;
        if (is_low == is_high || row.m_jacDiagABInv <= 0) continue;
        const btScalar side = is_low ? 1 : -1;
        btScalar before, forced;
        find_velocity(row, before, forced);
        const btScalar target = side * (row.m_rhs / row.m_jacDiagABInv + before + forced);
        const btScalar most = row.m_contactNormal1.isZero() ? FASTEST_TURN : FASTEST_PUSH;
        const btScalar excess = target - std::max(most, -side * before * bounce_of(*constraints[i]));
        if (excess > 0) row.m_rhs -= side * excess * row.m_jacDiagABInv;
      }
    }
  }

  // Whether joints hold bodies of the island.
  bool has_joints() const {
    if constexpr (HAS_TREES) {
      if (this->m_multiBodyNonContactConstraints.size() > 0) return true;
    }
    return this->m_tmpSolverNonContactConstraintPool.size() > 0;
  }

  bool is_impact(btScalar before, const btContactSolverInfo &info) const { return -before >= info.m_restitutionVelocityThreshold; }

  // Whether it is for `bounce`: what joints hold must not be moved out of them.
  bool bounces(const btSolverConstraint &row, const btContactSolverInfo &info) {
    const auto &point = *static_cast<const btManifoldPoint *>(row.m_originalContactPoint);
    if (!settings_.restitution || point.m_combinedRestitution <= 0) return false;
    btScalar before, forced;
    find_velocity(row, before, forced);
    return is_impact(before, info) || !has_joints();
  }
  // Bullet's bounces of trees are beside what takes overlap away.
  static bool bounces(const btMultiBodySolverConstraint &, const btContactSolverInfo &) { return false; }

  // A contact that bounces waits until the bodies touch and leaves with the energy that restitution asks for, wherever between two
  // steps the impact was.
  void bounce(const btContactSolverInfo &info) {
    btConstraintArray &contacts = this->m_tmpSolverContactConstraintPool;
    const btScalar h = info.m_timeStep;
    for (int i = 0; i < contacts.size(); ++i) {
      btSolverConstraint &row = contacts[i];
      const auto &point = *static_cast<const btManifoldPoint *>(row.m_originalContactPoint);
      if (!bounces(row, info)) continue;
      btScalar before, forced;
      find_velocity(row, before, forced);
      const btScalar gap = point.getDistance() + info.m_linearSlop, push = -gap * info.m_erp2 / h;
      if (is_impact(before, info)) {
        const btScalar pull = std::max(btScalar(0), -forced / h);
        row.m_rhsPenetration = 0;
        if (gap > 0) {
          row.m_rhs = row.m_upperLimit = 0;
          continue;
        }
        const btScalar target = leaving(before, gap, pull, h, point.m_combinedRestitution);
        row.m_rhs = (target - before - forced) * row.m_jacDiagABInv;
      } else if (push > info.m_restitutionVelocityThreshold) {
        // The depth reached before the bounce is left behind without adding to its velocity.
        row.m_rhs = (-before - forced) * row.m_jacDiagABInv;
        row.m_rhsPenetration = push * row.m_jacDiagABInv;
      }
    }
  }

  // Bodies that overlap leave each other at no more than this speed, m/s, however deep they are: what takes the overlap away stays as
  // velocity. A fall of 5 cm is as fast. What is less deep is slower, at this rate, 1/s, down to this speed: a body that was pressed into
  // another and let go does not jump.
  static constexpr btScalar FASTEST_PUSH = 1, PUSH_RATE = 10, SLOWEST_PUSH = 0.05;
  // What lies so deep in the links of a tree that more would have to be taken away of its push, m/s, is against what joints can do:
  // solutions are then far from all, and iterations end somewhere between.
  static constexpr btScalar MOST_EXCESS = 10;
  // The fastest of hinges beyond their limits, rad/s; as in trees.
  static constexpr btScalar FASTEST_TURN = 5;

  // What of the velocity that takes the overlap at a contact away is too much.
  template <class Row>
  btScalar excess_push(const Row &row, const btContactSolverInfo &info) {
    const auto &point = *static_cast<const btManifoldPoint *>(row.m_originalContactPoint);
    if (row.m_jacDiagABInv <= 0 || bounces(row, info)) return 0;
    const btScalar depth = -(point.getDistance() + info.m_linearSlop);
    return depth * info.m_erp2 / info.m_timeStep - std::min(std::max(depth * PUSH_RATE, SLOWEST_PUSH), FASTEST_PUSH);
  }

  // Bullet keeps what is deep out of the velocities, and moves bodies instead; what is slow enough for both must not move them out of
  // their joints.
  void keep_pushes(const btContactSolverInfo &info) {
    btConstraintArray &contacts = this->m_tmpSolverContactConstraintPool;
    for (int i = 0; i < contacts.size(); ++i) {
      btSolverConstraint &row = contacts[i];
      if (row.m_rhsPenetration == 0 || excess_push(row, info) <= 0) continue;
      row.m_rhs += row.m_rhsPenetration;
      row.m_rhsPenetration = 0;
    }
  }

  // For iterations, in which contacts are not soft. Those that are may ask for more than they get: a load takes it away.
  template <class Rows>
  void limit_pushes(Rows &rows, const btContactSolverInfo &info) {
    for (int i = 0; i < rows.size(); ++i) {
      rows[i].m_rhs -= std::max(btScalar(0), excess_push(rows[i], info)) * rows[i].m_jacDiagABInv;
    }
  }

  void limit_pushes(const btContactSolverInfo &info) {
    limit_pushes(this->m_tmpSolverContactConstraintPool, info);
    if constexpr (HAS_TREES) limit_pushes(this->m_multiBodyNormalContactConstraints, info);
  }

  // Velocity at the end of a step with which bodies separate that approach at -before, `gap` <= 0 below the surface, and accelerate
  // towards each other by `pull`. Flight conserves the energy v^2 / 2 + pull (x + k v / 2), with k minus the step for Bullet's
  // x += v' h and 0 for exact flight; impact keeps the share restitution^2 of what it is at the surface.
  btScalar leaving(btScalar before, btScalar gap, btScalar pull, btScalar h, btScalar restitution) const {
    const btScalar k = settings_.exact_flight ? 0 : -h;
    const btScalar energy = before * before / 2 + pull * (gap + k * before / 2);
    const btScalar kept = restitution * restitution * std::max(btScalar(0), energy);
    // The position at the end of the step is gap + v h.
    const btScalar linear = pull * (2 * h + k);
    return std::max(btScalar(0), (btSqrt(linear * linear + 8 * (kept - pull * gap)) - linear) / 2);
  }

  // Bullet skips friction once its normal impulse is zero, so that what was applied before stays.
  void release_friction() {
    btConstraintArray &frictions = this->m_tmpSolverContactFrictionConstraintPool;
    for (int i = 0; i < frictions.size(); ++i) {
      btSolverConstraint &row = frictions[i];
      const btScalar applied = row.m_appliedImpulse;
      if (applied == 0 || this->m_tmpSolverContactConstraintPool[row.m_frictionIndex].m_appliedImpulse > btScalar(0)) continue;
      row.m_appliedImpulse = 0;
      push(row, -applied);
    }
    if constexpr (HAS_TREES) {
      for (int i = 0; i < this->m_multiBodyFrictionContactConstraints.size(); ++i) {
        btMultiBodySolverConstraint &row = this->m_multiBodyFrictionContactConstraints[i];
        const bool holds = this->m_multiBodyNormalContactConstraints[row.m_frictionIndex].m_appliedImpulse > btScalar(0);
        if (holds || row.m_appliedImpulse == btScalar(0)) continue;
        row.m_lowerLimit = row.m_upperLimit = 0;
        Base::resolveSingleConstraintRowGeneric(row);
      }
    }
  }

  // Whether there are only rows of trees and their ties, which were solved together when they were made.
  bool is_solved() const {
    if constexpr (HAS_TREES) {
      return this->m_multiBodyNonContactConstraints.size() > 0 && this->m_multiBodyNormalContactConstraints.size() == 0 &&
             this->m_tmpSolverNonContactConstraintPool.size() == 0 && this->m_tmpSolverContactConstraintPool.size() == 0;
    }
    return false;
  }

  bool has_deep_contacts() const {
    const btConstraintArray &contacts = this->m_tmpSolverContactConstraintPool;
    for (int i = 0; i < contacts.size(); ++i) {
      if (contacts[i].m_rhsPenetration != 0) return true;
    }
    return false;
  }

  int dynamic_body(int id) const {
    const btSolverBody &b = this->m_tmpSolverBodyPool[id];
    return b.m_originalBody && b.m_originalBody->getInvMass() > 0 ? id : -1;
  }

  DirectRow &add_row(const btSolverConstraint &row) {
    DirectRow &out = new_row(row);
    for (int k = 0; k < 2; ++k) {
      const int id = dynamic_body(k ? row.m_solverBodyIdB : row.m_solverBodyIdA);
      if (id < 0) continue;
      const btVector3 &linear = k ? row.m_contactNormal2 : row.m_contactNormal1;
      fill(out.sides[k], id, linear, k ? row.m_relpos2CrossNormal : row.m_relpos1CrossNormal,
           linear * body(id).internalGetInvMass(), k ? row.m_angularComponentB : row.m_angularComponentA);
    }
    return out;
  }

  // What rows of all kinds share.
  template <class Row>
  DirectRow &new_row(const Row &row) {
    direct_.rows.emplace_back();
    DirectRow &out = direct_.rows.back();
    if (row.m_jacDiagABInv > 0) {
      out.target = row.m_rhs / row.m_jacDiagABInv;
      out.cfm = row.m_cfm / row.m_jacDiagABInv;
    }
    out.low = row.m_lowerLimit;
    out.high = row.m_upperLimit;
    return out;
  }

  static void fill(DirectRow::Side &side, int body, const btVector3 &linear, const btVector3 &angular,
                   const btVector3 &by_linear, const btVector3 &by_angular) {
    side.body = body;
    for (int k = 0; k < 3; ++k) {
      side.jacobian[k] = linear[k];
      side.jacobian[k + 3] = angular[k];
      side.response[k] = by_linear[k];
      side.response[k + 3] = by_angular[k];
    }
  }

  DirectRow &add_row(btMultiBodySolverConstraint &row) {
    DirectRow &out = new_row(row);
    tree_rows_.push_back(this->sides_of(row));
    // What a tree can move only as much as rounding lets it is nothing to push at.
    if (row.m_jacDiagABInv <= 0) return out;
    for (int k = 0; k < 2; ++k) {
      const auto &from = tree_rows_.back().sides[k];
      DirectRow::Side &side = out.sides[k];
      if (from.body) {
        const int id = static_cast<int>(from.body - &this->m_tmpSolverBodyPool[0]);
        fill(side, id, from.linear, from.angular, from.by_linear, from.by_angular);
      } else if (from.tree) {
        side.body = this->m_tmpSolverBodyPool.size() + tree_at(from.velocity, from.n);
        side.size = from.n;
        side.tree_jacobian = &this->m_data.m_jacobians[from.jacobian];
        side.tree_response = &this->m_data.m_deltaVelocitiesUnitImpulse[from.jacobian];
      }
    }
    return out;
  }

  // Trees are known by where their velocities are.
  int tree_at(int velocity, int size) {
    for (size_t i = 0; i < trees_.size(); ++i) {
      if (trees_[i] == velocity) return static_cast<int>(i);
    }
    trees_.push_back(velocity);
    tree_sizes_.push_back(size);
    return static_cast<int>(trees_.size()) - 1;
  }

  static void soften(DirectRow &row, const btSolverConstraint &from, double share) {
    if (from.m_jacDiagABInv > 0) row.cfm = std::max(row.cfm, share / from.m_jacDiagABInv);
  }

  // A tree that hardly moves along the row would else have to move far across it.
  static void soften(DirectRow &row, const btMultiBodySolverConstraint &from, double share) {
    if (from.m_jacDiagABInv <= 0) return;
    double response = 1 / from.m_jacDiagABInv;
    for (const auto &[tree, link] : {std::pair(from.m_multiBodyA, from.m_linkA), std::pair(from.m_multiBodyB, from.m_linkB)}) {
      const double mass = !tree ? 0 : link < 0 ? tree->getBaseMass() : tree->getLinkMass(link);
      if (mass > 0) response = std::max(response, 1 / mass);
    }
    row.cfm = std::max(row.cfm, share * response);
  }

  // Of an island: steps for which it is not solved directly, and how often in a row that took long.
  struct History {
    unsigned char rest = 0, toils = 0;
  };

  // What comes to rest is solved in few rounds once it has been solved, and must not be disturbed by iterations. But rows of bodies that
  // fall about change sides in every step: after some of those iterations are better for a while.
  void give_rest() {
    if (hard_) return;
    History &island = history();
    if (direct_.rounds() <= settings_.max_rounds) {
      island.toils = 0;
    } else if (++island.toils >= 8) {
      island.toils = 4;
      island.rest = 64;
    }
  }

  // Islands are known by their first tree or body.
  History &history() {
    int first = 0;
    if constexpr (HAS_TREES) {
      for (const btMultiBodyConstraintArray *rows :
           {&this->m_multiBodyNonContactConstraints, &this->m_multiBodyNormalContactConstraints}) {
        if (rows->size() == 0) continue;
        const btMultiBodySolverConstraint &row = (*rows)[0];
        const btMultiBody &tree = *(row.m_multiBodyA ? row.m_multiBodyA : row.m_multiBodyB);
        return history(tree.getLink(0).m_collider->getWorldArrayIndex());
      }
    }
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      const btRigidBody *b = this->m_tmpSolverBodyPool[i].m_originalBody;
      if (!b) continue;
      first = b->getWorldArrayIndex();
      break;
    }
    return history(first);
  }

  History &history(int object) {
    const size_t index = static_cast<size_t>(std::max(0, object));
    if (histories_.size() <= index) histories_.resize(index + 1);
    return histories_[index];
  }

  // Sequential impulses converge badly across joints and between light and heavy bodies.
  bool is_hard() const {
    if (this->m_tmpSolverNonContactConstraintPool.size() > 0) return true;
    btScalar least = BT_LARGE_FLOAT, most = 0;
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      const btRigidBody *b = this->m_tmpSolverBodyPool[i].m_originalBody;
      if (!b || b->getInvMass() <= 0) continue;
      least = std::min(least, b->getInvMass());
      most = std::max(most, b->getInvMass());
    }
    return most > settings_.hard_mass_ratio * least;
  }

  // Takes over all rows of the island if a direct solution is worth its cost.
  bool gather(const btContactSolverInfo &info) {
    const btConstraintArray &joints = this->m_tmpSolverNonContactConstraintPool;
    const btConstraintArray &contacts = this->m_tmpSolverContactConstraintPool;
    const btConstraintArray &frictions = this->m_tmpSolverContactFrictionConstraintPool;
    const btConstraintArray &rolling = this->m_tmpSolverContactRollingFrictionConstraintPool;
    History &island = history();
    if (island.rest > 0) {
      --island.rest;
      return false;
    }
    direct_.rows.clear();
    for (int i = 0; i < joints.size(); ++i) {
      DirectRow &row = add_row(joints[i]);
      soften(row, joints[i], settings_.joint_softness);
    }
    const int first_contact = joints.size();
    for (int i = 0; i < contacts.size(); ++i) add_contact(contacts[i], info);
    const double kept = info.m_solverMode & SOLVER_USE_WARMSTARTING ? info.m_warmstartingFactor : 1;
    for (int i = 0; i < frictions.size(); ++i) {
      add_friction(frictions[i], first_contact, frictions[i].m_appliedImpulse, BT_LARGE_FLOAT, kept);
    }
    for (int i = 0; i < rolling.size(); ++i) {
      add_friction(rolling[i], first_contact, rolling[i].m_appliedImpulse, rolling[i].m_friction, kept);
    }
    gather_tree_rows(info);
    if (direct_.rows.empty() || contradicts_) return false;
    const double cost = direct_.prepare(this->m_tmpSolverBodyPool.size(), tree_sizes_);
    const bool is_hard = hard_ || !tree_rows_.empty();
    if (cost <= (is_hard ? settings_.max_hard_cost : settings_.max_cost) * static_cast<double>(direct_.rows.size())) return true;
    // A pile stays one, and to see that costs a third of what its iterations do.
    if (!hard_) island.rest = 15;
    return false;
  }

  void gather_tree_rows(const btContactSolverInfo &info) {
    trees_.clear();
    tree_sizes_.clear();
    tree_rows_.clear();
    contradicts_ = false;
    if constexpr (HAS_TREES) {
      // Those of joints and ties are soft enough.
      btMultiBodyConstraintArray &joints = this->m_multiBodyNonContactConstraints;
      for (int i = 0; i < joints.size(); ++i) add_row(joints[i]).x = joints[i].m_appliedImpulse;
      btMultiBodyConstraintArray &contacts = this->m_multiBodyNormalContactConstraints;
      const int first_contact = static_cast<int>(direct_.rows.size());
      for (int i = 0; i < contacts.size(); ++i) add_contact(contacts[i], info);
      btMultiBodyConstraintArray &frictions = this->m_multiBodyFrictionContactConstraints;
      for (int i = 0; i < frictions.size(); ++i) {
        const auto &point = *static_cast<const btManifoldPoint *>(frictions[i].m_originalContactPoint);
        // Their directions follow from the normal, the first one first.
        const bool is_first = i == 0 || frictions[i - 1].m_frictionIndex != frictions[i].m_frictionIndex;
        const double guess = is_first ? point.m_appliedImpulseLateral1 : point.m_appliedImpulseLateral2;
        add_friction(frictions[i], first_contact, guess, BT_LARGE_FLOAT, 1);
      }
      for (btMultiBodyConstraintArray *rows :
           {&this->m_multiBodyTorsionalFrictionContactConstraints, &this->m_multiBodySpinningFrictionContactConstraints}) {
        for (int i = 0; i < rows->size(); ++i) add_friction((*rows)[i], first_contact, 0, BT_LARGE_FLOAT, 1);
      }
    }
  }

  template <class Row>
  void add_contact(Row &from, const btContactSolverInfo &info) {
    DirectRow &row = add_row(from);
    const auto &point = *static_cast<const btManifoldPoint *>(from.m_originalContactPoint);
    row.x = std::max(btScalar(0), point.m_appliedImpulse);
    const btScalar excess = excess_push(from, info);
    if (excess > 0) row.most = row.target - excess;
    if constexpr (std::is_same_v<Row, btMultiBodySolverConstraint>) contradicts_ = contradicts_ || excess > MOST_EXCESS;
    soften(row, from, settings_.contact_softness);
    const bool opens = row.target < 0 && row.x == 0;
    row.state = opens || (point.m_lifeTime > 1 && row.x == 0) ? DirectRow::Low : DirectRow::Free;
  }

  // kept: the share of the impulse of the step before that `guess` is.
  template <class Row>
  void add_friction(Row &from, int first_contact, double guess, double cap, double kept) {
    DirectRow &row = add_row(from);
    row.normal = first_contact + from.m_frictionIndex;
    row.friction = from.m_friction;
    row.cap = cap;
    soften(row, from, settings_.friction_softness);
    const DirectRow &normal = direct_.rows[row.normal];
    const double bound = std::min(row.friction * normal.x, cap) * (1 - 1e-6);
    row.state = guess >= bound * kept ? DirectRow::High
                : guess <= -bound * kept ? DirectRow::Low : DirectRow::Free;
    if (normal.state == DirectRow::Free && normal.x == 0) row.state = DirectRow::Free;
  }

  void write_back() {
    size_t at = 0;
    for (btConstraintArray *pool : {&this->m_tmpSolverNonContactConstraintPool, &this->m_tmpSolverContactConstraintPool,
                                    &this->m_tmpSolverContactFrictionConstraintPool,
                                    &this->m_tmpSolverContactRollingFrictionConstraintPool}) {
      for (int i = 0; i < pool->size(); ++i) (*pool)[i].m_appliedImpulse = direct_.rows[at++].x;
    }
    // Trees already have what was applied when their rows were made.
    if constexpr (HAS_TREES) {
      for (const auto &row : tree_rows_) this->apply(row, direct_.rows[at++].x - btScalar(row.row->m_appliedImpulse));
    }
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      btSolverBody &b = body(i);
      const double *v = direct_.velocity(i);
      b.internalGetDeltaLinearVelocity().setValue(v[0], v[1], v[2]);
      b.internalGetDeltaAngularVelocity().setValue(v[3], v[4], v[5]);
    }
  }

  const AccurateContext &settings_;
  DirectSolver direct_;
  // Of the rows that act on trees, which are the last of the direct solver.
  Vector<TieSolver::Sides> tree_rows_;
  Vector<int> trees_, tree_sizes_;
  bool hard_ = false;
  // Whether a row of the island asks a tree for what it can't do.
  bool contradicts_ = false;
  Vector<btVector3> friction_before_;
  Vector<History> histories_;
};

#endif
