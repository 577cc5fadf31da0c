/* Articulations: kinematic trees of hinges, sliders, fixed constraints and one-axis springs in generalised coordinates.
 */
#ifndef AMB_ARTICULATE_H
#define AMB_ARTICULATE_H
#include "types.h"

/* Makes n constraints of the world the joints of one articulation. Each joint must connect the base, or the child of an
   earlier joint, to a body that is not part of the articulation yet; that body becomes a link. Each of the n_springs
   springs must act about or along the axis of one of these hinges or sliders, between the same two bodies. A static
   base is fixed and may carry several articulations; a dynamic base is part of this one. No other constraint may act on
   the links, or on a dynamic base. The poses and velocities of links are projected onto the joints. All functions of
   the bodies and constraints remain valid: wrenches, gravity, damping, poses and velocities, readings, motors, limits
   and feedback. Returns null if the world is not of kind AmbWorldKind_Articulated, a body has an infinite moment of
   inertia or is a link already, a body is more than 2 cm or 0.05 rad off its joint, or a spring has another axis than
   its joint. */
AmbArticulation *amb_world_articulate(AmbWorld *world, AmbBody *base, AmbConstraint *const *joints, int n,
                                      AmbConstraint *const *springs, int n_springs);
/* Frees the articulation. Its bodies and constraints become rigid bodies and constraints of the world again, with their
   present poses and velocities. */
void amb_world_dissolve(AmbWorld *world, AmbArticulation *articulation);

/* Whether sub-steps compute the reactions of joints with feedback in articulations, and of constraints on their links; else
   those of earlier sub-steps stay. Nothing else depends on it. Default: 1. */
void amb_world_set_reactions(AmbWorld *world, int enabled);

/* Brings objects, bodies and constraints of a world of kind AmbWorldKind_Articulated without articulations back to the order
   in which they were added, which these arrays lose when articulations come and go. The n constraints are those of the
   world, in that order; null entries are skipped. Couplings forget the motion. */
void amb_world_restore_order(AmbWorld *world, AmbConstraint *const *constraints, int n);

#endif
