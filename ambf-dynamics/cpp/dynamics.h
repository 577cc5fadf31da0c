/* C interface of the engine. Its functions are for worlds that were made with `amb_dynamics_engine`, and objects in
   them. */
#ifndef AMB_DYNAMICS_H
#define AMB_DYNAMICS_H
#include "accurate.h"
#include "exact_joints.h"
#include "continuous.h"
#include "couple.h"
#include "drive.h"
#include "energy.h"
#include "flight.h"
#include "articulate.h"
#include "rays.h"
#include "types.h"

/* The engine for `amb_world_new`: a single object of static lifetime that any thread may use. */
const AmbEngine *amb_dynamics_engine(void);

#endif
