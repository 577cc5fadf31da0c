//! Following a recording in real time.
//!
//! What a recording says is done in the order in which it was done; between two updates others see what they saw then. They
//! may pause, step and hold it, and look from elsewhere. Commands and resets of others are refused by the hub.

use std::time::{Duration, Instant};

use super::{PhysicsLoop, MAX_LAG, PAUSED_PERIOD};
use crate::comm::Activity;
use crate::device::timing::Pacer;
use crate::sim::session::Played;
use crate::sim::slices::request_short_slices;
use crate::sim::{Event, Playback, ReplayError};

/// How a recording is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayPlan {
    /// Updates a simulated second of the recording, in the mean: how often it is looked whether one is due, Hz. Default: 1000.
    pub frequency: f64,
    /// Simulated per real time, above 0. Default: 1.
    pub speed: f64,
    /// Simulated time up to which it goes as fast as it can, s. Default: 0.
    pub fast_until: f64,
    /// Simulated time from which on others move the simulation, s; at the end of the recording at the latest. Default,
    /// `None`: at its end, where the simulation pauses.
    pub leave_at: Option<f64>,
}

impl Default for ReplayPlan {
    fn default() -> Self {
        Self { frequency: 1000.0, speed: 1.0, fast_until: 0.0, leave_at: None }
    }
}

/// Why a replay has ended.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReplayEnd {
    /// The recording is over; a sentence where it could not be read to its end.
    Over(Option<String>),
    /// It was left as planned.
    Left,
    /// It cannot go on, or is another motion.
    Failed(ReplayError),
}

/// Where a replay has ended.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayEnded {
    /// Why.
    pub why: ReplayEnd,
    /// The simulation is paused.
    pub is_paused: bool,
    /// Updates that were made.
    pub updates: u64,
    /// Simulated time, s.
    pub sim_time: f64,
    /// [`state_hash`](crate::sim::Simulation::state_hash).
    pub hash: u64,
}

/// How much it may be behind the clock and still catch up, s.
const MAX_BEHIND: f64 = 0.1;
/// How often it is seen how far it is while it goes as fast as it can.
const SHOW: Duration = Duration::from_millis(20);

/// Simulated time that is due.
struct Clock {
    /// How far the simulation is behind it, s; below 0: ahead.
    behind: f64,
    last: Instant,
}

impl Clock {
    /// An update is due now.
    fn new() -> Self {
        Self { behind: 0.0, last: Instant::now() }
    }

    /// The time since the last call does not pass.
    fn skip(&mut self) {
        self.last = Instant::now();
    }

    /// Lets the time since the last call pass at `speed`; whether it is further behind than can be caught up, which is
    /// forgotten.
    fn pass(&mut self, speed: f64) -> bool {
        let now = Instant::now();
        self.behind += (now - std::mem::replace(&mut self.last, now)).as_secs_f64() * speed;
        let most = MAX_BEHIND * speed.max(1.0);
        let is_late = self.behind > most;
        self.behind = self.behind.min(most);
        is_late
    }
}

/// A recording that is followed.
struct Followed {
    playback: Playback,
    plan: ReplayPlan,
    clock: Clock,
    updates: u64,
    /// When others saw it last, while it goes as fast as it can.
    shown: Instant,
    /// The state is lost, as it was then.
    lost: bool,
    told_late: bool,
}

impl PhysicsLoop {
    /// Follows a recording until it is over, left, or the program ends.
    pub(super) fn replay(&mut self, playback: Playback, plan: ReplayPlan) {
        if let Some(link) = &self.simulation.link {
            link.hub.set_replaying(true);
        }
        self.simulation.wait_in_this_thread();
        request_short_slices();
        let (clock, shown) = (Clock::new(), Instant::now());
        let mut followed = Followed { playback, plan, clock, updates: 0, shown, lost: false, told_late: false };
        let mut pacer = Pacer::new(Duration::from_secs_f64(1.0 / plan.frequency), MAX_LAG);
        while !self.control.is_stopping() {
            self.serve_changes();
            self.tell_notices();
            if plan.leave_at.is_some_and(|time| self.simulation.sim_time() >= time) {
                return self.end_replay(&followed, ReplayEnd::Left);
            }
            let is_paused = self.control.is_paused();
            self.simulation.pause_devices(is_paused);
            if is_paused && !self.control.take_manual_step() {
                followed.clock = Clock::new();
                self.simulation.tell_activity(Activity::Paused);
                std::thread::sleep(PAUSED_PERIOD);
                continue;
            }
            self.simulation.tell_activity(Activity::Runs);
            if !(is_paused || self.is_update_due(&mut followed)) {
                pacer.wait();
                continue;
            }
            match self.follow(&mut followed, is_paused) {
                Ok(true) => pacer.skip(),
                Ok(false) => {
                    let why = ReplayEnd::Over(followed.playback.problem());
                    return self.end_replay(&followed, why);
                }
                Err(error) => return self.end_replay(&followed, ReplayEnd::Failed(error)),
            }
        }
    }

    fn is_fast(&self, followed: &Followed) -> bool {
        self.simulation.sim_time() < followed.plan.fast_until
    }

    fn is_update_due(&mut self, followed: &mut Followed) -> bool {
        // Who holds it counts updates.
        if self.is_fast(followed) || self.simulation.is_throttled() {
            followed.clock = Clock::new();
            return true;
        }
        let is_late = followed.clock.pass(self.control.speed() * followed.plan.speed);
        if is_late && !std::mem::replace(&mut followed.told_late, true) {
            let why =
                "the replay is slower than asked for: the scene is too heavy for this computer; nothing is left out";
            self.tell(Event::Notice(why.into()));
        }
        followed.clock.behind >= 0.0
    }

    /// Follows the recording to the next update, and shows it; false at the end. `is_step`: somebody let it through, which
    /// counts for updates.
    fn follow(&mut self, followed: &mut Followed, is_step: bool) -> Result<bool, ReplayError> {
        let begin = Instant::now();
        match followed.playback.update(&mut self.simulation)? {
            Played::Update(passed) => followed.clock.behind -= passed,
            Played::Lost(lost) => {
                followed.updates += 1;
                followed.lost = true;
                self.simulation.tell_lost(Some(&lost));
                self.tell(Event::Notice(format!("{lost}; so it was when it was recorded")));
                return Ok(true);
            }
            Played::Change => {
                self.control.step(u32::from(is_step));
                self.publish(self.start.elapsed());
                return Ok(true);
            }
            Played::Waits => {
                self.control.step(u32::from(is_step));
                std::thread::sleep(PAUSED_PERIOD);
                followed.clock.skip();
                return Ok(true);
            }
            Played::End => return Ok(false),
        }
        followed.updates += 1;
        if std::mem::take(&mut followed.lost) {
            self.simulation.tell_lost(None);
        }
        if self.is_fast(followed) {
            followed.playback.exchange(&mut self.simulation)?;
            if followed.shown.elapsed() >= SHOW {
                followed.shown = Instant::now();
                self.publish(self.start.elapsed());
            }
            return Ok(true);
        }
        let stepped = begin.elapsed();
        if self.simulation.is_held_by_clients() && followed.updates == 1 {
            // Held from the start: clients have to see what there is.
            self.publish(self.start.elapsed());
        }
        let is_held = self.simulation.is_held_by_clients();
        // Resets, after which the state could be lost, are refused.
        let _ = self.hold_for_clients();
        if is_held {
            followed.clock.skip();
        }
        let resumed = Instant::now();
        followed.playback.exchange(&mut self.simulation)?;
        self.publish(resumed - self.start);
        self.simulation.note_published();
        self.statistics.record(resumed - self.start, stepped + resumed.elapsed());
        Ok(true)
    }

    /// Gives the simulation to others, and pauses it unless it was left as planned.
    fn end_replay(&mut self, followed: &Followed, why: ReplayEnd) {
        let goes_on = match why {
            ReplayEnd::Over(_) | ReplayEnd::Left => followed.plan.leave_at.is_some() && !followed.lost,
            ReplayEnd::Failed(_) => false,
        };
        if !goes_on {
            self.control.set_paused(true);
            self.lost = followed.lost;
            self.replay_paused = true;
        }
        self.was_paused = true;
        self.simulation.end_replay();
        if !followed.lost {
            self.publish(self.start.elapsed());
        }
        let ended = ReplayEnded {
            why,
            is_paused: !goes_on,
            updates: followed.updates,
            sim_time: self.simulation.sim_time(),
            hash: self.simulation.state_hash(),
        };
        // It is replayed once.
        let _ = self.control.replay_ended.set(ended);
    }
}
