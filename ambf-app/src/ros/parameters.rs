//! Parameters of cameras, lights and the world: written when the master is there, then polled; deleted when their
//! object goes.

use std::collections::{BTreeMap, HashSet};
use std::sync::mpsc::Receiver;
use std::sync::Arc;
use std::time::Duration;

use ambf_core::comm::{CameraParameters, Hub, HubIndex, LightParameters, PostError};
use dxr::Value;
use ros_node::{Announcement, CallError, Link, Peer};

use super::frames::Frames;
use super::naming::graph_name;
use super::neighbours::Neighbours;
use super::point_cloud::{subscriptions, PointClouds};
use super::signal::RateLimitedLog;
use super::topics::posed::ParentName;
use crate::report;

/// How often changes are looked for.
const POLL: Duration = Duration::from_secs(2);

/// How often a master that is not there yet is looked for.
const IMPATIENT_POLL: Duration = Duration::from_millis(50);

/// What the parameter server says about one object.
pub(super) type Tree = BTreeMap<String, Value>;

/// Vertical field of view in place of 0, rad.
const DEFAULT_FIELD_VIEW_ANGLE: f64 = 0.7;

/// Width of an orthographic view in place of 0, m.
const DEFAULT_ORTHOGRAPHIC_WIDTH: f64 = 10.0;

/// An object whose parameters are on the parameter server.
pub(super) struct Parameterised<P> {
    /// Position in the hub.
    pub object: HubIndex,
    /// `/<namespace>/<name>`.
    pub name: String,
    /// Values in force.
    pub values: P,
    /// Shown in the object's state.
    pub parent: Arc<ParentName>,
}

/// Objects with parameters that come, and objects that go.
#[derive(Default)]
pub(super) struct ParameterChange {
    pub cameras: Vec<Parameterised<CameraParameters>>,
    pub lights: Vec<Parameterised<LightParameters>>,
    /// `/<namespace>/World`.
    pub worlds: Vec<String>,
    /// Topics with their states.
    pub world_states: Vec<String>,
    /// Positions in the hub, with or without parameters.
    pub removed: Vec<HubIndex>,
}

/// Parameters of an object as the server holds them.
pub(super) trait OnServer: Clone + PartialEq {
    /// Name and value of each.
    fn values(&self) -> Vec<(&'static str, Value)>;

    /// Takes what `tree` says; what is missing keeps its value. Returns a sentence for each value that cannot be used.
    fn update(&mut self, tree: &Tree) -> Vec<String>;

    /// Replaces 0 where it means "choose one".
    fn fill_in(&mut self) {}

    /// Text that names the parent.
    fn parent_name(&self) -> &str;
}

impl OnServer for CameraParameters {
    fn values(&self) -> Vec<(&'static str, Value)> {
        let mut values: Vec<(&'static str, Value)> = vec![
            ("near_plane", Value::Double(self.near_plane)),
            ("far_plane", Value::Double(self.far_plane)),
            ("field_view_angle", Value::Double(self.field_view_angle)),
            ("orthographic_view_width", Value::Double(self.orthographic_view_width)),
            ("stereo_eye_separation", Value::Double(self.stereo_eye_separation)),
            ("stereo_focal_length", Value::Double(self.stereo_focal_length)),
        ];
        let words = [
            ("projection", if self.orthographic { "ORTHOGRAPHIC" } else { "PERSPECTIVE" }),
            ("mode", if self.stereo { "STEREO" } else { "MONO" }),
            ("parent_name", self.parent_name.as_str()),
        ];
        values.extend(words.map(|(name, word)| (name, Value::String(word.to_owned()))));
        values
    }

    fn update(&mut self, tree: &Tree) -> Vec<String> {
        let mut reader = Reader { tree, complaints: Vec::new() };
        reader.number("near_plane", &mut self.near_plane);
        reader.number("far_plane", &mut self.far_plane);
        reader.number("field_view_angle", &mut self.field_view_angle);
        reader.number("orthographic_view_width", &mut self.orthographic_view_width);
        reader.number("stereo_eye_separation", &mut self.stereo_eye_separation);
        reader.number("stereo_focal_length", &mut self.stereo_focal_length);
        reader.choice("projection", ["PERSPECTIVE", "ORTHOGRAPHIC"], &mut self.orthographic);
        reader.choice("mode", ["MONO", "STEREO"], &mut self.stereo);
        reader.parent(&mut self.parent_name);
        reader.complaints
    }

    fn fill_in(&mut self) {
        if !self.orthographic && self.field_view_angle == 0.0 {
            self.field_view_angle = DEFAULT_FIELD_VIEW_ANGLE;
        }
        if self.orthographic && self.orthographic_view_width == 0.0 {
            self.orthographic_view_width = DEFAULT_ORTHOGRAPHIC_WIDTH;
        }
    }

    fn parent_name(&self) -> &str {
        &self.parent_name
    }
}

impl OnServer for LightParameters {
    fn values(&self) -> Vec<(&'static str, Value)> {
        vec![
            ("cutoff_angle", Value::Double(self.cutoff_angle)),
            ("parent_name", Value::String(self.parent_name.clone())),
            // There is only one type.
            ("type", Value::String("SPOT".into())),
        ]
    }

    fn update(&mut self, tree: &Tree) -> Vec<String> {
        let mut reader = Reader { tree, complaints: Vec::new() };
        reader.number("cutoff_angle", &mut self.cutoff_angle);
        reader.parent(&mut self.parent_name);
        reader.complaints
    }

    fn parent_name(&self) -> &str {
        &self.parent_name
    }
}

/// A value of a parameter, as its user would write it.
fn words(value: &Value) -> String {
    match value {
        Value::Integer(number) => number.to_string(),
        Value::Boolean(truth) => truth.to_string(),
        Value::Double(number) => format!("{number:?}"),
        Value::String(text) => format!("\"{text}\""),
        Value::Array(list) => format!("a list of {} values", list.len()),
        Value::Struct(_) => "a mapping".to_owned(),
        _ => "a value of another type".to_owned(),
    }
}

struct Reader<'a> {
    tree: &'a Tree,
    complaints: Vec<String>,
}

impl Reader<'_> {
    fn number(&mut self, key: &str, target: &mut f64) {
        match self.tree.get(key) {
            Some(Value::Double(x)) if x.is_finite() => *target = *x,
            Some(Value::Integer(i)) => *target = f64::from(*i),
            Some(other) => self.complaints.push(format!("{key}: expected a finite number, found {}", words(other))),
            None => (),
        }
    }

    /// `choices`: what stands for false and for true.
    fn choice(&mut self, key: &str, choices: [&str; 2], target: &mut bool) {
        match self.tree.get(key) {
            Some(Value::String(word)) if word == choices[0] => *target = false,
            Some(Value::String(word)) if word == choices[1] => *target = true,
            Some(other) => {
                let [no, yes] = choices;
                self.complaints.push(format!("{key}: expected \"{no}\" or \"{yes}\", found {}", words(other)));
            }
            None => (),
        }
    }

    fn parent(&mut self, target: &mut String) {
        match self.tree.get("parent_name") {
            Some(Value::String(name)) if !name.is_empty() => target.clone_from(name),
            Some(Value::String(_)) | None => (),
            Some(other) => self.complaints.push(format!("parent_name: expected text, found {}", words(other))),
        }
    }
}

/// One object on the server.
struct Watched<P> {
    object: Parameterised<P>,
    /// Generation of the link in which it was last written; 0 before.
    written: u64,
    /// What was last complained about, so that a bad value is named once and not every two seconds.
    complaints: Vec<String>,
}

impl<P: OnServer> Watched<P> {
    fn new(object: Parameterised<P>) -> Self {
        Self { object, written: 0, complaints: Vec::new() }
    }

    /// Names of its parameters.
    fn keys(&self) -> impl Iterator<Item = String> + '_ {
        self.object.values.values().into_iter().map(|(key, _)| format!("{}/{key}", self.object.name))
    }

    fn write(&mut self, master: &Peer) -> Result<(), CallError> {
        self.object.values.fill_in();
        for (key, value) in self.object.values.values() {
            set(master, &format!("{}/{key}", self.object.name), value)?;
        }
        Ok(())
    }

    /// Writes to a server that does not hold the parameters yet, takes changes from one that does.
    fn visit(
        &mut self,
        master: &Peer,
        generation: u64,
        post: impl FnOnce(HubIndex, &P) -> Result<(), PostError>,
    ) -> Result<(), CallError> {
        if self.written == generation {
            return self.poll(master, post);
        }
        self.write(master)?;
        self.written = generation;
        Ok(())
    }

    /// Takes changes from the server and passes them on to `post`.
    fn poll(
        &mut self,
        master: &Peer,
        post: impl FnOnce(HubIndex, &P) -> Result<(), PostError>,
    ) -> Result<(), CallError> {
        let Some(Value::Struct(tree)) = get(master, &self.object.name)? else { return Ok(()) };
        let mut values = self.object.values.clone();
        let complaints = values.update(&tree);
        for complaint in complaints.iter().filter(|c| !self.complaints.contains(c)) {
            report!("ROS: parameter {}/{complaint}; it is ignored", self.object.name);
        }
        self.complaints = complaints;
        if values == self.object.values {
            return Ok(());
        }
        let asked_for = values.clone();
        values.fill_in();
        if let Err(error) = post(self.object.object, &values) {
            // That a recording is replayed is said once, for all.
            if error != PostError::Replaying {
                report!("ROS: parameters of {}: {error}", self.object.name);
            }
            return Ok(());
        }
        self.object.parent.set(values.parent_name());
        self.object.values = values;
        if self.object.values != asked_for {
            self.write(master)?;
        }
        Ok(())
    }
}

fn set(master: &Peer, name: &str, value: Value) -> Result<(), CallError> {
    master.call("setParam", vec![Value::String(name.to_owned()), value]).map(|_| ())
}

/// Deletes the parameter `name`, and the namespace above it when nothing else is in it.
fn delete(master: &Peer, name: &str) -> Result<(), CallError> {
    let call = |name: &str| match master.call("deleteParam", vec![Value::String(name.to_owned())]) {
        // It was deleted by somebody else.
        Err(error) if error.is_refusal() => Ok(()),
        result => result.map(|_| ()),
    };
    call(name)?;
    let Some((namespace, _)) = name.rsplit_once('/').filter(|(namespace, _)| !namespace.is_empty()) else {
        return Ok(());
    };
    match get(master, namespace)? {
        Some(Value::Struct(rest)) if rest.is_empty() => call(namespace),
        _ => Ok(()),
    }
}

/// `None` when the parameter does not exist.
fn get(master: &Peer, name: &str) -> Result<Option<Value>, CallError> {
    match master.call("getParam", vec![Value::String(name.to_owned())]) {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.is_refusal() => Ok(None),
        Err(error) => Err(error),
    }
}

/// The point clouds of one world: the list on the server is authoritative.
struct CloudTopics {
    /// `/<namespace>/World/point_cloud_topics`.
    parameter: String,
    topics: Vec<(String, [Arc<dyn Announcement>; 2])>,
    /// Generation of the link in which the list was last written; 0 before.
    written: u64,
    complaints: RateLimitedLog,
}

impl CloudTopics {
    fn new(world: &str, link: &Link, clouds: &Arc<PointClouds>) -> Self {
        let mut new = Self {
            parameter: format!("{world}/point_cloud_topics"),
            topics: Vec::new(),
            written: 0,
            complaints: RateLimitedLog::default(),
        };
        new.follow(vec![format!("{world}/point_cloud")], link, clouds);
        new
    }

    fn write(&self, master: &Peer) -> Result<(), CallError> {
        let list = self.topics.iter().map(|(topic, _)| Value::String(topic.clone())).collect();
        set(master, &self.parameter, Value::Array(list))
    }

    /// Writes to a server that does not hold the list yet, follows one that does.
    fn visit(
        &mut self,
        master: &Peer,
        generation: u64,
        link: &Link,
        clouds: &Arc<PointClouds>,
    ) -> Result<(), CallError> {
        if self.written == generation {
            return self.poll(master, link, clouds);
        }
        self.write(master)?;
        self.written = generation;
        Ok(())
    }

    fn poll(&mut self, master: &Peer, link: &Link, clouds: &Arc<PointClouds>) -> Result<(), CallError> {
        match get(master, &self.parameter)? {
            Some(Value::Array(list)) => {
                let names = list.iter().filter_map(|item| match item {
                    Value::String(topic) if !topic.trim_matches('/').is_empty() => Some(graph_name(&[topic]).0),
                    _ => None,
                });
                self.follow(names.collect(), link, clouds);
            }
            Some(other) => {
                let (parameter, complaints) = (&self.parameter, &self.complaints);
                complaints
                    .report(format_args!("parameter {parameter}: expected a list of topics, found {}", words(&other)));
            }
            None => (),
        }
        Ok(())
    }

    /// Listens to `topics` and to nothing else.
    fn follow(&mut self, topics: Vec<String>, link: &Link, clouds: &Arc<PointClouds>) {
        for (gone, subscriptions) in self.topics.extract_if(.., |(topic, _)| !topics.contains(topic)) {
            link.remove(&subscriptions);
            clouds.remove(&gone);
        }
        for topic in topics {
            if self.topics.iter().all(|(followed, _)| *followed != topic) {
                let subscriptions = subscriptions(clouds, &topic);
                link.add(subscriptions.clone());
                self.topics.push((topic, subscriptions));
            }
        }
    }
}

/// The parameter with the URDF of what is loaded, for rviz and its like.
pub(super) struct DescriptionParameter {
    name: String,
    frames: Arc<Frames>,
    /// Generation of the link in which it was last written, and which description it was.
    written: (u64, u64),
}

impl DescriptionParameter {
    pub fn new(name: String, frames: Arc<Frames>) -> Self {
        Self { name, frames, written: (0, 0) }
    }

    /// Writes to a server that does not hold the newest description yet.
    fn visit(&mut self, master: &Peer, generation: u64) -> Result<(), CallError> {
        let described = self.frames.described();
        let newest = (generation, described.count);
        if described.count != 0 && self.written != newest {
            set(master, &self.name, Value::String(described.robot.urdf.clone()))?;
            self.written = newest;
        }
        Ok(())
    }
}

/// Everything that is on the parameter server.
pub(super) struct Parameters {
    hub: Arc<Hub>,
    link: Arc<Link>,
    changes: Receiver<ParameterChange>,
    cameras: Vec<Watched<CameraParameters>>,
    lights: Vec<Watched<LightParameters>>,
    worlds: Vec<CloudTopics>,
    /// Topics with the states of the worlds.
    world_states: Vec<String>,
    neighbours: Neighbours,
    /// Parameters of objects that are gone, still to be deleted.
    gone: Vec<String>,
    clouds: Arc<PointClouds>,
    description: Option<DescriptionParameter>,
}

impl Parameters {
    /// Parameters of the objects that come through `changes`.
    pub fn new(
        hub: Arc<Hub>,
        link: Arc<Link>,
        changes: Receiver<ParameterChange>,
        clouds: Arc<PointClouds>,
        description: Option<DescriptionParameter>,
    ) -> Self {
        let (cameras, lights, worlds, world_states, neighbours, gone) = Default::default();
        Self { hub, link, changes, cameras, lights, worlds, world_states, neighbours, gone, clouds, description }
    }

    /// Writes and polls until the link is stopped. A master that does not answer is the link's business to report.
    pub fn run(mut self) {
        loop {
            while let Ok(change) = self.changes.try_recv() {
                self.take(change);
            }
            let generation = self.link.generation();
            if generation != 0 {
                let master = self.link.master();
                let _ = self.visit(&master, generation);
                let _ = self.neighbours.look(&master, master.caller(), &self.world_states);
            }
            let wait = if generation == 0 { IMPATIENT_POLL } else { POLL };
            if self.link.stop.wait(wait) {
                return;
            }
        }
    }

    fn take(&mut self, change: ParameterChange) {
        self.gone.extend(remove(&mut self.cameras, &change.removed));
        self.gone.extend(remove(&mut self.lights, &change.removed));
        self.cameras.extend(change.cameras.into_iter().map(Watched::new));
        self.lights.extend(change.lights.into_iter().map(Watched::new));
        for world in &change.worlds {
            self.worlds.push(CloudTopics::new(world, &self.link, &self.clouds));
        }
        self.world_states.extend(change.world_states);
        // What has another owner now is overwritten, not deleted.
        let of_cameras = self.cameras.iter().flat_map(Watched::keys);
        let owned: HashSet<String> = of_cameras.chain(self.lights.iter().flat_map(Watched::keys)).collect();
        self.gone.retain(|key| !owned.contains(key));
    }

    fn visit(&mut self, master: &Peer, generation: u64) -> Result<(), CallError> {
        let hub = &self.hub;
        while let Some(key) = self.gone.last() {
            delete(master, key)?;
            self.gone.pop();
        }
        if let Some(description) = &mut self.description {
            description.visit(master, generation)?;
        }
        for world in &mut self.worlds {
            world.visit(master, generation, &self.link, &self.clouds)?;
        }
        for camera in &mut self.cameras {
            camera.visit(master, generation, |object, values| hub.post(object, values))?;
        }
        for light in &mut self.lights {
            light.visit(master, generation, |object, values| hub.post(object, values))?;
        }
        Ok(())
    }
}

/// Removes the objects at the positions `removed`; returns the names of their parameters.
fn remove<P: OnServer>(objects: &mut Vec<Watched<P>>, removed: &[HubIndex]) -> Vec<String> {
    let gone: Vec<Watched<P>> = objects.extract_if(.., |watched| removed.contains(&watched.object.object)).collect();
    gone.iter().flat_map(Watched::keys).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros_node::{LinkOptions, NodeName, OwnMaster};

    fn tree(values: Vec<(&str, Value)>) -> Tree {
        values.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
    }

    #[test]
    fn what_is_written_is_read_back() {
        let camera = CameraParameters {
            near_plane: 0.1,
            far_plane: 10.0,
            field_view_angle: 0.8,
            orthographic: true,
            stereo: true,
            parent_name: "BODY base".into(),
            ..Default::default()
        };
        let mut copy = CameraParameters::default();
        assert!(copy.update(&tree(camera.values())).is_empty());
        assert_eq!(copy, camera);
        let light = LightParameters { cutoff_angle: 0.5, parent_name: "x".into() };
        let mut copy = LightParameters::default();
        assert!(copy.update(&tree(light.values())).is_empty());
        assert_eq!(copy, light);
    }

    #[test]
    fn values_are_said_as_they_were_written() {
        let said = |value: Value| words(&value);
        assert_eq!(said(Value::String("a".into())), "\"a\"");
        assert_eq!((said(Value::Integer(3)), said(Value::Double(1e300))), ("3".into(), "1e300".into()));
        assert_eq!(said(Value::Array(vec![Value::Boolean(true)])), "a list of 1 values");
    }

    #[test]
    fn bad_values_are_named_and_change_nothing() {
        let before = CameraParameters { near_plane: 0.1, stereo: true, parent_name: "p".into(), ..Default::default() };
        let mut camera = before.clone();
        let complaints = camera.update(&tree(vec![
            ("near_plane", Value::Double(f64::NAN)),
            ("far_plane", Value::String("far".into())),
            ("mode", Value::String("QUAD".into())),
            ("parent_name", Value::String(String::new())),
            ("something_else", Value::Integer(1)),
        ]));
        assert_eq!(camera, before);
        assert_eq!(complaints.len(), 3, "{complaints:?}");
        assert!(complaints[2].contains("MONO") && complaints[2].contains("QUAD"), "{complaints:?}");
    }

    #[test]
    fn integers_are_numbers_and_zero_is_filled_in() {
        let mut camera = CameraParameters { field_view_angle: 0.8, ..Default::default() };
        camera.update(&tree(vec![("far_plane", Value::Integer(20)), ("field_view_angle", Value::Integer(0))]));
        camera.fill_in();
        assert_eq!((camera.far_plane, camera.field_view_angle, camera.orthographic_view_width), (20.0, 0.7, 0.0));
    }

    #[test]
    fn what_belonged_to_one_that_is_gone_is_deleted_unless_another_has_it_now() {
        let master = Peer::new("http://localhost:1/", "/test", Duration::from_millis(1)).unwrap();
        let (sender, changes) = std::sync::mpsc::channel();
        let hub = Arc::new(Hub::new(Vec::new()));
        let link = Link::new(LinkOptions {
            master: master.clone(),
            name: NodeName::Anonymous("test".into()),
            own_master: OwnMaster::None,
            parameters: Vec::new(),
            report: ros_node::silent(),
        })
        .unwrap();
        let mut parameters = Parameters::new(hub, Arc::new(link), changes, Arc::default(), None);
        let light = |object, name: &str| {
            let (values, parent) = (LightParameters::default(), ParentName::new(""));
            Parameterised { object: HubIndex(object), name: name.into(), values, parent }
        };
        let lights = vec![light(0, "/e/a"), light(1, "/e/b"), light(2, "/e/b")];
        parameters.take(ParameterChange { lights, ..Default::default() });
        parameters.take(ParameterChange { removed: [0, 1, 7].map(HubIndex).into(), ..Default::default() });
        assert_eq!(parameters.gone, ["/e/a/cutoff_angle", "/e/a/parent_name", "/e/a/type"], "/e/b is the third's too");
        assert_eq!(parameters.lights.len(), 1);
        assert!(parameters.visit(&master, 1).is_err(), "nobody answers");
        assert_eq!(parameters.gone.len(), 3, "they are tried again");
        parameters.take(ParameterChange { lights: vec![light(8, "/e/a")], ..Default::default() });
        assert!(parameters.gone.is_empty());
        drop(sender);
    }
}
