//! Between the frame and units of HD and those of the simulator.
//!
//! HD: x to the right, y up, z towards the user; mm, N, mN·m. Simulator: x towards the user, y to the right, z up; m,
//! N, N·m. So x = z of HD, y = x of HD, z = y of HD.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Column or coordinate of HD that is the simulator's.
const ORDER: [usize; 3] = [2, 0, 1];

/// Metres in a millimetre.
pub(crate) const MILLI: f64 = 1e-3;

/// A vector of HD in the simulator's frame, same unit.
pub(crate) fn vector(hd: [f64; 3]) -> Vector3<f64> {
    Vector3::from_fn(|i, _| hd[ORDER[i]])
}

/// A vector of the simulator in the frame of HD, same unit.
pub(crate) fn to_hd(vector: Vector3<f64>) -> [f64; 3] {
    [vector.y, vector.z, vector.x]
}

/// Tip in m of a transform of HD: 16 numbers, column by column, mm.
pub(crate) fn position(transform: &[f64; 16]) -> Vector3<f64> {
    vector([transform[12], transform[13], transform[14]]) * MILLI
}

/// Orientation of a transform of HD. Its columns are not quite orthogonal: the first is normalised, the second loses
/// what it has of the first, the third is their cross product. `None` for columns that span no frame.
pub(crate) fn rotation(transform: &[f64; 16]) -> Option<UnitQuaternion<f64>> {
    let column = |j: usize| vector([0, 1, 2].map(|i| transform[4 * ORDER[j] + i]));
    let first = column(0).try_normalize(1e-6)?;
    let third = first.cross(&column(1).try_normalize(1e-6)?).try_normalize(1e-3)?;
    let second = third.cross(&first);
    let matrix = Matrix3::from_columns(&[first, second, third]);
    if matrix.iter().any(|x| !x.is_finite()) {
        return None;
    }
    // A mirrored frame is no rotation, whatever it came from.
    (third.dot(&column(2)) > 0.0)
        .then(|| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    /// Transform of HD with this rotation and tip in mm.
    fn transform(rotation: Matrix3<f64>, tip: [f64; 3]) -> [f64; 16] {
        let mut transform = [0.0; 16];
        for j in 0..3 {
            for i in 0..3 {
                transform[4 * j + i] = rotation[(i, j)];
            }
            transform[12 + j] = tip[j];
        }
        transform[15] = 1.0;
        transform
    }

    #[test]
    fn towards_the_user_is_x() {
        let at = |tip| position(&transform(Matrix3::identity(), tip));
        assert_eq!(at([0.0, 0.0, 10.0]), Vector3::new(0.010, 0.0, 0.0));
        assert_eq!(at([10.0, 0.0, 0.0]), Vector3::new(0.0, 0.010, 0.0));
        assert_eq!(at([0.0, 10.0, 0.0]), Vector3::new(0.0, 0.0, 0.010));
    }

    #[test]
    fn forces_go_back_the_same_way() {
        let force = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(to_hd(force), [2.0, 3.0, 1.0]);
        assert_eq!(vector(to_hd(force)), force);
    }

    #[test]
    fn quarter_turns_are_about_the_axis_that_takes_its_place() {
        // About x, y, z of HD, which are y, z, x of the simulator.
        let turns = [
            (Vector3::x_axis(), Vector3::y_axis()),
            (Vector3::y_axis(), Vector3::z_axis()),
            (Vector3::z_axis(), Vector3::x_axis()),
        ];
        for (hd, ours) in turns {
            let matrix = *Rotation3::from_axis_angle(&hd, FRAC_PI_2).matrix();
            let expected = UnitQuaternion::from_axis_angle(&ours, FRAC_PI_2);
            let angle = rotation(&transform(matrix, [0.0; 3])).unwrap().angle_to(&expected);
            assert!(angle < 1e-12, "{hd:?}: {angle}");
        }
    }

    #[test]
    fn a_matrix_that_is_a_little_off_becomes_a_rotation() {
        let mut matrix = *Rotation3::from_euler_angles(0.3, -0.8, 2.0).matrix();
        matrix += Matrix3::new(1.0, -2.0, 3.0, -1.0, 2.0, 1.0, 2.0, 1.0, -3.0) * 1e-4;
        let rotation = rotation(&transform(matrix, [0.0; 3])).unwrap();
        let off = rotation.to_rotation_matrix().matrix() * rotation.to_rotation_matrix().matrix().transpose()
            - Matrix3::identity();
        assert!(off.norm() < 1e-14);
        assert!((rotation.norm() - 1.0).abs() < 1e-14);
    }

    #[test]
    fn what_is_no_frame_is_no_rotation() {
        assert_eq!(rotation(&[0.0; 16]), None);
        assert_eq!(rotation(&[f64::NAN; 16]), None);
        assert_eq!(rotation(&[1.0; 16]), None);
        let mirrored = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        assert_eq!(rotation(&transform(mirrored, [0.0; 3])), None);
    }
}
