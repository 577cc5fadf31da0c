//! Sensors (ray tracers) and actuators.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Vector3};

use super::common::Common;
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::{beside, mesh_path, Base};

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
    /// Where the rays are; no ray for a contact sensor.
    pub rays: RaySource,
}

/// Type of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorKind {
    /// Reports what its rays hit.
    Proximity,
    /// Also pushes what its rays hit.
    Resistance(ResistanceParameters),
    /// Reports what touches its parent body. It has no rays.
    Contact {
        /// Largest distance that counts as contact even without a force, m, negative inside. Default: 0.
        threshold: f64,
        /// The state holds each contact point, not only who touches. Default: `false`.
        details: bool,
    },
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
        /// Where the file may lie, best first; the first that exists is meant. Absolute or relative to the working
        /// directory.
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

/// Largest resolution of a parametric sensor: a million rays.
const MAX_RESOLUTION: u32 = 1000;

/// Key `type`; one that is missing or not among `known` drops the element.
fn type_of(map: &Map<'_>, known: &[&str]) -> Option<String> {
    let text = map.filled("type");
    let expected = known.join(" or ");
    let Some(text) = text else {
        map.reject(ProblemKind::MissingKey, "type", &expected);
        return None;
    };
    let spelling = |n: &&&str| n.to_lowercase() == text || n.to_uppercase() == text || **n == text.as_str();
    let found = known.iter().find(spelling);
    if found.is_none() {
        map.reject(ProblemKind::UnknownValue, "type", &expected);
    }
    found.map(|n| n.to_string())
}

fn parent_of(map: &Map<'_>) -> String {
    let parent = map.filled("parent");
    if parent.is_none() {
        let expected = "the identifier of a body";
        map.reject(ProblemKind::MissingKey, "parent", expected);
    }
    parent.unwrap_or_default()
}

impl Sensor {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let kind = match type_of(map, &["Proximity", "Resistance", "Contact"])?.as_str() {
            "Proximity" => SensorKind::Proximity,
            "Resistance" => SensorKind::Resistance(ResistanceParameters::read(map)),
            _ => SensorKind::Contact {
                threshold: map.real("distance threshold").unwrap_or(0.0),
                details: map.boolean("process contact details").unwrap_or(false),
            },
        };
        let has_rays = !matches!(kind, SensorKind::Contact { .. });
        let sensor = Self {
            common: map.common(base),
            parent: parent_of(map),
            location: map.pose("location").unwrap_or_default(),
            range: map.real_in("range", Range::NotNegative).unwrap_or(0.5),
            visible: map.boolean("visible").unwrap_or(false),
            visible_size: map.real("visible size").unwrap_or(0.02),
            rays: if has_rays { RaySource::read(map, base)? } else { RaySource::Array(Vec::new()) },
            kind,
        };
        if !has_rays {
            map.ignore(&["array", "mesh", "parametric", "range"], "a contact sensor has no rays");
        }
        if !matches!(sensor.kind, SensorKind::Resistance(_)) {
            let why = "only resistance sensors have it";
            map.ignore(&["friction", "contact area"], why);
            map.ignore(&["contact stiffness", "contact damping"], why);
        }
        map.finish();
        Some(sensor)
    }
}

impl ResistanceParameters {
    fn read(map: &Map<'_>) -> Self {
        let default = Self::default();
        let friction = map.map("friction");
        let real = |map: &Map<'_>, key, default| map.real(key).unwrap_or(default);
        let parameters = Self {
            static_friction: real(&friction, "static", default.static_friction),
            friction_damping: real(&friction, "damping", default.friction_damping),
            dynamic_friction: real(&friction, "dynamic", default.dynamic_friction),
            variable_friction: friction.boolean("variable").unwrap_or(false),
            contact_area: real(map, "contact area", default.contact_area),
            contact_stiffness: real(map, "contact stiffness", default.contact_stiffness),
            contact_damping: real(map, "contact damping", default.contact_damping),
        };
        friction.finish();
        map.ignore(&["variable"], "it belongs into `friction`");
        parameters
    }
}

impl RaySource {
    fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        if map.has("array") {
            map.skip(&["mesh", "parametric"]);
            let rays = map.maps("array");
            let rays = rays.iter().map(Ray::read).collect::<Vec<_>>();
            if rays.is_empty() {
                let expected = "at least one {offset, direction}";
                map.reject(ProblemKind::OutOfRange, "array", expected);
            }
            return Some(RaySource::Array(rays));
        }
        if let Some(mesh) = map.filled("mesh") {
            map.skip(&["parametric"]);
            let dir = map.reader().dir();
            let below = |model: &Path| mesh_path(dir, model, Path::new(""), &mesh);
            // The original looks beside the file only, where no existing scene has these meshes.
            let mut candidates = vec![beside(dir, &mesh)];
            candidates.push(below(&base.low_resolution));
            candidates.push(below(&base.high_resolution));
            candidates.dedup();
            return Some(RaySource::Mesh { candidates });
        }
        map.skip(&["mesh"]);
        let Some(fan) = map.map_opt("parametric") else {
            let expected = "`array`, `mesh` or `parametric`";
            map.reject(ProblemKind::MissingKey, "array", expected);
            map.skip(&["direction"]);
            return None;
        };
        let resolution = fan.need_uint("resolution");
        if fan.has("resolution") && !(2..=MAX_RESOLUTION).contains(&resolution) {
            let expected = format!("2 to {MAX_RESOLUTION}");
            fan.reject(ProblemKind::OutOfRange, "resolution", &expected);
        }
        let source = RaySource::Parametric {
            resolution,
            horizontal_angle: fan.need_real("horizontal angle"),
            vertical_angle: fan.need_real("vertical angle"),
            start_offset: fan.need_real("start offset"),
        };
        fan.finish();
        Some(source)
    }
}

impl Ray {
    fn read(map: &Map<'_>) -> Self {
        let ray = Self { offset: map.need_vector("offset"), direction: map.need_vector("direction") };
        map.finish();
        ray
    }
}

impl Actuator {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        type_of(map, &["Constraint"])?;
        let actuator = Self {
            common: map.common(base),
            parent: parent_of(map),
            location: map.pose("location").unwrap_or_default(),
            visible: map.boolean("visible").unwrap_or(false),
            visible_size: map.real("visible size").unwrap_or(0.02),
            max_impulse: map.real("max impulse").unwrap_or(10.0),
            tau: map.real("tau").unwrap_or(1.0),
        };
        map.finish();
        Some(actuator)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::super::Model;
    use super::*;

    fn sensor(keys: &str) -> Sensor {
        let text =
            format!("sensors: [S]\nlow resolution path: lo\nhigh resolution path: hi\nS: {{parent: A, {keys}}}\n");
        clean::<Model>(&text).sensors.remove(0)
    }

    const ARRAY: &str = "array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 1, y: 0, z: 0}}]";

    #[test]
    fn kinds_and_rays() {
        let s = sensor(&format!("type: PROXIMITY, {ARRAY}"));
        assert_eq!((s.kind, s.range, s.visible_size), (SensorKind::Proximity, 0.5, 0.02));
        assert!(matches!(s.rays, RaySource::Array(rays) if rays.len() == 1));
        let s = sensor("type: resistance, mesh: t.stl, friction: {static: 3, variable: Yes}, contact area: 2");
        let SensorKind::Resistance(p) = s.kind else { panic!() };
        assert!(p.variable_friction);
        assert_eq!((p.static_friction, p.friction_damping, p.contact_area), (3.0, 0.1, 2.0));
        let RaySource::Mesh { candidates } = s.rays else { panic!() };
        assert_eq!(candidates, ["dir/t.stl", "dir/lo/t.stl", "dir/hi/t.stl"].map(PathBuf::from));
        let s = sensor("type: Contact, distance threshold: 0.001, process contact details: true");
        let kind = SensorKind::Contact { threshold: 0.001, details: true };
        assert_eq!((s.kind, s.rays), (kind, RaySource::Array(vec![])));
        let fan = "parametric: {resolution: 2, horizontal angle: 1, vertical angle: 0.5, start offset: 0}";
        let s = sensor(&format!("type: Proximity, {fan}"));
        assert!(matches!(s.rays, RaySource::Parametric { resolution: 2, .. }));
    }

    #[test]
    fn unusable_sensors_are_dropped() {
        for keys in [
            ARRAY.to_owned(),
            format!("type: Range, {ARRAY}"),
            "type: Proximity".to_owned(),
            "type: Proximity, array: []".to_owned(),
            format!("type: Proximity, range: -1, {ARRAY}"),
            "type: Proximity, parametric: {resolution: 1, horizontal angle: 1, vertical angle: 1, start offset: 0}"
                .to_owned(),
        ] {
            let text = format!("sensors: [S]\nS: {{parent: A, {keys}}}\n");
            let (model, problems) = read::<Model>(&text);
            assert!(model.sensors.is_empty(), "{keys}");
            assert!(problems[0].contains("the sensor is dropped"), "{problems:?}");
        }
    }

    #[test]
    fn actuators() {
        let text = "actuators: [C, D]\nC: {type: constraint, parent: A}\nD: {type: Motor, parent: A}\n";
        let (model, problems) = read::<Model>(text);
        assert_eq!(model.actuators.len(), 1);
        assert_eq!((model.actuators[0].max_impulse, model.actuators[0].tau), (10.0, 1.0));
        assert!(problems[0].contains("`D / type` is `Motor`, expected Constraint"));
    }
}
