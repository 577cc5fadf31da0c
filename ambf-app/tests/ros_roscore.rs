//! The ROS side against the real ROS master, which dies and comes back.

mod ros_common;

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use ambf_app::ros::messages::ambf_msgs;
use ambf_core::comm::{Inbox, Middleware, Rates, RigidBodyCommand};
use dxr::Value;
use ros_common::*;

/// Debian's `rosmaster` on a given port; killed when dropped.
struct Master(Child);

impl Master {
    fn start(port: u16) -> Option<Self> {
        let log_dir = std::env::temp_dir().join(format!("ambf_ros_log_{}", std::process::id()));
        let child = Command::new("rosmaster")
            .args(["--core", "-p", &port.to_string()])
            .env("ROS_LOG_DIR", log_dir)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        child.ok().map(Self)
    }
}

impl Drop for Master {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn answers(uri: &str) -> bool {
    call(uri, "getPid", vec![]).is_some()
}

fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).stderr(Stdio::null()).output().ok()?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[test]
fn a_master_that_dies_and_comes_back_is_told_everything_again() {
    let port = free_port();
    let uri = format!("http://localhost:{port}/");
    use_master(&uri);
    let Some(master) = Master::start(port) else {
        println!("skipped: rosmaster is not installed (Debian: python3-rosmaster)");
        return;
    };
    until("the master", || answers(&uri));
    let mut simulator = Simulator::start(objects("/ambf/env/", 10, Rates::default()));
    until("the last topic", || system_state_mentions(&uri, "/ambf/env/light/Command"));
    until("the parameters", || call(&uri, "getParam", vec![text("/ambf/env/light/type")]).is_some());

    if let Some(list) = output("rostopic", &["list"]) {
        assert!(list.contains("/ambf/env/Box9/Command") && list.contains("/ambf/env/World/Timing"), "{list}");
        let kind = output("rostopic", &["type", "/ambf/env/Box9/State"]).unwrap();
        assert_eq!(kind.trim(), "ambf_msgs/RigidBodyState");
    }
    let topic = "/ambf/env/Box0/State";
    let node = publisher_of(&uri, topic);
    let mut states = RawSubscriber::connect(&node, topic);
    states.read_block().unwrap();

    drop(master);
    until("the master is gone", || !answers(&uri));
    let step = simulator.step();
    // Long enough for the loss to be noticed at least once.
    std::thread::sleep(Duration::from_millis(1500));
    assert!(simulator.step() > step, "the simulation goes on");
    states.count(Duration::from_millis(300));

    let _master = Master::start(port).unwrap();
    until("the master is back", || answers(&uri));
    let back = Instant::now();
    until("everything is registered again", || {
        system_state_mentions(&uri, "/ambf/env/light/Command") && system_state_mentions(&uri, "/rosout")
    });
    println!("registered again {} ms after the master came back", back.elapsed().as_millis());
    assert_eq!(publisher_of(&uri, topic), node, "the node is the same");
    assert!(published_topics(&uri).contains(&(topic.to_owned(), "ambf_msgs/RigidBodyState".to_owned())));
    until("the parameters are back", || call(&uri, "getParam", vec![text("/ambf/env/light/type")]).is_some());
    states.count(Duration::from_millis(300));

    // A client that comes now is heard.
    let client = rosrust::api::Ros::new("tester").unwrap();
    let commands = client.publish::<ambf_msgs::RigidBodyCmd>("/ambf/env/Box1/Command", 10).unwrap();
    until("the simulator listens", || commands.subscriber_count() > 0);
    commands.send(ambf_msgs::RigidBodyCmd { cartesian_cmd_type: 2, ..Default::default() }).unwrap();
    let mut inbox = Inbox::<RigidBodyCommand>::default();
    until("the command", || inbox.fetch(&simulator.hub.channel(simulator.object("Box1")).body));
    drop(commands);

    simulator.ros.stop();
    until("no topic is left", || {
        call(&uri, "getSystemState", vec![]).is_some_and(|state: Value| {
            let state = format!("{state:?}");
            !state.contains("/ambf/env") && !state.contains("ambf_comm_node")
        })
    });
}
