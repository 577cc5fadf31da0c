//! Which joints of a scene are put into reduced coordinates.

use std::collections::{BTreeMap, BTreeSet};

use super::{Joint, Note, Scene};
use crate::adf::{self, JointKind, Severity};
use crate::bullet::ConstraintHandle;
use crate::ids::{BodyId, JointId, ModelId, Table};

/// Whether a model has joints that can be put into reduced coordinates.
pub(super) fn may_articulate(model: &adf::Model) -> bool {
    let may = |kind: &JointKind| !matches!(kind, JointKind::SixDofSpring(_) | JointKind::Unknown(_));
    model.joints.iter().any(|joint| may(&joint.kind))
}

/// Disjoint sets of bodies.
struct Sets(Table<BodyId, BodyId>);

impl Sets {
    fn root(&mut self, mut body: BodyId) -> BodyId {
        while self.0[body] != body {
            self.0[body] = self.0[self.0[body]];
            body = self.0[body];
        }
        body
    }

    fn join(&mut self, a: BodyId, b: BodyId) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[b] = a;
    }
}

impl Scene {
    /// Puts the joints of `models` into reduced coordinates, as far as they form trees: whole groups of bodies that
    /// joints hold together, no parts of them. What has loops, six-dof joints of which some axes are locked, or springs
    /// with several axes stays as it is, and so does what has a joint of `open`: reduced coordinates would close it. Groups whose
    /// joints are coupled are one. Says what was done.
    pub(super) fn articulate(&mut self, models: &BTreeSet<ModelId>, open: &BTreeSet<JointId>) -> Option<Note> {
        let has_massless = |id: ModelId| self.models[id].description.has_massless_links;
        let wants = |id: ModelId| self.models[id].description.wants_reduced_coordinates();
        if !self.world.has_articulations() {
            let source = self
                .joints
                .iter()
                .find(|joint| models.contains(&joint.model) && has_massless(joint.model))?
                .source
                .clone();
            let message = "the robot has links without a mass, and its joints stay constraints between bodies, which give way: \
                           reduced coordinates need a world without soft bodies that knows of the robot when it is made";
            return Some(Note { severity: Severity::Warning, source, message: message.into(), wanted: None });
        }
        let models: BTreeSet<_> = models.iter().copied().filter(|&id| self.articulates_all || wants(id)).collect();
        let mut sets = Sets(self.bodies.ids().collect());
        let is_dynamic = |body: &BodyId| self.bodies[*body].mass != 0.0;
        let own = || self.joints.entries().filter(|(_, joint)| models.contains(&joint.model));
        for (_, joint) in own() {
            if is_dynamic(&joint.parent) && is_dynamic(&joint.child) && joint.handle.is_some() {
                sets.join(joint.parent, joint.child);
            }
        }
        for (_, joint) in own() {
            let moved = |joint: &Joint| [joint.child, joint.parent].into_iter().find(is_dynamic);
            let Some(body) = moved(joint) else { continue };
            for &(leader, _) in joint.coupling.iter().flat_map(|coupling| &coupling.leaders) {
                if let Some(other) = moved(&self.joints[leader]) {
                    sets.join(body, other);
                }
            }
        }
        let mut groups: BTreeMap<BodyId, Vec<ConstraintHandle>> = BTreeMap::new();
        let mut open_roots = BTreeSet::new();
        for (id, joint) in own() {
            let Some(body) = [joint.parent, joint.child].into_iter().find(is_dynamic) else { continue };
            groups.entry(sets.root(body)).or_default().extend(joint.handle);
            if open.contains(&id) {
                open_roots.insert(sets.root(body));
            }
        }
        let source = own().next()?.1.source.clone();
        let (mut trees, mut joints, mut others) = (0, 0, 0);
        for (root, group) in groups {
            if !open_roots.contains(&root) && self.world.articulate(&group).is_some() {
                trees += 1;
                joints += group.len();
            } else {
                others += group.len();
            }
        }
        let others =
            if others > 0 { format!("; {others} stay constraints between free bodies") } else { String::new() };
        let message = format!("joints in reduced coordinates: {joints}, in {trees} tree(s){others}");
        (trees > 0).then_some(Note { severity: Severity::Info, source, message, wanted: None })
    }
}
