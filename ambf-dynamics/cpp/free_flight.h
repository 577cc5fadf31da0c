// Motion of bodies on which nothing acts but forces known in advance. C++ only.
#ifndef AMB_FREE_FLIGHT_H
#define AMB_FREE_FLIGHT_H

#include "internal.h"

// Before a sub-step: keeps the state of all dynamic bodies.
void save_sub_step_starts(AmbWorld &world);
// After a sub-step of h s: moves a body that neither touches anything nor is held from its state before, by the exact solution for a
// constant force with damping, and turns it by Runge-Kutta of fourth order. False: something else acted on it, and it stays where Bullet
// moved it.
bool integrate_free_body(btRigidBody &body, const SubStepStart &start, btScalar h);

#endif
