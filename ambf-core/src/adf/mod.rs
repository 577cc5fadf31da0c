//! ADF, the AMBF description format: text to typed description.
//!
//! Pure data: nothing here knows Bullet, opens meshes or talks to anyone. SI units, angles in rad, the world is z-up;
//! poses are given as [`nalgebra::Isometry3`]; orientations are written as roll, pitch, yaw about fixed axes,
//! R = Rz(y)·Ry(p)·Rx(r). Numbers that reach the physics are finite.

mod body;
mod camera;
mod common;
mod controller;
mod device;
mod geometry;
mod ghost;
mod joint;
mod launch;
mod light;
mod model;
mod sensor;
mod soft_body;
mod vehicle;
mod volume;
mod world;

pub use body::{RigidBody, Surface};
pub use camera::{Camera, DepthNoise, MouseMultipliers, PublishedFrame, Stereo};
pub use common::{Common, Material, PluginEntry, ShaderProgram, SourcePos};
pub use controller::{CartesianController, Controller, ControllerOutput, Gains};
pub use device::{ButtonMapping, HapticGain, InputDevice};
pub use geometry::{Axis, CollisionGeometry, CollisionMeshKind, PlacedPrimitive, Primitive, Visual, VisualGeometry};
pub use ghost::GhostObject;
pub use joint::{ConeTwistLimits, Joint, JointKind, Limits, LinearAngular, SixDofLimits, SixDofSpring};
pub use launch::Launch;
pub use light::{Attenuation, Light};
pub use model::Model;
pub use sensor::{Actuator, Ray, RaySource, ResistanceParameters, Sensor, SensorKind};
pub use soft_body::{SoftBody, SoftBodyConfig, SoftMaterial};
pub use vehicle::{Suspension, Vehicle, Wheel, WheelVisual};
pub use volume::{ImageStack, Volume};
pub use world::{Enclosure, PhysicsProfile, PhysicsSettings, Skybox, World};
