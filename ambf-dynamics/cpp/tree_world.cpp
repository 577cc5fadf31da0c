#include "tree_rows.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

TreeWorld::TreeWorld(MotionClock &clock, btDispatcher *dispatcher, btBroadphaseInterface *broadphase,
                     btMultiBodyConstraintSolver *solver, btCollisionConfiguration *configuration)
    : Lean(clock, dispatcher, broadphase, solver, configuration) {
  // Bullet's own lies on the heap.
  delete m_solverMultiBodyIslandCallback;
  m_solverMultiBodyIslandCallback = new Held<MultiBodyInplaceSolverIslandCallback>(solver, dispatcher);
}

// Trees take the gravity of their bodies themselves.
void TreeWorld::applyGravity() { btDiscreteDynamicsWorld::applyGravity(); }

void TreeWorld::clearForces() {
  btDiscreteDynamicsWorld::clearForces();
  for (AmbTree *tree : trees) tree->clear_forces();
}

void TreeWorld::predictUnconstraintMotion(btScalar h) { btDiscreteDynamicsWorld::predictUnconstraintMotion(h); }

void TreeWorld::solveExternalForces(btContactSolverInfo &info) {
  // Rows of trees start from what their constraints found. Of one friction direction Bullet would take a fixed one.
  if (!trees.empty()) info.m_solverMode |= SOLVER_USE_ARTICULATED_WARMSTARTING | SOLVER_USE_2_FRICTION_DIRECTIONS;
  for (AmbTree *tree : trees) {
    tree->touched = false;
    tree->settle();
  }
  for (int i = 0; !trees.empty() && i < getDispatcher()->getNumManifolds(); ++i) {
    const btPersistentManifold &manifold = *getDispatcher()->getManifoldByIndexInternal(i);
    if (manifold.getNumContacts() == 0) continue;
    for (const btCollisionObject *object : {manifold.getBody0(), manifold.getBody1()}) {
      const AmbBody *body = body_of(object);
      if (body && body->tree) body->tree->touched = true;
    }
  }
  clearMultiBodyConstraintForces();
  for (AmbTree *tree : trees) {
    tree->predict(info.m_timeStep);
    if (tree->has_rows) tree->prepare_rows();
  }
  // What Bullet does in this place beside the dynamics: constraints by island.
  m_sortedConstraints.copyFromArray(m_constraints);
  m_sortedConstraints.quickSort(btSortConstraintOnIslandPredicate2());
  m_sortedMultiBodyConstraints.resize(0);
  for (int i = 0; i < m_multiBodyConstraints.size(); ++i) m_sortedMultiBodyConstraints.push_back(m_multiBodyConstraints[i]);
  m_sortedMultiBodyConstraints.quickSort(btSortMultiBodyConstraintOnIslandPredicate());
  btTypedConstraint **typed = m_sortedConstraints.size() ? &m_sortedConstraints[0] : nullptr;
  btMultiBodyConstraint **rows = m_sortedMultiBodyConstraints.size() ? &m_sortedMultiBodyConstraints[0] : nullptr;
  m_solverMultiBodyIslandCallback->setup(&info, typed, m_sortedConstraints.size(), rows,
                                         m_sortedMultiBodyConstraints.size(), getDebugDrawer());
  m_constraintSolver->prepareSolve(getNumCollisionObjects(), getDispatcher()->getNumManifolds());
}

void TreeWorld::integrateTransforms(btScalar h) {
  btDiscreteDynamicsWorld::integrateTransforms(h);
  for (AmbTree *tree : trees) tree->integrate(h);
  for (AmbConstraint *constraint : ties) constraint->tie->write_feedback(h);
}

bool holds_link(const AmbConstraint &constraint) { return first_of(constraint).tree || second_of(constraint).tree; }

void add_tie(AmbWorld &world, AmbConstraint &constraint) {
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
  constraint.tie = a.tree ? make_held<TieRows>(constraint, a, frame_a, b, frame_b, rows)
                          : make_held<TieRows>(constraint, b, frame_b, a, frame_a, rows);
  for (AmbBody *body : {&a, &b}) {
    if (!body->tree) continue;
    ++body->tree->ties;
    AmbBody *other = body == &a ? &b : &a;
    if (constraint.parts) body->tree->members[body->member].collider->parted.push_back(other);
  }
  world.trees->addMultiBodyConstraint(constraint.tie.get());
  world.trees->ties.push_back(&constraint);
}

void remove_tie(AmbWorld &world, AmbConstraint &constraint) {
  world.trees->removeMultiBodyConstraint(constraint.tie.get());
  auto &ties = world.trees->ties;
  for (size_t i = ties.size(); i-- > 0;) {
    if (ties[i] == &constraint) ties.erase(ties.begin() + i);
  }
  for (AmbBody *body : {&first_of(constraint), &second_of(constraint)}) {
    if (!body->tree) continue;
    --body->tree->ties;
    const AmbObject *other = body == &first_of(constraint) ? &second_of(constraint) : &first_of(constraint);
    auto &parted = body->tree->members[body->member].collider->parted;
    for (size_t i = parted.size(); constraint.parts && i-- > 0;) {
      if (parted[i] != other) continue;
      parted.erase(parted.begin() + i);
      break;
    }
  }
  constraint.tie.reset();
}
