use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::Instant;

use ambf_device::{DeviceError, DeviceForce, DeviceSample, DeviceSpec, InputDevice};
use evdev::{EventSummary, InputEvent, KeyCode};
use nalgebra::{UnitQuaternion, Vector3};

use super::axes::{Axes, Kind, Map};
use super::find::SPACE_MOUSE;
use super::options::Options;
use crate::tracker;

/// Longer pauses of the host count as this, s: nothing jumps when it goes on.
const MAX_STEP: f64 = 0.02;

/// Buttons of gamepads, from `BTN_SOUTH` on.
const GAMEPAD_BUTTONS: std::ops::Range<u16> = 0x130..0x140;

/// Where events come from: a device file, or a test.
pub(super) trait Events: Send {
    /// Axes as they are now.
    fn axes(&self, now: Instant) -> io::Result<Axes>;

    /// Buttons that there are, in ascending order, and whether they are pressed now.
    fn buttons(&self) -> io::Result<Vec<(KeyCode, bool)>>;

    /// Appends the events that have arrived, without waiting; [`ErrorKind::WouldBlock`] if there are none.
    fn fetch(&mut self, events: &mut Vec<InputEvent>) -> io::Result<()>;
}

/// A device file like `/dev/input/event3`.
pub(super) struct EventFile(evdev::Device);

impl EventFile {
    pub fn open(path: &Path) -> io::Result<Self> {
        let device = evdev::Device::open(path)?;
        device.set_nonblocking(true)?;
        Ok(Self(device))
    }
}

impl Events for EventFile {
    fn axes(&self, now: Instant) -> io::Result<Axes> {
        let mut axes = Axes::default();
        if self.0.supported_absolute_axes().is_some() {
            for (code, range) in self.0.get_absinfo()? {
                axes.add_absolute(code, range.value(), range.minimum(), range.maximum());
            }
        }
        for code in self.0.supported_relative_axes().into_iter().flat_map(|codes| codes.iter()) {
            axes.add_relative(code, now);
        }
        Ok(axes)
    }

    fn buttons(&self) -> io::Result<Vec<(KeyCode, bool)>> {
        let pressed = self.0.get_key_state()?;
        let keys = self.0.supported_keys().into_iter().flat_map(|keys| keys.iter());
        Ok(keys.map(|key| (key, pressed.contains(key))).collect())
    }

    fn fetch(&mut self, events: &mut Vec<InputEvent>) -> io::Result<()> {
        events.extend(self.0.fetch_events()?);
        Ok(())
    }
}

/// A joystick, gamepad or SpaceMouse.
pub(super) struct Joystick<E: Events> {
    /// `None` once it was closed.
    events: Option<E>,
    name: String,
    options: Options,
    map: Map,
    axes: Axes,
    /// Bit of each button.
    buttons: Vec<KeyCode>,
    spec: DeviceSpec,
    sample: DeviceSample,
    arrived: Vec<InputEvent>,
}

impl<E: Events> Joystick<E> {
    /// Reads where everything is.
    ///
    /// # Errors
    /// When the device cannot be asked.
    pub fn new(events: E, model: &str, name: &str, options: Options) -> Result<Self, DeviceError> {
        let now = Instant::now();
        let asked = events.axes(now).and_then(|axes| Ok((axes, events.buttons()?)));
        let (axes, buttons) =
            asked.map_err(|error| DeviceError::Unavailable(format!("`{name}` does not say what it has: {error}")))?;
        let gamepad = buttons.iter().any(|(button, _)| GAMEPAD_BUTTONS.contains(&button.0));
        let kind = match model {
            SPACE_MOUSE => Kind::SpaceMouse,
            _ if gamepad => Kind::Gamepad,
            _ => Kind::Joystick,
        };
        let mut sample = DeviceSample { valid: true, ..DeviceSample::none(now) };
        for (bit, (_, pressed)) in buttons.iter().enumerate().take(32) {
            sample.buttons |= u32::from(*pressed) << bit;
        }
        Ok(Self {
            events: Some(events),
            name: name.to_owned(),
            options,
            map: options.map.unwrap_or_else(|| Map::suiting(&axes, kind)),
            axes,
            buttons: buttons.into_iter().map(|(button, _)| button).take(32).collect(),
            spec: spec(model, options.gripper.is_some()),
            sample,
            arrived: Vec::with_capacity(64),
        })
    }

    fn lost(&self, why: impl std::fmt::Display) -> DeviceError {
        DeviceError::Lost(format!("`{}` is lost: {why}", self.name))
    }

    fn take_events(&mut self, now: Instant) -> Result<(), DeviceError> {
        let Some(events) = &mut self.events else { return Err(self.lost("it is closed")) };
        self.arrived.clear();
        match events.fetch(&mut self.arrived) {
            Ok(()) => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(error) => return Err(self.lost(error)),
        }
        for event in &self.arrived {
            match event.destructure() {
                EventSummary::AbsoluteAxis(_, code, value) => self.axes.set_absolute(code, value),
                EventSummary::RelativeAxis(_, code, value) => self.axes.set_relative(code, value, now),
                EventSummary::Key(_, code, value) => {
                    if let Some(bit) = self.buttons.iter().position(|button| *button == code) {
                        let mask = 1 << bit;
                        // 2 repeats what is pressed.
                        self.sample.buttons =
                            if value == 0 { self.sample.buttons & !mask } else { self.sample.buttons | mask };
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }
}

fn spec(model: &str, gripper: bool) -> DeviceSpec {
    let sensed = ambf_device::Axes { position: true, rotation: true, gripper };
    DeviceSpec { workspace_radius: 0.1, sensed, ..tracker(model) }
}

impl<E: Events> InputDevice for Joystick<E> {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        let now = Instant::now();
        self.take_events(now)?;
        let deflection = self.map.apply(&self.axes, self.options.dead_zone, now);
        let linear = Vector3::from_column_slice(&deflection[..3]) * self.options.speed;
        let angular = Vector3::from_column_slice(&deflection[3..]) * self.options.turn;
        let sample = &mut self.sample;
        if self.options.rates {
            let dt = now.saturating_duration_since(sample.stamp).as_secs_f64().min(MAX_STEP);
            sample.position += linear * dt;
            sample.rotation = UnitQuaternion::from_scaled_axis(angular * dt) * sample.rotation;
            // Small steps add up to a quaternion that is no longer of length one.
            sample.rotation.renormalize();
            sample.linear_velocity = Some(linear);
            sample.angular_velocity = Some(angular);
        } else {
            sample.position = linear;
            sample.rotation = UnitQuaternion::from_scaled_axis(angular);
        }
        sample.gripper = self
            .options
            .gripper
            .map(|(code, sign)| (0.5 - 0.5 * sign * self.axes.deflection(code, now)).clamp(0.0, 1.0));
        sample.stamp = now;
        sample.sequence += 1;
        Ok(*sample)
    }

    fn write(&mut self, _force: &DeviceForce) -> Result<(), DeviceError> {
        // There is nothing that could move.
        Ok(())
    }

    fn close(&mut self) {
        self.events = None;
    }
}
