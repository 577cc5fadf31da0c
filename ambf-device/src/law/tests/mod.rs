//! Laws as a whole, against the formulas of `docs/devices.md` evaluated with matrices.

mod driving;
mod feeling;
mod following;

use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::*;
use crate::{known, DeviceSample, DeviceSpec};
use ambf_model::adf::{self, InputDevice, InputDevices};

/// The only device of a file with these keys beside the required ones.
fn device(keys: &str) -> InputDevice {
    let text = format!("input devices: [D]\nD:\n  hardware name: x\n  root link: l\n{keys}\n");
    let (devices, report) = adf::parse::<InputDevices>(&text, std::path::Path::new("d.yaml")).expect("a file");
    assert_eq!(report.problems().len(), 0, "{:?}", report.problems());
    devices.entries.into_iter().next().flatten().expect("a device")
}

fn spec(model: &str) -> DeviceSpec {
    known::spec(model).expect("a known model")
}

/// A device with its loop and the input of its next tick.
struct Hand {
    device: HapticLoop,
    input: HapticInput,
}

impl Hand {
    fn new(keys: &str, model: &str, root: Isometry3<f64>) -> Self {
        let sample = DeviceSample { valid: true, ..DeviceSample::none(Instant::now()) };
        let view = WorldView { root: Some(root), camera: None, paused: false, stale: false, reset: false };
        let switches = Switches { forces: true, ..Switches::default() };
        Self {
            device: HapticLoop::new(&device(keys), &spec(model), root),
            input: HapticInput { sample, view, time: 0.0, dt: 1e-3, switches },
        }
    }

    /// Ticks with a new sample of what `input` says.
    fn tick(&mut self) -> HapticOutput {
        self.input.time += self.input.dt;
        self.input.sample.sequence += 1;
        self.input.sample.stamp += Duration::from_secs_f64(self.input.dt);
        self.device.tick(&self.input)
    }

    /// The last of the ticks of `seconds`.
    fn run(&mut self, seconds: f64) -> HapticOutput {
        let ticks = (seconds / self.input.dt).round() as u32;
        (0..ticks).map(|_| self.tick()).last().expect("a tick")
    }

    /// Past the start-up hold, with the orientation caught up.
    fn settled(mut self) -> Self {
        self.input.time = 10.0;
        self.run(1.1);
        self
    }

    /// The next tick without a press of `button`, after one with it.
    fn press(&mut self, button: u32) -> HapticOutput {
        self.input.sample.buttons |= 1 << button;
        let output = self.tick();
        self.input.sample.buttons &= !(1 << button);
        output
    }
}

fn matrix(rotation: &nalgebra::UnitQuaternion<f64>) -> Matrix3<f64> {
    *rotation.to_rotation_matrix().matrix()
}

/// Rotation vector of a matrix by its definition; for angles well inside (0, π).
fn log(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let angle = ((rotation.trace() - 1.0) / 2.0).acos();
    let skew = (rotation - rotation.transpose()) / (2.0 * angle.sin());
    Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]) * angle
}

/// How far apart two poses are: m, rad.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
    let turn = rotation_vector(&(a.rotation.inverse() * b.rotation));
    ((a.translation.vector - b.translation.vector).norm(), turn.norm())
}
