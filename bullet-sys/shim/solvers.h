// Bullet's constraint solvers by their number in `AmbSolver`. C++ only.
#ifndef AMB_SOLVERS_H
#define AMB_SOLVERS_H

#include "internal.h"

// What an MLCP solver solves its islands with; null for all others.
std::unique_ptr<btMLCPSolverInterface> mlcp_of(int solver);
// AmbSolver_Accurate, which needs an engine, is sequential impulses here.
std::unique_ptr<btConstraintSolver> solver_of(int solver, btMLCPSolverInterface *mlcp);

// Bullet 3 no longer warm-starts friction; results of Bullet 2 need it. The rows are set up from velocities without impulses, so
// that it can be done after all of them are.
class WarmFrictionSolver : public btSequentialImpulseConstraintSolver {
 protected:
  void convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) override;
};

#endif
