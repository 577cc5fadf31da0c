#include "articulation_solver.h"

#include "articulation_rows.h"

const AmbIslandTable *island_table = nullptr;
const TreeTable *tree_table = nullptr;

namespace {

// Maximum number of contacts of a pair of bodies with rows of rolling and spinning friction.
constexpr int ROLLING_CONTACTS = 4;

void clear(btMultiBodySolverConstraint &row) {
  const btVector3 zero(0, 0, 0);
  row.m_relpos1CrossNormal = row.m_contactNormal1 = row.m_angularComponentA = zero;
  row.m_relpos2CrossNormal = row.m_contactNormal2 = row.m_angularComponentB = zero;
  row.m_multiBodyA = row.m_multiBodyB = nullptr;
  row.m_linkA = row.m_linkB = row.m_deltaVelAindex = row.m_deltaVelBindex = row.m_jacAindex = row.m_jacBindex = -1;
  row.m_orgConstraint = nullptr;
  row.m_orgDofIndex = row.m_frictionIndex = row.m_overrideNumSolverIterations = -1;
  row.m_originalContactPoint = nullptr;
  row.m_appliedImpulse = row.m_appliedPushImpulse = 0;
  row.m_friction = row.m_jacDiagABInv = row.m_rhs = row.m_rhsPenetration = row.m_cfm = 0;
  row.m_lowerLimit = -BT_LARGE_FLOAT;
  row.m_upperLimit = BT_LARGE_FLOAT;
}

}  // namespace

btMultiBodySolverConstraint &EngineRows::new_row(btMultiBodyConstraintArray &rows, int index,
                                                 const btMultiBodyJacobianData &data) {
  btMultiBodySolverConstraint &row = rows.expandNonInitializing();
  clear(row);
  row.m_orgConstraint = this;
  row.m_orgDofIndex = index;
  row.m_solverBodyIdA = row.m_solverBodyIdB = data.m_fixedBodyId;
  return row;
}

int velocities_of(const AmbArticulation &articulation, btMultiBodyJacobianData &data) {
  btMultiBody &multi_body = *articulation.multi_body;
  int velocity = multi_body.getCompanionId();
  if (velocity < 0) {
    velocity = data.m_deltaVelocities.size();
    multi_body.setCompanionId(velocity);
    data.m_deltaVelocities.resize(velocity + articulation.tree->velocities(), 0);
  }
  return velocity;
}

RowMotion act_on_member(btMultiBodySolverConstraint &row, int side, AmbArticulation &articulation, int member,
                        const btVector3 &linear, const btVector3 &angular, btMultiBodyJacobianData &data) {
  const Tree &tree = *articulation.tree;
  const int n = tree.velocities(), velocity = velocities_of(articulation, data), at = data.m_jacobians.size();
  (side ? row.m_contactNormal2 : row.m_contactNormal1) = linear;
  (side ? row.m_relpos2CrossNormal : row.m_relpos1CrossNormal) = angular;
  (side ? row.m_multiBodyB : row.m_multiBodyA) = articulation.multi_body.get();
  (side ? row.m_linkB : row.m_linkA) = member - 1;
  (side ? row.m_deltaVelBindex : row.m_deltaVelAindex) = velocity;
  (side ? row.m_jacBindex : row.m_jacAindex) = at;
  data.m_jacobians.resize(at + n, 0);
  tree_table->add_to_row(&tree, member, &linear, &angular, &data.m_jacobians[at]);
  data.m_deltaVelocitiesUnitImpulse.resize(at + n);
  // If both sides act on members of the same articulation, the mixed terms are added too.
  const bool is_twice = side == 1 && row.m_multiBodyA == row.m_multiBodyB;
  RowMotion motion;
  motion.velocity = linear.dot(tree.linear[member]) + angular.dot(tree.angular[member]);
  for (int k = 0; k < n; ++k) {
    const btScalar q = data.m_jacobians[at + k];
    data.m_deltaVelocitiesUnitImpulse[at + k] = q;
    motion.response += is_twice ? q * (q + 2 * data.m_jacobians[row.m_jacAindex + k]) : q * q;
  }
  return motion;
}

RowMotion act_on_body(btMultiBodySolverConstraint &row, int side, int id, const btVector3 &linear,
                      const btVector3 &angular, const btAlignedObjectArray<btSolverBody> &bodies) {
  (side ? row.m_solverBodyIdB : row.m_solverBodyIdA) = id;
  (side ? row.m_contactNormal2 : row.m_contactNormal1) = linear;
  (side ? row.m_relpos2CrossNormal : row.m_relpos1CrossNormal) = angular;
  const btSolverBody &body = bodies[id];
  RowMotion motion;
  if (!body.m_originalBody) return motion;
  const btVector3 turned =
      body.m_originalBody->getInvInertiaTensorWorld() * angular * body.m_originalBody->getAngularFactor();
  (side ? row.m_angularComponentB : row.m_angularComponentA) = turned;
  motion.velocity = linear.dot(body.m_linearVelocity + body.m_externalForceImpulse) +
                    angular.dot(body.m_angularVelocity + body.m_externalTorqueImpulse);
  motion.response = linear.dot(linear * body.internalGetInvMass()) + angular.dot(turned);
  return motion;
}

// A contact point of a link.
struct ArticulationSolver::LinkContact {
  struct Touching {
    AmbArticulation *articulation = nullptr;
    // Index of the member of the articulation; or of the solver body if `articulation` is null.
    int member = 0, id = 0;
    btVector3 center{0, 0, 0};
  };
  Touching sides[2];
  btManifoldPoint *point = nullptr;
  int normal = 0;
};

void ArticulationSolver::convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) {
  link_bounces_.clear();
  for (int i = 0; i < n; ++i) {
    btPersistentManifold &manifold = *manifolds[i];
    if (btMultiBodyLinkCollider::upcast(manifold.getBody0()) || btMultiBodyLinkCollider::upcast(manifold.getBody1())) {
      convert_link_contacts(manifold, info);
    } else {
      convertContact(&manifold, info);
    }
  }
  m_data.m_solverBodyPool = &m_tmpSolverBodyPool;
  m_data.m_fixedBodyId = m_fixedBodyId;
  for (int i = 0; i < m_tmpNumMultiBodyConstraints; ++i) {
    m_tmpMultiBodyConstraints[i]->createConstraintRows(m_multiBodyNonContactConstraints, m_data, info);
  }
}

void ArticulationSolver::convert_link_contacts(btPersistentManifold &manifold, const btContactSolverInfo &info) {
  const btScalar h = info.m_timeStep;
  LinkContact contact;
  for (int k = 0; k < 2; ++k) {
    LinkContact::Touching &side = contact.sides[k];
    // getOrInitSolverBody stores the index of the solver body in the object.
    auto &object = const_cast<btCollisionObject &>(k ? *manifold.getBody1() : *manifold.getBody0());
    if (const btMultiBodyLinkCollider *collider = btMultiBodyLinkCollider::upcast(&object)) {
      side.articulation = &articulation_of(*collider->m_multiBody);
      side.member = collider->m_link + 1;
      side.center = side.articulation->tree->origins[side.member];
    } else {
      side.id = getOrInitSolverBody(object, h);
      side.center = m_tmpSolverBodyPool[side.id].getWorldTransform().getOrigin();
    }
  }
  int rolling = ROLLING_CONTACTS;
  const btVector3 none(0, 0, 0);
  for (int i = 0; i < manifold.getNumContacts(); ++i) {
    btManifoldPoint &point = manifold.getContactPoint(i);
    if (point.getDistance() > manifold.getContactProcessingThreshold()) continue;
    contact.point = &point;
    contact.normal = m_multiBodyNormalContactConstraints.size();
    RowMotion motion;
    Row &row = add_contact_row(m_multiBodyNormalContactConstraints, contact, point.m_normalWorldOnB, none, motion);
    const btScalar cfm = info.m_globalCfm / h, whole = motion.response + cfm,
                   gap = point.getDistance() + info.m_linearSlop;
    // The velocity after the free motion also holds what forces that press the bodies together give them in h, from
    // which no body rebounds.
    const btScalar bounce =
        std::max(btScalar(0), restitutionCurve(velocity_before(contact, point.m_normalWorldOnB),
                                               point.m_combinedRestitution, info.m_restitutionVelocityThreshold));
    link_bounces_.push_back(bounce);
    row.m_jacDiagABInv = whole > SIMD_EPSILON ? info.m_sor / whole : 0;
    row.m_rhs = (bounce - motion.velocity - (gap > 0 ? gap : gap * info.m_erp2) / h) * row.m_jacDiagABInv;
    row.m_cfm = cfm * row.m_jacDiagABInv;
    row.m_lowerLimit = 0;
    row.m_friction = point.m_combinedFriction;
    row.m_frictionIndex = m_multiBodyFrictionContactConstraints.size();
    if (info.m_solverMode & SOLVER_USE_ARTICULATED_WARMSTARTING)
      apply(row, point.m_appliedImpulse * info.m_articulatedWarmstartingFactor);

    btVector3 &first = point.m_lateralFrictionDir1, &second = point.m_lateralFrictionDir2;
    btPlaneSpace1(point.m_normalWorldOnB, first, second);
    first.normalize();
    second.normalize();
    if (rolling-- > 0) {
      if (point.m_combinedSpinningFriction > 0) {
        add_friction_row(m_multiBodySpinningFrictionContactConstraints, contact, none, point.m_normalWorldOnB,
                         point.m_combinedSpinningFriction, 0, info);
      }
      if (point.m_combinedRollingFriction > 0) {
        for (const btVector3 &axis : {first, second}) {
          add_friction_row(m_multiBodyTorsionalFrictionContactConstraints, contact, none, axis,
                           point.m_combinedRollingFriction, 0, info);
        }
      }
    }
    btMultiBodyConstraintArray &frictions = m_multiBodyFrictionContactConstraints;
    add_friction_row(frictions, contact, first, none, point.m_combinedFriction, point.m_appliedImpulseLateral1, info);
    add_friction_row(frictions, contact, second, none, point.m_combinedFriction, point.m_appliedImpulseLateral2, info);
  }
}

// Velocity at which the bodies separated along a direction at the contact point before the sub-step, m/s.
btScalar ArticulationSolver::velocity_before(const LinkContact &contact, const btVector3 &direction) const {
  btVector3 relative(0, 0, 0);
  for (int k = 0; k < 2; ++k) {
    const LinkContact::Touching &side = contact.sides[k];
    const btVector3 arm =
        (k ? contact.point->getPositionWorldOnB() : contact.point->getPositionWorldOnA()) - side.center;
    btVector3 linear, angular;
    if (side.articulation) {
      const btRigidBody &link = side.articulation->members[side.member].body->body;
      linear = link.getLinearVelocity();
      angular = link.getAngularVelocity();
    } else {
      const btSolverBody &body = m_tmpSolverBodyPool[side.id];
      linear = body.m_linearVelocity;
      angular = body.m_angularVelocity;
    }
    const btVector3 velocity = linear + angular.cross(arm);
    relative += k ? -velocity : velocity;
  }
  return direction.dot(relative);
}

// Appends a row along a linear direction at the contact point, or about an angular one.
ArticulationSolver::Row &ArticulationSolver::add_contact_row(btMultiBodyConstraintArray &rows,
                                                             const LinkContact &contact, const btVector3 &linear,
                                                             const btVector3 &angular, RowMotion &motion) {
  Row &row = rows.expandNonInitializing();
  clear(row);
  row.m_solverBodyIdA = row.m_solverBodyIdB = m_fixedBodyId;
  row.m_originalContactPoint = contact.point;
  for (int k = 0; k < 2; ++k) {
    const LinkContact::Touching &side = contact.sides[k];
    const btVector3 arm =
        (k ? contact.point->getPositionWorldOnB() : contact.point->getPositionWorldOnA()) - side.center;
    const btScalar sign = k ? -1 : 1;
    const btVector3 push = linear * sign, turn = (angular + arm.cross(linear)) * sign;
    const RowMotion part = side.articulation
                               ? act_on_member(row, k, *side.articulation, side.member, push, turn, m_data)
                               : act_on_body(row, k, side.id, push, turn, m_tmpSolverBodyPool);
    motion.velocity += part.velocity;
    motion.response += part.response;
  }
  return row;
}

void ArticulationSolver::add_friction_row(btMultiBodyConstraintArray &rows, const LinkContact &contact,
                                          const btVector3 &linear, const btVector3 &angular, btScalar friction,
                                          btScalar guess, const btContactSolverInfo &info) {
  RowMotion motion;
  Row &row = add_contact_row(rows, contact, linear, angular, motion);
  const btScalar cfm = info.m_frictionCFM / info.m_timeStep, whole = motion.response + cfm;
  row.m_jacDiagABInv = whole > SIMD_EPSILON ? info.m_sor / whole : 0;
  row.m_rhs = -motion.velocity * row.m_jacDiagABInv;
  row.m_cfm = cfm * row.m_jacDiagABInv;
  row.m_friction = friction;
  row.m_lowerLimit = -friction;
  row.m_upperLimit = friction;
  row.m_frictionIndex = contact.normal;
  if (info.m_solverMode & SOLVER_USE_ARTICULATED_WARMSTARTING) apply(row, guess * info.m_articulatedWarmstartingFactor);
}

ArticulationSolver::Sides ArticulationSolver::sides_of(Row &row) {
  Sides result{&row, {}};
  for (int k = 0; k < 2; ++k) {
    Side &side = result.sides[k];
    side.multi_body = k ? row.m_multiBodyB : row.m_multiBodyA;
    if (side.multi_body) {
      side.n = side.multi_body->getNumDofs() + 6;
      side.jacobian = k ? row.m_jacBindex : row.m_jacAindex;
      side.velocity = k ? row.m_deltaVelBindex : row.m_deltaVelAindex;
      continue;
    }
    btSolverBody &body = m_tmpSolverBodyPool[k ? row.m_solverBodyIdB : row.m_solverBodyIdA];
    if (!body.m_originalBody || body.m_originalBody->getInvMass() <= 0) continue;
    side.body = &body;
    side.linear = k ? row.m_contactNormal2 : row.m_contactNormal1;
    side.angular = k ? row.m_relpos2CrossNormal : row.m_relpos1CrossNormal;
    side.by_linear = side.linear * body.internalGetInvMass();
    side.by_angular = k ? row.m_angularComponentB : row.m_angularComponentA;
  }
  return result;
}

void ArticulationSolver::apply(Row &row, btScalar impulse) {
  row.m_appliedImpulse = btScalar(row.m_appliedImpulse) + impulse;
  if (impulse == 0) return;
  for (const Side &side : sides_of(row).sides) {
    if (side.body) side.body->internalApplyImpulse(side.by_linear, side.by_angular, impulse);
    if (!side.multi_body) continue;
    btScalar *response = &m_data.m_deltaVelocitiesUnitImpulse[side.jacobian];
    applyDeltaVee(response, impulse, side.velocity, side.n);
    side.multi_body->applyDeltaVeeMultiDof2(response, impulse);
  }
}

void ArticulationSolver::set_change(btMultiBody &multi_body, int velocity, const double *change) {
  std::copy(change, change + multi_body.getNumDofs() + 6, &m_data.m_deltaVelocities[velocity]);
  multi_body.applyDeltaVeeMultiDof2(change, 1);
}
