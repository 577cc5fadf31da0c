//! Driver of the Novint Falcon over USB: firmware, homing, positions, forces, and what keeps its user's fingers safe.
//! `docs/falcon.md` is the guide.
//!
//! ```
//! use ambf_device::{DeviceForce, DeviceLog, Driver, InputDevice, Setting, Settings};
//!
//! // As `driver settings: {transport: fake}` in a device file: two Falcons in software, added to `falcon::driver()`.
//! let fake = Setting { value: "fake".into(), place: "devices.yaml:3".into() };
//! let settings = Settings::new([("transport".into(), fake)].into(), ".".into());
//! let driver = fake_falcon::driver();
//! let found = driver.find("Falcon", &settings)?;
//! let (log, sentences) = DeviceLog::new();
//! let mut device = driver.open(&found[0], &settings, &log)?;
//! let sample = device.read()?;
//! assert!(!sample.valid, "homing takes a while");
//! device.write(&DeviceForce::zero())?;
//! device.close();
//! # Ok::<(), ambf_device::DeviceError>(())
//! ```

mod device;
mod driver;
mod firmware;
pub mod kinematics;
mod link;
mod motion;
mod packet;
mod settings;
mod transport;
mod usb;
mod worker;

pub use device::FalconDevice;
pub use driver::{driver, FalconDriver};
pub use transport::{Bus, Port, TransportError, PACKET};
pub use usb::Usb;
pub use worker::{State, Status};

/// Model name, as `hardware name` in device files.
pub const MODEL: &str = "Falcon";
