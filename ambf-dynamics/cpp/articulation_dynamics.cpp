#include "articulation_dynamics.h"

#include "solve_three.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <numeric>

namespace {

// Change of the internal energy, and of the angular momentum of a free base, that is tolerated as truncation error of a
// step: as a share of the energy and of the work in the step, and of the angular momenta of all bodies.
constexpr btScalar MAX_GROWTH = 1e-4;
// Share of the length of a row for z that is rounding, beside couplings.
constexpr btScalar COUPLED_ROUNDING = 1e-10;

// [v] times a matrix: each column of the result is v x the column.
btMatrix3x3 cross_matrix(const btVector3 &v, const btMatrix3x3 &m) {
  const btVector3 x = m[2] * v.y() - m[1] * v.z();
  const btVector3 y = m[0] * v.z() - m[2] * v.x();
  const btVector3 z = m[1] * v.x() - m[0] * v.y();
  return btMatrix3x3(x.x(), x.y(), x.z(), y.x(), y.y(), y.z(), z.x(), z.y(), z.z());
}

void subtract_outer(btMatrix3x3 &m, const btVector3 &a, const btVector3 &b, btScalar factor) {
  for (int row = 0; row < 3; ++row) m[row] -= b * (a[row] * factor);
}

btMatrix3x3 scaled_rotation(const btMatrix3x3 &rotation, const btVector3 &diagonal) {
  return rotation.scaled(diagonal).timesTranspose(rotation);
}

btVector3 transpose_times(const btMatrix3x3 &m, const btVector3 &v) { return m[0] * v[0] + m[1] * v[1] + m[2] * v[2]; }

btQuaternion spin_of(const btVector3 &omega, const btQuaternion &rotation) {
  return btQuaternion(omega.x(), omega.y(), omega.z(), 0) * rotation * btScalar(0.5);
}

// Turns by h times an angular velocity, by the exponential map.
void turn_by(btQuaternion &rotation, const btVector3 &omega, btScalar h) {
  const btScalar speed = omega.length();
  if (speed * h == 0) return;
  rotation = btQuaternion(omega / speed, speed * h) * rotation;
  rotation.normalize();
}

AmbAbaMotion motion_of(const ArticulationDynamics::Position &position, const ArticulationDynamics::Rate &rate) {
  return {position.rotation, position.origin.m_floats, position.q.data(), reinterpret_cast<const double *>(position.balls.data()),
          rate.angular.m_floats, rate.linear.m_floats, rate.q.data()};
}

AmbAbaRates rates_to(ArticulationDynamics::Rate &rate) { return {rate.angular.m_floats, rate.linear.m_floats, rate.q.data()}; }

btVector3 three_of(const Vector<btScalar> &values, int first) {
  return btVector3(values[first], values[first + 1], values[first + 2]);
}

void advance(ArticulationDynamics::Rate &to, const ArticulationDynamics::Rate &from, btScalar h,
             const ArticulationDynamics::Rate &slope) {
  to.angular = from.angular + slope.angular * h;
  to.linear = from.linear + slope.linear * h;
  for (size_t i = 0; i < to.q.size(); ++i) to.q[i] = from.q[i] + h * slope.q[i];
}

}  // namespace

const AmbAbaTable *aba_table = nullptr;

void ArticulationDynamics::add(const Body &body, int parent, JointType type, const btVector3 &axis,
                               const btTransform &joint_in_parent, const btTransform &joint_in_child) {
  Link link;
  link.parent = parent;
  link.type = type;
  link.sliding = sliding_coordinates_of(type);
  link.turning = turning_coordinates_of(type);
  link.coordinate = link.freedoms() == 0 ? -1 : coordinates;
  coordinates += link.freedoms();
  link.ball = link.turning == 3 ? balls++ : -1;
  link.axis = joint_in_parent.getBasis() * axis;
  link.pivot = joint_in_parent.getOrigin();
  link.rotation = joint_in_parent.getBasis().timesTranspose(joint_in_child.getBasis());
  link.arm = -joint_in_child.getOrigin();
  link.turn = cross_matrix(link.axis, link.rotation);
  link.turn2 = cross_matrix(link.axis, link.turn);
  links.push_back(link);
  bodies.push_back(body);
}

void ArticulationDynamics::finish() {
  const size_t n = bodies.size();
  rotations.resize(n, btMatrix3x3::getIdentity());
  origins.resize(n, btVector3(0, 0, 0));
  linear.resize(n, btVector3(0, 0, 0));
  angular.resize(n, btVector3(0, 0, 0));
  arms.resize(n, btVector3(0, 0, 0));
  axes.resize(n, btVector3(0, 0, 0));
  assert(aba_table->link_size == sizeof(Link) && aba_table->body_size == sizeof(Body));
  work.resize(n * aba_table->work_size / sizeof(btVector3), btVector3(0, 0, 0));
  efforts.resize(coordinates);
  generalised_forces.resize(coordinates);
  unbounded_forces.resize(coordinates);
  driven.resize(coordinates);
  given_by.resize(coordinates, -1);
  rest_impulse.resize(coordinates);
  parent_component.resize(velocity_size());
  for (int k = 0; k < 6; ++k) parent_component[k] = k - 1;
  for (const Link &link : links) {
    if (link.coordinate < 0) continue;
    int parent = link.parent;
    while (parent > 0 && links[parent - 1].coordinate < 0) parent = links[parent - 1].parent;
    const auto last_of = [](const Link &other) { return 6 + other.coordinate + other.freedoms() - 1; };
    const int first = 6 + link.coordinate;
    parent_component[first] = parent > 0 ? last_of(links[parent - 1]) : fixed_base ? -1 : 5;
    for (int k = 1; k < link.freedoms(); ++k) parent_component[first + k] = first + k - 1;
  }
  factor.resize(velocity_size() * velocity_size());
  inverse_diagonal.resize(velocity_size());
  stage.q.resize(coordinates);
  stage.balls.resize(balls);
  stage_rate.q.resize(coordinates);
  for (int i = 0; i < 4; ++i) {
    slopes[i].q.resize(coordinates);
    speeds[i].q.resize(coordinates);
    ball_spins[i].resize(balls);
  }
}

AmbAbaTree ArticulationDynamics::tree() const {
  auto &self = const_cast<ArticulationDynamics &>(*this);
  const auto numbers = [](Vector<btVector3> &vectors) { return vectors[0].m_floats; };
  return {static_cast<int>(links.size()), coordinates, balls, fixed_base, splits_damping, links.data(), bodies.data(),
          self.rotations[0][0].m_floats, numbers(self.origins), numbers(self.linear), numbers(self.angular), numbers(self.arms),
          numbers(self.axes), self.work.data()};
}

void ArticulationDynamics::update_poses(const Position &position) {
  const AmbAbaTree all = tree();
  const AmbAbaMotion motion = motion_of(position, part_rate);
  aba_table->update_poses(&all, &motion);
}

void ArticulationDynamics::update_velocities(const Rate &rate) {
  const AmbAbaTree all = tree();
  const AmbAbaMotion motion = motion_of(part, rate);
  aba_table->update_velocities(&all, &motion);
}

btScalar ArticulationDynamics::Spring::displacement(btScalar q) const {
  // Wrapped half a turn away from the rest position, where the elastic energy is continuous.
  const btScalar x = sign * q + offset - rest;
  return is_angle ? wrapped(x) : x;
}

void ArticulationDynamics::accelerate(const Position &position, const Rate &rate, Rate &acceleration, bool is_placed) {
  efforts = generalised_forces;
  if (drive_step > 0) add_drives();
  if (!couplings.empty() && !is_placed) {
    update_poses(position);
    update_velocities(rate);
    is_placed = true;
  }
  for (const Spring &spring : springs) {
    if (spring.is_stiff) continue;
    const int i = spring.coordinate;
    efforts[i] -= spring.sign * spring.stiffness * spring.displacement(position.q[i]) + spring.damping * rate.q[i];
  }
  const AmbAbaTree all = tree();
  const AmbAbaMotion motion = motion_of(position, rate);
  const AmbAbaRates found = rates_to(acceleration);
  aba_table->accelerate(&all, &motion, efforts.data(), drive_step > 0 ? driven.data() : nullptr, is_placed, &found);
  if (!couplings.empty()) couple(acceleration);
}

void ArticulationDynamics::project(const btVector3 *linear_wanted, const btVector3 *angular_wanted, Rate &rate) {
  // Sets the motion subspaces of the joints; with rates of 0 there is no bias.
  for (btScalar &q : stage_rate.q) q = 0;
  stage_rate.angular.setZero();
  stage_rate.linear.setZero();
  if (fixed_base) {
    stage_rate.angular = rate.angular;
    stage_rate.linear = rate.linear;
  }
  update_velocities(stage_rate);
  std::fill(efforts.begin(), efforts.end(), 0);
  const AmbAbaTree all = tree();
  const AmbAbaRates found = rates_to(rate);
  aba_table->project(&all, linear_wanted->m_floats, angular_wanted->m_floats, efforts.data(), &found);
  if (!couplings.empty()) couple(rate);
  if (!fixed_base) return;
  rate.angular = stage_rate.angular;
  rate.linear = stage_rate.linear;
}

// One step of a power iteration for the fastest vibration mode about the present motion. slopes[0] must be the present
// acceleration.
void ArticulationDynamics::update_fastest_mode(const Position &at, const Rate &rate) {
  // Displacement of the finite difference, rad or m.
  constexpr btScalar shift = 1e-6;
  stage_rate.angular.setZero();
  stage_rate.linear.setZero();
  stage_rate.q = mode;
  stage = at;
  advance_position(stage, shift, stage_rate);
  update_poses(stage);
  update_velocities(rate);
  accelerate(stage, rate, stage_rate);
  btScalar square = 0;
  for (int k = 0; k < coordinates; ++k) {
    stage_rate.q[k] -= slopes[0].q[k];
    square += stage_rate.q[k] * stage_rate.q[k];
  }
  const btScalar length = btSqrt(square);
  stiffness = length / shift;
  if (!(length > 0 && length < BT_LARGE_FLOAT)) return;
  for (int k = 0; k < coordinates; ++k) mode[k] = stage_rate.q[k] / length;
}

btScalar ArticulationDynamics::kinetic_energy() const {
  btScalar sum = 0;
  for (size_t i = fixed_base ? 1 : 0; i < bodies.size(); ++i) {
    const btVector3 local = transpose_times(rotations[i], angular[i]);
    sum += bodies[i].mass * linear[i].length2() + local.dot(local * bodies[i].inertia);
  }
  return sum / 2;
}

btVector3 ArticulationDynamics::linear_momentum() const {
  btVector3 sum(0, 0, 0);
  for (size_t i = 0; i < bodies.size(); ++i) sum += linear[i] * bodies[i].mass;
  return sum;
}

btScalar ArticulationDynamics::mass() const {
  btScalar sum = 0;
  for (const Body &body : bodies) sum += body.mass;
  return sum;
}

btScalar ArticulationDynamics::internal_energy() const {
  if (!fixed_base) return std::max(kinetic_energy() - linear_momentum().length2() / (2 * mass()), btScalar(0));
  if (!is_carried()) return kinetic_energy();
  btScalar sum = 0;
  for (size_t i = 1; i < bodies.size(); ++i) {
    const btVector3 local = transpose_times(rotations[i], angular[i] - carried_angular());
    sum += bodies[i].mass * (linear[i] - carried_linear(i)).length2() + local.dot(local * bodies[i].inertia);
  }
  return sum / 2;
}

// Power of the forces on all bodies that a moved base carries, W: it does not change the internal energy.
btScalar ArticulationDynamics::carrying_power() const {
  if (!is_carried()) return 0;
  btScalar power = 0;
  for (size_t i = 1; i < bodies.size(); ++i)
    power += bodies[i].force.dot(carried_linear(i)) + bodies[i].torque.dot(carried_angular());
  return power;
}

// Kinetic energy of all bodies in a rigid turn with a base that is turned, J. Its change with the joints is the work of
// the centrifugal forces on the motion relative to the base; those of Coriolis do none.
btScalar ArticulationDynamics::centrifugal_energy() const {
  btScalar sum = 0;
  for (size_t i = 1; i < bodies.size(); ++i) {
    const btVector3 local = transpose_times(rotations[i], angular[0]);
    sum += bodies[i].mass * angular[0].cross(origins[i] - origins[0]).length2() + local.dot(local * bodies[i].inertia);
  }
  return sum / 2;
}

btVector3 ArticulationDynamics::total_force() const {
  btVector3 sum(0, 0, 0);
  for (const Body &body : bodies) sum += body.force;
  return sum;
}

btVector3 ArticulationDynamics::mass_centre() const {
  btVector3 sum(0, 0, 0);
  for (size_t i = 0; i < bodies.size(); ++i) sum += origins[i] * bodies[i].mass;
  return sum / mass();
}

// Rates of change of the momentum about a point by the external forces and torques and by the drag that the equations of
// motion hold, N and N m.
ArticulationDynamics::Momentum ArticulationDynamics::wrench(const btVector3 &about) const {
  Momentum sum;
  for (size_t i = 0; i < bodies.size(); ++i) {
    const Body &body = bodies[i];
    btVector3 force = body.force, torque = body.torque;
    if (!splits_damping) {
      force -= linear[i] * (body.mass * body.linear_drag);
      torque -= angular_momentum(i) * body.angular_drag;
    }
    sum.linear += force;
    sum.angular += torque + (origins[i] - about).cross(force);
  }
  return sum;
}

btScalar ArticulationDynamics::drag_power() const {
  if (fixed_base && !is_carried()) return 0;
  btScalar power = 0;
  if (fixed_base) {
    for (size_t i = 1; i < bodies.size(); ++i) {
      power -= bodies[i].mass * bodies[i].linear_drag * linear[i].dot(linear[i] - carried_linear(i)) +
               bodies[i].angular_drag * angular_momentum(i).dot(angular[i] - carried_angular());
    }
    return std::max(power, btScalar(0));
  }
  const btVector3 whole = linear_momentum() / mass();
  for (size_t i = 0; i < bodies.size(); ++i) {
    power -= bodies[i].mass * bodies[i].linear_drag * linear[i].dot(linear[i] - whole);
  }
  return std::max(power, btScalar(0));
}

void ArticulationDynamics::scale_internal_velocity(btScalar share, Rate &rate) {
  for (btScalar &q : rate.q) q *= share;
  if (fixed_base) return;
  // The velocity of the centre of mass is kept.
  const btVector3 velocity = linear_momentum() / mass();
  rate.angular *= share;
  rate.linear = velocity + (rate.linear - velocity) * share;
}

btScalar ArticulationDynamics::elastic_energy(const Position &at) const {
  btScalar sum = 0;
  for (const Spring &spring : springs) {
    if (spring.is_stiff) continue;
    const btScalar x = spring.displacement(at.q[spring.coordinate]);
    sum += spring.stiffness * x * x;
  }
  return sum / 2;
}

btScalar ArticulationDynamics::work_at_rate(btScalar h, const Position &at, const Rate &rate) const {
  btScalar power = 0;
  for (size_t i = 0; i < bodies.size(); ++i) {
    power += bodies[i].force.dot(linear[i] - carried_linear(i)) + bodies[i].torque.dot(angular[i] - carried_angular());
  }
  for (int k = 0; k < coordinates; ++k) power += generalised_forces[k] * rate.q[k];
  return h * power + elastic_energy(at);
}

// Bound of the rounding error of the work of forces, efforts and springs in a step at this position, J: it is the sum of
// differences of positions, of elastic energies and of displacements of springs, which nearly cancel at rest.
btScalar ArticulationDynamics::rounding_of_work(const Position &at) const {
  btScalar sum = 0;
  for (size_t i = 0; i < bodies.size(); ++i) sum += bodies[i].force.length() * start_origins[i].length();
  for (int k = 0; k < coordinates; ++k) sum += btFabs(generalised_forces[k] * at.q[k]);
  for (const Spring &spring : springs) {
    if (spring.is_stiff) continue;
    const btScalar q = at.q[spring.coordinate], x = btFabs(spring.displacement(q));
    sum += spring.stiffness * x * (x + btFabs(q) + btFabs(spring.offset) + btFabs(spring.rest));
  }
  constexpr btScalar OPERATIONS = 8;
  return OPERATIONS * SIMD_EPSILON * sum;
}

btScalar ArticulationDynamics::fastest_rotation(const Rate &rate) const {
  btScalar square = 0;
  for (const btVector3 &omega : angular) square = std::max(square, omega.length2());
  btScalar fastest = btSqrt(square);
  return std::max(fastest, fastest_coordinate(rate));
}

void ArticulationDynamics::bound_rotation(Rate &rate, btScalar most) {
  // Impulses on one coordinate after the other disturb those before.
  constexpr int MAX_ROUNDS = 4;
  for (int round = 0; fastest_coordinate(rate) > most; ++round) {
    if (round == MAX_ROUNDS) {
      scale_internal_velocity(most / fastest_coordinate(rate), rate);
      update_velocities(rate);
      break;
    }
    factor_inertia();
    for (const Link &link : links) {
      const btScalar speed = joint_speed(link, rate);
      if (!(speed > most)) continue;
      for (int k = link.sliding; k < link.freedoms(); ++k) {
        const btScalar component = btFabs(rate.q[link.coordinate + k]) * (most / speed);
        stop_at(link.coordinate + k, component, rate);
      }
    }
    update_velocities(rate);
  }
  const btScalar base = rate.angular.length();
  if (fixed_base || !(base > most)) return;
  scale_internal_velocity(most / base, rate);
  update_velocities(rate);
}

void ArticulationDynamics::bound_acceleration(btScalar h, const Position &from, const Rate &rate, Rate &acceleration) {
  // Forces on one coordinate after the other disturb those before.
  constexpr int MAX_ROUNDS = 4;
  const btScalar most = SIMD_HALF_PI / (h * h);
  if (!(fastest_undriven(acceleration) > most)) return;
  // Fast motion accelerates joints, too, which smaller steps resolve: only what forces do at rest counts here.
  for (btScalar &q : stage_rate.q) q = 0;
  stage_rate.angular.setZero();
  stage_rate.linear.setZero();
  update_velocities(stage_rate);
  accelerate(from, stage_rate, acceleration);
  for (int round = 0; round < MAX_ROUNDS && fastest_undriven(acceleration) > most; ++round) {
    for (const Link &link : links) {
      if (is_driven(link)) continue;
      for (int k = link.sliding; k < link.freedoms(); ++k) {
        const int coordinate = link.coordinate + k;
        const btScalar change = joint_speed(link, acceleration);
        if (!(change > most)) break;
        factor_inertia();
        const btScalar by_unit = response(coordinate);
        if (!(by_unit > 0)) continue;
        generalised_forces[coordinate] -= acceleration.q[coordinate] * (1 - most / change) / by_unit;
        accelerate(from, stage_rate, acceleration);
      }
    }
  }
  update_velocities(rate);
  accelerate_driven(from, rate, acceleration);
}

// As `fastest_coordinate`, of the joints that no drive accelerates.
btScalar ArticulationDynamics::fastest_undriven(const Rate &rate) const {
  btScalar fastest = 0;
  for (const Link &link : links) {
    if (!is_driven(link)) fastest = std::max(fastest, joint_speed(link, rate));
  }
  return fastest;
}

btScalar ArticulationDynamics::fastest_coordinate(const Rate &rate) const {
  btScalar fastest = 0;
  for (const Link &link : links) fastest = std::max(fastest, joint_speed(link, rate));
  return fastest;
}

btScalar ArticulationDynamics::largest_component(const Rate &rate) const {
  btScalar most = std::max(rate.linear.length(), rate.angular.length());
  for (int k = 0; k < coordinates; ++k) most = std::max(most, btFabs(rate.q[k]));
  return most;
}

// Angular velocity of a link relative to its parent, rad/s.
btScalar ArticulationDynamics::joint_speed(const Link &link, const Rate &rate) {
  if (link.turning == 0) return 0;
  return link.turning == 1 ? btFabs(rate.q[link.coordinate])
                           : three_of(rate.q, link.coordinate + link.sliding).length();
}

btScalar ArticulationDynamics::response(int coordinate) {
  impulse_row.assign(velocity_size(), 0);
  impulse_row[6 + coordinate] = 1;
  normalise(impulse_row.data());
  btScalar sum = 0;
  for (const btScalar part : impulse_row) sum += part * part;
  return sum;
}

// Brings the rate of a coordinate to +-`most` by an impulse between the two bodies of its joint.
void ArticulationDynamics::stop_at(int coordinate, btScalar most, Rate &rate) {
  const btScalar by_unit = response(coordinate);
  if (!(by_unit > 0)) return;
  btScalar &q = rate.q[coordinate];
  const btScalar impulse = ((q > 0 ? most : -most) - q) / by_unit;
  for (btScalar &part : impulse_row) part *= impulse;
  part_rate.q.resize(coordinates);
  rates_of(impulse_row.data(), part_rate);
  rate.angular += part_rate.angular;
  rate.linear += part_rate.linear;
  for (int k = 0; k < coordinates; ++k) rate.q[k] += part_rate.q[k];
}

// Damping over h s: the velocities of all bodies decay, and their projection onto the joints gives the new rates.
void ArticulationDynamics::apply_damping(btScalar h, const Position &at, Rate &rate) {
  update_poses(at);
  update_velocities(rate);
  const size_t n = bodies.size();
  wanted_linear.resize(n);
  wanted_angular.resize(n);
  for (size_t i = 0; i < n; ++i) {
    wanted_linear[i] = linear[i] * std::exp(-bodies[i].linear_drag * h);
    wanted_angular[i] = angular[i] * std::exp(-bodies[i].angular_drag * h);
  }
  project(wanted_linear.data(), wanted_angular.data(), rate);
  update_velocities(rate);
}

void ArticulationDynamics::step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate) {
  // Largest phase of a vibration in a step (the method is stable up to 2.8 rad), and largest turn of a body, rad.
  constexpr btScalar MAX_PHASE = 1.5, MAX_TURN = 0.3;
  // Largest decay rate times step: the method is unstable from 2.8 on, and inaccurate from a tenth of that.
  constexpr btScalar MAX_DECAY = 0.2;
  // Rounding error of the internal energy, as a share of the kinetic energy.
  constexpr btScalar ROUNDING = 1e-12;
  // Change of a rate in a sub-step by the acceleration at its beginning, m/s or rad/s, that no real force causes.
  constexpr btScalar MAX_CHANGE = 1e15;
  // Largest number of parts.
  constexpr int MAX_PARTS = 100, REFINEMENT = 4;
  constexpr int PROBES_AT_FIRST = 10, STEPS_BETWEEN_PROBES = 16;
  splits_damping = false;
  for (const Body &body : bodies) {
    splits_damping = splits_damping || std::max(body.linear_drag, body.angular_drag) * h > MAX_DECAY;
  }
  start_rate = rate;
  if (splits_damping) apply_damping(h / 2, from, start_rate);
  const btScalar kinetic = start_energy = internal_energy();
  Momentum before, wrench_before;
  if (!fixed_base) {
    const btVector3 centre = mass_centre();
    before = momentum(centre);
    wrench_before = wrench(centre);
  }
  const btScalar dragged_before = drag_power(), fastest = start_rotation = fastest_rotation(start_rate);
  start_elastic_energy = springs.empty() ? 0 : elastic_energy(from);
  start_carrying_power = carrying_power();
  start_centrifugal_energy = is_carried() ? centrifugal_energy() : 0;
  start_origins = origins;
  // The rotation in the step grows by a quarter of a turn at most, and with it the work of torques beyond that which other
  // forces take: velocities that diverge say nothing about it.
  btScalar twist_before = 0, most_twisted = 0;
  for (size_t i = 0; i < bodies.size(); ++i) {
    twist_before += bodies[i].torque.dot(angular[i]);
    most_twisted += bodies[i].torque.length() * (fastest * h + SIMD_HALF_PI);
  }
  drive_step = drives.empty() ? 0 : h;
  if (drive_step > 0) {
    settle_drives(from, slopes[0]);
  } else {
    accelerate(from, start_rate, slopes[0]);
  }
  if (coordinates > 0 && steps_until_probe-- <= 0) {
    int probes = 1;
    if (mode.empty()) {
      probes = PROBES_AT_FIRST;
      mode.resize(coordinates);
      // The fastest modes of chains are zigzags.
      for (int k = 0; k < coordinates; ++k) mode[k] = (k % 2 ? -1 : 1) * (1 + btScalar(0.3) * (k % 3));
    }
    for (int i = 0; i < probes; ++i) update_fastest_mode(from, start_rate);
    steps_until_probe = STEPS_BETWEEN_PROBES;
  }
  // Forces without measure end in a state that is not finite, which stops the simulation with a word about it.
  const bool is_measured = h * largest_component(slopes[0]) < MAX_CHANGE;
  unbounded_forces = generalised_forces;
  if (is_measured) bound_acceleration(h, from, start_rate, slopes[0]);
  const btScalar phases = std::max(h * btSqrt(stiffness) / MAX_PHASE, h * fastest / MAX_TURN);
  // The comparison is false for NaN.
  int parts = phases > 1 ? static_cast<int>(std::min(std::ceil(phases), btScalar(MAX_PARTS))) : 1;
  // Limits and motors that would hold such forces hide them from the accelerations.
  const bool holds = std::all_of(drives.begin(), drives.end(),
                                 [](const Drive &drive) { return btFabs(drive.impulse) < BT_LARGE_FLOAT; });
  btScalar scale = 1;
  bool has_caught = false;
  for (;;) {
    divided_step(h, parts, from, start_rate, to, new_rate);
    update_poses(to);
    update_velocities(new_rate);
    // The work of torques uses the mean angular velocity.
    btScalar twist_after = 0;
    for (size_t i = 0; i < bodies.size(); ++i) twist_after += bodies[i].torque.dot(angular[i]);
    Works by_forces = works_of_forces(h, from, to);
    for (const Drive &drive : drives) by_forces.internal += drive.work;
    const btScalar twisted =
        std::min(h / 2 * (twist_before + twist_after), most_twisted + btFabs(by_forces.internal));
    const btScalar work = by_forces.internal + twisted + h / 2 * (dragged_before + drag_power());
    const btScalar allowed = kinetic + work, lifted = btFabs(by_forces.of_mass_centre);
    btScalar after = internal_energy();
    // Of a method of first order the root of that share.
    const btScalar growth = by_euler ? btSqrt(MAX_GROWTH) : MAX_GROWTH;
    const btScalar slack = growth * (kinetic + btFabs(work)) + ROUNDING * (kinetic_energy() + lifted);
    // With velocities that overflow in the step, `after` and `slack` are infinite. Near rest the energy is rounded to 0,
    // and what drag takes is more: nothing can be removed then.
    if (std::isfinite(after) &&
        (after <= 0 || after <= allowed + slack || after <= allowed + slack + rounding_of_work(from))) {
      if (has_caught || !catch_limits(h, from, to, new_rate)) break;
      has_caught = true;
      drive_step = h;
      begin_again(from, slopes[0]);
      continue;
    }
    if (parts >= MAX_PARTS) {
      // The largest number of sub-intervals was not enough: the excess energy is removed by scaling the velocities.
      btScalar most_energy = allowed;
      if (!std::isfinite(after) && is_measured) {
        most_energy = tangential_step(h, from, start_rate, to, new_rate);
        after = internal_energy();
      }
      // At rest both are 0. The comparison is false for NaN, which is to be lost.
      scale = most_energy >= after ? 1 : btSqrt(std::max(most_energy, btScalar(0)) / after);
      break;
    }
    parts = std::min(parts * REFINEMENT, MAX_PARTS);
    begin_again(from, slopes[0]);
  }
  if (!holds) scale = std::numeric_limits<btScalar>::quiet_NaN();
  drive_step = 0;
  std::swap(generalised_forces, unbounded_forces);
  // In this order: velocities of which only little is left may be so large that the momentum is lost to rounding.
  if (!(scale >= 1)) {
    scale_internal_velocity(scale, new_rate);
    update_velocities(new_rate);
  }
  if (!fixed_base) restore_momentum(h, before, wrench_before, new_rate);
  if (splits_damping) apply_damping(h / 2, to, new_rate);
}

// The momentum of a free base changes by external forces and the drag alone. Where links turn by radians in a part of the
// step, the truncation errors of base and joints together are a force on the mass centre and a torque about it, whose
// energy no balance of the internal energy sees.
void ArticulationDynamics::restore_momentum(btScalar h, const Momentum &before, const Momentum &wrench_before, Rate &rate) {
  const btVector3 centre = mass_centre();
  const Momentum present = momentum(centre), after = wrench(centre);
  Momentum wanted;
  wanted.linear = before.linear + (wrench_before.linear + after.linear) * (h / 2);
  wanted.angular = before.angular + (wrench_before.angular + after.angular) * (h / 2);
  // The mean wrench is that of the trapezoidal rule, of lower order than the method where velocities are smooth.
  const bool has_slipped = (wanted.linear - present.linear).length() > h * (after.linear - wrench_before.linear).length();
  btScalar scale = 0;
  for (size_t i = 0; i < bodies.size(); ++i) {
    const btVector3 arm = origins[i] - centre, way = linear[i] - present.linear / mass();
    scale += angular_momentum(i).length() + arm.cross(way).length() * bodies[i].mass;
  }
  const btScalar turned = (wanted.angular - present.angular).length();
  const bool has_turned = turned > std::max(MAX_GROWTH * scale, h * (after.angular - wrench_before.angular).length());
  if (!has_slipped) wanted.linear = present.linear;
  if (!has_turned) wanted.angular = present.angular;
  if (has_turned) {
    set_momentum(wanted, centre, rate);
  } else if (has_slipped) {
    rate.linear += (wanted.linear - present.linear) / mass();
    update_velocities(rate);
  }
}

btScalar ArticulationDynamics::tangential_step(btScalar h, const Position &from, const Rate &rate, Position &to,
                                               Rate &new_rate) {
  new_rate = rate;
  if (!fixed_base) new_rate.linear += total_force() * (h / mass());
  to = from;
  advance_position(to, h, new_rate);
  update_poses(to);
  update_velocities(new_rate);
  return std::max(start_energy + works_of_forces(h, from, to).internal, btScalar(0));
}

ArticulationDynamics::Momentum ArticulationDynamics::uniform_step(btScalar h, const Position &from, Position &to,
                                                                  Rate &new_rate) {
  update_poses(from);
  update_velocities(start_rate);
  accelerate(from, start_rate, slopes[0]);
  unbounded_forces = generalised_forces;
  bound_acceleration(h, from, start_rate, slopes[0]);
  std::swap(generalised_forces, unbounded_forces);
  const btVector3 centre = mass_centre();
  Momentum change = momentum(centre);
  const Momentum by_forces = wrench(centre);
  change.linear += by_forces.linear * h;
  change.angular += by_forces.angular * h;
  advance(new_rate, start_rate, h, slopes[0]);
  update_velocities(new_rate);
  const Momentum present = momentum(centre);
  change.linear -= present.linear;
  change.angular -= present.angular;
  to = from;
  advance_position(to, h / 2, start_rate);
  advance_position(to, h / 2, new_rate);
  if (splits_damping) apply_damping(h / 2, from, new_rate);
  return change;
}

ArticulationDynamics::Works ArticulationDynamics::works_of_forces(btScalar h, const Position &from, const Position &to) const {
  // Forces are constant, so that their work is exact.
  Works works{start_elastic_energy - (springs.empty() ? 0 : elastic_energy(to)), 0};
  btVector3 moved(0, 0, 0);
  for (size_t i = 0; i < bodies.size(); ++i) {
    const btVector3 way = origins[i] - start_origins[i];
    works.internal += bodies[i].force.dot(way);
    moved += way * bodies[i].mass;
  }
  if (!fixed_base) works.of_mass_centre = total_force().dot(moved) / mass();
  works.internal -= works.of_mass_centre;
  for (int k = 0; k < coordinates; ++k) {
    const btScalar way = to.q[k] - from.q[k];
    // The forces that bound accelerations may take energy and add none.
    works.internal += unbounded_forces[k] * way + std::min((generalised_forces[k] - unbounded_forces[k]) * way, btScalar(0));
  }
  if (is_carried()) {
    works.internal += centrifugal_energy() - start_centrifugal_energy;
    works.internal -= h / 2 * (start_carrying_power + carrying_power());
  }
  return works;
}

// Integrates over h s in equal parts. slopes[0] must be the acceleration at the beginning.
void ArticulationDynamics::divided_step(btScalar h, int parts, const Position &from, const Rate &rate, Position &to,
                                        Rate &new_rate) {
  begin_drive_sums();
  part_step(h / parts, from, rate, to, new_rate);
  for (int i = 1; i < parts; ++i) {
    part = to;
    part_rate = new_rate;
    update_poses(part);
    update_velocities(part_rate);
    accelerate_driven(part, part_rate, slopes[0]);
    part_step(h / parts, part, part_rate, to, new_rate);
  }
}

// One step of the method of integration. slopes[0] must be the acceleration at the beginning.
void ArticulationDynamics::part_step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate) {
  if (!by_euler) return runge_kutta(h, from, rate, to, new_rate);
  advance(new_rate, rate, h, slopes[0]);
  to = from;
  advance_position(to, h, new_rate);
  // Constant forces do this work on the velocity that the step begins and that it ends with.
  add_drive_sums(h / 2, rate);
  add_drive_sums(h / 2, new_rate);
}

// One step of the classical Runge-Kutta method. slopes[0] must be the acceleration at the beginning.
void ArticulationDynamics::runge_kutta(btScalar h, const Position &from, const Rate &rate, Position &to,
                                       Rate &new_rate) {
  const btScalar way[4] = {0, h / 2, h / 2, h};
  btQuaternion spins[4];
  const auto set_ball_spins = [this](int i, const Position &at) {
    for (const Link &link : links) {
      if (link.ball >= 0)
        ball_spins[i][link.ball] = spin_of(three_of(speeds[i].q, link.coordinate + link.sliding), at.balls[link.ball]);
    }
  };
  speeds[0] = rate;
  spins[0] = spin_of(rate.angular, from.rotation);
  set_ball_spins(0, from);
  add_drive_sums(h / 6, rate);
  for (int i = 1; i < 4; ++i) {
    const Rate &speed = speeds[i - 1];
    stage.rotation = from.rotation + spins[i - 1] * way[i];
    stage.origin = from.origin + speed.linear * way[i];
    for (int k = 0; k < coordinates; ++k) stage.q[k] = from.q[k] + way[i] * speed.q[k];
    for (int k = 0; k < balls; ++k) stage.balls[k] = from.balls[k] + ball_spins[i - 1][k] * way[i];
    advance(speeds[i], rate, way[i], slopes[i - 1]);
    spins[i] = spin_of(speeds[i].angular, stage.rotation);
    set_ball_spins(i, stage);
    accelerate_driven(stage, speeds[i], slopes[i], false);
    add_drive_sums(i < 3 ? h / 3 : h / 6, speeds[i]);
  }
  auto way_of = [h](const auto &a, const auto &b, const auto &c, const auto &d) {
    return (a + b * 2 + c * 2 + d) * (h / 6);
  };
  const Rate *v = speeds, *a = slopes;
  to.rotation = from.rotation;
  if (!fixed_base || !rate.angular.isZero()) to.rotation = (from.rotation + way_of(spins[0], spins[1], spins[2], spins[3])).normalized();
  to.origin = from.origin + way_of(v[0].linear, v[1].linear, v[2].linear, v[3].linear);
  new_rate.angular = rate.angular + way_of(a[0].angular, a[1].angular, a[2].angular, a[3].angular);
  new_rate.linear = rate.linear + way_of(a[0].linear, a[1].linear, a[2].linear, a[3].linear);
  for (int k = 0; k < coordinates; ++k) {
    to.q[k] = from.q[k] + way_of(v[0].q[k], v[1].q[k], v[2].q[k], v[3].q[k]);
    new_rate.q[k] = rate.q[k] + way_of(a[0].q[k], a[1].q[k], a[2].q[k], a[3].q[k]);
  }
  const Vector<btQuaternion> *b = ball_spins;
  for (int k = 0; k < balls; ++k) {
    to.balls[k] = (from.balls[k] + way_of(b[0][k], b[1][k], b[2][k], b[3][k])).normalized();
  }
}

void ArticulationDynamics::factor_inertia() {
  const AmbAbaTree all = tree();
  aba_table->factor(&all, factor.data(), inverse_diagonal.data());
  if (!couplings.empty()) find_coupled_space();
}

void ArticulationDynamics::add_jacobian(size_t body, const btVector3 &force, const btVector3 &torque,
                                        btScalar *row) const {
  const AmbAbaTree all = tree();
  aba_table->add_jacobian(&all, static_cast<int>(body), force.m_floats, torque.m_floats, false, row);
}

void ArticulationDynamics::add_joint_jacobian(size_t body, const btVector3 &force, const btVector3 &torque,
                                              btScalar *row) const {
  const AmbAbaTree all = tree();
  aba_table->add_jacobian(&all, static_cast<int>(body), force.m_floats, torque.m_floats, true, row);
}

// Finds the rows of the couplings for z, made orthonormal by Gram and Schmidt's method. The rows of those whose joints nothing
// can move are left out.
void ArticulationDynamics::find_coupled_space() {
  const size_t n = velocity_size();
  coupling_rows.clear();
  coupled_velocity.resize(n);
  for (const Coupling &coupling : couplings) {
    std::fill(coupled_velocity.begin(), coupled_velocity.end(), 0);
    for (const CoupledCoordinate &term : coupling) coupled_velocity[6 + term.coordinate] += term.factor;
    btScalar *const row = coupled_velocity.data();
    normalise_uncoupled(row);
    const auto length = [&] { return btSqrt(std::inner_product(row, row + n, row, btScalar(0))); };
    const btScalar before = length();
    // The second time removes what rounding left of the first.
    remove_uncoupled(row);
    remove_uncoupled(row);
    const btScalar after = length();
    if (!(after > COUPLED_ROUNDING * before)) continue;
    for (size_t k = 0; k < n; ++k) coupling_rows.push_back(row[k] / after);
  }
}

// Takes the parts along the rows of couplings out of velocities z.
void ArticulationDynamics::remove_uncoupled(btScalar *z) const {
  const size_t n = velocity_size();
  for (size_t from = 0; from < coupling_rows.size(); from += n) {
    const btScalar *const row = &coupling_rows[from];
    const btScalar part = std::inner_product(z, z + n, row, btScalar(0));
    for (size_t k = 0; k < n; ++k) z[k] -= part * row[k];
  }
}

// Finds the rates, or accelerations, in which the couplings hold and of which the difference from those given has the least
// kinetic energy (Gauss's principle of least constraint).
void ArticulationDynamics::couple(Rate &rate) {
  factor_inertia();
  coordinates_of(rate, coupled_velocity.data());
  remove_uncoupled(coupled_velocity.data());
  rates_of(coupled_velocity.data(), rate);
  // But for rounding errors they are so already.
  for (const Coupling &coupling : couplings) {
    btScalar sum = 0;
    for (size_t i = 1; i < coupling.size(); ++i) sum += coupling[i].factor * rate.q[coupling[i].coordinate];
    rate.q[coupling[0].coordinate] = -sum;
  }
}

void ArticulationDynamics::normalise(btScalar *row) const {
  // What is left is rounding where the couplings hold what the row would move.
  normalise_uncoupled(row);
  if (coupling_rows.empty()) return;
  const size_t n = velocity_size();
  const auto square = [&] { return std::inner_product(row, row + n, row, btScalar(0)); };
  const btScalar before = square();
  remove_uncoupled(row);
  if (square() <= COUPLED_ROUNDING * COUPLED_ROUNDING * before) std::fill(row, row + n, 0);
}

void ArticulationDynamics::normalise_uncoupled(btScalar *row) const {
  const size_t n = velocity_size();
  for (size_t k = n; k-- > (fixed_base ? 6u : 0u);) {
    if (row[k] == 0) continue;
    row[k] *= inverse_diagonal[k];
    for (int j = parent_component[k]; j >= 0; j = parent_component[j]) row[j] -= factor[k * n + j] * row[k];
  }
}

void ArticulationDynamics::rates_of(const btScalar *z, Rate &rate) const {
  const size_t n = velocity_size();
  const auto component = [&](size_t k) -> btScalar & {
    return k < 3 ? rate.angular[k] : k < 6 ? rate.linear[k - 3] : rate.q[k - 6];
  };
  for (size_t k = 0; k < n; ++k) {
    if (fixed_base && k < 6) {
      component(k) = 0;
      continue;
    }
    btScalar sum = z[k];
    for (int j = parent_component[k]; j >= 0; j = parent_component[j]) sum -= factor[k * n + j] * component(j);
    component(k) = sum * inverse_diagonal[k];
  }
}

void ArticulationDynamics::coordinates_of(const Rate &rate, btScalar *z) const {
  const size_t n = velocity_size();
  const auto component = [&](size_t k) { return k < 3 ? rate.angular[k] : k < 6 ? rate.linear[k - 3] : rate.q[k - 6]; };
  for (size_t k = 0; k < n; ++k) {
    z[k] = 0;
    if (fixed_base && k < 6) continue;
    for (int j = static_cast<int>(k); j >= 0; j = parent_component[j]) z[k] += factor[k * n + j] * component(j);
  }
}

void ArticulationDynamics::advance_position(Position &position, btScalar h, const Rate &rate) const {
  position.origin += rate.linear * h;
  for (size_t i = 0; i < position.q.size(); ++i) position.q[i] += h * rate.q[i];
  turn_by(position.rotation, rate.angular, h);
  for (const Link &link : links) {
    if (link.ball >= 0) turn_by(position.balls[link.ball], three_of(rate.q, link.coordinate + link.sliding), h);
  }
}

btVector3 ArticulationDynamics::angular_momentum(size_t body) const {
  return rotations[body] * (transpose_times(rotations[body], angular[body]) * bodies[body].inertia);
}

ArticulationDynamics::Momentum ArticulationDynamics::momentum(const btVector3 &about) const {
  Momentum sum;
  for (size_t i = 0; i < bodies.size(); ++i) {
    const btVector3 part = linear[i] * bodies[i].mass;
    sum.linear += part;
    sum.angular += angular_momentum(i) + (origins[i] - about).cross(part);
  }
  return sum;
}

void ArticulationDynamics::set_momentum(const Momentum &wanted, const btVector3 &about, Rate &rate) {
  btScalar mass = 0;
  btVector3 center(0, 0, 0);
  for (size_t i = 0; i < bodies.size(); ++i) {
    mass += bodies[i].mass;
    center += origins[i] * bodies[i].mass;
  }
  center /= mass;
  btMatrix3x3 inertia(0, 0, 0, 0, 0, 0, 0, 0, 0);
  for (size_t i = 0; i < bodies.size(); ++i) {
    const btVector3 arm = origins[i] - center;
    inertia += scaled_rotation(rotations[i], bodies[i].inertia);
    for (int k = 0; k < 3; ++k) inertia[k][k] += bodies[i].mass * arm.length2();
    subtract_outer(inertia, arm, arm, bodies[i].mass);
  }
  const Momentum present = momentum(about);
  const btVector3 linear_change = wanted.linear - present.linear;
  const btVector3 turn = solve_three(inertia, wanted.angular - present.angular - (center - about).cross(linear_change));
  rate.angular += turn;
  rate.linear += linear_change / mass + turn.cross(origins[0] - center);
  update_velocities(rate);
}
