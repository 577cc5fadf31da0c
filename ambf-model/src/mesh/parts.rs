//! Parts of a mesh that are solids of their own, and whether a solid has holes.

use std::collections::{HashMap, HashSet};

use super::SubMesh;

impl SubMesh {
    /// Its [`parts`](Self::parts), if there are several and each is a closed surface: lists of triangles. Else nothing: parts
    /// that are patches of one surface, such as the sides of a box, enclose nothing by themselves.
    pub fn solids(&self) -> Vec<Vec<[u32; 3]>> {
        let mut numbers: HashMap<u32, usize> = HashMap::new();
        let mut solids: Vec<Vec<[u32; 3]>> = Vec::new();
        for (part, &triangle) in self.parts.iter().zip(&self.triangles) {
            let number = *numbers.entry(*part).or_insert(solids.len());
            if number == solids.len() {
                solids.push(Vec::new());
            }
            solids[number].push(triangle);
        }
        let is_closed = |solid: &Vec<[u32; 3]>| edges(solid).values().all(|uses| uses % 2 == 0);
        if solids.len() > 1 && solids.iter().all(is_closed) {
            solids
        } else {
            Vec::new()
        }
    }

    /// Some of its triangles, with the vertices that they use, in the order of their first use.
    pub fn of(&self, triangles: &[[u32; 3]]) -> Self {
        let mut numbers = HashMap::new();
        let mut part = Self { name: self.name.clone(), ..Self::default() };
        let exists = |triangle: &&[u32; 3]| triangle.iter().all(|&vertex| (vertex as usize) < self.vertices.len());
        for triangle in triangles.iter().filter(exists) {
            part.triangles.push(triangle.map(|vertex| {
                *numbers.entry(vertex).or_insert_with(|| {
                    part.vertices.push(self.vertices[vertex as usize]);
                    part.vertices.len() as u32 - 1
                })
            }));
        }
        part.surface_vertices = part.vertices.len();
        part
    }
}

/// Volume that closed surfaces of these triangles enclose, m³: by the divergence theorem, from tetrahedra with a common corner.
/// `None` for surfaces that are not closed.
pub fn enclosed_volume(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> Option<f64> {
    let edges = edges(triangles);
    let is_closed = !edges.is_empty() && edges.values().all(|uses| uses % 2 == 0);
    let at = |corner: u32| vertices.get(corner as usize).copied().map(nalgebra::Vector3::from);
    let origin = at(triangles.first()?[0])?;
    let of_triangle = |&[a, b, c]: &[u32; 3]| {
        let [a, b, c] = [at(a)? - origin, at(b)? - origin, at(c)? - origin];
        Some(a.dot(&b.cross(&c)) / 6.0)
    };
    let sum: Option<f64> = triangles.iter().map(of_triangle).sum();
    sum.map(f64::abs).filter(|_| is_closed)
}

/// Whether a hole goes through the solid that closed surfaces of these triangles (indices of vertices) bound: for a connected
/// surface of V vertices, E edges and F triangles V − E + F = 2 − 2 g, where g is the number of holes. `false` for surfaces that
/// are not closed, or that touch themselves along edges: they say nothing about holes.
pub fn has_holes(triangles: &[[u32; 3]]) -> bool {
    let edges = edges(triangles);
    if edges.is_empty() || edges.values().any(|&uses| uses != 2) {
        return false;
    }
    let faces: HashSet<[u32; 3]> = triangles.iter().filter(|t| !is_degenerate(t)).copied().collect();
    let vertices: HashSet<u32> = faces.iter().flatten().copied().collect();
    // Connected surfaces, by union of the vertices of edges.
    let mut leader: HashMap<u32, u32> = vertices.iter().map(|&vertex| (vertex, vertex)).collect();
    let mut count = vertices.len() as i64;
    for &[a, b] in edges.keys() {
        let [a, b] = [a, b].map(|vertex| lead(&mut leader, vertex));
        if a != b {
            leader.insert(a, b);
            count -= 1;
        }
    }
    let characteristic = vertices.len() as i64 - edges.len() as i64 + faces.len() as i64;
    characteristic < 2 * count
}

fn lead(leader: &mut HashMap<u32, u32>, vertex: u32) -> u32 {
    let mut at = vertex;
    while leader[&at] != at {
        let above = leader[&leader[&at]];
        leader.insert(at, above);
        at = above;
    }
    at
}

fn is_degenerate(&[a, b, c]: &[u32; 3]) -> bool {
    a == b || b == c || c == a
}

/// Edges, with the number of triangles that use them.
fn edges(triangles: &[[u32; 3]]) -> HashMap<[u32; 2], u32> {
    let mut edges = HashMap::new();
    for &[a, b, c] in triangles.iter().filter(|triangle| !is_degenerate(triangle)) {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            *edges.entry([from.min(to), from.max(to)]).or_insert(0) += 1;
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of `n` × 4 quadrilaterals, or, without the quadrilaterals that close it, a tube.
    fn ring(n: u32) -> Vec<[u32; 3]> {
        let at = |i: u32, k: u32| 4 * (i % n) + k % 4;
        let quads = (0..n).flat_map(|i| (0..4).map(move |k| (i, k)));
        quads
            .flat_map(|(i, k)| {
                let [a, b, c, d] = [at(i, k), at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)];
                [[a, b, c], [a, c, d]]
            })
            .collect()
    }

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]];

    #[test]
    fn holes_are_told_from_hollows() {
        assert!(has_holes(&ring(5)));
        assert!(!has_holes(&TETRAHEDRON));
        assert!(!has_holes(&TETRAHEDRON[..3]), "not closed");
        assert!(!has_holes(&ring(5)[1..]), "not closed");
        // Beside each other, and with a triangle of no area.
        let shifted = TETRAHEDRON.map(|triangle| triangle.map(|vertex| vertex + 20));
        assert!(!has_holes(&[&TETRAHEDRON[..], &shifted, &[[0, 0, 1]]].concat()));
        assert!(has_holes(&[&ring(5)[..], &shifted].concat()));
        assert!(!has_holes(&[]));
    }

    #[test]
    fn the_volume_of_a_closed_surface() {
        let vertices = [[1.0, 1.0, 1.0], [2.0, 1.0, 1.0], [1.0, 3.0, 1.0], [1.0, 1.0, 4.0]];
        let found = enclosed_volume(&vertices, &TETRAHEDRON).expect("it is closed");
        assert!((found - 1.0).abs() < 1e-12, "{found}");
        assert_eq!(enclosed_volume(&vertices, &TETRAHEDRON[1..]), None);
        assert_eq!(enclosed_volume(&vertices, &[]), None);
    }

    #[test]
    fn parts_that_are_closed_are_solids() {
        let shifted = TETRAHEDRON.map(|triangle| triangle.map(|vertex| vertex + 3));
        let triangles = [TETRAHEDRON, shifted].concat();
        let sub = |parts: &[u32]| SubMesh { triangles: triangles.clone(), parts: parts.to_vec(), ..SubMesh::default() };
        assert_eq!(sub(&[4, 4, 4, 4, 9, 9, 9, 9]).solids(), [TETRAHEDRON.to_vec(), shifted.to_vec()]);
        assert!(sub(&[4, 4, 4, 9, 9, 9, 9, 9]).solids().is_empty(), "patches");
        assert!(sub(&[1; 8]).solids().is_empty(), "one part");
        assert!(sub(&[]).solids().is_empty(), "one part");
    }
}
