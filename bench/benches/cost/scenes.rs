//! The scenes that are measured: shipped ones, the original program's where they are at hand, and generated ones.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use ambf_app::launch::scene_files;
use ambf_app::ros::naming::object_names;
use ambf_core::adf::{self, Launch};
use ambf_core::comm::ObjectKind;
use ambf_core::scene::{load, SceneFiles, SceneOptions};

/// A launch file and a model: an index into its list, or a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    pub name: String,
    pub launch: PathBuf,
    pub model: String,
}

impl Scene {
    /// A model file in the shipped world.
    pub fn shipped(name: &str, model: &Path) -> Self {
        Self { name: name.into(), launch: shipped_launch(), model: model.display().to_string() }
    }

    /// Name of the last body that communicates, as topics begin with it: the last one that is announced.
    pub fn last_body(&self) -> Option<String> {
        let objects = load(&self.files(), &SceneOptions::default()).scene.objects();
        let last = objects.iter().rposition(|object| matches!(object.kind, ObjectKind::RigidBody(..)))?;
        object_names(&objects).into_iter().nth(last)
    }

    fn index(&self) -> Option<usize> {
        self.model.parse().ok()
    }

    /// World and model file.
    pub fn files(&self) -> SceneFiles {
        let (launch, _) = adf::load::<Launch>(&self.launch).expect("the launch file was read before");
        let index = self.index();
        let file: Vec<PathBuf> = if index.is_none() { vec![PathBuf::from(&self.model)] } else { Vec::new() };
        scene_files(Some(&launch), None, &file, index.as_slice()).0
    }

    /// Options that make `ambf_simulator` or `ambf_batch` load it.
    pub fn arguments(&self) -> Vec<String> {
        let option = if self.index().is_some() { "-l" } else { "-a" };
        let launch = self.launch.display().to_string();
        vec!["--launch_file".into(), launch, option.into(), self.model.clone()]
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace").to_owned()
}

fn shipped_launch() -> PathBuf {
    root().join("resources/launch.yaml")
}

/// The scenes of the shipped launch file.
pub fn own() -> Vec<Scene> {
    listed(&shipped_launch(), usize::MAX)
}

/// The robots and puzzles of the original program's launch file; empty where `AMBF_ROOT_PATH` does not lead to them.
pub fn original() -> Vec<Scene> {
    let Some(root) = std::env::var_os("AMBF_ROOT_PATH") else { return Vec::new() };
    // The later entries are environments with soft bodies and textures.
    listed(&Path::new(&root).join("ambf_models/descriptions/launch.yaml"), 18)
}

fn listed(launch: &Path, most: usize) -> Vec<Scene> {
    let Ok((description, _)) = adf::load::<Launch>(launch) else { return Vec::new() };
    let models = description.multibody_configs.unwrap_or_default();
    let scene = |(index, path): (usize, PathBuf)| Scene {
        name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        launch: launch.to_owned(),
        model: index.to_string(),
    };
    models.into_iter().enumerate().take(most).filter(|(_, path)| path.exists()).map(scene).collect()
}

fn written(name: &str, text: &str) -> Scene {
    let path = ambf_bench::folder().join(format!("{name}.yaml"));
    std::fs::write(&path, text).expect("the target folder can be written");
    Scene::shipped(name, &path)
}

fn model(bodies: &[(String, String)], joints: &[(String, String)], keys: &str) -> String {
    let list = |items: &[(String, String)]| items.iter().map(|(key, _)| key.as_str()).collect::<Vec<_>>().join(", ");
    let mut text = format!("bodies: [{}]\njoints: [{}]\nnamespace: /ambf/env/\n{keys}\n", list(bodies), list(joints));
    for (key, body) in bodies.iter().chain(joints) {
        writeln!(text, "{key}: {{{body}}}").expect("a text takes everything");
    }
    text
}

/// Distance of the boxes from each other, m.
const PITCH: f64 = 0.25;
const BOX: &str = "restitution: 0, friction: {static: 0.5, rolling: 0.01}, damping: {linear: 0.04, angular: 0.1}, \
                   shape: Box, geometry: {x: 0.1, y: 0.1, z: 0.1}, collision shape: Box, \
                   collision geometry: {x: 0.1, y: 0.1, z: 0.1}";

fn grid(n: usize, pitch: f64, keys: &str) -> Vec<(String, String)> {
    let side = (1..).find(|side| side * side * side >= n).expect("there is a cube for every number");
    let place = |i: usize| (i as f64 - side as f64 / 2.0) * pitch;
    let body = |i: usize| {
        let (x, y, z) = (place(i % side), place(i / side % side), -1.4 + (i / (side * side)) as f64 * pitch);
        let position = format!("location: {{position: {{x: {x:.4}, y: {y:.4}, z: {z:.4}}}}}");
        (format!("BODY Box{i}"), format!("name: Box{i}, mass: 0.1, {position}, {keys}"))
    };
    (0..n).map(body).collect()
}

/// `n` boxes of 0.1 kg that fall onto the ground and each other.
pub fn boxes(n: usize) -> Scene {
    written(&format!("boxes{n}"), &model(&grid(n, PITCH, BOX), &[], "ignore inter-collision: false"))
}

/// `n` boxes that float and touch nothing.
pub fn floating(n: usize) -> Scene {
    let keys = format!("{BOX}, gravity: {{x: 0, y: 0, z: 0}}");
    written(&format!("floating{n}"), &model(&grid(n, PITCH, &keys), &[], "ignore inter-collision: false"))
}

/// Acceleration of the body `Clock` in [`clocked_boxes`], m/s².
pub const CLOCK_GRAVITY: f64 = 0.01;
/// Where it starts, m.
pub const CLOCK_START: f64 = 1000.0;

/// [`boxes`] beside a body that falls slowly, far away and without loss: how far tells how much time was integrated.
pub fn clocked_boxes(n: usize) -> Scene {
    let mut bodies = grid(n, PITCH, BOX);
    let clock = format!(
        "name: Clock, mass: 1, location: {{position: {{x: 100, y: 0, z: {CLOCK_START}}}}}, \
         gravity: {{x: 0, y: 0, z: -{CLOCK_GRAVITY}}}, damping: {{linear: 0, angular: 0}}, collision shape: Sphere, \
         collision geometry: {{radius: 0.1}}"
    );
    bodies.push(("BODY Clock".into(), clock));
    written(&format!("clocked_boxes{n}"), &model(&bodies, &[], "ignore inter-collision: false"))
}

/// As [`boxes`], but they fall through each other: pairs that overlap and never collide.
pub fn ghostly_boxes(n: usize) -> Scene {
    written(&format!("ghostly_boxes{n}"), &model(&grid(n, PITCH, BOX), &[], "ignore inter-collision: true"))
}

/// `n` hinged links that hang from a fixed one, with or without joint feedback.
pub fn chain(n: usize, feedback: bool) -> Scene {
    let body = |i: usize| {
        let (mass, x) = (if i == 0 { 0.0 } else { 0.5 }, 0.2 * i as f64);
        let position = format!("location: {{position: {{x: {x:.1}, y: 0, z: 3}}}}");
        (format!("BODY L{i}"), format!("name: L{i}, mass: {mass}, {position}, {BOX}"))
    };
    let joint = |i: usize| {
        let keys = format!(
            "name: J{i}, parent: BODY L{i}, child: BODY L{}, type: revolute, parent axis: {{x: 0, y: 1, z: 0}}, \
             child axis: {{x: 0, y: 1, z: 0}}, parent pivot: {{x: 0.1, y: 0, z: 0}}, \
             child pivot: {{x: -0.1, y: 0, z: 0}}, enable feedback: {feedback}",
            i + 1
        );
        (format!("JOINT {i}"), keys)
    };
    let bodies: Vec<_> = (0..=n).map(body).collect();
    let joints: Vec<_> = (0..n).map(joint).collect();
    let name = format!("chain{n}_{}", if feedback { "feedback" } else { "plain" });
    written(&name, &model(&bodies, &joints, "ignore inter-collision: true"))
}

/// Ten boxes on the ground, a post without a shape above them and a car's body beside them, and one element of each
/// kind in turn.
pub fn elements() -> Vec<(&'static str, Scene)> {
    let mesh = ambf_bench::folder().join("sheet.obj");
    std::fs::write(&mesh, sheet_obj(10)).expect("the target folder can be written");
    let bodies = || {
        let mut bodies = grid(10, PITCH, BOX);
        bodies.push(("BODY Post".into(), "name: Post, mass: 0, location: {position: {x: 0, y: 0, z: 0}}".into()));
        let at = "location: {position: {x: 3, y: 0, z: -1.3}}";
        bodies.push(("BODY Car".into(), format!("name: Car, mass: 5, {at}, {BOX}")));
        bodies
    };
    let sensor = |kind: &str, resolution: u32| {
        format!(
            "sensors: [S]\nS: {{name: S, type: {kind}, parent: BODY Post, range: 3, location: {{orientation: {{r: 0, p: 1.5708, y: 0}}}}, \
             parametric: {{resolution: {resolution}, horizontal angle: 0.8, vertical angle: 0.8, start offset: 0}}}}"
        )
    };
    let wheel = |x: f64, y: f64| {
        format!(
            "{{mesh: none.stl, radius: 0.1, friction: 1, roll influence: 0.1, suspension: {{stiffness: 40, damping: 4, compression: 3, \
             rest length: 0.1}}, down direction: {{x: 0, y: 0, z: -1}}, axel direction: {{x: 0, y: 1, z: 0}}, offset: {{x: {x}, y: {y}, z: 0}}}}"
        )
    };
    let wheels = [wheel(0.1, 0.1), wheel(0.1, -0.1), wheel(-0.1, 0.1), wheel(-0.1, -0.1)].join(", ");
    let kinds: [(&'static str, &str, String); 11] = [
        ("10 boxes, a post, a car's body", "none", String::new()),
        ("with a proximity sensor of 4 rays", "rays4", sensor("Proximity", 2)),
        ("with one of 100 rays", "rays100", sensor("Proximity", 10)),
        ("with a resistance sensor of 100 rays", "resistance", sensor("Resistance, contact stiffness: 0.1", 10)),
        ("with a contact sensor", "contact", "sensors: [S]\nS: {name: S, type: Contact, parent: BODY Box0}".into()),
        ("with an actuator", "actuator", "actuators: [A]\nA: {name: A, type: Constraint, parent: BODY Post}".into()),
        (
            "with a ghost object",
            "ghost",
            "ghost objects: [G]\nG: {name: G, location: {position: {x: 3, y: 3, z: 0}}, collision shape: Box, \
             collision geometry: {x: 1, y: 1, z: 1}}"
                .into(),
        ),
        (
            "with a vehicle of 4 wheels",
            "vehicle",
            format!("vehicles: [V]\nV: {{name: V, chassis: BODY Car, wheels: [{wheels}]}}"),
        ),
        (
            "with a cloth of 100 nodes",
            "cloth",
            format!(
                "soft bodies: [C]\nC: {{name: C, mass: 0.1, mesh: {}, location: {{position: {{x: -3, y: 0, z: 2}}}}, \
                 config: {{piterations: 4, kDP: 0.01, fixed nodes: [0, 9]}}}}",
                mesh.display()
            ),
        ),
        (
            "with a camera and a light",
            "camera",
            "cameras: [K]\nlights: [L]\nK: {name: K, location: {x: 1, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}}\n\
             L: {name: L, location: {x: 1, y: 0, z: 0}}"
                .into(),
        ),
        ("with an empty volume", "volume", "volumes: [U]\nU: {name: U}".into()),
    ];
    let scene = |(words, name, keys): (&'static str, &str, String)| {
        let text = model(&bodies(), &[], &format!("ignore inter-collision: false\n{keys}"));
        (words, written(&format!("element_{name}"), &text))
    };
    kinds.into_iter().map(scene).collect()
}

/// A square sheet of `n` × `n` vertices, 1 m wide, as an OBJ file.
fn sheet_obj(n: usize) -> String {
    let mut text = String::new();
    let place = |i: usize| i as f64 / (n - 1) as f64;
    for i in 0..n * n {
        writeln!(text, "v {:.4} {:.4} 0", place(i % n), place(i / n)).expect("a text takes everything");
    }
    for row in 0..n - 1 {
        for a in row * n + 1..(row + 1) * n {
            writeln!(text, "f {a} {} {}\nf {} {} {}", a + 1, a + n, a + 1, a + n + 1, a + n)
                .expect("a text takes everything");
        }
    }
    text
}

/// `n` balls of 0.1 m diameter that lie on the ground, as primitives or as meshes of 1280 triangles of the given type.
pub fn balls(n: usize, mesh_type: Option<&str>) -> Scene {
    let keys = match mesh_type {
        None => "collision shape: Sphere, collision geometry: {radius: 0.05}".into(),
        Some(kind) => format!("mesh: ball.stl, collision mesh type: {kind}"),
    };
    if mesh_type.is_some() {
        let path = ambf_bench::folder().join("ball.stl");
        std::fs::write(path, ball_stl(0.05)).expect("the target folder can be written");
    }
    let folder = ambf_bench::folder();
    let folder = folder.display();
    let paths = format!("high resolution path: {folder}/\nlow resolution path: {folder}/");
    let keys =
        format!("{keys}, inertia: {{ix: 0.0001, iy: 0.0001, iz: 0.0001}}, friction: {{static: 0.5, rolling: 0.01}}");
    // Side by side on the ground: the grid is one layer when it is cut off after its first.
    let bodies = grid(n * n * n, PITCH, &keys).into_iter().take(n * n).collect::<Vec<_>>();
    let name = format!("balls{}_{}", n * n, mesh_type.unwrap_or("primitive").to_lowercase());
    written(&name, &model(&bodies, &[], &format!("{paths}\nignore inter-collision: false")))
}

/// A sphere of 17 rings of 40 faces as a binary STL file; those at the poles are triangles: 2 · 40 · 16 triangles.
fn ball_stl(radius: f64) -> Vec<u8> {
    let (rows, columns) = (17, 40);
    let point = |row: usize, column: usize| {
        let polar = std::f64::consts::PI * row as f64 / rows as f64;
        let azimuth = std::f64::consts::TAU * (column % columns) as f64 / columns as f64;
        [polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()].map(|x| (radius * x) as f32)
    };
    let mut triangles = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let (a, b) = (point(row, column), point(row, column + 1));
            let (c, d) = (point(row + 1, column), point(row + 1, column + 1));
            if row > 0 {
                triangles.push([a, c, b]);
            }
            if row + 1 < rows {
                triangles.push([b, c, d]);
            }
        }
    }
    let mut bytes = vec![0; 80];
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for triangle in triangles {
        bytes.extend([0; 12]);
        bytes.extend(triangle.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}
