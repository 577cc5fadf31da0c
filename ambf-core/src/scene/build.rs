//! Builds the objects of one model after the other.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::Isometry3;

use super::assemble::Assembly;
use super::attached::{camera_parameters, camera_pose, first_target, light_rotation, Attached, Camera, Light};
use super::body::Body;
use super::descriptions::{ShapeRules, SharedModel};
use super::hulls::{CollisionMeshes, WantedHulls};
use super::joint::{constraint, frames, Joint};
use super::shape::BuiltShape;
use super::shared::{self, ShapeKey, SharedShape};
use super::targets::BodyTarget;
use super::{
    shape, Found, Identity, ModelInfo, NameMap, Note, ObjectType, Parent, PhysicsOptions, Scene, SceneOptions,
};
use crate::adf::{self, CollisionGeometry, CollisionMeshKind, Part, PartGeometry, RaySource, Severity, SourcePos};
use crate::bullet::{self, Integrator, Preset, Solver, SolverSettings, World, WorldKind};
use crate::comm::{CartesianCommandType, LightParameters, Rates};
use crate::control::{CartesianController, Profile};
use crate::ids::{BodyId, Id, ModelId};
use crate::mesh::{Mesh, MeshError};

/// Least principal moment of what collides, as a share of that of a solid body of its shape.
const MIN_INERTIA: f64 = 0.01;

/// Displacements of collision meshes below this are not worth a line, m.
const MIN_DISPLACEMENT: f64 = 1e-5;

/// Share of the position error of joints that profile `accurate` corrects in a sub-step: the joint gap is proportional
/// to its inverse, and with 1 rounding errors of redundant loops begin to show.
const ACCURATE_JOINT_ERP: f64 = 0.9;

/// Adds models to a scene, one after the other.
pub(super) struct Builder<'a> {
    pub scene: &'a mut Scene,
    pub notes: Vec<Note>,
    pub(super) meshes: &'a CollisionMeshes,
    /// The model that is being built.
    pub(super) model: ModelId,
    /// What it has in common with those of other worlds.
    planned: Option<PlannedModel>,
    /// Its bodies by qualified identifier.
    own_names: NameMap<BodyId>,
    /// The models that this builder has built, and the one that it builds.
    models: BTreeSet<ModelId>,
    assembly: Assembly,
}

/// Whether compounds of one shape become that shape. The trajectories of the C++ program depend on the compound.
fn simplifies(scene: &Scene) -> bool {
    scene.preset == Some(Preset::PyBullet) || scene.profile == Profile::Accurate
}

/// What the shapes of a scene's bodies depend on.
fn shape_rules(scene: &Scene) -> ShapeRules {
    ShapeRules { profile: scene.profile, is_simplified: simplifies(scene) }
}

/// A model that will be built, and the shapes of its bodies that other worlds have.
#[derive(Debug)]
pub(super) struct PlannedModel {
    model: Arc<SharedModel>,
    /// (bodies x 1); `None`: to be made.
    shapes: Vec<Option<SharedShape>>,
}

impl PlannedModel {
    /// A model for a scene that nobody knows yet: no shape is there.
    pub fn new(model: Arc<SharedModel>) -> Self {
        Self { model, shapes: Vec::new() }
    }

    /// A model for `scene`.
    pub fn for_scene(model: Arc<SharedModel>, scene: &Scene) -> Self {
        let rules = shape_rules(scene);
        let mut shapes = model.shapes(rules);
        for (shape, body) in shapes.iter_mut().zip(&model.description.bodies) {
            if shape.is_none() {
                *shape = ShapeKey::new(body, rules).as_ref().and_then(shared::find);
            }
        }
        Self { model, shapes }
    }

    /// Its description.
    pub fn description(&self) -> &adf::Model {
        &self.model.description
    }

    /// The bodies whose shapes have to be made.
    fn shapeless(&self) -> impl Iterator<Item = &adf::RigidBody> {
        let has_shape = |index: usize| self.shapes.get(index).is_some_and(Option::is_some);
        let bodies = self.description().bodies.iter().enumerate();
        bodies.filter(move |(index, _)| !has_shape(*index)).map(|(_, body)| body)
    }
}

/// Meshes that the objects of a model need, with their scales; without those of bodies whose shape another world has.
pub(super) fn needed_meshes(planned: &PlannedModel) -> impl Iterator<Item = (PathBuf, f64)> + '_ {
    let of = |collision: &CollisionGeometry, scale| match collision {
        CollisionGeometry::Mesh { path, .. } => vec![(path.clone(), scale)],
        CollisionGeometry::Parts { parts, .. } => {
            // Each part has its own scale, which is applied when its shape is made.
            let mesh = |part: &Part| match &part.geometry {
                PartGeometry::Mesh { path, .. } => Some((path.clone(), 1.0)),
                PartGeometry::Primitive(_) => None,
            };
            parts.iter().filter_map(mesh).collect()
        }
        _ => vec![],
    };
    let model = planned.description();
    let bodies = planned.shapeless().flat_map(move |body| of(&body.collision, body.scale));
    let ghosts = model.ghosts.iter().flat_map(move |ghost| of(&ghost.collision, ghost.scale));
    let soft_bodies = model.soft_bodies.iter().map(|soft| (soft.collision_mesh.clone(), soft.scale));
    let sensors = model.sensors.iter().filter_map(|sensor| Some((ray_mesh(&sensor.rays)?.clone(), 1.0)));
    bodies.chain(ghosts).chain(soft_bodies).chain(sensors)
}

/// Convex hulls that the objects of a model need, as [`needed_meshes`].
pub(super) fn needed_hulls(planned: &PlannedModel) -> impl Iterator<Item = WantedHulls> + '_ {
    let of = |collision: &CollisionGeometry, scale| match collision {
        CollisionGeometry::Mesh { path, kind: CollisionMeshKind::ConvexDecomposition(parameters) } => {
            Some((path.clone(), scale, *parameters))
        }
        _ => None,
    };
    let bodies = planned.shapeless().filter_map(move |body| of(&body.collision, body.scale));
    bodies.chain(planned.description().ghosts.iter().filter_map(move |ghost| of(&ghost.collision, ghost.scale)))
}

/// The file of a mesh with rays: the first that exists, else the best.
pub(super) fn ray_mesh(rays: &RaySource) -> Option<&PathBuf> {
    let RaySource::Mesh { candidates } = rays else { return None };
    candidates.iter().find(|path| path.is_file()).or(candidates.first())
}

/// A scene without objects. `may_articulate`: there is no reason against joints in reduced coordinates but the options.
pub(super) fn empty_scene(
    world: Arc<adf::World>,
    options: &SceneOptions,
    has_soft_bodies: bool,
    may_articulate: bool,
    notes: &mut Vec<Note>,
) -> Scene {
    let physics = physics(&world, &options.physics, notes);
    let profile = physics.profile.unwrap_or_default();
    let (solver, integrator) = match (physics.preset, profile) {
        (Some(Preset::PyBullet), _) => (Solver::SequentialImpulse, Integrator::Euler),
        (None, Profile::Legacy) => (Solver::WarmFriction, Integrator::Euler),
        (None, Profile::Accurate) => (Solver::Accurate, Integrator::RungeKutta),
    };
    let solver = physics.solver.unwrap_or(solver);
    let source = &world.common.source;
    let mut warn =
        |message| notes.push(Note { severity: Severity::Warning, source: source.clone(), message, wanted: None });
    let may_articulate =
        may_articulate && physics.articulated.unwrap_or(profile == Profile::Accurate && solver == Solver::Accurate);
    if may_articulate && physics.solver.is_some_and(|solver| solver != Solver::Accurate) {
        // Only two of the solvers know rows of trees.
        warn(format!(
            "solver {} knows no joints in reduced coordinates: sequential impulses solve what touches or ends there",
            solver.name()
        ));
    }
    // The error reduction of joints in files is that of the C++ program: a tenth.
    let accurate = profile == Profile::Accurate && physics.preset.is_none();
    let joint_erp = physics.joint_erp.or(accurate.then_some(ACCURATE_JOINT_ERP));
    let kind = match (has_soft_bodies, may_articulate) {
        (true, _) => WorldKind::Soft,
        (false, true) => WorldKind::Articulated,
        (false, false) => WorldKind::Rigid,
    };
    let savable = options.savable.then(|| World::savable(solver, kind));
    if matches!(savable, Some(None)) {
        warn("states cannot be saved: the process may have no more address space (`ulimit -v`)".into());
    }
    let manifolds = if options.is_one_of_many { 8 } else { World::MANIFOLDS };
    let mut bullet = savable.flatten().unwrap_or_else(|| World::with_room(solver, kind, manifolds));
    bullet.set_integrator(physics.integrator.unwrap_or(integrator));
    bullet.set_lag(profile == Profile::Legacy && physics.preset.is_none());
    if let Some(preset) = physics.preset {
        bullet.set_solver_settings(&preset.apply(bullet.solver_settings()));
        bullet.set_tight_bounds(true);
    } else if profile == Profile::Accurate {
        bullet.freeze_static_aabbs();
    }
    if physics.sleep == Some(true) && !bullet.enable_sleeping() {
        warn("`physics / sleep`: in a scene with soft bodies nothing sleeps".into());
    }
    if let Some(joint_erp) = joint_erp {
        // Some constraints have no error reduction of their own.
        bullet.set_solver_settings(&SolverSettings { joint_erp, ..bullet.solver_settings() });
    }
    bullet.set_gravity(world.gravity);
    if let Some(iterations) = physics.iterations {
        bullet.set_iterations(iterations);
    }
    Scene {
        namespace: format!("{}{}", options.prefix, world.common.namespace),
        world_rates: options.rates.unwrap_or_default(),
        gravity: world.gravity,
        max_sub_steps: world.max_iterations.max(1),
        sub_step: physics.sub_step,
        profile,
        preset: physics.preset,
        joint_erp,
        gyroscopic: physics.gyroscopic.unwrap_or_default(),
        ..Scene::empty(bullet, world, options)
    }
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
        self.declare_plugins(&model);
        self.finish_model();
    }

    /// Resolves what may refer to later models, and reads the joints for the first time.
    pub fn finish(mut self) -> Vec<Note> {
        self.scene.changes += 1;
        self.resolve_parents();
        self.scene.arrange();
        let (remarks, open) = self.assembly.put_together(self.scene, &self.models);
        self.notes.extend(remarks);
        self.scene.place_wheels();
        let remarks = self.scene.articulate(&self.models, &open);
        self.notes.extend(remarks);
        let mut buffer = vec![0.0; self.scene.world.constraints().len()];
        self.scene.world.refresh_constraints();
        self.scene.observe_joints(0.0, &mut buffer);
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
        self.model = scene.models.next_id();
        self.models.insert(self.model);
        let key = format!("{}{}{}", scene.options.prefix, description.namespace, description.name);
        let suffix = scene.model_names.free_suffix(&key);
        scene.model_names.insert(&key, self.model);
        let shared = Some(Arc::clone(&planned.model));
        let info = ModelInfo { key: key + &suffix, description: Arc::clone(&description), removed: false, shared };
        scene.models.push(info);
        self.planned = Some(planned);
        self.note_undrawn(&description);
        description
    }

    /// What is kept, but not drawn.
    fn note_undrawn(&mut self, model: &adf::Model) {
        if !model.volumes.is_empty() {
            let source = SourcePos { file: model.file.clone(), line: 0, column: 0 };
            let count = model.volumes.len();
            self.note(Severity::Warning, &source, format!("kept, but not drawn: {count} × volume"));
        }
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
        let mut apart = Vec::new();
        for (index, body) in model.bodies.iter().enumerate() {
            self.with_plugins(ObjectType::Body, &body.common, |builder| {
                if let Some(id) = builder.add_body(index, body, model) {
                    if !body.self_collision {
                        apart.push(id);
                    }
                    builder.own_names.insert(&builder.scene.bodies[id].identity.key(), id);
                }
            });
        }
        self.add_lists(model, false);
        for joint in &model.joints {
            self.with_plugins(ObjectType::Joint, &joint.common, |builder| builder.add_joint(joint));
        }
        self.add_lists(model, true);
        if model.ignore_inter_collision {
            self.ignore_all_pairs(&apart);
        }
    }

    /// The objects of all types that are built before joints, or after.
    fn add_lists(&mut self, model: &adf::Model, follow_joints: bool) {
        let adds = self.scene.lists().map(|list| list.add(follow_joints));
        adds.into_iter().flatten().for_each(|add| add(self, model));
    }

    /// `index`: of the body in the model's list.
    fn add_body(&mut self, index: usize, body: &adf::RigidBody, model: &adf::Model) -> Option<BodyId> {
        let source = &body.common.source;
        let (built, shared) = match self.built_shape(index, body) {
            Ok(built) => built,
            Err(error) => {
                self.drop_element(&body.common, error);
                return None;
            }
        };
        for (severity, message) in &built.left_out {
            self.note(*severity, source, format!("`{}`: {message}", body.common.identifier));
        }
        self.note_displacement(body, &built.inertial_offset);

        let estimate = || match &shared {
            Some(shared) => shared.inertia(body.mass, || built.shape.inertia(body.mass)),
            None => built.shape.inertia(body.mass),
        };
        let inertia = body.inertia.unwrap_or_else(|| {
            if body.mass > 0.0 {
                // An extent whose square underflows doesn't turn.
                estimate().map(|moment| if moment.recip().is_finite() { moment } else { 0.0 })
            } else {
                nalgebra::Vector3::zeros()
            }
        });
        let inertia = self.bounded_inertia(body, inertia, estimate);
        let initial_pose = body.location * built.inertial_offset;
        let gravity = body.gravity.or(model.gravity);
        let index = self.scene.bodies.next_id().index();
        let rigid = bullet::RigidBody {
            mass: body.mass,
            inertia,
            shape: built.shape,
            pose: initial_pose,
            friction: body.surface.static_friction,
            rolling_friction: body.surface.rolling_friction,
            restitution: body.surface.restitution,
            linear_damping: body.surface.linear_damping,
            angular_damping: body.surface.angular_damping,
            gravity,
        };
        let handle = self.scene.world.add_body_at(index, rigid);
        self.set_continuous(body, handle);
        self.scene.world.set_gyroscopic(handle, self.scene.gyroscopic);
        let controller = body.controller.unwrap_or_default();
        let identity = self.identity(&body.common, |scene| &scene.bodies.names);
        let id = self.scene.bodies.push(Body {
            identity,
            mass: body.mass,
            inertia,
            inertial_offset: built.inertial_offset,
            inertial_offset_inverse: built.inertial_offset.inverse(),
            initial_pose,
            gravity,
            scale: body.scale,
            collision_groups: body.collision_groups.clone(),
            publish_children_names: body.publish_children_names,
            publish_joint_names: body.publish_joint_names,
            publish_joint_positions: body.publish_joint_positions,
            source: source.clone(),
            removed: false,
            handle,
            control: CartesianCommandType::Force,
            target: BodyTarget::new(&controller.linear, &controller.angular),
            controller: CartesianController::new(controller.linear, controller.angular),
        });
        self.scene.graph.grow(self.scene.bodies.len());
        Some(id)
    }

    /// What collides of the body at `index` of the model's list: as another world has it, if one of the same files does.
    fn built_shape(
        &self,
        index: usize,
        body: &adf::RigidBody,
    ) -> Result<(BuiltShape, Option<SharedShape>), Arc<MeshError>> {
        let planned = self.planned.as_ref();
        if let Some(shared) = planned.and_then(|planned| planned.shapes.get(index)?.clone()) {
            return Ok((shared.built(), Some(shared)));
        }
        let (built, shared) = self.made_shape(body)?;
        if let (Some(planned), Some(shared)) = (planned, &shared) {
            planned.model.keep_shape(shape_rules(self.scene), index, shared.clone());
        }
        Ok((built, shared))
    }

    fn made_shape(&self, body: &adf::RigidBody) -> Result<(BuiltShape, Option<SharedShape>), Arc<MeshError>> {
        let rules = shape_rules(self.scene);
        let key = ShapeKey::new(body, rules);
        // An earlier body may have the same.
        if let Some(shared) = key.as_ref().and_then(shared::find) {
            return Ok((shared.built(), Some(shared)));
        }
        let mesh = match &body.collision {
            CollisionGeometry::Mesh { path, .. } => Some(self.meshes.files.get(path, body.scale)?),
            _ => None,
        };
        let mut built = shape::build(body, mesh.as_deref(), self.meshes, self.scene.profile);
        if rules.is_simplified {
            built.shape = built.shape.simplified();
        }
        let Some(key) = key else {
            let shared = SharedShape::without_files(built);
            return Ok((shared.built(), Some(shared)));
        };
        Ok(match shared::keep(key, body, built, &self.meshes.files) {
            Ok(shared) => (shared.built(), Some(shared)),
            Err(built) => (*built, None),
        })
    }

    /// What collides far out but turns like a point is shot away by any contact: one step cannot follow it. Zero
    /// moments, which don't turn, stay.
    fn bounded_inertia(
        &mut self,
        body: &adf::RigidBody,
        inertia: nalgebra::Vector3<f64>,
        estimate: impl FnOnce() -> nalgebra::Vector3<f64>,
    ) -> nalgebra::Vector3<f64> {
        if self.scene.profile != Profile::Accurate || body.mass <= 0.0 || body.inertia.is_none() {
            return inertia;
        }
        let least = estimate() * MIN_INERTIA;
        let bounded = inertia.zip_map(&least, |moment, least| if moment > 0.0 { moment.max(least) } else { moment });
        if bounded != inertia {
            let message = format!(
                "`{}`: `inertia` is less than {MIN_INERTIA} times that of a solid body of its collision shape, which contacts cannot stand; \
                 that is taken",
                body.common.identifier
            );
            self.note(Severity::Warning, &body.common.source, message);
        }
        bounded
    }

    /// Continuous collision detection: on request, or where the accurate profile can.
    fn set_continuous(&mut self, body: &adf::RigidBody, handle: bullet::BodyHandle) {
        let wanted = body.continuous_collision.unwrap_or(self.scene.profile == Profile::Accurate);
        if body.mass == 0.0 || !wanted || self.scene.world.set_continuous(handle, true) {
            return;
        }
        if body.continuous_collision == Some(true) {
            let message = format!(
                "`{}`: `continuous collision` is not possible: its shape is concave or empty, or its centre of mass lies outside",
                body.common.identifier
            );
            self.note(Severity::Warning, &body.common.source, message);
        }
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

    fn note_displacement(&mut self, body: &adf::RigidBody, offset: &Isometry3<f64>) {
        let distance = offset.translation.vector.norm();
        if matches!(body.collision, CollisionGeometry::Mesh { .. })
            && body.inertial_offset.is_none()
            && distance >= MIN_DISPLACEMENT
        {
            let message = format!(
                "`{}` has no `inertial offset`: its centre of mass is taken from the collision mesh; the C++ program then collides \
                 with the mesh displaced by {} m, here it stays where it is drawn",
                body.common.identifier,
                three_digits(distance)
            );
            self.note(Severity::Warning, &body.common.source, message);
        }
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
        let handle = constraint(joint, frame_a, frame_b, self.scene.joint_erp).and_then(|constraint| {
            self.assembly.add(id, &constraint, joint.assemble);
            let [a, b] = [parent, child].map(|body| self.scene.bodies[body].handle);
            let handle = self.scene.world.add_constraint(a, b, &constraint)?;
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
        let live = Joint::new(joint, key, (parent, child), self.model, ([frame_a, frame_b], axis), handle);
        self.scene.joints.push(live);
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
        self.ignore_foreign_groups();
    }

    /// Keeps bodies from colliding with each other.
    fn ignore_all_pairs(&mut self, apart: &[BodyId]) {
        for (i, &a) in apart.iter().enumerate() {
            for &b in &apart[i + 1..] {
                self.ignore_pair(a, b);
            }
        }
    }

    fn ignore_pair(&mut self, a: BodyId, b: BodyId) {
        let [a, b] = [a, b].map(|body| self.scene.bodies[body].handle);
        self.scene.world.ignore_collision(a, b);
    }

    /// Bodies of different groups that share none never collide; bodies in no group collide with everything.
    fn ignore_foreign_groups(&mut self) {
        let mut members: BTreeMap<&[u32], Vec<BodyId>> = BTreeMap::new();
        for (id, body) in self.scene.bodies.entries() {
            if !body.collision_groups.is_empty() {
                members.entry(&body.collision_groups).or_default().push(id);
            }
        }
        let members: Vec<_> =
            members.into_iter().map(|(groups, m)| (BTreeSet::from_iter(groups.to_vec()), m)).collect();
        for (i, (groups, bodies)) in members.iter().enumerate() {
            for (_, others) in members[i + 1..].iter().filter(|(other, _)| other.is_disjoint(groups)) {
                for &a in bodies {
                    for &b in others {
                        self.ignore_pair(a, b);
                    }
                }
            }
        }
    }

    fn resolve_parents(&mut self) {
        for object in self.scene.all_attached().collect::<Vec<_>>() {
            let text = match object {
                Parent::Body(_) => continue,
                Parent::Camera(index) => &self.scene.cameras[index].parameters.parent_name,
                Parent::Light(index) => &self.scene.lights[index].parameters.parent_name,
                Parent::Ghost(index) => &self.scene.ghosts[index].parent_name,
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
        }
    }
}

/// A positive number below a million with three significant digits, without an exponent.
fn three_digits(number: f64) -> String {
    let digits = (2.0 - number.log10().floor()).clamp(0.0, 12.0);
    format!("{number:.*}", digits as usize)
}

/// The options, completed by the world file.
fn physics(world: &adf::World, options: &PhysicsOptions, notes: &mut Vec<Note>) -> PhysicsOptions {
    options.or(PhysicsOptions::new(&world.physics, |key, name, known| {
        let message = format!("`physics / {key}`: `{name}` is not known, expected one of {known}");
        notes.push(Note { severity: Severity::Error, source: world.common.source.clone(), message, wanted: None });
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_shown_with_three_digits() {
        for (number, text) in [(0.3143, "0.314"), (0.003_677, "0.00368"), (1.234e-5, "0.0000123"), (12.0, "12.0")] {
            assert_eq!(three_digits(number), text);
        }
        assert_eq!((three_digits(0.0), three_digits(1e300).len()), ("0.000000000000".into(), 301));
    }
}
