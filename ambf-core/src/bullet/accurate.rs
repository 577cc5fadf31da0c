use bullet_sys as sys;

use super::{Solver, SolverSettings, World};

/// Switches of [`Solver::Accurate`], each of use alone. Worlds with another solver ignore them. The numbers were measured: see
/// `docs/benchmarks.md`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AccurateSettings {
    /// Friction ends with the normal impulse that bounds it; Bullet keeps the last one. Default: `true`.
    pub release_friction: bool,
    /// CFM of a joint, which Bullet takes for a share of the diagonal of its row, is also in what is divided by, which makes soft rows
    /// implicit; Bullet leaves it out. Default: `true`.
    pub diagonal_cfm: bool,
    /// Contacts bounce at the velocity that restitution asks for, whatever the gap or depth at that moment. Default: `true`.
    pub restitution: bool,
    /// Islands are solved directly where that is cheap. Default: `true`.
    pub direct: bool,
    /// Least softness of joint rows that are solved directly, as a share of the row's diagonal. Redundant rows then share the load.
    /// Default: 1e-11.
    pub joint_softness: f64,
    /// The same of contacts. Default: 1e-5.
    pub contact_softness: f64,
    /// The same of friction. Default: 1e-7.
    pub friction_softness: f64,
    /// Islands are hard that have joints or masses which differ by more than this factor. Default: 100.
    pub hard_mass_ratio: f64,
    /// Most multiplications of a factorisation, a row, of an island that is solved directly without being hard. Default: 500.
    pub max_cost: f64,
    /// The same of one that is hard. Default: 4000.
    pub max_hard_cost: f64,
    /// Most factorisations of block pivoting, and again of projected Gauss-Seidel with subspace minimisation, which follows on hard
    /// islands where pivoting cycles. Default: 20.
    pub max_rounds: u32,
}

impl Default for AccurateSettings {
    fn default() -> Self {
        Self {
            release_friction: true,
            diagonal_cfm: true,
            restitution: true,
            direct: true,
            joint_softness: 1e-11,
            contact_softness: 1e-5,
            friction_softness: 1e-7,
            hard_mass_ratio: 100.0,
            max_cost: 500.0,
            max_hard_cost: 4000.0,
            max_rounds: 20,
        }
    }
}

impl AccurateSettings {
    /// The settings of the solver that go with these: two friction directions, so that friction does not depend on the direction of
    /// sliding; joints that correct nearly all of their error in a sub-step. Iterations are for what is not solved directly, and five times as
    /// many for hard islands.
    pub fn solver_settings(settings: SolverSettings) -> SolverSettings {
        SolverSettings {
            iterations: 10,
            minimum_batch_size: 1,
            joint_erp: 0.9,
            residual_threshold: 1e-12,
            restitution_velocity_threshold: 0.05,
            two_friction_directions: true,
            ..settings
        }
    }
}

impl World {
    /// Changes the switches of [`Solver::Accurate`].
    pub fn set_accurate(&mut self, settings: &AccurateSettings) {
        let raw = sys::AmbAccurateSettings {
            release_friction: settings.release_friction.into(),
            diagonal_cfm: settings.diagonal_cfm.into(),
            restitution: settings.restitution.into(),
            direct: settings.direct.into(),
            joint_softness: settings.joint_softness,
            contact_softness: settings.contact_softness,
            friction_softness: settings.friction_softness,
            hard_mass_ratio: settings.hard_mass_ratio,
            max_cost: settings.max_cost,
            max_hard_cost: settings.max_hard_cost,
            max_rounds: settings.max_rounds.clamp(1, 1000) as i32,
        };
        // SAFETY: the world is alive; the struct is read before the call returns.
        unsafe { sys::amb_world_set_accurate(self.raw.as_ptr(), &raw) }
    }

    /// Switches and settings of a new world: those of its solver.
    pub(super) fn set_defaults(&mut self, solver: Solver) {
        if solver == Solver::Accurate {
            self.set_accurate(&AccurateSettings::default());
            self.set_solver_settings(&AccurateSettings::solver_settings(self.solver_settings()));
        }
    }
}
