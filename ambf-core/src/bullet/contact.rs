use bullet_sys as sys;
use nalgebra::Vector3;
use slotmap::KeyData;

use super::{BodyHandle, World};

/// A contact point between two bodies, which may have a positive distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The other body.
    pub other: BodyHandle,
    /// Point on the surface of the queried body, m, world axes.
    pub point: Vector3<f64>,
    /// Unit normal, world axes, from the other body to this one.
    pub normal: Vector3<f64>,
    /// Signed distance, m; negative: penetration depth.
    pub distance: f64,
    /// Normal impulse in the last sub-step, N·s, not negative.
    pub impulse: f64,
}

impl World {
    /// Fills `contacts` with the contact points of `body` with other bodies at a distance of at most `threshold` m, as
    /// of the last sub-step. Bullet keeps points up to about 0.02 m apart. Empty for a stale handle. Soft bodies and
    /// ghosts do not count.
    ///
    /// Takes time proportional to the number of contact manifolds in the world.
    pub fn contacts(&self, body: BodyHandle, threshold: f64, contacts: &mut Vec<Contact>) {
        contacts.clear();
        let Some(body) = self.raw_body(body) else { return };
        let raw = &mut self.scratch.borrow_mut().contacts;
        // SAFETY: world and body are alive.
        fill(raw, |out, capacity| unsafe { sys::amb_body_contacts(self.raw.as_ptr(), body, threshold, out, capacity) });
        contacts.extend(raw.iter().map(|raw| Contact {
            other: KeyData::from_ffi(raw.other).into(),
            point: raw.point.into(),
            normal: raw.normal.into(),
            distance: raw.distance,
            impulse: raw.impulse,
        }));
    }
}

/// Fills `out` with all results of `write`, which is called with a buffer and its capacity and returns the number of
/// all results.
pub(super) fn fill<T: Default + Clone>(out: &mut Vec<T>, write: impl Fn(*mut T, i32) -> i32) {
    out.resize(out.capacity(), T::default());
    let capacity = i32::try_from(out.len()).unwrap_or(i32::MAX);
    let count = write(out.as_mut_ptr(), capacity).max(0) as usize;
    let all_fit = count <= out.len();
    out.resize(count, T::default());
    if !all_fit {
        write(out.as_mut_ptr(), count as i32);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::super::tests::ball;
    use super::super::{RigidBody, Shape, Solver};
    use super::*;

    #[test]
    fn a_resting_ball_presses_with_its_weight() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) });
        let resting = world.add_body(ball(2.0, 0.0));
        for _ in 0..500 {
            world.step(0.001, 1, 0.001);
        }
        let mut found = Vec::new();
        world.contacts(resting, 0.001, &mut found);
        let [contact] = found[..] else { panic!("one point instead of {found:?}") };
        assert_eq!(contact.other, ground);
        assert!((contact.normal - Vector3::z()).norm() < 1e-9, "{contact:?}");
        assert!((contact.point - Vector3::new(0.0, 0.0, -0.1)).norm() < 1e-3, "{contact:?}");
        assert!(contact.distance.abs() < 1e-3, "{contact:?}");
        assert!((contact.impulse - 2.0 * 10.0 * 0.001).abs() < 1e-5, "m g dt, not {}", contact.impulse);

        world.contacts(ground, 0.001, &mut found);
        assert_eq!((found.len(), found[0].other), (1, resting));
        assert!((found[0].normal + Vector3::z()).norm() < 1e-9, "{found:?}");
        world.contacts(ground, -1.0, &mut found);
        assert!(found.is_empty(), "nothing is 1 m deep");

        assert!(world.remove_body(ground));
        world.contacts(ground, 0.001, &mut found);
        assert!(found.is_empty(), "a stale handle");
        world.contacts(resting, 0.001, &mut found);
        assert!(found.is_empty(), "what it lay on is gone");
    }

    #[test]
    fn more_contacts_than_the_first_try_has_place_for() {
        let mut world = World::new(Solver::default());
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) });
        for i in 0..50 {
            world.add_body(RigidBody { pose: Isometry3::translation(f64::from(i), 0.0, 0.0), ..ball(1.0, 0.0) });
        }
        world.step(0.001, 1, 0.001);
        let mut found = Vec::new();
        world.contacts(ground, 0.001, &mut found);
        assert_eq!(found.len(), 50);
        let mut others: Vec<_> = found.iter().map(|contact| contact.other).collect();
        others.sort_unstable();
        others.dedup();
        assert_eq!(others.len(), 50);
    }
}
