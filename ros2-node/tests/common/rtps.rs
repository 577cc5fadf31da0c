//! Packets of RTPS, made by hand (RTPS 2.5, chapter 9.4).
#![allow(dead_code)]

/// With what the identifiers of a participant begin.
pub type Prefix = [u8; 12];

/// A part of a message, in little-endian order.
pub fn part(kind: u8, flags: u8, body: &[u8]) -> Vec<u8> {
    let mut part = vec![kind, flags | 1];
    part.extend(u16::try_from(body.len()).unwrap().to_le_bytes());
    part.extend(body);
    part
}

/// A whole packet.
pub fn message(sender: Prefix, parts: &[Vec<u8>]) -> Vec<u8> {
    let mut message = b"RTPS\x02\x04\x01\x10".to_vec();
    message.extend(sender);
    parts.iter().for_each(|part| message.extend(part));
    message
}

/// One parameter.
pub fn parameter(id: u16, value: &[u8]) -> Vec<u8> {
    let mut parameter = id.to_le_bytes().to_vec();
    parameter.extend(u16::try_from(value.len()).unwrap().to_le_bytes());
    parameter.extend(value);
    parameter
}

/// A message that is a list of parameters.
pub fn parameters(list: &[Vec<u8>]) -> Vec<u8> {
    let mut payload = vec![0, 3, 0, 0];
    list.iter().for_each(|parameter| payload.extend(parameter));
    payload.extend(parameter(1, &[]));
    payload
}

/// An address over UDP.
pub fn locator(to: &str, port: u32) -> Vec<u8> {
    [&1u32.to_le_bytes()[..], &port.to_le_bytes(), &[0; 12], &to.parse::<std::net::Ipv4Addr>().unwrap().octets()]
        .concat()
}

/// How long the sender stays without being heard, s.
pub fn lease(seconds: i32) -> Vec<u8> {
    parameter(0x0002, &[seconds.to_le_bytes(), [0; 4]].concat())
}

/// A string, filled up to a multiple of four bytes.
pub fn text(text: &str) -> Vec<u8> {
    let mut bytes = u32::try_from(text.len() + 1).unwrap().to_le_bytes().to_vec();
    bytes.extend(text.as_bytes());
    bytes.push(0);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// The number of a message of a writer.
pub fn sequence_number(number: i64) -> Vec<u8> {
    [((number >> 32) as i32).to_le_bytes(), (number as u32).to_le_bytes()].concat()
}

/// The message 1 of `writer`.
pub fn data(reader: [u8; 4], writer: [u8; 4], flags: u8, payload: &[u8]) -> Vec<u8> {
    part(0x15, flags, &[&[0, 0, 16, 0][..], &reader, &writer, &sequence_number(1), payload].concat())
}

/// The announcement of the participant `of`.
pub fn participant(of: Prefix, more: &[Vec<u8>]) -> Vec<u8> {
    let mut list = vec![parameter(0x0050, &[&of[..], &[0, 0, 1, 0xc1]].concat())];
    list.extend_from_slice(more);
    data([0; 4], [0, 1, 0, 0xc2], 4, &parameters(&list))
}

/// The announcement of a writer of `/a` as one of the participant `of`.
pub fn endpoint(of: Prefix, number: u32, more: &[Vec<u8>]) -> Vec<u8> {
    let [_, a, b, c] = number.to_be_bytes();
    let guid = [&of[..], &[a, b, c, 0x03]].concat();
    let mut list = vec![parameter(0x005a, &guid), parameter(0x0005, &text("rt/a")), parameter(0x0007, &text("T"))];
    list.extend_from_slice(more);
    data([0, 0, 3, 0xc7], [0, 0, 3, 0xc2], 4, &parameters(&list))
}
