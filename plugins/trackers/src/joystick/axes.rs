//! Axes of an input device: how far each is deflected, and which of them moves what.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use evdev::{AbsoluteAxisCode, RelativeAxisCode};

/// Names of axes, with their codes; relative axes have the same numbers as far as they have these names.
const NAMES: [(&str, AbsoluteAxisCode); 15] = [
    ("x", AbsoluteAxisCode::ABS_X),
    ("y", AbsoluteAxisCode::ABS_Y),
    ("z", AbsoluteAxisCode::ABS_Z),
    ("rx", AbsoluteAxisCode::ABS_RX),
    ("ry", AbsoluteAxisCode::ABS_RY),
    ("rz", AbsoluteAxisCode::ABS_RZ),
    ("throttle", AbsoluteAxisCode::ABS_THROTTLE),
    ("rudder", AbsoluteAxisCode::ABS_RUDDER),
    ("wheel", AbsoluteAxisCode::ABS_WHEEL),
    ("gas", AbsoluteAxisCode::ABS_GAS),
    ("brake", AbsoluteAxisCode::ABS_BRAKE),
    ("hat0x", AbsoluteAxisCode::ABS_HAT0X),
    ("hat0y", AbsoluteAxisCode::ABS_HAT0Y),
    ("hat1x", AbsoluteAxisCode::ABS_HAT1X),
    ("hat1y", AbsoluteAxisCode::ABS_HAT1Y),
];

/// Deflection of a relative axis that counts as full: what a SpaceMouse reports at its stop.
const RELATIVE_FULL: f64 = 350.0;
/// A SpaceMouse repeats what is deflected every 16 ms or faster; that an axis is back in the middle is not told.
const RELATIVE_HOLD: Duration = Duration::from_millis(60);

/// Code of an axis by name.
pub(super) fn code(name: &str) -> Option<u16> {
    NAMES.iter().find(|(known, _)| *known == name).map(|(_, code)| code.0)
}

/// Names of all axes.
pub(super) fn names() -> String {
    NAMES.map(|(name, _)| name).join(" ")
}

/// Where one axis is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Axis {
    Absolute { value: i32, minimum: i32, maximum: i32 },
    Relative { value: i32, stamp: Instant },
}

/// Where all axes of a device are.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Axes(BTreeMap<u16, Axis>);

impl Axes {
    /// Adds an absolute axis; one without range is left out.
    pub fn add_absolute(&mut self, code: AbsoluteAxisCode, value: i32, minimum: i32, maximum: i32) {
        if minimum < maximum {
            self.0.insert(code.0, Axis::Absolute { value, minimum, maximum });
        }
    }

    /// Adds a relative axis.
    pub fn add_relative(&mut self, code: RelativeAxisCode, now: Instant) {
        if code.0 <= RelativeAxisCode::REL_RZ.0 {
            self.0.entry(code.0).or_insert(Axis::Relative { value: 0, stamp: now });
        }
    }

    pub fn has(&self, code: AbsoluteAxisCode) -> bool {
        self.0.contains_key(&code.0)
    }

    pub fn set_absolute(&mut self, code: AbsoluteAxisCode, new: i32) {
        if let Some(Axis::Absolute { value, .. }) = self.0.get_mut(&code.0) {
            *value = new;
        }
    }

    pub fn set_relative(&mut self, code: RelativeAxisCode, new: i32, now: Instant) {
        if let Some(Axis::Relative { value, stamp }) = self.0.get_mut(&code.0) {
            (*value, *stamp) = (new, now);
        }
    }

    /// −1 … 1; 0 for an axis that there is none of.
    pub fn deflection(&self, code: u16, now: Instant) -> f64 {
        match self.0.get(&code) {
            Some(Axis::Absolute { value, minimum, maximum }) => {
                let (low, high) = (f64::from(*minimum), f64::from(*maximum));
                ((2.0 * f64::from(*value) - low - high) / (high - low)).clamp(-1.0, 1.0)
            }
            Some(Axis::Relative { value, stamp }) if now.saturating_duration_since(*stamp) <= RELATIVE_HOLD => {
                (f64::from(*value) / RELATIVE_FULL).clamp(-1.0, 1.0)
            }
            _ => 0.0,
        }
    }
}

/// Deflection without a part around the middle, `zone` of the whole; full deflection stays full.
pub(super) fn outside_dead_zone(deflection: f64, zone: f64) -> f64 {
    let beyond = (deflection.abs() - zone).max(0.0) / (1.0 - zone);
    beyond.copysign(deflection)
}

/// An axis with a sign, or none.
pub(super) type Source = Option<(u16, f64)>;

/// What a device is held like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    SpaceMouse,
    Gamepad,
    Joystick,
}

/// Which axis moves what: x, y, z, and turns about x, y, z of the frame of devices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Map(pub [Source; 6]);

impl Map {
    /// A map as in `y x -ry 0 0 -rx`; `None` for another text.
    pub fn parse(text: &str) -> Option<Self> {
        let sources: Option<Vec<Source>> = text
            .split([' ', ','])
            .filter(|word| !word.is_empty())
            .map(|word| match word {
                "0" => Some(None),
                _ => Some(Some(source(word)?)),
            })
            .collect();
        sources?.try_into().ok().map(Self)
    }

    /// What suits a device. SpaceMouse: its axes are to the right, towards the user, and down. Others: the first stick
    /// moves in the plane; a second stick, or hat and twist, moves up and down and turns about the vertical. Where the
    /// second stick has no axes of its own, gamepads use those which are throttle and twist of a joystick.
    pub fn suiting(axes: &Axes, kind: Kind) -> Self {
        let text = match kind {
            Kind::SpaceMouse => "y x -z ry rx -rz",
            Kind::Gamepad if axes.has(AbsoluteAxisCode::ABS_RX) => "y x -ry 0 0 -rx",
            Kind::Gamepad => "y x -rz 0 0 -z",
            Kind::Joystick => "y x -hat0y 0 0 -rz",
        };
        Self::parse(text).unwrap_or(Self([None; 6]))
    }

    /// Deflections that belong to x, y, z and the turns about them.
    pub fn apply(&self, axes: &Axes, zone: f64, now: Instant) -> [f64; 6] {
        self.0
            .map(|source| source.map_or(0.0, |(code, sign)| sign * outside_dead_zone(axes.deflection(code, now), zone)))
    }
}

/// An axis with or without a minus.
pub(super) fn source(word: &str) -> Option<(u16, f64)> {
    match word.strip_prefix('-') {
        Some(name) => Some((code(name)?, -1.0)),
        None => Some((code(word)?, 1.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deflection_is_between_minus_one_and_one() {
        let now = Instant::now();
        let mut axes = Axes::default();
        axes.add_absolute(AbsoluteAxisCode::ABS_X, 0, 0, 255);
        axes.add_absolute(AbsoluteAxisCode::ABS_Y, 7, 7, 7);
        assert_eq!(axes.deflection(0, now), -1.0);
        axes.set_absolute(AbsoluteAxisCode::ABS_X, 255);
        assert_eq!(axes.deflection(0, now), 1.0);
        axes.set_absolute(AbsoluteAxisCode::ABS_X, 100_000);
        assert_eq!(axes.deflection(0, now), 1.0);
        axes.add_absolute(AbsoluteAxisCode::ABS_Z, i32::MAX, i32::MIN, i32::MAX);
        assert_eq!(axes.deflection(2, now), 1.0);
        assert!(!axes.has(AbsoluteAxisCode::ABS_Y) && axes.deflection(1, now) == 0.0, "an axis without range");
    }

    #[test]
    fn relative_axes_return_to_the_middle_by_themselves() {
        let now = Instant::now();
        let mut axes = Axes::default();
        axes.add_relative(RelativeAxisCode::REL_X, now);
        axes.set_relative(RelativeAxisCode::REL_X, -175, now);
        assert_eq!(axes.deflection(0, now + Duration::from_millis(20)), -0.5);
        assert_eq!(axes.deflection(0, now + Duration::from_millis(61)), 0.0);
    }

    #[test]
    fn the_dead_zone_begins_at_zero_and_ends_at_full() {
        let outside = [0.05, 0.1, 0.55, 1.0, -1.0].map(|deflection| outside_dead_zone(deflection, 0.1));
        assert!(outside.iter().zip([0.0, 0.0, 0.5, 1.0, -1.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{outside:?}");
    }

    #[test]
    fn maps_are_six_axes() {
        let map = Map::parse("y x, -rz 0 0 hat0x").unwrap();
        assert_eq!(map.0, [Some((1, 1.0)), Some((0, 1.0)), Some((5, -1.0)), None, None, Some((16, 1.0))]);
        assert!(["", "x y z", "x y z rx ry rz x", "x y z rx ry up", "x y z rx ry --rz"]
            .iter()
            .all(|text| Map::parse(text).is_none()));
    }

    #[test]
    fn a_space_mouse_moves_as_its_cap() {
        // Pulled towards the user, turned clockwise as seen from above.
        let now = Instant::now();
        let mut axes = Axes::default();
        for code in 0..6 {
            axes.add_relative(RelativeAxisCode(code), now);
        }
        axes.set_relative(RelativeAxisCode::REL_Y, 350, now);
        axes.set_relative(RelativeAxisCode::REL_RZ, 350, now);
        let moved = Map::suiting(&axes, Kind::SpaceMouse).apply(&axes, 0.0, now);
        assert_eq!(moved, [1.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
    }

    #[test]
    fn second_sticks_are_where_the_device_has_them() {
        let z = |codes: &[u16], kind| {
            let mut axes = Axes::default();
            codes.iter().for_each(|code| axes.add_absolute(AbsoluteAxisCode(*code), 0, -1, 1));
            Map::suiting(&axes, kind).0[2]
        };
        assert_eq!(z(&[0, 1, 2, 3, 4, 5], Kind::Gamepad), Some((4, -1.0)));
        assert_eq!(z(&[0, 1, 2, 5], Kind::Gamepad), Some((5, -1.0)));
        assert_eq!(z(&[0, 1, 2, 5, 17], Kind::Joystick), Some((17, -1.0)), "not the throttle");
    }
}
