//! Volumes: voxel data that is only drawn.

use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};

use super::common::{Common, Material, ShaderProgram};

/// A volume as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Identity and plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Pose in the parent's frame. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale; positive. Default: 1.
    pub scale: f64,
    /// The voxels; `None`: the volume is empty.
    pub images: Option<ImageStack>,
    /// Edge lengths, m; positive. Default: 1 each.
    pub dimensions: Vector3<f64>,
    /// Default: 0.5.
    pub iso_surface_value: f64,
    /// Default: 1.
    pub optical_density: f64,
    /// Default: 0.5.
    pub quality: f64,
    /// Material; `None`: the renderer's.
    pub material: Option<Material>,
    /// Own shaders.
    pub shaders: Option<ShaderProgram>,
}

/// A stack of images `path/prefix<i>.format`, i from 0 to `count` - 1.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageStack {
    /// Directory, joined to the file's directory when it was relative.
    pub path: PathBuf,
    /// Start of each file name.
    pub prefix: String,
    /// File extension without a dot.
    pub format: String,
    /// Number of images.
    pub count: u32,
}
