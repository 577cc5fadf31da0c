// How what the shim makes gets into the arena of its world, see arena.h. C++ only.
//
// Everything that changes while a world runs has to lie there: classes by BT_DECLARE_ALIGNED_ALLOCATOR, members by Vector, what is shared
// by make_held. Bullet's own is there but for the two things that it makes with plain `new`: the island callback of a world with trees,
// which the engine's tree_world.cpp replaces, and the cells of the distance fields of soft bodies, which soft_body.cpp keeps out.
#ifndef AMB_ARENA_MEMORY_H
#define AMB_ARENA_MEMORY_H

#include <memory>
#include <vector>

#include <LinearMath/btAlignedAllocator.h>

extern "C" {
#include "arena.h"
}

// Allocates where Bullet does.
template <typename T>
struct HeldAllocator {
  using value_type = T;

  HeldAllocator() = default;
  template <typename U>
  HeldAllocator(const HeldAllocator<U> &) {}

  T *allocate(size_t n) { return static_cast<T *>(btAlignedAlloc(n * sizeof(T), 16)); }
  void deallocate(T *block, size_t) { btAlignedFree(block); }

  template <typename U>
  bool operator==(const HeldAllocator<U> &) const {
    return true;
  }
  template <typename U>
  bool operator!=(const HeldAllocator<U> &) const {
    return false;
  }
};

template <typename T>
using Vector = std::vector<T, HeldAllocator<T>>;

template <typename T, typename... Arguments>
std::shared_ptr<T> make_held(Arguments &&...arguments) {
  return std::allocate_shared<T>(HeldAllocator<T>(), std::forward<Arguments>(arguments)...);
}

// A class of Bullet's that has no such allocator.
template <typename T>
struct Held : T {
  using T::T;
  BT_DECLARE_ALIGNED_ALLOCATOR();
};

bool lies_in(const AmbArena &arena, const void *pointer);
// What lies in the arena is as it was when it was copied.
void put_back(AmbArena &arena, const unsigned char *copy, size_t size);

#endif
