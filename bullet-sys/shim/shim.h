#ifndef AMB_SHIM_H
#define AMB_SHIM_H
#include "body.h"
#include "constraint.h"
#include "shape.h"
#include "types.h"
#include "world.h"
#endif
