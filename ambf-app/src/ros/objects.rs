//! From the hub's list of objects to topics: what is published, what is listened to.

use std::sync::Arc;

use ambf_core::comm::{
    ActuatorInfo, CameraParameters, Hub, LightParameters, ObjectInfo, ObjectKind, PostError, Rates, RigidBodyInfo,
    SensorCommand, SensorInfo, Snapshot, VehicleInfo,
};
use rosrust::Message;

use super::messages::ambf_msgs;
use super::naming::object_names;
use super::posed::{self, Identity, ParentName};
use super::received::FromClient;
use super::rigid_body::{self, Requests};
use super::scheduler::{is_live, Entry, StateOutlet};
use super::signal::{Complaints, Said, Waker};
use super::topic::{Announcement, Publication, Subscription};
use super::{actuator, ghost, sensor, soft_body, vehicle, world};
use crate::report;

/// An object whose parameters are on the parameter server.
pub(super) struct Parameterised<P> {
    /// Position in the hub.
    pub object: usize,
    /// `/<namespace>/<name>`.
    pub name: String,
    /// Values in force.
    pub values: P,
    /// Shown in the object's state.
    pub parent: Arc<ParentName>,
}

/// Everything that follows from the list of objects.
#[derive(Default)]
pub(super) struct Served {
    pub entries: Vec<Entry>,
    pub announcements: Vec<Arc<dyn Announcement>>,
    pub cameras: Vec<Parameterised<CameraParameters>>,
    pub lights: Vec<Parameterised<LightParameters>>,
    /// `/<namespace>/World`.
    pub worlds: Vec<String>,
}

/// Topics of all objects of `hub`.
pub(super) fn serve(hub: &Arc<Hub>, waker: &Arc<Waker>, n_devices: u8) -> Served {
    let mut builder = Builder { hub, waker, n_devices, served: Served::default() };
    let objects = hub.objects();
    let infos = || objects.iter().map(|object| &object.info);
    for (object, (info, name)) in infos().zip(object_names(infos())).enumerate() {
        match &info.kind {
            ObjectKind::World => builder.world(object, info, name),
            ObjectKind::RigidBody(index, body) => builder.rigid_body(object, info, name, *index, body),
            ObjectKind::Camera(index, parameters) => builder.camera(object, info, name, *index, parameters),
            ObjectKind::Light(index, parameters) => builder.light(object, info, name, *index, parameters),
            ObjectKind::Sensor(index, sensor) => builder.sensor(object, info, name, *index, sensor),
            ObjectKind::Actuator(index, actuator) => builder.actuator(object, info, name, *index, actuator),
            ObjectKind::Vehicle(index, vehicle) => builder.vehicle(object, info, name, *index, vehicle),
            ObjectKind::SoftBody(index, mass) => builder.soft_body(object, info, name, *index, *mass),
            ObjectKind::Ghost(index) => builder.ghost(object, info, name, *index),
        }
    }
    builder.served
}

/// What a command callback needs: one an object.
struct Commanded {
    hub: Arc<Hub>,
    waker: Arc<Waker>,
    object: usize,
    topic: String,
    complaints: Complaints,
    /// Fields without effect that have been named.
    named: Said,
}

impl Commanded {
    /// Leaves a command with the hub. The first one of a stream raises the rate at once, not at the next slow tick.
    fn post(&self, post: impl FnOnce(&Hub, usize) -> Result<(), PostError>) {
        let was_live = is_live(&self.hub, self.object, self.hub.now_ns());
        if let Err(error) = post(&self.hub, self.object) {
            self.complaints.report(format_args!("{}: {error}", self.topic));
        } else if !was_live {
            self.waker.wake();
        }
    }
}

impl Commanded {
    /// Says once a topic which `fields` of a command have no effect, and that `taken` is what has.
    fn name_unused(&self, fields: impl Iterator<Item = &'static str>, taken: &str) {
        for field in self.named.first_of(fields) {
            report!("ROS: {}: {field} has no effect: {taken}; this is said once", self.topic);
        }
    }
}

struct Builder<'a> {
    hub: &'a Arc<Hub>,
    waker: &'a Arc<Waker>,
    n_devices: u8,
    served: Served,
}

impl Builder<'_> {
    /// Publishes on `topic`, at the fast rate while commands come for `commanded_by`.
    fn publish<M: Message>(
        &mut self,
        topic: String,
        rates: Rates,
        commanded_by: Option<usize>,
        message: impl FnMut(Option<&Snapshot>) -> Option<M> + Send + 'static,
    ) {
        let publication = Publication::new(topic);
        self.served.announcements.push(Arc::clone(&publication) as Arc<dyn Announcement>);
        let outlet = Box::new(StateOutlet { publication, message });
        self.served.entries.push(Entry::new(outlet, rates, commanded_by, self.hub.now()));
    }

    fn subscribe<M: FromClient>(&mut self, topic: String, on_message: impl Fn(M) + Send + Sync + 'static) {
        self.served.announcements.push(Subscription::new(topic, on_message));
    }

    fn commanded(&self, object: usize, name: &str) -> Commanded {
        Commanded {
            hub: Arc::clone(self.hub),
            waker: Arc::clone(self.waker),
            object,
            topic: format!("{name}/Command"),
            complaints: Complaints::default(),
            named: Said::default(),
        }
    }

    fn world(&mut self, object: usize, info: &ObjectInfo, name: String) {
        let n_devices = self.n_devices;
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            Some(world::state(snapshot, n_devices))
        });
        let timing_rates = Rates { min: 10, max: 10 };
        self.publish(format!("{name}/Timing"), timing_rates, None, |snapshot| snapshot.map(world::timing));
        let on_command = world::on_command(Arc::clone(self.hub));
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|_, _| {
                on_command(message);
                Ok(())
            });
        });
        self.subscribe(format!("{name}/Command/Reset"), world::on_reset(Arc::clone(self.hub)));
        self.subscribe(format!("{name}/Command/Reset/Bodies"), world::on_body_reset(Arc::clone(self.hub)));
        self.served.worlds.push(name);
    }

    fn rigid_body(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize, body: &RigidBodyInfo) {
        let requests = Arc::<Requests>::default();
        let mut source =
            rigid_body::StateSource::new(index, body.clone(), &info.name, &info.identifier, Arc::clone(&requests));
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| source.message(snapshot?));
        let n_joints = body.joint_names.len().max(body.joints.len());
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message: ambf_msgs::RigidBodyCmd| {
            let command = rigid_body::command(&message, n_joints);
            commanded.post(|hub, object| {
                hub.post(object, &command)?;
                requests.note(&message);
                Ok(())
            });
            if let Some(what) = rigid_body::unknown_type(&command) {
                commanded.complaints.report(format_args!("{}: {what}", commanded.topic));
            }
        });
    }

    fn camera(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize, parameters: &CameraParameters) {
        let (identity, parent) = identity(info, &parameters.parent_name);
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            let snapshot = snapshot?;
            Some(posed::camera_state(&identity, snapshot.cameras.get(index)?, snapshot))
        });
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &posed::camera_command(&message)));
        });
        self.served.cameras.push(Parameterised { object, name, values: parameters.clone(), parent });
    }

    fn light(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize, parameters: &LightParameters) {
        let (identity, parent) = identity(info, &parameters.parent_name);
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            let snapshot = snapshot?;
            Some(posed::light_state(&identity, snapshot.lights.get(index)?, snapshot))
        });
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &posed::light_command(&message)));
        });
        self.served.lights.push(Parameterised { object, name, values: parameters.clone(), parent });
    }
}

impl Builder<'_> {
    fn sensor(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize, sensor: &SensorInfo) {
        let (of, sensor) = (info.clone(), sensor.clone());
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            sensor::state(&of, index, &sensor, snapshot?)
        });
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |_: ambf_msgs::SensorCmd| {
            commanded.post(|hub, object| hub.post(object, &SensorCommand));
        });
    }

    fn actuator(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize, actuator: &ActuatorInfo) {
        let (of, actuator) = (info.clone(), actuator.clone());
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            actuator::state(&of, index, &actuator, snapshot?)
        });
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message| match actuator::command(message) {
            Ok(command) => commanded.post(|hub, object| hub.post(object, &command)),
            Err(why) => {
                commanded.complaints.report(format_args!("{}: {why}", commanded.topic));
            }
        });
    }

    fn vehicle(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize, vehicle: &VehicleInfo) {
        let (of, wheels, vehicle) = (info.clone(), vehicle.wheels, vehicle.clone());
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            vehicle::state(&of, index, &vehicle, snapshot?)
        });
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &vehicle::command(&message, wheels)));
        });
    }

    fn soft_body(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize, mass: f64) {
        let of = info.clone();
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            soft_body::state(&of, index, mass, snapshot?)
        });
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.name_unused(soft_body::unused_fields(&message), "a soft body takes a wrench.force");
            commanded.post(|hub, object| hub.post(object, &soft_body::command(&message)));
        });
    }

    fn ghost(&mut self, object: usize, info: &ObjectInfo, name: String, index: usize) {
        let of = info.clone();
        self.publish(format!("{name}/State"), info.rates, Some(object), move |snapshot| {
            ghost::state(&of, index, snapshot?)
        });
        let commanded = self.commanded(object, &name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.name_unused(
                ghost::unused_fields(&message),
                "a ghost object takes a pose, with enable_position_controller",
            );
            commanded.post(|hub, object| hub.post(object, &ghost::command(&message)));
        });
    }
}

fn identity(info: &ObjectInfo, parent: &str) -> (Identity, Arc<ParentName>) {
    let parent = ParentName::new(parent);
    let identity =
        Identity { name: info.name.clone(), identifier: info.identifier.clone(), parent: Arc::clone(&parent) };
    (identity, parent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::topic::Direction;

    #[test]
    fn every_object_gets_its_topics_and_the_world_five_of_its_own() {
        let object = |kind, name: &str| ObjectInfo {
            kind,
            namespace: "/ambf//env/".into(),
            name: name.into(),
            identifier: format!("/ambf/env/{name}"),
            rates: Rates::default(),
        };
        let hub = Arc::new(Hub::new(vec![
            object(ObjectKind::World, "World"),
            object(ObjectKind::RigidBody(0, Box::default()), "psm/baselink1"),
            object(ObjectKind::Camera(0, Box::default()), "cameras/default_camera"),
            object(ObjectKind::Light(0, Box::default()), "light"),
            object(ObjectKind::Sensor(0, Box::default()), "sensor"),
            object(ObjectKind::Actuator(0, Box::default()), "actuator"),
            object(ObjectKind::Vehicle(0, Box::default()), "vehicle"),
            object(ObjectKind::SoftBody(0, 1.0), "soft body"),
            object(ObjectKind::Ghost(0), "ghost"),
        ]));
        let served = serve(&hub, &Arc::default(), 0);
        let mut lines: Vec<_> = served
            .announcements
            .iter()
            .map(|a| a.registration())
            .map(|r| format!("{} {} {}", r.topic, r.message_type, r.direction == Direction::Publishes))
            .collect();
        lines.sort();
        assert_eq!(
            lines,
            [
                "/ambf/env/World/Command ambf_msgs/WorldCmd false",
                "/ambf/env/World/Command/Reset std_msgs/Empty false",
                "/ambf/env/World/Command/Reset/Bodies std_msgs/Empty false",
                "/ambf/env/World/State ambf_msgs/WorldState true",
                "/ambf/env/World/Timing ambf_msgs/Timing true",
                "/ambf/env/actuator/Command ambf_msgs/ActuatorCmd false",
                "/ambf/env/actuator/State ambf_msgs/ActuatorState true",
                "/ambf/env/cameras/default_camera/Command ambf_msgs/CameraCmd false",
                "/ambf/env/cameras/default_camera/State ambf_msgs/CameraState true",
                "/ambf/env/ghost/Command ambf_msgs/ObjectCmd false",
                "/ambf/env/ghost/State ambf_msgs/ObjectState true",
                "/ambf/env/light/Command ambf_msgs/LightCmd false",
                "/ambf/env/light/State ambf_msgs/LightState true",
                "/ambf/env/psm/baselink1/Command ambf_msgs/RigidBodyCmd false",
                "/ambf/env/psm/baselink1/State ambf_msgs/RigidBodyState true",
                "/ambf/env/sensor/Command ambf_msgs/SensorCmd false",
                "/ambf/env/sensor/State ambf_msgs/SensorState true",
                "/ambf/env/soft_body/Command ambf_msgs/SoftBodyCmd false",
                "/ambf/env/soft_body/State ambf_msgs/SoftBodyState true",
                "/ambf/env/vehicle/Command ambf_msgs/VehicleCmd false",
                "/ambf/env/vehicle/State ambf_msgs/VehicleState true",
            ]
        );
        assert_eq!((served.cameras.len(), served.lights.len(), served.worlds.len()), (1, 1, 1));
    }
}
