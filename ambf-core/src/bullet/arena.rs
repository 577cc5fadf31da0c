//! Memory of a world whose state can be saved and restored.

use std::marker::PhantomData;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU64, Ordering};

use bullet_sys as sys;

/// Memory of one world, at fixed addresses, in which all of its changing state is allocated.
pub(super) struct Arena {
    raw: NonNull<sys::AmbArena>,
    /// Unique in this process.
    id: u64,
}

impl Arena {
    /// An arena that can grow to `max_bytes`, or less if there is less address space. `None`: the process has no
    /// address space left.
    pub fn new(max_bytes: u64) -> Option<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        // SAFETY: takes a number.
        let raw = NonNull::new(unsafe { sys::amb_arena_new(max_bytes) })?;
        Some(Self { raw, id: NEXT.fetch_add(1, Ordering::Relaxed) })
    }

    pub fn as_ptr(&self) -> *mut sys::AmbArena {
        self.raw.as_ptr()
    }

    pub fn id(&self) -> u64 {
        self.id
    }

    /// Whether the arena was full once, so that some object is on the heap and copies are incomplete.
    pub fn has_overflowed(&self) -> bool {
        // SAFETY: the arena is alive.
        unsafe { sys::amb_arena_has_overflowed(self.as_ptr()) != 0 }
    }

    /// A copy of its contents.
    pub fn copy(&self) -> Box<[u8]> {
        // SAFETY: the arena is alive.
        let size = unsafe { sys::amb_arena_size(self.as_ptr()) } as usize;
        let mut bytes = Vec::with_capacity(size);
        // SAFETY: the arena is alive and `size` bytes of it are in use, which are written to the beginning of the room
        // for as many.
        unsafe {
            sys::amb_arena_copy(self.as_ptr(), bytes.as_mut_ptr());
            bytes.set_len(size);
        }
        bytes.into_boxed_slice()
    }
}

impl Drop for Arena {
    fn drop(&mut self) {
        // SAFETY: the world that lies in it was freed before, and no guard outlives a call into the world.
        unsafe { sys::amb_arena_free(self.as_ptr()) }
    }
}

/// While the guard lives, Bullet allocates in the arena, if there is one, when this thread calls it.
pub(super) struct ArenaGuard {
    /// The arena that was entered before; `None`: there is no arena, and nothing was changed.
    before: Option<*mut sys::AmbArena>,
    /// The guard must not be moved to another thread.
    _thread: PhantomData<*mut ()>,
}

impl ArenaGuard {
    pub fn new(arena: Option<&Arena>) -> Self {
        // SAFETY: the arena is alive, and its world, which keeps it, is not dropped while one of its methods runs.
        let before = arena.map(|arena| unsafe { sys::amb_arena_enter(arena.as_ptr()) });
        Self { before, _thread: PhantomData }
    }
}

impl Drop for ArenaGuard {
    fn drop(&mut self) {
        if let Some(before) = self.before {
            // SAFETY: guards go in the reverse order of their making, so that what was entered before is still alive.
            unsafe { sys::amb_arena_enter(before) };
        }
    }
}
