//! From the hub's list of objects to topics and parameters, also while objects come and go.

use std::sync::mpsc::Sender;
use std::sync::Arc;
use std::time::Duration;

use ambf_core::comm::{self, HubObject, ObjectKind};
use ros_node::{Announcement, Link};

use super::naming::Names;
use super::parameters::ParameterChange;
#[cfg(feature = "pictures")]
use super::pictures::CameraTopics;
use super::scheduler::Entry;
use super::topics::{self, ServeContext, TopicSet};

/// How often the list is compared with what is served.
const POLL: Duration = Duration::from_millis(50);

/// An object that is served.
struct ServedObject {
    object: Arc<HubObject>,
    name: String,
    announcements: Vec<Arc<dyn Announcement>>,
}

/// Keeps what is served in step with the hub's list of objects.
pub(super) struct Objects {
    around: ServeContext,
    names: Names,
    /// One an object of the hub, as far as it has been looked at; `None` once it is gone.
    known: Vec<Option<ServedObject>>,
    /// The hub's when it was last looked at; `None` before.
    generation: Option<u64>,
    /// Positions of cameras of which it is not known yet what they publish.
    #[cfg(feature = "pictures")]
    cameras: Vec<comm::HubIndex>,
}

/// What has changed.
#[derive(Default)]
struct Change {
    come: TopicSet,
    withdrawn: Vec<Arc<dyn Announcement>>,
}

/// Who gets changes.
pub(super) struct ChangeSinks {
    pub link: Arc<Link>,
    pub publisher: Sender<Vec<Entry>>,
    pub parameters: Sender<ParameterChange>,
}

impl Objects {
    /// Serves nothing yet.
    pub fn new(around: ServeContext) -> Self {
        Self {
            around,
            names: Names::default(),
            known: Vec::new(),
            generation: None,
            #[cfg(feature = "pictures")]
            cameras: Vec::new(),
        }
    }

    /// Follows the list until the link is stopped. Blocks while the master thinks, which is why it needs a thread of
    /// its own.
    pub fn run(mut self, sinks: &ChangeSinks) {
        while !sinks.link.stop.wait(POLL) {
            self.follow(sinks);
        }
    }

    /// Announces what has come since the last call, withdraws what has gone.
    pub fn follow(&mut self, sinks: &ChangeSinks) {
        if let Some(Change { come, withdrawn }) = self.compare() {
            // Withdrawn first: what comes may have the same topics.
            sinks.link.remove(&withdrawn);
            // Nobody listens any more while the program ends.
            let _ = sinks.publisher.send(come.entries);
            let _ = sinks.parameters.send(come.parameters);
            sinks.link.add(come.announcements);
        }
        if let Some(frames) = &self.around.frames {
            frames.follow(&self.around.hub);
        }
        #[cfg(feature = "pictures")]
        {
            let new = self.follow_cameras();
            // Adding wakes the link, which is not to be done for nothing.
            if !new.is_empty() {
                sinks.link.add(new);
            }
        }
    }

    /// Topics of pictures of cameras that have come. What a camera publishes is in its description, which comes a
    /// little after the camera.
    #[cfg(feature = "pictures")]
    fn follow_cameras(&mut self) -> Vec<Arc<dyn Announcement>> {
        let mut announcements = Vec::new();
        let Some(pictures) = self.around.pictures.as_ref().filter(|_| !self.cameras.is_empty()) else {
            return announcements;
        };
        // Descriptions from before the change may be those of objects that had the same ids.
        let visuals = self.around.hub.visuals().filter(|visuals| Some(visuals.generation) >= self.generation);
        let Some(visuals) = visuals else { return announcements };
        let objects = self.around.hub.objects().clone();
        let (known, arguments) = (&mut self.known, &self.around.arguments);
        self.cameras.retain(|&position| {
            let (Some(known), ObjectKind::Camera(index, _)) = (&mut known[position.0], &objects[position].info.kind)
            else {
                return false;
            };
            let Some(camera) = visuals.cameras.get(*index) else { return true };
            let mapped = |topic| arguments.mapped(topic);
            let described = &camera.description;
            if let Some((topics, new)) = CameraTopics::of_ros1(*index, &known.name, described, mapped) {
                known.announcements.extend(new.iter().cloned());
                announcements.extend(new);
                pictures.insert(topics);
            }
            false
        });
        announcements
    }

    fn compare(&mut self) -> Option<Change> {
        // Read before the list: what changes between the two is seen again.
        let generation = self.around.hub.generation();
        if self.generation == Some(generation) {
            return None;
        }
        self.generation = Some(generation);
        let objects = self.around.hub.objects().clone();
        let mut change = Change::default();
        let served = self.known.len();
        for ((position, object), known) in objects.entries().zip(&mut self.known) {
            if let Some(known) = known.take_if(|_| object.is_removed()) {
                let object = &known.object;
                self.names.give_back(&known.name, &object.info);
                change.withdrawn.extend(known.announcements);
                if let (Some(frames), ObjectKind::RigidBody(body, _)) = (&self.around.frames, &object.info.kind) {
                    frames.remove(*body);
                }
                #[cfg(feature = "pictures")]
                if let (Some(pictures), ObjectKind::Camera(index, _)) = (&self.around.pictures, &object.info.kind) {
                    pictures.remove(*index);
                }
                change.come.parameters.removed.push(position);
            }
        }
        for (position, object) in objects.entries().skip(served) {
            let known = (!object.is_removed()).then(|| {
                let begin = change.come.announcements.len();
                let name = self.names.take(&object.info);
                topics::serve(&self.around, &mut change.come, position, &object.info, name.clone());
                #[cfg(feature = "pictures")]
                if matches!(object.info.kind, ObjectKind::Camera(..)) {
                    self.cameras.push(position);
                }
                let object = Arc::clone(object);
                ServedObject { object, name, announcements: change.come.announcements[begin..].to_vec() }
            });
            self.known.push(known);
        }
        Some(change)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::arguments::RosArguments;
    use crate::ros::models::{ModelHost, ModelReply};
    use crate::ros::Extras;
    use ambf_core::comm::{Hub, ObjectInfo, Rates, SensorInfo, SensorType};
    use ambf_core::ids::{ActuatorId, BodyId, CameraId, GhostId, LightId, SensorId, SoftBodyId, VehicleId};
    use ros_node::Direction;
    use std::path::{Path, PathBuf};

    /// A host that does nothing.
    struct Nobody;

    impl ModelHost for Nobody {
        fn add(&self, _: &Path) -> Result<ModelReply, String> {
            Err("nobody is here".into())
        }

        fn remove(&self, _: &str) -> Result<String, String> {
            Err("nobody is here".into())
        }

        fn list(&self) -> Vec<(String, PathBuf)> {
            Vec::new()
        }
    }

    fn object(kind: ObjectKind, name: &str) -> ObjectInfo {
        ObjectInfo {
            kind,
            namespace: "/ambf//env/".into(),
            name: name.into(),
            identifier: format!("/ambf/env/{name}"),
            rates: Rates::default(),
        }
    }

    fn objects(hub: &Arc<Hub>, models: Option<Arc<dyn ModelHost>>) -> Objects {
        Objects::new(ServeContext {
            hub: Arc::clone(hub),
            waker: Arc::default(),
            extras: Extras::default(),
            frames: None,
            models,
            recordings: None,
            steppables: Arc::default(),
            arguments: RosArguments::default(),
            #[cfg(feature = "ros2")]
            ros2: None,
            #[cfg(feature = "pictures")]
            pictures: None,
        })
    }

    fn lines(announcements: &[Arc<dyn Announcement>]) -> Vec<String> {
        let registrations = announcements.iter().map(|announcement| announcement.registration());
        let mut lines: Vec<_> = registrations
            .map(|r| {
                let side = match r.direction {
                    Direction::Publishes => "out",
                    Direction::Subscribes => "in",
                    Direction::Serves => "service",
                };
                format!("{} {} {side}", r.topic, r.message_type)
            })
            .collect();
        lines.sort();
        lines
    }

    #[test]
    fn every_object_gets_its_topics_and_the_world_some_of_its_own() {
        let hub = Arc::new(Hub::new(vec![
            object(ObjectKind::World, "World"),
            object(ObjectKind::RigidBody(BodyId::new(0), Box::default()), "psm/baselink1"),
            object(ObjectKind::Camera(CameraId::new(0), Box::default()), "cameras/default_camera"),
            object(ObjectKind::Light(LightId::new(0), Box::default()), "light"),
            object(ObjectKind::Sensor(SensorId::new(0), Box::default()), "sensor"),
            object(
                ObjectKind::Sensor(
                    SensorId::new(1),
                    Box::new(SensorInfo { kind: SensorType::Contact, ..Default::default() }),
                ),
                "touch",
            ),
            object(ObjectKind::Actuator(ActuatorId::new(0), Box::default()), "actuator"),
            object(ObjectKind::Vehicle(VehicleId::new(0), Box::default()), "vehicle"),
            object(ObjectKind::SoftBody(SoftBodyId::new(0), 1.0), "soft body"),
            object(ObjectKind::Ghost(GhostId::new(0), Box::default()), "ghost"),
        ]));
        let change = objects(&hub, Some(Arc::new(Nobody))).compare().unwrap();
        assert_eq!(
            lines(&change.come.announcements),
            [
                "/ambf/env/World/Command ambf_msgs/WorldCmd in",
                "/ambf/env/World/Command/Reset std_msgs/Empty in",
                "/ambf/env/World/Command/Reset/Bodies std_msgs/Empty in",
                "/ambf/env/World/Command/ResetBodies std_msgs/Empty in",
                "/ambf/env/World/State ambf_msgs/WorldState out",
                "/ambf/env/World/Timing ambf_msgs/Timing out",
                "/ambf/env/World/add_model ambf_msgs/AddModel service",
                "/ambf/env/World/list_models ambf_msgs/ListModels service",
                "/ambf/env/World/remove_model ambf_msgs/RemoveModel service",
                "/ambf/env/World/step ambf_msgs/Step service",
                "/ambf/env/actuator/Command ambf_msgs/ActuatorCmd in",
                "/ambf/env/actuator/State ambf_msgs/ActuatorState out",
                "/ambf/env/cameras/default_camera/Command ambf_msgs/CameraCmd in",
                "/ambf/env/cameras/default_camera/State ambf_msgs/CameraState out",
                "/ambf/env/ghost/Command ambf_msgs/GhostObjectCmd in",
                "/ambf/env/ghost/State ambf_msgs/GhostObjectState out",
                "/ambf/env/light/Command ambf_msgs/LightCmd in",
                "/ambf/env/light/State ambf_msgs/LightState out",
                "/ambf/env/psm/baselink1/Command ambf_msgs/RigidBodyCmd in",
                "/ambf/env/psm/baselink1/State ambf_msgs/RigidBodyState out",
                "/ambf/env/sensor/Command ambf_msgs/SensorCmd in",
                "/ambf/env/sensor/State ambf_msgs/SensorState out",
                "/ambf/env/soft_body/Command ambf_msgs/SoftBodyCmd in",
                "/ambf/env/soft_body/State ambf_msgs/SoftBodyState out",
                "/ambf/env/touch/Command ambf_msgs/ContactSensorCmd in",
                "/ambf/env/touch/State ambf_msgs/ContactSensorState out",
                "/ambf/env/vehicle/Command ambf_msgs/VehicleCmd in",
                "/ambf/env/vehicle/State ambf_msgs/VehicleState out",
                "/diagnostics diagnostic_msgs/DiagnosticArray out",
            ]
        );
        let parameters = change.come.parameters;
        assert_eq!((parameters.cameras.len(), parameters.lights.len(), parameters.worlds.len()), (1, 1, 1));
        assert_eq!(change.come.entries.len(), 12, "a state each, the world's timing and diagnostics");
        assert!(change.withdrawn.is_empty());
    }

    #[test]
    fn objects_come_and_go() {
        let hub = Arc::new(Hub::new(vec![object(ObjectKind::World, "World")]));
        let mut objects = objects(&hub, None);
        assert_eq!(objects.compare().unwrap().come.announcements.len(), 8, "no host, no services for models");
        assert!(objects.compare().is_none(), "nothing has changed");

        let car = || object(ObjectKind::Vehicle(VehicleId::new(0), Box::default()), "car");
        let light = || object(ObjectKind::Light(LightId::new(0), Box::default()), "light");
        hub.add_objects(vec![car(), light()]);
        let change = objects.compare().unwrap();
        assert_eq!(
            lines(&change.come.announcements),
            [
                "/ambf/env/car/Command ambf_msgs/VehicleCmd in",
                "/ambf/env/car/State ambf_msgs/VehicleState out",
                "/ambf/env/light/Command ambf_msgs/LightCmd in",
                "/ambf/env/light/State ambf_msgs/LightState out",
            ]
        );
        assert_eq!((change.come.parameters.lights.len(), change.come.entries.len()), (1, 2));

        // One goes, one comes and goes unseen, one comes that has the name of the one that goes.
        hub.remove_objects([comm::HubIndex(1)]);
        hub.add_objects(vec![object(ObjectKind::Ghost(GhostId::new(0), Box::default()), "unseen"), car()]);
        hub.remove_objects([comm::HubIndex(3)]);
        let change = objects.compare().unwrap();
        let topics =
            ["/ambf/env/car/Command ambf_msgs/VehicleCmd in", "/ambf/env/car/State ambf_msgs/VehicleState out"];
        assert_eq!(lines(&change.withdrawn), topics);
        assert_eq!(lines(&change.come.announcements), topics);
        assert_eq!(change.come.parameters.removed, [comm::HubIndex(1)]);
        assert!(!change.withdrawn.iter().any(|old| change.come.announcements.iter().any(|new| Arc::ptr_eq(old, new))));
    }
}
