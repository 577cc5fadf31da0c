#include "internal.h"

#include <BulletCollision/CollisionShapes/btEmptyShape.h>
#include <BulletCollision/Gimpact/btGImpactShape.h>

namespace {

AmbShape *own(btCollisionShape *shape, double margin) {
  auto *owner = new AmbShape;
  owner->shape.reset(shape);
  shape->setMargin(margin);
  return owner;
}

template <typename X, typename Y, typename Z>
btCollisionShape *along(int axis, btScalar radius, btScalar height) {
  switch (axis) {
    case 0: return new X(radius, height);
    case 1: return new Y(radius, height);
    default: return new Z(radius, height);
  }
}

// Triangles share vertices, so that a mesh on a plane has one contact per vertex.
std::shared_ptr<btTriangleMesh> triangle_mesh(const double *vertices, int n, const unsigned *triangles, int m) {
  // Bullet's allocator, unlike std::make_shared, clears memory.
  std::shared_ptr<btTriangleMesh> mesh(new btTriangleMesh);
  mesh->preallocateVertices(n);
  mesh->preallocateIndices(3 * m);
  for (int i = 0; i < n; ++i) mesh->findOrAddVertex(vector_of(vertices + 3 * i), false);
  for (int i = 0; i < m; ++i) {
    const unsigned *t = triangles + 3 * i;
    mesh->addTriangleIndices(static_cast<int>(t[0]), static_cast<int>(t[1]), static_cast<int>(t[2]));
  }
  return mesh;
}

// Members of a GImpact shape that it has no functions for.
struct PartInside : btGImpactMeshShapePart {
  static btGImpactBoxSet &boxes(btGImpactMeshShapePart &part) { return part.*(&PartInside::m_box_set); }
  static btAABB &bounds(btGImpactMeshShapePart &part) { return part.*(&PartInside::m_localAABB); }
  static bool &needs_update(btGImpactMeshShapePart &part) { return part.*(&PartInside::m_needs_update); }
};
struct BoxesInside : btGImpactBoxSet {
  static btQuantizedBvhTree &tree(btGImpactBoxSet &boxes) { return boxes.*(&BoxesInside::m_box_tree); }
};
struct TreeInside : btQuantizedBvhTree {
  // Makes `to` the tree `from`, whose nodes both then have; `from` owns them.
  static void alias(btQuantizedBvhTree &to, btQuantizedBvhTree &from) {
    auto &nodes = from.*(&TreeInside::m_node_array);
    (to.*(&TreeInside::m_node_array)).initializeFromBuffer(nodes.size() ? &nodes[0] : nullptr, nodes.size(), nodes.size());
    to.*(&TreeInside::m_num_nodes) = from.*(&TreeInside::m_num_nodes);
    to.*(&TreeInside::m_global_bound) = from.*(&TreeInside::m_global_bound);
    to.*(&TreeInside::m_bvhQuantization) = from.*(&TreeInside::m_bvhQuantization);
  }
};

// Queries of a GImpact shape write to it: they count locks of its mesh. So each world has a shape of its own, without a tree:
// nodes are written by buildSet and update alone, which a shape calls when it has no nodes, or when its margin or scale was
// changed, which nobody does after this.
std::unique_ptr<btGImpactMeshShape> gimpact_twin(btGImpactMeshShape &original, btStridingMeshInterface *mesh) {
  auto twin = std::make_unique<btGImpactMeshShape>(mesh);
  twin->setMargin(original.getMargin());
  for (int i = 0; i < original.getMeshPartCount(); ++i) {
    btGImpactMeshShapePart &from = *original.getMeshPart(i), &to = *twin->getMeshPart(i);
    TreeInside::alias(BoxesInside::tree(PartInside::boxes(to)), BoxesInside::tree(PartInside::boxes(from)));
    PartInside::bounds(to) = PartInside::bounds(from);
    PartInside::needs_update(to) = false;
    // The first lock tells the part how many triangles it has.
    to.lockChildShapes();
    to.unlockChildShapes();
  }
  twin->updateBound();
  return twin;
}

}  // namespace

extern "C" {

int amb_scalar_size(void) {
  static_assert(sizeof(btTransform) == 16 * sizeof(btScalar), "btTransform has an unexpected layout");
  return static_cast<int>(sizeof(btScalar));
}

AmbShape *amb_shape_empty(void) { return own(new btEmptyShape, 0); }

AmbShape *amb_shape_box(const double half_extents[3], double margin) {
  return own(new btBoxShape(vector_of(half_extents)), margin);
}

AmbShape *amb_shape_sphere(double radius, double margin) { return own(new btSphereShape(radius), margin); }

AmbShape *amb_shape_cylinder(int axis, double radius, double half_height, double margin) {
  switch (axis) {
    case 0: return own(new btCylinderShapeX(btVector3(half_height, radius, radius)), margin);
    case 1: return own(new btCylinderShape(btVector3(radius, half_height, radius)), margin);
    default: return own(new btCylinderShapeZ(btVector3(radius, radius, half_height)), margin);
  }
}

AmbShape *amb_shape_capsule(int axis, double radius, double height, double margin) {
  return own(along<btCapsuleShapeX, btCapsuleShape, btCapsuleShapeZ>(axis, radius, height), margin);
}

AmbShape *amb_shape_cone(int axis, double radius, double height, double margin) {
  return own(along<btConeShapeX, btConeShape, btConeShapeZ>(axis, radius, height), margin);
}

AmbShape *amb_shape_plane(const double normal[3], double offset, double margin) {
  return own(new btStaticPlaneShape(vector_of(normal), offset), margin);
}

AmbShape *amb_shape_convex_hull(const double *vertices, int n, double margin) {
  auto *hull = new btConvexHullShape;
  for (int i = 0; i < n; ++i) hull->addPoint(vector_of(vertices + 3 * i), false);
  hull->recalcLocalAabb();
  return own(hull, margin);
}

AmbShape *amb_shape_convex_part(const double *vertices, int n, double margin) {
  AmbShape *owner = amb_shape_convex_hull(vertices, n, margin);
  owner->is_part = true;
  return owner;
}

AmbShape *amb_shape_convex_triangle_mesh(const double *vertices, int n, const unsigned *triangles, int m,
                                         double margin) {
  auto mesh = triangle_mesh(vertices, n, triangles, m);
  AmbShape *owner = own(new btConvexTriangleMeshShape(mesh.get()), margin);
  owner->mesh = std::move(mesh);
  return owner;
}

AmbShape *amb_shape_gimpact(const double *vertices, int n, const unsigned *triangles, int m, double margin) {
  auto mesh = triangle_mesh(vertices, n, triangles, m);
  auto *shape = new btGImpactMeshShape(mesh.get());
  AmbShape *owner = own(shape, margin);
  shape->updateBound();
  owner->mesh = std::move(mesh);
  owner->topology = std::make_shared<TopologyHolder>();
  shape->setUserPointer(owner->topology.get());
  owner->needs_gimpact = true;
  return owner;
}

AmbShape *amb_shape_compound(void) {
  auto *owner = new AmbShape;
  owner->shape.reset(new btCompoundShape);
  return owner;
}

void amb_shape_compound_add(AmbShape *compound, AmbShape *child, const double pose[12]) {
  if (child->is_part) child->shape->setUserIndex(static_cast<int>(compound->children.size()));
  static_cast<btCompoundShape &>(*compound->shape).addChildShape(transform_of(pose), child->shape.get());
  compound->needs_gimpact |= child->needs_gimpact;
  compound->has_volume |= child->has_volume;
  compound->children.emplace_back(child);
}

AmbShape *amb_shape_simplify(AmbShape *shape) {
  // Nobody else may be reading it.
  if (shape->shape->getShapeType() == CONVEX_HULL_SHAPE_PROXYTYPE && shape->shape.use_count() == 1) {
    static_cast<btConvexHullShape &>(*shape->shape).recalcLocalAabb();
  }
  if (!shape->shape->isCompound() || shape->children.size() != 1) return shape;
  const auto &compound = static_cast<const btCompoundShape &>(*shape->shape);
  if (!(compound.getChildTransform(0) == btTransform::getIdentity())) return shape;
  AmbShape *child = shape->children[0].release();
  // The destructor of the compound does not access its child, whose ownership was released above.
  delete shape;
  return amb_shape_simplify(child);
}

AmbShape *amb_shape_twin(const AmbShape *shape) {
  auto *owner = new AmbShape;
  owner->needs_gimpact = shape->needs_gimpact;
  owner->mesh = shape->mesh;
  owner->inner_radius = shape->inner_radius;
  switch (shape->shape->getShapeType()) {
    case COMPOUND_SHAPE_PROXYTYPE: {
      // The tree of its children is made again: same children in the same order make the same tree.
      auto *compound = new btCompoundShape;
      owner->shape.reset(compound);
      const auto &original = static_cast<const btCompoundShape &>(*shape->shape);
      for (size_t i = 0; i < shape->children.size(); ++i) {
        owner->children.emplace_back(amb_shape_twin(shape->children[i].get()));
        compound->addChildShape(original.getChildTransform(static_cast<int>(i)), owner->children.back()->shape.get());
      }
      break;
    }
    case GIMPACT_SHAPE_PROXYTYPE:
      owner->shape = gimpact_twin(static_cast<btGImpactMeshShape &>(*shape->shape), shape->mesh.get());
      owner->original = shape->original ? shape->original : shape->shape;
      owner->topology = shape->topology;
      owner->shape->setUserPointer(owner->topology.get());
      break;
    default:
      // Hulls, convex meshes and primitives are never written to once they are made: what collision detection, rays, bounding
      // boxes and inertia call is const, and computes nothing on demand. Writers would be setMargin and setLocalScaling, which
      // are called in `own` only, recalcLocalAabb (amb_shape_simplify, before there are twins), setUserIndex
      // (amb_shape_compound_add, before as well), initializePolyhedralFeatures, which nobody uses, and the user pointer of a
      // shape, which is that of meshes (amb_shape_gimpact). Bodies keep what is theirs in the collision object.
      owner->shape = shape->shape;
  }
  return owner;
}

void amb_shape_free(AmbShape *shape) { delete shape; }

void amb_shape_inertia(const AmbShape *shape, double mass, double inertia[3]) {
  btVector3 moments(0, 0, 0);
  // btEmptyShape::calculateLocalInertia asserts, and in release builds does not write the result.
  if (shape->shape->getShapeType() != EMPTY_SHAPE_PROXYTYPE) shape->shape->calculateLocalInertia(mass, moments);
  write_vector(moments, inertia);
}

void amb_shape_aabb(const AmbShape *shape, double bounds[6]) {
  btVector3 low(0, 0, 0), high(0, 0, 0);
  shape->shape->getAabb(btTransform::getIdentity(), low, high);
  write_vector(low, bounds);
  write_vector(high, bounds + 3);
}

}  // extern "C"
