// Soft rows (compliant constraints): J v = target - softness * impulse. C++ only.
#ifndef AMB_SOFT_ROWS_H
#define AMB_SOFT_ROWS_H

#include <BulletDynamics/ConstraintSolver/btSolverConstraint.h>
#include <BulletDynamics/ConstraintSolver/btTypedConstraint.h>

#include "extension.h"

inline const SoftRows *soft_rows_of(const btTypedConstraint &constraint) {
  // The user pointer shares its bytes with the user id, which is -1 by default.
  if (constraint.getUserConstraintId() == -1) return nullptr;
  return static_cast<const SoftRows *>(const_cast<btTypedConstraint &>(constraint).getUserConstraintPtr());
}

// Includes the softness in the effective mass of soft rows. Bullet leaves it out, and its iterations diverge for rows
// whose softness exceeds J M^-1 J^T. To be called after all rows of `constraints` were set up. `rows_of(i)` is the
// number of rows of constraint i; `found` is called with the index of each soft row.
template <typename RowsOf, typename Found>
void soften_rows(btTypedConstraint *const *constraints, int n, RowsOf rows_of, btConstraintArray &rows, Found found) {
  int first = 0;
  for (int i = 0; i < n; ++i) {
    const int count = rows_of(i);
    const SoftRows *soft = soft_rows_of(*constraints[i]);
    if (soft && count > 0) {
      for (int j = 0; j < soft->count; ++j) {
        const int index = first + soft->first + j;
        btSolverConstraint &row = rows[index];
        // The effective mass of rows on which no body can move is zero.
        if (row.m_jacDiagABInv == 0) continue;
        const btScalar inverse = 1 / (1 / row.m_jacDiagABInv + soft->softness[j]);
        row.m_rhs *= inverse / row.m_jacDiagABInv;
        row.m_jacDiagABInv = inverse;
        row.m_cfm = soft->softness[j] * inverse;
        found(index);
      }
    }
    first += count;
  }
}

// Adds soft rows to a solver of the sequential-impulse family.
template <class Base>
struct WithSoftRows : Base {
  using Base::Base;

 protected:
  void convertJoints(btTypedConstraint **constraints, int n, const btContactSolverInfo &info) override {
    Base::convertJoints(constraints, n, info);
    soft.resize(0);
    const auto rows_of = [this](int i) { return int(this->m_tmpConstraintSizesPool[i].m_numConstraintRows); };
    soften_rows(constraints, n, rows_of, this->m_tmpSolverNonContactConstraintPool,
                [this](int row) { soft.push_back(row); });
  }

  // Indices of the soft rows among the rows of joints.
  btAlignedObjectArray<int> soft;
};

// Adds soft rows to an MLCP solver, with the softness in the diagonal of its matrix.
template <class Base>
struct WithSoftMatrix : WithSoftRows<Base> {
  using WithSoftRows<Base>::WithSoftRows;

 protected:
  void createMLCPFast(const btContactSolverInfo &info) override {
    Base::createMLCPFast(info);
    for (int i = 0; i < this->soft.size(); ++i) {
      const int index = this->soft[i];
      const btSolverConstraint &row = this->m_tmpSolverNonContactConstraintPool[index];
      this->m_A.setElem(index, index, this->m_A(index, index) + row.m_cfm / row.m_jacDiagABInv);
    }
  }
};

#endif
