//! The simulation: one iteration, its clock, and the thread that repeats it.

mod backlog;
mod commands;
mod devices;
mod history;
mod iteration;
mod losses;
mod models;
mod nearness;
mod physics;
mod plugins;
mod recordings;
mod runner;
mod saved;
mod session;
mod slices;
mod statistics;
mod step_pool;
mod stepper;
mod targets;
mod window;

pub use crate::bullet::StateError;
pub use history::Timeline;
pub use losses::LossCause;
pub use models::{AddedModel, ModelError, Models, ANSWER_TIMEOUT};
pub use nearness::Nearness;
pub use recordings::{Beginning, Recordings};
pub use runner::{Control, Event, ReplayEnd, ReplayEnded, ReplayPlan, Runner, RunnerOptions};
pub use saved::SavedState;
pub use session::{
    playback, recorder, CodeError, EarlyEnd, Entry, Feed, Playback, Recorder, ReplayError, Replayed, Replayer,
    StartError, Tap, Unpacker, AHEAD_BYTES, HASH_INTERVAL,
};
pub use slices::request_short_slices;
pub use step_pool::{Batch, StepPool, Stepped, Steps};
pub use stepper::{Stepper, StepperState, StepperWindow};
pub use window::{Picked, WindowAnswer, WindowLink, WindowRequest};

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::bullet::{BodyHandle, EnergyLedger, PlausibleBounds, SolverStatistics, World};
use crate::comm::{Hub, Snapshot, Wrench};
use crate::ids::{BodyId, Table};
use crate::plugin::run::Plugins;
use crate::scene::Scene;
use commands::Link;
use devices::Devices;
use history::Recording;
use models::ModelRequests;
use physics::Physics;
use plugins::PluginState;
use recordings::RecordingRequests;
use window::{Picking, Window};

/// Bullet's internal step unless somebody asks for another: 1 ms, whatever the frequency of the loop.
pub const DEFAULT_SUB_STEP: f64 = 0.001;

/// Error when the state of a body can no longer be what physics made of it. Nothing of that iteration is published.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("the state of body `{body}` {loss} in step {step}{}; last command: {command}", Joined(.joint))]
pub struct LostState {
    /// Qualified identifier of the body.
    pub body: String,
    /// How it was seen.
    pub loss: Loss,
    /// A joint that holds it.
    pub joint: Option<String>,
    /// Iteration in which it was seen.
    pub step: u32,
    /// The newest command of what is nearest to the body, and where it went; "none" without any.
    pub command: String,
}

/// How a state was seen to be lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// A pose or velocity is infinite or not a number.
    NonFinite,
    /// A speed, m/s, or angular speed, rad/s, is above the bound.
    TooFast {
        /// The larger of the two.
        speed: f64,
        /// [`PlausibleBounds::speed`].
        bound: f64,
    },
    /// A body is farther from the origin than the bound, m.
    TooFar {
        /// Distance of the centre of mass.
        distance: f64,
        /// [`PlausibleBounds::distance`].
        bound: f64,
    },
}

impl Loss {
    /// How the state of a body was lost that is not within `bounds`.
    fn of(world: &World, body: BodyHandle, bounds: &PlausibleBounds) -> Self {
        let (linear, angular) = world.velocity(body).unwrap_or_default();
        let pose = world.pose(body).unwrap_or_default();
        let (speed, distance) = (linear.norm().max(angular.norm()), pose.translation.vector.norm());
        if !(speed + distance).is_finite() {
            Self::NonFinite
        } else if speed > bounds.speed {
            Self::TooFast { speed, bound: bounds.speed }
        } else {
            Self::TooFar { distance, bound: bounds.distance }
        }
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NonFinite => write!(f, "became non-finite"),
            Self::TooFast { speed, bound } => {
                write!(f, "became implausible (speed {speed:.1e} m/s or rad/s, `physics / largest speed` is {bound:e})")
            }
            Self::TooFar { distance, bound } => {
                write!(
                    f,
                    "became implausible ({distance:.1e} m from the origin, `physics / largest distance` is {bound:e})"
                )
            }
        }
    }
}

/// A reset that was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Reset {
    Bodies,
    World,
}

struct Joined<'a>(&'a Option<String>);

impl fmt::Display for Joined<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.as_ref().map_or(Ok(()), |joint| write!(f, " (joint `{joint}`)"))
    }
}

/// A scene in time, and everybody who works with it. It owns the Bullet world and all objects; one thread steps it.
///
/// Parts that work on the physics are fields beside it, so that each can borrow it while it is used itself.
pub struct Simulation {
    /// Before the physics, so that they are closed before the scene goes.
    plugins: Option<Box<Plugins>>,
    plugin_state: PluginState,
    physics: Physics,
    link: Option<Link>,
    requests: Option<ModelRequests>,
    /// Of recordings.
    recordings: RecordingRequests,
    window: Option<Window>,
    picking: Picking,
    recording: Recording,
    /// Input devices, if there are any.
    devices: Option<Box<Devices>>,
    /// Sentences about commands that name what is not there.
    notices: Vec<String>,
}

impl Simulation {
    /// A simulation of `scene` at time zero in sub-steps of `sub_step` s.
    pub fn new(scene: Scene, sub_step: f64) -> Self {
        Self {
            plugins: None,
            plugin_state: PluginState::default(),
            physics: Physics::new(scene, sub_step),
            link: None,
            requests: None,
            recordings: RecordingRequests::default(),
            window: None,
            picking: Picking::default(),
            recording: Recording::default(),
            devices: None,
            notices: Vec::new(),
        }
    }

    /// Makes the hub through which others see the states and leave commands.
    pub fn connect(&mut self) -> Arc<Hub> {
        let hub = Arc::new(Hub::new(self.physics.scene.objects()));
        self.link = Some(Link::new(Arc::clone(&hub), &self.physics.scene, &self.physics.wrenches));
        hub
    }

    /// All objects.
    pub fn scene(&self) -> &Scene {
        &self.physics.scene
    }

    /// Simulated time: sum of all intervals, s. Resets leave it alone.
    pub fn sim_time(&self) -> f64 {
        self.physics.time.sim_time
    }

    /// Length of a sub-step, s.
    pub fn sub_step(&self) -> f64 {
        self.physics.sub_step
    }

    /// Iterations that stepped.
    pub fn sim_step(&self) -> u32 {
        self.physics.sim_step()
    }

    /// Simulated seconds that were never integrated because they could not be computed in time.
    pub fn lost_time(&self) -> f64 {
        self.physics.time.lost_time
    }

    /// Measures from now on how much [time](Self::bullet_time) is spent inside Bullet's step. Default: it is not measured.
    pub fn measure_bullet_time(&mut self) {
        self.physics.bullet_time.get_or_insert_default();
    }

    /// Time spent inside Bullet's step since it is [measured](Self::measure_bullet_time).
    pub fn bullet_time(&self) -> Duration {
        self.physics.bullet_time.unwrap_or_default()
    }

    /// Takes what the solver did since this was called the last time; see
    /// [`World::take_statistics`](crate::bullet::World::take_statistics).
    pub fn take_solver_statistics(&mut self) -> SolverStatistics {
        self.physics.scene.world.take_statistics()
    }

    /// Stamps snapshots, and with them all states and pictures that are published, with simulated time since 1970
    /// instead of the system's. Default: the system's.
    pub fn set_simulated_stamps(&mut self, enabled: bool) {
        self.physics.has_simulated_stamps = enabled;
    }

    /// Switches the energy ledger on, with all sums at 0, or off; see
    /// [`World::set_energy_ledger`](crate::bullet::World::set_energy_ledger).
    pub fn set_energy_ledger(&mut self, enabled: bool) {
        self.physics.scene.world.set_energy_ledger(enabled);
    }

    /// The energy ledger after the latest update; all 0 while it is off.
    pub fn energy(&self) -> EnergyLedger {
        self.physics.scene.world.energy()
    }

    /// Force and torque of feedback joints on each body in its inertial frame; empty when no joint has feedback.
    pub fn wrenches(&self) -> &Table<BodyId, Wrench> {
        &self.physics.wrenches
    }

    fn check_state(&self) -> Result<(), LostState> {
        let Physics { scene, bounds, .. } = &self.physics;
        let lost = |body: String, loss, joint, command: Option<String>| {
            let command = command.unwrap_or_else(|| "none".into());
            Err(LostState { body, loss, joint, step: self.sim_step(), command })
        };
        if let Some((handle, _)) = scene.world.soft_first_non_finite() {
            let soft = scene.soft_bodies.iter().find(|soft| soft.handle == handle);
            let command = soft.and_then(|soft| self.last_command(self.nearness_in_model(soft.identity.model)));
            return lost(soft.map(|soft| soft.identity.key()).unwrap_or_default(), Loss::NonFinite, None, command);
        }
        let Some(id) = scene.world.first_lost(bounds).map(BodyId::new) else { return Ok(()) };
        let body = &scene.bodies[id];
        let holds = |joint: &&crate::scene::Joint| joint.parent == id || joint.child == id;
        let joint = scene.joints.iter().find(holds).map(|joint| joint.name.clone());
        let command = self.last_command(self.nearness(id));
        lost(body.identity.key(), Loss::of(&scene.world, body.handle, bounds), joint, command)
    }

    /// The newest command through the hub to the nearest objects that were commanded, in words.
    fn last_command(&self, near: Table<BodyId, Nearness>) -> Option<String> {
        self.link.as_ref()?.last_command(&near, &self.physics.scene)
    }

    /// Returns every rigid body to its initial pose at rest, with the sensors and wheels on it; contacts, solver and
    /// controllers forget. Time goes on, commands stay in force and actuators hold what they hold. A state that was lost
    /// needs a [reset of the world](Self::reset_world), which is done instead.
    pub fn reset_bodies(&mut self) {
        self.reset_bodies_or_lost_world();
    }

    fn reset_bodies_or_lost_world(&mut self) -> Reset {
        if self.check_state().is_err() {
            return self.reset_world_asked(Instant::now());
        }
        self.physics.note(&Entry::ResetBodies {});
        self.physics.reset_bodies();
        self.reset_devices();
        Reset::Bodies
    }

    /// Returns everything to the start, and tells all plugins: what follows is what followed then, bit for bit, if the
    /// same is commanded. Commands that are in force or wait are forgotten, actuators, windows and plugins release what
    /// they hold, motors are off, controllers, solver and contacts forget. Only the clocks go on, and settings stay:
    /// parameters of cameras and lights, gravity that was switched off.
    pub fn reset_world(&mut self) {
        self.reset_world_asked(Instant::now());
    }

    /// [`reset_world`](Self::reset_world) that was asked for at `asked`: commands that came later stay.
    fn reset_world_asked(&mut self, asked: Instant) -> Reset {
        self.forget_commands_before(asked);
        self.physics.note(&Entry::ResetWorld {});
        self.let_go();
        self.release_plugins_before(asked);
        self.physics.reset();
        self.reset_devices();
        self.reset_plugins();
        Reset::World
    }

    /// Takes the sentences about commands that name what is not there, and what plugins have to say.
    pub fn take_notices(&mut self) -> Vec<String> {
        self.hear_plugins();
        std::mem::take(&mut self.notices)
    }

    /// The state of everything at this moment, for those who step the simulation themselves. It allocates.
    pub fn snapshot(&self) -> Snapshot {
        let mut snapshot = self.physics.scene.snapshot(&self.physics.wrenches);
        self.physics.fill(&mut snapshot, 0.0, self.physics.timing());
        snapshot
    }
}

#[cfg(test)]
mod shipped {
    //! Shipped scenes for the tests of this folder.

    use std::path::Path;

    use super::Simulation;
    use crate::scene::{load, SceneFiles, SceneOptions};

    /// A shipped model in the shipped world; `savable` if its states are to be saved.
    pub fn simulation(model: &str, savable: bool) -> Simulation {
        let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
        let files = SceneFiles {
            world: Some(resources.join("world/world.yaml")),
            models: vec![resources.join("models").join(model)],
        };
        let loaded = load(&files, &SceneOptions { savable, ..SceneOptions::default() });
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, 0.001)
    }
}
