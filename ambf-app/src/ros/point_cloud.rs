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

/// The newest cloud of every topic that is listened to.
#[derive(Debug, Default)]
pub struct PointClouds(Mutex<BTreeMap<String, Arc<PointCloud>>>);

impl PointClouds {
    /// Topic and cloud of each, sorted by topic.
    pub fn all(&self) -> Vec<(String, Arc<PointCloud>)> {
        self.0.lock().iter().map(|(topic, cloud)| (topic.clone(), Arc::clone(cloud))).collect()
    }

    fn insert(&self, topic: &str) {
        self.0.lock().insert(topic.to_owned(), Arc::default());
    }

    /// Nothing happens to a topic that has been removed: a message may still be on its way.
    fn change(&self, topic: &str, change: impl FnOnce(&mut PointCloud)) {
        if let Some(cloud) = self.0.lock().get_mut(topic) {
            change(Arc::make_mut(cloud));
        }
    }

    /// Makes `cloud` the newest of `topic`.
    #[cfg(test)]
    pub(crate) fn set(&self, topic: &str, cloud: PointCloud) {
        self.0.lock().insert(topic.to_owned(), Arc::new(cloud));
    }

    /// Forgets the cloud of `topic`.
    pub(super) fn remove(&self, topic: &str) {
        self.0.lock().remove(topic);
    }
}

/// Topic for the size of the points of `topic`.
pub(super) fn radius_topic(topic: &str) -> String {
    format!("{topic}/radius")
}

/// Longest cloud, bytes: some twenty million points.
const LONGEST_CLOUD: usize = 256 << 20;

/// Listens to the cloud on `topic` and to the size of its points.
pub(super) fn subscriptions(clouds: &Arc<PointClouds>, topic: &str) -> [Arc<dyn Announcement>; 2] {
    clouds.insert(topic);
    let (points, radius) = (Arc::clone(clouds), Arc::clone(clouds));
    let (of_points, of_radius) = (topic.to_owned(), topic.to_owned());
    [
        subscription(topic.to_owned(), LONGEST_CLOUD, move |message: sensor_msgs::PointCloud| {
            points.change(&of_points, |cloud| {
                cloud.frame_id = message.header.frame_id;
                cloud.points.clear();
                let all = message.points.iter().map(|p| [p.x, p.y, p.z]);
                cloud.points.extend(all.filter(|p| p.iter().all(|x| x.is_finite())));
            });
        }),
        subscription(radius_topic(topic), 4, move |message: std_msgs::Float32| {
            let radius_px = message.data.abs();
            if radius_px.is_finite() {
                radius.change(&of_radius, |cloud| cloud.radius = radius_px);
            }
        }),
    ]
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
        clouds.remove("/a");
        assert!(clouds.all().is_empty());
    }
}
