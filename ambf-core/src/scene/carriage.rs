//! Bodies without mass that are moved: what commands become of velocity.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::Body;
use crate::bullet::{SubStep, World};
use crate::control::agreement;

/// How commanded poses of a body without mass become a motion.
///
/// A set point that changes is reached in the time that passed since the change before, when it is expected to change again.
/// The body moves there as far as the rates of the set point in the last two of these times [agree](agreement); the rest of
/// the way is a jump, which has no velocity. So a set point that is put elsewhere throws nothing about (at most twice the
/// velocity before is left), and the first two changes after a rest are jumps: how long they may take is not known.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Carriage {
    /// Where the set point is; `None`: nowhere yet.
    set: Option<Isometry3<f64>>,
    /// Mean rates with which it came there: m/s and rad/s, world axes.
    rates: Option<[Vector3<f64>; 2]>,
    /// Time between the last two changes, s.
    period: Option<f64>,
    /// Time from the last change to the beginning of this update, and the time in which the body is to be there, s.
    age: f64,
    reach: f64,
    /// Length of this update, s.
    duration: f64,
    /// Where the body was brought.
    at: Option<Isometry3<f64>>,
}

/// A set point that has not changed for this multiple of the time between the last two changes is at rest.
const PATIENCE: f64 = 2.0;

/// Relative rounding error of times that are sums of sub-steps.
const ROUNDING: f64 = 1e-9;

/// Jumps shorter than this are made a part of the motion: m and rad.
const LEAST_JUMP: [f64; 2] = [1e-5, 1e-4];

/// Way from one pose to another: displacement, m, and rotation vector, rad, world axes.
pub(super) fn way_between(from: &Isometry3<f64>, to: &Isometry3<f64>) -> [Vector3<f64>; 2] {
    [to.translation.vector - from.translation.vector, (to.rotation * from.rotation.inverse()).scaled_axis()]
}

fn advanced(pose: &Isometry3<f64>, [way, turn]: [Vector3<f64>; 2]) -> Isometry3<f64> {
    // As a product of many rotations that are read from matrices it would not stay one.
    let rotation = UnitQuaternion::new_normalize((UnitQuaternion::from_scaled_axis(turn) * pose.rotation).into_inner());
    Isometry3::from_parts((pose.translation.vector + way).into(), rotation)
}

fn is_far([way, turn]: &[Vector3<f64>; 2]) -> bool {
    way.norm() > LEAST_JUMP[0] || turn.norm() > LEAST_JUMP[1]
}

impl Carriage {
    /// Takes the set point of an update of `duration` s of a body at `pose`. Returns where it has to be put now.
    fn aim(&mut self, target: &Isometry3<f64>, pose: &Isometry3<f64>, duration: f64) -> Option<Isometry3<f64>> {
        // Somebody else may have put it elsewhere.
        if self.at.is_some_and(|at| is_far(&way_between(&at, pose))) {
            *self = Self::default();
        }
        self.age += self.duration;
        self.duration = duration;
        let way = way_between(pose, target);
        if self.set == Some(*target) {
            let is_on_its_way = self.age < self.reach * (1.0 - ROUNDING);
            return (!is_on_its_way && is_far(&way)).then_some(*target);
        }
        let is_at_rest = self.period.is_some_and(|period| self.age > PATIENCE * period * (1.0 + ROUNDING));
        let last = self.set.filter(|_| !is_at_rest && self.age > 0.0);
        let rates = last.map(|last| way_between(&last, target).map(|part| part / self.age));
        let shares = match (rates, self.rates) {
            (Some(now), Some(before)) => [0, 1].map(|i| agreement(now[i], before[i])),
            _ => [0.0; 2],
        };
        (self.set, self.rates, self.period) = (Some(*target), rates, last.map(|_| self.age));
        self.reach = if shares == [0.0; 2] { 0.0 } else { self.age };
        self.age = 0.0;
        if self.reach == 0.0 {
            return Some(*target);
        }
        let jump = [0, 1].map(|i| way[i] * (1.0 - shares[i]));
        is_far(&jump).then(|| advanced(pose, jump))
    }
}

impl Body {
    /// Moves a body without mass to where its set point, a pose of the inertial frame, has it at the end of the sub-step.
    pub(super) fn carry(&mut self, world: &mut World, target: &Isometry3<f64>, sub_step: SubStep) {
        let Some(mut pose) = world.pose(self.handle) else { return };
        let carriage = &mut self.target.carriage;
        if sub_step.is_first() {
            if let Some(put) = carriage.aim(target, &pose, sub_step.duration) {
                world.set_pose(self.handle, &put);
                pose = put;
            }
        }
        let left = carriage.reach - carriage.age - sub_step.start;
        carriage.at = Some(if left <= ROUNDING * carriage.reach {
            world.rest_body(self.handle);
            pose
        } else {
            let share = sub_step.length / left;
            let is_last = share >= 1.0 - ROUNDING;
            let to =
                if is_last { *target } else { advanced(&pose, way_between(&pose, target).map(|part| part * share)) };
            world.move_body(self.handle, &to, sub_step.length);
            to
        });
    }

    /// Moves a body without mass for `length` s with these velocities of its body frame, m/s and rad/s, world axes.
    pub(super) fn carry_on(&mut self, world: &mut World, linear: &Vector3<f64>, angular: &Vector3<f64>, length: f64) {
        if linear.norm_squared() == 0.0 && angular.norm_squared() == 0.0 {
            return world.rest_body(self.handle);
        }
        let Some(pose) = world.pose(self.handle) else { return };
        let moved = advanced(&(pose * self.inertial_offset_inverse), [linear * length, angular * length]);
        world.move_body(self.handle, &(moved * self.inertial_offset), length);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.001;

    /// Carries a body by set points, one an update; returns the largest speed, the last pose and the number of jumps.
    fn follow(points: impl IntoIterator<Item = f64>) -> (f64, f64, usize) {
        let (mut carriage, mut at) = (Carriage::default(), 0.0);
        let (mut fastest, mut jumps) = (0.0f64, 0);
        for x in points {
            let place = |x| Isometry3::translation(x, 0.0, 0.0);
            if let Some(put) = carriage.aim(&place(x), &place(at), DT) {
                at = put.translation.x;
                jumps += 1;
            }
            let left = carriage.reach - carriage.age;
            if left > 1e-12 {
                let way = (x - at) * (DT / left).min(1.0);
                (fastest, at) = (fastest.max(way.abs() / DT), at + way);
            }
            carriage.at = Some(place(at));
        }
        (fastest, at, jumps)
    }

    #[test]
    fn a_steady_set_point_gives_its_velocity_however_often_it_comes() {
        for every in [1, 2, 10, 20] {
            let (fastest, at, jumps) = follow((1..=400).map(|i| 0.3 * DT * f64::from((i + every - 1) / every * every)));
            assert!((fastest - 0.3).abs() < 1e-9 && jumps == 2, "every {every}: {fastest} m/s, {jumps} jumps");
            assert!((at - 0.12).abs() < 1e-12, "{at}");
        }
    }

    #[test]
    fn jumps_have_no_velocity() {
        // One far away, there and back, out of a slow motion, and to and fro.
        assert_eq!(follow([0.0, 0.0, 1.0, 1.0, 1.0]), (0.0, 1.0, 2));
        assert_eq!(follow((0..50).map(|i| f64::from(i / 5 % 2))).0, 0.0);
        let (fastest, at, _) = follow((0..100).map(|i| 1e-4 * f64::from(i) + if i < 50 { 0.0 } else { 1.0 }));
        assert!(fastest < 0.2 + 1e-9 && (at - 1.0099).abs() < 1e-9, "{fastest} {at}");
    }

    #[test]
    fn a_set_point_that_goes_on_after_a_rest_is_there_at_once() {
        let slow = (0..20).map(|i| 1e-4 * f64::from(i));
        let (_, at, _) = follow(slow.chain(std::iter::repeat_n(1.9e-3, 500)).chain([0.05]));
        assert_eq!(at, 0.05);
    }
}
