//! Saved states: what is restored goes on as it did, bit for bit.

use std::hash::{DefaultHasher, Hasher};
use std::time::{Duration, Instant};

use crate::saved_common::*;
use ambf_core::bullet::Solver;
use ambf_core::comm::ActuatorCommand;
use ambf_core::control::Profile;
use ambf_core::ids::{ActuatorId, SoftBodyId};
use ambf_core::scene::{PhysicsOptions, PreparedModel, SceneFiles};
use ambf_core::sim::{SavedState, Simulation, StateError};
use ambf_test_support::legacy;
use nalgebra::Vector3;

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

fn physics(profile: Profile) -> PhysicsOptions {
    PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() }
}

#[test]
fn every_shipped_scene_goes_on_as_it_did() {
    for files in all_shipped() {
        for profile in PROFILES {
            assert!(check(&format!("{} {profile:?}", scene_name(&files)), &files, physics(profile), 100, 200));
        }
    }
}

#[test]
fn every_solver_goes_on_as_it_did() {
    for solver in [
        Solver::SequentialImpulse,
        Solver::Nncg,
        Solver::Dantzig,
        Solver::ProjectedGaussSeidel,
        Solver::Lemke,
        Solver::WarmFriction,
        Solver::Accurate,
    ] {
        for name in ["stack.yaml", "joints.yaml", "chain.yaml"] {
            let physics = PhysicsOptions { solver: Some(solver), ..physics(Profile::Legacy) };
            // Not every method can deal with what is commanded here.
            let finite = check(&format!("{name} {solver:?}"), &shipped(name), physics, 60, 60);
            assert!(finite || name != "stack.yaml", "{solver:?}");
        }
    }
    for name in ["arm7.yaml", "four_bar.yaml", "gripper.yaml"] {
        for articulated in [false, true] {
            let physics = PhysicsOptions { articulated: Some(articulated), ..physics(Profile::Accurate) };
            assert!(check(&format!("{name}, articulated: {articulated}"), &shipped(name), physics, 100, 100));
        }
    }
}

#[test]
fn several_models_that_touch_go_on_as_they_did() {
    let models = ["gripper.yaml", "arm7.yaml", "car.yaml", "stack.yaml", "ghost.yaml", "cloth.yaml"];
    let all = |models: &[&str]| SceneFiles {
        world: shipped("stack.yaml").world,
        models: models.iter().map(|name| resources().join("models").join(name)).collect(),
    };
    for profile in PROFILES {
        assert!(check(&format!("rigid {profile:?}"), &all(&models[..5]), physics(profile), 150, 150));
        assert!(check(&format!("with a cloth {profile:?}"), &all(&models), physics(profile), 150, 150));
    }
}

/// A cloth that falls on a ball and a plane, drops off and slides away: pieces of the plane come and go.
#[test]
fn soft_bodies_in_contact_go_on_as_they_did() {
    for profile in PROFILES {
        let mut simulation = simulation(&shipped("cloth.yaml"), profile);
        let mut saved: Vec<(SavedState, u32)> = Vec::new();
        for step in 0..12 {
            saved.push((simulation.save().expect("savable"), 100 * step));
            run(&mut simulation, 100 * step, 100 * (step + 1));
        }
        let mut expected = Vec::new();
        for (state, begin) in &saved {
            simulation.restore(state).expect("of this simulation");
            expected.push(run(&mut simulation, *begin, begin + 150));
        }
        // The other way round, so that what is left behind is always another thing.
        for ((state, begin), expected) in saved.iter().zip(expected).rev() {
            simulation.restore(state).expect("of this simulation");
            assert_eq!(run(&mut simulation, *begin, begin + 150), expected, "{profile:?} from {begin}");
        }
    }
}

#[test]
fn sleeping_bodies_sleep_on_and_wake_as_they_did() {
    let physics = PhysicsOptions { sleep: Some(true), ..physics(Profile::Accurate) };
    let mut simulation = simulation_with(&shipped("stack.yaml"), physics, true);
    for _ in 0..4000 {
        simulation.update(DT).expect("finite");
    }
    let asleep = |simulation: &Simulation| {
        let world = &simulation.scene().world;
        world.bodies().iter().filter(|&&body| world.is_asleep(body) == Some(true)).count()
    };
    let sleepers = asleep(&simulation);
    assert!(sleepers > 0);
    let saved = simulation.save().expect("savable");
    let first = run(&mut simulation, 0, 300);
    assert!(asleep(&simulation) < sleepers, "commands wake them");
    simulation.restore(&saved).expect("of this simulation");
    assert_eq!(asleep(&simulation), sleepers);
    assert_eq!(run(&mut simulation, 0, 300), first);
}

#[test]
fn states_of_several_times_live_side_by_side() {
    for name in ["gripper.yaml", "boxes200.yaml"] {
        let mut simulation = simulation(&shipped(name), Profile::Accurate);
        run(&mut simulation, 0, 80);
        let early = simulation.save().expect("savable");
        let to_late = run(&mut simulation, 80, 160);
        let late = simulation.save().expect("savable");
        let after_late = run(&mut simulation, 160, 240);
        // Another future of the early state, with a state in it.
        simulation.restore(&early).expect("of this simulation");
        run(&mut simulation, 500, 560);
        let other = simulation.save().expect("savable");
        let after_other = run(&mut simulation, 560, 640);
        for _ in 0..2 {
            simulation.restore(&late).expect("of this simulation");
            assert_eq!(run(&mut simulation, 160, 240), after_late, "{name}");
            simulation.restore(&other).expect("of this simulation");
            assert_eq!(run(&mut simulation, 560, 640), after_other, "{name}");
            simulation.restore(&early).expect("of this simulation");
            assert_eq!(run(&mut simulation, 80, 160), to_late, "{name}");
            assert_eq!(run(&mut simulation, 160, 240), after_late, "{name}");
        }
    }
}

#[test]
fn states_belong_to_their_simulation_and_its_objects() {
    let files = shipped("gripper.yaml");
    let mut simulation = simulation(&files, Profile::Legacy);
    let mut twin = crate::saved_common::simulation(&files, Profile::Legacy);
    let mut plain = simulation_with(&files, physics(Profile::Legacy), false);
    assert_eq!(plain.save().err(), Some(StateError::NotSavable));
    let saved = simulation.save().expect("savable");
    assert_eq!(twin.restore(&saved), Err(StateError::OtherSimulation));
    assert_eq!(plain.restore(&saved), Err(StateError::NotSavable));
    let before = run(&mut twin, 0, 50);
    assert_eq!(run(&mut simulation, 0, 50), before);

    let guest = || PreparedModel::read(&resources().join("models/pendulum.yaml")).expect("a model");
    let key = simulation.add_model(guest()).expect("something is built").key;
    assert_eq!(simulation.restore(&saved), Err(StateError::Changed));
    run(&mut simulation, 50, 100);
    let with_guest = simulation.save().expect("savable");
    let after = run(&mut simulation, 100, 150);
    simulation.restore(&with_guest).expect("of this simulation");
    assert_eq!(run(&mut simulation, 100, 150), after, "what was added later is saved too");
    simulation.remove_model(&key).expect("it is there");
    assert_eq!(simulation.restore(&saved), Err(StateError::Changed), "another history");
    assert_eq!(simulation.restore(&with_guest), Err(StateError::Changed));
    run(&mut simulation, 150, 200);
    let without = simulation.save().expect("savable");
    let after = run(&mut simulation, 200, 250);
    simulation.restore(&without).expect("of this simulation");
    assert_eq!(run(&mut simulation, 200, 250), after);

    // One camera has the place of another, of which Bullet knows nothing.
    let folder = tempfile::tempdir().expect("a folder");
    let camera = |name: &str| {
        let file = folder.path().join(format!("{name}.yaml"));
        let text = "cameras: [C]\nC: {name: C, location: {x: 1, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}}\n";
        std::fs::write(&file, text).expect("written");
        PreparedModel::read(&file).expect("a model")
    };
    let key = simulation.add_model(camera("one")).expect("something is built").key;
    let with_camera = simulation.save().expect("savable");
    simulation.remove_model(&key).expect("it is there");
    simulation.add_model(camera("other")).expect("something is built");
    assert_eq!(simulation.restore(&with_camera), Err(StateError::Changed));
}

#[test]
fn simulations_in_many_threads_do_not_mix() {
    let expected = run(&mut simulation(&shipped("gripper.yaml"), Profile::Accurate), 0, 150);
    std::thread::scope(|scope| {
        for i in 0..4 {
            scope.spawn(move || {
                let mut simulation = simulation(&shipped("gripper.yaml"), Profile::Accurate);
                let start = simulation.save().expect("savable");
                run(&mut simulation, 7 * i, 7 * i + 60);
                simulation.restore(&start).expect("of this simulation");
                // A simulation and its states may go to another thread.
                let handed = std::thread::spawn(move || {
                    let first = run(&mut simulation, 0, 150);
                    simulation.restore(&start).expect("of this simulation");
                    (first, run(&mut simulation, 0, 150))
                });
                assert_eq!(handed.join().expect("no panic"), (expected, expected));
            });
        }
    });
}

#[test]
fn saving_and_restoring_are_cheap() {
    for (name, most_time, most_size) in
        [("pendulum.yaml", 1.0, 1 << 18), ("gripper.yaml", 1.0, 1 << 19), ("boxes200.yaml", 20.0, 1 << 24)]
    {
        let mut simulation = simulation(&shipped(name), Profile::Accurate);
        run(&mut simulation, 0, 200);
        let saved = simulation.save().expect("savable");
        let least = |mut work: Box<dyn FnMut() + '_>| {
            let once = |_| {
                let begin = Instant::now();
                work();
                begin.elapsed()
            };
            (0..50).map(once).min().unwrap_or(Duration::MAX).as_secs_f64() * 1e3
        };
        let saving = least(Box::new(|| drop(simulation.save())));
        let restoring = least(Box::new(|| simulation.restore(&saved).expect("of this simulation")));
        println!("{name}: {} kB, saved in {saving:.3} ms, restored in {restoring:.3} ms", saved.size() / 1000);
        assert!(saved.size() < most_size, "{name}: {} bytes", saved.size());
        assert!(saving < most_time && restoring < most_time, "{name}: {saving} ms, {restoring} ms");
    }
}

#[test]
fn legacy_scenes_go_on_as_they_did() {
    let Some(folder) = legacy() else { return };
    let folder = folder.join("descriptions");
    let scenes = [
        "robots/blender-psm.yaml",
        "robots/blender-toy-car.yaml",
        "robots/blender-pr2-springy.yaml",
        "robots/resistive_sensor/resistive_sensor1.yaml",
        "puzzles/puzzle1.yaml",
        "sb/cloth2.yaml",
        "grippers/resistive/two_fists/gripper.yaml",
    ];
    for scene in scenes {
        let files = SceneFiles {
            world: Some(folder.join("world/world.yaml")),
            models: vec![folder.join("multi-bodies").join(scene)],
        };
        for profile in PROFILES {
            assert!(check(&format!("{scene} {profile:?}"), &files, physics(profile), 60, 60));
        }
    }
}

/// What is held when a state is saved is held after it was restored, and what was taken since is let go.
#[test]
fn grips_come_and_go_with_the_states() {
    for profile in PROFILES {
        let mut simulation = simulation(&shipped("gripper.yaml"), profile);
        let hold = |simulation: &mut Simulation, actuate: bool| {
            let scene = simulation.scene();
            let heavy = scene.bodies.iter().rev().find(|body| body.mass > 0.0).expect("a dynamic body");
            let body_name = heavy.identity.key();
            let command = ActuatorCommand { actuate, body_name, ..ActuatorCommand::default() };
            assert_eq!(simulation.command_actuator(ActuatorId::new(0), &command), None);
        };
        let steps = |simulation: &mut Simulation| {
            let mut hasher = DefaultHasher::new();
            for _ in 0..80 {
                simulation.update(DT).expect("finite");
                hash(simulation, &mut hasher);
            }
            hasher.finish()
        };
        let held = |simulation: &Simulation| simulation.scene().actuators[ActuatorId::new(0)].is_actuated();
        steps(&mut simulation);
        let free = simulation.save().expect("savable");
        let after_free = steps(&mut simulation);
        simulation.restore(&free).expect("of this simulation");
        hold(&mut simulation, true);
        assert!(held(&simulation), "{profile:?}");
        let taken = simulation.save().expect("savable");
        let after_taken = steps(&mut simulation);
        assert_ne!(after_taken, after_free);
        hold(&mut simulation, false);
        steps(&mut simulation);
        for _ in 0..3 {
            simulation.restore(&free).expect("of this simulation");
            assert!(!held(&simulation));
            assert_eq!(steps(&mut simulation), after_free, "{profile:?}");
            simulation.restore(&taken).expect("of this simulation");
            assert!(held(&simulation));
            assert_eq!(steps(&mut simulation), after_taken, "{profile:?}");
            // The joint that holds is another one each time.
            hold(&mut simulation, false);
            hold(&mut simulation, true);
            steps(&mut simulation);
        }
    }
}

#[test]
fn a_picked_node_of_a_cloth_is_drawn_on() {
    let mut simulation = simulation(&shipped("cloth.yaml"), Profile::Legacy);
    let steps = |simulation: &mut Simulation| {
        let mut hasher = DefaultHasher::new();
        for _ in 0..150 {
            simulation.update(DT).expect("finite");
            hash(simulation, &mut hasher);
        }
        hasher.finish()
    };
    steps(&mut simulation);
    let free = simulation.save().expect("savable");
    let after_free = steps(&mut simulation);
    let scene = simulation.scene();
    let mut nodes = vec![[0.0; 3]; scene.soft_bodies[SoftBodyId::new(0)].nodes];
    scene.soft_bodies[SoftBodyId::new(0)].read_nodes(&scene.world, &mut nodes);
    let point = Vector3::from(nodes[5]);
    let node =
        simulation.pick_soft_node(SoftBodyId::new(0), &point, 0.1, point + Vector3::z() * 0.3).expect("a node is near");
    let picked = simulation.save().expect("savable");
    let after_picked = steps(&mut simulation);
    assert_ne!(after_picked, after_free);
    simulation.drag_soft_node(SoftBodyId::new(0), node, None);
    steps(&mut simulation);
    for _ in 0..2 {
        simulation.restore(&picked).expect("of this simulation");
        assert_eq!(steps(&mut simulation), after_picked);
        simulation.restore(&free).expect("of this simulation");
        assert_eq!(steps(&mut simulation), after_free);
    }
}
