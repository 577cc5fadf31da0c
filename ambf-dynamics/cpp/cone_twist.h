/* Cone-twist joints whose limit of the twist acts along the gradient of the twist. */
#ifndef AMB_CONE_TWIST_H
#define AMB_CONE_TWIST_H
#include "types.h"

/* A cone-twist joint. In worlds of AmbSolver_Accurate the row of its twist limit acts along the gradient of the twist;
   otherwise as amb_cone_twist_new. The functions for constraints of amb_cone_twist_new apply to it. */
AmbConstraint *amb_exact_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);

#endif
