//! A vehicle on the wire: `VehicleState` and `VehicleCmd`.

use ambf_core::comm::{ObjectInfo, Snapshot, VehicleCommand, VehicleInfo};
use ambf_core::ids::VehicleId;

use super::Builder;
use crate::ros::messages::{ambf_msgs, from_vector, header, narrow, point, pose, string};
use crate::ros::received::{FromClient, Wire, WRENCH};

/// State of the vehicle at `index` of the snapshot's vehicles; `None` when the snapshot does not know it.
pub(in crate::ros) fn state(
    object: &ObjectInfo,
    index: VehicleId,
    vehicle: &VehicleInfo,
    snapshot: &Snapshot,
) -> Option<ambf_msgs::VehicleState> {
    let reading = snapshot.vehicles.get(index)?;
    Some(ambf_msgs::VehicleState {
        header: header(Some(snapshot)),
        sim_step: snapshot.sim_step,
        identifier: string(&object.identifier),
        name: string(&object.name),
        wall_time: snapshot.wall_time as f32,
        sim_time: snapshot.sim_time as f32,
        mass: narrow(vehicle.mass),
        pInertia: point(&vehicle.inertia),
        pose: pose(&reading.pose),
        wheel_count: i8::try_from(vehicle.wheels).unwrap_or(i8::MAX),
        wheel_offsets: reading.wheels.iter().map(pose).collect(),
    })
}

/// The command in `message`. Entries beyond the vehicle's `wheels` are dropped here: nobody could use them.
pub(in crate::ros) fn command(message: &ambf_msgs::VehicleCmd, wheels: usize) -> VehicleCommand {
    let cut = |values: &[f32]| values.iter().take(wheels).map(|&x| f64::from(x)).collect();
    VehicleCommand {
        force: from_vector(&message.chassis_wrench.force),
        torque: from_vector(&message.chassis_wrench.torque),
        steering: cut(&message.wheel_steering),
        power: cut(&message.wheel_power),
        brake: cut(&message.wheel_brake),
        full_brake: message.brake,
    }
}

impl Builder<'_> {
    pub(super) fn vehicle(&mut self, info: &ObjectInfo, name: String, index: VehicleId, vehicle: &VehicleInfo) {
        let (of, wheels, vehicle) = (info.clone(), vehicle.wheels, vehicle.clone());
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| state(&of, index, &vehicle, snapshot?));
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &command(&message, wheels)));
        });
    }
}

impl FromClient for ambf_msgs::VehicleCmd {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()?;
        wire.skip(WRENCH)?;
        (0..3).try_for_each(|_| wire.array(4))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ObjectKind, Rates, VehicleReading};
    use nalgebra::{Isometry3, Vector3};

    #[test]
    fn a_state_holds_the_chassis_and_every_wheel() {
        let info = VehicleInfo { mass: 20.0, inertia: Vector3::new(1.0, 2.0, 3.0), wheels: 2 };
        let object = ObjectInfo {
            kind: ObjectKind::Vehicle(VehicleId::new(0), Box::new(info.clone())),
            namespace: "/e/".into(),
            name: "Car".into(),
            identifier: "/e/VEHICLE Car".into(),
            rates: Rates::default(),
        };
        let reading = VehicleReading {
            pose: Isometry3::translation(1.0, 0.0, 0.0),
            wheels: vec![Isometry3::translation(0.0, 0.5, 0.0), Isometry3::translation(0.0, -0.5, 0.0)],
        };
        let snapshot = Snapshot { sim_step: 4, vehicles: vec![reading].into(), ..Default::default() };
        let car = state(&object, VehicleId::new(0), &info, &snapshot).unwrap();
        assert_eq!((car.name.data.as_str(), car.identifier.data.as_str()), ("Car", "/e/VEHICLE Car"));
        assert_eq!((car.sim_step, car.mass, car.pInertia.z, car.pose.position.x), (4, 20.0, 3.0, 1.0));
        assert_eq!((car.wheel_count, car.wheel_offsets.len(), car.wheel_offsets[1].position.y), (2, 2, -0.5));
        assert_eq!(state(&object, VehicleId::new(1), &info, &snapshot), None);
        let many = VehicleInfo { mass: 1e300, wheels: 1000, ..info };
        let many = state(&object, VehicleId::new(0), &many, &snapshot).unwrap();
        assert_eq!((many.mass, many.wheel_count), (f32::MAX, 127));
    }

    #[test]
    fn arrays_are_cut_to_the_wheels() {
        let mut message = ambf_msgs::VehicleCmd {
            wheel_steering: vec![0.5],
            wheel_power: vec![1.0; 1000],
            wheel_brake: vec![],
            brake: true,
            ..Default::default()
        };
        message.chassis_wrench.force.x = 3.0;
        message.chassis_wrench.torque.z = 4.0;
        let command = command(&message, 4);
        assert_eq!((command.steering, command.power, command.brake), (vec![0.5], vec![1.0; 4], vec![]));
        assert_eq!((command.force.x, command.torque.z, command.full_brake), (3.0, 4.0, true));
    }
}
