//! What must be seen, by numbers: the checklist of what a viewer of these scenes shows. Tests are named after its rows.

mod render_common;

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_core::ids::{ActuatorId, BodyId, CameraId, LightId, SensorId, SoftBodyId};
use ambf_core::plugin::Pixels;
use ambf_render::{Backdrop, Picture, PictureRequest, Renderer};
use nalgebra::{Isometry3, Point3, Vector3};
use render_common::{directory, keep, pixel, simulation, Shown};

/// A world with one camera at (2, 0, 0) that looks at the origin, and one light far above it. `camera` and `light` are
/// further lines.
/// The only camera of most scenes here.
const FIRST: CameraId = CameraId::new(0);

fn world(camera: &str, light: &str) -> String {
    format!(
        "namespace: /test/\ngravity: {{x: 0, y: 0, z: 0}}\ncameras: [cam]\nlights: [light1]\n\
         cam:\n  name: cam\n  location: {{x: 2.0, y: 0.0, z: 0.0}}\n  look at: {{x: 0.0, y: 0.0, z: 0.0}}\n\
         \x20 up: {{x: 0.0, y: 0.0, z: 1.0}}\n  clipping plane: {{near: 0.1, far: 10.0}}\n  field view angle: 0.5\n{}\
         light1:\n  name: light1\n{}",
        indented(camera),
        indented(if light.is_empty() {
            "location: {x: 2.0, y: 0.0, z: 2.0}\ndirection: {x: -1.0, y: 0.0, z: -1.0}"
        } else {
            light
        }),
    )
}

fn indented(lines: &str) -> String {
    lines.lines().map(|line| format!("  {line}\n")).collect()
}

/// A static box of edge lengths `size` at `at`, with further lines.
fn block(name: &str, at: [f64; 3], size: [f64; 3], more: &str) -> String {
    let ([x, y, z], [a, b, c]) = (at, size);
    format!(
        "BODY {name}:\n  name: {name}\n  mass: 0.0\n  location:\n    position: {{x: {x}, y: {y}, z: {z}}}\n    orientation: {{r: 0, p: 0, y: 0}}\n\
         \x20 shape: Box\n  geometry: {{x: {a}, y: {b}, z: {c}}}\n{}",
        indented(more)
    )
}

const GREY: &str = "color rgba: {r: 0.5, g: 0.5, b: 0.5, a: 1.0}";
const RED: &str = "color rgba: {r: 1.0, g: 0.0, b: 0.0, a: 1.0}";

/// A model of bodies.
fn model(bodies: &[String]) -> String {
    let name = |body: &String| body.lines().next().map(|line| line.trim_end_matches(':').to_owned());
    let names: Vec<String> = bodies.iter().filter_map(name).collect();
    format!("namespace: /test/\nbodies: [{}]\njoints: []\n{}", names.join(", "), bodies.concat())
}

fn shown(test: &str, world: &str, bodies: &[String]) -> Shown {
    Shown::of_texts(&directory(test), world, &model(bodies))
}

fn renderer() -> Renderer {
    Renderer::offscreen().expect("OpenGL without a window")
}

fn drawn(shown: &mut Shown, width: u32, height: u32) -> Picture {
    let request = PictureRequest { depth: true, ..PictureRequest::color(width, height) };
    shown.picture(&mut renderer(), FIRST, &request)
}

/// First and last column and row of the pixels that are not background, and their number.
fn extent(picture: &Picture) -> ([u32; 2], [u32; 2], usize) {
    let (mut columns, mut rows, mut count) = ([u32::MAX, 0], [u32::MAX, 0], 0);
    for row in 0..picture.height {
        for column in 0..picture.width {
            if pixel(picture, column, row) != [255; 3] {
                columns = [columns[0].min(column), columns[1].max(column)];
                rows = [rows[0].min(row), rows[1].max(row)];
                count += 1;
            }
        }
    }
    (columns, rows, count)
}

fn width_of([first, last]: [u32; 2]) -> f64 {
    f64::from(last - first + 1)
}

fn near(got: f64, expected: f64, tolerance: f64, what: &str) {
    assert!((got - expected).abs() <= tolerance, "{what}: {got}, expected {expected} within {tolerance}");
}

/// Colour within 3 levels.
fn is_color(got: [u8; 3], expected: [f64; 3], what: &str) {
    for (got, expected) in got.into_iter().zip(expected) {
        near(f64::from(got), (255.0 * expected).clamp(0.0, 255.0), 3.0, what);
    }
}

#[test]
fn row_01_an_empty_world_is_white() {
    let picture = drawn(&mut shown("row_01", &world("", ""), &[]), 640, 480);
    assert!(picture.color.iter().all(|&level| level == 255));
}

#[test]
fn rows_02_and_03_a_box_spans_what_the_focal_length_says() {
    let mut shown = shown("row_02", &world("", ""), &[block("Box", [0.0; 3], [0.2; 3], GREY)]);
    for (width, height) in [(640, 480), (800, 200)] {
        let picture = drawn(&mut shown, width, height);
        let focal = f64::from(height) / (2.0 * 0.25_f64.tan());
        let (columns, rows, _) = extent(&picture);
        near(width_of(columns), 0.2 * focal / 1.9, 1.0, "width");
        near(width_of(rows), 0.2 * focal / 1.9, 1.0, "height");
        near(f64::from(columns[0] + columns[1] + 1) / 2.0, f64::from(width) / 2.0, 1.0, "middle");
        near(f64::from(rows[0] + rows[1] + 1) / 2.0, f64::from(height) / 2.0, 1.0, "middle");
    }
}

#[test]
fn row_04_y_is_right_and_z_is_up() {
    let right = block("Right", [0.0, 0.3, 0.0], [0.05; 3], RED);
    let (columns, _, count) = extent(&drawn(&mut shown("row_04y", &world("", ""), &[right]), 640, 480));
    assert!(count > 0 && columns[0] > 320, "right of the middle: {columns:?}");
    let up = block("Up", [0.0, 0.0, 0.3], [0.05; 3], RED);
    let (_, rows, count) = extent(&drawn(&mut shown("row_04z", &world("", ""), &[up]), 640, 480));
    assert!(count > 0 && rows[1] < 240, "above the middle: {rows:?}");
}

#[test]
fn row_05_planes_cut_and_distance_shrinks() {
    let widths: Vec<f64> = [0.0, -1.0, -3.0]
        .iter()
        .map(|&x| {
            let body = block("Box", [x, 0.0, 0.0], [0.2; 3], GREY);
            width_of(extent(&drawn(&mut shown("row_05", &world("", ""), &[body]), 640, 480)).0)
        })
        .collect();
    assert!(widths[0] > widths[1] && widths[1] > widths[2], "{widths:?}");
    for x in [-8.2, 1.96] {
        let body = block("Box", [x, 0.0, 0.0], [0.1; 3], GREY);
        let (.., count) = extent(&drawn(&mut shown("row_05", &world("", ""), &[body]), 640, 480));
        assert_eq!(count, 0, "a box at x = {x} is behind the far plane or nearer than the near one");
    }
}

#[test]
fn a_body_around_the_camera_is_seen_from_within() {
    for shape in ["shape: Box\ngeometry: {x: 6, y: 6, z: 6}", "shape: Sphere\ngeometry: {radius: 4}"] {
        let lines = indented(&format!("name: Hull\nmass: 0.0\n{shape}\n{MATT}"));
        let body = format!("BODY Hull:\n{lines}");
        let (columns, rows, count) = extent(&drawn(&mut shown("within", &world("", ""), &[body]), 64, 48));
        assert_eq!((columns, rows, count), ([0, 63], [0, 47], 64 * 48), "{shape}");
    }
}

#[test]
fn rows_06_and_29_orthographic_views() {
    for x in [0.0, -3.0] {
        let body = block("Box", [x, 0.0, 0.0], [1.0; 3], GREY);
        let mut shown = shown("row_06", &world("orthographic view width: 2.0", ""), &[body]);
        let picture = drawn(&mut shown, 640, 480);
        near(width_of(extent(&picture).0), 320.0, 1.0, "half of the width");
        let points = picture.points();
        // Row 300 from the bottom, column 400.
        let point = points[300 * 640 + 400];
        near(f64::from(point[0]), -(2.0 - (x + 0.5)), 1e-4, "x is the depth");
        near(f64::from(point[1]), (400.5 - 320.0) * 2.0 / 640.0, 1e-5, "y");
        near(f64::from(point[2]), (300.5 - 240.0) * 2.0 / 640.0, 1e-5, "z");
    }
}

#[test]
fn row_07_up_turns_the_picture() {
    let world = world("", "").replace("up: {x: 0.0, y: 0.0, z: 1.0}", "up: {x: 0.0, y: 1.0, z: 0.0}");
    let body = block("Box", [0.0, 0.3, 0.0], [0.05; 3], RED);
    let (_, rows, count) = extent(&drawn(&mut shown("row_07", &world, &[body]), 640, 480));
    assert!(count > 0 && rows[1] < 240, "+y of the world is up: {rows:?}");
}

#[test]
fn rows_08_and_09_cameras_follow_their_parents() {
    let child = "cam2:\n  name: cam2\n  parent: cam\n  location: {x: 0.5, y: 0.0, z: 0.0}\n  look at: {x: 0.0, y: 0.0, z: 0.0}\n";
    let world = world("parent: BODY Carrier", "").replace("cameras: [cam]", "cameras: [cam, cam2]") + child;
    let bodies =
        [block("Carrier", [0.0, 0.0, 1.0], [0.01; 3], "visible: false"), block("Box", [0.0, 0.0, 1.0], [0.2; 3], GREY)];
    let simulation = simulation(&directory("row_08"), &world, &model(&bodies));
    let shown = Shown::of_simulation(&simulation);
    let views = &shown.snapshot.views;
    let parent = views[shown.camera("cam")].pose;
    near((parent.translation.vector - Vector3::new(2.0, 0.0, 1.0)).norm(), 0.0, 1e-12, "the parent carries the camera");
    let child = views[shown.camera("cam2")].pose;
    near((parent.inverse() * child).translation.x, 0.5, 1e-12, "a camera carries a camera");
    let mut shown = shown;
    let first = shown.camera("cam");
    let picture = shown.picture(&mut renderer(), first, &PictureRequest::color(640, 480));
    let (columns, rows, _) = extent(&picture);
    assert!(columns[0] < 320 && columns[1] > 320 && rows[0] < 240 && rows[1] > 240);
}

#[test]
fn row_12_points_project_where_the_formulas_say() {
    let at = Point3::new(-0.3, 0.25, 0.17);
    let body = block("Dot", at.coords.into(), [0.004; 3], RED);
    let mut shown = shown("row_12", &world("", ""), &[body]);
    let (columns, rows, _) = extent(&drawn(&mut shown, 1280, 960));
    // Clients know the pose, the matrix from the camera to the optical axes, and fx = H / (2 tan(φ/2)).
    let p = shown.snapshot.views[FIRST].pose.inverse() * at;
    let optical = Vector3::new(p.y, -p.z, -p.x);
    let focal = 960.0 / (2.0 * 0.25_f64.tan());
    near(f64::from(columns[0] + columns[1] + 1) / 2.0, focal * optical.x / optical.z + 640.0, 1.0, "column");
    near(f64::from(rows[0] + rows[1] + 1) / 2.0, focal * optical.y / optical.z + 480.0, 1.0, "row");
}

#[test]
fn row_17_a_ball_stays_round() {
    let ball = "BODY Ball:\n  name: Ball\n  mass: 0.0\n  shape: Sphere\n  geometry: {radius: 0.2}\n".to_owned();
    for (width, height) in [(640, 480), (960, 480), (300, 480)] {
        let (columns, rows, _) =
            extent(&drawn(&mut shown("row_17", &world("", ""), std::slice::from_ref(&ball)), width, height));
        near(width_of(columns), width_of(rows), 1.0, "round");
    }
}

#[test]
fn row_23_rows_and_columns_and_channels_are_in_order() {
    let body =
        block("Box", [0.0, -0.3, 0.2], [0.1; 3], &MATT.replace("{r: 0.8, g: 0.8, b: 0.8}", "{r: 1.0, g: 0.0, b: 0.0}"));
    let picture = drawn(&mut shown("row_23", &world("", ""), &[body]), 640, 480);
    let (columns, rows, _) = extent(&picture);
    assert!(columns[1] < 320 && rows[1] < 240, "upper left: {columns:?} {rows:?}");
    let [r, g, b] = pixel(&picture, (columns[0] + columns[1]) / 2, (rows[0] + rows[1]) / 2);
    assert!(r > 100 && g == 0 && b == 0, "red: {:?}", [r, g, b]);
}

#[test]
fn row_25_depth_is_along_the_axis() {
    let body = block("Wall", [0.0, 0.0, 0.0], [1.0, 9.0, 9.0], GREY);
    let picture = drawn(&mut shown("row_25", &world("", ""), &[body]), 640, 480);
    assert_eq!(picture.depth.len(), 640 * 480);
    for &depth in &picture.depth {
        near(f64::from(depth), 1.5, 1.5e-3, "everywhere, corners included");
    }
    for point in picture.points() {
        near(f64::from(point[0]), -1.5, 1.5e-3, "x");
    }
}

#[test]
fn rows_26_and_27_nothing_lies_on_the_far_plane() {
    let picture = drawn(&mut shown("row_26", &world("", ""), &[]), 64, 48);
    let points = picture.points();
    assert_eq!(points.len(), 64 * 48);
    assert!(points.iter().all(|point| (point[0] + 10.0).abs() < 1e-4 && point.iter().all(|x| x.is_finite())));
    assert!(points[0][1] < 0.0 && points[0][2] < 0.0, "the first point is the lower left one: {:?}", points[0]);
}

#[test]
fn row_30_transparent_before_opaque() {
    let light = "location: {x: 8.0, y: 0.0, z: 0.0}\ndirection: {x: -1.0, y: 0.0, z: 0.0}\nspot exponent: 0.0";
    let glass = "color components:\n  ambient: {level: 0.0}\n  diffuse: {r: 1.0, g: 0.0, b: 0.0}\n  specular: {r: 0.0, g: 0.0, b: 0.0}\n  transparency: 0.5";
    let solid = "color components:\n  ambient: {level: 0.0}\n  diffuse: {r: 0.0, g: 0.0, b: 1.0}\n  specular: {r: 0.0, g: 0.0, b: 0.0}\n  transparency: 1.0";
    // A thin sheet, so that its walls are hardly apart.
    let bodies =
        [block("Glass", [0.5, 0.0, 0.0], [0.002, 0.4, 0.4], glass), block("Solid", [0.0; 3], [0.2, 2.0, 2.0], solid)];
    for order in [[0, 1], [1, 0]] {
        let bodies = order.map(|index: usize| bodies[index].clone());
        let picture = drawn(&mut shown("row_30", &world("", light), &bodies), 640, 480);
        let [r, _, b] = pixel(&picture, 320, 240);
        let alone = pixel(&picture, 320, 40)[2];
        // Two walls of the sheet are seen, of which the nearer one is lit; each covers half of what is behind.
        near(f64::from(b), 0.25 * f64::from(alone), 4.0, "what is behind shows through both walls");
        assert!(r > 80, "the sheet is seen: {r}");
        near(f64::from(picture.depth[240 * 640 + 320]), 1.9, 2e-3, "depth is that of what is opaque");
    }
}

/// Floor at z = −1 seen from above, with a light above it that shines down.
fn floor_world(light: &str) -> String {
    world("", &format!("direction: {{x: 0.0, y: 0.0, z: -1.0}}\n{light}"))
        .replace(
            "location: {x: 2.0, y: 0.0, z: 0.0}\n  look at: {x: 0.0, y: 0.0, z: 0.0}",
            "location: {x: 0.0, y: 0.0, z: 5.0}\n  look at: {x: 0.0, y: 0.0, z: -1.0}",
        )
        .replace("up: {x: 0.0, y: 0.0, z: 1.0}", "up: {x: 0.0, y: 1.0, z: 0.0}")
}

const MATT: &str = "color components:\n  ambient: {level: 0.5}\n  diffuse: {r: 0.8, g: 0.8, b: 0.8}\n  specular: {r: 0.0, g: 0.0, b: 0.0}\n  transparency: 1.0";

fn floor() -> String {
    block("Floor", [0.0, 0.0, -1.5], [20.0, 20.0, 1.0], MATT)
}

/// Radius of the bright disc around the middle, in m on the floor at 6 m distance.
fn disc(picture: &Picture) -> f64 {
    let middle = pixel(picture, 320, 240)[0];
    let dark = pixel(picture, 5, 240)[0];
    let threshold = (u32::from(middle) + u32::from(dark)) / 2;
    let lit = (320..640).take_while(|&column| u32::from(pixel(picture, column, 240)[0]) > threshold).count();
    lit as f64 * 6.0 * 2.0 * 0.25_f64.tan() / 480.0
}

#[test]
fn rows_31_and_32_spots() {
    for exponent in [0.0, 50.0] {
        let light = format!(
            "location: {{x: 0.0, y: 0.0, z: 1.0}}\ncutoff angle: 0.3\nspot exponent: {exponent}\nshadow quality: 0"
        );
        let picture = drawn(&mut shown("row_31", &floor_world(&light), &[floor()]), 640, 480);
        let outside = pixel(&picture, 5, 240);
        is_color(outside, [0.2 * 0.4; 3], "outside: global ambient");
        let middle = 0.2 * 0.4 + 0.4 * 0.4 + 0.7 * 0.8;
        is_color(pixel(&picture, 320, 240), [middle; 3], "in the middle");
        if exponent == 0.0 {
            near(disc(&picture), 2.0 * 0.3_f64.tan(), 0.02, "radius");
        } else {
            // Half way to the rim.
            let angle = 0.15_f64;
            let scale = angle.cos().powf(50.0);
            let expected = 0.2 * 0.4 + scale * (0.4 * 0.4 + angle.cos() * 0.7 * 0.8);
            let column = 320.0 + 2.0 * angle.tan() * 480.0 / (6.0 * 2.0 * 0.25_f64.tan());
            is_color(pixel(&picture, column as u32, 240), [expected; 3], "fall-off");
        }
    }
}

#[test]
fn row_33_attenuation() {
    let light = |height: f64| {
        let light = format!(
            "location: {{x: 0.0, y: 0.0, z: {}}}\nattenuation: {{constant: 1.0, quadratic: 1.0}}",
            height - 1.0
        );
        let picture = drawn(&mut shown("row_33", &floor_world(&light), &[floor()]), 640, 480);
        f64::from(pixel(&picture, 320, 240)[0]) - 255.0 * 0.2 * 0.4
    };
    near(light(1.0) / light(2.0), 2.5, 0.1, "(1/2) : (1/5)");
}

#[test]
fn row_35_nine_lights() {
    let mut world = floor_world("location: {x: 0.0, y: 0.0, z: 1.0}\ncutoff angle: 0.1");
    let names: Vec<String> = (1..=9).map(|i| format!("light{i}")).collect();
    world = world.replace("lights: [light1]", &format!("lights: [{}]", names.join(", ")));
    for name in &names[1..] {
        world += &format!("{name}:\n  name: {name}\n  location: {{x: 3.0, y: 0.0, z: 1.0}}\n  direction: {{x: 0.0, y: 0.0, z: -1.0}}\n  cutoff angle: 0.1\n");
    }
    let mut shown = shown("row_35", &world, &[floor()]);
    let mut renderer = renderer();
    let first = shown.picture(&mut renderer, FIRST, &PictureRequest::color(64, 48));
    let said = |picture: &Picture| picture.messages.iter().filter(|message| message.contains("lights")).count();
    assert_eq!(said(&first), 1, "{:?}", first.messages);
    assert_eq!(said(&shown.picture(&mut renderer, FIRST, &PictureRequest::color(64, 48))), 0, "said once");
}

#[test]
fn rows_36_and_37_shadows() {
    for (quality, floor_at) in [(0, -1.0), (3, -1.0), (3, -11.0)] {
        let light = format!("location: {{x: 0.0, y: 0.0, z: 1.0}}\nspot exponent: 0.0\nshadow quality: {quality}");
        let world = floor_world(&light).replace("far: 10.0", "far: 40.0").replace("z: 5.0}", "z: 8.0}");
        // The shadow of a box beside the line of sight reaches beyond the box.
        let bodies = [
            block("Floor", [0.0, 0.0, floor_at - 0.5], [40.0, 40.0, 1.0], MATT),
            block("Box", [0.0, 0.0, 0.0], [0.4; 3], MATT),
        ];
        let picture = drawn(&mut shown("row_36", &world, &bodies), 640, 480);
        // On the floor, 0.8 of the way to the edge of the shadow: edge at 0.2 / (1 − 0.2) per metre below the light.
        let below = 1.0 - floor_at;
        let at = 0.8 * 0.25 * below;
        let focal = 480.0 / (2.0 * 0.25_f64.tan());
        let column = 320.0 + focal * at / (8.0 - floor_at);
        let nl = below / below.hypot(at);
        let lit = if quality == 0 { 1.0 } else { 0.3 };
        let expected = 0.2 * 0.4 + 0.4 * 0.4 + lit * nl * 0.7 * 0.8;
        is_color(
            pixel(&picture, column as u32, 240),
            [expected; 3],
            &format!("quality {quality}, floor at {floor_at}"),
        );
    }
}

/// The geometry of the first lights is interpolated between vertices, that of others computed at each pixel.
#[test]
fn the_order_of_lights_does_not_matter() {
    let keys = [
        "location: {x: 0.5, y: 0.3, z: 1.0}\nspot exponent: 3\ncutoff angle: 0.7\nshadow quality: 3",
        "location: {x: -0.6, y: 0.2, z: 1.5}\nattenuation: {constant: 0.5, linear: 0.2}\ncutoff angle: 1.5707963267948966\nshadow quality: 2",
        "location: {x: 0.1, y: -0.7, z: 2.0}\nspot exponent: 0\ncutoff angle: 0.4\nshadow quality: 0",
        "location: {x: -0.4, y: -0.5, z: 1.2}\nspot exponent: 20\ncutoff angle: 0.9\nshadow quality: 4",
    ];
    // A plain material, one with highlights of any shininess, and a physically based one.
    let shiny = "color components:\n  ambient: {level: 0.5}\n  diffuse: {r: 0.3, g: 0.1, b: 0.1}\n  specular: {r: 0.9, g: 0.9, b: 0.9}\n\
                 \x20 shininess: 50\n  transparency: 1.0";
    let physical = "color components:\n  diffuse: {r: 0.3, g: 0.1, b: 0.1}\n  metallic: 0.5\n  roughness: 0.4\n  transparency: 1.0";
    let bodies = [
        floor(),
        block("Box", [0.2, 0.1, -0.5], [0.2, 0.3, 0.4], shiny),
        block("Other", [-0.4, 0.1, -0.5], [0.2, 0.3, 0.4], physical),
    ];
    let pictures = [[0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]].map(|order| {
        let mut world = floor_world(keys[order[0]]).replace("lights: [light1]", "lights: [light1, b, c, d]");
        for (name, keys) in ["b", "c", "d"].iter().zip(&order[1..]).map(|(name, &index)| (name, keys[index])) {
            world +=
                &format!("{name}:\n  name: {name}\n{}", indented(&format!("direction: {{x: 0, y: 0, z: -1}}\n{keys}")));
        }
        drawn(&mut shown("order_of_lights", &world, &bodies), 320, 240)
    });
    keep(&pictures[0], "order_of_lights.png");
    for other in &pictures[1..] {
        let differs = |(a, b): &(&u8, &u8)| a.abs_diff(**b) > 2;
        let count = pictures[0].color.iter().zip(&other.color).filter(differs).count();
        assert_eq!(count, 0, "numbers of the pictures that differ by more than rounding");
    }
}

/// Only a part of a shadow map is stored and drawn anew: it must be the right one.
#[test]
fn rows_36_and_37_shadows_follow_bodies() {
    let light = "location: {x: 0.0, y: 0.0, z: 3.0}\nspot exponent: 0.0\nshadow quality: 3";
    let world = floor_world(light).replace("far: 10.0", "far: 40.0").replace("z: 5.0}", "z: 8.0}");
    let plane =
        "BODY Floor:\n  name: Floor\n  mass: 0.0\n  location: {position: {x: 0, y: 0, z: -1}}\n  shape: Plane\n\
                 \x20 geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}\n";
    let bodies = [
        format!("{plane}{}", indented(MATT)),
        block("Box", [0.0; 3], [0.2; 3], MATT),
        block("Other", [0.5, 0.5, 0.0], [0.1; 3], MATT),
    ];
    let mut shown = shown("rows_36_and_37", &world, &bodies);
    let request = PictureRequest::color(320, 240);
    let mut kept = renderer();
    let mut pictures: Vec<Picture> = Vec::new();
    // Aside, beside the light's cone, near the light, behind the light, and back; then the light moves aside.
    let places = [
        ([0.0, 0.0, 0.0], 0.0),
        ([0.3, -0.4, 0.0], 0.0),
        ([30.0, 0.0, 0.0], 0.0),
        ([0.1, 0.0, 2.7], 0.0),
        ([0.0, 0.0, 5.0], 0.0),
        ([0.0, 0.0, 0.0], 0.0),
        ([0.0, 0.0, 0.0], 0.4),
    ];
    for (place, light) in places {
        shown.snapshot.bodies[BodyId::new(1)].origin = place;
        shown.snapshot.spots[LightId::new(0)].pose.translation.x = light;
        let picture = shown.picture(&mut kept, FIRST, &request);
        let stage = std::mem::take(&mut shown.stage);
        let fresh = shown.picture(&mut renderer(), FIRST, &request);
        shown.stage = stage;
        assert!(picture.color == fresh.color, "the box is at {place:?}");
        assert!(pictures.last().is_none_or(|last| last.color != picture.color), "the box at {place:?} is seen");
        pictures.push(picture);
    }
    assert!(pictures[0].color == pictures[5].color, "nothing is left of what was");
    let dark = |picture: &Picture| picture.color.iter().map(|&level| 255 - usize::from(level)).sum::<usize>();
    assert!(dark(&pictures[2]) < dark(&pictures[0]), "a box that is away casts no shadow here");
}

#[test]
fn row_38_colours_under_one_light() {
    let white = "color components:\n  ambient: {level: 0.4}\n  diffuse: {r: 1.0, g: 1.0, b: 1.0}\n  specular: {r: 0.0, g: 0.0, b: 0.0}\n  transparency: 1.0";
    let world = floor_world("location: {x: 0.0, y: 0.0, z: 1.0}\nspot exponent: 0.0");
    let body = block("Floor", [0.0, 0.0, -1.5], [20.0, 20.0, 1.0], white);
    let picture = drawn(&mut shown("row_38", &world, &[body]), 640, 480);
    is_color(pixel(&picture, 320, 240), [0.2 * 0.4 + 0.4 * 0.4 + 0.7; 3], "sum of the parts");
}

#[test]
fn row_39_colour_and_its_ambient_half() {
    let light = "location: {x: -8.0, y: 0.0, z: 0.0}\ndirection: {x: -1.0, y: 0.0, z: 0.0}";
    let picture = drawn(&mut shown("row_39", &world("", light), &[block("Box", [0.0; 3], [0.3; 3], RED)]), 640, 480);
    is_color(pixel(&picture, 320, 240), [0.2 * 0.5, 0.0, 0.0], "not reached by light: 0.2 of half of the colour");
}

#[test]
fn row_40_emission() {
    let light = "location: {x: -8.0, y: 0.0, z: 0.0}\ndirection: {x: -1.0, y: 0.0, z: 0.0}";
    let glow = "color components:\n  ambient: {level: 0.5}\n  diffuse: {r: 0.4, g: 0.4, b: 0.4}\n  specular: {r: 0.0, g: 0.0, b: 0.0}\n  emission: {r: 0.0, g: 1.0, b: 0.0}\n  transparency: 1.0";
    let picture = drawn(&mut shown("row_40", &world("", light), &[block("Box", [0.0; 3], [0.3; 3], glow)]), 640, 480);
    let ambient = 0.2 * 0.5 * 0.4;
    is_color(pixel(&picture, 320, 240), [ambient, 1.0, ambient], "green shines by itself");
}

#[test]
fn physically_based_materials_reflect_as_the_model_says() {
    let light = "location: {x: 2.0, y: 0.0, z: 0.0}\ndirection: {x: -1.0, y: 0.0, z: 0.0}";
    for (diffuse, metallic, roughness) in
        [([0.8, 0.5, 0.2], 0.0, 1.0), ([0.9, 0.6, 0.3], 1.0, 0.6), ([0.5; 3], 0.5, 0.8)]
    {
        let [r, g, b] = diffuse;
        let material = format!(
            "color components: {{transparency: 1, diffuse: {{r: {r}, g: {g}, b: {b}}}, metallic: {metallic}, roughness: {roughness}}}"
        );
        let body = block("Box", [0.0; 3], [0.3; 3], &material);
        let picture = drawn(&mut shown("physical", &world("", light), &[body]), 640, 480);
        // Surface, light and eye face each other: all cosines are 1, and the sky is half as bright as at the zenith and
        // at the nadir.
        let expected = diffuse.map(|displayed: f64| {
            let base = displayed.powf(2.2);
            let (matt, f0) = ((1.0 - metallic) * base, 0.04 * (1.0 - metallic) + metallic * base);
            let alpha = roughness * roughness;
            // Distribution times visibility times π.
            let microfacets = 0.25 / (alpha * alpha);
            let reflected = 0.9 * ((1.0 - f0) * matt + microfacets * f0) + 0.65 * (0.12 * matt + 0.4 * f0);
            reflected.min(1.0).powf(1.0 / 2.2)
        });
        is_color(pixel(&picture, 320, 240), expected, &material);
    }
}

#[test]
fn row_41_invisible() {
    for color in ["", GREY] {
        let body = block("Box", [0.0; 3], [0.2; 3], &format!("visible: false\n{color}"));
        let (.., count) = extent(&drawn(&mut shown("row_41", &world("", ""), &[body]), 640, 480));
        assert_eq!(count, 0, "with `{color}`");
    }
}

/// Writes an OBJ file of a square in the y–z plane, seen from +x, with texture coordinates from its lower left corner.
fn square(directory: &Path, material: &str) -> PathBuf {
    std::fs::create_dir_all(directory.join("textures")).expect("a directory");
    std::fs::write(directory.join("square.mtl"), material).expect("a file");
    let path = directory.join("square.obj");
    let text = "mtllib square.mtl\nv 0 -0.4 -0.4\nv 0 0.4 -0.4\nv 0 0.4 0.4\nv 0 -0.4 0.4\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3 4/4\n";
    std::fs::write(&path, text).expect("a file");
    path
}

#[test]
fn row_43_textures_stand_upright() {
    let place = directory("row_43");
    square(&place, "newmtl m\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd textures/corner.png\n");
    // Red in the lower left quarter, else white; the first row of a file is the top.
    let texture =
        image::RgbImage::from_fn(64, 64, |x, y| image::Rgb(if x < 32 && y >= 32 { [255, 0, 0] } else { [255; 3] }));
    texture.save(place.join("textures/corner.png")).expect("a file");
    let body = "BODY Square:\n  name: Square\n  mass: 0.0\n  mesh: square.obj\n";
    let text = format!("namespace: /test/\nhigh resolution path: ./\nlow resolution path: ./\nbodies: [BODY Square]\njoints: []\n{body}");
    let mut shown = Shown::of_texts(&place, &world("", ""), &text);
    let picture = drawn(&mut shown, 640, 480);
    let [r, g, b] = pixel(&picture, 250, 310);
    assert!(r > 60 && g < 5 && b < 5, "lower left is red: {:?}", [r, g, b]);
    for (column, row) in [(390, 310), (250, 170), (390, 170)] {
        let [r, g, b] = pixel(&picture, column, row);
        assert!(r > 60 && r.abs_diff(g) < 3 && g.abs_diff(b) < 3, "white at {column} {row}: {:?}", [r, g, b]);
    }
}

/// A scene that shows the mesh file `mesh` of a folder.
fn shown_mesh(place: &Path, mesh: &str) -> Shown {
    let body = format!("BODY Square:\n  name: Square\n  mass: 0.0\n  mesh: {mesh}\n");
    let text = format!("namespace: /test/\nhigh resolution path: ./\nlow resolution path: ./\nbodies: [BODY Square]\njoints: []\n{body}");
    Shown::of_texts(place, &world("", ""), &text)
}

/// Backs of triangles are left out where nobody sees them. A box of 0.8 m as a file, with and without the face towards the
/// camera.
#[test]
fn the_inside_of_an_open_mesh_is_seen() {
    let place = directory("open_mesh");
    std::fs::create_dir_all(&place).expect("a directory");
    let vertices: String = (0..8)
        .map(|vertex: u8| [2, 1, 0].map(|bit| if vertex >> bit & 1 == 0 { -0.4 } else { 0.4 }))
        .map(|[x, y, z]| format!("v {x} {y} {z}\n"))
        .collect();
    // Vertex 1 + 4 x + 2 y + z; the last face is at +x.
    let faces = ["1 2 4 3", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4", "5 7 8 6"].map(|face| format!("f {face}\n"));
    let depth = |name: &str, faces: &[String], at: f64| {
        std::fs::write(place.join(name), format!("{vertices}{}", faces.concat())).expect("a file");
        let mut shown = shown_mesh(&place, name);
        shown.snapshot.bodies[BodyId::new(0)].origin[0] = at;
        let picture = drawn(&mut shown, 64, 48);
        assert!(pixel(&picture, 32, 24)[0] < 250, "{name} is seen");
        f64::from(picture.depth[24 * 64 + 32])
    };
    near(depth("closed.obj", &faces, 0.0), 1.6, 1e-3, "front of a closed box");
    near(depth("open.obj", &faces[..5], 0.0), 2.4, 1e-3, "back wall of an open box");
    near(depth("closed.obj", &faces, 2.0), 0.4, 1e-3, "wall of a closed box around the camera");
}

#[test]
fn colours_of_vertices_multiply_the_light() {
    let place = directory("colours");
    std::fs::create_dir_all(&place).expect("a directory");
    // A square in the y–z plane, seen from +x: green at the left edge, red at the right one.
    let header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
                  property uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let vertices = "0 -0.4 -0.4 0 255 0\n0 0.4 -0.4 255 0 0\n0 0.4 0.4 255 0 0\n0 -0.4 0.4 0 255 0\n4 0 1 2 3\n";
    std::fs::write(place.join("square.ply"), format!("{header}{vertices}")).expect("a file");
    let picture = drawn(&mut shown_mesh(&place, "square.ply"), 640, 480);
    let [left, middle, right] = [140, 320, 500].map(|column| pixel(&picture, column, 240));
    assert!(left[1] > 3 * left[0] && left[2] < 5, "{left:?}");
    assert!(right[0] > 3 * right[1] && right[2] < 5, "{right:?}");
    assert!(middle[0].abs_diff(middle[1]) < 10 && middle[0] > 40, "{middle:?}");
}

#[test]
fn a_gltf_file_brings_its_materials_and_pictures() {
    use base64::Engine;
    let place = directory("gltf");
    std::fs::create_dir_all(&place).expect("a directory");
    // The upper half is blue, the lower one white; the first row of a picture is the top.
    let picture = image::RgbImage::from_fn(8, 8, |_, y| image::Rgb(if y < 4 { [0, 0, 255] } else { [255; 3] }));
    let mut png = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut png, image::ImageFormat::Png).expect("a picture");
    // glTF's axes: x to the right of the camera at +x of ours would be our y; up is y. Corners and their texture
    // coordinates, v downwards.
    let corners = [[0.0, -0.4, 0.4], [0.0, -0.4, -0.4], [0.0, 0.4, -0.4], [0.0, 0.4, 0.4_f32]];
    let coordinates = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0_f32]];
    let mut bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend(coordinates.iter().flatten().flat_map(|x| x.to_le_bytes()));
    bytes.extend([0, 1, 2, 0, 2, 3_u16].iter().flat_map(|i| i.to_le_bytes()));
    let encode = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
    let text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}}]}}],
"materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}},"metallicFactor":0,"roughnessFactor":1}}}}],
"textures":[{{"source":0}}],"images":[{{"uri":"data:image/png;base64,{}"}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,-0.4,-0.4],"max":[0,0.4,0.4]}},
{{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}},{{"bufferView":2,"componentType":5123,"count":6,"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":32}},{{"buffer":0,"byteOffset":80,"byteLength":12}}],
"buffers":[{{"byteLength":92,"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        encode(png.get_ref()),
        encode(&bytes)
    );
    std::fs::write(place.join("square.gltf"), text).expect("a file");
    let picture = drawn(&mut shown_mesh(&place, "square.gltf"), 640, 480);
    let (upper, lower) = (pixel(&picture, 320, 150), pixel(&picture, 320, 330));
    assert!(upper[2] > 100 && upper[0] < 80 && upper[0] < upper[2] / 2, "{upper:?}");
    assert!(lower[0] > 100 && lower[0].abs_diff(lower[2]) < 3, "{lower:?}");
}

#[test]
fn row_47_the_mesh_is_at_the_body_frame() {
    let offset = "inertial offset:\n  position: {x: 0.0, y: 0.5, z: 0.0}\n  orientation: {r: 0, p: 0, y: 0}";
    let body = block("Box", [0.0; 3], [0.2; 3], &format!("{GREY}\n{offset}"));
    let (columns, ..) = extent(&drawn(&mut shown("row_47", &world("", ""), &[body]), 640, 480));
    near(f64::from(columns[0] + columns[1] + 1) / 2.0, 320.0, 1.0, "in the middle");
}

#[test]
fn rows_48_and_49_the_sky() {
    let place = directory("row_48");
    std::fs::create_dir_all(&place).expect("a directory");
    let colors = [
        ("front", [255, 0, 0]),
        ("back", [0, 255, 0]),
        ("left", [0, 0, 255]),
        ("right", [255, 255, 0]),
        ("top", [0, 255, 255]),
        ("bottom", [255, 0, 255]),
    ];
    for (name, color) in colors {
        // The upper half is darker, and its left part black.
        let picture = image::RgbImage::from_fn(64, 64, |x, y| {
            image::Rgb(if y < 32 && x < 32 {
                [0; 3]
            } else if y < 32 {
                color.map(|c| c / 2)
            } else {
                color
            })
        });
        picture.save(place.join(format!("{name}.png"))).expect("a file");
    }
    let sky = "skybox:\n  path: ./\n  right: right.png\n  left: left.png\n  top: top.png\n  bottom: bottom.png\n  front: front.png\n  back: back.png\n";
    let looks = [
        ([1.0, 0.0, 0.0], 0),
        ([-1.0, 0.0, 0.0], 1),
        ([0.0, 1.0, 0.0], 2),
        ([0.0, -1.0, 0.0], 3),
        ([0.0, 0.0, 1.0], 4),
        ([0.0, 0.0, -1.0], 5),
    ];
    // A user's program, which swaps red and blue.
    std::fs::write(place.join("sky.vs"), SKY_VERTEX).expect("a file");
    std::fs::write(place.join("sky.fs"), SKY_FRAGMENT).expect("a file");
    let own = format!("{sky}  shaders: {{path: ./, vertex: sky.vs, fragment: sky.fs}}\n");
    let mut renderer = renderer();
    for (([x, y, z], face), sky) in looks.into_iter().flat_map(|look| [(look, sky), (look, own.as_str())]) {
        // For looking up and down, up of the picture is what joins the front picture: −x, +x.
        let up = match z as i32 {
            1 => "{x: -1.0, y: 0.0, z: 0.0}",
            -1 => "{x: 1.0, y: 0.0, z: 0.0}",
            _ => "{x: 0.0, y: 0.0, z: 1.0}",
        };
        let world = format!("{sky}{}", world("", ""))
            .replace("look at: {x: 0.0, y: 0.0, z: 0.0}", &format!("look at: {{x: {}, y: {y:?}, z: {z:?}}}", 2.0 + x))
            .replace("up: {x: 0.0, y: 0.0, z: 1.0}", &format!("up: {up}"));
        let mut shown = Shown::of_texts(&place, &world, &model(&[]));
        let picture = shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480));
        assert_eq!(picture.messages, [] as [String; 0]);
        let mut color = colors[face].1;
        if sky == own {
            color.swap(0, 2);
        }
        assert_eq!(pixel(&picture, 400, 350), color, "{}: below", colors[face].0);
        assert_eq!(pixel(&picture, 400, 100), color.map(|c| c / 2), "{}: upright", colors[face].0);
        assert_eq!(pixel(&picture, 200, 100), [0; 3], "{}: not mirrored", colors[face].0);
    }
    let world = format!("{}{}", sky.replace("left.png", "absent.png"), world("", ""));
    let mut shown = Shown::of_texts(&place, &world, &model(&[]));
    let picture = shown.picture(&mut renderer, FIRST, &PictureRequest::color(64, 48));
    assert!(picture.messages.iter().any(|message| message.contains("absent.png")), "{:?}", picture.messages);
    assert!(picture.color.iter().all(|&level| level == 255), "white instead");
}

const SKY_VERTEX: &str =
    "attribute vec3 aPosition; uniform mat4 viewMat; uniform mat4 projectionMat; varying vec3 place;\n\
    void main() { place = aPosition; gl_Position = (projectionMat * viewMat * vec4(aPosition, 1.0)).xyww; }\n";

const SKY_FRAGMENT: &str = "varying vec3 place; uniform samplerCube skybox;\n\
    void main() { gl_FragColor = textureCube(skybox, place).bgra; }\n";

const MASK_VERTEX: &str =
    "attribute vec3 aPosition;\nvoid main() { gl_Position = gl_ModelViewProjectionMatrix * vec4(aPosition, 1.0); }\n";
const MASK_FRAGMENT: &str = "void main() { gl_FragColor = vec4(gl_FrontLightProduct[0].diffuse.rgb, 1.0); }\n";

#[test]
fn row_50_masks() {
    let place = directory("row_50");
    std::fs::create_dir_all(&place).expect("a directory");
    std::fs::write(place.join("mask.vs"), MASK_VERTEX).expect("a file");
    std::fs::write(place.join("mask.fs"), MASK_FRAGMENT).expect("a file");
    let orange = "color components:\n  ambient: {level: 0.5}\n  diffuse: {r: 1.0, g: 0.5, b: 0.0}\n  specular: {r: 1.0, g: 1.0, b: 1.0}\n  transparency: 0.5";
    let bodies = [block("Box", [0.0, 0.1, 0.0], [0.2; 3], orange), block("Other", [0.0, -0.2, 0.1], [0.15; 3], orange)];
    for file in ["mask", "absent"] {
        let shaders = format!("preprocessing shaders:\n  path: ./\n  vertex: {file}.vs\n  fragment: {file}.fs");
        let mut shown = Shown::of_texts(&place, &world(&shaders, ""), &model(&bodies));
        let preprocessing = shown.visuals.cameras[FIRST].description.preprocessing_shaders.clone();
        assert!(preprocessing.is_some());
        let request = PictureRequest { preprocessing, samples: 4, ..PictureRequest::color(640, 480) };
        let mut renderer = renderer();
        let picture = shown.picture(&mut renderer, FIRST, &request);
        let mut masked = 0;
        for pixel in picture.color.chunks_exact(3) {
            let is_mask = pixel.iter().zip([179_u8, 89, 0]).all(|(&got, expected)| got.abs_diff(expected) <= 1);
            assert!(is_mask || pixel == [255; 3], "no other colours: {pixel:?}");
            masked += usize::from(is_mask);
        }
        assert!(masked > 1000, "{masked}");
        // The bodies are transparent otherwise; as masks they are opaque.
        let said = picture.messages.iter().filter(|message| message.contains("absent.vs")).count();
        assert_eq!(said, usize::from(file == "absent"), "{:?}", picture.messages);
        let plain = shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480));
        assert_ne!(plain.color, picture.color, "the window is as ever");
    }
}

#[test]
fn row_51_shaders_that_do_not_compile() {
    let place = directory("row_51");
    std::fs::create_dir_all(&place).expect("a directory");
    std::fs::write(place.join("bad.vs"), MASK_VERTEX).expect("a file");
    std::fs::write(place.join("bad.fs"), "void main() { gl_FragColor = nonsense; }\n").expect("a file");
    std::fs::write(place.join("good.fs"), "void main() { gl_FragColor = vec4(0.0, 1.0, 0.0, 1.0); }\n")
        .expect("a file");
    let bodies = [block("Box", [0.0; 3], [0.2; 3], RED)];
    for fragment in ["bad.fs", "good.fs"] {
        let shaders = format!("shaders:\n  path: ./\n  vertex: bad.vs\n  fragment: {fragment}\n{}", world("", ""));
        let mut shown = Shown::of_texts(&place, &shaders, &model(&bodies));
        let picture = shown.picture(&mut renderer(), FIRST, &PictureRequest::color(640, 480));
        let [r, g, _] = pixel(&picture, 320, 240);
        if fragment == "good.fs" {
            assert_eq!([r, g], [0, 255], "the user's program draws; {:?}", picture.messages);
        } else {
            assert!(picture.messages.iter().any(|message| message.contains("bad.fs")), "{:?}", picture.messages);
            assert!(r > 50 && g < 5, "drawn all the same: {r} {g}");
        }
    }
}

/// Drivers of NVIDIA take `texture` in shaders without `#version`, and three coordinates for a picture of two; scenes are
/// written for them. Such shaders were rejected, and the built-in material was drawn.
#[test]
fn row_51_shaders_that_only_some_drivers_take() {
    let place = directory("row_51_lenient");
    std::fs::create_dir_all(&place).expect("a directory");
    std::fs::write(place.join("any.vs"), MASK_VERTEX).expect("a file");
    let heads = ["", "#version 120\n", "#version 130\n", "#extension GL_ARB_texture_rectangle : enable\n"];
    let calls =
        ["texture(map, vec3(0.5))", "texture(map, vec2(0.5))", "texture(map, vec3(0.5)) + texture(map, vec2(0.1))"];
    let bodies = [block("Box", [0.0; 3], [0.2; 3], RED)];
    for head in heads {
        for call in calls {
            let fragment = format!(
                "{head}uniform sampler2D map;\nvoid main() {{ gl_FragColor = vec4(0.0, 1.0, 0.0, 1.0) + 0.0 * ({call}); }}\n"
            );
            std::fs::write(place.join("lenient.fs"), fragment).expect("a file");
            let shaders = format!("shaders:\n  path: ./\n  vertex: any.vs\n  fragment: lenient.fs\n{}", world("", ""));
            let mut shown = Shown::of_texts(&place, &shaders, &model(&bodies));
            let picture = shown.picture(&mut renderer(), FIRST, &PictureRequest::color(640, 480));
            let [r, g, _] = pixel(&picture, 320, 240);
            assert_eq!([r, g], [0, 255], "{head:?}, {call}: {:?}", picture.messages);
        }
    }
}

#[test]
fn row_54_frames() {
    let mut shown = shown("row_54", &world("", ""), &[block("Box", [0.0; 3], [0.2; 3], MATT)]);
    shown.stage.own_frames.insert(
        shown
            .visuals
            .bodies
            .iter()
            .find(|body| &*body.object.name == "Box")
            .expect("a box")
            .object
            .identifier
            .to_string(),
    );
    let mut renderer = renderer();
    let colors = |picture: &Picture| {
        let has = |test: fn(&[u8]) -> bool| picture.color.chunks_exact(3).any(test);
        (has(|p| p[1] > 60 && p[0] < 30 && p[2] < 30), has(|p| p[2] > 60 && p[0] < 30 && p[1] < 30))
    };
    let one = shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480));
    assert_eq!(colors(&one), (true, true), "green y and blue z of the body that was picked");
    // With all frames on, that one is off; those of camera and light are out of sight or end on.
    shown.stage.own_frames.clear();
    shown.stage.frames = true;
    let all = shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480));
    assert_eq!(colors(&all), (true, true));
    shown.stage.frames = false;
    let none = shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480));
    assert_eq!(colors(&none), (false, false));
}

#[test]
fn row_53_points() {
    let mut shown = shown("row_53", &world("", ""), &[]);
    let mut renderer = renderer();
    for size in [10.0, 3.0] {
        shown.stage.markers = vec![ambf_render::Marker {
            shape: ambf_render::MarkerShape::Points(vec![[0.0; 3]], size),
            pose: Isometry3::translation(0.0, 0.2, 0.0),
            color: [0.0, 0.0, 0.0, 1.0],
        }];
        let picture = shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480));
        let (columns, rows, count) = extent(&picture);
        assert_eq!(count, (size * size) as usize, "a square of {size} pixels");
        assert_eq!((width_of(columns), width_of(rows)), (f64::from(size), f64::from(size)));
        let focal = 480.0 / (2.0 * 0.25_f64.tan());
        near(f64::from(columns[0] + columns[1] + 1) / 2.0, 320.0 + focal * 0.1, 1.0, "where its pose says");
    }
}

/// A shipped scene, in its own world.
fn shipped(model: &str) -> Shown {
    let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
    Shown::of_files(Some(&resources.join("world/world.yaml")), &[&resources.join("models").join(model)])
}

fn count(picture: &Picture, test: impl Fn(&[u8]) -> bool) -> usize {
    picture.color.chunks_exact(3).filter(|pixel| test(pixel)).count()
}

#[test]
fn row_52_cloth_follows_its_nodes() {
    let mut shown = shipped("cloth.yaml");
    let mut renderer = renderer();
    let cloth = shown.visuals.soft_bodies[SoftBodyId::new(0)].object.identifier.to_string();
    let request = PictureRequest { ids: true, ..PictureRequest::color(320, 240) };
    let mut rows = |shown: &mut Shown| {
        let picture = shown.picture(&mut renderer, FIRST, &request);
        assert!(picture.messages.is_empty(), "{:?}", picture.messages);
        let is_cloth = |id: &[u32; 2]| shown.stage.id_name(id[0]) == Some(&cloth);
        let places: Vec<usize> = (0..picture.ids.len()).filter(|&at| is_cloth(&picture.ids[at])).collect();
        assert!(places.len() > 100, "{} pixels show the cloth", places.len());
        let lit =
            places.iter().filter(|&&at| picture.color[3 * at..3 * at + 3].iter().any(|&level| level > 40)).count();
        assert_eq!(lit, places.len(), "every pixel of it is lit, whichever side is seen");
        places.iter().map(|at| at / 320).sum::<usize>() as f64 / places.len() as f64
    };
    let before = rows(&mut shown);
    for node in &mut shown.snapshot.soft_bodies[SoftBodyId::new(0)].nodes {
        node[2] -= 0.3;
    }
    shown.snapshot.sim_step += 1;
    let after = rows(&mut shown);
    assert!(after > before + 10.0, "it moves down in the picture: {before} {after}");
}

#[test]
fn rows_55_and_56_sensors_and_actuators() {
    let sensor = "sensors: [SENSOR ray]\nactuators: [ACTUATOR hold]\nSENSOR ray:\n  name: ray\n  type: Proximity\n  parent: BODY Box\n  range: 0.6\n  visible: true\n\
        \x20 visible size: 0.03\n  location: {position: {x: 0.0, y: -0.3, z: 0.2}}\n  array:\n    - {offset: {x: 0, y: 0, z: 0}, direction: {x: 0, y: 1, z: 0}}\n\
        ACTUATOR hold:\n  name: hold\n  type: Constraint\n  parent: BODY Box\n  location: {position: {x: 0.0, y: 0.0, z: -0.2}}\n  visible: true\n  visible size: 0.03\n";
    let text = model(&[block("Box", [0.0; 3], [0.05; 3], MATT)]) + sensor;
    let mut shown = Shown::of_texts(&directory("row_55"), &world("", ""), &text);
    let mut renderer = renderer();
    let is = |expected: [f64; 3]| {
        // By the ratios of the channels: markers are lit.
        move |pixel: &[u8]| {
            let level = f64::from(*pixel.iter().max().expect("a channel"));
            level > 60.0
                && pixel.iter().zip(expected).all(|(&got, wanted)| (f64::from(got) / level - wanted).abs() < 0.06)
        }
    };
    let (red, green, pink) = (is([1.0, 0.0, 0.0]), is([0.0, 1.0, 0.0]), is([1.0, 0.412, 0.706]));
    let (gold, lime) = (is([1.0, 0.843, 0.0]), is([0.0, 1.0, 0.0]));
    let request = PictureRequest::color(640, 480);

    shown.stage.sensors = Some(false);
    shown.stage.actuators = Some(false);
    let off = shown.picture(&mut renderer, FIRST, &request);
    shown.stage.sensors = Some(true);
    let on = shown.picture(&mut renderer, FIRST, &request);
    assert!(count(&on, red) > count(&off, red) && count(&on, green) > count(&off, green), "start and end of the rays");
    shown.snapshot.sensors[SensorId::new(0)][0].triggered = true;
    shown.snapshot.sensors[SensorId::new(0)][0].measurement = 0.5;
    let hit = shown.picture(&mut renderer, FIRST, &request);
    assert!(count(&hit, pink) > count(&on, pink), "a pink ball where something is hit");

    shown.stage.sensors = Some(false);
    shown.stage.actuators = Some(true);
    let rest = shown.picture(&mut renderer, FIRST, &request);
    assert!(count(&rest, gold) > count(&off, gold), "gold");
    shown.snapshot.actuators[ActuatorId::new(0)] = true;
    let holds = shown.picture(&mut renderer, FIRST, &request);
    assert!(
        count(&holds, lime) > count(&rest, lime) && count(&holds, gold) == count(&off, gold),
        "lime while it holds"
    );
}

#[test]
fn row_71_a_picture_shows_one_step() {
    // Two bodies fall side by side, stepped as fast as it goes by another thread.
    let fall = |name: &str, y: f64| {
        block(name, [0.0, y, 0.0], [0.1; 3], "")
            .replace("mass: 0.0", "mass: 1.0\n  inertia: {ix: 0.01, iy: 0.01, iz: 0.01}")
    };
    let world = world("", "").replace("z: 0}\n", "z: -9.81}\n");
    let simulation = simulation(&directory("row_71"), &world, &model(&[fall("A", -0.2), fall("B", 0.2)]));
    let mut stepper = ambf_core::sim::Stepper::new(simulation, 0.001);
    let hub = stepper.window().hub;
    let is_over = std::sync::atomic::AtomicBool::new(false);
    let relaxed = std::sync::atomic::Ordering::Relaxed;
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(relaxed) {
                stepper.step(1).expect("a step");
            }
        });
        let (mut seen, mut last) = (0, 0);
        while seen < 2000 {
            let Some(snapshot) = hub.snapshot().clone() else { continue };
            if snapshot.sim_step == last {
                continue;
            }
            (last, seen) = (snapshot.sim_step, seen + 1);
            let heights: Vec<f64> = snapshot.bodies.iter().map(|body| body.origin[2]).filter(|&z| z < 0.0).collect();
            assert!(
                heights.windows(2).all(|pair| (pair[0] - pair[1]).abs() < 1e-12),
                "torn at step {last}: {heights:?}"
            );
        }
        is_over.store(true, relaxed);
    });
}

#[test]
fn row_73_what_is_removed_is_gone() {
    let mut shown = shown("row_73", &world("", ""), &[block("Box", [0.0; 3], [0.2; 3], RED)]);
    shown.stage.frames = true;
    let mut renderer = renderer();
    assert!(extent(&shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480))).2 > 0);
    let mut visuals = (*shown.visuals).clone();
    for body in &mut visuals.bodies {
        body.object.removed = true;
    }
    visuals.cameras[FIRST].object.removed = true;
    visuals.lights[LightId::new(0)].object.removed = true;
    shown.visuals = visuals.into();
    let picture = shown.picture(&mut renderer, FIRST, &PictureRequest::color(640, 480));
    assert_eq!(extent(&picture).2, 0, "mesh and frame");
}

#[test]
fn stereo_halves_are_undistorted_and_meet_at_the_focal_length() {
    let stereo = "stereo:\n  mode: PASSIVE\n  eye separation: 0.1\n  focal length: 2.0";
    let body = block("Box", [-0.1, 0.0, 0.0], [0.2; 3], GREY);
    let mut shown = shown("stereo", &world(stereo, ""), &[body]);
    let picture = drawn(&mut shown, 1280, 480);
    let focal = 480.0 / (2.0 * 0.25_f64.tan());
    let half = |first: u32| {
        let columns: Vec<u32> =
            (first..first + 640).filter(|&column| pixel(&picture, column, 240) != [255; 3]).collect();
        (columns[0], columns[columns.len() - 1])
    };
    let (left, right) = (half(0), half(640));
    near(f64::from(left.1 - left.0 + 1), 0.2 * focal / 2.0, 1.5, "width as in a picture of one eye");
    near(f64::from(left.0 + left.1 + 1) / 2.0, 320.0, 1.0, "its front is at the focal length");
    near(f64::from(right.0 + right.1 + 1) / 2.0, 960.0, 1.0, "its front is at the focal length");
    // Points of both halves are in the frame of the camera between the eyes.
    for point in picture.points().iter().filter(|point| point[0] > -2.05) {
        assert!(point[1].abs() < 0.102 && point[2].abs() < 0.102, "{point:?}");
    }
    let count = picture.points().iter().filter(|point| point[0] > -2.05).count();
    assert!(count > 2 * 40 * 40, "{count}");
}

#[test]
fn ids_and_normals() {
    let bodies = [
        block("Box", [0.0, 0.1, 0.0], [0.2; 3], GREY),
        block("Glass", [0.0, -0.2, 0.0], [0.2; 3], "color rgba: {r: 0.5, g: 0.5, b: 0.5, a: 0.4}"),
    ];
    let mut shown = shown("ids", &world("", ""), &bodies);
    let request = PictureRequest { color: false, ids: true, normals: true, ..PictureRequest::color(640, 480) };
    let picture = shown.picture(&mut renderer(), FIRST, &request);
    assert!(picture.color.is_empty() && picture.depth.is_empty());
    let focal = 480.0 / (2.0 * 0.25_f64.tan());
    for (y, name) in [(0.1, "/test/BODY Box"), (-0.2, "/test/BODY Glass")] {
        let at = 240 * 640 + (320.0 + focal * y / 1.9) as usize;
        let [object, model] = picture.ids[at];
        assert_eq!(shown.stage.id_name(object), Some(name));
        assert_eq!(model, 2, "the environment is 1");
        let normal = Vector3::from(picture.normals[at]);
        near(f64::from((normal - Vector3::x()).norm()), 0.0, 1e-6, "towards the camera");
    }
    assert_eq!(picture.ids[0], [0, 0]);
    assert_eq!(picture.normals[0], [0.0; 3]);
}

#[test]
fn a_whole_turn_of_the_camera_never_shows_the_back() {
    // The light's disc moves along its axis (row 34), whatever its orientation.
    for turn in 0..4 {
        let angle = TAU * f64::from(turn) / 4.0 + 0.3;
        let light = format!("location: {{x: 0.0, y: 0.0, z: 1.0}}\ncutoff angle: 0.1\nspot exponent: 0.0\ndirection: {{x: {}, y: {}, z: -1.0}}", 0.2 * angle.cos(), 0.2 * angle.sin())
            ;
        let world = floor_world("").replace("  direction: {x: 0.0, y: 0.0, z: -1.0}\n", &indented(&light));
        let picture = drawn(&mut shown("row_34", &world, &[floor()]), 640, 480);
        let focal = 480.0 / (2.0 * 0.25_f64.tan());
        // Camera at z = 5, up +y: its right is −x … seen from above with +y up, +x is right.
        let (x, y) = (0.4 * angle.cos(), 0.4 * angle.sin());
        let (column, row) = (320.0 + focal * x / 6.0, 240.0 - focal * y / 6.0);
        let bright = pixel(&picture, column as u32, row as u32)[0];
        let dark = pixel(&picture, (640.0 - column) as u32, (480.0 - row) as u32)[0];
        assert!(bright > dark + 100, "turn {turn}: {bright} {dark}");
    }
}

#[test]
fn sizes_that_are_too_large_are_refused() {
    let mut shown = shown("sizes", &world("", ""), &[]);
    let mut renderer = renderer();
    renderer.prepare(&mut shown.stage, &shown.visuals, &shown.snapshot);
    let view = shown.view(FIRST);
    for (width, height) in [(0, 480), (640, 0), (100_000, 480)] {
        let error =
            renderer.render(&mut shown.stage, &view, &PictureRequest::color(width, height)).expect_err("a size");
        assert!(error.to_string().contains("pixels"), "{error}");
    }
    let mut other = Renderer::offscreen().expect("a second renderer");
    assert!(other.render(&mut shown.stage, &view, &PictureRequest::color(64, 48)).is_err(), "not prepared by it");
}

#[test]
fn a_renderer_goes_from_thread_to_thread() {
    let mut shown = shown("threads", &world("", ""), &[block("Box", [0.0; 3], [0.2; 3], GREY)]);
    let mut renderer = renderer();
    let here = shown.picture(&mut renderer, FIRST, &PictureRequest::color(64, 48));
    let there = std::thread::spawn(move || shown.picture(&mut renderer, FIRST, &PictureRequest::color(64, 48)));
    assert_eq!(there.join().expect("a picture").color, here.color);
}

#[test]
fn backdrops_are_behind_the_scene_and_fill_their_area() {
    let mut shown = shown("backdrops", &world("", ""), &[block("Box", [0.0; 3], [0.3; 3], RED)]);
    // Two rows: blue above, green below.
    let pixels = Pixels::new(1, 2, vec![[0, 0, 255, 255], [0, 255, 0, 255]]).expect("two pixels");
    let area = [10.0, 0.0, 300.0, 480.0];
    shown.stage.backdrops.push(Backdrop { pixels: Arc::new(pixels), area, color: [1.0, 1.0, 1.0, 0.5] });
    let mut renderer = renderer();
    let request = PictureRequest::color(640, 480);
    let picture = shown.picture(&mut renderer, FIRST, &request);
    // Half of it over white.
    for (column, row, expected) in
        [(5, 100, [255, 255, 255]), (12, 5, [127, 127, 255]), (305, 475, [127, 255, 127]), (315, 475, [255, 255, 255])]
    {
        let found = pixel(&picture, column, row);
        assert!(found.iter().zip(expected).all(|(a, b): (&u8, u8)| a.abs_diff(b) <= 2), "{column}, {row}: {found:?}");
    }
    let request = PictureRequest { markers: false, ..request };
    let without = shown.picture(&mut renderer, FIRST, &request);
    assert_eq!(pixel(&without, 12, 5), [255; 3], "only where markers are");
    assert_eq!(pixel(&picture, 320, 240), pixel(&without, 320, 240));
    assert_eq!(pixel(&picture, 300, 240), pixel(&without, 300, 240), "the box is before it");
}
