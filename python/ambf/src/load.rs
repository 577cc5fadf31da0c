//! From arguments to a simulation.

use std::path::PathBuf;
use std::sync::Arc;

use ambf_core::adf::{Launch, PhysicsProfile, PhysicsSettings};
use ambf_core::control::Profile;
use ambf_core::plugin::{PluginSetup, Registry, Search};
use ambf_core::scene::{load, shared_launch, Loaded, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::{Simulation, Stepper, DEFAULT_SUB_STEP};
use ambf_core::text::has_entries;
use crtk::diagnostics::Board;
use crtk::transport::Connect;

/// Which scene, and how it is simulated.
#[derive(Clone)]
pub struct Wanted {
    pub models: Vec<PathBuf>,
    pub launch_file: Option<PathBuf>,
    pub world: Option<PathBuf>,
    /// Models of the launch file's list, from 0.
    pub indexes: Vec<usize>,
    pub profile: Option<String>,
    pub solver: Option<String>,
    pub integrator: Option<String>,
    pub iterations: Option<u32>,
    pub articulated: Option<bool>,
    pub sleep: Option<bool>,
    /// States can be saved.
    pub saving: bool,
    /// The wrenches of all joints are measured.
    pub wrenches: bool,
    /// Interval of an iteration, s.
    pub step: f64,
    pub plugins: Vec<PathBuf>,
    /// Configurations of arms for CRTK clients.
    pub crtk: Vec<PathBuf>,
    /// What differs from run to run is drawn from it.
    pub seed: Option<u64>,
}

/// What is loaded.
pub struct Made {
    pub stepper: Stepper,
    /// What is left out or guessed.
    pub warnings: Vec<String>,
    /// While it is kept, further worlds need not read the file.
    pub launch: Option<Arc<Launch>>,
    /// Arms for CRTK clients.
    pub arms: Board,
}

/// Loads the scene.
///
/// # Errors
/// One sentence for each file, element of a list or name that can't be used at all.
pub fn load_world(wanted: &Wanted) -> Result<Made, Vec<String>> {
    if !(wanted.step.is_finite() && wanted.step > 0.0 && wanted.step <= 1.0) {
        return Err(vec![format!("step={}: expected seconds, above 0 and at most 1", wanted.step)]);
    }
    let physics = physics(wanted).map_err(|problem| vec![problem])?;
    let mut warnings = Vec::new();
    let launch = match &wanted.launch_file {
        Some(path) => {
            let (launch, report) = shared_launch(path).map_err(|error| vec![error.to_string()])?;
            warnings.extend(lines(&report));
            Some(launch)
        }
        None => None,
    };
    let files = files(wanted, launch.as_deref())?;
    let options = SceneOptions {
        physics,
        default_profile: Some(Profile::Accurate),
        savable: wanted.saving,
        is_one_of_many: true,
        joint_wrenches: wanted.wrenches,
        ..SceneOptions::default()
    };
    let Loaded { scene, report } = load(&files, &options);
    if !report.refused.is_empty() {
        return Err(report.refused.iter().map(|problem| problem.trim_end().to_owned()).collect());
    }
    warnings.extend(report.files.iter().flat_map(|file| lines(&file.verbose())));
    warnings.extend(report.notes.iter().map(ToString::to_string));
    let sub_step = scene.sub_step.unwrap_or(DEFAULT_SUB_STEP.min(wanted.step));
    let (longest, count) = (f64::from(scene.max_sub_steps) * sub_step, wanted.step / sub_step);
    if (count - count.round()).abs() > 1e-9 * count {
        warnings.push(format!(
            "step={} is not a whole number of sub-steps of {sub_step} s: their number changes from iteration to iteration, see `physics: \
             sub step` of the world",
            wanted.step
        ));
    }
    if wanted.step > longest * (1.0 + 1e-9) {
        let problem = "is simulated in an iteration, the rest of step";
        warnings
            .push(format!("at most {longest} s {problem}={} is lost: see `max iterations` of the world", wanted.step));
    }
    let mut simulation = Simulation::new(scene, sub_step);
    let (mut registry, arms) = (Registry::default(), Board::local());
    let without: Connect = Arc::new(|| Ok(Vec::new()));
    let mut plugins = wanted.plugins.clone();
    plugins.extend(crtk::plugin::register(&mut registry, &wanted.crtk, &without, &arms, wanted.seed));
    drill::register(&mut registry);
    let setup = PluginSetup {
        registry,
        search: Search::from_environment(),
        arguments: vec!["python".into()],
        command_line: plugins,
        launch: launch.as_ref().map(|launch| launch.plugins.clone()).unwrap_or_default(),
    };
    let problems = simulation.load_plugins(setup).problems;
    if !wanted.crtk.is_empty() && arms.topics().is_empty() {
        // Somebody who asks for arms can do nothing without.
        return Err(problems);
    }
    warnings.extend(problems);
    let stepper = Stepper::new(simulation, wanted.step);
    match stepper.lost() {
        Some(problem) => Err(vec![problem.to_string()]),
        None => Ok(Made { stepper, warnings, launch, arms }),
    }
}

fn lines(report: &impl ToString) -> Vec<String> {
    report.to_string().lines().map(str::to_owned).collect()
}

fn files(wanted: &Wanted, launch: Option<&Launch>) -> Result<SceneFiles, Vec<String>> {
    let listed = launch.and_then(|launch| launch.multibody_configs.as_deref()).unwrap_or_default();
    let mut models = wanted.models.clone();
    for &index in &wanted.indexes {
        let missing =
            || vec![format!("there is no model {index}: the launch file's list {}", has_entries(listed.len()))];
        models.push(listed.get(index).ok_or_else(missing)?.clone());
    }
    let world = wanted.world.clone().or_else(|| launch.and_then(|launch| launch.world_config.clone()));
    Ok(SceneFiles { world, models })
}

fn physics(wanted: &Wanted) -> Result<PhysicsOptions, String> {
    let unknown = |what: &str, name: &str, known: &str| format!("{what}={name:?}: not known, expected one of {known}");
    let profile = |name: &String| {
        let known = PhysicsProfile::NAMES.map(|(name, _)| name).join(", ");
        PhysicsProfile::from_name(name).ok_or_else(|| unknown("profile", name, &known))
    };
    let chosen = PhysicsSettings {
        profile: wanted.profile.as_ref().map(profile).transpose()?,
        solver: wanted.solver.clone(),
        integrator: wanted.integrator.clone(),
        iterations: wanted.iterations,
        articulated: wanted.articulated,
        sleep: wanted.sleep,
        ..PhysicsSettings::default()
    };
    if wanted.iterations == Some(0) {
        return Err("iterations=0: expected 1 or more".into());
    }
    let mut problem = None;
    let physics = PhysicsOptions::new(&chosen, |what, name, known| {
        problem.get_or_insert(unknown(what, name, known));
    });
    problem.map_or(Ok(physics), Err)
}
