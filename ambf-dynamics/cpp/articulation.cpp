#include "position_error.h"
#include "articulation_rows.h"

#include <algorithm>
#include <unordered_map>

namespace {

ArticulationDynamics::JointType joint_type_of(AmbConstraint &c) {
  switch (c.kind) {
    case Kind::Hinge: return ArticulationDynamics::JointType::Revolute;
    case Kind::Slider: return ArticulationDynamics::JointType::Prismatic;
    case Kind::PointToPoint:
    case Kind::ConeTwist: return ArticulationDynamics::JointType::Spherical;
    case Kind::SixDof: {
      const auto &limits = *c.as<btGeneric6DofConstraint>().getTranslationalLimitMotor();
      const bool slides = !(limits.m_lowerLimit.isZero() && limits.m_upperLimit.isZero());
      return slides ? ArticulationDynamics::JointType::Free : ArticulationDynamics::JointType::Spherical;
    }
    case Kind::SixDofSpring:
      if (moves_about_z(c)) return ArticulationDynamics::JointType::Revolute;
      return moves_along_z(c) ? ArticulationDynamics::JointType::Prismatic : ArticulationDynamics::JointType::Fixed;
    default: return ArticulationDynamics::JointType::Fixed;
  }
}

btTransform frame_of(AmbConstraint &c, bool of_b) {
  switch (c.kind) {
    case Kind::PointToPoint: {
      const auto &point = c.as<btPoint2PointConstraint>();
      return btTransform(btMatrix3x3::getIdentity(), of_b ? point.getPivotInB() : point.getPivotInA());
    }
    case Kind::Hinge: return of_b ? c.as<btHingeConstraint>().getBFrame() : c.as<btHingeConstraint>().getAFrame();
    case Kind::ConeTwist:
      return of_b ? c.as<btConeTwistConstraint>().getBFrame() : c.as<btConeTwistConstraint>().getAFrame();
    case Kind::SixDof:
      return of_b ? c.as<btGeneric6DofConstraint>().getFrameOffsetB() : c.as<btGeneric6DofConstraint>().getFrameOffsetA();
    case Kind::Slider:
      return of_b ? c.as<btSliderConstraint>().getFrameOffsetB() : c.as<btSliderConstraint>().getFrameOffsetA();
    case Kind::SixDofSpring: {
      auto &spring = c.as<btGeneric6DofSpring2Constraint>();
      return of_b ? spring.getFrameOffsetB() : spring.getFrameOffsetA();
    }
    default: return of_b ? c.as<btFixedConstraint>().getFrameOffsetB() : c.as<btFixedConstraint>().getFrameOffsetA();
  }
}

btVector3 axis_of(const AmbConstraint &c) { return c.kind == Kind::Slider ? btVector3(1, 0, 0) : btVector3(0, 0, 1); }

// Largest difference between the axes (rad) and pivots (m) of a spring and its joint.
constexpr btScalar AXIS_TOLERANCE = 2e-3;

// Whether a spring acts on the coordinate of a joint between the same bodies.
bool acts_along(AmbConstraint &spring, AmbConstraint &joint) {
  const ArticulationDynamics::JointType type = joint_type_of(spring);
  if (type == ArticulationDynamics::JointType::Fixed || type != joint_type_of(joint)) return false;
  const bool same_order = &first_of(spring) == &first_of(joint);
  for (bool of_b : {false, true}) {
    const btTransform theirs = frame_of(joint, of_b), own = frame_of(spring, same_order ? of_b : !of_b);
    const btVector3 axis = theirs.getBasis() * axis_of(joint);
    if (axis.cross(own.getBasis() * axis_of(spring)).length() > AXIS_TOLERANCE) return false;
    // For a hinge the distance between the axes counts, for a slider only their directions.
    const bool hinge = type == ArticulationDynamics::JointType::Revolute;
    if (hinge && axis.cross(own.getOrigin() - theirs.getOrigin()).length() > AXIS_TOLERANCE) return false;
  }
  return true;
}

bool joins_the_same(const AmbConstraint &a, const AmbConstraint &b) {
  return (&first_of(a) == &first_of(b) && &second_of(a) == &second_of(b)) ||
         (&first_of(a) == &second_of(b) && &second_of(a) == &first_of(b));
}

// Largest turn in a sub-step up to which the kinetic energy may grow at the new position, rad: slow motion exchanges energy
// between sub-steps by truncation errors of either sign, in proportion to the third power of the turn.
constexpr btScalar FAST_TURN = 0.05;

// Rows are solved with the rates after the free motion and the inertia before it. Largest ratio of the energy of both
// together to the energy before and after the motion; beyond it rows act on a motion along the tangent instead.
constexpr btScalar MAX_CONTRAST = 2;
// Largest position error of a joint, m and rad, up to which its child is moved onto the joint. With larger errors the
// joint stays a constraint.
constexpr btScalar MAX_INITIAL_GAP = 0.02, MAX_INITIAL_ANGLE = 0.05;

// Whether the position error of a joint is within these limits.
bool fits(AmbConstraint &joint) {
  const btTransform a = first_of(joint).body.getWorldTransform() * frame_of(joint, false);
  const btTransform b = second_of(joint).body.getWorldTransform() * frame_of(joint, true);
  const btVector3 axis = a.getBasis() * axis_of(joint);
  btVector3 gap = b.getOrigin() - a.getOrigin();
  const ArticulationDynamics::JointType type = joint_type_of(joint);
  if (type == ArticulationDynamics::JointType::Free) return true;
  if (type == ArticulationDynamics::JointType::Spherical) return gap.length() < MAX_INITIAL_GAP;
  if (type == ArticulationDynamics::JointType::Prismatic) gap -= axis * axis.dot(gap);
  btScalar angle;
  if (type == ArticulationDynamics::JointType::Revolute) {
    const btVector3 other = b.getBasis() * axis_of(joint);
    angle = btAtan2(axis.cross(other).length(), axis.dot(other));
  } else {
    const btQuaternion turn = b.getRotation() * a.getRotation().inverse();
    angle = 2 * btAtan2(btVector3(turn.x(), turn.y(), turn.z()).length(), btFabs(turn.w()));
  }
  return gap.length() < MAX_INITIAL_GAP && angle < MAX_INITIAL_ANGLE;
}

// Largest number of coordinates between the base and a link that can collide. The row of a contact has an entry for each:
// longer ropes in contact cost more than as constraints, whose rows have entries for two bodies.
constexpr int MAX_CONTACT_PATH = 100;

// Largest number of coordinates of a tree: btMultiBody has a matrix of all of them, and the row of a limit an entry for
// each.
constexpr int MAX_COORDINATES = 1000;

int coordinates_of(AmbConstraint &joint) {
  const ArticulationDynamics::JointType type = joint_type_of(joint);
  return ArticulationDynamics::sliding_coordinates_of(type) + ArticulationDynamics::turning_coordinates_of(type);
}

// Whether such a tree, and contacts with its links, are affordable.
bool is_affordable(const AmbWorld &world, const AmbBody &base, AmbConstraint *const *joints, int n) {
  int coordinates = 0, couplings = 0;
  for (const AmbCoupling *coupling : engine_of(world).couplings)
    couplings += std::find(joints, joints + n, coupling->terms[0].joint) != joints + n;
  if (couplings > MAX_COUPLED) return false;
  for (int i = 0; i < n; ++i) coordinates += coordinates_of(*joints[i]);
  if (coordinates > MAX_COORDINATES) return false;
  std::unordered_map<const AmbBody *, int> paths{{&base, 0}};
  for (int i = 0; i < n; ++i) {
    const AmbBody &a = first_of(*joints[i]), &b = second_of(*joints[i]);
    const bool from_a = paths.count(&a) > 0;
    const int path = paths[from_a ? &a : &b] + coordinates_of(*joints[i]);
    const AmbBody &child = from_a ? b : a;
    if (path > MAX_CONTACT_PATH && !touches_nothing(*child.shape->shape)) return false;
    paths[&child] = path;
  }
  return true;
}

// The joint of a tree that leads to each of its bodies from the base on.
using JointsByChild = std::unordered_map<const AmbBody *, AmbConstraint *>;

JointsByChild joints_by_child(const AmbBody &base, AmbConstraint *const *joints, int n) {
  JointsByChild found{{&base, nullptr}};
  for (int i = 0; i < n; ++i) {
    const AmbBody &a = first_of(*joints[i]), &b = second_of(*joints[i]);
    found.emplace(found.count(&a) > 0 ? &b : &a, joints[i]);
  }
  return found;
}

AmbConstraint *joint_of(AmbConstraint &spring, const JointsByChild &joints) {
  for (const AmbBody *body : {&first_of(spring), &second_of(spring)}) {
    const auto found = joints.find(body);
    if (found == joints.end() || !found->second) continue;
    if (joins_the_same(spring, *found->second) && acts_along(spring, *found->second)) return found->second;
  }
  return nullptr;
}

// Decay rate, 1/s, for a share of the velocity lost in 1 s; at most 1e4 1/s.
btScalar drag_of(btScalar share) { return share > 0 ? std::fmin(-std::log1p(-std::fmin(share, btScalar(1))), 1e4) : 0; }

ArticulationDynamics::Body body_of(const AmbBody &body) {
  ArticulationDynamics::Body result;
  const btScalar inverse = body.body.getInvMass();
  result.mass = inverse > 0 ? 1 / inverse : 0;
  result.inertia = inverse > 0 ? body.body.getLocalInertia() : btVector3(0, 0, 0);
  result.linear_drag = drag_of(body.body.getLinearDamping());
  result.angular_drag = drag_of(body.body.getAngularDamping());
  return result;
}

bool turns_freely(const AmbBody &body) {
  const btVector3 &inverse = body.body.getInvInertiaDiagLocal();
  return body.body.getInvMass() > 0 && inverse.x() > 0 && inverse.y() > 0 && inverse.z() > 0;
}

bool differ(const btTransform &a, const btTransform &b) {
  return !(a.getOrigin() == b.getOrigin() && a.getBasis() == b.getBasis());
}

btTransform transform_of(const ArticulationDynamics &dynamics, size_t body) {
  return btTransform(dynamics.rotations[body], dynamics.origins[body]);
}

void subtract(ArticulationDynamics::Rate &from, const ArticulationDynamics::Rate &rate) {
  from.angular -= rate.angular;
  from.linear -= rate.linear;
  for (size_t k = 0; k < rate.q.size(); ++k) from.q[k] -= rate.q[k];
}

}  // namespace

LinkCollider::LinkCollider(AmbBody &owner, btMultiBody *multi_body, int link)
    : btMultiBodyLinkCollider(multi_body, link) {
  setUserPointer(static_cast<AmbObject *>(&owner));
  setCollisionShape(owner.shape->shape.get());
  copy_surface(owner);
  setActivationState(DISABLE_DEACTIVATION);
}

void LinkCollider::copy_surface(const AmbBody &owner) {
  setFriction(owner.body.getFriction());
  setRollingFriction(owner.body.getRollingFriction());
  setRestitution(owner.body.getRestitution());
}

AmbArticulation::AmbArticulation(AmbWorld &owner, AmbBody &base, AmbConstraint *const *joints, int n,
                                 AmbConstraint *const *parallel, int n_parallel)
    : world(owner), dynamics(base.body.getInvMass() == 0) {
  const bool fixed = dynamics.fixed_base;
  dynamics.bodies.push_back(body_of(base));
  members.push_back({&base, nullptr, nullptr, nullptr});
  // Bullet has no joints with six motions: a further link of the btMultiBody, without a body, has three of them.
  int links = n;
  for (int i = 0; i < n; ++i) links += joint_type_of(*joints[i]) == ArticulationDynamics::JointType::Free ? 1 : 0;
  multi_body = std::make_unique<btMultiBody>(links, dynamics.bodies[0].mass, dynamics.bodies[0].inertia, fixed, false);
  links = n;
  auto member_of = [this](const AmbBody *body) {
    // A fixed base may be the base of several articulations and has no `articulation`.
    return body == members[0].body ? 0 : body->articulation == this ? body->member : -1;
  };
  if (!fixed) {
    base.articulation = this;
    base.member = 0;
  }
  for (int i = 0; i < n; ++i) {
    AmbConstraint &joint = *joints[i];
    const bool from_a = member_of(&first_of(joint)) >= 0;
    AmbBody &child = from_a ? second_of(joint) : first_of(joint);
    const int parent = member_of(from_a ? &first_of(joint) : &second_of(joint));
    const btTransform in_parent = frame_of(joint, !from_a), in_child = frame_of(joint, from_a);
    const btVector3 axis = axis_of(joint);
    // The coordinate is that of body B relative to body A.
    dynamics.add(body_of(child), parent, joint_type_of(joint), from_a ? axis : -axis, in_parent, in_child);
    child.articulation = this;
    child.member = i + 1;
    joint.articulation = this;
    joint.link = i + 1;
    has_feedback |= joint.feedback != nullptr;
    has_wide_limits |= joint.kind == Kind::ConeTwist || joint.kind == Kind::SixDof;
    members.push_back({&child, &joint, nullptr, nullptr});

    const ArticulationDynamics::Link &link = dynamics.links[i];
    const ArticulationDynamics::Body &body = dynamics.bodies[i + 1];
    btQuaternion rotation;
    link.rotation.transpose().getRotation(rotation);
    const btVector3 local_axis = link.rotation.transpose() * link.axis;
    switch (link.type) {
      case ArticulationDynamics::JointType::Revolute:
        multi_body->setupRevolute(i, body.mass, body.inertia, parent - 1, rotation, local_axis, link.pivot, link.arm);
        break;
      case ArticulationDynamics::JointType::Prismatic:
        multi_body->setupPrismatic(i, body.mass, body.inertia, parent - 1, rotation, local_axis, link.pivot, link.arm,
                                   false);
        break;
      case ArticulationDynamics::JointType::Free:
        multi_body->setupSpherical(links++, 0, btVector3(0, 0, 0), i, rotation, link.pivot, link.arm, false);
        [[fallthrough]];
      case ArticulationDynamics::JointType::Spherical:
        multi_body->setupSpherical(i, body.mass, body.inertia, parent - 1, rotation, link.pivot, link.arm, false);
        break;
      case ArticulationDynamics::JointType::Fixed:
        multi_body->setupFixed(i, body.mass, body.inertia, parent - 1, rotation, link.pivot, link.arm);
        break;
    }
  }
  take_couplings();
  dynamics.finish();
  multi_body->finalizeMultiDof();
  multi_body->setLinearDamping(0);
  multi_body->setAngularDamping(0);
  multi_body->setMaxCoordinateVelocity(BT_LARGE_FLOAT);
  multi_body->setUserPointer(this);
  correction.q.resize(dynamics.coordinates);
  change.q.resize(dynamics.coordinates);
  fed.q.resize(dynamics.coordinates);
  row_rate.q.resize(dynamics.coordinates);
  position.q.resize(dynamics.coordinates);
  position.balls.resize(dynamics.balls, btQuaternion::getIdentity());
  rate.q.resize(dynamics.coordinates);
  free_position = position;
  free_rate = mean_rate = rate;
  mean_velocity.resize(dynamics.velocity_size());
  changed_velocity.resize(dynamics.velocity_size());
  for (size_t i = 1; i < members.size(); ++i) world.articulated->removeConstraint(members[i].joint->constraint.get());
  for (int i = 0; i < n_parallel; ++i) world.articulated->removeConstraint(parallel[i]->constraint.get());
  for (size_t i = fixed ? 1 : 0; i < members.size(); ++i) {
    Member &member = members[i];
    AmbBody &body = *member.body;
    drop_drive(world, body);
    world.world->removeRigidBody(&body.body);
    const int link = static_cast<int>(i) - 1;
    member.collider = std::make_unique<LinkCollider>(body, multi_body.get(), link);
    if (link < 0) {
      multi_body->setBaseCollider(member.collider.get());
    } else {
      multi_body->getLink(link).m_collider = member.collider.get();
    }
    body.collider = member.collider.get();
    body.collider->setWorldTransform(body.body.getWorldTransform());
    world.world->addCollisionObject(body.collider, btBroadphaseProxy::DefaultFilter, btBroadphaseProxy::AllFilter);
  }
  poses_set = velocities_set = true;
  apply_set_state();
  for (size_t i = 1; i < members.size(); ++i) {
    AmbConstraint &joint = *members[i].joint;
    if (joint.kind == Kind::SixDofSpring && dynamics.links[i - 1].coordinate >= 0) add_spring(joint, i - 1, true);
    if (joint.motor.damping > 0) add_damper(joint, i - 1);
  }
  const JointsByChild by_child = n_parallel > 0 ? joints_by_child(base, joints, n) : JointsByChild();
  for (int i = 0; i < n_parallel; ++i) {
    AmbConstraint &spring = *parallel[i];
    has_feedback |= spring.feedback != nullptr;
    add_spring(spring, joint_of(spring, by_child)->link - 1, false);
  }
  joint_rows = std::make_unique<JointRows>(*this);
  world.articulated->addMultiBody(multi_body.get());
  world.articulated->addMultiBodyConstraint(joint_rows.get());
  world.articulated->articulations.push_back(this);
}

void AmbArticulation::body_changed(const AmbBody &body) {
  const size_t member = body.member;
  ArticulationDynamics::Body &present = dynamics.bodies[member];
  ArticulationDynamics::Body changed = body_of(body);
  changed.force = present.force;
  changed.torque = present.torque;
  present = changed;
  if (member == 0) {
    multi_body->setBaseMass(changed.mass);
    multi_body->setBaseInertia(changed.inertia);
  } else {
    btMultibodyLink &link = multi_body->getLink(static_cast<int>(member) - 1);
    link.m_mass = changed.mass;
    link.m_inertiaLocal = changed.inertia;
  }
  if (members[member].collider) members[member].collider->copy_surface(body);
}

bool AmbArticulation::damping_changed(const AmbConstraint &joint) {
  for (size_t i = 0; i < springs.size(); ++i) {
    if (springs[i].constraint != &joint) continue;
    dynamics.springs[i].damping = joint.motor.damping;
    return true;
  }
  return joint.motor.damping <= 0;
}

void AmbArticulation::add_spring(AmbConstraint &constraint, size_t link, bool is_joint) {
  const ArticulationDynamics::Link &joint = dynamics.links[link];
  const bool is_angle = joint.type == ArticulationDynamics::JointType::Revolute;
  auto &six_dof = constraint.as<btGeneric6DofSpring2Constraint>();
  const auto &turn = *six_dof.getRotationalLimitMotor(2);
  const auto &way = *six_dof.getTranslationalLimitMotor();
  // Angular quantities have the sign of a hinge here, which is opposite to that of Bullet's six-dof spring.
  const bool enabled = is_angle ? turn.m_enableSpring : way.m_enableSpring[2];
  ArticulationDynamics::Spring spring;
  spring.coordinate = joint.coordinate;
  spring.is_angle = is_angle;
  spring.stiffness = !enabled ? 0 : is_angle ? turn.m_springStiffness : way.m_springStiffness.z();
  spring.damping = !enabled ? 0 : is_angle ? turn.m_springDamping : way.m_springDamping.z();
  spring.rest = is_angle ? -turn.m_equilibriumPoint : way.m_equilibriumPoint.z();
  btScalar low = is_angle ? -turn.m_hiLimit : way.m_lowerLimit.z();
  btScalar high = is_angle ? -turn.m_loLimit : way.m_upperLimit.z();
  spring.sign = 1;
  spring.offset = 0;
  if (!is_joint) {
    AmbConstraint &own = *members[link + 1].joint;
    const bool same_order = &first_of(constraint) == &first_of(own);
    const btVector3 axis = frame_of(own, false).getBasis() * axis_of(own);
    const btVector3 other = frame_of(constraint, !same_order).getBasis() * axis_of(constraint);
    spring.sign = (axis.dot(other) > 0) == same_order ? 1 : -1;
    spring.offset = spring_coordinate(constraint) - spring.sign * position.q[joint.coordinate];
    if (low <= high) {
      low = (low - spring.offset) * spring.sign;
      high = (high - spring.offset) * spring.sign;
      if (low > high) std::swap(low, high);
      // Limits equal to those of the joint need no row of their own.
      const btScalar tolerance = 1e-6;
      if (btFabs(low - own.motor.low) < tolerance && btFabs(high - own.motor.high) < tolerance) low = high + 1;
    }
  }
  dynamics.springs.push_back(spring);
  springs.push_back({&constraint, link, low, high});
}

// Makes the couplings between its joints parts of the equations of motion.
void AmbArticulation::take_couplings() {
  for (AmbCoupling *coupling : engine_of(world).couplings) {
    if (coupling->articulation() != this) continue;
    coupling->follow_articulation(world);
    couplings.push_back(coupling);
    Vector<ArticulationDynamics::CoupledCoordinate> terms;
    for (const AmbCoupling::Term &term : coupling->terms)
      terms.push_back({dynamics.links[term.joint->link - 1].coordinate, term.factor});
    dynamics.couple(terms);
  }
}

// Keeps the coordinates of coupled joints with all their turns.
void AmbArticulation::remember_coordinates() {
  for (size_t i = 0; i < couplings.size(); ++i) {
    for (size_t k = 0; k < couplings[i]->terms.size(); ++k)
      couplings[i]->terms[k].last = position.q[dynamics.coupling(i)[k].coordinate];
  }
}

// Gives followers the coordinates that their leaders ask for; angles of joints are known up to whole turns before. At the
// start those of the leaders have none.
void AmbArticulation::close_couplings() {
  for (size_t i = 0; i < couplings.size(); ++i) {
    AmbCoupling &coupling = *couplings[i];
    const ArticulationDynamics::CoupledCoordinate *const terms = dynamics.coupling(i);
    const auto coordinate = [&](size_t k) -> btScalar & { return position.q[terms[k].coordinate]; };
    coupling.complete(coordinate, joint_rows != nullptr);
    coordinate(0) = coupling.wanted(coordinate);
  }
}

// The damping of a hinge or slider: a spring without stiffness.
void AmbArticulation::add_damper(AmbConstraint &joint, size_t link) {
  ArticulationDynamics::Spring damper;
  damper.coordinate = dynamics.links[link].coordinate;
  damper.is_angle = joint.kind == Kind::Hinge;
  damper.damping = joint.motor.damping;
  damper.stiffness = damper.rest = damper.offset = 0;
  damper.sign = 1;
  dynamics.springs.push_back(damper);
  springs.push_back({&joint, link, 1, -1});
}

// Classifies springs for a sub-step of h s, from the poses at its beginning: soft ones are integrated with the motion, stiff ones become implicit rows,
// which cannot overshoot. Those in between are rows of the position problem, too.
void AmbArticulation::choose_springs(btScalar h) {
  if (springs.empty()) return;
  if (!dynamics.state.has_subspaces) dynamics.update_velocities(rate);
  dynamics.factor_inertia();
  for (ArticulationDynamics::Spring &spring : dynamics.springs) {
    const btScalar response = dynamics.response(spring.coordinate) * h;
    spring.is_stiff = spring.stiffness * h * response > 0.04 || spring.damping * response > 0.1;
    spring.settles_in_a_step = spring.is_stiff && spring.stiffness * h * response > 1;
    spring.resists_corrections = spring.stiffness * h * response * SOFT_SPRING > 1;
  }
}

AmbArticulation::~AmbArticulation() {
  apply_set_state();
  auto &articulations = world.articulated->articulations;
  for (size_t i = 0; i < articulations.size(); ++i) {
    if (articulations[i] == this) articulations.erase(articulations.begin() + i--);
  }
  std::vector<AmbConstraint *> external;
  for (AmbConstraint *constraint : world.articulated->external_constraints) {
    if (first_of(*constraint).articulation == this || second_of(*constraint).articulation == this)
      external.push_back(constraint);
  }
  for (AmbConstraint *constraint : external) amb_world_remove_constraint(&world, constraint);
  world.articulated->removeMultiBodyConstraint(joint_rows.get());
  world.articulated->removeMultiBody(multi_body.get());
  for (Member &member : members) {
    if (member.drive) world.articulated->removeMultiBodyConstraint(member.drive.get());
    if (!member.collider) continue;
    AmbBody &body = *member.body;
    world.world->removeCollisionObject(member.collider.get());
    body.collider = &body.body;
    body.articulation = nullptr;
    const btVector3 gravity = body.body.getGravity();
    world.world->addRigidBody(&body.body);
    body.motion.setWorldTransform(body.body.getWorldTransform());
    body.body.setGravity(gravity);
    body.body.setInterpolationWorldTransform(body.body.getWorldTransform());
    body.body.setInterpolationLinearVelocity(body.body.getLinearVelocity());
    body.body.setInterpolationAngularVelocity(body.body.getAngularVelocity());
    body.body.updateInertiaTensor();
  }
  for (size_t i = 1; i < members.size(); ++i) {
    AmbConstraint &joint = *members[i].joint;
    joint.articulation = nullptr;
    world.world->addConstraint(joint.constraint.get());
  }
  remember_coordinates();
  for (AmbCoupling *coupling : couplings) coupling->follow_articulation(world);
  for (const Spring &spring : springs) {
    if (spring.constraint == members[spring.link + 1].joint) continue;
    world.world->addConstraint(spring.constraint->constraint.get());
  }
  for (AmbConstraint *constraint : external)
    amb_world_add_constraint(&world, constraint, constraint->disables_collision);
}

// Takes over the pose of a fixed base that was set.
void AmbArticulation::follow_base() {
  const btTransform &pose = members[0].body->body.getWorldTransform();
  if (!differ(pose, base_pose)) return;
  base_pose = pose;
  position.origin = pose.getOrigin();
  position.rotation = pose.getRotation();
  dynamics.update_poses(position);
  dynamics.update_velocities(rate);
  write_proxies();
}

// Takes over the velocity of a fixed base that is moved. It changes from one sub-step to the next by an impulse, which the
// joints pass on.
void AmbArticulation::take_base_velocity() {
  const btRigidBody &base = members[0].body->body;
  if (rate.linear == base.getLinearVelocity() && rate.angular == base.getAngularVelocity()) return;
  rate.linear = base.getLinearVelocity();
  rate.angular = base.getAngularVelocity();
  per_link[0] = dynamics.linear;
  per_link[1] = dynamics.angular;
  dynamics.project(per_link[0].data(), per_link[1].data(), rate);
  dynamics.update_velocities(rate);
}

void AmbArticulation::apply_set_state() {
  if (!poses_set && !velocities_set) return;
  if (poses_set) {
    dynamics.reset_estimates();
    if (joint_rows) {
      joint_rows->reset();
      remember_coordinates();
    }
    base_pose = members[0].body->body.getWorldTransform();
    position.origin = base_pose.getOrigin();
    position.rotation = base_pose.getRotation();
    for (size_t i = 0; i < dynamics.links.size(); ++i) {
      const ArticulationDynamics::Link &link = dynamics.links[i];
      if (link.type == ArticulationDynamics::JointType::Fixed) continue;
      const btTransform &parent = members[link.parent].body->body.getWorldTransform();
      const btTransform &child = members[i + 1].body->body.getWorldTransform();
      const btTransform relative = parent.inverseTimes(child);
      if (link.ball >= 0) {
        position.balls[link.ball] = relative.getRotation();
        const btVector3 way = relative.getOrigin() - relative.getBasis() * link.arm - link.pivot;
        for (int k = 0; k < link.sliding; ++k) position.q[link.coordinate + k] = way[k];
        continue;
      }
      btScalar &q = position.q[link.coordinate];
      if (link.type == ArticulationDynamics::JointType::Revolute) {
        // The angle q whose rotation about the axis is nearest to R = turn(axis, q) * rest.
        const btMatrix3x3 turn = relative.getBasis().timesTranspose(link.rotation);
        const btVector3 twist(turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1]);
        const btScalar trace = turn[0][0] + turn[1][1] + turn[2][2];
        q = btAtan2(link.axis.dot(twist), trace - link.axis.dot(turn * link.axis));
      } else {
        q = link.axis.dot(relative.getOrigin() - relative.getBasis() * link.arm - link.pivot);
      }
    }
    close_couplings();
  }
  dynamics.update_poses(position);
  if (dynamics.fixed_base) {
    rate.linear = members[0].body->body.getLinearVelocity();
    rate.angular = members[0].body->body.getAngularVelocity();
  }
  if (velocities_set) {
    per_link[0].clear();
    per_link[1].clear();
    for (const Member &member : members) {
      per_link[0].push_back(member.body->body.getLinearVelocity());
      per_link[1].push_back(member.body->body.getAngularVelocity());
    }
    dynamics.project(per_link[0].data(), per_link[1].data(), rate);
  }
  dynamics.update_velocities(rate);
  poses_set = velocities_set = false;
  write_proxies();
}

void AmbArticulation::write_proxies() {
  for (size_t i = dynamics.fixed_base ? 1 : 0; i < members.size(); ++i) {
    AmbBody &body = *members[i].body;
    const btTransform pose = transform_of(dynamics, i);
    body.body.setWorldTransform(pose);
    body.body.setLinearVelocity(dynamics.linear[i]);
    body.body.setAngularVelocity(dynamics.angular[i]);
    body.motion.setWorldTransform(pose);
    members[i].collider->setWorldTransform(pose);
    members[i].collider->setInterpolationWorldTransform(pose);
  }
}

void AmbArticulation::integrate_free_motion(btScalar h) {
  if (dynamics.fixed_base) follow_base();
  dynamics.state.by_euler = engine_of(world).trees_by_euler;
  if (engine_of(world).ledger.enabled) begin_account();
  for (size_t i = dynamics.fixed_base ? 1 : 0; i < members.size(); ++i) {
    ArticulationDynamics::Body &body = dynamics.bodies[i];
    const btRigidBody &proxy = members[i].body->body;
    body.force = proxy.getTotalForce() + proxy.getGravity() * body.mass;
    body.torque = proxy.getTotalTorque();
  }
  if (has_feedback && engine_of(world).has_reactions) remember_momenta();
  if (dynamics.fixed_base) take_base_velocity();
  choose_springs(h);
  // Motors and limits of coupled joints may contradict each other, which rows resolve.
  const bool is_alone =
      !has_contact && external_constraint_count == 0 && !has_wide_limits && !is_driven() && couplings.empty();
  if (is_alone) {
    joint_rows->plan_drives(h);
    dynamics.step(h, position, rate, free_position, free_rate);
    joint_rows->take_drives();
    has_rows = false;
    return_to_limits(h);
    return;
  }
  joint_rows->plan_motors(h);
  dynamics.step(h, position, rate, free_position, free_rate);
  free_energy = dynamics.kinetic_energy();
  free_internal_energy = dynamics.internal_energy();
  joint_rows->plan_limits(h);
  has_rows = joint_rows->any() || has_contact || external_constraint_count > 0 || is_driven();
}

// Plans the return of coordinates to limits that the free motion passes as a correction of positions, which does not move
// the mass centre of a free base.
void AmbArticulation::return_to_limits(btScalar h) {
  if (!dynamics.way_to_limits(h, position, free_position, correction.q)) return;
  is_corrected = true;
  for (btScalar &q : correction.q) q /= h;
  correction.angular.setZero();
  correction.linear.setZero();
  if (dynamics.fixed_base) return;
  dynamics.update_poses(free_position);
  dynamics.update_velocities(correction);
  dynamics.set_momentum({}, dynamics.mass_centre(), correction);
}

void AmbArticulation::prepare_rows(btScalar h) {
  const btVector3 momentum = dynamics.linear_momentum();
  dynamics.update_poses(position);
  dynamics.update_velocities(free_rate);
  row_velocity = free_rate.linear;
  if (!dynamics.fixed_base) {
    // The same rates give the mass centre another velocity where a light base turns fast relative to heavy links.
    ArticulationDynamics::Rate start = free_rate;
    start.linear += (momentum - dynamics.linear_momentum()) / dynamics.mass();
    row_velocity = start.linear;
    dynamics.update_velocities(start);
  }
  unsolved_energy = dynamics.internal_energy();
  is_tangential = unsolved_energy > MAX_CONTRAST * std::max(dynamics.state.start_energy, free_internal_energy);
  if (is_tangential) {
    free_internal_energy = dynamics.tangential_step(h, position, rate, free_position, free_rate);
    dynamics.update_poses(position);
    dynamics.update_velocities(free_rate);
    unsolved_energy = dynamics.internal_energy();
    row_velocity = free_rate.linear;
    free_energy = dynamics.kinetic_energy();
  }
  dynamics.factor_inertia();
  row_rate = free_rate;
  row_rate.linear = row_velocity;
  is_fed = joint_rows->rates_by_limits(fed);
  if (is_fed) {
    subtract(row_rate, fed);
    dynamics.update_velocities(row_rate);
  }
  // The velocity of the btMultiBody is the sum of the changes by all rows.
  multi_body->clearVelocities();
}

bool AmbArticulation::had_impulses() const {
  auto any = [](const btVector3 &v) { return !v.isZero(); };
  for (int i = 0; i < multi_body->getNumLinks(); ++i) {
    const btMultibodyLink &link = multi_body->getLink(i);
    if (any(link.m_appliedConstraintForce) || any(link.m_appliedConstraintTorque)) return true;
  }
  return joint_rows->hit_limit();
}

void AmbArticulation::integrate(btScalar h) {
  // The change of the rates by rows was solved at the old position; at the new position the same rates have another
  // momentum. The momentum of an articulation with a free base changes by forces and impulses only: it is computed at
  // the old position and restored at the new one.
  const bool keeps_momentum = has_rows && !dynamics.fixed_base;
  RowMotion motion;
  if (has_rows) {
    motion = move_by_rows(h);
  } else {
    std::swap(position, free_position);
    std::swap(rate, free_rate);
  }
  const bool is_accounted = engine_of(world).ledger.enabled;
  if (is_corrected && is_accounted) book_correction(h);
  if (is_corrected) dynamics.advance_position(position, h, correction);
  // The free motion ends with the poses and velocities of its bodies.
  bool is_elsewhere = has_rows || is_corrected || !couplings.empty();
  is_corrected = false;
  for (size_t i = 0; i < couplings.size(); ++i) {
    const ArticulationDynamics::CoupledCoordinate *const terms = dynamics.coupling(i);
    const auto coordinate = [&](size_t k) -> btScalar & { return position.q[terms[k].coordinate]; };
    coordinate(0) = couplings[i]->wanted(coordinate);
  }
  if (dynamics.fixed_base) {
    // It has been moved.
    const btRigidBody &base = members[0].body->body;
    is_elsewhere = is_elsewhere || dynamics.is_carried() || differ(base.getWorldTransform(), base_pose);
    base_pose = base.getWorldTransform();
    position.origin = base_pose.getOrigin();
    position.rotation = base_pose.getRotation();
    rate.linear = base.getLinearVelocity();
    rate.angular = base.getAngularVelocity();
  }
  if (is_elsewhere) {
    dynamics.update_poses(position);
    dynamics.update_velocities(rate);
  }
  if (keeps_momentum) dynamics.set_momentum(motion.momentum, dynamics.mass_centre(), rate);
  limit_energy(motion.energy_limit, motion.momentum);
  // Rows are linear in the motion, and turns of radians in a sub-step are not. Without rows the equations of motion resolve
  // them by parts of the sub-step, and only what no torque causes is too fast.
  dynamics.bound_rotation(rate, has_rows ? SIMD_HALF_PI / h : dynamics.state.start_rotation + SIMD_HALF_PI / h);
  if (is_accounted) end_account(h, motion.is_straight);
  if (has_feedback && engine_of(world).has_reactions) write_feedback(h);
  write_proxies();
}

// Adds the impulses of the rows to the rates, and moves the position by them.
AmbArticulation::RowMotion AmbArticulation::move_by_rows(btScalar h) {
  RowMotion motion;
  if (is_tangential) std::swap(rate, mean_rate);
  dynamics.rates_of(multi_body->getVelocityVector(), change);
  if (is_fed) subtract(change, fed);
  rate.angular = free_rate.angular + change.angular;
  rate.linear = row_velocity + change.linear;
  for (int i = 0; i < dynamics.coordinates; ++i) rate.q[i] = free_rate.q[i] + change.q[i];
  dynamics.update_poses(position);
  dynamics.update_velocities(rate);
  motion.is_straight = has_contact || external_constraint_count > 0 || had_impulses();
  const btScalar turn = dynamics.fastest_rotation(rate) * h;
  motion.energy_limit = energy_limit_of_rows(dynamics.internal_energy(), turn, motion.is_straight);
  if (is_tangential) {
    const btScalar internal = dynamics.internal_energy(), explained = internal - unexplained_energy(h);
    motion.energy_limit = std::min(motion.energy_limit, std::max(explained, btScalar(0)));
  }
  // Share of the sub-step for which the rows move the position.
  const btScalar followed = !motion.is_straight ? btScalar(0.5) : turn > SIMD_HALF_PI ? FAST_TURN / turn : 1;
  if (dynamics.fixed_base) {
    advance_by_rows(h, followed, motion.is_straight);
    return motion;
  }
  // The momentum is taken about the mass centre, which is not at the same place in both positions.
  const btVector3 old_centre = dynamics.mass_centre();
  const btScalar mass = dynamics.mass();
  dynamics.update_velocities(change);
  const ArticulationDynamics::Momentum by_rows = dynamics.momentum(old_centre);
  dynamics.update_poses(is_tangential ? position : free_position);
  dynamics.update_velocities(free_rate);
  motion.momentum = dynamics.momentum(dynamics.mass_centre());
  motion.momentum.linear += by_rows.linear;
  motion.momentum.angular += by_rows.angular;
  // Mass centre at the new position, which momenta imply, too.
  const bool has_centre = followed == 1 || !is_tangential;
  const btVector3 centre = followed == 1 ? old_centre + motion.momentum.linear * (h / mass)
                                         : dynamics.mass_centre() + by_rows.linear * (h * followed / mass);
  advance_by_rows(h, followed, motion.is_straight);
  if (has_centre) {
    dynamics.update_poses(position);
    position.origin += centre - dynamics.mass_centre();
  }
  return motion;
}

// Kinetic energy, J, that the sub-step adds at the old position beyond that at its beginning and the work of forces and
// impulses, which is that at the mean of the velocities at its beginning, which `mean_rate` has before, and of the present
// ones. Forces that bound the accelerations of the free motion do no work here: where links turn by radians they would
// otherwise add energy.
btScalar AmbArticulation::unexplained_energy(btScalar h) {
  const auto energy = [this] { return dynamics.fixed_base ? dynamics.internal_energy() : dynamics.kinetic_energy(); };
  const btScalar present = energy();
  dynamics.update_velocities(mean_rate);
  const btScalar before = energy();
  mean_rate.angular = (mean_rate.angular + rate.angular) / 2;
  mean_rate.linear = (mean_rate.linear + rate.linear) / 2;
  for (int k = 0; k < dynamics.coordinates; ++k) mean_rate.q[k] = (mean_rate.q[k] + rate.q[k]) / 2;
  dynamics.update_velocities(mean_rate);
  dynamics.coordinates_of(mean_rate, mean_velocity.data());
  dynamics.coordinates_of(change, changed_velocity.data());
  btScalar work = dynamics.work_at_rate(h, position, mean_rate);
  for (size_t k = 0; k < mean_velocity.size(); ++k) work += mean_velocity[k] * changed_velocity[k];
  dynamics.update_velocities(rate);
  // Coriolis forces exchange a part of the energy at the beginning with what the change of the position does.
  return present - 2 * before - work;
}

// Largest internal energy at the new position, J. solved: with the rates that rows leave, at the old position, with whose
// inertia they were solved; there rows add no energy but the work of motors.
btScalar AmbArticulation::energy_limit_of_rows(btScalar solved, btScalar turn, bool is_straight) const {
  const btScalar unsolved = unsolved_energy, there = free_internal_energy;
  // If rows removed a share of the energy at the old position, the same share is removed at the new one, where
  // inertias may be very different; if they added energy, the same amount is added, or the same share if that is
  // less.
  btScalar limit = solved < unsolved || unsolved > there ? there * (solved / unsolved) : there + (solved - unsolved);
  // Also where it is not a number.
  if (!(turn <= FAST_TURN)) return limit;
  limit *= 1 + turn * turn * turn;
  // The work of forces that are constant over the sub-step differs by its second order from that at the old position.
  return is_straight ? limit : limit + btFabs(solved - unsolved);
}

// Moves the position by the free motion and, for the share `followed` of the sub-step, by the change of the rates.
void AmbArticulation::advance_by_rows(btScalar h, btScalar followed, bool is_straight) {
  // Impulses of contacts, limits and external constraints act from the beginning of the sub-step, so that no link
  // penetrates further.
  if (is_straight && followed == 1) return dynamics.advance_position(position, h, rate);
  const auto follow_rate = [&](int k) {
    free_position.q[k] = position.q[k] + h * (rate.q[k] - change.q[k] * followed);
  };
  // Rows that turn links of next to no inertia are not linear, and poses follow them as far as they are. The force of a
  // stiff spring is a row, without which the free motion strains it.
  // Forces of motors are constant over the sub-step: their mean change of the rates is half of `change`. The implicit
  // force of a spring that is at rest at the end of the sub-step acts on the rate there.
  for (const ArticulationDynamics::Spring &spring : dynamics.springs) {
    if (is_straight ? spring.is_stiff : spring.settles_in_a_step) follow_rate(spring.coordinate);
  }
  // Without the force of its limit a link slides out of what turns by radians, as far as it turns.
  for (size_t i = 1; is_straight && i < members.size(); ++i) {
    const ArticulationDynamics::Link &link = dynamics.links[i - 1];
    if (link.sliding == 0 || !joint_rows->hit_sliding_limit(i)) continue;
    for (int k = link.coordinate; k < link.coordinate + link.sliding; ++k) {
      const btScalar way = free_position.q[k] + h * followed * change.q[k] - position.q[k];
      if (btFabs(way) > btFabs(h * rate.q[k])) follow_rate(k);
    }
  }
  position = free_position;
  dynamics.advance_position(position, h * followed, change);
}

// Limits the internal energy at the new position by scaling the rates of the coordinates and, if restoring the momentum
// of a free base raises the energy again, all motion relative to the centre of mass.
void AmbArticulation::limit_energy(btScalar most, const ArticulationDynamics::Momentum &momentum) {
  if (most >= BT_LARGE_FLOAT) return;
  btScalar energy = dynamics.internal_energy();
  if (!(energy > most)) return;
  const btScalar share = btSqrt(most / energy);
  for (btScalar &q : rate.q) q *= share;
  dynamics.update_velocities(rate);
  if (dynamics.fixed_base) return;
  dynamics.set_momentum(momentum, dynamics.mass_centre(), rate);
  energy = dynamics.internal_energy();
  if (!(energy > most)) return;
  dynamics.scale_internal_velocity(btSqrt(std::max(most, btScalar(0)) / energy), rate);
  dynamics.update_velocities(rate);
}

double free_energy(const btMultiBody &multi_body) {
  return static_cast<const AmbArticulation *>(multi_body.getUserPointer())->free_energy;
}

AmbBody &first_link_of(const btMultiBody &multi_body) {
  return *static_cast<const AmbArticulation *>(multi_body.getUserPointer())->members[1].body;
}

btScalar set_correction(btMultiBody &multi_body, const double *velocities, btScalar most_turned) {
  AmbArticulation &articulation = *static_cast<AmbArticulation *>(multi_body.getUserPointer());
  articulation.dynamics.rates_of(velocities, articulation.correction);
  articulation.is_corrected = true;
  btScalar fastest = articulation.correction.angular.length() / most_turned;
  fastest = std::max(fastest, articulation.correction.linear.length() / MAX_CORRECTION_SPEED);
  for (const ArticulationDynamics::Link &link : articulation.dynamics.links) {
    for (int k = 0; k < link.freedoms(); ++k) {
      const btScalar most = k < link.sliding ? MAX_CORRECTION_SPEED : most_turned;
      fastest = std::max(fastest, btFabs(articulation.correction.q[link.coordinate + k]) / most);
    }
  }
  return fastest;
}

void scale_correction(btMultiBody &multi_body, btScalar factor) {
  AmbArticulation &articulation = *static_cast<AmbArticulation *>(multi_body.getUserPointer());
  articulation.correction.angular *= factor;
  articulation.correction.linear *= factor;
  for (btScalar &q : articulation.correction.q) q *= factor;
}

void AmbArticulation::remember_momenta() {
  const size_t n = members.size();
  momenta.resize(n);
  angular_momenta.resize(n);
  velocities = dynamics.linear;
  angular_velocities = dynamics.angular;
  for (size_t i = 0; i < n; ++i) {
    momenta[i] = dynamics.linear[i] * dynamics.bodies[i].mass;
    angular_momenta[i] = dynamics.angular_momentum(i);
  }
}

// Joint reaction wrenches over the sub-step: for each subtree, the change of momentum minus the impulses of all
// external forces, divided by h; summed from the leaves to the base.
void AmbArticulation::write_feedback(btScalar h) {
  const size_t n = members.size();
  const btVector3 zero(0, 0, 0);
  auto &[forces, torques] = per_link;
  forces.assign(n, zero);
  torques.assign(n, zero);
  for (size_t i = n; i-- > 0;) {
    const ArticulationDynamics::Body &body = dynamics.bodies[i];
    const btVector3 velocity = (velocities[i] + dynamics.linear[i]) / 2;
    const btVector3 momentum = (angular_momenta[i] + dynamics.angular_momentum(i)) / 2;
    btVector3 outside = body.force - velocity * (body.mass * body.linear_drag);
    btVector3 twist = body.torque - momentum * body.angular_drag;
    if (has_rows && i > 0) {
      outside += multi_body->getLink(i - 1).m_appliedConstraintForce;
      twist += multi_body->getLink(i - 1).m_appliedConstraintTorque;
    }
    forces[i] += (dynamics.linear[i] * body.mass - momenta[i]) / h - outside;
    torques[i] += (dynamics.angular_momentum(i) - angular_momenta[i]) / h - twist;
    if (i == 0) continue;
    const int parent = dynamics.links[i - 1].parent;
    const btVector3 arm = dynamics.origins[i] - dynamics.origins[parent];
    forces[parent] += forces[i];
    torques[parent] += torques[i] + arm.cross(forces[i]);
    btVector3 force = forces[i], torque = torques[i];
    for (size_t s = 0; s < springs.size(); ++s) {
      AmbConstraint &constraint = *springs[s].constraint;
      if (springs[s].link + 1 != i || &constraint == members[i].joint) continue;
      const ArticulationDynamics::Link &link = dynamics.links[i - 1];
      const btVector3 axis = dynamics.rotations[parent] * link.axis * spring_effort(s, h);
      const bool is_angle = link.type == ArticulationDynamics::JointType::Revolute;
      const btVector3 push = is_angle ? zero : axis;
      // Torque about the child's centre of mass of a force at the child's end of the joint.
      const btVector3 twist = is_angle ? axis : axis.cross(dynamics.rotations[i] * link.arm);
      write_wrench(constraint, i, push, twist, arm);
      force -= push;
      torque -= twist;
    }
    write_wrench(*members[i].joint, i, force, torque, arm);
  }
}

// Writes the joint reaction wrench on link i about its centre of mass, and the opposite wrench on its parent. `arm`
// leads from the parent's centre of mass to that of the link, m.
void AmbArticulation::write_wrench(const AmbConstraint &constraint, size_t i, const btVector3 &force,
                                   const btVector3 &torque, const btVector3 &arm) {
  if (!constraint.feedback) return;
  const bool child_is_b = &second_of(constraint) == members[i].body;
  btJointFeedback &feedback = *constraint.feedback;
  (child_is_b ? feedback.m_appliedForceBodyB : feedback.m_appliedForceBodyA) = force;
  (child_is_b ? feedback.m_appliedTorqueBodyB : feedback.m_appliedTorqueBodyA) = torque;
  (child_is_b ? feedback.m_appliedForceBodyA : feedback.m_appliedForceBodyB) = -force;
  (child_is_b ? feedback.m_appliedTorqueBodyA : feedback.m_appliedTorqueBodyB) = -(torque + arm.cross(force));
}

btScalar AmbArticulation::spring_effort(size_t index, btScalar h) const {
  const ArticulationDynamics::Spring &spring = dynamics.springs[index];
  if (spring.is_stiff) return joint_rows->spring_impulse(index) / h;
  const int i = spring.coordinate;
  return -spring.sign * spring.stiffness * spring.displacement(position.q[i]) - spring.damping * rate.q[i];
}

void AmbArticulation::clear_forces() {
  for (Member &member : members) {
    if (member.collider) member.body->body.clearForces();
  }
}

bool AmbArticulation::is_driven() const {
  for (const Member &member : members) {
    if (member.drive && member.drive->enabled) return true;
  }
  return false;
}

LinkDrive &AmbArticulation::drive_of(AmbBody &link) {
  auto &drive = members[link.member].drive;
  if (!drive) {
    drive = make_in_arena<LinkDrive>(link);
    world.articulated->addMultiBodyConstraint(drive.get());
  }
  return *drive;
}

btScalar AmbArticulation::coordinate(const AmbConstraint &joint, btScalar *speed) {
  apply_set_state();
  const int coordinate = dynamics.links[joint.link - 1].coordinate;
  if (speed) *speed = coordinate < 0 ? 0 : rate.q[coordinate];
  return coordinate < 0 ? 0 : position.q[coordinate];
}

extern "C" {

AmbArticulation *amb_world_articulate(AmbWorld *world, AmbBody *base, AmbConstraint *const *joints, int n,
                                      AmbConstraint *const *springs, int n_springs) {
  if (!world->articulated || !is_affordable(*world, *base, joints, n)) return nullptr;
  for (int i = 0; i < n; ++i) {
    if (!fits(*joints[i])) return nullptr;
    for (const AmbBody *body : {&first_of(*joints[i]), &second_of(*joints[i])}) {
      if (body->articulation || (!turns_freely(*body) && (body != base || body->body.getInvMass() > 0))) return nullptr;
    }
  }
  const JointsByChild by_child = n_springs > 0 ? joints_by_child(*base, joints, n) : JointsByChild();
  for (int i = 0; i < n_springs; ++i) {
    if (!joint_of(*springs[i], by_child)) return nullptr;
  }
  return new AmbArticulation(*world, *base, joints, n, springs, n_springs);
}

void amb_world_dissolve(AmbWorld *, AmbArticulation *articulation) { delete articulation; }

}  // extern "C"
