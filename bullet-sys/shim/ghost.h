/* Ghosts: volumes that sense what overlaps them and touch nothing. */
#ifndef AMB_GHOST_H
#define AMB_GHOST_H
#include "types.h"

/* The shape stays the caller's and must outlive the ghost. */
AmbGhost *amb_ghost_new(AmbShape *shape, const double pose[12]);
/* The ghost must have been removed from its world. */
void amb_ghost_free(AmbGhost *ghost);
void amb_world_add_ghost(AmbWorld *world, AmbGhost *ghost, AmbHandle handle);
void amb_world_remove_ghost(AmbWorld *world, AmbGhost *ghost);
void amb_ghost_set_pose(AmbGhost *ghost, const double pose[12]);
/* The ghost does not sense the body from now on; found in constant time. */
void amb_world_ignore_ghost(AmbWorld *world, AmbGhost *ghost, AmbBody *body);
/* Handles of the bodies that overlap it as of the last sub-step, one entry a contact point of negative distance. Writes up to capacity
   and returns how many there are. */
int amb_ghost_overlaps(AmbWorld *world, AmbGhost *ghost, AmbHandle *out, int capacity);

#endif
