//! Scenes for pictures.
#![allow(dead_code)] // each test uses a part of it

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_core::adf::{self, Launch};
use ambf_core::comm::Snapshot;
use ambf_core::ids::CameraId;
use ambf_core::scene::{load, SceneFiles, SceneOptions, VisualScene};
use ambf_core::sim::Simulation;
use ambf_render::{Picture, PictureRequest, Renderer, Stage, View};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

/// A scene at a moment.
pub struct Shown {
    pub visuals: Arc<VisualScene>,
    pub snapshot: Snapshot,
    pub stage: Stage,
}

impl Shown {
    /// Files as the command line takes them.
    pub fn of_files(world: Option<&Path>, models: &[&Path]) -> Self {
        let models = models.iter().map(|path| path.to_path_buf()).collect();
        Self::of(&SceneFiles { world: world.map(Path::to_owned), models })
    }

    /// Models of a launch file.
    pub fn of_launch(launch: &Path, indexes: &[usize]) -> Self {
        let (launch, _) = adf::load::<Launch>(launch).expect("a launch file");
        let listed = launch.multibody_configs.unwrap_or_default();
        let models = indexes.iter().map(|&index| listed[index].clone()).collect();
        Self::of(&SceneFiles { world: launch.world_config, models })
    }

    fn of(files: &SceneFiles) -> Self {
        let loaded = load(files, &SceneOptions::default());
        Self::of_simulation(&Simulation::new(loaded.scene, 0.001))
    }

    /// Texts of a world and of a model, as files of their own.
    pub fn of_texts(directory: &Path, world: &str, model: &str) -> Self {
        Self::of_simulation(&simulation(directory, world, model))
    }

    pub fn of_simulation(simulation: &Simulation) -> Self {
        let visuals = Arc::new(simulation.scene().visuals(0));
        Self { visuals, snapshot: simulation.snapshot(), stage: Stage::default() }
    }

    /// Puts bodies where a list of poses says: topic, position, quaternion (x, y, z, w).
    pub fn pose(&mut self, list: &Path) {
        let text = std::fs::read_to_string(list).expect("a list of poses");
        let mut poses = HashMap::new();
        for line in text.lines().skip(1) {
            let mut fields = line.split(',');
            let topic = fields.next().expect("a topic").to_owned();
            let n: Vec<f64> = fields.map(|field| field.trim().parse().expect("a number")).collect();
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(n[6], n[3], n[4], n[5]));
            poses.insert(topic, Isometry3::from_parts(Translation3::new(n[0], n[1], n[2]), rotation));
        }
        let mut used = 0;
        for (body, state) in self.visuals.bodies.iter().zip(&mut self.snapshot.bodies) {
            let topic = format!("{}{}/State", body.object.namespace, body.object.name);
            let Some(pose) = poses.get(&topic) else { continue };
            let inertial = pose * body.offset.inverse();
            state.origin = inertial.translation.vector.into();
            let matrix = inertial.rotation.to_rotation_matrix();
            state.basis = std::array::from_fn(|i| matrix[(i / 3, i % 3)]);
            used += 1;
        }
        assert!(used > 0, "no body has a pose");
    }

    /// Index of a camera by its name.
    pub fn camera(&self, name: &str) -> CameraId {
        let found = self.visuals.cameras.position(|camera| &*camera.object.name == name);
        found.unwrap_or_else(|| panic!("no camera `{name}`"))
    }

    pub fn view(&self, camera: CameraId) -> View {
        View::of_camera(&self.visuals.cameras[camera].description, &self.snapshot.views[camera])
    }

    /// Draws; messages are collected in the picture.
    pub fn picture(&mut self, renderer: &mut Renderer, camera: CameraId, request: &PictureRequest) -> Picture {
        let messages = renderer.prepare(&mut self.stage, &self.visuals, &self.snapshot);
        let view = self.view(camera);
        let mut picture = renderer.render(&mut self.stage, &view, request).expect("a picture");
        picture.messages.splice(0..0, messages);
        picture
    }
}

pub fn simulation(directory: &Path, world: &str, model: &str) -> Simulation {
    std::fs::create_dir_all(directory).expect("a directory");
    let (world_file, model_file) = (directory.join("world.yaml"), directory.join("model.yaml"));
    std::fs::write(&world_file, world).expect("a world");
    std::fs::write(&model_file, model).expect("a model");
    let loaded = load(&SceneFiles { world: Some(world_file), models: vec![model_file] }, &SceneOptions::default());
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Simulation::new(loaded.scene, 0.001)
}

/// A directory for the files of one test.
pub fn directory(test: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(test)
}

/// Colour of a pixel.
pub fn pixel(picture: &Picture, column: u32, row: u32) -> [u8; 3] {
    let at = 3 * (row * picture.width + column) as usize;
    [picture.color[at], picture.color[at + 1], picture.color[at + 2]]
}

/// Keeps a picture for people to look at.
pub fn keep(picture: &Picture, name: &str) {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let kind = image::ExtendedColorType::Rgb8;
    image::save_buffer(path, &picture.color, picture.width, picture.height, kind).expect("a file");
}
