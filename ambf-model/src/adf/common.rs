//! What all elements share: where they were written, who they are, what they look like.

use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A place in a file the user wrote.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct SourcePos {
    /// The file, as it was named when it was loaded.
    pub file: Arc<Path>,
    /// Line, counted from 1; 0 when the problem concerns the file as a whole.
    pub line: u32,
    /// Column in characters, counted from 1; 0 when the problem concerns the file as a whole.
    pub column: u32,
}

impl std::fmt::Display for SourcePos {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.file.display())?;
        if self.line > 0 {
            write!(f, ":{}:{}", self.line, self.column)?;
        }
        Ok(())
    }
}

/// Keys that every element has.
#[derive(Clone, Debug, PartialEq)]
pub struct Common {
    /// The mapping key under which the element is defined, verbatim (`BODY left finger`).
    pub identifier: String,
    /// Communication name: key `name` without its blanks. Default: empty.
    pub name: String,
    /// Effective namespace: the element's merged with its file's, without a global prefix from the command line.
    pub namespace: String,
    /// No communication instance is created; a joint and the child it leads to leave the active lists. Default:
    /// `false`.
    pub passive: bool,
    /// Lowest and highest publishing rate in Hz, as written and unchecked against each other. Default: `None`.
    pub publish_frequency: Option<(u32, u32)>,
    /// Plugins attached to the element, in file order.
    pub plugins: Vec<PluginEntry>,
    /// Where the element's key stands.
    pub source: SourcePos,
}

/// One entry of a `plugins` list.
#[derive(Clone, Debug, PartialEq)]
pub struct PluginEntry {
    /// Name given to the plugin, blanks kept.
    pub name: String,
    /// Library file name as written.
    pub filename: PathBuf,
    /// Directory that is searched first, joined to the file's directory when it was relative.
    pub path: Option<PathBuf>,
    /// Where the entry stands.
    pub source: SourcePos,
}

/// A pair of GLSL source files.
#[derive(Clone, Debug, PartialEq)]
pub struct ShaderProgram {
    /// Vertex shader, joined to the file's directory when it was relative.
    pub vertex: PathBuf,
    /// Fragment shader, joined to the file's directory when it was relative.
    pub fragment: PathBuf,
}

/// Metallic-roughness model of a physically based material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhysicalMaterial {
    /// 0 is a dielectric, 1 is a metal. Default: 0.
    pub metallic: f64,
    /// 0 is smooth, 1 is matt. Default: 0.5.
    pub roughness: f64,
}

/// Phong material, or a physically based one. Colours are (red, green, blue), each 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Ambient colour. Default: 0.3 each.
    pub ambient: [f64; 3],
    /// Diffuse colour. Default: 0.7 each.
    pub diffuse: [f64; 3],
    /// Specular colour. Default: 1 each.
    pub specular: [f64; 3],
    /// Emitted colour. Default: 0 each.
    pub emission: [f64; 3],
    /// Opacity: 0 is clear, 1 is opaque. Default: 1.
    pub alpha: f64,
    /// Phong exponent. Default: 64.
    pub shininess: u32,
    /// Physically based reflection, by the keys `metallic` and `roughness`: `diffuse` is then the base colour, and
    /// `ambient`, `specular` and `shininess` have no effect. Default: none.
    pub physical: Option<PhysicalMaterial>,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            ambient: [0.3; 3],
            diffuse: [0.7; 3],
            specular: [1.0; 3],
            emission: [0.0; 3],
            alpha: 1.0,
            shininess: 64,
            physical: None,
        }
    }
}
