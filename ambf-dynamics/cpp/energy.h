/* Where the mechanical energy of a world comes from and goes. */
#ifndef AMB_ENERGY_H
#define AMB_ENERGY_H
#include "types.h"

/* All in J. Energies are those after the last sub-step; the others are sums since the ledger was switched on, positive where energy was
   gained. Soft bodies are left out; what they do to rigid bodies is in `outside`. */
typedef struct AmbEnergy {
  /* Of all dynamic bodies; potential energy of their gravity against that at the start; of springs. */
  double kinetic, potential, elastic;
  /* Velocities and poses that were set, bodies and constraints that came or went, gravity that was changed. */
  double set_states;
  /* Forces and torques that were applied to bodies. */
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
  /* Corrections of positions, and continuous collision detection, which shortens ways. */
  double corrections;
  /* Impulses after the solver's: wheels of vehicles, soft bodies. */
  double outside;
  /* Change of the three energies that none of these sums explains: numerical error. */
  double unexplained;
} AmbEnergy;

/* Switching on starts all sums at 0. Off at first; it costs one branch a sub-step then. */
void amb_world_set_energy_ledger(AmbWorld *world, int enabled);
/* All 0 while the ledger is off. */
void amb_world_energy(const AmbWorld *world, AmbEnergy *out);

#endif
