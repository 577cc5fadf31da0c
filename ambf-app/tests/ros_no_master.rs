//! The ROS side without a master it could use: the simulation does not care.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_app::ros::{RosMiddleware, RosOptions};
use ambf_core::comm::{Hub, Middleware, Rates};
use ambf_test_support::ros::*;

/// One test, since a process has one environment.
#[test]
fn nobody_to_talk_to_is_no_reason_to_stop() {
    // TEST-NET-1: packets to it get lost.
    use_master("http://192.0.2.1:11311/");
    let begin = Instant::now();
    let mut simulator = Simulator::start(objects("/ambf/env/", 3, Rates::default()));
    // The system gives a connection up after more than two minutes.
    assert!(begin.elapsed() < Duration::from_secs(20), "start waited {:?}", begin.elapsed());
    until("the simulation runs", || simulator.step() > 100);
    stop_in_time(&mut simulator);

    // Somebody who accepts and never answers.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    use_master(&format!("http://127.0.0.1:{}/", silent.local_addr().unwrap().port()));
    let mut simulator = Simulator::start(objects("/ambf/env/", 3, Rates::default()));
    until("the simulation runs", || simulator.step() > 100);
    stop_in_time(&mut simulator);

    use_master("localhost");
    let mut ros = RosMiddleware::new(RosOptions::default());
    let error = ros.start(Arc::new(Hub::new(Vec::new()))).unwrap_err();
    assert!(error.to_string().contains("http://HOST:PORT/"), "{error}");
    ros.stop();
}

fn stop_in_time(simulator: &mut Simulator) {
    let begin = Instant::now();
    simulator.ros.stop();
    assert!(begin.elapsed() < Duration::from_secs(30), "stop waited {:?}", begin.elapsed());
}
