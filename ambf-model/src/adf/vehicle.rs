//! Ray-cast vehicles.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::common::{Common, SourcePos};
use super::joint::Limits;
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::{beside, mesh_path, Base};

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

impl Vehicle {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let chassis = map.filled("chassis");
        if chassis.is_none() {
            let expected = "the identifier of a body";
            map.reject(ProblemKind::MissingKey, "chassis", expected);
        }
        let own: PathBuf = (map.filled("high resolution path")).unwrap_or_default().into();
        let r = map.reader();
        let wheel = |wheel: &Map<'_>| r.element("wheel", || Wheel::read(wheel, base, &own));
        let wheels = map.maps("wheels").iter().filter_map(wheel).collect();
        let vehicle = Self { common: map.common(base), chassis: chassis.unwrap_or_default(), wheels };
        map.finish();
        Some(vehicle)
    }
}

impl Wheel {
    fn read(map: &Map<'_>, base: &Base, own: &Path) -> Option<Self> {
        let dir = map.reader().dir();
        let visual = if let Some(body) = map.filled("body") {
            map.skip(&["mesh"]);
            WheelVisual::Body(body)
        } else if let Some(mesh) = map.filled("mesh") {
            // The original takes the name relative to the working directory.
            let candidates =
                vec![PathBuf::from(&mesh), mesh_path(dir, &base.high_resolution, own, &mesh), beside(dir, &mesh)];
            WheelVisual::Mesh(candidates)
        } else {
            let expected = "a `body` or a `mesh`";
            map.reject(ProblemKind::MissingKey, "body", expected);
            return None;
        };
        for key in ["radius", "friction", "suspension", "roll influence"] {
            if !map.has(key) {
                let expected = "the original has no default";
                map.warn(ProblemKind::Absent, key, expected, "Bullet's is used");
            }
        }
        let zero = Limits { low: 0.0, high: 0.0 };
        let wheel = Self {
            visual,
            width: map.real("width").unwrap_or(0.0),
            radius: map.real_in("radius", Range::Positive).unwrap_or(0.3),
            friction: map.real("friction").unwrap_or(10.5),
            suspension: Suspension::read(map),
            roll_influence: map.real("roll influence").unwrap_or(0.1),
            down_direction: map.vector("down direction").unwrap_or_default(),
            axle_direction: map.vector("axel direction").unwrap_or_default(),
            offset: map.vector("offset").unwrap_or_default(),
            front: map.boolean("front").unwrap_or(false),
            steering_limits: map.map_opt("steering limits").map_or(zero, |limits| {
                let range = Limits { low: limits.need_real("low"), high: limits.need_real("high") };
                limits.finish();
                range
            }),
            max_engine_power: map.real("max engine power").unwrap_or(0.0),
            max_brake_power: map.real("max brake power").unwrap_or(0.0),
            source: map.reader().source(map.mark),
        };
        map.finish();
        Some(wheel)
    }
}

impl Suspension {
    fn read(map: &Map<'_>) -> Self {
        map.map_opt("suspension").map_or(Self::default(), |block| {
            let suspension = Self {
                stiffness: block.need_real("stiffness"),
                damping: block.need_real("damping"),
                compression: block.need_real("compression"),
                rest_length: block.need_real("rest length"),
            };
            block.finish();
            suspension
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::read;
    use super::super::Model;
    use super::*;

    #[test]
    fn wheels() {
        let text = "vehicles: [V]\nV:\n  chassis: C\n  wheels: [{body: W, radius: 0.4, friction: 1, roll influence: 1,
    suspension: {stiffness: 1, damping: 2, compression: 3, rest length: 4}, front: True,
    steering limits: {low: -1, high: 1}}, {mesh: w.stl}, {radius: 1}, {body: W, radius: 0}]\n";
        let (model, problems) = read::<Model>(text);
        let wheels = &model.vehicles[0].wheels;
        assert_eq!(wheels.len(), 2);
        assert_eq!(wheels[0].visual, WheelVisual::Body("W".into()));
        assert_eq!(wheels[0].suspension.rest_length, 4.0);
        assert_eq!((wheels[0].steering_limits.low, wheels[0].front), (-1.0, true));
        assert_eq!((wheels[1].radius, wheels[1].suspension), (0.3, Suspension::default()));
        let errors: Vec<_> = problems.iter().filter(|p| p.contains("error")).collect();
        assert_eq!(errors.len(), 2, "{problems:#?}");
        assert!(errors[0].contains("`V / wheels[2] / body` is missing (a `body` or a `mesh`); the wheel is dropped"));
    }

    #[test]
    fn a_chassis_is_required() {
        let (model, problems) = read::<Model>("vehicles: [V]\nV: {wheels: []}\n");
        assert!(model.vehicles.is_empty() && problems[0].contains("the vehicle is dropped"));
    }
}
