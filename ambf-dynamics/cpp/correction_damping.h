// Levenberg–Marquardt damping of the position correction. C++ only.
//
// A correction is a Gauss-Newton step towards the least weighted sum of squares of the position errors, damped by the CFM
// of the position problem. Where the errors are infeasible (a loop that cannot close, a limit that excludes what the
// joints allow), such steps diverge along motions that hardly change the errors: with infeasible errors r, the curvature
// k of the joints and the change s of the errors by a unit motion, each step multiplies the distance from the least sum
// by r k / s^2. Their sign is that the errors are larger after a correction, which the linear model excludes. The CFM is
// then raised, and lowered again while the errors do not grow (Nocedal and Wright, Numerical Optimization, 2006, ch. 10).
// In motion the errors grow for other reasons, too; the CFM of joints is then raised from 1e-6 of the diagonal by a
// few orders, which stiff directions do not feel.
#ifndef AMB_CORRECTION_DAMPING_H
#define AMB_CORRECTION_DAMPING_H

#include <algorithm>

#include "extension.h"
#include "infeasible_islands.h"

// Factor by which the CFM of the next position problem is multiplied. `asked` are the errors before it; in the sub-steps
// between two corrections, at most `interval`, they were not corrected.
inline double update_damping(CorrectionDamping &damping, const PositionErrors &asked, unsigned sub_step,
                             unsigned interval) {
  // Growth of a sum of squares from one correction to the next, change of the factor after growth and without, and its
  // largest value.
  constexpr double GROWTH = 1.02, RAISED = 10, LOWERED = 1 / 1.2, MOST = 1e4;
  const bool is_known = damping.sub_step > 0 && sub_step - damping.sub_step <= interval;
  const bool has_grown = asked.linear > GROWTH * damping.linear || asked.angular > GROWTH * damping.angular;
  const double factor = !is_known ? 1 : std::clamp(damping.factor * (has_grown ? RAISED : LOWERED), 1.0, MOST);
  damping = {factor, asked.linear, asked.angular, sub_step};
  return factor;
}

#endif
