//! Parameters of cameras, lights and the world: written when the master is there, then polled.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use ambf_core::comm::{CameraParameters, Hub, LightParameters};
use dxr::Value;

use super::link::Link;
use super::naming::graph_name;
use super::objects::Parameterised;
use super::point_cloud::{radius_topic, subscriptions, PointClouds};
use super::signal::Complaints;
use super::xmlrpc::{CallError, Peer};
use crate::report;

/// How often changes are looked for.
const POLL: Duration = Duration::from_secs(2);

/// How often a master that is not there yet is looked for.
const IMPATIENT_POLL: Duration = Duration::from_millis(50);

/// What the parameter server says about one object.
type Tree = BTreeMap<String, Value>;

/// Vertical field of view in place of 0, rad.
const DEFAULT_FIELD_VIEW_ANGLE: f64 = 0.7;

/// Width of an orthographic view in place of 0, m.
const DEFAULT_ORTHOGRAPHIC_WIDTH: f64 = 10.0;

/// Parameters of an object as the server holds them.
trait OnServer: Clone + PartialEq {
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

struct Reader<'a> {
    tree: &'a Tree,
    complaints: Vec<String>,
}

impl Reader<'_> {
    fn number(&mut self, key: &str, target: &mut f64) {
        match self.tree.get(key) {
            Some(Value::Double(x)) if x.is_finite() => *target = *x,
            Some(Value::Integer(i)) => *target = f64::from(*i),
            Some(other) => self.complaints.push(format!("{key}: expected a finite number, found {other:?}")),
            None => (),
        }
    }

    /// `words`: what stands for false and for true.
    fn choice(&mut self, key: &str, words: [&str; 2], target: &mut bool) {
        match self.tree.get(key) {
            Some(Value::String(word)) if word == words[0] => *target = false,
            Some(Value::String(word)) if word == words[1] => *target = true,
            Some(other) => {
                self.complaints.push(format!("{key}: expected \"{}\" or \"{}\", found {other:?}", words[0], words[1]));
            }
            None => (),
        }
    }

    fn parent(&mut self, target: &mut String) {
        match self.tree.get("parent_name") {
            Some(Value::String(name)) if !name.is_empty() => target.clone_from(name),
            Some(Value::String(_)) | None => (),
            Some(other) => self.complaints.push(format!("parent_name: expected text, found {other:?}")),
        }
    }
}

/// One object and what was last complained about, so that a bad value is named once and not every two seconds.
struct Watched<P> {
    object: Parameterised<P>,
    complaints: Vec<String>,
}

impl<P: OnServer> Watched<P> {
    fn write(&mut self, master: &Peer) -> Result<(), CallError> {
        self.object.values.fill_in();
        for (key, value) in self.object.values.values() {
            set(master, &format!("{}/{key}", self.object.name), value)?;
        }
        Ok(())
    }

    /// Takes changes from the server and passes them on to `post`.
    fn poll(
        &mut self,
        master: &Peer,
        post: impl FnOnce(usize, &P) -> Result<(), ambf_core::comm::PostError>,
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
            report!("ROS: parameters of {}: {error}", self.object.name);
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

fn watched<P>(objects: Vec<Parameterised<P>>) -> Vec<Watched<P>> {
    objects.into_iter().map(|object| Watched { object, complaints: Vec::new() }).collect()
}

fn set(master: &Peer, name: &str, value: Value) -> Result<(), CallError> {
    master.call("setParam", vec![Value::String(name.to_owned()), value]).map(|_| ())
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
    topics: Vec<String>,
    complaints: Complaints,
}

impl CloudTopics {
    fn new(world: &str, link: &Link, clouds: &Arc<PointClouds>) -> Self {
        let mut new = Self {
            parameter: format!("{world}/point_cloud_topics"),
            topics: Vec::new(),
            complaints: Complaints::default(),
        };
        new.follow(vec![format!("{world}/point_cloud")], link, clouds);
        new
    }

    fn write(&self, master: &Peer) -> Result<(), CallError> {
        let list = self.topics.iter().map(|topic| Value::String(topic.clone())).collect();
        set(master, &self.parameter, Value::Array(list))
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
                complaints.report(format_args!("parameter {parameter}: expected a list of topics, found {other:?}"));
            }
            None => (),
        }
        Ok(())
    }

    /// Listens to `topics` and to nothing else.
    fn follow(&mut self, topics: Vec<String>, link: &Link, clouds: &Arc<PointClouds>) {
        for gone in self.topics.iter().filter(|topic| !topics.contains(topic)) {
            link.remove(gone);
            link.remove(&radius_topic(gone));
            clouds.remove(gone);
        }
        let mut followed: Vec<String> = self.topics.iter().filter(|topic| topics.contains(topic)).cloned().collect();
        for topic in topics {
            if !followed.contains(&topic) {
                subscriptions(clouds, &topic).into_iter().for_each(|subscription| link.add(subscription));
                followed.push(topic);
            }
        }
        self.topics = followed;
    }
}

/// Everything that is on the parameter server.
pub(super) struct Parameters {
    hub: Arc<Hub>,
    link: Arc<Link>,
    cameras: Vec<Watched<CameraParameters>>,
    lights: Vec<Watched<LightParameters>>,
    worlds: Vec<CloudTopics>,
    clouds: Arc<PointClouds>,
}

impl Parameters {
    /// Parameters of `cameras`, `lights` and of the `worlds` (`/<namespace>/World`).
    pub fn new(
        hub: Arc<Hub>,
        link: Arc<Link>,
        cameras: Vec<Parameterised<CameraParameters>>,
        lights: Vec<Parameterised<LightParameters>>,
        worlds: Vec<String>,
        clouds: Arc<PointClouds>,
    ) -> Self {
        let worlds = worlds.iter().map(|world| CloudTopics::new(world, &link, &clouds)).collect();
        Self { hub, link, cameras: watched(cameras), lights: watched(lights), worlds, clouds }
    }

    /// Writes and polls until the link is stopped. A master that does not answer is the link's business to report.
    pub fn run(mut self) {
        let mut written = 0;
        loop {
            let generation = self.link.generation();
            let master = self.link.master();
            if generation != written {
                if self.write(&master).is_ok() {
                    written = generation;
                }
            } else if generation != 0 {
                let _ = self.poll(&master);
            }
            let wait = if generation == 0 { IMPATIENT_POLL } else { POLL };
            if self.link.stop.wait(wait) {
                return;
            }
        }
    }

    fn write(&mut self, master: &Peer) -> Result<(), CallError> {
        self.worlds.iter().try_for_each(|world| world.write(master))?;
        self.cameras.iter_mut().try_for_each(|camera| camera.write(master))?;
        self.lights.iter_mut().try_for_each(|light| light.write(master))
    }

    fn poll(&mut self, master: &Peer) -> Result<(), CallError> {
        let hub = &self.hub;
        for world in &mut self.worlds {
            world.poll(master, &self.link, &self.clouds)?;
        }
        for camera in &mut self.cameras {
            camera.poll(master, |object, values| hub.post(object, values))?;
        }
        for light in &mut self.lights {
            light.poll(master, |object, values| hub.post(object, values))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
