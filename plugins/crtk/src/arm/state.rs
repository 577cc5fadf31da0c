//! Operating states.

use std::fmt;

/// Operating state of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum State {
    /// Holds still and takes no motion command.
    Disabled,
    /// Takes motion commands when it is homed, too.
    #[default]
    Enabled,
    /// Holds still until it is resumed.
    Paused,
    /// Holds still until the fault is cleared.
    Fault,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Disabled => "DISABLED",
            Self::Enabled => "ENABLED",
            Self::Paused => "PAUSED",
            Self::Fault => "FAULT",
        })
    }
}

/// How an arm speaks and behaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Dialect {
    /// The contract that the dVRK simulators share.
    #[default]
    Contract,
    /// That with the extras of the real dVRK, and its rules.
    Dvrk,
    /// The surgical robotics challenge.
    Src,
    /// The configuration of the C++ simulator's CRTK plugin.
    Plugin,
}

impl Dialect {
    /// What the frame of the base of `arm` is called. The challenge's interface calls it so whatever the body is called.
    pub fn base_frame(self, arm: &str) -> String {
        match self {
            Self::Src => format!("{arm}/baselink"),
            _ => format!("{arm}_base"),
        }
    }

    /// Whether states follow the documents of CRTK, as on the robot; else those of the simulators' contract.
    fn is_crtk(self) -> bool {
        self == Self::Dvrk
    }
}

/// What a state command does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The state becomes, or stays, this.
    Is(State),
    /// Whether it is homed becomes, or stays, this.
    Homed(bool),
    /// Not in this state.
    Refused,
    /// There is no such command.
    Unknown,
}

/// All commands, in any dialect.
const COMMANDS: [&str; 9] = ["enable", "disable", "pause", "resume", "home", "unhome", "fault", "clear_fault", "reset"];

/// What a command does in a state. Case and blanks at the ends do not matter.
pub fn outcome(command: &str, state: State, dialect: Dialect) -> Outcome {
    use Outcome::{Homed, Is, Refused, Unknown};
    use State::{Disabled, Enabled, Fault, Paused};
    let crtk = dialect.is_crtk();
    let known = COMMANDS.iter().find(|known| known.eq_ignore_ascii_case(command.trim()));
    match (known.copied().unwrap_or_default(), state) {
        ("enable", Disabled | Enabled) => Is(Enabled),
        ("enable", Paused) if !crtk => Is(Enabled),
        ("enable", Fault) if crtk => Is(Enabled),
        ("disable", _) => Is(Disabled),
        ("pause", Enabled) => Is(Paused),
        ("pause", Paused) if crtk => Is(Paused),
        ("resume", Paused) => Is(Enabled),
        ("home", _) => Homed(true),
        ("unhome", _) => Homed(false),
        ("fault", _) if !crtk => Is(Fault),
        ("clear_fault" | "reset", Fault) if !crtk => Is(Disabled),
        ("enable" | "pause" | "resume", _) => Refused,
        ("clear_fault" | "reset", _) if !crtk => Refused,
        _ => Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATES: [State; 4] = [State::Disabled, State::Enabled, State::Paused, State::Fault];

    fn row(command: &str, dialect: Dialect) -> Vec<Outcome> {
        STATES.iter().map(|&state| outcome(command, state, dialect)).collect()
    }

    #[test]
    fn the_table_of_crtk() {
        use Outcome::{Is, Refused, Unknown};
        use State::{Disabled, Enabled, Paused};
        let row = |command| row(command, Dialect::Dvrk);
        assert_eq!(row("enable"), [Is(Enabled), Is(Enabled), Refused, Is(Enabled)]);
        assert_eq!(row("disable"), [Is(Disabled); 4]);
        assert_eq!(row("pause"), [Refused, Is(Paused), Is(Paused), Refused]);
        assert_eq!(row("resume"), [Refused, Refused, Is(Enabled), Refused]);
        assert_eq!(row("fault"), [Unknown; 4]);
    }

    #[test]
    fn the_table_of_the_simulators() {
        use Outcome::{Homed, Is, Refused, Unknown};
        use State::{Disabled, Enabled, Fault, Paused};
        let row = |command| row(command, Dialect::Contract);
        assert_eq!(row(" Enable\n"), [Is(Enabled), Is(Enabled), Is(Enabled), Refused]);
        assert_eq!(row("DISABLE"), [Is(Disabled); 4]);
        assert_eq!(row("pause"), [Refused, Is(Paused), Refused, Refused]);
        assert_eq!(row("resume"), [Refused, Refused, Is(Enabled), Refused]);
        assert_eq!(row("fault"), [Is(Fault); 4]);
        assert_eq!(row("reset"), [Refused, Refused, Refused, Is(Disabled)]);
        assert_eq!(row("clear_fault"), row("reset"));
        assert_eq!(row("home"), [Homed(true); 4]);
        assert_eq!(row("unhome"), [Homed(false); 4]);
        assert_eq!(row("dance"), [Unknown; 4]);
    }
}
