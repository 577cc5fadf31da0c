//! Step costs: several ways to step a scene ("lanes"), in turn and in one process, so that their ratios don't depend on
//! what else the machine does. A worker process measures, because only one ROS node and one peak of memory fit into a
//! process.

use std::fs::read_to_string;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use ambf_app::ros::naming::object_names;
use ambf_app::ros::{RosMiddleware, RosOptions};
use ambf_core::comm::{Hub, Middleware};
use ambf_core::scene::{load, SceneOptions};
use ambf_core::sim::{Runner, RunnerOptions, Simulation, DEFAULT_SUB_STEP};

use super::ros_common::{published_topics, until, use_own_master};
use super::scenes::Scene;
use super::statistics::Spread;

/// The word that makes this program a worker.
pub const WORKER: &str = "--worker";

/// Steps of every lane before it is measured: boxes have landed, robots have settled.
const WARM_UP: usize = 1500;

/// A way to step a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// `Simulation::update` alone, as `ambf_batch` does.
    Update,
    /// The physics thread with a hub that nobody listens to, as `ambf_simulator --no_ros` does.
    Loop,
    /// The physics thread with ROS up and nobody subscribed.
    Ros,
}

impl Mode {
    const NAMES: [(&'static str, Self); 3] = [("update", Self::Update), ("loop", Self::Loop), ("ros", Self::Ros)];

    fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, mode)| *mode == self).expect("every mode has a name").0
    }
}

/// What one slice of time cost.
#[derive(Debug, Clone, Copy)]
struct Slice {
    steps: f64,
    wall: f64,
    bullet: f64,
    /// CPU time of the threads that do not step, s.
    others: f64,
}

/// What a lane cost.
#[derive(Debug, Clone)]
pub struct Lane {
    /// s.
    pub load: f64,
    pub bodies: usize,
    /// Rays that sensors cast in each step.
    pub rays: usize,
    slices: Vec<Slice>,
}

impl Lane {
    fn spread(&self, value: impl Fn(&Slice) -> f64) -> Spread {
        Spread::of(self.slices.iter().map(value)).expect("a lane has slices")
    }

    /// Time in Bullet, µs a step.
    pub fn inside(&self) -> Spread {
        self.spread(|slice| slice.bullet / slice.steps * 1e6)
    }

    /// Time outside Bullet, µs a step.
    pub fn outside(&self) -> Spread {
        self.spread(|slice| (slice.wall - slice.bullet) / slice.steps * 1e6)
    }

    /// The whole step over that of `other` in the slice that was measured right before or after.
    pub fn over(&self, other: &Self) -> Spread {
        let us = |slice: &Slice| slice.wall / slice.steps;
        let pairs = self.slices.iter().zip(&other.slices);
        Spread::of(pairs.map(|(mine, theirs)| us(mine) / us(theirs))).expect("a lane has slices")
    }

    /// Outside as a share of inside, %.
    pub fn overhead(&self) -> Spread {
        self.spread(|slice| (slice.wall / slice.bullet - 1.0) * 100.0)
    }

    /// CPU of the threads that do not step, % of a core.
    pub fn others(&self) -> Spread {
        self.spread(|slice| slice.others / slice.wall * 100.0)
    }
}

/// How long to measure.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    pub slice: Duration,
    pub rounds: usize,
}

/// Measures lanes in a worker; `Err` with what it said when the scene cannot be stepped.
pub fn measure(effort: Effort, lanes: &[(Mode, &Scene)]) -> Result<Vec<Lane>, String> {
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut command = Command::new(program);
    command.args([WORKER, &effort.slice.as_millis().to_string(), &effort.rounds.to_string()]);
    for (mode, scene) in lanes {
        command.args([mode.name(), &scene.launch.display().to_string(), &scene.model]);
    }
    let output = command.stderr(Stdio::piped()).output().map_err(|error| error.to_string())?;
    let text = String::from_utf8_lossy(&output.stdout);
    if !output.status.success() {
        let told = String::from_utf8_lossy(&output.stderr);
        return Err(told.lines().next_back().unwrap_or("it ended without a word").to_owned());
    }
    let mut measured = Vec::new();
    for line in text.lines() {
        let numbers: Vec<f64> = line.split_whitespace().map(|text| text.parse().expect("a number")).collect();
        match numbers[..] {
            [load, bodies, rays] => {
                measured.push(Lane { load, bodies: bodies as usize, rays: rays as usize, slices: Vec::new() })
            }
            [lane, steps, wall, bullet, others] => {
                measured[lane as usize].slices.push(Slice { steps, wall, bullet, others })
            }
            _ => return Err(format!("a worker said `{line}`")),
        }
    }
    Ok(measured)
}

/// The worker: loads each lane's scene, then steps them in turn and prints a line a slice.
pub fn work(arguments: &[String]) {
    let number = |text: &String| text.parse::<u64>().expect("a number");
    let (slice, rounds) = (Duration::from_millis(number(&arguments[0])), number(&arguments[1]));
    let mut lanes: Vec<Working> = arguments[2..].chunks(3).map(Working::new).collect();
    for _ in 0..rounds {
        for (index, lane) in lanes.iter_mut().enumerate() {
            let Slice { steps, wall, bullet, others } = lane.run(slice);
            println!("{index} {steps} {wall:e} {bullet:e} {others:e}");
        }
    }
}

struct Working {
    mode: Mode,
    simulation: Option<Simulation>,
    _ros: Option<RosMiddleware>,
}

impl Working {
    fn new(arguments: &[String]) -> Self {
        let [mode, launch, model] = arguments else { panic!("a lane is a mode, a launch file and a model") };
        let mode = Mode::NAMES.iter().find(|(name, _)| name == mode).expect("a known mode").1;
        let scene = Scene { name: String::new(), launch: launch.into(), model: model.clone() };
        let begin = Instant::now();
        let loaded = load(&scene.files(), &SceneOptions::default());
        assert!(loaded.report.refused.is_empty(), "{}", loaded.report.refused[0]);
        let mut simulation = Simulation::new(loaded.scene, DEFAULT_SUB_STEP);
        let rays: usize = simulation.scene().sensors.iter().map(|sensor| sensor.rays.len()).sum();
        println!("{:e} {} {rays}", begin.elapsed().as_secs_f64(), simulation.scene().bodies.len());
        simulation.measure_bullet_time();
        for _ in 0..WARM_UP {
            step(&mut simulation);
        }
        let ros = match mode {
            Mode::Update => None,
            Mode::Loop => {
                simulation.connect();
                None
            }
            Mode::Ros => Some(serve(simulation.connect())),
        };
        Self { mode, simulation: Some(simulation), _ros: ros }
    }

    fn run(&mut self, slice: Duration) -> Slice {
        let mut simulation = self.simulation.take().expect("it comes back after every slice");
        let (first, bullet, others) = (simulation.sim_step(), simulation.bullet_time(), other_threads());
        let begin = Instant::now();
        let wall = if self.mode == Mode::Update {
            while begin.elapsed() < slice {
                (0..16).for_each(|_| step(&mut simulation));
            }
            begin.elapsed()
        } else {
            // So often that it never waits: each iteration simulates 1 ms.
            let options = RunnerOptions { frequency: 1e9, fixed_step: true, speed_factor: 1e6 };
            let runner = Runner::start(simulation, options);
            std::thread::sleep(slice);
            let paused = runner.control().is_paused();
            simulation = runner.stop().expect("the physics thread ends in good order");
            assert!(!paused, "the state became non-finite");
            begin.elapsed()
        };
        let slice = Slice {
            steps: f64::from(simulation.sim_step() - first),
            wall: wall.as_secs_f64(),
            bullet: (simulation.bullet_time() - bullet).as_secs_f64(),
            others: other_threads() - others,
        };
        self.simulation = Some(simulation);
        slice
    }
}

fn step(simulation: &mut Simulation) {
    if let Err(problem) = simulation.update(DEFAULT_SUB_STEP) {
        panic!("{problem}");
    }
}

/// ROS with every topic announced to an embedded master.
fn serve(hub: std::sync::Arc<Hub>) -> RosMiddleware {
    let master = use_own_master();
    let last = object_names(hub.objects().iter().map(|object| &object.info)).pop().expect("the world at least");
    let topic = format!("{last}/State");
    let mut ros = RosMiddleware::new(RosOptions::default());
    ros.start(hub).expect("ROS starts");
    until(&format!("topic {topic}"), || published_topics(&master).iter().any(|(name, _)| *name == topic));
    std::thread::sleep(Duration::from_millis(500));
    ros
}

/// CPU time of all threads but the main one, s. The physics thread of a lane has ended when this is called.
fn other_threads() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    let main = std::process::id().to_string();
    let others = tasks.flatten().filter(|task| task.file_name().to_string_lossy() != main);
    let ns = others.filter_map(|task| {
        let stat = read_to_string(task.path().join("schedstat")).ok()?;
        stat.split_whitespace().next()?.parse::<f64>().ok()
    });
    ns.sum::<f64>() * 1e-9
}
