// Constraint solvers of the engine by enum AmbSolver: Bullet's with soft rows, and that of AmbSolver_Accurate. C++
// only.
#ifndef AMB_ENGINE_SOLVERS_H
#define AMB_ENGINE_SOLVERS_H

#include "accurate_context.h"
#include "ledger.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

// mlcp: algorithm of an MLCP solver; null for all other solvers.
// accurate: settings of AmbSolver_Accurate; ledger: to which the work of rows is added. Both must outlive the solver.
std::unique_ptr<btConstraintSolver> soft_row_solver_of(int solver, btMLCPSolverInterface *mlcp,
                                                       const AccurateContext &accurate, EnergyLedger &ledger);
// The solver of a world with articulations: AmbSolver_Accurate, or sequential impulses for all other values.
std::unique_ptr<btMultiBodyConstraintSolver> multi_body_solver_of(int solver, const AccurateContext &accurate,
                                                                  EnergyLedger &ledger);

#endif
