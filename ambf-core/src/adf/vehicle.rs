//! Ray-cast vehicles.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::common::{Common, SourcePos};
use super::joint::Limits;

/// A ray-cast vehicle as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Vehicle {
    /// Identity and communication; plugins are listed but the reference never loads them.
    pub common: Common,
    /// Identifier of the chassis, a body of a model loaded earlier.
    pub chassis: String,
    /// Wheels in file order.
    pub wheels: Vec<Wheel>,
}

/// A wheel: drawn by a body or a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Wheel {
    /// What shows the wheel.
    pub visual: WheelVisual,
    /// Width, m; without use in the reference. Default: 0.
    pub width: f64,
    /// Radius, m, positive. Default: 0.3.
    pub radius: f64,
    /// Bullet's friction slip. Default: 10.5.
    pub friction: f64,
    /// Suspension.
    pub suspension: Suspension,
    /// Bullet's roll influence. Default: 0.1.
    pub roll_influence: f64,
    /// Direction of the suspension ray in the chassis frame; not normalised. Default: zero.
    pub down_direction: Vector3<f64>,
    /// Axle in the chassis frame; not normalised. Default: zero.
    pub axle_direction: Vector3<f64>,
    /// Connection point in the chassis frame, m. Default: zero.
    pub offset: Vector3<f64>,
    /// A steered front wheel. Default: `false`.
    pub front: bool,
    /// Steering range, rad. Default: 0 and 0.
    pub steering_limits: Limits,
    /// Default: 0.
    pub max_engine_power: f64,
    /// Default: 0.
    pub max_brake_power: f64,
    /// Where the entry stands.
    pub source: SourcePos,
}

/// What shows a wheel.
#[derive(Clone, Debug, PartialEq)]
pub enum WheelVisual {
    /// Identifier of a body of a model loaded earlier.
    Body(String),
    /// A mesh: where the file may lie, best first; the first that exists is meant.
    Mesh(Vec<PathBuf>),
}

/// Suspension of a wheel, in Bullet's terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suspension {
    /// Stiffness per unit of chassis mass, 1/s². Default: 5.88.
    pub stiffness: f64,
    /// Damping while relaxing. Default: 0.88.
    pub damping: f64,
    /// Damping while compressing. Default: 0.83.
    pub compression: f64,
    /// Length at rest, m. Default: 0.3.
    pub rest_length: f64,
}

impl Default for Suspension {
    /// The values of Bullet's `btVehicleTuning`; the length at rest is ours.
    fn default() -> Self {
        Self { stiffness: 5.88, damping: 0.88, compression: 0.83, rest_length: 0.3 }
    }
}
