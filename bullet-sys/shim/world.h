/* The dynamics world. Objects added to it stay the caller's and must be removed before they are freed. */
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
  /* Sequential impulses that start friction from the impulses of the step before, as Bullet 2 did. */
  AmbSolver_WarmFriction = 5,
  /* The engine's own; without an engine, sequential impulses. */
  AmbSolver_Accurate = 6
};

enum AmbWorldKind {
  AmbWorldKind_Rigid = 0,
  /* Soft bodies may be added. Rigid bodies move as in a rigid world, bit for bit. */
  AmbWorldKind_Soft = 1,
  /* The engine's own, whose constraints may be made articulations; without an engine, rigid. */
  AmbWorldKind_Trees = 2
};

/* The arena is that of this world alone, or null. Who has given one enters it before each of the functions below, which may all allocate, and
   whenever something is made for the world; shapes don't change and stay out.
   engine: what replaces parts of Bullet's step, see extension.h, of static lifetime; null: nothing does. */
AmbWorld *amb_world_new(int solver, int kind, AmbArena *arena, const AmbEngine *engine);
/* Back to what it was when the copy of its arena was made. The same bodies, soft bodies, ghosts and vehicles must be in the world as then;
   constraints and trees made since are gone, and those removed are back. */
void amb_world_restore(AmbWorld *world, AmbArena *arena, const unsigned char *copy, unsigned long size);
void amb_world_free(AmbWorld *world);
/* Also sets it on every dynamic body and all soft bodies in the world. */
void amb_world_set_gravity(AmbWorld *world, const double gravity[3]);
void amb_world_set_iterations(AmbWorld *world, int iterations);

/* Whether motion states lag up to a sub-step behind (Bullet's default) or are as recent as the last sub-step. */
void amb_world_set_lag(AmbWorld *world, int enabled);

void amb_world_add_body(AmbWorld *world, AmbBody *body, AmbHandle handle);
/* Also drops the anchors of soft bodies on it and what soft bodies remember of it. */
void amb_world_remove_body(AmbWorld *world, AmbBody *body);
/* Makes a picture of a body: no mass, at rest, touched by nothing and seen by no ray. */
void amb_world_make_drawing(AmbWorld *world, AmbBody *body);
void amb_world_add_constraint(AmbWorld *world, AmbConstraint *constraint, int disable_collisions);
void amb_world_remove_constraint(AmbWorld *world, AmbConstraint *constraint);
/* The two bodies never collide from now on; found in constant time. */
void amb_world_ignore_pair(AmbWorld *world, AmbBody *a, AmbBody *b);

/* Advances by interval s in sub-steps of sub_step s, at most max_sub_steps of them. Returns the sub-steps that were due: those
   above max_sub_steps are lost. */
int amb_world_step(AmbWorld *world, double interval, int max_sub_steps, double sub_step);
/* The same in pieces: begin returns the sub-steps that are due, of which at most max_sub_steps calls of advance follow, then finish. */
int amb_world_begin_step(AmbWorld *world, double interval, int max_sub_steps, double sub_step);
void amb_world_advance(AmbWorld *world, double sub_step);
void amb_world_finish_step(AmbWorld *world);
/* Forgets contacts and what the solver starts from, and revives bodies that Bullet switched off because their state was not finite. Poses
   and velocities must have been set to finite values before. */
void amb_world_recover(AmbWorld *world);
/* Contact points of rigid bodies that touch or are about to, after the last sub-step. */
int amb_world_contact_count(const AmbWorld *world);

#endif
