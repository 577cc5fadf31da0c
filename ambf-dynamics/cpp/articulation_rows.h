// Constraint rows of articulations. C++ only.
#ifndef AMB_ARTICULATION_ROWS_H
#define AMB_ARTICULATION_ROWS_H

#include "articulation.h"

#include "articulation_solver.h"

// Limits, motors, stiff springs and dampers, dry friction and largest rates of all joints of an articulation: those that its tree has
// planned, see src/aba/rows.rs.
class JointRows : public EngineRows {
 public:
  explicit JointRows(AmbArticulation &articulation);

  // Gives the tree the rows of limits of joints of several coordinates.
  void give_wide_limits(btScalar h);
  // Those of the last solution.
  const btScalar *impulses() const { return &m_data[0]; }
  bool is_geometric(int row) const override { return planned(row).source == Tree::LIMIT; }
  bool is_spring(int row) const override {
    return planned(row).source >= articulation.tree->coordinates && planned(row).source < friction_of(0);
  }
  btScalar bias(int row) const override { return planned(row).target; }
  btScalar guess(int row) const override { return planned(row).guess; }
  btScalar fed(int row) const override { return planned(row).feedforward; }
  bool is_angular(int row) const override { return planned(row).is_angle; }
  WorkKind work_kind(int row) const override {
    const int source = planned(row).source, coordinates = articulation.tree->coordinates;
    return source < 0                                                  ? WorkKind::Limit
           : source < coordinates || source >= friction_of(coordinates) ? WorkKind::Motor
                                                                        : WorkKind::Damping;
  }

  void finalizeMultiDof() override {}
  int getIslandIdA() const override;
  int getIslandIdB() const override { return -1; }
  void createConstraintRows(btMultiBodyConstraintArray &rows, btMultiBodyJacobianData &data,
                            const btContactSolverInfo &info) override;
  void debugDraw(btIDebugDraw *) override {}

 private:
  const Tree::Row &planned(int row) const { return articulation.tree->row[row]; }
  // Source of the friction on a coordinate: those of friction follow those of springs, and those of rotors follow these.
  int friction_of(int coordinate) const {
    return articulation.tree->coordinates + static_cast<int>(articulation.springs.size()) + coordinate;
  }
  void give_limits_of(AmbConstraint &joint, int member, btScalar h);

  AmbArticulation &articulation;
};

// External constraint on a link: a fixed or point-to-point constraint between a link and a body that is not in its
// articulation.
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
  btScalar bias(int row) const override { return biases[row]; }
  btScalar guess(int row) const override { return guesses[row]; }
  WorkKind work_kind(int) const override { return WorkKind::Joint; }
  // Writes the reaction wrenches after the solution of a sub-step of h s.
  void write_feedback(btScalar h);

 private:
  AmbConstraint &constraint;
  AmbBody &link, &other;
  btTransform frame, other_frame;
  btScalar errors[6] = {}, biases[6] = {}, guesses[6] = {};
};

// Six rows that drive a link, as BodyDrive drives a rigid body; see drive.h.
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
  // Softness of the linear (1/kg) and of the angular rows (1/(kg m^2)).
  btScalar softness[2] = {};

 private:
  AmbBody &link;
};

#endif
