// Allocation of the shim's objects in the arena of their world, see arena.h. C++ only.
//
// All state that changes while a world runs must be in the arena: classes use BT_DECLARE_ALIGNED_ALLOCATOR, members are
// Vectors, shared objects are created by make_in_arena. Bullet's own objects are there except two that it allocates
// with plain `new`: the island callback of a world with articulations, which the engine's articulated_world.cpp
// replaces, and the cells of the signed distance fields of soft bodies, which soft_body.cpp excludes from saved states.
#ifndef AMB_ARENA_MEMORY_H
#define AMB_ARENA_MEMORY_H

#include <memory>
#include <vector>

#include <LinearMath/btAlignedAllocator.h>

extern "C" {
#include "arena.h"
}

// Allocates with btAlignedAlloc: in the arena that the thread has entered, or on the heap.
template <typename T>
struct ArenaAllocator {
  using value_type = T;

  ArenaAllocator() = default;
  template <typename U>
  ArenaAllocator(const ArenaAllocator<U> &) {}

  T *allocate(size_t n) { return static_cast<T *>(btAlignedAlloc(n * sizeof(T), 16)); }
  void deallocate(T *block, size_t) { btAlignedFree(block); }

  template <typename U>
  bool operator==(const ArenaAllocator<U> &) const {
    return true;
  }
  template <typename U>
  bool operator!=(const ArenaAllocator<U> &) const {
    return false;
  }
};

template <typename T>
using Vector = std::vector<T, ArenaAllocator<T>>;

template <typename T, typename... Arguments>
std::shared_ptr<T> make_in_arena(Arguments &&...arguments) {
  return std::allocate_shared<T>(ArenaAllocator<T>(), std::forward<Arguments>(arguments)...);
}

// Adds the aligned allocator to a class of Bullet that does not declare it.
template <typename T>
struct InArena : T {
  using T::T;
  BT_DECLARE_ALIGNED_ALLOCATOR();
};

bool is_in_arena(const AmbArena &arena, const void *pointer);
// Overwrites the arena with a copy of it.
void restore_arena(AmbArena &arena, const unsigned char *copy, size_t size);

#endif
