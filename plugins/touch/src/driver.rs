use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_device::{DeviceError, DeviceInfo, DeviceLog, Driver, InputDevice, Presence, Settings};

use crate::device::Touch;
use crate::library::{HdLibrary, DEFAULT_DEVICE};
use crate::models;

/// Settings that the driver knows.
const KEYS: [&str; 3] = ["device", "library", "rate"];
/// Rates that may be asked for, Hz.
const RATES: std::ops::RangeInclusive<u64> = 100..=10_000;

/// Driver `touch`.
///
/// Settings: `device`, name of the device in the vendor's set-up tool (default: the first that is set up); `library`,
/// file of the HD library, or its name without `/` for the loader's search path (default: `libHD.so` of the search
/// path); `rate` of the library's scheduler, Hz (default: the library's, 1000).
#[derive(Debug, Clone, Copy, Default)]
pub struct TouchDriver;

/// The driver for [`Drivers`](ambf_device::Drivers).
pub fn driver() -> Arc<dyn Driver> {
    Arc::new(TouchDriver)
}

impl TouchDriver {
    /// Opens a device, as [`Driver::open`], and keeps its type.
    ///
    /// # Errors
    /// [`DeviceError::Setting`]; [`DeviceError::Unavailable`] if there is no library, no such device, or one of another
    /// model; [`DeviceError::Lost`] if the library does not answer.
    pub fn open_touch(&self, info: &DeviceInfo, settings: &Settings, log: &DeviceLog) -> Result<Touch, DeviceError> {
        settings.unknown(&KEYS)?;
        let rate = rate(settings)?;
        let library = HdLibrary::shared(library(settings))?;
        let opened = library.open(&info.identity, rate, log)?;
        let touch = Touch::new(library, opened, &info.identity, log);
        let model = &touch.spec().model;
        if *model != info.model {
            return Err(DeviceError::Unavailable(format!(
                "`{}` is a `{model}`, not a `{}`: write `hardware name: {model}`",
                info.identity, info.model
            )));
        }
        Ok(touch)
    }
}

impl Driver for TouchDriver {
    fn name(&self) -> &str {
        "touch"
    }

    fn serves(&self, model: &str) -> bool {
        models::serves(model)
    }

    /// The library tells the model of a device only once the device was initialised, so every name that is set up may
    /// be of that model; the name is the identity.
    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        settings.unknown(&KEYS)?;
        rate(settings)?;
        HdLibrary::shared(library(settings))?;
        let names = match settings.text("device").map(str::trim) {
            Some("") => {
                return Err(settings.wrong("device", "the name of a device in the vendor's set-up tool").into())
            }
            Some(name) => vec![name.to_owned()],
            None => configured(std::env::var_os("GTDD_HOME").map(PathBuf::from).as_deref()),
        };
        Ok(names.into_iter().map(|identity| DeviceInfo { model: model.to_owned(), identity }).collect())
    }

    fn presence(&self, info: &DeviceInfo, _settings: &Settings) -> Presence {
        Presence::Unknown(format!(
            "the vendor's library is there; whether `{}` is plugged in it tells only by opening it",
            info.identity
        ))
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        Ok(Box::new(self.open_touch(info, settings, log)?))
    }
}

fn rate(settings: &Settings) -> Result<Option<u64>, DeviceError> {
    let expected = format!("a frequency in Hz, {} to {}", RATES.start(), RATES.end());
    match settings.parsed::<u64>("rate", &expected)? {
        Some(rate) if !RATES.contains(&rate) => Err(settings.wrong("rate", &expected).into()),
        rate => Ok(rate),
    }
}

/// File of the library; a name without folder is left to the loader's search path.
fn library(settings: &Settings) -> Option<PathBuf> {
    let text = settings.text("library")?;
    if text.contains('/') {
        settings.path("library")
    } else {
        Some(PathBuf::from(text))
    }
}

/// Names of devices that the vendor's set-up tool has stored, `config/NAME.config` in its folder; the default device
/// comes first, and is there if no other is.
fn configured(home: Option<&Path>) -> Vec<String> {
    let entries = home.and_then(|home| home.join("config").read_dir().ok()).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "config"))
        .filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()))
        .collect();
    names.sort_by_key(|name| (name != DEFAULT_DEVICE, name.clone()));
    if names.is_empty() {
        names.push(DEFAULT_DEVICE.to_owned());
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_device::Setting;

    fn settings(entries: &[(&str, &str)]) -> Settings {
        let entry = |(key, value): &(&str, &str)| {
            ((*key).to_owned(), Setting { value: (*value).to_owned(), place: String::from("devices.yaml:7") })
        };
        Settings::new(entries.iter().map(entry).collect(), PathBuf::from("/devices"))
    }

    #[test]
    fn settings_are_checked_before_anything_is_loaded() {
        let find = |entries| TouchDriver.find("Touch", &settings(entries)).unwrap_err().to_string();
        assert!(find(&[("rate", "20")]).contains("devices.yaml:7: `rate` is `20`, expected a frequency in Hz, 100 to"));
        assert!(find(&[("speed", "1")]).contains("`speed`"));
    }

    #[test]
    fn libraries_with_a_folder_belong_to_the_file() {
        let path = |text| library(&settings(&[("library", text)])).unwrap();
        assert_eq!(path("./libHD.so"), PathBuf::from("/devices/./libHD.so"));
        assert_eq!(path("/opt/lib/libHD.so"), PathBuf::from("/opt/lib/libHD.so"));
        assert_eq!(path("libHD.so.3.4"), PathBuf::from("libHD.so.3.4"));
    }

    #[test]
    fn a_missing_library_is_one_sentence() {
        let error = TouchDriver.find("Touch", &settings(&[("library", "/nowhere/libHD.so")])).unwrap_err();
        let DeviceError::Unavailable(sentence) = error else { panic!("{error:?}") };
        assert!(sentence.starts_with("/nowhere/libHD.so: cannot be opened") && !sentence.contains('\n'), "{sentence}");
    }

    #[test]
    fn names_come_from_the_set_up_tool() {
        let home = std::env::temp_dir().join(format!("touch-names-{}", std::process::id()));
        let config = home.join("config");
        std::fs::create_dir_all(&config).unwrap();
        for name in ["Left.config", "Default Device.config", "Arm.config", "notes.txt"] {
            std::fs::write(config.join(name), "").unwrap();
        }
        assert_eq!(configured(Some(&home)), [DEFAULT_DEVICE, "Arm", "Left"]);
        std::fs::remove_dir_all(&home).unwrap();
        assert_eq!(configured(Some(&home)), [DEFAULT_DEVICE]);
        assert_eq!(configured(None), [DEFAULT_DEVICE]);
    }
}
