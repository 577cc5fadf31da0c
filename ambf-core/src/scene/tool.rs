//! Tools of volumes: bodies with balls that touch voxels, of which the first one cuts.
//!
//! Each ball follows the body as far as the voxels let it ([`Proxy`]), in the volume's frame; a spring between both acts
//! on the body, and with the opposite sign on the body that carries the volume, in the next update. So what drives the
//! body feels it: a controller, or the hand at an input device with all limits of the device.

use std::sync::Arc;

use ambf_volume::proxy::{Law, Proxy, Surface};
use ambf_volume::{Carved, Carver, Rule, Shape, Stroke, VoxelGrid};
use nalgebra::{Isometry3, Point3, Vector3};

use super::Bodies;
use crate::adf::VolumeTool;
use crate::bullet::World;
use crate::comm::ToolReading;
use crate::ids::BodyId;

/// Voxels that a tool cuts in an update without new memory.
const ROOM: usize = 1 << 14;

/// Share of a voxel's edge beside the burr within which it removes voxels: those that it touches.
const REACH: f64 = 0.9;

/// A tool of a volume.
#[derive(Debug, Clone)]
pub(super) struct Tool {
    description: VolumeTool,
    /// `None`: it is not there.
    pub body: Option<BodyId>,
    /// The tip, then the cursors.
    balls: Vec<Ball>,
    is_on: bool,
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
            is_on: description.on,
            carver: Carver::with_room(if description.rate > 0.0 { ROOM } else { 0 }),
            force: Vector3::zeros(),
            goal: Vector3::zeros(),
            tip: Vector3::zeros(),
            description,
        };
        tool.reset();
        tool
    }

    /// As it was at the start.
    pub fn reset(&mut self) {
        let VolumeTool { tip, cursors, on, .. } = &self.description;
        self.balls.clear();
        let balls = std::iter::once(tip).chain(cursors);
        self.balls.extend(balls.map(|ball| Ball {
            place: ball.position.into(),
            proxy: Proxy::new(ball.radius),
            goal: None,
        }));
        self.is_on = *on;
        self.carver.carry = 0.0;
        (self.force, self.goal, self.tip) = Default::default();
    }

    pub fn save(&self) -> SavedTool {
        // All fields by name, so that no new one is forgotten.
        let Self { description: _, body: _, balls, is_on, carver, force, goal, tip } = self;
        let (balls, carry) = (balls.clone(), carver.carry);
        SavedTool { balls, is_on: *is_on, carry, force: *force, goal: *goal, tip: *tip }
    }

    pub fn restore(&mut self, saved: &SavedTool) {
        self.balls.clone_from(&saved.balls);
        (self.is_on, self.carver.carry) = (saved.is_on, saved.carry);
        (self.force, self.goal, self.tip) = (saved.force, saved.goal, saved.tip);
    }

    pub fn set(&mut self, on: Option<bool>, radius: Option<f64>) {
        self.is_on = on.unwrap_or(self.is_on);
        if let Some(radius) = radius {
            self.balls[0].proxy.radius = radius;
        }
    }

    pub fn reading(&self) -> ToolReading {
        let Self { goal, tip, force, is_on, .. } = *self;
        let proxy = &self.balls[0].proxy;
        ToolReading { goal, tip, force, radius: proxy.radius, is_touching: proxy.touched.is_some(), is_on }
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
        let VolumeTool { stiffness, damping, friction, largest_force: most, rate, .. } = self.description;
        let law = Law { stiffness, damping, friction, most };
        let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
        let (mut back, mut back_torque) = (Vector3::zeros(), Vector3::zeros());
        let carrier = carrier.and_then(|id| bodies.get(id)).filter(|carrier| carrier.is_dynamic());
        let carrier_center = carrier.and_then(|carrier| world.pose(carrier.handle)).unwrap_or_default();
        let before = self.balls[0].proxy.position;
        for ball in &mut self.balls {
            let there = frame * ball.place;
            let goal = pose.inverse_transform_point(&there);
            let velocity = ball.goal.map_or(Vector3::zeros(), |before| (goal - before) / interval);
            ball.goal = Some(goal);
            ball.proxy.update(grid, Surface::Interpolated, &law, &goal);
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
        let (Some(end), Some(_)) = (tip.position, tip.touched) else { return };
        if !self.is_on || rate == 0.0 || !may_cut {
            return;
        }
        let shape = Shape::Sphere { radius: tip.radius + REACH * grid.spacing().max() };
        let at = |point: Point3<f64>| Isometry3::from(point.coords);
        let stroke = Stroke { from: at(before.unwrap_or(end)), to: at(end) };
        // Its numbers were checked when they were read, and a state that is not finite ends the iteration.
        if let Ok(carved) = self.carver.carve_shared(grid, &shape, &stroke, Rule::Rate { rate, interval }) {
            cut.append(carved);
        }
    }
}
