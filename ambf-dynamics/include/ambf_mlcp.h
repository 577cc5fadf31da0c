/* Solver of mixed linear complementarity problems of islands of constraints: C interface of ambf-dynamics, src/mlcp/ffi.rs.
 *
 * Its user is linked before the Rust library, and is therefore given a table of functions. Units are SI.
 *
 *   w = (J M^-1 J^T + diag(cfm)) x - target
 *   low < x < high: w = 0;   x = low: w >= 0;   x = high: w <= 0
 *
 * Order of calls: clear, add_row for every row, prepare; then solve, solve_positions or both, and reading out. Results depend on the rows
 * and the budget only, not on earlier problems. A solver must not be used by two threads at once; different ones may be. */
#ifndef AMBF_MLCP_H
#define AMBF_MLCP_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct AmbMlcp AmbMlcp;

/* Active set: the impulse is between its bounds, at the lower or at the upper one. */
enum { AMB_MLCP_FREE = 0, AMB_MLCP_LOW = 1, AMB_MLCP_HIGH = 2 };

/* What a solution is worth. */
enum {
  /* Complementarity holds to 1e-6 of the largest target. */
  AMB_MLCP_SOLVED = 0,
  /* The best impulses that were found, within their bounds; the statistics have the residual. */
  AMB_MLCP_APPROXIMATE = 1,
  /* A number is not finite, the problem was not prepared, or an internal error. All impulses and velocities are 0. */
  AMB_MLCP_NOT_FINITE = 2
};

/* One scalar constraint J v + cfm x = target on the change v of velocities by the impulse x. */
typedef struct AmbMlcpRow {
  /* Body of each side, from 0: rigid bodies first, then articulations; -1: nothing that moves, its other members are not read. */
  int body[2];
  /* Components of each side's velocity: 6 for a rigid body (linear, angular), n for an articulation. */
  int size[2];
  /* Row of the Jacobian, and change of velocity by a unit impulse M^-1 J^T, of each side: `size` numbers, copied by add_row. */
  const double *jacobian[2];
  const double *response[2];
  /* Wanted change of velocity; the part of it that asks for another velocity than 0, such as that of restitution, and is given up where it
   * adds energy; and wanted pseudo-velocity of solve_positions, m/s or rad/s. */
  double target, aim, position_target;
  /* Velocity given up per unit of impulse, 1/kg or 1/(kg m^2), >= 0; and that in solve_positions if it is larger. */
  double cfm, position_cfm;
  /* Bounds of the impulse, N s or N m s; beyond 1e9 there are none. Friction replaces them. */
  double low, high;
  /* Row of the normal impulse for friction: the bounds are +-min(friction max(normal impulse, 0), cap); -1: no friction. */
  int normal;
  double friction, cap;
  /* Guess of the active set and of the impulse (warm start). */
  int state;
  double x;
  /* Whether the row takes part in solve_positions; rows of friction never do. */
  int in_positions;
  /* Whether the row is a drive, which may do work. */
  int is_drive;
} AmbMlcpRow;

/* What the last solution took. */
typedef struct AmbMlcpStatistics {
  uint32_t rows, factorisations;
  /* Rows that changed sides, summed over all iterations. */
  uint32_t pivots;
  /* Sweeps of projected Gauss-Seidel. */
  uint32_t sweeps;
  double multiplications;
  /* Largest violation of complementarity of the result, m/s or rad/s; infinite for AMB_MLCP_NOT_FINITE. */
  double residual;
} AmbMlcpStatistics;

typedef struct AmbMlcpTable {
  /* A new solver; null after an internal error. */
  AmbMlcp *(*create)(void);
  /* Null is ignored. */
  void (*destroy)(AmbMlcp *solver);
  /* Removes all rows; memory is kept. */
  void (*clear)(AmbMlcp *solver);
  /* Kinetic energy of all bodies before the impulses, J; 0 after clear. */
  void (*set_energy)(AmbMlcp *solver, double energy);
  /* Index of the row, from 0; -1: a negative size, a missing pointer or an internal error. */
  int (*add_row)(AmbMlcp *solver, const AmbMlcpRow *row);
  /* Orders the rows. Bodies below `rigid` have 6 components of velocity; articulation i is body rigid + i and has sizes[i]. Returns the
   * multiplications that a factorisation of all rows would take; -1: a row names a body or row that does not exist, or has a Jacobian of
   * the wrong size; the problem cannot be solved then. */
  double (*prepare)(AmbMlcp *solver, int rigid, const int *sizes, int articulations);
  /* Finds the impulses for `target`. The budget is in multiplications: factorisations are made as long as they fit, what is left goes into
   * sweeps. Where no factorisation fits, at least four sweeps are made from the guess. Returns AMB_MLCP_SOLVED and so on. */
  int (*solve)(AmbMlcp *solver, double budget);
  /* Finds pseudo-impulses for correction velocities: `targets`, one a row, or null for the rows' position_target. `states` is the guess of the
   * active set, one a row; null: all free. Rows that can push both ways are unbounded here, unilateral ones have impulses >= 0 or
   * <= 0. CFM is cfm_share (such as 1e-4) of the diagonal, or the row's own if that is larger. */
  int (*solve_positions)(AmbMlcp *solver, const double *targets, const uint8_t *states, double cfm_share, double budget);
  /* Results of solve: impulses and states, one a row, and changes of velocity of all bodies, one after the other: rigid body b begins at 6 b,
   * articulations follow. All 0 before it. Pointers hold until the next prepare or destroy. */
  const double *(*impulses)(const AmbMlcp *solver);
  const uint8_t *(*states)(const AmbMlcp *solver);
  const double *(*velocities)(const AmbMlcp *solver);
  /* Results of solve_positions; position_errors: what they leave of the targets where a row could push that way, else 0. */
  const double *(*position_impulses)(const AmbMlcp *solver);
  const uint8_t *(*position_states)(const AmbMlcp *solver);
  const double *(*position_velocities)(const AmbMlcp *solver);
  const double *(*position_errors)(const AmbMlcp *solver);
  void (*statistics)(const AmbMlcp *solver, AmbMlcpStatistics *out);
} AmbMlcpTable;

#ifdef __cplusplus
}
#endif

#endif
