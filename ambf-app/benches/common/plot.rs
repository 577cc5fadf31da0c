//! Two kinds of figures, as SVG.

use std::fmt::Write;

const WIDTH: f64 = 720.0;
const COLOURS: [&str; 5] = ["#1b6ca8", "#d1495b", "#edae49", "#3a7d44", "#777777"];
const STYLE: &str = "<style>text{font:13px sans-serif;fill:#333}.axis{stroke:#bbb}</style>\
                     <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>";

/// A named line.
pub struct Line {
    pub name: &'static str,
    pub points: Vec<(f64, f64)>,
}

/// Lines over logarithmic axes; the ticks of x are the values of the first line.
pub fn log_lines(title: &str, x_name: &str, y_name: &str, lines: &[Line]) -> String {
    let (height, left, right, top, bottom) = (420.0, 70.0, 190.0, 40.0, 50.0);
    let all = || lines.iter().flat_map(|line| line.points.iter().copied()).filter(|point| point.1 > 0.0);
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
        push(&mut svg, label(left - 8.0, at + 4.0, "end", &value.to_string()));
    }
    for &(value, _) in lines.first().map_or(&[][..], |line| &line.points) {
        push(&mut svg, label(x(value), height - bottom + 20.0, "middle", &value.to_string()));
    }
    push(&mut svg, label((left + WIDTH - right) / 2.0, height - 10.0, "middle", x_name));
    push(&mut svg, label(8.0, top - 12.0, "start", y_name));
    let mut names = Vec::new();
    for (line, colour) in lines.iter().zip(COLOURS) {
        let points: Vec<_> = line.points.iter().filter(|point| point.1 > 0.0).collect();
        let path: Vec<_> = points.iter().map(|point| format!("{:.1},{:.1}", x(point.0), y(point.1))).collect();
        let path = path.join(" ");
        push(&mut svg, format!("<polyline points=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>"));
        for point in &points {
            let (cx, cy) = (x(point.0), y(point.1));
            push(&mut svg, format!("<circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"3.5\" fill=\"{colour}\"/>"));
        }
        if let Some(last) = points.last() {
            names.push((y(last.1) + 4.0, x(last.0) + 10.0, line.name));
        }
    }
    names.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut free = 0.0_f64;
    for (wanted, from, name) in names {
        // Names of lines that end close to each other must not cover each other.
        let at = wanted.max(free);
        push(&mut svg, label(from, at, "start", name));
        free = at + 16.0;
    }
    svg + "</svg>\n"
}

/// Groups of horizontal bars; a value that is not a number has no bar.
pub fn bars(title: &str, unit: &str, series: &[&str], rows: &[(String, Vec<f64>)]) -> String {
    let (left, right, top, bar) = (190.0, 70.0, 60.0, 12.0);
    let group = bar * series.len() as f64 + 8.0;
    let height = top + group * rows.len() as f64 + 10.0;
    let most = rows.iter().flat_map(|row| &row.1).copied().fold(1e-9, f64::max);
    let mut svg = head(title, height);
    for (i, (name, colour)) in series.iter().zip(COLOURS).enumerate() {
        let at = left + 180.0 * i as f64;
        push(&mut svg, format!("<rect x=\"{at}\" y=\"34\" width=\"12\" height=\"12\" fill=\"{colour}\"/>"));
        push(&mut svg, label(at + 18.0, 45.0, "start", name));
    }
    for (i, (name, values)) in rows.iter().enumerate() {
        let at = top + group * i as f64;
        push(&mut svg, label(left - 8.0, at + group / 2.0, "end", name));
        for (j, (&value, colour)) in values.iter().zip(COLOURS).enumerate().filter(|(_, (value, _))| value.is_finite())
        {
            let (from, width) = (at + bar * j as f64, value / most * (WIDTH - left - right));
            push(
                &mut svg,
                format!(
                    "<rect x=\"{left}\" y=\"{from}\" width=\"{width:.1}\" height=\"{}\" fill=\"{colour}\"/>",
                    bar - 1.0
                ),
            );
            push(&mut svg, label(left + width + 5.0, from + bar - 2.0, "start", &format!("{value:.0} {unit}")));
        }
    }
    svg + "</svg>\n"
}

fn head(title: &str, height: f64) -> String {
    let mut svg = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\">{STYLE}\n");
    push(&mut svg, label(WIDTH / 2.0, 20.0, "middle", title));
    svg
}

fn label(x: f64, y: f64, anchor: &str, text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>")
}

fn push(svg: &mut String, element: String) {
    writeln!(svg, "{element}").expect("a text takes everything");
}
