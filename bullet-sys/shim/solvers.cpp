#include "solvers.h"

#include <BulletDynamics/ConstraintSolver/btNNCGConstraintSolver.h>
#include <BulletDynamics/MLCPSolvers/btDantzigSolver.h>
#include <BulletDynamics/MLCPSolvers/btLemkeSolver.h>
#include <BulletDynamics/MLCPSolvers/btMLCPSolver.h>
#include <BulletDynamics/MLCPSolvers/btSolveProjectedGaussSeidel.h>

namespace {

void apply(btSolverBody &body, const btVector3 &normal, const btVector3 &angular, btScalar impulse) {
  if (body.m_originalBody) body.internalApplyImpulse(normal * body.internalGetInvMass(), angular, impulse);
}

}  // namespace

void WarmFrictionSolver::convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) {
  btSequentialImpulseConstraintSolver::convertContacts(manifolds, n, info);
  if (!(info.m_solverMode & SOLVER_USE_WARMSTARTING)) return;
  for (int i = 0; i < m_tmpSolverContactConstraintPool.size(); ++i) {
    const btSolverConstraint &contact = m_tmpSolverContactConstraintPool[i];
    const auto *point = static_cast<const btManifoldPoint *>(contact.m_originalContactPoint);
    btSolverConstraint &friction = m_tmpSolverContactFrictionConstraintPool[contact.m_frictionIndex];
    friction.m_appliedImpulse = point->m_appliedImpulseLateral1 * info.m_warmstartingFactor;
    apply(m_tmpSolverBodyPool[contact.m_solverBodyIdA], friction.m_contactNormal1, friction.m_angularComponentA,
          friction.m_appliedImpulse);
    apply(m_tmpSolverBodyPool[contact.m_solverBodyIdB], friction.m_contactNormal2, friction.m_angularComponentB,
          friction.m_appliedImpulse);
  }
}

std::unique_ptr<btMLCPSolverInterface> mlcp_of(int solver) {
  switch (solver) {
    case AmbSolver_Dantzig: return std::make_unique<InArena<btDantzigSolver>>();
    case AmbSolver_ProjectedGaussSeidel: return std::make_unique<InArena<btSolveProjectedGaussSeidel>>();
    case AmbSolver_Lemke: return std::make_unique<InArena<btLemkeSolver>>();
    default: return nullptr;
  }
}

std::unique_ptr<btConstraintSolver> solver_of(int solver, btMLCPSolverInterface *mlcp) {
  if (mlcp) return std::make_unique<btMLCPSolver>(mlcp);
  if (solver == AmbSolver_Nncg) return std::make_unique<btNNCGConstraintSolver>();
  if (solver == AmbSolver_WarmFriction) return std::make_unique<WarmFrictionSolver>();
  return std::make_unique<btSequentialImpulseConstraintSolver>();
}
