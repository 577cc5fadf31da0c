//! From the scene options of a command line to the files of a scene.

use std::path::{Path, PathBuf};

use ambf_core::adf::{self, Launch, LoadError, PhysicsSettings, Report};
use ambf_core::scene::{PhysicsOptions, SceneFiles};
use ambf_core::text::has_entries;
use thiserror::Error;

use crate::cli;

/// Error when a launch file is of no use: the simulator then ends with exit status 255.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LaunchError {
    /// Error when it cannot be read.
    #[error("launch file {0}")]
    Load(#[from] LoadError),
    /// Error when a required key is missing.
    #[error("launch file {}: `{key}` is missing, expected {expected}", file.display())]
    Missing {
        /// The launch file.
        file: PathBuf,
        /// The key.
        key: &'static str,
        /// What it should hold.
        expected: &'static str,
    },
}

/// Reads a launch file; all four of its keys must be there.
///
/// # Errors
/// [`LaunchError`].
pub fn read_strict(file: &Path) -> Result<(Launch, Report), LaunchError> {
    let (launch, report) = adf::load::<Launch>(file)?;
    let missing = |key, expected| LaunchError::Missing { file: file.to_owned(), key, expected };
    if launch.world_config.is_none() {
        return Err(missing("world config", "the path of a world file"));
    }
    if launch.color_config.is_none() {
        return Err(missing("color config", "the path of a colour file"));
    }
    if launch.input_devices_config.is_none() {
        return Err(missing("input devices config", "the path of a file of input devices"));
    }
    if launch.multibody_configs.is_none() {
        return Err(missing("multibody configs", "a list of paths of model files"));
    }
    Ok((launch, report))
}

/// The files of a scene: `model_files` first, then the launch file's models at `indexes`. Indexes beyond the list are
/// returned as one sentence each.
pub fn scene_files(
    launch: Option<&Launch>,
    world: Option<&Path>,
    model_files: &[PathBuf],
    indexes: &[usize],
) -> (SceneFiles, Vec<String>) {
    let listed = launch.and_then(|launch| launch.multibody_configs.as_deref()).unwrap_or_default();
    let mut problems = Vec::new();
    let mut models = model_files.to_vec();
    for &index in indexes {
        match listed.get(index) {
            Some(path) => models.push(path.clone()),
            None => problems.push(format!(
                "there is no model {index}: the launch file's list {}; it is skipped",
                has_entries(listed.len())
            )),
        }
    }
    let world = world.map(Path::to_owned).or_else(|| launch.and_then(|launch| launch.world_config.clone()));
    (SceneFiles { world, models }, problems)
}

/// The physics that a command line asks for.
///
/// # Errors
/// The sentence that says which name is not known.
pub fn physics(options: &cli::PhysicsOptions) -> Result<PhysicsOptions, String> {
    let cli::PhysicsOptions { profile, solver, iterations, integrator, sleep, articulated } = options.clone();
    let chosen =
        PhysicsSettings { profile, solver, iterations, integrator, sleep, articulated, ..PhysicsSettings::default() };
    let mut problem = None;
    let physics = PhysicsOptions::new(&chosen, |option, name, known| {
        problem.get_or_insert(format!("--{option} {name}: not known, expected one of {known}"));
    });
    problem.map_or(Ok(physics), Err)
}

#[cfg(test)]
mod tests {
    use ambf_core::bullet::Integrator;

    use super::*;

    fn launch(text: &str) -> Launch {
        adf::parse::<Launch>(text, Path::new("/scenes/launch.yaml")).unwrap().0
    }

    #[test]
    fn files_come_before_indexes_and_wrong_indexes_are_named() {
        let launch = launch("world config: w.yaml\nmultibody configs: [a.yaml, b.yaml]\n");
        let (files, problems) = scene_files(Some(&launch), None, &["c.yaml".into()], &[1, 99, 1]);
        assert_eq!(files.world.as_deref(), Some(Path::new("/scenes/w.yaml")));
        let expected: Vec<PathBuf> = ["c.yaml", "/scenes/b.yaml", "/scenes/b.yaml"].map(PathBuf::from).into();
        assert_eq!(files.models, expected);
        assert_eq!(problems, ["there is no model 99: the launch file's list has 2 (0 to 1); it is skipped"]);
        let (_, problems) = scene_files(None, None, &[], &[0]);
        assert_eq!(problems, ["there is no model 0: the launch file's list is empty; it is skipped"]);
    }

    #[test]
    fn another_world_replaces_the_launch_files() {
        let launch = launch("world config: w.yaml\nmultibody configs: []\n");
        let (files, _) = scene_files(Some(&launch), Some(Path::new("own.yaml")), &[], &[]);
        assert_eq!(files.world.as_deref(), Some(Path::new("own.yaml")));
    }

    #[test]
    fn unknown_solvers_are_refused_with_what_is_known() {
        let options = cli::PhysicsOptions { solver: Some("magic".into()), ..Default::default() };
        assert!(physics(&options).unwrap_err().contains("dantzig"));
        let options = cli::PhysicsOptions { integrator: Some("ballistic".into()), ..Default::default() };
        assert_eq!(physics(&options).unwrap().integrator, Some(Integrator::Ballistic));
    }
}
