//! Section `asset`: meshes, height fields and materials.

use std::borrow::Cow;
use std::cell::{Cell, OnceCell, RefCell};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::classes::Classes;
use super::field::{Field, Unusable};
use super::geom::mesh_path;
use super::hull::hull;
use super::mass::{of_mesh, Mass, MeshMass};
use super::settings::{choice, finish, Compiler};
use super::source::{written_path, Source, Surroundings};
use crate::adf::{Material, PartGeometry, PhysicalMaterial, ProblemKind};
use crate::mesh::{self, Mesh, Sources, MAX_TRIANGLES};
use crate::xml::{quoted, Element};

/// A mesh of the assets.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MeshAsset {
    pub geometry: PartGeometry,
    /// Pose of the file's frame in that of the geoms that use it.
    pub in_geom: Isometry3<f64>,
    weighs: MeshMass,
    /// Mass and inertia at density 1, found once for all geoms.
    mass: OnceCell<Option<Mass>>,
}

/// What a material element and its defaults say.
#[derive(Debug, Clone)]
pub(super) struct MaterialText {
    rgba: [f64; 4],
    emission: f64,
    specular: f64,
    shininess: f64,
    metallic: f64,
    roughness: f64,
}

impl Default for MaterialText {
    fn default() -> Self {
        Self { rgba: [1.0; 4], emission: 0.0, specular: 0.5, shininess: 0.5, metallic: -1.0, roughness: -1.0 }
    }
}

impl MaterialText {
    pub fn apply(&mut self, element: &Element<'_>) {
        let read = ["name", "class", "rgba", "emission", "specular", "shininess", "metallic", "roughness"];
        let unused = [("only colours are used", &["texture", "texrepeat", "texuniform", "reflectance"][..])];
        finish(element, &read, &unused, &["layer"]);
        self.rgba = element.numbers("rgba").unwrap_or(self.rgba);
        for (name, value) in [
            ("emission", &mut self.emission),
            ("specular", &mut self.specular),
            ("shininess", &mut self.shininess),
            ("metallic", &mut self.metallic),
            ("roughness", &mut self.roughness),
        ] {
            *value = element.real(name).unwrap_or(*value);
        }
    }

    fn material(&self) -> Material {
        let [red, green, blue, alpha] = self.rgba.map(|part| part.clamp(0.0, 1.0));
        let diffuse = [red, green, blue];
        let part = |number: f64| number.clamp(0.0, 1.0);
        let physical = (self.metallic >= 0.0 || self.roughness >= 0.0).then(|| PhysicalMaterial {
            metallic: part(self.metallic),
            // That of ADF where none is given.
            roughness: if self.roughness >= 0.0 { part(self.roughness) } else { 0.5 },
        });
        Material {
            ambient: diffuse.map(|c| 0.5 * c),
            diffuse,
            specular: [part(self.specular); 3],
            emission: diffuse.map(|c| c * part(self.emission)),
            alpha,
            // OpenGL's exponents end at 128.
            shininess: (part(self.shininess) * 128.0) as u32,
            physical,
        }
    }
}

/// What meshes have of their defaults.
#[derive(Debug, Clone)]
pub(super) struct MeshText {
    scale: Vector3<f64>,
    weighs: MeshMass,
}

impl Default for MeshText {
    fn default() -> Self {
        Self { scale: Vector3::repeat(1.0), weighs: MeshMass::Legacy }
    }
}

impl MeshText {
    pub fn apply(&mut self, element: &Element<'_>) {
        let read = [
            "name",
            "class",
            "file",
            "scale",
            "inertia",
            "refpos",
            "refquat",
            "vertex",
            "face",
            "builtin",
            "params",
            "content_type",
        ];
        let unused = [
            ("shapes are hulls of all vertices", &["maxhullvert"][..]),
            ("only the surface is used", &["normal", "texcoord", "smoothnormal", "material"][..]),
        ];
        finish(element, &read, &unused, &["plugin"]);
        self.scale = element.vector("scale").unwrap_or(self.scale);
        let words = [
            ("exact", MeshMass::Exact),
            ("legacy", MeshMass::Legacy),
            ("convex", MeshMass::Convex),
            ("shell", MeshMass::Shell),
        ];
        self.weighs = choice(element, "inertia", &words).unwrap_or(self.weighs);
    }
}

/// Meshes, height fields and materials by name.
pub(super) struct Assets<'a> {
    /// `None`: reported.
    meshes: HashMap<String, Option<MeshAsset>>,
    /// `None`: reported.
    fields: HashMap<String, Option<Arc<Mesh>>>,
    /// Triangles that further height fields may have, and further geoms that use them: a few letters ask for millions.
    field_triangles: usize,
    geom_triangles: Cell<usize>,
    materials: HashMap<&'a str, MaterialText>,
    surroundings: Surroundings,
    /// What is known of files that were read.
    volumes: RefCell<HashMap<PathBuf, Option<Mesh>>>,
    /// Files that were read.
    pub read: RefCell<Sources>,
}

impl<'a> Assets<'a> {
    pub fn read(
        sections: &[Element<'a>],
        source: &Source<'a>,
        classes: &Classes<'a>,
        compiler: &Compiler,
        surroundings: Surroundings,
        file: &Path,
    ) -> Self {
        let mut assets = Self {
            meshes: HashMap::new(),
            fields: HashMap::new(),
            field_triangles: MAX_TRIANGLES,
            geom_triangles: Cell::new(MAX_TRIANGLES),
            materials: HashMap::new(),
            surroundings,
            volumes: RefCell::default(),
            read: RefCell::default(),
        };
        let folder = file.parent().unwrap_or(Path::new(""));
        for section in sections {
            finish(section, &[], &[], &["mesh", "material", "texture", "hfield", "skin", "model"]);
            for element in source.elements(section) {
                match element.tag() {
                    "mesh" => {
                        let mut text = classes.of(&element, None).mesh.clone();
                        text.apply(&element);
                        assets.add_mesh(&element, &text, compiler, folder);
                    }
                    "material" => {
                        let mut text = classes.of(&element, None).material.clone();
                        text.apply(&element);
                        assets.materials.insert(element.need_name("name", "a name"), text);
                    }
                    "texture" => element.problem(
                        crate::adf::Severity::Info,
                        ProblemKind::IgnoredKey,
                        "",
                        "",
                        "",
                        "surfaces have one colour",
                    ),
                    "hfield" => assets.add_field(&element, compiler, folder),
                    "skin" | "model" => {
                        element.error(ProblemKind::IgnoredKey, "", "", "", "what uses it is left out");
                    }
                    _ => (),
                }
            }
        }
        assets
    }

    fn add_mesh(&mut self, element: &Element<'a>, text: &MeshText, compiler: &Compiler, folder: &Path) {
        let file = element.attribute("file");
        let name = name_of(element, file);
        let left_out = "geoms that use the mesh are left out";
        if text.scale.iter().any(|factor| *factor == 0.0) {
            let found = quoted(element.attribute("scale").unwrap_or_default());
            element.error(ProblemKind::OutOfRange, "scale", &found, "three factors other than 0", left_out);
            self.meshes.insert(name, None);
            return;
        }
        let position = element.vector("refpos").unwrap_or_default();
        let [w, x, y, z] = element.numbers("refquat").unwrap_or([1.0, 0.0, 0.0, 0.0]);
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), f64::MIN_POSITIVE).unwrap_or_default();
        // MuJoCo turns the mesh, then scales it: the factors are those along the axes of the turned file.
        let turn = rotation.to_rotation_matrix();
        let factors = turn.matrix() * Matrix3::from_diagonal(&text.scale) * turn.matrix().transpose();
        let mut scale = factors.diagonal();
        let least = 1e-6 * text.scale.amin();
        if !(factors - Matrix3::from_diagonal(&scale)).iter().all(|apart| apart.abs() <= least) {
            let found = quoted(element.attribute("scale").unwrap_or_default());
            let expected = "one factor, or axes that `refquat` turns into each other";
            element.error(ProblemKind::OutOfRange, "scale", &found, expected, "the mesh is scaled, then turned");
            scale = text.scale;
        }
        let geometry = match file {
            Some(file) => Some(PartGeometry::Mesh { path: mesh_path(file, compiler, folder), scale }),
            None => inline(element, scale)
                .map_err(|(key, found, expected)| {
                    element.error(ProblemKind::OutOfRange, key, &found, &expected, left_out);
                })
                .ok(),
        };
        let mesh = geometry.map(|geometry| MeshAsset {
            geometry,
            in_geom: Isometry3::from_parts(scale.component_mul(&position).into(), rotation).inverse(),
            weighs: text.weighs,
            mass: OnceCell::new(),
        });
        self.meshes.insert(name, mesh);
    }

    fn add_field(&mut self, element: &Element<'a>, compiler: &Compiler, folder: &Path) {
        let read = ["name", "content_type", "file", "nrow", "ncol", "size", "elevation"];
        finish(element, &read, &[], &[]);
        let file = element.attribute("file");
        let name = name_of(element, file);
        let left_out = "geoms that use the height field are left out";
        let most = self.field_triangles;
        let field = match file {
            Some(_) if self.surroundings == Surroundings::Nothing => {
                let (found, expected) = ("a file that is not there".to_owned(), "a file".to_owned());
                Err(Unusable { found, expected })
            }
            Some(file) => {
                let path = mesh_path(file, compiler, folder);
                self.read.borrow_mut().add(&path);
                Field::load(&path, most)
            }
            None => {
                // Larger ones are refused as fields.
                let count = |name: &'static str| element.real(name).map_or(0, |count| count.clamp(0.0, 1e9) as usize);
                let (rows, columns) = (count("nrow"), count("ncol"));
                match element.numbers_in("elevation", 0..=usize::MAX) {
                    Some(elevations) => Field::of_text(rows, columns, &elevations, most),
                    None => Field::flat(rows, columns, most),
                }
            }
        };
        let size: Option<[f64; 4]> = element.numbers("size");
        let mesh = match (field, size.filter(|size| size.iter().all(|length| *length > 0.0))) {
            (Ok(field), Some(size)) => {
                let mesh = field.mesh(size);
                self.field_triangles = most.saturating_sub(mesh.triangle_count());
                Some(Arc::new(mesh))
            }
            (Err(Unusable { found, expected }), _) => {
                let key = if file.is_some() { "file" } else { "nrow" };
                element.error(ProblemKind::OutOfRange, key, &found, &expected, left_out);
                None
            }
            (_, None) => {
                let found = quoted(element.attribute("size").unwrap_or_default());
                element.error(ProblemKind::OutOfRange, "size", &found, "four lengths above 0", left_out);
                None
            }
        };
        self.fields.insert(name, mesh);
    }

    /// The height field of a geom; `None`: reported.
    pub fn field(&self, element: &Element<'a>, name: Option<&str>) -> Option<Arc<Mesh>> {
        let field = asset(element, ("hfield", name), &self.fields)?;
        let Some(left) = self.geom_triangles.get().checked_sub(field.triangle_count()) else {
            let (found, expected) = ("one height field too many", format!("{MAX_TRIANGLES} triangles of all of them"));
            element.error(ProblemKind::OutOfRange, "hfield", found, &expected, "the geom is left out");
            return None;
        };
        self.geom_triangles.set(left);
        Some(Arc::clone(field))
    }

    /// The mesh of a geom; `None`: reported.
    pub fn mesh(&self, element: &Element<'a>, name: Option<&str>) -> Option<&MeshAsset> {
        asset(element, ("mesh", name), &self.meshes)
    }

    /// Mass and inertia at density 1 of a mesh, in the frame of its file; `None` where the file is of no use, which is
    /// reported when it is built.
    pub fn mass(&self, asset: &MeshAsset) -> Option<Mass> {
        *asset.mass.get_or_init(|| self.find_mass(asset))
    }

    fn find_mass(&self, asset: &MeshAsset) -> Option<Mass> {
        let mesh = match &asset.geometry {
            PartGeometry::Mesh { path, scale } if self.surroundings == Surroundings::Disk => {
                let mut volumes = self.volumes.borrow_mut();
                let found = volumes.entry(path.clone()).or_insert_with(|| {
                    self.read.borrow_mut().add(path);
                    mesh::load(path).ok()
                });
                Cow::Owned(found.as_ref()?.scaled_along((*scale).into()))
            }
            PartGeometry::Triangles(mesh) => Cow::Borrowed(&**mesh),
            _ => return None,
        };
        let triangles = mesh.sub_meshes.iter().flat_map(|sub| {
            sub.triangles.iter().map(|triangle| triangle.map(|index| Vector3::from(sub.vertices[index as usize])))
        });
        // What has no triangles has those of its hull, as in MuJoCo.
        let mass = if asset.weighs == MeshMass::Convex || mesh.triangle_count() == 0 {
            let corners = mesh.sub_meshes.iter().flat_map(|sub| &sub.vertices).map(|&vertex| Vector3::from(vertex));
            of_mesh(hull(&corners.collect::<Vec<_>>()).into_iter(), asset.weighs)
        } else {
            of_mesh(triangles, asset.weighs)
        };
        (mass.mass.is_finite() && mass.mass > 0.0 && mass.inertia.iter().all(|x| x.is_finite())).then_some(mass)
    }

    /// The material of a geom.
    pub fn material(&self, element: &Element<'a>, name: Option<&str>, rgba: Option<[f64; 4]>) -> Option<Material> {
        let named = name.and_then(|name| {
            let found = self.materials.get(name);
            if found.is_none() {
                let expected = "the name of a material in `asset`";
                element.warn(ProblemKind::UnknownValue, "material", &quoted(name), expected, "the geom is grey");
            }
            found
        });
        let grey = MaterialText { rgba: [0.5, 0.5, 0.5, 1.0], ..MaterialText::default() };
        let mut text = named.cloned().unwrap_or(grey);
        text.rgba = rgba.unwrap_or(text.rgba);
        Some(text.material())
    }
}

/// What an asset of a kind is made of; `None`, reported there or here, if there is none of use.
fn asset<'m, T>(
    element: &Element<'_>,
    (key, name): (&'static str, Option<&str>),
    all: &'m HashMap<String, Option<T>>,
) -> Option<&'m T> {
    let name = name.unwrap_or_default();
    let found = all.get(name);
    if found.is_none() {
        let expected = format!("the name of a {key} in `asset`");
        element.error(ProblemKind::UnknownValue, key, &quoted(name), &expected, "the geom is left out");
    }
    found?.as_ref()
}

/// The name of an asset: its own, or that of its file.
fn name_of(element: &Element<'_>, file: Option<&str>) -> String {
    let stem = || {
        let path = written_path(file.unwrap_or_default());
        path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    };
    match element.attribute("name") {
        Some(_) => element.need_name("name", "a name").to_owned(),
        None => stem(),
    }
}

/// A mesh whose vertices are in the text. An error names the attribute, what it is and what was expected.
fn inline(element: &Element<'_>, scale: Vector3<f64>) -> Result<PartGeometry, (&'static str, String, String)> {
    let vertices = element.numbers_in("vertex", 0..=usize::MAX).unwrap_or_default();
    let numbers = element.numbers_in("face", 0..=usize::MAX).unwrap_or_default();
    let vectors: Vec<[f64; 3]> = vertices.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
    if vectors.is_empty() || !vertices.len().is_multiple_of(3) {
        let found =
            if vertices.is_empty() { "absent, as `file` is".to_owned() } else { format!("{} numbers", vertices.len()) };
        return Err(("vertex", found, "three numbers each vertex, or a file".to_owned()));
    }
    let triangles: Vec<[usize; 3]> = numbers.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(|n| n as usize)).collect();
    let is_index = |number: &f64| *number >= 0.0 && *number < vectors.len() as f64 && number.fract() == 0.0;
    if !numbers.len().is_multiple_of(3) || !numbers.iter().all(is_index) {
        let expected = format!("three indices each triangle, from 0 to {}", vectors.len() - 1);
        return Err(("face", format!("{} numbers", numbers.len()), expected));
    }
    if triangles.is_empty() {
        let action = "it collides and weighs as the hull of its vertices, and is not drawn";
        element.warn(ProblemKind::Absent, "face", "", "triangles", action);
    }
    let mesh = Mesh::of_triangles(&vectors, &triangles).unwrap_or_default();
    Ok(PartGeometry::Triangles(Arc::new(mesh.scaled_along(scale.into()))))
}
