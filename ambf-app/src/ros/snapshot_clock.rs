//! When the next snapshot is expected: what is published right after it came is youngest.

use std::time::{Duration, SystemTime};

use ambf_core::comm::Snapshot;

/// From a snapshot's stamp until it can be read.
const FILLING: Duration = Duration::from_micros(30);

/// A period that is longer than that of the topics by no more than this share counts as the same.
const TOLERANCE: f64 = 0.02;

/// Weight of the newest period in the mean.
const WEIGHT: f64 = 0.1;

/// Follows the stamps of snapshots. Where the simulation does not run in real time, or stamps are of simulated time, it
/// expects nothing.
#[derive(Debug, Default)]
pub(super) struct SnapshotClock {
    /// Step and stamp of the newest snapshot.
    newest: Option<(u32, SystemTime)>,
    /// Mean time between snapshots, s; 0: not known.
    period: f64,
}

impl SnapshotClock {
    /// Looks at the newest snapshot; true when it was not seen before.
    pub fn see(&mut self, snapshot: &Snapshot) -> bool {
        let newest = (snapshot.sim_step, snapshot.stamp);
        let Some(before) = self.newest.replace(newest) else { return true };
        if before.0 == newest.0 {
            return false;
        }
        let steps = newest.0.checked_sub(before.0).map(f64::from);
        let passed = newest.1.duration_since(before.1).ok().map(|passed| passed.as_secs_f64());
        self.period = match steps.zip(passed).map(|(steps, passed)| passed / steps) {
            Some(period) if self.period > 0.0 => self.period + WEIGHT * (period - self.period),
            Some(period) => period,
            None => 0.0,
        };
        true
    }

    /// How long to wait for what is due in `wait`: until the first snapshot that can be read then or later, if snapshots
    /// come at least every `period`, else `wait`. `now` is the system's time.
    pub fn align(&self, wait: Duration, period: Duration, now: SystemTime) -> Duration {
        let Some((_, stamp)) = self.newest else { return wait };
        let is_regular = self.period > 0.0 && self.period <= period.as_secs_f64() * (1.0 + TOLERANCE);
        let Some(age) = now.duration_since(stamp).ok().filter(|age| is_regular && age.as_secs_f64() < 2.0 * self.period)
        else {
            return wait;
        };
        // From the newest snapshot to what is due, in periods.
        let due = (age + wait).saturating_sub(FILLING).as_secs_f64() / self.period;
        let next = (due.ceil() * self.period) + FILLING.as_secs_f64() - age.as_secs_f64();
        wait.max(Duration::try_from_secs_f64(next).unwrap_or(wait))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(stamps_us: &[u64]) -> (SnapshotClock, SystemTime) {
        let mut clock = SnapshotClock::default();
        let at = |us| SystemTime::UNIX_EPOCH + Duration::from_micros(us);
        for (step, &us) in stamps_us.iter().enumerate() {
            let snapshot = Snapshot { sim_step: step as u32, stamp: at(us), ..Snapshot::default() };
            assert!(clock.see(&snapshot) && !clock.see(&snapshot));
        }
        (clock, at(*stamps_us.last().expect("one")))
    }

    fn us(duration: Duration) -> f64 {
        (duration.as_secs_f64() * 1e6).round()
    }

    #[test]
    fn what_is_due_waits_for_the_next_snapshot() {
        let (clock, newest) = seen(&[1000, 1500, 2000, 2500]);
        let now = newest + Duration::from_micros(100);
        let period = Duration::from_micros(500);
        for (wait, expected) in [(0, 430), (400, 430), (430, 430), (431, 930), (1000, 1430)] {
            let found = us(clock.align(Duration::from_micros(wait), period, now));
            assert_eq!(found, f64::from(expected), "due in {wait} µs");
        }
        // Topics of a lower rate, too; those of a higher one are not held up.
        assert_eq!(us(clock.align(Duration::ZERO, Duration::from_millis(20), now)), 430.0);
        assert_eq!(clock.align(Duration::ZERO, Duration::from_micros(400), now), Duration::ZERO);
    }

    #[test]
    fn the_snapshot_that_has_just_come_is_not_waited_for() {
        let (clock, newest) = seen(&[1000, 1500, 2000]);
        let waited = clock.align(Duration::ZERO, Duration::from_micros(500), newest + FILLING);
        assert_eq!(waited, Duration::ZERO);
    }

    #[test]
    fn nothing_is_expected_of_snapshots_that_do_not_come_in_real_time() {
        let (clock, newest) = seen(&[1000, 1500, 2000]);
        let period = Duration::from_millis(1);
        for now in [newest + Duration::from_secs(1), newest - Duration::from_secs(1)] {
            assert_eq!(clock.align(Duration::ZERO, period, now), Duration::ZERO, "paused, simulated stamps");
        }
        let (reset, newest) = seen(&[1000, 1500, 900]);
        assert_eq!(reset.align(Duration::ZERO, period, newest), Duration::ZERO);
        assert_eq!(SnapshotClock::default().align(Duration::ZERO, period, newest), Duration::ZERO);
    }

    #[test]
    fn steps_that_were_not_seen_do_not_count_as_one_period() {
        let mut clock = SnapshotClock::default();
        for (step, us) in [(4, 2000), (6, 3000), (10, 5000)] {
            let stamp = SystemTime::UNIX_EPOCH + Duration::from_micros(us);
            clock.see(&Snapshot { sim_step: step, stamp, ..Snapshot::default() });
        }
        assert!((clock.period - 500e-6).abs() < 1e-9, "{}", clock.period);
    }
}
