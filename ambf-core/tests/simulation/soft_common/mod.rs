//! A cloth and a ball.
#![allow(missing_docs)]

use ambf_core::bullet::{RigidBody, Shape, SoftBody, SoftBodyHandle, SoftConfig, Solver, World};
use nalgebra::{Isometry3, Vector3};

/// A ball of radius 0.1 m on the x axis.
pub fn ball(mass: f64, x: f64) -> RigidBody {
    RigidBody {
        mass,
        inertia: Vector3::repeat(0.004 * mass),
        shape: Shape::sphere(0.1, 0.001),
        pose: Isometry3::translation(x, 0.0, 0.0),
        friction: 0.5,
        rolling_friction: 0.0,
        restitution: 0.0,
        linear_damping: 0.0,
        angular_damping: 0.0,
        gravity: None,
    }
}

/// A square cloth of n × n nodes, 0.1 m apart, from the origin along x and y, of 1 kg.
pub fn cloth(n: u32) -> SoftBody {
    let node = |x: u32, y: u32| x + n * y;
    let faces: Vec<_> = (0..n - 1)
        .flat_map(|y| (0..n - 1).map(move |x| (x, y)))
        .flat_map(|(x, y)| {
            let [a, b, c, d] = [node(x, y), node(x + 1, y), node(x, y + 1), node(x + 1, y + 1)];
            [[a, b, c], [b, d, c]]
        })
        .collect();
    SoftBody {
        nodes: (0..n * n).map(|i| [0.1 * f64::from(i % n), 0.1 * f64::from(i / n), 0.0]).collect(),
        links: SoftBody::triangle_links(&faces),
        faces,
        mass: 1.0,
        margin: 0.02,
        pose: Isometry3::identity(),
        config: SoftConfig { piterations: 5, ..SoftConfig::default() },
        material: None,
        pose_matching: false,
        bending_distance: None,
        clusters: None,
        fixed_nodes: vec![],
        randomize: false,
    }
}

pub fn world() -> World {
    let mut world = World::with_soft_bodies(Solver::default());
    world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
    world
}

pub fn run(world: &mut World, steps: u32) {
    for _ in 0..steps {
        world.step(0.001, 1, 0.001);
    }
    assert_eq!(world.soft_first_non_finite(), None);
}

pub fn nodes(world: &World, body: SoftBodyHandle) -> Vec<[f64; 3]> {
    let mut nodes = vec![[0.0; 3]; world.soft_nodes(body).unwrap()];
    assert!(world.read_soft_nodes(body, &mut nodes));
    nodes
}

pub fn velocities(world: &World, body: SoftBodyHandle) -> Vec<[f64; 3]> {
    let mut velocities = vec![[0.0; 3]; world.soft_nodes(body).unwrap()];
    assert!(world.read_soft_velocities(body, &mut velocities));
    velocities
}

pub fn node(world: &World, body: SoftBodyHandle, index: usize) -> Vector3<f64> {
    nodes(world, body)[index].into()
}
