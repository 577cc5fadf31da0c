//! A sensor on the wire: `SensorState`, and `SensorCmd`, which has no effect.

use ambf_core::comm::{ObjectInfo, SensorInfo, SensorType, Snapshot};
use ambf_core::ids::SensorId;

use super::{contact, Builder};
use crate::ros::messages::{ambf_msgs, header, narrow, pose, string};
use crate::ros::received::{FromClient, Wire};
use crate::ros::step::Kind;

/// State of the sensor at `index` of the snapshot's sensors; `None` when the snapshot does not know it.
pub(in crate::ros) fn state(
    object: &ObjectInfo,
    index: SensorId,
    sensor: &SensorInfo,
    snapshot: &Snapshot,
) -> Option<ambf_msgs::SensorState> {
    let readings = snapshot.sensors.get(index)?;
    Some(ambf_msgs::SensorState {
        header: header(Some(snapshot)),
        sim_step: snapshot.sim_step,
        type_: string(match sensor.kind {
            SensorType::Proximity => "PROXIMITY",
            SensorType::Resistance => "RESISTANCE",
            SensorType::Contact => "CONTACT",
        }),
        parent_name: string(&sensor.parent_name),
        identifier: string(&object.identifier),
        name: string(&object.name),
        wall_time: snapshot.wall_time as f32,
        sim_time: snapshot.sim_time as f32,
        pose: pose(&sensor.pose),
        count: readings.len() as u32,
        triggered: readings.iter().map(|reading| reading.triggered).collect(),
        range: vec![narrow(sensor.range)],
        measurement: readings.iter().map(|reading| narrow(reading.measurement)).collect(),
        sensed_objects: readings
            .iter()
            .map(|reading| string(reading.sensed.as_deref().filter(|_| reading.triggered).unwrap_or_default()))
            .collect(),
        sensed_objects_map: Vec::new(),
    })
}

impl Builder<'_> {
    pub(super) fn sensor(&mut self, info: &ObjectInfo, name: String, index: SensorId, sensor: &SensorInfo) {
        self.can_be_stepped(&name, info, Kind::Sensor(index, sensor.clone()));
        let (of, own) = (info.clone(), sensor.clone());
        let topic = format!("{name}/State");
        if sensor.kind == SensorType::Contact {
            self.publish(topic, info.rates, true, move |snapshot| contact::state(&of, index, &own, snapshot?));
            self.without_effect::<ambf_msgs::ContactSensorCmd>(&name);
        } else {
            self.publish(topic, info.rates, true, move |snapshot| state(&of, index, &own, snapshot?));
            self.without_effect::<ambf_msgs::SensorCmd>(&name);
        }
    }
}

impl FromClient for ambf_msgs::SensorCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()?;
        wire.booleans()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ObjectKind, Rates, RayReading};
    use nalgebra::Isometry3;

    #[test]
    fn a_state_has_one_entry_a_ray_and_one_range() {
        let info = SensorInfo {
            kind: SensorType::Resistance,
            parent_name: "BODY tip".into(),
            pose: Isometry3::translation(0.0, 0.0, 0.5),
            range: 0.25,
        };
        let object = ObjectInfo {
            kind: ObjectKind::Sensor(SensorId::new(1), Box::new(info.clone())),
            namespace: "/e/".into(),
            name: "Proximity0".into(),
            identifier: "/e/SENSOR Proximity0".into(),
            rates: Rates::default(),
        };
        let hit = RayReading { triggered: true, measurement: 1e300, sensed: Some("Box".into()), body: None };
        let soft = RayReading { triggered: true, measurement: 0.5, sensed: None, body: None };
        // The body that was hit last stays stored after a miss.
        let miss = RayReading { triggered: false, measurement: 0.0, sensed: Some("Box".into()), body: None };
        let snapshot =
            Snapshot { sim_step: 4, sensors: vec![vec![], vec![hit, soft, miss]].into(), ..Default::default() };
        let state = state(&object, SensorId::new(1), &info, &snapshot).unwrap();
        assert_eq!((state.type_.data.as_str(), state.parent_name.data.as_str()), ("RESISTANCE", "BODY tip"));
        assert_eq!((state.name.data.as_str(), state.identifier.data.as_str()), ("Proximity0", "/e/SENSOR Proximity0"));
        assert_eq!((state.sim_step, state.pose.position.z), (4, 0.5));
        assert_eq!((state.count, state.range), (3, vec![0.25]));
        assert_eq!(state.triggered, [true, true, false]);
        assert_eq!(state.measurement, [f32::MAX, 0.5, 0.0]);
        assert_eq!(state.sensed_objects.iter().map(|s| s.data.as_str()).collect::<Vec<_>>(), ["Box", "", ""]);
        assert!(state.sensed_objects_map.is_empty());
        assert_eq!(super::state(&object, SensorId::new(2), &info, &snapshot), None);
    }
}
