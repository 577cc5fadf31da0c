//! Saving and restoring a world.

use std::fmt;
use std::mem::size_of_val;

use bullet_sys as sys;
use slotmap::SlotMap;
use thiserror::Error;

use super::articulation::OwnedArticulation;
use super::constraint::OwnedConstraint;
use super::coupling::OwnedCoupling;
use super::{ArticulationHandle, ConstraintHandle, Integrator, World};

/// Why a state was not saved or not restored; nothing has changed then.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum StateError {
    /// Error when the scene was not loaded with [`SceneOptions::savable`](crate::scene::SceneOptions::savable), or the
    /// world was not made by [`World::savable`].
    #[error("the scene was not loaded for saving: set `savable` in its options")]
    NotSavable,
    /// Error when the process may not have the address space that the scene needs by now.
    #[error("the scene has outgrown the address space that the process may have: raise its limit (`ulimit -v`)")]
    TooLarge,
    /// Error when the state was saved in another simulation, be it of the same files.
    #[error("the state was saved in another simulation: load it there, or save one here")]
    OtherSimulation,
    /// Error when models or objects were added or removed since the state was saved.
    #[error("models were added or removed since the state was saved: save a new one")]
    Changed,
}

/// The state of a [`World`]: a copy of everything that changes while it runs.
#[derive(Clone)]
pub struct SavedWorld {
    /// Identifies the world by its arena.
    arena: u64,
    structure: u64,
    /// Copy of the arena with all objects of the shim, the engine and Bullet.
    bytes: Box<[u8]>,
    integrator: Integrator,
    articulations: SlotMap<ArticulationHandle, OwnedArticulation>,
    constraints: SlotMap<ConstraintHandle, OwnedConstraint>,
    couplings: Vec<OwnedCoupling>,
    constraint_list: Vec<*mut sys::AmbConstraint>,
    constraint_order: Vec<ConstraintHandle>,
    readings: Vec<u8>,
    free_indices: Vec<usize>,
    /// For each body, the number of constraints and vehicles on it, and the articulation of which it is a link.
    body_constraints: Vec<(usize, Option<ArticulationHandle>)>,
}

// SAFETY: its pointers are only followed by the world that they belong to, after they were put back there.
unsafe impl Send for SavedWorld {}
// SAFETY: as above; nothing of it changes.
unsafe impl Sync for SavedWorld {}

impl fmt::Debug for SavedWorld {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SavedWorld").field("size", &self.size()).finish_non_exhaustive()
    }
}

impl SavedWorld {
    /// The copy of the arena.
    #[cfg(test)]
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Its memory, bytes.
    pub fn size(&self) -> usize {
        self.bytes.len()
            + size_of_val(self.body_constraints.as_slice())
            + self.constraints.capacity() * size_of::<OwnedConstraint>()
    }
}

impl World {
    /// Whether the state can be saved: the world was made by [`savable`](Self::savable).
    pub fn is_savable(&self) -> bool {
        self.arena.is_some()
    }

    /// Saves everything on which the further motion of the world depends. The world does not change.
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::TooLarge`].
    pub fn save(&self) -> Result<SavedWorld, StateError> {
        let arena = self.arena.as_ref().ok_or(StateError::NotSavable)?;
        if arena.has_overflowed() {
            return Err(StateError::TooLarge);
        }
        // All fields are named, so that a new field must be either saved or listed here with the reason why not.
        let Self {
            arena: _,
            // Owned objects, which are the same as long as `structure` is.
            raw: _,
            bodies,
            ghosts: _,
            vehicles: _,
            soft_bodies: _,
            volumes: _,
            body_list: _,
            body_order: _,
            structure,
            trees: _,
            // Set when the world is made.
            solver: _,
            has_soft_bodies: _,
            has_articulations: _,
            // Temporary memory without meaning between calls.
            scratch: _,
            integrator,
            articulations,
            constraints,
            couplings,
            constraint_list,
            constraint_order,
            readings,
            free_indices,
        } = self;
        Ok(SavedWorld {
            arena: arena.id(),
            structure: *structure,
            bytes: arena.copy(),
            integrator: *integrator,
            articulations: articulations.clone(),
            constraints: constraints.clone(),
            couplings: couplings.clone(),
            constraint_list: constraint_list.clone(),
            constraint_order: constraint_order.clone(),
            readings: readings.clone(),
            free_indices: free_indices.clone(),
            body_constraints: bodies.values().map(|body| (body.constraint_count, body.articulation)).collect(),
        })
    }

    /// Whether a state can be restored.
    ///
    /// # Errors
    /// The errors of [`restore`](Self::restore).
    pub fn check_saved(&self, saved: &SavedWorld) -> Result<(), StateError> {
        let arena = self.arena.as_ref().ok_or(StateError::NotSavable)?;
        match () {
            () if saved.arena != arena.id() => Err(StateError::OtherSimulation),
            () if saved.structure != self.structure => Err(StateError::Changed),
            () if arena.has_overflowed() => Err(StateError::TooLarge),
            () => Ok(()),
        }
    }

    /// Restores a saved state. With the same calls the world then repeats its motion bit for bit. Handles of
    /// constraints and articulations that were made since the state was saved are stale.
    ///
    /// # Errors
    /// [`StateError::NotSavable`], [`StateError::OtherSimulation`], [`StateError::Changed`] when bodies, soft bodies,
    /// ghosts or vehicles came or went since, [`StateError::TooLarge`]. Nothing has changed then.
    pub fn restore(&mut self, saved: &SavedWorld) -> Result<(), StateError> {
        self.check_saved(saved)?;
        let Some(arena) = &self.arena else { return Err(StateError::NotSavable) };
        // SAFETY: the copy was made of this arena, and since then no objects but constraints and articulations were
        // made or freed. Those are completely in the arena, so that after the copy exactly the same ones are alive as
        // then, and the lists below have exactly these.
        unsafe {
            sys::amb_world_restore(self.raw.as_ptr(), arena.as_ptr(), saved.bytes.as_ptr(), saved.bytes.len() as u64);
        }
        self.integrator = saved.integrator;
        self.articulations.clone_from(&saved.articulations);
        self.constraints.clone_from(&saved.constraints);
        self.couplings.clone_from(&saved.couplings);
        self.constraint_list.clone_from(&saved.constraint_list);
        self.constraint_order.clone_from(&saved.constraint_order);
        self.readings.clone_from(&saved.readings);
        self.free_indices.clone_from(&saved.free_indices);
        for (body, &(held, articulation)) in self.bodies.values_mut().zip(&saved.body_constraints) {
            (body.constraint_count, body.articulation) = (held, articulation);
        }
        Ok(())
    }
}

#[cfg(test)]
impl World {
    /// The 64-bit words in the memory of the world itself, and of each of its bodies, constraints, soft bodies and ghosts:
    /// numbers, counters and pointers, without what pointers lead to.
    pub(crate) fn words(&self) -> Vec<(String, Vec<u64>)> {
        let arena = self.arena.as_ref().expect("savable");
        let bytes = arena.copy();
        let half = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
        let word = |at: usize| u64::from(half(at)) | u64::from(half(at + 4)) << 32;
        // See arena.cpp: before an object stand its size class, its offset and, with the lowest bit set, the address of the
        // arena. The world is the first object.
        let is_header = |&at: &usize| word(at + 8) == arena.as_ptr() as u64 | 1;
        let first = (0..bytes.len()).step_by(16).find(is_header).expect("the world");
        let base = self.raw.as_ptr() as usize - (first + 16);
        let read = |name: String, address: usize| {
            let at = address - base;
            let class = half(at - 16) as usize;
            let size = if class < 8 { 16 * (class + 1) } else { ((class - 8) % 4 + 5) << (5 + (class - 8) / 4) };
            (name, (at..at + size - 16).step_by(8).map(word).collect())
        };
        let live = |list: &[usize], what: &str| {
            let named = list.iter().enumerate().filter(|(_, address)| **address != 0);
            named.map(|(index, &address)| read(format!("{what} {index}"), address)).collect::<Vec<_>>()
        };
        let addresses = [
            ("world", vec![self.raw.as_ptr() as usize]),
            ("body", self.body_list.iter().map(|body| *body as usize).collect()),
            ("constraint", self.constraint_list.iter().map(|constraint| *constraint as usize).collect()),
            ("soft body", self.soft_bodies.values().map(|soft| soft.raw.as_ptr() as usize).collect()),
            ("ghost", self.ghosts.values().map(|ghost| ghost.raw.as_ptr() as usize).collect()),
        ];
        addresses.iter().flat_map(|(what, list)| live(list, what)).collect()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::super::tests::{ball, hinge};
    use super::super::{RigidBody, Shape, Solver, WorldKind};
    use super::*;

    fn falling(mut world: World, bodies: u32) -> World {
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.11, 0.0), ..ball(0.0, 0.0) });
        for i in 0..bodies {
            world.add_body(ball(1.0, 0.19 * f64::from(i)));
        }
        world
    }

    fn heights(world: &mut World, steps: u32) -> Vec<f64> {
        for _ in 0..steps {
            world.step(0.001, 1, 0.001);
        }
        world.bodies().iter().filter_map(|&body| Some(world.pose(body)?.translation.z)).collect()
    }

    #[test]
    fn a_world_that_has_outgrown_its_room_goes_on_and_says_so() {
        let small = World::savable_within(1, Solver::Accurate, WorldKind::Rigid).expect("address space");
        let small = falling(small, 10);
        let saved = small.save().expect("room for ten");
        let mut small = falling(small, 1000);
        assert_eq!(small.save().err(), Some(StateError::TooLarge));
        assert_eq!(small.restore(&saved), Err(StateError::Changed));
        let mut plain = falling(falling(World::new(Solver::Accurate), 10), 1000);
        assert_eq!(heights(&mut small, 20), heights(&mut plain, 20));
    }

    #[test]
    fn constraints_that_came_and_went_are_stale_or_alive_again() {
        for kind in [WorldKind::Rigid, WorldKind::Soft, WorldKind::Articulated] {
            let mut world = World::savable(Solver::Accurate, kind).expect("address space");
            let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(1.0, 1.0)));
            world.set_gravity(Vector3::new(0.0, -10.0, 0.0));
            let joint = world.add_constraint(a, b, &hinge()).expect("two bodies");
            let articulation = world.articulate(&[joint]);
            assert_eq!(articulation.is_some(), kind == WorldKind::Articulated);
            heights(&mut world, 20);
            let with = world.save().expect("savable");
            heights(&mut world, 200);
            let expected = world.pose(b);
            assert!(world.remove_constraint(joint));
            heights(&mut world, 20);
            let without = world.save().expect("savable");
            let other = world.add_constraint(a, b, &hinge()).expect("two bodies");
            heights(&mut world, 20);
            for _ in 0..2 {
                world.restore(&with).expect("of this world");
                assert!(!world.set_motor(other, false, 0.0, 1.0) && !world.remove_body(b), "it is held");
                assert_eq!(world.articulation(b), articulation);
                heights(&mut world, 200);
                assert_eq!(world.pose(b), expected, "{kind:?}");
                world.restore(&without).expect("of this world");
                assert!(!world.remove_constraint(joint) && world.constraints().len() == 1);
                assert_eq!(world.articulation(b), None);
            }
            assert!(world.remove_body(b), "nothing holds it");
            assert_eq!(world.restore(&with), Err(StateError::Changed));
        }
    }
}
