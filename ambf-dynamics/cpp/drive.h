/* Soft motors and drives: rows of the constraint solver that act as implicit spring-dampers or velocity motors. */
#ifndef AMB_DRIVE_H
#define AMB_DRIVE_H
#include "types.h"

/* A hinge and a slider with a soft motor. The functions for constraints of amb_hinge_new and amb_slider_new apply to
   them too. Of all hinges and sliders only these may be given to the functions below and be joints of articulations. */
AmbConstraint *amb_driven_hinge_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
AmbConstraint *amb_driven_slider_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
/* A six-dof spring whose springs are integrated implicitly in worlds of AmbSolver_Accurate; otherwise as
   amb_six_dof_spring_new. */
AmbConstraint *amb_implicit_spring_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
/* Enables the row q' = velocity - softness * impulse of a hinge (rad/s) or slider (m/s); softness in rad/s per N m s or
   m/s per N s, |impulse| <= max_force * h, N m or N, in a sub-step of h s. Disables Bullet's motor. Returns 0 for constraints
   of other types. */
int amb_constraint_set_soft_motor(AmbConstraint *constraint, double velocity, double softness, double max_force);
/* Disables the row. */
void amb_constraint_clear_soft_motor(AmbConstraint *constraint);
/* Sets what resists the motion of a hinge or slider: the efforts -damping * rate and -armature * acceleration, N m or N, dry
   friction of at most `friction`, N m or N, and whatever keeps the rate within +-max_rate, rad/s or m/s. Returns 0 if it is a
   joint of an articulation that was made when there was no damping, and has no place for it. */
int amb_constraint_set_resistance(AmbConstraint *constraint, double damping, double armature, double friction,
                                  double max_rate);
/* Writes the coordinate of a hinge (rad, within pi of the middle of its limits, without them of 0) or slider (m) and its rate,
   from the present poses and velocities. Returns 0 for constraints of other types. */
int amb_constraint_coordinate(const AmbConstraint *constraint, double out[2]);
/* Writes what amb_constraints_read does after amb_constraints_refresh, rad or m, and the rates of hinges and of all joints
   of articulations, rad/s or m/s; 0 for the rates of other constraints. Where there is null nothing is written. */
void amb_constraints_observe(AmbConstraint *const *constraints, const unsigned char *readings, int n, double *coordinates,
                             double *rates);

/* Six rows v = velocity - softness * impulse for the centre of mass of a body: linear (m/s), then angular (rad/s),
   world axes; softness of the linear (1/kg) and of the angular rows (1/(kg m^2)). */
void amb_body_set_drive(AmbWorld *world, AmbBody *body, const double velocity[6], const double softness[2]);
/* Disables these rows. */
void amb_body_clear_drive(AmbBody *body);
/* Sets the velocity of a dynamic body so that it has this velocity at the end of a sub-step of dt s in which only
   gravity acts on it. */
void amb_body_hold_velocity(AmbWorld *world, AmbBody *body, const double linear[3], const double angular[3], double dt);

#endif
