use std::collections::VecDeque;
use std::time::{Duration, Instant};

use falcon::PACKET;

/// Modem status at the head of each packet.
const STATUS: [u8; 2] = [0x01, 0x60];
const DATA: usize = PACKET - STATUS.len();
/// Requests remembered.
const REQUESTS: usize = 10_000;

/// What a request means for the board behind the chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Line {
    Dtr(bool),
    Baud(u16),
    Other,
}

/// The serial chip: an FT232 as far as the device uses it.
#[derive(Debug)]
pub(crate) struct Chip {
    latency: Duration,
    /// Divisor word.
    pub baud: u16,
    event: Option<u8>,
    has_event_character: bool,
    /// Bytes from the board and when they are there.
    received: VecDeque<(Instant, u8)>,
    /// When the latency timer runs out.
    timer: Instant,
    pub requests: VecDeque<(u8, u16)>,
}

impl Chip {
    pub fn new(now: Instant, has_event_character: bool) -> Self {
        let latency = Duration::from_millis(16);
        let (received, requests) = (VecDeque::new(), VecDeque::new());
        Self { latency, baud: 0x4138, event: None, has_event_character, received, timer: now + latency, requests }
    }

    /// After power was away.
    pub fn reset(&mut self, now: Instant) {
        *self = Self { requests: std::mem::take(&mut self.requests), ..Self::new(now, self.has_event_character) };
    }

    /// A control request; `None` if the chip refuses it.
    pub fn control(&mut self, request: u8, value: u16, now: Instant) -> Option<Line> {
        if self.requests.len() == REQUESTS {
            self.requests.pop_front();
        }
        self.requests.push_back((request, value));
        match (request, value) {
            (0, 0 | 1) => self.received.clear(),
            (0, 2) | (2, 0) | (4, 8) => {}
            (1, _) if value & 0x0100 != 0 => return Some(Line::Dtr(value & 1 != 0)),
            (1, _) => {}
            (3, _) => {
                self.baud = value;
                return Some(Line::Baud(value));
            }
            (6, _) if self.has_event_character => self.event = (value & 0x0100 != 0).then_some(value as u8),
            (9, 1..=255) => {
                self.latency = Duration::from_millis(u64::from(value));
                self.timer = now + self.latency;
            }
            _ => return None,
        }
        Some(Line::Other)
    }

    /// How long a byte takes on the line between chip and board; `None` at a rate that the board doesn't know.
    pub fn byte_time(&self) -> Option<Duration> {
        let rate = match self.baud {
            0x4138 => 9_600.0,
            0x0015 => 3e6 / 21.0,
            0x0002 => 1.5e6,
            _ => return None,
        };
        Some(Duration::from_secs_f64(10.0 / rate))
    }

    /// A byte of the board that is there at `time`.
    pub fn receive(&mut self, time: Instant, byte: u8) {
        self.received.push_back((time, byte));
    }

    /// The packet that is sent at `now`, or when to ask again.
    pub fn packet(&mut self, now: Instant, packet: &mut [u8; PACKET]) -> Result<usize, Instant> {
        let at_once =
            self.received.iter().enumerate().find(|(n, (_, byte))| *n + 1 == DATA || Some(*byte) == self.event);
        let length = match at_once.map(|(n, (time, _))| (n + 1, *time)) {
            Some((length, time)) if time <= now => {
                self.timer = now + self.latency;
                length
            }
            _ if self.timer <= now => {
                // The timer runs on while nobody asks, as requests wait in the host's controller.
                let late = now.duration_since(self.timer).as_nanos();
                let periods = late / self.latency.as_nanos() + 1;
                self.timer += self.latency * u32::try_from(periods).unwrap_or(u32::MAX);
                self.received.iter().take(DATA).take_while(|(time, _)| *time <= now).count()
            }
            Some((_, time)) => return Err(time.min(self.timer)),
            None => return Err(self.timer),
        };
        packet[..STATUS.len()].copy_from_slice(&STATUS);
        for (place, (_, byte)) in packet[STATUS.len()..].iter_mut().zip(self.received.drain(..length)) {
            *place = byte;
        }
        Ok(STATUS.len() + length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn chip() -> (Chip, Instant) {
        let now = Instant::now();
        let mut chip = Chip::new(now, true);
        assert_eq!(chip.control(9, 1, now), Some(Line::Other));
        (chip, now)
    }

    #[test]
    fn packets_come_when_the_timer_runs_out() {
        let (mut chip, now) = chip();
        let mut packet = [0; PACKET];
        chip.receive(now + MS / 10, 7);
        assert_eq!(chip.packet(now + MS / 2, &mut packet), Err(now + MS));
        assert_eq!(chip.packet(now + MS, &mut packet), Ok(3));
        assert_eq!(packet[..3], [0x01, 0x60, 7]);
        assert_eq!(chip.packet(now + MS * 2, &mut packet), Ok(2), "without data only the status");
    }

    #[test]
    fn full_packets_and_event_characters_do_not_wait() {
        let (mut chip, now) = chip();
        let mut packet = [0; PACKET];
        (0..70).for_each(|_| chip.receive(now, 7));
        assert_eq!(chip.packet(now, &mut packet), Ok(64));
        assert_eq!(packet[63], 7);
        chip.control(6, 0x013E, now);
        chip.receive(now + MS / 4, b'>');
        assert_eq!(chip.packet(now, &mut packet), Err(now + MS / 4));
        assert_eq!(chip.packet(now + MS / 4, &mut packet), Ok(11));
    }

    #[test]
    fn requests_have_their_meaning() {
        let (mut chip, now) = chip();
        let mut packet = [0; PACKET];
        assert_eq!(chip.control(1, 0x0101, now), Some(Line::Dtr(true)));
        assert_eq!(chip.control(1, 0x0100, now), Some(Line::Dtr(false)));
        assert_eq!(chip.control(3, 0x0002, now), Some(Line::Baud(2)));
        assert_eq!(chip.byte_time(), Some(Duration::from_nanos(6667)));
        assert_eq!(chip.control(77, 0, now), None);
        chip.receive(now, 7);
        chip.control(0, 1, now);
        assert_eq!(chip.packet(now + MS, &mut packet), Ok(2), "purged");
        assert_eq!(chip.requests, [(9, 1), (1, 0x0101), (1, 0x0100), (3, 2), (77, 0), (0, 1)]);
    }
}
