//! 3D Systems Touch, Geomagic Touch and the Phantoms as input devices.
//!
//! The vendor's HD library (`libHD`, part of OpenHaptics) is opened when a device file asks for such a device; nothing
//! of it is needed to build or run the simulator. Its scheduler calls a callback of ours for each device, about a
//! thousand times a second, which leaves the newest sample for [`InputDevice::read`](ambf_device::InputDevice::read)
//! and takes the newest force. All devices of the process share the library and its scheduler.
//!
//! Safety: no force without calibration, after 50 ms without a new one, for 100 ms after a force error, while the
//! device is at fault, and before it is closed; the library's own limit of forces stays on.
//!
//! ```no_run
//! use ambf_device::{DeviceLog, Driver, InputDevice, Settings};
//!
//! let (driver, settings, (log, _)) = (touch::TouchDriver, Settings::default(), DeviceLog::new());
//! let found = driver.find("Touch", &settings)?;
//! let mut stylus = driver.open_touch(&found[0], &settings, &log)?;
//! println!("{:?}, joints {:?}", stylus.read()?.position, stylus.joint_angles());
//! # Ok::<(), ambf_device::DeviceError>(())
//! ```

mod convert;
mod device;
mod driver;
mod hd;
mod library;
mod models;
mod servo;

pub use device::Touch;
pub use driver::{driver, TouchDriver};
