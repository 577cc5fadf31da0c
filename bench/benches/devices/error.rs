//! How far end-effectors are from their hands, for every rate of the physics loop.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::control::Profile;
use ambf_core::device::Driver;
use ambf_core::sim::RunnerOptions;
use dvrk_arm::Pedal;
use fake_dvrk::{Curve, Fake, Motion};
use nalgebra::{Isometry3, UnitQuaternion};

use super::fleet::arms;
use super::plot::{log_lines, Figure, Line};
use super::report::Section;
use super::rig::{Iteration, Rig, Scenery, Wanted};
use super::statistics::percentile;
use super::traced::{Tick, CLUTCH};
use super::Effort;

const PROFILES: [(&str, Profile); 2] = [("legacy", Profile::Legacy), ("accurate", Profile::Accurate)];
const ARMS: [&str; 2] = ["MTMR", "MTML"];
/// The end-effectors' gains rise in the 2 s after physics has started; so long the clutch is pressed.
const RAMP: Duration = Duration::from_millis(2100);
/// From the release of the clutch, when the end-effectors are at rest, until readings count.
const START: Duration = Duration::from_millis(700);
/// A device that was not read for longer holds its reference.
const GAP: Duration = Duration::from_millis(50);
/// Farther off than if it did not move at all, m.
const LOST: f64 = 0.5;

/// Distances from the reference at each tick of the device, m; `None`: lost.
fn errors(ticks: &[Tick], iterations: &[Iteration], tool: usize, readings: usize) -> Option<Vec<f64>> {
    // The hand rested until the clutch was pressed.
    let mut reference = iterations.first()?.positions[tool];
    let clutched = ticks.iter().rposition(|tick| tick.is_clutched).expect("it was clutched");
    let counted = ticks.len().checked_sub(readings).filter(|counted| *counted > clutched)?;
    let mut next = 0;
    // The last clutched sample tells where the reference starts from; one after a gap, from where it goes on.
    let mut follows = true;
    let mut errors = Vec::with_capacity(readings);
    for (place, pair) in ticks.windows(2).enumerate().skip(clutched) {
        let [before, tick] = pair else { continue };
        let follows_on = tick.is_valid && tick.read - before.read <= GAP;
        if follows && follows_on {
            reference += tick.position - before.position;
        }
        follows = follows_on;
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

/// Presses the clutch or lets it go, until both devices know.
fn clutch(fake: &Fake, rig: &Rig, pressed: bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    fake.pedal(Pedal::Clutch, i32::from(pressed));
    while rig.traces.iter().any(|trace| trace.is_clutched() != pressed) {
        assert!(Instant::now() < deadline, "the pedal does not reach the devices");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Of both arms: (root mean square, 99th percentile), m.
fn measured(fake: &Fake, profile: Profile, rate: f64, readings: usize) -> Option<(f64, f64)> {
    let driver: Arc<dyn Driver> = Arc::new(dvrk_arm::driver());
    let keys = |name| format!("hardware name: {name}, button mapping: {{a1: {CLUTCH}}}");
    let wanted = ARMS.map(|name| Wanted { name, driver: Arc::clone(&driver), keys: keys(name) });
    ARMS.iter().for_each(|name| fake.set_pose(name, &Isometry3::identity()));
    let scenery = Scenery { profile, ..Scenery::new(ARMS.len(), 0) };
    let options = RunnerOptions { frequency: rate, ..RunnerOptions::default() };
    let rig = Rig::start(scenery.load(), &wanted, options);
    rig.settle(Duration::ZERO);
    clutch(fake, &rig, true);
    ARMS.iter().for_each(|name| fake.release(name));
    std::thread::sleep(RAMP);
    clutch(fake, &rig, false);
    // Copies of the logs would hold up the devices meanwhile.
    std::thread::sleep(START + Duration::from_secs_f64(1.1 * readings as f64 * 1e-3));
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
pub fn measure(effort: &Effort) -> (Section, Vec<(&'static str, Figure)>) {
    let fake = arms(&ARMS, Motion::Curve(Curve::default(), UnitQuaternion::identity()));
    let found: Vec<Vec<_>> = PROFILES
        .iter()
        .map(|(_, profile)| effort.rates.iter().map(|&rate| measured(&fake, *profile, rate, effort.readings)).collect())
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
        rate if rate.is_finite() => format!("`{}` stays within 0.5 m down to {rate} Hz", PROFILES[profile].0),
        _ => format!("`{}` stays within 0.5 m at none of them", PROFILES[profile].0),
    };
    let section = Section {
        title: "Controller error against the rate of physics",
        intro: "Fake MTMR and MTML on the curve of the paper's equation 9, P = 0.1·(sin 4t, cos 4t, 2 sin 4t) m, over ROS at 1000 Hz, the driver `dvrk`: \
                they drive two bodies of 1 kg with P = 1000 N/m and D = 60 N·s/m, from the release of the clutch pedal on. The devices' loops run at \
                1000 Hz, physics is throttled; Bullet's step stays 1 ms. Error: distance of the body from the reference, as a device sees it in each \
                of its ticks, mm: so it holds the age of the state too, during which the hand moves on at up to 0.9 m/s, but not the way of the pose \
                over ROS. !: farther off than 0.5 m.",
        header: &["physics, Hz", "legacy: rms", "legacy: p99", "accurate: rms", "accurate: p99"],
        rows: rows.collect(),
        remarks: vec![
            format!("{} readings of each device for a rate. {}; {}.", effort.readings, kept(0), kept(1)),
            "![Error against the rate of physics](devices-error.svg)".into(),
        ],
    };
    (section, vec![("devices-error.svg", figure)])
}
