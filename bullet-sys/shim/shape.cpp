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
std::unique_ptr<btTriangleMesh> triangle_mesh(const double *vertices, int n, const unsigned *triangles, int m) {
  auto mesh = std::make_unique<btTriangleMesh>();
  mesh->preallocateVertices(n);
  mesh->preallocateIndices(3 * m);
  for (int i = 0; i < n; ++i) mesh->findOrAddVertex(vector_of(vertices + 3 * i), false);
  for (int i = 0; i < m; ++i) {
    const unsigned *t = triangles + 3 * i;
    mesh->addTriangleIndices(static_cast<int>(t[0]), static_cast<int>(t[1]), static_cast<int>(t[2]));
  }
  return mesh;
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
  owner->needs_gimpact = true;
  return owner;
}

AmbShape *amb_shape_compound(void) {
  auto *owner = new AmbShape;
  owner->shape = std::make_unique<btCompoundShape>();
  return owner;
}

void amb_shape_compound_add(AmbShape *compound, AmbShape *child, const double pose[12]) {
  static_cast<btCompoundShape &>(*compound->shape).addChildShape(transform_of(pose), child->shape.get());
  compound->needs_gimpact |= child->needs_gimpact;
  compound->children.emplace_back(child);
}

AmbShape *amb_shape_simplify(AmbShape *shape) {
  if (shape->shape->getShapeType() == CONVEX_HULL_SHAPE_PROXYTYPE) {
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
