//! Cameras and lights on the wire: a pose to publish and a pose to follow.

use std::sync::Arc;

use ambf_core::comm::{CameraParameters, LightParameters, ObjectInfo, PoseCommand, Snapshot};
use ambf_core::ids::{CameraId, LightId};
use nalgebra::Isometry3;
use parking_lot::Mutex;

use super::Builder;
use crate::ros::messages::{ambf_msgs, from_point, from_quaternion, header, pose, string};
use crate::ros::parameters::Parameterised;
use crate::ros::received::FromClient;

/// Name of the parent as text, changed when a parameter changes it.
#[derive(Debug, Default)]
pub(in crate::ros) struct ParentName(Mutex<String>);

impl ParentName {
    /// A parent called `name`.
    pub fn new(name: &str) -> Arc<Self> {
        Arc::new(Self(Mutex::new(name.to_owned())))
    }

    /// The present name.
    pub fn get(&self) -> String {
        self.0.lock().clone()
    }

    /// Replaces the name.
    pub fn set(&self, name: &str) {
        *self.0.lock() = name.to_owned();
    }
}

/// What does not change in the states of a camera or light.
pub(in crate::ros) struct Identity {
    pub name: String,
    pub identifier: String,
    pub parent: Arc<ParentName>,
}

macro_rules! posed {
    ($state:ident, $command:ident, $state_of:ident, $command_of:ident, $title:literal) => {
        #[doc = concat!("State of a ", $title, " at `local`, its pose in its parent, as of `snapshot`.")]
        pub(in crate::ros) fn $state_of(
            identity: &Identity,
            local: &Isometry3<f64>,
            snapshot: &Snapshot,
        ) -> ambf_msgs::$state {
            ambf_msgs::$state {
                header: header(Some(snapshot)),
                sim_step: snapshot.sim_step,
                parent_name: string(&identity.parent.get()),
                identifier: string(&identity.identifier),
                name: string(&identity.name),
                wall_time: snapshot.wall_time as f32,
                sim_time: snapshot.sim_time as f32,
                pose: pose(local),
            }
        }

        #[doc = concat!("The command in a message for a ", $title, ".")]
        pub(in crate::ros) fn $command_of(message: &ambf_msgs::$command) -> PoseCommand {
            PoseCommand {
                enabled: message.enable_position_controller,
                position: from_point(&message.pose.position),
                orientation: from_quaternion(&message.pose.orientation),
            }
        }
    };
}

posed!(CameraState, CameraCmd, camera_state, camera_command, "camera");
posed!(LightState, LightCmd, light_state, light_command, "light");

impl Builder<'_> {
    pub(super) fn camera(&mut self, info: &ObjectInfo, name: String, index: CameraId, parameters: &CameraParameters) {
        let (identity, parent) = identity(info, &parameters.parent_name);
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            let snapshot = snapshot?;
            Some(camera_state(&identity, snapshot.cameras.get(index)?, snapshot))
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &camera_command(&message)));
        });
        let object = self.object;
        self.served.parameters.cameras.push(Parameterised { object, name, values: parameters.clone(), parent });
    }

    pub(super) fn light(&mut self, info: &ObjectInfo, name: String, index: LightId, parameters: &LightParameters) {
        let (identity, parent) = identity(info, &parameters.parent_name);
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            let snapshot = snapshot?;
            Some(light_state(&identity, snapshot.lights.get(index)?, snapshot))
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &light_command(&message)));
        });
        let object = self.object;
        self.served.parameters.lights.push(Parameterised { object, name, values: parameters.clone(), parent });
    }
}

fn identity(info: &ObjectInfo, parent: &str) -> (Identity, Arc<ParentName>) {
    let parent = ParentName::new(parent);
    let identity =
        Identity { name: info.name.clone(), identifier: info.identifier.clone(), parent: Arc::clone(&parent) };
    (identity, parent)
}

impl FromClient for ambf_msgs::CameraCmd {}

impl FromClient for ambf_msgs::LightCmd {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parent_is_the_present_one() {
        let parent = ParentName::new("BODY base");
        let identity = Identity { name: "cam".into(), identifier: "/e/CAMERA cam".into(), parent: Arc::clone(&parent) };
        let snapshot = Snapshot { sim_step: 3, ..Default::default() };
        let local = Isometry3::translation(1.0, 0.0, 0.0);
        assert_eq!(camera_state(&identity, &local, &snapshot).parent_name.data, "BODY base");
        parent.set("BODY tip");
        let state = light_state(&identity, &local, &snapshot);
        assert_eq!((state.parent_name.data.as_str(), state.sim_step, state.pose.position.x), ("BODY tip", 3, 1.0));
    }

    #[test]
    fn a_command_is_taken_as_it_is() {
        let mut message = ambf_msgs::CameraCmd { enable_position_controller: true, ..Default::default() };
        message.pose.position.y = 2.0;
        let command = camera_command(&message);
        assert!(command.enabled);
        assert_eq!((command.position.y, command.orientation), (2.0, [0.0; 4]));
    }
}
