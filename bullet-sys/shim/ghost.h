/* Ghosts: volumes that detect overlapping bodies without contact forces. */
#ifndef AMB_GHOST_H
#define AMB_GHOST_H
#include "types.h"

/* The caller keeps ownership of the shape, which must outlive the ghost. */
AmbGhost *amb_ghost_new(AmbShape *shape, const double pose[12]);
/* The ghost must have been removed from its world. */
void amb_ghost_free(AmbGhost *ghost);
void amb_world_add_ghost(AmbWorld *world, AmbGhost *ghost, AmbHandle handle);
void amb_world_remove_ghost(AmbWorld *world, AmbGhost *ghost);
void amb_ghost_set_pose(AmbGhost *ghost, const double pose[12]);
/* The ghost does not detect the body from now on. The test takes constant time. */
void amb_world_ignore_ghost(AmbWorld *world, AmbGhost *ghost, AmbBody *body);
/* Handles of the bodies that overlapped the ghost in the last sub-step, one entry per contact point of negative
   distance. Writes up to `capacity` handles and returns the number of all. */
int amb_ghost_overlaps(AmbWorld *world, AmbGhost *ghost, AmbHandle *out, int capacity);

#endif
