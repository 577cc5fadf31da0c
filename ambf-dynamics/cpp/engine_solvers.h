// Constraint solvers of the engine by their number in `AmbSolver`: Bullet's with soft rows, and that of AmbSolver_Accurate. C++ only.
#ifndef AMB_ENGINE_SOLVERS_H
#define AMB_ENGINE_SOLVERS_H

#include "accurate_context.h"
#include "ledger.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

// mlcp: what an MLCP solver solves its islands with; null for all others.
// accurate: switches of AmbSolver_Accurate, and where the work of rows is booked; both must outlive the solver.
std::unique_ptr<btConstraintSolver> soft_row_solver_of(int solver, btMLCPSolverInterface *mlcp, const AccurateContext &accurate,
                                                       EnergyLedger &ledger);
// The solver of a world with trees: sequential impulses, but for AmbSolver_Accurate.
std::unique_ptr<btMultiBodyConstraintSolver> multi_body_solver_of(int solver, const AccurateContext &accurate, EnergyLedger &ledger);

#endif
