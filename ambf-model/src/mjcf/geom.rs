//! Geoms: what collides, what is drawn, what weighs.

use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};

use super::asset::Assets;
use super::mass::{shell, solid, Mass};
use super::settings::{choice, finish, z_to, Compiler, BOOLEANS, POSE, SOFT};
use super::source::written_path;
use crate::adf::{Axis, Material, Part, PartGeometry, Primitive, ProblemKind};
use crate::xml::{quoted, Element};

/// Types of geoms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Plane,
    HeightField,
    Sphere,
    Capsule,
    Ellipsoid,
    Cylinder,
    Box,
    Mesh,
    Distance,
}

impl Kind {
    const WORDS: [(&'static str, Self); 9] = [
        ("plane", Self::Plane),
        ("hfield", Self::HeightField),
        ("sphere", Self::Sphere),
        ("capsule", Self::Capsule),
        ("ellipsoid", Self::Ellipsoid),
        ("cylinder", Self::Cylinder),
        ("box", Self::Box),
        ("mesh", Self::Mesh),
        ("sdf", Self::Distance),
    ];
}

/// What a geom element and its defaults say.
#[derive(Debug, Clone)]
pub(super) struct GeomText<'a> {
    pub kind: Kind,
    size: [f64; 3],
    from_to: Option<[f64; 6]>,
    pose: Isometry3<f64>,
    /// Bits by which geoms collide: one's `contact` with another's `affinity`.
    pub contact: u32,
    pub affinity: u32,
    pub dimensions: f64,
    pub friction: [f64; 3],
    pub group: f64,
    pub priority: f64,
    mass: Option<f64>,
    density: f64,
    is_shell: bool,
    material: Option<&'a str>,
    rgba: Option<[f64; 4]>,
    mesh: Option<&'a str>,
    field: Option<&'a str>,
}

impl Default for GeomText<'_> {
    fn default() -> Self {
        Self {
            kind: Kind::Sphere,
            size: [0.0; 3],
            from_to: None,
            pose: Isometry3::identity(),
            contact: 1,
            affinity: 1,
            dimensions: 3.0,
            friction: [1.0, 0.005, 0.0001],
            group: 0.0,
            priority: 0.0,
            mass: None,
            density: 1000.0,
            is_shell: false,
            material: None,
            rgba: None,
            mesh: None,
            field: None,
        }
    }
}

impl<'a> GeomText<'a> {
    pub fn apply(&mut self, element: &Element<'a>, compiler: &Compiler) {
        let read =
            [
                &[
                    "name",
                    "class",
                    "type",
                    "size",
                    "fromto",
                    "contype",
                    "conaffinity",
                    "condim",
                    "friction",
                    "group",
                    "priority",
                    "mass",
                ][..],
                &[
                    "density",
                    "shellinertia",
                    "material",
                    "rgba",
                    "mesh",
                    "hfield",
                    "fitscale",
                    "adhesion",
                    "surfacevel",
                ][..],
                &POSE,
            ]
            .concat();
        let unused = [
            SOFT,
            ("it changes nothing that moves", &["user", "castshadow"][..]),
            ("there is neither air nor water here", &["fluidshape", "fluidcoef"][..]),
        ];
        finish(element, &read, &unused, &["plugin"]);
        self.kind = choice(element, "type", &Kind::WORDS).unwrap_or(self.kind);
        if let Some(size) = element.numbers_in("size", 1..=3) {
            self.size[..size.len()].copy_from_slice(&size);
        }
        self.from_to = element.numbers("fromto").or(self.from_to);
        self.pose = compiler.pose(element, self.pose);
        let bits = |name| element.real(name).map(|number| number.clamp(0.0, f64::from(u32::MAX)) as u32);
        self.contact = bits("contype").unwrap_or(self.contact);
        self.affinity = bits("conaffinity").unwrap_or(self.affinity);
        self.dimensions = element.real("condim").unwrap_or(self.dimensions);
        if let Some(friction) = element.numbers_in("friction", 1..=3) {
            self.friction[..friction.len()].copy_from_slice(&friction);
        }
        self.group = element.real("group").unwrap_or(self.group);
        self.priority = element.real("priority").unwrap_or(self.priority);
        self.mass = element.real("mass").or(self.mass);
        self.density = element.real("density").unwrap_or(self.density);
        self.is_shell = choice(element, "shellinertia", &BOOLEANS).unwrap_or(self.is_shell);
        self.material = element.attribute("material").or(self.material);
        self.rgba = element.numbers("rgba").or(self.rgba);
        self.mesh = element.attribute("mesh").or(self.mesh);
        self.field = element.attribute("hfield").or(self.field);
        for name in ["adhesion", "surfacevel"] {
            if element.attribute(name).is_some() {
                element.ignored(name, "surfaces neither stick nor move here");
            }
        }
    }
}

/// A geom of a body.
#[derive(Clone)]
pub(super) struct Geom<'a> {
    pub name: Option<String>,
    pub text: GeomText<'a>,
    /// In the body's frame; a plane's normal is its z axis.
    pub part: Part,
    pub material: Option<Material>,
    /// In the body's frame; `None`: it weighs nothing, or its volume is not known.
    pub mass: Option<Mass>,
    /// A `pair` says that it collides.
    pub is_paired: bool,
}

impl<'a> Geom<'a> {
    /// The shape of a geom whose frame is `outer` in the body's; `None`, reported, if there is none of use.
    pub fn new(
        element: Element<'a>,
        text: GeomText<'a>,
        outer: &Isometry3<f64>,
        assets: &Assets<'a>,
        needs_mass: bool,
    ) -> Option<Self> {
        let name = element.attribute("name").map(|_| element.need_name("name", "a name").to_owned());
        let mut pose = text.pose;
        let mut size = text.size;
        if let Some([a, b, c, d, e, f]) = text.from_to {
            let (from, to) = (Vector3::new(a, b, c), Vector3::new(d, e, f));
            let Some(rotation) = z_to((from - to).into()) else {
                let found = quoted(element.attribute("fromto").unwrap_or_default());
                element.error(ProblemKind::OutOfRange, "fromto", &found, "two points", "the geom is left out");
                return None;
            };
            let half = (from - to).norm() / 2.0;
            size = match text.kind {
                Kind::Box | Kind::Ellipsoid => [size[0], size[0], half],
                _ => [size[0], half, size[2]],
            };
            pose = Isometry3::from_parts(((from + to) / 2.0).into(), rotation);
        }
        let [x, y, z] = size;
        let axis = Axis::Z;
        let used: &[f64] = match text.kind {
            Kind::Plane | Kind::Mesh | Kind::HeightField | Kind::Distance => &[],
            Kind::Sphere => &size[..1],
            Kind::Capsule | Kind::Cylinder => &size[..2],
            Kind::Box | Kind::Ellipsoid => &size,
        };
        // A mesh in place of which a primitive is fitted has no size.
        let is_fitted = text.mesh.is_some() && text.kind != Kind::Mesh;
        if !is_fitted && !used.iter().all(|length| *length > 0.0) {
            let expected = format!("{} lengths above 0", used.len());
            element.error(ProblemKind::OutOfRange, "size", &format!("{used:?}"), &expected, "the geom is left out");
            return None;
        }
        let primitive = match text.kind {
            _ if is_fitted => {
                let expected = "type mesh: no other shape is fitted to a mesh";
                element.error(ProblemKind::UnknownValue, "type", "another shape", expected, "the mesh itself is used");
                None
            }
            Kind::Plane => Some(Primitive::Plane { normal: Vector3::z(), offset: 0.0 }),
            Kind::Sphere => Some(Primitive::Sphere { radius: x }),
            Kind::Capsule => Some(Primitive::Capsule { radius: x, height: 2.0 * (x + y), axis }),
            Kind::Cylinder => Some(Primitive::Cylinder { radius: x, height: 2.0 * y, axis }),
            Kind::Box => Some(Primitive::Box { size: 2.0 * Vector3::new(x, y, z) }),
            Kind::Ellipsoid => Some(Primitive::Ellipsoid { radii: Vector3::new(x, y, z) }),
            Kind::Mesh | Kind::HeightField => None,
            Kind::Distance => {
                let expected = "plane, hfield, sphere, capsule, ellipsoid, cylinder, box or mesh";
                let found = quoted(element.attribute("type").unwrap_or("sdf"));
                element.error(ProblemKind::UnknownValue, "type", &found, expected, "the geom is left out");
                return None;
            }
        };
        let weight = |shape: Mass| match text.mass {
            Some(mass) if shape.mass > 0.0 => shape.times(mass.max(0.0) / shape.mass),
            Some(_) => Mass::default(),
            None => shape.times(text.density.max(0.0)),
        };
        let (geometry, shape) = match primitive {
            Some(primitive) => {
                let shape = if text.is_shell { shell(&primitive) } else { solid(&primitive) };
                (PartGeometry::Primitive(primitive), shape)
            }
            None if text.kind == Kind::HeightField && !is_fitted => {
                (PartGeometry::Triangles(assets.field(&element, text.field)?), None)
            }
            None => {
                let mesh = assets.mesh(&element, text.mesh)?;
                if text.is_shell {
                    element.ignored("shellinertia", "`inertia` of a mesh says what of it weighs");
                }
                let shape = (needs_mass && text.mass != Some(0.0)).then(|| assets.mass(mesh)).flatten();
                pose *= mesh.in_geom;
                (mesh.geometry.clone(), shape)
            }
        };
        let part = Part { geometry, offset: outer * pose };
        let material = assets.material(&element, text.material, text.rgba);
        let mass = shape.map(|shape| weight(shape).placed(&part.offset)).filter(|mass| mass.mass > 0.0);
        Some(Self { name, text, part, material, mass, is_paired: false })
    }

    /// Whether it meets anything.
    pub fn collides(&self) -> bool {
        self.has_masks() || self.is_paired
    }

    /// Whether it may meet what no `pair` names.
    pub fn has_masks(&self) -> bool {
        self.text.contact != 0 || self.text.affinity != 0
    }

    /// Whether MuJoCo's viewer draws it unless it is told otherwise.
    pub fn is_drawn(&self) -> bool {
        const HIDDEN_FROM: f64 = 3.0;
        self.text.group < HIDDEN_FROM && self.material.as_ref().is_none_or(|material| material.alpha > 0.0)
    }

    /// Whether it is a body of its own here.
    pub fn is_apart(&self) -> bool {
        self.is_plane() || self.is_field()
    }

    /// Whether it is a height field.
    pub fn is_field(&self) -> bool {
        self.text.kind == Kind::HeightField && self.text.mesh.is_none()
    }

    pub fn is_plane(&self) -> bool {
        matches!(self.part.geometry, PartGeometry::Primitive(Primitive::Plane { .. }))
    }
}

/// The file of a mesh or height field.
pub(super) fn mesh_path(file: &str, compiler: &Compiler, folder: &std::path::Path) -> PathBuf {
    let file = written_path(file);
    let file = match compiler.strips_paths {
        true => file.file_name().map_or(file.as_path(), std::path::Path::new),
        false => &file,
    };
    match compiler.mesh_folder.as_os_str().is_empty() {
        true => folder.join(file),
        false => compiler.mesh_folder.join(file),
    }
}
