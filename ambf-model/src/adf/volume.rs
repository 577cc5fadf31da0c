//! Volumes: voxel data that is only drawn.

use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};

use super::common::{Common, Material, ShaderProgram};
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::{beside, Base};
use crate::files::{look, Found};

/// A volume as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Identity and plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Pose in the parent's frame. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale; positive. Default: 1.
    pub scale: f64,
    /// The voxels; `None`: the volume is empty.
    pub images: Option<ImageStack>,
    /// Edge lengths, m; positive. Default: 1 each.
    pub dimensions: Vector3<f64>,
    /// Default: 0.5.
    pub iso_surface_value: f64,
    /// Default: 1.
    pub optical_density: f64,
    /// Default: 0.5.
    pub quality: f64,
    /// Material; `None`: the renderer's.
    pub material: Option<Material>,
    /// Own shaders.
    pub shaders: Option<ShaderProgram>,
}

/// A stack of images `path/prefix<i>.format`, i from 0 to `count` (the C++ program reads one more than it counts).
#[derive(Clone, Debug, PartialEq)]
pub struct ImageStack {
    /// Directory, joined to the file's directory when it was relative.
    pub path: PathBuf,
    /// Start of each file name.
    pub prefix: String,
    /// File extension without a dot.
    pub format: String,
    /// Number of images.
    pub count: u32,
}

impl Volume {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let r = map.reader();
        let images = if map.has("images") {
            let images = r.tolerant_element("volume", || ImageStack::read(map));
            if images.is_none() {
                r.spoil();
            }
            images
        } else {
            None
        };
        let dimensions = map.vector("dimensions").unwrap_or(Vector3::repeat(1.0));
        if dimensions.min() <= 0.0 && map.has("dimensions") {
            let expected = "edge lengths above 0";
            map.reject(ProblemKind::OutOfRange, "dimensions", expected);
        }
        let volume = Self {
            common: map.common(base),
            parent: map.filled("parent").unwrap_or_default(),
            location: map.pose("location").unwrap_or_default(),
            scale: map.real_in("scale", Range::Positive).unwrap_or(1.0),
            images,
            dimensions,
            iso_surface_value: map.real("iso-surface value").unwrap_or(0.5),
            optical_density: map.real("optical density").unwrap_or(1.0),
            quality: map.real("quality").unwrap_or(0.5),
            material: map.material(),
            shaders: map.shaders("shaders"),
        };
        map.finish();
        Some(volume)
    }
}

impl ImageStack {
    /// What is looked for as the image of an index: the number as it is, then with leading zeros, at most to as many
    /// digits as `count` has.
    pub fn candidates(&self, index: u32) -> impl Iterator<Item = PathBuf> + '_ {
        let digits = |number: u32| number.checked_ilog10().unwrap_or(0) as usize + 1;
        let widths = digits(index)..=digits(self.count).max(digits(index));
        widths.map(move |width| self.path.join(format!("{}{index:0width$}.{}", self.prefix, self.format)))
    }

    /// The images that are there, in order; numbers without one are skipped, and what is no file is listed, so that who
    /// reads it says so. At most `most` numbers are tried.
    pub fn files(&self, most: u32) -> Vec<PathBuf> {
        let indices = (0..=self.count).take(most as usize);
        let named = |index| self.candidates(index).map(|path| (look(&path), path)).collect::<Vec<_>>();
        let best = |found: Vec<(Found, PathBuf)>| {
            let is_file = found.iter().position(|(found, _)| *found == Found::File);
            let place = is_file.or_else(|| found.iter().position(|(found, _)| *found != Found::Nothing))?;
            found.into_iter().nth(place).map(|(_, path)| path)
        };
        indices.filter_map(|index| best(named(index))).collect()
    }

    fn read(map: &Map<'_>) -> Option<Self> {
        let images = map.map("images");
        let stack = Self {
            path: beside(map.reader().dir(), images.need_string("path")),
            prefix: images.need_string("prefix"),
            format: images.need_string("format"),
            count: images.need_uint("count"),
        };
        images.finish();
        Some(stack)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::super::Model;
    use super::*;

    #[test]
    fn images() {
        let text = "volumes: [V, W]\nV: {images: {path: p, prefix: a, format: png, count: 3}}\nW: {}\n";
        let volumes = clean::<Model>(text).volumes;
        let images = volumes[0].images.as_ref().expect("images");
        assert_eq!((images.path.to_str(), images.count), (Some("dir/p"), 3));
        assert_eq!((&volumes[1].images, volumes[1].dimensions.x), (&None, 1.0));
    }

    #[test]
    fn numbers_may_have_leading_zeros_and_gaps() {
        let folder = tempfile::tempdir().expect("a folder");
        let stack = |count| ImageStack { path: folder.path().into(), prefix: "p".into(), format: "png".into(), count };
        for name in ["p000.png", "p1.png", "p03.png", "p100.png", "p0004.png", "p101.png"] {
            std::fs::write(folder.path().join(name), "").expect("a file");
        }
        let names = |stack: ImageStack, most| -> Vec<String> {
            let name = |path: PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
            stack.files(most).into_iter().filter_map(name).collect()
        };
        assert_eq!(names(stack(100), 1000), ["p000.png", "p1.png", "p03.png", "p100.png"]);
        assert_eq!(names(stack(100), 3), ["p000.png", "p1.png"]);
        assert_eq!(names(stack(0), 1000), [""; 0], "count 0 has one digit");
    }

    #[test]
    fn wrong_images_drop_only_the_volume() {
        let text =
            "volumes: [V, W]\nV: {images: {path: p, count: x}}\nW: {dimensions: {x: 1, y: 0, z: 1}}\nbodies: []\n";
        let (model, problems) = read::<Model>(text);
        assert!(model.volumes.is_empty());
        assert_eq!(problems.len(), 4, "{problems:#?}");
        assert!(problems.iter().all(|p| p.ends_with("the volume is dropped")));
    }
}
