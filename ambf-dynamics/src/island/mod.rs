//! The solution of an island: rows of joints, contacts and friction become a velocity problem and a position problem, which
//! [`mlcp`](crate::mlcp) solves.
//!
//! Velocities and positions are solved separately. The velocity problem has no position correction (no Baumgarte term),
//! only a bias for the curvature of the motion. Its solution projects the velocities onto a convex set that contains 0,
//! which cannot add kinetic energy (motors and restitution aside). Position errors are corrected by a second problem
//! over the same rows. Its pseudo-velocities move the bodies in this sub-step and are then discarded (split impulse).
//!
//! The caller adds the rows as Bullet sets them up, calls [`Island::solve`] and reads impulses and velocities. An island keeps
//! memory, but nothing that changes a result: what a later sub-step depends on is the caller's ([`Memory`], [`Budgets`]).

mod budget;
mod build;
pub mod ffi;
mod positions;
mod row;
mod softness;
mod solve;
#[cfg(test)]
mod tests;
mod yielding;

pub use budget::{Budgets, Limits};
pub use row::{Kind, Row};
pub(crate) use softness::SOFT_SPRING;
pub(crate) use solve::MAX_CORRECTION_SPEED;
pub use solve::{Articulations, Counters, Island, Kept, Outcome, Problem, Solution};
pub use yielding::Memory;

/// The larger of two numbers; the first one if it is not a number, so that it reaches the solver, which refuses it.
fn larger(a: f64, b: f64) -> f64 {
    if a < b {
        b
    } else {
        a
    }
}

/// The smaller of two numbers; the first one if it is not a number, see [`larger`].
fn smaller(a: f64, b: f64) -> f64 {
    if b < a {
        b
    } else {
        a
    }
}
