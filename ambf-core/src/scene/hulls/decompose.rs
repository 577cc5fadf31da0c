//! Approximate convex decomposition of a mesh: V-HACD (Mamou, "Volumetric Hierarchical Approximate Convex
//! Decomposition", Game Engine Gems 3, 2016) of the crate `parry3d-f64` finds where to cut; the hulls are those of the
//! surface between the cuts, not of voxels, and hulls that are convex together are joined again, as far as they reach into no hole.

use std::panic::{catch_unwind, AssertUnwindSafe};

use parry3d_f64::math::Vector;
use parry3d_f64::transformation::try_convex_hull;
use parry3d_f64::transformation::vhacd::{VHACDParameters, VHACD};
use parry3d_f64::transformation::voxelization::FillMode;

use super::Hull;
use crate::adf::ConvexDecomposition;
use crate::mesh::SubMesh;

/// Number of this method: hulls that another one made are made again.
pub(super) const METHOD: u64 = 3;

/// Vertices of a hull at most. The cost of a pair of hulls grows with them.
pub(super) const MAX_VERTICES: usize = 64;

/// A vertex nearer than this to the hull of the others is left out, as a share of the longest edge of the bounding box
/// of the mesh.
const NEGLIGIBLE: f64 = 1e-4;

/// Volume of the hull of a sub-mesh, of that of a cube around it, below which it counts as a sheet.
const SHEET: f64 = 1e-6;

/// How far a hull may reach into a hole or hollow, as a share of the distance to the wall on the other side.
const REACH: f64 = 0.025;

/// Walls nearer to each other than this, as a share of the longest edge of the bounding box, are not looked at.
const NARROW: f64 = 0.01;

/// Triangles in front of which it is looked, at most.
const MAX_PROBES: usize = 1000;

/// By how much the concavity is lowered, and how often, while hulls reach too far into holes.
const FINER: f64 = 0.2;
const MAX_ATTEMPTS: usize = 3;

/// What became of a sub-mesh.
pub(super) enum Divided {
    /// At least one hull, each with 3 to [`MAX_VERTICES`] vertices.
    Hulls(Vec<Hull>),
    /// There is no triangle.
    NoSurface,
    /// The library could not divide it.
    Failed,
}

/// Divides the surface of a sub-mesh. The same mesh and parameters give the same hulls, bit for bit.
pub(super) fn decompose(sub: &SubMesh, wanted: &ConvexDecomposition) -> Divided {
    let exists = |triangle: &&[u32; 3]| triangle.iter().all(|&corner| (corner as usize) < sub.vertices.len());
    let triangles: Vec<[u32; 3]> = sub.triangles.iter().filter(exists).copied().collect();
    let corners = || triangles.as_flattened().iter().map(|&corner| Vector::from(sub.vertices[corner as usize]));
    let Some(first) = corners().next() else { return Divided::NoSurface };
    // The library compares with absolute tolerances: it gets the mesh in a cube of 1.
    let (low, high) = corners().fold((first, first), |(low, high), corner| (low.min(corner), high.max(corner)));
    let size = (high - low).max_element();
    if !(size.is_normal() && low.is_finite()) {
        return Divided::Failed;
    }
    let points: Vec<Vector> = sub.vertices.iter().map(|&vertex| (Vector::from(vertex) - low) / size).collect();
    // It panics where it meets what its author thought impossible.
    let parts = catch_unwind(AssertUnwindSafe(|| divide(&points, &triangles, wanted)));
    let hulls: Vec<Hull> = parts
        .unwrap_or_default()
        .iter()
        .map(|part| part.points.iter().map(|&point| (point * size + low).to_array()).collect())
        .filter(|hull: &Hull| hull.len() >= 3)
        .collect();
    if hulls.is_empty() {
        Divided::Failed
    } else {
        Divided::Hulls(hulls)
    }
}

/// A convex part of a mesh.
struct Part {
    /// Vertices of its hull.
    points: Vec<Vector>,
    /// Volume of its hull.
    volume: f64,
    /// Volume that was added when it was joined from others.
    added: f64,
}

impl Part {
    fn of(points: &[Vector]) -> Self {
        let points = essential(points);
        let volume = try_convex_hull(&points).map_or(0.0, |(vertices, faces)| volume(&vertices, &faces));
        Self { points, volume, added: 0.0 }
    }

    fn joined(&self, other: &Self) -> Self {
        let mut part = Self::of(&[&self.points[..], &other.points].concat());
        part.added = (part.volume - self.volume - other.volume).max(0.0) + self.added + other.added;
        part
    }

    /// Whether any of these points is in its hull.
    fn holds_any(&self, probes: &[Vector]) -> bool {
        let Ok((vertices, faces)) = try_convex_hull(&self.points) else { return false };
        let planes: Vec<(Vector, f64)> = faces
            .iter()
            .filter_map(|face| {
                let [a, b, c] = face.map(|corner| vertices[corner as usize]);
                let normal = (b - a).cross(c - a).try_normalize()?;
                Some((normal, normal.dot(a)))
            })
            .collect();
        probes.iter().any(|&probe| planes.iter().all(|&(normal, offset)| normal.dot(probe) < offset))
    }

    /// Whether the bounding boxes touch.
    fn is_near(&self, other: &Self) -> bool {
        let bounds = |part: &Self| {
            let first = part.points.first().copied().unwrap_or_default();
            part.points.iter().fold((first, first), |(low, high), &point| (low.min(point), high.max(point)))
        };
        let ((low, high), (other_low, other_high)) = (bounds(self), bounds(other));
        let slack = Vector::splat(NEGLIGIBLE);
        low.cmple(other_high + slack).all() && other_low.cmple(high + slack).all()
    }
}

fn divide(points: &[Vector], triangles: &[[u32; 3]], wanted: &ConvexDecomposition) -> Vec<Part> {
    let surface: Vec<Vector> = triangles.as_flattened().iter().map(|&corner| points[corner as usize]).collect();
    let (whole, probes) = (Part::of(&surface).volume, probes(points, triangles));
    let mut concavity = wanted.concavity;
    for attempt in 1.. {
        let parameters = VHACDParameters {
            concavity,
            resolution: wanted.resolution,
            max_convex_hulls: wanted.hulls,
            fill_mode: FillMode::FloodFill { detect_cavities: false },
            ..VHACDParameters::default()
        };
        let divided = VHACD::decompose(&parameters, points, triangles, true);
        let pieces = divided.compute_primitive_intersections(points, triangles);
        let parts: Vec<Part> = pieces.iter().filter(|piece| !piece.is_empty()).map(|piece| Part::of(piece)).collect();
        if attempt == MAX_ATTEMPTS || !parts.iter().any(|part| part.holds_any(&probes)) {
            return join(parts, wanted, whole, &probes);
        }
        concavity *= FINER;
    }
    unreachable!("the last attempt returns")
}

/// Points in the holes and hollows of a surface, each before a wall that has another one before it: at [`REACH`] of the way.
fn probes(points: &[Vector], triangles: &[[u32; 3]]) -> Vec<Vector> {
    let corners = |triangle: &[u32; 3]| triangle.map(|corner| points[corner as usize]);
    let every = triangles.len().div_ceil(MAX_PROBES).max(1);
    let probe = |triangle: &[u32; 3]| {
        let [a, b, c] = corners(triangle);
        let normal = (b - a).cross(c - a).try_normalize()?;
        let from = (a + b + c) / 3.0;
        let way =
            triangles.iter().filter_map(|other| way_to(from, normal, corners(other))).fold(f64::INFINITY, f64::min);
        (way.is_finite() && way > NARROW).then(|| from + normal * (REACH * way))
    };
    triangles.iter().step_by(every).filter_map(probe).collect()
}

/// Distance along a direction to a triangle that faces it (Möller and Trumbore 1997).
fn way_to(from: Vector, direction: Vector, [a, b, c]: [Vector; 3]) -> Option<f64> {
    let (ab, ac) = (b - a, c - a);
    let across = direction.cross(ac);
    let determinant = ab.dot(across);
    // Triangles are counter-clockwise seen from outside.
    if determinant <= f64::MIN_POSITIVE {
        return None;
    }
    let to = from - a;
    let u = to.dot(across) / determinant;
    let along = to.cross(ab);
    let v = direction.dot(along) / determinant;
    let way = ac.dot(along) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && way > 0.0).then_some(way)
}

/// Whether hulls reach far into holes or hollows of the sub-mesh that they stand for.
pub(super) fn close_up(sub: &SubMesh, hulls: &[Hull]) -> bool {
    let points: Vec<Vector> = sub.vertices.iter().copied().map(Vector::from).collect();
    let Some(&first) = points.first() else { return false };
    let (low, high) = points.iter().fold((first, first), |(low, high), &point| (low.min(point), high.max(point)));
    let size = (high - low).max_element();
    if !size.is_normal() {
        return false;
    }
    let scaled = |point: Vector| (point - low) / size;
    let points: Vec<Vector> = points.into_iter().map(scaled).collect();
    let exists = |triangle: &&[u32; 3]| triangle.iter().all(|&corner| (corner as usize) < points.len());
    let triangles: Vec<[u32; 3]> = sub.triangles.iter().filter(exists).copied().collect();
    let probes = probes(&points, &triangles);
    let part = |hull: &Hull| Part::of(&hull.iter().map(|&point| scaled(Vector::from(point))).collect::<Vec<_>>());
    hulls.iter().any(|hull| part(hull).holds_any(&probes))
}

/// Joins the two parts whose common hull adds the least volume, while there are too many or what it adds is within the
/// concavity and holds none of the probes. `whole` is the volume of the hull of all.
fn join(mut parts: Vec<Part>, wanted: &ConvexDecomposition, whole: f64, probes: &[Vector]) -> Vec<Part> {
    // Parts of a sheet have no volume, joined or not.
    let allowed = if whole > SHEET { wanted.concavity * whole } else { -1.0 };
    let most = wanted.hulls as usize;
    // Candidates: two parts, the first with the lower index, and what they are together.
    let candidates = |parts: &[Part], i: usize, all: bool| -> Vec<(usize, usize, Part)> {
        let others = (0..parts.len()).filter(|&j| j != i && (all || parts[i].is_near(&parts[j])));
        others.map(|j| (i.min(j), i.max(j), parts[i].joined(&parts[j]))).collect()
    };
    let from = |parts: &[Part], all: bool| -> Vec<(usize, usize, Part)> {
        (0..parts.len())
            .flat_map(|i| candidates(parts, i, all))
            .filter({
                let mut seen = std::collections::HashSet::new();
                move |&(i, j, _)| seen.insert((i, j))
            })
            .collect()
    };
    let mut pairs = from(&parts, false);
    loop {
        if pairs.is_empty() && parts.len() > most {
            pairs = from(&parts, true);
        }
        let best = pairs.iter().enumerate().min_by(|(_, a), (_, b)| a.2.added.total_cmp(&b.2.added));
        let Some(place) = best.filter(|(_, pair)| parts.len() > most || pair.2.added <= allowed).map(|(at, _)| at)
        else {
            return parts;
        };
        if parts.len() <= most && pairs[place].2.holds_any(probes) {
            pairs.swap_remove(place);
            continue;
        }
        let (i, j, part) = pairs.swap_remove(place);
        // The last part takes the place of the second one.
        let last = parts.len() - 1;
        pairs.retain(|&(a, b, _)| ![i, j].contains(&a) && ![i, j].contains(&b));
        for (a, b, _) in &mut pairs {
            for index in [&mut *a, &mut *b] {
                if *index == last {
                    *index = j;
                }
            }
            (*a, *b) = (*a.min(b), *a.max(b));
        }
        parts[i] = part;
        parts.swap_remove(j);
        pairs.extend(candidates(&parts, i, false));
    }
}

/// The vertices of the hull of points that matter most, at most [`MAX_VERTICES`]: beginning with those at the sides of
/// the bounding box, the one farthest outside the hull of those before it is taken next.
fn essential(points: &[Vector]) -> Vec<Vector> {
    let vertices = match try_convex_hull(points) {
        Ok((vertices, _)) => vertices,
        // Without an inside; Bullet takes such a hull, too.
        Err(_) => points.to_vec(),
    };
    let farthest =
        |direction: Vector| vertices.iter().copied().max_by(|a, b| a.dot(direction).total_cmp(&b.dot(direction)));
    let mut taken: Vec<Vector> = Vec::new();
    let take = |taken: &mut Vec<Vector>, point: Vector| {
        let is_new = taken.iter().all(|known| known.distance(point) > NEGLIGIBLE);
        if is_new {
            taken.push(point);
        }
        is_new
    };
    let axes = [Vector::X, Vector::Y, Vector::Z];
    let diagonals = [[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]].map(Vector::from);
    for direction in axes.into_iter().chain(diagonals).flat_map(|axis| [axis, -axis]) {
        farthest(direction).map(|point| take(&mut taken, point));
    }
    while taken.len() < MAX_VERTICES {
        let outside = match try_convex_hull(&taken) {
            Ok((corners, faces)) => farthest_outside(&vertices, &corners, &faces),
            // All in a plane: what is farthest from its fellows.
            Err(_) => vertices.iter().copied().max_by(|a, b| gap(&taken, *a).total_cmp(&gap(&taken, *b))),
        };
        if !outside.is_some_and(|point| take(&mut taken, point)) {
            break;
        }
    }
    taken
}

/// Distance to the nearest of the points.
fn gap(points: &[Vector], point: Vector) -> f64 {
    points.iter().map(|known| known.distance(point)).fold(f64::INFINITY, f64::min)
}

/// The point farthest outside a hull; `None`: none is farther than [`NEGLIGIBLE`].
fn farthest_outside(points: &[Vector], corners: &[Vector], faces: &[[u32; 3]]) -> Option<Vector> {
    let mut best = (NEGLIGIBLE, None);
    for face in faces {
        let [a, b, c] = face.map(|corner| corners[corner as usize]);
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
        for &point in points {
            let distance = normal.dot(point - a);
            if distance > best.0 {
                best = (distance, Some(point));
            }
        }
    }
    best.1
}

/// Volume of the convex hull of points, m³; 0 if it has no inside.
pub(super) fn hull_volume(points: &[[f64; 3]]) -> f64 {
    let points: Vec<Vector> = points.iter().copied().map(Vector::from).collect();
    let Some(&first) = points.first() else { return 0.0 };
    let (low, high) = points.iter().fold((first, first), |(low, high), &point| (low.min(point), high.max(point)));
    // As in `decompose`.
    let size = (high - low).max_element();
    if !size.is_normal() {
        return 0.0;
    }
    let points: Vec<Vector> = points.iter().map(|&point| (point - low) / size).collect();
    try_convex_hull(&points).map_or(0.0, |(vertices, faces)| volume(&vertices, &faces)) * size.powi(3)
}

/// Volume within a closed surface.
fn volume(vertices: &[Vector], faces: &[[u32; 3]]) -> f64 {
    let Some(&origin) = vertices.first() else { return 0.0 };
    let of_face = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|corner| vertices[corner as usize] - origin);
        a.dot(b.cross(c)) / 6.0
    };
    faces.iter().map(of_face).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use super::super::tests::channel;
    use super::*;

    fn hulls(sub: &SubMesh, wanted: &ConvexDecomposition) -> Vec<Hull> {
        match decompose(sub, wanted) {
            Divided::Hulls(hulls) => hulls,
            Divided::NoSurface => panic!("it has a surface"),
            Divided::Failed => panic!("it could not be divided"),
        }
    }

    fn volume_of(hull: &Hull) -> f64 {
        let points: Vec<Vector> = hull.iter().copied().map(Vector::from).collect();
        let (vertices, faces) = try_convex_hull(&points).expect("a hull");
        volume(&vertices, &faces)
    }

    #[test]
    fn a_channel_becomes_three_blocks() {
        let sub = channel();
        let found = hulls(&sub, &ConvexDecomposition::default());
        assert_eq!(found.len(), 3, "{found:?}");
        // 5 m³, and nothing between the walls.
        let all: f64 = found.iter().map(volume_of).sum();
        assert!((all - 5.0).abs() < 0.1, "{all} m³");
        for hull in &found {
            let within = |v: &[f64; 3]| v[0] > 1.1 && v[0] < 1.9 && v[2] > 1.05;
            assert!(!hull.iter().any(within), "{hull:?}");
        }
        // Its corners are where they were.
        for corner in &sub.vertices {
            let gap = found.iter().flatten().map(|v| (Vector::from(*v) - Vector::from(*corner)).length());
            let gap = gap.fold(f64::INFINITY, f64::min);
            assert!(gap < 1e-9 || corner[2] == 1.0, "{corner:?}: {gap}");
        }
    }

    #[test]
    fn the_same_mesh_gives_the_same_hulls_at_any_scale_and_place() {
        let (sub, wanted) = (channel(), ConvexDecomposition::default());
        let found = hulls(&sub, &wanted);
        assert_eq!(found, hulls(&sub, &wanted));
        let mut small = sub.clone();
        small.vertices.iter_mut().flatten().for_each(|x| *x *= 1.0 / 1024.0);
        let small = hulls(&small, &wanted);
        for (a, b) in found.iter().flatten().flatten().zip(small.iter().flatten().flatten()) {
            assert!((a - b * 1024.0).abs() < 1e-9);
        }
    }

    #[test]
    fn there_are_never_more_hulls_than_allowed() {
        for most in [1, 2, 3, 5] {
            let found = hulls(&channel(), &ConvexDecomposition { hulls: most, concavity: 1e-4, ..Default::default() });
            assert!(found.len() <= most as usize && !found.is_empty(), "{most}: {}", found.len());
            assert!(found.iter().all(|hull| hull.len() <= MAX_VERTICES));
        }
        let [whole] = &hulls(&channel(), &ConvexDecomposition { hulls: 1, ..Default::default() })[..] else { panic!() };
        assert!((volume_of(whole) - 6.0).abs() < 1e-6);
    }

    #[test]
    fn odd_meshes_are_survived() {
        let wanted = ConvexDecomposition { resolution: 16, ..ConvexDecomposition::default() };
        let mesh = |vertices: &[[f64; 3]], triangles: &[[u32; 3]]| SubMesh {
            vertices: vertices.to_vec(),
            triangles: triangles.to_vec(),
            surface_vertices: vertices.len(),
            ..SubMesh::default()
        };
        let square = [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        assert!(matches!(decompose(&mesh(&square, &[]), &wanted), Divided::NoSurface));
        assert!(matches!(decompose(&mesh(&square, &[[0, 1, 7]]), &wanted), Divided::NoSurface));
        assert!(matches!(decompose(&mesh(&square, &[[0, 0, 0]]), &wanted), Divided::Failed));
        // A triangle, a sheet, a needle.
        hulls(&mesh(&square, &[[0, 1, 2]]), &wanted);
        hulls(&mesh(&square, &[[0, 1, 2], [0, 2, 3]]), &wanted);
        let needle = mesh(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1e-9, 0.0]], &[[0, 1, 2]]);
        assert!(!matches!(decompose(&needle, &wanted), Divided::NoSurface), "at worst it is taken as it is");
        // A box without a lid.
        let mut open = channel();
        open.triangles.drain(2..4);
        hulls(&open, &wanted);
    }
}
