// Levenberg–Marquardt damping of the position correction. C++ only.
//
// A correction is a Gauss-Newton step towards the least weighted sum of squares of the position errors, damped by the CFM
// of the position problem. Where the errors are infeasible (a loop that cannot close, a limit that excludes what the
// joints allow), such steps diverge along motions that hardly change the errors: with infeasible errors r, the curvature
// k of the joints and the change s of the errors by a unit motion, each step multiplies the distance from the least sum
// by r k / s^2. The sign of this are corrections that leave much of the errors, and after most of which these are larger
// than before, and larger than what is left and what loads open by the CFM of the joints. The CFM is then raised, and
// lowered again while this does not happen (Nocedal and Wright, Numerical Optimization, 2006, ch. 10). In fast motion
// errors grow as well, but there a correction removes most of them; the small infeasible errors of redundant loops grow
// and fall from step to step, so that several growths are needed where the errors are small. Damped corrections leave
// more of what loads and motion open in each sub-step, so that errors may also grow because of the damping: it is not
// raised where they exceed MOST_DAMPED of the lever arm, or rad.
#ifndef AMB_CORRECTION_DAMPING_H
#define AMB_CORRECTION_DAMPING_H

#include <algorithm>

#include "extension.h"
#include "infeasible_islands.h"

// A correction is solved again with more damping, up to MOST_ROUNDS times, while it is more than LONG_CORRECTION times as
// long as bodies may move: near singular configurations small errors are corrected by large motions, for which the rows
// are no longer valid. Change of the damping factor then, and the factor from which on it is not raised for that.
constexpr btScalar LONG_CORRECTION = 3;
constexpr int MOST_ROUNDS = 3;
constexpr double RAISED_DAMPING = 10, MOST_DAMPING_OF_LONG_CORRECTIONS = 1e3;

// Updates the factor by which the CFM of the next position problem is multiplied. `present` are the errors before it,
// `largest` that of a joint, m or rad, and `share` the largest one as a share of its lever arm, or rad; in the sub-steps
// between two corrections, at most `interval`, they were not corrected.
inline void update_damping(CorrectionDamping &damping, const PositionErrors &present, double largest, double share,
                           unsigned sub_step, unsigned interval) {
  // Growths of the errors, less the times that they did not grow, from which corrections count as diverging, where the
  // largest error exceeds LARGE (m or rad) and otherwise; their largest number. A growth: by the factor GROWTH of a sum of
  // squares, of which the last correction left the share INFEASIBLE. Change of the damping factor otherwise; largest
  // factor.
  constexpr int DIVERGING_LARGE = 1, DIVERGING_SMALL = 6, MOST_GROWTHS = 8;
  constexpr double LARGE = 1e-3, MOST_DAMPED = 0.01;
  constexpr double GROWTH = 1.02, INFEASIBLE = 0.25, LOWERED = 1 / 1.2, MOST = 1e4;
  const bool is_known = damping.sub_step > 0 && sub_step - damping.sub_step <= interval;
  const double now[2] = {present.linear, present.angular};
  bool has_grown = false;
  for (int k = 0; k < 2; ++k) {
    const double before = damping.expected[k];
    has_grown = has_grown || (now[k] > GROWTH * before && damping.left[k] >= INFEASIBLE);
    damping.expected[k] = now[k];
  }
  damping.growths = is_known ? std::clamp(damping.growths + (has_grown ? 1 : -1), 0, MOST_GROWTHS) : 0;
  const bool diverges =
      share <= MOST_DAMPED && damping.growths >= (largest > LARGE ? DIVERGING_LARGE : DIVERGING_SMALL);
  damping.factor = is_known ? std::clamp(damping.factor * (diverges ? RAISED_DAMPING : LOWERED), 1.0, MOST) : 1;
  damping.sub_step = sub_step;
}

// Whether errors that only a long motion lowers are left alone. `sum`: of their squares over the responses, kg m^2. A heavy
// body that hangs on a light one is also corrected by long motions alone, and its load opens the joints further in each
// sub-step. So errors are corrected when the sum is beyond LEFT_ALONE_GROWTH times the least one that was left alone.
inline bool leave_alone(CorrectionDamping &damping, double sum) {
  constexpr double LEFT_ALONE_GROWTH = 2;
  const double least = damping.left_alone;
  if (least > 0 && sum > LEFT_ALONE_GROWTH * least) return false;
  damping.left_alone = least > 0 ? std::min(least, sum) : sum;
  return true;
}

// Contacts, limits and springs that contradict joints are to yield to them. The least sum of squares weights errors with
// the masses, so that a contact of heavy bodies opens the joints of light ones, and stiff springs resist a correction like
// joints do. The CFM of contacts, limits and springs is raised for that, by YIELDING_RAISED at a time up to MOST_YIELDING,
// while a correction lowers the sum of squares of the joints' errors by less than the share LEAST_LOWERED and leaves of
// them more than CONTRADICTING times that of the others. Where not even that lowers the joints' errors, the joints
// contradict each other: contacts, limits and springs then do not yield for UNYIELDING sub-steps, because joints would
// press bodies into each other, and strain springs, for nothing.
constexpr unsigned UNYIELDING = 64;
constexpr double YIELDING_RAISED = 10, YIELDING_LOWERED = 1 / 1.2, MOST_YIELDING = 1e4;
constexpr double LEAST_LOWERED = 0.1, CONTRADICTING = 0.01;

// Whether contacts, limits and springs may yield in this sub-step.
inline bool may_yield(const CorrectionDamping &damping, unsigned sub_step) {
  return damping.yielded_in_vain == 0 || sub_step - damping.yielded_in_vain >= UNYIELDING;
}

// `asked` and `left`: sums of squares of the joints' errors before a correction and after it; `others`: of the contacts'
// and limits' before it.
inline bool contacts_open_joints(double asked, double left, double others) {
  return left > CONTRADICTING * others && left > (1 - LEAST_LOWERED) * asked && others > 0;
}

// Whether springs may yield where joints are open by up to `share` of their lever arms, or rad. Corrections strain springs
// that yield.
inline bool springs_yield(double share) {
  constexpr double LEAST_OPENED = 0.005;
  return share > LEAST_OPENED;
}
// As `contacts_open_joints` for springs, which resist corrections and have no errors.
inline bool springs_open_joints(double asked, double left) { return left > (1 - LEAST_LOWERED) * asked; }

#endif
