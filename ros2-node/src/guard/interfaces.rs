//! The network interfaces of this machine.

use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

/// How often the list is read again, at most: cables are plugged in, and addresses change.
const EVERY: Duration = Duration::from_secs(2);

/// Addresses of this machine, and the networks that they are part of. IPv4, as the sockets of RustDDS.
#[derive(Debug, Clone)]
pub struct Interfaces {
    /// Address and mask of each.
    networks: Vec<(Ipv4Addr, Ipv4Addr)>,
    /// When the list was read; `None`: it is given.
    read: Option<Instant>,
}

impl Interfaces {
    /// Those of this machine. What changes is noticed within two seconds.
    pub fn of_this_machine() -> Self {
        Self { networks: read(), read: Some(Instant::now()) }
    }

    /// Given ones: address and mask of each.
    pub fn given(networks: Vec<(Ipv4Addr, Ipv4Addr)>) -> Self {
        Self { networks, read: None }
    }

    /// Whether `address` is one of this machine.
    pub(super) fn has(&mut self, address: Ipv4Addr, now: Instant) -> bool {
        self.is_listed(address) || self.renew(now) && self.is_listed(address)
    }

    /// Whether `address` is part of a network that this machine is part of.
    pub(super) fn is_near(&mut self, address: Ipv4Addr, now: Instant) -> bool {
        self.is_in_network(address) || self.renew(now) && self.is_in_network(address)
    }

    /// The same as [`has`](Self::has), by the list as it is.
    pub(super) fn is_listed(&self, address: Ipv4Addr) -> bool {
        address.is_loopback() || self.networks.iter().any(|(own, _)| *own == address)
    }

    /// The same as [`is_near`](Self::is_near), by the list as it is.
    pub(super) fn is_in_network(&self, address: Ipv4Addr) -> bool {
        let in_network = |(own, mask): &(Ipv4Addr, Ipv4Addr)| {
            let mask = mask.to_bits();
            !own.is_loopback() && own.to_bits() & mask == address.to_bits() & mask
        };
        self.networks.iter().any(in_network)
    }

    /// Reads the list again if it is time to; whether it was.
    fn renew(&mut self, now: Instant) -> bool {
        let is_due = self.read.is_some_and(|read| now.saturating_duration_since(read) >= EVERY);
        if is_due {
            (self.networks, self.read) = (read(), Some(now));
        }
        is_due
    }
}

fn read() -> Vec<(Ipv4Addr, Ipv4Addr)> {
    let interfaces = netdev::get_interfaces();
    interfaces.iter().flat_map(|interface| &interface.ipv4).map(|net| (net.addr(), net.netmask())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_has_a_loopback_interface_that_is_no_network() {
        let mut own = Interfaces::of_this_machine();
        let now = Instant::now();
        assert!(own.networks.iter().any(|(address, _)| *address == Ipv4Addr::LOCALHOST), "{own:?}");
        assert!(own.has(Ipv4Addr::LOCALHOST, now) && !own.is_near(Ipv4Addr::LOCALHOST, now));
    }

    #[test]
    fn networks_are_told_apart_by_their_masks() {
        let of = |text: &str| text.parse::<Ipv4Addr>().unwrap();
        let mut own = Interfaces::given(vec![(of("192.168.7.3"), of("255.255.255.0"))]);
        let now = Instant::now();
        assert!(own.has(of("192.168.7.3"), now) && !own.has(of("192.168.7.4"), now));
        assert!(own.is_near(of("192.168.7.4"), now) && !own.is_near(of("192.168.8.4"), now));
    }
}
