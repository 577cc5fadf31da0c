/* Continuous collision detection; off by default. */
#ifndef AMB_CONTINUOUS_H
#define AMB_CONTINUOUS_H
#include "types.h"

/* Enables continuous collision detection for a body: when it moves further in a sub-step than the radius of its
   inscribed sphere, the sphere is swept and the body stops at the first impact. Returns 0 when the shape has no
   inscribed sphere: it is concave, or its centre of mass is outside. Slow bodies cause no cost. */
int amb_world_set_continuous(AmbWorld *world, AmbBody *body, int enabled);

#endif
