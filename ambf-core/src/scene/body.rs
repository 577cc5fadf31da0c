//! A live rigid body: what its description became, and what acts on it.

use std::ops::{Deref, DerefMut};

use nalgebra::{Isometry3, Vector3};
use slotmap::SecondaryMap;

use super::list::SceneObject;
use super::targets::BodyTarget;
use super::{Identity, ObjectType, Objects, Scene};
use crate::adf::{Gains, SourcePos};
use crate::bullet::{BodyHandle, BodySurface, World};
use crate::comm::{BodyKinematics, CartesianCommandType, ObjectKind, RigidBodyCommand, Snapshot};
use crate::control::{orientation_of, CartesianController, CartesianOutput};
use crate::ids::BodyId;

/// A rigid body of a [`Scene`](super::Scene).
#[derive(Debug, Clone)]
pub struct Body {
    /// Names and publishing rates.
    pub identity: Identity,
    /// kg; 0: static.
    pub mass: f64,
    /// Principal moments about the axes of the inertial frame, kg·m².
    pub inertia: Vector3<f64>,
    /// Pose of the inertial frame in the body frame.
    pub inertial_offset: Isometry3<f64>,
    /// Pose of the body frame in the inertial frame.
    pub inertial_offset_inverse: Isometry3<f64>,
    /// Initial pose of the inertial frame in the world; resets return to it.
    pub initial_pose: Isometry3<f64>,
    /// Own or model's gravity, m/s²; `None`: the world's.
    pub gravity: Option<Vector3<f64>>,
    /// Coefficients of friction and restitution.
    pub surface: BodySurface,
    /// Shares of the linear and the angular velocity that are lost in 1 s.
    pub damping: [f64; 2],
    /// Colour instead of that of its description: red, green, blue, opacity, 0 to 1.
    pub color: Option<[f32; 4]>,
    /// Scale of joint pivots.
    pub scale: f64,
    /// Collision groups.
    pub collision_groups: Vec<u32>,
    /// Names of children in the state before a client asks.
    pub publish_children_names: bool,
    /// Names of joints in the state before a client asks.
    pub publish_joint_names: bool,
    /// Joint positions, velocities and efforts in the state before a client asks.
    pub publish_joint_positions: bool,
    /// Where it is defined.
    pub source: SourcePos,
    /// It was taken out of the scene by itself; see also [`ModelInfo::removed`](super::ModelInfo::removed).
    pub removed: bool,
    pub(crate) handle: BodyHandle,
    /// Type of the latest command; a device moves the body only while it is force.
    pub(crate) control: CartesianCommandType,
    pub(crate) controller: CartesianController,
    pub(crate) target: BodyTarget,
}

/// What of a [`Body`] changes while the simulation runs, beside what Bullet knows.
#[derive(Debug, Clone)]
pub(super) struct SavedBody {
    parameters: SavedParameters,
    control: CartesianCommandType,
    controller: CartesianController,
    target: BodyTarget,
}

/// What of a [`Body`] changes when it is [told to](super::ParameterChange).
#[derive(Debug, Clone)]
struct SavedParameters {
    mass: f64,
    inertia: Vector3<f64>,
    gravity: Option<Vector3<f64>>,
    surface: BodySurface,
    damping: [f64; 2],
}

/// Cartesian commands closer than this to the pose of a static body leave it alone: m and rad.
const SAME_POSE: (f64, f64) = (1e-5, 1e-4);

/// All rigid bodies, each at the index that it has in Bullet's world. One that was removed keeps its place: its handle
/// leads nowhere.
#[derive(Debug, Default)]
pub struct Bodies {
    list: Objects<BodyId, Body>,
    places: SecondaryMap<BodyHandle, BodyId>,
}

impl Bodies {
    pub(super) fn push(&mut self, body: Body) -> BodyId {
        if let Some(before) = self.list.get(self.list.next_id()) {
            self.places.remove(before.handle);
        }
        let handle = body.handle;
        let id = self.list.push(body);
        self.places.insert(handle, id);
        id
    }

    /// The body behind a handle of Bullet's world.
    pub fn id_of(&self, handle: BodyHandle) -> Option<BodyId> {
        self.places.get(handle).copied()
    }
}

impl Deref for Bodies {
    type Target = Objects<BodyId, Body>;

    fn deref(&self) -> &Self::Target {
        &self.list
    }
}

impl DerefMut for Bodies {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.list
    }
}

impl SceneObject for Body {
    type Id = BodyId;
    type Saved = SavedBody;
    const TYPE: ObjectType = ObjectType::Body;
    const RANK: u8 = 3;
    const RESETS_WITH_BODIES: bool = true;

    fn identity(&self) -> &Identity {
        &self.identity
    }

    fn kind(&self, id: Self::Id, scene: &Scene) -> Option<ObjectKind> {
        Some(ObjectKind::RigidBody(id, Box::new(scene.body_info(id))))
    }

    fn stands_on(&self, id: Self::Id) -> Option<BodyId> {
        Some(id)
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(Body::pose(self, &scene.world))
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.bodies.push(BodyKinematics::default());
    }

    /// At the initial pose, at rest, with its own gravity.
    fn reset(scene: &mut Scene, id: Self::Id) {
        let Scene { bodies, world, .. } = scene;
        let body = &mut bodies[id];
        world.reset_body(body.handle, &body.initial_pose, body.gravity.as_ref());
        body.controller.reset();
        body.target.reset();
    }

    fn save(&self) -> SavedBody {
        // All fields by name, so that no new one is forgotten.
        let Self {
            identity: _,
            mass,
            inertia,
            inertial_offset: _,
            inertial_offset_inverse: _,
            initial_pose: _,
            gravity,
            surface,
            damping,
            // It is not of the physics.
            color: _,
            scale: _,
            collision_groups: _,
            publish_children_names: _,
            publish_joint_names: _,
            publish_joint_positions: _,
            source: _,
            removed: _,
            handle: _,
            control,
            controller,
            target,
        } = self;
        let parameters =
            SavedParameters { mass: *mass, inertia: *inertia, gravity: *gravity, surface: *surface, damping: *damping };
        SavedBody { parameters, control: *control, controller: controller.clone(), target: target.clone() }
    }

    fn restore(&mut self, saved: &SavedBody) {
        let SavedBody { parameters, control, controller, target } = saved;
        let SavedParameters { mass, inertia, gravity, surface, damping } = parameters.clone();
        (self.mass, self.inertia, self.gravity, self.surface, self.damping) =
            (mass, inertia, gravity, surface, damping);
        self.control = *control;
        self.controller.clone_from(controller);
        self.target.clone_from(target);
    }
}

impl Body {
    /// Pose of the body frame in the world as reported: from the motion state, up to one sub-step old.
    pub fn pose(&self, world: &World) -> Isometry3<f64> {
        world.motion_state(self.handle).unwrap_or(self.initial_pose) * self.inertial_offset_inverse
    }

    /// Gains of the controller of its pose: linear and angular.
    pub fn gains(&self) -> [Gains; 2] {
        let settings = self.controller.settings();
        [settings.linear.gains, settings.angular.gains]
    }

    /// Whether forces move it.
    pub fn is_dynamic(&self) -> bool {
        self.mass != 0.0
    }

    /// Applies the Cartesian part of a command at once, as the legacy profile does. `dt` is the interval before, s.
    pub(crate) fn apply_command(&mut self, world: &mut World, command: &RigidBodyCommand, dt: f64) {
        match command.cartesian {
            CartesianCommandType::Force => world.apply_wrench(self.handle, &command.force, &command.torque),
            CartesianCommandType::Position => {
                let (orientation, _) = orientation_of(&command.orientation);
                let target = Isometry3::from_parts(command.position.into(), orientation);
                self.apply_pose(world, &target, dt);
            }
            CartesianCommandType::Velocity => {
                self.apply_velocity(world, &command.linear_velocity, &command.angular_velocity, dt);
            }
            CartesianCommandType::Unknown(_) => (),
        }
    }

    /// Sets the pose of a static body, or lets the Cartesian controller of a dynamic one follow `target` (body frame in
    /// the world).
    pub(crate) fn apply_pose(&mut self, world: &mut World, target: &Isometry3<f64>, dt: f64) {
        if self.mass == 0.0 {
            let wanted = target * self.inertial_offset;
            let Some(current) = world.pose(self.handle) else { return };
            let moved = (wanted.translation.vector - current.translation.vector).norm() > SAME_POSE.0;
            if moved || wanted.rotation.angle_to(&current.rotation) > SAME_POSE.1 {
                world.set_pose(self.handle, &wanted);
            }
            return;
        }
        match self.controller.update(&self.pose(world), target, dt) {
            CartesianOutput::Wrench(force, torque) => world.apply_wrench(self.handle, &force, &torque),
            CartesianOutput::Velocity(linear, angular) => world.set_velocity(self.handle, &linear, &angular),
        }
    }

    /// Sets the velocity of a dynamic body, m/s and rad/s; moves a static one by it for `dt` s.
    pub(crate) fn apply_velocity(&self, world: &mut World, linear: &Vector3<f64>, angular: &Vector3<f64>, dt: f64) {
        if self.mass != 0.0 {
            world.set_velocity(self.handle, linear, angular);
            return;
        }
        if linear.norm_squared() == 0.0 && angular.norm_squared() == 0.0 {
            return;
        }
        let pose = self.pose(world);
        let turned = angular * dt;
        let step = nalgebra::UnitQuaternion::from_euler_angles(turned.x, turned.y, turned.z);
        let moved = Isometry3::from_parts((pose.translation.vector + linear * dt).into(), step * pose.rotation);
        world.set_pose(self.handle, &(moved * self.inertial_offset));
    }
}
