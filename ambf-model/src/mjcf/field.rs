//! Height fields: elevations over a rectangle.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};

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

/// What a height field is that is none, and what was expected.
#[derive(Debug)]
pub(super) struct Unusable {
    pub found: String,
    pub expected: String,
}

impl Field {
    /// Of as many rows and columns as were checked.
    fn new(rows: usize, columns: usize, elevations: Vec<f64>) -> Result<Self, Unusable> {
        let wanted = rows * columns;
        if elevations.len() != wanted {
            return unusable(format!("{} elevations", elevations.len()), format!("{rows} times {columns}"));
        }
        if let Some(elevation) = elevations.iter().find(|elevation| !elevation.is_finite()) {
            return unusable(format!("with an elevation of {elevation}"), "finite numbers".to_owned());
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

    /// Without elevations; `most`: triangles, as below.
    pub fn flat(rows: usize, columns: usize, most: usize) -> Result<Self, Unusable> {
        Self::check_size(rows as u64, columns as u64, most)?;
        Self::new(rows, columns, vec![0.0; rows * columns])
    }

    /// Of rows of which the first is that of the largest y.
    pub fn of_text(rows: usize, columns: usize, elevations: &[f64], most: usize) -> Result<Self, Unusable> {
        Self::check_size(rows as u64, columns as u64, most)?;
        Self::new(rows, columns, elevations.chunks(columns).rev().flatten().copied().collect())
    }

    /// That of a PNG picture, whose first row is that of the largest y, or of a file in MuJoCo's binary format: numbers of rows and
    /// columns, then elevations, little-endian.
    pub fn load(path: &Path, most: usize) -> Result<Self, Unusable> {
        // The header, and four bytes each elevation: there are fewer than triangles.
        let bytes = files::read(path, 8 + 4 * most as u64)
            .or_else(|error| unusable(format!("not readable: {error}"), "a PNG picture or a binary file".to_owned()))?;
        Self::parse(&bytes, most)
    }

    fn parse(bytes: &[u8], most: usize) -> Result<Self, Unusable> {
        match image::guess_format(bytes) {
            Ok(ImageFormat::Png) => Self::of_picture(bytes, most),
            _ => Self::of_binary(bytes, most),
        }
    }

    fn of_picture(bytes: &[u8], most: usize) -> Result<Self, Unusable> {
        let failed = |error: ImageError| {
            let what: String = error.to_string().trim().chars().take(200).collect();
            let found = format!("a picture that cannot be read: {}", what.escape_debug());
            Unusable { found, expected: "a PNG picture".to_owned() }
        };
        let mut reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
        let mut limits = Limits::default();
        // Four channels of two bytes.
        limits.max_alloc = Some(8 * MAX_TRIANGLES as u64);
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(failed)?;
        let (columns, rows) = decoder.dimensions();
        Self::check_size(u64::from(rows), u64::from(columns), most)?;
        // The first channel of 8 bits, as in MuJoCo.
        let elevations: Vec<f64> = match DynamicImage::from_decoder(decoder).map_err(failed)? {
            DynamicImage::ImageLuma16(picture) => {
                picture.pixels().map(|pixel| pixel.0[0] >> 8).map(f64::from).collect()
            }
            DynamicImage::ImageLumaA16(picture) => {
                picture.pixels().map(|pixel| pixel.0[0] >> 8).map(f64::from).collect()
            }
            DynamicImage::ImageRgb16(picture) => picture.pixels().map(|pixel| pixel.0[0] >> 8).map(f64::from).collect(),
            DynamicImage::ImageRgba16(picture) => {
                picture.pixels().map(|pixel| pixel.0[0] >> 8).map(f64::from).collect()
            }
            picture => picture.into_rgb8().pixels().map(|pixel| f64::from(pixel.0[0])).collect(),
        };
        Self::of_text(rows as usize, columns as usize, &elevations, most)
    }

    fn of_binary(bytes: &[u8], most: usize) -> Result<Self, Unusable> {
        let mut words = bytes.chunks_exact(4).map(|word| [word[0], word[1], word[2], word[3]]);
        let mut count = || words.next().map_or(0, i32::from_le_bytes);
        let (rows, columns) = (count(), count());
        let [rows, columns] = [rows, columns].map(|count| u64::try_from(count).unwrap_or(0));
        Self::check_size(rows, columns, most)?;
        let announced = 8 + 4 * rows * columns;
        if bytes.len() as u64 != announced {
            let found = format!("a file of {} bytes", bytes.len());
            return unusable(found, format!("{announced} with {rows} rows and {columns} columns"));
        }
        let elevations = words.map(|word| f64::from(f32::from_le_bytes(word))).collect();
        Self::new(rows as usize, columns as usize, elevations)
    }

    fn check_size(rows: u64, columns: u64, most: usize) -> Result<(), Unusable> {
        let cells = rows.saturating_sub(1).saturating_mul(columns.saturating_sub(1));
        // Two triangles a cell, three for each part of the rim.
        let triangles = cells.saturating_mul(2).saturating_add(rows.saturating_add(columns).saturating_mul(6));
        if cells == 0 || triangles > most as u64 {
            let found = format!("of {rows} rows and {columns} columns");
            let expected = format!("2 or more, and {most} triangles at most: {MAX_TRIANGLES} of all height fields");
            return unusable(found, expected);
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

fn unusable<T>(found: String, expected: String) -> Result<T, Unusable> {
    Err(Unusable { found, expected })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::mesh::enclosed_volume;

    fn refused(field: Result<Field, Unusable>) -> String {
        let Unusable { found, expected } = field.unwrap_err();
        format!("{found}, expected {expected}")
    }

    fn field() -> Field {
        Field::of_text(2, 3, &[1.0, 2.0, 3.0, 4.0, 5.0, 7.0], MAX_TRIANGLES).unwrap()
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

    /// As MuJoCo 4.0.0 reads the same files.
    #[test]
    fn pictures() {
        let png = |picture: DynamicImage| {
            let mut bytes = Cursor::new(Vec::new());
            picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
            bytes.into_inner()
        };
        let colours = vec![10, 200, 30, 20, 0, 0, 60, 0, 0, 0, 0, 0, 110, 5, 5, 7, 7, 7];
        let coloured = png(DynamicImage::ImageRgb8(image::RgbImage::from_raw(3, 2, colours).unwrap()));
        let expected = [0.0, 110.0, 7.0, 10.0, 20.0, 60.0].map(|red: f64| red / 110.0);
        assert_eq!(Field::parse(&coloured, MAX_TRIANGLES).unwrap().elevations, expected);
        let depths = vec![0x10ff, 0x2000, 0x3080, 0x0090, 0x507f, 0x4000];
        let deep = png(DynamicImage::ImageLuma16(image::ImageBuffer::from_raw(3, 2, depths).unwrap()));
        let expected = [0.0, 80.0, 64.0, 16.0, 32.0, 48.0].map(|byte: f64| byte / 80.0);
        assert_eq!(Field::parse(&deep, MAX_TRIANGLES).unwrap().elevations, expected);
        let line = png(DynamicImage::new_luma8(3, 1));
        assert!(refused(Field::parse(&line, MAX_TRIANGLES)).contains("1 rows and 3 columns"));
        let large = png(DynamicImage::new_luma8(4000, 4000));
        assert!(refused(Field::parse(&large, MAX_TRIANGLES)).contains("10000000 triangles at most"));
        let broken = refused(Field::parse(&coloured[..40], MAX_TRIANGLES));
        assert!(broken.contains("a picture that cannot be read"), "{broken}");
    }

    #[test]
    fn binary_files() {
        let file = |rows: i32, columns: i32, elevations: &[f32]| -> Vec<u8> {
            let counts = [rows, columns].map(i32::to_le_bytes);
            let elevations: Vec<u8> = elevations.iter().flat_map(|elevation| elevation.to_le_bytes()).collect();
            [counts.as_flattened(), &elevations].concat()
        };
        let from_file = Field::parse(&file(2, 3, &[4.0, 5.0, 7.0, 1.0, 2.0, 3.0]), MAX_TRIANGLES).unwrap();
        assert_eq!(from_file, field(), "its first row is that of the smallest y");
        assert_eq!(Field::flat(3, 2, MAX_TRIANGLES).unwrap().elevations, [0.0; 6]);
        for (bytes, expected) in [
            (vec![], "0 rows and 0 columns, expected 2 or more"),
            (file(1, 9, &[0.0; 9]), "1 rows and 9 columns"),
            (file(-2, -3, &[0.0; 6]), "0 rows and 0 columns"),
            (
                file(i32::MAX, i32::MAX, &[]),
                "2147483647 rows and 2147483647 columns, expected 2 or more, and 10000000 triangles at most",
            ),
            (file(2, 3, &[0.0; 5]), "a file of 28 bytes, expected 32 with 2 rows and 3 columns"),
            (file(2, 3, &[0.0; 7]), "a file of 36 bytes"),
            (file(2, 2, &[0.0, 1.0, f32::NAN, 2.0]), "with an elevation of NaN, expected finite numbers"),
        ] {
            let problem = refused(Field::parse(&bytes, MAX_TRIANGLES));
            assert!(problem.contains(expected), "{expected}: {problem}");
        }
        assert!(refused(Field::of_text(2, 3, &[0.0; 7], MAX_TRIANGLES)).contains("7 elevations, expected 2 times 3"));
        assert!(refused(Field::flat(100_000, 100_000, MAX_TRIANGLES)).contains("10000000 triangles at most"));
    }
}
