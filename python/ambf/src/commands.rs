//! From arrays to commands of bodies and joints.

use std::sync::OnceLock;

use ambf_core::comm::{CartesianCommandType, Command, HubIndex, RigidBodyCommand, RigidBodyInfo};
use ambf_core::ids::{BodyId, JointId};
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
    /// The body in snapshots.
    pub id: BodyId,
    /// Inverse of the inertial offset.
    pub offset: Isometry3<f64>,
    pub joint_names: Vec<String>,
    /// The active joints below it.
    pub joints: Vec<JointId>,
}

impl Row {
    pub fn new(name: String, object: HubIndex, id: BodyId, info: &RigidBodyInfo) -> Self {
        let RigidBodyInfo { inertial_offset_inverse: offset, joint_names, joints, .. } = info.clone();
        Self { name, object, id, offset, joint_names, joints }
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

/// The commands of all bodies that the arrays last asked for, in memory that is used again for the next ones.
pub struct Requested {
    /// One a body: whether a command was ever in force.
    pub commanded: Vec<bool>,
    /// One a body; those of `rows` are of the present step.
    commands: Vec<RigidBodyCommand>,
    /// Bodies whose commands are put in force in the present step.
    rows: Vec<usize>,
}

impl Requested {
    /// For `count` bodies, none of them commanded.
    pub fn new(count: usize) -> Self {
        Self {
            commanded: vec![false; count],
            commands: vec![RigidBodyCommand::default(); count],
            rows: Vec::with_capacity(count),
        }
    }
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

/// Position and quaternion before anybody has written them.
const NO_POSE: [f64; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];

impl BodyCommands {
    pub fn new(py: Python<'_>, count: usize) -> PyResult<Self> {
        Ok(Self {
            kinds: Buffer::command(py, &[count], &[NONE])?,
            wrenches: Buffer::command(py, &[count, 6], &[0.0])?,
            poses: Buffer::command(py, &[count, 7], &NO_POSE)?,
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

    /// Lets the arrays hold what they held at first: no commands.
    pub fn clear(&self, py: Python<'_>) -> PyResult<()> {
        self.kinds.write::<i8>(py, |kinds| kinds.fill(NONE))?;
        self.wrenches.write::<f64>(py, |wrenches| wrenches.fill(0.0))?;
        self.poses.write::<f64>(py, |poses| {
            poses.iter_mut().zip(NO_POSE.iter().cycle()).for_each(|(to, from)| *to = *from);
        })?;
        self.twists.write::<f64>(py, |twists| twists.fill(0.0))?;
        for commands in self.joints.iter().filter_map(OnceLock::get) {
            commands.kinds.write::<i8>(py, |kinds| kinds.fill(NONE))?;
            commands.values.write::<f64>(py, |values| values.fill(0.0))?;
        }
        Ok(())
    }

    /// Puts everything that the arrays say in force, or nothing.
    pub fn put_in_force(
        &self,
        py: Python<'_>,
        rows: &[Row],
        stepper: &mut Stepper,
        requested: &mut Requested,
    ) -> PyResult<()> {
        self.read(py, rows, requested)?;
        let Requested { commanded, commands, rows: changed } = requested;
        for &row in &*changed {
            commanded[row] = true;
            if let Some(in_force) = stepper.body_command(rows[row].object) {
                in_force.copy_from(&commands[row]);
            }
        }
        Ok(())
    }

    /// Reads the commands of all bodies that have one now or had one before.
    fn read(&self, py: Python<'_>, rows: &[Row], requested: &mut Requested) -> PyResult<()> {
        let Requested { commanded, commands, rows: changed } = requested;
        changed.clear();
        let kinds = self.kinds.numbers::<i8>(py, self.count)?;
        let wrenches = self.wrenches.numbers::<f64>(py, 6 * self.count)?;
        let twists = self.twists.numbers::<f64>(py, 6 * self.count)?;
        let poses = self.poses.numbers::<f64>(py, 7 * self.count)?;
        let (kinds, wrenches) = (kinds.as_slice()?, wrenches.as_slice()?);
        let (twists, poses) = (twists.as_slice()?, poses.as_slice()?);
        for (row, (body, command)) in rows.iter().zip(commands).enumerate() {
            command.copy_from(&RigidBodyCommand::default());
            if let Some(joints) = self.joints[row].get() {
                joints.read(py, body, command)?;
            }
            let kind = kinds[row];
            if kind == NONE && command.joint_commands.is_empty() && !commanded[row] {
                continue;
            }
            if kind != NONE {
                command.cartesian = kind.into();
            }
            let numbers = match command.cartesian {
                _ if kind == NONE => &[],
                CartesianCommandType::Force => {
                    let numbers = &wrenches[6 * row..][..6];
                    (command.force, command.torque) = halves(numbers);
                    numbers
                }
                CartesianCommandType::Velocity => {
                    let numbers = &twists[6 * row..][..6];
                    (command.linear_velocity, command.angular_velocity) = halves(numbers);
                    numbers
                }
                CartesianCommandType::Position => {
                    let numbers = &poses[7 * row..][..7];
                    command.position = Vector3::from_column_slice(&numbers[..3]);
                    command.orientation.copy_from_slice(&numbers[3..]);
                    numbers
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
            if numbers.get(3..7).is_some_and(|quaternion| quaternion.iter().all(|number| *number == 0.0)) {
                let problem = format!("the quaternion commanded to {} is zero, which is no orientation", body.name);
                return Err(errors::invalid_command(py, problem));
            }
            changed.push(row);
        }
        Ok(())
    }
}

fn halves(six: &[f64]) -> (Vector3<f64>, Vector3<f64>) {
    (Vector3::from_column_slice(&six[..3]), Vector3::from_column_slice(&six[3..]))
}

impl JointCommands {
    /// Appends types and values up to the last joint that is commanded.
    fn read(&self, py: Python<'_>, row: &Row, command: &mut RigidBodyCommand) -> PyResult<()> {
        let kinds = self.kinds.numbers::<i8>(py, row.joints.len())?;
        let values = self.values.numbers::<f64>(py, row.joints.len())?;
        let (kinds, values) = (kinds.as_slice()?, values.as_slice()?);
        let count = kinds.iter().rposition(|kind| *kind != NONE).map_or(0, |last| last + 1);
        for ((&kind, &value), name) in kinds[..count].iter().zip(values).zip(&row.joint_names) {
            if !(NONE..=2).contains(&kind) {
                return Err(errors::invalid_command(
                    py,
                    format!(
                        "joint {name} of {}: kind {kind}; expected NONE (-1), EFFORT (0), POSITION (1) or VELOCITY (2)",
                        row.name
                    ),
                ));
            }
            // The value of a joint that is not commanded has no meaning.
            let value = if kind == NONE { 0.0 } else { value };
            if !value.is_finite() {
                let problem = format!("joint {name} of {} is commanded to {value}", row.name);
                return Err(errors::invalid_command(py, problem));
            }
            // An unknown type leaves its joint alone, which is what NONE means.
            command.joint_command_types.push(kind.into());
            command.joint_commands.push(value);
        }
        Ok(())
    }
}
