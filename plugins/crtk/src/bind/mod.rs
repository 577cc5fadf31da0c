//! From a configured arm to the bodies and joints of a scene: which they are, the chain that they make, and what is
//! read of them and commanded to them in each step.

mod chain;
mod find;

use ambf_plugin::{JointCommandType, ObjectId, ObjectType, View};
use nalgebra::{Isometry3, Point3, Unit, Vector3, Vector6};

use crate::arm::{Arm, ArmModel, Drive, FrameNames, InstrumentNumber, JawModel, Measured, SetPoint};
use crate::config::{wire_name, AlsoConfig, ArmConfig};
use crate::grasp::Grasp;
use crate::kinematics::{holding_efforts, Coordinates, Kinematics, Limits, Load};
use crate::trajectory::Bounds;
pub(crate) use find::look_up;
pub use find::BindError;
use find::Finder;

/// A body and a frame on it.
#[derive(Debug, Clone, Copy)]
struct Mount {
    body: usize,
    /// The frame in the body's inertial frame.
    offset: Isometry3<f64>,
}

/// Where a frame is and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moving {
    /// In the world.
    pub pose: Isometry3<f64>,
    /// Velocity of its origin, then angular velocity, world axes.
    pub twist: Vector6<f64>,
}

impl Default for Moving {
    fn default() -> Self {
        Self { pose: Isometry3::identity(), twist: Vector6::zeros() }
    }
}

impl Moving {
    /// A frame fixed to this one, at a pose in it.
    pub fn carried(&self, at: &Isometry3<f64>) -> Self {
        let pose = self.pose * at;
        let w = Vector3::from(self.twist.fixed_rows::<3>(3));
        let mut twist = self.twist;
        let arm = pose.translation.vector - self.pose.translation.vector;
        let mut linear = twist.fixed_rows_mut::<3>(0);
        linear += w.cross(&arm);
        Self { pose, twist }
    }
}

impl Mount {
    /// The frame at a pose of the body's own frame. `None` when the body is not there.
    fn new(world: &View<'_>, body: usize, in_body: &Isometry3<f64>) -> Option<Self> {
        let state = world.body(body)?;
        Some(Self { body, offset: state.inertial_pose.inv_mul(&(state.pose * in_body)) })
    }

    fn read(&self, world: &View<'_>) -> Option<Moving> {
        let state = world.body(self.body)?;
        let pose = state.inertial_pose * self.offset;
        let (w, arm) = (state.angular_velocity, pose.translation.vector - state.inertial_pose.translation.vector);
        let v = state.linear_velocity + w.cross(&arm);
        // A body without mass stands still, whatever was commanded.
        let twist = if state.mass > 0.0 { Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z) } else { Vector6::zeros() };
        Some(Moving { pose, twist })
    }
}

/// The frame in which poses are.
#[derive(Debug, Clone, Copy)]
enum Reference {
    World,
    Base,
    /// Control point of another arm, by its place among the configured ones.
    Arm(usize),
    Body(Mount),
}

/// A joint that takes commands: position = ratio · coordinate + offset.
#[derive(Debug, Clone, Copy)]
struct Driven {
    joint: usize,
    coordinate: usize,
    ratio: f64,
    offset: f64,
    /// Whether it takes commands.
    is_driven: bool,
}

/// What gravity does to the bodies that a joint moves.
#[derive(Debug, Clone)]
struct Weight {
    coordinate: usize,
    ratio: f64,
    is_angular: bool,
    parent: usize,
    pivot: Vector3<f64>,
    axis: Vector3<f64>,
    /// Body, its mass, its gravity.
    beyond: Vec<(usize, f64, Vector3<f64>)>,
}

/// A joint that slides. Its axis is in the parent's inertial frame.
#[derive(Debug, Clone, Copy)]
struct Slide {
    parent: usize,
    child: usize,
    axis: Vector3<f64>,
}

/// Bodies and joints of an arm.
#[derive(Debug)]
pub struct Binding {
    joints: Vec<usize>,
    /// Of each joint that slides.
    slides: Vec<Option<Slide>>,
    /// Each body that the joints move, and the force that takes its weight away, N, world axes.
    lifted: Vec<(usize, Vector3<f64>)>,
    followers: Vec<Driven>,
    jaw: Vec<Driven>,
    base: Option<Mount>,
    tool: Option<Mount>,
    reference: Reference,
    weights: Vec<Weight>,
    /// What its jaw holds by rules.
    grasp: Option<Grasp>,
    /// Without joints: the body that follows the set points, and the base.
    carried: Option<(usize, Isometry3<f64>)>,
    /// How the errors of its joints are called.
    pub errors_topic: String,
    /// Sentences for the user.
    pub notes: Vec<String>,
}

/// What a step has left of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reading {
    /// Joints.
    pub measured: Measured,
    /// Base.
    pub base: Moving,
    /// Control point.
    pub tool: Moving,
    /// Reference frame.
    pub reference: Moving,
}

/// Finds what an arm consists of. `all`: the configured arms, `own`: its place among them.
///
/// # Errors
/// [`BindError`].
pub fn bind(all: &[ArmConfig], own: usize, world: &View<'_>) -> Result<(ArmModel, Binding), BindError> {
    let config = &all[own];
    let finder = Finder { config, world };
    let joints = config.joints.iter().map(|name| finder.joint(name)).collect::<Result<Vec<_>, _>>()?;
    let follower = |follower: &crate::config::Follower| {
        let joint = finder.joint(&follower.joint)?;
        let position = |joint| world.joint(joint).map_or(0.0, |state| state.position);
        let now = position(joint) - follower.ratio * position(joints[follower.of]);
        let offset = follower.offset.unwrap_or(now);
        Ok(Driven { joint, coordinate: follower.of, ratio: follower.ratio, offset, is_driven: follower.is_driven })
    };
    let followers = config.coupling.iter().map(follower).collect::<Result<Vec<_>, _>>()?;
    let finger = |(name, ratio, offset): &(String, f64, f64)| {
        Ok(Driven { joint: finder.joint(name)?, coordinate: 0, ratio: *ratio, offset: *offset, is_driven: true })
    };
    let fingers = config.jaw.iter().flat_map(|jaw| &jaw.joints);
    let jaw = fingers.map(finger).collect::<Result<Vec<_>, _>>()?;
    let mut binding = Binding {
        slides: joints.iter().map(|&joint| slide(world, joint)).collect(),
        lifted: Vec::new(),
        grasp: None,
        carried: None,
        errors_topic: format!("{}/errors_model/set_errors", space(config, world, &finder)),
        joints,
        followers,
        jaw,
        base: None,
        tool: None,
        reference: Reference::World,
        weights: Vec::new(),
        notes: Vec::new(),
    };
    let kinematics = binding.mount(&finder)?;
    if binding.tool.is_none() && config.grasp.is_some() {
        binding.notes.push(format!("{}: without a `tool: {{body: …}}` its jaw holds nothing", config.name));
    }
    binding.reference = reference(all, own, &finder)?;
    binding.weights = binding.weights(world);
    binding.lifted = lifted(&binding.weights);
    binding.grasp = binding.grasp(config, world);
    let model = model(config, &binding, kinematics, world);
    Ok((model, binding))
}

/// The namespace of the arm's base, else the beginning of its topics.
fn space(config: &ArmConfig, world: &View<'_>, finder: &Finder<'_, '_>) -> String {
    let base = config.base.as_ref().and_then(|base| finder.find(ObjectType::Body, base).ok());
    let name = base.and_then(|body| world.identifier(ObjectId::new(ObjectType::Body, body)));
    let parent = name.as_deref().and_then(|name| name.rsplit_once('/')).map(|(parent, _)| parent.to_owned());
    parent.filter(|parent| !parent.is_empty()).unwrap_or_else(|| config.space.clone())
}

fn reference(all: &[ArmConfig], own: usize, finder: &Finder<'_, '_>) -> Result<Reference, BindError> {
    let name = all[own].reference.as_str();
    let of_arm = |arm: &ArmConfig| name.strip_suffix("_view") == Some(&arm.name) || name == arm.name;
    Ok(match name {
        "world" => Reference::World,
        "base" => Reference::Base,
        _ => match all.iter().position(of_arm) {
            Some(arm) if arm != own => Reference::Arm(arm),
            _ => {
                let body = finder.find(ObjectType::Body, name)?;
                Mount::new(finder.world, body, &Isometry3::identity()).map_or(Reference::World, Reference::Body)
            }
        },
    })
}

/// Limits, speeds and names of a configured arm.
/// The arm as clients of its further topics see it: other names, the same arm.
pub fn further(model: &ArmModel, config: &ArmConfig, also: &AlsoConfig) -> ArmModel {
    let base = also.dialect.base_frame(&also.name);
    let reference = if config.reference == "base" { base.clone() } else { config.reference.clone() };
    ArmModel {
        name: also.name.clone(),
        joints: also.names.clone(),
        dialect: also.dialect,
        frames: FrameNames { reference, base },
        ..model.clone()
    }
}

fn model(config: &ArmConfig, binding: &Binding, kinematics: Kinematics, world: &View<'_>) -> ArmModel {
    let of_scene = |&joint: &usize| {
        let (lower, upper) = world.joint(joint).map_or((f64::NEG_INFINITY, f64::INFINITY), |state| state.limits);
        // Limits the wrong way round limit nothing.
        if lower <= upper {
            Limits { lower, upper }
        } else {
            Limits::NONE
        }
    };
    let fill = |values: &[f64], other: f64| {
        let mut all = Coordinates::repeat(other);
        all.as_mut_slice()[..values.len()].copy_from_slice(values);
        all
    };
    let base = config.dialect.base_frame(&config.name);
    let jaw = config.jaw.as_ref().map(|jaw| JawModel {
        limits: jaw.limits,
        speed: jaw.speed,
        acceleration: jaw.speed * 20.0,
        home: jaw.home,
    });
    let limits: Vec<Limits> = config.limits.clone().unwrap_or_else(|| binding.joints.iter().map(of_scene).collect());
    let home = config.home.as_ref().map(|home| {
        let mut home = fill(home, 0.0);
        home.iter_mut().zip(&limits).for_each(|(value, limits)| *value = limits.clip(*value));
        home
    });
    ArmModel {
        name: config.name.clone(),
        joints: config.names.clone(),
        fingers: config.jaw.iter().flat_map(|jaw| &jaw.joints).map(|(name, ..)| wire_name(name)).collect(),
        kinematics,
        limits,
        bounds: Bounds { speed: fill(&config.speeds, 1.0), acceleration: fill(&config.accelerations, 1.0) },
        efforts: config.efforts.as_ref().map_or(Coordinates::repeat(f64::INFINITY), |efforts| fill(efforts, 0.0)),
        home,
        jaw,
        dialect: config.dialect,
        on_limit: config.on_limit,
        instrument: config.tool.as_ref().and_then(|tool| InstrumentNumber::of_tool(tool.instrument.as_deref()?)),
        frames: FrameNames {
            reference: if config.reference == "base" { base.clone() } else { config.reference.clone() },
            base,
        },
    }
}

impl Binding {
    /// What a step has left; the reference is filled in by [`refer`](Self::refer). `None` when parts of the arm have
    /// left the scene.
    pub fn read(&self, world: &View<'_>, arm: &Arm) -> Option<Reading> {
        let mut reading = Reading::default();
        let measured = &mut reading.measured;
        if self.carried.is_some() {
            (measured.position, measured.velocity) = (arm.set_point().position, arm.set_point().velocity);
        }
        for (i, &joint) in self.joints.iter().enumerate() {
            let state = world.joint(joint)?;
            (measured.position[i], measured.velocity[i], measured.effort[i]) =
                (state.position - arm.errors()[i], state.velocity, state.effort);
        }
        measured.jaw = self.read_jaw(world)?;
        measured.holding = self.holding(world);
        reading.base = match (self.base, self.carried) {
            (Some(base), _) => base.read(world)?,
            (None, Some((_, pose))) => Moving { pose, ..Moving::default() },
            (None, None) => Moving::default(),
        };
        reading.measured.base = reading.base.pose;
        // With errors, the control point is known from the joints only, as encoders know it.
        let is_true = arm.errors().iter().all(|&error| error == 0.0);
        reading.tool = match &self.tool {
            Some(tool) if is_true => tool.read(world)?,
            _ => by_joints(arm.model(), &reading),
        };
        Some(reading)
    }

    /// The reference frame, from the readings of all arms.
    pub fn refer(&self, world: &View<'_>, own: &Reading, tools: &[Option<Moving>]) -> Moving {
        match self.reference {
            Reference::World => Some(Moving::default()),
            Reference::Base => Some(own.base),
            Reference::Arm(arm) => tools.get(arm).copied().flatten(),
            Reference::Body(mount) => mount.read(world),
        }
        .unwrap_or_default()
    }

    /// Angle between the fingers, speed, effort: least squares of what the fingers say.
    fn read_jaw(&self, world: &View<'_>) -> Option<[f64; 3]> {
        let mut jaw = [0.0; 3];
        let squares: f64 = self.jaw.iter().map(|finger| finger.ratio * finger.ratio).sum();
        for finger in &self.jaw {
            let state = world.joint(finger.joint)?;
            let share = finger.ratio / squares;
            jaw[0] += share * (state.position - finger.offset);
            jaw[1] += share * state.velocity;
            jaw[2] += finger.ratio * state.effort;
        }
        Some(jaw)
    }

    fn holding(&self, world: &View<'_>) -> Coordinates {
        let mut holding = Coordinates::zeros();
        for weight in &self.weights {
            let Some(parent) = world.body(weight.parent) else { continue };
            let axis = Unit::new_unchecked(parent.inertial_pose.rotation * weight.axis);
            let origin = parent.inertial_pose * Point3::from(weight.pivot);
            let loads = weight.beyond.iter().filter_map(|&(body, mass, gravity)| {
                world.body(body).map(|state| Load::new(mass, &state.inertial_pose, &gravity))
            });
            holding[weight.coordinate] += weight.ratio * holding_efforts(weight.is_angular, &axis, &origin, loads);
        }
        holding
    }

    /// Commands the joints for the next step.
    pub fn command(&self, world: &mut View<'_>, arm: &Arm) {
        let (set_point, errors) = (arm.set_point(), arm.errors());
        if let Some((body, base)) = self.carried {
            // A body that has left the scene needs no command.
            let _ = world.follow_pose(body, base * arm.model().kinematics.chain.forward(&set_point.position));
        }
        // A joint that has left the scene needs no command.
        match set_point.drive {
            Drive::Position => {
                for (place, &joint) in self.joints.iter().enumerate() {
                    let position = set_point.position[place] + errors[place];
                    let _ = world.command_joint(joint, JointCommandType::Position, position);
                }
            }
            Drive::Effort => self.push(world, set_point, errors),
        }
        for follower in self.followers.iter().filter(|follower| follower.is_driven) {
            let position = set_point.position[follower.coordinate] + errors[follower.coordinate];
            let value = follower.ratio * position + follower.offset;
            let _ = world.command_joint(follower.joint, JointCommandType::Position, value);
        }
        for finger in &self.jaw {
            let (kind, value) = match set_point.jaw_drive {
                Drive::Position => (JointCommandType::Position, finger.ratio * set_point.jaw[0] + finger.offset),
                Drive::Effort => (JointCommandType::Effort, finger.ratio * set_point.jaw_effort),
            };
            let _ = world.command_joint(finger.joint, kind, value);
        }
    }

    /// Efforts for the next step. What holds the arm against gravity is taken off each body by itself: at the joints
    /// that is the same by virtual work, but then the joints have nothing to carry, so that it is right where they
    /// close loops, and independent of how far an iterative solver gets.
    fn push(&self, world: &mut View<'_>, set_point: &SetPoint, errors: &Coordinates) {
        let efforts = set_point.effort - set_point.holding;
        for (place, ((&joint, slide), &effort)) in self.joints.iter().zip(&self.slides).zip(efforts.iter()).enumerate()
        {
            if place >= set_point.positioned_from {
                let position = set_point.position[place] + errors[place];
                let _ = world.command_joint(joint, JointCommandType::Position, position);
                continue;
            }
            let turning = if slide.is_some() { 0.0 } else { effort };
            let _ = world.command_joint(joint, JointCommandType::Effort, turning);
            if let Some(slide) = slide.filter(|_| effort != 0.0) {
                slide.push(world, effort);
            }
        }
        if set_point.is_lifted {
            for &(body, force) in &self.lifted {
                let _ = world.apply_wrench(body, force, Vector3::zeros());
            }
        }
    }

    fn grasp(&self, config: &ArmConfig, world: &View<'_>) -> Option<Grasp> {
        let (rules, tool) = (config.grasp.clone()?, self.tool?.body);
        let fingers = self.jaw.iter().filter_map(|finger| Some(world.joint(finger.joint)?.child)).collect();
        let own = self.weights.iter().flat_map(|weight| &weight.beyond).map(|(body, ..)| *body).collect();
        Some(Grasp::new(rules, fingers, tool, own))
    }

    /// Grasps or releases by the rules of grasping, where there are any.
    pub fn hold(&mut self, world: &mut View<'_>, set_point: &SetPoint, tool: &Isometry3<f64>) {
        if let Some(grasp) = &mut self.grasp {
            grasp.update(world, set_point.jaw[0], tool);
        }
    }

    /// Releases what it holds.
    pub fn release(&mut self, world: &mut View<'_>) {
        if let Some(grasp) = &mut self.grasp {
            grasp.release(world);
        }
    }

    /// Whether there is anything to command.
    pub fn has_joints(&self) -> bool {
        !self.joints.is_empty() || self.carried.is_some()
    }
}

impl Slide {
    /// Forces on parent and child along one line. The simulator's own effort acts at the centres of mass in the profile
    /// `legacy`, as in the C++ program: where these are not on one line along the axis, that is a torque from nowhere.
    fn push(&self, world: &mut View<'_>, effort: f64) {
        let (Some(parent), Some(child)) = (world.body(self.parent), world.body(self.child)) else { return };
        let force = parent.inertial_pose.rotation * self.axis * effort;
        let arm = child.inertial_pose.translation.vector - parent.inertial_pose.translation.vector;
        let _ = world.apply_wrench(self.child, force, Vector3::zeros());
        let _ = world.apply_wrench(self.parent, -force, -arm.cross(&force));
    }
}

fn slide(world: &View<'_>, joint: usize) -> Option<Slide> {
    let (frame, state) = (world.joint_frame(joint)?, world.joint(joint)?);
    (!frame.is_angular).then_some(Slide { parent: state.parent, child: state.child, axis: frame.axis })
}

/// Each body once that joints move, and what takes its weight away.
fn lifted(weights: &[Weight]) -> Vec<(usize, Vector3<f64>)> {
    let mut all: Vec<(usize, Vector3<f64>)> = Vec::new();
    for &(body, mass, gravity) in weights.iter().flat_map(|weight| &weight.beyond) {
        if mass > 0.0 && all.iter().all(|(other, _)| *other != body) {
            all.push((body, -gravity * mass));
        }
    }
    all
}

/// The control point as the joints say.
fn by_joints(model: &ArmModel, reading: &Reading) -> Moving {
    let chain = &model.kinematics.chain;
    let Reading { measured, base, .. } = reading;
    let in_base = chain.jacobian(&measured.position) * measured.velocity;
    let turn = |row: usize| base.pose.rotation * in_base.fixed_rows::<3>(row);
    let pose = base.pose * chain.forward(&measured.position);
    let w = Vector3::from(base.twist.fixed_rows::<3>(3));
    let carried = base.twist.fixed_rows::<3>(0) + w.cross(&(pose.translation.vector - base.pose.translation.vector));
    let mut twist = Vector6::zeros();
    twist.fixed_rows_mut::<3>(0).copy_from(&(turn(0) + carried));
    twist.fixed_rows_mut::<3>(3).copy_from(&(turn(3) + w));
    Moving { pose, twist }
}
