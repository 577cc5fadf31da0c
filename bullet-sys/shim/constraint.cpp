#include "internal.h"

namespace {

// A spring that exerts its full force. By default Bullet 3 targets the velocity that the force would cause, from which
// the solver is far after few iterations when the pivot is off the centre of mass; Bullet 2 exerted the force.
struct ForceSpring : btGeneric6DofSpring2Constraint {
  ForceSpring(btRigidBody &a, btRigidBody &b, const btTransform &frame_a, const btTransform &frame_b)
      : btGeneric6DofSpring2Constraint(a, b, frame_a, frame_b, RO_XYZ) {
    m_flags |= BT_6DOF_FLAGS_USE_INFINITE_ERROR;
  }
};

AmbConstraint *make_owner(Kind kind, btTypedConstraint *constraint) {
  auto *owner = new AmbConstraint;
  owner->kind = kind;
  owner->constraint.reset(constraint);
  return owner;
}

// Distance of frame B's origin along frame A's z axis.
btScalar axis_distance(const btTransform &a, const btTransform &b) {
  return (b.getOrigin() - a.getOrigin()).dot(a.getBasis().getColumn(2));
}

// Angle of frame B about frame A's z axis, positive as for a hinge.
btScalar axis_angle(const btTransform &a, const btTransform &b) {
  const btVector3 y = b.getBasis().getColumn(1);
  return -btAtan2(y.dot(a.getBasis().getColumn(0)), y.dot(a.getBasis().getColumn(1)));
}

btScalar read(AmbConstraint &c, unsigned char reading) {
  const AmbWorld *world = body_of(&c.constraint->getRigidBodyA())->world;
  btScalar coordinate;
  if (reading != AmbReading_None && world && world->extension && world->extension->read_coordinate(c, coordinate)) {
    const bool is_angle = reading == AmbReading_HingeAngle || reading == AmbReading_AxisAngle;
    return is_angle ? c.motor.coordinate_of(coordinate) : coordinate;
  }
  switch (reading) {
    case AmbReading_HingeAngle: return c.motor.coordinate_of(c.as<btHingeConstraint>().getHingeAngle());
    case AmbReading_SliderPosition: return c.as<btSliderConstraint>().getLinearPos();
    case AmbReading_AxisDistance:
    case AmbReading_AxisAngle: return axis_reading(c, reading == AmbReading_AxisAngle);
    default: return 0;
  }
}

}  // namespace

btScalar axis_reading(AmbConstraint &c, bool is_angle) {
  auto &spring = c.as<btGeneric6DofSpring2Constraint>();
  const btTransform a = spring.getRigidBodyA().getCenterOfMassTransform() * spring.getFrameOffsetA();
  const btTransform b = spring.getRigidBodyB().getCenterOfMassTransform() * spring.getFrameOffsetB();
  return is_angle ? axis_angle(a, b) : axis_distance(a, b);
}

extern "C" {

AmbConstraint *amb_hinge_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner(Kind::Hinge,
                    new btHingeConstraint(a->body, b->body, transform_of(frame_a), transform_of(frame_b), true));
}

void amb_hinge_set_limit(AmbConstraint *hinge, double low, double high) {
  hinge->as<btHingeConstraint>().setLimit(low, high);
  hinge->motor.low = low;
  hinge->motor.high = high;
  activate_bodies(*hinge);
}

void amb_hinge_set_motor(AmbConstraint *hinge, int enabled, double velocity, double max_impulse) {
  auto &h = hinge->as<btHingeConstraint>();
  if (enabled || h.getEnableAngularMotor()) activate_bodies(*hinge);
  h.enableAngularMotor(enabled != 0, velocity, max_impulse);
}

AmbConstraint *amb_slider_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner(Kind::Slider,
                    new btSliderConstraint(a->body, b->body, transform_of(frame_a), transform_of(frame_b), true));
}

void amb_slider_set_limit(AmbConstraint *slider, double low, double high) {
  auto &s = slider->as<btSliderConstraint>();
  s.setLowerLinLimit(low);
  s.setUpperLinLimit(high);
  slider->motor.low = low;
  slider->motor.high = high;
  activate_bodies(*slider);
}

void amb_slider_lock_rotation(AmbConstraint *slider) {
  auto &s = slider->as<btSliderConstraint>();
  s.setLowerAngLimit(0);
  s.setUpperAngLimit(0);
}

void amb_slider_set_motor(AmbConstraint *slider, int enabled, double velocity, double max_force) {
  auto &s = slider->as<btSliderConstraint>();
  if (enabled || s.getPoweredLinMotor()) activate_bodies(*slider);
  s.setPoweredLinMotor(enabled != 0);
  s.setTargetLinMotorVelocity(velocity);
  s.setMaxLinMotorForce(max_force);
}

AmbConstraint *amb_fixed_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner(Kind::Fixed, new btFixedConstraint(a->body, b->body, transform_of(frame_a), transform_of(frame_b)));
}

AmbConstraint *amb_point_to_point_new(AmbBody *a, AmbBody *b, const double pivot_a[3], const double pivot_b[3]) {
  return make_owner(Kind::PointToPoint,
                    new btPoint2PointConstraint(a->body, b->body, vector_of(pivot_a), vector_of(pivot_b)));
}

AmbConstraint *amb_grip_new(AmbBody *body, const double pivot[3], const double goal[3], double max_impulse) {
  // Both bodies of a constraint must have an AmbBody, so Bullet's own fixed body cannot be used; the anchor is in no
  // world. All anchors share one shape. It is static memory: an allocation would be in the arena of the world that
  // happens to be entered.
  static btEmptyShape empty;
  alignas(AmbShape) static unsigned char place[sizeof(AmbShape)];
  static AmbShape *const nothing = [] {
    auto *shape = new (place) AmbShape;
    shape->shape.reset(&empty, [](btCollisionShape *) {});
    return shape;
  }();
  auto anchor = std::make_unique<AmbBody>(0, btVector3(0, 0, 0), nothing, btTransform::getIdentity());
  auto *point = new btPoint2PointConstraint(body->body, anchor->body, vector_of(pivot), vector_of(goal));
  point->m_setting.m_impulseClamp = max_impulse;
  point->m_setting.m_tau = max_impulse;
  AmbConstraint *grip = make_owner(Kind::PointToPoint, point);
  grip->anchor = std::move(anchor);
  return grip;
}

void amb_grip_set_goal(AmbConstraint *grip, const double goal[3]) {
  grip->as<btPoint2PointConstraint>().setPivotB(vector_of(goal));
  activate_bodies(*grip);
}

AmbConstraint *amb_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner(Kind::ConeTwist,
                    new btConeTwistConstraint(a->body, b->body, transform_of(frame_a), transform_of(frame_b)));
}

void amb_cone_twist_set_limit(AmbConstraint *cone, double swing1, double swing2, double twist) {
  cone->as<btConeTwistConstraint>().setLimit(swing1, swing2, twist);
}

AmbConstraint *amb_six_dof_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner(Kind::SixDof,
                    new btGeneric6DofConstraint(a->body, b->body, transform_of(frame_a), transform_of(frame_b), true));
}

void amb_six_dof_set_limit(AmbConstraint *six_dof, int axis, double low, double high) {
  six_dof->as<btGeneric6DofConstraint>().setLimit(axis, low, high);
}

AmbConstraint *amb_six_dof_spring_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner(Kind::SixDofSpring,
                    new ForceSpring(a->body, b->body, transform_of(frame_a), transform_of(frame_b)));
}

void amb_six_dof_spring_set_limit(AmbConstraint *spring, int axis, double low, double high) {
  spring->as<btGeneric6DofSpring2Constraint>().setLimit(axis, low, high);
}

void amb_six_dof_spring_set_spring(AmbConstraint *spring, int axis, int enabled, double stiffness, double damping) {
  auto &s = spring->as<btGeneric6DofSpring2Constraint>();
  s.enableSpring(axis, enabled != 0);
  s.setStiffness(axis, stiffness);
  s.setDamping(axis, damping);
}

void amb_six_dof_spring_set_equilibrium(AmbConstraint *spring, int axis, double equilibrium) {
  spring->as<btGeneric6DofSpring2Constraint>().setEquilibriumPoint(axis, equilibrium);
}

void amb_constraint_free(AmbConstraint *constraint) { delete constraint; }

void amb_constraint_set_param(AmbConstraint *constraint, int kind, double value, int axis) {
  constraint->constraint->setParam(kind, value, axis);
}

void amb_constraint_enable_feedback(AmbConstraint *constraint) {
  constraint->feedback = std::make_unique<btJointFeedback>();
  const btVector3 zero(0, 0, 0);
  *constraint->feedback = {zero, zero, zero, zero};
  constraint->constraint->setJointFeedback(constraint->feedback.get());
}

void amb_constraint_feedback(const AmbConstraint *constraint, double out[12]) {
  if (!constraint->feedback) {
    for (int i = 0; i < 12; ++i) out[i] = 0;
    return;
  }
  const btJointFeedback &feedback = *constraint->feedback;
  write_vector(feedback.m_appliedForceBodyA, out);
  write_vector(feedback.m_appliedTorqueBodyA, out + 3);
  write_vector(feedback.m_appliedForceBodyB, out + 6);
  write_vector(feedback.m_appliedTorqueBodyB, out + 9);
}

void amb_constraints_recover(AmbConstraint *const *constraints, int n) {
  const btVector3 zero(0, 0, 0);
  for (int i = 0; i < n; ++i) {
    if (!constraints[i]) continue;
    AmbConstraint &owner = *constraints[i];
    owner.constraint->setEnabled(true);
    owner.constraint->internalSetAppliedImpulse(0);
    owner.motor.rows.forget();
    if (owner.feedback) *owner.feedback = {zero, zero, zero, zero};
  }
}

void amb_constraints_refresh(AmbConstraint *const *constraints, int n) {
  for (int i = 0; i < n; ++i) {
    if (!constraints[i] || constraints[i]->kind != Kind::Slider) continue;
    auto &slider = constraints[i]->as<btSliderConstraint>();
    slider.calculateTransforms(slider.getRigidBodyA().getCenterOfMassTransform(),
                               slider.getRigidBodyB().getCenterOfMassTransform());
    slider.testLinLimits();
  }
}

void amb_constraints_read(AmbConstraint *const *constraints, const unsigned char *readings, int n, double *out) {
  for (int i = 0; i < n; ++i) {
    if (constraints[i]) out[i] = read(*constraints[i], readings[i]);
  }
}

}  // extern "C"
