//! Small scenes written in the tests themselves.
#![allow(missing_docs)]

use std::sync::atomic::{AtomicU32, Ordering};

use ambf_core::comm::JointCommandType;
use ambf_core::ids::BodyId;
use ambf_core::scene::{load, Joint, Loaded, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Length of a step, s.
pub const DT: f64 = 0.001;

/// World file without environment and gravity.
pub const WEIGHTLESS: &str = "gravity: {x: 0, y: 0, z: 0}\nmax iterations: 50\n";

/// World file without environment, gravity 10 m/s².
pub const HEAVY: &str = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\n";

/// Loads the text of a world file and of model files.
pub fn load_texts(world: &str, models: &[&str]) -> Loaded {
    load_texts_with(world, models, &SceneOptions::default())
}

/// The same with options.
pub fn load_texts_with(world: &str, models: &[&str], options: &SceneOptions) -> Loaded {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let name = format!("ambf_physics_{}_{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    let folder = std::env::temp_dir().join(name);
    std::fs::create_dir_all(&folder).expect("a folder");
    let write = |name: String, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let files = SceneFiles {
        world: Some(write("world.yaml".into(), world)),
        models: models.iter().enumerate().map(|(i, text)| write(format!("m{i}.yaml"), text)).collect(),
    };
    let loaded = load(&files, options);
    std::fs::remove_dir_all(&folder).expect("removed");
    loaded
}

/// A simulation with short names for what tests ask.
pub struct Bench(pub Simulation);

impl Bench {
    /// # Panics
    /// When a text has an error.
    pub fn new(world: &str, model: &str) -> Self {
        let Loaded { scene, report } = load_texts(world, &[model]);
        assert_eq!(report.errors(), 0, "{report}");
        Self(Simulation::new(scene, DT))
    }

    pub fn body(&self, name: &str) -> BodyId {
        let found = self.0.scene().bodies.position(|body| *body.identity.name == *name);
        found.unwrap_or_else(|| panic!("no body `{name}`"))
    }

    pub fn joint(&self, name: &str) -> &Joint {
        let found = self.0.scene().joints.iter().find(|joint| joint.name == name);
        found.unwrap_or_else(|| panic!("no joint `{name}`"))
    }

    /// Pose of the body frame after the last sub-step, not lagged.
    pub fn pose(&self, name: &str) -> Isometry3<f64> {
        let (scene, body) = (self.0.scene(), self.body(name));
        let inertial = scene.world.pose(scene.world.bodies()[body.index()]).expect("a live body");
        inertial * scene.bodies[body].inertial_offset_inverse
    }

    pub fn position(&self, name: &str) -> Vector3<f64> {
        self.pose(name).translation.vector
    }

    /// Pose of the body frame as reported.
    pub fn reported(&self, name: &str) -> Isometry3<f64> {
        let scene = self.0.scene();
        scene.bodies[self.body(name)].pose(&scene.world)
    }

    /// Linear and angular velocity, world axes.
    pub fn velocity(&self, name: &str) -> (Vector3<f64>, Vector3<f64>) {
        let world = &self.0.scene().world;
        world.velocity(world.bodies()[self.body(name).index()]).expect("a live body")
    }

    /// One update of `interval` s.
    pub fn update(&mut self, interval: f64) {
        self.0.update(interval).unwrap_or_else(|error| panic!("{error}"));
    }

    /// Steps of 1 ms.
    pub fn steps(&mut self, count: u32) {
        (0..count).for_each(|_| self.update(DT));
    }

    /// Steps of 1 ms, each with the same joint command on `body`'s joint `index` before it.
    pub fn command(&mut self, body: &str, index: usize, kind: JointCommandType, value: f64, steps: u32) {
        let body = self.body(body);
        for _ in 0..steps {
            assert!(self.0.command_joint(body, index, kind, value), "no such joint");
            self.update(DT);
        }
    }

    pub fn push(&mut self, name: &str, force: Vector3<f64>) {
        let body = self.body(name);
        self.0.apply_wrench(body, force, Vector3::zeros());
    }

    pub fn throw(&mut self, name: &str, linear: Vector3<f64>) {
        let body = self.body(name);
        self.0.set_velocity(body, linear, Vector3::zeros());
    }

    pub fn follow(&mut self, name: &str, target: &Isometry3<f64>) {
        let (body, q) = (self.body(name), target.rotation);
        self.0.follow_pose(body, target.translation.vector, [q.i, q.j, q.k, q.w]);
    }
}

/// Angle between two orientations, rad.
pub fn turned(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    a.angle_to(b)
}

/// Fails unless two numbers are closer than `tolerance`.
#[track_caller]
pub fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} instead of {expected} ± {tolerance}");
}

/// Fails unless two vectors are closer than `tolerance`.
#[track_caller]
pub fn near(found: Vector3<f64>, expected: [f64; 3], tolerance: f64) {
    let apart = (found - Vector3::from(expected)).norm();
    assert!(apart <= tolerance, "{found} instead of {expected:?} ± {tolerance}");
}
