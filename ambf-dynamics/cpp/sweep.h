// Continuous collision detection. C++ only.
//
// Bullet's own looks at bodies with a convex shape only, ignores impacts shallower than 4 cm, stops up to 1 mm before what is hit and
// lets bodies that fly towards each other pass. Here a sphere inside the body is swept along the way of the sub-step, relative to what is
// met; a body that would hit something ends the sub-step there, with its velocity, and the next sub-step finds the contact as usual.
#ifndef AMB_SWEEP_H
#define AMB_SWEEP_H
#include "engine.h"

// Finds the bodies among `bodies` that hit something within dt, into engine.impacts.
void find_impacts(EngineWorld &engine, const btAlignedObjectArray<btRigidBody *> &bodies, btScalar dt);
// Puts them where they hit it.
void stop_at_impacts(EngineWorld &engine);

#endif
