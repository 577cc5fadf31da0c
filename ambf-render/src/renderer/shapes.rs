//! Shapes of markers.

use crate::gl::{self, Current};
use crate::meshes::{lathe, Part};
use crate::RenderError;

/// Segments of the markers' round shapes.
const MARKER_SEGMENTS: u32 = 24;

/// Shapes of markers.
pub(super) struct Shapes {
    /// Of radius 1.
    pub(super) sphere: Part,
    /// With edges of 1.
    pub(super) cube: Part,
    /// Along +x, of length 1, as the frames' arrows are.
    pub(super) arrow: Part,
    /// Along +x, of length and radius 1.
    pub(super) cylinder: Part,
    /// Along +x, of length and radius 1.
    pub(super) cone: Part,
}

impl Shapes {
    pub(super) fn new(gl: &Current<'_>) -> Result<Self, RenderError> {
        let part = |(vertices, indices): (Vec<f32>, Vec<u32>)| Part::of_vertices(gl, &vertices, &indices);
        let turned = |rings: &[[f32; 4]]| part(lathe(rings, MARKER_SEGMENTS));
        let half_circle: Vec<[f32; 4]> = (0..=MARKER_SEGMENTS / 2)
            .map(|ring| {
                let (sine, cosine) = (std::f32::consts::TAU * ring as f32 / MARKER_SEGMENTS as f32).sin_cos();
                [-cosine, sine, -cosine, sine]
            })
            .collect();
        let slope = std::f32::consts::FRAC_1_SQRT_2;
        Ok(Self {
            sphere: turned(&half_circle)?,
            cube: part(cube())?,
            arrow: turned(&arrow(0.017, 0.068, 0.2))?,
            cylinder: turned(&[
                [0.0, 0.0, -1.0, 0.0],
                [0.0, 1.0, -1.0, 0.0],
                [0.0, 1.0, 0.0, 1.0],
                [1.0, 1.0, 0.0, 1.0],
                [1.0, 1.0, 1.0, 0.0],
                [1.0, 0.0, 1.0, 0.0],
            ])?,
            cone: turned(&[
                [0.0, 0.0, -1.0, 0.0],
                [0.0, 1.0, -1.0, 0.0],
                [0.0, 1.0, slope, slope],
                [1.0, 0.0, slope, slope],
            ])?,
        })
    }
}

/// Rings of an arrow of length 1.
fn arrow(shaft: f32, head: f32, length: f32) -> [[f32; 4]; 8] {
    let neck = 1.0 - length;
    let slope = length.hypot(head);
    let (along, outward) = (head / slope, length / slope);
    [
        [0.0, 0.0, -1.0, 0.0],
        [0.0, shaft, -1.0, 0.0],
        [0.0, shaft, 0.0, 1.0],
        [neck, shaft, 0.0, 1.0],
        [neck, shaft, -1.0, 0.0],
        [neck, head, -1.0, 0.0],
        [neck, head, along, outward],
        [1.0, 0.0, along, outward],
    ]
}

/// A box with edges of 1.
fn cube() -> (Vec<f32>, Vec<u32>) {
    let (mut vertices, mut indices) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in [-0.5_f32, 0.5] {
            let first = (vertices.len() / gl::VERTEX_FLOATS) as u32;
            for (u, v) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                let (mut position, mut normal) = ([0.0; 3], [0.0; 3]);
                (position[axis], position[(axis + 1) % 3], position[(axis + 2) % 3]) = (side, u, v);
                normal[axis] = 2.0 * side;
                vertices.extend(position.into_iter().chain(normal).chain([0.0, 0.0]));
            }
            let corners = if side > 0.0 { [0, 1, 2, 0, 2, 3] } else { [0, 2, 1, 0, 3, 2] };
            indices.extend(corners.map(|corner| first + corner));
        }
    }
    (vertices, indices)
}
