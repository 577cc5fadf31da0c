// Kinetic energy of the rotation of rigid bodies. C++ only.
#ifndef AMB_SPIN_ENERGY_H
#define AMB_SPIN_ENERGY_H

#include <BulletDynamics/Dynamics/btRigidBody.h>

// Turn in a sub-step, rad, from which on methods that are accurate for small turns may add energy.
constexpr btScalar FAR_TURN = 0.3;

// Kinetic energy of the rotation of a body that turns at `omega`, rad/s, in this orientation, J. An axis of infinite
// inertia does not count.
inline btScalar spin_energy(const btRigidBody &body, const btVector3 &omega, const btMatrix3x3 &basis) {
  const btVector3 &inverse = body.getInvInertiaDiagLocal(), v = omega * basis;
  btScalar twice = 0;
  for (int k = 0; k < 3; ++k) twice += inverse[k] > 0 ? v[k] * v[k] / inverse[k] : 0;
  return twice / 2;
}

// Splits the angular velocity of a body that spins by more than FAR_TURN in h s about its axis of least inertia, and turns
// slowly otherwise. Such a motion is not resolved: it is a spin about an axis that tilts.
struct FastSpin {
  bool is_fast = false;
  int axis = 0;               // of the body
  btScalar spin = 0;          // rad/s
  btVector3 direction, tilt;  // of the axis; angular velocity about other axes, rad/s

  FastSpin(const btRigidBody &body, const btVector3 &omega, const btMatrix3x3 &basis, btScalar h) {
    if (!(omega.length() * h > FAR_TURN)) return;
    axis = body.getInvInertiaDiagLocal().maxAxis();
    direction = basis.getColumn(axis);
    spin = omega.dot(direction);
    tilt = omega - direction * spin;
    is_fast = btFabs(spin) * h > FAR_TURN && tilt.length() * h < FAR_TURN;
  }
};

#endif
