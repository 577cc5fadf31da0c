//! Scenes that once failed, in `tests/regressions`: each is a model file that begins with a comment on what used
//! to happen, then lines `#> …` with its length and its commands (`benches/stability/random/script.rs` says how).
//! The search for failures, `scripts/bench stability --random N`, writes such files.

// Shared with the search, which uses more of it.

use ambf_bench::{follow, script};
use std::path::{Path, PathBuf};
use std::time::Duration;

use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

use follow::{follow, Outcome, Verdict};
use script::Script;

/// Far more CPU time than any of the scenes takes.
const PATIENCE: Duration = Duration::from_secs(120);

/// The model files, sorted.
fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/regressions");
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let paths = entries.map(|entry| entry.expect("the folder can be read").path());
    let mut scenes: Vec<_> = paths.filter(|path| path.extension().is_some_and(|ending| ending == "yaml")).collect();
    scenes.sort();
    scenes
}

/// The scene at time zero and what is done to it.
fn loaded(path: &Path, profile: Profile) -> (Simulation, Script) {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert!(text.starts_with("# "), "{} does not say what used to happen", path.display());
    let files = SceneFiles { world: None, models: vec![path.to_owned()] };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{}: {}", path.display(), loaded.report);
    let script = Script::parse(&text, &loaded.scene).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    (Simulation::new(loaded.scene, script.step), script)
}

fn run(path: &Path, profile: Profile) -> Outcome {
    let (mut simulation, script) = loaded(path, profile);
    follow(&mut simulation, &script, PATIENCE)
}

#[test]
fn mended_scenes_stay_mended() {
    let scenes = scenes();
    assert!(!scenes.is_empty());
    let failed = |path: &PathBuf| {
        let outcome = run(path, Profile::Accurate);
        (outcome.verdict != Verdict::Good).then(|| format!("{}: {outcome:?}", path.display()))
    };
    let failures: Vec<_> = scenes.iter().filter_map(failed).collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn every_scene_loads_in_both_profiles() {
    for path in scenes() {
        for profile in [Profile::Legacy, Profile::Accurate] {
            let (simulation, script) = loaded(&path, profile);
            assert!(script.span >= script.step, "{} has no sub-step", path.display());
            assert!(!simulation.scene().bodies.is_empty(), "{} has no body", path.display());
        }
    }
}
