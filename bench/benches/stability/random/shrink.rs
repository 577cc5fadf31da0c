//! A failing scene made small: parts are taken away and numbers simplified as long as the verdict stays (delta
//! debugging).

use std::path::Path;
use std::time::{Duration, Instant};

use nalgebra::Vector3;

use super::follow::{Outcome, Verdict};
use super::run;
use super::scene::Scene;

/// Runs that may be spent on one scene.
const TRIALS: usize = 600;
/// Time that may be spent on one scene.
const PATIENCE: Duration = Duration::from_secs(60);

/// The smallest scene that was found to end in the accurate profile as `scene` did, where `outcome` was seen.
pub fn shrink(scene: &Scene, outcome: &Outcome, path: &Path) -> Scene {
    let until = Instant::now() + PATIENCE;
    let mut shrinker = Shrinker { best: scene.clone(), outcome, path, left: TRIALS, until };
    // Slow scenes depend on the machine: they are kept as they are.
    if outcome.verdict == Verdict::Slow {
        return shrinker.best;
    }
    let seen = outcome.seen.since;
    let end = if seen.is_finite() { 1.5 * seen } else { outcome.steps as f64 * scene.step };
    shrinker.attempt(|scene| scene.span = scene.span.min(end));
    shrinker.shorten();
    while shrinker.round() {}
    shrinker.shorten();
    shrinker.best
}

struct Shrinker<'p> {
    best: Scene,
    outcome: &'p Outcome,
    path: &'p Path,
    left: usize,
    until: Instant,
}

/// Whether a smaller scene fails as the first one did and not in a milder way of its own.
fn is_same(first: &Outcome, other: &Outcome) -> bool {
    // A tenth of what was seen, and a failure by a factor where the first was one.
    let near = |first: f64, other: f64| other >= (0.1 * first).min(1e3).max(first.min(3.0));
    other.verdict == first.verdict
        && match first.verdict {
            Verdict::Energy => near(first.seen.energy, other.seen.energy),
            Verdict::Poor if first.seen.passed.is_some() => other.seen.passed.is_some(),
            Verdict::Poor if first.seen.gap > first.seen.depth => near(first.seen.gap, other.seen.gap),
            Verdict::Poor => near(first.seen.depth, other.seen.depth),
            _ => true,
        }
}

impl Shrinker<'_> {
    /// Takes the change over if the scene still fails in the same way; whether it did.
    fn attempt(&mut self, change: impl FnOnce(&mut Scene)) -> bool {
        let mut candidate = self.best.clone();
        change(&mut candidate);
        if self.left == 0 || Instant::now() > self.until || candidate == self.best {
            return false;
        }
        self.left -= 1;
        let is_same = is_same(self.outcome, &run::run(&candidate, "accurate", self.path));
        if is_same {
            self.best = candidate;
        }
        is_same
    }

    /// Halves the simulated time as long as that is possible, but for one sub-step.
    fn shorten(&mut self) {
        while self.best.span > self.best.step && self.attempt(|scene| scene.span = (scene.span / 2.0).max(scene.step)) {
        }
    }

    /// Tries every simplification once; whether any was possible.
    fn round(&mut self) -> bool {
        let parts = self.remove_parts();
        let bodies = self.simplify_bodies();
        let joints = self.simplify_joints();
        parts || bodies || joints
    }

    fn remove_parts(&mut self) -> bool {
        let mut any = self.remove_many(|scene| scene.commands.len(), |scene, i| _ = scene.commands.remove(i));
        any |= self.remove_many(|scene| scene.bodies.len(), Scene::remove_body);
        any |= self.remove_many(|scene| scene.joints.len(), Scene::remove_joint);
        any |= self.remove_many(|scene| scene.sensors.len(), |scene, i| _ = scene.sensors.remove(i));
        any |= self.remove_many(|scene| scene.ghosts.len(), |scene, i| _ = scene.ghosts.remove(i));
        any | self.remove_many(|scene| scene.actuators.len(), Scene::remove_actuator)
    }

    /// Takes out halves, quarters … and single elements of a list, from its end.
    fn remove_many(&mut self, length: impl Fn(&Scene) -> usize, remove: impl Fn(&mut Scene, usize)) -> bool {
        let (mut any, mut chunk) = (false, length(&self.best).max(1));
        loop {
            let mut end = length(&self.best);
            while end > 0 {
                let start = end.saturating_sub(chunk);
                any |= self.attempt(|scene| (start..end).rev().for_each(|i| remove(scene, i)));
                end = start.min(length(&self.best));
            }
            if chunk == 1 {
                return any;
            }
            chunk = chunk.div_ceil(2);
        }
    }

    fn simplify_bodies(&mut self) -> bool {
        let mut any = self.attempt(|scene| scene.step = 0.001);
        any |= self.attempt(|scene| scene.gravity = Vector3::zeros());
        any |= self.attempt(|scene| scene.ignore_collision = false);
        for i in 0..self.best.bodies.len() {
            any |= self.attempt(|scene| {
                let body = &mut scene.bodies[i];
                (body.friction, body.restitution, body.margin, body.controller) = (None, None, None, None);
            });
            any |= self.attempt(|scene| scene.bodies[i].controller = None);
            any |= self.attempt(|scene| scene.bodies[i].damping = None);
            any |= self.attempt(|scene| scene.bodies[i].drop_shape());
            any |= self.attempt(|scene| scene.bodies[i].set_mass(1.0));
            let rounded = round(self.best.bodies[i].mass, 2);
            any |= self.attempt(|scene| scene.bodies[i].set_mass(rounded));
            any |= self.attempt(|scene| {
                let body = &mut scene.bodies[i];
                body.inertia = body.inertia.map(|inertia| inertia.map(|moment| round(moment, 2)));
            });
        }
        any
    }

    fn simplify_joints(&mut self) -> bool {
        let mut any = false;
        for i in 0..self.best.joints.len() {
            any |= self.attempt(|scene| scene.joints[i].coupling = None);
            any |= self.attempt(|scene| scene.joints[i].controller = None);
            any |= self.attempt(|scene| scene.joints[i].limits = None);
            any |= self.attempt(|scene| {
                let joint = &mut scene.joints[i];
                (joint.softness, joint.feedback, joint.passive, joint.output) = (None, false, false, None);
            });
            any |= self.attempt(|scene| scene.joints[i].max_impulse = None);
            any |= self.attempt(|scene| scene.joints[i].ignore_collision = None);
            any |= self.attempt(|scene| {
                let joint = &mut scene.joints[i];
                joint.controller = joint.controller.map(|gains| gains.map(|gain| round(gain, 2)));
                joint.limits = joint.limits.map(|(low, high)| (round(low, 2), round(high, 2)));
            });
            // Frames lose only digits far below their errors, so that they fit as well as before.
            any |= self.attempt(|scene| {
                let joint = &mut scene.joints[i];
                joint.pivots = joint.pivots.map(|pivot| pivot.map(|x| round(x, 6)));
                joint.axes = joint.axes.map(|axis| axis.map(|x| round(x, 6)));
                joint.offset = round(joint.offset, 6);
            });
        }
        any
    }
}

/// With so many significant digits; what is only left of rounding beside 1 becomes 0.
fn round(value: f64, digits: usize) -> f64 {
    match value.abs() < 1e-14 {
        true => 0.0,
        false => format!("{value:.*e}", digits - 1).parse().unwrap_or(value),
    }
}
