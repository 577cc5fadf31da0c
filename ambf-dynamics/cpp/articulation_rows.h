// Rows of trees in the constraint solver. C++ only.
#ifndef AMB_ARTICULATION_ROWS_H
#define AMB_ARTICULATION_ROWS_H

#include "articulation.h"

#include "articulation_solver.h"

// Limits, motors, drives and stiff springs of all joints of a tree.
//
// What motors, drives and springs did in the last sub-step is part of the tree's motion over the next one, and their rows only change it: an
// impulse would act on the tree where it was at the beginning, and without it the tree would move as if nothing held it up.
class JointRows : public EngineRows {
 public:
  explicit JointRows(AmbArticulation &articulation);

  // Finds the rows of the coming sub-step in two parts: what moves joints, which expects forces in the dynamics, and then, from
  // the motion that these give, limits.
  void plan_motors(btScalar h);
  void plan_limits(btScalar h);
  bool is_geometric(int row) const override { return planned[row].source < 0; }
  btScalar aim(int row) const override { return planned[row].target; }
  bool is_angular(int row) const override { return planned[row].is_angle; }
  WorkKind work_kind(int row) const override {
    const int source = planned[row].source;
    return source < 0 ? WorkKind::Limit : source < articulation.dynamics.coordinates ? WorkKind::Motor : WorkKind::Damping;
  }
  // Books the work of the forces that were expected, over the motion since a state; `ahead` as in ledger.h.
  void book_feedforward(EnergyLedger &ledger, const ArticulationDynamics::Position &from, const ArticulationDynamics::Rate &rate, btScalar pose_lead) const;
  bool any() const { return !planned.empty(); }
  // What was here is no guide to what will be.
  void reset();
  // Whether a limit pushed in the last sub-step.
  bool hit_limit() const;
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
    btScalar feedforward = 0;
    // Wanted pseudo-velocity that corrects the error of position.
    btScalar correction = 0;
    bool is_angle = false;
  };

  void plan_limit(int coordinate, btScalar low, btScalar high, bool is_angle, btScalar h);
  void plan_motor(const AmbConstraint &joint, int coordinate, btScalar h);
  void add_feedforward_row(Row row, btScalar h);
  void drop_large_feedforward(btScalar h);

  AmbArticulation &articulation;
  Vector<Row> planned;
  // Last force of each source of rows.
  Vector<btScalar> forces;
  btScalar step = 0;
  ArticulationDynamics::Rate acceleration;
};

// A fixed or point-to-point constraint one end of which is a link of a tree.
class ExternalConstraintRows : public EngineRows {
 public:
  ExternalConstraintRows(AmbConstraint &constraint, AmbBody &link, const btTransform &frame, AmbBody &other,
          const btTransform &other_frame, int rows);

  void finalizeMultiDof() override {}
  int getIslandIdA() const override { return link.collider->getIslandTag(); }
  int getIslandIdB() const override { return other.collider->getIslandTag(); }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}
  void reset();
  bool is_geometric(int) const override { return true; }
  btScalar error(int row) const override { return errors[row]; }
  btScalar aim(int row) const override { return aims[row]; }
  WorkKind work_kind(int) const override { return WorkKind::Joint; }
  // After the solver's pass over a sub-step of h.
  void write_feedback(btScalar h);

 private:
  AmbConstraint &constraint;
  AmbBody &link, &other;
  btTransform frame, other_frame;
  btScalar errors[6] = {}, aims[6] = {};
};

// Six rows that drive a link, as those that drive a body do, see drive.h.
class LinkDrive : public EngineRows {
 public:
  explicit LinkDrive(AmbBody &link);

  bool is_geometric(int) const override { return false; }
  WorkKind work_kind(int) const override { return WorkKind::BodyDrive; }

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

#endif
