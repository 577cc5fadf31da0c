/* Numbers of the contact and constraint solver, and of the motion of single bodies: plain get and set. */
#ifndef AMB_SETTINGS_H
#define AMB_SETTINGS_H
#include "types.h"

/* Bits of `mode` that are not set here stay as they are. Named as in Bullet's btContactSolverInfo; SI units, factors without unit. */
typedef struct AmbSolverSettings {
  int iterations;
  /* Islands are merged until they have so many constraints. */
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
/* Whether the broad phase remembers bounding boxes without the margin of 0.05 m that Bullet gives those of moving objects. The order in
   which pairs are found, and with it the order in which contacts are solved, depends on it. */
void amb_world_set_tight_bounds(AmbWorld *world, int enabled);
/* How the torque of a turning body's own momentum is integrated: an AmbGyroscopic. */
void amb_body_set_gyroscopic(AmbBody *body, int kind);

#endif
