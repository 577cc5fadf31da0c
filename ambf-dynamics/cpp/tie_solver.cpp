#include "tie_solver.h"

#include "tree_rows.h"

const AmbMlcpTable *mlcp_table = nullptr;

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
