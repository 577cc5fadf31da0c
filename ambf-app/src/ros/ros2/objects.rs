//! From the hub's list of objects to nodes, also while objects come and go.

use std::sync::mpsc::Sender;

use ambf_core::comm::{ObjectInfo, ObjectKind};
use ros2_node::names::{clean_node, clean_topic, NameSet, LONGEST_TOPIC};

use super::super::messages::{std_msgs, string};
use super::super::naming::graph_name;
use super::super::scheduler::Entry;
use super::super::topics::{self, ServeContext, TopicSet};
use super::super::ROBOT_DESCRIPTION;
use super::parameters::Offered;
use super::transport::{Latched, NodeParts, Transport};
use crate::report;

/// What topics of an object have behind its name, at most: `/Command/Reset/Bodies` and the like.
const LONGEST_ENDING: usize = 40;

/// An object that is served.
struct ServedObject {
    name: String,
    node_name: String,
    _parts: NodeParts,
}

/// Keeps what is served in step with the hub's list of objects.
pub(super) struct Objects {
    around: ServeContext,
    publisher: Sender<Vec<Entry>>,
    names: NameSet,
    node_names: NameSet,
    /// One an object of the hub, as far as it has been looked at; `None` once it is gone.
    known: Vec<Option<ServedObject>>,
    /// The hub's when it was last looked at; `None` before.
    generation: Option<u64>,
    /// The topic with the URDF of what is loaded, and which description it has.
    description: Option<(Latched, u64)>,
}

impl Objects {
    /// Serves nothing yet. What is to be published goes to `publisher`.
    pub fn new(around: ServeContext, publisher: Sender<Vec<Entry>>) -> Self {
        let (names, node_names) = Default::default();
        Self { around, publisher, names, node_names, known: Vec::new(), generation: None, description: None }
    }

    /// Serves what has come since the last call, ends what has gone.
    pub fn follow(&mut self) {
        self.follow_list();
        let Some(frames) = &self.around.frames else { return };
        frames.follow(&self.around.hub);
        let described = frames.described();
        if let Some((topic, published)) = self.description.as_mut().filter(|(_, count)| *count != described.count) {
            topic.send(&string(&described.robot.urdf));
            *published = described.count;
        }
    }

    fn follow_list(&mut self) {
        // Read before the list: what changes between the two is seen again.
        let generation = self.around.hub.generation();
        if self.generation.replace(generation) == Some(generation) {
            return;
        }
        let Some(transport) = self.around.ros2.clone() else { return };
        let _hold = transport.participant().hold_announcements();
        let objects = self.around.hub.objects().clone();
        let served = self.known.len();
        for ((_, object), known) in objects.entries().zip(&mut self.known) {
            if let Some(gone) = known.take_if(|_| object.is_removed()) {
                if let (Some(frames), ObjectKind::RigidBody(body, _)) = (&self.around.frames, &object.info.kind) {
                    frames.remove(*body);
                }
                self.names.release(&gone.name);
                self.node_names.release(&gone.node_name);
            }
        }
        let mut come = TopicSet::default();
        for (position, object) in objects.entries().skip(served) {
            let known = (!object.is_removed()).then(|| {
                let name = self.name(&object.info);
                let node_name = self.node_names.claim(clean_node(&name));
                transport.begin(&node_name);
                topics::serve(&self.around, &mut come, position, &object.info, name.clone());
                self.serve_parameters(&transport, &mut come);
                if self.around.frames.is_some() && matches!(object.info.kind, ObjectKind::World) {
                    let topic = transport.latched::<std_msgs::String>(ROBOT_DESCRIPTION);
                    self.description = topic.map(|topic| (topic, 0));
                }
                ServedObject { name, node_name, _parts: transport.finish() }
            });
            self.known.push(known);
        }
        // Nobody listens any more while the program ends.
        let _ = self.publisher.send(come.entries);
    }

    /// The part that all topics of an object share, of its own; said where it differs from that of ROS 1.
    fn name(&mut self, object: &ObjectInfo) -> String {
        let own = if object.name.is_empty() { "_" } else { &object.name };
        let written = format!("/{}/{own}", object.namespace);
        let name = self.names.claim(clean_topic(&written, LONGEST_TOPIC - LONGEST_ENDING));
        if name != graph_name(&[&object.namespace, own]).0 {
            report!("ROS 2: \"{}\" is published as {name}", object.identifier);
        }
        name
    }

    fn serve_parameters(&self, transport: &Transport, come: &mut TopicSet) {
        let hub = &self.around.hub;
        for camera in come.parameters.cameras.drain(..) {
            transport.serve_parameters(Offered::new(hub, camera));
        }
        for light in come.parameters.lights.drain(..) {
            transport.serve_parameters(Offered::new(hub, light));
        }
    }
}
