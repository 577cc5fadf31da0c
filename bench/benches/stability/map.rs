//! Figure of the verdicts: a row for each way to simulate, a cell for each difficulty.

use std::fmt::Write;

use super::trial::Verdict;

const ROW: f64 = 20.0;
const CELL: f64 = 62.0;
const LEFT: f64 = 330.0;
const TOP: f64 = 60.0;

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

/// The map as SVG.
pub fn draw(blocks: &[Block]) -> String {
    let widest = blocks.iter().flat_map(|block| &block.rows).map(|row| row.1.len()).max().unwrap_or(0);
    let width = LEFT + CELL * widest as f64 + 10.0;
    let height = TOP + blocks.iter().map(|block| ROW * block.rows.len() as f64 + 8.0).sum::<f64>();
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\"><style>text{{font:12px sans-serif;fill:#333}}\
         </style><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    text(&mut svg, width / 2.0, 20.0, "middle", "Verdicts: difficulty grows to the right");
    for (i, verdict) in Verdict::ALL.into_iter().enumerate() {
        let x = 20.0 + 110.0 * i as f64;
        cell(&mut svg, x, 30.0, 16.0, verdict);
        text(&mut svg, x + 22.0, 44.0, "start", verdict.name());
    }
    let mut y = TOP;
    for block in blocks {
        text(&mut svg, 8.0, y + 14.0, "start", block.title);
        for (name, cells) in &block.rows {
            text(&mut svg, LEFT - 8.0, y + 14.0, "end", name);
            for (i, (value, verdict)) in cells.iter().enumerate() {
                let x = LEFT + CELL * i as f64;
                cell(&mut svg, x, y, CELL, *verdict);
                text(&mut svg, x + CELL / 2.0, y + 14.0, "middle", value);
            }
            y += ROW;
        }
        y += 8.0;
    }
    svg + "</svg>\n"
}

fn cell(svg: &mut String, x: f64, y: f64, width: f64, verdict: Verdict) {
    let (width, height, colour) = (width - 1.0, ROW - 1.0, verdict.colour());
    writeln!(svg, "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" fill=\"{colour}\"/>")
        .expect("a text takes everything");
}

fn text(svg: &mut String, x: f64, y: f64, anchor: &str, text: &str) {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    writeln!(svg, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{text}</text>").expect("a text takes everything");
}
