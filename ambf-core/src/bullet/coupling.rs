//! Couplings: the coordinate of a joint is a linear function of those of others.

use std::ptr::NonNull;

use ambf_dynamics::ffi as sys;

use super::constraint::Motor;
use super::{ConstraintHandle, World};

#[derive(Clone)]
pub(super) struct OwnedCoupling {
    raw: NonNull<sys::AmbCoupling>,
    /// The follower, then its leaders.
    joints: Vec<ConstraintHandle>,
}

impl OwnedCoupling {
    fn follower(&self) -> ConstraintHandle {
        self.joints[0]
    }
}

impl World {
    /// Couples a hinge or slider, the follower, to others, its leaders: its coordinate is the sum of theirs, each times the
    /// ratio beside it, plus `offset`; rad and m. It holds from the next sub-step on: where all joints are of one
    /// [articulation](Self::articulate) that is made later, in its equations of motion and exactly; elsewhere as a row of the
    /// constraint solver. Leaders turn as often as they like; poses that are set count with the turns that close the coupling
    /// best, of those the fewest. Articulations of which one of the joints is are dissolved until the next restart.
    ///
    /// False, and nothing is changed, when a handle is stale or of another type, when there is no leader, a number is not
    /// finite, or the joint is one of its own leaders; when it is a follower already, or leads one.
    pub fn couple(&mut self, follower: ConstraintHandle, leaders: &[(ConstraintHandle, f64)], offset: f64) -> bool {
        let joints: Vec<_> = std::iter::once(follower).chain(leaders.iter().map(|&(joint, _)| joint)).collect();
        let is_driven = |joint: &ConstraintHandle| {
            self.constraints.get(*joint).is_some_and(|constraint| constraint.motor != Motor::None)
        };
        let is_finite = offset.is_finite() && leaders.iter().all(|(_, ratio)| ratio.is_finite());
        let is_taken = self.couplings.iter().any(|coupling| coupling.joints.contains(&follower));
        let leads_itself = joints[1..].contains(&follower);
        if leaders.is_empty() || !joints.iter().all(is_driven) || !is_finite || is_taken || leads_itself {
            return false;
        }
        let _arena = self.enter();
        for joint in &joints {
            if let Some(articulation) = self.constraints[*joint].articulation {
                self.dissolve_until_restart(articulation);
            }
        }
        let raw: Vec<_> = joints.iter().map(|&joint| self.constraints[joint].raw.as_ptr()).collect();
        let ratios: Vec<f64> = std::iter::once(1.0).chain(leaders.iter().map(|&(_, ratio)| ratio)).collect();
        // SAFETY: the world and the joints are alive and no joints of an articulation; as many pointers and numbers are read.
        let raw = unsafe {
            sys::amb_world_couple(self.raw.as_ptr(), raw.as_ptr(), ratios.as_ptr(), raw.len() as i32, offset)
        };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        self.couplings.push(OwnedCoupling { raw, joints });
        true
    }

    /// By how much the coordinate of a follower exceeds what its leaders ask for, rad or m. `None` when it follows nothing.
    pub fn coupling_error(&self, follower: ConstraintHandle) -> Option<f64> {
        let _arena = self.enter();
        let coupling = self.couplings.iter().find(|coupling| coupling.follower() == follower)?;
        // SAFETY: the coupling and its joints are alive.
        Some(unsafe { sys::amb_coupling_error(coupling.raw.as_ptr()) })
    }

    /// Frees the couplings of a joint, which is of no articulation.
    pub(super) fn uncouple(&mut self, joint: ConstraintHandle) {
        let world = self.raw;
        self.couplings.retain(|coupling| {
            let goes = coupling.joints.contains(&joint);
            if goes {
                // SAFETY: world, coupling and joints are alive; no pointer to the coupling is left after this.
                unsafe { sys::amb_world_uncouple(world.as_ptr(), coupling.raw.as_ptr()) }
            }
            !goes
        });
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::super::tests::{ball, hinge};
    use super::super::{BodyHandle, Constraint, ConstraintKind, RigidBody, Solver, WorldKind};
    use super::*;

    const HINGE: ConstraintKind = ConstraintKind::Hinge { limits: None };
    const SLIDER: ConstraintKind = ConstraintKind::Slider { limits: None };

    /// Bodies of 1 kg and 3 kg on joints of their own, 1 m apart.
    fn pair(world: &mut World, kinds: [ConstraintKind; 2]) -> [(ConstraintHandle, BodyHandle); 2] {
        let base = world.add_body(ball(0.0, 0.0));
        let mut places = [(1.0, 1.0), (3.0, 2.0)].into_iter().zip(kinds);
        std::array::from_fn(|_| {
            let ((mass, y), kind) = places.next().expect("two");
            let pose = Isometry3::translation(0.0, y, 0.0);
            let body = world.add_body(RigidBody { pose, ..ball(mass, 0.0) });
            let joint = Constraint { kind, frame_a: pose, frame_b: Isometry3::identity(), ..hinge() };
            (world.add_constraint(base, body, &joint).expect("two bodies"), body)
        })
    }

    fn reads(world: &World, joint: ConstraintHandle) -> (f64, f64) {
        world.coordinate(joint).expect("a hinge or slider")
    }

    #[test]
    fn every_solver_moves_both_masses() {
        for (name, solver) in Solver::NAMES {
            for kind in [WorldKind::Rigid, WorldKind::Articulated] {
                let mut world = World::with_room(solver, kind, World::MANIFOLDS);
                let [(leader, pushed), (follower, _)] = pair(&mut world, [SLIDER, SLIDER]);
                assert!(world.couple(follower, &[(leader, -2.0)], 0.0));
                if kind == WorldKind::Articulated {
                    assert!(world.articulate(&[leader, follower]).is_some());
                }
                for _ in 0..100 {
                    world.apply_wrench(pushed, &(Vector3::x() * 13.0), &Vector3::zeros());
                    world.step(0.001, 1, 0.001);
                }
                // 1 kg and, through the ratio, 4 times 3 kg.
                let (way, rate) = reads(&world, leader);
                assert!((rate - 0.1).abs() < 2e-3, "{name}, {kind:?}: {rate} m/s");
                let apart = reads(&world, follower).0 + 2.0 * way;
                assert!(apart.abs() < 1e-6, "{name}, {kind:?}: {apart} m apart");
            }
        }
    }

    #[test]
    fn a_screw_counts_its_turns_and_so_does_a_saved_state() {
        for kind in [WorldKind::Rigid, WorldKind::Articulated] {
            let mut world = World::savable(Solver::Accurate, kind).expect("address space");
            let [(leader, turned), (follower, moved)] = pair(&mut world, [HINGE, SLIDER]);
            world.set_pose(moved, &Isometry3::translation(0.5, 2.0, 0.0));
            assert!(world.couple(follower, &[(leader, 0.01)], 0.5));
            if kind == WorldKind::Articulated {
                assert!(world.articulate(&[leader, follower]).is_some());
            }
            world.set_velocity(turned, &Vector3::zeros(), &(Vector3::z() * 40.0));
            world.set_velocity(moved, &(Vector3::x() * 0.4), &Vector3::zeros());
            for _ in 0..500 {
                world.step(0.001, 1, 0.001);
            }
            let way = reads(&world, follower).0;
            assert!((way - 0.7).abs() < 0.01, "{kind:?}: {way} m after 20 rad");
            let error = world.coupling_error(follower).expect("it follows");
            assert!(error.abs() < 1e-9, "{kind:?}: {error} m");
            let saved = world.save().expect("savable");
            let go_on = |world: &mut World| {
                (0..100).for_each(|_| _ = world.step(0.001, 1, 0.001));
                (reads(world, leader), reads(world, follower))
            };
            let expected = go_on(&mut world);
            // Poses that are set: the turns follow from the slider.
            let angle = 0.3;
            let goal = 0.5 + 0.01 * (angle - 4.0 * std::f64::consts::TAU);
            world.set_pose(turned, &Isometry3::new(Vector3::y(), Vector3::z() * angle));
            world.set_pose(moved, &Isometry3::translation(goal, 2.0, 0.0));
            for body in [turned, moved] {
                world.set_velocity(body, &Vector3::zeros(), &Vector3::zeros());
            }
            world.step(0.001, 1, 0.001);
            let way = reads(&world, follower).0;
            assert!((way - goal).abs() < 1e-6, "{kind:?}: {way} m");
            world.restore(&saved).expect("of this world");
            assert_eq!(go_on(&mut world), expected, "{kind:?}");
        }
    }

    #[test]
    fn what_cannot_be_coupled_is_refused_and_joints_that_go_take_couplings_along() {
        let mut world = World::with_articulations(Solver::Accurate);
        let [(a, _), (b, body)] = pair(&mut world, [HINGE, HINGE]);
        let fixed =
            world.add_constraint(body, world.bodies()[0], &Constraint { kind: ConstraintKind::Fixed, ..hinge() });
        let fixed = fixed.expect("two bodies");
        assert!(
            !world.couple(a, &[], 0.0) && !world.couple(a, &[(a, 1.0)], 0.0) && !world.couple(a, &[(fixed, 1.0)], 0.0)
        );
        assert!(!world.couple(a, &[(b, f64::NAN)], 0.0) && !world.couple(a, &[(b, 1.0)], f64::INFINITY));
        assert!(world.remove_constraint(fixed));
        assert!(!world.couple(a, &[(fixed, 1.0)], 0.0), "it is gone");
        assert!(world.couple(b, &[(a, 1.0)], 0.0));
        assert!(!world.couple(b, &[(a, 1.0)], 0.0), "it follows already");
        assert!(!world.couple(a, &[(b, 1.0)], 0.0), "it leads");
        assert!(world.articulate(&[a, b]).is_some());
        assert!(world.remove_constraint(a));
        assert_eq!(world.coupling_error(b), None);
        world.step(0.001, 1, 0.001);
    }
}
