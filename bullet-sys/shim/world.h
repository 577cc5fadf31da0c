/* The dynamics world. The caller keeps ownership of objects that are added, and must remove them before they are freed.
 */
#ifndef AMB_WORLD_H
#define AMB_WORLD_H
#include "arena.h"
#include "types.h"

enum AmbSolver {
  AmbSolver_SequentialImpulse = 0,
  AmbSolver_Nncg = 1,
  AmbSolver_Dantzig = 2,
  AmbSolver_ProjectedGaussSeidel = 3,
  AmbSolver_Lemke = 4,
  /* Sequential impulses with warm-started friction, as in Bullet 2. */
  AmbSolver_WarmFriction = 5,
  /* The engine's direct solver; without an engine, sequential impulses. */
  AmbSolver_Accurate = 6
};

enum AmbWorldKind {
  AmbWorldKind_Rigid = 0,
  /* Soft bodies may be added. Rigid bodies move as in a rigid world, bit for bit. */
  AmbWorldKind_Soft = 1,
  /* The engine's world, in which constraints can be articulated; without an engine, a rigid world. */
  AmbWorldKind_Articulated = 2
};

/* solver: enum AmbSolver; kind: enum AmbWorldKind. manifolds: contact manifolds for which memory is taken at once, 1.7 kB
   each; further ones are allocated one by one; without meaning in an arena. arena: used by this world only, or null. A caller that gives one
   must enter it before each of the functions below, which may all allocate, and whenever an object is made for the
   world; shapes, which do not change, are made outside. engine: replaces parts of Bullet's step, see extension.h; of
   static lifetime; null: none. */
AmbWorld *amb_world_new(int solver, int kind, int manifolds, AmbArena *arena, const AmbEngine *engine);
/* Restores the state of the world when the copy of its arena was made. The bodies, soft bodies, ghosts and vehicles in
   the world must be the same as then; constraints and articulations made since do not exist afterwards, and those
   removed since exist again. */
void amb_world_restore(AmbWorld *world, AmbArena *arena, const unsigned char *copy, unsigned long size);
void amb_world_free(AmbWorld *world);
/* m/s^2. Sets it on every dynamic body and all soft bodies in the world too. */
void amb_world_set_gravity(AmbWorld *world, const double gravity[3]);
void amb_world_set_iterations(AmbWorld *world, int iterations);

/* Whether motion states lag up to a sub-step behind (Bullet's default) or are as recent as the last sub-step. */
void amb_world_set_lag(AmbWorld *world, int enabled);

void amb_world_add_body(AmbWorld *world, AmbBody *body, AmbHandle handle);
/* Also removes anchors of soft bodies on the body, and the contacts and cached distance fields that soft bodies have of
   it. */
void amb_world_remove_body(AmbWorld *world, AmbBody *body);
/* Makes a body visual-only: static, at rest, without collisions, ignored by ray casts. */
void amb_world_make_visual_only(AmbWorld *world, AmbBody *body);
void amb_world_add_constraint(AmbWorld *world, AmbConstraint *constraint, int disable_collisions);
void amb_world_remove_constraint(AmbWorld *world, AmbConstraint *constraint);
/* The two bodies never collide from now on. The test takes constant time. */
void amb_world_ignore_pair(AmbWorld *world, AmbBody *a, AmbBody *b);

/* Advances by `interval` s in at most max_sub_steps sub-steps of `sub_step` s. Returns the number of sub-steps that
   were due; those above max_sub_steps are lost. */
int amb_world_step(AmbWorld *world, double interval, int max_sub_steps, double sub_step);
/* The same as three functions: begin returns the number of sub-steps due; then advance is called for each of them, at
   most max_sub_steps times, and then finish. advance may divide a sub-step of `sub_step` s: it is then called for parts
   of `length` s; impulses of contacts are always those of a whole sub-step. */
int amb_world_begin_step(AmbWorld *world, double interval, int max_sub_steps, double sub_step);
void amb_world_advance(AmbWorld *world, double length, double sub_step);
void amb_world_finish_step(AmbWorld *world);
/* Discards contacts, warm-starting impulses, the time that is left of the last step and all else that is remembered of the
   motion, and reactivates bodies that Bullet disabled because their state was not finite. Poses and velocities must have
   been set to finite values before. */
void amb_world_recover(AmbWorld *world);
/* Number of pairs of objects whose bounding boxes overlap, without those that are apart for good. */
int amb_world_pair_count(const AmbWorld *world);
/* Number of contact points of rigid bodies after the last sub-step, including those of positive distance. */
int amb_world_contact_count(const AmbWorld *world);

#endif
