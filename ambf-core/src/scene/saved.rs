//! Saving and restoring a scene: each module saves the state that it keeps beside Bullet's.

use nalgebra::Vector3;

use super::body::SavedBody;
use super::joint::SavedJoint;
use super::list::SavedList;
use super::Scene;
use crate::bullet::{SavedWorld, StateError};

/// What of a [`Scene`] changes while the simulation runs, as it was at one moment.
#[derive(Debug, Clone)]
pub(crate) struct SavedScene {
    changes: u64,
    world: SavedWorld,
    /// One a list of objects, in the order of [`Scene::lists`].
    lists: Vec<SavedList>,
    joints: Vec<SavedJoint>,
    gravity: Vector3<f64>,
    n_bodies: usize,
}

impl SavedScene {
    /// Bullet's side.
    #[cfg(test)]
    pub fn bytes(&self) -> &[u8] {
        self.world.bytes()
    }

    /// All that is kept beside Bullet.
    #[cfg(test)]
    pub fn objects(&self) -> impl std::fmt::Debug + '_ {
        (&self.lists, &self.joints)
    }

    /// Memory that it takes, bytes, but for little.
    pub fn size(&self) -> usize {
        self.world.size() + self.n_bodies * size_of::<SavedBody>() + size_of_val(self.joints.as_slice())
    }
}

impl Scene {
    /// # Errors
    /// Those of [`World::save`](crate::bullet::World::save).
    pub(crate) fn save(&self) -> Result<SavedScene, StateError> {
        let (world, joints, gravity) = self.saved_fields();
        Ok(SavedScene {
            changes: self.changes,
            world: world.save()?,
            lists: self.lists().map(|list| list.save()).to_vec(),
            joints: joints.iter().map(|joint| joint.save()).collect(),
            gravity: *gravity,
            n_bodies: self.bodies.len(),
        })
    }

    /// # Errors
    /// Those of [`World::restore`](crate::bullet::World::restore); [`StateError::Changed`] also when anything else came
    /// or went. Nothing has changed then.
    pub(crate) fn restore(&mut self, saved: &SavedScene) -> Result<(), StateError> {
        self.world.check_saved(&saved.world)?;
        if self.changes != saved.changes {
            return Err(StateError::Changed);
        }
        self.world.restore(&saved.world)?;
        self.lists_mut().into_iter().zip(&saved.lists).for_each(|(list, saved)| list.restore(saved));
        self.joints.iter_mut().zip(&saved.joints).for_each(|(joint, saved)| joint.restore(saved));
        self.gravity = saved.gravity;
        self.show_restored_volumes();
        Ok(())
    }
}
