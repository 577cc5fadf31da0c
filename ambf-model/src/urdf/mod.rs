//! URDF, the unified robot description format of ROS: XML to the description that ADF files have.
//!
//! [`load`] gives an [`adf::Model`](crate::adf::Model), so that a robot is simulated, driven and published as an ADF
//! model. What becomes of each element is in `docs/urdf.md`; the format is that of <https://wiki.ros.org/urdf/XML>.
//!
//! ## Limitations
//! * Transmissions, sensors and what simulators add in `<gazebo>` have no effect, but for `self_collide`; they are
//!   reported.
//! * Textures are not used.

mod convert;
mod geometry;
mod inertia;
mod joint;
mod link;
mod package;
mod tree;

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::path::Path;

pub use package::{PackagePlaces, Packages};

use crate::adf::{read_bytes, text_of, LoadError, Model, ProblemKind, Report};
use crate::xml::{quoted, Element, File};
use geometry::Materials;
use joint::Joint;
use link::Link;

/// Reads a robot description. Packages are looked for with [`Packages::around`]; meshes are not opened.
///
/// Bodies are `BODY <link>`, joints `JOINT <joint>`, in the namespace `/ambf/env/<robot>/`; the root stands at the
/// origin of the world, joints at zero or at the limit next to it.
///
/// The report lists what was dropped, replaced or not used.
///
/// # Errors
/// [`LoadError`]: the file is unreadable, larger than 64 MiB, no text, no XML, no `<robot>`, still to be processed by xacro, or has
/// numbers or names that cannot be read (then all of them are reported).
pub fn load(path: &Path) -> Result<(Model, Report), LoadError> {
    let bytes = read_bytes(path)?;
    parse(text_of(&bytes, path)?, path, &Packages::around(path))
}

/// Reads a text as [`load`] reads a file; `path` stands for its name. With the default `packages` no file is looked at.
///
/// # Errors
/// As [`load`], except that nothing is unreadable.
pub fn parse(text: &str, path: &Path, packages: &Packages) -> Result<(Model, Report), LoadError> {
    let is_xacro = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("xacro"));
    if is_xacro {
        return Err(LoadError::Xacro { at: File::new("", path).start() });
    }
    let text = text_of(text.as_bytes(), path)?;
    let file = File::new(text, path);
    let model = {
        let document = file.parse()?;
        read(&Element::root(&document, &file)?.expect_tag(&["robot"])?, packages)
    };
    let report = file.into_report();
    if report.is_fatal() {
        return Err(LoadError::Refused { file: path.into(), report });
    }
    Ok((model, report))
}

fn read(robot: &Element<'_>, packages: &Packages) -> Model {
    let known = ["link", "joint", "material", "gazebo", "transmission", "ros2_control", "sensor"];
    robot.finish(&["name", "version"], &known);
    let namespace = namespace(robot);
    let materials = Materials::read(robot);

    let mut indices = HashMap::new();
    let mut links = Vec::new();
    for element in robot.children("link") {
        let link = Link::read(element, packages, &materials);
        match indices.entry(link.name) {
            Entry::Vacant(entry) => {
                entry.insert(links.len());
                links.push(link);
            }
            Entry::Occupied(_) => twice(&element),
        }
    }
    if links.is_empty() {
        robot.error(ProblemKind::Absent, "link", "", "at least one link", "the model is empty");
    }
    let mut names = HashMap::new();
    let mut joints: Vec<Joint<'_>> = Vec::new();
    for joint in robot.children("joint").filter_map(|element| Joint::read(element, &indices)) {
        match names.entry(joint.name) {
            Entry::Vacant(entry) => {
                entry.insert(());
                joints.push(joint);
            }
            Entry::Occupied(_) => twice(&joint.element),
        }
    }
    let places = tree::places(&links, &mut joints);
    let names: Vec<String> = links.iter().map(|link| link.name.to_owned()).collect();
    let self_collision = self_collision(robot);
    let path = robot.file().path();
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Model {
        bodies: convert::bodies(links, &places, &namespace, &self_collision.links),
        joints: convert::joints(&names, &places, &joints, &namespace),
        ignore_inter_collision: !self_collision.all,
        has_massless_links: places.iter().any(|place| place.load.is_some_and(|load| load.is_carried)),
        ..Model::empty(name, namespace, path.clone())
    }
}

fn twice(element: &Element<'_>) {
    let (tag, name) = (element.tag(), quoted(element.attribute("name").unwrap_or_default()));
    let found = format!("is not the first {tag} called {name}");
    element.error(ProblemKind::Structure, "", &found, "", &format!("this {tag} is dropped"));
}

/// `/ambf/env/` and the name of the robot, without blanks, or without a name that of the file.
fn namespace(robot: &Element<'_>) -> String {
    let file = robot.file().path().file_stem().unwrap_or_default().to_string_lossy();
    let is_named = robot.attribute("name").is_some_and(|name| !name.trim().is_empty());
    let name = if is_named {
        robot.need_name("name", "a name")
    } else {
        let action = format!("that of the file is used, {}", quoted(&file));
        match robot.attribute("name") {
            Some(found) => {
                robot.warn(ProblemKind::OutOfRange, "name", &quoted(found), "the name of the robot", &action)
            }
            None => robot.warn(ProblemKind::Absent, "name", "", "the name of the robot", &action),
        }
        &file
    };
    let name: String = name.split_whitespace().collect();
    match name.trim_matches('/') {
        "" => "/ambf/env/".to_owned(),
        name => format!("/ambf/env/{name}/"),
    }
}

/// Which links collide with others of the robot: what Gazebo is told counts, by default none. What else concerns other
/// programs is reported.
fn self_collision<'a>(robot: &Element<'a>) -> SelfCollision<'a> {
    let mut collision = SelfCollision::default();
    for element in robot.elements() {
        match element.tag() {
            "gazebo" => {
                let is_setting = |e: &Element<'_>| matches!(e.tag(), "self_collide" | "selfCollide");
                if element.elements().any(|e| is_setting(&e) && matches!(e.text(), "true" | "1")) {
                    match element.attribute("reference") {
                        Some(link) => _ = collision.links.insert(link),
                        None => collision.all = true,
                    }
                }
                if !element.elements().all(|e| is_setting(&e)) {
                    element.ignored("", "of this only `self_collide` is");
                }
            }
            "transmission" | "ros2_control" | "sensor" => element.ignored("", "it concerns other programs"),
            _ => (),
        }
    }
    collision
}

/// Links that collide with others of their robot.
#[derive(Default)]
struct SelfCollision<'a> {
    /// Every link.
    all: bool,
    /// By name.
    links: HashSet<&'a str>,
}

#[cfg(test)]
mod tests;
