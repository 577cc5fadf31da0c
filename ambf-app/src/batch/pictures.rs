//! Pictures of a batch run: files, and videos that `ffmpeg` makes of them.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_core::adf::ShaderProgram;
use ambf_core::files::{folder_for, Output, WriteError};
use ambf_core::ids::CameraId;
use ambf_core::scene::VisualScene;
use ambf_core::sim::Simulation;
use ambf_render::{
    find_camera, object_label, published_size, DepthFormat, FrameTimes, NoSuchCamera, Picture, PictureRequest,
    RenderError, Renderer, Stage, Video, VideoError, View,
};
use thiserror::Error;

use crate::cli::PictureOptions;
use crate::report;

/// Pictures of a simulated second, unless another number is asked for.
const RATE: f64 = 30.0;

/// Why there are no pictures, or no more of them.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PictureError {
    /// Error when the scene has no such camera.
    #[error("--render: {0}")]
    Camera(#[from] NoSuchCamera),
    /// Error when the same camera is asked for twice.
    #[error("--render: `{0}` is given twice")]
    Twice(String),
    /// Error when nothing can be drawn.
    #[error("--render: {0}")]
    Render(#[from] RenderError),
    /// Error when a file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Error when there is no video.
    #[error("--video: {0}")]
    Video(#[from] VideoError),
    /// Error when a camera was removed while the scene was stepped.
    #[error("--render: the camera {0} was removed from the scene")]
    Removed(String),
}

/// A camera that takes pictures.
struct Camera {
    index: CameraId,
    /// What its files begin with.
    name: String,
    width: u32,
    height: u32,
    preprocessing: Option<ShaderProgram>,
    video: Option<Video>,
}

/// Takes pictures of a simulation.
pub struct Pictures {
    renderer: Renderer,
    stage: Stage,
    visuals: Arc<VisualScene>,
    /// [`Scene::changes`](ambf_core::scene::Scene::changes) when `visuals` was made.
    changes: u64,
    cameras: Vec<Camera>,
    every: u64,
    folder: Option<PathBuf>,
    list: Option<Output>,
    depth: Option<DepthFormat>,
    ids: bool,
    samples: u32,
    /// The table of ids has to be written.
    is_new: bool,
}

/// For file names.
fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect()
}

/// The file of one of several cameras: `FOLDER/STEM_CAMERA.EXTENSION`.
fn video_of(file: &Path, camera: &str) -> PathBuf {
    let text = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let (stem, extension) = (text(file.file_stem()), text(file.extension()));
    match extension.is_empty() {
        true => file.with_file_name(format!("{stem}_{camera}")),
        false => file.with_file_name(format!("{stem}_{camera}.{extension}")),
    }
}

impl Pictures {
    /// Finds the cameras, makes the folder and starts the videos. `dt` is the length of a step, s.
    ///
    /// # Errors
    /// [`PictureError`].
    pub fn create(options: &PictureOptions, simulation: &Simulation, dt: f64) -> Result<Self, PictureError> {
        let visuals = Arc::new(simulation.scene().visuals(0));
        let every = options.every.unwrap_or_else(|| ((1.0 / (RATE * dt)).round() as u64).max(1));
        let mut cameras: Vec<Camera> = Vec::new();
        for wanted in &options.cameras {
            let index = find_camera(&visuals, Some(wanted))?;
            if cameras.iter().any(|camera| camera.index == index) {
                return Err(PictureError::Twice(wanted.clone()));
            }
            let camera = &visuals.cameras[index];
            let mut name = plain(&camera.object.name);
            if cameras.iter().any(|other| other.name == name) {
                name = plain(object_label(&camera.object).trim_start_matches('/'));
            }
            let (width, height) = options.size.unwrap_or_else(|| published_size(&camera.description));
            let preprocessing = camera.description.preprocessing_shaders.clone();
            cameras.push(Camera { index, name, width, height, preprocessing, video: None });
        }
        let renderer = Renderer::offscreen()?;
        let list = match &options.out {
            Some(folder) => {
                let file = folder.join("pictures.csv");
                folder_for(&file)?;
                let mut list = Output::create(&file)?;
                let heading = "sim_step,sim_time,camera,file,px,py,pz,qx,qy,qz,qw,near,far,fx,fy,cx,cy,s";
                list.add(|list| writeln!(list, "{heading}"))?;
                Some(list)
            }
            None => None,
        };
        if let Some(file) = &options.video {
            let is_only = cameras.len() == 1;
            for camera in &mut cameras {
                let file = if is_only { file.clone() } else { video_of(file, &camera.name) };
                folder_for(&file)?;
                let times = FrameTimes::Rate(1.0 / (every as f64 * dt));
                camera.video = Some(Video::start(&file, (camera.width, camera.height), times)?);
            }
        }
        let depth = options.depth.as_deref().and_then(DepthFormat::from_name);
        Ok(Self {
            renderer,
            stage: Stage::default(),
            visuals,
            changes: simulation.scene().changes(),
            cameras,
            every,
            folder: options.out.clone(),
            list,
            depth,
            ids: options.ids,
            samples: options.samples,
            is_new: true,
        })
    }

    /// Takes the pictures of step `step`, if they are due.
    ///
    /// # Errors
    /// [`PictureError`].
    pub fn take(&mut self, simulation: &Simulation, step: u64) -> Result<(), PictureError> {
        if !step.is_multiple_of(self.every) {
            return Ok(());
        }
        let changes = simulation.scene().changes();
        if self.changes != changes {
            self.changes = changes;
            self.visuals = Arc::new(simulation.scene().visuals(self.visuals.generation + 1));
            self.is_new = true;
        }
        let snapshot = simulation.snapshot();
        let say = |messages: Vec<String>| messages.iter().for_each(|message| report!("{message}"));
        say(self.renderer.prepare(&mut self.stage, &self.visuals, &snapshot));
        for camera in 0..self.cameras.len() {
            let Camera { index, ref name, width, height, ref preprocessing, .. } = self.cameras[camera];
            let description = &self.visuals.cameras[index];
            if description.object.removed {
                return Err(PictureError::Removed(object_label(&description.object)));
            }
            let view = View::of_camera(&description.description, &snapshot.views[index]);
            let to_folder = self.folder.is_some();
            let request = PictureRequest {
                depth: to_folder && self.depth.is_some(),
                ids: to_folder && self.ids,
                samples: self.samples,
                preprocessing: preprocessing.clone(),
                ..PictureRequest::color(width, height)
            };
            let mut picture = self.renderer.render(&mut self.stage, &view, &request)?;
            say(std::mem::take(&mut picture.messages));
            if let Some(folder) = &self.folder {
                let (name, stem) = (name.clone(), format!("{name}_{step:08}"));
                self.write(folder, &stem, &picture, view.far)?;
                self.record(&stem, (step, simulation.sim_time()), &name, &view, &picture)?;
            }
            let film = &mut self.cameras[camera].video;
            if let Some(Err(error)) = film.as_mut().map(|video| video.add(&picture.color)) {
                *film = None;
                return Err(error.into());
            }
        }
        if let Some(folder) = self.folder.as_ref().filter(|_| self.ids && self.is_new) {
            self.write_table(&folder.join(format!("ids_{step:08}.csv")))?;
        }
        self.is_new = false;
        Ok(())
    }

    fn write(&self, folder: &Path, stem: &str, picture: &Picture, far: f64) -> Result<(), PictureError> {
        let file = folder.join(format!("{stem}.png"));
        picture.write_color(&file)?;
        if let Some(format) = self.depth {
            let file = folder.join(format!("{stem}_depth.{}", format.extension()));
            picture.write_depth(&file, format, far)?;
        }
        if self.ids {
            let file = folder.join(format!("{stem}_ids.npy"));
            picture.write_ids(&file)?;
        }
        Ok(())
    }

    /// Writes where the camera was and how it projects.
    fn record(
        &mut self,
        stem: &str,
        (step, time): (u64, f64),
        name: &str,
        view: &View,
        picture: &Picture,
    ) -> Result<(), PictureError> {
        let Some(list) = &mut self.list else { return Ok(()) };
        let mut line = format!("{step},{time:?},{name},{stem}.png");
        let rotation = view.pose.rotation.coords;
        let numbers = view.pose.translation.vector.iter().chain(rotation.iter()).chain([&view.near, &view.far]);
        numbers.for_each(|number| line += &format!(",{number:?}"));
        let matrix = match &picture.eyes[..] {
            [eye] => eye.camera_matrix(),
            _ => None,
        };
        match matrix {
            Some(k) => [k.m11, k.m22, k.m13, k.m23, k.m12].iter().for_each(|number| line += &format!(",{number:?}")),
            None => line += ",,,,,",
        }
        Ok(list.add(|list| writeln!(list, "{line}"))?)
    }

    /// Writes which number stands for which object.
    fn write_table(&self, file: &Path) -> Result<(), PictureError> {
        let mut text = String::from("id,identifier\n0,\n");
        for id in 1.. {
            let Some(name) = self.stage.id_name(id) else { break };
            let is_plain = !name.contains([',', '"', '\n']);
            let cell = if is_plain { name.to_owned() } else { format!("\"{}\"", name.replace('"', "\"\"")) };
            text += &format!("{id},{cell}\n");
        }
        Ok(Output::write_whole(file, |out| out.write_all(text.as_bytes()))?)
    }

    /// Completes the list and the videos, each whatever becomes of the others; what failed.
    pub fn finish(self) -> Vec<PictureError> {
        let Self { list, cameras, .. } = self;
        let listed = list.map(|list| list.finish().map_err(PictureError::from));
        let filmed = cameras.into_iter().filter_map(|camera| camera.video);
        let filmed = filmed.map(|video| video.finish().map_err(PictureError::from));
        listed.into_iter().chain(filmed).filter_map(Result::err).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_camera_has_its_file() {
        assert_eq!(video_of(Path::new("a/film.mp4"), "left"), Path::new("a/film_left.mp4"));
        assert_eq!(video_of(Path::new("film"), "left"), Path::new("film_left"));
    }
}
