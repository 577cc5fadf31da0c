//! Builds what is more than bodies and joints: soft bodies, ghosts, sensors, actuators, vehicles.

use super::attached::Attached;
use super::build::Builder;
use super::planned::ray_mesh;
use super::sensor::{ray_count, rays_of, Resistance, Sensor};
use super::{shape, soft_body, Actuator, Ghost, SoftBody, Vehicle, Wheel};
use crate::adf::{self, CollisionGeometry, SensorKind, Severity, WheelVisual};
use crate::bullet;
use crate::comm::{ActuatorInfo, SensorInfo, SensorType};
use crate::control::Profile;
use crate::ids::BodyId;

/// Rays of all sensors of a scene. A few keys can ask for a million each, which take a quarter of a gigabyte.
const MAX_RAYS: usize = 1_000_000;

impl Builder<'_> {
    pub(super) fn add_soft_body(&mut self, soft: &adf::SoftBody) {
        let Some(mesh) = self.mesh(&soft.collision_mesh, soft.scale, &soft.common) else { return };
        if !self.scene.world.has_soft_bodies() {
            let why = "soft bodies can be added only to a scene that began with one";
            return self.drop_element(&soft.common, why);
        }
        let (body, remarks) = soft_body::describe(soft, &mesh, self.scene.profile);
        for remark in remarks {
            self.note(Severity::Warning, &soft.common.source, format!("`{}`: {remark}", soft.common.identifier));
        }
        match self.scene.world.add_soft_body(&body) {
            Ok(handle) => {
                let identity = self.identity(&soft.common, |scene| &scene.soft_bodies.names);
                let nodes = body.nodes.len();
                self.scene.soft_bodies.push(SoftBody { identity, mass: soft.mass, nodes, handle });
            }
            Err(error) => self.drop_element(&soft.common, error),
        }
    }

    pub(super) fn add_ghost(&mut self, ghost: &adf::GhostObject) {
        let mesh = match &ghost.collision {
            CollisionGeometry::Mesh { path, .. } => match self.mesh(path, ghost.scale, &ghost.common) {
                Some(mesh) => Some(mesh),
                None => return,
            },
            _ => None,
        };
        let mut left_out = Vec::new();
        let origin = nalgebra::Isometry3::identity();
        let margin = shape::Margin { length: ghost.collision_margin, profile: self.scene.profile, is_moved: false };
        let collision = &ghost.collision;
        let shape = shape::geometry(collision, margin, mesh.as_deref(), self.meshes, &origin, &mut left_out);
        for (severity, message) in left_out {
            self.note(severity, &ghost.common.source, format!("`{}`: {message}", ghost.common.identifier));
        }
        let handle = self.scene.world.add_ghost(shape, &ghost.location);
        let identity = self.identity(&ghost.common, |scene| &scene.ghosts.names);
        let attached = Attached::new(identity, ghost.location);
        self.scene.ghosts.push(Ghost::new(attached, ghost, handle));
    }

    pub(super) fn add_sensor(&mut self, sensor: &adf::Sensor) {
        let identity = self.identity(&sensor.common, |scene| &scene.sensors.names);
        let Some(parent) = self.body_for(&sensor.common, &identity.suffix, "parent", &sensor.parent) else { return };
        let mesh = match ray_mesh(&sensor.rays).cloned() {
            Some(path) => match self.mesh(&path, 1.0, &sensor.common) {
                Some(mesh) => Some(mesh),
                None => return,
            },
            None => None,
        };
        let known: usize = self.scene.sensors.iter().map(|sensor| sensor.rays.len()).sum();
        let wanted = ray_count(&sensor.rays, mesh.as_deref());
        if known + wanted > MAX_RAYS {
            let why = format!("with its {wanted} rays the scene would have more than {MAX_RAYS}");
            return self.drop_element(&sensor.common, why);
        }
        let rays = rays_of(&sensor.rays, mesh.as_deref());
        let (kind, range, resistance) = match sensor.kind {
            SensorKind::Proximity => (SensorType::Proximity, sensor.range, None),
            SensorKind::Resistance(parameters) => {
                let resistance = Resistance::new(parameters, rays.len(), self.scene.profile);
                (SensorType::Resistance, sensor.range, Some(resistance))
            }
            SensorKind::Contact { threshold, .. } => (SensorType::Contact, threshold, None),
        };
        let info = SensorInfo { kind, parent_name: sensor.parent.clone(), pose: sensor.location, range };
        if let SensorKind::Contact { details, .. } = sensor.kind {
            self.scene.sensors.push(Sensor::with_contacts(identity, info, parent, details));
        } else if rays.is_empty() {
            self.drop_element(&sensor.common, "its mesh has no triangle with an area, so that it has no rays");
        } else {
            self.scene.sensors.push(Sensor::with_rays(identity, info, parent, rays, resistance));
        }
    }

    pub(super) fn add_actuator(&mut self, actuator: &adf::Actuator) {
        let identity = self.identity(&actuator.common, |scene| &scene.actuators.names);
        let parent = self.body_for(&actuator.common, &identity.suffix, "parent", &actuator.parent);
        let Some(parent) = parent else { return };
        // The C++ program takes the location in the inertial frame.
        let frame = match self.scene.profile {
            Profile::Legacy => actuator.location,
            Profile::Accurate => self.scene.bodies[parent].inertial_offset_inverse * actuator.location,
        };
        let info = ActuatorInfo { parent_name: actuator.parent.clone(), pose: actuator.location };
        self.scene.actuators.push(Actuator::new(identity, info, parent, frame));
    }

    pub(super) fn add_vehicle(&mut self, vehicle: &adf::Vehicle) {
        let identity = self.identity(&vehicle.common, |scene| &scene.vehicles.names);
        let chassis = self.body_for(&vehicle.common, &identity.suffix, "chassis", &vehicle.chassis);
        let Some(chassis) = chassis else { return };
        if self.scene.bodies[chassis].mass == 0.0 {
            return self.drop_element(&vehicle.common, "its chassis has no mass and cannot drive");
        }
        let to_chassis = self.scene.bodies[chassis].inertial_offset_inverse;
        let mut wheels = Vec::new();
        for wheel in &vehicle.wheels {
            let body = match &wheel.visual {
                WheelVisual::Body(text) => self.wheel_body(vehicle, &identity.suffix, text, chassis),
                WheelVisual::Mesh(_) => None,
            };
            wheels.push(Wheel::new(body, wheel));
        }
        if wheels.is_empty() {
            let message = format!("`{}` has no wheels: it is pushed, not driven", vehicle.common.identifier);
            self.note(Severity::Warning, &vehicle.common.source, message);
        }
        let described: Vec<_> = vehicle.wheels.iter().map(|wheel| described(wheel, &to_chassis)).collect();
        let world = &mut self.scene.world;
        let Some(handle) = world.add_vehicle(self.scene.bodies[chassis].handle, &described) else {
            return self.drop_element(&vehicle.common, "its chassis is not part of the world");
        };
        for body in wheels.iter().filter_map(|wheel| wheel.body) {
            self.scene.world.make_visual_only(self.scene.bodies[body].handle);
            let body = &mut self.scene.bodies[body];
            (body.mass, body.inertia) = (0.0, nalgebra::Vector3::zeros());
        }
        let live = Vehicle { identity, chassis, wheels, handle };
        live.show_wheels(&mut self.scene.world, &self.scene.bodies);
        self.scene.vehicles.push(live);
    }

    /// The body that shows a wheel. A wheel without one rolls unseen.
    fn wheel_body(&mut self, vehicle: &adf::Vehicle, suffix: &str, text: &str, chassis: BodyId) -> Option<BodyId> {
        let common = &vehicle.common;
        let mut wanted = None;
        let problem = match self.find_body(text, &self.namespace(common), suffix) {
            Ok((index, _)) if index == chassis => format!("wheel `{text}` is the chassis"),
            Ok((index, _))
                if self.scene.joints.iter().any(|j| !j.removed && (j.parent == index || j.child == index)) =>
            {
                format!("wheel `{text}` is held by a joint")
            }
            Ok((index, _)) => return Some(index),
            Err(why) => {
                wanted = Some(text);
                format!("wheel `{text}` {why}")
            }
        };
        let message = format!("`{}`: {problem}; the wheel rolls, but no body shows it", common.identifier);
        match wanted {
            Some(text) => self.note_wanted(Severity::Error, &common.source, message, text),
            None => self.note(Severity::Error, &common.source, message),
        }
        None
    }
}

/// A wheel as it is made in Bullet. The C++ program leaves the axle as it is written.
fn described(wheel: &adf::Wheel, to_chassis: &nalgebra::Isometry3<f64>) -> bullet::Wheel {
    bullet::Wheel {
        connection: (to_chassis * nalgebra::Point3::from(wheel.offset)).coords,
        direction: to_chassis.rotation * wheel.down_direction,
        axle: wheel.axle_direction,
        rest_length: wheel.suspension.rest_length,
        radius: wheel.radius,
        is_front: wheel.front,
        stiffness: wheel.suspension.stiffness,
        damping_relaxation: wheel.suspension.damping,
        damping_compression: wheel.suspension.compression,
        friction_slip: wheel.friction,
        roll_influence: wheel.roll_influence,
    }
}
