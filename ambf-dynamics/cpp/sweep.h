// Continuous collision detection. C++ only.
//
// Bullet's continuous collision detection handles bodies with a convex shape only, ignores impacts shallower than 4 cm,
// stops up to 1 mm before the obstacle and misses collisions of two fast bodies. Here a sphere inside the body is swept
// along its displacement relative to each obstacle. A body that hits an obstacle stays there for the rest of this
// sub-step, moves on with it where it moves, and keeps its velocity; the next sub-step finds the contact as usual. All
// bodies that joints hold to it stop at the same time.
#ifndef AMB_SWEEP_H
#define AMB_SWEEP_H
#include "engine.h"

// Finds the bodies that hit an object within dt s and stores them in engine.impacts.
void find_impacts(EngineWorld &engine, const btAlignedObjectArray<btRigidBody *> &bodies, btScalar dt);
// Moves these bodies to their poses at the impact.
void stop_at_impacts(EngineWorld &engine);

#endif
