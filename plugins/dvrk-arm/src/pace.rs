//! When a command is sent, repeated or replaced by zero.

use std::time::{Duration, Instant};

/// A command that is older is not repeated any more: whoever gave it has stalled or gone.
pub(crate) const WATCHDOG: Duration = Duration::from_millis(50);

/// Period at which a command is repeated.
const PERIOD: Duration = Duration::from_millis(1);

/// A caller that gives commands at about 1 kHz is not doubled by repetitions.
const PATIENCE: Duration = Duration::from_micros(1500);

/// Wake-ups while there is nothing to do.
const IDLE: Duration = Duration::from_millis(20);

/// What to do now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Act {
    Nothing,
    /// Send the newest command.
    Command,
    /// Commands flow, but the clutch is pressed: send no force of the simulation's.
    Clutched,
    /// Send no force at all.
    Zero,
}

/// What is known when a decision is made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Situation {
    pub now: Instant,
    /// Number of the newest command and when it was given.
    pub command: Option<(u64, Instant)>,
    /// The clutch is pressed: no force.
    pub clutched: bool,
    /// Somebody is connected.
    pub listening: bool,
}

/// Decides for one arm.
#[derive(Debug)]
pub(crate) struct Pace {
    seen: u64,
    sent: Option<Instant>,
    /// Commands flow.
    active: bool,
    clutched: bool,
    listening: bool,
}

impl Pace {
    /// Nothing sent yet; commands up to number `seen` are old.
    pub fn new(seen: u64) -> Self {
        Self { seen, sent: None, active: false, clutched: false, listening: false }
    }

    /// What to do in `situation`, and how long to wait if nothing happens.
    pub fn step(&mut self, situation: Situation) -> (Act, Duration) {
        let Situation { now, command, clutched, listening } = situation;
        let pressed = !std::mem::replace(&mut self.clutched, clutched) && clutched;
        let connected = !std::mem::replace(&mut self.listening, listening) && listening;
        let fresh = command.filter(|&(_, at)| now.saturating_duration_since(at) <= WATCHDOG);
        let act = match fresh {
            _ if !listening => {
                self.active = false;
                Act::Nothing
            }
            // What the arm holds from an earlier user is wiped first.
            _ if connected => Act::Zero,
            None if std::mem::take(&mut self.active) => Act::Zero,
            None => Act::Nothing,
            // One that was there before anybody listened or before the clutch is not new, but still wanted.
            Some((number, at)) => {
                let new = number != self.seen;
                let due = self.sent.is_none_or(|sent| now.saturating_duration_since(sent) >= PERIOD)
                    && now.saturating_duration_since(at) >= PATIENCE;
                if new || due || pressed {
                    self.seen = number;
                    self.active = true;
                    if clutched {
                        Act::Clutched
                    } else {
                        Act::Command
                    }
                } else {
                    Act::Nothing
                }
            }
        };
        if act != Act::Nothing {
            self.sent = Some(now);
        }
        let wait = match (fresh, self.sent) {
            (Some((_, at)), Some(sent)) if listening => {
                let next = (sent + PERIOD).max(at + PATIENCE);
                next.saturating_duration_since(now).max(Duration::from_micros(50))
            }
            _ => IDLE,
        };
        (act, wait)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps each 0.25 ms of `ms`; commands come every `period` ms until `until`, the clutch is pressed in `clutch`.
    fn run(ms: u32, period: u32, until: u32, clutch: std::ops::Range<u32>) -> Vec<(f64, Act)> {
        let begin = Instant::now();
        let (mut pace, mut command, mut acts) = (Pace::new(0), None, Vec::new());
        for quarter in 0..ms * 4 {
            let now = begin + Duration::from_micros(250) * quarter;
            let t = quarter / 4;
            if quarter % (4 * period) == 0 && t < until {
                command = Some((u64::from(t / period) + 1, now));
            }
            let (act, _) = pace.step(Situation { now, command, clutched: clutch.contains(&t), listening: true });
            if act != Act::Nothing {
                acts.push((f64::from(quarter) / 4.0, act));
            }
        }
        acts
    }

    #[test]
    fn the_first_is_zero_and_a_fast_caller_is_not_doubled() {
        let acts = run(1000, 1, 1000, 0..0);
        assert_eq!(acts[0], (0.0, Act::Zero));
        assert!(acts[1..].iter().all(|(_, act)| *act == Act::Command));
        assert!((999..=1001).contains(&acts.len()), "{}", acts.len());
    }

    #[test]
    fn a_slow_caller_is_repeated_at_one_kilohertz() {
        let acts = run(1000, 10, 1000, 0..0);
        assert!((900..=1001).contains(&acts.len()), "{}", acts.len());
    }

    #[test]
    fn a_stalled_caller_is_zeroed_once() {
        let acts = run(300, 1, 100, 0..0);
        let (last, before) = (acts[acts.len() - 1], acts[acts.len() - 2]);
        assert_eq!((last.1, before.1), (Act::Zero, Act::Command));
        assert!(last.0 > 149.0 && last.0 < 150.0, "50 ms after the last command at 99 ms: {last:?}");
    }

    #[test]
    fn the_clutch_zeroes_at_once_and_for_long() {
        let acts = run(100, 10, 100, 33..60);
        let zeroed: Vec<f64> = acts.iter().filter(|(_, act)| *act == Act::Clutched).map(|(t, _)| *t).collect();
        assert_eq!(zeroed[0], 33.0, "not at the next repetition");
        assert!(zeroed.len() > 20 && zeroed.iter().all(|t| (33.0..60.0).contains(t)), "{zeroed:?}");
        assert!(acts.iter().any(|(t, act)| *t < 62.0 && *t >= 60.0 && *act == Act::Command), "and it goes on");
    }

    #[test]
    fn nobody_is_told_nothing_and_who_comes_is_told_zero_first() {
        let (mut pace, now) = (Pace::new(0), Instant::now());
        let mut step = |ms: u64, listening| {
            let now = now + Duration::from_millis(ms);
            pace.step(Situation { now, command: Some((ms + 1, now)), clutched: false, listening }).0
        };
        assert_eq!([step(0, false), step(1, true), step(2, true)], [Act::Nothing, Act::Zero, Act::Command]);
        assert_eq!([step(3, false), step(4, true), step(5, true)], [Act::Nothing, Act::Zero, Act::Command]);
    }
}
