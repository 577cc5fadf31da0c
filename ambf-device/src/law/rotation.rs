use std::f64::consts::{PI, TAU};

use nalgebra::{UnitQuaternion, Vector3};

/// Rotation vector (axis times angle, rad) of a rotation, by the shorter way round: its length is in [0, π].
///
/// The logarithm of the quaternion, `2·atan2(|v|, w)·v/|v|` with `w ≥ 0`, by its series near zero. There is no dead
/// zone: a rotation of a microradian has a vector of that length. At exactly half a turn both ways are equally short;
/// which one is returned depends on the sign of the quaternion.
pub fn rotation_vector(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = rotation.quaternion();
    let (w, v) = if q.w < 0.0 { (-q.w, -q.imag()) } else { (q.w, q.imag()) };
    let sine = v.norm();
    // 2·atan(t)/t for t = sine/w: the first term left out is below the rounding of f64.
    let factor = if sine < 1e-4 * w {
        let t = sine / w;
        2.0 * (1.0 - t * t / 3.0) / w
    } else if sine > 0.0 {
        2.0 * sine.atan2(w) / sine
    } else {
        0.0
    };
    v * factor
}

/// What a rotation vector has changed by since `previous`, rad. Past half a turn the shorter way round flips: the step
/// of a full turn that this gives to the vector is not a motion and is taken out, so that it can be differentiated.
pub fn rotation_vector_change(previous: &Vector3<f64>, now: &Vector3<f64>) -> Vector3<f64> {
    let change = now - previous;
    let length = now.norm();
    if change.norm() <= PI || length < 1e-9 {
        return change;
    }
    let other = change - now * (TAU / length);
    if other.norm() < change.norm() {
        other
    } else {
        change
    }
}

/// The unit quaternion nearest to what a driver gave; `None` if that is no rotation: its length differs from 1 by more
/// than a tenth.
pub(super) fn unit(rotation: &UnitQuaternion<f64>) -> Option<UnitQuaternion<f64>> {
    let norm = rotation.quaternion().norm();
    (0.9..=1.1).contains(&norm).then(|| UnitQuaternion::new_normalize(*rotation.quaternion()))
}

#[cfg(test)]
mod tests {
    use super::super::random::Random;
    use super::*;

    #[test]
    fn the_vector_gives_the_rotation_back() {
        let mut random = Random::new(1);
        for _ in 0..2000 {
            let rotation = random.rotation();
            let vector = rotation_vector(&rotation);
            assert!(vector.norm() <= PI + 1e-12);
            assert!(UnitQuaternion::new(vector).angle_to(&rotation) < 1e-7);
        }
    }

    #[test]
    fn there_is_no_dead_zone() {
        for angle in [1e-12, 1e-8, 1e-5, 2e-4, 1e-3, 5e-3] {
            let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
                f64::cos(angle / 2.0),
                0.0,
                f64::sin(angle / 2.0),
                0.0,
            ));
            let vector = rotation_vector(&rotation);
            assert!((vector.y / angle - 1.0).abs() < 1e-9, "{angle}: {vector}");
        }
        assert_eq!(rotation_vector(&UnitQuaternion::identity()), Vector3::zeros());
    }

    #[test]
    fn near_half_a_turn_it_is_finite_and_continuous() {
        let axis = Vector3::new(1.0, -2.0, 0.5).normalize();
        let mut last = None;
        for i in 0..=1000 {
            let angle = PI - 0.01 + 0.01 * f64::from(i) / 1000.0;
            // The quaternion of either sign is the same rotation.
            let q = UnitQuaternion::new(axis * (angle - if i % 2 == 0 { 0.0 } else { TAU }));
            let vector = rotation_vector(&q);
            if angle < PI - 1e-9 {
                assert!((vector - axis * angle).norm() < 1e-9, "{angle}");
            }
            if let Some(last) = last.replace(vector) {
                assert!(rotation_vector_change(&last, &vector).norm() < 1.1e-5);
            }
        }
        // Past it the vector flips, its change does not.
        let before = rotation_vector(&UnitQuaternion::new(axis * (PI - 0.001)));
        let after = rotation_vector(&UnitQuaternion::new(axis * (PI + 0.001)));
        assert!((rotation_vector_change(&before, &after) - axis * 0.002).norm() < 1e-9);
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        let of = |w| UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(w, 0.0, 0.0, 0.0));
        assert_eq!(unit(&of(1.05)), Some(UnitQuaternion::identity()));
        assert_eq!((unit(&of(0.0)), unit(&of(f64::NAN)), unit(&of(2.0))), (None, None, None));
    }
}
