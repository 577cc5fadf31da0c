// A plain Bullet program for scenes that were built through the shim: the same bodies, constraints, solver and
// parameters only.
#include "../shim/internal.h"

#include <BulletCollision/Gimpact/btGImpactCollisionAlgorithm.h>

#include <ctime>

namespace {

// Work that is skipped; bits as in the benchmark.
enum Skip { MotionStates = 1, Prediction = 2, PairLists = 4, StaticBodies = 8, SingleCompounds = 16 };

class BareWorld : public btDiscreteDynamicsWorld {
 public:
  using btDiscreteDynamicsWorld::btDiscreteDynamicsWorld;

  void synchronizeMotionStates() override {
    if (!(skips & MotionStates)) btDiscreteDynamicsWorld::synchronizeMotionStates();
  }

  void createPredictiveContacts(btScalar dt) override {
    if (!(skips & Prediction)) btDiscreteDynamicsWorld::createPredictiveContacts(dt);
  }

  int skips = 0;
};

void skip_ignored(btBroadphasePair &pair, btCollisionDispatcher &dispatcher, const btDispatcherInfo &info) {
  const auto *a = static_cast<const btCollisionObject *>(pair.m_pProxy0->m_clientObject);
  const auto *b = static_cast<const btCollisionObject *>(pair.m_pProxy1->m_clientObject);
  if (!object_of(a)->ignores(*object_of(b))) btCollisionDispatcher::defaultNearCallback(pair, dispatcher, info);
}

// The child of a compound with one child at the identity pose; else the shape itself.
btCollisionShape *single(btCollisionShape *shape) {
  if (!shape->isCompound()) return shape;
  auto &compound = static_cast<btCompoundShape &>(*shape);
  const bool is_single =
      compound.getNumChildShapes() == 1 && compound.getChildTransform(0) == btTransform::getIdentity();
  return is_single ? compound.getChildShape(0) : shape;
}

struct Bare {
  btDefaultCollisionConfiguration configuration;
  btCollisionDispatcher dispatcher{&configuration};
  btDbvtBroadphase broadphase;
  std::unique_ptr<btConstraintSolver> solver;
  std::unique_ptr<BareWorld> world;
  std::vector<btRigidBody *> bodies;
  std::vector<std::unique_ptr<btDefaultMotionState>> motions;
};

}  // namespace

extern "C" {

// Moves the scene of a shim's world into a plain world; null for scenes with other objects than rigid bodies and
// constraints. The shim's world must not be used or freed afterwards.
Bare *bare_take(AmbWorld *from, int skips) {
  btDiscreteDynamicsWorld &old = *from->world;
  btCollisionObjectArray &objects = old.getCollisionObjectArray();
  std::vector<AmbBody *> owners;
  for (int i = 0; i < objects.size(); ++i) {
    AmbBody *owner = body_of(objects[i]);
    if (!owner || from->soft || from->articulated) return nullptr;
    owners.push_back(owner);
  }
  std::vector<std::pair<btTypedConstraint *, bool>> constraints;
  for (int i = 0; i < old.getNumConstraints(); ++i) {
    btTypedConstraint *constraint = old.getConstraint(i);
    const AmbObject &a = *object_of(&constraint->getRigidBodyA()), &b = *object_of(&constraint->getRigidBodyB());
    constraints.emplace_back(constraint, a.ignores(b));
  }
  auto *bare = new Bare;
  bare->solver = std::move(from->solver);
  bare->world =
      std::make_unique<BareWorld>(&bare->dispatcher, &bare->broadphase, bare->solver.get(), &bare->configuration);
  bare->world->skips = skips;
  if (skips & PairLists) bare->dispatcher.setNearCallback(skip_ignored);
  bare->world->setForceUpdateAllAabbs(!(skips & StaticBodies));
  if (from->has_gimpact) btGImpactCollisionAlgorithm::registerAlgorithm(&bare->dispatcher);
  bare->world->getSolverInfo() = old.getSolverInfo();
  bare->world->setGravity(old.getGravity());
  for (auto &[constraint, disables_collision] : constraints) old.removeConstraint(constraint);
  for (AmbBody *owner : owners) {
    btRigidBody &body = owner->body;
    const btVector3 gravity = body.getGravity();
    old.removeRigidBody(&body);
    bare->motions.push_back(std::make_unique<btDefaultMotionState>(body.getWorldTransform()));
    body.setMotionState(bare->motions.back().get());
    if (skips & SingleCompounds) body.setCollisionShape(single(body.getCollisionShape()));
    if ((skips & StaticBodies) && body.isStaticObject()) body.forceActivationState(ISLAND_SLEEPING);
    bare->world->addRigidBody(&body);
    body.setGravity(gravity);
    bare->bodies.push_back(&body);
  }
  for (auto &[constraint, disables_collision] : constraints) bare->world->addConstraint(constraint, disables_collision);
  if (skips & PairLists) return bare;
  // Bullet's lists of ignored objects instead of the shim's bit sets.
  for (AmbBody *a : owners) {
    for (AmbBody *b : owners) {
      if (a->index < b->index && a->ignores(*b)) a->body.setIgnoreCollisionCheck(&b->body, true);
    }
  }
  return bare;
}

void bare_step(Bare *bare, int steps, double dt) {
  for (int i = 0; i < steps; ++i) bare->world->stepSimulation(dt, 10, dt);
}

// Writes the motion state (12), linear (3) and angular (3) velocity of every body.
void bare_states(const Bare *bare, double *out) {
  for (size_t i = 0; i < bare->bodies.size(); ++i, out += 18) {
    write_pose(bare->motions[i]->m_graphicsWorldTrans, out);
    write_vector(bare->bodies[i]->getLinearVelocity(), out + 12);
    write_vector(bare->bodies[i]->getAngularVelocity(), out + 15);
  }
}

double bare_cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

}  // extern "C"
