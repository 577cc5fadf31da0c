// The solver of a world with trees. C++ only.
#ifndef AMB_TIE_SOLVER_H
#define AMB_TIE_SOLVER_H

#include "arena_memory.h"

#include <BulletDynamics/Featherstone/btMultiBodyConstraintSolver.h>

// Bullet's, which only iterates: on the six rows of a tie between bodies of unlike mass and reach that leaves so much of the gap that the
// two fly apart. Here ties and the joint rows of the trees they hold are solved together and exactly before all else, which then only
// adds what contacts change.
class TieSolver : public btMultiBodyConstraintSolver {
 public:
  using Row = btMultiBodySolverConstraint;

  // What a row acts on: a tree or a free body.
  struct Side {
    btMultiBody *tree = nullptr;
    btSolverBody *body = nullptr;
    // Of the tree: dimensions, and where its part of the arrays of m_data begins.
    int n = 0, jacobian = 0, velocity = 0;
    // Of the body.
    btVector3 linear{0, 0, 0}, angular{0, 0, 0}, by_linear{0, 0, 0}, by_angular{0, 0, 0};

    bool shares(const Side &other) const { return tree ? tree == other.tree : body && body == other.body; }
  };
  struct Sides {
    Row *row;
    Side sides[2];
  };

 protected:
  void convertContacts(btPersistentManifold **manifolds, int n, const btContactSolverInfo &info) override;

  Sides sides_of(Row &row);
  void apply(const Sides &row, btScalar impulse);

 private:
  bool are_coupled(const Sides &a, const Sides &b) const;
  btScalar coupling(const Sides &of, const Sides &by) const;
  btScalar velocity(const Sides &row) const;
  void solve(const Vector<Sides> &group);

  Vector<Sides> all, group;
  Vector<btScalar> matrix, right, low, high, impulses;
};

#endif
