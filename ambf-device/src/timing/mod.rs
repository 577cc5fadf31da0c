//! Loops of a fixed frequency: their schedule ([`Pacer`]), and the distribution of their periods or costs
//! ([`Histogram`]). Haptic loops and the loop of the physics use the same.

mod histogram;
mod pace;

pub use histogram::Histogram;
pub use pace::Pacer;
