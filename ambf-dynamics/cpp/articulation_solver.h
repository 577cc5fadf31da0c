// The solver of a world with articulations. C++ only.
//
// It uses Bullet's arrays of rows, their order in a sub-step, and Bullet's write-back of impulses. The velocities of
// articulations are in coordinates z in which the inertia is the identity, see src/aba/coupling.rs:
// the response to an impulse is then the row of the Jacobian. Bullet's kinematics and dynamics of articulations are not
// used.
#ifndef AMB_ARTICULATION_SOLVER_H
#define AMB_ARTICULATION_SOLVER_H

#include "../include/ambf_island.h"
#include "arena_memory.h"
#include "ledger.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraint.h>
#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

// Set once by amb_set_islands.
extern const AmbIslandTable *island_table;

struct AmbArticulation;
struct Tree;

// Base class of all constraints of this library on links.
class EngineRows : public btMultiBodyConstraint {
 public:
  using btMultiBodyConstraint::btMultiBodyConstraint;

  // Whether the row constrains a position; false: it is a motor or drive. m_rhsPenetration of such a row is its
  // position correction.
  virtual bool is_geometric(int row) const = 0;
  // Whether the row is a spring, which resists position corrections.
  virtual bool is_spring(int) const { return false; }
  // Position error of a row of an external constraint: m for the first three rows, rad for the others; 0 for other
  // kinds of rows.
  virtual btScalar error(int) const { return 0; }
  // Whether the velocity of the row is in rad/s.
  virtual bool is_angular(int row) const { return row >= 3; }
  // Velocity bias of a row that constrains a position, m/s or rad/s.
  virtual btScalar bias(int) const { return 0; }
  // Impulse of the row in the last sub-step where that is a guess of the next one, N s or N m s.
  virtual btScalar guess(int) const { return 0; }
  // Impulse of a drive that is part of the free motion, N s or N m s: the row solves for the change.
  virtual btScalar fed(int) const { return 0; }
  virtual WorkKind work_kind(int row) const = 0;

 protected:
  // Appends an unbounded row without sides, target and impulse.
  btMultiBodySolverConstraint &new_row(btMultiBodyConstraintArray &rows, int row, const btMultiBodyJacobianData &data);
};

// Velocity J v of a row after the free motion of the sub-step, m/s or rad/s, and its response J M^-1 J^T.
struct RowMotion {
  btScalar velocity = 0, response = 0;
};

// Index of the velocities z of an articulation in the arrays of the solver, where they get a place.
int velocities_of(const AmbArticulation &articulation, btMultiBodyJacobianData &data);
// Sets side 0 or 1 of a row to act on a member of an articulation, with a linear impulse at its centre of mass and an
// angular impulse.
RowMotion act_on_member(btMultiBodySolverConstraint &row, int side, AmbArticulation &articulation, int member,
                        const btVector3 &linear, const btVector3 &angular, btMultiBodyJacobianData &data);
// Sets side 0 or 1 of a row to act on a rigid body, which may be static.
RowMotion act_on_body(btMultiBodySolverConstraint &row, int side, int id, const btVector3 &linear,
                      const btVector3 &angular, const btAlignedObjectArray<btSolverBody> &bodies);

// Bullet's multi-body solver with other rows of articulations.
class ArticulationSolver : public btMultiBodyConstraintSolver {
 public:
  using Row = btMultiBodySolverConstraint;

  // One side of a row: an articulation, a rigid body, or nothing.
  struct Side {
    btMultiBody *multi_body = nullptr;
    btSolverBody *body = nullptr;
    // Articulation: number of velocity components, and indices of the first one in the arrays of m_data.
    int n = 0, jacobian = 0, velocity = 0;
    // Rigid body: Jacobian and response M^-1 J^T.
    btVector3 linear{0, 0, 0}, angular{0, 0, 0}, by_linear{0, 0, 0}, by_angular{0, 0, 0};
  };
  struct Sides {
    Row *row;
    Side sides[2];
  };

 protected:
  void convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) override;
  Sides sides_of(Row &row);
  // Adds an impulse along a row and changes the velocities of both sides.
  void apply(Row &row, btScalar impulse);
  // Sets the change of an articulation's velocity by all impulses.
  void set_change(btMultiBody &multi_body, int velocity, const double *change);

  // Separation velocity by restitution of each row of m_multiBodyNormalContactConstraints, m/s.
  Vector<btScalar> link_bounces_;

 private:
  struct LinkContact;
  void convert_link_contacts(btPersistentManifold &manifold, const btContactSolverInfo &info);
  btScalar velocity_before(const LinkContact &contact, const btVector3 &direction) const;
  Row &add_contact_row(btMultiBodyConstraintArray &rows, const LinkContact &contact, const btVector3 &linear,
                       const btVector3 &angular, RowMotion &motion);
  void add_friction_row(btMultiBodyConstraintArray &rows, const LinkContact &contact, const btVector3 &linear,
                        const btVector3 &angular, btScalar friction, btScalar guess, const btContactSolverInfo &info);
};

AmbArticulation &articulation_of(const btMultiBody &multi_body);
Tree *tree_of(const btMultiBody &multi_body);
// Kinetic energy of an articulation after the free motion of the sub-step, J.
double free_energy(const btMultiBody &multi_body);
// The first link that moves relative to the base.
AmbBody &first_link_of(const btMultiBody &multi_body);

#endif
