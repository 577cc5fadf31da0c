// Rows whose velocity gives way to their impulse: J v = target - softness * impulse. C++ only.
#ifndef AMB_SOFT_ROWS_H
#define AMB_SOFT_ROWS_H

#include <BulletDynamics/ConstraintSolver/btSolverConstraint.h>
#include <BulletDynamics/ConstraintSolver/btTypedConstraint.h>

#include "extension.h"

inline const SoftRows *soft_rows_of(const btTypedConstraint &constraint) {
  // Without a user pointer the same bytes hold the number -1.
  return constraint.getUserConstraintId() == -1 ? nullptr
                                                : static_cast<const SoftRows *>(
                                                      const_cast<btTypedConstraint &>(constraint).getUserConstraintPtr());
}

// Bullet leaves softness out of what it divides by, which diverges for rows that give way more than their bodies do. To be called
// after all rows of `constraints` were set up; `rows_of(i)` is the number of rows of the i-th, `found` is told the index of each soft row.
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

// Any solver of the sequential-impulse family that knows soft rows.
template <class Base>
struct WithSoftRows : Base {
  using Base::Base;

 protected:
  void convertJoints(btTypedConstraint **constraints, int n, const btContactSolverInfo &info) override {
    Base::convertJoints(constraints, n, info);
    soft.resize(0);
    const auto rows_of = [this](int i) { return int(this->m_tmpConstraintSizesPool[i].m_numConstraintRows); };
    soften_rows(constraints, n, rows_of, this->m_tmpSolverNonContactConstraintPool, [this](int row) { soft.push_back(row); });
  }

  // Their indices among the rows of joints.
  btAlignedObjectArray<int> soft;
};

// An MLCP solver that knows them: it has to see the softness in the diagonal of its matrix.
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
