//! The shipped launch file and everything it names: no problem, not even a warning, and bodies that stand where their
//! joints hold them.

use std::path::{Path, PathBuf};

use ambf_core::adf::{
    load, ColorTable, Description, InputDevices, JointKind, Launch, Model, Problem, RigidBody, World,
};
use ambf_core::robot::is_robot;
use ambf_core::scene::read_model;
use nalgebra::{Point3, Vector3};

fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources")
}

fn clean<T: Description>(path: &Path) -> T {
    let (value, report) = load::<T>(path).unwrap_or_else(|e| panic!("{e}"));
    assert!(report.is_empty(), "{}", report.verbose());
    value
}

fn launch() -> Launch {
    clean(&resources().join("launch.yaml"))
}

/// A model that may be URDF, where velocity limits and frames without a mass are reported.
fn model(path: &Path) -> Model {
    let (model, report) = read_model(path).unwrap_or_else(|e| panic!("{e}"));
    let known = |p: &Problem| is_robot(path) && matches!(p.key.as_str(), "velocity" | "inertial");
    assert!(report.errors() == 0 && report.problems().iter().all(known), "{}", report.verbose());
    model
}

fn models() -> Vec<PathBuf> {
    launch().multibody_configs.expect("a list of models")
}

fn body<'m>(model: &'m Model, identifier: &str) -> &'m RigidBody {
    let found = model.bodies.iter().find(|b| b.common.identifier == identifier);
    found.unwrap_or_else(|| panic!("{}: no body '{identifier}'", model.name))
}

#[test]
fn launch_world_devices_and_colours_load_without_a_warning() {
    let launch = launch();
    assert!(launch.missing_keys().is_empty());
    let world: World = clean(&launch.world_config.expect("a world"));
    assert_eq!((world.lights.len(), world.cameras.len()), (2, 1));
    let ground: Model = clean(&world.environment.expect("a ground"));
    assert_eq!((ground.bodies.len(), ground.bodies[0].mass), (1, 0.0));
    assert!(ground.bodies[0].collision_groups.is_empty(), "the ground must collide with every group");
    let devices: InputDevices = clean(&launch.input_devices_config.expect("devices"));
    for entry in devices.entries.iter().map(|entry| entry.as_ref().expect("every entry is of use")) {
        let path = entry.simulated_multibody.as_ref().expect("an end-effector");
        let model: Model = clean(path);
        assert_eq!(entry.root_link.as_deref(), Some("BODY palm"));
        assert!(body(&model, "BODY palm").mass > 0.0, "{}: nothing moves it", entry.identifier);
    }
    let colors: ColorTable = clean(&launch.color_config.expect("colours"));
    assert_eq!(colors.colors["white"][..3], [255, 255, 255]);
}

#[test]
fn every_scene_is_listed_and_loads_without_a_warning() {
    let listed = models();
    let in_folder = resources().join("models").read_dir().expect("models").count();
    assert_eq!(listed.len(), in_folder);
    for path in &listed {
        let model = model(path);
        assert!(!model.bodies.is_empty(), "{}", model.name);
        let text = std::fs::read_to_string(path).expect("readable scene");
        let comment = if is_robot(path) { "<?xml version=\"1.0\"?>\n<!--\n  " } else { "# " };
        assert!(text.starts_with(comment), "{}: the first line says what the scene shows", model.name);
    }
}

#[test]
fn bodies_stand_where_their_joints_hold_them() {
    for path in models() {
        let model = model(&path);
        for joint in &model.joints {
            let (parent, child) = (body(&model, &joint.parent), body(&model, &joint.child));
            let pivot_p = parent.location * Point3::from(joint.parent_pivot);
            let pivot_c = child.location * Point3::from(joint.child_pivot);
            let axis: Vector3<f64> = parent.location * joint.parent_axis.normalize();
            let mut apart = pivot_c - pivot_p;
            if matches!(joint.kind, JointKind::Prismatic | JointKind::LinearSpring) {
                let travel = apart.dot(&axis);
                let limits = joint.limits.expect("sliding joints of these scenes have limits");
                assert!((limits.low..=limits.high).contains(&travel), "{}: starts at {travel}", joint.common.name);
                apart -= axis * travel;
            }
            // Far below what shows, far above the rounding of the files.
            assert!(apart.norm() < 1e-6, "{} / {}: pivots {} m apart", model.name, joint.common.name, apart.norm());
        }
    }
}

#[test]
fn the_springs_of_the_arm_balance_it() {
    let path = models().into_iter().find(|p| p.ends_with("arm7.yaml")).expect("the arm");
    let model = model(&path);
    let spring = |j: &&ambf_core::adf::Joint| j.kind == JointKind::TorsionSpring;
    for (i, joint) in model.joints.iter().filter(spring).enumerate() {
        let parent = body(&model, &joint.parent);
        let pivot = parent.location * Point3::from(joint.parent_pivot);
        let axis = parent.location * joint.parent_axis;
        // The chain is in order, so everything after joint i hangs on it.
        let gravity: f64 = model.bodies[i + 1..]
            .iter()
            .map(|b| {
                (b.location.translation.vector - pivot.coords).cross(&Vector3::new(0.0, 0.0, -9.81 * b.mass)).dot(&axis)
            })
            .sum();
        let child = body(&model, &joint.child);
        let turn = parent.location.rotation.inverse() * child.location.rotation;
        let angle = turn.scaled_axis().dot(&joint.parent_axis);
        let spring = joint.stiffness * (joint.equilibrium_point.expect("springs have one") - angle);
        assert!((spring + gravity).abs() < 1e-3, "{}: {spring} N·m against {gravity} N·m", joint.common.name);
    }
}
