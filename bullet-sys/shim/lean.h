// What Bullet does for every body in every sub-step, and nobody looks at. C++ only.
#ifndef AMB_LEAN_H
#define AMB_LEAN_H

#include <cstdint>

#include <LinearMath/btTransformUtil.h>
#include <btBulletDynamicsCommon.h>

// When motion states were last due, and what Bullet would have integrated the poses by.
struct MotionClock {
  uint64_t due = 0;
  btScalar offset = 0;
  // They are behind the poses rather than ahead.
  bool lags = true;
};

// A motion state that is integrated when it is read, with Bullet's own numbers.
class LazyMotionState final : public btMotionState {
 public:
  LazyMotionState(const btTransform &pose, const btRigidBody &owner) : body(owner), state(pose) {}

  // From now on it follows the bodies of a world.
  void follow(const MotionClock &world_clock) {
    clock = &world_clock;
    seen = clock->due;
  }

  const btTransform &pose() const {
    if (clock && seen != clock->due) {
      seen = clock->due;
      integrate();
    }
    return state.m_graphicsWorldTrans;
  }

  void getWorldTransform(btTransform &transform) const override {
    pose();
    state.getWorldTransform(transform);
  }

  void setWorldTransform(const btTransform &transform) override {
    state.setWorldTransform(transform);
    if (clock) seen = clock->due;
  }

 private:
  void integrate() const {
    if (body.isStaticOrKinematicObject() || !body.isInWorld()) return;
    // What sleeps is where it is.
    if (!body.isActive()) return state.setWorldTransform(body.getWorldTransform());
    const btScalar by = clock->lags ? clock->offset : clock->offset * body.getHitFraction();
    btTransform moved;
    btTransformUtil::integrateTransform(body.getInterpolationWorldTransform(), body.getInterpolationLinearVelocity(),
                                        body.getInterpolationAngularVelocity(), by, moved);
    state.setWorldTransform(moved);
  }

  const btRigidBody &body;
  const MotionClock *clock = nullptr;
  mutable uint64_t seen = 0;
  mutable btDefaultMotionState state;
};

// A world of any type that leaves out what nobody looks at. Bodies move as in the plain world, bit for bit. Their motion states are
// lazy ones that follow `clock`.
template <typename World>
class Lean : public World {
 public:
  template <typename... Arguments>
  explicit Lean(MotionClock &motion_clock, Arguments... arguments) : World(arguments...), clock(motion_clock) {}

  void synchronizeMotionStates() override {
    ++clock.due;
    clock.lags = this->m_latencyMotionStateInterpolation && this->m_fixedTimeStep != 0;
    clock.offset = clock.lags ? this->m_localTime - this->m_fixedTimeStep : this->m_localTime;
  }

  // Bullet predicts the motion of every body before it asks whether it is checked continuously.
  void createPredictiveContacts(btScalar dt) override {
    this->releasePredictiveContacts();
    btAlignedObjectArray<btRigidBody *> &bodies = this->m_nonStaticRigidBodies;
    for (int i = 0; i < bodies.size(); ++i) {
      if (bodies[i]->getCcdSquareMotionThreshold() != 0) this->createPredictiveContactsInternal(&bodies[i], 1, dt);
    }
  }

 private:
  MotionClock &clock;
};

#endif
