#include <BulletDynamics/ConstraintSolver/btFixedConstraint.h>

#include "exact_rows.h"

namespace {

template <class Joint, class... More>
AmbConstraint *make_owner(Kind kind, AmbBody &a, AmbBody &b, const double frame_a[12], const double frame_b[12],
                          More... more) {
  auto *owner = new AmbConstraint;
  owner->kind = kind;
  owner->constraint = std::make_unique<WithExactRows<Joint>>(a.body, b.body, transform_of(frame_a),
                                                             transform_of(frame_b), more...);
  return owner;
}

}  // namespace

extern "C" {

AmbConstraint *amb_exact_fixed_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner<btFixedConstraint>(Kind::Fixed, *a, *b, frame_a, frame_b);
}

AmbConstraint *amb_exact_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner<btConeTwistConstraint>(Kind::ConeTwist, *a, *b, frame_a, frame_b);
}

AmbConstraint *amb_exact_six_dof_new(AmbBody *a, AmbBody *b, const double frame_a[12], const double frame_b[12]) {
  return make_owner<btGeneric6DofConstraint>(Kind::SixDof, *a, *b, frame_a, frame_b, true);
}

}  // extern "C"
