#include "hull_pairs.h"
#include "solvers.h"
#include "substepped_world.h"

#include <BulletCollision/Gimpact/btGImpactCollisionAlgorithm.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>

namespace {

// Ignored pairs stay in the pair cache, so that the order of the other pairs, and hence of contact rows, does not
// depend on how a pair is ignored; see Broadphase::MOST_KEPT.
void near_callback(btBroadphasePair &pair, btCollisionDispatcher &dispatcher, const btDispatcherInfo &info) {
  const auto &first = *static_cast<const btCollisionObject *>(pair.m_pProxy0->m_clientObject);
  const auto &second = *static_cast<const btCollisionObject *>(pair.m_pProxy1->m_clientObject);
  const AmbObject &a = *object_of(&first), &b = *object_of(&second);
  if (a.ignores(b)) return;
  const bool soft = a.kind == ObjectKind::SoftBody || b.kind == ObjectKind::SoftBody;
  if (soft && !prepare_soft_pair(pair, first, second)) return;
  const HullPairs parts(first, second);
  btCollisionDispatcher::defaultNearCallback(pair, dispatcher, info);
}

// Bullet's default pool of 4096 manifolds is 7 MB, all of it written at once. Beyond the pool, manifolds are allocated
// one by one. In an arena a pool has no advantage, and its unused part would be part of each copy.
btDefaultCollisionConstructionInfo pools_of(int manifolds, bool in_arena) {
  btDefaultCollisionConstructionInfo info;
  info.m_defaultMaxPersistentManifoldPoolSize = in_arena ? 1 : std::max(manifolds, 1);
  info.m_customCollisionAlgorithmMaxElementSize = MAX_ALGORITHM_SIZE;
  info.m_defaultMaxCollisionAlgorithmPoolSize = in_arena ? 1 : std::max(2 * manifolds, 1);
  return info;
}

std::unique_ptr<btDefaultCollisionConfiguration> configuration_of(
    bool soft, const btDefaultCollisionConstructionInfo &pools, Extension *extension) {
  std::unique_ptr<btDefaultCollisionConfiguration> made;
  if (soft) {
    made = std::make_unique<InArena<btSoftBodyRigidBodyCollisionConfiguration>>(pools);
  } else {
    made = std::make_unique<InArena<btDefaultCollisionConfiguration>>(pools);
  }
  if (extension) extension->configure(*made);
  return made;
}

}  // namespace

AmbWorld::AmbWorld(int solver_kind, int kind, int manifolds, const AmbArena *memory, const AmbEngine *engine)
    : arena(memory),
      extension(engine ? engine->extend(*this, solver_kind, kind) : nullptr),
      configuration(configuration_of(kind == AmbWorldKind_Soft, pools_of(manifolds, memory), extension.get())),
      dispatcher(configuration.get()) {
  if (extension) extension->add_algorithms(dispatcher);
  const bool is_articulated = extension && kind == AmbWorldKind_Articulated;
  if (!is_articulated) mlcp = mlcp_of(solver_kind);
  solver = extension ? extension->make_solver(mlcp.get()) : solver_of(solver_kind, mlcp.get());
  if (is_articulated) {
    extension->make_world(*solver);
  } else {
    if (kind == AmbWorldKind_Soft) {
      soft = fill_world<LazyWorld<btSoftRigidDynamicsWorld>>(*this, solver.get());
      soft->getWorldInfo().air_density = 0;
      if (arena) exclude_distance_fields(*this);
      soft->setInternalTickCallback(before_soft_sub_step, this, true);
    } else {
      fill_world<LazyWorld<btDiscreteDynamicsWorld>>(*this, solver.get());
    }
    // An MLCP solver solves each batch of islands as one matrix: one island per batch keeps the matrices small.
    if (mlcp) world->getSolverInfo().m_minimumSolverBatchSize = 1;
  }
  world->setWorldUserInfo(this);
  dispatcher.setNearCallback(near_callback);
  broadphase.keeps_order = solver_kind != AmbSolver_Accurate;
}

void AmbWorld::adopt(AmbObject &object, const AmbShape *shape, AmbHandle handle) {
  // It finds its first pairs when it comes.
  catch_up_with_bounds();
  if (shape) prepare_for(*shape);
  object.index = next_index++;
  object.handle = handle;
}

void AmbWorld::prepare_for(const AmbShape &shape) {
  if (shape.needs_gimpact && !has_gimpact) {
    btGImpactCollisionAlgorithm::registerAlgorithm(&dispatcher);
    has_gimpact = true;
  }
  if (shape.needs_gimpact && extension) extension->mesh_comes(shape);
  if (!shape.has_volume || has_volume) return;
  has_volume = true;
  if (extension) extension->volumes_come();
}

void AmbWorld::ignore_pair(AmbObject &a, btCollisionObject &object_a, AmbObject &b, btCollisionObject &object_b) {
  a.ignore(b, 1);
  broadphase.is_unknown = true;
  btOverlappingPairCache &pairs = *broadphase.getOverlappingPairCache();
  btBroadphasePair *pair = pairs.findPair(object_a.getBroadphaseHandle(), object_b.getBroadphaseHandle());
  if (pair) pairs.cleanOverlappingPair(*pair, &dispatcher);
}

void AmbWorld::find_what_may_touch() {
  if (!broadphase.is_unknown) return;
  const btCollisionObjectArray &objects = world->getCollisionObjectArray();
  const auto may_touch = [this](const btCollisionObject &a, const btCollisionObject &b) {
    auto *first = const_cast<btBroadphaseProxy *>(a.getBroadphaseHandle());
    auto *second = const_cast<btBroadphaseProxy *>(b.getBroadphaseHandle());
    return broadphase.pairs.needsBroadphaseCollision(first, second) && !touches_nothing(*b.getCollisionShape()) &&
           !object_of(&a)->ignores(*object_of(&b));
  };
  broadphase.may_touch = false;
  for (int i = 0; i < objects.size() && !broadphase.may_touch; ++i) {
    const btCollisionObject &object = *objects[i];
    // Static objects do not touch each other.
    if (object.isStaticOrKinematicObject() || touches_nothing(*object.getCollisionShape())) continue;
    for (int k = 0; k < objects.size() && !broadphase.may_touch; ++k)
      broadphase.may_touch = k != i && may_touch(object, *objects[k]);
  }
  broadphase.is_unknown = false;
}

void AmbWorld::catch_up_with_bounds() {
  if (!broadphase.lags) return;
  broadphase.lags = false;
  world->updateAabbs();
}

namespace {

void count_constraint(AmbWorld &world, const AmbConstraint &constraint, int change) {
  if (constraint.disables_collision) {
    world.broadphase.is_unknown = true;
    AmbObject *a = object_of(&constraint.constraint->getRigidBodyA());
    AmbObject *b = object_of(&constraint.constraint->getRigidBodyB());
    if (a && b) a->ignore(*b, change);
  }
  for (const btRigidBody *body : {&constraint.constraint->getRigidBodyA(), &constraint.constraint->getRigidBodyB()}) {
    AmbBody *owner = body_of(body);
    if (!owner) continue;
    owner->constraint_count += change;
    set_sleeping_thresholds(world, *owner);
  }
}

}  // namespace

extern "C" {

AmbWorld *amb_world_new(int solver, int kind, int manifolds, AmbArena *arena, const AmbEngine *engine) {
  AmbArena *const before = amb_arena_enter(arena);
  auto *world = new AmbWorld(solver, kind, manifolds, arena, engine);
  amb_arena_enter(before);
  return world;
}

void amb_world_restore(AmbWorld *world, AmbArena *arena, const unsigned char *copy, unsigned long size) {
  if (world->soft) {
    restore_soft_bodies(*world, *arena, copy, size);
  } else {
    restore_arena(*arena, copy, size);
  }
}

void amb_world_free(AmbWorld *world) { delete world; }

void amb_world_set_gravity(AmbWorld *world, const double gravity[3]) {
  // Bullet does not set the gravity of sleeping bodies.
  btCollisionObjectArray &objects = world->world->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) objects[i]->activate();
  world->world->setGravity(vector_of(gravity));
  for (int i = 0; i < objects.size(); ++i) {
    if (AmbBody *body = body_of(objects[i])) set_sleeping_thresholds(*world, *body);
  }
  if (world->soft) world->soft->getWorldInfo().m_gravity = vector_of(gravity);
  if (world->extension) world->extension->gravity_set(vector_of(gravity));
}

void amb_world_set_iterations(AmbWorld *world, int iterations) {
  world->world->getSolverInfo().m_numIterations = iterations;
}

void amb_world_set_lag(AmbWorld *world, int enabled) { world->world->setLatencyMotionStateInterpolation(enabled != 0); }

void amb_world_add_body(AmbWorld *world, AmbBody *body, AmbHandle handle) {
  world->adopt(*body, body->shape, handle);
  body->motion.follow(world->clock);
  body->world = world;
  world->world->addRigidBody(&body->body);
  set_activation_state(*world, *body);
}

void amb_world_remove_body(AmbWorld *world, AmbBody *body) {
  const auto is_it = [body](const AmbWorld::Moved &moved) { return moved.body == body; };
  world->moved.erase(std::remove_if(world->moved.begin(), world->moved.end(), is_it), world->moved.end());
  if (world->soft) forget_in_soft_bodies(*world, *body);
  if (world->extension) world->extension->body_leaves(*body);
  activate_neighbours(*world, *body);
  world->world->removeRigidBody(&body->body);
  body->world = nullptr;
}

void amb_world_make_visual_only(AmbWorld *world, AmbBody *body) {
  // The motion state is updated before the body becomes static, after which it is not extrapolated any more.
  body->motion.pose();
  amb_world_remove_body(world, body);
  const btVector3 zero(0, 0, 0);
  body->body.setMassProps(0, zero);
  body->body.setLinearVelocity(zero);
  body->body.setAngularVelocity(zero);
  body->body.clearForces();
  world->world->addRigidBody(&body->body, 0, 0);
  body->world = world;
  set_activation_state(*world, *body);
}

void amb_world_add_constraint(AmbWorld *world, AmbConstraint *constraint, int disable_collisions) {
  constraint->disables_collision = disable_collisions != 0;
  count_constraint(*world, *constraint, 1);
  activate_bodies(*constraint);
  if (world->extension && world->extension->add_constraint(*constraint)) return;
  world->world->addConstraint(constraint->constraint.get());
}

void amb_world_remove_constraint(AmbWorld *world, AmbConstraint *constraint) {
  count_constraint(*world, *constraint, -1);
  activate_bodies(*constraint);
  if (world->extension && world->extension->remove_constraint(*constraint)) return;
  world->world->removeConstraint(constraint->constraint.get());
}

void amb_world_ignore_pair(AmbWorld *world, AmbBody *a, AmbBody *b) {
  world->ignore_pair(*a, *a->collider, *b, *b->collider);
  a->body.activate();
  b->body.activate();
}

int amb_world_step(AmbWorld *world, double interval, int max_sub_steps, double sub_step) {
  world->contact_impulse_scale = 1;
  const int due = world->world->stepSimulation(interval, max_sub_steps, sub_step);
  if (world->soft) after_soft_step(*world);
  return due;
}

int amb_world_begin_step(AmbWorld *world, double interval, int max_sub_steps, double sub_step) {
  return world->stepper->begin(interval, max_sub_steps, sub_step);
}

void amb_world_advance(AmbWorld *world, double length, double sub_step) {
  world->contact_impulse_scale = sub_step / length;
  world->stepper->advance(length);
}

void amb_world_finish_step(AmbWorld *world) {
  world->stepper->finish();
  if (world->soft) after_soft_step(*world);
}

namespace {

// Creates all proxies of the broad phase again: the order of pairs, and hence of solver rows, then depends on the poses
// only. AABBs that were not finite are replaced.
void rebuild_broadphase(AmbWorld &world) {
  btCollisionObjectArray &objects = world.world->getCollisionObjectArray();
  // First, because a proxy that is destroyed looks for its pairs among all.
  btOverlappingPairCache &pairs = *world.broadphase.getOverlappingPairCache();
  const btBroadphasePairArray &all = pairs.getOverlappingPairArray();
  for (int i = all.size(); i-- > 0;)
    pairs.removeOverlappingPair(all[i].m_pProxy0, all[i].m_pProxy1, &world.dispatcher);
  std::vector<btBroadphaseProxy> old;
  old.reserve(objects.size());
  for (int i = 0; i < objects.size(); ++i) {
    btBroadphaseProxy *proxy = objects[i]->getBroadphaseHandle();
    old.push_back(*proxy);
    world.broadphase.destroyProxy(proxy, &world.dispatcher);
  }
  world.broadphase.resetPool(&world.dispatcher);
  world.broadphase.lags = false;
  for (int i = 0; i < objects.size(); ++i) {
    btCollisionObject *object = objects[i];
    btVector3 low, high;
    object->getCollisionShape()->getAabb(object->getWorldTransform(), low, high);
    const btBroadphaseProxy &proxy = old[i];
    object->setBroadphaseHandle(world.broadphase.createProxy(low, high, object->getCollisionShape()->getShapeType(),
                                                             object, proxy.m_collisionFilterGroup,
                                                             proxy.m_collisionFilterMask, &world.dispatcher));
  }
}

}  // namespace

void amb_world_recover(AmbWorld *world) {
  btCollisionObjectArray &objects = world->world->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    btCollisionObject *object = objects[i];
    AmbBody *body = body_of(object);
    // Only bodies are put to sleep.
    object->forceActivationState(body ? DISABLE_DEACTIVATION : ACTIVE_TAG);
    if (body && object == &body->body) {
      body->motion.pose();
      set_activation_state(*world, *body);
      // setWorldTransform does not update the inertia tensor in world axes.
      body->body.updateInertiaTensor();
    }
    object->setInterpolationWorldTransform(object->getWorldTransform());
    object->setInterpolationLinearVelocity(btVector3(0, 0, 0));
    object->setInterpolationAngularVelocity(btVector3(0, 0, 0));
  }
  rebuild_broadphase(*world);
  world->stepper->forget_time();
  world->contact_impulse_scale = 1;
  world->solver->reset();
  if (world->extension) world->extension->recovered();
}

int amb_world_pair_count(const AmbWorld *world) { return world->broadphase.pairs.getNumOverlappingPairs(); }

int amb_world_contact_count(const AmbWorld *world) {
  int count = 0;
  for (int i = 0; i < world->dispatcher.getNumManifolds(); ++i) {
    const btPersistentManifold *manifold = world->dispatcher.getManifoldByIndexInternal(i);
    if (responds(*manifold)) count += manifold->getNumContacts();
  }
  return count;
}

}  // extern "C"
