use ambf_dynamics::ffi as engine;
use bullet_sys as sys;
use nalgebra::Vector3;
use slotmap::KeyData;

use super::{BodyHandle, SoftBodyHandle, World};

/// A ray from one point to another, m, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub from: Vector3<f64>,
    /// Where it ends.
    pub to: Vector3<f64>,
}

/// Type of the object that a ray hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RayTarget {
    /// A rigid body.
    Body(BodyHandle),
    /// A soft body.
    SoftBody(SoftBodyHandle),
    /// A ghost.
    Other,
}

/// The closest hit of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// The object that was hit.
    pub target: RayTarget,
    /// Share of the way from start to end, 0 to 1.
    pub fraction: f64,
    /// Where, m, world axes.
    pub point: Vector3<f64>,
    /// Normal of the surface there, of unit length, world axes; towards the start of the ray.
    pub normal: Vector3<f64>,
}

/// Rays handed over at once.
const PIECE: usize = 64;

impl World {
    /// Whether rays, those of vehicles' wheels included, meet convex shapes and planes where these are. Bullet's rays miss
    /// the surface of small shapes by as much as their size, and meet shapes that they should miss. Default: `false`.
    pub fn set_exact_rays(&mut self, exact: bool) {
        // SAFETY: the world is alive and was made with the engine.
        unsafe { engine::amb_world_set_exact_rays(self.raw.as_ptr(), exact.into()) }
    }

    /// Casts rays; `hits` gets the closest hit of each, in the same order, `None` for none, for a ray without length or
    /// with a coordinate that is not finite, and beyond the last ray.
    ///
    /// Bullet's default filter applies: rays hit all bodies and ghosts except visual-only bodies. A ray that starts
    /// inside a convex shape does not hit it. Objects whose pose was set since the last sub-step may be missed. Soft
    /// bodies are hit on their faces.
    pub fn cast_rays(&self, rays: &[Ray], hits: &mut [Option<RayHit>]) {
        let _arena = self.enter();
        hits.fill(None);
        // In pieces on the stack, so that nothing is allocated.
        for (rays, hits) in rays.chunks(PIECE).zip(hits.chunks_mut(PIECE)) {
            let mut raw_rays = [sys::AmbRay::default(); PIECE];
            let mut raw_hits = [sys::AmbRayHit::default(); PIECE];
            let n = rays.len().min(hits.len());
            for (raw, ray) in raw_rays.iter_mut().zip(rays) {
                *raw = sys::AmbRay { from: ray.from.into(), to: ray.to.into() };
            }
            // SAFETY: the world is alive; n is at most the length of both arrays.
            unsafe {
                sys::amb_world_cast_rays(self.raw.as_ptr(), raw_rays.as_ptr(), n as i32, raw_hits.as_mut_ptr());
            }
            for (hit, raw) in hits.iter_mut().zip(&raw_hits[..n]) {
                *hit = hit_of(raw);
            }
        }
    }
}

fn hit_of(raw: &sys::AmbRayHit) -> Option<RayHit> {
    let handle = KeyData::from_ffi(raw.handle);
    let target = match raw.target as sys::AmbTarget::Type {
        sys::AmbTarget::AmbTarget_None => return None,
        sys::AmbTarget::AmbTarget_Body => RayTarget::Body(handle.into()),
        sys::AmbTarget::AmbTarget_SoftBody => RayTarget::SoftBody(handle.into()),
        _ => RayTarget::Other,
    };
    Some(RayHit { target, fraction: raw.fraction, point: raw.point.into(), normal: raw.normal.into() })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3};

    use super::super::tests::ball;
    use super::super::{Axis, RigidBody, Shape, Solver};
    use super::*;

    fn ray(from: [f64; 3], to: [f64; 3]) -> Ray {
        Ray { from: from.into(), to: to.into() }
    }

    #[test]
    fn rays_meet_spheres_and_planes_where_they_are() {
        let mut world = World::new(Solver::default());
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -1.0, 0.0), ..ball(0.0, 0.0) });
        let sphere = world.add_body(ball(1.0, 2.0));
        world.step(0.001, 1, 0.001);
        let rays = [
            ray([0.0, 0.0, 0.0], [4.0, 0.0, 0.0]),
            ray([0.0, 0.0, 1.0], [0.0, 0.0, -3.0]),
            ray([0.0, 0.0, 0.0], [1.5, 0.0, 0.0]),
            ray([1.0, 0.5, 0.0], [3.0, -0.5, 0.0]),
        ];
        let mut hits = [None; 5];
        hits[4] =
            Some(RayHit { target: RayTarget::Other, fraction: 0.0, point: Vector3::zeros(), normal: Vector3::x() });
        world.cast_rays(&rays, &mut hits);
        let near = |hit: RayHit, target, fraction: f64, point: [f64; 3], normal: [f64; 3]| {
            assert_eq!(hit.target, target);
            assert!((hit.fraction - fraction).abs() < 1e-4, "{hit:?}");
            assert!((hit.point - Vector3::from(point)).norm() < 1e-3, "{hit:?}");
            assert!((hit.normal - Vector3::from(normal)).norm() < 1e-2, "{hit:?}");
        };
        near(hits[0].unwrap(), RayTarget::Body(sphere), 1.9 / 4.0, [1.9, 0.0, 0.0], [-1.0, 0.0, 0.0]);
        near(hits[1].unwrap(), RayTarget::Body(ground), 0.5, [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]);
        assert_eq!(hits[2], None);
        // Through the centre of the sphere, along (2, -1).
        let (length, along) = (5.0_f64.sqrt(), Vector3::new(2.0, -1.0, 0.0) / 5.0_f64.sqrt());
        let point = Vector3::new(2.0, 0.0, 0.0) - 0.1 * along;
        near(hits[3].unwrap(), RayTarget::Body(sphere), (length / 2.0 - 0.1) / length, point.into(), (-along).into());
        assert_eq!(hits[4], None, "there was no fifth ray");
    }

    #[test]
    fn many_rays_keep_their_order() {
        let mut world = World::new(Solver::default());
        let spheres: Vec<_> = (0..150).map(|i| world.add_body(ball(0.0, f64::from(i)))).collect();
        world.step(0.001, 1, 0.001);
        let rays: Vec<_> = (0..150).map(|i| ray([i.into(), 0.0, 1.0], [i.into(), 0.0, -1.0])).collect();
        let mut hits = vec![None; 150];
        world.cast_rays(&rays, &mut hits);
        let targets: Vec<_> = hits.iter().map(|hit| hit.unwrap().target).collect();
        let expected: Vec<_> = spheres.into_iter().map(RayTarget::Body).collect();
        assert_eq!(targets, expected);
    }

    #[test]
    fn rays_that_are_none_hit_nothing() {
        let mut world = World::new(Solver::default());
        world.add_body(ball(0.0, 0.0));
        world.step(0.001, 1, 0.001);
        let start = [-1.0, 0.0, 0.0];
        let (nan, infinite) = (f64::NAN, f64::INFINITY);
        let rays = [
            ray(start, start),
            ray(start, [nan, 0.0, 0.0]),
            ray([0.0, nan, 0.0], start),
            ray(start, [infinite, 0.0, 0.0]),
            ray([f64::MIN, 0.0, 0.0], [f64::MAX, 0.0, 0.0]),
            ray(start, [1e-300, 0.0, 0.0]),
        ];
        let mut hits = [None; 6];
        world.cast_rays(&rays, &mut hits);
        assert_eq!(hits[..5], [None; 5]);
        assert!(hits[5].is_some(), "it ends in the sphere");
        let lost = world.bodies()[0];
        world.set_pose(lost, &Isometry3::translation(f64::NAN, 0.0, 0.0));
        world.cast_rays(&rays, &mut hits);
        assert_eq!(hits, [None; 6], "the sphere is nowhere");
    }

    #[test]
    fn ghosts_stop_rays_and_visual_only_bodies_do_not() {
        let mut world = World::new(Solver::default());
        let (visual, behind) = (world.add_body(ball(1.0, 1.0)), world.add_body(ball(1.0, 2.0)));
        let cast = |world: &World| {
            let mut hits = [None];
            world.cast_rays(&[ray([0.0; 3], [3.0, 0.0, 0.0])], &mut hits);
            hits[0].map(|hit| hit.target)
        };
        world.step(0.001, 1, 0.001);
        assert_eq!(cast(&world), Some(RayTarget::Body(visual)));
        assert!(world.make_visual_only(visual));
        world.step(0.001, 1, 0.001);
        assert_eq!(cast(&world), Some(RayTarget::Body(behind)));
        let ghost = world.add_ghost(Shape::sphere(0.1, 0.0), &Isometry3::translation(0.5, 0.0, 0.0));
        world.step(0.001, 1, 0.001);
        assert_eq!(cast(&world), Some(RayTarget::Other));
        assert!(world.remove_ghost(ghost) && world.remove_body(behind));
        assert_eq!(cast(&world), None);
    }

    /// Distance from the surface of a convex shape, m, by its type, half size `s`, m, and margin: below 0 within.
    fn distance(shape: &str, s: f64, margin: f64, p: Vector3<f64>) -> f64 {
        // Of a box with edges in any number of dimensions.
        let to_box = |q: &[f64]| {
            let outside = q.iter().map(|x| x.max(0.0).powi(2)).sum::<f64>().sqrt();
            outside + q.iter().copied().fold(f64::MIN, f64::max).min(0.0)
        };
        let across = p.xy().norm();
        match shape {
            "sphere" => p.norm() - s,
            "cuboid" => to_box(&[p.x.abs() - s, p.y.abs() - 0.6 * s, p.z.abs() - 0.3 * s]),
            "hull" => to_box(&[p.x.abs() - s, p.y.abs() - 0.6 * s, p.z.abs() - 0.3 * s]) - margin,
            "capsule" => across.hypot((p.z.abs() - s).max(0.0)) - 0.4 * s,
            "cylinder" => to_box(&[across - (0.5 * s - margin), p.z.abs() - (s - margin)]) - margin,
            _ => {
                // The corner, from the tip along the side to the edge of the base, and the base.
                let (tip, edge) = ([0.0, s], [0.5 * s, -s]);
                let (along, from) = ([edge[0] - tip[0], edge[1] - tip[1]], [across - tip[0], p.z - tip[1]]);
                let share = (along[0] * from[0] + along[1] * from[1]) / (along[0].powi(2) + along[1].powi(2));
                let share = share.clamp(0.0, 1.0);
                let side = (from[0] - share * along[0]).hypot(from[1] - share * along[1]);
                let base = (across - edge[0]).max(0.0).hypot(p.z + s);
                let within = p.z > -s && along[0] * from[1] - along[1] * from[0] < 0.0;
                if within {
                    -side.min(base) - margin
                } else {
                    side.min(base) - margin
                }
            }
        }
    }

    /// A shape for which [`distance`] holds where its axis, X, Y or Z by 0 to 2, is turned to z.
    fn shape_of(shape: &str, s: f64, margin: f64, axis: usize) -> Shape {
        let axis = [Axis::X, Axis::Y, Axis::Z][axis];
        match shape {
            "sphere" => Shape::sphere(s, 0.0),
            "cuboid" => Shape::cuboid(Vector3::new(s, 0.6 * s, 0.3 * s), margin),
            "capsule" => Shape::capsule(axis, 0.4 * s, 2.0 * s, 0.0),
            "cylinder" => Shape::cylinder(axis, 0.5 * s, 2.0 * s, margin),
            "hull" => {
                let corner = |k: u32| {
                    [(0, 1.0), (1, 0.6), (2, 0.3)]
                        .map(|(bit, half)| if k >> bit & 1 == 0 { -half * s } else { half * s })
                };
                Shape::convex_hull(&(0..8).map(corner).collect::<Vec<_>>(), margin)
            }
            _ => Shape::cone(axis, 0.5 * s, 2.0 * s, margin),
        }
    }

    /// Casts rays from all sides at a shape of half size `s`, m.
    fn check_rays(shape: &str, s: f64, axis: usize, in_compound: bool) {
        let margin = 0.05 * s;
        let pose = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(1.0, -2.0, 0.5));
        let mut made = shape_of(shape, s, margin, axis);
        if in_compound {
            let away = Isometry3::translation(40.0 * s, 0.0, 0.0);
            made = Shape::compound([(Shape::sphere(s, 0.0), away), (made, Isometry3::identity())]);
        }
        let mut world = World::new(Solver::default());
        world.set_exact_rays(true);
        world.add_body(RigidBody { shape: made, pose, ..ball(0.0, 0.0) });
        world.step(0.001, 1, 0.001);
        let turned = |p: Vector3<f64>| match axis {
            0 => Vector3::new(p.y, p.z, p.x),
            1 => Vector3::new(p.z, p.x, p.y),
            _ => p,
        };
        let distance = |p| distance(shape, s, margin, if matches!(shape, "cuboid" | "hull") { p } else { turned(p) });
        let is_exact = matches!(shape, "sphere" | "cuboid" | "capsule");
        let tolerance = if is_exact { 1e-12 * s + 1e-13 } else { 1e-6 * s };
        // Points in a cube without structure: multiples of irrational numbers.
        let coordinate =
            |i: i32, k: usize| (f64::from(i) * [2.0, 3.0, 5.0, 7.0, 11.0, 13.0_f64][k].sqrt()).fract() - 0.5;
        let mut met = 0;
        for i in 1..2000 {
            let direction = Vector3::from_fn(|k, _| coordinate(i, k)).normalize();
            let middle = Vector3::from_fn(|k, _| 2.6 * s * coordinate(i, k + 3));
            // Some begin within, some end before.
            let before = if i % 10 == 0 { 0.2 } else { 4.0 } * s;
            let length = before + if i % 7 == 0 { 0.1 } else { 4.0 } * s;
            let start = middle - before * direction;
            let [from, to] = [0.0, length].map(|way| (pose * Point3::from(start + way * direction)).coords);
            let mut hits = [None];
            world.cast_rays(&[Ray { from, to }], &mut hits);
            let at = |way: f64| distance(start + way * direction);
            let along = |way: f64| (0..1000).map(move |k| at(way * f64::from(k) / 1000.0));
            let name = format!("{shape} of {s} m, axis {axis}, compound {in_compound}, ray {i}: {:?}", hits[0]);
            let Some(hit) = hits[0] else {
                assert!(at(0.0) <= tolerance || along(length).all(|distance| distance > -1e-3 * s), "{name}");
                continue;
            };
            met += 1;
            let way = hit.fraction * length;
            assert!(at(way).abs() <= tolerance, "{name}: {:e} m off", at(way));
            assert!(along(way).all(|distance| distance > -tolerance), "{name}: it was within before");
            assert!((hit.normal.norm() - 1.0).abs() < 1e-9 && hit.normal.dot(&(to - from)) <= 1e-3 * s, "{name}");
            let normal = pose.inverse_transform_vector(&hit.normal);
            let rise = distance(start + way * direction + 1e-3 * s * normal) - at(way);
            assert!((rise - 1e-3 * s).abs() < 2e-5 * s, "{name}: {rise:e} m along its normal");
        }
        assert!(met > 200, "{shape} of {s} m: {met} hits");
    }

    #[test]
    fn exact_rays_meet_shapes_of_any_size_where_they_are() {
        for shape in ["sphere", "cuboid", "capsule", "cylinder", "hull", "cone"] {
            for (k, s) in [5e-4, 0.02, 1.0, 300.0].into_iter().enumerate() {
                check_rays(shape, s, k % 3, false);
                check_rays(shape, s, k % 3, true);
            }
        }
    }

    #[test]
    fn exact_rays_meet_planes_from_both_sides_and_the_nearest_of_all_bodies() {
        let mut world = World::new(Solver::default());
        world.set_exact_rays(true);
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -1.0, 0.0), ..ball(0.0, 0.0) });
        let spheres = [2.0, 1.0, 3.0].map(|x| world.add_body(ball(1.0, x)));
        world.step(0.001, 1, 0.001);
        let rays = [
            ray([0.0, 0.0, 0.0], [4.0, 0.0, 0.0]),
            ray([0.3, 0.0, 1.0], [0.3, 0.0, -3.0]),
            ray([0.3, 0.0, -2.0], [0.3, 0.0, 0.0]),
            ray([0.0, 0.0, 5.0], [1.0, 0.0, 5.0]),
        ];
        let mut hits = [None; 4];
        world.cast_rays(&rays, &mut hits);
        let hit = |target, fraction, point: [f64; 3], normal: Vector3<f64>| {
            Some(RayHit { target: RayTarget::Body(target), fraction, point: point.into(), normal })
        };
        assert_eq!(hits[0].unwrap().target, RayTarget::Body(spheres[1]));
        assert!((hits[0].unwrap().point.x - 0.9).abs() < 1e-15);
        assert_eq!(hits[1], hit(ground, 0.5, [0.3, 0.0, -1.0], Vector3::z()));
        assert_eq!(hits[2], hit(ground, 0.5, [0.3, 0.0, -1.0], -Vector3::z()));
        assert_eq!(hits[3], None);
    }
}
