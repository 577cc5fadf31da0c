#include "free_flight.h"

#include "engine.h"
#include "spin_energy.h"

#include <cmath>

namespace {

// Damping at rate c (1/s) over h s: factor exp(-c h), integral of exp(-c t) over t from 0 to h (s), and its double
// integral (s^2).
struct DampingIntegrals {
  btScalar factor, integral, double_integral;

  DampingIntegrals(btScalar c, btScalar h) {
    const btScalar x = c * h;
    if (x < btScalar(1e-2)) {
      // Power series; the closed forms cancel for small x.
      factor = std::exp(-x);
      integral = h * (1 - x / 2 * (1 - x / 3 * (1 - x / 4 * (1 - x / 5 * (1 - x / 6)))));
      double_integral = h * h / 2 * (1 - x / 3 * (1 - x / 4 * (1 - x / 5 * (1 - x / 6))));
    } else {
      factor = std::exp(-x);
      integral = -std::expm1(-x) / c;
      double_integral = (h - integral) / c;
    }
  }
};

// Decay rate, 1/s, for Bullet's damping: the share of the velocity lost in 1 s; infinite for 1.
btScalar rate_of(btScalar damping) { return -std::log1p(-damping); }

// One Newton step towards the nearest rotation matrix, so that rounding errors do not accumulate.
btMatrix3x3 orthonormal(const btMatrix3x3 &m) {
  btMatrix3x3 rest = m.transposeTimes(m) * btScalar(-0.5);
  for (int i = 0; i < 3; ++i) rest[i][i] += btScalar(1.5);
  return m * rest;
}

btVector3 divided(const btVector3 &a, const btVector3 &b) {
  return btVector3(a.x() / b.x(), a.y() / b.y(), a.z() / b.z());
}

// Attitude relative to that at the start of the sub-step and angular velocity in body axes (rad/s), or their time
// derivatives.
struct RotationState {
  btQuaternion attitude;
  btVector3 velocity;

  RotationState after(const RotationState &slope, btScalar h) const {
    return {attitude + slope.attitude * h, velocity + slope.velocity * h};
  }
};

// One Runge-Kutta step of `rotate_rk4`.
RotationState rotate_rk4_step(const btVector3 &velocity, const btVector3 &inertia, const btVector3 &torque,
                              btScalar left, btScalar h) {
  const auto slope = [&](const RotationState &spin, btScalar kept) -> RotationState {
    const btVector3 &v = spin.velocity;
    btVector3 change = (inertia * v).cross(v) * kept;
    if (!torque.isZero()) change += quatRotate(spin.attitude.inverse(), torque) / kept;
    return {spin.attitude * btQuaternion(v.x(), v.y(), v.z(), 0) * (kept / 2), divided(change, inertia)};
  };
  const btScalar half = btSqrt(left);
  const RotationState start = {btQuaternion::getIdentity(), velocity};
  const RotationState k1 = slope(start, 1), k2 = slope(start.after(k1, h / 2), half),
                      k3 = slope(start.after(k2, h / 2), half), k4 = slope(start.after(k3, h), left);
  RotationState end = start.after(k1, h / 6).after(k2, h / 3).after(k3, h / 3).after(k4, h / 6);
  end.attitude.normalize();
  end.velocity *= left;
  return end;
}

// The same in equal parts.
RotationState rotate_in_parts(const btVector3 &velocity, const btVector3 &inertia, const btVector3 &torque,
                              btScalar left, btScalar h, int parts) {
  if (parts == 1) return rotate_rk4_step(velocity, inertia, torque, left, h);
  const btScalar part_left = std::pow(left, btScalar(1) / parts);
  RotationState end = {btQuaternion::getIdentity(), velocity};
  for (int i = 0; i < parts; ++i) {
    const RotationState next =
        rotate_rk4_step(end.velocity, inertia, quatRotate(end.attitude.inverse(), torque), part_left, h / parts);
    end = {end.attitude * next.attitude, next.velocity};
  }
  return end;
}

// Integrates Euler's equations by the classical Runge-Kutta method, in several parts if the body turns by more than
// MAX_TURN, at the velocity before the sub-step or with what the torque gives it. Damping multiplies the angular
// velocity by `left` over h exactly: the integrated variable is the angular velocity divided by the damping factor.
// Returns false if the body turns too far for the method.
bool rotate_rk4(const btVector3 &velocity, const btVector3 &inertia, const btVector3 &torque, btScalar left, btScalar h,
                RotationState &end) {
  // Largest turn of one Runge-Kutta step, rad; the relative error of the angular momentum is 1e-6 after a thousand
  // turns. The method is unstable from 2.8 rad on.
  constexpr btScalar MAX_TURN = 0.05, MAX_INACCURATE_TURN = 0.5;
  constexpr int MAX_PARTS = 1000;
  btScalar turn = std::max(velocity.length(), (velocity + divided(torque, inertia) * h).length()) * h;
  for (;;) {
    if (!(turn <= MAX_PARTS * MAX_INACCURATE_TURN)) return false;
    const int parts = std::min(static_cast<int>(std::ceil(turn / MAX_TURN)), MAX_PARTS);
    end = rotate_in_parts(velocity, inertia, torque, left, h, std::max(parts, 1));
    // The torque may turn towards an axis of less inertia.
    const btScalar turned = end.velocity.length() * h;
    if (turned <= 2 * turn + MAX_TURN) return true;
    turn = turned;
  }
}

}  // namespace

void save_sub_step_starts(AmbWorld &world) {
  const btCollisionObjectArray &objects = world.world->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    AmbBody *owner = body_of(objects[i]);
    if (!owner || owner->articulation || owner->body.isStaticOrKinematicObject()) continue;
    owner->start = {owner->body.getWorldTransform(), owner->body.getLinearVelocity(), owner->body.getAngularVelocity()};
  }
}

bool integrate_free_body(btRigidBody &body, const SubStepStart &start, btScalar h) {
  const btScalar damping = body.getLinearDamping(), mass_inverse = body.getInvMass();
  if (damping >= 1 || body.getAngularDamping() >= 1) return false;
  const btVector3 acceleration = body.getTotalForce() * mass_inverse,
                  damped = start.linear_velocity * std::pow(1 - damping, h);
  // If the velocity differs from that under force and damping, something else acted on the body.
  const btVector3 difference = body.getLinearVelocity() - damped - acceleration * h;
  const btScalar scale = damped.length() + acceleration.length() * h;
  if (!(difference.length() <= btScalar(1e-12) * scale)) return false;
  // If the displacement differs from v h, the body was stopped by continuous collision detection or moved by a position
  // correction.
  const btVector3 &origin = start.pose.getOrigin(), way = body.getLinearVelocity() * h;
  const btVector3 stopped = body.getWorldTransform().getOrigin() - origin - way;
  if (!(stopped.length() <= btScalar(1e-9) * way.length() + btScalar(1e-12) * origin.length())) return false;

  const DampingIntegrals integrals(rate_of(damping), h);
  btTransform pose = body.getWorldTransform();
  pose.setOrigin(start.pose.getOrigin() + start.linear_velocity * integrals.integral +
                 acceleration * integrals.double_integral);
  btVector3 angular_velocity = body.getAngularVelocity();
  const btVector3 &inverse = body.getInvInertiaDiagLocal();
  constexpr int GYROSCOPIC = BT_ENABLE_GYROSCOPIC_FORCE_EXPLICIT | BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_WORLD |
                             BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_BODY;
  const bool turns = inverse.x() > 0 && inverse.y() > 0 && inverse.z() > 0;
  if (turns && (body.getFlags() & GYROSCOPIC)) {
    const btMatrix3x3 &from = start.pose.getBasis();
    RotationState end;
    if (!rotate_rk4(start.angular_velocity * from, divided(btVector3(1, 1, 1), inverse), body.getTotalTorque() * from,
                    std::pow(1 - body.getAngularDamping(), h), h, end)) {
      return false;
    }
    pose.setBasis(orthonormal(from * btMatrix3x3(end.attitude)));
    angular_velocity = pose.getBasis() * end.velocity;
  }
  const btVector3 velocity = start.linear_velocity * integrals.factor + acceleration * integrals.integral;
  if (!finite(pose.getOrigin() + pose.getBasis()[0] + velocity + angular_velocity)) return false;
  body.setLinearVelocity(velocity);
  body.setAngularVelocity(angular_velocity);
  body.setCenterOfMassTransform(pose);
  return true;
}

namespace {

void before_sub_step(btDynamicsWorld *dynamics, btScalar dt) {
  auto &world = *static_cast<AmbWorld *>(dynamics->getWorldUserInfo());
  if (world.soft) before_soft_sub_step(dynamics, dt);
  save_sub_step_starts(world);
}

// A body with contacts turns at the angular velocity that it has at its old orientation. Where it turns far, that
// angular velocity is another motion at the new one, about axes of other inertia: the kinetic energy must not grow by that.
void bound_spin_energy(AmbBody &owner, btScalar h) {
  btRigidBody &body = owner.body;
  const btVector3 &omega = body.getAngularVelocity();
  if (!(omega.length() * h > FAR_TURN)) return;
  const btScalar before = spin_energy(body, omega, owner.start.pose.getBasis());
  const btScalar after = spin_energy(body, omega, body.getWorldTransform().getBasis());
  if (!(after > before && std::isfinite(after))) return;
  const btScalar kept = btSqrt(before / after);
  body.setAngularVelocity(omega * kept);
  owner.other_angular_change *= kept;
}

// A body with joints that spins fast turns about its own axis as far as it spins, and this axis tilts as the joints have it;
// the spin follows its axis. Bullet turns it about its angular velocity, by at most pi / 4.
void complete_turn(AmbBody &owner, btScalar h) {
  btRigidBody &body = owner.body;
  if (!(body.getFlags() & BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_BODY)) return;
  const btVector3 omega = body.getAngularVelocity();
  const btScalar rate = omega.length();
  if (!(rate * h > FAR_TURN && std::isfinite(rate))) return;
  const btScalar turned = std::min(rate * h, btScalar(ANGULAR_MOTION_THRESHOLD));
  const btMatrix3x3 before = btMatrix3x3(btQuaternion(omega / rate, -turned)) * body.getWorldTransform().getBasis();
  const FastSpin fast(body, omega, before, h);
  if (!fast.is_fast) return;
  btVector3 axis(0, 0, 0);
  axis[fast.axis] = 1;
  btMatrix3x3 tilt = btMatrix3x3::getIdentity();
  const btScalar tilted = fast.tilt.length();
  if (tilted > 0) tilt = btMatrix3x3(btQuaternion(fast.tilt / tilted, tilted * h));
  btTransform pose = body.getWorldTransform();
  pose.setBasis(orthonormal(tilt * before * btMatrix3x3(btQuaternion(axis, std::remainder(fast.spin * h, 2 * SIMD_PI)))));
  body.setAngularVelocity(fast.tilt + tilt * fast.direction * fast.spin);
  body.setCenterOfMassTransform(pose);
}

// After a sub-step: replaces the new state of every free body by that of the integrator.
void correct_free_bodies(btDynamicsWorld *dynamics, btScalar dt) {
  auto &world = *static_cast<AmbWorld *>(dynamics->getWorldUserInfo());
  EngineWorld &engine = engine_of(world);
  const uint64_t now = ++engine.sub_step;
  for (int i = 0; i < world.dispatcher.getNumManifolds(); ++i) {
    const btPersistentManifold *manifold = world.dispatcher.getManifoldByIndexInternal(i);
    if (manifold->getNumContacts() == 0 || !responds(*manifold)) continue;
    for (const btCollisionObject *object : {manifold->getBody0(), manifold->getBody1()}) {
      if (AmbBody *body = body_of(object)) body->contact_sub_step = now;
    }
  }
  const btCollisionObjectArray &objects = dynamics->getCollisionObjectArray();
  for (int i = 0; i < objects.size(); ++i) {
    AmbBody *owner = body_of(objects[i]);
    if (!owner || owner->articulation) continue;
    btRigidBody &body = owner->body;
    if (!body.isActive() || body.isStaticOrKinematicObject()) continue;
    if (owner->constraint_count > 0 && engine.integrator == AmbIntegrator_RungeKutta) complete_turn(*owner, dt);
    if (owner->constraint_count > 0 || owner->drive) continue;
    if (owner->contact_sub_step == now) {
      if (engine.integrator == AmbIntegrator_RungeKutta) bound_spin_energy(*owner, dt);
      continue;
    }
    if (engine.integrator == AmbIntegrator_RungeKutta) {
      if (!integrate_free_body(body, owner->start, dt)) continue;
      owner->free_flight_sub_step = now;
      owner->solved_velocity[0] = body.getLinearVelocity();
      owner->solved_velocity[1] = body.getAngularVelocity();
      continue;
    }
    owner->free_flight_sub_step = now;
    const btVector3 back = body.getTotalForce() * (body.getInvMass() * dt * dt / 2);
    btTransform pose = body.getWorldTransform();
    pose.setOrigin(pose.getOrigin() - back);
    body.setWorldTransform(pose);
    body.setInterpolationWorldTransform(pose);
  }
}

}  // namespace

extern "C" {

void amb_world_set_trees_by_euler(AmbWorld *world, int by_euler) { engine_of(*world).trees_by_euler = by_euler != 0; }

void amb_world_set_integrator(AmbWorld *world, int integrator) {
  engine_of(*world).integrator = integrator;
  engine_of(*world).accurate.exact_flight = integrator != AmbIntegrator_Euler;
  world->world->setInternalTickCallback(integrator == AmbIntegrator_Euler ? nullptr : correct_free_bodies, world);
  const btInternalTickCallback soft = world->soft ? before_soft_sub_step : nullptr;
  world->world->setInternalTickCallback(integrator == AmbIntegrator_RungeKutta ? before_sub_step : soft, world, true);
}

}  // extern "C"
