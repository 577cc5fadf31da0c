//! How an arm is used: options for programs, settings in device files.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use ambf_device::text::lines;
use ambf_device::{DeviceError, DeviceLog, Settings};
use nalgebra::Isometry3;

use crate::dialect::{Dialect, DialectChoice};
use crate::frames::{isometry, Frames};
use crate::pedals::ClutchSource;

/// Where an arm says what its user should know, a sentence at a time; called from any thread.
pub type Say = Arc<dyn Fn(&str) + Send + Sync>;

/// How an arm is used.
#[derive(Clone)]
pub struct ArmOptions {
    /// Name of the arm as in its topics; `None`: the name it is connected by.
    pub arm: Option<String>,
    /// Dialects that may be found. Default: any.
    pub dialect: DialectChoice,
    /// Namespace of arms and pedals. Default: `/dvrk` for the legacy dialect, none for the others.
    pub namespace: Option<String>,
    /// Which pedal message is the clutch. Default: the pedal's.
    pub clutch_source: ClutchSource,
    /// Whether torques are sent; otherwise they are zero, as in the original. Default: `false`.
    pub send_torque: bool,
    /// Whether the arm is told to enable itself when it is not. Default: `false`.
    pub enable: bool,
    /// Whether the arm is told to home itself when it is not, **which moves it**. Default: `false`.
    pub home: bool,
    /// Angles of the closed and the open gripper, rad. Default: 0 and 60° in the dialects of CRTK, ±60° in the others.
    pub gripper: Option<(f64, f64)>,
    /// Frames. Default: [`Frames::of`].
    pub frames: Option<Frames>,
    /// How old a pose may be before the arm counts as away. Default: 0.2 s.
    pub timeout: Duration,
    /// Whether topics of motion commands are announced; a device needs none. Default: `true`.
    pub motion: bool,
    /// Where sentences for the user go. Default: standard error.
    pub say: Say,
}

impl Default for ArmOptions {
    fn default() -> Self {
        Self {
            arm: None,
            dialect: DialectChoice::Auto,
            namespace: None,
            clutch_source: ClutchSource::Pedal,
            send_torque: false,
            enable: false,
            home: false,
            gripper: None,
            frames: None,
            timeout: Duration::from_millis(200),
            motion: true,
            say: Arc::new(|sentence| eprintln!("{}", lines(sentence))),
        }
    }
}

impl fmt::Debug for ArmOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ArmOptions").field("arm", &self.arm).field("dialect", &self.dialect).finish_non_exhaustive()
    }
}

/// Keys of [`ArmOptions::from_settings`].
pub const SETTINGS: &[&str] = &[
    "arm",
    "clutch_source",
    "dialect",
    "enable",
    "gripper_closed",
    "gripper_open",
    "home",
    "namespace",
    "origin",
    "send_torque",
    "timeout",
    "tip",
];

impl ArmOptions {
    /// Options from `driver settings` of a device file; `docs/dvrk.md` lists them.
    ///
    /// # Errors
    /// [`DeviceError::Setting`] for a key that is not among [`SETTINGS`] and a value of no use.
    pub fn from_settings(model: &str, settings: &Settings) -> Result<Self, DeviceError> {
        settings.unknown(SETTINGS)?;
        let text = |key| settings.text(key).map(|text: &str| text.trim().to_owned());
        let dialect = choice(
            settings,
            "dialect",
            &[
                ("auto", DialectChoice::Auto),
                ("legacy", DialectChoice::Legacy),
                ("ambf", DialectChoice::Ambf),
                ("crtk", DialectChoice::Crtk),
            ],
        )?;
        let sources = [("pedal", ClutchSource::Pedal), ("console", ClutchSource::Console)];
        let gripper = match (finite(settings, "gripper_closed")?, finite(settings, "gripper_open")?) {
            (None, None) => None,
            (Some(closed), Some(open)) if closed < open => Some((closed, open)),
            (Some(_), None) => return Err(settings.wrong("gripper_closed", "together with gripper_open").into()),
            _ => return Err(settings.wrong("gripper_open", "an angle in rad larger than gripper_closed").into()),
        };
        let arm = text("arm").unwrap_or_else(|| model.to_owned());
        let usual = Frames::of(&arm);
        let frames = Frames {
            origin: pose(settings, "origin")?.unwrap_or(usual.origin),
            tip: pose(settings, "tip")?.unwrap_or(usual.tip),
        };
        let timeout = finite(settings, "timeout")?.unwrap_or(0.2);
        if !(0.01..=10.0).contains(&timeout) {
            return Err(settings.wrong("timeout", "0.01 to 10 s").into());
        }
        let home = settings.boolean("home")?.unwrap_or(false);
        Ok(Self {
            arm: Some(arm),
            dialect: dialect.unwrap_or_default(),
            namespace: text("namespace"),
            clutch_source: choice(settings, "clutch_source", &sources)?.unwrap_or_default(),
            send_torque: settings.boolean("send_torque")?.unwrap_or(false),
            enable: settings.boolean("enable")?.unwrap_or(home),
            home,
            gripper,
            frames: Some(frames),
            timeout: Duration::from_secs_f64(timeout),
            ..Self::default()
        })
    }

    /// The same, with sentences going to a device's log.
    pub(crate) fn with_log(self, log: &DeviceLog) -> Self {
        let log = log.clone();
        Self { say: Arc::new(move |sentence| log.say(sentence)), ..self }
    }

    /// Angles of the closed and the open gripper, rad.
    pub(crate) fn gripper_range(&self, dialect: Dialect) -> (f64, f64) {
        let most = f64::to_radians(60.0);
        self.gripper.unwrap_or(if dialect.is_crtk() { (0.0, most) } else { (-most, most) })
    }
}

fn choice<T: Copy>(settings: &Settings, key: &str, choices: &[(&str, T)]) -> Result<Option<T>, DeviceError> {
    let Some(text) = settings.text(key) else { return Ok(None) };
    let found = choices.iter().find(|(name, _)| text.trim().eq_ignore_ascii_case(name));
    let names = || choices.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
    found.map(|&(_, value)| Some(value)).ok_or_else(|| settings.wrong(key, &format!("one of {}", names())).into())
}

fn finite(settings: &Settings, key: &str) -> Result<Option<f64>, DeviceError> {
    match settings.parsed::<f64>(key, "a number")? {
        Some(number) if !number.is_finite() => Err(settings.wrong(key, "a finite number").into()),
        number => Ok(number),
    }
}

/// Six numbers, apart by spaces or commas: x y z in m, roll pitch yaw in rad.
fn pose(settings: &Settings, key: &str) -> Result<Option<Isometry3<f64>>, DeviceError> {
    let Some(text) = settings.text(key) else { return Ok(None) };
    let parts = text.split([' ', ',', '[', ']']).filter(|part| !part.is_empty());
    let numbers: Result<Vec<f64>, _> = parts.map(f64::from_str).collect();
    match numbers.ok().and_then(|numbers| <[f64; 6]>::try_from(numbers).ok()) {
        Some(numbers) if numbers.iter().all(|x| x.is_finite()) => Ok(Some(isometry(numbers))),
        _ => Err(settings.wrong(key, "six numbers: x y z in m, roll pitch yaw in rad").into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_device::Setting;

    fn options(entries: &[(&str, &str)]) -> Result<ArmOptions, DeviceError> {
        let entry = |(key, value): &(&str, &str)| {
            ((*key).to_owned(), Setting { value: (*value).to_owned(), place: "devices.yaml:7".into() })
        };
        ArmOptions::from_settings("MTMR", &Settings::new(entries.iter().map(entry).collect(), ".".into()))
    }

    #[test]
    fn settings_have_defaults() {
        let options = options(&[]).unwrap();
        assert_eq!(options.arm.as_deref(), Some("MTMR"));
        assert!(!options.home && !options.enable && !options.send_torque);
        assert_eq!(options.frames, Some(Frames::of("MTMR")));
        let degrees = |dialect| {
            let (closed, open) = options.gripper_range(dialect);
            (closed.to_degrees().round(), open.to_degrees().round())
        };
        assert_eq!((degrees(Dialect::CrtkPose), degrees(Dialect::Ambf)), ((0.0, 60.0), (-60.0, 60.0)));
    }

    #[test]
    fn settings_are_read() {
        let list = [
            ("arm", "MTML2"),
            ("dialect", "CRTK"),
            ("namespace", "lab"),
            ("clutch_source", "console"),
            ("home", "yes"),
            ("gripper_closed", "0.1"),
            ("gripper_open", "0.9"),
            ("tip", "0 0 0.1, 0 0 0"),
        ];
        let options = options(&list).unwrap();
        assert_eq!((options.dialect, options.clutch_source), (DialectChoice::Crtk, ClutchSource::Console));
        assert!(options.home && options.enable, "homing needs power");
        assert_eq!(options.gripper, Some((0.1, 0.9)));
        let frames = options.frames.unwrap();
        assert_eq!((frames.origin, frames.tip.translation.z), (Frames::of("MTML").origin, 0.1));
    }

    #[test]
    fn settings_of_no_use_say_where() {
        for (list, word) in [
            (&[("dialekt", "auto")][..], "dialect"),
            (&[("dialect", "french")], "legacy"),
            (&[("gripper_open", "1")], "gripper_closed"),
            (&[("gripper_closed", "1"), ("gripper_open", "0")], "larger"),
            (&[("origin", "1 2 3")], "six numbers"),
            (&[("tip", "0 0 0 0 0 NaN")], "six numbers"),
            (&[("timeout", "inf")], "finite"),
            (&[("timeout", "-1")], "0.01"),
            (&[("home", "perhaps")], "true or false"),
        ] {
            let error = options(list).unwrap_err().to_string();
            assert!(error.starts_with("devices.yaml:7: ") && error.contains(word), "{error}");
        }
    }
}
