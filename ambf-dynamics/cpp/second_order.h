// Second-order (leapfrog) integration of bodies with constraints. C++ only.
#ifndef AMB_SECOND_ORDER_H
#define AMB_SECOND_ORDER_H

#include <BulletDynamics/ConstraintSolver/btContactSolverInfo.h>
#include <BulletDynamics/Dynamics/btRigidBody.h>

#include <cmath>

#include "internal.h"
#include "solve_three.h"
#include "spin_energy.h"

// Bullet adds the forces at a pose to the velocity, v' = v + a h, and then the velocity to the pose, x += v' h. This is
// the leapfrog method, of second order in h, if velocities are those halfway between two poses. For that, forces act
// from the middle of the last sub-step to that of the next, for half of the first sub-step after a pose was set, and
// the gyroscopic torque is evaluated at the pose. Free bodies are integrated more exactly, see flight.h.
// Share of a sub-step of h s for which forces act on a body with constraints.
inline btScalar force_share(const AmbBody &body, btScalar h) { return (body.last_sub_step + h) / (2 * h); }

template <class Base>
class SecondOrder : public Base {
 public:
  using Base::Base;

 protected:
  void convertBodies(btCollisionObject **bodies, int n, const btContactSolverInfo &info) override {
    Base::convertBodies(bodies, n, info);
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      btSolverBody &row = this->m_tmpSolverBodyPool[i];
      AmbBody *owner = constrained_body_of(row);
      if (!owner) {
        set_small_gyroscopic_torque(row, info.m_timeStep);
        bound_gyroscopic_torque(row, info.m_timeStep);
        continue;
      }
      const btRigidBody &body = owner->body;
      const btScalar h = info.m_timeStep;
      if (body.getFlags() & BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_BODY) {
        const btVector3 forced = body.getInvInertiaTensorWorld() * body.getTotalTorque() * h;
        btVector3 turned;
        // What other torques did in the last sub-step tells about this one where the body turns little.
        constexpr btScalar LITTLE_TURN = 0.1;
        const btScalar turn = std::max(row.m_angularVelocity.length(), owner->other_angular_change.length()) * h;
        btScalar kept = owner->last_sub_step > 0 ? h / owner->last_sub_step : 1;
        if (turn > LITTLE_TURN) kept = 0;
        const FastSpin fast(body, row.m_angularVelocity, body.getWorldTransform().getBasis(), h);
        if (fast.is_fast) {
          turned = precession(body, fast, h);
          row.m_externalTorqueImpulse = forced + turned;
        } else if (gyroscopic_change(body, owner->other_angular_change * kept, h, turned)) {
          row.m_externalTorqueImpulse = forced + turned;
        } else {
          bound_gyroscopic_torque(row, h);
          turned = row.m_externalTorqueImpulse - forced;
        }
        owner->other_angular_change = -turned;
      }
      const btScalar share = force_share(*owner, h);
      row.m_externalForceImpulse *= share;
      row.m_externalTorqueImpulse *= share;
      owner->other_angular_change *= share;
    }
  }

  btScalar solveGroupCacheFriendlyFinish(btCollisionObject **bodies, int n, const btContactSolverInfo &info) override {
    for (int i = 0; i < this->m_tmpSolverBodyPool.size(); ++i) {
      btSolverBody &row = this->m_tmpSolverBodyPool[i];
      AmbBody *owner = constrained_body_of(row);
      if (!owner) continue;
      owner->other_angular_change += row.internalGetDeltaAngularVelocity() + row.m_externalTorqueImpulse;
      owner->other_angular_change /= force_share(*owner, info.m_timeStep);
      owner->last_sub_step = info.m_timeStep;
    }
    return Base::solveGroupCacheFriendlyFinish(bodies, n, info);
  }

 private:
  // Bullet computes none for a body of which the product of the principal moments is below SIMD_EPSILON, see solve_three.h.
  static void set_small_gyroscopic_torque(btSolverBody &row, btScalar h) {
    if (!row.m_originalBody || !(row.m_originalBody->getFlags() & BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_BODY)) return;
    const btRigidBody &body = *row.m_originalBody;
    const btVector3 &inverse = body.getInvInertiaDiagLocal();
    constexpr btScalar MARGIN = 10;
    btVector3 turned;
    if (inverse.x() * inverse.y() * inverse.z() * SIMD_EPSILON * MARGIN < 1) return;
    if (!gyroscopic_change(body, btVector3(0, 0, 0), h, turned)) return;
    row.m_externalTorqueImpulse = body.getInvInertiaTensorWorld() * body.getTotalTorque() * h + turned;
  }

  // Bullet solves the equation of the implicit gyroscopic torque by one step of Newton's method, which adds energy where
  // the body turns far in h s.
  static void bound_gyroscopic_torque(btSolverBody &row, btScalar h) {
    const btVector3 &omega = row.m_angularVelocity;
    if (!row.m_originalBody || row.m_originalBody->getInvMass() <= 0 || omega.length() * h <= FAR_TURN) return;
    const btRigidBody &body = *row.m_originalBody;
    const btMatrix3x3 &basis = body.getWorldTransform().getBasis();
    const btVector3 forced = body.getInvInertiaTensorWorld() * body.getTotalTorque() * h;
    const btVector3 turned = omega + (row.m_externalTorqueImpulse - forced);
    const btScalar before = spin_energy(body, omega, basis), after = spin_energy(body, turned, basis);
    if (!(after > before && std::isfinite(after))) return;
    row.m_externalTorqueImpulse = forced + turned * btSqrt(before / after) - omega;
  }

  static AmbBody *constrained_body_of(const btSolverBody &row) {
    AmbBody *owner = row.m_originalBody && row.m_originalBody->getInvMass() > 0 ? body_of(row.m_originalBody) : nullptr;
    return owner && owner->constraint_count > 0 ? owner : nullptr;
  }

  // Change of the angular velocity about the other axes of a body with a fast spin, rad/s: it turns with the axis about the
  // angular momentum, slower than the spin by the ratio of the moments of inertia. The spin follows its axis, see
  // complete_turn in free_flight.cpp.
  static btVector3 precession(const btRigidBody &body, const FastSpin &fast, btScalar h) {
    const btVector3 &inverse = body.getInvInertiaDiagLocal();
    const btScalar others = (inverse.x() + inverse.y() + inverse.z() - inverse[fast.axis]) / 2;
    const btScalar ratio = inverse[fast.axis] > 0 ? others / inverse[fast.axis] : 0;
    return fast.tilt.rotate(fast.direction, ratio * fast.spin * h) - fast.tilt;
  }

  // Finds the change d of the angular velocity w by the gyroscopic torque, rad/s: I d = -h v x I v at the mean v = w +
  // d / 2 + other / 2 of the velocities before and after, where `other`, the change by other torques, is that of the
  // last sub-step. Without other torques it conserves the kinetic energy. Returns false if Newton's method does not
  // converge because the body turns too far in h.
  static bool gyroscopic_change(const btRigidBody &body, const btVector3 &other, btScalar h, btVector3 &change) {
    const btVector3 &inverse = body.getInvInertiaDiagLocal();
    if (!(inverse.x() > 0 && inverse.y() > 0 && inverse.z() > 0)) return false;
    const btVector3 inertia(1 / inverse.x(), 1 / inverse.y(), 1 / inverse.z());
    const btMatrix3x3 &pose = body.getWorldTransform().getBasis();
    const btVector3 start = (body.getAngularVelocity() + other * btScalar(0.5)) * pose;
    btVector3 d(0, 0, 0);
    for (int round = 0; round < 4; ++round) {
      const btVector3 v = start + d * btScalar(0.5), momentum = inertia * v;
      const btVector3 rest = inertia * d + v.cross(momentum) * h;
      if (rest.length2() <= btScalar(1e-28) * momentum.length2()) {
        change = pose * d;
        return true;
      }
      // Half of h times the derivative of v x I v by v, plus I.
      btMatrix3x3 slope, by_momentum;
      v.getSkewSymmetricMatrix(&slope[0], &slope[1], &slope[2]);
      momentum.getSkewSymmetricMatrix(&by_momentum[0], &by_momentum[1], &by_momentum[2]);
      for (int i = 0; i < 3; ++i) {
        slope[i] = (slope[i] * inertia - by_momentum[i]) * (h / 2);
        slope[i][i] += inertia[i];
      }
      d -= solve_three(slope, rest);
    }
    return false;
  }
};

#endif
