// Interface between the shim and an engine: a library above this one that replaces parts of Bullet's step. C++ only.
//
// The shim never calls the engine by name. It calls the virtual functions below through the pointer that `amb_world_new` was given, so
// that it links and runs without an engine; worlds are then plain Bullet's. The engine includes the shim's internal.h and reaches its
// objects directly. What it keeps of a body or constraint lies in `EngineBody` and `EngineConstraint`, which the shim makes and
// destroys with their owner.
#ifndef AMB_EXTENSION_H
#define AMB_EXTENSION_H

#include <cstdint>
#include <memory>

#include <BulletDynamics/MLCPSolvers/btMLCPSolverInterface.h>
#include <btBulletDynamicsCommon.h>

extern "C" {
#include "types.h"
}

// Classes of the engine, opaque here: an articulation, the rows of a constraint on one of its links, a world that has articulations.
struct AmbTree;
class TieRows;
class TreeWorld;

// What an engine does in one world. It is made before all else in the world and destroyed last; both happen while the world's arena is
// entered, and so does every call below that may allocate.
class Extension {
 public:
  BT_DECLARE_ALIGNED_ALLOCATOR();
  virtual ~Extension() = default;

  // While the world is made, in this order.
  virtual void configure(btDefaultCollisionConfiguration &configuration) = 0;
  // mlcp: what an MLCP solver solves its islands with; null for all others.
  virtual std::unique_ptr<btConstraintSolver> make_solver(btMLCPSolverInterface *mlcp) = 0;
  // Makes a world of kind AmbWorldKind_Trees by `fill_world` (stepped.h). Its solver is that of `make_solver`.
  virtual void make_world(btConstraintSolver &solver) = 0;

  // Around a sub-step of h s; Bullet's tick callbacks come between.
  virtual void before_sub_step(btScalar h) = 0;
  virtual void after_sub_step(btScalar h) = 0;
  // Around the integration of all poses over dt s. `bodies` are the world's dynamic bodies.
  virtual void before_motion(const btAlignedObjectArray<btRigidBody *> &bodies, btScalar dt) = 0;
  virtual void after_motion() = 0;

  // The gravity of the world and of the bodies that are in it was set, m/s^2.
  virtual void gravity_set(const btVector3 &gravity) = 0;
  // The velocity of a body of the world was set.
  virtual void velocity_set(AmbBody &body) = 0;
  // The pose of a body of the world is about to be set. Returns whether the body is a link: its collision object then follows in the next
  // sub-step.
  virtual bool pose_set(AmbBody &body) = 0;
  // A body is about to leave the world.
  virtual void body_leaves(AmbBody &body) = 0;
  // A constraint is added or about to be removed. Returns whether the engine keeps it, in place of Bullet's world.
  virtual bool add_constraint(AmbConstraint &constraint) = 0;
  virtual bool remove_constraint(AmbConstraint &constraint) = 0;
  // Coordinate of a constraint that is a joint of an articulation, rad (of any number of turns) or m. Returns whether it is one.
  virtual bool read_coordinate(const AmbConstraint &constraint, btScalar &coordinate) = 0;
  // Contacts and impulses of earlier sub-steps were dropped.
  virtual void recovered() = 0;
};

// An engine: makes its part of each world. Lives as long as the process.
struct AmbEngine {
  virtual ~AmbEngine() = default;
  // For a world that is being made, of whose members none is ready; solver and kind are those of `amb_world_new`.
  virtual std::unique_ptr<Extension> extend(AmbWorld &world, int solver, int kind) const = 0;
};

// Pose and velocity of a body before a sub-step.
struct FlightStart {
  btTransform pose;
  btVector3 linear_velocity, angular_velocity;
};

// What the engine keeps of a body.
struct EngineBody {
  // Sub-step in which the body was last in contact; only counted where the integrator asks for it.
  uint64_t touched = 0;
  // The tree of which it is a link, and which of its bodies it is.
  AmbTree *tree = nullptr;
  int member = 0;
  // Whether it was put where it is and has not moved since, and what all but the gyroscopic torque added to its angular velocity in the
  // sub-step before; see the engine's second_order.h.
  bool begins = true;
  btVector3 turned{0, 0, 0};
  FlightStart start;
  // Sub-step in which it last moved in exact flight.
  uint64_t flew = 0;
  // For the energy ledger only: time by which the pose is ahead of the velocity, s; whether forces act for half of this sub-step only, see
  // `begins`; velocities after the solver's pass, or after the flight, m/s and rad/s.
  btScalar ahead = 0;
  bool begun = false;
  btVector3 solved[2] = {{0, 0, 0}, {0, 0, 0}};
  // Rows that drive the body. Made when they are first needed, dropped when the body leaves its world.
  std::unique_ptr<btTypedConstraint> drive;
  // Radius, m, of the sphere that is swept when the body moves further than that in a sub-step; 0: never.
  btScalar swept_radius = 0;
};

// What the user pointer of every constraint points at: which of its rows are soft in this sub-step, J v = target - softness * impulse, and
// what a solver found for all its rows in the last one.
struct SoftRows {
  static constexpr int MOST_GUESSES = 12;

  int first = 0;
  int count = 0;
  btScalar softness[6] = {};
  // Impulses, for a constraint that has as many rows again, and the number of resets of the solver before they were found.
  int guesses = 0;
  unsigned guessed_after = 0;
  btScalar guess[MOST_GUESSES] = {};
};

// A row that drives a hinge or slider.
struct JointDrive {
  bool enabled = false;
  btScalar velocity = 0;
  btScalar max_impulse = 0;
  // Limits of the joint as they were given, which the shim writes: Bullet keeps those of a hinge between -pi and pi. Low above high: free.
  btScalar low = 1, high = -1;
  // The softness of the row, and where it is in this sub-step.
  SoftRows rows;
};

// What the engine keeps of a constraint.
struct EngineConstraint {
  JointDrive drive;
  // The tree of which it is a joint, and to which of its links.
  AmbTree *tree = nullptr;
  int link = 0;
  // In its stead while one of its bodies is a link of a tree that it is no joint of.
  std::shared_ptr<TieRows> tie;
};

#endif
