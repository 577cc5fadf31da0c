#include "tree_rows.h"

namespace {

TreeDynamics::Motion motion_of(Kind kind) {
  switch (kind) {
    case Kind::Hinge: return TreeDynamics::Motion::Revolute;
    case Kind::Slider: return TreeDynamics::Motion::Prismatic;
    default: return TreeDynamics::Motion::Fixed;
  }
}

btTransform frame_of(AmbConstraint &c, bool of_b) {
  switch (c.kind) {
    case Kind::Hinge: return of_b ? c.as<btHingeConstraint>().getBFrame() : c.as<btHingeConstraint>().getAFrame();
    case Kind::Slider:
      return of_b ? c.as<btSliderConstraint>().getFrameOffsetB() : c.as<btSliderConstraint>().getFrameOffsetA();
    default: return of_b ? c.as<btFixedConstraint>().getFrameOffsetB() : c.as<btFixedConstraint>().getFrameOffsetA();
  }
}

// A share of velocity lost in 1 s as the rate of its decay. What is lost at once is lost in a step of 0.1 ms.
btScalar drag_of(btScalar share) { return share > 0 ? std::fmin(-std::log1p(-std::fmin(share, btScalar(1))), 1e4) : 0; }

TreeDynamics::Body body_of(const AmbBody &body) {
  TreeDynamics::Body result;
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

btTransform transform_of(const TreeDynamics &dynamics, size_t body) {
  return btTransform(dynamics.rotations[body], dynamics.origins[body]);
}

}  // namespace

LinkCollider::LinkCollider(AmbBody &owner, btMultiBody *multi_body, int link) : btMultiBodyLinkCollider(multi_body, link) {
  setUserPointer(static_cast<AmbObject *>(&owner));
  setCollisionShape(owner.shape->shape.get());
  setFriction(owner.body.getFriction());
  setRollingFriction(owner.body.getRollingFriction());
  setRestitution(owner.body.getRestitution());
  setActivationState(DISABLE_DEACTIVATION);
}

bool LinkCollider::checkCollideWithOverride(const btCollisionObject *other) const {
  const AmbObject *object = object_of(other);
  for (const AmbObject *one : parted) {
    if (one == object) return false;
  }
  return btMultiBodyLinkCollider::checkCollideWithOverride(other);
}

AmbTree::AmbTree(AmbWorld &owner, AmbBody &base, AmbConstraint *const *joints, int n)
    : world(owner), dynamics(base.body.getInvMass() == 0) {
  const bool fixed = dynamics.fixed_base;
  dynamics.bodies.push_back(body_of(base));
  members.push_back({&base, nullptr, nullptr});
  multi_body = std::make_unique<btMultiBody>(n, dynamics.bodies[0].mass, dynamics.bodies[0].inertia, fixed, false);
  auto member_of = [this](const AmbBody *body) {
    // A fixed base may be the base of other trees.
    return body == members[0].body ? 0 : body->tree == this ? body->member : -1;
  };
  if (!fixed) base.tree = this;
  for (int i = 0; i < n; ++i) {
    AmbConstraint &joint = *joints[i];
    const bool from_a = member_of(&first_of(joint)) >= 0;
    AmbBody &child = from_a ? second_of(joint) : first_of(joint);
    const int parent = member_of(from_a ? &first_of(joint) : &second_of(joint));
    const btTransform in_parent = frame_of(joint, !from_a), in_child = frame_of(joint, from_a);
    const btVector3 axis = joint.kind == Kind::Slider ? btVector3(1, 0, 0) : btVector3(0, 0, 1);
    // The coordinate is that of B with respect to A.
    dynamics.add(body_of(child), parent, motion_of(joint.kind), from_a ? axis : -axis, in_parent, in_child);
    child.tree = this;
    child.member = i + 1;
    joint.tree = this;
    joint.link = i + 1;
    has_feedback |= joint.feedback != nullptr;
    members.push_back({&child, &joint, nullptr});

    const TreeDynamics::Link &link = dynamics.links[i];
    const TreeDynamics::Body &body = dynamics.bodies[i + 1];
    btQuaternion rotation;
    link.rotation.transpose().getRotation(rotation);
    const btVector3 local_axis = link.rotation.transpose() * link.axis;
    switch (link.motion) {
      case TreeDynamics::Motion::Revolute:
        multi_body->setupRevolute(i, body.mass, body.inertia, parent - 1, rotation, local_axis, link.pivot, link.arm);
        break;
      case TreeDynamics::Motion::Prismatic:
        multi_body->setupPrismatic(i, body.mass, body.inertia, parent - 1, rotation, local_axis, link.pivot, link.arm,
                                   false);
        break;
      case TreeDynamics::Motion::Fixed:
        multi_body->setupFixed(i, body.mass, body.inertia, parent - 1, rotation, link.pivot, link.arm);
        break;
    }
  }
  dynamics.finish();
  multi_body->finalizeMultiDof();
  multi_body->setLinearDamping(0);
  multi_body->setAngularDamping(0);
  multi_body->setMaxCoordinateVelocity(BT_LARGE_FLOAT);
  position.q.resize(dynamics.coordinates);
  rate.q.resize(dynamics.coordinates);
  free_position = position;
  free_rate = rate;
  for (size_t i = 1; i < members.size(); ++i) world.trees->removeConstraint(members[i].joint->constraint.get());
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
  for (size_t i = 1; i < members.size(); ++i) {
    const AmbConstraint &joint = *members[i].joint;
    if (!joint.parts) continue;
    members[i].collider->parted.push_back(&first_of(joint) == members[i].body ? &second_of(joint) : &first_of(joint));
  }
  joint_rows = std::make_unique<JointRows>(*this);
  world.trees->addMultiBody(multi_body.get());
  world.trees->addMultiBodyConstraint(joint_rows.get());
  world.trees->trees.push_back(this);
  poses_set = velocities_set = true;
  settle();
}

AmbTree::~AmbTree() {
  settle();
  auto &trees = world.trees->trees;
  for (size_t i = 0; i < trees.size(); ++i) {
    if (trees[i] == this) trees.erase(trees.begin() + i--);
  }
  std::vector<AmbConstraint *> tied;
  for (AmbConstraint *constraint : world.trees->ties) {
    if (first_of(*constraint).tree == this || second_of(*constraint).tree == this) tied.push_back(constraint);
  }
  for (AmbConstraint *constraint : tied) remove_tie(world, *constraint);
  world.trees->removeMultiBodyConstraint(joint_rows.get());
  world.trees->removeMultiBody(multi_body.get());
  for (Member &member : members) {
    if (!member.collider) continue;
    AmbBody &body = *member.body;
    world.world->removeCollisionObject(member.collider.get());
    body.collider = &body.body;
    body.tree = nullptr;
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
    joint.tree = nullptr;
    world.world->addConstraint(joint.constraint.get(), joint.parts);
  }
  for (AmbConstraint *constraint : tied) amb_world_add_constraint(&world, constraint, constraint->parts);
}

void AmbTree::follow_base() {
  const btTransform &pose = members[0].body->body.getWorldTransform();
  if (!differ(pose, base_pose)) return;
  base_pose = pose;
  position.origin = pose.getOrigin();
  position.rotation = pose.getRotation();
  dynamics.place(position);
  dynamics.move(rate);
  write_mirrors();
}

void AmbTree::settle() {
  if (!poses_set && !velocities_set) return;
  if (poses_set) {
    base_pose = members[0].body->body.getWorldTransform();
    position.origin = base_pose.getOrigin();
    position.rotation = base_pose.getRotation();
    for (size_t i = 0; i < dynamics.links.size(); ++i) {
      const TreeDynamics::Link &link = dynamics.links[i];
      if (link.motion == TreeDynamics::Motion::Fixed) continue;
      const btTransform &parent = members[link.parent].body->body.getWorldTransform();
      const btTransform &child = members[i + 1].body->body.getWorldTransform();
      const btTransform relative = parent.inverseTimes(child);
      btScalar &q = position.q[link.coordinate];
      if (link.motion == TreeDynamics::Motion::Revolute) {
        // The rotation about the axis that comes nearest: of R = turn(axis, q) * rest.
        const btMatrix3x3 turn = relative.getBasis().timesTranspose(link.rotation);
        const btVector3 twist(turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1]);
        const btScalar trace = turn[0][0] + turn[1][1] + turn[2][2];
        q = btAtan2(link.axis.dot(twist), trace - link.axis.dot(turn * link.axis));
      } else {
        q = link.axis.dot(relative.getOrigin() - relative.getBasis() * link.arm - link.pivot);
      }
    }
  }
  dynamics.place(position);
  if (velocities_set) {
    std::vector<btVector3> linear, angular;
    for (const Member &member : members) {
      linear.push_back(member.body->body.getLinearVelocity());
      angular.push_back(member.body->body.getAngularVelocity());
    }
    dynamics.project(linear.data(), angular.data(), rate);
  }
  dynamics.move(rate);
  poses_set = velocities_set = false;
  write_mirrors();
}

void AmbTree::write_mirrors() {
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

void AmbTree::predict(btScalar h) {
  if (dynamics.fixed_base) follow_base();
  for (size_t i = dynamics.fixed_base ? 1 : 0; i < members.size(); ++i) {
    TreeDynamics::Body &body = dynamics.bodies[i];
    const btRigidBody &mirror = members[i].body->body;
    body.force = mirror.getTotalForce() + mirror.getGravity() * body.mass;
    body.torque = mirror.getTotalTorque();
  }
  if (has_feedback) remember_momenta();
  dynamics.step(h, position, rate, free_position, free_rate);
  has_rows = joint_rows->plan(h) || touched || ties > 0;
}

void AmbTree::prepare_rows() {
  btMultiBody &body = *multi_body;
  body.setBasePos(position.origin);
  body.setWorldToBaseRot(position.rotation.inverse());
  body.setBaseOmega(free_rate.angular);
  body.setBaseVel(free_rate.linear);
  for (size_t i = 0; i < dynamics.links.size(); ++i) {
    const int coordinate = dynamics.links[i].coordinate;
    if (coordinate < 0) {
      body.getLink(i).updateCacheMultiDof();
    } else {
      body.setJointPos(i, position.q[coordinate]);
      body.setJointVel(i, free_rate.q[coordinate]);
    }
  }
  body.forwardKinematics(scratch_q, scratch_v);
  // Of no time: for the factors that responses to impulses need.
  body.computeAccelerationsArticulatedBodyAlgorithmMultiDof(0, scratch_r, scratch_v, scratch_m, false, false, false);
}

bool AmbTree::was_pushed() const {
  auto any = [](const btVector3 &v) { return !v.isZero(); };
  for (int i = 0; i < multi_body->getNumLinks(); ++i) {
    const btMultibodyLink &link = multi_body->getLink(i);
    if (any(link.m_appliedConstraintForce) || any(link.m_appliedConstraintTorque)) return true;
  }
  return joint_rows->stopped();
}

void AmbTree::integrate(btScalar h) {
  if (has_rows) {
    TreeDynamics::Rate change = rate, &after = rate;
    after.angular = multi_body->getBaseOmega();
    after.linear = multi_body->getBaseVel();
    const btScalar *rates = multi_body->getVelocityVector() + 6;
    for (int i = 0; i < dynamics.coordinates; ++i) {
      after.q[i] = rates[i];
      change.q[i] = after.q[i] - free_rate.q[i];
    }
    change.angular = after.angular - free_rate.angular;
    change.linear = after.linear - free_rate.linear;
    if (touched || ties > 0 || was_pushed()) {
      // Impacts act from the beginning of the sub-step, so that nothing moves into what stopped it.
      TreeDynamics::shift(position, h, after);
    } else {
      // Motors push evenly over the sub-step.
      position = free_position;
      TreeDynamics::shift(position, h / 2, change);
    }
  } else {
    std::swap(position, free_position);
    std::swap(rate, free_rate);
  }
  if (dynamics.fixed_base) {
    position.origin = base_pose.getOrigin();
    rate.linear.setZero();
    rate.angular.setZero();
  }
  dynamics.place(position);
  dynamics.move(rate);
  if (has_feedback) write_feedback(h);
  write_mirrors();
}

void AmbTree::remember_momenta() {
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

// What the joints must have done over the sub-step: the change of momentum that nothing else explains, summed from the leaves.
void AmbTree::write_feedback(btScalar h) {
  const size_t n = members.size();
  std::vector<btVector3> forces(n), torques(n);
  for (size_t i = n; i-- > 0;) {
    const TreeDynamics::Body &body = dynamics.bodies[i];
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
    const btVector3 at_parent = torques[i] + arm.cross(forces[i]);
    const AmbConstraint &joint = *members[i].joint;
    if (joint.feedback) {
      const bool child_is_b = &second_of(joint) == members[i].body;
      btJointFeedback &feedback = *joint.feedback;
      (child_is_b ? feedback.m_appliedForceBodyB : feedback.m_appliedForceBodyA) = forces[i];
      (child_is_b ? feedback.m_appliedTorqueBodyB : feedback.m_appliedTorqueBodyA) = torques[i];
      (child_is_b ? feedback.m_appliedForceBodyA : feedback.m_appliedForceBodyB) = -forces[i];
      (child_is_b ? feedback.m_appliedTorqueBodyA : feedback.m_appliedTorqueBodyB) = -at_parent;
    }
    forces[parent] += forces[i];
    torques[parent] += at_parent;
  }
}

void AmbTree::clear_forces() {
  for (Member &member : members) {
    if (member.collider) member.body->body.clearForces();
  }
}

btScalar AmbTree::coordinate(const AmbConstraint &joint) {
  settle();
  const int coordinate = dynamics.links[joint.link - 1].coordinate;
  return coordinate < 0 ? 0 : position.q[coordinate];
}

extern "C" {

AmbTree *amb_world_articulate(AmbWorld *world, AmbBody *base, AmbConstraint *const *joints, int n) {
  if (!world->trees) return nullptr;
  for (int i = 0; i < n; ++i) {
    for (const AmbBody *body : {&first_of(*joints[i]), &second_of(*joints[i])}) {
      if (body->tree || (!turns_freely(*body) && (body != base || body->body.getInvMass() > 0))) return nullptr;
    }
  }
  return new AmbTree(*world, *base, joints, n);
}

void amb_world_dissolve(AmbWorld *, AmbTree *tree) { delete tree; }

}  // extern "C"
