//! Whether helpers make the steps of many worlds faster, found out by measuring.

use std::time::Duration;

/// Who makes the steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// The caller, one world after the other.
    Alone,
    /// The caller and helpers.
    Helped,
}

impl Way {
    fn other(self) -> Self {
        match self {
            Way::Alone => Way::Helped,
            Way::Helped => Way::Alone,
        }
    }
}

/// Calls are judged together until they took so long: the scheduler takes a core away for some milliseconds at a time,
/// which a single short call says nothing about.
const WINDOW: Duration = Duration::from_millis(20);

/// After so much time in calls the other way is tried for a window: a fiftieth of the time is spent on it.
const TRIAL_EVERY: Duration = Duration::from_millis(1000);

/// Windows after which it is tried at once when the way that is used has become slower than the other one was.
const SOONEST: u32 = 3;

/// How much faster the other way must be.
const CLEARLY: f64 = 1.05;

/// Weight of the latest window in the rate of the way that is used, and in that of the other one: where cores are taken
/// for milliseconds at a time, a single window is a matter of luck.
const WEIGHT: f64 = 0.3;
const TRIAL_WEIGHT: f64 = 0.5;

/// A call that takes so long, even the shortest, is worth helpers in any case: waking them costs nothing beside it, and
/// they get their share of cores that others use, too.
const LONG: Duration = Duration::from_millis(5);

/// Chooses the faster way for calls of one kind, from how long they took.
///
/// Nothing tells beforehand whether helpers pay: that depends on what a step costs, on how long a sleeping core takes
/// to wake up, and on other programs. On a machine whose cores are all taken, a helper that has begun a world may lose
/// its core in the middle of it for longer than the caller needs for all worlds.
#[derive(Debug)]
pub(super) struct Choice {
    favourite: Way,
    is_trial: bool,
    /// Iterations/s, alone and helped.
    rates: [Option<f64>; 2],
    /// Of the present window.
    iterations: f64,
    time: Duration,
    shortest: Duration,
    /// Since the latest trial.
    since_trial: Duration,
    windows: u32,
}

impl Default for Choice {
    fn default() -> Self {
        Self {
            favourite: Way::Helped,
            is_trial: false,
            rates: [None; 2],
            iterations: 0.0,
            time: Duration::ZERO,
            shortest: Duration::MAX,
            since_trial: Duration::ZERO,
            windows: 0,
        }
    }
}

impl Choice {
    /// The way of the next call.
    pub fn way(&self) -> Way {
        if self.is_trial {
            self.favourite.other()
        } else {
            self.favourite
        }
    }

    /// Takes to account a call that made `iterations` (of all worlds together). One that began before the way changed
    /// says nothing.
    pub fn record(&mut self, way: Way, iterations: u64, took: Duration) {
        if way != self.way() {
            return;
        }
        self.iterations += iterations as f64;
        self.time += took;
        self.shortest = self.shortest.min(took);
        if self.time >= WINDOW {
            self.close_window();
        }
    }

    fn close_window(&mut self) {
        let rate = self.iterations / self.time.as_secs_f64();
        let (time, shortest) = (self.time, self.shortest);
        (self.iterations, self.time, self.shortest) = (0.0, Duration::ZERO, Duration::MAX);
        if self.is_trial {
            self.end_trial(rate);
            return;
        }
        let now = self.learn(self.favourite, rate, WEIGHT);
        self.since_trial += time;
        self.windows += 1;
        let is_due = match self.rates[self.favourite.other() as usize] {
            None => true,
            Some(other) => self.since_trial >= TRIAL_EVERY || self.windows >= SOONEST && now < other,
        };
        if shortest >= LONG {
            self.favourite = Way::Helped;
        } else {
            self.is_trial = is_due;
        }
    }

    fn learn(&mut self, way: Way, rate: f64, weight: f64) -> f64 {
        let mine = &mut self.rates[way as usize];
        let now = mine.map_or(rate, |before| before + weight * (rate - before));
        *mine = Some(now);
        now
    }

    fn end_trial(&mut self, rate: f64) {
        let tried = self.favourite.other();
        let rate = self.learn(tried, rate, TRIAL_WEIGHT);
        if self.rates[self.favourite as usize].is_none_or(|present| rate > CLEARLY * present) {
            self.favourite = tried;
        }
        (self.is_trial, self.since_trial, self.windows) = (false, Duration::ZERO, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Calls of 8 iterations for `seconds`, which take as long as told, µs; part of the time that was spent helped.
    fn helped_part(choice: &mut Choice, seconds: f64, cost: impl Fn(Way) -> f64) -> f64 {
        let (mut all, mut helped) = (0.0, 0.0);
        while all < seconds {
            let way = choice.way();
            let took = 1e-6 * cost(way);
            all += took;
            helped += if way == Way::Helped { took } else { 0.0 };
            choice.record(way, 8, Duration::from_secs_f64(took));
        }
        helped / all
    }

    fn two_costs(alone: f64, helped: f64) -> impl Fn(Way) -> f64 {
        move |way| if way == Way::Alone { alone } else { helped }
    }

    #[test]
    fn the_faster_way_gets_nearly_all_of_the_time() {
        let mut choice = Choice::default();
        assert!(helped_part(&mut choice, 10.0, two_costs(100.0, 60.0)) > 0.97);
        let mut choice = Choice::default();
        assert!(helped_part(&mut choice, 10.0, two_costs(100.0, 1000.0)) < 0.03);
    }

    #[test]
    fn a_change_is_followed() {
        let mut choice = Choice::default();
        helped_part(&mut choice, 3.0, two_costs(100.0, 60.0));
        // Others take the cores.
        assert!(helped_part(&mut choice, 5.0, two_costs(150.0, 2000.0)) < 0.1);
        assert_eq!(choice.favourite, Way::Alone);
        // They are gone.
        assert!(helped_part(&mut choice, 5.0, two_costs(100.0, 60.0)) > 0.7);
        assert_eq!(choice.favourite, Way::Helped);
    }

    #[test]
    fn a_trial_that_was_lucky_is_soon_mended() {
        let mut choice = Choice::default();
        helped_part(&mut choice, 0.5, two_costs(100.0, 1000.0));
        (choice.favourite, choice.rates[Way::Helped as usize]) = (Way::Helped, Some(160e3));
        assert!(helped_part(&mut choice, 1.0, two_costs(100.0, 1000.0)) < 0.2);
    }

    #[test]
    fn long_calls_are_always_helped() {
        let mut choice = Choice::default();
        // Equal costs: nothing but their length decides.
        assert_eq!(helped_part(&mut choice, 10.0, two_costs(30_000.0, 30_000.0)), 1.0);
    }
}
