//! Mass and inertia of a link.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::adf::{ProblemKind, Severity};
use crate::inertia::diagonalised;
use crate::xml::Element;

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
