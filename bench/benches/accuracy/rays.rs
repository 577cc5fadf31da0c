//! Rays against convex shapes of the size of an instrument's tip and of furniture.

use std::time::Instant;

use ambf_core::bullet::{Ray, RigidBody, Shape, Solver, World};
use nalgebra::{Isometry3, Vector3};

use super::report::Section;
use super::statistics::{percentile, short};

/// Half extents of the box, and radius of the sphere, in units of the size.
const HALF: [f64; 3] = [1.0, 0.6, 0.3];

/// Where a ray enters a sphere about the origin, m from its start.
fn enter_sphere(start: Vector3<f64>, direction: Vector3<f64>, radius: f64) -> Option<f64> {
    let (along, outside) = (start.dot(&direction), start.norm_squared() - radius * radius);
    let discriminant = along * along - outside;
    (outside > 0.0 && along < 0.0 && discriminant > 0.0).then(|| -along - discriminant.sqrt())
}

/// The same of a box.
fn enter_box(start: Vector3<f64>, direction: Vector3<f64>, half: [f64; 3]) -> Option<f64> {
    let (mut enters, mut leaves) = (f64::MIN, f64::MAX);
    for k in 0..3 {
        let ways = [-half[k], half[k]].map(|side| (side - start[k]) / direction[k]);
        enters = ways[0].min(ways[1]).max(enters);
        leaves = ways[0].max(ways[1]).min(leaves);
    }
    (enters > 0.0 && enters < leaves).then_some(enters)
}

/// Points in the cube from -1/2 to 1/2 in six dimensions, without structure: multiples of irrational numbers.
fn point(i: u32) -> [f64; 6] {
    [2.0, 3.0, 5.0, 7.0, 11.0, 13.0_f64].map(|k| (f64::from(i) * k.sqrt()).fract() - 0.5)
}

/// Errors of the rays that Bullet casts, which is what `legacy` does, and of those of `accurate`.
pub fn measure(quick: bool) -> Section {
    let count = if quick { 5_000 } else { 50_000 };
    let mut rows = Vec::new();
    for shape in ["sphere", "box", "hull of 8 points"] {
        for size in [0.002, 0.02, 0.2] {
            let half = HALF.map(|half| half * size);
            let mut row = vec![shape.into(), short(1e3 * size)];
            for exact in [false, true] {
                row.extend(cast(shape, half, count, exact));
            }
            rows.push(row);
        }
    }
    Section {
        title: "Rays of sensors, wheels and picking",
        intro: "Rays from all sides through and past a shape: radius or longest half extent, mm; for `legacy` (Bullet's rays) and for `accurate`: \
                share of the rays past it that hit; error of the distance where both the ray and the shape's equation say that it is hit, 99th \
                percentile and most, mm; µs a ray.",
        header: &[
            "shape", "mm", "false hits", "p99", "most", "µs", "accurate: false hits", "p99", "most", "µs",
        ],
        rows,
        remarks: Vec::new(),
    }
}

/// False hits, errors and cost of one kind of rays.
fn cast(shape: &str, half: [f64; 3], count: u32, exact: bool) -> [String; 4] {
    let made = match shape {
        "sphere" => Shape::sphere(half[0], 0.0),
        "box" => Shape::cuboid(half.into(), 0.05 * half[2]),
        _ => {
            let corner = |k: usize| [0, 1, 2].map(|axis| if k >> axis & 1 == 0 { -half[axis] } else { half[axis] });
            Shape::convex_hull(&(0..8).map(corner).collect::<Vec<_>>(), 0.0)
        }
    };
    let mut world = World::new(Solver::default());
    world.set_exact_rays(exact);
    world.add_body(RigidBody {
        mass: 0.0,
        inertia: Vector3::zeros(),
        shape: made,
        pose: Isometry3::identity(),
        friction: 0.0,
        rolling_friction: 0.0,
        restitution: 0.0,
        linear_damping: 0.0,
        angular_damping: 0.0,
        gravity: None,
    });
    world.step(0.001, 1, 0.001);
    let size = half[0];
    let (mut rays, mut expected) = (Vec::new(), Vec::new());
    for i in 1..=count {
        let [a, b, c, x, y, z] = point(i);
        let direction = Vector3::new(a, b, c).normalize();
        let start = Vector3::new(x, y, z) * 2.6 * size - 4.0 * size * direction;
        rays.push(Ray { from: start, to: start + 8.0 * size * direction });
        expected.push(match shape {
            "sphere" => enter_sphere(start, direction, size),
            _ => enter_box(start, direction, half),
        });
    }
    let mut hits = vec![None; rays.len()];
    let begin = Instant::now();
    world.cast_rays(&rays, &mut hits);
    let cost = begin.elapsed().as_secs_f64() * 1e6 / f64::from(count);
    let found = hits.iter().map(|hit| hit.map(|hit| 8.0 * size * hit.fraction));
    let (mut past, mut false_hits, mut errors) = (0, 0, Vec::new());
    for (found, expected) in found.zip(&expected) {
        match (found, expected) {
            (Some(found), Some(expected)) => errors.push(1e3 * (found - expected).abs()),
            (Some(_), None) => (past, false_hits) = (past + 1, false_hits + 1),
            (None, None) => past += 1,
            // A miss is an error of the whole shape.
            (None, Some(_)) => errors.push(2e3 * size),
        }
    }
    errors.sort_by(f64::total_cmp);
    let share = 100.0 * f64::from(false_hits) / f64::from(past);
    let [p99, most] = [0.99, 1.0].map(|share| format!("{:.1e}", percentile(&errors, share)));
    [format!("{share:.2} %"), p99, most, short(cost)]
}
