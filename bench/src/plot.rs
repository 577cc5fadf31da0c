//! Figures as SVG.

use std::fmt::Write;

/// Of all figures.
pub const WIDTH: f64 = 720.0;
/// Of lines and bars, in turn.
pub const COLOURS: [&str; 10] =
    ["#1b6ca8", "#d1495b", "#edae49", "#3a7d44", "#777777", "#7b4ea3", "#d17a22", "#2aa1a1", "#a0522d", "#222222"];
const STYLE: &str = "<style>text{font:13px sans-serif;fill:#333}.axis{stroke:#bbb}</style>\
                     <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>";

/// A named line.
pub struct Line<'a> {
    pub name: &'a str,
    pub points: Vec<(f64, f64)>,
}

/// Lines over logarithmic axes, with the given ticks of x. Points that are not positive and finite are left out.
pub fn log_lines(title: &str, x_name: &str, y_name: &str, ticks: &[f64], lines: &[Line<'_>]) -> String {
    let (height, left, right, top, bottom) = (420.0, 70.0, 190.0, 40.0, 50.0);
    let shown = |point: &&(f64, f64)| point.1 > 0.0 && point.1.is_finite();
    let all = || lines.iter().flat_map(|line| line.points.iter().filter(shown).copied());
    let decades = |value: fn((f64, f64)) -> f64| {
        let (low, high) = all().map(value).fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
        (low.log10(), high.log10())
    };
    let ((x0, x1), (y0, y1)) = (decades(|point| point.0), decades(|point| point.1));
    let (y0, y1) = (y0.floor(), y1.ceil());
    let x = |value: f64| left + (value.log10() - x0) / (x1 - x0).max(1e-9) * (WIDTH - left - right);
    let y = |value: f64| height - bottom - (value.log10() - y0) / (y1 - y0).max(1e-9) * (height - top - bottom);

    let mut svg = head(title, height);
    for decade in y0 as i32..=y1 as i32 {
        let value = 10f64.powi(decade);
        let (at, end) = (y(value), WIDTH - right);
        push(&mut svg, format!("<line class=\"axis\" x1=\"{left}\" y1=\"{at:.1}\" x2=\"{end}\" y2=\"{at:.1}\"/>"));
        push(&mut svg, label(left - 8.0, at + 4.0, "end", &number(value)));
    }
    let inside = |value: &&f64| (x0..=x1).contains(&value.log10());
    for &value in ticks.iter().filter(inside) {
        push(&mut svg, label(x(value), height - bottom + 20.0, "middle", &number(value)));
    }
    push(&mut svg, label((left + WIDTH - right) / 2.0, height - 10.0, "middle", x_name));
    push(&mut svg, label(8.0, top - 12.0, "start", y_name));
    let mut names = Vec::new();
    for (line, colour) in lines.iter().zip(COLOURS) {
        let points: Vec<_> = line.points.iter().filter(shown).collect();
        let path: Vec<_> = points.iter().map(|point| format!("{:.1},{:.1}", x(point.0), y(point.1))).collect();
        let path = path.join(" ");
        push(&mut svg, format!("<polyline points=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>"));
        for point in &points {
            let (cx, cy) = (x(point.0), y(point.1));
            push(&mut svg, format!("<circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"3.5\" fill=\"{colour}\"/>"));
        }
        if let Some(last) = points.last() {
            names.push((y(last.1) + 4.0, line.name, colour));
        }
    }
    names.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut free = 0.0_f64;
    for (wanted, name, colour) in names {
        // Names of lines that end close to each other must not cover each other.
        let at = wanted.max(free);
        let from = WIDTH - right + 10.0;
        push(&mut svg, label(from, at, "start", name).replacen("<text", &format!("<text style=\"fill:{colour}\""), 1));
        free = at + 16.0;
    }
    svg + "</svg>\n"
}

/// Short as a tick.
fn number(value: f64) -> String {
    if (0.001..10_000.0).contains(&value) {
        format!("{}", (value * 1e6).round() / 1e6)
    } else {
        format!("{value:.0e}")
    }
}

/// The beginning of a figure with its title.
pub fn head(title: &str, height: f64) -> String {
    let mut svg = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\">{STYLE}\n");
    push(&mut svg, label(WIDTH / 2.0, 20.0, "middle", title));
    svg
}

/// A text at a place; `anchor`: `start`, `middle` or `end`.
pub fn label(x: f64, y: f64, anchor: &str, text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>")
}

/// Adds an element.
pub fn push(svg: &mut String, element: String) {
    writeln!(svg, "{element}").expect("a text takes everything");
}
