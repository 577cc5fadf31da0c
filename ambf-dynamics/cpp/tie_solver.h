// The solver of a world with articulations. C++ only.
#ifndef AMB_TIE_SOLVER_H
#define AMB_TIE_SOLVER_H

#include "../include/ambf_mlcp.h"
#include "arena_memory.h"
#include "ledger.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraint.h>
#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

// Set once by amb_set_mlcp.
extern const AmbMlcpTable *mlcp_table;

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
};

// Bullet's, and what the rows that it makes act on.
class TieSolver : public btMultiBodyConstraintSolver {
 public:
  using Row = btMultiBodySolverConstraint;

  // What a row acts on: an articulation or a free body.
  struct Side {
    btMultiBody *tree = nullptr;
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
  Sides sides_of(Row &row);
  void apply(const Sides &row, btScalar impulse);
};

// Keeps a correction for the sub-step: velocities of the base and rates of the coordinates, as long as the articulation's velocity.
void correct(btMultiBody &multi_body, const double *velocities);
// Kinetic energy of an articulation after the free motion of the sub-step, J.
double free_energy(const btMultiBody &multi_body);

#endif
