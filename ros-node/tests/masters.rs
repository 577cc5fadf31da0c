//! What a node says while there is no master.

mod common;

use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{until, PATIENCE};
use ros_node::{LinkOptions, Master, Node, NodeName, OwnMaster, Peer};

/// A free address, a node that looks for a master there, and what it says.
fn node(own_master: OwnMaster) -> (SocketAddr, Node, Arc<Mutex<Vec<String>>>) {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let lines = Arc::<Mutex<Vec<String>>>::default();
    let said = Arc::clone(&lines);
    let node = Node::start(LinkOptions {
        master: Peer::new(&format!("http://{address}/"), "/node", Duration::from_secs(2)).unwrap(),
        name: NodeName::Full("/node".into()),
        own_master,
        parameters: Vec::new(),
        report: Arc::new(move |line| said.lock().unwrap().push(line.to_string())),
    });
    (address, node.unwrap(), lines)
}

fn says(lines: &Mutex<Vec<String>>, what: &str) -> bool {
    lines.lock().unwrap().iter().any(|line| line.contains(what))
}

#[test]
fn a_master_that_another_node_starts_is_not_missed_before() {
    let (address, _node, lines) = node(OwnMaster::Expected(PATIENCE));
    // It has looked for the master in vain by now.
    std::thread::sleep(Duration::from_millis(200));
    let _master = Master::start(address).unwrap();
    until("it is at the master", || says(&lines, "at the master"));
    assert!(!says(&lines, "going on without"), "{lines:?}");
}

#[test]
fn one_that_does_not_come_is_missed_once_the_time_is_over() {
    let (_, _node, lines) = node(OwnMaster::Expected(Duration::from_millis(100)));
    until("it says so", || says(&lines, "going on without"));
    let (_, _node, lines) = node(OwnMaster::None);
    until("the other says so", || says(&lines, "going on without"));
}
