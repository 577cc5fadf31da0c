//! States that a description names.

use nalgebra::{Isometry3, Vector3};

/// A state with a name. Objects of the model are given by their indices in its lists. For descriptions that are not ADF.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Keyframe {
    /// Its name, or number in the file.
    pub name: String,
    /// Coordinates of joints, rad or m.
    pub positions: Vec<(usize, f64)>,
    /// Rates of joints, rad/s or m/s.
    pub rates: Vec<(usize, f64)>,
    /// Poses of body frames in the world.
    pub poses: Vec<(usize, Isometry3<f64>)>,
    /// Velocities of the centre of mass, m/s, and angular velocities, rad/s, world axes.
    pub twists: Vec<(usize, [Vector3<f64>; 2])>,
}
