#include "round_on_plane.h"

#include <BulletCollision/CollisionDispatch/btCollisionDispatcher.h>
#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>
#include <BulletCollision/CollisionShapes/btCapsuleShape.h>
#include <BulletCollision/CollisionShapes/btConeShape.h>
#include <BulletCollision/CollisionShapes/btCylinderShape.h>
#include <BulletCollision/CollisionShapes/btStaticPlaneShape.h>

#include <initializer_list>
#include <new>

namespace {

constexpr int MOST_POINTS = 4;

// A shape with an axis of symmetry, in its own frame.
struct Round {
  int axis;
  // Where the circles at both ends are along the axis, and their radii, without the margin, m.
  btScalar ends[2], radii[2];
  // By which the surface is beyond the circles, m.
  btScalar margin;
};

bool describe(const btCollisionShape &shape, Round &round) {
  switch (shape.getShapeType()) {
    case CYLINDER_SHAPE_PROXYTYPE: {
      const auto &cylinder = static_cast<const btCylinderShape &>(shape);
      const btVector3 half = cylinder.getHalfExtentsWithoutMargin();
      const int axis = cylinder.getUpAxis();
      const btScalar radius = half[axis == 0 ? 1 : 0];
      round = {axis, {half[axis], -half[axis]}, {radius, radius}, cylinder.getMargin()};
      return true;
    }
    case CONE_SHAPE_PROXYTYPE: {
      const auto &cone = static_cast<const btConeShape &>(shape);
      const btScalar half = cone.getHeight() / 2;
      round = {cone.getConeUpIndex(), {half, -half}, {0, cone.getRadius()}, cone.getMargin()};
      return true;
    }
    case CAPSULE_SHAPE_PROXYTYPE: {
      const auto &capsule = static_cast<const btCapsuleShape &>(shape);
      const btScalar half = capsule.getHalfHeight();
      round = {capsule.getUpAxis(), {half, -half}, {0, 0}, capsule.getRadius()};
      return true;
    }
    default:
      return false;
  }
}

// Finds the points of the surface on which the shape can rest on a plane in the direction `down`, a unit vector: the
// lowest point of each end, and two more of the rim of the lower one, 120 degrees from it.
int find_resting_points(const Round &round, const btVector3 &down, btVector3 points[MOST_POINTS]) {
  btVector3 along(0, 0, 0), across(0, 0, 0);
  along[round.axis] = 1;
  const btVector3 radial = down - along * down.dot(along);
  const btScalar length = radial.length();
  // A base that is parallel to the plane has no lowest point; Bullet takes this one.
  across[round.axis == 0 ? 1 : 0] = 1;
  if (length > 0) across = radial / length;
  const btVector3 beside = along.cross(across);
  const int lower = down[round.axis] > 0 ? 0 : 1;
  int n = 0;
  for (int end = 0; end < 2; ++end) {
    const btVector3 centre = along * round.ends[end] + down * round.margin;
    const btScalar radius = round.radii[end];
    points[n++] = centre + across * radius;
    if (end != lower || radius <= 0) continue;
    const btScalar sine = btSqrt(btScalar(3)) / 2;
    points[n++] = centre + (across * btScalar(-0.5) + beside * sine) * radius;
    points[n++] = centre + (across * btScalar(-0.5) - beside * sine) * radius;
  }
  return n;
}

}  // namespace

void RoundOnPlane::processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                                    const btDispatcherInfo &info, btManifoldResult *result) {
  btConvexPlaneCollisionAlgorithm::processCollision(first, second, info, result);
  btPersistentManifold *const manifold = result->getPersistentManifold();
  const btCollisionObjectWrapper &round_object = is_swapped_ ? *second : *first;
  const btCollisionObjectWrapper &plane_object = is_swapped_ ? *first : *second;
  Round round;
  // Without a contact at the lowest point there is none.
  if (!manifold || manifold->getNumContacts() == 0 || !describe(*round_object.getCollisionShape(), round)) return;
  const auto &plane = static_cast<const btStaticPlaneShape &>(*plane_object.getCollisionShape());
  const btTransform &pose = round_object.getWorldTransform(), &frame = plane_object.getWorldTransform();
  const btVector3 normal = frame.getBasis() * plane.getPlaneNormal();
  btVector3 points[MOST_POINTS];
  const int n = find_resting_points(round, -(normal * pose.getBasis()), points);
  for (int i = 0; i < n; ++i) {
    const btVector3 point = pose * points[i];
    const btScalar distance = normal.dot(point - frame.getOrigin()) - plane.getPlaneConstant();
    if (distance >= manifold->getContactBreakingThreshold()) continue;
    result->addContactPoint(normal, point - normal * distance, distance);
  }
}

btCollisionAlgorithm *RoundOnPlaneFactory::Create::CreateCollisionAlgorithm(
    btCollisionAlgorithmConstructionInfo &info, const btCollisionObjectWrapper *first,
    const btCollisionObjectWrapper *second) {
  void *const memory = info.m_dispatcher1->allocateCollisionAlgorithm(sizeof(RoundOnPlane));
  return new (memory) RoundOnPlane(info, first, second, m_swapped);
}

void RoundOnPlaneFactory::enable(btCollisionDispatcher &dispatcher) {
  for (const int shape : {CYLINDER_SHAPE_PROXYTYPE, CONE_SHAPE_PROXYTYPE, CAPSULE_SHAPE_PROXYTYPE}) {
    dispatcher.registerCollisionCreateFunc(shape, STATIC_PLANE_PROXYTYPE, &plane_second_);
    dispatcher.registerCollisionCreateFunc(STATIC_PLANE_PROXYTYPE, shape, &plane_first_);
  }
}
