//! Sensors (ray tracers) and actuators.

use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};

use super::common::Common;

/// A sensor as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    /// Identity, communication, plugins.
    pub common: Common,
    /// Type with what only that type has.
    pub kind: SensorKind,
    /// Identifier of the body that carries the sensor.
    pub parent: String,
    /// Pose of the sensor frame in the parent's body frame. Default: identity.
    pub location: Isometry3<f64>,
    /// Reach, m, not negative. Default: 0.5.
    pub range: f64,
    /// Draw markers. Default: `false`.
    pub visible: bool,
    /// Radius of the markers, m. Default: 0.02.
    pub visible_size: f64,
    /// Where the rays are.
    pub rays: RaySource,
}

/// Type of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorKind {
    /// Reports what its rays hit.
    Proximity,
    /// Also pushes what its rays hit.
    Resistance(ResistanceParameters),
}

/// Contact law of a resistance sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResistanceParameters {
    /// Static friction coefficient. Default: 0.
    pub static_friction: f64,
    /// Friction damping. Default: 0.1.
    pub friction_damping: f64,
    /// Dynamic friction coefficient. Default: 0.
    pub dynamic_friction: f64,
    /// Friction varies with the depth. Default: `false`.
    pub variable_friction: bool,
    /// Contact area, m². Default: 0.1.
    pub contact_area: f64,
    /// Contact stiffness, N/m. Default: 0.
    pub contact_stiffness: f64,
    /// Contact damping, N·s/m. Default: 0.
    pub contact_damping: f64,
}

impl Default for ResistanceParameters {
    fn default() -> Self {
        Self {
            static_friction: 0.0,
            friction_damping: 0.1,
            dynamic_friction: 0.0,
            variable_friction: false,
            contact_area: 0.1,
            contact_stiffness: 0.0,
            contact_damping: 0.0,
        }
    }
}

/// Where the rays of a sensor are, in the sensor frame.
#[derive(Clone, Debug, PartialEq)]
pub enum RaySource {
    /// One by one.
    Array(Vec<Ray>),
    /// One ray a triangle, from its centroid along its normal.
    Mesh {
        /// Where the file may lie, best first; the first that exists is meant. Absolute or relative to the working directory.
        candidates: Vec<PathBuf>,
    },
    /// A fan of `resolution`² rays.
    Parametric {
        /// Rays a side; at least 2, at most 1000.
        resolution: u32,
        /// Full horizontal opening, rad.
        horizontal_angle: f64,
        /// Full vertical opening, rad.
        vertical_angle: f64,
        /// Distance from the sensor's origin at which the rays start, m.
        start_offset: f64,
    },
}

/// A ray from `offset` to `offset + range·direction`, in the sensor frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start, m.
    pub offset: Vector3<f64>,
    /// Direction: finite, not normalised; its length scales the reach.
    pub direction: Vector3<f64>,
}

/// A constraint actuator as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Actuator {
    /// Identity, communication, plugins.
    pub common: Common,
    /// Identifier of the body that carries the actuator.
    pub parent: String,
    /// Pose of the actuator frame in the parent's body frame. Default: identity.
    pub location: Isometry3<f64>,
    /// Draw a marker. Default: `false`.
    pub visible: bool,
    /// Radius of the marker, m. Default: 0.02.
    pub visible_size: f64,
    /// Stored, without use in the reference. Default: 10.
    pub max_impulse: f64,
    /// Stored, without use in the reference. Default: 1.
    pub tau: f64,
}
