//! Models that come and go while the simulation runs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::physics_common::{close, load_texts, Bench, DT, HEAVY};
use ambf_core::comm::{ActuatorCommand, Hub, HubIndex, ObjectKind, RigidBodyCommand};
use ambf_core::ids::{ActuatorId, BodyId, ModelId, SensorId};
use ambf_core::scene::PreparedModel;
use ambf_core::sim::{AddedModel, Control, ModelError, Runner, RunnerOptions, Simulation};
use nalgebra::{Isometry3, Vector3};

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
                let added = host.0.add_model(guest.read()).expect("something is built");
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
    let keys: Vec<_> = (0..2).map(|_| simulation.add_model(guest.read()).expect("something is built").key).collect();
    assert_eq!(keys, ["/g/model.yaml", "/g/model.yaml1"]);
    assert_eq!(hub.objects().len(), known + 4);
    let names: Vec<_> = hub.objects().iter().skip(known).map(|object| object.info.name.clone()).collect();
    assert_eq!(names, ["Ball", "S", "Ball1", "S1"]);
    let first = position_of(&hub, "/g/BODY Ball");
    let body_at = |object: HubIndex| match hub.objects()[object].info.kind {
        ObjectKind::RigidBody(body, _) => body,
        _ => panic!("no body"),
    };
    let body = body_at(first);
    assert!(simulation.remove_model("model.yaml").is_err(), "the name of two");
    simulation.remove_model(&keys[0]).unwrap();
    assert!(hub.objects()[first].is_removed() && hub.objects()[HubIndex(first.0 + 1)].is_removed());
    // What is left for what is gone is not read.
    hub.post(first, &RigidBodyCommand { force: Vector3::x(), ..RigidBodyCommand::default() }).unwrap();
    simulation.update(DT).unwrap();
    // The name is free again.
    assert_eq!(simulation.add_model(guest.read()).expect("something is built").key, keys[0]);
    let again = position_of(&hub, "/g/BODY Ball");
    assert!(again > first, "a position in the hub names one object for good");
    assert_eq!(body_at(again), body, "a place in the scene is used again");
}

/// A simulator may add and remove models for days.
#[test]
fn nothing_is_kept_of_models_that_were_removed() {
    let guest = File::new("forgotten", GUEST);
    let mut simulation = simulation(&[PENDULUM]);
    let hub = simulation.connect();
    hub.set_listening();
    let mut descriptions = Vec::new();
    for _ in 0..50 {
        let key = simulation.add_model(guest.read()).expect("something is built").key;
        let model = simulation.scene().models.iter().find(|model| !model.removed && model.key == key);
        let model = model.expect("it was added");
        assert_eq!((model.description.bodies.len(), model.description.sensors.len()), (1, 1));
        descriptions.push(Arc::downgrade(&model.description));
        let ball = position_of(&hub, "/g/BODY Ball");
        hub.post(ball, &RigidBodyCommand { force: Vector3::x(), ..RigidBodyCommand::default() }).unwrap();
        simulation.update(DT).unwrap();
        simulation.remove_model(&key).unwrap();
    }
    let kept = descriptions.iter().filter(|description| description.strong_count() > 0).count();
    assert_eq!(kept, 0, "descriptions of removed models are kept");
    // The places of one, and its number and the one before.
    let scene = simulation.scene();
    let places = (scene.bodies.len(), scene.sensors.len(), scene.joints.len(), scene.models.len());
    assert_eq!(places, (3, 1, 1, 4));
    assert_eq!(scene.world.bodies().len(), 3);
    let snapshot = simulation.snapshot();
    assert_eq!((snapshot.bodies.len(), snapshot.sensors.len()), (3, 1));
    let visuals = hub.visuals().expect("a scene");
    let gone = visuals.bodies.iter().filter(|body| body.object.removed);
    assert!(gone.clone().all(|body| body.visual().is_none()) && gone.count() == 1);
    let removed: Vec<_> = hub.objects().iter().filter(|object| object.is_removed()).cloned().collect();
    assert!(removed.len() == 100 && removed.iter().all(|object| Arc::ptr_eq(object, &removed[0])));
}

/// Models of several kinds come and go in an order that a generator of random numbers gives: each object is found under
/// its own name, moves as it should, and the others do not notice.
#[test]
fn models_that_take_the_places_of_others_are_themselves() {
    let slider = "bodies: [BODY Rail, BODY Cart]\njoints: [K]\ncameras: [C]\nactuators: [A]\nnamespace: /s/\n\
        BODY Rail: {name: Rail, mass: 0, location: {position: {x: 20, y: 0, z: 0}}}\n\
        BODY Cart: {name: Cart, mass: 3, location: {position: {x: 20, y: 0, z: 0}}, inertia: {ix: 0.1, iy: 0.1, iz: 0.1}}\n\
        K: {name: K, type: prismatic, parent: BODY Rail, child: BODY Cart, parent pivot: {x: 0, y: 0, z: 0}, \
        child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}}\n\
        C: {name: C, parent: BODY Cart, location: {x: 1, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}}\n\
        A: {name: A, type: Constraint, parent: BODY Cart}\n";
    // Without a shape: several are at one place.
    let ball = GUEST
        .replace("collision shape: Sphere, collision geometry: {radius: 0.1}", "inertia: {ix: 0.1, iy: 0.1, iz: 0.1}");
    let kinds = [("Ball", File::new("balls", &ball)), ("Cart", File::new("sliders", slider))];
    let (mut alone, mut host) = (Bench::new(HEAVY, PENDULUM), Bench::new(HEAVY, PENDULUM));
    let hub = host.0.connect();
    hub.set_listening();
    let mut random = 1_u64;
    let mut below = |n: u64| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) % n
    };
    // Key of the model, its body, where the body is commanded and seen, and the steps since then.
    let mut guests: Vec<(String, &str, HubIndex, BodyId, u32)> = Vec::new();
    for _ in 0..200 {
        if guests.len() == 4 || (guests.len() > 1 && below(2) == 0) {
            let gone = guests.swap_remove(below(guests.len() as u64) as usize);
            host.0.remove_model(&gone.0).expect("it is there");
            assert!(hub.objects()[gone.2].is_removed());
            // What comes too late moves nobody.
            hub.post(gone.2, &RigidBodyCommand::wrench(Vector3::x() * 1e3, Vector3::zeros())).expect("finite");
        } else {
            let (name, file) = &kinds[below(2) as usize];
            let known = hub.objects().len();
            let key = host.0.add_model(file.read()).expect("something is built").key;
            let objects = hub.objects().clone();
            let new = objects.entries().skip(known).find(|(_, object)| object.info.name.starts_with(name));
            let (position, object) = new.expect("its body");
            let ObjectKind::RigidBody(body, _) = object.info.kind else { panic!("no body") };
            guests.push((key, name, position, body, 0));
        }
        for _ in 0..5 {
            alone.update(DT);
            host.update(DT);
            guests.iter_mut().for_each(|guest| guest.4 += 1);
        }
        assert_eq!(alone.pose("Arm"), host.pose("Arm"));
        assert_eq!(alone.joint("J").position, host.joint("J").position);
        let scene = host.0.scene();
        let snapshot = host.0.snapshot();
        for (key, name, _, body, steps) in &guests {
            let identity = &scene.bodies[*body].identity;
            assert!(*identity.name == **name && scene.models[identity.model].key == *key, "{key}: {identity:?}");
            let state = &snapshot.bodies[*body];
            let fallen = -0.5 * 10.0 * (f64::from(*steps) * DT).powi(2);
            let x = if *name == "Ball" { 9.0 } else { 20.0 };
            assert!((state.origin[2] - fallen).abs() < 0.02 + 0.02 * fallen.abs(), "{key}: {state:?}, {fallen}");
            assert!((state.origin[0] - x).abs() < 1e-3, "{key}: {state:?}");
        }
    }
    let scene = host.0.scene();
    let live = |model: &ModelId| !scene.models[*model].removed;
    // Four copies of each kind have their places.
    assert!(scene.bodies.len() <= 2 + 4 + 4 * 2 && scene.joints.len() <= 1 + 4 && scene.sensors.len() <= 4);
    assert!(scene.cameras.len() <= 1 + 4 && scene.models.len() <= 2 + 2 * 4 * 2, "{}", scene.models.len());
    assert_eq!(scene.models.ids().filter(live).count(), 2 + guests.len());
}

/// Who has the id of an object finds that object or none.
#[test]
fn only_the_same_model_takes_the_places_of_a_removed_one() {
    let guest = File::new("same", GUEST);
    let mut simulation = simulation(&[PENDULUM]);
    let body_of = |simulation: &mut Simulation, file: &File| {
        let key = simulation.add_model(file.read()).expect("something is built").key;
        simulation.remove_model(&key).expect("it is there");
        let mut balls = simulation.scene().bodies.entries().filter(|(_, body)| &*body.identity.name == "Ball");
        balls.next_back().map(|(id, _)| id)
    };
    let first = body_of(&mut simulation, &guest);
    assert!(first.is_some());
    assert_eq!(body_of(&mut simulation, &guest), first);
    let other = File::new("same-other", GUEST);
    assert_ne!(body_of(&mut simulation, &other), first, "another file with the same key");
    std::fs::write(&guest.0, GUEST.replace("mass: 2", "mass: 3")).expect("written");
    assert_ne!(body_of(&mut simulation, &guest), first, "the file has changed");
    assert_eq!(simulation.scene().bodies.iter().filter(|body| &*body.identity.name == "Ball").count(), 3);
}

/// What hung on a model that is gone does not move over to the one that comes after it.
#[test]
fn what_stood_on_a_removed_body_stays_gone() {
    let guest = File::new("stood-on", GUEST);
    let eye = "sensors: [E]\nnamespace: /e/\n\
        E: {name: E, type: Proximity, parent: BODY Ball, array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 0, y: 0, z: -1}}]}\n";
    let mut simulation = simulation(&[PENDULUM]);
    let hub = simulation.connect();
    simulation.add_model(guest.read()).expect("something is built");
    simulation.add_model(File::new("eye", eye).read()).expect("something is built");
    let eye = position_of(&hub, "/e/E");
    simulation.remove_model("/g/model.yaml").expect("it is there");
    assert!(hub.objects()[eye].is_removed());
    simulation.add_model(guest.read()).expect("something is built");
    assert!(hub.objects()[eye].is_removed());
    let visuals = hub.visuals().expect("a scene");
    let eye = visuals.sensors.iter().find(|sensor| &*sensor.object.name == "E").expect("its place");
    assert!(eye.object.removed);
    let ball = visuals.bodies.iter().find(|body| &*body.object.name == "Ball" && !body.object.removed);
    assert!(ball.is_some());
    (0..50).for_each(|_| simulation.update(DT).unwrap());
}

/// The joints of a model go with it, also those between bodies of others.
#[test]
fn a_joint_between_other_models_goes_with_its_own() {
    let brace = File::new(
        "brace",
        "joints: [B]\nnamespace: /p/\nB: {name: B, type: fixed, parent: BODY Base, child: BODY Arm, \
         parent pivot: {x: 0.5, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 1, z: 0}, \
         child axis: {x: 0, y: 1, z: 0}}\n",
    );
    let mut bench = Bench::new(HEAVY, PENDULUM);
    let added = bench.0.add_model(brace.read()).expect("something is built");
    assert!(!added.incomplete, "{}", added.report);
    bench.steps(200);
    assert!(bench.position("Arm").z.abs() < 0.01, "it is held");
    bench.0.remove_model(&added.key).expect("it is there");
    bench.steps(200);
    assert!(bench.position("Arm").z < -0.05, "{}", bench.position("Arm").z);
}

#[test]
fn what_leads_into_a_model_goes_with_it() {
    let guest = File::new("held", GUEST);
    let holder =
        "bodies: [BODY Hand]\nactuators: [A]\ncameras: [C]\nnamespace: /h/\nBODY Hand: {name: Hand, mass: 0}\n\
                  A: {name: A, type: Constraint, parent: BODY Hand}\n\
                  C: {name: C, parent: BODY Ball, location: {x: 1, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}}\n";
    let mut simulation = simulation(&[holder]);
    simulation.add_model(guest.read()).expect("something is built");
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
    let added = bench.0.add_model(bridge.read()).expect("something is built");
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
    // It used to be added, with nothing in it.
    let objects = simulation.scene().objects().len();
    let error = simulation.add_model(soft.read()).expect_err("all of it is dropped").to_string();
    assert!(error.starts_with("nothing of the model could be built:\n") && error.contains("began with one"), "{error}");
    let body = File::new("body", "bodies: [B]\nB: {name: B, mass: -1}\n");
    let error = simulation.add_model(body.read()).expect_err("all of it is dropped").to_string();
    assert!(error.contains("model.yaml:2") && error.contains("`B"), "{error}");
    assert_eq!(simulation.scene().objects().len(), objects);
    let half = File::new("half", "bodies: [A, B]\nA: {name: A, mass: 0}\nB: {name: B, mass: -1}\n");
    let added = simulation.add_model(half.read()).expect("A is built");
    assert!(added.incomplete && added.report.contains("`B"), "{added:?}");
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
