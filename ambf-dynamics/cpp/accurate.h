/* Switches of AmbSolver_Accurate; worlds with another solver ignore them. */
#ifndef AMB_ACCURATE_H
#define AMB_ACCURATE_H
#include "types.h"

typedef struct AmbAccurateSettings {
  /* 0 or 1: friction ends with the normal impulse that bounds it. Bullet keeps the last one. */
  int release_friction;
  /* 0 or 1: CFM of a joint, which Bullet takes for a share of its row's diagonal, is also in what is divided by: soft rows are
     implicit. */
  int diagonal_cfm;
  /* 0 or 1: contacts bounce at the velocity that restitution asks for, whatever the gap or depth at that moment. */
  int restitution;
  /* 0 or 1: islands are solved as mixed linear complementarity problems; else by sequential impulses only. */
  int direct;
  /* Least CFM of rows, as a share of their diagonal; redundant rows then share the load. */
  double joint_softness, contact_softness, friction_softness;
  /* Islands are hard that have joints, articulations or masses which differ by more than this factor. */
  double mass_ratio_threshold;
  /* Islands that are not hard and have more contacts than this are left to sequential impulses if a factorisation takes more multiplications a row
     than max_direct_cost_per_row. */
  int max_direct_contacts;
  double max_direct_cost_per_row;
  /* Most multiplications for the solution of an island: this many, and this many more for each of its rows. What a solution does not need is
     kept for later ones of the world, up to max_saved_budget. */
  double base_budget, budget_per_row, max_saved_budget;
} AmbAccurateSettings;

void amb_world_set_accurate(AmbWorld *world, const AmbAccurateSettings *settings);

/* What the solver did since it was asked the last time. */
typedef struct AmbSolverStatistics {
  /* Islands whose problem was solved, solved as far as the budget went, and left to sequential impulses. */
  unsigned long long islands_solved, islands_approximate, islands_iterated;
  /* Islands in which positions were corrected. */
  unsigned long long position_problems;
  unsigned long long rows, factorisations, pivots, sweeps;
  /* Largest violation of complementarity of a solution, m/s or rad/s. */
  double residual;
  /* Largest error of position along or about one axis of a joint whose row is solved here: m and rad. Joints of articulations have none. */
  double joint_gap, joint_angle;
  /* Largest penetration depth of a contact, m. */
  double penetration;
} AmbSolverStatistics;

/* Reads the statistics and begins anew. */
void amb_world_take_statistics(AmbWorld *world, AmbSolverStatistics *out);
/* Functions of the solver of mixed linear complementarity problems (AmbMlcpTable of ambf_mlcp.h); once, before the first world. */
void amb_set_mlcp(const void *table);

#endif
