use std::collections::VecDeque;
use std::time::Instant;

use super::chip::Line;
use super::Hand;

const BAUD_LOADER: u16 = 0x4138;
const BAUD_LOADING: u16 = 0x0015;
const BAUD_MOTION: u16 = 0x0002;
/// Less can't be the motion program.
const MIN_IMAGE: usize = 7000;
/// Commands remembered.
const COMMANDS: usize = 10_000;

/// A command as the board got it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received {
    /// When.
    pub time: Instant,
    /// Motor values.
    pub motors: [i16; 3],
    /// Bits of the control byte: 1 homing, 2 green, 4 blue, 8 red.
    pub control: u8,
}

#[derive(Debug, Default)]
struct Loader {
    dtr: bool,
    /// DTR went low and high.
    woken: bool,
    awake: bool,
    loading: bool,
    recent: Vec<u8>,
}

/// The program that moves.
#[derive(Debug, Default)]
struct MotionProgram {
    frame: Vec<u8>,
    homed: [bool; 3],
    last: Option<[i16; 3]>,
    motors: [i16; 3],
}

#[derive(Debug)]
enum Program {
    Loader(Loader),
    Motion(MotionProgram),
}

/// The device's own processor.
#[derive(Debug)]
pub(crate) struct Board {
    program: Program,
    leading_zero: bool,
    /// Encoders before homing are off by these, counts.
    offsets: [i16; 3],
    /// Encoders at the marks, counts.
    marks: [i16; 3],
    /// What the loader was given last.
    pub image: Vec<u8>,
    pub hand: Hand,
    pub commands: VecDeque<Received>,
    /// Commands in all.
    pub count: u64,
}

impl Board {
    pub fn new(hand: Hand, firmware_runs: bool, leading_zero: bool, offsets: [i16; 3]) -> Self {
        let program =
            if firmware_runs { Program::Motion(MotionProgram::default()) } else { Program::Loader(Loader::default()) };
        let marks = [-150, -130, -170];
        Self { program, leading_zero, offsets, marks, image: Vec::new(), hand, commands: VecDeque::new(), count: 0 }
    }

    /// After power was away.
    pub fn reset(&mut self) {
        self.program = Program::Loader(Loader::default());
    }

    pub fn is_running(&self) -> bool {
        matches!(self.program, Program::Motion(_))
    }

    /// Motor values in force.
    pub fn motors(&self) -> [i16; 3] {
        match &self.program {
            Program::Loader(_) => [0; 3],
            Program::Motion(motion) => motion.motors,
        }
    }

    /// A line of the chip changes.
    pub fn line(&mut self, line: Line) {
        let Program::Loader(loader) = &mut self.program else { return };
        match line {
            Line::Dtr(high) => {
                loader.woken |= high && !loader.dtr;
                loader.dtr = high;
            }
            Line::Baud(BAUD_MOTION) if loader.loading && self.image.len() >= MIN_IMAGE => {
                self.program = Program::Motion(MotionProgram::default());
            }
            Line::Baud(BAUD_MOTION) => *loader = Loader { dtr: loader.dtr, ..Loader::default() },
            _ => {}
        }
    }

    /// A byte comes at a rate of the line; what the board says to it.
    pub fn receive(&mut self, byte: u8, baud: u16, now: Instant) -> Vec<u8> {
        match &mut self.program {
            Program::Loader(loader) => loader.receive(byte, baud, self.leading_zero, &mut self.image),
            Program::Motion(_) if baud != BAUD_MOTION => Vec::new(),
            Program::Motion(motion) => {
                let Some((motors, control)) = motion.receive(byte) else { return Vec::new() };
                // The old values push until now.
                self.hand.advance(now, motion.motors);
                motion.motors = motors;
                self.count += 1;
                if self.commands.len() == COMMANDS {
                    self.commands.pop_front();
                }
                self.commands.push_back(Received { time: now, motors, control });
                let counts = self.hand.counts().or(motion.last).unwrap_or_default();
                motion.pass(counts, self.marks, control & 1 != 0);
                reply(counts, motion.homed, self.offsets, control & 1 != 0, self.hand.aim().grip)
            }
        }
    }
}

impl Loader {
    fn receive(&mut self, byte: u8, baud: u16, leading_zero: bool, image: &mut Vec<u8>) -> Vec<u8> {
        match baud {
            BAUD_LOADER if self.woken && self.dtr => {
                self.recent.push(byte);
                if !self.recent.ends_with(b"\x0AC\x0D") {
                    return Vec::new();
                }
                self.recent.clear();
                self.awake = true;
                let answer = b"\0\x0AD,\x0D";
                answer[usize::from(!leading_zero)..].to_vec()
            }
            BAUD_LOADING if self.loading => {
                image.push(byte);
                vec![byte]
            }
            BAUD_LOADING if self.awake && !self.dtr && byte == b'A' => {
                self.loading = true;
                image.clear();
                vec![byte]
            }
            _ => Vec::new(),
        }
    }
}

impl MotionProgram {
    /// Motor values and control bits when the byte completes a command.
    fn receive(&mut self, byte: u8) -> Option<([i16; 3], u8)> {
        if byte == b'<' {
            self.frame.clear();
        }
        if self.frame.len() < 16 {
            self.frame.push(byte);
        }
        if byte != b'>' {
            return None;
        }
        let frame = std::mem::take(&mut self.frame);
        if frame.len() != 16 || frame[0] != b'<' || frame[1..15].iter().any(|byte| !(b'A'..=b'P').contains(byte)) {
            return None;
        }
        let motor = |leg: usize| {
            let digit = |place: usize| i32::from(frame[1 + 4 * leg + place] - b'A') * 16_i32.pow(place as u32);
            let number = digit(0) + digit(1) + digit(2) + digit(3);
            (if number < 0x8000 { number } else { number - 0x1_0000 }) as i16
        };
        Some(([motor(0), motor(1), motor(2)], frame[13] - b'A'))
    }

    /// Encoders that have passed their marks since the last time.
    fn pass(&mut self, counts: [i16; 3], marks: [i16; 3], homing: bool) {
        if let Some(last) = self.last.filter(|_| homing) {
            for leg in 0..3 {
                self.homed[leg] |= (last[leg] < marks[leg]) != (counts[leg] < marks[leg]);
            }
        }
        self.last = Some(counts);
    }
}

fn reply(counts: [i16; 3], homed: [bool; 3], offsets: [i16; 3], homing: bool, grip: u8) -> Vec<u8> {
    let mut packet = vec![b'<'];
    for leg in 0..3 {
        let shown = if homed[leg] { counts[leg] } else { counts[leg].wrapping_sub(offsets[leg]) };
        let hexadecimal = format!("{shown:04x}");
        packet.extend(hexadecimal.bytes().rev().map(|digit| match digit {
            b'0'..=b'9' => digit - b'0' + b'A',
            _ => digit - b'a' + 10 + b'A',
        }));
    }
    let marks: u8 = (0..3).map(|leg| u8::from(homing && homed[leg]) << (4 + leg)).sum();
    packet.extend([b'A' + (grip & 0xF) + marks, b'A', b'>']);
    packet
}
