#include "engine.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "engine_solvers.h"
#include "substepped_world.h"
#include "sweep.h"
#include "turn_limit.h"
#include "articulation_solver.h"
#include "articulation_rows.h"

void EngineWorld::configure(btDefaultCollisionConfiguration &configuration) {
  // By default the plane algorithm finds one contact point per step: a sliding box would rock from corner to corner.
  if (solver == AmbSolver_Accurate) configuration.setPlaneConvexMultipointIterations(4, 4);
}

void EngineWorld::add_algorithms(btCollisionDispatcher &dispatcher) {
  if (solver == AmbSolver_Accurate) contact_algorithms.enable(dispatcher, *world.configuration);
}

std::unique_ptr<btConstraintSolver> EngineWorld::make_solver(btMLCPSolverInterface *mlcp) {
  if (kind == AmbWorldKind_Articulated) return multi_body_solver_of(solver, accurate, ledger);
  return soft_row_solver_of(solver, mlcp, accurate, ledger);
}

void EngineWorld::make_world(btConstraintSolver &made) {
  world.articulated = fill_world<ArticulatedWorld>(world, static_cast<btMultiBodyConstraintSolver *>(&made));
}

void EngineWorld::mesh_comes(const AmbShape &shape) {
  if (solver == AmbSolver_Accurate) contact_algorithms.add_mesh(shape, world.dispatcher);
}

void EngineWorld::volumes_come() { contact_algorithms.add_volumes(world.dispatcher); }

void EngineWorld::before_motion(const btAlignedObjectArray<btRigidBody *> &bodies, btScalar dt) {
  if (solver == AmbSolver_Accurate) limit_turns(*this, dt);
  if (has_continuous) find_impacts(*this, bodies, dt);
}

void EngineWorld::after_motion() {
  if (has_continuous) stop_at_impacts(*this);
  if (ledger.enabled) ledger.after_motion(*this);
}

void EngineWorld::before_sub_step(btScalar h) {
  if (ledger.enabled) ledger.before_sub_step(*this, h);
}

void EngineWorld::after_sub_step(btScalar h) {
  accurate.is_continued = false;
  if (ledger.enabled) ledger.after_sub_step(*this, h);
}

void EngineWorld::gravity_set(const btVector3 &gravity) {
  if (!world.articulated) return;
  for (AmbArticulation *articulation : world.articulated->articulations) {
    for (AmbArticulation::Member &member : articulation->members) {
      if (member.collider) member.body->body.setGravity(gravity);
    }
  }
}

void EngineWorld::velocity_set(AmbBody &body) {
  if (body.articulation) body.articulation->velocities_set = true;
}

bool EngineWorld::pose_set(AmbBody &body) {
  accurate.recent_turn_rate = 0;
  body.last_sub_step = 0;
  body.other_angular_change.setZero();
  body.drive_yielding = 0;
  body.drives_yielded_in_vain = 0;
  body.guess_tolerance = 0;
  // setWorldTransform leaves the inertia tensor in world axes as it was until the end of the next sub-step. With the other
  // solvers it stays so, as in plain Bullet.
  if (solver == AmbSolver_Accurate) body.body.updateInertiaTensor();
  if (body.articulation) body.articulation->poses_set = true;
  for (AmbCoupling *coupling : couplings) coupling->has_jumped = coupling->has_jumped || coupling->moves(body);
  return body.articulation;
}

void EngineWorld::body_leaves(AmbBody &body) { drop_drive(world, body); }

void EngineWorld::body_changed(AmbBody &body) {
  if (body.articulation) body.articulation->body_changed(body);
}

void EngineWorld::body_reset(AmbBody &body) {
  amb_body_clear_drive(&body);
  drop_drive(world, body);
  static_cast<BodyMemory &>(body) = {};
}

bool EngineWorld::add_constraint(AmbConstraint &constraint) {
  if (!acts_on_link(constraint)) return false;
  add_external_constraint(world, constraint);
  return true;
}

bool EngineWorld::remove_constraint(AmbConstraint &constraint) {
  if (!constraint.external_rows) return false;
  remove_external_constraint(world, constraint);
  return true;
}

bool EngineWorld::read_coordinate(const AmbConstraint &constraint, btScalar &coordinate) {
  if (!constraint.articulation) return false;
  coordinate = constraint.articulation->coordinate(constraint);
  return true;
}

void EngineWorld::recovered() {
  accurate.recent_turn_rate = 0;
  sub_step = 0;
  for (AmbCoupling *coupling : couplings) coupling->reset();
  // The energy of the state that was left has no relation to that of the new one.
  if (ledger.enabled) ledger.start(*this);
  if (!world.articulated) return;
  for (AmbConstraint *constraint : world.articulated->external_constraints) constraint->external_rows->reset();
  const btVector3 zero(0, 0, 0);
  for (AmbArticulation *articulation : world.articulated->articulations) {
    for (AmbArticulation::Member &member : articulation->members) {
      btRigidBody &body = member.body->body;
      body.setInterpolationWorldTransform(body.getWorldTransform());
      body.setInterpolationLinearVelocity(zero);
      body.setInterpolationAngularVelocity(zero);
    }
  }
}

btScalar spring_coordinate(AmbConstraint &c) { return axis_reading(c, moves_about_z(c)); }

namespace {

struct DynamicsEngine final : AmbEngine {
  std::unique_ptr<Extension> extend(AmbWorld &world, int solver, int kind) const override {
    return std::make_unique<EngineWorld>(world, solver, kind);
  }
};

}  // namespace

extern "C" {

const AmbEngine *amb_dynamics_engine(void) {
  static const DynamicsEngine engine;
  return &engine;
}

void amb_world_set_accurate(AmbWorld *world, const AmbAccurateSettings *settings) {
  static_cast<AmbAccurateSettings &>(engine_of(*world).accurate) = *settings;
}

void amb_world_take_statistics(AmbWorld *world, AmbSolverStatistics *out) {
  *out = engine_of(*world).accurate.statistics;
  engine_of(*world).accurate.statistics = {};
}

double amb_world_jointed_turn_rate(AmbWorld *world) {
  btScalar fastest = 0;
  const auto look_at = [&](const btRigidBody &body) {
    if (body.getInvMass() > 0 && body.isActive()) fastest = std::max(fastest, body.getAngularVelocity().length2());
  };
  btDiscreteDynamicsWorld &bullet = *world->world;
  for (int i = 0; i < bullet.getNumConstraints(); ++i) {
    const btTypedConstraint &constraint = *bullet.getConstraint(i);
    if (!constraint.isEnabled()) continue;
    look_at(constraint.getRigidBodyA());
    look_at(constraint.getRigidBodyB());
  }
  if (world->articulated) {
    for (const AmbConstraint *constraint : world->articulated->external_constraints) {
      look_at(first_of(*constraint).body);
      look_at(second_of(*constraint).body);
    }
  }
  // A loop near a singular configuration, or with links of little inertia, moves fast for single sub-steps, again and again.
  constexpr double KEPT = 0.98;
  double &recent = engine_of(*world).accurate.recent_turn_rate;
  const double rate = std::sqrt(fastest);
  if (!std::isfinite(rate)) return rate;
  recent = std::max(rate, KEPT * recent);
  return recent;
}

int amb_world_continue_sub_step(AmbWorld *world) {
  AccurateContext &accurate = engine_of(*world).accurate;
  accurate.is_continued = true;
  return island_table->may_divide(&accurate.budgets);
}

void amb_world_count_division(AmbWorld *world) { ++engine_of(*world).accurate.statistics.divided_sub_steps; }

void amb_world_set_energy_ledger(AmbWorld *world, int enabled) {
  EngineWorld &engine = engine_of(*world);
  if (enabled) {
    engine.ledger.start(engine);
  } else {
    engine.ledger.stop();
  }
}

void amb_world_energy(const AmbWorld *world, AmbEnergy *out) { *out = engine_of(*world).ledger.read(); }

void amb_set_islands(const void *table) {
  island_table = static_cast<const AmbIslandTable *>(table);
  assert(island_table->sizes[0] == sizeof(AmbIslandRow) && island_table->sizes[1] == sizeof(AmbIslandSide));
  assert(island_table->sizes[2] == sizeof(AmbIslandProblem) && island_table->sizes[3] == sizeof(AmbBudgets));
  assert(island_table->sizes[4] == sizeof(AmbIslandSolution));
}
void amb_set_trees(const void *table) {
  tree_table = static_cast<const TreeTable *>(table);
  assert(tree_table->sizes[0] == sizeof(Tree::Link) && tree_table->sizes[1] == sizeof(Tree::Body));
  assert(tree_table->sizes[2] == sizeof(Tree::Spring) && tree_table->sizes[3] == sizeof(Tree::Joint));
  assert(tree_table->sizes[4] == sizeof(Tree::Row) && tree_table->sizes[5] == sizeof(Tree::WideRow));
  assert(tree_table->sizes[6] == sizeof(Tree::Circumstances) && tree_table->sizes[7] == sizeof(Tree));
}

}  // extern "C"
