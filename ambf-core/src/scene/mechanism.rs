//! A tree of bodies of a scene as a [`Tree`], whose Jacobians, mass matrix and forces can be asked for.

use std::collections::{HashMap, HashSet};

use nalgebra::{Isometry3, Translation3, Unit, Vector3};
use thiserror::Error;

use super::{Body, Joint, JointType, Scene};
use crate::adf::Limits;
use crate::ids::{BodyId, JointId};
use ambf_dynamics::tree::{Follower, Link, Motion, Tree};

/// Bodies that joints hold together, and what they are in a [`Tree`].
///
/// It is what the scene was when it was made: after a change of masses, limits or gravity it has to be made anew.
#[derive(Debug, Clone)]
pub struct Mechanism {
    /// Links are at the centres of mass of [`bodies`](Self::bodies), along the axes of their inertial frames.
    pub tree: Tree,
    /// (links) the bodies; the first is the base.
    pub bodies: Vec<BodyId>,
    /// (coordinates) the joints with a coordinate, in the order of the scene.
    pub joints: Vec<JointId>,
}

/// Error when bodies are no tree of rigid bodies with revolute, prismatic and fixed joints.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum MechanismError {
    /// Error when the body is not there any more.
    #[error("the body was removed")]
    Removed,
    /// Error when a joint is of another type.
    #[error(
        "the joint {joint} is of type {kind}: trees have revolute, prismatic and fixed joints, and springs beside them"
    )]
    OtherJoint {
        /// Its name.
        joint: String,
        /// Its type.
        kind: &'static str,
    },
    /// Error when a joint closes a loop.
    #[error("the joint {joint} closes a loop: a body of a tree hangs on one joint, and a tree on one static body")]
    Loop {
        /// Its name.
        joint: String,
    },
    /// Error when a body that moves has a moment of inertia 0, which stands for one that is infinite.
    #[error(
        "the body {body} has a moment of inertia 0, which means that it does not turn: trees need moments above 0"
    )]
    DoesNotTurn {
        /// Its name.
        body: String,
    },
}

impl Scene {
    /// The tree that a body is part of: all that hangs together by joints. A body without mass, as which it stands still, is the
    /// base of all that hangs on it. Else the base is free: the body that no joint has as its child.
    ///
    /// Joints are without what they lose, but for the inertia of their rotors, and springs beside a joint, motors and limits are not part of it. Bodies that an
    /// actuator holds are neither.
    ///
    /// # Errors
    /// [`MechanismError`].
    pub fn mechanism(&self, body: BodyId) -> Result<Mechanism, MechanismError> {
        if self.bodies[body].removed || self.world.pose(self.bodies[body].handle).is_none() {
            return Err(MechanismError::Removed);
        }
        let (members, joints) = self.hanging_together(body)?;
        let is_child: HashSet<BodyId> = joints.iter().map(|id| self.joints[*id].child).collect();
        let is_still = |id: &BodyId| !self.bodies[*id].is_dynamic();
        let still = std::iter::once(body).chain(members.iter().copied()).find(is_still);
        let base = still.or_else(|| members.iter().copied().find(|id| !is_child.contains(id))).unwrap_or(body);
        let moves = |id: &&JointId| self.joints[**id].joint_type != JointType::Fixed;
        let with_coordinate: Vec<JointId> = joints.iter().filter(moves).copied().collect();
        let joints_of = self.joints_of_bodies(joints.iter().copied());
        let (of_base, none) = (&self.bodies[base], Vec::new());
        let links = match is_still(&base) {
            true => vec![Link::base(0.0, Vector3::zeros(), Vector3::zeros())],
            false => vec![Link::base(of_base.mass, self.moments(of_base)?, self.gravity_of(of_base))],
        };
        let (mut links, mut order) = (links, vec![base]);
        let (mut reached, mut used) = (HashSet::from([base]), HashSet::new());
        let mut next = 0;
        while let Some(&parent) = order.get(next) {
            for &id in joints_of.get(&parent).unwrap_or(&none) {
                if !used.insert(id) {
                    continue;
                }
                let joint = &self.joints[id];
                let child = if joint.parent == parent { joint.child } else { joint.parent };
                // What stands still is one base.
                if is_still(&child) || !reached.insert(child) {
                    return Err(MechanismError::Loop { joint: joint.name.clone() });
                }
                links.push(self.link(joint, child, (next, with_coordinate.binary_search(&id).unwrap_or_default()))?);
                order.push(child);
            }
            next += 1;
        }
        let number = |id: &JointId| with_coordinate.binary_search(id).ok();
        let followers = with_coordinate.iter().enumerate().filter_map(|(coordinate, id)| {
            let coupling = self.joints[*id].coupling.as_ref()?;
            // A leader in another tree: that coupling is between two, and nothing of this one.
            let leaders: Option<Vec<_>> =
                coupling.leaders.iter().map(|(leader, ratio)| Some((number(leader)?, *ratio))).collect();
            Some(Follower { coordinate, leaders: leaders?, offset: coupling.offset })
        });
        let tree = Tree::new(links, of_base.is_dynamic()).with_followers(followers.collect());
        Ok(Mechanism { tree, bodies: order, joints: with_coordinate })
    }

    /// The joints of each body that has some, ascending.
    fn joints_of_bodies(&self, joints: impl Iterator<Item = JointId>) -> HashMap<BodyId, Vec<JointId>> {
        let mut joints_of: HashMap<BodyId, Vec<JointId>> = HashMap::new();
        for id in joints {
            let Joint { parent, child, .. } = self.joints[id];
            joints_of.entry(parent).or_default().push(id);
            if child != parent {
                joints_of.entry(child).or_default().push(id);
            }
        }
        joints_of
    }

    /// Bodies and joints that hang together with a body: over bodies that move, and to those that do not. Joints ascend; those
    /// between bodies that stand still, and springs beside joints, are left out.
    fn hanging_together(&self, body: BodyId) -> Result<(Vec<BodyId>, Vec<JointId>), MechanismError> {
        let is_dynamic = |id: BodyId| self.bodies[id].is_dynamic();
        let is_there = |joint: &Joint| {
            joint.handle.is_some() && !joint.removed && (is_dynamic(joint.parent) || is_dynamic(joint.child))
        };
        let all = self.joints.entries().filter(|(_, joint)| is_there(joint)).map(|(id, _)| id);
        let joints_of = self.joints_of_bodies(all);
        let (mut members, mut seen, mut joints) = (vec![body], HashSet::from([body]), Vec::new());
        let mut next = 0;
        while let Some(&member) = members.get(next) {
            next += 1;
            // Another body that stands still ends the tree.
            let is_passed = member == body || is_dynamic(member);
            for &id in joints_of.get(&member).into_iter().flatten().filter(|_| is_passed) {
                joints.push(id);
                let ends = [self.joints[id].parent, self.joints[id].child];
                members.extend(ends.into_iter().filter(|end| seen.insert(*end)));
            }
        }
        joints.sort_unstable();
        joints.dedup();
        let ends = |id: &JointId| {
            let Joint { parent, child, .. } = self.joints[*id];
            (parent.min(child), parent.max(child))
        };
        let kind = |id: &JointId| self.joints[*id].joint_type;
        let is_spring = |id: &JointId| matches!(kind(id), JointType::LinearSpring | JointType::TorsionSpring);
        let joined: HashSet<_> = joints.iter().filter(|id| !is_spring(id)).map(ends).collect();
        joints.retain(|id| !(is_spring(id) && joined.contains(&ends(id))));
        let is_other =
            |id: &&JointId| !matches!(kind(id), JointType::Revolute | JointType::Prismatic | JointType::Fixed);
        if let Some(id) = joints.iter().find(is_other) {
            return Err(MechanismError::OtherJoint { joint: self.joints[*id].name.clone(), kind: kind(id).name() });
        }
        Ok((members, joints))
    }

    /// Gravity that a body feels, m/s².
    pub fn gravity_of(&self, body: &Body) -> Vector3<f64> {
        body.gravity.unwrap_or(self.gravity)
    }

    /// Principal moments of inertia of a body that moves, kg·m².
    fn moments(&self, body: &Body) -> Result<Vector3<f64>, MechanismError> {
        match body.inertia.iter().all(|moment| *moment > 0.0) {
            true => Ok(body.inertia),
            false => Err(MechanismError::DoesNotTurn { body: body.identity.name.to_string() }),
        }
    }

    /// A link and the joint to its parent; `numbers`: of the parent among the links, and of the joint's coordinate.
    fn link(&self, joint: &Joint, child: BodyId, numbers: (usize, usize)) -> Result<Link, MechanismError> {
        let body = &self.bodies[child];
        let (parent, coordinate) = numbers;
        let motion = match joint.joint_type {
            JointType::Revolute => Motion::Revolute(coordinate),
            JointType::Prismatic => Motion::Prismatic(coordinate),
            _ => Motion::Fixed,
        };
        // Where the joint's own child is the parent here, the same joint moves the other way round.
        let [in_parent, in_child] = joint.frames;
        let (in_upper, in_lower, axis) = match joint.child == child {
            true => (in_parent, in_child, joint.axis),
            false => (in_child, in_parent, -(in_child.rotation * in_parent.rotation.inverse() * joint.axis)),
        };
        let turned = Isometry3::from_parts(Translation3::identity(), in_upper.rotation);
        let limits = joint.limits.filter(|limits| limits.low <= limits.high);
        Ok(Link {
            parent,
            motion,
            pivot: in_upper.translation.vector,
            axis: Unit::new_normalize(axis),
            rest: turned * in_lower.inverse(),
            mass: body.mass,
            inertia: self.moments(body)?,
            gravity: self.gravity_of(body),
            limits: limits.map_or([f64::NEG_INFINITY, f64::INFINITY], |Limits { low, high }| [low, high]),
            armature: if motion == Motion::Fixed { 0.0 } else { joint.drive_train.armature },
        })
    }
}
