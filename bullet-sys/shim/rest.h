/* Bodies at rest: static ones, and dynamic ones that fall asleep. */
#ifndef AMB_REST_H
#define AMB_REST_H
#include "types.h"

/* Static bodies are looked at only when they are set, not in every sub-step. The order of pairs, and so that of contacts, becomes
   another one. */
void amb_world_rest_static(AmbWorld *world);
/* Bodies that touch or are joined fall asleep together once all of them have been slower than linear m/s and angular rad/s for 2 s. What is
   moved, pushed, driven, joined or let go through this interface wakes up, with what it touches. Includes amb_world_rest_static. Not
   for worlds with soft bodies. */
void amb_world_let_sleep(AmbWorld *world, double linear, double angular);
int amb_body_sleeps(const AmbBody *body);

#endif
