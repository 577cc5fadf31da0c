//! Packets as attackers and as implementations of ROS 2 send them.

#[path = "../../tests/common/rtps.rs"]
mod rtps;

use super::*;
use crate::environment::silent;
use rtps::{data, endpoint, lease, locator, message, parameter, parameters, part, participant, sequence_number, text};

const SENDER: Prefix = *b"\x01\x10ABCDEFGHIJ";
const OTHER: Prefix = *b"\x01\x10KLMNOPQRST";

fn address(text: &str) -> Ipv4Addr {
    text.parse().unwrap()
}

fn guard(range: Range) -> Guard {
    let networks =
        vec![(Ipv4Addr::LOCALHOST, address("255.0.0.0")), (address("192.168.7.3"), address("255.255.255.0"))];
    Guard::new(range, Interfaces::given(networks), silent())
}

fn check(guard: &mut Guard, packet: &mut [u8], from: &str) -> Result<(), Refusal> {
    guard.check(packet, Some((address(from), 7411).into()), Instant::now())
}

fn send(guard: &mut Guard, parts: &[Vec<u8>], from: &str) -> Result<(), Refusal> {
    check(guard, &mut message(SENDER, parts), from)
}

#[test]
fn only_the_asked_range_is_heard() {
    for (range, near) in [(Range::Localhost, false), (Range::Off, false), (Range::Subnet, true)] {
        for (from, expected) in [("127.0.0.1", true), ("192.168.7.3", true), ("192.168.7.9", near), ("10.1.2.3", false)]
        {
            let result = send(&mut guard(range), &[participant(SENDER, &[])], from);
            assert_eq!(result, if expected { Ok(()) } else { Err(Refusal::Foreign) }, "{range:?}, {from}");
        }
        let mut packet = message(SENDER, &[participant(SENDER, &[])]);
        let six = Some("[::1]:7411".parse().unwrap());
        assert_eq!(guard(range).check(&mut packet, six, Instant::now()), Err(Refusal::Foreign));
        assert_eq!(guard(range).check(&mut packet, None, Instant::now()), Err(Refusal::Foreign));
    }
}

#[test]
fn who_has_not_announced_itself_is_not_heard() {
    let mut guard = guard(Range::Localhost);
    let heartbeat = |first, last| {
        let ids = [0, 0, 3, 0xc7, 0, 0, 3, 0xc2];
        part(7, 0, &[&ids[..], &sequence_number(first), &sequence_number(last), &[1, 0, 0, 0]].concat())
    };
    assert_eq!(send(&mut guard, &[heartbeat(1, 1)], "127.0.0.1"), Err(Refusal::Unannounced));
    assert_eq!(send(&mut guard, &[participant(SENDER, &[])], "127.0.0.1"), Ok(()));
    assert_eq!(send(&mut guard, &[heartbeat(1, 1)], "127.0.0.1"), Ok(()));
    assert_eq!(send(&mut guard, &[heartbeat(1, 0)], "127.0.0.1"), Ok(()), "nothing is available");
    for (first, last) in [(2, 0), (-1, 5), (1, i64::MAX), (i64::MIN, i64::MAX)] {
        let malformed = send(&mut guard, &[heartbeat(first, last)], "127.0.0.1");
        assert_eq!(malformed, Err(Refusal::Malformed("part")), "{first}, {last}");
    }
    // Its last word.
    let guid = parameters(&[parameter(0x0050, &[&SENDER[..], &[0, 0, 1, 0xc1]].concat())]);
    let gone = data([0; 4], [0, 1, 0, 0xc2], 8, &guid);
    assert_eq!(send(&mut guard, &[gone], "127.0.0.1"), Ok(()));
    assert_eq!(send(&mut guard, &[heartbeat(1, 1)], "127.0.0.1"), Err(Refusal::Unannounced));
}

#[test]
fn nobody_speaks_for_another() {
    let mut guard = guard(Range::Subnet);
    for sender in [SENDER, OTHER] {
        check(&mut guard, &mut message(sender, &[participant(sender, &[])]), "192.168.7.9").unwrap();
    }
    for part in [participant(OTHER, &[]), endpoint(OTHER, 1, &[])] {
        assert_eq!(send(&mut guard, &[part], "192.168.7.9"), Err(Refusal::Impostor));
    }
    let key = |of: Prefix, id: [u8; 4]| [parameter(0x0070, &[&of[..], &id].concat()), parameter(1, &[])].concat();
    let leaves = |of| data([0; 4], [0, 1, 0, 0xc2], 2, &key(of, [0, 0, 1, 0xc1]));
    assert_eq!(send(&mut guard, &[leaves(OTHER)], "192.168.7.9"), Err(Refusal::Impostor));
    assert_eq!(send(&mut guard, &[leaves(SENDER)], "192.168.7.9"), Ok(()));
    // What this participant itself is called by, it says itself.
    guard.own().set(OTHER).unwrap();
    let mut own = message(OTHER, &[participant(OTHER, &[])]);
    assert_eq!(check(&mut guard, &mut own, "192.168.7.9"), Err(Refusal::Impostor));
    assert_eq!(check(&mut guard, &mut own, "192.168.7.3"), Ok(()));
    // Other sources and addresses for replies within a message.
    for kind in [0x0c, 0x0d, 0x0f] {
        let refused = send(&mut guard, &[participant(SENDER, &[]), part(kind, 0, &[0; 20])], "192.168.7.9");
        assert!(matches!(refused, Err(Refusal::Unused(_))), "{kind}");
    }
}

/// Readers take messages by their own identifier: announcements came to them from writers that are not checked.
#[test]
fn announcements_come_from_their_writer_alone() {
    let mut guard = guard(Range::Localhost);
    send(&mut guard, &[participant(SENDER, &[])], "127.0.0.1").unwrap();
    for (reader, writer) in
        [([0, 0, 3, 0xc7], [0, 0, 1, 3]), ([0, 0, 4, 0xc7], [0, 0, 3, 0xc2]), ([0, 0, 1, 4], [0, 1, 0, 0xc2])]
    {
        let refused = send(&mut guard, &[data(reader, writer, 4, &[0; 8])], "127.0.0.1");
        assert!(matches!(refused, Err(Refusal::Malformed(_))), "{reader:?}");
    }
    let body = [&[0, 0, 28, 0, 0, 0, 3, 0xc7, 0, 0, 3, 0xc2][..], &sequence_number(1), &[0; 20]].concat();
    assert!(matches!(send(&mut guard, &[part(0x16, 0, &body)], "127.0.0.1"), Err(Refusal::Unused(_))));
    assert_eq!(send(&mut guard, &[data([0, 0, 1, 4], [0, 0, 1, 3], 4, &[0; 8])], "127.0.0.1"), Ok(()));
}

#[test]
fn addresses_of_others_are_struck_out() {
    let kept = |range, from: &str, to: &str| {
        let mut packet = message(SENDER, &[participant(SENDER, &[parameter(0x0031, &locator(to, 7411)), lease(20)])]);
        let before = packet.clone();
        check(&mut guard(range), &mut packet, from).unwrap();
        packet == before
    };
    for (to, local, near) in [
        ("127.0.0.1", true, false),
        ("192.168.7.3", true, false),
        ("192.168.7.9", false, true),
        ("239.255.0.1", false, true),
        ("8.8.8.8", false, false),
        ("10.1.2.3", false, false),
    ] {
        assert_eq!(kept(Range::Localhost, "127.0.0.1", to), local, "{to}");
        assert_eq!(kept(Range::Subnet, "127.0.0.1", to), local || near, "{to}");
        assert_eq!(kept(Range::Subnet, "192.168.7.9", to), near, "{to}");
    }
}

#[test]
fn participants_are_counted_and_leave_with_their_lease() {
    let mut guard = guard(Range::Subnet);
    let now = Instant::now();
    let mut come = |number: u32, from: &str, at: Instant| {
        let prefix: Prefix = [&[1, 16, 0, 0, 0, 0, 0, 0][..], &number.to_be_bytes()].concat().try_into().unwrap();
        let mut packet = message(prefix, &[participant(prefix, &[lease(i32::MAX)])]);
        guard.check(&mut packet, Some((address(from), 7411).into()), at)
    };
    for number in 0..MAX_PARTICIPANTS_PER_ADDRESS as u32 {
        assert_eq!(come(number, "192.168.7.9", now), Ok(()));
    }
    assert_eq!(come(1000, "192.168.7.9", now), Err(Refusal::Participants));
    assert_eq!(come(1000, "192.168.7.10", now), Ok(()), "one machine does not keep others out");
    for number in 2000..2000 + MAX_PARTICIPANTS as u32 {
        let _ = come(number, &format!("192.168.7.{}", 11 + number % 200), now);
    }
    assert_eq!(come(5000, "192.168.7.250", now), Err(Refusal::Participants));
    // However long they say that they stay.
    let later = now + Duration::from_secs(u64::from(MAX_LEASE_S) + 2);
    assert_eq!(come(5000, "192.168.7.250", later), Ok(()));
    assert_eq!(guard.known.len(), 1);
}

#[test]
fn endpoints_are_counted_until_they_end() {
    let mut guard = guard(Range::Localhost);
    send(&mut guard, &[participant(SENDER, &[])], "127.0.0.1").unwrap();
    for number in 0..MAX_ENDPOINTS as u32 {
        send(&mut guard, &[endpoint(SENDER, number, &[])], "127.0.0.1").unwrap();
    }
    assert_eq!(send(&mut guard, &[endpoint(SENDER, 3, &[])], "127.0.0.1"), Ok(()), "it is known");
    assert_eq!(send(&mut guard, &[endpoint(SENDER, 1 << 20, &[])], "127.0.0.1"), Err(Refusal::Endpoints));
    let guid = parameters(&[parameter(0x005a, &[&SENDER[..], &[0, 0, 7, 3]].concat())]);
    let gone = data([0, 0, 3, 0xc7], [0, 0, 3, 0xc2], 8, &guid);
    assert_eq!(send(&mut guard, &[gone], "127.0.0.1"), Ok(()));
    assert_eq!(send(&mut guard, &[endpoint(SENDER, 1 << 20, &[])], "127.0.0.1"), Ok(()));
    let guid = parameters(&[parameter(0x0050, &[&SENDER[..], &[0, 0, 1, 0xc1]].concat())]);
    send(&mut guard, &[data([0; 4], [0, 1, 0, 0xc2], 8, &guid)], "127.0.0.1").unwrap();
    assert_eq!((guard.endpoints, guard.known.len()), (0, 0));
}

#[test]
fn what_announces_more_than_it_holds_is_malformed() {
    let mut guard = guard(Range::Localhost);
    send(&mut guard, &[participant(SENDER, &[])], "127.0.0.1").unwrap();
    let long = 1u32 << 31;
    let wrong = [
        parameter(0x0005, &[&long.to_le_bytes()[..], b"abcd"].concat()),
        parameter(0x0005, &text(&"a".repeat(600))),
        parameter(0x0005, &[&4u32.to_le_bytes()[..], b"abcd"].concat()),
        parameter(0x0029, &long.to_le_bytes()),
        parameter(0x002c, &long.to_le_bytes()),
        parameter(0x002c, &[0; 2]),
        parameter(0x0059, &[&2u32.to_le_bytes()[..], &text("a")].concat()),
        parameter(0x0073, &long.to_le_bytes()),
        parameter(0x0002, &[0; 4]),
        parameter(0x0031, &[0; 20]),
        parameter(0x0070, &[0; 1000]).repeat(5),
    ];
    for part in wrong {
        let refused = send(&mut guard, &[endpoint(SENDER, 1, std::slice::from_ref(&part))], "127.0.0.1");
        assert!(matches!(refused, Err(Refusal::Malformed(_))), "{part:?}: {refused:?}");
    }
    let right = [
        parameter(0x0029, &[&2u32.to_le_bytes()[..], &text("a"), &text("bcde")].concat()),
        parameter(0x002c, &[&8u32.to_le_bytes()[..], b"typehash"].concat()),
        parameter(0x0059, &[&1u32.to_le_bytes()[..], &text("key"), &text("value")].concat()),
        parameter(0x0073, &[&1u32.to_le_bytes()[..], &[0; 4]].concat()),
    ];
    assert_eq!(send(&mut guard, &[endpoint(SENDER, 1, &right)], "127.0.0.1"), Ok(()));
}

#[test]
fn fragments_claim_no_more_than_a_message_may_have() {
    let said = Arc::new(parking_lot::Mutex::new(Vec::new()));
    let mut guard = guard(Range::Localhost);
    let lines = Arc::clone(&said);
    guard.report = Arc::new(move |line| lines.lock().push(line.to_string()));
    send(&mut guard, &[participant(SENDER, &[])], "127.0.0.1").unwrap();
    let mut fragment = |first: u32, count: u16, size: u16, total: u32| {
        let body = [
            &[0, 0, 28, 0, 0, 0, 1, 4, 0, 0, 1, 3][..],
            &sequence_number(1),
            &first.to_le_bytes(),
            &count.to_le_bytes(),
            &size.to_le_bytes(),
            &total.to_le_bytes(),
            &[0; 64],
        ];
        send(&mut guard, &[part(0x16, 0, &body.concat())], "127.0.0.1")
    };
    assert_eq!(fragment(1, 1, 1024, 500_000_000), Err(Refusal::Large));
    assert_eq!(fragment(1, 1, 1024, u32::MAX), Err(Refusal::Large));
    assert_eq!(*said.lock(), ["ROS 2: a message of more than 16 MiB is ignored; this is said once"]);
    assert_eq!(fragment(3, 2, 1024, 4096), Ok(()));
    for (first, count, size, total) in [
        (0, 1, 1024, 4096),
        (4, 2, 1024, 4096),
        (1, 0, 1024, 4096),
        (1, 1, 0, 4096),
        (1, 1, 64, 16 << 20),
        (u32::MAX, u16::MAX, 1024, 4096),
    ] {
        let malformed = fragment(first, count, size, total);
        assert_eq!(malformed, Err(Refusal::Malformed("fragments")), "{first} {count} {size} {total}");
    }
}
