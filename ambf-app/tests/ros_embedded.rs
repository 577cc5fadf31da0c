//! The ROS side against the embedded master: topics, rates, commands, parameters, clients that misbehave.

use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use ambf_app::ros::messages::{ambf_msgs, geometry_msgs, sensor_msgs, std_msgs};
use ambf_app::ros::{RosMiddleware, RosOptions};
use ambf_core::comm::{
    CameraParameters, Hub, Inbox, JointCommandType, Middleware, PoseCommand, Rates, RigidBodyCommand,
};
use ambf_test_support::ros::*;
use dxr::Value;
use rosrust::api::Ros;

const NS: &str = "/ambf/env/";

/// One simulator for all tests of this file, since a process has one `ROS_MASTER_URI`; each test uses bodies of its
/// own.
struct Fixture {
    master: String,
    simulator: Mutex<Simulator>,
    client: Ros,
}

fn fixture() -> &'static Fixture {
    static FIXTURE: OnceLock<Fixture> = OnceLock::new();
    FIXTURE.get_or_init(|| {
        let master = use_own_master();
        let simulator = Simulator::start(objects(NS, 8, Rates::default()));
        until("the last topic", || system_state_mentions(&master, "/ambf/env/light/Command"));
        let client = Ros::new("tester").unwrap();
        Fixture { master, simulator: Mutex::new(simulator), client }
    })
}

impl Fixture {
    fn with<T>(&self, f: impl FnOnce(&Simulator) -> T) -> T {
        f(&self.simulator.lock().unwrap_or_else(|e| e.into_inner()))
    }

    fn subscriber(&self, topic: &str) -> RawSubscriber {
        RawSubscriber::connect(&publisher_of(&self.master, topic), topic)
    }

    /// The newest message on `topic` whenever it is asked for.
    fn listen<M: rosrust::Message>(&self, topic: &str) -> (rosrust::Subscriber, Arc<Mutex<Option<M>>>) {
        let newest = Arc::new(Mutex::new(None));
        let slot = Arc::clone(&newest);
        let subscriber = self.client.subscribe(topic, 10, move |m: M| *slot.lock().unwrap() = Some(m)).unwrap();
        (subscriber, newest)
    }

    /// A publisher that the simulator is connected to.
    fn publisher<M: rosrust::Message>(&self, topic: &str) -> rosrust::Publisher<M> {
        let publisher = self.client.publish::<M>(topic, 10).unwrap();
        until(&format!("the simulator listens to {topic}"), || publisher.subscriber_count() > 0);
        publisher
    }
}

fn body_command(force: f64) -> ambf_msgs::RigidBodyCmd {
    let mut command = ambf_msgs::RigidBodyCmd::default();
    command.wrench.force = geometry_msgs::Vector3 { x: force, y: 0.0, z: 0.0 };
    command
}

#[test]
fn topics_are_listed_with_their_types() {
    let listed = published_topics(&fixture().master);
    for (topic, kind) in [
        ("/ambf/env/World/State", "ambf_msgs/WorldState"),
        ("/ambf/env/World/Timing", "ambf_msgs/Timing"),
        ("/ambf/env/Box0/State", "ambf_msgs/RigidBodyState"),
        ("/ambf/env/cameras/cam/State", "ambf_msgs/CameraState"),
        ("/ambf/env/light/State", "ambf_msgs/LightState"),
    ] {
        assert!(listed.contains(&(topic.into(), kind.into())), "{topic} in {listed:?}");
    }
    for topic in ["World/Command", "World/Command/Reset", "World/Command/Reset/Bodies", "Box7/Command"] {
        assert!(system_state_mentions(&fixture().master, &format!("/ambf/env/{topic}\"")), "{topic}");
    }
}

#[test]
fn states_say_what_the_snapshot_says() {
    let fixture = fixture();
    let (_s, world) = fixture.listen::<ambf_msgs::WorldState>("/ambf/env/World/State");
    let (_s, body) = fixture.listen::<ambf_msgs::RigidBodyState>("/ambf/env/Box2/State");
    let (_s, camera) = fixture.listen::<ambf_msgs::CameraState>("/ambf/env/cameras/cam/State");
    let (_s, timing) = fixture.listen::<ambf_msgs::Timing>("/ambf/env/World/Timing");
    until("a state of each", || {
        world.lock().unwrap().as_ref().is_some_and(|w| w.sim_step > 0)
            && body.lock().unwrap().is_some()
            && camera.lock().unwrap().is_some()
            && timing.lock().unwrap().is_some()
    });
    assert_eq!(world.lock().unwrap().as_ref().unwrap().n_devices, 3);
    let body = body.lock().unwrap().clone().unwrap();
    assert_eq!((body.name.data.as_str(), body.identifier.data.as_str()), ("Box2", "/ambf/env/BODY Box2"));
    assert_eq!((body.pose.position.x, body.pose.orientation.w, body.mass), (2.0, 1.0, 1.5));
    assert_eq!((body.joint_names, body.joint_positions), (vec!["joint".to_owned()], vec![0.25]));
    assert!(body.children_names.is_empty() && body.header.frame_id.is_empty());
    let age = rosrust::Time::from_nanos(nanos_since_epoch() as i64).sec.abs_diff(body.header.stamp.sec);
    assert!(age <= PATIENCE.as_secs() as u32, "stamp is {age} s away from now");
    assert_eq!(camera.lock().unwrap().as_ref().unwrap().pose.position.z, 3.0);
}

fn nanos_since_epoch() -> u128 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos()
}

#[test]
fn a_subscriber_of_any_type_is_told_the_full_definition() {
    let mut subscriber = fixture().subscriber("/ambf/env/Box3/State");
    assert_eq!(subscriber.header["type"], "ambf_msgs/RigidBodyState");
    assert_eq!(subscriber.header["md5sum"], "c0ba0eb38f2481828a038f3b17ce0623");
    let definition = &subscriber.header["message_definition"];
    assert!(definition.contains("MSG: geometry_msgs/Twist"), "{definition}");
    assert!(definition.contains("MSG: std_msgs/Header"), "{definition}");
    assert!(subscriber.read_block().is_some());
}

#[test]
fn the_rate_follows_the_commands_and_the_watchdog() {
    let fixture = fixture();
    let mut states = fixture.subscriber("/ambf/env/Box4/State");
    states.count(Duration::from_millis(200));
    let slow = states.count(Duration::from_secs(1));
    let commands = fixture.publisher::<ambf_msgs::RigidBodyCmd>("/ambf/env/Box4/Command");
    let end = Instant::now() + Duration::from_secs(2);
    let sender = std::thread::spawn(move || {
        while Instant::now() < end {
            commands.send(body_command(1.0)).unwrap();
            std::thread::sleep(Duration::from_millis(10));
        }
    });
    states.count(Duration::from_millis(500));
    let fast = states.count(Duration::from_secs(1));
    sender.join().unwrap();
    states.count(Duration::from_secs(1));
    let slow_again = states.count(Duration::from_secs(1));
    println!("messages a second: {slow} idle, {fast} commanded, {slow_again} after the watchdog");
    assert!(slow <= 60 && slow_again <= 60 && fast > 4 * slow, "{slow} {fast} {slow_again}");
}

#[test]
fn commands_arrive_and_nonsense_does_not() {
    let fixture = fixture();
    let commands = fixture.publisher::<ambf_msgs::RigidBodyCmd>("/ambf/env/Box5/Command");
    let mut inbox = Inbox::<RigidBodyCommand>::default();
    let mut fetch = |force: f64, what: &str| {
        until(what, || {
            fixture.with(|s| inbox.fetch(&s.hub.objects()[s.object("Box5")].channel.body, 0));
            inbox.command().force.x == force
        });
        inbox.command().clone()
    };
    let mut command = body_command(5.0);
    command.joint_cmds = vec![0.5; 100];
    command.joint_cmds_types = vec![1];
    commands.send(command).unwrap();
    let received = fetch(5.0, "the command");
    assert_eq!(received.joint_commands, [0.5], "one joint");
    assert_eq!(received.joint_command_types, [JointCommandType::Position]);
    let mut nonsense = body_command(6.0);
    nonsense.pose.position.z = f64::NAN;
    commands.send(nonsense).unwrap();
    commands.send(body_command(7.0)).unwrap();
    assert_eq!(fetch(7.0, "the command after the nonsense").position.z, 0.0);
}

#[test]
fn world_commands_and_resets_reach_the_hub() {
    let fixture = fixture();
    fixture.publisher::<std_msgs::Empty>("/ambf/env/World/Command/Reset").send(std_msgs::Empty {}).unwrap();
    fixture.publisher::<std_msgs::Empty>("/ambf/env/World/Command/Reset/Bodies").send(std_msgs::Empty {}).unwrap();
    let mut seen = (false, false);
    until("both resets", || {
        let resets = fixture.with(|s| s.hub.take_resets());
        seen = (seen.0 | resets.world.is_some(), seen.1 | resets.bodies);
        seen == (true, true)
    });
    let commands = fixture.publisher::<ambf_msgs::WorldCmd>("/ambf/env/World/Command");
    commands.send(ambf_msgs::WorldCmd { enable_step_throttling: true, step_clock: false, n_skip_steps: 1 }).unwrap();
    until("throttling", || fixture.with(|s| s.hub.throttle().is_live(s.hub.now_ns())));
    fixture.with(|s| assert!(!s.hub.throttle().count(&mut 0) && !s.hub.throttle().is_open()));
    // No physics thread ends it here, and the watchdogs of other tests stand still meanwhile.
    commands.send(ambf_msgs::WorldCmd::default()).unwrap();
    until("no throttling", || fixture.with(|s| s.hub.throttle().watch_time(u64::MAX) == u64::MAX));
}

#[test]
fn a_subscriber_that_hangs_is_dropped_and_the_others_go_on() {
    let fixture = fixture();
    let topic = "/ambf/env/Box6/State";
    let mut good = fixture.subscriber(topic);
    let mut hanging = fixture.subscriber(topic);
    hanging.read_block().unwrap();
    let commands = fixture.publisher::<ambf_msgs::RigidBodyCmd>("/ambf/env/Box6/Command");
    let (mut received, mut longest) = (0, Duration::ZERO);
    let (mut last, end) = (Instant::now(), Instant::now() + Duration::from_secs(8));
    while Instant::now() < end {
        commands.send(body_command(0.0)).unwrap();
        good.read_block().expect("the good subscriber goes on");
        received += 1;
        longest = longest.max(last.elapsed());
        last = Instant::now();
    }
    println!("{received} messages beside a subscriber that hangs, longest gap {} ms", longest.as_millis());
    // What was sent before it was dropped is still there, then the stream ends.
    let mut blocks = 0;
    while hanging.read_block().is_some() {
        blocks += 1;
        assert!(blocks < received, "the one that hangs is still connected");
    }
    assert!(good.read_block().is_some());
}

#[test]
fn hundreds_of_clients_come_and_go_without_a_trace() {
    let fixture = fixture();
    let topic = "/ambf/env/Box7/State";
    let node = publisher_of(&fixture.master, topic);
    let warm_up = RawSubscriber::connect(&node, topic);
    let port = warm_up.stream.peer_addr().unwrap().port();
    drop(warm_up);
    let before = resources();
    for _ in 0..500 {
        let mut client = RawSubscriber::handshake(port, topic);
        client.read_block().expect("a state");
    }
    // Other tests open and close connections meanwhile, hundreds less than 500.
    until("threads and files as before", || {
        let now = resources();
        now.0 < before.0 + 150 && now.1 < before.1 + 150
    });
    println!("threads and files: {before:?} before, {:?} after 500 clients", resources());
}

#[test]
fn camera_parameters_are_written_polled_and_checked() {
    let master = &fixture().master;
    let name = |key: &str| text(&format!("/ambf/env/cameras/cam/{key}"));
    let get = |key: &str| call(master, "getParam", vec![name(key)]);
    until("the parameters", || call(master, "getParam", vec![text("/ambf/env/light/type")]).is_some());
    assert_eq!(get("near_plane"), Some(Value::Double(0.1)));
    assert_eq!(get("projection"), Some(text("PERSPECTIVE")));
    call(master, "setParam", vec![name("mode"), text("HOLOGRAM")]).unwrap();
    call(master, "setParam", vec![name("far_plane"), Value::Integer(77)]).unwrap();
    call(master, "setParam", vec![name("field_view_angle"), Value::Double(0.0)]).unwrap();
    let mut inbox = Inbox::<CameraParameters>::default();
    until("the change in the hub", || {
        fixture().with(|s| inbox.fetch(&s.hub.objects()[s.object("cameras/cam")].channel.camera, 0));
        inbox.command().far_plane == 77.0 && inbox.command().field_view_angle == 0.7
    });
    assert!(!inbox.command().stereo, "an unknown word changes nothing");
    until("0 is replaced on the server", || get("field_view_angle") == Some(Value::Double(0.7)));
}

#[test]
fn a_camera_follows_pose_commands() {
    let fixture = fixture();
    let commands = fixture.publisher::<ambf_msgs::CameraCmd>("/ambf/env/cameras/cam/Command");
    let mut command = ambf_msgs::CameraCmd { enable_position_controller: true, ..Default::default() };
    command.pose.position.y = 4.0;
    commands.send(command).unwrap();
    let mut inbox = Inbox::<PoseCommand>::default();
    until("the pose", || fixture.with(|s| inbox.fetch(&s.hub.objects()[s.object("cameras/cam")].channel.pose, 0)));
    assert!(inbox.command().enabled && inbox.command().position.y == 4.0);
}

#[test]
fn point_clouds_are_kept_for_the_viewer() {
    let fixture = fixture();
    let parameter = "/ambf/env/World/point_cloud_topics";
    let mut list = None;
    until("the default list", || {
        list = call(&fixture.master, "getParam", vec![text(parameter)]);
        list.is_some()
    });
    assert_eq!(list, Some(Value::Array(vec![text("/ambf/env/World/point_cloud")])));
    let both = Value::Array(vec![text("/ambf/env/World/point_cloud"), text("/another/cloud")]);
    call(&fixture.master, "setParam", vec![text(parameter), both]).unwrap();
    let points = fixture.publisher::<sensor_msgs::PointCloud>("/another/cloud");
    let radius = fixture.publisher::<std_msgs::Float32>("/another/cloud/radius");
    let mut cloud = sensor_msgs::PointCloud::default();
    cloud.header.frame_id = "BODY Box1".into();
    cloud.points =
        vec![geometry_msgs::Point32 { x: 1.0, y: 2.0, z: 3.0 }, geometry_msgs::Point32 { x: f32::NAN, y: 0.0, z: 0.0 }];
    points.send(cloud).unwrap();
    radius.send(std_msgs::Float32 { data: 4.0 }).unwrap();
    let clouds = fixture.with(|s| s.ros.point_clouds());
    until("the cloud", || {
        clouds.all().iter().any(|(topic, cloud)| {
            topic == "/another/cloud"
                && cloud.points == [[1.0, 2.0, 3.0]]
                && cloud.radius == 4.0
                && cloud.frame_id == "BODY Box1"
        })
    });
    call(&fixture.master, "setParam", vec![text(parameter), Value::Array(vec![])]).unwrap();
    until("nothing is listened to", || clouds.all().is_empty());
    until("the topic is given up", || points.subscriber_count() == 0 || !listens(&fixture.master, "/another/cloud"));
}

/// Whether the simulator is registered as a subscriber of `topic`.
fn listens(master: &str, topic: &str) -> bool {
    let Some(Value::Array(lists)) = call(master, "getSystemState", vec![]) else { return false };
    format!("{:?}", lists.get(1)).contains(topic)
}

#[test]
fn a_second_simulator_shares_the_master_and_leaves_it_clean() {
    let fixture = fixture();
    // Two bodies of one name share their topics; a camera of that name cannot, since its type differs.
    let mut list = objects("/second/", 2, Rates::default());
    list.iter_mut().filter(|o| o.name == "Box1" || o.name == "cameras/cam").for_each(|o| o.name = "Box0".into());
    let mut second = Simulator::start(list);
    until("the topics of the second", || system_state_mentions(&fixture.master, "/second/light/Command"));
    let mut subscriber = fixture.subscriber("/second/Box0/State");
    subscriber.read_block().expect("a state");
    let begin = Instant::now();
    second.ros.stop();
    assert!(begin.elapsed() < Duration::from_secs(10), "a stop took {:?}", begin.elapsed());
    assert!(!system_state_mentions(&fixture.master, "/second/"));
    while subscriber.read_block().is_some() {}
    until("the first goes on", || system_state_mentions(&fixture.master, "/ambf/env/Box0/State"));
}

#[test]
fn before_the_first_step_only_the_world_speaks() {
    let fixture = fixture();
    let mut ros = RosMiddleware::new(RosOptions::default());
    ros.start(Arc::new(Hub::new(objects("/idle/", 1, Rates::default())))).unwrap();
    let mut body = fixture.subscriber("/idle/Box0/State");
    let (_s, world) = fixture.listen::<ambf_msgs::WorldState>("/idle/World/State");
    until("the world's zeros", || world.lock().unwrap().is_some());
    assert_eq!(world.lock().unwrap().as_ref().unwrap().sim_step, 0);
    body.stream.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    assert!(body.read_block().is_none(), "a body has no state yet");
    ros.stop();
}

#[test]
fn a_client_that_connects_and_says_nothing_does_not_keep_others_out() {
    let topic = "/ambf/env/Box1/State";
    let node = publisher_of(&fixture().master, topic);
    let port = RawSubscriber::connect(&node, topic).stream.peer_addr().unwrap().port();
    // The time-out is set within a second or two after the topic was announced.
    std::thread::sleep(Duration::from_secs(3));
    let _silent = std::net::TcpStream::connect(("127.0.0.1", port)).unwrap();
    let mut other = RawSubscriber::handshake(port, topic);
    assert!(other.read_block().is_some());
}

#[test]
fn a_node_that_is_told_to_shut_down_leaves_and_the_simulation_goes_on() {
    let fixture = fixture();
    let simulator = Simulator::start(objects("/killed/", 1, Rates::default()));
    until("the topics", || system_state_mentions(&fixture.master, "/killed/light/Command"));
    let node = publisher_of(&fixture.master, "/killed/Box0/State");
    // As `rosnode kill` does.
    assert!(call(&node, "shutdown", vec![text("a test")]).is_some());
    until("the topics are gone", || !system_state_mentions(&fixture.master, "/killed/"));
    let step = simulator.step();
    until("the simulation goes on", || simulator.step() > step + 10);
}
