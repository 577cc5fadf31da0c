/* Rigid bodies. Positions, velocities, forces in world axes at the centre of mass; SI units. */
#ifndef AMB_BODY_H
#define AMB_BODY_H
#include "types.h"

/* A body sleeps only in a world with amb_world_enable_sleeping. The caller keeps ownership of the shape, which must
   outlive the body. mass in kg, 0: static; inertia: principal moments, kg m^2. */
AmbBody *amb_body_new(double mass, const double inertia[3], AmbShape *shape, const double pose[12]);
/* The body must have been removed from its world, and so must every constraint on it. */
void amb_body_free(AmbBody *body);

/* Bodies of one family, unless it is 0, never collide with each other; neither do two bodies that are both in groups, of
   which none is common. groups: n numbers, ascending. To be called before the body is added to a world. */
void amb_body_set_apart(AmbBody *body, unsigned family, const unsigned *groups, int n);

/* Two bodies of one model, a number above 0, never collide if they are of one cluster, if one is of the cluster `outer` of the
   other (0: none), if neither's kind has a bit in common with the other's affinity, or if one lists the other's member number
   among the n excluded ones; they do whatever else is said if both list each other among the m included ones. Both lists are
   ascending. To be called before the body is added to a world. */
void amb_body_set_filter(AmbBody *body, unsigned model, unsigned member, unsigned cluster, unsigned outer, unsigned kind,
                         unsigned affinity, const unsigned *excluded, int n, const unsigned *included, int m);

/* Contacts that are there already get the new coefficients, too. */
void amb_body_set_surface(AmbBody *body, double friction, double rolling_friction, double restitution);
void amb_body_set_damping(AmbBody *body, double linear, double angular);
/* Mass above 0, kg, and principal moments of inertia, kg m^2, of a body that is not static; its velocities stay. */
void amb_body_set_mass(AmbBody *body, double mass, const double inertia[3]);
/* m/s^2. To be called after the body was added to a world, which sets the world's gravity. */
void amb_body_set_gravity(AmbBody *body, const double gravity[3]);
void amb_body_apply_wrench(AmbBody *body, const double force[3], const double torque[3]);
void amb_body_clear_forces(AmbBody *body);
void amb_body_set_velocity(AmbBody *body, const double linear[3], const double angular[3]);
/* Sets world transform, interpolation transform and motion state. A static body is at rest afterwards. */
void amb_body_set_pose(AmbBody *body, const double pose[12]);
/* Moves a static body to a pose over the next sub-step: until then it has this linear (3, m/s) and angular (3, rad/s)
   velocity in contacts and joints. It keeps the velocity after the sub-step, until it is moved again, set or brought to
   rest; without a next call it does not move. No effect on other bodies, and on bodies in no world. */
void amb_body_move(AmbBody *body, const double pose[12], const double velocity[6]);
/* Ends the motion of a static body: its velocity is 0. */
void amb_body_rest(AmbBody *body);
/* At rest at a pose, with the gravity (m/s^2; null: the world's), and with no memory of what acted on the body. The broad
   phase and contacts follow with amb_world_recover. */
void amb_body_reset(AmbBody *body, const double pose[12], const double *gravity);
/* True world transform of the inertial frame, not interpolated. */
void amb_body_pose(const AmbBody *body, double pose[12]);
/* Pose from the motion state. */
void amb_body_motion_state(const AmbBody *body, double pose[12]);
void amb_body_velocity(const AmbBody *body, double velocity[6]);

/* Reads n bodies into out (n x 18): pose from the motion state (12), linear (3) and angular (3) velocity. Rows of null
   entries are not written. */
void amb_bodies_read(AmbBody *const *bodies, int n, double *out);
/* Index of the first body whose pose or velocity is not finite, or, unless it is static, whose speed exceeds `speed`
   (m/s, rad/s) or whose centre of mass is farther than `distance` (m) from the origin; -1 if there is none. Null
   entries are skipped. */
int amb_bodies_first_lost(AmbBody *const *bodies, int n, double speed, double distance);

#endif
