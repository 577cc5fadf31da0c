//! Commands of the accurate profile: they are kept for an update and executed in each of its sub-steps.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Vector3};

use super::carriage::{way_between, Carriage};
use super::joint::{Joint, JointType};
use super::{Bodies, Body, Scene};
use crate::adf::{Controller, Gains, Limits, IMPULSE_STEP};
use crate::bullet::{BodyDrive, SoftMotor, SubStep, World};
use crate::comm::{CartesianCommandType, JointCommandType, RigidBodyCommand};
use crate::control::{
    orientation_of, shortest_angle, JointDriver, PoseAction, PoseDriver, Profile, Quantity, Scheme, SetpointMotion,
    TrackingError,
};

/// Largest turn that a position controller may ask of a joint in a sub-step, rad. The derivative part of a controller asks
/// for any turn where the set point jumps, and an absurd gain always. Rows of joints are linear in the motion, so that larger
/// turns open them, and a joint that turns further may be beyond its limits in the same sub-step.
const MAX_DRIVEN_TURN: f64 = 0.1;

impl Scene {
    /// Ends all that commands have begun: motors are off, and joints and bodies have no targets.
    pub(crate) fn end_commands(&mut self) {
        let Self { world, joints, bodies, .. } = self;
        for joint in joints {
            joint.stop_motor(world);
            joint.let_go(world);
            joint.target.forget();
        }
        for body in bodies.iter_mut() {
            body.let_go(world);
            body.target.forget();
            body.control = CartesianCommandType::default();
        }
    }
}

/// The command of a joint for the next update.
#[derive(Debug, Clone)]
pub(crate) struct JointTarget {
    driver: JointDriver,
    /// N·m or N.
    effort: f64,
    /// Position, rad or m.
    goal: Option<f64>,
    /// Goal of the update before, if there was one, how fast it moved since, and how fast it moves.
    last_goal: Option<f64>,
    last_rate: Option<f64>,
    goal_motion: SetpointMotion<f64>,
    /// Bullet holds a spring, which goes when nobody asks for it.
    has_spring: bool,
    /// Force and torque on the parent that the effort made of in the sub-step before, world axes; the child has the
    /// opposite force, and, if it turns, the opposite torque.
    applied: Option<[Vector3<f64>; 2]>,
    is_listed: bool,
}

impl JointTarget {
    pub fn new(controller: &Controller) -> Self {
        Self::of(JointDriver::new(controller))
    }

    fn of(driver: JointDriver) -> Self {
        Self {
            driver,
            effort: 0.0,
            goal: None,
            last_goal: None,
            last_rate: None,
            goal_motion: SetpointMotion::default(),
            has_spring: false,
            applied: None,
            is_listed: false,
        }
    }

    /// Force, N, and torque about the centre of mass, N·m, of the commanded effort on the child in the latest sub-step, world
    /// axes.
    pub fn exerted_on_child(&self, joint_type: JointType) -> [Vector3<f64>; 2] {
        let [force, torque] = self.applied.unwrap_or_default();
        let turns = matches!(joint_type, JointType::Revolute | JointType::TorsionSpring);
        [-force, if turns { -torque } else { Vector3::zeros() }]
    }

    /// Uses other gains from now on.
    pub fn set_gains(&mut self, gains: Gains) {
        self.driver.set_gains(gains);
    }

    /// Forgets what the controller remembers.
    pub fn reset(&mut self) {
        self.driver.reset();
        (self.last_goal, self.last_rate) = (None, None);
    }

    /// Forgets all, also what was commanded.
    fn forget(&mut self) {
        self.driver.reset();
        *self = Self::of(self.driver.clone());
    }
}

impl Joint {
    /// Takes a command for the next update. True when the joint has to be [driven](Self::drive) from
    /// now on.
    pub(crate) fn set_target(&mut self, world: &mut World, kind: JointCommandType, value: f64) -> bool {
        match kind {
            JointCommandType::Effort => {
                self.let_go(world);
                self.target.effort += value;
                self.target.goal = None;
            }
            JointCommandType::Velocity if self.has_motor() => {
                let drive = self.motor(value);
                self.handle.map(|handle| world.set_soft_motor(handle, Some(drive)));
                self.target.has_spring = false;
                self.target.goal = None;
                return false;
            }
            JointCommandType::Position if self.enable_motor && self.has_motor() => self.target.goal = Some(value),
            _ => return false,
        }
        !std::mem::replace(&mut self.target.is_listed, true)
    }

    /// Turn that a jump of the set point may cause in the next sub-step, rad; 0 for joints of articulations.
    pub(crate) fn expected_turn(&self, world: &World, bodies: &Bodies) -> f64 {
        let (Some(goal), Some(handle)) = (self.target.goal, self.handle) else { return 0.0 };
        if world.is_articulated(handle) {
            return 0.0;
        }
        let Some(from) = self.target.last_goal.or_else(|| Some(world.coordinate(handle)?.0)) else { return 0.0 };
        let goal = self.within_limits(goal);
        match self.joint_type {
            JointType::Revolute if self.limits.is_none() => shortest_angle(from, goal, Profile::Accurate).abs(),
            JointType::Revolute => (goal - from).abs(),
            _ => {
                let pose = |body| world.pose(body);
                let (Some(parent), Some(child)) = (pose(bodies[self.parent].handle), pose(bodies[self.child].handle))
                else {
                    return 0.0;
                };
                let arm = (parent.translation.vector - child.translation.vector).norm();
                (goal - from).abs() / arm.max(f64::MIN_POSITIVE)
            }
        }
        .min(MAX_DRIVEN_TURN)
    }

    // Not `clamp`: the limits may be the wrong way round.
    fn within_limits(&self, goal: f64) -> f64 {
        self.limits.map_or(goal, |Limits { low, high }| goal.min(high).max(low))
    }

    /// Pursues the target in the sub-step that follows.
    pub(crate) fn drive(&mut self, world: &mut World, bodies: &Bodies, sub_step: SubStep) {
        if sub_step.is_first() {
            self.target.applied = None;
        }
        match self.target.goal {
            Some(goal) => self.pursue(world, goal, sub_step),
            None if sub_step.is_first() => {
                self.target.reset();
                if self.target.has_spring {
                    self.let_go(world);
                }
            }
            None => (),
        }
        if self.target.effort != 0.0 {
            self.push(world, bodies);
        }
    }

    /// Ends an update; without sub-steps its goal waits for the next one. False when nothing is left to do.
    pub(crate) fn end_update(&mut self, sub_steps: u32) -> bool {
        self.target.effort = 0.0;
        if sub_steps > 0 {
            // What was applied is forgotten in the next update.
            self.target.is_listed = self.target.goal.take().is_some() || self.target.applied.is_some();
        }
        self.target.is_listed
    }

    /// Takes the drive out of Bullet's joint.
    pub(crate) fn let_go(&mut self, world: &mut World) {
        self.target.has_spring = false;
        if let Some(handle) = self.handle.filter(|_| self.has_motor()) {
            world.set_soft_motor(handle, None);
        }
    }

    fn has_motor(&self) -> bool {
        matches!(self.joint_type, JointType::Revolute | JointType::Prismatic)
    }

    fn motor(&self, velocity: f64) -> SoftMotor {
        let velocity = self.possible_rate(velocity);
        SoftMotor { velocity, softness: 0.0, max_force: self.max_motor_impulse / IMPULSE_STEP }
    }

    fn pursue(&mut self, world: &mut World, goal: f64, sub_step: SubStep) {
        let Some((handle, (position, rate))) = self.handle.and_then(|handle| Some((handle, world.coordinate(handle)?)))
        else {
            return;
        };
        let turns_freely = self.limits.is_none() && self.joint_type == JointType::Revolute;
        let goal = self.within_limits(goal);
        let target = &mut self.target;
        if sub_step.is_first() {
            let rate = target.last_goal.replace(goal).map(|last| {
                let moved = goal - last;
                (if turns_freely { (moved + PI).rem_euclid(TAU) - PI } else { moved }) / sub_step.duration
            });
            target.goal_motion = motion_of(rate, target.last_rate);
            target.last_rate = rate;
        }
        let goal = goal + target.goal_motion.drift * sub_step.start;
        let error = match self.limits {
            Some(Limits { low, high }) => goal.min(high).max(low) - position,
            None if turns_freely => shortest_angle(position, goal, Profile::Accurate),
            None => goal - position,
        };
        let is_articulated = world.is_articulated(handle);
        let scheme = if is_articulated { Scheme::Collocated } else { Scheme::Staggered };
        let at = TrackingError { error, set_rate: target.goal_motion.rate, rate };
        let mut row = target.driver.update(&at, scheme, sub_step.length);
        target.has_spring = target.driver.is_spring();
        // The springs of articulations are part of their equations of motion, in which stiffness does no harm.
        if self.joint_type == JointType::Revolute && !(is_articulated && target.has_spring) {
            let most = MAX_DRIVEN_TURN / sub_step.whole;
            row.velocity = row.velocity.max(-most).min(most);
        }
        let drive = if target.has_spring {
            // As in the C++ program, forces of a controller have no bound, unless the drive has one.
            let max_force = self.drive_train.max_effort.unwrap_or(f64::INFINITY);
            SoftMotor { velocity: row.velocity, softness: row.softness, max_force }
        } else {
            self.motor(row.velocity)
        };
        world.set_soft_motor(handle, Some(drive));
    }

    /// Replaces the wrenches of the sub-step before by those of the present pose.
    fn push(&mut self, world: &mut World, bodies: &Bodies) {
        let (parent, child) = (bodies[self.parent].handle, bodies[self.child].handle);
        let (Some(pose), Some(child_pose)) = (world.pose(parent), world.pose(child)) else { return };
        let along = pose.rotation * self.axis * self.possible_effort(self.target.effort);
        let on_parent = match self.joint_type {
            JointType::Revolute | JointType::TorsionSpring => [Vector3::zeros(), -along],
            JointType::Prismatic | JointType::LinearSpring => {
                // Through the child's centre of mass on both: two forces on different lines would be a torque from
                // nowhere.
                [-along, (pose.translation.vector - child_pose.translation.vector).cross(&along)]
            }
            _ => return,
        };
        let before = self.target.applied.replace(on_parent).unwrap_or_default();
        let [force, torque] = [on_parent[0] - before[0], on_parent[1] - before[1]];
        world.apply_wrench(parent, &force, &torque);
        let turns = matches!(self.joint_type, JointType::Revolute | JointType::TorsionSpring);
        world.apply_wrench(child, &-force, &if turns { -torque } else { Vector3::zeros() });
    }
}

/// Motion of a set point by its rates in the latest update and in the one before, as far as there were commands then.
fn motion_of<T: Quantity + Default>(latest: Option<T>, before: Option<T>) -> SetpointMotion<T> {
    match (latest, before) {
        (Some(latest), Some(before)) => SetpointMotion::following(latest, before),
        (latest, _) => SetpointMotion { rate: latest.unwrap_or_default(), drift: T::default() },
    }
}

/// The command of a body for the next update.
#[derive(Debug, Clone)]
pub(crate) struct BodyTarget {
    driver: PoseDriver,
    goal: Option<BodyGoal>,
    /// Wanted pose of the update before, if there was one, how fast it moved since, and how fast it moves: m/s and
    /// rad/s, world axes.
    last_target: Option<Isometry3<f64>>,
    last_rates: Option<[Vector3<f64>; 2]>,
    target_motion: [SetpointMotion<Vector3<f64>>; 2],
    has_spring: bool,
    is_listed: bool,
    /// Of a body without mass.
    pub(super) carriage: Carriage,
}

/// Of the inertial frame in the world.
#[derive(Debug, Clone, Copy)]
enum BodyGoal {
    Pose(Isometry3<f64>),
    Velocity([Vector3<f64>; 2]),
}

impl BodyTarget {
    pub fn new(linear: &Controller, angular: &Controller) -> Self {
        Self::of(PoseDriver::new(linear, angular))
    }

    fn of(driver: PoseDriver) -> Self {
        Self {
            driver,
            goal: None,
            last_target: None,
            last_rates: None,
            target_motion: Default::default(),
            has_spring: false,
            is_listed: false,
            carriage: Carriage::default(),
        }
    }

    /// Uses other gains, linear and angular, from now on.
    pub fn set_gains(&mut self, gains: [Gains; 2]) {
        self.driver.set_gains(gains);
    }

    /// Forgets what the controller remembers.
    pub fn reset(&mut self) {
        self.carriage = Carriage::default();
        (self.last_target, self.last_rates) = (None, None);
        self.driver.reset();
    }

    /// Forgets all, also what was commanded.
    fn forget(&mut self) {
        self.driver.reset();
        *self = Self::of(self.driver.clone());
    }
}

impl Body {
    /// Takes the Cartesian part of a command for the next update. True when the body has to be [driven](Self::drive)
    /// from now on.
    pub(crate) fn set_target(&mut self, world: &mut World, command: &RigidBodyCommand) -> bool {
        match command.cartesian {
            CartesianCommandType::Position => {
                let (orientation, _) = orientation_of(&command.orientation);
                let target = Isometry3::from_parts(command.position.into(), orientation) * self.inertial_offset;
                self.target.goal = Some(BodyGoal::Pose(target));
            }
            CartesianCommandType::Velocity => {
                let (linear, angular) = (command.linear_velocity, command.angular_velocity);
                if self.is_dynamic() {
                    world.set_velocity(self.handle, &linear, &angular);
                }
                self.target.goal = Some(BodyGoal::Velocity([linear, angular]));
            }
            CartesianCommandType::Force | CartesianCommandType::Unknown(_) => return false,
        }
        !std::mem::replace(&mut self.target.is_listed, true)
    }

    /// Pursues the target in the sub-step that follows.
    pub(crate) fn drive(&mut self, world: &mut World, sub_step: SubStep) {
        match self.target.goal {
            Some(BodyGoal::Pose(target)) if !self.is_dynamic() => self.carry(world, &target, sub_step),
            Some(BodyGoal::Velocity([linear, angular])) if !self.is_dynamic() => {
                self.target.carriage = Carriage::default();
                self.carry_on(world, &linear, &angular, sub_step.length);
            }
            Some(BodyGoal::Pose(target)) => self.pursue(world, &target, sub_step),
            Some(BodyGoal::Velocity([linear, angular])) => {
                if sub_step.is_first() {
                    self.let_go(world);
                }
                world.hold_velocity(self.handle, &linear, &angular, sub_step.length);
            }
            None if sub_step.is_first() => self.let_go(world),
            None => (),
        }
    }

    /// Ends an update; without sub-steps its goal waits for the next one. False when nothing is left to do.
    pub(crate) fn end_update(&mut self, sub_steps: u32) -> bool {
        if sub_steps > 0 {
            self.target.is_listed = self.target.goal.take().is_some();
        }
        self.target.is_listed
    }

    /// Takes the springs away from Bullet's body, and brings one without mass to rest.
    pub(crate) fn let_go(&mut self, world: &mut World) {
        self.target.reset();
        world.rest_body(self.handle);
        if std::mem::take(&mut self.target.has_spring) {
            world.set_body_drive(self.handle, None);
        }
    }

    /// `target` is a pose of the inertial frame: with the error of the body frame, whose origin is not where the force
    /// acts, a turning body would be pushed about.
    fn pursue(&mut self, world: &mut World, target: &Isometry3<f64>, sub_step: SubStep) {
        let (Some(pose), Some((linear, angular))) = (world.pose(self.handle), world.velocity(self.handle)) else {
            return;
        };
        let between = |from: &Isometry3<f64>| way_between(from, target);
        let state = &mut self.target;
        if sub_step.is_first() {
            let rates = state.last_target.replace(*target);
            let rates = rates.map(|last| between(&last).map(|part| part / sub_step.duration));
            let motion = |i: usize| motion_of(rates.map(|rates| rates[i]), state.last_rates.map(|rates| rates[i]));
            state.target_motion = [motion(0), motion(1)];
            state.last_rates = rates;
        }
        let (errors, rates, motion) = (between(&pose), [linear, angular], &state.target_motion);
        let deviation = |i: usize| TrackingError {
            error: errors[i] + motion[i].drift * sub_step.start,
            set_rate: motion[i].rate,
            rate: rates[i],
        };
        match state.driver.update(&[deviation(0), deviation(1)], sub_step.length) {
            PoseAction::Springs([linear, angular]) => {
                let drive = BodyDrive {
                    velocity: [linear.velocity, angular.velocity],
                    softness: [linear.softness, angular.softness],
                };
                state.has_spring = world.set_body_drive(self.handle, Some(&drive));
            }
            PoseAction::Velocity([linear, angular]) => {
                world.hold_velocity(self.handle, &linear, &angular, sub_step.length);
            }
        }
    }
}
