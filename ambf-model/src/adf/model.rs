//! Model (multibody) files.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;

use super::body::RigidBody;
use super::camera::Camera;
use super::common::{PluginEntry, ShaderProgram};
use super::coupling;
use super::ghost::GhostObject;
use super::joint::Joint;
use super::keyframe::Keyframe;
use super::light::Light;
use super::reader::{Absent, Map};
use super::sensor::{Actuator, Sensor};
use super::soft_body::SoftBody;
use super::values::Base;
use super::vehicle::Vehicle;
use super::volume::Volume;

macro_rules! object_types {
    ($($(#[$doc:meta])* $kind:ident = $number:literal, $words:literal in $list:literal;)*) => {
        /// Types of objects that a model is made of.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum ObjectType {
            $($(#[$doc])* $kind = $number,)*
        }

        impl ObjectType {
            /// All types, in the order of their numbers.
            pub const ALL: [Self; [$($number),*].len()] = [$(Self::$kind),*];

            /// What a message calls it.
            pub const fn words(self) -> &'static str {
                match self {
                    $(Self::$kind => $words,)*
                }
            }

            /// The key of a model file that lists objects of this type.
            pub const fn list(self) -> &'static str {
                match self {
                    $(Self::$kind => $list,)*
                }
            }
        }
    };
}

// A line a type: number, name in messages, list in files. New ones at the end: plugins know the numbers.
object_types! {
    /// Rigid body.
    Body = 0, "body" in "bodies";
    /// Soft body.
    SoftBody = 1, "soft body" in "soft bodies";
    /// Ghost object.
    Ghost = 2, "ghost object" in "ghost objects";
    /// Joint.
    Joint = 3, "joint" in "joints";
    /// Sensor.
    Sensor = 4, "sensor" in "sensors";
    /// Actuator.
    Actuator = 5, "actuator" in "actuators";
    /// Vehicle.
    Vehicle = 6, "vehicle" in "vehicles";
    /// Camera.
    Camera = 7, "camera" in "cameras";
    /// Light.
    Light = 8, "light" in "lights";
    /// Volume.
    Volume = 9, "volume" in "volumes";
}

impl ObjectType {
    /// The type with a number.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }

    /// Whether world files have a list of them, too.
    pub fn is_in_worlds(self) -> bool {
        matches!(self, Self::Camera | Self::Light)
    }

    /// Reads the objects of this type that `root` lists.
    fn read<T>(self, root: &Map<'_>, absent: Absent, read: impl Fn(&Map<'_>) -> Option<T>) -> Vec<T> {
        root.elements(self.list(), self.words(), absent, read)
    }
}

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
    /// Links without a mass carry others between joints: only joints in reduced coordinates hold there in every profile. Never
    /// in ADF files.
    pub has_massless_links: bool,
    /// Gravity of the model's rigid bodies that have no own, m/s²; `None`: the world's.
    pub gravity: Option<Vector3<f64>>,
    /// Shaders of the model's objects that have no own.
    pub shaders: Option<ShaderProgram>,
    /// Model plugins.
    pub plugins: Vec<PluginEntry>,
    /// States that it names. Never in ADF files.
    pub keyframes: Vec<Keyframe>,
}

impl Model {
    /// Whether joints in reduced coordinates hold in every profile where constraints between bodies would give way: links without
    /// a mass carry others, or joints are coupled.
    pub fn wants_reduced_coordinates(&self) -> bool {
        self.has_massless_links || self.joints.iter().any(|joint| joint.coupling.is_some())
    }

    /// Names and file without anything else: what is kept of a model that was taken out of a scene.
    pub fn outline(&self) -> Self {
        Self::empty(self.name.clone(), self.namespace.clone(), Arc::clone(&self.file))
    }

    pub(super) fn read(root: &Map<'_>) -> Self {
        let base = Base::read(root);
        let file = root.reader().file().clone();
        let name = file.file_name().unwrap_or_default();
        let (made, dropped) = (Absent::Made("an unnamed body of 1 kg without a shape is made"), Absent::Dropped);
        let mut model = Self {
            name: name.to_string_lossy().into_owned(),
            bodies: ObjectType::Body.read(root, made, |map| RigidBody::read(map, &base)),
            soft_bodies: ObjectType::SoftBody.read(root, dropped, |map| SoftBody::read(map, &base)),
            ghosts: ObjectType::Ghost.read(root, dropped, |map| GhostObject::read(map, &base)),
            sensors: ObjectType::Sensor.read(root, dropped, |map| Sensor::read(map, &base)),
            actuators: ObjectType::Actuator.read(root, dropped, |map| Actuator::read(map, &base)),
            joints: ObjectType::Joint.read(root, Absent::Refused, |map| Joint::read(map, &base)),
            vehicles: ObjectType::Vehicle.read(root, dropped, |map| Vehicle::read(map, &base)),
            cameras: cameras(root, &base),
            lights: lights(root, &base),
            volumes: ObjectType::Volume
                .read(root, Absent::Made("an empty one is made"), |map| Volume::read(map, &base)),
            ignore_inter_collision: root.boolean("ignore inter-collision").unwrap_or(false),
            has_massless_links: false,
            gravity: root.vector("gravity"),
            shaders: root.shaders("shaders"),
            plugins: root.plugins("plugins"),
            keyframes: vec![],
            namespace: base.namespace,
            file,
        };
        let carriers = model.volumes.iter_mut().filter_map(Volume::take_carrier);
        model.bodies.extend(carriers);
        coupling::check(root, &mut model.joints);
        root.ignore(&["joint erp", "joint cfm"], "only those of each joint count");
        root.finish_root();
        model
    }

    /// A model without objects.
    pub(crate) fn empty(name: String, namespace: String, file: Arc<Path>) -> Self {
        Self {
            name,
            namespace,
            file,
            bodies: vec![],
            soft_bodies: vec![],
            ghosts: vec![],
            sensors: vec![],
            actuators: vec![],
            joints: vec![],
            vehicles: vec![],
            cameras: vec![],
            lights: vec![],
            volumes: vec![],
            ignore_inter_collision: false,
            has_massless_links: false,
            gravity: None,
            shaders: None,
            plugins: vec![],
            keyframes: vec![],
        }
    }
}

/// Cameras of a model or a world.
pub(super) fn cameras(root: &Map<'_>, base: &Base) -> Vec<Camera> {
    let absent = Absent::Made("one with defaults is made");
    ObjectType::Camera.read(root, absent, |map| Camera::read(map, base))
}

/// Lights of a model or a world.
pub(super) fn lights(root: &Map<'_>, base: &Base) -> Vec<Light> {
    let absent = Absent::Made("one with defaults is made");
    ObjectType::Light.read(root, absent, |map| Light::read(map, base))
}

#[cfg(test)]
mod tests {
    use super::super::tests::read;
    use super::super::{FileKind, Outline};
    use super::*;

    #[test]
    fn objects_of_each_type_are_read_from_its_list_which_tells_a_model() {
        for kind in ObjectType::ALL {
            assert_eq!(ObjectType::from_number(kind as u32), Some(kind));
            let text = format!("{}: [X]\nX:\n", kind.list());
            let (_, problems) = read::<Model>(&text);
            let dropped = format!("the {} is dropped", kind.words());
            assert!(problems.iter().any(|problem| problem.contains(&dropped)), "{kind:?}: {problems:?}");
            let outline = Outline::parse(&text, Path::new("x.yaml")).unwrap();
            let expected = if kind.is_in_worlds() { FileKind::World } else { FileKind::Model };
            assert_eq!(outline.kind(), Some(expected), "{kind:?}");
        }
    }
}
