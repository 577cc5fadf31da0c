#include "tree_rows.h"

namespace {

// The row in which a drive is written, of those that the solver asks a constraint for.
struct Row {
  Row(btTypedConstraint::btConstraintInfo2 &all, int index)
      : linear_a(all.m_J1linearAxis + index * all.rowskip),
        angular_a(all.m_J1angularAxis + index * all.rowskip),
        linear_b(all.m_J2linearAxis + index * all.rowskip),
        angular_b(all.m_J2angularAxis + index * all.rowskip),
        target(all.m_constraintError[index * all.rowskip]),
        lower(all.m_lowerLimit[index * all.rowskip]),
        upper(all.m_upperLimit[index * all.rowskip]) {}

  void drive(const JointDrive &joint) {
    target = joint.velocity;
    lower = -joint.max_impulse;
    upper = joint.max_impulse;
  }

  btScalar *linear_a, *angular_a, *linear_b, *angular_b;
  btScalar &target, &lower, &upper;
};

// The row of a drive is the last one, after those of Bullet.
void add_row(JointDrive &drive, btTypedConstraint::btConstraintInfo1 &info) {
  drive.rows.count = drive.enabled ? 1 : 0;
  if (!drive.enabled) return;
  drive.rows.first = info.m_numConstraintRows++;
  --info.nub;
}

// A motor that pushes against the limit it has reached only tears at it, and one that goes on would pass it before Bullet sees it.
void respect_limits(Row &row, const JointDrive &drive, btScalar at, btScalar per_second) {
  if (drive.low > drive.high) return;
  if (at <= drive.low) row.lower = 0;
  if (at >= drive.high) row.upper = 0;
  if (drive.rows.softness[0] > 0) return;
  // Backwards it is for Bullet's own rows to bring the joint.
  if (row.target < 0) row.target = btMax(row.target, btMin((drive.low - at) * per_second, btScalar(0)));
  if (row.target > 0) row.target = btMin(row.target, btMax((drive.high - at) * per_second, btScalar(0)));
}

struct DrivenHinge : btHingeConstraint {
  DrivenHinge(btRigidBody &a, btRigidBody &b, const btTransform &frame_a, const btTransform &frame_b, JointDrive &row)
      : btHingeConstraint(a, b, frame_a, frame_b, true), drive(row) {}

  void getInfo1(btConstraintInfo1 *info) override {
    btHingeConstraint::getInfo1(info);
    add_row(drive, *info);
  }

  void getInfo2(btConstraintInfo2 *info) override {
    btHingeConstraint::getInfo2(info);
    if (drive.rows.count == 0) return;
    Row row(*info, drive.rows.first);
    const btVector3 axis = (m_rbA.getCenterOfMassTransform() * getAFrame()).getBasis().getColumn(2);
    write_vector(-axis, row.angular_a);
    write_vector(axis, row.angular_b);
    row.drive(drive);
    respect_limits(row, drive, getHingeAngle(), info->fps);
  }

  btScalar rate() {
    const btVector3 axis = (m_rbA.getCenterOfMassTransform() * getAFrame()).getBasis().getColumn(2);
    return axis.dot(m_rbB.getAngularVelocity() - m_rbA.getAngularVelocity());
  }

  JointDrive &drive;
};

// The coordinate of a slider is a . (p_B - p_A), with the axis a and the point p_A fixed in A, p_B in B. Its rate is
// a . (v_B + w_B x r_B - v_A - w_A x (p_B - x_A)): the force that belongs to it acts on both bodies at p_B.
struct DrivenSlider : btSliderConstraint {
  DrivenSlider(btRigidBody &a, btRigidBody &b, const btTransform &frame_a, const btTransform &frame_b, JointDrive &row)
      : btSliderConstraint(a, b, frame_a, frame_b, true), drive(row) {}

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
    btSliderConstraint::getInfo1(info);
    add_row(drive, *info);
  }

  void getInfo2(btConstraintInfo2 *info) override {
    btSliderConstraint::getInfo2(info);
    if (drive.rows.count == 0) return;
    Row row(*info, drive.rows.first);
    const Geometry now = geometry();
    write_vector(-now.axis, row.linear_a);
    write_vector(now.axis, row.linear_b);
    write_vector(-now.arm_a.cross(now.axis), row.angular_a);
    write_vector(now.arm_b.cross(now.axis), row.angular_b);
    row.drive(drive);
    respect_limits(row, drive, now.position, info->fps);
  }

  btScalar rate(const Geometry &now) {
    return now.axis.dot(m_rbB.getVelocityInLocalPoint(now.arm_b) - m_rbA.getVelocityInLocalPoint(now.arm_a));
  }

  JointDrive &drive;
};

// What drives of bodies push against: no mass, no shape, in no world.
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

  // Nothing about these rows can be set from outside.
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

}  // namespace

std::unique_ptr<btTypedConstraint> driven_hinge(AmbBody &a, AmbBody &b, const btTransform &frame_a,
                                                const btTransform &frame_b, JointDrive &drive) {
  return std::make_unique<DrivenHinge>(a.body, b.body, frame_a, frame_b, drive);
}

std::unique_ptr<btTypedConstraint> driven_slider(AmbBody &a, AmbBody &b, const btTransform &frame_a,
                                                 const btTransform &frame_b, JointDrive &drive) {
  return std::make_unique<DrivenSlider>(a.body, b.body, frame_a, frame_b, drive);
}

void drop_drive(AmbWorld &world, AmbBody &body) {
  if (!body.drive) return;
  amb_body_release(&body);
  world.world->removeConstraint(body.drive.get());
  body.drive.reset();
}

extern "C" {

int amb_constraint_set_drive(AmbConstraint *constraint, double velocity, double softness, double max_impulse) {
  if (constraint->kind == Kind::Hinge) {
    constraint->as<btHingeConstraint>().enableMotor(false);
  } else if (constraint->kind == Kind::Slider) {
    constraint->as<btSliderConstraint>().setPoweredLinMotor(false);
  } else {
    return 0;
  }
  wake(*constraint);
  JointDrive &drive = constraint->drive;
  drive.enabled = true;
  drive.velocity = velocity;
  drive.max_impulse = btMin(max_impulse, btScalar(BT_LARGE_FLOAT));
  drive.rows.softness[0] = softness;
  return 1;
}

void amb_constraint_release(AmbConstraint *constraint) {
  if (constraint->drive.enabled) wake(*constraint);
  constraint->drive.enabled = false;
}

int amb_constraint_coordinate(const AmbConstraint *constraint, double out[2]) {
  if (constraint->tree && (constraint->kind == Kind::Hinge || constraint->kind == Kind::Slider)) {
    out[0] = constraint->tree->coordinate(*constraint, out + 1);
    if (constraint->kind == Kind::Hinge) out[0] = std::remainder(out[0], 2 * SIMD_PI);
    return 1;
  }
  if (constraint->kind == Kind::Hinge) {
    auto &hinge = static_cast<DrivenHinge &>(*constraint->constraint);
    out[0] = hinge.getHingeAngle();
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

void amb_body_set_drive(AmbWorld *world, AmbBody *body, const double velocity[6], const double softness[2]) {
  if (body->body.isStaticOrKinematicObject()) return;
  if (body->tree) {
    LinkDrive &drive = body->tree->drive_of(*body);
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
  // A body that is held is not in free flight.
  body->body.addConstraintRef(&drive);
}

void amb_body_release(AmbBody *body) {
  if (body->tree && body->tree->members[body->member].drive) body->tree->members[body->member].drive->enabled = false;
  if (!body->drive) return;
  if (body->drive->isEnabled()) body->body.activate();
  body->drive->setEnabled(false);
  body->body.removeConstraintRef(body->drive.get());
}

void amb_body_hold_velocity(AmbWorld *world, AmbBody *body, const double linear[3], const double angular[3], double dt) {
  body->body.setLinearVelocity(vector_of(linear) - body->body.getGravity() * dt);
  body->body.setAngularVelocity(vector_of(angular));
  if (body->tree) body->tree->velocities_set = true;
  body->touched = world->sub_step + 1;
  body->body.activate();
}

}  // extern "C"
