/* Solution of an island of constraints: C interface of ambf-dynamics, src/island/ffi.rs, where all of it is described. SI
 * units.
 *
 * The C++ code that calls it is linked before the Rust library, and therefore uses a table of function pointers. Order of
 * calls: reserve; rows are written to the space; solve. */
#ifndef AMBF_ISLAND_H
#define AMBF_ISLAND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct AmbIsland AmbIsland;

/* What a row is of: a joint of rigid bodies; a coupling of such joints; a joint or drive of an articulation, or one that
 * acts on it; a contact; friction of a contact. */
enum {
  AMB_ROW_JOINT = 0,
  AMB_ROW_COUPLING = 1,
  AMB_ROW_ARTICULATED_JOINT = 2,
  AMB_ROW_CONTACT = 3,
  AMB_ROW_FRICTION = 4
};

/* Row without its sides: `Row` in src/island/row.rs. What a kind of rows does not have is 0. */
typedef struct AmbIslandRow {
  uint8_t kind;
  bool is_articulated, is_angular, is_geometric, is_spring, is_limit, is_open, is_known, was_open;
  uint32_t joint;
  int32_t normal;
  double effective_mass, link_masses[2];
  double target, bias, cfm, low, high, fed, guess, warm_start, correction, gap;
  double response, position_response, turn_squared, arm;
  double friction, cap;
} AmbIslandRow;

typedef struct AmbIslandSide {
  int body, size;
  const double *jacobian, *response;
} AmbIslandSide;

typedef struct AmbIslandSpace {
  AmbIslandRow *rows;
  /* Two a row. */
  AmbIslandSide (*sides)[2];
  double *numbers;
} AmbIslandSpace;

/* Budgets in multiplications: src/island/budget.rs. */
typedef struct AmbBudgetLimits {
  double base, per_row, saved;
} AmbBudgetLimits;

typedef struct AmbBudgets {
  double shared, part, largest, work;
  uint32_t parts;
} AmbBudgets;

/* `Problem` in src/island/solve.rs. */
typedef struct AmbIslandProblem {
  double time_step;
  uint32_t sub_step, rigid, composites;
  double turn_rate, heaviest, kinetic_energy;
  double joint_softness, contact_softness, friction_softness;
  double most_cost;
  AmbBudgetLimits limits;
} AmbIslandProblem;

/* What an island remembers from one sub-step to the next: `Memory` in src/island/yielding.rs. */
typedef struct AmbIslandMemory {
  double drive_yielding;
  uint32_t drives_yielded_in_vain;
  double guess_tolerance;
} AmbIslandMemory;

/* The bodies after the rigid ones: those that consist of coupled ones, then articulations (`Tree` of
 * cpp/articulation_tree.h). */
typedef struct AmbIslandBodies {
  const int *sizes;
  int count, articulations;
  void *const *trees;
} AmbIslandBodies;

enum {
  AMB_ISLAND_SOLVED = 0,
  AMB_ISLAND_APPROXIMATE = 1,
  AMB_ISLAND_REFUSED = 2,
  AMB_ISLAND_AT_REST = 3,
  AMB_ISLAND_EXPENSIVE = 4
};

typedef struct AmbIslandCounters {
  uint32_t rows, factorisations, pivots, sweeps, position_problems;
  double multiplications, residual, depth;
} AmbIslandCounters;

/* Active set: the impulse is between its bounds, at the lower or at the upper one. */
enum { AMB_STATE_FREE = 0, AMB_STATE_LOW = 1, AMB_STATE_HIGH = 2 };

typedef struct AmbIslandSolution {
  int outcome;
  double correction;
  AmbIslandCounters counters;
  const double *impulses;
  const uint8_t *states;
  const double *velocities, *corrections;
} AmbIslandSolution;

typedef struct AmbIslandTable {
  /* Of AmbIslandRow, AmbIslandSide, AmbIslandProblem, AmbBudgets, AmbIslandSolution. */
  size_t sizes[5];
  AmbIsland *(*create)(void);
  void (*destroy)(AmbIsland *island);
  AmbIslandSpace (*reserve)(AmbIsland *island, size_t rows, size_t numbers);
  void (*solve)(AmbIsland *island, size_t rows, const AmbIslandProblem *problem, const AmbIslandBodies *bodies,
                AmbIslandMemory *memory, AmbBudgets *budgets, AmbIslandSolution *out);
  void (*begin)(AmbBudgets *budgets, const AmbBudgetLimits *limits, bool is_continued);
  bool (*may_divide)(const AmbBudgets *budgets);
} AmbIslandTable;

#ifdef __cplusplus
}
#endif

#endif
