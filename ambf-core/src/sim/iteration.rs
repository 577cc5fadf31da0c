//! The order of an iteration: nowhere else is it decided what comes before what.
//!
//! An iteration has two halves. [`Simulation::advance`] moves everything by one interval; [`Simulation::exchange`] then
//! takes commands and publishes states. So a command acts from the next update on, and what is published is the state
//! before it acts, as in the C++ program. Clients that throttle the simulation hold it between the halves. Who repeats
//! iterations chooses interval and moment, and where to rest: a [`Runner`](super::Runner) before the first half, a
//! [`Stepper`](super::Stepper) between them.

use std::time::SystemTime;

use super::session::Entry;
use super::{LostState, Reset, Simulation};
use crate::plugin::run::Phase;

impl Simulation {
    /// One iteration of `interval` s, for callers that step a simulation themselves: [`update`](Self::update), plugins
    /// of the world, those of models and objects, commands from the [hub](Self::connect), plugins of the simulator.
    /// Nothing is published. Nothing happens for an interval that is not positive.
    ///
    /// # Errors
    /// Those of [`update`](Self::update).
    pub fn iterate(&mut self, interval: f64) -> Result<(), LostState> {
        if interval.is_nan() || interval <= 0.0 {
            return Ok(());
        }
        self.advance(interval)?;
        self.exchange(|_| ())
    }

    /// Resets the world between the halves of an iteration, and makes the first half anew from there: what rests then is what
    /// rested there at the start. The iteration is not counted twice.
    ///
    /// # Errors
    /// Those of [`advance`](Self::advance).
    pub(super) fn reset_at_rest(&mut self) -> Result<(), LostState> {
        let interval = self.physics.time.interval;
        self.reset_world();
        self.advance_anew(interval)
    }

    /// Does the resets that clients or plugins asked for, between the halves of an iteration: see
    /// [`reset_at_rest`](Self::reset_at_rest). Whether there was one.
    ///
    /// # Errors
    /// Those of [`advance`](Self::advance), after the reset.
    pub(super) fn do_requested_resets_at_rest(&mut self) -> (bool, Result<(), LostState>) {
        let interval = self.physics.time.interval;
        match self.do_requested_resets() {
            None => (false, Ok(())),
            Some(Reset::Bodies) => (true, Ok(())),
            Some(Reset::World) => (true, self.advance_anew(interval)),
        }
    }

    fn advance_anew(&mut self, interval: f64) -> Result<(), LostState> {
        self.physics.uncount_update();
        self.begin_waiting_recording();
        self.advance(interval)
    }

    /// First half of an iteration.
    ///
    /// # Errors
    /// Those of [`update`](Self::update); plugins are not called then.
    pub(super) fn advance(&mut self, interval: f64) -> Result<(), LostState> {
        self.update(interval)?;
        self.update_plugins(Phase::World);
        Ok(())
    }

    /// [`advance`](Self::advance) to a state that is neither published nor saved: reactions of joints are not computed unless
    /// plugins, a recording or windows see them.
    ///
    /// # Errors
    /// Those of [`advance`](Self::advance).
    pub(super) fn advance_unseen(&mut self, interval: f64) -> Result<(), LostState> {
        let is_watched = self.has_plugins() || self.physics.recorder.is_some() || self.is_listened_to();
        self.physics.skips_reactions = !is_watched;
        let outcome = self.advance(interval);
        self.physics.skips_reactions = false;
        outcome
    }

    /// Second half of an iteration. `publish` shows the present state to whom it concerns.
    ///
    /// # Errors
    /// Those of `execute_commands`; nothing is published then.
    pub(super) fn exchange(&mut self, publish: impl FnOnce(&mut Self)) -> Result<(), LostState> {
        self.update_plugins(Phase::Models);
        self.execute_commands()?;
        publish(self);
        self.update_plugins(Phase::Simulator);
        Ok(())
    }

    /// Advances by `interval` s and brings what follows from Bullet's step up to date: joints, efforts, wrenches.
    /// Nothing happens for an interval that is not positive. No plugin is called.
    ///
    /// # Errors
    /// [`LostState`]: the state is lost, the caller should stop or reset.
    pub fn update(&mut self, interval: f64) -> Result<(), LostState> {
        if interval.is_nan() || interval <= 0.0 {
            return Ok(());
        }
        if self.do_plugin_resets() == Some(Reset::World) {
            self.begin_waiting_recording();
        }
        self.execute_posted();
        self.physics.begin_update(interval);
        self.drive_devices();
        self.physics.note(&Entry::Update { iteration: self.physics.time.iteration, interval });
        self.physics.step();
        self.physics.stamp = self.is_listened_to().then(SystemTime::now);
        self.physics.observe();
        self.physics.note_hash();
        self.check_state()?;
        self.tell_cuts();
        self.tell_devices();
        Ok(())
    }
}
