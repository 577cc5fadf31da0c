//! States that are set: what is asked for is there, and nothing else has moved.

use crate::physics_common::load_texts;
use crate::saved_common::{all_shipped, scene_name, shipped, simulation, DT};
use ambf_core::control::Profile;
use ambf_core::ids::{BodyId, JointId};
use ambf_core::scene::{Scene, SetStateError, StateChange};
use ambf_core::sim::{Simulation, Stepper};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

fn joint(scene: &Scene, name: &str) -> JointId {
    scene.joints.position(|joint| joint.name == name).expect("the joint is there")
}

fn body(scene: &Scene, name: &str) -> BodyId {
    scene.bodies.position(|body| &*body.identity.name == name).expect("the body is there")
}

/// Positions and rates of all joints.
fn coordinates(scene: &Scene) -> Vec<[f64; 2]> {
    scene.joints.iter().map(|joint| [joint.position, joint.velocity]).collect()
}

/// Twist of a body in the latest publication: of its centre of mass, and angular.
fn twist(stepper: &Stepper, body: BodyId) -> [Vector3<f64>; 2] {
    let body = &stepper.snapshot().bodies[body];
    [body.linear_velocity.into(), body.angular_velocity.into()]
}

#[test]
fn each_joint_of_each_scene_takes_the_coordinate_that_is_set() {
    let mut count = 0;
    for (scene, profile) in all_shipped().iter().flat_map(|scene| PROFILES.map(|profile| (scene, profile))) {
        let mut stepper = Stepper::new(simulation(scene, profile), DT);
        if stepper.step(20).is_err() {
            continue;
        }
        // Joints that close loops follow: two joints lead to the same body.
        let mut children: Vec<_> = stepper.simulation().scene().joints.iter().map(|joint| joint.child).collect();
        children.sort_unstable();
        let has_loops = children.windows(2).any(|pair| pair[0] == pair[1]);
        for id in stepper.simulation().scene().joints.ids() {
            let what = format!("{} {profile:?} {}", scene_name(scene), stepper.simulation().scene().joints[id].name);
            let before = coordinates(stepper.simulation().scene());
            let limits = stepper.simulation().scene().joints[id].limits;
            let wanted = limits.map_or(0.7, |limits| limits.low + 0.3 * (limits.high - limits.low));
            let change =
                StateChange { positions: vec![(id, wanted)], rates: vec![(id, 0.2)], ..StateChange::default() };
            match stepper.set_state(&change) {
                Ok(()) => count += 1,
                Err(SetStateError::Follows { .. } | SetStateError::LoopOpens { .. }) => continue,
                Err(error) => panic!("{what}: {error}"),
            }
            let scene = stepper.simulation().scene();
            for (other, now) in scene.joints.entries() {
                if other == id {
                    let far = [now.position - wanted, now.velocity - 0.2];
                    assert!(far.iter().all(|far| far.abs() < 1e-6), "{what}: {far:?}");
                }
                // Bullet's own joints tell their coordinates at the beginning of a sub-step.
                let [position, velocity] = before[other.index()];
                let by = now.position - position;
                let is_same = by.abs() < 1e-6 + 1.5 * velocity.abs() * DT;
                assert!(other == id || is_same || has_loops, "{what} moves {} by {by:e}", now.name);
            }
        }
        // What Bullet measures of the same state in the next iteration is the same.
        let before = coordinates(stepper.simulation().scene());
        stepper.step(1).expect("a state that is set is no lost one");
        for (joint, [position, velocity]) in stepper.simulation().scene().joints.iter().zip(before) {
            let turn = (joint.position - position).abs();
            let by = turn.min((turn - std::f64::consts::TAU).abs());
            let what = format!("{} {profile:?} {}", scene_name(scene), joint.name);
            assert!(by < 0.01 + 2.0 * velocity.abs() * DT, "{what}: {position}, then {}", joint.position);
        }
    }
    assert!(count > 60, "{count} joints of all shipped scenes");
}

#[test]
fn rates_are_velocities_of_all_that_hangs_below() {
    for profile in PROFILES {
        let mut stepper = Stepper::new(simulation(&shipped("arm7.yaml"), profile), DT);
        let scene = stepper.simulation().scene();
        let names = ["yaw", "shoulder", "elbow", "wrist"];
        let joints = names.map(|name| joint(scene, name));
        let flange = body(scene, "flange");
        let set = |stepper: &mut Stepper, by: f64| {
            let positions = joints.iter().enumerate().map(|(i, &id)| (id, 0.2 + 0.1 * i as f64 + by * 0.5)).collect();
            let rates = joints.iter().map(|&id| (id, 0.5)).collect();
            stepper.set_state(&StateChange { positions, rates, ..StateChange::default() }).expect("within limits");
            let pose = stepper.snapshot().bodies[flange].inertial_pose();
            (pose, twist(stepper, flange))
        };
        const SHORT: f64 = 1e-6;
        let (behind, _) = set(&mut stepper, -SHORT);
        let (ahead, _) = set(&mut stepper, SHORT);
        let (_, [linear, angular]) = set(&mut stepper, 0.0);
        let moved = (ahead.translation.vector - behind.translation.vector) / (2.0 * SHORT);
        let turned = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / (2.0 * SHORT);
        assert!((moved - linear).norm() < 1e-6, "{profile:?}: {moved} {linear}");
        assert!((turned - angular).norm() < 1e-6, "{profile:?}: {turned} {angular}");
        // The next iteration publishes the same, and the one after it the motion.
        stepper.step(1).expect("sound");
        assert!((twist(&stepper, flange)[0] - linear).norm() < 1e-9);
        let position = stepper.simulation().scene().joints[joints[0]].position;
        assert!((position - (0.2 + 0.5 * DT)).abs() < 2e-4, "{profile:?}: {position}");
    }
}

/// A free body with an arm, and a box on its own.
const FLOATING: &str = "
bodies: [BODY Base, BODY Arm, BODY Alone]
joints: [JOINT hinge]
BODY Base: {name: Base, mass: 2, mesh: '', collision shape: BOX, collision geometry: {x: 0.2, y: 0.2, z: 0.2}}
BODY Arm: {name: Arm, mass: 1, mesh: '', collision shape: BOX, collision geometry: {x: 0.1, y: 0.1, z: 0.4},
  location: {position: {x: 0, y: 0, z: 0.4}}}
BODY Alone: {name: Alone, mass: 1, mesh: '', collision shape: BOX, collision geometry: {x: 0.1, y: 0.1, z: 0.1},
  location: {position: {x: 3, y: 0, z: 0}}}
JOINT hinge: {name: hinge, type: revolute, parent: BODY Base, child: BODY Arm, parent axis: {x: 0, y: 1, z: 0},
  child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0, y: 0, z: 0.15}, child pivot: {x: 0, y: 0, z: -0.25},
  joint limits: {low: -1, high: 1}}
";

fn floating(profile: Profile) -> Stepper {
    let name = if profile == Profile::Legacy { "legacy" } else { "accurate" };
    let loaded = load_texts(&format!("namespace: /ambf/env/\nphysics: {{profile: {name}}}\n"), &[FLOATING]);
    Stepper::new(Simulation::new(loaded.scene, DT), DT)
}

#[test]
fn what_hangs_below_a_body_goes_along() {
    for profile in PROFILES {
        let mut stepper = floating(profile);
        let scene = stepper.simulation().scene();
        let [base, arm, alone] = ["Base", "Arm", "Alone"].map(|name| body(scene, name));
        let hinge = joint(scene, "hinge");
        let before = stepper.snapshot().bodies[alone];
        let pose = Isometry3::from_parts(
            Vector3::new(1.0, 2.0, 3.0).into(),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 1.0),
        );
        let spin = [Vector3::new(0.1, 0.0, 0.0), Vector3::new(0.0, 0.0, 2.0)];
        let change = StateChange {
            poses: vec![(base, pose)],
            twists: vec![(base, spin)],
            positions: vec![(hinge, 0.5)],
            rates: vec![(hinge, 0.0)],
        };
        stepper.set_state(&change).expect("a free body");
        let pose_of = |id: BodyId| stepper.snapshot().bodies[id].inertial_pose();
        assert!((pose_of(base).translation.vector - pose.translation.vector).norm() < 1e-9);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.5);
        let expected = pose * Point3::from(Vector3::new(0.0, 0.0, 0.15) + turn * Vector3::new(0.0, 0.0, 0.25));
        assert!((pose_of(arm).translation.vector - expected.coords).norm() < 1e-9, "{profile:?}");
        let far = pose_of(arm).translation.vector - pose_of(base).translation.vector;
        let [linear, angular] = twist(&stepper, arm);
        assert!((linear - (spin[0] + spin[1].cross(&far))).norm() < 1e-9 && (angular - spin[1]).norm() < 1e-9);
        assert_eq!(stepper.snapshot().bodies[alone], before, "nothing of it was set");
    }
}

#[test]
fn what_cannot_be_set_is_said_and_changes_nothing() {
    let mut stepper = floating(Profile::Accurate);
    let scene = stepper.simulation().scene();
    let (arm, hinge) = (body(scene, "Arm"), joint(scene, "hinge"));
    let base = body(scene, "Base");
    let before = format!("{:?}", stepper.snapshot());
    let none = StateChange::default;
    for (change, message) in [
        (StateChange { positions: vec![(hinge, 1.1)], ..none() }, "joint hinge: 1.1 is not within its limits, -1 to 1"),
        (StateChange { rates: vec![(hinge, f64::NAN)], ..none() }, "hinge: a number is not finite"),
        (
            StateChange { poses: vec![(base, Isometry3::identity()), (arm, Isometry3::identity())], ..none() },
            "the pose of Arm cannot be set: it hangs below the joint hinge",
        ),
        (
            StateChange { twists: vec![(arm, [Vector3::zeros(); 2])], ..none() },
            "the velocity of Arm cannot be set: it hangs below the joint hinge",
        ),
    ] {
        let said = stepper.set_state(&change).expect_err(message).to_string();
        assert!(said.starts_with(message), "{said}");
        assert_eq!(format!("{:?}", stepper.snapshot()), before);
    }
}
