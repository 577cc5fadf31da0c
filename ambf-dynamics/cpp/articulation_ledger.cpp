// Energy ledger of articulations.
#include "ledger_rows.h"
#include "articulation_rows.h"

namespace {

// Midpoint rate of a cubic through two values and their rates.
btScalar middle_of(btScalar way, btScalar before, btScalar after, btScalar h) {
  return btScalar(1.5) * way / h - (before + after) / 4;
}
btVector3 middle_of(const btVector3 &way, const btVector3 &before, const btVector3 &after, btScalar h) {
  return way * (btScalar(1.5) / h) - (before + after) / 4;
}

btScalar elastic(const ArticulationDynamics::Spring &spring, btScalar q) {
  const btScalar x = spring.displacement(q);
  return spring.stiffness * x * x / 2;
}

}  // namespace

void read_rates(const btMultiBody &multi_body, Vector<btScalar> &start, Vector<btScalar> &free) {
  const AmbArticulation &articulation = *static_cast<const AmbArticulation *>(multi_body.getUserPointer());
  start.resize(articulation.dynamics.velocity_size());
  free.resize(start.size());
  articulation.dynamics.coordinates_of(articulation.rate, start.data());
  articulation.dynamics.coordinates_of(articulation.row_rate, free.data());
}

// Present energy, with potential and elastic energy evaluated `by` s before the present positions.
MechanicalEnergy AmbArticulation::energy_at_lead(btScalar by) const {
  MechanicalEnergy sum;
  sum.kinetic = dynamics.kinetic_energy();
  for (size_t i = dynamics.fixed_base ? 1 : 0; i < members.size(); ++i) {
    const btVector3 weight = members[i].body->body.getGravity() * dynamics.bodies[i].mass;
    sum.potential -= weight.dot(dynamics.origins[i] - dynamics.linear[i] * by);
  }
  for (const ArticulationDynamics::Spring &spring : dynamics.springs) {
    sum.elastic += elastic(spring, position.q[spring.coordinate] - rate.q[spring.coordinate] * by);
  }
  return sum;
}

void AmbArticulation::note_energy() { energy = energy_at_lead(pose_lead); }

// Adds the energy of states that were set since the last sub-step, and stores the state at the beginning of this one.
void AmbArticulation::begin_account() {
  const double before = energy.total();
  note_energy();
  engine_of(world).ledger.sums.set_states += energy.total() - before;
  start.position = position;
  start.rate = rate;
  start.origins = dynamics.origins;
  start.linear = dynamics.linear;
  start.angular = dynamics.angular;
  start.drag = start.corrected = 0;
  for (size_t i = dynamics.fixed_base ? 1 : 0; i < members.size(); ++i) {
    start.drag += dynamics.bodies[i].angular_drag * dynamics.angular[i].dot(dynamics.angular_momentum(i));
  }
}

// Adds the work of the pseudo-velocities, before they move the position over h s.
void AmbArticulation::book_correction(btScalar h) {
  dynamics.update_poses(position);
  dynamics.update_velocities(correction);
  double work = 0;
  for (size_t i = dynamics.fixed_base ? 1 : 0; i < members.size(); ++i) {
    work -= members[i].body->body.getGravity().dot(dynamics.linear[i]) * dynamics.bodies[i].mass * h;
  }
  for (const ArticulationDynamics::Spring &spring : dynamics.springs) {
    const btScalar q = position.q[spring.coordinate];
    const btScalar change = elastic(spring, q + correction.q[spring.coordinate] * h) - elastic(spring, q);
    work += change;
    if (spring.is_stiff) start.corrected += change;
  }
  engine_of(world).ledger.sums.corrections += work;
}

// Adds the work in a sub-step of h s except that of rows. is_straight: the positions moved by the new rates
// (semi-implicit Euler).
void AmbArticulation::end_account(btScalar h, bool is_straight) {
  EnergyLedger &ledger = engine_of(world).ledger;
  const btScalar next = is_straight ? h / 2 : 0;
  double changed = 0, wrenches = 0, damping = -start.drag * h / 2 - start.corrected;
  for (size_t i = dynamics.fixed_base ? 1 : 0; i < members.size(); ++i) {
    const ArticulationDynamics::Body &body = dynamics.bodies[i];
    const btVector3 weight = members[i].body->body.getGravity() * body.mass, &before = start.linear[i],
                    &after = dynamics.linear[i];
    const btVector3 mean_way = (before + after) * (h / 2),
                    way = is_straight ? mean_way : dynamics.origins[i] - start.origins[i];
    changed += weight.dot(before) * (next - pose_lead);
    wrenches += (body.force - weight).dot(way) + body.torque.dot(start.angular[i] + dynamics.angular[i]) * (h / 2);
    const btVector3 middle = middle_of(way, before, after, h);
    damping -= body.mass * body.linear_drag * h / 6 * (before.length2() + 4 * middle.length2() + after.length2()) +
               body.angular_drag * dynamics.angular[i].dot(dynamics.angular_momentum(i)) * h / 2;
  }
  for (const ArticulationDynamics::Spring &spring : dynamics.springs) {
    const int i = spring.coordinate;
    const btScalar q = start.position.q[i], before = start.rate.q[i], after = rate.q[i];
    changed += elastic(spring, q - before * next) - elastic(spring, q - before * pose_lead);
    if (spring.is_stiff) {
      // The work of its row is the change of elastic energy plus the damping work.
      damping += elastic(spring, position.q[i] - after * next) - elastic(spring, q - before * next);
    } else {
      const btScalar way = is_straight ? (before + after) * (h / 2) : position.q[i] - q,
                     middle = middle_of(way, before, after, h);
      damping -= spring.damping * h / 6 * (before * before + 4 * middle * middle + after * after);
    }
  }
  ledger.sums.contacts += changed;
  ledger.sums.wrenches += wrenches;
  ledger.sums.damping += damping;
  joint_rows->book_feedforward(ledger, start.position, start.rate, is_straight ? h / 2 : 0);
  pose_lead = next;
  note_energy();
}

void JointRows::book_feedforward(EnergyLedger &ledger, const ArticulationDynamics::Position &from,
                                 const ArticulationDynamics::Rate &rate, btScalar pose_lead) const {
  if (are_drives) {
    for (size_t i = 0; i < planned.size(); ++i)
      ledger.book(work_kind(static_cast<int>(i)), articulation.dynamics.drives[i].work);
    return;
  }
  for (size_t i = 0; i < planned.size(); ++i) {
    const int k = planned[i].coordinate;
    const btScalar way =
        pose_lead > 0 ? (rate.q[k] + articulation.rate.q[k]) * pose_lead : articulation.position.q[k] - from.q[k];
    ledger.book(work_kind(static_cast<int>(i)), planned[i].feedforward / step * way);
  }
}
