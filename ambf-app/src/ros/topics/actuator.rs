//! A constraint actuator on the wire: `ActuatorState` and `ActuatorCmd`.

use ambf_core::comm::{ActuatorCommand, ActuatorInfo, ObjectInfo, Snapshot};
use ambf_core::ids::ActuatorId;

use super::Builder;
use crate::ros::messages::{ambf_msgs, from_point, from_quaternion, header, pose, string};
use crate::ros::received::{FromClient, Wire, BOOL, POSE};
use crate::ros::step::Kind;

/// Longest text in a command that is taken for a name, bytes. A longer one would be kept and looked up in each
/// iteration.
const MAX_NAME: usize = 4096;

/// State of the actuator at `index` of the snapshot's actuators; `None` when the snapshot does not know it.
pub(in crate::ros) fn state(
    object: &ObjectInfo,
    index: ActuatorId,
    actuator: &ActuatorInfo,
    snapshot: &Snapshot,
) -> Option<ambf_msgs::ActuatorState> {
    Some(ambf_msgs::ActuatorState {
        header: header(Some(snapshot)),
        sim_step: snapshot.sim_step,
        type_: string("CONSTRAINT"),
        parent_name: string(&actuator.parent_name),
        identifier: string(&object.identifier),
        name: string(&object.name),
        wall_time: snapshot.wall_time as f32,
        sim_time: snapshot.sim_time as f32,
        pose: pose(&actuator.pose),
        actuated: *snapshot.actuators.get(index)?,
    })
}

/// The command in `message`.
///
/// # Errors
/// A sentence about a text that is too long to be a name.
pub(in crate::ros) fn command(message: ambf_msgs::ActuatorCmd) -> Result<ActuatorCommand, String> {
    let texts = [("body_name", &message.body_name.data), ("sensor_identifier", &message.sensor_identifier.data)];
    for (field, text) in texts {
        if text.len() > MAX_NAME {
            let length = text.len();
            return Err(format!(
                "{field} has {length} bytes, {MAX_NAME} at most are a name; the command is ignored and the one before stays \
                 in force"
            ));
        }
    }
    Ok(ActuatorCommand {
        actuate: message.actuate,
        body_name: message.body_name.data,
        use_offset: message.use_offset,
        offset_position: from_point(&message.body_offset.position),
        offset_orientation: from_quaternion(&message.body_offset.orientation),
        use_sensor_data: message.use_sensor_data,
        sensor_identifier: message.sensor_identifier.data,
    })
}

impl Builder<'_> {
    pub(super) fn actuator(&mut self, info: &ObjectInfo, name: String, index: ActuatorId, actuator: &ActuatorInfo) {
        self.can_be_stepped(&name, info, Kind::Actuator(index, actuator.clone()));
        let (of, actuator) = (info.clone(), actuator.clone());
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            state(&of, index, &actuator, snapshot?)
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| match command(message) {
            Ok(command) => commanded.post(|hub, object| hub.post(object, &command)),
            Err(why) => {
                commanded.complaints.report(format_args!("{}: {why}", commanded.topic));
            }
        });
    }
}

impl FromClient for ambf_msgs::ActuatorCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()?;
        wire.skip(BOOL)?;
        wire.array(1)?;
        wire.skip(BOOL + POSE + BOOL)?;
        wire.array(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ObjectKind, Rates};
    use nalgebra::Isometry3;

    #[test]
    fn a_state_says_where_it_is_and_whether_it_holds() {
        let info = ActuatorInfo { parent_name: "BODY tip".into(), pose: Isometry3::translation(0.0, 0.5, 0.0) };
        let object = ObjectInfo {
            kind: ObjectKind::Actuator(ActuatorId::new(1), Box::new(info.clone())),
            namespace: "/e/".into(),
            name: "Grasp".into(),
            identifier: "/e/ACTUATOR Grasp".into(),
            rates: Rates::default(),
        };
        let snapshot = Snapshot { sim_step: 4, actuators: vec![false, true].into(), ..Default::default() };
        let held = state(&object, ActuatorId::new(1), &info, &snapshot).unwrap();
        assert!(held.actuated);
        assert_eq!((held.type_.data.as_str(), held.parent_name.data.as_str()), ("CONSTRAINT", "BODY tip"));
        assert_eq!((held.name.data.as_str(), held.identifier.data.as_str()), ("Grasp", "/e/ACTUATOR Grasp"));
        assert_eq!((held.sim_step, held.pose.position.y, held.pose.orientation.w), (4, 0.5, 1.0));
        assert!(!state(&object, ActuatorId::new(0), &info, &snapshot).unwrap().actuated);
        assert_eq!(state(&object, ActuatorId::new(2), &info, &snapshot), None);
    }

    #[test]
    fn a_command_is_taken_as_it_is_unless_a_name_is_none() {
        let mut message = ambf_msgs::ActuatorCmd {
            actuate: true,
            body_name: string("Box"),
            use_offset: true,
            use_sensor_data: true,
            sensor_identifier: string("SENSOR eye"),
            ..Default::default()
        };
        message.body_offset.position.x = 2.0;
        message.body_offset.orientation.w = 1.0;
        let expected = ActuatorCommand {
            actuate: true,
            body_name: "Box".into(),
            use_offset: true,
            offset_position: nalgebra::Vector3::new(2.0, 0.0, 0.0),
            offset_orientation: [0.0, 0.0, 0.0, 1.0],
            use_sensor_data: true,
            sensor_identifier: "SENSOR eye".into(),
        };
        assert_eq!(command(message.clone()), Ok(expected));
        message.sensor_identifier.data = "x".repeat(MAX_NAME + 1);
        assert!(command(message).unwrap_err().contains("sensor_identifier has 4097 bytes"));
    }
}
