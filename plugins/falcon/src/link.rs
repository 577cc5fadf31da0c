use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_device::caught;

use crate::packet::{Command, Led, Parser, Reply, END};
use crate::transport::{Bus, Port, TransportError, PACKET};

/// Each packet of the chip begins with its modem status.
const STATUS: usize = 2;

/// How long the chip may take to accept what it is sent.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);

/// Requests of the device's FTDI serial chip: `(request, value)`.
pub(crate) mod ftdi {
    pub type Request = (u8, u16);

    pub const PURGE_RECEIVED: Request = (0, 1);
    pub const PURGE_SENT: Request = (0, 2);
    pub const DTR_LOW: Request = (1, 0x0100);
    pub const DTR_HIGH: Request = (1, 0x0101);
    pub const RTS_LOW: Request = (1, 0x0200);
    pub const NO_FLOW_CONTROL: Request = (2, 0);
    /// Words against a clock of 3 MHz.
    pub const BAUD_9600: Request = (3, 0x4138);
    pub const BAUD_143K: Request = (3, 0x0015);
    pub const BAUD_1M5: Request = (3, 0x0002);
    /// 8 data bits, no parity, 1 stop bit.
    pub const LINE_8N1: Request = (4, 8);
    pub const EVENT_CHARACTER: u8 = 6;

    /// The chip sends what it has after so many ms.
    pub const fn latency(milliseconds: u16) -> Request {
        (9, milliseconds)
    }

    /// The chip sends what it has when it sees `character`.
    pub const fn event_character(character: u8) -> Request {
        (EVENT_CHARACTER, 0x0100 | character as u16)
    }
}

/// What came of waiting for a reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Answer {
    /// The newest reply.
    Reply(Reply),
    /// A packet came, but damaged: there will be no other before the next command.
    Damaged,
    /// Nothing came in time.
    Silence,
}

/// An open device. However it is closed, its motors are sent forces of zero first.
pub(crate) struct Link {
    bus: Arc<dyn Bus>,
    port: Box<dyn Port>,
    parser: Parser,
    /// Whether the motion program was heard: the loader takes no forces, and needs none.
    moves: bool,
}

impl Link {
    /// Opens a device and sets its chip up for the motion program.
    pub fn open(bus: &Arc<dyn Bus>, identity: &str, event_character: bool) -> Result<Self, TransportError> {
        let port = bus.open(identity)?;
        let mut link = Self { bus: Arc::clone(bus), port, parser: Parser::default(), moves: false };
        link.normal_mode(event_character)?;
        Ok(link)
    }

    /// Sets the chip up for the motion program, and forgets what was on the way.
    pub fn normal_mode(&mut self, event_character: bool) -> Result<(), TransportError> {
        self.purge()?;
        self.request(ftdi::latency(1))?;
        self.request(ftdi::BAUD_1M5)?;
        if event_character {
            // A chip that refuses is as fast as without.
            if let Err(TransportError::Gone) = self.request(ftdi::event_character(END)) {
                return Err(TransportError::Gone);
            }
        }
        self.purge()
    }

    /// A request of the chip.
    pub fn request(&mut self, (request, value): ftdi::Request) -> Result<(), TransportError> {
        self.port.control_out(request, value)
    }

    /// Forgets what was on the way, in both directions.
    pub fn purge(&mut self) -> Result<(), TransportError> {
        self.request(ftdi::PURGE_RECEIVED)?;
        self.request(ftdi::PURGE_SENT)?;
        // Requests that wait in the kernel may have been answered before. A packet without data is the first after
        // them.
        let mut packet = [0; PACKET];
        for _ in 0..8 {
            if self.port.bulk_in(&mut packet, Duration::from_millis(2))? <= STATUS {
                break;
            }
        }
        self.parser.clear();
        Ok(())
    }

    /// Sends bytes as they are.
    pub fn send(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), TransportError> {
        self.port.bulk_out(bytes, timeout)
    }

    /// Appends what comes until `deadline` to `bytes`, at least one byte if it comes in time.
    pub fn receive(&mut self, bytes: &mut Vec<u8>, deadline: Instant) -> Result<(), TransportError> {
        let before = bytes.len();
        let mut packet = [0; PACKET];
        while bytes.len() == before {
            let rest = deadline.saturating_duration_since(self.bus.now());
            if rest.is_zero() {
                break;
            }
            let length = self.port.bulk_in(&mut packet, rest)?;
            bytes.extend_from_slice(packet.get(STATUS..length).unwrap_or_default());
        }
        Ok(())
    }

    /// Sends a command to the motion program.
    pub fn command(&mut self, command: &Command) -> Result<(), TransportError> {
        self.port.bulk_out(&command.encode(), WRITE_TIMEOUT)
    }

    /// Waits for the reply until `deadline`; of several, the newest counts.
    pub fn answer(&mut self, deadline: Instant) -> Result<Answer, TransportError> {
        let damaged = self.parser.damaged();
        let mut packet = [0; PACKET];
        loop {
            let rest = deadline.saturating_duration_since(self.bus.now());
            if rest.is_zero() {
                return Ok(Answer::Silence);
            }
            let length = self.port.bulk_in(&mut packet, rest)?;
            let bytes = packet.get(STATUS..length).unwrap_or_default();
            if let Some(reply) = bytes.iter().filter_map(|byte| self.parser.push(*byte)).last() {
                self.moves = true;
                return Ok(Answer::Reply(reply));
            }
            if self.parser.damaged() > damaged {
                return Ok(Answer::Damaged);
            }
        }
    }

    /// Whether the motion program runs: up to 10 questions, of which one is answered.
    pub fn is_running(&mut self, stopped: &dyn Fn() -> bool) -> Result<bool, TransportError> {
        for _ in 0..10 {
            if stopped() {
                break;
            }
            match self.command(&Command::zero(Led::Red)) {
                // A loader needs not take it.
                Err(TransportError::TimedOut) => continue,
                other => other?,
            }
            let deadline = self.bus.now() + Duration::from_millis(50);
            loop {
                match self.answer(deadline)? {
                    Answer::Reply(_) => return Ok(true),
                    Answer::Damaged => {}
                    Answer::Silence => break,
                }
            }
        }
        Ok(false)
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        if self.moves {
            for _ in 0..3 {
                // A device that is gone takes nothing. The stack may be unwinding, so a panic must not get out.
                drop(caught(|| self.command(&Command::zero(Led::Off))));
            }
        }
    }
}
