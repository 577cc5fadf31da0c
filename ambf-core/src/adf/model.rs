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
use super::sensor::{Actuator, Sensor};
use super::soft_body::SoftBody;
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
