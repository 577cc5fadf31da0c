//! Runs devices: each in a thread of its own, which nothing that another device or the physics does can hold up.

mod pace;
mod rates;

pub use rates::Rate;
