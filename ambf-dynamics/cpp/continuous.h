/* Continuous collision detection, off for every body at first. */
#ifndef AMB_CONTINUOUS_H
#define AMB_CONTINUOUS_H
#include "types.h"

/* Whether a body that moves further in a sub-step than a sphere inside it is large stops where it hits something, instead of passing
   through what is thinner than its way. Returns 0 when the shape has no such sphere: it is concave, or its centre is outside. Costs
   nothing while the body is slow. */
int amb_world_set_continuous(AmbWorld *world, AmbBody *body, int enabled);

#endif
