/* Joints that have the rows of exact_rows.h in worlds of AmbSolver_Accurate; elsewhere those of Bullet. */
#ifndef AMB_EXACT_JOINTS_H
#define AMB_EXACT_JOINTS_H
#include "types.h"

/* As the functions of bullet-sys without `exact`. The functions for their constraints apply to these. */
AmbConstraint *amb_exact_fixed_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
AmbConstraint *amb_exact_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
AmbConstraint *amb_exact_six_dof_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);

#endif
