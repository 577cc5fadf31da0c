#include "line_contacts.h"

#include <algorithm>

#include <BulletCollision/CollisionShapes/btBoxShape.h>
#include <BulletCollision/CollisionShapes/btCapsuleShape.h>
#include <BulletCollision/CollisionShapes/btConeShape.h>
#include <BulletCollision/CollisionShapes/btCylinderShape.h>
#include <BulletCollision/CollisionShapes/btPolyhedralConvexShape.h>

#include "approach.h"

namespace {

// Cosine of the largest angle between the normal that Bullet found, which is inexact between round shapes and faces, and that
// of the face.
constexpr btScalar ALIGNED = 0.9999;
// Unevenness of a face of a polyhedron, as a share of the contact breaking threshold.
constexpr btScalar UNEVENNESS = 0.05;

}  // namespace

// Leaves the part in a half space.
void LineContacts::Line::clip(const HalfSpace &space, bool &is_empty) {
  const btScalar heights[2] = {space.height(ends[0]), space.height(ends[1])};
  is_empty |= heights[0] < 0 && heights[1] < 0;
  for (int i = 0; i < 2; ++i) {
    if (heights[i] < 0 && heights[1 - i] > 0)
      ends[i] += (ends[1 - i] - ends[i]) * (heights[i] / (heights[i] - heights[1 - i]));
  }
}

// The lowest straight line on a shape in the direction `down`, a unit vector in the world, and the margin about it.
bool LineContacts::line_of(const btCollisionObjectWrapper &object, const btVector3 &down, Line &line) {
  const btCollisionShape &shape = *object.getCollisionShape();
  const btTransform &pose = object.getWorldTransform();
  const auto set = [&](int axis, btScalar low, btScalar high, btScalar low_radius, btScalar high_radius) {
    btVector3 along(0, 0, 0);
    along[axis] = 1;
    const btVector3 local = down * pose.getBasis();
    btVector3 radial = local - along * local.dot(along);
    // A base that lies on the face is no line.
    const btScalar length = radial.length();
    if (!(length > SIMD_EPSILON)) return false;
    radial /= length;
    line.ends[0] = pose(along * low + radial * low_radius);
    line.ends[1] = pose(along * high + radial * high_radius);
    return true;
  };
  switch (shape.getShapeType()) {
    case CAPSULE_SHAPE_PROXYTYPE: {
      const auto &capsule = static_cast<const btCapsuleShape &>(shape);
      line.margin = capsule.getRadius();
      return set(capsule.getUpAxis(), -capsule.getHalfHeight(), capsule.getHalfHeight(), 0, 0);
    }
    case CYLINDER_SHAPE_PROXYTYPE: {
      const auto &cylinder = static_cast<const btCylinderShape &>(shape);
      const btVector3 half = cylinder.getHalfExtentsWithoutMargin();
      const int axis = cylinder.getUpAxis();
      const btScalar radius = half[axis == 0 ? 1 : 0];
      line.margin = cylinder.getMargin();
      return set(axis, -half[axis], half[axis], radius, radius);
    }
    case CONE_SHAPE_PROXYTYPE: {
      const auto &cone = static_cast<const btConeShape &>(shape);
      line.margin = cone.getMargin();
      return set(cone.getConeUpIndex(), -cone.getHeight() / 2, cone.getHeight() / 2, cone.getRadius(), 0);
    }
    default:
      return false;
  }
}

// The face whose outer normal is next to `normal`, which becomes that normal.
bool LineContacts::face_of(const btCollisionObjectWrapper &object, btVector3 &normal, btScalar band) {
  const btTransform &pose = object.getWorldTransform();
  const auto &shape = static_cast<const btConvexShape &>(*object.getCollisionShape());
  corners_.clear();
  if (shape.getShapeType() == BOX_SHAPE_PROXYTYPE) {
    const btVector3 half = static_cast<const btBoxShape &>(shape).getHalfExtentsWithMargin(), local = normal * pose.getBasis();
    const int axis = local.absolute().maxAxis(), u = (axis + 1) % 3, v = (axis + 2) % 3;
    if (btFabs(local[axis]) < ALIGNED) return false;
    const btScalar side = local[axis] > 0 ? 1 : -1;
    for (int i = 0; i < 4; ++i) {
      btVector3 corner;
      corner[axis] = side * half[axis];
      corner[u] = (i == 0 || i == 3 ? -1 : 1) * half[u];
      corner[v] = (i < 2 ? -1 : 1) * half[v];
      corners_.push_back(pose(corner));
    }
    normal = pose.getBasis().getColumn(axis) * side;
    face_margin_ = 0;
    return true;
  }
  if (!shape.isPolyhedral()) return false;
  feature_.find(shape, pose, -normal, band);
  if (feature_.points().size() < 3) return false;
  corners_ = feature_.points();
  btVector3 sum(0, 0, 0);
  for (size_t i = 2; i < corners_.size(); ++i) sum += (corners_[i - 1] - corners_[0]).cross(corners_[i] - corners_[0]);
  if (!(sum.length2() > 0)) return false;
  sum.normalize();
  if (sum.dot(normal) < 0) sum = -sum;
  if (sum.dot(normal) < ALIGNED) return false;
  normal = sum;
  face_margin_ = ContactFeature::margin_of(shape);
  return true;
}

bool LineContacts::replace(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second,
                           btManifoldResult &result) {
  if (!result.getPersistentManifold() || result.getPersistentManifold()->getNumContacts() == 0) return false;
  btPersistentManifold &manifold = *result.getPersistentManifold();
  const btScalar threshold = manifold.getContactBreakingThreshold();
  int deepest = 0;
  for (int i = 0; i < manifold.getNumContacts(); ++i) {
    if (manifold.getContactPoint(i).getDistance() < manifold.getContactPoint(deepest).getDistance()) deepest = i;
  }
  const btVector3 found = manifold.getContactPoint(deepest).m_normalWorldOnB;
  for (int side = 0; side < 2; ++side) {
    Line line;
    // Out of the face, to the body with the line.
    btVector3 normal = side == 0 ? found : -found;
    if (!line_of(side == 0 ? first : second, -normal, line)) continue;
    if (!face_of(side == 0 ? second : first, normal, UNEVENNESS * threshold)) continue;
    btVector3 middle(0, 0, 0);
    for (const btVector3 &corner : corners_) middle += corner / static_cast<btScalar>(corners_.size());
    bool is_empty = false;
    for (size_t i = 0; i < corners_.size(); ++i) {
      const btVector3 along = corners_[i + 1 < corners_.size() ? i + 1 : 0] - corners_[i];
      btVector3 inwards = normal.cross(along);
      if (!(inwards.length2() > 0)) continue;
      inwards.normalize();
      if (inwards.dot(middle - corners_[i]) < 0) inwards = -inwards;
      line.clip({inwards, inwards.dot(corners_[i])}, is_empty);
    }
    const btScalar margins = line.margin + face_margin_;
    const auto distance_of = [&](const btVector3 &end) { return normal.dot(end - middle) - margins; };
    const btScalar distances[2] = {distance_of(line.ends[0]), distance_of(line.ends[1])};
    const btScalar farthest = std::max(distances[0], distances[1]);
    if (is_empty || !(farthest < threshold) || !(line.ends[0].distance(line.ends[1]) > 2 * threshold)) continue;

    const btVector3 on_second = side == 0 ? normal : -normal;
    const auto on_first = [&](int i) {
      return line.ends[i] - normal * (side == 0 ? line.margin : margins + distances[i] - face_margin_);
    };
    for (int i = manifold.getNumContacts(); i-- > 0;) {
      const btVector3 &point = manifold.getContactPoint(i).getPositionWorldOnA();
      if (point.distance(on_first(0)) > threshold && point.distance(on_first(1)) > threshold) manifold.removeContactPoint(i);
    }
    for (int i = 0; i < 2; ++i) add_contact(manifold, on_second, on_first(i) - on_second * distances[i], distances[i], false);
    return true;
  }
  return false;
}
