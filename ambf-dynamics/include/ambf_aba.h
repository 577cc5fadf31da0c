/* Articulated-body algorithm: C interface of ambf-dynamics, src/aba/ffi.rs, where the functions are described.
 *
 * The C++ code that calls it is linked before the Rust library, and therefore uses a table of function pointers. SI units, world
 * axes. Vectors have four numbers as in Bullet, quaternions are x, y, z, w. */
#ifndef AMBF_ABA_H
#define AMBF_ABA_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Arrays have one element a body, the base first, `link` one a link. */
typedef struct AmbAbaTree {
  int links, coordinates, balls, has_fixed_base, splits_damping;
  const void *link, *body;
  double *rotations, *origins, *linear, *angular, *arms, *axes;
  void *work;
} AmbAbaTree;

typedef struct AmbAbaMotion {
  const double *rotation, *origin, *q, *balls;
  const double *angular, *linear, *rates;
} AmbAbaMotion;

typedef struct AmbAbaRates {
  double *angular, *linear, *q;
} AmbAbaRates;

/* What drives do to a coordinate: `inertia` is added to its articulated inertia, `pull` has been added to the force on it; or the
 * acceleration `given` is prescribed where `is_given` is 1. `force` is written: theirs in all. */
typedef struct AmbAbaDrive {
  double inertia, pull, is_given, given, force;
} AmbAbaDrive;

typedef struct AmbAbaTable {
  size_t work_size, link_size, body_size;
  void (*update_poses)(const AmbAbaTree *tree, const AmbAbaMotion *motion);
  void (*update_velocities)(const AmbAbaTree *tree, const AmbAbaMotion *motion);
  void (*accelerate)(const AmbAbaTree *tree, const AmbAbaMotion *motion, const double *efforts, AmbAbaDrive *drives, int is_placed,
                     const AmbAbaRates *out);
  void (*project)(const AmbAbaTree *tree, const double *wanted_linear, const double *wanted_angular, const double *efforts,
                  const AmbAbaRates *out);
  void (*factor)(const AmbAbaTree *tree, double *factor, double *inverse_diagonal);
  void (*add_jacobian)(const AmbAbaTree *tree, int body, const double *force, const double *torque, int of_joint_only,
                       double *row);
} AmbAbaTable;

#ifdef __cplusplus
}
#endif

#endif
