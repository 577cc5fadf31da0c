//! World files.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::camera::Camera;
use super::common::{Common, ShaderProgram};
use super::light::Light;
use super::model::{cameras, lights};
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::{beside, Base};

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

/// What users choose of the physics, in a world file (key `physics`, which the reference does not have), on a command
/// line or in Python. Every part is optional.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhysicsSettings {
    /// `legacy`, `accurate` or `pybullet`.
    pub profile: Option<PhysicsProfile>,
    /// Name of the constraint solver, as written.
    pub solver: Option<String>,
    /// Name of the integrator, as written.
    pub integrator: Option<String>,
    /// Iterations of the constraint solver; at least 1.
    pub iterations: Option<u32>,
    /// Whether joints that form trees are put into reduced coordinates.
    pub articulated: Option<bool>,
    /// Length of a sub-step, s; positive.
    pub sub_step: Option<f64>,
    /// Bodies at rest sleep.
    pub sleep: Option<bool>,
    /// Speed, m/s and rad/s, above which the state counts as lost; positive.
    pub largest_speed: Option<f64>,
    /// Distance from the origin, m, beyond which the state counts as lost; positive.
    pub largest_distance: Option<f64>,
    /// Share of the position error of joints that is corrected in a sub-step, 0 to 1, instead of that of every joint.
    pub joint_erp: Option<f64>,
    /// Name of the way in which the gyroscopic torque is integrated, as written.
    pub gyroscopic: Option<String>,
    /// Whether bodies without mass that commands move have the velocity of their motion.
    pub kinematic_bodies: Option<bool>,
}

/// Profile of the physics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhysicsProfile {
    /// What the reference does.
    Legacy,
    /// The best result at the same cost.
    Accurate,
    /// As the reference, with the solver and the shapes of pybullet.
    PyBullet,
}

impl PhysicsProfile {
    /// All of them, with the names by which users choose.
    pub const NAMES: [(&'static str, Self); 3] =
        [("legacy", Self::Legacy), ("accurate", Self::Accurate), ("pybullet", Self::PyBullet)];

    /// The profile called `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(known, _)| *known == name).map(|&(_, profile)| profile)
    }
}

impl World {
    pub(super) fn read(root: &Map<'_>) -> Self {
        let base = Base::read(root);
        root.ignore(&["name"], "a world is always called World");
        let mut common = root.common(&base);
        common.identifier = "World".into();
        common.name = "World".into();
        common.namespace.clone_from(&base.namespace);
        let environment = root.path_beside("environment");
        if environment.is_some() {
            root.ignore(&["enclosure"], "`environment` replaces it");
        }
        let world = Self {
            common,
            enclosure: match environment {
                Some(_) => None,
                None => Enclosure::read(root),
            },
            environment,
            gravity: (root.vector("gravity")).unwrap_or(Vector3::new(0.0, 0.0, -9.8)),
            max_iterations: at_least_one(root, "max iterations").unwrap_or(10),
            lights: lights(root, &base),
            cameras: cameras(root, &base),
            shaders: root.shaders("shaders"),
            skybox: Skybox::read(root),
            physics: PhysicsSettings::read(root),
        };
        let why = "the original ignores it too; `environment` names a model file";
        root.ignore(&["enclosure size"], why);
        root.finish_root();
        world
    }
}

fn at_least_one(map: &Map<'_>, key: &'static str) -> Option<u32> {
    let n = map.uint(key)?;
    if n == 0 {
        let expected = "an integer, at least 1";
        map.error(ProblemKind::OutOfRange, key, expected, "the default is used");
    }
    (n > 0).then_some(n)
}

impl Enclosure {
    fn read(root: &Map<'_>) -> Option<Self> {
        let block = root.map_opt("enclosure")?;
        root.reader().element("enclosure", || {
            let [length, width, height] =
                ["length", "width", "height"].map(|key| block.need_real_in(key, Range::Positive));
            block.finish();
            Some(Self { length, width, height })
        })
    }
}

impl Skybox {
    fn read(root: &Map<'_>) -> Option<Self> {
        let block = root.map_opt("skybox")?;
        let dir = beside(root.reader().dir(), block.need_string("path"));
        let names = ["right", "left", "top", "bottom", "front", "back"];
        let faces = names.map(|key| block.filled(key));
        let shaders = block.shaders("shaders");
        block.finish();
        if faces.iter().any(Option::is_none) {
            let expected = "all of right, left, top, bottom, front, back";
            let action = "there is no sky box";
            root.warn(ProblemKind::MissingKey, "skybox", expected, action);
            return None;
        }
        Some(Self { faces: faces.map(|face| dir.join(face.unwrap_or_default())), shaders })
    }
}

impl PhysicsSettings {
    fn read(root: &Map<'_>) -> Self {
        let block = root.map("physics");
        let profile = block.string("profile").and_then(|name| {
            let profile = PhysicsProfile::from_name(&name);
            if profile.is_none() {
                let expected = "legacy, accurate or pybullet";
                block.error(ProblemKind::UnknownValue, "profile", expected, "the default is used");
            }
            profile
        });
        let settings = Self {
            profile,
            solver: block.filled("solver"),
            integrator: block.filled("integrator"),
            iterations: at_least_one(&block, "iterations"),
            articulated: block.boolean("articulated"),
            sub_step: block.real_in("sub step", Range::Positive),
            sleep: block.boolean("sleep"),
            largest_speed: block.real_in("largest speed", Range::Positive),
            largest_distance: block.real_in("largest distance", Range::Positive),
            joint_erp: block.real_in("joint erp", Range::Share),
            gyroscopic: block.filled("gyroscopic"),
            kinematic_bodies: block.boolean("kinematic bodies"),
        };
        block.finish();
        settings
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::*;

    #[test]
    fn worlds() {
        let world: World = clean("{}\n");
        assert_eq!((world.common.name.as_str(), world.max_iterations), ("World", 10));
        assert_eq!(world.gravity, Vector3::new(0.0, 0.0, -9.8));
        assert_eq!((world.environment, world.physics), (None, PhysicsSettings::default()));
        let world: World = clean(
            "namespace: env/\nenvironment: e.yaml\nlights: [l]\nl: {namespace: a/}\nmax iterations: 3\n\
             physics: {profile: accurate, solver: nncg, iterations: 4, sub step: 0.0005, joint erp: 0.5, \
             gyroscopic: none, kinematic bodies: true, sleep: true, articulated: false, largest speed: 1e9, largest distance: 1e20}\n",
        );
        assert_eq!(world.common.namespace, "env/");
        assert_eq!(world.lights[0].common.namespace, "env/a/");
        assert_eq!(world.environment, Some("dir/e.yaml".into()));
        assert_eq!(world.physics.profile, Some(PhysicsProfile::Accurate));
        assert_eq!((world.physics.iterations, world.physics.sub_step), (Some(4), Some(0.0005)));
        assert_eq!(world.physics.sleep, Some(true));
        assert_eq!((world.physics.largest_speed, world.physics.largest_distance), (Some(1e9), Some(1e20)));
        assert_eq!((world.physics.articulated, world.physics.kinematic_bodies), (Some(false), Some(true)));
        assert_eq!((world.physics.joint_erp, world.physics.gyroscopic.as_deref()), (Some(0.5), Some("none")));
        let world: World = clean("physics: {profile: pybullet}\n");
        assert_eq!(world.physics.profile, Some(PhysicsProfile::PyBullet));
    }

    #[test]
    fn unusable_parts_leave_the_default() {
        let text = "max iterations: 0\ngravity: {x: .nan, y: 0, z: 0}\nenclosure: {length: 1, width: -1, height: 1}\n\
                    physics: {profile: best}\nskybox: {path: p, right: r.png}\n";
        let (world, problems) = read::<World>(text);
        assert_eq!((world.max_iterations, world.enclosure), (10, None));
        assert_eq!(world.gravity, Vector3::new(0.0, 0.0, -9.8));
        assert_eq!((world.physics.profile, world.skybox), (None, None));
        assert_eq!(problems.len(), 5, "{problems:#?}");
    }
}
