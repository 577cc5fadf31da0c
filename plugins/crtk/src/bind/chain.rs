//! The chain from the base of an arm to its tool: which joints it has, what it carries, how it is inverted.

use ambf_plugin::{ObjectId, ObjectType, View};
use nalgebra::{Isometry3, Point3, Translation3, Unit, Vector3};

use super::find::Finder;
use super::{BindError, Binding, Driven, Mount, Weight};
use crate::arm::Dialect;
use crate::config::{ArmConfig, IkKind, Kind};
use crate::kinematics::{
    Chain, ChainError, ChainJoint, Coordinates, DampedLeastSquares, DhTable, DlsSettings, EcmInverse, Instrument,
    Inverse, Kinematics, Limits, Motion, PsmInverse,
};

/// Most ways from a tool to a base that are looked at.
const MAX_PATHS: usize = 10_000;

impl Binding {
    /// Finds base and tool and the chain between them.
    pub(super) fn mount(&mut self, finder: &Finder<'_, '_>) -> Result<Kinematics, BindError> {
        let Finder { config, world } = *finder;
        let base = config.base.as_ref().map(|name| finder.find(ObjectType::Body, name)).transpose()?;
        let identity = Isometry3::identity();
        let nothing = |error| BindError::Chain { place: config.source.clone(), arm: config.name.clone(), error };
        let count = self.joints.len().max(1);
        if let Some(name) = &config.body {
            return self.carry(finder, name);
        }
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

    /// A body that an endoscope arm carries which is not in the scene: with all joints at 0 it is where the scene has it.
    fn carry(&mut self, finder: &Finder<'_, '_>, name: &str) -> Result<Kinematics, BindError> {
        let body = finder.find(ObjectType::Body, name)?;
        let table = DhTable::ecm(0.0).chain();
        self.tool = Mount::new(finder.world, body, &Isometry3::identity());
        // The frame of the body looks along -z, that of the table along z, with x to the other side.
        let view = Isometry3::rotation(std::f64::consts::PI * Vector3::y());
        let chain = table.with_tip(&view);
        let start = finder.world.body(body).map_or_else(Isometry3::identity, |state| state.pose);
        self.carried = Some((body, start * chain.forward(&Coordinates::zeros()).inverse()));
        Ok(Kinematics { chain, inverse: inverse(finder.config) })
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
            if tried > MAX_PATHS {
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

    pub(super) fn weights(&self, world: &View<'_>) -> Vec<Weight> {
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
}

fn joints_to<'v, 'w>(world: &'v View<'w>, body: usize) -> impl Iterator<Item = usize> + use<'v, 'w> {
    (0..world.count(ObjectType::Joint))
        .filter(move |&joint| world.joint(joint).is_some_and(|state| state.child == body))
}

fn joints_from<'v, 'w>(world: &'v View<'w>, body: usize) -> impl Iterator<Item = usize> + use<'v, 'w> {
    (0..world.count(ObjectType::Joint))
        .filter(move |&joint| world.joint(joint).is_some_and(|state| state.parent == body))
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
