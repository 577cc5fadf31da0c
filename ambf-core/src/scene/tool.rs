//! Tools of volumes: bodies with balls that touch voxels, of which the first one cuts.
//!
//! Each ball follows the body as far as the voxels let it ([`Proxy`]), in the volume's frame; a spring between both acts
//! on the body, and with the opposite sign on the body that carries the volume, in the next update. So what drives the
//! body feels it: a controller, or the hand at an input device with all limits of the device.
//!
//! A tool with burrs has one of them at a time. Its body is put where the volume lets the tool be; the others are not
//! drawn.

use std::sync::Arc;

use ambf_volume::proxy::{Law, Proxy, Surface};
use ambf_volume::{Carved, Carver, Rule, Shape, Stroke, VoxelGrid};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use super::{Bodies, Body};
use crate::adf::VolumeTool;
use crate::bullet::World;
use crate::comm::ToolReading;
use crate::ids::BodyId;

/// Voxels that a tool cuts in an update without new memory.
const ROOM: usize = 1 << 14;

/// Share of a voxel's edge beside the burr within which it removes voxels: those that it touches.
const REACH: f64 = 0.9;

/// Burrs are told apart by their radii from this difference on, m.
const SAME_RADIUS: f64 = 1e-6;

/// A body that shows a burr is moved from this difference on, m and rad: rounding moves nothing.
const SAME_POSE: f64 = 1e-9;

/// A tool of a volume.
#[derive(Debug, Clone)]
pub(super) struct Tool {
    description: VolumeTool,
    /// `None`: it is not there.
    pub body: Option<BodyId>,
    /// (burrs x 1) the bodies that show them.
    pub burr_bodies: Vec<Option<BodyId>>,
    /// Whether it puts the body of its burr somewhere also while it touches nothing: of the tools with one body, the
    /// first.
    pub leads: bool,
    /// The tip, then the cursors.
    balls: Vec<Ball>,
    is_on: bool,
    /// Which of its burrs it has.
    burr: Option<usize>,
    /// A burr that removes a number of voxels has done so in the update before.
    rests: bool,
    carver: Carver,
    force: Vector3<f64>,
    goal: Vector3<f64>,
    tip: Vector3<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Ball {
    /// In the body frame, m.
    place: Point3<f64>,
    proxy: Proxy,
    /// The goal of the latest update, in the volume's frame.
    goal: Option<Point3<f64>>,
}

/// What of a [`Tool`] changes while the simulation runs.
#[derive(Debug, Clone)]
pub(super) struct SavedTool {
    balls: Vec<Ball>,
    is_on: bool,
    burr: Option<usize>,
    rests: bool,
    carry: f64,
    force: Vector3<f64>,
    goal: Vector3<f64>,
    tip: Vector3<f64>,
}

impl Tool {
    pub fn new(description: VolumeTool) -> Self {
        let mut tool = Self {
            balls: Vec::new(),
            body: None,
            burr_bodies: vec![None; description.burrs.len()],
            leads: true,
            is_on: description.on,
            burr: None,
            rests: false,
            carver: Carver::with_room(if cuts(&description) { ROOM } else { 0 }),
            force: Vector3::zeros(),
            goal: Vector3::zeros(),
            tip: Vector3::zeros(),
            description,
        };
        tool.reset();
        tool
    }

    /// What it was made from.
    pub fn description(&self) -> &VolumeTool {
        &self.description
    }

    /// As it was at the start.
    pub fn reset(&mut self) {
        let VolumeTool { tip, cursors, on, .. } = &self.description;
        let tip_radius = tip.radius;
        self.balls.clear();
        let balls = std::iter::once(tip).chain(cursors);
        self.balls.extend(balls.map(|ball| Ball {
            place: ball.position.into(),
            proxy: Proxy::new(ball.radius),
            goal: None,
        }));
        self.is_on = *on;
        self.burr = self.burr_of(tip_radius);
        self.rests = false;
        self.carver.carry = 0.0;
        (self.force, self.goal, self.tip) = Default::default();
    }

    /// Lets go of what it touches, after its body was put elsewhere. Switch, burr and what is left of its rate stay.
    pub fn let_go(&mut self) {
        for ball in &mut self.balls {
            (ball.proxy, ball.goal) = (Proxy::new(ball.proxy.radius), None);
        }
        self.rests = false;
        (self.force, self.goal, self.tip) = Default::default();
    }

    pub fn save(&self) -> SavedTool {
        // All fields by name, so that no new one is forgotten.
        let Self {
            description: _,
            body: _,
            burr_bodies: _,
            leads: _,
            balls,
            is_on,
            burr,
            rests,
            carver,
            force,
            goal,
            tip,
        } = self;
        let (balls, carry) = (balls.clone(), carver.carry);
        SavedTool { balls, is_on: *is_on, burr: *burr, rests: *rests, carry, force: *force, goal: *goal, tip: *tip }
    }

    pub fn restore(&mut self, saved: &SavedTool) {
        self.balls.clone_from(&saved.balls);
        (self.is_on, self.burr, self.rests) = (saved.is_on, saved.burr, saved.rests);
        self.carver.carry = saved.carry;
        (self.force, self.goal, self.tip) = (saved.force, saved.goal, saved.tip);
    }

    /// Whether it can have a tip of this radius.
    pub fn takes(&self, radius: f64) -> bool {
        self.description.burrs.is_empty() || self.burr_of(radius).is_some()
    }

    /// Switches it, and gives it a tip of a radius that it [`takes`](Self::takes).
    pub fn set(&mut self, on: Option<bool>, radius: Option<f64>) {
        self.is_on = on.unwrap_or(self.is_on);
        if let Some(radius) = radius {
            self.burr = self.burr_of(radius);
            self.balls[0].proxy.radius = radius;
        }
    }

    fn burr_of(&self, radius: f64) -> Option<usize> {
        self.description.burrs.iter().position(|burr| (burr.radius - radius).abs() < SAME_RADIUS)
    }

    pub fn reading(&self) -> ToolReading {
        let Self { goal, tip, force, is_on, .. } = *self;
        let proxy = &self.balls[0].proxy;
        let burr = self.burr.and_then(|burr| self.burr_bodies[burr]);
        ToolReading { goal, tip, force, radius: proxy.radius, is_touching: proxy.touched.is_some(), is_on, burr }
    }

    /// Moves its balls to where the body is, as far as `grid` lets them, and has the springs between them act on the
    /// body and on `carrier`; cuts, and adds what it has removed to `cut`. `pose` is that of the volume in the world.
    #[allow(clippy::too_many_arguments, reason = "parts of the scene that are borrowed apart")]
    pub fn update(
        &mut self,
        grid: &mut Arc<VoxelGrid>,
        pose: &Isometry3<f64>,
        carrier: Option<BodyId>,
        bodies: &Bodies,
        world: &mut World,
        interval: f64,
        may_cut: bool,
        cut: &mut Carved,
    ) {
        let Some(body) = self.body.and_then(|id| bodies.get(id)) else { return };
        let Some(inertial) = world.pose(body.handle) else { return };
        let frame = inertial * body.inertial_offset_inverse;
        let VolumeTool { stiffness, damping, friction, largest_force: most, rate, ref burrs, .. } = self.description;
        let (rate, count) = self.burr.map_or((rate, 0), |burr| (burrs[burr].rate, burrs[burr].count));
        let law = Law { stiffness, damping, friction, most };
        let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
        let (mut back, mut back_torque) = (Vector3::zeros(), Vector3::zeros());
        let carrier = carrier.and_then(|id| bodies.get(id)).filter(|carrier| carrier.is_dynamic());
        let carrier_center = carrier.and_then(|carrier| world.pose(carrier.handle)).unwrap_or_default();
        let before = self.balls[0].proxy.position;
        let (mut held, mut held_by) = (Vector3::zeros(), 0.0);
        for ball in &mut self.balls {
            let there = frame * ball.place;
            let goal = pose.inverse_transform_point(&there);
            let velocity = ball.goal.map_or(Vector3::zeros(), |before| (goal - before) / interval);
            ball.goal = Some(goal);
            let at = ball.proxy.update(grid, Surface::Interpolated, &law, &goal);
            let offset = at - goal;
            if offset.norm_squared() > held_by {
                (held, held_by) = (pose.rotation * offset, offset.norm_squared());
            }
            let pull = pose.rotation * ball.proxy.force(&law, &goal, &velocity);
            force += pull;
            torque += (there.coords - inertial.translation.vector).cross(&pull);
            back -= pull;
            back_torque -= (there.coords - carrier_center.translation.vector).cross(&pull);
        }
        self.force = force;
        let tip = &self.balls[0].proxy;
        self.goal = (frame * self.balls[0].place).coords;
        self.tip = tip.position.map_or(self.goal, |tip| (pose * tip).coords);
        if body.is_dynamic() && force != Vector3::zeros() {
            world.apply_wrench(body.handle, &force, &torque);
        }
        if let Some(carrier) = carrier.filter(|_| force != Vector3::zeros()) {
            world.apply_wrench(carrier.handle, &back, &back_torque);
        }
        if let Some(burr) = self.burr.and_then(|burr| self.burr_bodies[burr]).and_then(|burr| bodies.get(burr)) {
            if self.leads || held_by > 0.0 {
                put(world, burr, &(Translation3::from(held) * frame));
            }
        }
        let tip = &self.balls[0].proxy;
        let rests = std::mem::take(&mut self.rests);
        let (Some(end), Some(_)) = (tip.position, tip.touched) else { return };
        if !self.is_on || (rate == 0.0 && count == 0) || !may_cut || (count > 0 && rests) {
            return;
        }
        let shape = Shape::Sphere { radius: tip.radius + REACH * grid.spacing().max() };
        let at = |point: Point3<f64>| Isometry3::from(point.coords);
        let stroke = Stroke { from: at(before.unwrap_or(end)), to: at(end) };
        let rule = if count > 0 { Rule::Count(count as usize) } else { Rule::Rate { rate, interval } };
        // Its numbers were checked when they were read, and a state that is not finite ends the iteration.
        if let Ok(carved) = self.carver.carve_shared(grid, &shape, &stroke, rule) {
            self.rests = !carved.indices.is_empty();
            cut.append(carved);
            self.carver.forget();
        }
    }
}

/// Whether it cuts at all.
pub(super) fn cuts(tool: &VolumeTool) -> bool {
    tool.rate > 0.0 || tool.burrs.iter().any(|burr| burr.rate > 0.0 || burr.count > 0)
}

/// Puts a body that only shows something at a pose of its body frame, at rest.
fn put(world: &mut World, body: &Body, pose: &Isometry3<f64>) {
    let wanted = pose * body.inertial_offset;
    let Some(now) = world.pose(body.handle) else { return };
    let moved = (wanted.translation.vector - now.translation.vector).norm();
    if moved > SAME_POSE || wanted.rotation.angle_to(&now.rotation) > SAME_POSE {
        world.set_pose(body.handle, &wanted);
    }
    if body.is_dynamic() {
        world.set_velocity(body.handle, &Vector3::zeros(), &Vector3::zeros());
    }
}
