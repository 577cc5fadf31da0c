//! Ghost objects: sensing volumes that damp what overlaps them.

use nalgebra::Isometry3;

use super::common::Common;
use super::geometry::{CollisionGeometry, Visual};

/// A ghost object as written.
#[derive(Clone, Debug, PartialEq)]
pub struct GhostObject {
    /// Identity and plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Pose in the parent's body frame, or in the world. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale of the meshes; positive. Default: 1.
    pub scale: f64,
    /// Appearance.
    pub visual: Visual,
    /// The volume; never `None`. The offset of a single primitive is filled in (`collision offset`, else `inertial offset`, else identity).
    pub collision: CollisionGeometry,
    /// Collision margin, m, not negative. Default: 0.001.
    pub collision_margin: f64,
    /// Collision groups, each 0 to 999, in file order.
    pub collision_groups: Vec<u32>,
}
