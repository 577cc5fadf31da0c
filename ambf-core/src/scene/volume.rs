//! Volumes: voxel data that is drawn, measured and cut where the volume is. Bodies collide with those that ask for it, as
//! with parts of the body that carries them. As in the C++ program they have no topics of their own: what moves one is its
//! parent.

use std::sync::Arc;

use ambf_volume::carve::CarveError;
use ambf_volume::{Carved, Carver, Stroke, VoxelGrid};
use nalgebra::Isometry3;
use thiserror::Error;

use super::attached::Attached;
use super::build::Builder;
use super::list::SceneObject;
use super::tool::{self, SavedTool, Tool};
use super::{Identity, ObjectType, Parent, Scene};
use crate::adf::{self, Severity};
use crate::bullet::{VolumePartHandle, World};
use crate::comm::{CarveCommand, Snapshot, ToolReading};
use crate::ids::{BodyId, VolumeId};

/// Voxels of a cut by tools that take no new memory.
const ROOM: usize = 1 << 14;

/// Voxels for which room is kept after a larger cut.
const KEPT: usize = 1 << 16;

/// A volume of a [`Scene`].
#[derive(Debug, Clone)]
pub struct Volume {
    /// Names, parent and pose.
    pub attached: Attached,
    /// What it was made from.
    pub description: Arc<adf::Volume>,
    voxels: Option<Voxels>,
    /// What bodies collide with; `None`: nothing.
    part: Option<VolumePartHandle>,
    pub(super) tools: Vec<Tool>,
    /// What tools have cut in the latest update.
    cut: Carved,
}

/// Voxels at the start and now. Both share what was not cut.
#[derive(Debug, Clone)]
struct Voxels {
    first: Arc<VoxelGrid>,
    now: Arc<VoxelGrid>,
    carver: Carver,
}

/// What of a [`Volume`] changes while the simulation runs.
#[derive(Debug, Clone)]
pub(super) struct SavedVolume {
    pose: Isometry3<f64>,
    /// Voxels, and what a rate of cutting has left over, m³.
    voxels: Option<(Arc<VoxelGrid>, f64)>,
    tools: Vec<SavedTool>,
}

/// Error when a volume cannot be cut.
#[derive(Debug, Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum VolumeError {
    /// Error when there is no such volume, or no longer.
    #[error("there is no volume of that name or number")]
    Unknown,
    /// Error when a volume has no voxels.
    #[error("volume `{0}` has no voxels")]
    Empty(String),
    /// Error when its file says that a volume is not to be cut.
    #[error("volume `{0}` is not to be cut: its file says `carvable: false`")]
    NotCarvable(String),
    /// Error when a volume has no tool of a number, or a radius is not positive and finite.
    #[error("volume `{0}` has no such tool, or its radius is not positive")]
    Tool(String),
    /// Error when a tool has burrs, and none of them has a radius.
    #[error("no burr of this tool of volume `{volume}` has a radius of {radius} m; there are {known}")]
    Burr {
        /// The volume.
        volume: String,
        /// What was asked for, m.
        radius: f64,
        /// Radii of those that it has, in words.
        known: String,
    },
    /// Error when a tool is to be added whose bodies are not there, or whose numbers are not usable.
    #[error("a tool of volume `{volume}` is not added: {why}")]
    NewTool {
        /// The volume.
        volume: String,
        /// A sentence.
        why: String,
    },
    /// Error when the cut is not described by usable numbers.
    #[error(transparent)]
    Carve(#[from] CarveError),
}

impl Volume {
    /// The voxels now; `None`: it is empty, or they cannot be read.
    pub fn voxels(&self) -> Option<&Arc<VoxelGrid>> {
        self.voxels.as_ref().map(|voxels| &voxels.now)
    }

    /// The voxels at the start.
    pub fn first_voxels(&self) -> Option<&Arc<VoxelGrid>> {
        self.voxels.as_ref().map(|voxels| &voxels.first)
    }

    /// Lets bodies collide with the voxels of now. `wakes`: those that sleep near what has changed wake.
    fn show_to_bodies(&self, world: &mut World, wakes: bool) {
        if let (Some(part), Some(Voxels { now, .. })) = (self.part, &self.voxels) {
            world.set_voxels(part, now, wakes);
        }
    }

    fn restore_voxels(&mut self) {
        if let Some(voxels) = &mut self.voxels {
            voxels.now = Arc::clone(&voxels.first);
            voxels.carver.carry = 0.0;
        }
    }

    /// What tools have cut since this was asked the last time, in the order in which they did.
    pub(crate) fn cut_by_tools(&self) -> &Carved {
        &self.cut
    }
}

impl SceneObject for Volume {
    type Id = VolumeId;
    type Saved = SavedVolume;
    const TYPE: ObjectType = ObjectType::Volume;
    const RANK: u8 = 8;
    const ACTS: bool = true;

    fn identity(&self) -> &Identity {
        &self.attached.identity
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.volumes.push(Isometry3::identity());
        snapshot.voxels.push(self.voxels().cloned());
        snapshot.tools.push(self.tools.iter().map(Tool::reading).collect());
    }

    fn read(&self, id: Self::Id, scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.volumes[id] = scene.global_pose(self.attached.parent, &self.attached.pose);
        let tools = &mut snapshot.tools[id];
        tools.clear();
        tools.extend(self.tools.iter().map(Tool::reading));
        if let (Some(shown), Some(now)) = (&mut snapshot.voxels[id], self.voxels()) {
            if !Arc::ptr_eq(shown, now) {
                *shown = Arc::clone(now);
            }
        }
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(scene.global_pose(self.attached.parent, &self.attached.pose))
    }

    /// Tools touch and cut.
    fn update(scene: &mut Scene, id: Self::Id, _sub_step: f64, interval: f64) {
        let volume = &mut scene.volumes[id];
        volume.cut.clear();
        volume.cut.shrink_to(KEPT);
        if volume.tools.is_empty() || volume.voxels.is_none() {
            return;
        }
        let Attached { parent, pose, .. } = volume.attached;
        let pose = scene.global_pose(parent, &pose);
        let Scene { volumes, bodies, world, .. } = scene;
        let Volume { tools, voxels: Some(Voxels { now, .. }), cut, description, .. } = &mut volumes[id] else { return };
        let carrier = match parent {
            Some(Parent::Body(body)) => Some(body),
            _ => None,
        };
        for tool in tools {
            tool.update(now, &pose, carrier, bodies, world, interval, description.carvable, cut);
        }
        scene.show_to_bodies(id);
    }

    fn reset(scene: &mut Scene, id: Self::Id) {
        let volume = &mut scene.volumes[id];
        volume.attached.reset();
        volume.restore_voxels();
        volume.tools.iter_mut().for_each(Tool::reset);
        volume.cut.clear();
        scene.show_to_bodies(id);
    }

    fn save(&self) -> Self::Saved {
        // All fields by name, so that no new one is forgotten.
        let Self { attached, description: _, voxels, part: _, tools, cut: _ } = self;
        let of_voxels = |Voxels { first: _, now, carver }: &Voxels| (Arc::clone(now), carver.carry);
        let tools = tools.iter().map(Tool::save).collect();
        SavedVolume { pose: attached.save(), voxels: voxels.as_ref().map(of_voxels), tools }
    }

    fn restore(&mut self, saved: &Self::Saved) {
        self.attached.pose = saved.pose;
        if let (Some(voxels), Some((now, carry))) = (&mut self.voxels, &saved.voxels) {
            voxels.now = Arc::clone(now);
            voxels.carver.carry = *carry;
        }
        self.tools.iter_mut().zip(&saved.tools).for_each(|(tool, saved)| tool.restore(saved));
        self.cut.clear();
    }
}

impl Scene {
    /// The volume that `name` names: its whole qualified identifier, or a part of it that no other has.
    pub fn volume_named(&self, name: &str) -> Option<VolumeId> {
        self.volumes.names.id(name)
    }

    /// Cuts a volume; what was removed. Between two iterations only. What shares the voxels of before, such as a saved
    /// state, keeps them.
    ///
    /// # Errors
    /// [`VolumeError`]; nothing is cut then.
    pub(crate) fn carve(&mut self, id: VolumeId, command: &CarveCommand) -> Result<Carved, VolumeError> {
        let volume = self.volumes.get(id).ok_or(VolumeError::Unknown)?;
        let pose = self.global_pose(volume.attached.parent, &volume.attached.pose);
        let volume = &mut self.volumes[id];
        let name = || volume.attached.identity.key();
        if !volume.description.carvable {
            return Err(VolumeError::NotCarvable(name()));
        }
        let Some(Voxels { now, carver, .. }) = &mut volume.voxels else {
            return Err(VolumeError::Empty(volume.attached.identity.key()));
        };
        let local = |there: &Isometry3<f64>| if command.in_world { pose.inv_mul(there) } else { *there };
        let stroke = Stroke { from: local(&command.from), to: local(&command.to) };
        carver.carve_shared(now, &command.shape, &stroke, command.rule)?;
        let carved = carver.take_carved();
        self.show_to_bodies(id);
        Ok(carved)
    }

    /// Switches a tool of a volume, or gives it another burr.
    ///
    /// # Errors
    /// [`VolumeError::Unknown`], [`VolumeError::Tool`].
    pub(crate) fn set_tool(
        &mut self,
        id: VolumeId,
        tool: usize,
        on: Option<bool>,
        radius: Option<f64>,
    ) -> Result<(), VolumeError> {
        let volume = self.volumes.get_mut(id).ok_or(VolumeError::Unknown)?;
        let name = || volume.attached.identity.key();
        let is_usable = radius.is_none_or(|radius| radius.is_finite() && radius > 0.0);
        if !is_usable || tool >= volume.tools.len() {
            return Err(VolumeError::Tool(name()));
        }
        if let Some(radius) = radius.filter(|radius| !volume.tools[tool].takes(*radius)) {
            let radii = volume.tools[tool].description().burrs.iter().map(|burr| format!("{} m", burr.radius));
            let known = radii.collect::<Vec<_>>().join(", ");
            return Err(VolumeError::Burr { volume: name(), radius, known });
        }
        volume.tools[tool].set(on, radius);
        Ok(())
    }

    /// Adds a tool to those of a volume; its place among them. For as long as the scene lasts: a reset keeps it. One that was
    /// added before and is the same body is replaced: a plugin that begins again has one tool.
    ///
    /// # Errors
    /// [`VolumeError::Unknown`], [`VolumeError::Empty`], [`VolumeError::NotCarvable`], [`VolumeError::NewTool`].
    pub(crate) fn add_tool(&mut self, id: VolumeId, tool: &adf::VolumeTool) -> Result<usize, VolumeError> {
        let volume = self.volumes.get(id).filter(|_| self.has_object(id.into())).ok_or(VolumeError::Unknown)?;
        let name = volume.attached.identity.key();
        if volume.voxels.is_none() {
            return Err(VolumeError::Empty(name));
        }
        if !volume.description.carvable {
            return Err(VolumeError::NotCarvable(name));
        }
        let refuse = |why: String| VolumeError::NewTool { volume: name.clone(), why };
        if !tool.is_usable() {
            return Err(refuse("one of its numbers is not finite, or has the wrong sign".into()));
        }
        let find = |body: &String| match self.find_parent(Parent::Volume(id), body) {
            Ok(Parent::Body(body)) => Ok(body),
            found => Err(refuse(format!("`{body}`: {}", found.err().unwrap_or_else(|| "no body".into())))),
        };
        let mut made = Tool::new(tool.clone());
        made.body = Some(find(&tool.body)?);
        for (place, burr) in tool.burrs.iter().enumerate().filter(|(_, burr)| !burr.body.is_empty()) {
            made.burr_bodies[place] = Some(find(&burr.body)?);
        }
        let volume = &mut self.volumes[id];
        let given = volume.description.tools.len();
        let added = volume.tools.iter().skip(given).position(|other| other.body == made.body);
        let place = added.map_or(volume.tools.len(), |place| given + place);
        match volume.tools.get_mut(place) {
            Some(other) => *other = made,
            None => volume.tools.push(made),
        }
        if tool::cuts(tool) {
            volume.cut = Carved::with_room(ROOM);
        }
        self.choose_leading_tools();
        Ok(place)
    }

    /// Tools that were added to those of the files, with their volumes.
    pub(crate) fn added_tools(&self) -> impl Iterator<Item = (VolumeId, &adf::VolumeTool)> {
        let there = self.volumes.entries().filter(|(id, _)| self.has_object((*id).into()));
        there.flat_map(|(id, volume)| {
            volume.tools.iter().skip(volume.description.tools.len()).map(move |tool| (id, tool.description()))
        })
    }

    /// Of the tools that a body is, the first shows the burr while none touches.
    pub(super) fn choose_leading_tools(&mut self) {
        let mut led = Vec::new();
        for id in self.volumes.ids().collect::<Vec<_>>() {
            if self.volumes[id].voxels.is_none() || !self.has_object(id.into()) {
                continue;
            }
            for tool in &mut self.volumes[id].tools {
                tool.leads = tool.body.is_none_or(|body| !led.contains(&body));
                led.extend(tool.body);
            }
        }
    }

    /// Switches the tools that a body is: on if the first is off, else off.
    pub(crate) fn switch_tools_of(&mut self, body: BodyId) {
        let mut on = None;
        let volumes = self.volumes.ids();
        for id in volumes {
            for tool in self.volumes[id].tools.iter_mut().filter(|tool| tool.body == Some(body)) {
                let on = *on.get_or_insert(!tool.reading().is_on);
                tool.set(Some(on), None);
            }
        }
    }

    /// What a tool of a volume does; `None`: there is none.
    pub fn tool(&self, id: VolumeId, tool: usize) -> Option<ToolReading> {
        self.volumes.get(id)?.tools.get(tool).map(Tool::reading)
    }

    /// How many tools all volumes have together.
    pub(crate) fn tool_count(&self) -> usize {
        self.volumes.iter().map(|volume| volume.tools.len()).sum()
    }

    /// Gives a volume the voxels of the start back.
    ///
    /// # Errors
    /// [`VolumeError::Unknown`].
    pub(crate) fn restore_voxels(&mut self, id: VolumeId) -> Result<(), VolumeError> {
        self.volumes.get_mut(id).ok_or(VolumeError::Unknown)?.restore_voxels();
        self.show_to_bodies(id);
        Ok(())
    }

    fn show_to_bodies(&mut self, id: VolumeId) {
        self.volumes[id].show_to_bodies(&mut self.world, true);
    }

    /// Lets bodies collide with the voxels that a saved state has brought back, at which sleeping bodies sleep on.
    pub(super) fn show_restored_volumes(&mut self) {
        for volume in self.volumes.iter() {
            volume.show_to_bodies(&mut self.world, false);
        }
    }

    /// Bodies pass through volumes that were removed from bodies that stay.
    pub(super) fn hide_removed_volumes(&mut self) {
        for id in self.volumes.ids() {
            let volume = &self.volumes[id];
            let (Some(part), Some(first)) = (volume.part, volume.first_voxels()) else { continue };
            if !self.has_object(id.into()) {
                let empty = Arc::new(first.emptied());
                self.world.set_voxels(part, &empty, true);
                self.volumes[id].part = None;
            }
        }
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
        let mut location = volume.location;
        let voxels = match self.meshes.voxels.get(volume) {
            None => None,
            Some(Ok(read)) => {
                for note in read.notes {
                    self.note(Severity::Info, &volume.common.source, format!("`{}`: {note}", volume.common.identifier));
                }
                if volume.nrrd.is_some() && volume.images.is_none() && !volume.has_location {
                    location = read.pose;
                }
                let (first, now) = (Arc::clone(&read.grid), read.grid);
                Some(Voxels { first, now, carver: Carver::default() })
            }
            Some(Err(why)) => {
                let message = format!("`{}`: {why}; the volume is empty", volume.common.identifier);
                self.note(Severity::Error, &volume.common.source, message);
                None
            }
        };
        let attached = Attached::new(identity, location);
        let tools = volume.tools.iter().map(|tool| Tool::new(tool.clone())).collect();
        let description = Arc::new(volume.clone());
        let cuts = volume.tools.iter().any(tool::cuts);
        let cut = Carved::with_room(if cuts { ROOM } else { 0 });
        self.scene.volumes.push(Volume { attached, description, voxels, part: None, tools, cut });
    }

    /// Lets bodies collide with the volumes of the models that are being built which ask for it. Their parents are known,
    /// and no body is a link yet of an articulation that is about to be made.
    pub(super) fn resolve_volume_contacts(&mut self) {
        for id in self.scene.volumes.ids().collect::<Vec<_>>() {
            let Scene { volumes, bodies, world, .. } = &mut *self.scene;
            let volume = &mut volumes[id];
            let is_new = self.models.contains(&volume.attached.identity.model);
            let (true, true, Some(now)) = (is_new, volume.description.contact.is_some(), volume.voxels()) else {
                continue;
            };
            let why = match volume.attached.parent {
                Some(Parent::Body(body)) => {
                    let body = &bodies[body];
                    let pose = body.inertial_offset_inverse * volume.attached.pose;
                    volume.part = world.add_volume(body.handle, now, &pose);
                    "the body that it hangs on is a link of a mechanism that was there before"
                }
                _ => "it hangs on nothing that is a body",
            };
            if volume.part.is_none() {
                let message = format!("`{}`: nothing collides with it: {why}", volume.attached.identity.key());
                let source = volume.description.common.source.clone();
                self.note(Severity::Warning, &source, message);
            }
        }
    }

    /// Finds the bodies of tools, which may be in later models.
    pub(super) fn resolve_tools(&mut self) {
        for id in self.scene.volumes.ids().collect::<Vec<_>>() {
            for place in 0..self.scene.volumes[id].tools.len() {
                let tool = &self.scene.volumes[id].tools[place];
                if tool.body.is_some() {
                    continue;
                }
                let names: Vec<_> = tool.description().burrs.iter().map(|burr| burr.body.clone()).collect();
                let body = tool.description().body.clone();
                let body = self.tool_body(id, place, &body);
                let burrs = names.iter().map(|name| {
                    let is_named = !name.is_empty();
                    is_named.then(|| self.tool_body(id, place, name)).flatten()
                });
                let burrs = burrs.collect();
                let tool = &mut self.scene.volumes[id].tools[place];
                (tool.body, tool.burr_bodies) = (body, burrs);
            }
        }
        self.scene.choose_leading_tools();
    }

    /// A body that a tool of a volume names; `None`, and a note, where there is none.
    fn tool_body(&mut self, id: VolumeId, place: usize, name: &str) -> Option<BodyId> {
        match self.scene.find_parent(Parent::Volume(id), name) {
            Ok(Parent::Body(body)) => Some(body),
            found => {
                let volume = &self.scene.volumes[id];
                let why = found.err().unwrap_or_else(|| "no body".to_owned());
                let message = format!("tool {place} of `{}`: `{name}`: {why}", volume.attached.identity.key());
                let source = volume.description.common.source.clone();
                self.note_wanted(Severity::Warning, &source, message, name);
                None
            }
        }
    }
}
