//! Which bases stream, and for how many of their controllers: the stream of a base ends with the last of them.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;

/// Controllers in use, by base.
#[derive(Debug, Clone, Default)]
pub(super) struct Streams(Arc<Mutex<BTreeMap<String, [bool; 2]>>>);

/// The part of one controller in the stream of its base.
#[derive(Debug)]
pub(super) struct Stream {
    streams: Streams,
    base: String,
    controller: usize,
    left: bool,
}

impl Streams {
    /// Claims a controller; `None` if it is in use.
    pub fn join(&self, base: &str, controller: usize) -> Option<Stream> {
        let mut bases = self.0.lock();
        let used = bases.entry(base.to_owned()).or_default().get_mut(controller)?;
        if *used {
            return None;
        }
        *used = true;
        Some(Stream { streams: self.clone(), base: base.to_owned(), controller, left: false })
    }
}

impl Stream {
    /// Gives the controller back, and calls `stop` if it was the last of its base.
    pub fn leave(&mut self, stop: impl FnOnce()) {
        if std::mem::replace(&mut self.left, true) {
            return;
        }
        // The lock is kept while the stream is stopped: a controller that is opened meanwhile starts it again, after
        // that.
        let mut bases = self.streams.0.lock();
        let Some(used) = bases.get_mut(&self.base) else { return };
        used[self.controller] = false;
        if *used == [false; 2] {
            stop();
        }
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.leave(|| {});
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_controller_stops_the_stream() {
        let streams = Streams::default();
        let mut left = streams.join("usb-1", 0).unwrap();
        let mut right = streams.join("usb-1", 1).unwrap();
        assert!(streams.join("usb-1", 0).is_none() && streams.join("usb-1", 2).is_none());
        let mut stopped = 0;
        left.leave(|| stopped += 1);
        left.leave(|| stopped += 10);
        assert_eq!(stopped, 0);
        right.leave(|| stopped += 1);
        assert_eq!(stopped, 1);
        assert!(streams.join("usb-1", 0).is_some());
    }

    #[test]
    fn a_controller_that_is_dropped_is_free() {
        let streams = Streams::default();
        drop(streams.join("usb-1", 1));
        assert!(streams.join("usb-1", 1).is_some());
    }
}
