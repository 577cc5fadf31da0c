// Bound on the turn of jointed bodies in a sub-step. C++ only.
//
// Bodies move along tangents, so that a turn of theta opens a joint by theta^2 / 2 times its lever arm. Sub-steps are
// divided for that, into a limited number of parts (`step.rs` of ambf-core). Where bodies turn faster still, joints would
// open by more than their lever arms, and no linear correction closes them again. Nor is the velocity meaningful: it is
// that of a mechanism in a configuration which it has left. The velocities of all bodies that joints connect, relative to
// their common centre of mass or, if a joint holds one of them to the ground, in the world, are then multiplied by the
// factor that bounds the turn. They keep satisfying the equations of the joints, which are homogeneous, the momentum of
// a free mechanism does not change, and kinetic energy can only fall.
#ifndef AMB_TURN_LIMIT_H
#define AMB_TURN_LIMIT_H
#include "engine.h"

// Bounds the turns of jointed bodies in the next h s. Joints of articulations do not count.
void limit_turns(EngineWorld &engine, btScalar h);

#endif
