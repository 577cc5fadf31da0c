/* Constraints between two bodies, which must outlive them. Frames are poses in the bodies' inertial frames. */
#ifndef AMB_CONSTRAINT_H
#define AMB_CONSTRAINT_H
#include "types.h"

/* The scalar that amb_constraints_read writes. */
enum AmbReading {
  AmbReading_None = 0,           /* 0 */
  AmbReading_HingeAngle = 1,     /* rad, within pi of the middle of the limits, without them of 0 */
  AmbReading_SliderPosition = 2, /* m, as of the last solver pass */
  AmbReading_AxisDistance = 3,   /* m, of frame B's origin along frame A's z axis */
  AmbReading_AxisAngle = 4       /* rad, of frame B about frame A's z axis */
};

AmbConstraint *amb_hinge_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
void amb_hinge_set_limit(AmbConstraint *hinge, double low, double high);
/* max_impulse in N m s a sub-step. */
void amb_hinge_set_motor(AmbConstraint *hinge, int enabled, double velocity, double max_impulse);

AmbConstraint *amb_slider_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
void amb_slider_set_limit(AmbConstraint *slider, double low, double high);
/* Locks the rotation about the axis. */
void amb_slider_lock_rotation(AmbConstraint *slider);
/* max_force in N. */
void amb_slider_set_motor(AmbConstraint *slider, int enabled, double velocity, double max_force);

AmbConstraint *amb_fixed_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
AmbConstraint *amb_point_to_point_new(AmbBody *a, AmbBody *b, const double pivot_a[3], const double pivot_b[3]);

/* Pulls a point of a body (in its inertial frame, m) towards a point of the world (m), with impulses of at most
   max_impulse N s a sub-step along each axis. */
AmbConstraint *amb_grip_new(AmbBody *body, const double pivot[3], const double goal[3], double max_impulse);
void amb_grip_set_goal(AmbConstraint *grip, const double goal[3]);

AmbConstraint *amb_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
void amb_cone_twist_set_limit(AmbConstraint *cone, double swing1, double swing2, double twist);

/* Linear limits in frame A. */
AmbConstraint *amb_six_dof_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
/* axis: 0-2 linear x y z, 3-5 angular x y z. low > high: free. */
void amb_six_dof_set_limit(AmbConstraint *six_dof, int axis, double low, double high);

/* Rotation order XYZ. */
AmbConstraint *amb_six_dof_spring_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]);
void amb_six_dof_spring_set_limit(AmbConstraint *spring, int axis, double low, double high);
void amb_six_dof_spring_set_spring(AmbConstraint *spring, int axis, int enabled, double stiffness, double damping);
void amb_six_dof_spring_set_equilibrium(AmbConstraint *spring, int axis, double equilibrium);

/* The constraint must have been removed from its world. */
void amb_constraint_free(AmbConstraint *constraint);
/* Bullet's constraint parameters; kind: 1 ERP, 2 STOP_ERP, 3 CFM, 4 STOP_CFM; axis -1 where the type has no axes. */
void amb_constraint_set_param(AmbConstraint *constraint, int kind, double value, int axis);
void amb_constraint_enable_feedback(AmbConstraint *constraint);
/* Force on A, torque on A, force on B, torque on B (12), world axes, of the last sub-step; zero without feedback. */
void amb_constraint_feedback(const AmbConstraint *constraint, double out[12]);

/* Forgets the impulses of the last sub-steps, and enables constraints that Bullet disabled because these were not finite.
   Null entries are skipped. */
void amb_constraints_recover(AmbConstraint *const *constraints, int n);
/* Updates the positions of sliders, which Bullet computes during the solver's pass only, to the present poses. Null
   entries are skipped. */
void amb_constraints_refresh(AmbConstraint *const *constraints, int n);
/* Reads one scalar per constraint into out (n x 1); readings: enum AmbReading. Entries of null constraints are not
   written. */
void amb_constraints_read(AmbConstraint *const *constraints, const unsigned char *readings, int n, double *out);

#endif
