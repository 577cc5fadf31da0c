use bullet_sys as sys;

use super::{BodyHandle, World};

/// Parameters of the contact and constraint solver. Defaults are those of Bullet; factors are dimensionless.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolverSettings {
    /// Iterations in a sub-step, at least 1. Default: 10.
    pub iterations: u32,
    /// Islands are solved together until they have this number of constraints. Default: 128.
    pub minimum_batch_size: u32,
    /// Error reduction parameter (ERP) of joints without one of their own: share of the position error corrected in a
    /// sub-step. Default: 0.2.
    pub joint_erp: f64,
    /// ERP of contacts. Default: 0.2.
    pub contact_erp: f64,
    /// Constraint force mixing of contacts and of joints that have none of their own, (m/s)/N. Default: 0.
    pub global_cfm: f64,
    /// ERP of friction anchors. Default: 0.2.
    pub friction_erp: f64,
    /// Constraint force mixing of friction anchors, (m/s)/N. Default: 0.
    pub friction_cfm: f64,
    /// Penetration depth that is not corrected, m. Default: 0.
    pub linear_slop: f64,
    /// Share of the velocity error of a joint that is corrected. Default: 1.
    pub damping: f64,
    /// Successive over-relaxation factor. Default: 1.
    pub over_relaxation: f64,
    /// Iterations end when the squared velocity change of every row is at most this, (m/s)². Default: 0.
    pub residual_threshold: f64,
    /// Approach velocity below which contacts have no restitution, m/s. Default: 0.2 (rounded to single precision).
    pub restitution_velocity_threshold: f64,
    /// Share of the contact impulses of the last sub-step with which the solver is warm-started. Default: 0.85.
    pub warm_starting_factor: f64,
    /// Split impulse: penetration is corrected by pseudo-velocities, which do not change velocities. Default: `true`.
    pub split_impulse: bool,
    /// Contacts with a signed distance below this use split impulse, m. Default: −0.04 (rounded to single precision).
    pub split_impulse_penetration_threshold: f64,
    /// Share of the angular pseudo-velocity that is applied. Default: 0.1 (rounded to single precision).
    pub split_impulse_turn_erp: f64,
    /// Contacts are warm-started with the impulses of the last sub-step. Default: `true`.
    pub warm_starting: bool,
    /// Friction has two directions at each contact point. Default: `false`.
    pub two_friction_directions: bool,
    /// Friction keeps its directions from one sub-step to the next. Default: `false`.
    pub friction_direction_caching: bool,
    /// The first friction direction is that of sliding. Default: `true`.
    pub velocity_dependent_friction_direction: bool,
    /// Friction is solved directly after its contact, not after all contacts. Default: `false`.
    pub interleave_friction: bool,
    /// Friction on multi-bodies in two directions is limited by a cone, not a pyramid. Default: `true`.
    pub implicit_friction_cone: bool,
    /// Rows are solved in an order that changes from iteration to iteration. Default: `false`.
    pub randomise_order: bool,
}

/// Integration of the gyroscopic torque −ω × (I ω).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Gyroscopic {
    /// Not at all.
    None,
    /// Explicit Euler: it gains energy.
    Explicit,
    /// One Newton step of implicit Euler in world axes.
    ImplicitWorld,
    /// One Newton step of implicit Euler in the body's axes. The default.
    #[default]
    ImplicitBody,
}

impl Gyroscopic {
    /// The values that users can choose, with their names.
    pub const NAMES: [(&'static str, Self); 3] =
        [("none", Self::None), ("explicit", Self::Explicit), ("implicit", Self::ImplicitBody)];
}

/// A set of settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// The settings of a world of pybullet 3.2.7.
    PyBullet,
}

impl Preset {
    /// The settings of the preset; those that it does not define are taken from `settings`.
    pub fn apply(self, settings: SolverSettings) -> SolverSettings {
        match self {
            Self::PyBullet => SolverSettings {
                iterations: 50,
                minimum_batch_size: 0,
                contact_erp: 0.08,
                friction_erp: 0.2,
                linear_slop: 1e-5,
                warm_starting: true,
                warm_starting_factor: 0.1,
                residual_threshold: 1e-7,
                two_friction_directions: true,
                ..settings
            },
        }
    }
}

/// Maximum number of iterations, so that the duration of a sub-step is bounded.
const MAX_ITERATIONS: u32 = 100_000;

impl World {
    /// Present settings of the solver.
    pub fn solver_settings(&self) -> SolverSettings {
        let mut raw = sys::AmbSolverSettings::default();
        // SAFETY: the world is alive; one struct is written.
        unsafe { sys::amb_world_get_settings(self.raw.as_ptr(), &mut raw) }
        SolverSettings {
            iterations: raw.iterations.max(0) as u32,
            minimum_batch_size: raw.minimum_batch_size.max(0) as u32,
            joint_erp: raw.joint_erp,
            contact_erp: raw.contact_erp,
            global_cfm: raw.global_cfm,
            friction_erp: raw.friction_erp,
            friction_cfm: raw.friction_cfm,
            linear_slop: raw.linear_slop,
            damping: raw.damping,
            over_relaxation: raw.over_relaxation,
            residual_threshold: raw.residual_threshold,
            restitution_velocity_threshold: raw.restitution_velocity_threshold,
            warm_starting_factor: raw.warm_starting_factor,
            split_impulse: raw.split_impulse != 0,
            split_impulse_penetration_threshold: raw.split_impulse_penetration_threshold,
            split_impulse_turn_erp: raw.split_impulse_turn_erp,
            warm_starting: raw.warm_starting != 0,
            two_friction_directions: raw.two_friction_directions != 0,
            friction_direction_caching: raw.friction_direction_caching != 0,
            velocity_dependent_friction_direction: raw.velocity_dependent_friction_direction != 0,
            interleave_friction: raw.interleave_friction != 0,
            implicit_friction_cone: raw.implicit_friction_cone != 0,
            randomise_order: raw.randomise_order != 0,
        }
    }

    /// Changes the settings of the solver. Iterations are limited to 1 … 100 000.
    pub fn set_solver_settings(&mut self, settings: &SolverSettings) {
        let raw = sys::AmbSolverSettings {
            iterations: settings.iterations.clamp(1, MAX_ITERATIONS) as i32,
            minimum_batch_size: settings.minimum_batch_size.min(i32::MAX as u32) as i32,
            joint_erp: settings.joint_erp,
            contact_erp: settings.contact_erp,
            global_cfm: settings.global_cfm,
            friction_erp: settings.friction_erp,
            friction_cfm: settings.friction_cfm,
            linear_slop: settings.linear_slop,
            damping: settings.damping,
            over_relaxation: settings.over_relaxation,
            residual_threshold: settings.residual_threshold,
            restitution_velocity_threshold: settings.restitution_velocity_threshold,
            warm_starting_factor: settings.warm_starting_factor,
            split_impulse: settings.split_impulse.into(),
            split_impulse_penetration_threshold: settings.split_impulse_penetration_threshold,
            split_impulse_turn_erp: settings.split_impulse_turn_erp,
            warm_starting: settings.warm_starting.into(),
            two_friction_directions: settings.two_friction_directions.into(),
            friction_direction_caching: settings.friction_direction_caching.into(),
            velocity_dependent_friction_direction: settings.velocity_dependent_friction_direction.into(),
            interleave_friction: settings.interleave_friction.into(),
            implicit_friction_cone: settings.implicit_friction_cone.into(),
            randomise_order: settings.randomise_order.into(),
        };
        // SAFETY: the world is alive; the struct is read before the call returns.
        unsafe { sys::amb_world_set_settings(self.raw.as_ptr(), &raw) }
    }

    /// Whether the broad phase remembers the bounding boxes of moving bodies without Bullet's margin of 0.05 m. The
    /// order in which pairs are found, and with it the order in which contacts are solved, depends on it. Default:
    /// `false`.
    pub fn set_tight_bounds(&mut self, tight: bool) {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_set_tight_bounds(self.raw.as_ptr(), tight.into()) }
    }

    /// Chooses how the gyroscopic torque on a body is integrated.
    pub fn set_gyroscopic(&mut self, handle: BodyHandle, gyroscopic: Gyroscopic) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; the number is one of the shim's enum.
            unsafe { sys::amb_body_set_gyroscopic(body, gyroscopic as i32) }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::super::tests::ball;
    use super::super::{RigidBody, Solver};
    use super::*;

    #[test]
    fn defaults_are_bullets() {
        let settings = World::new(Solver::default()).solver_settings();
        assert_eq!((settings.iterations, settings.minimum_batch_size), (10, 128));
        assert_eq!((settings.joint_erp, settings.contact_erp, settings.warm_starting_factor), (0.2, 0.2, 0.85));
        assert_eq!(settings.restitution_velocity_threshold, f64::from(0.2f32));
        assert!(settings.split_impulse && settings.warm_starting && settings.velocity_dependent_friction_direction);
        assert!(settings.implicit_friction_cone && !settings.two_friction_directions && !settings.randomise_order);
    }

    #[test]
    fn what_is_set_is_read_again() {
        let mut world = World::new(Solver::default());
        let default = world.solver_settings();
        let other = SolverSettings {
            iterations: 7,
            minimum_batch_size: 1,
            joint_erp: 0.31,
            contact_erp: 0.32,
            global_cfm: 0.33,
            friction_erp: 0.34,
            friction_cfm: 0.35,
            linear_slop: 0.36,
            damping: 0.37,
            over_relaxation: 0.38,
            residual_threshold: 0.39,
            restitution_velocity_threshold: 0.41,
            warm_starting_factor: 0.42,
            split_impulse: false,
            split_impulse_penetration_threshold: 0.43,
            split_impulse_turn_erp: 0.44,
            warm_starting: false,
            two_friction_directions: true,
            friction_direction_caching: true,
            velocity_dependent_friction_direction: false,
            interleave_friction: true,
            implicit_friction_cone: false,
            randomise_order: true,
        };
        world.set_solver_settings(&other);
        assert_eq!(world.solver_settings(), other);
        world.set_solver_settings(&default);
        assert_eq!(world.solver_settings(), default);
        world.set_solver_settings(&SolverSettings { iterations: 0, ..default });
        assert_eq!(world.solver_settings(), SolverSettings { iterations: 1, ..default });
    }

    #[test]
    fn the_contact_correction_follows_its_factor() {
        let depth_after_a_step = |contact_erp: f64| {
            let mut world = World::new(Solver::default());
            let settings = SolverSettings { contact_erp, split_impulse: false, ..world.solver_settings() };
            world.set_solver_settings(&settings);
            world.add_body(ball(0.0, 0.0));
            let sunk = Isometry3::translation(0.19, 0.0, 0.0);
            let other = world.add_body(RigidBody { pose: sunk, ..ball(1.0, 0.0) });
            world.step(0.001, 1, 0.001);
            0.2 - world.pose(other).unwrap().translation.x
        };
        assert!((depth_after_a_step(0.25) - 0.0075).abs() < 1e-9, "{}", depth_after_a_step(0.25));
        assert!((depth_after_a_step(0.5) - 0.005).abs() < 1e-9, "{}", depth_after_a_step(0.5));
    }

    #[test]
    fn without_the_gyroscopic_torque_a_body_keeps_its_angular_velocity() {
        let turned = |gyroscopic: Gyroscopic| {
            let mut world = World::new(Solver::default());
            let body = world.add_body(RigidBody { inertia: Vector3::new(1.0, 2.0, 3.0), ..ball(1.0, 0.0) });
            world.set_gyroscopic(body, gyroscopic);
            let start = Vector3::new(1.0, 1.0, 0.0);
            world.set_velocity(body, &Vector3::zeros(), &start);
            for _ in 0..100 {
                world.step(0.001, 1, 0.001);
            }
            (world.velocity(body).unwrap().1 - start).norm()
        };
        assert!(turned(Gyroscopic::None) < 1e-12);
        // Euler's equation: w_z' = (I_x - I_y) w_x w_y / I_z = -1/3.
        for gyroscopic in [Gyroscopic::Explicit, Gyroscopic::ImplicitWorld, Gyroscopic::ImplicitBody] {
            assert!((turned(gyroscopic) - 0.1 / 3.0).abs() < 3e-3, "{gyroscopic:?} {}", turned(gyroscopic));
        }
    }
}
