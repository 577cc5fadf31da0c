//! The simulation: one iteration, its clock, and the thread that repeats it.

mod cap;
mod commands;
mod devices;
mod history;
mod iteration;
mod models;
mod pace;
mod plugins;
mod runner;
mod saved;
mod statistics;
mod stepper;
mod targets;
mod window;

pub use crate::bullet::StateError;
pub use history::Timeline;
pub use models::{AddedModel, ModelError, Models, ANSWER_TIMEOUT};
pub use runner::{Control, Event, Runner, RunnerOptions};
pub use saved::SavedState;
pub use stepper::{Stepper, StepperState, StepperWindow};
pub use window::{Picked, WindowAnswer, WindowLink, WindowRequest};

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use nalgebra::Vector3;
use thiserror::Error;

use crate::bullet::{BodyHandle, EnergyLedger, PlausibleBounds, SolverStatistics};
use crate::comm::{Hub, Snapshot, Timing, Wrench};
use crate::plugin::run::Plugins;
use crate::scene::Scene;
use cap::SubStepCap;
use commands::Link;
use devices::Devices;
use history::Recording;
use models::ModelRequests;
use plugins::PluginState;
use targets::ActiveTargets;
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
    /// What the body was last told.
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

struct Joined<'a>(&'a Option<String>);

impl fmt::Display for Joined<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.as_ref().map_or(Ok(()), |joint| write!(f, " (joint `{joint}`)"))
    }
}

/// A scene in time. It owns the Bullet world and all objects; one thread steps it.
pub struct Simulation {
    /// Before the scene, so that they are closed before it goes.
    plugins: Option<Box<Plugins>>,
    plugin_state: PluginState,
    scene: Scene,
    sub_step: f64,
    bounds: PlausibleBounds,
    cap: SubStepCap,
    sim_time: f64,
    /// Interval before the present one, s: what object updates, controllers and plugins get.
    dt: f64,
    interval: f64,
    iteration: u64,
    lost_time: f64,
    /// Sub-steps that the latest update should have done.
    due: u32,
    bullet_time: Duration,
    /// When the latest update was; taken where somebody listens.
    stamp: Option<SystemTime>,
    joint_buffer: Vec<f64>,
    wrenches: Vec<Wrench>,
    link: Option<Link>,
    requests: Option<ModelRequests>,
    window: Option<Window>,
    picking: Picking,
    targets: ActiveTargets,
    recording: Recording,
    /// Input devices, if there are any.
    devices: Option<Box<Devices>>,
    /// Sentences about commands that name what is not there.
    notices: Vec<String>,
}

impl Simulation {
    /// A simulation of `scene` at time zero in sub-steps of `sub_step` s.
    pub fn new(scene: Scene, sub_step: f64) -> Self {
        let wrenches = if scene.has_feedback { vec![Wrench::default(); scene.bodies.len()] } else { Vec::new() };
        let mut targets = ActiveTargets::default();
        targets.reserve(&scene);
        let (wanted, usual) = (&scene.description.physics, PlausibleBounds::default());
        let bounds = PlausibleBounds {
            speed: wanted.largest_speed.unwrap_or(usual.speed),
            distance: wanted.largest_distance.unwrap_or(usual.distance),
        };
        Self {
            plugins: None,
            plugin_state: PluginState::default(),
            sub_step,
            bounds,
            cap: SubStepCap::new(scene.max_sub_steps),
            sim_time: 0.0,
            dt: 0.0,
            interval: 0.0,
            iteration: 0,
            lost_time: 0.0,
            due: 0,
            bullet_time: Duration::ZERO,
            stamp: None,
            joint_buffer: vec![0.0; scene.world.constraints().len()],
            wrenches,
            link: None,
            requests: None,
            window: None,
            picking: Picking::default(),
            targets,
            recording: Recording::default(),
            devices: None,
            notices: Vec::new(),
            scene,
        }
    }

    /// Makes the hub through which others see the states and leave commands.
    pub fn connect(&mut self) -> Arc<Hub> {
        let hub = Arc::new(Hub::new(self.scene.objects()));
        self.link = Some(Link::new(Arc::clone(&hub), &self.scene, &self.wrenches));
        hub
    }

    /// All objects.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Simulated time: sum of all intervals, s. Resets leave it alone.
    pub fn sim_time(&self) -> f64 {
        self.sim_time
    }

    /// Iterations that stepped.
    pub fn sim_step(&self) -> u32 {
        // Wraps like the counter on the wire.
        self.iteration as u32
    }

    /// Simulated seconds that were never integrated because of the cap on sub-steps.
    pub fn lost_time(&self) -> f64 {
        self.lost_time
    }

    /// Time spent inside Bullet's step.
    pub fn bullet_time(&self) -> Duration {
        self.bullet_time
    }

    /// Takes what the solver did since this was called the last time; see
    /// [`World::take_statistics`](crate::bullet::World::take_statistics).
    pub fn take_solver_statistics(&mut self) -> SolverStatistics {
        self.scene.world.take_statistics()
    }

    /// Switches the energy ledger on, with all sums at 0, or off; see
    /// [`World::set_energy_ledger`](crate::bullet::World::set_energy_ledger).
    pub fn set_energy_ledger(&mut self, enabled: bool) {
        self.scene.world.set_energy_ledger(enabled);
    }

    /// The energy ledger after the latest update; all 0 while it is off.
    pub fn energy(&self) -> EnergyLedger {
        self.scene.world.energy()
    }

    /// Force and torque of feedback joints on each body in its inertial frame; empty when no joint has feedback.
    pub fn wrenches(&self) -> &[Wrench] {
        &self.wrenches
    }

    /// Sums the reactions of all joints with feedback on their bodies, each in the body's inertial frame.
    fn estimate_efforts(&mut self) {
        self.wrenches.fill(Wrench::default());
        let Scene { joints, bodies, world, .. } = &mut self.scene;
        for joint in joints.iter_mut().filter(|joint| joint.feedback) {
            let Some(reaction) = joint.handle.and_then(|handle| world.joint_wrench(handle)) else { continue };
            let mut local = |body: usize, force: &Vector3<f64>, torque: &Vector3<f64>| {
                let to_body = world.pose(bodies[body].handle).map(|pose| pose.rotation.inverse()).unwrap_or_default();
                let wrench = &mut self.wrenches[body];
                wrench.force += to_body * force;
                wrench.torque += to_body * torque;
                (to_body * force, to_body * torque)
            };
            let (force, torque) = local(joint.parent, &reaction.force_a, &reaction.torque_a);
            local(joint.child, &reaction.force_b, &reaction.torque_b);
            joint.estimate_effort(&force, &torque);
        }
    }

    fn check_state(&self) -> Result<(), LostState> {
        if let Some((handle, _)) = self.scene.world.soft_first_non_finite() {
            let soft = self.scene.soft_bodies.iter().find(|soft| soft.handle == handle);
            return Err(LostState {
                body: soft.map(|soft| soft.identity.key()).unwrap_or_default(),
                loss: Loss::NonFinite,
                joint: None,
                step: self.sim_step(),
                command: "none".into(),
            });
        }
        let Some(index) = self.scene.world.first_lost(&self.bounds) else { return Ok(()) };
        let body = &self.scene.bodies[index];
        let holds = |joint: &&crate::scene::Joint| joint.parent == index || joint.child == index;
        Err(LostState {
            body: body.identity.key(),
            loss: self.loss_of(body.handle),
            joint: self.scene.joints.iter().find(holds).map(|joint| joint.name.clone()),
            step: self.sim_step(),
            command: self.last_command(index).unwrap_or_else(|| "none".into()),
        })
    }

    fn loss_of(&self, body: BodyHandle) -> Loss {
        let PlausibleBounds { speed: fastest, distance: farthest } = self.bounds;
        let (linear, angular) = self.scene.world.velocity(body).unwrap_or_default();
        let pose = self.scene.world.pose(body).unwrap_or_default();
        let (speed, distance) = (linear.norm().max(angular.norm()), pose.translation.vector.norm());
        if !(speed + distance).is_finite() {
            Loss::NonFinite
        } else if speed > fastest {
            Loss::TooFast { speed, bound: fastest }
        } else {
            Loss::TooFar { distance, bound: farthest }
        }
    }

    /// What a body was last told through the hub, in words; else what was told a joint of it.
    fn last_command(&self, body: usize) -> Option<String> {
        let link = self.link.as_ref()?;
        self.commanders(body).find_map(|commander| {
            let command = link.last_command(commander)?;
            let whose = |text: String| format!("{text} to `{}`", self.scene.bodies[commander].identity.key());
            Some(if commander == body { command } else { whose(command) })
        })
    }

    /// Bodies whose commands reach a body: itself, then those of whose active joints one holds it.
    pub fn commanders(&self, body: usize) -> impl Iterator<Item = usize> + '_ {
        let scene = &self.scene;
        let holds = move |&joint: &usize| scene.joints[joint].parent == body || scene.joints[joint].child == body;
        let others = (0..scene.bodies.len()).filter(move |&other| other != body);
        std::iter::once(body).chain(others.filter(move |&other| scene.active_joints(other).iter().any(holds)))
    }

    /// Returns every rigid body to its initial pose at rest. Time goes on. If the state was lost, controllers forget
    /// what they remember of it and motors are switched off.
    pub fn reset_bodies(&mut self) {
        let was_sound = self.check_state().is_ok();
        let Scene { bodies, joints, world, .. } = &mut self.scene;
        bodies.iter().for_each(|body| body.reset(world));
        if !was_sound {
            world.recover();
            // A motor may have been told a speed that is not finite.
            joints.iter().for_each(|joint| joint.stop_motor(world));
            self.release_drives();
            self.reset_controllers();
        }
        self.scene.vehicles.iter_mut().for_each(|vehicle| vehicle.reset(&mut self.scene.world));
        self.scene.place_wheels();
        self.scene.sensors.iter_mut().for_each(crate::scene::Sensor::reset);
        self.scene.world.refresh_constraints();
        self.scene.observe_joints(0.0, &mut self.joint_buffer);
        self.reset_devices();
    }

    fn reset_controllers(&mut self) {
        for joint in &mut self.scene.joints {
            joint.controller.reset();
            joint.target.reset();
        }
        for body in self.scene.bodies.iter_mut() {
            body.controller.reset();
            body.target.reset();
        }
    }

    /// Returns every object to its initial state and tells all plugins. Time goes on; commands stay in force. The
    /// accurate profile also clears the memory of controllers.
    pub fn reset_world(&mut self) {
        self.reset_bodies();
        self.scene.reset_placed();
        self.scene.soft_bodies.iter().for_each(|soft| soft.reset(&mut self.scene.world));
        if self.scene.profile == crate::control::Profile::Accurate {
            self.reset_controllers();
        }
        self.reset_plugins();
    }

    /// [`reset_world`](Self::reset_world) after which nothing is left of what was before: actuators let go, motors are
    /// off, controllers, solver and contacts forget. Time and commands go on.
    pub fn reset_thoroughly(&mut self) {
        for actuator in 0..self.scene.actuators.len() {
            self.scene.command_actuator(actuator, &crate::comm::ActuatorCommand::default());
        }
        let Scene { joints, world, .. } = &mut self.scene;
        joints.iter().for_each(|joint| joint.stop_motor(world));
        self.release_drives();
        self.reset_world();
        self.reset_controllers();
        self.scene.world.recover();
    }

    /// Takes the sentences about commands that name what is not there, and what plugins have to say.
    pub fn take_notices(&mut self) -> Vec<String> {
        self.hear_plugins();
        std::mem::take(&mut self.notices)
    }

    /// The state of everything at this moment, for those who step the simulation themselves. It allocates.
    pub fn snapshot(&self) -> Snapshot {
        let mut snapshot = self.scene.snapshot(&self.wrenches);
        self.fill(&mut snapshot, 0.0, Timing::default());
        snapshot
    }

    fn fill(&self, snapshot: &mut Snapshot, wall_time: f64, timing: Timing) {
        let scene = &self.scene;
        snapshot.stamp = self.stamp.unwrap_or_else(SystemTime::now);
        snapshot.sim_step = self.sim_step();
        snapshot.wall_time = wall_time;
        snapshot.sim_time = self.sim_time;
        snapshot.timing = Timing { lost_time: self.lost_time, sub_step_cap: self.cap.get(), ..timing };
        scene.world.read_bodies(&mut snapshot.bodies);
        snapshot.wrenches.copy_from_slice(&self.wrenches);
        for (i, joint) in scene.joints.iter().enumerate() {
            snapshot.joint_positions[i] = joint.position;
            snapshot.joint_velocities[i] = joint.velocity;
            snapshot.joint_efforts[i] = joint.effort;
        }
        scene.fill_elements(snapshot);
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
