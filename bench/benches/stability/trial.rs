//! One scene, stepped and watched.

use std::time::Duration;

use ambf_core::bullet::{Contact, World};
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, Point3, Vector3};
use rustix::time::{clock_gettime, ClockId};

use super::system::{Freedom, Joint, System};

/// Energy above what is allowed by this factor is an explosion.
const EXPLOSION: f64 = 10.0;
/// A run is looked at this often, at most.
const LOOKS: u64 = 1500;

/// What is done before iteration `n`, and the length of that iteration, s.
pub type Act = Box<dyn FnMut(&mut Simulation, u64) -> f64>;
/// A deviation of the trial's own, at the present state; unit as the trial says.
pub type Stray = Box<dyn Fn(&Simulation) -> f64>;

/// What a run may do; NaN: not looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Energy above that of the start, J.
    pub energy: f64,
    /// Between the pivots of a joint on its two bodies, m.
    pub gap: f64,
    /// Of bodies in each other, m.
    pub depth: f64,
    /// Of the trial's own deviation.
    pub stray: f64,
}

/// A scene and what is asked of it.
pub struct Trial {
    pub system: System,
    /// Replacements in the model file that [`System::adf`] makes.
    pub edits: Vec<(String, String)>,
    /// Most sub-steps of an iteration.
    pub cap: u32,
    /// Sub-step, s.
    pub step: f64,
    /// Simulated time, s.
    pub span: f64,
    /// `None`: nothing is done, and an iteration is a sub-step.
    pub act: Option<Act>,
    /// `None`: there is none.
    pub stray: Option<Stray>,
    /// The deviation counts from this time on, s.
    pub settled: f64,
    pub limits: Limits,
}

impl Trial {
    /// A system in sub-steps of 1 ms for `span` s that may gain `energy` J.
    pub fn of(system: System, span: f64, energy: f64) -> Self {
        let limits = Limits { energy, gap: f64::NAN, depth: f64::NAN, stray: f64::NAN };
        Self { system, edits: Vec::new(), cap: 1000, step: 0.001, span, act: None, stray: None, settled: 0.0, limits }
    }

    /// Puts keys, each with a comma after it, into a joint.
    pub fn joint_keys(&mut self, joint: usize, keys: &str) {
        let head = format!("JOINT {joint}: {{");
        self.edits.push((head.clone(), head + keys));
    }

    /// The same for a body.
    pub fn body_keys(&mut self, body: usize, keys: &str) {
        let head = format!("BODY {body}: {{");
        self.edits.push((head.clone(), head + keys));
    }
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    Good,
    /// Finite and of bounded energy, but some limit was passed.
    Poor,
    Exploded,
    NotFinite,
    /// It was not waited for.
    Slow,
}

/// What was seen. Largest values; NaN: not looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    pub verdict: Verdict,
    /// As in [`Limits`], but energy as a multiple of what is allowed.
    pub seen: Limits,
    /// What the simulator said when the state was lost.
    pub message: Option<String>,
}

/// Runs a trial; what takes more CPU time than `most` is given up.
///
/// # Panics
/// When the scene has an error: they are all right.
pub fn run(name: &str, mut trial: Trial, physics: PhysicsOptions, most: Duration) -> Outcome {
    let mut simulation = simulation(name, &trial, physics);
    let mut probe = Probe::new(&trial, &simulation);
    let begin = cpu_time();
    let every = ((trial.span / trial.step) as u64 / LOOKS).max(1);
    let (mut message, mut slow) = (None, false);
    for n in 0.. {
        if simulation.sim_time() >= trial.span - trial.step / 2.0 {
            break;
        }
        let interval = trial.act.as_mut().map_or(trial.step, |act| act(&mut simulation, n));
        if let Err(lost) = simulation.update(interval) {
            message = Some(lost.to_string());
            break;
        }
        if n % every == 0 {
            probe.look(&trial, &simulation);
            slow = cpu_time() - begin > most;
            if slow {
                break;
            }
        }
    }
    if message.is_none() {
        probe.look(&trial, &simulation);
    }
    let verdict = match &message {
        Some(_) => Verdict::NotFinite,
        None => judge(&probe.seen, &trial.limits, slow),
    };
    let seen = Limits { energy: probe.seen.energy / trial.limits.energy, ..probe.seen };
    Outcome { verdict, seen, message }
}

/// CPU time of this thread.
fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

fn judge(seen: &Limits, limits: &Limits, slow: bool) -> Verdict {
    // What is not looked at passes.
    let within = |seen: f64, limit: f64| seen.is_nan() || limit.is_nan() || seen <= limit;
    let all = within(seen.energy, limits.energy)
        && within(seen.gap, limits.gap)
        && within(seen.depth, limits.depth)
        && within(seen.stray, limits.stray);
    match (all, within(seen.energy, EXPLOSION * limits.energy)) {
        (_, false) => Verdict::Exploded,
        _ if slow => Verdict::Slow,
        (true, _) => Verdict::Good,
        (false, _) => Verdict::Poor,
    }
}

fn simulation(name: &str, trial: &Trial, physics: PhysicsOptions) -> Simulation {
    let folder = ambf_bench::folder();
    let (world, mut model) = trial.system.adf("");
    for (from, to) in &trial.edits {
        assert!(model.contains(from), "{name}: `{from}` is not in the model");
        model = model.replace(from, to);
    }
    let world = world.replace("max iterations: 1000", &format!("max iterations: {}", trial.cap));
    let write = |kind: &str, text: String| {
        let path = folder.join(format!("stability_{name}_{kind}.yaml"));
        std::fs::write(&path, text).expect("the target folder can be written");
        path
    };
    let files = SceneFiles { world: Some(write("world", world)), models: vec![write("model", model)] };
    let mut loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{name}: {}", loaded.report);
    let handles = loaded.scene.world.bodies().to_vec();
    for (body, handle) in trial.system.bodies.iter().zip(handles) {
        loaded.scene.world.set_velocity(handle, &body.velocity, &body.spin);
    }
    let step = loaded.scene.sub_step.unwrap_or(trial.step);
    Simulation::new(loaded.scene, step)
}

/// Where a joint's pivot is on either body.
struct Pivot {
    joint: Joint,
    on_parent: Point3<f64>,
    on_child: Point3<f64>,
    axis_in_parent: Vector3<f64>,
}

/// What is looked at, and the worst that was seen.
struct Probe {
    pivots: Vec<Pivot>,
    energy: f64,
    seen: Limits,
    contacts: Vec<Contact>,
}

impl Probe {
    fn new(trial: &Trial, simulation: &Simulation) -> Self {
        let System { bodies, joints, closures, .. } = &trial.system;
        let pivot = |&joint: &Joint| {
            let [parent, child] = [joint.parent, joint.child].map(|body| bodies[body].pose.inverse());
            let point = Point3::from(joint.pivot);
            Pivot { joint, on_parent: parent * point, on_child: child * point, axis_in_parent: parent * joint.axis }
        };
        let wanted = |limit: f64| if limit.is_nan() { f64::NAN } else { 0.0 };
        let Limits { gap, depth, stray, .. } = trial.limits;
        Self {
            pivots: joints.iter().chain(closures).map(pivot).collect(),
            energy: energy(&trial.system, simulation),
            seen: Limits { energy: 0.0, gap: wanted(gap), depth: wanted(depth), stray: wanted(stray) },
            contacts: Vec::new(),
        }
    }

    fn look(&mut self, trial: &Trial, simulation: &Simulation) {
        let world = &simulation.scene().world;
        // The larger one; NaN where nothing is looked at stays.
        let worse = |seen: &mut f64, value: f64| {
            if value > *seen {
                *seen = value;
            }
        };
        let gain = energy(&trial.system, simulation) - self.energy;
        // An energy that overflows is no number.
        worse(&mut self.seen.energy, if gain.is_nan() { f64::INFINITY } else { gain });
        for pivot in &self.pivots {
            let [parent, child] = [pivot.joint.parent, pivot.joint.child].map(|body| pose(world, body));
            let mut apart = child * pivot.on_child - parent * pivot.on_parent;
            if pivot.joint.freedom == Freedom::Slider {
                let axis = parent * pivot.axis_in_parent;
                apart -= axis * axis.dot(&apart);
            }
            worse(&mut self.seen.gap, apart.norm());
        }
        if !self.seen.depth.is_nan() {
            for &body in world.bodies() {
                world.contacts(body, 0.0, &mut self.contacts);
                self.contacts.iter().for_each(|contact| worse(&mut self.seen.depth, -contact.distance));
            }
        }
        if let Some(stray) = trial.stray.as_ref().filter(|_| simulation.sim_time() >= trial.settled) {
            worse(&mut self.seen.stray, stray(simulation));
        }
    }
}

/// True pose of a body, as counted in the system.
pub fn pose(world: &World, body: usize) -> Isometry3<f64> {
    world.pose(world.bodies()[body]).expect("nothing is removed")
}

/// Kinetic and potential, J.
pub fn energy(system: &System, simulation: &Simulation) -> f64 {
    let world = &simulation.scene().world;
    let of = |(index, body): (usize, &super::system::Body)| {
        if body.mass == 0.0 {
            return 0.0;
        }
        let pose = pose(world, index);
        let (velocity, spin) = world.velocity(world.bodies()[index]).expect("nothing is removed");
        let spin = pose.rotation.inverse() * spin;
        body.mass * (velocity.norm_squared() / 2.0 - system.gravity.dot(&pose.translation.vector))
            + spin.component_mul(&spin).dot(&body.inertia) / 2.0
    };
    system.bodies.iter().enumerate().map(of).sum()
}
