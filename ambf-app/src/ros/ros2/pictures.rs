//! Topics of pictures: large messages, which RustDDS sends in one burst and keeps for seconds.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use ambf_core::adf;
use ambf_core::ids::CameraId;
use ambf_render::published_size;
use parking_lot::Mutex;
use ros2_node::{Publication, Qos};

use super::super::arguments::RosArguments;
use super::super::messages::sensor_msgs;
use super::super::pictures::{CameraTopics, PictureKind, PictureSink};
use super::transport::{Converted, Transport};
use crate::warn;

/// Bytes a second that a topic sends at most: RustDDS keeps what was sent for 6 s.
const MAX_BYTES_PER_SECOND: f64 = 32e6;

/// Longest message that subscriptions with the usual receive buffer of 212 992 bytes get, bytes.
const MAX_MESSAGE: usize = 200_000;

/// Bytes of a point in a cloud, and of what is not picture in any message.
const POINT: usize = 32;
const FRAME: usize = 512;

/// Topics of the camera at `index` on the current node of `transport`, below `name`; `None` if it publishes nothing.
pub(super) fn topics(
    transport: &Transport,
    arguments: &RosArguments,
    index: CameraId,
    name: &str,
    described: &adf::Camera,
) -> Option<CameraTopics> {
    let (width, height) = published_size(described);
    let depth = described.publish_depth.map_or((width, height), |frame| (frame.width, frame.height));
    let (pixels, depths) = (width as usize * height as usize, depth.0 as usize * depth.1 as usize);
    CameraTopics::new(index, name, described, |kind, topic| {
        let topic = arguments.mapped(topic);
        let made = match kind {
            PictureKind::Image => transport.large::<sensor_msgs::Image>(&topic, Qos::large(FRAME + 3 * pixels)),
            // About what JPEG makes of it.
            PictureKind::Compressed => {
                transport.large::<sensor_msgs::CompressedImage>(&topic, Qos::large(FRAME + pixels / 4))
            }
            PictureKind::Cloud => {
                transport.large::<sensor_msgs::PointCloud2>(&topic, Qos::large(FRAME + POINT * depths))
            }
            PictureKind::DepthImage => transport.large::<sensor_msgs::Image>(&topic, Qos::large(FRAME + 4 * depths)),
            PictureKind::Info => transport.large::<sensor_msgs::CameraInfo>(&topic, Qos::large(FRAME)),
        };
        let (publication, bytes) = made?;
        Some(Arc::new(LargeOutlet {
            publication,
            bytes: Mutex::new(bytes),
            ready_at: Mutex::new(Instant::now()),
            advice: if kind == PictureKind::Image { "subscribe to ImageData/compressed, or " } else { "" },
            is_advised: AtomicBool::new(false),
        }) as Arc<dyn PictureSink>)
    })
}

/// A topic of large messages, which ends with its node.
struct LargeOutlet {
    publication: Weak<Publication>,
    bytes: Mutex<Converted>,
    /// When the next message may be sent.
    ready_at: Mutex<Instant>,
    /// What a subscriber can do besides enlarging its buffer.
    advice: &'static str,
    is_advised: AtomicBool,
}

impl LargeOutlet {
    /// Says once what becomes of messages of so many bytes.
    fn advise(&self, topic: &str, length: usize) {
        if length > MAX_MESSAGE && !self.is_advised.swap(true, Ordering::Relaxed) {
            warn!(
                "ROS 2: {topic}: messages of {} kB are mostly lost by subscribers with the usual receive buffer: {}there set \
                 net.core.rmem_default and rmem_max to 4000000; this is said once",
                length / 1000,
                self.advice
            );
        }
    }
}

impl PictureSink for LargeOutlet {
    fn is_wanted(&self) -> bool {
        self.publication.upgrade().is_some_and(|publication| publication.is_matched())
    }

    fn is_ready(&self) -> bool {
        Instant::now() >= *self.ready_at.lock()
    }

    fn send(&self, write: &mut dyn FnMut(&mut Vec<u8>, u32)) {
        let Some(publication) = self.publication.upgrade() else { return };
        let Converted { transcoder, ros1, cdr } = &mut *self.bytes.lock();
        ros1.clear();
        write(ros1, 0);
        if transcoder.to_cdr(ros1, cdr).is_err() {
            return;
        }
        self.advise(publication.topic(), cdr.len());
        *self.ready_at.lock() = Instant::now() + Duration::from_secs_f64(cdr.len() as f64 / MAX_BYTES_PER_SECOND);
        // What a client that hangs does not read is lost, and counted.
        let _ = publication.send(cdr);
    }
}
