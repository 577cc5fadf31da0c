// Drives (motors, controllers, springs, drives of bodies) that yield to joints and contacts in the velocity problem. C++ only.
//
// Files give motors bounds, and springs strains and stiffnesses, that are far beyond anything their bodies can bear. Where
// such drives contradict joints (motors of a closed loop that ask for different velocities, a spring on a mechanism
// without degrees of freedom) or contacts (jaws that close on a wall), a joint yields by its CFM times its impulse, and opens
// faster than the position problem can close it. The CFM of the drives is then raised, until the joints hold. Where that does
// not help, joints open for other reasons, such as loops with more constraints than they need whose dimensions are inaccurate,
// and drives do not yield for a while.
#ifndef AMB_DRIVE_YIELDING_H
#define AMB_DRIVE_YIELDING_H

#include <algorithm>

class DriveYielding {
 public:
  // CFM of drives that yield by 1, as a share of their response.
  static constexpr double SOFTNESS = 1e-7;
  // Whether drives are to yield more, where joints open by `opened` of their lever arms, or rad, in a sub-step.
  static bool is_wanted(double yielding, double opened) { return opened > MOST_OPENED && yielding < MOST; }
  // Whether it did not help that drives yield up to the most: joints opened by `unyielding` without. Drives that yielded in
  // the last sub-step are not tried without: they did help when they began to.
  static bool is_in_vain(double unyielding, double opened) { return opened > MOST_OPENED && opened > unyielding / 2; }
  // Whether drives may yield in this sub-step, where it did not help in the sub-step `in_vain`; 0: none.
  static bool is_allowed(unsigned in_vain, unsigned sub_step) { return in_vain == 0 || sub_step - in_vain >= UNYIELDING; }
  // With a drive that is much softer than the joint the opening is in inverse proportion to its CFM.
  static double raised(double yielding, double opened) {
    return std::min(std::max(yielding, 1.0) * std::max(opened / MOST_OPENED, LEAST_RAISED), MOST);
  }
  // After a sub-step that did not need more. It stays where it is just enough.
  static double lowered(double yielding, double opened) {
    if (opened > LOWERED * MOST_OPENED) return yielding;
    return yielding * LOWERED < 1 ? 0 : yielding * LOWERED;
  }

 private:
  // Opening that is allowed in a sub-step. The yielding is a multiple of SOFTNESS, or 0: its least change where it is
  // raised, its change where it is lowered, and its largest value.
  static constexpr double MOST_OPENED = 1e-5, LEAST_RAISED = 2, LOWERED = 1 / 1.2, MOST = 1e5;
  // Sub-steps for which drives do not yield again.
  static constexpr unsigned UNYIELDING = 64;
};

#endif
