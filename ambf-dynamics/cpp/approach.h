// How far objects approach each other within a sub-step. C++ only.
#ifndef AMB_APPROACH_H
#define AMB_APPROACH_H

#include <algorithm>

#include <BulletCollision/CollisionDispatch/btManifoldResult.h>

#include "internal.h"

// Motion of a first object relative to a second one in h s, with the velocities before it and the forces on the bodies. They do
// not approach each other unless continuous collision detection is enabled for one of them.
class Approach {
 public:
  Approach(const btCollisionObject &first, const btCollisionObject &second, btScalar h) {
    if (!is_continuous(first) && !is_continuous(second)) return;
    add(first, h, 0);
    add(second, -h, 1);
  }

  // Distance from which on points of the two may touch, m. Impulses make some points faster than they are in free motion:
  // where the tip of a rod that falls flat is stopped, its other end goes on with one and a half times its velocity.
  btScalar bound() const { return reach(way_.length(), turns_[0].length(), turns_[1].length()); }

  // The same along a normal, a unit vector from the second object to the first.
  btScalar along(const btVector3 &normal) const {
    return reach(-way_.dot(normal), turns_[0].cross(normal).length(), turns_[1].cross(normal).length());
  }

  // The same for the correction of a penetration, m, which may turn a body about its centre of mass.
  static btScalar of_correction(btScalar depth) { return FASTEST_POINT * std::max(depth, btScalar(0)); }

 private:
  static constexpr btScalar FASTEST_POINT = 2;

  // A turn moves no point by more than the diameter.
  btScalar reach(btScalar way, btScalar turn_of_first, btScalar turn_of_second) const {
    const btScalar sum = FASTEST_POINT * way + std::min(FASTEST_POINT * turn_of_first, btScalar(2)) * radii_[0] +
                         std::min(FASTEST_POINT * turn_of_second, btScalar(2)) * radii_[1];
    return std::max(sum, btScalar(0));
  }

  static bool is_continuous(const btCollisionObject &object) {
    const AmbBody *const owner = body_of(&object);
    return owner && owner->is_continuous;
  }

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

// Bit of btManifoldPoint::m_contactPointFlags: its bodies may get more than half through each other within the sub-step, so that
// their impact has to be computed before they touch.
constexpr int ANTICIPATED = 1 << 16;

// Adds a contact to a manifold. `normal` and `point` are those of its second object. Unlike btManifoldResult it takes contacts
// at any distance.
inline void add_contact(btPersistentManifold &manifold, const btVector3 &normal, const btVector3 &point, btScalar distance,
                        bool is_anticipated) {
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
  if (is_anticipated) made.m_contactPointFlags |= ANTICIPATED;
  btPlaneSpace1(normal, made.m_lateralFrictionDir1, made.m_lateralFrictionDir2);
  const int known = manifold.getCacheEntry(made);
  if (known >= 0) {
    manifold.replaceContactPoint(made, known);
  } else {
    manifold.addManifoldPoint(made);
  }
}

#endif
