// Constraint solvers by their number in `AmbSolver`. C++ only.
#ifndef AMB_SOLVERS_H
#define AMB_SOLVERS_H

#include "internal.h"

// What an MLCP solver solves its islands with; null for all others.
std::unique_ptr<btMLCPSolverInterface> mlcp_of(int solver);
std::unique_ptr<btConstraintSolver> solver_of(int solver, btMLCPSolverInterface *mlcp);

#endif
