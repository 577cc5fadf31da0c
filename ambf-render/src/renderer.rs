//! Draws a stage.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use ambf_core::adf;
use ambf_core::comm::Snapshot;
use ambf_core::scene::{VisualBody, VisualObject, VisualScene};
use nalgebra::{Isometry3, Matrix4, Point3, Vector3};
use thiserror::Error;

use crate::draw::{Drawable, Mask, Pass, Programs, Style};
use crate::gl::{self, Current, Device, InstanceBuffer, Target, TargetKind};
use crate::lights::{ShadowMap, MOST_LIGHTS};
use crate::meshes::{lathe, Library, MeshRequest, Part};
use crate::stage::{frame_length, rows, Built, Item, Look, Marker, MarkerShape, Object, SoftItem, Source};
use crate::view::Eye;
use crate::{sky, Picture, PictureRequest, Stage, View};

/// Why nothing can be drawn.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RenderError {
    /// Error when no OpenGL context can be made without a window.
    #[error("no pictures: {0}; install libegl1 and libgl1-mesa-dri, which draw without a graphics card")]
    NoContext(String),
    /// Error when OpenGL is there but cannot do what is needed.
    #[error("OpenGL: {0}")]
    Gl(String),
    /// Error when a process draws that was forked from one that has drawn: the threads of OpenGL are not in it.
    #[error(
        "this process was forked from one that has made pictures, and OpenGL does not outlive a fork; start processes by `spawn` or \
         `forkserver`, or fork before the first picture"
    )]
    Forked,
    /// Error when a size is 0 or too large.
    #[error("a picture of {width} x {height} pixels cannot be made; 1 to {most} pixels each way are possible")]
    Size {
        /// Pixels from left to right.
        width: u32,
        /// Pixels from top to bottom.
        height: u32,
        /// Most pixels each way.
        most: u32,
    },
    /// Error when a stage is drawn that this renderer has not prepared.
    #[error("the stage was not prepared by this renderer; call `prepare` before")]
    NotPrepared,
}

/// Targets that are kept for the next picture of the same size.
const TARGETS_KEPT: usize = 8;
/// Segments of the markers' round shapes.
const MARKER_SEGMENTS: u32 = 24;
/// Colours of the frames' arrows.
const AXES: [[f32; 4]; 3] = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]];
/// Start, end and hit of a sensor's ray.
const RAY_START: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const RAY_END: [f32; 4] = [0.0, 128.0 / 255.0, 0.0, 1.0];
const RAY_HIT: [f32; 4] = [1.0, 105.0 / 255.0, 180.0 / 255.0, 1.0];
/// An actuator, and one that holds something.
const ACTUATOR: [f32; 4] = [1.0, 215.0 / 255.0, 0.0, 1.0];
const ACTUATOR_HOLDS: [f32; 4] = [0.0, 1.0, 0.0, 1.0];
/// Outlines of collision shapes.
const COLLISION: [f32; 4] = [0.0, 0.6, 0.1, 1.0];

/// Draws stages with OpenGL. It may be handed from thread to thread, but is used by one at a time.
pub struct Renderer {
    // Declared before the device: what it made is given to the device's bin.
    resources: Resources,
    device: Device,
    id: u64,
}

/// What is on the graphics card.
struct Resources {
    library: Library,
    programs: Programs,
    buffer: InstanceBuffer,
    no_shadow: gl::Texture,
    white: gl::Texture,
    shapes: Shapes,
    targets: Targets,
    /// The last sky, `None` in it if it cannot be loaded.
    sky: Option<(adf::Skybox, Option<gl::Texture>)>,
    /// (lights x 1).
    maps: Vec<Option<ShadowMap>>,
    /// Counts changes of the shapes of soft bodies.
    soft_versions: u64,
    /// What is read back is read into it.
    bytes: Vec<u8>,
}

/// Shapes of markers.
struct Shapes {
    /// Of radius 1.
    sphere: Part,
    /// With edges of 1.
    cube: Part,
    /// Along +x, of length 1, as the frames' arrows are.
    arrow: Part,
    /// Along +x, of length and radius 1.
    cylinder: Part,
    /// Along +x, of length and radius 1.
    cone: Part,
}

/// Targets of the last pictures.
#[derive(Default)]
struct Targets(Vec<(TargetKind, Target)>);

impl Targets {
    fn get(&mut self, gl: &Current<'_>, kind: TargetKind, width: u32, height: u32) -> Result<&Target, RenderError> {
        let fits = |(k, target): &(TargetKind, Target)| *k == kind && (target.width, target.height) == (width, height);
        let entry = match self.0.iter().position(fits) {
            Some(place) => self.0.remove(place),
            None => {
                self.0.truncate(TARGETS_KEPT - 1);
                (kind, gl.target(width, height, kind)?)
            }
        };
        self.0.insert(0, entry);
        Ok(&self.0[0].1)
    }
}

impl Shapes {
    fn new(gl: &Current<'_>) -> Result<Self, RenderError> {
        let part = |(vertices, indices): (Vec<f32>, Vec<u32>)| Part::of_vertices(gl, &vertices, &indices);
        let turned = |rings: &[[f32; 4]]| part(lathe(rings, MARKER_SEGMENTS));
        let half_circle: Vec<[f32; 4]> = (0..=MARKER_SEGMENTS / 2)
            .map(|ring| {
                let (sine, cosine) = (std::f32::consts::TAU * ring as f32 / MARKER_SEGMENTS as f32).sin_cos();
                [-cosine, sine, -cosine, sine]
            })
            .collect();
        let slope = std::f32::consts::FRAC_1_SQRT_2;
        Ok(Self {
            sphere: turned(&half_circle)?,
            cube: part(cube())?,
            arrow: turned(&arrow(0.017, 0.068, 0.2))?,
            cylinder: turned(&[
                [0.0, 0.0, -1.0, 0.0],
                [0.0, 1.0, -1.0, 0.0],
                [0.0, 1.0, 0.0, 1.0],
                [1.0, 1.0, 0.0, 1.0],
                [1.0, 1.0, 1.0, 0.0],
                [1.0, 0.0, 1.0, 0.0],
            ])?,
            cone: turned(&[
                [0.0, 0.0, -1.0, 0.0],
                [0.0, 1.0, -1.0, 0.0],
                [0.0, 1.0, slope, slope],
                [1.0, 0.0, slope, slope],
            ])?,
        })
    }
}

/// Rings of an arrow of length 1.
fn arrow(shaft: f32, head: f32, length: f32) -> [[f32; 4]; 8] {
    let neck = 1.0 - length;
    let slope = length.hypot(head);
    let (along, outward) = (head / slope, length / slope);
    [
        [0.0, 0.0, -1.0, 0.0],
        [0.0, shaft, -1.0, 0.0],
        [0.0, shaft, 0.0, 1.0],
        [neck, shaft, 0.0, 1.0],
        [neck, shaft, -1.0, 0.0],
        [neck, head, -1.0, 0.0],
        [neck, head, along, outward],
        [1.0, 0.0, along, outward],
    ]
}

/// A box with edges of 1.
fn cube() -> (Vec<f32>, Vec<u32>) {
    let (mut vertices, mut indices) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in [-0.5_f32, 0.5] {
            let first = (vertices.len() / gl::VERTEX_FLOATS) as u32;
            for (u, v) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                let (mut position, mut normal) = ([0.0; 3], [0.0; 3]);
                (position[axis], position[(axis + 1) % 3], position[(axis + 2) % 3]) = (side, u, v);
                normal[axis] = 2.0 * side;
                vertices.extend(position.into_iter().chain(normal).chain([0.0, 0.0]));
            }
            let corners = if side > 0.0 { [0, 1, 2, 0, 2, 3] } else { [0, 2, 1, 0, 3, 2] };
            indices.extend(corners.map(|corner| first + corner));
        }
    }
    (vertices, indices)
}

/// A part of an object that is wanted.
struct Wanted {
    object: usize,
    request: MeshRequest,
    local: Matrix4<f64>,
    look: Option<Look>,
    program: Option<usize>,
}

fn scaling(scale: &Vector3<f64>) -> Matrix4<f64> {
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
        adf::PartGeometry::Mesh { path, scale } => {
            (MeshRequest::file(path, remove_duplicates), part.offset.to_homogeneous() * scaling(scale))
        }
    }
}

/// What shows a body in its body frame.
fn visual_parts(body: &VisualBody) -> Vec<(MeshRequest, Matrix4<f64>, Option<Look>)> {
    let Some(visual) = body.visual().filter(|visual| visual.visible) else { return Vec::new() };
    let identity = Isometry3::identity();
    let own = visual.material.as_ref().map(Look::of_material);
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
                (request, local, visual_part.material.as_ref().map(Look::of_material).or(own))
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
    fn new(gl: &Current<'_>) -> Result<Self, RenderError> {
        Ok(Self {
            library: Library::default(),
            programs: Programs::default(),
            buffer: gl.instance_buffer()?,
            no_shadow: gl.no_shadow()?,
            white: gl.texture(1, 1, &[255; 4])?,
            shapes: Shapes::new(gl)?,
            targets: Targets::default(),
            sky: None,
            maps: Vec::new(),
            soft_versions: 0,
            bytes: Vec::new(),
        })
    }

    /// Loads what shows a scene.
    fn build(
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
            let model = u32::try_from(object.model + 1).unwrap_or(u32::MAX);
            let (name, pose) = (Arc::clone(&object.identifier), Isometry3::identity());
            objects.push(Object { source, name, model, pose, frame_length: frame_length(None) });
            objects.len() - 1
        };
        let ghosts = visuals.ghosts.iter().enumerate().map(|(index, ghost)| (Source::Ghost(index), ghost));
        let bodies = visuals.bodies.iter().enumerate().map(|(index, body)| (Source::Body(index), body));
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
            }));
        }
        let soft_objects: Vec<usize> = (visuals.soft_bodies.iter().enumerate())
            .map(|(index, soft)| add(Source::SoftBody(index), &soft.object))
            .collect();
        for (vehicle, description) in visuals.vehicles.iter().enumerate() {
            for (wheel, files) in description.wheels.iter().enumerate() {
                let object = add(Source::Wheel(vehicle, wheel), &description.object);
                if let Some(file) = files.iter().find(|file| file.is_file()).or(files.first()) {
                    if !description.object.removed {
                        let request = MeshRequest::file(file, false);
                        wanted.push(Wanted { object, request, local: Matrix4::identity(), look: None, program: None });
                    }
                }
            }
        }
        for (index, camera) in visuals.cameras.iter().enumerate() {
            add(Source::Camera(index), &camera.object);
        }
        for (index, light) in visuals.lights.iter().enumerate() {
            add(Source::Light(index), &light.object);
        }
        for (index, sensor) in visuals.sensors.iter().enumerate() {
            add(Source::Sensor(index), &sensor.object);
        }
        for (index, actuator) in visuals.actuators.iter().enumerate() {
            add(Source::Actuator(index), &actuator.object);
        }
        let dark = visuals.lights.iter().filter(|light| !light.object.removed).skip(MOST_LIGHTS).count();
        if dark > 0 {
            messages.push(format!("{dark} lights shine on nothing: {MOST_LIGHTS} lights are drawn at most"));
        }
        let without = "shaders have no effect: the built-in ones do what they are for";
        for camera in visuals.cameras.iter().filter(|camera| camera.description.depth_compute_shaders.is_some()) {
            messages.push(format!("{}: its depth compute {without}", camera.object.identifier));
        }
        if visuals.world.skybox.as_ref().is_some_and(|skybox| skybox.shaders.is_some()) {
            messages.push(format!("the sky's {without}"));
        }
        let requests: Vec<MeshRequest> = wanted.iter().map(|wanted| wanted.request.clone()).collect();
        messages.extend(self.library.load(gl, &requests));
        let mut items = self.items(wanted, &mut objects);
        let mut soft_items = Vec::new();
        for (body, object) in soft_objects.into_iter().enumerate() {
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
        for Wanted { object, request, local, look, program } in wanted {
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
        (body, object): (usize, usize),
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
            let sky = sky::load(gl, skybox).map_err(|message| messages.push(message)).ok();
            (skybox.clone(), sky)
        });
    }

    fn collision_items(
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

/// Points and lines of markers, for the time of one picture: (markers x 1), `None` for other shapes and empty ones.
fn marker_parts(gl: &Current<'_>, markers: &[Marker]) -> Result<Vec<Option<Part>>, RenderError> {
    let part = |marker: &Marker| {
        let (MarkerShape::Points(points, _) | MarkerShape::Lines(points)) = &marker.shape else { return Ok(None) };
        if points.is_empty() {
            return Ok(None);
        }
        let vertices: Vec<f32> =
            points.iter().flat_map(|point| point.iter().copied().chain([0.0, 0.0, 1.0, 0.0, 0.0])).collect();
        let indices: Vec<u32> = (0..points.len() as u32).collect();
        Part::of_vertices(gl, &vertices, &indices).map(Some)
    };
    markers.iter().map(part).collect()
}

/// Adds what is drawn at a place.
fn put<'a>(drawables: &mut Vec<Drawable<'a>>, part: &'a Part, matrix: &Matrix4<f64>, color: [f32; 4], style: Style) {
    let scale = (0..3).map(|column| matrix.fixed_view::<3, 1>(0, column).norm()).fold(0.0, f64::max);
    drawables.push(Drawable {
        part,
        rows: rows(matrix),
        look: Look::of_color(color),
        ids: [0; 2],
        style,
        center: matrix.transform_point(&part.center),
        radius: part.radius * scale,
        is_object: false,
        is_sheet: false,
    });
}

fn put_frame<'a>(drawables: &mut Vec<Drawable<'a>>, shapes: &'a Shapes, pose: &Isometry3<f64>, length: f64) {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    for (axis, color) in axes.into_iter().zip(AXES) {
        let turn = nalgebra::UnitQuaternion::rotation_between(&Vector3::x(), &axis).unwrap_or_default();
        let matrix = (pose * turn).to_homogeneous() * Matrix4::new_scaling(length);
        put(drawables, &shapes.arrow, &matrix, color, Style::Lit);
    }
}

/// Everything that is drawn of a stage, objects first; and how many of it are objects.
fn drawables<'a>(
    built: &'a Built,
    flags: &Flags<'_>,
    shapes: &'a Shapes,
    markers: &'a [Marker],
    marker_parts: &'a [Option<Part>],
) -> (Vec<Drawable<'a>>, usize) {
    let mut drawables: Vec<Drawable<'a>> = Vec::with_capacity(built.items.len());
    for item in &built.items {
        let object = &built.objects[item.object];
        let mut look = item.look;
        if let Some(highlight) = flags.highlight.filter(|highlight| object.source == Source::Body(highlight.body)) {
            let [r, g, b] = highlight.color;
            look = Look::of_color([r, g, b, 1.0]);
        }
        drawables.push(Drawable {
            part: &item.part,
            rows: item.rows,
            look,
            ids: [item.object as u32 + 1, object.model],
            style: item.program.map_or(Style::Lit, Style::User),
            center: item.center,
            radius: item.radius,
            is_object: true,
            is_sheet: matches!(object.source, Source::SoftBody(_)),
        });
    }
    let objects = drawables.len();
    if !flags.markers {
        return (drawables, objects);
    }
    for item in built.collision_items.iter().flatten().filter(|_| flags.collision_shapes) {
        drawables.push(Drawable {
            part: &item.part,
            rows: item.rows,
            look: item.look,
            ids: [0; 2],
            style: Style::Outline,
            center: item.center,
            radius: item.radius,
            is_object: false,
            is_sheet: false,
        });
    }
    let visuals = &built.visuals;
    for object in &built.objects {
        if built.is_removed(object.source) {
            continue;
        }
        if flags.frames != flags.own_frames.contains(&*object.name) {
            put_frame(&mut drawables, shapes, &object.pose, object.frame_length);
        }
        match object.source {
            Source::Sensor(index) if flags.sensors.unwrap_or(visuals.sensors[index].visible) => {
                let sensor = &visuals.sensors[index];
                let readings = built.snapshot.sensors.get(index);
                for (ray, place) in sensor.rays.iter().enumerate() {
                    let start = Point3::from(place.start);
                    let along = place.direction * sensor.range;
                    let mut ball = |point: Point3<f64>, color| {
                        let place = object.pose * nalgebra::Translation3::from(point.coords);
                        let matrix = place.to_homogeneous() * Matrix4::new_scaling(sensor.visible_size);
                        put(&mut drawables, &shapes.sphere, &matrix, color, Style::Lit);
                    };
                    ball(start, RAY_START);
                    ball(start + along, RAY_END);
                    let reading = readings.and_then(|readings| readings.get(ray));
                    if let Some(reading) = reading.filter(|reading| reading.triggered) {
                        ball(start + along * (1.0 - reading.measurement), RAY_HIT);
                    }
                }
            }
            Source::Actuator(index) if flags.actuators.unwrap_or(visuals.actuators[index].visible) => {
                let holds = built.snapshot.actuators.get(index).copied().unwrap_or(false);
                let color = if holds { ACTUATOR_HOLDS } else { ACTUATOR };
                let size = visuals.actuators[index].visible_size;
                let matrix = object.pose.to_homogeneous() * Matrix4::new_scaling(size);
                put(&mut drawables, &shapes.sphere, &matrix, color, Style::Lit);
            }
            _ => {}
        }
    }
    for (marker, part) in markers.iter().zip(marker_parts) {
        let pose = marker.pose.to_homogeneous();
        let scaled = |x: f32, y: f32, z: f32| pose * scaling(&Vector3::new(f64::from(x), f64::from(y), f64::from(z)));
        let color = marker.color;
        match (&marker.shape, part) {
            (MarkerShape::Sphere(r), _) => put(&mut drawables, &shapes.sphere, &scaled(*r, *r, *r), color, Style::Lit),
            (MarkerShape::Box([x, y, z]), _) => {
                put(&mut drawables, &shapes.cube, &scaled(*x, *y, *z), color, Style::Lit);
            }
            (MarkerShape::Arrow(length, radius), _) => {
                let head = (4.0 * radius).min(0.5 * length);
                let shaft = scaled(length - head, *radius, *radius);
                put(&mut drawables, &shapes.cylinder, &shaft, color, Style::Lit);
                let neck = pose * Matrix4::new_translation(&Vector3::new(f64::from(length - head), 0.0, 0.0));
                let head = Vector3::new(f64::from(head), f64::from(2.0 * radius), f64::from(2.0 * radius));
                put(&mut drawables, &shapes.cone, &(neck * scaling(&head)), color, Style::Lit);
            }
            (MarkerShape::Frame(length), _) => put_frame(&mut drawables, shapes, &marker.pose, f64::from(*length)),
            (MarkerShape::Points(_, size), Some(part)) => {
                put(&mut drawables, part, &pose, color, Style::Points(*size));
            }
            (MarkerShape::Lines(_), Some(part)) => put(&mut drawables, part, &pose, color, Style::Lines),
            (MarkerShape::Points(..) | MarkerShape::Lines(_), None) => {}
        }
    }
    (drawables, objects)
}

/// What a user wants to see besides the bodies.
struct Flags<'a> {
    frames: bool,
    own_frames: &'a std::collections::BTreeSet<String>,
    sensors: Option<bool>,
    actuators: Option<bool>,
    collision_shapes: bool,
    highlight: Option<&'a crate::Highlight>,
    markers: bool,
}

impl Renderer {
    /// A renderer without a window, on a graphics card or in software.
    ///
    /// # Errors
    /// [`RenderError::NoContext`], [`RenderError::Gl`].
    pub fn offscreen() -> Result<Self, RenderError> {
        Self::on(Device::offscreen()?)
    }

    /// A renderer in the OpenGL context that is current on this thread; `find` gives the addresses of OpenGL functions. A compatibility
    /// profile of version 3.3 or later is needed.
    ///
    /// # Errors
    /// [`RenderError::Gl`].
    ///
    /// # Safety
    /// A context is current on this thread and `find` gives the addresses of its functions. Whenever the renderer is used or dropped, and
    /// whenever something is dropped that it prepared, that context is current on the thread.
    pub unsafe fn in_current_context(
        find: impl FnMut(&std::ffi::CStr) -> *const std::ffi::c_void,
    ) -> Result<Self, RenderError> {
        // SAFETY: promised by the caller.
        Self::on(unsafe { Device::in_current_context(find)? })
    }

    fn on(device: Device) -> Result<Self, RenderError> {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        let resources = {
            let gl = device.enter()?;
            gl.clear_errors();
            Resources::new(&gl)?
        };
        Ok(Self { resources, device, id: NEXT.fetch_add(1, Ordering::Relaxed) })
    }

    /// Vendor, device and version of OpenGL.
    pub fn device(&self) -> &str {
        &self.device.description
    }

    /// Whether pictures are computed by the processor.
    pub fn is_software(&self) -> bool {
        self.device.is_software
    }

    /// Brings a stage up to date: loads what is new in `visuals`, takes the poses of `snapshot`. Returns messages about what cannot be
    /// drawn as described, each once.
    pub fn prepare(&mut self, stage: &mut Stage, visuals: &Arc<VisualScene>, snapshot: &Snapshot) -> Vec<String> {
        let gl = match self.device.enter() {
            Ok(gl) => gl,
            Err(error) => return vec![error.to_string()],
        };
        gl.clear_errors();
        let mut messages = Vec::new();
        let is_current = |built: &Built| built.renderer == self.id && Arc::ptr_eq(&built.visuals, visuals);
        let resources = &mut self.resources;
        if !stage.built.as_ref().is_some_and(is_current) {
            let mut built = resources.build(&gl, self.id, visuals, snapshot, &mut messages);
            // What the old stage used is kept until the new one has taken its meshes from the library.
            built.said = stage.built.take().map(|built| built.said).unwrap_or_default();
            stage.built = Some(built);
            resources.library.prune();
        }
        let Some(built) = &mut stage.built else { return messages };
        if stage.collision_shapes && built.collision_items.is_none() {
            let items = resources.collision_items(&gl, &built.visuals, &built.objects, &mut messages);
            built.collision_items = Some(items);
        }
        built.take_poses(snapshot);
        for soft in &mut built.soft_items {
            let Some(reading) = snapshot.soft_bodies.get(soft.body) else { continue };
            // Neither time nor number of a snapshot tells: a reset changes the shape and leaves both.
            if soft.shown != reading.nodes {
                soft.shown.clone_from(&reading.nodes);
                // Counted over all stages, which share the shadow maps.
                resources.soft_versions += 1;
                built.soft_version = resources.soft_versions;
                let item = &mut built.items[soft.item];
                (item.center, item.radius) = soft.part.follow(&gl, &item.part, &reading.nodes);
            }
        }
        messages.retain(|message| built.said.insert(message.clone()));
        gl.leave();
        messages
    }

    /// Draws a stage without a window and reads the picture back.
    ///
    /// # Errors
    /// [`RenderError::Size`], [`RenderError::Gl`], [`RenderError::NotPrepared`].
    pub fn render(&mut self, stage: &mut Stage, view: &View, request: &PictureRequest) -> Result<Picture, RenderError> {
        let (width, height) = (request.width, request.height);
        let eyes = self.eyes(view, width, height)?;
        let mut picture = Picture { width, height, eyes, ..Picture::default() };
        let gl = self.device.enter()?;
        gl.clear_errors();
        let mask = request.preprocessing.as_ref().map(|files| {
            let user = self.resources.programs.user(&gl, files, &mut picture.messages);
            user.map_or(Mask::Built, Mask::User)
        });
        let samples = if mask.is_some() { 1 } else { request.samples.clamp(1, 8) };
        let bytes = std::mem::take(&mut self.resources.bytes);
        let markers = request.markers;
        let bytes = self.resources.with_scene(&gl, self.id, stage, markers, |pass, targets| {
            let mut bytes = bytes;
            if request.color {
                let target = targets.get(&gl, TargetKind::Color(samples), width, height)?;
                gl.bind_target(target);
                for eye in &picture.eyes {
                    pass.color(eye, mask)?;
                }
                let target = match samples {
                    1 => target,
                    _ => {
                        // One sample a pixel again, in a target that exists besides this one.
                        let joined = gl.target(width, height, TargetKind::Color(1))?;
                        gl.copy(target, &joined);
                        targets.0.insert(0, (TargetKind::Color(1), joined));
                        &targets.0[0].1
                    }
                };
                gl.read_color(target, &mut bytes);
                picture.color = rgb(&bytes, width as usize);
            }
            if request.depth {
                let target = targets.get(&gl, TargetKind::Color(1), width, height)?;
                // The depth of the colour is the depth that is wanted, unless transparent bodies were drawn opaque.
                if !request.color || samples > 1 || mask.is_some() {
                    gl.bind_target(target);
                    for eye in &picture.eyes {
                        pass.depth(eye)?;
                    }
                }
                gl.read_depth(target, &mut bytes);
                picture.depth = metric(&bytes, width, &picture.eyes);
            }
            if request.ids || request.normals {
                let target = targets.get(&gl, TargetKind::Flat(request.normals), width, height)?;
                gl.bind_target(target);
                for eye in &picture.eyes {
                    pass.flat(eye, request.normals)?;
                }
                if request.ids {
                    gl.read_ids(target, &mut bytes);
                    let id = |b: [u8; 8]| {
                        [u32::from_ne_bytes([b[0], b[1], b[2], b[3]]), u32::from_ne_bytes([b[4], b[5], b[6], b[7]])]
                    };
                    picture.ids = top_first(&bytes, width as usize, |pixel| [id(pixel)]);
                }
                if request.normals {
                    gl.read_normals(target, &mut bytes);
                    let number = |b: &[u8; 16], i: usize| f32::from_ne_bytes(std::array::from_fn(|j| b[4 * i + j]));
                    let normal = |b: [u8; 16]| [std::array::from_fn(|i| number(&b, i))];
                    picture.normals = top_first(&bytes, width as usize, normal);
                }
            }
            Ok(bytes)
        })?;
        self.resources.bytes = bytes;
        gl.leave();
        match gl.error() {
            None => Ok(picture),
            Some(error) => Err(RenderError::Gl(error)),
        }
    }

    /// Draws a stage into the frame buffer that is bound (0: the window's), lower left corner at (0, 0). `samples` as in
    /// [`PictureRequest`]; `mirrored` flips the picture top to bottom, with one sample a pixel.
    ///
    /// # Errors
    /// [`RenderError::Size`], [`RenderError::Gl`], [`RenderError::NotPrepared`].
    pub fn draw(
        &mut self,
        stage: &mut Stage,
        view: &View,
        (width, height): (u32, u32),
        samples: u32,
        mirrored: bool,
    ) -> Result<(), RenderError> {
        let eyes = self.eyes(view, width, height)?;
        let gl = self.device.enter()?;
        gl.clear_errors();
        let bound = gl.bound();
        let samples = if mirrored { 1 } else { samples.clamp(1, 8) };
        // What is bound is drawn into if that gives the same picture: a copy costs a software renderer as much as the scene.
        let is_direct = samples == 1 && !mirrored && gl.bound_depth_bits() >= 24;
        self.resources.with_scene(&gl, self.id, stage, true, |pass, targets| {
            let target = match is_direct {
                true => None,
                false => Some(targets.get(&gl, TargetKind::Color(samples), width, height)?),
            };
            match target {
                Some(target) => gl.bind_target(target),
                // Drawing shadow maps has bound others.
                None => gl.bind_again(bound),
            }
            for eye in &eyes {
                pass.color(eye, None)?;
            }
            gl.leave();
            if let Some(target) = target {
                gl.copy_to_bound(target, bound, mirrored);
            }
            Ok(())
        })?;
        match gl.error() {
            None => Ok(()),
            Some(error) => Err(RenderError::Gl(error)),
        }
    }

    fn eyes(&self, view: &View, width: u32, height: u32) -> Result<Vec<Eye>, RenderError> {
        let most = self.device.most_pixels;
        // Each of two eyes needs a column.
        let least = if view.stereo.is_some() { 2 } else { 1 };
        if !(least..=most).contains(&width) || !(1..=most).contains(&height) {
            return Err(RenderError::Size { width, height, most });
        }
        Ok(view.eyes(width, height))
    }
}

impl Resources {
    /// Brings the lights and their shadow maps up to date, then draws.
    fn with_scene<R>(
        &mut self,
        gl: &Current<'_>,
        renderer: u64,
        stage: &Stage,
        markers: bool,
        draw: impl FnOnce(&mut Pass<'_>, &mut Targets) -> Result<R, RenderError>,
    ) -> Result<R, RenderError> {
        let built = stage.built.as_ref().filter(|built| built.renderer == renderer).ok_or(RenderError::NotPrepared)?;
        let temporary = match markers {
            true => marker_parts(gl, &stage.markers)?,
            false => Vec::new(),
        };
        let flags = Flags {
            frames: stage.frames,
            own_frames: &stage.own_frames,
            sensors: stage.sensors,
            actuators: stage.actuators,
            collision_shapes: stage.collision_shapes,
            highlight: stage.highlight.as_ref(),
            markers,
        };
        let (drawables, objects) = drawables(built, &flags, &self.shapes, &stage.markers, &temporary);
        let casters = &drawables[..objects];
        let lights = built.lights(gl, &mut self.programs, &self.buffer, casters, &mut self.maps)?;
        let mut pass = Pass {
            gl,
            programs: &mut self.programs,
            buffer: &self.buffer,
            drawables: &drawables,
            lights: &lights,
            maps: &self.maps,
            no_shadow: &self.no_shadow,
            sky: self.sky.as_ref().and_then(|(_, sky)| sky.as_ref()),
            white: &self.white,
            normal_maps: !stage.normal_maps_off,
            lit_programs: Vec::new(),
        };
        draw(&mut pass, &mut self.targets)
    }
}

/// Pixels of `N` bytes, bottom row first, as `M` values each, top row first.
fn top_first<const N: usize, const M: usize, T: Copy + Default>(
    bytes: &[u8],
    width: usize,
    convert: impl Fn([u8; N]) -> [T; M],
) -> Vec<T> {
    let (pixels, _) = bytes.as_chunks::<N>();
    let mut out = vec![T::default(); pixels.len() * M];
    let (places, _) = out.as_chunks_mut::<M>();
    for (from, to) in pixels.chunks_exact(width).rev().zip(places.chunks_exact_mut(width)) {
        for (from, to) in from.iter().zip(to) {
            *to = convert(*from);
        }
    }
    out
}

/// Red, green and blue of RGBA pixels, bottom row first, top row first.
fn rgb(bytes: &[u8], width: usize) -> Vec<u8> {
    let mut out = vec![0; bytes.len() / 4 * 3];
    for (row, to) in bytes.chunks_exact(4 * width).rev().zip(out.chunks_exact_mut(3 * width)) {
        // Four pixels at once, as three words.
        let (fours, rest) = row.as_chunks::<16>();
        let (twelves, last) = to.as_chunks_mut::<12>();
        for (four, twelve) in fours.iter().zip(twelves) {
            let (pixels, _) = four.as_chunks::<4>();
            let [a, b, c, d] = std::array::from_fn(|i| u32::from_le_bytes(pixels[i]));
            let words = [a & 0xff_ffff | b << 24, b >> 8 & 0xffff | c << 16, c >> 16 & 0xff | d << 8];
            for (to, word) in twelve.as_chunks_mut::<4>().0.iter_mut().zip(words) {
                *to = word.to_le_bytes();
            }
        }
        for (pixel, to) in rest.chunks_exact(4).zip(last.chunks_exact_mut(3)) {
            to.copy_from_slice(&pixel[..3]);
        }
    }
    out
}

/// Depths of a depth buffer (native f32, bottom row first) in m along the axis, top row first.
fn metric(bytes: &[u8], width: u32, eyes: &[Eye]) -> Vec<f32> {
    let (depths, _) = bytes.as_chunks::<4>();
    let mut out = Vec::with_capacity(depths.len());
    for row in depths.chunks_exact(width as usize).rev() {
        for eye in eyes {
            let pixels = row[eye.left as usize..(eye.left + eye.width) as usize].iter();
            let p = &eye.projection;
            let (p22, p23, p32, p33) = (p[(2, 2)], p[(2, 3)], p[(3, 2)], p[(3, 3)]);
            if (p32, p33) == (-1.0, 0.0) {
                // p23 / (p22 + n) with n = 2 d - 1, which is exact: the sum loses nothing where p22 is given by two floats.
                let (numerator, high) = (p23 as f32, p22 as f32);
                let low = (p22 - f64::from(high)) as f32;
                out.extend(pixels.map(|&depth| numerator / (2.0 * f32::from_ne_bytes(depth) - 1.0 + high + low)));
            } else {
                out.extend(pixels.map(|&depth| {
                    let n = 2.0 * f64::from(f32::from_ne_bytes(depth)) - 1.0;
                    ((p23 - n * p33) / (p22 - n * p32)) as f32
                }));
            }
        }
    }
    out
}
