#include "engine_solvers.h"

#include "soft_rows.h"
#include "solvers.h"

#include <BulletDynamics/MLCPSolvers/btMLCPSolver.h>

#include "accurate_solver.h"
#include "coupled_rows.h"
#include "ledger_rows.h"
#include "second_order.h"
#include "articulation_solver.h"

std::unique_ptr<btConstraintSolver> soft_row_solver_of(int solver, btMLCPSolverInterface *mlcp,
                                                       const AccurateContext &accurate, EnergyLedger &ledger) {
  if (mlcp) return std::make_unique<WithLedger<WithSoftMatrix<WithCouplings<btMLCPSolver>>>>(ledger, mlcp);
  if (solver == AmbSolver_Nncg)
    return std::make_unique<WithLedger<WithSoftRows<WithCouplings<ConjugateSolver>>>>(ledger);
  if (solver == AmbSolver_WarmFriction)
    return std::make_unique<WithLedger<WithSoftRows<WithCouplings<WarmFrictionSolver>>>>(ledger);
  if (solver == AmbSolver_Accurate) {
    using Accurate = AccurateSolver<SecondOrder<WithCouplings<btSequentialImpulseConstraintSolver>>>;
    return std::make_unique<WithLedger<WithSoftRows<Accurate>>>(ledger, accurate);
  }
  return std::make_unique<WithLedger<WithSoftRows<WithCouplings<btSequentialImpulseConstraintSolver>>>>(ledger);
}

std::unique_ptr<btMultiBodyConstraintSolver> multi_body_solver_of(int solver, const AccurateContext &accurate,
                                                                  EnergyLedger &ledger) {
  if (solver == AmbSolver_Accurate) {
    using Accurate = AccurateSolver<SecondOrder<WithCouplings<ArticulationSolver>>>;
    return std::make_unique<WithLedger<WithSoftRows<Accurate>>>(ledger, accurate);
  }
  return std::make_unique<WithLedger<WithSoftRows<WithCouplings<ArticulationSolver>>>>(ledger);
}
