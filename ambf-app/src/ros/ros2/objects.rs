//! From the hub's list of objects to nodes, also while objects come and go.

use std::sync::mpsc::Sender;
use std::sync::Arc;

#[cfg(feature = "pictures")]
use ambf_core::comm::HubIndex;
use ambf_core::comm::{HubObject, ObjectInfo, ObjectKind};
use ros2_node::names::{clean_node, clean_topic, NameSet, MAX_TOPIC};

use super::super::messages::{std_msgs, string};
use super::super::naming::graph_name;
use super::super::point_cloud::PointClouds;
use super::super::scheduler::Entry;
use super::super::topics::{self, ServeContext, TopicSet};
use super::super::ROBOT_DESCRIPTION;
use super::parameters::Offered;
use super::transport::{Latched, NodeParts, Transport};
use crate::report;

/// What topics of an object have behind its name, at most: `/Command/Reset/Bodies` and the like.
const MAX_SUFFIX: usize = 40;

/// An object that is served.
struct ServedObject {
    object: Arc<HubObject>,
    name: String,
    node_name: String,
    parts: NodeParts,
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
    clouds: Arc<PointClouds>,
    /// Positions of cameras of which it is not known yet what they publish.
    #[cfg(feature = "pictures")]
    cameras: Vec<HubIndex>,
}

impl Objects {
    /// Serves nothing yet. What is to be published goes to `publisher`, points that come to `clouds`.
    pub fn new(around: ServeContext, publisher: Sender<Vec<Entry>>, clouds: Arc<PointClouds>) -> Self {
        let (names, node_names) = Default::default();
        Self {
            around,
            publisher,
            names,
            node_names,
            known: Vec::new(),
            generation: None,
            description: None,
            clouds,
            #[cfg(feature = "pictures")]
            cameras: Vec::new(),
        }
    }

    /// Serves what has come since the last call, ends what has gone.
    pub fn follow(&mut self) {
        self.compare();
        self.follow_description();
        #[cfg(feature = "pictures")]
        self.follow_cameras();
    }

    /// The URDF of what is loaded.
    fn follow_description(&mut self) {
        let Some(frames) = &self.around.frames else { return };
        frames.follow(&self.around.hub);
        let described = frames.described();
        if let Some((topic, published)) = self.description.as_mut().filter(|(_, count)| *count != described.count) {
            topic.send(&string(&described.robot.urdf));
            *published = described.count;
        }
    }

    /// Topics of pictures of cameras that have come. What a camera publishes is in its description, which comes a
    /// little after the camera.
    #[cfg(feature = "pictures")]
    fn follow_cameras(&mut self) {
        let (Some(pictures), Some(transport)) = (&self.around.pictures, &self.around.ros2) else { return };
        if self.cameras.is_empty() {
            return;
        }
        // Descriptions from before the change may be those of objects that had the same ids.
        let visuals = self.around.hub.visuals().filter(|visuals| Some(visuals.generation) >= self.generation);
        let Some(visuals) = visuals else { return };
        let objects = self.around.hub.objects().clone();
        let known = &mut self.known;
        self.cameras.retain(|&position| {
            let ObjectKind::Camera(index, _) = objects[position].info.kind else { return false };
            let Some(camera) = visuals.cameras.get(index) else { return true };
            let Some(ServedObject { object, name, node_name, parts }) = known[position.0].take() else { return false };
            transport.resume(parts);
            let arguments = &self.around.arguments;
            let topics = super::pictures::topics(transport, arguments, index, &name, &camera.description);
            known[position.0] = Some(ServedObject { object, name, node_name, parts: transport.finish() });
            topics.into_iter().for_each(|topics| pictures.insert(topics));
            false
        });
    }

    fn compare(&mut self) {
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
                let object = &gone.object;
                if let (Some(frames), ObjectKind::RigidBody(body, _)) = (&self.around.frames, &object.info.kind) {
                    frames.remove(*body);
                }
                self.names.release(&gone.name);
                self.node_names.release(&gone.node_name);
                #[cfg(feature = "pictures")]
                if let (Some(pictures), ObjectKind::Camera(index, _)) = (&self.around.pictures, &object.info.kind) {
                    pictures.remove(*index);
                }
                drop(gone.parts);
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
                    let topic =
                        transport.latched::<std_msgs::String>(&self.around.arguments.mapped(ROBOT_DESCRIPTION.into()));
                    self.description = topic.map(|topic| (topic, 0));
                }
                #[cfg(feature = "pictures")]
                if matches!(object.info.kind, ObjectKind::Camera(..)) {
                    self.cameras.push(position);
                }
                ServedObject { object: Arc::clone(object), name, node_name, parts: transport.finish() }
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
        let name = self.names.claim(clean_topic(&written, MAX_TOPIC - MAX_SUFFIX));
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
        for world in come.parameters.worlds.drain(..) {
            transport.serve_clouds(&self.clouds, &world);
        }
    }
}
