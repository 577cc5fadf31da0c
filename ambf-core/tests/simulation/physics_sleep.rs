//! Scenes in which bodies at rest sleep: sensors, joints, controllers and actuators work on them as on awake ones.

use crate::physics_common::{close, load_texts, near, Bench, HEAVY, WEIGHTLESS};
use ambf_core::comm::{ActuatorCommand, BodyKinematics, JointCommandType};
use ambf_core::ids::{ActuatorId, SensorId};
use nalgebra::{Isometry3, Vector3};

const SLEEPY: &str = "gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\nphysics: {sleep: true}\n";

/// A box of 2 kg on a table that feels it, under a hand that sees it and may hold it; an arm that a motor holds.
const MODEL: &str = "bodies: [BODY Table, BODY Box, BODY Hand, BODY Post, BODY Arm]\njoints: [JOINT elbow]\n\
    sensors: [SENSOR touch, SENSOR eye]\nactuators: [ACTUATOR grip]\nignore inter-collision: false\n\
    BODY Table: {name: Table, mass: 0, collision shape: Box, collision geometry: {x: 1, y: 1, z: 0.1}}\n\
    BODY Box: {name: Box, mass: 2, location: {position: {x: 0, y: 0, z: 0.1}}, collision shape: Box, \
    collision geometry: {x: 0.1, y: 0.1, z: 0.1}, friction: {static: 0.5, rolling: 0.1}}\n\
    BODY Hand: {name: Hand, mass: 0, location: {position: {x: 0, y: 0, z: 0.5}}}\n\
    BODY Post: {name: Post, mass: 0, location: {position: {x: 3, y: 0, z: 0}}}\n\
    BODY Arm: {name: Arm, mass: 1, inertia: {ix: 0.1, iy: 0.1, iz: 0.1}, location: {position: {x: 3, y: 0, z: 0}}}\n\
    JOINT elbow: {name: elbow, type: revolute, parent: BODY Post, child: BODY Arm, parent axis: {x: 0, y: 0, z: 1}, \
    child axis: {x: 0, y: 0, z: 1}, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
    controller: {P: 10, I: 0, D: 0}, joint limits: {low: -1, high: 1}}\n\
    SENSOR touch: {name: touch, type: Contact, parent: BODY Table}\n\
    SENSOR eye: {name: eye, type: Proximity, parent: BODY Hand, range: 1, \
    array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 0, y: 0, z: -1}}]}\n\
    ACTUATOR grip: {name: grip, type: Constraint, parent: BODY Hand}\n";

fn asleep(bench: &Bench, name: &str) -> bool {
    let world = &bench.0.scene().world;
    world.is_asleep(world.bodies()[bench.body(name).index()]).expect("a live body")
}

fn sleeping() -> Bench {
    let mut bench = Bench::new(SLEEPY, MODEL);
    bench.steps(5000);
    assert!(asleep(&bench, "Box") && asleep(&bench, "Arm"));
    bench
}

#[test]
fn nothing_sleeps_unless_asked_for() {
    let mut bench = Bench::new(HEAVY, MODEL);
    bench.steps(5000);
    assert!(!asleep(&bench, "Box") && !asleep(&bench, "Arm"));
}

#[test]
fn sensors_see_and_feel_what_sleeps_and_its_state_is_complete() {
    let mut bench = sleeping();
    bench.steps(100);
    let scene = bench.0.scene();
    let touch = scene.sensors[SensorId::new(0)].readings();
    close(touch.iter().map(|reading| reading.measurement).sum::<f64>(), 20.0, 1.0);
    let eye = &scene.sensors[SensorId::new(1)].readings()[0];
    assert_eq!(eye.sensed.as_deref(), Some("Box"));
    close(eye.measurement, 1.0 - 0.35, 1e-3);
    let mut states = vec![BodyKinematics::default(); scene.bodies.len()];
    scene.world.read_bodies(&mut states);
    let state = states[bench.body("Box").index()];
    assert_eq!((state.linear_velocity, state.angular_velocity), ([0.0; 3], [0.0; 3]));
    near(state.origin.into(), [0.0, 0.0, 0.1], 1e-3);
}

#[test]
fn commands_wake_what_they_act_on() {
    let mut bench = sleeping();
    bench.command("Post", 0, JointCommandType::Position, 0.5, 2000);
    assert!(bench.joint("elbow").position > 0.2);
    assert!(!asleep(&bench, "Arm"), "a command in force");
    assert!(asleep(&bench, "Box"), "nobody told it anything");
    bench.push("Box", Vector3::zeros());
    bench.steps(1);
    assert!(asleep(&bench, "Box"), "no force");
    bench.push("Box", Vector3::new(100.0, 0.0, 0.0));
    bench.steps(1);
    assert!(bench.velocity("Box").0.x > 0.03);
    // Where nothing is under it: the table is taken away.
    bench.steps(5000);
    assert!(asleep(&bench, "Box"));
    bench.follow("Table", &Isometry3::translation(0.0, 5.0, 0.0));
    bench.steps(200);
    assert!(bench.position("Box").z < -0.05);
}

#[test]
fn an_actuator_holds_and_lets_go_of_what_sleeps() {
    let mut bench = sleeping();
    let hold = ActuatorCommand { actuate: true, body_name: "BODY Box".into(), ..ActuatorCommand::default() };
    assert_eq!(bench.0.command_actuator(ActuatorId::new(0), &hold), None);
    bench.steps(4000);
    assert!(asleep(&bench, "Box"), "it is held, and rests");
    for i in 1..=100 {
        bench.follow("Hand", &Isometry3::translation(0.0, 0.0, 0.5 + 0.002 * f64::from(i)));
        bench.steps(5);
    }
    bench.steps(500);
    close(bench.position("Box").z, 0.3, 0.01);
    bench.steps(4000);
    assert!(asleep(&bench, "Box"));
    bench.0.command_actuator(ActuatorId::new(0), &ActuatorCommand::default());
    bench.steps(500);
    close(bench.position("Box").z, 0.1, 0.01);
}

#[test]
fn a_reset_wakes_everything() {
    let mut bench = sleeping();
    bench.0.reset_world();
    bench.steps(1);
    assert!(!asleep(&bench, "Box") && !asleep(&bench, "Arm"));
}

#[test]
fn a_scene_with_soft_bodies_stays_awake_and_says_so() {
    let world = format!("{WEIGHTLESS}physics: {{sleep: true}}\n");
    let folder = std::env::temp_dir().join(format!("ambf_sleep_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let mesh = folder.join("sheet.obj");
    std::fs::write(&mesh, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("written");
    let cloth = format!("soft bodies: [C]\nC: {{name: C, mass: 1, mesh: {}}}\n", mesh.display());
    let loaded = load_texts(&world, &[&cloth]);
    std::fs::remove_dir_all(&folder).expect("removed");
    assert_eq!(loaded.scene.soft_bodies.len(), 1, "{}", loaded.report);
    assert!(loaded.report.notes.iter().any(|note| note.message.contains("nothing sleeps")), "{}", loaded.report);
}
