//! A simulation and its arrays.

use std::collections::HashMap;
use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::adf::Launch;
use ambf_core::bullet::{BodyKinematics, EnergyLedger, Preset, Ray, RayHit, RayTarget};
use ambf_core::comm::{ActuatorCommand, CarveCommand, HubIndex, ObjectKind, Snapshot};
use ambf_core::control::Profile;
use ambf_core::ids::{ActuatorId, BodyId, JointId, SensorId};
use ambf_core::scene::{Body, JointCoupling, ParameterChange, PreparedModel, Scene, StateChange};
use ambf_core::sim::{LostState, ModelError, Stepper, StepperState};
use ambf_core::text;
use ambf_core::volume::VoxelGrid;
use ambf_recording::Writer;
use ambf_render::camera_labels;
use crtk::diagnostics::Board;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use numpy::{PyArray1, PyArrayMethods};
use parking_lot::Mutex;
use pyo3::prelude::*;

use crate::arms;
use crate::arrays::{Buffer, Pool};
use crate::commands::{BodyCommands, Requested, Row, SavedArrays};
use crate::drawing::{self, Drawing, Moment};
use crate::load::{self, Made, Wanted};
use crate::tree::{self, Tree};
use crate::view::Windows;
use crate::{contacts, errors, names, parameters, volumes};

/// How long the physics goes on before Python is asked whether it was interrupted.
pub const SLICE: Duration = Duration::from_millis(100);

/// How often it is looked whether a pause has ended.
const PAUSED: Duration = Duration::from_millis(5);

/// A new array that Python gets.
type Numbers<'py> = Bound<'py, PyArray1<f64>>;

/// Rows of two bodies, their names, and numbers of all contact points.
type Contacts<'py> = (Vec<[i64; 2]>, Vec<(String, String)>, Numbers<'py>);

/// The physics of a [`World`], which moves to the thread that steps it.
pub struct Physics {
    pub stepper: Box<Stepper>,
    requested: Requested,
    /// Kept for further worlds.
    _launch: Option<Arc<Launch>>,
}

impl Physics {
    /// Of a scene without a launch file.
    pub fn new(stepper: Stepper) -> Self {
        Self { stepper: Box::new(stepper), requested: Requested::new(0), _launch: None }
    }
}

/// Where the physics of a [`World`] is.
pub enum Slot {
    Here(Physics),
    Away,
    Closed,
}

struct Sensor {
    name: String,
    id: SensorId,
    /// Where its rays stand in the array of measurements; contact sensors have none.
    rays: std::ops::Range<usize>,
}

struct Actuator {
    name: String,
    object: HubIndex,
    id: ActuatorId,
}

/// Where the latest refresh stands.
#[derive(Clone, Copy, Default)]
struct Clock {
    step: u32,
    time: f64,
    lost: f64,
}

/// Of a joint that follows others: its index, those of its leaders with their ratios, and the offset.
type CouplingRow = (usize, Vec<(usize, f64)>, f64);

/// A state that a file names: its name; indices and values of joint positions, joint velocities, poses and twists.
type KeyframeRow = (String, Vec<(usize, f64)>, Vec<(usize, f64)>, Vec<(usize, [f64; 7])>, Vec<(usize, [f64; 6])>);

/// A world that is simulated; see `_ambf.pyi`.
#[pyclass(frozen, weakref, module = "ambf._ambf")]
pub struct World {
    slot: Arc<Mutex<Slot>>,
    clock: Mutex<Clock>,
    warnings: Vec<String>,
    rows: Vec<Row>,
    /// Row of each body by its index; -1: it has none.
    rows_of_bodies: Vec<i64>,
    joints: Vec<String>,
    /// (joints) which joint of the scene is at each place of the arrays.
    joint_ids: Vec<JointId>,
    sensors: Vec<Sensor>,
    actuators: Vec<Actuator>,
    poses: Buffer,
    twists: Buffer,
    joint_positions: Buffer,
    joint_velocities: Buffer,
    joint_efforts: Buffer,
    joint_wrenches: Buffer,
    measurements: Buffer,
    holding: Buffer,
    commands: BodyCommands,
    cameras: Vec<String>,
    drawing: Arc<Drawing>,
    pictures: PictureArrays,
    windows: Mutex<Option<Windows>>,
    /// Arms for CRTK clients.
    arms: Board,
    writer: Mutex<Option<Writer>>,
    revision: AtomicU64,
}

/// Arrays of pictures.
#[derive(Default)]
struct PictureArrays {
    rgb: Pool,
    depth: Pool,
    ids: Pool,
    normals: Pool,
}

impl World {
    /// Takes the physics away. The lock is held for no longer than that: Python's could change hands meanwhile.
    pub fn take_away(&self, py: Python<'_>) -> PyResult<Physics> {
        let mut slot = self.slot.lock();
        let before = std::mem::replace(&mut *slot, Slot::Away);
        match before {
            Slot::Here(physics) => Ok(physics),
            Slot::Away => {
                drop(slot);
                Err(errors::busy(py))
            }
            Slot::Closed => {
                *slot = Slot::Closed;
                drop(slot);
                Err(errors::closed(py))
            }
        }
    }

    /// Takes the physics away and puts what the arrays command in force; nothing has changed after an error.
    pub fn take(&self, py: Python<'_>) -> PyResult<Physics> {
        let mut physics = self.take_away(py)?;
        let Physics { stepper, requested, .. } = &mut physics;
        match self.commands.put_in_force(py, &self.rows, stepper, requested) {
            Ok(()) => Ok(physics),
            Err(error) => {
                *self.slot.lock() = Slot::Here(physics);
                Err(error)
            }
        }
    }

    /// Takes the physics back and shows its states; `None`: it was lost in a panic, and the world is closed.
    pub fn give(&self, py: Python<'_>, physics: Option<Physics>) -> PyResult<()> {
        let Some(physics) = physics else {
            *self.slot.lock() = Slot::Closed;
            return Ok(());
        };
        let refreshed = self.refresh(py, physics.stepper.snapshot());
        *self.slot.lock() = Slot::Here(physics);
        refreshed
    }

    /// Lets `act` use the physics, which is not stepped meanwhile.
    fn with<R>(&self, py: Python<'_>, act: impl FnOnce(&mut Physics) -> R) -> PyResult<R> {
        let mut physics = self.take_away(py)?;
        let result = act(&mut physics);
        *self.slot.lock() = Slot::Here(physics);
        Ok(result)
    }

    fn refresh(&self, py: Python<'_>, snapshot: &Snapshot) -> PyResult<()> {
        let bodies = || self.rows.iter().map(|row| (row, &snapshot.bodies[row.id]));
        self.poses.write::<f64>(py, |poses| {
            for (pose, (row, body)) in poses.chunks_exact_mut(7).zip(bodies()) {
                let Isometry3 { translation, rotation } = body.body_pose(&row.offset);
                pose[..3].copy_from_slice(translation.vector.as_slice());
                // x, y, z, w.
                pose[3..].copy_from_slice(rotation.coords.as_slice());
            }
        })?;
        self.twists.write::<f64>(py, |twists| {
            for (twist, (_, body)) in twists.chunks_exact_mut(6).zip(bodies()) {
                twist[..3].copy_from_slice(&body.linear_velocity);
                twist[3..].copy_from_slice(&body.angular_velocity);
            }
        })?;
        let joints = [
            (&self.joint_positions, &snapshot.joint_positions),
            (&self.joint_velocities, &snapshot.joint_velocities),
            (&self.joint_efforts, &snapshot.joint_efforts),
        ];
        for (buffer, values) in joints {
            buffer.write::<f64>(py, |numbers| {
                numbers.iter_mut().zip(&self.joint_ids).for_each(|(to, joint)| *to = values[*joint]);
            })?;
        }
        self.joint_wrenches.write::<f64>(py, |numbers| {
            for (to, joint) in numbers.chunks_exact_mut(6).zip(&self.joint_ids) {
                let wrench = &snapshot.joint_wrenches[*joint];
                to[..3].copy_from_slice(wrench.force.as_slice());
                to[3..].copy_from_slice(wrench.torque.as_slice());
            }
        })?;
        self.measurements.write::<f64>(py, |numbers| {
            for sensor in &self.sensors {
                let rays = numbers.get_mut(sensor.rays.clone()).unwrap_or_default();
                rays.iter_mut().zip(&snapshot.sensors[sensor.id]).for_each(|(to, from)| *to = from.measurement);
            }
        })?;
        self.holding.write::<bool>(py, |holding| {
            let held = self.actuators.iter().map(|actuator| snapshot.actuators[actuator.id]);
            holding.iter_mut().zip(held).for_each(|(to, from)| *to = from);
        })?;
        let clock = Clock { step: snapshot.sim_step, time: snapshot.sim_time, lost: snapshot.timing.lost_time };
        *self.clock.lock() = clock;
        Ok(())
    }

    /// Appends the arrays of states, one after the other: see `stack_states` in `_ambf.pyi`.
    pub fn append_states(&self, py: Python<'_>, numbers: &mut Vec<f64>) -> PyResult<()> {
        let joints = [&self.joint_positions, &self.joint_velocities, &self.joint_efforts];
        for buffer in [&self.poses, &self.twists].into_iter().chain(joints).chain([&self.measurements]) {
            buffer.read_all::<f64, _>(py, |states| numbers.extend_from_slice(states))?;
        }
        self.holding.read_all::<bool, _>(py, |holding| numbers.extend(holding.iter().map(|held| f64::from(*held))))
    }

    /// Iteration and simulated time, s, of what the arrays show.
    pub fn shown(&self) -> (i64, f64) {
        let clock = self.clock();
        (clock.step.into(), clock.time)
    }

    /// Whether the user has paused the simulation in a window.
    fn is_paused(&self) -> bool {
        self.windows.lock().as_ref().is_some_and(Windows::is_paused)
    }

    /// Whether it has to wait; a single step that the user wants is taken.
    fn is_held(&self) -> bool {
        self.windows.lock().as_ref().is_some_and(Windows::hold)
    }

    /// What can be drawn now; the physics may go on afterwards.
    fn moment(&self, py: Python<'_>) -> PyResult<Moment> {
        self.with(py, |physics| {
            let visuals = physics.stepper.visuals()?;
            Some(Moment { visuals, snapshot: physics.stepper.snapshot().clone() })
        })?
        .ok_or_else(|| errors::closed(py))
    }

    fn clock(&self) -> Clock {
        *self.clock.lock()
    }

    /// The row of a body; -1: it has none.
    fn row_of(&self, body: BodyId) -> i64 {
        self.rows_of_bodies.get(body.index()).copied().unwrap_or(-1)
    }

    fn row(&self, body: usize) -> PyResult<&Row> {
        self.rows.get(body).ok_or_else(|| no_such("body", body, self.rows.len()))
    }

    /// A world of a stepper, with arrays for what there is in it.
    pub fn around(
        py: Python<'_>,
        slot: Arc<Mutex<Slot>>,
        mut physics: Physics,
        warnings: Vec<String>,
        revision: u64,
    ) -> PyResult<Self> {
        let stepper = &physics.stepper;
        let (mut rows, mut sensors, mut actuators, mut rays) = (Vec::new(), Vec::new(), Vec::new(), 0);
        let snapshot = stepper.snapshot();
        for (object, entry) in stepper.objects().entries().filter(|(_, entry)| !entry.is_removed()) {
            let name = names::of(&entry.info);
            match &entry.info.kind {
                ObjectKind::RigidBody(id, info) => rows.push(Row::new(name, object, *id, info)),
                ObjectKind::Sensor(id, info) => {
                    let is_contact = info.kind == ambf_core::comm::SensorType::Contact;
                    let count = if is_contact { 0 } else { snapshot.sensors[*id].len() };
                    sensors.push(Sensor { name, id: *id, rays: rays..rays + count });
                    rays += count;
                }
                ObjectKind::Actuator(id, _) => actuators.push(Actuator { name, object, id: *id }),
                _ => (),
            }
        }
        let scene = stepper.simulation().scene();
        let mut rows_of_bodies = vec![-1; scene.bodies.len()];
        rows.iter().enumerate().for_each(|(place, row): (usize, &Row)| rows_of_bodies[row.id.index()] = place as i64);
        let there = || scene.joints.entries().filter(|(_, joint)| !joint.removed);
        let joints: Vec<String> = there().map(|(_, joint)| joint.name.clone()).collect();
        let joint_ids: Vec<JointId> = there().map(|(id, _)| id).collect();
        let visuals = stepper.visuals().map(|visuals| camera_labels(&visuals)).unwrap_or_default();
        let cameras = visuals.into_iter().map(|(_, label)| label).collect();
        let made = Self {
            clock: Mutex::default(),
            poses: Buffer::state::<f64>(py, &[rows.len(), 7])?,
            twists: Buffer::state::<f64>(py, &[rows.len(), 6])?,
            joint_positions: Buffer::state::<f64>(py, &[joints.len()])?,
            joint_velocities: Buffer::state::<f64>(py, &[joints.len()])?,
            joint_efforts: Buffer::state::<f64>(py, &[joints.len()])?,
            joint_wrenches: Buffer::state::<f64>(py, &[joints.len(), 6])?,
            measurements: Buffer::state::<f64>(py, &[rays])?,
            holding: Buffer::state::<bool>(py, &[actuators.len()])?,
            commands: BodyCommands::new(py, rows.len())?,
            slot,
            warnings,
            rows,
            rows_of_bodies,
            joints,
            joint_ids,
            sensors,
            actuators,
            cameras,
            drawing: Arc::default(),
            pictures: PictureArrays::default(),
            windows: Mutex::default(),
            arms: Board::local(),
            writer: Mutex::default(),
            revision: AtomicU64::new(revision),
        };
        physics.requested = Requested::new(made.rows.len());
        made.give(py, Some(physics))?;
        Ok(made)
    }

    /// A world with arrays for what the scene has after `change`, which takes the physics over; this one is empty then. Nothing
    /// has changed after an error.
    fn changed<R>(
        &self,
        py: Python<'_>,
        change: impl FnOnce(&mut Stepper) -> Result<R, ModelError> + Send,
    ) -> PyResult<(Self, R)>
    where
        R: Send,
    {
        let mut physics = self.take_away(py)?;
        let outcome = py.detach(|| change(&mut physics.stepper));
        let answer = match outcome {
            Ok(answer) => answer,
            Err(problem) => {
                self.give(py, Some(physics))?;
                return Err(errors::model(py, &problem));
            }
        };
        let was_commanded: Vec<BodyId> = self
            .rows
            .iter()
            .zip(&physics.requested.commanded)
            .filter(|(_, was)| **was)
            .map(|(row, _)| row.id)
            .collect();
        let revision = self.revision.load(Ordering::Relaxed) + 1;
        let mut made = Self::around(py, Arc::clone(&self.slot), physics, self.warnings.clone(), revision)?;
        // Pictures and windows are of what is published, whoever holds it.
        made.drawing = Arc::clone(&self.drawing);
        made.arms = self.arms.clone();
        *made.windows.lock() = self.windows.lock().take();
        *made.writer.lock() = self.writer.lock().take();
        made.with(py, |physics| {
            for (row, commanded) in made.rows.iter().zip(&mut physics.requested.commanded) {
                *commanded = was_commanded.contains(&row.id);
            }
        })?;
        Ok((made, answer))
    }

    fn voxels_of(&self, py: Python<'_>, volume: usize) -> PyResult<Arc<VoxelGrid>> {
        let found = self.with(py, |physics| volumes::shared(physics.stepper.simulation().scene(), volume))?;
        found.map_err(|problem| volumes::error(&problem))
    }

    /// Bodies and joints in the order of the arrays.
    pub fn ids(&self) -> (Vec<BodyId>, &[JointId]) {
        (self.rows.iter().map(|row| row.id).collect(), &self.joint_ids)
    }
}

/// Whether neither the body nor its model has left the scene.
fn is_there(scene: &Scene, body: &Body) -> bool {
    !body.removed && scene.models.get(body.identity.model).is_none_or(|model| !model.removed)
}

/// Values of the rows of bodies, without those that hold a number that is none.
fn given<const N: usize>(rows: &[Row], values: Option<Vec<[f64; N]>>) -> impl Iterator<Item = (BodyId, [f64; N])> + '_ {
    let values = values.unwrap_or_default().into_iter();
    rows.iter().map(|row| row.id).zip(values).filter(|(_, value)| !value.iter().any(|number| number.is_nan()))
}

fn no_such(what: &str, index: usize, count: usize) -> PyErr {
    pyo3::exceptions::PyIndexError::new_err(format!("there is no {what} {index}: there are {count}"))
}

/// Makes iterations until they are done, or until about [`SLICE`] has passed; how many were made.
pub fn slice(stepper: &mut Stepper, steps: u32) -> Result<u32, LostState> {
    // What may pass without a look at the clock, whose reading is a noticeable part of a short iteration.
    const BLIND: Duration = Duration::from_micros(100);
    let begin = Instant::now();
    let (mut made, mut next_look) = (0_u32, 1);
    stepper.step_while(steps, || {
        made += 1;
        if made < next_look {
            return true;
        }
        let elapsed = begin.elapsed();
        // As many as take that long at the present pace, but few enough that it matters little if they get slower.
        let pace = elapsed.as_nanos() / u128::from(made);
        next_look = made + (BLIND.as_nanos() / pace.max(1)).clamp(1, 16) as u32;
        elapsed < SLICE
    })
}

/// What [`World::save`] returns; see `_ambf.pyi`.
#[pyclass(frozen, module = "ambf._ambf")]
pub struct State {
    stepper: StepperState,
    /// One a body: whether a command was ever in force.
    commanded: Vec<bool>,
    commands: SavedArrays,
}

#[pymethods]
impl State {
    #[getter]
    fn sim_step(&self) -> u32 {
        self.stepper.snapshot().sim_step
    }

    #[getter]
    fn sim_time(&self) -> f64 {
        self.stepper.snapshot().sim_time
    }

    #[getter]
    fn size(&self) -> usize {
        self.stepper.simulation().size()
    }
}

#[pymethods]
impl World {
    #[new]
    #[pyo3(signature = (models, launch_file, world, indexes, profile, solver, integrator, iterations, articulated, sleep, saving, joint_wrenches, step, plugins, crtk, seed))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        models: Vec<PathBuf>,
        launch_file: Option<PathBuf>,
        world: Option<PathBuf>,
        indexes: Vec<usize>,
        profile: Option<String>,
        solver: Option<String>,
        integrator: Option<String>,
        iterations: Option<u32>,
        articulated: Option<bool>,
        sleep: Option<bool>,
        saving: bool,
        joint_wrenches: bool,
        step: f64,
        plugins: Vec<PathBuf>,
        crtk: Vec<PathBuf>,
        seed: Option<u64>,
    ) -> PyResult<Self> {
        let wanted = Wanted {
            models,
            launch_file,
            world,
            indexes,
            profile,
            solver,
            integrator,
            iterations,
            articulated,
            sleep,
            saving,
            wrenches: joint_wrenches,
            step,
            plugins,
            crtk,
            seed,
        };
        let Made { stepper, warnings, launch, arms } =
            py.detach(|| load::load_world(&wanted)).map_err(|problems| errors::load(py, problems))?;
        let physics = Physics { stepper: Box::new(stepper), requested: Requested::new(0), _launch: launch };
        let mut made = Self::around(py, Arc::new(Mutex::new(Slot::Away)), physics, warnings, 0)?;
        made.arms = arms;
        Ok(made)
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.iter().map(|warning| text::lines(warning).into_owned()).collect()
    }

    #[getter]
    fn bodies(&self) -> Vec<String> {
        self.rows.iter().map(|row| row.name.clone()).collect()
    }

    #[getter]
    fn joints(&self) -> Vec<String> {
        self.joints.clone()
    }

    #[getter]
    fn sensors(&self) -> Vec<String> {
        self.sensors.iter().map(|sensor| sensor.name.clone()).collect()
    }

    #[getter]
    fn actuators(&self) -> Vec<String> {
        self.actuators.iter().map(|actuator| actuator.name.clone()).collect()
    }

    fn body_joints(&self, body: usize) -> PyResult<(Vec<String>, Vec<usize>)> {
        let row = self.row(body)?;
        let place = |joint: &JointId| self.joint_ids.binary_search(joint).ok();
        Ok((row.joint_names.clone(), row.joints.iter().filter_map(place).collect()))
    }

    fn sensor_rays(&self, sensor: usize) -> PyResult<(usize, usize)> {
        let found = self.sensors.get(sensor).ok_or_else(|| no_such("sensor", sensor, self.sensors.len()))?;
        Ok((found.rays.start, found.rays.end))
    }

    fn sensor_readings<'py>(
        &self,
        py: Python<'py>,
        sensor: usize,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Vec<String>)> {
        let found = self.sensors.get(sensor).ok_or_else(|| no_such("sensor", sensor, self.sensors.len()))?;
        self.with(py, |physics| {
            let readings = &physics.stepper.snapshot().sensors[found.id];
            let seen = readings
                .iter()
                .map(|reading| reading.sensed.as_deref().filter(|_| reading.triggered).unwrap_or_default().to_owned());
            let measured = PyArray1::from_iter(py, readings.iter().map(|reading| reading.measurement));
            (measured, seen.collect())
        })
    }

    #[getter]
    fn poses(&self, py: Python<'_>) -> Py<PyAny> {
        self.poses.view(py)
    }

    #[getter]
    fn twists(&self, py: Python<'_>) -> Py<PyAny> {
        self.twists.view(py)
    }

    #[getter]
    fn joint_positions(&self, py: Python<'_>) -> Py<PyAny> {
        self.joint_positions.view(py)
    }

    #[getter]
    fn joint_velocities(&self, py: Python<'_>) -> Py<PyAny> {
        self.joint_velocities.view(py)
    }

    #[getter]
    fn joint_efforts(&self, py: Python<'_>) -> Py<PyAny> {
        self.joint_efforts.view(py)
    }

    #[getter]
    fn joint_wrenches(&self, py: Python<'_>) -> Py<PyAny> {
        self.joint_wrenches.view(py)
    }

    #[getter]
    fn measurements(&self, py: Python<'_>) -> Py<PyAny> {
        self.measurements.view(py)
    }

    #[getter]
    fn holding(&self, py: Python<'_>) -> Py<PyAny> {
        self.holding.view(py)
    }

    #[getter]
    fn kinds(&self, py: Python<'_>) -> Py<PyAny> {
        self.commands.kinds.view(py)
    }

    #[getter]
    fn wrenches(&self, py: Python<'_>) -> Py<PyAny> {
        self.commands.wrenches.view(py)
    }

    #[getter]
    fn target_poses(&self, py: Python<'_>) -> Py<PyAny> {
        self.commands.poses.view(py)
    }

    #[getter]
    fn target_twists(&self, py: Python<'_>) -> Py<PyAny> {
        self.commands.twists.view(py)
    }

    fn joint_commands(&self, py: Python<'_>, body: usize) -> PyResult<(Py<PyAny>, Py<PyAny>)> {
        self.commands.of_joints(py, body, self.row(body)?.joints.len())
    }

    fn hold(&self, py: Python<'_>, actuator: usize, hold: bool, sensor: String, body: String) -> PyResult<()> {
        let found = self.actuators.get(actuator).ok_or_else(|| no_such("actuator", actuator, self.actuators.len()))?;
        self.with(py, |physics| {
            if let Some(command) = physics.stepper.actuator_command(found.object) {
                *command = ActuatorCommand {
                    actuate: hold,
                    body_name: body,
                    use_sensor_data: !sensor.is_empty(),
                    sensor_identifier: sensor,
                    ..ActuatorCommand::default()
                };
            }
        })
    }

    #[getter]
    fn sim_step(&self) -> u32 {
        self.clock().step
    }

    #[getter]
    fn sim_time(&self) -> f64 {
        self.clock().time
    }

    #[getter]
    fn lost_time(&self) -> f64 {
        self.clock().lost
    }

    fn step(&self, py: Python<'_>, steps: u32) -> PyResult<()> {
        let mut physics = self.take(py)?;
        let mut left = steps;
        let outcome = loop {
            let mut next = left;
            if left > 0 && self.is_paused() {
                if self.is_held() {
                    py.detach(|| {
                        physics.stepper.serve_window();
                        std::thread::sleep(PAUSED);
                    });
                    if let Err(interruption) = py.check_signals() {
                        break Err(interruption);
                    }
                    continue;
                }
                next = 1;
            }
            match py.detach(|| catch_unwind(AssertUnwindSafe(|| slice(&mut physics.stepper, next)))) {
                Ok(Ok(made)) => left -= made,
                Ok(Err(problem)) => break Err(errors::non_finite(py, &problem)),
                Err(panic) => {
                    self.give(py, None)?;
                    // Python shows it as what it is, a bug.
                    resume_unwind(panic);
                }
            }
            if left == 0 {
                break Ok(());
            }
            if let Err(interruption) = py.check_signals() {
                break Err(interruption);
            }
        };
        self.give(py, Some(physics))?;
        outcome
    }

    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |physics| {
            physics.stepper.reset();
            physics.requested.commanded.fill(false);
            self.commands.clear(py)?;
            self.refresh(py, physics.stepper.snapshot())
        })?
    }

    /// Numbers that are no numbers leave what they stand for as it is.
    #[pyo3(signature = (joint_positions, joint_velocities, poses, twists))]
    fn set_state(
        &self,
        py: Python<'_>,
        joint_positions: Option<Vec<f64>>,
        joint_velocities: Option<Vec<f64>>,
        poses: Option<Vec<[f64; 7]>>,
        twists: Option<Vec<[f64; 6]>>,
    ) -> PyResult<()> {
        let joints = |values: Option<Vec<f64>>| {
            let given = values.unwrap_or_default().into_iter().enumerate().filter(|(_, value)| !value.is_nan());
            given.filter_map(|(index, value)| Some((*self.joint_ids.get(index)?, value))).collect()
        };
        let pose_of = |[x, y, z, i, j, k, w]: [f64; 7]| {
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
            Isometry3::from_parts(Translation3::new(x, y, z), rotation)
        };
        let twist_of = |twist: [f64; 6]| [0, 3].map(|first| Vector3::from_column_slice(&twist[first..first + 3]));
        let change = StateChange {
            positions: joints(joint_positions),
            rates: joints(joint_velocities),
            poses: given(&self.rows, poses).map(|(body, pose)| (body, pose_of(pose))).collect(),
            twists: given(&self.rows, twists).map(|(body, twist)| (body, twist_of(twist))).collect(),
        };
        self.with(py, |physics| {
            physics.stepper.set_state(&change).map_err(|problem| errors::set_state(py, &problem))?;
            self.refresh(py, physics.stepper.snapshot())
        })?
    }

    /// For each contact point: rows of the two bodies (-1: none) and their names, then 12 numbers: point, normal, distance,
    /// normal force, force of friction on the first body, coefficient of friction.
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Contacts<'py>> {
        let (mut rows, mut names, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            contacts::gather(&physics.stepper, &mut numbers, |first, second| {
                rows.push([first, second].map(|id| self.row_of(id)));
                let name = |id: BodyId| names::of_body(&scene.bodies[id]);
                names.push((name(first), name(second)));
            });
        })?;
        Ok((rows, names, PyArray1::from_vec(py, numbers)))
    }

    /// Rows of the bodies that rays from `origins` to `ends` meet first (-1: none that has a row, -2: nothing), and for each
    /// ray the share of the way, the point and the normal.
    fn cast_rays<'py>(
        &self,
        py: Python<'py>,
        origins: Vec<[f64; 3]>,
        ends: Vec<[f64; 3]>,
    ) -> PyResult<(Vec<i64>, Numbers<'py>)> {
        let rays: Vec<Ray> =
            origins.iter().zip(&ends).map(|(from, to)| Ray { from: (*from).into(), to: (*to).into() }).collect();
        let mut hits = vec![None; rays.len()];
        let mut numbers = Vec::with_capacity(7 * rays.len());
        let rows: Vec<i64> = self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            scene.world.cast_rays(&rays, &mut hits);
            let row = |target: RayTarget| match target {
                RayTarget::Body(handle) => scene.bodies.id_of(handle).map_or(-1, |id| self.row_of(id)),
                _ => -1,
            };
            hits.iter().map(|hit| hit.map_or(-2, |hit: RayHit| row(hit.target))).collect()
        })?;
        for hit in &hits {
            let Some(RayHit { fraction, point, normal, .. }) = hit else {
                numbers.extend([f64::INFINITY, f64::NAN, f64::NAN, f64::NAN, 0.0, 0.0, 0.0]);
                continue;
            };
            numbers.push(*fraction);
            numbers.extend(point.iter().chain(normal.iter()));
        }
        Ok((rows, PyArray1::from_vec(py, numbers)))
    }

    /// Numbers and names of the bodies without a row: passive ones.
    fn passive_bodies(&self, py: Python<'_>) -> PyResult<Vec<(usize, String)>> {
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            let is_meant = |(index, body): &(usize, &Body)| {
                body.identity.passive && is_there(scene, body) && self.row_of(BodyId::new(*index)) < 0
            };
            scene.bodies.iter().enumerate().filter(is_meant).map(|(i, body)| (i, names::of_body(body))).collect()
        })
    }

    /// Pose of the frame of a body by its number, and its twist; `None` when it has left the scene.
    fn body_state(&self, py: Python<'_>, body: usize) -> PyResult<Option<([f64; 7], [f64; 6])>> {
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            let mut all = vec![BodyKinematics::default(); scene.bodies.len()];
            scene.world.read_bodies(&mut all);
            let (state, body) =
                (all.get(body)?, scene.bodies.get(BodyId::new(body)).filter(|body| is_there(scene, body))?);
            let (pose, linear, angular) = (body.pose(&scene.world), state.linear_velocity, state.angular_velocity);
            let (at, turn) = (pose.translation.vector, pose.rotation.coords);
            let [[vx, vy, vz], [wx, wy, wz]] = [linear, angular];
            let twist = [vx, vy, vz, wx, wy, wz];
            Some(([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w], twist))
        })
    }

    /// Another number whenever masses, inertias, frames, limits or gravity have changed.
    #[getter]
    fn revision(&self) -> u64 {
        self.revision.load(Ordering::Relaxed)
    }

    /// The tree that a body is part of.
    fn tree(&self, py: Python<'_>, body: usize) -> PyResult<Tree> {
        let id = self.row(body)?.id;
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            let mechanism = scene.mechanism(id).map_err(|problem| errors::tree(py, &problem.to_string()))?;
            Ok(Tree::new(mechanism, scene, &self.joint_ids))
        })?
    }

    /// Pose of the body frame and twist of the base of a tree, as in the arrays.
    fn tree_base(&self, py: Python<'_>, tree: &Tree) -> PyResult<([f64; 7], [f64; 6])> {
        self.with(py, |physics| {
            let base = tree.bodies()[0];
            let state = &physics.stepper.snapshot().bodies[base];
            let pose = state.body_pose(&physics.stepper.simulation().scene().bodies[base].inertial_offset_inverse);
            let ([x, y, z], [i, j, k]) = (state.linear_velocity, state.angular_velocity);
            (tree::seven(&pose), [x, y, z, i, j, k])
        })
    }

    /// Numbers of each body, numbers of each joint, and gravity: see `parameters.rs`.
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<(Numbers<'py>, Numbers<'py>, Numbers<'py>)> {
        let (bodies, joints) = self.ids();
        let (bodies, joints, gravity) = self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            (parameters::of_bodies(scene, &bodies), parameters::of_joints(scene, joints), scene.gravity)
        })?;
        let gravity = PyArray1::from_slice(py, gravity.as_slice());
        Ok((PyArray1::from_vec(py, bodies), PyArray1::from_vec(py, joints), gravity))
    }

    /// Changes what is named; numbers that are none leave what they stand for as it is.
    fn set_parameters(&self, py: Python<'_>, values: Vec<(String, Vec<f64>)>) -> PyResult<()> {
        let (bodies, joints) = self.ids();
        let mut change = ParameterChange::default();
        for (name, numbers) in &values {
            parameters::add(&mut change, name, numbers, (&bodies, joints))?;
        }
        self.with(py, |physics| physics.stepper.set_parameters(&change))?
            .map_err(|problem| errors::parameter(&problem))?;
        self.revision.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// Puts a camera at a pose in the world.
    fn place_camera(&self, py: Python<'_>, camera: Option<String>, pose: [f64; 7]) -> PyResult<()> {
        let pose = tree::pose_of(pose)?;
        let moment = self.moment(py)?;
        let camera = moment.camera(camera.as_deref()).map_err(|problem| errors::camera(py, &problem))?;
        drop(moment);
        self.with(py, |physics| physics.stepper.place_camera(camera, &pose))
    }

    #[getter]
    fn lights(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            scene.lights.iter().map(|light| light.attached.identity.name.to_string()).collect()
        })
    }

    /// Puts the light at an index at a pose in the world.
    fn place_light(&self, py: Python<'_>, light: usize, pose: [f64; 7]) -> PyResult<()> {
        let pose = tree::pose_of(pose)?;
        self.with(py, |physics| {
            let found = physics.stepper.simulation().scene().lights.ids().nth(light);
            found.map(|light| physics.stepper.place_light(light, &pose))
        })?
        .ok_or_else(|| no_such("light", light, 0))
    }

    /// Names of the volumes.
    #[getter]
    fn volumes(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |physics| volumes::names(physics.stepper.simulation().scene()))
    }

    /// Size, spacing, pose in the world and labels of the volume at an index.
    fn volume_info(&self, py: Python<'_>, volume: usize) -> PyResult<volumes::Info> {
        let found = self.with(py, |physics| volumes::info(physics.stepper.simulation().scene(), volume))?;
        found.map_err(|problem| volumes::error(&problem))
    }

    /// Cuts the volume at an index.
    #[pyo3(signature = (volume, shape, rule, poses, in_world, voxels))]
    #[allow(clippy::too_many_arguments, reason = "one call from Python")]
    fn carve<'py>(
        &self,
        py: Python<'py>,
        volume: usize,
        shape: (String, Vec<f64>),
        rule: (String, Vec<f64>),
        poses: ([f64; 7], [f64; 7]),
        in_world: bool,
        voxels: Vec<[i64; 3]>,
    ) -> PyResult<volumes::Cut<'py>> {
        let command = CarveCommand {
            shape: volumes::shape(&shape.0, &shape.1, voxels)?,
            from: tree::pose_of(poses.0)?,
            to: tree::pose_of(poses.1)?,
            in_world,
            rule: volumes::rule(&rule.0, &rule.1)?,
        };
        let carved = self.with(py, |physics| volumes::carve(physics, volume, &command))?;
        volumes::cut(py, carved.map_err(|problem| volumes::error(&problem))?)
    }

    /// Densities and labels of the volume at an index.
    fn voxels<'py>(&self, py: Python<'py>, volume: usize) -> PyResult<volumes::Voxels<'py>> {
        volumes::voxels(py, &*self.voxels_of(py, volume)?)
    }

    /// Distances of points in the world to the volume at an index, or to one of its labels, and their gradients.
    fn volume_distances<'py>(
        &self,
        py: Python<'py>,
        volume: usize,
        points: Vec<[f64; 3]>,
        label: Option<u8>,
        most: f64,
    ) -> PyResult<Numbers<'py>> {
        let found = self.with(py, |physics| {
            volumes::distances(physics.stepper.simulation().scene(), volume, &points, label, most)
        })?;
        Ok(PyArray1::from_vec(py, found.map_err(|problem| volumes::error(&problem))?))
    }

    /// Writes the voxels of the volume at an index to files.
    fn save_volume(&self, py: Python<'_>, volume: usize, path: PathBuf, prefix: &str) -> PyResult<()> {
        let grid = self.voxels_of(py, volume)?;
        let pose = self.with(py, |physics| volumes::location(physics.stepper.simulation().scene(), volume))?;
        let pose = pose.map_err(|problem| volumes::error(&problem))?;
        py.detach(|| volumes::write(&grid, &path, prefix, &pose))
    }

    /// Gives the volume at an index the voxels of the start back.
    fn restore_voxels(&self, py: Python<'_>, volume: usize) -> PyResult<()> {
        let restored = self.with(py, |physics| {
            let id = volumes::id(physics.stepper.simulation().scene(), volume)?;
            physics.stepper.restore_voxels(id)
        })?;
        restored.map_err(|problem| volumes::error(&problem))
    }

    /// A world with the model, its name and what there is to say about it; this one is empty then.
    fn add_model(&self, py: Python<'_>, file: PathBuf) -> PyResult<(Self, String, Vec<String>)> {
        let (made, added) =
            self.changed(py, |stepper| stepper.add_model(PreparedModel::read(&file).map_err(ModelError::Load)?))?;
        Ok((made, added.key, added.report.lines().map(|line| text::lines(line).into_owned()).collect()))
    }

    /// A world without the model, and its name; this one is empty then.
    fn remove_model(&self, py: Python<'_>, name: &str) -> PyResult<(Self, String)> {
        self.changed(py, |stepper| stepper.remove_model(name))
    }

    /// Names of the models, the environment first.
    #[getter]
    fn models(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            scene.models.iter().filter(|model| !model.removed).map(|model| model.key.clone()).collect()
        })
    }

    /// Name of the profile.
    #[getter]
    fn profile(&self, py: Python<'_>) -> PyResult<&'static str> {
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            match (scene.preset, scene.profile) {
                (Some(Preset::PyBullet), _) => "pybullet",
                (_, Profile::Accurate) => "accurate",
                _ => "legacy",
            }
        })
    }

    #[getter]
    fn joint_types(&self, py: Python<'_>) -> PyResult<Vec<&'static str>> {
        self.with(py, |physics| {
            let scene = physics.stepper.simulation().scene();
            self.joint_ids.iter().map(|joint| scene.joints[*joint].joint_type.name()).collect()
        })
    }

    #[getter]
    fn couplings(&self, py: Python<'_>) -> PyResult<Vec<CouplingRow>> {
        self.with(py, |physics| {
            let joints = &physics.stepper.simulation().scene().joints;
            let coupled = joints.entries().filter_map(|(id, joint)| Some((id, joint.coupling.as_ref()?)));
            let leaders = |coupling: &JointCoupling| -> Vec<(usize, f64)> {
                coupling.leaders.iter().map(|&(leader, ratio)| (leader.index(), ratio)).collect()
            };
            coupled.map(|(id, coupling)| (id.index(), leaders(coupling), coupling.offset)).collect()
        })
    }

    #[getter]
    fn keyframes(&self, py: Python<'_>) -> PyResult<Vec<KeyframeRow>> {
        let places: HashMap<JointId, usize> =
            self.joint_ids.iter().enumerate().map(|(place, id)| (*id, place)).collect();
        let joints = |values: Vec<(JointId, f64)>| -> Vec<(usize, f64)> {
            values.into_iter().filter_map(|(id, value)| Some((*places.get(&id)?, value))).collect()
        };
        // Bodies without a State have no row.
        let row = |body: BodyId| usize::try_from(self.row_of(body)).ok();
        let frames = self.with(py, |physics| physics.stepper.simulation().scene().keyframes())?;
        let row_of = |(name, StateChange { positions, rates, poses, twists }): (String, StateChange)| {
            let poses = poses.into_iter().filter_map(|(body, pose)| Some((row(body)?, tree::seven(&pose))));
            let twists = twists.into_iter().filter_map(|(body, [linear, angular])| {
                Some((row(body)?, [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]))
            });
            (name, joints(positions), joints(rates), poses.collect(), twists.collect())
        };
        Ok(frames.into_iter().map(row_of).collect())
    }

    fn save(&self, py: Python<'_>) -> PyResult<State> {
        let (saved, commanded) =
            self.with(py, |physics| (physics.stepper.save(), physics.requested.commanded.clone()))?;
        let stepper = saved.map_err(|problem| errors::state(py, &problem))?;
        Ok(State { stepper, commanded, commands: self.commands.save(py)? })
    }

    fn restore(&self, py: Python<'_>, state: &State) -> PyResult<()> {
        self.with(py, |physics| {
            physics.stepper.restore(&state.stepper).map_err(|problem| errors::state(py, &problem))?;
            physics.requested.commanded.clone_from(&state.commanded);
            // They may have been others then.
            self.revision.fetch_add(1, Ordering::Relaxed);
            self.commands.restore(py, &state.commands)?;
            self.refresh(py, physics.stepper.snapshot())
        })?
    }

    fn record(&self, py: Python<'_>, file: PathBuf) -> PyResult<()> {
        let started = self.with(py, |physics| {
            let simulation = physics.stepper.simulation_mut();
            py.detach(|| Writer::start(&file, simulation, "ambf (Python)", true))
        })?;
        let writer = started.map_err(|error| errors::recording(py, &error.to_string()))?;
        *self.writer.lock() = Some(writer);
        Ok(())
    }

    /// Number of updates that were recorded; an error if the recording has ended before.
    fn stop_recording(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |physics| physics.stepper.simulation_mut().stop_recording())?;
        let Some(writer) = self.writer.lock().take() else {
            return Err(errors::recording(py, "the simulation is not recorded"));
        };
        let summary = py.detach(|| writer.finish());
        match summary.problem {
            Some(problem) => Err(errors::recording(py, &problem)),
            None => Ok(summary.updates),
        }
    }

    fn note(&self, py: Python<'_>, text: &str) -> PyResult<()> {
        self.with(py, |physics| physics.stepper.simulation_mut().annotate(text))
    }

    fn set_energy_ledger(&self, py: Python<'_>, enabled: bool) -> PyResult<()> {
        self.with(py, |physics| physics.stepper.set_energy_ledger(enabled))
    }

    fn energy(&self, py: Python<'_>) -> PyResult<Vec<(&'static str, f64)>> {
        let ledger = self.with(py, |physics| physics.stepper.simulation().energy())?;
        let names = EnergyLedger::NAMES.iter().map(|name| name.trim_end_matches("_J"));
        Ok(names.zip(ledger.values()).collect())
    }

    fn take_solver_statistics(&self, py: Python<'_>) -> PyResult<Vec<(&'static str, f64)>> {
        let found = self.with(py, |physics| physics.stepper.take_solver_statistics())?;
        Ok(vec![
            ("islands_solved", found.islands_solved as f64),
            ("islands_approximate", found.islands_approximate as f64),
            ("islands_iterated", found.islands_iterated as f64),
            ("position_problems", found.position_problems as f64),
            ("divided_sub_steps", found.divided_sub_steps as f64),
            ("rows", found.rows as f64),
            ("factorisations", found.factorisations as f64),
            ("pivots", found.pivots as f64),
            ("sweeps", found.sweeps as f64),
            ("residual", found.residual),
            ("joint_gap", found.joint_gap),
            ("joint_angle", found.joint_angle),
            ("penetration", found.penetration),
        ])
    }

    fn notices(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        let mut notices = self.with(py, |physics| physics.stepper.take_notices())?;
        notices.extend(self.drawing.take_messages());
        notices.extend(self.writer.lock().as_mut().and_then(Writer::problem));
        Ok(notices.iter().map(|notice| text::lines(notice).into_owned()).collect())
    }

    fn crtk_topics(&self) -> Vec<arms::Listed> {
        arms::topics(&self.arms)
    }

    fn crtk_send(&self, py: Python<'_>, topic: &str, numbers: Vec<f64>, text: String) -> PyResult<()> {
        arms::send(py, &self.arms, topic, numbers, text)
    }

    fn crtk_read(&self, py: Python<'_>, topic: &str) -> PyResult<Option<arms::Read>> {
        arms::read(py, &self.arms, topic)
    }

    #[getter]
    fn cameras(&self) -> Vec<String> {
        self.cameras.clone()
    }

    #[allow(clippy::too_many_arguments)]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: Option<String>,
        width: Option<u32>,
        height: Option<u32>,
        rgb: bool,
        depth: bool,
        ids: bool,
        normals: bool,
        samples: u32,
        pose: Option<[f64; 7]>,
        field_view_angle: Option<f64>,
    ) -> PyResult<Vec<(&'static str, Bound<'py, PyAny>)>> {
        let moment = self.moment(py)?;
        let camera = moment.camera(camera.as_deref()).map_err(|problem| errors::camera(py, &problem))?;
        let size = moment.size(camera, width, height);
        let view = moment.view_from(camera, pose.map(tree::pose_of).transpose()?, field_view_angle);
        let wanted = drawing::Wanted { camera, view, size, rgb, depth, ids, normals, samples };
        let shape = [size.1 as usize, size.0 as usize];
        let colors = [shape[0], shape[1], 3];
        // Other sizes are refused before anything is drawn.
        let is_possible = [size.0, size.1].iter().all(|pixels| (1..=16384).contains(pixels));
        let count = |is_wanted: bool| if is_wanted && is_possible { shape[0] * shape[1] } else { 0 };
        let pools = &self.pictures;
        let mut rgb_array = pools.rgb.array(py, 3 * count(rgb))?;
        let mut depth_array = pools.depth.array(py, count(depth))?;
        let mut id_array = pools.ids.array(py, count(ids))?;
        let mut normal_array = pools.normals.array(py, 3 * count(normals))?;
        let numbers = drawing::Arrays {
            rgb: rgb_array.as_slice_mut()?,
            depth: depth_array.as_slice_mut()?,
            ids: id_array.as_slice_mut()?,
            normals: normal_array.as_slice_mut()?,
        };
        let drawn = py.detach(|| self.drawing.picture(&moment, &wanted, numbers));
        drawn.map_err(|problem| errors::render(py, &problem))?;
        let mut arrays = Vec::with_capacity(4);
        if rgb {
            arrays.push(("rgb", rgb_array.reshape(colors)?.into_any()));
        }
        if depth {
            arrays.push(("depth", depth_array.reshape(shape)?.into_any()));
        }
        if ids {
            arrays.push(("ids", id_array.reshape(shape)?.into_any()));
        }
        if normals {
            arrays.push(("normals", normal_array.reshape(colors)?.into_any()));
        }
        Ok(arrays)
    }

    fn view(&self, py: Python<'_>) -> PyResult<()> {
        if self.windows.lock().as_ref().is_some_and(Windows::are_open) {
            return Ok(());
        }
        let window = self.with(py, |physics| physics.stepper.window())?;
        let (slot, said, report) = (Arc::downgrade(&self.slot), self.drawing.messages(), self.warnings.join("\n"));
        let opened = py.detach(|| Windows::open(window, slot, report, said));
        let windows = opened.map_err(|problem| errors::view(py, &problem))?;
        let before = self.windows.lock().replace(windows);
        py.detach(|| drop(before));
        Ok(())
    }

    #[getter]
    fn is_viewed(&self) -> bool {
        self.windows.lock().as_ref().is_some_and(Windows::are_open)
    }

    fn close_view(&self, py: Python<'_>) {
        let windows = self.windows.lock().take();
        py.detach(|| drop(windows));
    }

    fn id_names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        let moment = self.moment(py)?;
        py.detach(|| self.drawing.id_names(&moment)).map_err(|problem| errors::render(py, &problem))
    }

    fn camera_matrix(
        &self,
        py: Python<'_>,
        camera: Option<String>,
        width: Option<u32>,
        height: Option<u32>,
    ) -> PyResult<Option<Vec<f64>>> {
        let moment = self.moment(py)?;
        let camera = moment.camera(camera.as_deref()).map_err(|problem| errors::camera(py, &problem))?;
        let (width, height) = moment.size(camera, width, height);
        let eyes = moment.view(camera).eyes(width, height);
        let matrix = match &eyes[..] {
            [eye] => eye.camera_matrix(),
            _ => None,
        };
        Ok(matrix.map(|matrix| matrix.transpose().iter().copied().collect()))
    }

    fn camera_pose(&self, py: Python<'_>, camera: Option<String>) -> PyResult<Vec<f64>> {
        let moment = self.moment(py)?;
        let camera = moment.camera(camera.as_deref()).map_err(|problem| errors::camera(py, &problem))?;
        let Isometry3 { translation, rotation } = moment.view(camera).pose;
        Ok(translation.vector.iter().chain(rotation.coords.iter()).copied().collect())
    }

    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let mut slot = self.slot.lock();
        let is_busy = matches!(*slot, Slot::Away);
        let before = if is_busy { Slot::Away } else { std::mem::replace(&mut *slot, Slot::Closed) };
        drop(slot);
        // Plugins are closed here.
        drop(before);
        if is_busy {
            return Err(errors::busy(py));
        }
        self.close_view(py);
        let writer = self.writer.lock().take();
        py.detach(|| {
            drop(writer);
            self.drawing.close();
        });
        Ok(())
    }
}
