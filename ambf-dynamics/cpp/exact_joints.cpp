#include <BulletDynamics/ConstraintSolver/btFixedConstraint.h>

#include "exact_rows.h"

namespace {

template <class Joint, class... Arguments>
AmbConstraint *make_owner(Kind kind, AmbBody &a, AmbBody &b, Arguments... arguments) {
  auto *owner = new AmbConstraint;
  owner->kind = kind;
  owner->constraint = std::make_unique<WithExactRows<Joint>>(a.body, b.body, arguments...);
  return owner;
}

}  // namespace

extern "C" {

AmbConstraint *amb_exact_fixed_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner<btFixedConstraint>(Kind::Fixed, *a, *b, transform_of(frame_a), transform_of(frame_b));
}

AmbConstraint *amb_exact_point_to_point_new(AmbBody *a, AmbBody *b, const double frame_a[12],
                                            const double frame_b[12]) {
  return make_owner<btPoint2PointConstraint>(Kind::PointToPoint, *a, *b, transform_of(frame_a).getOrigin(),
                                             transform_of(frame_b).getOrigin());
}

AmbConstraint *amb_exact_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner<btConeTwistConstraint>(Kind::ConeTwist, *a, *b, transform_of(frame_a), transform_of(frame_b));
}

AmbConstraint *amb_exact_six_dof_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner<btGeneric6DofConstraint>(Kind::SixDof, *a, *b, transform_of(frame_a), transform_of(frame_b), true);
}

int amb_constraint_omit_rows(AmbConstraint *owner, const AmbOmittedRows *rows) {
  auto *omitted = dynamic_cast<OmittedRows *>(owner->constraint.get());
  if (!omitted) return 0;
  // Where these rows note that they are beyond their clearance.
  if (!soft_rows_of(*owner->constraint)) owner->constraint->setUserConstraintPtr(&owner->motor.rows);
  omitted->frames[0] = transform_of(rows->frame_a);
  omitted->frames[1] = transform_of(rows->frame_b);
  const double *axes = rows->axes;
  omitted->axes = btMatrix3x3(axes[0], axes[3], axes[6], axes[1], axes[4], axes[7], axes[2], axes[5], axes[8]);
  omitted->side = rows->side == 0 ? 0 : 1;
  omitted->linear_clearance = rows->linear_clearance;
  omitted->angular_clearance = rows->angular_clearance;
  omitted->is_any = false;
  for (int axis = 0; axis < 3; ++axis) {
    omitted->linear[axis] = rows->linear[axis] != 0;
    omitted->angular[axis] = rows->angular[axis] != 0;
    omitted->is_any = omitted->is_any || omitted->linear[axis] || omitted->angular[axis];
  }
  return 1;
}

}  // extern "C"
