#include "articulation_dynamics.h"

#include "position_error.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace {

// [v] times a matrix: each column of the result is v x the column.
btMatrix3x3 cross_matrix(const btVector3 &v, const btMatrix3x3 &m) {
  const btVector3 x = m[2] * v.y() - m[1] * v.z();
  const btVector3 y = m[0] * v.z() - m[2] * v.x();
  const btVector3 z = m[1] * v.x() - m[0] * v.y();
  return btMatrix3x3(x.x(), x.y(), x.z(), y.x(), y.y(), y.z(), z.x(), z.y(), z.z());
}

template <class Elements>
double *numbers_of(const Elements &elements) {
  return const_cast<double *>(reinterpret_cast<const double *>(elements.data()));
}

// What is only read is given as what may be written, too.
AmbAbaPosition raw(const ArticulationDynamics::Position &position) {
  auto &at = const_cast<ArticulationDynamics::Position &>(position);
  return {at.rotation, at.origin.m_floats, at.q.data(), numbers_of(at.balls)};
}

AmbAbaRates raw(const ArticulationDynamics::Rate &rate) {
  auto &of = const_cast<ArticulationDynamics::Rate &>(rate);
  return {of.angular.m_floats, of.linear.m_floats, of.q.data()};
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

ArticulationDynamics::Drive ArticulationDynamics::limit(int coordinate, bool is_angle, btScalar side, btScalar target,
                                                        btScalar gap) {
  Drive drive;
  drive.coordinate = coordinate;
  drive.target = target;
  drive.softness = 0;
  drive.low = side > 0 ? 0 : -BT_LARGE_FLOAT;
  drive.high = side > 0 ? BT_LARGE_FLOAT : 0;
  drive.is_limit = true;
  drive.side = side;
  drive.gap = gap;
  drive.is_angle = is_angle;
  return drive;
}

void ArticulationDynamics::couple(const Vector<CoupledCoordinate> &terms) {
  coupled.insert(coupled.end(), terms.begin(), terms.end());
  coupling_ends.push_back(static_cast<int>(coupled.size()));
}

void ArticulationDynamics::finish() {
  const AmbAbaTable &table = *aba_table;
  assert(table.link_size == sizeof(Link) && table.body_size == sizeof(Body) && table.spring_size == sizeof(Spring));
  assert(table.drive_size == sizeof(Drive) && table.distant_size == sizeof(DistantLimits));
  assert(table.state_size == sizeof(AmbAbaState));
  const size_t n = bodies.size(), size = velocity_size();
  const btVector3 zero(0, 0, 0);
  rotations.resize(n, btMatrix3x3::getIdentity());
  for (auto *each : {&origins, &linear, &angular, &arms, &axes}) each->resize(n, zero);
  work.resize(n * table.work_size / sizeof(btVector3), zero);
  numbers.resize(table.numbers * coordinates);
  vectors.resize(table.vectors * n, zero);
  quaternions.resize(table.quaternions * balls, btQuaternion::getIdentity());
  generalised_forces.resize(coordinates);
  driven.resize(2 * coordinates);
  given_by.resize(coordinates, -1);
  rest_impulse.resize(coordinates);
  factor.resize(size * size);
  inverse_diagonal.resize(size);
  coupling_rows.resize(coupling_ends.size() * size);
  rows.resize(2 * size);
  parent_component.resize(size);
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
}

AmbAbaTree ArticulationDynamics::tree() const {
  auto &self = const_cast<ArticulationDynamics &>(*this);
  const auto count = [](const auto &elements) { return static_cast<int>(elements.size()); };
  return {count(links),
          coordinates,
          balls,
          fixed_base,
          count(springs),
          count(coupling_ends),
          count(distant_limits),
          count(drives.places),
          links.data(),
          bodies.data(),
          numbers_of(rotations),
          numbers_of(origins),
          numbers_of(linear),
          numbers_of(angular),
          numbers_of(arms),
          numbers_of(axes),
          self.work.data(),
          springs.data(),
          coupled.data(),
          coupling_ends.data(),
          parent_component.data(),
          self.factor.data(),
          self.inverse_diagonal.data(),
          self.coupling_rows.data(),
          self.rows.data(),
          self.drives.places.data(),
          &self.drives.count,
          distant_limits.data(),
          self.driven.data(),
          self.given_by.data(),
          self.rest_impulse.data(),
          self.generalised_forces.data(),
          self.numbers.data(),
          numbers_of(vectors),
          numbers_of(quaternions),
          &self.state};
}

void ArticulationDynamics::update_poses(const Position &position) {
  const AmbAbaTree all = tree();
  const AmbAbaPosition at = raw(position);
  aba_table->update_poses(&all, &at);
}

void ArticulationDynamics::update_velocities(const Rate &rate) {
  const AmbAbaTree all = tree();
  const AmbAbaRates rates = raw(rate);
  aba_table->update_velocities(&all, &rates);
}

btScalar ArticulationDynamics::Spring::displacement(btScalar q) const {
  // Wrapped half a turn away from the rest position, where the elastic energy is continuous.
  const btScalar x = sign * q + offset - rest;
  return is_angle ? wrapped(x) : x;
}

void ArticulationDynamics::accelerate(const Position &position, const Rate &rate, Rate &acceleration) {
  const AmbAbaTree all = tree();
  const AmbAbaPosition at = raw(position);
  const AmbAbaRates rates = raw(rate), out = raw(acceleration);
  aba_table->accelerate(&all, &at, &rates, &out);
}

void ArticulationDynamics::project(const btVector3 *linear_wanted, const btVector3 *angular_wanted, Rate &rate) {
  const AmbAbaTree all = tree();
  const AmbAbaRates rates = raw(rate);
  aba_table->project(&all, linear_wanted->m_floats, angular_wanted->m_floats, &rates);
}

btScalar ArticulationDynamics::kinetic_energy() const {
  const AmbAbaTree all = tree();
  return aba_table->kinetic_energy(&all);
}

btScalar ArticulationDynamics::internal_energy() const {
  const AmbAbaTree all = tree();
  return aba_table->internal_energy(&all);
}

btVector3 ArticulationDynamics::linear_momentum() const { return momentum(btVector3(0, 0, 0)).linear; }

btScalar ArticulationDynamics::mass() const {
  const AmbAbaTree all = tree();
  return aba_table->mass(&all);
}

btVector3 ArticulationDynamics::mass_centre() const {
  const AmbAbaTree all = tree();
  btVector3 centre;
  aba_table->mass_centre(&all, centre.m_floats);
  return centre;
}

void ArticulationDynamics::scale_internal_velocity(btScalar share, Rate &rate) {
  const AmbAbaTree all = tree();
  const AmbAbaRates rates = raw(rate);
  aba_table->scale_internal_velocity(&all, share, &rates);
}

btScalar ArticulationDynamics::work_at_rate(btScalar h, const Position &position, const Rate &rate) const {
  const AmbAbaTree all = tree();
  const AmbAbaPosition at = raw(position);
  const AmbAbaRates rates = raw(rate);
  return aba_table->work_at_rate(&all, h, &at, &rates);
}

btScalar ArticulationDynamics::fastest_rotation(const Rate &rate) const {
  const AmbAbaTree all = tree();
  const AmbAbaRates rates = raw(rate);
  return aba_table->fastest_rotation(&all, &rates);
}

void ArticulationDynamics::bound_rotation(Rate &rate, btScalar most) {
  const AmbAbaTree all = tree();
  const AmbAbaRates rates = raw(rate);
  aba_table->bound_rotation(&all, &rates, most);
}

btScalar ArticulationDynamics::response(int coordinate) {
  return aba_table->response(&factored, coordinate);
}

void ArticulationDynamics::step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate) {
  const AmbAbaTree all = tree();
  const AmbAbaPosition begin = raw(from), end = raw(to);
  const AmbAbaRates before = raw(rate), after = raw(new_rate);
  aba_table->step(&all, h, &begin, &before, &end, &after);
}

btScalar ArticulationDynamics::tangential_step(btScalar h, const Position &from, const Rate &rate, Position &to,
                                               Rate &new_rate) {
  const AmbAbaTree all = tree();
  const AmbAbaPosition begin = raw(from), end = raw(to);
  const AmbAbaRates before = raw(rate), after = raw(new_rate);
  return aba_table->tangential_step(&all, h, &begin, &before, &end, &after);
}

bool ArticulationDynamics::way_to_limits(btScalar h, const Position &from, const Position &to, Vector<btScalar> &back) const {
  bool found = false;
  for (const Drive &drive : drives) {
    if (!drive.is_limit) continue;
    const int k = drive.coordinate;
    const btScalar side = drive.side == 0 ? 1 : drive.side;
    const btScalar gap = drive.gap + side * (to.q[k] - from.q[k]);
    if (drive.side != 0 ? gap >= 0 : gap == 0) continue;
    // A limit that was violated before is returned to at a bounded speed.
    const btScalar most = (drive.is_angle ? MAX_RETURN_RATE : MAX_RETURN_SPEED) * h;
    const btScalar way = drive.gap < 0 || drive.side == 0 ? std::clamp(-gap * LIMIT_ERP, -most, most) : -gap;
    if (!found) back.assign(coordinates, 0);
    found = true;
    back[k] = side * way;
  }
  return found;
}

void ArticulationDynamics::factor_inertia() {
  factored = tree();
  aba_table->factor(&factored);
}

void ArticulationDynamics::add_jacobian(size_t body, const btVector3 &force, const btVector3 &torque,
                                        btScalar *row) const {
  aba_table->add_jacobian(&factored, static_cast<int>(body), force.m_floats, torque.m_floats, false, row);
}

void ArticulationDynamics::add_joint_jacobian(size_t body, const btVector3 &force, const btVector3 &torque,
                                              btScalar *row) const {
  aba_table->add_jacobian(&factored, static_cast<int>(body), force.m_floats, torque.m_floats, true, row);
}

void ArticulationDynamics::normalise(btScalar *row) const {
  aba_table->normalise(&factored, row);
}

void ArticulationDynamics::rates_of(const btScalar *z, Rate &rate) const {
  const AmbAbaRates rates = raw(rate);
  aba_table->rates_of(&factored, z, &rates);
}

void ArticulationDynamics::coordinates_of(const Rate &rate, btScalar *z) const {
  const AmbAbaRates rates = raw(rate);
  aba_table->coordinates_of(&factored, &rates, z);
}

void ArticulationDynamics::advance_position(Position &position, btScalar h, const Rate &rate) const {
  const AmbAbaTree all = tree();
  const AmbAbaPosition at = raw(position);
  const AmbAbaRates rates = raw(rate);
  aba_table->advance_position(&all, &at, h, &rates);
}

btVector3 ArticulationDynamics::angular_momentum(size_t body) const {
  const btMatrix3x3 &rotation = rotations[body];
  return rotation * ((angular[body] * rotation) * bodies[body].inertia);
}

ArticulationDynamics::Momentum ArticulationDynamics::momentum(const btVector3 &about) const {
  const AmbAbaTree all = tree();
  Momentum sum;
  aba_table->momentum(&all, about.m_floats, sum.linear.m_floats);
  return sum;
}

void ArticulationDynamics::set_momentum(const Momentum &wanted, const btVector3 &about, Rate &rate) {
  const AmbAbaTree all = tree();
  const AmbAbaRates rates = raw(rate);
  aba_table->set_momentum(&all, wanted.linear.m_floats, about.m_floats, &rates);
}
