//! Scenes as URDF: what a program that knows only URDF makes of them is what moves in the simulation.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use ambf_core::control::Profile;
use ambf_core::ids::BodyId;
use ambf_core::scene::{load, Loaded, PhysicsOptions, RobotDescription, Scene, SceneFiles, SceneOptions, WORLD_LINK};
use ambf_core::sim::Simulation;
use ambf_core::urdf;
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node};

use crate::physics_common::{load_texts, DT, HEAVY};

fn models() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/models");
    folder.read_dir().expect("models").map(|entry| entry.expect("readable").path()).collect()
}

/// All ADF files below a folder; those that are no models make scenes without bodies.
fn yaml_files(folder: &Path) -> Vec<PathBuf> {
    let entries = folder.read_dir().expect("readable folder").map(|entry| entry.expect("readable entry").path());
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|entry| entry.is_dir());
    let below = folders.iter().flat_map(|folder| yaml_files(folder));
    files.into_iter().filter(|file| file.extension().is_some_and(|of| of == "yaml")).chain(below).collect()
}

fn scene(model: PathBuf, profile: Profile) -> Scene {
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let options = SceneOptions { physics, ..SceneOptions::default() };
    load(&SceneFiles { world: None, models: vec![model] }, &options).scene
}

fn described(scene: &Scene) -> RobotDescription {
    // A body of the URDF model is called as the root is.
    let link = |body: BodyId| scene.bodies[body].identity.communication_name().replace(WORLD_LINK, "stand");
    RobotDescription::new(&scene.visuals(0), |body| Some(link(body)))
}

fn elements<'d>(document: &'d Document<'_>, tag: &'static str) -> impl Iterator<Item = Node<'d, 'd>> {
    document.root_element().children().filter(move |node| node.has_tag_name(tag))
}

fn link_of<'d>(joint: &Node<'d, 'd>, role: &str) -> &'d str {
    let end = joint.children().find(|node| node.has_tag_name(role)).expect("parent and child");
    end.attribute("link").expect("a link")
}

fn numbers(joint: &Node<'_, '_>, tag: &str, attribute: &str) -> Option<Vector3<f64>> {
    let text = joint.children().find(|node| node.has_tag_name(tag))?.attribute(attribute)?;
    let numbers: Vec<f64> = text.split(' ').map(|number| number.parse().expect("a number")).collect();
    Some(Vector3::from_column_slice(&numbers))
}

/// Pose of a joint's child in its parent at coordinate `q`, as <https://wiki.ros.org/urdf/XML/joint> says.
fn transform(joint: &Node<'_, '_>, q: f64) -> Isometry3<f64> {
    let turned = |rpy: Vector3<f64>| UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z);
    let rotation = numbers(joint, "origin", "rpy").map_or_else(UnitQuaternion::identity, turned);
    let origin = Translation3::from(numbers(joint, "origin", "xyz").unwrap_or_default()) * rotation;
    let axis = numbers(joint, "axis", "xyz").unwrap_or_else(Vector3::x);
    match joint.attribute("type") {
        Some("revolute" | "continuous") => origin * UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), q),
        Some("prismatic") => origin * Translation3::from(axis * q),
        _ => origin,
    }
}

/// Coordinate of the joint of the scene that joins these bodies.
fn coordinate(scene: &Scene, parent: BodyId, child: BodyId) -> f64 {
    let joins = |joint: &&ambf_core::scene::Joint| (joint.parent, joint.child) == (parent, child);
    scene.joints.iter().find(joins).expect("a joint of the scene").position
}

#[test]
fn links_are_where_their_joints_put_them() {
    let mut joints = 0;
    for model in models() {
        let mut simulation = Simulation::new(scene(model.clone(), Profile::Accurate), DT);
        let description = described(simulation.scene());
        for _ in 0..300 {
            simulation.update(DT).expect("a finite state");
        }
        let scene = simulation.scene();
        let body_of = |link: &str| description.frames.iter().find(|frame| frame.link == link).map(|frame| frame.body);
        let pose_of = |link: &str| {
            let frame = description.frames.iter().find(|frame| frame.link == link).expect("a frame for each link");
            scene.world.pose(scene.world.bodies()[frame.body.index()]).expect("a live body") * frame.pose
        };
        let document = Document::parse(&description.urdf).expect("XML");
        for joint in elements(&document, "joint") {
            let [parent, child] = ["parent", "child"].map(|role| link_of(&joint, role));
            if parent == WORLD_LINK {
                continue;
            }
            let ends = [body_of(parent), body_of(child)].map(|body| body.expect("a body"));
            let q = if ends[0] == ends[1] { 0.0 } else { coordinate(scene, ends[0], ends[1]) };
            let apart = (pose_of(parent) * transform(&joint, q)).inv_mul(&pose_of(child));
            let error = (apart.translation.vector.norm(), apart.rotation.angle());
            assert!(error.0 < 2e-3 && error.1 < 1e-2, "{}: {child}: {error:?}", model.display());
            joints += 1;
        }
    }
    assert!(joints > 60, "{joints}");
}

#[test]
fn every_description_is_one_tree_that_can_be_loaded_again() {
    let legacy = ambf_test_support::legacy().map(|folder| yaml_files(&folder)).unwrap_or_default();
    for model in models().into_iter().chain(legacy) {
        let scene = scene(model.clone(), Profile::Legacy);
        let description = described(&scene);
        let document = Document::parse(&description.urdf).expect("XML");
        let links: HashSet<_> = elements(&document, "link").filter_map(|link| link.attribute("name")).collect();
        assert_eq!(links.len(), elements(&document, "link").count(), "{}: names are unique", model.display());
        assert_eq!(links.len(), description.frames.len() + 1, "{}: a frame each", model.display());
        let parents: HashMap<_, _> =
            elements(&document, "joint").map(|joint| (link_of(&joint, "child"), link_of(&joint, "parent"))).collect();
        assert_eq!(parents.len(), links.len() - 1, "{}: one joint leads to each link", model.display());
        for link in &links {
            let depth = std::iter::successors(Some(link), |link| parents.get(*link)).take(links.len() + 1).count();
            assert!(depth <= links.len(), "{}: {link} hangs on itself", model.display());
        }
        let (again, report) = urdf::parse(&description.urdf, Path::new("again.urdf"), &urdf::Packages::default())
            .unwrap_or_else(|error| panic!("{}: {error}", model.display()));
        assert_eq!(report.errors(), 0, "{}: {report}", model.display());
        for body in again.bodies.iter().filter(|body| body.mass > 0.0) {
            // A link that only carries a joint has no mass in URDF; in a simulation it must have some.
            let mut before = scene.bodies.iter().filter(|old| old.identity.communication_name() == body.common.name);
            assert!(before.next().is_none_or(|old| old.mass == body.mass), "{}: {body:?}", model.display());
        }
    }
}

#[test]
fn what_urdf_cannot_say_floats_or_is_left_out() {
    let body = |name: &str, keys: &str| {
        format!("BODY {name}: {{name: \"{name}\", mass: 1, inertia: {{ix: 1, iy: 1, iz: 1}}, {keys}}}\n")
    };
    let joint = |name: &str, kind: &str, ends: [&str; 2]| {
        let ends = format!("parent: BODY {}, child: BODY {}", ends[0], ends[1]);
        let pivots = "parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 1}";
        let axes = "parent axis: {x: 0, y: 1, z: 0}, child axis: {x: 0, y: 1, z: 0}";
        format!("{name}: {{name: J, type: {kind}, {ends}, {pivots}, {axes}}}\n")
    };
    let folder = tempfile::tempdir().expect("a folder");
    let mesh = folder.path().join("a b&c.stl");
    let triangle = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    std::fs::write(&mesh, format!("solid a\n{triangle}endsolid a\n")).expect("written");
    let text = "bodies: [BODY a, BODY b, BODY c, 'BODY <d>']\njoints: [J1, J2, J3]\n".to_owned()
        + &body("a", "shape: Capsule, geometry: {radius: 1, height: 5, axis: X}")
        + &body("b", "shape: Cone, geometry: {radius: 1, height: 5}")
        + &body("c", &format!("mesh: \"{}\", scale: 2", mesh.display()))
        + &body("<d>", "")
        + &joint("J1", "continuous", ["a", "b"])
        + &joint("J2", "prismatic", ["b", "a"])
        + &joint("J3", "p2p", ["a", "c"]);
    let Loaded { scene, .. } = load_texts(HEAVY, &[&text]);
    let description = described(&scene);
    let document = Document::parse(&description.urdf).expect("XML");
    let joints: Vec<_> = elements(&document, "joint")
        .map(|joint| (joint.attribute("type").unwrap_or_default(), link_of(&joint, "parent"), link_of(&joint, "child")))
        .collect();
    let expected = [
        ("floating", WORLD_LINK, "a"),
        ("continuous", "a", "b__joint"),
        ("fixed", "b__joint", "b"),
        ("floating", WORLD_LINK, "c"),
        ("floating", WORLD_LINK, "<d>"),
    ];
    assert_eq!(joints, expected, "J2 closes a loop, J3 is a ball joint");
    let shapes = |link: &str| -> Vec<String> {
        let link = elements(&document, "link").find(|node| node.attribute("name") == Some(link)).expect("a link");
        let visuals = link.children().filter(|node| node.has_tag_name("visual"));
        let geometry = |visual: Node<'_, '_>| {
            let geometry = visual.children().find(|node| node.has_tag_name("geometry")).expect("a geometry");
            let shape = geometry.first_element_child().expect("a shape");
            shape.attributes().fold(shape.tag_name().name().to_owned(), |text, attribute| {
                format!("{text} {}={}", attribute.name(), attribute.value())
            })
        };
        visuals.map(geometry).collect()
    };
    assert_eq!(shapes("a"), ["cylinder radius=1 length=3", "sphere radius=1", "sphere radius=1"]);
    assert!(shapes("b").is_empty());
    assert_eq!(shapes("c"), [format!("mesh filename=file://{} scale=2 2 2", mesh.display())]);
}

#[test]
fn bodies_without_a_name_and_removed_ones_are_left_out() {
    let text = "bodies: [BODY a, BODY b]\nBODY a: {name: a, mass: 1, inertia: {ix: 1, iy: 1, iz: 1}}\n\
                BODY b: {name: b, mass: 1, inertia: {ix: 1, iy: 1, iz: 1}}\n";
    let Loaded { scene, .. } = load_texts(HEAVY, &[text]);
    let mut visuals = scene.visuals(0);
    let links = |description: RobotDescription| -> Vec<String> {
        description.frames.into_iter().map(|frame| frame.link).collect()
    };
    let first = BodyId::new(0);
    let named = |body: BodyId| (body != first).then(|| format!("link{}", body.index()));
    assert_eq!(links(RobotDescription::new(&visuals, named)), ["link1"]);
    visuals.bodies[BodyId::new(1)].object.removed = true;
    assert_eq!(links(RobotDescription::new(&visuals, |body| Some(format!("link{}", body.index())))), ["link0"]);
}
