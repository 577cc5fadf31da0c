//! Saving and restoring a simulation.

use super::Simulation;
use crate::bullet::{SavedWorld, StateError};

/// The state of a [`Simulation`] at one moment. It belongs to its simulation, and can be restored as often as wanted.
#[derive(Debug, Clone)]
pub struct SavedState {
    world: SavedWorld,
}

impl Simulation {
    /// Saves everything that decides what the simulation does from now on. Nothing changes. The scene must have been loaded with
    /// [`SceneOptions::savable`](crate::scene::SceneOptions::savable).
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::TooLarge`].
    pub fn save(&self) -> Result<SavedState, StateError> {
        Ok(SavedState { world: self.scene.world.save()? })
    }

    /// Brings the simulation back to a saved state: from now on it does what it did from then on, bit for bit, if it is told the same.
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::OtherSimulation`], [`StateError::Changed`], [`StateError::TooLarge`]. Nothing has changed then.
    pub fn restore(&mut self, saved: &SavedState) -> Result<(), StateError> {
        self.scene.world.restore(&saved.world)
    }
}
