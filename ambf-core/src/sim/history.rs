//! The last minute of a simulation, to look back at and to go on from.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::Arc;

use super::saved::SavedState;
use super::Simulation;

/// Simulated time between two states that are kept, s.
const INTERVAL: f64 = 0.1;
/// Simulated time that is kept, s.
const SPAN: f64 = 60.0;
/// Memory that the states may take, bytes. Of larger scenes less time is kept.
const MAX_BYTES: usize = 256 << 20;

/// What times are kept, for the thread with the windows. Times are simulated ones, s.
#[derive(Debug, Default)]
pub struct Timeline {
    first: AtomicU64,
    last: AtomicU64,
    count: AtomicU32,
}

impl Timeline {
    /// The first and the last time of which there are states; `None` without any.
    pub fn span(&self) -> Option<(f64, f64)> {
        let time = |bits: &AtomicU64| f64::from_bits(bits.load(Ordering::Acquire));
        (self.count() > 0).then(|| (time(&self.first), time(&self.last)))
    }

    /// How many states there are.
    pub fn count(&self) -> u32 {
        self.count.load(Ordering::Acquire)
    }
}

/// States of the last minute, oldest first.
#[derive(Default)]
pub(super) struct History {
    states: VecDeque<Arc<SavedState>>,
    bytes: usize,
}

impl History {
    fn push(&mut self, state: SavedState) {
        // What comes after a state that the simulation went on from did not happen.
        while self.states.back().is_some_and(|last| last.sim_time() >= state.sim_time()) {
            self.drop_one(VecDeque::pop_back);
        }
        let oldest = state.sim_time() - SPAN;
        self.bytes += state.size();
        self.states.push_back(Arc::new(state));
        while self.states.len() > 1
            && (self.bytes > MAX_BYTES || self.states.front().is_some_and(|first| first.sim_time() < oldest))
        {
            self.drop_one(VecDeque::pop_front);
        }
    }

    fn drop_one(&mut self, pop: impl FnOnce(&mut VecDeque<Arc<SavedState>>) -> Option<Arc<SavedState>>) {
        self.bytes -= pop(&mut self.states).map_or(0, |state| state.size());
    }

    /// The state whose time is nearest.
    fn nearest(&self, time: f64) -> Option<Arc<SavedState>> {
        let after = self.states.partition_point(|state| state.sim_time() < time);
        let off = |state: &&Arc<SavedState>| (state.sim_time() - time).abs();
        let both = self.states.get(after.saturating_sub(1)).into_iter().chain(self.states.get(after));
        both.min_by(|a, b| off(a).total_cmp(&off(b))).map(Arc::clone)
    }

    fn tell(&self, timeline: &Timeline) {
        let time = |state: Option<&Arc<SavedState>>| state.map_or(0.0, |state| state.sim_time()).to_bits();
        timeline.first.store(time(self.states.front()), Ordering::Release);
        timeline.last.store(time(self.states.back()), Ordering::Release);
        timeline.count.store(self.states.len() as u32, Ordering::Release);
    }
}

/// The part of a [`Simulation`] that looks back.
#[derive(Default)]
pub(super) struct Recording {
    /// `None`: nothing is kept.
    history: Option<History>,
    pub timeline: Arc<Timeline>,
    /// Time has jumped since somebody asked.
    jumped: bool,
}

impl Simulation {
    /// Keeps the states of the last minute of simulated time from now on, one every 0.1 s and at most 256 MiB of them,
    /// or forgets them all. The scene must have been loaded with
    /// [`SceneOptions::savable`](crate::scene::SceneOptions::savable). Costs nothing while it is off; while it is on,
    /// the memory of the scene is copied ten times a second of simulated time.
    ///
    /// # Errors
    /// A sentence when states cannot be saved: nothing is kept then.
    pub fn keep_history(&mut self, keep: bool) -> Result<(), String> {
        self.recording.history = None;
        let outcome = match keep {
            true => self.save().map(|state| {
                let mut history = History::default();
                history.push(state);
                self.recording.history = Some(history);
            }),
            false => Ok(()),
        };
        self.tell_timeline();
        outcome.map_err(|error| format!("the last minute cannot be kept: {error}"))
    }

    /// Times of which there are states.
    pub fn timeline(&self) -> &Arc<Timeline> {
        &self.recording.timeline
    }

    /// Keeps the present state if it is time for that; a sentence when it cannot be saved, after which nothing is kept.
    pub(super) fn record_history(&mut self) -> Option<String> {
        let last = self.recording.history.as_ref()?.states.back().map(|last| last.sim_time());
        // Time that went back means that the simulation goes on from an earlier state.
        let now = self.physics.time.sim_time;
        let is_due = last.is_none_or(|last| now < last || now >= last + INTERVAL);
        if !is_due {
            return None;
        }
        self.keep_present().err()
    }

    fn keep_present(&mut self) -> Result<(), String> {
        match self.save() {
            Ok(state) => {
                if let Some(history) = &mut self.recording.history {
                    history.push(state);
                }
            }
            Err(error) => {
                self.recording.history = None;
                self.tell_timeline();
                return Err(format!("the last minute is not kept any more: {error}"));
            }
        }
        self.tell_timeline();
        Ok(())
    }

    fn tell_timeline(&self) {
        let nothing = History::default();
        self.recording.history.as_ref().unwrap_or(&nothing).tell(&self.recording.timeline);
    }

    /// Brings the simulation to the kept state whose time is nearest to `time` (s, simulated), from which it goes on;
    /// the time of that state. Later states are kept until it does. Cameras stay where they are: the user looks at the
    /// state through them. See [`restore`](Self::restore).
    ///
    /// # Errors
    /// A sentence when nothing is kept, or the scene has changed since: nothing has changed then.
    pub fn go_to_time(&mut self, time: f64) -> Result<f64, String> {
        if !time.is_finite() {
            return Err(format!("{time} is no time"));
        }
        let sim_time = self.physics.time.sim_time;
        let is_newest = |history: &History| history.states.back().is_none_or(|last| last.sim_time() < sim_time);
        // The present is not lost by looking back.
        if self.recording.history.as_ref().is_some_and(is_newest) && self.check_state().is_ok() {
            self.keep_present()?;
        }
        let Some(history) = &self.recording.history else {
            return Err("no states are kept: switch that on first".into());
        };
        let Some(state) = history.nearest(time) else { return Err("no states are kept yet".into()) };
        self.restore_keeping(&state, true).map_err(|error| error.to_string())?;
        self.recording.jumped = true;
        Ok(state.sim_time())
    }

    /// Whether time has jumped since this was called the last time.
    pub(super) fn take_time_jump(&mut self) -> bool {
        std::mem::take(&mut self.recording.jumped)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;
    use crate::ids::CameraId;
    use crate::sim::shipped::simulation;

    fn poses(simulation: &Simulation) -> Vec<Isometry3<f64>> {
        let scene = simulation.scene();
        scene.bodies.iter().map(|body| body.pose(&scene.world)).collect()
    }

    /// Steps, and the poses after each.
    fn run(simulation: &mut Simulation, steps: u32) -> Vec<Vec<Isometry3<f64>>> {
        let step = |_| {
            simulation.update(0.001).expect("finite");
            assert_eq!(simulation.record_history(), None);
            poses(simulation)
        };
        (0..steps).map(step).collect()
    }

    #[test]
    fn the_past_is_shown_and_gone_on_from_bit_for_bit() {
        let mut simulation = simulation("stack.yaml", true);
        assert!(simulation.go_to_time(0.0).unwrap_err().contains("switch that on"));
        simulation.keep_history(true).expect("savable");
        let first = run(&mut simulation, 1050);
        assert_eq!(simulation.timeline().count(), 11, "0, 0.1, …, 1.0");
        let time = simulation.go_to_time(0.43).expect("kept");
        assert!((time - 0.4).abs() < 1.5e-3, "{time}");
        assert_eq!(simulation.sim_time(), time);
        let step = simulation.sim_step() as usize;
        assert_eq!(poses(&simulation), first[step - 1]);
        assert!(simulation.take_time_jump() && !simulation.take_time_jump());
        // The present is still there, though it was not at a full tenth.
        let (_, last) = simulation.timeline().span().expect("states");
        assert!((last - 1.05).abs() < 1e-9, "{last}");
        assert_eq!(simulation.go_to_time(f64::MAX).expect("kept"), last);
        assert_eq!(poses(&simulation), first[1049]);
        // From an earlier state it does what it did, and what came after is kept anew.
        simulation.go_to_time(0.4).expect("kept");
        assert_eq!(run(&mut simulation, 1050 - step as u32), first[step..]);
        assert!(simulation.timeline().count() <= 12);
        let body = simulation.scene().bodies.ids().last().expect("a body");
        simulation.go_to_time(0.4).expect("kept");
        simulation.remove_body(body).expect("it is there");
        assert!(simulation.go_to_time(0.2).unwrap_err().contains("removed since"), "the scene is another one");
        assert!(simulation.go_to_time(f64::NAN).is_err());
    }

    #[test]
    fn memory_and_time_are_bounded_and_forgotten() {
        let mut simulation = simulation("pendulum.yaml", true);
        simulation.keep_history(true).expect("savable");
        for _ in 0..700 {
            simulation.update(0.1).expect("finite");
            simulation.record_history();
        }
        let (first, last) = simulation.timeline().span().expect("states");
        assert!(last - first <= SPAN + 1e-9 && last - first > SPAN - 0.2, "{first} to {last}");
        let history = simulation.recording.history.as_ref().expect("on");
        assert_eq!(history.bytes, history.states.iter().map(|state| state.size()).sum::<usize>());
        assert!(history.bytes <= MAX_BYTES);
        simulation.keep_history(false).expect("nothing can go wrong");
        assert_eq!(simulation.timeline().span(), None);
        assert_eq!(simulation.record_history(), None);
        assert_eq!(simulation.timeline().count(), 0);
    }

    #[test]
    fn cameras_stay_where_the_user_has_put_them() {
        let mut simulation = simulation("pendulum.yaml", true);
        simulation.keep_history(true).expect("savable");
        run(&mut simulation, 300);
        simulation.physics.scene.cameras[CameraId::new(0)]
            .follow_gesture(crate::scene::CameraGesture::Pan { right: 1.0, up: 0.0 });
        let camera = simulation.physics.scene.cameras[CameraId::new(0)].attached.pose;
        simulation.go_to_time(0.1).expect("kept");
        assert_eq!(simulation.physics.scene.cameras[CameraId::new(0)].attached.pose, camera);
    }

    #[test]
    fn scenes_that_are_not_savable_say_so() {
        let mut simulation = simulation("pendulum.yaml", false);
        let why = simulation.keep_history(true).unwrap_err();
        assert!(why.contains("savable"), "{why}");
        assert_eq!(simulation.timeline().span(), None);
    }
}
