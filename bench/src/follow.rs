//! A simulation stepped through its script and judged.

use std::time::Duration;

use ambf_core::sim::Simulation;
use rustix::time::{clock_gettime, ClockId};

use super::invariants::{Seen, Watch};
use super::script::Script;

/// How a run ended, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    Good,
    /// Finite and of bounded energy, but a joint opened, bodies sank into each other or went through one.
    Poor,
    /// Takes longer than real time, and far longer than `legacy`.
    Slow,
    /// More energy than anything can have given.
    Energy,
    /// Not finite.
    Lost,
    /// The file was refused or had errors: a fault of the generator.
    Refused,
}

/// All of them in their order.
pub const VERDICTS: [Verdict; 6] =
    [Verdict::Good, Verdict::Poor, Verdict::Slow, Verdict::Energy, Verdict::Lost, Verdict::Refused];

impl Verdict {
    /// One word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Poor => "poor",
            Self::Slow => "slow",
            Self::Energy => "energy",
            Self::Lost => "lost",
            Self::Refused => "refused",
        }
    }
}

/// What became of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    pub verdict: Verdict,
    pub seen: Seen,
    /// What the simulator said when the state was lost or the file refused.
    pub message: Option<String>,
    /// Mean CPU time of a sub-step, µs.
    pub cost: f64,
    /// Largest CPU time of a sub-step, µs.
    pub worst: f64,
    /// Sub-steps that were done.
    pub steps: u64,
}

impl Outcome {
    /// Of a scene that was not stepped.
    pub fn refused(message: String) -> Self {
        let seen = Seen { energy: 0.0, gap: 0.0, depth: 0.0, speed: 0.0, passed: None, since: f64::NAN };
        Self { verdict: Verdict::Refused, seen, message: Some(message), cost: 0.0, worst: 0.0, steps: 0 }
    }
}

/// Steps to the end of the script, or until the state is lost or stepping has taken CPU time `most`, which is
/// [`Verdict::Slow`].
pub fn follow(simulation: &mut Simulation, script: &Script, most: Duration) -> Outcome {
    // Joint coordinates are known only after an update or a reset; at the start a reset changes nothing else.
    simulation.reset_bodies();
    let mut watch = Watch::new(simulation, script);
    let steps = (script.span / script.step).round() as u64;
    let (mut spent, mut worst, mut done, mut message) = (Duration::ZERO, Duration::ZERO, 0, None);
    for n in 0..steps {
        script.apply(simulation, n);
        watch.before(simulation, script, n);
        let begin = cpu_time();
        let result = simulation.update(script.step);
        let cost = cpu_time().saturating_sub(begin);
        (spent, worst, done) = (spent + cost, worst.max(cost), n + 1);
        if let Err(lost) = result {
            message = Some(lost.to_string());
            break;
        }
        watch.after(simulation, n);
        if spent > most {
            break;
        }
    }
    let seen = watch.seen();
    let verdict = match () {
        () if message.is_some() => Verdict::Lost,
        () if seen.energy > 1.0 => Verdict::Energy,
        () if spent > most => Verdict::Slow,
        () if seen.gap > 1.0 || seen.depth > 1.0 || seen.passed.is_some() => Verdict::Poor,
        () => Verdict::Good,
    };
    let micros = |time: Duration| time.as_secs_f64() * 1e6;
    Outcome { verdict, seen, message, cost: micros(spent) / done.max(1) as f64, worst: micros(worst), steps: done }
}

/// CPU time of this thread.
fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}
