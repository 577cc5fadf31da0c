//! Sets the state of mechanisms: forward kinematics over the trees of joints.
//!
//! The first joint that leads to a body makes it the child of the other body in a tree; joints that close loops follow. A body
//! without mass is the root of what hangs below it.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use thiserror::Error;

use super::{Body, Joint, JointType, Scene};
use crate::adf;
use crate::ids::{BodyId, JointId, Table};

/// What to set of the state of a scene. Mechanisms of which nothing is set stay as they are; in the others every joint keeps its
/// coordinate and rate, and every root its pose and velocity, unless they are set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StateChange {
    /// Coordinates of joints, rad or m. Those that follow from others, because they are coupled to them or close a loop, are checked
    /// only; coupled ones follow.
    pub positions: Vec<(JointId, f64)>,
    /// Rates of joints, rad/s or m/s.
    pub rates: Vec<(JointId, f64)>,
    /// Poses of body frames, world axes; of bodies that hang below no joint.
    pub poses: Vec<(BodyId, Isometry3<f64>)>,
    /// Velocities of the centre of mass, m/s, and angular velocities, rad/s, world axes; of bodies that hang below no joint.
    pub twists: Vec<(BodyId, [Vector3<f64>; 2])>,
}

/// Error when a state cannot be set. Nothing has changed.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SetStateError {
    /// Error when a number is infinite or none.
    #[error("{of}: a number is not finite")]
    NotFinite {
        /// Name of the body or joint.
        of: String,
    },
    /// Error when a joint that follows from others, because it is coupled to them, closes a loop or has no coordinate, would not have
    /// the coordinate that it was to have.
    #[error("joint {joint} follows from others: its coordinate would be {found}, not {value}")]
    Follows {
        /// Its name.
        joint: String,
        /// What was to be set, rad or m.
        value: f64,
        /// What it would be, rad or m.
        found: f64,
    },
    /// Error when a coordinate is beyond the limits of its joint.
    #[error("joint {joint}: {value} is not within its limits, {low} to {high}")]
    OutOfLimits {
        /// Its name.
        joint: String,
        /// What was to be set, rad or m.
        value: f64,
        /// Lower limit, rad or m.
        low: f64,
        /// Upper limit, rad or m.
        high: f64,
    },
    /// Error when a body hangs below a joint, or is a static one that was to get a velocity.
    #[error("the {quantity} of {body} cannot be set: {why}")]
    NotFree {
        /// "pose" or "velocity".
        quantity: &'static str,
        /// Name of the body.
        body: String,
        /// What to set instead.
        why: String,
    },
    /// Error when a loop would open.
    #[error(
        "joint {joint} closes a loop, which would open by {gap:.3} m: set coordinates of its joints that fit together"
    )]
    LoopOpens {
        /// The joint.
        joint: String,
        /// Distance of its two pivots, m.
        gap: f64,
    },
    /// Error when the state was lost, and the simulation has to be reset first.
    #[error("the state was lost: reset the simulation first")]
    Lost,
}

/// Distance beyond a limit that counts as on it, rad or m: coordinates that were measured at a limit.
const SLACK: f64 = 1e-6;

/// Distance of the pivots of a joint that closes a loop up to which it counts as closed, m; and error of its coordinate, m or rad.
const MAX_GAP: f64 = 1e-3;

/// Pose of the inertial frame, velocity of the centre of mass and angular velocity, world axes.
#[derive(Clone, Copy)]
struct Motion {
    pose: Isometry3<f64>,
    linear: Vector3<f64>,
    angular: Vector3<f64>,
}

/// Coordinate and rate of a joint in a [`StateChange`].
#[derive(Clone, Copy, Default)]
struct Wanted {
    position: Option<f64>,
    rate: Option<f64>,
}

impl Scene {
    /// Sets a state. Controllers forget what they remember of the joints and bodies that moved.
    ///
    /// # Errors
    /// [`SetStateError`]; nothing has changed then.
    pub(crate) fn set_state(&mut self, change: &StateChange) -> Result<(), SetStateError> {
        let tree = Tree::of(self);
        let mut wanted: Table<JointId, Wanted> = Table::filled(Wanted::default(), self.joints.len());
        let before: Table<BodyId, Option<Motion>> =
            self.bodies.iter().map(|body| self.motion(body)).collect::<Vec<_>>().into();
        let mut after = before.clone();
        let mut is_touched: Table<BodyId, bool> = Table::filled(false, before.len());
        let mut following = Vec::new();
        for &(id, position) in &change.positions {
            if !self.leads(&tree, id, position)? {
                following.push((id, position));
                continue;
            }
            let outside = self.joints[id].limits.filter(|limits| limits.low <= limits.high);
            if let Some(limits) =
                outside.filter(|limits| !(limits.low - SLACK..=limits.high + SLACK).contains(&position))
            {
                let (joint, adf::Limits { low, high }) = (self.joints[id].name.clone(), limits);
                return Err(SetStateError::OutOfLimits { joint, value: position, low, high });
            }
            wanted[id].position = Some(position);
        }
        for &(id, rate) in &change.rates {
            if self.leads(&tree, id, rate)? {
                wanted[id].rate = Some(rate);
            }
        }
        self.follow(&before, &mut wanted)?;
        for &(id, pose) in &change.poses {
            let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            self.check_root(&tree, id, "pose", numbers.copied().all(f64::is_finite))?;
            if let Some(motion) = &mut after[id] {
                motion.pose = pose * self.bodies[id].inertial_offset;
            }
            is_touched[id] = true;
        }
        for &(id, [linear, angular]) in &change.twists {
            let is_finite = linear.iter().chain(angular.iter()).copied().all(f64::is_finite);
            self.check_root(&tree, id, "velocity", is_finite)?;
            if let Some(motion) = &mut after[id] {
                (motion.linear, motion.angular) = (linear, angular);
            }
            is_touched[id] = true;
        }
        for &id in &tree.order {
            let Some(leading) = tree.leading[id] else { continue };
            let joint = &self.joints[leading];
            let (Some(parent), Some(child), Some(new_parent)) = (before[joint.parent], before[id], after[joint.parent])
            else {
                continue;
            };
            let Wanted { position, rate } = wanted[leading];
            if is_touched[joint.parent] || position.is_some() || rate.is_some() {
                is_touched[id] = true;
                after[id] = Some(moved(joint, wanted[leading], [&parent, &child], &new_parent));
            }
        }
        self.check_loops(&tree, &before, &after)?;
        self.check_couplings(&after)?;
        for (id, position) in following {
            let joint = &self.joints[id];
            let found = match (after[joint.parent], after[joint.child]) {
                (Some(parent), Some(child)) if has_coordinate(joint) => coordinate(joint, &parent, &child),
                _ => joint.position,
            };
            if (found - position).abs() > MAX_GAP {
                return Err(SetStateError::Follows { joint: joint.name.clone(), value: position, found });
            }
        }
        for (id, &motion) in after.entries().filter(|(id, _)| is_touched[*id]) {
            let Some(motion) = motion else { continue };
            let body = &mut self.bodies[id];
            self.world.set_pose(body.handle, &motion.pose);
            if body.is_dynamic() {
                self.world.set_velocity(body.handle, &motion.linear, &motion.angular);
            }
            body.controller.reset();
            body.target.reset();
        }
        for joint in self.joints.iter_mut().filter(|joint| is_touched[joint.child]) {
            joint.reset();
            if let (Some(parent), Some(child), true) = (after[joint.parent], after[joint.child], has_coordinate(joint))
            {
                (joint.position, joint.velocity) = (coordinate(joint, &parent, &child), rate(joint, &parent, &child));
            }
        }
        Ok(())
    }

    /// `None` for a body that was removed.
    fn motion(&self, body: &Body) -> Option<Motion> {
        let (linear, angular) = self.world.velocity(body.handle)?;
        Some(Motion { pose: self.world.pose(body.handle)?, linear, angular })
    }

    /// Whether a joint can be set: it has a coordinate and leads to its child. `value`: what it is to have.
    fn leads(&self, tree: &Tree, id: JointId, value: f64) -> Result<bool, SetStateError> {
        let joint = &self.joints[id];
        if !value.is_finite() {
            return Err(SetStateError::NotFinite { of: joint.name.clone() });
        }
        Ok(has_coordinate(joint) && tree.leading[joint.child] == Some(id))
    }

    fn check_root(
        &self,
        tree: &Tree,
        id: BodyId,
        quantity: &'static str,
        is_finite: bool,
    ) -> Result<(), SetStateError> {
        let body = &self.bodies[id];
        let name = || body.identity.name.to_string();
        if !is_finite {
            return Err(SetStateError::NotFinite { of: name() });
        }
        let why = match tree.leading[id] {
            Some(joint) => {
                format!("it hangs below the joint {}; set coordinates of joints instead", self.joints[joint].name)
            }
            None if quantity == "velocity" && !body.is_dynamic() => {
                "it has no mass; command its velocity instead".into()
            }
            None => return Ok(()),
        };
        Err(SetStateError::NotFree { quantity, body: name(), why })
    }

    /// Sets what followers have to have where one of their leaders is set. A follower that is set, too, has to have it already.
    fn follow(
        &self,
        before: &Table<BodyId, Option<Motion>>,
        wanted: &mut Table<JointId, Wanted>,
    ) -> Result<(), SetStateError> {
        for &id in &self.followers {
            let joint = &self.joints[id];
            let Some(coupling) = &joint.coupling else { continue };
            let is_set = |of: &dyn Fn(&Wanted) -> bool| coupling.leaders.iter().any(|(leader, _)| of(&wanted[*leader]));
            let (has_position, has_rate) = (is_set(&|w| w.position.is_some()), is_set(&|w| w.rate.is_some()));
            let own = wanted[id].position;
            if has_position || own.is_some() {
                let found = coupling.asked(|id| wanted[id].position.unwrap_or(self.joints[id].position));
                let value = own.unwrap_or(found);
                let apart = self.apart(joint, value, found);
                if apart.abs() > MAX_GAP {
                    return Err(SetStateError::Follows { joint: joint.name.clone(), value, found });
                }
                wanted[id].position = Some(value + apart);
            }
            if has_rate {
                let rate_of = |id: JointId| {
                    let joint = &self.joints[id];
                    let motions = before[joint.parent].zip(before[joint.child]);
                    wanted[id].rate.unwrap_or_else(|| motions.map_or(0.0, |(a, b)| rate(joint, &a, &b)))
                };
                wanted[id].rate = Some(coupling.asked(rate_of) - coupling.offset);
            }
        }
        Ok(())
    }

    /// Coupled joints that close loops must fit together, too.
    fn check_couplings(&self, after: &Table<BodyId, Option<Motion>>) -> Result<(), SetStateError> {
        let present = |id: JointId| self.joints[id].position;
        let position = |id: JointId| {
            let joint = &self.joints[id];
            let motions = after[joint.parent].zip(after[joint.child]);
            motions.map_or(joint.position, |(parent, child)| coordinate(joint, &parent, &child))
        };
        for &id in &self.followers {
            let joint = &self.joints[id];
            let Some(coupling) = &joint.coupling else { continue };
            let apart = |position: &dyn Fn(JointId) -> f64| self.apart(joint, position(id), coupling.asked(position));
            if apart(&position).abs() > apart(&present).abs() + MAX_GAP {
                let (value, found) = (position(id), coupling.asked(position));
                return Err(SetStateError::Follows { joint: joint.name.clone(), value, found });
            }
        }
        Ok(())
    }

    /// By how much the coordinate of a follower is not what is asked of it, rad or m: coordinates are known up to whole turns.
    fn apart(&self, follower: &Joint, position: f64, asked: f64) -> f64 {
        let leaders = follower.coupling.iter().flat_map(|coupling| &coupling.leaders);
        let turns =
            leaders.filter(|(leader, _)| self.joints[*leader].joint_type.is_angular()).map(|(_, ratio)| TAU * ratio);
        let own = follower.joint_type.is_angular().then_some(TAU);
        let turns = turns.chain(own).filter(|turn| *turn != 0.0);
        turns.fold(asked - position, |apart, turn| apart - turn * (apart / turn).round())
    }

    /// Joints that close loops must not open.
    fn check_loops(
        &self,
        tree: &Tree,
        before: &Table<BodyId, Option<Motion>>,
        after: &Table<BodyId, Option<Motion>>,
    ) -> Result<(), SetStateError> {
        for (id, joint) in self.joints.entries() {
            let slides =
                joint.joint_type.is_linear() || matches!(joint.joint_type, JointType::SixDof | JointType::SixDofSpring);
            if joint.handle.is_none() || joint.removed || slides || tree.leading[joint.child] == Some(id) {
                continue;
            }
            let gap = |motions: &Table<BodyId, Option<Motion>>| {
                let pivot = |body: BodyId, side: usize| {
                    Some(motions[body]?.pose * Point3::from(joint.frames[side].translation.vector))
                };
                Some((pivot(joint.parent, 0)? - pivot(joint.child, 1)?).norm())
            };
            if let (Some(open), Some(opened)) = (gap(before), gap(after)) {
                if opened > open + MAX_GAP {
                    return Err(SetStateError::LoopOpens { joint: joint.name.clone(), gap: opened });
                }
            }
        }
        Ok(())
    }
}

/// Relative velocity of the child at its centre of mass, and relative angular velocity, in the axes of the world.
fn relative(parent: &Motion, child: &Motion) -> [Vector3<f64>; 2] {
    let arm = child.pose.translation.vector - parent.pose.translation.vector;
    [child.linear - parent.linear - parent.angular.cross(&arm), child.angular - parent.angular]
}

fn has_coordinate(joint: &Joint) -> bool {
    joint.joint_type.is_angular() || joint.joint_type.is_linear()
}

/// Coordinate of a joint that has one, rad (-π to π) or m.
fn coordinate(joint: &Joint, parent: &Motion, child: &Motion) -> f64 {
    let [in_parent, in_child] = &joint.frames;
    let frame = parent.pose.inverse() * child.pose * in_child;
    if joint.joint_type.is_linear() {
        return joint.axis.dot(&(frame.translation.vector - in_parent.translation.vector));
    }
    let turn = frame.rotation * in_parent.rotation.inverse();
    let angle = 2.0 * joint.axis.dot(&turn.imag()).atan2(turn.w);
    angle - TAU * (angle / TAU).round()
}

/// Rate of a joint with a coordinate, rad/s or m/s.
fn rate(joint: &Joint, parent: &Motion, child: &Motion) -> f64 {
    let [linear, angular] = relative(parent, child);
    let axis = parent.pose.rotation * joint.axis;
    axis.dot(if joint.joint_type.is_angular() { &angular } else { &linear })
}

/// Motion of the child of a joint when its parent moves as `new_parent`. `old`: parent and child before.
fn moved(joint: &Joint, wanted: Wanted, old: [&Motion; 2], new_parent: &Motion) -> Motion {
    let [parent, child] = old;
    let pivot = joint.frames[0].translation;
    let by = wanted.position.map_or(0.0, |wanted| wanted - coordinate(joint, parent, child));
    let along_axis = if joint.joint_type.is_angular() {
        let turn = UnitQuaternion::from_axis_angle(&Unit::new_unchecked(joint.axis), by);
        pivot * Isometry3::from_parts(Translation3::identity(), turn) * pivot.inverse()
    } else {
        Isometry3::from_parts(Translation3::from(joint.axis * by), UnitQuaternion::identity())
    };
    let in_parent = along_axis * (parent.pose.inverse() * child.pose);
    let pose = new_parent.pose * in_parent;
    let [linear, angular] = if has_coordinate(joint) {
        let along = new_parent.pose.rotation * joint.axis * wanted.rate.unwrap_or_else(|| rate(joint, parent, child));
        let arm = pose.translation.vector - (new_parent.pose * Point3::from(pivot.vector)).coords;
        if joint.joint_type.is_angular() {
            [along.cross(&arm), along]
        } else {
            [along, Vector3::zeros()]
        }
    } else {
        // The relative motion turns with the parent.
        let turn = new_parent.pose.rotation * parent.pose.rotation.inverse();
        relative(parent, child).map(|part| turn * part)
    };
    let arm = pose.translation.vector - new_parent.pose.translation.vector;
    Motion {
        pose,
        linear: new_parent.linear + new_parent.angular.cross(&arm) + linear,
        angular: new_parent.angular + angular,
    }
}

/// Which joint leads to each body.
struct Tree {
    /// `None`: the body is a root.
    leading: Table<BodyId, Option<JointId>>,
    /// All bodies, each after its parent.
    order: Vec<BodyId>,
}

impl Tree {
    fn of(scene: &Scene) -> Self {
        let count = scene.bodies.len();
        let mut leading: Table<BodyId, Option<JointId>> = Table::filled(None, count);
        // Roots of the trees so far, by paths that become shorter as they are walked.
        let mut above: Vec<usize> = (0..count).collect();
        let root = |above: &mut [usize], mut body: usize| {
            while above[body] != body {
                above[body] = above[above[body]];
                body = above[body];
            }
            body
        };
        let mut joined = Vec::new();
        for (id, joint) in scene.joints.entries() {
            let is_there = joint.handle.is_some() && !joint.removed && scene.bodies[joint.child].is_dynamic();
            let top = root(&mut above, joint.parent.index());
            if is_there && leading[joint.child].is_none() && top != joint.child.index() {
                leading[joint.child] = Some(id);
                joined.push((joint.parent, joint.child));
                above[joint.child.index()] = top;
            }
        }
        let mut below: Table<BodyId, Vec<BodyId>> = Table::filled(Vec::new(), count);
        for (parent, child) in joined {
            below[parent].push(child);
        }
        let mut order: Vec<BodyId> = (0..count).map(BodyId::new).filter(|id| leading[*id].is_none()).collect();
        let mut next = 0;
        while let Some(&body) = order.get(next) {
            order.append(&mut below[body]);
            next += 1;
        }
        Self { leading, order }
    }
}
