#include "internal.h"

#include <BulletCollision/Gimpact/btGImpactCollisionAlgorithm.h>
#include <BulletDynamics/ConstraintSolver/btNNCGConstraintSolver.h>
#include <BulletDynamics/MLCPSolvers/btDantzigSolver.h>
#include <BulletDynamics/MLCPSolvers/btLemkeSolver.h>
#include <BulletDynamics/MLCPSolvers/btMLCPSolver.h>
#include <BulletDynamics/MLCPSolvers/btSolveProjectedGaussSeidel.h>

namespace {

// Bullet 3 no longer warm-starts friction; results of Bullet 2 need it. The rows are set up from velocities without impulses, so
// that it can be done after all of them are.
class WarmFrictionSolver : public btSequentialImpulseConstraintSolver {
 protected:
  void convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) override {
    btSequentialImpulseConstraintSolver::convertContacts(manifolds, n, info);
    if (!(info.m_solverMode & SOLVER_USE_WARMSTARTING)) return;
    for (int i = 0; i < m_tmpSolverContactConstraintPool.size(); ++i) {
      const btSolverConstraint &contact = m_tmpSolverContactConstraintPool[i];
      const auto *point = static_cast<const btManifoldPoint *>(contact.m_originalContactPoint);
      btSolverConstraint &friction = m_tmpSolverContactFrictionConstraintPool[contact.m_frictionIndex];
      friction.m_appliedImpulse = point->m_appliedImpulseLateral1 * info.m_warmstartingFactor;
      apply(m_tmpSolverBodyPool[contact.m_solverBodyIdA], friction.m_contactNormal1, friction.m_angularComponentA,
            friction.m_appliedImpulse);
      apply(m_tmpSolverBodyPool[contact.m_solverBodyIdB], friction.m_contactNormal2, friction.m_angularComponentB,
            friction.m_appliedImpulse);
    }
  }

 private:
  static void apply(btSolverBody &body, const btVector3 &normal, const btVector3 &angular, btScalar impulse) {
    if (body.m_originalBody) body.internalApplyImpulse(normal * body.internalGetInvMass(), angular, impulse);
  }
};

std::unique_ptr<btMLCPSolverInterface> mlcp_of(int solver) {
  switch (solver) {
    case AmbSolver_Dantzig: return std::make_unique<btDantzigSolver>();
    case AmbSolver_ProjectedGaussSeidel: return std::make_unique<btSolveProjectedGaussSeidel>();
    case AmbSolver_Lemke: return std::make_unique<btLemkeSolver>();
    default: return nullptr;
  }
}

std::unique_ptr<btConstraintSolver> solver_of(int solver, btMLCPSolverInterface *mlcp) {
  if (mlcp) return std::make_unique<btMLCPSolver>(mlcp);
  if (solver == AmbSolver_Nncg) return std::make_unique<btNNCGConstraintSolver>();
  if (solver == AmbSolver_WarmFriction) return std::make_unique<WarmFrictionSolver>();
  return std::make_unique<btSequentialImpulseConstraintSolver>();
}

const AmbBody *body_of(const btBroadphaseProxy *proxy) {
  return static_cast<const AmbBody *>(static_cast<const btCollisionObject *>(proxy->m_clientObject)->getUserPointer());
}

// Pairs that never collide stay in the pair cache, so that the order of the others, and with it the order in which contacts are
// solved, is that of a world without a bit set.
void near_callback(btBroadphasePair &pair, btCollisionDispatcher &dispatcher, const btDispatcherInfo &info) {
  const AmbBody *a = body_of(pair.m_pProxy0), *b = body_of(pair.m_pProxy1);
  if (a && b && a->ignores(*b)) return;
  btCollisionDispatcher::defaultNearCallback(pair, dispatcher, info);
}

AmbBody *body_of(const btCollisionObject *object) { return static_cast<AmbBody *>(object->getUserPointer()); }

void set_ignored(AmbBody &body, size_t other) {
  if (body.ignored.size() <= other / 64) body.ignored.resize(other / 64 + 1);
  body.ignored[other / 64] |= uint64_t(1) << (other % 64);
}

// Bullet's default of 4096 manifolds takes 7 MB that are touched at once, half of what a small scene needs in all. Piles that need
// more get theirs from the heap, one by one.
btDefaultCollisionConstructionInfo small_pools() {
  btDefaultCollisionConstructionInfo info;
  info.m_defaultMaxPersistentManifoldPoolSize = 1024;
  info.m_defaultMaxCollisionAlgorithmPoolSize = 1024;
  return info;
}

}  // namespace

struct AmbWorld {
  explicit AmbWorld(int solver_kind)
      : configuration(small_pools()),
        dispatcher(&configuration),
        mlcp(mlcp_of(solver_kind)),
        solver(solver_of(solver_kind, mlcp.get())),
        world(&dispatcher, &broadphase, solver.get(), &configuration) {
    dispatcher.setNearCallback(near_callback);
    // An MLCP solver takes one island at a time; merging small ones would only make its matrices larger.
    if (mlcp) world.getSolverInfo().m_minimumSolverBatchSize = 1;
  }

  btDefaultCollisionConfiguration configuration;
  btCollisionDispatcher dispatcher;
  btDbvtBroadphase broadphase;
  std::unique_ptr<btMLCPSolverInterface> mlcp;
  std::unique_ptr<btConstraintSolver> solver;
  btDiscreteDynamicsWorld world;
  bool has_gimpact = false;
  size_t next_index = 0;
  uint64_t sub_step = 0;
};

namespace {

// After a sub-step: takes back a dt^2 / 2 of the way of every free body.
void correct_ballistic(btDynamicsWorld *dynamics, btScalar dt) {
  auto &world = *static_cast<AmbWorld *>(dynamics->getWorldUserInfo());
  const uint64_t now = ++world.sub_step;
  for (int i = 0; i < world.dispatcher.getNumManifolds(); ++i) {
    const btPersistentManifold *manifold = world.dispatcher.getManifoldByIndexInternal(i);
    if (manifold->getNumContacts() == 0) continue;
    for (const btCollisionObject *object : {manifold->getBody0(), manifold->getBody1()}) {
      if (AmbBody *body = body_of(object)) body->touched = now;
    }
  }
  const btCollisionObjectArray &objects = dynamics->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    AmbBody *owner = body_of(objects[i]);
    if (!owner || owner->touched == now) continue;
    btRigidBody &body = owner->body;
    if (body.isStaticOrKinematicObject() || body.getNumConstraintRefs() > 0) continue;
    const btVector3 back = body.getTotalForce() * (body.getInvMass() * dt * dt / 2);
    btTransform pose = body.getWorldTransform();
    pose.setOrigin(pose.getOrigin() - back);
    body.setWorldTransform(pose);
    body.setInterpolationWorldTransform(pose);
  }
}

}  // namespace

extern "C" {

AmbWorld *amb_world_new(int solver) { return new AmbWorld(solver); }

void amb_world_free(AmbWorld *world) { delete world; }

void amb_world_set_gravity(AmbWorld *world, const double gravity[3]) { world->world.setGravity(vector_of(gravity)); }

void amb_world_set_iterations(AmbWorld *world, int iterations) {
  world->world.getSolverInfo().m_numIterations = iterations;
}

void amb_world_set_erp(AmbWorld *world, double erp, double erp2) {
  world->world.getSolverInfo().m_erp = erp;
  world->world.getSolverInfo().m_erp2 = erp2;
}

void amb_world_set_ballistic(AmbWorld *world, int enabled) {
  world->world.setInternalTickCallback(enabled ? correct_ballistic : nullptr, world);
}

void amb_world_set_lag(AmbWorld *world, int enabled) {
  world->world.setLatencyMotionStateInterpolation(enabled != 0);
}

void amb_world_add_body(AmbWorld *world, AmbBody *body) {
  if (body->shape->needs_gimpact && !world->has_gimpact) {
    btGImpactCollisionAlgorithm::registerAlgorithm(&world->dispatcher);
    world->has_gimpact = true;
  }
  body->index = world->next_index++;
  world->world.addRigidBody(&body->body);
}

void amb_world_remove_body(AmbWorld *world, AmbBody *body) { world->world.removeRigidBody(&body->body); }

void amb_world_add_constraint(AmbWorld *world, AmbConstraint *constraint, int disable_collisions) {
  world->world.addConstraint(constraint->constraint.get(), disable_collisions != 0);
}

void amb_world_remove_constraint(AmbWorld *world, AmbConstraint *constraint) {
  world->world.removeConstraint(constraint->constraint.get());
}

void amb_world_ignore_pair(AmbWorld *, AmbBody *a, AmbBody *b) {
  set_ignored(*a, b->index);
  set_ignored(*b, a->index);
}

int amb_world_step(AmbWorld *world, double interval, int max_sub_steps, double sub_step) {
  return world->world.stepSimulation(interval, max_sub_steps, sub_step);
}

void amb_world_recover(AmbWorld *world) {
  btCollisionObjectArray &objects = world->world.getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    btCollisionObject *object = objects[i];
    object->forceActivationState(DISABLE_DEACTIVATION);
    object->setInterpolationWorldTransform(object->getWorldTransform());
    object->setInterpolationLinearVelocity(btVector3(0, 0, 0));
    object->setInterpolationAngularVelocity(btVector3(0, 0, 0));
    world->broadphase.getOverlappingPairCache()->cleanProxyFromPairs(object->getBroadphaseHandle(), &world->dispatcher);
  }
  world->solver->reset();
}

int amb_world_contact_count(const AmbWorld *world) {
  int count = 0;
  for (int i = 0; i < world->dispatcher.getNumManifolds(); ++i) {
    count += world->dispatcher.getManifoldByIndexInternal(i)->getNumContacts();
  }
  return count;
}

}  // extern "C"
