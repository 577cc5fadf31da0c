//! Novint Falcons in software, down to the USB packets: what the driver is tested with, and what a newcomer holds who
//! has none (`driver settings: {transport: fake}`, which [`driver`] understands).
//!
//! Behind the [`Port`] are the serial chip with its latency timer, the loader that wants the firmware, the motion
//! program with its encoders, marks and motors, and a [`Hand`] that the motors push. Faults can be put between them.

mod board;
mod chip;
mod clock;
mod hand;

use std::sync::Arc;
use std::time::{Duration, Instant};

use falcon::{Bus, FalconDriver, Port, TransportError, PACKET};
use nalgebra::Vector3;
use parking_lot::{Mutex, MutexGuard};

pub use board::Received;
pub use clock::Clock;
pub use hand::{Aim, Hand, Script, Softness};

use board::Board;
use chip::Chip;

/// What goes wrong. Those about answers hit the motion program's replies and the loader's echoes alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// An answer comes in two USB packets.
    Split,
    /// An answer is held back until the next one.
    Merge,
    /// A byte of an answer is lost.
    LoseByte(usize),
    /// A byte of an answer is another.
    ChangeByte(usize, u8),
    /// No answer.
    Silence,
    /// An answer is late.
    Slow(Duration),
    /// A byte of what is sent is lost.
    LoseSentByte(usize),
    /// A byte of what is sent is another.
    ChangeSentByte(usize, u8),
    /// What is sent is not taken.
    Refuse,
    /// What is sent fails.
    Fail,
    /// The device is unplugged while something is sent.
    Unplug,
    /// The transport panics.
    Panic,
}

impl Fault {
    fn is_about_sending(self) -> bool {
        use Fault::{ChangeSentByte, Fail, LoseSentByte, Panic, Refuse, Unplug};
        matches!(self, LoseSentByte(_) | ChangeSentByte(..) | Refuse | Fail | Unplug | Panic)
    }
}

/// How a fake Falcon is at first.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Identity on its bus.
    pub identity: String,
    /// Whether the motion program runs already.
    pub firmware_runs: bool,
    /// Whether the loader's answer begins with a zero byte.
    pub leading_zero: bool,
    /// Whether the chip knows event characters.
    pub event_character: bool,
    /// By how much encoders are off before homing, counts.
    pub offsets: [i16; 3],
    /// Who holds it. Its script begins when the device is first opened.
    pub hand: Hand,
}

impl Setup {
    /// A device whose program runs, held by [`Hand::circling`].
    pub fn new(identity: &str) -> Self {
        Self {
            identity: identity.to_owned(),
            firmware_runs: true,
            leading_zero: false,
            event_character: true,
            offsets: [700, -300, 1200],
            hand: Hand::circling(),
        }
    }
}

struct Device {
    chip: Chip,
    board: Board,
    plugged: bool,
    open: bool,
    begun: bool,
    attempts: u64,
    /// Counts how often it was plugged in: ports of before are dead.
    generation: u64,
    faults: Vec<(Fault, u64)>,
    held_back: Vec<u8>,
    /// When the lines to and from the board are free.
    free: [Instant; 2],
}

impl Device {
    fn take(&mut self, sending: bool) -> Option<Fault> {
        let place = self.faults.iter().position(|(fault, _)| fault.is_about_sending() == sending)?;
        let fault = self.faults[place].0;
        self.faults[place].1 -= 1;
        if self.faults[place].1 == 0 {
            self.faults.remove(place);
        }
        Some(fault)
    }

    fn send(&mut self, bytes: &[u8], now: Instant) {
        // At a rate that the board doesn't know it hears nothing.
        let Some(byte_time) = self.chip.byte_time() else { return };
        let mut time = now.max(self.free[0]);
        let mut answer = Vec::new();
        for byte in bytes {
            time += byte_time;
            answer.extend(self.board.receive(*byte, self.chip.baud, time));
        }
        self.free[0] = time;
        if !answer.is_empty() {
            self.answer(answer, time, byte_time);
        }
    }

    fn answer(&mut self, mut bytes: Vec<u8>, now: Instant, byte_time: Duration) {
        let mut split = usize::MAX;
        let mut time = now.max(self.free[1]);
        match self.take(false) {
            Some(Fault::Split) => split = bytes.len() / 2,
            Some(Fault::Merge) => {
                self.held_back.append(&mut bytes);
                return;
            }
            Some(Fault::LoseByte(place)) if place < bytes.len() => {
                bytes.remove(place);
            }
            Some(Fault::ChangeByte(place, byte)) if place < bytes.len() => bytes[place] = byte,
            Some(Fault::Silence) => return,
            Some(Fault::Slow(delay)) => time += delay,
            _ => {}
        }
        bytes.splice(0..0, std::mem::take(&mut self.held_back));
        for (n, byte) in bytes.into_iter().enumerate() {
            if n == split {
                // Longer than the chip waits for more.
                time += Duration::from_millis(2);
            }
            time += byte_time;
            self.chip.receive(time, byte);
        }
        self.free[1] = time;
    }
}

/// Handle of a fake Falcon: what its maker, its user and those who stumble over its cable can do.
#[derive(Clone)]
pub struct FakeFalcon {
    identity: String,
    clock: Clock,
    device: Arc<Mutex<Device>>,
}

impl FakeFalcon {
    fn new(setup: Setup, clock: Clock) -> Self {
        let now = clock.now();
        let device = Device {
            chip: Chip::new(now, setup.event_character),
            board: Board::new(setup.hand, setup.firmware_runs, setup.leading_zero, setup.offsets),
            plugged: true,
            open: false,
            begun: false,
            attempts: 0,
            generation: 0,
            faults: Vec::new(),
            held_back: Vec::new(),
            free: [now; 2],
        };
        Self { identity: setup.identity, clock, device: Arc::new(Mutex::new(device)) }
    }

    /// Pulls the plug of the USB cable; the device keeps its power, and forgets nothing.
    pub fn unplug(&self) {
        self.device.lock().plugged = false;
    }

    /// Plugs it in again.
    pub fn plug(&self) {
        let mut device = self.device.lock();
        device.plugged = true;
        device.generation += 1;
        device.open = false;
    }

    /// Switches it off and on: the loader waits for the firmware.
    pub fn power_cycle(&self) {
        let now = self.clock.now();
        let mut device = self.device.lock();
        device.board.reset();
        device.chip.reset(now);
        drop(device);
        self.plug();
    }

    /// Lets a fault happen the next `count` times that it can; faults about the same happen one after the other.
    pub fn inject(&self, fault: Fault, count: u64) {
        if count > 0 {
            self.device.lock().faults.push((fault, count));
        }
    }

    /// Whether a program has it.
    pub fn is_open(&self) -> bool {
        self.device.lock().open
    }

    /// Whether the motion program runs.
    pub fn is_running(&self) -> bool {
        self.device.lock().board.is_running()
    }

    /// Firmware that the loader was given last, as far as it came.
    pub fn image(&self) -> Vec<u8> {
        self.device.lock().board.image.clone()
    }

    /// How often somebody tried to open it.
    pub fn attempts(&self) -> u64 {
        self.device.lock().attempts
    }

    /// Commands that the motion program has got, in all.
    pub fn count(&self) -> u64 {
        self.device.lock().board.count
    }

    /// The last 10 000 of them, the newest last.
    pub fn commands(&self) -> Vec<Received> {
        self.device.lock().board.commands.iter().copied().collect()
    }

    /// Motor values in force.
    pub fn motors(&self) -> [i16; 3] {
        self.device.lock().board.motors()
    }

    /// The last 10 000 requests of the chip: `(request, value)`.
    pub fn requests(&self) -> Vec<(u8, u16)> {
        self.device.lock().chip.requests.iter().copied().collect()
    }

    /// Where the grip is, m, and how fast it moves, m/s, in the device frame, when the last command came.
    pub fn grip(&self) -> (Vector3<f64>, Vector3<f64>) {
        let device = self.device.lock();
        (device.board.hand.position(), device.board.hand.velocity())
    }
}

/// A bus with fake Falcons.
#[derive(Clone)]
pub struct FakeBus {
    clock: Clock,
    falcons: Vec<FakeFalcon>,
}

impl FakeBus {
    /// A bus with these devices.
    pub fn new(clock: Clock, setups: impl IntoIterator<Item = Setup>) -> Self {
        let falcons = setups.into_iter().map(|setup| FakeFalcon::new(setup, clock.clone())).collect();
        Self { clock, falcons }
    }

    /// The devices, in the order of the setups.
    pub fn falcons(&self) -> &[FakeFalcon] {
        &self.falcons
    }

    /// Its clock.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }
}

impl Bus for FakeBus {
    fn list(&self) -> Result<Vec<String>, TransportError> {
        let plugged = self.falcons.iter().filter(|falcon| falcon.device.lock().plugged);
        let mut identities: Vec<String> = plugged.map(|falcon| falcon.identity.clone()).collect();
        identities.sort();
        Ok(identities)
    }

    fn open(&self, identity: &str) -> Result<Box<dyn Port>, TransportError> {
        let falcon = self.falcons.iter().find(|falcon| falcon.identity == identity).ok_or(TransportError::Gone)?;
        let now = self.clock.now();
        let mut device = falcon.device.lock();
        device.attempts += 1;
        if !device.plugged {
            return Err(TransportError::Gone);
        }
        if device.open {
            return Err(TransportError::Busy);
        }
        device.open = true;
        if !std::mem::replace(&mut device.begun, true) {
            device.board.hand.begin(now);
        }
        Ok(Box::new(FakePort { generation: device.generation, falcon: falcon.clone() }))
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    fn wait(&self, duration: Duration) {
        self.clock.park(duration);
    }
}

/// The driver of Falcons on USB, and of the fakes `fake-1` and `fake-2` where settings ask for `transport: fake`.
pub fn driver() -> FalconDriver {
    let fakes = FakeBus::new(Clock::real(), [Setup::new("fake-1"), Setup::new("fake-2")]);
    falcon::driver().with_bus("fake", Arc::new(fakes))
}

struct FakePort {
    falcon: FakeFalcon,
    generation: u64,
}

impl FakePort {
    fn device(&self) -> Result<MutexGuard<'_, Device>, TransportError> {
        let device = self.falcon.device.lock();
        if device.plugged && device.generation == self.generation {
            Ok(device)
        } else {
            Err(TransportError::Gone)
        }
    }
}

impl Port for FakePort {
    fn control_out(&mut self, request: u8, value: u16) -> Result<(), TransportError> {
        let now = self.falcon.clock.now();
        let mut device = self.device()?;
        let line = device.chip.control(request, value, now);
        let line = line.ok_or_else(|| TransportError::Other(String::from("endpoint stalled")))?;
        device.board.line(line);
        Ok(())
    }

    fn bulk_out(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), TransportError> {
        let now = self.falcon.clock.now();
        let mut device = self.device()?;
        let mut bytes = bytes.to_vec();
        match device.take(true) {
            Some(Fault::LoseSentByte(place)) if place < bytes.len() => {
                bytes.remove(place);
            }
            Some(Fault::ChangeSentByte(place, byte)) if place < bytes.len() => bytes[place] = byte,
            Some(Fault::Refuse) => {
                drop(device);
                self.falcon.clock.wait_until(now + timeout);
                return Err(TransportError::TimedOut);
            }
            Some(Fault::Fail) => return Err(TransportError::Other(String::from("protocol violation"))),
            Some(Fault::Unplug) => {
                device.plugged = false;
                return Err(TransportError::Gone);
            }
            Some(Fault::Panic) => panic!("a fault that was asked for"),
            _ => {}
        }
        device.send(&bytes, now);
        Ok(())
    }

    fn bulk_in(&mut self, packet: &mut [u8; PACKET], timeout: Duration) -> Result<usize, TransportError> {
        let clock = self.falcon.clock.clone();
        let deadline = clock.now() + timeout;
        loop {
            let now = clock.now();
            let next = match self.device()?.chip.packet(now, packet) {
                Ok(length) => return Ok(length),
                Err(_) if now >= deadline => return Ok(0),
                Err(next) => next,
            };
            clock.wait_until(next.min(deadline));
        }
    }
}

impl Drop for FakePort {
    fn drop(&mut self) {
        let mut device = self.falcon.device.lock();
        if device.generation == self.generation {
            device.open = false;
        }
    }
}
