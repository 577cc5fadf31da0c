//! Principal axes.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Eigenvalues of a symmetric matrix, and the rotation R with tensor = R·diag(eigenvalues)·Rᵀ. A diagonal matrix is
/// left as it is; the axes of others are turned as little as the method turns them.
///
/// Cyclic Jacobi method (Golub, Van Loan, *Matrix Computations*, §8.5): always a rotation, never a mirror image, and
/// precise for tensors of any size.
pub(crate) fn diagonalised(tensor: Matrix3<f64>) -> (Vector3<f64>, Rotation3<f64>) {
    /// Sweeps that are never needed: convergence is quadratic.
    const MAX_SWEEPS: usize = 50;
    let mut a = tensor;
    let mut axes = Rotation3::identity();
    for _ in 0..MAX_SWEEPS {
        if [a.m12, a.m13, a.m23] == [0.0; 3] {
            break;
        }
        for (p, q, k) in [(0, 1, 2), (0, 2, 1), (1, 2, 0)] {
            if a[(p, q)].abs() <= f64::EPSILON * f64::EPSILON * a.diagonal().amax() {
                (a[(p, q)], a[(q, p)]) = (0.0, 0.0);
                continue;
            }
            let theta = (a[(q, q)] - a[(p, p)]) / (2.0 * a[(p, q)]);
            let t = 1.0_f64.copysign(theta) / (theta.abs() + theta.hypot(1.0));
            let cosine = t.hypot(1.0).recip();
            let sine = t * cosine;
            let shift = t * a[(p, q)];
            a[(p, p)] -= shift;
            a[(q, q)] += shift;
            (a[(p, q)], a[(q, p)]) = (0.0, 0.0);
            let (kp, kq) = (a[(k, p)], a[(k, q)]);
            a[(k, p)] = cosine * kp - sine * kq;
            a[(k, q)] = sine * kp + cosine * kq;
            (a[(p, k)], a[(q, k)]) = (a[(k, p)], a[(k, q)]);
            let mut turn = Matrix3::identity();
            (turn[(p, p)], turn[(q, q)], turn[(p, q)], turn[(q, p)]) = (cosine, cosine, sine, -sine);
            axes *= Rotation3::from_matrix_unchecked(turn);
        }
    }
    (a.diagonal(), axes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(tensor: Matrix3<f64>) -> (Vector3<f64>, Rotation3<f64>) {
        let (moments, axes) = diagonalised(tensor);
        let r = axes.matrix();
        let back = r * Matrix3::from_diagonal(&moments) * r.transpose();
        assert!((back - tensor).amax() <= 1e-14 * tensor.amax(), "{tensor} became {back}");
        assert!((r.determinant() - 1.0).abs() < 1e-14 && (r * r.transpose() - Matrix3::identity()).amax() < 1e-14);
        (moments, axes)
    }

    #[test]
    fn a_diagonal_tensor_keeps_its_order_and_axes() {
        let (moments, axes) = check(Matrix3::from_diagonal(&Vector3::new(3.0, 1.0, 2.0)));
        assert_eq!((moments, axes), (Vector3::new(3.0, 1.0, 2.0), Rotation3::identity()));
    }

    #[test]
    fn tensors_are_restored_from_their_principal_axes() {
        check(Matrix3::zeros());
        check(Matrix3::repeat(1.0));
        check(Matrix3::new(2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 2.0));
        for i in 0..100 {
            let f = f64::from(i);
            let axes = Rotation3::from_euler_angles(f, 2.0 * f, -0.7 * f);
            let moments = Vector3::new(1.0, 1.0 + 1e-9 * f, 10f64.powf(f / 20.0));
            let size = 10f64.powf(f - 50.0);
            check(size * (axes.matrix() * Matrix3::from_diagonal(&moments) * axes.matrix().transpose()).symmetric());
        }
    }

    #[test]
    fn the_rotated_inertia_of_a_box() {
        let turned = Rotation3::from_euler_angles(0.0, 0.0, 0.3);
        let tensor =
            turned.matrix() * Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 2.5)) * turned.matrix().transpose();
        let (moments, axes) = check(tensor.symmetric());
        assert!((moments - Vector3::new(1.0, 2.0, 2.5)).norm() < 1e-14);
        assert!(axes.angle_to(&turned) < 1e-14, "the nearest of the possible axes");
    }

    trait Symmetric {
        fn symmetric(self) -> Self;
    }

    impl Symmetric for Matrix3<f64> {
        fn symmetric(self) -> Self {
            (self + self.transpose()) / 2.0
        }
    }
}
