use std::time::Duration;

use super::Published;

/// Lowest and highest publishing frequency of an object, Hz. Default: 50 and 1000.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rates {
    /// While no command is in force, Hz.
    pub min: u32,
    /// While commands keep coming, Hz.
    pub max: u32,
}

impl Default for Rates {
    fn default() -> Self {
        Self { min: 50, max: 1000 }
    }
}

impl Rates {
    /// A pair in which `0 < min <= max`.
    ///
    /// # Errors
    /// The sentence that says what is wrong otherwise.
    pub fn new(min: u32, max: u32) -> Result<Self, String> {
        if min == 0 || min > max {
            return Err(format!("publish frequency: expected 0 < low <= high, found low {min}, high {max}"));
        }
        Ok(Self { min, max })
    }
}

/// When an object is due to be published: an absolute schedule at [`Rates::min`] that changes to [`Rates::max`] while
/// commands keep coming. Like a ROS rate, it catches up less than one period and starts afresh when a whole period
/// behind.
///
/// What is due waits for the next states, so that these are sent when they are new, and each once if a topic is as fast as
/// the physics. Where none come, because nothing moves, it waits half a period beyond the next time, so that the rate
/// stays. A topic that is faster than the physics does not wait.
#[derive(Debug, Clone)]
pub struct PublishSchedule {
    rates: Rates,
    fast: bool,
    next: Duration,
}

impl PublishSchedule {
    /// Due for the first time at `now`. Times are durations since any fixed instant.
    pub fn new(rates: Rates, now: Duration) -> Self {
        Self { rates, fast: false, next: now }
    }

    /// Present period, s.
    pub fn period(&self) -> Duration {
        Duration::from_secs(1) / if self.fast { self.rates.max } else { self.rates.min }
    }

    /// Says whether commands are coming; a change to the fast rate takes effect at `now`.
    pub fn set_fast(&mut self, fast: bool, now: Duration) {
        if fast != self.fast {
            self.fast = fast;
            self.next = if fast { now } else { now + self.period() };
        }
    }

    /// When it is due next.
    pub fn next_due(&self) -> Duration {
        self.next
    }

    /// Until when it waits for states that come every `interval`, s.
    pub fn latest(&self, interval: Duration) -> Duration {
        let period = self.period();
        // A topic as fast as the physics is not to look faster because a clock is read late.
        if period * 10 < interval * 9 {
            self.next
        } else {
            self.next + period * 3 / 2
        }
    }

    /// True when it is to be published at `now`; the next time is then scheduled. `published`: when states came.
    pub fn poll(&mut self, now: Duration, published: Published) -> bool {
        let Published { at, interval } = published;
        let is_new = at >= self.next;
        if now < self.next || !is_new && now < self.latest(interval) {
            return false;
        }
        let (due, period) = (self.next, self.period());
        self.next += period;
        if self.next + period <= now {
            self.next = now + period;
        } else if is_new && self.latest(interval) > self.next {
            // Where periods are multiples of the interval, the due times move to the middle between two states, where late
            // states do no harm; elsewhere the shifts cancel each other.
            self.next = self.next + (at - due).min(interval) / 8 - interval / 16;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(schedule: &mut PublishSchedule, from_us: u64, to_us: u64, step_us: u64) -> usize {
        let never = Published::default();
        (from_us..to_us).step_by(step_us as usize).filter(|&t| schedule.poll(Duration::from_micros(t), never)).count()
    }

    /// A topic of `rate` Hz and states every ms, up to 0.4 ms late, from 10 s on until `to_s`, all with its publisher woken at
    /// once: the numbers of the states that are sent.
    fn sent_with_states(schedule: &mut PublishSchedule, to_s: u64) -> Vec<u64> {
        let (mut sent, mut random) = (Vec::new(), 1_u64);
        for number in 10_000..to_s * 1000 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let late = Duration::from_micros((random >> 33) % 400);
            let at = Duration::from_millis(number) + late;
            let published = Published { at, interval: Duration::from_millis(1) };
            while schedule.poll(at, published) {
                sent.push(number);
            }
        }
        sent
    }

    #[test]
    fn slow_until_commanded_then_fast_then_slow_again_also_without_states() {
        let mut schedule = PublishSchedule::new(Rates::default(), Duration::from_nanos(1));
        assert_eq!(count(&mut schedule, 0, 1_020_000, 100), 50, "each one and a half periods late");
        schedule.set_fast(true, Duration::from_secs(2));
        assert_eq!(count(&mut schedule, 2_000_000, 3_000_600, 100), 1000);
        schedule.set_fast(false, Duration::from_secs(4));
        assert_eq!(count(&mut schedule, 4_000_000, 5_031_000, 100), 50, "the first one comes a whole period later");
    }

    #[test]
    fn a_topic_as_fast_as_the_physics_has_each_state_once() {
        // Wherever it starts between two states.
        for start_us in (0..1000).step_by(50) {
            let begin = Duration::from_micros(10_000_000 + start_us);
            let mut schedule = PublishSchedule::new(Rates::new(1000, 1000).unwrap(), begin);
            let sent = sent_with_states(&mut schedule, 12);
            let settled: Vec<u64> = sent.into_iter().filter(|&number| number >= 10_100).collect();
            assert_eq!(settled, (10_100..12_000).collect::<Vec<_>>(), "started {start_us} us after a state");
        }
    }

    #[test]
    fn a_rate_is_kept_with_states() {
        for rate in [50, 300, 700, 999] {
            let mut schedule = PublishSchedule::new(Rates::new(rate, rate).unwrap(), Duration::from_secs(10));
            let sent = sent_with_states(&mut schedule, 20).len();
            assert!(sent.abs_diff(rate as usize * 10) <= 20, "{rate} Hz: {sent} in 10 s");
        }
    }

    #[test]
    fn a_topic_that_is_faster_than_the_physics_does_not_wait() {
        let mut schedule = PublishSchedule::new(Rates::new(2000, 2000).unwrap(), Duration::ZERO);
        let published = Published { at: Duration::ZERO, interval: Duration::from_millis(1) };
        assert_eq!((0..1000).filter(|&t| schedule.poll(Duration::from_millis(t) / 10, published)).count(), 200);
    }

    #[test]
    fn a_late_caller_catches_up_less_than_a_period() {
        let never = Published::default();
        let mut schedule = PublishSchedule::new(Rates::new(100, 100).unwrap(), Duration::from_nanos(1));
        assert!(!schedule.poll(Duration::from_millis(14), never), "states may come");
        assert!(schedule.poll(Duration::from_millis(16), never));
        assert!(schedule.poll(Duration::from_millis(29), never), "due at 10");
        assert!(schedule.poll(Duration::from_millis(36), never), "kept its place");
        assert!(schedule.poll(Duration::from_millis(500), never));
        assert!(!schedule.poll(Duration::from_millis(520), never), "no burst after a long gap");
    }

    #[test]
    fn pairs_are_checked_as_pairs() {
        assert_eq!(Rates::new(1500, 2000), Ok(Rates { min: 1500, max: 2000 }));
        assert!(Rates::new(0, 10).is_err());
        assert!(Rates::new(20, 10).is_err());
    }
}
