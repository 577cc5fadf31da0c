// Rows of couplings between rigid bodies for solvers of the sequential-impulse family. C++ only.
#ifndef AMB_COUPLED_ROWS_H
#define AMB_COUPLED_ROWS_H

#include <BulletDynamics/ConstraintSolver/btSequentialImpulseConstraintSolver.h>
#include <BulletDynamics/MLCPSolvers/btMLCPSolver.h>

#include <algorithm>
#include <type_traits>

#include "coupling.h"
#include "solvers.h"

// A row acts on the bodies of all joints of its coupling, which a row of Bullet, with two bodies, cannot: it is solved
// after Bullet's rows in each iteration. Islands with such rows have no other solver than sequential impulses, or that of
// AccurateSolver, which adds them to its problem.
template <class Base>
class WithCouplings : public Base {
 public:
  using Base::Base;

 protected:
  // What a row does to one body: Jacobian and response M^-1 J^T.
  struct CoupledPart {
    int body;
    btVector3 linear, angular, by_linear, by_angular;
  };
  struct CoupledRow {
    AmbCoupling *coupling;
    // Its parts in coupled_parts_.
    size_t first, count;
    // Velocity J v after the forces of the sub-step, target of it, and position error: m and rad as the follower.
    btScalar velocity, target, error;
    // J M^-1 J^T, and impulse, N s or N m s.
    btScalar response, impulse;
  };

  void convertJoints(btTypedConstraint **constraints, int n, const btContactSolverInfo &info) override {
    Base::convertJoints(constraints, n, info);
    coupled_rows_.clear();
    coupled_parts_.clear();
    for (int i = 0; i < n; ++i) {
      if (constraints[i]->getUserConstraintType() != CouplingLink::USER_TYPE) continue;
      const auto &link = static_cast<const CouplingLink &>(*constraints[i]);
      if (link.coupling.links[0].get() == &link) add_coupled_row(link.coupling, info);
    }
  }

  btScalar solveSingleIteration(int iteration, btCollisionObject **bodies, int n, btPersistentManifold **manifolds,
                                int manifold_count, btTypedConstraint **constraints, int constraint_count,
                                const btContactSolverInfo &info, btIDebugDraw *debug) override {
    // The directions of conjugate gradients do not know these rows.
    constexpr bool has_directions = std::is_base_of_v<ConjugateSolver, Base>;
    using Iterated = std::conditional_t<has_directions, btSequentialImpulseConstraintSolver, Base>;
    if (coupled_rows_.empty())
      return Base::solveSingleIteration(iteration, bodies, n, manifolds, manifold_count, constraints, constraint_count,
                                        info, debug);
    btScalar residual = Iterated::solveSingleIteration(iteration, bodies, n, manifolds, manifold_count, constraints,
                                                       constraint_count, info, debug);
    for (CoupledRow &row : coupled_rows_) residual = std::max(residual, solve_coupled_row(row));
    return residual;
  }

  btScalar solveGroupCacheFriendlyIterations(btCollisionObject **bodies, int n, btPersistentManifold **manifolds,
                                             int manifold_count, btTypedConstraint **constraints, int constraint_count,
                                             const btContactSolverInfo &info, btIDebugDraw *debug) override {
    constexpr bool is_direct = std::is_base_of_v<btMLCPSolver, Base>;
    using Iterated = std::conditional_t<is_direct, btSequentialImpulseConstraintSolver, Base>;
    if (coupled_rows_.empty())
      return Base::solveGroupCacheFriendlyIterations(bodies, n, manifolds, manifold_count, constraints,
                                                     constraint_count, info, debug);
    return Iterated::solveGroupCacheFriendlyIterations(bodies, n, manifolds, manifold_count, constraints, constraint_count,
                                                       info, debug);
  }

  // Sum of what `value` is of each part of a row.
  template <class Value>
  btScalar sum_of_parts(const CoupledRow &row, Value value) const {
    btScalar sum = 0;
    for (size_t i = row.first; i < row.first + row.count; ++i) sum += value(coupled_parts_[i]);
    return sum;
  }

  Vector<CoupledRow> coupled_rows_;
  Vector<CoupledPart> coupled_parts_;

 private:
  void add_coupled_row(AmbCoupling &coupling, const btContactSolverInfo &info) {
    CoupledRow row{&coupling, coupled_parts_.size(), 0, 0, 0, 0, 0, 0};
    coordinates_.clear();
    for (const AmbCoupling::Term &term : coupling.terms) {
      const CoordinateRow part = coordinate_row(*term.joint);
      coordinates_.push_back(part.coordinate);
      btTypedConstraint &joint = *term.joint->constraint;
      add_part(row, joint.getRigidBodyA(), part.linear[0] * term.factor, part.angular[0] * term.factor, info);
      add_part(row, joint.getRigidBodyB(), part.linear[1] * term.factor, part.angular[1] * term.factor, info);
    }
    row.error = coupling.complete([this](size_t i) -> btScalar & { return coordinates_[i]; }, coupling.has_jumped);
    coupling.has_jumped = false;
    for (size_t i = row.first; i < row.first + row.count; ++i) {
      CoupledPart &part = coupled_parts_[i];
      const btSolverBody &body = this->m_tmpSolverBodyPool[part.body];
      part.by_linear = part.linear * body.internalGetInvMass();
      const btRigidBody &original = *body.m_originalBody;
      part.by_angular = original.getInvInertiaTensorWorld() * part.angular * original.getAngularFactor();
      row.response += part.linear.dot(part.by_linear) + part.angular.dot(part.by_angular);
      row.velocity += part.linear.dot(body.m_linearVelocity + body.m_externalForceImpulse) +
                      part.angular.dot(body.m_angularVelocity + body.m_externalTorqueImpulse);
    }
    row.target = -info.m_erp * row.error / info.m_timeStep;
    coupled_rows_.push_back(row);
  }

  // Adds to the part of a body; nothing to one that does not move.
  void add_part(CoupledRow &row, btRigidBody &body, const btVector3 &linear, const btVector3 &angular,
                const btContactSolverInfo &info) {
    if (body.getInvMass() <= 0) return;
    const int id = this->getOrInitSolverBody(body, info.m_timeStep);
    for (size_t i = row.first; i < coupled_parts_.size(); ++i) {
      if (coupled_parts_[i].body != id) continue;
      coupled_parts_[i].linear += linear;
      coupled_parts_[i].angular += angular;
      return;
    }
    const btVector3 none(0, 0, 0);
    coupled_parts_.push_back({id, linear, angular, none, none});
    ++row.count;
  }

  // Returns the square of the velocity that was missing, m/s or rad/s.
  btScalar solve_coupled_row(CoupledRow &row) {
    if (!(row.response > 0)) return 0;
    const btScalar changed = sum_of_parts(row, [this](const CoupledPart &part) {
      btSolverBody &body = this->m_tmpSolverBodyPool[part.body];
      return part.linear.dot(body.internalGetDeltaLinearVelocity()) +
             part.angular.dot(body.internalGetDeltaAngularVelocity());
    });
    const btScalar missing = row.target - row.velocity - changed, impulse = missing / row.response;
    row.impulse += impulse;
    for (size_t i = row.first; i < row.first + row.count; ++i) {
      const CoupledPart &part = coupled_parts_[i];
      this->m_tmpSolverBodyPool[part.body].internalApplyImpulse(part.by_linear, part.by_angular, impulse);
    }
    return missing * missing;
  }

  Vector<btScalar> coordinates_;
};

#endif
