/* Memory of one world at fixed addresses, so that the state of the world can be saved and restored as one block of
   bytes. */
#ifndef AMB_ARENA_H
#define AMB_ARENA_H

typedef struct AmbArena AmbArena;

/* Reserves address space for `max_bytes`, or for half of that repeatedly until it succeeds, at least 1 MiB. Null:
   failure. */
AmbArena *amb_arena_new(unsigned long max_bytes);
/* Everything allocated in the arena must have been freed, or must never be accessed again. */
void amb_arena_free(AmbArena *arena);
/* From now on Bullet allocates in the arena when it is called by this thread; null: on the heap. Returns the previous
   arena. Blocks are always freed where they were allocated, in any thread. */
AmbArena *amb_arena_enter(AmbArena *arena);
/* Whether the arena was full once, so that some object is on the heap and copies of the arena are incomplete. */
int amb_arena_has_overflowed(const AmbArena *arena);
/* Size of a copy, bytes. */
unsigned long amb_arena_size(const AmbArena *arena);
void amb_arena_copy(const AmbArena *arena, unsigned char *out);

#endif
