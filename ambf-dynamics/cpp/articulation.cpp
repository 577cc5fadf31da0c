#include "position_error.h"
#include "articulation_rows.h"

#include <algorithm>
#include <unordered_map>

namespace {

Tree::JointType joint_type_of(AmbConstraint &c) {
  switch (c.kind) {
    case Kind::Hinge: return Tree::JointType::Revolute;
    case Kind::Slider: return Tree::JointType::Prismatic;
    case Kind::PointToPoint:
    case Kind::ConeTwist: return Tree::JointType::Spherical;
    case Kind::SixDof: {
      const auto &limits = *c.as<btGeneric6DofConstraint>().getTranslationalLimitMotor();
      const bool slides = !(limits.m_lowerLimit.isZero() && limits.m_upperLimit.isZero());
      return slides ? Tree::JointType::Free : Tree::JointType::Spherical;
    }
    case Kind::SixDofSpring:
      if (moves_about_z(c)) return Tree::JointType::Revolute;
      return moves_along_z(c) ? Tree::JointType::Prismatic : Tree::JointType::Fixed;
    default: return Tree::JointType::Fixed;
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
  const Tree::JointType type = joint_type_of(spring);
  if (type == Tree::JointType::Fixed || type != joint_type_of(joint)) return false;
  const bool same_order = &first_of(spring) == &first_of(joint);
  for (bool of_b : {false, true}) {
    const btTransform theirs = frame_of(joint, of_b), own = frame_of(spring, same_order ? of_b : !of_b);
    const btVector3 axis = theirs.getBasis() * axis_of(joint);
    if (axis.cross(own.getBasis() * axis_of(spring)).length() > AXIS_TOLERANCE) return false;
    // For a hinge the distance between the axes counts, for a slider only their directions.
    const bool hinge = type == Tree::JointType::Revolute;
    if (hinge && axis.cross(own.getOrigin() - theirs.getOrigin()).length() > AXIS_TOLERANCE) return false;
  }
  return true;
}

bool joins_the_same(const AmbConstraint &a, const AmbConstraint &b) {
  return (&first_of(a) == &first_of(b) && &second_of(a) == &second_of(b)) ||
         (&first_of(a) == &second_of(b) && &second_of(a) == &first_of(b));
}

// Largest position error of a joint, m and rad, up to which its child is moved onto the joint. With larger errors the
// joint stays a constraint.
constexpr btScalar MAX_INITIAL_GAP = 0.02, MAX_INITIAL_ANGLE = 0.05;

// Whether the position error of a joint is within these limits.
bool fits(AmbConstraint &joint) {
  const btTransform a = first_of(joint).body.getWorldTransform() * frame_of(joint, false);
  const btTransform b = second_of(joint).body.getWorldTransform() * frame_of(joint, true);
  const btVector3 axis = a.getBasis() * axis_of(joint);
  btVector3 gap = b.getOrigin() - a.getOrigin();
  const Tree::JointType type = joint_type_of(joint);
  if (type == Tree::JointType::Free) return true;
  if (type == Tree::JointType::Spherical) return gap.length() < MAX_INITIAL_GAP;
  if (type == Tree::JointType::Prismatic) gap -= axis * axis.dot(gap);
  btScalar angle;
  if (type == Tree::JointType::Revolute) {
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
  const Tree::JointType type = joint_type_of(joint);
  return Tree::sliding_coordinates_of(type) + Tree::turning_coordinates_of(type);
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

Tree::Body inertia_of(const AmbBody &body) {
  Tree::Body result;
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

// [v] times a matrix: each column of the result is v x the column.
btMatrix3x3 cross_matrix(const btVector3 &v, const btMatrix3x3 &m) {
  const btVector3 x = m[2] * v.y() - m[1] * v.z();
  const btVector3 y = m[0] * v.z() - m[2] * v.x();
  const btVector3 z = m[1] * v.x() - m[0] * v.y();
  return btMatrix3x3(x.x(), x.y(), x.z(), y.x(), y.y(), y.z(), z.x(), z.y(), z.z());
}

// A link whose coordinates follow those of the links before. The joint's frames coincide at coordinate 0, `axis` is in them.
Tree::Link link_of(int parent, Tree::JointType type, const btVector3 &axis, const btTransform &joint_in_parent,
                   const btTransform &joint_in_child, int &coordinates, int &balls) {
  Tree::Link link;
  link.parent = parent;
  link.type = type;
  link.sliding = Tree::sliding_coordinates_of(type);
  link.turning = Tree::turning_coordinates_of(type);
  link.coordinate = link.freedoms() == 0 ? -1 : coordinates;
  coordinates += link.freedoms();
  link.ball = link.turning == 3 ? balls++ : -1;
  link.axis = joint_in_parent.getBasis() * axis;
  link.pivot = joint_in_parent.getOrigin();
  link.rotation = joint_in_parent.getBasis().timesTranspose(joint_in_child.getBasis());
  link.arm = -joint_in_child.getOrigin();
  link.turn = cross_matrix(link.axis, link.rotation);
  link.turn2 = cross_matrix(link.axis, link.turn);
  return link;
}

// Finds the motor of a joint: the rate that it leads to, its softness and its largest impulse in h s, 0: there is none.
void set_motor(Tree::Joint &of, const AmbConstraint &joint, btScalar h) {
  of.softness = of.target = of.impulse = 0;
  if (joint.motor.enabled) {
    of.target = joint.motor.velocity;
    of.softness = joint.motor.softness;
    of.impulse = joint.motor.max_force * h;
  } else if (joint.kind == Kind::Hinge) {
    auto &hinge = static_cast<btHingeConstraint &>(*joint.constraint);
    if (!hinge.getEnableAngularMotor()) return;
    of.target = hinge.getMotorTargetVelocity();
    of.impulse = hinge.getMaxMotorImpulse();
  } else if (joint.kind == Kind::Slider) {
    auto &slider = static_cast<btSliderConstraint &>(*joint.constraint);
    if (!slider.getPoweredLinMotor()) return;
    of.target = slider.getTargetLinMotorVelocity();
    of.impulse = slider.getMaxLinMotorForce() * h;
  }
}

// Memory in the arena that the thread has entered; each block begins with the address of the one before.
void *allocate(void **blocks, size_t size) {
  constexpr size_t HEAD = 16;
  void **const block = static_cast<void **>(btAlignedAlloc(HEAD + size, HEAD));
  *block = *blocks;
  *blocks = block;
  return reinterpret_cast<char *>(block) + HEAD;
}

void release(void *blocks) {
  while (blocks) {
    void *const before = *static_cast<void **>(blocks);
    btAlignedFree(blocks);
    blocks = before;
  }
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
    : world(owner), has_fixed_base(base.body.getInvMass() == 0) {
  members.push_back({&base, nullptr, nullptr, nullptr});
  if (!has_fixed_base) {
    base.articulation = this;
    base.member = 0;
  }
  make_tree(joints, n, n_parallel);
  // Bullet has no joints with six motions: a further link of the btMultiBody, without a body, has three of them.
  int links = n;
  for (int i = 0; i < n; ++i) links += tree->link[i].type == Tree::JointType::Free ? 1 : 0;
  multi_body = std::make_unique<btMultiBody>(links, tree->body[0].mass, tree->body[0].inertia, has_fixed_base, false);
  links = n;
  for (int i = 0; i < n; ++i) {
    const int parent = tree->link[i].parent;
    const Tree::Link &link = tree->link[i];
    const Tree::Body &body = tree->body[i + 1];
    btQuaternion rotation;
    link.rotation.transpose().getRotation(rotation);
    const btVector3 local_axis = link.rotation.transpose() * link.axis;
    switch (link.type) {
      case Tree::JointType::Revolute:
        multi_body->setupRevolute(i, body.mass, body.inertia, parent - 1, rotation, local_axis, link.pivot, link.arm);
        break;
      case Tree::JointType::Prismatic:
        multi_body->setupPrismatic(i, body.mass, body.inertia, parent - 1, rotation, local_axis, link.pivot, link.arm,
                                   false);
        break;
      case Tree::JointType::Free:
        multi_body->setupSpherical(links++, 0, btVector3(0, 0, 0), i, rotation, link.pivot, link.arm, false);
        [[fallthrough]];
      case Tree::JointType::Spherical:
        multi_body->setupSpherical(i, body.mass, body.inertia, parent - 1, rotation, link.pivot, link.arm, false);
        break;
      case Tree::JointType::Fixed:
        multi_body->setupFixed(i, body.mass, body.inertia, parent - 1, rotation, link.pivot, link.arm);
        break;
    }
  }
  multi_body->finalizeMultiDof();
  multi_body->setLinearDamping(0);
  multi_body->setAngularDamping(0);
  multi_body->setMaxCoordinateVelocity(BT_LARGE_FLOAT);
  multi_body->setUserPointer(this);
  for (size_t i = 1; i < members.size(); ++i) world.articulated->removeConstraint(members[i].joint->constraint.get());
  for (int i = 0; i < n_parallel; ++i) world.articulated->removeConstraint(parallel[i]->constraint.get());
  for (size_t i = has_fixed_base ? 1 : 0; i < members.size(); ++i) {
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
    if (joint.kind == Kind::SixDofSpring && tree->link[i - 1].coordinate >= 0) add_spring(joint, i - 1, true);
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

// Makes the tree of the joints, with place for all springs, and the couplings between them parts of its equations of motion.
void AmbArticulation::make_tree(AmbConstraint *const *joints, int n, int n_parallel) {
  Vector<Tree::Link> links;
  Vector<Tree::Body> bodies{inertia_of(*members[0].body)};
  int coordinates = 0, balls = 0, spring_count = n_parallel;
  auto member_of = [this](const AmbBody *body) {
    // A fixed base may be the base of several articulations and has no `articulation`.
    return body == members[0].body ? 0 : body->articulation == this ? body->member : -1;
  };
  for (int i = 0; i < n; ++i) {
    AmbConstraint &joint = *joints[i];
    const bool from_a = member_of(&first_of(joint)) >= 0;
    AmbBody &child = from_a ? second_of(joint) : first_of(joint);
    const int parent = member_of(from_a ? &first_of(joint) : &second_of(joint));
    const btTransform in_parent = frame_of(joint, !from_a), in_child = frame_of(joint, from_a);
    const btVector3 axis = axis_of(joint);
    // The coordinate is that of body B relative to body A.
    links.push_back(link_of(parent, joint_type_of(joint), from_a ? axis : -axis, in_parent, in_child, coordinates, balls));
    bodies.push_back(inertia_of(child));
    child.articulation = this;
    child.member = i + 1;
    joint.articulation = this;
    joint.link = i + 1;
    has_feedback |= joint.feedback != nullptr;
    has_wide_limits |= joint.kind == Kind::ConeTwist || joint.kind == Kind::SixDof;
    members.push_back({&child, &joint, nullptr, nullptr});
    spring_count += joint.kind == Kind::SixDofSpring && links.back().coordinate >= 0 ? 1 : 0;
    spring_count += joint.motor.damping > 0 ? 1 : 0;
  }
  Vector<Tree::CoupledCoordinate> terms;
  Vector<int> ends;
  Vector<btScalar> offsets;
  for (AmbCoupling *coupling : engine_of(world).couplings) {
    if (coupling->articulation() != this) continue;
    coupling->follow_articulation(world);
    couplings.push_back(coupling);
    for (const AmbCoupling::Term &term : coupling->terms)
      terms.push_back({links[term.joint->link - 1].coordinate, term.factor});
    ends.push_back(static_cast<int>(terms.size()));
    offsets.push_back(coupling->offset);
  }
  const Tree::Bounds bounds{MAX_RETURN_SPEED, MAX_RETURN_RATE, LIMIT_ERP};
  const Tree::Plan plan{n, static_cast<int>(ends.size()), spring_count, has_fixed_base, links.data(), bodies.data(),
                        terms.data(), ends.data(), offsets.data(), bounds, allocate, &blocks};
  tree = tree_table->make(&plan);
}

void AmbArticulation::body_changed(const AmbBody &body) {
  const size_t member = body.member;
  Tree::Body &present = tree->body[member];
  Tree::Body changed = inertia_of(body);
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
    tree->spring[i].damping = joint.motor.damping;
    return true;
  }
  return joint.motor.damping <= 0;
}

void AmbArticulation::add_spring(AmbConstraint &constraint, size_t link, bool is_joint) {
  const Tree::Link &joint = tree->link[link];
  const bool is_angle = joint.type == Tree::JointType::Revolute;
  auto &six_dof = constraint.as<btGeneric6DofSpring2Constraint>();
  const auto &turn = *six_dof.getRotationalLimitMotor(2);
  const auto &way = *six_dof.getTranslationalLimitMotor();
  // Angular quantities have the sign of a hinge here, which is opposite to that of Bullet's six-dof spring.
  const bool enabled = is_angle ? turn.m_enableSpring : way.m_enableSpring[2];
  Tree::Spring spring;
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
    spring.offset = spring_coordinate(constraint) - spring.sign * tree->q[joint.coordinate];
    if (low <= high) {
      low = (low - spring.offset) * spring.sign;
      high = (high - spring.offset) * spring.sign;
      if (low > high) std::swap(low, high);
      // Limits equal to those of the joint need no row of their own.
      const btScalar tolerance = 1e-6;
      if (btFabs(low - own.motor.low) < tolerance && btFabs(high - own.motor.high) < tolerance) low = high + 1;
    }
  }
  tree_table->add_spring(tree, &spring, static_cast<int>(link) + 1, !is_joint, low, high);
  springs.push_back({&constraint, link});
}

// Keeps the coordinates of coupled joints with all their turns.
void AmbArticulation::remember_coordinates() {
  for (AmbCoupling *coupling : couplings) {
    for (AmbCoupling::Term &term : coupling->terms) term.last = tree->q[tree->link[term.joint->link - 1].coordinate];
  }
}

// Gives followers the coordinates that their leaders ask for; angles of joints are known up to whole turns before. At the
// start those of the leaders have none.
void AmbArticulation::close_couplings() {
  for (AmbCoupling *coupling : couplings) {
    const auto coordinate = [&](size_t k) -> btScalar & {
      return tree->q[tree->link[coupling->terms[k].joint->link - 1].coordinate];
    };
    coupling->complete(coordinate, joint_rows != nullptr);
    coordinate(0) = coupling->wanted(coordinate);
  }
}

// The damping of a hinge or slider: a spring without stiffness.
void AmbArticulation::add_damper(AmbConstraint &joint, size_t link) {
  Tree::Spring damper;
  damper.coordinate = tree->link[link].coordinate;
  damper.is_angle = joint.kind == Kind::Hinge;
  damper.damping = joint.motor.damping;
  damper.stiffness = damper.rest = damper.offset = 0;
  damper.sign = 1;
  tree_table->add_spring(tree, &damper, static_cast<int>(link) + 1, false, 1, -1);
  springs.push_back({&joint, link});
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
  release(blocks);
}

void AmbArticulation::take_base_pose() {
  base_pose = members[0].body->body.getWorldTransform();
  *tree->origin = tree->base->origin = base_pose.getOrigin();
  *tree->rotation = tree->base->rotation = base_pose.getRotation();
}

// Takes over the pose of a fixed base that was set.
void AmbArticulation::follow_base() {
  if (!differ(members[0].body->body.getWorldTransform(), base_pose)) return;
  take_base_pose();
  tree_table->place(tree);
  write_proxies();
}

void AmbArticulation::apply_set_state() {
  if (!poses_set && !velocities_set) return;
  if (poses_set) {
    tree_table->forget(tree);
    if (joint_rows) remember_coordinates();
    take_base_pose();
    for (int i = 0; i < tree->links; ++i) {
      const Tree::Link &link = tree->link[i];
      if (link.type == Tree::JointType::Fixed) continue;
      const btTransform &parent = members[link.parent].body->body.getWorldTransform();
      const btTransform &child = members[i + 1].body->body.getWorldTransform();
      const btTransform relative = parent.inverseTimes(child);
      if (link.ball >= 0) {
        tree->balls[link.ball] = relative.getRotation();
        const btVector3 way = relative.getOrigin() - relative.getBasis() * link.arm - link.pivot;
        for (int k = 0; k < link.sliding; ++k) tree->q[link.coordinate + k] = way[k];
        continue;
      }
      btScalar &q = tree->q[link.coordinate];
      if (link.type == Tree::JointType::Revolute) {
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
  if (has_fixed_base) {
    *tree->base_linear = members[0].body->body.getLinearVelocity();
    *tree->base_angular = members[0].body->body.getAngularVelocity();
  }
  Vector<btVector3> linear, angular;
  for (size_t i = 0; velocities_set && i < members.size(); ++i) {
    linear.push_back(members[i].body->body.getLinearVelocity());
    angular.push_back(members[i].body->body.getAngularVelocity());
  }
  const auto given = [this](const Vector<btVector3> &all) { return velocities_set ? all.data() : nullptr; };
  tree_table->settle(tree, given(linear), given(angular));
  poses_set = velocities_set = false;
  write_proxies();
}

void AmbArticulation::write_proxies() {
  for (size_t i = has_fixed_base ? 1 : 0; i < members.size(); ++i) {
    AmbBody &body = *members[i].body;
    const btTransform pose(tree->rotations[i], tree->origins[i]);
    body.body.setWorldTransform(pose);
    body.body.setLinearVelocity(tree->linear[i]);
    body.body.setAngularVelocity(tree->angular[i]);
    body.motion.setWorldTransform(pose);
    members[i].collider->setWorldTransform(pose);
    members[i].collider->setInterpolationWorldTransform(pose);
  }
}

// Tells the tree what acts on its joints over the next h s.
void AmbArticulation::give_joints(btScalar h) {
  for (int i = 0; i < tree->links; ++i) {
    if (tree->link[i].freedoms() != 1) continue;
    const AmbConstraint &joint = *members[i + 1].joint;
    Tree::Joint &given = tree->joint[i];
    set_motor(given, joint, h);
    given.armature = joint.motor.armature;
    given.friction = joint.motor.friction;
    given.max_rate = joint.motor.max_rate;
    given.low = joint.motor.low;
    given.high = joint.motor.high;
    given.is_hinge = joint.kind == Kind::Hinge;
  }
}

void AmbArticulation::move_freely(btScalar h) {
  const EngineWorld &engine = engine_of(world);
  if (has_fixed_base) follow_base();
  *tree->circumstances = {engine.trees_by_euler, has_contact, external_constraint_count > 0, is_driven(), has_wide_limits,
                          has_feedback && engine.has_reactions, engine.ledger.enabled, false};
  for (size_t i = 0; i < members.size(); ++i) {
    const btRigidBody &proxy = members[i].body->body;
    tree->wrenches[i] = {proxy.getTotalForce(), proxy.getTotalTorque()};
    tree->gravity[i] = proxy.getGravity();
  }
  tree->base->linear = members[0].body->body.getLinearVelocity();
  tree->base->angular = members[0].body->body.getAngularVelocity();
  give_joints(h);
  if (has_wide_limits) joint_rows->give_wide_limits(h);
  tree_table->move_freely(tree, h);
}

void AmbArticulation::prepare_rows(btScalar h) {
  tree_table->prepare_rows(tree, h);
  // The velocity of the btMultiBody is the sum of the changes by all rows.
  multi_body->clearVelocities();
}

void AmbArticulation::finish(btScalar h) {
  for (size_t i = 1; *tree->has_rows && i < members.size(); ++i) {
    const btMultibodyLink &link = multi_body->getLink(static_cast<int>(i) - 1);
    tree->applied[i] = {link.m_appliedConstraintForce, link.m_appliedConstraintTorque};
  }
  if (has_fixed_base) {
    // It has been moved.
    const btRigidBody &base = members[0].body->body;
    tree->circumstances->is_moved = differ(base.getWorldTransform(), base_pose);
    if (tree->circumstances->is_moved) take_base_pose();
    tree->base->linear = base.getLinearVelocity();
    tree->base->angular = base.getAngularVelocity();
  }
  tree_table->finish(tree, h, multi_body->getVelocityVector(), joint_rows->impulses());
  if (tree->circumstances->is_accounted) engine_of(world).ledger.take(*tree->sums);
  if (tree->circumstances->has_reactions) write_feedback();
  write_proxies();
}

void AmbArticulation::note_energy() {
  for (size_t i = 0; i < members.size(); ++i) tree->gravity[i] = members[i].body->body.getGravity();
  tree_table->note_energy(tree);
}

MechanicalEnergy AmbArticulation::energy() const {
  return {tree->energy->kinetic, tree->energy->potential, tree->energy->elastic};
}

AmbArticulation &articulation_of(const btMultiBody &multi_body) {
  return *static_cast<AmbArticulation *>(multi_body.getUserPointer());
}

double free_energy(const btMultiBody &multi_body) { return *articulation_of(multi_body).tree->free_energy; }

AmbBody &first_link_of(const btMultiBody &multi_body) { return *articulation_of(multi_body).members[1].body; }

Tree *tree_of(const btMultiBody &multi_body) { return articulation_of(multi_body).tree; }

void read_rates(const btMultiBody &multi_body, Vector<btScalar> &start, Vector<btScalar> &free) {
  const Tree &tree = *articulation_of(multi_body).tree;
  start.resize(tree.velocities());
  free.resize(tree.velocities());
  tree_table->read_rates(&tree, start.data(), free.data());
}

// Writes the reactions of joints and of springs beside them.
void AmbArticulation::write_feedback() {
  const auto arm = [this](size_t i) { return tree->origins[i] - tree->origins[tree->link[i - 1].parent]; };
  for (size_t i = 1; i < members.size(); ++i) write_wrench(*members[i].joint, i, tree->reactions[i], arm(i));
  for (size_t s = 0; s < springs.size(); ++s) {
    const size_t i = springs[s].link + 1;
    if (springs[s].constraint == members[i].joint) continue;
    write_wrench(*springs[s].constraint, i, tree->spring_reactions[s], arm(i));
  }
}

// Writes the wrench of a joint or spring on link i about its centre of mass, and the opposite wrench on its parent. `arm`
// leads from the parent's centre of mass to that of the link, m.
void AmbArticulation::write_wrench(const AmbConstraint &constraint, size_t i, const Tree::Wrench &wrench, const btVector3 &arm) {
  if (!constraint.feedback) return;
  const bool child_is_b = &second_of(constraint) == members[i].body;
  btJointFeedback &feedback = *constraint.feedback;
  (child_is_b ? feedback.m_appliedForceBodyB : feedback.m_appliedForceBodyA) = wrench.force;
  (child_is_b ? feedback.m_appliedTorqueBodyB : feedback.m_appliedTorqueBodyA) = wrench.torque;
  (child_is_b ? feedback.m_appliedForceBodyA : feedback.m_appliedForceBodyB) = -wrench.force;
  (child_is_b ? feedback.m_appliedTorqueBodyA : feedback.m_appliedTorqueBodyB) = -(wrench.torque + arm.cross(wrench.force));
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
  const int coordinate = tree->link[joint.link - 1].coordinate;
  if (speed) *speed = coordinate < 0 ? 0 : tree->rates[coordinate];
  return coordinate < 0 ? 0 : tree->q[coordinate];
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
