//! Queries, cuts, contact and surfaces against analytic bodies, and against searches over all voxels.

use ambf_volume::proxy::{Law, Proxy, Surface};
use ambf_volume::query::Near;
use ambf_volume::surface::Patch;
use ambf_volume::{Carver, Label, Rule, Shape, Stroke, Voxel, VoxelGrid};
use nalgebra::{Isometry3, Point3, Vector3};

/// Numbers that look random and are the same each time.
struct Random(u64);

impl Random {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }

    /// From 0 to 1.
    fn part(&mut self) -> f64 {
        self.word() as f64 / (1_u64 << 31) as f64
    }

    fn point(&mut self, edges: &Vector3<f64>, share: f64) -> Point3<f64> {
        Point3::from(edges.map(|edge| edge * share * (self.part() - 0.5)))
    }

    fn direction(&mut self) -> Vector3<f64> {
        loop {
            let v = Vector3::from_fn(|_, _| 2.0 * self.part() - 1.0);
            if (0.01..1.0).contains(&v.norm()) {
                return v.normalize();
            }
        }
    }
}

fn label() -> Vec<Label> {
    vec![Label::of_color([255, 249, 219]), Label { hardness: 3.0, ..Label::of_color([1, 2, 3]) }]
}

const FULL: Voxel = Voxel { density: 255, label: 1 };

/// A ball of R = 12 mm in 128³ voxels of 0.25 mm; its density falls over `layer`, m.
fn ball(layer: f64) -> VoxelGrid {
    let edges = Vector3::repeat(0.032);
    VoxelGrid::from_fn([128; 3], edges, 0.5, label(), |index| {
        let from_middle = Vector3::from_fn(|axis, _| (index[axis] as f64 - 63.5) * 0.25e-3).norm();
        let density = if layer == 0.0 {
            f64::from(from_middle <= 0.012)
        } else {
            (0.5 + (0.012 - from_middle) / layer).clamp(0.0, 1.0)
        };
        Voxel { density: (255.0 * density).round() as u8, label: u8::from(density > 0.0) }
    })
    .expect("a grid")
}

fn random_grid(random: &mut Random, fill: f64) -> VoxelGrid {
    let size = [32, 27, 30];
    let voxels: Vec<_> = (0..size.iter().product())
        .map(|_| match random.part() < fill {
            true => Voxel { density: 128 + (random.word() % 128) as u8, label: 1 + (random.word() % 2) as u8 },
            false => Voxel { density: (random.word() % 128) as u8, label: 1 },
        })
        .collect();
    let at = |[i, j, k]: [usize; 3]| voxels[(k * 27 + j) * 32 + i];
    VoxelGrid::from_fn(size, Vector3::new(0.0128, 0.0135, 0.018), 0.5, label(), at).expect("a grid")
}

fn indices(size: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..size[2]).flat_map(move |k| (0..size[1]).flat_map(move |j| (0..size[0]).map(move |i| [i, j, k])))
}

/// Distance to a centre as the search computes it.
fn square_to(grid: &VoxelGrid, point: &Point3<f64>, index: [usize; 3]) -> f64 {
    let offset = grid.center(index) - point;
    [2, 1, 0].into_iter().fold(0.0, |sum, axis| sum + offset[axis] * offset[axis])
}

/// The nearest voxel of those that `is` picks, by looking at all; of equal ones the first in the order z, y, x.
fn nearest(grid: &VoxelGrid, point: &Point3<f64>, is: impl Fn([usize; 3]) -> bool) -> Option<([usize; 3], f64)> {
    let all = indices(grid.size()).filter(|&index| is(index)).map(|index| (index, square_to(grid, point, index)));
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, square)| (index, square.sqrt()))
}

fn is_right(grid: &VoxelGrid) {
    for index in indices(grid.size()) {
        let mut around = (0..27).map(|at| [at % 3, at / 3 % 3, at / 9]);
        let is_solid = |offset: [usize; 3]| {
            let beside: [usize; 3] = std::array::from_fn(|axis| (index[axis] + offset[axis]).wrapping_sub(1));
            grid.is_solid(beside)
        };
        let surface = grid.is_solid(index) && !around.all(is_solid);
        assert_eq!(grid.is_surface(index), surface, "{index:?}");
    }
    assert_eq!(grid.count_solid(), indices(grid.size()).filter(|&index| grid.is_solid(index)).count());
}

#[test]
fn queries_find_what_a_search_over_all_voxels_finds() {
    let mut random = Random(7);
    for fill in [0.0, 0.001, 0.02, 0.3, 0.9, 1.0] {
        let mut grid = random_grid(&mut random, fill);
        let mut carver = Carver::default();
        for round in 0..3 {
            is_right(&grid);
            let edges = grid.edges();
            for _ in 0..12 {
                let point = random.point(&edges, 1.6);
                let most = 0.02 * random.part();
                let expected = nearest(&grid, &point, |index| grid.is_solid(index));
                let found = grid.nearest_solid(&point, f64::INFINITY);
                let is_same = |found: Option<Near>| match (found, expected) {
                    (Some(found), Some((index, distance))) => {
                        (found.distance - distance).abs() < 1e-15
                            && (found.index == index || is_tie(&grid, &point, &found, distance))
                    }
                    (None, None) => true,
                    _ => false,
                };
                assert!(is_same(found), "{found:?}, expected {expected:?}");
                let guess =
                    Some([random.word() as usize % 32, random.word() as usize % 27, random.word() as usize % 30]);
                assert!(is_same(grid.nearest_solid_near(&point, f64::INFINITY, guess)));
                let near = grid.nearest_solid(&point, most).map(|near| near.index);
                assert_eq!(near.is_some(), expected.is_some_and(|(_, distance)| distance <= most));
                let free = grid.nearest_free(&point, f64::INFINITY).map(|near| near.distance);
                let expected = nearest(&grid, &point, |index| !grid.is_solid(index)).map(|(_, distance)| distance);
                assert_eq!(free.is_some(), expected.is_some());
                assert!((free.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-15);
                for label in [1, 2] {
                    let of_label = |index| grid.voxel(index).is_some_and(|voxel| voxel.label == label);
                    let Some((_, distance)) = nearest(&grid, &point, of_label) else { continue };
                    let found = grid.distance(&point, Some(label), f64::INFINITY).expect("it is there").distance;
                    let half = 0.5 * grid.mean_edge();
                    let is_in = grid.index_at(&point).is_some_and(of_label);
                    assert!(is_in && found <= half || !is_in && (found - (distance - half)).abs() < 1e-15);
                }
                sweeps(&grid, &mut random, &point);
                rays(&grid, &mut random, &point);
            }
            for _ in 0..if round == 0 { 300 } else { 30 } {
                let at = random.point(&edges, 1.1);
                let stroke = Stroke {
                    from: Isometry3::from(at.coords),
                    to: Isometry3::from(random.point(&edges, 0.2).coords + at.coords),
                };
                let shape = Shape::Sphere { radius: 0.0002 + 0.0006 * random.part() };
                carver.carve(&mut grid, &shape, &stroke, Rule::Count(random.word() as usize % 9)).expect("a cut");
            }
        }
    }
}

fn is_tie(grid: &VoxelGrid, point: &Point3<f64>, found: &Near, distance: f64) -> bool {
    (square_to(grid, point, found.index).sqrt() - distance).abs() < 1e-15
}

fn sweeps(grid: &VoxelGrid, random: &mut Random, from: &Point3<f64>) {
    let to = random.point(&grid.edges(), 1.6);
    let reach = 0.0003 + 0.002 * random.part();
    let solid = || indices(grid.size()).filter(|&index| grid.is_solid(index)).map(|index| grid.center(index));
    let way = to - from;
    let meets = |center: Point3<f64>| {
        let offset = from - center;
        let (a, b, c) = (way.norm_squared(), offset.dot(&way), offset.norm_squared() - reach * reach);
        if c < 0.0 {
            return Some(0.0);
        }
        let root = b * b - a * c;
        (b < 0.0 && root >= 0.0).then(|| (-b - root.sqrt()) / a).filter(|part| *part <= 1.0)
    };
    let expected = solid().filter_map(meets).reduce(f64::min);
    let found = grid.sweep(from, &to, reach).map(|touch| touch.part);
    assert_eq!(found.is_some(), expected.is_some(), "{found:?} {expected:?}");
    assert!((found.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-9, "{found:?} {expected:?}");
    // A capsule is as many balls as one likes: their first touch is not earlier, and hardly later.
    let half = random.direction() * 0.002;
    let balls = |at: i32| meets_from(from + half * (f64::from(at) / 20.0), way, reach, solid());
    let expected = (-20..=20).filter_map(balls).reduce(f64::min);
    let found = grid.sweep_capsule(from, &to, &half, reach).map(|touch| touch.part);
    if let Some(expected) = expected {
        let found = found.expect("balls of it touch");
        assert!(found <= expected + 1e-9, "{found} {expected}");
    }
    if let (Some(found), Some(expected)) = (found, expected) {
        // Between two of the balls, by less than the gap between them needs.
        assert!((expected - found) * way.norm() < 0.0003, "{found} {expected}");
    }
}

fn meets_from(
    from: Point3<f64>,
    way: Vector3<f64>,
    reach: f64,
    solid: impl Iterator<Item = Point3<f64>>,
) -> Option<f64> {
    let meets = |center: Point3<f64>| {
        let offset = from - center;
        let (a, b, c) = (way.norm_squared(), offset.dot(&way), offset.norm_squared() - reach * reach);
        let root = b * b - a * c;
        if c < 0.0 {
            return Some(0.0);
        }
        (b < 0.0 && root >= 0.0).then(|| (-b - root.sqrt()) / a).filter(|part| *part <= 1.0)
    };
    solid.filter_map(meets).reduce(f64::min)
}

fn rays(grid: &VoxelGrid, random: &mut Random, from: &Point3<f64>) {
    let direction = random.direction();
    // Where the ray is in the cell of a solid voxel, from and to.
    let meets = |index: [usize; 3]| {
        let (mut enter, mut leave) = (0.0_f64, 0.05_f64);
        for axis in 0..3 {
            let low = grid.center(index)[axis] - 0.5 * grid.spacing()[axis];
            let (a, b) =
                ((low - from[axis]) / direction[axis], (low + grid.spacing()[axis] - from[axis]) / direction[axis]);
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        (enter < leave - 1e-12).then_some(enter)
    };
    let expected = indices(grid.size()).filter(|&index| grid.is_solid(index)).filter_map(meets).reduce(f64::min);
    let found = grid.ray(from, &direction, 0.05).map(|hit| hit.distance);
    assert_eq!(found.is_some(), expected.is_some(), "{found:?} {expected:?}");
    assert!((found.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-12);
}

#[test]
fn contact_with_a_ball_is_as_far_as_its_rule_says() {
    let grid = ball(0.0);
    assert_eq!(grid.count_solid(), 463_400);
    let h = 0.25e-3;
    let mut random = Random(3);
    for (r, least, most, mean, turn) in [(2e-3, 0.05, 0.69, 0.52, 25.0), (0.5e-3, -0.04, 0.69, 0.41, 50.0)] {
        let (mut sum, mut count, mut largest) = (0.0, 0.0, 0.0_f64);
        for _ in 0..2000 {
            let direction = random.direction();
            let touch =
                grid.sweep(&Point3::from(direction * 0.018), &Point3::origin(), r + grid.ball()).expect("it is met");
            let off = (touch.center.coords.norm() - (0.012 + r)) / h;
            assert!(off > least - 0.1 && off < most + 0.06, "{off}");
            largest = largest.max(touch.normal.angle(&direction).to_degrees());
            (sum, count) = (sum + off, count + 1.0);
        }
        println!("r = {r}: mean {} voxels, normals within {largest} degrees", sum / count);
        assert!(largest < turn, "{largest}");
        assert!((sum / count - mean).abs() < 0.04, "r = {r}: mean {}", sum / count);
    }
    // The default: the interpolated surface. Densities of 8 bits make steps of 4 µm in the layer, slopes of some degrees.
    for (layer, by, turn) in [(0.0, 0.5, 45.0), (4.0 * h, 0.07, 8.0)] {
        let grid = ball(layer);
        let mut largest = (0.0_f64, 0.0_f64);
        for _ in 0..2000 {
            let direction = random.direction();
            let point = Point3::from(direction * (0.012 + 2e-3));
            let (distance, normal, _) = grid.interpolated_distance(&point, 0.01, None).expect("it is near");
            let off = (distance - 2e-3).abs() / h;
            largest = (largest.0.max(off), largest.1.max(normal.angle(&direction).to_degrees()));
        }
        println!("layer {layer}: within {} voxels and {} degrees", largest.0, largest.1);
        assert!(largest.0 <= by && largest.1 < turn, "{largest:?} with a layer of {layer}");
    }
}

fn block(h: f64, size: [usize; 3]) -> VoxelGrid {
    VoxelGrid::from_fn(size, Vector3::from_fn(|axis, _| size[axis] as f64 * h), 0.5, label(), |_| FULL).expect("a grid")
}

fn straight(from: Point3<f64>, to: Point3<f64>) -> Stroke {
    Stroke { from: Isometry3::from(from.coords), to: Isometry3::from(to.coords) }
}

#[test]
fn a_straight_pass_removes_the_same_voxels_in_any_number_of_strokes() {
    let (h, r) = (0.2e-3, 2e-3);
    let mut all: Vec<Vec<[u32; 3]>> = Vec::new();
    for strokes in [1, 10, 1000] {
        let mut grid = block(h, [140, 60, 60]);
        let mut carver = Carver::default();
        let at = |stroke: usize| Point3::new(-0.01 + 0.02 * stroke as f64 / strokes as f64, 0.0, 0.0);
        let mut removed = Vec::new();
        let mut volume = 0.0;
        for stroke in 0..strokes {
            let stroke = straight(at(stroke), at(stroke + 1));
            let carved = carver.carve(&mut grid, &Shape::Sphere { radius: r }, &stroke, Rule::All).expect("a cut");
            removed.extend_from_slice(&carved.indices);
            volume += carved.volume;
        }
        let count = removed.len() as f64;
        assert!((volume - count * h * h * h).abs() < 1e-15);
        assert!((volume * 1e9 - 284.8).abs() < 2.848, "{volume}");
        removed.sort_unstable();
        let within = indices([140, 60, 60]).filter(|&index| {
            let center = grid.center(index);
            let along = center.x.clamp(-0.01, 0.01);
            (center - Point3::new(along, 0.0, 0.0)).norm() <= r
        });
        let mut expected: Vec<_> = within.map(|index| index.map(|i| i as u32)).collect();
        expected.sort_unstable();
        assert!(removed == expected, "{} {}", removed.len(), expected.len());
        assert_eq!(140 * 60 * 60 - grid.count_solid(), removed.len());
        all.push(removed);
    }
    assert!(all[0] == all[1] && all[1] == all[2]);
    println!("{} voxels", all[0].len());
    // With a budget they are some of these, the nearest to the way first.
    let mut grid = block(h, [140, 60, 60]);
    let rule = Rule::Rate { rate: 30e-9, interval: 1.0 };
    let stroke = straight(Point3::new(-0.01, 0.0, 0.0), Point3::new(0.01, 0.0, 0.0));
    let mut carver = Carver::default();
    let carved = carver.carve(&mut grid, &Shape::Sphere { radius: r }, &stroke, rule).expect("a cut");
    assert!((carved.volume - 30e-9).abs() < 1e-11);
    assert!(carved.indices.iter().all(|index| all[0].binary_search(index).is_ok()));
}

#[test]
fn the_rate_depends_on_neither_voxels_nor_ticks_and_prefers_no_side() {
    for h in [0.1e-3, 0.2e-3, 0.3e-3] {
        for frequency in [200.0, 1000.0, 2000.0] {
            let edge = (0.008 / h) as usize;
            let mut grid = block(h, [edge; 3]);
            let mut carver = Carver::default();
            let mut volume = 0.0;
            let mut octants = [0_usize; 8];
            let seconds = 0.3;
            let middle = straight(Point3::origin(), Point3::origin());
            for _ in 0..(seconds * frequency) as usize {
                let rule = Rule::Rate { rate: 30e-9, interval: 1.0 / frequency };
                let shape = Shape::Sphere { radius: 1.5e-3 };
                let carved = carver.carve(&mut grid, &shape, &middle, rule).expect("a cut");
                volume += carved.volume;
                for index in &carved.indices {
                    let side = |axis: usize| usize::from(2 * index[axis] as usize >= edge) << axis;
                    octants[side(0) | side(1) | side(2)] += 1;
                }
            }
            let rate = volume / seconds * 1e9;
            assert!((rate - 30.0).abs() < 0.3, "{rate} mm³/s at h = {h}, {frequency} Hz");
            // Where the centre is between voxels. Of the last shell of equal distances those of low indices are gone.
            let (most, least) = (octants.iter().max().unwrap(), octants.iter().min().unwrap());
            let is_even = edge.is_multiple_of(2);
            assert!(!is_even || (most - least) as f64 <= 0.03 * *most as f64 + 6.0, "{octants:?}");
        }
    }
}

#[test]
fn hard_voxels_take_longer() {
    let edges = Vector3::repeat(0.008);
    let hard = Voxel { density: 255, label: 2 };
    let mut grid = VoxelGrid::from_fn([80; 3], edges, 0.5, label(), |_| hard).expect("a grid");
    let rule = Rule::Rate { rate: 30e-9, interval: 0.1 };
    let stroke = straight(Point3::origin(), Point3::origin());
    let mut carver = Carver::default();
    let volume = carver.carve(&mut grid, &Shape::Sphere { radius: 3e-3 }, &stroke, rule).expect("a cut").volume;
    assert!((volume - 1e-9).abs() < 2e-12, "{volume}");
}

#[test]
fn boxes_and_capsules_cut_what_they_cover() {
    let h = 0.2e-3;
    let mut carver = Carver::default();
    let pose = Isometry3::new(Vector3::new(0.001, -0.0005, 0.0003), Vector3::new(0.3, 0.5, -0.2));
    let half = Vector3::new(0.003, 0.002, 0.001);
    let shapes = [
        (Shape::Box { half_edges: half }, 8.0 * half.product()),
        (
            Shape::Capsule { radius: 0.0015, half_length: 0.002 },
            std::f64::consts::PI * 0.0015_f64.powi(2) * (0.004 + 4.0 / 3.0 * 0.0015),
        ),
    ];
    for (shape, volume) in shapes {
        let mut grid = block(h, [60; 3]);
        let carved = carver.carve(&mut grid, &shape, &Stroke { from: pose, to: pose }, Rule::All).expect("a cut");
        assert!((carved.volume / volume - 1.0).abs() < 0.02, "{} {volume}", carved.volume);
        is_right(&grid);
    }
    // A box that is pushed along its x axis leaves a longer box.
    let mut grid = block(h, [60; 3]);
    let to = pose * Isometry3::translation(0.002, 0.0, 0.0);
    let shape = Shape::Box { half_edges: half };
    let carved = carver.carve(&mut grid, &shape, &Stroke { from: pose, to }, Rule::All).expect("a cut");
    let volume = 8.0 * 0.004 * 0.002 * 0.001;
    assert!((carved.volume / volume - 1.0).abs() < 0.02, "{}", carved.volume);
}

#[test]
fn unusable_cuts_are_refused_and_change_nothing() {
    let mut grid = block(1e-3, [8; 3]);
    let before = grid.clone();
    let mut carver = Carver::default();
    let here = straight(Point3::origin(), Point3::origin());
    let nowhere = straight(Point3::origin(), Point3::new(f64::NAN, 0.0, 0.0));
    for (shape, stroke, rule) in [
        (Shape::Sphere { radius: f64::NAN }, here, Rule::All),
        (Shape::Sphere { radius: -1.0 }, here, Rule::All),
        (Shape::Sphere { radius: 1.0 }, nowhere, Rule::All),
        (Shape::Sphere { radius: 1.0 }, here, Rule::Rate { rate: f64::INFINITY, interval: 1.0 }),
        (
            Shape::Box { half_edges: Vector3::repeat(1.0) },
            straight(Point3::origin(), Point3::new(1e9, 0.0, 0.0)),
            Rule::All,
        ),
    ] {
        carver.carve(&mut grid, &shape, &stroke, rule).expect_err("it is unusable");
    }
    let outside = Shape::Voxels(vec![[-1, 0, 0], [8, 0, 0], [i64::MAX, i64::MIN, 0]]);
    assert!(carver.carve(&mut grid, &outside, &here, Rule::All).expect("nothing is there").indices.is_empty());
    assert_eq!(grid, before);
    // A way from far away is no way through all voxels of the world.
    let far = straight(Point3::new(1e12, 0.0, 0.0), Point3::new(-1e12, 0.0, 0.0));
    carver.carve(&mut grid, &Shape::Sphere { radius: 1e-3 }, &far, Rule::All).expect("a cut");
    assert!(grid != before);
}

#[test]
fn copies_share_and_a_copy_of_before_is_the_first_state() {
    let first = ball(0.0);
    let memory = first.memory();
    let mut grid = first.clone();
    let mut carver = Carver::default();
    let mut random = Random(11);
    let mut removed = 0;
    while removed < 100_000 {
        let at = random.point(&first.edges(), 0.7);
        let stroke = straight(at, at + random.direction() * 1e-3);
        removed +=
            carver.carve(&mut grid, &Shape::Sphere { radius: 1e-3 }, &stroke, Rule::All).expect("a cut").indices.len();
    }
    assert!(grid != first && first == ball(0.0));
    is_right(&grid);
    assert_eq!(grid.count_solid() + removed, 463_400);
    // What changed is told brick by brick.
    let changed = grid.changed_bricks(&first);
    assert!(!changed.is_empty() && changed.len() < 16 * 16 * 16);
    for index in indices([128; 3]).filter(|&index| grid.voxel(index) != first.voxel(index)) {
        assert!(changed.contains(&index.map(|i| i / 8 * 8)));
    }
    grid = first.clone();
    assert!(grid == first && grid.memory() == memory);
}

#[test]
fn the_surface_of_a_ball_is_closed_and_has_its_volume() {
    for grid in [ball(0.0), ball(1e-3)] {
        let mesh = grid.mesh();
        let volume = 4.0 / 3.0 * std::f64::consts::PI * 0.012_f64.powi(3);
        assert!((mesh.volume() / volume - 1.0).abs() < 0.01, "{} {volume}", mesh.volume());
        is_closed(&mesh.triangles);
        let places = indices([16; 3]).map(|brick| grid.brick_mesh(brick).triangles.len());
        assert_eq!(places.sum::<usize>(), mesh.triangles.len());
        for vertex in mesh.vertices.iter().step_by(7) {
            assert!((vertex.coords.norm() - 0.012).abs() < 0.3e-3);
        }
    }
    // What reaches the walls of the box is closed there.
    let mut random = Random(5);
    let rough = random_grid(&mut random, 0.5);
    let mesh = rough.mesh();
    is_closed(&mesh.triangles);
    assert!(mesh.volume() > 0.0);
}

#[test]
fn patches_are_the_surface_brick_by_brick_with_what_touches_it() {
    let mut random = Random(11);
    for grid in [ball(0.0), ball(1e-3), random_grid(&mut random, 0.5), random_grid(&mut random, 0.05)] {
        let mesh = grid.mesh();
        let key = |points: [[f64; 3]; 3]| points.map(|point| point.map(f64::to_bits));
        let whole: std::collections::HashMap<_, usize> =
            mesh.triangles.iter().fold(Default::default(), |mut all, t| {
                *all.entry(key(t.map(|v| mesh.vertices[v as usize].coords.into()))).or_insert(0) += 1;
                all
            });
        let around = |patch: &Patch, triangles: &[[u32; 3]], v: u32| {
            triangles
                .iter()
                .filter(|t| t.iter().any(|&w| patch.vertices[w as usize] == patch.vertices[v as usize]))
                .count()
        };
        let of_mesh = mesh.triangles.iter().flatten().fold(std::collections::HashMap::new(), |mut all, &v| {
            let at: [f64; 3] = mesh.vertices[v as usize].coords.into();
            *all.entry(at.map(f64::to_bits)).or_insert(0) += 1;
            all
        });
        let high = grid.size().map(|edge| edge.div_ceil(8) - 1);
        let (mut from, mut patch, mut own) = ([0; 3], Patch::default(), std::collections::HashMap::new());
        let mut checked = 0;
        while let Some(brick) = grid.next_surface_brick([0; 3], high, from) {
            grid.patch(brick, &mut patch);
            assert_eq!(patch.own, grid.brick_mesh(brick).triangles.len());
            for t in &patch.triangles[..patch.own] {
                *own.entry(key(t.map(|v| patch.vertices[v as usize]))).or_insert(0_usize) += 1;
            }
            for &v in patch.triangles[..patch.own].iter().flatten().step_by(17) {
                let at = patch.vertices[v as usize].map(f64::to_bits);
                assert_eq!(around(&patch, &patch.triangles, v), of_mesh[&at], "{brick:?}");
                checked += 1;
            }
            from = [brick[0] + 1, brick[1], brick[2]];
        }
        assert!(own == whole && checked > 50, "{} {} {checked}", own.len(), whole.len());
    }
}

#[test]
fn flat_patches_become_rectangles_of_the_same_plane_and_side() {
    // A block whose faces are a voxel inside the box, but for the one at the low end of x.
    let edges = Vector3::new(0.04, 0.048, 0.056);
    let grid = VoxelGrid::from_fn([40, 48, 56], edges, 0.5, label(), |index| {
        let inside = index[0] < 39 && (1..47).contains(&index[1]) && (1..55).contains(&index[2]);
        if inside {
            FULL
        } else {
            Voxel::default()
        }
    })
    .expect("a grid");
    let high = grid.size().map(|edge| edge.div_ceil(8) - 1);
    let area = |patch: &Patch| {
        let sum = |sum: Vector3<f64>, t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| Vector3::from(patch.vertices[v as usize]));
            sum + (b - a).cross(&(c - a)) / 2.0
        };
        patch.triangles[..patch.own].iter().fold(Vector3::zeros(), sum)
    };
    let (mut from, mut patch, mut merged) = ([0; 3], Patch::default(), 0);
    while let Some(brick) = grid.next_surface_brick([0; 3], high, from) {
        grid.patch(brick, &mut patch);
        let before = patch.clone();
        patch.merge_flat();
        assert!((area(&patch) - area(&before)).norm() < 1e-15, "{brick:?}");
        if patch.own < before.own {
            merged += 1;
            let axis = (0..3).find(|&k| before.vertices.iter().all(|v| (v[k] - before.vertices[0][k]).abs() < 1e-12));
            let axis = axis.expect("it is flat");
            assert!(
                patch.own == 2 && patch.vertices.iter().all(|v| (v[axis] - before.vertices[0][axis]).abs() < 1e-12)
            );
            for t in &before.triangles[..before.own] {
                for vertex in t.map(|v| before.vertices[v as usize]) {
                    let within = |k: usize| {
                        patch.vertices[0][k] - 1e-12 <= vertex[k] && vertex[k] <= patch.vertices[2][k] + 1e-12
                    };
                    assert!((0..3).all(within), "{brick:?}");
                }
            }
        }
        from = [brick[0] + 1, brick[1], brick[2]];
    }
    // All bricks of the faces that have no edge of the block in or beside them.
    assert_eq!(merged, 2 * (3 * 4 + 3 * 5 + 4 * 5));
}

fn is_closed(triangles: &[[u32; 3]]) {
    let mut edges = std::collections::HashMap::new();
    for &[a, b, c] in triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((from.min(to), from.max(to))).or_insert(0) += if from < to { 1 } else { -1 };
        }
    }
    assert!(!triangles.is_empty() && edges.values().all(|&sum| sum == 0), "each edge is used in both directions");
}

#[test]
fn force_on_a_flat_face_is_constant_and_ends_with_the_contact() {
    let h = 0.192e-3;
    let grid = block(h, [96, 96, 32]);
    let top = 0.5 * grid.edges().z;
    let law = Law { stiffness: 700.0, most: 10.0, ..Law::default() };
    for surface in [Surface::Interpolated, Surface::Balls] {
        let mut proxy = Proxy::new(3e-3);
        let reach = 3e-3 + if surface == Surface::Balls { grid.ball() - 0.5 * h } else { 0.0 };
        let goal_at = |x: f64, depth: f64| Point3::new(x, 0.3e-3, top + reach - depth);
        proxy.update(&grid, surface, &law, &goal_at(-5e-3, -1e-3));
        let (mut forces, mut last) = (Vec::new(), None);
        // 10 mm/s at 1 kHz.
        for tick in 0..1000 {
            let goal = goal_at(-5e-3 + 1e-5 * f64::from(tick), 0.5e-3);
            proxy.update(&grid, surface, &law, &goal);
            let force = proxy.force(&law, &goal, &Vector3::zeros());
            if let Some(last) = last {
                let step: Vector3<f64> = force - last;
                assert!(step.norm() < 11e-3, "{surface:?}: {step:?} at {tick}");
            }
            last = Some(force);
            forces.push(force.z);
        }
        let mean = forces.iter().sum::<f64>() / forces.len() as f64;
        let ripple = forces.iter().fold(0.0_f64, |most, force| most.max((force - mean).abs()));
        println!("{surface:?}: mean {mean} N, ripple {ripple} N");
        assert!((mean - 0.35).abs() < 0.0175, "{surface:?}: {mean}");
        assert!(ripple < 2.2e-3, "{surface:?}: {ripple}");
        let away = goal_at(-5e-3 + 1e-5 * 999.0, -1e-6 - 0.1e-3);
        proxy.update(&grid, surface, &law, &away);
        assert_eq!(proxy.force(&law, &away, &Vector3::zeros()), Vector3::zeros());
        assert!((proxy.position.unwrap() - away).norm() < 1e-9);
    }
}

#[test]
fn a_circle_in_contact_gives_no_energy_and_a_restored_volume_no_jump() {
    let grid = ball(1e-3);
    let law = Law { most: 3.3, ..Law::default() };
    let mut proxy = Proxy::new(1.5e-3);
    let goal_at = |angle: f64| Point3::new(0.006 * angle.cos(), 0.006 * angle.sin(), 0.0115 + 1.5e-3 - 3e-3);
    let above = Point3::new(0.006, 0.0, 0.02);
    proxy.update(&grid, Surface::Interpolated, &law, &above);
    let ticks = 2000;
    let (mut work, mut peak) = (0.0, 0.0_f64);
    let mut last = goal_at(0.0);
    proxy.update(&grid, Surface::Interpolated, &law, &last);
    for tick in 1..=2 * ticks {
        let goal = goal_at(std::f64::consts::TAU * f64::from(tick) / f64::from(ticks));
        let before = proxy.force(&law, &last, &Vector3::zeros());
        proxy.update(&grid, Surface::Interpolated, &law, &goal);
        let force = proxy.force(&law, &goal, &Vector3::zeros());
        if tick > ticks {
            work += 0.5 * (force + before).dot(&(goal - last));
            peak = peak.max(0.5 * law.stiffness * (proxy.position.unwrap() - goal).norm_squared());
        }
        last = goal;
    }
    println!("work of a closed path {work:e} J, spring {peak:e} J");
    // Nothing is given to the hand; what roughness takes, as the ball drops into the next hollow, is little.
    assert!(work < 0.01 * peak && work > -0.2 * peak, "{work} {peak}");
    // A goal 5 mm inside, around which the volume is restored.
    for surface in [Surface::Interpolated, Surface::Balls] {
        let mut proxy = Proxy::new(1.5e-3);
        let inside = Point3::new(0.0, 0.0, 0.007);
        proxy.position = Some(inside);
        let mut last = 0.0;
        for _ in 0..200 {
            let at = proxy.update(&grid, surface, &law, &inside);
            let force = proxy.force(&law, &inside, &Vector3::zeros()).norm();
            assert!(force <= law.most * (1.0 + 1e-12) && force - last <= law.most / 20.0, "{last} {force}");
            assert!(at.coords.norm() > 0.012 + 1.5e-3 - 0.5e-3, "{}", at.coords.norm());
            last = force;
        }
        assert!((last - 3.3).abs() < 1e-9);
    }
}

#[test]
fn a_corner_holds_the_ball_in_two_planes_and_friction_holds_it_back() {
    // A step: a wall on the side x < 0 stands 3 mm above the floor.
    let h = 0.2e-3;
    let grid = VoxelGrid::from_fn([80, 60, 60], Vector3::new(0.016, 0.012, 0.012), 0.5, label(), |[i, _, k]| {
        if k < 20 || i < 30 {
            FULL
        } else {
            Voxel::default()
        }
    })
    .expect("a grid");
    let floor = -0.006 + 20.0 * h;
    let wall = -0.008 + 30.0 * h;
    let law = Law { most: 100.0, ..Law::default() };
    for surface in [Surface::Interpolated, Surface::Balls] {
        let mut proxy = Proxy::new(1e-3);
        let away = if surface == Surface::Balls { grid.ball() - 0.5 * h } else { 0.0 };
        proxy.update(&grid, surface, &law, &Point3::new(0.003, 0.0, 0.004));
        let goal = Point3::new(wall - 0.001, 0.0005, floor - 0.001);
        let mut at = Point3::origin();
        for _ in 0..8 {
            at = proxy.update(&grid, surface, &law, &goal);
        }
        let expected = Point3::new(wall + 1e-3 + away, 0.0005, floor + 1e-3 + away);
        // Along the edge balls rest in the hollows between voxels.
        let off = at - expected;
        let is_near = off.x.abs().max(off.z.abs()) < 0.1 * h && off.y.abs() < h;
        assert!(is_near, "{surface:?}: {at}, expected {expected}");
        // Friction: within the cone nothing slides, beyond it the rest does.
        let rough = Law { friction: 0.5, ..law };
        let mut proxy = Proxy::new(1e-3);
        let start = Point3::new(0.002, 0.0, floor + 1e-3 + away + 1e-6);
        proxy.update(&grid, surface, &rough, &start);
        let held = proxy.update(&grid, surface, &rough, &(start + Vector3::new(0.0004, 0.0, -0.001)));
        assert!((held - start).norm() < 20e-6, "{surface:?}: {}", (held - start).norm());
        let slid = proxy.update(&grid, surface, &rough, &(start + Vector3::new(0.0014, 0.0, -0.001)));
        let expected = 0.0014 - 0.5 * 0.001;
        let hollow = if surface == Surface::Balls { h } else { 30e-6 };
        assert!((slid.x - start.x - expected).abs() < hollow, "{surface:?}: {}", slid.x - start.x);
    }
}
