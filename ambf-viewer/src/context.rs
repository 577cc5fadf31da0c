//! One OpenGL context for all windows.

use std::ffi::{c_void, CStr};
use std::num::NonZeroU32;

use glutin::config::{Api, Config, ConfigSurfaceTypes, ConfigTemplateBuilder, GlConfig};
use glutin::context::{
    ContextApi, ContextAttributesBuilder, GlProfile, NotCurrentGlContext, PossiblyCurrentContext,
    PossiblyCurrentGlContext, Version,
};
use glutin::display::{Display, DisplayApiPreference, GlDisplay};
use glutin::platform::x11::X11GlConfigExt;
use glutin::surface::{GlSurface, Surface, SurfaceAttributesBuilder, SwapInterval, WindowSurface};
use winit::event_loop::ActiveEventLoop;
use winit::platform::x11::WindowAttributesExtX11;
use winit::raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use winit::window::{Window, WindowAttributes};

/// A context with the display and the configuration that all surfaces share.
pub(crate) struct Context {
    display: Display,
    config: Config,
    context: PossiblyCurrentContext,
}

/// Sentence about what failed.
fn failed(what: &str, error: impl std::fmt::Display) -> String {
    format!("{what}: {error}")
}

impl Context {
    /// # Errors
    /// A sentence when the display offers no context of version 3.3 or later with the compatibility profile.
    pub fn new(event_loop: &ActiveEventLoop) -> Result<Self, String> {
        let handle = event_loop.display_handle().map_err(|error| failed("no display", error))?.as_raw();
        // SAFETY: the handle is that of the event loop, which outlives everything made here.
        let display = unsafe { Display::new(handle, DisplayApiPreference::Egl) };
        let display = display.map_err(|error| failed("EGL cannot be used (Debian package libegl1)", error))?;
        let template = ConfigTemplateBuilder::new()
            .with_api(Api::OPENGL)
            .with_surface_type(ConfigSurfaceTypes::WINDOW)
            .with_depth_size(24)
            .build();
        // SAFETY: the template names no window.
        let configs = unsafe { display.find_configs(template) };
        let configs = configs.map_err(|error| failed("the display has no OpenGL", error))?;
        // Windows must not be seen through, and anti-aliasing is done elsewhere.
        let config = configs
            .min_by_key(|config| (config.num_samples(), config.alpha_size(), config.depth_size()))
            .ok_or("the display has no OpenGL that windows can use")?;
        let attributes = ContextAttributesBuilder::new()
            .with_context_api(ContextApi::OpenGl(Some(Version::new(3, 3))))
            .with_profile(GlProfile::Compatibility)
            .build(None);
        // SAFETY: the attributes name no window.
        let context = unsafe { display.create_context(&config, &attributes) };
        let context = context.map_err(|error| failed("no OpenGL 3.3 with the compatibility profile", error))?;
        Ok(Self { display, config, context: context.treat_as_possibly_current() })
    }

    /// Attributes that a window needs so that this context can draw into it.
    pub fn attributes(&self, attributes: WindowAttributes) -> WindowAttributes {
        match self.config.x11_visual() {
            Some(visual) => attributes.with_x11_visual(visual.visual_id() as _),
            None => attributes,
        }
    }

    /// What is drawn into for a window.
    ///
    /// # Errors
    /// A sentence.
    pub fn surface(&self, window: &Window) -> Result<Surface<WindowSurface>, String> {
        let handle = window.window_handle().map_err(|error| failed("no window", error))?.as_raw();
        let (width, height) = pixels(window);
        let attributes = SurfaceAttributesBuilder::<WindowSurface>::new().build(handle, width, height);
        // SAFETY: the window is alive, and its owner drops the surface before it.
        let surface = unsafe { self.display.create_window_surface(&self.config, &attributes) };
        surface.map_err(|error| failed("a window cannot be drawn into", error))
    }

    /// Makes the context draw into a surface; without vertical synchronisation, so that windows don't wait for each
    /// other.
    ///
    /// # Errors
    /// A sentence: the context is lost.
    pub fn make_current(&self, surface: &Surface<WindowSurface>) -> Result<(), String> {
        self.context.make_current(surface).map_err(|error| failed("the window system has lost the context", error))
    }

    /// Makes the context current without a window.
    ///
    /// # Errors
    /// A sentence when the driver cannot do that.
    pub fn make_current_without_window(&self) -> Result<(), String> {
        match &self.context {
            PossiblyCurrentContext::Egl(context) => context.make_current_surfaceless(),
        }
        .map_err(|error| failed("OpenGL needs a window here", error))
    }

    /// Switches vertical synchronisation off for the surface that is current.
    pub fn swap_at_once(&self, surface: &Surface<WindowSurface>) {
        // Where that is refused frames come slower, nothing else.
        let _ = surface.set_swap_interval(&self.context, SwapInterval::DontWait);
    }

    /// Follows the size of a window.
    pub fn resize(&self, surface: &Surface<WindowSurface>, window: &Window) {
        let (width, height) = pixels(window);
        surface.resize(&self.context, width, height);
    }

    /// Shows what was drawn.
    ///
    /// # Errors
    /// A sentence: the context is lost.
    pub fn swap(&self, surface: &Surface<WindowSurface>) -> Result<(), String> {
        surface.swap_buffers(&self.context).map_err(|error| failed("the window system has lost the context", error))
    }

    /// Address of an OpenGL function.
    pub fn find(&self, name: &CStr) -> *const c_void {
        self.display.get_proc_address(name)
    }
}

fn pixels(window: &Window) -> (NonZeroU32, NonZeroU32) {
    let size = window.inner_size();
    let positive = |n: u32| NonZeroU32::new(n).unwrap_or(NonZeroU32::MIN);
    (positive(size.width), positive(size.height))
}
