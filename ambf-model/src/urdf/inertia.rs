//! Mass and inertia of a link.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::xml::Element;
use crate::adf::{ProblemKind, Severity};

/// Element `inertial` of a link with a mass above 0.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Inertial {
    /// kg.
    pub mass: f64,
    /// Pose of the inertial frame, whose axes are the principal ones, in the link frame.
    pub offset: Isometry3<f64>,
    /// Principal moments, kg·m²; `None`: not given or unusable.
    pub moments: Option<Vector3<f64>>,
}

impl Inertial {
    /// `None` without an inertial, without a mass, and with a mass of 0.
    pub fn read(link: &Element<'_>) -> Option<Self> {
        let inertial = link.child("inertial")?;
        inertial.finish(&[], &["origin", "mass", "inertia"]);
        let origin = inertial.origin();
        let Some(mass_element) = inertial.child("mass") else {
            inertial.error(
                ProblemKind::Absent,
                "mass",
                "",
                "an element with a mass in kg",
                "the link counts as one without",
            );
            return None;
        };
        mass_element.finish(&["value"], &[]);
        let mass = mass_element.need_real("value")?;
        if mass < 0.0 {
            let expected = "a mass in kg, at least 0";
            mass_element.error(ProblemKind::OutOfRange, "value", &mass.to_string(), expected, "0 is used");
        }
        if mass <= 0.0 {
            return None;
        }
        let principal = inertial.child("inertia").map(|element| principal(&element));
        if principal.is_none() {
            inertial.error(ProblemKind::Absent, "inertia", "", "moments of inertia", ESTIMATED);
        }
        Some(match principal.flatten() {
            Some((moments, axes)) => {
                Inertial { mass, offset: origin * UnitQuaternion::from_rotation_matrix(&axes), moments: Some(moments) }
            }
            None => Inertial { mass, offset: origin, moments: None },
        })
    }
}

const ESTIMATED: &str = "it is estimated from the collision shapes";

/// Moments smaller than this share of the largest are 0, and so are all below the square of it, kg·m².
const NOTHING: f64 = 1e-12;

/// What stands for a moment of 0, as a share of the largest: that of a rod about its axis whose length is 13 times its diameter.
const THIN: f64 = 1e-3;

/// Share by which the numbers of a file may miss the sum of two moments.
const ROUNDING: f64 = 1e-6;

/// Principal moments and axes of a written tensor; what is wrong with it is reported.
fn principal(element: &Element<'_>) -> Option<(Vector3<f64>, Rotation3<f64>)> {
    let names = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"];
    element.finish(&names, &[]);
    let [xx, yy, zz, xy, xz, yz] = names.map(|name| element.need_real(name));
    let (xx, yy, zz, xy, xz, yz) = (xx?, yy?, zz?, xy?, xz?, yz?);
    let (mut moments, axes) = diagonalised(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
    let size = moments.amax();
    let written = |moment: f64| if moment == 0.0 { "0".into() } else { format!("{moment:.3e}") };
    let found = format!(
        "a tensor with the principal moments {}",
        moments.data.as_slice().iter().map(|m| written(*m)).collect::<Vec<_>>().join(", ")
    );
    // Zeros stand for what nobody has measured; a negative moment is a mistake, unless rounding made it of a zero.
    let (is_nothing, is_negative) = (size < NOTHING * NOTHING, moments.min() < -ROUNDING * size);
    if is_nothing || is_negative {
        let severity = if is_negative && !is_nothing { Severity::Error } else { Severity::Warning };
        element.problem(severity, ProblemKind::OutOfRange, "", &found, "three moments above 0", ESTIMATED);
        return None;
    }
    if moments.min() <= NOTHING * size {
        // As of a thin rod about its axis.
        let action = format!("the others are used, and {THIN} times the largest for it");
        element.warn(ProblemKind::OutOfRange, "", &found, "three moments above 0", &action);
        moments = moments.map(|moment| if moment <= NOTHING * size { THIN * size } else { moment });
        return Some((moments, axes));
    }
    if 2.0 * moments.max() > moments.sum() * (1.0 + ROUNDING) {
        let expected = "none larger than the sum of the others, as that of any rigid body";
        element.warn(ProblemKind::OutOfRange, "", &found, expected, "it is used as it is");
    }
    Some((moments, axes))
}

/// Eigenvalues of a symmetric matrix, and the rotation R with tensor = R·diag(eigenvalues)·Rᵀ. A diagonal matrix is
/// left as it is; the axes of others are turned as little as the method turns them.
///
/// Cyclic Jacobi method (Golub, Van Loan, *Matrix Computations*, §8.5): always a rotation, never a mirror image, and
/// precise for tensors of any size.
fn diagonalised(tensor: Matrix3<f64>) -> (Vector3<f64>, Rotation3<f64>) {
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
