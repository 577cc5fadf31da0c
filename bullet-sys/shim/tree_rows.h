// Rows of trees in the constraint solver. C++ only.
#ifndef AMB_TREE_ROWS_H
#define AMB_TREE_ROWS_H

#include "tree.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraint.h>

// Limits, motors, drives and stiff springs of all joints of a tree. They are solved together and exactly; the solver's iterations, which start from
// that, only add what contacts change.
//
// What motors, drives and springs did in the last sub-step is part of the tree's motion over the next one, and their rows only change it: an
// impulse would act on the tree where it was at the beginning, and without it the tree would move as if nothing held it up.
class JointRows : public btMultiBodyConstraint {
 public:
  explicit JointRows(AmbTree &tree);

  // Finds the rows of the coming sub-step in two parts: what moves joints, which expects forces in the dynamics, and then, from
  // the motion that these give, limits.
  void plan_motors(btScalar h);
  void plan_limits(btScalar h);
  bool any() const { return !planned.empty(); }
  // What was here is no guide to what will be.
  void forget();
  // Whether a limit pushed in the last sub-step.
  bool stopped() const;
  // Of a spring that was left out of the dynamics.
  btScalar spring_impulse(size_t spring) const;

  void finalizeMultiDof() override {}
  int getIslandIdA() const override;
  int getIslandIdB() const override { return -1; }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}

 private:
  struct Row {
    int coordinate;
    btScalar target;    // rate
    btScalar softness;  // rate given up per impulse
    btScalar low, high;  // of the impulse
    // Coordinate of a motor, or the number of coordinates and a spring; -1: a limit.
    int source = -1;
    // Impulse that is part of the motion already.
    btScalar expected = 0;
  };

  void plan_limit(int coordinate, btScalar low, btScalar high, bool is_angle, btScalar h);
  void plan_motor(const AmbConstraint &joint, int coordinate, btScalar h);
  void expect(Row row, btScalar h);

  AmbTree &tree;
  Vector<Row> planned;
  // Last force of each source of rows.
  Vector<btScalar> forces;
  btScalar step = 0;
  Vector<btScalar> jacobian, matrix, right, impulses;
};

// A fixed or point-to-point constraint one end of which is a link of a tree.
class TieRows : public btMultiBodyConstraint {
 public:
  TieRows(AmbConstraint &constraint, AmbBody &link, const btTransform &frame, AmbBody &other,
          const btTransform &other_frame, int rows);

  void finalizeMultiDof() override {}
  int getIslandIdA() const override { return link.collider->getIslandTag(); }
  int getIslandIdB() const override { return other.collider->getIslandTag(); }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}
  void forget();
  // After the solver's pass over a sub-step of h.
  void write_feedback(btScalar h);

 private:
  AmbConstraint &constraint;
  AmbBody &link, &other;
  btTransform frame, other_frame;
};

// Six rows that drive a link, as those that drive a body do, see drive.h.
class LinkDrive : public btMultiBodyConstraint {
 public:
  explicit LinkDrive(AmbBody &link);

  void finalizeMultiDof() override {}
  int getIslandIdA() const override { return link.collider->getIslandTag(); }
  int getIslandIdB() const override { return -1; }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}

  bool enabled = false;
  btScalar velocity[6] = {};
  // Of the linear and of the angular rows.
  btScalar softness[2] = {};

 private:
  AmbBody &link;
};

// Minimises x^T A x / 2 - b^T x within low <= x <= high for a symmetric positive definite n x n matrix.
void solve_within_bounds(int n, const btScalar *matrix, const btScalar *b, const btScalar *low, const btScalar *high,
                         btScalar *x);

#endif
