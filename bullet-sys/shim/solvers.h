// Bullet's constraint solvers by enum AmbSolver. C++ only.
#ifndef AMB_SOLVERS_H
#define AMB_SOLVERS_H

#include "internal.h"

// Algorithm of an MLCP solver; null for all other solvers.
std::unique_ptr<btMLCPSolverInterface> mlcp_of(int solver);
// For AmbSolver_Accurate, which needs an engine, this is the sequential-impulse solver.
std::unique_ptr<btConstraintSolver> solver_of(int solver, btMLCPSolverInterface *mlcp);

// Sequential impulses with warm-started friction, as in Bullet 2; Bullet 3 warm-starts normal impulses only. Rows are
// set up from the velocities before any impulse, so that the friction impulses can be applied after all rows are set
// up.
class WarmFrictionSolver : public btSequentialImpulseConstraintSolver {
 protected:
  void convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) override;
};

#endif
