/* Sleeping bodies, and static bodies whose bounding boxes are not updated. */
#ifndef AMB_SLEEPING_H
#define AMB_SLEEPING_H
#include "types.h"

/* Updates AABBs of static bodies only when their pose is set, not in every sub-step. This changes the order of pairs,
   and hence the order of contact rows in the solver. */
void amb_world_freeze_static_aabbs(AmbWorld *world);
/* The bodies of an island fall asleep together once all of them have been slow for 2 s: slower than `slow`, m/s and
   rad/s, or slower than `resting` if nothing but contacts can carry them: no constraint acts on them, and they would
   fall faster. Stacked bodies never come to rest completely under Bullet's iterative solvers. A body wakes up, with the bodies that it touches, when its pose, velocity, force, motor or constraints are
   changed through this interface. Includes amb_world_freeze_static_aabbs. Not for worlds with soft bodies. */
void amb_world_enable_sleeping(AmbWorld *world, const double slow[2], const double resting[2]);
int amb_body_is_asleep(const AmbBody *body);

#endif
