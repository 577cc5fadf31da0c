//! Messages of cameras as they go over the wire, written in place: a cloud has ten megabytes.

use ambf_render::Eye;
use nalgebra::{Matrix3, Matrix4, Vector4};

/// Bytes of one point of a cloud.
pub(super) const POINT_STEP: u32 = 32;

/// Number of `FLOAT32` in a `sensor_msgs/PointField`.
const FLOAT32: u8 = 7;

/// What all messages begin with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Header<'a> {
    /// Time of the snapshot.
    pub stamp: rosrust::Time,
    /// Name of the camera.
    pub frame_id: &'a str,
}

fn number(bytes: &mut Vec<u8>, number: u32) {
    bytes.extend(number.to_le_bytes());
}

/// No text of ours comes near 4 GB.
fn text(bytes: &mut Vec<u8>, text: &str) {
    number(bytes, text.len() as u32);
    bytes.extend(text.as_bytes());
}

fn header(bytes: &mut Vec<u8>, header: Header<'_>, seq: u32) {
    number(bytes, seq);
    number(bytes, header.stamp.sec);
    number(bytes, header.stamp.nsec);
    text(bytes, header.frame_id);
}

/// Appends a `sensor_msgs/Image` in `rgb8`. `color`: (height x width x 3), top row first.
pub(super) fn image(bytes: &mut Vec<u8>, seq: u32, of: Header<'_>, (width, height): (u32, u32), color: &[u8]) {
    let step = 3 * width;
    bytes.reserve(color.len() + 100 + of.frame_id.len());
    image_head(bytes, seq, of, (width, height), "rgb8", step);
    bytes.extend_from_slice(color);
}

fn image_head(bytes: &mut Vec<u8>, seq: u32, of: Header<'_>, (width, height): (u32, u32), encoding: &str, step: u32) {
    header(bytes, of, seq);
    number(bytes, height);
    number(bytes, width);
    text(bytes, encoding);
    bytes.push(0); // little endian
    number(bytes, step);
    number(bytes, step * height);
}

/// Appends a `sensor_msgs/Image` in `32FC1`. `depth`: (height x width), m, top row first; `noise`, if it isn't empty,
/// in the same order, is taken away, since a point's x is the negative of its depth.
pub(super) fn depth_image(
    bytes: &mut Vec<u8>,
    seq: u32,
    of: Header<'_>,
    (width, height): (u32, u32),
    depth: &[f32],
    noise: &[f32],
) {
    bytes.reserve(4 * depth.len() + 100 + of.frame_id.len());
    image_head(bytes, seq, of, (width, height), "32FC1", 4 * width);
    if noise.is_empty() {
        depth.iter().for_each(|depth| bytes.extend(depth.to_le_bytes()));
    } else {
        depth.iter().zip(noise).for_each(|(depth, noise)| bytes.extend((depth - noise).to_le_bytes()));
    }
}

/// Appends a `sensor_msgs/CompressedImage` whose data `encode` appends. Names and format are those of
/// `image_transport`'s JPEG.
pub(super) fn compressed(bytes: &mut Vec<u8>, seq: u32, of: Header<'_>, encode: impl FnOnce(&mut Vec<u8>)) {
    header(bytes, of, seq);
    text(bytes, "rgb8; jpeg compressed bgr8");
    let length_at = bytes.len();
    number(bytes, 0);
    encode(bytes);
    let length = (bytes.len() - length_at - 4) as u32;
    bytes[length_at..length_at + 4].copy_from_slice(&length.to_le_bytes());
}

/// A picture with depth, for a cloud.
pub(super) struct Points<'a> {
    /// (height x width x 3), top row first; empty: black.
    pub color: &'a [u8],
    /// (height x width), m, top row first.
    pub depth: &'a [f32],
    /// (height x width), m, added to x; empty: none.
    pub noise: &'a [f32],
    /// One or two eyes.
    pub eyes: &'a [Eye],
}

/// Appends a `sensor_msgs/PointCloud2` of one row: points in the camera's frame, **bottom row first**, from left to
/// right.
///
/// A point has 32 bytes: x, y, z as 32-bit floats at 0, 4 and 8; blue, green and red at 16, 17 and 18.
pub(super) fn cloud(bytes: &mut Vec<u8>, seq: u32, of: Header<'_>, (width, height): (u32, u32), points: &Points<'_>) {
    let count = width * height;
    bytes.reserve((count * POINT_STEP) as usize + 200 + of.frame_id.len());
    header(bytes, of, seq);
    number(bytes, 1);
    number(bytes, count);
    number(bytes, 4);
    for (name, offset) in [("x", 0), ("y", 4), ("z", 8), ("rgb", 16)] {
        text(bytes, name);
        number(bytes, offset);
        bytes.push(FLOAT32);
        number(bytes, 1);
    }
    bytes.push(0); // little endian
    number(bytes, POINT_STEP);
    number(bytes, POINT_STEP * count);
    number(bytes, POINT_STEP * count);
    let rays: Vec<Ray> = points.eyes.iter().map(Ray::new).collect();
    for row in (0..height).rev() {
        for (eye, ray) in points.eyes.iter().zip(&rays) {
            let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / f64::from(height);
            for column in 0..eye.width {
                let at = row as usize * width as usize + (eye.left + column) as usize;
                let x = 2.0 * (f64::from(column) + 0.5) / f64::from(eye.width) - 1.0;
                let depth = points.depth.get(at).copied().unwrap_or(0.0);
                let mut point = ray.point(eye, x, y, f64::from(depth));
                point[0] += points.noise.get(at).copied().unwrap_or(0.0);
                let mut packed = [0; POINT_STEP as usize];
                packed[..4].copy_from_slice(&point[0].to_le_bytes());
                packed[4..8].copy_from_slice(&point[1].to_le_bytes());
                packed[8..12].copy_from_slice(&point[2].to_le_bytes());
                if let Some(&[red, green, blue]) = points.color.get(3 * at..3 * at + 3) {
                    packed[16..19].copy_from_slice(&[blue, green, red]);
                }
                bytes.extend_from_slice(&packed);
            }
        }
    }
    bytes.push(0); // not dense, as in the C++ program
}

/// From pixels and depth of an eye to points.
struct Ray {
    projection: Matrix4<f64>,
    inverse: Matrix4<f64>,
}

impl Ray {
    fn new(eye: &Eye) -> Self {
        // A projection that cannot be inverted shows nothing.
        let inverse = eye.projection.try_inverse().unwrap_or_else(Matrix4::zeros);
        Self { projection: eye.projection, inverse }
    }

    /// Point in the camera's frame at normalised coordinates (`x`, `y`) of the eye's part of the picture, `depth` m
    /// along the axis.
    fn point(&self, eye: &Eye, x: f64, y: f64, depth: f64) -> [f32; 3] {
        let p = &self.projection;
        let z = p[(2, 3)] - p[(2, 2)] * depth;
        let w = p[(3, 3)] - p[(3, 2)] * depth;
        let q = self.inverse * Vector4::new(x * w, y * w, z, w);
        [(eye.offset.x - depth) as f32, (q.x / q.w + eye.offset.y) as f32, (q.y / q.w + eye.offset.z) as f32]
    }
}

/// Intrinsics of a pinhole camera, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pinhole {
    pub focal_lengths: (f64, f64),
    pub principal_point: (f64, f64),
    /// Columns a row, counted downwards.
    pub skew: f64,
    /// Of the left camera of a pair, where it is in this one's frame (right, down), m; (0, 0) for all others.
    pub left: (f64, f64),
}

impl Pinhole {
    /// Of an eye that sees the whole picture; `None` for orthographic ones, and projections that are none of a pinhole.
    pub fn of(eye: &Eye) -> Option<Self> {
        let (p, width, height) = (&eye.projection, f64::from(eye.width), f64::from(eye.height));
        // The row that divides must be −depth, up to a factor.
        let factor = -p[(3, 2)];
        let divides = [(3, 0), (3, 1), (3, 3), (0, 3), (1, 3), (1, 0)].iter().all(|&at| p[at] == 0.0);
        if eye.is_orthographic || factor == 0.0 || !divides {
            return None;
        }
        let at = |row, column| p[(row, column)] / factor;
        Some(Self {
            focal_lengths: (0.5 * width * at(0, 0), 0.5 * height * at(1, 1)),
            principal_point: (0.5 * width * (1.0 - at(0, 2)), 0.5 * height * (1.0 + at(1, 2))),
            // The eye's y counts upwards.
            skew: -0.5 * width * at(0, 1),
            left: (0.0, 0.0),
        })
    }

    /// The same beside the left camera of the pair, if both look in one direction and stand side by side: only then are their
    /// pictures those of a rectified pair.
    pub fn beside(self, eye: &Eye, left: &Eye) -> Self {
        /// By which frames may differ, rad and m: rounding.
        const ROUNDING: f64 = 1e-6;
        let Some(inverse) = left.view.try_inverse() else { return self };
        let relative = eye.view * inverse;
        let turn = relative.fixed_view::<3, 3>(0, 0) - Matrix3::identity();
        if turn.amax() > ROUNDING || relative[(2, 3)].abs() > ROUNDING {
            return self;
        }
        Self { left: (relative[(0, 3)], -relative[(1, 3)]), ..self }
    }
}

/// Appends a `sensor_msgs/CameraInfo` without distortion. P projects points in the frame of the left camera of a pair.
pub(super) fn camera_info(
    bytes: &mut Vec<u8>,
    seq: u32,
    of: Header<'_>,
    (width, height): (u32, u32),
    pinhole: &Pinhole,
) {
    let ((fx, fy), (cx, cy), s) = (pinhole.focal_lengths, pinhole.principal_point, pinhole.skew);
    let numbers = |bytes: &mut Vec<u8>, numbers: &[f64]| numbers.iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    header(bytes, of, seq);
    number(bytes, height);
    number(bytes, width);
    text(bytes, "plumb_bob");
    number(bytes, 0); // D
    numbers(bytes, &[fx, s, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    numbers(bytes, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let (x, y) = pinhole.left;
    numbers(bytes, &[fx, s, cx, fx * x + s * y, 0.0, fy, cy, fy * y, 0.0, 0.0, 1.0, 0.0]);
    number(bytes, 0); // no binning
    number(bytes, 0);
    bytes.extend([0; 17]); // the whole picture is the region of interest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::messages::sensor_msgs;
    use ambf_render::{Projection, Stereo, View};
    use nalgebra::{Isometry3, Point3};
    use rosrust::RosMsg;

    const OF: Header<'_> = Header { stamp: rosrust::Time { sec: 12, nsec: 34 }, frame_id: "eye" };

    fn view(projection: Projection, stereo: Option<Stereo>) -> View {
        View { pose: Isometry3::identity(), near: 0.1, far: 10.0, projection, stereo }
    }

    fn decoded<M: RosMsg>(bytes: &[u8]) -> M {
        let mut rest = bytes;
        let message = M::decode(&mut rest).unwrap();
        assert!(rest.is_empty(), "{} bytes too many", rest.len());
        message
    }

    fn check_header(header: &crate::ros::messages::std_msgs::Header) {
        let stamp = (header.stamp.sec, header.stamp.nsec);
        assert_eq!((header.seq, stamp, header.frame_id.as_str()), (5, (12, 34), "eye"));
    }

    #[test]
    fn images_are_rgb8_with_the_top_row_first() {
        let mut bytes = Vec::new();
        let color: Vec<u8> = (0..18).collect();
        image(&mut bytes, 5, OF, (3, 2), &color);
        let message: sensor_msgs::Image = decoded(&bytes);
        check_header(&message.header);
        assert_eq!((message.width, message.height, message.step, message.is_bigendian), (3, 2, 9, 0));
        assert_eq!((message.encoding.as_str(), message.data), ("rgb8", color));
    }

    #[test]
    fn depth_images_are_metres_along_the_axis() {
        for (noise, first) in [(&[][..], 1.5), (&[0.25, 0.0][..], 1.25)] {
            let mut bytes = Vec::new();
            depth_image(&mut bytes, 5, OF, (2, 1), &[1.5, 2.0], noise);
            let message: sensor_msgs::Image = decoded(&bytes);
            check_header(&message.header);
            assert_eq!((message.encoding.as_str(), message.step, message.data.len()), ("32FC1", 8, 8));
            assert_eq!(f32::from_le_bytes(message.data[..4].try_into().unwrap()), first);
        }
    }

    #[test]
    fn compressed_images_hold_what_was_encoded() {
        let mut bytes = Vec::new();
        compressed(&mut bytes, 5, OF, |bytes| bytes.extend([1, 2, 3]));
        let message: sensor_msgs::CompressedImage = decoded(&bytes);
        check_header(&message.header);
        assert_eq!((message.format.as_str(), message.data), ("rgb8; jpeg compressed bgr8", vec![1, 2, 3]));
    }

    fn points(message: &sensor_msgs::PointCloud2) -> Vec<([f32; 3], [u8; 3])> {
        let float = |point: &[u8], at: usize| f32::from_le_bytes(point[at..at + 4].try_into().unwrap());
        let read = |point: &[u8]| {
            assert!(point[12..16].iter().chain(&point[19..]).all(|byte| *byte == 0));
            ([0, 4, 8].map(|at| float(point, at)), [point[16], point[17], point[18]])
        };
        message.data.chunks_exact(32).map(read).collect()
    }

    /// Row 27 of the checklist.
    #[test]
    fn a_cloud_begins_with_the_lower_left_pixel() {
        let eyes = view(Projection::Perspective(0.8), None).eyes(4, 2);
        let mut color = vec![0; 24];
        color[12..15].copy_from_slice(&[1, 2, 3]);
        let mut bytes = Vec::new();
        let of = Points { color: &color, depth: &[2.0; 8], noise: &[], eyes: &eyes };
        cloud(&mut bytes, 5, OF, (4, 2), &of);
        let message: sensor_msgs::PointCloud2 = decoded(&bytes);
        check_header(&message.header);
        assert_eq!((message.height, message.width, message.point_step, message.row_step), (1, 8, 32, 256));
        assert!(!message.is_dense && !message.is_bigendian);
        let fields: Vec<_> = message.fields.iter().map(|f| (f.name.as_str(), f.offset, f.datatype, f.count)).collect();
        assert_eq!(fields, [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 16, 7, 1)]);
        let points = points(&message);
        let focal = 1.0 / (0.4_f64).tan();
        let (point, color) = points[0];
        assert_eq!((point[0], color), (-2.0, [3, 2, 1]), "blue, green, red of the lower left pixel");
        assert!((f64::from(point[1]) - -1.5 * 2.0 / focal).abs() < 1e-6, "{point:?}");
        assert!((f64::from(point[2]) - -0.5 * 2.0 / focal).abs() < 1e-6, "{point:?}");
        assert!(points[3].0[1] > 0.0 && points[3].0[2] < 0.0 && points[4].0[2] > 0.0);
    }

    /// Every point lies on the ray of its pixel, for all projections and both eyes.
    #[test]
    fn points_lie_on_the_rays_of_their_pixels() {
        let skewed = {
            let mut matrix = view(Projection::Perspective(0.8), None).eyes(6, 4)[0].projection;
            matrix[(0, 1)] = 0.1;
            matrix[(0, 2)] = 0.2;
            Projection::Matrix { matrix, aspect: 1.5 }
        };
        let stereo = Some(Stereo { separation: 0.1, focal_length: 1.0 });
        let views = [(Projection::Perspective(0.8), stereo), (Projection::Orthographic(2.0), None), (skewed, None)];
        for (projection, stereo) in views {
            let view = view(projection, stereo);
            let eyes = view.eyes(6, 4);
            let depth: Vec<f32> = (0..24).map(|k| 1.0 + k as f32 / 10.0).collect();
            let mut bytes = Vec::new();
            cloud(&mut bytes, 0, OF, (6, 4), &Points { color: &[], depth: &depth, noise: &[], eyes: &eyes });
            for (place, (point, _)) in points(&decoded(&bytes)).into_iter().enumerate() {
                let (column, row) = (place % 6, 3 - place / 6);
                assert_eq!(point[0], -depth[row * 6 + column]);
                let ray = view.ray(6, 4, column as f64 + 0.5, row as f64 + 0.5);
                let point = Point3::from(point.map(f64::from));
                let off = (point - ray.origin).cross(&ray.direction).norm();
                assert!(off < 1e-6, "{view:?}, pixel ({column}, {row}): {off}");
            }
        }
    }

    /// Row 28 of the checklist.
    #[test]
    fn noise_moves_points_along_x_only() {
        let eyes = view(Projection::Perspective(0.8), None).eyes(2, 2);
        let mut clouds = [&[][..], &[0.15, 0.15, 0.15, 0.15][..]].map(|noise| {
            let mut bytes = Vec::new();
            cloud(&mut bytes, 0, OF, (2, 2), &Points { color: &[], depth: &[1.0; 4], noise, eyes: &eyes });
            points(&decoded(&bytes)).into_iter()
        });
        let [clean, noisy] = &mut clouds;
        for ((clean, _), (noisy, _)) in clean.zip(noisy) {
            assert_eq!((noisy[0], noisy[1], noisy[2]), (clean[0] + 0.15, clean[1], clean[2]));
        }
    }

    #[test]
    fn intrinsics_follow_from_the_projection() {
        let eye = view(Projection::Perspective(0.5), None).eyes(640, 480)[0];
        let focal = 480.0 / (2.0 * 0.25_f64.tan());
        let pinhole = Pinhole::of(&eye).unwrap();
        assert!((pinhole.focal_lengths.0 - focal).abs() < 1e-9 && (pinhole.focal_lengths.1 - focal).abs() < 1e-9);
        assert_eq!((pinhole.principal_point, pinhole.skew), ((320.0, 240.0), 0.0));
        assert_eq!(Pinhole::of(&view(Projection::Orthographic(1.0), None).eyes(640, 480)[0]), None);
        let mut bytes = Vec::new();
        camera_info(&mut bytes, 5, OF, (640, 480), &pinhole);
        let message: sensor_msgs::CameraInfo = decoded(&bytes);
        check_header(&message.header);
        assert_eq!((message.width, message.height, message.distortion_model.as_str()), (640, 480, "plumb_bob"));
        assert!(message.D.is_empty());
        let (fx, fy) = pinhole.focal_lengths;
        assert_eq!(message.K, [fx, 0.0, 320.0, 0.0, fy, 240.0, 0.0, 0.0, 1.0]);
        assert_eq!(message.P, [fx, 0.0, 320.0, 0.0, 0.0, fy, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        assert_eq!(message.R[0] + message.R[4] + message.R[8], 3.0);
    }

    /// The right camera of a pair tells the baseline; cameras that look elsewhere are none.
    #[test]
    fn a_right_camera_tells_the_baseline() {
        let at = |y: f64, yaw: f64| View {
            pose: Isometry3::new(nalgebra::Vector3::new(0.3, y, 0.1), nalgebra::Vector3::new(0.0, 0.0, yaw)),
            ..view(Projection::Perspective(0.5), None)
        };
        // A camera looks along −x of its frame: y is to its right.
        let eyes = [at(0.0, 0.0), at(0.02, 0.0), at(0.02, 0.1)].map(|view| view.eyes(640, 480)[0]);
        let pinhole = Pinhole::of(&eyes[1]).unwrap();
        let beside = pinhole.beside(&eyes[1], &eyes[0]);
        assert!((beside.left.0 + 0.02).abs() < 1e-12 && beside.left.1.abs() < 1e-12, "{beside:?}");
        let mut bytes = Vec::new();
        camera_info(&mut bytes, 5, OF, (640, 480), &beside);
        let message: sensor_msgs::CameraInfo = decoded(&bytes);
        assert!((message.P[3] + 0.02 * pinhole.focal_lengths.0).abs() < 1e-9, "{:?}", message.P);
        assert_eq!((message.P[7], message.P[11]), (0.0, 0.0));
        assert_eq!(pinhole.beside(&eyes[2], &eyes[0]), pinhole);
    }

    /// A camera that was described by intrinsics publishes them.
    #[test]
    fn given_intrinsics_come_back() {
        let text = "cameras: [C]\nC: {intrinsics: {fx: 800, fy: 810, cx: 300, cy: 260, s: 2}}\n";
        let (model, _) = ambf_core::adf::parse::<ambf_core::adf::Model>(text, std::path::Path::new("/m.yaml")).unwrap();
        let state = ambf_core::comm::CameraView {
            pose: Isometry3::identity(),
            parent: Isometry3::identity(),
            near_plane: 0.1,
            far_plane: 10.0,
            field_view_angle: 0.7,
            orthographic_view_width: None,
            stereo: None,
        };
        let eye = View::of_camera(&model.cameras[0], &state).eyes(640, 480)[0];
        let pinhole = Pinhole::of(&eye).unwrap();
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{pinhole:?}");
        near(pinhole.focal_lengths.0, 800.0);
        near(pinhole.focal_lengths.1, 810.0);
        near(pinhole.principal_point.0, 300.0);
        near(pinhole.principal_point.1, 260.0);
        near(pinhole.skew, 2.0);
    }
}
