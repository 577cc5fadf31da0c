//! What a participant is made with, and what the environment says about it.

use std::fmt::Arguments;
use std::sync::Arc;

/// Where a participant says what its user should know, a line at a time; called from any thread.
pub type Report = Arc<dyn Fn(Arguments<'_>) + Send + Sync>;

/// Says nothing.
pub fn silent() -> Report {
    Arc::new(|_| ())
}

/// Highest domain: beyond it the ports of participants overlap with those that systems give to anybody.
pub const HIGHEST_DOMAIN: u16 = 101;

/// Where other participants are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Range {
    /// On this machine: packets only go through its loopback interface.
    Localhost,
    /// On all networks that this machine is part of.
    Subnet,
    /// Nowhere: the participant announces itself to nobody.
    Off,
}

/// Bytes of the identifiers in `ros_discovery_info`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GidLength {
    /// Iron and later: 16.
    Iron,
    /// Humble and before: 24.
    Humble,
}

impl GidLength {
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::Iron => 16,
            Self::Humble => 24,
        }
    }
}

/// What a participant is made with.
#[derive(Clone)]
pub struct Options {
    /// Participants of other domains are not seen. Default: 0.
    pub domain: u16,
    /// Default: [`Range::Localhost`].
    pub range: Range,
    /// Default: [`GidLength::Iron`].
    pub gids: GidLength,
    /// Default: [`silent`].
    pub report: Report,
}

impl Default for Options {
    fn default() -> Self {
        Self { domain: 0, range: Range::Localhost, gids: GidLength::Iron, report: silent() }
    }
}

impl std::fmt::Debug for Options {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { domain, range, gids, report: _ } = self;
        f.debug_struct("Options").field("domain", domain).field("range", range).field("gids", gids).finish()
    }
}

/// Why a variable of the environment cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EnvironmentError {
    /// Error when ROS_DOMAIN_ID is no number from 0 to 101.
    #[error("ROS_DOMAIN_ID is \"{0}\", not a number from 0 to {HIGHEST_DOMAIN}")]
    Domain(String),
    /// Error when ROS_AUTOMATIC_DISCOVERY_RANGE is none of its four words.
    #[error("ROS_AUTOMATIC_DISCOVERY_RANGE is \"{0}\", not SUBNET, LOCALHOST, OFF or SYSTEM_DEFAULT")]
    Range(String),
}

impl Options {
    /// What the environment says, with `report` to say what of it is not honoured.
    ///
    /// `ROS_DOMAIN_ID`; `ROS_LOCALHOST_ONLY=1` (deprecated in ROS 2), else `ROS_AUTOMATIC_DISCOVERY_RANGE`, where
    /// `SYSTEM_DEFAULT` means `SUBNET`, as in ROS 2. Unlike there, nothing leaves this machine where neither is set.
    /// `ROS_STATIC_PEERS` has no effect. `ROS_DISTRO=humble` chooses [`GidLength::Humble`].
    ///
    /// # Errors
    /// [`EnvironmentError`] when a variable has a value that ROS 2 does not know.
    pub fn from_environment(report: Report) -> Result<Self, EnvironmentError> {
        Self::from_variables(report, |name| std::env::var(name).ok().filter(|value| !value.is_empty()))
    }

    fn from_variables(report: Report, of: impl Fn(&str) -> Option<String>) -> Result<Self, EnvironmentError> {
        let domain = match of("ROS_DOMAIN_ID") {
            Some(text) => domain(&text)?,
            None => 0,
        };
        let mut range = match of("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
            None | Some("LOCALHOST") => Range::Localhost,
            Some("SUBNET" | "SYSTEM_DEFAULT") => Range::Subnet,
            Some("OFF") => Range::Off,
            Some(other) => return Err(EnvironmentError::Range(other.into())),
        };
        if of("ROS_LOCALHOST_ONLY").as_deref() == Some("1") {
            report(format_args!(
                "ROS_LOCALHOST_ONLY is deprecated: ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST says the same"
            ));
            range = Range::Localhost;
        }
        if of("ROS_STATIC_PEERS").is_some() {
            report(format_args!(
                "ROS_STATIC_PEERS has no effect: peers are only found by multicast and on this machine"
            ));
        }
        let gids = match of("ROS_DISTRO").as_deref() {
            Some("humble" | "galactic" | "foxy") => GidLength::Humble,
            _ => GidLength::Iron,
        };
        Ok(Self { domain, range, gids, report })
    }
}

fn domain(text: &str) -> Result<u16, EnvironmentError> {
    let number = text.trim().parse().ok().filter(|&number: &u16| number <= HIGHEST_DOMAIN);
    number.ok_or_else(|| EnvironmentError::Domain(text.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(variables: &[(&str, &str)]) -> Result<Options, EnvironmentError> {
        let find = |name: &str| variables.iter().find(|(own, _)| *own == name).map(|(_, value)| (*value).to_owned());
        Options::from_variables(silent(), find)
    }

    #[test]
    fn nothing_leaves_the_machine_unless_asked_for() {
        let none = options(&[]).unwrap();
        assert_eq!((none.domain, none.range, none.gids), (0, Range::Localhost, GidLength::Iron));
        for (value, range) in [
            ("SUBNET", Range::Subnet),
            ("SYSTEM_DEFAULT", Range::Subnet),
            ("LOCALHOST", Range::Localhost),
            ("OFF", Range::Off),
        ] {
            assert_eq!(options(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", value)]).unwrap().range, range);
        }
        let both = [("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"), ("ROS_LOCALHOST_ONLY", "1")];
        assert_eq!(options(&both).unwrap().range, Range::Localhost);
        assert_eq!(options(&[("ROS_DISTRO", "humble")]).unwrap().gids, GidLength::Humble);
    }

    #[test]
    fn values_that_are_none_are_errors() {
        assert_eq!(options(&[("ROS_DOMAIN_ID", "42")]).unwrap().domain, 42);
        for wrong in ["x", "-1", "102", "70000"] {
            assert_eq!(options(&[("ROS_DOMAIN_ID", wrong)]).unwrap_err(), EnvironmentError::Domain(wrong.into()));
        }
        let range = options(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "near")]);
        assert_eq!(range.unwrap_err(), EnvironmentError::Range("near".into()));
    }
}
