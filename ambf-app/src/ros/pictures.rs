//! Topics of cameras that publish pictures, on one version of ROS or on both.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use ambf_core::adf;
use ambf_core::ids::CameraId;
use parking_lot::Mutex;
use ros_node::{Announcement, LargePublication};

use super::messages::sensor_msgs;

/// Bytes of the number that headers of ROS 1 begin with.
const NUMBER: std::ops::Range<usize> = 0..4;

/// What a camera publishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PictureKind {
    /// `ImageData`: `sensor_msgs/Image`.
    Image,
    /// `ImageData/compressed`: `sensor_msgs/CompressedImage`.
    Compressed,
    /// `DepthData`: `sensor_msgs/PointCloud2`.
    Cloud,
    /// `DepthImage`: `sensor_msgs/Image`.
    DepthImage,
    /// `CameraInfo`: `sensor_msgs/CameraInfo`.
    Info,
}

impl PictureKind {
    /// What stands behind the camera's name in the topic.
    fn ending(self) -> &'static str {
        match self {
            Self::Image => "ImageData",
            Self::Compressed => "ImageData/compressed",
            Self::Cloud => "DepthData",
            Self::DepthImage => "DepthImage",
            Self::Info => "CameraInfo",
        }
    }
}

/// A topic of one version of ROS.
pub(crate) trait PictureSink: Send + Sync {
    /// Whether anybody subscribes who has not stopped reading.
    fn is_wanted(&self) -> bool;

    /// Whether a message may be sent now, without sending more than this version of ROS bears.
    fn is_ready(&self) -> bool {
        true
    }

    /// Makes a message and sends it; never waits for a subscriber. `write` appends the message as ROS 1 has it, without its
    /// length; it gets the number for the message's header.
    fn send(&self, write: &mut dyn FnMut(&mut Vec<u8>, u32));
}

impl PictureSink for LargePublication {
    fn is_wanted(&self) -> bool {
        Self::is_wanted(self)
    }

    fn send(&self, write: &mut dyn FnMut(&mut Vec<u8>, u32)) {
        Self::send(self, write);
    }
}

/// A topic on every version of ROS that is served; on none, where the camera has nothing for it.
#[derive(Clone, Default)]
pub(crate) struct PictureTopic(Vec<Arc<dyn PictureSink>>);

impl PictureTopic {
    /// Whether anybody subscribes who has not stopped reading.
    pub fn is_wanted(&self) -> bool {
        self.0.iter().any(|sink| sink.is_wanted())
    }

    /// Whether anybody gets a message that is sent now.
    pub fn is_due(&self) -> bool {
        self.0.iter().any(|sink| sink.is_wanted() && sink.is_ready())
    }

    /// Has `write` make a message once and sends it where it [is due](Self::is_due), as [`PictureSink::send`] does.
    pub fn send(&self, mut write: impl FnMut(&mut Vec<u8>, u32)) {
        let due: Vec<_> = self.0.iter().filter(|sink| sink.is_wanted() && sink.is_ready()).collect();
        if let [sink] = due[..] {
            return sink.send(&mut write);
        }
        let mut message = Vec::new();
        for sink in due {
            sink.send(&mut |bytes, number| {
                if message.is_empty() {
                    write(&mut message, number);
                }
                let begin = bytes.len();
                bytes.extend_from_slice(&message);
                if let Some(field) = bytes[begin..].get_mut(NUMBER) {
                    field.copy_from_slice(&number.to_le_bytes());
                }
            });
        }
    }
}

/// What one camera publishes.
pub struct CameraTopics {
    /// Index of the camera in [`VisualScene::cameras`](ambf_core::scene::VisualScene::cameras).
    pub index: CameraId,
    name: String,
    /// Images come every so many frames; `None`: there are none.
    pub image_interval: Option<u32>,
    /// Depth comes every so many frames; `None`: there is none.
    pub depth_interval: Option<u32>,
    pub(crate) image: PictureTopic,
    pub(crate) compressed: PictureTopic,
    pub(crate) cloud: PictureTopic,
    pub(crate) depth_image: PictureTopic,
    /// For one eye in perspective only.
    pub(crate) info: PictureTopic,
}

impl CameraTopics {
    /// Topics below `name`, `/<namespace>/<camera>`, for the camera that `described` describes; `make` makes each.
    /// `None` if it publishes nothing.
    pub(crate) fn new(
        index: CameraId,
        name: &str,
        described: &adf::Camera,
        mut make: impl FnMut(PictureKind, String) -> Option<Arc<dyn PictureSink>>,
    ) -> Option<Self> {
        let image = described.publish_image.map(|frame| frame.interval);
        let depth = described.publish_depth.map(|frame| frame.interval);
        image.or(depth)?;
        let is_pinhole = described.stereo.is_none() && described.orthographic_view_width.is_none();
        let mut topic = |is_there: bool, kind: PictureKind| {
            let made = is_there.then(|| make(kind, format!("{name}/{}", kind.ending()))).flatten();
            PictureTopic(made.into_iter().collect())
        };
        Some(Self {
            index,
            name: name.to_owned(),
            image_interval: image,
            depth_interval: depth,
            image: topic(image.is_some(), PictureKind::Image),
            compressed: topic(image.is_some(), PictureKind::Compressed),
            cloud: topic(depth.is_some(), PictureKind::Cloud),
            depth_image: topic(depth.is_some(), PictureKind::DepthImage),
            info: topic(is_pinhole, PictureKind::Info),
        })
    }

    /// Those of ROS 1, and what is to be announced for them; `mapped` gives the name under which each is published.
    pub(crate) fn of_ros1(
        index: CameraId,
        name: &str,
        described: &adf::Camera,
        mapped: impl Fn(String) -> String,
    ) -> Option<(Self, Vec<Arc<dyn Announcement>>)> {
        let mut announcements: Vec<Arc<dyn Announcement>> = Vec::new();
        let topics = Self::new(index, name, described, |kind, topic| {
            let topic = mapped(topic);
            let publication = match kind {
                PictureKind::Image | PictureKind::DepthImage => LargePublication::new::<sensor_msgs::Image>(topic),
                PictureKind::Compressed => LargePublication::new::<sensor_msgs::CompressedImage>(topic),
                PictureKind::Cloud => LargePublication::new::<sensor_msgs::PointCloud2>(topic),
                PictureKind::Info => LargePublication::new::<sensor_msgs::CameraInfo>(topic),
            };
            announcements.push(Arc::clone(&publication) as Arc<dyn Announcement>);
            Some(publication)
        })?;
        Some((topics, announcements))
    }

    /// What the topics have in common: `/<namespace>/<camera>`.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn is_wanted(&self) -> bool {
        let all = [&self.image, &self.compressed, &self.cloud, &self.depth_image, &self.info];
        all.into_iter().any(PictureTopic::is_wanted)
    }

    /// These, and those of `other` on another version of ROS.
    fn with(&self, other: &Self) -> Self {
        let both = |one: &PictureTopic, two: &PictureTopic| PictureTopic([&one.0[..], &two.0[..]].concat());
        Self {
            index: self.index,
            name: self.name.clone(),
            image_interval: self.image_interval,
            depth_interval: self.depth_interval,
            image: both(&self.image, &other.image),
            compressed: both(&self.compressed, &other.compressed),
            cloud: both(&self.cloud, &other.cloud),
            depth_image: both(&self.depth_image, &other.depth_image),
            info: both(&self.info, &other.info),
        }
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
        self.cameras.lock().iter().any(|camera| camera.is_wanted())
    }

    /// Adds the topics of a camera on one version of ROS to those on another.
    pub(super) fn insert(&self, camera: CameraTopics) {
        let mut cameras = self.cameras.lock();
        match cameras.iter_mut().find(|known| known.index == camera.index) {
            Some(known) => *known = Arc::new(known.with(&camera)),
            None => cameras.push(Arc::new(camera)),
        }
        self.generation.fetch_add(1, Ordering::AcqRel);
    }

    /// Forgets the camera at `index`, on all versions of ROS.
    pub(super) fn remove(&self, index: CameraId) {
        self.cameras.lock().retain(|camera| camera.index != index);
        self.generation.fetch_add(1, Ordering::AcqRel);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Keeps what it is sent.
    struct Kept {
        number: u32,
        is_ready: bool,
        messages: Mutex<Vec<Vec<u8>>>,
    }

    impl Kept {
        fn new(number: u32, is_ready: bool) -> Arc<Self> {
            Arc::new(Self { number, is_ready, messages: Mutex::default() })
        }
    }

    impl PictureSink for Kept {
        fn is_wanted(&self) -> bool {
            true
        }

        fn is_ready(&self) -> bool {
            self.is_ready
        }

        fn send(&self, write: &mut dyn FnMut(&mut Vec<u8>, u32)) {
            let mut message = Vec::new();
            write(&mut message, self.number);
            self.messages.lock().push(message);
        }
    }

    #[test]
    fn a_message_is_made_once_for_both_versions() {
        let (one, two, late) = (Kept::new(7, true), Kept::new(9, true), Kept::new(1, false));
        let sinks = [&one, &two, &late].map(|sink| Arc::clone(sink) as Arc<dyn PictureSink>);
        let topic = PictureTopic(sinks.into());
        let mut made = 0;
        topic.send(|bytes, number| {
            made += 1;
            bytes.extend(number.to_le_bytes());
            bytes.extend([1, 2, 3]);
        });
        assert_eq!(made, 1);
        assert_eq!(*one.messages.lock(), [[7, 0, 0, 0, 1, 2, 3]]);
        assert_eq!(*two.messages.lock(), [[9, 0, 0, 0, 1, 2, 3]]);
        assert!(late.messages.lock().is_empty() && topic.is_wanted() && topic.is_due());
        assert!(!PictureTopic(vec![late]).is_due() && !PictureTopic::default().is_wanted());
    }
}
