//! Value shapes that several elements use: vectors, poses, paths, names, colours, gains.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::common::{Common, Material, PhysicalMaterial, PluginEntry, ShaderProgram};
use super::controller::{CartesianController, Controller, ControllerOutput, Gains};
use super::reader::{Map, Range};
use super::report::ProblemKind;

/// What the elements of a file inherit from its root.
#[derive(Clone, Debug, Default)]
pub(super) struct Base {
    /// Namespace of the file.
    pub namespace: String,
    /// Key `high resolution path` as written.
    pub high_resolution: PathBuf,
    /// Key `low resolution path` as written.
    pub low_resolution: PathBuf,
}

impl Base {
    /// Reads the keys of a root.
    pub(super) fn read(root: &Map<'_>) -> Self {
        let path = |key| root.filled(key).map(PathBuf::from).unwrap_or_default();
        Self {
            namespace: merge_namespace("", root.filled("namespace").as_deref()),
            high_resolution: path("high resolution path"),
            low_resolution: path("low resolution path"),
        }
    }
}

/// Effective namespace of an element: absolute as written, relative appended without a separator.
pub(super) fn merge_namespace(file: &str, element: Option<&str>) -> String {
    let mut part = String::new();
    for c in element.unwrap_or("").chars() {
        if !(c == '/' && part.ends_with('/')) {
            part.push(c);
        }
    }
    if part.starts_with('/') {
        part
    } else {
        format!("{file}{part}")
    }
}

/// Joins a path to the directory of the file unless it is absolute. `.` on the way is left out: it would only stand in
/// messages.
pub(super) fn beside(dir: &Path, path: impl AsRef<Path>) -> PathBuf {
    dir.join(path).components().collect()
}

/// Path of a mesh: below the element's directory; if that is relative below the model's; if still relative below the
/// file's.
pub(super) fn mesh_path(dir: &Path, model: &Path, element: &Path, mesh: &str) -> PathBuf {
    let mut path = element.join(mesh);
    if path.is_relative() {
        path = model.join(path);
    }
    if path.is_relative() {
        path = dir.join(path);
    }
    path.components().collect()
}

/// A vector whose components are all there and finite.
fn vector_of(map: &Map<'_>, keys: [&str; 3]) -> Option<Vector3<f64>> {
    let [x, y, z] = keys.map(|key| {
        if !map.has(key) {
            map.missing(key, Range::Any.words());
        }
        map.real(key)
    });
    Some(Vector3::new(x?, y?, z?))
}

/// Rotation by roll, pitch, yaw about fixed axes: R = Rz(y)·Ry(p)·Rx(r).
fn rotation_of(map: &Map<'_>) -> Option<UnitQuaternion<f64>> {
    let rpy = vector_of(map, ["r", "p", "y"]);
    map.finish();
    rpy.map(|rpy| UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z))
}

impl Map<'_> {
    /// `{x, y, z}`, all required and finite.
    pub(super) fn vector(&self, key: &str) -> Option<Vector3<f64>> {
        self.vector_named(key, ["x", "y", "z"])
    }

    pub(super) fn vector_named(&self, key: &str, keys: [&str; 3]) -> Option<Vector3<f64>> {
        let map = self.map_opt(key)?;
        let vector = vector_of(&map, keys);
        map.finish();
        vector
    }

    /// A required vector; zero after a problem.
    pub(super) fn need_vector(&self, key: &str) -> Vector3<f64> {
        if !self.has(key) {
            self.missing(key, "a mapping {x, y, z}");
        }
        self.vector(key).unwrap_or_default()
    }

    /// A vector that is not zero; a zero one drops the element being read.
    pub(super) fn reject_zero(&self, key: &str, vector: &Vector3<f64>) {
        // Numbers whose squares underflow or overflow cannot be normalised.
        if self.has(key) && !vector.norm_squared().is_normal() {
            self.reject_numbers(key, vector.as_slice(), "a direction that is not zero");
        }
    }

    /// `{r, p, y}`, all required, rad.
    pub(super) fn rotation(&self, key: &str) -> Option<UnitQuaternion<f64>> {
        self.map_opt(key).and_then(|map| rotation_of(&map))
    }

    /// `{position, orientation}`, both optional.
    pub(super) fn pose(&self, key: &str) -> Option<Isometry3<f64>> {
        let map = self.map_opt(key)?;
        let position = map.vector("position").unwrap_or_default();
        let orientation = map.rotation("orientation").unwrap_or_default();
        map.finish();
        Some(Isometry3::from_parts(position.into(), orientation))
    }

    /// `{x, y, z}` with an optional `orientation`: the location of a light.
    pub(super) fn flat_pose(&self, key: &str) -> Option<Isometry3<f64>> {
        let map = self.map_opt(key)?;
        let position = vector_of(&map, ["x", "y", "z"]).unwrap_or_default();
        let orientation = map.rotation("orientation").unwrap_or_default();
        map.finish();
        Some(Isometry3::from_parts(Translation3::from(position), orientation))
    }

    /// A path beside the file; absent, null and empty are `None`.
    pub(super) fn path_beside(&self, key: &str) -> Option<PathBuf> {
        self.filled(key).map(|path| beside(self.reader().dir(), path))
    }

    /// Identity, communication and plugins of an element.
    pub(super) fn common(&self, base: &Base) -> Common {
        Common {
            identifier: self.key().to_owned(),
            name: self.string("name").map_or(String::new(), |n| n.replace(' ', "")),
            namespace: merge_namespace(&base.namespace, self.filled("namespace").as_deref()),
            passive: self.boolean("passive").unwrap_or(false),
            publish_frequency: self.map_opt("publish frequency").map(|map| {
                let range = (map.need_uint("low"), map.need_uint("high"));
                map.finish();
                range
            }),
            plugins: self.plugins("plugins"),
            source: self.reader().source(self.mark),
        }
    }

    /// The list of plugins under `key`.
    pub(super) fn plugins(&self, key: &'static str) -> Vec<PluginEntry> {
        let mut plugins = Vec::new();
        for map in self.maps(key) {
            let entry = (map.string("name"), map.string("filename"));
            let path = map.path_beside("path");
            map.finish();
            if let (Some(name), Some(filename)) = entry {
                plugins.push(PluginEntry {
                    name,
                    filename: filename.into(),
                    path,
                    source: self.reader().source(map.mark),
                });
            } else {
                let action = "the entry is skipped";
                map.error(ProblemKind::MissingKey, "", "`name` and `filename` are required", action);
            }
        }
        plugins
    }

    pub(super) fn shaders(&self, key: &str) -> Option<ShaderProgram> {
        let map = self.map_opt(key)?;
        let dir = beside(self.reader().dir(), map.need_string("path"));
        let program = ShaderProgram {
            vertex: dir.join(map.need_string("vertex")),
            fragment: dir.join(map.need_string("fragment")),
        };
        map.finish();
        Some(program)
    }

    /// Material of the colour keys.
    pub(super) fn material(&self) -> Option<Material> {
        let use_material = self.boolean("use material").unwrap_or(true);
        let why = "named colours have no effect; write `color rgba` or `color components`";
        let has_colour = self.has("color rgba") || self.has("color components");
        if has_colour {
            self.skip(&["color"]);
        } else {
            self.ignore(&["color"], why);
        }
        let material = if let Some(map) = self.map_opt("color rgba") {
            self.skip(&["color components"]);
            let diffuse = map.rgb();
            let alpha = map.need_colour("a");
            map.finish();
            Material { ambient: diffuse.map(|c| 0.5 * c), diffuse, alpha, ..Material::default() }
        } else {
            self.map_opt("color components")?.colour_components()
        };
        use_material.then_some(material)
    }

    fn colour_components(&self) -> Material {
        let mut material = Material { alpha: self.need_colour("transparency"), ..Material::default() };
        for (key, colour) in [
            ("diffuse", &mut material.diffuse),
            ("specular", &mut material.specular),
            ("emission", &mut material.emission),
        ] {
            if let Some(map) = self.map_opt(key) {
                *colour = map.rgb();
                map.finish();
            }
        }
        if let Some(map) = self.map_opt("ambient") {
            let level = map.need_colour("level");
            material.ambient = material.diffuse.map(|c| level * c);
            map.finish();
        }
        if let Some(shininess) = self.uint("shininess") {
            material.shininess = shininess;
        }
        let (metallic, roughness) = (self.fraction("metallic"), self.fraction("roughness"));
        material.physical = (metallic.is_some() || roughness.is_some())
            .then(|| PhysicalMaterial { metallic: metallic.unwrap_or(0.0), roughness: roughness.unwrap_or(0.5) });
        self.finish();
        material
    }

    fn rgb(&self) -> [f64; 3] {
        ["r", "g", "b"].map(|key| self.need_colour(key))
    }

    /// A required share of a colour. A non-finite one cannot hurt the physics: 0 is drawn instead.
    fn need_colour(&self, key: &str) -> f64 {
        if !self.has(key) {
            self.missing(key, "a number from 0 to 1");
        }
        let value = self.any_real(key).unwrap_or(0.0);
        if value.is_finite() {
            return value;
        }
        let expected = "a number from 0 to 1";
        self.error(ProblemKind::NonFinite, key, expected, "0 is used");
        0.0
    }

    /// A number from 0 to 1 that has a default. One beyond is clamped.
    fn fraction(&self, key: &str) -> Option<f64> {
        let value = self.any_real(key)?;
        let expected = "a number from 0 to 1";
        if value.is_nan() {
            self.error(ProblemKind::NonFinite, key, expected, "the default is used");
            return None;
        }
        if !(0.0..=1.0).contains(&value) {
            self.warn(ProblemKind::OutOfRange, key, expected, "the nearest one is used");
        }
        Some(value.clamp(0.0, 1.0))
    }

    /// Key `controller` of a body, or one with the same grammar.
    pub(super) fn cartesian_controller(&self, key: &str) -> Option<CartesianController> {
        let Some(map) = self.map_opt(key) else {
            let why = "it needs a `controller`";
            self.ignore(&["controller output type"], why);
            return None;
        };
        let part = |key| match map.map_opt(key) {
            None => Controller::default(),
            Some(gains) => {
                let controller = Controller {
                    gains: Gains {
                        p: gains.need_real("P"),
                        i: gains.real("I").unwrap_or(0.0),
                        d: gains.need_real("D"),
                    },
                    output: ControllerOutput::Force,
                };
                gains.finish();
                controller
            }
        };
        let mut controller = CartesianController { linear: part("linear"), angular: part("angular") };
        map.finish();
        if let Some(output) = self.controller_output() {
            controller.linear.output = output;
            controller.angular.output = output;
        }
        Some(controller)
    }

    pub(super) fn controller_output(&self) -> Option<ControllerOutput> {
        let text = self.string("controller output type")?;
        Some(match text.as_str() {
            "FORCE" | "EFFORT" | "force" | "effort" => ControllerOutput::Force,
            "VELOCITY" | "velocity" => ControllerOutput::Velocity,
            "POSITION" | "position" => ControllerOutput::Position,
            _ => {
                let expected = "FORCE, VELOCITY or POSITION";
                let key = "controller output type";
                self.error(ProblemKind::UnknownValue, key, expected, "FORCE is used");
                ControllerOutput::Force
            }
        })
    }

    /// Key `scale`.
    pub(super) fn scale(&self) -> f64 {
        self.real_in("scale", Range::Positive).unwrap_or(1.0)
    }

    /// Keys of collision groups; those out of range are left out.
    pub(super) fn collision_groups(&self) -> Vec<u32> {
        let key = "collision groups";
        let groups = self.ints(key);
        let valid = groups.iter().filter(|g| (0..1000).contains(*g));
        let valid: Vec<u32> = valid.filter_map(|g| u32::try_from(*g).ok()).collect();
        if valid.len() < groups.len() {
            let expected = "groups from 0 to 999";
            self.warn(ProblemKind::OutOfRange, key, expected, "the others are left out");
        }
        valid
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn namespaces() {
        assert_eq!(merge_namespace("", Some("//ambf///env/")), "/ambf/env/");
        assert_eq!(merge_namespace("/ambf/env/", Some("lights/")), "/ambf/env/lights/");
        assert_eq!(merge_namespace("/ambf/env", Some("a")), "/ambf/enva");
        assert_eq!(merge_namespace("/ambf/env/", Some("/b//")), "/b/");
        assert_eq!(merge_namespace("/ambf/env/", None), "/ambf/env/");
    }

    #[test]
    fn mesh_paths() {
        let path = |model: &str, element: &str, mesh: &str| {
            mesh_path(Path::new("/adf"), Path::new(model), Path::new(element), mesh)
        };
        assert_eq!(path("high/", "", "a b.STL"), Path::new("/adf/high/a b.STL"));
        assert_eq!(path("high", "own", "m.stl"), Path::new("/adf/high/own/m.stl"));
        assert_eq!(path("/high", "own", "m.stl"), Path::new("/high/own/m.stl"));
        assert_eq!(path("high", "/own", "m.stl"), Path::new("/own/m.stl"));
        assert_eq!(path("high", "/own", "/m.stl"), Path::new("/m.stl"));
        assert_eq!(path("", "", "m.stl"), Path::new("/adf/m.stl"));
    }

    #[test]
    fn rotations_are_fixed_axis_roll_pitch_yaw() {
        let text = "bodies: [A]\nA: {mass: 1, mesh: m, location: {orientation: {r: 0.3, p: -0.7, y: 1.9}}}\n";
        let model = super::super::tests::clean::<super::super::Model>(text);
        let rotation = model.bodies[0].location.rotation.to_rotation_matrix();
        let about = |axis, angle| nalgebra::Rotation3::from_axis_angle(&axis, angle);
        let expected = about(Vector3::z_axis(), 1.9) * about(Vector3::y_axis(), -0.7) * about(Vector3::x_axis(), 0.3);
        assert!((rotation.matrix() - expected.matrix()).norm() < 1e-12);
    }

    #[test]
    fn materials() {
        let material = |keys: &str| {
            let text = format!("bodies: [A]\nA: {{mass: 1, mesh: m, {keys}}}\n");
            let (mut model, problems) = super::super::tests::read::<super::super::Model>(&text);
            (model.bodies.remove(0).visual.material, problems.len())
        };
        let rgba = "color rgba: {r: 1, g: 0.5, b: 0, a: 0.25}";
        let (found, problems) = material(&format!("{rgba}, color components: 3, color: red"));
        let found = found.expect("a material");
        assert_eq!((found.ambient, found.alpha, problems), ([0.5, 0.25, 0.0], 0.25, 0));
        assert_eq!(material(&format!("{rgba}, use material: no")), (None, 0));
        assert_eq!(material("color: random"), (None, 1));
        let (found, _) = material(
            "color components: {transparency: 0.5, ambient: {level: 0.1}, emission: {r: 1, g: 1, b: 1}, shininess: 3}",
        );
        let expected =
            Material { ambient: [0.7 * 0.1; 3], emission: [1.0; 3], alpha: 0.5, shininess: 3, ..Material::default() };
        assert_eq!(found, Some(expected));
        let physical = |keys: &str| {
            let (found, problems) = material(&format!("color components: {{transparency: 1, {keys}}}"));
            (found.and_then(|m| m.physical).map(|physical| (physical.metallic, physical.roughness)), problems)
        };
        assert_eq!(physical("metallic: 1, roughness: 0.2"), (Some((1.0, 0.2)), 0));
        assert_eq!(physical("roughness: 7"), (Some((0.0, 1.0)), 1));
        assert_eq!(physical("metallic: .nan"), (None, 1));
        assert_eq!(physical("shininess: 7"), (None, 0));
        // A colour cannot hurt the physics: the body stays.
        let (found, problems) = material("color rgba: {r: .nan, g: 0, b: 0, a: 1}");
        assert_eq!((found.map(|m| m.diffuse[0]), problems), (Some(0.0), 1));
    }
}
