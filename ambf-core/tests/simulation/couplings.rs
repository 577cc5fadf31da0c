//! Coupled joints, and loops of robots read from URDF, in both profiles: in trees, in loops and as constraints between bodies. `mimic`
//! had no effect, and a second joint to a link was dropped.

use std::fmt::Write as _;

use ambf_core::comm::JointCommandType::{Effort, Position};
use ambf_core::control::Profile;
use ambf_core::ids::JointId;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions, SetStateError, StateChange};
use ambf_core::sim::{Simulation, Stepper};
use nalgebra::{Point3, Vector3};
use tempfile::TempDir;

use crate::physics_common::{close, Bench, DT};

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];
const WEIGHTLESS: &str = "gravity: {x: 0, y: 0, z: 0}\nmax iterations: 50\n";
const HEAVY: &str = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\n";

/// Joints in reduced coordinates where they form trees, or constraints between bodies.
const COORDINATES: [Option<bool>; 2] = [None, Some(false)];

/// A scene of one model: a robot, or a model of ADF.
fn loaded(profile: Profile, articulated: Option<bool>, world: &str, model: &str) -> Loaded {
    let folder = TempDir::new().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let name = if model.starts_with('<') { "m.urdf" } else { "m.yaml" };
    let files = SceneFiles { world: Some(write("world.yaml", world)), models: vec![write(name, model)] };
    let physics = PhysicsOptions { profile: Some(profile), articulated, ..PhysicsOptions::default() };
    load(&files, &SceneOptions { physics, savable: true, ..SceneOptions::default() })
}

fn bench(profile: Profile, articulated: Option<bool>, world: &str, model: &str) -> Bench {
    let Loaded { scene, report } = loaded(profile, articulated, world, model);
    assert_eq!(report.errors(), 0, "{report}");
    Bench(Simulation::new(scene, DT))
}

fn link(name: &str, mass: f64, moment: f64, centre: &str) -> String {
    format!(
        "<link name='{name}'><inertial><origin xyz='{centre}'/><mass value='{mass}'/><inertia ixx='{moment}' iyy='{moment}' \
         izz='{moment}' ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )
}

fn joint(name: &str, kind: &str, parent: &str, child: &str, axis: &str, inside: &str) -> String {
    format!(
        "<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/><axis xyz='{axis}'/>{inside}</joint>"
    )
}

const LIMIT: &str = "<limit lower='-9' upper='9' effort='50' velocity='99'/>";

fn mimic(of: &str, ratio: f64, offset: f64) -> String {
    format!("<mimic joint='{of}' multiplier='{ratio}' offset='{offset}'/>")
}

/// Two fingers of 0.1 kg on a slide each; the second follows the first with the factor -1.
fn fingers() -> String {
    format!(
        "<robot name='r'><link name='world'/>{}{}{}{}</robot>",
        link("left", 0.1, 1e-4, "0 0 0"),
        link("right", 0.1, 1e-4, "0 0 0"),
        joint("lead", "prismatic", "world", "left", "1 0 0", LIMIT),
        joint("follow", "prismatic", "world", "right", "1 0 0", &format!("{LIMIT}{}", mimic("lead", -1.0, 0.0))),
    )
}

fn position(bench: &Bench, joint: &str) -> f64 {
    bench.joint(joint).position
}

#[test]
fn a_leader_moves_both_masses_and_the_follower_stays_with_it() {
    for profile in PROFILES {
        for articulated in COORDINATES {
            for (joint, sign) in [(0, 1.0), (1, -1.0)] {
                let mut bench = bench(profile, articulated, WEIGHTLESS, &fingers());
                bench.command("world", joint, Effort, 5.0, 100);
                let (lead, follow) = (position(&bench, "lead"), position(&bench, "follow"));
                let what = format!("{profile:?} {articulated:?}: {lead} and {follow} m");
                assert!((lead + follow).abs() < 1e-6, "{what}");
                // 5 N on 0.2 kg for 0.1 s.
                assert!((lead - sign * 0.125).abs() < 3e-3, "{what}");
            }
        }
    }
}

/// Angular acceleration of `a`, rad/s², by 1 N·m on it and by 1 N on the slide `b`, which follows it by 0.05 m/rad.
#[test]
fn a_rack_reflects_its_mass_and_its_load() {
    let text = format!(
        "<robot name='r'><link name='world'/>{}{}{}{}</robot>",
        link("a", 1.0, 0.01, "0 0 0"),
        link("b", 8.0, 0.01, "0 0 0"),
        joint("turn", "continuous", "world", "a", "0 1 0", ""),
        joint("slide", "prismatic", "world", "b", "0 0 1", &format!("{LIMIT}{}", mimic("turn", 0.05, 0.0))),
    );
    for profile in PROFILES {
        for articulated in COORDINATES {
            // 0.01 + 8 · 0.05² = 0.03 kg·m².
            for (index, effort, expected) in [(0, 1.0, 1.0 / 0.03), (1, 1.0, 0.05 / 0.03)] {
                let mut bench = bench(profile, articulated, WEIGHTLESS, &text);
                bench.command("world", index, Effort, effort, 50);
                close(bench.velocity("a").1.y / 0.05, expected, 0.02 * expected);
            }
            // The weight of the slide, 80 N, turns the gear; more than ten turns are counted.
            let mut bench = bench(profile, articulated, HEAVY, &text);
            bench.steps(1000);
            let (way, rate) = (bench.position("b").z, bench.velocity("b").0.z);
            let expected = -10.0 * 8.0 / (8.0 + 0.01 / 0.0025);
            // The damping of bodies takes 3 %.
            close(rate, 0.97 * expected, 0.05);
            assert!(way / 0.05 < -50.0, "{way} m");
            let turn = bench.velocity("a").1.y;
            close(rate, 0.05 * turn, 1e-6);
            let apart = bench.0.scene().coupling_error(JointId::new(1)).expect("it follows");
            assert!(apart.abs() < 1e-6, "{profile:?} {articulated:?}: {apart} m");
        }
    }
}

/// ADF: three wheels on the ground, of 0.01, 0.02 and 0.04 kg·m², about z; keys of the joint of the third.
fn wheels(coupling: &str) -> String {
    let mut text = String::from(
        "bodies: [BODY base, BODY w0, BODY w1, BODY w2]\njoints: [JOINT j0, JOINT j1, JOINT j2]\nBODY base: {name: base, mass: 0}\n",
    );
    for (i, moment) in [0.01, 0.02, 0.04].into_iter().enumerate() {
        let keys = if i == 2 { coupling } else { "" };
        write!(
            text,
            "BODY w{i}: {{name: w{i}, mass: 1, inertia: {{ix: {moment}, iy: {moment}, iz: {moment}}}, \
             damping: {{linear: 0, angular: 0}}, location: {{position: {{x: {i}, y: 0, z: 0}}}}}}\n\
             JOINT j{i}: {{name: j{i}, type: revolute, parent: BODY base, child: BODY w{i}, parent axis: {{x: 0, y: 0, z: 1}}, \
             child axis: {{x: 0, y: 0, z: 1}}, parent pivot: {{x: {i}, y: 0, z: 0}}, child pivot: {{x: 0, y: 0, z: 0}}{keys}}}\n"
        )
        .expect("a text");
    }
    text
}

#[test]
fn a_differential_adds_two_joints() {
    // q2 = 0.5 q0 + 0.5 q1: with 1 N·m on the third, the two others have the accelerations a = 0.5 λ / I each.
    let text = wheels(", coupling: {joints: [JOINT j0, JOINT j1], ratios: [0.5, 0.5]}");
    for profile in PROFILES {
        for articulated in COORDINATES {
            let mut bench = bench(profile, articulated, WEIGHTLESS, &text);
            bench.command("base", 2, Effort, 1.0, 50);
            let [w0, w1, w2] = ["w0", "w1", "w2"].map(|name| bench.velocity(name).1.z / 0.05);
            let through = 0.25 / 0.01 + 0.25 / 0.02;
            let carried = 1.0 / (1.0 + 0.04 * through);
            // In `accurate` forces act for half of the first sub-step.
            close(w0, 0.5 * carried / 0.01, 0.3);
            close(w1, 0.5 * carried / 0.02, 0.15);
            close(w2, 0.5 * (w0 + w1), 1e-6);
            // The third is held: the first two turn against each other.
            bench.command("base", 2, Effort, 0.0, 1);
            let apart = position(&bench, "j2") - 0.5 * (position(&bench, "j0") + position(&bench, "j1"));
            assert!(apart.abs() < 1e-6, "{profile:?} {articulated:?}: {apart}");
        }
    }
}

#[test]
fn coupled_pendulums_have_the_order_of_their_method() {
    // The first of 1 kg at 0.5 m, the second of 2 kg at 0.25 m, which turns by -2 times the angle of the first.
    let mut text = String::from(
        "bodies: [BODY base, BODY b0, BODY b1]\njoints: [JOINT j0, JOINT j1]\nBODY base: {name: base, mass: 0}\n",
    );
    for (i, (mass, moment, arm)) in [(1.0, 0.01, 0.5), (2.0, 0.02, 0.25)].into_iter().enumerate() {
        let keys = if i == 1 { ", coupling: {joint: JOINT j0, ratio: -2}" } else { "" };
        write!(
            text,
            "BODY b{i}: {{name: b{i}, mass: {mass}, inertia: {{ix: {moment}, iy: {moment}, iz: {moment}}}, \
             damping: {{linear: 0, angular: 0}}, location: {{position: {{x: 0, y: {i}, z: -{arm}}}}}}}\n\
             JOINT j{i}: {{name: j{i}, type: revolute, parent: BODY base, child: BODY b{i}, parent axis: {{x: 0, y: 1, z: 0}}, \
             child axis: {{x: 0, y: 1, z: 0}}, parent pivot: {{x: 0, y: {i}, z: 0}}, child pivot: {{x: 0, y: 0, z: {arm}}}{keys}}}\n"
        )
        .expect("a text");
    }
    let inertia = 0.01 + 0.25 + 4.0 * (0.02 + 2.0 * 0.0625);
    let accelerate = |q: f64| -(10.0 * 0.5 * q.sin() + 2.0 * 2.0 * 10.0 * 0.25 * (2.0 * q).sin()) / inertia;
    // A fine Runge-Kutta integration of the equation of motion.
    let (mut q, mut v, h) = (0.0, 3.0, 1e-5);
    for _ in 0..100_000 {
        let k = [v, accelerate(q)];
        let l = [v + h / 2.0 * k[1], accelerate(q + h / 2.0 * k[0])];
        let m = [v + h / 2.0 * l[1], accelerate(q + h / 2.0 * l[0])];
        let n = [v + h * m[1], accelerate(q + h * m[0])];
        q += h / 6.0 * (k[0] + 2.0 * l[0] + 2.0 * m[0] + n[0]);
        v += h / 6.0 * (k[1] + 2.0 * l[1] + 2.0 * m[1] + n[1]);
    }
    let miss = |step: f64| {
        let Loaded { scene, .. } = loaded(Profile::Accurate, None, HEAVY, &text);
        let mut stepper = Stepper::new(Simulation::new(scene, step), step);
        let j = JointId::new(0);
        stepper.set_state(&StateChange { rates: vec![(j, 3.0)], ..StateChange::default() }).expect("a leader");
        stepper.step((1.0 / step).round() as u32).expect("sound");
        let joints = &stepper.simulation().scene().joints;
        assert!((joints[JointId::new(1)].position + 2.0 * joints[j].position).abs() < 1e-12);
        (joints[j].position - q).abs()
    };
    let (fine, coarse) = (miss(0.005), miss(0.01));
    assert!(fine < 1e-7 && coarse < 2e-6, "{fine:e} and {coarse:e} rad");
    assert!(coarse / fine > 8.0, "{fine:e} and {coarse:e} rad");
}

#[test]
fn motors_on_either_side_act_and_limits_of_either_hold() {
    let text = fingers().replace(
        "lower='-9' upper='9' effort='50' velocity='99'/><mimic",
        "lower='-0.02' upper='9' effort='50'/><mimic",
    );
    for profile in PROFILES {
        for articulated in COORDINATES {
            for (index, goal, lead) in [(0, 0.01, 0.01), (1, -0.015, 0.015), (0, 0.05, 0.02)] {
                let mut bench = bench(profile, articulated, WEIGHTLESS, &text);
                bench.command("world", index, Position, goal, 3000);
                let what = format!("{profile:?} {articulated:?}: joint {index} to {goal}");
                let (found, follow) = (position(&bench, "lead"), position(&bench, "follow"));
                assert!((found - lead).abs() < 1e-3, "{what}: {found}");
                assert!((found + follow).abs() < 1e-5, "{what}: {found} and {follow}");
            }
        }
    }
}

#[test]
fn what_two_fingers_hold_stays_in_the_middle() {
    let finger = |name: &str| {
        link(name, 0.1, 1e-4, "0 0 0")
            .replace("</link>", "<collision><geometry><box size='0.01 0.04 0.04'/></geometry></collision></link>")
    };
    let slide = |name: &str, child: &str, axis: &str, x: f64, inside: &str| {
        joint(
            name,
            "prismatic",
            "palm",
            child,
            axis,
            &format!("<origin xyz='{x} 0 0'/><limit lower='0' upper='0.1' effort='20'/>{inside}"),
        )
    };
    let text = format!(
        "<robot name='r'><link name='world'/>{}{}{}{}{}{}</robot>",
        link("palm", 1.0, 1e-3, "0 0 0"),
        finger("left"),
        finger("right"),
        joint("mount", "fixed", "world", "palm", "1 0 0", ""),
        slide("lead", "left", "1 0 0", -0.06, ""),
        slide("follow", "right", "-1 0 0", 0.06, &mimic("lead", 1.0, 0.0)),
    );
    let cube = "bodies: [BODY cube]\nBODY cube: {name: cube, mass: 0.2, mesh: '', collision shape: BOX, collision geometry: \
                {x: 0.04, y: 0.04, z: 0.04}, location: {position: {x: 0.01, y: 0, z: 0}}, friction: {static: 1, rolling: 0}, \
                collision margin: 0.0005}\n";
    for profile in PROFILES {
        let folder = TempDir::new().expect("a temporary folder");
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect("written");
            path
        };
        let files = SceneFiles {
            world: Some(write("world.yaml", WEIGHTLESS)),
            models: vec![write("r.urdf", &text), write("cube.yaml", cube)],
        };
        let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
        let Loaded { scene, report } = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
        assert_eq!(report.errors(), 0, "{report}");
        let mut bench = Bench(Simulation::new(scene, DT));
        bench.command("palm", 0, Effort, 10.0, 1000);
        // Pushed to one side by a third of the grip's force.
        for _ in 0..1000 {
            bench.push("cube", Vector3::x() * 3.0);
            bench.command("palm", 0, Effort, 10.0, 1);
        }
        let (cube, lead, follow) = (bench.position("cube"), position(&bench, "lead"), position(&bench, "follow"));
        let most = if profile == Profile::Accurate { 1e-4 } else { 1e-3 };
        assert!(cube.x.abs() < most && cube.yz().norm() < 5e-3, "{profile:?}: {cube}");
        assert!((lead - follow).abs() < most && lead > 0.02, "{profile:?}: {lead} and {follow}");
    }
}

/// A parallelogram of cranks a and b (0.3 m) on the world and a coupler c (0.5 m); its second pin has two parents.
fn parallelogram(more: &str) -> String {
    let crank = |name: &str| link(name, 1.0, 0.02, "0.15 0 0");
    let origin = |xyz: &str, pitch: f64| format!("<origin xyz='{xyz}' rpy='0 {pitch} 0'/>");
    format!(
        "<robot name='r'><link name='world'/>{}{}{}<link name='pin'/>{}{}{}{}{}{more}</robot>",
        crank("a"),
        crank("b"),
        link("c", 1.0, 0.02, "0.25 0 0"),
        joint("jp", "fixed", "c", "pin", "1 0 0", &origin("0.5 0 0", 0.0)),
        joint("j1", "continuous", "world", "a", "0 1 0", &origin("0 0 1", -1.2)),
        joint("j2", "continuous", "a", "c", "0 1 0", &origin("0.3 0 0", 1.2)),
        joint("j3", "continuous", "world", "b", "0 1 0", &origin("0.5 0 1", -1.2)),
        joint("j4", "continuous", "b", "pin", "0 1 0", &origin("0.3 0 0", 1.2)),
    )
}

/// Distance of the second pin's two places, m.
fn gap(bench: &Bench) -> f64 {
    (bench.pose("b") * Point3::new(0.3, 0.0, 0.0) - bench.pose("c") * Point3::new(0.5, 0.0, 0.0)).norm()
}

#[test]
fn a_link_with_two_parents_closes_a_loop() {
    for (profile, most) in [(Profile::Legacy, 1e-3), (Profile::Accurate, 1e-5)] {
        let mut bench = bench(profile, None, HEAVY, &parallelogram(""));
        let (mut widest, mut fastest) = (0.0_f64, 0.0_f64);
        for _ in 0..1000 {
            bench.update(DT);
            widest = widest.max(gap(&bench));
            fastest = fastest.max(bench.velocity("a").1.norm());
        }
        assert!(widest < most, "{profile:?}: {widest} m");
        assert!((bench.pose("a").translation.vector - Vector3::z()).norm() < 1e-3);
        assert!(fastest > 3.0, "it swings")
    }
}

#[test]
fn a_loop_may_have_couplings() {
    // The crank of the parallelogram lifts a weight by a rack.
    let more = link("load", 5.0, 0.01, "0 0 0")
        + &joint("rack", "prismatic", "world", "load", "0 0 1", &format!("{LIMIT}{}", mimic("j1", 0.2, 0.1)));
    for (profile, most) in [(Profile::Legacy, 1e-3), (Profile::Accurate, 1e-5)] {
        let mut bench = bench(profile, None, HEAVY, &parallelogram(&more));
        close(position(&bench, "rack"), 0.1, 1e-9);
        let (mut widest, mut apart) = (0.0_f64, 0.0_f64);
        for _ in 0..500 {
            bench.update(DT);
            widest = widest.max(gap(&bench));
            let scene = bench.0.scene();
            let rack = scene.joints.position(|joint| joint.name == "rack").expect("a joint");
            apart = apart.max(scene.coupling_error(rack).expect("it follows").abs());
        }
        assert!(widest < most && apart < most, "{profile:?}: {widest} and {apart} m");
        assert!(bench.velocity("load").0.z.abs() > 0.05, "it moves");
    }
}

#[test]
fn states_resets_and_saved_states_keep_couplings_closed() {
    for profile in PROFILES {
        for articulated in COORDINATES {
            let what = format!("{profile:?} {articulated:?}");
            let text = wheels(", coupling: {joint: JOINT j0, ratio: 0.4, offset: 0.2}");
            let Loaded { scene, report } = loaded(profile, articulated, WEIGHTLESS, &text);
            assert_eq!(report.errors(), 0, "{report}");
            let mut stepper = Stepper::new(Simulation::new(scene, DT), DT);
            let (j0, j2) = (JointId::new(0), JointId::new(2));
            let positions = |stepper: &Stepper| [j0, j2].map(|id| stepper.simulation().scene().joints[id].position);
            let apart = |stepper: &Stepper| {
                let [leader, follower] = positions(stepper);
                (follower - 0.4 * leader - 0.2).abs()
            };
            // The file has the follower at 0.
            stepper.step(200).expect("sound");
            assert!(apart(&stepper) < 1e-6, "{what}: {}", apart(&stepper));
            let set = |stepper: &mut Stepper, positions: Vec<(JointId, f64)>, rates: Vec<(JointId, f64)>| {
                stepper.set_state(&StateChange { positions, rates, ..StateChange::default() })
            };
            set(&mut stepper, vec![(j0, 1.0)], vec![(j0, 2.0)]).expect("a leader");
            assert!(apart(&stepper) < 1e-9 && (positions(&stepper)[0] - 1.0).abs() < 1e-9, "{what}");
            close(stepper.simulation().scene().joints[j2].velocity, 0.8, 1e-9);
            set(&mut stepper, vec![(j0, 1.0), (j2, 0.6)], vec![]).expect("both fit");
            let refused = set(&mut stepper, vec![(j2, 0.9)], vec![]);
            assert!(matches!(refused, Err(SetStateError::Follows { .. })), "{what}: {refused:?}");
            stepper.step(100).expect("sound");
            assert!(apart(&stepper) < 1e-5, "{what}: {}", apart(&stepper));
            close(positions(&stepper)[0], 1.2, 2e-3);

            // More than a turn, of which a ratio of 0.4 keeps nothing.
            let saved = stepper.save().expect("savable");
            set(&mut stepper, vec![(j0, 1.0)], vec![(j0, 40.0)]).expect("a leader");
            stepper.step(300).expect("sound");
            let error = |stepper: &Stepper| stepper.simulation().scene().coupling_error(j2).expect("it follows").abs();
            assert!(error(&stepper) < 1e-5, "{what}: {}", error(&stepper));
            let go_on = |stepper: &mut Stepper| {
                stepper.restore(&saved).expect("of this simulation");
                stepper.step(50).expect("sound");
                positions(stepper)
            };
            assert_eq!(go_on(&mut stepper), go_on(&mut stepper), "{what}");

            stepper.reset();
            stepper.step(200).expect("sound");
            let first = positions(&stepper);
            set(&mut stepper, vec![(j0, 1.0)], vec![(j0, 40.0)]).expect("a leader");
            stepper.step(300).expect("sound");
            stepper.reset();
            stepper.step(200).expect("sound");
            assert_eq!(positions(&stepper), first, "{what}: episodes are equal");
        }
    }
}

#[test]
fn trees_and_constraints_between_bodies_move_alike() {
    // A free base with two arms of two joints each; the outer joints follow the inner ones of the other arm.
    let mut text = format!("<robot name='r'>{}", link("base", 2.0, 0.02, "0 0 0"));
    for (arm, x) in [("l", -0.1), ("r", 0.1)] {
        let other = if arm == "l" { "r" } else { "l" };
        let [inner, outer] = [format!("{arm}0"), format!("{arm}1")];
        let follows = mimic(&format!("j{other}0"), -0.7, 0.1);
        text += &link(&inner, 0.5, 0.005, "0 0 -0.15");
        text += &link(&outer, 0.3, 0.003, "0.02 0 -0.1");
        text +=
            &joint(&format!("j{inner}"), "continuous", "base", &inner, "0 1 0", &format!("<origin xyz='{x} 0 0'/>"));
        text += &joint(
            &format!("j{outer}"),
            "continuous",
            &inner,
            &outer,
            "0.6 0.8 0",
            &format!("<origin xyz='0 0 -0.3'/>{follows}"),
        );
    }
    text += "</robot>";
    let run = |articulated| {
        let mut bench = bench(Profile::Accurate, articulated, WEIGHTLESS, &text);
        assert_eq!(bench.joint("jl0").name, "jl0");
        for step in 0..400 {
            bench.push("base", Vector3::new(2.0, 1.0, 0.0));
            bench.command("base", 0, Effort, if step < 200 { 0.3 } else { -0.2 }, 1);
        }
        let scene = bench.0.scene();
        let errors = (0..4).filter_map(|joint| scene.coupling_error(JointId::new(joint)));
        let worst = errors.map(f64::abs).fold(0.0, f64::max);
        (["jl0", "jr0", "jl1", "jr1"].map(|name| position(&bench, name)), bench.position("base"), worst)
    };
    let (tree, place, exact) = run(None);
    let (bodies, other, small) = run(Some(false));
    assert!(exact < 1e-12 && small < 1e-6, "{exact:e} and {small:e} rad");
    let apart = tree.iter().zip(&bodies).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // Forces act on bodies with constraints for half of the first sub-step, so that these are 0.5 ms behind.
    assert!(tree[0].abs() > 0.5 && apart < 4e-3, "{tree:?} and {bodies:?}");
    assert!((place - other).norm() < 1e-3, "{place} and {other}");
}

#[test]
fn hundreds_of_couplings_move_on() {
    // A train of 150 gears is more than the direct solver takes.
    let mut text = String::from("<robot name='r'><link name='world'/>");
    for i in 0..150 {
        let follows = if i > 0 { mimic(&format!("j{}", i - 1), -1.0, 0.0) } else { String::new() };
        let name = format!("w{i}");
        text += &link(&name, 1.0, 0.01, "0 0 0");
        let at = format!("<origin xyz='{i} 0 0'/>{follows}");
        text += &joint(&format!("j{i}"), "continuous", "world", &name, "0 0 1", &at);
    }
    for profile in PROFILES {
        let mut bench = bench(profile, None, WEIGHTLESS, &(text.clone() + "</robot>"));
        bench.command("world", 0, Effort, 1.0, 200);
        let [first, last] = ["w0", "w149"].map(|name| bench.velocity(name).1.z);
        // 0.133 rad/s of all would be exact; iterations do not converge for so long a train.
        assert!(first > 0.05 && first < 20.0 && last.abs() < 20.0, "{profile:?}: {first} and {last} rad/s");
    }
}

#[test]
fn couplings_of_dropped_joints_are_named() {
    let text = wheels(", coupling: {joint: JOINT j0}").replace("child: BODY w0", "child: BODY nothing");
    let Loaded { scene, report } = loaded(Profile::Accurate, None, WEIGHTLESS, &text);
    assert!(
        report.to_string().contains("`JOINT j2` moves on its own: `JOINT j0`, which it follows, is dropped"),
        "{report}"
    );
    assert!(scene.joints.iter().all(|joint| joint.coupling.is_none()));
}
