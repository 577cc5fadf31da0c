// How errors of position are corrected: tuned numbers, and which part of a joint's error belongs to its motion. C++ only.
#ifndef AMB_POSITION_ERROR_H
#define AMB_POSITION_ERROR_H

#include <LinearMath/btVector3.h>

#include <algorithm>

// Velocity that counts as none at any scale, m/s or rad/s.
constexpr double NO_SPEED = 1e-14;
// Bounds beyond this are none, N s or N m s.
constexpr btScalar UNBOUNDED = 1e9;
// Fastest correction of a joint or loop, m/s and rad/s, and of what is beyond a limit.
constexpr btScalar MAX_CORRECTION_SPEED = 10, MAX_CORRECTION_RATE = 50, MAX_RETURN_SPEED = 1, MAX_RETURN_RATE = 5;
// The problem of positions is solved in sub-steps in which a joint asks for a faster correction than this, m/s or rad/s, or a contact is
// deeper than this, m.
constexpr double MIN_CORRECTION = 1e-6;
constexpr btScalar MIN_DEPTH = 1e-5;
// Errors of joints and contacts below this multiple of those are corrected in every so many sub-steps only.
constexpr double URGENT_CORRECTION = 20;
constexpr unsigned CORRECTION_INTERVAL = 4;
// CFM of the position problem as a share of the diagonal, of joints and of contacts: contradictory rows share what cannot be reached, and
// joints and grips are the stiffer ones.
constexpr double POSITION_SOFTNESS = 1e-6, CONTACT_POSITION_SOFTNESS = 1e-4;
// Largest softness, as a share of the diagonal, of a row that holds a position rather than drives.
constexpr btScalar MAX_GEOMETRIC_SOFTNESS = 1e-3;
// Largest angle a sub-step for which the motion of a joint's frames is taken for a parabola, rad.
constexpr btScalar MAX_CURVED_TURN = 0.3;

// Push-out velocity of a contact of that penetration depth, m/s: proportional to it, between bounds.
inline btScalar push_out_speed(btScalar depth) {
  constexpr btScalar RATE = 10, MIN_SPEED = 0.05, MAX_SPEED = 1;
  return std::min(std::max(depth * RATE, MIN_SPEED), MAX_SPEED);
}

// Bodies move along tangents, x += v h, so that the frames of a joint part by terms of second order in h: by
// h^2 (w_B x (w_B x r_B) - w_A x (w_A x r_A) - 2 w_A x u) / 2 at the pivot, where r leads from the centre of mass to the pivot and u is the
// velocity of B's pivot in A, and by the like for the axis of a hinge. The velocity that undoes this is the centripetal one in the middle of the
// sub-step and belongs to the motion (leapfrog method): without it turning loops would lose energy. It is predicted from the velocities and
// not from the gap, so that joints which cannot be closed do not feed energy into the motion.
class JointMotion {
 public:
  // A row that holds a position: its Jacobian, linear and angular part on either body.
  void add_row(const btVector3 &linear_a, const btVector3 &angular_a, const btVector3 &linear_b, const btVector3 &angular_b) {
    if (linear_a.isZero()) {
      if (angular_rows < 2) axes[angular_rows] = angular_a;
      ++angular_rows;
      return;
    }
    if (linear_rows < 2) normals[linear_rows] = linear_a;
    ++linear_rows;
    // n x (r x n) is the part of r across n.
    arm_a += linear_a.cross(angular_a);
    arm_b += linear_b.cross(angular_b);
  }

  // After all rows; velocities of the centres of mass, m/s and rad/s, step in s, and the arms from the centres of mass to the pivot, m, if they
  // are known: those of Bullet's rows are mixtures of both pivots.
  void finish(const btVector3 &velocity_a, const btVector3 &omega_a, const btVector3 &velocity_b, const btVector3 &omega_b, btScalar h,
              const btVector3 *known_a = nullptr, const btVector3 *known_b = nullptr) {
    half_step = h / 2;
    const btScalar turn = std::max(omega_a.length(), omega_b.length()) * h;
    // For larger turns this is no parabola.
    if (turn > MAX_CURVED_TURN) half_step *= MAX_CURVED_TURN * MAX_CURVED_TURN / (turn * turn);
    if (linear_rows == 3) {
      arm_a *= btScalar(0.5);
      arm_b *= btScalar(0.5);
    } else if (linear_rows == 2) {
      const btVector3 free = normals[0].cross(normals[1]);
      arm_a -= free * (free.dot(arm_a) / 2);
      arm_b -= free * (free.dot(arm_b) / 2);
    }
    if (known_a) arm_a = *known_a;
    if (known_b) arm_b = *known_b;
    const btVector3 sliding = velocity_b + omega_b.cross(arm_b) - velocity_a - omega_a.cross(arm_a);
    acceleration = omega_b.cross(omega_b.cross(arm_b)) - omega_a.cross(omega_a.cross(arm_a)) - omega_a.cross(sliding) * 2;
    if (angular_rows == 2) {
      const btVector3 axis = axes[0].cross(axes[1]);
      tilting = omega_a.cross(axis) * omega_a.dot(axis) - omega_b.cross(axis) * omega_b.dot(axis);
    }
  }

  // Target of a row with that linear part on body B, m/s.
  btScalar linear_target(const btVector3 &linear_b) const { return -half_step * linear_b.dot(acceleration); }
  // Target of a row with that angular part on body A, rad/s.
  btScalar angular_target(const btVector3 &angular_a) const { return half_step * angular_a.dot(tilting); }

 private:
  int linear_rows = 0, angular_rows = 0;
  btVector3 normals[2], axes[2];
  btVector3 arm_a{0, 0, 0}, arm_b{0, 0, 0};
  btVector3 acceleration{0, 0, 0}, tilting{0, 0, 0};
  btScalar half_step = 0;
};

#endif
