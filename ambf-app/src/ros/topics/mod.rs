//! The topics of one object: what is published, what is listened to. A file a type of object has its messages.

pub(super) mod actuator;
pub(super) mod contact;
pub(super) mod ghost;
pub(super) mod posed;
pub(super) mod rigid_body;
pub(super) mod sensor;
mod soft_body;
mod vehicle;
mod volume;
mod world;

use std::sync::Arc;

use ambf_core::comm::{Hub, HubIndex, ObjectInfo, ObjectKind, PostError, Rates, SensorCommand, Snapshot};
use ros_node::{Announcement, Publication};
use rosrust::Message;

use super::arguments::RosArguments;
use super::frames::Frames;
use super::models::ModelHost;
use super::parameters::ParameterChange;
use super::received::{self, FromClient};
use super::recordings::RecordHost;
use super::scheduler::{is_live, Entry, Outlet, StateOutlet, Watch};
use super::signal::{OnceLog, RateLimitedLog, Waker};
use super::step::{Kind, Steppable, Steppables};
use super::Extras;
use crate::report;

/// Longest command, bytes: some hundred thousand joints.
const MAX_COMMAND: usize = 1 << 20;

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
        match post(&self.hub, self.object) {
            // Said once, for all topics.
            Err(PostError::Replaying) => (),
            Err(error) => {
                self.complaints.report(format_args!("{}: {error}", self.topic));
            }
            Ok(()) if !was_live => self.waker.wake(),
            Ok(()) => (),
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
    /// Who begins and ends recordings; without one there are no services.
    pub recordings: Option<Arc<dyn RecordHost>>,
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
        self.publish_as(topic, rates, (commanded, false), message);
    }

    /// Publishes on `topic` what is new, for subscribers that come later too; `rates`: how often that is looked for.
    fn publish_latched<M: Message>(
        &mut self,
        topic: String,
        rates: Rates,
        message: impl FnMut(Option<&Snapshot>) -> Option<M> + Send + 'static,
    ) {
        self.publish_as(topic, rates, (false, true), message);
    }

    /// Publishes on `topic`; what tells whether anybody listens, unless there can be no such topic.
    fn publish_as<M: Message>(
        &mut self,
        topic: String,
        rates: Rates,
        (commanded, is_latched): (bool, bool),
        message: impl FnMut(Option<&Snapshot>) -> Option<M> + Send + 'static,
    ) -> Option<Watch> {
        let outlet = self.outlet(self.around.arguments.mapped(topic), rates, is_latched, message)?;
        let watch = outlet.watch();
        self.served.entries.push(Entry::new(outlet, rates, self.object, commanded, self.around.hub.now()));
        Some(watch)
    }

    #[cfg_attr(not(feature = "ros2"), allow(unused_variables, reason = "rates are those of ROS 2's windows"))]
    fn outlet<M: Message>(
        &mut self,
        topic: String,
        rates: Rates,
        is_latched: bool,
        message: impl FnMut(Option<&Snapshot>) -> Option<M> + Send + 'static,
    ) -> Option<Box<dyn Outlet>> {
        #[cfg(feature = "ros2")]
        if let Some(ros2) = &self.around.ros2 {
            return ros2.publish(&topic, rates, is_latched, message);
        }
        let publication = if is_latched { Publication::latched(topic) } else { Publication::new(topic) };
        self.served.announcements.push(Arc::clone(&publication) as Arc<dyn Announcement>);
        Some(Box::new(StateOutlet { publication, is_latched, message }))
    }

    fn subscribe<M: FromClient>(&mut self, topic: String, on_message: impl FnMut(M) + Send + 'static) {
        #[cfg(feature = "ros2")]
        if let Some(ros2) = &self.around.ros2 {
            return ros2.subscribe(&self.around.arguments.mapped(topic), MAX_COMMAND, on_message);
        }
        let topic = self.around.arguments.mapped(topic);
        let subscription = received::subscription(topic, MAX_COMMAND, on_message);
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

    /// Listens to commands that only raise the rate at which the object is published.
    fn without_effect<M: FromClient>(&mut self, name: &str) {
        let commanded = self.commanded(name);
        self.subscribe(format!("{name}/Command"), move |_: M| {
            commanded.post(|hub, object| hub.post(object, &SensorCommand));
        });
    }
}
