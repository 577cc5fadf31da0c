//! Parameters of cameras, lights and the world, which clients read from the object's node and set there.

use std::sync::Arc;

use ambf_core::comm::{Command, Hub};
use dxr::Value as Ros1Value;
use parking_lot::Mutex;
use ros2_node::names::{check_topic, NameError, MAX_TOPIC};
use ros2_node::{Node, Parameter, Parameters, Subscription, Value};

use super::super::parameters::{OnServer, Parameterised, Tree};
use super::super::point_cloud::{listeners, radius_topic, PointClouds, MAX_CLOUD, MAX_RADIUS};
use super::transport::{subscription, Failure};

/// An object whose parameters are offered.
pub(super) struct Offered<P> {
    hub: Arc<Hub>,
    object: Mutex<Parameterised<P>>,
}

impl<P: OnServer> Offered<P> {
    /// Changes are left with `hub`.
    pub fn new(hub: &Arc<Hub>, mut object: Parameterised<P>) -> Arc<Self> {
        object.values.fill_in();
        Arc::new(Self { hub: Arc::clone(hub), object: Mutex::new(object) })
    }
}

impl<P: OnServer + Command> Parameters for Offered<P> {
    fn all(&self) -> Vec<Parameter> {
        let object = self.object.lock();
        let parameter = |(key, value): (&str, _)| Parameter {
            name: format!("{}/{key}", object.name),
            value: from_ros1(value),
            description: String::new(),
            // There is only one type of light.
            read_only: key == "type",
        };
        object.values.values().into_iter().map(parameter).collect()
    }

    fn set(&self, name: &str, value: &Value) -> Result<(), String> {
        let mut object = self.object.lock();
        let key = name.strip_prefix(&object.name).and_then(|rest| rest.strip_prefix('/')).unwrap_or(name);
        let value = to_ros1(value).ok_or_else(|| format!("{key}: expected a number or text"))?;
        let mut values = object.values.clone();
        let complaints = values.update(&Tree::from([(key.to_owned(), value)]));
        if let Some(complaint) = complaints.into_iter().next() {
            return Err(complaint);
        }
        values.fill_in();
        self.hub.post(object.object, &values).map_err(|error| error.to_string())?;
        object.parent.set(values.parent_name());
        object.values = values;
        Ok(())
    }
}

/// Clouds of points that a world listens to, at most: each is two topics and their memory.
const MAX_CLOUDS: usize = 100;

/// Why a list of topics is of no use.
#[derive(Debug, thiserror::Error)]
enum CloudError {
    /// Error when the value is no list of texts.
    #[error("expected a list of names of topics")]
    NoList,
    /// Error when there are too many.
    #[error("{0} topics are more than {MAX_CLOUDS}")]
    Many(usize),
    /// Error when one is no name of a topic.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Error when one cannot be listened to.
    #[error("{0}")]
    Topic(Failure),
}

/// The parameter of a world: topics with clouds of points that are drawn.
pub(super) struct CloudTopics {
    clouds: Arc<PointClouds>,
    node: Node,
    /// Its name.
    parameter: String,
    followed: Mutex<Vec<Followed>>,
}

/// A topic that is listened to.
struct Followed {
    topic: String,
    _subscriptions: [Subscription; 2],
}

impl CloudTopics {
    /// Of the world called `world` on `node`: it listens to its topic `point_cloud` until it is told otherwise.
    pub fn new(clouds: &Arc<PointClouds>, node: &Node, world: &str) -> Result<Arc<Self>, Failure> {
        let own = Self {
            clouds: Arc::clone(clouds),
            node: node.clone(),
            parameter: format!("{world}/point_cloud_topics"),
            followed: Mutex::default(),
        };
        own.follow(&[format!("{world}/point_cloud")])?;
        Ok(Arc::new(own))
    }

    /// Listens to `topics` and to nothing else; to what it did before if that is not possible.
    fn follow(&self, topics: &[String]) -> Result<(), CloudError> {
        if topics.len() > MAX_CLOUDS {
            return Err(CloudError::Many(topics.len()));
        }
        let longest = MAX_TOPIC - radius_topic("").len();
        for topic in topics {
            check_topic(topic)?;
            if topic.len() > longest {
                return Err(NameError::Long { name: topic.clone(), longest }.into());
            }
        }
        let mut followed = self.followed.lock();
        let mut come: Vec<Followed> = Vec::new();
        for topic in topics {
            if followed.iter().chain(&come).all(|known| known.topic != *topic) {
                come.push(self.listen(topic).map_err(CloudError::Topic)?);
            }
        }
        for gone in followed.extract_if(.., |known| !topics.contains(&known.topic)) {
            self.clouds.remove(&gone.topic);
        }
        followed.extend(come);
        Ok(())
    }

    fn listen(&self, topic: &str) -> Result<Followed, Failure> {
        let (on_points, on_radius) = listeners(&self.clouds, topic);
        let made = subscription(&self.node, topic, MAX_CLOUD, on_points)
            .and_then(|points| Ok([points, subscription(&self.node, &radius_topic(topic), MAX_RADIUS, on_radius)?]));
        if made.is_err() {
            self.clouds.remove(topic);
        }
        Ok(Followed { topic: topic.to_owned(), _subscriptions: made? })
    }
}

impl Drop for CloudTopics {
    fn drop(&mut self) {
        for followed in self.followed.get_mut().drain(..) {
            self.clouds.remove(&followed.topic);
        }
    }
}

impl Parameters for CloudTopics {
    fn all(&self) -> Vec<Parameter> {
        vec![Parameter {
            name: self.parameter.clone(),
            value: Value::Texts(self.followed.lock().iter().map(|followed| followed.topic.clone()).collect()),
            description: "topics of sensor_msgs/msg/PointCloud that are drawn".into(),
            read_only: false,
        }]
    }

    fn set(&self, name: &str, value: &Value) -> Result<(), String> {
        let topics = if let Value::Texts(topics) = value { Ok(topics) } else { Err(CloudError::NoList) };
        topics.and_then(|topics| self.follow(topics)).map_err(|error| format!("{name}: {error}"))
    }
}

/// The parameters of the node that is the program: those that the command line gives it.
pub(super) struct Given(Mutex<Vec<(String, Value)>>);

impl Given {
    /// Those in `all` that have a value.
    pub fn new(all: &[(String, Ros1Value)]) -> Arc<Self> {
        let values = all.iter().filter_map(|(name, value)| Some((name.clone(), from_command_line(value)?)));
        Arc::new(Self(Mutex::new(values.collect())))
    }
}

impl Parameters for Given {
    fn all(&self) -> Vec<Parameter> {
        let parameter = |(name, value): &(String, Value)| Parameter {
            name: name.clone(),
            value: value.clone(),
            description: "given on the command line".into(),
            read_only: false,
        };
        self.0.lock().iter().map(parameter).collect()
    }

    fn set(&self, name: &str, value: &Value) -> Result<(), String> {
        self.0.lock().iter_mut().filter(|(own, _)| own == name).for_each(|(_, own)| own.clone_from(value));
        Ok(())
    }
}

/// A value of the command line; a list is written `[a, b]`. `None` for what ROS 2 does not have.
pub(super) fn from_command_line(value: &Ros1Value) -> Option<Value> {
    let list = |text: &str| {
        let inner = text.strip_prefix('[')?.strip_suffix(']')?;
        let bare = |item: &str| item.trim().trim_matches(['"', '\'']).to_owned();
        Some(Value::Texts(inner.split(',').map(bare).filter(|item| !item.is_empty()).collect()))
    };
    match value {
        Ros1Value::String(text) => list(text).or_else(|| Some(Value::Text(text.clone()))),
        other => Some(from_ros1(other.clone())).filter(|value| *value != Value::NotSet),
    }
}

fn from_ros1(value: Ros1Value) -> Value {
    match value {
        Ros1Value::Double(number) => Value::Double(number),
        Ros1Value::Integer(number) => Value::Integer(number.into()),
        Ros1Value::Boolean(truth) => Value::Bool(truth),
        Ros1Value::String(text) => Value::Text(text),
        _ => Value::NotSet,
    }
}

fn to_ros1(value: &Value) -> Option<Ros1Value> {
    Some(match value {
        Value::Double(number) => Ros1Value::Double(*number),
        Value::Integer(number) => Ros1Value::Double(*number as f64),
        Value::Text(text) => Ros1Value::String(text.clone()),
        _ => return None,
    })
}
