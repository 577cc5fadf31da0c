use std::time::{Duration, Instant};

use thiserror::Error;

/// Length of a USB packet of the device: what a bulk transfer asks for.
pub const PACKET: usize = 64;

/// Why a transfer did not happen.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum TransportError {
    /// Error when the device did not take what it was sent in time.
    #[error("the device does not take what it is sent")]
    TimedOut,
    /// Error when the device is not, or no more, plugged in.
    #[error("it is not plugged in")]
    Gone,
    /// Error when the user may not open the device.
    #[error("this user may not open it: install resources/udev/60-novint-falcon.rules and plug the device in again (docs/falcon.md)")]
    Denied,
    /// Error when another program has the device.
    #[error("another program uses it")]
    Busy,
    /// Error when the computer's USB says no for another reason.
    #[error("USB: {0}")]
    Other(String),
}

/// Where devices are plugged in: the computer's USB, or a fake of it.
pub trait Bus: Send + Sync {
    /// Identities of the Falcons that are plugged in, sorted. Nothing is opened.
    ///
    /// # Errors
    /// [`TransportError::Other`] when the bus can't be looked at.
    fn list(&self) -> Result<Vec<String>, TransportError>;

    /// Whether this user may open a device; it is not opened. Default: yes.
    ///
    /// # Errors
    /// [`TransportError`].
    fn may_open(&self, identity: &str) -> Result<(), TransportError> {
        let _ = identity;
        Ok(())
    }

    /// Opens a device for this program alone.
    ///
    /// # Errors
    /// [`TransportError`].
    fn open(&self, identity: &str) -> Result<Box<dyn Port>, TransportError>;

    /// The bus's clock.
    fn now(&self) -> Instant {
        Instant::now()
    }

    /// Waits at most `duration` on that clock; less when the thread is unparked.
    fn wait(&self, duration: Duration) {
        std::thread::park_timeout(duration);
    }
}

/// An open device. Dropping it closes the device.
pub trait Port: Send {
    /// A request of the serial chip, without data.
    ///
    /// # Errors
    /// [`TransportError`].
    fn control_out(&mut self, request: u8, value: u16) -> Result<(), TransportError>;

    /// Sends bytes to the device.
    ///
    /// # Errors
    /// [`TransportError`]; after [`TransportError::TimedOut`] some of the bytes may have been sent.
    fn bulk_out(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), TransportError>;

    /// Receives a packet as the chip sends it, with its two status bytes, and says how long it is: 0 if none came in
    /// time.
    ///
    /// # Errors
    /// [`TransportError`].
    fn bulk_in(&mut self, packet: &mut [u8; PACKET], timeout: Duration) -> Result<usize, TransportError>;
}
