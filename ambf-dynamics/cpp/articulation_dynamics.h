// Dynamics of an articulation in generalised coordinates. C++ only.
#ifndef AMB_ARTICULATION_DYNAMICS_H
#define AMB_ARTICULATION_DYNAMICS_H

#include "arena_memory.h"
#include "../include/ambf_aba.h"

#include <LinearMath/btTransform.h>

#include <cmath>

// The articulated-body algorithm and what depends on it. The Rust library sets it before the first world is made.
extern const AmbAbaTable *aba_table;

// A kinematic tree of hinges, sliders, ball joints, joints that leave all six motions and fixed joints, on a fixed or
// free base. Accelerations are those of the articulated-body algorithm in src/aba; here they are integrated.
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
  using Coupling = Vector<CoupledCoordinate>;

  // A motor, a stiff spring or a limit of a coordinate, which acts over the whole step: with the impulse x in it, N m s or
  // N s, the rate at its end is target - softness * x, or x is one of its bounds. It is part of the equations of motion:
  // its force at each instant is that with which the acceleration there, kept over the step, leads to that rate.
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
    enum class State { Free, Low, High } state = State::Free;
    // At the beginning of the step.
    State start_state = State::Free;
    // At the last evaluation; and mean over the step, with its work, J.
    btScalar impulse = 0, mean_impulse = 0, work = 0;
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
  // To be called after the last link was added.
  void finish();

  // Computes the poses of all bodies from the position (forward kinematics).
  void update_poses(const Position &position);
  // Computes the velocities of all bodies from the rates; the poses must be up to date.
  void update_velocities(const Rate &rate);
  // Computes accelerations under external forces and springs. Poses and velocities must be those of `position` and
  // `rate`, unless `is_placed` is false: they are undefined afterwards then.
  void accelerate(const Position &position, const Rate &rate, Rate &acceleration, bool is_placed = true);
  // Acceleration of a coordinate by a unit force on it: the diagonal of the inverse inertia. The base and all other
  // coordinates are free to move: a light parent of a heavy link moves instead of the link. `factor_inertia` must be up to
  // date.
  btScalar response(int coordinate);
  // Projects velocities of the bodies onto the joints: finds the rates with the least kinetic energy of the difference.
  // Poses must be up to date. The velocity of a fixed base, which is that of `rate`, is given.
  void project(const btVector3 *linear, const btVector3 *angular, Rate &rate);

  // Whether steps are semi-implicit Euler steps, with one evaluation of the accelerations, instead of those of the classical
  // Runge-Kutta method.
  bool by_euler = false;
  // Integrates over h s. Poses and velocities must be those of `from` and `rate`; afterwards they are those of `to` and `new_rate`. The
  // step is divided into sub-intervals if the articulation vibrates or turns too fast for it, and further while the kinetic energy grows by more than the work of all forces. Damping that is stiff for h is split
  // off (Strang splitting): it acts for h / 2 before and after the step.
  void step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  // Drives act in it: limits are found to be reached or not, and motors within their bounds, by the accelerations at the
  // beginning; a limit that is passed nevertheless makes the step again. Coordinates do not leave their limits.
  // Internal energy at the beginning of the last step, J.
  btScalar start_energy = 0;
  // Largest angular velocity of a link or joint then, rad/s.
  btScalar start_rotation = 0;
  // After a step with drives over h s: finds displacements `back`, rad or m, by which coordinates return that passed their
  // limits in it, and by a share of what they were beyond them before. Returns whether there are any.
  bool way_to_limits(btScalar h, const Position &from, const Position &to, Vector<btScalar> &back) const;
  // Instead of the last step: moves over h s along the tangent, with constant rates, without forces but those on the
  // centre of mass of a free base. Near singular positions of links of next to no inertia the rates are finite for an
  // instant only, and no step of useful length follows them. Returns the internal energy that the work of the forces
  // leaves at most, J.
  btScalar tangential_step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  // Instead of the last step: accelerates over h s as at its beginning, at rates of which the mean is that of the motion.
  // Returns how much of the change of momentum about the mass centre is a change of the inertia with the position:
  // the new rates have the rest at the old position.
  Momentum uniform_step(btScalar h, const Position &from, Position &to, Rate &new_rate);

  // Kinetic energy of all bodies, J, from the velocities of the last `update_velocities`.
  btScalar kinetic_energy() const;
  // Internal energy, J: the kinetic energy without that of the centre of mass if the base is free, and relative to the
  // base if that is fixed: it depends neither on the speed of a fall nor on that at which a base is moved.
  btScalar internal_energy() const;
  // Power that drag adds to the internal energy, W, at least 0: joined bodies of different drag that fall accelerate
  // each other.
  btScalar drag_power() const;
  // Multiplies all velocities relative to the centre of mass by `share`; velocities must be those of `rate`.
  void scale_internal_velocity(btScalar share, Rate &rate);
  // Largest angular velocity of a body or rate of a revolute coordinate, rad/s; velocities must be those of `rate`.
  btScalar fastest_rotation(const Rate &rate) const;

  // Discards the estimate of the fastest mode, after the position was set.
  void reset_estimates() {
    mode.clear();
    steps_until_probe = 0;
  }

  // Bounds the angular velocity of the base and of revolute and ball joints to `most` rad/s, as Bullet clamps angular
  // velocities of rigid bodies: by impulses between the two bodies of a joint, which take energy away and keep
  // the momentum. Setting the rate of one coordinate alone would change the velocities of all bodies behind it, and
  // adds energy where rates of several coordinates cancel. Poses and velocities must be up to date.
  void bound_rotation(Rate &rate, btScalar most);
  // Adds generalised forces that keep the accelerations of revolute and ball joints, rad/s^2, from changing an angular
  // velocity by more than that in h s, as the torque of a wrench does on a link of next to no inertia. What the present
  // motion adds does not count. A motion by many turns in h s cannot be integrated, and its truncation errors are those
  // of a large energy.
  void bound_acceleration(btScalar h, const Position &from, const Rate &rate, Rate &acceleration);

  // Factors the generalised inertia H = L^T L. In the velocity coordinates z = L v the kinetic energy is z^T z / 2,
  // where v is the base's angular and linear velocity (0 if it is fixed) followed by the rates of the coordinates. L
  // has entries along the branches only (Featherstone 2008, section 6.5). Poses and velocities must be up to date. The
  // functions below use L.
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
  // A follower comes after its leaders. They hold in accelerations, in projected rates, and in the responses of rows: all that
  // `normalise` returns is within the space of rates in which they hold.
  Vector<Coupling> couplings;
  // Of the next step; `step` is the only function that knows them.
  Vector<Drive> drives;
  // Where the step reaches one of these, it is added to the drives and the step made again.
  Vector<DistantLimits> distant_limits;
  // Force on each coordinate, N or N m, constant over a step.
  Vector<btScalar> generalised_forces;
  // Those without what `bound_acceleration` adds, during a step.
  Vector<btScalar> unbounded_forces;
  // Poses and velocities of the bodies, world axes.
  Vector<btMatrix3x3> rotations;
  Vector<btVector3> origins, linear, angular;

  // Linear momentum of all bodies, N s, and their mass, kg.
  btVector3 linear_momentum() const;
  btVector3 mass_centre() const;
  btScalar mass() const;
  // Bound of the work of all forces over h s at the velocities of the bodies and this rate at a position, J. All elastic
  // energy of springs that are integrated with the motion counts.
  btScalar work_at_rate(btScalar h, const Position &at, const Rate &rate) const;

 private:
  btVector3 total_force() const;
  // The velocity that a body would have with a fixed base that moves if all joints were rigid; else 0.
  btVector3 carried_linear(size_t body) const {
    return is_carried() ? linear[0] + angular[0].cross(origins[body] - origins[0]) : btVector3(0, 0, 0);
  }
  btVector3 carried_angular() const { return is_carried() ? angular[0] : btVector3(0, 0, 0); }
  btScalar carrying_power() const;
  btScalar centrifugal_energy() const;
  Momentum wrench(const btVector3 &about) const;
  // Corrects the momentum after a step of h s, from that and the wrench about the mass centre before it.
  void restore_momentum(btScalar h, const Momentum &before, const Momentum &wrench_before, Rate &rate);
  void load_drives();
  void add_drives();
  void measure_drives(const Rate &acceleration);
  bool saturate_drives();
  bool pivot_drives(const Rate &acceleration, bool one_only);
  void settle_drives(const Position &from, Rate &acceleration);
  void accelerate_driven(const Position &position, const Rate &rate, Rate &acceleration, bool is_placed = true);
  void begin_drive_sums();
  void add_drive_sums(btScalar time, const Rate &rate);
  bool catch_limits(btScalar h, const Position &from, const Position &to, const Rate &rate);
  void begin_again(const Position &from, Rate &acceleration);
  bool is_driven(const Link &link) const;
  btScalar fastest_undriven(const Rate &rate) const;
  void part_step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  void runge_kutta(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  void divided_step(btScalar h, int parts, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  btScalar fastest_coordinate(const Rate &rate) const;
  btScalar largest_component(const Rate &rate) const;
  static btScalar joint_speed(const Link &link, const Rate &rate);
  void stop_at(int coordinate, btScalar most, Rate &rate);
  void apply_damping(btScalar h, const Position &at, Rate &rate);
  // Work of forces, generalised forces and springs between the position at the beginning of the step and `to`, whose
  // poses and velocities are the present ones, J: on the motion relative to the centre of mass if the base is free and to
  // the base if it is fixed, and on that of the centre of mass.
  struct Works {
    btScalar internal, of_mass_centre;
  };
  Works works_of_forces(btScalar h, const Position &from, const Position &to) const;
  btScalar elastic_energy(const Position &at) const;
  btScalar rounding_of_work(const Position &at) const;
  void update_fastest_mode(const Position &at, const Rate &rate);
  AmbAbaTree tree() const;
  void find_coupled_space();
  void normalise_uncoupled(btScalar *row) const;
  void remove_uncoupled(btScalar *z) const;
  void couple(Rate &rate);

  // Intermediate results of the articulated-body algorithm.
  Vector<btVector3> work;
  Vector<btScalar> efforts;
  // For each component of v, the previous one on the path to the base; -1: none.
  Vector<int> parent_component;
  // L, by rows, and the inverses of its diagonal.
  Vector<btScalar> factor, inverse_diagonal;
  // Orthonormal rows for z that couplings keep at 0, one after the other.
  Vector<btScalar> coupling_rows;
  // Velocities z while rates are coupled.
  Vector<btScalar> coupled_velocity;
  // Impulse on one coordinate, as a row for z.
  Vector<btScalar> impulse_row;
  Position stage, part;
  Rate stage_rate, part_rate, start_rate, slopes[4], speeds[4];
  Vector<btQuaternion> ball_spins[4];
  // Whether damping is split off from the other forces in the present step.
  bool splits_damping = false;
  // Length of the present step, s, while drives act in it; else 0.
  btScalar drive_step = 0;
  // What drives do to each coordinate. `given_by`: the drive that prescribes its acceleration; -1: none.
  Vector<AmbAbaDrive> driven;
  Vector<int> given_by;
  Vector<btScalar> rest_impulse;
  Vector<btVector3> wanted_linear, wanted_angular, start_origins;
  // Of each body, world axes: from the pivot of its joint to its centre of mass, and the axis of that joint.
  Vector<btVector3> arms, axes;
  // Shape of the fastest vibration mode, and the square of its angular frequency, 1/s^2.
  Vector<btScalar> mode;
  btScalar stiffness = 0;
  btScalar start_elastic_energy = 0;
  // See `carrying_power` and `centrifugal_energy`.
  btScalar start_carrying_power = 0, start_centrifugal_energy = 0;
  // Number of steps until the mode is estimated again.
  int steps_until_probe = 0;
};

#endif
