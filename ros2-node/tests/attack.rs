//! A program with a participant, and somebody on its machine who sends it packets: it goes on working, and needs no more
//! than a bounded amount of memory.

mod common;
#[path = "common/rtps.rs"]
mod rtps;

use std::io::{BufRead, BufReader};
use std::net::{Ipv4Addr, UdpSocket};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Arc;
use std::time::Duration;

use common::{options, wait};
use ros2_node::guard::{MAX_ENDPOINTS, MAX_MESSAGE, MAX_PARTICIPANTS_PER_ADDRESS};
use ros2_node::{Options, Participant, Qos, TypeName};
use rtps::{lease, locator, message, parameter, parameters, part, sequence_number, text, Prefix};

/// What all packets together may make the program need, kB.
const ALLOWED: usize = 64 << 10;

/// Objects that the program has: a state and a command each.
const OBJECTS: usize = 20;

/// The program, and a client that tells whether it works.
struct Victim {
    program: Child,
    port: u16,
    idle: usize,
    received: Arc<AtomicUsize>,
    // Dropped first, as other clients do.
    _client: Box<dyn std::any::Any>,
}

impl Victim {
    fn start() -> Self {
        let options = options();
        let domain = options.domain;
        let examples = std::env::current_exe().unwrap().parent().unwrap().join("../examples/peer");
        let mut program = Command::new(examples)
            .arg(OBJECTS.to_string())
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .env_remove("ROS_LOCALHOST_ONLY")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(program.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        assert!(line.starts_with("ready"), "{line}");
        let ports = ports(program.id());
        let first = 7410 + 250 * domain;
        let port = (first..first + 240).find(|port| ports.contains(port)).expect("the port for announcements");
        let received = Arc::<AtomicUsize>::default();
        let client = client(options, Arc::clone(&received));
        let mut victim = Self { program, port, idle: 0, received, _client: Box::new(client) };
        victim.works();
        std::thread::sleep(Duration::from_secs(1));
        victim.idle = victim.memory();
        victim
    }

    /// Resident memory, kB.
    fn memory(&self) -> usize {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.program.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS")).expect("the program runs");
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }

    /// It goes on sending.
    fn works(&mut self) {
        let before = self.received.load(Ordering::Relaxed);
        wait("states arrive", || self.received.load(Ordering::Relaxed) > before + 20);
        assert!(self.program.try_wait().unwrap().is_none(), "it has ended");
    }

    /// After `what`, it works and has not grown by too much.
    fn stands(&mut self, what: &str) {
        self.works();
        let grown = self.memory().saturating_sub(self.idle);
        println!("{what}: {grown} kB more than the {} kB before", self.idle);
        assert!(grown < ALLOWED, "{what}: {grown} kB");
    }
}

impl Drop for Victim {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

/// Counts states.
fn client(options: Options, received: Arc<AtomicUsize>) -> impl std::any::Any {
    let participant = Participant::new(options).unwrap();
    let node = participant.node("/", "client").unwrap();
    let state = TypeName::message("ambf_msgs", "RigidBodyState");
    let count = move |_: &[u8]| {
        received.fetch_add(1, Ordering::Relaxed);
    };
    let subscription = node.subscribe("/test/State", &state, Qos::new(), 1 << 20, count).unwrap();
    (subscription, node, participant)
}

/// Ports of all UDP sockets of a process, whose addresses are checked: this machine's, and that of a multicast group, which
/// brings what other programs of this machine have sent to it.
fn ports(process: u32) -> Vec<u16> {
    let links = std::fs::read_dir(format!("/proc/{process}/fd")).unwrap();
    let links: Vec<String> = links
        .filter_map(|link| std::fs::read_link(link.unwrap().path()).ok())
        .map(|link| link.to_string_lossy().into_owned())
        .collect();
    let table = std::fs::read_to_string("/proc/net/udp").unwrap();
    let own = table.lines().skip(1).filter_map(|line| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let (address, port) = fields[1].split_once(':')?;
        let address = Ipv4Addr::from(u32::from_str_radix(address, 16).ok()?.to_le_bytes());
        links.contains(&format!("socket:[{}]", fields[9])).then_some((address, u16::from_str_radix(port, 16).ok()?))
    });
    let own: Vec<_> = own.collect();
    assert!(own.len() >= 4, "{own:?}");
    assert!(
        own.iter().all(|(address, _)| address.is_loopback() || *address == Ipv4Addr::new(239, 255, 0, 1)),
        "{own:?}"
    );
    own.into_iter().filter(|(address, _)| address.is_loopback()).map(|(_, port)| port).collect()
}

/// Somebody with a socket on this machine.
struct Attacker {
    socket: UdpSocket,
    port: u16,
    sent: usize,
}

impl Attacker {
    fn of(victim: &Victim) -> Self {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        Self { socket, port: victim.port, sent: 0 }
    }

    /// At a pace that the receiver's buffer stands.
    fn send(&mut self, packet: &[u8]) {
        let _ = self.socket.send_to(packet, (Ipv4Addr::LOCALHOST, self.port));
        self.sent += 1;
        if self.sent.is_multiple_of(32) || packet.len() > 4096 && self.sent.is_multiple_of(4) {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn announce(&mut self, prefix: Prefix) {
        let own = self.socket.local_addr().unwrap().port().into();
        let more = [
            parameter(0x0015, &[2, 4, 0, 0]),
            parameter(0x0016, &[1, 16, 0, 0]),
            parameter(0x0031, &locator("127.0.0.1", own)),
            parameter(0x0032, &locator("127.0.0.1", own)),
            parameter(0x0058, &0xfffu32.to_le_bytes()),
            lease(100),
        ];
        self.send(&message(prefix, &[rtps::participant(prefix, &more)]));
        std::thread::sleep(Duration::from_millis(50));
    }

    /// Announces a writer of `topic`; its identifier. `number`: of the announcement among those of its sender, from 1.
    fn write(&mut self, prefix: Prefix, number: u32, topic: &str, type_name: &str) -> [u8; 4] {
        let id = entity(number, 3);
        let guid = [&prefix[..], &id].concat();
        let list = parameters(&[
            parameter(0x005a, &guid),
            parameter(0x0005, &text(topic)),
            parameter(0x0007, &text(type_name)),
            parameter(0x001a, &[2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
        ]);
        let body = [&[0, 0, 16, 0, 0, 0, 3, 0xc7, 0, 0, 3, 0xc2][..], &sequence_number(number.into()), &list].concat();
        self.send(&message(prefix, &[part(0x15, 4, &body)]));
        id
    }

    /// What comes back, for a while.
    fn received(&self) -> Vec<Vec<u8>> {
        let mut buffer = vec![0; 1 << 16];
        let mut packets = vec![];
        while packets.len() < 2000 {
            let Ok(length) = self.socket.recv(&mut buffer) else { break };
            packets.push(buffer[..length].to_vec());
        }
        packets
    }
}

fn entity(number: u32, kind: u8) -> [u8; 4] {
    let [_, a, b, c] = number.to_be_bytes();
    [a, b, c, kind]
}

fn prefix(number: u32) -> Prefix {
    [&[1, 16, 0, 0, 0, 0, 0, 0][..], &number.to_be_bytes()].concat().try_into().unwrap()
}

/// One HEARTBEAT of 52 bytes used to cost 1 GB a second until the program was aborted.
#[test]
fn ranges_of_sequence_numbers_reserve_nothing() {
    let mut victim = Victim::start();
    let mut attacker = Attacker::of(&victim);
    let me = prefix(1);
    attacker.announce(me);
    attacker.write(me, 1, "rt/object_0/Command", "ambf_msgs::msg::dds_::RigidBodyCmd_");
    for (reader, writer) in
        [([0, 0, 3, 0xc7], [0, 0, 3, 0xc2]), ([0, 0, 4, 0xc7], [0, 0, 4, 0xc2]), ([0; 4], entity(1, 3))]
    {
        for (count, last) in [1i64 << 20, 1 << 40, (1 << 52) - 1].into_iter().enumerate() {
            let ids = [reader, writer].concat();
            let count = (count as u32 + 1).to_le_bytes();
            let heartbeat = [&ids[..], &sequence_number(1), &sequence_number(last), &count].concat();
            attacker.send(&message(me, &[part(7, 0, &heartbeat)]));
            let gap = [&ids[..], &sequence_number(5), &sequence_number(last), &[0; 4]].concat();
            attacker.send(&message(me, &[part(8, 0, &gap)]));
        }
    }
    victim.stands("ranges of sequence numbers");
}

/// Sixteen packets that announced a message of 500 MB each used to cost 3.8 GB.
#[test]
fn fragments_and_gaps_reserve_little() {
    let mut victim = Victim::start();
    let mut attacker = Attacker::of(&victim);
    let me = prefix(1);
    attacker.announce(me);
    for object in 0..OBJECTS as u32 {
        let topic = format!("rt/object_{object}/Command");
        attacker.write(me, object + 1, &topic, "ambf_msgs::msg::dds_::RigidBodyCmd_");
    }
    std::thread::sleep(Duration::from_millis(200));
    for number in 1..40 {
        for object in 0..OBJECTS as u32 {
            for total in [500_000_000, MAX_MESSAGE, 1 << 20] {
                let writer = entity(object + 1, 3);
                let start = [&[0, 0, 28, 0, 0, 0, 0, 0][..], &writer, &sequence_number(number)].concat();
                let body = [&start[..], &1u32.to_le_bytes(), &[1, 0, 0, 4], &total.to_le_bytes(), &[7; 1024]].concat();
                attacker.send(&message(me, &[part(0x16, 0, &body)]));
            }
        }
    }
    victim.stands("fragments of messages that never become whole");
    // Messages that wait for the first one, for ever.
    for number in 2..100 {
        for object in 0..OBJECTS as u32 {
            let writer = entity(object + 1, 3);
            let start = [&[0, 0, 16, 0, 0, 0, 0, 0][..], &writer, &sequence_number(number)].concat();
            let body = [&start[..], &[0, 1, 0, 0], &[7; 60_000]].concat();
            attacker.send(&message(me, &[part(0x15, 4, &body)]));
        }
    }
    victim.stands("messages that cannot be delivered");
}

#[test]
fn participants_and_endpoints_are_bounded() {
    let mut victim = Victim::start();
    let mut attacker = Attacker::of(&victim);
    for number in 1..4 * MAX_PARTICIPANTS_PER_ADDRESS as u32 {
        let me = prefix(number);
        let more = [parameter(0x0062, &text(&"name".repeat(100))), lease(i32::MAX)];
        attacker.send(&message(me, &[rtps::participant(me, &more)]));
    }
    victim.stands("participants");
    for number in 1..2 * MAX_ENDPOINTS as u32 {
        let topic = format!("rt/{number}/{}", "name/".repeat(90));
        attacker.write(prefix(1 + number % 20), 1 + number / 20, &topic, &"type".repeat(100));
    }
    victim.stands("endpoints");
}

/// Some 9,000 such packets used to end the program.
#[test]
fn mutated_packets_do_no_harm() {
    let mut victim = Victim::start();
    let mut attacker = Attacker::of(&victim);
    let me = prefix(1);
    attacker.announce(me);
    for object in 0..OBJECTS as u32 {
        let topic = format!("rt/object_{object}/Command");
        attacker.write(me, object + 1, &topic, "ambf_msgs::msg::dds_::RigidBodyCmd_");
    }
    // What the program itself says, in the attacker's name.
    let mut packets = attacker.received();
    assert!(packets.len() > 20, "the program announces itself: {}", packets.len());
    let its: Prefix = packets[0][8..20].try_into().unwrap();
    for packet in &mut packets {
        while let Some(at) = packet.windows(12).position(|window| window == its) {
            packet[at..at + 12].copy_from_slice(&me);
        }
    }
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for round in 0..100_000 {
        if round % 5000 == 0 {
            // It may have said good-bye meanwhile.
            attacker.announce(me);
            assert!(victim.program.try_wait().unwrap().is_none(), "it has ended after {round}");
        }
        let mut packet = packets[random.below(packets.len())].clone();
        for _ in 0..=random.below(3) {
            mutate(&mut packet, &packets, &mut random);
        }
        attacker.send(&packet);
    }
    victim.stands("100,000 mutated packets");
}

/// Marsaglia's xorshift64.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % bound.max(1) as u64) as usize
    }
}

/// Changes what comes after the header: a bit, a byte, four bytes, a piece of another packet, the end.
fn mutate(packet: &mut Vec<u8>, others: &[Vec<u8>], random: &mut Random) {
    const NUMBERS: [u32; 8] = [0, 1, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x100];
    let at = 20 + random.below(packet.len() - 20);
    match random.below(6) {
        0 => packet[at] ^= 1 << random.below(8),
        1 => packet[at] = random.below(256) as u8,
        2 | 3 => {
            let end = packet.len().min(at + 4);
            let number = NUMBERS[random.below(NUMBERS.len())].to_le_bytes();
            packet[at..end].copy_from_slice(&number[..end - at]);
        }
        4 => {
            let other = &others[random.below(others.len())];
            let from = 20 + random.below(other.len() - 20);
            packet.truncate(at);
            packet.extend(&other[from..]);
            packet.truncate(60_000);
        }
        _ => packet.truncate(at.max(24)),
    }
}
