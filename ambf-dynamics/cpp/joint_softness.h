// CFM of the joints of rigid bodies in the velocity problem. C++ only.
//
// A row turns with its bodies, by the angle theta = h |w_a - w_b| relative to each other in a sub-step of h s. Where a
// loop goes through a singular configuration some combination of its rows hardly moves any body: its response is s^2 of
// that of the rows, with s of the order of the angle to the singular configuration. Where s < theta it is a constraint of
// a part of the sub-step only. Fully imposed, it turns the error that the curvature leaves into a velocity 1 / s times as
// large, and the loop goes on along another branch. With a CFM of theta^2 of the response a such combinations are left to
// the inertia, and all others are imposed. The CFM is
//
//   a max(LEAST, min(theta^2, MOST, LOADED / (a M))),
//
// with the mass M of the heaviest body of the island, or M r^2 for angular rows with the longest lever arm r of the
// island's joints: under the acceleration g of that body the joint opens by at most LOADED g h, m/s, or, where 1 / a is
// small beside M, as for a heavy body on a light link, by LEAST a M g h. A spring or motor with the force F counts as a
// body of the mass F / g.
#ifndef AMB_JOINT_SOFTNESS_H
#define AMB_JOINT_SOFTNESS_H

#include <algorithm>

class JointSoftness {
 public:
  // least: LEAST.
  explicit JointSoftness(double least) : least_(least) {}

  // A body of the island, or a link that it touches, kg.
  void add_body(double mass) { heaviest_ = std::max(heaviest_, mass); }
  // Impulse of a spring or motor at a joint of the island in the last sub-step of h s, N s.
  void add_drive(double impulse, double h) { heaviest_ = std::max(heaviest_, impulse / (GRAVITY * h)); }
  // Lever arm of a joint of the island, m.
  void add_arm(double arm) { longest_ = std::max(longest_, arm); }

  // response: a, 1/kg, or of an angular row 1/(kg m^2). turn_squared: theta^2.
  double cfm(double response, bool is_angular, double turn_squared) const {
    const double load = is_angular ? heaviest_ * longest_ * longest_ : heaviest_;
    const double moving = std::min(turn_squared, MOST) * response;
    return std::max(least_ * response, load > 0 ? std::min(moving, LOADED / load) : moving);
  }

 private:
  static constexpr double MOST = 1e-6, LOADED = 2e-6, GRAVITY = 9.81;

  double least_, heaviest_ = 0, longest_ = 0;
};

#endif
