//! Builds the objects of one model after the other: what they have in common, joints, cameras and lights. Rigid bodies are in
//! `rigid_bodies`, all others in `elements`.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;
use std::sync::Arc;

use super::assemble::Assembly;
use super::attached::{camera_parameters, camera_pose, first_target, light_rotation, Attached, Camera, Light};
use super::hulls::CollisionMeshes;
use super::joint::{constraint, frames, resistance, Joint, JointCoupling};
use super::planned::PlannedModel;
use super::{Found, Identity, ModelInfo, NameMap, Note, ObjectType, Parent, Scene};
use crate::adf::{self, Severity, SourcePos};
use crate::bullet::JointReadings;
use crate::comm::{LightParameters, Rates};
use crate::ids::{BodyId, Id, JointId, ModelId};
use crate::mesh::Mesh;

/// Adds models to a scene, one after the other.
pub(super) struct Builder<'a> {
    pub scene: &'a mut Scene,
    pub notes: Vec<Note>,
    pub(super) meshes: &'a CollisionMeshes,
    /// The model that is being built.
    pub(super) model: ModelId,
    /// What it has in common with those of other worlds.
    pub(super) planned: Option<PlannedModel>,
    /// Its bodies by qualified identifier.
    own_names: NameMap<BodyId>,
    /// The models that this builder has built, and the one that it builds.
    pub(super) models: BTreeSet<ModelId>,
    assembly: Assembly,
}

impl<'a> Builder<'a> {
    pub fn new(scene: &'a mut Scene, meshes: &'a CollisionMeshes) -> Self {
        Self {
            scene,
            notes: Vec::new(),
            meshes,
            model: ModelId::ENVIRONMENT,
            planned: None,
            own_names: NameMap::default(),
            models: BTreeSet::new(),
            assembly: Assembly::default(),
        }
    }

    /// Builds the environment model with the world's own lights and cameras in it.
    pub fn add_environment(&mut self, model: PlannedModel) {
        let world = Arc::clone(&self.scene.description);
        let model = self.begin_model(model);
        self.add_objects(&model);
        self.add_volumes(&model.volumes);
        self.declare_plugins(&model);
        self.add_lights(&world.lights);
        self.add_cameras(&world.cameras);
        self.finish_model();
    }

    /// Builds a model.
    pub fn add_model(&mut self, model: PlannedModel) {
        let model = self.begin_model(model);
        self.add_objects(&model);
        self.add_cameras(&model.cameras);
        self.add_lights(&model.lights);
        self.add_volumes(&model.volumes);
        self.declare_plugins(&model);
        self.finish_model();
    }

    /// Resolves what may refer to later models, and reads the joints for the first time.
    pub fn finish(mut self) -> Vec<Note> {
        self.scene.changes += 1;
        self.scene.vacate(&BTreeSet::new());
        self.resolve_parents();
        self.resolve_volume_contacts();
        self.resolve_tools();
        self.scene.arrange();
        let (remarks, open) = self.assembly.put_together(self.scene, &self.models);
        self.notes.extend(remarks);
        self.scene.place_wheels();
        for ghost in self.scene.ghosts.ids() {
            if self.models.contains(&self.scene.ghosts[ghost].attached.identity.model) {
                self.scene.place_ghost(ghost);
            }
        }
        self.note_open_couplings();
        let remarks = self.scene.articulate(&self.models, &open);
        self.notes.extend(remarks);
        self.scene.world.refresh_constraints();
        self.scene.observe_joints(0.0, &mut JointReadings::default());
        self.notes
    }

    pub(super) fn note(&mut self, severity: Severity, source: &SourcePos, message: String) {
        self.notes.push(Note { severity, source: source.clone(), message, wanted: None });
    }

    /// A remark on a name in the file that leads to nothing, or to several objects.
    pub(super) fn note_wanted(&mut self, severity: Severity, source: &SourcePos, message: String, wanted: &str) {
        self.notes.push(Note { severity, source: source.clone(), message, wanted: Some(wanted.to_owned()) });
    }

    fn begin_model(&mut self, planned: PlannedModel) -> Arc<adf::Model> {
        let scene = &mut *self.scene;
        let description = Arc::clone(&planned.model.description);
        self.own_names = NameMap::default();
        let name = format!("{}{}{}", scene.options.prefix, description.namespace, description.name);
        let key = format!("{name}{}", scene.model_names.free_suffix(&name));
        scene.vacate_for(&key, &description);
        let info = ModelInfo {
            key,
            description: Arc::clone(&description),
            removed: false,
            shared: Some(Arc::clone(&planned.model)),
            fingerprint: 0,
        };
        self.model = scene.models.push(info);
        self.models.insert(self.model);
        scene.model_names.insert(&name, self.model);
        self.planned = Some(planned);
        description
    }

    /// Prefix and namespace of an element.
    pub(super) fn namespace(&self, common: &adf::Common) -> String {
        format!("{}{}", self.scene.options.prefix, common.namespace)
    }

    /// Names of an element whose type has `names` in the world.
    pub(super) fn identity<I: Id>(&mut self, common: &adf::Common, names: impl Fn(&Scene) -> &NameMap<I>) -> Identity {
        let namespace = self.namespace(common);
        let suffix = names(self.scene).free_suffix(&format!("{namespace}{}", common.identifier));
        let rates = self.rates(common);
        Identity::new(common, namespace, suffix, rates, self.model)
    }

    fn rates(&mut self, common: &adf::Common) -> Rates {
        match (self.scene.options.rates, common.publish_frequency) {
            (Some(rates), _) => rates,
            (None, None) => Rates::default(),
            (None, Some((low, high))) => Rates::new(low, high).unwrap_or_else(|message| {
                self.note(Severity::Error, &common.source, format!("{message}; 50 and 1000 Hz are used"));
                Rates::default()
            }),
        }
    }

    /// All but cameras and lights, in the order of the C++ program.
    fn add_objects(&mut self, model: &adf::Model) {
        for (index, body) in model.bodies.iter().enumerate() {
            self.with_plugins(ObjectType::Body, &body.common, |builder| {
                if let Some(id) = builder.add_body(index, body, model) {
                    builder.own_names.insert(&builder.scene.bodies[id].identity.key(), id);
                }
            });
        }
        self.add_lists(model, false);
        let mut made = Vec::with_capacity(model.joints.len());
        for joint in &model.joints {
            let id = self.scene.joints.next_id();
            self.with_plugins(ObjectType::Joint, &joint.common, |builder| builder.add_joint(joint));
            made.push((self.scene.joints.next_id() != id).then_some(id));
        }
        if model.joints.iter().any(|joint| joint.coupling.is_some()) {
            self.couple(model, &made);
        }
        self.add_lists(model, true);
    }

    /// The objects of all types that are built before joints, or after.
    fn add_lists(&mut self, model: &adf::Model, follow_joints: bool) {
        let adds = self.scene.lists().map(|list| list.add(follow_joints));
        adds.into_iter().flatten().for_each(|add| add(self, model));
    }

    /// A mesh; `None`, and a note that the element is dropped, when it cannot be used.
    pub(super) fn mesh(&mut self, path: &Path, scale: f64, common: &adf::Common) -> Option<Arc<Mesh>> {
        match self.meshes.files.get(path, scale) {
            Ok(mesh) => Some(mesh),
            Err(error) => {
                self.drop_element(common, error);
                None
            }
        }
    }

    pub(super) fn drop_element(&mut self, common: &adf::Common, why: impl std::fmt::Display) {
        self.note(Severity::Error, &common.source, format!("`{}` is dropped: {why}", common.identifier));
    }

    fn add_joint(&mut self, joint: &adf::Joint) {
        let key = format!("{}{}", self.namespace(&joint.common), joint.common.identifier);
        let suffix = self.scene.joint_names.free_suffix(&key);
        let parent = self.body_for(&joint.common, &suffix, "parent", &joint.parent);
        let child = self.body_for(&joint.common, &suffix, "child", &joint.child);
        let (Some(parent), Some(child)) = (parent, child) else { return };
        if parent == child {
            self.drop_element(&joint.common, format_args!("it joins `{}` with itself", joint.parent));
            return;
        }
        let (frame_a, frame_b, axis) = frames(joint, &self.scene.bodies[parent], &self.scene.bodies[child]);
        let id = self.scene.joints.next_id();
        let measured = joint.enable_feedback || self.scene.options.joint_wrenches;
        let handle = constraint(joint, frame_a, frame_b, self.scene.joint_erp).and_then(|mut constraint| {
            constraint.feedback = measured;
            self.assembly.add(id, &constraint, joint.assemble);
            let [a, b] = [parent, child].map(|body| self.scene.bodies[body].handle);
            let handle = self.scene.world.add_constraint(a, b, &constraint)?;
            if let Some(resistance) = resistance(joint) {
                self.scene.world.set_resistance(handle, resistance);
            }
            Some((handle, self.scene.world.constraint_index(handle)?))
        });
        let was_full = self.scene.graph.is_full();
        self.scene.graph.add_joint(parent, child, id, joint.common.passive);
        if !was_full && self.scene.graph.is_full() {
            let message = format!(
                "`{}` makes chains too long to be listed: of it and of some later joints only the parent body has names, positions and \
                 commands",
                joint.common.identifier
            );
            self.note(Severity::Warning, &joint.common.source, message);
        }
        self.scene.has_feedback |= joint.enable_feedback && handle.is_some();
        self.scene.has_measured |= measured && handle.is_some();
        let live = Joint::new(joint, key, (parent, child), self.model, ([frame_a, frame_b], axis), handle, measured);
        self.scene.joints.push(live);
    }

    /// Couples the joints of a model; `made`: those that were made, in its order.
    fn couple(&mut self, model: &adf::Model, made: &[Option<JointId>]) {
        let mut named: HashMap<&str, JointId> = HashMap::new();
        for (joint, id) in model.joints.iter().zip(made) {
            if let Some(id) = *id {
                named.entry(&joint.common.identifier).or_insert(id);
            }
        }
        for index in adf::followers(&model.joints) {
            let (joint, Some(id)) = (&model.joints[index], made[index]) else { continue };
            let Some(coupling) = &joint.coupling else { continue };
            let found: Result<Vec<(JointId, f64)>, &str> = coupling
                .leaders
                .iter()
                .map(|leader| Ok((*named.get(leader.joint.as_str()).ok_or(leader.joint.as_str())?, leader.ratio)))
                .collect();
            let leaders = match found {
                Ok(leaders) => leaders,
                Err(missing) => {
                    let message = format!(
                        "`{}` moves on its own: `{missing}`, which it follows, is dropped",
                        joint.common.identifier
                    );
                    self.note(Severity::Error, &joint.common.source, message);
                    continue;
                }
            };
            let handle = |id: JointId| self.scene.joints[id].handle;
            let handles: Option<Vec<_>> =
                leaders.iter().map(|&(leader, ratio)| Some((handle(leader)?, ratio))).collect();
            let (Some(follower), Some(handles)) = (handle(id), handles) else { continue };
            if self.scene.world.couple(follower, &handles, coupling.offset) {
                self.scene.joints[id].coupling = Some(JointCoupling { leaders, offset: coupling.offset });
                self.scene.followers.push(id);
            }
        }
    }

    /// Names the followers that do not start where their leaders ask for.
    fn note_open_couplings(&mut self) {
        /// Errors from these on are said: m and rad (0.1°).
        const OPEN: [f64; 2] = [1e-4, 1.75e-3];
        for &id in &self.scene.followers {
            let joint = &self.scene.joints[id];
            let error = self.scene.coupling_error(id).unwrap_or(0.0);
            let is_angular = joint.joint_type.is_angular();
            if !self.models.contains(&joint.model) || error.abs() <= OPEN[usize::from(is_angular)] {
                continue;
            }
            let unit = if is_angular { "rad" } else { "m" };
            let message = format!(
                "`{}` starts {error:.3e} {unit} from where its coupling asks for, and is brought there",
                joint.name
            );
            self.notes.push(Note { severity: Severity::Warning, source: joint.source.clone(), message, wanted: None });
        }
    }

    /// The body that `text` names for an element; `None`, and a note that the element is dropped, if there is none.
    /// `suffix` tells copies of the element apart, `role` is what the body is to it.
    pub(super) fn body_for(&mut self, common: &adf::Common, suffix: &str, role: &str, text: &str) -> Option<BodyId> {
        match self.find_body(text, &self.namespace(common), suffix) {
            Ok((index, remark)) => {
                if let Some(remark) = remark {
                    let message = format!("`{}`: {role} `{text}` {remark}", common.identifier);
                    self.note(Severity::Warning, &common.source, message);
                }
                Some(index)
            }
            Err(why) => {
                let message = format!("`{}` is dropped: {role} `{text}` {why}", common.identifier);
                self.note_wanted(Severity::Error, &common.source, message, text);
                None
            }
        }
    }

    /// Where a text leads: in its own model as it is, then with its namespace; in the world with namespace and suffix,
    /// then as it is. A remark says when it was no exact hit in the own model.
    pub(super) fn find_body(
        &self,
        text: &str,
        namespace: &str,
        suffix: &str,
    ) -> Result<(BodyId, Option<String>), String> {
        let own_names = &self.own_names;
        let qualified = format!("{namespace}{text}");
        // The usual case first, without a search: a key that is `qualified` holds `text`, so that the steps below could
        // only end at it.
        if let Some(index) = own_names.exact(text).or_else(|| own_names.exact(&qualified)) {
            return Ok((index, None));
        }
        let world = &self.scene.bodies.names;
        let with_suffix = format!("{qualified}{suffix}");
        let steps: [(&NameMap<BodyId>, &str); 4] =
            [(own_names, text), (own_names, &qualified), (world, &with_suffix), (world, text)];
        let mut ambiguous = None;
        for (step, (names, wanted)) in steps.into_iter().enumerate() {
            let found = names.find(wanted);
            match found.id() {
                Some(id) if step < 2 => return Ok((id, Some(format!("is {found}")))),
                Some(id) => {
                    let remark = format!("is taken from another model: `{}`", self.scene.bodies[id].identity.key());
                    return Ok((id, Some(remark)));
                }
                None if matches!(found, Found::Ambiguous(_)) => ambiguous = ambiguous.or(Some(found)),
                None => (),
            }
        }
        Err(format!("is {}", ambiguous.unwrap_or(Found::Nothing)))
    }

    fn add_cameras(&mut self, cameras: &[adf::Camera]) {
        for camera in cameras {
            self.with_plugins(ObjectType::Camera, &camera.common, |builder| builder.add_camera(camera));
        }
    }

    fn add_camera(&mut self, camera: &adf::Camera) {
        let pose = camera_pose(&camera.location, &camera.look_at, &camera.up);
        let identity = self.identity(&camera.common, |scene| &scene.cameras.names);
        self.scene.cameras.push(Camera {
            attached: Attached::new(identity, pose),
            parameters: camera_parameters(camera),
            look_at: camera.look_at,
            target: first_target(&pose, &camera.look_at),
            description: camera.clone(),
        });
    }

    fn add_lights(&mut self, lights: &[adf::Light]) {
        for light in lights {
            self.with_plugins(ObjectType::Light, &light.common, |builder| builder.add_light(light));
        }
    }

    fn add_light(&mut self, light: &adf::Light) {
        let mut pose = light.location;
        pose.rotation = light.direction.as_ref().and_then(light_rotation).unwrap_or(pose.rotation);
        let identity = self.identity(&light.common, |scene| &scene.lights.names);
        let parameters = LightParameters { cutoff_angle: light.cutoff_angle, parent_name: light.parent.clone() };
        self.scene.lights.push(Light {
            attached: Attached::new(identity, pose),
            parameters,
            description: light.clone(),
        });
    }

    /// Enters a model's objects in the world's maps and applies what concerns them together.
    fn finish_model(&mut self) {
        let model = self.model;
        self.scene.lists_mut().into_iter().for_each(|list| list.enter_names(model));
        let Scene { joints, joint_names, .. } = &mut *self.scene;
        for (id, joint) in joints.entries().filter(|(_, joint)| joint.model == model) {
            joint_names.insert(&joint.key, id);
        }
    }

    fn resolve_parents(&mut self) {
        for object in self.scene.all_attached().collect::<Vec<_>>() {
            let text = match object {
                Parent::Body(_) => continue,
                Parent::Camera(index) => &self.scene.cameras[index].parameters.parent_name,
                Parent::Light(index) => &self.scene.lights[index].parameters.parent_name,
                Parent::Ghost(index) => &self.scene.ghosts[index].parent_name,
                Parent::Volume(index) => &self.scene.volumes[index].description.parent,
            };
            let (text, source) = (text.clone(), self.source_of(object));
            let is_resolved = self.scene.attached_mut(object).is_some_and(|attached| attached.parent.is_some());
            if let (false, Err(message)) = (is_resolved, self.scene.set_parent(object, &text)) {
                // A parent that is there is refused where it closes a loop.
                match self.scene.find_parent(object, &text) {
                    Ok(_) => self.note(Severity::Warning, &source, message),
                    Err(_) => self.note_wanted(Severity::Warning, &source, message, &text),
                }
            }
        }
    }

    fn source_of(&self, object: Parent) -> SourcePos {
        match object {
            Parent::Body(index) => self.scene.bodies[index].source.clone(),
            Parent::Camera(index) => self.scene.cameras[index].description.common.source.clone(),
            Parent::Light(index) => self.scene.lights[index].description.common.source.clone(),
            Parent::Ghost(index) => self.scene.ghosts[index].source.clone(),
            Parent::Volume(index) => self.scene.volumes[index].description.common.source.clone(),
        }
    }
}
