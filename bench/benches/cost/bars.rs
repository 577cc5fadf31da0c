//! Bars as SVG.

use super::plot::{head, label, push, COLOURS, WIDTH};

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
