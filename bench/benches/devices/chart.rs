//! Lines over linear axes as SVG.

use super::plot::{head, label, push, Line, COLOURS, WIDTH};

/// Lines over linear axes that begin at zero; `y_most` cuts what is larger.
pub fn lines(title: &str, x_name: &str, y_name: &str, y_most: f64, lines: &[Line<'_>]) -> String {
    let (height, left, right, top, bottom) = (360.0, 70.0, 170.0, 50.0, 50.0);
    let x_most = lines.iter().flat_map(|line| &line.points).map(|point| point.0).fold(1e-9, f64::max);
    let x = |value: f64| left + value / x_most * (WIDTH - left - right);
    let y = |value: f64| height - bottom - (value / y_most).clamp(0.0, 1.0) * (height - top - bottom);
    let mut svg = head(title, height);
    for value in ticks(y_most) {
        let (at, end) = (y(value), WIDTH - right);
        push(&mut svg, format!("<line class=\"axis\" x1=\"{left}\" y1=\"{at:.1}\" x2=\"{end}\" y2=\"{at:.1}\"/>"));
        push(&mut svg, label(left - 8.0, at + 4.0, "end", &short(value)));
    }
    for value in ticks(x_most) {
        push(&mut svg, label(x(value), height - bottom + 20.0, "middle", &short(value)));
    }
    push(&mut svg, label((left + WIDTH - right) / 2.0, height - 10.0, "middle", x_name));
    push(&mut svg, label(8.0, top - 12.0, "start", y_name));
    for (i, (line, colour)) in lines.iter().zip(COLOURS).enumerate() {
        let path: Vec<_> = line.points.iter().map(|point| format!("{:.1},{:.1}", x(point.0), y(point.1))).collect();
        let path = path.join(" ");
        push(&mut svg, format!("<polyline points=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>"));
        let (from, at) = (WIDTH - right + 10.0, top + 18.0 * i as f64);
        let name = label(from, at, "start", line.name);
        push(&mut svg, name.replacen("<text", &format!("<text style=\"fill:{colour}\""), 1));
    }
    svg + "</svg>\n"
}

/// Round numbers from 0 to `most`, four to ten of them.
fn ticks(most: f64) -> Vec<f64> {
    let decade = 10f64.powf(most.log10().floor());
    let step = [0.1, 0.2, 0.5, 1.0].map(|part| part * decade).into_iter().find(|step| most / step <= 10.0);
    let step = step.unwrap_or(decade);
    (0..=(most / step + 1e-9) as usize).map(|i| i as f64 * step).collect()
}

fn short(value: f64) -> String {
    format!("{}", (value * 1e3).round() / 1e3)
}
