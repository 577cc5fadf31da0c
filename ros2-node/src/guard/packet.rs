//! The parts of an RTPS message, as far as they make RustDDS remember or send something (RTPS 2.5, chapters 8.3 and 9.4).

use std::hash::{BuildHasher, RandomState};
use std::net::Ipv4Addr;
use std::time::Duration;

use super::{Prefix, Refusal, MAX_LEASE_S, MAX_MESSAGE};

/// Bytes of the announcement of a participant, an endpoint or a topic.
const MAX_ANNOUNCEMENT: usize = 4096;
/// Bytes of a message that says that a participant is alive.
const MAX_LIVELINESS: usize = 256;
/// Characters of a name of a topic, a type or an entity. Names of ROS 2 have at most 255 before they are decorated.
const MAX_NAME: usize = 512;
/// Bytes of user data, of partitions, of properties.
const MAX_DATA: usize = 2048;
/// Addresses in one announcement.
const MAX_LOCATORS: usize = 32;
/// Sequence numbers beyond this one are not believed; at a million messages a second they begin after 142 years.
const MAX_SEQUENCE_NUMBER: i64 = 1 << 52;
/// Fragments of a message.
const MAX_FRAGMENTS: u32 = 1 << 16;

/// Parts of a message.
mod kind {
    pub const PAD: u8 = 0x01;
    pub const ACKNACK: u8 = 0x06;
    pub const HEARTBEAT: u8 = 0x07;
    pub const GAP: u8 = 0x08;
    pub const INFO_TS: u8 = 0x09;
    pub const INFO_SRC: u8 = 0x0c;
    pub const INFO_REPLY_IP4: u8 = 0x0d;
    pub const INFO_DST: u8 = 0x0e;
    pub const INFO_REPLY: u8 = 0x0f;
    pub const NACK_FRAG: u8 = 0x12;
    pub const HEARTBEAT_FRAG: u8 = 0x13;
    pub const DATA: u8 = 0x15;
    pub const DATA_FRAG: u8 = 0x16;
}

/// Parameters (RTPS 2.5, table 9.19).
mod pid {
    pub const PAD: u16 = 0x0000;
    pub const SENTINEL: u16 = 0x0001;
    pub const LEASE: u16 = 0x0002;
    pub const TOPIC_NAME: u16 = 0x0005;
    pub const TYPE_NAME: u16 = 0x0007;
    pub const PARTITION: u16 = 0x0029;
    pub const USER_DATA: u16 = 0x002c;
    pub const GROUP_DATA: u16 = 0x002d;
    pub const TOPIC_DATA: u16 = 0x002e;
    pub const UNICAST: u16 = 0x002f;
    pub const MULTICAST: u16 = 0x0030;
    pub const DEFAULT_UNICAST: u16 = 0x0031;
    pub const METATRAFFIC_UNICAST: u16 = 0x0032;
    pub const METATRAFFIC_MULTICAST: u16 = 0x0033;
    pub const CONTENT_FILTER: u16 = 0x0035;
    pub const DEFAULT_MULTICAST: u16 = 0x0048;
    pub const PARTICIPANT_GUID: u16 = 0x0050;
    pub const PROPERTIES: u16 = 0x0059;
    pub const ENDPOINT_GUID: u16 = 0x005a;
    pub const ENTITY_NAME: u16 = 0x0062;
    pub const KEY_HASH: u16 = 0x0070;
    pub const REPRESENTATIONS: u16 = 0x0073;
}

/// Endpoints that each participant has: writer, reader, what goes from one to the other.
const BUILT_IN: [([u8; 4], [u8; 4], Topic); 5] = [
    ([0, 1, 0, 0xc2], [0, 1, 0, 0xc7], Topic::Participants),
    ([0, 0, 2, 0xc2], [0, 0, 2, 0xc7], Topic::Topics),
    ([0, 0, 3, 0xc2], [0, 0, 3, 0xc7], Topic::Endpoints),
    ([0, 0, 4, 0xc2], [0, 0, 4, 0xc7], Topic::Endpoints),
    ([0, 2, 0, 0xc2], [0, 2, 0, 0xc7], Topic::Liveliness),
];

#[derive(Clone, Copy, PartialEq)]
enum Topic {
    Participants,
    Topics,
    Endpoints,
    Liveliness,
}

/// What a packet announces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Announcement {
    /// Its sender is there.
    Here { lease: Option<Duration> },
    /// Its sender leaves.
    Gone,
    /// An endpoint or a topic of its sender.
    Endpoint { hash: u64 },
    /// The same has ended.
    EndpointGone { hash: u64 },
}

/// What is done with the parts of a packet.
pub(super) struct Visitor<'a> {
    pub announcements: &'a mut Vec<Announcement>,
    /// Whether this machine may send to an address that its sender gives as its own, or as that of a multicast group.
    pub may_reply_to: &'a dyn Fn(Ipv4Addr) -> bool,
    pub hashes: &'a RandomState,
}

/// Checks a packet; the identifier of its sender.
pub(super) fn visit(packet: &mut [u8], visitor: &mut Visitor<'_>) -> Result<Prefix, Refusal> {
    let (header, mut rest) = packet.split_at_mut_checked(20).ok_or(Refusal::Malformed("header"))?;
    if &header[..4] != b"RTPS" || header[4] != 2 {
        return Err(Refusal::Malformed("header"));
    }
    let prefix: Prefix = header[8..].try_into().map_err(|_| Refusal::Malformed("header"))?;
    while !rest.is_empty() {
        let (head, after) = rest.split_at_mut_checked(4).ok_or(Refusal::Malformed("header of a part"))?;
        let (kind, flags) = (head[0], head[1]);
        let order = Order { is_little: flags & 1 != 0 };
        let length = usize::from(order.u16(head, 2).unwrap_or(0));
        // A length of 0 means "to the end", but for parts that may be empty.
        let to_end = length == 0 && kind != kind::PAD && kind != kind::INFO_TS;
        let length = if to_end { after.len() } else { length };
        let (body, after) = after.split_at_mut_checked(length).ok_or(Refusal::Malformed("length of a part"))?;
        part(kind, flags, order, body, prefix, visitor)?;
        rest = after;
    }
    Ok(prefix)
}

fn part(
    kind: u8,
    flags: u8,
    order: Order,
    body: &mut [u8],
    sender: Prefix,
    visitor: &mut Visitor<'_>,
) -> Result<(), Refusal> {
    let is_valid = match kind {
        kind::DATA => return data(flags, order, body, sender, visitor),
        kind::DATA_FRAG => return fragments(flags, order, body),
        kind::INFO_SRC | kind::INFO_REPLY | kind::INFO_REPLY_IP4 => {
            return Err(Refusal::Unused("other source or address for replies"))
        }
        kind::ACKNACK => sequence_number(order, body, 8, 0)
            .and_then(|_| number_set(order, body, 16))
            .is_some_and(|end| end + 4 <= body.len()),
        kind::HEARTBEAT => {
            let (first, last) = (sequence_number(order, body, 8, 0), sequence_number(order, body, 16, -1));
            body.len() >= 28 && first.zip(last).is_some_and(|(first, last)| first <= last + 1)
        }
        kind::GAP => {
            let start = sequence_number(order, body, 8, 1);
            let base = sequence_number(order, body, 16, 1);
            start.zip(base).is_some_and(|(start, base)| start <= base) && number_set(order, body, 24).is_some()
        }
        kind::INFO_TS => flags & 2 != 0 || body.len() >= 8,
        kind::INFO_DST => body.len() >= 12,
        kind::NACK_FRAG => {
            let base = order.u32(body, 16).filter(|base| (1..=MAX_FRAGMENTS).contains(base));
            sequence_number(order, body, 8, 1).is_some()
                && base.and_then(|_| number_set(order, body, 20)).is_some_and(|end| end + 4 <= body.len())
        }
        kind::HEARTBEAT_FRAG => sequence_number(order, body, 8, 1).is_some() && body.len() >= 24,
        // RustDDS skips what it does not know.
        _ => true,
    };
    if is_valid {
        Ok(())
    } else {
        Err(Refusal::Malformed("part"))
    }
}

/// A message, or an announcement.
fn data(flags: u8, order: Order, body: &mut [u8], sender: Prefix, visitor: &mut Visitor<'_>) -> Result<(), Refusal> {
    let malformed = Refusal::Malformed("message");
    let skipped = usize::from(order.u16(body, 2).ok_or(malformed)?);
    let topic = built_in_topic(body.get(4..12).ok_or(malformed)?)?;
    sequence_number(order, body, 12, 1).filter(|_| skipped >= 16).ok_or(malformed)?;
    let mut rest = body.get_mut(4 + skipped..).ok_or(malformed)?;
    let mut key = None;
    if flags & 2 != 0 {
        let (end, hash) = inline_parameters(order, rest)?;
        (rest, key) = (&mut rest[end..], hash);
    }
    let (has_data, has_key) = (flags & 4 != 0, flags & 8 != 0);
    let Some(topic) = topic else { return Ok(()) };
    if topic == Topic::Liveliness {
        return if rest.len() <= MAX_LIVELINESS { Ok(()) } else { Err(malformed) };
    }
    let mut found = Found { guid: key, ..Found::default() };
    if has_data || has_key {
        found = announcement(rest, found, visitor)?;
    }
    let of_sender = |guid: [u8; 16]| if guid[..12] == sender { Ok(guid) } else { Err(Refusal::Impostor) };
    let announced = match topic {
        Topic::Participants => {
            let guid = of_sender(found.guid.ok_or(Refusal::Malformed("participant"))?)?;
            if guid[12..] != [0, 0, 1, 0xc1] {
                return Err(Refusal::Malformed("participant"));
            }
            if has_data {
                Announcement::Here { lease: found.lease }
            } else {
                Announcement::Gone
            }
        }
        Topic::Endpoints => {
            let guid = of_sender(found.guid.ok_or(Refusal::Malformed("endpoint"))?)?;
            let hash = visitor.hashes.hash_one(guid);
            if has_data {
                Announcement::Endpoint { hash }
            } else {
                Announcement::EndpointGone { hash }
            }
        }
        // RustDDS forgets topics when their endpoints have ended.
        Topic::Topics if !has_data => return Ok(()),
        Topic::Topics => Announcement::Endpoint { hash: found.topic.ok_or(Refusal::Malformed("topic"))? },
        Topic::Liveliness => return Ok(()),
    };
    visitor.announcements.push(announced);
    Ok(())
}

/// The topic that goes from the writer to the reader if they are built in. `ids`: reader, writer.
fn built_in_topic(ids: &[u8]) -> Result<Option<Topic>, Refusal> {
    let (reader, writer) = ids.split_at(4);
    for (its_writer, its_reader, topic) in BUILT_IN {
        if writer == its_writer || reader == its_reader {
            let is_pair = writer == its_writer && (reader == its_reader || reader == [0; 4]);
            return if is_pair { Ok(Some(topic)) } else { Err(Refusal::Malformed("reader of another writer")) };
        }
    }
    Ok(None)
}

/// Fragments of a message.
fn fragments(flags: u8, order: Order, body: &[u8]) -> Result<(), Refusal> {
    let malformed = Refusal::Malformed("fragments");
    let skipped = usize::from(order.u16(body, 2).ok_or(malformed)?);
    if built_in_topic(body.get(4..12).ok_or(malformed)?)?.is_some() {
        return Err(Refusal::Unused("announcement in fragments"));
    }
    sequence_number(order, body, 12, 1).filter(|_| skipped >= 28).ok_or(malformed)?;
    let first = order.u32(body, 20).ok_or(malformed)?;
    let count = u32::from(order.u16(body, 24).ok_or(malformed)?);
    let size = u32::from(order.u16(body, 26).ok_or(malformed)?);
    let total = order.u32(body, 28).ok_or(malformed)?;
    let rest = body.get(4 + skipped..).ok_or(malformed)?;
    if flags & 2 != 0 {
        inline_parameters(order, rest)?;
    }
    if total > MAX_MESSAGE {
        return Err(Refusal::Large);
    }
    let fragments = total.div_ceil(size.max(1));
    let is_valid = (1..=total).contains(&size)
        && fragments <= MAX_FRAGMENTS
        && first >= 1
        && count >= 1
        && first.checked_add(count - 1).is_some_and(|last| last <= fragments);
    if is_valid {
        Ok(())
    } else {
        Err(malformed)
    }
}

/// Where a list of parameters before a message ends, and the key in it.
fn inline_parameters(order: Order, bytes: &[u8]) -> Result<(usize, Option<[u8; 16]>), Refusal> {
    let malformed = Refusal::Malformed("parameters");
    let (mut at, mut key) = (0, None);
    loop {
        let id = order.u16(bytes, at).ok_or(malformed)?;
        let length = usize::from(order.u16(bytes, at + 2).ok_or(malformed)?);
        if id == pid::SENTINEL {
            return Ok((at + 4, key));
        }
        let value = bytes.get(at + 4..at + 4 + length).ok_or(malformed)?;
        if id == pid::KEY_HASH {
            key = Some(value.try_into().map_err(|_| malformed)?);
        }
        at += 4 + length;
    }
}

/// What an announcement says.
#[derive(Default)]
struct Found {
    guid: Option<[u8; 16]>,
    lease: Option<Duration>,
    topic: Option<u64>,
}

/// Reads an announcement, and strikes out addresses and long times.
fn announcement(payload: &mut [u8], mut found: Found, visitor: &mut Visitor<'_>) -> Result<Found, Refusal> {
    let malformed = Refusal::Malformed("announcement");
    if payload.len() > MAX_ANNOUNCEMENT {
        return Err(Refusal::Malformed("announcement of more than 4096 bytes"));
    }
    let order = match payload.get(..2) {
        Some([0, 2]) => Order { is_little: false },
        Some([0, 3]) => Order { is_little: true },
        _ => return Err(malformed),
    };
    let mut locators = 0;
    let mut at = 4;
    loop {
        let id = order.u16(payload, at).ok_or(malformed)?;
        let length = usize::from(order.u16(payload, at + 2).ok_or(malformed)?);
        if id == pid::SENTINEL {
            return Ok(found);
        }
        let (before, value) = payload.split_at_mut_checked(at + 4).ok_or(malformed)?;
        let value = value.get_mut(..length).ok_or(malformed)?;
        let is_valid = match id {
            pid::PARTICIPANT_GUID | pid::ENDPOINT_GUID => {
                let guid: Option<[u8; 16]> = (&*value).try_into().ok();
                // A participant may be named beside its endpoint; both are of the same sender.
                let agrees = |known: [u8; 16]| guid.is_some_and(|guid| guid[..12] == known[..12]);
                let is_valid = guid.is_some() && found.guid.is_none_or(agrees);
                if id == pid::ENDPOINT_GUID || found.guid.is_none() {
                    found.guid = guid;
                }
                is_valid
            }
            pid::LEASE => {
                let seconds = order.u32(value, 0);
                if seconds.is_some_and(|seconds| seconds > MAX_LEASE_S && seconds < 1 << 31) && length == 8 {
                    value[..4].copy_from_slice(&order.bytes(MAX_LEASE_S));
                    value[4..].fill(0);
                }
                found.lease = seconds.map(|seconds| Duration::from_secs(u64::from(seconds.min(MAX_LEASE_S)) + 1));
                length == 8 && seconds.is_some_and(|seconds| seconds < 1 << 31)
            }
            pid::UNICAST
            | pid::MULTICAST
            | pid::DEFAULT_UNICAST
            | pid::DEFAULT_MULTICAST
            | pid::METATRAFFIC_UNICAST
            | pid::METATRAFFIC_MULTICAST => {
                locators += 1;
                let is_udp = order.u32(value, 0) == Some(1);
                let address: Option<[u8; 4]> = value.get(20..24).and_then(|bytes| bytes.try_into().ok());
                if is_udp && address.is_some_and(|address| !(visitor.may_reply_to)(address.into())) {
                    before[at..at + 2].copy_from_slice(&pid::PAD.to_le_bytes());
                }
                length == 24 && locators <= MAX_LOCATORS
            }
            pid::TOPIC_NAME => {
                found.topic = Some(visitor.hashes.hash_one(&*value));
                string(order, value, 0).is_some_and(|end| end <= MAX_NAME)
            }
            pid::TYPE_NAME | pid::ENTITY_NAME => string(order, value, 0).is_some_and(|end| end <= MAX_NAME),
            pid::USER_DATA | pid::GROUP_DATA | pid::TOPIC_DATA => {
                let count = order.u32(value, 0).map(|count| count as usize);
                length <= MAX_DATA && count.is_some_and(|count| count <= length - 4)
            }
            pid::REPRESENTATIONS => {
                let count = order.u32(value, 0).map(|count| count as usize);
                count.is_some_and(|count| count <= (length - 4) / 2)
            }
            pid::PARTITION => length <= MAX_DATA && strings(order, value, 0, 1).is_some(),
            pid::PROPERTIES => length <= MAX_DATA && strings(order, value, 0, 2).is_some(),
            pid::CONTENT_FILTER => {
                let parameters = (0..4).try_fold(0, |at, _| string(order, value, at));
                length <= MAX_DATA && parameters.and_then(|at| strings(order, value, at, 1)).is_some()
            }
            _ => true,
        };
        if !is_valid {
            return Err(malformed);
        }
        at += 4 + length;
    }
}

/// Order of bytes.
#[derive(Clone, Copy)]
struct Order {
    is_little: bool,
}

impl Order {
    fn u16(self, bytes: &[u8], at: usize) -> Option<u16> {
        let bytes = bytes.get(at..at.checked_add(2)?)?.try_into().ok()?;
        Some(if self.is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    }

    fn u32(self, bytes: &[u8], at: usize) -> Option<u32> {
        let bytes = bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if self.is_little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    fn bytes(self, value: u32) -> [u8; 4] {
        if self.is_little {
            value.to_le_bytes()
        } else {
            value.to_be_bytes()
        }
    }
}

/// A sequence number from `least` on.
fn sequence_number(order: Order, bytes: &[u8], at: usize, least: i64) -> Option<i64> {
    let high = order.u32(bytes, at)? as i32;
    let number = (i64::from(high) << 32) + i64::from(order.u32(bytes, at + 4)?);
    (least..=MAX_SEQUENCE_NUMBER).contains(&number).then_some(number)
}

/// Where the bits of a set end that begins with their number.
fn number_set(order: Order, bytes: &[u8], at: usize) -> Option<usize> {
    let bits = order.u32(bytes, at)?;
    let end = at + 4 + 4 * bits.div_ceil(32) as usize;
    (bits <= 256 && end <= bytes.len()).then_some(end)
}

/// Where a string ends, with the bytes that fill it up to a multiple of four.
fn string(order: Order, bytes: &[u8], at: usize) -> Option<usize> {
    let length = order.u32(bytes, at)? as usize;
    let text = bytes.get(at + 4..)?.get(..length)?;
    let is_terminated = text.last().is_none_or(|last| *last == 0);
    is_terminated.then(|| bytes.len().min(at + 4 + length.next_multiple_of(4)))
}

/// Where a list ends whose elements are so many strings each.
fn strings(order: Order, bytes: &[u8], at: usize, each: usize) -> Option<usize> {
    let count = order.u32(bytes, at)? as usize * each;
    // Each has a length of four bytes.
    (count <= bytes.len() / 4).then_some(())?;
    (0..count).try_fold(at + 4, |at, _| string(order, bytes, at))
}
