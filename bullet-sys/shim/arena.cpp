#include "arena_memory.h"

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <sys/mman.h>

#include <LinearMath/btAlignedAllocator.h>

namespace {

// Blocks of like size are kept in lists: sizes in steps of 16 up to 128 bytes, then four to a power of two.
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

// At the beginning of an arena: what was handed out goes back with what it holds.
struct Book {
  size_t used;
  void *free[kClasses];
};

// Before every block. On the heap `origin` is what malloc gave, as Bullet has it; in an arena it is the arena, with the lowest bit set,
// which is never set in what malloc gives.
struct Header {
  uint32_t size_class;
  uint32_t offset;
  uintptr_t origin;
};
static_assert(sizeof(Header) == kStep, "blocks are aligned by it");

constexpr size_t kLeastReserved = size_t(1) << 20, kLeastCommitted = size_t(256) << 10;

thread_local AmbArena *current = nullptr;

}  // namespace

struct AmbArena {
  unsigned char *base = nullptr;
  size_t reserved = 0, committed = 0;
  bool torn = false;

  Book &book() const { return *reinterpret_cast<Book *>(base); }

  bool commit(size_t size) {
    if (size > reserved) return false;
    if (size <= committed) return true;
    size_t wanted = committed * 2 > size ? committed * 2 : size;
    wanted = (wanted + kLeastCommitted - 1) / kLeastCommitted * kLeastCommitted;
    if (wanted > reserved) wanted = reserved;
    if (mprotect(base + committed, wanted - committed, PROT_READ | PROT_WRITE) != 0) return false;
    committed = wanted;
    return true;
  }

  void *take(size_t size, size_t alignment) {
    const size_t slack = alignment > kStep ? alignment - kStep : 0;
    if (size > reserved) return nullptr;
    const int index = class_of(size + sizeof(Header) + slack);
    unsigned char *block = static_cast<unsigned char *>(book().free[index]);
    if (block) {
      memcpy(&book().free[index], block, sizeof(void *));
    } else {
      if (!commit(book().used + size_of(index))) return nullptr;
      block = base + book().used;
      book().used += size_of(index);
    }
    unsigned char *out = block + sizeof(Header);
    out += (alignment - reinterpret_cast<uintptr_t>(out) % alignment) % alignment;
    const Header header = {static_cast<uint32_t>(index), static_cast<uint32_t>(out - block),
                           reinterpret_cast<uintptr_t>(this) | 1};
    memcpy(out - sizeof(Header), &header, sizeof(Header));
    // As Bullet's own allocator does.
    memset(out, 0, size);
    return out;
  }

  void give(unsigned char *pointer, const Header &header) {
    unsigned char *block = pointer - header.offset;
    memcpy(block, &book().free[header.size_class], sizeof(void *));
    book().free[header.size_class] = block;
  }
};

namespace {

void *allocate(size_t size, int alignment_wanted) {
  const size_t alignment = alignment_wanted < int(kStep) ? kStep : static_cast<size_t>(alignment_wanted);
  if (current) {
    if (void *block = current->take(size, alignment)) return block;
    current->torn = true;
  }
  // Bullet's own, whose blocks may be freed here and the other way round.
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

bool lies_in(const AmbArena &arena, const void *pointer) {
  const auto *at = static_cast<const unsigned char *>(pointer);
  return at >= arena.base && at < arena.base + arena.reserved;
}

void put_back(AmbArena &arena, const unsigned char *copy, size_t size) { memcpy(arena.base, copy, size); }

extern "C" {

AmbArena *amb_arena_new(unsigned long most) {
  static std::once_flag installed;
  std::call_once(installed, [] { btAlignedAllocSetCustomAligned(allocate, release); });
  // Address space, which costs nothing before it is used.
  size_t reserved = most > kLeastReserved ? most : kLeastReserved;
  void *base = MAP_FAILED;
  while (base == MAP_FAILED && reserved >= kLeastReserved) {
    base = mmap(nullptr, reserved, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (base == MAP_FAILED) reserved /= 2;
  }
  if (base == MAP_FAILED) return nullptr;
  auto *arena = new AmbArena;
  arena->base = static_cast<unsigned char *>(base);
  arena->reserved = reserved;
  if (!arena->commit(sizeof(Book))) {
    amb_arena_free(arena);
    return nullptr;
  }
  arena->book().used = (sizeof(Book) + kStep - 1) / kStep * kStep;
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

int amb_arena_is_torn(const AmbArena *arena) { return arena->torn; }

unsigned long amb_arena_size(const AmbArena *arena) { return arena->book().used; }

void amb_arena_copy(const AmbArena *arena, unsigned char *out) { memcpy(out, arena->base, arena->book().used); }

}  // extern "C"
