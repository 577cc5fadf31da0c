//! Articulations: kinematic trees of constraints in generalised coordinates.

use std::collections::{HashMap, HashSet};
use std::ptr::NonNull;

use ambf_dynamics::ffi as sys;

use super::{ArticulationHandle, BodyHandle, ConstraintHandle, ConstraintKind, World};

#[derive(Clone)]
pub(super) struct OwnedArticulation {
    raw: NonNull<sys::AmbArticulation>,
    joints: Vec<ConstraintHandle>,
    links: Vec<BodyHandle>,
}

/// A kinematic tree; `joints` are ordered so that each connects one new body to the base or to an earlier body.
struct SpanningTree {
    base: BodyHandle,
    joints: Vec<ConstraintHandle>,
    /// Springs parallel to a joint, between the same two bodies.
    springs: Vec<ConstraintHandle>,
    /// Dynamic bodies of the tree.
    links: Vec<BodyHandle>,
}

impl World {
    /// Makes constraints that form one kinematic tree an articulation: hinges, sliders, ball joints, fixed constraints
    /// and springs about or along one axis. Its generalised coordinates are those of the joints and, if no body is
    /// static, the pose of the base. Springs may also act in parallel to a hinge or slider on the same axis. Joints of an articulation
    /// have no position error, and motion between impacts is integrated by the classical Runge-Kutta method, fourth
    /// order in the sub-step. The base is the static body, or else a body that is body A of a constraint and body B of
    /// none. Poses and velocities of links are projected onto the joints.
    ///
    /// All functions of the bodies and constraints remain valid: wrenches, gravity, damping, poses and velocities,
    /// motors, limits, readings, feedback, contacts, rays, ghosts. Motion states don't lag.
    ///
    /// `None`, and nothing is changed, when the world was not made [for articulations](Self::with_articulations); when
    /// the constraints are of other types, do not form a single tree, or include more than one static body; when
    /// another constraint acts on one of their bodies, or a body has an infinite moment of inertia, is a link already,
    /// or is more than 2 cm or 0.05 rad off its joint; when a body that can collide has more than 100 coordinates
    /// between itself and the base, with which a contact would cost more than with constraints; when there are more than 1000
    /// coordinates in all, of which Bullet keeps a square matrix; or when there are vehicles, whose wheels do not detect
    /// links.
    pub fn articulate(&mut self, constraints: &[ConstraintHandle]) -> Option<ArticulationHandle> {
        let handle = self.make_articulation(constraints)?;
        self.trees.push(constraints.to_vec());
        Some(handle)
    }

    fn make_articulation(&mut self, constraints: &[ConstraintHandle]) -> Option<ArticulationHandle> {
        let _arena = self.enter();
        if !self.has_articulations || !self.vehicles.is_empty() {
            return None;
        }
        let SpanningTree { base, mut joints, springs, links } = self.spanning_tree(constraints)?;
        let pointers = |of: &[ConstraintHandle]| -> Vec<_> {
            of.iter().map(|&constraint| self.constraints[constraint].raw.as_ptr()).collect()
        };
        let (raw_joints, raw_springs) = (pointers(&joints), pointers(&springs));
        // SAFETY: world, base and constraints are alive, the constraints are in the world and ordered from the base,
        // and no other constraint acts on the links. The articulation is dissolved before any of them is removed.
        let raw = unsafe {
            sys::amb_world_articulate(
                self.raw.as_ptr(),
                self.raw_body(base)?,
                raw_joints.as_ptr(),
                raw_joints.len() as i32,
                raw_springs.as_ptr(),
                raw_springs.len() as i32,
            )
        };
        let raw = NonNull::new(raw)?;
        joints.extend(springs);
        let handle = self.articulations.insert(OwnedArticulation { raw, joints: joints.clone(), links: links.clone() });
        joints.into_iter().for_each(|joint| self.constraints[joint].articulation = Some(handle));
        links.into_iter().for_each(|link| self.bodies[link].articulation = Some(handle));
        Some(handle)
    }

    /// Makes the bodies and constraints of an articulation rigid bodies and constraints again, with their present poses
    /// and velocities. False when the handle is stale.
    pub fn dissolve(&mut self, handle: ArticulationHandle) -> bool {
        let Some(articulation) = self.articulations.get(handle) else { return false };
        let is_of_it = |joint: &ConstraintHandle| articulation.joints.contains(joint);
        self.trees.retain(|tree| !tree.iter().any(is_of_it));
        self.dissolve_until_restart(handle)
    }

    pub(super) fn dissolve_until_restart(&mut self, handle: ArticulationHandle) -> bool {
        let _arena = self.enter();
        let Some(articulation) = self.articulations.remove(handle) else { return false };
        // SAFETY: the world, the articulation, its bodies and constraints are alive; no pointer to the articulation is
        // left after this.
        unsafe { sys::amb_world_dissolve(self.raw.as_ptr(), articulation.raw.as_ptr()) }
        articulation.joints.into_iter().for_each(|joint| self.constraints[joint].articulation = None);
        articulation.links.into_iter().for_each(|link| self.bodies[link].articulation = None);
        true
    }

    /// Whether sub-steps compute the [reactions](Self::joint_wrench) of joints of articulations, and of constraints on their
    /// links; else those of earlier sub-steps stay. Nothing else depends on it. Default: `true`.
    pub fn set_reactions(&mut self, enabled: bool) {
        // SAFETY: the world is alive and was made with the engine.
        unsafe { sys::amb_world_set_reactions(self.raw.as_ptr(), enabled.into()) }
    }

    /// Makes the articulation of which a constraint is a joint once more, of what its bodies and constraints are now.
    pub(super) fn articulate_anew(&mut self, joint: ConstraintHandle) {
        let Some(handle) = self.constraints.get(joint).and_then(|joint| joint.articulation) else { return };
        let Some(tree) = self.trees.iter().find(|tree| tree.contains(&joint)).cloned() else { return };
        if self.dissolve_until_restart(handle) {
            let _ = self.make_articulation(&tree);
        }
    }

    /// The articulation of which a body is a link.
    pub fn articulation(&self, body: BodyHandle) -> Option<ArticulationHandle> {
        self.bodies.get(body)?.articulation
    }

    /// Whether constraints may be [articulated](Self::articulate).
    pub fn has_articulations(&self) -> bool {
        self.has_articulations
    }

    /// Dissolves the articulations of `a` and `b`, unless a new constraint of this kind between them can be an external
    /// constraint: it is fixed or point-to-point, and the bodies are not links of the same articulation.
    pub(super) fn dissolve_for(&mut self, a: BodyHandle, b: BodyHandle, kind: &ConstraintKind) {
        let of = [a, b].map(|body| self.articulation(body));
        let is_external = matches!(kind, ConstraintKind::Fixed | ConstraintKind::PointToPoint);
        if !is_external || of[0] == of[1] {
            of.into_iter().flatten().for_each(|handle| {
                self.dissolve_until_restart(handle);
            });
        }
    }

    /// Dissolves all articulations.
    pub(super) fn dissolve_all(&mut self) {
        for handle in self.articulations.keys().collect::<Vec<_>>() {
            self.dissolve_until_restart(handle);
        }
    }

    /// Begins a restart: no body is a link until [`finish_restart`](Self::finish_restart), so that each can be put where
    /// it is to be. Handles of articulations are stale.
    pub fn begin_restart(&mut self) {
        self.dissolve_all();
    }

    /// Ends a restart, after all bodies were [reset](Self::reset_body) and the constraints that came since the start were
    /// removed: articulations are made again as they were at the start, also those that other constraints had dissolved,
    /// and nothing is remembered, as after [`recover`](Self::recover).
    pub fn finish_restart(&mut self) {
        if self.has_articulations {
            let _arena = self.enter();
            let (list, n) = (self.constraint_list.as_ptr(), self.constraint_list.len() as i32);
            // SAFETY: the world is alive; the list holds constraints of this world and null only, none of which is a joint
            // of an articulation.
            unsafe { sys::amb_world_restore_order(self.raw.as_ptr(), list, n) }
        }
        for tree in std::mem::take(&mut self.trees) {
            // What is not possible any more, because the scene has changed, stays dissolved.
            let _ = self.make_articulation(&tree);
            self.trees.push(tree);
        }
        self.recover();
    }

    fn spanning_tree(&self, constraints: &[ConstraintHandle]) -> Option<SpanningTree> {
        let mut held: HashMap<BodyHandle, usize> = HashMap::new();
        for handle in constraints {
            let constraint = self.constraints.get(*handle)?;
            if !(constraint.is_simple || constraint.is_axis_spring) || constraint.articulation.is_some() {
                return None;
            }
            constraint.bodies.iter().for_each(|&body| *held.entry(body).or_default() += 1);
        }
        let is_static = |body: BodyHandle| !self.bodies[body].dynamic;
        if held.iter().any(|(&body, &n)| !is_static(body) && self.bodies[body].constraint_count != n) {
            return None;
        }
        // If several constraints connect the same bodies, the joint is the one that is not a spring.
        let mut joined = HashSet::new();
        let (mut joints, mut springs) = (Vec::new(), Vec::new());
        let is_simple = |handle: &ConstraintHandle| self.constraints[*handle].is_simple;
        let (simple, others): (Vec<_>, Vec<_>) = constraints.iter().copied().partition(is_simple);
        for handle in simple.into_iter().chain(others) {
            let mut bodies = self.constraints[handle].bodies;
            bodies.sort();
            if joined.insert(bodies) {
                joints.push(handle);
            } else if is_simple(&handle) {
                return None;
            } else {
                springs.push(handle);
            }
        }
        let mut joints_of: HashMap<BodyHandle, Vec<ConstraintHandle>> = HashMap::new();
        let mut children = HashSet::new();
        for &joint in &joints {
            let bodies = self.constraints[joint].bodies;
            bodies.iter().for_each(|&body| joints_of.entry(body).or_default().push(joint));
            children.insert(bodies[1]);
        }
        let ends = || constraints.iter().flat_map(|&handle| self.constraints[handle].bodies);
        let root = || ends().find(|body| !children.contains(body)).or_else(|| ends().next());
        let base = ends().find(|&body| is_static(body)).or_else(root)?;
        let (mut reached, mut seen) = (vec![base], HashSet::new());
        let mut order = Vec::with_capacity(joints.len());
        let mut next = 0;
        while let Some(&body) = reached.get(next) {
            next += 1;
            if next > 1 && is_static(body) {
                return None;
            }
            for &joint in joints_of[&body].iter().filter(|joint| seen.insert(**joint)) {
                let [a, b] = self.constraints[joint].bodies;
                order.push(joint);
                reached.push(if a == body { b } else { a });
            }
        }
        // In a tree every joint leads to a new body, and all bodies are reached.
        let is_tree = reached.len() == held.len() && order.len() == joints.len();
        let links = reached.into_iter().filter(|&body| !is_static(body)).collect();
        is_tree.then_some(SpanningTree { base, joints: order, springs, links })
    }
}

#[cfg(test)]
mod tests;
