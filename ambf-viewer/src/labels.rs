//! Texts in a window: what they say, and how they are drawn.

use std::time::{Duration, Instant};

use egui::{Align2, Color32, FontId, Pos2, Vec2};

/// Height of the texts, pixels of the frame buffer.
const HEIGHT: f32 = 20.0;
/// Height of smaller texts.
const SMALL: f32 = 0.8 * HEIGHT;

/// A device as a window shows it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DeviceLabel {
    pub name: String,
    pub model: String,
    /// Ticks of its loop, Hz.
    pub rate: f64,
}

/// What the texts of a window say.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Labels {
    /// Frames and physics iterations in the last full second, Hz.
    pub graphics: u32,
    pub physics: f64,
    /// s.
    pub wall_time: f64,
    pub sim_time: f64,
    pub mode: &'static str,
    pub action: String,
    /// Named by the camera's description.
    pub controlling: Vec<String>,
    /// Paired with the camera.
    pub devices: Vec<DeviceLabel>,
    pub paused: bool,
}

impl Labels {
    pub fn rates(&self) -> String {
        format!("Gfx ({} Hz) / Phx ({:.0} Hz)", self.graphics, self.physics)
    }

    pub fn times(&self) -> String {
        format!("Wall Time: {:.2} s / Sim Time: {:.2} s", self.wall_time, self.sim_time)
    }

    pub fn mode(&self) -> String {
        format!("MODE: {}", self.mode)
    }

    pub fn action(&self) -> String {
        if self.action.is_empty() {
            String::new()
        } else {
            format!(" : {}", self.action)
        }
    }

    /// Names from the description first, then those of paired devices that it does not name.
    pub fn controlling(&self) -> String {
        let paired = self.devices.iter().map(|device| &device.name).filter(|name| !self.controlling.contains(name));
        let names: String = self.controlling.iter().chain(paired).map(|name| format!("{name} <> ")).collect();
        match names.is_empty() {
            true => "Controlling Devices: [ ]".into(),
            false => format!("Controlling Devices: [ {names} ]"),
        }
    }

    pub fn device(device: &DeviceLabel) -> String {
        format!("{} [{}] : {:.0} Hz", device.name, device.model, device.rate)
    }

    /// Draws the texts into a window of `size` pixels; `scale` is pixels a point of egui.
    pub fn paint(&self, painter: &egui::Painter, size: (u32, u32), scale: f32) {
        let (width, height) = (size.0 as f32, size.1 as f32);
        // From pixels above the lower left corner.
        let at = |x: f32, y: f32| Pos2::new(x / scale, (height - y) / scale);
        let font = |pixels: f32| FontId::proportional(pixels / scale);
        let centred = |y: f32, text: String, pixels: f32| {
            painter.text(at(width / 2.0, y), Align2::CENTER_BOTTOM, text, font(pixels), Color32::BLACK)
        };
        centred(10.0, self.rates(), HEIGHT);
        centred(30.0, self.times(), HEIGHT);
        let mode = centred(50.0, self.mode(), HEIGHT);
        painter.text(mode.right_bottom(), Align2::LEFT_BOTTOM, self.action(), font(HEIGHT), Color32::BLACK);
        centred(height - 20.0, self.controlling(), SMALL);
        for (i, device) in self.devices.iter().enumerate() {
            let place = at(10.0, height - 20.0 * (i + 1) as f32);
            let lime = Color32::from_rgb(0, 255, 0);
            painter.text(place, Align2::LEFT_BOTTOM, Self::device(device), font(SMALL), lime);
        }
        if self.paused {
            let place = at(width - 10.0, height - 20.0) + Vec2::ZERO;
            painter.text(place, Align2::RIGHT_BOTTOM, "PAUSED", font(SMALL), Color32::BLACK);
        }
    }
}

/// Counts what happened in the last full second.
#[derive(Debug)]
pub(crate) struct Counter {
    start: Instant,
    events: u32,
    last: u32,
}

impl Counter {
    pub fn new(now: Instant) -> Self {
        Self { start: now, events: 0, last: 0 }
    }

    pub fn count(&mut self, now: Instant) {
        self.events += 1;
        let open = now.saturating_duration_since(self.start);
        if open >= Duration::from_secs(1) {
            self.last = (f64::from(self.events) / open.as_secs_f64()).round() as u32;
            (self.start, self.events) = (now, 0);
        }
    }

    /// Hz; 0 in the first second.
    pub fn rate(&self) -> u32 {
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> Labels {
        Labels {
            graphics: 60,
            physics: 999.6,
            wall_time: 12.345,
            sim_time: 1.0,
            mode: "CAM_CLUTCH_CONTROL",
            ..Labels::default()
        }
    }

    #[test]
    fn row_64_texts_are_those_of_the_cxx_program() {
        let mut labels = labels();
        assert_eq!(labels.rates(), "Gfx (60 Hz) / Phx (1000 Hz)");
        assert_eq!(labels.times(), "Wall Time: 12.35 s / Sim Time: 1.00 s");
        assert_eq!((labels.mode(), labels.action()), ("MODE: CAM_CLUTCH_CONTROL".into(), String::new()));
        assert_eq!(labels.controlling(), "Controlling Devices: [ ]");
        labels.action = "D_ac = 0.1000".into();
        assert_eq!(labels.action(), " : D_ac = 0.1000");
        labels.controlling = vec!["A".into(), "B".into()];
        assert_eq!(labels.controlling(), "Controlling Devices: [ A <> B <>  ]");
        let device = |name: &str| DeviceLabel { name: name.into(), model: "Touch".into(), rate: 1000.4 };
        labels.devices = vec![device("B"), device("C")];
        assert_eq!(labels.controlling(), "Controlling Devices: [ A <> B <> C <>  ]", "each once");
        assert_eq!(Labels::device(&labels.devices[1]), "C [Touch] : 1000 Hz");
    }

    #[test]
    fn rates_are_those_of_full_seconds() {
        let begin = Instant::now();
        let mut counter = Counter::new(begin);
        for ms in (0..=2500).step_by(10) {
            assert!(ms >= 1000 || counter.rate() == 0);
            counter.count(begin + Duration::from_millis(ms));
        }
        assert!((100..=101).contains(&counter.rate()), "{}", counter.rate());
    }
}
