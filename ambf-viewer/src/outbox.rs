//! Requests on their way to the simulation.

use std::collections::VecDeque;
use std::sync::Arc;

use ambf_core::plugin::Drawing;
use ambf_core::sim::{WindowAnswer, WindowLink, WindowRequest};

/// Leaves requests for the simulation without ever waiting: what finds no room waits here, in order. Motions that
/// follow each other become one, so that a simulation that is busy for long does not make the queue long.
pub(crate) struct Outbox {
    link: WindowLink,
    waiting: VecDeque<WindowRequest>,
}

impl Outbox {
    pub fn new(link: WindowLink) -> Self {
        Self { link, waiting: VecDeque::new() }
    }

    pub fn post(&mut self, request: WindowRequest) {
        match self.waiting.back_mut() {
            Some(last) => match last.merged(&request) {
                Some(both) => *last = both,
                None => self.waiting.push_back(request),
            },
            None => self.waiting.push_back(request),
        }
        self.flush();
    }

    /// Leaves what waits, as far as there is room.
    pub fn flush(&mut self) {
        while let Some(request) = self.waiting.pop_front() {
            if let Err(request) = self.link.post(request) {
                self.waiting.push_front(request);
                break;
            }
        }
    }

    /// What plugins show.
    pub fn drawings(&self) -> Vec<Arc<Vec<Drawing>>> {
        self.link.drawings().read()
    }

    /// First and last time that can be looked back at, simulated s.
    pub fn span(&self) -> Option<(f64, f64)> {
        self.link.timeline().span()
    }

    pub fn answer(&self) -> Option<WindowAnswer> {
        self.link.answer()
    }
}
