#include "solvers.h"

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

template <class Visit>
void ConjugateSolver::for_each_row(Visit visit) {
  int index = 0;
  for (btConstraintArray *rows :
       {&m_tmpSolverNonContactConstraintPool, &m_tmpSolverContactConstraintPool,
        &m_tmpSolverContactFrictionConstraintPool, &m_tmpSolverContactRollingFrictionConstraintPool}) {
    for (int i = 0; i < rows->size(); ++i) visit((*rows)[i], index++);
  }
}

btScalar ConjugateSolver::solveSingleIteration(int iteration, btCollisionObject **bodies, int n,
                                               btPersistentManifold **manifolds, int manifold_count,
                                               btTypedConstraint **constraints, int constraint_count,
                                               const btContactSolverInfo &info, btIDebugDraw *debug) {
  if (iteration == 0) {
    int count = 0;
    for_each_row([&count](const btSolverConstraint &, int) { ++count; });
    before_.resize(count);
    direction_.resize(0);
    direction_.resize(count, 0);
    latest_ = 0;
  }
  for_each_row([this](const btSolverConstraint &row, int i) { before_[i] = row.m_appliedImpulse; });
  const btScalar residual = btSequentialImpulseConstraintSolver::solveSingleIteration(
      iteration, bodies, n, manifolds, manifold_count, constraints, constraint_count, info, debug);
  btScalar change = 0;
  for_each_row([&](const btSolverConstraint &row, int i) {
    const btScalar by_row = row.m_appliedImpulse - before_[i];
    if (row.m_jacDiagABInv > 0) change += by_row * by_row / row.m_jacDiagABInv;
  });
  // A change that has grown starts the directions anew. The last iteration leaves impulses that are within their bounds.
  const btScalar share = change < latest_ && iteration + 1 < info.m_numIterations ? change / latest_ : 0;
  latest_ = change;
  for_each_row([&](btSolverConstraint &row, int i) {
    const btScalar extra = share * direction_[i];
    direction_[i] = extra + row.m_appliedImpulse - before_[i];
    if (extra == 0) return;
    row.m_appliedImpulse += extra;
    apply(m_tmpSolverBodyPool[row.m_solverBodyIdA], row.m_contactNormal1, row.m_angularComponentA, extra);
    apply(m_tmpSolverBodyPool[row.m_solverBodyIdB], row.m_contactNormal2, row.m_angularComponentB, extra);
  });
  return residual;
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
  if (solver == AmbSolver_Nncg) return std::make_unique<ConjugateSolver>();
  if (solver == AmbSolver_WarmFriction) return std::make_unique<WarmFrictionSolver>();
  return std::make_unique<btSequentialImpulseConstraintSolver>();
}
