//! Razer Hydra: a base on USB that measures two controllers, 250 times a second.

mod device;
mod filter;
mod hidraw;
mod report;
mod streams;

use std::path::PathBuf;

use ambf_device::{DeviceError, DeviceInfo, DeviceLog, Driver, InputDevice, Presence, Settings};
use rustix::fs::Access;

use device::{Hydra, MODEL};
use hidraw::HidRaw;
use streams::Streams;

const CORNER: &str = "corner frequency";
/// Corner frequency of the filters, Hz.
const DEFAULT_CORNER: f64 = 3.0;
/// Half the rate of the reports, Hz, above which a filter has no meaning.
const HIGHEST_CORNER: f64 = 125.0;

/// Driver `hydra`. Both controllers of a base are devices of their own; their identity is the USB port of the base and
/// the number of the controller.
///
/// Settings: `corner frequency` of the low-pass filters, Hz (default: 3; the higher, the faster and the less smooth).
#[derive(Debug, Clone)]
pub struct HydraDriver {
    sys: PathBuf,
    streams: Streams,
}

impl Default for HydraDriver {
    fn default() -> Self {
        Self { sys: PathBuf::from("/sys"), streams: Streams::default() }
    }
}

fn corner(settings: &Settings) -> Result<f64, DeviceError> {
    settings.unknown(&[CORNER])?;
    let expected = "a frequency in Hz, above 0 and below 125";
    let corner = settings.parsed(CORNER, expected)?.unwrap_or(DEFAULT_CORNER);
    if corner > 0.0 && corner < HIGHEST_CORNER {
        Ok(corner)
    } else {
        Err(settings.wrong(CORNER, expected).into())
    }
}

fn identity(port: &str, controller: usize) -> String {
    format!("{port} controller {controller}")
}

impl Driver for HydraDriver {
    fn name(&self) -> &str {
        "hydra"
    }

    fn serves(&self, model: &str) -> bool {
        model == MODEL
    }

    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        corner(settings)?;
        let bases = hidraw::list(&self.sys).into_iter();
        let controllers = bases.flat_map(|(port, _)| [0, 1].map(|controller| identity(&port, controller)));
        Ok(controllers.map(|identity| DeviceInfo { model: model.to_owned(), identity }).collect())
    }

    fn presence(&self, info: &DeviceInfo, _settings: &Settings) -> Presence {
        let bases = hidraw::list(&self.sys);
        let base = bases.iter().find(|(port, _)| [0, 1].iter().any(|one| identity(port, *one) == info.identity));
        let Some((_, path)) = base else { return Presence::NotReady(format!("`{}` is not plugged in", info.identity)) };
        crate::may_open(path, Access::READ_OK | Access::WRITE_OK)
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        _log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        let corner = corner(settings)?;
        let name = &info.identity;
        let bases = hidraw::list(&self.sys);
        let found = bases.iter().find_map(|(port, path)| {
            let controller = (0..2).find(|controller| identity(port, *controller) == *name)?;
            Some((port, path, controller))
        });
        let (port, path, controller) =
            found.ok_or_else(|| DeviceError::Unavailable(format!("`{name}` is not plugged in")))?;
        let stream = self
            .streams
            .join(port, controller)
            .ok_or_else(|| DeviceError::Unavailable(format!("`{name}` is in use already")))?;
        let file = HidRaw::open(path).map_err(|error| {
            DeviceError::Unavailable(format!(
                "`{name}`: {} cannot be opened: {error}; resources/udev has rules that allow it",
                path.display()
            ))
        })?;
        Ok(Box::new(Hydra::start(file, stream, controller, name, corner)?))
    }
}

#[cfg(test)]
mod tests;
