// Interface between the shim and an engine: a library above this one that replaces parts of Bullet's step. C++ only.
//
// The shim never calls the engine by name. It calls the virtual functions below through the pointer that
// `amb_world_new` was given, so that it links and runs without an engine; worlds are then plain Bullet's. The engine
// includes the shim's internal.h and accesses its objects directly. Its data of a body or constraint are `EngineBody`
// and `EngineConstraint`, which the shim creates and destroys with their owner.
#ifndef AMB_EXTENSION_H
#define AMB_EXTENSION_H

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <mutex>

#include <BulletDynamics/MLCPSolvers/btMLCPSolverInterface.h>
#include <btBulletDynamicsCommon.h>

extern "C" {
#include "types.h"
}

// Classes of the engine, opaque here: an articulation, the rows of a constraint on one of its links, a world that has
// articulations.
struct AmbArticulation;
class ExternalConstraintRows;
class ArticulatedWorld;
// What an engine finds out of a mesh, opaque here.
struct MeshTopology;

// The user pointer of a mesh shape points at it. Twins (amb_shape_twin) share it; the first world that needs it makes it.
struct TopologyHolder {
  std::once_flag is_made;
  std::shared_ptr<const MeshTopology> topology;
};

// Room for a collision algorithm of an extension in the dispatcher's pool, bytes.
constexpr int MAX_ALGORITHM_SIZE = 256;

// The part of an engine in one world. It is created before everything else in the world and destroyed last. The world's
// arena is entered during both, and during every call below that may allocate.
class Extension {
 public:
  BT_DECLARE_ALIGNED_ALLOCATOR();
  virtual ~Extension() = default;

  // The first four are called in this order while the world is made.
  virtual void configure(btDefaultCollisionConfiguration &configuration) = 0;
  // May register collision algorithms, whose factories have to outlive the dispatcher.
  virtual void add_algorithms(btCollisionDispatcher &dispatcher) = 0;
  // mlcp: algorithm of an MLCP solver; null for all other solvers.
  virtual std::unique_ptr<btConstraintSolver> make_solver(btMLCPSolverInterface *mlcp) = 0;
  // Makes a world of kind AmbWorldKind_Articulated by `fill_world` (substepped_world.h). Its solver is that of
  // `make_solver`.
  virtual void make_world(btConstraintSolver &solver) = 0;

  // An object whose shape is, or has as a part, a mesh that is not convex comes into the world. Bullet has registered its
  // algorithms for such shapes.
  virtual void mesh_comes(const AmbShape &shape) = 0;
  // The first object comes into the world whose shape is, or has as a part, a volume (volume_shape.h).
  virtual void volumes_come() = 0;

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
  // The pose of a body of the world was set. Returns whether the body is a link: its collision object is then moved in
  // the next sub-step.
  virtual bool pose_set(AmbBody &body) = 0;
  // A body is about to leave the world.
  virtual void body_leaves(AmbBody &body) = 0;
  // Mass, moments of inertia, damping or surface of a body of the world were set.
  virtual void body_changed(AmbBody &body) = 0;
  // A body is reset: nothing is left of what acted on it and of its motion.
  virtual void body_reset(AmbBody &body) = 0;
  // A constraint is added, or about to be removed. Returns whether the engine holds it instead of Bullet's world.
  virtual bool add_constraint(AmbConstraint &constraint) = 0;
  virtual bool remove_constraint(AmbConstraint &constraint) = 0;
  // Writes the coordinate of a joint of an articulation, rad (not wrapped) or m. Returns false for all other
  // constraints.
  virtual bool read_coordinate(const AmbConstraint &constraint, btScalar &coordinate) = 0;
  // Contacts and warm-starting impulses of earlier sub-steps were discarded.
  virtual void recovered() = 0;
  // Reports the hits of a ray like btCollisionWorld::rayTest, which takes over where this returns false.
  virtual bool cast_ray(const btVector3 &from, const btVector3 &to, btCollisionWorld::RayResultCallback &result) = 0;
};

// An engine. It makes its part of each world and has static lifetime.
struct AmbEngine {
  virtual ~AmbEngine() = default;
  // Called while `world` is constructed, before any of its members is; solver and kind are those of `amb_world_new`.
  virtual std::unique_ptr<Extension> extend(AmbWorld &world, int solver, int kind) const = 0;
};

// Pose and velocity of a body before a sub-step.
struct SubStepStart {
  btTransform pose;
  btVector3 linear_velocity, angular_velocity;
};

// Bodies that joints connect, while their turns are bounded; see the engine's turn_limit.h. Kept by one of them.
struct TurnGroup {
  // A body of the same group; null: this is the one that keeps the group.
  AmbBody *parent = nullptr;
  // Largest turn, rad; mass, kg; momentum, kg m/s.
  btScalar turn = 0, mass = 0;
  btVector3 momentum{0, 0, 0};
  // Whether joints hold it to a static or kinematic object, and to a link of an articulation.
  bool is_anchored = false, is_held = false;
};

// What the engine remembers of the motion of a body: a reset forgets it all.
struct BodyMemory {
  // Number of the sub-step in which the body was last in contact; maintained by AmbIntegrator_Ballistic and _RungeKutta
  // only.
  uint64_t contact_sub_step = 0;
  // Length of the last sub-step in which constraints acted on the body, s; 0: none since its pose was set. And the change
  // of angular velocity in it by everything but the gyroscopic torque, rad/s. See the engine's second_order.h.
  btScalar last_sub_step = 0;
  btVector3 other_angular_change{0, 0, 0};
  // By how much the drives of an island yield to its joints, kept by its first body; see the engine's src/island.
  double drive_yielding = 0;
  // Last sub-step in which that did not help; 0: none.
  unsigned drives_yielded_in_vain = 0;
  // Up to which residual impulses of the last sub-step are accepted as those of an island, kept by its first body; see
  // src/mlcp.
  double guess_tolerance = 0;
  SubStepStart start{btTransform::getIdentity(), {0, 0, 0}, {0, 0, 0}};
  // Number of the sub-step in which the body was last integrated as a free body.
  uint64_t free_flight_sub_step = 0;
  // For the energy ledger only: time by which the pose is ahead of the velocity, s; share of this sub-step for which
  // forces acted, see `last_sub_step`; linear (m/s) and angular (rad/s) velocity after the solver or after the
  // integration as a free body.
  btScalar pose_lead = 0;
  btScalar force_share = 1;
  btVector3 solved_velocity[2] = {{0, 0, 0}, {0, 0, 0}};
  // Index of its impact while those of a sub-step are found; -1: none.
  int impact = -1;
  TurnGroup turn_group;
};

// Data of the engine for each body.
struct EngineBody : BodyMemory {
  // The articulation of which the body is a link, and its index in `members`.
  AmbArticulation *articulation = nullptr;
  int member = 0;
  // Six rows that drive the body. Created when they are first needed, destroyed when the body leaves its world.
  std::unique_ptr<btTypedConstraint> drive;
  // Radius, m, of the sphere that is swept when the body moves further than that in a sub-step; 0: never.
  btScalar swept_radius = 0;
  // Whether continuous collision detection is enabled.
  bool is_continuous = false;
};

// The user pointer of constraints that can be driven, that are springs, or of which rows are left out points at their
// SoftRows: which of their rows are soft in this sub-step,
// J v = target - softness * impulse, and the impulses of all its rows in the last sub-step (warm start).
struct SoftRows {
  // As many rows as a joint has at most: a six-dof joint has two limits, a motor and a spring on each axis.
  static constexpr int MAX_GUESSES = 24;

  int first = 0;
  int count = 0;
  btScalar softness[6] = {};
  // Number of stored impulses, which are used only if the constraint has as many rows again, and the number of resets
  // of the solver when they were stored.
  int guesses = 0;
  unsigned guessed_after = 0;
  btScalar guess[MAX_GUESSES] = {};

  void forget() {
    guesses = 0;
    guessed_after = 0;
    std::fill(guess, guess + MAX_GUESSES, 0);
    std::fill(softness, softness + 6, 0);
  }

  // Bit k is set if row k was left out of a joint and holds in this sub-step because its error exceeds the clearance; see
  // the engine's exact_rows.h.
  unsigned beyond_clearance = 0;
};

// A velocity row that drives a hinge or slider: rate = velocity - softness * impulse, |impulse| <= max_force * h. And what
// resists the motion of its coordinate.
struct SoftMotor {
  bool enabled = false;
  btScalar velocity = 0;
  btScalar max_force = 0;
  btScalar softness = 0;
  // Viscous damping, N m s/rad or N s/m; inertia of the rotor, kg m^2 or kg; dry friction, N m or N; largest rate, rad/s or
  // m/s.
  btScalar damping = 0, armature = 0, friction = 0, max_rate = BT_LARGE_FLOAT;
  // Limits of the joint, rad or m, as they were set through the shim: Bullet wraps those of a hinge to [-pi, pi].
  // low > high: no limits.
  btScalar low = 1, high = -1;
  // The softness of these rows, and their indices among the rows of the constraint in this sub-step.
  SoftRows rows;

  bool bounds_rate() const { return max_rate < BT_LARGE_FLOAT; }

  // The coordinate of a hinge of which the angle is known up to whole turns, rad: in the turn that is nearest to the middle of
  // its limits, or without limits in [-pi, pi]. An angle that is there already is not changed in its last bit.
  btScalar coordinate_of(btScalar angle) const {
    const btScalar turn = 2 * SIMD_PI, middle = (low + high) / 2;
    const bool is_bounded = low <= high && std::isfinite(middle);
    // Nearly always it is there, and the functions below take longer than all else that reads a joint.
    if (std::fabs(is_bounded ? angle - middle : angle) < 3) return angle;
    if (!is_bounded) return std::remainder(angle, turn);
    const btScalar turns = std::nearbyint((angle - middle) / turn);
    return turns == 0 ? angle : angle - turn * turns;
  }
};

// Data of the engine for each constraint.
struct EngineConstraint {
  SoftMotor motor;
  // The articulation of which the constraint is a joint, and the index in `members` of the link that it moves.
  AmbArticulation *articulation = nullptr;
  int link = 0;
  // Rows that replace the constraint while it acts on a link without being a joint of that link's articulation.
  std::shared_ptr<ExternalConstraintRows> external_rows;
};

#endif
