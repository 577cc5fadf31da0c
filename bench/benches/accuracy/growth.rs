//! How costs grow with the number of bodies: boxes that fall onto the ground and each other.

use std::time::Duration;

use nalgebra::Vector3;

use super::case::{times, Case, Family, USUAL};
use super::own::{self, Setting};
use super::peers::{Peer, Peers};
use super::plot::{log_lines, Figure, Line};
use super::report::Section;
use super::statistics::short;
use super::system::{Body, Shape, System};

/// Exponents are fitted from here on.
const LARGE: usize = 100;

fn pile(n: usize) -> Case {
    let side = (1..).find(|side| side * side * side >= n).expect("there is a cube for every number");
    let mut system = System::of(vec![Body::fixed(Some(Shape::Ground))]);
    for i in 0..n {
        let (x, y, z) = (i % side, i / side % side, i / (side * side));
        // Layers lie askew, so that columns fall over.
        let shift = 0.04 * (z % 3) as f64;
        let place = Vector3::new(x as f64 * 0.12 + shift, y as f64 * 0.12 - shift, 0.1 + z as f64 * 0.12);
        system.bodies.push(Body::block(0.1, Vector3::repeat(0.1), place));
    }
    system.friction = 0.5;
    Case {
        name: "pile",
        title: "Cost over the number of boxes",
        words: "",
        unit: "",
        family: Family::Contact,
        system,
        // 0.8 s to fall; what is measured are the 0.16 s after that.
        times: vec![times(1, 50)[0], times(1, 60)[0]],
        measure: Box::new(|_| 0.0),
        limit: 0.0,
    }
}

enum Way {
    Own(Setting),
    Peer(Peer),
}

/// Costs of piles of boxes in all ways, with the exponents of their growth, and a figure.
pub fn measure(peers: &mut Option<Peers>, quick: bool) -> (Section, Figure) {
    let sizes: &[usize] = if quick { &[25, 50, 100] } else { &[25, 50, 100, 200, 400, 800, 1600] };
    let most = Duration::from_secs(if quick { 1 } else { 10 });
    let settings = own::settings(&pile(1)).into_iter().take(2);
    let mut ways: Vec<(String, Way)> = settings.map(|setting| (setting.name.into(), Way::Own(setting))).collect();
    let others = [Peer::Featherstone, Peer::Maximal, Peer::MujocoEuler];
    ways.extend(others.map(|peer| (peer.name().into(), Way::Peer(peer))));
    let mut found: Vec<Vec<(f64, f64)>> = vec![Vec::new(); ways.len()];
    let mut last = vec![Duration::ZERO; ways.len()];
    for &n in sizes {
        let case = pile(n);
        for (index, (_, way)) in ways.iter().enumerate() {
            // Twice as many boxes are at most four times the work.
            if last[index] * 3 > most {
                continue;
            }
            let run = match (way, peers.as_mut()) {
                (Way::Own(setting), _) => own::run(&case, setting, USUAL, most),
                (Way::Peer(peer), Some(peers)) => peers.run(&case, *peer, USUAL, most),
                (Way::Peer(_), None) => continue,
            };
            let Ok(Some(run)) = run else {
                last[index] = most;
                continue;
            };
            last[index] = run.cpu;
            if let [from, to] = case.times[..] {
                found[index].push((n as f64, run.tail.as_secs_f64() * 1e6 / ((to - from) / USUAL)));
            }
        }
    }
    let row = |((name, _), points): (&(String, Way), &Vec<(f64, f64)>)| {
        let cost =
            |n: &usize| points.iter().find(|point| point.0 == *n as f64).map_or("–".into(), |point| short(point.1));
        let mut row = vec![name.clone()];
        row.extend([25, 50, 100, 200, 400, 800, 1600].iter().map(cost));
        row.push(exponent(points).map_or("–".into(), |exponent| format!("{exponent:.2}")));
        row
    };
    let section = Section {
        title: "Cost over the number of boxes",
        intro: "Boxes of 0.1 m that fell onto the ground and each other, friction 0.5: µs a step of 1 ms, and the exponent of the growth from \
                100 boxes on. Runs that would take too long are left out.",
        header: &["setting", "25", "50", "100", "200", "400", "800", "1600", "exponent"],
        rows: ways.iter().zip(&found).map(row).collect(),
        remarks: vec!["![Cost over the number of boxes](accuracy-growth.svg)".into()],
    };
    let lines: Vec<Line> =
        ways.iter().zip(&found).map(|((name, _), points)| Line { name, points: points.clone() }).collect();
    let ticks: Vec<f64> = sizes.iter().map(|&n| n as f64).collect();
    (section, log_lines("Cost over the number of boxes", "boxes in contact", "µs a step", &ticks, &lines))
}

/// Slope of a straight line through the logarithms.
fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> =
        points.iter().filter(|point| point.0 >= LARGE as f64).map(|point| (point.0.ln(), point.1.ln())).collect();
    let count = logs.len() as f64;
    let (x, y) = (logs.iter().map(|p| p.0).sum::<f64>() / count, logs.iter().map(|p| p.1).sum::<f64>() / count);
    let (up, across) =
        logs.iter().fold((0.0, 0.0), |(up, across), p| (up + (p.0 - x) * (p.1 - y), across + (p.0 - x).powi(2)));
    (logs.len() > 1).then(|| up / across)
}
