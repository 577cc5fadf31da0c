//! What joints hold, report and obey.

use std::f64::consts::TAU;

use crate::physics_common::{close, near, turned, Bench, HEAVY, WEIGHTLESS};
use ambf_core::comm::JointCommandType;
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// A body 0.5 m beside a fixed one, joined at the fixed one's origin; `AXIS` as x/y/z numbers, `KEYS` the rest of the
/// joint.
const LEVER: &str = "bodies: [BODY Base, BODY Link]\njoints: [JOINT J]\n\
    BODY Base: {name: Base, mass: 0}\n\
    BODY Link: {name: Link, mass: 1, inertia: {ix: 0.01, iy: 0.01, iz: 0.01}, location: {position: {x: 0.5, y: 0, z: 0}}, \
    damping: {linear: DAMPING, angular: DAMPING}}\n\
    JOINT J: {name: J, parent: BODY Base, child: BODY Link, parent axis: {AXIS}, child axis: {AXIS}, \
    parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: -0.5, y: 0, z: 0}, KEYS}\n";

fn lever(world: &str, axis: &str, damping: f64, keys: &str) -> Bench {
    let text = LEVER.replace("AXIS", axis).replace("DAMPING", &damping.to_string()).replace("KEYS", keys);
    Bench::new(world, &text)
}

const X: &str = "x: 1, y: 0, z: 0";
const Y: &str = "x: 0, y: 1, z: 0";
const Z: &str = "x: 0, y: 0, z: 1";

#[test]
fn default_position_control_follows_the_known_curve() {
    // A rod of 1 kg and 1 m about its end, default gains, cfm, erp and impulse: known angles after so many steps of a
    // set point of 0.5 rad. They were given without the inertia, so 4 mrad is as close as they can be compared.
    let text = LEVER.replace("ix: 0.01, iy: 0.01, iz: 0.01", "ix: 0.001, iy: 0.0833, iz: 0.0833");
    let text = text.replace("AXIS", Y).replace("DAMPING", "0").replace("KEYS", "type: revolute");
    let mut bench = Bench::new(WEIGHTLESS, &text);
    let mut done = 0;
    for (steps, angle) in [(20, 0.040), (200, 0.316), (1000, 0.497), (4000, 0.500)] {
        bench.command("Base", 0, JointCommandType::Position, 0.5, steps - done);
        done = steps;
        close(bench.joint("J").position, angle, 0.004);
    }
    close(bench.joint("J").position, 0.5, 1e-6);
}

#[test]
fn a_pendulum_swings_with_the_period_of_its_length() {
    // Physical pendulum from level to level: T = 1.18034·2π·√((I + m l²)/(m g l)), the factor from the complete
    // elliptic integral for an amplitude of 90°.
    let mut bench = lever(HEAVY, Y, 0.0, "type: revolute, joint cfm: 0");
    let mut crossings = Vec::new();
    let mut before = bench.position("Link").x;
    for step in 1..=6000_u32 {
        bench.steps(1);
        let now = bench.position("Link").x;
        if before > 0.0 && now <= 0.0 {
            crossings.push(step);
        }
        before = now;
    }
    let period = f64::from(crossings[2] - crossings[0]) * 0.001 / 2.0;
    close(period, 1.180_34 * TAU * ((0.01 + 0.25_f64) / (10.0 * 0.5)).sqrt(), 0.003);
}

#[test]
fn the_effort_of_a_held_lever_is_its_weight_times_its_length() {
    // Without cfm the motor does not creep.
    let keys = "type: revolute, enable feedback: true, max motor impulse: 10, joint cfm: 0";
    let mut bench = lever(HEAVY, Y, 0.04, keys);
    bench.command("Base", 0, JointCommandType::Velocity, 0.0, 1000);
    let joint = bench.joint("J");
    close(joint.velocity, 0.0, 1e-6);
    close(bench.position("Link").x, 0.5, 1e-3);
    // About +y a weight on +x pulls the parent the positive way.
    close(joint.effort, 1.0 * 10.0 * 0.5, 0.01);
}

#[test]
fn without_feedback_there_is_no_effort() {
    let mut bench = lever(HEAVY, Y, 0.04, "type: revolute");
    bench.command("Base", 0, JointCommandType::Velocity, 0.0, 100);
    assert_eq!(bench.joint("J").effort, 0.0);
    assert!(bench.0.wrenches().is_empty());
}

#[test]
fn a_fixed_joint_reports_the_weight_it_carries() {
    let mut bench = lever(HEAVY, Y, 0.04, "type: fixed, enable feedback: true");
    bench.steps(2000);
    let [base, link] = ["Base", "Link"].map(|name| bench.0.wrenches()[bench.body(name)]);
    near(link.force, [0.0, 0.0, 10.0], 0.05);
    near(base.force, [0.0, 0.0, -10.0], 0.05);
    // 10 N at 0.5 m pull the base about +y.
    near(base.torque, [0.0, 5.0, 0.0], 0.05);
}

/// What a joint held in two seconds of 10 m/s² on 1 kg at 0.5 m.
struct Held {
    bench: Bench,
    /// Largest distance of the link's end of the joint from the base's, m: in all, and across the joint's axis.
    apart: f64,
    across: f64,
    /// Largest rotation of the link, and of the joint's axis in it, rad.
    turned: f64,
    tilted: f64,
}

fn hold(axis: &str, direction: Vector3<f64>, keys: &str) -> Held {
    let bench = lever(HEAVY, axis, 0.04, keys);
    let mut held = Held { bench, apart: 0.0, across: 0.0, turned: 0.0, tilted: 0.0 };
    for _ in 0..2000 {
        held.bench.steps(1);
        let pose = held.bench.pose("Link");
        let end = pivot(&held.bench);
        held.apart = held.apart.max(end.norm());
        held.across = held.across.max(end.cross(&direction).norm());
        held.turned = held.turned.max(turned(&pose.rotation, &UnitQuaternion::identity()));
        held.tilted = held.tilted.max((pose.rotation * direction).angle(&direction));
    }
    held
}

/// Where the link's end of the joint is.
fn pivot(bench: &Bench) -> Vector3<f64> {
    (bench.pose("Link") * Point3::new(-0.5, 0.0, 0.0)).coords
}

// Tolerances below: what Bullet leaves with the default erp and cfm of 0.1, times two to five.

#[test]
fn a_revolute_joint_turns_about_its_axis_only() {
    for (axis, direction) in [(X, Vector3::x()), (Y, Vector3::y()), (Z, Vector3::z())] {
        let held = hold(axis, direction, "type: revolute");
        assert!(held.apart < 5e-4 && held.tilted < 5e-3, "{axis}: {} m, {} rad", held.apart, held.tilted);
        // Only about y does the weight turn it.
        assert_eq!(held.turned > 1.0, axis == Y, "{axis}");
    }
}

#[test]
fn a_prismatic_joint_slides_along_its_axis_between_its_limits() {
    let limits = "type: prismatic, joint limits: {low: -0.2, high: 0.2}";
    for (axis, direction, end) in [(X, Vector3::x(), 0.0), (Z, Vector3::z(), -0.2)] {
        let held = hold(axis, direction, limits);
        assert!(held.across < 1e-3 && held.turned < 5e-3, "{axis}: {} m, {} rad", held.across, held.turned);
        assert!(held.apart < 0.201, "{axis}: {} m", held.apart);
        close(held.bench.joint("J").position, end, 1e-3);
    }
}

#[test]
fn a_fixed_joint_holds_everything() {
    let held = hold(Y, Vector3::y(), "type: fixed");
    assert!(held.apart < 1e-6 && held.turned < 1e-3, "{} m, {} rad", held.apart, held.turned);
}

#[test]
fn a_ball_joint_holds_a_point() {
    let held = hold(Y, Vector3::y(), "type: p2p");
    assert!(held.apart < 1e-3 && held.turned > 1.0, "{} m, {} rad", held.apart, held.turned);
}

#[test]
fn a_cone_twist_joint_stays_within_its_cone() {
    let held = hold(X, Vector3::x(), "type: cone twist, joint limits: {x: 0.3, y: 0.3, z: 0.3}");
    assert!(held.apart < 5e-3 && held.turned < 0.31, "{} m, {} rad", held.apart, held.turned);
    close(held.bench.pose("Link").rotation.angle(), 0.3, 1e-3);
}

#[test]
fn springs_give_way_by_force_over_stiffness() {
    let keys =
        "type: linear spring, stiffness: 100, damping: 10, equilibrium point: 0, joint limits: {low: -1, high: 1}";
    let held = hold(Z, Vector3::z(), keys);
    assert!(held.across < 1e-6 && held.turned < 1e-3, "{} m, {} rad", held.across, held.turned);
    close(held.bench.joint("J").position, -10.0 / 100.0, 1e-3);

    let keys =
        "type: torsion spring, stiffness: 50, damping: 2, equilibrium point: 0, joint limits: {low: -1, high: 1}";
    let held = hold(Y, Vector3::y(), keys);
    assert!(held.apart < 1e-4 && held.tilted < 1e-3, "{} m, {} rad", held.apart, held.tilted);
    // 50·θ = 10·0.5·cos θ.
    close(held.bench.joint("J").position, 0.0995, 1e-4);
}

#[test]
fn a_spring_without_limits_is_locked() {
    let held = hold(Z, Vector3::z(), "type: linear spring, stiffness: 1, damping: 0");
    assert!(held.apart < 1e-3, "{} m", held.apart);
}

#[test]
fn six_dof_joints_move_where_they_may() {
    let limits = "joint limits: {linear: {low: {x: 0, y: 0, z: -0.1}, high: {x: 0, y: 0, z: 0.1}}, \
                  angular: {low: {x: 0, y: 0, z: 0}, high: {x: 0, y: 0, z: 0}}}";
    let held = hold(Z, Vector3::z(), &format!("type: six dof, {limits}"));
    assert!(held.across < 5e-3 && held.turned < 0.02, "{} m, {} rad", held.across, held.turned);
    close(pivot(&held.bench).z, -0.1, 1e-3);

    let spring = "stiffness: {linear: {x: 0, y: 0, z: 200}, angular: {x: 0, y: 0, z: 0}}, \
                  damping: {linear: {x: 0, y: 0, z: 20}, angular: {x: 0, y: 0, z: 0}}, \
                  equilibrium point: {linear: {x: 0, y: 0, z: 0}, angular: {x: 0, y: 0, z: 0}}";
    let held = hold(Z, Vector3::z(), &format!("type: six dof spring, {limits}, {spring}"));
    assert!(held.across < 1e-6 && held.turned < 1e-3, "{} m, {} rad", held.across, held.turned);
    close(pivot(&held.bench).z, -10.0 / 200.0, 1e-3);
}

#[test]
fn the_velocity_of_a_joint_is_a_difference_over_the_interval_before() {
    let mut bench = lever(WEIGHTLESS, Y, 0.0, "type: revolute");
    let body = bench.body("Link");
    // 1 rad/s about y: the centre of mass moves down at 0.5 m/s.
    bench.0.set_velocity(body, Vector3::new(0.0, 0.0, -0.5), Vector3::y());
    bench.steps(1);
    assert_eq!(bench.joint("J").velocity, 0.0, "there is no interval before the first");
    bench.steps(50);
    let before = bench.joint("J").position;
    bench.update(0.003);
    let joint = bench.joint("J");
    close(joint.velocity, (joint.position - before) / 0.001, 1e-9);
    bench.steps(1);
    let slow = bench.joint("J").velocity;
    assert!(slow < 0.5, "1 ms of motion over the 3 ms before: {slow}");
}

#[test]
fn a_joint_that_turns_past_half_a_turn_has_no_spike() {
    let mut bench = lever(WEIGHTLESS, Y, 0.0, "type: revolute, joint cfm: 0");
    let body = bench.body("Link");
    bench.0.set_velocity(body, Vector3::new(0.0, 0.0, -2.0), Vector3::y() * 4.0);
    bench.steps(2);
    let mut wrapped = false;
    for _ in 0..1000 {
        bench.steps(1);
        let joint = bench.joint("J");
        wrapped |= joint.position < 0.0;
        assert!((3.0..5.0).contains(&joint.velocity), "{}", joint.velocity);
    }
    assert!(wrapped, "it never passed half a turn");
}

#[test]
fn commands_that_name_no_joint_or_no_number_are_refused() {
    let mut bench = lever(WEIGHTLESS, Y, 0.0, "type: revolute");
    let (base, link) = (bench.body("Base"), bench.body("Link"));
    assert!(bench.0.command_joint(base, 0, JointCommandType::Effort, 1.0));
    assert!(!bench.0.command_joint(base, 1, JointCommandType::Effort, 1.0));
    assert!(!bench.0.command_joint(link, 0, JointCommandType::Effort, 1.0));
    assert!(!bench.0.command_joint(base, 0, JointCommandType::Effort, f64::NAN));
    assert!(!bench.0.command_joint(base, 0, JointCommandType::Position, f64::INFINITY));
}

/// Distance by which the last of twelve balls of 1 g on 1 cm links hangs too low after 2 s with a solver of 30 iterations, m. Its
/// load is 100 times as heavy.
fn stretch_of_a_chain(solver: &str) -> f64 {
    let names: Vec<_> = (0..13).map(|i| format!("BODY L{i}")).collect();
    let joints: Vec<_> = (1..13).map(|i| format!("J{i}")).collect();
    let mut text = format!("bodies: [{}]\njoints: [{}]\n", names.join(", "), joints.join(", "));
    for i in 0..13 {
        let mass = [0.0, 0.001, 0.1][usize::from(i > 0) + usize::from(i == 12)];
        text += &format!(
            "BODY L{i}: {{name: L{i}, mass: {mass}, location: {{position: {{x: 0, y: 0, z: {}}}}}, collision shape: Sphere, \
             collision geometry: {{radius: 0.003}}}}\n",
            -0.01 * f64::from(i)
        );
    }
    for i in 1..13 {
        text += &format!(
            "J{i}: {{name: J{i}, type: revolute, parent: BODY L{}, child: BODY L{i}, parent axis: {{x: 0, y: 1, z: 0}}, \
             child axis: {{x: 0, y: 1, z: 0}}, parent pivot: {{x: 0, y: 0, z: -0.01}}, child pivot: {{x: 0, y: 0, z: 0}}}}\n",
            i - 1
        );
    }
    let world =
        format!("gravity: {{x: 0, y: 0, z: -10}}\nphysics: {{profile: legacy, solver: {solver}, iterations: 30}}\n");
    let mut bench = Bench::new(&world, &text);
    bench.steps(2000);
    (bench.position("L12").z + 0.12).abs()
}

/// Bullet's own conjugate gradients take velocities for impulses: this chain was lost.
#[test]
fn conjugate_gradients_close_joints_better_than_sequential_impulses() {
    let (plain, conjugate) = (stretch_of_a_chain("si"), stretch_of_a_chain("nncg"));
    assert!(conjugate < 0.5 * plain, "{conjugate} m, {plain} m");
}
