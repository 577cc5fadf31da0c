#include "internal.h"

namespace {

// Bits whose meaning is the negation of their member's.
constexpr int INVERTED = SOLVER_DISABLE_VELOCITY_DEPENDENT_FRICTION_DIRECTION | SOLVER_DISABLE_IMPLICIT_CONE_FRICTION;

struct ModeBit {
  int AmbSolverSettings::*field;
  int bit;
};

constexpr ModeBit MODE_BITS[] = {
    {&AmbSolverSettings::warm_starting, SOLVER_USE_WARMSTARTING},
    {&AmbSolverSettings::two_friction_directions, SOLVER_USE_2_FRICTION_DIRECTIONS},
    {&AmbSolverSettings::friction_direction_caching, SOLVER_ENABLE_FRICTION_DIRECTION_CACHING},
    {&AmbSolverSettings::velocity_dependent_friction_direction, SOLVER_DISABLE_VELOCITY_DEPENDENT_FRICTION_DIRECTION},
    {&AmbSolverSettings::interleave_friction, SOLVER_INTERLEAVE_CONTACT_AND_FRICTION_CONSTRAINTS},
    {&AmbSolverSettings::implicit_friction_cone, SOLVER_DISABLE_IMPLICIT_CONE_FRICTION},
    {&AmbSolverSettings::randomise_order, SOLVER_RANDMIZE_ORDER},
};

struct Number {
  double AmbSolverSettings::*field;
  btScalar btContactSolverInfoData::*member;
};

constexpr Number NUMBERS[] = {
    {&AmbSolverSettings::joint_erp, &btContactSolverInfoData::m_erp},
    {&AmbSolverSettings::contact_erp, &btContactSolverInfoData::m_erp2},
    {&AmbSolverSettings::global_cfm, &btContactSolverInfoData::m_globalCfm},
    {&AmbSolverSettings::friction_erp, &btContactSolverInfoData::m_frictionERP},
    {&AmbSolverSettings::friction_cfm, &btContactSolverInfoData::m_frictionCFM},
    {&AmbSolverSettings::linear_slop, &btContactSolverInfoData::m_linearSlop},
    {&AmbSolverSettings::damping, &btContactSolverInfoData::m_damping},
    {&AmbSolverSettings::over_relaxation, &btContactSolverInfoData::m_sor},
    {&AmbSolverSettings::residual_threshold, &btContactSolverInfoData::m_leastSquaresResidualThreshold},
    {&AmbSolverSettings::restitution_velocity_threshold, &btContactSolverInfoData::m_restitutionVelocityThreshold},
    {&AmbSolverSettings::warm_starting_factor, &btContactSolverInfoData::m_warmstartingFactor},
    {&AmbSolverSettings::split_impulse_penetration_threshold,
     &btContactSolverInfoData::m_splitImpulsePenetrationThreshold},
    {&AmbSolverSettings::split_impulse_turn_erp, &btContactSolverInfoData::m_splitImpulseTurnErp},
};

}  // namespace

extern "C" {

void amb_world_get_settings(const AmbWorld *world, AmbSolverSettings *settings) {
  const btContactSolverInfo &info = world->world->getSolverInfo();
  settings->iterations = info.m_numIterations;
  settings->minimum_batch_size = info.m_minimumSolverBatchSize;
  settings->split_impulse = info.m_splitImpulse != 0;
  for (const Number &number : NUMBERS) settings->*number.field = info.*number.member;
  for (const ModeBit &mode : MODE_BITS) settings->*mode.field = ((info.m_solverMode ^ INVERTED) & mode.bit) != 0;
}

void amb_world_set_settings(AmbWorld *world, const AmbSolverSettings *settings) {
  btContactSolverInfo &info = world->world->getSolverInfo();
  info.m_numIterations = settings->iterations;
  info.m_minimumSolverBatchSize = settings->minimum_batch_size;
  info.m_splitImpulse = settings->split_impulse;
  for (const Number &number : NUMBERS) info.*number.member = settings->*number.field;
  int bits = info.m_solverMode ^ INVERTED;
  for (const ModeBit &mode : MODE_BITS) bits = settings->*mode.field ? bits | mode.bit : bits & ~mode.bit;
  info.m_solverMode = bits ^ INVERTED;
}

void amb_world_set_tight_bounds(AmbWorld *world, int enabled) { world->broadphase.tight = enabled != 0; }

void amb_body_set_gyroscopic(AmbBody *body, int kind) {
  constexpr int FLAGS[] = {0, BT_ENABLE_GYROSCOPIC_FORCE_EXPLICIT, BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_WORLD,
                           BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_BODY};
  constexpr int ALL = FLAGS[1] | FLAGS[2] | FLAGS[3];
  body->body.setFlags((body->body.getFlags() & ~ALL) | FLAGS[kind]);
}

}  // extern "C"
