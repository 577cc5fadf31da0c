/* Motion of free bodies. */
#ifndef AMB_FLIGHT_H
#define AMB_FLIGHT_H
#include "types.h"

/* How bodies without contacts and constraints move. */
enum AmbIntegrator {
  /* Bullet's semi-implicit Euler; that of a new world. */
  AmbIntegrator_Euler = 0,
  /* Exactly under constant force: Bullet's step x += v' dt is a a dt^2 / 2 too long. */
  AmbIntegrator_Ballistic = 1,
  /* Also exactly under damping, turning as Euler's equations say, by Runge-Kutta of fourth order. */
  AmbIntegrator_RungeKutta = 2
};

void amb_world_set_integrator(AmbWorld *world, int integrator);

#endif
