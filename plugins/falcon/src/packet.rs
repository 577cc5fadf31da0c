//! What goes over the wire once the device's program runs: 16 bytes out, 16 bytes back, strictly one answer to one
//! question.
//!
//! A packet is `<`, 14 bytes of payload, `>`. Payload bytes are small numbers plus `A`, so neither bracket is ever
//! among them: whatever was lost, the next `<` begins a packet.

/// Length of a packet in both directions.
pub const LENGTH: usize = 16;
const BEGIN: u8 = b'<';
/// Ends a packet.
pub const END: u8 = b'>';
const ZERO: u8 = b'A';

/// Colours of the ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Led {
    /// Closed.
    Off,
    /// Not homed.
    Red,
    /// Homed, and nobody asks for forces.
    Blue,
    /// In use.
    Green,
}

impl Led {
    fn bits(self) -> u8 {
        match self {
            Self::Off => 0,
            Self::Green => 0x02,
            Self::Blue => 0x04,
            Self::Red => 0x08,
        }
    }
}

/// What is sent to the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Command {
    /// Motor values of the legs, within ±4096.
    pub motors: [i16; 3],
    /// Whether the device finds the marks of its encoders, and says which it has found.
    pub homing: bool,
    /// Colour of the ring.
    pub led: Led,
}

impl Command {
    /// No force, homing on.
    pub fn zero(led: Led) -> Self {
        Self { motors: [0; 3], homing: true, led }
    }

    /// The packet.
    pub fn encode(&self) -> [u8; LENGTH] {
        let mut packet = [ZERO; LENGTH];
        packet[0] = BEGIN;
        for (bytes, motor) in packet[1..13].chunks_exact_mut(4).zip(self.motors) {
            bytes.copy_from_slice(&nibbles(motor));
        }
        packet[13] += u8::from(self.homing) | self.led.bits();
        packet[15] = END;
        packet
    }
}

/// What the device says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reply {
    /// Encoders of the legs, counts.
    pub encoders: [i16; 3],
    /// Which encoders have passed their marks. All `false` while homing is off.
    pub homed: [bool; 3],
    /// Buttons of the grip: 1 right, 2 front, 4 centre, 8 left.
    pub grip: u8,
}

impl Reply {
    /// Buttons as the vendor's library numbers them, which device files are written for: 0 centre, 1 left, 2 front, 3
    /// right.
    pub fn buttons(&self) -> u32 {
        let bit = |mask: u8, place: u32| u32::from(self.grip & mask != 0) << place;
        bit(0x4, 0) | bit(0x8, 1) | bit(0x2, 2) | bit(0x1, 3)
    }

    /// Whether all encoders have passed their marks.
    pub fn is_homed(&self) -> bool {
        self.homed == [true; 3]
    }

    /// Reads a packet; `None` for what isn't one.
    pub fn decode(packet: &[u8; LENGTH]) -> Option<Self> {
        if packet[0] != BEGIN || packet[LENGTH - 1] != END {
            return None;
        }
        let mut encoders = [0; 3];
        for (encoder, bytes) in encoders.iter_mut().zip(packet[1..13].chunks_exact(4)) {
            *encoder = number(bytes)?;
        }
        let status = packet[13].checked_sub(ZERO)?;
        packet[14].checked_sub(ZERO)?;
        let homed = [0x10, 0x20, 0x40].map(|bit| status & bit != 0);
        Some(Self { encoders, homed, grip: status & 0xF })
    }
}

/// Four nibbles of a number in two's complement, the lowest first.
fn nibbles(number: i16) -> [u8; 4] {
    [0, 4, 8, 12].map(|shift| ZERO + ((number as u16 >> shift) & 0xF) as u8)
}

fn number(bytes: &[u8]) -> Option<i16> {
    let number = bytes.iter().rev().try_fold(0_u16, |number, byte| {
        let nibble = byte.checked_sub(ZERO).filter(|nibble| *nibble < 16)?;
        Some(number << 4 | u16::from(nibble))
    });
    number.map(|number| number as i16)
}

/// Finds replies in a stream of bytes, and its way back after bytes were lost or damaged.
#[derive(Debug, Clone, Default)]
pub struct Parser {
    packet: [u8; LENGTH],
    filled: usize,
    damaged: u64,
}

impl Parser {
    /// Forgets what it has of an unfinished packet.
    pub fn clear(&mut self) {
        self.filled = 0;
    }

    /// Packets that were damaged so far, and bytes outside of packets.
    pub fn damaged(&self) -> u64 {
        self.damaged
    }

    /// Takes a byte; gives the reply that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Reply> {
        if byte == BEGIN {
            self.damaged += u64::from(self.filled > 0);
            self.packet[0] = byte;
            self.filled = 1;
            return None;
        }
        if self.filled == 0 {
            self.damaged += 1;
            return None;
        }
        self.packet[self.filled] = byte;
        self.filled += 1;
        if byte != END && self.filled < LENGTH {
            return None;
        }
        let reply = (self.filled == LENGTH).then(|| Reply::decode(&self.packet)).flatten();
        self.filled = 0;
        self.damaged += u64::from(reply.is_none());
        reply
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reply_packet(encoders: [i16; 3], status: u8) -> Vec<u8> {
        let mut packet = vec![BEGIN];
        packet.extend(encoders.iter().flat_map(|encoder| nibbles(*encoder)));
        packet.extend([ZERO + status, ZERO, END]);
        packet
    }

    fn replies(parser: &mut Parser, bytes: &[u8]) -> Vec<[i16; 3]> {
        bytes.iter().filter_map(|byte| parser.push(*byte)).map(|reply| reply.encoders).collect()
    }

    #[test]
    fn the_neutral_packet_is_known() {
        let neutral = Command { motors: [0; 3], homing: false, led: Led::Off };
        assert_eq!(&neutral.encode(), b"<AAAAAAAAAAAAAA>");
        assert_eq!(&Command::zero(Led::Red).encode(), b"<AAAAAAAAAAAAJA>");
        assert_eq!(&Command::zero(Led::Green).encode(), b"<AAAAAAAAAAAADA>");
        assert_eq!(&Command::zero(Led::Blue).encode(), b"<AAAAAAAAAAAAFA>");
    }

    #[test]
    fn the_lowest_nibble_comes_first() {
        assert_eq!(nibbles(-1447), [0x4A, 0x46, 0x4B, 0x50]);
        let command = Command { motors: [1, -1447, 0x1234], homing: false, led: Led::Off };
        assert_eq!(&command.encode(), b"<BAAAJFKPEDCBAA>");
    }

    #[test]
    fn numbers_survive() {
        for value in [0, 1, -1, 4096, -4096, i16::MAX, i16::MIN, -1447] {
            assert_eq!(number(&nibbles(value)), Some(value));
            let packet = reply_packet([value, 0, -1], 0);
            assert_eq!(replies(&mut Parser::default(), &packet), [[value, 0, -1]]);
        }
        assert_eq!(number(b"AAAQ"), None, "16 is no nibble");
        assert_eq!(number(b"@AAA"), None);
    }

    #[test]
    fn status_bits_have_their_meaning() {
        let decode = |status| Reply::decode(&reply_packet([0; 3], status).try_into().unwrap()).unwrap();
        assert_eq!(decode(0x10).homed, [true, false, false]);
        assert_eq!(decode(0x60).homed, [false, true, true]);
        assert!(decode(0x70).is_homed() && !decode(0x5F).is_homed());
        assert_eq!([0x4, 0x8, 0x2, 0x1].map(|grip| decode(grip).buttons()), [1, 2, 4, 8]);
        assert_eq!(decode(0x7F).buttons(), 0xF);
        assert_eq!(decode(0x70).buttons(), 0);
    }

    #[test]
    fn split_and_merged_packets_are_found() {
        let bytes = [reply_packet([1, 2, 3], 0), reply_packet([4, 5, 6], 0)].concat();
        assert_eq!(replies(&mut Parser::default(), &bytes), [[1, 2, 3], [4, 5, 6]]);
        let mut parser = Parser::default();
        assert_eq!(replies(&mut parser, &bytes[..7]), [[0; 3]; 0]);
        assert_eq!(replies(&mut parser, &bytes[7..]), [[1, 2, 3], [4, 5, 6]]);
        assert_eq!(parser.damaged(), 0);
    }

    #[test]
    fn whatever_byte_is_lost_or_damaged_the_next_packet_is_found() {
        let (first, second) = (reply_packet([100, -200, 300], 0x70), reply_packet([7, 8, 9], 0x70));
        for place in 0..LENGTH {
            let mut lost = [first.clone(), second.clone()].concat();
            lost.remove(place);
            let mut parser = Parser::default();
            assert_eq!(replies(&mut parser, &lost), [[7, 8, 9]], "byte {place} lost");
            assert!(parser.damaged() > 0);
            for byte in [0, BEGIN, END, 0xFF, 0x40] {
                let mut damaged = [first.clone(), second.clone()].concat();
                if damaged[place] == byte || (byte == 0xFF && (13..15).contains(&place)) {
                    continue;
                }
                damaged[place] = byte;
                assert_eq!(replies(&mut Parser::default(), &damaged), [[7, 8, 9]], "byte {place} became {byte:#x}");
            }
        }
    }

    #[test]
    fn endless_noise_is_no_packet() {
        let mut parser = Parser::default();
        let mut seed = 1_u32;
        for _ in 0..100_000 {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let byte = (seed >> 24) as u8;
            // Noise without an end never makes a packet, and never overflows.
            assert_eq!(parser.push(if byte == END { 0 } else { byte }), None);
        }
        assert_eq!(replies(&mut parser, &reply_packet([1, 2, 3], 0)), [[1, 2, 3]]);
    }
}
