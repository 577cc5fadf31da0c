//! Objects with a pose in a parent: cameras, lights, volumes and, with physics, ghost objects.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::commands::{Commanded, Commands, WithParameters};
use super::gesture::{CameraGesture, CameraPlace};
use super::list::SceneObject;
use super::{Identity, ObjectType, Scene};
use crate::adf;
use crate::comm::{
    CameraParameters, CameraView, Command, Inbox, LightParameters, ObjectKind, PoseCommand, Snapshot, SpotReading,
};
use crate::control::orientation_of;
use crate::ids::{BodyId, CameraId, GhostId, LightId, VolumeId};

/// Objects that a message names: a few are enough to see what went wrong.
const MAX_CANDIDATES: usize = 5;

/// What an object can hang on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parent {
    /// Body frame of a rigid body.
    Body(BodyId),
    /// A camera.
    Camera(CameraId),
    /// A light.
    Light(LightId),
    /// A ghost object.
    Ghost(GhostId),
    /// A volume.
    Volume(VolumeId),
}

/// What cameras, lights, ghost objects and volumes share.
#[derive(Debug, Clone)]
pub struct Attached {
    /// Names and publishing rates.
    pub identity: Identity,
    /// `None`: the world.
    pub parent: Option<Parent>,
    /// Pose in the parent's frame.
    pub pose: Isometry3<f64>,
    /// Pose that a reset returns to.
    pub initial_pose: Isometry3<f64>,
}

impl Attached {
    pub(super) fn new(identity: Identity, pose: Isometry3<f64>) -> Self {
        Self { identity, parent: None, pose, initial_pose: pose }
    }

    pub(super) fn save(&self) -> Isometry3<f64> {
        // All fields by name, so that no new one is forgotten. A parent changes only with the extent.
        let Self { identity: _, parent: _, pose, initial_pose: _ } = self;
        *pose
    }

    /// Back to where it was.
    pub(super) fn reset(&mut self) {
        self.pose = self.initial_pose;
    }

    pub(crate) fn apply_command(&mut self, command: &PoseCommand) {
        if command.enabled {
            self.pose = Isometry3::from_parts(command.position.into(), orientation_of(&command.orientation).0);
        }
    }
}

/// A camera. It looks along its −x axis; +y is right in the picture, +z up.
#[derive(Debug, Clone)]
pub struct Camera {
    /// Names and pose.
    pub attached: Attached,
    /// What clients may change.
    pub parameters: CameraParameters,
    /// The point that it looked at in the beginning, in its parent's frame, m.
    pub look_at: Vector3<f64>,
    /// The point about which it orbits, in its own frame, m.
    pub target: Vector3<f64>,
    /// What it was made from.
    pub description: adf::Camera,
}

impl SceneObject for Camera {
    type Id = CameraId;
    type Saved = (Isometry3<f64>, CameraParameters, Vector3<f64>);
    const TYPE: ObjectType = ObjectType::Camera;
    const RANK: u8 = 1;

    fn identity(&self) -> &Identity {
        &self.attached.identity
    }

    fn kind(&self, id: Self::Id, _scene: &Scene) -> Option<ObjectKind> {
        Some(ObjectKind::Camera(id, Box::new(self.parameters.clone())))
    }

    fn make_room(&self, scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.cameras.push(Isometry3::identity());
        snapshot.views.push(scene.view_of(self));
    }

    fn read(&self, id: Self::Id, scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.cameras[id] = self.attached.pose;
        snapshot.views[id] = scene.view_of(self);
    }

    fn commands(id: Self::Id) -> Option<Box<dyn Commands>> {
        Some(Box::new(WithParameters {
            commands: Commanded {
                id,
                execute: |scene, id, command, _| scene.cameras[id].attached.apply_command(command),
                inbox: Inbox::default(),
            },
            set: Scene::set_camera_parameters,
            parameters: Inbox::default(),
            is_new: false,
        }))
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(scene.global_pose(self.attached.parent, &self.attached.pose))
    }

    /// Where it was, with the target of the beginning. What clients have chosen by parameters stays.
    fn reset(scene: &mut Scene, id: Self::Id) {
        let camera = &mut scene.cameras[id];
        camera.attached.reset();
        camera.target = first_target(&camera.attached.initial_pose, &camera.look_at);
    }

    fn save(&self) -> Self::Saved {
        let Self { attached, parameters, look_at: _, target, description: _ } = self;
        (attached.save(), parameters.clone(), *target)
    }

    fn restore(&mut self, (pose, parameters, target): &Self::Saved) {
        (self.attached.pose, self.target) = (*pose, *target);
        self.parameters.clone_from(parameters);
    }
}

impl Camera {
    /// Moves it as a mouse does.
    pub(crate) fn follow_gesture(&mut self, gesture: CameraGesture) {
        let width = self.parameters.orthographic_view_width;
        let place = CameraPlace { pose: self.attached.pose, target: self.target, width }.moved(gesture);
        (self.attached.pose, self.target) = (place.pose, place.target);
        if self.parameters.orthographic {
            self.parameters.orthographic_view_width = place.width;
        }
    }

    /// Puts it at a pose in its parent's frame, looking at a point at `distance` m.
    pub(crate) fn look_from(&mut self, pose: &Isometry3<f64>, distance: f64) {
        self.attached.pose = *pose;
        self.target = Vector3::new(-distance, 0.0, 0.0);
    }
}

/// What a camera orbits about in the beginning, in its own frame: what it looks at, else a point 1 m ahead.
pub(super) fn first_target(pose: &Isometry3<f64>, look_at: &Vector3<f64>) -> Vector3<f64> {
    let distance = (pose.translation.vector - look_at).norm();
    Vector3::new(if distance > 1e-9 && distance.is_finite() { -distance } else { -1.0 }, 0.0, 0.0)
}

/// A spot light. It shines along its +x axis.
#[derive(Debug, Clone)]
pub struct Light {
    /// Names and pose.
    pub attached: Attached,
    /// What clients may change.
    pub parameters: LightParameters,
    /// What it was made from.
    pub description: adf::Light,
}

impl SceneObject for Light {
    type Id = LightId;
    type Saved = (Isometry3<f64>, LightParameters);
    const TYPE: ObjectType = ObjectType::Light;
    const RANK: u8 = 2;

    fn identity(&self) -> &Identity {
        &self.attached.identity
    }

    fn kind(&self, id: Self::Id, _scene: &Scene) -> Option<ObjectKind> {
        Some(ObjectKind::Light(id, Box::new(self.parameters.clone())))
    }

    fn make_room(&self, scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.lights.push(Isometry3::identity());
        snapshot.spots.push(scene.spot_of(self));
    }

    fn read(&self, id: Self::Id, scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.lights[id] = self.attached.pose;
        snapshot.spots[id] = scene.spot_of(self);
    }

    fn commands(id: Self::Id) -> Option<Box<dyn Commands>> {
        Some(Box::new(WithParameters {
            commands: Commanded {
                id,
                execute: |scene, id, command, _| scene.lights[id].attached.apply_command(command),
                inbox: Inbox::default(),
            },
            set: Scene::set_light_parameters,
            parameters: Inbox::default(),
            is_new: false,
        }))
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(scene.global_pose(self.attached.parent, &self.attached.pose))
    }

    /// Where it was. What clients have chosen by parameters stays.
    fn reset(scene: &mut Scene, id: Self::Id) {
        scene.lights[id].attached.reset();
    }

    fn save(&self) -> Self::Saved {
        let Self { attached, parameters, description: _ } = self;
        (attached.save(), parameters.clone())
    }

    fn restore(&mut self, (pose, parameters): &Self::Saved) {
        self.attached.pose = *pose;
        self.parameters.clone_from(parameters);
    }
}

impl Scene {
    /// What `text` names as the parent of `child`: by its qualified identifier, in the namespace of `child`, else as
    /// part of one. Of a model that is loaded several times the copy of `child` is meant. Several hits of different
    /// types are as bad as several of one, unless exactly one of them is exact.
    ///
    /// # Errors
    /// A clause that says why there is none.
    pub(crate) fn find_parent(&self, child: Parent, text: &str) -> Result<Parent, String> {
        let identity = self.attached(child).map(|attached| &attached.identity);
        let (namespace, suffix) = identity.map_or(("", ""), |identity| (&identity.namespace, &identity.suffix));
        let own = [format!("{namespace}{text}{suffix}"), format!("{text}{suffix}"), format!("{namespace}{text}")];
        let own = own.iter().map(|text| self.parents_named(text)).find(|found| !found.is_empty()).unwrap_or_default();
        let exactly = self.parents_named(text);
        match (own.as_slice(), exactly.as_slice(), self.parents_with(text).as_slice()) {
            (&[parent], ..) | ([], &[parent], _) | ([], [], &[parent]) => Ok(parent),
            _ => {
                let is_exact = !exactly.is_empty();
                Err(match self.candidates(text, is_exact) {
                    candidates if candidates.is_empty() => "not found".to_owned(),
                    candidates if is_exact => format!("the name of several: {}", candidates.join(", ")),
                    candidates => format!("part of several: {}", candidates.join(", ")),
                })
            }
        }
    }

    /// What of each type others may hang on has exactly the name `text`.
    fn parents_named(&self, text: &str) -> Vec<Parent> {
        let body = self.bodies.names.exact(text).map(Parent::Body);
        let camera = self.cameras.names.exact(text).map(Parent::Camera);
        let light = self.lights.names.exact(text).map(Parent::Light);
        let ghost = self.ghosts.names.exact(text).map(Parent::Ghost);
        let volume = self.volumes.names.exact(text).map(Parent::Volume);
        [body, camera, light, ghost, volume].into_iter().flatten().collect()
    }

    /// What of each type others may hang on is named by `text`, its whole name or a part that no other has.
    fn parents_with(&self, text: &str) -> Vec<Parent> {
        let body = self.bodies.names.id(text).map(Parent::Body);
        let camera = self.cameras.names.id(text).map(Parent::Camera);
        let light = self.lights.names.id(text).map(Parent::Light);
        let ghost = self.ghosts.names.id(text).map(Parent::Ghost);
        let volume = self.volumes.names.id(text);
        // A volume hangs on the body that carries it, which has its name, too: the volume is meant.
        let is_carrier = |parent: &Parent| match (parent, volume) {
            (Parent::Body(body), Some(volume)) => {
                let carrier = &self.volumes[volume].description.parent;
                carrier.ends_with(" (volume)") && self.bodies[*body].identity.key().ends_with(carrier.as_str())
            }
            _ => false,
        };
        let body = body.filter(|body| !is_carrier(body));
        [body, camera, light, ghost, volume.map(Parent::Volume)].into_iter().flatten().collect()
    }

    /// What of each type has the name `text`, or with `is_exact` false holds it: a few in lexicographic order, as a
    /// message shows them.
    fn candidates<'a>(&'a self, text: &str, is_exact: bool) -> Vec<String> {
        let holds = |key: &&str| if is_exact { *key == text } else { key.contains(text) };
        let mut found: Vec<(&'a str, &str)> = Vec::new();
        let mut add = |keys: Vec<&'a str>, kind| found.extend(keys.into_iter().map(|key| (key, kind)));
        add(self.bodies.names.keys().filter(holds).take(MAX_CANDIDATES).collect(), "body");
        add(self.cameras.names.keys().filter(holds).take(MAX_CANDIDATES).collect(), "camera");
        add(self.lights.names.keys().filter(holds).take(MAX_CANDIDATES).collect(), "light");
        add(self.ghosts.names.keys().filter(holds).take(MAX_CANDIDATES).collect(), "ghost object");
        add(self.volumes.names.keys().filter(holds).take(MAX_CANDIDATES).collect(), "volume");
        found.sort_unstable();
        // The type matters only where a name is that of objects of several types.
        let is_of_two = |key: &str| found.iter().filter(|(other, _)| *other == key).count() > 1;
        let shown = |&(key, kind): &(&str, &str)| match is_of_two(key) {
            true => format!("`{key}` ({kind})"),
            false => format!("`{key}`"),
        };
        found.iter().take(MAX_CANDIDATES).map(shown).collect()
    }

    /// Hangs `child` on what `text` names. An empty text changes nothing.
    ///
    /// # Errors
    /// A sentence that says why the parent stays what it was.
    pub(crate) fn set_parent(&mut self, child: Parent, text: &str) -> Result<(), String> {
        if text.is_empty() {
            return Ok(());
        }
        let refuse = |scene: &Self, why: String| {
            let key = scene.attached(child).map(|attached| attached.identity.key()).unwrap_or_default();
            Err(format!("`{key}`: parent `{text}` is {why}; it stays where it is"))
        };
        let parent = match self.find_parent(child, text) {
            Ok(parent) => parent,
            Err(why) => return refuse(self, why),
        };
        let mut above = Some(parent);
        while let Some(link) = above {
            if link == child {
                return refuse(self, "itself or hangs on it".into());
            }
            above = self.attached(link).and_then(|attached| attached.parent);
        }
        if let Some(attached) = self.attached_mut(child) {
            attached.parent = Some(parent);
        }
        Ok(())
    }

    /// Pose in the world of a pose in `parent`.
    pub fn global_pose(&self, parent: Option<Parent>, local: &Isometry3<f64>) -> Isometry3<f64> {
        let (mut pose, mut above) = (*local, parent);
        while let Some(link) = above {
            match self.attached(link) {
                // Loops are refused in `set_parent`.
                Some(attached) => (pose, above) = (attached.pose * pose, attached.parent),
                None => {
                    if let Parent::Body(body) = link {
                        pose = self.bodies[body].pose(&self.world) * pose;
                    }
                    above = None;
                }
            }
        }
        pose
    }

    /// What a picture of `camera` depends on.
    pub(super) fn view_of(&self, camera: &Camera) -> CameraView {
        let CameraParameters { near_plane, far_plane, field_view_angle, orthographic_view_width, .. } =
            camera.parameters;
        let is_stereo = camera.parameters.stereo && !camera.parameters.orthographic;
        CameraView {
            pose: self.global_pose(camera.attached.parent, &camera.attached.pose),
            parent: self.global_pose(camera.attached.parent, &Isometry3::identity()),
            near_plane,
            far_plane,
            field_view_angle,
            orthographic_view_width: camera.parameters.orthographic.then_some(orthographic_view_width),
            stereo: is_stereo
                .then_some((camera.parameters.stereo_eye_separation, camera.parameters.stereo_focal_length)),
        }
    }

    /// Where `light` shines.
    pub(super) fn spot_of(&self, light: &Light) -> SpotReading {
        let pose = self.global_pose(light.attached.parent, &light.attached.pose);
        SpotReading { pose, cutoff_angle: light.parameters.cutoff_angle }
    }

    /// `None` for a body.
    fn attached(&self, object: Parent) -> Option<&Attached> {
        match object {
            Parent::Body(_) => None,
            Parent::Camera(index) => Some(&self.cameras[index].attached),
            Parent::Light(index) => Some(&self.lights[index].attached),
            Parent::Ghost(index) => Some(&self.ghosts[index].attached),
            Parent::Volume(index) => Some(&self.volumes[index].attached),
        }
    }

    pub(super) fn attached_mut(&mut self, object: Parent) -> Option<&mut Attached> {
        match object {
            Parent::Body(_) => None,
            Parent::Camera(index) => Some(&mut self.cameras[index].attached),
            Parent::Light(index) => Some(&mut self.lights[index].attached),
            Parent::Ghost(index) => Some(&mut self.ghosts[index].attached),
            Parent::Volume(index) => Some(&mut self.volumes[index].attached),
        }
    }

    /// Cameras, lights, ghost objects and volumes.
    pub(super) fn all_attached(&self) -> impl Iterator<Item = Parent> {
        let cameras = self.cameras.ids().map(Parent::Camera);
        let placed = cameras.chain(self.lights.ids().map(Parent::Light)).chain(self.ghosts.ids().map(Parent::Ghost));
        placed.chain(self.volumes.ids().map(Parent::Volume))
    }

    /// Takes over what a client changed of a camera; a sentence when its parent is not found.
    pub(crate) fn set_camera_parameters(&mut self, id: CameraId, parameters: &CameraParameters) -> Result<(), String> {
        self.cameras[id].parameters.copy_from(parameters);
        self.set_parent(Parent::Camera(id), &parameters.parent_name)
    }

    /// Takes over what a client changed of a light; a sentence when its parent is not found.
    pub(crate) fn set_light_parameters(&mut self, id: LightId, parameters: &LightParameters) -> Result<(), String> {
        self.lights[id].parameters.copy_from(parameters);
        self.set_parent(Parent::Light(id), &parameters.parent_name)
    }
}

pub(super) fn camera_parameters(camera: &adf::Camera) -> CameraParameters {
    CameraParameters {
        near_plane: camera.clipping_plane.0,
        far_plane: camera.clipping_plane.1,
        field_view_angle: camera.field_view_angle,
        orthographic_view_width: camera.orthographic_view_width.unwrap_or(0.0),
        stereo_eye_separation: camera.stereo.as_ref().map_or(0.2, |stereo| stereo.eye_separation),
        stereo_focal_length: camera.stereo.as_ref().map_or(0.5, |stereo| stereo.focal_length),
        orthographic: camera.orthographic_view_width.is_some(),
        stereo: camera.stereo.is_some(),
        parent_name: camera.parent.clone(),
    }
}

/// Pose of a camera at `location` that looks at `look_at`; identity when the three vectors span no view.
pub(super) fn camera_pose(location: &Vector3<f64>, look_at: &Vector3<f64>, up: &Vector3<f64>) -> Isometry3<f64> {
    let view = || {
        let x = (location - look_at).try_normalize(1e-12)?;
        let y = up.cross(&x).try_normalize(1e-12)?;
        Some(Matrix3::from_columns(&[x, y, x.cross(&y)]))
    };
    match view() {
        Some(columns) => Isometry3::from_parts((*location).into(), rotation(columns)),
        None => Isometry3::identity(),
    }
}

/// Rotation that turns +x to `direction`: the other axes are chosen with z, or y where that is further from
/// `direction`.
pub(super) fn light_rotation(direction: &Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let x = (direction.norm_squared() >= 1e-4).then(|| direction.normalize())?;
    let (z_sine, y_sine) = (x.cross(&Vector3::z()).norm(), x.cross(&Vector3::y()).norm());
    let other = if z_sine > y_sine { Vector3::z() } else { Vector3::y() };
    let y = x.cross(&other).normalize();
    Some(rotation(Matrix3::from_columns(&[x, y, x.cross(&y).normalize()])))
}

fn rotation(columns: Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_looks_along_minus_x_with_z_up() {
        let pose = camera_pose(&Vector3::new(3.0, 0.0, 1.0), &Vector3::new(0.0, 0.0, 1.0), &Vector3::z());
        assert!((pose.rotation * -Vector3::x() - -Vector3::x()).norm() < 1e-12);
        assert!((pose.rotation * Vector3::z() - Vector3::z()).norm() < 1e-12);
        let above = camera_pose(&Vector3::z(), &Vector3::zeros(), &Vector3::z());
        assert_eq!(above, Isometry3::identity(), "up along the view");
    }

    #[test]
    fn a_light_shines_along_x_in_any_direction() {
        for direction in [-Vector3::z(), Vector3::y() * 3.0, Vector3::new(1.0, -2.0, 0.5)] {
            let turned = light_rotation(&direction).unwrap() * Vector3::x();
            assert!((turned - direction.normalize()).norm() < 1e-12);
        }
        assert!(light_rotation(&Vector3::zeros()).is_none());
    }
}
