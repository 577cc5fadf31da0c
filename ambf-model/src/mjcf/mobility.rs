//! How easily joints move: the inertias that time constants and damping ratios are about.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};

use super::actuator::Drives;
use super::body::{Bodies, Body};
use super::joint::{Joint, Kind};
use crate::adf::ProblemKind;

/// Sets what springs and dampers of joints and actuators have by `springdamper` and `dampratio`. Masses are complete, actuators read.
///
/// With the inertia m, which a joint has where everything stands as it is written, the time constant t and the ratio z, a joint has the
/// stiffness m / (t z)² and the damping 2 m / t, and an actuator of stiffness k the damping 2 z √(k m), as in MuJoCo.
pub(super) fn set_ratios(bodies: &mut Bodies<'_>, drives: &mut Drives) {
    let has_spring = bodies.all.iter().flat_map(|body| &body.joints).any(|joint| joint.spring_damper.is_some());
    if !has_spring && !drives.values().any(|drive| drive.has_ratio()) {
        return;
    }
    let armature =
        |joint: &Joint<'_>| joint.drive_train.armature + drives.get(&joint.name).map_or(0.0, |drive| drive.armature);
    let mobilities = mobilities(&bodies.all, armature);
    let joints = bodies.all.iter_mut().flat_map(|body| &mut body.joints);
    for (joint, mobility) in joints.zip(mobilities.into_iter().flatten()) {
        if let Some(drive) = drives.get_mut(&joint.name) {
            drive.set_ratio(mobility);
        }
        let Some([time, ratio]) = joint.spring_damper else { continue };
        let inertia = mobility.recip();
        let (stiffness, damping) = (inertia / (time * ratio).powi(2), 2.0 * inertia / time);
        if stiffness.is_finite() && stiffness > 0.0 && damping.is_finite() {
            joint.add_spring(stiffness, joint.own_rest);
            joint.drive_train.damping += damping;
        } else {
            let found = format!("with the inertia {inertia:.1e} a stiffness of {stiffness:.1e}");
            let expected = "another time constant or ratio";
            joint.element.error(ProblemKind::OutOfRange, "springdamper", &found, expected, "it has no effect");
        }
    }
}

/// Of each joint of each body the diagonal element of the inverse mass matrix where everything stands as it is written, 1/(kg·m²) or
/// 1/kg; infinite where nothing moves that has an inertia. Of joints with several coordinates, 0.
///
/// The articulated-body algorithm without velocities and forces (Featherstone 2008, chapter 7), all in world axes about a point of the
/// tree, then inverse inertias of the bodies from the base on (Kreutz-Delgado, Jain and Rodriguez 1992).
fn mobilities(all: &[Body<'_>], armature: impl Fn(&Joint<'_>) -> f64) -> Vec<Vec<f64>> {
    // Close to what moves: squares of distances are added to moments of inertia.
    let mut points = vec![Point3::origin(); all.len()];
    for (index, body) in all.iter().enumerate() {
        let is_first = all[body.parent].is_static;
        points[index] = if is_first { body.in_world.translation.vector.into() } else { points[body.parent] };
    }
    let mut inertias: Vec<Matrix6<f64>> = all.iter().zip(&points).map(|(body, point)| spatial(body, point)).collect();
    let mut axes: Vec<Vec<Vec<Axis>>> = Vec::new();
    for (body, point) in all.iter().zip(&points) {
        axes.push(body.joints.iter().map(|joint| Axis::all(joint, &body.in_world, point, armature(joint))).collect());
    }
    for index in (0..all.len()).rev().filter(|&index| !all[index].is_static) {
        for axis in axes[index].iter_mut().flatten().rev() {
            axis.release(&mut inertias[index]);
        }
        let inertia = inertias[index];
        inertias[all[index].parent] += inertia;
    }
    // What a force on a body makes of its acceleration.
    let mut inverses = vec![Matrix6::zeros(); all.len()];
    let mut found = vec![Vec::new(); all.len()];
    for (index, body) in all.iter().enumerate().filter(|(_, body)| !body.is_static) {
        let mut inverse = inverses[body.parent];
        for (joint, axes) in body.joints.iter().zip(&axes[index]) {
            let mut mobility = 0.0;
            for axis in axes {
                mobility = axis.mobility(&inverse);
                axis.carry(&mut inverse);
            }
            found[index].push(if joint.has_coordinate() { mobility } else { 0.0 });
        }
        inverses[index] = inverse;
    }
    found
}

/// One coordinate of a joint. Spatial vectors have the angular part first.
struct Axis {
    /// Motion at rate 1.
    motion: Vector6<f64>,
    armature: f64,
    /// Force on what the joint carries at acceleration 1, nothing else accelerated; that along the motion is its inertia.
    force: Vector6<f64>,
    inertia: f64,
}

impl Axis {
    /// Those of a joint; of several axes the first is nearest to the base.
    fn all(joint: &Joint<'_>, body: &Isometry3<f64>, about: &Point3<f64>, armature: f64) -> Vec<Self> {
        let new = |angular: Vector3<f64>, linear: Vector3<f64>| Self {
            motion: Vector6::from_iterator(angular.iter().chain(linear.iter()).copied()),
            armature,
            force: Vector6::zeros(),
            inertia: 0.0,
        };
        let slide = |along: Vector3<f64>| new(Vector3::zeros(), along);
        let pivot = (body * Point3::from(joint.position)) - about;
        let hinge = |axis: Vector3<f64>| new(axis, pivot.cross(&axis));
        let unit = |axis| Vector3::ith(axis, 1.0);
        match joint.kind {
            Kind::Hinge => vec![hinge(body * joint.axis.into_inner())],
            Kind::Slide => vec![slide(body * joint.axis.into_inner())],
            Kind::Ball => (0..3).map(|axis| hinge(unit(axis))).collect(),
            Kind::Free => (0..3).map(|axis| slide(unit(axis))).chain((0..3).map(|axis| hinge(unit(axis)))).collect(),
        }
    }

    /// Takes from the inertia of what the joint carries the part that it lets go.
    fn release(&mut self, inertia: &mut Matrix6<f64>) {
        self.force = *inertia * self.motion;
        self.inertia = self.motion.dot(&self.force) + self.armature;
        if self.inertia > 0.0 {
            *inertia -= self.force * self.force.transpose() / self.inertia;
        }
    }

    /// `inverse`: what a force on the body before the joint makes of its acceleration.
    fn mobility(&self, inverse: &Matrix6<f64>) -> f64 {
        if self.inertia <= 0.0 {
            return f64::INFINITY;
        }
        self.inertia.recip() + self.force.dot(&(inverse * self.force)) / self.inertia.powi(2)
    }

    /// Makes of the inverse inertia before the joint that after it.
    fn carry(&self, inverse: &mut Matrix6<f64>) {
        if self.inertia > 0.0 {
            let passed = Matrix6::identity() - self.force * self.motion.transpose() / self.inertia;
            *inverse = passed.transpose() * *inverse * passed + self.motion * self.motion.transpose() / self.inertia;
        }
    }
}

/// Spatial inertia about a point, in world axes.
fn spatial(body: &Body<'_>, about: &Point3<f64>) -> Matrix6<f64> {
    let Some((moments, pose)) = body.principal else { return Matrix6::zeros() };
    let pose = body.in_world * pose;
    let turn = pose.rotation.to_rotation_matrix();
    let cross = (Point3::from(pose.translation.vector) - about).cross_matrix();
    let mass = body.mass.mass;
    let mut inertia = Matrix6::zeros();
    let angular = turn.matrix() * Matrix3::from_diagonal(&moments) * turn.matrix().transpose();
    inertia.fixed_view_mut::<3, 3>(0, 0).copy_from(&(angular - cross * cross * mass));
    inertia.fixed_view_mut::<3, 3>(0, 3).copy_from(&(cross * mass));
    inertia.fixed_view_mut::<3, 3>(3, 0).copy_from(&(cross.transpose() * mass));
    inertia.fixed_view_mut::<3, 3>(3, 3).copy_from(&Matrix3::from_diagonal_element(mass));
    inertia
}
