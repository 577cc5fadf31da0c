//! Joints: chains, loops, limits that contradict, bodies of next to no inertia.

use nalgebra::Vector3;

use super::super::jointed::{bricard_system, chain_system, window_system};
use super::super::system::{Body, Joint, System};
use super::super::trial::Trial;
use super::Family;

const G: f64 = 9.81;
/// Gap that a joint may have, m.
const GAP: f64 = 0.01;

pub fn families() -> Vec<Family> {
    vec![
        Family {
            name: "chain-mass",
            title: "Chain of 10, heavy end",
            words: "Rods of 1 m and 1 kg, hinged end to end, are let go horizontally; the last one is heavier; 2 s. Good, here and in \
                    all jointed scenes: no joint opens by more than 1 cm, energy grows by less than 5 % of what is in play.",
            difficulty: "mass ratio",
            stray: "",
            values: &[1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6],
            make: |ratio| chain(10, ratio),
        },
        Family {
            name: "chain-links",
            title: "Chain",
            words: "The same with rods of 1 kg.",
            difficulty: "links",
            stray: "",
            values: &[2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0],
            make: |n| chain(n as usize, 1.0),
        },
        Family {
            name: "step-chain",
            title: "Chain of 10, step",
            words: "Ten rods of 1 kg over steps of different length.",
            difficulty: "step, ms",
            stray: "",
            values: &[0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0],
            make: |ms| Trial { step: ms / 1e3, ..chain(10, 1.0) },
        },
        Family {
            name: "loops",
            title: "Redundant loops",
            words: "Four-bar windows side by side (IFToMM A02) and the Bricard mechanism (A04), 4 s.",
            difficulty: "windows",
            stray: "",
            values: &[0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0],
            make: loops,
        },
        Family {
            name: "inertia-joint",
            title: "Chain of 3, inertia",
            words: "Three rods of 1 kg with a given moment of inertia, 2 s.",
            difficulty: "inertia, kg·m²",
            stray: "",
            values: &[1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 1e-12],
            make: |inertia| {
                let mut trial = chain(3, 1.0);
                trial.system.bodies.iter_mut().skip(1).for_each(|body| body.inertia = Vector3::repeat(inertia));
                trial
            },
        },
        Family {
            name: "limits-swapped",
            title: "Lower limit above the upper",
            words: "A pendulum whose hinge has its limits the wrong way round, 2 s.",
            difficulty: "overlap, rad",
            stray: "",
            values: &[0.001, 0.01, 0.1, 0.5, 1.0, 3.0],
            make: |overlap| {
                let mut trial = chain(1, 1.0);
                trial.joint_keys(0, &limits(overlap / 2.0, -overlap / 2.0));
                trial
            },
        },
        Family {
            name: "limits-conflict",
            title: "Two hinges with limits apart",
            words: "Two hinges of the same bodies about the same axis whose ranges, each 0.1 rad, don't meet, 2 s. They can't both hold: \
                    only energy counts.",
            difficulty: "apart, rad",
            stray: "",
            values: &[0.001, 0.01, 0.1, 0.5, 1.0, 3.0],
            make: conflict,
        },
    ]
}

fn limits(low: f64, high: f64) -> String {
    format!("joint limits: {{low: {low:?}, high: {high:?}}}, ")
}

fn chain(n: usize, last: f64) -> Trial {
    let system = chain_system(n, last);
    let in_play: f64 = system.bodies.iter().map(|body| body.mass * G * body.pose.translation.x).sum();
    let mut trial = Trial::of(system, 2.0, 0.05 * in_play);
    trial.limits.gap = GAP;
    trial
}

fn loops(n: f64) -> Trial {
    let system = if n == 0.0 { bricard_system() } else { window_system(n as usize) };
    let mass: f64 = system.bodies.iter().map(|body| body.mass).sum();
    let mut trial = Trial::of(system, 4.0, 0.05 * mass * G);
    trial.limits.gap = GAP;
    trial
}

fn conflict(apart: f64) -> Trial {
    let link = Body::cuboid(1.0, Vector3::new(1.0, 0.05, 0.05), Vector3::new(0.5, 0.0, 0.0));
    let mut system = System::of(vec![Body::fixed(None), link]);
    let hinge = Joint::hinge(0, 1, Vector3::zeros(), Vector3::y());
    system.joints = vec![hinge, hinge];
    let mut trial = Trial::of(system, 2.0, G);
    trial.joint_keys(0, &limits(apart / 2.0, apart / 2.0 + 0.1));
    trial.joint_keys(1, &limits(-apart / 2.0 - 0.1, -apart / 2.0));
    trial
}
