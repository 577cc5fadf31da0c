//! The device file of a Hydra.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;
use rustix::ioctl::{self, opcode, Opcode, Updater};

use super::report::FEATURE;

/// `HIDIOCSFEATURE(91)`.
const SET_FEATURE: Opcode = opcode::read_write::<[u8; FEATURE]>(b'H', 0x06);

/// What the driver needs of a device file: reads that do not wait, one report each, and feature reports.
pub(super) trait Hid: Send {
    /// The next report; [`io::ErrorKind::WouldBlock`] if there is none.
    fn read(&mut self, report: &mut [u8]) -> io::Result<usize>;

    /// Sends a feature report.
    fn set_feature(&mut self, report: [u8; FEATURE]) -> io::Result<()>;
}

/// A file like `/dev/hidraw0`.
#[derive(Debug)]
pub(super) struct HidRaw(File);

impl HidRaw {
    pub fn open(path: &Path) -> io::Result<Self> {
        let nonblocking = OFlags::NONBLOCK.bits().try_into().unwrap_or(0);
        Ok(Self(OpenOptions::new().read(true).write(true).custom_flags(nonblocking).open(path)?))
    }
}

impl Hid for HidRaw {
    fn read(&mut self, report: &mut [u8]) -> io::Result<usize> {
        self.0.read(report)
    }

    fn set_feature(&mut self, mut report: [u8; FEATURE]) -> io::Result<()> {
        // SAFETY: the request says how long the report is, the kernel reads no more than that.
        unsafe { ioctl::ioctl(&self.0, Updater::<SET_FEATURE, _>::new(&mut report)) }?;
        Ok(())
    }
}

/// Device files of Hydras, with the USB port of each, ordered by port. `sys` is where the kernel lists devices, `/sys`;
/// nothing is opened.
pub(super) fn list(sys: &Path) -> Vec<(String, PathBuf)> {
    let entries = sys.join("class/hidraw").read_dir().into_iter().flatten().flatten();
    let mut found: Vec<(String, PathBuf)> = entries
        .filter_map(|entry| {
            let facts = std::fs::read_to_string(entry.path().join("device/uevent")).ok()?;
            let fact = |key: &str| facts.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
            // Bus, vendor, product, in hexadecimal.
            let ids: Vec<u32> = fact("HID_ID")?.split(':').map_while(|id| u32::from_str_radix(id, 16).ok()).collect();
            let port = fact("HID_PHYS")?;
            // The device has a second interface, a mouse.
            (ids.get(1..) == Some(&[0x1532, 0x0300]) && port.ends_with("/input0"))
                .then(|| (port.trim_end_matches("/input0").to_owned(), Path::new("/dev").join(entry.file_name())))
        })
        .collect();
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn the_request_is_that_of_the_kernel() {
        // _IOC(_IOC_WRITE | _IOC_READ, 'H', 0x06, 91).
        assert_eq!(SET_FEATURE, 0xC05B_4806);
    }

    #[test]
    fn a_file_that_is_no_hydra_refuses() {
        let mut file = HidRaw::open(Path::new("/dev/null")).unwrap();
        assert!(file.set_feature([0; FEATURE]).is_err());
        assert_eq!(file.read(&mut [0; 8]).unwrap(), 0);
        assert!(HidRaw::open(Path::new("/nowhere")).is_err());
    }

    #[test]
    fn hydras_are_found_by_their_numbers() {
        let sys = std::env::temp_dir().join(format!("trackers-hid-{}", std::process::id()));
        let add = |name: &str, text: &str| {
            let device = sys.join("class/hidraw").join(name).join("device");
            fs::create_dir_all(&device).unwrap();
            fs::write(device.join("uevent"), text).unwrap();
        };
        add(
            "hidraw3",
            "DRIVER=hid\nHID_ID=0003:00001532:00000300\nHID_NAME=Razer Hydra\nHID_PHYS=usb-0000:00:14.0-3/input0\n",
        );
        add("hidraw4", "HID_ID=0003:00001532:00000300\nHID_PHYS=usb-0000:00:14.0-3/input1\n");
        add("hidraw1", "HID_ID=0003:0000046D:0000C31C\nHID_PHYS=usb-0000:00:14.0-1/input0\n");
        add("hidraw5", "HID_ID=0003:00001532:00000300\nHID_PHYS=usb-0000:00:14.0-2/input0\n");
        add("hidraw6", "nothing of use");
        let found = list(&sys);
        fs::remove_dir_all(&sys).unwrap();
        let expected = [("usb-0000:00:14.0-2", "/dev/hidraw5"), ("usb-0000:00:14.0-3", "/dev/hidraw3")];
        assert_eq!(found, expected.map(|(port, path)| (port.to_owned(), PathBuf::from(path))));
        assert_eq!(list(&sys), []);
    }
}
