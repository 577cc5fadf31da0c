//! A `libHD.so` without hardware behind it, which stands in for the vendor's HD library of the Touch and Phantom
//! devices: the same symbols, a real scheduler thread, the same rules for frames, scripted hands, faults, and a record
//! of all forces. For tests, measurements, and a first look:
//!
//! ```text
//! cargo run -p fake-hd                              # prints the path of the library
//! ```
//! then, in a device file, `driver settings: {library: PATH}`. The variable `AMBF_FAKE_HD` holds commands that set up
//! its devices; `c/control.c` lists them. Without it there is one `Touch` whose tip goes around a circle.

use std::ffi::{c_char, CStr, CString};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use libloading::Library;

/// The library that was built. All who open this file share its devices; [`Fake`] makes copies.
pub const LIBRARY: &str = concat!(env!("OUT_DIR"), "/libHD.so");
/// The same without `hdGetError`.
pub const OLD_LIBRARY: &str = concat!(env!("OUT_DIR"), "/libHD_old.so");
/// A program that calls every function of the library given to it through C, and ends with status 0 if all is right;
/// with the name of a device too, it prints model and position of that device instead.
pub const ABI_CHECK: &str = concat!(env!("OUT_DIR"), "/abi_check");

type Control = unsafe extern "C" fn(*const c_char, *mut c_char, u64) -> i32;

/// A copy of the library with devices and scheduler of its own, removed when dropped.
#[derive(Debug)]
pub struct Fake {
    path: PathBuf,
    control: Control,
    /// Keeps `control` where it is.
    _library: Library,
}

/// A force as it reached the motors, in the frame of HD: x to the right, y up, z towards the user.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Force {
    /// s since the library was loaded.
    pub time: f64,
    /// N.
    pub force: [f64; 3],
    /// mN·m.
    pub torque: [f64; 3],
}

impl Fake {
    /// A copy with these devices: name, model.
    ///
    /// # Errors
    /// When the copy cannot be written or loaded.
    pub fn new(devices: &[(&str, &str)]) -> io::Result<Self> {
        static COPIES: AtomicU32 = AtomicU32::new(0);
        let number = COPIES.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("libHD_fake_{}_{number}.so", std::process::id()));
        fs::copy(LIBRARY, &path)?;
        // SAFETY: the library is ours; loading it reads a variable and starts nothing.
        let library = unsafe { Library::new(&path) }.map_err(io::Error::other)?;
        // SAFETY: `ambf_fake_hd_control` has this type.
        let control = *unsafe { library.get::<Control>(b"ambf_fake_hd_control") }.map_err(io::Error::other)?;
        let fake = Self { path, control, _library: library };
        fake.tell("reset");
        for (name, model) in devices {
            fake.tell(&format!("device {name} = {model}"));
        }
        Ok(fake)
    }

    /// File of the copy, for `driver settings: {library: …}`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Runs a command of `c/control.c` and gives back its reply.
    ///
    /// # Panics
    /// On a command that is not known.
    pub fn tell(&self, command: &str) -> String {
        self.try_tell(command).unwrap_or_else(|| panic!("the fake HD library does not know `{command}`"))
    }

    /// The same; `None` for a command that is not known, or has no answer yet.
    ///
    /// # Panics
    /// On a command with a zero in it.
    pub fn try_tell(&self, command: &str) -> Option<String> {
        let command = CString::new(command).expect("commands are text");
        let mut reply = vec![0_u8; 8192];
        // SAFETY: the command ends with a zero, the reply has the size that is said, and the library writes an end to
        // it.
        let code = unsafe { (self.control)(command.as_ptr(), reply.as_mut_ptr().cast(), reply.len() as u64) };
        let text = CStr::from_bytes_until_nul(&reply).ok()?;
        (code == 0).then(|| text.to_string_lossy().into_owned())
    }

    /// How many frames a device had.
    ///
    /// # Panics
    /// If there is no such device.
    pub fn frames(&self, device: &str) -> usize {
        self.tell(&format!("{device}: frames")).parse().expect("a number")
    }

    /// Force of a frame, for the last 65536.
    pub fn force(&self, device: &str, frame: usize) -> Option<Force> {
        self.read_force(device, &frame.to_string())
    }

    /// Force of the newest frame.
    pub fn newest_force(&self, device: &str) -> Option<Force> {
        self.read_force(device, "-1")
    }

    fn read_force(&self, device: &str, frame: &str) -> Option<Force> {
        let text = self.try_tell(&format!("{device}: force {frame}"))?;
        let numbers: Vec<f64> = text.split(' ').map_while(|word| word.parse().ok()).collect();
        let three = |at: usize| Some([*numbers.get(at)?, *numbers.get(at + 1)?, *numbers.get(at + 2)?]);
        Some(Force { time: *numbers.first()?, force: three(1)?, torque: three(4)? })
    }

    /// What was called so far that concerns devices and the scheduler, one a line.
    pub fn log(&self) -> Vec<String> {
        self.tell("log").lines().map(str::to_owned).collect()
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        // A file that stays in the temporary folder does no harm.
        drop(fs::remove_file(&self.path));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    fn every_function_works_through_c() {
        let fake = Fake::new(&[]).unwrap();
        let output = Command::new(ABI_CHECK).arg(fake.path()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(String::from_utf8_lossy(&output.stdout).contains("checks"));
    }

    #[test]
    fn a_variable_scripts_the_devices() {
        let show = |name: &str, script: Option<&str>| {
            let mut command = Command::new(ABI_CHECK);
            command.args([LIBRARY, name]).env_remove("AMBF_FAKE_HD");
            script.map(|script| command.env("AMBF_FAKE_HD", script));
            let output = command.output().unwrap();
            (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
        };
        let script = "device Left = Touch X; device Right = Touch; Left: pose 1 2 3; jump";
        let (shown, complaint) = show("Left", Some(script));
        assert_eq!(shown, "Touch X 1 2 3\n");
        assert_eq!(complaint, "fake libHD: ` jump` in AMBF_FAKE_HD is not known\n");
        assert!(show("Default Device", None).0.starts_with("Touch "), "a device without a script");
    }

    #[test]
    fn copies_have_devices_of_their_own() {
        let [one, two] = ["Left", "Right"].map(|name| Fake::new(&[(name, "Touch")]).unwrap());
        assert_eq!(one.frames("Left"), 0);
        assert_eq!(one.try_tell("Right: frames"), None);
        assert_eq!(two.frames("Right"), 0);
    }
}
