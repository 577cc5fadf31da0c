// Direct solver of the mixed linear complementarity problem of one island. C++ only, knows nothing of Bullet.
#ifndef AMB_DIRECT_H
#define AMB_DIRECT_H

#include <cstddef>
#include <limits>
#include "arena_memory.h"

// One scalar constraint between two bodies: jacobian v + cfm x = target with low <= x <= high, where x is an impulse and v the
// change of the bodies' velocities. What yields little may ask for a large target; where it would be reached, it is `most`.
struct DirectRow {
  enum State : unsigned char { Free, Low, High };

  // What the row acts on.
  struct Side {
    // Numbered from 0; -1: one that no impulse moves.
    int body = -1;
    // Linear and angular part of the Jacobian, and what a unit impulse adds to the velocity (inverse mass times Jacobian).
    double jacobian[6], response[6];
    // In their stead, where the body is a tree: as long as its velocity.
    const double *tree_jacobian = nullptr, *tree_response = nullptr;
    int size = 6;
  };

  Side sides[2];
  double target = 0, most = std::numeric_limits<double>::infinity();
  double cfm = 0;
  double low = 0, high = 0;
  // Row of the normal impulse that bounds this one by friction x normal impulse, at most cap; -1: bounds are fixed.
  int normal = -1;
  double friction = 0, cap = 0;
  // In: the guess; out: the solution.
  State state = Free;
  double x = 0;
};

// Block principal pivoting (Judice and Pires 1994) over a Cholesky factorisation of the rows between their bounds, stored by
// envelope: a chain of any length costs time linear in its length. Friction bounds follow the normal impulses. Where pivoting
// cycles, few rows are solved within fixed bounds, which then follow, and many by projected Gauss-Seidel with subspace minimisation.
class DirectSolver {
 public:
  Vector<DirectRow> rows;

  // Orders the rows so that those that share bodies are close, and returns the multiplications that a factorisation would take. Bodies
  // from `rigid` on are trees, with velocities of these sizes.
  double prepare(int rigid, const Vector<int> &tree_sizes);
  // Solves what was prepared by block pivoting of at most max_rounds factorisations, and, where that cycles, by slower methods of at
  // most ten times as many. False: neither gave a solution.
  bool solve(int max_rounds);
  // Velocity that the solution adds to a body, linear and angular part.
  const double *velocity(int body) const { return &velocities[velocity_start[static_cast<size_t>(body)]]; }
  // Factorisations of the last solve.
  int rounds() const { return rounds_; }

 private:
  void assemble();
  bool solve_targets(int max_rounds);
  bool lower_targets();
  void factor();
  void solve_free();
  void settle();
  void accumulate();
  bool pivot(int max_rounds);
  void take_free();
  bool exchange();
  bool descend();
  bool stagger();
  void restore_guess();
  double sweep();
  bool polish(int max_rounds);
  double energy() const;
  void bound_friction(DirectRow &row) const;
  double bound_frictions();
  int flip(bool single);
  double diagonal(int row) const;
  double along(const DirectRow &row) const;
  void push(const DirectRow &row, double impulse);

  int rounds_ = 0;
  // Where the velocity of each body begins, and the end of the last.
  Vector<size_t> velocity_start;
  // Factorisations that are left to the slow methods, and multiplications of one.
  int budget = 0;
  double work = 0;
  // Largest error of a velocity that counts as none.
  double tolerance = 0;
  // Rows by place; their envelope starts at place first[i], and its entries lie at matrix[start[i] + place - first[i]].
  Vector<int> order, first, place;
  Vector<size_t> start;
  Vector<double> matrix;
  // The same for the rows between their bounds.
  Vector<int> free_rows, free_first;
  Vector<size_t> free_start;
  Vector<double> factors, inverse_diagonal, unknowns;
  Vector<double> velocities, guess, saved;
  Vector<int> body_place, neighbours, neighbour_start, queue, body_first;
};

#endif
