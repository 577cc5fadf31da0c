use std::sync::Arc;

use ambf_device::{DeviceError, DeviceInfo, DeviceLog, Driver, InputDevice, Presence, Settings};

use crate::device::FalconDevice;
use crate::settings::{config, KEYS};
use crate::transport::Bus;
use crate::usb::Usb;
use crate::MODEL;

/// The driver of Falcons, on USB and where else [`with_bus`](Self::with_bus) says.
pub struct FalconDriver {
    /// With the names that the setting `transport` has for them; the first is the default.
    buses: Vec<(&'static str, Arc<dyn Bus>)>,
}

/// The driver of Falcons on USB.
pub fn driver() -> FalconDriver {
    FalconDriver { buses: vec![("usb", Arc::new(Usb))] }
}

impl FalconDriver {
    /// Looks for devices on `bus` where settings ask for `transport: name`.
    #[must_use]
    pub fn with_bus(mut self, name: &'static str, bus: Arc<dyn Bus>) -> Self {
        self.buses.push((name, bus));
        self
    }

    /// The bus that settings ask for, if all of their keys are known.
    fn bus(&self, settings: &Settings) -> Result<&Arc<dyn Bus>, DeviceError> {
        settings.unknown(&KEYS)?;
        let wanted = settings.text("transport");
        let names = || self.buses.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(" or ");
        let bus = self.buses.iter().find(|(name, _)| wanted.is_none_or(|wanted| wanted == *name));
        Ok(&bus.ok_or_else(|| settings.wrong("transport", &names()))?.1)
    }

    /// Opens a device that was found, as [`Driver::open`] does.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn open_falcon(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<FalconDevice, DeviceError> {
        FalconDevice::open(self.bus(settings)?, &info.identity, config(settings)?, log)
    }
}

impl Driver for FalconDriver {
    fn name(&self) -> &str {
        "falcon"
    }

    fn serves(&self, model: &str) -> bool {
        model == MODEL
    }

    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        let (bus, port) = (self.bus(settings)?, settings.text("port"));
        if !self.serves(model) {
            return Ok(Vec::new());
        }
        let identities = bus.list().map_err(|error| DeviceError::Unavailable(format!("Falcon: {error}")))?;
        let wanted = identities.into_iter().filter(|identity| port.is_none_or(|port| port == identity));
        Ok(wanted.map(|identity| DeviceInfo { model: model.to_owned(), identity }).collect())
    }

    fn presence(&self, info: &DeviceInfo, settings: &Settings) -> Presence {
        let checked = self.bus(settings).and_then(|bus| Ok((bus, config(settings)?)));
        match checked.map(|(bus, config)| (bus.may_open(&info.identity), config.firmware.is_some())) {
            Err(error) => Presence::NotReady(error.to_string()),
            Ok((Err(error), _)) => Presence::NotReady(format!("{}: {error}", info.identity)),
            Ok((Ok(()), true)) => Presence::There(format!("{}, and its firmware", info.identity)),
            Ok((Ok(()), false)) => Presence::There(format!(
                "{}; without `firmware` in its driver settings it works only if its firmware runs already",
                info.identity
            )),
        }
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        Ok(Box::new(self.open_falcon(info, settings, log)?))
    }
}
