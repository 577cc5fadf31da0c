//! Volumes: voxel data that is drawn where the volume is. They collide with nothing, and as in the C++ program have no
//! topics: what moves one is its parent.

use std::sync::Arc;

use nalgebra::Isometry3;

use super::attached::Attached;
use super::build::Builder;
use super::list::SceneObject;
use super::{Identity, ObjectType, Scene};
use crate::adf;
use crate::comm::Snapshot;
use crate::ids::VolumeId;

/// A volume of a [`Scene`].
#[derive(Debug, Clone)]
pub struct Volume {
    /// Names, parent and pose.
    pub attached: Attached,
    /// What it was made from; its voxels are read by who draws them.
    pub description: Arc<adf::Volume>,
}

impl SceneObject for Volume {
    type Id = VolumeId;
    type Saved = Isometry3<f64>;
    const TYPE: ObjectType = ObjectType::Volume;
    const RANK: u8 = 8;

    fn identity(&self) -> &Identity {
        &self.attached.identity
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.volumes.push(Isometry3::identity());
    }

    fn read(&self, id: Self::Id, scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.volumes[id] = scene.global_pose(self.attached.parent, &self.attached.pose);
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(scene.global_pose(self.attached.parent, &self.attached.pose))
    }

    fn reset(scene: &mut Scene, id: Self::Id) {
        scene.volumes[id].attached.reset();
    }

    fn save(&self) -> Self::Saved {
        let Self { attached, description: _ } = self;
        attached.save()
    }

    fn restore(&mut self, saved: &Self::Saved) {
        self.attached.pose = *saved;
    }
}

impl Builder<'_> {
    /// After cameras and lights, as in the C++ program: this is the order in which plugins are loaded.
    pub(super) fn add_volumes(&mut self, volumes: &[adf::Volume]) {
        for volume in volumes {
            self.with_plugins(ObjectType::Volume, &volume.common, |builder| builder.add_volume(volume));
        }
    }

    fn add_volume(&mut self, volume: &adf::Volume) {
        let identity = self.identity(&volume.common, |scene| &scene.volumes.names);
        let attached = Attached::new(identity, volume.location);
        self.scene.volumes.push(Volume { attached, description: Arc::new(volume.clone()) });
    }
}
