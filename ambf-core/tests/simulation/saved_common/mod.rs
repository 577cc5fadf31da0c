//! Scenes that are driven in a fixed way, and numbers that stand for all their states.
#![allow(missing_docs)]

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

use ambf_core::bullet::PlausibleBounds;
use ambf_core::comm::{ActuatorCommand, JointCommandType, VehicleCommand};
use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

pub const DT: f64 = 0.001;

pub fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources")
}

/// Scenes of the resources, by file name.
pub fn shipped(name: &str) -> SceneFiles {
    SceneFiles {
        world: Some(resources().join("world/world.yaml")),
        models: vec![resources().join("models").join(name)],
    }
}

pub fn all_shipped() -> Vec<SceneFiles> {
    let folder = resources().join("models").read_dir().expect("models");
    let mut names: Vec<_> = folder.map(|entry| entry.expect("an entry").file_name()).collect();
    names.sort();
    names.iter().map(|name| shipped(&name.to_string_lossy())).collect()
}

pub fn simulation_with(files: &SceneFiles, physics: PhysicsOptions, savable: bool) -> Simulation {
    let loaded = load(files, &SceneOptions { physics, savable, ..SceneOptions::default() });
    assert!(loaded.report.refused.is_empty(), "{}", loaded.report);
    assert_eq!(loaded.scene.world.is_savable(), savable);
    Simulation::new(loaded.scene, DT)
}

pub fn simulation(files: &SceneFiles, profile: Profile) -> Simulation {
    simulation_with(files, PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() }, true)
}

/// Commands of all kinds, which depend on nothing but the step.
pub fn command(simulation: &mut Simulation, step: u32) {
    let phase = f64::from(step) * 0.02;
    let scene = simulation.scene();
    let (bodies, vehicles, actuators) = (scene.bodies.ids(), scene.vehicles.ids(), scene.actuators.ids());
    for body in bodies {
        for joint in 0..simulation.scene().active_joints(body).len() {
            let value = 0.3 * (phase + joint as f64).sin();
            match (joint + body.index()) % 4 {
                0 | 1 => simulation.command_joint(body, joint, JointCommandType::Position, value),
                2 => simulation.command_joint(body, joint, JointCommandType::Effort, value),
                _ => simulation.command_joint(body, joint, JointCommandType::Velocity, value),
            };
        }
        match (body.index() as u32 + step / 50) % 5 {
            0 => simulation.apply_wrench(body, Vector3::new(phase.sin(), phase.cos(), 0.5), Vector3::z() * 0.01),
            1 if body.index() % 7 == 3 => {
                let pose = simulation.scene().bodies[body].initial_pose.translation.vector;
                simulation.follow_pose(body, pose + Vector3::z() * (0.05 * phase.sin()), [0.0, 0.0, 0.0, 1.0]);
            }
            _ => (),
        }
    }
    for vehicle in vehicles {
        let wheels = simulation.scene().vehicles[vehicle].wheels.len();
        let (steering, power) = (vec![0.2 * phase.sin(); wheels], vec![30.0; wheels]);
        let command = VehicleCommand { steering, power, ..VehicleCommand::default() };
        simulation.command_vehicle(vehicle, &command);
    }
    for actuator in actuators {
        // Holds and lets go, each for a while.
        let use_sensor_data = !simulation.scene().sensors.is_empty() && step.is_multiple_of(2);
        let sensor_identifier = simulation.scene().sensors.first().map(|sensor| sensor.identity.key());
        let target =
            simulation.scene().bodies.iter().rev().find(|body| body.mass > 0.0).map(|body| body.identity.key());
        let command = ActuatorCommand {
            actuate: (step / 37).is_multiple_of(2),
            use_sensor_data,
            sensor_identifier: sensor_identifier.unwrap_or_default(),
            body_name: target.unwrap_or_default(),
            ..ActuatorCommand::default()
        };
        simulation.command_actuator(actuator, &command);
    }
}

/// Commands and steps from iteration `begin` to `end`; a number for all states on the way.
pub fn run(simulation: &mut Simulation, begin: u32, end: u32) -> u64 {
    let mut hasher = DefaultHasher::new();
    for step in begin..end {
        command(simulation, step);
        // Lengths of all kinds: none, one and several sub-steps.
        let interval = if step % 10 == 7 { 2.6 * DT } else { DT };
        if let Err(error) = simulation.update(interval) {
            // Lost in the same way at the same time.
            error.to_string().hash(&mut hasher);
            break;
        }
        hash(simulation, &mut hasher);
    }
    hasher.finish()
}

/// Everything that can be seen of a simulation.
pub fn hash(simulation: &Simulation, hasher: &mut DefaultHasher) {
    let scene = simulation.scene();
    let mut number = |x: f64| x.to_bits().hash(hasher);
    number(simulation.sim_time());
    number(f64::from(simulation.sim_step()));
    number(simulation.lost_time());
    for &handle in scene.world.bodies() {
        let (Some(pose), Some(state), Some((linear, angular))) =
            (scene.world.pose(handle), scene.world.motion_state(handle), scene.world.velocity(handle))
        else {
            continue;
        };
        for pose in [pose, state] {
            pose.translation.vector.iter().chain(pose.rotation.coords.iter()).for_each(|&x| number(x));
        }
        linear.iter().chain(angular.iter()).for_each(|&x| number(x));
        number(f64::from(u8::from(scene.world.is_asleep(handle) == Some(true))));
    }
    number(scene.world.contact_count() as f64);
    for joint in &scene.joints {
        [joint.position, joint.velocity, joint.effort].into_iter().for_each(&mut number);
    }
    for wrench in simulation.wrenches() {
        wrench.force.iter().chain(wrench.torque.iter()).for_each(|&x| number(x));
    }
    for soft in &scene.soft_bodies {
        let mut nodes = vec![[0.0; 3]; soft.nodes];
        soft.read_nodes(&scene.world, &mut nodes);
        nodes.iter().flatten().for_each(|&x| number(x));
    }
    for attached in scene.cameras.iter().map(|c| &c.attached).chain(scene.ghosts.iter().map(|g| &g.attached)) {
        attached.pose.translation.vector.iter().for_each(|&x| number(x));
    }
    for actuator in &scene.actuators {
        number(f64::from(u8::from(actuator.is_actuated())));
    }
    for ghost in &scene.ghosts {
        ghost.sensed(&scene.bodies).for_each(|body| number(body.index() as f64));
    }
    for sensor in &scene.sensors {
        for reading in sensor.readings() {
            number(reading.measurement);
            number(f64::from(u8::from(reading.triggered)));
        }
    }
    for joint in scene.world.constraints() {
        scene.world.joint_wrench(*joint).iter().for_each(|wrench| wrench.force_a.iter().for_each(|&x| number(x)));
    }
}

/// Runs, saves, goes on, restores and goes on again: each time the same, and the same as without any of it. False: the
/// state became non-finite, in all of them.
#[must_use]
pub fn check(what: &str, files: &SceneFiles, physics: PhysicsOptions, warm: u32, steps: u32) -> bool {
    let mut plain = simulation_with(files, physics, false);
    let before = run(&mut plain, 0, warm);
    let after = run(&mut plain, warm, warm + steps);
    let mut simulation = simulation_with(files, physics, true);
    assert_eq!(run(&mut simulation, 0, warm), before, "{what}: the option changes nothing");
    let saved = simulation.save().expect("savable");
    assert_eq!(run(&mut simulation, warm, warm + steps), after, "{what}: saving changes nothing");
    for time in 1..=2 {
        simulation.restore(&saved).expect("of this simulation");
        assert_eq!(run(&mut simulation, warm, warm + steps), after, "{what}: restored {time} times");
    }
    // From where nothing was the same.
    simulation.restore(&saved).expect("of this simulation");
    disturb(&mut simulation);
    simulation.restore(&saved).expect("of this simulation");
    assert_eq!(run(&mut simulation, warm, warm + steps), after, "{what}: after another life");
    simulation.sim_step() == warm + steps && simulation.scene().world.first_lost(&PlausibleBounds::default()).is_none()
}

/// Does what the commands do not, until little is as it was.
pub fn disturb(simulation: &mut Simulation) {
    for body in simulation.scene().bodies.ids() {
        simulation.set_velocity(body, Vector3::new(0.3, -0.2, 1.0), Vector3::z());
    }
    for _ in 0..50 {
        // A state that is lost is none of our business here.
        let _ = simulation.update(DT);
    }
    simulation.reset_world();
    let _ = simulation.update(DT);
}

pub fn scene_name(files: &SceneFiles) -> String {
    files.models.iter().map(|path| path.file_name().unwrap_or_default().to_string_lossy()).collect()
}
