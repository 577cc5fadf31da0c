// Adds the work of a solver's rows to the energy ledger. C++ only.
#ifndef AMB_LEDGER_ROWS_H
#define AMB_LEDGER_ROWS_H

#include <type_traits>
#include <utility>

#include "ledger.h"
#include "position_error.h"
#include "coupled_rows.h"
#include "soft_rows.h"
#include "articulation_solver.h"

// Writes the velocities z of an articulation (see articulation_solver.h) at the beginning of the
// sub-step and after its free motion.
void read_rates(const btMultiBody &multi_body, Vector<btScalar> &start, Vector<btScalar> &free);

// A solver of the sequential-impulse family with couplings. The work of a row is its impulse times the mean of its velocities before
// and after the sub-step: for rigid bodies the sum over all rows, and forces, is exactly the change of kinetic energy.
template <class Base>
class WithLedger : public Base {
  static constexpr bool HAS_ARTICULATIONS = std::is_base_of_v<ArticulationSolver, Base>;

 public:
  template <class... Arguments>
  explicit WithLedger(EnergyLedger &owner, Arguments &&...arguments)
      : Base(std::forward<Arguments>(arguments)...), ledger(owner) {}

 protected:
  btScalar solveGroupCacheFriendlyFinish(btCollisionObject **bodies, int n, const btContactSolverInfo &info) override {
    if (ledger.enabled) account();
    return Base::solveGroupCacheFriendlyFinish(bodies, n, info);
  }

 private:
  void account() {
    const btTypedConstraint *last = nullptr;
    int index = 0;
    const btConstraintArray &joints = this->m_tmpSolverNonContactConstraintPool;
    for (int i = 0; i < joints.size(); ++i) {
      const auto *constraint = static_cast<const btTypedConstraint *>(joints[i].m_originalContactPoint);
      index = constraint == last ? index + 1 : 0;
      last = constraint;
      ledger.book(kind_of(*constraint, joints[i], index), work_of(joints[i]));
    }
    for (const auto &row : this->coupled_rows_) {
      const auto speeds = [this](const auto &part) {
        return speeds_of(this->m_tmpSolverBodyPool[part.body], part.linear, part.angular);
      };
      if (row.impulse != 0) ledger.book(WorkKind::Joint, row.impulse / 2 * this->sum_of_parts(row, speeds));
    }
    book_all(this->m_tmpSolverContactConstraintPool, WorkKind::Contact);
    book_all(this->m_tmpSolverContactFrictionConstraintPool, WorkKind::Friction);
    book_all(this->m_tmpSolverContactRollingFrictionConstraintPool, WorkKind::Friction);
    if constexpr (HAS_ARTICULATIONS) {
      btMultiBodyConstraintArray &rows = this->m_multiBodyNonContactConstraints;
      for (int i = 0; i < rows.size(); ++i) {
        const auto &owner = *static_cast<const EngineRows *>(rows[i].m_orgConstraint);
        ledger.book(owner.work_kind(rows[i].m_orgDofIndex), work_of(rows[i]));
      }
      book_all(this->m_multiBodyNormalContactConstraints, WorkKind::Contact);
      book_all(this->m_multiBodyFrictionContactConstraints, WorkKind::Friction);
      book_all(this->m_multiBodyTorsionalFrictionContactConstraints, WorkKind::Friction);
      book_all(this->m_multiBodySpinningFrictionContactConstraints, WorkKind::Friction);
    }
  }

  // The kind of a row follows from its bounds: unbounded on both sides is a joint, on one side a limit, bounded on both
  // a motor.
  static WorkKind kind_of(const btTypedConstraint &constraint, const btSolverConstraint &row, int index) {
    const bool is_spring = constraint.getConstraintType() == D6_SPRING_2_CONSTRAINT_TYPE;
    const SoftRows *soft = soft_rows_of(constraint);
    if (!is_spring && soft && index >= soft->first && index < soft->first + soft->count) {
      return constraint.getConstraintType() == D6_CONSTRAINT_TYPE ? WorkKind::BodyDrive : WorkKind::Motor;
    }
    const bool low_open = row.m_lowerLimit <= -UNBOUNDED, high_open = row.m_upperLimit >= UNBOUNDED;
    const bool is_soft = is_spring && soft && index >= soft->first && index < soft->first + soft->count;
    if (low_open && high_open && !is_soft) return WorkKind::Joint;
    if (low_open != high_open) return WorkKind::Limit;
    // The work of a spring is computed from its coordinates, see EnergyLedger::springs.
    return is_spring ? WorkKind::Ignored : WorkKind::Motor;
  }

  template <class Rows>
  void book_all(Rows &rows, WorkKind kind) {
    for (int i = 0; i < rows.size(); ++i) ledger.book(kind, work_of(rows[i]));
  }

  // Sum of the velocities J v of one body before and after the sub-step, m/s or rad/s.
  static double speeds_of(const btSolverBody &body, const btVector3 &linear, const btVector3 &angular) {
    if (!body.m_originalBody || body.m_originalBody->getInvMass() <= 0) return 0;
    return linear.dot(body.m_linearVelocity * 2 + body.m_externalForceImpulse + body.getDeltaLinearVelocity()) +
           angular.dot(body.m_angularVelocity * 2 + body.m_externalTorqueImpulse + body.getDeltaAngularVelocity());
  }

  double work_of(const btSolverConstraint &row) {
    if (row.m_appliedImpulse == btScalar(0)) return 0;
    const btSolverBody &a = this->m_tmpSolverBodyPool[row.m_solverBodyIdA],
                       &b = this->m_tmpSolverBodyPool[row.m_solverBodyIdB];
    return row.m_appliedImpulse / 2 *
           (speeds_of(a, row.m_contactNormal1, row.m_relpos1CrossNormal) +
            speeds_of(b, row.m_contactNormal2, row.m_relpos2CrossNormal));
  }

  double work_of(btMultiBodySolverConstraint &row) {
    if (row.m_appliedImpulse == btScalar(0)) return 0;
    double sum = 0;
    for (const auto &side : this->sides_of(row).sides) {
      if (side.body) sum += speeds_of(*side.body, side.linear, side.angular);
      if (!side.multi_body) continue;
      read_rates(*side.multi_body, start_rates, free_rates);
      for (int k = 0; k < side.n; ++k) {
        const btScalar change = this->m_data.m_deltaVelocities[side.velocity + k];
        sum += this->m_data.m_jacobians[side.jacobian + k] * (start_rates[k] + free_rates[k] + change);
      }
    }
    return btScalar(row.m_appliedImpulse) / 2 * sum;
  }

  EnergyLedger &ledger;
  Vector<btScalar> start_rates, free_rates;
};

#endif
