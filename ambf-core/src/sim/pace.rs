use std::time::{Duration, Instant};

/// Sleeping wakes up late by up to about this; the rest is spun.
const SPIN: Duration = Duration::from_micros(60);

/// Periods that a loop may be behind and still catch up: what a preempted iteration costs on a busy computer.
const MAX_LAG: u32 = 10;

/// Keeps a loop at a frequency on an absolute schedule. Further behind than a few periods it starts afresh: no lag piles up.
#[derive(Debug, Clone)]
pub(super) struct Pacer {
    period: Duration,
    next: Instant,
}

impl Pacer {
    pub fn new(period: Duration) -> Self {
        Self { period, next: Instant::now() + period }
    }

    /// Waits for the end of the period. Most of it is slept, the last part spun.
    pub fn wait(&mut self) {
        let now = Instant::now();
        if now > self.next + self.period * MAX_LAG {
            self.next = now + self.period;
            return;
        }
        if now >= self.next {
            self.next += self.period;
            return;
        }
        if let Some(rest) = self.next.checked_duration_since(now + SPIN) {
            std::thread::sleep(rest);
        }
        while Instant::now() < self.next {
            std::hint::spin_loop();
        }
        self.next += self.period;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lag_does_not_pile_up() {
        let mut pacer = Pacer::new(Duration::from_millis(1));
        std::thread::sleep(Duration::from_millis(50));
        let begin = Instant::now();
        pacer.wait();
        pacer.wait();
        assert!(begin.elapsed() >= Duration::from_millis(1), "no burst to catch up 50 periods");
    }

    #[test]
    fn a_period_is_never_shorter_on_average() {
        let begin = Instant::now();
        let mut pacer = Pacer::new(Duration::from_millis(1));
        for _ in 0..50 {
            pacer.wait();
        }
        assert!(begin.elapsed() >= Duration::from_millis(50));
    }
}
