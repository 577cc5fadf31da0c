//! Cameras over ROS: images, depth clouds, depth images and intrinsics, made when they are due and somebody subscribes.
//!
//! [`CameraService`] makes them, with a renderer that somebody else owns: the graphics thread of a window, or
//! [`OffscreenCameras`], a thread that has a renderer while there are subscribers. What a frame shows is one snapshot,
//! with one stamp in all its messages: that of the `State` messages of the same step. Frames are counted for all
//! cameras together, so that cameras with the same interval publish in the same frames, also a camera that comes later.

mod clouds;
mod messages;
mod noise;
mod offscreen;
mod service;

pub use clouds::CloudMarkers;
pub use offscreen::OffscreenCameras;
pub use service::CameraService;
