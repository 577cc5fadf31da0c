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

// Nonsmooth nonlinear conjugate gradients of Fletcher-Reeves over projected Gauss-Seidel (Silcowitz, Niebe, Erleben: "A
// nonsmooth nonlinear conjugate gradient method for interactive contact force problems", The Visual Computer 26, 2010).
// btNNCGConstraintSolver takes what its rows return for changes of impulses, but since Bullet 2.85 they return velocities.
// Changes are measured as impulse^2 times response, an energy, because rows of forces and of torques have different units.
class ConjugateSolver : public btSequentialImpulseConstraintSolver {
 protected:
  btScalar solveSingleIteration(int iteration, btCollisionObject **bodies, int n, btPersistentManifold **manifolds,
                                int manifold_count, btTypedConstraint **constraints, int constraint_count,
                                const btContactSolverInfo &info, btIDebugDraw *debug) override;

 private:
  template <class Visit>
  void for_each_row(Visit visit);

  // Of each row: impulse before the iteration, and the direction along which impulses are moved beyond it.
  btAlignedObjectArray<btScalar> before_, direction_;
  // Square of the change in the latest iteration, J.
  btScalar latest_ = 0;
};

#endif
