//! Commands, as clients give them: held for a while, all at once, sometimes absurd.

use std::f64::consts::PI;

use nalgebra::Isometry3;

use super::super::scene::{Command, Kind, Order};
use super::Draft;

impl Draft {
    /// Adds commands to some scenes; most of these end before the run does.
    pub(super) fn orders(&mut self) {
        if self.dice.chance(0.3) {
            return;
        }
        let steps = (self.scene.span / self.scene.step) as u64;
        let driven: Vec<usize> = (0..self.scene.joints.len())
            .filter(|&j| matches!(self.scene.joints[j].kind, Kind::Revolute | Kind::Continuous | Kind::Prismatic))
            .collect();
        let moving: Vec<usize> = (0..self.scene.bodies.len()).filter(|&i| self.scene.bodies[i].mass > 0.0).collect();
        if !driven.is_empty() && self.dice.chance(0.8) {
            self.joint_orders(&driven, steps);
        }
        if moving.is_empty() {
            return;
        }
        if self.dice.chance(0.15) {
            self.feature("wrench on a body");
            let body = self.dice.pick(&moving);
            let force = self.scene.bodies[body].mass * 9.8 * self.dice.decades(0.1, 30.0);
            let (push, twist) = (self.dice.vector(force), self.dice.vector(force * self.style.length));
            self.command(steps, Order::Wrench(body, push, twist));
        }
        if self.dice.chance(0.1) {
            self.feature("velocity of a body");
            let body = self.dice.pick(&moving);
            let speed = self.style.length * self.dice.decades(0.1, 30.0);
            let (linear, angular) = (self.dice.vector(speed), self.dice.vector(10.0));
            self.command(steps, Order::Twist(body, linear, angular));
        }
        if self.dice.chance(0.12) {
            self.feature("pose of a body");
            let body = self.dice.pick(&moving);
            let at = self.scene.bodies[body].pose;
            let far = self.dice.pick(&[0.1, 1.0, 10.0]);
            let shift = self.dice.vector(self.style.length * far);
            let turn = self.dice.rotation(PI);
            let goal = Isometry3::from_parts((at.translation.vector + shift).into(), at.rotation * turn);
            self.command(steps, Order::Pose(body, goal));
        }
        if self.dice.chance(0.1) {
            self.feature("reset");
            let kind = self.dice.index(3) as u8;
            let at = self.dice.index(steps as usize) as u64;
            self.scene.commands.push(Command { first: at, last: at, order: Order::Reset(kind) });
        }
        if !self.scene.actuators.is_empty() {
            self.feature("actuator");
            let body = self.dice.pick(&moving);
            if body != self.scene.actuators[0] {
                let at = self.dice.index(steps as usize / 2) as u64;
                self.scene.commands.push(Command { first: at, last: at, order: Order::Hold(0, Some(body)) });
                if self.dice.chance(0.5) {
                    let at = at + steps / 4;
                    self.scene.commands.push(Command { first: at, last: at, order: Order::Hold(0, None) });
                }
            }
        }
    }

    /// Set points of joints that change a few times, in some or all joints at once.
    fn joint_orders(&mut self, driven: &[usize], steps: u64) {
        let kind = match self.dice.index(8) {
            0 => 0,
            1 => 2,
            _ => 1,
        };
        self.feature(["joint efforts", "joint positions", "joint velocities"][kind as usize]);
        let jumps = self.dice.count(1, 4) as u64;
        let far = if self.dice.chance(0.2) { 10.0 } else { 1.0 };
        if far > 1.0 {
            self.feature("set points far away");
        }
        let end = if self.dice.chance(0.6) { steps * 6 / 10 } else { steps };
        let share = self.dice.pick(&[0.3, 1.0, 1.0]);
        for jump in 0..jumps {
            let (first, last) = (end * jump / jumps, end * (jump + 1) / jumps - 1);
            for &joint in driven {
                if !self.dice.chance(share) {
                    continue;
                }
                let is_linear = self.scene.joints[joint].kind == Kind::Prismatic;
                let unit = if is_linear { self.style.length } else { 1.0 };
                let value = unit * far * self.dice.between(-1.0, 1.0);
                let value = match kind {
                    0 => value * self.style.mass * 9.8 * if is_linear { 1.0 / unit } else { self.style.length },
                    2 => value * self.dice.decades(0.1, 10.0),
                    _ => value,
                };
                self.scene.commands.push(Command { first, last, order: Order::Joint(joint, kind, value) });
            }
        }
    }

    /// An order for some part of the run.
    fn command(&mut self, steps: u64, order: Order) {
        let first = self.dice.index(steps as usize * 6 / 10) as u64;
        let length = match self.dice.index(3) {
            0 => 1,
            _ => (steps as f64 * self.dice.decades(0.01, 0.4)) as u64,
        };
        self.scene.commands.push(Command { first, last: first + length.max(1) - 1, order });
    }
}
