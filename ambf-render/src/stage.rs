//! What of a scene is on the graphics card, and what is drawn besides its objects.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;

use ambf_core::adf;
use ambf_core::comm::{RayReading, Snapshot, SpotReading, ToolReading};
use ambf_core::ids::{
    ActuatorId, BodyId, CameraId, GhostId, LightId, SensorId, SoftBodyId, Table, VehicleId, VolumeId,
};
use ambf_core::plugin::Pixels;
use ambf_core::scene::VisualScene;
use nalgebra::{Isometry3, Matrix4, Point3, Vector3};

use crate::meshes::{Part, SoftPart};
use crate::volumes::Isosurface;

/// A scene as a renderer draws it: loaded meshes, poses, and what a user wants to see besides.
#[derive(Default)]
pub struct Stage {
    /// Frames (axes) of all objects are drawn.
    pub frames: bool,
    /// Objects whose frames are the other way round than [`frames`](Self::frames) says, by qualified identifier.
    pub own_frames: BTreeSet<String>,
    /// Sensors are drawn: `None`: those that are visible by their description.
    pub sensors: Option<bool>,
    /// Actuators are drawn: `None`: those that are visible by their description.
    pub actuators: Option<bool>,
    /// Collision shapes are drawn as wire frames.
    pub collision_shapes: bool,
    /// What is drawn besides the objects of the scene.
    pub markers: Vec<Marker>,
    /// Pictures behind the scene and before its sky, the first one farthest back.
    pub backdrops: Vec<Backdrop>,
    /// A body in another colour.
    pub highlight: Option<Highlight>,
    /// Normal maps are not used.
    pub normal_maps_off: bool,
    /// What was loaded for it.
    pub(crate) built: Option<Built>,
}

/// A picture behind the scene, upright. It is drawn where markers are.
#[derive(Debug, Clone, PartialEq)]
pub struct Backdrop {
    /// Loaded anew when it is another `Arc`.
    pub pixels: Arc<Pixels>,
    /// Left, top, width and height in pixels of what is drawn.
    pub area: [f64; 4],
    /// Red, green, blue and alpha, 0 to 1, by which the picture is multiplied.
    pub color: [f32; 4],
}

/// A rigid body that is drawn in another colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Highlight {
    /// Which one.
    pub body: BodyId,
    /// Red, green, blue, 0 to 1.
    pub color: [f32; 3],
}

/// Something that is drawn besides the objects of the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// What.
    pub shape: MarkerShape,
    /// Pose in the world.
    pub pose: Isometry3<f64>,
    /// Red, green, blue, alpha, 0 to 1.
    pub color: [f32; 4],
}

/// Shape of a [`Marker`].
#[derive(Debug, Clone, PartialEq)]
pub enum MarkerShape {
    /// A ball of this radius, m.
    Sphere(f32),
    /// A box of these full edge lengths, m.
    Box([f32; 3]),
    /// An arrow along +x: length and radius of the shaft, m.
    Arrow(f32, f32),
    /// Three arrows of this length, m: x red, y green, z blue; the colour is not used.
    Frame(f32),
    /// Square points of this size in pixels, unlit.
    Points(Vec<[f32; 3]>, f32),
    /// Lines between successive pairs of points, unlit, one pixel wide.
    Lines(Vec<[f32; 3]>),
}

/// Length of the frame of an object whose size is not computed, m.
const FRAME_WITHOUT_SIZE: f64 = 0.2;

/// A scene that is loaded.
pub(crate) struct Built {
    /// Which renderer loaded it.
    pub(crate) renderer: u64,
    pub(crate) visuals: Arc<VisualScene>,
    pub(crate) objects: Vec<Object>,
    pub(crate) items: Vec<Item>,
    pub(crate) soft_items: Vec<SoftItem>,
    /// Collision shapes, once they were asked for.
    pub(crate) collision_items: Option<Vec<Item>>,
    /// Changes with the shapes of soft bodies.
    pub(crate) soft_version: u64,
    pub(crate) snapshot: SnapshotParts,
    /// Messages that were given.
    pub(crate) said: HashSet<String>,
}

/// What of a snapshot is drawn besides poses.
#[derive(Default)]
pub(crate) struct SnapshotParts {
    pub(crate) spots: Table<LightId, SpotReading>,
    pub(crate) sensors: Table<SensorId, Vec<RayReading>>,
    pub(crate) actuators: Table<ActuatorId, bool>,
    /// (volumes x tools).
    pub(crate) tools: Table<VolumeId, Vec<ToolReading>>,
}

/// Which object of the scene it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    Body(BodyId),
    Ghost(GhostId),
    SoftBody(SoftBodyId),
    /// Vehicle and wheel.
    Wheel(VehicleId, usize),
    Camera(CameraId),
    Light(LightId),
    Sensor(SensorId),
    Actuator(ActuatorId),
    Volume(VolumeId),
}

/// An object of the scene.
pub(crate) struct Object {
    pub(crate) source: Source,
    pub(crate) name: Arc<str>,
    /// Index of its model plus 1.
    pub(crate) model: u32,
    /// Body frame in the world.
    pub(crate) pose: Isometry3<f64>,
    /// Length of its frame's arrows, m.
    pub(crate) frame_length: f64,
}

/// A material as it is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Look {
    pub(crate) diffuse: [f32; 4],
    pub(crate) ambient: [f32; 3],
    pub(crate) specular: [f32; 3],
    pub(crate) emission: [f32; 3],
    pub(crate) shininess: f32,
    /// Metalness and roughness, 0 to 1, of a physically based material: `diffuse` is its base colour, and `ambient`,
    /// `specular` and `shininess` have no effect.
    pub(crate) physical: Option<[f32; 2]>,
}

impl Look {
    /// One colour: ambient half of it, a white highlight, as `color rgba` gives.
    pub(crate) fn of_color([r, g, b, a]: [f32; 4]) -> Self {
        Self {
            diffuse: [r, g, b, a],
            ambient: [0.5 * r, 0.5 * g, 0.5 * b],
            specular: [1.0; 3],
            emission: [0.0; 3],
            shininess: 64.0,
            physical: None,
        }
    }

    pub(crate) fn of_material(material: &adf::Material) -> Self {
        let narrow = |color: [f64; 3]| color.map(|value| value as f32);
        let [r, g, b] = narrow(material.diffuse);
        Self {
            diffuse: [r, g, b, material.alpha as f32],
            ambient: narrow(material.ambient),
            specular: narrow(material.specular),
            emission: narrow(material.emission),
            shininess: (material.shininess as f32).clamp(0.0, 128.0),
            physical: material.physical.map(|physical| [physical.metallic as f32, physical.roughness as f32]),
        }
    }

    /// What shaders get as the specular colour: metalness and roughness of a physically based material.
    pub(crate) fn specular_or_physical(&self) -> [f32; 3] {
        self.physical.map_or(self.specular, |[metallic, roughness]| [metallic, roughness, 0.0])
    }

    pub(crate) fn is_transparent(&self) -> bool {
        self.diffuse[3] < 1.0
    }
}

/// A part of a mesh on an object.
pub(crate) struct Item {
    /// Index of the object.
    pub(crate) object: usize,
    pub(crate) part: Arc<Part>,
    /// From the part to the frame of the object.
    pub(crate) local: Matrix4<f64>,
    pub(crate) look: Look,
    /// Index of the user's program in the renderer.
    pub(crate) program: Option<usize>,
    /// The part is the box of these voxels.
    pub(crate) isosurface: Option<Isosurface>,
    /// Where it is, once poses are known: (3 x 4) row by row.
    pub(crate) rows: [f32; 12],
    /// Bounding sphere in the world.
    pub(crate) center: Point3<f64>,
    /// Its radius, m.
    pub(crate) radius: f64,
}

/// A soft body's mesh.
pub(crate) struct SoftItem {
    /// Which one.
    pub(crate) body: SoftBodyId,
    /// Index of the item that shows it.
    pub(crate) item: usize,
    pub(crate) part: SoftPart,
    /// The nodes, m, whose shape the part has.
    pub(crate) shown: Vec<[f64; 3]>,
}

impl Stage {
    /// Qualified identifier of the object whose id is `id` in a picture; `None` for 0 and what is no object.
    pub fn id_name(&self, id: u32) -> Option<&str> {
        let index = usize::try_from(id.checked_sub(1)?).ok()?;
        Some(&self.built.as_ref()?.objects.get(index)?.name)
    }

    /// Centre and radius of a sphere around all bodies that are drawn, m, half spaces excepted; `None` if nothing is
    /// drawn.
    pub fn bounds(&self) -> Option<(Point3<f64>, f64)> {
        let items = &self.built.as_ref()?.items;
        let finite = || items.iter().filter(|item| item.radius < MAX_BODY && item.center.iter().all(|x| x.is_finite()));
        let (mut low, mut high) = (Point3::from([f64::INFINITY; 3]), Point3::from([f64::NEG_INFINITY; 3]));
        for item in finite() {
            for axis in 0..3 {
                low[axis] = low[axis].min(item.center[axis] - item.radius);
                high[axis] = high[axis].max(item.center[axis] + item.radius);
            }
        }
        let center = nalgebra::center(&low, &high);
        finite().next()?;
        let radius = finite().map(|item| (item.center - center).norm() + item.radius).fold(0.0, f64::max);
        Some((center, radius))
    }
}

/// What is larger is taken for a ground, m: planes are drawn as squares of 100 m.
const MAX_BODY: f64 = 50.0;

impl Built {
    /// Whether an object was taken out of the scene.
    pub(crate) fn is_removed(&self, source: Source) -> bool {
        let visuals = &self.visuals;
        match source {
            Source::Body(id) => visuals.bodies[id].object.removed,
            Source::Ghost(id) => visuals.ghosts[id].object.removed,
            Source::SoftBody(id) => visuals.soft_bodies[id].object.removed,
            Source::Wheel(vehicle, _) => visuals.vehicles[vehicle].object.removed,
            Source::Camera(id) => visuals.cameras[id].object.removed,
            Source::Light(id) => visuals.lights[id].object.removed,
            Source::Sensor(id) => visuals.sensors[id].object.removed,
            Source::Actuator(id) => visuals.actuators[id].object.removed,
            Source::Volume(id) => visuals.volumes[id].object.removed,
        }
    }

    /// Takes the poses of a snapshot, except the shapes of soft bodies. An object that the snapshot does not know keeps
    /// its pose.
    pub(crate) fn take_poses(&mut self, snapshot: &Snapshot) {
        let visuals = Arc::clone(&self.visuals);
        let body_frame = |id: BodyId| {
            let body = snapshot.bodies.get(id)?;
            Some(body.inertial_pose() * visuals.bodies[id].offset)
        };
        for object in &mut self.objects {
            let pose = match object.source {
                Source::Body(id) => body_frame(id),
                Source::Ghost(id) => snapshot.ghosts.get(id).map(|ghost| ghost.pose * visuals.ghosts[id].offset),
                Source::SoftBody(_) => Some(Isometry3::identity()),
                Source::Wheel(vehicle, wheel) => {
                    let reading = snapshot.vehicles.get(vehicle);
                    reading.and_then(|reading| Some(reading.pose * reading.wheels.get(wheel)?))
                }
                Source::Camera(id) => snapshot.views.get(id).map(|view| view.pose),
                Source::Light(id) => snapshot.spots.get(id).map(|spot| spot.pose),
                Source::Volume(id) => snapshot.volumes.get(id).copied(),
                Source::Sensor(id) => {
                    let sensor = &visuals.sensors[id];
                    body_frame(sensor.parent).map(|parent| parent * sensor.pose)
                }
                Source::Actuator(id) => {
                    let actuator = &visuals.actuators[id];
                    body_frame(actuator.parent).map(|parent| parent * actuator.pose)
                }
            };
            if let Some(pose) = pose.filter(is_finite) {
                object.pose = pose;
            }
        }
        for item in self.items.iter_mut().chain(self.collision_items.iter_mut().flatten()) {
            item.place(&self.objects[item.object].pose);
        }
        self.snapshot.spots.clone_from(&snapshot.spots);
        self.snapshot.sensors.clone_from(&snapshot.sensors);
        self.snapshot.actuators.clone_from(&snapshot.actuators);
        self.snapshot.tools.clone_from(&snapshot.tools);
    }
}

fn is_finite(pose: &Isometry3<f64>) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|number| number.is_finite())
}

impl Item {
    /// Puts it where its object is.
    pub(crate) fn place(&mut self, pose: &Isometry3<f64>) {
        let matrix = pose.to_homogeneous() * self.local;
        self.rows = rows(&matrix);
        self.center = matrix.transform_point(&self.part.center);
        let scale = (0..3).map(|column| matrix.fixed_view::<3, 1>(0, column).norm()).fold(0.0, f64::max);
        self.radius = self.part.radius * scale;
    }
}

/// Upper three rows.
pub(crate) fn rows(matrix: &Matrix4<f64>) -> [f32; 12] {
    std::array::from_fn(|i| matrix[(i / 4, i % 4)] as f32)
}

/// Arrow length of the frame of an object whose mesh lies between two corners of its own coordinates.
pub(crate) fn frame_length(bounds: Option<(Vector3<f64>, Vector3<f64>)>) -> f64 {
    let Some((_, high)) = bounds else { return FRAME_WITHOUT_SIZE };
    match high.max() {
        // Arrows as long as a ground is wide would hide everything.
        largest if high.norm() > 0.001 && largest > 0.0 && largest < 0.5 * MAX_BODY => 1.2 * largest,
        _ => 0.5,
    }
}
