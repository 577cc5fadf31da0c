// Integration of bodies on which only constant forces and damping act. C++ only.
#ifndef AMB_FREE_FLIGHT_H
#define AMB_FREE_FLIGHT_H

#include "internal.h"

// Stores the state of all dynamic bodies at the beginning of a sub-step.
void save_sub_step_starts(AmbWorld &world);
// After a sub-step of h s: replaces Bullet's new state of a body without contacts and constraints by the exact solution
// of the linear motion under constant force and damping, and by a Runge-Kutta solution of the rotation. Returns false,
// and leaves Bullet's state, if something else acted on the body.
bool integrate_free_body(btRigidBody &body, const SubStepStart &start, btScalar h);

#endif
