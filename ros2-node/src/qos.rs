//! Quality of service: what of DDS's is used.

use rustdds::qos::policy;
use rustdds::{QosPolicies, QosPolicyBuilder};

/// Unacknowledged messages that a publication keeps at least: acknowledgements come each 0.1 s.
pub const MIN_WINDOW: u32 = 512;

/// Unacknowledged messages that a publication keeps at most.
pub const MAX_WINDOW: u32 = 8192;

/// How messages of a topic are kept and delivered. Begin with one of the functions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Lost messages are sent again. Subscriptions that ask for less match, too.
    pub reliable: bool,
    /// Subscriptions that come later get the last messages (`transient local`).
    pub latched: bool,
    /// Messages that are kept for a subscription that is slow, or, if they are latched, for one that comes later.
    pub depth: u32,
    /// Messages that a publication keeps until all reliable subscriptions have acknowledged them. Beyond that none is
    /// sent until the publication has been made anew, see [`Publication::send`](crate::Publication::send).
    pub window: u32,
}

impl Qos {
    /// Reliable, volatile, the last ten: the default of ROS 2. Window: the smallest.
    pub const fn new() -> Self {
        Self { reliable: true, latched: false, depth: 10, window: MIN_WINDOW }
    }

    /// Reliable, for subscriptions that come later, the last one.
    pub const fn latched() -> Self {
        Self { reliable: true, latched: true, depth: 1, window: MIN_WINDOW }
    }

    /// For states that are published at most at `frequency`, Hz: twenty seconds of them may be unacknowledged, as long
    /// as other implementations wait until they give a peer up.
    pub fn states(frequency: f64) -> Self {
        // A number that is none gives the smallest.
        let window = ((20.0 * frequency) as u32).clamp(MIN_WINDOW, MAX_WINDOW);
        Self { window, ..Self::new() }
    }

    /// For messages of about so many bytes, of which 16 MB may be unacknowledged.
    pub fn large(bytes: usize) -> Self {
        let window = (16_000_000 / bytes.max(1)).clamp(8, MIN_WINDOW as usize) as u32;
        Self { depth: 2, window, ..Self::new() }
    }

    /// With another depth.
    #[must_use]
    pub const fn with_depth(self, depth: u32) -> Self {
        Self { depth, ..self }
    }

    fn builder(self) -> QosPolicyBuilder {
        let reliability = if self.reliable {
            policy::Reliability::Reliable { max_blocking_time: rustdds::Duration::ZERO }
        } else {
            policy::Reliability::BestEffort
        };
        let durability = if self.latched { policy::Durability::TransientLocal } else { policy::Durability::Volatile };
        let depth = i32::try_from(self.depth.max(1)).unwrap_or(i32::MAX);
        QosPolicyBuilder::new()
            .reliability(reliability)
            .durability(durability)
            .history(policy::History::KeepLast { depth })
    }

    pub(crate) fn of_writer(self) -> QosPolicies {
        let samples = i32::try_from(self.window.max(1)).unwrap_or(i32::MAX);
        let limits =
            policy::ResourceLimits { max_samples: samples, max_instances: 1, max_samples_per_instance: samples };
        self.builder().resource_limits(limits).build()
    }

    pub(crate) fn of_reader(self) -> QosPolicies {
        // Without, RustDDS keeps 64.
        let depth = i32::try_from(self.depth.max(1)).unwrap_or(i32::MAX);
        let limits = policy::ResourceLimits { max_samples: depth, max_instances: 1, max_samples_per_instance: depth };
        self.builder().resource_limits(limits).build()
    }
}

impl Default for Qos {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_bounded() {
        assert_eq!(Qos::states(50.0).window, 1000);
        assert_eq!(Qos::states(1000.0).window, MAX_WINDOW);
        assert_eq!(Qos::states(f64::NAN).window, MIN_WINDOW);
        assert_eq!(Qos::large(1_000_000).window, 16);
        assert_eq!(Qos::large(100_000_000).window, 8);
        assert_eq!(Qos::large(0).window, MIN_WINDOW);
    }
}
