/* Settings of AmbSolver_Accurate; worlds with another solver ignore them. */
#ifndef AMB_ACCURATE_H
#define AMB_ACCURATE_H
#include "types.h"

typedef struct AmbAccurateSettings {
  /* 0 or 1: the friction impulse of a contact is set to 0 when its normal impulse becomes 0. Bullet keeps the last one.
   */
  int release_friction;
  /* 0 or 1: includes CFM in the effective mass of joint rows, 1/(d (1 + CFM)) with d = J M^-1 J^T (implicit soft
     constraint); Bullet, which takes CFM as a share of d, leaves it out. */
  int diagonal_cfm;
  /* 0 or 1: the separation velocity of a contact follows from its restitution, whatever the gap or penetration depth at
     the impact. */
  int restitution;
  /* 0 or 1: islands are solved as mixed linear complementarity problems; 0: by sequential impulses only. */
  int direct;
  /* Minimum CFM of rows as a share of their diagonal, which regularises redundant rows. */
  double joint_softness, contact_softness, friction_softness;
  /* An island is ill-conditioned if it has joints or articulations, or if its masses differ by more than this factor.
   */
  double mass_ratio_threshold;
  /* Well-conditioned islands with more contacts than max_direct_contacts are solved by sequential impulses if a
     factorisation takes more multiplications per row than max_direct_cost_per_row. */
  int max_direct_contacts;
  double max_direct_cost_per_row;
  /* Budget of the solutions of a sub-step in multiplications: base_budget for all islands, plus budget_per_row for each
     row. Unused budget is saved for later solutions in the same world, up to max_saved_budget. */
  double base_budget, budget_per_row, max_saved_budget;
} AmbAccurateSettings;

void amb_world_set_accurate(AmbWorld *world, const AmbAccurateSettings *settings);

/* Counters of the solver since they were read the last time. */
typedef struct AmbSolverStatistics {
  /* Islands that were solved to tolerance, solved approximately within the budget, and solved by sequential impulses.
   */
  unsigned long long islands_solved, islands_approximate, islands_iterated;
  /* Solved position problems. */
  unsigned long long position_problems;
  /* Sub-steps that were divided because jointed bodies turn fast. */
  unsigned long long divided_sub_steps;
  unsigned long long rows, factorisations, pivots, sweeps;
  /* Multiplications of all solutions, of velocities and of positions: what the budget counts. */
  double multiplications;
  /* Largest violation of complementarity of a solution, m/s or rad/s. */
  double residual;
  /* Largest position error along (m) or about (rad) one axis of a joint that is a constraint. Joints of articulations
     have none. */
  double joint_gap, joint_angle;
  /* Largest penetration depth of a contact, m. */
  double penetration;
} AmbSolverStatistics;

/* Reads the statistics and resets them to 0. */
void amb_world_take_statistics(AmbWorld *world, AmbSolverStatistics *out);
/* Largest angular velocity of a body on which constraints act, without those that are joints of articulations, rad/s, or
   half of what was returned for the last sub-step, if that is more. To be called once before each sub-step. */
double amb_world_jointed_turn_rate(AmbWorld *world);
/* To be called before each part of a sub-step but the first: the sub-step then has one budget, and goes on with it. Returns
   whether it is to be divided further: 0 where the parts so far have used up the budget; all that is left of the sub-step
   is then to be the last part. */
int amb_world_continue_sub_step(AmbWorld *world);
/* Counts a sub-step that is divided. */
void amb_world_count_division(AmbWorld *world);
/* Sets the functions that solve islands (AmbIslandTable of ambf_island.h). To be called once, before the first world is
   made. */
void amb_set_islands(const void *table);
/* Sets the functions of trees (TreeTable of articulation_tree.h), likewise. */
void amb_set_trees(const void *table);

#endif
