// Motors, stiff springs and limits of the coordinates of an articulation as parts of its equations of motion.
//
// A drive that gives the rate v' = target - c x at the end of a step of h s by its impulse x has, at any instant of the step,
// the force f = (target - v0 - h a) / (c h), where v0 is the rate at the beginning and a the acceleration at that instant.
// That is linear in a: 1 / c is added to the articulated inertia D of the coordinate, and (target - v0) / (c h) to the force
// on it. With the weights of any Runge-Kutta method the mean of f is x / h, so that the step ends with v' exactly and keeps
// the order of the method. A rigid drive (c = 0) prescribes the acceleration (target - v0) / h, as in Featherstone's hybrid
// dynamics (Rigid Body Dynamics Algorithms, 2008, section 9.2).
#include "articulation_dynamics.h"

#include <algorithm>
#include <cmath>

#include "position_error.h"

namespace {

using Drive = ArticulationDynamics::Drive;

// Share of a rate or impulse that counts as rounding.
constexpr btScalar ROUNDING = 1e-9;
// Largest number of evaluations in which all drives that are wrong change their states at once, and in all; with one change at
// a time the method ends (Murty's least-index rule).
constexpr int MAX_BLOCK_ROUNDS = 6, MAX_ROUNDS = 40;

bool is_rigid(const Drive &drive) { return drive.softness <= 0; }
bool is_free(const Drive &drive) { return drive.state == Drive::State::Free; }
btScalar bound_of(const Drive &drive) { return drive.state == Drive::State::Low ? drive.low : drive.high; }

}  // namespace

Drive ArticulationDynamics::limit(int coordinate, bool is_angle, btScalar side, btScalar target, btScalar gap) {
  Drive drive;
  drive.coordinate = coordinate;
  drive.target = target;
  drive.softness = 0;
  drive.low = side > 0 ? 0 : -BT_LARGE_FLOAT;
  drive.high = side > 0 ? BT_LARGE_FLOAT : 0;
  drive.is_angle = is_angle;
  drive.side = side;
  drive.gap = gap;
  drive.is_limit = true;
  drive.state = side > 0 ? Drive::State::Low : Drive::State::High;
  return drive;
}

// Sets what the drives in their present states add to the equations of motion.
void ArticulationDynamics::load_drives() {
  for (int k = 0; k < coordinates; ++k) {
    driven[k] = {0, 0, 0, 0, 0};
    given_by[k] = -1;
  }
  for (size_t i = 0; i < drives.size(); ++i) {
    const Drive &drive = drives[i];
    if (!is_free(drive)) continue;
    const int k = drive.coordinate;
    if (!is_rigid(drive)) {
      driven[k].inertia += 1 / drive.softness;
      driven[k].pull += (drive.target - start_rate.q[k]) / (drive.softness * drive_step);
      continue;
    }
    // Where several rigid drives act, a motor that leads away from a limit overrules it, and a limit any other motor. A joint
    // whose limits are equal does not move.
    const int other = given_by[k];
    const bool is_locked = drive.is_limit && drive.side == 0;
    if (other < 0 || is_locked || (drive.is_limit && (drives[other].target - drive.target) * drive.side < 0)) {
      given_by[k] = static_cast<int>(i);
    } else if (!drive.is_limit && drives[other].is_limit && drives[other].side != 0 &&
               (drive.target - drives[other].target) * drives[other].side >= 0) {
      given_by[k] = static_cast<int>(i);
    }
  }
  for (int k = 0; k < coordinates; ++k) {
    if (given_by[k] < 0) continue;
    driven[k].is_given = 1;
    driven[k].given = (drives[given_by[k]].target - start_rate.q[k]) / drive_step;
  }
}

// Adds the forces of the drives that do not depend on the acceleration.
void ArticulationDynamics::add_drives() {
  for (const Drive &drive : drives) {
    if (!is_free(drive)) efforts[drive.coordinate] += bound_of(drive) / drive_step;
  }
  for (int k = 0; k < coordinates; ++k) efforts[k] += driven[k].pull;
}

// Finds the impulses that the drives would have if the last evaluation held over the whole step.
void ArticulationDynamics::measure_drives(const Rate &acceleration) {
  for (int k = 0; k < coordinates; ++k) rest_impulse[k] = driven[k].force * drive_step;
  for (Drive &drive : drives) {
    if (is_free(drive) && is_rigid(drive)) continue;
    const int k = drive.coordinate;
    const btScalar change = drive_step * acceleration.q[k];
    drive.impulse = is_free(drive) ? (drive.target - start_rate.q[k] - change) / drive.softness : bound_of(drive);
    if (is_free(drive)) rest_impulse[k] -= drive.impulse;
  }
  // What holds a coordinate at its limit is the motor that presses it there, as far as it has to, and else the limit.
  for (const bool of_limits : {false, true}) {
    for (size_t i = 0; i < drives.size(); ++i) {
      Drive &drive = drives[i];
      if (!is_free(drive) || !is_rigid(drive) || drive.is_limit != of_limits) continue;
      const int k = drive.coordinate, given = given_by[k];
      btScalar low = -BT_LARGE_FLOAT, high = BT_LARGE_FLOAT;
      if (given != static_cast<int>(i)) {
        const Drive &holder = drives[given];
        const bool helps = !of_limits && !(holder.is_limit && holder.side == 0);
        low = helps && holder.side >= 0 ? drive.low : 0;
        high = helps && holder.side <= 0 ? drive.high : 0;
      }
      drive.impulse = std::min(std::max(rest_impulse[k], low), high);
      rest_impulse[k] -= drive.impulse;
    }
  }
}

// Drives that would have to be stronger than they are get the largest impulse they have; that of a limit is one of forces without
// measure. Returns whether one did.
bool ArticulationDynamics::saturate_drives() {
  bool changed = false;
  for (Drive &drive : drives) {
    // Which limits hold is known since the beginning of the step.
    if (!is_free(drive) || drive.side * drive.impulse < 0) continue;
    const btScalar slack = ROUNDING * btFabs(drive.impulse);
    if (drive.impulse > drive.high + slack) {
      drive.state = Drive::State::High;
    } else if (drive.impulse < drive.low - slack) {
      drive.state = Drive::State::Low;
    } else {
      continue;
    }
    changed = true;
  }
  return changed;
}

// Changes the states of drives that the last evaluation contradicts, or that of the first of them. Returns whether there was one.
bool ArticulationDynamics::pivot_drives(const Rate &acceleration, bool one_only) {
  bool changed = false;
  for (size_t i = 0; i < drives.size() && !(changed && one_only); ++i) {
    Drive &drive = drives[i];
    const int k = drive.coordinate;
    const btScalar change = drive_step * acceleration.q[k], speed = start_rate.q[k] + change;
    const btScalar rounding = ROUNDING * (btFabs(drive.target) + btFabs(start_rate.q[k]) + btFabs(change));
    const Drive::State before = drive.state;
    if (drive.is_limit && drive.side == 0) continue;
    if (drive.is_limit) {
      if (!is_free(drive)) {
        if (drive.side * (speed - drive.target) < -rounding) drive.state = Drive::State::Free;
      } else if (given_by[k] == static_cast<int>(i) ? drive.side * drive.impulse < -ROUNDING * btFabs(driven[k].force * drive_step)
                                                    : drive.side * (speed - drive.target) > rounding) {
        drive.state = drive.side > 0 ? Drive::State::Low : Drive::State::High;
      }
    } else if (is_free(drive)) {
      const btScalar slack = ROUNDING * btFabs(drive.impulse), missed = drive.target - speed;
      const int given = given_by[k];
      // Friction that a motor overcomes acts in full.
      const bool is_overruled = is_rigid(drive) && given != static_cast<int>(i) && !drives[given].is_limit;
      if (drive.impulse > drive.high + slack || (is_overruled && missed > rounding)) drive.state = Drive::State::High;
      if (drive.impulse < drive.low - slack || (is_overruled && missed < -rounding)) drive.state = Drive::State::Low;
    } else {
      const btScalar asked = drive.target - speed - drive.softness * bound_of(drive);
      if (drive.state == Drive::State::High ? asked < -rounding : asked > rounding) drive.state = Drive::State::Free;
    }
    changed = changed || drive.state != before;
  }
  return changed;
}

// Finds the accelerations at the beginning of the step and the states of the drives that go with them, by principal pivoting.
void ArticulationDynamics::settle_drives(const Position &from, Rate &acceleration) {
  for (int round = 0;; ++round) {
    load_drives();
    accelerate(from, start_rate, acceleration);
    measure_drives(acceleration);
    if (round == MAX_ROUNDS || !pivot_drives(acceleration, round >= MAX_BLOCK_ROUNDS)) break;
  }
  for (Drive &drive : drives) drive.start_state = drive.state;
}

// Finds the accelerations at the beginning once more, with the states of the drives there.
void ArticulationDynamics::begin_again(const Position &from, Rate &acceleration) {
  update_poses(from);
  update_velocities(start_rate);
  for (Drive &drive : drives) drive.state = drive.start_state;
  if (drive_step > 0) load_drives();
  accelerate_driven(from, start_rate, acceleration);
}

// Whether drives determine the acceleration of a joint.
bool ArticulationDynamics::is_driven(const Link &link) const {
  return drive_step > 0 && link.freedoms() == 1 && (given_by[link.coordinate] >= 0 || driven[link.coordinate].inertia > 0);
}

// Accelerations within the step, where motors may reach their bounds.
void ArticulationDynamics::accelerate_driven(const Position &position, const Rate &rate, Rate &acceleration, bool is_placed) {
  accelerate(position, rate, acceleration, is_placed);
  if (drive_step == 0) return;
  measure_drives(acceleration);
  while (saturate_drives()) {
    load_drives();
    accelerate(position, rate, acceleration, is_placed);
    measure_drives(acceleration);
  }
}

void ArticulationDynamics::begin_drive_sums() {
  for (Drive &drive : drives) drive.mean_impulse = drive.work = 0;
}

// Adds `time` s of the step with the forces of the last evaluation, at the rates there.
void ArticulationDynamics::add_drive_sums(btScalar time, const Rate &rate) {
  if (drive_step == 0) return;
  for (Drive &drive : drives) {
    const btScalar impulse = drive.impulse * (time / drive_step);
    drive.mean_impulse += impulse;
    drive.work += impulse * rate.q[drive.coordinate];
  }
}

// Lets limits act that the step passes and leaves with a rate that leads on, although the accelerations at its beginning did
// not. Returns whether there are such limits.
bool ArticulationDynamics::catch_limits(btScalar h, const Position &from, const Position &to, const Rate &rate) {
  bool caught = false;
  const auto check = [&](Drive &drive) {
    const int k = drive.coordinate;
    const bool is_reached = drive.bounds_rate() || drive.gap + drive.side * (to.q[k] - from.q[k]) < 0;
    if (!is_reached || drive.side * (rate.q[k] - drive.target) >= 0) return false;
    drive.start_state = Drive::State::Free;
    caught = true;
    return true;
  };
  for (Drive &drive : drives) {
    if (drive.side != 0 && !is_free(drive) && drive.gap >= 0) check(drive);
  }
  for (const DistantLimits &limits : distant_limits) {
    const int k = limits.coordinate;
    const btScalar way = to.q[k] - from.q[k], speed = rate.q[k];
    const auto add = [&](btScalar side, btScalar target, btScalar gap) {
      Drive drive = limit(k, limits.is_angle, side, side * target, gap);
      if (check(drive)) drives.push_back(drive);
    };
    if (speed < -limits.backward) add(1, -limits.backward, BT_LARGE_FLOAT);
    if (speed > limits.forward) add(-1, -limits.forward, BT_LARGE_FLOAT);
    if (limits.below + way < 0) add(1, -limits.below / h, limits.below);
    if (limits.above - way < 0) add(-1, -limits.above / h, limits.above);
  }
  return caught;
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
