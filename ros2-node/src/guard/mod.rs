//! What looks at each packet before RustDDS does.
//!
//! Whoever can send UDP packets to a participant can announce participants and endpoints to it; DDS without its security
//! plugins authenticates nobody. The guard drops packets from addresses that the discovery [`Range`] leaves out, packets
//! that are no valid RTPS (Real-Time Publish-Subscribe protocol 2.5, OMG formal/22-04-01), and those of senders that have
//! not announced themselves. Of announcements it bounds numbers and sizes, and it strikes out addresses to which this
//! machine would have to send although they are none of the sender's.
//!
//! What a packet can make RustDDS reserve is bounded by this, and by limits within RustDDS (`third_party/rustdds`).

mod interfaces;
mod packet;

use std::collections::{HashMap, HashSet};
use std::hash::RandomState;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

pub use interfaces::Interfaces;

use crate::environment::{Range, Report};
use packet::{Announcement, Visitor};

/// Identifier of a participant: the first twelve bytes of the identifiers of all it has.
pub type Prefix = [u8; 12];

/// Participants that are known at once, of all machines. On one machine there are at most 120: more have no port.
pub const MAX_PARTICIPANTS: usize = 512;

/// Participants of one address that are known at once.
pub const MAX_PARTICIPANTS_PER_ADDRESS: usize = 128;

/// Endpoints and topics that all participants together can announce.
pub const MAX_ENDPOINTS: usize = 8192;

/// How long a participant is believed to be there after it was heard, at most, s. Common are 10 to 100.
pub const MAX_LEASE_S: u32 = 120;

/// How long a participant is believed to be there that does not say (RTPS 2.5, table 9.14: 100 s).
const DEFAULT_LEASE: Duration = Duration::from_secs(100);

/// Bytes of a message that comes in fragments, at most.
pub const MAX_MESSAGE: u32 = 16 << 20;

/// Why a packet is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// Error when it comes from outside the discovery range.
    #[error("it comes from outside the discovery range")]
    Foreign,
    /// Error when it is no RTPS, or a part of it is not as RTPS says.
    #[error("it is no valid RTPS: {0}")]
    Malformed(&'static str),
    /// Error when it is RTPS that no implementation of ROS 2 sends, and that would redirect answers.
    #[error("it is of a kind that is not used by ROS 2: {0}")]
    Unused(&'static str),
    /// Error when its sender has not announced itself.
    #[error("its sender has not announced itself")]
    Unannounced,
    /// Error when it speaks for another participant than its sender.
    #[error("it speaks for another participant")]
    Impostor,
    /// Error when there are too many participants.
    #[error("there are too many participants")]
    Participants,
    /// Error when there are too many endpoints.
    #[error("there are too many endpoints")]
    Endpoints,
    /// Error when a message is larger than [`MAX_MESSAGE`].
    #[error("a message has more than {MAX_MESSAGE} bytes")]
    Large,
}

/// What is known of a participant.
struct Known {
    address: Ipv4Addr,
    heard: Instant,
    lease: Duration,
    /// Hashes of the endpoints and topics that it has announced.
    announced: HashSet<u64>,
}

/// Looks at packets, and remembers who has announced what. Its memory is bounded.
pub struct Guard {
    range: Range,
    report: Report,
    interfaces: Interfaces,
    own: Arc<OnceLock<Prefix>>,
    known: HashMap<Prefix, Known>,
    endpoints: usize,
    announcements: Vec<Announcement>,
    hashes: RandomState,
    said: HashSet<&'static str>,
}

impl Guard {
    /// For the given discovery range, on a machine with these interfaces. `report` is told once of each limit that is met.
    pub fn new(range: Range, interfaces: Interfaces, report: Report) -> Self {
        Self {
            range,
            report,
            interfaces,
            own: Arc::default(),
            known: HashMap::new(),
            endpoints: 0,
            announcements: Vec::new(),
            hashes: RandomState::new(),
            said: HashSet::new(),
        }
    }

    /// Where the identifier of this participant is to be left when it is known: only this machine may use it.
    pub fn own(&self) -> Arc<OnceLock<Prefix>> {
        Arc::clone(&self.own)
    }

    /// Whether RustDDS gets `packet`, which was sent by `from` and arrived at `now`. Addresses and times in it may be
    /// changed: locators of other machines than the sender's network become invalid, and leases are at most
    /// [`MAX_LEASE_S`].
    ///
    /// # Errors
    /// [`Refusal`] when the packet is to be dropped.
    pub fn check(&mut self, packet: &mut [u8], from: Option<SocketAddr>, now: Instant) -> Result<(), Refusal> {
        let Some(IpAddr::V4(address)) = from.map(|from| from.ip()) else { return Err(Refusal::Foreign) };
        let is_own_machine = self.interfaces.has(address, now);
        let is_in_range = is_own_machine || self.range == Range::Subnet && self.interfaces.is_near(address, now);
        if !is_in_range {
            return Err(Refusal::Foreign);
        }
        let result = self.check_contents(packet, address, is_own_machine, now);
        match result {
            Err(Refusal::Participants) => self.say("more participants than can be told apart: the last are ignored"),
            Err(Refusal::Endpoints) => self.say("more endpoints than can be remembered: the last are ignored"),
            Err(Refusal::Large) => self.say("a message of more than 16 MiB is ignored"),
            _ => (),
        }
        result
    }

    fn check_contents(
        &mut self,
        packet: &mut [u8],
        address: Ipv4Addr,
        is_own_machine: bool,
        now: Instant,
    ) -> Result<(), Refusal> {
        self.announcements.clear();
        let interfaces = &self.interfaces;
        let range = self.range;
        let may_reply_to = |to: Ipv4Addr| {
            // A participant of this machine may be reached at any of its addresses, one of another machine only on the
            // networks that this machine is part of.
            let near = range == Range::Subnet && (interfaces.is_in_network(to) || is_group(to));
            if is_own_machine {
                near || interfaces.is_listed(to)
            } else {
                near && !interfaces.is_listed(to)
            }
        };
        let mut visitor =
            Visitor { announcements: &mut self.announcements, may_reply_to: &may_reply_to, hashes: &self.hashes };
        let prefix = packet::visit(packet, &mut visitor)?;
        if self.own.get() == Some(&prefix) {
            // What this participant has sent itself comes back by multicast.
            return if is_own_machine { Ok(()) } else { Err(Refusal::Impostor) };
        }
        let announcements = std::mem::take(&mut self.announcements);
        let result = self.remember(prefix, address, &announcements, now);
        self.announcements = announcements;
        result
    }

    fn remember(
        &mut self,
        prefix: Prefix,
        address: Ipv4Addr,
        announcements: &[Announcement],
        now: Instant,
    ) -> Result<(), Refusal> {
        for announcement in announcements {
            match *announcement {
                Announcement::Here { lease } => self.admit(prefix, address, lease.unwrap_or(DEFAULT_LEASE), now)?,
                Announcement::Gone => self.forget(&prefix),
                Announcement::Endpoint { hash } => {
                    let known = self.known.get_mut(&prefix).ok_or(Refusal::Unannounced)?;
                    if !known.announced.contains(&hash) {
                        if self.endpoints >= MAX_ENDPOINTS {
                            return Err(Refusal::Endpoints);
                        }
                        self.endpoints += usize::from(known.announced.insert(hash));
                    }
                }
                Announcement::EndpointGone { hash } => {
                    let known = self.known.get_mut(&prefix).ok_or(Refusal::Unannounced)?;
                    self.endpoints -= usize::from(known.announced.remove(&hash));
                }
            }
        }
        let said_good_bye = announcements.iter().any(|announcement| matches!(announcement, Announcement::Gone));
        if said_good_bye || self.known.contains_key(&prefix) {
            Ok(())
        } else {
            Err(Refusal::Unannounced)
        }
    }

    fn admit(&mut self, prefix: Prefix, address: Ipv4Addr, lease: Duration, now: Instant) -> Result<(), Refusal> {
        if let Some(known) = self.known.get_mut(&prefix) {
            (known.heard, known.lease) = (now, lease);
            return Ok(());
        }
        let of_address = |known: &HashMap<Prefix, Known>| known.values().filter(|one| one.address == address).count();
        let is_full = |known: &HashMap<Prefix, Known>| {
            known.len() >= MAX_PARTICIPANTS || of_address(known) >= MAX_PARTICIPANTS_PER_ADDRESS
        };
        if is_full(&self.known) {
            let silent = |known: &Known| now.saturating_duration_since(known.heard) > known.lease;
            let gone: Vec<Prefix> =
                self.known.iter().filter(|(_, known)| silent(known)).map(|(prefix, _)| *prefix).collect();
            gone.iter().for_each(|prefix| self.forget(prefix));
            if is_full(&self.known) {
                return Err(Refusal::Participants);
            }
        }
        self.known.insert(prefix, Known { address, heard: now, lease, announced: HashSet::new() });
        Ok(())
    }

    fn forget(&mut self, prefix: &Prefix) {
        if let Some(known) = self.known.remove(prefix) {
            self.endpoints -= known.announced.len();
        }
    }

    /// Once each.
    fn say(&mut self, what: &'static str) {
        if self.said.insert(what) {
            (self.report)(format_args!("ROS 2: {what}; this is said once"));
        }
    }
}

/// Whether `address` is that of a multicast group as DDS uses them (RTPS 2.5, 9.6.1.4: 239.255.0.1).
fn is_group(address: Ipv4Addr) -> bool {
    address.octets()[..2] == [239, 255]
}

#[cfg(test)]
mod tests;
