// Levenberg–Marquardt damping of the position correction, and corrections that are not made. C++ only.
//
// A correction is a Gauss-Newton step towards the least weighted sum of squares of the position errors, damped by the CFM
// of the position problem (Nocedal and Wright, Numerical Optimization, 2006, ch. 10).
#ifndef AMB_CORRECTION_DAMPING_H
#define AMB_CORRECTION_DAMPING_H

#include <algorithm>

#include <LinearMath/btScalar.h>

// A correction is solved again with RAISED_DAMPING times the damping, up to MOST_ROUNDS times, while it is more than
// LONG_CORRECTION times as long as bodies may move: near singular configurations small errors are corrected by large
// motions, for which the rows are no longer valid.
constexpr btScalar LONG_CORRECTION = 3;
constexpr int MOST_ROUNDS = 3;
constexpr double RAISED_DAMPING = 10;

// Sums of squares of the correction velocities of an island's rows, over their responses, J: the parts of the sum that
// the position problem minimises.
struct PositionErrors {
  double linear = 0, angular = 0;

  void add(double error, double weight, bool is_angular) { (is_angular ? angular : linear) += weight * error * error; }
};

// Whether a correction lowers neither sum by more than the share LEAST_DECREASE, or one only at the expense of the other.
// It is not applied: the remaining errors are infeasible.
inline bool is_uncorrectable(const PositionErrors &asked, const PositionErrors &left) {
  constexpr double LEAST_DECREASE = 0.02;
  const double linear = asked.linear - left.linear, angular = asked.angular - left.angular;
  const auto is_lowered = [both = linear + angular](double decrease, double before) {
    return std::min(decrease, both) > LEAST_DECREASE * before;
  };
  return !is_lowered(linear, asked.linear) && !is_lowered(angular, asked.angular);
}

// Whether a correction is a long motion that hardly lowers the errors: it leaves most of the sum of squares `asked`, J, and
// lowers it by less than SOFT of twice the kinetic energy of its pseudo-velocities, `moved`, J. This is the square of the
// sine of the angle between the motion and those that the rows allow, as a mean over the rows.
inline bool is_soft(const PositionErrors &asked, const PositionErrors &left, double moved) {
  constexpr double SOFT = 1e-3, MOSTLY = 0.7;
  const double before = asked.linear + asked.angular, after = left.linear + left.angular;
  return after > MOSTLY * before && before - after < SOFT * moved;
}

#endif
