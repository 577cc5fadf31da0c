//! What a Hydra sends, and how it becomes a pose in the frame of devices.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Bytes of an input report up to the end of the second controller.
pub(super) const REPORT: usize = 50;
/// Bytes of a feature report, the first of which is its number.
pub(super) const FEATURE: usize = 91;
/// From one controller to the next, in bytes.
const CONTROLLER: usize = 22;
/// From the tip of the base's measurement to where the hand holds, in the controller's frame, m.
const GRAB_POINT: Vector3<f64> = Vector3::new(0.047, 0.035, 0.0);
/// The hand is so far in front of the base when it is at the origin, m.
const DISTANCE: f64 = 0.5;

/// The feature report that starts, or stops, the stream of input reports.
pub(super) fn streaming(on: bool) -> [u8; FEATURE] {
    let mut report = [0; FEATURE];
    report[6] = 1;
    report[8] = 4;
    if on {
        report[9] = 3;
    }
    report[89] = if on { 6 } else { 5 };
    report
}

/// A controller as measured, in the frame that the drivers of ROS use: x away from the base, y to the left, z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Controller {
    /// m.
    pub position: Vector3<f64>,
    pub rotation: UnitQuaternion<f64>,
    /// Seven bits.
    pub buttons: u32,
    /// 0 released … 1 pulled.
    pub trigger: f64,
}

/// Controller 0 or 1 of an input report; `None` for what is no such report.
pub(super) fn parse(report: &[u8], controller: usize) -> Option<Controller> {
    if report.len() < REPORT {
        return None;
    }
    let at = 8 + CONTROLLER * controller;
    let word = |i: usize| f64::from(i16::from_le_bytes([report[at + i], report[at + i + 1]]));
    // From the frame of the base to that of ROS.
    let to_ours = Matrix3::new(0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    let position = to_ours * Vector3::new(word(0), word(2), word(4)) * 1e-3;
    let quaternion = Quaternion::new(word(6), word(8), word(10), word(12)) / 32768.0;
    let measured = UnitQuaternion::try_new(quaternion, 1e-3)?;
    let to_ours = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(to_ours));
    let rotation = to_ours * measured * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
    Some(Controller {
        position,
        rotation,
        buttons: u32::from(report[at + 14] & 0x7F),
        trigger: f64::from(report[at + 19]) / 255.0,
    })
}

/// Pose of the grab point in the frame of devices.
pub(super) fn to_device(position: Vector3<f64>, rotation: UnitQuaternion<f64>) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let p = position + rotation * GRAB_POINT;
    // x and y of the rotation vector change their sign: the same rotation seen after half a turn about z.
    let half = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    (Vector3::new(-p.x - DISTANCE, -p.y, p.z), half * rotation * half.inverse())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// An input report with these raw numbers for one controller.
    pub fn report(
        controller: usize,
        position: [i16; 3],
        quaternion: [i16; 4],
        buttons: u8,
        trigger: u8,
    ) -> [u8; REPORT + 2] {
        let mut report = [0; REPORT + 2];
        for (c, identity) in [(0, 14), (1, 36)] {
            if c != controller {
                report[identity..identity + 2].copy_from_slice(&i16::MAX.to_le_bytes());
            }
        }
        let at = 8 + 22 * controller;
        for (i, value) in position.iter().chain(&quaternion).enumerate() {
            report[at + 2 * i..at + 2 * i + 2].copy_from_slice(&value.to_le_bytes());
        }
        report[at + 14] = buttons;
        report[at + 19] = trigger;
        report
    }

    const STRAIGHT: [i16; 4] = [i16::MAX, 0, 0, 0];

    #[test]
    fn feature_reports_have_their_bytes() {
        let set = |on| {
            let report = streaming(on);
            (0..FEATURE).filter(|i| report[*i] != 0).map(|i| (i, report[i])).collect::<Vec<_>>()
        };
        assert_eq!(set(true), [(6, 1), (8, 4), (9, 3), (89, 6)]);
        assert_eq!(set(false), [(6, 1), (8, 4), (89, 5)]);
    }

    #[test]
    fn controllers_are_read_from_their_places() {
        let bytes = report(1, [100, -200, 300], STRAIGHT, 0xFF, 51);
        let second = parse(&bytes, 1).unwrap();
        assert!((second.position - Vector3::new(0.2, -0.1, -0.3)).norm() < 1e-12, "{:?}", second.position);
        assert_eq!((second.buttons, second.trigger), (0x7F, 0.2));
        let first = parse(&bytes, 0).unwrap();
        assert_eq!((first.position, first.buttons, first.trigger), (Vector3::zeros(), 0, 0.0));
    }

    #[test]
    fn orientation_is_that_of_the_matrices() {
        // Formula of the source: R' = M R Rz(90°).
        let (w, y) = (0.8, 0.6);
        let raw = [(w * 32768.0) as i16, 0, (y * 32768.0) as i16, 0];
        let read = parse(&report(0, [0; 3], raw, 0, 0), 0).unwrap().rotation;
        let m = Matrix3::new(0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        let r = UnitQuaternion::from_quaternion(Quaternion::new(w, 0.0, y, 0.0)).to_rotation_matrix();
        let expected = m * r.matrix() * Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        assert!((read.to_rotation_matrix().matrix() - expected).norm() < 1e-3);
    }

    #[test]
    fn the_grab_point_is_what_moves() {
        let rotation = UnitQuaternion::from_euler_angles(0.2, -0.4, 0.9);
        let (p, r) = to_device(Vector3::new(0.1, 0.2, 0.3), rotation);
        let q = Vector3::new(0.1, 0.2, 0.3) + rotation * Vector3::new(0.047, 0.035, 0.0);
        assert!((p - Vector3::new(-q.x - 0.5, -q.y, q.z)).norm() < 1e-12);
        let (a, b) = (rotation.scaled_axis(), r.scaled_axis());
        assert!((b - Vector3::new(-a.x, -a.y, a.z)).norm() < 1e-12, "{a:?} {b:?}");
    }

    #[test]
    fn what_is_no_report_is_not_read() {
        assert_eq!(parse(&[0; 20], 0), None);
        assert_eq!(parse(&[0; 64], 0), None, "a quaternion of zeros");
    }
}
