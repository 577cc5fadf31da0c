//! Saving and restoring a simulation.

use super::cap::SubStepCap;
use super::commands::{Link, SavedCommands};
use super::driven::Driven;
use super::plugins::Attachment;
use super::Simulation;
use crate::bullet::StateError;
use crate::comm::Wrench;
use crate::device::law::EndEffector;
use crate::scene::SavedScene;

/// The state of a [`Simulation`] at one moment: poses, velocities, contacts with what the solver starts from, controllers, motors, springs,
/// what actuators hold, sensors, soft bodies, vehicles, commands in force, clocks. It belongs to its simulation, and can be restored as
/// often as wanted; any number of them may exist.
///
/// ## Limitations
/// What plugins keep for themselves is not part of it, nor where a hand holds an input device, nor the time that was spent in Bullet.
pub struct SavedState {
    scene: SavedScene,
    cap: SubStepCap,
    sim_time: f64,
    dt: f64,
    interval: f64,
    iteration: u64,
    lost_time: f64,
    due: u32,
    wrenches: Vec<Wrench>,
    commands: SavedCommands,
    driven: Driven,
    attachments: Vec<Attachment>,
    devices: Vec<EndEffector>,
}

impl std::fmt::Debug for SavedState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { sim_time, iteration, .. } = self;
        let mut out = f.debug_struct("SavedState");
        out.field("sim_time", sim_time)
            .field("iteration", iteration)
            .field("size", &self.size())
            .finish_non_exhaustive()
    }
}

impl SavedState {
    /// Memory that it takes, bytes, but for little.
    pub fn size(&self) -> usize {
        self.scene.size()
    }

    /// Simulated time of the state, s.
    pub fn sim_time(&self) -> f64 {
        self.sim_time
    }
}

impl Simulation {
    /// Saves everything that decides what the simulation does from now on, between two updates. Nothing changes. The scene must have been
    /// loaded with [`SceneOptions::savable`](crate::scene::SceneOptions::savable).
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::TooLarge`].
    pub fn save(&self) -> Result<SavedState, StateError> {
        // All fields by name, so that no new one is forgotten.
        let Self {
            plugins: _,
            plugin_state,
            scene,
            sub_step: _,
            cap,
            sim_time,
            dt,
            interval,
            iteration,
            lost_time,
            due,
            // Measured, not simulated.
            bullet_time: _,
            stamp: _,
            // Read anew in each update.
            joint_buffer: _,
            wrenches,
            link,
            // What others have asked for or are to be told.
            requests: _,
            notices: _,
            driven,
            devices,
        } = self;
        Ok(SavedState {
            scene: scene.save()?,
            cap: cap.clone(),
            sim_time: *sim_time,
            dt: *dt,
            interval: *interval,
            iteration: *iteration,
            lost_time: *lost_time,
            due: *due,
            wrenches: wrenches.clone(),
            commands: link.as_ref().map(Link::save).unwrap_or_default(),
            driven: driven.clone(),
            attachments: plugin_state.save(),
            devices: devices.as_ref().map(|devices| devices.save()).unwrap_or_default(),
        })
    }

    /// Brings the simulation back to a saved state: from now on it does what it did from then on, bit for bit, if it is told the same.
    ///
    /// # Errors
    /// [`StateError::NotSavable`]; [`StateError::OtherSimulation`], also for another simulation of the same files; [`StateError::Changed`]
    /// when models or devices were added or removed since; [`StateError::TooLarge`]. Nothing has changed then.
    pub fn restore(&mut self, saved: &SavedState) -> Result<(), StateError> {
        self.scene.restore(&saved.scene)?;
        self.cap.clone_from(&saved.cap);
        self.sim_time = saved.sim_time;
        (self.dt, self.interval) = (saved.dt, saved.interval);
        self.iteration = saved.iteration;
        (self.lost_time, self.due) = (saved.lost_time, saved.due);
        self.wrenches.clone_from(&saved.wrenches);
        if let Some(link) = &mut self.link {
            link.restore(&saved.commands);
        }
        self.driven.restore(&saved.driven);
        self.plugin_state.restore(&saved.attachments);
        if let Some(devices) = &mut self.devices {
            devices.restore(&saved.devices);
        }
        self.tell_devices();
        Ok(())
    }
}
