//! The ROS side against the real ROS master, which dies and comes back.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_app::ros::messages::ambf_msgs;
use ambf_app::ros::{ModelHost, ModelReply};
use ambf_core::comm::{Inbox, Middleware, Rates, RigidBodyCommand};
use ambf_test_support::ros::*;
use dxr::Value;

/// Debian's `rosmaster` on a given port; killed when dropped.
struct Master(Child);

impl Master {
    fn start(port: u16) -> Option<Self> {
        let log_dir = concat!(env!("CARGO_TARGET_TMPDIR"), "/ros_log");
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

/// There is one model and nothing to be done about it.
struct OneModel;

impl ModelHost for OneModel {
    fn add(&self, _: &Path) -> Result<ModelReply, String> {
        Err("there is one already".into())
    }

    fn remove(&self, _: &str) -> Result<String, String> {
        Err("it stays".into())
    }

    fn list(&self) -> Vec<(String, PathBuf)> {
        vec![("the one".into(), PathBuf::new())]
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
    let list = objects("/ambf/env/", 10, Rates::default());
    let mut simulator = Simulator::start_with(list, |ros| ros.with_models(Arc::new(OneModel)));
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
    // It steps at most once a millisecond: long enough for the loss, which is looked for each second, to be noticed.
    until("the simulation goes on", || simulator.step() > step + 1500);
    states.count(Duration::from_millis(300));
    // What comes and goes meanwhile is right when the master is back.
    simulator.hub.add_objects(elements("/ambf/env/later/"));
    simulator.hub.remove_objects([simulator.object("Box9")]);

    let master = Master::start(port).unwrap();
    until("the master is back", || answers(&uri));
    let back = Instant::now();
    until("everything is registered again", || {
        system_state_mentions(&uri, "/ambf/env/light/Command") && system_state_mentions(&uri, "/rosout")
    });
    until("so is what came meanwhile", || system_state_mentions(&uri, "/ambf/env/later/Water/Command"));
    assert!(!system_state_mentions(&uri, "/ambf/env/Box9"));
    println!("registered again {} ms after the master came back", back.elapsed().as_millis());
    assert_eq!(publisher_of(&uri, topic), node, "the node is the same");
    assert!(published_topics(&uri).contains(&(topic.to_owned(), "ambf_msgs/RigidBodyState".to_owned())));
    until("the parameters are back", || call(&uri, "getParam", vec![text("/ambf/env/light/type")]).is_some());
    states.count(Duration::from_millis(300));

    // A client that comes now is heard.
    let client = rosrust::api::Ros::new("tester").unwrap();
    let list_models = client.client::<ambf_msgs::ListModels>("/ambf/env/World/list_models").unwrap();
    assert_eq!(list_models.req(&ambf_msgs::ListModelsReq {}).unwrap().unwrap().models, ["the one"]);
    let commands = client.publish::<ambf_msgs::RigidBodyCmd>("/ambf/env/Box1/Command", 10).unwrap();
    until("the simulator listens", || commands.subscriber_count() > 0);
    commands.send(ambf_msgs::RigidBodyCmd { cartesian_cmd_type: 2, ..Default::default() }).unwrap();
    let mut inbox = Inbox::<RigidBodyCommand>::default();
    until("the command", || inbox.fetch(&simulator.hub.objects()[simulator.object("Box1")].channel.body, 0));
    drop(commands);

    if let Some(heard) = heard_by_rospy(topic) {
        assert!(heard.starts_with("ambf_msgs/RigidBodyState "), "{heard}");
    }

    // A master that hangs: the simulation goes on, and so does everything when it comes to itself.
    signal(&master, "-STOP");
    let step = simulator.step();
    until("the simulation goes on", || simulator.step() > step + 2500);
    states.count(Duration::from_millis(300));
    signal(&master, "-CONT");

    simulator.ros.stop();
    until("no topic is left", || {
        call(&uri, "getSystemState", vec![]).is_some_and(|state: Value| {
            let state = format!("{state:?}");
            !state.contains("/ambf/env") && !state.contains("ambf_comm_node")
        })
    });
}

fn signal(master: &Master, name: &str) {
    assert!(Command::new("kill").args([name, &master.0.id().to_string()]).status().unwrap().success());
}

/// A message as a rospy client gets it; `None` when rospy is not installed.
fn heard_by_rospy(topic: &str) -> Option<String> {
    let rospy = |code: &str| Command::new("/usr/bin/python3").args(["-c", code]).output().ok();
    rospy("import rospy").filter(|output| output.status.success())?;
    let code = format!(
        "import rospy; rospy.init_node('listener', anonymous=True, disable_signals=True); \
         m = rospy.wait_for_message('{topic}', rospy.AnyMsg, {}); print(m._connection_header['type'], len(m._buff))",
        PATIENCE.as_secs()
    );
    let output = rospy(&code)?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}
