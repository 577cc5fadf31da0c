//! Draws a stage.

mod build;
mod drawables;
mod read_back;
mod shapes;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use ambf_core::adf;
use ambf_core::comm::Snapshot;
use ambf_core::plugin::Pixels;
use ambf_core::scene::VisualScene;
use thiserror::Error;

use crate::draw::{Mask, Pass, Programs};
use crate::gl::{self, Current, Device, InstanceBuffer, Target, TargetKind};
use crate::lights::ShadowMap;
use crate::meshes::Library;
use crate::sky::Sky;
use crate::stage::{Backdrop, Built, Source};
use crate::view::Eye;
use crate::volumes::Stacks;
use crate::{Picture, PictureRequest, Planes, Stage, View};
use drawables::{drawables, marker_parts, Flags};
use read_back::{metric, rgb, top_first};
use shapes::Shapes;

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
    /// Error when a process draws that was forked from one that has drawn: the threads of OpenGL are not in it.
    #[error(
        "this process was forked from one that has made pictures, and OpenGL does not outlive a fork; start processes by `spawn` or \
         `forkserver`, or fork before the first picture"
    )]
    Forked,
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
    /// Error when a stage is drawn that this renderer has not prepared.
    #[error("the stage was not prepared by this renderer; call `prepare` before")]
    NotPrepared,
}

/// Targets that are kept for the next picture of the same size.
const TARGETS_KEPT: usize = 8;

/// Draws stages with OpenGL. It may be handed from thread to thread, but is used by one at a time.
pub struct Renderer {
    // Declared before the device: what it made is given to the device's bin.
    resources: Resources,
    device: Device,
    id: u64,
}

/// What is on the graphics card.
struct Resources {
    library: Library,
    programs: Programs,
    buffer: InstanceBuffer,
    no_shadow: gl::Texture,
    white: gl::Texture,
    shapes: Shapes,
    targets: Targets,
    /// The last sky, `None` in it if it cannot be loaded.
    sky: Option<(adf::Skybox, Option<Sky>)>,
    /// Pictures behind the scene.
    backdrops: Vec<(Arc<Pixels>, gl::Texture)>,
    volumes: Stacks,
    /// (lights x 1).
    maps: Vec<Option<ShadowMap>>,
    /// Counts changes of the shapes of soft bodies.
    soft_versions: u64,
    /// What is read back is read into it.
    bytes: Vec<u8>,
}

/// Targets of the last pictures.
#[derive(Default)]
struct Targets(Vec<(TargetKind, Target)>);

impl Targets {
    fn get(&mut self, gl: &Current<'_>, kind: TargetKind, width: u32, height: u32) -> Result<&Target, RenderError> {
        let fits = |(k, target): &(TargetKind, Target)| *k == kind && (target.width, target.height) == (width, height);
        let entry = match self.0.iter().position(fits) {
            Some(place) => self.0.remove(place),
            None => {
                self.0.truncate(TARGETS_KEPT - 1);
                (kind, gl.target(width, height, kind)?)
            }
        };
        self.0.insert(0, entry);
        Ok(&self.0[0].1)
    }
}

impl Resources {
    fn new(gl: &Current<'_>) -> Result<Self, RenderError> {
        Ok(Self {
            library: Library::default(),
            programs: Programs::default(),
            buffer: gl.instance_buffer()?,
            no_shadow: gl.no_shadow()?,
            white: gl.texture(1, 1, &[255; 4])?,
            shapes: Shapes::new(gl)?,
            targets: Targets::default(),
            sky: None,
            backdrops: Vec::new(),
            volumes: Stacks::default(),
            maps: Vec::new(),
            soft_versions: 0,
            bytes: Vec::new(),
        })
    }
}

impl Renderer {
    /// A renderer without a window, on a graphics card or in software.
    ///
    /// # Errors
    /// [`RenderError::NoContext`], [`RenderError::Gl`].
    pub fn offscreen() -> Result<Self, RenderError> {
        Self::on(Device::offscreen()?)
    }

    /// A renderer in the OpenGL context that is current on this thread; `find` gives the addresses of OpenGL functions.
    /// A compatibility profile of version 3.3 or later is needed.
    ///
    /// # Errors
    /// [`RenderError::Gl`].
    ///
    /// # Safety
    /// A context is current on this thread and `find` gives the addresses of its functions. Whenever the renderer is
    /// used or dropped, and whenever something is dropped that it prepared, that context is current on the thread.
    pub unsafe fn in_current_context(
        find: impl FnMut(&std::ffi::CStr) -> *const std::ffi::c_void,
    ) -> Result<Self, RenderError> {
        // SAFETY: promised by the caller.
        Self::on(unsafe { Device::in_current_context(find)? })
    }

    fn on(device: Device) -> Result<Self, RenderError> {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        let resources = {
            let gl = device.enter()?;
            gl.clear_errors();
            Resources::new(&gl)?
        };
        Ok(Self { resources, device, id: NEXT.fetch_add(1, Ordering::Relaxed) })
    }

    /// Vendor, device and version of OpenGL.
    pub fn device(&self) -> &str {
        &self.device.description
    }

    /// Whether pictures are computed by the processor.
    pub fn is_software(&self) -> bool {
        self.device.is_software
    }

    /// Bytes of voxels that were sent to the graphics card since the start: whole volumes once, then what was cut.
    pub fn sent_voxel_bytes(&self) -> u64 {
        self.resources.volumes.sent
    }

    /// Brings a stage up to date: loads what is new in `visuals`, takes the poses of `snapshot`. Returns messages about
    /// what cannot be drawn as described, each once.
    pub fn prepare(&mut self, stage: &mut Stage, visuals: &Arc<VisualScene>, snapshot: &Snapshot) -> Vec<String> {
        let gl = match self.device.enter() {
            Ok(gl) => gl,
            Err(error) => return vec![error.to_string()],
        };
        gl.clear_errors();
        let mut messages = Vec::new();
        let is_current = |built: &Built| built.renderer == self.id && Arc::ptr_eq(&built.visuals, visuals);
        let resources = &mut self.resources;
        if !stage.built.as_ref().is_some_and(is_current) {
            let mut built = resources.build(&gl, self.id, visuals, snapshot, &mut messages);
            // What the old stage used is kept until the new one has taken its meshes from the library.
            built.said = stage.built.take().map(|built| built.said).unwrap_or_default();
            stage.built = Some(built);
            resources.library.prune();
            resources.volumes.prune();
        }
        let Some(built) = &mut stage.built else { return messages };
        if stage.collision_shapes && built.collision_items.is_none() {
            let items = resources.collision_items(&gl, &built.visuals, &built.objects, &mut messages);
            built.collision_items = Some(items);
        }
        built.take_poses(snapshot);
        for soft in &mut built.soft_items {
            let Some(reading) = snapshot.soft_bodies.get(soft.body) else { continue };
            // Neither time nor number of a snapshot tells: a reset changes the shape and leaves both.
            if soft.shown != reading.nodes {
                soft.shown.clone_from(&reading.nodes);
                // Counted over all stages, which share the shadow maps.
                resources.soft_versions += 1;
                built.soft_version = resources.soft_versions;
                let item = &mut built.items[soft.item];
                (item.center, item.radius) = soft.part.follow(&gl, &item.part, &reading.nodes);
            }
        }
        for item in &mut built.items {
            let object = &built.objects[item.object];
            let (Some(isosurface), Source::Volume(id)) = (&mut item.isosurface, object.source) else { continue };
            let Some(Some(now)) = snapshot.voxels.get(id) else { continue };
            if let Err(error) = resources.volumes.follow(&gl, &mut isosurface.voxels, now) {
                messages.push(format!("{}: {error}; what was cut is not shown", object.name));
            }
        }
        messages.retain(|message| built.said.insert(message.clone()));
        gl.leave();
        messages
    }

    /// Draws a stage without a window and reads the picture back.
    ///
    /// # Errors
    /// [`RenderError::Size`], [`RenderError::Gl`], [`RenderError::NotPrepared`].
    pub fn render(&mut self, stage: &mut Stage, view: &View, request: &PictureRequest) -> Result<Picture, RenderError> {
        let (width, height) = (request.width, request.height);
        self.eyes(view, width, height)?;
        let count = |is_wanted: bool| if is_wanted { width as usize * height as usize } else { 0 };
        let mut picture = Picture {
            width,
            height,
            color: vec![0; 3 * count(request.color)],
            depth: vec![0.0; count(request.depth)],
            ids: vec![[0; 2]; count(request.ids)],
            normals: vec![[0.0; 3]; count(request.normals)],
            ..Picture::default()
        };
        let Picture { color, depth, ids, normals, .. } = &mut picture;
        let planes = Planes { color, depth, ids, normals };
        (picture.eyes, picture.messages) = self.render_into(stage, view, request, planes)?;
        Ok(picture)
    }

    /// As [`render`](Self::render), into arrays that are there: the system takes long to give a program memory for new
    /// ones. Returns the eyes and the messages of a [`Picture`].
    ///
    /// # Errors
    /// [`RenderError::Size`], [`RenderError::Gl`], [`RenderError::NotPrepared`].
    ///
    /// # Panics
    /// If an array that is asked for has another size than the picture.
    pub fn render_into(
        &mut self,
        stage: &mut Stage,
        view: &View,
        request: &PictureRequest,
        planes: Planes<'_>,
    ) -> Result<(Vec<Eye>, Vec<String>), RenderError> {
        let (width, height) = (request.width, request.height);
        let eyes = self.eyes(view, width, height)?;
        let mut messages = Vec::new();
        let gl = self.device.enter()?;
        gl.clear_errors();
        let mask = request.preprocessing.as_ref().map(|files| {
            let user = self.resources.programs.user(&gl, files, &mut messages);
            user.map_or(Mask::Built, Mask::User)
        });
        let samples = if mask.is_some() { 1 } else { request.samples.clamp(1, 8) };
        let bytes = std::mem::take(&mut self.resources.bytes);
        let markers = request.markers;
        let bytes = self.resources.with_scene(&gl, self.id, stage, markers, |pass, targets| {
            let mut bytes = bytes;
            if request.color {
                let target = targets.get(&gl, TargetKind::Color(samples), width, height)?;
                gl.bind_target(target);
                for eye in &eyes {
                    pass.color(eye, mask)?;
                }
                let target = match samples {
                    1 => target,
                    _ => {
                        // One sample a pixel again, in a target that exists besides this one.
                        let joined = gl.target(width, height, TargetKind::Color(1))?;
                        gl.copy(target, &joined);
                        targets.0.insert(0, (TargetKind::Color(1), joined));
                        &targets.0[0].1
                    }
                };
                gl.read_color(target, &mut bytes);
                rgb(&bytes, width as usize, planes.color);
            }
            if request.depth {
                let target = targets.get(&gl, TargetKind::Color(1), width, height)?;
                // The depth of the colour is the depth that is wanted, unless transparent bodies were drawn opaque.
                if !request.color || samples > 1 || mask.is_some() {
                    gl.bind_target(target);
                    for eye in &eyes {
                        pass.depth(eye)?;
                    }
                }
                gl.read_depth(target, &mut bytes);
                metric(&bytes, width, &eyes, planes.depth);
            }
            if request.ids || request.normals {
                let target = targets.get(&gl, TargetKind::Flat(request.normals), width, height)?;
                gl.bind_target(target);
                for eye in &eyes {
                    pass.flat(eye, request.normals)?;
                }
                if request.ids {
                    gl.read_ids(target, &mut bytes);
                    let id = |b: [u8; 8]| {
                        [u32::from_ne_bytes([b[0], b[1], b[2], b[3]]), u32::from_ne_bytes([b[4], b[5], b[6], b[7]])]
                    };
                    top_first(&bytes, width as usize, planes.ids, id);
                }
                if request.normals {
                    gl.read_normals(target, &mut bytes);
                    let number = |b: &[u8; 16], i: usize| f32::from_ne_bytes(std::array::from_fn(|j| b[4 * i + j]));
                    let normal = |b: [u8; 16]| std::array::from_fn(|i| number(&b, i));
                    top_first(&bytes, width as usize, planes.normals, normal);
                }
            }
            Ok(bytes)
        })?;
        self.resources.bytes = bytes;
        gl.leave();
        match gl.error() {
            None => Ok((eyes, messages)),
            Some(error) => Err(RenderError::Gl(error)),
        }
    }

    /// Draws a stage into the frame buffer that is bound (0: the window's), lower left corner at (0, 0). `samples` as
    /// in [`PictureRequest`]; `mirrored` flips the picture top to bottom, with one sample a pixel.
    ///
    /// # Errors
    /// [`RenderError::Size`], [`RenderError::Gl`], [`RenderError::NotPrepared`].
    pub fn draw(
        &mut self,
        stage: &mut Stage,
        view: &View,
        (width, height): (u32, u32),
        samples: u32,
        mirrored: bool,
    ) -> Result<(), RenderError> {
        let eyes = self.eyes(view, width, height)?;
        let gl = self.device.enter()?;
        gl.clear_errors();
        let bound = gl.bound();
        let samples = if mirrored { 1 } else { samples.clamp(1, 8) };
        // What is bound is drawn into if that gives the same picture: a copy costs a software renderer as much as the
        // scene.
        let is_direct = samples == 1 && !mirrored && gl.bound_depth_bits() >= 24;
        self.resources.with_scene(&gl, self.id, stage, true, |pass, targets| {
            let target = match is_direct {
                true => None,
                false => Some(targets.get(&gl, TargetKind::Color(samples), width, height)?),
            };
            match target {
                Some(target) => gl.bind_target(target),
                // Drawing shadow maps has bound others.
                None => gl.bind_again(bound),
            }
            for eye in &eyes {
                pass.color(eye, None)?;
            }
            gl.leave();
            if let Some(target) = target {
                gl.copy_to_bound(target, bound, mirrored);
            }
            Ok(())
        })?;
        match gl.error() {
            None => Ok(()),
            Some(error) => Err(RenderError::Gl(error)),
        }
    }

    fn eyes(&self, view: &View, width: u32, height: u32) -> Result<Vec<Eye>, RenderError> {
        let most = self.device.most_pixels;
        // Each of two eyes needs a column.
        let least = if view.stereo.is_some() { 2 } else { 1 };
        if !(least..=most).contains(&width) || !(1..=most).contains(&height) {
            return Err(RenderError::Size { width, height, most });
        }
        Ok(view.eyes(width, height))
    }
}

/// Backdrops with their textures; those whose texture did not fit into memory are left out.
fn textured<'a>(
    backdrops: &'a [Backdrop],
    loaded: &'a [(Arc<Pixels>, gl::Texture)],
) -> Vec<(&'a Backdrop, &'a gl::Texture)> {
    let texture = |backdrop: &Backdrop| loaded.iter().find(|(pixels, _)| Arc::ptr_eq(pixels, &backdrop.pixels));
    backdrops.iter().filter_map(|backdrop| Some((backdrop, &texture(backdrop)?.1))).collect()
}

impl Resources {
    /// Loads the pictures of backdrops that are new, and lets those go that nobody else has.
    fn load_backdrops(&mut self, gl: &Current<'_>, backdrops: &[Backdrop]) {
        self.backdrops.retain(|(pixels, _)| Arc::strong_count(pixels) > 1);
        for Backdrop { pixels, .. } in backdrops {
            if !self.backdrops.iter().any(|(loaded, _)| Arc::ptr_eq(loaded, pixels)) {
                if let Ok(texture) = gl.texture(pixels.width(), pixels.height(), pixels.rgba().as_flattened()) {
                    self.backdrops.push((Arc::clone(pixels), texture));
                }
            }
        }
    }

    /// Brings the lights and their shadow maps up to date, then draws.
    fn with_scene<R>(
        &mut self,
        gl: &Current<'_>,
        renderer: u64,
        stage: &Stage,
        markers: bool,
        draw: impl FnOnce(&mut Pass<'_>, &mut Targets) -> Result<R, RenderError>,
    ) -> Result<R, RenderError> {
        let built = stage.built.as_ref().filter(|built| built.renderer == renderer).ok_or(RenderError::NotPrepared)?;
        let temporary = match markers {
            true => marker_parts(gl, &stage.markers)?,
            false => Vec::new(),
        };
        let flags = Flags {
            frames: stage.frames,
            own_frames: &stage.own_frames,
            sensors: stage.sensors,
            actuators: stage.actuators,
            collision_shapes: stage.collision_shapes,
            highlight: stage.highlight.as_ref(),
            markers,
        };
        let backdrops = if markers { stage.backdrops.as_slice() } else { &[] };
        self.load_backdrops(gl, backdrops);
        let (drawables, objects) = drawables(built, &flags, &self.shapes, &stage.markers, &temporary);
        let casters = &drawables[..objects];
        let lights = built.lights(gl, &mut self.programs, &self.buffer, casters, &mut self.maps)?;
        let mut pass = Pass {
            gl,
            programs: &mut self.programs,
            buffer: &self.buffer,
            drawables: &drawables,
            lights: &lights,
            maps: &self.maps,
            no_shadow: &self.no_shadow,
            sky: self.sky.as_ref().and_then(|(_, sky)| sky.as_ref()),
            backdrops: textured(backdrops, &self.backdrops),
            white: &self.white,
            normal_maps: !stage.normal_maps_off,
            lit_programs: Vec::new(),
        };
        draw(&mut pass, &mut self.targets)
    }
}
