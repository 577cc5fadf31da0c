//! Lights.

use nalgebra::{Isometry3, Vector3};

use super::common::Common;
use super::reader::Map;
use super::report::ProblemKind;
use super::values::Base;

/// A spot light as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Identity, communication, plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Pose in the parent's frame. Default: identity.
    pub location: Isometry3<f64>,
    /// The light points along its local +x; a direction replaces its orientation. `None` (or nearly zero): the
    /// orientation stays.
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

impl Light {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let mut shadow_quality = map.uint("shadow quality").unwrap_or(0);
        if shadow_quality > 5 {
            let key = "shadow quality";
            map.warn(ProblemKind::OutOfRange, key, "0 to 5", "0 is used");
            shadow_quality = 0;
        }
        let light = Self {
            common: map.common(base),
            parent: map.filled("parent").unwrap_or_default(),
            location: map.flat_pose("location").unwrap_or_default(),
            direction: map.vector("direction"),
            spot_exponent: map.real("spot exponent").unwrap_or(0.7),
            cutoff_angle: map.real("cutoff angle").unwrap_or(0.7),
            shadow_quality,
            attenuation: map.map_opt("attenuation").map(|block| {
                let attenuation = Attenuation {
                    constant: block.real("constant").unwrap_or(1.0),
                    linear: block.real("linear").unwrap_or(0.0),
                    quadratic: block.real("quadratic").unwrap_or(0.0),
                };
                block.finish();
                attenuation
            }),
        };
        map.finish();
        Some(light)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read, refused};
    use super::super::Model;
    use super::*;

    #[test]
    fn lights() {
        let text = "lights: [L]\nL: {location: {x: 1, y: 2, z: 3, orientation: {r: 0, p: 0, y: 1}}, attenuation: {linear: 2}}\n";
        let light = clean::<Model>(text).lights.remove(0);
        assert_eq!(light.location.translation.vector, Vector3::new(1.0, 2.0, 3.0));
        assert!((light.location.rotation.angle() - 1.0).abs() < 1e-12);
        let attenuation = light.attenuation.expect("a block");
        assert_eq!((attenuation.constant, attenuation.linear), (1.0, 2.0));
        assert_eq!((light.direction, light.cutoff_angle), (None, 0.7));
        let (model, problems) = read::<Model>("lights: [L]\nL: {shadow quality: 6}\n");
        assert_eq!((model.lights[0].shadow_quality, problems.len()), (0, 1));
        let text = "lights: [L]\nL: {location: {position: {x: 1, y: 2, z: 3}}}\n";
        assert!(refused::<Model>(text)[0].contains("`L / location / x` is missing"));
    }
}
