//! Which commands can have acted on a body: who names one when a state was lost has to look beyond the body itself.

use super::Simulation;
use crate::ids::{BodyId, ModelId, Table};

/// How near two bodies are, with respect to what moves one when the other is commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Nearness {
    /// The same body, one that joints connect with it, directly or through others, or one whose commands move such a joint.
    Connected,
    /// Parts of one model.
    SameModel,
    /// Neither: they may touch.
    Apart,
}

impl Simulation {
    /// How near each body is to `body`.
    pub fn nearness(&self, body: BodyId) -> Table<BodyId, Nearness> {
        let scene = &self.physics.scene;
        let mut near = self.nearness_in_model(scene.bodies[body].identity.model);
        let mut neighbours = Table::<BodyId, Vec<BodyId>>::filled(Vec::new(), scene.bodies.len());
        for joint in &scene.joints {
            neighbours[joint.parent].push(joint.child);
            neighbours[joint.child].push(joint.parent);
        }
        let mut found = vec![body];
        near[body] = Nearness::Connected;
        while let Some(next) = found.pop() {
            // What stands still passes nothing on.
            if next != body && scene.bodies[next].mass == 0.0 {
                continue;
            }
            for &neighbour in &neighbours[next] {
                if std::mem::replace(&mut near[neighbour], Nearness::Connected) != Nearness::Connected {
                    found.push(neighbour);
                }
            }
        }
        let moved = |body: BodyId| near[body] == Nearness::Connected && scene.bodies[body].mass != 0.0;
        let commands_one = |&other: &BodyId| {
            let mut joints = scene.active_joints(other).iter().map(|&joint| &scene.joints[joint]);
            joints.any(|joint| moved(joint.parent) || moved(joint.child))
        };
        let commanders: Vec<BodyId> = scene.bodies.ids().filter(commands_one).collect();
        commanders.into_iter().for_each(|commander| near[commander] = Nearness::Connected);
        near
    }

    /// How near each body is to something of `model` that no joint holds.
    pub(super) fn nearness_in_model(&self, model: ModelId) -> Table<BodyId, Nearness> {
        let near = |of: ModelId| if of == model { Nearness::SameModel } else { Nearness::Apart };
        self.physics.scene.bodies.iter().map(|body| near(body.identity.model)).collect()
    }
}
