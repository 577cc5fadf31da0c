#include "contact_feature.h"

#include <algorithm>
#include <utility>

#include <BulletCollision/CollisionShapes/btBoxShape.h>
#include <BulletCollision/CollisionShapes/btCapsuleShape.h>
#include <BulletCollision/CollisionShapes/btConeShape.h>
#include <BulletCollision/CollisionShapes/btCylinderShape.h>

namespace {

// Points of the rim of a cylinder or cone.
constexpr int RIM_POINTS = 8;
// By how much less of its distance from the middle a point at the height of the band is seen at.
constexpr btScalar SHRINKAGE = 0.3;

}  // namespace

btScalar ContactFeature::margin_of(const btConvexShape &shape) {
  return shape.getShapeType() == BOX_SHAPE_PROXYTYPE ? btScalar(0) : shape.getMargin();
}

void ContactFeature::find(const btConvexShape &shape, const btTransform &pose, const btVector3 &normal, btScalar band) {
  take_points(shape, pose, normal);
  keep_lowest(normal, band);
  order(normal, band);
  found_ = points_;
}

void ContactFeature::take_points(const btConvexShape &shape, const btTransform &pose, const btVector3 &normal) {
  points_.clear();
  const btVector3 down = -(normal * pose.getBasis());
  const auto use = [&](const btVector3 &local) { points_.push_back(pose(local)); };
  const auto rim = [&](int axis, btScalar at, btScalar radius) {
    btVector3 along(0, 0, 0);
    along[axis] = 1;
    btVector3 radial = down - along * down.dot(along);
    const btScalar length = radial.length();
    // A base that is parallel to the surface has no lowest point.
    if (length > btScalar(1e-3)) {
      radial /= length;
    } else {
      radial.setZero();
      radial[axis == 0 ? 1 : 0] = 1;
    }
    const btVector3 beside = along.cross(radial);
    for (int i = 0; i < RIM_POINTS; ++i) {
      const btScalar angle = SIMD_2_PI * i / RIM_POINTS;
      use(along * at + (radial * btCos(angle) + beside * btSin(angle)) * radius);
    }
  };
  switch (shape.getShapeType()) {
    case SPHERE_SHAPE_PROXYTYPE:
      return use(btVector3(0, 0, 0));
    case CAPSULE_SHAPE_PROXYTYPE: {
      const auto &capsule = static_cast<const btCapsuleShape &>(shape);
      btVector3 along(0, 0, 0);
      along[capsule.getUpAxis()] = capsule.getHalfHeight();
      use(along);
      return use(-along);
    }
    case CYLINDER_SHAPE_PROXYTYPE: {
      const auto &cylinder = static_cast<const btCylinderShape &>(shape);
      const btVector3 half = cylinder.getHalfExtentsWithoutMargin();
      const int axis = cylinder.getUpAxis();
      rim(axis, half[axis], half[axis == 0 ? 1 : 0]);
      return rim(axis, -half[axis], half[axis == 0 ? 1 : 0]);
    }
    case CONE_SHAPE_PROXYTYPE: {
      const auto &cone = static_cast<const btConeShape &>(shape);
      btVector3 tip(0, 0, 0);
      tip[cone.getConeUpIndex()] = cone.getHeight() / 2;
      use(tip);
      return rim(cone.getConeUpIndex(), -cone.getHeight() / 2, cone.getRadius());
    }
    default:
      break;
  }
  const auto *const polyhedron = shape.isPolyhedral() ? static_cast<const btPolyhedralConvexShape *>(&shape) : nullptr;
  const int n = polyhedron ? polyhedron->getNumVertices() : 0;
  for (int i = 0; i < n; ++i) {
    btVector3 vertex;
    polyhedron->getVertex(i, vertex);
    use(vertex);
  }
  if (n > 0) return;
  // For shapes that do not list their vertices: the lowest points along the normal and along some a little beside it.
  constexpr btScalar TILT = 0.02;
  btVector3 first, second;
  btPlaneSpace1(normal, first, second);
  for (const btVector3 &tilt : {btVector3(0, 0, 0), first, -first, second, -second})
    use(shape.localGetSupportingVertexWithoutMargin((tilt * TILT - normal) * pose.getBasis()));
}

void ContactFeature::keep_lowest(const btVector3 &normal, btScalar band) {
  btScalar least = BT_LARGE_FLOAT;
  for (const btVector3 &point : points_) least = std::min(least, normal.dot(point));
  const auto is_higher = [&](const btVector3 &point) { return normal.dot(point) > least + band; };
  points_.erase(std::remove_if(points_.begin(), points_.end(), is_higher), points_.end());
}

// Keeps the points on the convex hull, seen along the normal, in order (Andrew, Another efficient algorithm for convex hulls
// in two dimensions, 1979). Higher points are seen nearer to the middle, so that of points above each other, as
// those of a thin sheet, the lowest stays.
void ContactFeature::order(const btVector3 &normal, btScalar band) {
  if (points_.size() < 3) return;
  btVector3 first, second, middle(0, 0, 0);
  btPlaneSpace1(normal, first, second);
  btScalar least = BT_LARGE_FLOAT;
  for (const btVector3 &point : points_) {
    middle += point / static_cast<btScalar>(points_.size());
    least = std::min(least, normal.dot(point));
  }
  const auto seen = [&](const btVector3 &axis, const btVector3 &point) {
    return axis.dot(point - middle) * (1 - SHRINKAGE * (normal.dot(point) - least) / band);
  };
  const auto x = [&](const btVector3 &point) { return seen(first, point); };
  const auto y = [&](const btVector3 &point) { return seen(second, point); };
  const auto comes_before = [&](const btVector3 &a, const btVector3 &b) {
    return std::make_pair(x(a), y(a)) < std::make_pair(x(b), y(b));
  };
  std::sort(points_.begin(), points_.end(), comes_before);
  const auto turns_left = [&](const btVector3 &a, const btVector3 &b, const btVector3 &c) {
    return (x(b) - x(a)) * (y(c) - y(a)) - (y(b) - y(a)) * (x(c) - x(a)) > 0;
  };
  other_.clear();
  for (int pass = 0; pass < 2; ++pass) {
    const size_t base = other_.size();
    for (const btVector3 &point : points_) {
      while (other_.size() >= base + 2 && !turns_left(other_[other_.size() - 2], other_.back(), point)) other_.pop_back();
      other_.push_back(point);
    }
    other_.pop_back();
    std::reverse(points_.begin(), points_.end());
  }
  points_.swap(other_);
}

btScalar ContactFeature::unevenness(btVector3 &normal) const {
  btVector3 sum(0, 0, 0), middle(0, 0, 0);
  for (size_t i = 2; i < points_.size(); ++i) sum += (points_[i - 1] - points_[0]).cross(points_[i] - points_[0]);
  if (!(sum.length2() > 0)) return SIMD_INFINITY;
  normal = sum.normalized();
  for (const btVector3 &point : points_) middle += point / static_cast<btScalar>(points_.size());
  btScalar most = 0;
  for (const btVector3 &point : points_) most = std::max(most, btFabs(normal.dot(point - middle)));
  return most;
}

void ContactFeature::clip(const HalfSpace &space) {
  other_.clear();
  for (size_t i = 0; i < points_.size(); ++i) {
    const btVector3 &point = points_[i], &next = points_[i + 1 < points_.size() ? i + 1 : 0];
    const btScalar here = space.height(point), there = space.height(next);
    if (here >= 0) other_.push_back(point);
    if ((here > 0 && there < 0) || (here < 0 && there > 0))
      other_.push_back(point + (next - point) * (here / (here - there)));
  }
  points_.swap(other_);
}

void ContactFeature::clip_by(const ContactFeature &polygon, const btVector3 &normal) {
  const Vector<btVector3> &corners = polygon.points();
  btVector3 middle(0, 0, 0);
  for (const btVector3 &corner : corners) middle += corner / static_cast<btScalar>(corners.size());
  for (size_t i = 0; i < corners.size(); ++i) {
    const btVector3 along = corners[i + 1 < corners.size() ? i + 1 : 0] - corners[i];
    btVector3 inwards = normal.cross(along);
    const btScalar length = inwards.length();
    if (!(length > 0)) continue;
    inwards /= length;
    if (inwards.dot(middle - corners[i]) < 0) inwards = -inwards;
    clip({inwards, inwards.dot(corners[i]) - btScalar(1e-9) * length});
  }
}
