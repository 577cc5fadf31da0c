//! States that descriptions name, as changes of a scene.

use std::collections::{BTreeMap, HashMap};

use super::{Scene, StateChange};
use crate::adf::Common;
use crate::ids::{BodyId, JointId};

impl Scene {
    /// The states that the descriptions of its models name, by name. Those of the same name in several models are one: that of all
    /// of them.
    pub fn keyframes(&self) -> BTreeMap<String, StateChange> {
        let mut all: BTreeMap<String, StateChange> = BTreeMap::new();
        for (id, model) in self.models.entries().filter(|(_, model)| !model.description.keyframes.is_empty()) {
            let own = |body: &&super::Body| !body.removed && body.identity.model == id;
            let bodies: HashMap<String, BodyId> = (self.bodies.entries())
                .filter(|(_, body)| own(body))
                .map(|(id, body)| (body.identity.key(), id))
                .collect();
            let joints: HashMap<&str, JointId> = (self.joints.entries())
                .filter(|(_, joint)| !joint.removed && joint.model == id)
                .map(|(id, joint)| (joint.key.as_str(), id))
                .collect();
            let description = &model.description;
            // Namespaces in the scene begin with a prefix of the file that lists the model.
            let first = self.bodies.iter().find(own).map_or("", |body| &body.identity.namespace);
            let prefix = first.strip_suffix(description.namespace.as_str()).unwrap_or_default();
            let key = |common: &Common| format!("{prefix}{}{}", common.namespace, common.identifier);
            let body = |index: usize| bodies.get(&key(&description.bodies.get(index)?.common)).copied();
            let joint = |index: usize| joints.get(key(&description.joints.get(index)?.common).as_str()).copied();
            for keyframe in &description.keyframes {
                let change = all.entry(keyframe.name.clone()).or_default();
                let of_joints = |values: &[(usize, f64)]| -> Vec<(JointId, f64)> {
                    values.iter().filter_map(|&(index, value)| Some((joint(index)?, value))).collect()
                };
                change.positions.extend(of_joints(&keyframe.positions));
                change.rates.extend(of_joints(&keyframe.rates));
                change.poses.extend(keyframe.poses.iter().filter_map(|&(index, pose)| Some((body(index)?, pose))));
                change.twists.extend(keyframe.twists.iter().filter_map(|&(index, twist)| Some((body(index)?, twist))));
            }
        }
        all
    }
}
