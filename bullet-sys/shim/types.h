/* Opaque objects of the shim. Every `pose` is 12 doubles: origin (3), then the rotation matrix row by row (9); m. */
#ifndef AMB_TYPES_H
#define AMB_TYPES_H

typedef struct AmbWorld AmbWorld;
typedef struct AmbShape AmbShape;
typedef struct AmbBody AmbBody;
typedef struct AmbConstraint AmbConstraint;
typedef struct AmbGhost AmbGhost;
typedef struct AmbVehicle AmbVehicle;
typedef struct AmbSoft AmbSoft;
typedef struct AmbTree AmbTree;
typedef struct AmbEngine AmbEngine;

/* Names an object towards the caller: given with the object, handed back by queries. */
typedef unsigned long long AmbHandle;

/* sizeof(btScalar) that the shim and, through the size of a transform, the library were built with. */
int amb_scalar_size(void);

#endif
