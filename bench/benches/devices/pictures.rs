//! Five devices and light physics, beside a thread that draws.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::comm::Hub;
use ambf_core::ids::CameraId;
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{RunnerOptions, Simulation};
use ambf_render::{PictureRequest, Renderer, Stage, Stereo, View};

use super::fleet::{Fleet, NAMES};
use super::load::{row, warm_up};
use super::plot::Figure;
use super::rates::Periods;
use super::report::{goal, Section};
use super::rig::{Rig, Scenery, SUB_STEP, TOOLS};
use super::statistics::percentile;
use super::Effort;

/// Pictures a second.
const RATE: f64 = 30.0;
/// Of two eyes of 640 x 480, side by side.
const SIZE: (u32, u32) = (1280, 480);
/// Priority of the thread that draws (`nice`), as in the simulator.
const NICE: i32 = 10;

/// Frames that were drawn: when each was complete, and how long it took.
type Frames = Vec<(Instant, Duration)>;

/// Draws colour and depth for two eyes until it is stopped.
fn draw(hub: &Hub, stop: &AtomicBool) -> Frames {
    let _ = rustix::process::setpriority_process(None, NICE);
    let mut renderer = Renderer::offscreen().expect("OpenGL without a window");
    let mut stage = Stage::default();
    let request = PictureRequest { depth: true, ..PictureRequest::color(SIZE.0, SIZE.1) };
    let (mut frames, mut next) = (Frames::new(), Instant::now());
    while !stop.load(Ordering::Acquire) {
        next = (next + Duration::from_secs_f64(1.0 / RATE)).max(Instant::now());
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        let begin = Instant::now();
        let (Some(snapshot), Some(visuals)) = (hub.snapshot().clone(), hub.visuals()) else { continue };
        let said = renderer.prepare(&mut stage, &visuals, &snapshot);
        assert!(said.is_empty(), "{said:?}");
        let mut view =
            View::of_camera(&visuals.cameras[CameraId::new(0)].description, &snapshot.views[CameraId::new(0)]);
        view.stereo = Some(Stereo { separation: 0.06, focal_length: 3.0 });
        let picture = renderer.render(&mut stage, &view, &request).expect("a picture");
        assert_eq!(picture.depth.len(), (SIZE.0 * SIZE.1) as usize);
        frames.push((Instant::now(), begin.elapsed()));
    }
    frames
}

fn scene() -> Simulation {
    let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
    let world = resources.join("world/world.yaml");
    let files = SceneFiles {
        world: Some(world),
        models: vec![Scenery::new(TOOLS, 0).file(), resources.join("models/arm7.yaml")],
    };
    let loaded = load(&files, &SceneOptions::default());
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Simulation::new(loaded.scene, SUB_STEP)
}

/// The table.
pub fn measure(effort: &Effort) -> (Section, Vec<(&'static str, Figure)>) {
    let (mut rows, mut remarks) = (Vec::new(), Vec::new());
    for (devices, pictures) in [(true, false), (true, true), (false, true)] {
        let scene_words = if devices { "arm and devices" } else { "arm" };
        let picture_words = if pictures { "30 Hz" } else { "none" };
        let fleet = devices.then(Fleet::start);
        let mut simulation = scene();
        warm_up(&mut simulation);
        let hub = simulation.connect();
        hub.set_listening();
        let stop = Arc::<AtomicBool>::default();
        let drawing = pictures.then(|| {
            let (hub, stop) = (Arc::clone(&hub), Arc::clone(&stop));
            std::thread::spawn(move || draw(&hub, &stop))
        });
        let wanted = fleet.as_ref().map_or(&[][..], |fleet| &fleet.wanted);
        let rig = Rig::start(simulation, wanted, RunnerOptions::default());
        let from = rig.settle(effort.settle);
        std::thread::sleep(effort.stretch);
        let to = Instant::now();
        let begins = |ticks: Vec<super::traced::Tick>| Periods::of(ticks.iter().map(|tick| tick.begin), from, to);
        let periods: Vec<Periods> = rig.traces.iter().map(|trace| begins(trace.ticks())).collect();
        let physics = Periods::of(rig.iterations.all().iter().map(|iteration| iteration.at), from, to);
        rig.stop();
        stop.store(true, Ordering::Release);
        let frames = drawing.map(|thread| thread.join().expect("the thread that draws"));
        for (device, name) in periods.iter().zip(NAMES) {
            rows.push(row(scene_words, picture_words, name, device, None));
        }
        rows.push(row(scene_words, picture_words, "physics", &physics, None));
        if let Some(frames) = frames {
            let mut times: Vec<f64> = (frames.iter().filter(|(at, _)| (from..to).contains(at)))
                .map(|(_, time)| time.as_secs_f64() * 1e3)
                .collect();
            times.sort_by(f64::total_cmp);
            let rate = times.len() as f64 / (to - from).as_secs_f64();
            let physics_p99 = physics.percentile(0.99);
            let found = format!(
                "{rate:.1} pictures a second, each {:.1} ms (p99 {:.1} ms); physics at {:.0} Hz with p99 {physics_p99:.2} ms",
                percentile(&times, 0.5),
                percentile(&times, 0.99),
                physics.rate
            );
            remarks.push(if devices {
                let p99 = periods.iter().map(|periods| periods.percentile(0.99)).fold(0.0, f64::max);
                goal(
                    "99 % of each device's periods shorter than 1.5 ms, with pictures",
                    p99 < 1.5,
                    &format!("largest p99 {p99:.2} ms; {found}"),
                )
            } else {
                let is_met = rate > 0.98 * RATE && physics.rate > 990.0 && physics_p99 < 1.5;
                goal("30 stereo pictures a second with depth, physics at 1 kHz with a p99 below 1.5 ms", is_met, &found)
            });
        }
    }
    let section = Section {
        title: "Five devices and pictures",
        intro: "The same loops, with the arm of `resources/models/arm7.yaml` and the shipped lights, without pictures and beside a thread that draws \
                colour and depth of two eyes of 640 × 480 pixels each, 30 times a second, without a graphics card unless there is one.",
        header: &["scene", "pictures", "loop", "mean, Hz", "p50, ms", "p99, ms", "max, ms", "< 1.5 ms, %", "new samples, Hz"],
        rows,
        remarks,
    };
    (section, Vec::new())
}
