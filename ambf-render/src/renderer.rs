//! Draws a stage.

use std::sync::Arc;

use ambf_core::comm::Snapshot;
use ambf_core::scene::VisualScene;
use thiserror::Error;

use crate::{Picture, PictureRequest, Stage, View};

/// Why nothing can be drawn.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RenderError {
    /// Error when no OpenGL context can be made without a window.
    #[error("no pictures: {0}; install libegl1 and libgl1-mesa-dri, which draw without a graphics card")]
    NoContext(String),
    /// Error when OpenGL is there but cannot do what is needed.
    #[error("OpenGL: {0}")]
    Gl(String),
    /// Error when a size is 0 or too large.
    #[error("a picture of {width} x {height} pixels cannot be made; 1 to {most} pixels each way are possible")]
    Size {
        /// Pixels from left to right.
        width: u32,
        /// Pixels from top to bottom.
        height: u32,
        /// Most pixels each way.
        most: u32,
    },
}

/// Draws stages with OpenGL. It may be handed from thread to thread, but is used by one at a time.
pub struct Renderer {}

impl Renderer {
    /// A renderer without a window, on a graphics card or in software.
    ///
    /// # Errors
    /// [`RenderError::NoContext`], [`RenderError::Gl`].
    pub fn offscreen() -> Result<Self, RenderError> {
        Err(RenderError::NoContext("not written yet".into()))
    }

    /// A renderer in the OpenGL context that is current on this thread and stays so at each call; `find` gives the addresses of OpenGL
    /// functions. A compatibility profile of version 3.3 or later is needed.
    ///
    /// # Errors
    /// [`RenderError::Gl`].
    pub fn in_current_context(
        find: impl FnMut(&std::ffi::CStr) -> *const std::ffi::c_void,
    ) -> Result<Self, RenderError> {
        let _ = find;
        Err(RenderError::Gl("not written yet".into()))
    }

    /// Vendor, device and version of OpenGL.
    pub fn device(&self) -> &str {
        ""
    }

    /// Whether pictures are computed by the processor.
    pub fn is_software(&self) -> bool {
        true
    }

    /// Brings a stage up to date: loads what is new in `visuals`, takes the poses of `snapshot`. Returns messages about what cannot be
    /// drawn as described, each once.
    pub fn prepare(&mut self, stage: &mut Stage, visuals: &Arc<VisualScene>, snapshot: &Snapshot) -> Vec<String> {
        let _ = (stage, visuals, snapshot);
        Vec::new()
    }

    /// Draws a stage without a window and reads the picture back.
    ///
    /// # Errors
    /// [`RenderError::Size`], [`RenderError::Gl`].
    pub fn render(&mut self, stage: &mut Stage, view: &View, request: &PictureRequest) -> Result<Picture, RenderError> {
        let _ = (stage, view, request);
        Err(RenderError::Gl("not written yet".into()))
    }

    /// Draws a stage into the frame buffer that is bound (0: the window's), lower left corner at (0, 0). `samples` as in
    /// [`PictureRequest`]; `mirrored` flips the picture top to bottom.
    ///
    /// # Errors
    /// [`RenderError::Size`], [`RenderError::Gl`].
    pub fn draw(
        &mut self,
        stage: &mut Stage,
        view: &View,
        size: (u32, u32),
        samples: u32,
        mirrored: bool,
    ) -> Result<(), RenderError> {
        let _ = (stage, view, size, samples, mirrored);
        Err(RenderError::Gl("not written yet".into()))
    }
}
