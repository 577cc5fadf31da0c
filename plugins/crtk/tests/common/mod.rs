//! Arms in a world that is stepped by the test, with topics in memory.
#![allow(dead_code, missing_docs)]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_core::bullet::BodyKinematics;
use ambf_core::control::Profile;
use ambf_core::plugin::{PluginSetup, Registry};
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use crtk::arm::JointMessage;
use crtk::diagnostics::Board;
use crtk::messages::{Header, Message};
use crtk::queries::Service;
use crtk::topics::Topic;
use crtk::transport::{Answer, Connect, Receive, Sender, Transport, TransportError};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion};
use parking_lot::Mutex;

pub const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

/// Interval of an iteration, s.
pub const STEP: f64 = 0.001;

/// Topics in memory: nobody listens, and commands are handed over at once.
#[derive(Clone, Default)]
pub struct Memory {
    receivers: Arc<Mutex<Vec<(String, Receive)>>>,
    services: Arc<Mutex<Vec<(String, Answer)>>>,
}

struct NoSender;

impl Sender for NoSender {
    fn is_open(&self) -> bool {
        false
    }

    fn has_receivers(&self) -> bool {
        false
    }

    fn send(&self, _: &Message) {}
}

impl Transport for Memory {
    fn advertise(&mut self, _: &Topic) -> Result<Box<dyn Sender>, TransportError> {
        Ok(Box::new(NoSender))
    }

    fn subscribe(&mut self, topic: &Topic, receive: Receive) -> Result<(), TransportError> {
        self.receivers.lock().push((topic.name.clone(), receive));
        Ok(())
    }

    fn serve(&mut self, service: &Service, answer: Answer) -> Result<(), TransportError> {
        self.services.lock().push((service.name.clone(), answer));
        Ok(())
    }
}

impl Memory {
    /// Hands a message over to the topic's receiver.
    pub fn send(&self, topic: &str, bytes: &[u8]) {
        let receivers = self.receivers.lock();
        let (_, receive) = receivers.iter().find(|(name, _)| name == topic).unwrap_or_else(|| panic!("no {topic}"));
        receive(bytes);
    }
}

impl Memory {
    /// Asks a service; bytes in the encoding of ROS 1.
    pub fn ask(&self, service: &str, request: &[u8]) -> Result<Vec<u8>, String> {
        let services = self.services.lock();
        let (_, answer) = services.iter().find(|(name, _)| name == service).unwrap_or_else(|| panic!("no {service}"));
        answer(request)
    }
}

/// A world with arms.
pub struct Bench {
    pub simulation: Simulation,
    pub topics: Memory,
    pub notices: Vec<String>,
}

pub fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../resources")
}

impl Bench {
    /// Models in the shipped world, with the arms that a file configures.
    pub fn new(models: &[PathBuf], arms: &Path, profile: Profile) -> Self {
        Self::with_physics(models, arms, PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() })
    }

    /// The same with other settings of the physics.
    pub fn with_physics(models: &[PathBuf], arms: &Path, physics: PhysicsOptions) -> Self {
        let files = SceneFiles { world: Some(resources().join("world/world.yaml")), models: models.to_vec() };
        let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        let mut simulation = Simulation::new(loaded.scene, STEP);
        let topics = Memory::default();
        let own = topics.clone();
        let connect: Connect = Arc::new(move || Ok(vec![Box::new(own.clone()) as Box<dyn Transport>]));
        let mut registry = Registry::default();
        let command_line = crtk::plugin::register(&mut registry, &[arms.to_owned()], &connect, &Board::default(), None);
        let report = simulation.load_plugins(PluginSetup { registry, command_line, ..PluginSetup::default() });
        assert_eq!(report.problems, Vec::<String>::new());
        let notices = simulation.take_notices();
        Self { simulation, topics, notices }
    }

    /// The shipped PSM.
    pub fn psm(profile: Profile) -> Self {
        Self::new(
            &["psm", "ecm"].map(|name| resources().join(format!("models/{name}.yaml"))),
            &resources().join("crtk/cart.yaml"),
            profile,
        )
    }

    pub fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / STEP).round() as usize {
            self.simulation.iterate(STEP).unwrap();
        }
    }

    /// Pose of a body's inertial frame.
    pub fn body(&self, name: &str) -> Isometry3<f64> {
        let scene = self.simulation.scene();
        let at = scene.bodies.iter().position(|body| body.identity.qualified.ends_with(name));
        let mut states = vec![BodyKinematics::default(); scene.bodies.len()];
        scene.world.read_bodies(&mut states);
        let BodyKinematics { origin, basis, .. } = states[at.unwrap_or_else(|| panic!("no body {name}"))];
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(basis.as_slice()));
        Isometry3::from_parts(origin.into(), UnitQuaternion::from_rotation_matrix(&rotation))
    }

    /// Position of a joint.
    pub fn joint(&self, name: &str) -> f64 {
        let mut joints = self.simulation.scene().joints.iter();
        joints.find(|joint| *joint.name == *name).unwrap_or_else(|| panic!("no joint {name}")).position
    }

    pub fn send_joints(&self, topic: &str, joints: JointMessage) {
        self.topics.send(topic, &Message::Joints(Header::default(), joints).encode());
    }

    pub fn send_positions(&self, topic: &str, position: &[f64]) {
        self.send_joints(topic, JointMessage { position: position.to_vec(), ..JointMessage::default() });
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.simulation.close_plugins();
    }
}

/// Arms of the C++ simulator's scenes: configuration, name space, body at the tool.
pub const LEGACY_ARMS: [(&str, &str, &str); 3] = [
    ("psm", "/PSM1", "/ambf/env/psm/BODY tool pitch link"),
    ("ecm", "/ECM", "/ambf/env/ecm/BODY tool link"),
    ("mtm", "/MTMR", "/ambf/env/mtm/BODY WristRoll"),
];

/// One of them; `None` when those files are not here. All topics are offered.
pub fn legacy_arm(name: &str, physics: PhysicsOptions) -> Option<Bench> {
    let models = ambf_test_support::legacy()?.join("descriptions/multi-bodies/robots");
    let text = std::fs::read_to_string(resources().join(format!("crtk/legacy-{name}.yaml"))).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let arms = folder.path().join("arms.yaml");
    std::fs::write(&arms, text.replace("    kind:", "    extras: true\n    kind:")).unwrap();
    Some(Bench::with_physics(&[models.join(format!("blender-{name}.yaml"))], &arms, physics))
}
