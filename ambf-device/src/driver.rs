use std::sync::Arc;

use ambf_model::SettingError;
use crossbeam_channel::{bounded, Receiver, Sender};
use thiserror::Error;

use super::{DeviceForce, DeviceSample, DeviceSpec, Settings};

/// Why a device cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// Error when a setting of the device file is of no use.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// Error when what the driver needs is not there: a library, a permission, a ROS master.
    #[error("{0}")]
    Unavailable(String),
    /// Error when the device was there and is no more, or does not answer. Opening it again may help.
    #[error("{0}")]
    Lost(String),
}

/// A device that a driver has found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Model name, as `hardware name` in device files.
    pub model: String,
    /// Which one of several: USB port, serial number, name of the arm. The same at each start where the hardware allows
    /// it.
    pub identity: String,
}

/// What is known of a device without opening it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Presence {
    /// It is there, and nothing is seen that keeps it from being opened and used. What is seen of it.
    There(String),
    /// It could not be used now. What is missing.
    NotReady(String),
    /// Only opening it would tell. Why.
    Unknown(String),
}

/// Where a driver says what its user should know, from any of its threads, without waiting. Sentences that nobody takes
/// are dropped.
#[derive(Debug, Clone)]
pub struct DeviceLog(Sender<String>);

impl DeviceLog {
    /// A log and where its sentences come out.
    pub fn new() -> (Self, Receiver<String>) {
        let (sender, receiver) = bounded(64);
        (Self(sender), receiver)
    }

    /// Says a sentence.
    pub fn say(&self, sentence: impl Into<String>) {
        // A full log is no reason to wait.
        drop(self.0.try_send(sentence.into()));
    }
}

/// A device that is open. The host calls all of it from one thread, about a thousand times a second; what takes longer
/// belongs into a thread of the driver's own, so that [`read`](Self::read) returns the newest sample and
/// [`write`](Self::write) leaves the newest force at once.
pub trait InputDevice: Send {
    /// What it can do.
    fn spec(&self) -> &DeviceSpec;

    /// The newest sample; the same as before if there is none yet.
    ///
    /// # Errors
    /// [`DeviceError::Lost`]: the host stops using the device, closes it, and tries to open it again.
    fn read(&mut self) -> Result<DeviceSample, DeviceError>;

    /// Lets the user feel `force`. The host has limited it to [`spec`](Self::spec) already. The device itself must fall
    /// back to no force when this is not called for 50 ms.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError>;

    /// Sends a force of zero and closes the device. Called once, last; dropping must do the same.
    fn close(&mut self);
}

/// Finds and opens devices of one kind.
pub trait Driver: Send + Sync {
    /// Name, as `driver` in device files.
    fn name(&self) -> &str;

    /// Whether devices of that model name are this driver's.
    fn serves(&self, model: &str) -> bool;

    /// Devices that are there, without side effects: nothing is opened, moved or sent. `model` is what is looked for.
    ///
    /// # Errors
    /// [`DeviceError::Unavailable`], [`DeviceError::Setting`].
    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError>;

    /// What is known of a device that was [found](Self::find), without opening it: nothing is moved or sent, nobody is
    /// disturbed who uses it. It may take some seconds. Default: [`Presence::Unknown`].
    fn presence(&self, info: &DeviceInfo, settings: &Settings) -> Presence {
        let _ = (info, settings);
        Presence::Unknown("its driver tells only when it is opened".into())
    }

    /// Opens a device that was found. It may take a second.
    ///
    /// # Errors
    /// [`DeviceError`].
    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError>;
}

/// The drivers of a program.
#[derive(Clone, Default)]
pub struct Drivers(Vec<Arc<dyn Driver>>);

impl Drivers {
    /// Adds a driver; a later one of the same name replaces it.
    pub fn add(&mut self, driver: Arc<dyn Driver>) {
        self.0.retain(|other| other.name() != driver.name());
        self.0.push(driver);
    }

    /// Driver of that name.
    pub fn named(&self, name: &str) -> Option<&Arc<dyn Driver>> {
        self.0.iter().find(|driver| driver.name() == name)
    }

    /// The first driver that serves a model.
    pub fn serving(&self, model: &str) -> Option<&Arc<dyn Driver>> {
        self.0.iter().find(|driver| driver.serves(model))
    }

    /// Names in the order in which they were added.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|driver| driver.name())
    }
}
