//! Impulses and velocities while they are solved for.

use super::coordinates::Coordinates;
use super::layout::Layout;
use super::problem::{Rows, State, StoredRow, StoredSide};
use super::vector::{add_velocity, are_finite, dot_velocity};

/// Bounds beyond this, N·s or N·m·s, are none.
const UNBOUNDED: f64 = 1e9;

/// CFM of tangential rows in the problem of positions, as a share of the diagonal.
const STICKING: f64 = 0.1;

/// Residual and objective of given impulses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Merit {
    /// Largest violation of complementarity as a velocity: `d |x - clamp(x - (J v + cfm x - target) / d)|` with `d` the
    /// diagonal. Rows that no impulse moves do not count. Infinite where a number is not finite.
    pub residual: f64,
    /// `xᵀ (A + cfm) x / 2 - targetᵀ x`, J: 0 without impulses.
    pub objective: f64,
}

impl Merit {
    pub const NOT_FINITE: Self = Self { residual: f64::INFINITY, objective: f64::INFINITY };

    /// Solutions, whose residual is at most `accepted`, are judged by that. Of approximations the one of the lower
    /// objective leaves less kinetic energy that should not be there: a small residual may be a whole column of bodies
    /// in free fall, a large one a single light body.
    pub fn is_better_than(&self, other: &Self, accepted: f64) -> bool {
        let is_solved = self.residual <= accepted || other.residual <= accepted;
        if is_solved || self.objective == other.objective {
            self.residual < other.residual
        } else {
            self.objective < other.objective
        }
    }
}

/// Velocity components on which one row acts: `size` components of the velocities from `velocity` on. Where its Jacobian and
/// its response begin in [`Rows::data`].
#[derive(Debug, Clone, Copy, Default)]
struct Acting {
    size: u32,
    velocity: u32,
    jacobian: usize,
    response: usize,
}

impl Acting {
    fn new(side: &StoredSide, layout: &Layout) -> Self {
        let velocity = if side.is_some() { layout.velocity_start[side.body as usize] } else { 0 };
        Self {
            size: side.size,
            velocity: velocity as u32,
            jacobian: side.offset,
            response: side.offset + side.size as usize,
        }
    }
}

/// One row of the mixed linear complementarity problem that is solved, of velocities or of positions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Variable {
    sides: [Acting; 2],
    pub target: f64,
    pub cfm: f64,
    pub inverse_cfm: f64,
    /// `A + cfm` on the diagonal.
    pub diagonal: f64,
    pub low: f64,
    pub high: f64,
    pub x: f64,
    pub state: State,
    /// Place of the normal impulse that bounds this one.
    normal: Option<u32>,
    coefficient: f64,
    cap: f64,
}

impl Variable {
    /// A row of the velocity problem without its bias, if that may add energy.
    pub fn without_bias(row: &StoredRow, rows: &Rows, layout: &Layout, diagonal: f64) -> Self {
        let bias = if row.is_drive {
            0.0
        } else if row.low >= 0.0 {
            // A bias that permits the bodies to approach further does not add energy.
            row.bias.max(0.0)
        } else if row.high <= 0.0 {
            row.bias.min(0.0)
        } else {
            row.bias
        };
        Self { target: row.target - bias, ..Self::of_velocity(row, rows, layout, diagonal) }.with_possible_state()
    }

    /// A row of the velocity problem.
    pub fn of_velocity(row: &StoredRow, rows: &Rows, layout: &Layout, diagonal: f64) -> Self {
        let normal = row.friction.and_then(|friction| rows.normal(&friction));
        // Without a normal impulse there is no friction.
        let (low, high) = if row.friction.is_some() && normal.is_none() { (0.0, 0.0) } else { (row.low, row.high) };
        Self {
            sides: [Acting::new(&row.sides[0], layout), Acting::new(&row.sides[1], layout)],
            target: row.target,
            cfm: row.cfm,
            inverse_cfm: 1.0 / row.cfm,
            diagonal: diagonal + row.cfm,
            low: if low <= -UNBOUNDED { f64::NEG_INFINITY } else { low },
            high: if high >= UNBOUNDED { f64::INFINITY } else { high },
            x: row.x,
            state: row.state,
            normal: normal.map(|normal| layout.place[normal as usize]),
            coefficient: row.friction.map_or(0.0, |friction| friction.coefficient),
            cap: row.friction.map_or(0.0, |friction| friction.cap),
        }
        .with_possible_state()
    }

    /// Raises its CFM to at least `cfm`. `fed`: the impulse of the row that acts beside `x`, and that gives way, too.
    pub fn soften(&mut self, cfm: f64, fed: f64) {
        if cfm > self.cfm {
            self.target -= (cfm - self.cfm) * fed;
            self.diagonal += cfm - self.cfm;
            self.inverse_cfm = 1.0 / cfm;
            self.cfm = cfm;
        }
    }

    /// The same row in the problem of positions, where only the signs of its bounds count, with the CFM `cfm`.
    /// `target` is that of the normal in a row of friction; a row that `is_loaded`, and one of a spring, has no bounds.
    pub fn of_position(
        row: &StoredRow,
        rows: &Rows,
        layout: &Layout,
        [diagonal, cfm]: [f64; 2],
        target: f64,
        state: State,
        is_loaded: bool,
    ) -> Self {
        let sticks = row.friction.is_some() && target > 0.0;
        let takes_part = row.in_positions && row.friction.is_none();
        let cfm = cfm.max(if sticks { STICKING * diagonal } else { 0.0 });
        let is_equation = sticks || takes_part && (row.is_drive || is_loaded);
        Self {
            target: if takes_part { target } else { 0.0 },
            cfm,
            inverse_cfm: 1.0 / cfm,
            diagonal: diagonal + cfm,
            low: if is_equation || (takes_part && row.low < 0.0) { f64::NEG_INFINITY } else { 0.0 },
            high: if is_equation || (takes_part && row.high > 0.0) { f64::INFINITY } else { 0.0 },
            x: 0.0,
            state: if sticks {
                State::Free
            } else if takes_part {
                state
            } else {
                State::Low
            },
            normal: None,
            coefficient: 0.0,
            cap: 0.0,
            ..Self::of_velocity(row, rows, layout, diagonal)
        }
        .with_possible_state()
    }

    /// A bound that does not exist cannot be active. Where the impulse is given the target does not count; Bullet's is
    /// then at times the largest number there is.
    fn with_possible_state(mut self) -> Self {
        if self.is_fixed() && self.normal.is_none() {
            return Self { state: State::Low, target: 0.0, ..self };
        }
        let bound = if self.state == State::Low { self.low } else { self.high };
        if self.state != State::Free && self.normal.is_none() && !bound.is_finite() {
            self.state = State::Free;
        }
        self
    }

    pub fn is_finite(&self) -> bool {
        let given = [self.target, self.cfm, self.diagonal, self.x, self.coefficient];
        are_finite(&given) && !self.low.is_nan() && !self.high.is_nan() && !self.cap.is_nan()
    }

    pub fn is_friction(&self) -> bool {
        self.normal.is_some()
    }

    /// Sets the bounds of friction to `high`, as far as that is at least 0 and at most the cap.
    pub fn bound_by(&mut self, high: f64) {
        self.high = high.max(0.0).min(self.cap);
        self.low = -self.high;
    }

    pub fn is_unbounded(&self) -> bool {
        self.low == f64::NEG_INFINITY && self.high == f64::INFINITY
    }

    /// The velocity that the row asks for, as far as its CFM and its bounds let it cause it alone, m/s or rad/s. Targets
    /// of soft springs and weak motors are much larger.
    pub fn asked_velocity(&self) -> f64 {
        if self.is_friction() || self.diagonal <= 0.0 {
            return self.target.abs();
        }
        let response = self.diagonal - self.cfm;
        let strongest = self.low.abs().max(self.high.abs());
        (self.target.abs() * response / self.diagonal).min(response * strongest)
    }

    pub fn is_fixed(&self) -> bool {
        self.low >= self.high
    }

    pub fn clamp(&self, x: f64) -> f64 {
        x.max(self.low).min(self.high)
    }

    /// For sliding friction below its cap, the place of the normal impulse, and the share of it that this impulse is.
    pub fn slides_with(&self) -> Option<(usize, f64)> {
        let sign = match self.state {
            State::Free => return None,
            State::Low => -1.0,
            State::High => 1.0,
        };
        self.normal.filter(|_| self.high < self.cap).map(|normal| (normal as usize, sign * self.coefficient))
    }

    /// Whether impulses of this sign are within the bounds.
    pub fn can_push(&self, sign: f64) -> bool {
        if sign > 0.0 {
            self.high > 0.0
        } else {
            self.low < 0.0
        }
    }

    /// The side of the bounds on which the impulse is.
    pub fn state_of_x(&self) -> State {
        if self.x <= self.low {
            State::Low
        } else if self.x >= self.high {
            State::High
        } else {
            State::Free
        }
    }
}

/// Rows by place, and the velocities that their impulses give: those of bodies, or their [`Coordinates`].
#[derive(Debug, Default)]
pub(super) struct Iterate {
    pub variables: Vec<Variable>,
    pub velocities: Vec<f64>,
    /// Whether velocities are given by coordinates.
    in_coordinates: bool,
}

impl Iterate {
    pub fn begin(&mut self, layout: &Layout) {
        self.variables.clear();
        self.velocities.clear();
        self.velocities.resize(layout.velocity_start[layout.bodies()], 0.0);
        self.in_coordinates = false;
    }

    /// Goes over to coordinates, in which a row is its own response. Velocities are 0 then.
    pub fn enter(&mut self, coordinates: &Coordinates, layout: &Layout) {
        self.in_coordinates = true;
        self.velocities.clear();
        self.velocities.resize(layout.coordinates, 0.0);
        for ((row, span), &offset) in self.variables.iter_mut().zip(&coordinates.spans).zip(&coordinates.offsets) {
            let mut at = offset;
            row.sides = std::array::from_fn(|k| {
                let side = Acting { size: span.size[k], velocity: span.start[k], jacobian: at, response: at };
                at += side.size as usize;
                side
            });
        }
    }

    /// Writes the velocities of all bodies that the impulses give. `rows.rows[order[p]]` is the row at place p.
    pub fn write_velocities(&self, rows: &Rows, layout: &Layout, velocities: &mut [f64]) {
        if !self.in_coordinates {
            velocities.copy_from_slice(&self.velocities);
            return;
        }
        velocities.fill(0.0);
        for (variable, &index) in self.variables.iter().zip(&layout.order).filter(|(variable, _)| variable.x != 0.0) {
            for side in rows.rows[index as usize].sides.iter().filter(|side| side.is_some()) {
                let from = layout.velocity_start[side.body as usize];
                add_velocity(&mut velocities[from..from + side.size as usize], variable.x, side.response(&rows.data));
            }
        }
    }

    /// Velocity along a row, `J v`.
    #[inline(always)]
    pub fn row_velocity(&self, rows: &Rows, row: &Variable) -> f64 {
        let mut sum = 0.0;
        for side in &row.sides {
            let size = side.size as usize;
            if size > 0 {
                let jacobian = &rows.data[side.jacobian..side.jacobian + size];
                let velocity = side.velocity as usize;
                sum += dot_velocity(jacobian, &self.velocities[velocity..velocity + size]);
            }
        }
        sum
    }

    /// By how much the velocity equation of a row is missed, `J v + cfm x - target`.
    #[inline(always)]
    pub fn excess(&self, rows: &Rows, row: &Variable) -> f64 {
        self.row_velocity(rows, row) + row.cfm * row.x - row.target
    }

    /// Applies an impulse along the row at a place.
    #[inline(always)]
    pub fn push(&mut self, rows: &Rows, place: usize, impulse: f64) {
        if impulse == 0.0 {
            return;
        }
        for side in &self.variables[place].sides {
            let size = side.size as usize;
            let from = side.velocity as usize;
            let velocity = &mut self.velocities[from..from + size];
            let response = &rows.data[side.response..side.response + size];
            add_velocity(velocity, impulse, response);
        }
    }

    /// Applies the impulses of the rows at their bounds, and of no others.
    #[inline(always)]
    pub fn apply_bound_impulses(&mut self, rows: &Rows) {
        self.velocities.fill(0.0);
        for p in 0..self.variables.len() {
            let row = &mut self.variables[p];
            row.x = match row.state {
                State::Free => continue,
                State::Low => row.low,
                State::High => row.high,
            };
            let x = row.x;
            self.push(rows, p, x);
        }
    }

    /// Moves the impulses of the rows at their bounds onto them.
    pub fn move_to_bounds(&mut self) {
        for row in &mut self.variables {
            match row.state {
                State::Free if row.is_fixed() => row.x = row.low,
                State::Free => {}
                State::Low => row.x = row.low,
                State::High => row.x = row.high,
            }
        }
    }

    /// Finds the velocities from all impulses.
    pub fn accumulate(&mut self, rows: &Rows) {
        self.velocities.fill(0.0);
        for p in 0..self.variables.len() {
            let x = self.variables[p].x;
            self.push(rows, p, x);
        }
    }

    /// Sets the bounds of a row of friction from its normal impulse.
    #[inline]
    pub fn bound_friction(&mut self, place: usize) {
        if let Some(normal) = self.variables[place].normal {
            let normal = self.variables[normal as usize].x;
            let row = &mut self.variables[place];
            row.bound_by(row.coefficient * normal);
        }
    }

    /// Sets the bounds of all friction. Returns the largest change of an impulse that follows, as a velocity.
    pub fn bound_frictions(&mut self) -> f64 {
        let mut change: f64 = 0.0;
        for p in 0..self.variables.len() {
            if !self.variables[p].is_friction() {
                continue;
            }
            let before = self.variables[p].high;
            self.bound_friction(p);
            let row = &self.variables[p];
            let moved = if row.state == State::Free { row.x.abs() - row.high } else { (row.high - before).abs() };
            change = change.max(moved * row.diagonal);
        }
        change
    }

    /// Brings all impulses within their bounds, those of friction last. Returns whether one of them changed.
    pub fn clamp(&mut self) -> bool {
        let mut changed = false;
        for row in self.variables.iter_mut().filter(|row| !row.is_friction()) {
            let x = row.clamp(row.x);
            changed |= x != row.x;
            row.x = x;
        }
        for p in 0..self.variables.len() {
            if self.variables[p].is_friction() {
                self.bound_friction(p);
                let row = &mut self.variables[p];
                let x = row.clamp(row.x);
                changed |= x != row.x;
                row.x = x;
            }
        }
        changed
    }

    /// Judges the impulses at hand, with the velocities that they give.
    pub fn merit(&self, rows: &Rows) -> Merit {
        let (mut residual, mut objective): (f64, f64) = (0.0, 0.0);
        for row in self.variables.iter().filter(|row| row.diagonal > 0.0) {
            let excess = self.excess(rows, row);
            let whole = row.x * row.diagonal;
            let clamped = (whole - excess).max(row.low * row.diagonal).min(row.high * row.diagonal);
            let moved = (whole - clamped).abs();
            if !moved.is_finite() {
                return Merit::NOT_FINITE;
            }
            residual = residual.max(moved);
            objective += row.x * (excess - row.target) / 2.0;
        }
        if are_finite(&self.velocities) && self.variables.iter().all(|row| row.x.is_finite()) {
            Merit { residual, objective }
        } else {
            Merit::NOT_FINITE
        }
    }

    /// Multiplies all impulses by the factor of at most 1 with which the [objective](Merit::objective) is least, and then at
    /// most 0.
    pub fn scale_down(&mut self, rows: &Rows) {
        let (mut asked, mut squared) = (0.0, 0.0);
        for row in self.variables.iter().filter(|row| row.diagonal > 0.0) {
            asked += row.x * row.target;
            squared += row.x * (self.excess(rows, row) + row.target);
        }
        let factor = if asked > 0.0 && squared > asked {
            asked / squared
        } else if asked > 0.0 {
            1.0
        } else {
            0.0
        };
        self.variables.iter_mut().for_each(|row| row.x *= factor);
    }

    /// Energy that impulses other than those of drives give the bodies, and the sum of what their biases ask for, J.
    /// `rows.rows[order[p]]` is the row at place p.
    pub fn work_of_biases(&self, rows: &Rows, order: &[u32]) -> (f64, f64) {
        let (mut work, mut asked) = (0.0, 0.0);
        for (row, &index) in self.variables.iter().zip(order) {
            let given = &rows.rows[index as usize];
            if !given.is_drive && row.x != 0.0 {
                work += row.x * (self.row_velocity(rows, row) / 2.0 - row.target + given.bias);
                asked += (row.x * given.bias).abs();
            }
        }
        (work, asked)
    }
}
