//! What is drawn and what collides of a link.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::package::Packages;
use crate::adf::{Axis, Material, Part, PartGeometry, Primitive, ProblemKind, Severity, VisualPart};
use crate::xml::{quoted, Element, Id};

/// The materials that a robot defines, by itself or in its visuals.
pub(super) struct Materials<'a> {
    /// The first definition of each name.
    by_name: HashMap<&'a str, Id>,
    /// `None`: only a texture.
    colours: HashMap<Id, Option<Material>>,
}

impl<'a> Materials<'a> {
    pub fn read(robot: &Element<'a>) -> Self {
        let mut materials = Self { by_name: HashMap::new(), colours: HashMap::new() };
        for element in robot.children("material") {
            element.need_name("name", "a name");
            materials.define(&element);
        }
        let visuals = robot.children("link").flat_map(|link| link.children("visual"));
        for element in visuals.flat_map(|visual| visual.children("material")) {
            materials.define(&element);
        }
        materials
    }

    fn define(&mut self, element: &Element<'a>) {
        element.finish(&["name"], &["color", "texture"]);
        let (color, texture) = (element.child("color"), element.child("texture"));
        if let Some(texture) = &texture {
            texture.ignored("", "only colours are");
        }
        if color.is_none() && texture.is_none() {
            return;
        }
        if let Some(name) = element.attribute("name") {
            self.by_name.entry(name).or_insert(element.id());
        }
        self.colours.insert(element.id(), color.and_then(|color| colour(&color)));
    }

    /// The material of a visual.
    fn of(&self, visual: &Element<'a>) -> Option<Material> {
        let element = visual.child("material")?;
        let name = element.attribute("name").unwrap_or_default();
        let found = self.colours.get(&element.id()).or_else(|| self.colours.get(self.by_name.get(name)?));
        if found.is_none() {
            let expected = "the name of a material with a colour";
            element.warn(ProblemKind::UnknownValue, "name", &quoted(name), expected, "the shape keeps its own colours");
        }
        found.cloned().flatten()
    }
}

fn colour(color: &Element<'_>) -> Option<Material> {
    color.finish(&["rgba"], &[]);
    color.need("rgba", "red, green, blue and opacity from 0 to 1");
    let [red, green, blue, alpha] = color.numbers::<4>("rgba")?;
    let diffuse = [red, green, blue];
    // Ambient light as for `color rgba` in ADF.
    Some(Material { ambient: diffuse.map(|c| 0.5 * c), diffuse, alpha, ..Material::default() })
}

/// Reads the `collision` elements of a link.
pub(super) fn collisions(link: &Element<'_>, packages: &Packages) -> Vec<Part> {
    let parts = link.children("collision").filter_map(|collision| {
        collision.finish(&["name"], &["origin", "geometry"]);
        part(&collision, packages, Severity::Error)
    });
    parts.collect()
}

/// Reads the `visual` elements of a link.
pub(super) fn visuals<'a>(link: &Element<'a>, packages: &Packages, materials: &Materials<'a>) -> Vec<VisualPart> {
    let parts = link.children("visual").filter_map(|visual| {
        visual.finish(&["name"], &["origin", "geometry", "material"]);
        let material = materials.of(&visual);
        // What is not drawn changes nothing that moves.
        Some(VisualPart { part: part(&visual, packages, Severity::Warning)?, material })
    });
    parts.collect()
}

/// A shape at its origin; `None` when there is none that can be used, which is reported.
fn part(element: &Element<'_>, packages: &Packages, severity: Severity) -> Option<Part> {
    let offset = element.origin();
    let left_out = format!("the {} is left out", element.tag());
    let expected = "box, sphere, cylinder, capsule or mesh";
    let Some(geometry) = element.child("geometry") else {
        element.problem(severity, ProblemKind::Absent, "geometry", "", expected, &left_out);
        return None;
    };
    let mut shapes = geometry.elements();
    let Some(shape) = shapes.next() else {
        geometry.problem(severity, ProblemKind::Absent, "", "", expected, &left_out);
        return None;
    };
    if let Some(second) = shapes.next() {
        second.ignored("", "the first shape counts; write one element for each");
    }
    let geometry = match shape.tag() {
        "box" => {
            shape.finish(&["size"], &[]);
            PartGeometry::Primitive(Primitive::Box { size: Vector3::from(shape.lengths::<3>("size")?) })
        }
        "sphere" => {
            shape.finish(&["radius"], &[]);
            let [radius] = shape.lengths("radius")?;
            PartGeometry::Primitive(Primitive::Sphere { radius })
        }
        tag @ ("cylinder" | "capsule") => {
            shape.finish(&["radius", "length"], &[]);
            let (radius, length) = (shape.lengths::<1>("radius"), shape.lengths::<1>("length"));
            let ([radius], [length], axis) = (radius?, length?, Axis::Z);
            PartGeometry::Primitive(match tag {
                "cylinder" => Primitive::Cylinder { radius, height: length, axis },
                // URDF gives the part between the caps, ADF the total height.
                _ => Primitive::Capsule { radius, height: length + 2.0 * radius, axis },
            })
        }
        "mesh" => mesh(&shape, packages, severity, &left_out)?,
        other => {
            geometry.problem(severity, ProblemKind::UnknownValue, "", &quoted(other), expected, &left_out);
            return None;
        }
    };
    Some(Part { geometry, offset })
}

fn mesh(shape: &Element<'_>, packages: &Packages, severity: Severity, left_out: &str) -> Option<PartGeometry> {
    shape.finish(&["filename", "scale"], &[]);
    let scale = shape.vector("scale").unwrap_or(Vector3::repeat(1.0));
    if scale.iter().any(|factor| *factor == 0.0) {
        let found = quoted(shape.attribute("scale").unwrap_or_default());
        shape.problem(severity, ProblemKind::OutOfRange, "scale", &found, "three factors other than 0", left_out);
        return None;
    }
    let filename = shape.need("filename", "the path of a mesh file").trim();
    match mesh_path(filename, shape.file().path(), packages) {
        Ok(path) => Some(PartGeometry::Mesh { path, scale }),
        Err(expected) => {
            shape.problem(severity, ProblemKind::UnknownValue, "filename", &quoted(filename), &expected, left_out);
            None
        }
    }
}

/// The file that a mesh's `filename` in the description `urdf` means, or what was expected instead.
fn mesh_path(filename: &str, urdf: &Path, packages: &Packages) -> Result<PathBuf, String> {
    if let Some(rest) = filename.strip_prefix("package://") {
        // Some tools write a third slash.
        let rest = decoded(rest.trim_start_matches('/'));
        let (name, inside) = rest.split_once('/').unwrap_or((&rest, ""));
        let folder = packages.find(name);
        return folder.map(|folder| folder.join(inside.trim_start_matches('/'))).ok_or_else(|| {
            "a package in a folder above the file or below one in ROS_PACKAGE_PATH, which should name its workspace"
                .into()
        });
    }
    if let Some(rest) = filename.strip_prefix("file:") {
        let rest = rest.strip_prefix("//").unwrap_or(rest);
        return Ok(beside(urdf, &decoded(rest)));
    }
    if filename.is_empty() || filename.contains("://") {
        return Err("package://name/path, file:///path, or a path relative to the file".into());
    }
    Ok(beside(urdf, filename))
}

/// The rest of a URI with each `%` and two hexadecimal digits replaced by the byte that they stand for, as RFC 3986, 2.1, says. A
/// text that would not be UTF-8 then stays as it is, and so does a `%` without digits.
fn decoded(text: &str) -> Cow<'_, str> {
    if !text.contains('%') {
        return Cow::Borrowed(text);
    }
    let bytes = text.as_bytes();
    let digit = |at: usize| bytes.get(at).and_then(|byte| char::from(*byte).to_digit(16));
    let (mut out, mut at) = (Vec::with_capacity(bytes.len()), 0);
    while let Some(&byte) = bytes.get(at) {
        match (byte, digit(at + 1), digit(at + 2)) {
            (b'%', Some(high), Some(low)) => {
                out.push((16 * high + low) as u8);
                at += 3;
            }
            _ => {
                out.push(byte);
                at += 1;
            }
        }
    }
    String::from_utf8(out).map_or(Cow::Borrowed(text), Cow::Owned)
}

fn beside(urdf: &Path, path: &str) -> PathBuf {
    urdf.parent().unwrap_or(Path::new("")).join(path)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::*;
    use crate::adf::{CollisionGeometry, RigidBody, VisualGeometry};

    fn link(inside: &str) -> String {
        format!("<robot name='r'><link name='a'>{inside}</link></robot>")
    }

    fn body(inside: &str) -> RigidBody {
        clean(&link(inside)).bodies.remove(0)
    }

    fn collision(geometry: &str) -> String {
        format!("<collision><origin xyz='1 2 3' rpy='0 0 1'/><geometry>{geometry}</geometry></collision>")
    }

    #[test]
    fn all_shapes() {
        let shapes = [
            "<box size='1 2 3'/>",
            "<sphere radius='4'/>",
            "<cylinder radius='1' length='2'/>",
            "<capsule radius='1' length='2'/>",
            "<mesh filename='m.stl' scale='1 -2 3e-3'/>",
        ];
        let body = body(&shapes.map(collision).concat());
        let CollisionGeometry::Parts { parts, .. } = body.collision else { panic!() };
        let axis = Axis::Z;
        let expected = [
            PartGeometry::Primitive(Primitive::Box { size: Vector3::new(1.0, 2.0, 3.0) }),
            PartGeometry::Primitive(Primitive::Sphere { radius: 4.0 }),
            PartGeometry::Primitive(Primitive::Cylinder { radius: 1.0, height: 2.0, axis }),
            PartGeometry::Primitive(Primitive::Capsule { radius: 1.0, height: 4.0, axis }),
            PartGeometry::Mesh { path: "dir/m.stl".into(), scale: Vector3::new(1.0, -2.0, 0.003) },
        ];
        assert_eq!(parts.iter().map(|part| part.geometry.clone()).collect::<Vec<_>>(), expected);
        assert!(parts.iter().all(|part| part.offset.translation.z == 3.0 && part.offset.rotation.angle() == 1.0));
    }

    #[test]
    fn paths_of_meshes() {
        let path = |filename| mesh_path(filename, Path::new("dir/r.urdf"), &Packages::default());
        assert_eq!(path("meshes/a b.dae"), Ok("dir/meshes/a b.dae".into()));
        assert_eq!(path("/m.stl"), Ok("/m.stl".into()));
        assert_eq!(path("file:///m.stl"), Ok("/m.stl".into()));
        assert_eq!(path("file:/m.stl"), Ok("/m.stl".into()));
        assert_eq!(path("file:///a%20b/%c3%a9%2F.stl"), Ok("/a b/é/.stl".into()));
        assert_eq!(path("file:///a%2/%zz%"), Ok("/a%2/%zz%".into()), "no digits");
        assert_eq!(path("file:///a%ff"), Ok("/a%ff".into()), "no UTF-8");
        assert_eq!(path("a%20b.stl"), Ok("dir/a%20b.stl".into()), "a path is no URI");
        assert!(path("package://p/m.stl").unwrap_err().contains("ROS_PACKAGE_PATH"));
        assert!(path("http://host/m.stl").is_err() && path("").is_err());
    }

    #[test]
    fn shapes_of_no_use_are_left_out() {
        for (geometry, message) in [
            ("<box size='1 -2 3'/>", "geometry / box / size` is `1 -2 3`, expected lengths above 0"),
            ("<ball/>", "geometry` is `ball`, expected box, sphere"),
            ("", "geometry` is missing (box"),
            ("<mesh filename='a' scale='1 0 1'/>", "scale` is `1 0 1`, expected three factors"),
            ("<mesh filename='package://p/a.stl'/>", "expected a package in a folder above"),
            ("<sphere radius='0'/>", "radius` is `0`"),
        ] {
            let (model, problems) = read(&link(&collision(geometry)));
            assert_eq!(model.bodies[0].collision, CollisionGeometry::None);
            assert!(problems.len() == 1 && problems[0].contains(message), "{problems:#?}");
            assert!(problems[0].contains("error: `link a / collision"), "{problems:#?}");
        }
    }

    #[test]
    fn materials_by_name_wherever_they_are_defined() {
        let visual = |material: &str| {
            format!("<visual><geometry><sphere radius='1'/></geometry><material name='{material}</material></visual>")
        };
        let inside =
            ["red'>", "blue'>", "blue'><color rgba='0 0 1 0.5'/>", "'><color rgba='0 1 0 1'/>"].map(visual).concat();
        let text = link(&inside).replace("<link", "<material name='red'><color rgba='1 0 0 1'/></material><link");
        let VisualGeometry::Parts(parts) = clean(&text).bodies.remove(0).visual.geometry else { panic!() };
        let colours = parts.iter().map(|part| part.material.as_ref().map(|m| (m.diffuse, m.alpha)));
        let (red, blue, green) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
        assert!(colours.eq([(red, 1.0), (blue, 0.5), (blue, 0.5), (green, 1.0)].map(Some)));
        let (_, problems) = read(&link(&visual("pink'>")));
        assert!(problems.len() == 1 && problems[0].contains("is `pink`"), "{problems:#?}");
    }
}
