// Islands whose errors of position contradict each other. C++ only.
#ifndef AMB_INFEASIBLE_ISLANDS_H
#define AMB_INFEASIBLE_ISLANDS_H

#include "arena_memory.h"

// Weighted sums of squares of what the rows of an island ask for in positions, (m/s)^2 and (rad/s)^2.
struct PositionErrors {
  double linear = 0, angular = 0;

  void add(double error, double weight, bool is_angular) { (is_angular ? angular : linear) += weight * error * error; }
  // Whether both are at most this multiple of the others.
  bool within(double factor, const PositionErrors &other) const {
    return linear <= factor * other.linear && angular <= factor * other.angular;
  }
};

class InfeasibleIslands {
 public:
  // A correction that leaves more than this share of both sums is not made: what is left contradicts itself.
  static constexpr double UNCORRECTABLE = 0.98;

  static bool is_uncorrectable(const PositionErrors &asked, const PositionErrors &left) {
    return left.linear >= UNCORRECTABLE * asked.linear && left.angular >= UNCORRECTABLE * asked.angular;
  }

  // Leaves an island as it is for some sub-steps. The island is known by something that stays what it is from one to the next.
  void add(const void *island, const PositionErrors &errors, unsigned sub_step) { islands_.push_back({island, errors, sub_step + INTERVAL}); }

  void clear() { islands_.clear(); }

  // Whether the errors of an island are those, but for little, for which it was left.
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
  // Sub-steps after which a correction is looked for again, and the factor of a sum from which it is before.
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
