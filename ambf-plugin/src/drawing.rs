//! What plugins show in windows besides the scene: markers, texts and pictures, as plain data.

use std::sync::Arc;

use arc_swap::ArcSwap;
use nalgebra::{Isometry3, Vector3};

use super::abi::{slice, RawDrawing, RawPose, RawText};
use super::CommandError;

/// Drawings that one plugin may show at a time.
pub const MAX_DRAWINGS: usize = 10_000;
/// Points of all drawings of one plugin at a time.
pub const MAX_POINTS: usize = 1_000_000;
/// Bytes of all texts of one plugin at a time.
pub const MAX_TEXT: usize = 100_000;

/// Pixels of all pictures of one plugin at a time.
pub const MAX_PIXELS: usize = 1 << 24;
/// Pixels of a picture each way.
const MAX_SIDE: u32 = 8192;

/// A picture: (height x width) pixels of red, green, blue and alpha, top row first. Alpha is not multiplied into the
/// colours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pixels {
    width: u32,
    height: u32,
    rgba: Vec<[u8; 4]>,
}

impl Pixels {
    /// A picture of `width` x `height` pixels, 1 to 8192 each way; `None` for others and if `rgba` are not as many.
    pub fn new(width: u32, height: u32, rgba: Vec<[u8; 4]>) -> Option<Self> {
        let is_possible = [width, height].iter().all(|side| (1..=MAX_SIDE).contains(side));
        (is_possible && rgba.len() == width as usize * height as usize).then_some(Self { width, height, rgba })
    }

    /// Pixels from left to right.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels from top to bottom.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Row by row from the top.
    pub fn rgba(&self) -> &[[u8; 4]] {
        &self.rgba
    }
}

/// A marker, a text or a picture in windows. Pictures that are published don't have it.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Number of the window, from 1, as its title says; 0: all windows.
    pub window: u32,
    /// Pose in the world, m. Of texts and pictures only [`TextPlace::Scene`] uses it.
    pub pose: Isometry3<f64>,
    /// Red, green, blue, alpha, 0 to 1; pictures are multiplied by it.
    pub color: [f32; 4],
    /// What it is.
    pub shape: DrawingShape,
}

/// Shape of a [`Drawing`], in the frame of its pose.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum DrawingShape {
    /// A ball of this radius, m.
    Sphere(f64),
    /// A box of these full edge lengths, m.
    Box([f64; 3]),
    /// An arrow along +x: length and radius of the shaft, m.
    Arrow(f64, f64),
    /// Three arrows of this length, m: x red, y green, z blue; the colour is not used.
    Frame(f64),
    /// Square points of this size in pixels, unlit; points in m.
    Points(Vec<Vector3<f64>>, f64),
    /// Lines between successive pairs of points (m), unlit, one pixel wide.
    Lines(Vec<Vector3<f64>>),
    /// A text, of one or more lines.
    Text {
        /// What it says.
        text: String,
        /// Where its upper left corner is.
        place: TextPlace,
        /// Height of a line, pixels.
        height: f64,
        /// Colour of a rectangle with rounded corners behind it; `None`: there is none.
        panel: Option<[f32; 4]>,
    },
    /// A picture.
    Picture {
        /// The same `Arc` in the next frame is not loaded again.
        pixels: Arc<Pixels>,
        /// Where its upper left corner is.
        place: TextPlace,
        /// Height in pixels of the window; 0: the picture fills the window, whatever its shape.
        height: f64,
        /// Behind everything that is drawn of the scene, and before its sky; else before everything.
        is_behind: bool,
    },
}

/// Where in a window a text or a picture is.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum TextPlace {
    /// x and y in pixels from the upper left corner of the window; negative ones count from the right and lower edge.
    Pixels(f64, f64),
    /// x and y as shares of the width and height of the window, from its upper left corner: 0 to 1.
    Share(f64, f64),
    /// Where the origin of the drawing's pose is seen; nowhere if that is behind the camera. Stereo windows show it
    /// once for each eye.
    Scene,
}

impl TextPlace {
    fn is_finite(&self) -> bool {
        match self {
            TextPlace::Pixels(x, y) | TextPlace::Share(x, y) => x.is_finite() && y.is_finite(),
            TextPlace::Scene => true,
        }
    }

    /// Its number in plain data, from that of the first on, and x and y.
    fn raw(self, first: u32) -> (u32, f64, f64) {
        match self {
            TextPlace::Pixels(x, y) => (first, x, y),
            TextPlace::Share(x, y) => (first + 1, x, y),
            TextPlace::Scene => (first + 2, 0.0, 0.0),
        }
    }

    fn of_raw(number: u32, x: f64, y: f64) -> Self {
        match number {
            0 => TextPlace::Pixels(x, y),
            1 => TextPlace::Share(x, y),
            _ => TextPlace::Scene,
        }
    }
}

impl Drawing {
    /// A marker in all windows.
    pub fn new(shape: DrawingShape, pose: Isometry3<f64>, color: [f32; 4]) -> Self {
        Self { window: 0, pose, color, shape }
    }

    /// A black text of 16 pixels a line in all windows, without a panel.
    pub fn text(text: impl Into<String>, place: TextPlace) -> Self {
        let shape = DrawingShape::Text { text: text.into(), place, height: 16.0, panel: None };
        Self::new(shape, Isometry3::identity(), [0.0, 0.0, 0.0, 1.0])
    }

    /// The same in one window only, by its number from 1.
    pub fn in_window(self, window: u32) -> Self {
        Self { window, ..self }
    }

    fn is_finite(&self) -> bool {
        let colors = self.color.iter().all(|x| x.is_finite());
        let shape = match &self.shape {
            DrawingShape::Sphere(x) | DrawingShape::Frame(x) => x.is_finite(),
            DrawingShape::Box(edges) => edges.iter().all(|x| x.is_finite()),
            DrawingShape::Arrow(length, radius) => length.is_finite() && radius.is_finite(),
            DrawingShape::Points(points, size) => size.is_finite() && points.iter().flatten().all(|x| x.is_finite()),
            DrawingShape::Lines(points) => points.iter().flatten().all(|x| x.is_finite()),
            DrawingShape::Text { place, height, panel, .. } => {
                place.is_finite() && height.is_finite() && panel.iter().flatten().all(|x| x.is_finite())
            }
            DrawingShape::Picture { place, height, .. } => place.is_finite() && height.is_finite(),
        };
        colors && shape && RawPose::from(&self.pose).pose().is_some()
    }

    /// As plain data, which borrows from `self`; `points` is where points of it are kept meanwhile.
    pub(super) fn raw<'a>(&'a self, points: &'a mut Vec<[f64; 3]>) -> RawDrawing {
        let mut raw = RawDrawing {
            window: self.window,
            pose: RawPose::from(&self.pose),
            color: self.color,
            ..RawDrawing::default()
        };
        match &self.shape {
            DrawingShape::Sphere(radius) => (raw.shape, raw.numbers[0]) = (0, *radius),
            DrawingShape::Box(edges) => {
                raw.shape = 1;
                raw.numbers[..3].copy_from_slice(edges);
            }
            DrawingShape::Arrow(length, radius) => (raw.shape, raw.numbers) = (2, [*length, *radius, 0.0]),
            DrawingShape::Frame(length) => (raw.shape, raw.numbers[0]) = (3, *length),
            DrawingShape::Points(all, size) => {
                (raw.shape, raw.numbers[0]) = (4, *size);
                points.extend(all.iter().map(|point| <[f64; 3]>::from(*point)));
            }
            DrawingShape::Lines(all) => {
                raw.shape = 5;
                points.extend(all.iter().map(|point| <[f64; 3]>::from(*point)));
            }
            DrawingShape::Text { text, place, height, panel } => {
                raw.text = RawText::of(text);
                raw.panel = panel.unwrap_or_default();
                let (shape, x, y) = place.raw(6);
                (raw.shape, raw.numbers) = (shape, [x, y, *height]);
            }
            DrawingShape::Picture { pixels, place, height, is_behind } => {
                let (shape, x, y) = place.raw(9);
                (raw.shape, raw.numbers) = (shape, [x, y, *height]);
                (raw.pixels, raw.width, raw.height) = (pixels.rgba.as_ptr(), pixels.width, pixels.height);
                raw.behind = (*is_behind).into();
            }
        }
        (raw.points, raw.point_count) = (points.as_ptr(), points.len() as u64);
        raw
    }

    /// What plain data says.
    ///
    /// # Errors
    /// [`CommandError::Unknown`] for a shape that is none, [`CommandError::NotFinite`] for a pose that is none,
    /// [`CommandError::Refused`] for points and pixels at null, [`CommandError::TooMuch`].
    ///
    /// # Safety
    /// Points, text and pixels are null or as many as they say, and live until this returns.
    pub(super) unsafe fn from_raw(raw: &RawDrawing) -> Result<Self, CommandError> {
        if raw.point_count > MAX_POINTS as u64 || raw.text.length > MAX_TEXT as u64 {
            return Err(CommandError::TooMuch);
        }
        let points = || {
            // SAFETY: the caller vouches for the points.
            let points = unsafe { slice(raw.points, raw.point_count) }.ok_or(CommandError::Refused)?;
            Ok(points.iter().map(|point| Vector3::from(*point)).collect())
        };
        let [a, b, c] = raw.numbers;
        let text = |place| DrawingShape::Text {
            // SAFETY: the caller vouches for the text.
            text: unsafe { raw.text.read() },
            place: TextPlace::of_raw(place, a, b),
            height: c,
            panel: (raw.panel[3] != 0.0).then_some(raw.panel),
        };
        let shape = match raw.shape {
            0 => DrawingShape::Sphere(a),
            1 => DrawingShape::Box([a, b, c]),
            2 => DrawingShape::Arrow(a, b),
            3 => DrawingShape::Frame(a),
            4 => DrawingShape::Points(points()?, a),
            5 => DrawingShape::Lines(points()?),
            place @ 6..=8 => text(place - 6),
            place @ 9..=11 => {
                let count = u64::from(raw.width) * u64::from(raw.height);
                if count > MAX_PIXELS as u64 {
                    return Err(CommandError::TooMuch);
                }
                // SAFETY: the caller vouches for the pixels.
                let rgba = unsafe { slice(raw.pixels, count) }.ok_or(CommandError::Refused)?;
                let pixels = Pixels::new(raw.width, raw.height, rgba.to_vec()).ok_or(CommandError::Refused)?;
                let place = TextPlace::of_raw(place - 9, a, b);
                DrawingShape::Picture { pixels: Arc::new(pixels), place, height: c, is_behind: raw.behind == 1 }
            }
            _ => return Err(CommandError::Unknown),
        };
        // In C a pose that nobody has filled in is the origin of the world.
        let is_unset = raw.pose.position == [0.0; 3] && raw.pose.orientation == [0.0; 4];
        let pose = match is_unset {
            true => Isometry3::identity(),
            false => raw.pose.pose().ok_or(CommandError::NotFinite)?,
        };
        Ok(Self { window: raw.window, pose, color: raw.color, shape })
    }
}

/// Whether windows can show all of it.
///
/// # Errors
/// [`CommandError::NotFinite`], [`CommandError::TooMuch`].
pub(super) fn check(drawings: &[Drawing]) -> Result<(), CommandError> {
    let (mut points, mut bytes, mut pixels) = (0, 0, 0);
    for drawing in drawings {
        match &drawing.shape {
            DrawingShape::Points(own, _) | DrawingShape::Lines(own) => points += own.len(),
            DrawingShape::Text { text, .. } => bytes += text.len(),
            DrawingShape::Picture { pixels: own, .. } => pixels += own.rgba.len(),
            _ => (),
        }
    }
    if drawings.len() > MAX_DRAWINGS || points > MAX_POINTS || bytes > MAX_TEXT || pixels > MAX_PIXELS {
        return Err(CommandError::TooMuch);
    }
    match drawings.iter().all(Drawing::is_finite) {
        true => Ok(()),
        false => Err(CommandError::NotFinite),
    }
}

/// What one plugin shows.
pub(super) type Sheet = Arc<ArcSwap<Vec<Drawing>>>;

/// What all plugins of a simulation show in windows, for the thread that draws them. Neither side waits for the other.
#[derive(Debug, Clone, Default)]
pub struct Drawings(Arc<ArcSwap<Vec<(u64, Sheet)>>>);

impl Drawings {
    /// What each plugin that shows anything shows now, in the order of loading.
    pub fn read(&self) -> Vec<Arc<Vec<Drawing>>> {
        let sheets = self.0.load();
        sheets.iter().map(|(_, sheet)| sheet.load_full()).filter(|drawings| !drawings.is_empty()).collect()
    }

    /// Gives a plugin a place to show things at. Called by one thread at a time, as is [`close`](Self::close).
    pub(super) fn open(&self, plugin: u64) -> Sheet {
        let sheet = Sheet::default();
        let mut sheets = (**self.0.load()).clone();
        sheets.push((plugin, Arc::clone(&sheet)));
        self.0.store(Arc::new(sheets));
        sheet
    }

    /// What a plugin shows goes, and what it shows from now on is not seen.
    pub(super) fn close(&self, plugin: u64) {
        let sheets = self.0.load();
        if sheets.iter().any(|(number, _)| *number == plugin) {
            let others = sheets.iter().filter(|(number, _)| *number != plugin);
            self.0.store(Arc::new(others.cloned().collect()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> Vec<Drawing> {
        let pose = Isometry3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.1, 0.2, 0.3));
        let points = || vec![Vector3::x(), Vector3::new(0.0, 2.0, -3.0)];
        let text =
            |place| DrawingShape::Text { text: "tool at 3 mm".into(), place, height: 20.0, panel: Some([1.0; 4]) };
        let picture = |place, height, is_behind| {
            let pixels = Pixels::new(3, 2, vec![[1, 2, 3, 4], [5; 4], [6; 4], [7; 4], [8; 4], [9; 4]]).expect("six");
            DrawingShape::Picture { pixels: Arc::new(pixels), place, height, is_behind }
        };
        let shapes = [
            DrawingShape::Sphere(0.1),
            DrawingShape::Box([0.1, 0.2, 0.3]),
            DrawingShape::Arrow(1.0, 0.02),
            DrawingShape::Frame(0.5),
            DrawingShape::Points(points(), 4.0),
            DrawingShape::Lines(points()),
            text(TextPlace::Pixels(10.0, -20.0)),
            text(TextPlace::Share(0.5, 0.25)),
            text(TextPlace::Scene),
            picture(TextPlace::Pixels(-10.0, 20.0), 30.0, false),
            picture(TextPlace::Share(0.0, 0.0), 0.0, true),
            picture(TextPlace::Scene, 30.0, true),
        ];
        let drawing = |shape| Drawing::new(shape, pose, [0.1, 0.2, 0.3, 0.4]).in_window(2);
        shapes.into_iter().map(drawing).chain([Drawing::text("plain", TextPlace::Scene)]).collect()
    }

    #[test]
    fn drawings_cross_the_c_interface_unchanged() {
        for drawing in all() {
            let mut points = Vec::new();
            let raw = drawing.raw(&mut points);
            // SAFETY: `raw` borrows from `drawing` and `points`, which live.
            let back = unsafe { Drawing::from_raw(&raw) };
            assert_eq!(back.as_ref(), Ok(&drawing));
        }
        let strange = RawDrawing { shape: 99, ..RawDrawing::default() };
        let no_points = RawDrawing { shape: 5, point_count: 2, ..RawDrawing::default() };
        let many = RawDrawing { shape: 5, point_count: u64::MAX, ..RawDrawing::default() };
        let no_pixels = RawDrawing { shape: 9, width: 2, height: 2, ..RawDrawing::default() };
        let huge = RawDrawing { shape: 9, width: u32::MAX, height: u32::MAX, ..RawDrawing::default() };
        let empty = RawDrawing { shape: 9, pixels: [[0; 4]].as_ptr(), ..RawDrawing::default() };
        let no_pose =
            RawDrawing { pose: RawPose { position: [1.0, 0.0, 0.0], orientation: [0.0; 4] }, ..RawDrawing::default() };
        // SAFETY: none of them has points, a text or pixels.
        let read = |raw: &RawDrawing| unsafe { Drawing::from_raw(raw) };
        assert_eq!(read(&strange), Err(CommandError::Unknown));
        assert_eq!(read(&no_points), Err(CommandError::Refused));
        assert_eq!(read(&many), Err(CommandError::TooMuch));
        assert_eq!(read(&no_pixels), Err(CommandError::Refused));
        assert_eq!(read(&huge), Err(CommandError::TooMuch));
        assert_eq!(read(&empty), Err(CommandError::Refused));
        assert_eq!(read(&no_pose), Err(CommandError::NotFinite));
        assert_eq!(read(&RawDrawing::default()).map(|drawing| drawing.pose), Ok(Isometry3::identity()));
    }

    #[test]
    fn what_cannot_be_shown_is_refused() {
        assert_eq!(check(&all()), Ok(()));
        let sphere = |radius| Drawing::new(DrawingShape::Sphere(radius), Isometry3::identity(), [1.0; 4]);
        assert_eq!(check(&[sphere(f64::NAN)]), Err(CommandError::NotFinite));
        assert_eq!(check(&[Drawing { color: [f32::INFINITY; 4], ..sphere(1.0) }]), Err(CommandError::NotFinite));
        let far = Isometry3::translation(f64::INFINITY, 0.0, 0.0);
        assert_eq!(check(&[Drawing { pose: far, ..sphere(1.0) }]), Err(CommandError::NotFinite));
        assert_eq!(check(&vec![sphere(1.0); MAX_DRAWINGS + 1]), Err(CommandError::TooMuch));
        let long = Drawing::text("x".repeat(MAX_TEXT / 2 + 1), TextPlace::Scene);
        assert_eq!(check(std::slice::from_ref(&long)), Ok(()));
        assert_eq!(check(&[long.clone(), long]), Err(CommandError::TooMuch), "both together");
        let half = Pixels::new(4096, 2049, vec![[0; 4]; 4096 * 2049]).expect("as many");
        let (pixels, place) = (Arc::new(half), TextPlace::Share(0.0, 0.0));
        let shape = DrawingShape::Picture { pixels, place, height: 0.0, is_behind: true };
        let picture = Drawing::new(shape, Isometry3::identity(), [1.0; 4]);
        assert_eq!(check(std::slice::from_ref(&picture)), Ok(()));
        assert_eq!(check(&[picture.clone(), picture]), Err(CommandError::TooMuch), "both together");
        assert_eq!(Pixels::new(2, 2, vec![[0; 4]; 3]), None);
        assert_eq!(Pixels::new(0, 2, Vec::new()), None);
        assert_eq!(Pixels::new(8193, 1, vec![[0; 4]; 8193]), None);
    }

    #[test]
    fn what_a_plugin_shows_goes_with_it() {
        let drawings = Drawings::default();
        let (one, two) = (drawings.open(1), drawings.open(2));
        assert!(drawings.read().is_empty());
        one.store(Arc::new(all()));
        two.store(Arc::new(vec![Drawing::text("two", TextPlace::Scene)]));
        assert_eq!(drawings.read().len(), 2);
        drawings.close(1);
        one.store(Arc::new(all()));
        let left = drawings.read();
        assert_eq!(left.len(), 1);
        assert_eq!(*left[0], [Drawing::text("two", TextPlace::Scene)]);
    }
}
