//! How set points move from where they are to a goal, all joints at once.

use crate::kinematics::{Coordinates, MAX_JOINTS};

/// The course of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A straight line in joint space at constant speed, of the duration max |Δ| / v: the contract of the dVRK
    /// simulators. It ignores the speed at the start.
    Straight,
    /// From the speed at the start to rest, within the limits of speed and acceleration; all joints end together.
    Bounded,
    /// A polynomial of fifth degree from the speed at the start to rest, of this duration (s), whatever speed it takes.
    Quintic(f64),
}

/// Largest speeds and accelerations, rad/s and rad/s² or m/s and m/s².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Speeds, above 0.
    pub speed: Coordinates,
    /// Accelerations, above 0.
    pub acceleration: Coordinates,
}

/// Where set points are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// rad or m.
    pub position: Coordinates,
    /// rad/s or m/s.
    pub velocity: Coordinates,
}

impl Point {
    /// At rest.
    pub fn at_rest(position: Coordinates) -> Self {
        Self { position, velocity: Coordinates::zeros() }
    }
}

/// A move from a point to a goal at rest. Time starts at 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trajectory {
    start: Point,
    goal: Coordinates,
    shape: Shape,
    acceleration: Coordinates,
    /// Of shape [`Shape::Bounded`]: speed in the middle.
    cruise: Coordinates,
    duration: f64,
}

impl Trajectory {
    /// Plans the move.
    pub fn new(shape: Shape, start: Point, goal: Coordinates, bounds: &Bounds) -> Self {
        let mut planned =
            Self { start, goal, shape, acceleration: bounds.acceleration, cruise: Coordinates::zeros(), duration: 0.0 };
        let all = 0..MAX_JOINTS;
        match shape {
            Shape::Straight => {
                let times = all.map(|i| (goal[i] - start.position[i]).abs() / bounds.speed[i]);
                planned.duration = longest(times);
            }
            Shape::Bounded => {
                for i in all.clone() {
                    let speed = bounds.speed[i];
                    planned.start.velocity[i] = start.velocity[i].clamp(-speed, speed);
                }
                let ramps = planned.start.velocity;
                let axis = |i: usize| Axis {
                    distance: goal[i] - start.position[i],
                    begin: ramps[i],
                    speed: bounds.speed[i],
                    acceleration: bounds.acceleration[i],
                };
                planned.duration = longest(all.clone().map(|i| axis(i).shortest()));
                for i in all {
                    planned.cruise[i] = axis(i).cruise(planned.duration);
                }
            }
            Shape::Quintic(duration) => planned.duration = duration.max(0.0),
        }
        planned
    }

    /// s.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Where it ends.
    pub fn goal(&self) -> &Coordinates {
        &self.goal
    }

    /// The point at a time, s; exactly the goal at rest from the end on.
    pub fn at(&self, time: f64) -> Point {
        if time >= self.duration {
            return Point::at_rest(self.goal);
        }
        let mut point = self.start;
        for i in 0..MAX_JOINTS {
            (point.position[i], point.velocity[i]) = match self.shape {
                Shape::Straight => self.straight(i, time),
                Shape::Bounded => self.bounded(i, time),
                Shape::Quintic(_) => self.quintic(i, time),
            };
        }
        point
    }

    fn straight(&self, i: usize, time: f64) -> (f64, f64) {
        let velocity = (self.goal[i] - self.start.position[i]) / self.duration;
        (self.start.position[i] + velocity * time, velocity)
    }

    fn bounded(&self, i: usize, time: f64) -> (f64, f64) {
        let (begin, cruise, acceleration) = (self.start.velocity[i], self.cruise[i], self.acceleration[i]);
        let first = (cruise - begin).abs() / acceleration;
        let last = cruise.abs() / acceleration;
        if time < first {
            let change = acceleration.copysign(cruise - begin);
            return (self.start.position[i] + begin * time + change * time * time / 2.0, begin + change * time);
        }
        let left = self.duration - time;
        if left < last {
            // From the end back, so that it is met exactly.
            let change = acceleration.copysign(cruise);
            return (self.goal[i] - change * left * left / 2.0, change * left);
        }
        let after_first = self.start.position[i] + (begin + cruise) / 2.0 * first;
        (after_first + cruise * (time - first), cruise)
    }

    fn quintic(&self, i: usize, time: f64) -> (f64, f64) {
        let (t, end) = (time, self.duration);
        let (distance, begin) = (self.goal[i] - self.start.position[i], self.start.velocity[i]);
        // Accelerations at both ends are 0.
        let c3 = (10.0 * distance - 6.0 * begin * end) / end.powi(3);
        let c4 = (-15.0 * distance + 8.0 * begin * end) / end.powi(4);
        let c5 = (6.0 * distance - 3.0 * begin * end) / end.powi(5);
        let position = self.start.position[i] + t * (begin + t * t * (c3 + t * (c4 + t * c5)));
        let velocity = begin + t * t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5));
        (position, velocity)
    }
}

fn longest(times: impl Iterator<Item = f64>) -> f64 {
    times.fold(0.0, f64::max)
}

/// One joint of a bounded move: from speed `begin` to a cruising speed, along, and to rest.
struct Axis {
    distance: f64,
    begin: f64,
    speed: f64,
    acceleration: f64,
}

/// Halvings that leave a share of 1e-18.
const HALVINGS: usize = 60;

impl Axis {
    /// Distance after `time` with a cruising speed, which has to leave room for both ramps.
    fn covered(&self, cruise: f64, time: f64) -> f64 {
        let first = (cruise - self.begin).abs() / self.acceleration;
        let last = cruise.abs() / self.acceleration;
        (self.begin + cruise) / 2.0 * first + cruise * (time - first - last) + cruise / 2.0 * last
    }

    /// Cruising speeds that leave room for both ramps.
    fn range(&self, time: f64) -> (f64, f64) {
        let reach = self.acceleration * time;
        (((self.begin - reach) / 2.0).max(-self.speed), ((self.begin + reach) / 2.0).min(self.speed))
    }

    fn is_possible(&self, time: f64) -> bool {
        let (low, high) = self.range(time);
        (self.covered(low, time)..=self.covered(high, time)).contains(&self.distance)
    }

    /// Shortest time, s. Whoever can do it in a time can also do it in a longer one: he waits on the way.
    fn shortest(&self) -> f64 {
        let mut low = self.begin.abs() / self.acceleration;
        if self.is_possible(low) {
            return low;
        }
        // Stop, then from rest to rest: always enough.
        let rest = (self.distance - self.begin * low / 2.0).abs();
        let mut high =
            2.0 * low + rest / self.speed + self.speed / self.acceleration + 2.0 * (rest / self.acceleration).sqrt();
        for _ in 0..HALVINGS {
            let middle = (low + high) / 2.0;
            if self.is_possible(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        high
    }

    /// Cruising speed for a time that is long enough; the distance grows with it.
    fn cruise(&self, time: f64) -> f64 {
        let (mut low, mut high) = self.range(time);
        for _ in 0..HALVINGS {
            let middle = (low + high) / 2.0;
            if self.covered(middle, time) < self.distance {
                low = middle;
            } else {
                high = middle;
            }
        }
        (low + high) / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::testing::Random;

    fn bounds(speed: f64, acceleration: f64) -> Bounds {
        Bounds { speed: Coordinates::repeat(speed), acceleration: Coordinates::repeat(acceleration) }
    }

    fn random_start(random: &mut Random, speed: f64) -> (Point, Coordinates) {
        let mut start = Point::at_rest(Coordinates::zeros());
        let mut goal = Coordinates::zeros();
        for i in 0..MAX_JOINTS {
            start.position[i] = random.within(-1.0, 1.0);
            start.velocity[i] = random.within(-speed, speed);
            goal[i] = random.within(-1.0, 1.0);
        }
        (start, goal)
    }

    #[test]
    fn a_straight_move_takes_as_long_as_its_slowest_joint() {
        let mut goal = Coordinates::zeros();
        (goal[0], goal[2]) = (1.0, -0.5);
        let mut limits = bounds(2.0, 1.0);
        limits.speed[2] = 0.25;
        let planned = Trajectory::new(Shape::Straight, Point::at_rest(Coordinates::zeros()), goal, &limits);
        assert_eq!(planned.duration(), 2.0);
        let middle = planned.at(1.0);
        assert_eq!((middle.position[0], middle.position[2], middle.velocity[0]), (0.5, -0.25, 0.5));
        assert_eq!(planned.at(2.0), Point::at_rest(goal));
        let nothing = Trajectory::new(Shape::Straight, Point::at_rest(goal), goal, &limits);
        assert_eq!((nothing.duration(), nothing.at(0.0)), (0.0, Point::at_rest(goal)));
    }

    /// Follows a trajectory and checks that it is continuous and within its bounds.
    fn follow(planned: &Trajectory, start: &Point, limits: &Bounds) {
        const PARTS: usize = 2000;
        let dt = planned.duration() / PARTS as f64;
        let mut last = planned.at(0.0);
        assert!((last.position - start.position).amax() < 1e-9);
        assert!((last.velocity - start.velocity).amax() < 1e-9);
        for k in 1..=PARTS {
            let now = planned.at(k as f64 * dt);
            for i in 0..MAX_JOINTS {
                assert!(now.velocity[i].abs() <= limits.speed[i] * (1.0 + 1e-9));
                let change = (now.velocity[i] - last.velocity[i]).abs();
                assert!(change <= limits.acceleration[i] * dt * (1.0 + 1e-6) + 1e-7, "{change} in {dt} at {k}");
                let moved = now.position[i] - last.position[i];
                let expected = (now.velocity[i] + last.velocity[i]) / 2.0 * dt;
                assert!((moved - expected).abs() < limits.acceleration[i] * dt * dt + 1e-9);
            }
            last = now;
        }
        assert_eq!(planned.at(planned.duration()), Point::at_rest(*planned.goal()));
        assert!((last.position - planned.goal()).amax() < 1e-9);
    }

    #[test]
    fn bounded_moves_start_with_any_speed_and_keep_the_bounds() {
        let mut random = Random::new(41);
        for _ in 0..200 {
            let limits = bounds(random.within(0.5, 2.0), random.within(0.5, 5.0));
            let (start, goal) = random_start(&mut random, limits.speed[0]);
            let planned = Trajectory::new(Shape::Bounded, start, goal, &limits);
            follow(&planned, &start, &limits);
        }
    }

    #[test]
    fn bounded_moves_from_rest_are_trapezoids() {
        let limits = bounds(1.0, 2.0);
        let mut goal = Coordinates::zeros();
        goal[0] = 2.0;
        let planned = Trajectory::new(Shape::Bounded, Point::at_rest(Coordinates::zeros()), goal, &limits);
        // Ramps of 0.5 s over 0.25 m each, 1.5 m in between.
        assert!((planned.duration() - 2.5).abs() < 1e-9, "{}", planned.duration());
        assert!((planned.at(1.25).velocity[0] - 1.0).abs() < 1e-9);
        goal[0] = 0.02;
        let short = Trajectory::new(Shape::Bounded, Point::at_rest(Coordinates::zeros()), goal, &limits);
        assert!((short.duration() - 0.2).abs() < 1e-9, "a triangle: 2 sqrt(d / a), got {}", short.duration());
    }

    #[test]
    fn moves_from_rest_go_one_way() {
        let mut random = Random::new(43);
        for _ in 0..50 {
            let (mut start, goal) = random_start(&mut random, 1.0);
            start.velocity.fill(0.0);
            for shape in [Shape::Straight, Shape::Bounded, Shape::Quintic(0.5)] {
                let planned = Trajectory::new(shape, start, goal, &bounds(1.0, 3.0));
                let mut last = start.position;
                for k in 1..=100 {
                    let now = planned.at(planned.duration() * f64::from(k) / 100.0).position;
                    for i in 0..MAX_JOINTS {
                        assert!((now[i] - last[i]) * (goal[i] - start.position[i]).signum() >= -1e-12);
                    }
                    last = now;
                }
            }
        }
    }

    #[test]
    fn quintics_meet_both_ends() {
        let mut random = Random::new(47);
        let (start, goal) = random_start(&mut random, 1.0);
        let planned = Trajectory::new(Shape::Quintic(0.5), start, goal, &bounds(1.0, 1.0));
        let begin = planned.at(0.0);
        assert!((begin.position - start.position).amax() < 1e-12 && (begin.velocity - start.velocity).amax() < 1e-12);
        let end = planned.at(0.5 - 1e-9);
        assert!((end.position - goal).amax() < 1e-7 && end.velocity.amax() < 1e-6);
    }
}
