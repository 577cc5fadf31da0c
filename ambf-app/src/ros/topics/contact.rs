//! A contact sensor on the wire: `ContactSensorState`, and `ContactSensorCmd`, which has no effect.

use ambf_core::comm::{ContactPoint, ObjectInfo, SensorInfo, Snapshot};
use ambf_core::ids::SensorId;

use crate::ros::messages::{ambf_msgs, header, std_msgs, string, vector};
use crate::ros::received::{FromClient, Wire};

/// State of the contact sensor at `index` of the snapshot's sensors; `None` when the snapshot does not know it.
pub(in crate::ros) fn state(
    object: &ObjectInfo,
    index: SensorId,
    sensor: &SensorInfo,
    snapshot: &Snapshot,
) -> Option<ambf_msgs::ContactSensorState> {
    let reading = snapshot.contacts.get(index)?;
    let data = |point: &ContactPoint| ambf_msgs::ContactData {
        distance: std_msgs::Float64 { data: point.distance },
        contact_point: vector(&point.point),
        contact_normal: vector(&point.normal),
    };
    Some(ambf_msgs::ContactSensorState {
        header: header(Some(snapshot)),
        sim_step: snapshot.sim_step,
        type_: string("CONTACT"),
        parent_name: string(&sensor.parent_name),
        identifier: string(&object.identifier),
        name: string(&object.name),
        wall_time: snapshot.wall_time as f32,
        sim_time: snapshot.sim_time as f32,
        contact_events: reading
            .iter()
            .map(|(body, points)| ambf_msgs::ContactEvent {
                object_name: string(&body.identifier),
                contact_data: points.iter().map(data).collect(),
            })
            .collect(),
    })
}

impl FromClient for ambf_msgs::ContactSensorCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ContactReading, ObjectKind, Rates, SensorType, TouchingBody};
    use nalgebra::Vector3;

    #[test]
    fn a_state_has_one_event_a_body_with_its_own_points() {
        let info = SensorInfo { kind: SensorType::Contact, parent_name: "BODY tip".into(), ..Default::default() };
        let object = ObjectInfo {
            kind: ObjectKind::Sensor(SensorId::new(1), Box::new(info.clone())),
            namespace: "/e/".into(),
            name: "Touch".into(),
            identifier: "/e/SENSOR Touch".into(),
            rates: Rates::default(),
        };
        let point = |distance| ContactPoint { distance, point: Vector3::x(), normal: Vector3::z() };
        let body = |identifier: &str, points| TouchingBody { identifier: identifier.into(), points };
        let reading = ContactReading {
            bodies: vec![body("/e/BODY Box", 2), body("/e/BODY Ball", 0), body("/e/BODY Peg", 1)],
            points: vec![point(-0.25), point(-0.5), point(0.125)],
        };
        let snapshot =
            Snapshot { sim_step: 4, contacts: vec![Default::default(), reading].into(), ..Default::default() };
        let state = state(&object, SensorId::new(1), &info, &snapshot).unwrap();
        assert_eq!((state.type_.data.as_str(), state.parent_name.data.as_str()), ("CONTACT", "BODY tip"));
        assert_eq!((state.name.data.as_str(), state.identifier.data.as_str()), ("Touch", "/e/SENSOR Touch"));
        let seen: Vec<_> = (state.contact_events.iter())
            .map(|event| {
                (event.object_name.data.as_str(), event.contact_data.iter().map(|d| d.distance.data).collect())
            })
            .collect();
        assert_eq!(seen, [("/e/BODY Box", vec![-0.25, -0.5]), ("/e/BODY Ball", vec![]), ("/e/BODY Peg", vec![0.125])]);
        let first = &state.contact_events[0].contact_data[0];
        assert_eq!((first.contact_point.x, first.contact_normal.z), (1.0, 1.0));
        assert_eq!(super::state(&object, SensorId::new(2), &info, &snapshot), None);
    }
}
