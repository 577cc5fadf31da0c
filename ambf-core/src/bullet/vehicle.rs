use std::ptr::NonNull;

use bullet_sys as sys;
use nalgebra::{Isometry3, Vector3};

use super::{pose_of, BodyHandle, VehicleHandle, World};

/// A wheel of a vehicle. Vectors are in the inertial frame of the chassis, whose x is forward and z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wheel {
    /// Where the suspension begins, m.
    pub connection: Vector3<f64>,
    /// Direction from the connection to the wheel. Its length scales the length of the suspension ray.
    pub direction: Vector3<f64>,
    /// Axle; not along the direction. An engine drives forward when it points to the right, −y.
    pub axle: Vector3<f64>,
    /// Length of the suspension at rest, m.
    pub rest_length: f64,
    /// m, positive.
    pub radius: f64,
    /// Steered in front; Bullet only keeps it.
    pub is_front: bool,
    /// Stiffness of the suspension, per mass of the chassis, 1/s².
    pub stiffness: f64,
    /// Damping of the suspension while it extends, per mass of the chassis, 1/s.
    pub damping_relaxation: f64,
    /// Damping of the suspension while it is compressed, per mass of the chassis, 1/s.
    pub damping_compression: f64,
    /// The tyre slides when its force is larger than this times the force of the suspension.
    pub friction_slip: f64,
    /// How much the side force of the tyre rolls the chassis, 0 to 1.
    pub roll_influence: f64,
}

impl Wheel {
    /// Whether Bullet can compute with it: a wheel without direction, axle or reach makes the chassis' state not
    /// finite.
    fn is_sound(&self) -> bool {
        let Self { connection, direction, axle, rest_length, radius, .. } = self;
        let numbers = [
            self.rest_length,
            self.radius,
            self.stiffness,
            self.damping_relaxation,
            self.damping_compression,
            self.friction_slip,
            self.roll_influence,
        ];
        let finite = [connection, direction, axle].iter().all(|v| v.iter().all(|x| x.is_finite()))
            && numbers.iter().all(|x| x.is_finite());
        finite
            && *radius > 0.0
            && rest_length + radius > 0.0
            && direction.cross(axle).norm() > 1e-6 * direction.norm() * axle.norm()
    }

    fn raw(&self) -> sys::AmbWheel {
        sys::AmbWheel {
            connection: self.connection.into(),
            direction: self.direction.into(),
            axle: self.axle.into(),
            rest_length: self.rest_length,
            radius: self.radius,
            stiffness: self.stiffness,
            damping_relaxation: self.damping_relaxation,
            damping_compression: self.damping_compression,
            friction_slip: self.friction_slip,
            roll_influence: self.roll_influence,
            is_front: self.is_front.into(),
        }
    }
}

pub(super) struct OwnedVehicle {
    pub(super) raw: NonNull<sys::AmbVehicle>,
    chassis: BodyHandle,
    wheels: usize,
}

impl World {
    /// Makes a body the chassis of a ray-cast vehicle, `btRaycastVehicle` with its default tuning. `None` when the
    /// handle is stale or the body is static, or a wheel has a number that is not finite, a radius or suspension ray of
    /// a length that is not positive, or an axle that is zero or along its direction. Articulations are dissolved. Only
    /// rigid bodies carry wheels: a wheel has no support if its ray hits a ghost or soft body first.
    pub fn add_vehicle(&mut self, chassis: BodyHandle, wheels: &[Wheel]) -> Option<VehicleHandle> {
        let _arena = self.enter();
        let dynamic = self.bodies.get(chassis)?.dynamic;
        if !dynamic || !wheels.iter().all(Wheel::is_sound) {
            return None;
        }
        let raw_wheels: Vec<_> = wheels.iter().map(Wheel::raw).collect();
        let n = i32::try_from(wheels.len()).ok()?;
        self.dissolve_all();
        // SAFETY: world and chassis are alive and outlive the vehicle: `remove_body` refuses while it exists; n wheels
        // are copied.
        let raw = unsafe { sys::amb_vehicle_new(self.raw.as_ptr(), self.raw_body(chassis)?, raw_wheels.as_ptr(), n) };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        self.bodies[chassis].constraint_count += 1;
        self.structure += 1;
        Some(self.vehicles.insert(OwnedVehicle { raw, chassis, wheels: wheels.len() }))
    }

    /// Removes a vehicle; its chassis remains as a body. False when the handle is stale.
    pub fn remove_vehicle(&mut self, handle: VehicleHandle) -> bool {
        let _arena = self.enter();
        let Some(vehicle) = self.vehicles.remove(handle) else { return false };
        self.bodies[vehicle.chassis].constraint_count -= 1;
        self.structure += 1;
        // SAFETY: the vehicle is in this world, and no pointer to it is left after this.
        unsafe { sys::amb_vehicle_free(vehicle.raw.as_ptr()) }
        true
    }

    /// Sets steering (rad, to the left), engine force (N, along up × axle; the brake has no effect unless it is 0) and
    /// brake (largest impulse of a sub-step, N·s; negative is 0) of a wheel until they are set again. False, and no
    /// effect, when there is no such wheel or a number is not finite.
    pub fn drive(&mut self, handle: VehicleHandle, wheel: usize, steering: f64, engine: f64, brake: f64) -> bool {
        let Some((raw, wheel)) = self.raw_wheel(handle, wheel) else { return false };
        let finite = steering.is_finite() && engine.is_finite() && brake.is_finite();
        if finite {
            // SAFETY: the vehicle is alive and has this wheel.
            unsafe { sys::amb_vehicle_drive(raw, wheel, steering, engine, brake.max(0.0)) }
        }
        finite
    }

    /// Pose of the drawn wheel in the world, on the chassis' motion state: its axes are up × axle, −axle and up,
    /// against the direction of the suspension, turned by steering and rolling.
    pub fn wheel_pose(&self, handle: VehicleHandle, wheel: usize) -> Option<Isometry3<f64>> {
        let (vehicle, wheel) = self.raw_wheel(handle, wheel)?;
        let mut raw = [0.0; 12];
        // SAFETY: the vehicle is alive and has this wheel; 12 doubles are written.
        unsafe { sys::amb_vehicle_wheel_pose(vehicle, wheel, raw.as_mut_ptr()) }
        Some(pose_of(&raw))
    }

    /// Whether a wheel stood on a rigid body in the last sub-step.
    pub fn wheel_on_ground(&self, handle: VehicleHandle, wheel: usize) -> Option<bool> {
        let (vehicle, wheel) = self.raw_wheel(handle, wheel)?;
        // SAFETY: the vehicle is alive and has this wheel.
        Some(unsafe { sys::amb_vehicle_on_ground(vehicle, wheel) } != 0)
    }

    /// Brings suspensions to rest and the angles of all wheels, their steering, engine and brake to zero.
    pub fn reset_vehicle(&mut self, handle: VehicleHandle) {
        let _arena = self.enter();
        if let Some(vehicle) = self.vehicles.get(handle) {
            // SAFETY: the vehicle is alive.
            unsafe { sys::amb_vehicle_reset(vehicle.raw.as_ptr()) }
        }
    }

    fn raw_wheel(&self, handle: VehicleHandle, wheel: usize) -> Option<(*mut sys::AmbVehicle, i32)> {
        let vehicle = self.vehicles.get(handle).filter(|vehicle| wheel < vehicle.wheels)?;
        Some((vehicle.raw.as_ptr(), wheel as i32))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::super::tests::ball;
    use super::super::{RigidBody, Shape, Solver};
    use super::*;

    const MASS: f64 = 100.0;

    fn wheel(x: f64, y: f64) -> Wheel {
        Wheel {
            connection: Vector3::new(x, y, 0.0),
            direction: -Vector3::z(),
            axle: -Vector3::y(),
            rest_length: 0.5,
            radius: 0.3,
            is_front: x > 0.0,
            stiffness: 50.0,
            damping_relaxation: 5.0,
            damping_compression: 5.0,
            friction_slip: 10.5,
            roll_influence: 0.1,
        }
    }

    /// A car of 100 kg that stands on a plane.
    fn car() -> (World, BodyHandle, VehicleHandle) {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), ..ball(0.0, 0.0) });
        let shape = Shape::cuboid(Vector3::new(1.0, 0.5, 0.2), 0.001);
        let chassis = world.add_body(RigidBody {
            inertia: shape.inertia(MASS),
            shape,
            pose: Isometry3::translation(0.0, 0.0, 0.8),
            ..ball(MASS, 0.0)
        });
        let wheels = [wheel(1.0, 0.5), wheel(1.0, -0.5), wheel(-1.0, 0.5), wheel(-1.0, -0.5)];
        let vehicle = world.add_vehicle(chassis, &wheels).unwrap();
        run(&mut world, 3000);
        (world, chassis, vehicle)
    }

    fn run(world: &mut World, steps: u32) {
        for _ in 0..steps {
            world.step(0.001, 1, 0.001);
        }
    }

    /// Along the ground: the suspension pushes after each sub-step, gravity pulls in the next.
    fn speed(world: &World, chassis: BodyHandle) -> Vector2<f64> {
        world.velocity(chassis).unwrap().0.xy()
    }

    #[test]
    fn suspensions_carry_the_weight() {
        let (world, chassis, vehicle) = car();
        // Four springs of 50 · m each shorten by g / (4 · 50).
        let height = 0.8 - 10.0 / 200.0;
        let pose = world.pose(chassis).unwrap();
        assert!((pose.translation.z - height).abs() < 1e-3, "{pose}");
        assert!(pose.rotation.angle() < 1e-3);
        for (index, place) in [(0, [1.0, 0.5]), (3, [-1.0, -0.5])] {
            let drawn = world.wheel_pose(vehicle, index).unwrap();
            assert!((drawn.translation.vector - Vector3::new(place[0], place[1], 0.3)).norm() < 2e-3, "{drawn}");
            assert!(drawn.rotation.angle() < 1e-3, "{drawn}");
            assert_eq!(world.wheel_on_ground(vehicle, index), Some(true));
        }
        assert_eq!(world.wheel_pose(vehicle, 4), None);
    }

    #[test]
    fn it_drives_straight_and_brakes() {
        let (mut world, chassis, vehicle) = car();
        for index in 0..4 {
            assert!(world.drive(vehicle, index, 0.0, 25.0, 0.0));
        }
        run(&mut world, 1000);
        // 100 N on 100 kg for 1 s.
        let (pose, v) = (world.pose(chassis).unwrap(), speed(&world, chassis));
        assert!((v.x - 1.0).abs() < 0.02 && v.y.abs() < 1e-3, "{v}");
        assert!((pose.translation.x - 0.5).abs() < 0.02 && pose.translation.y.abs() < 1e-3, "{pose}");
        // Wheels of 0.3 m have rolled so far.
        let rolled = world.wheel_pose(vehicle, 0).unwrap().rotation.scaled_axis();
        assert!((rolled - Vector3::y() * (pose.translation.x / 0.3)).norm() < 0.05, "{rolled}");
        for index in 0..4 {
            assert!(world.drive(vehicle, index, 0.0, 0.0, 1.0));
        }
        run(&mut world, 500);
        let v = speed(&world, chassis);
        assert!(v.norm() < 0.01, "it stands, but for {v}");
    }

    #[test]
    fn it_turns_left_and_resets() {
        let (mut world, chassis, vehicle) = car();
        for index in 0..4 {
            world.drive(vehicle, index, if index < 2 { 0.3 } else { 0.0 }, 25.0, 0.0);
        }
        run(&mut world, 2000);
        let turned = world.pose(chassis).unwrap().rotation.scaled_axis();
        assert!(turned.z > 0.1, "{turned}");
        assert!(speed(&world, chassis).norm() > 0.5);
        world.reset_vehicle(vehicle);
        world.set_pose(chassis, &Isometry3::translation(0.0, 0.0, 0.75));
        world.set_velocity(chassis, &Vector3::zeros(), &Vector3::zeros());
        run(&mut world, 1000);
        let v = speed(&world, chassis);
        assert!(v.norm() < 1e-3, "no engine any more, but {v}");
        let drawn = world.wheel_pose(vehicle, 0).unwrap();
        assert!((drawn.translation.vector - Vector3::new(1.0, 0.5, 0.3)).norm() < 5e-3, "{drawn}");
        assert!(drawn.rotation.angle() < 0.01, "{drawn}");
    }

    #[test]
    fn wheels_that_bullet_cannot_compute_with_are_refused() {
        let (mut world, chassis, _) = car();
        let good = wheel(0.0, 0.0);
        for bad in [
            Wheel { direction: Vector3::zeros(), ..good },
            Wheel { axle: Vector3::zeros(), ..good },
            Wheel { axle: 2.0 * good.direction, ..good },
            Wheel { radius: 0.0, ..good },
            Wheel { rest_length: -0.3, ..good },
            Wheel { stiffness: f64::NAN, ..good },
            Wheel { connection: Vector3::repeat(f64::INFINITY), ..good },
        ] {
            assert!(world.add_vehicle(chassis, &[good, bad]).is_none(), "{bad:?}");
        }
        let ground = world.bodies()[0];
        assert!(world.add_vehicle(ground, &[good]).is_none(), "a static chassis");
    }

    #[test]
    fn stale_handles_and_numbers_that_are_not_finite_do_nothing() {
        let (mut world, chassis, vehicle) = car();
        assert!(!world.drive(vehicle, 0, f64::NAN, 1.0, 0.0));
        assert!(!world.drive(vehicle, 0, 0.0, f64::INFINITY, 0.0));
        assert!(!world.drive(vehicle, 4, 0.0, 1.0, 0.0), "there are four wheels");
        assert!(!world.remove_body(chassis), "a vehicle stands on it");
        assert!(!world.make_visual_only(chassis));
        assert!(world.remove_vehicle(vehicle) && !world.remove_vehicle(vehicle));
        assert!(!world.drive(vehicle, 0, 0.0, 1.0, 0.0));
        assert_eq!(world.wheel_pose(vehicle, 0), None);
        assert_eq!(world.wheel_on_ground(vehicle, 0), None);
        world.reset_vehicle(vehicle);
        run(&mut world, 1000);
        assert!(world.pose(chassis).unwrap().translation.z < 0.3, "it has no wheels any more");
        assert!(world.remove_body(chassis));
        assert!(world.add_vehicle(chassis, &[wheel(0.0, 0.0)]).is_none());
    }
}
