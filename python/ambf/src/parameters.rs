//! Parameters of scenes as rows of numbers.

use ambf_core::adf::Gains;
use ambf_core::ids::{BodyId, JointId};
use ambf_core::scene::{ParameterChange, Scene};
use nalgebra::Vector3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// For each body: mass, principal moments (3), friction, restitution, linear and angular damping, gravity (3), gains of its pose
/// controller (linear P and D, angular P and D).
pub fn of_bodies(scene: &Scene, bodies: &[BodyId]) -> Vec<f64> {
    let row = |id: &BodyId| {
        let body = &scene.bodies[*id];
        let (inertia, gravity) = (body.inertia, scene.gravity_of(body));
        let gains = body.gains();
        [
            body.mass,
            inertia.x,
            inertia.y,
            inertia.z,
            body.surface.friction,
            body.surface.restitution,
            body.damping[0],
            body.damping[1],
            gravity.x,
            gravity.y,
            gravity.z,
            gains[0].p,
            gains[0].d,
            gains[1].p,
            gains[1].d,
        ]
    };
    bodies.iter().flat_map(row).collect()
}

/// For each joint: lower and upper limit, damping, friction, gains of its controller (P, I, D).
pub fn of_joints(scene: &Scene, joints: &[JointId]) -> Vec<f64> {
    let row = |id: &JointId| {
        let joint = &scene.joints[*id];
        let (low, high) = match joint.limits {
            Some(limits) if limits.low <= limits.high => (limits.low, limits.high),
            _ => (f64::NEG_INFINITY, f64::INFINITY),
        };
        let Gains { p, i, d } = joint.gains();
        [low, high, joint.drive_train.damping, joint.drive_train.friction, p, i, d]
    };
    joints.iter().flat_map(row).collect()
}

/// Adds what an array of that name says, in the order of these bodies and joints; NaN leaves what it stands for as it is.
pub fn add(
    change: &mut ParameterChange,
    name: &str,
    numbers: &[f64],
    (bodies, joints): (&[BodyId], &[JointId]),
) -> PyResult<()> {
    let one = |[value]: [f64; 1]| value;
    match name {
        "masses" => change.masses.extend(rows(bodies, numbers, one)),
        "inertias" => change.inertias.extend(rows(bodies, numbers, Vector3::from)),
        "frictions" => change.frictions.extend(rows(bodies, numbers, one)),
        "restitutions" => change.restitutions.extend(rows(bodies, numbers, one)),
        "dampings" => change.dampings.extend(rows(bodies, numbers, |two| two)),
        "gravity" => change.gravity = rows(&[()], numbers, Vector3::from).next().map(|(_, gravity)| gravity),
        "gravities" => change.gravities.extend(rows(bodies, numbers, Vector3::from)),
        "body_gains" => change.body_gains.extend(rows(bodies, numbers, |[lp, ld, ap, ad]| {
            [(lp, ld), (ap, ad)].map(|(p, d)| Gains { p, i: 0.0, d })
        })),
        "colors" => change.colors.extend(rows(bodies, numbers, |color| color)),
        "joint_limits" => change.limits.extend(rows(joints, numbers, |limits| limits)),
        "joint_dampings" => change.joint_dampings.extend(rows(joints, numbers, one)),
        "joint_frictions" => change.joint_frictions.extend(rows(joints, numbers, one)),
        "joint_gains" => change.joint_gains.extend(rows(joints, numbers, |[p, i, d]| Gains { p, i, d })),
        _ => return Err(PyValueError::new_err(format!("there are no parameters {name}"))),
    }
    Ok(())
}

/// Rows of `N` numbers without those that hold a number that is none.
fn rows<'a, I: Copy, T, const N: usize>(
    ids: &'a [I],
    numbers: &'a [f64],
    make: impl Fn([f64; N]) -> T + 'a,
) -> impl Iterator<Item = (I, T)> + 'a {
    let (rows, _) = numbers.as_chunks::<N>();
    let given = ids.iter().zip(rows).filter(|(_, row)| !row.iter().any(|number| number.is_nan()));
    given.map(move |(id, row)| (*id, make(*row)))
}
