//! A soft body on the wire: `SoftBodyState`, which holds its shape, and `SoftBodyCmd`, of which only the force counts.

use ambf_core::comm::{ObjectInfo, Snapshot, SoftBodyCommand};
use ambf_core::ids::SoftBodyId;
use nalgebra::Isometry3;

use super::Builder;
use crate::ros::messages::{ambf_msgs, from_vector, header, is_zero, narrow, pose, string};
use crate::ros::received::{FromClient, Wire, BOOL, POSE, WRENCH};

/// What the numbers in the state mean.
const USERDATA: &str = "node positions x y z, x y z, ... in the world, m";

/// State of the soft body at `index` of the snapshot's soft bodies; `None` when the snapshot does not know it.
pub(in crate::ros) fn state(
    object: &ObjectInfo,
    index: SoftBodyId,
    mass: f64,
    snapshot: &Snapshot,
) -> Option<ambf_msgs::SoftBodyState> {
    let reading = snapshot.soft_bodies.get(index)?;
    Some(ambf_msgs::SoftBodyState {
        header: header(Some(snapshot)),
        sim_step: snapshot.sim_step,
        identifier: string(&object.identifier),
        name: string(&object.name),
        wall_time: snapshot.wall_time as f32,
        sim_time: snapshot.sim_time as f32,
        mass: narrow(mass),
        pose: pose(&Isometry3::from_parts(reading.center.into(), Default::default())),
        userdata_description: USERDATA.into(),
        userdata: reading.nodes.iter().flatten().copied().map(narrow).collect(),
        ..Default::default()
    })
}

/// The command in `message`: its force.
pub(in crate::ros) fn command(message: &ambf_msgs::SoftBodyCmd) -> SoftBodyCommand {
    SoftBodyCommand { force: from_vector(&message.wrench.force) }
}

/// Fields that `message` uses in vain.
pub(in crate::ros) fn unused_fields(message: &ambf_msgs::SoftBodyCmd) -> impl Iterator<Item = &'static str> {
    let used = [
        (message.enable_position_controller, "enable_position_controller"),
        (!is_zero(&message.wrench.torque), "wrench.torque"),
        (!message.joint_cmds.is_empty(), "joint_cmds"),
    ];
    used.into_iter().filter_map(|(is_used, field)| is_used.then_some(field))
}

impl Builder<'_> {
    pub(super) fn soft_body(&mut self, info: &ObjectInfo, name: String, index: SoftBodyId, mass: f64) {
        let of = info.clone();
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| state(&of, index, mass, snapshot?));
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.name_unused(unused_fields(&message), "a soft body takes a wrench.force");
            commanded.post(|hub, object| hub.post(object, &command(&message)));
        });
    }
}

impl FromClient for ambf_msgs::SoftBodyCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()?;
        wire.skip(BOOL + POSE + WRENCH)?;
        wire.array(4)?;
        wire.booleans()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ObjectKind, Rates, SoftBodyReading};
    use nalgebra::Vector3;

    #[test]
    fn a_state_holds_the_shape() {
        let object = ObjectInfo {
            kind: ObjectKind::SoftBody(SoftBodyId::new(0), 2.0),
            namespace: "/e/".into(),
            name: "Cloth".into(),
            identifier: "/e/SOFT BODY Cloth".into(),
            rates: Rates::default(),
        };
        let reading =
            SoftBodyReading { center: Vector3::new(1.0, 2.0, 3.0), nodes: vec![[0.5, 1.5, 1e300], [1.0, 2.0, 3.0]] };
        let snapshot = Snapshot { sim_step: 4, soft_bodies: vec![reading].into(), ..Default::default() };
        let cloth = state(&object, SoftBodyId::new(0), 2.0, &snapshot).unwrap();
        assert_eq!((cloth.name.data.as_str(), cloth.identifier.data.as_str()), ("Cloth", "/e/SOFT BODY Cloth"));
        assert_eq!((cloth.sim_step, cloth.mass, cloth.pose.position.z, cloth.pose.orientation.w), (4, 2.0, 3.0, 1.0));
        assert_eq!(cloth.userdata, [0.5, 1.5, f32::MAX, 1.0, 2.0, 3.0]);
        assert!(cloth.userdata_description.contains("node positions"));
        assert!(cloth.children_names.is_empty() && cloth.joint_positions.is_empty());
        assert_eq!(state(&object, SoftBodyId::new(1), 2.0, &snapshot), None);
    }

    #[test]
    fn only_the_force_counts() {
        let mut message = ambf_msgs::SoftBodyCmd::default();
        message.wrench.force.y = 2.0;
        assert_eq!(command(&message), SoftBodyCommand { force: Vector3::new(0.0, 2.0, 0.0) });
        assert_eq!(unused_fields(&message).count(), 0);
        message.enable_position_controller = true;
        message.wrench.torque.x = 1.0;
        message.joint_cmds = vec![0.0];
        let unused: Vec<_> = unused_fields(&message).collect();
        assert_eq!(unused, ["enable_position_controller", "wrench.torque", "joint_cmds"]);
    }
}
