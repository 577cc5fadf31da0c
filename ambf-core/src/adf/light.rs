//! Lights.

use nalgebra::{Isometry3, Vector3};

use super::common::Common;

/// A spot light as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Identity, communication, plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Pose in the parent's frame. Default: identity.
    pub location: Isometry3<f64>,
    /// The light points along its local +x; a direction replaces its orientation. `None` (or nearly zero): the orientation stays.
    pub direction: Option<Vector3<f64>>,
    /// Default: 0.7.
    pub spot_exponent: f64,
    /// Half opening, rad. Default: 0.7.
    pub cutoff_angle: f64,
    /// 0 (none) to 5 (very high). Default: 0.
    pub shadow_quality: u32,
    /// Attenuation; `None`: the renderer's.
    pub attenuation: Option<Attenuation>,
}

/// Attenuation 1 / (constant + linear·d + quadratic·d²) at the distance d in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attenuation {
    /// Default: 1.
    pub constant: f64,
    /// 1/m. Default: 0.
    pub linear: f64,
    /// 1/m². Default: 0.
    pub quadratic: f64,
}
