//! The topics of one object: what is published, what is listened to.

use std::sync::Arc;

use ambf_core::comm::{
    ActuatorInfo, CameraParameters, GhostInfo, Hub, HubIndex, LightParameters, ObjectInfo, ObjectKind, PostError,
    Rates, RigidBodyInfo, SensorCommand, SensorInfo, SensorType, Snapshot, VehicleInfo,
};
use ambf_core::ids::{ActuatorId, BodyId, CameraId, GhostId, LightId, SensorId, SoftBodyId, VehicleId};
use ros_node::{Announcement, Publication};
use rosrust::Message;

use super::arguments::RosArguments;
use super::diagnostics;
use super::frames::{self, Frames};
use super::messages::{ambf_msgs, rosgraph_msgs, time};
use super::models::{self, ModelHost};
use super::parameters::{ParameterChange, Parameterised};
use super::posed::{self, Identity, ParentName};
use super::received::{self, FromClient};
use super::rigid_body::{self, Requests};
use super::scheduler::{is_live, Entry, StateOutlet};
use super::signal::{OnceLog, RateLimitedLog, Waker};
use super::step::{self, Kind, Steppable, Steppables};
use super::{actuator, contact, ghost, sensor, soft_body, vehicle, world, Extras};
use crate::report;

/// How often `/clock` is published, Hz.
const CLOCK_FREQUENCY: u32 = 200;

/// Longest command, bytes: some hundred thousand joints.
const LONGEST_COMMAND: usize = 1 << 20;

/// Everything that follows from objects that have come.
#[derive(Default)]
pub(super) struct TopicSet {
    pub entries: Vec<Entry>,
    pub announcements: Vec<Arc<dyn Announcement>>,
    pub parameters: ParameterChange,
}

/// What a command callback needs: one an object.
struct Commanded {
    hub: Arc<Hub>,
    waker: Arc<Waker>,
    object: HubIndex,
    topic: String,
    complaints: RateLimitedLog,
    /// Fields without effect that have been named.
    named: OnceLog,
}

impl Commanded {
    /// Leaves a command with the hub. The first one of a stream raises the rate at once, not at the next slow tick.
    fn post(&self, post: impl FnOnce(&Hub, HubIndex) -> Result<(), PostError>) {
        let was_live = is_live(&self.hub, self.object, self.hub.now_ns());
        if let Err(error) = post(&self.hub, self.object) {
            self.complaints.report(format_args!("{}: {error}", self.topic));
        } else if !was_live {
            self.waker.wake();
        }
    }

    /// Says once a topic which `fields` of a command have no effect, and that `taken` is what has.
    fn name_unused(&self, fields: impl Iterator<Item = &'static str>, taken: &str) {
        for field in self.named.first_of(fields) {
            report!("ROS: {}: {field} has no effect: {taken}; this is said once", self.topic);
        }
    }
}

/// What the topics of every object are made with.
pub(super) struct ServeContext {
    pub hub: Arc<Hub>,
    pub waker: Arc<Waker>,
    /// What is published beside the objects.
    pub extras: Extras,
    /// Frames of the bodies, if they are wanted.
    pub frames: Option<Arc<Frames>>,
    /// Who adds and removes models; without one there are no services.
    pub models: Option<Arc<dyn ModelHost>>,
    /// What steps can command and observe.
    pub steppables: Arc<Steppables>,
    /// What the command line says.
    pub arguments: RosArguments,
    /// Where the topics are made if they are those of ROS 2; `None`: they are those of ROS 1.
    #[cfg(feature = "ros2")]
    pub ros2: Option<Arc<super::ros2::Transport>>,
    /// Where topics of pictures are to be found; `None`: there are none.
    #[cfg(feature = "pictures")]
    pub pictures: Option<Arc<super::pictures::PictureTopics>>,
}

/// Makes the topics of the object at position `object`, whose name is `name` (`/<namespace>/<name>`), and adds them to
/// `served`.
pub(super) fn serve(around: &ServeContext, served: &mut TopicSet, object: HubIndex, info: &ObjectInfo, name: String) {
    let mut builder = Builder { around, served, object };
    match &info.kind {
        ObjectKind::World => builder.world(info, name),
        ObjectKind::RigidBody(index, body) => builder.rigid_body(info, name, *index, body),
        ObjectKind::Camera(index, parameters) => builder.camera(info, name, *index, parameters),
        ObjectKind::Light(index, parameters) => builder.light(info, name, *index, parameters),
        ObjectKind::Sensor(index, sensor) => builder.sensor(info, name, *index, sensor),
        ObjectKind::Actuator(index, actuator) => builder.actuator(info, name, *index, actuator),
        ObjectKind::Vehicle(index, vehicle) => builder.vehicle(info, name, *index, vehicle),
        ObjectKind::SoftBody(index, mass) => builder.soft_body(info, name, *index, *mass),
        ObjectKind::Ghost(index, ghost) => builder.ghost(info, name, *index, ghost),
    }
}

/// Always this frequency, Hz.
fn at(frequency: u32) -> Rates {
    Rates { min: frequency, max: frequency }
}

struct Builder<'a> {
    around: &'a ServeContext,
    served: &'a mut TopicSet,
    /// Position in the hub.
    object: HubIndex,
}

impl Builder<'_> {
    /// Publishes on `topic`; if it is `commanded`, at the fast rate while commands come for the object.
    fn publish<M: Message>(
        &mut self,
        topic: String,
        rates: Rates,
        commanded: bool,
        message: impl FnMut(Option<&Snapshot>) -> Option<M> + Send + 'static,
    ) {
        #[cfg(feature = "ros2")]
        if let Some(ros2) = &self.around.ros2 {
            let outlet = ros2.publish(&self.around.arguments.mapped(topic), rates, message);
            let entry = |outlet| Entry::new(outlet, rates, self.object, commanded, self.around.hub.now());
            self.served.entries.extend(outlet.map(entry));
            return;
        }
        let publication = Publication::new(self.around.arguments.mapped(topic));
        self.served.announcements.push(Arc::clone(&publication) as Arc<dyn Announcement>);
        let outlet = Box::new(StateOutlet { publication, message });
        self.served.entries.push(Entry::new(outlet, rates, self.object, commanded, self.around.hub.now()));
    }

    fn subscribe<M: FromClient>(&mut self, topic: String, on_message: impl FnMut(M) + Send + 'static) {
        #[cfg(feature = "ros2")]
        if let Some(ros2) = &self.around.ros2 {
            return ros2.subscribe(&self.around.arguments.mapped(topic), LONGEST_COMMAND, on_message);
        }
        let topic = self.around.arguments.mapped(topic);
        let subscription = received::subscription(topic, LONGEST_COMMAND, on_message);
        self.served.announcements.push(subscription);
    }

    fn commanded(&self, name: &str) -> Commanded {
        Commanded {
            hub: Arc::clone(&self.around.hub),
            waker: Arc::clone(&self.around.waker),
            object: self.object,
            topic: format!("{name}/Command"),
            complaints: RateLimitedLog::default(),
            named: OnceLog::default(),
        }
    }

    fn can_be_stepped(&self, name: &str, info: &ObjectInfo, kind: Kind) {
        let steppable = Steppable { object: self.object, info: info.clone(), kind };
        self.around.steppables.insert(name.to_owned(), steppable);
    }

    fn world(&mut self, info: &ObjectInfo, name: String) {
        let (hub, devices) = (Arc::clone(&self.around.hub), Arc::clone(&self.around.extras.devices));
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            Some(world::state(snapshot, devices.count(), hub.lost().as_deref().map(String::as_str)))
        });
        let hub = Arc::clone(&self.around.hub);
        self.publish(format!("{name}/Timing"), at(10), false, move |snapshot| {
            Some(world::timing(snapshot?, hub.lost().as_deref().map(String::as_str)))
        });
        self.diagnostics(name.clone());
        self.time_and_frames();
        let on_command = world::on_command(Arc::clone(&self.around.hub));
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|_, _| {
                on_command(message);
                Ok(())
            });
        });
        self.subscribe(format!("{name}/Command/Reset"), world::on_reset(Arc::clone(&self.around.hub)));
        self.subscribe(format!("{name}/Command/Reset/Bodies"), world::on_body_reset(Arc::clone(&self.around.hub)));
        #[cfg(feature = "ros2")]
        if let Some(ros2) = &self.around.ros2 {
            self.served.parameters.worlds.push(name.clone());
            return ros2.serve_world(self.around, &name);
        }
        let ServeContext { hub, steppables, arguments, .. } = self.around;
        let full_name = |service: &str| arguments.mapped(format!("{name}/{service}"));
        self.served.announcements.push(step::service(full_name("step"), hub, steppables));
        if let Some(host) = &self.around.models {
            self.served.announcements.extend(models::services(full_name, host));
        }
        self.served.parameters.world_states.push(full_name("State"));
        self.served.parameters.worlds.push(name);
    }

    /// Reports on the world whose topics begin with `name`, and on devices.
    fn diagnostics(&mut self, name: String) {
        let (hub, extras) = (Arc::clone(&self.around.hub), self.around.extras.clone());
        let (rates, mut lost_before) = (at(diagnostics::FREQUENCY), 0.0);
        self.publish(diagnostics::TOPIC.into(), rates, false, move |snapshot| {
            let lost = hub.lost();
            let lost = lost.as_deref().map(String::as_str);
            Some(diagnostics::message(&name, snapshot?, lost, &mut lost_before, &extras))
        });
    }

    /// `/clock` and `/tf`, where they are wanted.
    fn time_and_frames(&mut self) {
        let Extras { clock, tf, .. } = self.around.extras;
        if clock {
            self.publish("/clock".into(), at(CLOCK_FREQUENCY), false, |snapshot| {
                Some(rosgraph_msgs::Clock { clock: time(snapshot?.stamp) })
            });
        }
        if let (Some(frequency), Some(frames)) = (tf, &self.around.frames) {
            self.publish("/tf".into(), at(frequency), false, frames::source(Arc::clone(frames), clock));
        }
    }

    fn rigid_body(&mut self, info: &ObjectInfo, name: String, index: BodyId, body: &RigidBodyInfo) {
        if let Some(frames) = &self.around.frames {
            frames.insert(index, &name);
        }
        let requests = Arc::<Requests>::default();
        let mut source =
            rigid_body::StateSource::new(index, body.clone(), &info.name, &info.identifier, Arc::clone(&requests));
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| source.message(snapshot?));
        let n_joints = body.joint_names.len().max(body.joints.len());
        self.can_be_stepped(&name, info, Kind::body(index, body, info, &requests));
        let commanded = self.commanded(&name);
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

    fn camera(&mut self, info: &ObjectInfo, name: String, index: CameraId, parameters: &CameraParameters) {
        let (identity, parent) = identity(info, &parameters.parent_name);
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            let snapshot = snapshot?;
            Some(posed::camera_state(&identity, snapshot.cameras.get(index)?, snapshot))
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &posed::camera_command(&message)));
        });
        let object = self.object;
        self.served.parameters.cameras.push(Parameterised { object, name, values: parameters.clone(), parent });
    }

    fn light(&mut self, info: &ObjectInfo, name: String, index: LightId, parameters: &LightParameters) {
        let (identity, parent) = identity(info, &parameters.parent_name);
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            let snapshot = snapshot?;
            Some(posed::light_state(&identity, snapshot.lights.get(index)?, snapshot))
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &posed::light_command(&message)));
        });
        let object = self.object;
        self.served.parameters.lights.push(Parameterised { object, name, values: parameters.clone(), parent });
    }

    fn sensor(&mut self, info: &ObjectInfo, name: String, index: SensorId, sensor: &SensorInfo) {
        self.can_be_stepped(&name, info, Kind::Sensor(index, sensor.clone()));
        let (of, own) = (info.clone(), sensor.clone());
        let state = format!("{name}/State");
        if sensor.kind == SensorType::Contact {
            self.publish(state, info.rates, true, move |snapshot| contact::state(&of, index, &own, snapshot?));
            self.without_effect::<ambf_msgs::ContactSensorCmd>(&name);
        } else {
            self.publish(state, info.rates, true, move |snapshot| sensor::state(&of, index, &own, snapshot?));
            self.without_effect::<ambf_msgs::SensorCmd>(&name);
        }
    }

    /// Listens to commands that only raise the rate at which the object is published.
    fn without_effect<M: FromClient>(&mut self, name: &str) {
        let commanded = self.commanded(name);
        self.subscribe(format!("{name}/Command"), move |_: M| {
            commanded.post(|hub, object| hub.post(object, &SensorCommand));
        });
    }

    fn actuator(&mut self, info: &ObjectInfo, name: String, index: ActuatorId, actuator: &ActuatorInfo) {
        self.can_be_stepped(&name, info, Kind::Actuator(index, actuator.clone()));
        let (of, actuator) = (info.clone(), actuator.clone());
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            actuator::state(&of, index, &actuator, snapshot?)
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| match actuator::command(message) {
            Ok(command) => commanded.post(|hub, object| hub.post(object, &command)),
            Err(why) => {
                commanded.complaints.report(format_args!("{}: {why}", commanded.topic));
            }
        });
    }

    fn vehicle(&mut self, info: &ObjectInfo, name: String, index: VehicleId, vehicle: &VehicleInfo) {
        let (of, wheels, vehicle) = (info.clone(), vehicle.wheels, vehicle.clone());
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            vehicle::state(&of, index, &vehicle, snapshot?)
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|hub, object| hub.post(object, &vehicle::command(&message, wheels)));
        });
    }

    fn soft_body(&mut self, info: &ObjectInfo, name: String, index: SoftBodyId, mass: f64) {
        let of = info.clone();
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            soft_body::state(&of, index, mass, snapshot?)
        });
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.name_unused(soft_body::unused_fields(&message), "a soft body takes a wrench.force");
            commanded.post(|hub, object| hub.post(object, &soft_body::command(&message)));
        });
    }

    fn ghost(&mut self, info: &ObjectInfo, name: String, index: GhostId, ghost: &GhostInfo) {
        self.can_be_stepped(&name, info, Kind::Ghost(index, ghost.clone()));
        let (of, ghost) = (info.clone(), ghost.clone());
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            ghost::state(&of, index, &ghost, snapshot?)
        });
        self.without_effect::<ambf_msgs::GhostObjectCmd>(&name);
    }
}

fn identity(info: &ObjectInfo, parent: &str) -> (Identity, Arc<ParentName>) {
    let parent = ParentName::new(parent);
    let identity =
        Identity { name: info.name.clone(), identifier: info.identifier.clone(), parent: Arc::clone(&parent) };
    (identity, parent)
}
