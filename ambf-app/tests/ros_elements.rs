//! The ROS side of sensors, actuators, vehicles, soft bodies and ghost objects, and of models that come and go.

use ambf_core::ids::{BodyId, CameraId, GhostId, LightId};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, OnceLock};

use ambf_app::ros::messages::{ambf_msgs, std_msgs};
use ambf_app::ros::{ModelHost, ModelReply};
use ambf_core::comm::{
    self, ActuatorCommand, CameraParameters, Hub, HubIndex, HubObject, Inbox, LightParameters, Middleware, ObjectKind,
    Rates, SensorCommand, SoftBodyCommand, VehicleCommand,
};
use ambf_test_support::ros::*;
use dxr::Value;
use nalgebra::Vector3;
use rosrust::api::Ros;
use rosrust::{Message, RosMsg};

const NS: &str = "/ambf/env/";

/// One simulator for all tests of this file, since a process has one `ROS_MASTER_URI`; each test adds objects of its
/// own.
struct Fixture {
    master: String,
    hub: Arc<Hub>,
    client: Ros,
}

/// Keeps a list of models.
#[derive(Default)]
struct Models(Mutex<Vec<(String, PathBuf)>>);

impl ModelHost for Models {
    fn add(&self, file: &Path) -> Result<ModelReply, String> {
        let model = file.file_stem().and_then(|stem| stem.to_str()).ok_or("this is no file")?.to_owned();
        let mut models = self.0.lock().unwrap();
        models.push((model.clone(), file.to_owned()));
        Ok(ModelReply { model, message: format!("{} now", models.len()) })
    }

    fn remove(&self, model: &str) -> Result<String, String> {
        let mut models = self.0.lock().unwrap();
        let position = models.iter().position(|(name, _)| name == model).ok_or(format!("there is no \"{model}\""))?;
        models.remove(position);
        Ok(String::new())
    }

    fn list(&self) -> Vec<(String, PathBuf)> {
        self.0.lock().unwrap().clone()
    }
}

fn fixture() -> &'static Fixture {
    static FIXTURE: OnceLock<(Fixture, Mutex<Simulator>)> = OnceLock::new();
    let (fixture, _) = FIXTURE.get_or_init(|| {
        let master = use_own_master();
        let mut list = objects(NS, 2, Rates::default());
        list.extend(elements(NS));
        let simulator = Simulator::start_with(list, |ros| ros.with_models(Arc::new(Models::default())));
        until("the last topic", || system_state_mentions(&master, "/ambf/env/Water/Command"));
        let client = Ros::new("tester").unwrap();
        (Fixture { master, hub: Arc::clone(&simulator.hub), client }, Mutex::new(simulator))
    });
    fixture
}

impl Fixture {
    /// The first state of type `M` on `topic`, whose checksum is to be `md5sum`.
    fn state<M: Message>(&self, topic: &str, md5sum: &str) -> M {
        let mut raw = RawSubscriber::connect(&publisher_of(&self.master, topic), topic);
        assert_eq!((raw.header["type"].clone(), raw.header["md5sum"].as_str()), (M::msg_type(), md5sum));
        assert!(raw.read_block().is_some());
        let newest = Arc::new(Mutex::new(None));
        let slot = Arc::clone(&newest);
        let _subscriber = self.client.subscribe(topic, 10, move |m: M| *slot.lock().unwrap() = Some(m)).unwrap();
        until(&format!("a state on {topic}"), || newest.lock().unwrap().is_some());
        let state = newest.lock().unwrap().take();
        state.unwrap()
    }

    /// The command in the mailbox of the object called `name` in `namespace` after `message` was sent.
    fn command<M: Message, C: comm::Command + Clone>(&self, namespace: &str, name: &str, message: M) -> C {
        let publisher = self.client.publish::<M>(&format!("{namespace}{name}/Command"), 10).unwrap();
        until("the simulator listens", || publisher.subscriber_count() > 0);
        publisher.send(message).unwrap();
        let objects = self.hub.objects().clone();
        let positions = self.positions(namespace);
        let object = positions.into_iter().map(|i| &objects[i]).find(|object| object.info.name == name).unwrap();
        let mut inbox = Inbox::<C>::default();
        until("the command", || inbox.fetch(C::mailbox(&object.channel), 0));
        inbox.command().clone()
    }

    /// Positions in the hub of those in `namespace`.
    fn positions(&self, namespace: &str) -> Vec<HubIndex> {
        let objects = self.hub.objects().clone();
        let is_there = |object: &HubObject| object.info.namespace == namespace && !object.is_removed();
        objects.entries().filter(|(_, object)| is_there(object)).map(|(position, _)| position).collect()
    }

    fn parameter(&self, name: &str) -> Option<Value> {
        call(&self.master, "getParam", vec![text(name)])
    }
}

#[test]
fn states_of_every_type_are_published() {
    let fixture = fixture();
    let eye: ambf_msgs::SensorState = fixture.state("/ambf/env/Eye/State", "e405887246b5afd9e382d4a7a0f69926");
    assert_eq!((eye.type_.data.as_str(), eye.parent_name.data.as_str()), ("PROXIMITY", "BODY Box0"));
    assert_eq!((eye.count, eye.range, eye.measurement), (2, vec![2.0], vec![0.75, 0.0]));
    assert_eq!((eye.triggered, eye.sensed_objects[0].data.as_str()), (vec![true, false], "Box0"));
    assert_eq!(eye.pose.position.z, 0.25);
    let hand: ambf_msgs::ActuatorState = fixture.state("/ambf/env/Hand/State", "bb54291f69633b7821b7930b1ec68d2b");
    assert!(hand.actuated && hand.pose.position.z == 0.25);
    let car: ambf_msgs::VehicleState = fixture.state("/ambf/env/Car/State", "0196943764f0cf7865b5798046e2027c");
    assert_eq!((car.mass, car.wheel_count, car.wheel_offsets[1].position.x), (20.0, 2, -1.0));
    let cloth: ambf_msgs::SoftBodyState = fixture.state("/ambf/env/Cloth/State", "3dc87d37c7ec8f949bfbd135c2cfe5a8");
    assert_eq!((cloth.mass, cloth.userdata), (4.0, vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0]));
    let touch: ambf_msgs::ContactSensorState =
        fixture.state("/ambf/env/Touch/State", "69bafc7aa5201075354dea9d8be980d5");
    let [event] = &touch.contact_events[..] else { panic!("{touch:?}") };
    assert_eq!((event.object_name.data.as_str(), event.contact_data[0].distance.data), ("/ambf/env/KEY Box1", -0.5));
    let water: ambf_msgs::GhostObjectState = fixture.state("/ambf/env/Water/State", "415d13a1e544582332f8da23ceee6c2f");
    assert_eq!((water.pose.position.x, water.sensed_objects[0].data.as_str()), (7.0, "/ambf/env/KEY Box1"));
    assert!(water.sim_step > 0 && water.identifier.data == "/ambf/env/KEY Water");
}

#[test]
fn commands_of_every_type_reach_the_hub() {
    let fixture = fixture();
    let _: SensorCommand =
        fixture.command(NS, "Eye", ambf_msgs::SensorCmd { actuate: vec![true], ..Default::default() });
    let body_name = std_msgs::String { data: "Box1".into() };
    let grasp = ambf_msgs::ActuatorCmd { actuate: true, body_name, ..Default::default() };
    let grasp: ActuatorCommand = fixture.command(NS, "Hand", grasp);
    assert_eq!((grasp.actuate, grasp.body_name.as_str()), (true, "Box1"));
    let drive = ambf_msgs::VehicleCmd { wheel_power: vec![1.0; 9], brake: true, ..Default::default() };
    let drive: VehicleCommand = fixture.command(NS, "Car", drive);
    assert_eq!((drive.power, drive.full_brake), (vec![1.0; 2], true));
    let mut push = ambf_msgs::SoftBodyCmd { enable_position_controller: true, ..Default::default() };
    push.wrench.force.y = 3.0;
    let push: SoftBodyCommand = fixture.command(NS, "Cloth", push);
    assert_eq!(push.force, Vector3::new(0.0, 3.0, 0.0));
    let _: SensorCommand = fixture.command(NS, "Touch", ambf_msgs::ContactSensorCmd::default());
    let _: SensorCommand = fixture.command(NS, "Water", ambf_msgs::GhostObjectCmd::default());
}

#[test]
fn objects_come_and_go_and_leave_nothing_behind() {
    let fixture = fixture();
    let namespace = "/ambf/env/late/";
    let add = |near_plane: f64| {
        let camera = CameraParameters { near_plane, ..Default::default() };
        let light = LightParameters { cutoff_angle: 0.5, ..Default::default() };
        let mut list = vec![object(ObjectKind::RigidBody(BodyId::new(1), Box::default()), namespace, "Ball")];
        list.push(object(ObjectKind::Camera(CameraId::new(0), Box::new(camera)), namespace, "cam"));
        list.push(object(ObjectKind::Light(LightId::new(0), Box::new(light)), namespace, "light"));
        list.extend(elements(namespace));
        fixture.hub.add_objects(list);
        until("the topics", || system_state_mentions(&fixture.master, "/ambf/env/late/Water/Command"));
        until("the parameters", || {
            fixture.parameter("/ambf/env/late/cam/near_plane") == Some(Value::Double(near_plane))
                && fixture.parameter("/ambf/env/late/light/type").is_some()
        });
    };
    let remove = || {
        fixture.hub.remove_objects(fixture.positions(namespace));
        until("the topics are gone", || !system_state_mentions(&fixture.master, "/ambf/env/late"));
        until("the parameters are gone", || {
            let names = call(&fixture.master, "getParamNames", vec![]);
            names.is_some_and(|names| {
                let names = format!("{names:?}");
                !names.contains("/late/cam") && !names.contains("/late/light")
            })
        });
    };
    let listed = ("/ambf/env/late/Ball/State".to_owned(), "ambf_msgs/RigidBodyState".to_owned());
    add(0.1);
    assert!(published_topics(&fixture.master).contains(&listed));
    let node = publisher_of(&fixture.master, "/ambf/env/late/Ball/State");
    let mut states = RawSubscriber::connect(&node, "/ambf/env/late/Ball/State");
    assert!(states.read_block().is_some());
    remove();
    while states.read_block().is_some() {}
    assert!(!published_topics(&fixture.master).contains(&listed));

    let before = resources();
    for near_plane in [0.2, 0.3, 0.4] {
        add(near_plane);
        remove();
    }
    // 3 x 18 topics have come and gone, with two threads each; other tests open and close connections meanwhile.
    until("threads and files as before", || {
        let now = resources();
        now.0 < before.0 + 40 && now.1 < before.1 + 40
    });
    println!("threads and files: {before:?} before, {:?} after", resources());

    add(0.5);
    let _: SensorCommand = fixture.command(namespace, "Eye", ambf_msgs::SensorCmd::default());
    let state: ambf_msgs::RigidBodyState =
        fixture.state("/ambf/env/late/Ball/State", "c0ba0eb38f2481828a038f3b17ce0623");
    assert_eq!(state.pose.position.x, 1.0);
    remove();
}

#[test]
fn one_of_two_that_share_their_topics_goes_and_the_other_stays() {
    let fixture = fixture();
    let twin = |identifier: &str| {
        let mut twin = object(ObjectKind::Ghost(GhostId::new(0), Box::default()), "/ambf/env/twins/", "Twin");
        twin.identifier = identifier.into();
        twin
    };
    fixture.hub.add_objects(vec![twin("first")]);
    let first = fixture.positions("/ambf/env/twins/");
    fixture.hub.add_objects(vec![twin("second")]);
    let topic = "/ambf/env/twins/Twin/State";
    let connect = || RawSubscriber::connect(&publisher_of(&fixture.master, topic), topic);
    let who = |states: &mut RawSubscriber| {
        let state = [&[0; 4][..], &states.read_block()?].concat();
        Some(ambf_msgs::GhostObjectState::decode_slice(&state).unwrap().identifier.data)
    };
    let mut states = connect();
    until("the second", || who(&mut states).unwrap() == "second");
    until("the first", || who(&mut states).unwrap() == "first");
    fixture.hub.remove_objects(first);
    // Whoever is connected stays so, and a new subscriber is taken too.
    until("only the second", || (0..20).all(|_| who(&mut states).unwrap() == "second"));
    let mut late = connect();
    assert!((0..20).all(|_| who(&mut late).unwrap() == "second"));
    let _: SensorCommand = fixture.command("/ambf/env/twins/", "Twin", ambf_msgs::GhostObjectCmd::default());
}

#[test]
fn models_are_added_listed_and_removed_by_services() {
    let fixture = fixture();
    let add = fixture.client.client::<ambf_msgs::AddModel>("/ambf/env/World/add_model").unwrap();
    let added = add.req(&ambf_msgs::AddModelReq { file: "models/car.yaml".into() }).unwrap().unwrap();
    assert!(added.success && added.model == "car" && added.message.ends_with(" now"), "{added:?}");
    let list = fixture.client.client::<ambf_msgs::ListModels>("/ambf/env/World/list_models").unwrap();
    let listed = list.req(&ambf_msgs::ListModelsReq {}).unwrap().unwrap();
    let position = listed.models.iter().position(|model| model == "car").unwrap();
    assert_eq!((listed.files[position].as_str(), listed.models.len()), ("models/car.yaml", listed.files.len()));
    let remove = fixture.client.client::<ambf_msgs::RemoveModel>("/ambf/env/World/remove_model").unwrap();
    let request = ambf_msgs::RemoveModelReq { model: "car".into() };
    assert!(remove.req(&request).unwrap().unwrap().success);
    let again = remove.req(&request).unwrap().unwrap();
    assert!(!again.success && again.message.contains("\"car\""), "{again:?}");
    let refused = add.req(&ambf_msgs::AddModelReq { file: String::new() }).unwrap().unwrap();
    assert!(!refused.success && refused.message == "this is no file", "{refused:?}");
}

#[test]
fn debians_rosservice_calls_them() {
    let fixture = fixture();
    let python = concat!(env!("CARGO_TARGET_TMPDIR"), "/ros_python");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let made = Command::new(format!("{root}/scripts/python-messages")).arg(python).stdout(Stdio::null()).status();
    let rosservice = |arguments: &[&str]| {
        let output = Command::new("rosservice").args(arguments).env("PYTHONPATH", python).output().ok()?;
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        Some(String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (Ok(true), Some(listed)) = (made.map(|status| status.success()), rosservice(&["list"])) else {
        println!("skipped: rosservice or genpy is not installed (Debian: python3-rosservice, python3-genpy)");
        return;
    };
    assert!(listed.contains("/ambf/env/World/add_model"), "{listed}");
    let kind = rosservice(&["type", "/ambf/env/World/add_model"]).unwrap();
    assert_eq!(kind.trim(), "ambf_msgs/AddModel");
    let added = rosservice(&["call", "/ambf/env/World/add_model", "models/boat.yaml"]).unwrap();
    assert!(added.contains("success: True") && added.contains("boat"), "{added}");
    let listed = rosservice(&["call", "/ambf/env/World/list_models"]).unwrap();
    assert!(listed.contains("models/boat.yaml"), "{listed}");
    let removed = rosservice(&["call", "/ambf/env/World/remove_model", "boat"]).unwrap();
    assert!(removed.contains("success: True"), "{removed}");
    assert!(fixture.hub.objects().len() > 1);
}

#[test]
fn services_go_with_the_simulator() {
    let fixture = fixture();
    let list = objects("/brief/", 0, Rates::default());
    let mut brief = Simulator::start_with(list, |ros| ros.with_models(Arc::new(Models::default())));
    let names = ["add_model", "remove_model", "list_models"].map(|name| format!("/brief/World/{name}"));
    let lookup = |name: &String| call(&fixture.master, "lookupService", vec![text(name)]);
    until("the services", || names.iter().all(|name| lookup(name).is_some()));
    brief.ros.stop();
    assert!(names.iter().all(|name| lookup(name).is_none()));
    assert!(!system_state_mentions(&fixture.master, "/brief/"));
}
