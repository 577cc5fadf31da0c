/* Collision shapes. Each function returns a new shape that the caller owns; lengths in m. */
#ifndef AMB_SHAPE_H
#define AMB_SHAPE_H
#include "types.h"

AmbShape *amb_shape_empty(void);
AmbShape *amb_shape_box(const double half_extents[3], double margin);
AmbShape *amb_shape_sphere(double radius, double margin);
/* axis: 0 x, 1 y, 2 z. */
AmbShape *amb_shape_cylinder(int axis, double radius, double half_height, double margin);
/* height: between the centres of the caps. */
AmbShape *amb_shape_capsule(int axis, double radius, double height, double margin);
AmbShape *amb_shape_cone(int axis, double radius, double height, double margin);
AmbShape *amb_shape_plane(const double normal[3], double offset, double margin);
/* vertices: (n x 3), copied. */
AmbShape *amb_shape_convex_hull(const double *vertices, int n, double margin);
/* The same as a part of a decomposition: the pairs that it makes with parts of other bodies are found with less work,
   see hull_pairs.h. */
AmbShape *amb_shape_convex_part(const double *vertices, int n, double margin);
/* vertices (n x 3) and triangles (m x 3), copied; every index is below n. */
AmbShape *amb_shape_convex_triangle_mesh(const double *vertices, int n, const unsigned *triangles, int m,
                                         double margin);
AmbShape *amb_shape_gimpact(const double *vertices, int n, const unsigned *triangles, int m, double margin);
AmbShape *amb_shape_compound(void);
/* Takes ownership of child. */
void amb_shape_compound_add(AmbShape *compound, AmbShape *child, const double pose[12]);
/* Takes ownership of `shape`. Returns the child of a compound with one child at the identity pose, else `shape` itself.
   The AABB of a convex hull without twins is computed again with the margin that was set after its construction. */
AmbShape *amb_shape_simplify(AmbShape *shape);
void amb_shape_free(AmbShape *shape);
/* A shape that collides as `shape` does, bit for bit, for another world, which another thread may step at the same time.
   Points, triangles and their tree are shared and kept until the last twin is freed. Several threads may make twins of one
   shape at a time, if it belongs to no world. */
AmbShape *amb_shape_twin(const AmbShape *shape);

/* Bullet's estimate of the principal moments for a mass in kg; kg m^2. Zero for shapes that have none. */
void amb_shape_inertia(const AmbShape *shape, double mass, double inertia[3]);
/* Axis-aligned bounding box in the shape's own frame: minimum, then maximum. */
void amb_shape_aabb(const AmbShape *shape, double bounds[6]);

#endif
