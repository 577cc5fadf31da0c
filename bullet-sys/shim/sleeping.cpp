#include "internal.h"

#include <cmath>

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

// Whether nothing but contacts can hold the body against its gravity. Then it is slow for long only if it rests on
// something: it would fall faster than the thresholds of resting bodies otherwise, also at its terminal speed.
bool is_carried(const AmbWorld &world, const AmbBody &owner) {
  // It is reached within a tenth of the time after which bodies fall asleep, 2 s.
  constexpr btScalar MIN_GRAVITY = 1;
  if (owner.constraint_count > 0) return false;
  const btScalar gravity = owner.body.getGravity().length();
  // Bullet's damping is the share of the velocity that is lost in 1 s.
  const btScalar damping_rate = -std::log1p(-owner.body.getLinearDamping());
  return gravity >= MIN_GRAVITY && gravity > 2 * world.resting_thresholds[0] * damping_rate;
}

}  // namespace

void set_sleeping_thresholds(AmbWorld &world, AmbBody &owner) {
  if (!world.allows_sleeping || owner.sleep_inhibitors > 0 || owner.body.isStaticObject()) return;
  const btScalar *thresholds = is_carried(world, owner) ? world.resting_thresholds : world.sleeping_thresholds;
  owner.body.setSleepingThresholds(thresholds[0], thresholds[1]);
}

void set_activation_state(AmbWorld &world, AmbBody &owner) {
  btRigidBody &body = owner.body;
  if (body.isStaticObject()) {
    if (world.freezes_static_aabbs) body.forceActivationState(ISLAND_SLEEPING);
  } else if (world.allows_sleeping && owner.sleep_inhibitors == 0) {
    set_sleeping_thresholds(world, owner);
    body.setDeactivationTime(0);
    body.forceActivationState(ACTIVE_TAG);
  } else {
    body.forceActivationState(DISABLE_DEACTIVATION);
  }
}

void activate_neighbours(AmbWorld &world, const AmbBody &owner) {
  if (!world.allows_sleeping) return;
  world.catch_up_with_bounds();
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
  body.setWorldTransform(pose);
  owner.motion.setWorldTransform(pose);
  const bool is_link = world.extension && world.extension->pose_set(owner);
  // The collision object of a link is moved in the next sub-step, and links never sleep.
  if (!moves || !world.freezes_static_aabbs || is_link) return;
  world.world->updateSingleAabb(&body);
  activate_neighbours(world, owner);
}

void place_moved_bodies(AmbWorld &world) {
  for (const auto &[owner, pose] : world.moved) {
    owner->body.setWorldTransform(pose);
    owner->motion.setWorldTransform(pose);
    if (!world.freezes_static_aabbs) continue;
    world.world->updateSingleAabb(&owner->body);
    activate_neighbours(world, *owner);
  }
  world.moved.clear();
}

extern "C" {

void amb_world_freeze_static_aabbs(AmbWorld *world) {
  world->freezes_static_aabbs = true;
  world->world->setForceUpdateAllAabbs(false);
  set_all_activation_states(*world);
}

void amb_world_enable_sleeping(AmbWorld *world, const double slow[2], const double resting[2]) {
  world->allows_sleeping = true;
  for (int i = 0; i < 2; ++i) {
    world->sleeping_thresholds[i] = slow[i];
    world->resting_thresholds[i] = resting[i];
  }
  amb_world_freeze_static_aabbs(world);
}

int amb_body_is_asleep(const AmbBody *body) {
  return !body->body.isStaticObject() && body->body.getActivationState() == ISLAND_SLEEPING;
}

}  // extern "C"
