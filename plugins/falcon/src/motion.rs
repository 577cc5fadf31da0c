use std::time::{Duration, Instant};

use ambf_device::DeviceSample;
use nalgebra::Vector3;

use crate::kinematics::{self, to_base, to_device, Solver};
use crate::packet::{Command, Led, Reply};

/// A force that was not renewed for so long is not sent any more.
const STALE: Duration = Duration::from_millis(50);
/// Forces grow from zero to what they should be in this time after homing and after silence.
const RAMP: Duration = Duration::from_secs(1);

/// Counts that an encoder may turn between two replies, and for each ms between them: about 1 m/s at the grip. Packets
/// have no check sum, so what turns further must be confirmed by the next reply. What passes unseen is less than 2 mm.
const JUMP: f64 = 20.0;
const JUMP_PER_MS: f64 = 30.0;

/// A force and when it was asked for, N, in the device frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub force: Vector3<f64>,
    pub since: Instant,
}

/// What is known of the grip, and which forces it may feel. Has no clock and no device.
#[derive(Debug)]
pub(crate) struct Motion {
    z0: f64,
    solver: Solver,
    sample: DeviceSample,
    /// Replies since all encoders were homed. The coordinates jump with the first.
    homed: u32,
    /// Encoders as believed and when, and others that wait to be confirmed.
    believed: Option<([i16; 3], Instant)>,
    doubted: Option<([i16; 3], Instant)>,
    /// Since when forces are allowed.
    ramp: Option<Instant>,
}

impl Motion {
    pub fn new(z0: f64, now: Instant) -> Self {
        let sample = DeviceSample::none(now);
        Self { z0, solver: Solver::default(), sample, homed: 0, believed: None, doubted: None, ramp: None }
    }

    /// The newest sample.
    pub fn sample(&self) -> &DeviceSample {
        &self.sample
    }

    /// Whether all encoders have passed their marks.
    pub fn is_homed(&self) -> bool {
        self.homed > 0
    }

    /// The device was not heard: nothing is valid, and forces begin from zero again.
    pub fn silent(&mut self) {
        self.sample.valid = false;
        self.ramp = None;
    }

    /// The device is not there: it will have to be homed again.
    pub fn away(&mut self) {
        self.silent();
        (self.homed, self.believed, self.doubted) = (0, None, None);
        self.sample.buttons = 0;
    }

    /// Takes a reply of `now`.
    pub fn reply(&mut self, reply: &Reply, now: Instant) {
        // The device says that the coordinates are others than before, for good or bad.
        if reply.is_homed() != self.is_homed() {
            (self.homed, self.believed, self.doubted) = (0, None, None);
        }
        if !reply.is_homed() {
            self.silent();
        } else {
            self.homed = self.homed.saturating_add(1);
        }
        if !self.believe(reply.encoders, now) {
            return;
        }
        let angles = Vector3::from(reply.encoders.map(|encoder| kinematics::angle(f64::from(encoder))));
        let position = if reply.is_homed() { self.solver.solve(&angles) } else { None };
        if let Some(position) = position {
            self.sample.position = to_device(&position, self.z0);
        }
        self.sample.stamp = now;
        self.sample.sequence += 1;
        self.sample.buttons = reply.buttons();
        self.sample.valid = position.is_some() && self.homed > 1;
        if self.sample.valid {
            self.ramp.get_or_insert(now);
        } else {
            self.ramp = None;
        }
    }

    /// Whether encoders may be what they say: a jump only when it is said twice.
    fn believe(&mut self, encoders: [i16; 3], now: Instant) -> bool {
        let near = |(others, at): &([i16; 3], Instant)| {
            let limit = JUMP + JUMP_PER_MS * 1e3 * now.saturating_duration_since(*at).as_secs_f64();
            others.iter().zip(encoders).all(|(other, encoder)| (f64::from(*other) - f64::from(encoder)).abs() <= limit)
        };
        let believable = self.believed.as_ref().is_none_or(near) || self.doubted.as_ref().is_some_and(near);
        let seen = Some((encoders, now));
        (self.believed, self.doubted) = if believable { (seen, None) } else { (self.believed, seen) };
        believable
    }

    /// What to tell the device at `now`.
    pub fn command(&self, wanted: &Wanted, now: Instant) -> Command {
        let led = match self.is_homed() {
            false => Led::Red,
            true if is_fresh(wanted, now) => Led::Green,
            true => Led::Blue,
        };
        let Some(motors) = self.motors(wanted, now) else { return Command::zero(led) };
        Command { motors, homing: true, led }
    }

    fn motors(&self, wanted: &Wanted, now: Instant) -> Option<[i16; 3]> {
        let begin = self.ramp?;
        if !is_fresh(wanted, now) || !wanted.force.iter().all(|component| component.is_finite()) {
            return None;
        }
        let share = (now.saturating_duration_since(begin).as_secs_f64() / RAMP.as_secs_f64()).min(1.0);
        let force = to_base(&(wanted.force * share));
        kinematics::torques(&self.solver.position(), &force).map(|torques| kinematics::motors(&torques))
    }
}

fn is_fresh(wanted: &Wanted, now: Instant) -> bool {
    now.saturating_duration_since(wanted.since) < STALE
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn reply(encoders: [i16; 3], homed: bool) -> Reply {
        Reply { encoders, homed: [homed; 3], grip: 0x4 }
    }

    fn push(now: Instant) -> Wanted {
        Wanted { force: Vector3::x(), since: now }
    }

    /// Homed, at the centre, and with its ramp at the end.
    fn ready() -> (Motion, Instant) {
        let mut now = Instant::now();
        let mut motion = Motion::new(0.125, now);
        for _ in 0..1100 {
            now += MS;
            motion.reply(&reply([-200; 3], true), now);
        }
        (motion, now)
    }

    #[test]
    fn nothing_is_valid_or_pushed_before_homing() {
        let mut now = Instant::now();
        let mut motion = Motion::new(0.125, now);
        for _ in 0..10 {
            now += MS;
            let part = Reply { homed: [true, true, false], ..reply([0; 3], false) };
            motion.reply(&part, now);
            assert!(!motion.sample().valid && !motion.is_homed());
            assert_eq!(motion.command(&push(now), now), Command::zero(Led::Red));
        }
        assert_eq!(motion.sample().buttons, 1, "buttons work before homing");
        motion.reply(&reply([900; 3], true), now);
        assert!(!motion.sample().valid, "the first reply after the marks is not trusted");
        motion.reply(&reply([-200; 3], true), now + MS);
        motion.reply(&reply([-200; 3], true), now + 2 * MS);
        assert!(motion.sample().valid);
        assert!(motion.sample().position.norm() < 1e-4, "{}", motion.sample().position);
        assert_eq!(motion.command(&push(now), now).led, Led::Green);
    }

    #[test]
    fn homing_that_is_lost_ends_all_force() {
        let (mut motion, now) = ready();
        assert_ne!(motion.command(&push(now), now).motors, [0; 3]);
        motion.reply(&Reply { homed: [true, false, true], ..reply([-200; 3], true) }, now);
        assert!(!motion.sample().valid);
        assert_eq!(motion.command(&push(now), now), Command::zero(Led::Red));
    }

    #[test]
    fn forces_grow_after_homing_and_after_silence() {
        let (mut motion, mut now) = ready();
        let full = motion.command(&push(now), now).motors;
        // 1 N along x of the device is 1 N along z of the base.
        let expected = kinematics::motors(&kinematics::torques(&motion.solver.position(), &Vector3::z()).unwrap());
        assert_eq!(full, expected);
        motion.silent();
        assert_eq!(motion.command(&push(now), now).motors, [0; 3]);
        let mut last = 0;
        for _ in 0..1000 {
            now += MS;
            motion.reply(&reply([-200; 3], true), now);
            let motor = motion.command(&push(now), now).motors[0];
            assert!((-1..=0).contains(&(motor - last)), "{last} to {motor}");
            last = motor;
        }
        assert!((last - full[0]).abs() <= 1);
    }

    #[test]
    fn forces_that_are_old_or_no_numbers_are_not_sent() {
        let (motion, now) = ready();
        let at = |age: u32| motion.command(&push(now), now + age * MS).motors;
        assert_ne!(at(49), [0; 3]);
        assert_eq!(motion.command(&push(now), now + 50 * MS), Command::zero(Led::Blue));
        for bad in [f64::NAN, f64::INFINITY] {
            let wanted = Wanted { force: Vector3::new(0.0, bad, 0.0), since: now };
            assert_eq!(motion.command(&wanted, now).motors, [0; 3]);
        }
        let huge = Wanted { force: Vector3::new(1e6, 0.0, 0.0), since: now };
        assert!(motion.command(&huge, now).motors.iter().all(|motor| (-4096..=4096).contains(motor)));
    }

    #[test]
    fn a_single_wild_reply_is_not_believed() {
        let (mut motion, mut now) = ready();
        let before = *motion.sample();
        now += MS;
        motion.reply(&reply([-200, -200, 3896], true), now);
        assert_eq!(*motion.sample(), before);
        now += MS;
        motion.reply(&reply([-199, -200, -200], true), now);
        assert!(motion.sample().sequence == before.sequence + 1 && motion.sample().valid);
        // What stays is true.
        for _ in 0..2 {
            now += MS;
            motion.reply(&reply([200; 3], true), now);
        }
        assert_eq!(motion.sample().sequence, before.sequence + 2);
        assert!(motion.sample().position.x > 0.01);
    }

    #[test]
    fn encoders_of_no_position_are_not_valid() {
        let (mut motion, mut now) = ready();
        let before = motion.sample().position;
        for _ in 0..3 {
            now += MS;
            motion.reply(&reply([20_000, -20_000, 0], true), now);
        }
        assert!(!motion.sample().valid);
        assert_eq!(motion.sample().position, before);
        assert_eq!(motion.command(&push(now), now).motors, [0; 3]);
    }
}
