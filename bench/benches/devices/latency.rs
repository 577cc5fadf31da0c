//! How long it takes from a hand that moves to the force that it feels, over ROS.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::device::Driver;
use ambf_core::sim::RunnerOptions;
use fake_dvrk::{Fake, Motion};
use nalgebra::Isometry3;

use super::fleet::arms;
use super::plot::Figure;
use super::report::Section;
use super::rig::{Rig, Scenery, Wanted, SUB_STEP};
use super::statistics::percentile;
use super::Effort;

const ARMS: [&str; 4] = ["MTMR", "MTML", "PSM1", "PSM2"];
/// How far hands jump, m.
const JUMP: f64 = 0.01;
/// Stiff, so that an end-effector has come to rest before the next jump.
const CONTROLLER: &str = "{linear: {P: 10000, I: 0, D: 200}, angular: {P: 10, I: 0, D: 0.5}}";
const STIFFNESS: f64 = 10_000.0;
/// N/m.
const FEEDBACK: f64 = 100.0;
/// From jump to jump; not a multiple of the loops' periods.
const PAUSE: Duration = Duration::from_micros(120_370);

/// Times since a hand jumped, s.
#[derive(Default)]
struct Latencies {
    /// Until its device's loop read that.
    read: Vec<f64>,
    /// Until an iteration ended in which the force on the end-effector acted.
    moved: Vec<f64>,
    /// Until the wrench arrived at the arm's node.
    felt: Vec<f64>,
}

fn measured(arm_count: usize, jumps: usize) -> Latencies {
    let names = &ARMS[..arm_count];
    let fake = arms(names, Motion::Still(Isometry3::identity()));
    let driver: Arc<dyn Driver> = Arc::new(dvrk_arm::driver());
    let gain = format!("haptic gain: {{linear: {FEEDBACK}, angular: 0}}");
    let wanted: Vec<_> = names
        .iter()
        .map(|&name| Wanted {
            name,
            driver: Arc::clone(&driver),
            keys: format!("hardware name: {name}, {gain}, max force: 5"),
        })
        .collect();
    let scenery = Scenery { controller: CONTROLLER, ..Scenery::new(arm_count, 0) };
    let rig = Rig::start(scenery.load(), &wanted, RunnerOptions::default());
    // The end-effectors' gains rise in the first 2 s.
    rig.settle(Duration::from_millis(2200));
    let times: Vec<Instant> = (0..jumps).map(|i| jump(&fake, names, i)).collect();
    let iterations = rig.iterations.all();
    let mut found = Latencies::default();
    for (place, name) in names.iter().enumerate() {
        let (ticks, wrenches) = (rig.traces[place].ticks(), fake.wrenches(name));
        for &at in &times {
            let until = at + PAUSE;
            let since = |found: Instant| (found - at).as_secs_f64();
            let inside = |found: Instant| (at..until).contains(&found);
            let read = ticks
                .windows(2)
                .find(|pair| inside(pair[1].read) && (pair[1].position - pair[0].position).norm() > JUMP / 2.0);
            // What it causes comes after it.
            let read_at = read.map_or(until, |pair| pair[1].read);
            let caused = |found: Instant| (read_at..until).contains(&found);
            let pushed = 0.5 * STIFFNESS * JUMP * SUB_STEP;
            let moved = iterations.windows(2).find(|pair| {
                caused(pair[1].at) && (pair[1].velocities[place] - pair[0].velocities[place]).norm() > pushed
            });
            let felt = wrenches.windows(2).find(|pair| {
                caused(pair[1].at) && (pair[1].wrench.force - pair[0].wrench.force).norm() > FEEDBACK * JUMP / 2.0
            });
            found.read.extend(read.map(|pair| since(pair[1].read)));
            found.moved.extend(moved.map(|pair| since(pair[1].at)));
            found.felt.extend(felt.map(|pair| since(pair[1].at)));
        }
    }
    rig.stop();
    found
}

/// Moves all hands there or back, and waits until all is at rest again.
fn jump(fake: &Fake, names: &[&str], number: usize) -> Instant {
    let x = if number.is_multiple_of(2) { JUMP } else { 0.0 };
    let at = Instant::now();
    names.iter().for_each(|name| fake.set_pose(name, &Isometry3::translation(x, 0.0, 0.0)));
    std::thread::sleep(PAUSE);
    at
}

/// The table.
pub fn measure(effort: &Effort) -> (Section, Vec<(&'static str, Figure)>) {
    let mut rows = Vec::new();
    for &count in effort.arms {
        let mut found = measured(count, effort.jumps);
        let cells = [&mut found.read, &mut found.moved, &mut found.felt].map(|times| {
            times.sort_by(f64::total_cmp);
            match times.as_slice() {
                [] => "–".to_owned(),
                times => format!("{:.2} / {:.2}", percentile(times, 0.5) * 1e3, percentile(times, 0.99) * 1e3),
            }
        });
        let seen = [&found.read, &found.moved, &found.felt].map(|times| times.len().to_string()).join(" / ");
        let seen = format!("{seen} of {}", count * effort.jumps);
        rows.push([count.to_string()].into_iter().chain(cells).chain([seen]).collect());
    }
    let section = Section {
        title: "Latency from the hand to the force",
        intro: "Fake dVRK arms that publish 1000 times a second, over ROS (TCP on this computer, same process), the driver `dvrk`, loops of devices and \
                physics at 1000 Hz. All hands jump by 10 mm at once; p50 / p99 in ms from then on. The wait for the arm's next publication, up to \
                1 ms, is part of all times. *Read*: the device's loop has the pose. *End-effector*: an iteration of physics has ended in which its \
                force acted. *Felt*: a wrench with the change has arrived at the arm's node. That wrench follows from the reference in the same tick \
                of the device, so it does not wait for the end-effector.",
        header: &["arms", "read", "end-effector", "felt", "jumps seen in each"],
        rows,
        remarks: Vec::new(),
    };
    (section, Vec::new())
}
