//! Memory of a world that can be copied out and back.

use std::marker::PhantomData;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU64, Ordering};

use bullet_sys as sys;

/// Where all of a world lies that changes, at addresses that never change.
pub(super) struct Arena {
    raw: NonNull<sys::AmbArena>,
    /// No other arena ever has it.
    id: u64,
}

impl Arena {
    /// One that can grow to `most` bytes, or as far as there is address space. `None`: the process may have no more of that.
    pub fn new(most: u64) -> Option<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        // SAFETY: takes a number.
        let raw = NonNull::new(unsafe { sys::amb_arena_new(most) })?;
        Some(Self { raw, id: NEXT.fetch_add(1, Ordering::Relaxed) })
    }

    pub fn as_ptr(&self) -> *mut sys::AmbArena {
        self.raw.as_ptr()
    }

    pub fn id(&self) -> u64 {
        self.id
    }

    /// Whether something found no place, so that copies are not complete.
    pub fn has_overflowed(&self) -> bool {
        // SAFETY: the arena is alive.
        unsafe { sys::amb_arena_has_overflowed(self.as_ptr()) != 0 }
    }

    /// What lies in it.
    pub fn copy(&self) -> Box<[u8]> {
        // SAFETY: the arena is alive.
        let size = unsafe { sys::amb_arena_size(self.as_ptr()) } as usize;
        let mut bytes = Vec::with_capacity(size);
        // SAFETY: the arena is alive and `size` bytes of it are in use, which are written to the beginning of the room for as many.
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

/// While it lives, what Bullet allocates in this thread lies in an arena, if there is one.
pub(super) struct ArenaGuard {
    /// What was entered before; `None`: nothing was changed.
    before: Option<*mut sys::AmbArena>,
    /// It belongs to its thread.
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
