// What the solver of AmbSolver_Accurate knows of its world. C++ only.
#ifndef AMB_ACCURATE_CONTEXT_H
#define AMB_ACCURATE_CONTEXT_H

#include "internal.h"

extern "C" {
#include "accurate.h"
}

struct AccurateContext : AmbAccurateSettings {
  AccurateContext() : AmbAccurateSettings{} {}

  // Free bodies fly exactly, not by Bullet's semi-implicit Euler.
  bool exact_flight = false;
  mutable AmbSolverStatistics statistics{};
};

#endif
