//! A held body is pressed against the ground: grip and ground contradict each other.

use ambf_core::comm::{ActuatorCommand, JointCommandType};
use ambf_core::ids::{ActuatorId, BodyId};
use nalgebra::{UnitQuaternion, Vector3};

use super::super::system::{Body, Freedom, Joint, Shape, System};
use super::super::trial::{pose, Trial};
use super::Family;

const G: f64 = 9.81;
/// Edge of the box, m, and its mass, kg.
const EDGE: f64 = 0.04;
const MASS: f64 = 0.1;
/// Bodies of the scene.
const BOX: usize = 1;
const PALM: usize = 2;
/// Height of the palm above the box, m.
const REACH: f64 = 0.1;
/// When it lets go, s.
const RELEASE: f64 = 0.6;

pub fn families() -> Vec<Family> {
    vec![
        Family {
            name: "press-depth",
            title: "Held box pressed into the ground",
            words: "A static palm with two sliding fingers holds a box of 0.1 kg at the palm and between the fingers, tilted by 0.1 rad, \
                    lowers it at 2 cm/s until its lowest corner would be at the given depth, and lets go after 0.6 s; 1.5 s. Good: the \
                    box is never faster than 0.25 m/s and ends within 2 cm of where it was put.",
            difficulty: "depth, mm",
            stray: "speed, m/s",
            values: &[0.5, 1.0, 2.0, 3.0, 5.0, 8.0],
            make: |mm| press(mm / 1e3, None, 0.001),
        },
        Family {
            name: "press-mass",
            title: "Held box pressed onto a plate, mass",
            words: "The same, 2 mm deep, on a plate of 0.3 × 0.3 × 0.05 m that lies on the ground.",
            difficulty: "mass of the plate, kg",
            stray: "speed, m/s",
            values: &[1e3, 100.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4],
            make: |mass| press(0.002, Some(mass), 0.001),
        },
        Family {
            name: "step-press",
            title: "Held box pressed into the ground, step",
            words: "The same without a plate over steps of different length.",
            difficulty: "step, ms",
            stray: "speed, m/s",
            values: &[0.1, 0.5, 1.0, 2.0, 4.0, 10.0],
            make: |ms| press(0.002, None, ms / 1e3),
        },
    ]
}

fn press(depth: f64, plate: Option<f64>, step: f64) -> Trial {
    let rotation = UnitQuaternion::from_euler_angles(0.1, 0.05, 0.0);
    let corner: f64 = (0..3).map(|i| (rotation.to_rotation_matrix()[(2, i)] * EDGE / 2.0).abs()).sum();
    let top = if plate.is_some() { 0.05 } else { 0.0 };
    let touch = top + corner;
    let start = touch + 0.002;
    let mut held = Body::block(MASS, Vector3::repeat(EDGE), Vector3::new(0.0, 0.0, start));
    held.pose.rotation = rotation;
    let palm = Body { pose: nalgebra::Isometry3::translation(0.0, 0.0, start + REACH), ..Body::fixed(None) };
    let finger =
        |side: f64| Body::block(0.05, Vector3::new(0.01, 0.03, 0.03), Vector3::new(side * 0.045, 0.0, start + 0.01));
    let mut bodies = vec![Body::fixed(Some(Shape::Ground)), held, palm, finger(-1.0), finger(1.0)];
    bodies.extend(plate.map(|mass| Body::block(mass, Vector3::new(0.3, 0.3, 0.05), Vector3::new(0.0, 0.0, 0.025))));
    let mut system = System::of(bodies);
    system.friction = 0.5;
    system.gravity = Vector3::new(0.0, 0.0, -G);
    let slide = |(body, side): (usize, f64)| Joint {
        freedom: Freedom::Slider,
        ..Joint::hinge(PALM, body, Vector3::new(side * 0.045, 0.0, start + 0.05), Vector3::x() * -side)
    };
    system.joints = [(3, -1.0), (4, 1.0)].map(slide).to_vec();
    // Of a fall of 5 cm: closing, the fingers have half of it.
    let mut trial = Trial::of(system, 1.5, MASS * G * 0.05);
    trial.step = step;
    for joint in 0..2 {
        trial.joint_keys(joint, "joint limits: {low: 0, high: 0.04}, controller: {P: 300, I: 0, D: 10}, ");
    }
    let grip = format!(
        "actuators: [ACTUATOR grip]\nACTUATOR grip: {{name: grip, type: Constraint, parent: BODY {PALM}, location: {{position: {{x: 0, \
         y: 0, z: -0.05}}}}}}\njoints: ["
    );
    trial.edits.push(("joints: [".into(), grip));
    trial.act = Some(Box::new(move |simulation, n| {
        let t = n as f64 * step;
        let command =
            ActuatorCommand { actuate: t < RELEASE, body_name: format!("BODY {BOX}"), ..ActuatorCommand::default() };
        simulation.command_actuator(ActuatorId::new(0), &command);
        let height = (start - 0.02 * t).max(touch - depth) + REACH;
        simulation.follow_pose(BodyId::new(PALM), Vector3::new(0.0, 0.0, height), [0.0, 0.0, 0.0, 1.0]);
        for finger in 0..2 {
            simulation.command_joint(BodyId::new(PALM), finger, JointCommandType::Position, 0.03);
        }
        step
    }));
    trial.stray = Some(Box::new(move |simulation| {
        let world = &simulation.scene().world;
        let at = pose(world, BOX).translation.vector;
        let lost = at.xy().norm() > 0.02 || (at.z - touch).abs() > 0.02;
        let (speed, _) = world.velocity(world.bodies()[BOX]).expect("nothing is removed");
        if lost {
            f64::INFINITY
        } else {
            speed.norm()
        }
    }));
    trial.limits.stray = 0.25;
    trial
}
