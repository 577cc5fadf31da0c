//! How far end-effectors are from their hands, for every rate of the physics loop.

use std::sync::Arc;
use std::time::Duration;

use ambf_core::control::Profile;
use ambf_core::device::{Driver, MockDriver};
use ambf_core::sim::RunnerOptions;

use super::plot::{log_lines, Line};
use super::report::Section;
use super::rig::{Iteration, Rig, Scenery, Wanted};
use super::statistics::percentile;
use super::traced::Tick;
use super::Effort;

const PROFILES: [(&str, Profile); 2] = [("legacy", Profile::Legacy), ("accurate", Profile::Accurate)];
/// Clutched until then, s after the device was opened: the last clutched sample tells where the reference starts from.
const CLUTCHED: f64 = 0.8;
/// The end-effectors' gains rise in the 2 s after physics has started.
const RAMP: Duration = Duration::from_millis(2700);
/// A device that was not read for longer holds its reference.
const GAP: Duration = Duration::from_millis(50);
/// Farther off than if it did not move at all, m.
const LOST: f64 = 0.5;

/// Distances from the reference at each tick of the device, m; `None`: lost.
fn errors(ticks: &[Tick], iterations: &[Iteration], tool: usize, readings: usize) -> Option<Vec<f64>> {
    let start = iterations.first()?.positions[tool];
    let clutched = ticks.iter().rposition(|tick| tick.is_clutched).expect("it was clutched");
    let counted = ticks.len().checked_sub(readings)?;
    let (mut reference, mut next) = (start, 0);
    let mut errors = Vec::with_capacity(readings);
    for (place, pair) in ticks.windows(2).enumerate().skip(clutched) {
        let [before, tick] = pair else { continue };
        // After a gap the reference goes on from where it is.
        if tick.read - before.read <= GAP {
            reference += tick.position - before.position;
        }
        while iterations.get(next + 1).is_some_and(|iteration| iteration.at <= tick.read) {
            next += 1;
        }
        if place + 1 < counted {
            continue;
        }
        let error = (reference - iterations[next].positions[tool]).norm();
        if error.is_nan() || error > LOST {
            return None;
        }
        errors.push(error);
    }
    errors.sort_by(f64::total_cmp);
    Some(errors)
}

/// Of both arms: (root mean square, 99th percentile), m.
fn measured(profile: Profile, rate: f64, readings: usize) -> Option<(f64, f64)> {
    let mock: Arc<dyn Driver> = Arc::new(MockDriver::default());
    let device = |name: &'static str, identity| Wanted {
        name,
        driver: Arc::clone(&mock),
        keys: format!(
            "hardware name: {name}, identity: '{identity}', button mapping: {{a1: 1}}, \
             driver settings: {{buttons: '1@0-{CLUTCHED}', hold: 0.1}}"
        ),
    };
    let wanted = [device("MTMR", 0), device("MTML", 1)];
    let scenery = Scenery { profile, ..Scenery::new(2, 0) };
    let options = RunnerOptions { frequency: rate, ..RunnerOptions::default() };
    let rig = Rig::start(scenery.load(), &wanted, options);
    std::thread::sleep(RAMP);
    // Copies of the logs would hold up the devices meanwhile.
    std::thread::sleep(Duration::from_secs_f64(1.1 * readings as f64 * 1e-3));
    let (ticks, iterations) = ([0, 1].map(|i| rig.traces[i].ticks()), rig.iterations.all());
    // A state that is not finite pauses physics; that the distance tells.
    drop(rig);
    let mut both = errors(&ticks[0], &iterations, 0, readings)?;
    both.extend(errors(&ticks[1], &iterations, 1, readings)?);
    both.sort_by(f64::total_cmp);
    let square = both.iter().map(|error| error * error).sum::<f64>() / both.len() as f64;
    Some((square.sqrt(), percentile(&both, 0.99)))
}

/// The table and its figure.
pub fn measure(effort: &Effort) -> (Section, Vec<(&'static str, String)>) {
    let found: Vec<Vec<_>> = PROFILES
        .iter()
        .map(|(_, profile)| effort.rates.iter().map(|&rate| measured(*profile, rate, effort.readings)).collect())
        .collect();
    let cell = |value: Option<f64>| value.map_or_else(|| "!".into(), |value| format!("{:.2}", value * 1e3));
    let rows = effort.rates.iter().enumerate().map(|(i, rate)| {
        let of = |profile: usize| found[profile][i];
        let mut row = vec![format!("{rate}")];
        for profile in 0..PROFILES.len() {
            row.push(cell(of(profile).map(|found| found.0)));
            row.push(cell(of(profile).map(|found| found.1)));
        }
        row
    });
    let lines: Vec<_> = PROFILES
        .iter()
        .zip(&found)
        .map(|((name, _), found)| {
            let points = effort.rates.iter().zip(found).filter_map(|(rate, found)| Some((*rate, found.as_ref()?.0)));
            Line { name, points: points.collect() }
        })
        .collect();
    let figure = log_lines(
        "Distance of end-effectors from their hands",
        "physics loop, Hz",
        "root mean square, m",
        effort.rates,
        &lines,
    );
    let slowest = |profile: usize| {
        let alive = effort.rates.iter().zip(&found[profile]).filter(|(_, found)| found.is_some());
        alive.map(|(rate, _)| *rate).fold(f64::INFINITY, f64::min)
    };
    let kept = |profile: usize| match slowest(profile) {
        rate if rate.is_finite() => format!("`{}` follows down to {rate} Hz", PROFILES[profile].0),
        _ => format!("`{}` follows at none of them", PROFILES[profile].0),
    };
    let section = Section {
        title: "Controller error against the rate of physics",
        intro: "Two devices on the curve of the paper's equation 9, P = 0.1·(sin 4t, cos 4t, 2 sin 4t) m, drive two bodies of 1 kg with P = 1000 N/m and \
                D = 60 N·s/m. The devices' loops run at 1000 Hz, physics is throttled; Bullet's step stays 1 ms. Error: distance of the body from the \
                reference, as a device sees it in each of its ticks, mm: so it holds the age of the state too, during which the hand moves on at up \
                to 0.9 m/s. !: farther off than 0.5 m. The devices are mock devices with the limits of MTMR and MTML, not arms over ROS.",
        header: &["physics, Hz", "legacy: rms", "legacy: p99", "accurate: rms", "accurate: p99"],
        rows: rows.collect(),
        remarks: vec![
            format!("{} readings of each device for a rate. {}; {}.", effort.readings, kept(0), kept(1)),
            "![Error against the rate of physics](devices-error.svg)".into(),
        ],
    };
    (section, vec![("devices-error.svg", figure)])
}
