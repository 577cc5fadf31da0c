//! Which device serves which entry of a device file.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{bounded, RecvTimeoutError};

use crate::{caught, DeviceInfo, Driver, Drivers, Presence, Settings};
use ambf_model::adf;

/// How long a driver may look for its devices, or at one of them.
const FIND_TIMEOUT: Duration = Duration::from_secs(10);

/// A device that belongs to one entry.
#[derive(Clone)]
pub(super) struct Claim {
    pub driver: Arc<dyn Driver>,
    pub info: DeviceInfo,
    pub settings: Settings,
}

impl Claim {
    fn is(&self, driver: &Arc<dyn Driver>, info: &DeviceInfo) -> bool {
        self.driver.name() == driver.name() && self.info == *info
    }
}

/// The first device of the entry's model that is not among `claimed` and has the wanted identity.
///
/// # Errors
/// One sentence that says why there is none.
pub(super) fn claim(entry: &adf::InputDevice, drivers: &Drivers, claimed: &[Claim]) -> Result<Claim, String> {
    let model = &entry.hardware_name;
    let driver = match &entry.driver {
        Some(name) => drivers.named(name).ok_or_else(|| format!("there is no driver `{name}`{}", known(drivers)))?,
        None => drivers.serving(model).ok_or_else(|| format!("no driver serves `{model}`{}", known(drivers)))?,
    };
    let mut found = find_devices(driver, model, &entry.driver_settings)?;
    found.retain(|info| info.model == *model);
    if found.is_empty() {
        return Err(format!("no `{model}` is connected"));
    }
    if let Some(identity) = &entry.identity {
        let there: Vec<_> = found.iter().map(|info| info.identity.clone()).collect();
        found.retain(|info| info.identity == *identity);
        if found.is_empty() {
            return Err(format!(
                "no `{model}` with the identity `{identity}` is connected, only `{}`",
                there.join("`, `")
            ));
        }
    }
    let count = found.len();
    let free = found.into_iter().find(|info| !claimed.iter().any(|claim| claim.is(driver, info)));
    let info = free.ok_or_else(|| match count {
        1 => format!("the only `{model}` is taken by another entry"),
        _ => format!("all {count} `{model}` are taken by other entries"),
    })?;
    Ok(Claim { driver: Arc::clone(driver), info, settings: entry.driver_settings.clone() })
}

fn known(drivers: &Drivers) -> String {
    let names: Vec<_> = drivers.names().collect();
    match names.is_empty() {
        true => String::from("; this program has no drivers"),
        false => format!("; there are {}", names.join(", ")),
    }
}

/// What a driver finds. One that panics or does not return is no reason to start without the others.
///
/// # Errors
/// Why it is not known what there is.
pub fn find_devices(driver: &Arc<dyn Driver>, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, String> {
    let (model, settings) = (model.to_owned(), settings.clone());
    let found = asked(driver, "which devices there are", move |driver| driver.find(&model, &settings))?;
    found.map_err(|error| error.to_string())
}

/// What a driver can tell of a device that it found; the same holds for one that panics or does not return.
///
/// # Errors
/// Why that is not known.
pub fn presence_of(driver: &Arc<dyn Driver>, info: &DeviceInfo, settings: &Settings) -> Result<Presence, String> {
    let (info, settings) = (info.clone(), settings.clone());
    asked(driver, "whether the device can be used", move |driver| driver.presence(&info, &settings))
}

/// What a driver answers, in a thread that is given up after [`FIND_TIMEOUT`]; `what` it is asked.
fn asked<T: Send + 'static>(
    driver: &Arc<dyn Driver>,
    what: &str,
    ask: impl FnOnce(&dyn Driver) -> T + Send + 'static,
) -> Result<T, String> {
    let (answer, answered) = bounded(1);
    let (name, asked) = (driver.name(), Arc::clone(driver));
    let work = move || {
        let said = caught(|| ask(&*asked));
        // Nobody waits any more after the timeout.
        let _ = answer.send(said);
    };
    std::thread::Builder::new().name("find devices".into()).spawn(work).map_err(|error| error.to_string())?;
    match answered.recv_timeout(FIND_TIMEOUT) {
        Ok(Ok(said)) => Ok(said),
        Ok(Err(panic)) => Err(format!("driver `{name}` panicked: {panic}")),
        Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
            Err(format!("driver `{name}` did not say within {} s {what}", FIND_TIMEOUT.as_secs()))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::{DeviceError, DeviceLog, InputDevice, MockDriver, Setting};

    /// A driver with which something is wrong.
    struct Bad;

    impl Driver for Bad {
        fn name(&self) -> &str {
            "bad"
        }

        fn serves(&self, model: &str) -> bool {
            model == "Bad"
        }

        fn find(&self, _: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
            match settings.text("how") {
                Some("panic") => panic!("no bus"),
                Some("refuse") => Err(DeviceError::Unavailable("no permission".into())),
                _ => Ok(Vec::new()),
            }
        }

        fn presence(&self, _: &DeviceInfo, settings: &Settings) -> Presence {
            match settings.text("how") {
                Some("panic") => panic!("no bus"),
                _ => Presence::Unknown("only opening it would tell".into()),
            }
        }

        fn open(&self, _: &DeviceInfo, _: &Settings, _: &DeviceLog) -> Result<Box<dyn InputDevice>, DeviceError> {
            Err(DeviceError::Unavailable("never".into()))
        }
    }

    fn outcome(entry: &str, claimed: &[Claim]) -> Result<Claim, String> {
        let mut drivers = Drivers::default();
        drivers.add(Arc::new(MockDriver::default()));
        drivers.add(Arc::new(Bad));
        let text = format!("input devices: [A]\nA: {{root link: l, {entry}}}\n");
        let (devices, _) = adf::parse::<adf::InputDevices>(&text, Path::new("d.yaml")).expect("a list");
        claim(devices.entries[0].as_ref().expect("an entry"), &drivers, claimed)
    }

    #[test]
    fn equal_entries_get_different_devices() {
        let mut claimed = Vec::new();
        for identity in ["0", "1", "2"] {
            let claim = outcome("hardware name: Mock", &claimed).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(claim.info.identity, identity);
            claimed.push(claim);
        }
        let taken = outcome("hardware name: Mock, identity: 1", &claimed).err().expect("it is taken");
        assert_eq!(taken, "the only `Mock` is taken by another entry");
    }

    #[test]
    fn a_named_driver_serves_any_model() {
        let claim = outcome("hardware name: Falcon, driver: mock", &[]).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((claim.driver.name(), claim.info.model.as_str()), ("mock", "Falcon"));
    }

    #[test]
    fn failures_say_what_is_wrong() {
        let of = |entry| outcome(entry, &[]).err().expect("a failure");
        assert_eq!(of("hardware name: Falcon"), "no driver serves `Falcon`; there are mock, bad");
        assert_eq!(of("hardware name: Bad"), "no `Bad` is connected");
        assert_eq!(of("hardware name: Bad, driver settings: {how: refuse}"), "no permission");
        assert_eq!(of("hardware name: Bad, driver settings: {how: panic}"), "driver `bad` panicked: no bus");
        let found = of("hardware name: Mock, identity: 99");
        assert!(found.starts_with("no `Mock` with the identity `99` is connected, only `0`, `1`"), "{found}");
    }

    #[test]
    fn drivers_are_asked_about_devices() {
        let of = |driver: Arc<dyn Driver>, how: &str| {
            let setting = Setting { value: how.into(), place: "d.yaml:1".into() };
            let settings = Settings::new([("how".to_owned(), setting)].into(), ".".into());
            presence_of(&driver, &DeviceInfo { model: "Bad".into(), identity: "0".into() }, &settings)
        };
        let said = of(Arc::new(MockDriver::default()), "any");
        assert_eq!(said, Ok(Presence::There("in software".into())));
        assert!(matches!(of(Arc::new(Bad), "any"), Ok(Presence::Unknown(_))), "what a driver says that does not know");
        assert!(of(Arc::new(Bad), "panic").unwrap_err().contains("no bus"));
    }
}
