//! Contacts: stacks, spin, overlaps, thin walls.

use ambf_core::ids::BodyId;
use nalgebra::{UnitQuaternion, Vector3};

use super::super::system::{Body, Shape, System};
use super::super::trial::{pose, Limits, Trial};
use super::Family;

const G: f64 = 9.81;
/// Edge of the blocks, m.
const EDGE: f64 = 0.2;

pub fn families() -> Vec<Family> {
    vec![
        Family {
            name: "stack2-mass",
            title: "Two boxes, the upper heavier",
            words: "Cubes of 0.2 m on the ground, 3 s. Good: the upper one moves less than 2 cm, penetration below 2 cm.",
            difficulty: "mass ratio",
            stray: "moved, m",
            values: &[1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6],
            make: |ratio| stack(&[1.0, ratio]),
        },
        Family {
            name: "stack5-mass",
            title: "Five boxes, the uppermost heavier",
            words: "The same with five.",
            difficulty: "mass ratio",
            stray: "moved, m",
            values: &[1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6],
            make: |ratio| stack(&[1.0, 1.0, 1.0, 1.0, ratio]),
        },
        Family {
            name: "stack-height",
            title: "Stack",
            words: "The same with boxes of 1 kg.",
            difficulty: "boxes",
            stray: "moved, m",
            values: &[2.0, 5.0, 10.0, 20.0, 35.0, 50.0],
            make: |n| stack(&vec![1.0; n as usize]),
        },
        Family {
            name: "step-stack",
            title: "Stack of five, step",
            words: "Five boxes of 1 kg over steps of different length.",
            difficulty: "step, ms",
            stray: "moved, m",
            values: &[0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0],
            make: |ms| Trial { step: ms / 1e3, ..stack(&[1.0; 5]) },
        },
        Family {
            name: "spin-free",
            title: "Spinning in free flight",
            words: "A box of 0.1 × 0.4 × 0.9 m turns about (almost) its middle axis, 3 s. Good: energy never above 102 %, angular \
                    momentum within 10 %.",
            difficulty: "spin, rad/s",
            stray: "momentum error",
            values: &[1.0, 5.0, 20.0, 100.0, 300.0, 1e3],
            make: spin_free,
        },
        Family {
            name: "spin-ground",
            title: "Spinning on the ground",
            words: "The same box is dropped spinning, friction 0.5, 3 s. Good: energy never above 105 %.",
            difficulty: "spin, rad/s",
            stray: "",
            values: &[1.0, 5.0, 20.0, 100.0, 300.0, 1e3],
            make: spin_ground,
        },
        Family {
            name: "overlap",
            title: "Pile that starts overlapping",
            words: "27 cubes of 1 kg in a grid whose pitch is too small, 3 s. Good: no body gains more energy, on average, than a fall of \
                    2 m has.",
            difficulty: "overlap, share of the edge",
            stray: "",
            values: &[0.01, 0.1, 0.25, 0.5, 0.75, 0.95],
            make: overlap,
        },
        Family {
            name: "teleport",
            title: "Static block that jumps into a box",
            words: "Ten times in 5 s a static cube jumps into the side of a cube of 1 kg that lies on the ground, and away again. Good: \
                    the box never has more energy than a fall of 1 m gives.",
            difficulty: "overlap, share of the edge",
            stray: "",
            values: &[0.05, 0.1, 0.25, 0.5, 0.75, 1.0],
            make: teleport,
        },
        Family {
            name: "thin-wall",
            title: "Ball of 5 mm radius at a wall of 1 mm",
            words: "The ball flies at the wall at an angle of 0.1 rad. Good: its centre stays on its side.",
            difficulty: "speed, m/s",
            stray: "beyond the wall, m",
            values: &[1.0, 3.0, 10.0, 31.0, 100.0, 310.0, 1e3],
            make: thin_wall,
        },
        Family {
            name: "inertia-ground",
            title: "Cube of 1 kg on the ground, inertia",
            words: "A tilted cube of 0.2 m and 1 kg is dropped from 5 cm with a given moment of inertia (a real one has 7e-3 kg·m²), 3 s. \
                    Good: energy never above 105 %, penetration below 2 cm.",
            difficulty: "inertia, kg·m²",
            stray: "",
            values: &[1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 1e-12],
            make: inertia_ground,
        },
    ]
}

fn on_ground(bodies: impl IntoIterator<Item = Body>) -> System {
    let mut system = System::of(std::iter::once(Body::fixed(Some(Shape::Ground))).chain(bodies).collect());
    system.friction = 0.5;
    system
}

fn cube(mass: f64, position: Vector3<f64>) -> Body {
    Body::block(mass, Vector3::repeat(EDGE), position)
}

fn stack(masses: &[f64]) -> Trial {
    let height = |i: usize| EDGE * (i as f64 + 0.5);
    let bodies = masses.iter().enumerate().map(|(i, &mass)| cube(mass, Vector3::new(0.0, 0.0, height(i))));
    let in_play: f64 = masses.iter().enumerate().map(|(i, mass)| mass * G * height(i)).sum();
    let (top, start) = (masses.len(), height(masses.len() - 1));
    let mut trial = Trial::of(on_ground(bodies), 3.0, 0.05 * in_play);
    trial.stray = Some(Box::new(move |simulation| {
        (pose(&simulation.scene().world, top).translation.vector - Vector3::new(0.0, 0.0, start)).norm()
    }));
    trial.limits = Limits { depth: 0.02, stray: 0.02, ..trial.limits };
    trial
}

fn spinning(spin: f64, position: Vector3<f64>) -> (Body, f64) {
    let mut body = Body::block(10.0, Vector3::new(0.1, 0.4, 0.9), position);
    body.spin = Vector3::new(0.02, 1.0, 0.02) * spin;
    let energy = body.spin.component_mul(&body.spin).dot(&body.inertia) / 2.0;
    (body, energy)
}

fn spin_free(spin: f64) -> Trial {
    let (body, energy) = spinning(spin, Vector3::zeros());
    let inertia = body.inertia;
    let start = inertia.component_mul(&body.spin);
    let mut system = System::of(vec![body]);
    system.gravity = Vector3::zeros();
    let mut trial = Trial::of(system, 3.0, 0.02 * energy);
    trial.stray = Some(Box::new(move |simulation| {
        let world = &simulation.scene().world;
        let rotation = pose(world, 0).rotation;
        let (_, spin) = world.velocity(world.bodies()[0]).expect("alive");
        let momentum = rotation * inertia.component_mul(&(rotation.inverse() * spin));
        (momentum - start).norm() / start.norm()
    }));
    trial.limits.stray = 0.1;
    trial
}

fn spin_ground(spin: f64) -> Trial {
    let height = 0.5;
    let (body, energy) = spinning(spin, Vector3::new(0.0, 0.0, height));
    let in_play = energy + body.mass * G * height;
    Trial::of(on_ground([body]), 3.0, 0.05 * in_play)
}

fn overlap(share: f64) -> Trial {
    let pitch = EDGE * (1.0 - share);
    let at = |i: usize| (i as f64 - 1.0) * pitch;
    let place = |i: usize| Vector3::new(at(i % 3), at(i / 3 % 3), EDGE / 2.0 + pitch * (i / 9) as f64);
    let bodies = (0..27).map(|i| cube(1.0, place(i)));
    Trial::of(on_ground(bodies), 3.0, 27.0 * G * 2.0)
}

fn teleport(share: f64) -> Trial {
    let far = Vector3::new(0.0, 0.0, 5.0);
    let block = Body { mass: 0.0, inertia: Vector3::zeros(), ..cube(1.0, far) };
    let mut trial = Trial::of(on_ground([cube(1.0, Vector3::new(0.0, 0.0, EDGE / 2.0)), block]), 5.0, G);
    trial.act = Some(Box::new(move |simulation, n| {
        if n % 500 == 250 {
            let mut target = pose(&simulation.scene().world, 1).translation.vector;
            target.x -= EDGE * (1.0 - share);
            // Not below the ground with it when the box has gone there.
            target.z = target.z.max(EDGE / 2.0);
            simulation.follow_pose(BodyId::new(2), target, [0.0, 0.0, 0.0, 1.0]);
        } else if n % 500 == 0 {
            simulation.follow_pose(BodyId::new(2), far, [0.0, 0.0, 0.0, 1.0]);
        }
        0.001
    }));
    trial
}

fn thin_wall(speed: f64) -> Trial {
    let wall = Body { mass: 0.0, ..Body::block(1.0, Vector3::new(0.001, 2.0, 2.0), Vector3::zeros()) };
    let wall = Body { inertia: Vector3::zeros(), ..wall };
    // Not a multiple of the way of a step.
    let mut ball = Body::sphere(0.01, 0.005, Vector3::new(-0.5317, 0.0, 0.0));
    ball.velocity = Vector3::new(speed * 0.1_f64.cos(), speed * 0.1_f64.sin(), 0.0);
    let mut system = System::of(vec![wall, ball]);
    system.gravity = Vector3::zeros();
    system.restitution = 0.5;
    let energy = 0.05 * 0.01 * speed * speed / 2.0;
    let mut trial = Trial::of(system, 1.0 / speed + 0.02, energy);
    trial.stray = Some(Box::new(|simulation| pose(&simulation.scene().world, 1).translation.x));
    trial.limits.stray = 0.0;
    trial
}

fn inertia_ground(inertia: f64) -> Trial {
    let mut body = cube(1.0, Vector3::new(0.0, 0.0, 0.25));
    body.pose.rotation = UnitQuaternion::from_euler_angles(0.3, 0.4, 0.0);
    body.inertia = Vector3::repeat(inertia);
    let mut trial = Trial::of(on_ground([body]), 3.0, 0.05 * G * 0.25);
    trial.limits.depth = 0.02;
    trial
}
