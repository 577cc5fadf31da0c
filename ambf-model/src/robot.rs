//! Robot descriptions in XML, told apart by their outermost element: [`urdf`] or [`mjcf`].

use std::path::Path;

use crate::adf::{read_bytes, text_of, LoadError, Model, Report};
use crate::mesh::Sources;
use crate::mjcf::{self, Surroundings};
use crate::urdf::{self, PackagePlaces, Packages};

/// Whether the name of a file says that it is a robot description: `urdf`, `xacro`, `mjcf` or `xml`, in any letter case.
pub fn is_robot(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    ["urdf", "xacro", "mjcf", "xml"].iter().any(|known| known.eq_ignore_ascii_case(extension))
}

/// What decides, beside a file, what is read of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Companions {
    /// Where the packages were found that it refers to.
    pub packages: PackagePlaces,
    /// Files that it includes, and meshes whose volume says masses.
    pub files: Sources,
}

impl Companions {
    /// Whether all of them are as they were for the description `file`.
    pub fn are_current(&self, file: &Path) -> bool {
        self.packages.are_current(file) && self.files.are_current()
    }
}

/// Reads a robot description.
///
/// # Errors
/// Those of [`urdf::load`] and [`mjcf::load`].
pub fn load(path: &Path) -> Result<(Model, Report), LoadError> {
    load_with_companions(path).map(|(model, report, _)| (model, report))
}

/// [`load`], and what else was read.
///
/// # Errors
/// Those of [`load`].
pub fn load_with_companions(path: &Path) -> Result<(Model, Report, Companions), LoadError> {
    let bytes = read_bytes(path)?;
    let text = text_of(&bytes, path)?;
    if is_mjcf(text) {
        let (model, report, files) = mjcf::parse_with_files(text, path, Surroundings::Disk)?;
        return Ok((model, report, Companions { files, ..Companions::default() }));
    }
    let packages = Packages::around(path);
    let (model, report) = urdf::parse(text, path, &packages)?;
    Ok((model, report, Companions { packages: packages.places(), files: Sources::default() }))
}

/// Whether the outermost element is one of MJCF.
pub fn is_mjcf(text: &str) -> bool {
    let mut rest = text.trim_start_matches('\u{feff}').trim_start();
    loop {
        let end = if rest.starts_with("<!--") {
            "-->"
        } else if rest.starts_with("<?") {
            "?>"
        } else if rest.starts_with("<!") {
            ">"
        } else {
            break;
        };
        let Some((_, behind)) = rest.split_once(end) else { return false };
        rest = behind.trim_start();
    }
    let name = rest.strip_prefix('<').unwrap_or_default();
    let name = name.split(|c: char| c.is_whitespace() || matches!(c, '>' | '/')).next().unwrap_or_default();
    matches!(name, "mujoco" | "mujocoinclude")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outermost_element_tells() {
        for text in
            ["<mujoco/>", "\u{feff} <?xml version='1.0'?>\n<!-- <robot> -->\n<mujoco model='a'>", "<mujocoinclude>"]
        {
            assert!(is_mjcf(text), "{text}");
        }
        for text in ["", "<robot/>", "<!-- <mujoco/>", "<!-- <mujoco/> --><robot>", "mujoco", "<mujocos>"] {
            assert!(!is_mjcf(text), "{text}");
        }
        assert!(is_robot(Path::new("a.XML")) && is_robot(Path::new("a.mjcf")) && !is_robot(Path::new("a.yaml")));
    }
}
