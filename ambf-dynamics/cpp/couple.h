/* Couplings: the coordinate of a hinge or slider is a linear function of those of others. */
#ifndef AMB_COUPLE_H
#define AMB_COUPLE_H
#include "types.h"

typedef struct AmbCoupling AmbCoupling;

/* Couples joints of the world, which are those of drive.h and no joints of an articulation: the coordinate of the first, the
   follower, is the sum of the factors times the coordinates of the others, its leaders, plus the offset; rad and m. There are
   n >= 2 joints, and the first of the n factors does not count. A joint is the follower of one coupling at most, and of none
   whose leaders follow it; a coupling is added after those whose follower leads it. Within one articulation it is part of the
   equations of motion; elsewhere it is a row of the constraint solver. */
AmbCoupling *amb_world_couple(AmbWorld *world, AmbConstraint *const *joints, const double *factors, int n, double offset);
/* Frees the coupling, which is of no articulation. To be called before its joints are removed. */
void amb_world_uncouple(AmbWorld *world, AmbCoupling *coupling);
/* By how much the coordinate of the follower exceeds what the others ask for at the present poses, rad or m. */
double amb_coupling_error(const AmbCoupling *coupling);

#endif
