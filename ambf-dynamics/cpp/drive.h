/* Implicit drives: rows of the constraint solver that stand for a spring and a damper, a velocity or a pose. */
#ifndef AMB_DRIVE_H
#define AMB_DRIVE_H
#include "types.h"

/* A hinge and a slider that can be driven; otherwise as amb_hinge_new and amb_slider_new, whose functions are for these too. Only they may
   be given to the functions below, and be joints of articulations. */
AmbConstraint *amb_driven_hinge_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
AmbConstraint *amb_driven_slider_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
/* A six-dof spring whose springs are implicit in worlds of AmbSolver_Accurate; otherwise as amb_six_dof_spring_new. */
AmbConstraint *amb_implicit_spring_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
/* Adds the row q' = velocity - softness * impulse to a hinge (rad/s) or slider (m/s); softness in rad/s per N m s or m/s per N s,
   |impulse| <= max_impulse, N m s or N s a sub-step. Switches Bullet's own motor off. 0: the constraint is of another type. */
int amb_constraint_set_soft_motor(AmbConstraint *constraint, double velocity, double softness, double max_impulse);
/* Takes the row away. */
void amb_constraint_clear_soft_motor(AmbConstraint *constraint);
/* Coordinate of a hinge (rad, in [-pi, pi]) or slider (m) and its rate, both of the present poses and velocities. 0: another type. */
int amb_constraint_coordinate(const AmbConstraint *constraint, double out[2]);

/* Six rows v = velocity - softness * impulse for the centre of mass of a body: linear (m/s), then angular (rad/s), world axes;
   softness of the linear (1/kg) and of the angular rows (1/(kg m^2)). */
void amb_body_set_drive(AmbWorld *world, AmbBody *body, const double velocity[6], const double softness[2]);
/* Takes them away. */
void amb_body_clear_drive(AmbBody *body);
/* Gives a dynamic body the velocity that it has at the end of a sub-step of dt s if only gravity acts on it. */
void amb_body_hold_velocity(AmbWorld *world, AmbBody *body, const double linear[3], const double angular[3], double dt);

#endif
