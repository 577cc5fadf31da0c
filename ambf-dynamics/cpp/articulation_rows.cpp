#include "articulation_rows.h"

#include "exact_rows.h"
#include "position_error.h"

#include <algorithm>

namespace {

// CFM as a share of the response, which regularises several rows on one coordinate.
constexpr btScalar SOFTNESS = 1e-9;
// CFM of external constraints, as a share of the response of their rows.
constexpr btScalar EXTERNAL_SOFTNESS = 1e-6;
// Largest number of rows of the limits of a joint of several coordinates.
constexpr int MAX_ROWS = 6;

}  // namespace

JointRows::JointRows(AmbArticulation &owner)
    : EngineRows(owner.multi_body.get(), nullptr, 0, -1, 3 * owner.tree->coordinates, false,
                 MULTIBODY_CONSTRAINT_1DOF_JOINT_MOTOR),
      articulation(owner) {
  // Maximum number of rows: two limits, a motor, a rotor, friction and two largest rates for each coordinate, two limits and a
  // force for each spring, and the limits of joints of several coordinates.
  m_numRows = 7 * owner.tree->coordinates + 3 * static_cast<int>(owner.springs.size());
  m_data.resize(m_numRows + MAX_ROWS * static_cast<int>(owner.members.size()), 0);
}

int JointRows::getIslandIdA() const { return articulation.members[1].collider->getIslandTag(); }

void JointRows::give_wide_limits(btScalar h) {
  tree_table->clear_wide_rows(articulation.tree);
  for (size_t i = 1; i < articulation.members.size(); ++i) {
    AmbConstraint &joint = *articulation.members[i].joint;
    if (joint.kind == Kind::ConeTwist || joint.kind == Kind::SixDof) give_limits_of(joint, static_cast<int>(i), h);
  }
}

// Limits of a cone-twist or six-dof joint: rows of Bullet's constraint.
void JointRows::give_limits_of(AmbConstraint &joint, int member, btScalar h) {
  btTypedConstraint &constraint = *joint.constraint;
  btTypedConstraint::btConstraintInfo1 sizes;
  constraint.getInfo1(&sizes);
  btVector3 linear[2 * MAX_ROWS], angular[2 * MAX_ROWS];
  btVector3 bounds[MAX_ROWS], errors[MAX_ROWS];
  for (int k = 0; k < 2 * MAX_ROWS; ++k) linear[k] = angular[k] = btVector3(0, 0, 0);
  for (int k = 0; k < MAX_ROWS; ++k) {
    bounds[k].setValue(-BT_LARGE_FLOAT, BT_LARGE_FLOAT, 0);
    errors[k].setZero();
  }
  btTypedConstraint::btConstraintInfo2 rows;
  rows.fps = 1 / h;
  rows.erp = LIMIT_ERP;
  rows.rowskip = sizeof(btVector3) / sizeof(btScalar);
  rows.m_J1linearAxis = &linear[0][0];
  rows.m_J2linearAxis = &linear[MAX_ROWS][0];
  rows.m_J1angularAxis = &angular[0][0];
  rows.m_J2angularAxis = &angular[MAX_ROWS][0];
  rows.m_constraintError = &errors[0][0];
  rows.cfm = &errors[0][1];
  rows.m_lowerLimit = &bounds[0][0];
  rows.m_upperLimit = &bounds[0][1];
  rows.m_numIterations = 1;
  rows.m_damping = 1;
  constraint.getInfo2(&rows);
  const int child = &second_of(joint) == articulation.members[member].body ? MAX_ROWS : 0;
  for (int k = 0; k < sizes.m_numConstraintRows; ++k) {
    const Tree::WideRow row{member, bounds[k][0], bounds[k][1], errors[k][0], linear[child + k], angular[child + k]};
    tree_table->add_wide_row(articulation.tree, &row);
  }
}

void JointRows::createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                                     const btContactSolverInfo &info) {
  const int count = tree_table->rows(articulation.tree), n = articulation.tree->velocities(), first = data.m_jacobians.size();
  if (count == 0) return;
  const int velocity = velocities_of(articulation, data);
  data.m_jacobians.resize(first + count * n, 0);
  tree_table->write_rows(articulation.tree, &data.m_jacobians[first]);
  data.m_deltaVelocitiesUnitImpulse.resize(first + count * n);
  std::copy_n(&data.m_jacobians[first], count * n, &data.m_deltaVelocitiesUnitImpulse[first]);
  for (int i = 0; i < count; ++i) {
    const Tree::Row &plan = planned(i);
    btMultiBodySolverConstraint &row = new_row(rows, i, data);
    row.m_multiBodyA = articulation.multi_body.get();
    row.m_deltaVelAindex = velocity;
    row.m_jacAindex = first + i * n;
    const btScalar softness = std::max(plan.softness, plan.softest * SOFTNESS), whole = plan.response + softness;
    row.m_lowerLimit = plan.low - plan.feedforward;
    row.m_upperLimit = plan.high - plan.feedforward;
    row.m_jacDiagABInv = whole > 0 ? 1 / whole : 0;
    row.m_cfm = softness * row.m_jacDiagABInv;
    row.m_rhs = (plan.target - plan.softness * plan.feedforward - plan.velocity) * row.m_jacDiagABInv;
    row.m_rhsPenetration = plan.correction * row.m_jacDiagABInv;
    internalSetAppliedImpulse(i, 0);
  }
}

ExternalConstraintRows::ExternalConstraintRows(AmbConstraint &owner, AmbBody &link_body, const btTransform &link_frame,
                                               AmbBody &other_body, const btTransform &frame_of_other, int rows)
    : EngineRows(link_body.articulation->multi_body.get(),
                 other_body.articulation ? other_body.articulation->multi_body.get() : nullptr, link_body.member - 1,
                 other_body.articulation ? other_body.member - 1 : -1, rows, false, MULTIBODY_CONSTRAINT_FIXED),
      constraint(owner),
      link(link_body),
      other(other_body),
      frame(link_frame),
      other_frame(frame_of_other) {
  m_data.resize(rows);
  reset();
}

void ExternalConstraintRows::reset() {
  for (int i = 0; i < m_numRows; ++i) m_data[i] = 0;
}

void ExternalConstraintRows::createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                                                  const btContactSolverInfo &info) {
  const btTransform a = link.body.getWorldTransform() * frame, b = other.body.getWorldTransform() * other_frame;
  const btVector3 gap = a.getOrigin() - b.getOrigin();
  const btQuaternion turn = (a.getRotation() * b.getRotation().inverse()).normalized();
  btVector3 angle(0, 0, 0);
  const btScalar half = btVector3(turn.x(), turn.y(), turn.z()).length();
  if (half > 0)
    angle = btVector3(turn.x(), turn.y(), turn.z()) / half * std::remainder(2 * btAtan2(half, turn.w()), 2 * SIMD_PI);
  // No warm start by Bullet, which would apply the stored impulses to the articulation only, not to a rigid body at the
  // other end.
  for (int i = 0; i < m_numRows; ++i) guesses[i] = m_data[i];
  reset();
  const bool is_dynamic = !other.articulation && other.body.getInvMass() > 0;
  JointMotion motion;
  const btVector3 arm_a = a.getOrigin() - link.body.getWorldTransform().getOrigin();
  const btVector3 arm_b = b.getOrigin() - other.body.getWorldTransform().getOrigin();
  for (int i = 0; i < 3; ++i) {
    btVector3 normal(0, 0, 0);
    normal[i] = 1;
    motion.add_row(normal, arm_a.cross(normal), -normal, -arm_b.cross(normal));
  }
  motion.finish(link.body.getLinearVelocity(), link.body.getAngularVelocity(), other.body.getLinearVelocity(),
                other.body.getAngularVelocity(), info.m_timeStep);
  for (int i = 0; i < m_numRows; ++i) {
    btMultiBodySolverConstraint &row = new_row(rows, i, data);
    btVector3 linear(0, 0, 0), angular(0, 0, 0);
    (i < 3 ? linear : angular)[i % 3] = 1;
    RowMotion motion_of_row =
        act_on_member(row, 0, *link.articulation, link.member, linear, angular + arm_a.cross(linear), data);
    const btVector3 back = -linear, turn_back = -(angular + arm_b.cross(linear));
    RowMotion part;
    if (other.articulation) {
      part = act_on_member(row, 1, *other.articulation, other.member, back, turn_back, data);
    } else if (is_dynamic) {
      part = act_on_body(row, 1, other.body.getCompanionId(), back, turn_back, *data.m_solverBodyPool);
    }
    const btScalar whole = motion_of_row.response + part.response;
    row.m_jacDiagABInv = whole > SIMD_EPSILON ? 1 / whole : 0;
    row.m_rhs = -(motion_of_row.velocity + part.velocity) * row.m_jacDiagABInv;
    const btScalar error = i < 3 ? gap[i] : angle[i - 3];
    errors[i] = error;
    const btScalar target = -error * info.m_erp / info.m_timeStep;
    biases[i] = i < 3 ? motion.linear_target(-linear) : 0;
    row.m_rhs += biases[i] * row.m_jacDiagABInv;
    row.m_rhsPenetration = target * row.m_jacDiagABInv;
    // CFM regularises rows that the articulation cannot move, and redundant rows.
    const btScalar share = 1 / (1 + EXTERNAL_SOFTNESS);
    row.m_rhs *= share;
    row.m_rhsPenetration = row.m_rhsPenetration * share;
    row.m_jacDiagABInv *= share;
    row.m_cfm = EXTERNAL_SOFTNESS * share;
  }
}

void ExternalConstraintRows::write_feedback(btScalar h) {
  if (!constraint.feedback) return;
  btVector3 force(m_data[0] / h, m_data[1] / h, m_data[2] / h), torque(0, 0, 0);
  if (m_numRows > 3) torque = btVector3(m_data[3] / h, m_data[4] / h, m_data[5] / h);
  const btVector3 arm = link.body.getWorldTransform().getBasis() * frame.getOrigin();
  const btVector3 other_arm = other.body.getWorldTransform().getBasis() * other_frame.getOrigin();
  const bool link_is_a = &first_of(constraint) == &link;
  btJointFeedback &feedback = *constraint.feedback;
  (link_is_a ? feedback.m_appliedForceBodyA : feedback.m_appliedForceBodyB) = force;
  (link_is_a ? feedback.m_appliedTorqueBodyA : feedback.m_appliedTorqueBodyB) = torque + arm.cross(force);
  (link_is_a ? feedback.m_appliedForceBodyB : feedback.m_appliedForceBodyA) = -force;
  (link_is_a ? feedback.m_appliedTorqueBodyB : feedback.m_appliedTorqueBodyA) = -(torque + other_arm.cross(force));
}

LinkDrive::LinkDrive(AmbBody &body)
    : EngineRows(body.articulation->multi_body.get(), nullptr, body.member - 1, -1, 6, false,
                 MULTIBODY_CONSTRAINT_FIXED),
      link(body) {
  m_data.resize(6);
  for (int i = 0; i < 6; ++i) m_data[i] = 0;
}

void LinkDrive::createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                                     const btContactSolverInfo &) {
  if (!enabled) return;
  for (int i = 0; i < 6; ++i) {
    btMultiBodySolverConstraint &row = new_row(rows, i, data);
    btVector3 linear(0, 0, 0), angular(0, 0, 0);
    (i < 3 ? linear : angular)[i % 3] = 1;
    const RowMotion motion = act_on_member(row, 0, *link.articulation, link.member, linear, angular, data);
    // A direction in which the articulation cannot move has no response and no row.
    if (motion.response <= SIMD_EPSILON) continue;
    const btScalar whole = motion.response + softness[i / 3];
    row.m_jacDiagABInv = 1 / whole;
    row.m_cfm = softness[i / 3] / whole;
    row.m_rhs = (velocity[i] - motion.velocity) / whole;
  }
}
