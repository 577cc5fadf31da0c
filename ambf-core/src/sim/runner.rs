//! The thread that repeats the iteration in real time.

mod replay;

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{bounded, Receiver, Sender};

use super::backlog::{Backlog, Share};
use super::losses::{processor_time, LossCause, Losses};
use super::slices::request_short_slices;
use super::statistics::StepStatistics;
use super::{LostState, Playback, Reset, Simulation};
use crate::comm::{Activity, Timing};
use crate::device::timing::Pacer;

pub use replay::{ReplayEnd, ReplayEnded, ReplayPlan};

/// How the loop keeps time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunnerOptions {
    /// Iterations a second. Default: 1000.
    pub frequency: f64,
    /// Every interval is `speed_factor / frequency` instead of what the wall clock says. Default: `false`.
    pub fixed_step: bool,
    /// Simulated per real time with fixed steps; ignored otherwise. Default: 1.
    pub speed_factor: f64,
}

impl Default for RunnerOptions {
    fn default() -> Self {
        Self { frequency: 1000.0, fixed_step: false, speed_factor: 1.0 }
    }
}

/// Something worth a line in the log, sent by the physics thread without waiting for anyone.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// Simulated seconds that were not computed since the last such event, and in all. At most one a second.
    LostTime {
        /// Since the event before.
        recent: f64,
        /// Since the start.
        total: f64,
        /// What most of the recent ones were lost to.
        cause: LossCause,
    },
    /// With fixed steps, simulated time does not keep up with the clock: an iteration costs more than its period. Said
    /// once.
    Slow {
        /// Median cost of an iteration, s.
        cost: f64,
        /// Period, s.
        period: f64,
    },
    /// The state was lost; the simulation is paused until it is reset.
    Lost(LostState),
    /// A throttling client asks for steps of no iterations, which throttle nothing.
    EmptySteps,
    /// Objects were reset on request.
    Reset,
    /// A command names what is not there, or a plugin has something to say.
    Notice(String),
}

/// Pause, manual steps and the end of a running simulation, from any thread.
#[derive(Debug)]
pub struct Control {
    stop: AtomicBool,
    paused: AtomicBool,
    manual_steps: AtomicU32,
    /// Bits of f64.
    speed: AtomicU64,
    replay_ended: OnceLock<ReplayEnded>,
}

impl Default for Control {
    fn default() -> Self {
        Self {
            stop: AtomicBool::default(),
            paused: AtomicBool::default(),
            manual_steps: AtomicU32::default(),
            speed: AtomicU64::new(1.0_f64.to_bits()),
            replay_ended: OnceLock::new(),
        }
    }
}

impl Control {
    /// Pauses or resumes. Paused time does not count as simulated time.
    pub fn set_paused(&self, paused: bool) {
        self.paused.store(paused, Ordering::Release);
    }

    /// Whether it is paused.
    pub fn is_paused(&self) -> bool {
        self.paused.load(Ordering::Acquire)
    }

    /// Lets `steps` iterations through while paused.
    pub fn step(&self, steps: u32) {
        self.manual_steps.fetch_add(steps, Ordering::AcqRel);
    }

    /// Factor on simulated time per real time, over what [`RunnerOptions`] say; 1 at the start.
    pub fn speed(&self) -> f64 {
        f64::from_bits(self.speed.load(Ordering::Acquire))
    }

    /// Changes [`speed`](Self::speed); what is not finite or not above 0 changes nothing.
    pub fn set_speed(&self, factor: f64) {
        if factor.is_finite() && factor > 0.0 {
            self.speed.store(factor.to_bits(), Ordering::Release);
        }
    }

    /// How the replay of a recording has ended; `None` while it goes on, and without one.
    pub fn replay_ended(&self) -> Option<&ReplayEnded> {
        self.replay_ended.get()
    }

    fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    /// Takes one of the iterations that [`step`](Self::step) lets through; false if there is none.
    pub fn take_manual_step(&self) -> bool {
        let one_less = |n: u32| n.checked_sub(1);
        self.manual_steps.fetch_update(Ordering::AcqRel, Ordering::Acquire, one_less).is_ok()
    }
}

/// A simulation that runs in a thread of its own.
pub struct Runner {
    control: Arc<Control>,
    events: Receiver<Event>,
    thread: Option<JoinHandle<Simulation>>,
}

/// Events that may wait; more are dropped: the log is not worth a stalled simulation.
const EVENTS: usize = 64;
/// Periods that the loop may be behind and still catch up: what a preempted iteration costs on a busy computer.
const MAX_LAG: u32 = 10;
/// How often a paused loop looks around.
const PAUSED_PERIOD: Duration = Duration::from_millis(1);

impl Runner {
    /// Starts stepping `simulation`.
    pub fn start(simulation: Simulation, options: RunnerOptions) -> Self {
        Self::start_loop(simulation, options, None)
    }

    /// Starts with the replay of a recording, whose scene `simulation` is, where the recording begins. When it is over or
    /// left, it goes on as `options` say; see [`Control::replay_ended`].
    pub fn replay(simulation: Simulation, options: RunnerOptions, playback: Playback, plan: ReplayPlan) -> Self {
        Self::start_loop(simulation, options, Some((playback, plan)))
    }

    fn start_loop(simulation: Simulation, options: RunnerOptions, replayed: Option<(Playback, ReplayPlan)>) -> Self {
        let control = Arc::new(Control::default());
        let (sender, events) = bounded(EVENTS);
        let loop_control = Arc::clone(&control);
        let thread = std::thread::Builder::new()
            .name("physics".into())
            .spawn(move || {
                let mut physics = PhysicsLoop::new(simulation, options, loop_control, sender);
                if let Some((playback, plan)) = replayed {
                    physics.replay(playback, plan);
                }
                physics.run()
            })
            .expect("a thread can be started: nothing runs without it");
        Self { control, events, thread: Some(thread) }
    }

    /// Pause and manual steps.
    pub fn control(&self) -> &Arc<Control> {
        &self.control
    }

    /// What the physics thread has to say.
    pub fn events(&self) -> &Receiver<Event> {
        &self.events
    }

    /// Ends the thread and returns the simulation; `None` if it panicked.
    pub fn stop(mut self) -> Option<Simulation> {
        self.end()
    }

    fn end(&mut self) -> Option<Simulation> {
        self.control.stop.store(true, Ordering::Release);
        let thread = self.thread.take()?;
        thread.thread().unpark();
        thread.join().ok()
    }
}

impl Drop for Runner {
    fn drop(&mut self) {
        self.end();
    }
}

struct PhysicsLoop {
    simulation: Simulation,
    options: RunnerOptions,
    control: Arc<Control>,
    events: Sender<Event>,
    start: Instant,
    backlog: Backlog,
    was_paused: bool,
    /// The pause was made because the state was lost.
    lost: bool,
    /// The pause was made because a replay has ended.
    replay_paused: bool,
    statistics: StepStatistics,
    throttle_counter: u32,
    losses: Losses,
    /// It was said that fixed steps are slower than the clock.
    told_slow: bool,
}

impl PhysicsLoop {
    fn new(mut simulation: Simulation, options: RunnerOptions, control: Arc<Control>, events: Sender<Event>) -> Self {
        // It tells which part of the cost of an iteration further sub-steps have.
        simulation.measure_bullet_time();
        let backlog =
            Backlog::new(1.0 / options.frequency, simulation.physics.sub_step, simulation.physics.scene.max_sub_steps);
        Self {
            simulation,
            options,
            control,
            events,
            start: Instant::now(),
            backlog,
            was_paused: false,
            lost: false,
            replay_paused: false,
            statistics: StepStatistics::default(),
            throttle_counter: 0,
            losses: Losses::default(),
            told_slow: false,
        }
    }

    fn run(mut self) -> Simulation {
        self.simulation.wait_in_this_thread();
        self.simulation.set_nominal_frequency(self.options.frequency);
        request_short_slices();
        let mut pacer = Pacer::new(Duration::from_secs_f64(1.0 / self.options.frequency), MAX_LAG);
        while !self.control.is_stopping() {
            // A pause after it has been resumed is another one.
            self.replay_paused &= self.control.is_paused();
            if let Some(reset) = self.simulation.do_requested_resets() {
                if reset == Reset::World {
                    self.simulation.begin_waiting_recording();
                }
                self.resume_after_reset(Ok(()));
            }
            self.serve_changes();
            self.obey_plugins();
            self.simulation.pause_devices(self.control.is_paused());
            if self.control.is_paused() && !self.control.take_manual_step() {
                self.was_paused = true;
                self.simulation.tell_activity(Activity::Paused);
                std::thread::sleep(PAUSED_PERIOD);
                continue;
            }
            self.simulation.tell_activity(Activity::Runs);
            if let Err(problem) = self.iterate() {
                self.pause_lost(problem);
            }
            match self.is_urgent() {
                true => pacer.skip(),
                false => pacer.wait(),
            }
        }
        self.simulation.pause_devices(true);
        self.simulation
    }

    /// Whether the next iteration follows at once: with fixed steps a client that orders them gets them as fast as they
    /// can be made; otherwise time that is due is caught up.
    fn is_urgent(&self) -> bool {
        match self.options.fixed_step {
            true => self.simulation.is_stepped_by_orders(),
            false => self.backlog.is_behind(),
        }
    }

    /// One iteration, if its interval is above 0. It ends early when the state is lost.
    fn iterate(&mut self) -> Result<(), LostState> {
        let begin = Instant::now();
        let interval = self.choose_interval(begin);
        if interval <= 0.0 {
            return Ok(());
        }
        let (bullet_before, processor_before) = (self.simulation.bullet_time(), processor_time());
        self.simulation.advance(interval)?;
        self.report_loss(begin);
        let stepped = begin.elapsed();
        if self.simulation.is_held_by_clients() && self.simulation.sim_step() == 1 {
            // Held from the start: clients have to see what there is.
            self.publish(self.start.elapsed());
        }
        let changing_before = self.losses.changing();
        let held = Instant::now();
        self.hold_for_clients()?;
        let resumed = Instant::now();
        self.losses.hold(resumed - held, changing_before);
        let (wall, timing) = (resumed - self.start, self.timing());
        self.simulation.exchange(|simulation| {
            simulation.publish(wall.as_secs_f64(), timing);
            simulation.note_published();
        })?;
        if let Some(why) = self.simulation.record_history() {
            self.tell(Event::Notice(why));
        }
        self.tell_notices();
        let cost = stepped + resumed.elapsed();
        self.statistics.record(wall, cost);
        if timing.is_slow() && !std::mem::replace(&mut self.told_slow, true) {
            self.tell(Event::Slow { cost: timing.step_cost[0], period: timing.allowed_cost });
        }
        if !self.options.fixed_step {
            let sub_steps = self.simulation.bullet_time() - bullet_before;
            let other = cost.saturating_sub(sub_steps);
            self.backlog.learn(self.simulation.physics.time.due, sub_steps.as_secs_f64(), other.as_secs_f64());
        }
        self.losses.compute(processor_time().saturating_sub(processor_before));
        Ok(())
    }

    /// Does the changes that clients, plugins and windows asked for; true if there were any.
    fn serve_changes(&mut self) -> bool {
        let begin = Instant::now();
        let changed = self.simulation.do_requested_changes();
        if changed {
            self.show_changes();
        }
        if changed {
            self.losses.change(begin.elapsed());
        }
        changed
    }

    /// What plugins ask of the loop, and what they have to say while nothing moves.
    fn obey_plugins(&mut self) {
        let (pause, steps) = self.simulation.take_plugin_requests();
        if let Some(pause) = pause {
            self.control.set_paused(pause);
        }
        if steps > 0 {
            self.control.step(steps);
        }
        self.tell_notices();
    }

    fn tell_notices(&mut self) {
        for notice in self.simulation.take_notices() {
            self.tell(Event::Notice(notice));
        }
    }

    fn pause_lost(&mut self, problem: LostState) {
        self.simulation.tell_lost(Some(&problem));
        self.control.set_paused(true);
        self.simulation.pause_devices(true);
        self.lost = true;
        self.tell(Event::Lost(problem));
    }

    /// Interval of this iteration, s: what the wall clock is ahead, or a part of it; or fixed. The first one after a
    /// pause is one period.
    fn choose_interval(&mut self, now: Instant) -> f64 {
        let speed = self.control.speed();
        if self.options.fixed_step {
            return speed * self.options.speed_factor / self.options.frequency;
        }
        let wall = (now - self.start).as_secs_f64();
        match std::mem::take(&mut self.was_paused) {
            true => self.losses.skip(self.backlog.restart(wall)),
            false => self.backlog.pass(wall, speed),
        }
        // A client that throttles counts iterations: one has to take all the time for which it was held.
        let Share { interval, lost } = match self.simulation.is_throttled() {
            true => self.backlog.take_all(),
            false => self.backlog.take(),
        };
        self.simulation.physics.lose_time(lost);
        interval
    }

    /// Blocks while clients throttle. Resets and requests about models are honoured meanwhile. The state may be lost in the
    /// update that follows a reset.
    fn hold_for_clients(&mut self) -> Result<(), LostState> {
        loop {
            let (control, simulation) = (&self.control, &self.simulation);
            simulation.wait_for_clients(|| {
                control.is_stopping() || simulation.reset_is_requested() || simulation.change_is_requested()
            });
            if self.control.is_stopping() {
                break;
            }
            let (was_reset, outcome) = self.simulation.do_requested_resets_at_rest();
            if was_reset {
                self.resume_after_reset(outcome.clone());
                outcome?;
            }
            if !(self.serve_changes() || was_reset || self.simulation.is_held_by_clients()) {
                break;
            }
        }
        if self.simulation.count_for_clients(&mut self.throttle_counter) {
            self.tell(Event::EmptySteps);
        }
        Ok(())
    }

    fn publish(&mut self, wall: Duration) {
        self.simulation.publish(wall.as_secs_f64(), self.timing());
    }

    /// What was changed is seen at once, also while paused or throttled. A time that was gone to is where the clock is
    /// followed from.
    fn show_changes(&mut self) {
        if self.simulation.take_time_jump() {
            self.was_paused = true;
            if std::mem::take(&mut self.lost) {
                // That state is not lost. The simulation stays paused until its user lets it go on.
                self.simulation.tell_lost(None);
            }
        }
        self.publish(self.start.elapsed());
    }

    /// A reset is seen at once, also while paused or throttled, unless the state was lost again. It ends the pause that a lost
    /// state or the end of a replay made.
    fn resume_after_reset(&mut self, outcome: Result<(), LostState>) {
        if outcome.is_ok() {
            self.publish(self.start.elapsed());
        }
        if std::mem::take(&mut self.lost) | std::mem::take(&mut self.replay_paused) {
            self.simulation.tell_lost(None);
            self.control.set_paused(false);
            self.simulation.tell_activity(Activity::Runs);
        }
        self.simulation.note_reset();
        self.tell(Event::Reset);
    }

    fn timing(&self) -> Timing {
        let mut timing = self.simulation.physics.timing();
        timing.physics_frequency = self.statistics.frequency;
        timing.step_cost = self.statistics.percentiles;
        if self.options.fixed_step {
            timing.allowed_cost = 1.0 / self.options.frequency;
        } else {
            timing.sub_step_cap = self.backlog.cap();
        }
        timing
    }

    /// Says what was lost until `now`, the beginning of this iteration, whose interval leaves it out.
    fn report_loss(&mut self, now: Instant) {
        let total = self.simulation.lost_time();
        let wall = (now - self.start).as_secs_f64();
        if let Some((recent, cause)) = self.losses.report(wall, total, self.control.speed()) {
            self.tell(Event::LostTime { recent, total, cause });
        }
    }

    fn tell(&self, event: Event) {
        // A full queue means that nobody reads: the event is dropped.
        let _ = self.events.try_send(event);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::ids::CameraId;
    use crate::scene::{load, SceneFiles, SceneOptions};
    use crate::sim::{Simulation, WindowRequest};

    /// A running simulation of a pendulum, its hub and its window.
    fn running(fixed_step: bool) -> (Runner, Arc<crate::comm::Hub>, crate::sim::WindowLink) {
        let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
        let files = SceneFiles {
            world: Some(resources.join("world/world.yaml")),
            models: vec![resources.join("models/pendulum.yaml")],
        };
        let loaded = load(&files, &SceneOptions::default());
        let mut simulation = Simulation::new(loaded.scene, 0.001);
        let hub = simulation.connect();
        hub.set_listening();
        let link = simulation.window_link();
        (Runner::start(simulation, RunnerOptions { fixed_step, ..RunnerOptions::default() }), hub, link)
    }

    fn time(hub: &crate::comm::Hub) -> f64 {
        hub.snapshot().as_ref().map_or(0.0, |snapshot| snapshot.sim_time)
    }

    fn wait(what: &str, is_there: impl Fn() -> bool) {
        let begin = Instant::now();
        while !is_there() {
            assert!(begin.elapsed() < Duration::from_secs(20), "{what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    #[test]
    fn the_speed_is_a_factor_on_simulated_time_and_the_clock_is_followed_again_at_1() {
        for fixed_step in [false, true] {
            let (runner, hub, _) = running(fixed_step);
            wait("it runs", || time(&hub) > 0.05);
            let speed = |factor: f64| {
                runner.control().set_speed(factor);
                std::thread::sleep(Duration::from_millis(100));
                let (begin, before) = (Instant::now(), time(&hub));
                std::thread::sleep(Duration::from_millis(400));
                (time(&hub) - before) / begin.elapsed().as_secs_f64()
            };
            // On a busy machine a loop with fixed steps may be slower than asked for, never faster.
            let slow = speed(0.02);
            assert!(slow > 0.002 && slow < 0.03, "fixed {fixed_step}: {slow}");
            runner.control().set_speed(f64::NAN);
            assert_eq!(runner.control().speed(), 0.02);
            let usual = speed(1.0);
            assert!(usual > 3.0 * slow && usual < 1.3, "fixed {fixed_step}: {usual}");
        }
    }

    #[test]
    fn row_66_a_window_moves_cameras_while_the_simulation_is_paused() {
        let (runner, hub, link) = running(true);
        wait("it runs", || time(&hub) > 0.01);
        runner.control().set_paused(true);
        std::thread::sleep(Duration::from_millis(50));
        let (before, step) =
            hub.snapshot().as_ref().map(|s| (s.cameras[CameraId::new(0)], s.sim_step)).expect("a snapshot");
        let gesture = crate::scene::CameraGesture::Pan { right: 1.0, up: 0.0 };
        link.post(WindowRequest::MoveCamera { camera: CameraId::new(0), gesture }).expect("there is room");
        let now = || hub.snapshot().as_ref().map(|s| (s.cameras[CameraId::new(0)], s.sim_step)).expect("a snapshot");
        wait("the camera has moved", || now().0 != before);
        assert!((before.inverse() * now().0).translation.y > 0.999);
        assert_eq!(now().1, step, "no step was made");
    }
}
