//! Methods of integration: the classical Runge-Kutta method and semi-implicit Euler steps.

use super::algebra::Quaternion;
use super::motion::{advance, advance_position, Motion};
use super::scalar::Scalar;
use super::{Position, Rate, Tree};

/// One of the four and that before it.
#[inline(always)]
fn neighbours<'a, 'b, S: Scalar>(four: &'a mut [Rate<'b, S>; 4], i: usize) -> (&'a Rate<'b, S>, &'a mut Rate<'b, S>) {
    let (before, rest) = four.split_at_mut(i);
    (&before[i - 1], &mut rest[0])
}

/// Derivatives of the rotations of joints that turn about three axes.
#[inline(always)]
fn set_ball_spins<S: Scalar>(
    tree: &Tree<'_, S>,
    speed: &Rate<'_, S>,
    at: &Position<'_, S>,
    spins: &mut [Quaternion<S>],
) {
    for link in tree.links.iter().filter(|link| link.ball >= 0) {
        let ball = link.ball as usize;
        spins[ball] = at.balls[ball].spin(speed.three(link.coordinate() + link.sliding as usize));
    }
}

impl<S: Scalar> Motion<'_, '_, S> {
    /// One step of the method. `slopes[0]` is the acceleration at the beginning.
    #[inline(always)]
    pub fn part_step(
        &mut self,
        h: f64,
        from: &Position<'_, S>,
        rate: &Rate<'_, S>,
        to: &mut Position<'_, S>,
        new_rate: &mut Rate<'_, S>,
    ) {
        if !self.by_euler {
            return self.runge_kutta(h, from, rate, to, new_rate);
        }
        advance(new_rate, rate, h, &self.slopes[0]);
        to.copy(from);
        advance_position(&self.equations.tree, to, h, new_rate);
        // Constant forces do this work on the velocity that the step begins and that it ends with.
        self.equations.add_drive_sums(h / 2.0, rate);
        self.equations.add_drive_sums(h / 2.0, new_rate);
    }

    #[inline(always)]
    fn runge_kutta(
        &mut self,
        h: f64,
        from: &Position<'_, S>,
        rate: &Rate<'_, S>,
        to: &mut Position<'_, S>,
        new_rate: &mut Rate<'_, S>,
    ) {
        let ways = [0.0, h / 2.0, h / 2.0, h];
        let mut spins = [from.rotation; 4];
        self.speeds[0].copy(rate);
        spins[0] = from.rotation.spin(rate.angular);
        set_ball_spins(&self.equations.tree, rate, from, self.ball_spins[0]);
        self.equations.add_drive_sums(h / 6.0, rate);
        for i in 1..4 {
            let way = S::splat(ways[i]);
            let stage = &mut self.stage;
            let (before, speed) = neighbours(&mut self.speeds, i);
            stage.rotation = from.rotation + spins[i - 1] * way;
            stage.origin = from.origin + before.linear * way;
            for ((q, from), speed) in stage.q.iter_mut().zip(&*from.q).zip(&*before.q) {
                *q = *from + way * *speed;
            }
            for ((ball, from), spin) in stage.balls.iter_mut().zip(&*from.balls).zip(&*self.ball_spins[i - 1]) {
                *ball = *from + *spin * way;
            }
            let (slope, next) = neighbours(&mut self.slopes, i);
            advance(speed, rate, ways[i], slope);
            spins[i] = stage.rotation.spin(speed.angular);
            self.equations.accelerate_driven(&self.start_rate, stage, speed, next, false);
            self.equations.add_drive_sums(if i < 3 { h / 3.0 } else { h / 6.0 }, speed);
            set_ball_spins(&self.equations.tree, speed, stage, self.ball_spins[i]);
        }
        let (sixth, two) = (S::splat(h / 6.0), S::splat(2.0));
        let (v, a, b) = (&self.speeds, &self.slopes, &self.ball_spins);
        let turned = (from.rotation + (spins[0] + spins[1] * two + spins[2] * two + spins[3]) * sixth).normalised();
        // A base at rest stays as it is, to the bit.
        let turns = match self.equations.tree.has_fixed_base {
            true => rate.angular.x.abs() + rate.angular.y.abs() + rate.angular.z.abs(),
            false => S::splat(1.0),
        };
        to.rotation = turned.where_positive(turns, from.rotation);
        to.origin = from.origin + (v[0].linear + v[1].linear * two + v[2].linear * two + v[3].linear) * sixth;
        new_rate.angular =
            rate.angular + (a[0].angular + a[1].angular * two + a[2].angular * two + a[3].angular) * sixth;
        new_rate.linear = rate.linear + (a[0].linear + a[1].linear * two + a[2].linear * two + a[3].linear) * sixth;
        for k in 0..to.q.len() {
            to.q[k] = from.q[k] + (v[0].q[k] + v[1].q[k] * two + v[2].q[k] * two + v[3].q[k]) * sixth;
            new_rate.q[k] = rate.q[k] + (a[0].q[k] + a[1].q[k] * two + a[2].q[k] * two + a[3].q[k]) * sixth;
        }
        for (k, ball) in to.balls.iter_mut().enumerate() {
            let spin = b[0][k] + b[1][k] * two + b[2][k] * two + b[3][k];
            *ball = (from.balls[k] + spin * sixth).normalised();
        }
    }
}
