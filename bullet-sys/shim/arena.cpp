#include "arena_memory.h"

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <sys/mman.h>

#include <LinearMath/btAlignedAllocator.h>

namespace {

// Free blocks are kept in one list per size class: sizes in steps of 16 up to 128 bytes, then four classes to a power
// of two.
constexpr size_t kStep = 16, kFine = 128;
constexpr int kFineClasses = kFine / kStep, kClasses = kFineClasses + 4 * (64 - 7);

int class_of(size_t size) {
  if (size <= kFine) return static_cast<int>((size - 1) / kStep);
  const int power = 63 - __builtin_clzl(size - 1);
  return kFineClasses + 4 * (power - 7) + static_cast<int>((size - 1) >> (power - 2) & 3);
}

size_t size_of(int index) {
  if (index < kFineClasses) return kStep * static_cast<size_t>(index + 1);
  const int power = 7 + (index - kFineClasses) / 4;
  return static_cast<size_t>((index - kFineClasses) % 4 + 5) << (power - 2);
}

// State of the allocator. It is at the beginning of the arena, so that it is saved and restored with the contents.
struct AllocatorState {
  size_t used;
  void *free[kClasses];
};

// Precedes every block. On the heap `origin` is the address from malloc, as in Bullet's allocator; in an arena it is
// the address of the AmbArena with the lowest bit set, which no address from malloc has.
struct Header {
  uint32_t size_class;
  uint32_t offset;
  uintptr_t origin;
};
static_assert(sizeof(Header) == kStep, "blocks are aligned by it");

constexpr size_t kMinReserved = size_t(1) << 20, kMinCommitted = size_t(256) << 10;

thread_local AmbArena *current = nullptr;

}  // namespace

struct AmbArena {
  unsigned char *base = nullptr;
  size_t reserved = 0, committed = 0;
  bool has_overflowed = false;

  AllocatorState &state() const { return *reinterpret_cast<AllocatorState *>(base); }

  bool commit(size_t size) {
    if (size > reserved) return false;
    if (size <= committed) return true;
    size_t wanted = committed * 2 > size ? committed * 2 : size;
    wanted = (wanted + kMinCommitted - 1) / kMinCommitted * kMinCommitted;
    if (wanted > reserved) wanted = reserved;
    if (mprotect(base + committed, wanted - committed, PROT_READ | PROT_WRITE) != 0) return false;
    committed = wanted;
    return true;
  }

  void *take(size_t size, size_t alignment) {
    const size_t slack = alignment > kStep ? alignment - kStep : 0;
    if (size > reserved) return nullptr;
    const int index = class_of(size + sizeof(Header) + slack);
    unsigned char *block = static_cast<unsigned char *>(state().free[index]);
    if (block) {
      memcpy(&state().free[index], block, sizeof(void *));
    } else {
      if (!commit(state().used + size_of(index))) return nullptr;
      block = base + state().used;
      state().used += size_of(index);
    }
    unsigned char *out = block + sizeof(Header);
    out += (alignment - reinterpret_cast<uintptr_t>(out) % alignment) % alignment;
    const Header header = {static_cast<uint32_t>(index), static_cast<uint32_t>(out - block),
                           reinterpret_cast<uintptr_t>(this) | 1};
    memcpy(out - sizeof(Header), &header, sizeof(Header));
    // Bullet's own allocator clears blocks too.
    memset(out, 0, size);
    return out;
  }

  void give(unsigned char *pointer, const Header &header) {
    unsigned char *block = pointer - header.offset;
    memcpy(block, &state().free[header.size_class], sizeof(void *));
    state().free[header.size_class] = block;
  }
};

namespace {

void *allocate(size_t size, int alignment_wanted) {
  const size_t alignment = alignment_wanted < int(kStep) ? kStep : static_cast<size_t>(alignment_wanted);
  if (current) {
    if (void *block = current->take(size, alignment)) return block;
    current->has_overflowed = true;
  }
  // The layout of Bullet's default allocator, so that either function may free a block of the other.
  void *const real = calloc(1, size + sizeof(Header) + alignment);
  if (!real) return nullptr;
  unsigned char *out = static_cast<unsigned char *>(real) + sizeof(Header);
  out += (alignment - reinterpret_cast<uintptr_t>(out) % alignment) % alignment;
  memcpy(out - sizeof(void *), &real, sizeof(void *));
  return out;
}

void release(void *pointer) {
  if (!pointer) return;
  unsigned char *const block = static_cast<unsigned char *>(pointer);
  uintptr_t origin;
  memcpy(&origin, block - sizeof(origin), sizeof(origin));
  if (!(origin & 1)) {
    free(reinterpret_cast<void *>(origin));
    return;
  }
  Header header;
  memcpy(&header, block - sizeof(header), sizeof(header));
  reinterpret_cast<AmbArena *>(origin & ~uintptr_t(1))->give(block, header);
}

}  // namespace

bool is_in_arena(const AmbArena &arena, const void *pointer) {
  const auto *at = static_cast<const unsigned char *>(pointer);
  return at >= arena.base && at < arena.base + arena.reserved;
}

void restore_arena(AmbArena &arena, const unsigned char *copy, size_t size) { memcpy(arena.base, copy, size); }

extern "C" {

AmbArena *amb_arena_new(unsigned long max_bytes) {
  static std::once_flag installed;
  std::call_once(installed, [] { btAlignedAllocSetCustomAligned(allocate, release); });
  // Only address space is reserved; no memory is used before pages are committed.
  size_t reserved = max_bytes > kMinReserved ? max_bytes : kMinReserved;
  void *base = MAP_FAILED;
  while (base == MAP_FAILED && reserved >= kMinReserved) {
    base = mmap(nullptr, reserved, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (base == MAP_FAILED) reserved /= 2;
  }
  if (base == MAP_FAILED) return nullptr;
  auto *arena = new AmbArena;
  arena->base = static_cast<unsigned char *>(base);
  arena->reserved = reserved;
  if (!arena->commit(sizeof(AllocatorState))) {
    amb_arena_free(arena);
    return nullptr;
  }
  arena->state().used = (sizeof(AllocatorState) + kStep - 1) / kStep * kStep;
  return arena;
}

void amb_arena_free(AmbArena *arena) {
  munmap(arena->base, arena->reserved);
  delete arena;
}

AmbArena *amb_arena_enter(AmbArena *arena) {
  AmbArena *before = current;
  current = arena;
  return before;
}

int amb_arena_has_overflowed(const AmbArena *arena) { return arena->has_overflowed; }

unsigned long amb_arena_size(const AmbArena *arena) { return arena->state().used; }

void amb_arena_copy(const AmbArena *arena, unsigned char *out) { memcpy(out, arena->base, arena->state().used); }

}  // extern "C"
