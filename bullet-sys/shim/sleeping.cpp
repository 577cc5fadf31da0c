#include "internal.h"

namespace {

struct ActivateOverlapping : btBroadphaseAabbCallback {
  bool process(const btBroadphaseProxy *proxy) override {
    static_cast<btCollisionObject *>(proxy->m_clientObject)->activate();
    return true;
  }
};

void set_all_activation_states(AmbWorld &world) {
  btCollisionObjectArray &objects = world.world->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    if (AmbBody *body = body_of(objects[i])) set_activation_state(world, *body);
  }
}

}  // namespace

void set_activation_state(AmbWorld &world, AmbBody &owner) {
  btRigidBody &body = owner.body;
  if (body.isStaticObject()) {
    if (world.freezes_static_aabbs) body.forceActivationState(ISLAND_SLEEPING);
  } else if (world.allows_sleeping && owner.sleep_inhibitors == 0) {
    body.setSleepingThresholds(world.sleeping_thresholds[0], world.sleeping_thresholds[1]);
    body.setDeactivationTime(0);
    body.forceActivationState(ACTIVE_TAG);
  } else {
    body.forceActivationState(DISABLE_DEACTIVATION);
  }
}

void activate_neighbours(AmbWorld &world, const AmbBody &owner) {
  if (!world.allows_sleeping) return;
  const btBroadphaseProxy &proxy = *owner.collider->getBroadphaseHandle();
  ActivateOverlapping waker;
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

void set_pose(AmbWorld &world, AmbBody &owner, const btTransform &pose) {
  btRigidBody &body = owner.body;
  const bool moves = !(body.getWorldTransform() == pose);
  if (moves) activate_neighbours(world, owner);
  const bool is_link = world.extension && world.extension->pose_set(owner);
  body.setWorldTransform(pose);
  owner.motion.setWorldTransform(pose);
  // The collision object of a link is moved in the next sub-step, and links never sleep.
  if (!moves || !world.freezes_static_aabbs || is_link) return;
  world.world->updateSingleAabb(&body);
  activate_neighbours(world, owner);
}

extern "C" {

void amb_world_freeze_static_aabbs(AmbWorld *world) {
  world->freezes_static_aabbs = true;
  world->world->setForceUpdateAllAabbs(false);
  set_all_activation_states(*world);
}

void amb_world_enable_sleeping(AmbWorld *world, double linear, double angular) {
  world->allows_sleeping = true;
  world->sleeping_thresholds[0] = linear;
  world->sleeping_thresholds[1] = angular;
  amb_world_freeze_static_aabbs(world);
}

int amb_body_is_asleep(const AmbBody *body) {
  return !body->body.isStaticObject() && body->body.getActivationState() == ISLAND_SLEEPING;
}

}  // extern "C"
