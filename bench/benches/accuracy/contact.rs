//! Cases with contacts.

use nalgebra::Vector3;

use super::case::{largest, times, Case, Family, Measure, Samples, GRAIN};
use super::reference::State;
use super::system::{Body, Shape, System};

const GRAVITY: f64 = 9.81;

fn on_ground(body: Body) -> System {
    System::of(vec![Body::fixed(Some(Shape::Ground)), body])
}

/// Mechanical energy of a body that started unrotated, J.
fn energy(body: &Body, state: &State) -> f64 {
    let spin = state.pose.inverse_transform_vector(&state.spin);
    let kinetic = body.mass * state.velocity.norm_squared() + spin.component_mul(&body.inertia).dot(&spin);
    kinetic / 2.0 + body.mass * GRAVITY * state.pose.translation.z
}

fn total_energy(bodies: &[Body], states: &[State]) -> f64 {
    bodies.iter().zip(states).filter(|(body, _)| body.mass > 0.0).map(|(body, state)| energy(body, state)).sum()
}

/// A ball of 0.1 m that falls 1 m, looked at near the top of each of `count` bounces.
fn ball(name: &'static str, title: &'static str, words: &'static str, restitution: f64, count: i32) -> Case {
    let (height, radius) = (1.0, 0.1);
    let mut system = on_ground(Body::sphere(1.0, radius, Vector3::new(0.0, 0.0, height + radius)));
    system.restitution = restitution;
    let (mut times, mut expected) = (Vec::new(), Vec::new());
    let fall = (2.0 * height / GRAVITY).sqrt();
    let mut landed = fall;
    for bounce in 1..=count {
        let rise = fall * restitution.powi(bounce);
        // The time of comparison that is nearest to the top; the energy is the same all the way.
        times.push(((landed + rise) / GRAIN).round() * GRAIN);
        expected.push(GRAVITY * (height * restitution.powi(2 * bounce) + radius));
        landed += 2.0 * rise;
    }
    let body = system.bodies[1].clone();
    let scale = GRAVITY * height;
    let measure: Measure = Box::new(move |samples| {
        let off = |(states, expected): (&Vec<State>, &f64)| (energy(&body, &states[1]) - expected).abs() / scale;
        largest(samples.iter().zip(&expected).map(off))
    });
    Case { name, title, words, unit: "of the energy", family: Family::Bounce, system, times, measure, limit: 0.5 }
}

pub fn bounce() -> Case {
    let words = "A ball falls 1 m onto the ground, restitution 1. Error: largest deviation of its energy from the initial one, in flight \
                 after each of 10 bounces, as a share of the energy of the fall. MuJoCo has no coefficient of restitution.";
    ball("bounce", "Bounce, e = 1", words, 1.0, 10)
}

pub fn bounce_half() -> Case {
    let words = "The same with restitution 0.5 and three bounces: energy e²ᵏ after the k-th.";
    ball("bounce-half", "Bounce, e = 0.5", words, 0.5, 3)
}

/// Inclination of the slopes, rad. Gravity is tilted instead of the ground.
const SLOPE: f64 = 0.5;

/// A box or ball on a slope that descends along `heading` (rad from x).
fn slope(mut system: System, heading: f64, friction: f64) -> System {
    let down = Vector3::new(heading.cos(), heading.sin(), 0.0);
    system.gravity = (down * SLOPE.sin() - Vector3::z() * SLOPE.cos()) * GRAVITY;
    system.friction = friction;
    system
}

fn block() -> System {
    on_ground(Body::block(1.0, Vector3::new(0.4, 0.4, 0.1), Vector3::new(0.0, 0.0, 0.05)))
}

/// Relative error of the acceleration on a slope, from velocities after 0.8 and 2 s: unlike the way it does not depend
/// on the order in which velocities and positions are integrated, nor on the first step, which finds no contact yet.
fn descent(system: System, name: &'static str, title: &'static str, words: &'static str, acceleration: f64) -> Case {
    let times = times(5, 25);
    let exact = Vector3::new(system.gravity.x, system.gravity.y, 0.0).normalize() * acceleration;
    let span = times[4] - times[1];
    let measure: Measure = Box::new(move |samples| {
        let found = (samples[4][1].velocity - samples[1][1].velocity) / span;
        (found.xy() - exact.xy()).norm() / exact.norm()
    });
    Case {
        name,
        title,
        words,
        unit: "of the acceleration",
        family: Family::Contact,
        system,
        times,
        measure,
        limit: 1.0,
    }
}

pub fn slide() -> Case {
    let system = slope(block(), 0.0, 0.3);
    let words =
        "A box of 1 kg slides down a slope of 0.5 rad along a friction axis, friction 0.3, 2 s. Error: difference of \
                 its acceleration from g (sin α − µ cos α), as a share of it.";
    descent(system, "slide", "Slide along a friction axis", words, GRAVITY * (SLOPE.sin() - 0.3 * SLOPE.cos()))
}

pub fn slide_oblique() -> Case {
    let system = slope(block(), std::f64::consts::FRAC_PI_4, 0.3);
    let words = "The same, 45° to the friction axes.";
    descent(
        system,
        "slide-oblique",
        "Slide across the friction axes",
        words,
        GRAVITY * (SLOPE.sin() - 0.3 * SLOPE.cos()),
    )
}

pub fn roll() -> Case {
    let system = slope(on_ground(Body::sphere(1.0, 0.1, Vector3::new(0.0, 0.0, 0.1))), 0.0, 0.8);
    let words = "A solid ball rolls down the slope, friction 0.8, 2 s. Error: difference of its acceleration from \
                 5/7 g sin α, as a share of it.";
    descent(system, "roll", "Rolling ball", words, GRAVITY * SLOPE.sin() * 5.0 / 7.0)
}

/// Largest distance (m) of a body from where it started, at any time of comparison.
fn drift(system: &System) -> Measure {
    let start: Vec<_> = system.bodies.iter().map(|body| body.pose.translation.vector).collect();
    Box::new(move |samples: &Samples| {
        let moved = |states: &Vec<State>| {
            largest(states.iter().zip(&start).map(|(state, start)| (state.pose.translation.vector - start).norm()))
        };
        largest(samples.iter().map(moved))
    })
}

pub fn stick() -> Case {
    let (system, times) = (slope(block(), 0.3, 0.8), times(10, 25));
    Case {
        name: "stick",
        title: "Stick on a slope",
        words: "The same box on the slope, friction 0.8, 4 s: it should stay. Error: largest distance from its start.",
        unit: "m",
        family: Family::Contact,
        measure: drift(&system),
        system,
        times,
        limit: 0.5,
    }
}

/// Cubes of 0.2 m on each other; an error above 0.1 m is a fallen stack.
fn stack(name: &'static str, title: &'static str, words: &'static str, masses: &[f64]) -> Case {
    let mut system = System::of(vec![Body::fixed(Some(Shape::Ground))]);
    for (i, &mass) in masses.iter().enumerate() {
        let place = Vector3::new(0.0, 0.0, 0.1 + 0.2 * i as f64);
        system.bodies.push(Body::block(mass, Vector3::repeat(0.2), place));
    }
    system.friction = 0.5;
    let measure = drift(&system);
    Case { name, title, words, unit: "m", family: Family::Contact, system, times: times(25, 12), measure, limit: 0.1 }
}

pub fn stack10() -> Case {
    let words = "Ten cubes of 0.2 m and 1 kg, 4.8 s. Error: largest distance of a cube from its place, penetration and drift alike; above \
                 0.1 m the stack counts as fallen.";
    stack("stack10", "Stack of 10", words, &[1.0; 10])
}

pub fn stack2() -> Case {
    stack("stack2-heavy", "Stack of 2, mass ratio 1000", "A cube of 1000 kg on one of 1 kg, 4.8 s.", &[1.0, 1000.0])
}

pub fn stack5() -> Case {
    let words = "A cube of 1000 kg on four of 1 kg, 4.8 s.";
    stack("stack5-heavy", "Stack of 5, mass ratio 1000", words, &[1.0, 1.0, 1.0, 1.0, 1000.0])
}

/// Radius of the spheres of a drop, m.
const RADIUS: f64 = 0.05;

/// 216 spheres in a cube that fall onto the ground, no two straight above each other.
fn drop(restitution: f64) -> System {
    let mut system = System::of(vec![Body::fixed(Some(Shape::Ground))]);
    for i in 0..216 {
        let (x, y, z) = (i % 6, i / 6 % 6, i / 36);
        let shift = 0.02 * f64::from(z % 3);
        let place =
            Vector3::new(f64::from(x) * 0.13 + shift, f64::from(y) * 0.13 - shift / 2.0, 0.3 + f64::from(z) * 0.13);
        system.bodies.push(Body::sphere(0.5, RADIUS, place));
    }
    system.restitution = restitution;
    system
}

pub fn spheres() -> Case {
    let (system, times) = (drop(0.0), times(25, 3));
    let bodies = system.bodies.clone();
    Case {
        name: "spheres",
        title: "216 spheres dropped, inelastic",
        words: "A cube of 6 × 6 × 6 spheres of 0.1 m without friction or restitution falls 0.25 m and collapses, 1.2 s. Error: deepest \
                penetration; energy that rises between two looks by more than 1 % of the initial one counts as a failure.",
        unit: "m",
        family: Family::Contact,
        system,
        times,
        measure: Box::new(move |samples| {
            let energies: Vec<f64> = samples.iter().map(|states| total_energy(&bodies, states)).collect();
            let gained = largest(energies.windows(2).map(|pair| (pair[1] - pair[0]) / energies[0]));
            if gained > 0.01 {
                return f64::INFINITY;
            }
            largest(samples.iter().map(|states| penetration(&states[1..])))
        }),
        limit: RADIUS,
    }
}

/// Deepest overlap of spheres with each other and the ground, m.
fn penetration(states: &[State]) -> f64 {
    let place = |state: &State| state.pose.translation.vector;
    let pairs = states
        .iter()
        .enumerate()
        .flat_map(|(i, a)| states[i + 1..].iter().map(move |b| 2.0 * RADIUS - (place(a) - place(b)).norm()));
    largest(pairs.chain(states.iter().map(|state| RADIUS - place(state).z)))
}

pub fn elastic_spheres() -> Case {
    let (system, times) = (drop(1.0), times(25, 3));
    let bodies = system.bodies.clone();
    let at_first = bodies.iter().map(|body| body.mass * GRAVITY * body.pose.translation.z).sum::<f64>();
    Case {
        name: "spheres-elastic",
        title: "216 spheres dropped, elastic",
        words: "The same with restitution 1. Error: largest deviation of the total energy from the initial one, as a share of it.",
        unit: "of the energy",
        family: Family::Bounce,
        system,
        times,
        measure: Box::new(move |samples| {
            largest(samples.iter().map(|states| (total_energy(&bodies, states) / at_first - 1.0).abs()))
        }),
        limit: 1.0,
    }
}
