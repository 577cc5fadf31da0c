// The rows of an island as its position problem has them, and the sums of their errors. C++ only.
#ifndef AMB_POSITION_ROWS_H
#define AMB_POSITION_ROWS_H

#include <algorithm>
#include <cmath>
#include <utility>

#include "../include/ambf_mlcp.h"
#include "correction_damping.h"
#include "position_error.h"

class PositionRows {
 public:
  // A row constrains a position on both sides (joint), on one side (limit, contact), or is a motor, spring or friction.
  enum class Kind { Geometric, Limit, Contact, Other };

  void clear() {
    rows_.clear();
    states_.clear();
    needs_correction_ = is_urgent_ = false;
  }

  // Adds the next row. `arm`: lever arm of the joint, m, 0: not known; `least_correction`: the correction velocity below
  // which the error is not corrected, m/s or rad/s.
  void add(const AmbMlcpRow &row, Kind kind, bool is_angular, double least_correction, double arm) {
    const bool is_low = row.low == 0 && row.position_target < 0, is_high = row.high == 0 && row.position_target > 0;
    const bool counts = row.in_positions && !is_low && !is_high;
    // Weight in the sum of squared errors: the inverse of the CFM in the position problem, as the solution has it.
    const double cfm = row.is_drive ? row.position_cfm : std::max(row.cfm, row.position_cfm);
    const double weight = row.position_cfm > 0 ? POSITION_SOFTNESS / cfm : 0;
    const double target = counts ? row.position_target : 0;
    const bool is_joint = kind == Kind::Geometric && !row.is_drive;
    const bool is_contact = kind == Kind::Contact;
    rows_.push_back({target, weight, row.cfm, is_angular, is_joint, is_contact, is_contact ? CONTACT_ARM : arm});
    states_.push_back(is_low ? AMB_MLCP_LOW : is_high ? AMB_MLCP_HIGH : AMB_MLCP_FREE);
    if (!counts) return;
    const double asked = std::fabs(row.position_target) / least_correction;
    needs_correction_ = needs_correction_ || asked > 1;
    // Limits are corrected at once: drives may push against them in every sub-step.
    is_urgent_ = is_urgent_ || asked > URGENT_CORRECTION || (asked > 1 && kind == Kind::Limit);
  }

  // Whether a row has a position error that is to be corrected in this sub-step.
  bool are_due(unsigned sub_step) const {
    return needs_correction_ && (is_urgent_ || sub_step % CORRECTION_INTERVAL == 0);
  }

  // Guess of the active set of the position problem.
  const unsigned char *states() const { return states_.data(); }

  // Of what is to be corrected in this sub-step.
  PositionErrors asked() const {
    return sums([&](size_t i) { return rows_[i].target; });
  }
  // `left`, here and below: what the position problem leaves of the targets, one a row.
  PositionErrors after(const double *left) const {
    return sums([&](size_t i) { return left[i]; });
  }

  // Twice the kinetic energy of the pseudo-velocities of the position problem that was solved, J, for the least damping:
  // the sum of the impulses, which are the errors left over the CFM, times the velocities of the rows.
  double correction_energy(const double *left) const {
    double sum = 0;
    for (size_t i = 0; i < rows_.size(); ++i) {
      const Row &row = rows_[i];
      sum += row.weight * left[i] * (row.target - left[i]);
    }
    return sum / POSITION_SOFTNESS;
  }

  // By how much the joints of the island open, and its contacts close, by their CFM in a sub-step of h s, as a share of their
  // lever arms, or rad, with the impulses `impulses`.
  double opening(const double *impulses, double h) const {
    double largest = 0;
    for (size_t i = 0; i < rows_.size(); ++i) {
      const Row &row = rows_[i];
      if (!(row.is_joint ? row.is_angular || row.arm > 0 : row.is_contact)) continue;
      const double opened = h * row.cfm * std::fabs(impulses[i]);
      largest = std::max(largest, row.is_angular ? opened : opened / row.arm);
    }
    return largest;
  }

 private:
  struct Row {
    // Correction velocity asked for in this sub-step, m/s or rad/s.
    double target;
    double weight;
    // In the velocity problem.
    double cfm;
    bool is_angular, is_joint, is_contact;
    // Lever arm of the joint, m; 0: not known.
    double arm;
  };

  // Length that stands for the lever arm at contacts, m: what drives press into each other is corrected at a rate of 10/s and
  // stays some 1e-5 m deep.
  static constexpr double CONTACT_ARM = 0.01;

  template <class ErrorOf>
  PositionErrors sums(ErrorOf error_of) const {
    PositionErrors sums;
    for (size_t i = 0; i < rows_.size(); ++i) {
      const Row &row = rows_[i];
      sums.add(error_of(i), row.weight, row.is_angular);
    }
    return sums;
  }

  Vector<Row> rows_;
  Vector<unsigned char> states_;
  // Whether a row has a position error that is to be corrected, and one that is to be corrected in this sub-step.
  bool needs_correction_ = false, is_urgent_ = false;
};

#endif
