#include "mesh_contacts.h"

#include <algorithm>
#include <cmath>
#include <new>

#include <BulletCollision/CollisionDispatch/btCollisionDispatcher.h>
#include <BulletCollision/CollisionDispatch/btCollisionObjectWrapper.h>
#include <BulletCollision/CollisionDispatch/btCompoundCompoundCollisionAlgorithm.h>
#include <BulletCollision/CollisionDispatch/btManifoldResult.h>
#include <BulletCollision/CollisionShapes/btBoxShape.h>
#include <BulletCollision/CollisionShapes/btTriangleShape.h>
#include <BulletCollision/Gimpact/btGImpactShape.h>
#include <BulletCollision/NarrowPhaseCollision/btGjkPairDetector.h>
#include <BulletCollision/NarrowPhaseCollision/btPointCollector.h>
#include <BulletCollision/NarrowPhaseCollision/btVoronoiSimplexSolver.h>

#include "approach.h"
#include "mesh_topology.h"
#include "volume_shape.h"

namespace {

// Manifolds of a pair: as many walls may a body touch at a time.
constexpr int MOST_GROUPS = 4;

// Finds the contacts of one shape with the triangles near it, in the frame of the mesh.
class Narrow final : public btTriangleCallback {
 public:
  Narrow(MeshContacts &memory, const btConvexShape &shape, const btTransform &pose, btScalar mesh_margin, btScalar threshold,
         const Approach &approach, const btMatrix3x3 &frame, btScalar correction)
      : memory_(memory),
        shape_(shape),
        pose_(pose),
        mesh_margin_(mesh_margin),
        threshold_(threshold),
        approach_(approach),
        frame_(frame),
        correction_(correction),
        is_thin_(approach.bound() + correction > least_size(shape) / 2 + mesh_margin),
        reach_(is_thin_ ? std::max(approach.bound() + correction, threshold) : threshold),
        is_box_(shape.getShapeType() == BOX_SHAPE_PROXYTYPE),
        sharp_box_(is_box_ ? static_cast<const btBoxShape &>(shape).getHalfExtentsWithMargin() : btVector3(1, 1, 1)) {
    sharp_box_.setMargin(0);
    shape.getAabb(btTransform::getIdentity(), own_low_, own_high_);
    shape.getAabb(pose, low_, high_);
    const btScalar wider = mesh_margin + reach_;
    low_ -= btVector3(wider, wider, wider);
    high_ += btVector3(wider, wider, wider);
  }

  const btVector3 &low() const { return low_; }
  const btVector3 &high() const { return high_; }
  btScalar reach() const { return reach_; }
  // It may get more than half through the surface in the sub-step, and has its contacts before.
  bool is_thin() const { return is_thin_; }

  // The triangles that come next are those of this mesh.
  void begin(const MeshTopology &mesh) { mesh_ = &mesh; }

  // Whether a triangle is too far for contacts. Cheaper than to look for them: most triangles near a body that lies on a fine
  // mesh are below it, but far beside of what it touches.
  bool is_far(const btVector3 &a, const btVector3 &b, const btVector3 &c) const {
    const btVector3 middle = (a + b + c) / 3;
    return is_far(middle, btSqrt(std::max({middle.distance2(a), middle.distance2(b), middle.distance2(c)})));
  }

  // The same of a ball around `middle`.
  bool is_far(const btVector3 &middle, btScalar radius) const {
    const btScalar least = radius + reach_ + mesh_margin_;
    const btVector3 at = pose_.invXform(middle);
    btVector3 inside = at;
    inside.setMax(own_low_);
    inside.setMin(own_high_);
    if (at.distance2(inside) > least * least) return true;
    if (is_box_) return false;
    btVector3 way = pose_.getOrigin() - middle;
    const btScalar length = way.length();
    if (!(length > 0)) return false;
    way /= length;
    return lowest(way) - margin() - way.dot(middle) > least;
  }

  // Leaves those of the contacts from `first` on, which came from one brick, that a selection among all may choose.
  void thin_out(size_t first) { thin_out_contacts(memory_.found, first, memory_.left, threshold_); }

  size_t found() const { return memory_.found.size(); }

  void processTriangle(btVector3 *, int, int index) override {
    const MeshTopology::Triangle &triangle = mesh_->triangles[index];
    if (triangle.is_degenerate) return;
    const btVector3 corners[3] = {mesh_->vertices[triangle.corners[0]], mesh_->vertices[triangle.corners[1]],
                                  mesh_->vertices[triangle.corners[2]]};
    btVector3 normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalized();
    const btScalar level = normal.dot(corners[0]);
    const btScalar below = lowest(normal) - level, above = -lowest(-normal) - level;
    btScalar height = below;
    if (below + above < 0) {
      normal = -normal;
      height = -above;
    }
    const btVector3 nearest_point = pose_(solid().localGetSupportingVertexWithoutMargin(-normal * pose_.getBasis()));
    if (normal.dot(nearest_point - corners[0]) - margin() - mesh_margin_ > reach_) return;
    const bool is_cut = !(height > 0);
    if (!is_cut || is_inside(corners, triangle, normal)) add_inside(corners, normal);
    for (int k = 0; k < 3; ++k) {
      if (triangle.edges[k] < 0) continue;
      const MeshTopology::Edge &edge = mesh_->edges[triangle.edges[k]];
      // Seen from this side the surface bends towards the body.
      if (!is_cut && rises(edge, normal)) continue;
      add_edge(edge);
    }
  }

 private:
  static btScalar least_size(const btConvexShape &shape) {
    btVector3 low, high;
    shape.getAabb(btTransform::getIdentity(), low, high);
    const btVector3 size = high - low;
    return size[size.minAxis()];
  }

  btVector3 core_support(const btVector3 &direction) const {
    return pose_(shape_.localGetSupportingVertexWithoutMargin(direction * pose_.getBasis()));
  }

  // Least coordinate of the core along a direction.
  btScalar lowest(const btVector3 &direction) const { return direction.dot(core_support(-direction)); }

  // Boxes have sharp edges here, as on planes; other shapes are their cores with a margin.
  btScalar margin() const { return ContactFeature::margin_of(shape_); }
  const btConvexShape &solid() const { return is_box_ ? sharp_box_ : shape_; }

  bool rises(const MeshTopology::Edge &edge, const btVector3 &normal) const {
    const btVector3 &start = mesh_->vertices[edge.ends[0]];
    for (int i = edge.first_wing; i < edge.last_wing; ++i) {
      const btVector3 to = mesh_->vertices[mesh_->wings[i]] - start;
      if (normal.dot(to) > btScalar(1e-3) * SMOOTH_BEND * to.length()) return true;
    }
    return false;
  }

  // Distance of the body from a triangle or, if two corners are the same, a segment; no result: farther than the threshold.
  btPointCollector nearest(const btTriangleShape &of) const {
    btVoronoiSimplexSolver simplex;
    btGjkPairDetector detector(&solid(), &of, &simplex, &memory_.depth_solver);
    btGjkPairDetector::ClosestPointInput input;
    const btScalar farthest = margin() + mesh_margin_ + reach_;
    input.m_maximumDistanceSquared = farthest * farthest;
    input.m_transformA = pose_;
    input.m_transformB.setIdentity();
    btPointCollector found;
    detector.getClosestPoints(input, found, nullptr);
    found.m_hasResult &= found.m_distance < reach_;
    return found;
  }

  // Whether a body whose core the plane of a triangle cuts touches its inside. Turns the normal to the side that it is on.
  bool is_inside(const btVector3 (&corners)[3], const MeshTopology::Triangle &triangle, btVector3 &normal) const {
    btTriangleShape shape(corners[0], corners[1], corners[2]);
    shape.setMargin(mesh_margin_);
    const btPointCollector found = nearest(shape);
    if (!found.m_hasResult) return false;
    const btVector3 &way = found.m_normalOnBInWorld;
    const btScalar cosine = way.dot(normal);
    if (std::abs(cosine) > btScalar(0.999)) {
      if (cosine < 0) normal = -normal;
      return true;
    }
    // The corners that are farthest along the way out are what the body touches.
    btScalar heights[3];
    for (int k = 0; k < 3; ++k) heights[k] = way.dot(corners[k]);
    const int top = static_cast<int>(std::max_element(heights, heights + 3) - heights);
    for (int k : {top, (top + 2) % 3}) {
      const int other = k == top ? (k + 1) % 3 : k;
      const btVector3 along = corners[(k + 1) % 3] - corners[k];
      if (heights[top] - heights[other] > btScalar(1e-3) * along.length()) continue;
      return !is_normal_of_side(corners[k], corners[(k + 1) % 3], triangle.corners[k], triangle.corners[(k + 1) % 3], way);
    }
    return !mesh_->is_normal_of_vertex(triangle.corners[top], way);
  }

  // As MeshTopology::is_normal_of_edge, of any edge: smooth ones have no normals of their own. Third corners are those
  // vertices that both ends have as neighbours.
  bool is_normal_of_side(const btVector3 &start, const btVector3 &end, int first, int second, const btVector3 &way) const {
    const btVector3 along = (end - start).normalized();
    const auto begin = [&](int vertex) { return mesh_->neighbours.begin() + mesh_->first_neighbour[vertex]; };
    for (auto i = begin(first); i != begin(first + 1); ++i) {
      if (!std::binary_search(begin(second), begin(second + 1), *i)) continue;
      const btVector3 to = mesh_->vertices[*i] - start, across = to - along * to.dot(along);
      if (way.dot(across) > SMOOTH_BEND * across.length()) return false;
    }
    return true;
  }

  // Neighbouring triangles of a flat surface have the same normal, to the bit.
  void find_feature(const btVector3 &normal) {
    if (normal == last_normal_) return memory_.feature.find_again();
    memory_.feature.find(shape_, pose_, normal, reach_);
    last_normal_ = normal;
  }

  void add_inside(const btVector3 (&corners)[3], const btVector3 &normal) {
    find_feature(normal);
    const btScalar level = normal.dot(corners[0]);
    btScalar height = 0;
    for (const btVector3 &point : memory_.feature.points()) height = std::max(height, normal.dot(point) - level);
    const btVector3 middle = (corners[0] + corners[1] + corners[2]) / 3;
    for (int k = 0; k < 3; ++k) {
      const btVector3 along = corners[(k + 1) % 3] - corners[k];
      btVector3 inwards = normal.cross(along).normalized();
      if (inwards.dot(middle - corners[k]) < 0) inwards = -inwards;
      const btScalar tolerance = SMOOTH_BEND * height + btScalar(1e-9) * along.length();
      memory_.feature.clip({inwards, inwards.dot(corners[k]) - tolerance});
    }
    add_feature(normal, level);
  }

  void add_edge(const MeshTopology::Edge &edge) {
    const btVector3 &start = mesh_->vertices[edge.ends[0]], &end = mesh_->vertices[edge.ends[1]];
    btVector3 low = start, high = start;
    low.setMin(end);
    high.setMax(end);
    if (!TestAabbAgainstAabb2(low, high, low_, high_)) return;
    btTriangleShape segment(start, end, end);
    segment.setMargin(mesh_margin_);
    const btPointCollector found = nearest(segment);
    if (!found.m_hasResult) return;
    const btVector3 &normal = found.m_normalOnBInWorld;
    const btVector3 along = (end - start).normalized();
    const btScalar slope = normal.dot(along);
    if (std::abs(slope) > btScalar(1e-3)) {
      if (!mesh_->is_normal_of_vertex(edge.ends[slope > 0], normal)) return;
      return add(normal, found.m_pointInWorld, found.m_distance);
    }
    if (!mesh_->is_normal_of_edge(edge, normal)) return;
    add(normal, found.m_pointInWorld, found.m_distance);
    // Where a face or edge of the body lies along the edge, both ends of what they have in common.
    find_feature(normal);
    if (memory_.feature.points().size() < 2) return;
    const btVector3 across = normal.cross(along).normalized();
    const btScalar width = btScalar(1e-6) * end.distance(start);
    memory_.feature.clip({along, along.dot(start)});
    memory_.feature.clip({-along, -along.dot(end)});
    memory_.feature.clip({across, across.dot(start) - width});
    memory_.feature.clip({-across, -across.dot(start) - width});
    add_feature(normal, normal.dot(start));
  }

  void add(const btVector3 &normal, const btVector3 &point, btScalar distance) {
    if (distance < threshold_ || distance < approach_.along(frame_ * normal) + correction_)
      memory_.found.push_back({normal, point, distance, false});
  }

  // Adds the points of the feature as contacts with a surface at `level` along the normal.
  void add_feature(const btVector3 &normal, btScalar level) {
    for (const btVector3 &point : memory_.feature.points()) {
      const btScalar height = normal.dot(point) - level;
      add(normal, point - normal * (height - mesh_margin_), height - mesh_margin_ - margin());
    }
  }

  MeshContacts &memory_;
  const MeshTopology *mesh_ = nullptr;
  const btConvexShape &shape_;
  // Of the body in the frame of the mesh.
  const btTransform pose_;
  const btScalar mesh_margin_, threshold_;
  // Axes of the mesh in the world, where the approach is known.
  const Approach &approach_;
  const btMatrix3x3 &frame_;
  // Motion by the correction of a penetration, m.
  const btScalar correction_;
  const bool is_thin_;
  // Distance from which on there may be contacts, m.
  const btScalar reach_;
  const bool is_box_;
  btBoxShape sharp_box_;
  btVector3 low_, high_;
  // Bounding box of the shape in its own frame.
  btVector3 own_low_, own_high_;
  // Of the feature that was found last.
  btVector3 last_normal_{0, 0, 0};
};

class ConvexOnMesh final : public btCollisionAlgorithm {
 public:
  ConvexOnMesh(const btCollisionAlgorithmConstructionInfo &info, MeshContacts &memory, bool is_mesh_first)
      : btCollisionAlgorithm(info), memory_(memory), is_mesh_first_(is_mesh_first) {}

  ~ConvexOnMesh() override { release_from(0); }

  void processCollision(const btCollisionObjectWrapper *first, const btCollisionObjectWrapper *second,
                        const btDispatcherInfo &info, btManifoldResult *result) override {
    const btCollisionObjectWrapper &body = is_mesh_first_ ? *second : *first, &ground = is_mesh_first_ ? *first : *second;
    const auto &mesh = static_cast<const btConcaveShape &>(*ground.getCollisionShape());
    const auto &shape = static_cast<const btConvexShape &>(*body.getCollisionShape());
    const btScalar threshold = std::min(breaking_threshold(*first), breaking_threshold(*second));
    const btTransform &frame = ground.getWorldTransform();
    const btTransform pose = frame.inverseTimes(body.getWorldTransform());
    const Approach approach(*body.getCollisionObject(), *ground.getCollisionObject(), info.m_timeStep);
    btScalar reach = threshold;
    bool is_thin = false;
    for (btScalar correction = 0;;) {
      Narrow narrow(memory_, shape, pose, mesh.getMargin(), threshold, approach, frame.getBasis(), correction);
      if (correction > 0 && !(narrow.reach() > reach)) break;
      reach = narrow.reach();
      is_thin = narrow.is_thin();
      memory_.found.clear();
      process(mesh, narrow);
      if (correction > 0) break;
      for (const SurfaceContact &contact : memory_.found)
        correction = std::max(correction, Approach::of_correction(-contact.distance));
      if (!(correction > 0)) break;
    }

    int groups = 0;
    for (; groups < MOST_GROUPS; ++groups) {
      const SurfaceContact *seed = nullptr;
      for (const SurfaceContact &contact : memory_.found) {
        if (!contact.is_done && (!seed || contact.distance < seed->distance)) seed = &contact;
      }
      if (!seed) break;
      const ContactSelection selection = select_contacts(memory_.found, *seed, pose.getOrigin(), threshold);
      btPersistentManifold *&manifold = manifolds_[groups];
      if (groups == count_) {
        manifold = m_dispatcher->getNewManifold(first->getCollisionObject(), second->getCollisionObject());
        ++count_;
      }
      manifold->clearManifold();
      result->setPersistentManifold(manifold);
      for (int i = 0; i < selection.count; ++i) {
        const SurfaceContact &contact = *selection.kept[i];
        const btVector3 normal = frame.getBasis() * contact.normal, point = frame(contact.point);
        // Bullet asks for the normal and the point of the second object.
        if (is_mesh_first_) {
          add_contact(*manifold, -normal, point + normal * contact.distance, contact.distance, is_thin);
        } else {
          add_contact(*manifold, normal, point, contact.distance, is_thin);
        }
      }
    }
    release_from(groups);
  }

  btScalar calculateTimeOfImpact(btCollisionObject *, btCollisionObject *, const btDispatcherInfo &,
                                 btManifoldResult *) override {
    return 1;
  }

  void getAllContactManifolds(btManifoldArray &all) override {
    for (int i = 0; i < count_; ++i) all.push_back(manifolds_[i]);
  }

 private:
  static void process(const btConcaveShape &mesh, Narrow &narrow) {
    if (mesh.getShapeType() != VOLUME_SHAPE_TYPE) {
      narrow.begin(*static_cast<const TopologyHolder *>(mesh.getUserPointer())->topology);
      return mesh.processAllTriangles(&narrow, narrow.low(), narrow.high());
    }
    const auto is_near = [&](const btVector3 &centre, btScalar radius) { return !narrow.is_far(centre, radius); };
    static_cast<const VolumeShape &>(mesh).for_bricks(narrow.low(), narrow.high(), is_near, [&](VolumeBrick &brick) {
      if (!brick.topology) brick.topology = std::make_shared<const MeshTopology>(brick);
      narrow.begin(*brick.topology);
      const size_t before = narrow.found();
      for (int i = 0; i < brick.own; ++i) {
        if (!brick.overlaps(i, narrow.low(), narrow.high())) continue;
        if (!narrow.is_far(brick.corner(i, 0), brick.corner(i, 1), brick.corner(i, 2))) narrow.processTriangle(nullptr, 0, i);
      }
      narrow.thin_out(before);
    });
  }

  // As in btCollisionDispatcher::getNewManifold.
  static btScalar breaking_threshold(const btCollisionObjectWrapper &object) {
    return object.getCollisionObject()->getCollisionShape()->getContactBreakingThreshold(gContactBreakingThreshold);
  }

  void release_from(int first) {
    while (count_ > first) m_dispatcher->releaseManifold(manifolds_[--count_]);
  }

  MeshContacts &memory_;
  const bool is_mesh_first_;
  int count_ = 0;
  btPersistentManifold *manifolds_[MOST_GROUPS];
};

}  // namespace

btCollisionAlgorithm *MeshContacts::Pairs::CreateCollisionAlgorithm(btCollisionAlgorithmConstructionInfo &info,
                                                                    const btCollisionObjectWrapper *,
                                                                    const btCollisionObjectWrapper *) {
  // In the dispatcher's pool, which has room for Bullet's own algorithms.
  static_assert(sizeof(ConvexOnMesh) <= sizeof(btCompoundCompoundCollisionAlgorithm));
  return new (info.m_dispatcher1->allocateCollisionAlgorithm(sizeof(ConvexOnMesh))) ConvexOnMesh(info, *owner, m_swapped);
}

void MeshContacts::enable(btCollisionDispatcher &dispatcher, int type_of_mesh) {
  mesh_first_.m_swapped = true;
  mesh_first_.owner = mesh_second_.owner = this;
  for (int type = 0; type < CONCAVE_SHAPES_START_HERE; ++type) {
    dispatcher.registerCollisionCreateFunc(type, type_of_mesh, &mesh_second_);
    dispatcher.registerCollisionCreateFunc(type_of_mesh, type, &mesh_first_);
  }
}

void MeshContacts::prepare(const AmbShape &shape) {
  for (const auto &child : shape.children) prepare(*child);
  if (shape.shape->getShapeType() != GIMPACT_SHAPE_PROXYTYPE) return;
  TopologyHolder &holder = *shape.topology;
  auto &mesh = static_cast<btGImpactMeshShape &>(*shape.shape);
  std::call_once(holder.is_made, [&] { holder.topology = std::make_shared<const MeshTopology>(mesh); });
}
