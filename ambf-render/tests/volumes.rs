//! Volumes against analytic surfaces: a ball whose density falls linearly across its surface.

mod render_common;

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use ambf_core::ids::{CameraId, VolumeId};
use ambf_core::volume::{Carver, Rule, Shape, Stroke, VoxelGrid};
use ambf_render::{Picture, PictureRequest, Renderer};
use image::{Rgba, RgbaImage};
use nalgebra::{Isometry3, Point3, Vector3};
use render_common::{directory, pixel, Shown};

const CAMERA: CameraId = CameraId::new(0);
/// Voxels along x, y and z, and edges of their box, m: voxels of three different edges.
const VOXELS: [u32; 3] = [48, 40, 36];
const EDGES: [f64; 3] = [0.48, 0.42, 0.45];
/// Middle of the ball in the box, its radius, and half the thickness of the layer in which its density falls, m.
const MIDDLE: [f64; 3] = [0.03, -0.02, 0.04];
const RADIUS: f64 = 0.15;
const LAYER: f64 = 0.04;

/// Writes the ball as a stack of pictures in which `texel` colours the densities.
fn write_ball(folder: &Path, texel: impl Fn(u8) -> [u8; 4]) {
    std::fs::create_dir_all(folder).expect("a folder");
    let place = |axis: usize, voxel: u32| (f64::from(voxel) + 0.5) / f64::from(VOXELS[axis]) * EDGES[axis];
    for k in 0..VOXELS[2] {
        let slice = RgbaImage::from_fn(VOXELS[0], VOXELS[1], |i, row| {
            // Rows of pictures are counted from above, y from below.
            let voxel = [i, VOXELS[1] - 1 - row, k];
            let from_corner = Vector3::from_fn(|axis, _| place(axis, voxel[axis]) - 0.5 * EDGES[axis] - MIDDLE[axis]);
            let density = (0.5 + 0.5 * (RADIUS - from_corner.norm()) / LAYER).clamp(0.0, 1.0);
            Rgba(texel((255.0 * density).round() as u8))
        });
        slice.save(folder.join(format!("ball{k:02}.png"))).expect("a picture");
    }
}

/// A scene with the ball, and a camera at (2, 0, 0) that looks at the origin. `camera`, `volume` and `bodies` are further
/// text.
fn shown(test: &str, camera: &str, volume: &str, bodies: &str, texel: impl Fn(u8) -> [u8; 4]) -> Shown {
    let folder = directory(test);
    write_ball(&folder.join("stack"), texel);
    let world = format!(
        "gravity: {{x: 0, y: 0, z: 0}}\ncameras: [cam]\nlights: [light]\n\
         cam:\n  location: {{x: 2.0, y: 0.0, z: 0.0}}\n  look at: {{x: 0.0, y: 0.0, z: 0.0}}\n  up: {{x: 0, y: 0, z: 1}}\n\
         \x20 clipping plane: {{near: 0.1, far: 10.0}}\n  field view angle: 0.5\n{camera}\
         light:\n  location: {{x: 4.0, y: 0.0, z: 0.0}}\n  direction: {{x: -1.0, y: 0.0, z: 0.0}}\n"
    );
    let [x, y, z] = EDGES;
    let mut model = format!(
        "volumes: [V]\nV:\n  images: {{path: stack, prefix: ball, format: png, count: {}}}\n\
         \x20 dimensions: {{x: {x}, y: {y}, z: {z}}}\n  quality: 1.0\n{volume}",
        VOXELS[2]
    );
    write!(model, "{}", if bodies.is_empty() { "bodies: []\n" } else { bodies }).expect("a text");
    Shown::of_texts(&folder, &world, &model)
}

fn drawn(shown: &mut Shown) -> Picture {
    let all = PictureRequest { depth: true, ids: true, normals: true, ..PictureRequest::color(160, 120) };
    let mut renderer = Renderer::offscreen().expect("OpenGL without a window");
    let picture = shown.picture(&mut renderer, CAMERA, &all);
    assert_eq!(picture.messages, [""; 0]);
    picture
}

fn grey(density: u8) -> [u8; 4] {
    [density, density, density, 255]
}

/// Compares depth, normals and ids with a ball around `middle` in the world, m; returns the pixels that show it.
fn is_ball(shown: &Shown, picture: &Picture, middle: &Point3<f64>) -> usize {
    let camera = shown.snapshot.views[CAMERA].pose;
    let middle = camera.inverse() * middle;
    let points = picture.points();
    let is_orthographic = picture.eyes[0].is_orthographic;
    let (mut seen, mut wrong) = (0, 0);
    for row in 0..picture.height {
        for column in 0..picture.width {
            let place = (row * picture.width + column) as usize;
            let point = points[((picture.height - 1 - row) * picture.width + column) as usize].map(f64::from);
            let point = Point3::from(point);
            // The ray of the pixel, and how far from the middle it passes.
            let (from, along) = match is_orthographic {
                true => (Point3::new(0.0, point.y, point.z), -Vector3::x()),
                false => (Point3::origin(), point.coords.normalize()),
            };
            let across = (middle - from).cross(&along).norm();
            let is_seen = picture.ids[place] != [0; 2];
            assert_eq!(is_seen, picture.depth[place] < 9.9, "ids and depth show the same");
            assert_eq!(is_seen, pixel(picture, column, row) != [255; 3], "colour and depth show the same");
            if !is_seen {
                wrong += usize::from(across < RADIUS - 0.001);
                continue;
            }
            seen += 1;
            assert_eq!(shown.stage.id_name(picture.ids[place][0]), Some("V"));
            if across > RADIUS - 0.005 {
                // Grazing: what is between the voxels decides.
                wrong += usize::from(across > RADIUS + 0.001);
                continue;
            }
            // Interpolation between voxels is off by up to h²/(8 R), h² = 0.0100² + 0.0105² + 0.0125² m².
            let off = (point - middle).norm() - RADIUS;
            assert!(off.abs() < 6e-4, "({column}, {row}) is {off} m beside the surface");
            let normal = Vector3::from(picture.normals[place].map(f64::from));
            let angle = normal.angle(&(point - middle)).to_degrees();
            assert!(angle < 2.0, "({column}, {row}): the normal is off by {angle} degrees");
        }
    }
    assert!(wrong <= 6, "{wrong} pixels at the rim are wrong");
    seen
}

#[test]
fn depth_ids_and_normals_are_those_of_the_ball() {
    for (name, camera) in [("perspective", ""), ("orthographic", "  orthographic view width: 1.0\n")] {
        let mut shown = shown(&format!("volume_{name}"), camera, "", "", grey);
        let picture = drawn(&mut shown);
        assert!(is_ball(&shown, &picture, &Point3::from(MIDDLE)) > 1000, "{name}");
    }
}

#[test]
fn a_volume_follows_its_parent_and_hides_behind_bodies() {
    let body = "bodies: [BODY B, BODY Wall]\nBODY B:\n  mass: 1.0\n  mesh: ''\n  shape: Sphere\n  geometry: {radius: 0.01}\n  visible: false\n\
                \x20 location: {position: {x: -0.3, y: 0.1, z: 0.05}, orientation: {r: 0.4, p: -0.3, y: 2.0}}\n\
                BODY Wall:\n  mass: 0.0\n  mesh: ''\n  shape: Box\n  geometry: {x: 0.1, y: 4.0, z: 4.0}\n\
                \x20 location: {position: {x: -1.0, y: 0.0, z: 0.0}, orientation: {r: 0, p: 0, y: 0}}\n";
    let volume =
        "  parent: BODY B\n  location: {position: {x: 0.02, y: 0.0, z: -0.03}, orientation: {r: 0, p: 0.7, y: 0}}\n";
    let mut shown = shown("volume_parent", "", volume, body, grey);
    let carrier = shown.snapshot.bodies.iter().next().expect("a body").inertial_pose();
    let local = Isometry3::new(Vector3::new(0.02, 0.0, -0.03), Vector3::y() * 0.7);
    let pose = shown.snapshot.volumes[VolumeId::new(0)];
    assert!((pose.to_homogeneous() - (carrier * local).to_homogeneous()).norm() < 1e-9);
    // The wall is behind: pixels beside the ball show it.
    let mut renderer = Renderer::offscreen().expect("OpenGL without a window");
    let request = PictureRequest { ids: true, ..PictureRequest::color(160, 120) };
    let shares = |picture: &Picture, shown: &Shown| {
        let names = picture.ids.iter().map(|id| shown.stage.id_name(id[0]));
        names.fold([0, 0], |[ball, wall], name| match name {
            Some("V") => [ball + 1, wall],
            Some("BODY Wall") => [ball, wall + 1],
            other => panic!("{other:?}"),
        })
    };
    let picture = shown.picture(&mut renderer, CAMERA, &request);
    let [ball, wall] = shares(&picture, &shown);
    assert!(ball > 500 && wall > 10_000, "{ball} {wall}");
    // In front of the ball, it hides it; through the middle of the ball, half of it is hidden.
    let wall_at = |shown: &mut Shown, x: f64| shown.snapshot.bodies.iter_mut().nth(1).expect("the wall").origin[0] = x;
    wall_at(&mut shown, 1.0);
    let picture = shown.picture(&mut renderer, CAMERA, &request);
    assert_eq!(shares(&picture, &shown)[0], 0);
    let middle = pose * Point3::from(MIDDLE);
    wall_at(&mut shown, middle.x + 0.8 * RADIUS - 0.05);
    let picture = shown.picture(&mut renderer, CAMERA, &request);
    // Before the wall is a cap whose rim has 0.6 of the ball's radius, and is nearer than the ball's middle.
    let share = f64::from(shares(&picture, &shown)[0]) / f64::from(ball);
    let (to_middle, to_rim) = (2.0 - middle.x, 2.0 - middle.x - 0.8 * RADIUS);
    let expected = (0.6 * RADIUS / to_rim).powi(2) / (RADIUS * RADIUS / (to_middle * to_middle - RADIUS * RADIUS));
    assert!((share - expected).abs() < 0.02, "{share}, expected {expected}");
}

#[test]
fn the_material_and_the_voxels_give_the_colour() {
    // Density 0.5 at the surface: half the grey. Red voxels: full colour, as densities mix with black outside.
    let plain = "  color components:\n    ambient: {level: 0.0}\n    diffuse: {r: 1.0, g: 1.0, b: 1.0}\n    specular: {r: 0, g: 0, b: 0}\n    transparency: 1.0\n";
    for (name, texel, expected) in [
        ("grey", grey as fn(u8) -> [u8; 4], [0.35, 0.35, 0.35]),
        ("red", |density| [(f64::from(density) * 0.8) as u8, 0, 0, density], [0.56, 0.0, 0.0]),
    ] {
        let mut shown = shown(&format!("volume_{name}"), "", plain, "", texel);
        let picture = drawn(&mut shown);
        // Where the normal is towards the light: on the line from the camera through the middle of the ball.
        let middle = shown.snapshot.views[CAMERA].pose.inverse() * Point3::from(MIDDLE);
        let focal = 60.0 / 0.25_f64.tan();
        let (column, row) = (80.0 + focal * middle.y / -middle.x, 60.0 - focal * middle.z / -middle.x);
        let got = pixel(&picture, column as u32, row as u32).map(|level| f64::from(level) / 255.0);
        for (got, expected) in got.into_iter().zip(expected) {
            assert!((got - expected).abs() < 0.02, "{name}: {got}, expected {expected}");
        }
    }
}

#[test]
fn all_materials_and_lights_work_on_volumes() {
    // A wall between the light and the ball, beside the line of sight.
    let wall = "bodies: [BODY Wall]\nBODY Wall:\n  mass: 0.0\n  mesh: ''\n  shape: Box\n  geometry: {x: 0.1, y: 2.0, z: 2.0}\n\
                \x20 location: {position: {x: 3.0, y: 0.0, z: 0.0}, orientation: {r: 0, p: 0, y: 0}}\n";
    let matt = "  color components:\n    ambient: {level: 0.0}\n    diffuse: {r: 1.0, g: 1.0, b: 1.0}\n    specular: {r: 0, g: 0, b: 0}\n    transparency: 1.0\n";
    let metal = format!("{matt}    metallic: 0.5\n    roughness: 0.5\n");
    for (name, material) in [("matt", matt), ("metal", &metal)] {
        let brightest = |shadows: &str| {
            let test = format!("volume_{name}");
            shown(&test, "", material, wall, grey);
            let read = |file: &str| std::fs::read_to_string(directory(&test).join(file)).expect("it was written");
            let world = read("world.yaml").replace("light:\n", &format!("light:\n{shadows}"));
            let mut shown = Shown::of_texts(&directory(&test), &world, &read("model.yaml"));
            let picture = drawn(&mut shown);
            let of_ball = picture.color.chunks_exact(3).zip(&picture.ids).filter(|(_, id)| **id != [0; 2]);
            of_ball.map(|(pixel, _)| pixel[0]).max().expect("the ball is seen")
        };
        let (lit, shaded) = (brightest(""), brightest("  shadow quality: 3\n"));
        assert!(lit > 60 && shaded < lit - 20, "{name}: {lit} in the light, {shaded} in the shadow");
    }
}

#[test]
fn the_eye_may_be_in_the_box_and_in_the_ball() {
    // Beside the ball, but in its box: the ball is seen. In the ball: all pixels are of it, at the near plane.
    let mut inside = shown("volume_inside", "", "", "", grey);
    let place = |shown: &mut Shown, at: [f64; 3]| {
        shown.snapshot.views[CAMERA].pose.translation.vector = Vector3::from(at);
        shown.snapshot.views[CAMERA].near_plane = 0.01;
    };
    place(&mut inside, [0.22, MIDDLE[1], MIDDLE[2]]);
    let picture = drawn(&mut inside);
    let middle = picture.depth[60 * 160 + 80];
    assert!((f64::from(middle) - (0.22 - MIDDLE[0] - RADIUS)).abs() < 1e-3, "{middle}");
    place(&mut inside, MIDDLE);
    let picture = drawn(&mut inside);
    assert!(picture.depth.iter().all(|&depth| (f64::from(depth) - 0.01).abs() < 1e-3), "at the near plane");
}

#[test]
fn transparent_volumes_show_what_is_behind_and_have_no_depth() {
    let glass = "  color rgba: {r: 1.0, g: 1.0, b: 1.0, a: 0.5}\n";
    let mut clear = shown("volume_clear", "", glass, "", grey);
    let mut solid = shown("volume_solid", "", &glass.replace("a: 0.5", "a: 1.0"), "", grey);
    let (clear, solid) = (drawn(&mut clear), drawn(&mut solid));
    assert!(clear.depth.iter().all(|&depth| depth > 9.9) && solid.depth.iter().any(|&depth| depth < 9.9));
    for (&clear, &solid) in clear.color.iter().zip(&solid.color) {
        // Half of the volume, half of the white behind it.
        assert!((f64::from(clear) - 0.5 * (255.0 + f64::from(solid))).abs() <= 1.5, "{clear} {solid}");
    }
}

#[test]
fn a_volume_that_cannot_be_read_is_not_drawn() {
    shown("volume_none", "", "", "", grey);
    let folder = directory("volume_none");
    std::fs::remove_dir_all(folder.join("stack")).expect("it is there");
    let (world, model) = (folder.join("world.yaml"), folder.join("model.yaml"));
    let mut shown = Shown::of_files(Some(&world), &[&model]);
    let mut renderer = Renderer::offscreen().expect("OpenGL without a window");
    let picture = shown.picture(&mut renderer, CAMERA, &PictureRequest::color(16, 12));
    assert!(picture.color.iter().all(|&level| level == 255), "nothing is drawn");
}

#[test]
fn what_was_cut_is_sent_alone_and_looks_as_if_all_was_sent() {
    let volume = VolumeId::new(0);
    for (name, texel) in [("grey", grey as fn(u8) -> [u8; 4]), ("red", |density| [200, 0, 0, density])] {
        let mut shown = shown(&format!("volume_cut_{name}"), "", "", "", texel);
        let mut renderer = Renderer::offscreen().expect("OpenGL without a window");
        let request = PictureRequest { depth: true, ids: true, normals: true, ..PictureRequest::color(160, 120) };
        let before = shown.picture(&mut renderer, CAMERA, &request);
        let channels = if name == "grey" { 1 } else { 4 };
        let whole = renderer.sent_voxel_bytes();
        assert_eq!(whole, u64::from(VOXELS.iter().product::<u32>()) * channels);
        let mut grid = VoxelGrid::clone(shown.snapshot.voxels[volume].as_ref().expect("it has voxels"));
        let here = Isometry3::translation(MIDDLE[0] + RADIUS, MIDDLE[1], MIDDLE[2]);
        let shape = Shape::Sphere { radius: 0.06 };
        let mut carver = Carver::default();
        carver.carve(&mut grid, &shape, &Stroke { from: here, to: here }, Rule::All).expect("a cut");
        shown.snapshot.voxels[volume] = Some(Arc::new(grid));
        let cut = shown.picture(&mut renderer, CAMERA, &request);
        let sent = renderer.sent_voxel_bytes() - whole;
        // The ball has twelve voxels across: at most three bricks each way.
        assert!(sent > 0 && sent <= 27 * 512 * channels, "{sent} of {whole} bytes");
        shown.picture(&mut renderer, CAMERA, &request);
        assert_eq!(renderer.sent_voxel_bytes(), whole + sent, "nothing has changed since");
        let mut other = Renderer::offscreen().expect("OpenGL without a window");
        let anew = shown.picture(&mut other, CAMERA, &request);
        assert!(
            cut.color == anew.color && cut.depth == anew.depth && cut.normals == anew.normals && cut.ids == anew.ids
        );
        // Through the middle of the hole it is as much deeper as the radius of what cut.
        let focal = 60.0 / 0.25_f64.tan();
        let middle = shown.snapshot.views[CAMERA].pose.inverse() * Point3::from(MIDDLE);
        let (column, row) = (80.0 + focal * middle.y / -middle.x, 60.0 - focal * middle.z / -middle.x);
        let place = row as usize * 160 + column as usize;
        let deeper = f64::from(cut.depth[place] - before.depth[place]);
        assert!((deeper - 0.06).abs() < 0.01, "{deeper}");
    }
}
