//! What an arm is ready for, and the commands that change it.

use std::time::{Duration, Instant};

/// How long homing takes.
pub(crate) const HOMING: Duration = Duration::from_millis(500);

/// Operating state of a fake arm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Machine {
    /// `DISABLED`, `ENABLED`, `PAUSED` or `FAULT`.
    pub state: &'static str,
    /// Whether it is homed.
    pub homed: bool,
    homing: Option<Instant>,
}

/// States by name.
const STATES: [&str; 4] = ["DISABLED", "ENABLED", "PAUSED", "FAULT"];

impl Machine {
    /// In a state of that name; `None` if there is no such state.
    pub fn new(state: &str, homed: bool) -> Option<Self> {
        let state = STATES.into_iter().find(|name| name.eq_ignore_ascii_case(state))?;
        Some(Self { state, homed, homing: None })
    }

    /// Whether it is homing.
    pub fn is_busy(&self) -> bool {
        self.homing.is_some()
    }

    /// Obeys a command as far as its state allows; whether it did.
    pub fn command(&mut self, command: &str, now: Instant) -> bool {
        let state = match (command, self.state) {
            ("enable", "DISABLED" | "FAULT") => "ENABLED",
            ("disable", _) => "DISABLED",
            ("pause", "ENABLED") => "PAUSED",
            ("resume", "PAUSED") => "ENABLED",
            ("home", "ENABLED") => {
                self.homing = Some(now);
                "ENABLED"
            }
            ("unhome", state) => {
                self.homed = false;
                state
            }
            _ => return false,
        };
        if state != "ENABLED" {
            self.homing = None;
        }
        self.state = state;
        true
    }

    /// Goes on with homing.
    pub fn step(&mut self, now: Instant) {
        if self.homing.is_some_and(|begin| now.saturating_duration_since(begin) >= HOMING) {
            (self.homing, self.homed) = (None, true);
        }
    }

    /// Something has gone wrong.
    pub fn fault(&mut self) {
        (self.state, self.homing) = ("FAULT", None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transitions_are_those_of_crtk() {
        let now = Instant::now();
        let mut machine = Machine::new("disabled", false).unwrap();
        assert!(!machine.command("home", now) && !machine.command("pause", now) && !machine.command("resume", now));
        assert!(machine.command("enable", now) && machine.command("home", now));
        assert!(machine.is_busy() && !machine.homed);
        machine.step(now + HOMING / 2);
        assert!(machine.is_busy());
        machine.step(now + HOMING);
        assert!(!machine.is_busy() && machine.homed);
        assert!(machine.command("pause", now) && machine.state == "PAUSED" && machine.command("resume", now));
        machine.fault();
        assert!(!machine.command("resume", now) && machine.command("enable", now) && machine.homed);
        assert!(machine.command("unhome", now) && !machine.homed && machine.state == "ENABLED");
        assert!(machine.command("disable", now) && !machine.command("nonsense", now));
        assert!(Machine::new("asleep", true).is_none());
    }
}
