//! What is drawn of a stage at one moment: its objects, then markers.

use ambf_core::ids::BodyId;
use nalgebra::{Isometry3, Matrix4, Point3, Vector3};

use super::build::scaling;
use super::shapes::Shapes;
use crate::draw::{Drawable, Style};
use crate::gl::Current;
use crate::meshes::Part;
use crate::stage::{rows, Built, Look, Marker, MarkerShape, Source};
use crate::RenderError;

/// Colours of the frames' arrows.
const AXES: [[f32; 4]; 3] = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]];

/// Start, end and hit of a sensor's ray.
const RAY_START: [f32; 4] = [1.0, 0.0, 0.0, 1.0];

const RAY_END: [f32; 4] = [0.0, 128.0 / 255.0, 0.0, 1.0];

const RAY_HIT: [f32; 4] = [1.0, 105.0 / 255.0, 180.0 / 255.0, 1.0];

/// An actuator, and one that holds something.
const ACTUATOR: [f32; 4] = [1.0, 215.0 / 255.0, 0.0, 1.0];

const ACTUATOR_HOLDS: [f32; 4] = [0.0, 1.0, 0.0, 1.0];

/// What a user wants to see besides the bodies.
pub(super) struct Flags<'a> {
    pub(super) frames: bool,
    pub(super) own_frames: &'a std::collections::BTreeSet<String>,
    pub(super) sensors: Option<bool>,
    pub(super) actuators: Option<bool>,
    pub(super) collision_shapes: bool,
    pub(super) highlight: Option<&'a crate::Highlight>,
    pub(super) markers: bool,
}

/// Points and lines of markers, for the time of one picture: (markers x 1), `None` for other shapes and empty ones.
pub(super) fn marker_parts(gl: &Current<'_>, markers: &[Marker]) -> Result<Vec<Option<Part>>, RenderError> {
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
        isosurface: None,
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

/// Bodies of the burrs that tools do not have now.
fn spare_burrs(built: &Built) -> Vec<BodyId> {
    let mut spare = Vec::new();
    for ((_, volume), tools) in built.visuals.volumes.entries().zip(built.snapshot.tools.iter()) {
        for (burrs, tool) in volume.burrs.iter().zip(tools).filter(|_| !volume.object.removed) {
            spare.extend(burrs.iter().filter(|&&burr| Some(burr) != tool.burr));
        }
    }
    spare
}

/// Everything that is drawn of a stage, objects first; and how many of it are objects.
pub(super) fn drawables<'a>(
    built: &'a Built,
    flags: &Flags<'_>,
    shapes: &'a Shapes,
    markers: &'a [Marker],
    marker_parts: &'a [Option<Part>],
) -> (Vec<Drawable<'a>>, usize) {
    let mut drawables: Vec<Drawable<'a>> = Vec::with_capacity(built.items.len());
    let spare = spare_burrs(built);
    for item in &built.items {
        let object = &built.objects[item.object];
        if matches!(object.source, Source::Body(body) if spare.contains(&body)) {
            continue;
        }
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
            isosurface: item.isosurface.as_ref(),
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
            isosurface: None,
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
            Source::Sensor(id) if flags.sensors.unwrap_or(visuals.sensors[id].visible) => {
                let sensor = &visuals.sensors[id];
                let readings = built.snapshot.sensors.get(id);
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
            Source::Actuator(id) if flags.actuators.unwrap_or(visuals.actuators[id].visible) => {
                let holds = built.snapshot.actuators.get(id).copied().unwrap_or(false);
                let color = if holds { ACTUATOR_HOLDS } else { ACTUATOR };
                let size = visuals.actuators[id].visible_size;
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
