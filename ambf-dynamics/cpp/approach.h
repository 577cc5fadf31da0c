// How far objects approach each other within a sub-step. C++ only.
#ifndef AMB_APPROACH_H
#define AMB_APPROACH_H

#include <algorithm>

#include <BulletCollision/CollisionDispatch/btManifoldResult.h>

#include "internal.h"

// Motion of a first object relative to a second one in h s, with the velocities before it and the forces on the bodies.
class Approach {
 public:
  Approach(const btCollisionObject &first, const btCollisionObject &second, btScalar h) {
    add(first, h, 1);
    add(second, -h, 0);
  }

  // The largest distance, m, by which any points of the two can approach each other.
  btScalar bound() const { return way_.length() + turns_[0].length() * radii_[0] + turns_[1].length() * radii_[1]; }

  // The same along a normal, a unit vector from the second object to the first.
  btScalar along(const btVector3 &normal) const {
    btScalar sum = -way_.dot(normal);
    for (int i = 0; i < 2; ++i) sum += turns_[i].cross(normal).length() * radii_[i];
    return std::max(sum, btScalar(0));
  }

 private:
  void add(const btCollisionObject &object, btScalar h, int place) {
    const AmbBody *const owner = body_of(&object);
    if (!owner || object.isStaticObject()) return;
    const btRigidBody &body = owner->body;
    way_ += (body.getLinearVelocity() + body.getTotalForce() * (body.getInvMass() * std::abs(h))) * h;
    turns_[place] = body.getAngularVelocity() * h;
    radii_[place] = object.getCollisionShape()->getAngularMotionDisc();
  }

  btVector3 way_{0, 0, 0};
  // rad, and distance of the farthest point of the object from its origin, m.
  btVector3 turns_[2] = {{0, 0, 0}, {0, 0, 0}};
  btScalar radii_[2] = {0, 0};
};

// A contact that no velocity opens further than the motion of its sub-step closes is no contact. This many times the approach
// of the free motion may be that of a point: where the tip of a rod that falls flat is stopped, its other end goes on with one
// and a half times its velocity.
constexpr btScalar FASTEST_POINT = 2;

// Adds a contact to a manifold. `normal` and `point` are those of its second object. Unlike btManifoldResult it takes contacts
// at any distance.
inline void add_contact(btPersistentManifold &manifold, const btVector3 &normal, const btVector3 &point, btScalar distance) {
  const btCollisionObject &first = *manifold.getBody0(), &second = *manifold.getBody1();
  const btVector3 on_first = point + normal * distance;
  btManifoldPoint made(first.getWorldTransform().invXform(on_first), second.getWorldTransform().invXform(point), normal,
                       distance);
  made.m_positionWorldOnA = on_first;
  made.m_positionWorldOnB = point;
  made.m_combinedFriction = btManifoldResult::calculateCombinedFriction(&first, &second);
  made.m_combinedRestitution = btManifoldResult::calculateCombinedRestitution(&first, &second);
  made.m_combinedRollingFriction = btManifoldResult::calculateCombinedRollingFriction(&first, &second);
  made.m_combinedSpinningFriction = btManifoldResult::calculateCombinedSpinningFriction(&first, &second);
  btPlaneSpace1(normal, made.m_lateralFrictionDir1, made.m_lateralFrictionDir2);
  const int known = manifold.getCacheEntry(made);
  if (known >= 0) {
    manifold.replaceContactPoint(made, known);
  } else {
    manifold.addManifoldPoint(made);
  }
}

#endif
