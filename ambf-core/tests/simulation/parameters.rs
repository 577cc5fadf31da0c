//! Parameters that are changed while the simulation runs: the motion is that of the new ones, in trees too.

use ambf_core::control::Profile;
use ambf_core::ids::{BodyId, JointId};
use ambf_core::scene::{
    load, MechanismError, ParameterChange, ParameterError, PhysicsOptions, SceneFiles, SceneOptions, StateChange,
};
use ambf_core::sim::{Simulation, Stepper};
use nalgebra::{DVector, Vector3};

/// Two links on sliders: the inner one along x, the outer one, on it, along z.
const SLIDERS: &str = r#"<robot name="r"><link name="world"/>
<joint name="inner" type="prismatic"><parent link="world"/><child link="first"/><axis xyz="1 0 0"/>
  <limit lower="-9" upper="9" effort="1000" velocity="1000"/></joint>
<link name="first"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="outer" type="prismatic"><parent link="first"/><child link="second"/><axis xyz="0 0 1"/>
  <limit lower="-9" upper="9" effort="1000" velocity="1000"/></joint>
<link name="second"><inertial><mass value="3"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"#;

fn stepper(profile: Profile) -> Stepper {
    let folder = tempfile::tempdir().expect("a folder");
    let robot = folder.path().join("robot.urdf");
    std::fs::write(&robot, SLIDERS).expect("written");
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let options = SceneOptions { physics, savable: true, ..SceneOptions::default() };
    let loaded = load(&SceneFiles { world: None, models: vec![robot] }, &options);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Stepper::new(Simulation::new(loaded.scene, 0.001), 0.001)
}

fn body(stepper: &Stepper, name: &str) -> BodyId {
    let scene = stepper.simulation().scene();
    let found = scene.bodies.entries().find(|(_, body)| &*body.identity.name == name);
    found.unwrap_or_else(|| panic!("no body {name}")).0
}

/// Accelerations of both joints under efforts of 6 N on both, from rest.
fn accelerations(stepper: &mut Stepper) -> [f64; 2] {
    use ambf_core::comm::{JointCommandType, ObjectKind};
    stepper.reset();
    let base = body(stepper, "world");
    let objects = stepper.objects();
    let is_base = |kind: &ObjectKind| matches!(kind, ObjectKind::RigidBody(id, _) if *id == base);
    let (object, _) = objects.entries().find(|(_, object)| is_base(&object.info.kind)).expect("it is there");
    let command = stepper.body_command(object).expect("a body");
    command.joint_commands = vec![6.0; 2];
    command.joint_command_types = vec![JointCommandType::Effort; 2];
    stepper.step(2).expect("sound");
    let rates = |stepper: &Stepper| [0, 1].map(|joint| stepper.snapshot().joint_positions[JointId::new(joint)]);
    stepper.step(100).expect("sound");
    rates(stepper).map(|way| way / (0.5 * 0.1 * 0.1))
}

#[test]
fn trees_accelerate_as_the_new_masses_say() {
    for profile in [Profile::Accurate, Profile::Legacy] {
        let mut stepper = stepper(profile);
        let [first, second] = ["first", "second"].map(|name| body(&stepper, name));
        for masses in [[2.0, 3.0], [0.5, 1.0], [5.0, 0.2]] {
            let change = ParameterChange {
                masses: vec![(first, masses[0]), (second, masses[1])],
                gravity: Some(Vector3::new(0.0, 0.0, -1.0)),
                ..ParameterChange::default()
            };
            stepper.set_parameters(&change).expect("possible");
            // The first change scales the moments, too.
            let scene = stepper.simulation().scene();
            assert!((scene.bodies[second].inertia.x - masses[1] / 3.0).abs() < 1e-12);
            let found = accelerations(&mut stepper);
            let expected = [6.0 / (masses[0] + masses[1]), 6.0 / masses[1] - 1.0];
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 0.03 * expected.abs(), "{profile:?} {masses:?}: {found} {expected}");
            }
            let mechanism = stepper.simulation().scene().mechanism(first).expect("a tree");
            let base = stepper.simulation().scene().world.pose(stepper_handle(&stepper)).expect("there");
            let matrix = mechanism.tree.posture(&base, &[0.1, 0.2]).mass_matrix();
            let diagonal = DVector::from_vec(vec![masses[0] + masses[1], masses[1]]);
            assert!((matrix.diagonal() - diagonal).norm() < 1e-12 && matrix[(0, 1)].abs() < 1e-12);
        }
    }
}

/// A handle of the base.
fn stepper_handle(stepper: &Stepper) -> ambf_core::bullet::BodyHandle {
    let scene = stepper.simulation().scene();
    scene.world.bodies()[body(stepper, "world").index()]
}

#[test]
fn what_is_refused_changes_nothing() {
    let mut stepper = stepper(Profile::Accurate);
    let [world, first] = ["world", "first"].map(|name| body(&stepper, name));
    let refused = |change| stepper.set_parameters(&change).expect_err("refused");
    let mut refused = refused;
    let masses = |id, mass| ParameterChange { masses: vec![(first, 7.0), (id, mass)], ..ParameterChange::default() };
    assert!(matches!(refused(masses(world, 1.0)), ParameterError::Static { .. }));
    for mass in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refused(masses(first, mass)), ParameterError::Range { .. }));
    }
    let limits = ParameterChange { limits: vec![(JointId::new(0), [1.0, 0.0])], ..masses(first, 7.0) };
    assert!(refused(limits).to_string().contains("lower limit"));
    let mass = stepper.simulation().scene().bodies[first].mass;
    assert_eq!(mass.to_bits(), 2.0_f64.to_bits());
}

#[test]
fn saved_states_hold_them() {
    let mut stepper = stepper(Profile::Accurate);
    let first = body(&stepper, "first");
    let saved = stepper.save().expect("savable");
    let change = ParameterChange {
        masses: vec![(first, 7.0)],
        gravity: Some(Vector3::x()),
        limits: vec![(JointId::new(0), [-1.0, 1.0])],
        ..ParameterChange::default()
    };
    stepper.set_parameters(&change).expect("possible");
    stepper.restore(&saved).expect("its own");
    let scene = stepper.simulation().scene();
    assert_eq!((scene.bodies[first].mass, scene.gravity.x), (2.0, 0.0));
    assert_eq!(scene.joints[JointId::new(0)].limits.map(|limits| limits.high), Some(9.0));
    stepper.set_state(&StateChange { positions: vec![(JointId::new(0), 5.0)], ..StateChange::default() }).expect("ok");
}

#[test]
fn trees_say_why_they_are_none() {
    let mut stepper = stepper(Profile::Accurate);
    let first = body(&stepper, "first");
    let mechanism = stepper.simulation().scene().mechanism(first).expect("a tree");
    assert_eq!((mechanism.bodies.len(), mechanism.joints.len(), mechanism.tree.is_free()), (3, 2, false));
    let key = stepper.simulation().scene().models.iter().last().expect("the robot").key.clone();
    stepper.remove_model(&key).expect("there");
    assert_eq!(stepper.simulation().scene().mechanism(first).err(), Some(MechanismError::Removed));
}
