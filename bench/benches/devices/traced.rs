//! A driver around a driver: it writes down what passes, and can let things go wrong.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use ambf_core::device::{
    DeviceError, DeviceForce, DeviceInfo, DeviceLog, DeviceSample, DeviceSpec, Driver, InputDevice, Settings,
};
use nalgebra::Vector3;
use parking_lot::Mutex;

/// Start-up hold of every device here, s: with the usual 3 s there would be nothing to see for long.
const HOLD: f64 = 0.3;
/// Button of the clutch, as `a1` of entries: that of arms.
pub const CLUTCH: u32 = 1;
/// Ticks that a log has room for without allocating: two minutes.
const ROOM: usize = 120_000;

/// One tick of a device's loop.
#[derive(Debug, Clone, Copy)]
pub struct Tick {
    /// When its read began, and when that had returned.
    pub begin: Instant,
    pub read: Instant,
    pub sequence: u64,
    pub position: Vector3<f64>,
    pub is_clutched: bool,
    pub is_valid: bool,
}

/// What is to go wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// A read takes so long.
    Block(Duration),
    /// A read panics, once.
    Panic,
    /// Positions are no numbers, for so long.
    NotANumber(Duration),
    /// The device is away for so long.
    Disappear(Duration),
}

/// What the user of a [`Traced`] driver holds.
#[derive(Debug, Default, Clone)]
pub struct Trace(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    ticks: Mutex<Vec<Tick>>,
    fault: Mutex<Option<(Fault, Instant)>>,
    /// When the last valid sample was read, ns after [`epoch`].
    valid: AtomicU64,
    /// Whether the clutch was pressed then.
    clutched: AtomicBool,
}

/// A moment before all others.
fn epoch() -> Instant {
    static EPOCH: OnceLock<Instant> = OnceLock::new();
    *EPOCH.get_or_init(Instant::now)
}

impl Trace {
    /// All ticks until now. Not while they are measured: the device waits for the copy.
    pub fn ticks(&self) -> Vec<Tick> {
        self.0.ticks.lock().clone()
    }

    /// Whether a valid sample came after `time`.
    pub fn is_valid_since(&self, time: Instant) -> bool {
        epoch() + Duration::from_nanos(self.0.valid.load(Ordering::Acquire)) > time
    }

    /// Whether the clutch was pressed in the newest valid sample.
    pub fn is_clutched(&self) -> bool {
        self.0.clutched.load(Ordering::Acquire)
    }

    /// Lets something go wrong from now on; says when that was.
    pub fn inject(&self, fault: Fault) -> Instant {
        let now = Instant::now();
        *self.0.fault.lock() = Some((fault, now));
        now
    }
}

/// The driver.
pub struct Traced {
    name: String,
    inner: Arc<dyn Driver>,
    trace: Trace,
}

impl Traced {
    /// `name`: as `driver` in entries.
    pub fn new(name: &str, inner: Arc<dyn Driver>) -> (Self, Trace) {
        epoch();
        let trace = Trace::default();
        trace.0.ticks.lock().reserve(ROOM);
        (Self { name: name.into(), inner, trace: trace.clone() }, trace)
    }
}

impl Driver for Traced {
    fn name(&self) -> &str {
        &self.name
    }

    fn serves(&self, model: &str) -> bool {
        self.inner.serves(model)
    }

    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        self.inner.find(model, settings)
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        self.trace.0.is_there()?;
        let inner = self.inner.open(info, settings, log)?;
        let spec = DeviceSpec { start_up_hold: HOLD, ..inner.spec().clone() };
        Ok(Box::new(TracedDevice { inner, spec, trace: self.trace.clone(), last: None }))
    }
}

impl Inner {
    fn is_there(&self) -> Result<(), DeviceError> {
        match *self.fault.lock() {
            Some((Fault::Disappear(time), since)) if since.elapsed() < time => {
                Err(DeviceError::Lost("the device went away, as the benchmark wanted".into()))
            }
            _ => Ok(()),
        }
    }

    /// What goes wrong now, in this read. What happens once is over with that.
    fn take(&self) -> Option<Fault> {
        let mut fault = self.fault.lock();
        match *fault {
            Some((Fault::NotANumber(time) | Fault::Disappear(time), since)) if since.elapsed() < time => {
                fault.map(|(fault, _)| fault)
            }
            _ => fault.take().map(|(fault, _)| fault).filter(|fault| matches!(fault, Fault::Block(_) | Fault::Panic)),
        }
    }
}

struct TracedDevice {
    inner: Box<dyn InputDevice>,
    spec: DeviceSpec,
    trace: Trace,
    last: Option<Tick>,
}

impl InputDevice for TracedDevice {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        let begin = Instant::now();
        let fault = self.trace.0.take();
        match fault {
            Some(Fault::Block(time)) => std::thread::sleep(time),
            Some(Fault::Panic) => panic!("the driver panics, as the benchmark wanted"),
            Some(Fault::NotANumber(_)) | None => (),
            Some(Fault::Disappear(_)) => self.trace.0.is_there()?,
        }
        let mut sample = self.inner.read()?;
        if matches!(fault, Some(Fault::NotANumber(_))) {
            sample.position.x = f64::NAN;
        }
        let (is_valid, is_clutched) = (sample.valid && sample.is_finite(), sample.is_pressed(CLUTCH));
        if is_valid {
            self.trace.0.clutched.store(is_clutched, Ordering::Release);
            self.trace.0.valid.store(epoch().elapsed().as_nanos() as u64, Ordering::Release);
        }
        self.last = Some(Tick {
            begin,
            read: Instant::now(),
            sequence: sample.sequence,
            position: sample.position,
            is_clutched,
            is_valid,
        });
        Ok(sample)
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        let written = self.inner.write(force);
        if let Some(tick) = self.last.take() {
            self.trace.0.ticks.lock().push(tick);
        }
        written
    }

    fn close(&mut self) {
        self.inner.close();
    }
}
