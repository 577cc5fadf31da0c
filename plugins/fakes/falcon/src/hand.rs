use std::f64::consts::TAU;
use std::fmt;
use std::sync::Arc;
use std::time::Instant;

use falcon::kinematics::{self, to_base};
use nalgebra::Vector3;

/// Step of the hand's motion, s.
const STEP: f64 = 1e-4;
/// Longest time that is caught up with, s: nobody touched the device meanwhile.
const LONGEST: f64 = 1.0;
/// Distance of the device frame's origin from the base, m.
const Z0: f64 = 0.125;

/// What a hand is about to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aim {
    /// Where it wants the grip, m, in the device frame.
    pub position: Vector3<f64>,
    /// Buttons of the grip as the device numbers them: 1 right, 2 front, 4 centre, 8 left.
    pub grip: u8,
}

/// What a hand does in the course of time, s.
pub type Script = Arc<dyn Fn(f64) -> Aim + Send + Sync>;

/// How a hand gives way: a mass held by a spring and a damper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Softness {
    /// kg.
    pub mass: f64,
    /// N/m.
    pub stiffness: f64,
    /// N·s/m.
    pub damping: f64,
}

/// A hand that holds the grip.
#[derive(Clone)]
pub struct Hand {
    script: Script,
    softness: Option<Softness>,
    begin: Instant,
    /// Time of the state, s since the beginning.
    time: f64,
    /// In the device frame, m and m/s.
    position: Vector3<f64>,
    velocity: Vector3<f64>,
}

impl fmt::Debug for Hand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Hand")
            .field("softness", &self.softness)
            .field("position", &self.position)
            .finish_non_exhaustive()
    }
}

impl Hand {
    /// A hand that follows its script whatever pushes it.
    pub fn firm(script: Script) -> Self {
        let now = Instant::now();
        let position = script(0.0).position;
        Self { script, softness: None, begin: now, time: 0.0, position, velocity: Vector3::zeros() }
    }

    /// A hand that gives way to forces.
    pub fn soft(script: Script, softness: Softness) -> Self {
        Self { softness: Some(softness), ..Self::firm(script) }
    }

    /// A hand that pulls the grip out and pushes it in, which homes the device within 2 s, then moves it in a circle of
    /// 2 cm every 4 s and presses the centre button for a moment on each round.
    pub fn circling() -> Self {
        let script = |time: f64| {
            let out = if time < 2.0 { 0.03 * (TAU * time).sin() } else { 0.0 };
            let angle = TAU * (time - 2.0).max(0.0) / 4.0;
            let position = Vector3::new(out, 0.02 * angle.sin(), 0.02 * (1.0 - angle.cos()));
            Aim { position, grip: if angle % TAU > TAU * 0.9 { 0x4 } else { 0 } }
        };
        Self::soft(Arc::new(script), Softness { mass: 0.1, stiffness: 300.0, damping: 8.0 })
    }

    /// Lets the script begin at `now`.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.begin = now;
        self.time = 0.0;
        self.position = (self.script)(0.0).position;
        self.velocity = Vector3::zeros();
    }

    /// Moves on to `now` while the motors have these values.
    pub(crate) fn advance(&mut self, now: Instant, motors: [i16; 3]) {
        let end = now.saturating_duration_since(self.begin).as_secs_f64();
        let Some(softness) = self.softness else {
            self.time = end;
            self.position = (self.script)(end).position;
            return;
        };
        self.time = self.time.max(end - LONGEST);
        let torques = kinematics::motor_torques(motors);
        while self.time < end {
            let dt = STEP.min(end - self.time);
            let aim = (self.script)(self.time + dt).position;
            let aim_velocity = (aim - (self.script)(self.time).position) / dt;
            let pushed =
                kinematics::force(&self.base(), &torques).map_or_else(Vector3::zeros, |f| Vector3::new(f.z, f.x, f.y));
            let held = softness.stiffness * (aim - self.position) + softness.damping * (aim_velocity - self.velocity);
            self.velocity += (held + pushed) / softness.mass * dt;
            let before = self.position;
            self.position += self.velocity * dt;
            if kinematics::inverse(&self.base()).is_none() {
                // The end of the mechanism.
                (self.position, self.velocity) = (before, Vector3::zeros());
            }
            self.time += dt;
        }
    }

    /// Where the grip is, m, in the base frame.
    fn base(&self) -> Vector3<f64> {
        to_base(&self.position) + Vector3::new(0.0, 0.0, Z0)
    }

    /// Where the grip is, m, in the device frame.
    pub fn position(&self) -> Vector3<f64> {
        self.position
    }

    /// How fast a soft hand moves, m/s.
    pub fn velocity(&self) -> Vector3<f64> {
        self.velocity
    }

    /// What it is about to do.
    pub fn aim(&self) -> Aim {
        (self.script)(self.time)
    }

    /// True encoders, counts; `None` where the grip can't be.
    pub(crate) fn counts(&self) -> Option<[i16; 3]> {
        kinematics::inverse(&self.base())
            .map(|angles| <[f64; 3]>::from(angles.map(kinematics::counts)).map(|n| n.round() as i16))
    }
}
