/* Solver of mixed linear complementarity problems of islands of constraints: C interface of ambf-dynamics,
 * src/mlcp/ffi.rs.
 *
 * The C++ code that calls it is linked before the Rust library, and therefore uses a table of function pointers. SI
 * units.
 *   w = (J M^-1 J^T + diag(cfm)) x - target
 *   low < x < high: w = 0;   x = low: w >= 0;   x = high: w <= 0
 *
 * Order of calls: clear, add_row for every row, prepare; then solve, solve_positions or both, and reading out. Results
 * depend on the rows and the budget only, not on earlier problems. A solver must not be used by two threads at once;
 * different ones may be. */
#ifndef AMBF_MLCP_H
#define AMBF_MLCP_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct AmbMlcp AmbMlcp;

/* Active set: the impulse is between its bounds, at the lower or at the upper one. */
enum { AMB_MLCP_FREE = 0, AMB_MLCP_LOW = 1, AMB_MLCP_HIGH = 2 };

/* Accuracy of a solution. */
enum {
  /* Complementarity holds to 1e-6 of the largest target. */
  AMB_MLCP_SOLVED = 0,
  /* The impulses are within their bounds but not a solution; the residual is in the statistics. */
  AMB_MLCP_APPROXIMATE = 1,
  /* A number is not finite, the problem was not prepared, or an internal error. All impulses and velocities are 0. */
  AMB_MLCP_NOT_FINITE = 2
};

/* One scalar constraint J v + cfm x = target on the change v of velocities by the impulse x. */
typedef struct AmbMlcpRow {
  /* Index of the body of each side: rigid bodies first, then articulations; -1: static or none, its other members are
     not read. */
  int body[2];
  /* Components of each side's velocity: 6 for a rigid body (linear, angular), n for an articulation. */
  int size[2];
  /* Row of the Jacobian, and change of velocity by a unit impulse M^-1 J^T, of each side: `size` numbers, copied by
     add_row. */
  const double *jacobian[2];
  const double *response[2];
  /* Target of J v + cfm x; velocity bias: the part of the target by which J v after the impulses is to differ from 0,
   * such as that of restitution, which is omitted where it adds energy; and target of solve_positions, m/s or rad/s. */
  double target, bias, position_target;
  /* Constraint force mixing, 1/kg or 1/(kg m^2), >= 0; and that in solve_positions if it is larger. */
  double cfm, position_cfm;
  /* Least CFM by which a drive yields to joints, for a yielding of 1; 0: it does not. */
  double yielding_cfm;
  /* Impulse of a drive that is part of the motion before the impulses; what yields is its sum with that of the row. */
  double fed;
  /* Bounds of the impulse, N s or N m s; beyond 1e9 there are none. Friction replaces them. */
  double low, high;
  /* Row of the normal impulse for friction: the bounds are +-min(friction max(normal impulse, 0), cap); -1: no
     friction. */
  int normal;
  double friction, cap;
  /* Guess of the active set and of the impulse (warm start). */
  int state;
  double x;
  /* Whether the row takes part in solve_positions; rows of friction never do. A drive that does, such as a spring, resists. */
  int in_positions;
  /* Whether it stays closed in solve_positions where the last solve gave it an impulse: a loaded limit. */
  int stays_loaded;
  /* Whether the row is a drive, which may do work. */
  int is_drive;
} AmbMlcpRow;

/* Counters of the last solution. */
typedef struct AmbMlcpStatistics {
  uint32_t rows, factorisations;
  /* Changes of the active set, summed over all iterations. */
  uint32_t pivots;
  /* Sweeps of projected Gauss-Seidel. */
  uint32_t sweeps;
  double multiplications;
  /* Largest violation of complementarity of the result, m/s or rad/s; infinite for AMB_MLCP_NOT_FINITE. */
  double residual;
  /* For set_guess_tolerance before the next problem of the same bodies. */
  double guess_tolerance;
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
  /* Residual up to which the guess is accepted as the solution, as a share of the largest target: guess_tolerance of the
   * last solve of the same bodies; 0, as after clear: the default. */
  void (*set_guess_tolerance)(AmbMlcp *solver, double share);
  /* Index of the row, from 0; -1: a negative size, a missing pointer or an internal error. */
  int (*add_row)(AmbMlcp *solver, const AmbMlcpRow *row);
  /* Orders the rows. Bodies below `rigid` have 6 velocity components; articulation i is body rigid + i and has
   * sizes[i]. Returns the number of multiplications of a factorisation of all rows; -1: a row refers to a body or row
   * that does not exist, or has a Jacobian of the wrong size, and the problem cannot be solved. */
  double (*prepare)(AmbMlcp *solver, int rigid, const int *sizes, int articulations);
  /* Solves for the impulses. CFM is at least `yielding` times the row's yielding_cfm. The budget is in multiplications: it
   * is used for factorisations first, then for sweeps. If no factorisation fits, at least four sweeps are made from the
   * guess. Returns AMB_MLCP_SOLVED and so on. */
  int (*solve)(AmbMlcp *solver, double yielding, double budget);
  /* Solves for pseudo-impulses of the position correction: `targets`, one per row, or null for the rows'
   * position_target. `states` is the guess of the active set, one per row; null: all free. Bilateral rows are unbounded
   * here, unilateral rows have impulses >= 0 or <= 0. CFM is cfm_share (such as 1e-4) of the diagonal, or the row's
   * position_cfm if that is larger, times `damping`; or the row's cfm if that is larger. That of a drive is its
   * position_cfm, if it has one. */
  int (*solve_positions)(AmbMlcp *solver, const double *targets, const uint8_t *states, double cfm_share,
                         double damping, double budget);
  /* Results of solve: impulses and states, one per row, and the changes of velocity of all bodies: rigid body b from
   * index 6 b on, then the articulations. All are 0 before the first solve. Pointers are valid until the next prepare
   * or destroy. */
  const double *(*impulses)(const AmbMlcp *solver);
  const uint8_t *(*states)(const AmbMlcp *solver);
  const double *(*velocities)(const AmbMlcp *solver);
  /* Results of solve_positions. position_errors: target - J v for rows that can push in this direction, else 0. */
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
