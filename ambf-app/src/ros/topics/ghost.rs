//! A ghost object on the wire: `GhostObjectState`, which names what is inside, and `GhostObjectCmd`, which has no
//! effect.
//!
//! Never `ObjectState`: clients of the C++ program 2.0 make handles of it, and then find two objects where a script
//! looks for one by a part of its name.

use ambf_core::comm::{GhostInfo, ObjectInfo, Snapshot};
use ambf_core::ids::GhostId;

use super::Builder;
use crate::ros::messages::{ambf_msgs, header, pose, string};
use crate::ros::received::{FromClient, Wire};
use crate::ros::step::Kind;

/// State of the ghost object at `index` of the snapshot's ghost objects; `None` when the snapshot does not know it.
pub(in crate::ros) fn state(
    object: &ObjectInfo,
    index: GhostId,
    ghost: &GhostInfo,
    snapshot: &Snapshot,
) -> Option<ambf_msgs::GhostObjectState> {
    let reading = snapshot.ghosts.get(index)?;
    Some(ambf_msgs::GhostObjectState {
        header: header(Some(snapshot)),
        sim_step: snapshot.sim_step,
        parent_name: string(&ghost.parent_name),
        identifier: string(&object.identifier),
        name: string(&object.name),
        wall_time: snapshot.wall_time as f32,
        sim_time: snapshot.sim_time as f32,
        pose: pose(&reading.pose),
        sensed_objects: reading.sensed.iter().map(|identifier| string(identifier)).collect(),
    })
}

impl Builder<'_> {
    pub(super) fn ghost(&mut self, info: &ObjectInfo, name: String, index: GhostId, ghost: &GhostInfo) {
        self.can_be_stepped(&name, info, Kind::Ghost(index, ghost.clone()));
        let (of, ghost) = (info.clone(), ghost.clone());
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| state(&of, index, &ghost, snapshot?));
        self.without_effect::<ambf_msgs::GhostObjectCmd>(&name);
    }
}

impl FromClient for ambf_msgs::GhostObjectCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{GhostReading, ObjectKind, Rates};
    use nalgebra::Isometry3;

    #[test]
    fn a_state_names_what_is_inside() {
        let info = GhostInfo { parent_name: "BODY jaw".into() };
        let object = ObjectInfo {
            kind: ObjectKind::Ghost(GhostId::new(0), Box::new(info.clone())),
            namespace: "/e/".into(),
            name: "Water".into(),
            identifier: "/e/GHOST OBJECT Water".into(),
            rates: Rates::default(),
        };
        let sensed = vec!["/e/BODY Box".into(), "/e/BODY Ball".into()];
        let reading = GhostReading { pose: Isometry3::translation(1.0, 0.0, 0.0), sensed };
        let snapshot = Snapshot { sim_step: 4, ghosts: vec![reading].into(), ..Default::default() };
        let water = state(&object, GhostId::new(0), &info, &snapshot).unwrap();
        assert_eq!((water.name.data.as_str(), water.identifier.data.as_str()), ("Water", "/e/GHOST OBJECT Water"));
        assert_eq!((water.sim_step, water.parent_name.data.as_str(), water.pose.position.x), (4, "BODY jaw", 1.0));
        assert_eq!(
            water.sensed_objects.iter().map(|name| name.data.as_str()).collect::<Vec<_>>(),
            ["/e/BODY Box", "/e/BODY Ball"]
        );
        assert_eq!(state(&object, GhostId::new(1), &info, &snapshot), None);
    }
}
