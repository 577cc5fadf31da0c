// Settings and statistics of AmbSolver_Accurate in one world. C++ only.
#ifndef AMB_ACCURATE_CONTEXT_H
#define AMB_ACCURATE_CONTEXT_H

#include "internal.h"

extern "C" {
#include "accurate.h"
}

struct AccurateContext : AmbAccurateSettings {
  AccurateContext() : AmbAccurateSettings{} {}

  // Free bodies are integrated exactly under constant force, not by Bullet's semi-implicit Euler method.
  bool exact_flight = false;
  mutable AmbSolverStatistics statistics{};
  // See amb_world_jointed_turn_rate.
  double recent_turn_rate = 0;
};

#endif
