// Joints of Bullet whose rows are the gradients of their position errors, in worlds of AmbSolver_Accurate. C++ only.
//
// Bullet's rows differ from the gradients, which sequential impulses with a small ERP forgive. A correction of positions
// that solves the rows exactly then moves bodies elsewhere than the errors say, in the worst case away from where they
// should be, by more in each sub-step:
//   - Where one body is static and the joint is at an angular limit, hinges, sliders and six-dof joints leave the angular
//     velocity of the other body out of a linear row.
//   - The arms of a slider or six-dof joint end at different points where the bodies have slid apart: the two forces of
//     a row have different lines of action.
//   - The row of an Euler angle of a six-dof joint is a unit vector. The gradient of the first and of the last angle is
//     longer by 1 / cos of the middle one.
//   - The row of a cone-twist joint's swing is not along the normal of the elliptic cone, see set_exact_swing.
//   - The row of the twist acts along the x axis of B, see set_exact_twist.
#ifndef AMB_EXACT_ROWS_H
#define AMB_EXACT_ROWS_H

#include <BulletDynamics/ConstraintSolver/btConeTwistConstraint.h>

#include <type_traits>

#include "engine.h"
#include "joint_arms.h"
#include "soft_rows.h"

// One row of a constraint as it is passed to Bullet's solver.
struct ConstraintRow {
  ConstraintRow(btTypedConstraint::btConstraintInfo2 &all, int index)
      : linear_a(all.m_J1linearAxis + index * all.rowskip),
        angular_a(all.m_J1angularAxis + index * all.rowskip),
        linear_b(all.m_J2linearAxis + index * all.rowskip),
        angular_b(all.m_J2angularAxis + index * all.rowskip),
        target(all.m_constraintError[index * all.rowskip]),
        lower(all.m_lowerLimit[index * all.rowskip]),
        upper(all.m_upperLimit[index * all.rowskip]) {}

  // h: sub-step, s.
  void set_motor(const SoftMotor &motor, btScalar h) {
    target = motor.velocity;
    lower = -motor.max_force * h;
    upper = motor.max_force * h;
  }

  void set(btScalar to, btScalar low, btScalar high) {
    target = to;
    lower = low;
    upper = high;
  }

  static btVector3 vector(const btScalar *values) { return btVector3(values[0], values[1], values[2]); }
  bool is_angular() const { return vector(linear_a).isZero(); }

  btScalar *linear_a, *angular_a, *linear_b, *angular_b;
  btScalar &target, &lower, &upper;
};

// The rows of a joint in one sub-step.
struct ConstraintRows {
  btTypedConstraint::btConstraintInfo2 &info;
  int count;

  ConstraintRow operator[](int index) const { return ConstraintRow(info, index); }
};

// Sets the angular parts of linear rows n to arm x n, with the arms to the pivots.
inline void set_exact_arms(const btTypedConstraint &joint, const ConstraintRows &rows) {
  btVector3 arm_a, arm_b;
  if (!find_joint_arms(joint, arm_a, arm_b)) return;
  for (int k = 0; k < rows.count; ++k) {
    const ConstraintRow row = rows[k];
    if (row.is_angular()) continue;
    write_vector(arm_a.cross(ConstraintRow::vector(row.linear_a)), row.angular_a);
    write_vector(arm_b.cross(ConstraintRow::vector(row.linear_b)), row.angular_b);
  }
}

// Scales the errors of the first and last Euler angle, in the order x, y, z, by the cosine of the middle one.
template <class SixDof>
void scale_euler_errors(const SixDof &joint, const ConstraintRows &rows) {
  const btVector3 z_a = joint.getCalculatedTransformA().getBasis().getColumn(2),
                  x_b = joint.getCalculatedTransformB().getBasis().getColumn(0);
  const btScalar cosine = z_a.cross(x_b).length();
  for (int k = 0; k < rows.count; ++k) {
    const ConstraintRow row = rows[k];
    // The other two axes are orthogonal to the axis of the middle angle.
    const btScalar along_middle = ConstraintRow::vector(row.angular_a).dot(joint.getAxis(1));
    if (row.is_angular() && btFabs(along_middle) < SIMDSQRT12) row.target *= cosine;
  }
}

inline btVector3 x_axis(const btTransform &frame) { return frame.getBasis().getColumn(0); }

// The swing takes the x axis of B to that of A by the angle theta about the unit vector u, which has the components y and z
// in the frame of B. Its limit is the radius of the ellipse, 1 / sqrt(y^2 / span2^2 + z^2 / span1^2), in the direction of
// u. Sets the row to the gradient of theta less this limit. Bullet's row, along a normal with the ratio of the spans where
// the ellipse has that of their squares, lets a swing that moves along its limit go beyond it, and the correction lifts
// what hangs on the joint.
inline void set_exact_swing(btConeTwistConstraint &joint, const btTransform &frame_b, const btVector3 &x_a,
                            const ConstraintRows &rows) {
  const btScalar span1 = joint.getSwingSpan1(), span2 = joint.getSwingSpan2();
  const bool has_cone = std::min(span1, span2) >= joint.getFixThresh();
  btVector3 axis = x_axis(frame_b).cross(x_a);
  const btScalar sine = axis.length();
  // Three linear rows come first.
  constexpr int SWING_ROW = 3;
  if (!has_cone || sine < SIMD_EPSILON || rows.count <= SWING_ROW) return;
  axis /= sine;
  const btScalar theta = btAtan2(sine, x_a.dot(x_axis(frame_b)));
  const btScalar y = axis.dot(frame_b.getBasis().getColumn(1)), z = axis.dot(frame_b.getBasis().getColumn(2));
  const btScalar normal_y = y / (span2 * span2), normal_z = z / (span1 * span1);
  const btScalar along = y * normal_y + z * normal_z, beside = y * normal_z - z * normal_y;
  btVector3 gradient = axis * along + x_a.cross(axis) * (beside * theta / sine);
  const btScalar length = gradient.length();
  gradient /= length;
  const ConstraintRow row = rows[SWING_ROW];
  row.target *= along / length;
  write_vector(-gradient, row.angular_a);
  write_vector(gradient, row.angular_b);
}

// The rotation between the bodies is a swing, which takes the x axis of one joint frame to that of the other on the
// shortest way, after a twist about x. The rate of the twist is w . (x_A + x_B) / (1 + x_A . x_B), with the relative
// angular velocity w. Bullet's row acts along x_B: while the swing moves around its cone, such a row lets the twist pass
// its limit, and the correction along x_B moves the swing on, which lifts what hangs on the joint.
inline void set_exact_twist(const btVector3 &x_a, const btVector3 &x_b, const ConstraintRows &rows) {
  const btScalar whole = 1 + x_a.dot(x_b);
  // Near a swing of half a turn the twist is not defined.
  constexpr btScalar LEAST = btScalar(1e-2);
  if (whole < LEAST || rows.count == 0) return;
  // The row of the twist is the last one.
  const ConstraintRow row = rows[rows.count - 1];
  const btVector3 gradient = (x_a + x_b) * (ConstraintRow::vector(row.angular_a).dot(x_b) / whole);
  write_vector(gradient, row.angular_a);
  write_vector(-gradient, row.angular_b);
}

// Rows that are left out of a joint because other joints of its loop demand the same (`src/assembly/redundancy.rs`). Their
// position errors do not count. The linear rows of a joint of which some are left out are along `axes`, the angular ones
// about the axes of the joint frame on A.
struct OmittedRows {
  bool is_any = false;
  // Joint frames in the inertial frames of A and B.
  btTransform frames[2];
  // Columns: unit vectors in the joint frame on body `side`; of a slider, the first is its axis.
  btMatrix3x3 axes;
  int side = 0;
  bool linear[3] = {}, angular[3] = {};
  // Position errors from which on these rows hold nevertheless, m and rad.
  btScalar linear_clearance = 0, angular_clearance = 0;
};

// Leaves a row out but for a soft resistance to velocities. That guides the mechanism through configurations in which its
// other rows do not determine its motion, as the third bar of a parallelogram does when the bars lie in a line. Where it
// moves as its loops imply, with a misfit of the share s of the lever arm, it loses the share s^2 / GUIDANCE of its
// velocity in a sub-step. Beyond the clearance it is a row of the joint on one side: the mechanism does not get into another
// configuration.
// Returns whether the error is beyond it.
inline bool leave_out(const ConstraintRows &rows, int k, btScalar error, btScalar clearance, btScalar rate) {
  // CFM as a share of the response.
  constexpr btScalar GUIDANCE = 10;
  const ConstraintRow row = rows[k];
  if (btFabs(error) <= clearance) {
    row.target = 0;
    rows.info.cfm[k * rows.info.rowskip] = GUIDANCE;
    return false;
  }
  (error > 0 ? row.lower : row.upper) = 0;
  row.target = rate * (error - (error > 0 ? clearance : -clearance));
  return true;
}

// Sets one row of a joint to the velocity of A less that of B along or about `axis`, with the position error `error`.
inline void set_row(const ConstraintRow &row, const btVector3 &axis, const btVector3 *arms, btScalar target) {
  const btVector3 none(0, 0, 0);
  write_vector(arms ? axis : none, row.linear_a);
  write_vector(arms ? -axis : none, row.linear_b);
  write_vector(arms ? arms[0].cross(axis) : axis, row.angular_a);
  write_vector(arms ? -arms[1].cross(axis) : -axis, row.angular_b);
  row.target = target;
}

// Returns the bits of the rows that are beyond their clearance.
inline unsigned leave_out(const btTypedConstraint &joint, const ConstraintRows &rows, const OmittedRows &omitted) {
  constexpr btScalar NO_BOUND = 1e9;
  const bool slides = joint.getConstraintType() == SLIDER_CONSTRAINT_TYPE;
  const bool turns_about_axis = joint.getConstraintType() == HINGE_CONSTRAINT_TYPE;
  const btTransform frames[2] = {joint.getRigidBodyA().getCenterOfMassTransform() * omitted.frames[0],
                                 joint.getRigidBodyB().getCenterOfMassTransform() * omitted.frames[1]};
  btVector3 arms[2];
  if (!find_joint_arms(joint, arms[0], arms[1])) return 0;
  const btVector3 gap = frames[1].getOrigin() - frames[0].getOrigin();
  // The axis of a hinge is z, that of a slider x.
  const int own = slides ? 0 : 2;
  const btVector3 tilt = frames[0].getBasis().getColumn(own).cross(frames[1].getBasis().getColumn(own));
  const btScalar rate = rows.info.fps * rows.info.erp;
  int linear = slides ? 1 : 0, angular = slides ? 1 : 0;
  unsigned beyond = 0;
  const auto leave_out_row = [&](int k, btScalar error, btScalar clearance) {
    if (leave_out(rows, k, error, clearance, rate)) beyond |= 1u << k;
  };
  for (int k = 0; k < rows.count; ++k) {
    const ConstraintRow row = rows[k];
    // Rows with bounds are limits.
    if (row.lower > -NO_BOUND || row.upper < NO_BOUND) continue;
    if (!row.is_angular()) {
      if (linear > 2) continue;
      const btVector3 axis = frames[omitted.side].getBasis() * omitted.axes.getColumn(linear);
      const btScalar error = gap.dot(axis);
      set_row(row, axis, arms, rate * error);
      if (omitted.linear[linear++]) leave_out_row(k, error, omitted.linear_clearance);
    } else if ((turns_about_axis || slides) && angular < own + 3) {
      // Those across the axis come first: x and y of a hinge, y and z of a slider. Then comes the lock of a slider.
      const int about = angular++ % 3;
      btScalar error = row.target / rate;
      if (about != own) {
        const btVector3 axis = frames[0].getBasis().getColumn(about);
        error = tilt.dot(axis);
        set_row(row, axis, nullptr, rate * error);
      }
      if (omitted.angular[about]) leave_out_row(k, error, omitted.angular_clearance);
    }
  }
  return beyond;
}

template <class Joint>
class WithExactRows : public Joint, public OmittedRows {
 public:
  using Joint::Joint;

  void getInfo1(btTypedConstraint::btConstraintInfo1 *info) override {
    Joint::getInfo1(info);
    count_ = info->m_numConstraintRows;
  }

  void getInfo2(btTypedConstraint::btConstraintInfo2 *info) override {
    Joint::getInfo2(info);
    if (!is_accurate(this->m_rbA, this->m_rbB)) return;
    const ConstraintRows rows{*info, count_};
    set_exact_arms(*this, rows);
    if constexpr (std::is_base_of_v<btGeneric6DofConstraint, Joint> ||
                  std::is_base_of_v<btGeneric6DofSpring2Constraint, Joint>) {
      scale_euler_errors(*this, rows);
    } else if constexpr (std::is_base_of_v<btConeTwistConstraint, Joint>) {
      const btVector3 x_a = x_axis(this->m_rbA.getCenterOfMassTransform() * this->getAFrame());
      const btTransform frame_b = this->m_rbB.getCenterOfMassTransform() * this->getBFrame();
      const btVector3 x_b = x_axis(frame_b);
      if (this->getSolveSwingLimit()) set_exact_swing(*this, frame_b, x_a, rows);
      if (this->getSolveTwistLimit()) set_exact_twist(x_a, x_b, rows);
    }
    const unsigned beyond = is_any ? leave_out(*this, rows, *this) : 0;
    if (SoftRows *memory = const_cast<SoftRows *>(soft_rows_of(*this))) memory->beyond_clearance = beyond;
  }

 private:
  int count_ = 0;
};

#endif
