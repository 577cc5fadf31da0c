//! An instrument arm in the accurate profile whose set points jump: all joints at once, to anywhere in their ranges, at
//! any gain.
//!
//! The arm is a tree of eleven joints: yaw and pitch of the shoulder, three of a parallelogram that is left open,
//! insertion, roll, pitch and yaw of the wrist, and two jaws, from 6 kg down to 5 g.

use crate::physics_common::{load_texts, Bench};
use ambf_core::comm::JointCommandType;
use ambf_core::sim::Simulation;

/// Name, parent, type, axis, pivot in the parent's frame (m), limits (rad or m), mass of the child (kg), its size (m),
/// gain (N·m/rad or N/m).
type Part = (&'static str, &'static str, &'static str, [f64; 3], [f64; 3], [f64; 2], f64, f64, f64);

#[rustfmt::skip]
const PARTS: [Part; 11] = [
    ("yaw",       "base",      "revolute",  [0.0, 0.0, 1.0], [0.0, 0.0, 0.0],  [-1.6, 1.6],  6.0,   0.2,   300.0),
    ("pitch",     "yaw",       "revolute",  [0.0, 1.0, 0.0], [0.1, 0.0, 0.0],  [-0.9, 0.9],  4.0,   0.3,   300.0),
    ("parallel1", "yaw",       "revolute",  [0.0, 1.0, 0.0], [0.1, 0.0, 0.1],  [-0.9, 0.9],  1.0,   0.3,   50.0),
    ("parallel2", "parallel1", "revolute",  [0.0, 1.0, 0.0], [0.0, 0.0, 0.3],  [-0.9, 0.9],  1.0,   0.2,   50.0),
    ("parallel3", "parallel2", "revolute",  [0.0, 1.0, 0.0], [0.2, 0.0, 0.0],  [-0.9, 0.9],  0.5,   0.1,   20.0),
    ("insertion", "pitch",     "prismatic", [0.0, 0.0, 1.0], [0.3, 0.0, 0.0],  [0.0, 0.24],  0.5,   0.3,   1000.0),
    ("roll",      "insertion", "revolute",  [0.0, 0.0, 1.0], [0.0, 0.0, -0.3], [-3.0, 3.0],  0.1,   0.02,  1.0),
    ("wrist",     "roll",      "revolute",  [0.0, 1.0, 0.0], [0.0, 0.0, -0.02],[-1.5, 1.5],  0.02,  0.01,  0.2),
    ("turn",      "wrist",     "revolute",  [1.0, 0.0, 0.0], [0.0, 0.0, -0.01],[-1.5, 1.5],  0.01,  0.008, 0.1),
    ("jaw1",      "turn",      "revolute",  [1.0, 0.0, 0.0], [0.0, 0.0, 0.0],  [0.0, 1.5],   0.005, 0.008, 0.05),
    ("jaw2",      "turn",      "revolute",  [1.0, 0.0, 0.0], [0.0, 0.0, 0.0],  [-1.5, 0.0],  0.005, 0.008, 0.05),
];

/// Random numbers between 0 and 1 that are the same in every run (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn point([x, y, z]: [f64; 3]) -> String {
    format!("{{x: {x}, y: {y}, z: {z}}}")
}

/// The arm with all gains multiplied by `gain`.
fn arm(gain: f64, output: &str) -> Bench {
    let names = |prefix: &str, first: &str| {
        let all = PARTS.iter().map(|part| format!("{prefix} {}", part.0));
        std::iter::once(first.to_owned()).filter(|first| !first.is_empty()).chain(all).collect::<Vec<_>>().join(", ")
    };
    let mut text = format!("bodies: [{}]\njoints: [{}]\n", names("BODY", "BODY base"), names("JOINT", ""));
    text += "BODY base: {name: base, mass: 0, location: {position: {x: 0, y: 0, z: 1}}}\n";
    let mut origins = vec![("base", [0.0, 0.0, 1.0])];
    for (name, parent, kind, axis, pivot, [low, high], mass, size, stiffness) in PARTS {
        let above = origins.iter().find(|(other, _)| *other == parent).expect("parents come first").1;
        let at: [f64; 3] = std::array::from_fn(|k| above[k] + pivot[k]);
        origins.push((name, at));
        let moment = mass * size * size / 6.0;
        text += &format!(
            "BODY {name}: {{name: {name}, mass: {mass}, inertia: {{ix: {moment}, iy: {moment}, iz: {moment}}}, location: {{position: {}}}, \
             inertial offset: {{position: {{x: {}, y: 0, z: {}}}}}}}\n",
            point(at),
            size / 4.0,
            -size / 2.0
        );
        text += &format!(
            "JOINT {name}: {{name: {name}, type: {kind}, parent: BODY {parent}, child: BODY {name}, parent pivot: {}, child pivot: {}, \
             parent axis: {}, child axis: {}, joint limits: {{low: {low}, high: {high}}}, \
             controller: {{P: {}, I: 0, D: {}}}, controller output type: {output}}}\n",
            point(pivot),
            point([0.0; 3]),
            point(axis),
            point(axis),
            gain * stiffness,
            gain * stiffness * 0.05
        );
    }
    let world = "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\nphysics: {profile: accurate}\n";
    let loaded = load_texts(world, &[&text]);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Bench(Simulation::new(loaded.scene, 0.001))
}

/// Commands every joint a position in its range.
fn command(bench: &mut Bench, position: impl Fn(usize) -> f64) {
    for (i, part) in PARTS.iter().enumerate() {
        let parent = bench.body(part.1);
        let index = bench
            .0
            .scene()
            .active_joints(parent)
            .iter()
            .position(|&joint| bench.0.scene().joints[joint].name == part.0);
        assert!(bench.0.command_joint(
            parent,
            index.expect("a joint of its parent"),
            JointCommandType::Position,
            position(i)
        ));
    }
}

#[test]
fn no_jump_of_the_set_points_loses_the_arm() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for output in ["FORCE", "VELOCITY"] {
        for gain in [0.1, 1.0, 10.0, 100.0] {
            for share in [0.1, 0.3, 0.6, 1.0] {
                for _ in 0..4 {
                    let mut bench = arm(gain, output);
                    let centre = |i: usize| (PARTS[i].5[0] + PARTS[i].5[1]) / 2.0;
                    let targets: [f64; 11] = std::array::from_fn(|i| {
                        centre(i) + share * (random.next() - 0.5) * (PARTS[i].5[1] - PARTS[i].5[0])
                    });
                    for step in 0..300 {
                        command(&mut bench, |i| if step < 100 { centre(i) } else { targets[i] });
                        let case = format!("{output}, gain {gain}, {share} of the range, step {step}");
                        bench.0.update(0.001).unwrap_or_else(|error| panic!("{case}: {error}"));
                        for part in &PARTS {
                            let (position, (linear, _)) = (bench.position(part.0), bench.velocity(part.0));
                            assert!(position.norm() < 5.0, "{case}: `{}` is at {position}", part.0);
                            assert!(linear.norm() < 1000.0, "{case}: `{}` moves at {linear}", part.0);
                        }
                    }
                }
            }
        }
    }
}
