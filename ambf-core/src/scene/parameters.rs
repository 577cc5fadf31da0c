//! Changes of what a scene is made of, while it runs: masses, surfaces, limits, gains, gravity, colours.
//!
//! They are settings, not states: resets keep them. Saved states hold them (but for colours), because the motion that follows
//! depends on them.

use nalgebra::Vector3;
use thiserror::Error;

use super::joint::resistance_of;
use super::{Body, Joint, Scene};
use crate::adf::{Gains, Limits};
use crate::ids::{BodyId, JointId};

/// What to change. Whatever is not named stays.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ParameterChange {
    /// Masses, kg, above 0, of bodies that have one. Moments of inertia change in proportion unless they are given.
    pub masses: Vec<(BodyId, f64)>,
    /// Principal moments of inertia, kg·m², above 0; or 0, not to turn about that axis, where it is 0.
    pub inertias: Vec<(BodyId, Vector3<f64>)>,
    /// Coefficients of friction, at least 0.
    pub frictions: Vec<(BodyId, f64)>,
    /// Coefficients of restitution, 0 to 1.
    pub restitutions: Vec<(BodyId, f64)>,
    /// Shares of linear and angular velocity that are lost in 1 s, 0 to 1.
    pub dampings: Vec<(BodyId, [f64; 2])>,
    /// Gravity of the world, m/s²: of all bodies that have none of their own.
    pub gravity: Option<Vector3<f64>>,
    /// Own gravity of bodies, m/s².
    pub gravities: Vec<(BodyId, Vector3<f64>)>,
    /// Gains of the controllers of bodies' poses: linear and angular.
    pub body_gains: Vec<(BodyId, [Gains; 2])>,
    /// Colours: red, green, blue, opacity, 0 to 1.
    pub colors: Vec<(BodyId, [f64; 4])>,
    /// Limits of revolute and prismatic joints, rad or m: lower, not above upper; both infinite: none. A joint beyond its new
    /// limits returns to them.
    pub limits: Vec<(JointId, [f64; 2])>,
    /// Viscous damping of revolute and prismatic joints, N·m·s/rad or N·s/m, at least 0.
    pub joint_dampings: Vec<(JointId, f64)>,
    /// Dry friction of revolute and prismatic joints, N·m or N, at least 0.
    pub joint_frictions: Vec<(JointId, f64)>,
    /// Gains of the position controllers of joints.
    pub joint_gains: Vec<(JointId, Gains)>,
}

/// Error when something cannot be changed. Nothing has changed.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ParameterError {
    /// Error when a number is not finite, or out of range.
    #[error("the {quantity} of {of}: {value:?}; expected {expected}")]
    Range {
        /// What was to be set.
        quantity: &'static str,
        /// Name of the body or joint, or `the world`.
        of: String,
        /// What it was to be.
        value: Vec<f64>,
        /// What it could be.
        expected: &'static str,
    },
    /// Error when a body has no mass: it stands still, and would have to be made anew to move.
    #[error("the {quantity} of {body} cannot be set: it has no mass, and stands still for good")]
    Static {
        /// What was to be set.
        quantity: &'static str,
        /// Name of the body.
        body: String,
    },
    /// Error when a joint of another type is to get what only revolute and prismatic joints have.
    #[error("the {quantity} of the joint {joint} cannot be set: it is of type {kind}, neither revolute nor prismatic")]
    NoDrive {
        /// What was to be set.
        quantity: &'static str,
        /// Name of the joint.
        joint: String,
        /// Its type.
        kind: &'static str,
    },
}

impl Scene {
    /// Changes parameters; all copies of them follow, also those of trees in reduced coordinates.
    ///
    /// # Errors
    /// [`ParameterError`]; nothing has changed then.
    pub(crate) fn set_parameters(&mut self, change: &ParameterChange) -> Result<(), ParameterError> {
        self.check_parameters(change)?;
        let mut loads: Vec<(BodyId, f64, Vector3<f64>)> = Vec::with_capacity(change.masses.len());
        for &(id, mass) in change.masses.iter().filter(|(id, _)| self.bodies[*id].is_dynamic()) {
            let body = &self.bodies[id];
            loads.push((id, mass, body.inertia * (mass / body.mass)));
        }
        for &(id, inertia) in change.inertias.iter().filter(|(id, _)| self.bodies[*id].is_dynamic()) {
            match loads.iter_mut().find(|(of, _, _)| *of == id) {
                Some(load) => load.2 = inertia,
                None => loads.push((id, self.bodies[id].mass, inertia)),
            }
        }
        for (id, mass, inertia) in loads {
            let body = &mut self.bodies[id];
            (body.mass, body.inertia) = (mass, inertia);
            self.world.set_mass(body.handle, mass, &inertia);
        }
        for &(id, friction) in &change.frictions {
            self.bodies[id].surface.friction = friction;
        }
        for &(id, restitution) in &change.restitutions {
            self.bodies[id].surface.restitution = restitution;
        }
        for (id, _) in change.frictions.iter().chain(&change.restitutions) {
            let Body { handle, surface, .. } = &self.bodies[*id];
            self.world.set_surface(*handle, surface);
        }
        for &(id, damping) in &change.dampings {
            let body = &mut self.bodies[id];
            body.damping = damping;
            self.world.set_damping(body.handle, damping);
        }
        self.change_gravity(change);
        for &(id, gains) in &change.body_gains {
            let body = &mut self.bodies[id];
            body.controller.set_gains(gains);
            body.target.set_gains(gains);
        }
        for &(id, color) in &change.colors {
            self.bodies[id].color = Some(color.map(|part| part as f32));
        }
        self.change_joints(change);
        Ok(())
    }

    fn change_gravity(&mut self, change: &ParameterChange) {
        for &(id, gravity) in &change.gravities {
            self.bodies[id].gravity = Some(gravity);
        }
        if let Some(gravity) = change.gravity {
            self.gravity = gravity;
            self.world.set_gravity(gravity);
        }
        // The world's is set for all bodies, also for those with one of their own.
        for body in self.bodies.iter() {
            if let Some(own) = body.gravity.filter(|_| change.gravity.is_some() || !change.gravities.is_empty()) {
                self.world.set_body_gravity(body.handle, &own);
            }
        }
    }

    fn change_joints(&mut self, change: &ParameterChange) {
        let Self { world, joints, .. } = self;
        for &(id, limits) in &change.limits {
            let joint = &mut joints[id];
            let [low, high] = limits;
            joint.limits = low.is_finite().then_some(Limits { low, high });
            if let Some(handle) = joint.handle {
                world.set_limits(handle, joint.limits.map(|limits| [limits.low, limits.high]));
            }
        }
        for &(id, damping) in &change.joint_dampings {
            joints[id].drive_train.damping = damping;
        }
        for &(id, friction) in &change.joint_frictions {
            joints[id].drive_train.friction = friction;
        }
        for (id, _) in change.joint_dampings.iter().chain(&change.joint_frictions) {
            let joint = &joints[*id];
            if let Some(handle) = joint.handle {
                world.set_resistance(handle, resistance_of(&joint.drive_train));
            }
        }
        for &(id, gains) in &change.joint_gains {
            let joint = &mut joints[id];
            joint.controller.set_gains(gains);
            joint.target.set_gains(gains);
        }
    }

    /// Whether all that is to change can change.
    ///
    /// # Errors
    /// [`ParameterError`].
    pub(crate) fn check_parameters(&self, change: &ParameterChange) -> Result<(), ParameterError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let not_negative = |value: f64| value.is_finite() && value >= 0.0;
        let share = |value: f64| (0.0..=1.0).contains(&value);
        for &(id, mass) in &change.masses {
            let body = &self.bodies[id];
            // What stands still may keep its mass of 0.
            if !body.is_dynamic() && mass != 0.0 {
                return Err(is_static(body, "mass"));
            }
            in_range("mass", of_body(body), &[mass], "kg, above 0", |mass| positive(mass) || !body.is_dynamic())?;
        }
        for (id, inertia) in &change.inertias {
            let body = &self.bodies[*id];
            if !body.is_dynamic() && *inertia != body.inertia {
                return Err(is_static(body, "inertia"));
            }
            for (new, old) in inertia.iter().zip(&body.inertia) {
                let expected = "principal moments in kg·m², above 0 unless the body does not turn about that axis";
                let is_possible = |moment| positive(moment) || (moment == 0.0 && *old == 0.0);
                in_range("inertia", of_body(body), &[*new], expected, is_possible)?;
            }
        }
        for &(id, value) in &change.frictions {
            in_range("friction", of_body(&self.bodies[id]), &[value], "0 or more", not_negative)?;
        }
        for &(id, value) in &change.restitutions {
            in_range("restitution", of_body(&self.bodies[id]), &[value], "0 to 1", share)?;
        }
        for (id, values) in &change.dampings {
            in_range("damping", of_body(&self.bodies[*id]), values, "two numbers from 0 to 1", share)?;
        }
        if let Some(gravity) = &change.gravity {
            in_range("gravity", "the world".into(), gravity.as_slice(), "m/s²", f64::is_finite)?;
        }
        for (id, gravity) in &change.gravities {
            in_range("gravity", of_body(&self.bodies[*id]), gravity.as_slice(), "m/s²", f64::is_finite)?;
        }
        for (id, gains) in &change.body_gains {
            let numbers = gains.map(|Gains { p, i, d }| [p, i, d]).concat();
            in_range("gains", of_body(&self.bodies[*id]), &numbers, "finite numbers", f64::is_finite)?;
        }
        for (id, color) in &change.colors {
            in_range("colour", of_body(&self.bodies[*id]), color, "four numbers from 0 to 1", share)?;
        }
        self.check_joints(change)
    }

    fn check_joints(&self, change: &ParameterChange) -> Result<(), ParameterError> {
        let not_negative = |value: f64| value.is_finite() && value >= 0.0;
        for &(id, [low, high]) in &change.limits {
            let joint = &self.joints[id];
            let is_none = low == f64::NEG_INFINITY && high == f64::INFINITY;
            if !(is_none || low.is_finite() && high.is_finite() && low <= high) {
                let expected = "a lower limit that is not above the upper one, or -inf and inf for none";
                return Err(out_of_range("limits", joint.name.clone(), &[low, high], expected));
            }
            // What has no limits may keep having none.
            has_drive("limits", joint, is_none && joint.limits.is_none())?;
        }
        let of_joints = [("damping", &change.joint_dampings), ("friction", &change.joint_frictions)];
        for (quantity, values) in of_joints {
            for &(id, value) in values {
                let joint = &self.joints[id];
                in_range(quantity, joint.name.clone(), &[value], "0 or more", not_negative)?;
                has_drive(quantity, joint, value == 0.0)?;
            }
        }
        for &(id, Gains { p, i, d }) in &change.joint_gains {
            in_range("gains", self.joints[id].name.clone(), &[p, i, d], "finite numbers", f64::is_finite)?;
        }
        Ok(())
    }
}

fn has_drive(quantity: &'static str, joint: &Joint, is_unchanged: bool) -> Result<(), ParameterError> {
    match joint.joint_type.has_motor() || is_unchanged {
        true => Ok(()),
        false => Err(ParameterError::NoDrive { quantity, joint: joint.name.clone(), kind: joint.joint_type.name() }),
    }
}

fn is_static(body: &Body, quantity: &'static str) -> ParameterError {
    ParameterError::Static { quantity, body: of_body(body) }
}

fn of_body(body: &Body) -> String {
    body.identity.name.to_string()
}

fn in_range(
    quantity: &'static str,
    of: String,
    values: &[f64],
    expected: &'static str,
    is_possible: impl Fn(f64) -> bool,
) -> Result<(), ParameterError> {
    match values.iter().all(|value| is_possible(*value)) {
        true => Ok(()),
        false => Err(out_of_range(quantity, of, values, expected)),
    }
}

fn out_of_range(quantity: &'static str, of: String, values: &[f64], expected: &'static str) -> ParameterError {
    ParameterError::Range { quantity, of, value: values.to_vec(), expected }
}
