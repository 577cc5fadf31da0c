//! What subscribers get, small messages and large ones.

mod common;

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::{message, shake_hands, text, until, Place};
use dxr::Value;
use ros_node::{Announcement, LargePublication, Node, Publication};
use rosrust::msg::rosgraph_msgs::Log;
use rosrust::{Message, RosMsg};

const NAME: &str = "/env/eye/ImageData";

struct Fixture {
    place: Place,
    node: Node,
    large: Arc<LargePublication>,
    port: u16,
}

impl Fixture {
    fn new() -> Self {
        let place = Place::new();
        let (node, _) = place.node("/node");
        let large = LargePublication::new::<Log>(NAME.into());
        place.announce(&node, vec![Arc::clone(&large) as Arc<dyn Announcement>]);
        let port = place.port("/node", NAME);
        Self { place, node, large, port }
    }

    fn subscribe_to(&self, topic: &str) -> TcpStream {
        let before = self.connections();
        let md5sum = Log::md5sum();
        let header = [("callerid", "/me"), ("topic", topic), ("md5sum", &md5sum), ("type", "rosgraph_msgs/Log")];
        let (stream, answer) = shake_hands(self.port, &header);
        assert_eq!((answer["callerid"].as_str(), &answer["md5sum"]), ("/node", &md5sum), "{answer:?}");
        until("it is connected", || self.connections() > before);
        stream
    }

    fn subscribe(&self) -> TcpStream {
        self.subscribe_to(NAME)
    }

    fn connections(&self) -> usize {
        match self.place.peer("/node").call("getBusInfo", vec![]).unwrap() {
            Value::Array(rows) => rows.len(),
            other => panic!("{other:?}"),
        }
    }

    fn send(&self, size: usize, byte: u8) {
        self.large.send(|bytes, number| {
            bytes.extend(number.to_le_bytes());
            bytes.resize(bytes.len() + size, byte);
        });
    }

    fn small(&self, topic: &str, latched: bool) -> Arc<Publication<Log>> {
        let topic = topic.to_owned();
        let small = if latched { Publication::latched(topic) } else { Publication::new(topic) };
        self.place.announce(&self.node, vec![Arc::clone(&small) as Arc<dyn Announcement>]);
        small
    }
}

fn log(line: u32) -> Log {
    Log { line, msg: "text".into(), ..Log::default() }
}

fn line_of(message: Option<Vec<u8>>) -> u32 {
    Log::decode(&message.expect("a message")[..]).unwrap().line
}

#[test]
fn large_messages_come_whole_and_numbered() {
    let fixture = Fixture::new();
    assert!(!fixture.large.is_wanted());
    fixture.large.send(|_, _| panic!("nobody is there"));
    let mut stream = fixture.subscribe();
    assert!(fixture.large.is_wanted());
    for number in 0..20_u8 {
        fixture.send(100_000, number);
        let message = message(&mut stream).unwrap();
        assert_eq!((message.len(), message[0], message[100_000]), (100_004, number, number));
    }
}

/// One reads nothing, one reads everything at once: the second gets every message, the first the newest when it reads
/// again.
#[test]
fn one_who_does_not_read_delays_nobody_and_misses_the_old() {
    let fixture = Fixture::new();
    let (mut idle, mut busy) = (fixture.subscribe(), fixture.subscribe());
    const SIZE: usize = 10 << 20;
    for number in 0..30 {
        let begin = Instant::now();
        fixture.send(SIZE, number);
        assert!(begin.elapsed() < Duration::from_secs(20), "sending never waits");
        assert_eq!(message(&mut busy).unwrap()[SIZE], number);
    }
    assert_eq!(message(&mut idle).unwrap()[SIZE], 0, "the one that was under way");
    assert_eq!(message(&mut idle).unwrap()[SIZE], 29, "then the newest");
}

#[test]
fn one_who_stalls_is_not_worth_a_large_message_but_is_kept() {
    let fixture = Fixture::new();
    let mut idle = fixture.subscribe();
    fixture.send(10 << 20, 1);
    until("it counts as stalled", || !fixture.large.is_wanted());
    assert_eq!(message(&mut idle).unwrap().len(), (10 << 20) + 4);
    until("it is wanted again", || fixture.large.is_wanted());
}

#[test]
fn who_goes_is_forgotten_without_a_message() {
    let fixture = Fixture::new();
    let mut stream = fixture.subscribe();
    fixture.send(10, 0);
    message(&mut stream).unwrap();
    drop(stream);
    until("it is forgotten", || fixture.connections() == 0);
    assert!(!fixture.large.is_wanted());
}

#[test]
fn who_wants_something_else_is_told_so_and_the_user_once() {
    let place = Place::new();
    let (node, lines) = place.node("/node");
    place.announce(&node, vec![LargePublication::new::<Log>(NAME.into())]);
    let port = place.port("/node", NAME);
    let sum = Log::md5sum();
    for (key, value) in [("topic", "/other"), ("md5sum", "4567"), ("md5sum", "4567"), ("type", "test_msgs/Small")] {
        let mut header = vec![("callerid", "/me"), ("topic", NAME), ("md5sum", &sum), ("type", "rosgraph_msgs/Log")];
        header.iter_mut().find(|field| field.0 == key).unwrap().1 = value;
        assert!(shake_hands(port, &header).1.contains_key("error"), "{key}");
    }
    let any = [("callerid", "/me"), ("topic", NAME), ("md5sum", "*"), ("type", "*")];
    assert_eq!(shake_hands(port, &any).1["type"], "rosgraph_msgs/Log");
    let lines = lines.lock().unwrap();
    assert_eq!(lines.iter().filter(|line| line.contains("4567")).count(), 1, "{lines:?}");
}

#[test]
fn small_messages_have_numbers_and_times_and_the_last_one_is_kept_if_it_is_to_be() {
    let fixture = Fixture::new();
    let (plain, latched) = (fixture.small("/plain", false), fixture.small("/latched", true));
    plain.send(log(1));
    latched.send(log(2));
    latched.send(log(3));
    assert_eq!(line_of(message(&mut fixture.subscribe_to("/latched"))), 3);
    let mut stream = fixture.subscribe_to("/plain");
    let mut numbers = Vec::new();
    for line in 4..7 {
        plain.send(log(line));
        let came = Log::decode(&message(&mut stream).unwrap()[..]).unwrap();
        assert_eq!(came.line, line, "what was sent before is gone");
        assert!(came.header.stamp.sec > 1_000_000_000, "the time of this machine");
        numbers.push(came.header.seq);
    }
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
}

#[test]
fn a_message_that_is_sent_as_it_is_keeps_a_time_of_zero() {
    let fixture = Fixture::new();
    let plain = fixture.small("/plain", false);
    let mut stream = fixture.subscribe_to("/plain");
    plain.send_as_is(&log(7));
    let came = Log::decode(&message(&mut stream).unwrap()[..]).unwrap();
    assert_eq!((came.line, came.header.stamp.sec, came.header.stamp.nsec), (7, 0, 0));
}

/// It misses the oldest of what waits, and never a part of one.
#[test]
fn a_slow_subscriber_of_small_messages_misses_some_and_the_others_none() {
    let fixture = Fixture::new();
    let small = fixture.small("/small", false);
    let (mut slow, mut good) = (fixture.subscribe_to("/small"), fixture.subscribe_to("/small"));
    let long = Log { msg: "x".repeat(10_000), ..Log::default() };
    const COUNT: u32 = 2000;
    let (mut lines, mut last, mut taken) = (0, None, Instant::now());
    let mut take_slowly = || {
        let line = line_of(message(&mut slow));
        assert!(last.is_none_or(|last| line > last), "in order");
        (lines, last) = (lines + 1, Some(line));
        line
    };
    for line in 0..COUNT {
        small.send(Log { line, ..long.clone() });
        assert_eq!(line_of(message(&mut good)), line);
        // One that takes nothing for two seconds would be disconnected, also where fifty messages take that long; its
        // socket tells the sender only after some seven messages that there is room again.
        if line % 50 == 0 || taken.elapsed() > Duration::from_millis(100) {
            take_slowly();
            taken = Instant::now();
        }
    }
    while take_slowly() != COUNT - 1 {}
    assert!(lines < COUNT / 2, "{lines} of {COUNT} waited for it");
}

#[test]
fn one_that_takes_nothing_for_long_is_disconnected_from_small_messages() {
    let fixture = Fixture::new();
    let small = fixture.small("/small", false);
    let mut hanging = fixture.subscribe_to("/small");
    let long = Log { msg: "x".repeat(100_000), ..Log::default() };
    until("it is disconnected", || {
        small.send(long.clone());
        !small.has_subscribers()
    });
    while message(&mut hanging).is_some() {}
}

#[test]
fn calls_are_answered() {
    let fixture = Fixture::new();
    let peer = fixture.place.peer("/node");
    let _stream = fixture.subscribe();
    let Value::Array(rows) = peer.call("getBusInfo", vec![]).unwrap() else { panic!("a list") };
    let Value::Array(row) = &rows[0] else { panic!("a list") };
    assert_eq!((&row[1], &row[2], &row[4]), (&text("/me"), &text("o"), &text(NAME)));
    assert_eq!(peer.call("getPid", vec![]).unwrap(), Value::Integer(std::process::id() as i32));
    assert_eq!(peer.call("getMasterUri", vec![]).unwrap(), text(&fixture.place.uri));
    let Value::Array(published) = peer.call("getPublications", vec![]).unwrap() else { panic!("a list") };
    assert!(published.contains(&Value::Array(vec![text(NAME), text("rosgraph_msgs/Log")])));
    let protocols = Value::Array(vec![Value::Array(vec![text("TCPROS")])]);
    assert!(peer.call("requestTopic", vec![text("/other"), protocols]).unwrap_err().is_refusal());
    assert!(peer.call("sing", vec![]).unwrap_err().is_refusal());
    let gain = fixture.place.master().call("getParam", vec![text("/node/gain")]);
    assert_eq!(gain.unwrap(), Value::Double(2.0), "a private parameter");
}

#[test]
fn bytes_that_are_no_call_and_no_header_harm_nobody() {
    let fixture = Fixture::new();
    let uri = fixture.place.peer("/node").uri().to_owned();
    let calls: u16 = uri.trim_end_matches('/').rsplit_once(':').unwrap().1.parse().unwrap();
    let deep =
        format!("<methodCall><methodName>x</methodName><params><param>{}", "<value><array><data>".repeat(100_000));
    let deep = format!("POST / HTTP/1.1\r\nContent-Length: {}\r\n\r\n{deep}", deep.len());
    let nonsense: [&[u8]; 5] = [
        b"\xff\xff\xff\xff",
        b"GET / HTTP/1.0\r\n\r\n",
        b"content-length: 99999999999\r\n\r\n",
        &[b'x'; 100_000],
        deep.as_bytes(),
    ];
    for port in [fixture.port, calls] {
        for bytes in nonsense {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            // It may be closed before all is written.
            let _ = stream.write_all(bytes);
            let _ = stream.shutdown(Shutdown::Write);
            let _ = stream.read_to_end(&mut Vec::new());
        }
    }
    let mut stream = fixture.subscribe();
    fixture.send(10, 7);
    assert_eq!(message(&mut stream).unwrap()[5], 7);
}

#[test]
fn several_calls_go_over_one_connection() {
    let fixture = Fixture::new();
    let uri = fixture.place.peer("/node").uri().to_owned();
    let mut stream = TcpStream::connect(uri.strip_prefix("http://").unwrap().trim_end_matches('/')).unwrap();
    stream.set_read_timeout(Some(common::PATIENCE)).unwrap();
    let body =
        "<methodCall><methodName>getPid</methodName><params><param><value>/me</value></param></params></methodCall>";
    for _ in 0..3 {
        write!(stream, "POST /RPC2 HTTP/1.1\r\nContent-Length: {}\r\n\r\n{body}", body.len()).unwrap();
        let mut answer = String::new();
        while !answer.ends_with("</methodResponse>") {
            let mut chunk = [0; 1024];
            let count = stream.read(&mut chunk).unwrap();
            assert!(count > 0, "{answer}");
            answer.push_str(std::str::from_utf8(&chunk[..count]).unwrap());
        }
        assert!(answer.contains(&std::process::id().to_string()), "{answer}");
    }
}

#[test]
fn publications_of_one_name_share_their_subscribers_until_the_last_is_withdrawn() {
    let fixture = Fixture::new();
    let mut stream = fixture.subscribe();
    let other = LargePublication::new::<Log>(NAME.into());
    fixture.node.link().add([Arc::clone(&other) as Arc<dyn Announcement>]);
    other.send(|bytes, _| bytes.push(5));
    assert_eq!(message(&mut stream).unwrap(), [5]);
    fixture.node.link().remove(&[Arc::clone(&other) as Arc<dyn Announcement>]);
    fixture.send(1, 6);
    assert_eq!(message(&mut stream).unwrap()[4], 6, "the first goes on");
    assert!(fixture.place.lists(0, NAME));
    fixture.node.link().remove(&[Arc::clone(&fixture.large) as Arc<dyn Announcement>]);
    assert!(matches!(stream.read(&mut [0]), Ok(0) | Err(_)));
    assert!(!fixture.place.lists(0, NAME));
}

/// Two listening sockets, both on loopback, and a few threads, whatever there is to serve.
#[test]
fn two_hundred_topics_with_subscribers_need_two_ports_and_a_few_threads() {
    let fixture = Fixture::new();
    let small: Vec<_> = (0..200).map(|number| Publication::<Log>::new(format!("/topic{number}"))).collect();
    let threads = || std::fs::read_dir("/proc/self/task").unwrap().count();
    let before = threads();
    fixture.place.announce(&fixture.node, small.iter().map(|one| Arc::clone(one) as Arc<dyn Announcement>).collect());
    let mut streams: Vec<_> = (0..200).map(|number| fixture.subscribe_to(&format!("/topic{number}"))).collect();
    for (line, (publication, stream)) in (0..).zip(small.iter().zip(&mut streams)) {
        publication.send(log(line));
        assert_eq!(line_of(message(stream)), line);
    }
    // Other tests of this program run meanwhile, a few threads each.
    assert!(threads() < before + 100, "{before} threads before, {} now", threads());
    for (address, _) in listening() {
        assert!(address == "0100007F", "a socket listens at {address}");
    }
}

/// Address and port of each listening IPv4 socket of this process, in hexadecimal.
fn listening() -> Vec<(String, String)> {
    let own: Vec<String> = std::fs::read_dir("/proc/self/fd")
        .unwrap()
        .filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok()?.into_os_string().into_string().ok())
        .filter_map(|link| Some(link.strip_prefix("socket:[")?.trim_end_matches(']').to_owned()))
        .collect();
    let table = std::fs::read_to_string("/proc/net/tcp").unwrap();
    let rows = table.lines().skip(1).map(|line| line.split_whitespace().collect::<Vec<_>>());
    rows.filter(|row| row[3] == "0A" && own.iter().any(|inode| inode == row[9]))
        .filter_map(|row| row[1].split_once(':').map(|(address, port)| (address.to_owned(), port.to_owned())))
        .collect()
}
