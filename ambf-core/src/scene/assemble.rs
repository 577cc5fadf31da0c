//! Bodies are put onto their joints before the first step.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::f64::consts::PI;

use ambf_dynamics::assembly::{self, Gap, Kind, Omission, Range};
use nalgebra::{Isometry3, Vector3};

use super::{Body, Note, Scene};
use crate::adf::Severity;
use crate::bullet::{Constraint, ConstraintKind};
use crate::control::Profile;
use crate::ids::{BodyId, JointId, ModelId};

/// Displacements and gaps up to these are not worth a line: m and rad.
const NEGLIGIBLE: (f64, f64) = (1e-6, 1e-5);

/// Gaps from these on are said: m and rad (0.1°).
const OPEN: (f64, f64) = (1e-4, 1.75e-3);

/// Displacements beyond these mean that the file is wrong rather than rounded: m and rad.
const FAR: (f64, f64) = (0.02, 0.1);

/// Bodies that the line of a model names, and joints that have a line of their own.
const MAX_NAMED: usize = 3;

/// What of a joint matters to assembly: what Bullet was given.
struct Constrained {
    /// The joint in the scene.
    joint: JointId,
    kind: Kind,
    frames: [Isometry3<f64>; 2],
    /// `assemble: false`.
    is_left_open: bool,
}

/// Joints that wait for assembly.
#[derive(Default)]
pub(super) struct Assembly(Vec<Constrained>);

/// How far a body was displaced.
struct Displacement {
    body: BodyId,
    moved: Gap,
}

impl Assembly {
    /// Takes a joint over. `joint`: its index in the scene.
    pub fn add(&mut self, joint: JointId, constraint: &Constraint, assemble: bool) {
        let frames = [constraint.frame_a, constraint.frame_b];
        self.0.push(Constrained { joint, kind: kind(&constraint.kind), frames, is_left_open: !assemble });
    }

    /// Moves the bodies of `models` onto the joints in profile `accurate`, with the least displacement in the metric of
    /// their masses; those poses become the initial ones. Bodies of other models and static ones stay. Returns what is
    /// worth saying, and the joints that are to stay open.
    pub fn put_together(&self, scene: &mut Scene, models: &BTreeSet<ModelId>) -> (Vec<Note>, BTreeSet<JointId>) {
        if scene.profile != Profile::Accurate || scene.preset.is_some() || self.0.is_empty() {
            return Default::default();
        }
        let written: Vec<assembly::Body> = scene.bodies.iter().map(|body| described(scene, body, models)).collect();
        let mut bodies = written.clone();
        let all: Vec<assembly::Joint> = self
            .0
            .iter()
            .map(|Constrained { joint, kind, frames, .. }| {
                let joint = &scene.joints[*joint];
                assembly::Joint {
                    kind: *kind,
                    bodies: [joint.parent.index(), joint.child.index()],
                    frames: *frames,
                    omission: Omission::NONE,
                }
            })
            .collect();
        let closed: Vec<usize> = (0..all.len()).filter(|&index| !self.0[index].is_left_open).collect();
        let mut to_close: Vec<assembly::Joint> = closed.iter().map(|&index| all[index].clone()).collect();
        let index_of: HashMap<JointId, usize> =
            closed.iter().enumerate().map(|(index, &of)| (self.0[of].joint, index)).collect();
        let couplings = couplings(scene, &index_of);
        assembly::assemble_coupled(&mut bodies, &to_close, &couplings);
        let redundant = assembly::omit_redundant_rows(&bodies, &mut to_close);
        if !redundant.is_empty() {
            // Not from the compromise of all rows.
            bodies = written;
            assembly::assemble_coupled(&mut bodies, &to_close, &couplings);
        }
        let joint_of = |index: usize| self.0[closed[index]].joint;
        let mut omitted = Vec::new();
        for loops in &redundant {
            for &(index, misfit) in &loops.omitted {
                let (joint, assembly::Joint { frames, omission, .. }) = (joint_of(index), &to_close[index]);
                if let Some(handle) = scene.joints[joint].handle {
                    scene.world.omit_rows(handle, frames, omission);
                }
                omitted.push((joint, *omission, misfit));
            }
            scene.redundant_loops.push(loops.joints.iter().map(|&index| joint_of(index)).collect());
        }

        let displaced = place(scene, &bodies);
        let mut notes = displacements(scene, &displaced);
        notes.extend(omissions(scene, omitted));
        let open = (0..closed.len()).map(|index| (joint_of(index), assembly::gap(&to_close[index], &bodies)));
        notes.extend(residuals(scene, open));
        let is_open = |index: &usize| self.0[*index].is_left_open && matters(&assembly::gap(&all[*index], &bodies));
        (notes, (0..all.len()).filter(is_open).map(|index| self.0[index].joint).collect())
    }
}

/// The couplings between joints that are assembled; `index_of`: which one a joint of the scene is.
fn couplings(scene: &Scene, index_of: &HashMap<JointId, usize>) -> Vec<assembly::Coupling> {
    let coupled = scene.joints.entries().filter_map(|(id, joint)| Some((id, joint.coupling.as_ref()?)));
    coupled
        .filter_map(|(id, coupling)| {
            let leaders = coupling.leaders.iter().map(|(leader, ratio)| Some((*index_of.get(leader)?, *ratio)));
            Some(assembly::Coupling {
                follower: *index_of.get(&id)?,
                leaders: leaders.collect::<Option<_>>()?,
                offset: coupling.offset,
            })
        })
        .collect()
}

fn matters(gap: &Gap) -> bool {
    gap.exceeds(NEGLIGIBLE.0, NEGLIGIBLE.1)
}

/// A body as it is now.
fn described(scene: &Scene, body: &Body, models: &BTreeSet<ModelId>) -> assembly::Body {
    let pose = scene.world.pose(body.handle).unwrap_or(body.initial_pose);
    let movable = models.contains(&body.identity.model) && body.is_dynamic();
    assembly::Body { pose, mass: body.mass, inertia: body.inertia, movable }
}

/// Sets the poses that changed, as poses to which resets return.
fn place(scene: &mut Scene, bodies: &[assembly::Body]) -> Vec<Displacement> {
    let mut displaced = Vec::new();
    for ((id, body), assembled) in scene.bodies.entries_mut().zip(bodies) {
        if !assembled.movable || assembled.pose == body.initial_pose {
            continue;
        }
        let distance = (assembled.pose.translation.vector - body.initial_pose.translation.vector).norm();
        let angle = assembled.pose.rotation.angle_to(&body.initial_pose.rotation);
        body.initial_pose = assembled.pose;
        scene.world.reset_body(body.handle, &assembled.pose, body.gravity.as_ref());
        displaced.push(Displacement { body: id, moved: Gap { distance, angle } });
    }
    displaced.retain(|displacement| matters(&displacement.moved));
    displaced
}

/// One line a model: how many bodies were displaced, and which most.
fn displacements(scene: &Scene, displaced: &[Displacement]) -> Vec<Note> {
    let mut models: BTreeMap<ModelId, Vec<&Displacement>> = BTreeMap::new();
    for displacement in displaced {
        models.entry(scene.bodies[displacement.body].identity.model).or_default().push(displacement);
    }
    let line = |mut list: Vec<&Displacement>| {
        // A radian counts as much as 0.25 m.
        let size = |d: &Displacement| d.moved.distance.max(d.moved.angle * 0.25);
        list.sort_by(|a, b| size(b).total_cmp(&size(a)));
        let name =
            |d: &&Displacement| format!("`{}` by {}", scene.bodies[d.body].identity.identifier, readable(&d.moved));
        let named: Vec<_> = list.iter().take(MAX_NAMED).map(name).collect();
        let rest =
            if list.len() > MAX_NAMED { format!(", … ({} more)", list.len() - MAX_NAMED) } else { String::new() };
        let bodies = if list.len() == 1 { "1 body is".to_owned() } else { format!("{} bodies are", list.len()) };
        let message = format!("{bodies} displaced so that the joints close: {}{rest}", named.join(", "));
        let is_far = list.iter().any(|displacement| displacement.moved.exceeds(FAR.0, FAR.1));
        let severity = if is_far { Severity::Warning } else { Severity::Info };
        Note { severity, source: scene.bodies[list[0].body].source.clone(), message, wanted: None }
    };
    models.into_values().map(line).collect()
}

/// A line for each model of which rows of joints are left out.
fn omissions(scene: &Scene, joints: Vec<(JointId, Omission, Gap)>) -> Vec<Note> {
    let mut models: BTreeMap<ModelId, Vec<(JointId, Omission, Gap)>> = BTreeMap::new();
    for joint in joints {
        models.entry(scene.joints[joint.0].model).or_default().push(joint);
    }
    let line = |list: Vec<(JointId, Omission, Gap)>| {
        let named = |(joint, omission, misfit): &(JointId, Omission, Gap)| {
            format!("{} of `{}`, up to {}", omission.count(), scene.joints[*joint].name, readable(misfit))
        };
        let rest = list.len().saturating_sub(MAX_NAMED);
        let rest = if rest > 0 { format!("; … ({rest} more joints)") } else { String::new() };
        let named: Vec<_> = list.iter().take(MAX_NAMED).map(named).collect();
        let message = format!(
            "the loops have more constraints than they need, and do not fit so exactly that they could move; those that repeat others are left out: {}{rest}",
            named.join("; ")
        );
        Note { severity: Severity::Info, source: scene.joints[list[0].0].source.clone(), message, wanted: None }
    };
    models.into_values().map(line).collect()
}

/// A line for each joint that stays open, the widest first; of many only the first, and how many more.
fn residuals(scene: &Scene, gaps: impl Iterator<Item = (JointId, Gap)>) -> Vec<Note> {
    let mut models: BTreeMap<ModelId, Vec<(JointId, Gap)>> = BTreeMap::new();
    // What has no inertia does not turn onto its joints, and has a line of its own.
    let turns = |body: BodyId| !scene.bodies[body].is_dynamic() || scene.bodies[body].inertia != Vector3::zeros();
    let is_said = |&(joint, gap): &(JointId, Gap)| {
        let joint = &scene.joints[joint];
        gap.exceeds(OPEN.0, OPEN.1) && turns(joint.parent) && turns(joint.child)
    };
    for (joint, gap) in gaps.filter(is_said) {
        models.entry(scene.joints[joint].model).or_default().push((joint, gap));
    }
    let mut notes = Vec::new();
    for mut list in models.into_values() {
        list.sort_by(|(_, a), (_, b)| b.distance.max(b.angle).total_cmp(&a.distance.max(a.angle)));
        let rest = list.len().saturating_sub(MAX_NAMED);
        for (place, (joint, gap)) in list.iter().take(MAX_NAMED).enumerate() {
            let joint = &scene.joints[*joint];
            let more = match rest {
                0 => String::new(),
                _ if place + 1 < MAX_NAMED => String::new(),
                1 => "; 1 more joint stays open by less".to_owned(),
                n => format!("; {n} more joints stay open by less"),
            };
            let message = format!(
                "`{}` cannot be closed together with the other joints, limits and static bodies: {:.3e} m and {:.3e} rad remain{more}",
                joint.name, gap.distance, gap.angle
            );
            notes.push(Note { severity: Severity::Warning, source: joint.source.clone(), message, wanted: None });
        }
    }
    notes
}

/// Millimetres and degrees.
fn readable(gap: &Gap) -> String {
    format!("{:.3} mm and {:.3}°", gap.distance * 1e3, gap.angle * 180.0 / PI)
}

/// The joint that a constraint of Bullet is.
fn kind(kind: &ConstraintKind) -> Kind {
    let range = |limits: Option<[f64; 2]>| limits.map_or(Range::FREE, |[low, high]| Range::new(low, high));
    match kind {
        ConstraintKind::Hinge { limits } => Kind::Revolute(range(*limits)),
        ConstraintKind::Slider { limits } => Kind::Prismatic(range(*limits)),
        ConstraintKind::Fixed => Kind::Fixed,
        ConstraintKind::PointToPoint => Kind::PointToPoint,
        &ConstraintKind::ConeTwist { swing1, swing2, twist } => {
            Kind::ConeTwist { twist, swing_y: swing2, swing_z: swing1 }
        }
        ConstraintKind::SixDof(limits) | ConstraintKind::SixDofSpring { limits, .. } => Kind::SixDof {
            linear: std::array::from_fn(|i| Range::new(limits[i][0], limits[i][1])),
            // Bullet's angles have the opposite sign.
            angular: std::array::from_fn(|i| Range::new(-limits[i + 3][1], -limits[i + 3][0])),
        },
    }
}
