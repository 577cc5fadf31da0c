#include "articulation_rows.h"
#include "engine.h"
#include "exact_rows.h"
#include "position_error.h"
#include "spring_rotation.h"

#include <algorithm>
#include <cmath>
#include <optional>

namespace {

// The rows of the motor and of what resists it come after the rows of Bullet.
void add_rows(SoftMotor &motor, btTypedConstraint::btConstraintInfo1 &info) {
  motor.rows.count = motor.enabled + (motor.damping > 0) + (motor.armature > 0) + (motor.friction > 0) +
                     (motor.bounds_rate() ? 2 : 0);
  if (motor.rows.count == 0) return;
  motor.rows.first = info.m_numConstraintRows;
  info.m_numConstraintRows += motor.rows.count;
  info.nub -= motor.rows.count;
}

// Removes the motor's impulse towards a limit that is reached or violated, and bounds the target of a motor without
// softness so that a limit is not passed within the sub-step.
void respect_limits(ConstraintRow &row, const SoftMotor &motor, btScalar at, btScalar per_second) {
  if (motor.low > motor.high) return;
  if (at <= motor.low) row.lower = 0;
  if (at >= motor.high) row.upper = 0;
  if (motor.softness > 0) return;
  // The target is never reversed: Bullet's limit row corrects a violation.
  if (row.target < 0) row.target = btMax(row.target, btMin((motor.low - at) * per_second, btScalar(0)));
  if (row.target > 0) row.target = btMin(row.target, btMax((motor.high - at) * per_second, btScalar(0)));
}

// Writes these rows. `set_axis` writes the Jacobian of the coordinate to a row; at, rate: coordinate, rad or m, and its rate.
template <class SetAxis>
void write_rows(SoftMotor &motor, btTypedConstraint::btConstraintInfo2 &info, btScalar at, btScalar rate, SetAxis set_axis) {
  const btScalar h = 1 / info.fps;
  int next = 0;
  const auto new_row = [&](btScalar softness) {
    ConstraintRow row(info, motor.rows.first + next);
    motor.rows.softness[next++] = softness;
    set_axis(row);
    return row;
  };
  if (motor.enabled) {
    ConstraintRow row = new_row(motor.softness);
    row.set_motor(motor, h);
    respect_limits(row, motor, at, info.fps);
  }
  // The impulse -h * damping * rate with the rate at the end of the sub-step: no damping is too strong.
  if (motor.damping > 0) new_row(1 / (h * motor.damping)).set(0, -BT_LARGE_FLOAT, BT_LARGE_FLOAT);
  // The impulse -armature * change of the rate.
  if (motor.armature > 0) new_row(1 / motor.armature).set(rate, -BT_LARGE_FLOAT, BT_LARGE_FLOAT);
  if (motor.friction > 0) new_row(0).set(0, -motor.friction * h, motor.friction * h);
  if (motor.bounds_rate()) {
    new_row(0).set(motor.max_rate, -BT_LARGE_FLOAT, 0);
    new_row(0).set(-motor.max_rate, 0, BT_LARGE_FLOAT);
  }
}

struct DrivenHinge : WithExactRows<btHingeConstraint> {
  DrivenHinge(btRigidBody &a, btRigidBody &b, const btTransform &frame_a, const btTransform &frame_b,
              SoftMotor &soft_motor)
      : WithExactRows(a, b, frame_a, frame_b, true), motor(soft_motor) {}

  void getInfo1(btConstraintInfo1 *info) override {
    WithExactRows::getInfo1(info);
    add_rows(motor, *info);
  }

  void getInfo2(btConstraintInfo2 *info) override {
    WithExactRows::getInfo2(info);
    if (motor.rows.count == 0) return;
    const btVector3 axis = (m_rbA.getCenterOfMassTransform() * getAFrame()).getBasis().getColumn(2);
    write_rows(motor, *info, motor.coordinate_of(getHingeAngle()), rate(), [&](ConstraintRow &row) {
      write_vector(-axis, row.angular_a);
      write_vector(axis, row.angular_b);
    });
  }

  btScalar rate() {
    const btVector3 axis = (m_rbA.getCenterOfMassTransform() * getAFrame()).getBasis().getColumn(2);
    return axis.dot(m_rbB.getAngularVelocity() - m_rbA.getAngularVelocity());
  }

  SoftMotor &motor;
};

// The coordinate of a slider is a . (p_B - p_A), with the axis a and the point p_A fixed in A, p_B in B. Its rate is
// a . (v_B + w_B x r_B - v_A - w_A x (p_B - x_A)): the force that belongs to it acts on both bodies at p_B.
struct DrivenSlider : WithExactRows<btSliderConstraint> {
  DrivenSlider(btRigidBody &a, btRigidBody &b, const btTransform &frame_a, const btTransform &frame_b,
               SoftMotor &soft_motor)
      : WithExactRows(a, b, frame_a, frame_b, true), motor(soft_motor) {}

  struct Geometry {
    btVector3 axis, arm_a, arm_b;
    btScalar position;
  };

  Geometry geometry() {
    const btTransform &a = m_rbA.getCenterOfMassTransform(), &b = m_rbB.getCenterOfMassTransform();
    const btTransform joint_a = a * getFrameOffsetA();
    const btVector3 point = b * getFrameOffsetB().getOrigin();
    const btVector3 axis = joint_a.getBasis().getColumn(0);
    return {axis, point - a.getOrigin(), point - b.getOrigin(), axis.dot(point - joint_a.getOrigin())};
  }

  void getInfo1(btConstraintInfo1 *info) override {
    WithExactRows::getInfo1(info);
    add_rows(motor, *info);
  }

  void getInfo2(btConstraintInfo2 *info) override {
    WithExactRows::getInfo2(info);
    if (motor.rows.count == 0) return;
    const Geometry now = geometry();
    write_rows(motor, *info, now.position, rate(now), [&](ConstraintRow &row) {
      write_vector(-now.axis, row.linear_a);
      write_vector(now.axis, row.linear_b);
      write_vector(-now.arm_a.cross(now.axis), row.angular_a);
      write_vector(now.arm_b.cross(now.axis), row.angular_b);
    });
  }

  btScalar rate(const Geometry &now) {
    return now.axis.dot(m_rbB.getVelocityInLocalPoint(now.arm_b) - m_rbA.getVelocityInLocalPoint(now.arm_a));
  }

  SoftMotor &motor;
};

// The springs of a six-dof constraint as rows that are implicit in position and velocity, in worlds of
// AmbSolver_Accurate; in other worlds they are Bullet's explicit forces. With displacement x, rate v, stiffness k,
// damping d and step h the force at the end of the sub-step is -k (x + h (v - v0)) - d v. The function `spring` in
// ambf-core's control/drive.rs explains why the rate v0 at the beginning is subtracted, and why h v0 is limited to half
// of the displacement.
struct ImplicitSpring : WithExactRows<btGeneric6DofSpring2Constraint> {
  ImplicitSpring(btRigidBody &a, btRigidBody &b, const btTransform &frame_a, const btTransform &frame_b,
                 SoftMotor &soft_motor)
      : WithExactRows(a, b, frame_a, frame_b, RO_XYZ), rows(soft_motor.rows) {
    // Springs exert their full force, as in Bullet 2; by default Bullet 3 targets the velocity that the force would
    // cause.
    m_flags |= BT_6DOF_FLAGS_USE_INFINITE_ERROR;
  }

  void getInfo1(btConstraintInfo1 *info) override {
    take_springs();
    WithExactRows::getInfo1(info);
    give_springs();
    rows.first = info->m_numConstraintRows;
    info->m_numConstraintRows += rows.count;
    info->nub -= rows.count;
  }

  void getInfo2(btConstraintInfo2 *info) override {
    if (rows.count == 0) return WithExactRows::getInfo2(info);
    take_springs();
    WithExactRows::getInfo2(info);
    give_springs();
    const btScalar h = 1 / info->fps;
    std::optional<SpringRotation> rotation;
    if (SpringRotation::holds_for(*this)) rotation.emplace(*this);
    int next = rows.first;
    for (int axis = 0; axis < 6; ++axis) {
      if (!taken[axis]) continue;
      ConstraintRow row(*info, next);
      const btScalar target = axis < 3 ? linear_row(row, axis, h) : angular_row(row, axis - 3, rotation, h);
      row.target = target;
      row.lower = -BT_LARGE_FLOAT;
      row.upper = BT_LARGE_FLOAT;
      ++next;
    }
  }

 private:
  // Disables the springs while Bullet sets up its rows.
  void take_springs() {
    rows.count = 0;
    const bool implicit = is_accurate(m_rbA, m_rbB);
    for (int axis = 0; axis < 6; ++axis) {
      bool &enabled = axis < 3 ? m_linearLimits.m_enableSpring[axis] : m_angularLimits[axis - 3].m_enableSpring;
      const btScalar stiffness =
          axis < 3 ? m_linearLimits.m_springStiffness[axis] : m_angularLimits[axis - 3].m_springStiffness;
      const btScalar damping =
          axis < 3 ? m_linearLimits.m_springDamping[axis] : m_angularLimits[axis - 3].m_springDamping;
      taken[axis] = implicit && enabled && stiffness >= 0 && damping >= 0 && stiffness + damping > 0;
      if (!taken[axis]) continue;
      enabled = false;
      ++rows.count;
    }
  }

  void give_springs() {
    for (int axis = 0; axis < 6; ++axis) {
      if (taken[axis])
        (axis < 3 ? m_linearLimits.m_enableSpring[axis] : m_angularLimits[axis - 3].m_enableSpring) = true;
    }
  }

  // Target velocity of a spring row, m/s or rad/s; sets its softness. `curved` is the change of the displacement in h
  // because bodies move along tangents, m. It is part of the displacement at the end of the sub-step as h v is: a stiff
  // spring between bodies that turn about each other would otherwise be stretched by it anew in each sub-step.
  btScalar target_of(int index, btScalar stiffness, btScalar damping, btScalar displacement, btScalar rate, btScalar h,
                     btScalar curved = 0) {
    const btScalar back = h * rate + curved, implicit = damping + h * stiffness;
    const btScalar share = back == 0 ? 0 : std::min(btScalar(1), btFabs(displacement / back) / 2);
    rows.softness[index] = 1 / (h * implicit);
    return -stiffness * (displacement + curved - share * back) / implicit;
  }

  int index_of(int axis) const { return static_cast<int>(std::count(taken, taken + axis, true)); }

  // The force acts on both bodies at the origin of frame B.
  btScalar linear_row(ConstraintRow &row, int axis, btScalar h) {
    const btVector3 direction = m_calculatedTransformA.getBasis().getColumn(axis),
                    point = m_calculatedTransformB.getOrigin();
    const btVector3 arm_a = point - m_rbA.getCenterOfMassPosition(), arm_b = point - m_rbB.getCenterOfMassPosition();
    write_vector(-direction, row.linear_a);
    write_vector(direction, row.linear_b);
    write_vector(-arm_a.cross(direction), row.angular_a);
    write_vector(arm_b.cross(direction), row.angular_b);
    const btScalar rate = direction.dot(m_rbB.getVelocityInLocalPoint(arm_b) - m_rbA.getVelocityInLocalPoint(arm_a));
    const btScalar displacement = m_calculatedLinearDiff[axis] - m_linearLimits.m_equilibriumPoint[axis];
    JointMotion motion;
    motion.finish(m_rbA.getLinearVelocity(), m_rbA.getAngularVelocity(), m_rbB.getLinearVelocity(),
                  m_rbB.getAngularVelocity(), h, &arm_a, &arm_b);
    return target_of(index_of(axis), m_linearLimits.m_springStiffness[axis], m_linearLimits.m_springDamping[axis],
                     displacement, rate, h, -h * motion.linear_target(direction));
  }

  // Bullet's angles have the opposite sign.
  btScalar angular_row(ConstraintRow &row, int axis, const std::optional<SpringRotation> &rotation, btScalar h) {
    const btVector3 direction = rotation ? rotation->gradient[axis] : getAxis(axis);
    write_vector(-direction, row.angular_a);
    write_vector(direction, row.angular_b);
    const btRotationalLimitMotor2 &motor = m_angularLimits[axis];
    const btScalar rate = direction.dot(m_rbB.getAngularVelocity() - m_rbA.getAngularVelocity());
    // Wrapped half a turn away from the rest position, where the elastic energy is continuous.
    const btScalar displacement =
        rotation ? rotation->phi[axis]
                 : std::remainder(motor.m_equilibriumPoint - m_calculatedAxisAngleDiff[axis], 2 * SIMD_PI);
    return target_of(index_of(axis + 3), motor.m_springStiffness, motor.m_springDamping, displacement, rate, h);
  }

  SoftRows &rows;
  // Which of the six axes have a spring that is a row in this sub-step.
  bool taken[6] = {};
};

// The other body of a BodyDrive: static, without shape, in no world.
std::unique_ptr<btRigidBody> nothing() {
  return std::make_unique<btRigidBody>(btRigidBody::btRigidBodyConstructionInfo(0, nullptr, nullptr));
}

// Six rows for the centre of mass of a body.
class BodyDrive : public btTypedConstraint {
 public:
  explicit BodyDrive(btRigidBody &body) : BodyDrive(body, nothing()) {}

  void getInfo1(btConstraintInfo1 *info) override {
    info->m_numConstraintRows = 6;
    info->nub = 0;
  }

  void getInfo2(btConstraintInfo2 *info) override {
    for (int i = 0; i < 6; ++i) {
      (i < 3 ? info->m_J1linearAxis : info->m_J1angularAxis)[i * info->rowskip + i % 3] = 1;
      info->m_constraintError[i * info->rowskip] = velocity[i];
    }
  }

  // These rows have no parameters.
  void setParam(int, btScalar, int) override {}
  btScalar getParam(int, int) const override { return 0; }

  btScalar velocity[6] = {};
  SoftRows rows;

 private:
  BodyDrive(btRigidBody &body, std::unique_ptr<btRigidBody> other)
      : btTypedConstraint(D6_CONSTRAINT_TYPE, body, *other), fixed(std::move(other)) {
    rows.count = 6;
    setUserConstraintPtr(&rows);
  }

  std::unique_ptr<btRigidBody> fixed;
};

template <class Driven>
AmbConstraint *own_driven(Kind kind, AmbBody &a, AmbBody &b, const double frame_a[12], const double frame_b[12]) {
  auto *owner = new AmbConstraint;
  owner->kind = kind;
  owner->constraint =
      std::make_unique<Driven>(a.body, b.body, transform_of(frame_a), transform_of(frame_b), owner->motor);
  owner->constraint->setUserConstraintPtr(&owner->motor.rows);
  return owner;
}

}  // namespace

void drop_drive(AmbWorld &world, AmbBody &body) {
  if (!body.drive) return;
  amb_body_clear_drive(&body);
  world.world->removeConstraint(body.drive.get());
  body.drive.reset();
}

extern "C" {

AmbConstraint *amb_driven_hinge_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return own_driven<DrivenHinge>(Kind::Hinge, *a, *b, frame_a, frame_b);
}

AmbConstraint *amb_driven_slider_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return own_driven<DrivenSlider>(Kind::Slider, *a, *b, frame_a, frame_b);
}

AmbConstraint *amb_implicit_spring_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return own_driven<ImplicitSpring>(Kind::SixDofSpring, *a, *b, frame_a, frame_b);
}

int amb_constraint_set_soft_motor(AmbConstraint *constraint, double velocity, double softness, double max_force) {
  if (constraint->kind == Kind::Hinge) {
    constraint->as<btHingeConstraint>().enableMotor(false);
  } else if (constraint->kind == Kind::Slider) {
    constraint->as<btSliderConstraint>().setPoweredLinMotor(false);
  } else {
    return 0;
  }
  activate_bodies(*constraint);
  SoftMotor &motor = constraint->motor;
  motor.enabled = true;
  motor.velocity = velocity;
  motor.max_force = btMin(max_force, btScalar(BT_LARGE_FLOAT));
  motor.softness = softness;
  return 1;
}

void amb_constraint_clear_soft_motor(AmbConstraint *constraint) {
  SoftMotor &motor = constraint->motor;
  if (motor.enabled) activate_bodies(*constraint);
  motor.enabled = false;
  motor.velocity = motor.max_force = motor.softness = 0;
}

int amb_constraint_set_resistance(AmbConstraint *constraint, double damping, double armature, double friction,
                                  double max_rate) {
  if (constraint->kind != Kind::Hinge && constraint->kind != Kind::Slider) return 1;
  constraint->motor.damping = damping;
  constraint->motor.armature = armature;
  constraint->motor.friction = friction;
  constraint->motor.max_rate = btMin(max_rate, btScalar(BT_LARGE_FLOAT));
  return !constraint->articulation || constraint->articulation->damping_changed(*constraint);
}

int amb_constraint_coordinate(const AmbConstraint *constraint, double out[2]) {
  if (constraint->articulation && (constraint->kind == Kind::Hinge || constraint->kind == Kind::Slider)) {
    out[0] = constraint->articulation->coordinate(*constraint, out + 1);
    if (constraint->kind == Kind::Hinge) out[0] = constraint->motor.coordinate_of(out[0]);
    return 1;
  }
  if (constraint->kind == Kind::Hinge) {
    auto &hinge = static_cast<DrivenHinge &>(*constraint->constraint);
    out[0] = constraint->motor.coordinate_of(hinge.getHingeAngle());
    out[1] = hinge.rate();
  } else if (constraint->kind == Kind::Slider) {
    auto &slider = static_cast<DrivenSlider &>(*constraint->constraint);
    const DrivenSlider::Geometry now = slider.geometry();
    out[0] = now.position;
    out[1] = slider.rate(now);
  } else {
    return 0;
  }
  return 1;
}

void amb_constraints_observe(AmbConstraint *const *constraints, const unsigned char *readings, int n, double *coordinates,
                             double *rates) {
  for (int i = 0; i < n; ++i) {
    if (!constraints[i]) continue;
    AmbConstraint &constraint = *constraints[i];
    rates[i] = 0;
    if (constraint.articulation && readings[i] != AmbReading_None) {
      const btScalar coordinate = constraint.articulation->coordinate(constraint, &rates[i]);
      const bool is_angle = readings[i] == AmbReading_HingeAngle || readings[i] == AmbReading_AxisAngle;
      coordinates[i] = is_angle ? constraint.motor.coordinate_of(coordinate) : coordinate;
    } else {
      amb_constraints_refresh(&constraints[i], 1);
      amb_constraints_read(&constraints[i], &readings[i], 1, &coordinates[i]);
      if (constraint.kind == Kind::Hinge) rates[i] = static_cast<DrivenHinge &>(*constraint.constraint).rate();
    }
  }
}

void amb_body_set_drive(AmbWorld *world, AmbBody *body, const double velocity[6], const double softness[2]) {
  if (body->body.isStaticOrKinematicObject()) return;
  if (body->articulation) {
    LinkDrive &drive = body->articulation->drive_of(*body);
    for (int i = 0; i < 6; ++i) drive.velocity[i] = velocity[i];
    for (int i = 0; i < 2; ++i) drive.softness[i] = softness[i];
    drive.enabled = true;
    return;
  }
  if (!body->drive) {
    body->drive = std::make_unique<BodyDrive>(body->body);
    world->world->addConstraint(body->drive.get());
  }
  body->body.activate();
  auto &drive = static_cast<BodyDrive &>(*body->drive);
  for (int i = 0; i < 6; ++i) {
    drive.velocity[i] = velocity[i];
    drive.rows.softness[i] = softness[i / 3];
  }
  drive.setEnabled(true);
  // A driven body is not integrated as a free body.
  body->body.addConstraintRef(&drive);
}

void amb_body_clear_drive(AmbBody *body) {
  if (body->articulation) {
    const auto &link_drive = body->articulation->members[body->member].drive;
    if (link_drive) link_drive->enabled = false;
  }
  if (!body->drive) return;
  if (body->drive->isEnabled()) body->body.activate();
  body->drive->setEnabled(false);
  body->body.removeConstraintRef(body->drive.get());
}

void amb_body_hold_velocity(AmbWorld *world, AmbBody *body, const double linear[3], const double angular[3],
                            double dt) {
  body->body.setLinearVelocity(vector_of(linear) - body->body.getGravity() * dt);
  body->body.setAngularVelocity(vector_of(angular));
  if (body->articulation) body->articulation->velocities_set = true;
  body->contact_sub_step = engine_of(*world).sub_step + 1;
  body->body.activate();
}

}  // extern "C"
