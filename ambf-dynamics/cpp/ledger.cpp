#include "ledger.h"

#include "free_flight.h"
#include "second_order.h"
#include "spring_rotation.h"
#include "articulation_rows.h"

#include <cmath>

namespace {

btVector3 inertia_of(const btRigidBody &body) {
  const btVector3 &inverse = body.getInvInertiaDiagLocal();
  const auto moment = [](btScalar one) { return one > 0 ? 1 / one : btScalar(0); };
  return {moment(inverse.x()), moment(inverse.y()), moment(inverse.z())};
}

double rotation_energy(const btRigidBody &body, const btMatrix3x3 &pose, const btVector3 &omega) {
  const btVector3 local = omega * pose;
  return local.dot(local * inertia_of(body)) / 2;
}

btVector3 weight_of(const btRigidBody &body) { return body.getGravity() / body.getInvMass(); }

MechanicalEnergy energy_of(const AmbBody &owner, const btVector3 &velocity, const btVector3 &omega) {
  const btRigidBody &body = owner.body;
  const btTransform &pose = body.getWorldTransform();
  return {velocity.length2() / body.getInvMass() / 2 + rotation_energy(body, pose.getBasis(), omega),
          -weight_of(body).dot(pose.getOrigin() - velocity * owner.pose_lead), 0};
}

// Calls `act` for every dynamic body that is not a link.
template <class Act>
void for_free_bodies(const AmbWorld &world, Act act) {
  const btCollisionObjectArray &objects = world.world->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    AmbBody *owner = body_of(objects[i]);
    if (owner && !owner->articulation && owner->body.getInvMass() > 0 && !owner->body.isStaticOrKinematicObject())
      act(*owner);
  }
}

struct Axis {
  double coordinate, rest, stiffness, damping;
};

// Axes of a spring whose transforms are up to date: translations along x, y, z (m), then rotations (rad).
struct Axes {
  Axis axis[6];
  // The angular coordinates are a rotation vector, which changes its sign at pi; the energy is continuous there.
  bool turns;
};

Axis axis_of(btGeneric6DofSpring2Constraint &spring, int i) {
  if (i < 3) {
    const auto &way = *spring.getTranslationalLimitMotor();
    if (!way.m_enableSpring[i]) return {spring.getRelativePivotPosition(i), 0, 0, 0};
    return {spring.getRelativePivotPosition(i), way.m_equilibriumPoint[i], way.m_springStiffness[i],
            way.m_springDamping[i]};
  }
  const auto &turn = *spring.getRotationalLimitMotor(i - 3);
  if (!turn.m_enableSpring) return {spring.getAngle(i - 3), 0, 0, 0};
  return {spring.getAngle(i - 3), turn.m_equilibriumPoint, turn.m_springStiffness, turn.m_springDamping};
}

Axes axes_of(btGeneric6DofSpring2Constraint &spring, bool implicit) {
  Axes axes;
  for (int i = 0; i < 6; ++i) axes.axis[i] = axis_of(spring, i);
  axes.turns = implicit && SpringRotation::holds_for(spring);
  if (axes.turns) {
    const SpringRotation rotation(spring);
    for (int i = 0; i < 3; ++i) {
      axes.axis[3 + i].coordinate = rotation.phi[i];
      axes.axis[3 + i].rest = 0;
    }
  }
  return axes;
}

}  // namespace

void EnergyLedger::start(EngineWorld &engine) {
  enabled = true;
  implicit_springs = engine.solver == AmbSolver_Accurate;
  sums = {};
  spring_states.clear();
  if (engine.world.articulated) {
    for (AmbArticulation *articulation : engine.world.articulated->articulations) articulation->note_energy();
  }
  update_spring_states(engine);
  last = free_bodies(engine);
  const MechanicalEnergy articulated = articulations(engine);
  last += articulated;
  last.elastic += springs(0);
  start_total = last.total();
  start_potential = last.potential;
}

AmbEnergy EnergyLedger::read() const {
  if (!enabled) return {};
  AmbEnergy result = sums;
  result.kinetic = last.kinetic;
  result.potential = last.potential - start_potential;
  result.elastic = last.elastic;
  result.unexplained = last.total() - start_total - sums.set_states - sums.wrenches - sums.motors - sums.body_drives -
                       sums.damping - sums.joints - sums.limits - sums.contacts - sums.friction - sums.corrections -
                       sums.outside;
  return result;
}

MechanicalEnergy EnergyLedger::free_bodies(EngineWorld &engine) const {
  MechanicalEnergy sum;
  for_free_bodies(engine.world, [&](AmbBody &owner) {
    sum += energy_of(owner, owner.body.getLinearVelocity(), owner.body.getAngularVelocity());
  });
  return sum;
}

MechanicalEnergy EnergyLedger::articulations(EngineWorld &engine) const {
  MechanicalEnergy sum;
  if (!engine.world.articulated) return sum;
  for (const AmbArticulation *articulation : engine.world.articulated->articulations) sum += articulation->energy();
  return sum;
}

// Resets the stored coordinates of springs whose bodies were moved between two sub-steps.
void EnergyLedger::update_spring_states(EngineWorld &engine) {
  const btDiscreteDynamicsWorld &world = *engine.world.world;
  size_t count = 0;
  for (int i = 0; i < world.getNumConstraints(); ++i) {
    const btTypedConstraint *constraint = engine.world.world->getConstraint(i);
    if (constraint->getConstraintType() != D6_SPRING_2_CONSTRAINT_TYPE || !constraint->isEnabled()) continue;
    if (spring_states.size() <= count) spring_states.push_back({});
    SpringState &state = spring_states[count++];
    auto &spring = *static_cast<btGeneric6DofSpring2Constraint *>(engine.world.world->getConstraint(i));
    spring.calculateTransforms();
    const Axes axes = axes_of(spring, implicit_springs);
    for (int k = 0; k < 6; ++k) {
      const double coordinate = axes.axis[k].coordinate;
      // A pose that was set differs by more than the rounding error.
      if (state.spring != constraint || std::fabs(coordinate - state.now[k]) > 1e-12 * (1 + std::fabs(coordinate))) {
        state.before[k] = state.now[k] = coordinate;
      }
    }
    state.spring = constraint;
  }
  spring_states.resize(count);
}

// Elastic energy after a sub-step of h s, whose damping work is added to the sums; h = 0: the present energy only. The
// energy halfway between two poses, k (x0 - r) (x1 - r) / 2, is that with which the work of the force at the pose
// between them is balanced exactly.
double EnergyLedger::springs(double h) {
  double sum = 0;
  for (SpringState &state : spring_states) {
    const auto &constant = *static_cast<const btGeneric6DofSpring2Constraint *>(state.spring);
    auto &spring = const_cast<btGeneric6DofSpring2Constraint &>(constant);
    if (h > 0) spring.calculateTransforms();
    const Axes axes = axes_of(spring, implicit_springs);
    if (h > 0 && axes.turns) state.keep_sign(axes.axis[3].coordinate, axes.axis[4].coordinate, axes.axis[5].coordinate);
    for (int k = 0; k < 6; ++k) {
      const Axis &axis = axes.axis[k];
      if (h > 0) {
        const double last_way = state.now[k] - state.before[k], way = axis.coordinate - state.before[k];
        const double damped_way = implicit_springs ? axis.coordinate - state.now[k] : last_way;
        if (axis.damping > 0) sums.damping -= axis.damping * damped_way * way / (2 * h);
        state.before[k] = state.now[k];
        state.now[k] = axis.coordinate;
      }
      sum += axis.stiffness * (state.before[k] - axis.rest) * (state.now[k] - axis.rest) / 2;
    }
  }
  return sum;
}

void EnergyLedger::before_sub_step(EngineWorld &engine, double h) {
  save_sub_step_starts(engine.world);
  const bool always_leads = engine.integrator == AmbIntegrator_Euler;
  for_free_bodies(engine.world, [&](AmbBody &owner) {
    const bool is_second_order = owner.constraint_count > 0 && engine.solver == AmbSolver_Accurate;
    const bool is_first = is_second_order && owner.last_sub_step == 0;
    owner.force_share = is_second_order ? force_share(owner, h) : 1;
    if (is_first) owner.pose_lead = 0;
    if (!always_leads || is_first || owner.pose_lead > 0) return;
    // In this world the velocity is half a sub-step behind the pose at the beginning of every sub-step.
    owner.pose_lead = h / 2;
    const double slope = weight_of(owner.body).dot(owner.body.getLinearVelocity()) * owner.pose_lead;
    start_total += slope;
    start_potential += slope;
    last.potential += slope;
  });
  update_spring_states(engine);
  const MechanicalEnergy articulated = articulations(engine);
  const MechanicalEnergy now = free_bodies(engine);
  sums.set_states += now.total() + springs(0) + articulated.total() - last.total();
}

void EnergyLedger::after_motion(EngineWorld &engine) {
  for_free_bodies(engine.world, [](AmbBody &owner) {
    owner.solved_velocity[0] = owner.body.getLinearVelocity();
    owner.solved_velocity[1] = owner.body.getAngularVelocity();
  });
}

// Adds the work on a body that is not a link, except that of solver rows.
void EnergyLedger::account(EngineWorld &engine, AmbBody &owner, double h) {
  btRigidBody &body = owner.body;
  if (!body.isActive()) return;
  const SubStepStart &start = owner.start;
  const double mass = 1 / body.getInvMass(), before = owner.pose_lead;
  const btVector3 weight = weight_of(body), force = body.getTotalForce() - weight, torque = body.getTotalTorque();
  const double linear_left = std::pow(1 - body.getLinearDamping(), h),
               angular_left = std::pow(1 - body.getAngularDamping(), h);
  const double turning = rotation_energy(body, start.pose.getBasis(), start.angular_velocity);
  const btTransform &pose = body.getWorldTransform();
  const btVector3 &velocity = body.getLinearVelocity();
  const bool flew = owner.free_flight_sub_step == engine.sub_step && engine.integrator != AmbIntegrator_Euler;
  owner.pose_lead = flew ? 0 : h / 2;
  if (owner.force_share == 1) sums.contacts += weight.dot(start.linear_velocity) * (owner.pose_lead - before);
  const btVector3 &solved = owner.solved_velocity[0], &solved_omega = owner.solved_velocity[1];
  const btVector3 way = pose.getOrigin() - start.pose.getOrigin();
  if (flew) {
    const double pushed = force.dot(way);
    sums.wrenches += pushed + torque.dot(start.angular_velocity + solved_omega) * (h / 2);
    if (body.getLinearDamping() > 0) {
      sums.damping += (solved.length2() - start.linear_velocity.length2()) * mass / 2 - weight.dot(way) - pushed;
    }
    sums.damping += (angular_left * angular_left - 1) * turning;
  } else {
    const btVector3 slowed = start.linear_velocity * linear_left, turned = start.angular_velocity * angular_left;
    sums.damping += (linear_left * linear_left - 1) * start.linear_velocity.length2() * mass / 2 +
                    (angular_left * angular_left - 1) * turning + weight.dot(slowed - start.linear_velocity) * (h / 2);
    sums.wrenches += owner.force_share * h / 2 * (force.dot(slowed + solved) + torque.dot(turned + solved_omega));
    // The rest of the displacement and of the rotation is that of pseudo-velocities.
    sums.corrections += rotation_energy(body, pose.getBasis(), solved_omega) -
                        rotation_energy(body, start.pose.getBasis(), solved_omega) - weight.dot(way - solved * h);
  }
  const btVector3 &omega = body.getAngularVelocity();
  if (velocity != solved || omega != solved_omega) {
    sums.outside += energy_of(owner, velocity, omega).total() - energy_of(owner, solved, solved_omega).total();
  }
}

void EnergyLedger::after_sub_step(EngineWorld &engine, double h) {
  for_free_bodies(engine.world, [&](AmbBody &owner) { account(engine, owner, h); });
  last = free_bodies(engine);
  const MechanicalEnergy articulated = articulations(engine);
  last += articulated;
  last.elastic += springs(h);
}
