//! What a case is: a system, how long it moves, and how far a run is from what is known about it.

use std::time::Duration;

use super::reference::State;
use super::system::System;

/// Steps of 1/8 … 16 ms: all divide 16 ms, of which the times of comparison are multiples.
pub const STEPS: [f64; 8] = [0.000125, 0.00025, 0.0005, 0.001, 0.002, 0.004, 0.008, 0.016];
/// The one at which settings are compared, s.
pub const USUAL: f64 = 0.001;
/// Longest of them, s.
pub const GRAIN: f64 = 0.016;

/// States of all bodies at each time of comparison; fewer when the simulator lost its state.
pub type Samples = Vec<Vec<State>>;

/// One run of one simulator.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// CPU time of the steps alone.
    pub cpu: Duration,
    /// CPU time of those after the last but one time of comparison.
    pub tail: Duration,
    pub samples: Samples,
}

/// Distance of a run from what is known; may be infinite.
pub type Measure = Box<dyn Fn(&Samples) -> f64>;

/// What moves in a case, which decides the simulators and settings that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// One body that touches nothing.
    Free,
    /// Joints without loops.
    Tree,
    /// Joints with loops.
    Loop,
    /// Contacts.
    Contact,
    /// Contacts with restitution, which not every simulator has.
    Bounce,
}

/// A case of the benchmark.
pub struct Case {
    pub name: &'static str,
    pub title: &'static str,
    /// What is built and what the error is.
    pub words: &'static str,
    /// Of the error.
    pub unit: &'static str,
    pub family: Family,
    pub system: System,
    /// Times of comparison, s, ascending.
    pub times: Vec<f64>,
    pub measure: Measure,
    /// An error above this is a failure: fallen, flown away, off the branch.
    pub limit: f64,
}

impl Case {
    /// Error of a run; infinite when it did not get to its end or left all bounds.
    pub fn error(&self, run: &Run) -> f64 {
        let lost = run.samples.len() < self.times.len();
        let error = if lost { f64::INFINITY } else { (self.measure)(&run.samples) };
        if error.is_finite() && error <= self.limit {
            error
        } else {
            f64::INFINITY
        }
    }
}

/// `count` equally spaced times up to `count` · `grains` · 16 ms.
pub fn times(count: usize, grains: usize) -> Vec<f64> {
    (1..=count).map(|i| (i * grains) as f64 * GRAIN).collect()
}

/// Largest distance (m) of any body from where it should be, at any time of comparison.
pub fn positions(expected: Samples) -> Measure {
    Box::new(move |samples| {
        let pairs = samples.iter().zip(&expected).flat_map(|(a, b)| a.iter().zip(b));
        largest(pairs.map(|(a, b)| (a.pose.translation.vector - b.pose.translation.vector).norm()))
    })
}

/// The largest value, or NaN if one is.
pub fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |most, value| if value > most || value.is_nan() { value } else { most })
}
