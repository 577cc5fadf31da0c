//! What a subscription gets from publishers that behave well or badly.

mod common;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

use common::{text, until, FakeNode, Place};
use dxr::Value;
use ros_node::tcpros::{block, header_of};
use ros_node::{Announcement, Node, Publication, RawSubscription};
use rosrust::msg::rosgraph_msgs::Log;
use rosrust::{Message, RosMsg};

const TOPIC: &str = "/commands";

/// A node that listens, what it has heard and what it says.
struct Fixture {
    place: Place,
    node: Node,
    subscription: Arc<dyn Announcement>,
    heard: Arc<Mutex<Vec<Vec<u8>>>>,
    lines: Arc<Mutex<Vec<String>>>,
}

impl Fixture {
    fn new() -> Self {
        let place = Place::new();
        let (node, lines) = place.node("/listener");
        let heard = Arc::<Mutex<Vec<Vec<u8>>>>::default();
        let into = Arc::clone(&heard);
        let subscription: Arc<dyn Announcement> = RawSubscription::of::<Log>(TOPIC.into(), 1000, move |message| {
            into.lock().unwrap().push(message.body.into())
        });
        place.announce(&node, vec![Arc::clone(&subscription)]);
        Self { place, node, subscription, heard, lines }
    }

    /// A publisher that answers our header with `bytes`, and holds the connection until `hold` is dropped.
    fn publisher(&self, name: &str, bytes: Vec<u8>) -> FakeNode {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        std::thread::spawn(move || {
            let mut open = Vec::new();
            for stream in listener.incoming() {
                let Ok(mut stream) = stream else { return };
                let mut length = [0; 4];
                if stream.read_exact(&mut length).is_err() {
                    continue;
                }
                let mut header = vec![0; u32::from_le_bytes(length) as usize];
                let _ = stream.read_exact(&mut header);
                let _ = stream.write_all(&bytes);
                open.push(stream);
            }
        });
        let how = Value::Array(vec![text("TCPROS"), text("127.0.0.1"), Value::Integer(port.into())]);
        let fake = FakeNode::new(move |method| match method {
            "requestTopic" => how.clone(),
            _ => Value::Integer(0),
        });
        let arguments = vec![text(TOPIC), text("rosgraph_msgs/Log"), text(&fake.uri)];
        self.place.master().called_by(name).call("registerPublisher", arguments).unwrap();
        fake
    }

    fn heard(&self) -> usize {
        self.heard.lock().unwrap().len()
    }

    fn says(&self, what: &str) {
        until(what, || self.lines.lock().unwrap().iter().any(|line| line.contains(what)));
    }
}

fn good() -> Vec<u8> {
    header_of(&[("callerid", "/you"), ("md5sum", &Log::md5sum()), ("type", "rosgraph_msgs/Log")])
}

#[test]
fn a_publisher_is_heard_at_once_and_again_after_it_was_restarted() {
    let fixture = Fixture::new();
    for round in 0..2 {
        let (node, _) = fixture.place.node("/speaker");
        let speaker = Publication::<Log>::latched(TOPIC.into());
        fixture.place.announce(&node, vec![Arc::clone(&speaker) as Arc<dyn Announcement>]);
        speaker.send(Log { line: round, ..Log::default() });
        until("it is heard", || fixture.heard() > round as usize);
        let last = fixture.heard.lock().unwrap().last().unwrap().clone();
        assert_eq!(Log::decode(&last[..]).unwrap().line, round);
    }
}

#[test]
fn every_message_of_a_burst_arrives() {
    let fixture = Fixture::new();
    let mut bytes = good();
    let burst: Vec<Vec<u8>> = (0..1000_u32).map(|i| i.to_le_bytes()[..(i % 5) as usize].to_vec()).collect();
    burst.iter().for_each(|message| bytes.extend(block(message)));
    let _fake = fixture.publisher("/burst", bytes);
    until("all of it", || fixture.heard() >= 1000);
    assert_eq!(*fixture.heard.lock().unwrap(), burst);
}

#[test]
fn publishers_that_do_what_publishers_do_not_do_are_named_and_harm_nobody() {
    let fixture = Fixture::new();
    let sum = Log::md5sum();
    let huge = u32::MAX.to_le_bytes();
    let _fakes = [
        ("/kind", header_of(&[("md5sum", &sum), ("type", "a/B")]), "/kind is not listened to: it sends a/B"),
        ("/sum", header_of(&[("md5sum", "13"), ("type", "rosgraph_msgs/Log")]), "with the checksum 13"),
        ("/any", header_of(&[("md5sum", "*"), ("type", "rosgraph_msgs/Log")]), "with the checksum *"),
        ("/no", header_of(&[("error", "no\nway")]), "it refuses us: no way"),
        ("/nonsense", block(b"nonsense"), "its answer is no header"),
        ("/header", huge.to_vec(), "announces 4294967295 bytes, 1048576 are the most"),
        ("/long", [good(), block(b"x"), huge.to_vec()].concat(), "announces 4294967295 bytes, 1000 are the most"),
        ("/silent", Vec::new(), "says nothing within 5 s"),
    ]
    .map(|(name, bytes, says)| (fixture.publisher(name, bytes), says));
    for (_, says) in &_fakes {
        fixture.says(says);
    }
    let heard = fixture.heard.lock().unwrap();
    assert!(
        !heard.is_empty() && heard.iter().all(|message| message == b"x"),
        "the one message that was whole, each time"
    );
}

/// Whoever says that there are publishers: only the master's word counts.
#[test]
fn a_notice_about_publishers_is_not_believed() {
    let fixture = Fixture::new();
    let fake = FakeNode::new(|_| Value::Integer(0));
    let notice = vec![text(TOPIC), Value::Array(vec![text(&fake.uri)])];
    fixture.place.peer("/listener").called_by("/master").call("publisherUpdate", notice).unwrap();
    let (node, _) = fixture.place.node("/speaker");
    let speaker = Publication::<Log>::latched(TOPIC.into());
    fixture.place.announce(&node, vec![Arc::clone(&speaker) as Arc<dyn Announcement>]);
    speaker.send(Log::default());
    until("the real one is heard", || fixture.heard() > 0);
    assert_eq!(fake.called("requestTopic"), 0);
}

#[test]
fn publishers_of_other_machines_are_not_listened_to_while_the_master_is_here() {
    let fixture = Fixture::new();
    // TEST-NET-1 is nobody's.
    let arguments = vec![text(TOPIC), text("rosgraph_msgs/Log"), text("http://192.0.2.1:4000/")];
    fixture.place.master().called_by("/far").call("registerPublisher", arguments).unwrap();
    fixture.says("/far is not listened to: it is at http://192.0.2.1:4000/, and only programs of this machine");
}

#[test]
fn nothing_comes_after_the_end() {
    let fixture = Fixture::new();
    let (node, _) = fixture.place.node("/speaker");
    let speaker = Publication::<Log>::new(TOPIC.into());
    fixture.place.announce(&node, vec![Arc::clone(&speaker) as Arc<dyn Announcement>]);
    until("it is connected", || speaker.has_subscribers());
    fixture.node.link().remove(&[Arc::clone(&fixture.subscription)]);
    until("it is disconnected", || !speaker.has_subscribers());
    assert!(!fixture.place.lists(1, TOPIC));
    assert_eq!(fixture.heard(), 0);
}

#[test]
fn a_call_back_that_panics_ends_its_connection_only() {
    let place = Place::new();
    let (node, _) = place.node("/listener");
    let heard = Arc::<Mutex<u32>>::default();
    let into = Arc::clone(&heard);
    let careless = RawSubscription::of::<Log>(TOPIC.into(), 1000, move |_| {
        *into.lock().unwrap() += 1;
        assert!(*into.lock().unwrap() > 1, "the first one panics");
    });
    place.announce(&node, vec![careless]);
    let (other, _) = place.node("/speaker");
    let speaker = Publication::<Log>::new(TOPIC.into());
    place.announce(&other, vec![Arc::clone(&speaker) as Arc<dyn Announcement>]);
    until("it is connected again and hears more", || {
        speaker.send(Log::default());
        *heard.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) > 3
    });
}

/// A connection that nobody answers is not worth a word; the real publisher is heard beside it.
#[test]
fn one_that_was_killed_keeps_nobody_else_waiting() {
    let fixture = Fixture::new();
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let arguments = vec![text(TOPIC), text("rosgraph_msgs/Log"), text(&format!("http://{free}/"))];
    fixture.place.master().called_by("/killed").call("registerPublisher", arguments).unwrap();
    // One that takes connections and never answers.
    let hanging = TcpListener::bind("127.0.0.1:0").unwrap();
    let uri = format!("http://{}/", hanging.local_addr().unwrap());
    let arguments = vec![text(TOPIC), text("rosgraph_msgs/Log"), text(&uri)];
    fixture.place.master().called_by("/hanging").call("registerPublisher", arguments).unwrap();
    let _fake = fixture.publisher("/good", [good(), block(b"hello")].concat());
    until("it is heard", || fixture.heard() > 0);
    fixture.says("/hanging cannot be reached");
    assert!(!fixture.lines.lock().unwrap().iter().any(|line| line.contains("/killed")), "programs come and go");
    drop(TcpStream::connect(hanging.local_addr().unwrap()));
}
