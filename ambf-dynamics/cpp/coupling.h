// Implementation of couplings, see couple.h. C++ only.
//
// The error of a coupling is g(q) = sum of factors times coordinates - offset, in which the factor of the follower is 1. It
// is to be 0. Angles are known up to whole turns: those of the leaders are counted, and the follower's is the one next to
// what its leaders ask for.
#ifndef AMB_COUPLING_H
#define AMB_COUPLING_H

#include "internal.h"

// Largest number of couplings of an articulation, whose rows are all made orthogonal, and of rigid bodies that couplings make one
// in the MLCP problem. What has more is solved by sequential impulses.
constexpr int MAX_COUPLED = 100;

struct AmbCoupling;

// Makes bodies of a coupling parts of one island; it has no rows.
class CouplingLink : public btTypedConstraint {
 public:
  // Its user constraint type, by which it is known among constraints.
  static constexpr int USER_TYPE = 0x636f7570;

  CouplingLink(AmbCoupling &owner, btRigidBody &a, btRigidBody &b)
      : btTypedConstraint(D6_CONSTRAINT_TYPE, a, b), coupling(owner) {
    setUserConstraintType(USER_TYPE);
  }

  void getInfo1(btConstraintInfo1 *info) override { info->m_numConstraintRows = info->nub = 0; }
  void getInfo2(btConstraintInfo2 *) override {}
  void setParam(int, btScalar, int) override {}
  btScalar getParam(int, int) const override { return 0; }

  AmbCoupling &coupling;
};

// How the coordinate of a hinge or slider follows from the poses of its bodies A and B: the coordinate (rad or m; of a hinge in
// [-pi, pi]), and its derivatives by their velocities and angular velocities, world axes.
struct CoordinateRow {
  btScalar coordinate = 0;
  btVector3 linear[2] = {{0, 0, 0}, {0, 0, 0}}, angular[2] = {{0, 0, 0}, {0, 0, 0}};
};
CoordinateRow coordinate_row(const AmbConstraint &joint);

struct AmbCoupling {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  struct Term {
    AmbConstraint *joint;
    btScalar factor;
    // Coordinate at the last look, with all its turns, rad or m.
    btScalar last = 0;
  };

  // Adds the turns that are missing to the coordinates of the terms, rad or m: to those of the leaders the ones of the last
  // look or, within limits, those next to their middle; with `has_jumped`, those by which the coupling is closed. `q(i)` is
  // the coordinate of term i. Returns the error.
  template <class Coordinate>
  btScalar complete(Coordinate q, bool has_jumped);
  // The coordinate that the leaders give the follower, rad or m.
  template <class Coordinate>
  btScalar wanted(Coordinate q) const {
    btScalar sum = offset;
    for (size_t i = 1; i < terms.size(); ++i) sum -= terms[i].factor * q(i);
    return sum;
  }
  bool is_angle(size_t i) const { return terms[i].joint->kind == Kind::Hinge; }
  // Whether one of its joints is on a body.
  bool moves(const AmbBody &body) const;
  // The articulation of which all its joints are; else null.
  AmbArticulation *articulation() const;
  // Brings its links into the world, or takes them out of it: they are there while it is a row of the solver.
  void follow_articulation(AmbWorld &world);
  // Forgets the motion, and with it all turns.
  void reset();

  // The first is the follower.
  Vector<Term> terms;
  btScalar offset = 0;
  Vector<std::unique_ptr<CouplingLink>> links;
  bool is_linked = false;
  // Poses were set since the last look.
  bool has_jumped = false;
  // Impulse of the row in the last sub-step, N s or N m s, and whether it is known.
  btScalar guess = 0;
  bool is_known = false;

 private:
  template <class Coordinate>
  void close_by_turns(Coordinate q);
};

template <class Coordinate>
btScalar AmbCoupling::complete(Coordinate q, bool jumped) {
  const btScalar turn = 2 * SIMD_PI;
  for (size_t i = 1; i < terms.size(); ++i) {
    const SoftMotor &motor = terms[i].joint->motor;
    if (!is_angle(i)) continue;
    if (motor.low <= motor.high) {
      q(i) = motor.coordinate_of(q(i));
    } else {
      q(i) += turn * std::nearbyint((terms[i].last - q(i)) / turn);
    }
  }
  if (jumped) close_by_turns(q);
  if (is_angle(0)) q(0) += turn * std::nearbyint((wanted(q) - q(0)) / turn);
  for (size_t i = 0; i < terms.size(); ++i) terms[i].last = q(i);
  return q(0) - wanted(q);
}

// Turns the first leader that turns without limits by as many turns as close the coupling best, of those the fewest.
template <class Coordinate>
void AmbCoupling::close_by_turns(Coordinate q) {
  // Turns that are tried where the follower is an angle, too.
  constexpr int MAX_TURNS = 8;
  const btScalar turn = 2 * SIMD_PI;
  size_t leader = 1;
  const auto is_counted = [this](size_t i) {
    const SoftMotor &motor = terms[i].joint->motor;
    return is_angle(i) && motor.low > motor.high && terms[i].factor != 0;
  };
  while (leader < terms.size() && !is_counted(leader)) ++leader;
  if (leader == terms.size()) return;
  const btScalar step = -terms[leader].factor * turn, error = q(0) - wanted(q);
  if (!std::isfinite(error)) return;
  if (!is_angle(0)) {
    q(leader) += turn * std::nearbyint(error / step);
    return;
  }
  int best = 0;
  btScalar least = btFabs(std::remainder(error, turn));
  for (int turns = 1; turns <= MAX_TURNS; ++turns) {
    for (const int tried : {turns, -turns}) {
      const btScalar left = btFabs(std::remainder(error - tried * step, turn));
      // A ratio of whole numbers is closed by many turns alike.
      constexpr btScalar ROUNDING = 1e-6;
      if (left < least - ROUNDING) {
        least = left;
        best = tried;
      }
    }
  }
  q(leader) += turn * best;
}

#endif
