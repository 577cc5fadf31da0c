use std::sync::Arc;

use ambf_device::{DeviceError, DeviceInfo, DeviceLog, Driver, InputDevice, Settings};

use crate::device::FalconDevice;
use crate::fake::{Clock, FakeBus, Setup};
use crate::settings::{config, place, Transport};
use crate::transport::Bus;
use crate::usb::Usb;
use crate::MODEL;

/// The driver of Falcons: on USB, and of two fake ones where settings ask for `transport: fake`.
pub struct FalconDriver {
    usb: Arc<dyn Bus>,
    fake: Arc<dyn Bus>,
}

/// The driver of Falcons.
pub fn driver() -> FalconDriver {
    let fake = FakeBus::new(Clock::real(), [Setup::new("fake-1"), Setup::new("fake-2")]);
    FalconDriver { usb: Arc::new(Usb), fake: Arc::new(fake) }
}

impl FalconDriver {
    /// A driver whose fake devices are on `bus`.
    #[must_use]
    pub fn with_fakes(mut self, bus: Arc<dyn Bus>) -> Self {
        self.fake = bus;
        self
    }

    fn bus(&self, transport: Transport) -> &Arc<dyn Bus> {
        match transport {
            Transport::Usb => &self.usb,
            Transport::Fake => &self.fake,
        }
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
        let (transport, _) = place(settings)?;
        FalconDevice::open(self.bus(transport), &info.identity, config(settings)?, log)
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
        let (transport, port) = place(settings)?;
        if !self.serves(model) {
            return Ok(Vec::new());
        }
        let identities =
            self.bus(transport).list().map_err(|error| DeviceError::Unavailable(format!("Falcon: {error}")))?;
        let wanted = identities.into_iter().filter(|identity| port.is_none_or(|port| port == identity));
        Ok(wanted.map(|identity| DeviceInfo { model: model.to_owned(), identity }).collect())
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
