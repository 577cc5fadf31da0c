//! From the description of a scene to what is drawn of it.

use std::sync::Arc;

use ambf_core::adf;
use ambf_core::comm::Snapshot;
use ambf_core::ids::SoftBodyId;
use ambf_core::scene::{VisualBody, VisualObject, VisualScene};
use nalgebra::{Isometry3, Matrix4, Point3, Vector3};

use super::Resources;
use crate::gl::Current;
use crate::lights::MAX_LIGHTS;
use crate::meshes::MeshRequest;
use crate::sky;
use crate::stage::{frame_length, rows, Built, Item, Look, Object, SoftItem, Source};
use crate::volumes::Isosurface;

/// Outlines of collision shapes.
const COLLISION: [f32; 4] = [0.0, 0.6, 0.1, 1.0];

/// A part of an object that is wanted.
struct Wanted {
    object: usize,
    request: MeshRequest,
    local: Matrix4<f64>,
    look: Option<Look>,
    program: Option<usize>,
    isosurface: Option<Isosurface>,
}

pub(super) fn scaling(scale: &Vector3<f64>) -> Matrix4<f64> {
    Matrix4::new_nonuniform_scaling(scale)
}

/// A shape at a pose, as a mesh and a matrix.
fn placed(primitive: &adf::Primitive, offset: &Isometry3<f64>) -> (MeshRequest, Matrix4<f64>) {
    let (request, scale) = MeshRequest::shape(primitive);
    (request, offset.to_homogeneous() * scaling(&scale))
}

fn part_request(part: &adf::Part, remove_duplicates: bool) -> (MeshRequest, Matrix4<f64>) {
    match &part.geometry {
        adf::PartGeometry::Primitive(primitive) => placed(primitive, &part.offset),
        adf::PartGeometry::Triangles(mesh) => {
            (MeshRequest::triangles(mesh, remove_duplicates), part.offset.to_homogeneous())
        }
        adf::PartGeometry::Mesh { path, scale } => {
            (MeshRequest::file(path, remove_duplicates), part.offset.to_homogeneous() * scaling(scale))
        }
    }
}

/// What shows a body in its body frame.
fn visual_parts(body: &VisualBody) -> Vec<(MeshRequest, Matrix4<f64>, Option<Look>)> {
    let Some(visual) = body.visual().filter(|visual| visual.visible) else { return Vec::new() };
    let identity = Isometry3::identity();
    let chosen = body.color.map(Look::of_color);
    let own = chosen.or_else(|| visual.material.as_ref().map(Look::of_material));
    match &visual.geometry {
        adf::VisualGeometry::None => Vec::new(),
        adf::VisualGeometry::Primitive(primitive) => {
            let (request, local) = placed(primitive, &identity);
            vec![(request, local, own)]
        }
        adf::VisualGeometry::Compound(parts) => parts
            .iter()
            .map(|part| {
                let (request, local) = placed(&part.primitive, &part.offset);
                (request, local, own)
            })
            .collect(),
        adf::VisualGeometry::Mesh { path } => {
            let local = scaling(&Vector3::repeat(body.scale));
            vec![(MeshRequest::file(path, visual.remove_duplicates), local, own)]
        }
        adf::VisualGeometry::Parts(parts) => parts
            .iter()
            .map(|visual_part| {
                let (request, local) = part_request(&visual_part.part, visual.remove_duplicates);
                let look = chosen.or_else(|| visual_part.material.as_ref().map(Look::of_material)).or(own);
                (request, local, look)
            })
            .collect(),
    }
}

/// What collides of a body, in its body frame.
fn collision_parts(body: &VisualBody) -> Vec<(MeshRequest, Matrix4<f64>)> {
    // Shapes without a pose are in the inertial frame.
    let inertial = body.offset.inverse();
    match body.collision() {
        None | Some(adf::CollisionGeometry::None) => Vec::new(),
        Some(adf::CollisionGeometry::Primitive { primitive, offset }) => {
            vec![placed(primitive, &offset.unwrap_or(inertial))]
        }
        Some(adf::CollisionGeometry::Compound(parts)) => {
            parts.iter().map(|part| placed(&part.primitive, &part.offset)).collect()
        }
        Some(adf::CollisionGeometry::Mesh { path, .. }) => {
            vec![(MeshRequest::file(path, false), scaling(&Vector3::repeat(body.scale)))]
        }
        Some(adf::CollisionGeometry::Parts { parts, .. }) => {
            parts.iter().map(|part| part_request(part, false)).collect()
        }
    }
}

impl Resources {
    /// Loads what shows a scene.
    pub(super) fn build(
        &mut self,
        gl: &Current<'_>,
        renderer: u64,
        visuals: &Arc<VisualScene>,
        snapshot: &Snapshot,
        messages: &mut Vec<String>,
    ) -> Built {
        let mut objects = Vec::new();
        let mut wanted = Vec::new();
        let mut add = |source: Source, object: &VisualObject| {
            let model = u32::try_from(object.model.index() + 1).unwrap_or(u32::MAX);
            let (name, pose) = (Arc::clone(&object.identifier), Isometry3::identity());
            objects.push(Object { source, name, model, pose, frame_length: frame_length(None) });
            objects.len() - 1
        };
        let ghosts = visuals.ghosts.entries().map(|(id, ghost)| (Source::Ghost(id), ghost));
        let bodies = visuals.bodies.entries().map(|(id, body)| (Source::Body(id), body));
        for (source, body) in bodies.chain(ghosts) {
            let object = add(source, &body.object);
            if body.object.removed {
                continue;
            }
            let parts = visual_parts(body);
            let shaders = body.shaders(&visuals.world).filter(|_| !parts.is_empty());
            let program = shaders.and_then(|files| self.programs.user(gl, files, messages));
            wanted.extend(parts.into_iter().map(|(request, local, look)| Wanted {
                object,
                request,
                local,
                look,
                program,
                isosurface: None,
            }));
        }
        let soft_objects: Vec<_> =
            visuals.soft_bodies.entries().map(|(id, soft)| (id, add(Source::SoftBody(id), &soft.object))).collect();
        for (vehicle, description) in visuals.vehicles.entries() {
            for (wheel, files) in description.wheels.iter().enumerate() {
                let object = add(Source::Wheel(vehicle, wheel), &description.object);
                if let Some(file) = files.iter().find(|file| file.is_file()).or(files.first()) {
                    if !description.object.removed {
                        let request = MeshRequest::file(file, false);
                        wanted.push(Wanted {
                            object,
                            request,
                            local: Matrix4::identity(),
                            look: None,
                            program: None,
                            isosurface: None,
                        });
                    }
                }
            }
        }
        for (id, camera) in visuals.cameras.entries() {
            add(Source::Camera(id), &camera.object);
        }
        for (id, light) in visuals.lights.entries() {
            add(Source::Light(id), &light.object);
        }
        for (id, sensor) in visuals.sensors.entries() {
            add(Source::Sensor(id), &sensor.object);
        }
        for (id, actuator) in visuals.actuators.entries() {
            add(Source::Actuator(id), &actuator.object);
        }
        for (id, volume) in visuals.volumes.entries() {
            let object = add(Source::Volume(id), &volume.object);
            // What of it cannot be read is in the load report.
            let Some(grid) = volume.voxels.as_ref().filter(|_| !volume.object.removed) else { continue };
            let grid = snapshot.voxels.get(id).and_then(Option::as_ref).unwrap_or(grid);
            let voxels = match self.volumes.load(gl, grid) {
                Ok(voxels) => voxels,
                Err(error) => {
                    messages.push(format!("{}: {error}; the volume is not drawn", volume.object.identifier));
                    continue;
                }
            };
            if volume.description.shaders.is_some() {
                messages.push(format!("{}: shaders of a volume have no effect", volume.object.identifier));
            }
            let size = grid.edges();
            let (request, local) = placed(&adf::Primitive::Box { size }, &Isometry3::identity());
            let look = volume.description.material.as_ref().map(Look::of_material);
            let isosurface = Some(Isosurface::new(&voxels, &volume.description, size.norm()));
            wanted.push(Wanted { object, request, local, look, program: None, isosurface });
        }
        let dark = visuals.lights.iter().filter(|light| !light.object.removed).skip(MAX_LIGHTS).count();
        if dark > 0 {
            messages.push(format!("{dark} lights shine on nothing: {MAX_LIGHTS} lights are drawn at most"));
        }
        let without = "shaders have no effect: the built-in ones do what they are for";
        for camera in visuals.cameras.iter().filter(|camera| camera.description.depth_compute_shaders.is_some()) {
            messages.push(format!("{}: its depth compute {without}", camera.object.identifier));
        }
        let requests: Vec<MeshRequest> = wanted.iter().map(|wanted| wanted.request.clone()).collect();
        messages.extend(self.library.load(gl, &requests));
        let mut items = self.items(wanted, &mut objects);
        let mut soft_items = Vec::new();
        for (body, object) in soft_objects {
            self.soft_body(gl, visuals, snapshot, (body, object), &mut items, &mut soft_items, messages);
        }
        self.load_sky(gl, visuals.world.skybox.as_ref(), messages);
        Built {
            renderer,
            visuals: Arc::clone(visuals),
            objects,
            items,
            soft_items,
            collision_items: None,
            soft_version: 0,
            snapshot: Default::default(),
            said: Default::default(),
        }
    }

    fn items(&self, wanted: Vec<Wanted>, objects: &mut [Object]) -> Vec<Item> {
        let mut items = Vec::new();
        let mut bounds: Vec<Option<(Vector3<f64>, Vector3<f64>)>> = vec![None; objects.len()];
        for Wanted { object, request, local, look, program, isosurface } in wanted {
            let Some(mesh) = self.library.get(&request.key) else { continue };
            if let Some((low, high)) = mesh.bounds {
                for corner in 0..8 {
                    let corner =
                        Vector3::from_fn(|axis, _| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] });
                    let corner = local.transform_point(&Point3::from(corner)).coords;
                    let (low, high) = bounds[object].unwrap_or((corner, corner));
                    bounds[object] = Some((low.inf(&corner), high.sup(&corner)));
                }
            }
            items.extend(mesh.parts.iter().map(|part| Item {
                object,
                part: Arc::clone(part),
                local,
                look: look.unwrap_or(part.look),
                program,
                isosurface: isosurface.clone(),
                rows: rows(&local),
                center: part.center,
                radius: part.radius,
            }));
        }
        for (object, bounds) in objects.iter_mut().zip(bounds).filter(|(_, bounds)| bounds.is_some()) {
            object.frame_length = frame_length(bounds);
        }
        items
    }

    #[allow(clippy::too_many_arguments)] // what is read and what is filled
    fn soft_body(
        &mut self,
        gl: &Current<'_>,
        visuals: &VisualScene,
        snapshot: &Snapshot,
        (body, object): (SoftBodyId, usize),
        items: &mut Vec<Item>,
        soft_items: &mut Vec<SoftItem>,
        messages: &mut Vec<String>,
    ) {
        let soft = &visuals.soft_bodies[body];
        let nodes = snapshot.soft_bodies.get(body).map_or(0, |reading| reading.nodes.len());
        let Some(description) = soft.description().filter(|_| !soft.object.removed && nodes > 0) else { return };
        if !description.visual.visible {
            return;
        }
        let collision = &description.collision_mesh;
        let (path, weld) = match &description.visual.geometry {
            adf::VisualGeometry::Mesh { path } => (path, description.visual.remove_duplicates),
            _ => (collision, false),
        };
        let mut loaded = self.library.load_soft(gl, path, weld, nodes, messages);
        if path != collision && loaded.is_err() {
            messages.extend(loaded.err().map(|error| format!("{error}; its collision mesh is drawn")));
            loaded = self.library.load_soft(gl, collision, false, nodes, messages);
        }
        let parts = match loaded {
            Ok(parts) => parts,
            Err(error) => return messages.push(error),
        };
        let program = soft.shaders(&visuals.world).and_then(|files| self.programs.user(gl, files, messages));
        let look = description.visual.material.as_ref().map(Look::of_material);
        for (part, soft) in parts {
            soft_items.push(SoftItem { body, item: items.len(), part: soft, shown: Vec::new() });
            let local = Matrix4::identity();
            items.push(Item {
                object,
                look: look.unwrap_or(part.look),
                local,
                program,
                isosurface: None,
                rows: rows(&local),
                center: part.center,
                radius: part.radius,
                part,
            });
        }
    }

    fn load_sky(&mut self, gl: &Current<'_>, skybox: Option<&adf::Skybox>, messages: &mut Vec<String>) {
        if self.sky.as_ref().map(|(loaded, _)| loaded) == skybox {
            return;
        }
        self.sky = skybox.map(|skybox| {
            let files = skybox.shaders.as_ref();
            let program = files.and_then(|files| self.programs.user(gl, files, messages));
            let sky = sky::load(gl, skybox, program).map_err(|message| messages.push(message)).ok();
            (skybox.clone(), sky)
        });
    }

    pub(super) fn collision_items(
        &mut self,
        gl: &Current<'_>,
        visuals: &VisualScene,
        objects: &[Object],
        messages: &mut Vec<String>,
    ) -> Vec<Item> {
        let mut wanted = Vec::new();
        for (index, object) in objects.iter().enumerate() {
            let body = match object.source {
                Source::Body(body) => &visuals.bodies[body],
                Source::Ghost(ghost) => &visuals.ghosts[ghost],
                _ => continue,
            };
            if !body.object.removed {
                wanted.extend(collision_parts(body).into_iter().map(|(request, local)| Wanted {
                    object: index,
                    request,
                    local,
                    look: Some(Look::of_color(COLLISION)),
                    program: None,
                    isosurface: None,
                }));
            }
        }
        let requests: Vec<MeshRequest> = wanted.iter().map(|wanted| wanted.request.clone()).collect();
        messages.extend(self.library.load(gl, &requests));
        let mut lengths: Vec<Object> = Vec::new();
        lengths.extend(objects.iter().map(|object| Object {
            source: object.source,
            name: Arc::clone(&object.name),
            model: object.model,
            pose: object.pose,
            frame_length: object.frame_length,
        }));
        self.items(wanted, &mut lengths)
    }
}
