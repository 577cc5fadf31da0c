//! Trees of bodies: Jacobians, mass matrices, forces and inverse kinematics, as functions of coordinates that are given.

use ambf_core::ids::{BodyId, JointId};
use ambf_core::scene::{Mechanism, Scene};
use ambf_core::tree::{Goal, Posture};
use nalgebra::{DVector, Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{errors, names};

/// Numbers that Python gives.
type Given<'py> = PyReadonlyArray1<'py, f64>;

/// What inverse kinematics found: coordinates, what is left (m, rad), whether that is within the tolerances.
type Found<'py> = (Bound<'py, PyArray1<f64>>, f64, f64, bool);

/// A tree of bodies as it was when it was asked for; see `_ambf.pyi`.
#[pyclass(frozen, module = "ambf._ambf")]
pub struct Tree {
    mechanism: Mechanism,
    /// (links) poses of the inertial frames in the frames of the bodies.
    offsets: Vec<Isometry3<f64>>,
    names: Vec<String>,
    joint_names: Vec<String>,
    places: Vec<usize>,
}

impl Tree {
    /// `joints`: those of the arrays of the world, in their order.
    pub fn new(mechanism: Mechanism, scene: &Scene, joints: &[JointId]) -> Self {
        let bodies = || mechanism.bodies.iter().map(|id| &scene.bodies[*id]);
        let (offsets, names) =
            (bodies().map(|body| body.inertial_offset).collect(), bodies().map(names::of_body).collect());
        let places = mechanism.joints.iter().filter_map(|joint| joints.binary_search(joint).ok()).collect();
        let joint_names = mechanism.joints.iter().map(|joint| scene.joints[*joint].name.clone()).collect();
        Self { mechanism, offsets, names, joint_names, places }
    }

    pub fn bodies(&self) -> &[BodyId] {
        &self.mechanism.bodies
    }

    /// The tree with its base's body frame at a pose.
    fn posture(&self, base: [f64; 7], positions: &Given<'_>) -> PyResult<Posture<'_>> {
        let positions = numbers("joint positions", positions, self.mechanism.tree.joints())?;
        Ok(self.mechanism.tree.posture(&(pose_of(base)? * self.offsets[0]), positions))
    }

    fn offset(&self, link: usize) -> PyResult<&Isometry3<f64>> {
        let count = self.offsets.len();
        self.offsets.get(link).ok_or_else(|| PyValueError::new_err(format!("there are {count} links, no {link}")))
    }
}

/// As many finite numbers as are needed.
fn numbers<'a>(what: &str, given: &'a Given<'_>, count: usize) -> PyResult<&'a [f64]> {
    let found = given.as_slice()?;
    if found.len() != count || !found.iter().all(|number| number.is_finite()) {
        let problem = format!("{what}: expected {count} finite numbers, not {found:?}");
        return Err(PyValueError::new_err(problem));
    }
    Ok(found)
}

/// Position, m, and quaternion x, y, z, w.
pub fn pose_of([x, y, z, i, j, k, w]: [f64; 7]) -> PyResult<Isometry3<f64>> {
    let rotation = rotation_of([i, j, k, w])?;
    match [x, y, z].iter().all(|number| number.is_finite()) {
        true => Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation)),
        false => Err(PyValueError::new_err("a position is not finite")),
    }
}

fn rotation_of([i, j, k, w]: [f64; 4]) -> PyResult<UnitQuaternion<f64>> {
    let problem = || PyValueError::new_err("a quaternion (x, y, z, w) is zero or not finite, which is no orientation");
    UnitQuaternion::try_new(Quaternion::new(w, i, j, k), f64::MIN_POSITIVE)
        .filter(|rotation| rotation.coords.iter().all(|number| number.is_finite()))
        .ok_or_else(problem)
}

pub fn seven(pose: &Isometry3<f64>) -> [f64; 7] {
    let Isometry3 { translation: t, rotation } = pose;
    let [i, j, k, w] = rotation.coords.into();
    [t.x, t.y, t.z, i, j, k, w]
}

fn array<'py>(py: Python<'py>, vector: &DVector<f64>) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, vector.as_slice())
}

#[pymethods]
impl Tree {
    #[getter]
    fn bodies_by_name(&self) -> Vec<String> {
        self.names.clone()
    }

    /// (joints) places in the arrays of the world.
    #[getter]
    fn joints(&self) -> Vec<usize> {
        self.places.clone()
    }

    #[getter]
    fn is_free(&self) -> bool {
        self.mechanism.tree.is_free()
    }

    /// (links x 7) poses of the body frames.
    fn poses<'py>(
        &self,
        py: Python<'py>,
        base: [f64; 7],
        positions: Given<'py>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let posture = self.posture(base, &positions)?;
        let poses = posture.poses().iter().zip(&self.offsets);
        Ok(PyArray1::from_iter(py, poses.flat_map(|(pose, offset)| seven(&(pose * offset.inverse())))))
    }

    /// (6 x n), row by row; the point is in the frame of the body.
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        base: [f64; 7],
        positions: Given<'py>,
        link: usize,
        point: [f64; 3],
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let offset = self.offset(link)?;
        let posture = self.posture(base, &positions)?;
        let point = posture.poses()[link] * offset.inverse() * Point3::from(point);
        let jacobian = posture.jacobian(link, &point.coords);
        Ok(PyArray1::from_iter(py, jacobian.transpose().iter().copied()))
    }

    /// (n x n), symmetric.
    fn mass_matrix<'py>(
        &self,
        py: Python<'py>,
        base: [f64; 7],
        positions: Given<'py>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let matrix = self.posture(base, &positions)?.mass_matrix();
        Ok(PyArray1::from_slice(py, matrix.as_slice()))
    }

    /// (followers x n), row by row.
    fn coupling_rows<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, self.mechanism.tree.coupling_rows().transpose().iter().copied())
    }

    /// (n)
    fn inverse_dynamics<'py>(
        &self,
        py: Python<'py>,
        base: [f64; 7],
        positions: Given<'py>,
        rates: Given<'py>,
        accelerations: Given<'py>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let count = self.mechanism.tree.rates();
        let posture = self.posture(base, &positions)?;
        let rates = numbers("rates", &rates, count)?;
        Ok(array(py, &posture.inverse_dynamics(rates, numbers("accelerations", &accelerations, count)?)))
    }

    /// (n)
    fn gravity_forces<'py>(
        &self,
        py: Python<'py>,
        base: [f64; 7],
        positions: Given<'py>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(array(py, &self.posture(base, &positions)?.gravity_forces()))
    }

    /// (n)
    fn coriolis_forces<'py>(
        &self,
        py: Python<'py>,
        base: [f64; 7],
        positions: Given<'py>,
        rates: Given<'py>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let posture = self.posture(base, &positions)?;
        let rates = numbers("rates", &rates, self.mechanism.tree.rates())?;
        Ok(array(py, &posture.coriolis_forces(rates)))
    }

    #[allow(clippy::too_many_arguments)]
    fn inverse_kinematics<'py>(
        &self,
        py: Python<'py>,
        base: [f64; 7],
        start: Given<'py>,
        link: usize,
        point: [f64; 3],
        position: Option<[f64; 3]>,
        rotation: Option<[f64; 4]>,
        tolerance: [f64; 2],
        iterations: usize,
    ) -> PyResult<Found<'py>> {
        let tree = &self.mechanism.tree;
        let frame = self.offset(link)?.inverse() * Translation3::from(point);
        let start = numbers("joint positions", &start, tree.joints())?;
        let base = pose_of(base)? * self.offsets[0];
        let rotation = rotation.map(rotation_of).transpose()?;
        let position: Option<Vector3<f64>> = position.map(Vector3::from);
        let goal = Goal { link, frame, position, rotation, tolerance, iterations };
        let found = py.detach(|| tree.inverse_kinematics(&base, start, &goal)).map_err(|problem| {
            let joint = self.joint_names.get(problem.coordinate).map_or("", String::as_str);
            errors::tree(py, &format!("{problem}; those of {joint} are not kept"))
        })?;
        Ok((PyArray1::from_vec(py, found.positions), found.position_error, found.rotation_error, found.reached))
    }
}
