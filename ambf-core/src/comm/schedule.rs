use std::time::Duration;

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

    /// True when it is due at `now`; the next time is then scheduled.
    pub fn poll(&mut self, now: Duration) -> bool {
        if now < self.next {
            return false;
        }
        let period = self.period();
        self.next += period;
        if self.next + period <= now {
            self.next = now + period;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(schedule: &mut PublishSchedule, from_us: u64, to_us: u64, step_us: u64) -> usize {
        (from_us..to_us).step_by(step_us as usize).filter(|&t| schedule.poll(Duration::from_micros(t))).count()
    }

    #[test]
    fn slow_until_commanded_then_fast_then_slow_again() {
        let mut schedule = PublishSchedule::new(Rates::default(), Duration::ZERO);
        assert_eq!(count(&mut schedule, 0, 1_000_000, 100), 50);
        schedule.set_fast(true, Duration::from_secs(1));
        assert_eq!(count(&mut schedule, 1_000_000, 2_000_000, 100), 1000);
        schedule.set_fast(false, Duration::from_secs(2));
        assert_eq!(count(&mut schedule, 2_000_000, 3_000_000, 100), 49, "the first one comes a whole period later");
    }

    #[test]
    fn a_late_caller_catches_up_less_than_a_period() {
        let mut schedule = PublishSchedule::new(Rates::new(100, 100).unwrap(), Duration::ZERO);
        assert!(schedule.poll(Duration::ZERO));
        assert!(schedule.poll(Duration::from_millis(15)), "due at 10");
        assert!(schedule.poll(Duration::from_millis(20)), "kept its place");
        assert!(schedule.poll(Duration::from_millis(500)));
        assert!(!schedule.poll(Duration::from_millis(505)), "no burst after a long gap");
    }

    #[test]
    fn pairs_are_checked_as_pairs() {
        assert_eq!(Rates::new(1500, 2000), Ok(Rates { min: 1500, max: 2000 }));
        assert!(Rates::new(0, 10).is_err());
        assert!(Rates::new(20, 10).is_err());
    }
}
