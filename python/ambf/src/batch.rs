//! Many worlds of one scene in one object, with common arrays.
//!
//! A call reads the commands of all worlds, lets threads step them (each writes what is seen of its world into memory of
//! its own), and copies that into the arrays: nothing of Python is made for a world or a step, and Python's lock is held for the
//! two copies only.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use ambf_core::comm::{ActuatorCommand, HubIndex, ObjectKind, RayReading, RigidBodyCommand, SensorType, Snapshot};
use ambf_core::ids::{ActuatorId, BodyId, JointId, SensorId};
use ambf_core::scene::{ParameterChange, StateChange};
use ambf_core::sim::{LostState, StepPool, Stepper, Steps};
use ambf_core::text;
use ambf_core::together;
use nalgebra::{Isometry3, Vector3};
use numpy::{PyArray1, PyReadonlyArray1};
use parking_lot::Mutex;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::Buffer;
use crate::load::{self, Made, Wanted};
use crate::pool::Counts;
use crate::world::{slice, SLICE};
use crate::{contacts, errors, names, parameters, tree};

/// Worlds and places of two bodies, and numbers, of all contact points.
type Contacts<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

/// Kind of a body or joint that is not commanded.
const NONE: i8 = -1;

/// A body in the arrays.
struct Row {
    name: String,
    id: BodyId,
    object: HubIndex,
    offset: Isometry3<f64>,
    /// Its active joints: for each, the joint whose command it takes from the arrays.
    joints: Vec<Option<usize>>,
    /// All active joints below it.
    below: Vec<usize>,
}

/// A sensor in the arrays.
struct Sensor {
    name: String,
    id: SensorId,
    kind: SensorType,
    /// Columns of its rays; of a contact sensor, its column among contact sensors.
    columns: Range<usize>,
}

impl Sensor {
    fn has_rays(&self) -> bool {
        self.kind != SensorType::Contact
    }
}

/// An actuator in the arrays.
struct Actuator {
    name: String,
    id: ActuatorId,
    object: HubIndex,
}

/// What is the same in all worlds.
struct Layout {
    rows: Vec<Row>,
    joint_ids: Vec<JointId>,
    joint_names: Vec<String>,
    /// Places in `rows` by the bodies' numbers; -1: a passive body.
    places: Vec<i64>,
    sensors: Vec<Sensor>,
    /// Rays of all sensors.
    rays: usize,
    /// Contact sensors.
    feelers: usize,
    actuators: Vec<Actuator>,
}

/// Numbers of a body: pose and twist.
const SEEN: usize = 13;

/// What a ray sees that is no body in the arrays, and nothing.
const ELSEWHERE: i64 = -1;
const NOTHING: i64 = -2;

impl Layout {
    fn of(stepper: &Stepper) -> Self {
        let scene = stepper.simulation().scene();
        let joint_ids: Vec<JointId> = scene.joints.ids().collect();
        let joint_names = scene.joints.iter().map(|joint| joint.name.clone()).collect();
        let mut rows = Vec::new();
        for (object, entry) in stepper.objects().entries() {
            let ObjectKind::RigidBody(id, info) = &entry.info.kind else { continue };
            let joints = vec![None; info.joints.len()];
            let below = info.joints.iter().map(|joint| joint.index()).collect();
            let (name, offset) = (names::of(&entry.info), info.inertial_offset_inverse);
            rows.push((Row { name, id: *id, object, offset, joints, below }, info.joints.clone()));
        }
        // A joint is commanded through the body that has most joints below it: the base of its tree.
        for joint in &joint_ids {
            let above = rows.iter_mut().filter(|(_, joints)| joints.contains(joint));
            // The first of equals.
            let Some((row, joints)) = above.reduce(|best, next| if next.1.len() > best.1.len() { next } else { best })
            else {
                continue;
            };
            if let Some(place) = joints.iter().position(|other| other == joint) {
                row.joints[place] = Some(joint.index());
            }
        }
        let rows: Vec<Row> = rows.into_iter().map(|(row, _)| row).collect();
        let mut places = vec![-1; scene.bodies.len()];
        for (place, row) in (0..).zip(&rows) {
            places[row.id.index()] = place;
        }
        let (mut sensors, mut rays, mut feelers) = (Vec::new(), 0, 0);
        for (_, entry) in stepper.objects().entries() {
            let ObjectKind::Sensor(id, info) = &entry.info.kind else { continue };
            let (first, count) = match info.kind {
                SensorType::Contact => (&mut feelers, 1),
                SensorType::Proximity | SensorType::Resistance => (&mut rays, stepper.snapshot().sensors[*id].len()),
            };
            let columns = *first..*first + count;
            *first = columns.end;
            sensors.push(Sensor { name: names::of(&entry.info), id: *id, kind: info.kind, columns });
        }
        let mut actuators = Vec::new();
        for (object, entry) in stepper.objects().entries() {
            if let ObjectKind::Actuator(id, _) = &entry.info.kind {
                actuators.push(Actuator { name: names::of(&entry.info), id: *id, object });
            }
        }
        Self { rows, joint_ids, joint_names, places, sensors, rays, feelers, actuators }
    }

    /// Numbers that are seen of a world: those of bodies; positions, velocities and efforts of joints; measurements of rays and
    /// what they see; forces on contact sensors and how many bodies touch them; whether actuators hold something.
    fn size(&self) -> usize {
        self.of_actuators() + self.actuators.len()
    }

    /// Where the numbers of actuators begin.
    fn of_actuators(&self) -> usize {
        self.of_sensors() + 2 * (self.rays + self.feelers)
    }

    /// Where the numbers of sensors begin.
    fn of_sensors(&self) -> usize {
        SEEN * self.rows.len() + 3 * self.joint_ids.len()
    }

    fn see(&self, stepper: &Stepper, seen: &mut [f64]) {
        let snapshot = stepper.snapshot();
        let (seen, of_sensors) = seen.split_at_mut(self.of_sensors());
        self.sense(snapshot, of_sensors);
        let (bodies, joints) = seen.split_at_mut(SEEN * self.rows.len());
        for (numbers, row) in bodies.chunks_exact_mut(SEEN).zip(&self.rows) {
            let body = &snapshot.bodies[row.id];
            numbers[..7].copy_from_slice(&tree::seven(&body.body_pose(&row.offset)));
            numbers[7..10].copy_from_slice(&body.linear_velocity);
            numbers[10..].copy_from_slice(&body.angular_velocity);
        }
        let values = [&snapshot.joint_positions, &snapshot.joint_velocities, &snapshot.joint_efforts];
        for (numbers, values) in joints.chunks_exact_mut(self.joint_ids.len().max(1)).zip(values) {
            numbers.iter_mut().zip(&self.joint_ids).for_each(|(to, joint)| *to = values[*joint]);
        }
    }

    fn sense(&self, snapshot: &Snapshot, numbers: &mut [f64]) {
        let (measured, numbers) = numbers.split_at_mut(self.rays);
        let (sensed, numbers) = numbers.split_at_mut(self.rays);
        let (forces, numbers) = numbers.split_at_mut(self.feelers);
        let (touching, holding) = numbers.split_at_mut(self.feelers);
        for (held, actuator) in holding.iter_mut().zip(&self.actuators) {
            *held = f64::from(u8::from(snapshot.actuators[actuator.id]));
        }
        for sensor in &self.sensors {
            let (readings, columns) = (&snapshot.sensors[sensor.id], sensor.columns.clone());
            if sensor.has_rays() {
                for (column, reading) in columns.zip(readings) {
                    measured[column] = reading.measurement;
                    sensed[column] = self.place_of(reading) as f64;
                }
            } else {
                forces[columns.start] = readings.iter().map(|reading| reading.measurement).sum();
                touching[columns.start] = readings.len() as f64;
            }
        }
    }

    /// The place of the body that a ray sees.
    fn place_of(&self, reading: &RayReading) -> i64 {
        match reading.body {
            _ if !reading.triggered => NOTHING,
            Some(body) => self.places.get(body.index()).copied().unwrap_or(ELSEWHERE),
            None => ELSEWHERE,
        }
    }
}

/// What a thread does with a world.
#[derive(Default)]
enum Task {
    #[default]
    Step,
    /// Back to the start, and to a state.
    Reset(Box<StateChange>),
}

/// A world.
struct Lane {
    stepper: Box<Stepper>,
    layout: Arc<Layout>,
    task: Task,
    seen: Vec<f64>,
    /// Why its state was not set.
    refused: Option<String>,
    /// Bodies whose commands were ever in force.
    commanded: Vec<bool>,
}

impl Lane {
    fn new(stepper: Stepper, layout: &Arc<Layout>) -> Self {
        let (seen, commanded) = (vec![0.0; layout.size()], vec![false; layout.rows.len()]);
        let mut lane = Self {
            stepper: Box::new(stepper),
            layout: Arc::clone(layout),
            task: Task::Step,
            seen,
            refused: None,
            commanded,
        };
        lane.look();
        lane
    }

    fn look(&mut self) {
        self.layout.see(&self.stepper, &mut self.seen);
    }
}

impl Steps for Lane {
    const SIDE_BY_SIDE: usize = together::SIDE_BY_SIDE;

    fn advance(&mut self, at_most: u32) -> Result<u32, LostState> {
        let made = match std::mem::take(&mut self.task) {
            Task::Step => slice(&mut self.stepper, at_most),
            Task::Reset(state) => {
                self.stepper.reset();
                self.commanded.fill(false);
                self.refused = self.stepper.set_state(&state).err().map(|problem| problem.to_string());
                Ok(at_most)
            }
        };
        self.look();
        made
    }
}

/// The pool, and the process that its threads belong to: they are not there after a fork.
static POOL: Mutex<Option<(u32, Arc<StepPool<Lane>>)>> = Mutex::new(None);

fn pool() -> Arc<StepPool<Lane>> {
    let mut kept = POOL.lock();
    let process = std::process::id();
    match &*kept {
        Some((owner, pool)) if *owner == process => Arc::clone(pool),
        _ => {
            // The caller is a thread, too.
            let made = Arc::new(StepPool::new(threads() - 1));
            // The pool of the parent process may have been in use when it forked: it is left as it is.
            std::mem::forget(kept.replace((process, Arc::clone(&made))));
            made
        }
    }
}

/// Processors that this process may use.
fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Where the worlds are.
enum Place {
    Here(Vec<Lane>),
    Away,
    Closed,
}

/// Many worlds of one scene; see `_ambf.pyi`.
#[pyclass(frozen, weakref, module = "ambf._ambf")]
pub struct Batch {
    place: Mutex<Place>,
    layout: Arc<Layout>,
    count: usize,
    warnings: Vec<String>,
    poses: Buffer,
    twists: Buffer,
    joint_positions: Buffer,
    joint_velocities: Buffer,
    joint_efforts: Buffer,
    measurements: Buffer,
    sensed: Buffer,
    contact_forces: Buffer,
    touching: Buffer,
    holding: Buffer,
    times: Buffer,
    lost: Buffer,
    kinds: Buffer,
    wrenches: Buffer,
    target_poses: Buffer,
    target_twists: Buffer,
    joint_kinds: Buffer,
    joint_commands: Buffer,
}

impl Batch {
    fn take(&self, py: Python<'_>) -> PyResult<Vec<Lane>> {
        let mut place = self.place.lock();
        match std::mem::replace(&mut *place, Place::Away) {
            Place::Here(lanes) => Ok(lanes),
            before => {
                let error = if matches!(before, Place::Away) { errors::busy } else { errors::closed };
                *place = before;
                drop(place);
                Err(error(py))
            }
        }
    }

    fn give(&self, lanes: Vec<Lane>) {
        *self.place.lock() = Place::Here(lanes);
    }

    /// Lets `act` use the worlds.
    fn with<R>(&self, py: Python<'_>, act: impl FnOnce(&mut Vec<Lane>) -> R) -> PyResult<R> {
        let mut lanes = self.take(py)?;
        let result = act(&mut lanes);
        self.give(lanes);
        Ok(result)
    }

    /// Copies what was seen of all worlds into the arrays.
    fn show(&self, py: Python<'_>, lanes: &[Lane]) -> PyResult<()> {
        let (bodies, joints) = (self.layout.rows.len(), self.layout.joint_ids.len());
        let of_bodies = |buffer: &Buffer, part: std::ops::Range<usize>| {
            buffer.write::<f64>(py, |numbers| {
                let width = part.len();
                for (to, lane) in numbers.chunks_exact_mut((bodies * width).max(1)).zip(lanes) {
                    for (to, from) in to.chunks_exact_mut(width).zip(lane.seen.chunks_exact(SEEN)) {
                        to.copy_from_slice(&from[part.clone()]);
                    }
                }
            })
        };
        of_bodies(&self.poses, 0..7)?;
        of_bodies(&self.twists, 7..SEEN)?;
        for (index, buffer) in
            [&self.joint_positions, &self.joint_velocities, &self.joint_efforts].into_iter().enumerate()
        {
            buffer.write::<f64>(py, |numbers| {
                for (to, lane) in numbers.chunks_exact_mut(joints.max(1)).zip(lanes) {
                    to.copy_from_slice(&lane.seen[SEEN * bodies + index * joints..][..joints]);
                }
            })?;
        }
        let (rays, feelers, first) = (self.layout.rays, self.layout.feelers, self.layout.of_sensors());
        let of_sensors = [(&self.measurements, first, rays), (&self.contact_forces, first + 2 * rays, feelers)];
        for (buffer, begin, count) in of_sensors.into_iter().filter(|(_, _, count)| *count > 0) {
            buffer.write::<f64>(py, |numbers| {
                for (to, lane) in numbers.chunks_exact_mut(count).zip(lanes) {
                    to.copy_from_slice(&lane.seen[begin..][..count]);
                }
            })?;
        }
        let counted = [(&self.sensed, first + rays, rays), (&self.touching, first + 2 * rays + feelers, feelers)];
        for (buffer, begin, count) in counted.into_iter().filter(|(_, _, count)| *count > 0) {
            buffer.write::<i64>(py, |numbers| {
                for (to, lane) in numbers.chunks_exact_mut(count).zip(lanes) {
                    to.iter_mut().zip(&lane.seen[begin..][..count]).for_each(|(to, from)| *to = *from as i64);
                }
            })?;
        }
        let (first, count) = (self.layout.of_actuators(), self.layout.actuators.len());
        if count > 0 {
            self.holding.write::<bool>(py, |holding| {
                for (to, lane) in holding.chunks_exact_mut(count).zip(lanes) {
                    to.iter_mut().zip(&lane.seen[first..][..count]).for_each(|(to, from)| *to = *from != 0.0);
                }
            })?;
        }
        self.times.write::<f64>(py, |numbers| {
            numbers.iter_mut().zip(lanes).for_each(|(to, lane)| *to = lane.stepper.snapshot().sim_time);
        })?;
        self.lost.write::<bool>(py, |lost| {
            lost.iter_mut().zip(lanes).for_each(|(to, lane)| *to = lane.stepper.lost().is_some());
        })
    }

    /// Puts what the arrays command in force in all worlds, or nothing.
    fn command(&self, py: Python<'_>, lanes: &mut [Lane]) -> PyResult<()> {
        let (n, bodies, joints) = (self.count, self.layout.rows.len(), self.layout.joint_ids.len());
        let kinds = self.kinds.numbers::<i8>(py, n * bodies)?;
        let joint_kinds = self.joint_kinds.numbers::<i8>(py, n * joints)?;
        let (kinds, joint_kinds) = (kinds.as_slice()?, joint_kinds.as_slice()?);
        let numbers =
            [(&self.wrenches, 6 * bodies), (&self.target_poses, 7 * bodies), (&self.target_twists, 6 * bodies)];
        let [wrenches, poses, twists] = numbers.map(|(buffer, size)| buffer.numbers::<f64>(py, n * size));
        let (wrenches, poses, twists) = (wrenches?, poses?, twists?);
        let values = self.joint_commands.numbers::<f64>(py, n * joints)?;
        let all = Commands {
            kinds,
            joint_kinds,
            wrenches: wrenches.as_slice()?,
            poses: poses.as_slice()?,
            twists: twists.as_slice()?,
            values: values.as_slice()?,
        };
        for world in 0..n {
            all.check(&self.layout, world).map_err(|problem| errors::invalid_command(py, problem))?;
        }
        for (world, lane) in lanes.iter_mut().enumerate() {
            all.put_in_force(world, lane);
        }
        Ok(())
    }

    /// Lets threads do what is to be done, `steps` iterations in each world.
    fn run(&self, py: Python<'_>, lanes: Vec<Lane>, steps: impl Fn(usize) -> u32) -> PyResult<()> {
        let pool = pool();
        let mut work = pool.begin(lanes.into_iter().enumerate().map(|(index, lane)| (lane, steps(index))));
        let mut interrupted = None;
        while !py.detach(|| work.work_until(Instant::now() + SLICE)) {
            if let Err(error) = py.check_signals() {
                work.cancel();
                interrupted.get_or_insert(error);
            }
        }
        let done: Option<Vec<Lane>> = work.finish().into_iter().map(|stepped| stepped.world).collect();
        let Some(lanes) = done else {
            // A world panicked, and is gone; it was said on standard error.
            *self.place.lock() = Place::Closed;
            return Err(errors::closed(py));
        };
        let shown = self.show(py, &lanes);
        self.give(lanes);
        shown?;
        interrupted.map_or(Ok(()), Err)
    }
}

/// The arrays of commands of all worlds.
struct Commands<'a> {
    kinds: &'a [i8],
    joint_kinds: &'a [i8],
    wrenches: &'a [f64],
    poses: &'a [f64],
    twists: &'a [f64],
    values: &'a [f64],
}

impl Commands<'_> {
    /// The numbers that the kind of a body reads.
    fn of_body(&self, kind: i8, place: usize) -> Result<&[f64], ()> {
        match kind {
            NONE => Ok(&[]),
            0 => Ok(&self.wrenches[6 * place..][..6]),
            1 => Ok(&self.poses[7 * place..][..7]),
            2 => Ok(&self.twists[6 * place..][..6]),
            _ => Err(()),
        }
    }

    fn check(&self, layout: &Layout, world: usize) -> Result<(), String> {
        let bodies = layout.rows.len();
        for (index, row) in layout.rows.iter().enumerate() {
            let (place, name) = (world * bodies + index, &row.name);
            let kind = self.kinds[place];
            let numbers = self.of_body(kind, place).map_err(|()| {
                format!(
                    "{name} of world {world}: kind {kind}; expected NONE (-1), FORCE (0), POSITION (1) or VELOCITY (2)"
                )
            })?;
            if let Some(wrong) = numbers.iter().find(|number| !number.is_finite()) {
                return Err(format!("the command of {name} of world {world} holds {wrong}"));
            }
            if numbers.get(3..7).is_some_and(|quaternion| quaternion.iter().all(|number| *number == 0.0)) {
                return Err(format!(
                    "the quaternion commanded to {name} of world {world} is zero, which is no orientation"
                ));
            }
        }
        let first = world * layout.joint_ids.len();
        for (index, name) in layout.joint_names.iter().enumerate() {
            let (kind, value) = (self.joint_kinds[first + index], self.values[first + index]);
            if !(NONE..=2).contains(&kind) {
                return Err(format!(
                    "joint {name} of world {world}: kind {kind}; expected NONE (-1), EFFORT (0), POSITION (1) or VELOCITY (2)"
                ));
            }
            if kind != NONE && !value.is_finite() {
                return Err(format!("joint {name} of world {world} is commanded to {value}"));
            }
        }
        Ok(())
    }

    /// As `commands.rs` puts those of one world in force.
    fn put_in_force(&self, world: usize, lane: &mut Lane) {
        let Lane { stepper, layout, commanded, .. } = lane;
        let (bodies, first) = (layout.rows.len(), world * layout.joint_ids.len());
        for (index, row) in layout.rows.iter().enumerate() {
            let place = world * bodies + index;
            let kind = self.kinds[place];
            let kind_of = |joint: &Option<usize>| joint.map_or(NONE, |joint| self.joint_kinds[first + joint]);
            let joints = row.joints.iter().rposition(|joint| kind_of(joint) != NONE).map_or(0, |last| last + 1);
            if kind == NONE && joints == 0 && !commanded[index] {
                continue;
            }
            commanded[index] = true;
            let Some(command) = stepper.body_command(row.object) else { continue };
            command.joint_commands.clear();
            command.joint_command_types.clear();
            let (values, types) =
                (std::mem::take(&mut command.joint_commands), std::mem::take(&mut command.joint_command_types));
            *command =
                RigidBodyCommand { joint_commands: values, joint_command_types: types, ..RigidBodyCommand::default() };
            if kind != NONE {
                command.cartesian = kind.into();
            }
            let numbers = self.of_body(kind, place).unwrap_or_default();
            match kind {
                0 => (command.force, command.torque) = halves(numbers),
                1 => {
                    command.position = Vector3::from_column_slice(&numbers[..3]);
                    command.orientation.copy_from_slice(&numbers[3..]);
                }
                2 => (command.linear_velocity, command.angular_velocity) = halves(numbers),
                _ => (),
            }
            for joint in &row.joints[..joints] {
                let kind = kind_of(joint);
                let value = joint.filter(|_| kind != NONE).map_or(0.0, |joint| self.values[first + joint]);
                command.joint_command_types.push(kind.into());
                command.joint_commands.push(value);
            }
        }
    }
}

fn halves(six: &[f64]) -> (Vector3<f64>, Vector3<f64>) {
    (Vector3::from_column_slice(&six[..3]), Vector3::from_column_slice(&six[3..]))
}

/// Worlds, what is the same in all, and what was left out or guessed.
type Loaded = (Vec<Lane>, Arc<Layout>, Vec<String>);

/// Loads worlds of a scene on all threads.
fn load_all(wanted: &Wanted, count: usize) -> Result<Loaded, Vec<String>> {
    let Made { stepper, warnings, launch: _kept, .. } = load::load_world(wanted)?;
    let layout = Arc::new(Layout::of(&stepper));
    let mut lanes = Vec::with_capacity(count);
    lanes.push(Lane::new(stepper, &layout));
    let rest = count - 1;
    let chunk = rest.div_ceil(threads()).max(1);
    let load_some = |from: usize| {
        let some = (from..rest.min(from + chunk)).map(|_| load::load_world(wanted));
        some.map(|made| Ok(Lane::new(made?.stepper, &layout))).collect::<Result<Vec<Lane>, Vec<String>>>()
    };
    let loaded: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..rest).step_by(chunk).map(|from| scope.spawn(move || load_some(from))).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap_or_else(|_| Err(vec!["a world could not be built".into()])))
            .collect()
    });
    for some in loaded {
        lanes.extend(some?);
    }
    Ok((lanes, layout, warnings))
}

#[pymethods]
impl Batch {
    #[new]
    #[pyo3(signature = (count, models, launch_file, world, indexes, profile, solver, integrator, iterations, articulated, sleep, step))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        count: usize,
        models: Vec<std::path::PathBuf>,
        launch_file: Option<std::path::PathBuf>,
        world: Option<std::path::PathBuf>,
        indexes: Vec<usize>,
        profile: Option<String>,
        solver: Option<String>,
        integrator: Option<String>,
        iterations: Option<u32>,
        articulated: Option<bool>,
        sleep: Option<bool>,
        step: f64,
    ) -> PyResult<Self> {
        if count == 0 {
            return Err(PyValueError::new_err("n=0: expected 1 world or more"));
        }
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
            saving: false,
            wrenches: false,
            step,
            plugins: Vec::new(),
            crtk: Vec::new(),
            seed: None,
        };
        let (lanes, layout, warnings) =
            py.detach(|| load_all(&wanted, count)).map_err(|problems| errors::load(py, problems))?;
        let (bodies, joints) = (layout.rows.len(), layout.joint_ids.len());
        let numbers = |shape: &[usize]| Buffer::command::<f64>(py, shape, &[0.0]);
        let kinds = |shape: &[usize]| Buffer::command::<i8>(py, shape, &[NONE]);
        let batch = Self {
            place: Mutex::new(Place::Away),
            count,
            warnings,
            poses: numbers(&[count, bodies, 7])?,
            twists: numbers(&[count, bodies, 6])?,
            joint_positions: numbers(&[count, joints])?,
            joint_velocities: numbers(&[count, joints])?,
            joint_efforts: numbers(&[count, joints])?,
            measurements: numbers(&[count, layout.rays])?,
            sensed: Buffer::command::<i64>(py, &[count, layout.rays], &[NOTHING])?,
            contact_forces: numbers(&[count, layout.feelers])?,
            touching: Buffer::command::<i64>(py, &[count, layout.feelers], &[0])?,
            holding: Buffer::command::<bool>(py, &[count, layout.actuators.len()], &[false])?,
            times: numbers(&[count])?,
            lost: Buffer::command::<bool>(py, &[count], &[false])?,
            kinds: kinds(&[count, bodies])?,
            wrenches: numbers(&[count, bodies, 6])?,
            target_poses: Buffer::command::<f64>(py, &[count, bodies, 7], &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])?,
            target_twists: numbers(&[count, bodies, 6])?,
            joint_kinds: kinds(&[count, joints])?,
            joint_commands: numbers(&[count, joints])?,
            layout,
        };
        batch.show(py, &lanes)?;
        batch.give(lanes);
        Ok(batch)
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.iter().map(|warning| text::lines(warning).into_owned()).collect()
    }

    #[getter]
    fn bodies(&self) -> Vec<String> {
        self.layout.rows.iter().map(|row| row.name.clone()).collect()
    }

    #[getter]
    fn joints(&self) -> Vec<String> {
        self.layout.joint_names.clone()
    }

    /// Places of the joints below a body in the arrays.
    fn body_joints(&self, body: usize) -> PyResult<Vec<usize>> {
        let row =
            self.layout.rows.get(body).ok_or_else(|| PyValueError::new_err(format!("there is no body {body}")))?;
        Ok(row.below.clone())
    }

    /// Names of the sensors, their types, and the columns of their rays, or of a contact sensor among those.
    #[getter]
    fn sensors(&self) -> Vec<(String, &'static str, usize, usize)> {
        let kind = |kind: SensorType| match kind {
            SensorType::Proximity => "proximity",
            SensorType::Resistance => "resistance",
            SensorType::Contact => "contact",
        };
        let sensors = self.layout.sensors.iter();
        sensors.map(|one| (one.name.clone(), kind(one.kind), one.columns.start, one.columns.end)).collect()
    }

    #[getter]
    fn actuators(&self) -> Vec<String> {
        self.layout.actuators.iter().map(|actuator| actuator.name.clone()).collect()
    }

    /// Lets an actuator hold what a sensor sees, or else a body, in the worlds in which `hold` says so, and let go in the others; in those of
    /// `mask`.
    fn hold(
        &self,
        py: Python<'_>,
        actuator: usize,
        mask: PyReadonlyArray1<'_, bool>,
        hold: PyReadonlyArray1<'_, bool>,
        sensor: &str,
        body: &str,
    ) -> PyResult<()> {
        let no_actuator = || PyValueError::new_err(format!("there is no actuator {actuator}"));
        let found = self.layout.actuators.get(actuator).ok_or_else(no_actuator)?;
        let (mask, hold) = (mask.as_slice()?, hold.as_slice()?);
        if [mask, hold].iter().any(|worlds| worlds.len() != self.count) {
            return Err(PyValueError::new_err(format!("masks of {} and {} worlds", mask.len(), hold.len())));
        }
        let command = ActuatorCommand {
            actuate: true,
            body_name: body.to_owned(),
            use_sensor_data: !sensor.is_empty(),
            sensor_identifier: sensor.to_owned(),
            ..ActuatorCommand::default()
        };
        self.with(py, |lanes| {
            // All worlds are of one scene.
            if let Some(lane) = lanes.first().filter(|_| hold.contains(&true)) {
                lane.stepper.simulation().scene().check_actuator_command(found.id, &command)?;
            }
            for (lane, hold) in lanes.iter_mut().zip(hold).zip(mask).filter_map(|(of, is_meant)| is_meant.then_some(of))
            {
                if let Some(in_force) = lane.stepper.actuator_command(found.object) {
                    match hold {
                        true => in_force.clone_from(&command),
                        false => *in_force = ActuatorCommand::default(),
                    }
                }
            }
            Ok(())
        })?
        .map_err(|problem: String| errors::not_found(py, &problem))
    }

    #[getter]
    fn joint_types(&self, py: Python<'_>) -> PyResult<Vec<&'static str>> {
        self.with(py, |lanes| {
            let joints = lanes.first().map(|lane| &lane.stepper.simulation().scene().joints);
            joints.into_iter().flat_map(|joints| joints.iter().map(|joint| joint.joint_type.name())).collect()
        })
    }

    /// The array of that name.
    fn array(&self, py: Python<'_>, name: &str) -> PyResult<Py<PyAny>> {
        let buffer = match name {
            "poses" => &self.poses,
            "twists" => &self.twists,
            "joint_positions" => &self.joint_positions,
            "joint_velocities" => &self.joint_velocities,
            "joint_efforts" => &self.joint_efforts,
            "measurements" => &self.measurements,
            "sensed" => &self.sensed,
            "contact_forces" => &self.contact_forces,
            "touching" => &self.touching,
            "holding" => &self.holding,
            "times" => &self.times,
            "lost" => &self.lost,
            "kinds" => &self.kinds,
            "wrenches" => &self.wrenches,
            "target_poses" => &self.target_poses,
            "target_twists" => &self.target_twists,
            "joint_kinds" => &self.joint_kinds,
            "joint_commands" => &self.joint_commands,
            _ => return Err(PyValueError::new_err(format!("there is no array {name}"))),
        };
        Ok(buffer.view(py))
    }

    fn step(&self, py: Python<'_>, steps: Counts) -> PyResult<()> {
        if let Counts::Each(steps) = &steps {
            if steps.len() != self.count {
                let problem = format!("{} numbers of steps for {} worlds", steps.len(), self.count);
                return Err(PyValueError::new_err(problem));
            }
        }
        let mut lanes = self.take(py)?;
        if let Err(error) = self.command(py, &mut lanes) {
            self.give(lanes);
            return Err(error);
        }
        // What was lost waits for its reset.
        let is_lost: Vec<bool> = lanes.iter().map(|lane| lane.stepper.lost().is_some()).collect();
        self.run(py, lanes, |world| match &steps {
            _ if is_lost[world] => 0,
            Counts::Same(steps) => *steps,
            Counts::Each(steps) => steps[world],
        })
    }

    /// Resets the worlds of `mask`, then sets their states where the numbers are some; commands of these worlds are empty. `poses`
    /// and `twists`: of all bodies.
    fn reset(
        &self,
        py: Python<'_>,
        mask: Vec<bool>,
        positions: Option<PyReadonlyArray1<'_, f64>>,
        rates: Option<PyReadonlyArray1<'_, f64>>,
        poses: Option<PyReadonlyArray1<'_, f64>>,
        twists: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<()> {
        let (bodies, joints) = (self.layout.rows.len(), self.layout.joint_ids.len());
        let given = [(&positions, joints), (&rates, joints), (&poses, 7 * bodies), (&twists, 6 * bodies)];
        let mut slices: [&[f64]; 4] = Default::default();
        for (slice, (array, width)) in slices.iter_mut().zip(given) {
            if let Some(array) = array {
                *slice = array.as_slice()?;
                if slice.len() != self.count * width {
                    return Err(PyValueError::new_err(format!("{} numbers, not {}", slice.len(), self.count * width)));
                }
            }
        }
        let [positions, rates, poses, twists] = slices;
        if mask.len() != self.count {
            return Err(PyValueError::new_err(format!("mask: {} worlds, not {}", mask.len(), self.count)));
        }
        let mut lanes = self.take(py)?;
        for (world, lane) in lanes.iter_mut().enumerate().filter(|(world, _)| mask[*world]) {
            let part = |numbers: &[f64], width: usize| {
                numbers.get(world * width..(world + 1) * width).unwrap_or_default().to_vec()
            };
            let of_joints = |numbers: Vec<f64>| {
                let pairs = self.layout.joint_ids.iter().copied().zip(numbers);
                pairs.filter(|(_, number)| !number.is_nan()).collect::<Vec<_>>()
            };
            let mut state = StateChange {
                positions: of_joints(part(positions, joints)),
                rates: of_joints(part(rates, joints)),
                ..StateChange::default()
            };
            let is_given = |numbers: &[f64]| !numbers.iter().any(|number| number.is_nan());
            for (row, pose) in self.layout.rows.iter().zip(part(poses, 7 * bodies).as_chunks::<7>().0) {
                if is_given(pose) {
                    match tree::pose_of(*pose) {
                        Ok(pose) => state.poses.push((row.id, pose)),
                        Err(error) => {
                            lane.task = Task::Step;
                            self.give_untouched(lanes);
                            return Err(error);
                        }
                    }
                }
            }
            for (row, twist) in self.layout.rows.iter().zip(part(twists, 6 * bodies).as_chunks::<6>().0) {
                if is_given(twist) {
                    state.twists.push((row.id, <[Vector3<f64>; 2]>::from(halves(twist))));
                }
            }
            lane.task = Task::Reset(Box::new(state));
        }
        self.forget_commands(py, &mask)?;
        self.run(py, lanes, |world| u32::from(mask[world]))?;
        self.with(py, |lanes| {
            let refused = lanes.iter_mut().enumerate().filter_map(|(world, lane)| Some((world, lane.refused.take()?)));
            refused.collect::<Vec<_>>().into_iter().next()
        })?
        .map_or(Ok(()), |(world, problem)| Err(errors::refused(py, &format!("world {world}: {problem}"))))
    }

    /// Of all contact points: the world and the places of the two bodies, and their numbers.
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Contacts<'py>> {
        let (mut places, mut numbers) = (Vec::new(), Vec::new());
        self.with(py, |lanes| {
            for (world, lane) in (0..).zip(lanes.iter()) {
                let place = |body: BodyId| self.layout.places.get(body.index()).copied().unwrap_or(-1);
                contacts::gather(&lane.stepper, &mut numbers, |first, second| {
                    places.extend([world, place(first), place(second)]);
                });
            }
        })?;
        Ok((PyArray1::from_vec(py, places), PyArray1::from_vec(py, numbers)))
    }

    /// Why worlds are lost: their numbers and what happened.
    fn problems(&self, py: Python<'_>) -> PyResult<Vec<(usize, String)>> {
        self.with(py, |lanes| {
            let lost =
                lanes.iter().enumerate().filter_map(|(world, lane)| Some((world, lane.stepper.lost()?.to_string())));
            lost.map(|(world, problem)| (world, text::lines(&problem).into_owned())).collect()
        })
    }

    /// Changes what is named, in each world as its part of the numbers says, or nothing; NaN leaves what it stands for as it is.
    fn set_parameters(&self, py: Python<'_>, values: Vec<(String, PyReadonlyArray1<'_, f64>)>) -> PyResult<()> {
        let bodies: Vec<BodyId> = self.layout.rows.iter().map(|row| row.id).collect();
        let mut changes = Vec::with_capacity(self.count);
        for world in 0..self.count {
            let mut change = ParameterChange::default();
            for (name, numbers) in &values {
                let numbers = numbers.as_slice()?;
                let width = numbers.len() / self.count;
                let part = &numbers[world * width..][..width];
                parameters::add(&mut change, name, part, (&bodies, &self.layout.joint_ids))?;
            }
            changes.push(change);
        }
        self.with(py, |lanes| {
            for (lane, change) in lanes.iter().zip(&changes) {
                lane.stepper.check_parameters(change)?;
            }
            lanes.iter_mut().zip(&changes).try_for_each(|(lane, change)| lane.stepper.set_parameters(change))
        })?
        .map_err(|problem| errors::parameter(&problem))
    }

    /// Numbers of the bodies, of the joints, and gravity of all worlds: see `parameters.rs`.
    #[allow(clippy::type_complexity)]
    fn parameters<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
        let bodies: Vec<BodyId> = self.layout.rows.iter().map(|row| row.id).collect();
        let [bodies, joints, gravity] = self.with(py, |lanes| {
            let scenes = || lanes.iter().map(|lane| lane.stepper.simulation().scene());
            [
                scenes().flat_map(|scene| parameters::of_bodies(scene, &bodies)).collect::<Vec<f64>>(),
                scenes().flat_map(|scene| parameters::of_joints(scene, &self.layout.joint_ids)).collect(),
                scenes().flat_map(|scene| [scene.gravity.x, scene.gravity.y, scene.gravity.z]).collect(),
            ]
        })?;
        Ok((PyArray1::from_vec(py, bodies), PyArray1::from_vec(py, joints), PyArray1::from_vec(py, gravity)))
    }

    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let mut place = self.place.lock();
        let is_busy = matches!(*place, Place::Away);
        let before = if is_busy { Place::Away } else { std::mem::replace(&mut *place, Place::Closed) };
        drop(place);
        py.detach(|| drop(before));
        match is_busy {
            true => Err(errors::busy(py)),
            false => Ok(()),
        }
    }
}

impl Batch {
    /// Gives worlds back with which nothing was done.
    fn give_untouched(&self, mut lanes: Vec<Lane>) {
        lanes.iter_mut().for_each(|lane| lane.task = Task::Step);
        self.give(lanes);
    }

    /// Empties the commands of worlds.
    fn forget_commands(&self, py: Python<'_>, mask: &[bool]) -> PyResult<()> {
        for buffer in [&self.kinds, &self.joint_kinds] {
            buffer.write::<i8>(py, |kinds| {
                let width = (kinds.len() / self.count).max(1);
                let worlds = kinds.chunks_exact_mut(width).zip(mask);
                worlds.filter(|(_, is_meant)| **is_meant).for_each(|(kinds, _)| kinds.fill(NONE));
            })?;
        }
        Ok(())
    }
}
