/* Joints that have the rows of exact_rows.h in worlds of AmbSolver_Accurate; elsewhere those of Bullet. */
#ifndef AMB_EXACT_JOINTS_H
#define AMB_EXACT_JOINTS_H
#include "types.h"

/* As the functions of bullet-sys without `exact`. The functions for their constraints apply to these. */
AmbConstraint *amb_exact_fixed_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
AmbConstraint *amb_exact_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
AmbConstraint *amb_exact_six_dof_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
/* Of each frame only the origin counts. */
AmbConstraint *amb_exact_point_to_point_new(AmbBody *a, AmbBody *b, const double frame_a[12],
                                            const double frame_b[12]);

/* Rows of a joint that are left out in worlds of AmbSolver_Accurate. */
typedef struct AmbOmittedRows {
  /* Joint frames in the inertial frames of A and B. */
  double frame_a[12], frame_b[12];
  /* Axes of the linear rows, unit vectors one after the other, in the joint frame on body `side` (0: A, 1: B). The first of
   * a slider is its axis. */
  double axes[9];
  int side;
  /* 0 or 1: which rows along those axes, and about the axes of the joint frame on A, are left out. */
  int linear[3], angular[3];
  /* Position errors from which on these rows hold nevertheless, m and rad. */
  double linear_clearance, angular_clearance;
} AmbOmittedRows;

/* Leaves rows out of a hinge, slider, ball joint or cone-twist joint; all 0: none. Returns 0 for a constraint whose rows are
 * Bullet's. */
int amb_constraint_omit_rows(AmbConstraint *constraint, const AmbOmittedRows *rows);

#endif
