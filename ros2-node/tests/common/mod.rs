//! What tests and examples share: definitions of messages, waiting, participants of their own.
#![allow(dead_code)]

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use ros2_node::{Description, Options, TypeName};

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Folders with packages of ROS 1: ours, then Debian's.
fn packages() -> [PathBuf; 2] {
    [root().join("resources/ros"), PathBuf::from("/usr/share")]
}

fn text_of(package: &str, name: &str) -> String {
    let file = |folder: &PathBuf| folder.join(package).join("msg").join(format!("{name}.msg"));
    let found = packages().iter().map(file).find(|file| file.is_file());
    std::fs::read_to_string(found.unwrap_or_else(|| panic!("no {package}/{name}.msg"))).unwrap()
}

/// The definition of `package/name` with those of all it uses, as ROS 1 sends it.
pub fn definition(package: &str, name: &str) -> String {
    let (mut whole, mut known) = (text_of(package, name), vec![]);
    let mut open = uses(package, &whole);
    while let Some((package, name)) = open.pop() {
        if known.contains(&(package.clone(), name.clone())) {
            continue;
        }
        let text = text_of(&package, &name);
        whole.push_str(&format!("\n{}\nMSG: {package}/{name}\n{text}", "=".repeat(80)));
        open.extend(uses(&package, &text));
        known.push((package, name));
    }
    whole
}

fn uses(package: &str, text: &str) -> Vec<(String, String)> {
    let built_in = ["bool", "byte", "char", "string", "time", "duration"];
    let statements = text.lines().map(|line| line.split('#').next().unwrap().trim());
    let kinds = statements.filter_map(|line| line.split_whitespace().next());
    let kinds = kinds.map(|kind| kind.split('[').next().unwrap());
    let messages = kinds
        .filter(|kind| !built_in.contains(kind) && !["int", "uint", "float"].iter().any(|own| kind.starts_with(own)));
    messages
        .map(|kind| match kind.split_once('/') {
            Some((package, name)) => (package.to_owned(), name.to_owned()),
            None if kind == "Header" => ("std_msgs".into(), "Header".into()),
            None => (package.to_owned(), kind.to_owned()),
        })
        .collect()
}

/// The description of the message `package/name`.
pub fn description(package: &str, name: &str) -> Description {
    Description::parse(TypeName::message(package, name), &definition(package, name)).unwrap()
}

/// Domains that tests of this program have: names in the system's table of sockets, as those of `tests/domains.py`.
static DOMAINS: Mutex<Vec<UnixListener>> = Mutex::new(Vec::new());

/// Options of a test: on this machine, in a domain that no other test has.
pub fn options() -> Options {
    let mut random = [0; 1];
    std::io::Read::read_exact(&mut std::fs::File::open("/dev/urandom").unwrap(), &mut random).unwrap();
    let report = std::sync::Arc::new(|line: std::fmt::Arguments<'_>| eprintln!("{line}"));
    let take = |number: u16| {
        let name = SocketAddr::from_abstract_name(format!("ambf-tests-domain-{number}")).unwrap();
        UnixListener::bind_addr(&name).map(|mark| DOMAINS.lock().unwrap().push(mark)).is_ok()
    };
    let domain = (0..100).map(|i| 1 + (u16::from(random[0]) + i) % 100).find(|number| take(*number));
    Options { domain: domain.expect("a domain that no test has"), report, ..Options::default() }
}

/// Waits until `condition`; fails when that takes long.
pub fn wait(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while !condition() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The ROS 1 bytes of a `RigidBodyState` with two joints and one child.
pub fn rigid_body_state(step: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let text = |bytes: &mut Vec<u8>, text: &str| {
        bytes.extend((text.len() as u32).to_le_bytes());
        bytes.extend(text.as_bytes());
    };
    bytes.extend([0; 4]);
    bytes.extend(1_700_000_000u32.to_le_bytes());
    bytes.extend(123_456_789u32.to_le_bytes());
    text(&mut bytes, "world");
    bytes.extend(step.to_le_bytes());
    text(&mut bytes, "/ambf/env/BODY a");
    text(&mut bytes, "a");
    [1.5f32, 2.5, 3.5].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    (0..3 + 7 + 6 + 6).for_each(|i| bytes.extend((f64::from(i) + 0.5).to_le_bytes()));
    bytes.extend(1u32.to_le_bytes());
    text(&mut bytes, "b");
    bytes.extend(2u32.to_le_bytes());
    text(&mut bytes, "joint one");
    text(&mut bytes, "Größe");
    for list in 0..3 {
        bytes.extend(2u32.to_le_bytes());
        [list as f32, -1.25].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    bytes
}
