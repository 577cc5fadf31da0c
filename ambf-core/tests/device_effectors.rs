//! End-effectors: how they come into a scene, follow their hands, grip, and obey clients.

mod device_common;

use std::sync::Arc;

use ambf_core::comm::{CartesianCommandType, HubObject, RigidBodyCommand};
use ambf_core::control::Profile;
use ambf_core::device::host::DeviceHost;
use ambf_core::ids::{ActuatorId, BodyId, CameraId, JointId, VolumeId};
use ambf_core::scene::PreparedModel;
use ambf_core::sim::Simulation;
use device_common::{coupled, puppets, until, Folder, Puppet, BOTH, BOXES, GRIPPER};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

/// A simulation that the test steps, with devices that run by themselves.
struct Stage {
    simulation: Simulation,
    host: DeviceHost,
    puppets: Vec<Arc<Puppet>>,
    folder: Folder,
}

impl Stage {
    fn new(entries: &str, models: &[&str], profile: Profile) -> Self {
        Self::with(entries, models, profile, true)
    }

    /// With devices that know where their hands are, or not.
    fn with(entries: &str, models: &[&str], profile: Profile, valid: bool) -> Self {
        let folder = Folder::new();
        folder.write("gripper.yaml", GRIPPER);
        let (puppets, drivers) = puppets(&["one", "two"]);
        puppets.iter().for_each(|puppet| puppet.set(|pose| pose.valid = valid));
        let mut simulation = folder.simulation(models, profile);
        let entries = folder.entries(entries);
        let host = coupled(&entries, &drivers, false, &mut simulation);
        Self { simulation, host, puppets, folder }
    }

    fn body(&self, name: &str) -> BodyId {
        let found = self.simulation.scene().bodies.position(|body| *body.identity.name == *name);
        found.unwrap_or_else(|| panic!("no body `{name}`"))
    }

    fn pose(&self, name: &str) -> Isometry3<f64> {
        let scene = self.simulation.scene();
        scene.bodies[self.body(name)].pose(&scene.world)
    }

    fn position(&self, name: &str) -> Vector3<f64> {
        self.pose(name).translation.vector
    }

    fn steps(&mut self, count: u32) {
        (0..count).for_each(|_| self.simulation.update(0.001).expect("finite"));
    }

    /// Steps until something holds.
    #[track_caller]
    fn until(&mut self, what: &str, mut condition: impl FnMut(&Self) -> bool) {
        until(what, || {
            self.steps(5);
            condition(self)
        });
    }

    /// Waits until the newest of the device has reached the physics and has had time to work.
    fn settle(&mut self) {
        let reads = self.puppets[0].reads();
        self.until("a few ticks", |stage| stage.puppets[0].reads() > reads + 20);
        self.steps(3000);
    }
}

fn gripper_entry(more: &str) -> String {
    format!("input devices: [A]\nA: {{hardware name: Puppet, simulated multibody: gripper.yaml{more}}}\n")
}

#[test]
fn only_the_root_link_of_an_end_effector_has_topics() {
    let mut stage = Stage::new(&gripper_entry(""), &[], Profile::Legacy);
    let hub = stage.simulation.connect();
    let names: Vec<_> = hub.objects().iter().map(|o| (o.info.namespace.clone(), o.info.name.clone())).collect();
    assert!(names.contains(&("/g//simulated_device/".into(), "palm".into())), "{names:?}");
    assert!(!names.iter().any(|(_, name)| name == "finger" || name.contains("actuator")), "{names:?}");
    // Its sensors keep theirs.
    assert!(names.iter().any(|(_, name)| name == "eye"), "{names:?}");
}

#[test]
fn an_end_effector_moves_rigidly_to_its_location() {
    let location = ", location: {position: {x: -1, y: 0.5, z: 2}, orientation: {r: 0, p: 0, y: 1.5707963267948966}}";
    for profile in PROFILES {
        // Without a hand, which would move it.
        let mut stage = Stage::with(&gripper_entry(location), &[], profile, false);
        let palm = stage.pose("palm");
        assert!((palm.translation.vector - Vector3::new(-1.0, 0.5, 2.0)).norm() < 1e-9);
        let finger = stage.position("finger");
        assert!((finger - Vector3::new(-1.0, 0.6, 2.0)).norm() < 1e-6, "{finger}");
        // It is at rest there: nothing pulls itself together.
        stage.steps(5);
        let moved = (stage.position("finger") - finger).norm();
        assert!(moved < 1e-3, "{profile:?}: {moved} m");
    }
}

#[test]
fn the_root_link_follows_the_hand_and_the_fingers_the_gripper() {
    for profile in PROFILES {
        let mut stage = Stage::new(&gripper_entry(", workspace scaling: 5"), &[], profile);
        let start = stage.position("palm");
        stage.puppets[0].set(|pose| pose.gripper = Some(0.0));
        stage.settle();
        stage.puppets[0].set(|pose| pose.position = Vector3::new(0.02, 0.0, 0.01));
        stage.settle();
        // The camera looks along −x: its axes are those of the world. Five times the hand's way.
        let moved = stage.position("palm") - start;
        assert!((moved - Vector3::new(0.1, 0.0, 0.05)).norm() < 2e-3, "{profile:?}: {moved}");
        let joint = |stage: &Stage| stage.simulation.scene().joints[JointId::new(0)].position;
        assert!((joint(&stage) + 0.2).abs() < 0.02, "{profile:?}: closed at {}", joint(&stage));
        stage.puppets[0].set(|pose| pose.gripper = Some(1.0));
        stage.settle();
        assert!((joint(&stage) - 0.6).abs() < 0.02, "{profile:?}: open at {}", joint(&stage));
    }
}

#[test]
fn the_root_link_turns_with_the_hand() {
    for profile in PROFILES {
        let mut stage = Stage::new(&gripper_entry(", enable joint control: false"), &[], profile);
        stage.settle();
        let turn = UnitQuaternion::new(Vector3::new(0.0, 0.0, 0.4));
        stage.puppets[0].set(|pose| pose.rotation = turn);
        stage.settle();
        stage.steps(3000);
        let angle = stage.pose("palm").rotation.angle_to(&turn);
        assert!(angle < 0.02, "{profile:?}: {angle}");
    }
}

#[test]
fn velocity_output_works_in_both_profiles() {
    let text = "input devices: [A]\nA: {hardware name: Puppet, root link: BODY left}\n";
    for profile in PROFILES {
        let mut stage = Stage::new(text, &[BOXES], profile);
        stage.settle();
        stage.puppets[0].set(|pose| pose.position.z = 0.1);
        stage.settle();
        let position = stage.position("left");
        assert!((position - Vector3::new(0.0, -1.0, 0.1)).norm() < 1e-3, "{profile:?}: {position}");
    }
}

#[test]
fn the_clutch_of_one_hand_leaves_the_other_alone() {
    let mut stage = Stage::new(BOTH, &[BOXES], Profile::Legacy);
    stage.settle();
    stage.puppets[0].set(|pose| pose.buttons = 0b10);
    stage.settle();
    for puppet in &stage.puppets {
        puppet.set(|pose| pose.position.z = 0.2);
    }
    stage.settle();
    let z = |stage: &Stage| [stage.position("left").z, stage.position("right").z];
    let [left, right] = z(&stage);
    assert!(left.abs() < 1e-3 && (right - 0.2).abs() < 2e-3, "{left} {right}");
    stage.puppets[0].set(|pose| pose.buttons = 0);
    stage.settle();
    stage.puppets[0].set(|pose| pose.position.z = 0.3);
    stage.settle();
    let [left, right] = z(&stage);
    assert!((left - 0.1).abs() < 2e-3 && (right - 0.2).abs() < 2e-3, "{left} {right}");
}

#[test]
fn a_closed_gripper_takes_the_nearest_body_and_an_open_one_lets_go() {
    let boxes = "bodies: [BODY far, BODY near]\nnamespace: /b/\n\
        BODY far: {name: far, mass: 0.1, location: {position: {x: 1.27, y: 2, z: 3.045}}, collision shape: Box, \
          collision geometry: {x: 0.02, y: 0.02, z: 0.02}}\n\
        BODY near: {name: near, mass: 0.1, location: {position: {x: 1.16, y: 2, z: 3.025}}, collision shape: Box, \
          collision geometry: {x: 0.02, y: 0.02, z: 0.02}}\n";
    for profile in PROFILES {
        let mut stage = Stage::new(&gripper_entry(", enable joint control: false"), &[boxes], profile);
        stage.settle();
        stage.puppets[0].set(|pose| pose.gripper = Some(0.1));
        stage.settle();
        let actuator = |stage: &Stage| stage.simulation.scene().actuators[ActuatorId::new(0)].is_actuated();
        assert!(actuator(&stage), "{profile:?}");
        // Slowly: a jerk would swing the box against the other.
        for i in 1..=10 {
            stage.puppets[0].set(|pose| pose.position.z = 0.03 * f64::from(i));
            stage.settle();
        }
        let [near, far] = ["near", "far"].map(|name| stage.position(name).z);
        assert!((near - 3.325).abs() < 0.02, "{profile:?}: near at {near}");
        assert!((far - 3.045).abs() < 0.02, "{profile:?}: far at {far}");
        stage.puppets[0].set(|pose| pose.gripper = Some(0.9));
        stage.until("it lets go", |stage| !actuator(stage));
    }
}

#[test]
fn a_client_that_commands_the_root_link_silences_the_hand() {
    let mut stage = Stage::new(BOTH, &[BOXES], Profile::Legacy);
    stage.settle();
    stage.puppets[0].set(|pose| pose.position.z = 0.2);
    let left = stage.body("left");
    let command = RigidBodyCommand { cartesian: CartesianCommandType::Velocity, ..RigidBodyCommand::default() };
    stage.simulation.command_body(left, &command);
    let before = stage.position("left").z;
    for _ in 0..200 {
        stage.simulation.command_body(left, &command);
        stage.steps(1);
        std::thread::sleep(std::time::Duration::from_micros(200));
    }
    assert!((stage.position("left").z - before).abs() < 1e-9);
    stage.simulation.command_body(left, &RigidBodyCommand::default());
    stage.settle();
    assert!((stage.position("left").z - 0.2).abs() < 2e-3);
}

#[test]
fn a_reset_takes_the_reference_back_and_the_hand_goes_on_from_there() {
    let mut stage = Stage::new(BOTH, &[BOXES], Profile::Legacy);
    stage.settle();
    stage.puppets[0].set(|pose| pose.position.z = 0.2);
    stage.settle();
    stage.simulation.reset_bodies();
    stage.settle();
    assert!(stage.position("left").z.abs() < 2e-3, "{}", stage.position("left").z);
    stage.puppets[0].set(|pose| pose.position.z = 0.25);
    stage.settle();
    assert!((stage.position("left").z - 0.05).abs() < 2e-3, "{}", stage.position("left").z);
}

#[test]
fn two_copies_of_an_end_effector_live_side_by_side() {
    let text = "input devices: [A, B]\nA: {hardware name: Puppet, simulated multibody: gripper.yaml}\n\
        B: {hardware name: Puppet, simulated multibody: gripper.yaml, location: {position: {x: 0, y: 0, z: 0}}}\n";
    let mut stage = Stage::new(text, &[], Profile::Legacy);
    let hub = stage.simulation.connect();
    let is_palm = |o: &&Arc<HubObject>| o.info.name.starts_with("palm");
    let palms: Vec<_> = hub.objects().iter().filter(is_palm).map(|o| o.info.name.clone()).collect();
    assert_eq!(palms, ["palm", "palm1"]);
    stage.settle();
    stage.puppets[1].set(|pose| pose.position.z = 0.1);
    stage.settle();
    let scene = stage.simulation.scene();
    let z = |index: BodyId| scene.bodies[index].pose(&scene.world).translation.z;
    let palms: Vec<_> = scene.bodies.ids().filter(|&id| &*scene.bodies[id].identity.name == "palm").collect();
    assert!((z(palms[0]) - 3.0).abs() < 2e-3 && (z(palms[1]) - 0.1).abs() < 2e-3);
}

#[test]
fn removing_the_model_of_an_end_effector_leaves_a_device_without_force() {
    let mut stage = Stage::new(&gripper_entry(""), &[], Profile::Legacy);
    stage.settle();
    stage.simulation.remove_model("gripper.yaml").expect("it is there");
    stage.puppets[0].set(|pose| pose.position.z = 0.2);
    stage.settle();
    assert_eq!(stage.puppets[0].force(), 0.0);
    assert_eq!(stage.host.status().len(), 1);
    // A model that takes its places is not moved by the device.
    let file = stage.folder.write("gripper.yaml", GRIPPER);
    stage.simulation.add_model(PreparedModel::read(&file).expect("a model")).expect("something is built");
    let palm = stage.position("palm");
    stage.puppets[0].set(|pose| pose.position.z = -0.3);
    stage.settle();
    assert_eq!((stage.puppets[0].force(), stage.position("palm")), (0.0, palm));
}

#[test]
fn the_camera_button_moves_the_camera_and_freezes_the_hand() {
    let text = "input devices: [A]\nA: {hardware name: Puppet, root link: BODY left, button mapping: {a2: 3}, pair cameras: [camera1]}\n";
    let mut stage = Stage::new(text, &[BOXES], Profile::Legacy);
    stage.settle();
    stage.puppets[0].set(|pose| pose.buttons = 0b1000);
    stage.settle();
    let camera = |stage: &Stage| stage.simulation.scene().cameras[CameraId::new(0)].attached.pose;
    let before = camera(&stage);
    let turn = UnitQuaternion::new(Vector3::new(0.0, 0.0, 0.3));
    stage.puppets[0].set(|pose| {
        pose.position.z = 0.05;
        pose.rotation = turn;
    });
    stage.settle();
    let after = camera(&stage);
    assert!(after.rotation.angle_to(&(before.rotation * turn)) < 1e-6);
    assert!(after.translation.z > before.translation.z + 0.01, "{after}");
    assert!(stage.position("left").z.abs() < 2e-3);
}

#[test]
fn the_gripper_of_a_device_switches_the_tool_that_it_leads() {
    let phantom = concat!(env!("CARGO_MANIFEST_DIR"), "/../resources/drill/phantom.nrrd");
    let bone = format!(
        "bodies: []\nvolumes: [VOLUME bone]\nVOLUME bone: {{name: bone, nrrd: {phantom}, location: {{position: {{x: 9, y: 9, z: 9}}}}, \
         tools: [{{body: BODY left, tip: {{radius: 0.001}}, rate: 1.0e-9}}, {{body: BODY right, tip: {{radius: 0.001}}}}]}}\n"
    );
    let entries = "input devices: [A]\nA: {hardware name: Puppet, root link: BODY left}\n";
    let mut stage = Stage::new(entries, &[BOXES, &bone], Profile::Legacy);
    let volume = VolumeId::new(0);
    let mut becomes = |opening: f64, expected: bool| {
        stage.puppets[0].set(|pose| pose.gripper = Some(opening));
        let reads = stage.puppets[0].reads();
        until("the hand is read", || stage.puppets[0].reads() > reads + 20);
        let begin = std::time::Instant::now();
        loop {
            stage.simulation.iterate(0.001).expect("finite");
            let is_on = |tool| stage.simulation.scene().tool(volume, tool).expect("it is there").is_on;
            assert!(is_on(1), "the tool of another body");
            if is_on(0) == expected {
                return;
            }
            assert!(begin.elapsed().as_secs() < 20, "an opening of {opening} does not switch it to {expected}");
        }
    };
    // It is closed already when it is seen for the first time.
    becomes(0.0, true);
    for _ in 0..100 {
        becomes(0.1, true);
    }
    for on in [true, false] {
        becomes(1.0, on);
        becomes(0.1, !on);
        // Not opened far enough.
        becomes(0.4, !on);
        becomes(0.0, !on);
    }
    becomes(1.0, true);
}
