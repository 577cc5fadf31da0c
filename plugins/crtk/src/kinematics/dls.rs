//! Inverse kinematics of any chain by damped least squares (Levenberg and Marquardt; Wampler 1986).

use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector6};

use super::{Chain, Coordinates, InverseError, Jacobian, Limits};

/// How [`DampedLeastSquares`] works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DlsSettings {
    /// Most iterations. Default: 50.
    pub iterations: usize,
    /// Largest distance from the goal that counts as reached, m. Default: 1e-4.
    pub distance: f64,
    /// Largest angle from the goal that counts as reached, rad. Default: 1e-3.
    pub angle: f64,
    /// Length that makes angles comparable with distances, m/rad. Default: 0.1.
    pub length: f64,
    /// Whether rotations count; `false` for arms with fewer than six joints. Default: `true`.
    pub rotation: bool,
}

impl Default for DlsSettings {
    fn default() -> Self {
        Self { iterations: 50, distance: 1e-4, angle: 1e-3, length: 0.1, rotation: true }
    }
}

/// Steps of Δq = Jᵀ (J Jᵀ + λ² I)⁻¹ e from the present coordinates, with the error e of the pose in base axes (angles
/// multiplied by a length).
///
/// * λ² starts at 1e-6 of the largest diagonal element. A step that makes the error larger is not taken, and λ² is
///   multiplied by 8; after a step that helps it is divided by 4.
/// * **Limits**: a joint that a step would take beyond its limit is put there and left out of that step, whose rest is
///   computed again.
/// * **Redundant arms**: among all solutions the step that moves the joints least, so the arm stays near where it is.
/// * It goes on until the error is below 1e-10 m or no step helps, and **has converged** if distance and angle are
///   within the tolerances then.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DampedLeastSquares {
    /// How.
    pub settings: DlsSettings,
}

/// The error at which nothing is left to be gained, m.
const EXACT: f64 = 1e-10;

/// Steps that make the error larger in a row, before it is given up.
const MAX_DAMPINGS: usize = 12;

impl DampedLeastSquares {
    /// Joint coordinates within `limits` for `goal` in the base, from `present` on.
    ///
    /// # Errors
    /// [`InverseError::Unreachable`] when it has not converged.
    pub fn solve(
        &self,
        chain: &Chain,
        goal: &Isometry3<f64>,
        present: &Coordinates,
        limits: &[Limits],
    ) -> Result<Coordinates, InverseError> {
        let mut q = *present;
        for (value, limit) in q.iter_mut().zip(limits) {
            *value = limit.clip(*value);
        }
        let mut error = self.error(chain, goal, &q);
        let mut damping = 1e-6;
        let mut failures = 0;
        for _ in 0..self.settings.iterations {
            if error.norm() < EXACT || failures > MAX_DAMPINGS {
                break;
            }
            let jacobian = self.weighted(chain.jacobian(&q));
            let trial = step(&jacobian, &error, &q, damping, limits);
            let trial_error = self.error(chain, goal, &trial);
            if trial_error.norm() < error.norm() {
                (q, error) = (trial, trial_error);
                damping = (damping / 4.0).max(1e-12);
                failures = 0;
            } else {
                damping *= 8.0;
                failures += 1;
            }
        }
        let is_near = error.fixed_rows::<3>(0).norm() <= self.settings.distance
            && error.fixed_rows::<3>(3).norm() <= self.settings.angle * self.settings.length;
        is_near.then_some(q).ok_or(InverseError::Unreachable)
    }

    /// Weight of angles, m/rad.
    fn weight(&self) -> f64 {
        if self.settings.rotation {
            self.settings.length
        } else {
            0.0
        }
    }

    fn error(&self, chain: &Chain, goal: &Isometry3<f64>, q: &Coordinates) -> Vector6<f64> {
        let pose = chain.forward(q);
        let mut error = Vector6::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&(goal.translation.vector - pose.translation.vector));
        let turn = (goal.rotation * pose.rotation.inverse()).scaled_axis();
        error.fixed_rows_mut::<3>(3).copy_from(&(turn * self.weight()));
        error
    }

    fn weighted(&self, mut jacobian: Jacobian) -> Jacobian {
        let mut angular = jacobian.fixed_rows_mut::<3>(3);
        angular *= self.weight();
        jacobian
    }
}

/// Most steps towards an orientation.
const ORIENTING_STEPS: usize = 10;

/// Joint coordinates near `present` that turn the control point to `goal` (in the base), with joints from `first` on only;
/// those before stay, and the place is what comes of it. What cannot be reached is come near.
pub(super) fn orient(
    chain: &Chain,
    goal: &UnitQuaternion<f64>,
    present: &Coordinates,
    first: usize,
    limits: &[Limits],
) -> Coordinates {
    let error = |q: &Coordinates| {
        let mut error = Vector6::zeros();
        let turn = (goal * chain.forward(q).rotation.inverse()).scaled_axis();
        error.fixed_rows_mut::<3>(3).copy_from(&turn);
        error
    };
    let mut q = *present;
    let mut left = error(&q);
    for _ in 0..ORIENTING_STEPS {
        if left.norm() < EXACT {
            break;
        }
        let mut jacobian = chain.jacobian(&q);
        jacobian.fixed_rows_mut::<3>(0).fill(0.0);
        jacobian.columns_mut(0, first).fill(0.0);
        let trial = step(&jacobian, &left, &q, 1e-6, limits);
        let trial_left = error(&trial);
        if trial_left.norm() >= left.norm() {
            break;
        }
        (q, left) = (trial, trial_left);
    }
    q
}

/// One step that respects the limits.
fn step(jacobian: &Jacobian, error: &Vector6<f64>, q: &Coordinates, damping: f64, limits: &[Limits]) -> Coordinates {
    let mut jacobian = *jacobian;
    let mut left = *error;
    let mut result = *q;
    // At most each joint is put to a limit once.
    for _ in 0..=limits.len() {
        let change = damped(&jacobian, &left, damping);
        let beyond = (0..limits.len()).find(|&i| !limits[i].hold(result[i] + change[i], 0.0) && change[i] != 0.0);
        let Some(joint) = beyond else { return result + change };
        let by = limits[joint].clip(result[joint] + change[joint]) - result[joint];
        left -= jacobian.column(joint) * by;
        result[joint] += by;
        jacobian.column_mut(joint).fill(0.0);
    }
    result
}

fn damped(jacobian: &Jacobian, error: &Vector6<f64>, damping: f64) -> Coordinates {
    let square = jacobian * jacobian.transpose();
    let scale = square.diagonal().max().max(1e-12);
    let inverse = (square + Matrix6::identity() * (damping * scale)).cholesky();
    inverse.map_or_else(Coordinates::zeros, |inverse| jacobian.transpose() * inverse.solve(error))
}

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;

    use super::super::testing::{gap, random_psm, Random, PSM_LIMITS};
    use super::super::{DhTable, Instrument, MAX_JOINTS};
    use super::*;

    #[test]
    fn forward_kinematics_are_inverted_from_nearby() {
        let chain = DhTable::psm(&Instrument::LARGE_NEEDLE_DRIVER).chain();
        let mut random = Random::new(17);
        let mut failed = 0;
        const POSES: usize = 3000;
        for _ in 0..POSES {
            let q = random_psm(&mut random);
            let mut start = q;
            start.iter_mut().take(6).for_each(|value| *value += random.within(-0.05, 0.05));
            let goal = chain.forward(&q);
            match DampedLeastSquares::default().solve(&chain, &goal, &start, &PSM_LIMITS) {
                Ok(found) => {
                    assert!(gap(&chain.forward(&found), &goal) < 2e-3);
                    assert!(PSM_LIMITS.iter().zip(&found).all(|(limit, &value)| limit.hold(value, 1e-12)));
                }
                Err(_) => failed += 1,
            }
        }
        // At limits the step that stays inside may lead nowhere.
        assert!(failed * 100 < POSES, "{failed} of {POSES}");
    }

    #[test]
    fn a_redundant_arm_moves_little() {
        let chain = DhTable::mtm().chain();
        let limits = [Limits { lower: -6.0, upper: 6.0 }; 7];
        let mut random = Random::new(23);
        for _ in 0..500 {
            let mut q = Coordinates::zeros();
            let middle = [0.0, 0.3, 0.0, 0.0, 0.9, 0.3, 0.0];
            for (value, middle) in q.iter_mut().zip(middle) {
                *value = middle + random.within(-0.3, 0.3);
            }
            let mut goal = chain.forward(&q);
            goal.append_translation_mut(&Translation3::new(0.01, -0.01, 0.01));
            let found = DampedLeastSquares::default().solve(&chain, &goal, &q, &limits).unwrap();
            assert!(gap(&chain.forward(&found), &goal) < 1e-6);
            assert!((found - q).amax() < 0.5, "{}", (found - q).transpose());
        }
    }

    #[test]
    fn what_is_out_of_reach_is_said() {
        let chain = DhTable::psm(&Instrument::LARGE_NEEDLE_DRIVER).chain();
        let goal = Isometry3::translation(3.0, 0.0, 0.0);
        let solve = |present| DampedLeastSquares::default().solve(&chain, &goal, &present, &PSM_LIMITS);
        assert_eq!(solve(Coordinates::zeros()), Err(InverseError::Unreachable));
        assert_eq!(Coordinates::zeros().len(), MAX_JOINTS);
    }

    #[test]
    fn without_rotation_the_place_is_enough() {
        let chain = DhTable::ecm(0.0).chain();
        let method = DampedLeastSquares { settings: DlsSettings { rotation: false, ..DlsSettings::default() } };
        let limits = [Limits { lower: -1.5, upper: 1.5 }; 4];
        let goal = Isometry3::translation(0.02, -0.03, -0.12);
        let start = Coordinates::from([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let found = method.solve(&chain, &goal, &start, &limits).unwrap();
        assert!((chain.forward(&found).translation.vector - goal.translation.vector).norm() < 1e-9);
    }
}
