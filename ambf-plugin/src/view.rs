use ambf_model::adf::VolumeTool;
use nalgebra::{Isometry3, Vector3};

use super::{BodyState, Clock, Command, CommandError, Hit, JointFrame, JointState, Subject, ToolState, Touch};
use crate::JointCommandType;
use crate::{ObjectId, ObjectType};

/// Which text of an object is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextOf {
    /// Its name.
    Name,
    /// Its qualified identifier.
    Identifier,
    /// The file that describes it.
    File,
}

/// Queries and commands: the host's simulation itself, or the same through the C interface. `kind`: a type of
/// objects, or `None` for models.
pub trait Access {
    /// What follows is done for the plugin with this number.
    fn act_as(&mut self, _plugin: u64) {}
    /// Undoes what outlives a plugin's calls: its attachments.
    fn release(&mut self, _plugin: u64) {}
    /// Simulated and real time.
    fn clock(&self) -> Clock;
    /// Number of objects of a type, removed ones included.
    fn count(&self, kind: Option<ObjectType>) -> usize;
    /// Index of the object whose name or identifier is `text`.
    fn find(&self, kind: Option<ObjectType>, text: &str) -> Option<usize>;
    /// A text of an object.
    fn text(&self, what: TextOf, kind: Option<ObjectType>, index: usize) -> Option<String>;
    /// Index of the model to which an object belongs.
    fn model_of(&self, object: ObjectId) -> Option<usize>;
    /// State of a rigid body.
    fn body(&self, index: usize) -> Option<BodyState>;
    /// State of a joint.
    fn joint(&self, index: usize) -> Option<JointState>;
    /// Where a joint with one coordinate is; `None` for others, and through the C interface.
    fn joint_frame(&self, _index: usize) -> Option<JointFrame> {
        None
    }
    /// Gravity that acts on a body, m/s², world axes; `None` when there is no such body, and through the C interface.
    fn gravity(&self, _body: usize) -> Option<Vector3<f64>> {
        None
    }
    /// Pose of an object in the world.
    fn pose(&self, object: ObjectId) -> Option<Isometry3<f64>>;
    /// Appends the numbers of an object; `None` when there is no such object.
    fn values(&self, object: ObjectId, out: &mut Vec<f64>) -> Option<()>;
    /// The first body that the segment between two points (m) meets.
    fn cast_ray(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Hit>;
    /// Appends the contacts of a body; `None` when there is no such body.
    fn contacts(&self, body: usize, out: &mut Vec<Touch>) -> Option<()>;
    /// Adds a tool to those of a volume; its place among them. Never through the C interface.
    ///
    /// # Errors
    /// A sentence that says why not.
    fn add_tool(&mut self, _volume: usize, _tool: &VolumeTool) -> Result<usize, String> {
        Err("tools of volumes are for plugins that are part of the program".into())
    }
    /// What a tool of a volume does; `None` when there is none, and through the C interface.
    fn tool(&self, _volume: usize, _tool: usize) -> Option<ToolState> {
        None
    }
    /// Switches a tool of a volume, or gives it a tip of another radius, m. Never through the C interface.
    ///
    /// # Errors
    /// [`CommandError`].
    fn set_tool(
        &mut self,
        _volume: usize,
        _tool: usize,
        _on: Option<bool>,
        _radius: Option<f64>,
    ) -> Result<(), CommandError> {
        Err(CommandError::Unknown)
    }
    /// Gives a volume the voxels of the start back. Never through the C interface.
    ///
    /// # Errors
    /// [`CommandError`].
    fn restore_voxels(&mut self, _volume: usize) -> Result<(), CommandError> {
        Err(CommandError::Unknown)
    }
    /// Executes a command; the number of the attachment that it makes, else 0.
    ///
    /// # Errors
    /// [`CommandError`].
    fn execute(&mut self, command: &Command) -> Result<u64, CommandError>;
}

/// The simulation as a plugin sees it in a callback of the physics thread: the scene between two steps.
///
/// Objects are named by type and index; an index stays the same for as long as the simulation runs and is never used
/// again. What is asked of an object that is not there, or no longer, is `None` or [`CommandError::NoObject`]. Nothing
/// that is sent here can corrupt the simulation: numbers that are not finite are refused.
pub struct View<'a> {
    pub(crate) access: &'a mut dyn Access,
    subject: Subject,
}

impl<'a> View<'a> {
    pub(crate) fn new(access: &'a mut dyn Access, subject: Subject) -> Self {
        Self { access, subject }
    }

    /// What the plugin was declared on.
    pub fn subject(&self) -> Subject {
        self.subject
    }

    /// Index of the object that the plugin was declared on, if it is of this type.
    pub fn own(&self, kind: ObjectType) -> Option<usize> {
        match self.subject {
            Subject::Object(object) if object.kind == kind => Some(object.index),
            _ => None,
        }
    }

    /// Simulated time, the step just made, its number.
    pub fn clock(&self) -> Clock {
        self.access.clock()
    }

    /// How many objects of a type there ever were: indices are below this.
    pub fn count(&self, kind: ObjectType) -> usize {
        self.access.count(Some(kind))
    }

    /// How many models there ever were; the first is the environment.
    pub fn model_count(&self) -> usize {
        self.access.count(None)
    }

    /// The object of a type whose qualified identifier (`/ambf/env/BODY Base`) or name (`Base`) is `text`, else the
    /// only one whose identifier holds it.
    pub fn find(&self, kind: ObjectType, text: &str) -> Option<usize> {
        self.access.find(Some(kind), text)
    }

    /// The model whose key is `text`, else the only one whose key holds it.
    pub fn find_model(&self, text: &str) -> Option<usize> {
        self.access.find(None, text)
    }

    /// Name of an object, with the suffix that tells copies apart.
    pub fn name(&self, object: ObjectId) -> Option<String> {
        self.access.text(TextOf::Name, Some(object.kind), object.index)
    }

    /// Qualified identifier of an object: namespace, mapping key and suffix.
    pub fn identifier(&self, object: ObjectId) -> Option<String> {
        self.access.text(TextOf::Identifier, Some(object.kind), object.index)
    }

    /// Model that an object belongs to.
    pub fn model_of(&self, object: ObjectId) -> Option<usize> {
        self.access.model_of(object)
    }

    /// Key of a model: what it is removed by.
    pub fn model_key(&self, model: usize) -> Option<String> {
        self.access.text(TextOf::Identifier, None, model)
    }

    /// File of a model.
    pub fn model_file(&self, model: usize) -> Option<String> {
        self.access.text(TextOf::File, None, model)
    }

    /// State of a rigid body.
    pub fn body(&self, index: usize) -> Option<BodyState> {
        self.access.body(index)
    }

    /// State of a joint.
    pub fn joint(&self, index: usize) -> Option<JointState> {
        self.access.joint(index)
    }

    /// Where a joint with one coordinate is and how it moves; `None` for other joints, and in shared libraries.
    pub fn joint_frame(&self, index: usize) -> Option<JointFrame> {
        self.access.joint_frame(index)
    }

    /// Gravity that acts on a body, m/s², world axes; `None` when there is no such body, and in shared libraries.
    pub fn gravity(&self, body: usize) -> Option<Vector3<f64>> {
        self.access.gravity(body)
    }

    /// Pose of an object in the world: of a body its body frame, of a soft body its centre without rotation; `None` for
    /// joints and volumes.
    pub fn pose(&self, object: ObjectId) -> Option<Isometry3<f64>> {
        self.access.pose(object)
    }

    /// Measurements of a sensor, one a ray (1 − distance / length, 0 without a hit) or one a contact (N). Replaces what
    /// is in `out`; `None` when there is no such sensor.
    pub fn sensor_readings(&self, sensor: usize, out: &mut Vec<f64>) -> Option<()> {
        out.clear();
        self.access.values(ObjectId::new(ObjectType::Sensor, sensor), out)
    }

    /// The bodies in a ghost object, one entry a contact.
    pub fn ghost_bodies(&self, ghost: usize) -> Option<Vec<usize>> {
        let mut values = Vec::new();
        self.access.values(ObjectId::new(ObjectType::Ghost, ghost), &mut values)?;
        Some(values.into_iter().map(|body| body as usize).collect())
    }

    /// Positions of the nodes of a soft body, (nodes x 3) in one row, m, world axes. Replaces what is in `out`.
    pub fn soft_nodes(&self, soft: usize, out: &mut Vec<f64>) -> Option<()> {
        out.clear();
        self.access.values(ObjectId::new(ObjectType::SoftBody, soft), out)
    }

    /// Whether an actuator holds something.
    pub fn is_holding(&self, actuator: usize) -> Option<bool> {
        let mut values = Vec::new();
        self.access.values(ObjectId::new(ObjectType::Actuator, actuator), &mut values)?;
        Some(values.first() == Some(&1.0))
    }

    /// What a ray from one point to another meets first; points in m, world axes. Objects are where the last sub-step
    /// saw them.
    pub fn cast_ray(&self, from: Vector3<f64>, to: Vector3<f64>) -> Option<Hit> {
        self.access.cast_ray(&from, &to)
    }

    /// Where a body touches others, as of the last sub-step. Replaces what is in `out`; `None` when there is no such
    /// body.
    pub fn contacts(&self, body: usize, out: &mut Vec<Touch>) -> Option<()> {
        out.clear();
        self.access.contacts(body, out)
    }

    /// Adds a tool to those of a volume that has voxels and may be cut, for as long as the scene lasts; its place among
    /// them. Not in shared libraries.
    ///
    /// # Errors
    /// A sentence that says why not.
    pub fn add_tool(&mut self, volume: usize, tool: &VolumeTool) -> Result<usize, String> {
        self.access.add_tool(volume, tool)
    }

    /// What a tool of a volume did in the last step; `None` when there is none, and in shared libraries.
    pub fn tool(&self, volume: usize, tool: usize) -> Option<ToolState> {
        self.access.tool(volume, tool)
    }

    /// Switches a tool of a volume, or gives it a tip of another radius, m. Not in shared libraries.
    ///
    /// # Errors
    /// [`CommandError::NoObject`]; [`CommandError::Refused`] for a radius that it cannot have.
    pub fn set_tool(
        &mut self,
        volume: usize,
        tool: usize,
        on: Option<bool>,
        radius: Option<f64>,
    ) -> Result<(), CommandError> {
        self.access.set_tool(volume, tool, on, radius)
    }

    /// Gives a volume the voxels of the start back. Not in shared libraries.
    ///
    /// # Errors
    /// [`CommandError::NoObject`].
    pub fn restore_voxels(&mut self, volume: usize) -> Result<(), CommandError> {
        self.access.restore_voxels(volume)
    }

    /// Executes a command.
    ///
    /// # Errors
    /// [`CommandError`].
    pub fn execute(&mut self, command: &Command) -> Result<(), CommandError> {
        self.access.execute(command).map(|_| ())
    }

    /// [`Command::Wrench`].
    ///
    /// # Errors
    /// [`CommandError::NoObject`], [`CommandError::NotFinite`].
    pub fn apply_wrench(&mut self, body: usize, force: Vector3<f64>, torque: Vector3<f64>) -> Result<(), CommandError> {
        self.execute(&Command::Wrench { body, force, torque })
    }

    /// Adds a force (N) at a point (m) of a body for the next step; torque = (point − centre of mass) × force. World
    /// axes.
    ///
    /// # Errors
    /// [`CommandError::NoObject`], [`CommandError::NotFinite`].
    pub fn apply_force_at(
        &mut self,
        body: usize,
        force: Vector3<f64>,
        point: Vector3<f64>,
    ) -> Result<(), CommandError> {
        let centre = self.body(body).ok_or(CommandError::NoObject)?.inertial_pose.translation.vector;
        self.apply_wrench(body, force, (point - centre).cross(&force))
    }

    /// [`Command::Velocity`].
    ///
    /// # Errors
    /// [`CommandError::NoObject`], [`CommandError::NotFinite`].
    pub fn set_velocity(
        &mut self,
        body: usize,
        linear: Vector3<f64>,
        angular: Vector3<f64>,
    ) -> Result<(), CommandError> {
        self.execute(&Command::Velocity { body, linear, angular })
    }

    /// [`Command::Pose`].
    ///
    /// # Errors
    /// [`CommandError::NoObject`], [`CommandError::NotFinite`].
    pub fn set_pose(&mut self, body: usize, pose: Isometry3<f64>) -> Result<(), CommandError> {
        self.execute(&Command::Pose { body, pose })
    }

    /// [`Command::FollowPose`].
    ///
    /// # Errors
    /// [`CommandError::NoObject`], [`CommandError::NotFinite`].
    pub fn follow_pose(&mut self, body: usize, pose: Isometry3<f64>) -> Result<(), CommandError> {
        self.execute(&Command::FollowPose { body, pose })
    }

    /// [`Command::Joint`].
    ///
    /// # Errors
    /// [`CommandError::NoObject`], [`CommandError::NotFinite`].
    pub fn command_joint(&mut self, joint: usize, kind: JointCommandType, value: f64) -> Result<(), CommandError> {
        self.execute(&Command::Joint { joint, kind, value })
    }

    /// [`Command::Attach`]: a number to detach by.
    ///
    /// # Errors
    /// [`CommandError::NoObject`]; [`CommandError::Refused`] for a body and itself.
    pub fn attach(&mut self, body: usize, to: usize) -> Result<u64, CommandError> {
        self.access.execute(&Command::Attach { body, to })
    }

    /// [`Command::Detach`].
    ///
    /// # Errors
    /// [`CommandError::NoObject`]: it is not attached any more.
    pub fn detach(&mut self, attachment: u64) -> Result<(), CommandError> {
        self.execute(&Command::Detach { attachment })
    }
}
