//! A scene from any model, and of any world before a line `=====`: built, stepped, told a few things, reset, and its
//! models added and removed without a crash.
#![no_main]

mod numbers;

use std::path::PathBuf;
use std::sync::OnceLock;

use ambf_core::comm::{ActuatorCommand, JointCommandType, VehicleCommand};
use ambf_core::ids::BodyId;
use ambf_core::scene::{load, Loaded, PreparedModel, SceneFiles, SceneOptions};
use ambf_core::sim::{Simulation, DEFAULT_SUB_STEP};
use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use nalgebra::Vector3;

/// Meshes that models may name.
const MESHES: [(&str, &str); 5] = [
    ("tetra.obj", include_str!("../meshes/tetra.obj")),
    ("one.obj", include_str!("../meshes/one.obj")),
    ("open.obj", include_str!("../meshes/open.obj")),
    ("flat.obj", include_str!("../meshes/flat.obj")),
    ("book.obj", include_str!("../meshes/book.obj")),
];

const WORLD: &str = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 5\nenclosure: {length: 4, width: 4, height: 2}\n";

/// A folder with the meshes.
fn folder() -> &'static PathBuf {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = std::env::temp_dir().join(format!("ambf_fuzz_{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        for (name, text) in MESHES {
            std::fs::write(folder.join(name), text).expect("written");
        }
        folder
    })
}

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    numbers::mutate(data, size, max_size, seed)
});

fuzz_target!(|text: &str| {
    let (world, model) = text.split_once("=====\n").unwrap_or((WORLD, text));
    let folder = folder();
    let file = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let files = SceneFiles { world: Some(file("world.yaml", world)), models: vec![file("model.yaml", model)] };
    let Loaded { scene, report } = load(&files, &SceneOptions::default());
    let _ = report.verbose().to_string();

    let mut simulation = Simulation::new(scene, DEFAULT_SUB_STEP);
    let _hub = simulation.connect();
    steps(&mut simulation);
    command(&mut simulation);
    steps(&mut simulation);
    simulation.reset_world();
    steps(&mut simulation);

    // A second one of the model comes, then the first goes, then all that is left.
    let Ok(again) = PreparedModel::read(&files.models[0]) else { return };
    let second = simulation.add_model(again).expect("something is built").key;
    command(&mut simulation);
    steps(&mut simulation);
    let first = simulation.scene().models.iter().rfind(|model| !model.removed && model.key != second);
    let first = first.map(|model| model.key.clone()).expect("an environment at least");
    for key in [first, second] {
        let _ = simulation.remove_model(&key);
        steps(&mut simulation);
    }
});

fn steps(simulation: &mut Simulation) {
    for _ in 0..3 {
        // A lost state is an answer; a crash is not.
        if simulation.update(DEFAULT_SUB_STEP).is_err() {
            simulation.reset_bodies();
        }
    }
}

/// Tells the first of everything to do something.
fn command(simulation: &mut Simulation) {
    let scene = simulation.scene();
    let (bodies, vehicles, actuators) = (scene.bodies.ids(), scene.vehicles.ids(), scene.actuators.ids());
    let name = |i| scene.bodies.get(BodyId::new(i)).map(|body| body.identity.name.to_string()).unwrap_or_default();
    let hold = |body_name, use_sensor_data| ActuatorCommand {
        actuate: true,
        body_name,
        use_sensor_data,
        sensor_identifier: "S".into(),
        ..Default::default()
    };
    let holds = [hold(name(1), false), hold(name(2), true)];
    for body in bodies.take(4) {
        simulation.command_joint(body, 0, JointCommandType::Position, 0.5);
        simulation.command_joint(body, 1, JointCommandType::Velocity, 1.0);
        simulation.apply_wrench(body, Vector3::new(1.0, 0.0, 2.0), Vector3::z());
    }
    let drive = VehicleCommand { steering: vec![0.3; 4], power: vec![50.0; 4], ..Default::default() };
    vehicles.take(2).for_each(|vehicle| simulation.command_vehicle(vehicle, &drive));
    for (actuator, command) in actuators.zip(&holds) {
        let _ = simulation.command_actuator(actuator, command);
    }
}
