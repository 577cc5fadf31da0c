// The engine's part of a world. C++ only.
#ifndef AMB_ENGINE_H
#define AMB_ENGINE_H

#include "accurate_context.h"
#include "contact_algorithms.h"
#include "coupling.h"
#include "internal.h"
#include "ledger.h"

extern "C" {
#include "dynamics.h"
}

// A body that hits another object within the sub-step, or is joined to one that does. It follows its own motion for the
// share of the sub-step until then, and moves with velocity `drift` (m/s) for the rest.
struct AmbImpact {
  AmbBody *body;
  btScalar share;
  btVector3 drift;
  // Whether joints hold it to a static or kinematic object, and to a link of an articulation.
  bool is_anchored, is_held;
  // At the end of the sub-step.
  btTransform pose;
};

class EngineWorld final : public Extension {
 public:
  EngineWorld(AmbWorld &owner, int solver_kind, int world_kind) : world(owner), solver(solver_kind), kind(world_kind) {}

  void configure(btDefaultCollisionConfiguration &configuration) override;
  void add_algorithms(btCollisionDispatcher &dispatcher) override;
  std::unique_ptr<btConstraintSolver> make_solver(btMLCPSolverInterface *mlcp) override;
  void make_world(btConstraintSolver &made) override;
  void mesh_comes(const AmbShape &shape) override;
  void volumes_come() override;
  void before_sub_step(btScalar h) override;
  void after_sub_step(btScalar h) override;
  void before_motion(const btAlignedObjectArray<btRigidBody *> &bodies, btScalar dt) override;
  void after_motion() override;
  void gravity_set(const btVector3 &gravity) override;
  void velocity_set(AmbBody &body) override;
  bool pose_set(AmbBody &body) override;
  void body_leaves(AmbBody &body) override;
  void body_changed(AmbBody &body) override;
  void body_reset(AmbBody &body) override;
  bool add_constraint(AmbConstraint &constraint) override;
  bool remove_constraint(AmbConstraint &constraint) override;
  bool read_coordinate(const AmbConstraint &constraint, btScalar &coordinate) override;
  void recovered() override;
  bool cast_ray(const btVector3 &from, const btVector3 &to, btCollisionWorld::RayResultCallback &result) override;

  AmbWorld &world;
  // An AmbSolver and an AmbWorldKind.
  const int solver, kind;
  AccurateContext accurate;
  EnergyLedger ledger;
  int integrator = AmbIntegrator_Euler;
  // See amb_world_set_trees_by_euler.
  bool trees_by_euler = false;
  // See amb_world_set_reactions.
  bool has_reactions = true;
  // Number of the sub-step; counted for AmbIntegrator_Ballistic and AmbIntegrator_RungeKutta only.
  uint64_t sub_step = 0;
  // Continuous collision detection is enabled for at least one body, see sweep.h.
  bool has_continuous = false;
  // See rays.h.
  bool exact_rays = false;
  Vector<AmbImpact> impacts;
  // In the order in which they were added: a follower comes after its leaders.
  Vector<AmbCoupling *> couplings;
  ContactAlgorithms contact_algorithms;
};

// The engine's part of a world, which must have been made with this engine.
inline EngineWorld &engine_of(const AmbWorld &world) { return static_cast<EngineWorld &>(*world.extension); }

// Whether two bodies of a constraint are in a world of AmbSolver_Accurate; one of them may be in no world.
inline bool is_accurate(const btRigidBody &first, const btRigidBody &second) {
  const AmbBody *a = body_of(&first), *b = body_of(&second);
  const AmbWorld *world = a && a->world ? a->world : b ? b->world : nullptr;
  return world && world->extension && engine_of(*world).solver == AmbSolver_Accurate;
}

// Destroys the drive of a body before the body leaves its world; see drive.cpp.
void drop_drive(AmbWorld &world, AmbBody &body);

#endif
