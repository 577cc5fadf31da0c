// Settings and statistics of AmbSolver_Accurate in one world. C++ only.
#ifndef AMB_ACCURATE_CONTEXT_H
#define AMB_ACCURATE_CONTEXT_H

#include "../include/ambf_island.h"
#include "internal.h"

extern "C" {
#include "accurate.h"
}

struct AccurateContext : AmbAccurateSettings {
  AccurateContext() : AmbAccurateSettings{} {}

  // Free bodies are integrated exactly under constant force, not by Bullet's semi-implicit Euler method.
  bool exact_flight = false;
  mutable AmbSolverStatistics statistics{};
  mutable AmbBudgets budgets{};
  // Whether a part of a sub-step follows that is not its first one.
  bool is_continued = false;
  // See amb_world_jointed_turn_rate.
  double recent_turn_rate = 0;
};

#endif
