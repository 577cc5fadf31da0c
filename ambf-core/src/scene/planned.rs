//! What of a model is known before it is built: its shapes that other worlds have, the meshes that it needs.

use std::path::PathBuf;
use std::sync::Arc;

use super::build::Builder;
use super::descriptions::{ShapeRules, SharedModel};
use super::hulls::WantedHulls;
use super::shape::{self, BuiltShape};
use super::shared::{self, ShapeKey, SharedShape};
use super::Scene;
use crate::adf::{self, CollisionGeometry, CollisionMeshKind, Part, PartGeometry, RaySource};
use crate::bullet::Preset;
use crate::control::Profile;
use crate::mesh::MeshError;

/// What the shapes of a scene's bodies depend on. Compounds of one shape become that shape where they may: the
/// trajectories of the C++ program depend on the compound.
fn shape_rules(scene: &Scene) -> ShapeRules {
    let is_simplified = scene.preset == Some(Preset::PyBullet) || scene.profile == Profile::Accurate;
    ShapeRules { profile: scene.profile, is_simplified }
}

/// A model that will be built, and the shapes of its bodies that other worlds have.
#[derive(Debug)]
pub(super) struct PlannedModel {
    pub(super) model: Arc<SharedModel>,
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
                PartGeometry::Primitive(_) | PartGeometry::Triangles(_) => None,
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

impl Builder<'_> {
    /// What collides of the body at `index` of the model's list: as another world has it, if one of the same files does.
    pub(super) fn built_shape(
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
}
