//! How set points move: along trajectories, with servo commands, at speeds and efforts, within limits.

use nalgebra::{Matrix6, Vector6};

use super::{Arm, Drive, Level, Measured, Mode, Now, WrenchFrame, EFFORT_TIMEOUT, VELOCITY_TIMEOUT};
use crate::kinematics::{Coordinates, Jacobian, MAX_JOINTS};
use crate::trajectory::{Bounds, Point, Shape, Trajectory};

/// Joints that place the control point while its orientation is kept by the others: those of a master's arm.
const POSITIONING_JOINTS: usize = 3;

impl Arm {
    pub(super) fn go(&mut self, level: Level, goal: Coordinates, measured: &Measured) {
        match level {
            Level::Servo => self.servo(goal, measured),
            Level::Interpolate => {
                self.enter(Mode::HELD, measured);
                self.follow(goal, Shape::Bounded, false);
            }
            Level::Move => {
                if self.mode.drive() == Drive::Effort {
                    self.enter(Mode::HELD, measured);
                }
                self.follow(goal, self.model.shape(), true);
            }
        }
    }

    /// The set point jumps; its speed is guessed from how it jumped before.
    fn servo(&mut self, goal: Coordinates, measured: &Measured) {
        let since = match self.mode {
            Mode::Position { age } if age > 0.0 && age < VELOCITY_TIMEOUT => Some(age),
            _ => None,
        };
        self.enter(Mode::Position { age: 0.0 }, measured);
        let jump = goal - self.set_point.position;
        self.set_point.velocity = since.map_or_else(Coordinates::zeros, |since| jump / since);
        self.set_point.position = goal;
    }

    pub(super) fn follow(&mut self, goal: Coordinates, shape: Shape, is_move: bool) {
        let start = Point { position: self.set_point.position, velocity: self.set_point.velocity };
        let path = Trajectory::new(shape, start, goal, &self.reduced(&self.model.bounds));
        self.mode = Mode::Follow { path, elapsed: 0.0, is_move };
    }

    /// Bounds of trajectories.
    fn reduced(&self, bounds: &Bounds) -> Bounds {
        Bounds { speed: bounds.speed * self.ratios.speed, acceleration: bounds.acceleration * self.ratios.acceleration }
    }

    pub(super) fn take_jaw(&mut self, level: Level, angle: f64, measured: &Measured) {
        if self.jaw_mode.drive() == Drive::Effort {
            self.set_point.jaw = [measured.jaw[0], 0.0];
            self.jaw_mode = Mode::HELD;
        }
        match level {
            Level::Servo => {
                self.jaw_mode = Mode::HELD;
                self.set_point.jaw = [angle, 0.0];
            }
            Level::Interpolate => self.follow_jaw(angle, Shape::Bounded, false),
            Level::Move => self.follow_jaw(angle, self.model.shape(), true),
        }
    }

    pub(super) fn follow_jaw(&mut self, angle: f64, shape: Shape, is_move: bool) {
        let Some(jaw) = &self.model.jaw else { return };
        let first = |value: f64, others: f64| {
            let mut all = Coordinates::repeat(others);
            all[0] = value;
            all
        };
        let [position, velocity] = self.set_point.jaw;
        let start = Point { position: first(position, 0.0), velocity: first(velocity, 0.0) };
        let bounds = Bounds { speed: first(jaw.speed, 1.0), acceleration: first(jaw.acceleration, 1.0) };
        let path = Trajectory::new(shape, start, first(angle, 0.0), &self.reduced(&bounds));
        self.jaw_mode = Mode::Follow { path, elapsed: 0.0, is_move };
    }

    pub(super) fn advance(&mut self, dt: f64, now: &mut Now<'_>) {
        let measured = now.measured;
        match self.mode {
            Mode::Position { ref mut age } => {
                *age += dt;
                if *age >= VELOCITY_TIMEOUT {
                    self.set_point.velocity = Coordinates::zeros();
                }
            }
            Mode::Follow { path, elapsed, is_move } => {
                let elapsed = elapsed + dt;
                let point = path.at(elapsed);
                (self.set_point.position, self.set_point.velocity) = (point.position, point.velocity);
                self.mode =
                    if elapsed < path.duration() { Mode::Follow { path, elapsed, is_move } } else { Mode::HELD };
            }
            Mode::Velocity { value, ref mut age } => {
                *age += dt;
                let age = *age;
                self.integrate(value, age, dt);
            }
            Mode::Twist { value, ref mut age } => {
                *age += dt;
                let age = *age;
                let speeds = self.speeds_of(&value, measured);
                self.integrate(speeds, age, dt);
            }
            Mode::Effort { ref mut age, .. } | Mode::Wrench { ref mut age, .. } => {
                *age += dt;
                if *age > EFFORT_TIMEOUT {
                    self.enter(Mode::HELD, measured);
                }
            }
            Mode::Free => (),
        }
        self.set_point.drive = self.mode.drive();
        self.set_point.positioned_from = MAX_JOINTS;
        if self.set_point.drive == Drive::Effort {
            let before = self.set_point.position;
            self.set_point.position = measured.position;
            self.set_point.velocity = Coordinates::zeros();
            self.keep_orientation(&before, dt, measured);
            let is_lifted = self.gravity_compensation || self.mode == Mode::Free;
            self.set_point.is_lifted = is_lifted;
            self.set_point.holding = if is_lifted { measured.holding } else { Coordinates::zeros() };
            self.set_point.effort = self.efforts(measured) + self.set_point.holding;
            self.model.limit_efforts(&mut self.set_point.effort);
        }
    }

    /// While the orientation is locked, joints after the third are where they keep it, by at most their largest speeds;
    /// the first three follow efforts. `before`: set points of the last step.
    fn keep_orientation(&mut self, before: &Coordinates, dt: f64, measured: &Measured) {
        let Some(locked) = self.locked.filter(|_| self.model.count() >= POSITIONING_JOINTS + 3) else { return };
        let goal = measured.base.rotation.inverse() * measured.reference.rotation * locked;
        let mut begin = measured.position;
        for joint in POSITIONING_JOINTS..self.model.count() {
            begin[joint] = before[joint];
        }
        let kept = self.model.kinematics.orient(&goal, &begin, POSITIONING_JOINTS, &self.model.limits);
        for joint in POSITIONING_JOINTS..self.model.count() {
            let most = self.model.bounds.speed[joint] * dt;
            self.set_point.position[joint] = begin[joint] + (kept[joint] - begin[joint]).clamp(-most, most);
        }
        self.set_point.positioned_from = POSITIONING_JOINTS;
    }

    fn integrate(&mut self, speeds: Coordinates, age: f64, dt: f64) {
        if age > VELOCITY_TIMEOUT {
            self.mode = Mode::HELD;
            self.set_point.velocity = Coordinates::zeros();
            return;
        }
        let before = self.set_point.position;
        for (joint, limits) in self.model.limits.iter().enumerate() {
            let most = self.model.bounds.speed[joint];
            self.set_point.position[joint] = limits.clip(before[joint] + speeds[joint].clamp(-most, most) * dt);
        }
        if dt > 0.0 {
            self.set_point.velocity = (self.set_point.position - before) / dt;
        }
    }

    /// Joint speeds for a twist of the control point in reference axes, damped near singular places.
    fn speeds_of(&self, twist: &Vector6<f64>, measured: &Measured) -> Coordinates {
        let to_base = measured.base.rotation.inverse() * measured.reference.rotation;
        let mut in_base = Vector6::zeros();
        in_base.fixed_rows_mut::<3>(0).copy_from(&(to_base * twist.fixed_rows::<3>(0)));
        in_base.fixed_rows_mut::<3>(3).copy_from(&(to_base * twist.fixed_rows::<3>(3)));
        let jacobian = self.model.kinematics.chain.jacobian(&self.set_point.position);
        pseudo_inverse(&jacobian, &in_base)
    }

    /// Efforts of the mode.
    fn efforts(&self, measured: &Measured) -> Coordinates {
        let chain = &self.model.kinematics.chain;
        match &self.mode {
            Mode::Effort { value, .. } => *value,
            Mode::Wrench { value, frame, .. } => {
                let jacobian = match frame {
                    WrenchFrame::Spatial => chain.spatial_jacobian(&measured.position),
                    WrenchFrame::Body if self.absolute_forces => chain.jacobian(&measured.position),
                    WrenchFrame::Body => chain.body_jacobian(&measured.position),
                };
                jacobian.tr_mul(value)
            }
            _ => Coordinates::zeros(),
        }
    }

    pub(super) fn advance_jaw(&mut self, dt: f64, measured: &Measured) {
        match self.jaw_mode {
            Mode::Follow { path, elapsed, is_move } => {
                let elapsed = elapsed + dt;
                let point = path.at(elapsed);
                self.set_point.jaw = [point.position[0], point.velocity[0]];
                let follow = Mode::Follow { path, elapsed, is_move };
                self.jaw_mode = if elapsed < path.duration() { follow } else { Mode::HELD };
            }
            Mode::Effort { value, ref mut age } => {
                *age += dt;
                self.set_point.jaw = [measured.jaw[0], 0.0];
                self.set_point.jaw_effort = value[0];
                if *age > EFFORT_TIMEOUT {
                    self.jaw_mode = Mode::HELD;
                }
            }
            _ => (),
        }
        self.set_point.jaw_drive = self.jaw_mode.drive();
    }
}

/// Joint values x with J x ≈ y, least in norm, damped: Jᵀ (J Jᵀ + λ² I)⁻¹ y.
pub fn pseudo_inverse(jacobian: &Jacobian, twist: &Vector6<f64>) -> Coordinates {
    let square = jacobian * jacobian.transpose();
    let damping = 1e-8 * square.diagonal().max().max(1e-12);
    let inverse = (square + Matrix6::identity() * damping).cholesky();
    inverse.map_or_else(Coordinates::zeros, |inverse| jacobian.transpose() * inverse.solve(twist))
}

/// The wrench F with Jᵀ F ≈ τ, least in norm, damped: J (Jᵀ J + λ² I)⁻¹ τ, by the matrix of 6 × 6.
pub fn wrench_of(jacobian: &Jacobian, efforts: &Coordinates) -> Vector6<f64> {
    let square = jacobian * jacobian.transpose();
    let damping = 1e-8 * square.diagonal().max().max(1e-12);
    let inverse = (square + Matrix6::identity() * damping).cholesky();
    inverse.map_or_else(Vector6::zeros, |inverse| inverse.solve(&(jacobian * efforts)))
}
