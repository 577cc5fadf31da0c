//! Scenes and files that are far too large, endless or without substance: each is read or refused with a message, in
//! bounded time and memory.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use ambf_core::adf::{self, LoadError, Model};
use ambf_core::ids::BodyId;
use ambf_core::mesh::{self, MeshError};
use ambf_core::scene::{load, Loaded, SceneFiles, SceneOptions};
use ambf_core::sim::{Simulation, DEFAULT_SUB_STEP};
use tempfile::TempDir;

/// A temporary folder of its own for each test.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(TempDir::new().expect("a temporary folder"))
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, content).expect("written");
        path
    }

    /// Loads a model that stands in this folder.
    fn load(&self, model: &str) -> Loaded {
        let models = vec![self.write("model.yaml", model)];
        load(&SceneFiles { world: None, models }, &SceneOptions::default())
    }
}

/// Runs `work` and demands that it ends within `seconds`: generous, since other tests run beside it; what it must catch
/// takes minutes.
fn within<T>(seconds: u64, work: impl FnOnce() -> T) -> T {
    let begin = Instant::now();
    let result = work();
    let taken = begin.elapsed();
    assert!(taken < Duration::from_secs(seconds), "took {taken:?}");
    result
}

/// Steps a scene three times.
fn step(loaded: Loaded) {
    let mut simulation = Simulation::new(loaded.scene, DEFAULT_SUB_STEP);
    for _ in 0..3 {
        simulation.update(DEFAULT_SUB_STEP).unwrap_or_else(|error| panic!("{error}"));
    }
}

fn names(count: usize) -> String {
    (0..count).map(|i| format!("B{i}")).collect::<Vec<_>>().join(", ")
}

fn model_error(text: &str) -> LoadError {
    adf::parse::<Model>(text, Path::new("m.yaml")).expect_err("refused")
}

const COUNT: usize = 10_000;

#[test]
fn ten_thousand_bodies_in_one_model() {
    for keys in ["", "ignore inter-collision: true\n"] {
        let mut text = format!("{keys}bodies: [{}]\n", names(COUNT));
        for i in 0..COUNT {
            let (x, y) = (i % 100, i / 100);
            writeln!(
                text,
                "B{i}: {{name: b{i}, mass: 1, collision shape: Sphere, collision geometry: {{radius: 0.4}}, \
                 location: {{position: {{x: {x}, y: {y}, z: 0}}}}}}"
            )
            .expect("text");
        }
        within(60, || {
            let loaded = Folder::new().load(&text);
            assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
            assert_eq!(loaded.scene.bodies.len(), COUNT);
            step(loaded);
        });
    }
}

#[test]
fn ten_thousand_joints_in_a_chain() {
    let mut text = format!("bodies: [{}]\njoints: [", names(COUNT + 1));
    (0..COUNT).for_each(|i| write!(text, "J{i}, ").expect("text"));
    text += "]\nz: &z {x: 0, y: 0, z: 0}\na: &a {x: 0, y: 0, z: 1}\n";
    for i in 0..=COUNT {
        let mass = usize::from(i > 0);
        writeln!(
            text,
            "B{i}: {{name: b{i}, mass: {mass}, inertia: {{ix: 1, iy: 1, iz: 1}}, location: {{position: {{x: {i}, y: 0, z: 0}}}}}}"
        )
        .expect("text");
    }
    for i in 0..COUNT {
        writeln!(
            text,
            "J{i}: {{name: j{i}, type: revolute, parent: B{i}, child: B{}, parent axis: *a, child axis: *a, parent pivot: *z, \
             child pivot: {{x: -1, y: 0, z: 0}}}}",
            i + 1
        )
        .expect("text");
    }
    within(60, || {
        let loaded = Folder::new().load(&text);
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        assert_eq!(loaded.scene.joints.len(), COUNT);
        // Every body's list of all bodies below it would take gigabytes.
        assert!(loaded.report.to_string().contains("too long to be listed"), "{}", loaded.report);
        assert!((0..COUNT).all(|body| loaded
            .scene
            .graph
            .active(BodyId::new(body))
            .any(|below| below.body == BodyId::new(body + 1))));
        step(loaded);
    });
}

const MESH_BYTES: usize = 50 << 20;

#[test]
fn an_stl_of_50_mb() {
    let triangles = (MESH_BYTES - 84) / 50;
    let mut bytes = vec![b' '; 80];
    bytes.extend((triangles as u32).to_le_bytes());
    for i in 0..triangles {
        bytes.extend([0; 12]);
        let (x, y) = ((i % 1000) as f32, (i / 1000) as f32);
        for [dx, dy] in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]] {
            [x + dx, y + dy, 0.0].iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        }
        bytes.extend([0; 2]);
    }
    let mesh = within(60, || mesh::parse(bytes, Path::new("m.stl")).expect("read"));
    assert_eq!(mesh.triangle_count(), triangles);
    assert!(mesh.vertex_count() < triangles * 11 / 10, "not welded");
}

#[test]
fn an_obj_of_50_mb() {
    let mut text = String::with_capacity(MESH_BYTES + 100);
    let mut count = 0u32;
    while text.len() < MESH_BYTES {
        let (x, y) = (count % 1000, count / 1000);
        writeln!(text, "v {x} {y} 0.25").expect("text");
        count += 1;
        if count > 1000 {
            writeln!(text, "f {count} {} {}", count - 1, count - 1000).expect("text");
        }
    }
    let mesh = within(60, || mesh::parse(text.into_bytes(), Path::new("m.obj")).expect("read"));
    assert_eq!(mesh.triangle_count(), count as usize - 1000);
}

#[test]
fn an_obj_of_nothing_but_objects() {
    let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{}", "o\n".repeat(1_000_000));
    let error = within(5, || mesh::parse(text.into_bytes(), Path::new("m.obj")).expect_err("refused"));
    assert!(error.to_string().contains("objects"), "{error}");
}

#[test]
fn many_materials_that_are_used_often() {
    let folder = Folder::new();
    let mut library = String::new();
    let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    for i in 0..50_000 {
        writeln!(library, "newmtl m{i}").expect("text");
        writeln!(text, "usemtl m{}", 49_999 - i).expect("text");
    }
    folder.write("m.mtl", &library);
    let path = folder.write("m.obj", format!("mtllib m.mtl\n{text}"));
    let mesh = within(10, || mesh::load(&path).expect("read"));
    assert_eq!(mesh.sub_meshes.len(), 50_000);
    let path = folder.write("again.obj", "mtllib m.mtl\n".repeat(5_000) + &text);
    let error = within(10, || mesh::load(&path).expect_err("refused"));
    assert!(error.to_string().contains("materials"), "{error}");
}

#[test]
fn collada_nodes_that_multiply() {
    let source = "<source id=\"s\"><float_array id=\"a\">0 0 0 1 0 0 0 1 0</float_array><technique_common>\
                  <accessor source=\"#a\" stride=\"3\"/></technique_common></source><vertices id=\"v\">\
                  <input semantic=\"POSITION\" source=\"#s\"/></vertices>";
    let triangles = |p: &str| format!("<triangles><input semantic=\"VERTEX\" source=\"#v\"/>{p}</triangles>");
    let scene = |content: &str, primitives: &str| {
        let mut nodes = format!("<node id=\"n0\">{content}</node>");
        for i in 1..12 {
            let instance = format!("<instance_node url=\"#n{}\"/>", i - 1);
            write!(nodes, "<node id=\"n{i}\">{}</node>", instance.repeat(10)).expect("text");
        }
        format!(
            "<COLLADA><library_geometries><geometry id=\"g\"><mesh>{source}{primitives}</mesh></geometry></library_geometries>\
             <library_nodes>{nodes}</library_nodes><visual_scene><instance_node url=\"#n11\"/></visual_scene></COLLADA>"
        )
    };
    let instance = "<instance_geometry url=\"#g\"/>";
    for text in [
        scene(instance, &triangles("<p>0 1 2</p>")),
        // Many transforms or instances in a node that few others multiply.
        scene(&"<translate>0 0 0</translate>".repeat(20_000), "").replace("#n11", "#n4"),
        scene(&instance.repeat(20_000), &triangles("<p>0 1 2</p>")).replace("#n11", "#n4"),
        // Primitives without triangles are places too.
        scene(&instance.repeat(100), &triangles("").repeat(1_000)).replace("#n11", "#n4"),
    ] {
        let error = within(10, || mesh::parse(text.into_bytes(), Path::new("m.dae")).expect_err("refused"));
        assert!(matches!(error, MeshError::Malformed { .. }), "{error}");
    }
    // One long array behind many sources.
    let array = "0 0 0 ".repeat(50_000);
    let mut sources = String::new();
    for i in 0..2_000 {
        write!(
            sources,
            "<source id=\"s{i}\"><technique_common><accessor source=\"#a\" stride=\"3\"/></technique_common></source>\
             <vertices id=\"v{i}\"><input semantic=\"POSITION\" source=\"#s{i}\"/></vertices>\
             <triangles><input semantic=\"VERTEX\" source=\"#v{i}\"/><p>0 1 2</p></triangles>"
        )
        .expect("text");
    }
    let text = format!("<a><geometry><mesh><float_array id=\"a\">{array}</float_array>{sources}</mesh></geometry></a>");
    let mesh = within(10, || mesh::parse(text.into_bytes(), Path::new("m.dae")).expect("read"));
    assert_eq!(mesh.triangle_count(), 2_000);
}

#[test]
fn xml_of_100_000_levels() {
    let text = "<a>".repeat(100_000);
    within(5, || mesh::parse(text.into_bytes(), Path::new("m.dae")).expect_err("refused"));
}

#[test]
fn yaml_of_100_000_levels() {
    for open in ["[", "{a: ", "- ", "? ", "- - [", "{? ", "[\n", "&a [", "!t [", "\"a\": {"] {
        let error = within(10, || model_error(&open.repeat(100_000)));
        assert!(matches!(error, LoadError::Syntax { .. }), "{open}: {error}");
    }
    let mut ladder = String::new();
    for level in 0..100_000 {
        writeln!(ladder, "{:1$}a:", "", level % 300).expect("text");
    }
    within(10, || model_error(&ladder));
}

#[test]
fn lines_of_10_mb() {
    const LENGTH: usize = 10 << 20;
    for (begin, unit, end) in [
        ("bodies: ", "x", ""),
        ("bodies: [", "x, ", "]"),
        ("bodies: '", "''", "'"),
        ("bodies: \"", "\\n", "\""),
        ("# ", "#", ""),
        ("", " ", "a: 1"),
        ("a: |\n ", "x ", ""),
        ("a: {", "b: 1, ", "}"),
        ("", "- ", ""),
        ("", "a: ", ""),
        ("a: &", "b", " 1"),
        ("a: *", "b", ""),
        ("a: !", "b", " 1"),
    ] {
        let text = format!("{begin}{}{end}\n", unit.repeat(LENGTH / unit.len()));
        // What comes of it does not matter, only that something does.
        let message = within(60, || match adf::parse::<Model>(&text, Path::new("m.yaml")) {
            Ok((_, report)) => report.to_string(),
            Err(error) => error.to_string(),
        });
        assert!(message.len() < 100_000, "{begin}{unit}: {} bytes", message.len());
    }
}

#[test]
fn a_wide_indent_is_not_copied_to_every_line() {
    // Lines of a flow collection that stand too far left are indented: by as much as its key is.
    let wide = " ".repeat(1 << 20);
    let text = format!("{wide}a: {{\n{}}}\n", "b: 1,\n".repeat(100_000));
    let error = within(10, || model_error(&text));
    assert!(matches!(error, LoadError::Syntax { .. }), "{error}");
}

#[test]
fn an_environment_that_is_the_world_itself() {
    let folder = Folder::new();
    let world = folder.write("world.yaml", "environment: world.yaml\ngravity: {x: 0, y: 0, z: -9.8}\n");
    let files = SceneFiles { world: Some(world.clone()), models: vec![world] };
    step(within(5, || load(&files, &SceneOptions::default())));
}

#[test]
fn a_loop_of_parents() {
    let mut text = format!("bodies: [{}]\njoints: [", names(300));
    (0..300).for_each(|i| write!(text, "J{i}, ").expect("text"));
    text += "]\nz: &z {x: 0, y: 0, z: 0}\na: &a {x: 0, y: 0, z: 1}\n";
    for i in 0..300 {
        writeln!(text, "B{i}: {{name: b{i}, mass: 1}}").expect("text");
        writeln!(
            text,
            "J{i}: {{name: j{i}, type: revolute, parent: B{i}, child: B{}, parent axis: *a, child axis: *a, parent pivot: *z, \
             child pivot: *z}}",
            (i + 1) % 300
        )
        .expect("text");
    }
    within(10, || {
        let loaded = Folder::new().load(&text);
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        // Each is below every one, itself too.
        assert!((0..300).all(|body| loaded.scene.graph.descendants(BodyId::new(body)).len() == 300));
        step(loaded);
    });
}

#[test]
fn meshes_that_are_no_files() {
    let folder = Folder::new();
    folder.write("empty.obj", "");
    folder.write("empty.stl", "");
    folder.write("text.3ds", "what is this");
    folder.write("utf16.dae", b"\xFF\xFE<\0a\0/\0>\0");
    std::fs::create_dir(folder.0.path().join("directory.stl")).expect("a folder");
    let made = Command::new("mkfifo").arg(folder.0.path().join("pipe.stl")).status().expect("mkfifo runs");
    assert!(made.success());
    std::os::unix::fs::symlink("/dev/zero", folder.0.path().join("zero.stl")).expect("a link");
    std::os::unix::fs::symlink("loop.stl", folder.0.path().join("loop.stl")).expect("a link");
    let meshes =
        ["empty.obj", "empty.stl", "text.3ds", "utf16.dae", "directory.stl", "pipe.stl", "zero.stl", "loop.stl"];
    let mut text = format!("bodies: [{}, Good]\nGood: {{mass: 1}}\n", names(meshes.len()));
    for (i, mesh) in meshes.iter().enumerate() {
        writeln!(text, "B{i}: {{mass: 1, mesh: {mesh}, collision mesh type: CONVEX_HULL}}").expect("text");
    }
    let loaded = within(10, || folder.load(&text));
    let message = loaded.report.to_string();
    assert_eq!(loaded.report.errors(), meshes.len(), "{message}");
    assert!(meshes.iter().all(|mesh| message.contains(mesh)), "{message}");
    assert_eq!(loaded.scene.bodies.len(), 1);
    step(loaded);
}

#[test]
fn scenes_that_are_no_files() {
    let folder = Folder::new();
    let pipe = folder.0.path().join("pipe.yaml");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo runs").success());
    let refused = [
        folder.0.path().to_owned(),
        pipe,
        "/dev/zero".into(),
        folder.write("empty.yaml", ""),
        folder.write("utf16.yaml", "bodies: []".encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<_>>()),
        folder.write("utf16_mark.yaml", b"\xFF\xFEb\0"),
        folder.write("utf32.yaml", "bodies: []".chars().flat_map(|c| u32::from(c).to_be_bytes()).collect::<Vec<_>>()),
    ];
    let environment = folder.write("world.yaml", "environment: pipe.yaml\ngravity: {x: 0, y: 0, z: 0}\n");
    let files = SceneFiles { world: Some(environment), models: refused.to_vec() };
    let loaded = within(10, || load(&files, &SceneOptions::default()));
    assert_eq!(loaded.report.refused.len(), refused.len() + 1, "{:#?}", loaded.report.refused);
    step(loaded);
}

/// A dynamic body A and a static one B, with `lists` and `more` beside them.
fn with_two_bodies(lists: &str, more: &str) -> String {
    format!(
        "bodies: [A, B]\n{lists}\nA: {{name: A, mass: 1, collision shape: Box, collision geometry: {{x: 1, y: 1, z: 0.2}}}}\n\
         B: {{name: B, mass: 0, collision shape: Box, collision geometry: {{x: 9, y: 9, z: 1}}, location: {{position: {{x: 0, y: 0, z: -2}}}}}}\n\
         {more}"
    )
}

#[test]
fn sensors_without_rays_or_with_too_many() {
    let folder = Folder::new();
    folder.write("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    let none = "S: {name: S, type: Proximity, parent: A, array: []}\nT: {name: T, type: Proximity, parent: A, mesh: flat.obj}\n";
    let loaded = folder.load(&with_two_bodies("sensors: [S, T]", none));
    assert_eq!((loaded.report.errors(), loaded.scene.sensors.len()), (2, 0), "{}", loaded.report);
    step(loaded);

    let fan =
        "{name: s, type: Proximity, parent: A, parametric: {resolution: 1000, horizontal angle: 1, vertical angle: 1, \
               start offset: 0}}";
    let names: Vec<_> = (0..100).map(|i| format!("S{i}")).collect();
    let fans: String = names.iter().map(|name| format!("{name}: {fan}\n")).collect();
    let text = with_two_bodies(&format!("sensors: [{}]", names.join(", ")), &fans);
    let loaded = within(60, || folder.load(&text));
    assert_eq!((loaded.report.errors(), loaded.scene.sensors.len()), (99, 1), "{}", loaded.report);
    assert!(loaded.report.to_string().contains("more than 1000000"), "{}", loaded.report);
    within(60, || step(loaded));
}

#[test]
fn a_stack_of_four_thousand_million_images() {
    let text = with_two_bodies(
        "volumes: [V]",
        "V: {name: V, images: {path: slices, prefix: s, format: png, count: 4000000000}}\n",
    );
    step(within(5, || Folder::new().load(&text)));
}

#[test]
fn soft_bodies_of_surfaces_that_enclose_nothing() {
    for (mesh, what) in [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "one triangle"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n", "an open sheet"),
        ("v 0 0 0\nv 0 0 1\nv 1 0 0\nv 0 1 0\nv -1 -1 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\n", "three pages on a spine"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 2\n", "triangles without an area"),
        ("v 0 0 0\n", "a point"),
    ] {
        let folder = Folder::new();
        folder.write("soft.obj", mesh);
        for keys in
            ["", "kPR: 100", "kVC: 1, kMT: 0.5, bending constraint: 5", "clusters: 3, flags: 34, citerations: 10"]
        {
            let soft = format!("F: {{name: F, mass: 1, mesh: soft.obj, collision margin: 0.01, config: {{{keys}}}}}\n");
            let loaded = folder.load(&with_two_bodies("soft bodies: [F]", &soft));
            // Either it is refused with a reason, or it moves and stays finite.
            assert_eq!(loaded.scene.soft_bodies.len() + loaded.report.errors(), 1, "{what}, {keys}: {}", loaded.report);
            let mut simulation = Simulation::new(loaded.scene, DEFAULT_SUB_STEP);
            for _ in 0..200 {
                simulation.update(DEFAULT_SUB_STEP).unwrap_or_else(|error| panic!("{what}, {keys}: {error}"));
            }
        }
    }
}

#[test]
fn vehicles_that_cannot_drive() {
    let wheel =
        "{mesh: none.obj, radius: 0.2, suspension: {stiffness: 10, damping: 1, compression: 1, rest length: 0.2}, \
                 down direction: {x: 0, y: 0, z: -1}, axle direction: {x: 1, y: 0, z: 0}, offset: {x: 0, y: 0, z: 0}}";
    let text = with_two_bodies(
        "vehicles: [V, W, X]",
        &format!(
            "V: {{name: V, chassis: A, wheels: []}}\nW: {{name: W, chassis: B, wheels: [{wheel}]}}\n\
             X: {{name: X, chassis: C, wheels: [{wheel}]}}\n"
        ),
    );
    let loaded = Folder::new().load(&text);
    let message = loaded.report.to_string();
    assert_eq!((loaded.report.errors(), loaded.scene.vehicles.len()), (2, 1), "{message}");
    for part in ["`V` has no wheels", "`W` is dropped: its chassis has no mass", "`X` is dropped"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    step(loaded);
}
