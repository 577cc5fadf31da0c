// Dynamics of an articulation in generalised coordinates. C++ only.
#ifndef AMB_ARTICULATION_DYNAMICS_H
#define AMB_ARTICULATION_DYNAMICS_H

#include "arena_memory.h"
#include "../include/ambf_aba.h"

#include <LinearMath/btTransform.h>

#include <cmath>

// The motion of articulations. The Rust library sets it before the first world is made.
extern const AmbAbaTable *aba_table;

// A kinematic tree of hinges, sliders, ball joints, joints that leave all six motions and fixed joints, on a fixed or
// free base. What it does is in src/aba; this is its memory, in the arena of the world.
//
// Body 0 is the base, body i + 1 is link i. Poses are those of inertial frames; SI units.
class ArticulationDynamics {
 public:
  enum class JointType { Fixed, Revolute, Prismatic, Spherical, Free };

  // Numbers of coordinates of a joint: displacements, which come first, and rotations. Three of a kind are along or about
  // the parent's axes.
  static int sliding_coordinates_of(JointType type) {
    return type == JointType::Free ? 3 : type == JointType::Prismatic ? 1 : 0;
  }
  static int turning_coordinates_of(JointType type) {
    return type == JointType::Free || type == JointType::Spherical ? 3 : type == JointType::Revolute ? 1 : 0;
  }

  struct Link {
    int parent;  // body
    JointType type;
    int coordinate;           // index in `q` of its first coordinate; -1 if fixed
    int sliding, turning;     // numbers of its coordinates
    int ball;                 // index in `balls`; -1 if it does not turn about three axes
    int freedoms() const { return sliding + turning; }
    btVector3 axis;           // of length 1, in the parent's frame
    btVector3 pivot;          // in the parent's frame
    btMatrix3x3 rotation;     // child in parent at coordinate 0
    btVector3 arm;            // from the pivot to the centre of mass at coordinate 0, in the child's frame
    btMatrix3x3 turn, turn2;  // axis x rotation, axis x (axis x rotation)
  };

  struct Body {
    btScalar mass;
    btVector3 inertia;  // principal moments
    // Decay rates of linear and angular momentum, 1/s.
    btScalar linear_drag = 0, angular_drag = 0;
    // External force (N) and torque (N m), constant over a step.
    btVector3 force{0, 0, 0}, torque{0, 0, 0};
  };

  // An angle, rad, wrapped to [-pi, pi]. The library's remainder is exact and slow.
  static btScalar wrapped(btScalar angle) {
    return btFabs(angle) <= SIMD_PI ? angle : std::remainder(angle, 2 * SIMD_PI);
  }

  // Generalised force -sign k (x - rest) - d q' on a coordinate q, where x = sign q + offset, wrapped to [-pi, pi] if
  // it is an angle.
  struct Spring {
    int coordinate;
    bool is_angle;
    btScalar sign, offset, stiffness, damping, rest;
    // Too stiff for explicit integration with the step: not part of this class's forces, but an implicit row, see
    // JointRows.
    bool is_stiff = false;
    // Stiff enough to resist the corrections of positions that many sub-steps make.
    bool resists_corrections = false;
    // So stiff that this row brings it to rest in one step.
    bool settles_in_a_step = false;

    btScalar displacement(btScalar q) const;
  };

  // A linear equation between rates of coordinates: the sum of factors times rates is 0. The first is that of the follower, with
  // the factor 1.
  struct CoupledCoordinate {
    int coordinate;
    btScalar factor;
  };

  // A motor, a stiff spring or a limit of a coordinate, which acts over the whole step: see src/aba/drives.rs.
  struct Drive {
    int coordinate;
    btScalar target;     // rad/s or m/s
    btScalar softness;   // change of rate per impulse; 0: rigid
    btScalar low, high;  // bounds of the impulse
    bool is_limit = false;
    // Limit: 1 where it bounds the coordinate from below, -1 from above; 0 where it holds it. Else 0.
    btScalar side = 0;
    // Limit: distance at the beginning of the step, rad or m, negative if it is violated; of a bound of the rate it is infinite.
    btScalar gap = 0;
    bool bounds_rate() const { return gap >= BT_LARGE_FLOAT; }
    bool is_angle = false;
    // What bounds it is found in the step.
    enum class State : int { Free, Low, High } state = State::Free, start_state = State::Free;
    // At the last evaluation; and mean over the step, with its work, J.
    btScalar impulse = 0, mean_impulse = 0, work = 0;
  };

  // Drives of a step. Their places are made once.
  class DriveList {
   public:
    void reserve(size_t n) { places.resize(n); }
    void clear() { count = 0; }
    void push_back(const Drive &drive) { places[count++] = drive; }
    Drive &back() { return places[count - 1]; }
    size_t size() const { return count; }
    const Drive &operator[](size_t i) const { return places[i]; }
    const Drive *begin() const { return places.data(); }
    const Drive *end() const { return places.data() + count; }

   private:
    friend class ArticulationDynamics;
    Vector<Drive> places;
    int count = 0;
  };

  // Limits of a coordinate and bounds of its rate that the step will not reach unless a rate more than doubles; infinite: none.
  struct DistantLimits {
    int coordinate;
    bool is_angle;
    // Distances from the lower and the upper limit, rad or m, and bounds of the rate in either direction, rad/s or m/s, positive.
    btScalar below = BT_LARGE_FLOAT, above = BT_LARGE_FLOAT, backward = BT_LARGE_FLOAT, forward = BT_LARGE_FLOAT;

    bool any() const { return below < BT_LARGE_FLOAT || above < BT_LARGE_FLOAT || backward < BT_LARGE_FLOAT || forward < BT_LARGE_FLOAT; }
  };

  // The drive that keeps a rate above (side 1) or below (-1) the target where it has to; see Drive::gap.
  static Drive limit(int coordinate, bool is_angle, btScalar side, btScalar target, btScalar gap);

  // Linear (N s) and angular (N m s) momentum.
  struct Momentum {
    btVector3 linear{0, 0, 0}, angular{0, 0, 0};
  };

  // Generalised position.
  struct Position {
    btQuaternion rotation{0, 0, 0, 1};  // of the base
    btVector3 origin{0, 0, 0};
    // Angles (rad) and displacements (m). The three of a rotation about three axes are meaningless: rotations have no
    // coordinates whose rates are angular velocities.
    Vector<btScalar> q;
    // Rotations of children that turn about three axes, in their parents.
    Vector<btQuaternion> balls;
  };

  // Generalised velocity: velocity of the base and rates of the coordinates, which for a rotation about three axes are
  // the components of the relative angular velocity in the parent's axes. Also used for accelerations.
  struct Rate {
    btVector3 angular{0, 0, 0}, linear{0, 0, 0};
    Vector<btScalar> q;
  };

  explicit ArticulationDynamics(bool with_fixed_base) : fixed_base(with_fixed_base) {}

  // Adds a link; `joint_in_parent` and `joint_in_child` are frames that coincide at coordinate 0, `axis` is in them.
  void add(const Body &body, int parent, JointType type, const btVector3 &axis, const btTransform &joint_in_parent,
           const btTransform &joint_in_child);
  // Adds an equation between rates, after those of its leaders.
  void couple(const Vector<CoupledCoordinate> &terms);
  // To be called after the last link and coupling was added.
  void finish();

  // Computes the poses of all bodies from the position (forward kinematics).
  void update_poses(const Position &position);
  // Computes the velocities of all bodies from the rates; the poses must be up to date.
  void update_velocities(const Rate &rate);
  // Computes accelerations under external forces and springs. Poses and velocities must be those of `position` and `rate`.
  void accelerate(const Position &position, const Rate &rate, Rate &acceleration);
  // Acceleration of a coordinate by a unit force on it. `factor_inertia` must be up to date.
  btScalar response(int coordinate);
  // Projects velocities of the bodies onto the joints: finds the rates with the least kinetic energy of the difference.
  // Poses must be up to date. The velocity of a fixed base, which is that of `rate`, is given.
  void project(const btVector3 *linear, const btVector3 *angular, Rate &rate);

  // Integrates over h s. Poses and velocities must be those of `from` and `rate`; afterwards they are those of `to` and `new_rate`.
  // Drives act in it; limits that were distant and are reached are added to them.
  void step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  // After a step with drives over h s: finds displacements `back`, rad or m, by which coordinates return that passed their
  // limits in it, and by a share of what they were beyond them before. Returns whether there are any.
  bool way_to_limits(btScalar h, const Position &from, const Position &to, Vector<btScalar> &back) const;
  // Instead of the last step: moves over h s along the tangent. Returns the internal energy that the work of the forces leaves at
  // most, J.
  btScalar tangential_step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  // Kinetic and internal energy of all bodies, J, from the velocities of the last `update_velocities`.
  btScalar kinetic_energy() const;
  btScalar internal_energy() const;
  // Multiplies all velocities relative to the centre of mass by `share`; velocities must be those of `rate`.
  void scale_internal_velocity(btScalar share, Rate &rate);
  // Largest angular velocity of a body or rate of a revolute coordinate, rad/s; velocities must be those of `rate`.
  btScalar fastest_rotation(const Rate &rate) const;

  // Discards the estimate of the fastest mode, after the position was set.
  void reset_estimates() { state.has_mode = state.steps_until_probe = 0; }

  // Bounds the angular velocity of the base and of joints that turn to `most` rad/s. Poses and velocities must be up to date.
  void bound_rotation(Rate &rate, btScalar most);

  // Factors the generalised inertia H = L^T L. In the velocity coordinates z = L v the kinetic energy is z^T z / 2,
  // where v is the base's angular and linear velocity (0 if it is fixed) followed by the rates of the coordinates.
  // Poses and velocities must be up to date. The functions below use L.
  void factor_inertia();
  size_t velocity_size() const { return 6 + static_cast<size_t>(coordinates); }
  // Adds to a row of the Jacobian of v the part of an impulse along `force` at the centre of mass of a body, and along
  // `torque`.
  void add_jacobian(size_t body, const btVector3 &force, const btVector3 &torque, btScalar *row) const;
  // As `add_jacobian`, with the coordinates of the link's own joint only: an impulse between a link and its parent.
  void add_joint_jacobian(size_t body, const btVector3 &force, const btVector3 &torque, btScalar *row) const;
  // Transforms a row J of the Jacobian of v into J L^-1, the row for z. It is also the response of z to a unit impulse
  // of the row.
  void normalise(btScalar *row) const;
  void rates_of(const btScalar *z, Rate &rate) const;
  void coordinates_of(const Rate &rate, btScalar *z) const;

  // Adds h times rate to a position; rotations by the exponential map.
  void advance_position(Position &position, btScalar h, const Rate &rate) const;

  // Angular momentum of a body about its own centre of mass, N m s.
  btVector3 angular_momentum(size_t body) const;
  // Momentum of all bodies about a point.
  Momentum momentum(const btVector3 &about) const;
  // Adds a rigid motion of the whole articulation, which must have a free base, so that its momentum about a point
  // becomes that given. Changes the rate of the base.
  void set_momentum(const Momentum &momentum, const btVector3 &about, Rate &rate);

  // Whether a fixed base moves.
  bool is_carried() const { return fixed_base && !(linear[0].isZero() && angular[0].isZero()); }

  // No force moves the base. It may be moved all the same: the velocity of all rates is then that of its prescribed motion,
  // at a constant twist over a step.
  const bool fixed_base;
  int coordinates = 0, balls = 0;
  Vector<Body> bodies;
  Vector<Link> links;
  Vector<Spring> springs;
  // Of the next step; `step` is the only function that knows them.
  DriveList drives;
  // Where the step reaches one of these, it is added to the drives and the step made again.
  Vector<DistantLimits> distant_limits;
  // Force on each coordinate, N or N m, constant over a step.
  Vector<btScalar> generalised_forces;
  // Poses and velocities of the bodies, world axes.
  Vector<btMatrix3x3> rotations;
  Vector<btVector3> origins, linear, angular;
  // Of the latest step. Whether steps are semi-implicit Euler steps, instead of those of the classical Runge-Kutta method.
  AmbAbaState state{};

  // Linear momentum of all bodies, N s, and their mass, kg.
  btVector3 linear_momentum() const;
  btVector3 mass_centre() const;
  btScalar mass() const;
  // Bound of the work of all forces over h s at the velocities of the bodies and this rate at a position, J. All elastic
  // energy of springs that are integrated with the motion counts.
  btScalar work_at_rate(btScalar h, const Position &at, const Rate &rate) const;

  // Terms of couplings: a follower comes after its leaders. They hold in accelerations, in projected rates, and in the responses of
  // rows: all that `normalise` returns is within the space of rates in which they hold.
  const CoupledCoordinate *coupling(size_t i) const { return coupled.data() + (i == 0 ? 0 : coupling_ends[i - 1]); }

 private:
  AmbAbaTree tree() const;

  // That of the last `factor_inertia`, for what is called for each row after it.
  AmbAbaTree factored{};
  Vector<CoupledCoordinate> coupled;
  Vector<int> coupling_ends;
  // Memory of the algorithm.
  Vector<btVector3> work, vectors, arms, axes;
  Vector<btQuaternion> quaternions;
  Vector<btScalar> numbers, rest_impulse;
  Vector<AmbAbaDriven> driven;
  Vector<int> given_by;
  // For each component of v, the previous one on the path to the base; -1: none.
  Vector<int> parent_component;
  // L, by rows, and the inverses of its diagonal; rows of couplings.
  Vector<btScalar> factor, inverse_diagonal, coupling_rows, rows;
};

#endif
