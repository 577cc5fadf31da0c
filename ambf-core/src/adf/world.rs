//! World files.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::camera::Camera;
use super::common::{Common, ShaderProgram};
use super::light::Light;

/// A world file as written.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Identifier and name are always `World`; plugins are world plugins.
    pub common: Common,
    /// Model file that is loaded first, joined to the file's directory when it was relative. Replaces `enclosure`.
    pub environment: Option<PathBuf>,
    /// Box of five static planes.
    pub enclosure: Option<Enclosure>,
    /// Gravity, m/s². Default: (0, 0, -9.8).
    pub gravity: Vector3<f64>,
    /// Largest number of sub-steps of a physics update. Default: 10.
    pub max_iterations: u32,
    /// Lights in list order.
    pub lights: Vec<Light>,
    /// Cameras in list order.
    pub cameras: Vec<Camera>,
    /// Shaders of objects without own or model shaders.
    pub shaders: Option<ShaderProgram>,
    /// Sky box.
    pub skybox: Option<Skybox>,
    /// How the physics is solved.
    pub physics: PhysicsSettings,
}

/// Inner size of a box around the scene, m, each positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enclosure {
    /// Along x, m.
    pub length: f64,
    /// Along y, m.
    pub width: f64,
    /// Along z, m.
    pub height: f64,
}

/// Image files of a sky box.
#[derive(Clone, Debug, PartialEq)]
pub struct Skybox {
    /// Keys `right`, `left`, `top`, `bottom`, `front`, `back` in this order, joined to `path`.
    pub faces: [PathBuf; 6],
    /// Shaders of the sky box.
    pub shaders: Option<ShaderProgram>,
}

/// Key `physics` of a world file; the reference has no such key. Every part is optional.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhysicsSettings {
    /// `legacy` or `accurate`.
    pub profile: Option<PhysicsProfile>,
    /// Name of the constraint solver, as written.
    pub solver: Option<String>,
    /// Name of the integrator, as written.
    pub integrator: Option<String>,
    /// Iterations of the constraint solver; at least 1.
    pub iterations: Option<u32>,
    /// Length of a sub-step, s; positive.
    pub sub_step: Option<f64>,
}

/// Profile of the physics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhysicsProfile {
    /// What the reference does.
    Legacy,
    /// The best result at the same cost.
    Accurate,
}
