//! NRRD files (<https://teem.sourceforge.net/nrrd/format.html>): a text header, and numbers in the same file or beside
//! it; with segments as 3D Slicer names them.
//!
//! Voxel (i, j, k) is the sample of these indices along the three axes of space; where these are left-handed, k is counted
//! from the last sample, so that nothing is mirrored. Colours (an axis of kind `RGBA-color` or
//! of 3 or 4 samples before the axes of space) have alpha, or their brightest channel, as density. Segments have the
//! density 255. Other numbers are spread over 0 to 255 between the smallest and the largest, but bytes, which stay; where
//! all are equal, those that are not 0 have the density 255.
//!
//! ## Limitations
//! One data file; encodings `raw`, `gzip` and text; all integers and floats, no `block`.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use ambf_model::files::{self, Output, WriteError};
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use thiserror::Error;

use crate::grid::{check_size, MAX_LABELS, MAX_VOXELS};
use crate::{Coloring, GridError, Label, Voxel, VoxelGrid};

/// Most bytes of a header.
const MAX_HEADER: usize = 1 << 20;
/// Most samples a voxel: colours, or layers of segments.
const MAX_LAYERS: usize = 16;
/// Most bytes of data, packed or not.
const MAX_DATA: usize = MAX_VOXELS * 8;
/// Bytes behind the data that are nobody's error: a line end.
const SLACK: usize = 2;

/// Error when a NRRD file cannot be used.
#[derive(Debug, Error)]
#[error("{}{}: {problem}", path.display(), line.map_or(String::new(), |line| format!(":{line}")))]
pub struct NrrdError {
    /// The file.
    pub path: PathBuf,
    /// Line of the header, from 1 on.
    pub line: Option<usize>,
    /// What is wrong.
    pub problem: NrrdProblem,
}

/// What can be wrong with a NRRD file.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum NrrdProblem {
    /// Error when the file cannot be opened or read.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// Error when it does not begin as a NRRD file does.
    #[error("no NRRD file: it does not begin with `NRRD000` and a version from 1 to 5")]
    Magic,
    /// Error when the header does not end within 1 MiB.
    #[error("the header has no end within {} KiB", MAX_HEADER >> 10)]
    Header,
    /// Error when a field has an unusable value.
    #[error("{field}: expected {expected}, got `{got}`")]
    Field {
        /// Name of the field.
        field: String,
        /// What was expected.
        expected: &'static str,
        /// What is there.
        got: String,
    },
    /// Error when a field is missing.
    #[error("the field `{0}` is missing")]
    Missing(&'static str),
    /// Error when the data have another length than the sizes say.
    #[error("{got} bytes or numbers of data, {expected} were expected from type and sizes")]
    Length {
        /// What is there, or a few more than expected.
        got: usize,
        /// What the sizes say.
        expected: usize,
    },
    /// Error when the voxels are too many, or none.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// What a file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The voxels, in a box with the edges that the file says.
    pub grid: VoxelGrid,
    /// Pose of the box's centre in the file's space, m, left-posterior-superior.
    pub pose: Isometry3<f64>,
    /// What was changed or left out, for people.
    pub notes: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Kind {
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "signed char" | "int8" | "int8_t" => Self::I8,
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => Self::U8,
            "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Self::I16,
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Self::U16,
            "int" | "signed int" | "int32" | "int32_t" => Self::I32,
            "uint" | "unsigned int" | "uint32" | "uint32_t" => Self::U32,
            "longlong"
            | "long long"
            | "long long int"
            | "signed long long"
            | "signed long long int"
            | "int64"
            | "int64_t" => Self::I64,
            "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Self::U64,
            "float" => Self::F32,
            "double" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// A number of the first bytes of `bytes`, which are at least as many as the type has.
    fn number(self, bytes: &[u8], big: bool) -> f64 {
        let mut raw = [0; 8];
        let width = self.bytes();
        raw[..width].copy_from_slice(&bytes[..width]);
        if big {
            raw[..width].reverse();
        }
        let word = u64::from_le_bytes(raw);
        match self {
            Self::I8 => f64::from(word as i8),
            Self::U8 => f64::from(word as u8),
            Self::I16 => f64::from(word as i16),
            Self::U16 => f64::from(word as u16),
            Self::I32 => f64::from(word as i32),
            Self::U32 => f64::from(word as u32),
            Self::I64 => word as i64 as f64,
            Self::U64 => word as f64,
            Self::F32 => f64::from(f32::from_bits(word as u32)),
            Self::F64 => f64::from_bits(word),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Raw,
    Gzip,
    Text,
}

/// A header, taken apart.
#[derive(Debug)]
struct Header {
    /// By field, with the line.
    fields: BTreeMap<String, (usize, String)>,
    /// Of `key:=value`, in order.
    keys: BTreeMap<String, String>,
    /// Where the data begin.
    end: usize,
}

/// Reads a file; voxels of a density of `iso`, 0 to 1, and more are solid.
///
/// # Errors
/// [`NrrdError`]. Nothing larger than the sizes in the header is reserved, and these are checked before.
pub fn read(path: &Path, iso: f64) -> Result<Loaded, NrrdError> {
    let failed = |problem| NrrdError { path: path.to_path_buf(), line: None, problem };
    let limit = (MAX_HEADER + MAX_DATA) as u64;
    let bytes = files::read(path, limit).map_err(|error| failed(error.into()))?;
    parse(&bytes, iso, path, &|name| {
        let beside = path.parent().unwrap_or(Path::new("")).join(name);
        files::read(&beside, limit)
            .map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", beside.display())))
    })
}

/// Reads the content of a file as [`read`] reads a file; `path` stands for its name, and `beside` reads the file of its
/// data.
///
/// # Errors
/// As [`read`].
pub fn parse(
    bytes: &[u8],
    iso: f64,
    path: &Path,
    beside: &dyn Fn(&str) -> io::Result<Vec<u8>>,
) -> Result<Loaded, NrrdError> {
    let at = |line: Option<usize>| move |problem| NrrdError { path: path.to_path_buf(), line, problem };
    let header = Header::read(bytes).map_err(|(line, problem)| at(line)(problem))?;
    load(&header, bytes, iso, beside).map_err(|(line, problem)| at(line)(problem))
}

type Problem = (Option<usize>, NrrdProblem);

impl Header {
    fn read(bytes: &[u8]) -> Result<Self, Problem> {
        let head = &bytes[..bytes.len().min(MAX_HEADER)];
        let version = head.get(7).is_some_and(|version| (b'1'..=b'5').contains(version));
        if !head.starts_with(b"NRRD000") || !version {
            return Err((Some(1), NrrdProblem::Magic));
        }
        let mut header = Self { fields: BTreeMap::new(), keys: BTreeMap::new(), end: bytes.len() };
        let (mut start, mut number) = (0, 0);
        loop {
            let Some(length) = head[start..].iter().position(|byte| *byte == b'\n') else {
                // A header without data may end with the file.
                if head.len() < bytes.len() {
                    return Err((None, NrrdProblem::Header));
                }
                header.take(&String::from_utf8_lossy(&head[start..]), number + 1);
                return Ok(header);
            };
            let line = String::from_utf8_lossy(&head[start..start + length]);
            start += length + 1;
            number += 1;
            let line = line.trim_end_matches('\r');
            if line.is_empty() {
                header.end = start;
                return Ok(header);
            }
            header.take(line, number);
        }
    }

    fn take(&mut self, line: &str, number: usize) {
        if line.starts_with('#') {
            return;
        }
        if let Some((key, value)) = line.split_once(":=") {
            self.keys.insert(key.trim().to_owned(), value.trim().to_owned());
        } else if let Some((field, value)) = line.split_once(": ") {
            // Blanks and the hyphen of `data-file` do not count.
            let field = field.trim().to_ascii_lowercase().replace([' ', '-', '_'], "");
            self.fields.insert(field, (number, value.trim().to_owned()));
        }
    }

    fn field(&self, name: &str) -> Option<(usize, &str)> {
        self.fields.get(&name.replace(' ', "")).map(|(line, value)| (*line, value.as_str()))
    }

    fn need(&self, name: &'static str) -> Result<(usize, &str), Problem> {
        self.field(name).ok_or((None, NrrdProblem::Missing(name)))
    }

    fn wrong(&self, name: &str, expected: &'static str) -> Problem {
        let (line, got) = self.field(name).unwrap_or_default();
        let got = got.chars().take(60).collect();
        (Some(line), NrrdProblem::Field { field: name.to_owned(), expected, got })
    }

    fn integers(&self, name: &'static str) -> Result<Vec<usize>, Problem> {
        let (_, text) = self.need(name)?;
        let numbers: Result<Vec<usize>, _> = text.split_ascii_whitespace().map(str::parse).collect();
        numbers.map_err(|_| self.wrong(name, "whole numbers, not negative"))
    }

    fn skip(&self, name: &'static str) -> Result<Option<i64>, Problem> {
        let parsed = self.field(name).map(|(_, text)| text.parse::<i64>());
        parsed.transpose().map_err(|_| self.wrong(name, "a whole number"))
    }
}

/// A vector as `(x,y,z)`; `None` for `none`.
fn vector(text: &str) -> Option<Vec<f64>> {
    let inner = text.strip_prefix('(')?.strip_suffix(')')?;
    let numbers: Result<Vec<f64>, _> = inner.split(',').map(|number| number.trim().parse()).collect();
    numbers.ok().filter(|numbers| numbers.iter().all(|number| number.is_finite()))
}

/// Vectors of a field, which are apart by blanks.
fn vectors(text: &str) -> Vec<Option<Vec<f64>>> {
    let mut rest = text.trim();
    let mut all = Vec::new();
    while !rest.is_empty() {
        let length =
            if rest.starts_with('(') { rest.find(')').map(|at| at + 1) } else { rest.find(char::is_whitespace) };
        let (one, next) = rest.split_at(length.unwrap_or(rest.len()));
        all.push(vector(one));
        rest = next.trim_start();
    }
    all
}

fn load(
    header: &Header,
    bytes: &[u8],
    iso: f64,
    beside: &dyn Fn(&str) -> io::Result<Vec<u8>>,
) -> Result<Loaded, Problem> {
    let mut notes = Vec::new();
    let (_, name) = header.need("type")?;
    let kind = Kind::of(&name.to_ascii_lowercase())
        .ok_or_else(|| header.wrong("type", "an integer of 8 to 64 bits, float or double"))?;
    let (_, dimension) = header.need("dimension")?;
    let sizes = header.integers("sizes")?;
    if dimension.parse() != Ok(sizes.len()) || !(3..=4).contains(&sizes.len()) {
        return Err(header.wrong("dimension", "3, or 4 with colours or layers of segments first, and as many sizes"));
    }
    let (layers, size) = match sizes[..] {
        [x, y, z] => (1, [x, y, z]),
        [layers, x, y, z] => (layers, [x, y, z]),
        _ => return Err(header.wrong("sizes", "3 or 4 sizes")),
    };
    if layers == 0 || layers > MAX_LAYERS {
        return Err(header.wrong("sizes", "at most 16 colours or layers, first"));
    }
    check_size(size).map_err(|error| (None, error.into()))?;
    let voxels = size.iter().product::<usize>();
    // Both factors are small enough by now.
    let numbers = voxels * layers;
    if numbers > MAX_DATA / kind.bytes() {
        return Err(header.wrong("sizes", "at most 8 GiB of data: a smaller type, fewer layers, or a lower resolution"));
    }
    let big = match header.field("endian").map(|(_, text)| text.to_ascii_lowercase()) {
        None => false,
        Some(text) if text == "little" => false,
        Some(text) if text == "big" => true,
        Some(_) => return Err(header.wrong("endian", "`little` or `big`")),
    };
    let encoding = match header.need("encoding")?.1.to_ascii_lowercase().as_str() {
        "raw" => Encoding::Raw,
        "gzip" | "gz" => Encoding::Gzip,
        "text" | "txt" | "ascii" => Encoding::Text,
        _ => return Err(header.wrong("encoding", "raw, gzip or ascii: save it anew")),
    };
    let data = samples(header, bytes, kind, big, encoding, numbers, beside)?;
    let Place { edges, pose, is_mirrored } = place(header, size, sizes.len() == 4, &mut notes)?;
    let made = |grid: Result<VoxelGrid, GridError>| grid.map_err(|error| (None, error.into()));
    let grid;
    let segments = segments(header, &mut notes);
    let colors = header.field("kinds").is_some_and(|(_, kinds)| kinds.to_ascii_lowercase().contains("-color"));
    let flat = |[i, j, k]: [usize; 3]| {
        let k = if is_mirrored { size[2] - 1 - k } else { k };
        ((k * size[1] + j) * size[0] + i) * layers
    };
    let number = |at: usize| kind.number(&data[at * kind.bytes()..], big);
    if !segments.is_empty() {
        let labels: Vec<Label> = segments.iter().map(|segment| segment.label.clone()).collect();
        // (layers x values): labels, the last named segment first, as Slicer draws them.
        let mut named = BTreeMap::new();
        for (segment, label) in segments.iter().zip(1_u8..) {
            named.insert((segment.layer, segment.value), label);
        }
        grid = made(VoxelGrid::from_fn(size, edges, iso, labels, |index| {
            let at = flat(index);
            let of_layer = |layer: usize| named.get(&(layer, number(at + layer) as i64)).copied();
            (0..layers).rev().find_map(of_layer).map_or(Voxel::default(), |label| Voxel { density: 255, label })
        }))?;
    } else if layers == 3 || layers == 4 || colors {
        if !(layers == 3 || layers == 4) || kind != Kind::U8 {
            return Err(header.wrong("sizes", "3 or 4 bytes of colour, first"));
        }
        let rgb = |at: usize| [data[at], data[at + 1], data[at + 2]];
        let density = |at: usize| if layers == 4 { data[at + 3] } else { rgb(at).into_iter().fold(0, u8::max) };
        let mut palette = std::collections::BTreeSet::new();
        for at in (0..numbers).step_by(layers) {
            if density(at) > 0 && palette.len() <= MAX_LABELS {
                palette.insert(rgb(at));
            }
        }
        if palette.len() > MAX_LABELS {
            return Err(header.wrong("sizes", "at most 255 colours: save the segments instead, or a stack of pictures"));
        }
        let palette: Vec<_> = palette.into_iter().collect();
        let labels = palette.iter().map(|&color| Label::of_color(color)).collect();
        let mut read = made(VoxelGrid::from_fn(size, edges, iso, labels, |index| {
            let at = flat(index);
            match (density(at), palette.binary_search(&rgb(at))) {
                (0, _) | (_, Err(_)) => Voxel::default(),
                (density, Ok(place)) => Voxel { density, label: place as u8 + 1 },
            }
        }))?;
        if layers == 3 {
            let labels = read.labels()[1..].to_vec();
            read.set_labels(labels, Coloring::Opaque);
        }
        grid = read;
    } else {
        if layers > 1 {
            notes.push(format!("of {layers} layers only the first is read: no segments are named"));
        }
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        if kind == Kind::U8 {
            (low, high) = (0.0, 255.0);
        } else {
            let values = (0..numbers).step_by(layers).map(number).filter(|value| value.is_finite());
            values.for_each(|value| (low, high) = (low.min(value), high.max(value)));
            if low == high {
                notes.push(format!("all numbers are {low}: density 1, or 0 for the number 0"));
            } else if low < high {
                notes.push(format!("densities 0 to 1 stand for {low} to {high}"));
            }
        }
        // Half of numbers of opposite signs is apart by what can be represented.
        let scale = if (high - low).is_finite() { 1.0 } else { 0.5 };
        let (least, span) = (low * scale, high * scale - low * scale);
        let density = |value: f64| {
            if low == high {
                return if value.is_finite() && value != 0.0 { 255 } else { 0 };
            }
            // What is no number is empty; `as` saturates.
            ((value * scale - least) / span * 255.0).round() as u8
        };
        let mut read = made(VoxelGrid::from_fn(size, edges, iso, vec![Label::of_color([255; 3])], |index| {
            let density = density(number(flat(index)));
            Voxel { density, label: u8::from(density > 0) }
        }))?;
        let labels = read.labels()[1..].to_vec();
        read.set_labels(labels, Coloring::Grey);
        grid = read;
    }
    Ok(Loaded { grid, pose, notes })
}

/// All numbers as bytes of the type; text becomes numbers of the type, in the byte order of the file.
fn samples(
    header: &Header,
    bytes: &[u8],
    kind: Kind,
    big: bool,
    encoding: Encoding,
    numbers: usize,
    beside: &dyn Fn(&str) -> io::Result<Vec<u8>>,
) -> Result<Vec<u8>, Problem> {
    let file = header.field("data file").or_else(|| header.field("datafile"));
    let read;
    let mut data = match file {
        None => &bytes[header.end..],
        Some((line, name)) => {
            if name.starts_with("LIST") || name.contains('%') {
                return Err(header.wrong("data file", "the name of one file"));
            }
            read = beside(name).map_err(|error| (Some(line), error.into()))?;
            &read[..]
        }
    };
    let expected = numbers * kind.bytes();
    for _ in 0..header.skip("line skip")?.unwrap_or(0).max(0) {
        let Some(at) = data.iter().position(|byte| *byte == b'\n') else {
            return Err(header.wrong("line skip", "as many lines as there are"));
        };
        data = &data[at + 1..];
    }
    let unpacked;
    let skip = header.skip("byte skip")?.unwrap_or(0);
    if encoding == Encoding::Gzip {
        let failed = |error: io::Error| (None, error.into());
        let skipped = u64::try_from(skip).map_err(|_| header.wrong("byte skip", "a number that is not negative"))?;
        let mut decoder = MultiGzDecoder::new(data);
        // What is skipped is not held.
        let passed = io::copy(&mut decoder.by_ref().take(skipped), &mut io::sink()).map_err(failed)?;
        if passed < skipped {
            return Err(header.wrong("byte skip", "fewer bytes than there are"));
        }
        let mut out = Vec::new();
        decoder.take((expected + SLACK + 1) as u64).read_to_end(&mut out).map_err(failed)?;
        unpacked = out;
        data = &unpacked;
    } else if skip == -1 && encoding == Encoding::Raw {
        data = &data[data.len().saturating_sub(expected)..];
    } else if skip >= 0 {
        data = data.get(skip as usize..).ok_or_else(|| header.wrong("byte skip", "fewer bytes than there are"))?;
    } else {
        return Err(header.wrong("byte skip", "a number not negative, or -1 with raw data"));
    }
    let wrong = |got| {
        (None, NrrdProblem::Length { got, expected: if encoding == Encoding::Text { numbers } else { expected } })
    };
    if encoding != Encoding::Text {
        return match data.len() {
            length if length < expected || length > expected + SLACK => Err(wrong(length)),
            _ => Ok(data[..expected].to_vec()),
        };
    }
    // A number takes two bytes at least, so that nothing is reserved for numbers that cannot be there.
    if data.len() + 1 < 2 * numbers {
        return Err(wrong(data.len().div_ceil(2)));
    }
    let text = std::str::from_utf8(data).map_err(|_| header.wrong("encoding", "text in the data"))?;
    let mut all = Vec::with_capacity(expected);
    let mut count = 0;
    for word in text.split(|c: char| c.is_ascii_whitespace() || c == ',').filter(|word| !word.is_empty()) {
        if count == numbers {
            return Err(wrong(numbers + 1));
        }
        let number: f64 = word.parse().map_err(|_| {
            let got = word.chars().take(60).collect();
            (None, NrrdProblem::Field { field: "data".to_owned(), expected: "numbers", got })
        })?;
        let mut raw = match kind {
            Kind::F32 => u64::from((number as f32).to_bits()),
            Kind::F64 => number.to_bits(),
            Kind::U64 => word.parse().unwrap_or(number as u64),
            Kind::U8 | Kind::U16 | Kind::U32 => number as u64,
            _ => word.parse().unwrap_or(number as i64) as u64,
        }
        .to_le_bytes();
        if big {
            raw[..kind.bytes()].reverse();
        }
        all.extend_from_slice(&raw[..kind.bytes()]);
        count += 1;
    }
    if count == numbers {
        Ok(all)
    } else {
        Err(wrong(count))
    }
}

/// Where the voxels are.
struct Place {
    /// Of the box, m.
    edges: Vector3<f64>,
    /// Of the box's centre.
    pose: Isometry3<f64>,
    /// Whether the third index runs against the third axis of the box, whose axes are right-handed.
    is_mirrored: bool,
}

/// Signs of the coordinates of a space in left-posterior-superior.
fn signs(header: &Header) -> Result<Vector3<f64>, Problem> {
    let Some((_, text)) = header.field("space") else { return Ok(Vector3::repeat(1.0)) };
    let name = text.to_ascii_lowercase().replace([' ', '-', '_'], "");
    Ok(match name.as_str() {
        // Of the last two nobody knows how they are to a patient: they stay.
        "leftposteriorsuperior" | "lps" | "scannerxyz" | "3drighthanded" => Vector3::new(1.0, 1.0, 1.0),
        "rightanteriorsuperior" | "ras" => Vector3::new(-1.0, -1.0, 1.0),
        "leftanteriorsuperior" | "las" => Vector3::new(1.0, -1.0, 1.0),
        _ => return Err(header.wrong(
            "space",
            "left-posterior-superior, right-anterior-superior, left-anterior-superior, scanner-xyz or 3D-right-handed",
        )),
    })
}

fn place(header: &Header, size: [usize; 3], skip_first: bool, notes: &mut Vec<String>) -> Result<Place, Problem> {
    // Numbers are mm, unless units say something else.
    let unit = match header.field("space units").map(|(_, text)| text.to_ascii_lowercase()) {
        Some(text) if text.contains("\"m\"") => 1.0,
        Some(text) if text.contains("\"cm\"") => 1e-2,
        Some(text) if text.contains("um\"") => 1e-6,
        _ => 1e-3,
    };
    let skip = usize::from(skip_first);
    let mut axes = Matrix3::identity();
    if let Some((_, text)) = header.field("space directions") {
        let given = vectors(text);
        let of_space: Vec<_> = given.into_iter().skip(skip).collect();
        let all: Option<Vec<_>> = of_space.iter().map(|v| v.as_ref().filter(|v| v.len() == 3)).collect();
        let all = all
            .filter(|all| all.len() == 3)
            .ok_or_else(|| header.wrong("space directions", "three vectors (x,y,z)"))?;
        for (axis, direction) in all.iter().enumerate() {
            axes.set_column(axis, &Vector3::from_column_slice(direction));
        }
    } else if let Some((_, text)) = header.field("spacings") {
        let given: Result<Vec<f64>, _> = text.split_ascii_whitespace().map(str::parse).collect();
        let given = given.map_err(|_| header.wrong("spacings", "a number for each axis"))?;
        let given = given.get(skip..).filter(|given| given.len() == 3);
        let given = given.ok_or_else(|| header.wrong("spacings", "a number for each axis"))?;
        axes = Matrix3::from_diagonal(&Vector3::from_column_slice(given));
    } else {
        notes.push("neither `space directions` nor `spacings`: voxels of 1 mm".to_owned());
    }
    let to_space = Matrix3::from_diagonal(&signs(header)?) * unit;
    axes = to_space * axes;
    let spacing = Vector3::from_fn(|axis, _| axes.column(axis).norm());
    if !spacing.iter().all(|edge| edge.is_finite() && *edge > 0.0 && *edge < 1e6) {
        return Err(header.wrong("space directions", "vectors that are not zero"));
    }
    let edges = Vector3::from_fn(|axis, _| spacing[axis] * size[axis] as f64);
    let mut rotation = Matrix3::from_fn(|row, column| axes[(row, column)] / spacing[column]);
    let is_mirrored = rotation.determinant() < 0.0;
    if is_mirrored {
        notes.push("the axes are left-handed: the third index of a voxel is counted from the other end".to_owned());
        let mirrored = -rotation.column(2);
        rotation.set_column(2, &mirrored);
    }
    if rotation.determinant() < 1e-3 {
        return Err(header.wrong("space directions", "vectors that are not in a plane"));
    }
    // The nearest rotation, by Newton's method for the polar decomposition (Higham 1986): it converges quadratically,
    // and perpendicular axes stay as they are.
    let given = rotation;
    for _ in 0..20 {
        let Some(inverse) = rotation.try_inverse() else { break };
        rotation = (rotation + inverse.transpose()) * 0.5;
    }
    if (rotation - given).norm() > 1e-3 {
        notes.push("the axes are not perpendicular: the volume is drawn in the nearest box".to_owned());
    }
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    let mut origin = Vector3::zeros();
    if let Some((_, text)) = header.field("space origin") {
        let given = vector(text).filter(|given| given.len() == 3);
        let given = given.ok_or_else(|| header.wrong("space origin", "a vector (x,y,z)"))?;
        origin = to_space * Vector3::from_column_slice(&given);
    }
    // The origin is the centre of the first voxel of the file, whatever the handedness.
    let center = origin + axes * Vector3::from_fn(|axis, _| 0.5 * (size[axis] - 1) as f64);
    let pose = Isometry3::from_parts(center.into(), UnitQuaternion::from_rotation_matrix(&rotation));
    Ok(Place { edges, pose, is_mirrored })
}

struct Segment {
    layer: usize,
    value: i64,
    label: Label,
}

/// Segments as 3D Slicer writes them.
fn segments(header: &Header, notes: &mut Vec<String>) -> Vec<Segment> {
    let key = |number: usize, what: &str| header.keys.get(&format!("Segment{number}_{what}"));
    let mut segments = Vec::new();
    let there = (0..).take_while(|&number| key(number, "ID").or(key(number, "LabelValue")).is_some());
    for number in there.take(MAX_HEADER) {
        if segments.len() == MAX_LABELS {
            notes.push(format!("only the first {MAX_LABELS} segments are read"));
            break;
        }
        let value = key(number, "LabelValue").and_then(|text| text.parse().ok()).unwrap_or(number as i64 + 1);
        let layer = key(number, "Layer").and_then(|text| text.parse().ok()).unwrap_or(0);
        let color = key(number, "Color").map(|text| {
            let parts = text.split_ascii_whitespace().map(|part| part.parse().unwrap_or(0.0_f64));
            let mut color = [0; 3];
            color.iter_mut().zip(parts).for_each(|(level, part)| *level = (part * 255.0).round() as u8);
            color
        });
        let name = key(number, "Name").or(key(number, "ID")).cloned().unwrap_or_default();
        let hardness = key(number, "Hardness").and_then(|text| text.parse().ok());
        let hardness = hardness.filter(|hardness: &f64| hardness.is_finite() && *hardness > 0.0).unwrap_or(1.0);
        segments.push(Segment { layer, value, label: Label { color: color.unwrap_or([255; 3]), name, hardness } });
    }
    segments
}

/// Writes voxels with gzip: grey as bytes, voxels that are empty or of the density 255 as segments, others as colours.
/// `pose` is that of the box's centre, left-posterior-superior. What is read from the file are the same voxels.
///
/// # Errors
/// [`WriteError`]; the file of before, or none, is there then.
pub fn write(grid: &VoxelGrid, path: &Path, pose: &Isometry3<f64>) -> Result<(), WriteError> {
    let (densities, labels) = grid.to_arrays();
    let is_binary = densities.iter().zip(&labels).all(|(density, label)| match density {
        0 => *label == 0,
        255 => *label != 0,
        _ => false,
    });
    let coloring = grid.coloring();
    let is_segments = is_binary && coloring == Coloring::Labels && !grid.has_own_colors();
    let channels = match coloring {
        Coloring::Grey => 1,
        Coloring::Labels if is_segments => 1,
        Coloring::Opaque => 3,
        Coloring::Labels => 4,
    };
    let rotation = pose.rotation.to_rotation_matrix();
    let axes = rotation.matrix() * Matrix3::from_diagonal(&(grid.spacing() * 1e3));
    let origin = (pose.translation.vector - rotation * ((grid.edges() - grid.spacing()) * 0.5)) * 1e3;
    let text = |v: Vector3<f64>| format!("({},{},{})", v.x, v.y, v.z);
    let [x, y, z] = grid.size();
    let mut head = String::from("NRRD0004\n# Voxels of the asynchronous multi-body framework.\ntype: unsigned char\n");
    let directions = [0, 1, 2].map(|axis| text(axes.column(axis).into())).join(" ");
    match channels {
        1 => head += &format!("dimension: 3\nspace: left-posterior-superior\nsizes: {x} {y} {z}\nspace directions: {directions}\nkinds: domain domain domain\n"),
        _ => {
            let kind = if channels == 4 { "RGBA-color" } else { "RGB-color" };
            head += &format!("dimension: 4\nspace: left-posterior-superior\nsizes: {channels} {x} {y} {z}\nspace directions: none {directions}\nkinds: {kind} domain domain domain\n");
        }
    }
    head += &format!("encoding: gzip\nspace origin: {}\n", text(origin));
    if is_segments {
        for (number, label) in grid.labels().iter().skip(1).enumerate() {
            let [r, g, b] = label.color.map(|level| f64::from(level) / 255.0);
            let name = if label.name.is_empty() { format!("Segment_{}", number + 1) } else { label.name.clone() };
            let name: String = name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
            head += &format!("Segment{number}_ID:=Segment_{}\nSegment{number}_Name:={name}\nSegment{number}_Color:={r} {g} {b}\nSegment{number}_LabelValue:={}\nSegment{number}_Layer:=0\nSegment{number}_Hardness:={}\n", number + 1, number + 1, label.hardness);
        }
    }
    head += "\n";
    Output::write_whole(path, |file| {
        file.write_all(head.as_bytes())?;
        let mut gzip = GzEncoder::new(io::BufWriter::new(file), flate2::Compression::fast());
        match channels {
            1 => gzip.write_all(if coloring == Coloring::Grey { &densities } else { &labels })?,
            4 => gzip.write_all(&grid.to_rgba())?,
            _ => {
                for pixel in grid.to_rgba().chunks_exact(4) {
                    gzip.write_all(&pixel[..3])?;
                }
            }
        }
        gzip.finish()?.flush()
    })
}
