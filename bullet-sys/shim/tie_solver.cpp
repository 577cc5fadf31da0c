#include "tie_solver.h"

#include "tree_rows.h"

namespace {

// Of a tie, as a share of its rows' response: it may hold what its tree cannot move, and rows then share the load.
constexpr btScalar SOFTNESS = 1e-6;

}  // namespace

TieSolver::Sides TieSolver::sides_of(Row &row) {
  Sides result{&row, {}};
  for (int k = 0; k < 2; ++k) {
    Side &side = result.sides[k];
    side.tree = k ? row.m_multiBodyB : row.m_multiBodyA;
    if (side.tree) {
      side.n = side.tree->getNumDofs() + 6;
      side.jacobian = k ? row.m_jacBindex : row.m_jacAindex;
      side.velocity = k ? row.m_deltaVelBindex : row.m_deltaVelAindex;
      continue;
    }
    btSolverBody &body = m_tmpSolverBodyPool[k ? row.m_solverBodyIdB : row.m_solverBodyIdA];
    if (!body.m_originalBody || body.m_originalBody->getInvMass() <= 0) continue;
    side.body = &body;
    side.linear = k ? row.m_contactNormal2 : row.m_contactNormal1;
    side.angular = k ? row.m_relpos2CrossNormal : row.m_relpos1CrossNormal;
    side.by_linear = side.linear * body.internalGetInvMass();
    side.by_angular = k ? row.m_angularComponentB : row.m_angularComponentA;
  }
  return result;
}

bool TieSolver::are_coupled(const Sides &a, const Sides &b) const {
  for (const Side &one : a.sides) {
    for (const Side &other : b.sides) {
      if (one.shares(other)) return true;
    }
  }
  return false;
}

// The velocity of one row that an impulse of 1 on another gives.
btScalar TieSolver::coupling(const Sides &of, const Sides &by) const {
  btScalar sum = 0;
  for (const Side &one : of.sides) {
    for (const Side &other : by.sides) {
      if (!one.shares(other)) continue;
      if (one.body) sum += one.linear.dot(other.by_linear) + one.angular.dot(other.by_angular);
      for (int i = 0; i < one.n; ++i) {
        sum += m_data.m_jacobians[one.jacobian + i] * m_data.m_deltaVelocitiesUnitImpulse[other.jacobian + i];
      }
    }
  }
  return sum;
}

// What impulses have changed of it so far.
btScalar TieSolver::velocity(const Sides &row) const {
  btScalar sum = 0;
  for (const Side &side : row.sides) {
    if (side.body) {
      sum += side.linear.dot(side.body->internalGetDeltaLinearVelocity()) +
             side.angular.dot(side.body->internalGetDeltaAngularVelocity());
    }
    for (int i = 0; i < side.n; ++i) {
      sum += m_data.m_jacobians[side.jacobian + i] * m_data.m_deltaVelocities[side.velocity + i];
    }
  }
  return sum;
}

void TieSolver::apply(const Sides &row, btScalar impulse) {
  row.row->m_appliedImpulse = btScalar(row.row->m_appliedImpulse) + impulse;
  for (const Side &side : row.sides) {
    if (side.body) side.body->internalApplyImpulse(side.by_linear, side.by_angular, impulse);
    if (!side.tree) continue;
    btScalar *response = &m_data.m_deltaVelocitiesUnitImpulse[side.jacobian];
    applyDeltaVee(response, impulse, side.velocity, side.n);
    side.tree->applyDeltaVeeMultiDof2(response, impulse);
  }
}

void TieSolver::solve(const Vector<Sides> &rows) {
  const int n = static_cast<int>(rows.size());
  matrix.resize(n * n);
  right.resize(n);
  low.resize(n);
  high.resize(n);
  impulses.assign(n, 0);
  for (int i = 0; i < n; ++i) {
    const Row &row = *rows[i].row;
    const btScalar diagonal = 1 / row.m_jacDiagABInv, softness = row.m_cfm * diagonal, applied = row.m_appliedImpulse;
    for (int j = 0; j < n; ++j) matrix[i * n + j] = coupling(rows[i], rows[j]);
    matrix[i * n + i] += softness;
    right[i] = row.m_rhs * diagonal - softness * applied - velocity(rows[i]);
    low[i] = row.m_lowerLimit - applied;
    high[i] = row.m_upperLimit - applied;
  }
  solve_within_bounds(n, matrix.data(), right.data(), low.data(), high.data(), impulses.data());
  for (int i = 0; i < n; ++i) apply(rows[i], impulses[i]);
}

void TieSolver::convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) {
  btMultiBodyConstraintSolver::convertContacts(manifolds, n, info);
  size_t ties = 0;
  // Ties first; by them groups are found.
  all.clear();
  for (const bool of_ties : {true, false}) {
    for (int i = 0; i < m_multiBodyNonContactConstraints.size(); ++i) {
      Row &row = m_multiBodyNonContactConstraints[i];
      if (row.m_jacDiagABInv <= 0 || (dynamic_cast<const TieRows *>(row.m_orgConstraint) != nullptr) != of_ties) continue;
      all.push_back(sides_of(row));
      if (!of_ties) continue;
      const btScalar share = 1 / (1 + SOFTNESS);
      row.m_rhs *= share;
      row.m_jacDiagABInv *= share;
      row.m_cfm = SOFTNESS * share;
    }
    if (all.empty()) return;
    if (of_ties) ties = all.size();
  }
  while (ties > 0) {
    group.assign(1, all[0]);
    all.erase(all.begin());
    --ties;
    for (size_t i = 0; i < group.size(); ++i) {
      for (size_t k = 0; k < all.size();) {
        if (!are_coupled(group[i], all[k])) {
          ++k;
          continue;
        }
        group.push_back(all[k]);
        all.erase(all.begin() + k);
        if (k < ties) --ties;
      }
    }
    solve(group);
  }
}
