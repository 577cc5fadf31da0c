/* Motion of articulations: C interface of ambf-dynamics, src/aba/ffi.rs, where the functions are described.
 *
 * The C++ code that calls it is linked before the Rust library, and therefore uses a table of function pointers. SI units, world
 * axes. Vectors have four numbers as in Bullet, quaternions are x, y, z, w. */
#ifndef AMBF_ABA_H
#define AMBF_ABA_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Of the beginning of the latest step: energies in J, the largest angular velocity in rad/s, and the velocity of the base. */
typedef struct AmbAbaState {
  double start_energy, start_elastic_energy, start_rotation, start_carrying_power, start_centrifugal_energy, stiffness;
  double start_angular[4], start_linear[4];
  int steps_until_probe, has_mode, splits_damping, by_euler, coupling_rows, has_subspaces;
} AmbAbaState;

/* What drives do to a coordinate. */
typedef struct AmbAbaDriven {
  double inertia, pull, is_given, given, force;
} AmbAbaDriven;

/* Arrays have one element a body, the base first, `link` one a link. */
typedef struct AmbAbaTree {
  int links, coordinates, balls, has_fixed_base, springs, couplings, distant_limits, drive_places;
  const void *link, *body;
  double *rotations, *origins, *linear, *angular, *arms, *axes;
  void *work;
  const void *spring, *coupled;
  const int *coupling_ends, *parents;
  double *factor, *inverse_diagonal, *coupling_row, *rows;
  void *drive;
  int *drives;
  const void *distant;
  AmbAbaDriven *driven;
  int *given_by;
  double *rest, *forces, *numbers, *vectors, *quaternions;
  AmbAbaState *state;
} AmbAbaTree;

typedef struct AmbAbaPosition {
  double *rotation, *origin, *q, *balls;
} AmbAbaPosition;

typedef struct AmbAbaRates {
  double *angular, *linear, *q;
} AmbAbaRates;

typedef struct AmbAbaTable {
  size_t work_size, link_size, body_size, spring_size, drive_size, distant_size, state_size;
  size_t numbers, vectors, quaternions;
  void (*update_poses)(const AmbAbaTree *tree, const AmbAbaPosition *at);
  void (*update_velocities)(const AmbAbaTree *tree, const AmbAbaRates *rate);
  void (*accelerate)(const AmbAbaTree *tree, const AmbAbaPosition *at, const AmbAbaRates *rate, const AmbAbaRates *out);
  void (*step)(const AmbAbaTree *tree, double h, const AmbAbaPosition *from, const AmbAbaRates *rate, const AmbAbaPosition *to,
               const AmbAbaRates *new_rate);
  double (*tangential_step)(const AmbAbaTree *tree, double h, const AmbAbaPosition *from, const AmbAbaRates *rate,
                            const AmbAbaPosition *to, const AmbAbaRates *new_rate);
  void (*project)(const AmbAbaTree *tree, const double *linear, const double *angular, const AmbAbaRates *rate);
  void (*bound_rotation)(const AmbAbaTree *tree, const AmbAbaRates *rate, double most);
  void (*advance_position)(const AmbAbaTree *tree, const AmbAbaPosition *at, double h, const AmbAbaRates *rate);
  void (*factor)(const AmbAbaTree *tree);
  double (*response)(const AmbAbaTree *tree, int coordinate);
  void (*normalise)(const AmbAbaTree *tree, double *row);
  void (*rates_of)(const AmbAbaTree *tree, const double *z, const AmbAbaRates *rate);
  void (*coordinates_of)(const AmbAbaTree *tree, const AmbAbaRates *rate, double *z);
  void (*add_jacobian)(const AmbAbaTree *tree, int body, const double *force, const double *torque, int of_joint_only,
                       double *row);
  double (*kinetic_energy)(const AmbAbaTree *tree);
  double (*internal_energy)(const AmbAbaTree *tree);
  double (*mass)(const AmbAbaTree *tree);
  void (*mass_centre)(const AmbAbaTree *tree, double *out);
  void (*momentum)(const AmbAbaTree *tree, const double *about, double *out);
  void (*set_momentum)(const AmbAbaTree *tree, const double *momentum, const double *about, const AmbAbaRates *rate);
  void (*scale_internal_velocity)(const AmbAbaTree *tree, double share, const AmbAbaRates *rate);
  double (*fastest_rotation)(const AmbAbaTree *tree, const AmbAbaRates *rate);
  double (*work_at_rate)(const AmbAbaTree *tree, double h, const AmbAbaPosition *at, const AmbAbaRates *rate);
} AmbAbaTable;

#ifdef __cplusplus
}
#endif

#endif
