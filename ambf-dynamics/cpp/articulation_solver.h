// The solver of a world with articulations. C++ only.
//
// It uses Bullet's rows, their order in a sub-step and what Bullet makes of their impulses afterwards. Velocities of articulations are given in
// other coordinates than Bullet's, in which the inertia is the identity (ArticulationDynamics::factor_inertia): the response to an impulse is then the row of the
// Jacobian, and nothing of Bullet's kinematics and dynamics of articulations is used.
#ifndef AMB_ARTICULATION_SOLVER_H
#define AMB_ARTICULATION_SOLVER_H

#include "../include/ambf_mlcp.h"
#include "arena_memory.h"
#include "ledger.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraint.h>
#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

// Set once by amb_set_mlcp.
extern const AmbMlcpTable *mlcp_table;

struct AmbArticulation;

// What all constraints of this library on links have in common.
class EngineRows : public btMultiBodyConstraint {
 public:
  using btMultiBodyConstraint::btMultiBodyConstraint;

  // Whether the row holds a position, in contrast to one that drives a velocity. Its m_rhsPenetration is then the correction.
  virtual bool is_geometric(int row) const = 0;
  // Error of position of a row of a tie, m for the first three and rad for the others; rows of other kinds have none.
  virtual btScalar error(int) const { return 0; }
  // Whether its velocity is one in rad/s.
  virtual bool is_angular(int row) const { return row >= 3; }
  // Velocity that a row which holds a position asks for beside rest, m/s or rad/s.
  virtual btScalar aim(int) const { return 0; }
  virtual WorkKind work_kind(int row) const = 0;

 protected:
  // A row that acts on nothing yet, between no bounds, from rest.
  btMultiBodySolverConstraint &new_row(btMultiBodyConstraintArray &rows, int row, const btMultiBodyJacobianData &data);
};

// Velocity along a row that the free motion of the sub-step gives, m/s or rad/s, and the square of the change of it by a unit impulse.
struct RowMotion {
  btScalar velocity = 0, response = 0;
};

// Makes side 0 or 1 of a row push a member of an articulation with an impulse at its centre of mass and an angular one.
RowMotion act_on_member(btMultiBodySolverConstraint &row, int side, AmbArticulation &articulation, int member, const btVector3 &linear, const btVector3 &angular,
                      btMultiBodyJacobianData &data);
// Makes side 0 of a row push a coordinate of an articulation.
RowMotion act_on_coordinate(btMultiBodySolverConstraint &row, AmbArticulation &articulation, int coordinate, btMultiBodyJacobianData &data);
// The same of a rigid body, which may be one that impulses do not move.
RowMotion act_on_body(btMultiBodySolverConstraint &row, int side, int id, const btVector3 &linear, const btVector3 &angular,
                    const btAlignedObjectArray<btSolverBody> &bodies);

// Bullet's, and what the rows that it makes act on.
class ArticulationSolver : public btMultiBodyConstraintSolver {
 public:
  using Row = btMultiBodySolverConstraint;

  // What a row acts on: an articulation or a free body.
  struct Side {
    btMultiBody *multi_body = nullptr;
    btSolverBody *body = nullptr;
    // Of the articulation: dimensions, and where its part of the arrays of m_data begins.
    int n = 0, jacobian = 0, velocity = 0;
    // Of the body.
    btVector3 linear{0, 0, 0}, angular{0, 0, 0}, by_linear{0, 0, 0}, by_angular{0, 0, 0};
  };
  struct Sides {
    Row *row;
    Side sides[2];
  };

 protected:
  void convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) override;
  Sides sides_of(Row &row);
  // Adds an impulse of a row to the velocities of what it acts on.
  void apply(Row &row, btScalar impulse);
  // Sets the change of an articulation's velocity by all impulses.
  void set_change(btMultiBody &multi_body, int velocity, const double *change);

 private:
  struct LinkContact;
  void convert_link_contacts(btPersistentManifold &manifold, const btContactSolverInfo &info);
  Row &add_contact_row(btMultiBodyConstraintArray &rows, const LinkContact &contact, const btVector3 &linear, const btVector3 &angular,
                       RowMotion &motion);
  void add_friction_row(btMultiBodyConstraintArray &rows, const LinkContact &contact, const btVector3 &linear, const btVector3 &angular,
                        btScalar friction, btScalar guess, const btContactSolverInfo &info);
};

// Keeps a correction for the sub-step, in the coordinates of the rows.
void correct(btMultiBody &multi_body, const double *velocities);
// Kinetic energy of an articulation after the free motion of the sub-step, J.
double free_energy(const btMultiBody &multi_body);

#endif
