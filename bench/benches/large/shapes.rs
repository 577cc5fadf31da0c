//! Meshes that are not convex, made of closed prisms and rings; m.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::fmt::Write;

use ambf_core::mesh::SubMesh;

/// A mesh with its name, centred at its own origin.
pub struct Shape {
    pub name: &'static str,
    pub mesh: SubMesh,
    /// Radius of a ball that goes into it; `None`: it has no inside.
    pub ball: Option<f64>,
}

/// All shapes.
pub fn all() -> Vec<Shape> {
    let bracket = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.02], [0.02, 0.02], [0.02, 0.1], [0.0, 0.1]];
    let finger = [
        [0.0, 0.0],
        [0.015, 0.0],
        [0.015, 0.06],
        [0.04, 0.085],
        [0.04, 0.11],
        [0.028, 0.11],
        [0.028, 0.092],
        [0.0, 0.064],
    ];
    // Inside, bottom, outside, rim: radius and height.
    let ring = [[0.03, 0.0], [0.05, 0.0], [0.05, 0.02], [0.03, 0.02]];
    let cup = [[0.0, 0.0], [0.04, 0.0], [0.04, 0.08], [0.034, 0.08], [0.034, 0.006], [0.0, 0.006]];
    // As many triangles as the meshes that designers export.
    let fine = finer(finer(finer(turned(&cup, false))));
    [
        ("ring", turned(&ring, true), Some(0.02)),
        ("cup", turned(&cup, false), Some(0.02)),
        ("cup, fine", fine, Some(0.02)),
        ("L", prism(&bracket, 0.03), None),
        ("finger", prism(&finger, 0.02), None),
    ]
    .map(|(name, mesh, ball)| Shape { name, mesh: centred(mesh), ball })
    .into()
}

/// Sides of a full turn.
const SIDES: u32 = 48;

/// A profile of radius and height, counter-clockwise, turned about z. One that is not a loop begins and ends on the
/// axis.
fn turned(profile: &[[f64; 2]], is_loop: bool) -> SubMesh {
    let mut mesh = SubMesh::default();
    let n = profile.len() as u32;
    for i in 0..SIDES {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(SIDES)).sin_cos();
        mesh.vertices.extend(profile.iter().map(|&[r, z]| [r * cos, r * sin, z]));
    }
    for i in 0..SIDES {
        let (here, next) = (i * n, (i + 1) % SIDES * n);
        for a in 0..if is_loop { n } else { n - 1 } {
            let b = (a + 1) % n;
            let corners = [here + a, next + a, next + b, here + b];
            let on_axis = |k: u32| profile[k as usize][0] == 0.0;
            if !on_axis(a) {
                mesh.triangles.push([corners[0], corners[1], corners[2]]);
            }
            if !on_axis(b) {
                mesh.triangles.push([corners[0], corners[2], corners[3]]);
            }
        }
    }
    mesh
}

/// A counter-clockwise outline in the plane xz, extruded along y.
fn prism(outline: &[[f64; 2]], depth: f64) -> SubMesh {
    let mut mesh = SubMesh::default();
    let n = outline.len() as u32;
    mesh.vertices = outline.iter().map(|&[x, z]| [x, 0.0, z]).collect();
    mesh.vertices.extend(outline.iter().map(|&[x, z]| [x, depth, z]));
    for a in 0..n {
        let b = (a + 1) % n;
        mesh.triangles.extend([[a, a + n, b + n], [a, b + n, b]]);
    }
    for [a, b, c] in ears(outline) {
        mesh.triangles.extend([[a, b, c], [a + n, c + n, b + n]]);
    }
    mesh
}

/// The same surface in four times as many triangles.
fn finer(mut mesh: SubMesh) -> SubMesh {
    let mut known = HashMap::new();
    let triangles = std::mem::take(&mut mesh.triangles);
    for corners in triangles {
        let middles = [0, 1, 2].map(|k| {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            *known.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let [p, q] = [a, b].map(|corner| mesh.vertices[corner as usize]);
                mesh.vertices.push([0, 1, 2].map(|axis| (p[axis] + q[axis]) / 2.0));
                mesh.vertices.len() as u32 - 1
            })
        });
        mesh.triangles.push(middles);
        mesh.triangles.extend([0, 1, 2].map(|k| [middles[(k + 2) % 3], corners[k], middles[k]]));
    }
    mesh
}

/// Triangles of a simple polygon, by cutting ears.
fn ears(outline: &[[f64; 2]]) -> Vec<[u32; 3]> {
    let mut left: Vec<u32> = (0..outline.len() as u32).collect();
    let at = |i: u32| outline[i as usize];
    let area = |a: u32, b: u32, c: u32| {
        let ([ax, ay], [bx, by], [cx, cy]) = (at(a), at(b), at(c));
        (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    };
    let mut triangles = Vec::new();
    while left.len() > 2 {
        let n = left.len();
        let is_ear = |&i: &usize| {
            let [a, b, c] = [left[(i + n - 1) % n], left[i], left[(i + 1) % n]];
            let is_inside = |p: u32| area(a, b, p) >= 0.0 && area(b, c, p) >= 0.0 && area(c, a, p) >= 0.0;
            area(a, b, c) > 0.0 && !left.iter().any(|&p| ![a, b, c].contains(&p) && is_inside(p))
        };
        let ear = (0..n).find(is_ear).expect("a simple polygon has an ear");
        triangles.push([left[(ear + n - 1) % n], left[ear], left[(ear + 1) % n]]);
        left.remove(ear);
    }
    triangles
}

/// The mesh with the centre of its bounding box at the origin.
fn centred(mut mesh: SubMesh) -> SubMesh {
    for axis in 0..3 {
        let along = || mesh.vertices.iter().map(|v| v[axis]);
        let middle = (along().fold(f64::INFINITY, f64::min) + along().fold(f64::NEG_INFINITY, f64::max)) / 2.0;
        mesh.vertices.iter_mut().for_each(|v| v[axis] -= middle);
    }
    mesh.surface_vertices = mesh.vertices.len();
    mesh
}

/// The mesh as the text of an OBJ file.
pub fn obj(mesh: &SubMesh) -> String {
    let mut text = String::new();
    for [x, y, z] in &mesh.vertices {
        writeln!(text, "v {x} {y} {z}").expect("a text takes everything");
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|corner| corner + 1);
        writeln!(text, "f {a} {b} {c}").expect("a text takes everything");
    }
    text
}

/// Points on the surface, about `count` of them, evenly by area.
pub fn samples(mesh: &SubMesh, count: usize) -> Vec<[f64; 3]> {
    let corners = |triangle: &[u32; 3]| triangle.map(|corner| nalgebra::Vector3::from(mesh.vertices[corner as usize]));
    let area = |triangle: &[u32; 3]| {
        let [a, b, c] = corners(triangle);
        (b - a).cross(&(c - a)).norm() / 2.0
    };
    let whole: f64 = mesh.triangles.iter().map(area).sum();
    let mut points = Vec::new();
    let mut due = 0.0;
    for triangle in &mesh.triangles {
        let [a, b, c] = corners(triangle);
        due += area(triangle) / whole * count as f64;
        while due >= 1.0 {
            due -= 1.0;
            // A sequence of low discrepancy (Roberts), folded into the triangle.
            let k = points.len() as f64;
            let (mut u, mut v) = ((k * 0.754_877_666_246_693).fract(), (k * 0.569_840_290_998_053).fract());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            points.push((a + (b - a) * u + (c - a) * v).into());
        }
    }
    points
}
