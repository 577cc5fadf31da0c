// Kinetic energy that an approximate solution of the velocity problem may leave. C++ only.
//
// At one position forces and impulses p change the kinetic energy by p (v_0 + v_1) / 2, with the velocities v_0 before
// the sub-step and v_1 after it, and constraints without drives do no work. An exact solution keeps to that. The objective
// that an approximation lowers is the kinetic energy beyond that of the motion under the external forces alone, which has
// much more than these forces can give where they act on bodies of next to no inertia that joints hold.
#ifndef AMB_APPROXIMATION_ENERGY_H
#define AMB_APPROXIMATION_ENERGY_H

#include <BulletDynamics/ConstraintSolver/btSolverBody.h>

#include <algorithm>
#include <cmath>

#include "spin_energy.h"

class ApproximationEnergy {
 public:
  // A body with its velocities before the sub-step, the change by external forces and that by the solution.
  void add(const btSolverBody &body) {
    const btRigidBody &owner = *body.m_originalBody;
    const btMatrix3x3 &basis = body.m_worldTransform.getBasis();
    const btVector3 pushed = body.m_externalForceImpulse / owner.getInvMass();
    const btVector3 linear = body.m_linearVelocity + body.m_externalForceImpulse + body.m_deltaLinearVelocity;
    const btVector3 angular =
        body.m_angularVelocity + body.m_externalTorqueImpulse + body.m_deltaAngularVelocity;
    before_ += energy(owner, body.m_linearVelocity, body.m_angularVelocity, basis);
    after_ += energy(owner, linear, angular, basis);
    work_before_ += pushed.dot(body.m_linearVelocity) / 2;
    work_after_ += pushed.dot(linear) / 2;
    const btVector3 &inverse = owner.getInvInertiaDiagLocal(), twist = body.m_externalTorqueImpulse * basis;
    const btVector3 start = body.m_angularVelocity * basis, end = angular * basis;
    for (int k = 0; k < 3; ++k) {
      if (inverse[k] <= 0) continue;
      work_before_ += twist[k] * start[k] / inverse[k] / 2;
      work_after_ += twist[k] * end[k] / inverse[k] / 2;
    }
  }

  // A drive with the impulse p, N s or N m s, that moves at these speeds before and after.
  void add_drive(double impulse, double before, double after) {
    work_before_ += impulse * before / 2;
    work_after_ += impulse * after / 2;
  }

  // Factor of all velocities with which the kinetic energy is that at the beginning and the work; 1 unless it is more by a
  // share of SLACK.
  double scale() const {
    constexpr double SLACK = 0.1;
    const double given = std::max(before_ + work_before_, 0.0);
    if (!(after_ > (1 + SLACK) * (given + std::max(work_after_, 0.0)))) return 1;
    // after s^2 = given + work_after s.
    const double half = work_after_ / (2 * after_);
    return std::min(half + std::sqrt(half * half + given / after_), 1.0);
  }

 private:
  static double energy(const btRigidBody &body, const btVector3 &linear, const btVector3 &angular,
                       const btMatrix3x3 &basis) {
    return linear.length2() / (2 * body.getInvMass()) + spin_energy(body, angular, basis);
  }

  double before_ = 0, after_ = 0, work_before_ = 0, work_after_ = 0;
};

#endif
