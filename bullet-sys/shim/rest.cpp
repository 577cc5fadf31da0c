#include "internal.h"

namespace {

struct Waker : btBroadphaseAabbCallback {
  bool process(const btBroadphaseProxy *proxy) override {
    static_cast<btCollisionObject *>(proxy->m_clientObject)->activate();
    return true;
  }
};

void set_all(AmbWorld &world) {
  btCollisionObjectArray &objects = world.world->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    if (AmbBody *body = body_of(objects[i])) set_activity(world, *body);
  }
}

}  // namespace

void set_activity(AmbWorld &world, AmbBody &owner) {
  btRigidBody &body = owner.body;
  if (body.isStaticObject()) {
    if (world.rests) body.forceActivationState(ISLAND_SLEEPING);
  } else if (world.sleeps && owner.restless == 0) {
    body.setSleepingThresholds(world.sleeps_below[0], world.sleeps_below[1]);
    body.setDeactivationTime(0);
    body.forceActivationState(ACTIVE_TAG);
  } else {
    body.forceActivationState(DISABLE_DEACTIVATION);
  }
}

void wake_around(AmbWorld &world, const AmbBody &owner) {
  if (!world.sleeps) return;
  const btBroadphaseProxy &proxy = *owner.collider->getBroadphaseHandle();
  Waker waker;
  world.broadphase.aabbTest(proxy.m_aabbMin, proxy.m_aabbMax, waker);
  for (int i = 0; i < world.world->getNumConstraints(); ++i) {
    btTypedConstraint &constraint = *world.world->getConstraint(i);
    btRigidBody &a = constraint.getRigidBodyA(), &b = constraint.getRigidBodyB();
    if (&a == &owner.body || &b == &owner.body) {
      a.activate();
      b.activate();
    }
  }
}

void place(AmbWorld &world, AmbBody &owner, const btTransform &pose) {
  btRigidBody &body = owner.body;
  const bool moves = !(body.getWorldTransform() == pose);
  if (moves) wake_around(world, owner);
  const bool is_link = world.extension && world.extension->pose_set(owner);
  body.setWorldTransform(pose);
  owner.motion.setWorldTransform(pose);
  // A link follows in the next sub-step, and is never at rest.
  if (!moves || !world.rests || is_link) return;
  world.world->updateSingleAabb(&body);
  wake_around(world, owner);
}

extern "C" {

void amb_world_rest_static(AmbWorld *world) {
  world->rests = true;
  world->world->setForceUpdateAllAabbs(false);
  set_all(*world);
}

void amb_world_let_sleep(AmbWorld *world, double linear, double angular) {
  world->sleeps = true;
  world->sleeps_below[0] = linear;
  world->sleeps_below[1] = angular;
  amb_world_rest_static(world);
}

int amb_body_sleeps(const AmbBody *body) {
  return !body->body.isStaticObject() && body->body.getActivationState() == ISLAND_SLEEPING;
}

}  // extern "C"
