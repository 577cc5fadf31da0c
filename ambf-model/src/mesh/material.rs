//! Materials of mesh files, and the material libraries (MTL) of OBJ files.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{quoted, Files, Position};
use crate::files::Found;

/// How a part of a mesh looks. Colours are red, green, blue, usually 0 to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshMaterial {
    /// Reflected part of ambient light. Default: 0.3 each.
    pub ambient: [f32; 3],
    /// Reflected part of light from a direction, multiplied by the texture. Default: 0.7 each.
    pub diffuse: [f32; 3],
    /// Colour of highlights. Default: 1 each.
    pub specular: [f32; 3],
    /// Emitted colour. Default: 0 each.
    pub emission: [f32; 3],
    /// Opacity: 0 is clear, 1 is opaque. Default: 1.
    pub alpha: f32,
    /// Phong exponent, 0 to 128. Default: 64.
    pub shininess: f32,
    /// Texture that multiplies the lit colour. Default: none.
    pub diffuse_map: Option<MeshTexture>,
    /// Texture of normals in the tangent frame, (n + 1) / 2. Default: none.
    pub normal_map: Option<MeshTexture>,
    /// Texture that multiplies the specular colour. Default: none.
    pub specular_map: Option<MeshTexture>,
    /// Physically based reflection. If there is one, `diffuse` and `diffuse_map` are the base colour, and `ambient`,
    /// `specular` and `shininess` have no effect. Default: none.
    pub physical: Option<MetallicRoughness>,
}

/// A physically based material: the metallic-roughness model of glTF 2.0, appendix B.
#[derive(Debug, Clone, PartialEq)]
pub struct MetallicRoughness {
    /// 0 is a dielectric, 1 is a metal.
    pub metallic: f32,
    /// 0 is smooth, 1 is matt: the square root of the width α of the distribution of the microfacets' normals.
    pub roughness: f32,
    /// Texture whose green channel multiplies the roughness and whose blue channel multiplies the metalness. Default:
    /// none.
    pub map: Option<MeshTexture>,
}

/// Where a texture is.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum MeshTexture {
    /// A file of its own.
    File(PathBuf),
    /// A picture within the mesh file.
    Embedded {
        /// The mesh file and what it calls the picture, for messages.
        name: PathBuf,
        /// The encoded picture, as a file would hold it.
        bytes: Arc<[u8]>,
    },
}

impl From<&str> for MeshTexture {
    fn from(path: &str) -> Self {
        MeshTexture::File(path.into())
    }
}

/// What a file without materials gets.
impl Default for MeshMaterial {
    fn default() -> Self {
        Self {
            ambient: [0.3; 3],
            diffuse: [0.7; 3],
            specular: [1.0; 3],
            emission: [0.0; 3],
            alpha: 1.0,
            shininess: 64.0,
            diffuse_map: None,
            normal_map: None,
            specular_map: None,
            physical: None,
        }
    }
}

/// Largest shininess that OpenGL takes.
const MAX_SHININESS: f32 = 128.0;

/// Exporters write `Ns` up to 1000 and beyond; the C++ program multiplies by this and clamps.
const SHININESS_OF_NS: f32 = 1.28;

/// Messages about one file that are kept.
const MAX_WARNINGS: usize = 50;

/// Messages about what of a file is not drawn as written. A damaged file may be wrong in every line; the first messages
/// are kept.
#[derive(Debug, Default)]
pub(super) struct Warnings {
    kept: Vec<String>,
    left_out: usize,
}

impl Warnings {
    pub fn add(&mut self, path: &Path, at: Position, message: impl AsRef<str>) {
        self.add_text(|| format!("{}{at}: {}", path.display(), message.as_ref()));
    }

    /// A message about no place in particular.
    pub fn add_general(&mut self, path: &Path, message: impl AsRef<str>) {
        self.add_text(|| format!("{}: {}", path.display(), message.as_ref()));
    }

    fn add_text(&mut self, text: impl FnOnce() -> String) {
        if self.kept.len() < MAX_WARNINGS {
            self.kept.push(text());
        } else {
            self.left_out += 1;
        }
    }

    pub fn finish(mut self, path: &Path) -> Vec<String> {
        if self.left_out > 0 {
            self.kept.push(format!("{}: and {} more such messages", path.display(), self.left_out));
        }
        self.kept
    }
}

/// Texture file `name`, as the mesh file `mesh` or its material library `library` names it: relative to the folder of
/// the mesh, else its last part in that folder, else relative to the library's folder.
///
/// # Errors
/// A sentence that says where the file was looked for.
pub(super) fn find_texture(mesh: &Path, library: &Path, name: &str, files: &Files) -> Result<MeshTexture, String> {
    // Files from Windows.
    let name = name.replace('\\', "/");
    let mut tried: Vec<PathBuf> = Vec::new();
    let mut other = None;
    let folder = |file: &Path| file.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let alone = Path::new(&name).file_name().map(|name| folder(mesh).join(name));
    let places = [Some(folder(mesh).join(&name)), alone, Some(folder(library).join(&name))];
    for place in places.into_iter().flatten() {
        if tried.contains(&place) {
            continue;
        }
        // The system's functions do not take such names.
        match if name.contains('\0') { Found::Nothing } else { (files.look)(&place) } {
            Found::File => return Ok(MeshTexture::File(place)),
            Found::Other(kind) => other = other.or(Some((place.clone(), kind))),
            Found::Nothing => (),
        }
        tried.push(place);
    }
    if let Some((place, kind)) = other {
        let place = quoted_path(&place);
        return Err(format!(
            "texture {}: {place} is {kind}, expected a file; the plain material is drawn",
            quoted(&name)
        ));
    }
    let tried: Vec<String> = tried.iter().take(3).map(|place| quoted_path(place)).collect();
    Err(format!(
        "texture {} is not there (looked for {}); the plain material is drawn",
        quoted(&name),
        tried.join(", ")
    ))
}

fn quoted_path(path: &Path) -> String {
    super::printable(&path.display().to_string(), 200)
}

/// A material as written in a library.
#[derive(Default)]
struct Draft {
    ambient: Option<[f32; 3]>,
    diffuse: Option<[f32; 3]>,
    specular: Option<[f32; 3]>,
    emission: Option<[f32; 3]>,
    shininess: Option<f32>,
    /// Key `d`.
    opacity: Option<f32>,
    /// Key `Tr`.
    transparency: Option<f32>,
    /// Key `Pm`.
    metallic: Option<f32>,
    /// Key `Pr`.
    roughness: Option<f32>,
    diffuse_map: Option<MeshTexture>,
    bump_map: Option<MeshTexture>,
    normal_map: Option<MeshTexture>,
    specular_map: Option<MeshTexture>,
}

impl Draft {
    fn finish(self) -> MeshMaterial {
        let diffuse = self.diffuse.unwrap_or([0.8; 3]);
        let ambient = self.ambient.unwrap_or([0.5; 3]);
        let alpha = self.opacity.or(self.transparency.map(|transparency| 1.0 - transparency)).unwrap_or(1.0);
        MeshMaterial {
            ambient: std::array::from_fn(|i| ambient[i] * diffuse[i]),
            diffuse,
            specular: self.specular.unwrap_or([0.3; 3]),
            emission: self.emission.unwrap_or([0.0; 3]),
            alpha: alpha.clamp(0.0, 1.0),
            shininess: (self.shininess.unwrap_or(0.0) * SHININESS_OF_NS).clamp(0.0, MAX_SHININESS),
            diffuse_map: self.diffuse_map,
            // A file with both means normals by the former; the latter may then be heights.
            normal_map: self.normal_map.or(self.bump_map),
            specular_map: self.specular_map,
            physical: (self.metallic.is_some() || self.roughness.is_some()).then(|| MetallicRoughness {
                metallic: self.metallic.unwrap_or(0.0).clamp(0.0, 1.0),
                roughness: self.roughness.unwrap_or(0.5).clamp(0.0, 1.0),
                map: None,
            }),
        }
    }
}

/// Where a library is read, and for which mesh.
pub(super) struct LibraryFile<'a> {
    pub mesh: &'a Path,
    pub library: &'a Path,
    pub files: &'a Files<'a>,
}

/// Materials of the library `text` by name, in file order. Without `warnings` only the names are read, and the
/// materials are the default.
pub(super) fn read_library(
    text: &str,
    file: &LibraryFile,
    mut warnings: Option<&mut Warnings>,
) -> Vec<(String, MeshMaterial)> {
    let mut materials: Vec<(String, MeshMaterial)> = Vec::new();
    let mut draft: Option<Draft> = None;
    for (line, content) in (1..).zip(text.lines()) {
        let content = content.trim();
        if let Some(name) = content.strip_prefix("newmtl") {
            if let (Some(draft), Some(last)) = (draft.take(), materials.last_mut()) {
                last.1 = draft.finish();
            }
            draft = warnings.is_some().then(Draft::default);
            materials.push((name.trim().to_owned(), MeshMaterial::default()));
        } else if let (Some(draft), Some(warnings)) = (&mut draft, &mut warnings) {
            let (keyword, rest) = content.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((content, ""));
            if let Err(message) = draft.read(keyword, rest.trim(), file) {
                warnings.add(file.library, Position::Line(line), message);
            }
        }
    }
    if let (Some(draft), Some(last)) = (draft, materials.last_mut()) {
        last.1 = draft.finish();
    }
    materials
}

impl Draft {
    /// Reads one line. What it does not know is skipped.
    ///
    /// # Errors
    /// A sentence that says what of the line is not used.
    fn read(&mut self, keyword: &str, rest: &str, file: &LibraryFile) -> Result<(), String> {
        match keyword {
            "Ka" => self.ambient = Some(color(keyword, rest)?),
            "Kd" => self.diffuse = Some(color(keyword, rest)?),
            "Ks" => self.specular = Some(color(keyword, rest)?),
            "Ke" => self.emission = Some(color(keyword, rest)?),
            "Ns" => self.shininess = Some(number(keyword, rest)?),
            // `-halo` makes the opacity depend on the angle of view, which nothing here does.
            "d" => self.opacity = Some(number(keyword, rest.strip_prefix("-halo").unwrap_or(rest))?),
            "Tr" => self.transparency = Some(number(keyword, rest)?),
            "Pm" => self.metallic = Some(number(keyword, rest)?),
            "Pr" => self.roughness = Some(number(keyword, rest)?),
            "map_Kd" => return map(&mut self.diffuse_map, rest, file),
            "map_Bump" | "map_bump" | "bump" => return map(&mut self.bump_map, rest, file),
            "norm" => return map(&mut self.normal_map, rest, file),
            "map_Ks" => return map(&mut self.specular_map, rest, file),
            _ => {}
        }
        Ok(())
    }
}

fn number(keyword: &str, rest: &str) -> Result<f32, String> {
    let word = rest.split_ascii_whitespace().next().unwrap_or("");
    match word.parse::<f32>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("expected a number after '{keyword}', got {}; the default is used", quoted(word))),
    }
}

/// Three numbers; one alone stands for all three.
fn color(keyword: &str, rest: &str) -> Result<[f32; 3], String> {
    let words: Vec<&str> = rest.split_ascii_whitespace().take_while(|word| !word.starts_with('#')).take(3).collect();
    let numbers: Vec<f32> = words.iter().filter_map(|word| word.parse().ok()).filter(|x: &f32| x.is_finite()).collect();
    match (numbers.as_slice(), words.len()) {
        (&[r, g, b], 3) => Ok([r, g, b]),
        (&[grey], 1) => Ok([grey; 3]),
        _ => Err(format!("expected three numbers after '{keyword}', got {}; the default is used", quoted(rest))),
    }
}

/// Reads a texture file with its options. `slot` keeps its value if the file is not there.
fn map(slot: &mut Option<MeshTexture>, rest: &str, file: &LibraryFile) -> Result<(), String> {
    let (name, moved) = without_options(rest);
    if name.is_empty() {
        return Err("a texture without a file name; the plain material is drawn".to_owned());
    }
    *slot = Some(find_texture(file.mesh, file.library, name, file.files)?);
    match moved {
        true => {
            Err("the options -o, -s and -t of a texture are not used: it is drawn as its coordinates say".to_owned())
        }
        false => Ok(()),
    }
}

/// The file name, which may have spaces, behind the options of a texture; and whether options move or scale the
/// texture.
fn without_options(rest: &str) -> (&str, bool) {
    let mut rest = rest.trim();
    let mut moved = false;
    loop {
        let (option, values) = rest.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((rest, ""));
        // Least and most values.
        let (least, most) = match option {
            "-blendu" | "-blendv" | "-boost" | "-bm" | "-cc" | "-clamp" | "-imfchan" | "-texres" | "-type" => (1, 1),
            "-mm" => (2, 2),
            "-o" | "-s" | "-t" => (1, 3),
            _ => return (rest, moved),
        };
        let neutral = if option == "-s" { 1.0 } else { 0.0 };
        rest = values.trim_start();
        for taken in 0..most {
            let (word, behind) = rest.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((rest, ""));
            let number = word.parse::<f32>();
            if taken >= least && number.is_err() {
                break;
            }
            moved |= most == 3 && number.is_ok_and(|x| x != neutral);
            rest = behind.trim_start();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::ErrorKind;

    /// Reads a library for mesh `folder/m.obj`; only the files `there` exist.
    fn read(text: &str, there: &[&str]) -> (Vec<(String, MeshMaterial)>, Vec<String>) {
        let look = |path: &Path| match there.iter().any(|file| Path::new(file) == path) {
            true if path.ends_with("pipe.png") => Found::Other("a named pipe"),
            true => Found::File,
            false => Found::Nothing,
        };
        let open = |path: &Path| Err(super::super::io_error(path, ErrorKind::NotFound.into()));
        let files = Files { open: &open, look: &look };
        let mut warnings = Warnings::default();
        let (mesh, library) = (Path::new("folder/m.obj"), Path::new("folder/lib/m.mtl"));
        let materials = read_library(text, &LibraryFile { mesh, library, files: &files }, Some(&mut warnings));
        (materials, warnings.finish(library))
    }

    #[test]
    fn missing_keys_have_the_defaults_of_the_format() {
        let (materials, warnings) = read("newmtl a\r\nnewmtl b c\r\nKd 0.5 1 0\r\n", &[]);
        assert!(warnings.is_empty());
        assert_eq!((materials[0].0.as_str(), materials[1].0.as_str()), ("a", "b c"));
        let a = &materials[0].1;
        assert_eq!((a.ambient, a.diffuse, a.specular), ([0.4; 3], [0.8; 3], [0.3; 3]));
        assert_eq!((a.alpha, a.shininess, a.emission), (1.0, 0.0, [0.0; 3]));
        assert_eq!(materials[1].1.ambient, [0.25, 0.5, 0.0]);
    }

    #[test]
    fn numbers_are_read_and_clamped() {
        let (materials, warnings) = read(
            "newmtl a\nKa 1 0.5 0\nKd 0.5\nKs 0 1 0 # green\nKe 0 0 2\nNs 50\nd -halo 0.25\nTr 0.9\n\
             newmtl b\nTr 0.7\nNs 1000\nnewmtl c\nd 0.3\nnewmtl d\nd 7\nTr 0.5\n",
            &[],
        );
        assert!(warnings.is_empty(), "{warnings:?}");
        let a = &materials[0].1;
        assert_eq!((a.ambient, a.diffuse, a.specular), ([0.5, 0.25, 0.0], [0.5; 3], [0.0, 1.0, 0.0]));
        assert_eq!((a.emission, a.shininess, a.alpha), ([0.0, 0.0, 2.0], 64.0, 0.25));
        let (b, c, d) = (&materials[1].1, &materials[2].1, &materials[3].1);
        assert!((b.alpha - c.alpha).abs() < 1e-6 && c.alpha == 0.3, "{} {}", b.alpha, c.alpha);
        assert_eq!((b.shininess, d.alpha), (128.0, 1.0));
    }

    #[test]
    fn textures_are_found_and_their_options_skipped() {
        let text = "newmtl a\nmap_Kd -bm 0.5 -s 1 1 1 -clamp on tex\\my wood.png\nmap_Bump h.png\nnorm -mm 0 1 n.png\n\
                    newmtl b\nmap_Kd /home/x/floor.png\nbump -o 1 h.png\nmap_Ks s.png\n";
        let there = ["folder/tex/my wood.png", "folder/h.png", "folder/n.png", "folder/floor.png", "folder/lib/s.png"];
        let (materials, warnings) = read(text, &there);
        let (a, b) = (&materials[0].1, &materials[1].1);
        let path = |text: &str| Some(MeshTexture::from(text));
        assert_eq!((&a.diffuse_map, &a.normal_map), (&path(there[0]), &path(there[2])));
        assert_eq!((&b.diffuse_map, &b.normal_map), (&path(there[3]), &path(there[1])));
        assert_eq!(b.specular_map, path(there[4]));
        assert_eq!(warnings.len(), 1);
        assert!(warnings[0].starts_with("folder/lib/m.mtl:7: the options -o, -s and -t"), "{warnings:?}");
    }

    #[test]
    fn what_cannot_be_used_is_named_with_its_line() {
        let text =
            "Kd 9 9 9\nnewmtl a\nKd red\nKs 1 2\nNs nan\nd\nmap_Kd\nmap_Kd a/none.png\nKa 1 inf 1\nillum 2\nNi x\n";
        let (materials, warnings) = read(text, &[]);
        assert_eq!(materials[0].1.diffuse, [0.8; 3]);
        let lines: Vec<&str> = warnings.iter().map(|w| w.split(':').nth(1).unwrap()).collect();
        assert_eq!(lines, ["3", "4", "5", "6", "7", "8", "9"]);
        let sentence = "texture 'a/none.png' is not there (looked for folder/a/none.png, folder/none.png, \
                        folder/lib/a/none.png); the plain material is drawn";
        assert!(warnings[5].ends_with(sentence), "{}", warnings[5]);
        let (_, warnings) = read("newmtl a\nmap_Kd pipe.png\n", &["folder/lib/pipe.png"]);
        let sentence =
            "texture 'pipe.png': folder/lib/pipe.png is a named pipe, expected a file; the plain material is drawn";
        assert!(warnings[0].ends_with(sentence), "it used to be not there: {}", warnings[0]);
        let (_, warnings) = read(&("newmtl a\n".to_owned() + &"d x\n".repeat(1000)), &[]);
        assert_eq!(warnings.len(), MAX_WARNINGS + 1);
        assert!(warnings[MAX_WARNINGS].ends_with("and 950 more such messages"));
    }
}
