//! Controllers: gains, steps, stalls, commands at random.

use ambf_core::ids::BodyId;
use std::f64::consts::{PI, TAU};

use ambf_core::comm::JointCommandType;
use nalgebra::Vector3;

use super::super::jointed::arm_system;
use super::super::system::{Body, Drive, System};
use super::super::trial::{pose, Act, Stray, Trial};
use super::{Dice, Family};

/// Energy that the arm, 17 kg and 1.4 m, never has when it follows, J.
const ARM_ENERGY: f64 = 300.0;

pub fn families() -> Vec<Family> {
    vec![
        Family {
            name: "gain-joint",
            title: "Arm of 7 joints, gains",
            words: "Every joint follows 0.3·(1 − cos 4t) rad with torques, P and D times the given factor, 3 s. Good: after the first second \
                    no joint is further than 0.3 rad from its goal.",
            difficulty: "gains ×",
            stray: "off, rad",
            values: &[1.0, 3.0, 10.0, 100.0, 1e3, 1e4],
            make: |factor| {
                let mut trial = arm();
                let drive = trial.system.drive.as_mut().expect("the arm has one");
                drive.gains.iter_mut().for_each(|(p, d)| (*p, *d) = (*p * factor, *d * factor));
                trial
            },
        },
        Family {
            name: "step-arm",
            title: "Arm of 7 joints, step",
            words: "The same with gains × 1; the controllers are commanded once a step.",
            difficulty: "step, ms",
            stray: "off, rad",
            values: &[0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0],
            make: |ms| {
                let mut trial = arm();
                trial.step = ms / 1e3;
                trial.act = Some(follow_arm(drive(&trial), move |_| ms / 1e3));
                trial
            },
        },
        Family {
            name: "starvation",
            title: "Arm of 7 joints, stalls",
            words: "A tenth of the iterations take 5–50 ms, one in a thousand 0.5 s, at random; the sub-steps of an iteration are capped, and \
                    commands come once an iteration. 10 s. Good: no joint further than 0.5 rad from its goal.",
            difficulty: "cap",
            stray: "off, rad",
            values: &[1.0, 5.0, 20.0, 50.0, 100.0, 500.0],
            make: starved_arm,
        },
        Family {
            name: "gain-cartesian",
            title: "Pose controller, gains",
            words: "A cube of 1 kg follows 0.1·(sin 4t, cos 4t, 2 sin 4t) m with forces, P 100 N/m and D 20 N·s/m (P 1, D 0.1 for rotation) \
                    times the given factor, 3 s. Good: after the first second it is within 0.2 m of its goal.",
            difficulty: "gains ×",
            stray: "off, m",
            values: &[1.0, 3.0, 10.0, 100.0, 1e3, 1e4],
            make: |factor| cartesian(factor, 0.001),
        },
        Family {
            name: "step-cartesian",
            title: "Pose controller, step",
            words: "The same with gains × 1.",
            difficulty: "step, ms",
            stray: "off, m",
            values: &[0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0],
            make: |ms| cartesian(1.0, ms / 1e3),
        },
        Family {
            name: "commands",
            title: "Commands at random",
            words: "A hundred times a second a joint of the arm is told another position, velocity or effort. Good: no joint opens by more \
                    than 1 cm, and the arm never has more than 5 kJ, what the stiffest controller stores at π.",
            difficulty: "simulated, s",
            stray: "",
            values: &[60.0, 3600.0],
            make: random_commands,
        },
    ]
}

fn drive(trial: &Trial) -> Drive {
    trial.system.drive.clone().expect("the arm has one")
}

fn off_goal(drive: Drive) -> Stray {
    Box::new(move |simulation| {
        let (goal, _) = drive.set_point(simulation.sim_time());
        let off = |angle: f64| ((angle - goal + PI).rem_euclid(TAU) - PI).abs();
        simulation.scene().joints.iter().map(|joint| off(joint.position)).fold(0.0, f64::max)
    })
}

/// Commands all joints in each iteration, whose length `interval` chooses.
fn follow_arm(drive: Drive, mut interval: impl FnMut(u64) -> f64 + 'static) -> Act {
    Box::new(move |simulation, n| {
        let (goal, _) = drive.set_point(simulation.sim_time());
        for joint in 0..drive.gains.len() {
            simulation.command_joint(BodyId::new(0), joint, JointCommandType::Position, goal);
        }
        interval(n)
    })
}

fn arm() -> Trial {
    let mut trial = Trial::of(arm_system(), 3.0, ARM_ENERGY);
    trial.act = Some(follow_arm(drive(&trial), |_| 0.001));
    trial.stray = Some(off_goal(drive(&trial)));
    trial.settled = 1.0;
    trial.limits.stray = 0.3;
    trial.limits.gap = 0.01;
    trial
}

fn starved_arm(cap: f64) -> Trial {
    let mut dice = Dice(1);
    let interval = move |_| {
        let (kind, length) = (dice.roll(), dice.roll());
        match kind {
            kind if kind < 0.001 => 0.5,
            kind if kind < 0.1 => 0.005 + 0.045 * length,
            _ => 0.001,
        }
    };
    let mut trial = arm();
    trial.cap = cap as u32;
    trial.span = 10.0;
    trial.act = Some(follow_arm(drive(&trial), interval));
    trial.limits.stray = 0.5;
    trial
}

fn cartesian(factor: f64, step: f64) -> Trial {
    let goal = |t: f64| Vector3::new((4.0 * t).sin(), (4.0 * t).cos(), 2.0 * (4.0 * t).sin()) * 0.1;
    let body = Body::cuboid(1.0, Vector3::repeat(0.1), goal(0.0));
    // No faster than a hundred times what the curve asks for.
    let mut trial = Trial::of(System::of(vec![body]), 3.0, 100.0);
    trial.step = step;
    trial.body_keys(
        0,
        &format!(
            "controller: {{linear: {{P: {:?}, I: 0, D: {:?}}}, angular: {{P: {:?}, I: 0, D: {:?}}}}}, controller output type: FORCE, ",
            100.0 * factor,
            20.0 * factor,
            factor,
            0.1 * factor
        ),
    );
    trial.act = Some(Box::new(move |simulation, _| {
        simulation.follow_pose(BodyId::new(0), goal(simulation.sim_time()), [0.0, 0.0, 0.0, 1.0]);
        step
    }));
    trial.stray = Some(Box::new(move |simulation| {
        (pose(&simulation.scene().world, 0).translation.vector - goal(simulation.sim_time())).norm()
    }));
    trial.settled = 1.0;
    trial.limits.stray = 0.2;
    trial
}

fn random_commands(seconds: f64) -> Trial {
    let mut trial = Trial::of(arm_system(), seconds, 5000.0);
    let gains = drive(&trial).gains;
    let joints = gains.len();
    let mut dice = Dice(7);
    // A client repeats its commands until they change.
    let mut commands = vec![(JointCommandType::Position, 0.0); joints];
    trial.act = Some(Box::new(move |simulation, n| {
        if n % 10 == 0 {
            let (joint, x) = (dice.index(joints), 2.0 * dice.roll() - 1.0);
            commands[joint] = match dice.index(3) {
                0 => (JointCommandType::Position, 0.5 * x),
                1 => (JointCommandType::Velocity, x),
                _ => (JointCommandType::Effort, 0.02 * gains[joint].0 * x),
            };
        }
        for (joint, &(kind, value)) in commands.iter().enumerate() {
            simulation.command_joint(BodyId::new(0), joint, kind, value);
        }
        0.001
    }));
    trial.limits.gap = 0.01;
    trial
}
