//! Topics of cameras that publish pictures.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use ambf_core::adf;
use ambf_core::ids::CameraId;
use parking_lot::Mutex;
use ros_node::{Announcement, LargePublication};

use super::messages::sensor_msgs;

/// What one camera publishes.
pub struct CameraTopics {
    /// Index of the camera in [`VisualScene::cameras`](ambf_core::scene::VisualScene::cameras).
    pub index: CameraId,
    name: String,
    /// Images come every so many frames; `None`: there are none.
    pub image_interval: Option<u32>,
    /// Depth comes every so many frames; `None`: there is none.
    pub depth_interval: Option<u32>,
    /// `ImageData`: `sensor_msgs/Image`.
    pub image: Option<Arc<LargePublication>>,
    /// `ImageData/compressed`: `sensor_msgs/CompressedImage`.
    pub compressed: Option<Arc<LargePublication>>,
    /// `DepthData`: `sensor_msgs/PointCloud2`.
    pub cloud: Option<Arc<LargePublication>>,
    /// `DepthImage`: `sensor_msgs/Image`.
    pub depth_image: Option<Arc<LargePublication>>,
    /// `CameraInfo`: `sensor_msgs/CameraInfo`; for one eye in perspective only.
    pub info: Option<Arc<LargePublication>>,
}

impl CameraTopics {
    /// Topics below `name`, `/<namespace>/<camera>`, for the camera that `described` describes; `mapped` gives the name
    /// under which each is published. `None` if it publishes nothing.
    pub(crate) fn new(
        index: CameraId,
        name: &str,
        described: &adf::Camera,
        mapped: impl Fn(String) -> String,
    ) -> Option<Arc<Self>> {
        let image = described.publish_image.map(|frame| frame.interval);
        let depth = described.publish_depth.map(|frame| frame.interval);
        image.or(depth)?;
        let topic = |last: &str| mapped(format!("{name}/{last}"));
        let is_pinhole = described.stereo.is_none() && described.orthographic_view_width.is_none();
        Some(Arc::new(Self {
            index,
            name: name.to_owned(),
            image_interval: image,
            depth_interval: depth,
            image: image.map(|_| LargePublication::new::<sensor_msgs::Image>(topic("ImageData"))),
            compressed: image
                .map(|_| LargePublication::new::<sensor_msgs::CompressedImage>(topic("ImageData/compressed"))),
            cloud: depth.map(|_| LargePublication::new::<sensor_msgs::PointCloud2>(topic("DepthData"))),
            depth_image: depth.map(|_| LargePublication::new::<sensor_msgs::Image>(topic("DepthImage"))),
            info: is_pinhole.then(|| LargePublication::new::<sensor_msgs::CameraInfo>(topic("CameraInfo"))),
        }))
    }

    /// What the topics have in common: `/<namespace>/<camera>`.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn publications(&self) -> impl Iterator<Item = &Arc<LargePublication>> {
        [&self.image, &self.compressed, &self.cloud, &self.depth_image, &self.info].into_iter().flatten()
    }

    pub(crate) fn announcements(&self) -> Vec<Arc<dyn Announcement>> {
        self.publications().map(|publication| Arc::clone(publication) as Arc<dyn Announcement>).collect()
    }
}

/// Topics of all cameras that publish pictures, while the cameras come and go.
#[derive(Default)]
pub struct PictureTopics {
    generation: AtomicU64,
    cameras: Mutex<Vec<Arc<CameraTopics>>>,
}

impl PictureTopics {
    /// How often cameras came or went.
    pub fn generation(&self) -> u64 {
        self.generation.load(Ordering::Acquire)
    }

    /// Those of each camera, in the order in which they came.
    pub fn all(&self) -> Vec<Arc<CameraTopics>> {
        self.cameras.lock().clone()
    }

    /// Whether anybody subscribes to any of them who has not stopped reading.
    pub fn is_wanted(&self) -> bool {
        self.cameras.lock().iter().any(|camera| camera.publications().any(|publication| publication.is_wanted()))
    }

    pub(super) fn insert(&self, camera: Arc<CameraTopics>) {
        self.cameras.lock().push(camera);
        self.generation.fetch_add(1, Ordering::AcqRel);
    }

    /// Forgets the camera at `index`.
    pub(super) fn remove(&self, index: CameraId) {
        self.cameras.lock().retain(|camera| camera.index != index);
        self.generation.fetch_add(1, Ordering::AcqRel);
    }
}
