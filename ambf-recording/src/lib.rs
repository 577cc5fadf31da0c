//! Recordings of simulations: files from which the same motion can be made again, bit for bit.
//!
//! A [`Writer`] takes what enters a simulation from its physics thread and writes an MCAP file (<https://mcap.dev>). A
//! [`Recording`] reads one, loads its scene, and yields its entries; [`Replay`] lets a simulation do what they say.
//!
//! # The file
//!
//! * A metadata record `ambf.recording` at the beginning: `format` (1), `program`, `version`, `processor`, and `scene`, a
//!   JSON object: files, options, length of a sub-step, and SHA-256 of each file.
//! * An attachment for each description that was read (ADF, URDF), so that it can be looked at when the file has changed.
//! * Messages on the topic `/ambf/recording`, encoding `ambf`: each is a list of entries, each with its length (u32,
//!   little-endian) before it, as [`Entry::write`](ambf_core::sim::Entry::write) makes them. `log_time` is simulated
//!   time, `publish_time` the clock, both in ns.
//! * Messages on the topic `/ambf/notes`, encoding `json`: `{"text": …}`, what somebody noted, for programs that do not
//!   know entries.
//! * A metadata record `ambf.end` with `reason` and `entries` when the file was completed. `stopped`: it is whole; other
//!   reasons: it ended before it was to.
//!
//! A chunk is closed each second, and what is closed can be read, whatever becomes of the writer.

mod header;
mod reader;
mod replay;
mod writer;

use ambf_core::sim::EarlyEnd;

pub use header::{Header, LaterHeader, UsedFile};
pub use reader::{Recording, RecordingError, Timed};
pub use replay::{Replay, ReplayFailure, Step, Targets};
pub use writer::{RecordError, Summary, Writer};

/// Number of the format; a later one cannot be read.
pub const FORMAT: u32 = 1;

pub(crate) const HEADER: &str = "ambf.recording";
pub(crate) const END: &str = "ambf.end";
pub(crate) const TOPIC: &str = "/ambf/recording";
pub(crate) const NOTES: &str = "/ambf/notes";
/// The reason of an end that was asked for.
pub(crate) const STOPPED: &str = "stopped";

/// The reason of an end that came before that, as files have it.
pub(crate) fn reason(why: EarlyEnd) -> &'static str {
    match why {
        EarlyEnd::Slow => "overflow",
        EarlyEnd::TooLarge => "too large",
        EarlyEnd::WentBack => "went back",
    }
}
