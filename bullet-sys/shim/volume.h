/* Volumes that collide: concave shapes whose triangles come brick by brick from the caller, on demand. */
#ifndef AMB_VOLUME_H
#define AMB_VOLUME_H
#include "types.h"

/* The surface at a brick. vertices: (vertex_count x 3), m, in the shape's frame. triangles: (triangle_count x 3) vertices; the
   first `own` are those of the brick, the others those that share a vertex with them. Valid until the next call. */
typedef struct {
  const double *vertices;
  const unsigned *triangles;
  int vertex_count, triangle_count, own;
} AmbBrickMesh;

/* Where triangles come from. Called by the thread that steps the world or casts rays in it; must not call the shim. */
typedef struct {
  /* Bricks along x, y and z. */
  int bricks[3];
  /* Lower corner of the box of all bricks, edges of a brick and of a voxel, m. Triangles of a brick are within a voxel of it. */
  double low[3], brick[3], voxel[3];
  /* Of the box in which the surface is; may be smaller than that of the bricks, m. */
  double bounds[6];
  void *data;
  /* Finds the first brick with a surface, in the order x, y, z, from `brick` on, of those from `low` to `high`, both included.
     Returns 0 if there is none, else writes it to `brick`. */
  int (*next)(void *data, const int low[3], const int high[3], int brick[3]);
  void (*mesh)(void *data, const int brick[3], AmbBrickMesh *out);
  /* Frees `data`. */
  void (*release)(void *data);
} AmbVolumeSource;

/* A shape without margin, of no mass. The source's `release` is called when it is freed. */
AmbShape *amb_shape_volume(const AmbVolumeSource *source);
/* The triangles at a brick, and those at its neighbours, have changed. */
void amb_shape_volume_changed(AmbShape *volume, const int brick[3]);
/* Makes `part` a part of `shape`, which becomes a compound if it is none. Takes ownership of `part`. A body that has the shape
   collides with it from amb_body_shape_changed on. */
void amb_shape_add_part(AmbShape *shape, AmbShape *part, const double pose[12]);
/* To be called after the shape of a body in a world was given a part. The body must be no link. */
void amb_body_shape_changed(AmbBody *body);
/* Whether a body is a link of an articulation. */
int amb_body_is_link(const AmbBody *body);
/* Wakes what overlaps the bounding box of a body. */
void amb_body_wake_neighbours(AmbBody *body);

#endif
