//! What is worth saying about the elements of a model.

use ambf_core::adf::{
    Actuator, Axis, CollisionGeometry, CollisionMeshKind, Common, GhostObject, ImageStack, Joint, JointKind, Model,
    Part, PartGeometry, Primitive, RaySource, RigidBody, Sensor, SensorKind, SoftBody, Vehicle, Visual, VisualGeometry,
    Volume, WheelVisual,
};
use ambf_core::mesh;
use ambf_core::scene::NameMap;
use nalgebra::Isometry3;

use super::finding::Level;
use super::original;
use super::pass::Pass;
use super::view;

/// Images of a stack that are looked for.
const MAX_IMAGES: u32 = 10_000;

/// Walks over a model.
pub(super) fn model(pass: &mut Pass<'_>, model: &Model) {
    let bodies = Bodies::of(model);
    let whole = pass.outline.root().source();
    model.bodies.iter().for_each(|body| rigid_body(pass, body));
    model.soft_bodies.iter().for_each(|body| soft_body(pass, body));
    model.ghosts.iter().for_each(|ghost| ghost_object(pass, ghost, model));
    model.sensors.iter().for_each(|s| sensor(pass, s, &bodies));
    model.actuators.iter().for_each(|a| actuator(pass, a, &bodies));
    model.joints.iter().for_each(|j| joint(pass, j));
    model.vehicles.iter().for_each(|v| vehicle(pass, v, &bodies));
    view::cameras(pass, &model.cameras);
    view::lights(pass, &model.lights);
    model.volumes.iter().for_each(|v| volume(pass, v));
    pass.shaders(&whole, &["shaders"], model.shaders.as_ref());
    pass.plugins(&["plugins"], &model.plugins);
}

/// The bodies of a model by qualified identifier.
struct Bodies<'m> {
    names: NameMap<usize>,
    bodies: &'m [RigidBody],
}

impl<'m> Bodies<'m> {
    fn of(model: &'m Model) -> Self {
        let mut names = NameMap::default();
        for (index, body) in model.bodies.iter().enumerate() {
            names.insert(&format!("{}{}", body.common.namespace, body.common.identifier), index);
        }
        Self { names, bodies: &model.bodies }
    }

    fn exact(&self, text: &str) -> Option<usize> {
        self.names.exact(text)
    }

    /// The body that an element of `namespace` means by `text`.
    fn find(&self, text: &str, namespace: &str) -> Option<&'m RigidBody> {
        let exact = self.exact(text).or_else(|| self.exact(&format!("{namespace}{text}")));
        exact.or_else(|| self.names.find(text).id()).map(|index| &self.bodies[index])
    }
}

fn is_identity(pose: &Isometry3<f64>) -> bool {
    pose.translation.vector.norm() < 1e-12 && is_unturned(pose)
}

fn is_unturned(pose: &Isometry3<f64>) -> bool {
    pose.rotation.angle() < 1e-12
}

fn rigid_body(pass: &mut Pass<'_>, body: &RigidBody) {
    let common = &body.common;
    pass.common(common, true);
    let collision = match &body.collision {
        CollisionGeometry::Mesh { path, .. } => {
            let key = if has(pass, common, "collision mesh") { "collision mesh" } else { "mesh" };
            pass.mesh(Level::Error, common, key, path, "the body is dropped");
            Some(path)
        }
        CollisionGeometry::Parts { parts, .. } => {
            parts.iter().for_each(|p| part(pass, Level::Error, common, p, "it collides with nothing"));
            None
        }
        _ => None,
    };
    visual(pass, common, &body.visual, collision);
    if matches!(body.collision, CollisionGeometry::Mesh { kind: CollisionMeshKind::ConvexDecomposition(_), .. }) {
        pass.differs(&original::CONVEX_DECOMPOSITION, &common.identifier);
    }
    if body.collision == CollisionGeometry::None && body.inertia.is_none() && body.mass > 0.0 {
        pass.differs(&original::EMPTY_INERTIA, &common.identifier);
    }
}

fn has(pass: &Pass<'_>, common: &Common, key: &str) -> bool {
    pass.entry(&common.identifier).is_some_and(|entry| entry.get(key).is_some())
}

/// What is drawn; nothing more is said about a mesh that was looked for already.
fn visual(pass: &mut Pass<'_>, common: &Common, visual: &Visual, known: Option<&std::path::PathBuf>) {
    match &visual.geometry {
        VisualGeometry::Mesh { path } if Some(path) != known => {
            pass.mesh(Level::Warning, common, "mesh", path, "it is not drawn");
        }
        VisualGeometry::Primitive(primitive) => drawn_primitive(pass, common, primitive),
        VisualGeometry::Compound(parts) => {
            if parts.iter().any(|part| !is_identity(&part.offset)) {
                pass.differs(&original::COMPOUND_OFFSET, &common.identifier);
            }
            parts.iter().for_each(|part| drawn_primitive(pass, common, &part.primitive));
        }
        VisualGeometry::Parts(parts) => {
            for drawn in parts {
                part(pass, Level::Warning, common, &drawn.part, "it is not drawn");
                pass.material(drawn.material.as_ref());
            }
        }
        VisualGeometry::Mesh { .. } | VisualGeometry::None => (),
    }
    if !visual.visible && visual.material.is_none() {
        pass.differs(&original::HIDDEN, &common.identifier);
    }
    pass.material(visual.material.as_ref());
    let place = pass.place(common, "shaders");
    pass.shaders(&place, &[&common.identifier, "shaders"], visual.shaders.as_ref());
}

/// A part of a body of a robot description.
fn part(pass: &mut Pass<'_>, level: Level, common: &Common, part: &Part, consequence: &str) {
    if let PartGeometry::Mesh { path, .. } = &part.geometry {
        pass.mesh(level, common, "mesh", path, consequence);
    }
}

fn drawn_primitive(pass: &mut Pass<'_>, common: &Common, primitive: &Primitive) {
    match primitive {
        Primitive::Capsule { .. } => pass.differs(&original::CAPSULE_DRAWN, &common.identifier),
        Primitive::Cylinder { axis, .. } | Primitive::Cone { axis, .. } if *axis != Axis::Z => {
            pass.differs(&original::AXIS_DRAWN, &common.identifier);
        }
        _ => (),
    }
}

fn joint(pass: &mut Pass<'_>, joint: &Joint) {
    let common = &joint.common;
    pass.common(common, false);
    if has(pass, common, "enable motor") {
        if !has(pass, common, "enable feedback") {
            pass.differs(&original::ENABLE_MOTOR_ALONE, &common.identifier);
        } else if joint.enable_motor != joint.enable_feedback {
            pass.differs(&original::ENABLE_MOTOR, &common.identifier);
        }
    }
    let is_spring = matches!(joint.kind, JointKind::LinearSpring | JointKind::TorsionSpring);
    if is_spring && joint.limits.is_none() {
        pass.differs(&original::SPRING_LOCKED, &common.identifier);
    }
    if has(pass, common, "drive train") {
        pass.differs(&original::DRIVE_TRAIN, &common.identifier);
    }
    if joint.coupling.is_some() {
        pass.differs(&original::COUPLING, &common.identifier);
    }
}

fn sensor(pass: &mut Pass<'_>, sensor: &Sensor, bodies: &Bodies<'_>) {
    let common = &sensor.common;
    let identifier = &common.identifier;
    pass.common(common, true);
    parent(pass, common, &sensor.parent, bodies);
    if common.plugins.iter().any(|plugin| plugin.path.is_some()) {
        pass.differs(&original::SENSOR_PLUGIN, identifier);
    }
    if let SensorKind::Resistance(parameters) = &sensor.kind {
        if !common.passive {
            pass.differs(&original::RESISTANCE_SILENT, identifier);
        }
        if !is_unturned(&sensor.location) {
            pass.differs(&original::RESISTANCE_NORMAL, identifier);
        }
        if parameters.contact_damping != 0.0 {
            pass.differs(&original::RESISTANCE_DAMPING, identifier);
        }
    }
    if matches!(sensor.kind, SensorKind::Contact { .. }) {
        pass.differs(&original::CONTACT_SENSOR, identifier);
    }
    match &sensor.rays {
        RaySource::Mesh { candidates } => {
            match pass.files.first_mesh(candidates) {
                None => {
                    let first = candidates.first().map(|path| path.display().to_string()).unwrap_or_default();
                    let why = format!("neither {first} nor one below the resolution paths exists");
                    pass.missing(Level::Error, common, "mesh", &why, "the sensor has no rays and is dropped");
                    return;
                }
                Some(0) => (),
                Some(_) => pass.differs(&original::SENSOR_MESH, identifier),
            }
            pass.differs(&original::MESH_RAYS, identifier);
        }
        RaySource::Parametric { .. } if !is_identity(&sensor.location) => {
            pass.differs(&original::PARAMETRIC_TWICE, identifier);
        }
        RaySource::Parametric { .. } | RaySource::Array(_) => (),
    }
}

/// The C++ program looks for the parents of sensors and actuators without their namespace.
fn parent(pass: &mut Pass<'_>, common: &Common, text: &str, bodies: &Bodies<'_>) {
    let qualified = format!("{}{text}", common.namespace);
    let needs_namespace = bodies.exact(text).is_none() && bodies.exact(&qualified).is_some();
    if needs_namespace && bodies.names.find(text).id().is_none() {
        pass.differs(&original::SHORT_PARENT, &common.identifier);
    }
}

fn actuator(pass: &mut Pass<'_>, actuator: &Actuator, bodies: &Bodies<'_>) {
    let common = &actuator.common;
    pass.common(common, true);
    parent(pass, common, &actuator.parent, bodies);
    let has_offset = |body: &RigidBody| match &body.inertial_offset {
        Some(offset) => !is_identity(offset),
        None => matches!(body.collision, CollisionGeometry::Mesh { .. }),
    };
    if bodies.find(&actuator.parent, &common.namespace).is_some_and(has_offset) {
        pass.differs(&original::ACTUATOR_FRAME, &common.identifier);
    }
    for difference in [&original::ACTUATOR_LIMIT, &original::ACTUATOR_TAU] {
        if has(pass, common, difference.key) {
            pass.differs(difference, &common.identifier);
        }
    }
}

fn vehicle(pass: &mut Pass<'_>, vehicle: &Vehicle, bodies: &Bodies<'_>) {
    let common = &vehicle.common;
    pass.common(common, true);
    if bodies.find(&vehicle.chassis, &common.namespace).is_some() {
        pass.differs(&original::CHASSIS_SAME_FILE, &common.identifier);
    }
    for wheel in &vehicle.wheels {
        let WheelVisual::Mesh(candidates) = &wheel.visual else { continue };
        match pass.files.first_mesh(candidates) {
            Some(0) => (),
            Some(_) => pass.differs(&original::WHEEL_MESH, &common.identifier),
            None => {
                let name = candidates.first().map(|path| path.display().to_string()).unwrap_or_default();
                let sentence = format!("names the mesh {name}, which is nowhere; the wheel is not drawn");
                let path = [common.identifier.as_str(), "wheels"];
                pass.say(Level::Warning, "missing file", wheel.source.clone(), &path, &sentence);
            }
        }
    }
}

fn ghost_object(pass: &mut Pass<'_>, ghost: &GhostObject, model: &Model) {
    let common = &ghost.common;
    pass.common(common, false);
    let collision = match &ghost.collision {
        CollisionGeometry::Mesh { path, .. } => {
            let key = if has(pass, common, "collision mesh") { "collision mesh" } else { "mesh" };
            pass.mesh(Level::Error, common, key, path, "the ghost object is dropped");
            Some(path)
        }
        _ => None,
    };
    visual(pass, common, &ghost.visual, collision);
    if !ghost.collision_groups.is_empty() {
        pass.differs(&original::GHOST_GROUPS, &common.identifier);
    }
    if model.gravity.is_some() || model.bodies.iter().any(|body| body.gravity.is_some()) {
        pass.differs(&original::GHOST_GRAVITY, &common.identifier);
    }
}

fn soft_body(pass: &mut Pass<'_>, body: &SoftBody) {
    let common = &body.common;
    let identifier = &common.identifier;
    pass.common(common, false);
    let key = if has(pass, common, "collision mesh") { "collision mesh" } else { "mesh" };
    pass.mesh(Level::Error, common, key, &body.collision_mesh, "the soft body is dropped");
    visual(pass, common, &body.visual, Some(&body.collision_mesh));
    let randomize = pass.entry(identifier).and_then(|entry| entry.get("randomize constraints")?.text());
    if randomize.is_some_and(|text| ["n", "no", "false", "off"].contains(&text.to_lowercase().as_str())) {
        pass.differs(&original::RANDOMIZE, identifier);
    }
    if !body.collision_mesh.is_file() {
        return;
    }
    let mesh = match mesh::load(&body.collision_mesh) {
        Ok(mesh) => mesh,
        Err(error) => {
            pass.missing(Level::Error, common, key, &error.to_string(), "the soft body is dropped");
            return;
        }
    };
    if mesh.sub_meshes.len() > 1 {
        pass.differs(&original::SOFT_PARTS, identifier);
    }
    let Some(part) = mesh.sub_meshes.last() else { return };
    let is_first = |vertex: &u32| part.file_vertices.binary_search(&(*vertex, 0)).is_ok();
    if body.config.fixed_nodes.iter().any(is_first) {
        pass.differs(&original::NODE_ZERO, identifier);
    }
}

fn volume(pass: &mut Pass<'_>, volume: &Volume) {
    let common = &volume.common;
    pass.common(common, false);
    match &volume.images {
        Some(images) => image_stack(pass, common, images),
        None => pass.differs(&original::VOLUME_EMPTY, &common.identifier),
    }
    pass.material(volume.material.as_ref());
    let place = pass.place(common, "shaders");
    pass.shaders(&place, &[&common.identifier, "shaders"], volume.shaders.as_ref());
}

/// One message for all images that are missing.
fn image_stack(pass: &mut Pass<'_>, common: &Common, images: &ImageStack) {
    let looked_for = images.count.min(MAX_IMAGES);
    let mut missing = Vec::new();
    for index in 0..looked_for {
        let is_there = images.candidates(index).find(|file| file.is_file());
        let file = is_there.or_else(|| images.candidates(index).next());
        missing.extend(file.and_then(|file| pass.files.other(&file)));
    }
    let Some(first) = missing.first() else { return };
    if missing.len() == looked_for as usize {
        let why = format!("none of {looked_for} images is there, the first: {first}");
        return pass.missing(Level::Warning, common, "images", &why, "the volume is not drawn");
    }
    let sentence = format!("{} of {looked_for} images are missing and left out, the first: {first}", missing.len());
    pass.say(Level::Warning, "missing file", pass.place(common, "images"), &[&common.identifier, "images"], &sentence);
}
