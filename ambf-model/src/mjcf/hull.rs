//! Convex hulls of points.

use std::collections::{HashMap, HashSet};

use nalgebra::Vector3;

/// Distance from a face, as a share of the size of all points, up to which a point counts as in it.
const FLAT: f64 = 1e-12;

/// A triangle of the hull, counter-clockwise seen from outside.
struct Face {
    corners: [usize; 3],
    normal: Vector3<f64>,
    /// Points outside, none of which is outside of another face's, too.
    outside: Vec<usize>,
}

impl Face {
    fn edges(&self) -> [(usize, usize); 3] {
        let [a, b, c] = self.corners;
        [(a, b), (b, c), (c, a)]
    }

    fn height(&self, points: &[Vector3<f64>], point: usize) -> f64 {
        self.normal.dot(&(points[point] - points[self.corners[0]]))
    }
}

/// Triangles of the convex hull, counter-clockwise seen from outside; none if all points are in a plane. Finite points.
///
/// Quickhull (Barber, Dobkin and Huhdanpaa 1996).
pub(super) fn hull(points: &[Vector3<f64>]) -> Vec<[Vector3<f64>; 3]> {
    let Some(first) = tetrahedron(points) else { return Vec::new() };
    let size = points.iter().map(|point| (point - points[first[0]]).amax()).fold(0.0, f64::max);
    let mut hull = Hull { points, flat: FLAT * size, faces: Vec::new(), at_edge: HashMap::new() };
    let [a, b, c, d] = first;
    for corners in [[a, b, c], [a, d, b], [b, d, c], [c, d, a]] {
        hull.add(corners);
    }
    let all: Vec<usize> = (0..points.len()).collect();
    hull.share(&all, 0);
    let mut waiting: Vec<usize> = (0..hull.faces.len()).collect();
    while let Some(index) = waiting.pop() {
        let made = hull.faces.len();
        hull.grow(index);
        waiting.extend(made..hull.faces.len());
    }
    hull.faces.iter().flatten().map(|face| face.corners.map(|corner| points[corner])).collect()
}

/// Four points far from each other, of which the first three are counter-clockwise seen from outside.
fn tetrahedron(points: &[Vector3<f64>]) -> Option<[usize; 4]> {
    let farthest = |distance: &dyn Fn(&Vector3<f64>) -> f64| {
        let found = points.iter().map(distance).enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b));
        found.filter(|(_, distance)| *distance > 0.0).map(|(index, _)| index)
    };
    let start = points.first()?;
    let a = farthest(&|point| (point - start).norm())?;
    let b = farthest(&|point| (point - points[a]).norm())?;
    let along = (points[b] - points[a]).normalize();
    let c = farthest(&|point| (point - points[a]).cross(&along).norm())?;
    let normal = along.cross(&(points[c] - points[a])).normalize();
    let height = |point: &Vector3<f64>| normal.dot(&(point - points[a]));
    let d = farthest(&|point| height(point).abs())?;
    if height(&points[d]).abs() <= FLAT * (points[b] - points[a]).norm() {
        return None;
    }
    Some(if height(&points[d]) < 0.0 { [a, b, c, d] } else { [a, c, b, d] })
}

struct Hull<'p> {
    points: &'p [Vector3<f64>],
    flat: f64,
    /// `None`: no longer part of it.
    faces: Vec<Option<Face>>,
    /// Faces by their edges.
    at_edge: HashMap<(usize, usize), usize>,
}

impl Hull<'_> {
    fn add(&mut self, corners: [usize; 3]) {
        let [a, b, c] = corners.map(|corner| self.points[corner]);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
        let face = Face { corners, normal, outside: Vec::new() };
        for edge in face.edges() {
            self.at_edge.insert(edge, self.faces.len());
        }
        self.faces.push(Some(face));
    }

    /// Gives points to the faces from an index on that they are outside of.
    fn share(&mut self, points: &[usize], from: usize) {
        for &point in points {
            let (all, flat) = (self.points, self.flat);
            let face = self.faces[from..].iter_mut().flatten().find(|face| face.height(all, point) > flat);
            if let Some(face) = face {
                face.outside.push(point);
            }
        }
    }

    /// Takes the point that is farthest outside of a face into the hull.
    fn grow(&mut self, index: usize) {
        let Some(face) = &self.faces[index] else { return };
        let height = |point: &usize| face.height(self.points, *point);
        let Some(&apex) = face.outside.iter().max_by(|a, b| height(a).total_cmp(&height(b))) else { return };
        let is_below = |face: &Face| face.height(self.points, apex) > self.flat;
        let mut below = HashSet::from([index]);
        let (mut waiting, mut rim) = (vec![index], Vec::new());
        while let Some(index) = waiting.pop() {
            for (a, b) in self.faces[index].iter().flat_map(Face::edges) {
                let Some(&beside) = self.at_edge.get(&(b, a)) else { continue };
                if below.contains(&beside) {
                    continue;
                }
                if self.faces[beside].as_ref().is_some_and(is_below) {
                    below.insert(beside);
                    waiting.push(beside);
                } else {
                    rim.push((a, b));
                }
            }
        }
        // In the order in which they were made, so that the same points make the same hull.
        let mut below: Vec<usize> = below.into_iter().collect();
        below.sort_unstable();
        let lost: Vec<Face> = below.into_iter().filter_map(|index| self.faces[index].take()).collect();
        for edge in lost.iter().flat_map(Face::edges) {
            self.at_edge.remove(&edge);
        }
        let made = self.faces.len();
        for (a, b) in rim {
            self.add([a, b, apex]);
        }
        for face in lost {
            self.share(&face.outside, made);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the volume, and whether each edge has two triangles.
    fn measure(triangles: &[[Vector3<f64>; 3]]) -> (f64, bool) {
        let volume = triangles.iter().map(|[a, b, c]| a.dot(&b.cross(c))).sum();
        let key = |point: &Vector3<f64>| [point.x, point.y, point.z].map(f64::to_bits);
        let edges: HashSet<_> = triangles
            .iter()
            .flat_map(|[a, b, c]| [(a, b), (b, c), (c, a)].map(|(from, to)| (key(from), key(to))))
            .collect();
        (volume, edges.len() == 3 * triangles.len() && edges.iter().all(|&(from, to)| edges.contains(&(to, from))))
    }

    #[test]
    fn a_grid_in_a_box_is_the_box() {
        let along = |n: usize| (0..=4).map(move |i| n as f64 * f64::from(i) / 4.0 + 3.0);
        let points: Vec<Vector3<f64>> =
            along(1).flat_map(|x| along(2).flat_map(move |y| along(3).map(move |z| Vector3::new(x, y, z)))).collect();
        let (volume, is_closed) = measure(&hull(&points));
        assert!((volume / 6.0 - 6.0).abs() < 1e-12 && is_closed, "{volume}");
    }

    #[test]
    fn points_on_a_sphere_are_all_corners() {
        // Fibonacci's spiral, each point twice, and points inside.
        let on_sphere = |index: usize| {
            let z = 1.0 - (2.0 * index as f64 + 1.0) / 1000.0;
            let (sine, cosine) = (index as f64 * 2.399_963_229_728_653).sin_cos();
            Vector3::new(cosine, sine, 0.0) * (1.0 - z * z).sqrt() + Vector3::new(0.0, 0.0, z)
        };
        let points: Vec<Vector3<f64>> = (0..1000)
            .map(on_sphere)
            .chain((0..1000).map(on_sphere))
            .chain((0..1000).map(|i| 0.9 * on_sphere(i)))
            .collect();
        let triangles = hull(&points);
        let (volume, is_closed) = measure(&triangles);
        assert!(is_closed && triangles.len() == 2 * 1000 - 4, "{}", triangles.len());
        let ball = 4.0 / 3.0 * std::f64::consts::PI;
        assert!(volume / 6.0 < ball && volume / 6.0 > 0.99 * ball, "{volume}");
        assert!(triangles.iter().all(|[a, b, c]| {
            let normal = (b - a).cross(&(c - a)).normalize();
            points.iter().all(|point| normal.dot(&(point - a)) < 1e-12)
        }));
    }

    #[test]
    fn what_is_flat_has_no_hull() {
        let flat = |points: &[[f64; 3]]| hull(&points.iter().map(|&point| point.into()).collect::<Vec<_>>()).len();
        assert_eq!(flat(&[]), 0);
        assert_eq!(flat(&[[1.0, 2.0, 3.0]; 5]), 0);
        assert_eq!(flat(&[[0.0; 3], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.0]]), 0);
        assert_eq!(flat(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.3, 0.2, 0.0]]), 0);
        assert_eq!(flat(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1e-3]]), 4);
    }
}
