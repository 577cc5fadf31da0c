//! A ghost object on the wire: `ObjectState`, which names what is inside, and `ObjectCmd`, of which only the pose counts.

use ambf_core::comm::{ObjectCommand, ObjectInfo, Snapshot};

use super::messages::{ambf_msgs, from_point, from_quaternion, header, is_zero, pose, string};

/// State of the ghost object at `index` of the snapshot's ghost objects; `None` when the snapshot does not know it.
pub(super) fn state(object: &ObjectInfo, index: usize, snapshot: &Snapshot) -> Option<ambf_msgs::ObjectState> {
    let reading = snapshot.ghosts.get(index)?;
    Some(ambf_msgs::ObjectState {
        header: header(Some(snapshot)),
        sim_step: snapshot.sim_step,
        identifier: string(&object.identifier),
        name: string(&object.name),
        wall_time: snapshot.wall_time as f32,
        sim_time: snapshot.sim_time as f32,
        pose: pose(&reading.pose),
        children_names: reading.sensed.iter().map(|name| name.as_ref().to_owned()).collect(),
        ..Default::default()
    })
}

/// The command in `message`: its pose.
pub(super) fn command(message: &ambf_msgs::ObjectCmd) -> ObjectCommand {
    ObjectCommand {
        enabled: message.enable_position_controller,
        position: from_point(&message.pose.position),
        orientation: from_quaternion(&message.pose.orientation),
        ..Default::default()
    }
}

/// Fields that `message` uses in vain.
pub(super) fn unused_fields(message: &ambf_msgs::ObjectCmd) -> impl Iterator<Item = &'static str> {
    let used = [
        (!is_zero(&message.wrench.force), "wrench.force"),
        (!is_zero(&message.wrench.torque), "wrench.torque"),
        (!message.joint_cmds.is_empty(), "joint_cmds"),
    ];
    used.into_iter().filter_map(|(is_used, field)| is_used.then_some(field))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{GhostReading, ObjectKind, Rates};
    use nalgebra::Isometry3;

    #[test]
    fn a_state_names_what_is_inside() {
        let object = ObjectInfo {
            kind: ObjectKind::Ghost(0),
            namespace: "/e/".into(),
            name: "Water".into(),
            identifier: "/e/GHOST OBJECT Water".into(),
            rates: Rates::default(),
        };
        let reading =
            GhostReading { pose: Isometry3::translation(1.0, 0.0, 0.0), sensed: vec!["Box".into(), "Ball".into()] };
        let snapshot = Snapshot { sim_step: 4, ghosts: vec![reading], ..Default::default() };
        let water = state(&object, 0, &snapshot).unwrap();
        assert_eq!((water.name.data.as_str(), water.identifier.data.as_str()), ("Water", "/e/GHOST OBJECT Water"));
        assert_eq!((water.sim_step, water.mass, water.pose.position.x), (4, 0.0, 1.0));
        assert_eq!(water.children_names, ["Box", "Ball"]);
        assert_eq!(state(&object, 1, &snapshot), None);
    }

    #[test]
    fn only_the_pose_counts() {
        let mut message = ambf_msgs::ObjectCmd { enable_position_controller: true, ..Default::default() };
        message.pose.position.y = 2.0;
        message.pose.orientation.w = 1.0;
        assert_eq!(unused_fields(&message).count(), 0);
        message.wrench.force.x = 1.0;
        message.wrench.torque.x = f64::NAN;
        message.joint_cmds = vec![0.0];
        assert_eq!(unused_fields(&message).collect::<Vec<_>>(), ["wrench.force", "wrench.torque", "joint_cmds"]);
        let command = command(&message);
        assert!(command.enabled);
        assert_eq!((command.position.y, command.orientation), (2.0, [0.0, 0.0, 0.0, 1.0]));
        assert_eq!(command.force.norm(), 0.0);
    }
}
