//! Descriptions of scenes: files in, data out. No physics, no ROS, nothing is drawn.
//!
//! * [`adf`]: scene files of AMBF (worlds, models, launch files, devices, colours) with a report of what is wrong in
//!   them, by file and line.
//! * [`urdf`], [`mjcf`]: robot descriptions in URDF and MJCF, as the same models; [`robot`] tells them apart.
//! * [`mesh`]: mesh files as triangles, for what collides and for what is drawn.
//! * [`files`]: how all programs read and write files.
//! * [`text`]: texts as they may leave a program.
//! * [`Settings`]: settings of drivers, as a device file has them.
//!
//! ```
//! use ambf_model::adf;
//!
//! let text = "bodies: [BODY Ball]\nBODY Ball: {name: Ball, mass: 1.0, shape: Sphere, geometry: {radius: 0.1}}\njoints: []\n";
//! let directory = std::env::temp_dir().join(format!("ambf_model_{}", std::process::id()));
//! std::fs::create_dir_all(&directory)?;
//! let file = directory.join("ball.yaml");
//! std::fs::write(&file, text)?;
//! let (model, report) = adf::load::<adf::Model>(&file)?;
//! assert_eq!(model.bodies[0].common.name, "Ball");
//! println!("{report}");
//! # std::fs::remove_dir_all(directory)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod adf;
pub mod files;
mod inertia;
pub mod mesh;
pub mod mjcf;
pub mod robot;
mod settings;
pub mod text;
pub mod urdf;
mod xml;

pub use settings::{Setting, SettingError, Settings};
