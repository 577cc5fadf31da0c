// What stands behind the opaque objects. C++ only.
#ifndef AMB_INTERNAL_H
#define AMB_INTERNAL_H

#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include <BulletCollision/CollisionDispatch/btGhostObject.h>
#include <BulletDynamics/MLCPSolvers/btMLCPSolverInterface.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>
#include <btBulletDynamicsCommon.h>

#include "arena_memory.h"
#include "extension.h"
#include "lean.h"

extern "C" {
#include "shim.h"
}

struct AmbShape {
  // Destroyed in reverse order: the shape before what it refers to.
  std::vector<std::unique_ptr<AmbShape>> children;
  std::unique_ptr<btStridingMeshInterface> mesh;
  std::unique_ptr<btCollisionShape> shape;
  bool needs_gimpact = false;
};

enum class ObjectKind { Body, Ghost, SoftBody };

struct AmbWorld;

// What the user pointer of every collision object points at.
struct AmbObject {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  explicit AmbObject(ObjectKind object_kind) : kind(object_kind) {}

  bool ignores(const AmbObject &other) const {
    const size_t word = other.index / 64;
    return word < ignored.size() && (ignored[word] >> (other.index % 64) & 1) != 0;
  }

  void ignore(const AmbObject &other) {
    if (ignored.size() <= other.index / 64) ignored.resize(other.index / 64 + 1);
    ignored[other.index / 64] |= uint64_t(1) << (other.index % 64);
  }

  ObjectKind kind;
  // Never used again in this world, so that what an object ignores stays true when others are removed.
  size_t index = 0;
  AmbHandle handle = 0;
  Vector<uint64_t> ignored;
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
  // The world it is in.
  AmbWorld *home = nullptr;
  // What keeps it from falling asleep.
  int restless = 0;
  // What of it is in the world: the body, or what the engine puts there in its place.
  btCollisionObject *collider = &body;
  // Constraints on it.
  int held = 0;
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
  // Where the nodes were when the body was added.
  Vector<btVector3> initial;
  Vector<Pull> pulls;
  // Acts in every sub-step of the next step.
  btVector3 force{0, 0, 0};
  // Whether the nodes are where the narrow phase can deal with them, found once a sub-step.
  bool checked = false;
  bool sound = false;
  // What of planes the narrow phase knows: about patch_radius around the projection of patch_center.
  btVector3 patch_center{0, 0, 0};
  btScalar patch_radius = 0;
  bool left_patch = false;
};

inline AmbObject *object_of(const btCollisionObject *object) { return static_cast<AmbObject *>(object->getUserPointer()); }

inline AmbBody *body_of(const btCollisionObject *object) {
  AmbObject *owner = object_of(object);
  return owner->kind == ObjectKind::Body ? static_cast<AmbBody *>(owner) : nullptr;
}

inline AmbSoft *soft_of(const btSoftBody *body) { return static_cast<AmbSoft *>(object_of(body)); }

enum class Kind { Hinge, Slider, Fixed, PointToPoint, ConeTwist, SixDof, SixDofSpring };

struct AmbConstraint : EngineConstraint {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  Kind kind;
  // A body that is in no world, at the other end of a grip. Goes after the constraint.
  std::unique_ptr<AmbBody> anchor;
  std::unique_ptr<btTypedConstraint> constraint;
  std::unique_ptr<btJointFeedback> feedback;
  // Its bodies don't collide.
  bool parts = false;

  template <typename T>
  T &as() {
    return static_cast<T &>(*constraint);
  }
};

inline void wake(AmbConstraint &owner) {
  owner.constraint->getRigidBodyA().activate();
  owner.constraint->getRigidBodyB().activate();
}

// Bullet's step in pieces, between which controllers act.
struct Stepper {
  virtual ~Stepper() = default;
  // Counts the interval and begins a step of at most `most` sub-steps. Returns the sub-steps that are due.
  virtual int begin(btScalar interval, int most, btScalar sub_step) = 0;
  virtual void advance(btScalar sub_step) = 0;
  virtual void finish() = 0;
};

// Finds pairs of bounding boxes that overlap.
struct Broadphase : btDbvtBroadphase {
  // Bullet puts a margin around boxes that move; it is a global variable there, which worlds in several threads cannot share.
  void setAabb(btBroadphaseProxy *proxy, const btVector3 &low, const btVector3 &high, btDispatcher *dispatcher) override {
    if (tight && !static_cast<btDbvtProxy *>(proxy)->leaf->volume.Contain(btDbvtVolume::FromMM(low, high))) {
      setAabbForceUpdate(proxy, low, high, dispatcher);
    } else {
      btDbvtBroadphase::setAabb(proxy, low, high, dispatcher);
    }
  }

  bool tight = false;
};

struct AmbWorld {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  AmbWorld(int solver_kind, int kind, const AmbArena *memory, const AmbEngine *engine);

  // Objects of any kind are numbered here, and what their shapes need is set up.
  void adopt(AmbObject &object, const AmbShape *shape, AmbHandle handle);
  // The two never collide from now on, and lose the contacts that they have.
  void part(AmbObject &a, btCollisionObject &object_a, AmbObject &b, btCollisionObject &object_b);

  // In which it lies itself; null: on the heap.
  const AmbArena *arena;
  // What an engine does here; null: plain Bullet. Before all that it makes.
  std::unique_ptr<Extension> extension;
  std::unique_ptr<btDefaultCollisionConfiguration> configuration;
  btCollisionDispatcher dispatcher;
  // Bullet makes its pairs known to ghosts through it; set when there is one.
  std::unique_ptr<btGhostPairCallback> ghost_pairs;
  Broadphase broadphase;
  std::unique_ptr<btMLCPSolverInterface> mlcp;
  std::unique_ptr<btConstraintSolver> solver;
  std::unique_ptr<btDiscreteDynamicsWorld> world;
  // The same world.
  Stepper *stepper = nullptr;
  // The same world, if it was made for soft bodies.
  btSoftRigidDynamicsWorld *soft = nullptr;
  // The same world, if the engine made it.
  TreeWorld *trees = nullptr;
  MotionClock clock;
  // Static bodies are looked at only when they are set.
  bool rests = false;
  // Bodies may fall asleep, below these linear and angular velocities.
  bool sleeps = false;
  btScalar sleeps_below[2] = {0, 0};
  bool has_gimpact = false;
  // Somebody casts rays: soft bodies keep a tree of their faces.
  bool has_rays = false;
  size_t next_index = 0;
};

// Of manifolds that push.
inline bool responds(const btPersistentManifold &manifold) {
  return manifold.getBody0()->hasContactResponse() && manifold.getBody1()->hasContactResponse();
}

// Bodies at rest, see rest.cpp: whether a body may fall asleep, beginning awake, ...
void set_activity(AmbWorld &world, AmbBody &owner);
// ... what happens to those that a body touches or holds when it goes, ...
void wake_around(AmbWorld &world, const AmbBody &owner);
// ... and when it is put somewhere else.
void place(AmbWorld &world, AmbBody &owner, const btTransform &pose);

// Soft bodies in a world, see soft_body.cpp.
void before_soft_sub_step(btDynamicsWorld *dynamics, btScalar dt);
void after_soft_step(AmbWorld &world);
void prepare_soft_rays(AmbWorld &world);
void forget_in_soft_bodies(AmbWorld &world, AmbBody &body);
// Distance fields are not part of copies of a world: Bullet makes their cells elsewhere, and they follow from the shapes.
void keep_distance_fields_out(AmbWorld &world);
void put_back_soft(AmbWorld &world, AmbArena &arena, const unsigned char *copy, size_t size);
// Before the narrow phase looks at a pair one of which is a soft body; false: it may not.
bool prepare_soft_pair(btBroadphasePair &pair, const btCollisionObject &a, const btCollisionObject &b);

// Of a spring about (rad, as of a hinge) or along (m) z of its frames, from the present poses.
btScalar axis_reading(AmbConstraint &spring, bool is_angle);

inline btVector3 vector_of(const double v[3]) { return btVector3(v[0], v[1], v[2]); }

// A sum is finite only if each term is, short of an overflow that deserves the alarm too.
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
