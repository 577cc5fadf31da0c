// Islands whose position constraints are infeasible. C++ only.
#ifndef AMB_INFEASIBLE_ISLANDS_H
#define AMB_INFEASIBLE_ISLANDS_H

#include <algorithm>

#include "arena_memory.h"

// Sums of squares of the correction velocities of an island's rows, over their responses, J: the parts of the sum that
// the position problem minimises.
struct PositionErrors {
  double linear = 0, angular = 0;

  void add(double error, double weight, bool is_angular) { (is_angular ? angular : linear) += weight * error * error; }
  // Whether both sums are at most `factor` times those of `other`.
  bool within(double factor, const PositionErrors &other) const {
    return linear <= factor * other.linear && angular <= factor * other.angular;
  }
};

class InfeasibleIslands {
 public:
  // A correction that lowers neither sum by more than this share, or one only at the expense of the other, is not applied:
  // the remaining errors are infeasible.
  static constexpr double LEAST_DECREASE = 0.02;

  static bool is_uncorrectable(const PositionErrors &asked, const PositionErrors &left) {
    const double linear = asked.linear - left.linear, angular = asked.angular - left.angular;
    const auto is_lowered = [both = linear + angular](double decrease, double before) {
      return std::min(decrease, both) > LEAST_DECREASE * before;
    };
    return !is_lowered(linear, asked.linear) && !is_lowered(angular, asked.angular);
  }

  // Whether a correction is a long motion that hardly lowers the errors: it leaves most of the sum of squares `asked`, J, and
  // lowers it by less than SOFT of twice the kinetic energy of its pseudo-velocities, `moved`, J. This is the square of the
  // sine of the angle between the motion and those that the rows allow, as a mean over the rows. yields: springs yield
  // to the correction, which strains them the more the longer it is.
  static bool is_soft(const PositionErrors &asked, const PositionErrors &left, double moved, bool yields) {
    constexpr double SOFT = 1e-3, SOFT_OF_YIELDING = 0.02, MOSTLY = 0.7;
    const double before = asked.linear + asked.angular, after = left.linear + left.angular;
    return after > MOSTLY * before && before - after < (yields ? SOFT_OF_YIELDING : SOFT) * moved;
  }

  // Disables the position correction of an island for INTERVAL sub-steps. `island` identifies it in consecutive
  // sub-steps.
  void add(const void *island, const PositionErrors &errors, unsigned sub_step) {
    islands_.push_back({island, errors, sub_step + INTERVAL});
  }

  void clear() { islands_.clear(); }

  // Whether the correction of an island is disabled and its errors have not grown by more than the factor GROWTH since.
  bool contain(const void *island, const PositionErrors &errors, unsigned sub_step) {
    for (size_t i = 0; i < islands_.size();) {
      const Settled &it = islands_[i];
      const bool is_over = it.until <= sub_step;
      if (it.island == island && !is_over && errors.within(GROWTH, it.errors)) return true;
      if (it.island == island || is_over) {
        islands_[i] = islands_.back();
        islands_.pop_back();
      } else {
        ++i;
      }
    }
    return false;
  }

 private:
  // Sub-steps after which the correction is tried again, and the growth of a sum at which it is tried earlier.
  static constexpr unsigned INTERVAL = 16;
  static constexpr double GROWTH = 1.2;

  struct Settled {
    const void *island;
    PositionErrors errors;
    unsigned until;
  };
  Vector<Settled> islands_;
};

#endif
