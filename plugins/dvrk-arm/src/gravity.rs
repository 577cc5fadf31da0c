//! A gravity term of the user's own. The arm compensates its own weight; who has a better model of it can add the
//! difference.

use nalgebra::{DMatrix, DVector, Vector6};

use crate::frames::Wrench;

/// Joint torques, N·m, from joint positions, rad; `None`: none this time.
pub(crate) type Torques = Box<dyn FnMut(&[f64]) -> Option<Vec<f64>> + Send>;

/// A hook and its limits.
pub(crate) struct GravityTerm {
    pub torques: Torques,
    /// N and N·m.
    pub limits: (f64, f64),
}

impl GravityTerm {
    /// The wrench to add, in the frame of the tip; zero for what is not known or not finite.
    pub fn wrench(&mut self, joints: &[f64], jacobian: &[f64]) -> Wrench {
        let torques = (self.torques)(joints);
        let wrench = torques.and_then(|torques| tip_wrench(jacobian, &torques)).unwrap_or_default();
        let limited = |v: nalgebra::Vector3<f64>, limit: f64| v.cap_magnitude(limit);
        Wrench { force: limited(wrench.force, self.limits.0), torque: limited(wrench.torque, self.limits.1) }
    }
}

/// Wrench at the tip that does what joint torques do: `w = (Jᵀ)⁺ τ`, in the frame of the Jacobian. `jacobian` is 6 × n
/// in columns, as robots publish it (element of row r and column c at r + 6 c), linear rows first; `torques` are n.
/// `None` when sizes do not fit or numbers are not finite.
pub fn tip_wrench(jacobian: &[f64], torques: &[f64]) -> Option<Wrench> {
    if torques.is_empty() || jacobian.len() != 6 * torques.len() {
        return None;
    }
    if !jacobian.iter().chain(torques).all(|x| x.is_finite()) {
        return None;
    }
    let transposed = DMatrix::from_column_slice(6, torques.len(), jacobian).transpose();
    let inverse = transposed.pseudo_inverse(1e-6).ok()?;
    let w: Vector6<f64> = (inverse * DVector::from_column_slice(torques)).fixed_rows::<6>(0).into();
    let wrench = Wrench { force: w.fixed_rows::<3>(0).into(), torque: w.fixed_rows::<3>(3).into() };
    Some(wrench).filter(Wrench::is_finite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn torques_become_the_wrench_that_does_the_same() {
        // Seven joints; the last moves nothing that the first six do not.
        let mut jacobian = vec![0.0; 42];
        for i in 0..6 {
            jacobian[i + 6 * i] = 0.5 + i as f64;
        }
        jacobian[36] = 1.0;
        let wrench = Wrench { force: Vector3::new(1.0, -2.0, 3.0), torque: Vector3::new(0.1, 0.2, -0.3) };
        let w = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3];
        let torques: Vec<f64> = (0..7).map(|c| (0..6).map(|r| jacobian[r + 6 * c] * w[r]).sum()).collect();
        let got = tip_wrench(&jacobian, &torques).unwrap();
        assert!((got.force - wrench.force).norm() < 1e-12 && (got.torque - wrench.torque).norm() < 1e-12);
        assert!(tip_wrench(&jacobian, &torques[..6]).is_none());
        jacobian[0] = f64::NAN;
        assert!(tip_wrench(&jacobian, &torques).is_none());
    }

    #[test]
    fn a_term_is_limited() {
        let jacobian: Vec<f64> = (0..36).map(|i| f64::from(i % 7 == 0)).collect();
        let mut term = GravityTerm { torques: Box::new(|q| Some(vec![q[0]; 6])), limits: (5.0, 0.1) };
        let wrench = term.wrench(&[100.0], &jacobian);
        assert!((wrench.force.norm() - 5.0).abs() < 1e-12 && (wrench.torque.norm() - 0.1).abs() < 1e-12);
        assert_eq!(term.wrench(&[f64::NAN], &jacobian), Wrench::zero());
        assert_eq!(term.wrench(&[1.0], &[]), Wrench::zero());
    }
}
