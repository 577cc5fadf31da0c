//! What simulated time was lost to: the cost of the scene, or something that has nothing to do with it.

use std::time::Duration;

use rustix::time::{clock_gettime, ClockId};

/// Losses are reported at most once in so many s.
const WINDOW: f64 = 1.0;

/// Computing that takes more than this share of the time in which something was simulated leaves no room.
const FULL: f64 = 0.98;

/// Why simulated time was not computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LossCause {
    /// The simulation costs more processor time than there is.
    Cost,
    /// Clients held the simulation.
    Clients,
    /// Models were built or removed, or everything was reset.
    Changes,
    /// The thread did not run: its process was stopped, or other programs had the processor.
    Outside,
}

/// Counts what the loop spends its time on in a window of a second, s.
#[derive(Debug, Default)]
pub(super) struct Losses {
    /// Processor time of iterations.
    computing: f64,
    /// Held by clients.
    held: f64,
    /// Changing the scene.
    changing: f64,
    /// When the window began, s.
    begin: f64,
    /// Lost before, s.
    lost: f64,
}

/// Processor time of the calling thread.
pub(super) fn processor_time() -> Duration {
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default()
}

impl Losses {
    /// Counts `time` of computing iterations.
    pub fn compute(&mut self, time: Duration) {
        self.computing += time.as_secs_f64();
    }

    /// Counts `time` of changes to the scene.
    pub fn change(&mut self, time: Duration) {
        self.changing += time.as_secs_f64();
    }

    /// Counts `time` for which clients held the loop, with what was changed meanwhile, which does not count here.
    /// `changing_before` is [`changing`](Self::changing) when that began.
    pub fn hold(&mut self, time: Duration, changing_before: f64) {
        self.held += (time.as_secs_f64() - (self.changing - changing_before)).max(0.0);
    }

    /// `time` s of a pause do not count.
    pub fn skip(&mut self, time: f64) {
        self.begin += time;
    }

    /// Time of changes in this window, s.
    pub fn changing(&self) -> f64 {
        self.changing
    }

    /// At the end of a window: what was lost in it, s, and why. It is `wall` s now, `lost` s were lost in all, and
    /// `speed` s are simulated in one of the clock.
    pub fn report(&mut self, wall: f64, lost: f64, speed: f64) -> Option<(f64, LossCause)> {
        let passed = wall - self.begin;
        if passed < WINDOW {
            return None;
        }
        let Self { computing, held, changing, lost: before, .. } =
            std::mem::replace(self, Self { begin: wall, lost, ..Self::default() });
        let recent = lost - before;
        if recent <= 0.0 {
            return None;
        }
        let missing = recent / speed;
        let elsewhere = missing - held - changing;
        // Whether the processor would have been enough for all, at the cost that a simulated second had.
        let cause = if computing >= FULL * (passed - missing) {
            LossCause::Cost
        } else if held >= changing.max(elsewhere) {
            LossCause::Clients
        } else if changing >= elsewhere {
            LossCause::Changes
        } else {
            LossCause::Outside
        };
        Some((recent, cause))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cause of 1.9 s that were lost in 3 s.
    fn cause(computing: f64, held: f64, changing: f64) -> LossCause {
        let mut losses = Losses::default();
        losses.compute(Duration::from_secs_f64(computing));
        let before = losses.changing();
        losses.change(Duration::from_secs_f64(changing));
        losses.hold(Duration::from_secs_f64(held + changing), before);
        assert_eq!(losses.report(0.5, 0.1, 1.0), None, "within the window");
        let (lost, cause) = losses.report(3.0, 1.9, 1.0).expect("a loss");
        assert_eq!(lost, 1.9);
        losses.compute(Duration::from_millis(500));
        losses.skip(600.0);
        assert_eq!(losses.report(603.5, 1.9, 1.0), None, "within the next window, which has a pause");
        assert_eq!(losses.report(604.0, 2.4, 1.0).map(|(_, cause)| cause), Some(LossCause::Cost));
        assert_eq!(losses.report(606.0, 2.4, 1.0), None, "nothing new");
        cause
    }

    #[test]
    fn the_scene_is_blamed_for_its_own_cost_only() {
        assert_eq!(cause(2.9, 0.0, 0.0), LossCause::Cost);
        // Slow once: 2 s of one iteration, and 0.3 s of others.
        assert_eq!(cause(2.3, 0.0, 0.0), LossCause::Cost);
        // These were all called too heavy.
        assert_eq!(cause(0.3, 0.0, 0.0), LossCause::Outside);
        assert_eq!(cause(0.3, 2.0, 0.0), LossCause::Clients);
        assert_eq!(cause(0.3, 0.0, 2.0), LossCause::Changes);
    }

    #[test]
    fn at_a_tenth_of_the_speed_the_scene_may_cost_ten_times_as_much() {
        let mut losses = Losses::default();
        losses.compute(Duration::from_millis(300));
        // 0.095 simulated s are 0.95 s of the clock.
        assert_eq!(losses.report(2.0, 0.095, 0.1), Some((0.095, LossCause::Outside)));
        losses.compute(Duration::from_secs(2));
        assert_eq!(losses.report(4.0, 0.19, 0.1).expect("a loss").1, LossCause::Cost);
    }
}
