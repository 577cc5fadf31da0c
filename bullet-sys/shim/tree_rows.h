// Rows of trees in the constraint solver. C++ only.
#ifndef AMB_TREE_ROWS_H
#define AMB_TREE_ROWS_H

#include "tree.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraint.h>

// Limits, motors, drives and stiff springs of all joints of a tree. They are solved together and exactly; the solver's iterations, which start from
// that, only add what contacts change.
class JointRows : public btMultiBodyConstraint {
 public:
  explicit JointRows(AmbTree &tree);

  // Finds the rows of the coming sub-step. Whether there are any.
  bool plan(btScalar h);
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
    bool limit;
    // Of the tree's, or -1.
    int spring = -1;
  };

  void plan_limit(int coordinate, btScalar low, btScalar high, bool is_angle, btScalar h);
  void plan_motor(const AmbConstraint &joint, int coordinate, btScalar h);

  AmbTree &tree;
  std::vector<Row> planned;
  std::vector<btScalar> jacobian, matrix, right, impulses;
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
