//! The asynchronous multi-body framework as a library: scene files in, a simulated world out.
//!
//! ```
//! use std::path::Path;
//!
//! use ambf_core::scene::{load, SceneFiles, SceneOptions};
//! use ambf_core::sim::{LostState, Simulation};
//!
//! # fn main() -> Result<(), LostState> {
//! let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
//! let world = Some(resources.join("world/world.yaml"));
//! let files = SceneFiles { world, models: vec![resources.join("models/pendulum.yaml")] };
//! let loaded = load(&files, &SceneOptions::default());
//! assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
//!
//! let mut simulation = Simulation::new(loaded.scene, 0.001); // sub-steps of 1 ms
//! for _ in 0..300 {
//!     simulation.update(0.001)?; // iterations of 1 ms
//! }
//! let scene = simulation.scene();
//! let link = scene.bodies.iter().find(|body| &*body.identity.name == "Link").expect("it is in the file");
//! let pose = link.pose(&scene.world); // body frame in the world
//! assert!(pose.translation.z < 0.35, "it swings down from 0.5 m");
//! # Ok(())
//! # }
//! ```
//!
//! # Where to begin
//!
//! | for | see |
//! |---|---|
//! | programs that step a scene themselves | [`sim::Simulation`], or [`sim::Stepper`] with commands that stay in force and saved states |
//! | examples of such programs | `examples/step_scene.rs`, `examples/own_controller.rs` |
//! | Jacobians, mass matrices, inverse dynamics and kinematics | [`scene::Scene::mechanism`], [`tree`] |
//! | masses, friction, limits, gains that change | [`sim::Stepper::set_parameters`] |
//! | programs in real time | [`sim::Runner`] repeats the iteration in a thread; others work with it through [`comm::Hub`] |
//! | files | [`scene::load`]; [`adf`], [`urdf`] and [`mjcf`] are descriptions alone, [`mesh`] reads triangles |
//! | code that runs within a simulator | [`plugin`] |
//! | input devices | [`device`] |
//! | Bullet itself | [`bullet::World`] |
//!
//! The order of an iteration, the threads and the ways of data are in `ARCHITECTURE.md` at the root of the repository,
//! frames, signs and units in `docs/notation.md`.
//!
//! Not in: ROS, windows, command lines, and anything that writes to a terminal. What there is to say is returned.

pub mod bullet;
pub mod comm;
pub mod control;
pub mod ids;
pub mod scene;
pub mod sim;

pub use ambf_device as device;
pub use ambf_dynamics::aba::together;
pub use ambf_dynamics::tree;
pub use ambf_model::{adf, files, mesh, mjcf, robot, text, urdf};
pub use ambf_plugin as plugin;
pub use ambf_plugin::{export_driver, export_plugin};
pub use ambf_volume as volume;
