//! A program that the tests in `tests/ros2` talk to: topics, services and parameters of all kinds.
//!
//! `peer [OBJECTS]` publishes `/test/State` at 1 kHz while anybody listens, `/test/Image` of 1 MB at 10 Hz, and
//! `/test/Latched` once; sends what comes on `/test/Command` back on `/test/Echo`; serves `/test/AddModel` and parameters
//! of the node `/test`; and has so many nodes `object_N` with a State and a Command each. It answers lines on its standard
//! input: `counts`. It ends with the end of its standard input.

#[path = "../tests/common/mod.rs"]
mod common;

use std::io::BufRead;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::{definition, description, rigid_body_state};
use parking_lot::Mutex;
use ros2_node::names::Kind;
use ros2_node::{
    Description, Node, Options, Parameter, Parameters, Participant, Publication, Qos, Request, SendError, Service,
    Subscription, Transcoder, TypeName, Value,
};

const LONGEST: usize = 1 << 20;
const FREQUENCY: f64 = 1000.0;

type Failure = Box<dyn std::error::Error>;

#[derive(Default)]
struct Counts {
    sent: AtomicU64,
    unsent: AtomicU64,
    commands: AtomicU64,
    bad: AtomicU64,
}

struct Light(Mutex<f64>);

impl Parameters for Light {
    fn all(&self) -> Vec<Parameter> {
        let text = |text: &str| Value::Text(text.into());
        let angle = Parameter {
            name: "/test/cutoff_angle".into(),
            value: Value::Double(*self.0.lock()),
            description: "rad".into(),
            read_only: false,
        };
        let kind = Parameter { name: "kind".into(), value: text("spot"), description: String::new(), read_only: true };
        vec![angle, kind]
    }

    fn set(&self, _name: &str, value: &Value) -> Result<(), String> {
        match value {
            Value::Double(angle) if (0.0..1.6).contains(angle) => *self.0.lock() = *angle,
            _ => return Err("an angle from 0 to 1.6 is expected".into()),
        }
        Ok(())
    }
}

fn state() -> TypeName {
    TypeName::message("ambf_msgs", "RigidBodyState")
}

fn command() -> TypeName {
    TypeName::message("ambf_msgs", "RigidBodyCmd")
}

/// Sends commands back, by way of ROS 1.
fn echo(node: &Node, counts: &Arc<Counts>) -> Result<Subscription, Failure> {
    let echo = node.publish("/test/Echo", &command(), Qos::new())?;
    let transcoder = Transcoder::new(&description("ambf_msgs", "RigidBodyCmd"))?;
    let (mut ros1, mut cdr, counts) = (Vec::new(), Vec::new(), Arc::clone(counts));
    let on_command = move |body: &[u8]| {
        counts.commands.fetch_add(1, Ordering::Relaxed);
        let there = transcoder.to_ros1(body, &mut ros1);
        if there.and_then(|()| transcoder.to_cdr(&ros1, &mut cdr)).is_err() {
            counts.bad.fetch_add(1, Ordering::Relaxed);
        } else if let Err(error) = echo.send(&cdr) {
            eprintln!("echo: {error}");
        }
    };
    Ok(node.subscribe("/test/Command", &command(), Qos::new().with_depth(100), LONGEST, on_command)?)
}

/// Answers with what the request says, from another thread.
fn service(node: &Node) -> Result<Service, Failure> {
    let type_name = |half: &str| TypeName { package: "ambf_msgs".into(), kind: Kind::Service, name: half.into() };
    let transcoder = |half: &str, text: &str| -> Result<Transcoder, Failure> {
        Ok(Transcoder::new(&Description::parse(type_name(half), text)?)?)
    };
    let request = transcoder("AddModel_Request", "string file")?;
    let reply = transcoder("AddModel_Response", "bool success\nstring model\nstring message")?;
    let transcoders = Arc::new((request, reply));
    let answer = move |request: Request| {
        let transcoders = Arc::clone(&transcoders);
        std::thread::spawn(move || {
            let (mut ros1, mut cdr) = (Vec::new(), Vec::new());
            if transcoders.0.to_ros1(request.body(), &mut ros1).is_ok() {
                let reply = [&[1], &ros1[..], &2u32.to_le_bytes(), b"ok"].concat();
                if transcoders.1.to_cdr(&reply, &mut cdr).is_ok() {
                    request.reply(&cdr);
                }
            }
        });
    };
    Ok(node.serve("/test/AddModel", &type_name("AddModel"), LONGEST, answer)?)
}

/// `std_msgs/Header`, then height, width, encoding, endianness, step and the pixels of `sensor_msgs/Image`.
fn image() -> Vec<u8> {
    let (height, width) = (500u32, 2000u32);
    let mut bytes = vec![0; 16];
    [height, width, 5].iter().for_each(|number| bytes.extend(number.to_le_bytes()));
    bytes.extend(b"mono8\0");
    [width, height * width].iter().for_each(|number| bytes.extend(number.to_le_bytes()));
    bytes.extend((0..height * width).map(|i| (i / 7) as u8));
    bytes
}

fn objects(participant: &Participant, count: usize) -> Result<Vec<(Arc<Publication>, Subscription)>, Failure> {
    let object = |number| {
        let node = participant.node("/", &format!("object_{number}"))?;
        let publication = node.publish(&format!("/object_{number}/State"), &state(), Qos::states(FREQUENCY))?;
        let on_command = |_: &[u8]| ();
        let name = format!("/object_{number}/Command");
        Ok((publication, node.subscribe(&name, &command(), Qos::new(), LONGEST, on_command)?))
    };
    (0..count).map(object).collect()
}

fn publish(publications: &[Arc<Publication>], image: &Publication, stop: &AtomicBool, counts: &Counts) {
    let transcoder = Transcoder::new(&description("ambf_msgs", "RigidBodyState")).expect("the type is usable");
    let image_transcoder = Transcoder::new(&description("sensor_msgs", "Image")).expect("the type is usable");
    let (mut cdr, mut step, mut next) = (Vec::new(), 0u32, Instant::now());
    let pixels = self::image();
    while !stop.load(Ordering::Relaxed) {
        for publication in publications.iter().filter(|publication| publication.is_matched()) {
            transcoder.to_cdr(&rigid_body_state(step), &mut cdr).expect("it is a state");
            match publication.send(&cdr) {
                Ok(()) => counts.sent.fetch_add(1, Ordering::Relaxed),
                Err(SendError::Full) => counts.unsent.fetch_add(1, Ordering::Relaxed),
                Err(error) => panic!("{error}"),
            };
        }
        if step % 100 == 0 && image.is_matched() {
            image_transcoder.to_cdr(&pixels, &mut cdr).expect("it is an image");
            let _ = image.send(&cdr);
        }
        step += 1;
        next += Duration::from_secs_f64(1.0 / FREQUENCY);
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}

fn main() -> Result<(), Failure> {
    let count = std::env::args().nth(1).map_or(Ok(0), |count| count.parse())?;
    let options = Options::from_environment(Arc::new(|line| eprintln!("{line}")))?;
    let participant = Participant::new(options)?;
    let hold = participant.hold_announcements();
    let node = participant.node("/", "test")?;
    let counts = Arc::<Counts>::default();
    let image_type = TypeName::message("sensor_msgs", "Image");
    let image = node.publish("/test/Image", &image_type, Qos::large(1_000_000))?;
    let latched = node.publish("/test/Latched", &TypeName::message("std_msgs", "String"), Qos::latched())?;
    latched.send(b"\x05\0\0\0kept\0")?;
    let served = (echo(&node, &counts)?, service(&node)?, node.serve_parameters(Arc::new(Light(Mutex::new(0.5))))?);
    let objects = objects(&participant, count)?;
    let mut publications = vec![node.publish("/test/State", &state(), Qos::states(FREQUENCY))?];
    publications.extend(objects.iter().map(|(publication, _)| Arc::clone(publication)));
    drop(hold);
    let stop = AtomicBool::new(false);
    println!("ready {}", Description::parse(state(), &definition("ambf_msgs", "RigidBodyState"))?.type_hash());
    std::thread::scope(|scope| {
        scope.spawn(|| publish(&publications, &image, &stop, &counts));
        for _ in std::io::stdin().lock().lines().map_while(Result::ok) {
            let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
            let Counts { sent, unsent, commands, bad } = &*counts;
            println!("{} {} {} {}", of(sent), of(unsent), of(commands), of(bad));
        }
        stop.store(true, Ordering::Relaxed);
    });
    drop((served, objects));
    Ok(())
}
