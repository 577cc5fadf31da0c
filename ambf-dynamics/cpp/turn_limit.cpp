#include "turn_limit.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "articulation.h"
#include "joint_arms.h"

namespace {

// Most turn in a sub-step or a part of one, rad.
constexpr btScalar MAX_TURN = 0.5;

bool is_dynamic(const AmbBody *body) { return body && !body->body.isStaticOrKinematicObject(); }

// The turn in h s of a body, rad, that would open a joint as much as this motion does. A body that turns about an axis
// through its pivot opens none.
btScalar turn_of(const btRigidBody &body, const btVector3 &arm, btScalar longest, btScalar h) {
  if (body.getInvMass() <= 0 || longest <= 0) return 0;
  const btVector3 &omega = body.getAngularVelocity();
  return h * btSqrt(omega.length() * omega.cross(arm).length() / longest);
}

btScalar turn_of(const btTypedConstraint &constraint, btScalar h) {
  btVector3 arm_a, arm_b;
  if (!find_joint_arms(constraint, arm_a, arm_b)) return 0;
  const btRigidBody &a = constraint.getRigidBodyA(), &b = constraint.getRigidBodyB();
  const btScalar longest = std::max(a.getInvMass() > 0 ? arm_a.length() : 0, b.getInvMass() > 0 ? arm_b.length() : 0);
  return std::max(turn_of(a, arm_a, longest, h), turn_of(b, arm_b, longest, h));
}

// Sets of bodies that joints connect (disjoint-set forest over the members `TurnGroup` of the bodies).
AmbBody &root_of(AmbBody &body) {
  AmbBody *root = &body;
  while (root->turn_group.parent) root = root->turn_group.parent;
  for (AmbBody *at = &body; at != root;) at = std::exchange(at->turn_group.parent, root);
  root->turn_group.parent = nullptr;
  return *root;
}

}  // namespace

void limit_turns(EngineWorld &engine, btScalar h) {
  btDiscreteDynamicsWorld &world = *engine.world.world;
  const auto for_joints = [&](auto act) {
    for (int i = 0; i < world.getNumConstraints(); ++i) {
      const btTypedConstraint &constraint = *world.getConstraint(i);
      if (constraint.isEnabled()) act(constraint);
    }
  };
  btScalar most = 0;
  for_joints([&](const btTypedConstraint &constraint) { most = std::max(most, turn_of(constraint, h)); });
  // A turn that is not a number is left for the check of the state.
  if (!(most > MAX_TURN && std::isfinite(most))) return;

  const auto for_bodies = [&](auto act) {
    const btAlignedObjectArray<btRigidBody *> &bodies = world.getNonStaticRigidBodies();
    for (int i = 0; i < bodies.size(); ++i) {
      AmbBody *body = body_of(bodies[i]);
      if (is_dynamic(body)) act(*body);
    }
  };
  for_bodies([](AmbBody &body) { body.turn_group = {}; });
  for_joints([&](const btTypedConstraint &constraint) {
    AmbBody *a = body_of(&constraint.getRigidBodyA()), *b = body_of(&constraint.getRigidBodyB());
    if (!is_dynamic(a) || !is_dynamic(b)) return;
    AmbBody &first = root_of(*a), &second = root_of(*b);
    if (&first != &second) second.turn_group.parent = &first;
  });
  for_joints([&](const btTypedConstraint &constraint) {
    AmbBody *a = body_of(&constraint.getRigidBodyA()), *b = body_of(&constraint.getRigidBodyB());
    if (!is_dynamic(a) && !is_dynamic(b)) return;
    TurnGroup &group = root_of(is_dynamic(a) ? *a : *b).turn_group;
    group.turn = std::max(group.turn, turn_of(constraint, h));
    group.is_anchored = group.is_anchored || !is_dynamic(a) || !is_dynamic(b);
  });
  if (engine.world.articulated) {
    for (const AmbConstraint *constraint : engine.world.articulated->external_constraints) {
      for (AmbBody *body : {&first_of(*constraint), &second_of(*constraint)}) {
        if (is_dynamic(body) && !body->articulation) root_of(*body).turn_group.is_held = true;
      }
    }
  }
  for_bodies([](AmbBody &body) {
    TurnGroup &group = root_of(body).turn_group;
    const btScalar mass = 1 / body.body.getInvMass();
    group.mass += mass;
    group.momentum += body.body.getLinearVelocity() * mass;
  });
  for_bodies([&](AmbBody &body) {
    const TurnGroup &group = root_of(body).turn_group;
    if (group.turn <= MAX_TURN || group.is_held) return;
    const btScalar kept = MAX_TURN / group.turn;
    const btVector3 mean = group.is_anchored ? btVector3(0, 0, 0) : group.momentum / group.mass;
    btRigidBody &moved = body.body;
    moved.setLinearVelocity(mean + (moved.getLinearVelocity() - mean) * kept);
    moved.setAngularVelocity(moved.getAngularVelocity() * kept);
    body.other_angular_change *= kept;
  });
}
