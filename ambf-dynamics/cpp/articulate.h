/* Trees of hinges, sliders, fixed constraints and springs about or along one axis in reduced coordinates. */
#ifndef AMB_ARTICULATE_H
#define AMB_ARTICULATE_H
#include "types.h"

/* Makes the n constraints, which are in the world, the joints of one tree: each must have one end on the base or the end of a constraint
   before it, and its other end on a body that the tree has not reached yet, which becomes a link. The n_springs springs each lie between
   the two bodies of one of these hinges or sliders, and act about or along its axis. A base without mass is fixed and may
   carry several trees; else it is part of this one. Nothing else may hold the links, or the base if it is free.
   Links are set to poses and velocities that the joints allow, next to what they were. All calls on the bodies and constraints go on to
   work: wrenches, gravity, damping, poses and velocities, readings, motors, limits and feedback.
   Null where reduced coordinates don't serve: the world was not made for trees, a body cannot turn about all axes, is more than 2 cm or
   0.05 rad off its joint, or a spring has another axis than its joint. */
AmbArticulation *amb_world_articulate(AmbWorld *world, AmbBody *base, AmbConstraint *const *joints, int n,
                              AmbConstraint *const *springs, int n_springs);
/* Puts bodies and constraints back into the world, each with its present pose and velocity, and frees the tree. */
void amb_world_dissolve(AmbWorld *world, AmbArticulation *articulation);

#endif
