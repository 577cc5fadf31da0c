#include "articulation_rows.h"

#include <algorithm>

#include <BulletCollision/CollisionDispatch/btSimulationIslandManager.h>
#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

namespace {

// Islands of bodies that constraints or contacts connect. Bullet's islands also unite bodies whose bounding boxes overlap:
// tolerances, budgets and corrections that are found for an island would depend on bodies that nothing connects with it.
class ConnectedIslands : public btSimulationIslandManager {
 public:
  // As Bullet's function, apart from the unions; constraints are united by the world afterwards.
  void updateActivationState(btCollisionWorld *world, btDispatcher *dispatcher) override {
    btCollisionObjectArray &objects = world->getCollisionObjectArray();
    int count = 0;
    for (int i = 0; i < objects.size(); ++i) {
      btCollisionObject &object = *objects[i];
      if (!object.isStaticOrKinematicObject()) object.setIslandTag(count++);
      object.setCompanionId(-1);
      object.setHitFraction(1);
    }
    initUnionFind(count);
    for (int i = 0; i < dispatcher->getNumManifolds(); ++i) {
      const btPersistentManifold &manifold = *dispatcher->getManifoldByIndexInternal(i);
      const btCollisionObject &first = *manifold.getBody0(), &second = *manifold.getBody1();
      if (manifold.getNumContacts() > 0 && first.mergesSimulationIslands() && second.mergesSimulationIslands())
        getUnionFind().unite(first.getIslandTag(), second.getIslandTag());
    }
  }
};

// Solves each island by itself.
class IslandSolver : public InArena<MultiBodyInplaceSolverIslandCallback> {
 public:
  using InArena<MultiBodyInplaceSolverIslandCallback>::InArena;

  void processIsland(btCollisionObject **bodies, int n, btPersistentManifold **manifolds, int manifold_count,
                     int island) override {
    // Manifolds without contacts may name a body of another island.
    btPersistentManifold **const end = std::remove_if(
        manifolds, manifolds + manifold_count, [](const btPersistentManifold *m) { return m->getNumContacts() == 0; });
    MultiBodyInplaceSolverIslandCallback::processIsland(bodies, n, manifolds, static_cast<int>(end - manifolds), island);
    if (m_bodies.size() > 0) processConstraints(island);
  }
};

}  // namespace

ArticulatedWorld::ArticulatedWorld(MotionClock &clock, btDispatcher *dispatcher, btBroadphaseInterface *broadphase,
                                   btMultiBodyConstraintSolver *solver, btCollisionConfiguration *configuration)
    : LazyWorld(clock, dispatcher, broadphase, solver, configuration) {
  // Bullet allocates its callback on the heap; this one is in the arena.
  delete m_solverMultiBodyIslandCallback;
  m_solverMultiBodyIslandCallback = new IslandSolver(solver, dispatcher);
  m_islandManager->~btSimulationIslandManager();
  btAlignedFree(m_islandManager);
  m_islandManager = new (btAlignedAlloc(sizeof(ConnectedIslands), 16)) ConnectedIslands;
}

// Articulations add the gravity of their links themselves.
void ArticulatedWorld::applyGravity() { btDiscreteDynamicsWorld::applyGravity(); }

void ArticulatedWorld::addMultiBody(btMultiBody *body, int group, int mask) {
  multi_body_places.add(body, m_multiBodies.size());
  LazyWorld::addMultiBody(body, group, mask);
}

void ArticulatedWorld::removeMultiBody(btMultiBody *body) { multi_body_places.remove(m_multiBodies, body); }

void ArticulatedWorld::addMultiBodyConstraint(btMultiBodyConstraint *constraint) {
  multi_body_constraint_places.add(constraint, m_multiBodyConstraints.size());
  LazyWorld::addMultiBodyConstraint(constraint);
}

void ArticulatedWorld::removeMultiBodyConstraint(btMultiBodyConstraint *constraint) {
  multi_body_constraint_places.remove(m_multiBodyConstraints, constraint);
}

void ArticulatedWorld::clearForces() {
  btDiscreteDynamicsWorld::clearForces();
  for (AmbArticulation *articulation : articulations) articulation->clear_forces();
}

void ArticulatedWorld::predictUnconstraintMotion(btScalar h) { btDiscreteDynamicsWorld::predictUnconstraintMotion(h); }

void ArticulatedWorld::solveConstraints(btContactSolverInfo &info) {
  move_freely(info);
  m_constraintSolver->prepareSolve(getNumCollisionObjects(), getDispatcher()->getNumManifolds());
  if (is_solved()) return;
  LazyWorld::calculateSimulationIslands();
  // The part of Bullet's solveExternalForces that is not dynamics: sorting constraints by island.
  m_sortedConstraints.copyFromArray(m_constraints);
  m_sortedConstraints.quickSort(btSortConstraintOnIslandPredicate2());
  m_sortedMultiBodyConstraints.resize(0);
  for (int i = 0; i < m_multiBodyConstraints.size(); ++i)
    m_sortedMultiBodyConstraints.push_back(m_multiBodyConstraints[i]);
  m_sortedMultiBodyConstraints.quickSort(btSortMultiBodyConstraintOnIslandPredicate());
  btTypedConstraint **typed = m_sortedConstraints.size() ? &m_sortedConstraints[0] : nullptr;
  btMultiBodyConstraint **rows = m_sortedMultiBodyConstraints.size() ? &m_sortedMultiBodyConstraints[0] : nullptr;
  m_solverMultiBodyIslandCallback->setup(&info, typed, m_sortedConstraints.size(), rows,
                                         m_sortedMultiBodyConstraints.size(), getDebugDrawer());
  buildIslands();
  solveInternalConstraints(info);
}

// Whether the motion without constraints is that of the sub-step: nothing moves but articulations without rows.
bool ArticulatedWorld::is_solved() const {
  for (int i = 0; i < m_nonStaticRigidBodies.size(); ++i) {
    if (!m_nonStaticRigidBodies[i]->isStaticOrKinematicObject()) return false;
  }
  for (int i = 0; i < m_constraints.size(); ++i) {
    const btTypedConstraint &constraint = *m_constraints[i];
    if (!constraint.getRigidBodyA().isStaticOrKinematicObject() || !constraint.getRigidBodyB().isStaticOrKinematicObject()) return false;
  }
  return std::none_of(articulations.begin(), articulations.end(), [](const auto *each) { return *each->tree->has_rows; });
}

// Finds the motion of articulations over the next sub-step without contacts and external constraints.
void ArticulatedWorld::move_freely(btContactSolverInfo &info) {
  // Contact rows of links are warm-started, and have two friction directions: a single one would have a fixed
  // direction.
  if (!articulations.empty()) {
    info.m_solverMode |= SOLVER_USE_ARTICULATED_WARMSTARTING | SOLVER_USE_2_FRICTION_DIRECTIONS;
  }
  for (AmbArticulation *articulation : articulations) {
    articulation->has_contact = false;
    articulation->apply_set_state();
  }
  for (int i = 0; !articulations.empty() && i < getDispatcher()->getNumManifolds(); ++i) {
    const btPersistentManifold &manifold = *getDispatcher()->getManifoldByIndexInternal(i);
    if (manifold.getNumContacts() == 0) continue;
    for (const btCollisionObject *object : {manifold.getBody0(), manifold.getBody1()}) {
      const AmbBody *body = body_of(object);
      if (body && body->articulation) body->articulation->has_contact = true;
    }
  }
  clearMultiBodyConstraintForces();
  for (AmbArticulation *articulation : articulations) {
    articulation->move_freely(info.m_timeStep);
    if (*articulation->tree->has_rows) articulation->prepare_rows(info.m_timeStep);
  }
}

void ArticulatedWorld::integrateTransforms(btScalar h) {
  btDiscreteDynamicsWorld::integrateTransforms(h);
  for (AmbArticulation *articulation : articulations) articulation->finish(h);
  if (!engine_of(*static_cast<AmbWorld *>(getWorldUserInfo())).has_reactions) return;
  for (AmbConstraint *constraint : external_constraints) constraint->external_rows->write_feedback(h);
}

void ArticulatedWorld::restore_order(AmbConstraint *const *constraints, int n, const Vector<AmbCoupling *> &couplings) {
  const auto is_earlier = [](const btCollisionObject *a, const btCollisionObject *b) {
    return object_of(a)->index < object_of(b)->index;
  };
  m_collisionObjects.quickSort(is_earlier);
  for (int i = 0; i < m_collisionObjects.size(); ++i) m_collisionObjects[i]->setWorldArrayIndex(i);
  m_nonStaticRigidBodies.quickSort(is_earlier);
  for (int i = 0; i < m_nonStaticRigidBodies.size(); ++i) body_of(m_nonStaticRigidBodies[i])->place = i;
  m_constraints.resize(0);
  for (int i = 0; i < n; ++i) {
    if (!constraints[i]) continue;
    constraint_places.add(constraints[i]->constraint.get(), m_constraints.size());
    m_constraints.push_back(constraints[i]->constraint.get());
  }
  for (AmbCoupling *coupling : couplings) {
    coupling->reset();
    for (const auto &link : coupling->links) {
      constraint_places.add(link.get(), m_constraints.size());
      m_constraints.push_back(link.get());
    }
  }
}

bool acts_on_link(const AmbConstraint &constraint) {
  return first_of(constraint).articulation || second_of(constraint).articulation;
}

void add_external_constraint(AmbWorld &world, AmbConstraint &constraint) {
  btTransform frame_a, frame_b;
  frame_a.setIdentity();
  frame_b.setIdentity();
  int rows = 3;
  if (constraint.kind == Kind::Fixed) {
    auto &fixed = constraint.as<btFixedConstraint>();
    frame_a = fixed.getFrameOffsetA();
    frame_b = fixed.getFrameOffsetB();
    rows = 6;
  } else {
    auto &point = constraint.as<btPoint2PointConstraint>();
    frame_a.setOrigin(point.getPivotInA());
    frame_b.setOrigin(point.getPivotInB());
  }
  AmbBody &a = first_of(constraint), &b = second_of(constraint);
  constraint.external_rows = a.articulation
                                 ? make_in_arena<ExternalConstraintRows>(constraint, a, frame_a, b, frame_b, rows)
                                 : make_in_arena<ExternalConstraintRows>(constraint, b, frame_b, a, frame_a, rows);
  for (AmbBody *body : {&a, &b}) {
    if (!body->articulation) continue;
    ++body->articulation->external_constraint_count;
  }
  world.articulated->addMultiBodyConstraint(constraint.external_rows.get());
  world.articulated->external_constraints.push_back(&constraint);
}

void remove_external_constraint(AmbWorld &world, AmbConstraint &constraint) {
  world.articulated->removeMultiBodyConstraint(constraint.external_rows.get());
  auto &external_constraints = world.articulated->external_constraints;
  for (size_t i = external_constraints.size(); i-- > 0;) {
    if (external_constraints[i] == &constraint) external_constraints.erase(external_constraints.begin() + i);
  }
  for (AmbBody *body : {&first_of(constraint), &second_of(constraint)}) {
    if (!body->articulation) continue;
    --body->articulation->external_constraint_count;
  }
  constraint.external_rows.reset();
}

extern "C" {

void amb_world_set_reactions(AmbWorld *world, int enabled) { engine_of(*world).has_reactions = enabled != 0; }

void amb_world_restore_order(AmbWorld *world, AmbConstraint *const *constraints, int n) {
  world->articulated->restore_order(constraints, n, engine_of(*world).couplings);
}

}  // extern "C"
