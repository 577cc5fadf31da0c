//! From file names to a scene.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

use super::articulate;
use super::build::Builder;
use super::descriptions::{self, SharedModel};
use super::empty::{empty_scene, JointCoordinates};
use super::hulls::CollisionMeshes;
use super::planned::{needed_hulls, needed_meshes, PlannedModel};
use super::progress::{Part, Progress};
use super::{Note, Scene, SceneOptions};
use crate::adf::{self, LoadError, Report, Severity};
use crate::bullet::Solver;
use crate::control::Profile;
use crate::ids::ModelId;
use crate::robot;

/// The files a scene is made of, in the order in which their contents are created.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SceneFiles {
    /// World file; `None`: default world attributes and no environment.
    pub world: Option<PathBuf>,
    /// Model files, ADF, URDF or MJCF. One that is given twice is built twice.
    pub models: Vec<PathBuf>,
}

/// What was found while a scene was loaded.
#[derive(Debug, Default)]
pub struct SceneReport {
    /// Files that could not be used at all, one message each.
    pub refused: Vec<String>,
    /// Problems in the text of each file that was used.
    pub files: Vec<Report>,
    /// What was dropped, replaced or guessed while objects were built.
    pub notes: Vec<Note>,
    /// How physics is solved, where it is not as in the C++ program.
    pub physics: Option<String>,
}

impl SceneReport {
    /// Files refused and elements dropped.
    pub fn errors(&self) -> usize {
        let notes = self.notes.iter().filter(|note| note.severity > Severity::Warning).count();
        self.refused.len() + notes + self.files.iter().map(Report::errors).sum::<usize>()
    }

    /// One line a problem instead of one a kind of problem.
    pub fn verbose(&self) -> impl fmt::Display + '_ {
        Written { report: self, verbose: true }
    }
}

struct Written<'a> {
    report: &'a SceneReport,
    verbose: bool,
}

impl fmt::Display for Written<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = self.report;
        if let Some(physics) = &report.physics {
            writeln!(f, "{physics}")?;
        }
        for message in &report.refused {
            writeln!(f, "{}", message.trim_end())?;
        }
        for file in &report.files {
            if self.verbose {
                write!(f, "{}", file.verbose())?
            } else {
                write!(f, "{file}")?
            }
        }
        for note in &report.notes {
            writeln!(f, "{note}")?;
        }
        Ok(())
    }
}

impl fmt::Display for SceneReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Written { report: self, verbose: false }.fmt(f)
    }
}

/// A scene and what was found while it was loaded.
pub struct Loaded {
    /// The scene.
    pub scene: Scene,
    /// What was found.
    pub report: SceneReport,
}

/// Reads the files, loads the collision meshes in parallel and builds the scene.
///
/// Never fails: a file that cannot be used is left out and reported, as in the C++ program; without a usable world file
/// the defaults apply (gravity −9.8 m/s² along z, 10 sub-steps, no environment).
pub fn load(files: &SceneFiles, options: &SceneOptions) -> Loaded {
    load_with_progress(files, options, &Progress::default())
}

/// [`load`], which says in `progress` how far it is.
pub fn load_with_progress(files: &SceneFiles, options: &SceneOptions, progress: &Progress) -> Loaded {
    let mut report = SceneReport::default();
    let read_world = |path| descriptions::world(path, with_defaults);
    let world = files.world.as_deref().and_then(|path| taken(read_world(path), &mut report));
    let world = world.unwrap_or_else(|| Arc::clone(&WITHOUT_FILE));
    let environment = world.environment.as_deref().and_then(|path| taken(descriptions::model(path), &mut report));
    let environment = environment.unwrap_or_else(|| built_in_environment(&world));
    let read = files.models.iter().filter_map(|path| taken(descriptions::model(path), &mut report));
    let models: Vec<Arc<SharedModel>> = std::iter::once(environment).chain(read).collect();

    let all = || models.iter().map(|model| &*model.description);
    let has_soft_bodies = all().any(|model| !model.soft_bodies.is_empty());
    let may_articulate = options.may_grow || all().any(articulate::may_articulate);
    let mut notes = Vec::new();
    let joints = if !may_articulate {
        JointCoordinates::Full
    } else if all().any(adf::Model::wants_reduced_coordinates) {
        JointCoordinates::ReducedWhereNeeded
    } else {
        JointCoordinates::ReducedByProfile
    };
    let mut scene = empty_scene(world, options, has_soft_bodies, joints, &mut notes);
    scene.files = files.clone();
    let meshes = CollisionMeshes::new();
    let models: Vec<_> = models.into_iter().map(|model| PlannedModel::for_scene(model, &scene)).collect();
    preload(&meshes, &models, progress);
    // Entries are large: what a growing list has to spare would be as much as it needs.
    scene.bodies.reserve_exact(models.iter().map(|model| model.description().bodies.len()).sum());
    scene.joints.reserve_exact(models.iter().map(|model| model.description().joints.len()).sum());
    progress.begin(Part::Models, models.len());
    let mut builder = Builder::new(&mut scene, &meshes);
    let mut models = models.into_iter();
    models.next().into_iter().for_each(|environment| builder.add_environment(environment));
    for model in models {
        progress.advance();
        builder.add_model(model);
    }
    progress.begin(Part::Articulations, 1);
    notes.extend(builder.finish());
    report.notes = notes;
    report.physics = (scene.profile == Profile::Accurate && scene.preset.is_none()).then(|| physics_line(&scene));
    Loaded { scene, report }
}

/// What profile `accurate` chose for a scene, in one line.
fn physics_line(scene: &Scene) -> String {
    let (solver, integrator) = (scene.world.solver(), scene.world.integrator());
    let settings = scene.world.solver_settings();
    let directly = match solver {
        Solver::Accurate => " (joints and small groups of contacts directly, piles by iterations)",
        _ => "",
    };
    let sub_step = scene.sub_step.map_or(String::new(), |sub_step| format!(", sub step {sub_step} s"));
    format!(
        "physics: accurate – solver {}{directly}, iterations {}, integrator {}, joint ERP {}{sub_step}",
        solver.name(),
        settings.iterations,
        integrator.name(),
        settings.joint_erp,
    )
}

/// Loads the meshes of `models`, and makes the convex hulls that they ask for, in parallel: those that will be needed.
fn preload(meshes: &CollisionMeshes, models: &[PlannedModel], progress: &Progress) {
    let mut wanted: Vec<_> = models.iter().flat_map(needed_meshes).collect();
    wanted.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    wanted.dedup();
    progress.begin(Part::Meshes, wanted.len());
    meshes.files.preload(&wanted, &|| progress.advance());
    let hulls: Vec<_> = models.iter().flat_map(needed_hulls).collect();
    meshes.hulls.preload(&meshes.files, &hulls, progress);
    let volumes = models.iter().flat_map(|model| &model.description().volumes);
    volumes.for_each(|volume| meshes.voxels.preload(volume, progress));
}

/// A model that was read and whose meshes are in memory, ready to be built into a scene.
pub struct PreparedModel {
    model: PlannedModel,
    meshes: CollisionMeshes,
    /// What was found while it was read.
    pub report: SceneReport,
}

impl PreparedModel {
    /// Reads a model file and its meshes; takes as long as that takes, but no scene.
    ///
    /// # Errors
    /// Why the file is of no use, with all problems in it.
    pub fn read(path: &Path) -> Result<Self, String> {
        let mut report = SceneReport::default();
        let Some(model) = taken(descriptions::model(path), &mut report) else {
            return Err(report.to_string().trim_end().to_owned());
        };
        let (meshes, model) = (CollisionMeshes::new(), PlannedModel::new(model));
        preload(&meshes, std::slice::from_ref(&model), &Progress::default());
        Ok(Self { model, meshes, report })
    }

    /// The file that was read.
    pub fn file(&self) -> &Path {
        &self.description().file
    }

    /// What was read.
    pub(super) fn description(&self) -> &adf::Model {
        self.model.description()
    }

    /// Puts another description in place of what was read; it must not need other meshes.
    pub(super) fn set_description(&mut self, description: adf::Model) {
        self.model = PlannedModel::new(SharedModel::new(description));
    }
}

impl Scene {
    /// Builds a model into the scene; returns it and what was dropped, replaced or guessed.
    pub(crate) fn add_model(&mut self, model: PreparedModel) -> (ModelId, Vec<Note>) {
        let mut builder = Builder::new(self, &model.meshes);
        builder.add_model(model.model);
        (builder.model, builder.finish())
    }
}

/// Reads a model file: URDF or MJCF if its name says so ([`robot::is_robot`]), else ADF.
///
/// # Errors
/// Those of [`robot::load`] and [`adf::load`].
pub fn read_model(path: &Path) -> Result<(adf::Model, Report), LoadError> {
    if robot::is_robot(path) {
        robot::load(path)
    } else {
        adf::load(path)
    }
}

fn taken<T>(read: Result<(T, Report), LoadError>, report: &mut SceneReport) -> Option<T> {
    match read {
        Ok((description, problems)) => {
            report.files.push(problems);
            Some(description)
        }
        Err(error) => {
            report.refused.push(error.to_string());
            None
        }
    }
}

/// What is simulated without a world file.
static WITHOUT_FILE: LazyLock<Arc<adf::World>> =
    LazyLock::new(|| Arc::new(with_defaults(described("gravity: {x: 0, y: 0, z: -9.8}\n"))));

/// The description that `text` of our own gives.
fn described<T: adf::Description>(text: &str) -> T {
    adf::parse::<T>(text, Path::new("built-in")).expect("text of our own is valid").0
}

/// A world always has a light and a camera.
fn with_defaults(mut world: adf::World) -> adf::World {
    let mut defaults: adf::World = described(
        "lights: [default_light]\n\
         cameras: [default_camera]\n\
         default_light: {name: default_light, location: {x: 2, y: 2, z: 5}, direction: {x: 0, y: 0, z: -1}}\n\
         default_camera: {name: default_camera, location: {x: 0, y: 0, z: 0}, look at: {x: -1, y: 0, z: 0}}\n",
    );
    for common in
        defaults.lights.iter_mut().map(|l| &mut l.common).chain(defaults.cameras.iter_mut().map(|c| &mut c.common))
    {
        common.namespace.clone_from(&world.common.namespace);
        common.source = world.common.source.clone();
    }
    if world.lights.is_empty() {
        world.lights = defaults.lights;
    }
    if world.cameras.is_empty() {
        world.cameras = defaults.cameras;
    }
    world
}

/// The environment of a world without an environment file: empty, or the five static planes of its enclosure, with the
/// origin in the middle.
fn built_in_environment(world: &adf::World) -> Arc<SharedModel> {
    let Some(size) = world.enclosure else { return descriptions::built_in("bodies: []\n", described) };
    let planes = [
        ("floor", [0, 0, 1], size.height),
        ("front", [-1, 0, 0], size.length),
        ("back", [1, 0, 0], size.length),
        ("right", [0, -1, 0], size.width),
        ("left", [0, 1, 0], size.width),
    ];
    let names = planes.map(|(name, ..)| format!("BODY {name}")).join(", ");
    let mut text = format!("namespace: {}\nbodies: [{names}]\n", world.common.namespace);
    for (name, [x, y, z], span) in planes {
        text += &format!(
            "BODY {name}: {{name: {name}, mass: 0, collision shape: Plane, collision geometry: {{normal: {{x: {x}, y: {y}, z: {z}}}, \
             offset: {}}}}}\n",
            -span / 2.0
        );
    }
    descriptions::built_in(&text, described)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_world_without_a_file_has_gravity_a_light_and_a_camera() {
        let Loaded { scene, report } = load(&SceneFiles::default(), &SceneOptions::default());
        assert_eq!(report.errors(), 0, "{report}");
        assert_eq!((scene.lights.len(), scene.cameras.len(), scene.bodies.len()), (1, 1, 0));
        assert_eq!((scene.gravity.z, scene.max_sub_steps), (-9.8, 10));
    }

    #[test]
    fn an_enclosure_is_five_planes() {
        let world: adf::World = described("namespace: /env/\nenclosure: {length: 4, width: 2, height: 1}\n");
        let model = built_in_environment(&world);
        let names: Vec<_> = model.description.bodies.iter().map(|body| body.common.name.as_str()).collect();
        assert_eq!(names, ["floor", "front", "back", "right", "left"]);
    }

    #[test]
    fn what_cannot_be_used_is_reported_and_left_out() {
        let files = SceneFiles { world: Some("no/such/world.yaml".into()), models: vec!["no/such/model.yaml".into()] };
        let Loaded { scene, report } = load(&files, &SceneOptions::default());
        assert_eq!(report.refused.len(), 2);
        assert!(report.to_string().contains("no/such/model.yaml"), "{report}");
        assert_eq!(scene.models.len(), 1);
    }
}
