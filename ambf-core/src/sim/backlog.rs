//! Wall time that is still to be simulated, and how it is divided into iterations.

/// An interval is at most so many periods unless longer ones are needed to keep up: controllers, resistance sensors and
/// devices act once an iteration in the profile `legacy`, and stiff ones are unstable with intervals of many ms.
const LONGEST: f64 = 2.0;
/// Weight of a new sample in the running means of costs: what lasts less than about 0.1 s at 1 kHz is borne by the time
/// that may be due.
const WEIGHT: f64 = 1.0 / 128.0;
/// Costs above so many times the running mean and [`USUAL_COST`] count as that: an iteration that was preempted says
/// nothing about the scene.
const OUTLIER: f64 = 4.0;
/// Cost of an iteration, s, that is not worth a thought.
const USUAL_COST: f64 = 100e-6;
/// Above this share of the time that a sub-step has, no division into iterations can keep up.
const OVERLOAD: f64 = 0.98;
/// Where iterations are lengthened to keep up, they may cost this much more than measured.
const MARGIN: f64 = 1.25;
/// Under overload, sub-steps cost at least so many times what else an iteration does.
const WORTHWHILE: f64 = 4.0;

/// Wall time, times the speed factor, that is still to be simulated.
///
/// An iteration that comes late (preempted, or after a slow plugin) leaves more time due than a period. It is divided
/// into iterations of at most two periods, done one after the other. They are longer where an iteration's costs besides
/// its sub-steps would otherwise not allow to keep up. What cannot be computed in time is lost: what exceeds the world's
/// limit of sub-steps an iteration, and under overload nearly everything that is due, so that states and commands flow.
#[derive(Debug)]
pub(super) struct Backlog {
    /// Period of the loop, s.
    period: f64,
    /// Length of a sub-step, s.
    sub_step: f64,
    /// Sub-steps of an iteration, at most.
    limit: f64,
    /// Still to be simulated, s.
    due: f64,
    /// Wall time until which everything is simulated or due, s.
    wall: f64,
    /// Simulated per wall time.
    speed: f64,
    /// Running mean of the cost of a sub-step, s.
    sub_step_cost: f64,
    /// Running mean of the cost of an iteration besides its sub-steps, s.
    other_cost: f64,
}

/// What is taken from a [`Backlog`], s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Share {
    /// Interval of the next iteration.
    pub interval: f64,
    /// Simulated time that will never be integrated.
    pub lost: f64,
}

impl Backlog {
    /// Nothing is due at wall time zero of a loop with this `period` (s), in sub-steps of `sub_step` s, at most `limit`
    /// an iteration.
    pub fn new(period: f64, sub_step: f64, limit: u32) -> Self {
        let limit = f64::from(limit.max(1));
        Self { period, sub_step, limit, due: 0.0, wall: 0.0, speed: 1.0, sub_step_cost: 0.0, other_cost: 0.0 }
    }

    /// It is `wall` s now; since the last call `speed` times as much became due as has passed.
    pub fn pass(&mut self, wall: f64, speed: f64) {
        self.speed = speed;
        self.due += speed * (wall - self.wall);
        self.wall = wall;
    }

    /// It is `wall` s now, and just one period is due: what has passed, which this returns, does not count.
    pub fn restart(&mut self, wall: f64) -> f64 {
        self.due = self.period;
        wall - std::mem::replace(&mut self.wall, wall)
    }

    /// Takes the interval of the next iteration.
    pub fn take(&mut self) -> Share {
        let lost = (self.due - self.kept()).max(0.0);
        self.due -= lost;
        let interval = self.due.min(self.longest());
        self.due -= interval;
        Share { interval, lost }
    }

    /// Takes all that is due as one interval.
    pub fn take_all(&mut self) -> Share {
        Share { interval: std::mem::take(&mut self.due), lost: 0.0 }
    }

    /// Whether the next iteration should follow at once.
    pub fn is_behind(&self) -> bool {
        self.due >= self.period
    }

    /// Learns from an iteration of `sub_steps` that took `stepping` s, and `other` s for everything else.
    pub fn learn(&mut self, sub_steps: u32, stepping: f64, other: f64) {
        let mut other = other;
        match sub_steps {
            0 => other += stepping,
            n => mix(&mut self.sub_step_cost, stepping / f64::from(n)),
        }
        mix(&mut self.other_cost, other);
    }

    /// Sub-steps that may be due before time is lost.
    pub fn cap(&self) -> u32 {
        (self.kept() / self.sub_step).min(self.limit) as u32
    }

    /// Time that may be due, s; what exceeds it is lost.
    fn kept(&self) -> f64 {
        match self.is_overloaded() {
            true => self.longest(),
            // Less than a whole sub-step may be left from the iteration before.
            false => self.longest().max((self.limit + 1.0) * self.sub_step),
        }
    }

    /// Longest interval of an iteration now, s.
    fn longest(&self) -> f64 {
        let sub_steps = match self.is_overloaded() {
            true => WORTHWHILE * self.other_cost / self.sub_step_cost,
            // n sub-steps last n h / speed and cost other + n cost.
            false => MARGIN * self.other_cost / (self.sub_step / self.speed - self.sub_step_cost),
        };
        let limit = (self.limit * self.sub_step).max(self.period);
        (sub_steps.ceil() * self.sub_step).max(LONGEST * self.period).min(limit)
    }

    fn is_overloaded(&self) -> bool {
        self.sub_step_cost >= OVERLOAD * self.sub_step / self.speed
    }
}

fn mix(mean: &mut f64, sample: f64) {
    *mean += WEIGHT * (sample.min(OUTLIER * *mean + USUAL_COST) - *mean);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A loop of 1 kHz whose sub-steps of 1 ms cost `cost` s and whose iterations cost `other` s more.
    struct Loop {
        backlog: Backlog,
        wall: f64,
        iterations: u32,
        /// Longest interval, s.
        longest: f64,
        /// Sum of all intervals, and what was lost, s.
        simulated: f64,
        lost: f64,
    }

    impl Loop {
        fn new() -> Self {
            let backlog = Backlog::new(0.001, 0.001, 50);
            Self { backlog, wall: 0.0, iterations: 0, longest: 0.0, simulated: 0.0, lost: 0.0 }
        }

        fn run(&mut self, cost: f64, other: f64, seconds: f64) {
            (self.iterations, self.longest, self.simulated, self.lost) = (0, 0.0, 0.0, 0.0);
            let (end, mut next) = (self.wall + seconds, self.wall);
            while self.wall < end {
                self.backlog.pass(self.wall, 1.0);
                let Share { interval, lost } = self.backlog.take();
                let sub_steps = (interval / 0.001).round();
                self.wall += sub_steps * cost + other;
                self.backlog.learn(sub_steps as u32, sub_steps * cost, other);
                self.iterations += 1;
                self.longest = self.longest.max(interval);
                self.simulated += interval;
                self.lost += lost;
                next += 0.001;
                if !self.backlog.is_behind() {
                    next = next.max(self.wall);
                    self.wall = next;
                }
            }
        }
    }

    #[test]
    fn a_late_iteration_is_divided_and_nothing_is_lost() {
        let mut one = Loop::new();
        one.run(0.0002, 0.0001, 1.0);
        assert!(one.longest < 0.0021, "{}", one.longest);
        one.wall += 0.04;
        one.run(0.0002, 0.0001, 0.1);
        assert!(one.longest <= 0.002, "{}", one.longest);
        assert_eq!(one.lost, 0.0);
        assert!((one.simulated - 0.14).abs() < 0.003, "{}", one.simulated);
        assert!(!one.backlog.is_behind());
    }

    #[test]
    fn an_iteration_of_a_second_loses_what_exceeds_the_limit() {
        let mut one = Loop::new();
        one.wall = 1.0;
        one.run(0.0002, 0.0001, 0.1);
        assert!((one.lost - 0.949).abs() < 1e-9, "{}", one.lost);
    }

    #[test]
    fn expensive_sub_steps_make_many_short_iterations_and_lose_no_more_time() {
        let mut one = Loop::new();
        one.run(0.0014, 0.00005, 1.0);
        one.run(0.0014, 0.00005, 10.0);
        assert!(one.iterations > 3000, "{}", one.iterations);
        assert!(one.simulated > 0.95 * 10.0 / 1.4, "{}", one.simulated);
        assert!(one.longest <= 0.002, "{}", one.longest);
        assert!((one.simulated + one.lost - 10.0).abs() < 0.01);
    }

    #[test]
    fn other_costs_make_longer_iterations_and_no_time_is_lost() {
        let mut one = Loop::new();
        one.run(0.0002, 0.004, 2.0);
        one.run(0.0002, 0.004, 10.0);
        assert_eq!(one.lost, 0.0);
        assert!(one.simulated > 9.99, "{}", one.simulated);
        assert!(one.longest < 0.012, "{}", one.longest);
    }

    #[test]
    fn load_is_forgotten_when_it_has_gone() {
        let mut one = Loop::new();
        one.run(0.0014, 0.0001, 2.0);
        assert!(one.lost > 0.5);
        assert_eq!(one.backlog.cap(), 2);
        one.run(0.0002, 0.0001, 0.1);
        one.run(0.0002, 0.0001, 1.0);
        assert_eq!(one.lost, 0.0);
        assert_eq!(one.backlog.cap(), 50);
    }

    #[test]
    fn one_preempted_iteration_changes_little() {
        let mut one = Loop::new();
        one.run(0.0002, 0.0001, 1.0);
        one.backlog.learn(2, 0.05, 0.0001);
        one.backlog.learn(2, 0.0004, 0.05);
        assert!(!one.backlog.is_overloaded());
        assert_eq!(one.backlog.longest(), 0.002);
    }

    #[test]
    fn a_world_of_one_sub_step_an_iteration_keeps_up_at_1_khz() {
        let mut backlog = Backlog::new(0.001, 0.001, 1);
        let mut lost = 0.0;
        for i in 1..1000 {
            // Each wake-up is up to 0.1 ms late.
            backlog.pass(f64::from(i) * 0.001 + f64::from(i % 7) * 1e-4 / 7.0, 1.0);
            loop {
                let share = backlog.take();
                lost += share.lost;
                assert!(share.interval <= 0.001);
                if !backlog.is_behind() {
                    break;
                }
            }
        }
        assert_eq!(lost, 0.0);
    }

    #[test]
    fn a_pause_does_not_count() {
        let mut backlog = Backlog::new(0.001, 0.001, 50);
        backlog.pass(0.001, 1.0);
        backlog.restart(30.0);
        assert_eq!(backlog.take(), Share { interval: 0.001, lost: 0.0 });
    }
}
