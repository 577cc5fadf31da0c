use std::path::{Path, PathBuf};
use std::time::Duration;

use ambf_device::files::read;
use thiserror::Error;

use crate::link::{ftdi, Link};
use crate::transport::{Bus, TransportError};

/// Bytes that the loader takes at once: what a USB packet holds beside the chip's status.
const BLOCK: usize = 62;
/// Lengths of the images that are known to work, the recommended one first.
const KNOWN_LENGTHS: [usize; 3] = [8492, 7914, 7324];
/// Far more than the device has memory for.
const LONGEST: usize = 65_536;

const WAKE: [u8; 3] = [0x0A, 0x43, 0x0D];
const AWAKE: [u8; 4] = [0x0A, 0x44, 0x2C, 0x0D];
const LOAD: u8 = 0x41;

const WAKE_ATTEMPTS: usize = 100;
const WAKE_TIMEOUT: Duration = Duration::from_millis(40);
const TIMEOUT: Duration = Duration::from_millis(500);

/// Why the motion program did not get into the device.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum FirmwareError {
    /// Error when the file can't be read.
    #[error("firmware {}: {reason}", path.display())]
    File {
        /// File.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// Error when the file can't be what it should be.
    #[error("firmware {}: {length} bytes are no image for a Falcon, which has {} bytes", path.display(), KNOWN_LENGTHS[0])]
    Length {
        /// File.
        path: PathBuf,
        /// Its length.
        length: usize,
    },
    /// Error when the loader did not do its part.
    #[error("the loader {0}")]
    Loader(&'static str),
    /// Error when it was told to stop.
    #[error("stopped")]
    Stopped,
    /// Error when the bytes did not get through.
    #[error(transparent)]
    Transport(#[from] TransportError),
}

/// An image of the motion program, from a file of the user's: its licence does not let it be given away.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Firmware(Vec<u8>);

impl Firmware {
    /// Reads an image.
    pub fn read(path: &Path) -> Result<Self, FirmwareError> {
        let bytes = read(path, LONGEST as u64)
            .map_err(|error| FirmwareError::File { path: path.to_owned(), reason: error.to_string() })?;
        if bytes.is_empty() || bytes.len() > LONGEST {
            return Err(FirmwareError::Length { path: path.to_owned(), length: bytes.len() });
        }
        Ok(Self(bytes))
    }

    /// Number of bytes.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether images of that length are known to work.
    pub fn is_known(&self) -> bool {
        KNOWN_LENGTHS.contains(&self.0.len())
    }

    /// Sends the image to the loader. It starts when the link is set up for the motion program.
    pub fn upload(&self, bus: &dyn Bus, link: &mut Link, stopped: &dyn Fn() -> bool) -> Result<(), FirmwareError> {
        wake(bus, link, stopped)?;
        start_loading(bus, link)?;
        let mut echo = Vec::with_capacity(2 * BLOCK);
        for block in self.0.chunks(BLOCK) {
            if stopped() {
                return Err(FirmwareError::Stopped);
            }
            link.send(block, TIMEOUT)?;
            echo.clear();
            let deadline = bus.now() + TIMEOUT;
            while echo.len() < block.len() && bus.now() < deadline {
                link.receive(&mut echo, deadline)?;
            }
            if echo != block {
                let short = echo.len() < block.len();
                return Err(FirmwareError::Loader(if short {
                    "stopped listening"
                } else {
                    "did not repeat what it was sent"
                }));
            }
        }
        Ok(())
    }
}

fn wake(bus: &dyn Bus, link: &mut Link, stopped: &dyn Fn() -> bool) -> Result<(), FirmwareError> {
    link.purge()?;
    for request in [
        ftdi::latency(16),
        ftdi::BAUD_9600,
        ftdi::LINE_8N1,
        ftdi::NO_FLOW_CONTROL,
        ftdi::RTS_LOW,
        ftdi::DTR_LOW,
        ftdi::DTR_HIGH,
    ] {
        link.request(request)?;
    }
    let mut answer = Vec::new();
    for _ in 0..WAKE_ATTEMPTS {
        if stopped() {
            return Err(FirmwareError::Stopped);
        }
        match link.send(&WAKE, TIMEOUT) {
            Err(TransportError::TimedOut) => continue,
            other => other?,
        }
        let deadline = bus.now() + WAKE_TIMEOUT;
        while bus.now() < deadline {
            link.receive(&mut answer, deadline)?;
            // Some systems see a zero before it, and an earlier question may have been answered in part.
            if answer.windows(AWAKE.len()).any(|window| window == AWAKE) {
                return Ok(());
            }
        }
    }
    Err(FirmwareError::Loader("does not answer: switch the device off and on"))
}

fn start_loading(bus: &dyn Bus, link: &mut Link) -> Result<(), FirmwareError> {
    link.request(ftdi::DTR_LOW)?;
    link.request(ftdi::BAUD_143K)?;
    link.purge()?;
    link.send(&[LOAD], TIMEOUT)?;
    let mut answer = Vec::new();
    link.receive(&mut answer, bus.now() + TIMEOUT)?;
    if answer != [LOAD] {
        return Err(FirmwareError::Loader("is not ready for the firmware"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_are_no_images_are_refused() {
        let missing = Firmware::read(Path::new("no/such/firmware.bin")).unwrap_err().to_string();
        assert!(missing.contains("no/such/firmware.bin"), "{missing}");
        let path = std::env::temp_dir().join(format!("falcon-empty-{}", std::process::id()));
        std::fs::write(&path, []).unwrap();
        let empty = Firmware::read(&path).unwrap_err();
        std::fs::write(&path, vec![7; 8492]).unwrap();
        let good = Firmware::read(&path).unwrap();
        std::fs::write(&path, vec![7; 100]).unwrap();
        let odd = Firmware::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(empty, FirmwareError::Length { path, length: 0 });
        assert!(good.is_known() && good.len() == 8492);
        assert!(!odd.is_known());
    }
}
