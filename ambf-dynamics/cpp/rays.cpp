// Ray casts that are as exact for an instrument's tip as for a table.
//
// Bullet casts a ray at a convex shape by btSubsimplexConvexCast, whose simplex solver merges vertices that are less
// than about 1 cm apart. At a box of 4 mm every seventh ray past it is said to hit, and hits are up to 3 mm off; on a
// sphere they are off by up to 1 % of the radius. Here rays meet planes, spheres, boxes, capsules and the sides and ends
// of cylinders at the roots of their equations, and all other convex shapes by an algorithm whose tolerances are shares
// of their size. Concave meshes and soft bodies, whose triangles are met exactly, are left to Bullet.
#include <algorithm>
#include <cmath>

#include "engine.h"

namespace {

// The points start + share * way, 0 <= share <= most, in some frame, m.
struct Ray {
  btVector3 start, way;
  btScalar most;

  btVector3 at(btScalar share) const { return start + share * way; }

  Ray in(const btTransform &frame) const { return {frame.invXform(start), way * frame.getBasis(), most}; }
};

// Where a ray enters a shape: share of the way, and outward normal of any length in the frame of the ray.
struct Entry {
  btScalar share;
  btVector3 normal;
};

// The functions below return whether the ray enters the shape. Rays that begin within a convex shape do not.

// A sphere of this radius about a centre. With s the start seen from the centre, w the way: |s + t w| = radius.
bool enter_sphere(const Ray &ray, const btVector3 &centre, btScalar radius, Entry &entry) {
  const btVector3 from = ray.start - centre;
  const btScalar square = ray.way.length2(), along = from.dot(ray.way), outside = from.length2() - radius * radius;
  if (outside <= 0 || along >= 0) return false;
  // Distance of the line from the centre, by which the discriminant does not suffer from cancellation.
  const btScalar chord = radius * radius - (from - ray.way * (along / square)).length2();
  if (chord < 0) return false;
  entry.share = outside / (btSqrt(square * chord) - along);
  entry.normal = from + entry.share * ray.way;
  return entry.share <= ray.most;
}

// The box between two corners. Writes where the ray leaves it too.
bool enter_box(const Ray &ray, const btVector3 &low, const btVector3 &high, Entry &entry, btScalar &leaves) {
  entry.share = -BT_LARGE_FLOAT;
  leaves = BT_LARGE_FLOAT;
  for (int k = 0; k < 3; ++k) {
    if (ray.way[k] == 0) {
      if (ray.start[k] < low[k] || ray.start[k] > high[k]) return false;
      continue;
    }
    const bool rises = ray.way[k] > 0;
    const btScalar near = ((rises ? low : high)[k] - ray.start[k]) / ray.way[k];
    leaves = std::min(leaves, ((rises ? high : low)[k] - ray.start[k]) / ray.way[k]);
    if (near <= entry.share) continue;
    entry.share = near;
    entry.normal.setZero();
    entry.normal[k] = rises ? -1 : 1;
  }
  return entry.share <= leaves && leaves >= 0 && entry.share <= ray.most;
}

// The side of a cylinder of infinite height about an axis.
bool enter_side(const Ray &ray, int axis, btScalar radius, Entry &entry) {
  Ray across = ray;
  across.start[axis] = across.way[axis] = 0;
  return !across.way.isZero() && enter_sphere(across, {0, 0, 0}, radius, entry);
}

bool enter_capsule(const Ray &ray, const btCapsuleShape &capsule, Entry &entry) {
  const int axis = capsule.getUpAxis();
  // A file may say a height below 0.
  const btScalar radius = capsule.getRadius(), half = std::fabs(capsule.getHalfHeight());
  btVector3 top(0, 0, 0);
  top[axis] = half;
  btVector3 nearest(0, 0, 0);
  nearest[axis] = std::clamp(ray.start[axis], -half, half);
  if ((ray.start - nearest).length2() <= radius * radius) return false;
  if (enter_side(ray, axis, radius, entry) && std::fabs(ray.at(entry.share)[axis]) <= half) return true;
  Entry other{};
  const bool enters = enter_sphere(ray, top, radius, entry), enters_other = enter_sphere(ray, -top, radius, other);
  if (enters_other && (!enters || other.share < entry.share)) entry = other;
  return enters || enters_other;
}

// What is known about the entry of a ray into a shape that a simpler one encloses.
enum class Known { Enters, Misses, Nothing };

// Cylinders have edges that are rounded by the margin. A ray enters one where it enters the cylinder with sharp edges,
// unless that is near an edge.
Known enter_cylinder(const Ray &ray, const btCylinderShape &cylinder, Entry &entry) {
  const int axis = cylinder.getUpAxis();
  const btVector3 flat = cylinder.getHalfExtentsWithoutMargin();
  const btScalar margin = cylinder.getMargin(), half = flat[axis] + margin;
  const btScalar flat_radius = flat[(axis + 1) % 3], radius = flat_radius + margin;
  // A margin above the size makes another shape.
  if (flat[axis] < 0 || flat_radius < 0) return Known::Nothing;
  if (enter_side(ray, axis, radius, entry)) {
    const btScalar height = std::fabs(ray.at(entry.share)[axis]);
    if (height <= flat[axis]) return Known::Enters;
    if (height <= half) return Known::Nothing;
  }
  const btScalar end = ray.start[axis] > 0 ? half : -half;
  btVector3 across = ray.start;
  across[axis] = 0;
  if (std::fabs(ray.start[axis]) <= half) {
    // It begins between the planes of the ends, and within the sharp edges or does not enter the side.
    const bool at_edge = std::fabs(ray.start[axis]) > flat[axis] && across.length2() > flat_radius * flat_radius;
    return at_edge && across.length2() < radius * radius ? Known::Nothing : Known::Misses;
  }
  entry.share = (end - ray.start[axis]) / ray.way[axis];
  if (!(entry.share >= 0 && entry.share <= ray.most)) return Known::Misses;
  entry.normal.setZero();
  entry.normal[axis] = end;
  across = ray.at(entry.share);
  across[axis] = 0;
  const btScalar distance2 = across.length2();
  return distance2 <= flat_radius * flat_radius ? Known::Enters
         : distance2 <= radius * radius         ? Known::Nothing
                                                : Known::Misses;
}

// The point of a convex hull of up to four points that is nearest to a given one.
class Simplex {
 public:
  void add(const btVector3 &point) { points_[count_++] = point; }

  // Forgets the points that the nearest one does not depend on. Among all faces onto which the given point can be
  // projected, the nearest one counts: that is slower than to walk from face to face, and cannot go astray where the
  // points are nearly in one plane.
  btVector3 nearest_to(const btVector3 &given) {
    btScalar least = BT_LARGE_FLOAT;
    unsigned best = 1;
    btVector3 nearest = points_[0];
    for (unsigned face = 1; face < 1u << count_; ++face) {
      btVector3 on_face;
      if (!project(face, given, on_face)) continue;
      const btScalar distance2 = (on_face - given).length2();
      if (distance2 >= least) continue;
      least = distance2;
      best = face;
      nearest = on_face;
    }
    int kept = 0;
    for (int i = 0; i < count_; ++i) {
      if (best >> i & 1) points_[kept++] = points_[i];
    }
    count_ = kept;
    return nearest;
  }

  // Whether it is a tetrahedron around the given point.
  bool is_full() const { return count_ == 4; }

 private:
  // Projects a point onto a face, a set of bits; false where that is not within it.
  bool project(unsigned face, const btVector3 &given, btVector3 &on_face) const {
    int corners[4] = {0, 0, 0, 0}, n = 0;
    for (int i = 0; i < count_; ++i) {
      if (face >> i & 1) corners[n++] = i;
    }
    const btVector3 origin = points_[corners[0]];
    on_face = origin;
    if (n == 1) return true;
    // Weights of the other corners, by their reciprocal vectors.
    btScalar weights[3] = {0, 0, 0};
    const btVector3 way = given - origin, a = points_[corners[1]] - origin;
    if (n == 2) {
      const btScalar square = a.length2();
      if (!(square > 0)) return false;
      weights[0] = way.dot(a) / square;
      on_face += a * weights[0];
    } else {
      const btVector3 b = points_[corners[2]] - origin, normal = a.cross(b);
      // Three corners: it is projected along their normal. Four: their face is the space.
      const btVector3 c = n == 4 ? points_[corners[3]] - origin : normal;
      const btScalar volume = normal.dot(c);
      // Corners in one plane, or in line, span no face of their own.
      if (!(std::fabs(volume) > FLAT * a.length() * b.length() * c.length())) return false;
      weights[0] = way.dot(b.cross(c)) / volume;
      weights[1] = way.dot(c.cross(a)) / volume;
      weights[2] = n == 4 ? way.dot(normal) / volume : 0;
      on_face += a * weights[0] + b * weights[1];
      if (n == 4) on_face = given;
    }
    return weights[0] >= 0 && weights[1] >= 0 && weights[2] >= 0 && weights[0] + weights[1] + weights[2] <= 1;
  }

  // Volume of a flat tetrahedron as a share of that of its edges at right angles.
  static constexpr btScalar FLAT = 1e-9;
  btVector3 points_[4] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  int count_ = 0;
};

// Any convex shape: ray cast by the Gilbert-Johnson-Keerthi algorithm (van den Bergen 2004, Ray casting against general
// convex objects). The point on the ray advances to planes that have the whole shape behind them, until it is in the
// hull of the points where these touch the shape.
bool enter_by_support(const Ray &ray, const btConvexShape &shape, Entry &entry) {
  // Distances at which the point is on the shape: where the algorithm ends, and what counts where rounding keeps it
  // from that; as shares of the size.
  constexpr btScalar TOUCHES = 1e-10, NEARLY_TOUCHES = 1e-6;
  constexpr int MAX_ROUNDS = 100;
  // It begins at the bounding box, so that numbers are small. Those of hulls contain Bullet's default margin of 4 cm.
  btVector3 low, high;
  shape.getAabb(btTransform::getIdentity(), low, high);
  btScalar leaves;
  if (!finite(low + high) || !enter_box(ray, low, high, entry, leaves)) return false;
  const btVector3 middle = (low + high) / 2;
  const btScalar first = std::max(btScalar(0), entry.share), last = std::min(ray.most, leaves) - first;
  const btVector3 start = ray.at(first);
  btVector3 point = start, normal(0, 0, 0);
  Simplex simplex;
  btVector3 towards = point - middle;
  if (towards.isZero()) towards = -ray.way;
  btScalar share = 0, size = 0, distance = BT_LARGE_FLOAT;
  for (int round = 0; round < MAX_ROUNDS && distance > TOUCHES * size; ++round) {
    const btVector3 touched = shape.localGetSupportingVertex(towards.normalized());
    size = std::max(size, 2 * (touched - middle).length());
    const btScalar outside = towards.dot(point - touched);
    if (outside > 0) {
      const btScalar closing = -towards.dot(ray.way);
      // Of a point that touches, the direction to the shape is rounding error.
      if (!(closing > 0) && distance <= NEARLY_TOUCHES * size) break;
      if (!(closing > 0)) return false;
      share += outside / closing;
      if (share > last) return false;
      point = start + share * ray.way;
      normal = towards;
    }
    simplex.add(touched);
    towards = point - simplex.nearest_to(point);
    const btScalar before = distance;
    distance = simplex.is_full() ? 0 : towards.length();
    // Neither the point nor the hull moves any more.
    if (outside <= 0 && distance >= before) break;
  }
  // A ray that begins within meets no plane.
  if (distance > NEARLY_TOUCHES * size || normal.isZero()) return false;
  entry.share = first + share;
  entry.normal = normal;
  return true;
}

bool enter_convex(const Ray &ray, const btConvexShape &shape, Entry &entry) {
  switch (shape.getShapeType()) {
    case SPHERE_SHAPE_PROXYTYPE:
      return enter_sphere(ray, {0, 0, 0}, static_cast<const btSphereShape &>(shape).getRadius(), entry);
    case BOX_SHAPE_PROXYTYPE: {
      const btVector3 half = static_cast<const btBoxShape &>(shape).getHalfExtentsWithMargin();
      btScalar leaves;
      return enter_box(ray, -half, half, entry, leaves) && entry.share > 0;
    }
    case CAPSULE_SHAPE_PROXYTYPE: return enter_capsule(ray, static_cast<const btCapsuleShape &>(shape), entry);
    case CYLINDER_SHAPE_PROXYTYPE: {
      const Known known = enter_cylinder(ray, static_cast<const btCylinderShape &>(shape), entry);
      return known == Known::Enters || (known == Known::Nothing && enter_by_support(ray, shape, entry));
    }
    default: return enter_by_support(ray, shape, entry);
  }
}

// A plane is met from both sides; the normal is towards the start.
bool meet_plane(const Ray &ray, const btStaticPlaneShape &plane, Entry &entry) {
  const btVector3 &normal = plane.getPlaneNormal();
  const btScalar height = normal.dot(ray.start) - plane.getPlaneConstant(), rise = normal.dot(ray.way);
  if (height * rise >= 0) return false;
  entry.share = -height / rise;
  entry.normal = height > 0 ? normal : -normal;
  return entry.share <= ray.most;
}

// Casts one ray at all objects whose bounding boxes it meets.
class Caster final : public btBroadphaseRayCallback {
 public:
  Caster(const btVector3 &from, const btVector3 &to, btCollisionWorld::RayResultCallback &result)
      : from_(btMatrix3x3::getIdentity(), from), to_(btMatrix3x3::getIdentity(), to), way_(to - from), result_(result) {
    const btVector3 direction = way_.normalized();
    for (int k = 0; k < 3; ++k) {
      m_rayDirectionInverse[k] = direction[k] == 0 ? btScalar(BT_LARGE_FLOAT) : 1 / direction[k];
      m_signs[k] = m_rayDirectionInverse[k] < 0;
    }
    m_lambda_max = direction.dot(way_);
  }

  bool process(const btBroadphaseProxy *proxy) override {
    if (result_.m_closestHitFraction == btScalar(0)) return false;
    auto *object = static_cast<btCollisionObject *>(proxy->m_clientObject);
    if (result_.needsCollision(object->getBroadphaseHandle()))
      cast(*object, *object->getCollisionShape(), object->getWorldTransform());
    return true;
  }

 private:
  void cast(btCollisionObject &object, const btCollisionShape &shape, const btTransform &pose) {
    const Ray ray = Ray{from_.getOrigin(), way_, result_.m_closestHitFraction}.in(pose);
    Entry entry{};
    if (shape.isConvex() || shape.getShapeType() == STATIC_PLANE_PROXYTYPE) {
      const bool hits = shape.isConvex() ? enter_convex(ray, static_cast<const btConvexShape &>(shape), entry)
                                         : meet_plane(ray, static_cast<const btStaticPlaneShape &>(shape), entry);
      if (!hits || entry.share >= result_.m_closestHitFraction) return;
      const btVector3 normal = pose.getBasis() * entry.normal.normalized();
      btCollisionWorld::LocalRayResult hit(&object, nullptr, normal, entry.share);
      result_.addSingleResult(hit, true);
    } else if (shape.isCompound()) {
      cast_compound(object, static_cast<const btCompoundShape &>(shape), pose, ray);
    } else {
      btSoftRigidDynamicsWorld::rayTestSingle(from_, to_, &object, &shape, pose, result_);
    }
  }

  void cast_compound(btCollisionObject &object, const btCompoundShape &compound, const btTransform &pose,
                     const Ray &ray) {
    const auto child = [&](int i) {
      cast(object, *compound.getChildShape(i), pose * compound.getChildTransform(i));
    };
    if (const btDbvt *tree = compound.getDynamicAabbTree()) {
      struct Children : btDbvt::ICollide {
        explicit Children(decltype(child) &of) : visit(of) {}
        void Process(const btDbvtNode *leaf) override { visit(leaf->dataAsInt); }
        decltype(child) &visit;
      } children(child);
      btDbvt::rayTest(tree->m_root, ray.start, ray.at(1), children);
    } else {
      for (int i = 0; i < compound.getNumChildShapes(); ++i) child(i);
    }
  }

  const btTransform from_, to_;
  const btVector3 way_;
  btCollisionWorld::RayResultCallback &result_;
};

}  // namespace

bool EngineWorld::cast_ray(const btVector3 &from, const btVector3 &to, btCollisionWorld::RayResultCallback &result) {
  if (!exact_rays) return false;
  Caster caster(from, to, result);
  world.broadphase.rayTest(from, to, caster);
  return true;
}

extern "C" void amb_world_set_exact_rays(AmbWorld *world, int enabled) { engine_of(*world).exact_rays = enabled != 0; }
