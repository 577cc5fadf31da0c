// Parameters of the position correction, and the velocity bias of joints by the curvature of their motion. C++ only.
#ifndef AMB_POSITION_ERROR_H
#define AMB_POSITION_ERROR_H

#include <LinearMath/btVector3.h>

#include <algorithm>

// Velocities up to this count as 0, m/s or rad/s.
constexpr double NO_SPEED = 1e-14;
// Bounds of impulses beyond this are infinite, N s or N m s.
constexpr btScalar UNBOUNDED = 1e9;
// Largest correction velocity of joints and of bodies, m/s and rad/s, and of violated limits.
constexpr btScalar MAX_CORRECTION_SPEED = 10, MAX_CORRECTION_RATE = 50, MAX_RETURN_SPEED = 1, MAX_RETURN_RATE = 5;
// Share of the violation of a limit that is corrected in a sub-step.
constexpr btScalar LIMIT_ERP = 0.2;
// Largest turn of a body or joint by a correction, rad: the rows are linear in the motion.
constexpr btScalar MAX_CORRECTION_TURN = 0.05;
// The position problem is solved only if the correction velocity of a joint exceeds MIN_CORRECTION, m/s or rad/s, or
// the penetration depth of a contact exceeds MIN_DEPTH, m.
constexpr double MIN_CORRECTION = 1e-6;
constexpr btScalar MIN_DEPTH = 1e-5;
// Errors below URGENT_CORRECTION times these thresholds are corrected in every CORRECTION_INTERVAL-th sub-step only.
constexpr double URGENT_CORRECTION = 20;
constexpr unsigned CORRECTION_INTERVAL = 4;
// CFM of the position problem as a share of the response of joints, and of the diagonal of contacts and limits:
// infeasible rows end in a least-squares compromise, in which contacts and limits yield to joints and grips. It is at
// least LEAST_POSITION_SOFTNESS of the diagonal.
constexpr double POSITION_SOFTNESS = 1e-6, YIELDING_POSITION_SOFTNESS = 1e-4, LEAST_POSITION_SOFTNESS = 1e-12;
// CFM of stiff springs, as a share of their response, and the share below which the implicit CFM of a spring falls
// towards it; and the same for soft springs, which are stiffer than what moves with them, and softer than contacts.
constexpr double SPRING_POSITION_SOFTNESS = 1e-7, STIFF_SPRING = 10;
constexpr double SOFT_SPRING_POSITION_SOFTNESS = 1e-3, SOFT_SPRING = 1000;
// Largest turn in a sub-step for which the motion of joint frames is approximated to second order, rad.
constexpr btScalar MAX_CURVED_TURN = 0.3;

// Largest angular velocity of a correction in a sub-step of h s, rad/s, where jointed bodies turn at up to `turn_rate`
// rad/s. Fast motion opens joints fast.
inline btScalar max_correction_rate(btScalar h, btScalar turn_rate) {
  return std::min(std::max(MAX_CORRECTION_RATE, turn_rate), MAX_CORRECTION_TURN / h);
}

// Push-out (depenetration) velocity of a contact, m/s: RATE (1/s) times the penetration depth (m), clamped to
// [MIN_SPEED, MAX_SPEED].
inline btScalar push_out_speed(btScalar depth) {
  constexpr btScalar RATE = 10, MIN_SPEED = 0.05, MAX_SPEED = 1;
  return std::min(std::max(depth * RATE, MIN_SPEED), MAX_SPEED);
}

// CFM in the position problem of a spring whose implicit row has the CFM `cfm` and the response `response`. A spring
// that is stiff for the sub-step resists like a joint. With its implicit CFM it would resist each correction by the
// force of that correction alone, without those of the corrections before, and many of them would strain it.
inline double spring_position_softness(double cfm, double response) {
  const auto falling = [&](double from, double least) {
    const double share = response > 0 ? std::min(1.0, cfm / (response * from)) : 1;
    return std::max(least * response, cfm * share * share * share * share);
  };
  const double stiff = falling(STIFF_SPRING, SPRING_POSITION_SOFTNESS);
  return std::min({cfm, stiff, falling(SOFT_SPRING, SOFT_SPRING_POSITION_SOFTNESS)});
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
