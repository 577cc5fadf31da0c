//! What a driver that fails does to the others.

use std::time::{Duration, Instant};

use ambf_core::sim::RunnerOptions;

use super::fleet::{Fleet, NAMES, STYLUS, TOUCH};
use super::plot::Figure;
use super::rates::Periods;
use super::report::{goal, Section};
use super::rig::{Rig, Scenery, TOOLS};
use super::traced::{Fault, Tick, Trace};
use super::Effort;

/// A force that can be felt, N.
const FELT: f64 = 0.01;
/// What is at least at the motors when a fault begins, N.
const CLEAR: f64 = 0.5;
/// It was there for so long.
const HELD: Duration = Duration::from_millis(100);
/// End-effectors hang 10 mm below their hands, which the Touch shows with 100 N/m, N/kg.
const GRAVITY: f64 = 10.0;
/// How long a failed device may stay away.
const PATIENCE: Duration = Duration::from_secs(20);
/// Until forces that were off are there again.
const RISEN: Duration = Duration::from_millis(1200);
/// After which a device without new forces must let go.
const WATCHDOG: Duration = Duration::from_millis(50);

/// Forces at the motors of the stylus since `frame`: (when, N).
fn motor_forces(fleet: &Fleet, frame: usize, epoch: Instant) -> Vec<(Instant, f64)> {
    let force = |frame| fleet.hd.force(STYLUS, frame);
    let norm = |f: [f64; 3]| f.iter().map(|x| x * x).sum::<f64>().sqrt();
    let at = |time: f64| epoch + Duration::from_secs_f64(time.max(0.0));
    (frame..fleet.hd.frames(STYLUS)).filter_map(force).map(|shown| (at(shown.time), norm(shown.force))).collect()
}

/// Waits for a clear force at the motors: a computer that is busy may have let it go. Gives the frame since which it
/// was there.
fn until_held(fleet: &Fleet, epoch: Instant) -> usize {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let frame = fleet.hd.frames(STYLUS);
        std::thread::sleep(HELD);
        let forces = motor_forces(fleet, frame, epoch);
        if !forces.is_empty() && forces.iter().all(|(_, force)| *force > CLEAR) {
            return frame;
        }
        assert!(Instant::now() < deadline, "there is no force to be let go of");
    }
}

/// When the clock of the fake library was zero: of many tries the one that waited least for its next frame.
fn library_epoch(fleet: &Fleet) -> Instant {
    let tries = (0..200).filter_map(|_| {
        std::thread::sleep(Duration::from_micros(300));
        let shown = fleet.hd.newest_force(STYLUS)?;
        Instant::now().checked_sub(Duration::from_secs_f64(shown.time))
    });
    tries.min().expect("the library has frames")
}

/// What was seen while a driver failed.
struct Suffered {
    name: &'static str,
    from: Instant,
    injected: Instant,
    /// When the driver could have been right again.
    over: Instant,
    to: Instant,
    /// At the motors, since shortly before the fault.
    forces: Vec<(Instant, f64)>,
}

struct Outcome {
    name: &'static str,
    /// The others before and during.
    before: Vec<Periods>,
    during: Vec<Periods>,
    /// The least force at the motors just before the fault, N.
    held: f64,
    /// Until the last force that can be felt, s.
    zero: f64,
    /// From the fault until valid samples come again, s.
    back: f64,
}

/// Injects a fault into the stylus of a rig that has settled.
fn suffer(rig: &Rig, fleet: &Fleet, epoch: Instant, name: &'static str, fault: Fault, before: Duration) -> Suffered {
    let from = Instant::now();
    std::thread::sleep(before);
    let frame = until_held(fleet, epoch);
    let injected = rig.traces[TOUCH].inject(fault);
    let over = injected
        + match fault {
            Fault::Block(time) | Fault::NotANumber(time) | Fault::Disappear(time) => time,
            // It may be in the middle of a read.
            Fault::Panic => Duration::from_millis(5),
        };
    while !rig.traces[TOUCH].is_valid_since(over) {
        assert!(injected.elapsed() < PATIENCE, "{name}: the device does not come back");
        std::thread::sleep(Duration::from_millis(20));
    }
    let to = Instant::now().max(injected + before);
    std::thread::sleep(to.saturating_duration_since(Instant::now()));
    Suffered { name, from, injected, over, to, forces: motor_forces(fleet, frame, epoch) }
}

impl Suffered {
    fn judge(&self, ticks: &[Vec<Tick>]) -> Outcome {
        let held: Vec<f64> =
            self.forces.iter().filter(|(at, _)| *at < self.injected).map(|(_, force)| *force).collect();
        let held = held.iter().copied().reduce(f64::min).expect("frames before the fault");
        let back =
            ticks[TOUCH].iter().find(|tick| tick.is_valid && tick.read > self.over).map_or(self.to, |tick| tick.read);
        // Forces rise again once the device is back.
        let felt = self.forces.iter().filter(|(at, force)| *at < back && *force > FELT).map(|(at, _)| *at).max();
        let others = |from, to| {
            let lines = ticks.iter().enumerate().filter(|(i, _)| *i != TOUCH);
            lines.map(|(_, ticks)| Periods::of(ticks.iter().map(|tick| tick.begin), from, to)).collect()
        };
        Outcome {
            name: self.name,
            before: others(self.from, self.injected),
            during: others(self.injected, self.to),
            held,
            zero: felt.map_or(0.0, |at| at.saturating_duration_since(self.injected).as_secs_f64()),
            back: (back - self.injected).as_secs_f64(),
        }
    }
}

/// The table.
pub fn measure(effort: &Effort) -> (Section, Vec<(&'static str, Figure)>) {
    let fleet = Fleet::start();
    let scenery = Scenery { gravity: GRAVITY, ..Scenery::new(TOOLS, 0) };
    let mut rig = Rig::start(scenery.load(), &fleet.wanted, RunnerOptions::default());
    rig.settle(effort.settle.max(RISEN));
    let epoch = library_epoch(&fleet);
    let faults = [
        (effort.block_words, Fault::Block(effort.block)),
        ("panics once", Fault::Panic),
        ("returns NaN for 0.3 s", Fault::NotANumber(Duration::from_millis(300))),
        (effort.away_words, Fault::Disappear(effort.away)),
    ];
    let mut suffered = Vec::new();
    for (name, fault) in faults {
        suffered.push(suffer(&rig, &fleet, epoch, name, fault, effort.before));
        std::thread::sleep(RISEN);
        rig.news();
    }
    let traces = rig.traces.clone();
    rig.stop();
    let ticks: Vec<_> = traces.iter().map(Trace::ticks).collect();
    let outcomes: Vec<_> = suffered.iter().map(|suffered| suffered.judge(&ticks)).collect();
    let others: Vec<_> = NAMES.iter().enumerate().filter(|(i, _)| *i != TOUCH).map(|(_, name)| *name).collect();
    let mut rows = Vec::new();
    for outcome in &outcomes {
        for ((name, before), during) in others.iter().zip(&outcome.before).zip(&outcome.during) {
            let pair = |of: fn(&Periods) -> f64, digits| format!("{:.digits$} → {:.digits$}", of(before), of(during));
            rows.push(vec![
                outcome.name.to_owned(),
                (*name).to_owned(),
                pair(|periods| periods.rate, 0),
                pair(|periods| periods.percentile(0.5), 2),
                pair(|periods| periods.percentile(0.99), 2),
                pair(Periods::max, 1),
            ]);
        }
    }
    let mut remarks: Vec<String> = outcomes
        .iter()
        .map(|outcome| {
            let limit = WATCHDOG.as_secs_f64() + 0.002;
            goal(
                &format!("a Touch whose driver {}: no force after {:.0} ms, back by itself", outcome.name, limit * 1e3),
                outcome.zero <= limit,
                &format!(
                    "at least {:.2} N at its motors before, the last force there {:.1} ms after the fault began, first good tick after {:.2} s",
                    outcome.held,
                    outcome.zero * 1e3,
                    outcome.back
                ),
            )
        })
        .collect();
    let pairs = || outcomes.iter().flat_map(|outcome| outcome.before.iter().zip(&outcome.during));
    let shift = pairs().map(|(b, d)| d.percentile(0.99) - b.percentile(0.99)).fold(f64::NEG_INFINITY, f64::max);
    let middle = pairs().map(|(b, d)| (d.percentile(0.5) - b.percentile(0.5)).abs()).fold(0.0, f64::max);
    remarks.push(goal(
        "the others' periods stay as they are: p50 within 0.05 ms, p99 no more than 0.2 ms longer",
        middle <= 0.05 && shift <= 0.2,
        &format!("p50 moves by at most {middle:.3} ms, p99 rises by at most {shift:.2} ms"),
    ));
    let section = Section {
        title: "One driver fails",
        intro: "All five devices run; the driver of the Touch fails in `read`. The others' loops before → during: until the Touch is back, at least as \
                long as before. Its end-effector hangs below the hand, which the hand feels all the time. The last force is the one that reached the motors of the fake HD library: where the driver does not return, the device \
                must let go by itself, 50 ms after the last force that it was told.",
        header: &["the driver", "other device", "mean, Hz", "p50, ms", "p99, ms", "max, ms"],
        rows,
        remarks,
    };
    (section, Vec::new())
}
