//! New connections: how many there may be, and blocks of bytes from them.

use std::io::{self, ErrorKind, Read};
use std::net::{TcpListener, TcpStream};
use std::os::fd::{AsRawFd, RawFd};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Arc;

use super::reactor::{Handler, Turn};

/// How much memory is made ready for bytes that may come, bytes.
const STEP: usize = 16 << 10;

/// A buffer that has held a long block is given back when it is larger than this, bytes.
const KEPT: usize = 256 << 10;

/// Counts open connections.
#[derive(Clone, Default)]
pub(crate) struct Count(Arc<AtomicUsize>);

impl Count {
    /// A place for one more, if there are fewer than `most`.
    pub fn place(&self, most: usize) -> Option<Place> {
        let before = self.0.fetch_add(1, Ordering::AcqRel);
        let place = Place(Arc::clone(&self.0));
        (before < most).then_some(place)
    }
}

/// One of the connections while it is open.
pub(crate) struct Place(Arc<AtomicUsize>);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Hands new connections to a function; those beyond `most` at a time are turned away.
pub(crate) struct Listener<F> {
    pub listener: TcpListener,
    pub count: Count,
    pub most: usize,
    /// Takes a connection that does not block.
    pub greet: F,
}

impl<F: FnMut(TcpStream, Place) + Send> Handler for Listener<F> {
    fn socket(&self) -> RawFd {
        self.listener.as_raw_fd()
    }

    fn ready(&mut self) -> Turn {
        match self.listener.accept() {
            Ok((stream, _)) => {
                if let (Some(place), Ok(())) = (self.count.place(self.most), stream.set_nonblocking(true)) {
                    (self.greet)(stream, place);
                }
                Turn::Again
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => Turn::Wait,
            Err(error) if error.kind() == ErrorKind::Interrupted => Turn::Again,
            // The client has gone already, or there are too many open files.
            Err(error) if error.kind() == ErrorKind::ConnectionAborted => Turn::Again,
            Err(_) => Turn::Later,
        }
    }
}

/// What a connection has brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Came {
    /// So many bytes.
    Bytes(usize),
    /// Nothing for now.
    Nothing,
    /// Its end.
    End,
}

/// Bytes that have come and have not been used.
#[derive(Debug, Default)]
pub(crate) struct Buffer {
    bytes: Vec<u8>,
    used: usize,
}

impl Buffer {
    /// Takes what `stream`, which does not block, has; memory grows with the bytes that come.
    pub fn read(&mut self, mut stream: &TcpStream) -> Came {
        if self.used == self.bytes.len() {
            self.bytes.clear();
            self.bytes.shrink_to(KEPT);
            self.used = 0;
        } else if self.used > STEP {
            self.bytes.drain(..self.used);
            self.used = 0;
        }
        let filled = self.bytes.len();
        // A block that is long is read in longer pieces.
        self.bytes.resize(filled + STEP.max(filled.min(KEPT)), 0);
        let came = loop {
            match stream.read(&mut self.bytes[filled..]) {
                Ok(0) => break Came::End,
                Ok(count) => break Came::Bytes(count),
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break Came::Nothing,
                Err(_) => break Came::End,
            }
        };
        let count = match came {
            Came::Bytes(count) => count,
            _ => 0,
        };
        self.bytes.truncate(filled + count);
        came
    }

    /// What has not been used.
    pub fn rest(&self) -> &[u8] {
        &self.bytes[self.used..]
    }

    /// Takes `count` bytes off the rest.
    pub fn take(&mut self, count: usize) -> &[u8] {
        let begin = self.used;
        self.used = (begin + count).min(self.bytes.len());
        &self.bytes[begin..self.used]
    }

    /// The next block without the length before it; `None` while it is not complete.
    ///
    /// # Errors
    /// The length that is announced, if it is more than `longest`.
    pub fn block(&mut self, longest: usize) -> Result<Option<&[u8]>, usize> {
        let Some(length) = self.rest().first_chunk::<4>() else { return Ok(None) };
        let length = u32::from_le_bytes(*length) as usize;
        if length > longest {
            return Err(length);
        }
        if self.rest().len() < 4 + length {
            return Ok(None);
        }
        Ok(Some(&self.take(4 + length)[4..]))
    }
}

/// A listening socket at `address` on a port that is free, which does not block.
///
/// # Errors
/// The system's.
pub(crate) fn listen(address: std::net::IpAddr, port: u16) -> io::Result<TcpListener> {
    let listener = TcpListener::bind((address, port))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}
