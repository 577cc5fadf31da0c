//! Pictures of scenes: descriptions and a snapshot of states in; colour, metric depth, ids and surface normals out. No
//! window, no ROS, no physics.
//!
//! ```no_run
//! use ambf_render::{find_camera, Picture, PictureRequest, Renderer, Stage, View};
//! # fn picture(hub: &ambf_core::comm::Hub) -> Result<Picture, ambf_render::RenderError> {
//! let (visuals, snapshot) = (hub.visuals().unwrap(), hub.snapshot().clone().unwrap());
//! let mut renderer = Renderer::offscreen()?;
//! let mut stage = Stage::default();
//! for message in renderer.prepare(&mut stage, &visuals, &snapshot) {
//!     eprintln!("{message}");
//! }
//! let camera = find_camera(&visuals, None).unwrap();
//! let view = View::of_camera(&visuals.cameras[camera].description, &snapshot.views[camera]);
//! let request = PictureRequest { depth: true, ..PictureRequest::color(640, 480) };
//! renderer.render(&mut stage, &view, &request)
//! # }
//! ```

mod cameras;
mod draw;
mod files;
mod gl;
mod lights;
mod meshes;
mod picture;
mod renderer;
mod shaders;
mod sky;
mod stage;
mod video;
mod view;
mod volumes;

pub use ambf_core::volume::texture::{Texture, TextureError};
pub use cameras::{camera_labels, find_camera, object_label, NoSuchCamera};
pub use files::{write_rgb_png, DepthFormat};
pub use picture::{Picture, PictureRequest, Planes};
pub use renderer::{RenderError, Renderer};
pub use stage::{Backdrop, Highlight, Marker, MarkerShape, Stage};
pub use video::{FrameTimes, Video, VideoError};
pub use view::{published_size, view_matrix, Eye, PixelRay, Projection, Stereo, View};
