// What C++ and Rust share of an articulation: its tree. C++ only.
//
// What a tree does is in src/aba, which is called through a table, because the C++ code is linked before it: the functions are described
// at `AmbTreeTable` in src/aba/ffi.rs. All memory is in the arena of the world. SI units, world axes.
#ifndef AMB_ARTICULATION_TREE_H
#define AMB_ARTICULATION_TREE_H

#include <LinearMath/btTransform.h>

struct Tree {
  enum class JointType { Fixed, Revolute, Prismatic, Spherical, Free };

  // Numbers of coordinates of a joint: displacements, which come first, and rotations. Three of a kind are along or about
  // the parent's axes.
  static int sliding_coordinates_of(JointType type) {
    return type == JointType::Free ? 3 : type == JointType::Prismatic ? 1 : 0;
  }
  static int turning_coordinates_of(JointType type) {
    return type == JointType::Free || type == JointType::Spherical ? 3 : type == JointType::Revolute ? 1 : 0;
  }

  // Body 0 is the base, body i + 1 is that of link i. Poses are those of inertial frames.
  struct Link {
    int parent;  // body
    JointType type;
    int coordinate;           // index in `q` of its first coordinate; -1 if fixed
    int sliding, turning;     // numbers of its coordinates
    int ball;                 // index in `balls`; -1 if it does not turn about three axes
    btVector3 axis;           // of length 1, in the parent's frame
    btVector3 pivot;          // in the parent's frame
    btMatrix3x3 rotation;     // child in parent at coordinate 0
    btVector3 arm;            // from the pivot to the centre of mass at coordinate 0, in the child's frame
    btMatrix3x3 turn, turn2;  // axis x rotation, axis x (axis x rotation)

    int freedoms() const { return sliding + turning; }
  };

  struct Body {
    btScalar mass;
    btVector3 inertia;  // principal moments
    // Decay rates of linear and angular momentum, 1/s.
    btScalar linear_drag = 0, angular_drag = 0;
    // External force and torque of the sub-step.
    btVector3 force{0, 0, 0}, torque{0, 0, 0};
  };

  // Generalised force -sign k (x - rest) - d q' on a coordinate q, where x = sign q + offset, wrapped to [-pi, pi] if it is an angle.
  struct Spring {
    int coordinate;
    bool is_angle;
    btScalar sign, offset, stiffness, damping, rest;
    // Of the sub-step.
    bool is_stiff = false, resists_corrections = false, settles_in_a_step = false;
  };

  // A linear equation between rates of coordinates: the sum of factors times rates is 0. The first is that of the follower,
  // with the factor 1.
  struct CoupledCoordinate {
    int coordinate;
    btScalar factor;
  };

  // What acts on the joint of a link of one freedom in a sub-step: a motor, if its largest impulse is above 0, ...
  struct Joint {
    btScalar target, softness, impulse, armature, friction, max_rate, low, high;
    bool is_hinge;
  };

  // A row of a joint.
  struct Row {
    int coordinate;
    btScalar target, softness, low, high;
    // Motor: its coordinate; stiff spring: the number of coordinates plus the index of the spring; then friction and rotors.
    int source;
    btScalar feedforward, correction;
    bool is_angle;
    btScalar guess;
    int member;
    btVector3 force, torque;
    btScalar impulse, velocity, response, softest;
  };
  // Sources of rows that are no forces.
  static constexpr int LIMIT = -1, LARGEST_RATE = -2;

  // A row of the limits of a joint of several coordinates.
  struct WideRow {
    int member;
    btScalar low, high, correction;
    btVector3 force, torque;
  };

  struct Wrench {
    btVector3 force, torque;
  };

  struct Circumstances {
    bool by_euler, has_contact, is_connected, is_driven, has_wide_limits, has_reactions, is_accounted, is_moved;
  };

  struct Base {
    btQuaternion rotation;
    btVector3 origin, linear, angular;
  };

  struct Energy {
    double kinetic, potential, elastic;
  };

  struct Sums {
    double set_states, corrections, contacts, wrenches, damping, motors, limits;
  };

  // See position_error.h.
  struct Bounds {
    btScalar return_speed, return_rate, limit_erp;
  };

  struct Plan {
    int links, couplings, springs, has_fixed_base;
    const Link *link;
    const Body *body;
    const CoupledCoordinate *term;
    const int *end;
    const btScalar *offset;
    Bounds bounds;
    void *(*allocate)(void **blocks, size_t size);
    void **blocks;
  };

  void *articulation;
  int links, coordinates;
  const Link *link;
  Body *body;
  Spring *spring;
  const btMatrix3x3 *rotations;
  const btVector3 *origins, *linear, *angular;
  // Position: angles (rad) and displacements (m). The three of a rotation about three axes are meaningless: rotations have no
  // coordinates whose rates are angular velocities, and are those of the child in its parent.
  btQuaternion *rotation;
  btVector3 *origin;
  btScalar *q;
  btQuaternion *balls;
  btVector3 *base_linear, *base_angular;
  btScalar *rates;
  // Of the next sub-step.
  Wrench *wrenches;
  btVector3 *gravity;
  Joint *joint;
  Circumstances *circumstances;
  Base *base;
  Wrench *applied;
  // What the sub-step leaves.
  const Row *row;
  const Wrench *reactions, *spring_reactions;
  const Energy *energy;
  Sums *sums;
  const bool *has_rows;
  const double *free_energy;

  // Number of velocities z, in which the inertia is the identity.
  int velocities() const { return coordinates + 6; }
};

struct TreeTable {
  size_t sizes[8];
  Tree *(*make)(const Tree::Plan *plan);
  void (*add_spring)(Tree *tree, const Tree::Spring *spring, int body, int is_beside, double low, double high);
  void (*forget)(Tree *tree);
  void (*settle)(Tree *tree, const btVector3 *linear, const btVector3 *angular);
  void (*place)(Tree *tree);
  void (*clear_wide_rows)(Tree *tree);
  void (*add_wide_row)(Tree *tree, const Tree::WideRow *row);
  void (*move_freely)(Tree *tree, double h);
  void (*prepare_rows)(Tree *tree, double h);
  int (*rows)(const Tree *tree);
  void (*write_rows)(Tree *tree, double *jacobians);
  void (*add_to_row)(const Tree *tree, int body, const btVector3 *force, const btVector3 *torque, double *row);
  void (*finish)(Tree *tree, double h, const double *z, const double *impulses);
  void (*read_rates)(const Tree *tree, double *start, double *free);
  void (*note_energy)(Tree *tree);
};

// The Rust library sets it before the first world is made.
extern const TreeTable *tree_table;

#endif
