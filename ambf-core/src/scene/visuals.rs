//! What of a scene is drawn: descriptions by index, without states. States are in the
//! [`Snapshot`](crate::comm::Snapshot).

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::{Identity, JointType, LocalRay, Scene};
use ambf_volume::VoxelGrid;

use crate::adf;
use crate::ids::{
    ActuatorId, BodyId, CameraId, GhostId, JointId, LightId, ModelId, SensorId, SoftBodyId, Table, VehicleId, VolumeId,
};

/// What of a scene can be drawn. All lists are indexed as the arrays of [`Snapshot`](crate::comm::Snapshot); what was
/// removed keeps its place.
///
/// It is made anew when the scene changes, and shares the descriptions with the scene.
#[derive(Debug, Clone)]
pub struct VisualScene {
    /// Counts changes of the scene, from 0.
    pub generation: u64,
    /// Sky box and shaders of the world.
    pub world: Arc<adf::World>,
    /// (bodies x 1).
    pub bodies: Table<BodyId, VisualBody>,
    /// (ghost objects x 1).
    pub ghosts: Table<GhostId, VisualBody>,
    /// (soft bodies x 1).
    pub soft_bodies: Table<SoftBodyId, VisualSoftBody>,
    /// (vehicles x 1).
    pub vehicles: Table<VehicleId, VisualVehicle>,
    /// (sensors x 1).
    pub sensors: Table<SensorId, VisualSensor>,
    /// (actuators x 1).
    pub actuators: Table<ActuatorId, VisualActuator>,
    /// (cameras x 1).
    pub cameras: Table<CameraId, VisualCamera>,
    /// (lights x 1).
    pub lights: Table<LightId, VisualLight>,
    /// (volumes x 1).
    pub volumes: Table<VolumeId, VisualVolume>,
    /// (joints x 1).
    pub joints: Table<JointId, VisualJoint>,
    /// (models x 1) key of each model, what it is removed by, and its file; the environment is the first.
    pub models: Table<ModelId, VisualModel>,
}

/// A model.
#[derive(Debug, Clone)]
pub struct VisualModel {
    /// What it is removed by.
    pub key: Arc<str>,
    /// What it was made from.
    pub description: Arc<adf::Model>,
    /// Taken out of the scene.
    pub removed: bool,
}

/// A joint.
#[derive(Debug, Clone)]
pub struct VisualJoint {
    /// Name without suffix.
    pub name: Arc<str>,
    /// The parent body.
    pub parent: BodyId,
    /// The child body.
    pub child: BodyId,
    /// The joint's model.
    pub model: ModelId,
    /// Range of the coordinate, rad or m; `None`: unlimited.
    pub limits: Option<(f64, f64)>,
    /// Whether its coordinate is an angle, a length, or nothing.
    pub kind: JointType,
    /// Axis in the parent's inertial frame, of length 1.
    pub axis: Vector3<f64>,
    /// Joint frames in the inertial frames of parent and child; they are one where the coordinate is 0.
    pub frames: [Isometry3<f64>; 2],
    /// Taken out of the scene.
    pub removed: bool,
}

/// What all objects that can be drawn have.
#[derive(Debug, Clone)]
pub struct VisualObject {
    /// Prefix, namespace, mapping key and suffix.
    pub identifier: Arc<str>,
    /// Prefix and namespace.
    pub namespace: Arc<str>,
    /// Name with the suffix that tells copies apart: the last part of the object's topics.
    pub name: Arc<str>,
    /// The object's model.
    pub model: ModelId,
    /// Taken out of the scene.
    pub removed: bool,
}

/// Where the description of a body, ghost object or soft body is found.
#[derive(Debug, Clone)]
struct Described {
    model: Arc<adf::Model>,
    /// Index in the list of its type; `None`: made without a description.
    index: Option<usize>,
}

/// A rigid body or a ghost object.
#[derive(Debug, Clone)]
pub struct VisualBody {
    /// Names.
    pub object: VisualObject,
    /// Pose of the body frame, which carries the visual mesh, in the frame whose pose is in the snapshot: the inertial
    /// frame of a rigid body, the ghost's own frame.
    pub offset: Isometry3<f64>,
    /// Factor on meshes; primitives are not scaled.
    pub scale: f64,
    /// Pose in the world at the start, of the same frame as in the snapshot.
    pub initial_pose: Isometry3<f64>,
    /// kg; 0: static, or a ghost object.
    pub mass: f64,
    /// Principal moments about the axes of the inertial frame, kg·m².
    pub inertia: Vector3<f64>,
    /// Whether it is a ghost object.
    pub is_ghost: bool,
    /// Colour instead of that of the description: red, green, blue, opacity, 0 to 1.
    pub color: Option<[f32; 4]>,
    described: Described,
}

/// A soft body.
#[derive(Debug, Clone)]
pub struct VisualSoftBody {
    /// Names.
    pub object: VisualObject,
    described: Described,
}

/// A vehicle: its wheels; the chassis is a rigid body.
#[derive(Debug, Clone)]
pub struct VisualVehicle {
    /// Names.
    pub object: VisualObject,
    /// (wheels x 1) where the mesh file may lie, best first; empty for a wheel that a rigid body shows.
    pub wheels: Vec<Vec<PathBuf>>,
}

/// A sensor.
#[derive(Debug, Clone)]
pub struct VisualSensor {
    /// Names.
    pub object: VisualObject,
    /// The parent body.
    pub parent: BodyId,
    /// Pose of the sensor in the parent's body frame.
    pub pose: Isometry3<f64>,
    /// Rays in the sensor frame; none for a contact sensor.
    pub rays: Vec<LocalRay>,
    /// Length of a ray of direction length 1, m.
    pub range: f64,
    /// Shown at the start.
    pub visible: bool,
    /// Radius of its markers, m.
    pub visible_size: f64,
}

/// An actuator.
#[derive(Debug, Clone)]
pub struct VisualActuator {
    /// Names.
    pub object: VisualObject,
    /// The parent body.
    pub parent: BodyId,
    /// Pose of the actuator in the parent's body frame.
    pub pose: Isometry3<f64>,
    /// Shown at the start.
    pub visible: bool,
    /// Radius of its marker, m.
    pub visible_size: f64,
}

/// A camera.
#[derive(Debug, Clone)]
pub struct VisualCamera {
    /// Names.
    pub object: VisualObject,
    /// What it was made from.
    pub description: Arc<adf::Camera>,
    /// Pose at the start in the parent's frame.
    pub initial_pose: Isometry3<f64>,
    /// The point that it looked at in the beginning, in its parent's frame, m.
    pub look_at: Vector3<f64>,
}

/// A light.
#[derive(Debug, Clone)]
pub struct VisualLight {
    /// Names.
    pub object: VisualObject,
    /// What it was made from.
    pub description: Arc<adf::Light>,
}

/// A volume.
#[derive(Debug, Clone)]
pub struct VisualVolume {
    /// Names.
    pub object: VisualObject,
    /// What it was made from.
    pub description: Arc<adf::Volume>,
    /// The voxels when it was made; `None`: it is empty, or they cannot be read. Those of now are in
    /// [`Snapshot::voxels`](crate::comm::Snapshot::voxels).
    pub voxels: Option<Arc<VoxelGrid>>,
    /// (tools x burrs) bodies that show burrs: of each tool, that of
    /// [`ToolReading::burr`](crate::comm::ToolReading::burr) is drawn.
    pub burrs: Vec<Vec<BodyId>>,
}

impl VisualBody {
    /// Appearance as described; `None` for a body that was made without a description.
    pub fn visual(&self) -> Option<&adf::Visual> {
        let Described { model, index } = &self.described;
        Some(match self.is_ghost {
            true => &model.ghosts[(*index)?].visual,
            false => &model.bodies[(*index)?].visual,
        })
    }

    /// What collides, as described; `None` for a body that was made without a description.
    pub fn collision(&self) -> Option<&adf::CollisionGeometry> {
        let Described { model, index } = &self.described;
        Some(match self.is_ghost {
            true => &model.ghosts[(*index)?].collision,
            false => &model.bodies[(*index)?].collision,
        })
    }

    /// Own shaders, else the model's, else those of `world`. Ghost objects have their own only, as in the C++ program.
    pub fn shaders<'a>(&'a self, world: &'a adf::World) -> Option<&'a adf::ShaderProgram> {
        let own = self.visual().and_then(|visual| visual.shaders.as_ref());
        match self.is_ghost {
            true => own,
            false => own.or(self.described.model.shaders.as_ref()).or(world.shaders.as_ref()),
        }
    }
}

impl VisualSoftBody {
    /// What it was made from; `None` if nothing is known of it.
    pub fn description(&self) -> Option<&adf::SoftBody> {
        self.described.model.soft_bodies.get(self.described.index?)
    }

    /// Own shaders, else the model's, else those of `world`.
    pub fn shaders<'a>(&'a self, world: &'a adf::World) -> Option<&'a adf::ShaderProgram> {
        let own = self.description().and_then(|soft| soft.visual.shaders.as_ref());
        own.or(self.described.model.shaders.as_ref()).or(world.shaders.as_ref())
    }
}

/// Places of descriptions in their lists, by model and mapping key. A key that is listed twice has one description.
struct Places<'a>(HashMap<(ModelId, &'a str), usize>);

impl<'a> Places<'a> {
    fn new(scene: &'a Scene, list: impl Fn(&'a adf::Model) -> Vec<&'a adf::Common>) -> Self {
        let mut places = HashMap::new();
        for (model, info) in scene.models.entries() {
            for (index, common) in list(&info.description).into_iter().enumerate() {
                places.insert((model, common.identifier.as_str()), index);
            }
        }
        Self(places)
    }

    fn index(&self, identity: &Identity) -> Option<usize> {
        self.0.get(&(identity.model, identity.identifier.as_str())).copied()
    }

    fn described(&self, scene: &Scene, identity: &Identity) -> Described {
        let model = Arc::clone(&scene.models[identity.model].description);
        Described { model, index: self.index(identity) }
    }
}

impl Scene {
    /// What can be drawn of it. `generation` counts its changes.
    pub fn visuals(&self, generation: u64) -> VisualScene {
        let object = |identity: &Identity| VisualObject {
            identifier: Arc::clone(&identity.qualified),
            namespace: identity.namespace.as_str().into(),
            name: identity.communication_name().into(),
            model: identity.model,
            removed: self.models[identity.model].removed,
        };
        let of_bodies = Places::new(self, |model| model.bodies.iter().map(|body| &body.common).collect());
        let of_ghosts = Places::new(self, |model| model.ghosts.iter().map(|ghost| &ghost.common).collect());
        let of_soft = Places::new(self, |model| model.soft_bodies.iter().map(|soft| &soft.common).collect());
        let of_vehicles = Places::new(self, |model| model.vehicles.iter().map(|vehicle| &vehicle.common).collect());
        let of_sensors = Places::new(self, |model| model.sensors.iter().map(|sensor| &sensor.common).collect());
        let of_actuators = Places::new(self, |model| model.actuators.iter().map(|actuator| &actuator.common).collect());
        let is_gone = |body: BodyId| self.body_is_gone(body);
        let body = |(id, body): (BodyId, &super::Body)| VisualBody {
            object: VisualObject { removed: is_gone(id), ..object(&body.identity) },
            offset: body.inertial_offset_inverse,
            scale: body.scale,
            initial_pose: body.initial_pose,
            mass: body.mass,
            inertia: body.inertia,
            is_ghost: false,
            color: body.color,
            described: of_bodies.described(self, &body.identity),
        };
        let ghost = |ghost: &super::Ghost| {
            let described = of_ghosts.described(self, &ghost.attached.identity);
            let scale = described.index.map_or(1.0, |index| described.model.ghosts[index].scale);
            VisualBody {
                object: object(&ghost.attached.identity),
                offset: Isometry3::identity(),
                scale,
                initial_pose: ghost.attached.initial_pose,
                mass: 0.0,
                inertia: Vector3::zeros(),
                is_ghost: true,
                color: None,
                described,
            }
        };
        let soft = |soft: &super::SoftBody| VisualSoftBody {
            object: object(&soft.identity),
            described: of_soft.described(self, &soft.identity),
        };
        let vehicle = |vehicle: &super::Vehicle| {
            let described = of_vehicles.described(self, &vehicle.identity);
            let files = |wheel: &adf::Wheel| match &wheel.visual {
                adf::WheelVisual::Mesh(files) => files.clone(),
                adf::WheelVisual::Body(_) => Vec::new(),
            };
            let wheels = described.index.map(|index| described.model.vehicles[index].wheels.iter().map(files));
            let object = VisualObject { removed: is_gone(vehicle.chassis), ..object(&vehicle.identity) };
            VisualVehicle { object, wheels: wheels.into_iter().flatten().collect() }
        };
        let sensor = |sensor: &super::Sensor| {
            let described = of_sensors.described(self, &sensor.identity);
            let (visible, visible_size) = described.index.map_or((false, 0.0), |index| {
                let sensor = &described.model.sensors[index];
                (sensor.visible, sensor.visible_size)
            });
            let mut object = object(&sensor.identity);
            object.removed |= is_gone(sensor.parent);
            VisualSensor {
                object,
                parent: sensor.parent,
                pose: sensor.info.pose,
                rays: sensor.rays.clone(),
                range: sensor.info.range,
                visible,
                visible_size,
            }
        };
        let actuator = |actuator: &super::Actuator| {
            let described = of_actuators.described(self, &actuator.identity);
            let (visible, visible_size) = described.index.map_or((false, 0.0), |index| {
                let actuator = &described.model.actuators[index];
                (actuator.visible, actuator.visible_size)
            });
            let mut object = object(&actuator.identity);
            object.removed |= is_gone(actuator.parent);
            VisualActuator { object, parent: actuator.parent, pose: actuator.info.pose, visible, visible_size }
        };
        let camera = |camera: &super::Camera| VisualCamera {
            object: object(&camera.attached.identity),
            description: Arc::new(camera.description.clone()),
            initial_pose: camera.attached.initial_pose,
            look_at: camera.look_at,
        };
        let light = |light: &super::Light| VisualLight {
            object: object(&light.attached.identity),
            description: Arc::new(light.description.clone()),
        };
        let volume = |volume: &super::Volume| VisualVolume {
            object: object(&volume.attached.identity),
            description: Arc::clone(&volume.description),
            voxels: volume.first_voxels().cloned(),
            burrs: volume.tools.iter().map(|tool| tool.burr_bodies.iter().flatten().copied().collect()).collect(),
        };
        let joint = |joint: &super::Joint| VisualJoint {
            name: joint.name.as_str().into(),
            parent: joint.parent,
            child: joint.child,
            model: joint.model,
            limits: joint.limits.map(|limits| (limits.low, limits.high)),
            kind: joint.joint_type,
            axis: joint.axis,
            frames: joint.frames,
            removed: joint.removed || self.models[joint.model].removed,
        };
        let model = |model: &super::ModelInfo| VisualModel {
            key: model.key.as_str().into(),
            description: Arc::clone(&model.description),
            removed: model.removed,
        };
        VisualScene {
            generation,
            world: Arc::clone(&self.description),
            bodies: self.bodies.entries().map(body).collect(),
            ghosts: self.ghosts.iter().map(ghost).collect(),
            soft_bodies: self.soft_bodies.iter().map(soft).collect(),
            vehicles: self.vehicles.iter().map(vehicle).collect(),
            sensors: self.sensors.iter().map(sensor).collect(),
            actuators: self.actuators.iter().map(actuator).collect(),
            cameras: self.cameras.iter().map(camera).collect(),
            lights: self.lights.iter().map(light).collect(),
            volumes: self.volumes.iter().map(volume).collect(),
            joints: self.joints.iter().map(joint).collect(),
            models: self.models.iter().map(model).collect(),
        }
    }
}
