// Lazy motion states, and no prediction of contacts for bodies without continuous collision detection. C++ only.
#ifndef AMB_LAZY_WORLD_H
#define AMB_LAZY_WORLD_H

#include <cstdint>

#include <LinearMath/btHashMap.h>
#include <LinearMath/btTransformUtil.h>
#include <btBulletDynamicsCommon.h>

// Number of the last synchronisation of motion states, and the time over which Bullet would have extrapolated the
// poses, s.
struct MotionClock {
  uint64_t due = 0;
  btScalar offset = 0;
  // Motion states lag behind the poses (Bullet's latency interpolation) instead of being extrapolated ahead.
  bool lags = true;
};

// A motion state that is extrapolated when it is read, bit for bit as Bullet's synchronizeSingleMotionState does.
class LazyMotionState final : public btMotionState {
 public:
  LazyMotionState(const btTransform &pose, const btRigidBody &owner) : body(owner), state(pose) {}

  // Uses the clock of the world that the body was added to.
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

  // As at the construction, to the sign of zeros.
  void place(const btTransform &transform) {
    state.m_graphicsWorldTrans = transform;
    if (clock) seen = clock->due;
  }

  void setWorldTransform(const btTransform &transform) override {
    state.setWorldTransform(transform);
    if (clock) seen = clock->due;
  }

 private:
  void integrate() const {
    if (body.isStaticOrKinematicObject() || !body.isInWorld()) return;
    // The pose of a sleeping body is not extrapolated.
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

// Takes an element at a known place out of a list of Bullet's as its `remove` does: the last one takes its place.
template <typename T>
void remove_at(btAlignedObjectArray<T> &list, int place) {
  list.swap(place, list.size() - 1);
  list.pop_back();
}

// Pointers, and where they are in a list of Bullet's, which finds them by a look at each element.
class Places {
 public:
  void add(const void *element, int place) { places_.insert(element, place); }

  // As the list's `remove`.
  template <typename T>
  void remove(btAlignedObjectArray<T *> &list, T *element) {
    const int *known = places_.find(element);
    if (!known) return;
    const int place = *known;
    places_.remove(element);
    remove_at(list, place);
    if (place < list.size()) places_.insert(list[place], place);
  }

 private:
  btHashMap<btHashPtr, int> places_;
};

// A world of type World without work whose results are not used: motion states are lazy and use `clock`. Constraints are
// removed in constant time. Bodies move as in the plain world, bit for bit.
template <typename World>
class LazyWorld : public World {
 public:
  template <typename... Arguments>
  explicit LazyWorld(MotionClock &motion_clock, Arguments... arguments) : World(arguments...), clock(motion_clock) {}

  void addConstraint(btTypedConstraint *constraint, bool disables_collisions = false) override {
    constraint_places.add(constraint, this->m_constraints.size());
    World::addConstraint(constraint, disables_collisions);
  }

  void removeConstraint(btTypedConstraint *constraint) override {
    constraint_places.remove(this->m_constraints, constraint);
    constraint->getRigidBodyA().removeConstraintRef(constraint);
    constraint->getRigidBodyB().removeConstraintRef(constraint);
  }

  // Bullet computes the velocity of a kinematic object from its last two poses; here it is given (amb_body_move).
  void saveKinematicState(btScalar) override {}

  void synchronizeMotionStates() override {
    ++clock.due;
    clock.lags = this->m_latencyMotionStateInterpolation && this->m_fixedTimeStep != 0;
    clock.offset = clock.lags ? this->m_localTime - this->m_fixedTimeStep : this->m_localTime;
  }

  // Bullet predicts the motion of every body before it checks whether continuous collision detection is enabled for it.
  void createPredictiveContacts(btScalar dt) override {
    this->releasePredictiveContacts();
    btAlignedObjectArray<btRigidBody *> &bodies = this->m_nonStaticRigidBodies;
    for (int i = 0; i < bodies.size(); ++i) {
      if (bodies[i]->getCcdSquareMotionThreshold() != 0) this->createPredictiveContactsInternal(&bodies[i], 1, dt);
    }
  }

 protected:
  MotionClock &clock;
  Places constraint_places;
};

#endif
