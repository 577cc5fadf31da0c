// Damping of the position correction. C++ only.
//
// A correction is a Gauss-Newton step towards the least weighted sum of squares of the position errors, damped by the CFM
// of the position problem.
#ifndef AMB_CORRECTION_DAMPING_H
#define AMB_CORRECTION_DAMPING_H

#include "extension.h"

// A correction is solved again with more damping, up to MOST_ROUNDS times, while it is more than LONG_CORRECTION times as
// long as bodies may move: near singular configurations small errors are corrected by large motions, for which the rows
// are no longer valid. Change of the damping factor then and otherwise, and the factor from which on it is not raised.
//
// Errors that grow although they are corrected are no reason to raise it: damped corrections leave more of what loads and
// fast motion open in each sub-step, errors grow because of that, and the damping would never fall again.
constexpr btScalar LONG_CORRECTION = 3;
constexpr int MOST_ROUNDS = 3;
constexpr double RAISED_DAMPING = 10, LOWERED_DAMPING = 1 / 1.2, MOST_DAMPING = 1e3;

// Contacts and limits that contradict joints are to yield to them. The least sum of squares weights errors with the
// masses, so that a contact of heavy bodies opens the joints of light ones. The CFM of contacts and limits is raised for
// that, by YIELDING_RAISED at a time up to MOST_YIELDING, while a correction lowers the sum of squares of the joints'
// errors by less than the share LEAST_LOWERED and leaves of them more than CONTRADICTING times that of the others.
constexpr double YIELDING_RAISED = 10, YIELDING_LOWERED = 1 / 1.2, MOST_YIELDING = 1e4;
constexpr double LEAST_LOWERED = 0.1, CONTRADICTING = 0.01;

// `asked` and `left`: sums of squares of the joints' errors before a correction and after it; `others`: of the contacts'
// and limits' before it.
inline bool contacts_open_joints(double asked, double left, double others) {
  return left > CONTRADICTING * others && left > (1 - LEAST_LOWERED) * asked && others > 0;
}

#endif
