/* Parameters of the contact and constraint solver, and of the motion of single bodies: plain getters and setters. */
#ifndef AMB_SETTINGS_H
#define AMB_SETTINGS_H
#include "types.h"

/* Named as in Bullet's btContactSolverInfo; SI units, factors are dimensionless. Bits of m_solverMode without a member
   here are not changed. */
typedef struct AmbSolverSettings {
  int iterations;
  /* Islands are solved together until they have this number of constraints. */
  int minimum_batch_size;
  /* Bullet's erp and erp2. */
  double joint_erp, contact_erp;
  double global_cfm;
  double friction_erp, friction_cfm;
  double linear_slop;
  double damping, over_relaxation;
  double residual_threshold;
  double restitution_velocity_threshold;
  double warm_starting_factor;
  double split_impulse_penetration_threshold, split_impulse_turn_erp;
  /* 0 or 1. */
  int split_impulse;
  int warm_starting;
  int two_friction_directions;
  int friction_direction_caching;
  int velocity_dependent_friction_direction;
  int interleave_friction;
  int implicit_friction_cone;
  int randomise_order;
} AmbSolverSettings;

enum AmbGyroscopic {
  AmbGyroscopic_None = 0,
  AmbGyroscopic_Explicit = 1,
  AmbGyroscopic_ImplicitWorld = 2,
  AmbGyroscopic_ImplicitBody = 3
};

void amb_world_get_settings(const AmbWorld *world, AmbSolverSettings *settings);
void amb_world_set_settings(AmbWorld *world, const AmbSolverSettings *settings);
/* Whether the broad phase stores AABBs without the margin of 0.05 m that Bullet adds for moving objects. This changes
   the order of pairs, and hence the order of contact rows in the solver. */
void amb_world_set_tight_bounds(AmbWorld *world, int enabled);
/* Integration of the gyroscopic torque -w x (I w); kind: enum AmbGyroscopic. */
void amb_body_set_gyroscopic(AmbBody *body, int kind);

#endif
