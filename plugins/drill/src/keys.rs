//! What keys of a window do: those of the C++ plugin, and one to switch the drill on and off, for which that has a foot
//! pedal alone.

use std::f64::consts::PI;

use ambf_plugin::key_name;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// How far a key moves the drill, m.
const STEP: f64 = 1e-3;

/// How far a key turns it, rad: 1°.
const TURN: f64 = PI / 180.0;

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// To move by so much, m, in the frame of the camera, which looks along −x, with y to the right and z up.
    Move(Vector3<f64>),
    /// To turn by so much, rad, about the axes of the drill.
    Turn(Vector3<f64>),
    /// The next smaller burr; after the smallest the largest.
    NextBurr,
    /// On or off.
    Switch,
    /// All voxels of the start.
    Restore,
}

/// What a key with modifiers (a sum of 1 Shift, 2 Ctrl, 4 Alt, 8 Super) asks for, if anything.
pub fn action(key: i32, mods: i32) -> Option<Action> {
    let along = |x: f64, y: f64, z: f64| Some(Action::Move(STEP * Vector3::new(x, y, z)));
    let about = |y: f64, z: f64| Some(Action::Turn(TURN * Vector3::new(0.0, y, z)));
    match (key_name(key)?, mods) {
        ("W", 2) => along(0.0, 0.0, 1.0),
        ("S", 2) => along(0.0, 0.0, -1.0),
        ("D", 2) => along(0.0, 1.0, 0.0),
        ("A", 2) => along(0.0, -1.0, 0.0),
        ("I", 2) => along(-1.0, 0.0, 0.0),
        ("K", 2) => along(1.0, 0.0, 0.0),
        ("Keypad8", 0) => about(-1.0, 0.0),
        ("Keypad5", 0) => about(1.0, 0.0),
        ("Keypad4", 0) => about(0.0, -1.0),
        ("Keypad6", 0) => about(0.0, 1.0),
        ("C", 0) => Some(Action::NextBurr),
        ("B", 2) => Some(Action::Switch),
        ("N", 2) => Some(Action::Restore),
        _ => None,
    }
}

/// Where the drill at `pose` is after a move in the frame of a camera that is turned like `camera`, or a turn.
pub fn moved(pose: &Isometry3<f64>, action: Action, camera: &UnitQuaternion<f64>) -> Isometry3<f64> {
    match action {
        Action::Move(by) => Translation3::from(camera * by) * pose,
        Action::Turn(by) => pose * UnitQuaternion::new(by),
        Action::NextBurr | Action::Switch | Action::Restore => *pose,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTROL: i32 = 2;

    #[test]
    fn keys_move_along_the_picture_and_turn_about_the_drill() {
        // GLFW numbers letters as ASCII does.
        let up = action(i32::from(b'W'), CONTROL).unwrap();
        let start = Isometry3::translation(1.0, 2.0, 3.0);
        assert_eq!(moved(&start, up, &UnitQuaternion::identity()).translation.vector, Vector3::new(1.0, 2.0, 3.001));
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI / 2.0);
        let right = action(i32::from(b'D'), CONTROL).unwrap();
        let there = moved(&start, right, &quarter).translation.vector;
        assert!((there - Vector3::new(0.999, 2.0, 3.0)).norm() < 1e-12, "{there}");
        // Keypad 6.
        let turned = moved(&start, action(326, 0).unwrap(), &quarter);
        assert!((turned.rotation.scaled_axis() - Vector3::new(0.0, 0.0, TURN)).norm() < 1e-12);
        assert_eq!(turned.translation, start.translation);
    }

    #[test]
    fn modifiers_have_to_fit() {
        assert_eq!(action(i32::from(b'W'), 0), None);
        assert_eq!(action(i32::from(b'C'), 0), Some(Action::NextBurr));
        assert_eq!(action(i32::from(b'C'), CONTROL), None);
        assert_eq!(action(i32::from(b'B'), CONTROL), Some(Action::Switch));
        assert_eq!(action(-1, 0), None);
    }
}
