//! Worlds of the same files have descriptions and shapes in common, and move as if they had not, to the last bit.

use std::path::{Path, PathBuf};

use ambf_core::comm::JointCommandType;
use ambf_core::control::Profile;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::{Simulation, Stepper};

fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources")
}

/// A world of a model file.
fn stepper(model: &Path, profile: Profile, savable: bool) -> Stepper {
    let files = SceneFiles { world: Some(resources().join("world/world.yaml")), models: vec![model.to_path_buf()] };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let options = SceneOptions { physics, savable, is_one_of_many: true, ..SceneOptions::default() };
    let Loaded { scene, report } = load(&files, &options);
    assert_eq!(report.errors(), 0, "{report}");
    Stepper::new(Simulation::new(scene, 0.001), 0.001)
}

/// Lets a world move under commands of its joints; poses and velocities at several moments, to the last bit.
fn motion(stepper: &mut Stepper) -> Vec<String> {
    let objects: Vec<_> = stepper.objects().entries().map(|(object, _)| object).collect();
    let mut seen = Vec::new();
    for round in 0..6 {
        for &object in &objects {
            if let Some(command) = stepper.body_command(object) {
                command.joint_commands = vec![0.1 * f64::from(round); 3];
                command.joint_command_types = vec![JointCommandType::Position; 3];
            }
        }
        stepper.step(50).expect("sound");
        // Debug text of numbers tells them apart by the last bit.
        seen.push(format!("{:?} {:?}", stepper.snapshot().bodies, stepper.snapshot().joint_velocities));
    }
    seen
}

#[test]
fn a_further_world_moves_as_the_first_and_as_one_that_shares_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["hanging_arm.urdf", "arm7.yaml", "free_bodies.yaml"] {
        let model = resources().join("models").join(name);
        for profile in [Profile::Legacy, Profile::Accurate] {
            let mut first = stepper(&model, profile, false);
            let mut further: Vec<_> = (0..3).map(|_| stepper(&model, profile, false)).collect();
            let description = |stepper: &Stepper| {
                stepper
                    .simulation()
                    .scene()
                    .models
                    .iter()
                    .last()
                    .map(|model| std::sync::Arc::as_ptr(&model.description))
            };
            assert!(further.iter().all(|world| description(world) == description(&first)), "{name}");
            let expected = motion(&mut first);
            for world in &mut further {
                assert_eq!(motion(world), expected, "{name}, {profile:?}");
            }
            drop((first, further));
            // All are gone: this one is read anew, from a file with another path.
            let copy = folder.path().join(name);
            let text = std::fs::read_to_string(&model).expect("a model");
            let meshes = format!("{}/meshes", resources().display());
            std::fs::write(&copy, text.replace("../meshes", &meshes)).expect("written");
            let mut alone = stepper(&copy, profile, false);
            assert_eq!(motion(&mut alone), expected, "{name}, {profile:?}");
        }
    }
}

#[test]
fn saved_states_of_a_further_world_are_what_those_of_the_first_are() {
    let model = resources().join("models/hanging_arm.urdf");
    let mut worlds: Vec<_> = (0..3).map(|_| stepper(&model, Profile::Accurate, true)).collect();
    let mut seen = Vec::new();
    for world in &mut worlds {
        motion(world);
        let state = world.save().expect("savable");
        let ahead = motion(world);
        world.restore(&state).expect("its own");
        assert_eq!(motion(world), ahead);
        seen.push(ahead);
    }
    assert!(seen.iter().all(|ahead| *ahead == seen[0]));
    let state = worlds[0].save().expect("savable");
    assert!(worlds[1].restore(&state).is_err(), "a state belongs to its world");
}
