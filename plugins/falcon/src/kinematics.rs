//! Geometry of the Falcon: three equal legs of a delta robot.
//!
//! Positions here are in the *base frame*: x to the user's right, y up, z out of the device towards the user, origin at
//! the base, m. A leg has the angles θ1 (thigh, which the motor turns), θ2 (shin in the plane of the thigh) and θ3
//! (shin out of that plane), rad. After R. E. Stamper, "A three degree of freedom parallel manipulator with only
//! translational degrees of freedom" (thesis, University of Maryland, 1997), with the lengths of libnifalcon, the
//! public driver.

use nalgebra::{Matrix3, RowVector3, Vector3};

/// Thigh, m.
const A: f64 = 0.060;
/// Shin, a parallelogram, m.
const B: f64 = 0.1025;
/// Half width of the grip, m.
const C: f64 = 0.01443;
/// Ends of the parallelogram, both together, m.
const D_AND_E: f64 = 2.0 * 0.01125;
/// Offset of the shin along the axis of the leg's motor, m.
const F: f64 = -0.025;
/// Radius of the base, m.
const R: f64 = 0.0400;
/// Offset of the base along the axis of the leg's motor, m.
const S: f64 = -0.02309;

/// Directions of the legs about the base's z axis, degrees: top, right, left as seen from the front.
const DIRECTIONS: [f64; 3] = [105.0, -15.0, -135.0];

/// Degrees of θ1 for each count: 1280 counts a turn of the motor, whose shaft of 14.25 mm drives a pulley of 110 mm.
const DEGREES_PER_COUNT: f64 = 0.0364346591;
/// θ1 at count 0, degrees.
const DEGREES_AT_ZERO: f64 = 35.0;

/// Units of a motor for each N·m at the leg, as the public driver has it. Not verified on hardware.
const MOTOR_UNITS_PER_NM: f64 = 10_000.0;
/// Largest motor value.
pub const MOTOR_LIMIT: f64 = 4096.0;

/// Where the first search of [`Solver`] begins, m.
const CENTRE: Vector3<f64> = Vector3::new(0.0, 0.0, 0.125);
/// A position is found when no angle is further off, rad.
const TOLERANCE: f64 = 1e-9;
const ITERATIONS: usize = 15;

/// Position in the device frame, m, of one in the base frame; `z0` is the distance of its origin from the base.
pub fn to_device(position: &Vector3<f64>, z0: f64) -> Vector3<f64> {
    Vector3::new(position.z - z0, position.x, position.y)
}

/// Vector in the base frame of one in the device frame.
pub fn to_base(vector: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(vector.y, vector.z, vector.x)
}

/// θ1 for an encoder, rad.
pub fn angle(counts: f64) -> f64 {
    (counts * DEGREES_PER_COUNT + DEGREES_AT_ZERO).to_radians()
}

/// Encoder for θ1, in counts: the inverse of [`angle`].
pub fn counts(angle: f64) -> f64 {
    (angle.to_degrees() - DEGREES_AT_ZERO) / DEGREES_PER_COUNT
}

/// Three angles of one leg.
#[derive(Debug, Clone, Copy)]
struct Leg {
    cos_phi: f64,
    sin_phi: f64,
    theta1: f64,
    theta2: f64,
    theta3: f64,
}

impl Leg {
    /// Leg in direction `phi` when the grip is at `position`; `None` where it can't reach.
    fn reaching(phi: f64, position: &Vector3<f64>) -> Option<Self> {
        let (sin_phi, cos_phi) = phi.sin_cos();
        let u = cos_phi * position.x + sin_phi * position.y - R + C;
        let v = -sin_phi * position.x + cos_phi * position.y - S;
        let w = position.z;
        // Out of its domain each of these functions gives NaN, which the last line finds.
        let theta3 = ((v + F) / B).acos();
        let length = D_AND_E + B * theta3.sin();
        let k = u * u + w * w + A * A - length * length;
        let (l0, l1, l2) = (k - 2.0 * A * u, -4.0 * A * w, k + 2.0 * A * u);
        let theta1 = 2.0 * ((-l1 - (l1 * l1 - 4.0 * l0 * l2).sqrt()) / (2.0 * l2)).atan();
        let theta2 = (w - A * theta1.sin()).atan2(u - A * theta1.cos());
        let leg = Self { cos_phi, sin_phi, theta1, theta2, theta3 };
        (theta1 + theta2 + theta3).is_finite().then_some(leg)
    }

    /// ∂θ1/∂(x, y, z), rad/m.
    fn gradient(&self) -> RowVector3<f64> {
        let (sin2, cos2) = self.theta2.sin_cos();
        let (sin3, cos3) = self.theta3.sin_cos();
        let d = -A * sin3 * (self.theta1 - self.theta2).sin();
        // The public driver has sin²θ2 in the third column, which numerical differentiation disproves.
        RowVector3::new(
            self.cos_phi * cos2 * sin3 - self.sin_phi * cos3,
            self.sin_phi * cos2 * sin3 + self.cos_phi * cos3,
            sin2 * sin3,
        ) / d
    }
}

fn legs(position: &Vector3<f64>) -> Option<[Leg; 3]> {
    let [top, right, left] = DIRECTIONS.map(|phi| Leg::reaching(phi.to_radians(), position));
    Some([top?, right?, left?])
}

/// θ1 of the three legs, rad, when the grip is at `position`; `None` outside of the reachable set.
pub fn inverse(position: &Vector3<f64>) -> Option<Vector3<f64>> {
    legs(position).map(|legs| Vector3::from(legs.map(|leg| leg.theta1)))
}

/// ∂θ1/∂p at `position`, rad/m: one row for each leg. `None` outside of the reachable set.
pub fn jacobian(position: &Vector3<f64>) -> Option<Matrix3<f64>> {
    legs(position).map(|legs| Matrix3::from_rows(&legs.map(|leg| leg.gradient())))
}

/// Torques of the legs, N·m, that push the grip at `position` with `force`, N, in the base frame: τ = A⁻ᵀ F with A of
/// [`jacobian`]. `None` where there are none: outside of the reachable set and in singular poses.
pub fn torques(position: &Vector3<f64>, force: &Vector3<f64>) -> Option<Vector3<f64>> {
    let torques = jacobian(position)?.transpose().lu().solve(force)?;
    torques.iter().all(|torque| torque.is_finite()).then_some(torques)
}

/// Force, N, of torques of the legs, N·m: the inverse of [`torques`].
pub fn force(position: &Vector3<f64>, torques: &Vector3<f64>) -> Option<Vector3<f64>> {
    jacobian(position).map(|jacobian| jacobian.transpose() * torques)
}

/// Motor values for torques, N·m, rounded towards zero. If one would be beyond [`MOTOR_LIMIT`], all three are made
/// smaller together, so that the force keeps its direction.
pub fn motors(torques: &Vector3<f64>) -> [i16; 3] {
    let units = -torques * MOTOR_UNITS_PER_NM;
    let largest = units.amax();
    if !largest.is_finite() {
        return [0; 3];
    }
    let scale = if largest > MOTOR_LIMIT { MOTOR_LIMIT / largest } else { 1.0 };
    <[f64; 3]>::from(units * scale).map(|unit| unit as i16)
}

/// Torques, N·m, of motor values: the inverse of [`motors`].
pub fn motor_torques(motors: [i16; 3]) -> Vector3<f64> {
    Vector3::from(motors.map(f64::from)) / -MOTOR_UNITS_PER_NM
}

/// Finds the position of the grip from angles, each time from where it was before.
#[derive(Debug, Clone)]
pub struct Solver {
    position: Vector3<f64>,
}

impl Default for Solver {
    fn default() -> Self {
        Self { position: CENTRE }
    }
}

impl Solver {
    /// The last position found, m; the centre before the first.
    pub fn position(&self) -> Vector3<f64> {
        self.position
    }

    /// Position of the grip, m, where the legs have the angles `theta1`, rad: Newton's method to 1e-9 rad. `None` if
    /// there is none in front of the base; the last position then stays.
    pub fn solve(&mut self, theta1: &Vector3<f64>) -> Option<Vector3<f64>> {
        // What is far from the last position may still be found from the centre.
        let found = search(self.position, theta1).or_else(|| search(CENTRE, theta1))?;
        self.position = found;
        Some(found)
    }
}

fn search(start: Vector3<f64>, theta1: &Vector3<f64>) -> Option<Vector3<f64>> {
    let mut position = start;
    let mut here = legs(&position)?;
    for _ in 0..ITERATIONS {
        let error = theta1 - Vector3::from(here.map(|leg| leg.theta1));
        if error.amax() < TOLERANCE {
            return (position.z > 0.0).then_some(position);
        }
        let mut step = Matrix3::from_rows(&here.map(|leg| leg.gradient())).lu().solve(&error)?;
        // A step out of the reachable set is halved until it stays inside.
        let next = (0..10).find_map(|_| {
            let next = legs(&(position + step)).map(|legs| (position + step, legs));
            step *= 0.5;
            next
        });
        (position, here) = next?;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_those_of_device_and_base() {
        let base = Vector3::new(0.01, 0.02, 0.135);
        assert!((to_device(&base, 0.125) - Vector3::new(0.01, 0.01, 0.02)).norm() < 1e-12);
        assert_eq!(to_base(&Vector3::new(1.0, 2.0, 3.0)), Vector3::new(2.0, 3.0, 1.0));
    }

    /// Position, m; θ1, degrees; counts; motor values for 1 N along z.
    type Row = ([f64; 3], [f64; 3], [i16; 3], [i16; 3]);
    const TABLE: [Row; 7] = [
        ([0.0, 0.0, 0.080], [-11.80005; 3], [-1284; 3], [-158; 3]),
        ([0.0, 0.0, 0.100], [8.00808; 3], [-741; 3], [-223; 3]),
        ([0.0, 0.0, 0.125], [27.70929; 3], [-200; 3], [-252; 3]),
        ([0.0, 0.0, 0.150], [47.24327; 3], [336; 3], [-227; 3]),
        ([0.02, -0.01, 0.12], [35.56800, 11.49250, 30.34870], [16, -645, -128], [-154, -364, -211]),
        ([-0.03, 0.03, 0.13], [15.47707, 57.78800, 41.12308], [-536, 625, 168], [-446, 21, -251]),
        ([0.03, 0.0, 0.14], [48.18744, 25.60226, 53.71097], [362, -258, 514], [-192, -403, -99]),
    ];

    /// Positions all over the usable workspace.
    fn workspace() -> impl Iterator<Item = Vector3<f64>> {
        let lateral = [-0.04, -0.015, 0.0, 0.02, 0.04];
        let depths = [0.085, 0.1, 0.125, 0.14, 0.155];
        lateral
            .into_iter()
            .flat_map(move |x| lateral.into_iter().flat_map(move |y| depths.map(|z| Vector3::new(x, y, z))))
    }

    #[test]
    fn known_positions_have_known_angles_and_counts() {
        for (position, degrees, encoders, _) in TABLE {
            let angles = inverse(&position.into()).unwrap();
            assert!((angles.map(f64::to_degrees) - Vector3::from(degrees)).amax() < 1e-5, "{position:?}: {angles}");
            assert_eq!(<[f64; 3]>::from(angles).map(|angle| counts(angle).round() as i16), encoders, "{position:?}");
        }
    }

    #[test]
    fn known_angles_have_known_positions() {
        let mut warm = Solver::default();
        for (position, degrees, encoders, _) in TABLE {
            let expected = Vector3::from(position);
            let angles = Vector3::from(degrees).map(f64::to_radians);
            for solver in [&mut Solver::default(), &mut warm] {
                assert!((solver.solve(&angles).unwrap() - expected).norm() < 1e-7, "{position:?}");
                // Half a count is at most about 40 µm at the grip.
                let rounded = solver.solve(&Vector3::from(encoders.map(|count| angle(f64::from(count))))).unwrap();
                assert!((rounded - expected).norm() < 4e-5, "{position:?}: {rounded}");
            }
        }
    }

    #[test]
    fn known_positions_have_known_motor_values() {
        for (position, _, _, values) in TABLE {
            let torques = torques(&position.into(), &Vector3::z()).unwrap();
            assert_eq!(motors(&torques), values, "{position:?}");
        }
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_angles() {
        let h = 1e-6;
        for position in workspace() {
            let Some(jacobian) = jacobian(&position) else { continue };
            for column in 0..3 {
                let step = Vector3::ith(column, h);
                let numeric = (inverse(&(position + step)).unwrap() - inverse(&(position - step)).unwrap()) / (2.0 * h);
                let error = (jacobian.column(column) - numeric).amax();
                assert!(error < 1e-4, "{position}, column {column}: off by {error} rad/m");
            }
        }
        let z = jacobian(&Vector3::new(0.0, 0.0, 0.1)).unwrap()[(0, 2)];
        assert!((z - 14.888).abs() < 5e-4, "{z}");
    }

    #[test]
    fn positions_come_back_from_anywhere() {
        let mut solver = Solver::default();
        let mut reached = 0;
        for position in workspace() {
            let Some(angles) = inverse(&position) else { continue };
            reached += 1;
            assert!((solver.solve(&angles).unwrap() - position).norm() < 1e-9, "{position}");
            assert!((Solver::default().solve(&angles).unwrap() - position).norm() < 1e-9, "{position}");
        }
        assert!(reached > 100, "the grid is mostly inside the workspace: {reached}");
    }

    #[test]
    fn angles_of_no_position_leave_the_last_one() {
        let mut solver = Solver::default();
        let before = solver.solve(&inverse(&Vector3::new(0.01, 0.0, 0.12)).unwrap()).unwrap();
        for angles in [Vector3::new(3.0, -3.0, 0.0), Vector3::new(f64::NAN, 0.0, 0.0), Vector3::repeat(1e9)] {
            assert_eq!(solver.solve(&angles), None);
            assert_eq!(solver.position(), before);
        }
    }

    #[test]
    fn torques_do_the_work_of_the_force() {
        for position in workspace() {
            let Some(jacobian) = jacobian(&position) else { continue };
            let push = Vector3::new(1.0, -2.0, 0.5);
            let torques = torques(&position, &push).unwrap();
            let step = Vector3::new(3e-4, 2e-4, -1e-4);
            assert!((torques.dot(&(jacobian * step)) - push.dot(&step)).abs() < 1e-12);
            assert!((force(&position, &torques).unwrap() - push).norm() < 1e-9);
        }
    }

    #[test]
    fn motor_values_are_limited_together() {
        let all = motors(&Vector3::new(0.1, -0.2, 0.3));
        assert_eq!(all, [-1000, 2000, -3000]);
        let large = motors(&Vector3::new(1.0, -2.0, 3.0));
        assert_eq!(large, [-1365, 2730, -4096]);
        assert_eq!(motors(&Vector3::new(f64::NAN, 0.0, 0.0)), [0; 3]);
        assert_eq!(motors(&Vector3::new(f64::INFINITY, 0.0, 0.0)), [0; 3]);
        assert!((motor_torques([-1000, 2000, -3000]) - Vector3::new(0.1, -0.2, 0.3)).norm() < 1e-12);
    }
}
