/* Balance of the mechanical energy of a world. */
#ifndef AMB_ENERGY_H
#define AMB_ENERGY_H
#include "types.h"

/* All in J. The first three are energies after the last sub-step; the others are works since the ledger was enabled,
   positive where the world gained energy. Soft bodies are not included; the work of their impulses on rigid bodies is
   in `outside`. */
typedef struct AmbEnergy {
  /* Kinetic energy of all dynamic bodies; their potential energy in gravity relative to that at the start; elastic
     energy of springs. */
  double kinetic, potential, elastic;
  /* Changes of energy by setting velocities, poses or gravity, and by adding or removing bodies and constraints. */
  double set_states;
  /* Applied forces and torques. */
  double wrenches;
  /* Motors and drives of joints. */
  double motors;
  /* Drives of bodies. */
  double body_drives;
  /* Damping of bodies and springs. */
  double damping;
  /* Rows that hold joints, and limits of joints. */
  double joints, limits;
  /* Normal impulses of contacts, and friction. */
  double contacts, friction;
  /* Position corrections, and continuous collision detection, which shortens displacements. */
  double corrections;
  /* Impulses outside of the solver: wheels of vehicles, soft bodies. */
  double outside;
  /* Change of the three energies minus all works above: numerical error. */
  double unexplained;
} AmbEnergy;

/* Enabling resets all works to 0. Default: disabled, which costs one branch per sub-step. */
void amb_world_set_energy_ledger(AmbWorld *world, int enabled);
/* All 0 while the ledger is disabled. */
void amb_world_energy(const AmbWorld *world, AmbEnergy *out);

#endif
