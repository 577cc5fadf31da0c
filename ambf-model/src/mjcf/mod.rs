//! MJCF, the robot description format of MuJoCo: XML to the description that ADF files have.
//!
//! [`load`] gives an [`adf::Model`](crate::adf::Model), so that a robot is simulated, driven and published as an ADF model. What
//! becomes of each element is in `docs/mjcf.md`; the format is that of <https://mujoco.readthedocs.io/en/stable/XMLreference.html>.
//!
//! ## Limitations
//! * Constraints are hard: `solref`, `solimp` and their like have no effect.
//! * Deformable bodies, spatial tendons, muscles, plugins and textures are left out, and reported.

mod actuator;
mod asset;
mod body;
mod classes;
mod contact;
mod convert;
mod field;
mod geom;
mod hull;
mod joint;
mod keyframe;
mod mass;
mod mobility;
mod relation;
mod sensor;
mod settings;
mod source;
mod view;

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use roxmltree::Document;

pub use source::Surroundings;

use crate::adf::{read_bytes, text_of, Joint as AdfJoint, JointKind, LoadError, Model, ProblemKind, Report};
use crate::mesh::Sources;
use crate::xml::{quoted, Element, File};
use actuator::{ActuatorText, Drives};
use asset::Assets;
use body::{Bodies, Reading};
use classes::Classes;
use convert::{adf_joint, body_identifier, common, convert, Context};
use settings::{finish, Compiler, Options, SOFT};
use source::{Source, Texts};

/// Reads a description. Included files are read; meshes only where their volume says a mass.
///
/// Bodies are `BODY <body>`, joints `JOINT <joint>`, in the namespace `/ambf/env/<model>/`. Everything stands as it is written.
///
/// The report lists what was dropped, replaced or not used.
///
/// # Errors
/// [`LoadError`]: a file is unreadable, larger than 64 MiB, no text, no XML, no `<mujoco>`, is included twice, or has numbers or
/// words that cannot be read (then all of them are reported).
pub fn load(path: &Path) -> Result<(Model, Report), LoadError> {
    let bytes = read_bytes(path)?;
    parse(text_of(&bytes, path)?, path, Surroundings::Disk)
}

/// Reads a text as [`load`] reads a file; `path` stands for its name.
///
/// # Errors
/// As [`load`].
pub fn parse(text: &str, path: &Path, surroundings: Surroundings) -> Result<(Model, Report), LoadError> {
    parse_with_files(text, path, surroundings).map(|(model, report, _)| (model, report))
}

/// [`parse`], and the other files that were read: together with this one they decide what is read.
///
/// # Errors
/// As [`load`].
pub fn parse_with_files(
    text: &str,
    path: &Path,
    surroundings: Surroundings,
) -> Result<(Model, Report, Sources), LoadError> {
    let text = text_of(text.as_bytes(), path)?;
    let texts = Texts::gather(text.to_owned(), path, surroundings)?;
    let files: Vec<File<'_>> = texts.all.iter().map(|(path, text)| File::new(text, path)).collect();
    let (model, read) = {
        let documents: Vec<Document<'_>> = files.iter().map(File::parse).collect::<Result<_, _>>()?;
        let roots = documents.iter().zip(&files).map(|(document, file)| Element::root(document, file));
        let source = Source { roots: roots.collect::<Result<_, _>>()?, includes: &texts.includes };
        read(&source, surroundings, path)
    };
    let mut report = Report::default();
    files.into_iter().for_each(|file| report.append(file.into_report()));
    if report.is_fatal() {
        return Err(LoadError::Refused { file: path.into(), report });
    }
    let mut sources = texts.sources;
    sources.extend(&read);
    Ok((model, report, sources))
}

/// Sections of a description.
const SECTIONS: [&str; 16] = [
    "compiler",
    "option",
    "size",
    "visual",
    "statistic",
    "default",
    "asset",
    "worldbody",
    "contact",
    "equality",
    "tendon",
    "actuator",
    "sensor",
    "keyframe",
    "custom",
    "extension",
];

fn read(source: &Source<'_>, surroundings: Surroundings, path: &Path) -> (Model, Sources) {
    let root = source.roots[0];
    finish(&root, &["model"], &[], &[&SECTIONS[..], &["deformable"]].concat());
    let all = source.elements(&root);
    let sections = |tag: &str| all.iter().filter(|element| element.tag() == tag).copied().collect::<Vec<_>>();
    let mut compiler = Compiler::default();
    sections("compiler").iter().for_each(|section| compiler.apply(section, path));
    let mut options = Options::default();
    sections("option").iter().for_each(|section| options.apply(section));
    for tag in ["deformable", "extension"] {
        for section in sections(tag) {
            section.error(ProblemKind::IgnoredKey, "", "", "", "it is left out");
        }
    }
    let classes = Classes::read(&sections("default"), source, &compiler);
    let assets = Assets::read(&sections("asset"), source, &classes, &compiler, surroundings, path);
    let reading = Reading { source, classes: &classes, assets: &assets, compiler: &compiler };
    let mut bodies = reading.bodies(&sections("worldbody"));
    if bodies.all.len() < 2 && bodies.all.iter().all(|world| world.geoms.is_empty()) {
        root.error(ProblemKind::Absent, "worldbody", "", "bodies or geoms", "the model is empty");
    }
    scale_to_total(&mut bodies, compiler.total_mass);

    let equalities: Vec<Element<'_>> = sections("equality")
        .iter()
        .flat_map(|section| {
            finish(
                section,
                &[],
                &[],
                &["connect", "weld", "joint", "tendon", "flex", "distance", "flexvert", "flexstrain"],
            );
            source.elements(section)
        })
        .filter(|_| options.has_equalities)
        .collect();
    let tendons = relation::tendons(&sections("tendon"), source, &classes, &compiler, &mut bodies);
    let couplings = relation::couplings(&equalities, &classes, &tendons, &bodies);
    let arms = tendons.arms(&couplings);
    let mut drives = Drives::new();
    for section in sections("actuator") {
        let kinds: Vec<&str> =
            ["general", "motor", "position", "velocity", "intvelocity", "orientation", "pid", "damper"]
                .into_iter()
                .chain(["cylinder", "muscle", "adhesion", "dcmotor", "plugin"])
                .collect();
        finish(&section, &[], &[], &kinds);
        for element in source.elements(&section).iter().filter(|_| options.has_actuators) {
            let mut text = classes.of(element, None).actuator.clone();
            if ActuatorText::is_kind(element.tag()) {
                text.apply(element);
                actuator::add(element, &text, &compiler, &bodies.joints, &arms, &mut drives);
            }
        }
    }
    mobility::set_ratios(&mut bodies, &mut drives);
    let exceptions = contact::read(&sections("contact"), source, &mut bodies);
    let namespace = namespace(&root, path);
    let loops = loops(&equalities, &classes, &bodies);
    let context =
        Context { namespace: &namespace, options: &options, has_loops: !loops.is_empty(), exceptions: &exceptions };
    let mut converted = convert(&bodies, &context, &drives, &couplings);
    close(&loops, &bodies, &context, &mut converted);
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut model = Model {
        bodies: converted.bodies,
        joints: converted.joints,
        has_massless_links: converted.has_massless,
        gravity: Some(options.gravity),
        ..Model::empty(name, namespace.clone(), path.into())
    };
    add_views(&mut model, &bodies, &classes, &compiler);
    sensor::add(&mut model, &sections("sensor"), source, &bodies);
    model.keyframes = keyframe::read(&sections("keyframe"), source, &bodies, &model);
    (model, assets.read.take())
}

/// Makes all masses together `total`, kg, if it is above 0.
fn scale_to_total(bodies: &mut Bodies<'_>, total: f64) {
    let sum: f64 = bodies.all.iter().map(|body| body.mass.mass).sum();
    if total > 0.0 && sum > 0.0 {
        for body in &mut bodies.all {
            body.mass.mass *= total / sum;
            if let Some((moments, _)) = &mut body.principal {
                *moments *= total / sum;
            }
        }
    }
}

/// `/ambf/env/` and the name of the model, without blanks, or without a name that of the file.
fn namespace(root: &Element<'_>, path: &Path) -> String {
    let file = path.file_stem().unwrap_or_default().to_string_lossy();
    let written = root.attribute("model").filter(|name| !name.trim().is_empty());
    let name = written.map_or_else(|| file.clone(), |_| root.need_name("model", "a name").into());
    let name: String = name.split_whitespace().collect();
    match name.trim_matches('/') {
        "" => "/ambf/env/".to_owned(),
        name => format!("/ambf/env/{name}/"),
    }
}

/// An equality that holds two bodies together.
struct Loop<'a> {
    element: Element<'a>,
    kind: JointKind,
    /// Indices of the bodies, and the frames on them that are one.
    ends: [(usize, Isometry3<f64>); 2],
}

/// Equalities of kind `connect` and `weld`.
fn loops<'a>(equalities: &[Element<'a>], classes: &Classes<'a>, bodies: &Bodies<'a>) -> Vec<Loop<'a>> {
    let mut loops = Vec::new();
    for element in equalities {
        let kind = match element.tag() {
            "connect" => JointKind::PointToPoint,
            "weld" => JointKind::Fixed,
            "joint" | "tendon" => continue,
            _ => {
                element.error(ProblemKind::IgnoredKey, "", "", "", "the equality is left out");
                continue;
            }
        };
        let read = ["name", "class", "active", "body1", "body2", "site1", "site2", "anchor", "relpose", "torquescale"];
        finish(element, &read, &[SOFT], &[]);
        if !classes.is_active(element) {
            continue;
        }
        let Some(ends) = ends(element, bodies, kind == JointKind::Fixed) else { continue };
        if ends[0].0 == ends[1].0 || ends.iter().all(|(body, _)| bodies.all[*body].is_static) {
            let found = "holds what stands still, or one body";
            element.error(ProblemKind::Structure, "", found, "bodies that move", "the equality is left out");
            continue;
        }
        loops.push(Loop { element: *element, kind, ends });
    }
    loops
}

fn ends<'a>(element: &Element<'a>, bodies: &Bodies<'a>, is_weld: bool) -> Option<[(usize, Isometry3<f64>); 2]> {
    let left_out = "the equality is left out";
    if element.attribute("site1").is_some() {
        let site = |key: &'static str| {
            let name = element.need(key, "the name of a site");
            let found = bodies.sites.get(name);
            if found.is_none() && !name.is_empty() {
                element.error(ProblemKind::UnknownValue, key, &quoted(name), "the name of a site", left_out);
            }
            found.map(|site| (site.body, site.pose))
        };
        return Some([site("site1")?, site("site2")?]);
    }
    let body = |key: &'static str| {
        let name = element.attribute(key)?;
        let found = bodies.by_name.get(name).copied();
        if found.is_none() {
            element.error(ProblemKind::UnknownValue, key, &quoted(name), "the name of a body", left_out);
        }
        Some(found)
    };
    let Some(first) = body("body1") else {
        element.error(ProblemKind::Absent, "body1", "", "the name of a body, or of two sites", left_out);
        return None;
    };
    let (first, second) = (first?, body("body2").unwrap_or(Some(0))?);
    let pose = |index: usize| bodies.all[index].in_world;
    let anchor = Isometry3::from(element.vector("anchor").unwrap_or_default());
    if !is_weld {
        // In the frame of the first body, where both are as they are written.
        return Some([(first, anchor), (second, pose(second).inverse() * pose(first) * anchor)]);
    }
    // Pose of the second body in the first; with a quaternion of zeros as they are written.
    let relative: Option<[f64; 7]> = element.numbers("relpose");
    let relative = relative.and_then(|[x, y, z, w, i, j, k]| {
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), f64::MIN_POSITIVE)?;
        Some(Isometry3::from_parts(Vector3::new(x, y, z).into(), rotation))
    });
    let relative = relative.unwrap_or_else(|| pose(first).inverse() * pose(second));
    // The anchor is in the frame of the second body.
    Some([(first, relative * anchor), (second, anchor)])
}

/// Adds the joints that close loops.
fn close(loops: &[Loop<'_>], bodies: &Bodies<'_>, context: &Context<'_>, converted: &mut convert::Converted) {
    for (number, Loop { element, kind, ends }) in loops.iter().enumerate() {
        // An equality may be called as a joint is.
        let name = element.attribute("name").map_or_else(|| format!("equality{number}"), str::to_owned);
        let name = converted.joint_names.give(name);
        let [(first, in_first), (second, in_second)] = ends;
        if [*first, *second].contains(&0) && !converted.has_world {
            converted.has_world = true;
            converted.bodies.push(convert::world(&bodies.all[0], context));
        }
        let joint = AdfJoint {
            parent: body_identifier(&bodies.all[*first].name),
            child: body_identifier(&bodies.all[*second].name),
            parent_pivot: in_first.translation.vector,
            child_pivot: in_second.translation.vector,
            parent_axis: in_first.rotation * Vector3::z(),
            child_axis: in_second.rotation * Vector3::z(),
            child_rotation: Some(in_first.rotation * in_second.rotation.inverse()),
            ..adf_joint(&name, element.source(), kind.clone(), context)
        };
        converted.joints.push(joint);
    }
}

/// Adds cameras and lights.
fn add_views<'a>(model: &mut Model, bodies: &Bodies<'a>, classes: &Classes<'a>, compiler: &Compiler) {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    for (element, body, outer, class) in &bodies.views {
        let count = counts.entry(element.tag()).or_default();
        let name = element.attribute("name").map_or_else(|| format!("{}{count}", element.tag()), str::to_owned);
        *count += 1;
        // The world stands at the origin, whether it is a body or not.
        let parent = if *body == 0 { String::new() } else { body_identifier(&bodies.all[*body].name) };
        let words = if element.tag() == "camera" { "CAMERA" } else { "LIGHT" };
        let common = common(&format!("{words} {name}"), &name, &model.namespace, element.source());
        let class = classes.of(element, *class);
        if element.tag() == "camera" {
            let pose = outer * compiler.pose(element, Isometry3::identity());
            model.cameras.extend(view::camera(element, class.fov, common, parent, &pose));
        } else {
            let mut text = class.light.clone();
            text.apply(element);
            model.lights.extend(text.light(common, parent, outer, element));
        }
    }
}

#[cfg(test)]
mod tests;
