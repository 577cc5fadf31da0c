//! Efforts that hold an arm against gravity.

use nalgebra::{Isometry3, Point3, Unit, Vector3};

/// What gravity does to a body, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Centre of mass, m.
    pub centre: Point3<f64>,
    /// Weight, N.
    pub force: Vector3<f64>,
}

/// Effort (N·m or N) of a joint that holds the bodies beyond it, by virtual work: −Σ (∂c/∂q)·w. `axis` and `origin` in
/// world axes; `beyond`: the bodies that the joint moves. Valid for trees; where joints close a loop, what hangs on the
/// loop is counted for the joint through which it was found. Arms report these efforts; what acts is the same weight
/// taken off each body.
pub fn holding_efforts(
    is_angular: bool,
    axis: &Unit<Vector3<f64>>,
    origin: &Point3<f64>,
    beyond: impl Iterator<Item = Load>,
) -> f64 {
    let work = |load: Load| {
        let moved = if is_angular { axis.cross(&(load.centre - origin)) } else { axis.into_inner() };
        moved.dot(&load.force)
    };
    -beyond.map(work).sum::<f64>()
}

impl Load {
    /// A body of a mass (kg) in a gravity (m/s², world axes).
    pub fn new(mass: f64, inertial_pose: &Isometry3<f64>, gravity: &Vector3<f64>) -> Self {
        Self { centre: inertial_pose.translation.vector.into(), force: gravity * mass }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lever_is_held_by_its_weight_times_its_length() {
        let gravity = Vector3::new(0.0, 0.0, -9.81);
        let load = Load::new(2.0, &Isometry3::translation(0.5, 0.0, 1.0), &gravity);
        let origin = Point3::new(0.0, 0.0, 1.0);
        // Positive rotation about y lets a lever along x sink, so the holding torque is negative.
        let effort = holding_efforts(true, &Vector3::y_axis(), &origin, [load].into_iter());
        assert!((effort + 2.0 * 9.81 * 0.5).abs() < 1e-12);
        let lift = holding_efforts(false, &Vector3::z_axis(), &origin, [load, load].into_iter());
        assert!((lift - 2.0 * 2.0 * 9.81).abs() < 1e-12);
        assert_eq!(holding_efforts(true, &Vector3::z_axis(), &origin, [load].into_iter()), 0.0);
    }
}
