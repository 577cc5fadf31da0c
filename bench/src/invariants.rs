//! Invariants of a run: finite, no energy from nowhere, joints stay closed, penetration does not grow.
//!
//! The state is read from outside, once a sub-step, so the work of controllers is bounded instead of known: see
//! [`Work`].

use std::collections::BTreeMap;
use std::f64::consts::PI;

use ambf_core::adf;
use ambf_core::bullet::{BodyHandle, Contact, Ray, RayHit, RayTarget};
use ambf_core::ids::BodyId;
use ambf_core::scene::{Body, Joint, JointType, Scene};
use ambf_core::sim::Simulation;
use nalgebra::{Point3, Vector3};

use super::script::{Action, Script};
use super::work::{spring_energy, springs, Spring, Work};

/// Joint gaps and penetration count from this time after the start, a reset, and the end of prescribed motion on, s:
/// bodies may then be where joints and grips do not close, which is corrected at a bounded speed.
const SETTLED: f64 = 0.2;
/// Speed at which joints that prescribed motion has opened close, m/s.
const CLOSING: f64 = 5.0;
/// Speed that a correction of initial penetration or of joint frames may leave behind, m/s.
const PUSH: f64 = 1.0;
/// Share of the misfit of a joint that a sub-step may turn into velocity.
const ERP: f64 = 0.2;
/// Relative slack of the energy balance.
const SLACK: f64 = 0.1;
/// Share of the elastic energy at the start that corrections of strained joints may change.
const ELASTIC_SLACK: f64 = 0.01;
/// Least distance about which a correction turns a body, as a share of the scene's lever arms.
const LEAST_ARM: f64 = 0.1;
/// A body that is faster than this (m/s) was shot, whatever its energy: all bounds on motors are below it.
const FASTEST: f64 = 1e5;
/// Contacts are looked at every this many sub-steps.
const CONTACT_INTERVAL: u64 = 5;

/// Where the pivot of a joint is on either body, in the inertial frames.
struct Pivot {
    parent: BodyId,
    child: BodyId,
    points: [Point3<f64>; 2],
    /// Axis along which the pivots may part, in the parent's inertial frame.
    free: Option<Vector3<f64>>,
    /// Axis in either inertial frame, of joints that keep these parallel.
    axes: Option<[Vector3<f64>; 2]>,
    /// Distance at the start, m.
    initial: f64,
    /// Lever arm: distance of the pivots from the centres of mass, or the radius of gyration if that is more, m.
    lever: f64,
    /// Largest distance since [`SETTLED`], as a multiple of what is allowed.
    worst: f64,
}

/// A body that no joint holds.
struct Loose {
    body: BodyId,
    /// Where its centre of mass was when it was last looked at, m.
    centre: Vector3<f64>,
    /// Outward normal of the static surface that it went through and has not come back through, and when it did, s.
    entered: Option<(Vector3<f64>, f64)>,
}

/// What was seen, each as a multiple of what is allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    pub energy: f64,
    pub gap: f64,
    pub depth: f64,
    /// Largest speed of a centre of mass, m/s.
    pub speed: f64,
    /// A body without joints whose centre of mass went into or through a static one and has not come back, and when it did, s.
    pub passed: Option<(BodyId, f64)>,
    /// When there was too much energy for the first time, s; NaN: never.
    pub since: f64,
}

/// Watches a simulation from its first to its last sub-step.
pub struct Watch {
    pivots: Vec<Pivot>,
    work: Work,
    /// Energy at the start or at the latest reset or prescribed motion, and what may be added to it at once, J.
    base: f64,
    allowance: f64,
    initial_potential: f64,
    /// Springs as they were then.
    springs: Vec<Spring>,
    /// Of all bodies that move, N: what lifts them out of initial penetration.
    weight: f64,
    /// What the correction of initial penetration may add, J, for each pair of bodies: each pair is pushed apart by itself.
    pushed: BTreeMap<[BodyHandle; 2], f64>,
    /// Largest gap of any joint at the start, and length of the scene's lever arms, m.
    misfit: f64,
    size: f64,
    /// First sub-step in which gaps and penetration count.
    settled_from: u64,
    /// Largest penetration before they count, m.
    first_depth: f64,
    worst_depth: f64,
    /// Bodies that no joint holds.
    loose: Vec<Loose>,
    energy_ratio: f64,
    speed: f64,
    since: f64,
    moved: bool,
    step: f64,
    contacts: Vec<Contact>,
}

impl Watch {
    /// Before the first sub-step.
    pub fn new(simulation: &Simulation, script: &Script) -> Self {
        let scene = simulation.scene();
        let mut pivots: Vec<Pivot> = scene.joints.iter().filter_map(|joint| pivot(scene, joint)).collect();
        for pivot in &mut pivots {
            pivot.initial = gap(scene, pivot);
        }
        let misfit = pivots.iter().map(|pivot| pivot.initial).fold(0.0, f64::max);
        let mut levers: Vec<f64> = pivots.iter().map(|pivot| pivot.lever).collect();
        levers.sort_by(f64::total_cmp);
        let size = levers.get(levers.len() / 2).copied().unwrap_or(0.1).max(1e-4);
        let mut watch = Self {
            pivots,
            work: Work::new(scene, script.step),
            base: 0.0,
            allowance: 0.0,
            initial_potential: 0.0,
            springs: Vec::new(),
            weight: 0.0,
            pushed: BTreeMap::new(),
            misfit,
            size,
            settled_from: settling(script),
            first_depth: 0.0,
            worst_depth: 0.0,
            loose: loose(scene),
            energy_ratio: 0.0,
            speed: 0.0,
            since: f64::NAN,
            moved: false,
            step: script.step,
            contacts: Vec::new(),
        };
        watch.rebase(simulation);
        watch
    }

    /// Starts the balance of energy anew from the present state.
    fn rebase(&mut self, simulation: &Simulation) {
        let scene = simulation.scene();
        let (kinetic, potential) = energy(scene);
        self.base = kinetic + potential;
        self.initial_potential = potential;
        self.work.reset();
        // Limits that the start violates are corrected like gaps, at the end of a lever.
        let beyond = scene.joints.iter().map(violation).fold(0.0, f64::max);
        let present = self.pivots.iter().map(|pivot| gap(scene, pivot)).fold(0.0, f64::max);
        let skew = self.pivots.iter().map(|pivot| skew(scene, pivot)).fold(0.0, f64::max);
        let beyond = beyond + skew;
        let angle = ERP * beyond / self.step;
        let speed = PUSH + ERP * present / self.step + angle * self.size;
        let of = |(mass, inertia): (f64, f64)| mass * speed * speed / 2.0 + inertia * (angle * angle + PUSH) / 2.0;
        let bodies = scene.bodies.iter().filter(|body| body.mass > 0.0);
        let pull = |body: &Body| body.mass * body.gravity.unwrap_or(scene.gravity).norm();
        self.weight = scene.bodies.iter().map(pull).sum();
        // A limit that is corrected turns all that hangs on the joint about it, not only the body next to it.
        let turned = turns_of_corrections(scene, &self.pivots);
        let lifted = |body: BodyId| {
            let centre = scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default().translation.vector;
            let turned = turned.iter().map(|(at, angle)| angle * (centre - at).norm()).sum::<f64>();
            present + slid_of_corrections(scene) + turned
        };
        // What cannot be closed settles elsewhere than it was assembled, and takes springs with it.
        let arm = self.size.min(shortest_arm(scene, &self.pivots).max(LEAST_ARM * self.size));
        let (way, angle) = (present + slid_of_corrections(scene) + beyond * self.size, beyond + present / arm);
        self.springs = springs(scene);
        let strained = |spring: &Spring| spring.strained_by(way, angle);
        self.allowance = bodies.map(|body| of((body.mass, body.inertia.amax()))).sum::<f64>()
            + scene.bodies.entries().map(|(id, body)| body.mass * scene.gravity.norm() * lifted(id)).sum::<f64>()
            + self.work.elastic_reserve(scene)
            + ELASTIC_SLACK * scene.joints.iter().map(|joint| spring_energy(scene, joint)).sum::<f64>()
            + self.springs.iter().map(strained).sum::<f64>();
    }

    /// Before sub-step `n`, when its commands have been given.
    pub fn before(&mut self, simulation: &Simulation, script: &Script, n: u64) {
        let is_prescribed = |action: &Action| matches!(action, Action::Twist(..) | Action::Pose(..) | Action::Hold(..));
        // Poses and velocities are followed until all commands have ended.
        self.moved = n < script.end()
            && script.events.iter().any(|event| event.first <= n && is_prescribed(&event.action))
            || script.due(n).any(|event| matches!(event.action, Action::Reset(_)));
        let has_rest = n == script.end();
        if has_rest || script.due(n).any(|event| matches!(event.action, Action::Reset(_))) {
            // Once all commands have ended, nothing of what they might have done is left for later.
            self.rebase(simulation);
            let scene = simulation.scene();
            let open = self.pivots.iter().map(|pivot| gap(scene, pivot)).fold(0.0, f64::max);
            self.settled_from = n + settling(script) + (open / CLOSING / self.step).round() as u64;
        }
        self.work.before(simulation, script, n);
    }

    /// After sub-step `n`.
    pub fn after(&mut self, simulation: &Simulation, n: u64) {
        let scene = simulation.scene();
        self.work.after(simulation);
        let settled = n >= self.settled_from;
        if settled && !self.moved {
            let (misfit, size, step) = (self.misfit, self.size, self.step);
            for pivot in &mut self.pivots {
                let lever = pivot.lever.max(0.2 * size);
                let allowed = 1.5 * misfit + lever * (0.02 + turn(scene, pivot, step).powi(2) / 2.0);
                pivot.worst = pivot.worst.max(gap(scene, pivot) / allowed);
            }
        }
        if n.is_multiple_of(CONTACT_INTERVAL) {
            self.look_for_passage(simulation);
            for (index, &body) in scene.world.bodies().iter().enumerate() {
                scene.world.contacts(body, 0.0, &mut self.contacts);
                let contacts = std::mem::take(&mut self.contacts);
                for contact in contacts.iter().filter(|contact| contact.distance < 0.0) {
                    if settled {
                        self.worst_depth = self.worst_depth.max(-contact.distance);
                    } else {
                        self.first_depth = self.first_depth.max(-contact.distance);
                        let added = self.pushed_out(scene, BodyId::new(index), contact);
                        let pair = [body.min(contact.other), body.max(contact.other)];
                        let pushed = self.pushed.entry(pair).or_default();
                        *pushed = pushed.max(added);
                    }
                }
                self.contacts = contacts;
            }
        }
        self.judge_energy(simulation);
    }

    /// Follows the centres of mass of loose bodies through the surfaces of static ones.
    fn look_for_passage(&mut self, simulation: &Simulation) {
        let scene = simulation.scene();
        // Planes fill a half space, which is left on the side where it was entered.
        let has_two_sides = |body: &Body| {
            use adf::{CollisionGeometry, Primitive};
            let collision = collision(scene, body);
            !matches!(collision, Some(CollisionGeometry::Primitive { primitive: Primitive::Plane { .. }, .. }))
        };
        let of_static = |hit: &RayHit| {
            let RayTarget::Body(handle) = hit.target else { return false };
            let mut hit = scene.bodies.iter().zip(scene.world.bodies()).filter(|(_, &other)| other == handle);
            hit.any(|(body, _)| body.mass == 0.0 && has_two_sides(body))
        };
        for loose in &mut self.loose {
            let pose = scene.world.pose(scene.world.bodies()[loose.body.index()]).unwrap_or_default();
            let (from, to) = (std::mem::replace(&mut loose.centre, pose.translation.vector), pose.translation.vector);
            let mut hits = [None; 2];
            scene.world.cast_rays(&[Ray { from, to }, Ray { from: to, to: from }], &mut hits);
            let [there, back] = hits.map(|hit| hit.filter(of_static).map(|hit| hit.normal));
            // A ray meets a convex body only from outside, a mesh from both sides.
            loose.entered = match (loose.entered, there, back) {
                // Prescribed motion goes through walls.
                _ if self.moved => None,
                (None, Some(normal), _) => Some((normal, simulation.sim_time())),
                (Some((normal, _)), Some(other), Some(_)) if normal.dot(&other) < 0.0 => None,
                (Some((normal, _)), None, Some(other)) if normal.dot(&other) > 0.0 => None,
                (entered, ..) => entered,
            };
        }
    }

    /// Energy that may be added where a body is pushed out of penetration, J: all bodies are lifted, or turn about one of
    /// its joints, and springs are strained.
    fn pushed_out(&self, scene: &Scene, body: BodyId, contact: &Contact) -> f64 {
        let depth = -contact.distance;
        let pose = scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default();
        let points =
            self.pivots.iter().flat_map(|pivot| [(pivot.parent, 0), (pivot.child, 1)].map(|side| (side, pivot)));
        let points = points.filter(|&((side, _), _)| side == body).map(|((_, side), pivot)| pivot.points[side]);
        let turned = points.clone().map(|point| {
            let (at, arm) = ((pose * point).coords, point.coords.norm().max(0.1 * self.size));
            let lifted = |(id, other): (BodyId, &Body)| {
                let centre = scene.world.pose(scene.world.bodies()[id.index()]).unwrap_or_default().translation.vector;
                other.mass
                    * other.gravity.unwrap_or(scene.gravity).norm()
                    * (depth / arm).min(PI)
                    * (centre - at).norm()
            };
            scene.bodies.entries().map(lifted).sum::<f64>()
        });
        // The body may also turn about any of its joints, and strain springs by that angle.
        let arms = points.map(|point| (contact.point - (pose * point).coords).cross(&contact.normal).norm());
        let turn = depth / arms.fold(f64::INFINITY, f64::min).max(0.1 * self.size);
        let strained = |spring: &Spring| {
            let pushed = spring.pushed_by(&contact.point, &contact.normal, depth, 0.1 * self.size);
            pushed.max(spring.strained_by(0.0, turn.min(PI)))
        };
        self.weight * depth + turned.fold(0.0, f64::max) + self.springs.iter().map(strained).sum::<f64>()
    }

    /// The one place where energy is judged; a ledger of the simulator itself would replace [`Work`] here.
    fn judge_energy(&mut self, simulation: &Simulation) {
        let scene = simulation.scene();
        let fastest = scene.world.bodies().iter().filter_map(|&body| scene.world.velocity(body));
        self.speed = fastest.map(|(velocity, _)| velocity.norm()).fold(self.speed, f64::max);
        if self.moved {
            // Velocities were prescribed: whatever energy there is now is given.
            let (kinetic, potential) = energy(scene);
            let allowance = self.allowance;
            if kinetic + potential > self.base + self.work.done() {
                self.rebase(simulation);
                self.allowance = self.allowance.max(allowance);
            }
        } else {
            let (kinetic, potential) = energy(scene);
            let allowed = self.work.done()
                + self.allowance
                + self.pushed.values().sum::<f64>()
                + SLACK
                    * (kinetic.abs().min(self.base.abs() + self.work.done())
                        + (potential - self.initial_potential).abs());
            let gain = kinetic + potential - self.base;
            let ratio = gain / allowed.max(f64::MIN_POSITIVE);
            self.energy_ratio = self.energy_ratio.max(if ratio.is_nan() { f64::INFINITY } else { ratio });
        }
        if self.speed > FASTEST {
            self.energy_ratio = f64::INFINITY;
        }
        if self.energy_ratio > 1.0 && self.since.is_nan() {
            self.since = simulation.sim_time();
        }
    }

    /// What was seen so far.
    pub fn seen(&self) -> Seen {
        let depth = 1.5 * self.first_depth + 0.1 * self.size + 2.0 * self.step * self.speed.min(FASTEST);
        Seen {
            energy: self.energy_ratio,
            gap: self.pivots.iter().map(|pivot| pivot.worst).fold(0.0, f64::max),
            depth: self.worst_depth / depth,
            speed: self.speed,
            passed: self.loose.iter().find_map(|loose| loose.entered.map(|(_, time)| (loose.body, time))),
            since: self.since,
        }
    }
}

/// What of a body collides, unless its model's bodies do not collide with each other.
fn collision<'s>(scene: &'s Scene, body: &Body) -> Option<&'s adf::CollisionGeometry> {
    let models = scene.models.iter().map(|model| &model.description).filter(|model| !model.ignore_inter_collision);
    let described = models.flat_map(|model| &model.bodies).find(|described| described.common.source == body.source)?;
    Some(&described.collision).filter(|collision| **collision != adf::CollisionGeometry::None)
}

/// Bodies that move, that no joint holds, and that collide with others of their model.
fn loose(scene: &Scene) -> Vec<Loose> {
    let joined = |id: BodyId| scene.joints.iter().any(|joint| joint.parent == id || joint.child == id);
    let colliding = |body: &Body| collision(scene, body).is_some();
    let loose = scene.bodies.entries().filter(|&(id, body)| body.mass > 0.0 && !joined(id) && colliding(body));
    let centre = |id: BodyId| scene.world.pose(scene.world.bodies()[id.index()]).unwrap_or_default().translation.vector;
    loose.map(|(body, _)| Loose { body, centre: centre(body), entered: None }).collect()
}

/// Sub-steps of [`SETTLED`].
fn settling(script: &Script) -> u64 {
    (SETTLED / script.step).round() as u64
}

/// Whether a joint's coordinate is a length.
fn slides(joint: &Joint) -> bool {
    matches!(joint.joint_type, JointType::Prismatic | JointType::LinearSpring)
}

/// Where and by which angle the corrections of limits and of the axes of joints turn bodies: m, world axes, and rad.
fn turns_of_corrections(scene: &Scene, pivots: &[Pivot]) -> Vec<(Vector3<f64>, f64)> {
    let at = |body: BodyId, point: Point3<f64>| {
        let pose = scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default();
        (pose * point).coords
    };
    let limits = scene.joints.iter().filter(|joint| !slides(joint)).map(|joint| {
        let origin = Point3::from(joint.frames[0].translation.vector);
        (at(joint.parent, origin), violation(joint))
    });
    let axes = pivots.iter().map(|pivot| (at(pivot.parent, pivot.points[0]), skew(scene, pivot)));
    limits.chain(axes).filter(|(_, angle)| *angle > 0.0).collect()
}

/// Shortest distance between two pivots on a body that moves, m: where one joint holds the body, the correction of the other turns it
/// about the first. Infinite: no body has two joints.
fn shortest_arm(scene: &Scene, pivots: &[Pivot]) -> f64 {
    let sides = || {
        let all = pivots.iter().flat_map(|pivot| [(pivot.parent, pivot.points[0]), (pivot.child, pivot.points[1])]);
        all.filter(|&(body, _)| scene.bodies[body].mass > 0.0)
    };
    let from = |n: usize, (body, point): (BodyId, Point3<f64>)| {
        let others = sides().skip(n + 1).filter(move |&(other, _)| other == body);
        others.map(|(_, other)| (other - point).norm()).fold(f64::INFINITY, f64::min)
    };
    sides().enumerate().map(|(n, side)| from(n, side)).fold(f64::INFINITY, f64::min)
}

/// By how much the corrections of the limits of sliding joints move bodies, m.
fn slid_of_corrections(scene: &Scene) -> f64 {
    let sliding = scene.joints.iter().filter(|joint| slides(joint)).map(violation).sum::<f64>();
    sliding + scene.joints.iter().map(|joint| outside_box(scene, joint)).sum::<f64>()
}

/// How far a six-dof joint is outside of its linear limits, m; 0 for other joints.
fn outside_box(scene: &Scene, joint: &Joint) -> f64 {
    let limits = match description(scene, joint).map(|described| &described.kind) {
        Some(adf::JointKind::SixDof(limits)) => limits,
        Some(adf::JointKind::SixDofSpring(spring)) => &spring.limits,
        _ => return 0.0,
    };
    let pose = |body: BodyId| scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default();
    let frames = [pose(joint.parent) * joint.frames[0], pose(joint.child) * joint.frames[1]];
    let at = frames[0].inv_mul(&frames[1]).translation.vector;
    let beyond = |i: usize| (limits.linear_low[i] - at[i]).max(at[i] - limits.linear_high[i]).max(0.0);
    (0..3).filter(|&i| limits.linear_low[i] <= limits.linear_high[i]).map(beyond).sum()
}

/// How far the start is beyond a limit, rad or m.
fn violation(joint: &Joint) -> f64 {
    let beyond = |limits: adf::Limits| (limits.low - joint.position).max(joint.position - limits.high).max(0.0);
    joint.limits.filter(|limits| limits.low <= limits.high).map_or(0.0, beyond)
}

/// Kinetic energy and potential energy, of gravity and of springs with one coordinate, J.
fn energy(scene: &Scene) -> (f64, f64) {
    let (mut kinetic, mut potential) = (0.0, 0.0);
    for (body, &handle) in scene.bodies.iter().zip(scene.world.bodies()).filter(|(body, _)| body.mass > 0.0) {
        let Some((pose, (velocity, spin))) = scene.world.pose(handle).zip(scene.world.velocity(handle)) else {
            continue;
        };
        let spin = pose.rotation.inverse() * spin;
        kinetic += body.mass * velocity.norm_squared() / 2.0 + spin.component_mul(&spin).dot(&body.inertia) / 2.0;
        potential -= body.mass * body.gravity.unwrap_or(scene.gravity).dot(&pose.translation.vector);
    }
    for joint in &scene.joints {
        potential += spring_energy(scene, joint);
    }
    (kinetic, potential)
}

/// The joint as its file describes it.
pub fn description<'s>(scene: &'s Scene, joint: &Joint) -> Option<&'s adf::Joint> {
    let model = scene.models.get(joint.model)?;
    model.description.joints.iter().find(|described| described.common.source == joint.source)
}

fn pivot(scene: &Scene, joint: &Joint) -> Option<Pivot> {
    let described = description(scene, joint)?;
    let free = match joint.joint_type {
        JointType::SixDof | JointType::SixDofSpring | JointType::Unknown => return None,
        JointType::Prismatic | JointType::LinearSpring => Some(joint.axis),
        _ => None,
    };
    let on = |body: BodyId, pivot: &Vector3<f64>| {
        let body = &scene.bodies[body];
        body.inertial_offset_inverse * Point3::from(pivot * body.scale)
    };
    let points = [on(joint.parent, &described.parent_pivot), on(joint.child, &described.child_pivot)];
    let moves = |body: BodyId| scene.bodies[body].mass > 0.0;
    // A pivot may be at the centre of mass; a body is not smaller than its radius of gyration.
    let arm = |id: BodyId, point: &Point3<f64>| {
        let body = &scene.bodies[id];
        if moves(id) {
            point.coords.norm().max((body.inertia.amax() / body.mass).sqrt())
        } else {
            0.0
        }
    };
    let lever = arm(joint.parent, &points[0]).max(arm(joint.child, &points[1]));
    let is_ball = matches!(joint.joint_type, JointType::PointToPoint | JointType::ConeTwist);
    let axes = (!is_ball).then(|| {
        let child = scene.bodies[joint.child].inertial_offset_inverse * described.child_axis;
        [joint.axis, child.normalize()]
    });
    Some(Pivot { parent: joint.parent, child: joint.child, points, free, axes, initial: 0.0, lever, worst: 0.0 })
}

/// Angle between the axes, rad; 0 where the joint leaves it free.
fn skew(scene: &Scene, pivot: &Pivot) -> f64 {
    let Some([parent, child]) = pivot.axes else { return 0.0 };
    let turn = |body: BodyId| scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default().rotation;
    (turn(pivot.parent) * parent).angle(&(turn(pivot.child) * child))
}

/// Angle by which the bodies turn in a sub-step, rad. Bodies that move along tangents leave a joint by its square,
/// halved, times the lever arm, before that is corrected.
fn turn(scene: &Scene, pivot: &Pivot, step: f64) -> f64 {
    let speed =
        |body: BodyId| scene.world.velocity(scene.world.bodies()[body.index()]).map_or(0.0, |(_, spin)| spin.norm());
    speed(pivot.parent).max(speed(pivot.child)) * step
}

/// Distance of the pivots across the free axis, m, for the lever arm of a joint that has not slid.
fn gap(scene: &Scene, pivot: &Pivot) -> f64 {
    let pose = |body: BodyId| scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default();
    let (parent, child) = (pose(pivot.parent), pose(pivot.child));
    let mut apart = child * pivot.points[1] - parent * pivot.points[0];
    let mut slide = 0.0;
    if let Some(axis) = pivot.free {
        let axis = parent * axis;
        slide = axis.dot(&apart);
        apart -= axis * slide;
    }
    // Where the pivots have slid apart, the lever arm is that much longer.
    let lever = pivot.lever.max(f64::MIN_POSITIVE);
    apart.norm() * lever / (lever + slide.abs())
}
