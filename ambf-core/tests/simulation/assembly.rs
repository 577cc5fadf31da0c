//! Joints are closed before the first step: in profile `accurate`, where the file does not say otherwise.

use crate::physics_common::{load_texts, Bench, DT};
use ambf_core::adf::Severity;
use ambf_core::comm::JointCommandType;
use ambf_core::ids::BodyId;
use ambf_core::scene::{Loaded, Note, PreparedModel};
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, Point3, Vector3};

const ACCURATE: &str = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\nphysics: {profile: accurate}\n";
const LEGACY: &str = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\n";

/// A base, and two links of 0.5 m on hinges about y; the second lies 1 mm too far along x and 2 mm along z. `{keys}`
/// are keys of its joint.
const ARM: &str = "bodies: [BODY Base, BODY Upper, BODY Lower]\njoints: [JOINT A, JOINT B]\n\
    BODY Base: {name: Base, mass: 0}\n\
    BODY Upper: {name: Upper, mass: 2, inertia: {ix: 0.01, iy: 0.03, iz: 0.03}, location: {position: {x: 0.25, y: 0, z: 0}}}\n\
    BODY Lower: {name: Lower, mass: 1, inertia: {ix: 0.01, iy: 0.02, iz: 0.02}, location: {position: {x: 0.751, y: 0, z: 0.002}}}\n\
    JOINT A: {name: A, type: revolute, parent: BODY Base, child: BODY Upper, parent axis: {x: 0, y: 1, z: 0}, \
    child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: -0.25, y: 0, z: 0}}\n\
    JOINT B: {name: B, type: revolute, parent: BODY Upper, child: BODY Lower, parent axis: {x: 0, y: 1, z: 0}, \
    child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0.25, y: 0, z: 0}, child pivot: {x: -0.25, y: 0, z: 0}{keys}}\n";

fn arm(keys: &str) -> String {
    ARM.replace("{keys}", keys)
}

/// Distance of the pivots of joint `B` of [`ARM`], m.
fn gap_of(bench: &Bench) -> f64 {
    let end = bench.pose("Upper") * Point3::new(0.25, 0.0, 0.0);
    (bench.pose("Lower") * Point3::new(-0.25, 0.0, 0.0) - end).norm()
}

fn said<'a>(notes: &'a [Note], words: &str) -> Vec<&'a Note> {
    notes.iter().filter(|note| note.message.contains(words)).collect()
}

#[test]
fn accurate_scenes_start_and_restart_on_their_joints() {
    let mut bench = Bench::new(ACCURATE, &arm(""));
    assert!(gap_of(&bench) < 1e-12, "{}", gap_of(&bench));
    let start: Vec<Isometry3<f64>> = ["Base", "Upper", "Lower"].map(|name| bench.pose(name)).to_vec();
    assert_eq!(start[0], Isometry3::identity());
    for (name, start) in ["Base", "Upper", "Lower"].into_iter().zip(&start) {
        assert!((bench.reported(name).translation.vector - start.translation.vector).norm() < 1e-15);
        let (linear, angular) = bench.velocity(name);
        assert_eq!((linear, angular), (Vector3::zeros(), Vector3::zeros()));
    }
    bench.steps(200);
    assert!((bench.position("Lower") - start[2].translation.vector).norm() > 0.05);
    bench.0.reset_world();
    assert_eq!(bench.pose("Lower"), start[2]);
    assert_eq!(bench.pose("Upper"), start[1]);
}

#[test]
fn the_report_says_how_far_bodies_are_displaced() {
    let Loaded { report, .. } = load_texts(ACCURATE, &[&arm("")]);
    let notes = said(&report.notes, "displaced");
    assert_eq!(notes.len(), 1, "{report}");
    assert_eq!(notes[0].severity, Severity::Info);
    assert!(
        notes[0].message.starts_with("2 bodies are displaced so that the joints close: `BODY Lower` by "),
        "{report}"
    );
    assert!(notes[0].message.contains(" mm and ") && notes[0].message.ends_with('°'), "{report}");
    assert_eq!(notes[0].source.line, 5, "{report}");
    // The file's own digits are not worth a line.
    let exact = arm("").replace("x: 0.751, y: 0, z: 0.002", "x: 0.7500001, y: 0, z: 0");
    let Loaded { report, .. } = load_texts(ACCURATE, &[&exact]);
    assert!(said(&report.notes, "displaced").is_empty(), "{report}");
}

#[test]
fn bodies_far_from_their_joints_are_worth_a_warning() {
    let far = arm("").replace("x: 0.751", "x: 1.5");
    let Loaded { report, .. } = load_texts(ACCURATE, &[&far]);
    let notes = said(&report.notes, "displaced");
    assert_eq!((notes.len(), notes[0].severity), (1, Severity::Warning), "{report}");
    assert!(gap_of(&Bench::new(ACCURATE, &far)) < 1e-12);
}

#[test]
fn legacy_scenes_start_as_written() {
    let Loaded { report, .. } = load_texts(LEGACY, &[&arm("")]);
    assert!(said(&report.notes, "displaced").is_empty(), "{report}");
    let bench = Bench::new(LEGACY, &arm(""));
    assert_eq!(bench.position("Lower"), Vector3::new(0.751, 0.0, 0.002));
    assert_eq!(bench.position("Upper"), Vector3::new(0.25, 0.0, 0.0));
}

#[test]
fn a_joint_that_is_not_to_be_assembled_starts_open_and_closes_in_motion() {
    let text = arm(", assemble: false");
    let Loaded { report, scene } = load_texts(ACCURATE, &[&text]);
    assert!(said(&report.notes, "displaced").is_empty(), "{report}");
    assert!(scene.world.bodies().iter().all(|&body| scene.world.articulation(body).is_none()));
    let mut bench = Bench::new(ACCURATE, &text);
    assert_eq!(bench.position("Lower"), Vector3::new(0.751, 0.0, 0.002));
    bench.steps(100);
    assert!(gap_of(&bench) < 1e-4, "{}", gap_of(&bench));
    // Nothing is given up for a joint that is closed anyway.
    let exact = text.replace("x: 0.751, y: 0, z: 0.002", "x: 0.75, y: 0, z: 0");
    let scene = load_texts(ACCURATE, &[&exact]).scene;
    assert!(scene.world.articulation(scene.world.bodies()[2]).is_some());
}

#[test]
fn limits_hold_from_the_start_as_bullet_reads_them() {
    for (kind, axis, high) in [
        ("revolute", "{x: 0, y: 1, z: 0}", -0.3),
        ("prismatic", "{x: 1, y: 0, z: 0}", -0.04),
        ("torsion spring", "{x: 0, y: 1, z: 0}", -0.3),
        ("linear spring", "{x: 1, y: 0, z: 0}", -0.04),
    ] {
        let limits = format!(", joint limits: {{low: {}, high: {high}}}, stiffness: 1, damping: 1", 2.0 * high);
        let (before, last) = ARM.split_at(ARM.find("JOINT B: {").expect("it is there"));
        let last = last.replace("{x: 0, y: 1, z: 0}", axis).replace("type: revolute", &format!("type: {kind}"));
        let text = format!("{before}{}", last.replace("{keys}", &limits));
        for articulated in [true, false] {
            let world = ACCURATE.replace("accurate}", &format!("accurate, articulated: {articulated}}}"));
            let position = Bench::new(&world, &text).joint("B").position;
            assert!((position - high).abs() < 1e-9, "{kind}: {position} instead of {high}");
        }
    }
}

#[test]
fn what_cannot_be_closed_is_named_with_what_remains() {
    // A link of 0.5 m between two hinges 0.52 m apart on static bodies.
    let text = "bodies: [BODY Base, BODY Link]\njoints: [JOINT A, JOINT B]\n\
        BODY Base: {name: Base, mass: 0}\n\
        BODY Link: {name: Link, mass: 1, inertia: {ix: 0.01, iy: 0.02, iz: 0.02}, location: {position: {x: 0.25, y: 0, z: 0}}}\n\
        JOINT A: {name: A, type: revolute, parent: BODY Base, child: BODY Link, parent axis: {x: 0, y: 1, z: 0}, \
        child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: -0.25, y: 0, z: 0}}\n\
        JOINT B: {name: B, type: revolute, parent: BODY Base, child: BODY Link, parent axis: {x: 0, y: 1, z: 0}, \
        child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0.52, y: 0, z: 0}, child pivot: {x: 0.25, y: 0, z: 0}}\n";
    let Loaded { report, scene } = load_texts(ACCURATE, &[text]);
    let mut notes = said(&report.notes, "cannot be closed");
    notes.sort_by_key(|note| note.source.line);
    assert_eq!(notes.len(), 2, "{report}");
    for (note, (name, line)) in notes.iter().zip([("`A` ", 5), ("`B` ", 6)]) {
        assert_eq!((note.severity, note.source.line), (Severity::Warning, line), "{report}");
        assert!(note.message.starts_with(name) && note.message.contains(": 1.000e-2 m and "), "{report}");
    }
    let middle = scene.world.pose(scene.world.bodies()[1]).expect("a live body").translation.vector;
    assert!((middle - Vector3::new(0.26, 0.0, 0.0)).norm() < 1e-9, "{middle}");
}

/// Correcting what cannot be corrected moves a mechanism along its freedom, for the little that its errors shrink by
/// that.
#[test]
fn what_cannot_be_closed_does_not_creep() {
    // A parallelogram of rods of 0.3 m and 0.4 m, one of whose hinges is 1e-3 rad off parallel.
    let rod = |name: &str, place: &str| {
        format!("BODY {name}: {{name: {name}, mass: 1, inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}, location: {{position: {place}}}}}\n")
    };
    let hinge = |name: &str, parent: &str, child: &str, at: &str, of: &str, axis: &str| {
        format!(
            "JOINT {name}: {{name: {name}, type: revolute, parent: BODY {parent}, child: BODY {child}, parent axis: {{x: 0, y: 1, z: 0}}, \
             child axis: {axis}, parent pivot: {at}, child pivot: {of}}}\n"
        )
    };
    let (straight, skew) = ("{x: 0, y: 1, z: 0}", "{x: 0.001, y: 1, z: 0.0005}");
    let text = "bodies: [BODY Base, BODY Left, BODY Right, BODY Top]\njoints: [JOINT A, JOINT B, JOINT C, JOINT D]\n\
        BODY Base: {name: Base, mass: 0}\n"
        .to_owned()
        + &rod("Left", "{x: 0.1, y: 0, z: 0.141}")
        + &rod("Right", "{x: 0.5, y: 0, z: 0.141}")
        + &rod("Top", "{x: 0.4, y: 0, z: 0.282}")
        + &hinge("A", "Base", "Left", "{x: 0, y: 0, z: 0}", "{x: -0.1, y: 0, z: -0.141}", straight)
        + &hinge("B", "Base", "Right", "{x: 0.4, y: 0, z: 0}", "{x: -0.1, y: 0, z: -0.141}", skew)
        + &hinge("C", "Left", "Top", "{x: 0.1, y: 0, z: 0.141}", "{x: -0.2, y: 0, z: 0}", straight)
        + &hinge("D", "Right", "Top", "{x: 0.1, y: 0, z: 0.141}", "{x: 0.2, y: 0, z: 0}", straight);
    let world = ACCURATE.replace("z: -10", "z: 0");
    let mut bench = Bench::new(&world, &text);
    bench.steps(100);
    let start = bench.position("Top");
    bench.steps(3000);
    let way = (bench.position("Top") - start).norm();
    assert!(way < 1e-4, "{way} m");
}

#[test]
fn of_a_model_added_at_run_time_only_its_own_bodies_move() {
    let mut bench = Bench::new(ACCURATE, &arm(""));
    bench.steps(50);
    let before = bench.pose("Lower");
    let text = "bodies: [BODY Tool]\njoints: [JOINT T]\n\
        BODY Tool: {name: Tool, mass: 0.1, inertia: {ix: 0.001, iy: 0.001, iz: 0.001}, location: {position: {x: 1.1, y: 0, z: 0}}}\n\
        JOINT T: {name: T, type: fixed, parent: BODY Lower, child: BODY Tool, parent axis: {x: 0, y: 1, z: 0}, \
        child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0.25, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}}\n";
    let file = std::env::temp_dir().join(format!("ambf_assembly_{}.yaml", std::process::id()));
    std::fs::write(&file, text).expect("written");
    let prepared = PreparedModel::read(&file);
    std::fs::remove_file(&file).expect("removed");
    let added = bench.0.add_model(prepared.expect("a model")).expect("something is built");
    assert!(added.report.contains("1 body is displaced"), "{}", added.report);
    assert_eq!(bench.pose("Lower"), before);
    let tip = before * Point3::new(0.25, 0.0, 0.0);
    assert!((bench.position("Tool") - tip.coords).norm() < 1e-12);
}

#[test]
fn a_robot_whose_joints_are_closed_is_loaded_as_it_is() {
    let exact = arm("").replace("x: 0.751, y: 0, z: 0.002", "x: 0.75, y: 0, z: 0");
    let Loaded { scene, .. } = load_texts(ACCURATE, &[&exact]);
    let simulation = Simulation::new(scene, DT);
    let pose = simulation.scene().bodies[BodyId::new(2)].initial_pose;
    assert_eq!(pose.translation.vector, Vector3::new(0.75, 0.0, 0.0));
}

/// A rail on three bars: a parallelogram whose pivots are off by up to 0.4 mm of 0.2 m, and whose axes by up to 4 mrad, times
/// `error`.
fn parallelogram(error: f64) -> String {
    let bars = 3;
    let names: Vec<String> = (0..bars).map(|bar| format!("BODY Bar{bar}")).collect();
    let joints: Vec<String> =
        (0..bars).flat_map(|bar| [format!("JOINT Foot{bar}"), format!("JOINT Head{bar}")]).collect();
    let mut text = format!(
        "bodies: [BODY Base, BODY Rail, {}]\njoints: [{}]\nBODY Base: {{name: Base, mass: 0}}\n\
         BODY Rail: {{name: Rail, mass: 1, inertia: {{ix: 0.001, iy: 0.01, iz: 0.01}}, location: {{position: {{x: 0.1, y: 0, z: 0.2}}}}}}\n",
        names.join(", "),
        joints.join(", ")
    );
    for bar in 0..bars {
        let x = [0.0, 0.2, 0.13][bar];
        let off = error * [0.0, 3e-4, -4e-4][bar];
        let end = |name: &str, parent: &str, pivot: [f64; 2], child: f64, tilt: f64| {
            format!(
                "JOINT {name}{bar}: {{name: {name}{bar}, type: revolute, parent: BODY {parent}, child: BODY Bar{bar}, \
                 parent axis: {{x: {tilt}, y: 1, z: 0}}, child axis: {{x: 0, y: 1, z: 0}}, parent pivot: {{x: {}, y: 0, z: {}}}, \
                 child pivot: {{x: 0, y: 0, z: {child}}}, joint limits: {{low: -1.2, high: 1.2}}, max motor impulse: 1}}\n",
                pivot[0], pivot[1]
            )
        };
        text += &format!(
            "BODY Bar{bar}: {{name: Bar{bar}, mass: 0.2, inertia: {{ix: 0.001, iy: 0.001, iz: 0.0001}}, location: {{position: {{x: {x}, y: 0, z: 0.1}}}}}}\n"
        );
        text += &end("Foot", "Base", [x, 0.0], -0.1, 10.0 * off);
        text += &end("Head", "Rail", [x - 0.1 + off, 0.0], 0.1 + off, 0.0);
    }
    text
}

#[test]
fn parallelograms_with_inaccurate_dimensions_move() {
    let Loaded { report, .. } = load_texts(ACCURATE, &[&parallelogram(1.0)]);
    let notes = said(&report.notes, "that repeat others are left out: ");
    assert_eq!((notes.len(), notes[0].severity), (1, Severity::Info), "{report}");
    assert!(said(&report.notes, "cannot be closed").is_empty(), "{report}");
    let mut bench = Bench::new(ACCURATE, &parallelogram(1.0));
    for goal in [0.6, -0.9, 0.0] {
        bench.command("Base", 0, JointCommandType::Position, goal, 1500);
        let reached: Vec<f64> = (0..3).map(|bar| bench.joint(&format!("Foot{bar}")).position).collect();
        assert!(reached.iter().all(|angle| (angle - goal).abs() < 0.02), "{goal} rad: {reached:?}");
    }
}

#[test]
fn parallelograms_with_inaccurate_dimensions_swing_like_exact_ones() {
    // The bars are pulled upwards and to a side. A motor that may do nothing leaves the joints free.
    let world = ACCURATE.replace("{x: 0, y: 0, z: -10}", "{x: 3, y: 0, z: 10}");
    let swing = |error: f64| {
        let free = parallelogram(error).replace("max motor impulse: 1", "max motor impulse: 0");
        let mut bench = Bench::new(&world, &free);
        [150, 150, 150].map(|steps| {
            bench.steps(steps);
            bench.joint("Foot0").position
        })
    };
    let exact = swing(0.0);
    assert!(exact.iter().all(|angle| angle.abs() > 0.1), "it swings, rad: {exact:?}");
    for (error, allowed) in [(1.0, 0.03), (0.1, 0.003), (0.01, 3e-4)] {
        let angles = swing(error);
        println!("errors of {:.4} mm: {angles:.4?} rad, exact dimensions {exact:.4?} rad", 0.4 * error);
        let most = angles.iter().zip(&exact).map(|(angle, exact)| (angle - exact).abs()).fold(0.0, f64::max);
        assert!(most < allowed, "errors of {:.4} mm: {angles:?}, exact {exact:?}", 0.4 * error);
    }
}

#[test]
fn loops_that_are_taken_apart_have_all_their_rows() {
    let mut bench = Bench::new(ACCURATE, &parallelogram(1.0));
    bench.command("Base", 0, JointCommandType::Position, 0.5, 1500);
    let bar = bench.body("Bar0");
    bench.0.remove_body(bar).expect("it is there");
    bench.steps(2000);
    // What is left is the parallelogram of two bars, that hangs on its joints.
    for name in ["Foot1", "Head1", "Foot2", "Head2"] {
        let joint = bench.joint(name);
        let [a, b] = [joint.parent, joint.child].map(|body| {
            let scene = bench.0.scene();
            scene.world.pose(scene.world.bodies()[body.index()]).expect("it is there")
        });
        let (a, b) = (a * joint.frames[0], b * joint.frames[1]);
        let gap = (a.translation.vector - b.translation.vector).norm();
        assert!(gap < 1e-4, "{name}: {gap} m");
    }
}

#[test]
fn an_arm_follows_its_base_wherever_that_was_moved() {
    let light = arm("").replace("ix: 0.01, iy: 0.03, iz: 0.03", "ix: 1e-6, iy: 1e-6, iz: 1e-6");
    let light = light.replace("ix: 0.01, iy: 0.02, iz: 0.02", "ix: 1e-6, iy: 1e-6, iz: 1e-6");
    for (x, roll, pitch, yaw) in [(0.8, 0.5, 1.0, 2.5), (-3.0, 3.0, 0.0, 0.0), (0.0, 0.0, 3.1, 0.0)] {
        let place = format!(
            "location: {{position: {{x: {x}, y: 0.3, z: 0.5}}, orientation: {{r: {roll}, p: {pitch}, y: {yaw}}}}}"
        );
        let moved = light.replace("mass: 0}", &format!("mass: 0, {place}}}"));
        let Loaded { report, scene } = load_texts(ACCURATE, &[&moved]);
        assert!(said(&report.notes, "cannot be closed").is_empty(), "{report}");
        assert_eq!(said(&report.notes, "reduced coordinates: 2").len(), 1, "{report}");
        let bench = Bench(Simulation::new(scene, DT));
        assert!(gap_of(&bench) < 1e-9, "{}", gap_of(&bench));
    }
}

#[test]
fn what_cannot_turn_is_said_to_lack_an_inertia() {
    let without = arm("").replace("inertia: {ix: 0.01, iy: 0.02, iz: 0.02}, ", "");
    for world in [LEGACY, ACCURATE] {
        let Loaded { report, .. } = load_texts(world, &[&without]);
        let notes = said(&report.notes, "has no inertia");
        assert_eq!((notes.len(), notes[0].severity), (1, Severity::Warning), "{report}");
        assert!(notes[0].message.starts_with("`BODY Lower`"), "{report}");
        assert!(said(&report.notes, "cannot be closed").is_empty(), "{report}");
    }
}
