//! Any bytes as packets of RTPS, each after two bytes with its length, from a participant that has announced itself.
#![no_main]

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Instant;

use libfuzzer_sys::fuzz_target;
use ros2_node::guard::{Guard, Interfaces, Refusal};
use ros2_node::{silent, Range};

const SENDER: [u8; 12] = *b"\x01\x10ABCDEFGHIJ";

/// With its header, which fuzzing would hardly find.
fn packet(contents: &[u8]) -> Vec<u8> {
    [b"RTPS\x02\x04\x01\x10", &SENDER[..], contents].concat()
}

fuzz_target!(|bytes: &[u8]| {
    let near = (Ipv4Addr::new(192, 168, 7, 3), Ipv4Addr::new(255, 255, 255, 0));
    let interfaces = Interfaces::given(vec![(Ipv4Addr::LOCALHOST, Ipv4Addr::new(255, 0, 0, 0)), near]);
    let mut guard = Guard::new(Range::Subnet, interfaces, silent());
    let from = Some(SocketAddr::from(([192, 168, 7, 9], 7411)));
    let now = Instant::now();
    let guid = [&[0x50, 0, 16, 0][..], &SENDER, &[0, 0, 1, 0xc1, 1, 0, 0, 0]].concat();
    let here = [&[0x15, 5, 48, 0, 0, 0, 16, 0, 0, 0, 0, 0, 0, 1, 0, 0xc2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 3, 0, 0][..], &guid];
    let mut here = packet(&here.concat());
    assert_eq!(guard.check(&mut here, from, now), Ok(()));
    let mut rest = bytes;
    while let Some((length, after)) = rest.split_first_chunk() {
        let (contents, after) = after.split_at(after.len().min(u16::from_le_bytes(*length).into()));
        let mut packet = packet(contents);
        let first = guard.check(&mut packet, from, now);
        if first.is_ok() {
            // What has been changed is as it is to be.
            let once = packet.clone();
            let again = guard.check(&mut packet, from, now);
            assert!(matches!(again, Ok(()) | Err(Refusal::Unannounced)), "{again:?}");
            assert_eq!(packet, once);
            // Strangers are not heard, whatever they say.
            let stranger = Some(SocketAddr::from(([10, 1, 2, 3], 7411)));
            assert_eq!(guard.check(&mut packet, stranger, now), Err(Refusal::Foreign));
        }
        rest = after;
    }
});
