//! How bodies move: integration, sub-steps, gravity, resets, estimated inertia, Cartesian control.

use crate::physics_common::{close, load_texts, near, turned, Bench, DT, HEAVY, WEIGHTLESS};
use ambf_core::ids::BodyId;
use ambf_core::scene::Loaded;
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

const BALL: &str = "bodies: [BODY Ball]\nBODY Ball: {name: Ball, mass: 2, inertia: {ix: 0.1, iy: 0.2, iz: 0.3}, \
                    damping: {linear: LINEAR, angular: 0}}\n";

fn ball(world: &str, linear_damping: f64) -> Bench {
    Bench::new(world, &BALL.replace("LINEAR", &linear_damping.to_string()))
}

#[test]
fn a_fall_follows_the_integrators_formula() {
    let mut bench = ball(HEAVY, 0.0);
    for step in 1..=1000 {
        bench.steps(1);
        // Velocity first, then position with the new velocity.
        let k = f64::from(step);
        close(bench.velocity("Ball").0.z, -10.0 * DT * k, 1e-11);
        close(bench.position("Ball").z, -10.0 * DT * DT * k * (k + 1.0) / 2.0, 1e-11);
    }
}

#[test]
fn damping_takes_its_share_each_second() {
    let mut bench = ball(HEAVY, 0.3);
    let kept = 0.7_f64.powf(DT);
    let mut speed = 0.0;
    for _ in 0..2000 {
        bench.steps(1);
        speed = speed * kept + 10.0 * DT;
    }
    close(-bench.velocity("Ball").0.z, speed, 1e-9);
    assert!(speed < 15.0, "20 m/s without damping");
}

#[test]
fn a_force_acts_through_all_sub_steps_of_an_update_and_no_longer() {
    let mut bench = ball(WEIGHTLESS, 0.0);
    bench.push("Ball", Vector3::new(6.0, 0.0, 0.0));
    bench.update(0.004);
    near(bench.velocity("Ball").0, [6.0 / 2.0 * 0.004, 0.0, 0.0], 1e-14);
    bench.update(0.004);
    near(bench.velocity("Ball").0, [0.012, 0.0, 0.0], 1e-14);
}

#[test]
fn a_force_is_lost_in_an_update_without_a_sub_step() {
    let mut bench = ball(WEIGHTLESS, 0.0);
    bench.push("Ball", Vector3::new(6.0, 0.0, 0.0));
    bench.update(0.0004);
    bench.update(0.0008);
    near(bench.velocity("Ball").0, [0.0; 3], 0.0);
    // At 2 kHz every second update does nothing else; a force given again each time is the same force.
    for _ in 0..200 {
        bench.push("Ball", Vector3::new(6.0, 0.0, 0.0));
        bench.update(0.0005);
    }
    near(bench.velocity("Ball").0, [6.0 / 2.0 * 0.1, 0.0, 0.0], 1e-12);
}

#[test]
fn sixty_updates_a_second_keep_up_if_they_may() {
    let fallen = |world: &str| {
        let mut bench = ball(world, 0.0);
        (0..60).for_each(|_| bench.update(1.0 / 60.0));
        close(bench.0.sim_time(), 1.0, 1e-12);
        (-bench.velocity("Ball").0.z / 10.0, bench.0.lost_time())
    };
    let (simulated, lost) = fallen(HEAVY);
    close(simulated, 1.0, 0.0011);
    assert_eq!(lost, 0.0);
    // Ten sub-steps, the default, of the 16 or 17 that are due: 60 %.
    let (simulated, lost) = fallen("gravity: {x: 0, y: 0, z: -10}\n");
    close(simulated, 0.6, 1e-9);
    close(simulated + lost, 1.0, 0.0011);
}

#[test]
fn reported_poses_lag_by_up_to_a_sub_step() {
    let mut bench = ball(WEIGHTLESS, 0.0);
    bench.throw("Ball", Vector3::new(1.0, 0.0, 0.0));
    for update in 1..=20 {
        bench.update(0.0015);
        let given = 0.0015 * f64::from(update);
        // Whole sub-steps, against the time given less one sub-step.
        close(bench.position("Ball").x, (given / DT + 1e-6).floor() * DT, 1e-12);
        close(bench.reported("Ball").translation.x, given - DT, 1e-12);
    }
}

#[test]
fn nothing_happens_in_no_time() {
    let mut bench = ball(HEAVY, 0.0);
    for interval in [0.0, -1.0, f64::NAN] {
        bench.update(interval);
    }
    assert_eq!((bench.0.sim_step(), bench.0.sim_time()), (0, 0.0));
    near(bench.position("Ball"), [0.0; 3], 0.0);
}

#[test]
fn gravity_of_a_body_goes_before_the_models_and_the_worlds() {
    let model = |gravity: &str, bodies: &str| format!("{gravity}{bodies}");
    let two = "bodies: [BODY A, BODY B]\n\
               BODY A: {name: A, mass: 1, damping: {linear: 0, angular: 0}}\n\
               BODY B: {name: B, mass: 1, damping: {linear: 0, angular: 0}, gravity: {x: 3, y: 0, z: 0}}\n";
    let speed_after_reset = |bench: &mut Bench| {
        bench.steps(50);
        bench.0.reset_bodies();
        bench.steps(100);
        (bench.velocity("A").0, bench.velocity("B").0)
    };
    let (a, b) = speed_after_reset(&mut Bench::new(HEAVY, &model("", two)));
    near(a, [0.0, 0.0, -1.0], 1e-12);
    near(b, [0.3, 0.0, 0.0], 1e-12);
    let (a, b) = speed_after_reset(&mut Bench::new(HEAVY, &model("gravity: {x: 0, y: 5, z: 0}\n", two)));
    near(a, [0.0, 0.5, 0.0], 1e-12);
    near(b, [0.3, 0.0, 0.0], 1e-12);
}

#[test]
fn a_reset_returns_to_the_start_and_time_goes_on() {
    let mut bench = ball(HEAVY, 0.0);
    bench.steps(100);
    let (fallen, speed) = (bench.position("Ball").z, bench.velocity("Ball").0.z);
    let body = bench.body("Ball");
    bench.0.set_velocity(body, Vector3::new(1.0, 2.0, 3.0), Vector3::new(4.0, 5.0, 6.0));
    bench.steps(50);
    bench.push("Ball", Vector3::new(1e3, 0.0, 0.0));
    bench.0.reset_world();
    assert_eq!(bench.pose("Ball"), Isometry3::identity());
    assert_eq!(bench.reported("Ball"), Isometry3::identity());
    assert_eq!(bench.velocity("Ball"), (Vector3::zeros(), Vector3::zeros()));
    assert_eq!(bench.0.sim_step(), 150);
    // The pending force is gone too: the fall is the same again.
    bench.steps(100);
    assert_eq!((bench.position("Ball").z, bench.velocity("Ball").0.z), (fallen, speed));
    near(bench.position("Ball"), [0.0, 0.0, fallen], 0.0);
    close(bench.0.sim_time(), 0.25, 1e-12);
}

#[test]
fn the_moment_of_inertia_is_that_of_the_bounding_box() {
    // Mass 12: I = sum of the squares of two edges. Around a cone Bullet leaves twice the margin on each side.
    for (shape, edges) in [
        ("Box, geometry: {x: 0.2, y: 0.3, z: 0.4}", [0.2, 0.3, 0.4]),
        ("Sphere, geometry: {radius: 0.1}", [0.2; 3]),
        ("Cylinder, geometry: {radius: 0.1, height: 0.5, axis: x}", [0.5, 0.2, 0.2]),
        ("Cylinder, geometry: {radius: 0.1, height: 0.5, axis: z}", [0.2, 0.2, 0.5]),
        ("Capsule, geometry: {radius: 0.1, height: 0.5, axis: y}", [0.2, 0.5, 0.2]),
        ("Cone, geometry: {radius: 0.1, height: 0.5, axis: z}", [0.204, 0.204, 0.504]),
    ] {
        let shape = shape.replace("geometry", "collision geometry");
        let text =
            format!("bodies: [B]\nB: {{name: B, mass: 12, collision margin: 0.001, collision shape: {shape}}}\n");
        let bench = Bench::new(WEIGHTLESS, &text);
        let [x, y, z] = edges.map(|edge| edge * edge);
        near(bench.0.scene().bodies[BodyId::new(0)].inertia, [y + z, z + x, x + y], 1e-9);
    }
}

#[test]
fn several_shapes_count_as_their_common_box() {
    let text = "bodies: [B]\nB: {name: B, mass: 12, compound collision shape: [\
                {shape: Box, geometry: {x: 0.2, y: 0.2, z: 0.2}, offset: {position: {x: 0.4, y: 0, z: 0}}}, \
                {shape: Sphere, geometry: {radius: 0.1}, offset: {position: {x: -0.4, y: 0, z: 0}}}]}\n";
    let bench = Bench::new(WEIGHTLESS, text);
    let (x, y) = (1.0, 0.04);
    near(bench.0.scene().bodies[BodyId::new(0)].inertia, [y + y, x + y, x + y], 1e-9);
}

#[test]
fn a_written_moment_of_inertia_is_used_and_a_plane_has_none() {
    let bench = ball(WEIGHTLESS, 0.0);
    near(bench.0.scene().bodies[BodyId::new(0)].inertia, [0.1, 0.2, 0.3], 0.0);
    let text = "bodies: [P]\nP: {name: P, mass: 0, collision shape: Plane, \
                collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}}\n";
    near(Bench::new(HEAVY, text).0.scene().bodies[BodyId::new(0)].inertia, [0.0; 3], 0.0);
}

#[test]
fn a_body_without_a_shape_does_not_turn() {
    let mut bench = Bench::new(WEIGHTLESS, "bodies: [B]\nB: {name: B, mass: 1}\n");
    assert_eq!(bench.0.scene().bodies[BodyId::new(0)].inertia, Vector3::zeros());
    bench.0.apply_wrench(BodyId::new(0), Vector3::x(), Vector3::new(1.0, 2.0, 3.0));
    bench.steps(10);
    assert_eq!(bench.velocity("B").1, Vector3::zeros());
    assert!(bench.velocity("B").0.x > 0.0);
}

#[test]
fn the_default_cartesian_controller_converges() {
    let mut bench = ball(WEIGHTLESS, 0.0);
    let target = Isometry3::from_parts(
        Translation3::new(0.1, -0.2, 0.3),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 1.0),
    );
    let left = |bench: &Bench| {
        let pose = bench.pose("Ball");
        (pose.translation.vector - target.translation.vector).norm() + turned(&pose.rotation, &target.rotation)
    };
    let mut before = left(&bench);
    for _ in 0..20 {
        for _ in 0..100 {
            bench.follow("Ball", &target);
            bench.steps(1);
        }
        // The C++ program's derivative term makes the same loop diverge.
        let now = left(&bench);
        assert!(now < 0.4 * before || now < 1e-6, "{now} after {before}");
        before = now;
    }
    assert!(before < 1e-6);
}

#[test]
fn a_controller_with_force_output_is_a_spring_and_a_damper() {
    let text = BALL
        .replace("LINEAR", "0")
        .replace("mass: 2,", "mass: 2, controller: {linear: {P: 200, I: 0, D: 40}, angular: {P: 10, I: 0, D: 2}},");
    let mut bench = Bench::new(WEIGHTLESS, &text);
    let target = Isometry3::translation(0.5, 0.0, 0.0);
    bench.follow("Ball", &target);
    bench.steps(1);
    // The first derivative compares with the error of the start, 0, but no interval has passed yet.
    near(bench.velocity("Ball").0, [200.0 * 0.5 / 2.0 * DT, 0.0, 0.0], 1e-12);
    for _ in 0..4000 {
        bench.follow("Ball", &target);
        bench.steps(1);
    }
    near(bench.position("Ball"), [0.5, 0.0, 0.0], 1e-6);
}

#[test]
fn copies_of_a_model_are_separate_bodies() {
    let text = BALL.replace("LINEAR", "0");
    let loaded = load_texts(HEAVY, &[&text, &text]);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    let mut bench = Bench(Simulation::new(loaded.scene, DT));
    assert_eq!(
        bench.0.scene().bodies.iter().map(|body| body.identity.communication_name()).collect::<Vec<_>>(),
        ["Ball", "Ball1"]
    );
    bench.0.set_velocity(BodyId::new(1), Vector3::x(), Vector3::zeros());
    bench.steps(10);
    let world = &bench.0.scene().world;
    let x = [0, 1].map(|body| world.pose(world.bodies()[body]).expect("live").translation.x);
    close(x[0], 0.0, 0.0);
    close(x[1], 0.01, 1e-12);
}

#[test]
fn what_collides_cannot_turn_like_a_point() {
    let text = |inertia: &str| {
        format!(
            "bodies: [BODY Floor, BODY Cube]\n\
             BODY Floor: {{name: Floor, mass: 0, collision shape: Plane, collision geometry: {{normal: {{x: 0, y: 0, z: 1}}, offset: 0}}}}\n\
             BODY Cube: {{name: Cube, mass: 1, inertia: {{ix: {inertia}, iy: {inertia}, iz: {inertia}}}, collision shape: Box, \
             collision geometry: {{x: 0.2, y: 0.2, z: 0.2}}, \
             location: {{position: {{x: 0, y: 0, z: 0.25}}, orientation: {{r: 0.3, p: 0.4, y: 0}}}}}}\n"
        )
    };
    let world = format!("{HEAVY}physics: {{profile: accurate}}\n");
    for inertia in ["1e-5", "1e-9"] {
        let Loaded { scene, report } = load_texts(&world, &[&text(inertia)]);
        assert!(report.to_string().contains("a solid body of its collision shape"), "{report}");
        let mut bench = Bench(Simulation::new(scene, DT));
        for _ in 0..100 {
            bench.steps(20);
            let height = bench.position("Cube").z;
            assert!((0.09..0.251).contains(&height), "{inertia}: {height}");
        }
    }
    let report = load_texts(&world, &[&text("0.006")]).report;
    assert!(!report.to_string().contains("inertia"), "{report}");
    let Loaded { scene, .. } = load_texts(HEAVY, &[&text("1e-9")]);
    assert_eq!(scene.bodies[BodyId::new(1)].inertia, Vector3::repeat(1e-9), "legacy takes what is written");
}

/// The impulses from which the solver starts belong to the motion that was reset.
#[test]
fn an_accurate_world_repeats_its_motion_to_the_bit_after_a_thorough_reset() {
    let text = "bodies: [BODY Ground, BODY Box]\n\
        BODY Ground: {name: Ground, mass: 0, location: {position: {x: 0, y: 0, z: -0.5}}, collision shape: Box, \
        collision geometry: {x: 4, y: 4, z: 1}, friction: {static: 0.5, rolling: 0.1}}\n\
        BODY Box: {name: Box, mass: 1, location: {position: {x: 1, y: 1, z: 0.05}, orientation: {r: 0.01, p: 0.02, y: 0}}, \
        collision shape: Box, collision geometry: {x: 0.2, y: 0.3, z: 0.1}, friction: {static: 0.5, rolling: 0.1}}\n";
    let mut bench = Bench::new(&(HEAVY.to_owned() + "physics: {profile: accurate}\n"), text);
    let run = |bench: &mut Bench| -> Vec<u64> {
        let mut bits = Vec::new();
        for _ in 0..701 {
            bench.steps(1);
            let pose = bench.pose("Box");
            bits.extend(pose.translation.vector.iter().chain(&pose.rotation.coords).map(|x| x.to_bits()));
        }
        bits
    };
    let first = run(&mut bench);
    bench.0.reset_world();
    assert!(run(&mut bench) == first, "a reset leaves nothing of what was before");
}
