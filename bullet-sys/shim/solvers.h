// Constraint solvers by their number in `AmbSolver`. C++ only.
#ifndef AMB_SOLVERS_H
#define AMB_SOLVERS_H

#include "internal.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

// What an MLCP solver solves its islands with; null for all others.
std::unique_ptr<btMLCPSolverInterface> mlcp_of(int solver);
// accurate: switches of AmbSolver_Accurate, which must outlive the solver.
std::unique_ptr<btConstraintSolver> solver_of(int solver, btMLCPSolverInterface *mlcp, const AccurateContext &accurate);
// The solver of a world with trees: sequential impulses, but for AmbSolver_Accurate.
std::unique_ptr<btMultiBodyConstraintSolver> multi_body_solver_of(int solver, const AccurateContext &accurate);

#endif
