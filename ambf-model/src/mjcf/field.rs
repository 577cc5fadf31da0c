//! Height fields: elevations over a rectangle.

use std::path::Path;

use crate::files;
use crate::mesh::{Mesh, SubMesh, MAX_TRIANGLES};

/// Elevations of a grid, of which x grows with the columns and y with the rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    rows: usize,
    columns: usize,
    /// (rows x columns), row by row; from 0 to 1, or all 0.
    elevations: Vec<f64>,
}

impl Field {
    /// An error is the reason why it cannot be.
    pub fn new(rows: usize, columns: usize, elevations: Vec<f64>) -> Result<Self, String> {
        Self::check_size(rows as u64, columns as u64)?;
        let wanted = rows * columns;
        if elevations.len() != wanted {
            return Err(format!("{} elevations, expected {rows} times {columns}", elevations.len()));
        }
        if let Some(elevation) = elevations.iter().find(|elevation| !elevation.is_finite()) {
            return Err(format!("an elevation is {elevation}, expected finite numbers"));
        }
        let (low, high) = elevations.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &elevation| {
            (elevation.min(low), elevation.max(high))
        });
        let range = if high > low { high - low } else { 1.0 };
        Ok(Self {
            rows,
            columns,
            elevations: elevations.into_iter().map(|elevation| (elevation - low) / range).collect(),
        })
    }

    /// Without elevations.
    pub fn flat(rows: usize, columns: usize) -> Result<Self, String> {
        Self::check_size(rows as u64, columns as u64)?;
        Self::new(rows, columns, vec![0.0; rows * columns])
    }

    /// That of a text, whose first row is that of the largest y.
    pub fn of_text(rows: usize, columns: usize, elevations: &[f64]) -> Result<Self, String> {
        Self::check_size(rows as u64, columns as u64)?;
        Self::new(rows, columns, elevations.chunks(columns).rev().flatten().copied().collect())
    }

    /// That of a file in MuJoCo's binary format: numbers of rows and columns, then elevations, little-endian.
    pub fn load(path: &Path) -> Result<Self, String> {
        // The header, four bytes each elevation, and a byte by which a longer file is told.
        const MOST_BYTES: u64 = 8 + 4 * MAX_TRIANGLES as u64;
        let bytes = files::read(path, MOST_BYTES).map_err(|error| format!("it cannot be read: {error}"))?;
        Self::parse(&bytes)
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut words = bytes.chunks_exact(4).map(|word| [word[0], word[1], word[2], word[3]]);
        let mut count = || words.next().map_or(0, i32::from_le_bytes);
        let (rows, columns) = (count(), count());
        let [rows, columns] = [rows, columns].map(|count| u64::try_from(count).unwrap_or(0));
        Self::check_size(rows, columns)?;
        let announced = 8 + 4 * rows * columns;
        if bytes.len() as u64 != announced {
            let length = bytes.len();
            return Err(format!(
                "a file of {length} bytes, expected {announced} with {rows} rows and {columns} columns"
            ));
        }
        let elevations = words.map(|word| f64::from(f32::from_le_bytes(word))).collect();
        Self::new(rows as usize, columns as usize, elevations)
    }

    fn check_size(rows: u64, columns: u64) -> Result<(), String> {
        let cells = rows.saturating_sub(1).saturating_mul(columns.saturating_sub(1));
        // Two triangles a cell, three for each part of the rim.
        let triangles = cells.saturating_mul(2).saturating_add(rows.saturating_add(columns).saturating_mul(6));
        if cells == 0 || triangles > MAX_TRIANGLES as u64 {
            let most = MAX_TRIANGLES;
            return Err(format!(
                "{rows} rows and {columns} columns, expected 2 or more and less than {most} triangles"
            ));
        }
        Ok(())
    }

    /// The body below the surface. `size`: half of its length along x and y, its height above the plane z = 0 where the elevation is 1,
    /// and its depth below, m.
    pub fn mesh(&self, size: [f64; 4]) -> Mesh {
        let [half_x, half_y, height, depth] = size;
        let (rows, columns) = (self.rows, self.columns);
        let along = |half: f64, index: usize, count: usize| half * (2.0 * index as f64 / (count - 1) as f64 - 1.0);
        let at = |row: usize, column: usize, z: f64| [along(half_x, column, columns), along(half_y, row, rows), z];
        let vertex = |row: usize, column: usize| at(row, column, height * self.elevations[row * columns + column]);
        let mut top = SubMesh {
            vertices: (0..rows).flat_map(|row| (0..columns).map(move |column| vertex(row, column))).collect(),
            surface_vertices: rows * columns,
            ..SubMesh::default()
        };
        for row in 0..rows - 1 {
            for column in 0..columns - 1 {
                let [low, high] = [row, row + 1].map(|row| (row * columns + column) as u32);
                // The diagonal is that of MuJoCo.
                top.triangles.extend([[low, low + 1, high + 1], [low, high + 1, high]]);
            }
        }
        // Along the rim, counter-clockwise seen from above.
        let rim = (0..columns - 1).map(|column| (0, column));
        let rim = rim.chain((0..rows - 1).map(|row| (row, columns - 1)));
        let rim = rim.chain((1..columns).rev().map(|column| (rows - 1, column)));
        let rim: Vec<(usize, usize)> = rim.chain((1..rows).rev().map(|row| (row, 0))).collect();
        let count = rim.len() as u32;
        let mut rest = SubMesh::default();
        rest.vertices.extend(rim.iter().map(|&(row, column)| vertex(row, column)));
        rest.vertices.extend(rim.iter().map(|&(row, column)| at(row, column, -depth)));
        rest.vertices.push([0.0, 0.0, -depth]);
        for (own, next) in (0..count).map(|own| (own, (own + 1) % count)) {
            let (below, next_below) = (own + count, next + count);
            rest.triangles.extend([[own, below, next_below], [own, next_below, next], [2 * count, next_below, below]]);
        }
        rest.surface_vertices = rest.vertices.len();
        Mesh { sub_meshes: vec![top, rest] }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::mesh::enclosed_volume;

    fn field() -> Field {
        Field::of_text(2, 3, &[1.0, 2.0, 3.0, 4.0, 5.0, 7.0]).unwrap()
    }

    /// Height of the surface at a place.
    fn height_at(mesh: &Mesh, x: f64, y: f64) -> Option<f64> {
        let top = &mesh.sub_meshes[0];
        top.triangles.iter().find_map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| Vector3::from(top.vertices[vertex as usize]));
            let normal = (b - a).cross(&(c - a));
            assert!(normal.z > 0.0, "the surface looks up");
            let point = Vector3::new(x, y, a.z - (normal.x * (x - a.x) + normal.y * (y - a.y)) / normal.z);
            let is_inside =
                [(a, b), (b, c), (c, a)].iter().all(|(from, to)| (to - from).cross(&(point - from)).z >= 0.0);
            is_inside.then_some(point.z)
        })
    }

    /// Found by `mj_ray` of MuJoCo 4.0.0 in this field.
    #[test]
    fn the_surface_is_that_of_mujoco() {
        let mesh = field().mesh([2.0, 1.0, 3.0, 0.5]);
        for (x, y, expected) in [
            (-1.9, -0.9, 1.45),
            (-0.1, 0.9, 0.55),
            (-0.5, 0.2, 0.975),
            (-0.9, 0.9, 0.35),
            (1.5, -0.3, 2.05),
            (1.1, 0.8, 0.925),
        ] {
            let found = height_at(&mesh, x, y).unwrap();
            assert!((found - expected).abs() < 1e-7, "({x}, {y}): {found}");
        }
    }

    #[test]
    fn it_is_closed_and_looks_outwards() {
        let mesh = field().mesh([2.0, 1.0, 3.0, 0.5]);
        let mut all = SubMesh::default();
        let mut places: Vec<[f64; 3]> = Vec::new();
        for sub in &mesh.sub_meshes {
            for triangle in &sub.triangles {
                all.triangles.push(triangle.map(|vertex| {
                    let vertex = sub.vertices[vertex as usize];
                    let known = places.iter().position(|place| *place == vertex);
                    known.unwrap_or_else(|| {
                        places.push(vertex);
                        places.len() - 1
                    }) as u32
                }));
            }
        }
        // Prisms above triangles of half a cell, which is 2 m by 2 m: the mean of the corners, and the depth.
        let above: f64 =
            [[1.5, 2.0, 0.5], [1.5, 0.5, 0.0], [2.0, 3.0, 1.0], [2.0, 1.0, 0.5]].as_flattened().iter().sum();
        let expected = 2.0 * above / 3.0 + 4.0 * 2.0 * 0.5;
        let found = enclosed_volume(&places, &all.triangles).expect("it is closed");
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        let signed: f64 = (all.triangles.iter())
            .map(|triangle| triangle.map(|vertex| Vector3::from(places[vertex as usize])))
            .map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0)
            .sum();
        assert!((signed - expected).abs() < 1e-12, "{signed}");
    }

    #[test]
    fn binary_files() {
        let file = |rows: i32, columns: i32, elevations: &[f32]| -> Vec<u8> {
            let counts = [rows, columns].map(i32::to_le_bytes);
            let elevations: Vec<u8> = elevations.iter().flat_map(|elevation| elevation.to_le_bytes()).collect();
            [counts.as_flattened(), &elevations].concat()
        };
        let from_file = Field::parse(&file(2, 3, &[4.0, 5.0, 7.0, 1.0, 2.0, 3.0])).unwrap();
        assert_eq!(from_file, field(), "its first row is that of the smallest y");
        assert_eq!(Field::flat(3, 2).unwrap().elevations, [0.0; 6]);
        for (bytes, expected) in [
            (vec![], "0 rows and 0 columns, expected 2 or more"),
            (file(1, 9, &[0.0; 9]), "1 rows and 9 columns"),
            (file(-2, -3, &[0.0; 6]), "0 rows and 0 columns"),
            (
                file(i32::MAX, i32::MAX, &[]),
                "2147483647 rows and 2147483647 columns, expected 2 or more and less than 10000000",
            ),
            (file(2, 3, &[0.0; 5]), "a file of 28 bytes, expected 32 with 2 rows and 3 columns"),
            (file(2, 3, &[0.0; 7]), "a file of 36 bytes"),
            (file(2, 2, &[0.0, 1.0, f32::NAN, 2.0]), "an elevation is NaN, expected finite numbers"),
        ] {
            let problem = Field::parse(&bytes).unwrap_err();
            assert!(problem.contains(expected), "{expected}: {problem}");
        }
        assert!(Field::of_text(2, 3, &[0.0; 7]).unwrap_err().contains("7 elevations, expected 2 times 3"));
        assert!(Field::flat(100_000, 100_000).unwrap_err().contains("less than 10000000 triangles"));
    }
}
