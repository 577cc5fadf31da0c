//! Families of scenes, each over a range of one difficulty.

mod contact;
mod driven;
mod linked;
mod pressed;

use super::trial::Trial;

/// Scenes that differ in one number.
pub struct Family {
    pub name: &'static str,
    pub title: &'static str,
    /// What is built, and what counts as good.
    pub words: &'static str,
    /// What the number is.
    pub difficulty: &'static str,
    /// Of the trial's own deviation; empty: none.
    pub stray: &'static str,
    /// In order of difficulty.
    pub values: &'static [f64],
    pub make: fn(f64) -> Trial,
}

impl Family {
    /// Runs take minutes: only the profiles are compared.
    pub fn is_long(&self) -> bool {
        self.name == "commands"
    }

    /// The difficulty in words.
    pub fn label(&self, value: f64) -> String {
        match self.name {
            "loops" if value == 0.0 => "Bricard".into(),
            _ if !(1e-3..1e4).contains(&value) => format!("{value:e}"),
            _ => value.to_string(),
        }
    }
}

/// All of them.
pub fn all() -> Vec<Family> {
    let all = contact::families().into_iter().chain(pressed::families());
    all.chain(linked::families()).chain(driven::families()).collect()
}

/// Numbers that look random and are always the same (SplitMix64).
pub struct Dice(pub u64);

impl Dice {
    /// In [0, 1).
    pub fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// In [0, n).
    pub fn index(&mut self, n: usize) -> usize {
        (self.roll() * n as f64) as usize
    }
}
