//! Figure of the verdicts: a row for each way to simulate, a cell for each difficulty.

use ambf_bench::plot::{cells, Figure};

use super::trial::Verdict;

/// Rows of one family.
pub struct Block {
    pub title: &'static str,
    /// Name of the way and verdicts with the difficulty in words.
    pub rows: Vec<(&'static str, Vec<(String, Verdict)>)>,
}

impl Verdict {
    const ALL: [Self; 5] = [Self::Good, Self::Poor, Self::Exploded, Self::NotFinite, Self::Slow];

    fn colour(self) -> &'static str {
        match self {
            Self::Good => "#8fce8b",
            Self::Poor => "#f6e08a",
            Self::Exploded => "#f0a35e",
            Self::NotFinite => "#e0605e",
            Self::Slow => "#cccccc",
        }
    }

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Poor => "poor",
            Self::Exploded => "exploded",
            Self::NotFinite => "not finite",
            Self::Slow => "too slow",
        }
    }
}

/// The map of all blocks.
pub fn draw(blocks: &[Block]) -> Figure {
    let legend = Verdict::ALL.map(|verdict| (verdict.name(), verdict.colour()));
    let colour = |(value, verdict): &(String, Verdict)| (value.clone(), verdict.colour());
    let rows = |block: &Block| {
        block.rows.iter().map(|(name, cells)| (*name, cells.iter().map(colour).collect())).collect::<Vec<_>>()
    };
    let blocks: Vec<_> = blocks.iter().map(|block| (block.title, rows(block))).collect();
    cells("Verdicts: difficulty grows to the right", &legend, &blocks)
}
