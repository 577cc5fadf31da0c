// Drives (motors, controllers, drives of bodies) that yield to joints in the velocity problem. C++ only.
//
// Drives are rows with bounds, and files give them bounds that are far beyond anything their bodies can bear. Where
// drives contradict joints (motors of a closed loop that ask for different velocities, a mechanism without degrees of
// freedom), a joint yields by its CFM times its impulse, and opens faster than the position problem can close it. The
// CFM of the drives is then raised, until the joints hold.
#ifndef AMB_DRIVE_YIELDING_H
#define AMB_DRIVE_YIELDING_H

#include <algorithm>

class DriveYielding {
 public:
  // Whether drives are to yield more, where joints open by `opened` of their lever arms, or rad, in a sub-step.
  static bool is_wanted(double yielding, double opened) { return opened > MOST_OPENED && yielding < MOST; }
  static double raised(double yielding) { return std::min(std::max(yielding, 1.0) * RAISED, MOST); }
  // After a sub-step that did not need more. It stays where it is just enough.
  static double lowered(double yielding, double opened) {
    if (opened > LOWERED * MOST_OPENED) return yielding;
    return yielding * LOWERED < 1 ? 0 : yielding * LOWERED;
  }

 private:
  // Opening that is allowed in a sub-step. The yielding is the CFM of drives as a multiple of that of joints of the same
  // response, or 0: its change where it is raised and lowered, and its largest value.
  static constexpr double MOST_OPENED = 1e-6, RAISED = 10, LOWERED = 1 / 1.2, MOST = 1e6;
};

#endif
