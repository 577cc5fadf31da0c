#include "face_contacts.h"

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

// Whether the corners of a shape are known.
bool has_corners(const btCollisionShape &shape) {
  return shape.isPolyhedral() && static_cast<const btPolyhedralConvexShape &>(shape).getNumVertices() > 0;
}

}  // namespace

// The lowest straight line on a shape in the direction `down`, a unit vector in the world.
bool FaceContacts::find_line(const btCollisionObjectWrapper &object, const btVector3 &down) {
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
    lying_.set({pose(along * low + radial * low_radius), pose(along * high + radial * high_radius)});
    lying_margin_ = shape.getShapeType() == CAPSULE_SHAPE_PROXYTYPE ? static_cast<const btCapsuleShape &>(shape).getRadius()
                                                                    : shape.getMargin();
    return true;
  };
  switch (shape.getShapeType()) {
    case CAPSULE_SHAPE_PROXYTYPE: {
      const auto &capsule = static_cast<const btCapsuleShape &>(shape);
      return set(capsule.getUpAxis(), -capsule.getHalfHeight(), capsule.getHalfHeight(), 0, 0);
    }
    case CYLINDER_SHAPE_PROXYTYPE: {
      const auto &cylinder = static_cast<const btCylinderShape &>(shape);
      const btVector3 half = cylinder.getHalfExtentsWithoutMargin();
      const int axis = cylinder.getUpAxis();
      const btScalar radius = half[axis == 0 ? 1 : 0];
      return set(axis, -half[axis], half[axis], radius, radius);
    }
    case CONE_SHAPE_PROXYTYPE: {
      const auto &cone = static_cast<const btConeShape &>(shape);
      return set(cone.getConeUpIndex(), -cone.getHeight() / 2, cone.getHeight() / 2, cone.getRadius(), 0);
    }
    default:
      return false;
  }
}

// The lowest edge or face of a polyhedron along the outer normal of what it lies on: its corners up to `threshold` m above the lowest
// one, if they lie in a plane.
bool FaceContacts::find_corners(const btCollisionObjectWrapper &object, const btVector3 &normal, btScalar threshold) {
  const auto &shape = static_cast<const btConvexShape &>(*object.getCollisionShape());
  if (!has_corners(shape)) return false;
  lying_.find(shape, object.getWorldTransform(), normal, threshold);
  lying_margin_ = ContactFeature::margin_of(shape);
  btVector3 own;
  return lying_.points().size() == 2 || (lying_.points().size() > 2 && lying_.unevenness(own) < UNEVENNESS * threshold);
}

// The face whose outer normal is next to `normal`, which becomes that normal.
bool FaceContacts::find_face(const btCollisionObjectWrapper &object, btVector3 &normal, btScalar unevenness) {
  const btTransform &pose = object.getWorldTransform();
  const auto &shape = static_cast<const btConvexShape &>(*object.getCollisionShape());
  if (shape.getShapeType() == BOX_SHAPE_PROXYTYPE) {
    const btVector3 half = static_cast<const btBoxShape &>(shape).getHalfExtentsWithMargin(), local = normal * pose.getBasis();
    const int axis = local.absolute().maxAxis(), u = (axis + 1) % 3, v = (axis + 2) % 3;
    if (btFabs(local[axis]) < ALIGNED) return false;
    const btScalar side = local[axis] > 0 ? 1 : -1;
    const auto corner = [&](btScalar along_u, btScalar along_v) {
      btVector3 at;
      at[axis] = side * half[axis];
      at[u] = along_u * half[u];
      at[v] = along_v * half[v];
      return pose(at);
    };
    face_.set({corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)});
    normal = pose.getBasis().getColumn(axis) * side;
    face_margin_ = 0;
    return true;
  }
  if (!has_corners(shape)) return false;
  face_.find(shape, pose, -normal, unevenness);
  btVector3 own;
  if (face_.points().size() < 3 || !(face_.unevenness(own) < SIMD_INFINITY)) return false;
  if (own.dot(normal) < 0) own = -own;
  if (own.dot(normal) < ALIGNED) return false;
  normal = own;
  face_margin_ = ContactFeature::margin_of(shape);
  return true;
}

Replaced FaceContacts::replace(const btCollisionObjectWrapper &first, const btCollisionObjectWrapper &second,
                               btManifoldResult &result) {
  if (!result.getPersistentManifold() || result.getPersistentManifold()->getNumContacts() == 0) return Replaced::None;
  btPersistentManifold &manifold = *result.getPersistentManifold();
  const btScalar threshold = manifold.getContactBreakingThreshold();
  int deepest = 0;
  for (int i = 0; i < manifold.getNumContacts(); ++i) {
    if (manifold.getContactPoint(i).getDistance() < manifold.getContactPoint(deepest).getDistance()) deepest = i;
  }
  const btVector3 found = manifold.getContactPoint(deepest).m_normalWorldOnB;
  for (int side = 0; side < 2; ++side) {
    const btCollisionObjectWrapper &object = side == 0 ? first : second, &ground = side == 0 ? second : first;
    // Out of the face, to the other body.
    btVector3 normal = side == 0 ? found : -found;
    const bool is_line = find_line(object, -normal);
    if (!is_line && !has_corners(*object.getCollisionShape())) continue;
    if (!find_face(ground, normal, UNEVENNESS * threshold)) continue;
    if (!is_line && !find_corners(object, normal, threshold)) continue;
    const btScalar height = normal.dot(face_.points()[0]) + face_margin_;
    lying_.clip_by(face_, normal);
    found_.clear();
    size_t lowest = 0;
    for (const btVector3 &corner : lying_.points()) {
      const btScalar distance = normal.dot(corner) - lying_margin_ - height;
      if (!(distance < threshold)) continue;
      if (!found_.empty() && distance < found_[lowest].distance) lowest = found_.size();
      found_.push_back({normal, corner - normal * (lying_margin_ + distance), distance, false});
    }
    if (found_.empty() || (is_line && found_.size() != lying_.points().size())) continue;
    // Something between the corners is lower: the shape is domed.
    const btScalar depth = -manifold.getContactPoint(deepest).getDistance();
    if (!is_line && found_[lowest].distance > 2 * UNEVENNESS * threshold - depth) continue;
    const ContactSelection selection =
        select_contacts(found_, found_[lowest], object.getWorldTransform().getOrigin(), threshold);
    // Nearer points are one for Bullet.
    if (selection.count < 2 || !(selection.kept[0]->point.distance(selection.kept[1]->point) > 2 * threshold)) continue;
    const auto is_kept = [&](const btVector3 &on_ground) {
      for (int i = 0; i < selection.count; ++i) {
        if (on_ground.distance(selection.kept[i]->point) <= threshold) return true;
      }
      return false;
    };
    for (int i = manifold.getNumContacts(); i-- > 0;) {
      const btManifoldPoint &point = manifold.getContactPoint(i);
      if (!is_line || !is_kept(side == 0 ? point.getPositionWorldOnB() : point.getPositionWorldOnA())) manifold.removeContactPoint(i);
    }
    for (int i = 0; i < selection.count; ++i) {
      const SurfaceContact &contact = *selection.kept[i];
      if (side == 0) {
        add_contact(manifold, normal, contact.point, contact.distance, false);
      } else {
        add_contact(manifold, -normal, contact.point + normal * contact.distance, contact.distance, false);
      }
    }
    return is_line ? Replaced::Line : Replaced::Face;
  }
  return Replaced::None;
}
