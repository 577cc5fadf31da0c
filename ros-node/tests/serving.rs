//! Services, and the master.

mod common;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::{message, shake_hands, text, until, FakeNode, Place};
use dxr::Value;
use ros_node::tcpros::block;
use ros_node::{Announcement, Node, Peer, RawSubscription, ServiceKind, ServiceServer};
use rosrust::msg::rosgraph_msgs::Log;

const NAME: &str = "/env/World/echo";

/// A service that repeats what it is asked, and refuses what begins with 0.
fn echo() -> Arc<ServiceServer> {
    let kind = ServiceKind { name: "test/Echo".into(), md5sum: "0123".into(), longest: 1000 };
    let answer = |request: &[u8]| match request.first() {
        Some(0) => Err(String::from("begins with 0")),
        _ => Ok(request.to_vec()),
    };
    ServiceServer::new(NAME.into(), kind, answer, |_| ())
}

/// A node with that service.
struct Fixture {
    place: Place,
    node: Node,
    service: Arc<ServiceServer>,
    port: u16,
}

impl Fixture {
    fn new() -> Self {
        let place = Place::new();
        let (node, _) = place.node("/node");
        let service = echo();
        place.announce(&node, vec![Arc::clone(&service) as Arc<dyn Announcement>]);
        let Value::String(uri) = place.master().call("lookupService", vec![text(NAME)]).unwrap() else { panic!() };
        let port = uri.strip_prefix("rosrpc://127.0.0.1:").unwrap().parse().unwrap();
        Self { place, node, service, port }
    }

    fn client(&self, more: &[(&str, &str)]) -> (TcpStream, std::collections::HashMap<String, String>) {
        let mut header = std::collections::HashMap::from([("service", NAME), ("callerid", "/me"), ("md5sum", "0123")]);
        header.extend(more.iter().copied());
        shake_hands(self.port, &header.into_iter().collect::<Vec<_>>())
    }
}

fn ask(stream: &mut TcpStream, request: &[u8]) -> (bool, Vec<u8>) {
    stream.write_all(&block(request)).unwrap();
    let mut success = [2];
    stream.read_exact(&mut success).unwrap();
    (success == [1], message(stream).unwrap())
}

fn assert_closed(stream: &mut TcpStream) {
    // Closed with unread bytes it is reset, which is an end too.
    assert!(!matches!(stream.read(&mut [0]), Ok(1)), "nothing follows");
}

#[test]
fn a_request_is_answered_and_the_connection_ends_unless_it_is_to_persist() {
    let fixture = Fixture::new();
    let (mut once, header) = fixture.client(&[]);
    assert_eq!((header["type"].as_str(), header["callerid"].as_str()), ("test/Echo", "/node"));
    assert_eq!(ask(&mut once, b"car"), (true, b"car".to_vec()));
    assert_closed(&mut once);
    let (mut persistent, _) = fixture.client(&[("persistent", "1"), ("md5sum", "*")]);
    for request in [&b"a"[..], b"b", b""] {
        assert_eq!(ask(&mut persistent, request), (true, request.to_vec()));
    }
    assert_eq!(ask(&mut persistent, &[0]), (false, b"begins with 0".to_vec()));
    let (success, why) = ask(&mut persistent, &[1; 2000]);
    assert!(!success && String::from_utf8(why).unwrap().contains("2000 bytes, 1000 are the most"));
    assert_closed(&mut persistent);
}

#[test]
fn a_probe_is_told_the_type_and_who_means_something_else_that() {
    let fixture = Fixture::new();
    let (mut stream, header) = fixture.client(&[("probe", "1"), ("md5sum", "*")]);
    assert_eq!((header["type"].as_str(), header["service"].as_str()), ("test/Echo", NAME));
    assert_closed(&mut stream);
    for (field, value) in [("md5sum", "992ce8a1"), ("service", "/other")] {
        let (mut stream, header) = fixture.client(&[(field, value)]);
        assert!(header["error"].contains(value), "{header:?}");
        assert_closed(&mut stream);
    }
}

#[test]
fn too_many_clients_are_turned_away_until_some_go() {
    let fixture = Fixture::new();
    let mut persistent: Vec<_> = (0..64).map(|_| fixture.client(&[("persistent", "1")]).0).collect();
    let mut stream = TcpStream::connect(("127.0.0.1", fixture.port)).unwrap();
    stream.write_all(&ros_node::tcpros::header_of(&[("service", NAME), ("md5sum", "*")])).unwrap();
    assert_closed(&mut stream);
    assert!(ask(&mut persistent[0], b"x").0, "the others go on");
    drop(persistent);
    until("there is room again", || {
        let mut stream = TcpStream::connect(("127.0.0.1", fixture.port)).unwrap();
        stream.write_all(&ros_node::tcpros::header_of(&[("service", NAME), ("md5sum", "*")])).unwrap();
        message(&mut stream).is_some()
    });
}

#[test]
fn withdrawing_ends_everything() {
    let fixture = Fixture::new();
    let (mut stream, _) = fixture.client(&[("persistent", "1")]);
    assert!(ask(&mut stream, b"x").0);
    fixture.node.link().remove(&[Arc::clone(&fixture.service) as Arc<dyn Announcement>]);
    assert_closed(&mut stream);
    assert!(!fixture.place.lists(2, NAME));
}

#[test]
fn a_node_of_the_same_name_takes_the_place_of_the_first() {
    let place = Place::new();
    let (first, _) = place.node("/node");
    let listen = || RawSubscription::of::<Log>("/topic".into(), 100, |_| ());
    place.announce(&first, vec![listen()]);
    let (second, _) = place.node("/node");
    second.link().add([listen() as Arc<dyn Announcement>]);
    until("the first is told to end", || first.link().is_dismissed());
    assert!(!second.link().is_dismissed());
    until("the second is there", || place.lists(1, "/topic"));
}

#[test]
fn everything_is_registered_again_with_a_master_that_has_forgotten() {
    let place = Place::new();
    let (node, lines) = place.node("/node");
    place.announce(&node, vec![RawSubscription::of::<Log>("/topic".into(), 100, |_| ())]);
    let uri = text(place.peer("/node").uri());
    let master = place.master().called_by("/node");
    master.call("unregisterSubscriber", vec![text("/topic"), uri.clone()]).unwrap();
    master.call("unregisterPublisher", vec![text("/rosout"), uri]).unwrap();
    until("it is registered again", || place.lists(1, "/topic") && place.lists(0, "/rosout"));
    until("it says so", || lines.lock().unwrap().iter().any(|line| line.contains("registered again")));
}

/// Who has waited for a service finds the topics.
#[test]
fn services_are_registered_after_the_topics() {
    let master = FakeNode::new(|_| Value::Integer(1));
    let mut place = Place::new();
    place.uri.clone_from(&master.uri);
    let (node, _) = place.node("/node");
    let topics = ["/a", "/b", "/c"].map(|topic| RawSubscription::of::<Log>(topic.into(), 100, |_| ()) as _);
    node.link().add([echo() as Arc<dyn Announcement>].into_iter().chain(topics));
    until("the service is there", || master.called("registerService") == 1);
    assert_eq!(master.called("registerSubscriber"), 3);
}

fn structure(members: &[(&str, Value)]) -> Value {
    Value::Struct(members.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect())
}

#[test]
fn parameters_are_a_tree() {
    let place = Place::new();
    let call = |method: &str, arguments: Vec<Value>| place.master().called_by("/arm/driver").call(method, arguments);
    let arm = structure(&[("gain", Value::Double(0.5)), ("joints", structure(&[("n", Value::Integer(6))]))]);
    call("setParam", vec![text("/arm"), arm.clone()]).unwrap();
    assert_eq!(call("getParam", vec![text("/arm")]).unwrap(), arm);
    assert_eq!(call("getParam", vec![text("gain")]).unwrap(), Value::Double(0.5), "beside the caller");
    call("setParam", vec![text("~rate"), Value::Integer(100)]).unwrap();
    assert_eq!(call("getParam", vec![text("/arm/driver/rate")]).unwrap(), Value::Integer(100));
    assert_eq!(call("hasParam", vec![text("/arm/joints/n")]).unwrap(), Value::Boolean(true));
    assert_eq!(call("searchParam", vec![text("gain")]).unwrap(), text("/arm/gain"));
    let Value::Array(names) = call("getParamNames", vec![]).unwrap() else { panic!("a list") };
    for name in ["/arm/driver/rate", "/arm/gain", "/arm/joints/n"] {
        assert!(names.contains(&text(name)), "{names:?}");
    }
    call("deleteParam", vec![text("/arm/joints")]).unwrap();
    assert!(call("getParam", vec![text("/arm/joints/n")]).unwrap_err().is_refusal());
    assert!(call("deleteParam", vec![text("/arm/joints")]).unwrap_err().is_refusal());
    assert!(call("searchParam", vec![text("nothing")]).unwrap_err().is_refusal());
    let deep = "/x".repeat(1000);
    assert!(call("setParam", vec![text(&deep), Value::Integer(1)]).unwrap_err().is_refusal());
}

/// Subscribers and followers of parameters are told what changes, and one that hangs delays nobody.
#[test]
fn nodes_are_told_what_changes() {
    let place = Place::new();
    let node = FakeNode::new(|_| Value::Integer(0));
    let hanging = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let hanging = format!("http://{}/", hanging.local_addr().unwrap());
    let register = |name: &str, method: &str, uri: &str| {
        let arguments = vec![text("/topic"), text("a/B"), text(uri)];
        place.master().called_by(name).call(method, arguments).unwrap()
    };
    register("/hanging", "registerSubscriber", &hanging);
    assert_eq!(register("/node", "registerSubscriber", &node.uri), Value::Array(vec![]));
    let begin = Instant::now();
    assert_eq!(
        register("/speaker", "registerPublisher", "http://127.0.0.1:1/"),
        Value::Array(vec![text(&hanging), text(&node.uri)])
    );
    until("it is told of the publisher", || node.called("publisherUpdate") > 0);
    assert!(begin.elapsed() < Duration::from_secs(10));
    let (_, arguments) = node.calls.lock().unwrap().last().unwrap().clone();
    assert_eq!(arguments, [text("/master"), text("/topic"), Value::Array(vec![text("http://127.0.0.1:1/")])]);
    let follow = vec![text(&node.uri), text("/arm")];
    place.master().called_by("/node").call("subscribeParam", follow).unwrap();
    place.master().call("setParam", vec![text("/arm/gain"), Value::Integer(3)]).unwrap();
    until("it is told of the parameter", || node.called("paramUpdate") > 0);
    let (_, arguments) = node.calls.lock().unwrap().last().unwrap().clone();
    assert_eq!(arguments, [text("/master"), text("/arm/gain"), Value::Integer(3)]);
    let Value::Array(published) = place.master().call("getPublishedTopics", vec![text("")]).unwrap() else { panic!() };
    assert_eq!(published, [Value::Array(vec![text("/topic"), text("a/B")])]);
}

#[test]
fn an_address_that_is_taken_is_an_error_and_free_again_after_the_end() {
    let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let master = ros_node::Master::start(address).unwrap();
    let peer = Peer::new(&format!("http://{address}/"), "/test", Duration::from_secs(1)).unwrap();
    assert_eq!(peer.call("getPid", vec![]).unwrap(), Value::Integer(std::process::id() as i32));
    assert!(ros_node::Master::start(address).is_err(), "the port is taken");
    drop(master);
    assert!(peer.call("getPid", vec![]).is_err());
}
