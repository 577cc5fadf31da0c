//! Inverse kinematics in closed form of arms that move about a remote centre: PSM and ECM of a da Vinci.
//!
//! The remote centre is the origin of the base. A PSM's wrist centre W (on the pitch axis) lies on the instrument's
//! shaft, so yaw, pitch and insertion follow from W alone; the wrist's angles from how the tool is turned against the
//! shaft. Which side of the yaw axis W is on is decided so that the wrist is not folded back: the other solution breaks
//! the limits of the wrist of every instrument.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::{Coordinates, InverseError, Limits};

/// Below this length (m, or sine) a direction is not determined.
const SINGULAR: f64 = 1e-9;

/// Directions of yaw and pitch, frame 3 of the table, and the distance from the remote centre.
struct Shaft {
    yaw: f64,
    pitch: f64,
    distance: f64,
    /// Along the shaft, away from the remote centre.
    direction: Vector3<f64>,
    /// Columns: axes of the frame that follows the insertion.
    frame: Matrix3<f64>,
}

impl Shaft {
    /// `yaw_limits`: where the arm may be above its remote centre, as some can by yaw alone.
    fn to(place: &Vector3<f64>, yaw_limits: Option<&Limits>) -> Result<Self, InverseError> {
        let distance = place.norm();
        if distance < SINGULAR {
            return Err(InverseError::Singular);
        }
        let direction = place / distance;
        let yaw = direction.x.atan2(-direction.z);
        if direction.z >= 0.0 && !yaw_limits.is_some_and(|limits| limits.hold(yaw, 1e-6)) {
            return Err(InverseError::RemoteCentre);
        }
        let pitch = -direction.y.clamp(-1.0, 1.0).asin();
        let ((sin_yaw, cos_yaw), (sin_pitch, cos_pitch)) = (yaw.sin_cos(), pitch.sin_cos());
        // Product of the first three rows of the table.
        let x = Vector3::new(-sin_yaw * sin_pitch, -cos_pitch, cos_yaw * sin_pitch);
        let y = direction.cross(&x);
        Ok(Self { yaw, pitch, distance, direction, frame: Matrix3::from_columns(&[x, y, direction]) })
    }
}

/// The angle in (−π, π].
fn wrap(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > PI {
        turned - TAU
    } else {
        turned
    }
}

/// The angle, by whole turns, that is nearest to `present`.
fn nearest_turn(angle: f64, present: f64) -> f64 {
    present + wrap(angle - present)
}

/// Of a patient side manipulator: yaw, pitch, insertion, roll, wrist pitch, wrist yaw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PsmInverse {
    /// D − L of the [instrument](super::Instrument), m.
    pub gap: f64,
    /// From the wrist's pitch axis to its yaw axis, m.
    pub wrist: f64,
    /// Control point in the frame of the wrist's yaw axis. Default: none.
    pub tip: Isometry3<f64>,
}

impl PsmInverse {
    /// Joint coordinates for `goal` in the base; the roll is the turn that is next to the present one. Of `limits` only
    /// the first counts, for places above the remote centre.
    ///
    /// # Errors
    /// [`InverseError::RemoteCentre`] for a wrist above the remote centre, [`InverseError::Singular`] where the tool's
    /// yaw axis points at the remote centre.
    pub fn solve(
        &self,
        goal: &Isometry3<f64>,
        present: &Coordinates,
        limits: &[Limits],
    ) -> Result<Coordinates, InverseError> {
        let goal = goal * self.tip.inverse();
        let place = goal.translation.vector;
        let rotation = goal.rotation.to_rotation_matrix();
        // Axes of the last row's frame, without the fixed turn of the tool: its rows are (0 −1 0), (0 0 1), (−1 0 0).
        let axes = rotation.matrix() * Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0).transpose();
        let (x6, z6) = (axes.column(0).into_owned(), axes.column(2).into_owned());
        let across = place - z6 * place.dot(&z6);
        if across.norm() < SINGULAR {
            return Err(InverseError::Singular);
        }
        let x5 = across.normalize();
        let z5 = x5.cross(&z6);
        let shaft = Shaft::to(&(place - x5 * self.wrist), limits.first())?;
        let insertion = shaft.distance + self.gap;
        let u = shaft.direction;
        let wrist_yaw = wrap((-x6.dot(&z5)).atan2(x6.dot(&x5)) + FRAC_PI_2);
        let x4 = z5.cross(&u);
        let wrist_pitch = wrap((-x5.dot(&u)).atan2(x5.dot(&x4)) + FRAC_PI_2);
        let roll = x4.dot(&shaft.frame.column(1)).atan2(x4.dot(&shaft.frame.column(0)));
        let mut q = Coordinates::zeros();
        let values = [shaft.yaw, shaft.pitch, insertion, nearest_turn(roll, present[3]), wrist_pitch, wrist_yaw];
        q.as_mut_slice()[..values.len()].copy_from_slice(&values);
        Ok(q)
    }
}

/// Of an endoscope manipulator: yaw, pitch, insertion, roll. The place is met, and the rotation about the endoscope as
/// far as it can.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EcmInverse {
    /// Control point in the frame of the endoscope's tip, without the fixed turn of the tool.
    pub tool: Isometry3<f64>,
}

impl EcmInverse {
    /// From the remote centre to the insertion's zero, m.
    pub const DEPTH: f64 = 0.3822;
    /// From the insertion to the tip, m.
    pub const LENGTH: f64 = 0.3829;

    /// Joint coordinates for `goal` in the base; `limits` as for [`PsmInverse::solve`].
    ///
    /// # Errors
    /// [`InverseError::RemoteCentre`] above the remote centre, [`InverseError::Singular`] within 0.1 mm of it.
    pub fn solve(
        &self,
        goal: &Isometry3<f64>,
        present: &Coordinates,
        limits: &[Limits],
    ) -> Result<Coordinates, InverseError> {
        let tip = goal * self.tool.inverse();
        if tip.translation.vector.norm() < 1e-4 {
            return Err(InverseError::Singular);
        }
        let shaft = Shaft::to(&tip.translation.vector, limits.first())?;
        let frame = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(shaft.frame));
        let turned = (frame.inverse() * tip.rotation).to_rotation_matrix();
        let m = turned.matrix();
        // The rotation about z that is nearest in the sense of Frobenius' norm.
        let roll = (m[(1, 0)] - m[(0, 1)]).atan2(m[(0, 0)] + m[(1, 1)]);
        let insertion = shaft.distance + Self::DEPTH - Self::LENGTH;
        let mut q = Coordinates::zeros();
        let values = [shaft.yaw, shaft.pitch, insertion, nearest_turn(roll, present[3])];
        q.as_mut_slice()[..values.len()].copy_from_slice(&values);
        Ok(q)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{coordinates, gap, random_psm, Random, PSM_LIMITS};
    use super::super::{DhTable, Instrument};
    use super::*;

    #[test]
    fn forward_kinematics_of_a_psm_are_inverted() {
        let mut random = Random::new(11);
        for instrument in [Instrument::LARGE_NEEDLE_DRIVER, Instrument::CHALLENGE] {
            let chain = DhTable::psm(&instrument).chain();
            let inverse = PsmInverse::from(&instrument);
            for _ in 0..10_000 {
                let q = random_psm(&mut random);
                let found = inverse.solve(&chain.forward(&q), &q, &PSM_LIMITS).unwrap();
                assert!((found - q).amax() < 1e-9, "{} {}", q.transpose(), found.transpose());
            }
        }
    }

    #[test]
    fn a_tip_beyond_the_wrist_is_taken_off() {
        let tip = Isometry3::translation(0.0, 0.0, 0.0102);
        let chain = DhTable::psm(&Instrument::LARGE_NEEDLE_DRIVER).chain().with_tip(&tip);
        let inverse = PsmInverse { tip, ..PsmInverse::from(&Instrument::LARGE_NEEDLE_DRIVER) };
        let q = coordinates(&[0.1, -0.2, 0.15, 0.3, -0.4, 0.5]);
        assert!((inverse.solve(&chain.forward(&q), &q, &PSM_LIMITS).unwrap() - q).amax() < 1e-12);
    }

    #[test]
    fn the_roll_stays_on_its_turn() {
        let chain = DhTable::psm(&Instrument::LARGE_NEEDLE_DRIVER).chain();
        let inverse = PsmInverse::from(&Instrument::LARGE_NEEDLE_DRIVER);
        for roll in [-4.5, -3.2, 3.2, 4.5] {
            let q = coordinates(&[0.1, -0.2, 0.15, roll, -0.4, 0.5]);
            let near = coordinates(&[0.0, 0.0, 0.1, roll + 1.0, 0.0, 0.0]);
            assert!((inverse.solve(&chain.forward(&q), &near, &PSM_LIMITS).unwrap() - q).amax() < 1e-9);
        }
    }

    #[test]
    fn goals_without_a_solution_are_named() {
        let inverse = PsmInverse::from(&Instrument::LARGE_NEEDLE_DRIVER);
        let chain = DhTable::psm(&Instrument::LARGE_NEEDLE_DRIVER).chain();
        let down = chain.forward(&coordinates(&[0.0, 0.0, 0.12]));
        let solve = |goal: Isometry3<f64>| inverse.solve(&goal, &Coordinates::zeros(), &PSM_LIMITS);
        let above = Isometry3::from_parts(Vector3::new(0.01, 0.0, 0.1).into(), down.rotation);
        assert_eq!(solve(above), Err(InverseError::RemoteCentre));
        let at_centre = Isometry3::from_parts(Vector3::zeros().into(), down.rotation);
        assert_eq!(solve(at_centre), Err(InverseError::Singular));
        // The yaw axis of the wrist along the shaft.
        let turned = down * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2);
        let turned_other = down * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), FRAC_PI_2);
        assert!([turned, turned_other].into_iter().any(|goal| solve(goal) == Err(InverseError::Singular)));
    }

    #[test]
    fn forward_kinematics_of_an_ecm_are_inverted() {
        let mut random = Random::new(5);
        let table = DhTable::ecm(0.0);
        let chain = table.chain();
        let inverse = EcmInverse { tool: table.tool };
        for _ in 0..10_000 {
            let q = coordinates(&[
                random.within(-1.5, 1.5),
                random.within(-0.76, 1.1),
                random.within(0.001, 0.255),
                random.within(-1.5, 1.5),
            ]);
            assert!((inverse.solve(&chain.forward(&q), &q, &PSM_LIMITS).unwrap() - q).amax() < 1e-9);
        }
    }

    #[test]
    fn an_ecm_meets_the_place_when_the_rotation_is_out_of_reach() {
        let table = DhTable::ecm(0.0);
        let inverse = EcmInverse { tool: table.tool };
        let q = coordinates(&[0.3, -0.2, 0.1, 0.4]);
        let exact = table.chain().forward(&q);
        let tilted = exact * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.3);
        let found = table.chain().forward(&inverse.solve(&tilted, &q, &[]).unwrap());
        assert!((found.translation.vector - exact.translation.vector).norm() < 1e-12);
        assert!(gap(&found, &exact) < 0.05);
    }
}
