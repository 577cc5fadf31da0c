//! The linter: what it says about files, its exit status, its JSON, and what it does with bad input.

mod batch_common;

use std::fmt::Write as _;
use std::process::Command;

use batch_common::{resources, Folder, Ran};
use serde_json::Value;

/// What `ambf_batch --check` prints, as JSON, with its exit status.
fn check(folder: &Folder, arguments: &str) -> (Value, i32) {
    let ran = folder.run(&format!("--check --json {arguments}"));
    let document = serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{error}: {ran:?}"));
    (document, ran.status)
}

/// The findings about `text` as a model, as lines.
fn lines(folder: &Folder, text: &str) -> Vec<String> {
    folder.write("m.yaml", text);
    let ran = folder.run("--check m.yaml");
    assert!(ran.stderr.is_empty(), "{ran:?}");
    ran.stdout.lines().take_while(|line| !line.is_empty()).map(str::to_owned).collect()
}

/// The only problem of a JSON report that has this kind.
#[track_caller]
fn problem<'d>(document: &'d Value, kind: &str) -> &'d Value {
    let problems = document["problems"].as_array().expect("a list");
    let of_kind: Vec<_> = problems.iter().filter(|problem| problem["kind"] == kind).collect();
    assert_eq!(of_kind.len(), 1, "{kind}: {document:#}");
    of_kind[0]
}

fn simulator(folder: &Folder, words: &[&str]) -> Ran {
    let output = Command::new(env!("CARGO_BIN_EXE_ambf_simulator"))
        .args(words)
        .current_dir(folder.path())
        .env("AMBF_RESOURCES", resources())
        .env_remove("AMBF_ROOT_PATH")
        .output()
        .expect("ambf_simulator runs");
    let text = |bytes| String::from_utf8(bytes).expect("text");
    let status = output.status.code().expect("no signal");
    Ran { status, stdout: text(output.stdout), stderr: text(output.stderr) }
}

const BALL: &str = "bodies: [BODY Ball]\nBODY Ball: {name: Ball, mass: 2, \
                    collision shape: Sphere, collision geometry: {radius: 0.1}}\n";

#[test]
fn our_own_scenes_hold_no_error() {
    let folder = Folder::new();
    let (document, status) = check(&folder, "");
    assert_eq!((status, &document["errors"], &document["status"]), (0, &0.into(), &0.into()), "{document:#}");
    let files = document["files"].as_array().expect("a list");
    let kinds: Vec<_> = files.iter().map(|file| file["kind"].as_str().expect("a kind")).collect();
    // The device file names the gripper that all devices have.
    assert_eq!(kinds[..6], ["launch file", "world", "model", "input devices", "model", "colours"]);
    let models = files[0]["written"]["models"].as_u64().expect("a number");
    assert_eq!(kinds.len() as u64, 6 + models, "{kinds:?}");
    let chain = files.iter().find(|file| file["file"].as_str().expect("a name").ends_with("chain.yaml"));
    let chain = chain.expect("checked");
    assert_eq!((&chain["written"]["bodies"], &chain["built"]["bodies"]), (&7.into(), &7.into()), "{chain:#}");
    assert_eq!(chain["built"]["joints"], 6);
}

#[test]
fn both_programs_say_the_same() {
    let folder = Folder::new();
    folder.write("m.yaml", &BALL.replace("mass: 2", "mass: 2, colour: red"));
    folder.write("w.yaml", "gravity: {x: 0, y: 0, z: -9}\n");
    let batch = folder.run("--check m.yaml w.yaml");
    let ran = simulator(&folder, &["--check", "m.yaml", "-g", "0", "w.yaml"]);
    assert_eq!((ran.status, &ran.stdout), (batch.status, &batch.stdout), "{ran:?}");
    assert!(ran.stderr.is_empty(), "{ran:?}");
    let first = ran.stdout.lines().next().expect("a line");
    assert_eq!(first, "m.yaml:2:34: warning: `BODY Ball / colour` is not known");
    assert!(ran.stdout.contains("m.yaml  model      1/1"), "{}", ran.stdout);
    // Without --check the words stay what they were: ignored by one program, refused by the other.
    assert_eq!(folder.run("m.yaml -l 1 --steps 1").status, 1);
}

#[test]
fn a_launch_file_checks_all_it_names() {
    let folder = Folder::new();
    folder.write(
        "launch.yaml",
        "world config: w.yaml\ninput devices config: d.yaml\ncolor config: c.yaml\n\
         multibody configs:\n  - m.yaml\n  - absent.yaml\n  - m.yaml\nplugins: [{name: p, filename: libp.so}]\n",
    );
    folder.write(
        "w.yaml",
        "environment: e.yaml\nskybox: {path: sky, right: r, left: l, top: t, bottom: b, front: f, back: k}\n",
    );
    folder.write("e.yaml", "bodies: [BODY floor]\nBODY floor: {mass: 0, colour: green, mesh: ''}\n");
    folder.write("c.yaml", "red: {r: 255, g: 0, b: 0, a: 255}\n");
    folder.write(
        "d.yaml",
        "input devices: [D]\nD: {hardware name: x, simulated multibody: s.yaml, root link: BODY z, deadband: 1}\n",
    );
    folder.write("s.yaml", BALL);
    folder.write("m.yaml", &BALL.replace("mass: 2", "mass: 2, color: crimson"));
    let (document, status) = check(&folder, "launch.yaml");
    assert_eq!(status, 2, "{document:#}");
    let files = document["files"].as_array().expect("a list").iter();
    let files: Vec<_> = files.map(|file| file["file"].as_str().expect("a name")).collect();
    let expected = ["launch.yaml", "w.yaml", "e.yaml", "d.yaml", "s.yaml", "c.yaml", "m.yaml", "absent.yaml"];
    assert_eq!(files, expected);
    let absent = problem(&document, "unreadable");
    assert_eq!((&absent["file"], &absent["severity"]), (&"absent.yaml".into(), &"error".into()));
    assert!(absent["message"].as_str().expect("a text").contains("launch.yaml:6:5"), "{absent}");
    assert_eq!(problem(&document, "unknown colour")["path"], "BODY Ball / color");
    assert_eq!(problem(&document, "unknown key")["file"], "e.yaml");
    assert_eq!(problem(&document, "root link")["line"], 2);
    assert_eq!(problem(&document, "plugin")["file"], "launch.yaml");
    let missing = document["problems"].as_array().expect("a list").iter();
    assert_eq!(missing.filter(|problem| problem["kind"] == "missing file").count(), 6, "faces of the sky box");
}

#[test]
fn json_has_every_field_and_escapes() {
    let folder = Folder::new();
    folder.write("m.yaml", &BALL.replace("mass: 2", "mass: 2, \"a\\\"b\\\\c\\u0007é\": 1, scale: -1"));
    let (document, status) = check(&folder, "m.yaml");
    assert_eq!(status, 2);
    let scale = problem(&document, "out of range");
    for (field, expected) in [
        ("severity", "error"),
        ("file", "m.yaml"),
        ("path", "BODY Ball / scale"),
        ("key", "scale"),
        ("found", "`-1`"),
        ("expected", "a finite number above 0"),
        ("action", "the body is dropped"),
        ("original", "does not check it"),
    ] {
        assert_eq!(scale[field], expected, "{scale}");
    }
    assert_eq!(scale["line"], 2);
    assert!(scale["column"].as_u64().expect("a number") > 1);
    assert_eq!(problem(&document, "unknown key")["key"], "a\"b\\c\u{7}é");
    assert_eq!(problem(&document, "unknown key")["original"], Value::Null);
}

#[test]
fn a_file_that_is_named_twice_is_checked_once() {
    let folder = Folder::new();
    folder.write("m.yaml", &BALL.replace("mass: 2", "colour: red, mesh: absent.stl"));
    let once = folder.run("--check m.yaml");
    let again = folder.run("--check m.yaml ./m.yaml m.yaml");
    assert_eq!(once.stdout, again.stdout);
    assert_eq!(once.stdout.matches("`BODY Ball / colour`").count(), 1);
    // Two copies in one world are two objects, but one file.
    let copies = folder.run("--check -a m.yaml,m.yaml");
    assert_eq!(copies.stdout.matches("`BODY Ball / colour`").count(), 1, "{copies:?}");
    let line = copies.stdout.lines().find(|line| line.starts_with("2 models together")).expect("a line");
    assert!(line.contains("scene") && line.ends_with("2/2"), "{line}");
    let ground = copies.stdout.lines().find(|line| line.contains("ground.yaml")).expect("a line");
    assert!(ground.contains("1/1"), "{ground}");
}

#[test]
fn meshes_are_looked_for_and_said_once() {
    let folder = Folder::new();
    folder.write("There.STL", "");
    let found = lines(
        &folder,
        "bodies: [A, B, C]\nA: {mass: 1, mesh: absent.stl, name: a}\n\
         B: {mass: 1, name: b, mesh: there.stl, collision shape: Sphere, collision geometry: {radius: 1}}\n\
         C: {mass: 1, mesh: x.ply, collision shape: Sphere, collision geometry: {radius: 1}}\n",
    );
    assert_eq!(found.len(), 3, "{found:#?}");
    assert_eq!(
        found[0],
        "m.yaml:2:14: error: `A / mesh` cannot be used: absent.stl does not exist; the body is dropped"
    );
    assert!(found[1].contains("warning") && found[1].contains("`There.STL` does"), "{found:#?}");
    assert!(found[1].ends_with("it is not drawn (the C++ program: drops the element)"), "{found:#?}");
    assert!(found[2].contains("x.ply does not exist"), "{found:#?}");
    let (document, status) = check(&folder, "m.yaml");
    assert_eq!((status, &document["files"][0]["meshes"]["missing"]), (2, &3.into()));
    assert_eq!(document["files"][0]["built"]["bodies"], 2);
}

#[test]
fn notes_of_building_are_listed() {
    let folder = Folder::new();
    let second = BALL.replace("[BODY Ball]", "[BODY Ball, BODY Second ball]\njoints: [J, K]")
        + "BODY Second ball: {mass: 1, collision shape: Sphere, collision geometry: {radius: 0.1}}\n";
    let joint = "parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 0, z: 1}, \
                 child axis: {x: 0, y: 0, z: 1}}\n";
    let text = format!(
        "{second}J: {{type: fixed, parent: Second, child: BODY Ball, {joint}K: {{type: fixed, parent: BODY Ball, child: none, {joint}"
    );
    let found = lines(&folder, &text);
    assert_eq!(found.len(), 2, "{found:#?}");
    assert!(found[0].contains(": warning: `J`: parent `Second` is taken for part of `BODY Second ball`"), "{found:#?}");
    assert!(found[1].contains(": error: `K` is dropped: child `none` is not found"), "{found:#?}");
}

/// A model text, and the kind of the difference it shows.
const DIFFERENCES: &[(&str, &str)] = &[
    ("publish frequency", "bodies: [A]\nA: {mass: 0, publish frequency: {low: 1500, high: 2000}, mesh: ''}\n"),
    ("hidden", "bodies: [A]\nA: {mass: 0, visible: no}\n"),
    ("name", "bodies: [A]\nA: {mass: 0, name: a-b}\n"),
    ("same topics", "bodies: [A, B]\nA: {mass: 0, name: a}\nB: {mass: 0, name: a}\n"),
    ("compound offset", "bodies: [A]\nA: {mass: 0, compound shape: [{shape: Sphere, geometry: {radius: 1}, offset: {position: {x: 1, y: 0, z: 0}}}]}\n"),
    ("capsule drawn", "bodies: [A]\nA: {mass: 0, shape: Capsule, geometry: {radius: 1, height: 3}}\n"),
    ("axis drawn", "bodies: [A]\nA: {mass: 0, shape: Cone, geometry: {radius: 1, height: 3, axis: x}}\n"),
    ("empty inertia", "bodies: [A]\nA: {mass: 1}\n"),
    ("sensor mesh", "low resolution path: lo\nsensors: [S]\nS: {type: Proximity, parent: A, mesh: there.stl}\n"),
    ("mesh rays", "sensors: [S]\nS: {type: Proximity, parent: A, mesh: lo/there.stl}\n"),
    ("parametric location", "sensors: [S]\nS: {type: Proximity, parent: A, location: {position: {x: 1, y: 0, z: 0}}, \
      parametric: {resolution: 2, horizontal angle: 1, vertical angle: 1, start offset: 0}}\n"),
    ("resistance silent", "sensors: [S]\nS: {type: Resistance, parent: A, array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 1, y: 0, z: 0}}]}\n"),
    ("resistance normal", "sensors: [S]\nS: {type: Resistance, parent: A, location: {orientation: {r: 1, p: 0, y: 0}}, \
      array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 1, y: 0, z: 0}}]}\n"),
    ("resistance damping", "sensors: [S]\nS: {type: Resistance, parent: A, contact damping: 1, \
      array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 1, y: 0, z: 0}}]}\n"),
    ("contact sensor", "sensors: [S]\nS: {type: contact, parent: A}\n"),
    ("convex decomposition", "bodies: [A]\nA: {mass: 1, mesh: one.obj, collision mesh type: CONVEX_DECOMPOSITION}\n"),
    ("short parent", "namespace: /n/\nbodies: [A, AB]\nA: {mass: 0}\nAB: {mass: 0}\nactuators: [C]\nC: {type: Constraint, parent: A}\n"),
    ("actuator frame", "bodies: [A]\nA: {mass: 1, inertia: {ix: 1, iy: 1, iz: 1}, inertial offset: {position: {x: 1, y: 0, z: 0}}}\n\
      actuators: [C]\nC: {type: Constraint, parent: A}\n"),
    ("chassis", "bodies: [A]\nA: {mass: 0}\nvehicles: [V]\nV: {chassis: A}\n"),
    ("wheel mesh", "high resolution path: lo\nvehicles: [V]\nV: {chassis: A, wheels: [{mesh: there.stl, radius: 1, friction: 1, \
      roll influence: 1, suspension: {stiffness: 1, damping: 1, compression: 1, rest length: 1}}]}\n"),
    ("coupling", "joints: [J, K]\nJ: {type: revolute, parent: A, child: B, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
      parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}}\nK: {type: revolute, coupling: {joint: J}, parent: A, child: B, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
      parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}}\n"),
    ("drive train", "joints: [J]\nJ: {type: revolute, drive train: {friction: 1}, parent: A, child: B, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
      parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}}\n"),
    ("ghost groups", "ghost objects: [G]\nG: {collision shape: Sphere, collision geometry: {radius: 1}, collision groups: [1]}\n"),
    ("ghost gravity", "gravity: {x: 0, y: 0, z: 0}\nghost objects: [G]\nG: {collision shape: Sphere, collision geometry: {radius: 1}}\n"),
    ("randomize constraints", "soft bodies: [S]\nS: {mass: 1, mesh: lo/there.stl, randomize constraints: No}\n"),
    ("soft body parts", "soft bodies: [S]\nS: {mass: 1, mesh: two.obj}\n"),
    ("fixed nodes", "soft bodies: [S]\nS: {mass: 1, mesh: one.obj, config: {fixed nodes: [0]}}\n"),
    ("volume images", "volumes: [V]\nV: {}\n"),
    ("shadow quality", "bodies: []\nlights: [L]\nL: {}\n"),
    ("stereo mode", "bodies: []\ncameras: [C]\nC: {stereo: {mode: active, eye separation: 1, focal length: 1}}\n"),
    ("depth resolution", "bodies: []\ncameras: [C]\nC: {publish depth: yes, publish depth resolution: {width: 10, height: 10}}\n"),
    ("dae mesh", "bodies: [A]\nA: {mass: 0, mesh: m.dae, collision shape: Sphere, collision geometry: {radius: 1}}\n"),
    ("enclosure", "enclosure: {length: 1, width: 1, height: 1}\n"),
    ("environment", "gravity: {x: 0, y: 0, z: 0}\n"),
    ("max force", "input devices: [D]\nD: {hardware name: x, root link: A, max force: 3}\n"),
    ("haptic gain", "input devices: [D]\nD: {hardware name: x, root link: A}\n"),
    ("device key", "input devices: [D]\nD: {hardware name: x, root link: A, driver settings: {rate: 100}}\n"),
    ("deadband", "input devices: [D]\nD: {hardware name: x, root link: A}\n"),
    ("button mapping", "input devices: [D]\nD: {hardware name: x, root link: A}\n"),
    ("button mapping", "input devices: [D]\nD: {hardware name: x, root link: A, \
      button mapping: {a1: 1, a2: 2, next mode: 3, prev mode: 4, g1: 0}}\n"),
];

#[test]
fn differences_from_the_original_are_told() {
    let folder = Folder::new();
    let facet = "vertex 0 0 0 vertex 1 0 0 vertex 0 1 0";
    folder.write(
        "lo/there.stl",
        &format!("solid s\nfacet normal 0 0 1 outer loop {facet} endloop endfacet\nendsolid s\n"),
    );
    folder.write("one.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    folder.write("two.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\no a\nf 1 2 3\no b\nf 3 2 1\n");
    folder.write("m.dae", "");
    for (kind, text) in DIFFERENCES {
        folder.write("m.yaml", text);
        let (document, _) = check(&folder, "m.yaml");
        let found = problem(&document, kind);
        assert_eq!(found["severity"], "info", "{found:#}");
        let original = found["original"].as_str();
        assert!(*kind == "randomize constraints" || *kind == "stereo mode" || original.is_some(), "{found:#}");
    }
}

#[test]
fn enable_motor_has_three_cases() {
    let folder = Folder::new();
    let joint = |keys: &str| {
        format!(
            "bodies: [A, B]\nA: {{mass: 0}}\nB: {{mass: 0}}\njoints: [J]\nJ: {{type: revolute, parent: A, child: B, {keys}, \
             parent pivot: {{x: 0, y: 0, z: 0}}, child pivot: {{x: 0, y: 0, z: 0}}, parent axis: {{x: 0, y: 0, z: 1}}, \
             child axis: {{x: 0, y: 0, z: 1}}}}\n"
        )
    };
    for (keys, part) in [
        ("enable motor: 1", Some("refuses the file")),
        ("enable motor: yes, enable feedback: no", Some("takes the value of `enable feedback`")),
        ("enable motor: yes, enable feedback: yes", None),
        ("enable feedback: yes", None),
    ] {
        let found = lines(&folder, &joint(keys));
        let of_motor = found.iter().find(|line| line.contains("enable motor"));
        match part {
            Some(part) => assert!(of_motor.is_some_and(|line| line.contains(part)), "{keys}: {found:#?}"),
            None => assert_eq!(of_motor, None, "{keys}"),
        }
    }
}

#[test]
fn loops_of_parents_are_named_once() {
    let folder = Folder::new();
    let mut text = String::from("bodies: []\nnamespace: /n/\nlights: [A, B, C, D]\ncameras: [E]\n");
    for (name, parent) in [("A", "/n/B"), ("B", "/n/C"), ("C", "A"), ("D", "A"), ("E", "E")] {
        let _ = writeln!(text, "{name}: {{parent: {parent}}}");
    }
    let lines = lines(&folder, &text);
    let found: Vec<_> = lines.iter().filter(|line| line.contains("itself or hangs on it")).collect();
    assert_eq!(found.len(), 2, "{lines:#?}");
    assert!(found[0].starts_with("m.yaml:7:1: warning: `/n/C`: parent `A` is"), "{found:#?}");
    assert!(found[1].starts_with("m.yaml:9:1: warning: `/n/E`: parent `E` is"), "{found:#?}");
}

#[test]
fn a_closed_chain_of_joints_is_legal() {
    let folder = Folder::new();
    let model = resources().join("models/four_bar.yaml");
    let (document, status) = check(&folder, &model.display().to_string());
    assert_eq!((status, &document["warnings"]), (0, &0.into()), "{document:#}");
    assert_eq!(document["files"][0]["built"]["joints"], 4);
}

#[test]
fn thousands_of_elements_take_no_more_processor_time_than_a_run_may() {
    let folder = Folder::new();
    let count = 10_000;
    let names = |prefix: &str| (0..count).map(|i| format!("{prefix}{i}, ")).collect::<String>();
    let joints = names("J").replace("J0, ", "");
    let mut text = format!("namespace: /n/\nbodies: [{}]\nlights: [{}]\njoints: [{joints}]\n", names("B"), names("L"));
    let frames = "parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 0, z: 1}, \
                  child axis: {x: 0, y: 0, z: 1}";
    for i in 0..count {
        let place = format!("location: {{position: {{x: {i}, y: 0, z: 0}}}}");
        let _ = writeln!(text, "B{i}: {{mass: 1, unknown: 1, name: b{i}, {place}, inertia: {{ix: 1, iy: 1, iz: 1}}}}");
        let _ = writeln!(text, "L{i}: {{parent: /n/L{}}}", (i + 1) % count);
        // Chains of ten.
        let parent = if i % 10 == 0 { 0 } else { i - 1 };
        if i > 0 {
            let _ = writeln!(text, "J{i}: {{type: fixed, parent: B{parent}, child: B{i}, {frames}}}");
        }
    }
    folder.write("m.yaml", &text);
    let (document, status) = check(&folder, "m.yaml");
    assert_eq!(status, 0, "{}", document["errors"]);
    assert_eq!(document["files"][0]["built"]["bodies"], count);
    assert_eq!(document["files"][0]["built"]["joints"], count - 1);
    let problems = document["problems"].as_array().expect("a list");
    let is_loop = |problem: &&Value| problem["message"].as_str().is_some_and(|text| text.contains("hangs on it"));
    assert_eq!(problems.iter().filter(is_loop).count(), 1);
    // Those of one file that the reader keeps, and the linter's own.
    assert!(problems.len() < 60_000, "{}", problems.len());
}

#[test]
fn broken_and_hostile_files_are_named() {
    let folder = Folder::new();
    folder.write("syntax.yaml", "bodies: [A\njoints: []\n");
    folder.write("empty.yaml", "");
    folder.write("list.yaml", "- a\n");
    folder.write("types.yaml", "bodies: [A]\nA: {mass: heavy, damping: 0.1, location: 3}\n");
    folder.write("version.yaml", "adf version: 2.0\nbodies: []\n");
    folder.write("itself.yaml", "a: &a {b: *a}\nbodies: []\n");
    let mut deep = String::from("a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n");
    for i in 1..40 {
        let _ = writeln!(deep, "a{i}: &a{i} [{}]", format!("*a{}, ", i - 1).repeat(10));
    }
    folder.write("deep.yaml", &(deep + "bodies: *a39\n"));
    folder.write("words.yaml", "colour: red\n");
    for (file, part) in [
        ("absent.yaml", "absent.yaml: error: cannot be read"),
        (".", ".: error: is a folder, expected a file"),
        ("syntax.yaml", "syntax.yaml:2:"),
        ("empty.yaml", "the file holds nothing"),
        ("list.yaml", "list.yaml:1:1: error: the file holds a list"),
        ("types.yaml", "types.yaml:2:11: error: `A / mass` is `heavy`, expected a number; the file is refused"),
        ("version.yaml", "`adf version` is `2.0`"),
        ("itself.yaml", "an alias refers to the collection that contains it"),
        ("deep.yaml", "the file is refused"),
    ] {
        let ran = folder.run(&format!("--check {file}"));
        assert_eq!(ran.status, 2, "{file}: {ran:?}");
        assert!(ran.stdout.contains(part), "{file}: {ran:?}");
    }
    let ran = folder.run("--check words.yaml");
    assert_eq!(ran.status, 0, "{ran:?}");
    assert!(ran.stdout.contains("no key tells what this file is; it is taken for a model"), "{ran:?}");
}

#[test]
fn models_of_a_scene_are_built_together() {
    let folder = Folder::new();
    folder.write("w.yaml", "gravity: {x: 0, y: 0, z: -9}\n");
    folder.write("a.yaml", BALL);
    folder.write(
        "b.yaml",
        "bodies: [BODY Other]\njoints: [J]\nBODY Other: {mass: 0}\nJ: {type: fixed, parent: BODY Other, child: BODY Ball, \
         parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 0, z: 1}, \
         child axis: {x: 0, y: 0, z: 1}}\n",
    );
    let (document, status) = check(&folder, "-a a.yaml,b.yaml --world w.yaml");
    assert_eq!(status, 0, "{document:#}");
    let together = document["files"].as_array().expect("a list").last().expect("a line");
    assert_eq!((&together["kind"], &together["built"]["joints"]), (&"scene".into(), &1.into()), "{together:#}");
    // Alone, the joint finds nothing to hold.
    assert_eq!(check(&folder, "b.yaml").1, 2);
    let (document, status) = check(&folder, "-l 99");
    assert_eq!(status, 2);
    assert!(problem(&document, "no such model")["message"].as_str().expect("a text").contains("99"));
}

/// A joint of an arm to a body that is not in its file, and the arm.
fn arm(parent: &str) -> String {
    format!(
        "namespace: /arm/\nbodies: [BODY Hand]\njoints: [J]\ncameras: [Eye]\n\
         BODY Hand: {{name: Hand, mass: 1, collision shape: Sphere, collision geometry: {{radius: 0.1}}}}\n\
         J: {{name: J, type: fixed, parent: {parent}, child: BODY Hand, parent pivot: {{x: 0, y: 0, z: 0}}, \
         child pivot: {{x: 0, y: 0, z: 0}}, parent axis: {{x: 0, y: 0, z: 1}}, child axis: {{x: 0, y: 0, z: 1}}}}\n\
         Eye: {{name: Eye, parent: {parent}}}\n"
    )
}

fn post(namespace: &str, body: &str, mass: u32) -> String {
    format!("namespace: {namespace}\nbodies: [BODY {body}]\nBODY {body}: {{name: {body}, mass: {mass}, inertia: {{ix: 1, iy: 1, iz: 1}}}}\n")
}

/// Messages of warnings and errors about what a launch file names.
fn faults(document: &Value) -> Vec<String> {
    let problems = document["problems"].as_array().expect("a list").iter();
    let text =
        |problem: &Value| format!("{}: {}", problem["file"].as_str().unwrap(), problem["message"].as_str().unwrap());
    problems.filter(|problem| problem["severity"] != "info" && problem["file"] != "launch.yaml").map(text).collect()
}

fn row<'d>(document: &'d Value, file: &str) -> &'d Value {
    let rows = document["files"].as_array().expect("a list");
    rows.iter().find(|row| row["file"] == file).unwrap_or_else(|| panic!("no line of {file}: {document:#}"))
}

#[test]
fn models_of_a_launch_file_find_names_in_each_other() {
    let folder = Folder::new();
    folder.write("launch.yaml", "world config: w.yaml\nmultibody configs: [post.yaml, arm.yaml, lamp.yaml]\n");
    folder.write(
        "w.yaml",
        "enclosure: {length: 4, width: 4, height: 2}\ncameras: [Front]\nFront: {name: Front, parent: BODY Hand}\n",
    );
    folder.write("post.yaml", &post("/cell/", "Post", 0));
    folder.write("arm.yaml", &arm("BODY Post"));
    folder.write("lamp.yaml", "namespace: /cell/\nbodies: []\nlights: [L]\nL: {name: L, parent: /arm/Eye}\n");
    let (document, status) = check(&folder, "launch.yaml");
    assert_eq!((status, faults(&document)), (0, vec![]), "{document:#}");
    assert_eq!(row(&document, "arm.yaml")["needs"], serde_json::json!([["post.yaml"]]));
    assert_eq!(row(&document, "arm.yaml")["built"], serde_json::json!({"bodies": 1, "joints": 1, "cameras": 1}));
    assert_eq!(row(&document, "lamp.yaml")["needs"], serde_json::json!([["arm.yaml"]]));
    assert_eq!(row(&document, "w.yaml")["needs"], serde_json::json!([["arm.yaml"]]));
    assert_eq!(row(&document, "post.yaml")["needs"], serde_json::json!([]));
    let problems = document["problems"].as_array().expect("a list").iter();
    let needs: Vec<_> =
        problems.filter(|problem| problem["kind"] == "other model").map(|p| p["message"].as_str().unwrap()).collect();
    assert_eq!(
        needs,
        [
            "`Front` needs `BODY Hand`, which is in arm.yaml; it is found together with that file (`-l 1`)",
            "`J` needs `BODY Post`, which is in post.yaml; this model is to be loaded together with that file (`-l 0,1`)",
            "`/arm/Eye` needs `BODY Post`, which is in post.yaml; this model is to be loaded together with that file (`-l 0,1`)",
            "`/cell/L` needs `/arm/Eye`, which is in arm.yaml; this model is to be loaded together with that file (`-l 1,2`)",
        ]
    );
    let text = folder.run("--check launch.yaml").stdout;
    assert!(
        text.lines().any(|line| line.starts_with("arm.yaml") && line.contains("1/1") && line.ends_with("post.yaml")),
        "{text}"
    );
    // In whatever order files are named, and whatever other file is named.
    assert_eq!(check(&folder, "arm.yaml launch.yaml").1, 0);
    assert_eq!(check(&folder, "launch.yaml ./arm.yaml").1, 0);
    assert_eq!(check(&folder, "arm.yaml").1, 2, "alone it is not whole");
}

#[test]
fn names_that_no_model_has_stay_errors() {
    let folder = Folder::new();
    folder.write("launch.yaml", "multibody configs: [post.yaml, arm.yaml]\n");
    folder.write("post.yaml", &post("/cell/", "Post", 0));
    folder.write("arm.yaml", &arm("BODY Pots"));
    let (document, status) = check(&folder, "launch.yaml");
    assert_eq!(status, 2);
    let expected = [
        "arm.yaml: `J` is dropped: parent `BODY Pots` is not found",
        "arm.yaml: `/arm/Eye`: parent `BODY Pots` is not found; it stays where it is",
    ];
    assert_eq!(faults(&document), expected);
    assert_eq!(row(&document, "arm.yaml")["built"]["joints"], Value::Null);
    // A body is looked for in the models before; a camera's parent in all.
    folder.write("launch.yaml", "multibody configs: [arm.yaml, post.yaml]\n");
    folder.write("arm.yaml", &arm("BODY Post"));
    let (document, status) = check(&folder, "launch.yaml");
    assert_eq!(status, 2);
    assert_eq!(
        faults(&document),
        ["arm.yaml: `J` is dropped: parent `BODY Post` is not found; it is in post.yaml, which the launch file lists later: list that file \
          before this one, or load it first (`-l 1,0`)"]
    );
    // What is wrong beside the name shows when the name is found.
    folder.write("launch.yaml", "multibody configs: [post.yaml, car.yaml]\n");
    folder.write("car.yaml", "bodies: []\nvehicles: [V]\nV: {name: V, chassis: BODY Post, wheels: []}\n");
    let faults = faults(&check(&folder, "launch.yaml").0);
    assert_eq!(faults, ["car.yaml: `V` is dropped: its chassis has no mass and cannot drive"]);
}

#[test]
fn what_an_element_looks_for_once_its_first_name_is_found_is_judged_too() {
    let folder = Folder::new();
    folder.write("launch.yaml", "multibody configs: [chassis.yaml, wheel.yaml, drive.yaml]\n");
    folder.write("chassis.yaml", &post("/car/", "Chassis", 10));
    folder.write("wheel.yaml", &post("/wheel/", "Wheel", 1));
    let drive = "bodies: []\nvehicles: [V]\nV: {name: V, chassis: BODY Chassis, wheels: [{body: BODY Wheel, radius: 0.1, friction: 1, \
                 roll influence: 0.1, down direction: {x: 0, y: 0, z: -1}, axel direction: {x: 0, y: 1, z: 0}, offset: {x: 0, y: 0, z: 0}, \
                 suspension: {stiffness: 1, damping: 1, compression: 1, rest length: 1}}]}\n";
    folder.write("drive.yaml", drive);
    let (document, status) = check(&folder, "launch.yaml");
    assert_eq!((status, faults(&document)), (0, vec![]), "{document:#}");
    assert_eq!(row(&document, "drive.yaml")["needs"], serde_json::json!([["chassis.yaml"], ["wheel.yaml"]]));
    assert_eq!(row(&document, "drive.yaml")["built"]["vehicles"], 1);
    folder.write("drive.yaml", &drive.replace("BODY Wheel", "BODY Weel"));
    let (document, status) = check(&folder, "launch.yaml");
    let expected = "drive.yaml: `V`: wheel `BODY Weel` is not found; the wheel rolls, but no body shows it";
    assert_eq!((status, faults(&document)), (2, vec![expected.to_owned()]));
}

#[test]
fn alternatives_in_a_launch_file_do_not_disturb_each_other() {
    let folder = Folder::new();
    let listed = "multibody configs: [left.yaml, right.yaml, arm.yaml, arm.yaml, twin.yaml]\n";
    folder.write("launch.yaml", listed);
    // The same names in both, and parts of names that are unique only in one.
    folder.write("left.yaml", &post("/left/", "Post", 0));
    folder.write("right.yaml", &post("/right/", "Post", 0));
    folder.write("arm.yaml", &arm("BODY Post"));
    folder.write(
        "twin.yaml",
        &arm("BODY Hand")
            .replace("BODY Hand: {", "BODY Handle: {")
            .replace("[BODY Hand]", "[BODY Handle]")
            .replace("child: BODY Hand", "child: BODY Handle"),
    );
    let (document, status) = check(&folder, "launch.yaml");
    // The twin's own joint holds its body twice, by a part of its name.
    let faults = faults(&document);
    assert!(faults.iter().all(|line| line.starts_with("twin.yaml")), "{faults:#?}");
    assert_eq!(status, 2);
    assert_eq!(row(&document, "arm.yaml")["needs"], serde_json::json!([["left.yaml", "right.yaml"]]));
    let needs =
        document["problems"].as_array().expect("a list").iter().find(|problem| problem["kind"] == "other model");
    let needs = needs.and_then(|problem| problem["message"].as_str()).expect("a text");
    assert_eq!(
        needs,
        "`J` needs `BODY Post`, which is in left.yaml or right.yaml; this model is to be loaded together with one of them (`-l 0,2`)"
    );
    let alone = check(&folder, "twin.yaml").0;
    assert_eq!(faults, self::faults(&alone));
    // A body that is dropped is not found in an alternative that has it too.
    folder.write("launch.yaml", "multibody configs: [left.yaml, broken.yaml]\n");
    let broken =
        arm("BODY Post").replace("[BODY Hand]", "[BODY Hand, BODY Post]") + "BODY Post: {mass: 0, mesh: absent.stl}\n";
    folder.write("broken.yaml", &broken);
    let (document, status) = check(&folder, "launch.yaml");
    assert_eq!((status, &row(&document, "broken.yaml")["needs"]), (2, &serde_json::json!([])), "{document:#}");
    assert!(self::faults(&document)
        .iter()
        .any(|line| line.ends_with("`J` is dropped: parent `BODY Post` is not found")));
}

#[test]
fn parents_that_are_part_of_several_are_listed() {
    let folder = Folder::new();
    let found = lines(
        &folder,
        "namespace: /n/\nbodies: [camera]\ncamera: {name: camera, mass: 0}\ncameras: [cameraL, cameraL2, Third, Fourth]\nlights: [Lamp]\n\
         cameraL: {name: cameraL}\ncameraL2: {name: cameraL2}\nThird: {name: Third, parent: eraL}\nFourth: {name: Fourth, parent: cameraL}\n\
         Lamp: {name: Lamp, parent: cameraX}\n",
    );
    let found: Vec<_> = found.iter().filter(|line| line.contains("warning")).collect();
    assert_eq!(found.len(), 2, "{found:#?}");
    assert_eq!(
        found[0],
        "m.yaml:8:1: warning: `/n/Third`: parent `eraL` is part of several: `/n/cameraL`, `/n/cameraL2`; it stays where it is"
    );
    assert!(found[1].contains("`/n/Lamp`: parent `cameraX` is not found"), "{found:#?}");
    let found = lines(
        &folder,
        "namespace: /n/\nbodies: [A]\nA: {name: A, mass: 0}\ncameras: [A, C]\nC: {name: C, parent: /n/A}\n",
    );
    assert!(
        found.iter().any(|line| line.contains("parent `/n/A` is the name of several: `/n/A` (body), `/n/A` (camera)")),
        "{found:#?}"
    );
}

#[test]
fn robot_descriptions_are_models() {
    let folder = Folder::new();
    let mesh = |file: &str| format!("<geometry><mesh filename='{file}'/></geometry>");
    folder.write(
        "r.urdf",
        &format!(
            "<robot name='r'><link name='a'><visual>{}</visual><collision>{}</collision></link></robot>",
            mesh("x.stl"),
            mesh("y.stl")
        ),
    );
    folder.write("broken.urdf", "<robot name='r'><link");
    let (document, status) = check(&folder, "r.urdf");
    assert_eq!((status, &document["errors"]), (2, &1.into()), "{document:#}");
    assert_eq!(document["files"][0]["meshes"]["missing"], 2);
    assert_eq!((&document["files"][0]["kind"], &document["files"][0]["built"]["bodies"]), (&"model".into(), &1.into()));
    assert_eq!(problem(&document, "robot description")["original"], "reads none");
    // Remarks are no problems; they were taken off the number of those that are not listed.
    let second = "<joint name='NAME' type='fixed'><parent link='a'/><child link='b'/></joint>";
    let text = ["j", "k"].map(|name| second.replace("NAME", name)).concat();
    folder.write("loop.urdf", &format!("<robot name='r'><link name='a'/><link name='b'/>{text}</robot>"));
    let (document, status) = check(&folder, "loop.urdf");
    assert_eq!((status, &document["errors"], &document["warnings"]), (0, &0.into(), &0.into()), "{document:#}");
    let (document, status) = check(&folder, "broken.urdf");
    assert_eq!(status, 2);
    assert_eq!(problem(&document, "syntax")["line"], 1);
}

#[test]
fn scenes_of_the_original_are_checked() {
    let Some(models) = ambf_test_support::legacy() else { return };
    let folder = Folder::new();
    let (document, status) = check(&folder, &format!("{}/descriptions/launch.yaml", models.display()));
    assert_eq!(status, 2, "some meshes are missing");
    assert_eq!(document["files"][0]["built"]["models"], 23);
    let problems = document["problems"].as_array().expect("a list");
    assert!(problems.iter().all(|problem| problem["file"].as_str().is_some_and(|file| file.ends_with(".yaml"))));
    let errors = problems.iter().filter(|problem| problem["severity"] == "error");
    for error in errors {
        // Nothing but what is not there, and what hangs on it.
        let message = error["message"].as_str().expect("a text");
        assert!(message.contains("does not exist") || message.contains("is not found"), "{error:#}");
    }
}
