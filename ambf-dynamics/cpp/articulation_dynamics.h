// Motion of a tree of rigid bodies in reduced coordinates. C++ only.
#ifndef AMB_ARTICULATION_DYNAMICS_H
#define AMB_ARTICULATION_DYNAMICS_H

#include "arena_memory.h"

#include <LinearMath/btTransform.h>

// A tree of hinges, sliders and fixed joints on a base that is fixed or free. Featherstone's articulated-body algorithm (Rigid Body
// Dynamics Algorithms, 2008, chapter 7) with every quantity in world axes about the centre of mass of its body: matrices then need no
// rotation on their way from link to link. Classical accelerations are used, not spatial ones.
//
// Body 0 is the base, body i + 1 is link i. Poses are those of inertial frames; SI units.
class ArticulationDynamics {
 public:
  enum class JointType { Fixed, Revolute, Prismatic };

  struct Link {
    int parent;  // body
    JointType type;
    int coordinate;          // place in `q`; -1 if fixed
    btVector3 axis;          // of length 1, in the parent's frame
    btVector3 pivot;         // in the parent's frame
    btMatrix3x3 rotation;    // child in parent at coordinate 0
    btVector3 arm;           // from the pivot to the centre of mass at coordinate 0, in the child's frame
    btMatrix3x3 turn, turn2;  // axis x rotation, axis x (axis x rotation)
  };

  struct Body {
    btScalar mass;
    btVector3 inertia;  // principal moments
    // Rates of decay of momentum, 1/s.
    btScalar linear_drag = 0, angular_drag = 0;
    // External, constant over a step.
    btVector3 force{0, 0, 0}, torque{0, 0, 0};
  };

  // Pushes a coordinate q with -sign k (x - rest) - d q' where x = sign q + offset, between -pi and pi if it is an angle.
  struct Spring {
    int coordinate;
    bool is_angle;
    btScalar sign, offset, stiffness, damping, rest;
    // Left to whoever deals with springs that are too stiff for the step.
    bool is_stiff = false;

    btScalar displacement(btScalar q) const;
  };

  // Where the tree is.
  struct Position {
    btQuaternion rotation{0, 0, 0, 1};  // of the base
    btVector3 origin{0, 0, 0};
    Vector<btScalar> q;
  };

  // How it moves: velocity of the base and rates of the coordinates. Also used for accelerations.
  struct Rate {
    btVector3 angular{0, 0, 0}, linear{0, 0, 0};
    Vector<btScalar> q;
  };

  explicit ArticulationDynamics(bool with_fixed_base) : fixed_base(with_fixed_base) {}

  // Adds a link; `joint_in_parent` and `joint_in_child` are frames that coincide at coordinate 0, `axis` is in them.
  void add(const Body &body, int parent, JointType type, const btVector3 &axis, const btTransform &joint_in_parent,
           const btTransform &joint_in_child);
  // After the last link.
  void finish();

  // Poses of all bodies from the position.
  void update_poses(const Position &position);
  // Velocities of all bodies from the rates; the poses must be those of the position.
  void update_velocities(const Rate &rate);
  // Accelerations under external forces and springs, of bodies that were placed at a position and moved with a rate.
  void accelerate(const Position &position, const Rate &rate, Rate &acceleration);
  // What a force of 1 on the coordinate of a link gives if its parent doesn't move, as of the last sweep.
  btScalar response(size_t link) const { return work[link + 1].d_inverse; }
  // The rates that come nearest to velocities of the bodies, weighted with their masses and inertias: what perfect joints would leave of
  // them. The poses must be those of the position.
  void project(const btVector3 *linear, const btVector3 *angular, Rate &rate);

  // A step by the classical Runge-Kutta method from where `place` put the bodies; poses are spoilt. It is divided into sub-intervals where the
  // articulation vibrates or turns too fast for the step, and again as long as the kinetic energy grows by more than the work of all forces.
  // Damping that is stiff against the step is split off (Strang): the bodies' velocities decay by half the step before and after.
  void step(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);

  // Kinetic energy of all bodies, J; `move` has set their velocities.
  btScalar kinetic_energy() const;
  // The same without that of the motion of the centre of mass where the base is free: energy that does not depend on how fast the whole falls.
  btScalar internal_energy() const;
  // What drag adds to that, W: bodies of different drag that fall together push each other. Not negative.
  btScalar drag_power() const;
  // Multiplies the rates, which `move` has set, by `share`, but for the velocity of the centre of mass.
  void scale_internal_velocity(btScalar share, Rate &rate);
  // Largest angular velocity of a body or rate of a revolute coordinate, rad/s; `move` has set the velocities.
  btScalar fastest_rotation(const Rate &rate) const;

  // After a jump: what was learnt of the motion doesn't count any more.
  void reset_estimates() {
    mode.clear();
    steps_until_probe = 0;
  }

  // Bounds the angular velocity of the base and the rates of revolute coordinates to a quarter of a turn in h, as Bullet bounds the angular
  // velocities of rigid bodies: the step resolves no faster motion. The linear momentum of a free articulation stays. The articulation was
  // placed and moved with the rate.
  void bound_rotation(Rate &rate, btScalar h);

  // Velocity coordinates z in which the kinetic energy is z^T z / 2: z = L v, where v are the base's angular and linear velocity and the rates of
  // the coordinates, and L^T L is their inertia; L has entries along the branches only (Featherstone 2008, section 6.5). The base's six are 0
  // if it is fixed. `factor_inertia` is to be called first, with bodies that were placed and moved.
  void factor_inertia();
  size_t velocity_size() const { return 6 + static_cast<size_t>(coordinates); }
  // Adds to a row of the Jacobian of v what a force at the centre of mass of a body and a torque on it do, both of 1 N s or N m s.
  void add_jacobian(size_t body, const btVector3 &force, const btVector3 &torque, btScalar *row) const;
  // Turns a row of the Jacobian of v into that of z, which is the response of z to the row's impulse too.
  void normalise(btScalar *row) const;
  void rates_of(const btScalar *z, Rate &rate) const;
  void coordinates_of(const Rate &rate, btScalar *z) const;

  // Moves on by h times rate, the rotation by the exponential map.
  static void advance_position(Position &position, btScalar h, const Rate &rate);

  // About the body's own centre of mass.
  btVector3 angular_momentum(size_t body) const;
  // Of all bodies, which were placed and moved, about a point.
  struct Momentum {
    btVector3 linear{0, 0, 0}, angular{0, 0, 0};
  };
  Momentum momentum(const btVector3 &about) const;
  // Moves a tree that was placed and moved, with a free base, as one body, so that it gets a momentum; changes the rate of the base.
  void set_momentum(const Momentum &momentum, const btVector3 &about, Rate &rate);

  const bool fixed_base;
  int coordinates = 0;
  Vector<Body> bodies;
  Vector<Link> links;
  Vector<Spring> springs;
  // On each coordinate, constant over a step.
  Vector<btScalar> generalised_forces;
  // State of the bodies, world axes.
  Vector<btMatrix3x3> rotations;
  Vector<btVector3> origins, linear, angular;

 private:
  struct Work {
    btMatrix3x3 inertia;        // of the body alone
    btMatrix3x3 a, b, m;        // articulated: torque and force from angular and linear acceleration, [a b; b^T m]
    btVector3 torque, force;    // bias
    btVector3 r;                // from the parent's centre of mass to the body's
    btVector3 s_angular, s_linear;  // motion of a coordinate
    btVector3 c_angular, c_linear;  // acceleration at rest of the coordinate
    btVector3 u_angular, u_linear;
    btScalar d_inverse, u;
    btVector3 alpha, accel;
  };

  void runge_kutta(btScalar h, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  void divided_step(btScalar h, int parts, const Position &from, const Rate &rate, Position &to, Rate &new_rate);
  void apply_damping(btScalar h, const Position &at, Rate &rate);
  btScalar elastic_energy(const Position &at) const;
  btVector3 linear_momentum() const;
  btScalar mass() const;
  void update_fastest_mode(const Position &at, const Rate &rate);
  void add_inertias();
  void compute_joint_inertia(size_t link);
  void remove_joint_motion(size_t link);
  void add_to_parent(size_t link);
  void sweep(Rate &out, bool with_bias);

  Vector<Work> work;
  Vector<btScalar> efforts;
  // Of each component of v, the one before it on its way to the base; -1: none.
  Vector<int> parent_component;
  // L, by rows, and the inverses of its diagonal.
  Vector<btScalar> factor, inverse_diagonal;
  Position stage, part;
  Rate stage_rate, part_rate, start_rate, slopes[4], speeds[4];
  // Damping is integrated apart from the other forces.
  bool splits_damping = false;
  Vector<btVector3> wanted_linear, wanted_angular, start_origins;
  // Fastest mode: its shape, and the square of its angular frequency, 1/s^2.
  Vector<btScalar> mode;
  btScalar stiffness = 0;
  // Steps until it is looked at again.
  int steps_until_probe = 0;
};

#endif
