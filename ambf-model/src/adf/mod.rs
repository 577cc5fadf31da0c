//! ADF, the AMBF description format: text to typed description.
//!
//! Pure data: nothing here knows Bullet, opens meshes or talks to anyone. SI units, angles in rad, the world is z-up;
//! poses are given as [`nalgebra::Isometry3`]; orientations are written as roll, pitch, yaw about fixed axes,
//! R = Rz(y)·Ry(p)·Rx(r). Numbers that reach the physics are finite.

mod body;
mod camera;
mod color;
mod common;
mod controller;
mod coupling;
mod device;
mod geometry;
mod ghost;
mod joint;
mod keyframe;
mod launch;
mod light;
mod model;
mod node_text;
mod normalise;
mod outline;
mod reader;
mod report;
mod scalar;
mod sensor;
mod soft_body;
mod values;
mod vehicle;
mod volume;
mod world;
mod yaml;

use std::path::Path;

use crate::files;

use normalise::normalise;
pub use reader::is_version_key;
use reader::{Map, Reader};
use yaml::{Document, Kind, Mark, NodeId, SyntaxError};

pub use body::{CollisionFilter, RigidBody, Surface};
pub use camera::{Camera, DepthNoise, Intrinsics, MouseMultipliers, PublishedFrame, Stereo};
pub use color::ColorTable;
pub use common::{Common, Material, PhysicalMaterial, PluginEntry, ShaderProgram, SourcePos};
pub use controller::{CartesianController, Controller, ControllerOutput, Gains};
pub use coupling::{followers, Coupling, Leader, MAX_LEADERS};
pub(crate) use coupling::{ordered, Coupled};
pub use device::{ButtonMapping, HapticGain, InputDevice, InputDevices};
pub use geometry::{
    Axis, CollisionGeometry, CollisionMeshKind, ConvexDecomposition, Part, PartGeometry, PlacedPrimitive, Primitive,
    Visual, VisualGeometry, VisualPart,
};
pub use ghost::GhostObject;
pub use joint::{
    ConeTwistLimits, DriveTrain, Joint, JointKind, Limits, LinearAngular, SixDofLimits, SixDofSpring, IMPULSE_STEP,
};
pub use keyframe::Keyframe;
pub use launch::Launch;
pub use light::{Attenuation, Light};
pub use model::{Model, ObjectType};
pub use node_text::node_text;
pub use outline::{Entry, FileKind, Outline};
pub use report::{LoadError, Problem, ProblemKind, Report, Severity, Verbose};
pub use sensor::{Actuator, Ray, RaySource, ResistanceParameters, Sensor, SensorKind};
pub use soft_body::{SoftBody, SoftBodyConfig, SoftConfig, SoftMaterial};
pub use vehicle::{Suspension, Vehicle, Wheel, WheelVisual};
pub use volume::{ImageStack, ToolBall, ToolBurr, Volume, VolumeContact, VolumeLabel, VolumeTool};
pub use world::{Enclosure, PhysicsProfile, PhysicsSettings, Skybox, World};

/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 64 << 20;

/// A kind of file: [`Launch`], [`World`], [`Model`], [`InputDevices`] or [`ColorTable`].
pub trait Description: sealed::Root {}

impl<T: sealed::Root> Description for T {}

mod sealed {
    use super::{ColorTable, InputDevices, Launch, Map, Model, World};

    /// Reads a kind of file from its root.
    pub trait Root: Sized {
        fn read_root(root: &Map<'_>) -> Self;
    }

    macro_rules! roots {
        ($($kind:ty),*) => { $(
            impl Root for $kind {
                fn read_root(root: &Map<'_>) -> Self {
                    <$kind>::read(root)
                }
            }
        )* };
    }

    roots!(ColorTable, InputDevices, Launch, Model, World);
}

/// Reads a file: `load::<Model>(path)`.
///
/// The report lists what was dropped, replaced or not used. Files the description refers to (meshes, images, other ADF
/// files) are not opened; relative paths are joined to the directory of `path`. A file without `adf version` is taken
/// for 1.0.
///
/// # Errors
/// Every [`LoadError`]: the file is unreadable or no regular file, larger than 64 MiB, no text, no YAML, no mapping, of
/// another version than 1.0, or holds values that do not convert (then all of them are reported).
pub fn load<T: Description>(path: &Path) -> Result<(T, Report), LoadError> {
    parse_bytes(&read_bytes(path)?, path)
}

/// Content of a file, at most one byte more than [`text_of`] takes.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>, LoadError> {
    files::read(path, MAX_BYTES).map_err(|source| LoadError::Unreadable { file: path.to_owned(), source })
}

/// Reads a text as [`load`] reads a file; `path` stands for its name.
///
/// # Errors
/// As [`load`], except that nothing is unreadable.
pub fn parse<T: Description>(text: &str, path: &Path) -> Result<(T, Report), LoadError> {
    parse_bytes(text.as_bytes(), path)
}

fn parse_bytes<T: Description>(bytes: &[u8], path: &Path) -> Result<(T, Report), LoadError> {
    with_document(bytes, path, |doc, entries| {
        let reader = Reader::new(doc, path.into());
        let value = {
            let root = Map::root(&reader, entries);
            if let Some((mark, found)) = root.other_version() {
                return Err(LoadError::Version { at: reader.source(mark), found });
            }
            root.warn_second_document();
            T::read_root(&root)
        };
        let report = reader.into_report();
        if report.is_fatal() {
            return Err(LoadError::Refused { file: path.into(), report });
        }
        Ok((value, report))
    })
}

/// Hands the tree of a file and the entries of its root to `read`.
fn with_document<T>(
    bytes: &[u8],
    path: &Path,
    read: impl FnOnce(&Document<'_>, &[(NodeId, NodeId)]) -> Result<T, LoadError>,
) -> Result<T, LoadError> {
    let text = text_of(bytes, path)?;
    let at = |mark: Mark| SourcePos { file: path.into(), line: mark.line, column: mark.column };
    let normalised;
    let doc = match Document::parse(text, None) {
        Ok(doc) => doc,
        Err(strict) => {
            let syntax = |error: SyntaxError| LoadError::Syntax { at: at(error.mark), message: error.message };
            let Some(lenient) = normalise(text) else {
                return Err(syntax(strict));
            };
            normalised = lenient;
            // Whichever got further names what is really wrong.
            Document::parse(text, Some(&normalised))
                .map_err(|error| syntax(if error.mark.line < strict.mark.line { strict } else { error }))?
        }
    };
    let root = doc.root();
    let found = match &root.kind {
        Kind::Map(entries) => return read(&doc, entries),
        Kind::Null => "nothing",
        Kind::Scalar(_) => "a single value",
        Kind::List(_) => "a list",
    };
    Err(LoadError::NotAMapping { at: at(root.mark), found })
}

/// UTF-8 text of at most 64 MiB without control characters; a byte-order mark is skipped.
pub(crate) fn text_of<'t>(bytes: &'t [u8], path: &Path) -> Result<&'t str, LoadError> {
    if bytes.len() as u64 > MAX_BYTES {
        return Err(LoadError::TooLarge { file: path.to_owned(), limit: MAX_BYTES });
    }
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let not_text = |at: usize, message: &str| {
        let before = &bytes[..at];
        let line_start = before.iter().rposition(|&b| b == b'\n').map_or(0, |i| i + 1);
        let line = before.iter().filter(|&&b| b == b'\n').count() + 1;
        let column = String::from_utf8_lossy(&before[line_start..]).chars().count() + 1;
        LoadError::NotText {
            at: SourcePos {
                file: path.into(),
                line: u32::try_from(line).unwrap_or(u32::MAX),
                column: u32::try_from(column).unwrap_or(u32::MAX),
            },
            message: message.to_owned(),
        }
    };
    let text = std::str::from_utf8(bytes).map_err(|e| not_text(e.valid_up_to(), "bytes that are not UTF-8"))?;
    // A NUL would end the text for the parser without a word.
    let control = |b: &u8| *b < b' ' && !matches!(b, b'\t' | b'\n' | b'\r');
    match bytes.iter().position(control) {
        Some(at) => Err(not_text(at, "a control character")),
        None => Ok(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Description and problems of a text that is read.
    pub(super) fn read<T: Description>(text: &str) -> (T, Vec<String>) {
        let (value, report) = parse(text, Path::new("dir/t.yaml")).expect("read");
        let lines = report.problems().iter().map(|p| p.to_string());
        (value, lines.collect())
    }

    /// As [`read`], of a text without problems.
    pub(super) fn clean<T: Description>(text: &str) -> T {
        let (value, problems) = read(text);
        assert_eq!(problems, [""; 0]);
        value
    }

    /// Problems of a text that is refused.
    pub(super) fn refused<T: Description>(text: &str) -> Vec<String> {
        match parse::<T>(text, Path::new("t.yaml")) {
            Err(LoadError::Refused { report, .. }) => report.problems().iter().map(|p| p.to_string()).collect(),
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("not refused"),
        }
    }

    #[test]
    fn versions() {
        assert!(parse::<Model>("adf version: 1.0\n", Path::new("t")).is_ok());
        assert!(parse::<Model>("adf version: '1.0'\n", Path::new("t")).is_ok());
        for other in ["1", "1.00", "2.0", "[1.0]"] {
            let text = format!("bodies: []\nadf version: {other}\n");
            let error = parse::<Model>(&text, Path::new("t")).unwrap_err();
            assert!(matches!(error, LoadError::Version { at, .. } if at.line == 2));
        }
    }

    #[test]
    fn the_version_in_other_letter_case_is_known_and_refuses_nothing() {
        clean::<Model>("ADF Version: 1.0\nbodies: []\n");
        clean::<ColorTable>("Adf version: '1.0'\nred: {r: 1, g: 2, b: 3, a: 4}\n");
        let (_, problems) = read::<World>("adf version: 1.0\nADF Version: 3.0\ngravity: {x: 0, y: 0, z: 0}\n");
        let expected =
            "dir/t.yaml:2:14: warning: `ADF Version` is `3.0`, expected 1.0; the file is read as version 1.0";
        assert_eq!(problems, [expected]);
    }

    #[test]
    fn a_syntax_error_behind_an_unusual_flow_collection_is_the_one_reported() {
        let text = "s: &s\n{\n  a: 1\n}\nbodies: [A\njoints: []\n";
        let error = parse::<Model>(text, Path::new("t")).unwrap_err();
        assert!(matches!(&error, LoadError::Syntax { at, .. } if at.line == 6), "{error}");
    }

    #[test]
    fn a_byte_order_mark_is_skipped() {
        let model: Model = clean("\u{feff}namespace: /a/\n");
        assert_eq!(model.namespace, "/a/");
    }

    #[test]
    fn positions_of_what_is_no_text() {
        let error = parse_bytes::<Model>(b"a: 1\nb: \xC3\xA9\xFF", Path::new("t")).unwrap_err();
        let LoadError::NotText { at, .. } = &error else { panic!("{error}") };
        assert_eq!((at.line, at.column), (2, 5));
        let error = parse::<Model>("a: \0", Path::new("t")).unwrap_err();
        assert!(error.to_string().starts_with("t:1:4: a control character"));
    }
}
