/* Ray casts against convex shapes and planes. */
#ifndef AMB_RAYS_H
#define AMB_RAYS_H
#include "types.h"

/* Whether rays meet convex shapes and planes where these are, independently of their size. Bullet's own casts against
   convex shapes have tolerances of up to 1 cm, see rays.cpp. */
void amb_world_set_exact_rays(AmbWorld *world, int enabled);

#endif
