// The angular coordinates of a six-dof spring that is elastic about all three axes, in worlds of AmbSolver_Accurate.
// C++ only.
#ifndef AMB_SPRING_ROTATION_H
#define AMB_SPRING_ROTATION_H

#include <BulletDynamics/ConstraintSolver/btGeneric6DofSpring2Constraint.h>

// The rotation vector phi, rad, from the rest orientation of B to its present one: R = R_A R_0 exp([phi]), where R_0 is
// the rest orientation of B in A. The elastic energy sum k_i phi_i^2 / 2 is a continuous function of the orientation,
// also at |phi| = pi, where phi changes its sign. The energy of Bullet's Euler angles jumps where an angle wraps and
// where the middle angle is pi / 2, and the axes of Bullet's torques are not the gradients of the angles.
//
// With w the angular velocity of B relative to A, d phi / dt = J(phi) (R_A R_0)^T w, where
//   J(phi) = 1 - [phi] / 2 + c [phi]^2,   c = (1 - (t / 2) cot(t / 2)) / t^2,   t = |phi|
// (J. Sola, J. Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics, 2018, eq. 146: the inverse of
// the left Jacobian).
struct SpringRotation {
  btVector3 phi;
  // Row i, in world axes: d phi_i / dt = gradient[i] . w.
  btMatrix3x3 gradient;

  // Whether these coordinates apply to a spring: it is elastic about all three axes. For springs about one or two axes,
  // with the others free or locked, Bullet's angles are used.
  static bool holds_for(const btGeneric6DofSpring2Constraint &spring) {
    auto &it = const_cast<btGeneric6DofSpring2Constraint &>(spring);
    for (int i = 0; i < 3; ++i) {
      if (!it.getRotationalLimitMotor(i)->m_enableSpring) return false;
    }
    return true;
  }

  explicit SpringRotation(const btGeneric6DofSpring2Constraint &spring) {
    const btMatrix3x3 &a = spring.getCalculatedTransformA().getBasis(),
                      &b = spring.getCalculatedTransformB().getBasis();
    const btMatrix3x3 rest = a * rest_of(spring);
    btQuaternion q;
    (rest.transpose() * b).getRotation(q);
    if (q.w() < 0) q = -q;
    const btVector3 v(q.x(), q.y(), q.z());
    const btScalar sine = v.length(), t = 2 * btAtan2(sine, q.w());
    // sin(t/2) / t and c for small t, to fourth order.
    const bool is_small = t < btScalar(1e-3);
    phi = v * (is_small ? 2 * (1 + t * t / 24) : t / sine);
    const btScalar c = is_small ? btScalar(1) / 12 + t * t / 720 : (1 - t / 2 * q.w() / sine) / (t * t);
    btMatrix3x3 cross;
    cross.setValue(0, -phi.z(), phi.y(), phi.z(), 0, -phi.x(), -phi.y(), phi.x(), 0);
    const btMatrix3x3 square = cross * cross;
    btMatrix3x3 jacobian = btMatrix3x3::getIdentity();
    for (int i = 0; i < 3; ++i) jacobian[i] += square[i] * c - cross[i] / 2;
    gradient = jacobian * rest.transpose();
  }

 private:
  // For Bullet's angles x, y, z the rotation of B relative to A is (R_x(x) R_y(y) R_z(z))^T.
  static btMatrix3x3 rest_of(const btGeneric6DofSpring2Constraint &spring) {
    auto &it = const_cast<btGeneric6DofSpring2Constraint &>(spring);
    btMatrix3x3 turned = btMatrix3x3::getIdentity();
    for (int i = 0; i < 3; ++i) {
      const btRotationalLimitMotor2 &axis = *it.getRotationalLimitMotor(i);
      if (axis.m_equilibriumPoint == 0) continue;
      btVector3 unit(0, 0, 0);
      unit[i] = 1;
      turned = turned * btMatrix3x3(btQuaternion(unit, axis.m_equilibriumPoint));
    }
    return turned.transpose();
  }
};

#endif
