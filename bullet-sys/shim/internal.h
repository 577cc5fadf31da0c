// What stands behind the opaque objects. C++ only.
#ifndef AMB_INTERNAL_H
#define AMB_INTERNAL_H

#include <cstdint>
#include <memory>
#include <vector>

#include <btBulletDynamicsCommon.h>

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

struct AmbBody {
  AmbBody(btScalar mass, const btVector3 &inertia, AmbShape *owner_shape, const btTransform &pose)
      : shape(owner_shape),
        motion(pose),
        body(btRigidBody::btRigidBodyConstructionInfo(mass, &motion, owner_shape->shape.get(), inertia)) {
    body.setUserPointer(this);
    body.setActivationState(DISABLE_DEACTIVATION);
    body.setSleepingThresholds(0, 0);
  }

  bool ignores(const AmbBody &other) const {
    const size_t word = other.index / 64;
    return word < ignored.size() && (ignored[word] >> (other.index % 64) & 1) != 0;
  }

  AmbShape *shape;
  btDefaultMotionState motion;
  btRigidBody body;
  size_t index = 0;
  // Sub-step in which the body was last in contact; only counted for the ballistic correction.
  uint64_t touched = 0;
  std::vector<uint64_t> ignored;
};

enum class Kind { Hinge, Slider, Fixed, PointToPoint, ConeTwist, SixDof, SixDofSpring };

struct AmbConstraint {
  Kind kind;
  std::unique_ptr<btTypedConstraint> constraint;
  std::unique_ptr<btJointFeedback> feedback;

  template <typename T>
  T &as() {
    return static_cast<T &>(*constraint);
  }
};

inline btVector3 vector_of(const double v[3]) { return btVector3(v[0], v[1], v[2]); }

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
