//! Point clouds that clients publish for display.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use ros_node::Announcement;

use super::messages::{sensor_msgs, std_msgs};
use super::received::subscription;

/// Size of points until a client says otherwise, pixels.
const DEFAULT_RADIUS: f32 = 10.0;

/// The newest cloud of one topic.
#[derive(Debug, Clone, PartialEq)]
pub struct PointCloud {
    /// Text that names the rigid body in whose body frame the points are: its qualified identifier, or a part that only
    /// one has. Not looked up here; empty, unknown or ambiguous means the world.
    pub frame_id: String,
    /// (n x 3) in that frame, m; points with a coordinate that is not finite are left out.
    pub points: Vec<[f32; 3]>,
    /// Size of a point, pixels. Default: 10.
    pub radius: f32,
}

impl Default for PointCloud {
    fn default() -> Self {
        Self { frame_id: String::new(), points: Vec::new(), radius: DEFAULT_RADIUS }
    }
}

/// The newest cloud of a topic.
#[derive(Debug, Default)]
struct Newest {
    cloud: Arc<PointCloud>,
    /// How many versions of ROS listen to it.
    listeners: usize,
}

/// The newest cloud of every topic that is listened to.
#[derive(Debug, Default)]
pub struct PointClouds(Mutex<BTreeMap<String, Newest>>);

impl PointClouds {
    /// Topic and cloud of each, sorted by topic.
    pub fn all(&self) -> Vec<(String, Arc<PointCloud>)> {
        self.0.lock().iter().map(|(topic, newest)| (topic.clone(), Arc::clone(&newest.cloud))).collect()
    }

    fn insert(&self, topic: &str) {
        self.0.lock().entry(topic.to_owned()).or_default().listeners += 1;
    }

    /// Nothing happens to a topic that has been removed: a message may still be on its way.
    fn change(&self, topic: &str, change: impl FnOnce(&mut PointCloud)) {
        if let Some(newest) = self.0.lock().get_mut(topic) {
            change(Arc::make_mut(&mut newest.cloud));
        }
    }

    /// Makes `cloud` the newest of `topic`.
    #[cfg(test)]
    pub(crate) fn set(&self, topic: &str, cloud: PointCloud) {
        self.0.lock().insert(topic.to_owned(), Newest { cloud: Arc::new(cloud), listeners: 1 });
    }

    /// Forgets the cloud of `topic`, if no other version of ROS listens to it.
    pub(super) fn remove(&self, topic: &str) {
        let mut clouds = self.0.lock();
        let is_left = clouds.get_mut(topic).is_some_and(|newest| {
            newest.listeners = newest.listeners.saturating_sub(1);
            newest.listeners == 0
        });
        if is_left {
            clouds.remove(topic);
        }
    }
}

/// Topic for the size of the points of `topic`.
pub(super) fn radius_topic(topic: &str) -> String {
    format!("{topic}/radius")
}

/// Longest cloud, bytes: some twenty million points.
pub(super) const MAX_CLOUD: usize = 256 << 20;

/// Longest message with the size of points, bytes.
pub(super) const MAX_RADIUS: usize = 4;

/// Listens to the cloud on `topic` and to the size of its points.
pub(super) fn subscriptions(clouds: &Arc<PointClouds>, topic: &str) -> [Arc<dyn Announcement>; 2] {
    let (on_points, on_radius) = listeners(clouds, topic);
    [subscription(topic.to_owned(), MAX_CLOUD, on_points), subscription(radius_topic(topic), MAX_RADIUS, on_radius)]
}

/// What is done with a cloud on `topic`, and with the size of its points. From now on it is one of `clouds`.
pub(super) fn listeners(
    clouds: &Arc<PointClouds>,
    topic: &str,
) -> (impl FnMut(sensor_msgs::PointCloud) + Send + 'static, impl FnMut(std_msgs::Float32) + Send + 'static) {
    clouds.insert(topic);
    let (points, radius) = (Arc::clone(clouds), Arc::clone(clouds));
    let (of_points, of_radius) = (topic.to_owned(), topic.to_owned());
    let on_points = move |message: sensor_msgs::PointCloud| {
        points.change(&of_points, |cloud| {
            cloud.frame_id = message.header.frame_id;
            cloud.points.clear();
            let all = message.points.iter().map(|p| [p.x, p.y, p.z]);
            cloud.points.extend(all.filter(|p| p.iter().all(|x| x.is_finite())));
        });
    };
    let on_radius = move |message: std_msgs::Float32| {
        let radius_px = message.data.abs();
        if radius_px.is_finite() {
            radius.change(&of_radius, |cloud| cloud.radius = radius_px);
        }
    };
    (on_points, on_radius)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cloud_is_kept_while_its_topic_is_listened_to() {
        let clouds = Arc::<PointClouds>::default();
        let _subscriptions = subscriptions(&clouds, "/a");
        clouds.change("/a", |cloud| cloud.points.push([1.0, 2.0, 3.0]));
        clouds.change("/b", |_| panic!("nobody listens to /b"));
        let all = clouds.all();
        assert_eq!((all[0].0.as_str(), all[0].1.points.len(), all[0].1.radius), ("/a", 1, 10.0));
        let _other_version = subscriptions(&clouds, "/a");
        clouds.remove("/a");
        assert_eq!(clouds.all().len(), 1, "the other version of ROS still listens");
        clouds.remove("/a");
        assert!(clouds.all().is_empty());
    }
}
