//! From arrays to commands of bodies and joints.

use std::sync::OnceLock;

use ambf_core::comm::{CartesianCommandType, HubIndex, JointCommandType, RigidBodyCommand, RigidBodyInfo};
use ambf_core::sim::Stepper;
use nalgebra::{Isometry3, Vector3};
use pyo3::prelude::*;

use crate::arrays::Buffer;
use crate::errors;

/// Kind of a body or joint that is not commanded.
const NONE: i8 = -1;

/// A body that can be seen and commanded.
pub struct Row {
    pub name: String,
    /// Position among the objects of the stepper.
    object: HubIndex,
    /// Index into the snapshot's bodies.
    pub index: usize,
    /// Inverse of the inertial offset.
    pub offset: Isometry3<f64>,
    pub joint_names: Vec<String>,
    /// Indices into the snapshot's joints.
    pub joints: Vec<usize>,
}

impl Row {
    pub fn new(name: String, object: HubIndex, index: usize, info: &RigidBodyInfo) -> Self {
        let RigidBodyInfo { inertial_offset_inverse: offset, joint_names, joints, .. } = info.clone();
        Self { name, object, index, offset, joint_names, joints }
    }
}

/// Commands of the joints below a body.
struct JointCommands {
    kinds: Buffer,
    values: Buffer,
}

/// What the arrays held at one moment.
pub struct SavedArrays {
    kinds: Vec<i8>,
    wrenches: Vec<f64>,
    poses: Vec<f64>,
    twists: Vec<f64>,
    /// One a body; `None`: not commanded.
    joints: Vec<Option<(Vec<i8>, Vec<f64>)>>,
}

/// What the arrays of one body say.
struct Wanted {
    row: usize,
    command: RigidBodyCommand,
}

/// The arrays through which bodies and joints are commanded.
pub struct BodyCommands {
    pub kinds: Buffer,
    pub wrenches: Buffer,
    pub poses: Buffer,
    pub twists: Buffer,
    /// One a body, made when it is first asked for.
    joints: Vec<OnceLock<JointCommands>>,
    count: usize,
}

impl BodyCommands {
    pub fn new(py: Python<'_>, count: usize) -> PyResult<Self> {
        Ok(Self {
            kinds: Buffer::command(py, &[count], &[NONE])?,
            wrenches: Buffer::command(py, &[count, 6], &[0.0])?,
            poses: Buffer::command(py, &[count, 7], &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])?,
            twists: Buffer::command(py, &[count, 6], &[0.0])?,
            joints: (0..count).map(|_| OnceLock::new()).collect(),
            count,
        })
    }

    /// Kinds and values, for the `count` joints below a body.
    pub fn of_joints(&self, py: Python<'_>, body: usize, count: usize) -> PyResult<(Py<PyAny>, Py<PyAny>)> {
        let place = &self.joints[body];
        let commands = match place.get() {
            Some(commands) => commands,
            None => {
                let kinds = Buffer::command(py, &[count], &[NONE])?;
                let made = JointCommands { kinds, values: Buffer::command(py, &[count], &[0.0])? };
                // Another thread may have been quicker.
                place.get_or_init(|| made)
            }
        };
        Ok((commands.kinds.view(py), commands.values.view(py)))
    }

    /// What the arrays hold.
    pub fn save(&self, py: Python<'_>) -> PyResult<SavedArrays> {
        let of_joints = |commands: &JointCommands| {
            PyResult::Ok((commands.kinds.read_all(py, <[i8]>::to_vec)?, commands.values.read_all(py, <[f64]>::to_vec)?))
        };
        Ok(SavedArrays {
            kinds: self.kinds.read_all(py, <[i8]>::to_vec)?,
            wrenches: self.wrenches.read_all(py, <[f64]>::to_vec)?,
            poses: self.poses.read_all(py, <[f64]>::to_vec)?,
            twists: self.twists.read_all(py, <[f64]>::to_vec)?,
            joints: self
                .joints
                .iter()
                .map(|commands| commands.get().map(of_joints).transpose())
                .collect::<PyResult<_>>()?,
        })
    }

    /// Lets the arrays hold what they held.
    pub fn restore(&self, py: Python<'_>, saved: &SavedArrays) -> PyResult<()> {
        self.kinds.write_all(py, &saved.kinds)?;
        self.wrenches.write_all(py, &saved.wrenches)?;
        self.poses.write_all(py, &saved.poses)?;
        self.twists.write_all(py, &saved.twists)?;
        for (commands, saved) in self.joints.iter().zip(&saved.joints) {
            match (commands.get(), saved) {
                (Some(commands), Some((kinds, values))) => {
                    commands.kinds.write_all(py, kinds)?;
                    commands.values.write_all(py, values)?;
                }
                // They were asked for since.
                (Some(commands), None) => commands.kinds.write::<i8>(py, |kinds| kinds.fill(NONE))?,
                _ => (),
            }
        }
        Ok(())
    }

    /// Puts everything that the arrays say in force, or nothing.
    pub fn put_in_force(
        &self,
        py: Python<'_>,
        rows: &[Row],
        stepper: &mut Stepper,
        commanded: &mut [bool],
    ) -> PyResult<()> {
        let all = self.wanted(py, rows, commanded)?;
        for Wanted { row, command } in all {
            commanded[row] = true;
            if let Some(in_force) = stepper.body_command(rows[row].object) {
                *in_force = command;
            }
        }
        Ok(())
    }

    fn wanted(&self, py: Python<'_>, rows: &[Row], commanded: &[bool]) -> PyResult<Vec<Wanted>> {
        let kinds = self.kinds.read(py, self.count, <[i8]>::to_vec)?;
        let mut all = Vec::new();
        for (row, kind) in kinds.into_iter().enumerate() {
            let (types, values) = match self.joints[row].get() {
                Some(commands) => joint_commands(py, &rows[row], commands)?,
                None => Default::default(),
            };
            if kind == NONE && values.is_empty() && !commanded[row] {
                continue;
            }
            let command = RigidBodyCommand {
                joint_commands: values,
                joint_command_types: types,
                ..self.cartesian(py, &rows[row], row, kind)?
            };
            all.push(Wanted { row, command });
        }
        Ok(all)
    }

    fn cartesian(&self, py: Python<'_>, body: &Row, row: usize, kind: i8) -> PyResult<RigidBodyCommand> {
        let mut command = RigidBodyCommand::default();
        if kind == NONE {
            return Ok(command);
        }
        command.cartesian = CartesianCommandType::from(kind);
        let numbers = match command.cartesian {
            CartesianCommandType::Force => {
                let six = self.six(py, &self.wrenches, row)?;
                (command.force, command.torque) = halves(&six);
                six.to_vec()
            }
            CartesianCommandType::Velocity => {
                let six = self.six(py, &self.twists, row)?;
                (command.linear_velocity, command.angular_velocity) = halves(&six);
                six.to_vec()
            }
            CartesianCommandType::Position => {
                let place = |all: &[f64]| all[7 * row..7 * row + 7].to_vec();
                let pose = self.poses.read(py, 7 * self.count, place)?;
                command.position = Vector3::new(pose[0], pose[1], pose[2]);
                command.orientation = [pose[3], pose[4], pose[5], pose[6]];
                pose
            }
            CartesianCommandType::Unknown(kind) => {
                return Err(errors::invalid_command(
                    py,
                    format!(
                        "{}: kind {kind} of a body; expected NONE (-1), FORCE (0), POSITION (1) or VELOCITY (2)",
                        body.name
                    ),
                ))
            }
        };
        if let Some(wrong) = numbers.iter().find(|number| !number.is_finite()) {
            return Err(errors::invalid_command(py, format!("the command of {} holds {wrong}", body.name)));
        }
        Ok(command)
    }

    fn six(&self, py: Python<'_>, buffer: &Buffer, row: usize) -> PyResult<[f64; 6]> {
        buffer.read(py, 6 * self.count, |all| std::array::from_fn(|i| all[6 * row + i]))
    }
}

fn halves(six: &[f64; 6]) -> (Vector3<f64>, Vector3<f64>) {
    (Vector3::new(six[0], six[1], six[2]), Vector3::new(six[3], six[4], six[5]))
}

/// Types and values up to the last joint that is commanded.
fn joint_commands(py: Python<'_>, row: &Row, commands: &JointCommands) -> PyResult<(Vec<JointCommandType>, Vec<f64>)> {
    let count = row.joints.len();
    let mut kinds = commands.kinds.read(py, count, <[i8]>::to_vec)?;
    kinds.truncate(kinds.iter().rposition(|kind| *kind != NONE).map_or(0, |last| last + 1));
    let mut values: Vec<f64> = commands.values.read(py, count, |values: &[f64]| values[..kinds.len()].to_vec())?;
    for ((kind, value), name) in kinds.iter().zip(&mut values).zip(&row.joint_names) {
        if !(NONE..=2).contains(kind) {
            return Err(errors::invalid_command(
                py,
                format!(
                    "joint {name} of {}: kind {kind}; expected NONE (-1), EFFORT (0), POSITION (1) or VELOCITY (2)",
                    row.name
                ),
            ));
        }
        if *kind == NONE {
            // Nobody looks at it.
            *value = 0.0;
        }
        if !value.is_finite() {
            return Err(errors::invalid_command(py, format!("joint {name} of {} is commanded to {value}", row.name)));
        }
    }
    // An unknown type leaves its joint alone, which is what NONE means.
    Ok((kinds.into_iter().map(JointCommandType::from).collect(), values))
}
