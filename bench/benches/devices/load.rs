//! Five devices, asynchronous and sequential, with light and with heavy physics.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use ambf_core::device::law::{HapticInput, HapticLoop, Switches, WorldView};
use ambf_core::device::{DeviceError, DeviceForce, DeviceLog, DeviceSample, InputDevice};
use ambf_core::ids::BodyId;
use ambf_core::sim::{RunnerOptions, Simulation};

use super::fleet::{Fleet, NAMES};
use super::plot::{linear_lines, Figure, Line};
use super::rates::{over_time, Periods};
use super::report::{goal, Section};
use super::rig::{entries, watch, Iterations, Rig, Scenery, SUB_STEP, TOOLS};
use super::traced::{Tick, Trace};
use super::Effort;

/// Rate of physics in the heavy scene, Hz.
const HEAVY_RATE: f64 = 300.0;
/// How wide the slices of the figures are.
const SLICE: Duration = Duration::from_millis(100);
/// A device that says nothing new for longer is not waited for.
const SILENCE: Duration = Duration::from_millis(100);

/// Boxes with which physics runs at about [`HEAVY_RATE`] here and now, beside five devices.
pub fn heavy_boxes() -> usize {
    static FOUND: OnceLock<usize> = OnceLock::new();
    *FOUND.get_or_init(find_heavy_boxes)
}

fn find_heavy_boxes() -> usize {
    let mut boxes = 200;
    for _ in 0..3 {
        let fleet = Fleet::start();
        let mut simulation = Scenery::new(TOOLS, boxes).load();
        warm_up(&mut simulation);
        let run = asynchronous(simulation, &fleet, true, Duration::from_millis(300), Duration::from_secs(1));
        let rate = Periods::of(run.iterations.iter().copied(), run.from, run.to).rate;
        boxes = (boxes as f64 * rate / HEAVY_RATE).clamp(20.0, 4000.0) as usize;
    }
    boxes
}

/// Lets what overlaps or hangs come to rest.
pub fn warm_up(simulation: &mut Simulation) {
    for _ in 0..60 {
        simulation.update(SUB_STEP).expect("a finite state");
    }
}

/// What a run gave: ticks of each device, iterations, and the stretch that counts.
struct Run {
    ticks: Vec<Vec<Tick>>,
    iterations: Vec<Instant>,
    from: Instant,
    to: Instant,
}

fn asynchronous(simulation: Simulation, fleet: &Fleet, fixed_step: bool, settle: Duration, stretch: Duration) -> Run {
    let rig = Rig::start(simulation, &fleet.wanted, RunnerOptions { fixed_step, ..RunnerOptions::default() });
    let from = rig.settle(settle);
    std::thread::sleep(stretch);
    let to = Instant::now();
    let run = gather(&rig.traces, &rig.iterations, from, to);
    rig.stop();
    run
}

fn gather(traces: &[Trace], iterations: &Iterations, from: Instant, to: Instant) -> Run {
    let iterations = iterations.all().iter().map(|iteration| iteration.at).collect();
    Run { ticks: traces.iter().map(Trace::ticks).collect(), iterations, from, to }
}

/// A device of the sequential loop.
struct InLine {
    device: Box<dyn InputDevice>,
    law: HapticLoop,
    body: BodyId,
    sequence: u64,
    last: Instant,
}

impl InLine {
    /// Waits for a new sample, as drivers do that talk to their device in the calling thread.
    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        let begin = Instant::now();
        loop {
            let sample = self.device.read()?;
            if sample.sequence != self.sequence || begin.elapsed() > SILENCE {
                self.sequence = sample.sequence;
                return Ok(sample);
            }
            std::thread::sleep(Duration::from_micros(20));
        }
    }
}

/// Everything in one loop, one after the other.
fn sequential(mut simulation: Simulation, fleet: &Fleet, fixed_step: bool, effort: &Effort) -> Run {
    let (entries, drivers, traces) = entries(&fleet.wanted);
    let iterations = watch(&mut simulation);
    let (log, _said) = DeviceLog::new();
    let bodies = &simulation.scene().bodies;
    let mut devices: Vec<InLine> = Vec::new();
    for (i, (entry, driver)) in entries.iter().zip(&drivers).enumerate() {
        let found = driver.find(&entry.hardware_name, &entry.driver_settings).expect("devices");
        let wanted = |identity: &String| entry.identity.as_ref().is_none_or(|wanted| wanted == identity);
        let info = found.into_iter().find(|info| wanted(&info.identity)).expect("the device");
        let device = driver.open(&info, &entry.driver_settings, &log).expect("the device opens");
        let name = format!("Tool{i}");
        let body = bodies.position(|body| *body.identity.name == *name).expect("its end-effector");
        let law = HapticLoop::new(entry, device.spec(), bodies[body].pose(&simulation.scene().world));
        devices.push(InLine { device, law, body, sequence: u64::MAX, last: Instant::now() });
    }
    let switches = Switches { forces: true, ..Switches::default() };
    let begin = Instant::now();
    let (mut next, mut all_there) = (begin, None);
    let limit = if fixed_step { SUB_STEP } else { 0.05 };
    let (from, to) = loop {
        let mut valid = true;
        for line in &mut devices {
            let sample = line.read().expect("a sample");
            valid &= sample.valid;
            let now = Instant::now();
            let dt = (now - std::mem::replace(&mut line.last, now)).as_secs_f64();
            let scene = simulation.scene();
            let root = Some(scene.bodies[line.body].pose(&scene.world));
            let view = WorldView { root, camera: None, paused: false, stale: false, reset: false };
            let output = line.law.tick(&HapticInput { sample, view, time: (now - begin).as_secs_f64(), dt, switches });
            let force = if output.force.is_finite() { output.force } else { DeviceForce::zero() };
            line.device.write(&force).expect("a force is taken");
            let rotation = output.reference.rotation.coords;
            let rotation = [rotation.x, rotation.y, rotation.z, rotation.w];
            simulation.follow_pose(line.body, output.reference.translation.vector, rotation);
        }
        let lag = (begin.elapsed().as_secs_f64() - simulation.sim_time()).clamp(SUB_STEP, limit);
        simulation.iterate(lag).expect("a finite state");
        let now = Instant::now();
        if valid {
            let since = *all_there.get_or_insert(now);
            let (from, to) = (since + effort.settle, since + effort.settle + effort.stretch);
            if now >= to {
                break (from, to);
            }
        }
        assert!(begin.elapsed() < Duration::from_secs(90), "a device gives no valid samples");
        next = (next + Duration::from_millis(1)).max(now);
        std::thread::sleep(next - now);
    };
    devices.iter_mut().for_each(|line| line.device.close());
    gather(&traces, &iterations, from, to)
}

/// Begin of ticks, and reads that brought something new.
fn events(ticks: &[Tick]) -> (impl Iterator<Item = Instant> + '_, impl Iterator<Item = Instant> + '_) {
    let fresh = ticks.windows(2).filter(|pair| pair[0].sequence != pair[1].sequence).map(|pair| pair[1].read);
    (ticks.iter().map(|tick| tick.begin), fresh)
}

/// A row of the table.
pub fn row(scene: &str, control: &str, name: &str, periods: &Periods, fresh: Option<f64>) -> Vec<String> {
    let cells = [
        format!("{:.0}", periods.rate),
        format!("{:.2}", periods.percentile(0.5)),
        format!("{:.2}", periods.percentile(0.99)),
        format!("{:.1}", periods.max()),
        format!("{:.1}", periods.below(1.5)),
        fresh.map_or_else(|| "–".into(), |rate| format!("{rate:.0}")),
    ];
    [scene, control, name].map(str::to_owned).into_iter().chain(cells).collect()
}

/// The table and its figures.
pub fn measure(effort: &Effort) -> (Section, Vec<(&'static str, Figure)>) {
    let boxes = heavy_boxes();
    let (mut rows, mut figures, mut remarks) = (Vec::new(), Vec::new(), Vec::new());
    let mut means = Vec::new();
    for (scene, file, boxes) in [("light", "devices-light.svg", 0), ("heavy", "devices-heavy.svg", boxes)] {
        let mut lines = Vec::new();
        for control in ["asynchronous", "sequential"] {
            let fleet = Fleet::start();
            let mut simulation = Scenery::new(TOOLS, boxes).load();
            warm_up(&mut simulation);
            let run = match control {
                "asynchronous" => asynchronous(simulation, &fleet, boxes > 0, effort.settle, effort.stretch),
                _ => sequential(simulation, &fleet, boxes > 0, effort),
            };
            let found: Vec<Periods> = run
                .ticks
                .iter()
                .zip(NAMES)
                .map(|(ticks, name)| {
                    let (begins, fresh) = events(ticks);
                    let periods = Periods::of(begins, run.from, run.to);
                    let fresh = Periods::of(fresh, run.from, run.to).rate;
                    rows.push(row(scene, control, name, &periods, Some(fresh)));
                    periods
                })
                .collect();
            let physics = Periods::of(run.iterations.iter().copied(), run.from, run.to);
            rows.push(row(scene, control, "physics", &physics, None));
            if control == "asynchronous" {
                for (ticks, name) in run.ticks.iter().zip(NAMES) {
                    lines.push(Line { name, points: over_time(events(ticks).0, run.from, run.to, SLICE) });
                }
                remarks.push(judged(scene, &found, &physics));
            }
            let name = if control == "asynchronous" { "physics" } else { "all, sequential" };
            lines.push(Line { name, points: over_time(run.iterations.iter().copied(), run.from, run.to, SLICE) });
            means.push((scene, control, found.iter().map(|periods| periods.rate).sum::<f64>() / TOOLS as f64));
        }
        let title = format!("Five devices and a {scene} scene");
        figures.push((file, linear_lines(&title, "time, s", "Hz, in slices of 0.1 s", 1200.0, &lines)));
        remarks.push(format!("![Rates with a {scene} scene]({file})"));
    }
    for pair in means.chunks(2) {
        let [(scene, _, apart), (_, _, together)] = pair else { continue };
        remarks.push(format!(
            "{} scene: asynchronous devices run at {apart:.0} Hz on average, sequential ones at {together:.0} Hz.",
            if *scene == "light" { "Light" } else { "Heavy" }
        ));
    }
    remarks.push(format!(
        "The heavy scene has {boxes} boxes in stacks of two: so many that physics ran at about {HEAVY_RATE} Hz beside the devices in a trial before."
    ));
    let section = Section {
        title: "Five devices: asynchronous and sequential control",
        intro: "Periods of each device's loop, ms, from the begin of a read to the next. *New samples*: reads that brought another measurement than \
                the one before, Hz. The sequential loop reads and writes all five devices in turn, each read waiting for a new sample as drivers do \
                that talk to their device in the calling thread, and then steps physics; it is part of the benchmark, not of the simulator. Light: \
                the end-effectors alone, dynamic step. Heavy: boxes at rest on each other and a fixed step, so that physics is slow, not long.",
        header: &["scene", "control", "loop", "mean, Hz", "p50, ms", "p99, ms", "max, ms", "< 1.5 ms, %", "new samples, Hz"],
        rows,
        remarks,
    };
    (section, figures)
}

/// The goals of asynchronous control; with a heavy scene they are no goals, only worth knowing.
fn judged(scene: &str, devices: &[Periods], physics: &Periods) -> String {
    let low = devices.iter().map(|periods| periods.rate).fold(f64::INFINITY, f64::min);
    let high = devices.iter().map(|periods| periods.rate).fold(0.0, f64::max);
    let below = devices.iter().map(|periods| periods.below(1.5)).fold(100.0, f64::min);
    let longest = devices.iter().map(Periods::max).fold(0.0, f64::max);
    let met = low >= 980.0 && high <= 1020.0 && below >= 99.0;
    let found = format!(
        "means {low:.0} to {high:.0} Hz, at least {below:.1} % of periods, longest {longest:.1} ms, physics at {:.0} Hz",
        physics.rate
    );
    let words = "each device's loop at 980 to 1020 Hz on average and 99 % of its periods shorter than 1.5 ms";
    match scene {
        "light" => goal(&format!("with light physics, {words}"), met, &found),
        _ => format!("With heavy physics ({words} is no goal there): {found}."),
    }
}
