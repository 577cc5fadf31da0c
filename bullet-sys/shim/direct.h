// Direct solver of the mixed linear complementarity problem of one island. C++ only, knows nothing of Bullet.
#ifndef AMB_DIRECT_H
#define AMB_DIRECT_H

#include <cstddef>
#include "arena_memory.h"

// One scalar constraint between two bodies: jacobian v + cfm x = target with low <= x <= high, where x is an impulse and v the
// change of the bodies' velocities.
struct DirectRow {
  enum State : unsigned char { Free, Low, High };

  // Bodies, numbered from 0; -1: one that no impulse moves.
  int body_a = -1, body_b = -1;
  // Linear and angular part of the Jacobian, and what a unit impulse adds to the velocity (inverse mass times Jacobian).
  double jacobian_a[6], jacobian_b[6];
  double response_a[6], response_b[6];
  double target = 0;
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
// cycles, projected Gauss-Seidel with subspace minimisation takes over, which never does.
class DirectSolver {
 public:
  Vector<DirectRow> rows;

  // Orders the rows so that those that share bodies are close, and returns the multiplications that a factorisation would take.
  double prepare(int body_count);
  // Solves what was prepared by block pivoting of at most max_rounds factorisations, and, where that cycles, by as many rounds of the
  // slower method. False: neither gave a solution.
  bool solve(int max_rounds);
  // Velocity that the solution adds to a body, linear and angular part.
  const double *velocity(int body) const { return &velocities[6 * static_cast<size_t>(body)]; }
  // Factorisations of the last solve.
  int rounds() const { return rounds_; }

 private:
  void assemble();
  void factor();
  void solve_free();
  void settle();
  void accumulate();
  bool pivot(int max_rounds);
  double sweep();
  bool polish(int max_rounds);
  double energy() const;
  void bound_friction(DirectRow &row) const;
  double bound_frictions();
  int flip(bool single);
  double diagonal(int row) const;
  double along(const DirectRow &row) const;
  void push(const DirectRow &row, double impulse);

  int bodies = 0, rounds_ = 0;
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
