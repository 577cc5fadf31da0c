//! Saving and restoring a world.

use std::fmt;
use std::mem::size_of_val;

use bullet_sys as sys;
use slotmap::SlotMap;
use thiserror::Error;

use super::articulation::OwnedArticulation;
use super::constraint::OwnedConstraint;
use super::{ArticulationHandle, ConstraintHandle, Integrator, World};

/// Why a state was not saved or not restored; nothing has changed then.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum StateError {
    /// Error when the scene was not loaded with [`SceneOptions::savable`](crate::scene::SceneOptions::savable), or the world was not made
    /// by [`World::savable`].
    #[error("the scene was not loaded for saving: set `savable` in its options")]
    NotSavable,
    /// Error when the process may not have the address space that the scene needs by now.
    #[error("the scene has outgrown the address space that the process may have: raise its limit (`ulimit -v`)")]
    TooLarge,
    /// Error when the state was saved in another simulation, be it of the same files.
    #[error("the state was saved in another simulation: load it there, or save one here")]
    OtherSimulation,
    /// Error when models or objects were added or removed since the state was saved.
    #[error("models were added or removed since the state was saved: save a new one")]
    Changed,
}

/// What of a [`World`] changes while it runs, as it was at one moment.
#[derive(Clone)]
pub struct SavedWorld {
    /// The world that it is of.
    arena: u64,
    structure: u64,
    /// Bullet's side.
    bytes: Box<[u8]>,
    integrator: Integrator,
    articulations: SlotMap<ArticulationHandle, OwnedArticulation>,
    constraints: SlotMap<ConstraintHandle, OwnedConstraint>,
    constraint_list: Vec<*mut sys::AmbConstraint>,
    constraint_order: Vec<ConstraintHandle>,
    readings: Vec<u8>,
    free_places: Vec<usize>,
    /// Of each body: how much holds it, and of which articulation it is a link.
    held: Vec<(usize, Option<ArticulationHandle>)>,
}

// SAFETY: its pointers are only followed by the world that they belong to, after they were put back there.
unsafe impl Send for SavedWorld {}
// SAFETY: as above; nothing of it changes.
unsafe impl Sync for SavedWorld {}

impl fmt::Debug for SavedWorld {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SavedWorld").field("size", &self.size()).finish_non_exhaustive()
    }
}

impl SavedWorld {
    /// Bullet's side.
    #[cfg(test)]
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Memory that it takes, bytes.
    pub fn size(&self) -> usize {
        self.bytes.len()
            + size_of_val(self.held.as_slice())
            + self.constraints.capacity() * size_of::<OwnedConstraint>()
    }
}

impl World {
    /// Whether the state can be saved: the world was made by [`savable`](Self::savable).
    pub fn is_savable(&self) -> bool {
        self.arena.is_some()
    }

    /// Saves everything that decides what the world does from now on. Nothing changes.
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::TooLarge`].
    pub fn save(&self) -> Result<SavedWorld, StateError> {
        let arena = self.arena.as_ref().ok_or(StateError::NotSavable)?;
        if arena.is_torn() {
            return Err(StateError::TooLarge);
        }
        // All fields by name: a new one has to be saved, or is here for a reason.
        let Self {
            arena: _,
            // Owned objects, which stay while the structure does.
            raw: _,
            bodies,
            ghosts: _,
            vehicles: _,
            soft_bodies: _,
            body_list: _,
            body_order: _,
            structure,
            // Chosen when the world is made.
            solver: _,
            has_soft_bodies: _,
            has_articulations: _,
            // Means nothing between calls.
            scratch: _,
            integrator,
            articulations,
            constraints,
            constraint_list,
            constraint_order,
            readings,
            free_places,
        } = self;
        Ok(SavedWorld {
            arena: arena.id(),
            structure: *structure,
            bytes: arena.copy(),
            integrator: *integrator,
            articulations: articulations.clone(),
            constraints: constraints.clone(),
            constraint_list: constraint_list.clone(),
            constraint_order: constraint_order.clone(),
            readings: readings.clone(),
            free_places: free_places.clone(),
            held: bodies.values().map(|body| (body.held, body.articulation)).collect(),
        })
    }

    /// Whether a state can be restored.
    ///
    /// # Errors
    /// Those of [`restore`](Self::restore).
    pub fn check_saved(&self, saved: &SavedWorld) -> Result<(), StateError> {
        let arena = self.arena.as_ref().ok_or(StateError::NotSavable)?;
        match () {
            () if saved.arena != arena.id() => Err(StateError::OtherSimulation),
            () if saved.structure != self.structure => Err(StateError::Changed),
            () if arena.is_torn() => Err(StateError::TooLarge),
            () => Ok(()),
        }
    }

    /// Brings the world back to a saved state: from now on it does what it did from then on, bit for bit, if the same is done to it.
    /// Handles of constraints and articulations that were made since are stale.
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::OtherSimulation`], [`StateError::Changed`] when bodies, soft bodies, ghosts or vehicles
    /// came or went since, [`StateError::TooLarge`]. Nothing has changed then.
    pub fn restore(&mut self, saved: &SavedWorld) -> Result<(), StateError> {
        self.check_saved(saved)?;
        let Some(arena) = &self.arena else { return Err(StateError::NotSavable) };
        // SAFETY: the copy was made of this arena, and since then no object came or went but constraints and trees. Those lie in the
        // arena as a whole, so that with the copy exactly those are alive again that were, and the lists below name just them.
        unsafe {
            sys::amb_world_restore(self.raw.as_ptr(), arena.as_ptr(), saved.bytes.as_ptr(), saved.bytes.len() as u64);
        }
        self.integrator = saved.integrator;
        self.articulations.clone_from(&saved.articulations);
        self.constraints.clone_from(&saved.constraints);
        self.constraint_list.clone_from(&saved.constraint_list);
        self.constraint_order.clone_from(&saved.constraint_order);
        self.readings.clone_from(&saved.readings);
        self.free_places.clone_from(&saved.free_places);
        for (body, &(held, articulation)) in self.bodies.values_mut().zip(&saved.held) {
            (body.held, body.articulation) = (held, articulation);
        }
        Ok(())
    }
}
