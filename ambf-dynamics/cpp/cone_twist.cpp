#include <BulletDynamics/ConstraintSolver/btConeTwistConstraint.h>

#include "engine.h"

namespace {

// The rotation between the bodies is a swing, which takes the x axis of one joint frame to that of the other on the
// shortest way, after a twist about x. The rate of the twist is w . (x_A + x_B) / (1 + x_A . x_B), with the relative
// angular velocity w. Bullet's row of the twist limit acts along x_B: while the swing moves around its cone, such a row
// lets the twist pass its limit, and the correction along x_B moves the swing on, which lifts what hangs on the joint.
class ExactConeTwist : public btConeTwistConstraint {
 public:
  using btConeTwistConstraint::btConeTwistConstraint;

  void getInfo1(btConstraintInfo1 *info) override {
    btConeTwistConstraint::getInfo1(info);
    rows = info->m_numConstraintRows;
  }

  void getInfo2(btConstraintInfo2 *info) override {
    btConeTwistConstraint::getInfo2(info);
    if (!getSolveTwistLimit() || rows == 0 || !is_accurate(m_rbA, m_rbB)) return;
    const btVector3 x_a = (m_rbA.getCenterOfMassTransform() * getAFrame()).getBasis().getColumn(0);
    const btVector3 x_b = (m_rbB.getCenterOfMassTransform() * getBFrame()).getBasis().getColumn(0);
    const btScalar whole = 1 + x_a.dot(x_b);
    // Near a swing of half a turn the twist is not defined.
    constexpr btScalar LEAST = btScalar(1e-2);
    if (whole < LEAST) return;
    // The row of the twist is the last one.
    btScalar *const a = info->m_J1angularAxis + (rows - 1) * info->rowskip;
    btScalar *const b = info->m_J2angularAxis + (rows - 1) * info->rowskip;
    const btScalar along_x_b = a[0] * x_b.x() + a[1] * x_b.y() + a[2] * x_b.z();
    const btVector3 gradient = (x_a + x_b) * (along_x_b / whole);
    for (int k = 0; k < 3; ++k) {
      a[k] = gradient[k];
      b[k] = -gradient[k];
    }
  }

 private:
  int rows = 0;
};

}  // namespace

extern "C" AmbConstraint *amb_exact_cone_twist_new(AmbBody *a, AmbBody *b, const double frame_a[12],
                                                   const double frame_b[12]) {
  auto *owner = new AmbConstraint;
  owner->kind = Kind::ConeTwist;
  owner->constraint = std::make_unique<ExactConeTwist>(a->body, b->body, transform_of(frame_a), transform_of(frame_b));
  return owner;
}
