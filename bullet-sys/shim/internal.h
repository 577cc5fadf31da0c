// Definitions of the opaque objects of the C interface. C++ only.
#ifndef AMB_INTERNAL_H
#define AMB_INTERNAL_H

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include <BulletCollision/CollisionDispatch/btGhostObject.h>
#include <BulletDynamics/MLCPSolvers/btMLCPSolverInterface.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>
#include <LinearMath/btHashMap.h>
#include <btBulletDynamicsCommon.h>

#include "arena_memory.h"
#include "extension.h"
#include "lazy_world.h"
#include "pair_cache.h"

extern "C" {
#include "shim.h"
}

struct AmbShape {
  // Members are destroyed in reverse order: the shape before the mesh and the children that it refers to.
  std::vector<std::unique_ptr<AmbShape>> children;
  // Twins (amb_shape_twin) share the mesh, and the shape where it is never written to after its construction.
  std::shared_ptr<btStridingMeshInterface> mesh;
  // The shape whose tree of triangles this one uses.
  std::shared_ptr<const btCollisionShape> original;
  std::shared_ptr<btCollisionShape> shape;
  // What twins need to find out only once: radius of the largest sphere about the origin within the shape; negative: not known.
  std::shared_ptr<std::atomic<double>> inner_radius = std::make_shared<std::atomic<double>>(-1.0);
  // Of a mesh that is not convex.
  std::shared_ptr<TopologyHolder> topology;
  bool needs_gimpact = false;
  // It is a volume or has one as a part.
  bool has_volume = false;
  // A hull of a decomposition; in a compound its user index is its place among the children.
  bool is_part = false;
};

enum class ObjectKind { Body, Ghost, SoftBody };

struct AmbWorld;

// Which objects of a model an object collides with, see amb_body_set_filter.
struct CollisionFilter {
  bool is_apart_from(const CollisionFilter &other) const {
    if (model == 0 || model != other.model) return false;
    if (includes(other) && other.includes(*this)) return false;
    if (cluster == other.cluster || (outer != 0 && outer == other.cluster) || (other.outer != 0 && other.outer == cluster)) return true;
    if ((kind & other.affinity) == 0 && (other.kind & affinity) == 0) return true;
    return std::binary_search(excluded.begin(), excluded.end(), other.member);
  }

  bool includes(const CollisionFilter &other) const { return std::binary_search(included.begin(), included.end(), other.member); }

  // 0: none.
  unsigned model = 0;
  unsigned member = 0, cluster = 0, outer = 0, kind = 0, affinity = 0;
  // Ascending.
  Vector<unsigned> excluded, included;
};

// The user pointer of every collision object points at its AmbObject.
struct AmbObject {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  explicit AmbObject(ObjectKind object_kind) : kind(object_kind) {}

  // Whether the two never collide because of what they are: of one family, in groups of which none is common, or by their filters.
  bool is_apart_from(const AmbObject &other) const {
    if (family != 0 && family == other.family) return true;
    if (filter && other.filter && filter->is_apart_from(*other.filter)) return true;
    if (groups.empty() || other.groups.empty()) return false;
    for (size_t i = 0, k = 0; i < groups.size() && k < other.groups.size();) {
      if (groups[i] == other.groups[k]) return false;
      groups[i] < other.groups[k] ? ++i : ++k;
    }
    return true;
  }

  // Whether the two do not collide now.
  bool ignores(const AmbObject &other) const {
    const AmbObject &newer = index > other.index ? *this : other, &older = index > other.index ? other : *this;
    return is_apart_from(other) || (newer.ignored.size() > 0 && newer.ignored.find(older.index));
  }

  // Adds a reason for which the two do not collide, or takes one away.
  void ignore(AmbObject &other, int reasons) {
    AmbObject &newer = index > other.index ? *this : other, &older = index > other.index ? other : *this;
    const int *present = newer.ignored.find(older.index);
    const int sum = reasons + (present ? *present : 0);
    if (sum > 0) {
      newer.ignored.insert(older.index, sum);
    } else {
      newer.ignored.remove(older.index);
    }
  }

  ObjectKind kind;
  // Unique in this world, above 0 and never reused, so that `ignored` stays valid when other objects are removed; 0: not
  // in a world.
  int index = 0;
  AmbHandle handle = 0;
  // Objects of one family never collide; 0: none. Neither do objects in groups that have none in common; sorted, empty:
  // in no group, which collides with all.
  unsigned family = 0;
  Vector<unsigned> groups;
  std::unique_ptr<CollisionFilter> filter;
  // By the index of an older object, the number of reasons, such as joints, for which the two do not collide.
  btHashMap<btHashInt, int> ignored;
  Partners partners;
};

struct AmbBody : AmbObject, EngineBody {
  AmbBody(btScalar mass, const btVector3 &inertia, AmbShape *owner_shape, const btTransform &pose)
      : AmbObject(ObjectKind::Body),
        shape(owner_shape),
        motion(pose, body),
        body(btRigidBody::btRigidBodyConstructionInfo(mass, &motion, owner_shape->shape.get(), inertia)) {
    body.setUserPointer(static_cast<AmbObject *>(this));
    body.setActivationState(DISABLE_DEACTIVATION);
    body.setSleepingThresholds(0, 0);
  }

  AmbShape *shape;
  LazyMotionState motion;
  btRigidBody body;
  // The world that the body is in; null: none.
  AmbWorld *world = nullptr;
  // Number of vehicles on the body; while it is above 0 the body may not fall asleep.
  int sleep_inhibitors = 0;
  // The collision object in the world: the body itself, or the link collider that the engine adds instead.
  btCollisionObject *collider = &body;
  // Number of constraints that act on the body.
  int constraint_count = 0;
  // Place in Bullet's list of bodies that are not static; -1: not in it.
  int place = -1;
};

struct AmbGhost : AmbObject {
  AmbGhost(AmbShape *owner_shape, const btTransform &pose) : AmbObject(ObjectKind::Ghost), shape(owner_shape) {
    ghost.setUserPointer(static_cast<AmbObject *>(this));
    ghost.setCollisionShape(owner_shape->shape.get());
    ghost.setCollisionFlags(ghost.getCollisionFlags() | btCollisionObject::CF_NO_CONTACT_RESPONSE);
    ghost.setWorldTransform(pose);
  }

  AmbShape *shape;
  btPairCachingGhostObject ghost;
};

// A copy of a bounding-volume tree: its shape decides in which order contacts are found.
class TreeCopy {
 public:
  void take(const btDbvt &tree);
  // Makes `tree` such a tree; `relink` is called with each leaf.
  template <typename Relink>
  void give(btDbvt &tree, Relink relink) const;
  bool is_empty() const { return nodes_.empty(); }

 private:
  // In the order in which parents come before their children.
  struct Node {
    btDbvtVolume volume;
    // Of a leaf.
    void *data;
    // Index of the parent, and whether it is the second child.
    int parent;
    bool is_second, is_leaf;
  };

  Vector<Node> nodes_;
  int leaves_ = 0, lookahead_ = -1;
  unsigned path_ = 0;
};

struct AmbSoft : AmbObject {
  struct Pull {
    int node;
    btVector3 goal;
  };

  AmbSoft(btSoftBodyWorldInfo *info, int n, const btVector3 *nodes)
      : AmbObject(ObjectKind::SoftBody), body(info, n, nodes, nullptr) {
    body.setUserPointer(static_cast<AmbObject *>(this));
  }

  btSoftBody body;
  // What changes of the body, as it was when it was added.
  struct Start {
    // Positions of the nodes, m.
    Vector<btVector3> positions;
    Vector<btSoftBody::Cluster> clusters;
    btSoftBody::SolverState solver;
    btVector3 centre{0, 0, 0}, bounds[2] = {{0, 0, 0}, {0, 0, 0}};
    btMatrix3x3 rotation, scale;
    TreeCopy nodes, faces, cluster_tree;
  };
  Start start;
  Vector<Pull> pulls;
  // Applied in every sub-step of the next step, N.
  btVector3 force{0, 0, 0};
  // Whether all nodes are within the range of coordinates that the narrow phase can represent; evaluated once a
  // sub-step.
  bool checked = false;
  bool sound = false;
  // The narrow phase triangulates a plane within about patch_radius of the projection of patch_center, m.
  btVector3 patch_center{0, 0, 0};
  btScalar patch_radius = 0;
  bool left_patch = false;
};

inline AmbObject *object_of(const btCollisionObject *object) {
  return static_cast<AmbObject *>(object->getUserPointer());
}

inline AmbBody *body_of(const btCollisionObject *object) {
  AmbObject *owner = object_of(object);
  return owner && owner->kind == ObjectKind::Body ? static_cast<AmbBody *>(owner) : nullptr;
}

inline AmbSoft *soft_of(const btSoftBody *body) { return static_cast<AmbSoft *>(object_of(body)); }

enum class Kind { Hinge, Slider, Fixed, PointToPoint, ConeTwist, SixDof, SixDofSpring };

struct AmbConstraint : EngineConstraint {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  Kind kind;
  // Static body in no world that is the other end of a grip. It is destroyed after the constraint.
  std::unique_ptr<AmbBody> anchor;
  std::unique_ptr<btTypedConstraint> constraint;
  std::unique_ptr<btJointFeedback> feedback;
  // The two bodies do not collide with each other.
  bool disables_collision = false;

  template <typename T>
  T &as() {
    return static_cast<T &>(*constraint);
  }
};

inline void activate_bodies(AmbConstraint &owner) {
  owner.constraint->getRigidBodyA().activate();
  owner.constraint->getRigidBodyB().activate();
}

// One step divided into begin, sub-steps and finish, so that controllers can act between sub-steps.
struct Stepper {
  virtual ~Stepper() = default;
  // Adds the interval to the clock and begins a step of at most `most` sub-steps. Returns the number of sub-steps due.
  virtual int begin(btScalar interval, int most, btScalar sub_step) = 0;
  virtual void advance(btScalar sub_step) = 0;
  virtual void finish() = 0;
  // Forgets the time that is left of the last step.
  virtual void forget_time() = 0;
};

// Whether a shape has no extent: it takes part in no collision, and no ray hits it.
inline bool touches_nothing(const btCollisionShape &shape) {
  if (shape.isCompound()) return static_cast<const btCompoundShape &>(shape).getNumChildShapes() == 0;
  return shape.getShapeType() == EMPTY_SHAPE_PROXYTYPE;
}

// Base class, so that it is there before the broad phase that uses it.
struct OwnPairCache {
  PairCache pairs;
};

// Broad phase: finds pairs of overlapping bounding boxes (AABBs).
struct Broadphase : private OwnPairCache, btDbvtBroadphase {
  Broadphase() : btDbvtBroadphase(&pairs) {}

  using OwnPairCache::pairs;

  // Number of objects up to which trees and pairs are Bullet's, where they have to be (`keeps_order`): which pairs there are
  // decides the order of contact rows. Beyond it, and in other worlds, objects whose shape touches nothing are in no tree and
  // those that are apart for good in no pair, however many are at one point.
  static constexpr int MOST_KEPT = 1000;

  btBroadphaseProxy *createProxy(const btVector3 &low, const btVector3 &high, int shape_type, void *object, int group,
                                 int mask, btDispatcher *dispatcher) override {
    count(1);
    if (pairs.leaves_out_apart && touches_nothing(*static_cast<btCollisionObject *>(object)->getCollisionShape())) {
      auto *proxy = new (btAlignedAlloc(sizeof(btDbvtProxy), 16)) btDbvtProxy(low, high, object, group, mask);
      proxy->leaf = nullptr;
      proxy->m_uniqueId = 0;
      return proxy;
    }
    btBroadphaseProxy *proxy = btDbvtBroadphase::createProxy(low, high, shape_type, object, group, mask, dispatcher);
    // A new leaf goes to the nearest one, so that a row of bodies makes the tree a list, and each further body takes time in
    // proportion to their number. The tree is then balanced.
    int depth = 0;
    for (const btDbvtNode *node = static_cast<btDbvtProxy *>(proxy)->leaf; node->parent; node = node->parent) ++depth;
    if (depth > MOST_KEPT) m_sets[DYNAMIC_SET].optimizeTopDown(2);
    return proxy;
  }

  void destroyProxy(btBroadphaseProxy *proxy, btDispatcher *dispatcher) override {
    count(-1);
    if (is_in_tree(*proxy)) return btDbvtBroadphase::destroyProxy(proxy, dispatcher);
    btAlignedFree(proxy);
  }

  // Bullet enlarges the AABBs of moving objects by the global variable gDbvtMargin, which worlds in several threads
  // cannot set to different values. With `tight` the AABB is stored without it.
  void setAabb(btBroadphaseProxy *proxy, const btVector3 &low, const btVector3 &high,
               btDispatcher *dispatcher) override {
    if (!is_in_tree(*proxy)) {
      proxy->m_aabbMin = low;
      proxy->m_aabbMax = high;
    } else if (tight && !static_cast<btDbvtProxy *>(proxy)->leaf->volume.Contain(btDbvtVolume::FromMM(low, high))) {
      setAabbForceUpdate(proxy, low, high, dispatcher);
    } else {
      btDbvtBroadphase::setAabb(proxy, low, high, dispatcher);
    }
  }

  bool tight = false;
  bool keeps_order = true;
  // Whether two objects may touch, unless it is not known because objects came or went, or others ignore each other: see
  // AmbWorld::find_what_may_touch.
  bool may_touch = true, is_unknown = true;
  // AABBs are those of an earlier sub-step, because nothing may touch.
  bool lags = false;

 private:
  static bool is_in_tree(const btBroadphaseProxy &proxy) { return static_cast<const btDbvtProxy &>(proxy).leaf; }

  void count(int change) {
    is_unknown = true;
    objects_ += change;
    pairs.leaves_out_apart = !keeps_order || objects_ > MOST_KEPT;
  }

  int objects_ = 0;
};

struct AmbWorld {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  AmbWorld(int solver_kind, int kind, int manifolds, const AmbArena *memory, const AmbEngine *engine);

  // Assigns the index and handle of a new object, and registers the algorithms that its shape needs.
  void adopt(AmbObject &object, const AmbShape *shape, AmbHandle handle);
  // Registers the algorithms that a shape needs.
  void prepare_for(const AmbShape &shape);
  // Disables collisions between the two from now on and removes their contacts.
  void ignore_pair(AmbObject &a, btCollisionObject &object_a, AmbObject &b, btCollisionObject &object_b);
  // Finds out whether two objects may touch, if that is not known.
  void find_what_may_touch();
  // Brings AABBs up to the present poses if sub-steps have left them as they were. To be called before they are used
  // outside of the collision detection.
  void catch_up_with_bounds();

  // Arena in which this object itself is allocated; null: the heap.
  const AmbArena *arena;
  // The engine's part of this world; null: plain Bullet. Declared before, so destroyed after, everything that it makes.
  std::unique_ptr<Extension> extension;
  std::unique_ptr<btDefaultCollisionConfiguration> configuration;
  btCollisionDispatcher dispatcher;
  // Callback by which Bullet reports overlapping pairs to ghosts; created with the first ghost.
  std::unique_ptr<btGhostPairCallback> ghost_pairs;
  Broadphase broadphase;
  std::unique_ptr<btMLCPSolverInterface> mlcp;
  std::unique_ptr<btConstraintSolver> solver;
  std::unique_ptr<btDiscreteDynamicsWorld> world;
  // Length of a sub-step over that of the part of it in which the contacts had their impulses.
  double contact_impulse_scale = 1;
  // `world` as a Stepper.
  Stepper *stepper = nullptr;
  // `world`, if its kind is AmbWorldKind_Soft; else null.
  btSoftRigidDynamicsWorld *soft = nullptr;
  // `world`, if its kind is AmbWorldKind_Articulated and the engine made it; else null.
  ArticulatedWorld *articulated = nullptr;
  MotionClock clock;
  // Static bodies that are moved in the next sub-step, each once for each part of it, and their poses at its end.
  struct Moved {
    AmbBody *body;
    btTransform pose;
  };
  Vector<Moved> moved;
  // The AABB of a static body is updated only when its pose is set.
  bool freezes_static_aabbs = false;
  // Bodies fall asleep below these linear (m/s) and angular (rad/s) speeds.
  bool allows_sleeping = false;
  btScalar sleeping_thresholds[2] = {0, 0};
  // The same for bodies that only contacts can carry.
  btScalar resting_thresholds[2] = {0, 0};
  bool has_gimpact = false;
  bool has_volume = false;
  // Rays are cast in this world: soft bodies maintain a bounding-volume tree of their faces.
  bool has_rays = false;
  int next_index = 1;
};

// Whether the contacts of a manifold produce impulses: neither object is a ghost.
inline bool responds(const btPersistentManifold &manifold) {
  return manifold.getBody0()->hasContactResponse() && manifold.getBody1()->hasContactResponse();
}

// See sleeping.cpp. Sets the activation state of a body: frozen if static, able to sleep, or always awake.
void set_activation_state(AmbWorld &world, AmbBody &owner);
// To be called when the gravity, the damping or the number of constraints of a body has changed.
void set_sleeping_thresholds(AmbWorld &world, AmbBody &owner);
// Wakes the bodies that overlap the AABB of a body or share a constraint with it.
void activate_neighbours(AmbWorld &world, const AmbBody &owner);
// Sets the pose of a body and wakes its neighbours at the old and the new pose.
void set_pose(AmbWorld &world, AmbBody &owner, const btTransform &pose);
// Puts the static bodies that are moved in this sub-step where they are to be at its end.
void place_moved_bodies(AmbWorld &world);

// Soft bodies in a world, see soft_body.cpp.
void before_soft_sub_step(btDynamicsWorld *dynamics, btScalar dt);
void after_soft_step(AmbWorld &world);
void prepare_soft_rays(AmbWorld &world);
void forget_in_soft_bodies(AmbWorld &world, AmbBody &body);
// Excludes the signed distance fields from saved states: Bullet allocates their cells with plain `new`, and they can be
// computed from the shapes again.
void exclude_distance_fields(AmbWorld &world);
void restore_soft_bodies(AmbWorld &world, AmbArena &arena, const unsigned char *copy, size_t size);
// To be called before the narrow phase of a pair with a soft body; false: the pair must be skipped.
bool prepare_soft_pair(btBroadphasePair &pair, const btCollisionObject &a, const btCollisionObject &b);

// Coordinate of a spring about z (rad, sign as of a hinge) or along z (m) of its frames, from the present poses.
btScalar axis_reading(AmbConstraint &spring, bool is_angle);

inline btVector3 vector_of(const double v[3]) { return btVector3(v[0], v[1], v[2]); }

// A sum is finite only if each term is. A sum that overflows counts as not finite.
inline bool finite(const btVector3 &v) { return std::isfinite(v.x() + v.y() + v.z()); }

inline btTransform transform_of(const double pose[12]) {
  return btTransform(btMatrix3x3(pose[3], pose[4], pose[5], pose[6], pose[7], pose[8], pose[9], pose[10], pose[11]),
                     vector_of(pose));
}

inline void write_vector(const btVector3 &v, double *out) {
  out[0] = v.x();
  out[1] = v.y();
  out[2] = v.z();
}

inline void write_pose(const btTransform &t, double *out) {
  write_vector(t.getOrigin(), out);
  for (int row = 0; row < 3; ++row) write_vector(t.getBasis()[row], out + 3 + 3 * row);
}

#endif
