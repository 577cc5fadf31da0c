#include "near_contacts.h"

#include <algorithm>

#include <BulletCollision/CollisionShapes/btBoxShape.h>
#include <BulletCollision/NarrowPhaseCollision/btGjkPairDetector.h>
#include <BulletCollision/NarrowPhaseCollision/btPointCollector.h>
#include <BulletCollision/NarrowPhaseCollision/btVoronoiSimplexSolver.h>

#include "approach.h"

namespace {

// A shape in the world, with the sharp edges of a box.
class Solid {
 public:
  explicit Solid(const btCollisionObjectWrapper &object)
      : pose(object.getWorldTransform()),
        given_(static_cast<const btConvexShape &>(*object.getCollisionShape())),
        is_box(given_.getShapeType() == BOX_SHAPE_PROXYTYPE),
        box_(is_box ? static_cast<const btBoxShape &>(given_).getHalfExtentsWithMargin() : btVector3(1, 1, 1)) {
    box_.setMargin(0);
  }

  const btConvexShape &shape() const { return is_box ? box_ : given_; }
  // With the rounded edges that all shapes with a margin have: where sharp ones touch, their cores are still apart.
  const btConvexShape &rounded() const { return given_; }
  btScalar margin() const { return ContactFeature::margin_of(shape()); }

  // Coordinate of the farthest point along a direction.
  btScalar farthest(const btVector3 &direction) const {
    return direction.dot(pose(shape().localGetSupportingVertex(direction * pose.getBasis())));
  }

  const btTransform &pose;

 private:
  const btConvexShape &given_;

 public:
  const bool is_box;

 private:
  btBoxShape box_;
};

btPointCollector nearest(const Solid &first, const Solid &second, btScalar reach) {
  btVoronoiSimplexSolver simplex;
  btGjkPairDetector detector(&first.rounded(), &second.rounded(), &simplex, nullptr);
  btGjkPairDetector::ClosestPointInput input;
  const btScalar farthest = first.rounded().getMargin() + second.rounded().getMargin() + reach;
  input.m_maximumDistanceSquared = farthest * farthest;
  input.m_transformA = first.pose;
  input.m_transformB = second.pose;
  btPointCollector found;
  detector.getClosestPoints(input, found, nullptr);
  found.m_hasResult &= found.m_distance < reach;
  return found;
}

// Depth of the deepest contact, m; 0: none overlaps.
btScalar depth_of(const btPersistentManifold &manifold) {
  btScalar depth = 0;
  for (int i = 0; i < manifold.getNumContacts(); ++i) depth = std::max(depth, -manifold.getContactPoint(i).getDistance());
  return depth;
}

bool is_apart(const btPersistentManifold &manifold) {
  for (int i = 0; i < manifold.getNumContacts(); ++i) {
    if (manifold.getContactPoint(i).getDistance() > 0) return true;
  }
  return false;
}

}  // namespace

void NearContacts::add(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second,
                       btManifoldResult &result, btScalar h, bool is_complete) {
  if (!result.getPersistentManifold()) return;
  btPersistentManifold &manifold = *result.getPersistentManifold();
  const btScalar threshold = manifold.getContactBreakingThreshold();
  const btCollisionObject &one = *first.getCollisionObject(), &other = *second.getCollisionObject();
  const Approach approach(one, other, h);
  const btScalar correction = Approach::of_correction(depth_of(manifold)), most = approach.bound() + correction;
  const Solid a(first), b(second);
  const bool rebounds = btManifoldResult::calculateCombinedRestitution(&one, &other) > 0;
  const bool is_gap = a.is_box && b.is_box && manifold.getNumContacts() == 0 && !rebounds;
  if (!is_gap && !(most > threshold) && !(rebounds && is_apart(manifold))) return;

  btVector3 normal(0, 0, 0);
  if (manifold.getNumContacts() > 0) {
    int deepest = 0;
    for (int i = 1; i < manifold.getNumContacts(); ++i) {
      if (manifold.getContactPoint(i).getDistance() < manifold.getContactPoint(deepest).getDistance()) deepest = i;
    }
    normal = manifold.getContactPoint(deepest).m_normalWorldOnB;
  }
  btPointCollector found;
  if (manifold.getNumContacts() == 0) {
    found = nearest(a, b, std::max(most, threshold));
    if (!found.m_hasResult) return;
    normal = found.m_normalOnBInWorld;
  }
  const btScalar closing = approach.along(normal) + correction, high_b = b.farthest(normal), low_a = -a.farthest(-normal);
  const btScalar thickness = a.farthest(normal) - low_a + high_b + b.farthest(-normal);
  const bool is_thin = closing > thickness / 2;
  for (int i = 0; is_thin && i < manifold.getNumContacts(); ++i) manifold.getContactPoint(i).m_contactPointFlags |= ANTICIPATED;
  if (is_complete || (!is_gap && !(is_thin && most > threshold))) return;
  const btScalar reach = is_thin ? std::max(closing, threshold) : threshold;
  if (low_a - high_b > reach) return;

  // The face that is flatter along the normal holds the points of the other shape that are over it.
  features_[0].find(a.shape(), a.pose, normal, reach);
  features_[1].find(b.shape(), b.pose, -normal, reach);
  const auto unevenness = [&](const ContactFeature &feature) {
    if (feature.points().size() < 3) return BT_LARGE_FLOAT;
    btScalar low = BT_LARGE_FLOAT, high = -BT_LARGE_FLOAT;
    for (const btVector3 &point : feature.points()) {
      low = std::min(low, normal.dot(point));
      high = std::max(high, normal.dot(point));
    }
    return high - low;
  };
  const btScalar of_a = unevenness(features_[0]), of_b = unevenness(features_[1]);
  if (of_a == BT_LARGE_FLOAT && of_b == BT_LARGE_FLOAT) {
    if (found.m_hasResult && found.m_distance < reach) add_contact(manifold, normal, found.m_pointInWorld, found.m_distance, is_thin);
    return;
  }
  const bool holds_b = of_a < of_b;
  ContactFeature &held = features_[holds_b];
  held.clip_by(features_[!holds_b], normal);
  for (const btVector3 &point : held.points()) {
    const btScalar height = normal.dot(point);
    const btScalar distance = holds_b ? low_a - height - b.margin() : height - a.margin() - high_b;
    if (!(distance < reach)) continue;
    add_contact(manifold, normal, holds_b ? point + normal * b.margin() : point - normal * (a.margin() + distance), distance, is_thin);
  }
}
