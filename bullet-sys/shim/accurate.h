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
  /* 0 or 1: islands are solved directly where that is cheap. */
  int direct;
  /* Least softness of rows that are solved directly, as a share of their diagonal; redundant rows then share the load. */
  double joint_softness, contact_softness, friction_softness;
  /* Islands are hard that have joints or masses which differ by more than this factor. */
  double hard_mass_ratio;
  /* Most multiplications of a factorisation, a row, of other islands and of hard ones that are solved directly. */
  double max_cost, max_hard_cost;
  /* Most factorisations of block pivoting, and again of the method that follows where it cycles. */
  int max_rounds;
} AmbAccurateSettings;

void amb_world_set_accurate(AmbWorld *world, const AmbAccurateSettings *settings);

#endif
