//! Models that come and go while the simulation runs.

mod physics_common;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_core::comm::{ActuatorCommand, Hub, HubIndex, ObjectKind, RigidBodyCommand};
use ambf_core::ids::{ActuatorId, BodyId, SensorId};
use ambf_core::scene::PreparedModel;
use ambf_core::sim::{AddedModel, Control, ModelError, Runner, RunnerOptions, Simulation};
use nalgebra::{Isometry3, Vector3};
use physics_common::{close, load_texts, Bench, DT, HEAVY};

const PENDULUM: &str = "bodies: [BODY Base, BODY Arm]\njoints: [J]\nnamespace: /p/\n\
    BODY Base: {name: Base, mass: 0}\n\
    BODY Arm: {name: Arm, mass: 1, location: {position: {x: 0.5, y: 0, z: 0}}, inertia: {ix: 0.01, iy: 0.01, iz: 0.01}}\n\
    J: {name: J, type: revolute, parent: BODY Base, child: BODY Arm, parent pivot: {x: 0, y: 0, z: 0}, \
    child pivot: {x: -0.5, y: 0, z: 0}, parent axis: {x: 0, y: 1, z: 0}, child axis: {x: 0, y: 1, z: 0}, enable feedback: true}\n";

const GUEST: &str = "bodies: [BODY Ball]\nsensors: [S]\nnamespace: /g/\n\
    BODY Ball: {name: Ball, mass: 2, location: {position: {x: 9, y: 0, z: 0}}, collision shape: Sphere, collision geometry: {radius: 0.1}}\n\
    S: {name: S, type: Proximity, parent: BODY Ball, array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 0, y: 0, z: -1}}]}\n";

/// A folder with one file.
struct File(PathBuf);

impl File {
    fn new(name: &str, text: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("ambf_models_{}_{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("model.yaml"), text).unwrap();
        Self(folder.join("model.yaml"))
    }

    fn read(&self) -> PreparedModel {
        PreparedModel::read(&self.0).unwrap_or_else(|error| panic!("{error}"))
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(self.0.parent().expect("a folder"));
    }
}

fn simulation(models: &[&str]) -> Simulation {
    let loaded = load_texts(HEAVY, models);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Simulation::new(loaded.scene, DT)
}

#[test]
fn a_guest_changes_nothing_for_the_others() {
    let guest = File::new("guest", GUEST);
    let (mut alone, mut host) = (Bench::new(HEAVY, PENDULUM), Bench::new(HEAVY, PENDULUM));
    for step in 0..600 {
        match step {
            100 => {
                let added = host.0.add_model(guest.read());
                assert_eq!((added.incomplete, added.report.as_str()), (false, ""));
                assert_eq!(added.key, "/g/model.yaml");
            }
            300 => assert_eq!(host.0.remove_model("/g/model.yaml"), Ok("/g/model.yaml".into())),
            _ => (),
        }
        alone.update(DT);
        host.update(DT);
        assert_eq!(alone.pose("Arm"), host.pose("Arm"), "step {step}");
        assert_eq!(alone.joint("J").position, host.joint("J").position);
        assert_eq!(alone.0.wrenches().as_slice()[..2], host.0.wrenches().as_slice()[..2]);
        if step == 299 {
            close(host.velocity("Ball").0.z, -2.0, 0.02);
            assert!(!host.0.scene().sensors[SensorId::new(0)].readings()[0].triggered);
        }
    }
}

fn position_of(hub: &Hub, identifier: &str) -> HubIndex {
    let objects = hub.objects();
    let found = objects.entries().find(|(_, object)| object.info.identifier == identifier && !object.is_removed());
    let found = found.map(|(position, _)| position);
    found.unwrap_or_else(|| panic!("no {identifier}"))
}

#[test]
fn copies_get_suffixes_and_the_hub_follows() {
    let guest = File::new("copies", GUEST);
    let mut simulation = simulation(&[PENDULUM]);
    let hub = simulation.connect();
    let known = hub.objects().len();
    let keys: Vec<_> = (0..2).map(|_| simulation.add_model(guest.read()).key).collect();
    assert_eq!(keys, ["/g/model.yaml", "/g/model.yaml1"]);
    assert_eq!(hub.objects().len(), known + 4);
    let names: Vec<_> = hub.objects().iter().skip(known).map(|object| object.info.name.clone()).collect();
    assert_eq!(names, ["Ball", "S", "Ball1", "S1"]);
    let first = position_of(&hub, "/g/BODY Ball");
    assert!(simulation.remove_model("model.yaml").is_err(), "the name of two");
    simulation.remove_model(&keys[0]).unwrap();
    assert!(hub.objects()[first].is_removed() && hub.objects()[HubIndex(first.0 + 1)].is_removed());
    // What is left for what is gone is not read.
    hub.post(first, &RigidBodyCommand { force: Vector3::x(), ..RigidBodyCommand::default() }).unwrap();
    simulation.update(DT).unwrap();
    // The name is free again.
    assert_eq!(simulation.add_model(guest.read()).key, keys[0]);
    let again = position_of(&hub, "/g/BODY Ball");
    assert!(
        again > first
            && matches!(hub.objects()[again].info.kind, ObjectKind::RigidBody(index, _) if index == BodyId::new(4))
    );
}

/// A simulator that runs for days keeps the place of a model that was removed, but not what the model was made from.
#[test]
fn little_is_kept_of_models_that_were_removed() {
    let guest = File::new("forgotten", GUEST);
    let mut simulation = simulation(&[PENDULUM]);
    let hub = simulation.connect();
    let mut descriptions = Vec::new();
    for _ in 0..50 {
        let key = simulation.add_model(guest.read()).key;
        let model = simulation.scene().models.iter().last().expect("it was added");
        assert_eq!((model.description.bodies.len(), model.description.sensors.len()), (1, 1));
        descriptions.push(Arc::downgrade(&model.description));
        let ball = position_of(&hub, "/g/BODY Ball");
        hub.post(ball, &RigidBodyCommand { force: Vector3::x(), ..RigidBodyCommand::default() }).unwrap();
        simulation.update(DT).unwrap();
        simulation.remove_model(&key).unwrap();
    }
    let kept = descriptions.iter().filter(|description| description.strong_count() > 0).count();
    assert_eq!(kept, 0, "descriptions of removed models are kept");
    let mut removed = simulation.scene().models.iter().filter(|model| model.removed).map(|model| &model.description);
    let names = removed.clone().map(|description| (description.name.as_str(), &*description.file));
    assert!(names.clone().all(|name| name == ("model.yaml", &*guest.0)) && names.count() == 50);
    assert!(removed.all(|description| description.bodies.is_empty() && description.sensors.is_empty()));
    let visuals = hub.visuals().expect("a scene");
    let gone = visuals.bodies.iter().filter(|body| body.object.removed);
    assert!(gone.clone().all(|body| body.visual().is_none()) && gone.count() == 50);
}

#[test]
fn what_leads_into_a_model_goes_with_it() {
    let guest = File::new("held", GUEST);
    let holder =
        "bodies: [BODY Hand]\nactuators: [A]\ncameras: [C]\nnamespace: /h/\nBODY Hand: {name: Hand, mass: 0}\n\
                  A: {name: A, type: Constraint, parent: BODY Hand}\n\
                  C: {name: C, parent: BODY Ball, location: {x: 1, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}}\n";
    let mut simulation = simulation(&[holder]);
    simulation.add_model(guest.read());
    let camera = |simulation: &Simulation| {
        let attached = &simulation.scene().cameras.iter().last().expect("a camera").attached;
        (attached.parent.is_some(), simulation.scene().global_pose(attached.parent, &attached.pose))
    };
    assert!(camera(&simulation).0, "it waited for its parent");
    let command = ActuatorCommand { actuate: true, body_name: "BODY Ball".into(), ..Default::default() };
    assert_eq!(simulation.command_actuator(ActuatorId::new(0), &command), None);
    assert!(simulation.scene().actuators[ActuatorId::new(0)].is_actuated());
    (0..50).for_each(|_| simulation.update(DT).unwrap());
    let before = camera(&simulation).1;
    simulation.remove_model("/g/model.yaml").unwrap();
    assert!(!simulation.scene().actuators[ActuatorId::new(0)].is_actuated());
    assert_eq!(camera(&simulation), (false, before), "it stays where it was");
    assert!(simulation.command_actuator(ActuatorId::new(0), &command).expect("a message").contains("BODY Ball"));
    (0..50).for_each(|_| simulation.update(DT).unwrap());
    // The list of constraints is as long as before, however often something is held.
    for _ in 0..100 {
        simulation.command_actuator(
            ActuatorId::new(0),
            &ActuatorCommand { body_name: "BODY Hand".into(), ..command.clone() },
        );
        simulation.command_actuator(ActuatorId::new(0), &ActuatorCommand::default());
    }
    assert!(simulation.scene().world.constraints().len() <= 1);
}

#[test]
fn a_joint_to_another_model_goes_with_either() {
    let bridge = File::new(
        "bridge",
        "bodies: [BODY Tip]\njoints: [K]\nnamespace: /b/\nBODY Tip: {name: Tip, mass: 1, location: {position: {x: 1, y: 0, z: 0}}}\n\
         K: {name: K, type: revolute, parent: BODY Arm, child: BODY Tip, parent pivot: {x: 0.5, y: 0, z: 0}, \
         child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 1, z: 0}, child axis: {x: 0, y: 1, z: 0}}\n",
    );
    let mut bench = Bench::new(HEAVY, PENDULUM);
    let added = bench.0.add_model(bridge.read());
    assert!(added.report.contains("is taken from another model"), "{}", added.report);
    assert_eq!(bench.0.scene().active_joints(BodyId::new(0)).len(), 2);
    bench.steps(200);
    let apart = bench.pose("Arm").inverse() * bench.pose("Tip");
    close((apart.translation.vector - Vector3::new(0.5, 0.0, 0.0)).norm(), 0.0, 2e-3);
    bench.0.remove_model("/b/").unwrap();
    assert_eq!(bench.0.scene().active_joints(BodyId::new(0)).len(), 1);
    bench.steps(200);
    assert!(bench.pose("Arm") != Isometry3::identity());
}

#[test]
fn what_cannot_be_removed_or_added_is_said() {
    let mut simulation = simulation(&[PENDULUM]);
    for name in ["nobody", "", "built-in"] {
        assert!(matches!(simulation.remove_model(name), Err(ModelError::Unknown { .. })), "{name}");
    }
    assert!(PreparedModel::read(Path::new("no/such.yaml")).err().expect("an error").contains("no/such.yaml"));
    let soft = File::new("soft", "soft bodies: [F]\nF: {name: F, mass: 1, mesh: sheet.obj}\n");
    std::fs::write(soft.0.with_file_name("sheet.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let added = simulation.add_model(soft.read());
    assert!(added.incomplete && added.report.contains("began with one"), "{added:?}");
}

#[test]
fn a_running_simulation_takes_requests_even_while_paused() {
    let guest = File::new("running", GUEST);
    let mut simulation = simulation(&[PENDULUM]);
    let (hub, models) = (simulation.connect(), simulation.models());
    hub.set_listening();
    let runner = Runner::start(simulation, RunnerOptions::default());
    let pause: &Control = runner.control();
    pause.set_paused(true);
    let AddedModel { key, .. } = models.add(&guest.0).unwrap();
    assert_eq!(models.list().unwrap().len(), 3, "the environment, the pendulum and the guest");
    let ball = position_of(&hub, "/g/BODY Ball");
    let ObjectKind::RigidBody(index, _) = hub.objects()[ball].info.kind.clone() else { panic!("no body") };
    let height = |hub: &Hub| hub.snapshot().as_ref().and_then(|s| s.bodies.get(index).map(|b| b.origin[2]));
    let begin = std::time::Instant::now();
    while height(&hub).is_none() && begin.elapsed().as_secs() < 10 {
        std::thread::yield_now();
    }
    assert_eq!(height(&hub), Some(0.0), "paused");
    pause.set_paused(false);
    while height(&hub) > Some(-0.01) && begin.elapsed().as_secs() < 20 {
        std::thread::yield_now();
    }
    assert!(height(&hub) <= Some(-0.01), "it falls");
    assert_eq!(models.remove(&key).unwrap(), key);
    assert!(hub.objects()[ball].is_removed());
    drop(runner.stop());
    assert_eq!(models.remove(&key), Err(ModelError::NoAnswer));
}
