//! Saving and restoring a scene: each module saves the state that it keeps beside Bullet's.

use nalgebra::{Isometry3, Vector3};

use super::actuator::SavedActuator;
use super::body::SavedBody;
use super::ghost::SavedGhost;
use super::joint::SavedJoint;
use super::sensor::SavedSensor;
use super::vehicle::Drive;
use super::{Attached, Camera, Counts, Light, Scene};
use crate::bullet::{SavedWorld, StateError};
use crate::comm::{CameraParameters, LightParameters};

/// What of a [`Scene`] changes while the simulation runs, as it was at one moment.
#[derive(Debug, Clone)]
pub(crate) struct SavedScene {
    extent: Extent,
    world: SavedWorld,
    bodies: Vec<SavedBody>,
    joints: Vec<SavedJoint>,
    ghosts: Vec<SavedGhost>,
    sensors: Vec<SavedSensor>,
    actuators: Vec<SavedActuator>,
    vehicles: Vec<Vec<Drive>>,
    cameras: Vec<(Isometry3<f64>, CameraParameters, Vector3<f64>)>,
    lights: Vec<(Isometry3<f64>, LightParameters)>,
}

/// Numbers of which one is another whenever something was added or removed: places are never used again.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extent {
    counts: Counts,
    joints: usize,
    models: usize,
    removed: usize,
    removed_bodies: usize,
}

impl SavedScene {
    /// Bullet's side.
    #[cfg(test)]
    pub fn bytes(&self) -> &[u8] {
        self.world.bytes()
    }

    /// Memory that it takes, bytes, but for little.
    pub fn size(&self) -> usize {
        self.world.size() + size_of_val(self.bodies.as_slice()) + size_of_val(self.joints.as_slice())
    }
}

impl Scene {
    fn extent(&self) -> Extent {
        Extent {
            counts: self.counts(),
            joints: self.joints.len(),
            models: self.models.len(),
            removed: self.models.iter().filter(|model| model.removed).count(),
            removed_bodies: self.bodies.iter().filter(|body| body.removed).count(),
        }
    }

    /// # Errors
    /// Those of [`World::save`](crate::bullet::World::save).
    pub(crate) fn save(&self) -> Result<SavedScene, StateError> {
        // All fields by name, so that no new one is forgotten.
        let Self {
            world,
            bodies,
            joints,
            // Nothing of them is kept beside Bullet.
            soft_bodies: _,
            ghosts,
            sensors,
            actuators,
            vehicles,
            cameras,
            lights,
            // These change only with the extent.
            graph: _,
            models: _,
            body_names: _,
            plugins: _,
            active_joints: _,
            names: _,
            elements: _,
            has_feedback: _,
            // These are chosen when the scene is loaded.
            namespace: _,
            world_rates: _,
            gravity: _,
            max_sub_steps: _,
            sub_step: _,
            profile: _,
            preset: _,
            joint_erp: _,
            gyroscopic: _,
            description: _,
            options: _,
        } = self;
        Ok(SavedScene {
            extent: self.extent(),
            world: world.save()?,
            bodies: bodies.iter().map(|body| body.save()).collect(),
            joints: joints.iter().map(|joint| joint.save()).collect(),
            ghosts: ghosts.iter().map(|ghost| ghost.save()).collect(),
            sensors: sensors.iter().map(|sensor| sensor.save()).collect(),
            actuators: actuators.iter().map(|actuator| actuator.save()).collect(),
            vehicles: vehicles.iter().map(|vehicle| vehicle.save()).collect(),
            cameras: cameras.iter().map(Camera::save).collect(),
            lights: lights.iter().map(Light::save).collect(),
        })
    }

    /// # Errors
    /// Those of [`World::restore`](crate::bullet::World::restore); [`StateError::Changed`] also when anything else came
    /// or went. Nothing has changed then.
    pub(crate) fn restore(&mut self, saved: &SavedScene) -> Result<(), StateError> {
        self.world.check_saved(&saved.world)?;
        if self.extent() != saved.extent {
            return Err(StateError::Changed);
        }
        self.world.restore(&saved.world)?;
        self.bodies.iter_mut().zip(&saved.bodies).for_each(|(body, saved)| body.restore(saved));
        self.joints.iter_mut().zip(&saved.joints).for_each(|(joint, saved)| joint.restore(saved));
        self.ghosts.iter_mut().zip(&saved.ghosts).for_each(|(ghost, saved)| ghost.restore(saved));
        self.sensors.iter_mut().zip(&saved.sensors).for_each(|(sensor, saved)| sensor.restore(saved));
        self.actuators.iter_mut().zip(&saved.actuators).for_each(|(actuator, saved)| actuator.restore(saved));
        self.vehicles.iter_mut().zip(&saved.vehicles).for_each(|(vehicle, saved)| vehicle.restore(saved));
        for (camera, (pose, parameters, target)) in self.cameras.iter_mut().zip(&saved.cameras) {
            (camera.attached.pose, camera.target) = (*pose, *target);
            camera.parameters.clone_from(parameters);
        }
        for (light, (pose, parameters)) in self.lights.iter_mut().zip(&saved.lights) {
            light.attached.pose = *pose;
            light.parameters.clone_from(parameters);
        }
        Ok(())
    }
}

impl Attached {
    fn save(&self) -> Isometry3<f64> {
        // All fields by name, so that no new one is forgotten. A parent changes only with the extent.
        let Self { identity: _, parent: _, pose, initial_pose: _ } = self;
        *pose
    }
}

impl Camera {
    fn save(&self) -> (Isometry3<f64>, CameraParameters, Vector3<f64>) {
        let Self { attached, parameters, look_at: _, target, description: _ } = self;
        (attached.save(), parameters.clone(), *target)
    }
}

impl Light {
    fn save(&self) -> (Isometry3<f64>, LightParameters) {
        let Self { attached, parameters, description: _ } = self;
        (attached.save(), parameters.clone())
    }
}
