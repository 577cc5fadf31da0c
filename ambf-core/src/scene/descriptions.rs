//! Descriptions that all worlds of this process have in common.
//!
//! Reading a file, and finding out what it says, takes longer than building a small scene of it. A description is
//! never changed once it is read, so that worlds of one file share it, and with it the shapes of its bodies
//! ([`shared`](super::shared)). It is kept for as long as any world uses it. A world that is built meanwhile takes it
//! from here if the file, and where it leads, are still what they were.

use std::collections::HashMap;
use std::hash::Hash;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Weak};

use parking_lot::Mutex;

use super::shared::SharedShape;
use crate::adf::{self, LoadError, Report};
use crate::control::Profile;
use crate::mesh::Sources;
use crate::robot::{self, Companions};

/// A model as it was read, and what worlds of it have in common.
#[derive(Debug)]
pub(super) struct SharedModel {
    /// What was read.
    pub description: Arc<adf::Model>,
    /// Shapes of bodies, for each way of making them.
    shapes: Mutex<Vec<(ShapeRules, Vec<Option<SharedShape>>)>>,
}

/// What the shapes of bodies depend on beside their descriptions and files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ShapeRules {
    pub profile: Profile,
    /// Compounds of one shape become that shape.
    pub is_simplified: bool,
}

impl SharedModel {
    /// A model that worlds may have in common.
    pub fn new(description: adf::Model) -> Arc<Self> {
        Arc::new(Self { description: Arc::new(description), shapes: Mutex::default() })
    }

    /// (bodies x 1) shapes that some world has made; `None` for one that has to be made, also because its files have
    /// changed.
    pub fn shapes(&self, rules: ShapeRules) -> Vec<Option<SharedShape>> {
        let known = self.shapes.lock().iter().find(|(of, _)| *of == rules).map(|(_, shapes)| shapes.clone());
        // Files are asked for without the lock: they may be on a slow network.
        let current = |shape: Option<SharedShape>| shape.filter(SharedShape::is_current);
        known.map_or_else(|| self.no_shapes(), |shapes| shapes.into_iter().map(current).collect())
    }

    /// Keeps the shape of the body at `index` of the list.
    pub fn keep_shape(&self, rules: ShapeRules, index: usize, shape: SharedShape) {
        let mut all = self.shapes.lock();
        let place = all.iter().position(|(of, _)| *of == rules).unwrap_or(all.len());
        if place == all.len() {
            all.push((rules, self.no_shapes()));
        }
        if let Some(kept) = all[place].1.get_mut(index) {
            *kept = Some(shape);
        }
    }

    fn no_shapes(&self) -> Vec<Option<SharedShape>> {
        vec![None; self.description.bodies.len()]
    }
}

/// What was read of a file; it is forgotten with the last world that uses it.
struct Kept<T> {
    description: Weak<T>,
    report: Report,
    sources: Sources,
    companions: Companions,
}

/// By path, as it was written: names of files in a description begin with it.
type Descriptions<T> = Mutex<HashMap<PathBuf, Kept<T>>>;

static MODELS: LazyLock<Descriptions<SharedModel>> = LazyLock::new(Mutex::default);
static WORLDS: LazyLock<Descriptions<adf::World>> = LazyLock::new(Mutex::default);
static LAUNCHES: LazyLock<Descriptions<adf::Launch>> = LazyLock::new(Mutex::default);
/// Models that we have written ourselves, by their texts.
static BUILT_IN: LazyLock<Mutex<HashMap<String, Weak<SharedModel>>>> = LazyLock::new(Mutex::default);

/// What some world has read of a file, if it would be read again now.
fn find<T>(all: &Descriptions<T>, path: &Path) -> Option<(Arc<T>, Report)> {
    let (found, sources, companions) = {
        let all = all.lock();
        let Kept { description, report, sources, companions } = all.get(path)?;
        ((description.upgrade()?, report.clone()), sources.clone(), companions.clone())
    };
    (sources.are_current() && companions.are_current(path)).then_some(found)
}

/// Reads a file, unless some world has read it.
fn shared<T>(
    all: &Descriptions<T>,
    path: &Path,
    read: impl FnOnce() -> Result<(Arc<T>, Report, Companions), LoadError>,
) -> Result<(Arc<T>, Report), LoadError> {
    if let Some(found) = find(all, path) {
        return Ok(found);
    }
    let mut sources = Sources::default();
    sources.add(path);
    // Of a file that is being written nobody knows whether a later change would be seen.
    let is_settled = sources.are_settled();
    let (description, report, companions) = read()?;
    if is_settled && sources.are_current() && companions.files.are_settled() && companions.files.are_current() {
        let mut all = all.lock();
        // Another thread may have been quicker.
        let same = all.get(path).filter(|kept| kept.sources == sources && kept.companions == companions);
        if let Some(found) = same.and_then(|kept| kept.description.upgrade()) {
            return Ok((found, report));
        }
        let kept = Kept { description: Arc::downgrade(&description), report: report.clone(), sources, companions };
        insert(&mut all, path.to_path_buf(), kept, |kept| kept.description.strong_count() > 0);
    }
    Ok((description, report))
}

/// Inserts into a map of what is forgotten when nobody uses it any more.
fn insert<K: Hash + Eq, V>(all: &mut HashMap<K, V>, key: K, kept: V, is_used: impl Fn(&V) -> bool) {
    all.retain(|_, kept| is_used(kept));
    all.insert(key, kept);
}

/// A model file, URDF, MJCF or ADF, and what is wrong in it.
///
/// # Errors
/// Those of [`read_model`](super::read_model).
pub(super) fn model(path: &Path) -> Result<(Arc<SharedModel>, Report), LoadError> {
    shared(&MODELS, path, || {
        let (model, report, companions) = match robot::is_robot(path) {
            true => robot::load_with_companions(path)?,
            false => adf::load(path).map(|(model, report)| (model, report, Companions::default()))?,
        };
        Ok((SharedModel::new(model), report, companions))
    })
}

/// A world file, `completed`, and what is wrong in it.
///
/// # Errors
/// Those of [`adf::load`].
pub(super) fn world(
    path: &Path,
    completed: impl FnOnce(adf::World) -> adf::World,
) -> Result<(Arc<adf::World>, Report), LoadError> {
    shared(&WORLDS, path, || {
        let (world, report) = adf::load(path)?;
        Ok((Arc::new(completed(world)), report, Companions::default()))
    })
}

/// A launch file, and what is wrong in it. For as long as somebody keeps the description, it is not read again unless it
/// has changed.
///
/// # Errors
/// Those of [`adf::load`].
pub fn shared_launch(path: &Path) -> Result<(Arc<adf::Launch>, Report), LoadError> {
    shared(&LAUNCHES, path, || {
        let (launch, report) = adf::load(path)?;
        Ok((Arc::new(launch), report, Companions::default()))
    })
}

/// The model that a text of our own describes, which `parse` reads.
pub(super) fn built_in(text: &str, parse: impl FnOnce(&str) -> adf::Model) -> Arc<SharedModel> {
    let known = BUILT_IN.lock().get(text).and_then(Weak::upgrade);
    known.unwrap_or_else(|| {
        let model = SharedModel::new(parse(text));
        insert(&mut BUILT_IN.lock(), text.to_owned(), Arc::downgrade(&model), |kept| kept.strong_count() > 0);
        model
    })
}

/// Descriptions of model, world and launch files that worlds of this process share at present.
pub fn shared_descriptions() -> usize {
    fn count<T>(all: &Descriptions<T>) -> usize {
        all.lock().values().filter(|kept| kept.description.strong_count() > 0).count()
    }
    count(&MODELS) + count(&WORLDS) + count(&LAUNCHES)
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::scene::{load, Loaded, PreparedModel, Scene, SceneFiles, SceneOptions};

    /// A folder with a world, its environment and a robot whose mesh lies in a package beside it.
    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        write(folder.path(), "world.yaml", "environment: ./ground.yaml\ngravity: {x: 0, y: 0, z: -5}\n");
        write(
            folder.path(),
            "ground.yaml",
            "bodies: [BODY ground]\nBODY ground: {name: ground, mass: 0, collision shape: Plane, \
             collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}}\n",
        );
        write_robot(folder.path(), 2.0);
        std::fs::create_dir(folder.path().join("parts")).expect("made");
        write(
            folder.path(),
            "parts/stone.obj",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n",
        );
        folder
    }

    fn write(folder: &Path, name: &str, text: &str) {
        std::fs::write(folder.join(name), text).expect("written");
    }

    fn write_robot(folder: &Path, mass: f64) {
        let inertia = "<inertia ixx=\"1\" iyy=\"1\" izz=\"1\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/>";
        let geometry = "<collision><geometry><mesh filename=\"package://parts/stone.obj\"/></geometry></collision>";
        let ball = "<collision><geometry><sphere radius=\"0.1\"/></geometry></collision>";
        let link = |name: &str, collision: &str| {
            format!("<link name=\"{name}\"><inertial><mass value=\"{mass}\"/>{inertia}</inertial>{collision}</link>\n")
        };
        let joint = "<joint name=\"j\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/><axis xyz=\"0 0 1\"/>\
                     <limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>\n";
        let text = format!("<robot name=\"r\">\n{}{}{joint}</robot>\n", link("a", ball), link("b", geometry));
        write(folder, "robot.urdf", &text);
    }

    const FILES: [&str; 4] = ["world.yaml", "ground.yaml", "robot.urdf", "parts/stone.obj"];

    /// Waits until a later change would be seen.
    fn settle(folder: &Path) {
        let end = Instant::now() + Duration::from_secs(20);
        let is_settled = || {
            let mut sources = Sources::default();
            FILES.iter().for_each(|name| sources.add(&folder.join(name)));
            sources.are_settled()
        };
        while !is_settled() {
            assert!(Instant::now() < end, "the clock of the file system is ahead");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn scene(folder: &Path) -> Scene {
        let files = SceneFiles { world: Some(folder.join("world.yaml")), models: vec![folder.join("robot.urdf")] };
        let Loaded { scene, report } = load(&files, &SceneOptions::default());
        assert_eq!((report.errors(), report.files.len()), (0, 3), "{report}");
        assert_eq!(scene.bodies.len(), 3);
        scene
    }

    /// Whether each description of the folder is kept, and would be used.
    fn kept(folder: &Path) -> [bool; 3] {
        let path = |name: &str| folder.join(name);
        [
            find(&WORLDS, &path(FILES[0])).is_some(),
            find(&MODELS, &path(FILES[1])).is_some(),
            find(&MODELS, &path(FILES[2])).is_some(),
        ]
    }

    fn share(a: &Scene, b: &Scene) -> Vec<bool> {
        let models = a.models.iter().zip(b.models.iter()).map(|(a, b)| Arc::ptr_eq(&a.description, &b.description));
        std::iter::once(Arc::ptr_eq(&a.description, &b.description)).chain(models).collect()
    }

    #[test]
    fn worlds_of_the_same_files_share_descriptions_and_shapes_until_the_last_is_gone() {
        let folder = folder();
        settle(folder.path());
        let first = scene(folder.path());
        assert_eq!(kept(folder.path()), [true; 3]);
        let second = scene(folder.path());
        assert_eq!(share(&first, &second), [true; 3]);
        let (model, _) = model(&folder.path().join("robot.urdf")).expect("a robot");
        let rules = ShapeRules { profile: Profile::Legacy, is_simplified: false };
        assert!(model.shapes(rules).iter().all(Option::is_some));
        let other = ShapeRules { is_simplified: true, ..rules };
        assert!(model.shapes(other).iter().all(Option::is_none), "other rules, other shapes");
        drop((first, model));
        assert_eq!(kept(folder.path()), [true; 3]);
        drop(second);
        assert_eq!(kept(folder.path()), [false; 3]);
    }

    #[test]
    fn a_model_that_was_removed_keeps_no_shapes() {
        let folder = folder();
        settle(folder.path());
        let mut first = scene(folder.path());
        let id = first.find_model("robot").expect("it is there");
        first.remove_model(id);
        assert_eq!(kept(folder.path()), [true, true, false]);
    }

    #[test]
    fn each_file_that_has_changed_is_read_anew() {
        let folder = folder();
        settle(folder.path());
        let first = scene(folder.path());
        write(folder.path(), "world.yaml", "environment: ./ground.yaml\ngravity: {x: 0, y: 0, z: -6}\n");
        write_robot(folder.path(), 3.0);
        assert_eq!(kept(folder.path()), [false, true, false]);
        let second = scene(folder.path());
        assert_eq!(share(&first, &second), [false, true, false]);
        assert_eq!((first.gravity.z, second.gravity.z), (-5.0, -6.0));
        let mass = |scene: &Scene| scene.bodies.iter().last().map(|body| body.mass);
        assert_eq!((mass(&first), mass(&second)), (Some(2.0), Some(3.0)));
    }

    #[test]
    fn a_change_that_leaves_the_length_is_seen_and_so_is_an_older_file() {
        let folder = folder();
        settle(folder.path());
        let (robot, copy) = (folder.path().join("robot.urdf"), folder.path().join("copy"));
        let first = scene(folder.path());
        let text = std::fs::read_to_string(&robot).expect("read").replace("value=\"2\"", "value=\"7\"");
        std::fs::write(&copy, text).expect("written");
        // With the time of the file whose place it takes.
        let time = std::fs::metadata(&robot).and_then(|found| found.modified()).expect("a time");
        std::fs::File::options().write(true).open(&copy).and_then(|file| file.set_modified(time)).expect("set");
        std::fs::rename(&copy, &robot).expect("moved");
        let second = scene(folder.path());
        let mass = |scene: &Scene| scene.bodies.iter().last().map(|body| body.mass);
        assert_eq!((mass(&first), mass(&second)), (Some(2.0), Some(7.0)));
    }

    #[test]
    fn a_mesh_or_a_package_that_has_changed_is_looked_for_anew() {
        let folder = folder();
        settle(folder.path());
        let first = scene(folder.path());
        let larger = "v 0 0 0\nv 2 0 0\nv 0 2 0\nv 0 0 2\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
        write(folder.path(), "parts/stone.obj", larger);
        assert_eq!(kept(folder.path()), [true; 3], "the mesh is no part of the description");
        let (model, _) = model(&folder.path().join("robot.urdf")).expect("a robot");
        let rules = ShapeRules { profile: Profile::Legacy, is_simplified: false };
        let known = model.shapes(rules).iter().map(Option::is_some).collect::<Vec<_>>();
        assert_eq!(known, [true, false]);
        // A package by this name that is found first.
        let nearer = "<package><name>parts</name></package>\n";
        write(folder.path(), "package.xml", nearer);
        write(folder.path(), "stone.obj", larger);
        assert_eq!(kept(folder.path()), [true, true, false]);
        let second = scene(folder.path());
        assert_eq!(share(&first, &second), [true, true, false]);
    }

    #[test]
    fn what_was_written_just_now_is_not_shared() {
        let folder = folder();
        let before = Instant::now();
        let first = scene(folder.path());
        // Unless the machine was so slow that the files are old by now.
        assert!(before.elapsed() > Duration::from_millis(40) || kept(folder.path()) == [false; 3]);
        drop(first);
    }

    #[test]
    fn problems_of_a_file_are_told_to_every_world() {
        let folder = folder();
        write(folder.path(), "world.yaml", "environment: ./ground.yaml\nno such key: 1\n");
        settle(folder.path());
        let files = SceneFiles { world: Some(folder.path().join("world.yaml")), models: Vec::new() };
        let [first, second] = [(); 2].map(|()| load(&files, &SceneOptions::default()));
        assert!(first.report.to_string().contains("no such key"), "{}", first.report);
        assert_eq!(first.report.to_string(), second.report.to_string());
        assert_eq!(share(&first.scene, &second.scene), [true; 2]);
    }

    #[test]
    fn a_launch_file_is_shared_until_it_changes_or_nobody_keeps_it() {
        let folder = folder();
        let path = folder.path().join("launch.yaml");
        write(folder.path(), "launch.yaml", "world config: ./world.yaml\n");
        let mut sources = Sources::default();
        while !sources.are_settled() || sources == Sources::default() {
            std::thread::sleep(Duration::from_millis(5));
            sources = Sources::default();
            sources.add(&path);
        }
        let read = || shared_launch(&path).expect("a launch file").0;
        let first = read();
        assert!(Arc::ptr_eq(&first, &read()));
        write(folder.path(), "launch.yaml", "world config: ./other.yaml\n");
        assert_eq!(read().world_config, Some(folder.path().join("other.yaml")));
        drop(first);
        assert!(find(&LAUNCHES, &path).is_none());
    }

    #[test]
    fn models_that_are_added_later_share_too() {
        let folder = folder();
        settle(folder.path());
        let mut first = scene(folder.path());
        let (id, _) = first.add_model(PreparedModel::read(&folder.path().join("robot.urdf")).expect("a robot"));
        let copies: Vec<_> = first.models.iter().skip(1).map(|model| &model.description).collect();
        assert_eq!(copies.len(), 2);
        assert!(Arc::ptr_eq(copies[0], copies[1]));
        first.remove_model(id);
        assert_eq!(kept(folder.path()), [true; 3], "the other one is there");
    }
}
