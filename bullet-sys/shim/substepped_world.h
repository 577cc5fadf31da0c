// btDiscreteDynamicsWorld::stepSimulation divided into begin, advance and finish, for worlds of any type. C++ only.
#ifndef AMB_SUBSTEPPED_WORLD_H
#define AMB_SUBSTEPPED_WORLD_H

#include <utility>

#include "internal.h"

// Makes the same calls in the same order as stepSimulation: results agree bit for bit. The world's user pointer is its
// AmbWorld.
template <class Base>
struct SubsteppedWorld : Base, Stepper {
  using Base::Base;

  // Bodies are removed in constant time. The user pointer of each is its AmbBody.
  void addRigidBody(btRigidBody *body) override {
    Base::addRigidBody(body);
    note_place(*body);
  }

  void addRigidBody(btRigidBody *body, int group, int mask) override {
    Base::addRigidBody(body, group, mask);
    note_place(*body);
  }

  void removeRigidBody(btRigidBody *body) override {
    btAlignedObjectArray<btRigidBody *> &bodies = this->m_nonStaticRigidBodies;
    const int place = std::exchange(body_of(body)->place, -1);
    if (place >= 0) {
      remove_at(bodies, place);
      if (place < bodies.size()) body_of(bodies[place])->place = place;
    }
    btCollisionWorld::removeCollisionObject(body);
  }

  int begin(btScalar interval, int most, btScalar sub_step) override {
    this->m_fixedTimeStep = sub_step;
    this->m_localTime += interval;
    int due = 0;
    if (this->m_localTime >= sub_step) {
      due = int(this->m_localTime / sub_step);
      this->m_localTime -= due * sub_step;
    }
    idle = due == 0;
    if (!idle) {
      this->saveKinematicState(sub_step * btMin(due, most));
      this->applyGravity();
    }
    return due;
  }

  void advance(btScalar sub_step) override {
    this->internalSingleStepSimulation(sub_step);
    this->synchronizeMotionStates();
  }

  void forget_time() override {
    this->m_localTime = 0;
    this->clock.offset = 0;
    idle = true;
  }

  void finish() override {
    if (idle) this->synchronizeMotionStates();
    this->clearForces();
  }

  void rayTest(const btVector3 &from, const btVector3 &to,
               btCollisionWorld::RayResultCallback &result) const override {
    AmbWorld &owner = *static_cast<AmbWorld *>(this->getWorldUserInfo());
    owner.catch_up_with_bounds();
    Extension *extension = owner.extension.get();
    if (!extension || !extension->cast_ray(from, to, result)) Base::rayTest(from, to, result);
  }

 protected:
  void internalSingleStepSimulation(btScalar h) override {
    Extension *extension = static_cast<AmbWorld *>(this->getWorldUserInfo())->extension.get();
    if (extension) extension->before_sub_step(h);
    Base::internalSingleStepSimulation(h);
    if (extension) extension->after_sub_step(h);
  }

  // Where nothing may touch nothing is looked for: AABBs are then brought up to date when somebody needs them. Not where
  // pairs have another effect: Bullet's islands unite what overlaps, which those of articulated worlds do not, and where the
  // order of pairs is plain Bullet's it depends on the AABBs of all sub-steps, also for pairs of objects that come later.
  void performDiscreteCollisionDetection() override {
    AmbWorld &owner = *static_cast<AmbWorld *>(this->getWorldUserInfo());
    Broadphase &bounds = owner.broadphase;
    if (!owner.articulated || bounds.keeps_order) return Base::performDiscreteCollisionDetection();
    // The first one after a change is made in any case, and contacts that are left go when their objects part.
    bounds.lags = !bounds.is_unknown && !bounds.may_touch && owner.dispatcher.getNumManifolds() == 0;
    if (bounds.lags) return;
    owner.find_what_may_touch();
    Base::performDiscreteCollisionDetection();
  }

  void integrateTransforms(btScalar dt) override {
    Extension *extension = static_cast<AmbWorld *>(this->getWorldUserInfo())->extension.get();
    if (extension) extension->before_motion(this->m_nonStaticRigidBodies, dt);
    place_moved_bodies(*static_cast<AmbWorld *>(this->getWorldUserInfo()));
    Base::integrateTransforms(dt);
    if (extension) extension->after_motion();
  }

 private:
  void note_place(btRigidBody &body) {
    const int last = this->m_nonStaticRigidBodies.size() - 1;
    if (last >= 0 && this->m_nonStaticRigidBodies[last] == &body) body_of(&body)->place = last;
  }

  bool idle = true;
};

// Creates the world of `owner`. Base is a LazyWorld of a btDiscreteDynamicsWorld. The owner keeps ownership of the
// solver.
template <class Base, class Solver>
Base *fill_world(AmbWorld &owner, Solver *solver) {
  auto *made =
      new SubsteppedWorld<Base>(owner.clock, &owner.dispatcher, &owner.broadphase, solver, owner.configuration.get());
  owner.world.reset(made);
  owner.stepper = made;
  return made;
}

#endif
