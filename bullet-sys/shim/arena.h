/* Memory of one world, at addresses that never change, so that all that it holds can be copied out and back. */
#ifndef AMB_ARENA_H
#define AMB_ARENA_H

typedef struct AmbArena AmbArena;

/* One that can grow to `most` bytes, or to as much of that as there is address space for, at least to 1 MiB. Null: there is less. */
AmbArena *amb_arena_new(unsigned long most);
/* Everything in it must have been freed, or is never touched again. */
void amb_arena_free(AmbArena *arena);
/* What the calling thread allocates through Bullet from now on lies in the arena; null: on the heap. Returns what was there before. What is
   freed goes back to where it came from, in any thread. */
AmbArena *amb_arena_enter(AmbArena *arena);
/* Something found no place and lies on the heap: copies are not complete. */
int amb_arena_is_torn(const AmbArena *arena);
/* Bytes of a copy. */
unsigned long amb_arena_size(const AmbArena *arena);
void amb_arena_copy(const AmbArena *arena, unsigned char *out);

#endif
