//! A rigid body on the wire: `RigidBodyState` and `RigidBodyCmd`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;

use ambf_core::comm::{CartesianCommandType, JointCommandType, ObjectInfo, RigidBodyCommand, RigidBodyInfo, Snapshot};
use ambf_core::ids::{BodyId, JointId, Table};

use super::Builder;
use crate::ros::messages::{
    ambf_msgs, from_point, from_quaternion, from_vector, geometry_msgs, header, narrow, point, pose, string, vector,
};
use crate::ros::received::{FromClient, Wire, BOOL, POSE, TWIST, WRENCH};
use crate::ros::step::Kind;

/// What clients have asked to see, set by commands and read when a state is made.
#[derive(Debug, Default)]
pub(in crate::ros) struct Requests {
    /// Once asked for, names stay.
    children_names: AtomicBool,
    joint_names: AtomicBool,
    /// As the latest command says.
    joint_positions: AtomicBool,
}

impl Requests {
    /// Takes the flags of `message`.
    pub fn note(&self, message: &ambf_msgs::RigidBodyCmd) {
        self.children_names.fetch_or(message.publish_children_names, Ordering::Relaxed);
        self.joint_names.fetch_or(message.publish_joint_names, Ordering::Relaxed);
        self.joint_positions.store(message.publish_joint_positions, Ordering::Relaxed);
    }
}

/// Makes the states of one body.
pub(in crate::ros) struct StateSource {
    /// Index into [`Snapshot::bodies`].
    index: BodyId,
    info: RigidBodyInfo,
    name: String,
    identifier: String,
    requests: Arc<Requests>,
    /// Joint values that were last asked for; they keep being sent when nobody asks any more.
    positions: Vec<f32>,
    velocities: Vec<f32>,
    efforts: Vec<f32>,
    names: bool,
}

impl StateSource {
    /// The body at `index` of the snapshot's bodies.
    pub fn new(index: BodyId, info: RigidBodyInfo, name: &str, identifier: &str, requests: Arc<Requests>) -> Self {
        Self {
            index,
            info,
            name: name.to_owned(),
            identifier: identifier.to_owned(),
            requests,
            positions: Vec::new(),
            velocities: Vec::new(),
            efforts: Vec::new(),
            names: true,
        }
    }

    /// Leaves out names, whoever asks for them.
    pub fn without_names(self) -> Self {
        Self { names: false, ..self }
    }

    /// The state as of `snapshot`; `None` when the snapshot does not know the body.
    pub fn message(&mut self, snapshot: &Snapshot) -> Option<ambf_msgs::RigidBodyState> {
        let body = snapshot.bodies.get(self.index)?;
        let names = |wanted: bool, asked: &AtomicBool, names: &Vec<String>| {
            if self.names && (wanted || asked.load(Ordering::Relaxed)) {
                names.clone()
            } else {
                Vec::new()
            }
        };
        if self.info.publish_joint_positions || self.requests.joint_positions.load(Ordering::Relaxed) {
            let joints = &self.info.joints;
            select(&mut self.positions, &snapshot.joint_positions, joints);
            select(&mut self.velocities, &snapshot.joint_velocities, joints);
            select(&mut self.efforts, &snapshot.joint_efforts, joints);
        }
        let wrench = snapshot.wrenches.get(self.index).copied().unwrap_or_default();
        Some(ambf_msgs::RigidBodyState {
            header: header(Some(snapshot)),
            sim_step: snapshot.sim_step,
            identifier: string(&self.identifier),
            name: string(&self.name),
            wall_time: snapshot.wall_time as f32,
            sim_time: snapshot.sim_time as f32,
            mass: narrow(self.info.mass),
            pInertia: point(&self.info.inertia),
            pose: pose(&body.body_pose(&self.info.inertial_offset_inverse)),
            twist: geometry_msgs::Twist {
                linear: vector(&body.linear_velocity.into()),
                angular: vector(&body.angular_velocity.into()),
            },
            wrench: geometry_msgs::Wrench { force: vector(&wrench.force), torque: vector(&wrench.torque) },
            children_names: names(
                self.info.publish_children_names,
                &self.requests.children_names,
                &self.info.children_names,
            ),
            joint_names: names(self.info.publish_joint_names, &self.requests.joint_names, &self.info.joint_names),
            joint_positions: self.positions.clone(),
            joint_velocities: self.velocities.clone(),
            joint_efforts: self.efforts.clone(),
        })
    }
}

fn select(out: &mut Vec<f32>, values: &Table<JointId, f64>, joints: &[JointId]) {
    out.clear();
    out.extend(joints.iter().map(|&joint| values.get(joint).copied().map_or(0.0, narrow)));
}

/// The command in `message`. Entries beyond the body's `n_joints` are dropped here: nobody could use them.
pub(in crate::ros) fn command(message: &ambf_msgs::RigidBodyCmd, n_joints: usize) -> RigidBodyCommand {
    RigidBodyCommand {
        cartesian: CartesianCommandType::from(message.cartesian_cmd_type),
        position: from_point(&message.pose.position),
        orientation: from_quaternion(&message.pose.orientation),
        force: from_vector(&message.wrench.force),
        torque: from_vector(&message.wrench.torque),
        linear_velocity: from_vector(&message.twist.linear),
        angular_velocity: from_vector(&message.twist.angular),
        joint_commands: message.joint_cmds.iter().take(n_joints).map(|&x| f64::from(x)).collect(),
        joint_command_types: message
            .joint_cmds_types
            .iter()
            .take(n_joints)
            .map(|&t| JointCommandType::from(t))
            .collect(),
        publish_children_names: message.publish_children_names,
        publish_joint_names: message.publish_joint_names,
        publish_joint_positions: message.publish_joint_positions,
    }
}

/// A sentence about a type in `command` that does not exist, if there is one.
pub(in crate::ros) fn unknown_type(command: &RigidBodyCommand) -> Option<String> {
    if let CartesianCommandType::Unknown(code) = command.cartesian {
        return Some(format!(
            "cartesian_cmd_type {code} does not exist (0 force, 1 position, 2 velocity); nothing is applied"
        ));
    }
    command.joint_commands.iter().zip(&command.joint_command_types).enumerate().find_map(|(i, (_, &kind))| match kind {
        JointCommandType::Unknown(code) => Some(format!(
            "joint_cmds_types[{i}] {code} does not exist (0 effort, 1 position, 2 velocity); the joint is left alone"
        )),
        _ => None,
    })
}

impl Builder<'_> {
    pub(super) fn rigid_body(&mut self, info: &ObjectInfo, name: String, index: BodyId, body: &RigidBodyInfo) {
        if let Some(frames) = &self.around.frames {
            frames.insert(index, &name);
        }
        let requests = Arc::<Requests>::default();
        let mut source = StateSource::new(index, body.clone(), &info.name, &info.identifier, Arc::clone(&requests));
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| source.message(snapshot?));
        let n_joints = body.joint_names.len().max(body.joints.len());
        self.can_be_stepped(&name, info, Kind::body(index, body, info, &requests));
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message: ambf_msgs::RigidBodyCmd| {
            let command = command(&message, n_joints);
            commanded.post(|hub, object| {
                hub.post(object, &command)?;
                requests.note(&message);
                Ok(())
            });
            if let Some(what) = unknown_type(&command) {
                commanded.complaints.report(format_args!("{}: {what}", commanded.topic));
            }
        });
    }
}

impl FromClient for ambf_msgs::RigidBodyCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        const TYPE: usize = 1;
        wire.header()?;
        wire.skip(TYPE + POSE + WRENCH + TWIST)?;
        wire.array(1)?;
        wire.array(4)?;
        wire.skip(3 * BOOL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{BodyKinematics, Wrench};
    use nalgebra::{Isometry3, Vector3};

    fn source(requests: &Arc<Requests>, publish: bool) -> StateSource {
        let info = RigidBodyInfo {
            mass: 2.0,
            inertial_offset_inverse: Isometry3::translation(0.0, 0.0, -0.5),
            children_names: vec!["a".into(), "b".into()],
            joint_names: vec!["j1".into(), "j2".into()],
            joints: vec![JointId::new(2), JointId::new(0)],
            publish_joint_names: publish,
            publish_joint_positions: publish,
            ..Default::default()
        };
        StateSource::new(BodyId::new(0), info, "Box1", "/ambf/env/BODY Box1", Arc::clone(requests))
    }

    fn snapshot(x: f64) -> Snapshot {
        Snapshot {
            sim_step: 9,
            bodies: vec![BodyKinematics {
                origin: [x, 2.0, 3.0],
                angular_velocity: [0.0, 0.0, 4.0],
                ..Default::default()
            }]
            .into(),
            joint_positions: vec![x, 0.2, 0.3].into(),
            joint_velocities: vec![1.0, 2.0, 3.0].into(),
            joint_efforts: vec![0.0; 3].into(),
            ..Default::default()
        }
    }

    #[test]
    fn a_state_holds_the_body_frame_and_the_joints_in_the_bodys_order() {
        let mut source = source(&Arc::default(), true);
        let state = source.message(&snapshot(0.1)).unwrap();
        assert_eq!((state.pose.position.x, state.pose.position.z), (0.1, 2.5));
        assert_eq!(state.twist.angular.z, 4.0);
        assert_eq!(state.joint_positions, [0.3, 0.1]);
        assert_eq!(source.message(&snapshot(1e300)).unwrap().joint_positions, [0.3, f32::MAX]);
        assert_eq!(state.joint_velocities, [3.0, 1.0]);
        assert_eq!(state.joint_names, ["j1", "j2"]);
        assert!(state.children_names.is_empty());
        assert_eq!((state.name.data.as_str(), state.mass, state.sim_step), ("Box1", 2.0, 9));
        assert_eq!(state.wrench.force.x, 0.0, "no feedback, no wrench");
        let with_feedback =
            Snapshot { wrenches: vec![Wrench { force: Vector3::x(), ..Default::default() }].into(), ..snapshot(0.1) };
        assert_eq!(source.message(&with_feedback).unwrap().wrench.force.x, 1.0);
        assert!(source.message(&Snapshot::default()).is_none());
    }

    #[test]
    fn names_stay_once_asked_for_and_positions_stop_changing() {
        let requests = Arc::<Requests>::default();
        let mut source = source(&requests, false);
        let first = source.message(&snapshot(0.1)).unwrap();
        assert!(first.joint_names.is_empty() && first.joint_positions.is_empty());
        requests.note(&ambf_msgs::RigidBodyCmd {
            publish_children_names: true,
            publish_joint_positions: true,
            ..Default::default()
        });
        let asked = source.message(&snapshot(0.5)).unwrap();
        assert_eq!(asked.children_names, ["a", "b"]);
        assert!(asked.joint_names.is_empty());
        assert_eq!(asked.joint_positions, [0.3, 0.5]);
        requests.note(&ambf_msgs::RigidBodyCmd::default());
        let after = source.message(&snapshot(0.9)).unwrap();
        assert_eq!(after.children_names, ["a", "b"]);
        assert_eq!(after.joint_positions, [0.3, 0.5], "the last ones keep being sent");
    }

    #[test]
    fn lengths_that_do_not_fit_are_tolerated() {
        let message = ambf_msgs::RigidBodyCmd {
            cartesian_cmd_type: 2,
            joint_cmds: vec![1.0; 10],
            joint_cmds_types: vec![1],
            ..Default::default()
        };
        let command = command(&message, 3);
        assert_eq!(command.cartesian, CartesianCommandType::Velocity);
        assert_eq!(command.joint_commands, [1.0; 3]);
        assert_eq!(command.joint_command_types, [JointCommandType::Position]);
        assert_eq!(unknown_type(&command), None);
    }

    #[test]
    fn types_that_do_not_exist_are_named() {
        let message = |cartesian, kinds: Vec<i8>| ambf_msgs::RigidBodyCmd {
            cartesian_cmd_type: cartesian,
            joint_cmds: vec![0.0; 2],
            joint_cmds_types: kinds,
            ..Default::default()
        };
        let about = |m| unknown_type(&command(&m, 2));
        assert!(about(message(7, vec![])).unwrap().contains("cartesian_cmd_type 7"));
        assert!(about(message(0, vec![1, -3])).unwrap().contains("joint_cmds_types[1] -3"));
        assert_eq!(about(message(0, vec![0, 1, 9])), None, "surplus types are ignored");
    }
}
