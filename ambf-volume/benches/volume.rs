//! What a volume of the size of a scanned temporal bone costs: 512 × 512 × 505 voxels of 0.096 mm, about a fifth of its
//! bricks mixed. Loading, memory, ticks of a drill with a tip and seven cursors along its shaft, cuts; and, beside them,
//! the look-ups that the finger proxy of the C++ program's library does for the tip alone in each search.
//!
//! `cargo bench -p ambf-volume` runs it; `-- --quick` uses 128³ voxels. The voxels are made here: layers of colours that
//! wind through each other, no one's anatomy.

use std::hint::black_box;
use std::time::{Duration, Instant};

use ambf_model::adf::ImageStack;
use ambf_volume::proxy::{Law, Proxy, Surface};
use ambf_volume::{save, stack, Carver, Label, Rule, Shape, Stroke, Voxel, VoxelGrid};
use nalgebra::{Isometry3, Point3, Vector3};

/// Edge of a voxel, m.
const EDGE: f64 = 0.096e-3;

/// Radii of the cursors, m, and the distance between them: those of the C++ drilling plugin with a 6 mm burr.
const RADII: [f64; 8] = [3e-3, 0.65e-3, 0.75e-3, 0.85e-3, 0.95e-3, 1.05e-3, 1.15e-3, 1.25e-3];
const BETWEEN: f64 = 1.5e-3;

fn main() {
    let quick = std::env::args().any(|argument| argument == "--quick");
    let size = if quick { [128; 3] } else { [512, 512, 505] };
    let edges = Vector3::from_fn(|axis, _| size[axis] as f64 * EDGE);
    println!("{} x {} x {} voxels of {} mm, {} threads", size[0], size[1], size[2], EDGE * 1e3, threads());
    let made = phantom(size, edges);
    let folder = tempfile::tempdir().expect("a folder");
    save::pictures(&made, folder.path(), "slice0").expect("pictures");
    drop(made);
    let images = ImageStack { path: folder.path().into(), prefix: "slice0".into(), format: "png".into(), count: 1000 };
    let begin = Instant::now();
    let grid = stack::read(&images, edges, 0.5, &|_, _| {}).expect("a volume");
    println!("load                       {:8.2} s", begin.elapsed().as_secs_f64());
    println!("memory                     {:8.1} MB", grid.memory() as f64 / 1e6);
    println!(
        "solid                      {:8.1} %",
        100.0 * grid.count_solid() as f64 / size.iter().product::<usize>() as f64
    );
    drill(&grid, if quick { 2000 } else { 60_000 });
    cuts(&grid);
    look_ups(&grid);
}

fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// A body of bone with cavities of several colours in it.
fn phantom(size: [usize; 3], edges: Vector3<f64>) -> VoxelGrid {
    let labels = [[255, 249, 219], [110, 184, 209], [200, 60, 40], [240, 220, 60]].map(Label::of_color).to_vec();
    let scale = 12.0 / size[0] as f64;
    let voxel = |[i, j, k]: [usize; 3]| {
        let [x, y, z] = [i, j, k].map(|index| index as f64 * scale);
        let from_middle = Vector3::new(x - 6.0, y - 6.0, z - 6.0).norm();
        let winding =
            (2.3 * x).sin() * (2.1 * y).cos() + (2.2 * y).sin() * (2.4 * z).cos() + (2.0 * z).sin() * (2.5 * x).cos();
        match (from_middle < 5.6, winding) {
            (false, _) => Voxel::default(),
            (_, w) if w > 0.35 => Voxel::default(),
            (_, w) if w > -0.6 => Voxel { density: 255, label: 1 },
            (_, w) if w > -0.9 => Voxel { density: 255, label: 2 },
            (_, w) if w > -1.3 => Voxel { density: 255, label: 3 },
            _ => Voxel { density: 255, label: 4 },
        }
    };
    VoxelGrid::from_fn(size, edges, 0.5, labels, voxel).expect("a grid")
}

fn percentiles(what: &str, mut times: Vec<Duration>) {
    times.sort_unstable();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e6;
    println!("{what:26} {:8.1} µs median, {:.1} at 99 %, {:.1} at most", at(0.5), at(0.99), at(1.0));
}

/// A tick of a drill along a spiral into the volume: eight proxies, the force, and a cut at 30 mm³/s.
fn drill(grid: &VoxelGrid, ticks: u32) {
    let half = 0.5 * grid.edges();
    // Tools touch the interpolated surface; the other one is for comparison.
    for (surface, ticks) in [(Surface::Interpolated, ticks), (Surface::Balls, ticks / 20)] {
        let mut grid = grid.clone();
        let mut proxies = RADII.map(Proxy::new);
        let mut carver = Carver::with_room(1 << 14);
        let law = Law::default();
        let (mut touch, mut cut, mut all) = (Vec::new(), Vec::new(), Vec::new());
        let (mut removed, mut in_contact) = (0, 0);
        for tick in 0..ticks {
            let part = f64::from(tick) / f64::from(ticks);
            let angle = 40.0 * part;
            let radius = 0.3 * half.x * (1.0 - 0.5 * part);
            let tip = Point3::new(half.x * (1.02 - 0.9 * part), radius * angle.cos(), radius * angle.sin());
            let begin = Instant::now();
            let mut force = Vector3::zeros();
            for (place, proxy) in proxies.iter_mut().enumerate() {
                let goal = tip + Vector3::x() * (BETWEEN * place as f64);
                proxy.update(&grid, surface, &law, &goal);
                force += proxy.force(&law, &goal, &Vector3::zeros());
            }
            black_box(force);
            let touched = begin.elapsed();
            if let (Some(center), Some(_)) = (proxies[0].position, proxies[0].touched) {
                let here = Isometry3::from(center.coords);
                let shape = Shape::Sphere { radius: RADII[0] + 0.9 * EDGE };
                let rule = Rule::Rate { rate: 30e-9, interval: 1e-3 };
                let stroke = Stroke { from: here, to: here };
                removed += carver.carve(&mut grid, &shape, &stroke, rule).expect("a cut").indices.len();
                in_contact += 1;
                cut.push(begin.elapsed() - touched);
            }
            touch.push(touched);
            all.push(begin.elapsed());
        }
        println!("{surface:?}: {ticks} ticks, {in_contact} in contact, {removed} voxels removed");
        percentiles("  tip and seven cursors", touch);
        if !cut.is_empty() {
            percentiles("  cut at 30 mm³/s", cut);
        }
        percentiles("  whole tick", all);
    }
}

/// Cuts of 500 voxels, each at a place that no cut has touched, of a grid that shares all with another.
fn cuts(grid: &VoxelGrid) {
    let mut carver = Carver::with_room(1 << 14);
    let mut times = Vec::new();
    let mut now = grid.clone();
    let radius = (500.0 * 0.75 / std::f64::consts::PI).cbrt() * EDGE;
    for at in 0..400 {
        let place = [37, 53, 71].map(|step| (at * step + 11) % 200 - 100);
        let here =
            Isometry3::from(Vector3::from_fn(|axis, _| 0.4 * grid.edges()[axis] * f64::from(place[axis]) / 100.0));
        let begin = Instant::now();
        let carved = carver.carve(&mut now, &Shape::Sphere { radius }, &Stroke { from: here, to: here }, Rule::All);
        if carved.expect("a cut").indices.len() > 450 {
            times.push(begin.elapsed());
        }
    }
    percentiles("cut of 500 voxels", times);
}

/// What a search of the C++ program's finger proxy does for the tip in contact: all voxels of a box around it, twice in
/// a tick, each tested by its distance.
fn look_ups(grid: &VoxelGrid) {
    let reach = (RADII[0] / EDGE).ceil() as i64 + 1;
    let size = grid.size();
    let middle = size.map(|edge| edge as i64 / 2);
    let mut times = Vec::new();
    for _ in 0..20 {
        let begin = Instant::now();
        let mut near = 0_u32;
        for k in -reach..=reach {
            for j in -reach..=reach {
                for i in -reach..=reach {
                    let index = [i, j, k].map(|offset| offset);
                    let at: [i64; 3] = std::array::from_fn(|axis| middle[axis] + index[axis]);
                    let inside = (0..3).all(|axis| (0..size[axis] as i64).contains(&at[axis]));
                    let square: i64 = index.iter().map(|offset| offset * offset).sum();
                    let is_near = (square as f64).sqrt() * EDGE < RADII[0] + 0.9 * EDGE;
                    if inside && grid.is_solid(at.map(|index| index as usize)) && is_near {
                        near += 1;
                    }
                }
            }
        }
        black_box(near);
        times.push(begin.elapsed());
    }
    println!("({} look-ups)", (2 * reach + 1).pow(3));
    percentiles("C++ search, tip alone", times);
}
