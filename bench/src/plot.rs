//! Figures of the pages: described here, drawn as SVG by `bench/plot.py` with matplotlib.

use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{json, Map, Value};

/// A figure's description, drawn by [`draw`].
#[derive(Debug, Clone)]
pub struct Figure(pub Value);

/// A named line.
#[derive(Debug, Clone)]
pub struct Line<'a> {
    pub name: &'a str,
    pub points: Vec<(f64, f64)>,
}

/// Points over axes with these titles. Those that are not finite are left out.
fn axes(kind: &str, title: &str, x: &str, y: &str, lines: &[Line<'_>]) -> Value {
    let lines: Vec<_> = lines
        .iter()
        .map(|line| {
            let points: Vec<_> =
                line.points.iter().filter(|point| point.0.is_finite() && point.1.is_finite()).collect();
            json!({"name": line.name, "points": points})
        })
        .collect();
    json!({"kind": kind, "title": title, "x": x, "y": y, "lines": lines})
}

/// Lines over logarithmic axes, with the given ticks of x. Points that are not positive are left out.
pub fn log_lines(title: &str, x: &str, y: &str, ticks: &[f64], lines: &[Line<'_>]) -> Figure {
    let mut figure = axes("log lines", title, x, y, lines);
    figure["ticks"] = json!(ticks);
    Figure(figure)
}

/// Lines over linear axes that begin at zero; y ends at `y_max`.
pub fn linear_lines(title: &str, x: &str, y: &str, y_max: f64, lines: &[Line<'_>]) -> Figure {
    let mut figure = axes("linear lines", title, x, y, lines);
    figure["y max"] = json!(y_max);
    Figure(figure)
}

/// Groups of horizontal bars, one group a row, one bar in it for each of `series`; a value that is not a number has no
/// bar.
pub fn bars(title: &str, unit: &str, series: &[&str], rows: &[(String, Vec<f64>)]) -> Figure {
    // JSON has no NaN: null.
    Figure(json!({"kind": "bars", "title": title, "unit": unit, "series": series, "rows": rows}))
}

/// A coloured cell of a table: text and colour.
pub type Cell = (String, &'static str);
/// The name and the cells of each row of a block.
pub type Rows<'a> = Vec<(&'a str, Vec<Cell>)>;

/// Blocks of rows of coloured cells, with the title of each block. `legend`: what the
/// colours mean.
pub fn cells(title: &str, legend: &[(&str, &str)], blocks: &[(&str, Rows<'_>)]) -> Figure {
    Figure(json!({"kind": "cells", "title": title, "legend": legend, "blocks": blocks}))
}

/// Has figures drawn as files in `folder`; says so where that fails, and the figures stay as they were.
pub fn draw(folder: &Path, figures: &[(impl AsRef<str>, Figure)]) {
    if figures.is_empty() {
        return;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/plot");
    let all: Map<_, _> = figures.iter().map(|(name, figure)| (name.as_ref().to_owned(), figure.0.clone())).collect();
    let drawn = Command::new(script).arg(folder).stdin(Stdio::piped()).spawn().and_then(|mut child| {
        let input = child.stdin.take().expect("it is piped");
        serde_json::to_writer(input, &all)?;
        child.wait()
    });
    match drawn {
        Ok(status) if status.success() => (),
        Ok(status) => eprintln!("figures are not drawn: scripts/plot ended with {status}"),
        Err(error) => eprintln!("figures are not drawn: {error}"),
    }
}
