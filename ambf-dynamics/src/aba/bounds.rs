//! Bounds of rotations and of their accelerations, beyond which a motion cannot be integrated.

use std::mem::take;

use super::motion::{Equations, Motion};
use super::{Position, Rate, Tree};

/// Impulses or forces on one coordinate after the other disturb those before.
const MAX_ROUNDS: usize = 4;

impl Motion<'_, '_, f64> {
    /// Bounds the angular velocity of the base and of joints that turn to `most` rad/s, as Bullet clamps angular velocities of rigid
    /// bodies: by impulses between the two bodies of a joint, which take energy away and keep the momentum. Setting the rate of one
    /// coordinate alone would change the velocities of all bodies behind it, and adds energy where rates of several coordinates cancel.
    /// Poses and velocities are up to date.
    pub fn bound_rotation(&mut self, rate: &mut Rate<'_, f64>, most: f64) {
        let mut round = 0;
        while self.equations.tree.fastest_coordinate(rate) > most {
            if round == MAX_ROUNDS {
                self.equations.tree.scale_internal_velocity(most / self.equations.tree.fastest_coordinate(rate), rate);
                self.equations.tree.update_velocities(rate);
                break;
            }
            round += 1;
            self.equations.factor_inertia();
            for link in self.equations.tree.links {
                let speed = Tree::joint_speed(link, rate);
                if speed > most {
                    for k in link.sliding as usize..link.freedoms() {
                        let coordinate = link.coordinate() + k;
                        let component = rate.q[coordinate].abs() * (most / speed);
                        self.stop_at(coordinate, component, rate);
                    }
                }
            }
            self.equations.tree.update_velocities(rate);
        }
        let base = rate.angular.length();
        if !self.equations.tree.has_fixed_base && base > most {
            self.equations.tree.scale_internal_velocity(most / base, rate);
            self.equations.tree.update_velocities(rate);
        }
    }

    /// Brings the rate of a coordinate to ± `most` by an impulse between the two bodies of its joint.
    fn stop_at(&mut self, coordinate: usize, most: f64, rate: &mut Rate<'_, f64>) {
        let by_unit = self.equations.coupled.response(coordinate);
        if by_unit > 0.0 {
            let q = rate.q[coordinate];
            let impulse = (if q > 0.0 { most } else { -most } - q) / by_unit;
            let row = take(&mut self.equations.coupled.impulse);
            row.iter_mut().for_each(|part| *part *= impulse);
            let change = &mut self.part_rate;
            self.equations.coupled.rates_of(row, change);
            rate.angular += change.angular;
            rate.linear += change.linear;
            for (q, change) in rate.q.iter_mut().zip(&*change.q) {
                *q += change;
            }
            self.equations.coupled.impulse = row;
        }
    }

    /// Adds generalised forces that keep the accelerations at the beginning, `slopes[0]`, of joints that turn from changing an angular
    /// velocity by more than a quarter of a turn in h s, as the torque of a wrench does on a link of next to no inertia. What the present
    /// motion adds does not count. A motion by many turns in h s cannot be integrated, and its truncation errors are those of a large
    /// energy.
    pub(super) fn bound_acceleration(&mut self, h: f64, from: &Position<'_, f64>) {
        let most = std::f64::consts::FRAC_PI_2 / (h * h);
        let (equations, rest, slope) = (&mut self.equations, &mut self.stage_rate, &mut self.slopes[0]);
        let is_fast =
            |equations: &Equations<'_, '_, f64>, slope: &Rate<'_, f64>| equations.fastest_undriven(0, slope) > most;
        if !is_fast(equations, slope) {
            return;
        }
        // Fast motion accelerates joints, too, which smaller steps resolve: only what forces do at rest counts here.
        rest.clear();
        equations.tree.update_velocities(rest);
        equations.accelerate(from, rest, slope, true);
        for _ in 0..MAX_ROUNDS {
            if !is_fast(equations, slope) {
                break;
            }
            for link in equations.tree.links {
                if equations.is_driven(0, link) {
                    continue;
                }
                for k in link.sliding as usize..link.freedoms() {
                    let (coordinate, change) = (link.coordinate() + k, Tree::joint_speed(link, slope));
                    if change > most {
                        equations.factor_inertia();
                        let by_unit = equations.coupled.response(coordinate);
                        if by_unit > 0.0 {
                            equations.forces[coordinate] -= slope.q[coordinate] * (1.0 - most / change) / by_unit;
                            equations.accelerate(from, rest, slope, true);
                        }
                    }
                }
            }
        }
        equations.tree.update_velocities(&self.start_rate);
        equations.accelerate_driven(&self.start_rate, from, &self.start_rate, slope, true);
    }
}
