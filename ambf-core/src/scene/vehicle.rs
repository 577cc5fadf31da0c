//! Live ray-cast vehicles.

use nalgebra::{Isometry3, Vector3};

use super::build::Builder;
use super::commands::{Commanded, Commands};
use super::list::SceneObject;
use super::{Bodies, Identity, ObjectType, Scene};
use crate::adf::{self, Limits};
use crate::bullet::{VehicleHandle, World};
use crate::comm::{ObjectKind, Snapshot, VehicleCommand, VehicleInfo, VehicleReading};
use crate::ids::{BodyId, VehicleId};

/// A vehicle of a [`Scene`](super::Scene).
#[derive(Debug)]
pub struct Vehicle {
    /// Names and publishing rates.
    pub identity: Identity,
    /// Index of the chassis.
    pub chassis: BodyId,
    /// Wheels in file order.
    pub wheels: Vec<Wheel>,
    pub(crate) handle: VehicleHandle,
}

/// A wheel of a [`Vehicle`].
#[derive(Debug, Clone, PartialEq)]
pub struct Wheel {
    /// Index of the body that shows the wheel; its inertial frame follows it.
    pub body: Option<BodyId>,
    /// Range of the steering angle, rad.
    pub steering_limits: Limits,
    /// Largest engine force, N.
    pub max_power: f64,
    /// Largest brake, N·s: the largest impulse of a sub-step.
    pub max_brake: f64,
    /// In force.
    drive: Drive,
}

/// What is in force for a wheel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Drive {
    steering: f64,
    power: f64,
    brake: f64,
}

impl Wheel {
    pub(super) fn new(body: Option<BodyId>, wheel: &crate::adf::Wheel) -> Self {
        Self {
            body,
            steering_limits: wheel.steering_limits,
            max_power: wheel.max_engine_power,
            max_brake: wheel.max_brake_power,
            drive: Drive::default(),
        }
    }
}

impl Wheel {
    /// Takes over what is wanted, within the limits.
    fn drive(&mut self, world: &mut World, vehicle: VehicleHandle, index: usize, wanted: Drive) {
        self.drive = Drive {
            steering: within(wanted.steering, self.steering_limits.low, self.steering_limits.high),
            power: within(wanted.power, -self.max_power, self.max_power),
            brake: within(wanted.brake, 0.0, self.max_brake),
        };
        world.drive(vehicle, index, self.drive.steering, self.drive.power, self.drive.brake);
    }
}

/// Not `clamp`: the limits may be the wrong way round.
fn within(value: f64, low: f64, high: f64) -> f64 {
    value.min(high).max(low)
}

impl Scene {
    /// Puts the bodies that show wheels where the wheels are: chassis may have been moved.
    pub(crate) fn place_wheels(&mut self) {
        let Self { vehicles, world, bodies, .. } = self;
        vehicles.iter().for_each(|vehicle| vehicle.show_wheels(world, bodies));
    }

    /// Applies a whole command to a vehicle; it acts in the next update.
    pub(crate) fn command_vehicle(&mut self, vehicle: VehicleId, command: &VehicleCommand) {
        let Self { vehicles, world, bodies, .. } = self;
        vehicles[vehicle].apply_command(world, bodies, command);
    }
}

impl SceneObject for Vehicle {
    type Id = VehicleId;
    type Saved = Vec<Drive>;
    const TYPE: ObjectType = ObjectType::Vehicle;
    const RANK: u8 = 7;
    const ACTS: bool = true;
    const RESETS_WITH_BODIES: bool = true;
    /// A body that a joint holds cannot be a wheel.
    const FOLLOWS_JOINTS: bool = true;

    fn identity(&self) -> &Identity {
        &self.identity
    }

    fn add_all(builder: &mut Builder<'_>, model: &adf::Model) {
        for vehicle in &model.vehicles {
            builder.with_plugins(Self::TYPE, &vehicle.common, |builder| builder.add_vehicle(vehicle));
        }
    }

    fn kind(&self, id: Self::Id, scene: &Scene) -> Option<ObjectKind> {
        let chassis = &scene.bodies[self.chassis];
        let info = VehicleInfo { mass: chassis.mass, inertia: chassis.inertia, wheels: self.wheels.len() };
        Some(ObjectKind::Vehicle(id, Box::new(info)))
    }

    fn stands_on(&self, _id: Self::Id) -> Option<BodyId> {
        Some(self.chassis)
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        let wheels = vec![Isometry3::identity(); self.wheels.len()];
        snapshot.vehicles.push(VehicleReading { wheels, ..VehicleReading::default() });
    }

    fn read(&self, id: Self::Id, scene: &Scene, snapshot: &mut Snapshot) {
        let reading = &mut snapshot.vehicles[id];
        // Wheels are drawn on the chassis as it is reported.
        reading.pose = scene.bodies[self.chassis].pose(&scene.world);
        let to_chassis = reading.pose.inverse();
        for (i, wheel) in reading.wheels.iter_mut().enumerate() {
            let pose = scene.world.wheel_pose(self.handle, i);
            *wheel = pose.map_or_else(Isometry3::identity, |pose| to_chassis * pose);
        }
    }

    fn commands(id: Self::Id) -> Option<Box<dyn Commands>> {
        Some(Commanded::new(id, |scene, id, command, _| scene.command_vehicle(id, command)))
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(scene.bodies[self.chassis].pose(&scene.world))
    }

    fn update(scene: &mut Scene, id: Self::Id, _sub_step: f64, _interval: f64) {
        let Scene { vehicles, world, bodies, .. } = scene;
        vehicles[id].show_wheels(world, bodies);
    }

    /// Wheels straight, no power, no brake, suspension at rest.
    fn reset(Scene { vehicles, world, bodies, .. }: &mut Scene, id: Self::Id) {
        let vehicle = &mut vehicles[id];
        vehicle.wheels.iter_mut().for_each(|wheel| wheel.drive = Drive::default());
        world.reset_vehicle(vehicle.handle);
        vehicle.show_wheels(world, bodies);
    }

    fn save(&self) -> Vec<Drive> {
        // All fields by name, so that no new one is forgotten.
        let Self { identity: _, chassis: _, wheels, handle: _ } = self;
        let drive = |wheel: &Wheel| {
            let Wheel { body: _, steering_limits: _, max_power: _, max_brake: _, drive } = wheel;
            *drive
        };
        wheels.iter().map(drive).collect()
    }

    fn restore(&mut self, saved: &Vec<Drive>) {
        for (wheel, &drive) in self.wheels.iter_mut().zip(saved) {
            wheel.drive = drive;
        }
    }
}

impl Vehicle {
    /// Executes a command; it acts in the next update.
    pub(crate) fn apply_command(&mut self, world: &mut World, bodies: &Bodies, command: &VehicleCommand) {
        for (i, wheel) in self.wheels.iter_mut().enumerate() {
            let asked = |values: &[f64]| values.get(i).copied().unwrap_or(0.0);
            let (power, brake) = if command.full_brake {
                (0.0, wheel.max_brake)
            } else {
                (asked(&command.power), asked(&command.brake))
            };
            // A wheel that no value is given for keeps its angle.
            let steering = command.steering.get(i).copied().unwrap_or(wheel.drive.steering);
            wheel.drive(world, self.handle, i, Drive { steering, power, brake });
        }
        if command.force != Vector3::zeros() || command.torque != Vector3::zeros() {
            world.apply_wrench(bodies[self.chassis].handle, &command.force, &command.torque);
        }
    }

    /// Drives one wheel; false when there is none of that index.
    pub(crate) fn drive_wheel(
        &mut self,
        world: &mut World,
        index: usize,
        steering: f64,
        power: f64,
        brake: f64,
    ) -> bool {
        let Some(wheel) = self.wheels.get_mut(index) else { return false };
        wheel.drive(world, self.handle, index, Drive { steering, power, brake });
        true
    }

    /// Lets the bodies that show wheels follow them.
    pub(crate) fn show_wheels(&self, world: &mut World, bodies: &Bodies) {
        for (i, wheel) in self.wheels.iter().enumerate() {
            if let (Some(body), Some(pose)) = (wheel.body, world.wheel_pose(self.handle, i)) {
                world.set_pose(bodies[body].handle, &pose);
            }
        }
    }
}
