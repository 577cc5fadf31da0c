// Bullet's step in pieces, in worlds of any type. C++ only.
#ifndef AMB_STEPPED_H
#define AMB_STEPPED_H

#include "internal.h"

// The same calls in the same order as in Bullet's own loop: results agree bit for bit. The world's user pointer is its AmbWorld.
template <class Base>
struct Stepped : Base, Stepper {
  using Base::Base;

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

  void finish() override {
    if (idle) this->synchronizeMotionStates();
    this->clearForces();
  }

 protected:
  void internalSingleStepSimulation(btScalar h) override {
    Extension *extension = static_cast<AmbWorld *>(this->getWorldUserInfo())->extension.get();
    if (extension) extension->before_sub_step(h);
    Base::internalSingleStepSimulation(h);
    if (extension) extension->after_sub_step(h);
  }

  void integrateTransforms(btScalar dt) override {
    Extension *extension = static_cast<AmbWorld *>(this->getWorldUserInfo())->extension.get();
    if (extension) extension->before_motion(this->m_nonStaticRigidBodies, dt);
    Base::integrateTransforms(dt);
    if (extension) extension->after_motion();
  }

 private:
  bool idle = true;
};

// Makes the world of `owner`; Base: a btDiscreteDynamicsWorld that is `Lean`. The solver stays the owner's.
template <class Base, class Solver>
Base *fill_world(AmbWorld &owner, Solver *solver) {
  auto *made = new Stepped<Base>(owner.clock, &owner.dispatcher, &owner.broadphase, solver, owner.configuration.get());
  owner.world.reset(made);
  owner.stepper = made;
  return made;
}

#endif
