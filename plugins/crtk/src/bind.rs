//! From a configured arm to the bodies and joints of a scene: which they are, the chain that they make, and what is
//! read of them and told to them in each step.

use ambf_model::adf::SourcePos;
use ambf_plugin::{JointCommandType, ObjectId, ObjectType, View};
use nalgebra::{Isometry3, Point3, Translation3, Unit, Vector3, Vector6};
use thiserror::Error;

use crate::arm::{ArmModel, Dialect, Drive, FrameNames, InstrumentNumber, JawModel, Measured, SetPoint};
use crate::config::{ArmConfig, IkKind, Kind};
use crate::grasp::Grasp;
use crate::kinematics::{
    holding_efforts, Chain, ChainError, ChainJoint, Coordinates, DampedLeastSquares, DhTable, DlsSettings, EcmInverse,
    Instrument, Inverse, Kinematics, Limits, Load, Motion, PsmInverse,
};
use crate::trajectory::Bounds;

/// Why an arm cannot be offered.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BindError {
    /// Error when the scene has no such object.
    #[error("{place}: {arm}: the scene has no {kind} `{name}`; there is {near}")]
    NoObject {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// What kind of object it should be.
        kind: &'static str,
        /// What it is called there.
        name: String,
        /// Names that are like it.
        near: String,
    },
    /// Error when no joints lead from the base to the tool.
    #[error("{place}: {arm}: no joints lead from the base `{base}` to the tool `{tool}`")]
    NoPath {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// Body.
        base: String,
        /// Body.
        tool: String,
    },
    /// Error when a joint has no coordinate.
    #[error("{place}: {arm}: the joint `{name}` has no single coordinate")]
    NoCoordinate {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// The joint.
        name: String,
    },
    /// Error when the chain is of no use.
    #[error("{place}: {arm}: {error}")]
    Chain {
        /// Where the arm is configured.
        place: SourcePos,
        /// The arm.
        arm: String,
        /// Why.
        error: ChainError,
    },
}

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
        // A body without mass stands still, whatever it was told.
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

/// A joint that is told what to do: position = ratio · coordinate + offset.
#[derive(Debug, Clone, Copy)]
struct Driven {
    joint: usize,
    coordinate: usize,
    ratio: f64,
    offset: f64,
    /// Whether it is told what to do.
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

/// Looks things up for one arm.
struct Finder<'a, 'w> {
    config: &'a ArmConfig,
    world: &'a View<'w>,
}

/// Most names that an error offers.
const OFFERED: usize = 3;

impl Finder<'_, '_> {
    fn find(&self, kind: ObjectType, name: &str) -> Result<usize, BindError> {
        let found = self.by_parts(kind, name).or_else(|| self.world.find(kind, name));
        found.ok_or_else(|| BindError::NoObject {
            place: self.config.source.clone(),
            arm: self.config.name.clone(),
            kind: if kind == ObjectType::Joint { "joint" } else { "body" },
            name: name.to_owned(),
            near: self.near(kind, name),
        })
    }

    /// The only object whose identifier ends with the last part of a name and holds the parts before in order, such as
    /// `psm1/yaw` or `psm1/JOINT yaw`.
    fn by_parts(&self, kind: ObjectType, name: &str) -> Option<usize> {
        let wanted = plain_parts(name);
        let holds = |index: &usize| {
            let identifier = self.world.identifier(ObjectId::new(kind, *index)).unwrap_or_default();
            let has = plain_parts(&identifier);
            let mut before = has.iter().take(has.len().saturating_sub(1));
            let Some((last, first)) = wanted.split_last() else { return false };
            has.last() == Some(last) && first.iter().all(|part| before.any(|other| other == part))
        };
        let mut found = (0..self.world.count(kind)).filter(holds);
        let first = found.next()?;
        found.next().is_none().then_some(first)
    }

    fn near(&self, kind: ObjectType, name: &str) -> String {
        let all = (0..self.world.count(kind)).filter_map(|index| self.world.name(ObjectId::new(kind, index)));
        let mut all: Vec<(usize, String)> = all.map(|other| (edits(name, &other), other)).collect();
        all.sort();
        let names: Vec<String> = all.into_iter().take(OFFERED).map(|(_, other)| other).collect();
        if names.is_empty() {
            "none at all".into()
        } else {
            names.join(", ")
        }
    }

    fn joint(&self, name: &str) -> Result<usize, BindError> {
        let joint = self.find(ObjectType::Joint, name)?;
        if self.world.joint_frame(joint).is_none() {
            let (place, arm) = (self.config.source.clone(), self.config.name.clone());
            return Err(BindError::NoCoordinate { place, arm, name: name.to_owned() });
        }
        Ok(joint)
    }
}

/// Parts of a name without the word for its type, and without what is written differently in files, keys and topics.
fn plain_parts(name: &str) -> Vec<String> {
    let plain = |part: &str| {
        let part = part.trim_start_matches("BODY ").trim_start_matches("JOINT ");
        part.chars().filter(|c| !matches!(c, ' ' | '_')).collect()
    };
    name.split('/').filter(|part| !part.is_empty()).map(plain).collect()
}

/// Least number of characters that are added, removed or replaced to make one text of another (Levenshtein 1966).
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
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
    let base = format!("{}_base", config.name);
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
    /// Finds base and tool and the chain between them.
    fn mount(&mut self, finder: &Finder<'_, '_>) -> Result<Kinematics, BindError> {
        let Finder { config, world } = *finder;
        let base = config.base.as_ref().map(|name| finder.find(ObjectType::Body, name)).transpose()?;
        let identity = Isometry3::identity();
        let nothing = |error| BindError::Chain { place: config.source.clone(), arm: config.name.clone(), error };
        let count = self.joints.len().max(1);
        let Some(tool) = &config.tool else {
            self.base = base.and_then(|base| Mount::new(world, base, &identity));
            let chain = Chain::new(count, Vec::new(), identity).map_err(nothing)?;
            return Ok(Kinematics { chain, inverse: Inverse::None });
        };
        let body = tool.body.as_ref().map(|name| finder.find(ObjectType::Body, name)).transpose()?;
        let tip = Translation3::new(0.0, 0.0, tool.tip);
        self.tool = body.and_then(|body| Mount::new(world, body, &(tool.offset * tip)));
        let table = self.table(config);
        let Some(body) = body else {
            // Without a body the table says where the tool is.
            self.base = base.and_then(|base| Mount::new(world, base, &identity));
            let table = table.filter(|table| table.joints.len() == self.joints.len());
            let chain = match &table {
                Some(table) => table.chain().with_tip(&beyond_table(config)),
                None => Chain::new(count, Vec::new(), identity).map_err(nothing)?,
            };
            let inverse = if table.is_some() { inverse(config) } else { Inverse::None };
            return Ok(Kinematics { chain, inverse });
        };
        if config.kind == Kind::Object {
            let chain = Chain::new(count, Vec::new(), identity).map_err(nothing)?;
            return Ok(Kinematics { chain, inverse: Inverse::None });
        }
        let (base, path) = self.path(world, base, body).ok_or_else(|| BindError::NoPath {
            place: config.source.clone(),
            arm: config.name.clone(),
            base: config.base.clone().unwrap_or_default(),
            tool: tool.body.clone().unwrap_or_default(),
        })?;
        self.base = Mount::new(world, base, &identity);
        let chain = self.chain(world, &path, count).map_err(nothing)?;
        if let (IkKind::Psm | IkKind::Ecm, Some(table)) = (config.ik, &table) {
            self.compare(&chain, &table.chain().with_tip(&beyond_table(config)), config);
        }
        Ok(Kinematics { chain, inverse: inverse(config) })
    }

    fn table(&self, config: &ArmConfig) -> Option<DhTable> {
        match config.kind {
            Kind::Psm => Some(DhTable::psm(&instrument(config))),
            Kind::Ecm => Some(DhTable::ecm(0.0)),
            Kind::Mtm => Some(DhTable::mtm()),
            Kind::Generic | Kind::Object => None,
        }
    }

    /// Says by how much the scene differs from the table of the closed form.
    fn compare(&mut self, scene: &Chain, table: &Chain, config: &ArmConfig) {
        let mut q = Coordinates::zeros();
        let (mut distance, mut angle) = (0.0_f64, 0.0_f64);
        for k in 0..16_u32 {
            for joint in 0..self.joints.len() {
                let limits = config.limits.as_ref().map_or(Limits { lower: -0.5, upper: 0.5 }, |limits| limits[joint]);
                let share = f64::from((k * 7 + joint as u32 * 5) % 16) / 15.0;
                q[joint] = limits.lower.max(-1.0) + share * (limits.upper.min(1.0) - limits.lower.max(-1.0));
            }
            let (a, b) = (scene.forward(&q), table.forward(&q));
            distance = distance.max((a.translation.vector - b.translation.vector).norm());
            angle = angle.max((a.rotation.inverse() * b.rotation).angle());
        }
        if distance > 1e-6 || angle > 1e-6 {
            self.notes.push(format!(
                "{}: the scene differs from the table of its inverse kinematics by up to {:.3} mm and {:.3} deg; \
                 `ik: dls` follows the scene",
                config.name,
                distance * 1e3,
                angle.to_degrees()
            ));
        }
    }

    /// Which coordinate moves a joint, and how.
    fn driven(&self, joint: usize) -> Option<Driven> {
        let own = self.joints.iter().position(|&own| own == joint);
        let own = own.map(|coordinate| Driven { joint, coordinate, ratio: 1.0, offset: 0.0, is_driven: true });
        own.or_else(|| self.followers.iter().copied().find(|follower| follower.joint == joint))
    }

    /// Joints from the base to the tool, and the base. Of several ways the one with most joints of the arm.
    fn path(&self, world: &View<'_>, base: Option<usize>, tool: usize) -> Option<(usize, Vec<usize>)> {
        let mut best: Option<(i64, usize, Vec<usize>)> = None;
        let mut open = vec![(tool, Vec::new())];
        let mut tried = 0;
        while let Some((body, path)) = open.pop() {
            tried += 1;
            if tried > MOST_PATHS {
                break;
            }
            let mut before = joints_to(world, body).filter(|joint| !path.contains(joint)).peekable();
            let ends = base.map_or(before.peek().is_none(), |base| base == body);
            if ends {
                let score = path.iter().map(|&joint| if self.driven(joint).is_some() { 10 } else { -1 }).sum();
                if best.as_ref().is_none_or(|(most, ..)| score > *most) {
                    best = Some((score, body, path));
                }
                continue;
            }
            for joint in before {
                let parent = world.joint(joint)?.parent;
                let mut longer = path.clone();
                longer.push(joint);
                open.push((parent, longer));
            }
        }
        let (_, base, mut path) = best?;
        path.reverse();
        Some((base, path))
    }

    /// Screws of the joints on the way, in the base, as they are now.
    fn chain(&mut self, world: &View<'_>, path: &[usize], count: usize) -> Result<Chain, ChainError> {
        let base = self.base.and_then(|base| base.read(world)).unwrap_or_default().pose;
        let tool = self.tool.and_then(|tool| tool.read(world)).unwrap_or_default().pose;
        let mut joints = Vec::new();
        for &joint in path {
            let (Some(frame), Some(state)) = (world.joint_frame(joint), world.joint(joint)) else { continue };
            let Some(driven) = self.driven(joint) else {
                let name = world.name(ObjectId::new(ObjectType::Joint, joint)).unwrap_or_default();
                self.notes.push(format!("the joint `{name}` is on the way to the tool and counts as stiff"));
                continue;
            };
            let parent = world.body(state.parent).map_or_else(Isometry3::identity, |body| body.inertial_pose);
            let in_base = base.inv_mul(&parent);
            let axis = Unit::new_normalize(in_base.rotation * frame.axis);
            let motion = if frame.is_angular {
                Motion::Revolute { axis, point: in_base * Point3::from(frame.pivot) }
            } else {
                Motion::Prismatic { axis }
            };
            let Driven { coordinate, ratio, offset, .. } = driven;
            joints.push(ChainJoint { motion, coordinate, ratio, offset: offset - state.position });
        }
        Chain::new(count, joints, base.inv_mul(&tool))
    }

    fn weights(&self, world: &View<'_>) -> Vec<Weight> {
        let weight = |coordinate: usize, joint: usize, ratio: f64| {
            let (frame, state) = (world.joint_frame(joint)?, world.joint(joint)?);
            let mut bodies = vec![state.child];
            let mut next = 0;
            while next < bodies.len() {
                for other in joints_from(world, bodies[next]) {
                    let child = world.joint(other)?.child;
                    if !bodies.contains(&child) && child != state.parent {
                        bodies.push(child);
                    }
                }
                next += 1;
            }
            let load = |body: usize| Some((body, world.body(body)?.mass, world.gravity(body)?));
            let beyond = bodies.into_iter().filter_map(load).collect();
            let (is_angular, parent, pivot, axis) = (frame.is_angular, state.parent, frame.pivot, frame.axis);
            Some(Weight { coordinate, ratio, is_angular, parent, pivot, axis, beyond })
        };
        let own = self.joints.iter().enumerate().filter_map(|(coordinate, &joint)| weight(coordinate, joint, 1.0));
        own.collect()
    }

    /// What a step has left; the reference is filled in by [`refer`](Self::refer). `None` when parts of the arm have
    /// left the scene.
    pub fn read(&self, world: &View<'_>, model: &ArmModel) -> Option<Reading> {
        let mut reading = Reading::default();
        let measured = &mut reading.measured;
        for (i, &joint) in self.joints.iter().enumerate() {
            let state = world.joint(joint)?;
            (measured.position[i], measured.velocity[i], measured.effort[i]) =
                (state.position, state.velocity, state.effort);
        }
        measured.jaw = self.read_jaw(world)?;
        measured.holding = self.holding(world);
        reading.base = self.base.map_or(Some(Moving::default()), |base| base.read(world))?;
        reading.measured.base = reading.base.pose;
        reading.tool = match &self.tool {
            Some(tool) => tool.read(world)?,
            None => by_joints(model, &reading),
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

    /// Tells the joints what to do in the next step.
    pub fn command(&self, world: &mut View<'_>, set_point: &SetPoint) {
        // A joint that has left the scene needs no command.
        match set_point.drive {
            Drive::Position => {
                for (&joint, &position) in self.joints.iter().zip(set_point.position.iter()) {
                    let _ = world.command_joint(joint, JointCommandType::Position, position);
                }
            }
            Drive::Effort => self.push(world, set_point),
        }
        for follower in self.followers.iter().filter(|follower| follower.is_driven) {
            let value = follower.ratio * set_point.position[follower.coordinate] + follower.offset;
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
    fn push(&self, world: &mut View<'_>, set_point: &SetPoint) {
        let efforts = set_point.effort - set_point.holding;
        for (place, ((&joint, slide), &effort)) in self.joints.iter().zip(&self.slides).zip(efforts.iter()).enumerate()
        {
            if place >= set_point.positioned_from {
                let _ = world.command_joint(joint, JointCommandType::Position, set_point.position[place]);
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

    /// Takes or lets go by the rules of grasping, where there are any.
    pub fn hold(&mut self, world: &mut View<'_>, set_point: &SetPoint, tool: &Isometry3<f64>) {
        if let Some(grasp) = &mut self.grasp {
            grasp.update(world, set_point.jaw[0], tool);
        }
    }

    /// Lets go of what it holds.
    pub fn let_go(&mut self, world: &mut View<'_>) {
        if let Some(grasp) = &mut self.grasp {
            grasp.release(world);
        }
    }

    /// Whether there is anything to command.
    pub fn has_joints(&self) -> bool {
        !self.joints.is_empty()
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

/// Most ways from a tool to a base that are looked at.
const MOST_PATHS: usize = 10_000;

fn joints_to<'v, 'w>(world: &'v View<'w>, body: usize) -> impl Iterator<Item = usize> + use<'v, 'w> {
    (0..world.count(ObjectType::Joint))
        .filter(move |&joint| world.joint(joint).is_some_and(|state| state.child == body))
}

fn joints_from<'v, 'w>(world: &'v View<'w>, body: usize) -> impl Iterator<Item = usize> + use<'v, 'w> {
    (0..world.count(ObjectType::Joint))
        .filter(move |&joint| world.joint(joint).is_some_and(|state| state.parent == body))
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

fn instrument(config: &ArmConfig) -> Instrument {
    let number = config.tool.as_ref().and_then(|tool| tool.instrument.as_deref());
    if config.dialect == Dialect::Src {
        return Instrument::CHALLENGE;
    }
    number.and_then(Instrument::of_number).unwrap_or(Instrument::LARGE_NEEDLE_DRIVER)
}

/// Control point in the table's tool frame. Where a body has the tool, its frame is the table's.
fn beyond_table(config: &ArmConfig) -> Isometry3<f64> {
    let Some(tool) = &config.tool else { return Isometry3::identity() };
    let frame = if tool.body.is_some() { Isometry3::identity() } else { tool.offset };
    frame * Translation3::new(0.0, 0.0, tool.tip)
}

fn inverse(config: &ArmConfig) -> Inverse {
    let offset = beyond_table(config);
    match config.ik {
        IkKind::Psm => Inverse::Psm(PsmInverse { tip: offset, ..PsmInverse::from(&instrument(config)) }),
        IkKind::Ecm => Inverse::Ecm(EcmInverse { tool: DhTable::ecm(0.0).tool * offset }),
        IkKind::Dls => {
            // With fewer than six joints not every rotation can be reached.
            let rotation = config.joints.len() >= 6;
            Inverse::Iterative(DampedLeastSquares { settings: DlsSettings { rotation, ..DlsSettings::default() } })
        }
        IkKind::None => Inverse::None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_keys_and_topics_are_compared_by_their_parts() {
        assert_eq!(plain_parts("psm1/BODY tool yaw link"), ["psm1", "toolyawlink"]);
        assert_eq!(plain_parts("/ambf/env/psm/left_jaw"), ["ambf", "env", "psm", "leftjaw"]);
    }

    #[test]
    fn likeness_of_names_is_counted_in_edits() {
        assert_eq!(edits("yaw", "yaw"), 0);
        assert_eq!(edits("jaw", "yaw"), 1);
        assert_eq!(edits("", "yaw"), 3);
        assert_eq!(edits("baselink-yawlink", "base link-yaw link"), 2);
    }
}
