#include "articulation_rows.h"

#include "exact_rows.h"
#include "position_error.h"

#include <algorithm>

namespace {

// Coefficient of restitution of a hinge at its limits, as in Bullet; that of a slider or spring is 0.
constexpr btScalar HINGE_BOUNCE = 0.3;
// CFM as a share of the response, which regularises several rows on one coordinate.
constexpr btScalar SOFTNESS = 1e-9;
// CFM of external constraints, as a share of the response of their rows.
constexpr btScalar EXTERNAL_SOFTNESS = 1e-6;
// Largest acceleration times h^2 under fed-forward forces, rad; for a slider that angle times the distance between the
// centres of mass that it joins, m. Beyond it the motion depends too nonlinearly on the forces: after a jump of a set
// point the last force of the controller would be repeated where the controller reverses it.
constexpr btScalar MAX_FEEDFORWARD_MOTION = 0.02;
// Difference of accelerations times h^2 up to which fed-forward forces are not refuted, rad or m.
constexpr btScalar LEAST_REFUTED = 1e-6;

// Largest number of rows of the limits of a joint of several coordinates.
constexpr int MAX_ROWS = 6;

// The one that is nearer to 0 of two numbers of the same sign; else 0.
btScalar common_part(btScalar a, btScalar b) { return a * b > 0 ? (btFabs(a) < btFabs(b) ? a : b) : 0; }

}  // namespace

JointRows::JointRows(AmbArticulation &owner)
    : EngineRows(owner.multi_body.get(), nullptr, 0, -1, 3 * owner.dynamics.coordinates, false,
                 MULTIBODY_CONSTRAINT_1DOF_JOINT_MOTOR),
      articulation(owner) {
  // Maximum number of rows: two limits, a motor, a rotor, friction and two largest rates for each joint, two limits and a force
  // for each spring.
  m_numRows = 7 * owner.dynamics.coordinates + 3 * static_cast<int>(owner.springs.size());
  m_data.resize(m_numRows);
  planned.reserve(m_numRows + MAX_ROWS * owner.members.size());
  owner.dynamics.drives.reserve(m_numRows);
  owner.dynamics.distant_limits.reserve(m_numRows);
  reset();
}

void JointRows::reset() {
  acceleration.q.resize(articulation.dynamics.coordinates);
  with_feedforward.q.resize(articulation.dynamics.coordinates);
  fed_forces.resize(articulation.dynamics.coordinates);
  last_rate.assign(articulation.dynamics.coordinates, 0);
  last_change.assign(articulation.dynamics.coordinates, 0);
  planned.clear();
  forces.assign(3 * articulation.dynamics.coordinates + articulation.springs.size(), 0);
  limit_impulses.assign(articulation.dynamics.coordinates, 0);
  limit_feedforward.assign(articulation.dynamics.coordinates, 0);
  held_by_limits.assign(articulation.dynamics.coordinates, 0);
  steady_impulses.assign(articulation.dynamics.coordinates, 0);
  fed_velocity.assign(articulation.dynamics.velocity_size(), 0);
  feeds_limits = are_drives = false;
}

int JointRows::getIslandIdA() const { return articulation.members[1].collider->getIslandTag(); }

void JointRows::plan_limit(int coordinate, btScalar low, btScalar high, bool is_angle, btScalar bounce, btScalar driven,
                           btScalar h) {
  const btScalar infinity = BT_LARGE_FLOAT, most = is_angle ? MAX_RETURN_RATE : MAX_RETURN_SPEED;
  if (low > high) return;
  const btScalar q = coordinate_within(coordinate, low, high, is_angle);
  if (low == high) {
    const btScalar target = (low - q) * LIMIT_ERP / h;
    const btScalar bounded = std::max(std::min(target, most), -most);
    planned.push_back({coordinate, 0, 0, -infinity, infinity, LIMIT, 0, bounded, is_angle, limit_impulses[coordinate]});
    return;
  }
  for (btScalar side : {1, -1}) {
    // Distance to the limit (negative: violated), and speed away from it.
    const btScalar gap = side * (q - (side > 0 ? low : high));
    const btScalar speed = side * articulation.free_rate.q[coordinate];
    // The joint rebounds from the velocity before the sub-step, not from what motors give it while they press it
    // against its limit.
    const btScalar speed_before = side * articulation.rate.q[coordinate];
    const bool is_fed = side * limit_feedforward[coordinate] > 0;
    if (gap + h * std::min(speed, side * driven) >= 0 && gap >= 0 && !is_fed) continue;
    btScalar target = gap < 0 ? 0 : -gap / h;
    if (bounce > 0 && gap + h * speed_before < 0) target = std::max(target, -bounce * speed_before);
    const btScalar correction = gap < 0 ? std::min(-gap / h * LIMIT_ERP, most) : -gap / h;
    planned.push_back({coordinate, side * target, 0, side > 0 ? 0 : -infinity, side > 0 ? infinity : 0, LIMIT, 0,
                       side * correction, is_angle, side * std::max(side * limit_impulses[coordinate], btScalar(0))});
    return;
  }
}

// What would exceed the largest rate is brought back to it.
void JointRows::plan_largest_rate(const SoftMotor &motor, int coordinate, bool is_angle) {
  const btScalar rate = articulation.free_rate.q[coordinate];
  // The rows of other joints may still speed up what is slower than that after the free motion.
  constexpr btScalar NEAR = 0.5;
  if (!motor.bounds_rate() || btFabs(rate) <= NEAR * motor.max_rate) return;
  const btScalar side = rate > 0 ? 1 : -1, infinity = BT_LARGE_FLOAT;
  planned.push_back({coordinate, side * motor.max_rate, 0, side > 0 ? -infinity : 0, side > 0 ? 0 : infinity, LARGEST_RATE, 0, 0,
                     is_angle});
}

// Limits of a cone-twist or six-dof joint: rows of Bullet's constraint.
void JointRows::plan_limits_of(AmbConstraint &joint, size_t member, btScalar h) {
  btTypedConstraint &constraint = *joint.constraint;
  btTypedConstraint::btConstraintInfo1 sizes;
  constraint.getInfo1(&sizes);
  btVector3 linear[2 * MAX_ROWS], angular[2 * MAX_ROWS];
  btVector3 bounds[MAX_ROWS], errors[MAX_ROWS];
  for (int k = 0; k < 2 * MAX_ROWS; ++k) linear[k] = angular[k] = btVector3(0, 0, 0);
  for (int k = 0; k < MAX_ROWS; ++k) {
    bounds[k].setValue(-BT_LARGE_FLOAT, BT_LARGE_FLOAT, 0);
    errors[k].setZero();
  }
  btTypedConstraint::btConstraintInfo2 rows;
  rows.fps = 1 / h;
  rows.erp = LIMIT_ERP;
  rows.rowskip = sizeof(btVector3) / sizeof(btScalar);
  rows.m_J1linearAxis = &linear[0][0];
  rows.m_J2linearAxis = &linear[MAX_ROWS][0];
  rows.m_J1angularAxis = &angular[0][0];
  rows.m_J2angularAxis = &angular[MAX_ROWS][0];
  rows.m_constraintError = &errors[0][0];
  rows.cfm = &errors[0][1];
  rows.m_lowerLimit = &bounds[0][0];
  rows.m_upperLimit = &bounds[0][1];
  rows.m_numIterations = 1;
  rows.m_damping = 1;
  constraint.getInfo2(&rows);
  const ArticulationDynamics::Link &link = articulation.dynamics.links[member - 1];
  const int child = &second_of(joint) == articulation.members[member].body ? MAX_ROWS : 0;
  for (int k = 0; k < sizes.m_numConstraintRows; ++k) {
    Row row{link.coordinate, 0, 0, bounds[k][0], bounds[k][1]};
    row.is_angle = linear[k].isZero();
    // A ball joint itself holds its pivots together.
    if (!row.is_angle && link.sliding == 0) continue;
    const btScalar most = row.is_angle ? MAX_RETURN_RATE : MAX_RETURN_SPEED;
    row.correction = std::clamp(errors[k][0], -most, most);
    row.member = member;
    row.force = linear[child + k];
    row.torque = angular[child + k];
    planned.push_back(row);
  }
}

// Finds the motor of a joint: the rate that it leads to, its softness and its largest impulse in h s. Returns false if there is
// none.
bool JointRows::motor_of(const AmbConstraint &joint, btScalar h, btScalar &target, btScalar &softness,
                         btScalar &impulse) const {
  softness = 0;
  if (joint.motor.enabled) {
    target = joint.motor.velocity;
    softness = joint.motor.softness;
    impulse = joint.motor.max_force * h;
  } else if (joint.kind == Kind::Hinge) {
    auto &hinge = static_cast<btHingeConstraint &>(*joint.constraint);
    if (!hinge.getEnableAngularMotor()) return false;
    target = hinge.getMotorTargetVelocity();
    impulse = hinge.getMaxMotorImpulse();
  } else if (joint.kind == Kind::Slider) {
    auto &slider = static_cast<btSliderConstraint &>(*joint.constraint);
    if (!slider.getPoweredLinMotor()) return false;
    target = slider.getTargetLinMotorVelocity();
    impulse = slider.getMaxLinMotorForce() * h;
  } else {
    return false;
  }
  return impulse > 0;
}

void JointRows::plan_motor(const AmbConstraint &joint, int coordinate, btScalar h) {
  btScalar target, softness, impulse;
  if (motor_of(joint, h, target, softness, impulse))
    add_feedforward_row({coordinate, target, softness, -impulse, impulse, coordinate}, h);
}

void JointRows::plan_drive(int coordinate, btScalar target, btScalar softness, btScalar low, btScalar high, int source,
                           bool is_angle) {
  ArticulationDynamics::Drive drive;
  drive.coordinate = coordinate;
  drive.target = target;
  drive.softness = softness;
  drive.low = low;
  drive.high = high;
  drive.is_angle = is_angle;
  add_drive(drive, source);
}

void JointRows::add_drive(const ArticulationDynamics::Drive &drive, int source) {
  planned.push_back(
      {drive.coordinate, drive.target, drive.softness, drive.low, drive.high, source, 0, 0, drive.is_angle});
  articulation.dynamics.drives.push_back(drive);
}

void JointRows::plan_limit_drives(ArticulationDynamics::DistantLimits &distant, btScalar low, btScalar high, btScalar bounce,
                                  btScalar h) {
  if (low > high) return;
  const int coordinate = distant.coordinate;
  const bool is_angle = distant.is_angle;
  const btScalar q = coordinate_within(coordinate, low, high, is_angle);
  if (low == high) {
    plan_drive(coordinate, 0, 0, -BT_LARGE_FLOAT, BT_LARGE_FLOAT, LIMIT, is_angle);
    articulation.dynamics.drives.back().gap = q - low;
    articulation.dynamics.drives.back().is_limit = true;
    return;
  }
  // Share of the range in which limits may stop a joint that begins to move.
  constexpr btScalar NEAR_LIMIT = 0.01;
  const btScalar rate = articulation.rate.q[coordinate];
  for (btScalar side : {1, -1}) {
    const btScalar gap = side * (q - (side > 0 ? low : high)), speed = side * rate;
    if (gap > NEAR_LIMIT * (high - low) && gap + 2 * h * speed > 0) {
      (side > 0 ? distant.below : distant.above) = gap;
      continue;
    }
    btScalar target = gap < 0 ? 0 : -gap / h;
    if (bounce > 0 && gap + h * speed < 0) target = std::max(target, -bounce * speed);
    add_drive(ArticulationDynamics::limit(coordinate, is_angle, side, side * target, gap), LIMIT);
  }
}

void JointRows::plan_drives(btScalar h) {
  ArticulationDynamics &dynamics = articulation.dynamics;
  remember(h);
  planned.clear();
  dynamics.drives.clear();
  dynamics.distant_limits.clear();
  std::fill(dynamics.generalised_forces.begin(), dynamics.generalised_forces.end(), 0);
  feeds_limits = false;
  are_drives = true;
  step = h;
  for (size_t i = 1; i < articulation.members.size(); ++i) {
    const AmbConstraint &joint = *articulation.members[i].joint;
    const ArticulationDynamics::Link &link = dynamics.links[i - 1];
    if (link.freedoms() != 1) continue;
    const bool is_hinge = joint.kind == Kind::Hinge;
    btScalar target, softness, impulse;
    if (motor_of(joint, h, target, softness, impulse))
      plan_drive(link.coordinate, target, softness, -impulse, impulse, link.coordinate, is_hinge);
    // The inertia of a rotor resists any change of the rate that it has.
    if (joint.motor.armature > 0)
      plan_drive(link.coordinate, articulation.rate.q[link.coordinate], 1 / joint.motor.armature, -BT_LARGE_FLOAT,
                 BT_LARGE_FLOAT, rotor_of(link.coordinate), is_hinge);
    const btScalar friction = joint.motor.friction * h;
    if (friction > 0) plan_drive(link.coordinate, 0, 0, -friction, friction, friction_of(link.coordinate), is_hinge);
    ArticulationDynamics::DistantLimits distant{link.coordinate, is_hinge};
    for (const btScalar side : {1, -1}) {
      const btScalar most = joint.motor.max_rate;
      if (!joint.motor.bounds_rate()) break;
      if (side * articulation.rate.q[link.coordinate] > -most / 2) {
        (side > 0 ? distant.backward : distant.forward) = most;
      } else {
        add_drive(ArticulationDynamics::limit(link.coordinate, is_hinge, side, -side * most, BT_LARGE_FLOAT), LARGEST_RATE);
      }
    }
    plan_limit_drives(distant, joint.motor.low, joint.motor.high, is_hinge ? HINGE_BOUNCE : 0, h);
    if (distant.any()) dynamics.distant_limits.push_back(distant);
  }
  for (size_t i = 0; i < articulation.springs.size(); ++i) {
    const ArticulationDynamics::Spring &spring = dynamics.springs[i];
    if (spring.is_stiff)
      plan_drive(spring.coordinate, target_of(spring, h), 1 / (h * (spring.damping + h * spring.stiffness)), -BT_LARGE_FLOAT,
                 BT_LARGE_FLOAT, dynamics.coordinates + static_cast<int>(i), spring.is_angle);
    ArticulationDynamics::DistantLimits distant{spring.coordinate, spring.is_angle};
    plan_limit_drives(distant, articulation.springs[i].low, articulation.springs[i].high, 0, h);
    if (distant.any()) dynamics.distant_limits.push_back(distant);
  }
}

void JointRows::take_drives() {
  const ArticulationDynamics::DriveList &drives = articulation.dynamics.drives;
  // Limits that were distant.
  for (size_t i = planned.size(); i < drives.size(); ++i) {
    const ArticulationDynamics::Drive &limit = drives[i];
    const int source = limit.bounds_rate() ? LARGEST_RATE : LIMIT;
    planned.push_back({limit.coordinate, limit.target, 0, limit.low, limit.high, source, 0, 0, limit.is_angle});
  }
  for (size_t i = 0; i < planned.size(); ++i) {
    const bool is_limit = planned[i].source < 0;
    planned[i].feedforward = is_limit ? 0 : drives[i].mean_impulse;
    m_data[i] = is_limit ? drives[i].mean_impulse : 0;
  }
}

// Angle that is wrapped to within pi of the centre of its limits, or displacement.
btScalar JointRows::coordinate_within(int coordinate, btScalar low, btScalar high, bool is_angle) const {
  const btScalar q = articulation.position.q[coordinate], centre = (low + high) / 2;
  return is_angle ? centre + ArticulationDynamics::wrapped(q - centre) : q;
}

// Keeps the rates at the beginning of this sub-step, how they changed in the last one, and the forces and impulses of that.
void JointRows::remember(btScalar h) {
  for (size_t k = 0; k < last_rate.size(); ++k) {
    last_change[k] = step > 0 ? (articulation.rate.q[k] - last_rate[k]) * (h / step) : 0;
    last_rate[k] = articulation.rate.q[k];
  }
  std::fill(forces.begin(), forces.end(), 0);
  // What holds a joint at its limit is fed forward, and what stops it there is not.
  steady_impulses = limit_impulses;
  std::fill(limit_impulses.begin(), limit_impulses.end(), 0);
  for (size_t i = 0; i < planned.size(); ++i) {
    if (planned[i].source >= 0) {
      forces[planned[i].source] = (planned[i].feedforward + m_data[i]) / step;
    } else if (planned[i].source == LIMIT && planned[i].member == 0 && m_data[i] != 0) {
      limit_impulses[planned[i].coordinate] = m_data[i];
    }
  }
}

void JointRows::add_feedforward_row(Row row, btScalar h) {
  row.feedforward = std::min(std::max(forces[row.source] * h, row.low), row.high);
  if (!(btFabs(row.feedforward) < BT_LARGE_FLOAT)) row.feedforward = 0;
  articulation.dynamics.generalised_forces[row.coordinate] += row.feedforward / h;
  planned.push_back(row);
}

btScalar JointRows::target_of(const ArticulationDynamics::Spring &spring, btScalar h) const {
  const btScalar push = spring.sign * spring.stiffness * spring.displacement(articulation.position.q[spring.coordinate]);
  return -push / (spring.damping + h * spring.stiffness);
}

void JointRows::plan_motors(btScalar h) {
  remember(h);
  are_drives = false;
  articulation.dynamics.drives.clear();
  articulation.dynamics.distant_limits.clear();
  std::fill(limit_feedforward.begin(), limit_feedforward.end(), 0);
  feeds_limits = false;
  // What presses a joint against its limit is part of the free motion, which would turn the joint beyond it.
  std::fill(held_by_limits.begin(), held_by_limits.end(), 0);
  for (size_t i = 0; i < planned.size(); ++i) {
    if (planned[i].source != LIMIT || planned[i].member > 0 || m_data[i] == 0) continue;
    const int k = planned[i].coordinate;
    // A motor may press a joint with a million times the force that moves it: the force of the limit is subtracted from it.
    const auto drives = [&](const Row &row) {
      return row.source >= 0 && row.source < articulation.dynamics.coordinates && row.coordinate == k;
    };
    const auto drive = std::find_if(planned.begin(), planned.end(), drives);
    if (drive != planned.end()) {
      forces[drive->source] += m_data[i] / step;
      held_by_limits[k] += m_data[i] / step * h;
    } else {
      limit_feedforward[k] += common_part(m_data[i], steady_impulses[k]) / step * h;
      held_by_limits[k] = limit_feedforward[k];
    }
  }
  step = h;
  planned.clear();
  Vector<btScalar> &generalised_forces = articulation.dynamics.generalised_forces;
  for (size_t k = 0; k < generalised_forces.size(); ++k) {
    feeds_limits = feeds_limits || limit_feedforward[k] != 0;
    generalised_forces[k] = limit_feedforward[k] / h;
  }
  for (size_t i = 1; i < articulation.members.size(); ++i) {
    const AmbConstraint &joint = *articulation.members[i].joint;
    const ArticulationDynamics::Link &link = articulation.dynamics.links[i - 1];
    if (link.freedoms() != 1) continue;
    plan_motor(joint, link.coordinate, h);
    if (joint.motor.armature > 0)
      add_feedforward_row({link.coordinate, articulation.rate.q[link.coordinate], 1 / joint.motor.armature, -BT_LARGE_FLOAT,
                           BT_LARGE_FLOAT, rotor_of(link.coordinate)}, h);
    const btScalar friction = joint.motor.friction * h;
    if (friction > 0) add_feedforward_row({link.coordinate, 0, 0, -friction, friction, friction_of(link.coordinate)}, h);
  }
  // Positions are corrected by contacts and external constraints; limits of other coordinates do so in rare cases.
  const bool is_corrected = articulation.has_contact || articulation.external_constraint_count > 0;
  for (size_t i = 0; i < articulation.springs.size(); ++i) {
    const ArticulationDynamics::Spring &spring = articulation.dynamics.springs[i];
    const int coordinate = spring.coordinate;
    const btScalar give = spring.damping + h * spring.stiffness;
    const int source = articulation.dynamics.coordinates + static_cast<int>(i);
    if (!spring.is_stiff) {
      // No impulse: the spring only resists corrections.
      if (spring.resists_corrections && is_corrected) planned.push_back({coordinate, 0, 1 / (h * give), 0, 0, source});
      continue;
    }
    // The implicit force -k (x + h q') - d q' at the end of the sub-step, written as a soft row.
    add_feedforward_row({coordinate, target_of(spring, h), 1 / (h * give), -BT_LARGE_FLOAT, BT_LARGE_FLOAT, source}, h);
  }
  drop_wrong_feedforward(h);
}

// Drops all fed-forward forces if one of them accelerates the articulation too much, or if the acceleration of the last
// sub-step refutes them: the forces of a chain balance each other.
void JointRows::drop_wrong_feedforward(btScalar h) {
  ArticulationDynamics &dynamics = articulation.dynamics;
  const auto has_feedforward = [](const Row &row) { return row.feedforward != 0; };
  if (!feeds_limits && std::none_of(planned.begin(), planned.end(), has_feedforward)) return;
  dynamics.update_poses(articulation.position);
  dynamics.update_velocities(articulation.rate);
  dynamics.accelerate(articulation.position, articulation.rate, acceleration);
  bool is_large = false;
  for (const ArticulationDynamics::Link &link : dynamics.links) {
    for (int k = 0; k < link.freedoms(); ++k) {
      const btScalar scale = k < link.sliding ? link.arm.length() + link.pivot.length() : 1;
      // The comparison is false for NaN, which counts as large.
      const btScalar motion = btFabs(acceleration.q[link.coordinate + k]) * h * h;
      is_large = is_large || !(motion <= MAX_FEEDFORWARD_MOTION * scale);
    }
  }
  if (!is_large && !is_refuted(h)) return;
  for (Row &row : planned) row.feedforward = 0;
  std::fill(limit_feedforward.begin(), limit_feedforward.end(), 0);
  std::fill(held_by_limits.begin(), held_by_limits.end(), 0);
  feeds_limits = false;
  std::fill(dynamics.generalised_forces.begin(), dynamics.generalised_forces.end(), 0);
}

// Whether a coordinate with a fed-forward force accelerated in the last sub-step as it does without all these forces
// rather than with them. Then contacts or external constraints balance them, which are not part of the free motion: they
// would have to stop what the forces accelerate.
bool JointRows::is_refuted(btScalar h) {
  ArticulationDynamics &dynamics = articulation.dynamics;
  Vector<btScalar> &forces_on = dynamics.generalised_forces;
  const auto misses = [&](const ArticulationDynamics::Rate &found, int k) {
    return btFabs(found.q[k] * h - last_change[k]) * h;
  };
  bool any = false;
  for (int k = 0; k < dynamics.coordinates; ++k)
    any = any || (forces_on[k] != 0 && misses(acceleration, k) > LEAST_REFUTED);
  if (!any) return false;
  std::swap(with_feedforward, acceleration);
  std::swap(fed_forces, forces_on);
  std::fill(forces_on.begin(), forces_on.end(), 0);
  dynamics.accelerate(articulation.position, articulation.rate, acceleration);
  std::swap(fed_forces, forces_on);
  bool refuted = false;
  for (int k = 0; k < dynamics.coordinates; ++k)
    refuted = refuted || (forces_on[k] != 0 && misses(with_feedforward, k) > LEAST_REFUTED + misses(acceleration, k));
  return refuted;
}

void JointRows::plan_limits(btScalar h) {
  for (size_t i = 1; i < articulation.members.size(); ++i) {
    AmbConstraint &joint = *articulation.members[i].joint;
    const ArticulationDynamics::Link &link = articulation.dynamics.links[i - 1];
    if (joint.kind == Kind::ConeTwist || joint.kind == Kind::SixDof) plan_limits_of(joint, i, h);
    if (link.freedoms() != 1) continue;
    const bool is_hinge = joint.kind == Kind::Hinge;
    plan_largest_rate(joint.motor, link.coordinate, is_hinge);
    plan_limit(link.coordinate, joint.motor.low, joint.motor.high, is_hinge, is_hinge ? HINGE_BOUNCE : 0, 0, h);
  }
  for (size_t i = 0; i < articulation.springs.size(); ++i) {
    const ArticulationDynamics::Spring &spring = articulation.dynamics.springs[i];
    const btScalar driven = spring.is_stiff ? target_of(spring, h) : 0;
    const btScalar low = articulation.springs[i].low, high = articulation.springs[i].high;
    plan_limit(spring.coordinate, low, high, spring.is_angle, 0, driven, h);
  }
}

bool JointRows::rates_by_limits(ArticulationDynamics::Rate &fed) {
  if (!feeds_limits) return false;
  const ArticulationDynamics &dynamics = articulation.dynamics;
  fed_velocity.assign(dynamics.velocity_size(), 0);
  for (int k = 0; k < dynamics.coordinates; ++k) fed_velocity[6 + k] = limit_feedforward[k];
  dynamics.normalise(fed_velocity.data());
  dynamics.rates_of(fed_velocity.data(), fed);
  return true;
}

bool JointRows::hit_limit() const {
  for (size_t i = 0; i < planned.size(); ++i) {
    if (planned[i].source != LIMIT || m_data[i] == 0) continue;
    // An impulse that was fed forward held the joint during the free motion, too.
    if (planned[i].member > 0 || held_by_limits[planned[i].coordinate] == 0) return true;
  }
  return false;
}

bool JointRows::hit_sliding_limit(size_t member) const {
  const ArticulationDynamics::Link &link = articulation.dynamics.links[member - 1];
  for (size_t i = 0; i < planned.size(); ++i) {
    if (planned[i].source != LIMIT || planned[i].is_angle || m_data[i] == 0) continue;
    const int k = planned[i].coordinate - link.coordinate;
    if (planned[i].member > 0 ? planned[i].member == member : k >= 0 && k < link.sliding) return true;
  }
  return false;
}

btScalar JointRows::spring_impulse(size_t spring) const {
  for (size_t i = 0; i < planned.size(); ++i) {
    if (planned[i].source == articulation.dynamics.coordinates + static_cast<int>(spring))
      return planned[i].feedforward + m_data[i];
  }
  return 0;
}

void JointRows::createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                                     const btContactSolverInfo &info) {
  if (are_drives) return;
  for (size_t i = 0; i < planned.size(); ++i) {
    const Row &plan = planned[i];
    btMultiBodySolverConstraint &row = new_row(rows, static_cast<int>(i), data);
    const RowMotion motion = plan.member == 0
                                 ? act_on_coordinate(row, articulation, plan.coordinate, data)
                                 : act_between(row, articulation, plan.member, plan.force, plan.torque, data);
    // A stiff spring or controller on the coordinate of a limit reduces its response, and the limit must hold it, too.
    btScalar response = motion.response;
    for (const Row &drive : planned) {
      if (plan.source < 0 && plan.member == 0 && drive.coordinate == plan.coordinate && drive.softness > 0)
        response = std::min(response, drive.softness);
    }
    const btScalar softness = std::max(plan.softness, response * SOFTNESS), whole = motion.response + softness;
    row.m_lowerLimit = plan.low - plan.feedforward;
    row.m_upperLimit = plan.high - plan.feedforward;
    row.m_jacDiagABInv = whole > 0 ? 1 / whole : 0;
    row.m_cfm = softness * row.m_jacDiagABInv;
    row.m_rhs = (plan.target - plan.softness * plan.feedforward - motion.velocity) * row.m_jacDiagABInv;
    row.m_rhsPenetration = plan.correction * row.m_jacDiagABInv;
    internalSetAppliedImpulse(static_cast<int>(i), 0);
  }
}

ExternalConstraintRows::ExternalConstraintRows(AmbConstraint &owner, AmbBody &link_body, const btTransform &link_frame,
                                               AmbBody &other_body, const btTransform &frame_of_other, int rows)
    : EngineRows(link_body.articulation->multi_body.get(),
                 other_body.articulation ? other_body.articulation->multi_body.get() : nullptr, link_body.member - 1,
                 other_body.articulation ? other_body.member - 1 : -1, rows, false, MULTIBODY_CONSTRAINT_FIXED),
      constraint(owner),
      link(link_body),
      other(other_body),
      frame(link_frame),
      other_frame(frame_of_other) {
  m_data.resize(rows);
  reset();
}

void ExternalConstraintRows::reset() {
  for (int i = 0; i < m_numRows; ++i) m_data[i] = 0;
}

void ExternalConstraintRows::createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                                                  const btContactSolverInfo &info) {
  const btTransform a = link.body.getWorldTransform() * frame, b = other.body.getWorldTransform() * other_frame;
  const btVector3 gap = a.getOrigin() - b.getOrigin();
  const btQuaternion turn = (a.getRotation() * b.getRotation().inverse()).normalized();
  btVector3 angle(0, 0, 0);
  const btScalar half = btVector3(turn.x(), turn.y(), turn.z()).length();
  if (half > 0)
    angle = btVector3(turn.x(), turn.y(), turn.z()) / half * std::remainder(2 * btAtan2(half, turn.w()), 2 * SIMD_PI);
  // No warm start by Bullet, which would apply the stored impulses to the articulation only, not to a rigid body at the
  // other end.
  for (int i = 0; i < m_numRows; ++i) guesses[i] = m_data[i];
  reset();
  const bool is_dynamic = !other.articulation && other.body.getInvMass() > 0;
  JointMotion motion;
  const btVector3 arm_a = a.getOrigin() - link.body.getWorldTransform().getOrigin();
  const btVector3 arm_b = b.getOrigin() - other.body.getWorldTransform().getOrigin();
  for (int i = 0; i < 3; ++i) {
    btVector3 normal(0, 0, 0);
    normal[i] = 1;
    motion.add_row(normal, arm_a.cross(normal), -normal, -arm_b.cross(normal));
  }
  motion.finish(link.body.getLinearVelocity(), link.body.getAngularVelocity(), other.body.getLinearVelocity(),
                other.body.getAngularVelocity(), info.m_timeStep);
  for (int i = 0; i < m_numRows; ++i) {
    btMultiBodySolverConstraint &row = new_row(rows, i, data);
    btVector3 linear(0, 0, 0), angular(0, 0, 0);
    (i < 3 ? linear : angular)[i % 3] = 1;
    RowMotion motion_of_row =
        act_on_member(row, 0, *link.articulation, link.member, linear, angular + arm_a.cross(linear), data);
    const btVector3 back = -linear, turn_back = -(angular + arm_b.cross(linear));
    RowMotion part;
    if (other.articulation) {
      part = act_on_member(row, 1, *other.articulation, other.member, back, turn_back, data);
    } else if (is_dynamic) {
      part = act_on_body(row, 1, other.body.getCompanionId(), back, turn_back, *data.m_solverBodyPool);
    }
    const btScalar whole = motion_of_row.response + part.response;
    row.m_jacDiagABInv = whole > SIMD_EPSILON ? 1 / whole : 0;
    row.m_rhs = -(motion_of_row.velocity + part.velocity) * row.m_jacDiagABInv;
    const btScalar error = i < 3 ? gap[i] : angle[i - 3];
    errors[i] = error;
    const btScalar target = -error * info.m_erp / info.m_timeStep;
    biases[i] = i < 3 ? motion.linear_target(-linear) : 0;
    row.m_rhs += biases[i] * row.m_jacDiagABInv;
    row.m_rhsPenetration = target * row.m_jacDiagABInv;
    // CFM regularises rows that the articulation cannot move, and redundant rows.
    const btScalar share = 1 / (1 + EXTERNAL_SOFTNESS);
    row.m_rhs *= share;
    row.m_rhsPenetration = row.m_rhsPenetration * share;
    row.m_jacDiagABInv *= share;
    row.m_cfm = EXTERNAL_SOFTNESS * share;
  }
}

void ExternalConstraintRows::write_feedback(btScalar h) {
  if (!constraint.feedback) return;
  btVector3 force(m_data[0] / h, m_data[1] / h, m_data[2] / h), torque(0, 0, 0);
  if (m_numRows > 3) torque = btVector3(m_data[3] / h, m_data[4] / h, m_data[5] / h);
  const btVector3 arm = link.body.getWorldTransform().getBasis() * frame.getOrigin();
  const btVector3 other_arm = other.body.getWorldTransform().getBasis() * other_frame.getOrigin();
  const bool link_is_a = &first_of(constraint) == &link;
  btJointFeedback &feedback = *constraint.feedback;
  (link_is_a ? feedback.m_appliedForceBodyA : feedback.m_appliedForceBodyB) = force;
  (link_is_a ? feedback.m_appliedTorqueBodyA : feedback.m_appliedTorqueBodyB) = torque + arm.cross(force);
  (link_is_a ? feedback.m_appliedForceBodyB : feedback.m_appliedForceBodyA) = -force;
  (link_is_a ? feedback.m_appliedTorqueBodyB : feedback.m_appliedTorqueBodyA) = -(torque + other_arm.cross(force));
}

LinkDrive::LinkDrive(AmbBody &body)
    : EngineRows(body.articulation->multi_body.get(), nullptr, body.member - 1, -1, 6, false,
                 MULTIBODY_CONSTRAINT_FIXED),
      link(body) {
  m_data.resize(6);
  for (int i = 0; i < 6; ++i) m_data[i] = 0;
}

void LinkDrive::createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                                     const btContactSolverInfo &) {
  if (!enabled) return;
  for (int i = 0; i < 6; ++i) {
    btMultiBodySolverConstraint &row = new_row(rows, i, data);
    btVector3 linear(0, 0, 0), angular(0, 0, 0);
    (i < 3 ? linear : angular)[i % 3] = 1;
    const RowMotion motion = act_on_member(row, 0, *link.articulation, link.member, linear, angular, data);
    // A direction in which the articulation cannot move has no response and no row.
    if (motion.response <= SIMD_EPSILON) continue;
    const btScalar whole = motion.response + softness[i / 3];
    row.m_jacDiagABInv = 1 / whole;
    row.m_cfm = softness[i / 3] / whole;
    row.m_rhs = (velocity[i] - motion.velocity) / whole;
  }
}
