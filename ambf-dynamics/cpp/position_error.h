// Parameters of position errors, and the velocity bias of joints by the curvature of their motion. C++ only.
#ifndef AMB_POSITION_ERROR_H
#define AMB_POSITION_ERROR_H

#include <LinearMath/btVector3.h>

#include <algorithm>

// Bounds of impulses beyond this are infinite, N s or N m s.
constexpr btScalar UNBOUNDED = 1e9;
// Largest correction velocity of violated limits, m/s and rad/s.
constexpr btScalar MAX_RETURN_SPEED = 1, MAX_RETURN_RATE = 5;
// Share of the violation of a limit that is corrected in a sub-step.
constexpr btScalar LIMIT_ERP = 0.2;
// Largest turn in a sub-step for which the motion of joint frames is approximated to second order, rad.
constexpr btScalar MAX_CURVED_TURN = 0.3;

// Push-out (depenetration) velocity of a contact, m/s: RATE (1/s) times the penetration depth (m), clamped to
// [MIN_SPEED, MAX_SPEED].
inline btScalar push_out_speed(btScalar depth) {
  constexpr btScalar RATE = 10, MIN_SPEED = 0.05, MAX_SPEED = 1;
  return std::min(std::max(depth * RATE, MIN_SPEED), MAX_SPEED);
}

// Velocity bias of a joint by the curvature of its motion. Bodies move along tangents, x += v h, so that the two pivots
// of a joint separate by terms of second order in h: h^2 (w_B x (w_B x r_B) - w_A x (w_A x r_A) - 2 w_A x u) / 2, where
// r is the arm from the centre of mass to the pivot and u is the velocity of B's pivot relative to A; the axes of a
// hinge do correspondingly. The bias that compensates this is the centripetal acceleration times h / 2 and is part of
// the motion (leapfrog method): without it rotating loops would lose energy. It is computed from the velocities and not
// from the gap, so that infeasible joints add no energy to the motion.
class JointMotion {
 public:
  // Adds a row that constrains a position, by the linear and angular part of its Jacobian for both bodies.
  void add_row(const btVector3 &linear_a, const btVector3 &angular_a, const btVector3 &linear_b,
               const btVector3 &angular_b) {
    if (linear_a.isZero()) {
      if (angular_rows < 2) axes[angular_rows] = angular_a;
      ++angular_rows;
      return;
    }
    if (linear_rows < 2) normals[linear_rows] = linear_a;
    ++linear_rows;
    // n x (r x n) is the component of r orthogonal to n.
    arm_a += linear_a.cross(angular_a);
    arm_b += linear_b.cross(angular_b);
  }

  // To be called after all rows were added, with the velocities of both bodies, m/s and rad/s, the sub-step in s and,
  // if they are known, the arms from the centres of mass to the pivot, m. Arms computed from Bullet's rows mix both
  // pivots.
  void finish(const btVector3 &velocity_a, const btVector3 &omega_a, const btVector3 &velocity_b,
              const btVector3 &omega_b, btScalar h, const btVector3 *known_a = nullptr,
              const btVector3 *known_b = nullptr) {
    half_step = h / 2;
    const btScalar turn = std::max(omega_a.length(), omega_b.length()) * h;
    // For larger turns the second-order term overestimates the separation.
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
    acceleration =
        omega_b.cross(omega_b.cross(arm_b)) - omega_a.cross(omega_a.cross(arm_a)) - omega_a.cross(sliding) * 2;
    if (angular_rows == 2) {
      const btVector3 axis = axes[0].cross(axes[1]);
      tilting = omega_a.cross(axis) * omega_a.dot(axis) - omega_b.cross(axis) * omega_b.dot(axis);
    }
  }

  // Bias of a linear row whose Jacobian has this linear part for body B, m/s.
  btScalar linear_target(const btVector3 &linear_b) const { return -half_step * linear_b.dot(acceleration); }
  // Bias of an angular row whose Jacobian has this angular part for body A, rad/s.
  btScalar angular_target(const btVector3 &angular_a) const { return half_step * angular_a.dot(tilting); }

 private:
  int linear_rows = 0, angular_rows = 0;
  btVector3 normals[2], axes[2];
  btVector3 arm_a{0, 0, 0}, arm_b{0, 0, 0};
  btVector3 acceleration{0, 0, 0}, tilting{0, 0, 0};
  btScalar half_step = 0;
};

#endif
