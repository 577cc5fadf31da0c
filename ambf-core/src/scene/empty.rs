//! A world without objects, as the world file and the options want its physics.

use std::sync::Arc;

use super::{Note, PhysicsOptions, Scene, SceneOptions};
use crate::adf::{self, Severity};
use crate::bullet::{Integrator, Preset, Solver, SolverSettings, World, WorldKind};
use crate::control::Profile;

/// Share of the position error of joints that profile `accurate` corrects in a sub-step: the joint gap is proportional
/// to its inverse, and with 1 rounding errors of redundant loops begin to show.
const ACCURATE_JOINT_ERP: f64 = 0.9;

/// What the models of a scene want of the coordinates of their joints, as far as the options say nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum JointCoordinates {
    /// None of them can be reduced.
    Full,
    /// Reduced in the profile that does so.
    ReducedByProfile,
    /// The same, and reduced in models with links without a mass, whatever the profile: rows between bodies, of which one is ten
    /// thousand times as heavy as the other, give way.
    ReducedWhereNeeded,
}

/// A scene without objects.
pub(super) fn empty_scene(
    world: Arc<adf::World>,
    options: &SceneOptions,
    has_soft_bodies: bool,
    joints: JointCoordinates,
    notes: &mut Vec<Note>,
) -> Scene {
    let physics = physics(&world, &options.physics, notes);
    let profile = physics.profile.or(options.default_profile).unwrap_or_default();
    let (solver, integrator) = match (physics.preset, profile) {
        (Some(Preset::PyBullet), _) => (Solver::SequentialImpulse, Integrator::Euler),
        (None, Profile::Legacy) => (Solver::WarmFriction, Integrator::Euler),
        (None, Profile::Accurate) => (Solver::Accurate, Integrator::RungeKutta),
    };
    let solver = physics.solver.unwrap_or(solver);
    let source = &world.common.source;
    let mut warn =
        |message| notes.push(Note { severity: Severity::Warning, source: source.clone(), message, wanted: None });
    let articulates_all = joints != JointCoordinates::Full
        && physics.articulated.unwrap_or(profile == Profile::Accurate && solver == Solver::Accurate);
    let may_articulate =
        articulates_all || (joints == JointCoordinates::ReducedWhereNeeded && physics.articulated.is_none());
    if may_articulate && physics.solver.is_some_and(|solver| solver != Solver::Accurate) {
        // Only two of the solvers know rows of trees.
        warn(format!(
            "solver {} knows no joints in reduced coordinates: sequential impulses solve what touches or ends there",
            solver.name()
        ));
    }
    // The error reduction of joints in files is that of the C++ program: a tenth.
    let accurate = profile == Profile::Accurate && physics.preset.is_none();
    let joint_erp = physics.joint_erp.or(accurate.then_some(ACCURATE_JOINT_ERP));
    let kind = match (has_soft_bodies, may_articulate) {
        (true, _) => WorldKind::Soft,
        (false, true) => WorldKind::Articulated,
        (false, false) => WorldKind::Rigid,
    };
    let savable = options.savable.then(|| World::savable(solver, kind));
    if matches!(savable, Some(None)) {
        warn("states cannot be saved: the process may have no more address space (`ulimit -v`)".into());
    }
    let manifolds = if options.is_one_of_many { 8 } else { World::MANIFOLDS };
    let mut bullet = savable.flatten().unwrap_or_else(|| World::with_room(solver, kind, manifolds));
    bullet.set_integrator(physics.integrator.unwrap_or(integrator));
    bullet.set_trees_by_euler(physics.integrator == Some(Integrator::Euler));
    bullet.set_lag(profile == Profile::Legacy && physics.preset.is_none());
    if let Some(preset) = physics.preset {
        bullet.set_solver_settings(&preset.apply(bullet.solver_settings()));
        bullet.set_tight_bounds(true);
    } else if profile == Profile::Accurate {
        bullet.freeze_static_aabbs();
        bullet.set_exact_rays(true);
    }
    if physics.sleep == Some(true) && !bullet.enable_sleeping() {
        warn("`physics / sleep`: in a scene with soft bodies nothing sleeps".into());
    }
    if let Some(joint_erp) = joint_erp {
        // Some constraints have no error reduction of their own.
        bullet.set_solver_settings(&SolverSettings { joint_erp, ..bullet.solver_settings() });
    }
    bullet.set_gravity(world.gravity);
    if let Some(iterations) = physics.iterations {
        bullet.set_iterations(iterations);
    }
    Scene {
        namespace: format!("{}{}", options.prefix, world.common.namespace),
        world_rates: options.rates.unwrap_or_default(),
        gravity: world.gravity,
        max_sub_steps: world.max_iterations.max(1),
        sub_step: physics.sub_step,
        profile,
        preset: physics.preset,
        joint_erp,
        articulates_all,
        gyroscopic: physics.gyroscopic.unwrap_or_default(),
        kinematic_bodies: physics.kinematic_bodies.unwrap_or(profile == Profile::Accurate || physics.preset.is_some()),
        ..Scene::empty(bullet, world, options)
    }
}

/// The options, completed by the world file.
fn physics(world: &adf::World, options: &PhysicsOptions, notes: &mut Vec<Note>) -> PhysicsOptions {
    options.or(PhysicsOptions::new(&world.physics, |key, name, known| {
        let message = format!("`physics / {key}`: `{name}` is not known, expected one of {known}");
        notes.push(Note { severity: Severity::Error, source: world.common.source.clone(), message, wanted: None });
    }))
}
