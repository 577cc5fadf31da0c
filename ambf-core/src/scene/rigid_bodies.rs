//! Builds rigid bodies, and says which of them never collide.

use nalgebra::Isometry3;

use super::body::Body;
use super::build::Builder;
use super::targets::BodyTarget;
use crate::adf::{self, CollisionGeometry, Severity};
use crate::bullet;
use crate::comm::CartesianCommandType;
use crate::control::{CartesianController, Profile};
use crate::ids::BodyId;

/// Least principal moment of what collides, as a share of that of a solid body of its shape.
const MIN_INERTIA: f64 = 0.01;

/// Displacements of collision meshes below this are not worth a line, m.
const MIN_DISPLACEMENT: f64 = 1e-5;

/// Coefficient of rolling friction of a body of which the file says nothing about it. That of the C++ program is a lever of 10 mm
/// for a ball of any size, which then lies still on slopes.
fn default_rolling_friction(profile: Profile) -> f64 {
    match profile {
        Profile::Legacy => 0.01,
        Profile::Accurate => 0.0,
    }
}

impl Builder<'_> {
    /// `index`: of the body in the model's list.
    pub(super) fn add_body(&mut self, index: usize, body: &adf::RigidBody, model: &adf::Model) -> Option<BodyId> {
        let source = &body.common.source;
        let (built, shared) = match self.built_shape(index, body) {
            Ok(built) => built,
            Err(error) => {
                self.drop_element(&body.common, error);
                return None;
            }
        };
        for (severity, message) in &built.left_out {
            self.note(*severity, source, format!("`{}`: {message}", body.common.identifier));
        }
        self.note_displacement(body, &built.inertial_offset);

        let estimate = || match &shared {
            Some(shared) => shared.inertia(body.mass, || built.shape.inertia(body.mass)),
            None => built.shape.inertia(body.mass),
        };
        let inertia = body.inertia.unwrap_or_else(|| {
            if body.mass > 0.0 {
                // An extent whose square underflows doesn't turn.
                estimate().map(|moment| if moment.recip().is_finite() { moment } else { 0.0 })
            } else {
                nalgebra::Vector3::zeros()
            }
        });
        let inertia = self.bounded_inertia(body, inertia, estimate);
        let initial_pose = body.location * built.inertial_offset;
        let gravity = body.gravity.or(model.gravity);
        let index = self.scene.bodies.next_id().index();
        let surface = bullet::BodySurface {
            friction: body.surface.static_friction,
            rolling_friction: body.surface.rolling_friction.unwrap_or(default_rolling_friction(self.scene.profile)),
            restitution: body.surface.restitution,
        };
        let damping = [body.surface.linear_damping, body.surface.angular_damping];
        let rigid = bullet::RigidBody {
            mass: body.mass,
            inertia,
            shape: built.shape,
            pose: initial_pose,
            friction: surface.friction,
            rolling_friction: surface.rolling_friction,
            restitution: surface.restitution,
            linear_damping: damping[0],
            angular_damping: damping[1],
            gravity,
        };
        if body.mass > 0.0 && body.inertia.is_none() && inertia == nalgebra::Vector3::zeros() {
            let message = format!(
                "`{}` has no inertia (none is given, and there is no collision shape to estimate one from), so that \
                 it cannot turn; give `inertia`",
                body.common.identifier
            );
            self.note(Severity::Warning, source, message);
        }
        let keeps_apart = model.ignore_inter_collision && !body.self_collision;
        let apart = bullet::Apart {
            family: if keeps_apart { self.model.index() as u32 + 1 } else { 0 },
            groups: &body.collision_groups,
            filter: body.collision_filter.as_ref().map(|filter| (self.model.index() as u32 + 1, filter)),
        };
        let handle = self.scene.world.add_body_apart(index, rigid, apart);
        self.set_continuous(body, handle);
        self.scene.world.set_gyroscopic(handle, self.scene.gyroscopic);
        let controller = body.controller.unwrap_or_default();
        let identity = self.identity(&body.common, |scene| &scene.bodies.names);
        let id = self.scene.bodies.push(Body {
            identity,
            mass: body.mass,
            inertia,
            inertial_offset: built.inertial_offset,
            inertial_offset_inverse: built.inertial_offset.inverse(),
            initial_pose,
            gravity,
            surface,
            damping,
            color: None,
            scale: body.scale,
            collision_groups: body.collision_groups.clone(),
            publish_children_names: body.publish_children_names,
            publish_joint_names: body.publish_joint_names,
            publish_joint_positions: body.publish_joint_positions,
            source: source.clone(),
            removed: false,
            handle,
            control: CartesianCommandType::Force,
            target: BodyTarget::new(&controller.linear, &controller.angular),
            controller: CartesianController::new(controller.linear, controller.angular),
        });
        self.scene.graph.grow(self.scene.bodies.len());
        Some(id)
    }

    /// What collides far out but turns like a point is shot away by any contact: one step cannot follow it. Zero
    /// moments, which don't turn, stay.
    fn bounded_inertia(
        &mut self,
        body: &adf::RigidBody,
        inertia: nalgebra::Vector3<f64>,
        estimate: impl FnOnce() -> nalgebra::Vector3<f64>,
    ) -> nalgebra::Vector3<f64> {
        if self.scene.profile != Profile::Accurate || body.mass <= 0.0 || body.inertia.is_none() {
            return inertia;
        }
        let least = estimate() * MIN_INERTIA;
        let bounded = inertia.zip_map(&least, |moment, least| if moment > 0.0 { moment.max(least) } else { moment });
        if bounded != inertia {
            let message = format!(
                "`{}`: `inertia` is less than {MIN_INERTIA} times that of a solid body of its collision shape, which contacts cannot stand; \
                 that is taken",
                body.common.identifier
            );
            self.note(Severity::Warning, &body.common.source, message);
        }
        bounded
    }

    /// Continuous collision detection: on request, or where the accurate profile can.
    fn set_continuous(&mut self, body: &adf::RigidBody, handle: bullet::BodyHandle) {
        let wanted = body.continuous_collision.unwrap_or(self.scene.profile == Profile::Accurate);
        if body.mass == 0.0 || !wanted || self.scene.world.set_continuous(handle, true) {
            return;
        }
        if body.continuous_collision == Some(true) {
            let message = format!(
                "`{}`: `continuous collision` is not possible: its shape is concave or empty, or its centre of mass lies outside",
                body.common.identifier
            );
            self.note(Severity::Warning, &body.common.source, message);
        }
    }

    fn note_displacement(&mut self, body: &adf::RigidBody, offset: &Isometry3<f64>) {
        let distance = offset.translation.vector.norm();
        if matches!(body.collision, CollisionGeometry::Mesh { .. })
            && body.inertial_offset.is_none()
            && distance >= MIN_DISPLACEMENT
        {
            let message = format!(
                "`{}` has no `inertial offset`: its centre of mass is taken from the collision mesh; the C++ program then collides \
                 with the mesh displaced by {} m, here it stays where it is drawn",
                body.common.identifier,
                three_digits(distance)
            );
            self.note(Severity::Warning, &body.common.source, message);
        }
    }
}

/// A positive number below a million with three significant digits, without an exponent.
fn three_digits(number: f64) -> String {
    let digits = (2.0 - number.log10().floor()).clamp(0.0, 12.0);
    format!("{number:.*}", digits as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_shown_with_three_digits() {
        for (number, text) in [(0.3143, "0.314"), (0.003_677, "0.00368"), (1.234e-5, "0.0000123"), (12.0, "12.0")] {
            assert_eq!(three_digits(number), text);
        }
        assert_eq!((three_digits(0.0), three_digits(1e300).len()), ("0.000000000000".into(), 301));
    }
}
