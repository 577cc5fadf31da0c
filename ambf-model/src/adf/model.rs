//! Model (multibody) files.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;

use super::body::RigidBody;
use super::camera::Camera;
use super::common::{PluginEntry, ShaderProgram};
use super::ghost::GhostObject;
use super::joint::Joint;
use super::light::Light;
use super::reader::{Absent, Map};
use super::sensor::{Actuator, Sensor};
use super::soft_body::SoftBody;
use super::values::Base;
use super::vehicle::Vehicle;
use super::volume::Volume;

/// A model file as written. Elements are in list order, which is the order of creation.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Base name of the file with its extension; name and identifier of the model.
    pub name: String,
    /// Namespace of the file, without a global prefix. Default: empty.
    pub namespace: String,
    /// The file.
    pub file: Arc<Path>,
    /// Rigid bodies.
    pub bodies: Vec<RigidBody>,
    /// Soft bodies.
    pub soft_bodies: Vec<SoftBody>,
    /// Ghost objects.
    pub ghosts: Vec<GhostObject>,
    /// Sensors.
    pub sensors: Vec<Sensor>,
    /// Actuators.
    pub actuators: Vec<Actuator>,
    /// Joints.
    pub joints: Vec<Joint>,
    /// Vehicles.
    pub vehicles: Vec<Vehicle>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// Lights.
    pub lights: Vec<Light>,
    /// Volumes.
    pub volumes: Vec<Volume>,
    /// No collision between any two rigid bodies of the model. Default: `false`.
    pub ignore_inter_collision: bool,
    /// Gravity of the model's rigid bodies that have no own, m/s²; `None`: the world's.
    pub gravity: Option<Vector3<f64>>,
    /// Shaders of the model's objects that have no own.
    pub shaders: Option<ShaderProgram>,
    /// Model plugins.
    pub plugins: Vec<PluginEntry>,
}

impl Model {
    pub(super) fn read(root: &Map<'_>) -> Self {
        let base = Base::read(root);
        let file = root.reader().file().clone();
        let name = file.file_name().unwrap_or_default();
        let model = Self {
            name: name.to_string_lossy().into_owned(),
            bodies: root.elements(
                "bodies",
                "body",
                Absent::Made("an unnamed body of 1 kg without a shape is made"),
                |map| RigidBody::read(map, &base),
            ),
            soft_bodies: root.elements("soft bodies", "soft body", Absent::Dropped, |map| SoftBody::read(map, &base)),
            ghosts: root
                .elements("ghost objects", "ghost object", Absent::Dropped, |map| GhostObject::read(map, &base)),
            sensors: root.elements("sensors", "sensor", Absent::Dropped, |map| Sensor::read(map, &base)),
            actuators: root.elements("actuators", "actuator", Absent::Dropped, |map| Actuator::read(map, &base)),
            joints: root.elements("joints", "joint", Absent::Refused, |map| Joint::read(map, &base)),
            vehicles: root.elements("vehicles", "vehicle", Absent::Dropped, |map| Vehicle::read(map, &base)),
            cameras: cameras(root, &base),
            lights: lights(root, &base),
            volumes: root
                .elements("volumes", "volume", Absent::Made("an empty one is made"), |map| Volume::read(map, &base)),
            ignore_inter_collision: root.boolean("ignore inter-collision").unwrap_or(false),
            gravity: root.vector("gravity"),
            shaders: root.shaders("shaders"),
            plugins: root.plugins("plugins"),
            namespace: base.namespace,
            file,
        };
        root.ignore(&["joint erp", "joint cfm"], "only those of each joint count");
        root.finish_root();
        model
    }
}

/// Cameras of a model or a world.
pub(super) fn cameras(root: &Map<'_>, base: &Base) -> Vec<Camera> {
    let absent = Absent::Made("one with defaults is made");
    root.elements("cameras", "camera", absent, |map| Camera::read(map, base))
}

/// Lights of a model or a world.
pub(super) fn lights(root: &Map<'_>, base: &Base) -> Vec<Light> {
    let absent = Absent::Made("one with defaults is made");
    root.elements("lights", "light", absent, |map| Light::read(map, base))
}
