use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;

use super::{Activity, Command, Hub, HubIndex, PostError, Snapshot};

/// How long iterations may take to make any progress.
const STALLED: Duration = Duration::from_secs(30);

/// A number of iterations to be made while the physics is otherwise held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepOrder {
    /// Iterations; 0 only holds.
    pub steps: u32,
    /// Everything returns to its initial state first.
    pub reset: bool,
    /// How long the physics waits for the next order before it runs freely.
    pub patience: Duration,
}

/// Error when an order cannot be carried out.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum StepError {
    /// Error when the simulation is paused by a user.
    #[error("the simulation is paused")]
    Paused,
    /// Error when the state was lost; what [`Hub::lost`] says.
    #[error("{0}")]
    Lost(String),
    /// Error when the physics makes no progress, or has ended.
    #[error("the physics has made no progress for {} s", STALLED.as_secs())]
    Stalled,
    /// Error when a command is refused.
    #[error(transparent)]
    Command(#[from] PostError),
}

/// Where an order leaves its commands.
pub struct OrderedCommands<'a> {
    hub: &'a Hub,
    order: u64,
}

impl OrderedCommands<'_> {
    /// [`Hub::post`] of a command that nothing replaces while the order runs.
    ///
    /// # Errors
    /// [`PostError::NotFinite`].
    pub fn post<C: Command>(&self, object: HubIndex, command: &C) -> Result<(), PostError> {
        self.hub.post_for(object, command, self.order)
    }
}

/// Says that no order runs any more, however it ended.
struct Running<'a>(&'a AtomicU64);

impl Drop for Running<'_> {
    fn drop(&mut self) {
        self.0.store(0, Ordering::Release);
    }
}

impl Hub {
    /// Holds the physics, lets `command` post what is to be in force, lets exactly the ordered iterations through, and
    /// returns the state after them. Blocks; orders of several threads are carried out one after the other.
    ///
    /// What `command` posts stays in force until the last of the iterations: a command that others post meanwhile for
    /// the same object, or that they posted before and that was delivered late, is dropped.
    ///
    /// A reset is done at rest: between the Bullet step of one iteration and its commands, as every order begins. So, with
    /// fixed steps, the result of a series of orders depends on nothing else.
    ///
    /// # Errors
    /// [`StepError`]. After [`StepError::Command`] nothing has moved, except for a reset.
    pub fn step(
        &self,
        order: StepOrder,
        command: impl FnOnce(&OrderedCommands) -> Result<(), PostError>,
    ) -> Result<Arc<Snapshot>, StepError> {
        let mut orders = self.turn.lock();
        *orders += 1;
        if order.reset && self.refuses() {
            return Err(PostError::Replaying.into());
        }
        let throttle = self.throttle();
        if throttle.activity() == Activity::Paused && !order.reset {
            return Err(self.why_paused());
        }
        self.await_progress(|| self.snapshot().is_some())?;
        throttle.hold(order.patience, self.now_ns());
        if order.reset || order.steps == 0 {
            self.await_progress(|| throttle.activity() != Activity::Runs)?;
        }
        if order.reset {
            let before = self.resets();
            self.request_world_reset();
            self.await_progress(|| self.resets() != before)?;
        }
        self.running_order.store(*orders, Ordering::Release);
        let _running = Running(&self.running_order);
        command(&OrderedCommands { hub: self, order: *orders })?;
        if order.steps > 0 {
            throttle.order(order.steps, self.now_ns());
            let done = self.await_progress(|| !throttle.is_busy() || throttle.activity() == Activity::Paused);
            if done.is_err() || throttle.is_busy() {
                throttle.cancel();
                return Err(done.err().unwrap_or_else(|| self.why_paused()));
            }
        }
        self.snapshot().clone().ok_or(StepError::Stalled)
    }

    fn why_paused(&self) -> StepError {
        self.lost().map_or(StepError::Paused, |why| StepError::Lost(String::clone(&why)))
    }

    /// Waits as long as iterations are made.
    fn await_progress(&self, is_there: impl Fn() -> bool) -> Result<(), StepError> {
        let progress = || (self.throttle().ordered(), self.snapshot().as_ref().map(|snapshot| snapshot.sim_step));
        let mut before = progress();
        while !self.throttle().wait_until(STALLED, &is_there) {
            let now = progress();
            if now == before {
                return Err(StepError::Stalled);
            }
            before = now;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{Snapshot, SnapshotWriter, StepThrottle};
    use std::sync::atomic::{AtomicBool, Ordering};

    const PATIENCE: Duration = Duration::from_secs(60);

    fn order(steps: u32, reset: bool) -> StepOrder {
        StepOrder { steps, reset, patience: PATIENCE }
    }

    /// Does to a hub what the physics loop does, with a counter for a simulation.
    fn iterate(hub: &Hub, stop: &AtomicBool) {
        let (mut writer, mut counter, mut step) = (SnapshotWriter::new(Snapshot::default()), 0, 0);
        let throttle: &StepThrottle = hub.throttle();
        throttle.set_waiter(std::thread::current());
        while !stop.load(Ordering::Acquire) {
            step += 1;
            let publish = |writer: &mut SnapshotWriter| hub.publish(writer, |snapshot| snapshot.sim_step = step);
            while !throttle.is_open() && !stop.load(Ordering::Acquire) {
                throttle.wait(|| hub.now_ns(), || stop.load(Ordering::Acquire) || hub.reset_requested());
                if hub.take_resets().world.is_some() {
                    publish(&mut writer);
                    hub.note_reset();
                }
            }
            throttle.count(&mut counter);
            publish(&mut writer);
            throttle.note_published(hub.now_ns());
        }
    }

    #[test]
    fn orders_make_exactly_as_many_iterations() {
        let (hub, stop) = (Hub::new(Vec::new()), AtomicBool::new(false));
        std::thread::scope(|scope| {
            scope.spawn(|| iterate(&hub, &stop));
            let start = hub.step(order(0, false), |_| Ok(())).unwrap().sim_step;
            assert_eq!(hub.snapshot().as_ref().unwrap().sim_step, start, "held");
            let mut expected = start;
            for steps in [1, 1, 7, 300, 1, 2] {
                expected += steps;
                assert_eq!(hub.step(order(steps, false), |_| Ok(())).unwrap().sim_step, expected);
            }
            assert_eq!(hub.step(order(0, true), |_| Ok(())).unwrap().sim_step, expected + 1, "the iteration under way");
            assert_eq!(hub.step(order(1, false), |_| Ok(())).unwrap().sim_step, expected + 1, "is the next to be done");
            let refused = hub.step(order(5, false), |_| Err(PostError::NotFinite("a".into())));
            assert_eq!(refused, Err(StepError::Command(PostError::NotFinite("a".into()))));
            assert_eq!(hub.step(order(1, false), |_| Ok(())).unwrap().sim_step, expected + 2);
            stop.store(true, Ordering::Release);
            hub.throttle().wake();
        });
    }

    #[test]
    fn a_pause_is_told() {
        let hub = Hub::new(Vec::new());
        hub.throttle().set_activity(Activity::Paused);
        assert_eq!(hub.step(order(1, false), |_| Ok(())), Err(StepError::Paused));
    }
}
