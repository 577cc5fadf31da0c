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
typedef struct AmbArticulation AmbArticulation;
typedef struct AmbEngine AmbEngine;

/* The caller's name of an object: given when the object is added to a world, returned by queries. */
typedef unsigned long long AmbHandle;

/* sizeof(btScalar) of the headers that the shim was compiled with. */
int amb_scalar_size(void);

#endif
