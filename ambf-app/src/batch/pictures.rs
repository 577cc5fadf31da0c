//! Pictures of a batch run: files, and videos that `ffmpeg` makes of them.

mod video;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_core::adf::ShaderProgram;
use ambf_core::ids::CameraId;
use ambf_core::scene::VisualScene;
use ambf_core::sim::Simulation;
use ambf_render::{
    find_camera, object_label, published_size, DepthFormat, NoSuchCamera, Picture, PictureRequest, RenderError,
    Renderer, Stage, View,
};
use thiserror::Error;

use self::video::Video;
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
    #[error("cannot write {}: {source}", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Error when `ffmpeg` cannot be started.
    #[error("--video: ffmpeg cannot be started ({0}); install it (apt install ffmpeg), or write pictures with --out")]
    NoFfmpeg(io::Error),
    /// Error when `ffmpeg` gives up.
    #[error("--video: ffmpeg cannot write {}: {said}", file.display())]
    Video {
        /// The video.
        file: PathBuf,
        /// What it printed.
        said: String,
    },
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
    list: Option<BufWriter<File>>,
    depth: Option<DepthFormat>,
    ids: bool,
    samples: u32,
    /// The table of ids has to be written.
    is_new: bool,
}

fn failed(file: &Path) -> impl Fn(io::Error) -> PictureError + '_ {
    move |source| PictureError::Write { file: file.to_owned(), source }
}

/// For file names.
fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect()
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
                std::fs::create_dir_all(folder).map_err(failed(folder))?;
                let file = folder.join("pictures.csv");
                let mut list = BufWriter::new(File::create(&file).map_err(failed(&file))?);
                let heading = "sim_step,sim_time,camera,file,px,py,pz,qx,qy,qz,qw,near,far,fx,fy,cx,cy,s";
                writeln!(list, "{heading}").map_err(failed(&file))?;
                Some(list)
            }
            None => None,
        };
        if let Some(file) = &options.video {
            let is_only = cameras.len() == 1;
            for camera in &mut cameras {
                let file = if is_only { file.clone() } else { video::file_of(file, &camera.name) };
                camera.video = Some(Video::start(file, (camera.width, camera.height), 1.0 / (every as f64 * dt))?);
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
            if let Some(video) = &mut self.cameras[camera].video {
                video.add(&picture.color)?;
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
        picture.write_color(&file).map_err(failed(&file))?;
        if let Some(format) = self.depth {
            let file = folder.join(format!("{stem}_depth.{}", format.extension()));
            picture.write_depth(&file, format, far).map_err(failed(&file))?;
        }
        if self.ids {
            let file = folder.join(format!("{stem}_ids.npy"));
            picture.write_ids(&file).map_err(failed(&file))?;
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
        let (Some(list), Some(folder)) = (&mut self.list, &self.folder) else { return Ok(()) };
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
        line.push('\n');
        list.write_all(line.as_bytes()).map_err(failed(&folder.join("pictures.csv")))
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
        std::fs::write(file, text).map_err(failed(file))
    }

    /// Completes the files and the videos.
    ///
    /// # Errors
    /// [`PictureError`].
    pub fn finish(mut self) -> Result<(), PictureError> {
        if let (Some(list), Some(folder)) = (&mut self.list, &self.folder) {
            list.flush().map_err(failed(&folder.join("pictures.csv")))?;
        }
        self.cameras.iter_mut().filter_map(|camera| camera.video.take()).try_for_each(Video::finish)
    }
}
