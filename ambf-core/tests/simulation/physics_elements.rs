//! Sensors, actuators, ghosts and vehicles: what they see and what they do.

use crate::physics_common::{close, load_texts, near, Bench, DT, HEAVY, WEIGHTLESS};
use ambf_core::comm::{ActuatorCommand, ObjectKind, SensorType, VehicleCommand};
use ambf_core::ids::{ActuatorId, BodyId, GhostId, SensorId, SoftBodyId, VehicleId};
use ambf_core::scene::{Loaded, Parent};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

/// A static post at the origin with a ray upwards of 0.5 m, and a ball whose lowest point is at `height`.
fn ray_under_ball(height: f64, sensor: &str) -> String {
    format!(
        "bodies: [BODY Post, BODY Ball]\nsensors: [SENSOR eye]\n\
         BODY Post: {{name: Post, mass: 0}}\n\
         BODY Ball: {{name: Ball, mass: 1, location: {{position: {{x: 0, y: 0, z: {}}}}}, collision shape: Sphere, \
         collision geometry: {{radius: 0.1}}, damping: {{linear: 0.9, angular: 0.9}}}}\n\
         SENSOR eye: {{name: eye, parent: BODY Post, range: 0.5, {sensor}}}\n",
        height + 0.1
    )
}

const UP: &str = "array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 0, y: 0, z: 1}}, \
                  {offset: {x: 1, y: 0, z: 0}, direction: {x: 0, y: 0, z: 1}}]";

#[test]
fn a_ray_measures_how_near_something_is_and_names_it() {
    let mut bench = Bench::new(WEIGHTLESS, &ray_under_ball(0.2, &format!("type: Proximity, {UP}")));
    bench.steps(1);
    let readings = bench.0.scene().sensors[SensorId::new(0)].readings();
    assert_eq!(readings.len(), 2);
    assert!(readings[0].triggered && readings[0].sensed.as_deref() == Some("Ball"));
    close(readings[0].measurement, 1.0 - 0.2 / 0.5, 1e-9);
    assert!(!readings[1].triggered && readings[1].sensed.is_none() && readings[1].measurement == 0.0);
    let info = &bench.0.scene().sensors[SensorId::new(0)].info;
    assert_eq!((info.kind, info.range, info.parent_name.as_str()), (SensorType::Proximity, 0.5, "BODY Post"));
    // Out of reach, then back: a reset restores the body, and the sensor still sees from where it was.
    bench.throw("Ball", Vector3::new(5.0, 0.0, 0.0));
    bench.steps(100);
    assert!(!bench.0.scene().sensors[SensorId::new(0)].readings()[0].triggered);
    bench.0.reset_world();
    bench.steps(1);
    close(bench.0.scene().sensors[SensorId::new(0)].readings()[0].measurement, 0.6, 1e-9);
}

#[test]
fn the_location_of_a_fan_counts_once() {
    let fan = "type: Proximity, location: {position: {x: 0, y: 0, z: 0.1}, orientation: {r: 0, p: -1.5707963267948966, y: 0}}, \
               parametric: {resolution: 3, horizontal angle: 0.2, vertical angle: 0.2, start offset: 0.02}";
    let mut bench = Bench::new(WEIGHTLESS, &ray_under_ball(0.2, fan));
    bench.steps(1);
    // The middle ray starts 0.02 above the sensor, which is 0.1 above the post.
    close(bench.0.scene().sensors[SensorId::new(0)].readings()[4].measurement, 1.0 - 0.08 / 0.5, 1e-9);
}

#[test]
fn a_resistance_sensor_carries_what_it_presses() {
    let sensor = format!("type: Resistance, contact stiffness: 100, {UP}");
    let mut bench = Bench::new(HEAVY, &ray_under_ball(0.4, &sensor));
    bench.steps(8000);
    // k·d = m·g: d = 0.1, the gap is 0.45 m.
    close(bench.position("Ball").z, 0.55, 1e-4);
    close(bench.0.scene().sensors[SensorId::new(0)].readings()[0].measurement, 0.1, 2e-4);
    assert_eq!(bench.0.scene().sensors[SensorId::new(0)].info.kind, SensorType::Resistance);
}

#[test]
fn a_contact_sensor_weighs_what_lies_on_its_parent() {
    let model = "bodies: [BODY Table, BODY Box]\nsensors: [SENSOR touch]\n\
                 BODY Table: {name: Table, mass: 0, collision shape: Box, collision geometry: {x: 1, y: 1, z: 0.1}}\n\
                 BODY Box: {name: Box, mass: 2, location: {position: {x: 0, y: 0, z: 0.11}}, collision shape: Box, \
                 collision geometry: {x: 0.1, y: 0.1, z: 0.1}}\n\
                 SENSOR touch: {name: touch, type: Contact, parent: BODY Table}\n";
    let mut bench = Bench::new(HEAVY, model);
    bench.steps(5);
    assert!(bench.0.scene().sensors[SensorId::new(0)].readings().is_empty(), "still falling");
    bench.steps(1000);
    let mut sum = 0.0;
    for _ in 0..100 {
        bench.steps(1);
        let readings = bench.0.scene().sensors[SensorId::new(0)].readings();
        sum += readings.iter().map(|reading| reading.measurement).sum::<f64>() / 100.0;
        assert!(readings.iter().all(|reading| reading.sensed.as_deref() == Some("Box")), "{readings:?}");
    }
    close(sum, 20.0, 0.5);
}

/// A static hand 0.3 above a box, with an actuator and an eye that looks down.
fn hand() -> Bench {
    Bench::new(
        HEAVY,
        "namespace: /ambf/env/\nbodies: [BODY Hand, BODY Box, BODY Other]\nactuators: [ACTUATOR grip]\nsensors: [SENSOR eye]\n\
         BODY Hand: {name: Hand, mass: 0, location: {position: {x: 0, y: 0, z: 1}}}\n\
         BODY Box: {name: Box, mass: 1, location: {position: {x: 0, y: 0, z: 0.7}}, collision shape: Box, \
         collision geometry: {x: 0.1, y: 0.1, z: 0.1}}\n\
         BODY Other: {name: Other, mass: 1, location: {position: {x: 3, y: 0, z: 0.7}}}\n\
         ACTUATOR grip: {name: grip, type: Constraint, parent: BODY Hand, location: {position: {x: 0, y: 0, z: -0.1}}}\n\
         SENSOR eye: {name: eye, type: Proximity, parent: BODY Hand, range: 0.5, \
         array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 0, y: 0, z: -1}}]}\n",
    )
}

fn by_name(name: &str) -> ActuatorCommand {
    ActuatorCommand { actuate: true, body_name: name.into(), ..Default::default() }
}

#[test]
fn an_actuator_holds_a_body_where_it_is_until_it_lets_go() {
    for command in [
        by_name("BODY Box"),
        ActuatorCommand {
            actuate: true,
            use_sensor_data: true,
            sensor_identifier: "SENSOR eye".into(),
            ..Default::default()
        },
    ] {
        let mut bench = hand();
        bench.steps(1);
        assert_eq!(bench.0.command_actuator(ActuatorId::new(0), &command), None);
        assert!(bench.0.scene().actuators[ActuatorId::new(0)].is_actuated());
        let hand = bench.body("Hand");
        for step in 0..1000 {
            // 0.2 m to the side in a second.
            bench.0.follow_pose(hand, Vector3::new(0.0002 * f64::from(step), 0.0, 1.0), [0.0, 0.0, 0.0, 1.0]);
            bench.steps(1);
        }
        near(bench.position("Box") - bench.position("Hand"), [0.0, 0.0, -0.3], 2e-3);
        assert_eq!(bench.0.command_actuator(ActuatorId::new(0), &ActuatorCommand::default()), None);
        assert!(!bench.0.scene().actuators[ActuatorId::new(0)].is_actuated());
        bench.steps(300);
        assert!(bench.position("Box").z < 0.4, "it falls");
    }
}

#[test]
fn an_actuator_holds_what_lists_and_topics_call_a_body() {
    for name in ["Box", "BODY Box", "/ambf/env/Box", "env/Box"] {
        let mut bench = hand();
        assert_eq!(bench.0.command_actuator(ActuatorId::new(0), &by_name(name)), None, "{name}");
        assert!(bench.0.scene().actuators[ActuatorId::new(0)].is_actuated(), "{name}");
    }
    let mut bench = hand();
    bench.steps(1);
    let by_sensor = ActuatorCommand {
        actuate: true,
        use_sensor_data: true,
        sensor_identifier: "/ambf/env/eye".into(),
        ..Default::default()
    };
    assert_eq!(bench.0.command_actuator(ActuatorId::new(0), &by_sensor), None);
    assert!(bench.0.scene().actuators[ActuatorId::new(0)].is_actuated());
    // The end of a word is no name.
    let mut bench = hand();
    assert!(bench.0.command_actuator(ActuatorId::new(0), &by_name("v/Box")).is_some());
}

#[test]
fn an_offset_says_where_the_body_is_held() {
    let mut bench = hand();
    let offset = ActuatorCommand {
        use_offset: true,
        offset_position: Vector3::new(0.0, 0.0, 0.1),
        offset_orientation: [0.0, 0.0, 0.0, 1.0],
        ..by_name("Box")
    };
    bench.0.command_actuator(ActuatorId::new(0), &offset);
    bench.steps(1500);
    // The frame 0.1 above the centre of the box is at the actuator, 0.1 below the hand.
    near(bench.position("Box"), [0.0, 0.0, 0.8], 2e-3);
}

#[test]
fn what_an_actuator_cannot_find_is_named_once() {
    let mut bench = hand();
    let message = bench.0.command_actuator(ActuatorId::new(0), &by_name("BODY Nobody")).expect("a message");
    assert!(message.contains("BODY Nobody") && message.contains("ACTUATOR grip"), "{message}");
    assert_eq!(bench.0.command_actuator(ActuatorId::new(0), &by_name("BODY Nobody")), None);
    assert!(
        bench.0.command_actuator(ActuatorId::new(0), &by_name("BODY")).is_none()
            && !bench.0.scene().actuators[ActuatorId::new(0)].is_actuated()
    );
    // The hand itself cannot be held by itself.
    bench.0.command_actuator(ActuatorId::new(0), &by_name("BODY Hand"));
    assert!(!bench.0.scene().actuators[ActuatorId::new(0)].is_actuated());
}

/// A box in a ghost zone of 1 m around the origin, with its own gravity.
const ZONE: &str = "bodies: [BODY Box]\nghost objects: [GHOST zone]\n\
                    BODY Box: {name: Box, mass: 1, gravity: {x: 0, y: 0, z: -3}, collision shape: Box, \
                    collision geometry: {x: 0.1, y: 0.1, z: 0.1}, damping: {linear: 0, angular: 0}}\n\
                    GHOST zone: {name: zone, collision shape: Box, collision geometry: {x: 1, y: 1, z: 1}}\n";

#[test]
fn what_is_in_a_ghost_floats_and_gets_its_own_weight_back() {
    let mut bench = Bench::new(HEAVY, ZONE);
    bench.throw("Box", Vector3::new(1.0, 0.0, 0.0));
    bench.steps(500);
    let (velocity, _) = bench.velocity("Box");
    assert!(velocity.norm() < 1e-6, "it is slowed down: {velocity}");
    assert!(bench.position("Box").norm() < 0.1);
    assert_eq!(bench.0.scene().ghosts[GhostId::new(0)].sensed(&bench.0.scene().bodies).next(), Some(BodyId::new(0)));
    // Throw it out.
    for _ in 0..400 {
        bench.throw("Box", Vector3::new(0.0, 0.0, -5.0));
        bench.steps(1);
    }
    let before = bench.velocity("Box").0.z;
    bench.steps(100);
    close(bench.velocity("Box").0.z - before, -0.3, 1e-9);
    assert!(bench.0.scene().ghosts[GhostId::new(0)].sensed(&bench.0.scene().bodies).next().is_none());
}

#[test]
fn a_ghost_follows_its_parent_body() {
    let model = format!(
        "{}BODY Carrier: {{name: Carrier, mass: 0, location: {{position: {{x: 5, y: 0, z: 0}}}}}}\n",
        ZONE.replace("[BODY Box]", "[BODY Box, BODY Carrier]")
            .replace("{name: zone,", "{name: zone, parent: BODY Carrier, location: {position: {x: 0, y: 0, z: 1}},")
    );
    let mut bench = Bench::new(HEAVY, &model);
    bench.steps(2);
    let scene = bench.0.scene();
    assert_eq!(scene.ghosts[GhostId::new(0)].attached.parent, Some(Parent::Body(BodyId::new(1))));
    near(scene.ghosts[GhostId::new(0)].pose().translation.vector, [5.0, 0.0, 1.0], 1e-12);
    assert!(scene.ghosts[GhostId::new(0)].sensed(&scene.bodies).next().is_none());
}

#[test]
fn a_short_name_means_the_parent_of_the_same_model() {
    let model = |namespace: &str, x: f64| {
        format!(
            "namespace: {namespace}\nbodies: [BODY finger]\njoints: []\nghost objects: [GHOST g]\ncameras: [CAMERA c]\n\
             BODY finger: {{name: finger, mass: 0, location: {{position: {{x: {x}, y: 0, z: 0}}}}}}\n\
             GHOST g: {{name: g, parent: BODY finger, collision shape: Sphere, collision geometry: {{radius: 0.1}}}}\n\
             CAMERA c: {{name: c, parent: BODY finger}}\n"
        )
    };
    // One model twice, and one with the same names in another namespace.
    let (a, b) = (model("/ambf/env/a/", 1.0), model("/ambf/env/b/", 2.0));
    let Loaded { scene, report } = load_texts(HEAVY, &[&a, &a, &b]);
    assert!(report.errors() == 0 && !report.to_string().contains("parent"), "{report}");
    let parents = |placed: Vec<Option<Parent>>| {
        assert_eq!(placed, (0..3).map(|body| Some(Parent::Body(BodyId::new(body)))).collect::<Vec<_>>())
    };
    parents(scene.ghosts.iter().map(|ghost| ghost.attached.parent).collect());
    parents(
        scene
            .cameras
            .iter()
            .filter(|camera| camera.attached.identity.identifier == "CAMERA c")
            .map(|camera| camera.attached.parent)
            .collect(),
    );
}

#[test]
fn a_loop_of_parents_is_refused() {
    let model = "lights: [A, B]\ncameras: [C]\n\
                 A: {name: A, parent: B, location: {x: 1, y: 0, z: 0}}\nB: {name: B, parent: A, location: {x: 1, y: 0, z: 0}}\n\
                 C: {name: C, parent: C, location: {x: 1, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}}\n";
    let Loaded { scene, report } = load_texts(HEAVY, &[model]);
    let text = report.to_string();
    assert_eq!(text.matches("itself or hangs on it").count(), 2, "{text}");
    let lights: Vec<_> = scene.lights.iter().filter(|light| light.attached.parent.is_some()).collect();
    assert_eq!(lights.len(), 1);
    let pose = scene.global_pose(lights[0].attached.parent, &lights[0].attached.pose);
    near(pose.translation.vector, [2.0, 0.0, 0.0], 1e-12);
}

/// A box on four wheels on a plane; forward is +x.
fn car() -> String {
    let wheel = |name: &str, x: f64, y: f64, front: bool| {
        format!(
            "    - {{body: BODY {name}, radius: 0.1, friction: 10, suspension: {{stiffness: 60, damping: 6, compression: 4, \
             rest length: 0.1}}, roll influence: 0.01, down direction: {{x: 0, y: 0, z: -1}}, \
             axel direction: {{x: 0, y: 1, z: 0}}, offset: {{x: {x}, y: {y}, z: 0}}, front: {front}, \
             steering limits: {{low: {}, high: {}}}, max engine power: 20, max brake power: 2}}\n",
            if front { -0.5 } else { 0.0 },
            if front { 0.5 } else { 0.0 }
        )
    };
    let mut text = String::from(
        "bodies: [BODY Ground, BODY Chassis, BODY FL, BODY FR, BODY RL, BODY RR]\nvehicles: [VEHICLE car]\n\
         BODY Ground: {name: Ground, mass: 0, collision shape: Plane, collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}}\n\
         BODY Chassis: {name: Chassis, mass: 10, location: {position: {x: 0, y: 0, z: 0.25}}, \
         collision shape: Box, collision geometry: {x: 0.6, y: 0.3, z: 0.1}}\n",
    );
    let corners =
        [("FL", 0.25, 0.2, true), ("FR", 0.25, -0.2, true), ("RL", -0.25, 0.2, false), ("RR", -0.25, -0.2, false)];
    for (name, ..) in corners {
        text += &format!(
            "BODY {name}: {{name: {name}, mass: 1, collision shape: Sphere, collision geometry: {{radius: 0.1}}}}\n"
        );
    }
    text += "VEHICLE car:\n  name: car\n  chassis: BODY Chassis\n  wheels:\n";
    corners.iter().for_each(|&(name, x, y, front)| text += &wheel(name, x, y, front));
    text
}

fn drive(bench: &mut Bench, command: &VehicleCommand, steps: u32) {
    for _ in 0..steps {
        bench.0.command_vehicle(VehicleId::new(0), command);
        bench.steps(1);
    }
}

#[test]
fn a_vehicle_drives_steers_and_brakes() {
    let mut bench = Bench::new(HEAVY, &car());
    assert_eq!(bench.0.scene().vehicles[VehicleId::new(0)].wheels.len(), 4);
    drive(&mut bench, &VehicleCommand::default(), 1000);
    let start = bench.position("Chassis");
    assert!((0.15..0.25).contains(&start.z), "it stands on its wheels: {start}");
    let speed = |bench: &Bench| bench.velocity("Chassis").0;

    let forward = VehicleCommand { power: vec![5.0; 4], ..VehicleCommand::default() };
    drive(&mut bench, &forward, 1000);
    let driven = (bench.position("Chassis") - start, speed(&bench));
    assert!(driven.0.x.abs() > 0.5 && driven.0.y.abs() < 0.02, "{driven:?}");
    // 20 N on 10 kg for a second, against the damping of the body.
    close(driven.1.x.abs(), 2.0, 0.2);

    let heading = |bench: &Bench| bench.pose("Chassis").rotation.euler_angles().2;
    let before = heading(&bench);
    drive(&mut bench, &VehicleCommand { steering: vec![0.3, 0.3], ..forward.clone() }, 1000);
    let turned = heading(&bench) - before;
    assert!(turned.abs() > 0.2, "{turned}");

    drive(&mut bench, &VehicleCommand { full_brake: true, ..VehicleCommand::default() }, 3000);
    assert!(speed(&bench).norm() < 0.02, "{}", speed(&bench));
    // A wheel's body is where Bullet has the wheel.
    let (wheel, chassis) = (bench.position("FL"), bench.pose("Chassis"));
    let local = chassis.inverse_transform_point(&wheel.into());
    close(local.x, 0.25, 1e-3);
    close(local.y, 0.2, 1e-3);
    assert!(local.z < -0.02, "{local}");

    bench.0.reset_world();
    bench.steps(1000);
    near(bench.position("Chassis"), [0.0, 0.0, start.z], 1e-2);
}

#[test]
fn wheels_are_on_their_vehicle_before_the_first_step_and_after_a_reset() {
    let mut bench = Bench::new(HEAVY, &car());
    let places = [("FL", 0.25, 0.2), ("FR", 0.25, -0.2), ("RL", -0.25, 0.2), ("RR", -0.25, -0.2)];
    let on_vehicle = |bench: &Bench| {
        for (name, x, y) in places {
            near(bench.position(name), [x, y, 0.15], 1e-9);
        }
    };
    on_vehicle(&bench);
    drive(&mut bench, &VehicleCommand { power: vec![20.0; 4], ..VehicleCommand::default() }, 500);
    assert!((bench.position("FL").x - 0.25).abs() > 0.05, "it drove");
    bench.0.reset_bodies();
    on_vehicle(&bench);
}

#[test]
fn wheels_follow_a_chassis_that_assembly_moves() {
    let model = car().replace("joints: []", "")
        + "joints: [J]\nBODY Post: {name: Post, mass: 0, location: {position: {x: 3, y: 0, z: 0.25}}}\n\
           J: {name: J, type: fixed, parent: BODY Post, child: BODY Chassis, parent pivot: {x: 0, y: 0, z: 0}, \
           child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}}\n";
    let model = model.replace("BODY RL, BODY RR]", "BODY RL, BODY RR, BODY Post]");
    let bench = Bench::new(&format!("physics: {{profile: accurate}}\n{HEAVY}"), &model);
    near(bench.position("Chassis"), [3.0, 0.0, 0.25], 1e-6);
    near(bench.position("FL"), [3.25, 0.2, 0.15], 1e-6);
}

#[test]
fn commands_of_vehicles_are_clamped_and_may_be_short() {
    let mut bench = Bench::new(HEAVY, &car());
    drive(&mut bench, &VehicleCommand::default(), 500);
    let command = VehicleCommand { power: vec![1e9], steering: vec![7.0; 9], ..VehicleCommand::default() };
    drive(&mut bench, &command, 200);
    assert!(bench.velocity("Chassis").0.norm() < 1.0, "one wheel, 20 N");
    let lift = VehicleCommand { force: Vector3::new(0.0, 0.0, 200.0), ..VehicleCommand::default() };
    let before = bench.velocity("Chassis").0.z;
    drive(&mut bench, &lift, 100);
    assert!(bench.velocity("Chassis").0.z - before > 0.5, "20 m/s² up against 10 down");
}

/// A cloth of 6 × 6 nodes, 0.5 m wide, that hangs from two corners at z = 1, with a hand that looks at its middle.
fn cloth_and_hand(name: &str) -> Bench {
    let mesh = std::env::temp_dir().join(format!("ambf_cloth_{}_{name}.obj", std::process::id()));
    let mut text = String::new();
    for i in 0..36 {
        text += &format!("v {} 0 {}\n", f64::from(i % 6) * 0.1, -f64::from(i / 6) * 0.1);
    }
    // From the far end: the legacy profile cannot fix what becomes node 0.
    for a in (1..30).rev().filter(|a| a % 6 != 0) {
        text += &format!("f {a} {} {}\nf {} {} {}\n", a + 1, a + 6, a + 1, a + 7, a + 6);
    }
    std::fs::write(&mesh, text).expect("a mesh");
    let model = format!(
        "bodies: [BODY Hand]\nsoft bodies: [CLOTH]\nsensors: [SENSOR eye]\nactuators: [ACTUATOR grip]\n\
         BODY Hand: {{name: Hand, mass: 0, location: {{position: {{x: 0.25, y: -0.2, z: 0.75}}}}}}\n\
         CLOTH: {{name: cloth, mass: 0.2, mesh: {}, location: {{position: {{x: 0, y: 0, z: 1}}}}, \
         config: {{kLST: 0.5, kDP: 0.02, piterations: 8, fixed nodes: [0, 5]}}}}\n\
         SENSOR eye: {{name: eye, type: Proximity, parent: BODY Hand, range: 0.5, \
         array: [{{offset: {{x: 0, y: 0, z: 0}}, direction: {{x: 0, y: 1, z: 0}}}}]}}\n\
         ACTUATOR grip: {{name: grip, type: Constraint, parent: BODY Hand}}\n",
        mesh.display()
    );
    let bench = Bench::new(HEAVY, &model);
    let _ = std::fs::remove_file(mesh);
    bench
}

fn nodes(bench: &Bench) -> Vec<Vector3<f64>> {
    let (scene, mut nodes) = (bench.0.scene(), vec![[0.0; 3]; 36]);
    scene.soft_bodies[SoftBodyId::new(0)].read_nodes(&scene.world, &mut nodes);
    nodes.into_iter().map(Vector3::from).collect()
}

#[test]
fn a_cloth_hangs_settles_and_is_restored() {
    let mut bench = cloth_and_hand("hangs");
    let before = nodes(&bench);
    bench.steps(200);
    let early = nodes(&bench);
    bench.steps(4000);
    let (late, mut moved) = (nodes(&bench), 0.0_f64);
    bench.steps(100);
    for (a, b) in late.iter().zip(nodes(&bench)) {
        moved = moved.max((a - b).norm());
    }
    assert!(moved < 1e-3, "it still moves by {moved} m in 0.1 s");
    assert!(early.iter().zip(&before).any(|(a, b)| (a - b).norm() > 1e-6), "it sagged");
    let fixed = (0..36).filter(|&i| late[i] == before[i]);
    let corners: Vec<_> = fixed.map(|i| (before[i].x, before[i].z)).collect();
    assert_eq!(corners.len(), 2, "{corners:?}");
    assert!(corners.contains(&(0.0, 1.0)) && corners.contains(&(0.5, 1.0)), "{corners:?}");
    bench.0.reset_world();
    assert_eq!(nodes(&bench), before);
}

#[test]
fn an_actuator_ties_what_it_sees_of_a_cloth_to_its_parent() {
    let mut bench = cloth_and_hand("held");
    bench.steps(1);
    assert!(bench.0.scene().sensors[SensorId::new(0)].readings()[0].triggered);
    assert_eq!(
        bench.0.scene().sensors[SensorId::new(0)].readings()[0].sensed,
        None,
        "a soft body has no name to a sensor"
    );
    let command =
        ActuatorCommand { actuate: true, use_sensor_data: true, sensor_identifier: "eye".into(), ..Default::default() };
    assert_eq!(bench.0.command_actuator(ActuatorId::new(0), &command), None);
    assert!(bench.0.scene().actuators[ActuatorId::new(0)].is_actuated());
    let middle = |bench: &Bench| {
        nodes(bench).iter().map(|node| (node - Vector3::new(0.25, 0.0, 0.75)).norm()).fold(9.0, f64::min)
    };
    assert!(middle(&bench) < 0.1);
    // Pull it 0.2 m away from where it hangs.
    let hand = bench.body("Hand");
    for step in 0..1000 {
        bench.0.follow_pose(hand, Vector3::new(0.25, -0.2 - 0.0002 * f64::from(step), 0.75), [0.0, 0.0, 0.0, 1.0]);
        bench.steps(1);
    }
    let pulled = nodes(&bench).iter().map(|node| node.y).fold(0.0, f64::min);
    close(pulled, -0.2, 0.03);
    bench.0.command_actuator(ActuatorId::new(0), &ActuatorCommand::default());
    assert!(!bench.0.scene().actuators[ActuatorId::new(0)].is_actuated());
    bench.steps(3000);
    assert!(nodes(&bench).iter().all(|node| node.y.abs() < 0.1), "it swings back");
}

#[test]
fn a_node_can_be_picked_and_dragged() {
    let mut bench = cloth_and_hand("picked");
    let goal = Vector3::new(0.25, 0.3, 0.6);
    assert_eq!(bench.0.pick_soft_node(SoftBodyId::new(0), &Vector3::new(9.0, 9.0, 9.0), 0.1, goal), None);
    let node = bench.0.pick_soft_node(SoftBodyId::new(0), &Vector3::new(0.3, 0.0, 0.6), 0.1, goal).expect("a node");
    bench.steps(500);
    assert!((nodes(&bench)[node] - goal).norm() < 0.1, "{}", nodes(&bench)[node]);
    bench.0.drag_soft_node(SoftBodyId::new(0), node, None);
    bench.steps(3000);
    assert!((nodes(&bench)[node] - goal).norm() > 0.2);
}

#[test]
fn bad_elements_are_dropped_with_a_reason() {
    let model = "bodies: [BODY A]\nsensors: [S1, S2]\nactuators: [C]\nvehicles: [V1, V2]\nghost objects: [G]\n\
                 soft bodies: [F]\n\
                 BODY A: {name: A, mass: 0}\n\
                 S1: {name: S1, type: Proximity, parent: BODY Nobody, array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 1, y: 0, z: 0}}]}\n\
                 S2: {name: S2, type: Resistance, parent: BODY A, mesh: none.stl}\n\
                 C: {name: C, type: Constraint, parent: BODY Nobody}\n\
                 V1: {name: V1, chassis: BODY Nobody, wheels: []}\nV2: {name: V2, chassis: BODY A, wheels: []}\n\
                 G: {name: G, collision mesh: none.obj}\nF: {name: F, mass: 1, mesh: none.obj}\n";
    let Loaded { scene, report } = load_texts(HEAVY, &[model]);
    let text = report.to_string();
    for part in [
        "`S1` is dropped",
        "`S2` is dropped",
        "`C` is dropped",
        "`V1` is dropped",
        "`V2` is dropped",
        "`G` is",
        "`F` is",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let n = scene.sensors.len() + scene.actuators.len() + scene.vehicles.len() + scene.ghosts.len();
    assert_eq!(n + scene.soft_bodies.len(), 0);
    let mut simulation = Simulation::new(scene, DT);
    simulation.update(DT).unwrap();
}

#[test]
fn objects_are_visited_by_model_type_and_name() {
    let mut bench = hand();
    let hub = bench.0.connect();
    let kinds: Vec<_> = hub.objects().iter().map(|object| object.info.kind.clone()).collect();
    assert!(matches!(kinds[0], ObjectKind::World));
    let count = |wanted: fn(&ObjectKind) -> bool| kinds.iter().filter(|kind| wanted(kind)).count();
    assert_eq!(count(|kind| matches!(kind, ObjectKind::Sensor(..))), 1);
    assert_eq!(count(|kind| matches!(kind, ObjectKind::Actuator(..))), 1);
    assert_eq!(count(|kind| matches!(kind, ObjectKind::RigidBody(..))), 3);
}
