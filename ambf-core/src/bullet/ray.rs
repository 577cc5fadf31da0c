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
    use nalgebra::Isometry3;

    use super::super::tests::ball;
    use super::super::{RigidBody, Shape, Solver};
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
}
