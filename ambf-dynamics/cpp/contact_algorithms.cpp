#include "contact_algorithms.h"

#include <BulletCollision/CollisionDispatch/btCollisionConfiguration.h>
#include <BulletCollision/CollisionDispatch/btCollisionDispatcher.h>
#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btCompoundCompoundCollisionAlgorithm.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>
#include <BulletCollision/CollisionDispatch/btSphereSphereCollisionAlgorithm.h>
#include <BulletCollision/CollisionShapes/btCapsuleShape.h>
#include <BulletCollision/CollisionShapes/btConeShape.h>
#include <BulletCollision/CollisionShapes/btCylinderShape.h>
#include <BulletCollision/CollisionShapes/btPolyhedralConvexShape.h>
#include <BulletCollision/CollisionShapes/btStaticPlaneShape.h>

#include <algorithm>
#include <new>

#include "approach.h"
#include "contact_normals.h"
#include "volume_shape.h"

namespace {

// Orientations that Bullet tries, and the number of points from which on it does not. As for polyhedra on planes.
constexpr int PERTURBATIONS = 4, ENOUGH_POINTS = 4;

bool is_deep(const btManifoldResult &result) {
  const btPersistentManifold *const manifold = result.getPersistentManifold();
  if (!manifold) return false;
  btScalar least = 0;
  for (int i = 0; i < manifold->getNumContacts(); ++i)
    least = std::min(least, manifold->getContactPoint(i).getDistance());
  return least < -manifold->getContactBreakingThreshold();
}

// As in btCollisionDispatcher::getNewManifold.
btScalar breaking_threshold(const btCollisionObject &object) {
  return object.getCollisionShape()->getContactBreakingThreshold(gContactBreakingThreshold);
}

class ConvexPair final : public btConvexConvexAlgorithm {
 public:
  ConvexPair(const btCollisionAlgorithmConstructionInfo &info, const btCollisionObjectWrapper *first,
             const btCollisionObjectWrapper *second, btConvexPenetrationDepthSolver *depth_solver, NearContacts *near,
             FaceContacts *faces)
      : btConvexConvexAlgorithm(info.m_manifold, info, first, second, depth_solver, 0, 0),
        depth_solver_(depth_solver),
        near_(near),
        faces_(faces) {}

  void processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                        const btDispatcherInfo &info, btManifoldResult *result) override {
    normals_.turn(*first, *second);
    btConvexConvexAlgorithm::processCollision(first, second, info, result);
    const Replaced replaced = faces_->replace(*first, *second, *result);
    // Both ends of a line are enough, also for a pair that approaches fast: round sides get no further while they roll.
    near_->add(*first, *second, *result, info.m_timeStep, replaced == Replaced::Line);
    if (replaced == Replaced::None && is_deep(*result)) find_resting_points(first, second, info, result);
    normals_.keep(*first, *second, *result);
  }

 private:
  void find_resting_points(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                           const btDispatcherInfo &info, btManifoldResult *result) {
    btCollisionAlgorithmConstructionInfo made(m_dispatcher, 1);
    btConvexConvexAlgorithm perturbed(result->getPersistentManifold(), made, first, second, depth_solver_,
                                      PERTURBATIONS, ENOUGH_POINTS);
    perturbed.processCollision(first, second, info, result);
  }

  btConvexPenetrationDepthSolver *const depth_solver_;
  NearContacts *const near_;
  FaceContacts *const faces_;
  ContactNormals normals_;
};

class BoxPair final : public btBoxBoxCollisionAlgorithm {
 public:
  BoxPair(const btCollisionAlgorithmConstructionInfo &info, const btCollisionObjectWrapper *first,
          const btCollisionObjectWrapper *second, NearContacts *near)
      : btBoxBoxCollisionAlgorithm(nullptr, info, first, second), near_(near) {}

  void processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                        const btDispatcherInfo &info, btManifoldResult *result) override {
    normals_.turn(*first, *second);
    btBoxBoxCollisionAlgorithm::processCollision(first, second, info, result);
    near_->add(*first, *second, *result, info.m_timeStep);
    normals_.keep(*first, *second, *result);
  }

 private:
  NearContacts *const near_;
  ContactNormals normals_;
};

// A compound and another shape, part by part. Bullet looks at the parts whose bounding boxes overlap, so that they have no
// contacts before they do. Here they have them from the threshold on, and those of fast bodies before.
class PartsPair final : public btCollisionAlgorithm {
 public:
  PartsPair(const btCollisionAlgorithmConstructionInfo &info, bool is_swapped)
      : btCollisionAlgorithm(info), is_swapped_(is_swapped) {}

  ~PartsPair() override {
    for (int i = 0; i < parts_.size(); ++i) drop(i);
  }

  void processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                        const btDispatcherInfo &info, btManifoldResult *result) override {
    const btCollisionObjectWrapper &whole = is_swapped_ ? *second : *first, &other = is_swapped_ ? *first : *second;
    const auto &compound = static_cast<const btCompoundShape &>(*whole.getCollisionShape());
    if (parts_.size() != compound.getNumChildShapes()) parts_.resize(compound.getNumChildShapes(), nullptr);
    const btCollisionObject &one = *whole.getCollisionObject(), &two = *other.getCollisionObject();
    const btScalar threshold = std::min(breaking_threshold(one), breaking_threshold(two));
    const btScalar reach = std::max(threshold, Approach(one, two, info.m_timeStep).bound());
    btVector3 low, high, part_low, part_high;
    other.getCollisionShape()->getAabb(other.getWorldTransform(), low, high);
    low -= btVector3(reach, reach, reach);
    high += btVector3(reach, reach, reach);
    for (int i = 0; i < parts_.size(); ++i) {
      const btCollisionShape &shape = *compound.getChildShape(i);
      const btTransform pose = whole.getWorldTransform() * compound.getChildTransform(i);
      shape.getAabb(pose, part_low, part_high);
      if (!TestAabbAgainstAabb2(low, high, part_low, part_high)) {
        drop(i);
        continue;
      }
      const btCollisionObjectWrapper part(&whole, &shape, &one, pose, -1, i);
      if (!parts_[i]) parts_[i] = m_dispatcher->findAlgorithm(&part, &other, nullptr, BT_CONTACT_POINT_ALGORITHMS);
      if (!parts_[i]) continue;
      const bool is_first = result->getBody0Internal() == &one;
      const btCollisionObjectWrapper *const before = is_first ? result->getBody0Wrap() : result->getBody1Wrap();
      is_first ? result->setBody0Wrap(&part) : result->setBody1Wrap(&part);
      parts_[i]->processCollision(&part, &other, info, result);
      is_first ? result->setBody0Wrap(before) : result->setBody1Wrap(before);
    }
  }

  btScalar calculateTimeOfImpact(btCollisionObject *, btCollisionObject *, const btDispatcherInfo &,
                                 btManifoldResult *) override {
    return 1;
  }

  void getAllContactManifolds(btManifoldArray &all) override {
    for (int i = 0; i < parts_.size(); ++i) {
      if (parts_[i]) parts_[i]->getAllContactManifolds(all);
    }
  }

 private:
  void drop(int i) {
    if (!parts_[i]) return;
    parts_[i]->~btCollisionAlgorithm();
    m_dispatcher->freeCollisionAlgorithm(parts_[i]);
    parts_[i] = nullptr;
  }

  const bool is_swapped_;
  // By the index of the part; null: it is far from the other shape.
  btAlignedObjectArray<btCollisionAlgorithm *> parts_;
};

bool has_mesh(const btCollisionObject &object) {
  const AmbObject *const owner = object_of(&object);
  const auto is_mesh = [](const AmbShape &shape) { return shape.needs_gimpact || shape.has_volume; };
  if (owner->kind == ObjectKind::Ghost) return is_mesh(*static_cast<const AmbGhost *>(owner)->shape);
  return owner->kind == ObjectKind::Body && is_mesh(*static_cast<const AmbBody *>(owner)->shape);
}

class SpherePair final : public btSphereSphereCollisionAlgorithm {
 public:
  SpherePair(const btCollisionAlgorithmConstructionInfo &info, const btCollisionObjectWrapper *first,
             const btCollisionObjectWrapper *second)
      : btSphereSphereCollisionAlgorithm(nullptr, info, first, second),
        threshold_(std::min(breaking_threshold(*first), breaking_threshold(*second))) {}

  void processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                        const btDispatcherInfo &info, btManifoldResult *result) override {
    const btScalar restitution =
        btManifoldResult::calculateCombinedRestitution(first->getCollisionObject(), second->getCollisionObject());
    if (restitution == 0) result->m_closestPointDistanceThreshold = threshold_;
    btSphereSphereCollisionAlgorithm::processCollision(first, second, info, result);
  }

 private:
  // As in btCollisionDispatcher::getNewManifold.
  static btScalar breaking_threshold(const btCollisionObjectWrapper &object) {
    return object.getCollisionShape()->getContactBreakingThreshold(gContactBreakingThreshold);
  }

  const btScalar threshold_;
};

// Calls `use` with all points of a shape, in its own frame, on which it can rest on a plane in the direction `down`, a
// unit vector: the vertices of a polyhedron; of shapes with an axis of symmetry the lowest point of each end, and two
// more of a rim, 120 degrees from it.
template <class Use>
void for_resting_points(const btCollisionShape &shape, const btVector3 &down, Use use) {
  const auto ends = [&](int axis, const btScalar(&at)[2], const btScalar(&radii)[2], btScalar margin) {
    btVector3 along(0, 0, 0), across(0, 0, 0);
    along[axis] = 1;
    const btVector3 radial = down - along * down.dot(along);
    const btScalar length = radial.length();
    // A base that is parallel to the plane has no lowest point; Bullet takes this one.
    across[axis == 0 ? 1 : 0] = 1;
    if (length > 0) across = radial / length;
    const btVector3 beside = along.cross(across) * (btSqrt(btScalar(3)) / 2);
    for (int end = 0; end < 2; ++end) {
      const btVector3 centre = along * at[end] + down * margin;
      use(centre + across * radii[end]);
      if (radii[end] <= 0) continue;
      use(centre + (across * btScalar(-0.5) + beside) * radii[end]);
      use(centre + (across * btScalar(-0.5) - beside) * radii[end]);
    }
  };
  switch (shape.getShapeType()) {
    case CYLINDER_SHAPE_PROXYTYPE: {
      const auto &cylinder = static_cast<const btCylinderShape &>(shape);
      const btVector3 half = cylinder.getHalfExtentsWithoutMargin();
      const int axis = cylinder.getUpAxis();
      const btScalar radius = half[axis == 0 ? 1 : 0];
      return ends(axis, {half[axis], -half[axis]}, {radius, radius}, cylinder.getMargin());
    }
    case CONE_SHAPE_PROXYTYPE: {
      const auto &cone = static_cast<const btConeShape &>(shape);
      const btScalar half = cone.getHeight() / 2;
      return ends(cone.getConeUpIndex(), {half, -half}, {0, cone.getRadius()}, cone.getMargin());
    }
    case CAPSULE_SHAPE_PROXYTYPE: {
      const auto &capsule = static_cast<const btCapsuleShape &>(shape);
      const btScalar half = capsule.getHalfHeight();
      return ends(capsule.getUpAxis(), {half, -half}, {0, 0}, capsule.getRadius());
    }
    default:
      break;
  }
  if (!shape.isPolyhedral()) return;
  const auto &polyhedron = static_cast<const btPolyhedralConvexShape &>(shape);
  for (int i = 0; i < polyhedron.getNumVertices(); ++i) {
    btVector3 vertex;
    polyhedron.getVertex(i, vertex);
    // The vertices of a box are those of its surface.
    use(shape.getShapeType() == BOX_SHAPE_PROXYTYPE ? vertex : vertex + down * polyhedron.getMargin());
  }
}

class ConvexOnPlane final : public btConvexPlaneCollisionAlgorithm {
 public:
  ConvexOnPlane(const btCollisionAlgorithmConstructionInfo &info, const btCollisionObjectWrapper *first,
                const btCollisionObjectWrapper *second, bool is_swapped)
      : btConvexPlaneCollisionAlgorithm(nullptr, info, first, second, is_swapped, PERTURBATIONS, ENOUGH_POINTS),
        is_swapped_(is_swapped) {
    const btCollisionObjectWrapper &object = is_swapped ? *second : *first;
    btVector3 low, high;
    object.getCollisionShape()->getAabb(btTransform::getIdentity(), low, high);
    centre_ = (low + high) / 2;
    reach_ = (high - low) / 2;
    threshold_ = breaking_threshold(*object.getCollisionObject());
  }

  void processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                        const btDispatcherInfo &info, btManifoldResult *result) override {
    const btCollisionObjectWrapper &object = is_swapped_ ? *second : *first, &ground = is_swapped_ ? *first : *second;
    const auto &plane = static_cast<const btStaticPlaneShape &>(*ground.getCollisionShape());
    const btTransform &pose = object.getWorldTransform(), &frame = ground.getWorldTransform();
    const btVector3 normal = frame.getBasis() * plane.getPlaneNormal();
    // Bullet evaluates the support function of all vertices of a shape, however far it is from the plane: planes have no
    // bounding box that would keep the pair out of the broad phase.
    const btScalar height = normal.dot(pose * centre_ - frame.getOrigin()) - plane.getPlaneConstant();
    if (!has_contacts_ && height - (normal * pose.getBasis()).absolute().dot(reach_) > threshold_) return;
    btConvexPlaneCollisionAlgorithm::processCollision(first, second, info, result);
    has_contacts_ = result->getPersistentManifold() && result->getPersistentManifold()->getNumContacts() > 0;
    if (!is_deep(*result)) return;
    for_resting_points(*object.getCollisionShape(), -(normal * pose.getBasis()), [&](const btVector3 &at) {
      const btVector3 point = pose * at;
      const btScalar distance = normal.dot(point - frame.getOrigin()) - plane.getPlaneConstant();
      if (distance < result->getPersistentManifold()->getContactBreakingThreshold())
        result->addContactPoint(normal, point - normal * distance, distance);
    });
  }

 private:
  const bool is_swapped_;
  bool has_contacts_ = false;
  // Centre and half extents of the bounding box of the object in its own frame, m, and the distance up to which contacts are kept, m.
  btVector3 centre_, reach_;
  btScalar threshold_;
};

// In the dispatcher's pool.
template <class Algorithm, class... Arguments>
btCollisionAlgorithm *create(const btCollisionAlgorithmConstructionInfo &info, Arguments... arguments) {
  static_assert(sizeof(Algorithm) <= MAX_ALGORITHM_SIZE);
  return new (info.m_dispatcher1->allocateCollisionAlgorithm(sizeof(Algorithm))) Algorithm(info, arguments...);
}

}  // namespace

btCollisionAlgorithm *ContactAlgorithms::Pairs::CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                                         const btCollisionObjectWrapper *first,
                                                                         const btCollisionObjectWrapper *second) {
  return create<ConvexPair>(info, first, second, m_pdSolver, near, faces);
}

btCollisionAlgorithm *ContactAlgorithms::Boxes::CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                                         const btCollisionObjectWrapper *first,
                                                                         const btCollisionObjectWrapper *second) {
  return create<BoxPair>(info, first, second, near);
}

btCollisionAlgorithm *ContactAlgorithms::Compounds::CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                                             const btCollisionObjectWrapper *first,
                                                                             const btCollisionObjectWrapper *second) {
  const bool are_both = first->getCollisionShape()->isCompound() && second->getCollisionShape()->isCompound();
  if (are_both && !has_mesh(*first->getCollisionObject()) && !has_mesh(*second->getCollisionObject())) {
    void *const memory = info.m_dispatcher1->allocateCollisionAlgorithm(sizeof(btCompoundCompoundCollisionAlgorithm));
    return new (memory) btCompoundCompoundCollisionAlgorithm(info, first, second, false);
  }
  return create<PartsPair>(info, m_swapped);
}

btCollisionAlgorithm *ContactAlgorithms::Spheres::CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                                           const btCollisionObjectWrapper *first,
                                                                           const btCollisionObjectWrapper *second) {
  return create<SpherePair>(info, first, second);
}

btCollisionAlgorithm *ContactAlgorithms::Planes::CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                                          const btCollisionObjectWrapper *first,
                                                                          const btCollisionObjectWrapper *second) {
  return create<ConvexOnPlane>(info, first, second, m_swapped);
}

void ContactAlgorithms::enable(btCollisionDispatcher &dispatcher, btCollisionConfiguration &configuration) {
  const auto created_by = [&](int first, int second) {
    return configuration.getCollisionAlgorithmCreateFunc(first, second);
  };
  const auto *const of_pairs = created_by(CONVEX_HULL_SHAPE_PROXYTYPE, CONVEX_HULL_SHAPE_PROXYTYPE);
  const auto *const of_planes = created_by(CONVEX_HULL_SHAPE_PROXYTYPE, STATIC_PLANE_PROXYTYPE);
  dispatcher.registerCollisionCreateFunc(SPHERE_SHAPE_PROXYTYPE, SPHERE_SHAPE_PROXYTYPE, &spheres_);
  dispatcher.registerCollisionCreateFunc(BOX_SHAPE_PROXYTYPE, BOX_SHAPE_PROXYTYPE, &boxes_);
  for (int type = 0; type < CONCAVE_SHAPES_START_HERE; ++type) {
    dispatcher.registerCollisionCreateFunc(COMPOUND_SHAPE_PROXYTYPE, type, &compound_first_);
    dispatcher.registerCollisionCreateFunc(type, COMPOUND_SHAPE_PROXYTYPE, &compound_second_);
  }
  dispatcher.registerCollisionCreateFunc(COMPOUND_SHAPE_PROXYTYPE, COMPOUND_SHAPE_PROXYTYPE, &compound_first_);
  for (int first = 0; first < CONCAVE_SHAPES_START_HERE; ++first) {
    for (int second = 0; second < CONCAVE_SHAPES_START_HERE; ++second) {
      if (created_by(first, second) == of_pairs) dispatcher.registerCollisionCreateFunc(first, second, &pairs_);
    }
    if (created_by(first, STATIC_PLANE_PROXYTYPE) != of_planes) continue;
    dispatcher.registerCollisionCreateFunc(first, STATIC_PLANE_PROXYTYPE, &plane_second_);
    dispatcher.registerCollisionCreateFunc(STATIC_PLANE_PROXYTYPE, first, &plane_first_);
  }
}

void ContactAlgorithms::add_volumes(btCollisionDispatcher &dispatcher) {
  meshes_.enable(dispatcher, VOLUME_SHAPE_TYPE);
  dispatcher.registerCollisionCreateFunc(COMPOUND_SHAPE_PROXYTYPE, VOLUME_SHAPE_TYPE, &compound_first_);
  dispatcher.registerCollisionCreateFunc(VOLUME_SHAPE_TYPE, COMPOUND_SHAPE_PROXYTYPE, &compound_second_);
}

void ContactAlgorithms::add_mesh(const AmbShape &shape, btCollisionDispatcher &dispatcher) {
  MeshContacts::prepare(shape);
  meshes_.enable(dispatcher, GIMPACT_SHAPE_PROXYTYPE);
  dispatcher.registerCollisionCreateFunc(COMPOUND_SHAPE_PROXYTYPE, GIMPACT_SHAPE_PROXYTYPE, &compound_first_);
  dispatcher.registerCollisionCreateFunc(GIMPACT_SHAPE_PROXYTYPE, COMPOUND_SHAPE_PROXYTYPE, &compound_second_);
}
