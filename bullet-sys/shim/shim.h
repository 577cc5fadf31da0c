#ifndef AMB_SHIM_H
#define AMB_SHIM_H
#include "arena.h"
#include "body.h"
#include "constraint.h"
#include "ghost.h"
#include "query.h"
#include "sleeping.h"
#include "settings.h"
#include "shape.h"
#include "soft_body.h"
#include "types.h"
#include "vehicle.h"
#include "volume.h"
#include "world.h"
#endif
