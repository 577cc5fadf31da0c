/* Integration of free bodies: bodies without contacts, constraints and drives. */
#ifndef AMB_FLIGHT_H
#define AMB_FLIGHT_H
#include "types.h"

/* Integrator of free bodies. */
enum AmbIntegrator {
  /* Bullet's semi-implicit Euler method. Default. */
  AmbIntegrator_Euler = 0,
  /* Exact positions under constant acceleration a: Bullet's x += v' dt is too long by a dt^2 / 2. */
  AmbIntegrator_Ballistic = 1,
  /* Exact velocities and positions under constant force and damping; Euler's equations of rotation by the classical
     Runge-Kutta method. */
  AmbIntegrator_RungeKutta = 2
};

void amb_world_set_integrator(AmbWorld *world, int integrator);

/* Whether articulations are integrated by the semi-implicit Euler method instead of the classical Runge-Kutta method.
   Default: 0. */
void amb_world_set_trees_by_euler(AmbWorld *world, int by_euler);

#endif
