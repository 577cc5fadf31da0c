//! Collision shapes that all worlds of this process have in common.
//!
//! A learner steps hundreds of worlds of the same files. What of a mesh costs memory and time is read-only once it is
//! made: points of a hull, triangles, their tree. It is kept for as long as any world uses it, and a world that is built
//! meanwhile takes it from here, without opening the files, if they are still what they were. What a world may change
//! is not shared: each has bodies, compounds and counters of locks of its own ([`ShapePattern`]).
//!
//! Shapes without a mesh are shared by worlds of one description only ([`SharedModel`](super::descriptions::SharedModel)),
//! which asks for no files: finding the size of a sphere that fits into a cylinder takes longer than all else of a body.
//!
//! Not shared: meshes of soft bodies and of sensors, whose vertices become nodes and rays of a world.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Weak};

use nalgebra::{Isometry3, Vector3};
use parking_lot::Mutex;

use super::descriptions::ShapeRules;
use super::shape::BuiltShape;
use crate::adf::{CollisionGeometry, PartGeometry, RigidBody, Severity};
use crate::bullet::ShapePattern;
use crate::mesh::{MeshCache, Sources};

/// All that the collision shape of a body depends on, beside the contents of its files.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct ShapeKey(String);

impl ShapeKey {
    /// `None`: no mesh is part of the shape.
    pub fn new(body: &RigidBody, rules: ShapeRules) -> Option<Self> {
        let ShapeRules { profile, is_simplified } = rules;
        let RigidBody { collision, collision_margin, scale, inertial_offset, mass, .. } = body;
        mesh_files(collision).next()?;
        // Numbers are written so that they are told apart by the last bit.
        let is_moved = *mass != 0.0;
        let text = format!(
            "{collision:?} {collision_margin:?} {scale:?} {inertial_offset:?} {profile:?} {is_simplified} {is_moved}"
        );
        Some(Self(text))
    }
}

/// Mesh files of a geometry.
fn mesh_files(collision: &CollisionGeometry) -> impl Iterator<Item = &std::path::Path> {
    let (one, parts) = match collision {
        CollisionGeometry::Mesh { path, .. } => (Some(path.as_path()), &[][..]),
        CollisionGeometry::Parts { parts, .. } => (None, &parts[..]),
        _ => (None, &[][..]),
    };
    let of_parts = parts.iter().filter_map(|part| match &part.geometry {
        PartGeometry::Mesh { path, .. } => Some(path.as_path()),
        PartGeometry::Primitive(_) | PartGeometry::Triangles(_) => None,
    });
    one.into_iter().chain(of_parts)
}

/// A shape that some world uses, and what was found when it was made.
#[derive(Debug, Clone)]
pub(super) struct SharedShape {
    pattern: Arc<ShapePattern>,
    inertial_offset: Isometry3<f64>,
    left_out: Vec<(Severity, String)>,
    inertias: Inertias,
    /// What its meshes were read from.
    sources: Arc<Sources>,
}

/// Moments of inertia that were estimated, by the bits of the mass. Those of a concave mesh are a sum over all triangles.
type Inertias = Arc<Mutex<Vec<(u64, Vector3<f64>)>>>;

/// Masses of one shape whose estimates are kept.
const MAX_MASSES: usize = 16;

impl SharedShape {
    /// The shape of a body without meshes.
    pub fn without_files(built: BuiltShape) -> Self {
        Self::new(built, Sources::default())
    }

    fn new(built: BuiltShape, sources: Sources) -> Self {
        let BuiltShape { shape, inertial_offset, left_out } = built;
        let (pattern, sources) = (Arc::new(ShapePattern::from(shape)), Arc::new(sources));
        Self { pattern, inertial_offset, left_out, inertias: Inertias::default(), sources }
    }

    /// Whether its files are still what they were.
    pub fn is_current(&self) -> bool {
        self.sources.are_current()
    }

    /// For a body of one more world, or one more body.
    pub fn built(&self) -> BuiltShape {
        BuiltShape {
            shape: self.pattern.twin(),
            inertial_offset: self.inertial_offset,
            left_out: self.left_out.clone(),
        }
    }

    /// [`Shape::inertia`](crate::bullet::Shape::inertia) for `mass` kg, computed by `estimate` unless it is known.
    pub fn inertia(&self, mass: f64, estimate: impl FnOnce() -> Vector3<f64>) -> Vector3<f64> {
        let known = |inertias: &[(u64, Vector3<f64>)]| {
            inertias.iter().find(|(bits, _)| *bits == mass.to_bits()).map(|(_, inertia)| *inertia)
        };
        if let Some(inertia) = known(&self.inertias.lock()) {
            return inertia;
        }
        let inertia = estimate();
        let mut inertias = self.inertias.lock();
        if inertias.len() < MAX_MASSES && known(&inertias).is_none() {
            inertias.push((mass.to_bits(), inertia));
        }
        inertia
    }
}

/// A [`SharedShape`] that is forgotten with the last world that uses it.
struct Kept {
    pattern: Weak<ShapePattern>,
    inertial_offset: Isometry3<f64>,
    left_out: Vec<(Severity, String)>,
    inertias: Inertias,
    sources: Arc<Sources>,
}

/// Of all worlds of this process.
static KEPT: LazyLock<Mutex<HashMap<ShapeKey, Kept>>> = LazyLock::new(Mutex::default);

/// The shape that some world already uses, if its files have not changed since.
pub(super) fn find(key: &ShapeKey) -> Option<SharedShape> {
    let found = {
        let kept = KEPT.lock();
        let Kept { pattern, inertial_offset, left_out, inertias, sources } = kept.get(key)?;
        let (left_out, inertias, sources) = (left_out.clone(), Arc::clone(inertias), Arc::clone(sources));
        SharedShape { pattern: pattern.upgrade()?, inertial_offset: *inertial_offset, left_out, inertias, sources }
    };
    // Files are asked for without the lock: they may be on a slow network.
    found.is_current().then_some(found)
}

/// Keeps the shape of a body whose meshes `meshes` has read, for as long as any world uses it. It comes back where
/// that could be wrong for others, because a mesh has changed just now.
pub(super) fn keep(
    key: ShapeKey,
    body: &RigidBody,
    built: BuiltShape,
    meshes: &MeshCache,
) -> Result<SharedShape, Box<BuiltShape>> {
    let mut sources = Sources::default();
    for path in mesh_files(&body.collision) {
        match meshes.sources(path) {
            Some(files) => sources.extend(&files),
            None => return Err(Box::new(built)),
        }
    }
    if !sources.are_settled() || !sources.are_current() {
        return Err(Box::new(built));
    }
    let shared = SharedShape::new(built, sources);
    let kept = Kept {
        pattern: Arc::downgrade(&shared.pattern),
        inertial_offset: shared.inertial_offset,
        left_out: shared.left_out.clone(),
        inertias: Arc::clone(&shared.inertias),
        sources: Arc::clone(&shared.sources),
    };
    let mut all = KEPT.lock();
    all.retain(|_, kept| kept.pattern.strong_count() > 0);
    all.insert(key, kept);
    Ok(shared)
}

/// Shapes of meshes that worlds of this process share at present.
pub fn shared_shapes() -> usize {
    KEPT.lock().values().filter(|kept| kept.pattern.strong_count() > 0).count()
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::{Duration, Instant};

    use super::*;
    use crate::scene::{load, Loaded, Scene, SceneFiles, SceneOptions};

    /// A folder with a model of two bodies of one mesh and one of another.
    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        let body = |name: &str, kind: &str| {
            format!("BODY {name}: {{name: {name}, mass: 1, mesh: {}.obj, collision mesh type: {kind}}}\n", &name[..1])
        };
        let bodies =
            ["bodies: [BODY a1, BODY a2, BODY b]\n".to_owned(), body("a1", "CONCAVE_MESH"), body("a2", "CONCAVE_MESH")];
        let text = bodies.concat() + &body("b", "CONVEX_HULL");
        let paths = "high resolution path: ./\nlow resolution path: ./\n";
        std::fs::write(folder.path().join("model.yaml"), text + paths).expect("written");
        write_mesh(folder.path(), "a", 1.0);
        write_mesh(folder.path(), "b", 1.0);
        folder
    }

    fn write_mesh(folder: &Path, name: &str, height: f64) {
        let text = format!(
            "mtllib {name}.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {height}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
        );
        std::fs::write(folder.join(name).with_extension("obj"), text).expect("written");
    }

    /// Waits until a later change would be seen.
    fn settle(folder: &Path) {
        let end = Instant::now() + Duration::from_secs(20);
        let is_settled = || {
            let mut sources = Sources::default();
            ["a.obj", "b.obj"].iter().for_each(|name| sources.add(&folder.join(name)));
            sources.are_settled()
        };
        while !is_settled() {
            assert!(Instant::now() < end, "the clock of the file system is ahead");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn scene(folder: &Path) -> Scene {
        let files = SceneFiles { world: None, models: vec![folder.join("model.yaml")] };
        let Loaded { scene, report } = load(&files, &SceneOptions::default());
        assert_eq!(report.errors(), 0, "{report}");
        assert_eq!(scene.bodies.len(), 3);
        scene
    }

    /// Keys of shapes from the folder that some world uses, and whether their files are still the same.
    fn kept(folder: &Path) -> Vec<bool> {
        let name = folder.to_string_lossy();
        let keys: Vec<_> = KEPT.lock().keys().filter(|key| key.0.contains(&*name)).cloned().collect();
        let is_used = |key: &ShapeKey| KEPT.lock().get(key).is_some_and(|kept| kept.pattern.strong_count() > 0);
        keys.iter().filter(|key| is_used(key)).map(|key| find(key).is_some()).collect()
    }

    #[test]
    fn worlds_of_the_same_files_share_shapes_until_the_last_is_gone() {
        let folder = folder();
        settle(folder.path());
        let first = scene(folder.path());
        assert_eq!(kept(folder.path()), [true, true]);
        let second = scene(folder.path());
        assert_eq!(kept(folder.path()), [true, true]);
        let inertia = |scene: &Scene| scene.bodies.iter().map(|body| body.inertia).collect::<Vec<_>>();
        assert_eq!(inertia(&first), inertia(&second));
        drop(first);
        assert_eq!(kept(folder.path()), [true, true]);
        drop(second);
        assert!(kept(folder.path()).is_empty());
    }

    #[test]
    fn a_file_that_has_changed_is_read_anew() {
        let folder = folder();
        settle(folder.path());
        let first = scene(folder.path());
        write_mesh(folder.path(), "b", 2.0);
        assert_eq!(kept(folder.path()).iter().filter(|is_current| **is_current).count(), 1);
        let second = scene(folder.path());
        let inertia = |scene: &Scene| scene.bodies.iter().last().map(|body| body.inertia);
        assert_ne!(inertia(&first), inertia(&second));
        // A file that was missing counts, too: this one decides how many parts the mesh has.
        settle(folder.path());
        let third = scene(folder.path());
        assert_eq!(kept(folder.path()), [true, true]);
        std::fs::write(folder.path().join("a.mtl"), "newmtl one\nnewmtl two\n").expect("written");
        assert_eq!(kept(folder.path()).iter().filter(|is_current| **is_current).count(), 1);
        drop((first, second, third));
    }

    #[test]
    fn what_was_written_just_now_is_not_shared() {
        let folder = folder();
        write_mesh(folder.path(), "a", 3.0);
        // Unless the machine was so slow that the file is old by now.
        let mut sources = Sources::default();
        sources.add(&folder.path().join("a.obj"));
        let scene = scene(folder.path());
        let was_young = !sources.are_settled();
        assert!(!was_young || kept(folder.path()).len() < 2);
        drop(scene);
    }
}
