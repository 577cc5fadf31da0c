//! Making a recorded motion again.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use nalgebra::Isometry3;
use thiserror::Error;

use super::hash::StateHash;
use super::Entry;
use crate::adf::{self, InputDevices, ObjectType};
use crate::bullet::StateError;
use crate::comm::RigidBodyCommand;
use crate::device::host::{quantity, CameraSum, Controls, Hand, StandIn};
use crate::device::law::{GainChange, Switches, UNKNOWN_OPENING};
use crate::ids::{ActuatorId, BodyId, CameraId, JointId, LightId, SoftBodyId, VehicleId, VolumeId};
use crate::plugin::{CommandError, ObjectId};
use crate::scene::{ParameterChange, PreparedModel, StateChange};
use crate::sim::physics::Time;
use crate::sim::{LostState, SavedState, Simulation};

/// Why a recording cannot be replayed, or not further.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// Error when the motion is another one: another build, another processor, files that have changed.
    #[error(
        "the replay differs from the recording: after iteration {iteration} (simulated time {sim_time} s) the state has the hash {found:016x}, \
         recorded was {expected:016x}; {}", since(.same)
    )]
    Differs {
        /// The last update after which the states were seen to be the same; 0: none.
        same: u64,
        /// The first after which they were seen to differ.
        iteration: u64,
        /// Simulated time of that, s.
        sim_time: f64,
        /// Hash in the recording.
        expected: u64,
        /// Hash of the replay.
        found: u64,
    },
    /// Error when updates are not counted as in the recording: entries are missing.
    #[error("the recording goes on with iteration {found} after {last}: entries are missing")]
    Gap {
        /// Updates that were made.
        last: u64,
        /// Number of the next one.
        found: u64,
    },
    /// Error when an entry is about something that is not in the scene.
    #[error("the recording is about {what} {index}, which is not in the scene: is it made of the same files?")]
    NoObject {
        /// What.
        what: &'static str,
        /// Which one.
        index: usize,
    },
    /// Error when an entry holds numbers that cannot have been recorded.
    #[error("the recording holds {0} that is not finite or out of range: it is corrupt")]
    Number(&'static str),
    /// Error when a plugin's command fails: recorded are those that were executed.
    #[error("a plugin's command fails that was executed when it was recorded: {command}: {error}")]
    Plugin {
        /// What was commanded.
        command: String,
        /// Why it fails.
        error: CommandError,
    },
    /// Error when a file that was used while it was recorded is of no use.
    #[error("{0}")]
    File(String),
    /// Error when the simulation went back to a state that cannot be saved here.
    #[error("the simulation went back to an earlier state: {0}")]
    State(#[from] StateError),
    /// Error when the state to go back to was not saved before.
    #[error("the simulation went back to entry {0}, which is not before this one: the recording is corrupt")]
    NoState(u64),
    /// Error when the recording does not begin with its beginning, or begins twice.
    #[error("the recording {0}")]
    Start(&'static str),
}

/// Most that can have been lost at once, s: a computer that slept for a year.
const MAX_LOSS: f64 = 366.0 * 86400.0;

fn since(same: &u64) -> String {
    match *same {
        0 => "it was not checked before".into(),
        same => format!("after iteration {same} both were the same"),
    }
}

/// What an entry did.
#[derive(Debug, Clone, PartialEq)]
pub enum Replayed {
    /// An update was made.
    Update,
    /// An update was made, after which the state was lost, as it was when it was recorded.
    Lost(LostState),
    /// The state was compared with the recorded one, and is the same.
    Checked,
    /// Somebody had noted something.
    Note(String),
    /// Something else.
    Changed,
}

/// A model that an entry adds, read beforehand; or why its file is of no use.
pub(super) type Prepared = Result<PreparedModel, String>;

/// Reads the files of a model that `entry` adds; `None`: it adds none. Takes as long as that takes, and needs no simulation.
pub(super) fn prepared(entry: &Entry<'_>) -> Option<Box<Prepared>> {
    match entry {
        Entry::AddModel { file } => Some(Box::new(PreparedModel::read(Path::new(file)))),
        _ => None,
    }
}

/// Lets a simulation do what was recorded.
pub struct Replayer {
    /// Entries before which the state is saved, because the simulation goes back there later.
    restored: HashSet<u64>,
    saved: HashMap<u64, SavedState>,
    position: u64,
    devices: Vec<(StandIn, Hand)>,
    controls: Arc<Controls>,
    hash: StateHash,
    same: u64,
}

impl Replayer {
    /// For a recording whose [`Entry::Restore`]s have the positions `restored`.
    pub fn new(restored: impl IntoIterator<Item = u64>) -> Self {
        Self {
            restored: restored.into_iter().collect(),
            saved: HashMap::new(),
            position: 0,
            devices: Vec::new(),
            controls: Arc::new(Controls::new(Switches::default())),
            hash: StateHash::default(),
            same: 0,
        }
    }

    /// Does what `entry`, the next of the recording, says. The simulation must be of the same files and options, fresh at
    /// the first entry, and nobody else may do anything to it.
    ///
    /// # Errors
    /// [`ReplayError`]. After [`ReplayError::Differs`] the replay can go on, of what is another motion now; after others
    /// it cannot.
    pub fn apply(&mut self, simulation: &mut Simulation, entry: &Entry<'_>) -> Result<Replayed, ReplayError> {
        self.apply_prepared(simulation, entry, prepared(entry))
    }

    /// [`apply`](Self::apply), with what [`prepared`] gave for the entry: reads no model files.
    pub(super) fn apply_prepared(
        &mut self,
        simulation: &mut Simulation,
        entry: &Entry<'_>,
        prepared: Option<Box<Prepared>>,
    ) -> Result<Replayed, ReplayError> {
        if self.restored.contains(&self.position) {
            self.saved.insert(self.position, simulation.save()?);
        }
        match (self.position, matches!(entry, Entry::Start { .. })) {
            (0, false) => return Err(ReplayError::Start("has no beginning")),
            (1.., true) => return Err(ReplayError::Start("begins twice")),
            _ => (),
        }
        self.position += 1;
        self.execute(simulation, entry, prepared)
    }

    fn execute(
        &mut self,
        simulation: &mut Simulation,
        entry: &Entry<'_>,
        prepared: Option<Box<Prepared>>,
    ) -> Result<Replayed, ReplayError> {
        let check = Check(simulation);
        match entry {
            Entry::Start { iteration, sim_time, lost_time, attachments } => {
                simulation.plugin_state.next_attachment = *attachments;
                finite("a time", [*sim_time, *lost_time])?;
                let (iteration, sim_time, lost_time) = (*iteration, *sim_time, *lost_time);
                simulation.physics.time = Time { iteration, sim_time, lost_time, ..Time::default() };
            }
            Entry::Update { iteration, interval } => {
                let last = simulation.physics.time.iteration;
                if last.checked_add(1) != Some(*iteration) {
                    return Err(ReplayError::Gap { last, found: *iteration });
                }
                if !(interval.is_finite() && *interval > 0.0) {
                    return Err(ReplayError::Number("an interval"));
                }
                return Ok(match simulation.update(*interval) {
                    Ok(()) => Replayed::Update,
                    Err(lost) => Replayed::Lost(lost),
                });
            }
            Entry::LoseTime { seconds } => {
                if !(0.0..=MAX_LOSS).contains(seconds) {
                    return Err(ReplayError::Number("a time that was lost"));
                }
                simulation.physics.lose_time(*seconds);
            }
            Entry::Again {} => simulation.physics.uncount_update(),
            Entry::Body { body, command } => {
                let body = check.body(*body)?;
                check_command::<RigidBodyCommand>(command)?;
                simulation.command_body(body, command);
            }
            Entry::Joint { body, index, kind, value } => {
                let body = check.body(*body)?;
                simulation.command_joint(body, *index, *kind, *value);
            }
            Entry::Pose { object, command } => {
                check.object("camera or light", *object, &[ObjectType::Camera, ObjectType::Light])?;
                check_command(&**command)?;
                let scene = &mut simulation.physics.scene;
                match object.kind {
                    ObjectType::Camera => scene.cameras[CameraId::new(object.index)].attached.apply_command(command),
                    _ => scene.lights[LightId::new(object.index)].attached.apply_command(command),
                }
                simulation.physics.note(entry);
            }
            Entry::SoftBody { soft, command } => {
                check.is_there("soft body", ObjectType::SoftBody, *soft)?;
                check_command(&**command)?;
                simulation.physics.note(entry);
                let scene = &mut simulation.physics.scene;
                scene.soft_bodies[SoftBodyId::new(*soft)].apply_command(&mut scene.world, command);
            }
            Entry::Actuator { actuator, command } => {
                check.is_there("actuator", ObjectType::Actuator, *actuator)?;
                check_command(&**command)?;
                simulation.command_actuator(ActuatorId::new(*actuator), command);
            }
            Entry::Vehicle { vehicle, command } => {
                check.is_there("vehicle", ObjectType::Vehicle, *vehicle)?;
                check_command(&**command)?;
                simulation.command_vehicle(VehicleId::new(*vehicle), command);
            }
            Entry::Camera { camera, parameters } => {
                check.is_there("camera", ObjectType::Camera, *camera)?;
                check_command(&**parameters)?;
                simulation.physics.note(entry);
                // It said so when it was recorded, too.
                let _ = simulation.physics.scene.set_camera_parameters(CameraId::new(*camera), parameters);
            }
            Entry::Light { light, parameters } => {
                check.is_there("light", ObjectType::Light, *light)?;
                check_command(&**parameters)?;
                simulation.physics.note(entry);
                let _ = simulation.physics.scene.set_light_parameters(LightId::new(*light), parameters);
            }
            Entry::Plugin { plugin, begins, command } => {
                let done = simulation.act_as_plugin(*plugin, *begins, command);
                done.map_err(|error| ReplayError::Plugin { command: command.to_string(), error })?;
            }
            Entry::PluginGone { plugin } => simulation.release_plugin(*plugin),
            Entry::ResetBodies {} => simulation.reset_bodies(),
            Entry::ResetWorld {} => simulation.reset_world(),
            Entry::AddModel { .. } => {
                if let Some(prepared) = prepared {
                    // It may have failed when it was recorded, too.
                    let _ = simulation.add_model(prepared.map_err(ReplayError::File)?);
                }
            }
            Entry::RemoveModel { key } => {
                simulation.remove_model(key).map_err(|error| ReplayError::File(error.to_string()))?;
            }
            Entry::RemoveBody { body } => {
                let body = check.body(*body)?;
                simulation.remove_body(body).map_err(ReplayError::File)?;
            }
            Entry::State { change } => {
                check.state(change)?;
                simulation.set_state(change).map_err(|error| ReplayError::File(error.to_string()))?;
            }
            Entry::Parameters { change } => {
                check.parameters(change)?;
                simulation.set_parameters(change).map_err(|error| ReplayError::File(error.to_string()))?;
            }
            Entry::Place { object, pose } => {
                check.object("camera or light", *object, &[ObjectType::Camera, ObjectType::Light])?;
                finite_pose(pose)?;
                simulation.place(*object, *pose);
            }
            Entry::MoveCamera { camera, gesture } => simulation.move_camera(CameraId::new(*camera), *gesture),
            Entry::LookFrom { camera, pose, distance } => {
                simulation.place_camera(CameraId::new(*camera), pose, *distance);
            }
            Entry::ResetCameras {} => simulation.reset_cameras(),
            Entry::Gravity { on } => simulation.switch_gravity(*on),
            Entry::Pick { origin, direction } => {
                simulation.pick(origin, direction);
            }
            Entry::Drag { origin, direction } => simulation.drag(origin, direction),
            Entry::Release {} => simulation.release_picked(),
            Entry::PickNode { soft, node, goal } => {
                check.is_there("soft body", ObjectType::SoftBody, *soft)?;
                let soft = SoftBodyId::new(*soft);
                if *node >= simulation.physics.scene.soft_bodies[soft].nodes {
                    return Err(ReplayError::NoObject { what: "node", index: *node });
                }
                finite("a goal", goal.iter().flat_map(|goal| goal.iter().copied()))?;
                simulation.drag_soft_node(soft, *node, *goal);
            }
            // Cuts and tools that were refused are refused again.
            Entry::Carve { volume, command } => {
                check.is_there("volume", ObjectType::Volume, *volume)?;
                let _ = simulation.carve(VolumeId::new(*volume), command);
            }
            Entry::RestoreVoxels { volume } => {
                check.is_there("volume", ObjectType::Volume, *volume)?;
                let _ = simulation.restore_voxels(VolumeId::new(*volume));
            }
            Entry::Tool { volume, tool, on, radius } => {
                check.is_there("volume", ObjectType::Volume, *volume)?;
                let _ = simulation.set_tool(VolumeId::new(*volume), *tool, *on, *radius);
            }
            Entry::NewTool { volume, tool } => {
                check.is_there("volume", ObjectType::Volume, *volume)?;
                let _ = simulation.add_tool(VolumeId::new(*volume), tool);
            }
            Entry::Restore { position, keep_cameras, .. } => {
                let state = self.saved.get(position).ok_or(ReplayError::NoState(*position))?;
                simulation.restore_keeping(state, *keep_cameras)?;
            }
            Entry::Device { file, line, name } => self.add_device(simulation, file, *line, name)?,
            Entry::Period { period } => {
                if !(period.is_finite() && *period > 0.0) {
                    return Err(ReplayError::Number("a period"));
                }
                simulation.set_device_period(*period);
            }
            Entry::Hand { device, reference, gripper } => {
                let (stand_in, hand) = self.device(*device)?;
                (hand.reference, hand.gripper) = (*reference, *gripper);
                stand_in.send(*hand);
            }
            Entry::HandCameras { device, ticks, moved } => {
                finite_pose(moved)?;
                let (stand_in, hand) = self.device(*device)?;
                hand.cameras = CameraSum::from_parts(*ticks, moved);
                stand_in.send(*hand);
            }
            Entry::Gain { device, quantity: number, step } => {
                let quantity = quantity(*number).ok_or(ReplayError::Number("a quantity"))?;
                if !simulation.change_device_gain(*device, GainChange { quantity, step: *step }) {
                    return Err(ReplayError::NoObject { what: "input device", index: *device });
                }
            }
            Entry::Assist { on } => self.controls.set_gripping_assist(*on),
            Entry::Hash { iteration, sim_time, hash } => {
                self.hash.grow(&simulation.physics.scene);
                let found = self.hash.of(&simulation.physics.scene);
                let same = std::mem::replace(&mut self.same, *iteration);
                if found != *hash {
                    let (iteration, sim_time, expected) = (*iteration, *sim_time, *hash);
                    return Err(ReplayError::Differs { same, iteration, sim_time, expected, found });
                }
                return Ok(Replayed::Checked);
            }
            // Recordings are read by an `Unpacker`, which leaves none.
            Entry::Same { .. } => return Err(ReplayError::Start("holds an entry that repeats nothing")),
            Entry::Note { text } => {
                simulation.annotate(text);
                return Ok(Replayed::Note(text.clone()));
            }
        }
        Ok(Replayed::Changed)
    }

    fn device(&mut self, device: usize) -> Result<(&mut StandIn, &mut Hand), ReplayError> {
        let found = self.devices.get_mut(device).map(|(stand_in, hand)| (stand_in, hand));
        found.ok_or(ReplayError::NoObject { what: "input device", index: device })
    }

    fn add_device(
        &mut self,
        simulation: &mut Simulation,
        file: &str,
        line: u64,
        name: &str,
    ) -> Result<(), ReplayError> {
        let (listed, _) = adf::load::<InputDevices>(Path::new(file))
            .map_err(|error| ReplayError::File(format!("input devices {error}")))?;
        let is_it = |entry: &adf::InputDevice| entry.identifier == name && u64::from(entry.source.line) == line;
        let entry = listed.entries.into_iter().flatten().find(is_it);
        let entry =
            entry.ok_or_else(|| ReplayError::File(format!("{file}:{line}: there is no input device `{name}`")))?;
        let mut made = None;
        let couple = |pose: Isometry3<f64>| {
            let (physics, stand_in) = StandIn::new(pose);
            made = Some((stand_in, Hand { reference: pose, gripper: UNKNOWN_OPENING, cameras: CameraSum::default() }));
            physics
        };
        let controls = Arc::clone(&self.controls);
        let added = simulation.add_device(entry, &controls, couple);
        added.map_err(|why| ReplayError::File(format!("{file}:{line}: input device `{name}`: {why}")))?;
        self.devices.extend(made);
        Ok(())
    }
}

/// Whether what entries are about is there.
struct Check<'a>(&'a Simulation);

impl Check<'_> {
    fn is_there(&self, what: &'static str, kind: ObjectType, index: usize) -> Result<(), ReplayError> {
        // What has left is there, too: it was told the same when this was recorded, and does as little now.
        let is_there = index < self.0.physics.scene.object_count(kind);
        is_there.then_some(()).ok_or(ReplayError::NoObject { what, index })
    }

    fn object(&self, what: &'static str, object: ObjectId, kinds: &[ObjectType]) -> Result<(), ReplayError> {
        match kinds.contains(&object.kind) {
            true => self.is_there(what, object.kind, object.index),
            false => Err(ReplayError::NoObject { what, index: object.index }),
        }
    }

    fn body(&self, index: usize) -> Result<BodyId, ReplayError> {
        self.is_there("body", ObjectType::Body, index).map(|()| BodyId::new(index))
    }

    fn bodies<T>(&self, list: &[(BodyId, T)]) -> Result<(), ReplayError> {
        list.iter().try_for_each(|(body, _)| self.body(body.index()).map(|_| ()))
    }

    fn joints<T>(&self, list: &[(JointId, T)]) -> Result<(), ReplayError> {
        list.iter().try_for_each(|(joint, _)| self.is_there("joint", ObjectType::Joint, joint.index()))
    }

    fn state(&self, change: &StateChange) -> Result<(), ReplayError> {
        let StateChange { positions, rates, poses, twists } = change;
        self.joints(positions).and(self.joints(rates)).and(self.bodies(poses)).and(self.bodies(twists))
    }

    fn parameters(&self, change: &ParameterChange) -> Result<(), ReplayError> {
        // All fields by name, so that no new one is forgotten.
        let ParameterChange {
            masses,
            inertias,
            frictions,
            restitutions,
            dampings,
            gravity: _,
            gravities,
            body_gains,
            colors,
            limits,
            joint_dampings,
            joint_frictions,
            joint_gains,
        } = change;
        self.bodies(masses)
            .and(self.bodies(inertias))
            .and(self.bodies(frictions))
            .and(self.bodies(restitutions))
            .and(self.bodies(dampings))
            .and(self.bodies(gravities))
            .and(self.bodies(body_gains))
            .and(self.bodies(colors))
            .and(self.joints(limits))
            .and(self.joints(joint_dampings))
            .and(self.joints(joint_frictions))
            .and(self.joints(joint_gains))
    }
}

fn check_command<C: crate::comm::Command>(command: &C) -> Result<(), ReplayError> {
    command.is_finite().then_some(()).ok_or(ReplayError::Number("a command"))
}

fn finite(what: &'static str, numbers: impl IntoIterator<Item = f64>) -> Result<(), ReplayError> {
    numbers.into_iter().all(f64::is_finite).then_some(()).ok_or(ReplayError::Number(what))
}

fn finite_pose(pose: &Isometry3<f64>) -> Result<(), ReplayError> {
    finite("a pose", pose.translation.vector.iter().chain(pose.rotation.coords.iter()).copied())
}
