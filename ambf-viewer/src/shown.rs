//! What plugins show in windows: markers, texts and pictures.

use std::sync::Arc;

use ambf_core::plugin::{Drawing, DrawingShape, Pixels, TextPlace};
use ambf_render::{Backdrop, Eye, Marker, MarkerShape};
use egui::{Color32, FontId, Pos2, Vec2};
use nalgebra::{Point3, Vector3};

/// Heights of texts that can be read and drawn, pixels.
const HEIGHTS: std::ops::RangeInclusive<f64> = 4.0..=400.0;
/// Between a text and the edge of its panel, as a share of the height of a line.
const MARGIN: f32 = 0.3;

/// The markers that a window has, by its number from 1.
pub(crate) fn markers(shown: &[Arc<Vec<Drawing>>], window: u32) -> Vec<Marker> {
    of_window(shown, window)
        .filter_map(|drawing| {
            let float = |x: &f64| *x as f32;
            let floats =
                |points: &[Vector3<f64>]| points.iter().map(|point| (*point).map(|x| x as f32).into()).collect();
            let shape = match &drawing.shape {
                DrawingShape::Sphere(radius) => MarkerShape::Sphere(float(radius)),
                DrawingShape::Box(edges) => MarkerShape::Box(edges.map(|edge| edge as f32)),
                DrawingShape::Arrow(length, radius) => MarkerShape::Arrow(float(length), float(radius)),
                DrawingShape::Frame(length) => MarkerShape::Frame(float(length)),
                DrawingShape::Points(points, size) => MarkerShape::Points(floats(points), float(size)),
                DrawingShape::Lines(points) => {
                    // A point without a partner ends no line.
                    MarkerShape::Lines(floats(&points[..points.len() & !1]))
                }
                _ => return None,
            };
            Some(Marker { shape, pose: drawing.pose, color: drawing.color })
        })
        .collect()
}

fn of_window(shown: &[Arc<Vec<Drawing>>], window: u32) -> impl Iterator<Item = &Drawing> {
    let all = shown.iter().flat_map(|drawings| drawings.iter());
    all.filter(move |drawing| drawing.window == 0 || drawing.window == window)
}

/// Pictures before the scene, as a window has loaded them.
pub(crate) type Pictures = Vec<(Arc<Pixels>, egui::TextureHandle)>;

/// The pictures behind the scene of a window of `size` pixels, by its number from 1.
pub(crate) fn backdrops(shown: &[Arc<Vec<Drawing>>], window: u32, size: (u32, u32), eyes: &[Eye]) -> Vec<Backdrop> {
    let mut found = Vec::new();
    for drawing in of_window(shown, window) {
        let DrawingShape::Picture { pixels, is_behind: true, .. } = &drawing.shape else { continue };
        let color = drawing.color.map(|x| x.clamp(0.0, 1.0));
        // A mirrored window mirrors the scene with what is behind it.
        let areas = areas(drawing, size, eyes, false).into_iter();
        found.extend(areas.map(|area| Backdrop { pixels: Arc::clone(pixels), area, color }));
    }
    found
}

/// Left, top, width and height of a picture, pixels from the upper left corner of the window.
fn areas(drawing: &Drawing, size: (u32, u32), eyes: &[Eye], mirrored: bool) -> Vec<[f64; 4]> {
    let DrawingShape::Picture { pixels, place, height, .. } = &drawing.shape else { return Vec::new() };
    if *height <= 0.0 {
        return vec![[0.0, 0.0, f64::from(size.0), f64::from(size.1)]];
    }
    let width = height * f64::from(pixels.width()) / f64::from(pixels.height());
    places(drawing, place, size, eyes, mirrored).into_iter().map(|(x, y)| [x, y, width, *height]).collect()
}

/// What plugins show in a window when a picture of the scene is there.
pub(crate) struct Shown<'a> {
    pub drawings: &'a [Arc<Vec<Drawing>>],
    /// Number of the window, from 1.
    pub window: u32,
    /// Pixels.
    pub size: (u32, u32),
    /// Of the picture.
    pub eyes: Vec<Eye>,
    pub mirrored: bool,
}

impl Shown<'_> {
    /// Draws pictures before the scene; `scale` is pixels a point of egui.
    pub(crate) fn paint_pictures(&self, painter: &egui::Painter, loaded: &mut Pictures, scale: f32) {
        // Those that nobody else has are not shown any more.
        loaded.retain(|(pixels, _)| Arc::strong_count(pixels) > 1);
        for drawing in of_window(self.drawings, self.window) {
            let DrawingShape::Picture { pixels, is_behind: false, .. } = &drawing.shape else { continue };
            let place = loaded.iter().position(|(known, _)| Arc::ptr_eq(known, pixels)).unwrap_or_else(|| {
                let size = [pixels.width() as usize, pixels.height() as usize];
                let image = egui::ColorImage::from_rgba_unmultiplied(size, pixels.rgba().as_flattened());
                // Not `load_texture`, whose limit is that of the texture of letters.
                let textures = painter.ctx().tex_manager();
                let name = "picture of a plugin".into();
                let texture = textures.write().alloc(name, image.into(), egui::TextureOptions::LINEAR);
                loaded.push((Arc::clone(pixels), egui::TextureHandle::new(textures, texture)));
                loaded.len() - 1
            });
            for area in areas(drawing, self.size, &self.eyes, self.mirrored) {
                let [left, top, width, height] = area.map(|x| x as f32 / scale);
                let area = egui::Rect::from_min_size(Pos2::new(left, top), Vec2::new(width, height));
                let whole = egui::Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
                painter.image(loaded[place].1.id(), area, whole, ink(drawing.color));
            }
        }
    }

    /// Draws texts; `scale` is pixels a point of egui.
    pub(crate) fn paint_texts(&self, painter: &egui::Painter, scale: f32) {
        for drawing in of_window(self.drawings, self.window) {
            let DrawingShape::Text { text, place, height, panel } = &drawing.shape else { continue };
            let pixels = height.clamp(*HEIGHTS.start(), *HEIGHTS.end()) as f32 / scale;
            let color = |[r, g, b, a]: [f32; 4]| egui::Rgba::from_rgba_unmultiplied(r, g, b, a);
            let ink = ink(drawing.color);
            for (x, y) in places(drawing, place, self.size, &self.eyes, self.mirrored) {
                let corner = Pos2::new(x as f32 / scale, y as f32 / scale);
                let galley = painter.layout_no_wrap(text.clone(), FontId::proportional(pixels), ink);
                if let Some(panel) = panel {
                    let behind = egui::Rect::from_min_size(corner, galley.size()).expand(MARGIN * pixels);
                    let color = Color32::from(color(panel.map(|x| x.clamp(0.0, 1.0))));
                    painter.rect_filled(behind, MARGIN * pixels, color);
                }
                painter.galley(corner, galley, ink);
            }
        }
    }
}

/// Bytes of a colour from 0 to 1.
fn ink(color: [f32; 4]) -> Color32 {
    let [r, g, b, a] = color.map(|x| (x.clamp(0.0, 1.0) * 255.0).round() as u8);
    Color32::from_rgba_unmultiplied(r, g, b, a)
}

/// Upper left corners of a text or picture, pixels from that of the window.
fn places(
    drawing: &Drawing,
    place: &TextPlace,
    (width, height): (u32, u32),
    eyes: &[Eye],
    mirrored: bool,
) -> Vec<(f64, f64)> {
    let (width, height) = (f64::from(width), f64::from(height));
    let from_edge = |x: f64, size: f64| if x < 0.0 { size + x } else { x };
    match *place {
        TextPlace::Pixels(x, y) => vec![(from_edge(x, width), from_edge(y, height))],
        TextPlace::Share(x, y) => vec![(x * width, y * height)],
        TextPlace::Scene => {
            let point = Point3::from(drawing.pose.translation.vector);
            let seen = eyes.iter().filter_map(|eye| pixel(eye, &point));
            seen.map(|(x, y)| (x, if mirrored { height - y } else { y })).collect()
        }
        _ => Vec::new(),
    }
}

/// Where an eye sees a point of the world, pixels from the upper left corner of the *whole* picture; `None` beside its
/// part, and behind it.
fn pixel(eye: &Eye, point: &Point3<f64>) -> Option<(f64, f64)> {
    let clip = eye.projection * eye.view * point.to_homogeneous();
    let (x, y) = (clip.x / clip.w, clip.y / clip.w);
    let is_seen = clip.w > 0.0 && x.abs() <= 1.0 && y.abs() <= 1.0;
    let (left, width, height) = (f64::from(eye.left), f64::from(eye.width), f64::from(eye.height));
    is_seen.then_some((left + 0.5 * (x + 1.0) * width, 0.5 * (1.0 - y) * height))
}

#[cfg(test)]
mod tests {
    use ambf_render::{Projection, Stereo, View};
    use nalgebra::Isometry3;

    use super::*;

    fn text(place: TextPlace, at: [f64; 3]) -> Drawing {
        Drawing { pose: Isometry3::translation(at[0], at[1], at[2]), ..Drawing::text("here", place) }
    }

    #[test]
    fn texts_are_where_their_points_are_seen() {
        let pose = Isometry3::translation(2.0, 0.0, 0.0);
        let mut view = View { pose, near: 0.1, far: 10.0, projection: Projection::Perspective(1.0), stereo: None };
        let at = |view: &View, point: [f64; 3], mirrored: bool| {
            let drawing = text(TextPlace::Scene, point);
            places(&drawing, &TextPlace::Scene, (200, 100), &view.eyes(200, 100), mirrored)
        };
        // The ray of the place passes through the point.
        let point = [0.5, 0.3, 0.2];
        let [(x, y)] = at(&view, point, false)[..] else { panic!("seen once") };
        let ray = view.ray(200, 100, x, y);
        let to = Point3::from(point) - ray.origin;
        assert!(to.cross(&ray.direction).norm() < 1e-9 && x > 100.0 && y < 50.0);
        assert_eq!(at(&view, point, true), [(x, 100.0 - y)]);
        assert!(at(&view, [3.0, 0.0, 0.0], false).is_empty(), "behind the camera");
        view.stereo = Some(Stereo { separation: 0.1, focal_length: 2.0 });
        let both = at(&view, [0.0; 3], false);
        assert_eq!(both.len(), 2);
        assert!((both[0].0 - 50.0).abs() < 1e-9 && (both[1].0 - 150.0).abs() < 1e-9, "{both:?}");
    }

    #[test]
    fn negative_pixels_count_from_the_other_edge() {
        let at = |place| places(&text(place, [0.0; 3]), &place, (200, 100), &[], false);
        assert_eq!(at(TextPlace::Pixels(10.0, -20.0)), [(10.0, 80.0)]);
        assert_eq!(at(TextPlace::Share(0.25, 0.5)), [(50.0, 50.0)]);
    }

    #[test]
    fn pictures_behind_the_scene_keep_their_shape_or_fill_the_window() {
        let pixels = Arc::new(Pixels::new(4, 2, vec![[9; 4]; 8]).expect("eight"));
        let picture = |height, is_behind| {
            let (pixels, place) = (Arc::clone(&pixels), TextPlace::Pixels(-50.0, 10.0));
            let shape = DrawingShape::Picture { pixels, place, height, is_behind };
            Drawing::new(shape, Isometry3::identity(), [1.0, 1.0, 1.0, 2.0])
        };
        let shown = [Arc::new(vec![picture(20.0, true), picture(20.0, false), picture(0.0, true)])];
        let found = backdrops(&shown, 1, (200, 100), &[]);
        assert_eq!(
            found.iter().map(|backdrop| backdrop.area).collect::<Vec<_>>(),
            [[150.0, 10.0, 40.0, 20.0], [0.0, 0.0, 200.0, 100.0]]
        );
        assert_eq!(found[0].color, [1.0; 4]);
    }

    #[test]
    fn each_window_has_its_own_markers() {
        let marker = |shape| Drawing::new(shape, Isometry3::identity(), [1.0; 4]);
        let odd = DrawingShape::Lines(vec![Vector3::x(), Vector3::y(), Vector3::z()]);
        let one = vec![marker(DrawingShape::Sphere(0.1)), marker(DrawingShape::Frame(0.2)).in_window(2)];
        let shown = [Arc::new(one), Arc::new(vec![marker(odd), text(TextPlace::Scene, [0.0; 3])])];
        let shapes = |window| markers(&shown, window).into_iter().map(|marker| marker.shape).collect::<Vec<_>>();
        let line = MarkerShape::Lines(vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        assert_eq!(shapes(1), [MarkerShape::Sphere(0.1), line.clone()]);
        assert_eq!(shapes(2), [MarkerShape::Sphere(0.1), MarkerShape::Frame(0.2), line]);
    }
}
