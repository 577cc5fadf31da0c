//! Soft bodies in a world: they hang, lie on things, and hold and are held by rigid bodies.

use crate::soft_common::{ball, cloth, node, nodes, run, velocities, world};
use ambf_core::bullet::{RigidBody, Shape, SoftBody, SoftConfig, Solver, World};
use nalgebra::{Isometry3, Vector3};

#[test]
fn a_hanging_cloth_keeps_its_size_and_loses_energy() {
    let mut world = world();
    let fixed_nodes = (0..10).collect();
    let config = SoftConfig { kDP: 0.002, ..cloth(10).config };
    let cloth = world.add_soft_body(&SoftBody { fixed_nodes, config, ..cloth(10) }).unwrap();
    let energy = |world: &World| -> f64 {
        let states = nodes(world, cloth).into_iter().zip(velocities(world, cloth));
        states.map(|(x, v)| 0.01 * (10.0 * x[2] + Vector3::from(v).norm_squared() / 2.0)).sum()
    };
    let mut before = energy(&world);
    for _ in 0..10 {
        run(&mut world, 1000);
        let now = energy(&world);
        assert!(now < before + 1e-6, "energy rose from {before} to {now}");
        before = now;
    }
    for (i, x) in nodes(&world, cloth).into_iter().enumerate() {
        let (column, row) = ((i % 10) as f64, (i / 10) as f64);
        assert!((x[0] - 0.1 * column).abs() < 0.03, "{i}: {x:?}");
        assert!((x[2] + 0.1 * row).abs() < 0.05, "{i} hangs straight down: {x:?}");
    }
    let fastest = velocities(&world, cloth).into_iter().map(|v| Vector3::from(v).norm()).fold(0.0, f64::max);
    assert!(fastest < 0.1, "{fastest}");
}

#[test]
fn a_cloth_lies_on_boxes_and_planes() {
    // Bullet's distance fields are as coarse as 0.25 m, and its planes are 0.06 m thick for soft bodies.
    let (plane, box_) = (Shape::plane(Vector3::z(), 0.0, 0.0), Shape::cuboid(Vector3::new(2.0, 2.0, 1.0), 0.01));
    let half = Shape::cuboid(Vector3::repeat(1.0), 0.01);
    let raised = Shape::compound([(half, Isometry3::translation(0.0, 0.0, 0.5))]);
    for (shape, surface) in [(plane, 0.06), (box_, 1.0), (raised, 1.5)] {
        let mut world = world();
        world.add_body(RigidBody { shape, ..ball(0.0, 0.0) });
        let pose = Isometry3::translation(-0.2, -0.2, surface + 0.2);
        let config = SoftConfig { kDP: 0.01, kDF: 1.0, ..cloth(5).config };
        let cloth = world.add_soft_body(&SoftBody { pose, config, ..cloth(5) }).unwrap();
        run(&mut world, 3000);
        let low = nodes(&world, cloth).into_iter().map(|x| x[2]).fold(f64::MAX, f64::min);
        assert!((surface - 0.05..surface + 0.1).contains(&low), "{low} over {surface}");
    }
}

#[test]
fn anchors_follow_the_body_and_pull_on_it() {
    let mut world = world();
    let cloth = world.add_soft_body(&cloth(5)).unwrap();
    let holder = world.add_body(RigidBody { pose: Isometry3::translation(0.0, 0.0, 0.5), ..ball(0.0, 0.0) });
    let pivot = Vector3::new(0.0, 0.0, -0.5);
    assert!(world.add_anchor(cloth, 0, holder, &pivot, 1.0, true));
    run(&mut world, 2000);
    let first = node(&world, cloth, 0);
    assert!(first.norm() < 0.02, "{first}");
    assert!(world.soft_center(cloth).unwrap().z < -0.1, "the rest hangs from it");
    for i in 0..500 {
        world.set_pose(holder, &Isometry3::translation(0.0, 0.001 * f64::from(i), 0.5));
        run(&mut world, 1);
    }
    let first = node(&world, cloth, 0);
    assert!((first - Vector3::new(0.0, 0.499, 0.0)).norm() < 0.05, "it followed to {first}");
    assert_eq!(world.remove_anchors(cloth, holder), 1);
    assert_eq!(world.remove_anchors(cloth, holder), 0);
    run(&mut world, 1000);
    assert!(node(&world, cloth, 0).z < -3.0, "it falls");
}

#[test]
fn a_body_hangs_from_a_cloth() {
    let mut world = world();
    let fixed_nodes = (0..5).collect();
    let config = SoftConfig { piterations: 20, kDP: 0.01, ..cloth(5).config };
    let cloth = world.add_soft_body(&SoftBody { fixed_nodes, config, ..cloth(5) }).unwrap();
    let load = world.add_body(RigidBody {
        pose: Isometry3::translation(0.2, 0.4, -0.2),
        linear_damping: 0.9,
        angular_damping: 0.9,
        ..ball(0.5, 0.0)
    });
    for i in 20..25 {
        let pivot = node(&world, cloth, i) - world.pose(load).unwrap().translation.vector;
        assert!(world.add_anchor(cloth, i, load, &pivot, 1.0, true));
    }
    run(&mut world, 3000);
    let z = world.pose(load).unwrap().translation.z;
    // Rows 0.4 m long, and the load 0.2 m below the last of them.
    assert!((z + 0.6).abs() < 0.1, "{z}");
    assert!(world.remove_body(load), "its anchors are dropped");
    run(&mut world, 500);
    assert!(world.add_soft_body(&SoftBody { fixed_nodes: vec![0], ..self::cloth(3) }).is_ok());
}

#[test]
fn soft_bodies_stop_each_other() {
    let mut world = world();
    let config = SoftConfig { flags: 17, kDP: 0.01, ..cloth(6).config };
    let all = (0..36).collect();
    let table = world.add_soft_body(&SoftBody { fixed_nodes: all, config, ..cloth(6) }).unwrap();
    let pose = Isometry3::translation(0.13, 0.12, 0.1);
    let falling = world.add_soft_body(&SoftBody { pose, config, ..cloth(3) }).unwrap();
    run(&mut world, 1000);
    let z = world.soft_center(falling).unwrap().z;
    assert!((-0.05..0.06).contains(&z), "{z}");
    assert!(world.remove_soft_body(table));
    run(&mut world, 1000);
    let z = world.soft_center(falling).unwrap().z;
    assert!(z < -0.5, "{z}");
}

#[test]
fn rigid_bodies_do_not_notice_the_kind_of_world() {
    let end = |mut world: World| {
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.3, 0.0), ..ball(0.0, 0.0) });
        let bodies: Vec<_> = (0..20)
            .map(|i| {
                let place = Vector3::new(0.05 * f64::from(i % 3), 0.03 * f64::from(i % 5), 0.2 * f64::from(i));
                let shape = Shape::cuboid(Vector3::new(0.1, 0.08, 0.09), 0.001);
                world.add_body(RigidBody { shape, pose: place.into(), ..ball(1.0, 0.0) })
            })
            .collect();
        for _ in 0..1500 {
            world.step(0.001, 1, 0.001);
        }
        bodies.into_iter().map(|body| world.pose(body).unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(end(World::new(Solver::default())), end(World::with_soft_bodies(Solver::default())));
}

#[test]
fn a_cloth_slides_far_on_a_plane() {
    let mut world = world();
    world.set_gravity(Vector3::new(3.0, 0.0, -10.0));
    world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), ..ball(0.0, 0.0) });
    let config = SoftConfig { kDF: 0.0, ..cloth(5).config };
    let pose = Isometry3::translation(0.0, 0.0, 0.1);
    let cloth = world.add_soft_body(&SoftBody { pose, config, ..cloth(5) }).unwrap();
    run(&mut world, 2000);
    let center = world.soft_center(cloth).unwrap();
    // a t² / 2 along the plane, less what friction takes.
    assert!(center.x > 2.0 && (0.0..0.2).contains(&center.z), "{center}");
}
