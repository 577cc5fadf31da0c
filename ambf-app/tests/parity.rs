//! Every trace of the C++ simulator against our run of the same scene. `docs/parity.md` explains what is left.

mod parity_common;

use std::ops::RangeInclusive;
use std::process::Command;
use std::thread;

use ambf_core::ids::BodyId;
use nalgebra::Vector3;
use parity_common::{
    apart_at_end, at_rest, bodies, cases, compare_bodies, compare_joints, joints, load_case, meta, simulate,
    soft_distances, Case, Quantity, Recording, Start, SHIFTS,
};
use Quantity::{Angular, JointEffort, JointPosition, JointVelocity, Linear, Position, Rotation};

/// Before the first contact. Position and rotation are the contract's; the others allow that much to build up in 0.1 s,
/// where at most a twentieth of it was seen (a cone twist joint, whose rows turn with every rounding error).
const FREE: [(Quantity, f64); 7] = [
    (Position, 1e-8),
    (Rotation, 1e-7),
    (Linear, 1e-7),
    (Angular, 1e-6),
    (JointPosition, 1e-8),
    (JointVelocity, 1e-6),
    (JointEffort, 1e-8),
];

/// In the first 100 steps, and in the 100 after the first contact. Position is the contract's. Rotation moves a point
/// 0.1 m away as far, and a velocity is one that gets there in a step: between two steps of a contact that is all that
/// is known.
const CONTACT: [(Quantity, f64); 7] = [
    (Position, 1e-5),
    (Rotation, 1e-4),
    (Linear, 1e-2),
    (Angular, 1e-1),
    (JointPosition, 1e-4),
    (JointVelocity, 1e-1),
    (JointEffort, 1e-1),
];

/// Bodies at rest at the end, m.
const REST: f64 = 2e-3;

/// Traces in which nothing touches anything.
const CONTACT_FREE: [&str; 7] =
    ["pendulum", "pendulum_pos", "chain", "joints", "psm_free", "kuka_free", "parallel_structure"];

/// The cases without soft bodies.
fn comparable() -> Vec<Case> {
    cases().into_iter().filter(|case| !case.is_soft()).collect()
}

/// Not even the nodes of a soft body go other ways: what changed inside Bullet since does not concern links, anchors
/// and fixed nodes.
#[test]
fn the_nodes_of_soft_bodies_go_the_same_way() {
    if ambf_test_support::shared().is_none() {
        return;
    }
    let soft: Vec<_> = cases().into_iter().filter(Case::is_soft).collect();
    assert!(!soft.is_empty(), "no trace has a soft body");
    for_each(&soft, |case| {
        let distances = soft_distances(case);
        let last = distances.last().map(|(step, _)| *step);
        let far = distances.iter().filter(|(_, distance)| distance.is_nan() || *distance > 1e-9);
        let mut complaints: Vec<_> = far.map(|(step, distance)| format!("step {step}: {distance} m apart")).collect();
        complaints.extend((last != Some(case.steps)).then(|| format!("ends at step {last:?}")));
        complaints
    });
}

/// Runs `check` on every case, each in its own thread, and fails with all complaints.
fn for_each(cases: &[Case], check: impl Fn(&Case) -> Vec<String> + Sync) {
    let complaints: Vec<_> = thread::scope(|scope| {
        let threads: Vec<_> = cases.iter().map(|case| (case, scope.spawn(|| check(case)))).collect();
        let results = threads.into_iter().map(|(case, thread)| match thread.join() {
            Ok(complaints) => complaints.iter().map(|text| format!("{}: {text}", case.name)).collect(),
            Err(_) => vec![format!("{}: see the panic above", case.name)],
        });
        results.flat_map(|list: Vec<_>| list).collect()
    });
    assert!(complaints.is_empty(), "\n{}", complaints.join("\n"));
}

fn run(case: &Case, start: Start) -> Recording {
    let steps: Vec<_> = bodies(case).rows.iter().map(|row| row.0).collect();
    simulate(case, &steps, start)
}

fn compare(case: &Case, ours: &Recording, limits: &[(Quantity, f64)], range: RangeInclusive<u64>) -> Vec<String> {
    let (their_bodies, their_joints) = (bodies(case), joints(case));
    let mut complaints = Vec::new();
    for &(quantity, limit) in limits {
        let worst = match quantity {
            Position | Rotation | Linear | Angular => {
                compare_bodies(&ours.bodies, &their_bodies, quantity, range.clone())
            }
            _ if their_joints.names.is_empty() && ours.joints.names.is_empty() => continue,
            _ => compare_joints(&ours.joints, &their_joints, quantity, range.clone()),
        };
        if worst.difference.is_nan() || worst.difference > limit {
            complaints.push(format!("{quantity:?} in steps {range:?}: {worst:?} is above {limit:e}"));
        }
    }
    complaints
}

#[test]
fn motion_is_the_same_up_to_rounding() {
    for_each(&comparable(), |case| {
        let ours = run(case, Start::AsWritten);
        let mut complaints = Vec::new();
        if CONTACT_FREE.contains(&case.name.as_str()) && ours.first_contact.is_some() {
            complaints.push(format!("contact in step {:?}", ours.first_contact));
        }
        match ours.first_contact {
            None => complaints.extend(compare(case, &ours, &FREE, 0..=case.steps)),
            Some(touch) => {
                complaints.extend(compare(case, &ours, &FREE, 0..=touch.saturating_sub(1)));
                complaints.extend(compare(case, &ours, &CONTACT, 0..=100));
                complaints.extend(compare(case, &ours, &CONTACT, touch..=touch + 100));
            }
        }
        complaints
    });
}

/// Contacts make some scenes chaotic: what the last digit of the start decides cannot be compared. So a later
/// difference from the trace is accepted only as far as runs of ours whose starts differ by a shift of at most 1e-12 m
/// come apart themselves.
#[test]
fn later_differences_are_no_greater_than_those_of_an_invisible_shift() {
    for_each(&comparable(), |case| {
        let (ours, theirs) = (run(case, Start::AsWritten), bodies(case));
        let mut resting = at_rest(&theirs);
        resting.retain(|name| apart_at_end(&ours.bodies, &theirs, name) > REST);
        let all = compare_bodies(&ours.bodies, &theirs, Position, 0..=case.steps);
        if resting.is_empty() && all.difference <= 1e-5 {
            return Vec::new();
        }
        let shifted: Vec<_> = SHIFTS.iter().map(|&shift| run(case, Start::Shifted(shift))).collect();
        let largest = |of: &dyn Fn(&Recording) -> f64| shifted.iter().map(of).fold(0.0, f64::max);
        let mut complaints = Vec::new();
        for name in resting {
            let apart = apart_at_end(&ours.bodies, &theirs, name);
            let spread = largest(&|run| apart_at_end(&ours.bodies, &run.bodies, name));
            if apart > spread {
                complaints.push(format!("`{name}` rests {apart} m away; shifted starts move it by {spread} m only"));
            }
        }
        let spread = largest(&|run| compare_bodies(&ours.bodies, &run.bodies, Position, 0..=case.steps).difference);
        // Six runs are a small sample.
        if all.difference.is_nan() || all.difference > 3.0 * spread {
            complaints.push(format!("{all:?}; shifted starts come {spread} m apart only"));
        }
        complaints
    });
}

/// The other tests step scenes themselves. That is what the program does too, and its traces list objects in the order
/// of the C++ program.
#[test]
fn the_program_writes_what_is_compared_here() {
    for_each(&comparable(), |case| {
        let folder = std::env::temp_dir().join(format!("ambf_parity_{}_{}", std::process::id(), case.name));
        let steps = case.steps.to_string();
        let mut command = Command::new(env!("CARGO_BIN_EXE_ambf_batch"));
        command.arg("-a").arg(&case.files.models[0]).arg("--world").arg(case.files.world.as_ref().expect("a world"));
        command.args(["--steps", &steps, "--every", &steps, "--trace"]).arg(folder.join("t"));
        if let Some(commands) = &case.commands {
            command.arg("--commands").arg(commands);
        }
        let output = command.output().expect("ambf_batch runs");
        let written = std::fs::read_to_string(folder.join("t_bodies.csv")).unwrap_or_default();
        let joint_lines = std::fs::read_to_string(folder.join("t_joints.csv")).unwrap_or_default();
        let _ = std::fs::remove_dir_all(&folder);
        if !output.status.success() {
            return vec![format!("{output:?}")];
        }

        let mut complaints = Vec::new();
        let names = |text: &str| {
            let lines = text.lines().filter(|line| line.starts_with("0,"));
            lines.map(|line| line.split(',').nth(2).unwrap_or_default().to_owned()).collect::<Vec<_>>()
        };
        let (their_bodies, their_joints) = (bodies(case).names, joints(case).names);
        if names(&written) != their_bodies || names(&joint_lines) != their_joints {
            complaints.push(format!("order {:?} {:?}", names(&written), names(&joint_lines)));
        }
        let ours = simulate(case, &[case.steps], Start::AsWritten).bodies;
        for (name, state) in ours.names.iter().zip(&ours.rows[0].2) {
            let mark = format!(",{name},");
            let is_last = |line: &&str| line.starts_with(&format!("{steps},")) && line.contains(&mark);
            let line = written.lines().find(is_last).unwrap_or_default();
            let position: Vec<_> =
                line.split(',').skip(3).take(3).filter_map(|cell| cell.parse::<f64>().ok()).collect();
            if position != state.position.as_slice() {
                complaints.push(format!("`{name}` ends at {position:?} instead of {}", state.position));
            }
        }
        complaints
    });
}

fn equal(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 1e-9 * expected.abs()
}

fn vectors_equal(found: &Vector3<f64>, expected: &Vector3<f64>) -> bool {
    (found - expected).norm() <= 1e-9 * expected.norm()
}

#[test]
fn descriptions_become_the_same_bodies_and_joints() {
    for_each(&comparable(), |case| {
        let scene = load_case(case, Start::AsWritten);
        let names = scene.bodies.iter().map(|body| body.identity.communication_name()).collect::<Vec<_>>();
        let (bodies, mut joints) = meta(case);
        let mut complaints = Vec::new();
        if bodies.len() != scene.bodies.len() {
            complaints.push(format!("{} bodies instead of {}", scene.bodies.len(), bodies.len()));
        }
        for expected in &bodies {
            let Some(body) = names.iter().position(|name| *name == expected.name).map(BodyId::new) else {
                complaints.push(format!("no body `{}`", expected.name));
                continue;
            };
            let active = scene.graph.active(body);
            let body = &scene.bodies[body];
            let active: Vec<_> =
                active.map(|e| (scene.joints[e.joint].name.clone(), names[e.body.index()].clone())).collect();
            let same = equal(body.mass, expected.mass)
                && vectors_equal(&body.inertia, &expected.inertia)
                && vectors_equal(&body.inertial_offset.translation.vector, &expected.inertial_offset)
                && body.identity.passive == expected.passive
                && active == expected.active_joints;
            if !same {
                complaints.push(format!("{body:?}\nwith {active:?} instead of {expected:?}"));
            }
        }
        let mut ours: Vec<_> = scene.joints.iter().map(|j| (j.name.clone(), j.joint_type.code())).collect();
        ours.sort();
        joints.sort();
        if ours != joints {
            complaints.push(format!("joints {ours:?} instead of {joints:?}"));
        }
        complaints
    });
}
