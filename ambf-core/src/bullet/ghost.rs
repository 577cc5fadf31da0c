use std::ptr::NonNull;

use bullet_sys as sys;
use nalgebra::Isometry3;
use slotmap::{Key, KeyData};

use super::contact::fill;
use super::{raw_pose, BodyHandle, GhostHandle, Shape, World};

pub(super) struct OwnedGhost {
    pub(super) raw: NonNull<sys::AmbGhost>,
    /// Kept alive for the ghost; freed after it.
    _shape: Shape,
}

impl World {
    /// Adds a volume that detects overlapping bodies without contact forces. Rays hit it.
    pub fn add_ghost(&mut self, shape: Shape, pose: &Isometry3<f64>) -> GhostHandle {
        let _arena = self.enter();
        self.structure += 1;
        // SAFETY: the shape is alive and stays so with the ghost; numbers are read before the call returns.
        let raw = unsafe { sys::amb_ghost_new(shape.raw(), raw_pose(pose).as_ptr()) };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        let handle = self.ghosts.insert(OwnedGhost { raw, _shape: shape });
        // SAFETY: ghost and world are alive; the world removes the ghost before it frees it.
        unsafe { sys::amb_world_add_ghost(self.raw.as_ptr(), raw.as_ptr(), handle.data().as_ffi()) }
        handle
    }

    /// Removes a ghost; false when it is not there.
    pub fn remove_ghost(&mut self, handle: GhostHandle) -> bool {
        let _arena = self.enter();
        let Some(ghost) = self.ghosts.remove(handle) else { return false };
        self.structure += 1;
        // SAFETY: the ghost is in this world, and no pointer to it is left after this.
        unsafe {
            sys::amb_world_remove_ghost(self.raw.as_ptr(), ghost.raw.as_ptr());
            sys::amb_ghost_free(ghost.raw.as_ptr());
        }
        true
    }

    /// Sets the pose of a ghost in the world. What it overlaps there is known after the next sub-step.
    pub fn set_ghost_pose(&mut self, handle: GhostHandle, pose: &Isometry3<f64>) {
        if let Some(ghost) = self.ghosts.get(handle) {
            // SAFETY: the ghost is alive; 12 doubles are read.
            unsafe { sys::amb_ghost_set_pose(ghost.raw.as_ptr(), raw_pose(pose).as_ptr()) }
        }
    }

    /// The ghost does not detect the body from now on. The test takes constant time, however many such pairs there are.
    pub fn ignore_ghost(&mut self, ghost: GhostHandle, body: BodyHandle) {
        let _arena = self.enter();
        if let (Some(ghost), Some(body)) = (self.ghosts.get(ghost), self.raw_body(body)) {
            // SAFETY: world, ghost and body are alive.
            unsafe { sys::amb_world_ignore_ghost(self.raw.as_ptr(), ghost.raw.as_ptr(), body) }
        }
    }

    /// Fills `bodies` with the bodies that overlapped a ghost in the last sub-step: one entry per contact point of
    /// negative distance, so that a body may be there several times. A body that has left the ghost may be reported for
    /// some more sub-steps. Empty for a stale handle. Soft bodies are not detected.
    pub fn ghost_overlaps(&self, handle: GhostHandle, bodies: &mut Vec<BodyHandle>) {
        bodies.clear();
        let Some(ghost) = self.ghosts.get(handle) else { return };
        let raw = &mut self.scratch.borrow_mut().overlaps;
        // SAFETY: world and ghost are alive.
        fill(raw, |out, capacity| unsafe {
            sys::amb_ghost_overlaps(self.raw.as_ptr(), ghost.raw.as_ptr(), out, capacity)
        });
        bodies.extend(raw.iter().map(|&raw| BodyHandle::from(KeyData::from_ffi(raw))));
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::super::tests::ball;
    use super::super::{Integrator, RigidBody, Solver};
    use super::*;

    fn box_ghost(world: &mut World) -> GhostHandle {
        world.add_ghost(Shape::cuboid(Vector3::repeat(0.5), 0.001), &Isometry3::identity())
    }

    fn overlapped(world: &World, ghost: GhostHandle) -> Vec<BodyHandle> {
        let mut bodies = Vec::new();
        world.ghost_overlaps(ghost, &mut bodies);
        bodies.dedup();
        bodies
    }

    #[test]
    fn a_ghost_senses_what_passes_through_it_and_does_not_touch_it() {
        let flight = |with_ghost: bool| {
            let mut world = World::new(Solver::default());
            let ghost = with_ghost.then(|| box_ghost(&mut world));
            let flying = world.add_body(ball(1.0, -1.0));
            world.set_velocity(flying, &Vector3::x(), &Vector3::zeros());
            let sensed: Vec<bool> = (0..2000)
                .map(|_| {
                    world.step(0.001, 1, 0.001);
                    ghost.is_some_and(|ghost| overlapped(&world, ghost) == [flying])
                })
                .collect();
            (world.pose(flying).unwrap(), sensed, world.contact_count())
        };
        let (pose, sensed, _) = flight(true);
        assert_eq!(pose, flight(false).0, "it touched nothing");
        // A ball of radius 0.1 at x = -1 + t: inside the box from t = 0.4 to 1.6.
        let first = sensed.iter().position(|&sensed| sensed).unwrap();
        let last = sensed.iter().rposition(|&sensed| sensed).unwrap();
        // Old contact points stay until Bullet removes the pair, some time after the bounding boxes have separated.
        assert!(first.abs_diff(400) < 5 && (1595..1900).contains(&last), "{first} {last}");
        assert!(sensed[first..=last].iter().all(|&sensed| sensed));
    }

    #[test]
    fn a_ghost_moves_and_ignores() {
        let mut world = World::new(Solver::default());
        let ghost = box_ghost(&mut world);
        let [near, far] = [0.0, 3.0].map(|x| world.add_body(ball(1.0, x)));
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.2, 0.0), ..ball(0.0, 0.0) });
        world.step(0.001, 1, 0.001);
        let mut sensed = overlapped(&world, ghost);
        sensed.sort_unstable();
        sensed.dedup();
        assert_eq!(sensed, [near, ground]);
        assert_eq!(world.contact_count(), 0, "contacts of ghosts do not count");
        world.ignore_ghost(ghost, ground);
        world.set_ghost_pose(ghost, &Isometry3::translation(3.0, 0.0, 0.0));
        world.step(0.001, 1, 0.001);
        assert_eq!(overlapped(&world, ghost), [far]);
        assert!(world.remove_body(far));
        assert!(overlapped(&world, ghost).is_empty());
        assert!(world.remove_ghost(ghost) && !world.remove_ghost(ghost));
        world.set_ghost_pose(ghost, &Isometry3::identity());
        assert!(overlapped(&world, ghost).is_empty(), "a stale handle");
        world.step(0.001, 1, 0.001);
    }

    #[test]
    fn exact_flight_goes_on_inside_a_ghost() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.set_integrator(Integrator::Ballistic);
        let ghost = box_ghost(&mut world);
        let falling = world.add_body(ball(1.0, 0.0));
        for _ in 0..200 {
            world.step(0.001, 1, 0.001);
        }
        assert_eq!(overlapped(&world, ghost), [falling]);
        assert!((world.pose(falling).unwrap().translation.z + 0.2).abs() < 1e-12);
    }
}
