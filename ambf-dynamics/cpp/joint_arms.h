// Pivots of Bullet's joint classes relative to the centres of mass of their bodies. C++ only.
#ifndef AMB_JOINT_ARMS_H
#define AMB_JOINT_ARMS_H

#include <BulletDynamics/ConstraintSolver/btConeTwistConstraint.h>
#include <BulletDynamics/ConstraintSolver/btGeneric6DofConstraint.h>
#include <BulletDynamics/ConstraintSolver/btGeneric6DofSpring2Constraint.h>
#include <BulletDynamics/ConstraintSolver/btHingeConstraint.h>
#include <BulletDynamics/ConstraintSolver/btPoint2PointConstraint.h>
#include <BulletDynamics/ConstraintSolver/btSliderConstraint.h>

// Arms of a joint in which body B can slide relative to A: both lead to the pivot of B.
inline bool sliding_arms(const btTypedConstraint &constraint, const btTransform &frame_b, btVector3 &arm_a,
                         btVector3 &arm_b) {
  const btTransform &a = constraint.getRigidBodyA().getCenterOfMassTransform();
  const btTransform &b = constraint.getRigidBodyB().getCenterOfMassTransform();
  arm_b = b.getBasis() * frame_b.getOrigin();
  arm_a = b.getOrigin() + arm_b - a.getOrigin();
  return true;
}

// Writes the arms from the centres of mass to the pivot of a joint, m, world axes. Returns false for classes without a
// pivot.
inline bool find_joint_arms(const btTypedConstraint &constraint, btVector3 &arm_a, btVector3 &arm_b) {
  const auto arms = [&](const btVector3 &in_a, const btVector3 &in_b) {
    arm_a = constraint.getRigidBodyA().getCenterOfMassTransform().getBasis() * in_a;
    arm_b = constraint.getRigidBodyB().getCenterOfMassTransform().getBasis() * in_b;
    return true;
  };
  switch (constraint.getConstraintType()) {
    case HINGE_CONSTRAINT_TYPE: {
      auto &hinge = const_cast<btHingeConstraint &>(static_cast<const btHingeConstraint &>(constraint));
      return arms(hinge.getAFrame().getOrigin(), hinge.getBFrame().getOrigin());
    }
    case POINT2POINT_CONSTRAINT_TYPE: {
      const auto &point = static_cast<const btPoint2PointConstraint &>(constraint);
      return arms(point.getPivotInA(), point.getPivotInB());
    }
    case CONETWIST_CONSTRAINT_TYPE: {
      const auto &cone = static_cast<const btConeTwistConstraint &>(constraint);
      return arms(cone.getAFrame().getOrigin(), cone.getBFrame().getOrigin());
    }
    // If B can slide relative to A, the pivot of B is used for both bodies.
    case SLIDER_CONSTRAINT_TYPE:
      return sliding_arms(constraint, static_cast<const btSliderConstraint &>(constraint).getFrameOffsetB(), arm_a,
                          arm_b);
    case D6_CONSTRAINT_TYPE:
      // BodyDrive has this type too, and no pivot.
      if (const auto *joint = dynamic_cast<const btGeneric6DofConstraint *>(&constraint)) {
        return sliding_arms(constraint, joint->getFrameOffsetB(), arm_a, arm_b);
      }
      return false;
    case D6_SPRING_2_CONSTRAINT_TYPE:
      return sliding_arms(constraint, static_cast<const btGeneric6DofSpring2Constraint &>(constraint).getFrameOffsetB(),
                          arm_a, arm_b);
    default: return false;
  }
}

#endif
