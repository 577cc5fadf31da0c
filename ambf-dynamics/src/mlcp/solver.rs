//! The solver: its memory, the order of its methods, and what it returns.

use super::descent::{BoundStep, Way};
use super::free_factor::FreeFactor;
use super::iterate::{Iterate, Merit, Variable};
use super::layout::Layout;
use super::newton::Newton;
use super::problem::{ProblemError, Row, Rows, State, StoredRow};

/// Sweeps of projected Gauss–Seidel that are made whatever the budget is.
pub(super) const MIN_SWEEPS: u32 = 4;
/// Most factorisations of block pivoting; where it cycles, more of them do not help.
pub(super) const MAX_PIVOT_ROUNDS: u32 = 20;
/// Tolerances of pivoting and of the result, as shares of the largest target.
const FINE: f64 = 1e-9;
const COARSE: f64 = 1e-6;
/// Residual up to which the guess is accepted as the solution, as a share of the largest target other than of friction:
/// where the problem before was solved, and where its guess was accepted. A solution also removes the velocities that
/// accepted guesses left, so that it is not yet the guess of a state at rest.
const SOLVED_BEFORE: f64 = 1e-8;
const RESTING: f64 = 1e-7;
/// Largest residual with which a guess is accepted, m/s or rad/s: what creeps no faster is at rest. The largest target is
/// that of the strongest force, which says nothing about what friction holds beside it, and can be as large as the velocity that
/// a stiff spring would give to a link of next to no inertia, were there no limit.
const MAX_GUESS_RESIDUAL: f64 = 3e-8;
/// Residual up to which impulses count as near the solution, as a share of the largest target, and the share of the
/// budget for block pivoting from such a guess.
const NEAR: f64 = 1e-3;
const NEAR_SHARE: f64 = 0.2;
/// The residual of the guess is computed first only if a factorisation and the budget are at least this multiple of one
/// pass over the rows.
const EXPENSIVE: f64 = 10.0;
/// Energy that biases may add, as a share of the kinetic energy and of the nominal work Σ |λ · bias| of the biases, and
/// at most as a share of the kinetic energy. Curved motion exchanges the share θ³ of the kinetic energy in a turn of
/// θ rad. Rows that nearly contradict each other have impulses, and a nominal work, that are thousands of times those
/// of the motion.
const ENERGY_SLACK: f64 = 2e-3;
const BIAS_SLACK: f64 = 0.02;
const MAX_ENERGY_SLACK: f64 = 0.01;
/// Multiple of the nominal work beyond which added energy cannot come from the biases.
const MAX_BIAS_WORK: f64 = 1e4;
/// Velocities up to this count as 0, m/s or rad/s.
const TINY: f64 = 1e-14;
/// Shares of the budget up to which block pivoting and staggered projections may go.
const PIVOT_SHARE: f64 = 0.7;
const ALTERNATION_SHARE: f64 = 0.85;

/// Largest work of a solution, in multiplications.
///
/// Factorisations are made as long as they fit; what is left goes into sweeps. At least four sweeps are made in any
/// case where no factorisation fits. As much work again may go into an approximation: into the problem for given friction,
/// and into that without biases.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Budget(pub f64);

impl Budget {
    /// No limit but those on the number of iterations.
    pub const UNLIMITED: Self = Self(f64::INFINITY);
}

/// Accuracy of a solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// Complementarity holds to 1e-6 of the largest target.
    Solved,
    /// The budget ended, the methods did not converge, or rows without CFM contradict each other. The impulses are the
    /// best that were found, within their bounds.
    Approximate {
        /// Largest violation of complementarity, m/s or rad/s.
        residual: f64,
    },
    /// A number of the problem is not finite (or overflows). All impulses and velocities are 0.
    NotFinite,
}

/// Counters of the last solution.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Statistics {
    /// Rows of the problem.
    pub rows: u32,
    /// Factorisations, whole or in part.
    pub factorisations: u32,
    /// Rows that changed sides, summed over all iterations.
    pub pivots: u32,
    /// Sweeps of projected Gauss–Seidel.
    pub sweeps: u32,
    /// Multiplications, without those of the caller's Jacobians and responses.
    pub multiplications: f64,
    /// Largest violation of complementarity of the result, m/s or rad/s; infinite for [`Outcome::NotFinite`].
    pub residual: f64,
    /// What [`Solver::set_guess_tolerance`] is to be told about the next problem of the same bodies.
    pub guess_tolerance: f64,
}

impl Statistics {
    /// Adds the work of another solution of the same rows.
    fn add(&mut self, other: &Self) {
        self.factorisations += other.factorisations;
        self.pivots += other.pivots;
        self.sweeps += other.sweeps;
        self.multiplications += other.multiplications;
    }
}

/// A solution, by rows and bodies.
#[derive(Debug, Default)]
struct Solution {
    impulses: Vec<f64>,
    states: Vec<State>,
    velocities: Vec<f64>,
}

impl Solution {
    fn resize(&mut self, rows: usize, velocities: usize) {
        self.impulses.resize(rows, 0.0);
        self.states.resize(rows, State::Free);
        self.velocities.resize(velocities, 0.0);
    }

    fn reset(&mut self) {
        self.impulses.fill(0.0);
        self.states.fill(State::Free);
        self.velocities.fill(0.0);
    }

    fn take(&mut self, iterate: &Iterate, rows: &Rows, layout: &Layout) {
        self.states.fill(State::Low);
        for (row, &kept) in iterate.variables.iter().zip(&layout.order) {
            let index = rows.index[kept as usize] as usize;
            self.impulses[index] = row.x;
            self.states[index] = row.state;
        }
        iterate.write_velocities(rows, layout, &mut self.velocities);
    }
}

/// Best impulses so far, by place.
#[derive(Debug)]
pub(super) struct Best {
    merit: Merit,
    x: Vec<(f64, State)>,
    /// Whether the iterate is it.
    pub(super) is_current: bool,
}

impl Default for Best {
    fn default() -> Self {
        Self { merit: Merit::NOT_FINITE, x: Vec::new(), is_current: false }
    }
}

impl Best {
    pub(super) fn forget(&mut self) {
        (self.merit, self.is_current) = (Merit::NOT_FINITE, false);
    }
}

/// CFM of a position problem.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Softness {
    /// Least CFM of a row, as a share of its diagonal.
    pub share: f64,
    /// Multiple of the CFM of all rows but springs.
    pub damping: f64,
}

/// Solver of mixed linear complementarity problems; see the [module](super).
///
/// Fill it by [`clear`](Self::clear), [`add_row`](Self::add_row) and [`prepare`](Self::prepare), then call
/// [`solve`](Self::solve) or [`solve_positions`](Self::solve_positions) or both, in any order. It keeps memory between
/// problems, but nothing that changes a result.
#[derive(Debug, Default)]
pub struct Solver {
    pub(super) rows: Rows,
    pub(super) layout: Layout,
    pub(super) factor: FreeFactor,
    pub(super) iterate: Iterate,
    pub(super) newton: Newton,
    /// Impulses of the free rows, in the order of `factor.places()`.
    pub(super) unknowns: Vec<f64>,
    /// By how much the equations of the free rows are missed, in the same order.
    pub(super) errors: Vec<f64>,
    /// Steps to a minimum, by place.
    pub(super) ways: Vec<Way>,
    /// Bounds of friction in the turn before, by place.
    pub(super) bound_steps: Vec<BoundStep>,
    /// Bounds of all rows while some are held, by place.
    pub(super) bounds: Vec<(f64, f64)>,
    /// Largest error of a velocity that counts as none, m/s or rad/s.
    pub(super) tolerance: f64,
    /// Residual of a solution, m/s or rad/s.
    pub(super) accepted: f64,
    /// The largest target that counts, m/s or rad/s: of all rows, and of those that are not friction.
    pub(super) scale: f64,
    pub(super) normal_scale: f64,
    /// The part of the budget that is for factorisations, in multiplications.
    pub(super) direct: f64,
    /// The smallest tolerance of the problem.
    pub(super) fine: f64,
    pub(super) statistics: Statistics,
    guess: Vec<(f64, State)>,
    pub(super) best: Best,
    velocity: Solution,
    position: Solution,
    /// Position errors after the pseudo-velocities, by row.
    position_errors: Vec<f64>,
    prepared: bool,
    /// Kinetic energy of all bodies before the impulses, J.
    pub(super) kinetic_energy: f64,
    /// See [`Solver::set_guess_tolerance`].
    guess_tolerance: f64,
}

impl Solver {
    /// A solver without rows.
    pub fn new() -> Self {
        Self::default()
    }

    /// Removes all rows. Memory is kept.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.kinetic_energy = 0.0;
        self.guess_tolerance = 0.0;
        self.prepared = false;
    }

    /// Kinetic energy of all bodies before the impulses, J, by which [`solve`](Self::solve) judges what biases add. 0
    /// after [`clear`](Self::clear).
    pub fn set_kinetic_energy(&mut self, energy: f64) {
        self.kinetic_energy = energy;
    }

    /// Residual up to which the guess is accepted as the solution, as a share of the largest target other than of
    /// friction: [`Statistics::guess_tolerance`] of the last [`solve`](Self::solve) of the same bodies. 0, as after
    /// [`clear`](Self::clear), means the default, 1e-8.
    pub fn set_guess_tolerance(&mut self, share: f64) {
        self.guess_tolerance = share;
    }

    /// Adds a row, whose numbers are copied, and returns its index.
    pub fn add_row(&mut self, row: &Row) -> usize {
        self.prepared = false;
        self.rows.add(row)
    }

    /// Orders the rows. Bodies below `rigid` are rigid and have velocities of 6 components; then come the
    /// articulations, with velocities of the given sizes. Returns the multiplications that a factorisation of all rows
    /// would take.
    ///
    /// # Errors
    /// Where a row names a body or row that does not exist, or has a Jacobian of the wrong size. The problem can't be
    /// solved then: solving it gives [`Outcome::NotFinite`].
    pub fn prepare(&mut self, rigid: usize, articulations: &[usize]) -> Result<f64, ProblemError> {
        self.prepare_with(rigid, articulations.iter().copied())
    }

    pub(super) fn prepare_with(
        &mut self,
        rigid: usize,
        articulations: impl Iterator<Item = usize>,
    ) -> Result<f64, ProblemError> {
        self.prepared = false;
        self.layout.set_bodies(rigid, articulations);
        let velocities = self.layout.velocity_start[self.layout.bodies()];
        self.velocity.resize(self.rows.count(), velocities);
        self.velocity.reset();
        self.position.resize(self.rows.count(), velocities);
        self.position_errors.resize(self.rows.count(), 0.0);
        self.rows.check(&self.layout.velocity_start)?;
        self.layout.arrange(&self.rows);
        self.factor.set_rows(&self.rows, &self.layout);
        self.prepared = true;
        Ok(self.layout.least_factor_cost())
    }

    /// Solves for the impulses that give the bodies the wanted velocities.
    ///
    /// Impulses that ask all rows for rest add no kinetic energy. Restitution does where other rows are violated: a
    /// limit that a light link hits fast then accelerates all that hangs on that link. Where rows other than drives add
    /// more than 0.2 % of the kinetic energy before and 2 % of the work that the biases ask for, or more than 1 % of the
    /// kinetic energy before, the problem is solved again without biases.
    pub fn solve(&mut self, budget: Budget) -> Outcome {
        self.solve_yielding(0.0, budget)
    }

    /// The same with a CFM of at least `yielding` times the [`yielding_cfm`](super::ConstraintRow::yielding_cfm) of
    /// each row.
    pub fn solve_yielding(&mut self, yielding: f64, budget: Budget) -> Outcome {
        let mut outcome = self.solve_velocities(yielding, budget, Variable::of_velocity);
        if outcome != Outcome::NotFinite {
            let (work, asked) = self.iterate.work_of_biases(&self.rows, &self.layout.order);
            let most = MAX_ENERGY_SLACK * self.kinetic_energy;
            let slack = (BIAS_SLACK * asked).min(most).max(ENERGY_SLACK * self.kinetic_energy);
            if work > slack && work < MAX_BIAS_WORK * asked {
                let first = self.statistics;
                // Twice the budget in all: this problem may in turn take twice of its own.
                let left = (2.0 * budget.0 - first.multiplications).max(0.0);
                outcome = self.solve_velocities(yielding, Budget(left / 2.0), Variable::without_bias);
                self.statistics.add(&first);
            }
        }
        outcome
    }

    fn solve_velocities(
        &mut self,
        yielding: f64,
        budget: Budget,
        variable: fn(&StoredRow, &Rows, &Layout, f64) -> Variable,
    ) -> Outcome {
        if self.begin() {
            for (p, &row) in self.layout.order.iter().enumerate() {
                let row = &self.rows.rows[row as usize];
                let mut variable = variable(row, &self.rows, &self.layout, self.factor.diagonal()[p]);
                variable.soften(yielding * row.yielding_cfm, row.fed);
                self.iterate.variables.push(variable);
            }
        }
        let outcome = self.run(budget);
        if outcome == Outcome::NotFinite {
            self.velocity.reset();
        } else {
            self.velocity.take(&self.iterate, &self.rows, &self.layout);
        }
        outcome
    }

    /// Solves for pseudo-impulses that correct positions, on the same rows and matrix.
    ///
    /// Rows without `in_positions` get no impulse. Of the bounds of the others only the signs count: rows that can push
    /// both ways are unbounded, unilateral ones have impulses ≥ 0 or ≤ 0, unless they
    /// [stay loaded](super::ConstraintRow::stays_loaded). Rows of friction whose normal row has a
    /// target above 0 resist tangential pseudo-velocities softly (CFM of 0.1 of the diagonal): light bodies would else
    /// be squeezed out between heavy ones. Targets are `targets`, one a row in the order of [`add_row`](Self::add_row),
    /// or the rows' own `position_target`; `states` is a guess of the active set, by default every row free.
    ///
    /// CFM is `cfm_share` of the diagonal (1e-4 is a good value), or that of the row or its `position_cfm` if one is
    /// larger; that of a drive is its `position_cfm` if it has one. It makes the result the best compromise between rows that contradict each other: kinetic energy is at
    /// most `Σ target² / (2 cfm)`.
    pub fn solve_positions(
        &mut self,
        targets: Option<&[f64]>,
        states: Option<&[State]>,
        cfm_share: f64,
        budget: Budget,
    ) -> Outcome {
        let target = |row: usize| targets.map(|targets| targets.get(row).copied().unwrap_or(0.0));
        let guess = |row: usize| states.and_then(|states| states.get(row).copied()).unwrap_or_default();
        self.solve_positions_with(target, guess, Softness { share: cfm_share, damping: 1.0 }, budget)
    }

    /// The same with a target, if not the row's own, and a guess for each row.
    pub(crate) fn solve_positions_with(
        &mut self,
        target: impl Fn(usize) -> Option<f64>,
        guess: impl Fn(usize) -> State,
        softness: Softness,
        budget: Budget,
    ) -> Outcome {
        self.position.reset();
        self.position_errors.fill(0.0);
        if self.begin() {
            for (p, &kept) in self.layout.order.iter().enumerate() {
                let row = &self.rows.rows[kept as usize];
                let index = self.rows.index[kept as usize] as usize;
                let normal = row.friction.map(|friction| (friction.normal, self.rows.normal(&friction)));
                let (of_target, kept) = normal.unwrap_or((index, Some(kept)));
                let own = || kept.map_or(0.0, |kept| self.rows.rows[kept as usize].position_target);
                let target = target(of_target).unwrap_or_else(own);
                let state = guess(index);
                let diagonal = self.factor.diagonal()[p];
                let cfm = if row.is_drive && row.position_cfm > 0.0 {
                    row.position_cfm
                } else {
                    row.cfm.max(softness.damping * row.position_cfm.max(softness.share * diagonal))
                };
                let is_loaded = row.stays_loaded && self.velocity.impulses[index] != 0.0;
                // The velocities already end where a loaded row closes.
                let opens = (row.low >= 0.0 && target < 0.0) || (row.high <= 0.0 && target > 0.0);
                let target = if is_loaded && opens { 0.0 } else { target };
                let variable =
                    Variable::of_position(row, &self.rows, &self.layout, [diagonal, cfm], target, state, is_loaded);
                self.iterate.variables.push(variable);
            }
        }
        let outcome = self.run(budget);
        if outcome != Outcome::NotFinite {
            self.position.take(&self.iterate, &self.rows, &self.layout);
            for (row, &kept) in self.iterate.variables.iter().zip(&self.layout.order) {
                let left = row.target - self.iterate.row_velocity(&self.rows, row);
                let given = &self.rows.rows[kept as usize];
                let counts = given.in_positions && !given.is_drive && given.friction.is_none() && row.can_push(left);
                let index = self.rows.index[kept as usize] as usize;
                self.position_errors[index] = if counts { left } else { 0.0 };
            }
        }
        outcome
    }

    /// Impulses of the last [`solve`](Self::solve), N·s or N·m·s, one a row.
    pub fn impulses(&self) -> &[f64] {
        &self.velocity.impulses
    }

    /// Active set of the last [`solve`](Self::solve), one a row.
    pub fn states(&self) -> &[State] {
        &self.velocity.states
    }

    /// Changes of the velocities of all bodies by the last [`solve`](Self::solve), m/s and rad/s, one body after the
    /// other: rigid body `b` from `6 b` on; see [`velocity_start`](Self::velocity_start).
    pub fn velocities(&self) -> &[f64] {
        &self.velocity.velocities
    }

    /// Pseudo-impulses of the last [`solve_positions`](Self::solve_positions), one a row.
    pub fn position_impulses(&self) -> &[f64] {
        &self.position.impulses
    }

    /// Active set of the last [`solve_positions`](Self::solve_positions), one a row: the guess for the next.
    pub fn position_states(&self) -> &[State] {
        &self.position.states
    }

    /// Pseudo-velocities of the last [`solve_positions`](Self::solve_positions), like [`velocities`](Self::velocities).
    pub fn position_velocities(&self) -> &[f64] {
        &self.position.velocities
    }

    /// What the pseudo-velocities of the last [`solve_positions`](Self::solve_positions) leave of the targets, `target
    /// − J v` where the row could push that way, else 0; one a row, m/s or rad/s.
    pub fn position_errors(&self) -> &[f64] {
        &self.position_errors
    }

    /// Where the velocity of each body begins, and the end of the last one. Empty before the first
    /// [`prepare`](Self::prepare).
    pub fn velocity_start(&self) -> &[usize] {
        &self.layout.velocity_start
    }

    /// Counters of the last solution.
    pub fn statistics(&self) -> Statistics {
        self.statistics
    }

    fn begin(&mut self) -> bool {
        self.statistics = Statistics { rows: self.rows.count() as u32, ..Statistics::default() };
        if self.prepared {
            self.iterate.begin(&self.layout);
        }
        self.prepared
    }

    fn run(&mut self, Budget(budget): Budget) -> Outcome {
        let budget = if budget.is_nan() { 0.0 } else { budget };
        self.statistics.residual = f64::INFINITY;
        if !self.prepared || self.rows.not_finite || !self.iterate.variables.iter().all(Variable::is_finite) {
            return Outcome::NotFinite;
        }
        // A row that needs no impulse, such as a separating contact or a limit that is not reached, does not count for the
        // scale.
        let counts = |row: &&Variable| row.is_friction() || row.can_push(row.target);
        let asked = |of_friction: bool| {
            let rows = self.iterate.variables.iter().filter(counts).filter(|row| of_friction == row.is_friction());
            rows.map(Variable::asked_velocity).fold(0.0, f64::max)
        };
        // What slides is faster than friction can change in a sub-step.
        self.normal_scale = asked(false);
        let scale = self.normal_scale.max(asked(true));
        let accepted = COARSE * scale + TINY;
        self.guess.clear();
        self.guess.extend(self.iterate.variables.iter().map(|row| (row.x, row.state)));
        self.best.merit = Merit::NOT_FINITE;
        self.find(budget, scale);
        if self.best.merit.residual == f64::INFINITY {
            return Outcome::NotFinite;
        }
        self.load_best();
        if self.best.merit.objective > 0.0 && self.best.merit.residual > accepted {
            self.iterate.scale_down(&self.rows);
            self.iterate.bound_frictions();
            self.iterate.accumulate(&self.rows);
            self.best.merit = self.iterate.merit(&self.rows);
        }
        let residual = self.best.merit.residual;
        self.statistics.residual = residual;
        if residual <= accepted {
            Outcome::Solved
        } else {
            Outcome::Approximate { residual }
        }
    }

    /// Tries one method after the other until the result is accurate or the budget ends.
    fn find(&mut self, budget: f64, scale: f64) {
        // The first bounds of friction come from the guess of the normal impulses.
        self.iterate.bound_frictions();
        let accepted = COARSE * scale + TINY;
        self.accepted = accepted;
        self.newton.reset(self.iterate.variables.len());
        self.scale = scale;
        self.fine = FINE * scale + TINY;
        let direct = budget - f64::from(MIN_SWEEPS) * self.sweep_cost();
        self.direct = direct;
        let is_near = self.is_guess_near();
        let tolerance = self.guess_tolerance.max(SOLVED_BEFORE) * self.normal_scale;
        if self.best.merit.residual <= tolerance.min(MAX_GUESS_RESIDUAL) + TINY {
            self.statistics.guess_tolerance = RESTING;
            return;
        }
        if !self.assemble(direct) {
            self.tolerance = accepted;
            self.restore_guess();
            self.sweeps(budget);
            self.record();
            return;
        }
        self.tolerance = self.fine;
        let converged = self.pivot(if is_near { NEAR_SHARE } else { PIVOT_SHARE } * direct);
        // The velocities are those of the impulses at hand.
        let changed = self.iterate.clamp();
        if self.record_clamped(changed) <= accepted || self.best.merit.residual <= accepted {
            return;
        }
        self.tolerance = accepted;
        if converged {
            self.refine();
            if self.record() <= accepted {
                return;
            }
        }
        if is_near {
            // Sweeps move the guess on, where projections that need not converge leave it.
            self.restore_guess();
            self.sweeps(budget);
            self.record();
        } else {
            let has_joints = self.iterate.variables.iter().any(Variable::is_unbounded);
            self.alternate(ALTERNATION_SHARE * direct);
            if self.best.merit.residual > accepted && !has_joints {
                self.sweeps(budget);
                self.record();
            }
        }
    }

    /// Judges the guess, which is the solution where bodies rest or contacts open, and then the best so far. Returns
    /// whether it is a result for want of a better one, like that of a pile at rest of which a few contacts change. Not
    /// asked of problems that are solved as fast as that is found, nor where the budget is small.
    fn is_guess_near(&mut self) -> bool {
        let expensive = self.layout.least_factor_cost() >= EXPENSIVE * self.layout.pass_cost;
        let variables = &self.iterate.variables;
        let has_joints = variables.iter().any(Variable::is_unbounded);
        let has_no_guess = has_joints && variables.iter().all(|row| row.x == 0.0);
        if self.direct < EXPENSIVE * self.layout.pass_cost || !expensive && has_no_guess {
            return false;
        }
        let residual = self.record();
        let is_near = residual <= NEAR * self.scale;
        // Where the impulses of joints and drives are far from the solution, methods that begin at them, some of them
        // on their bounds, take many more steps than from 0.
        for (row, (x, state)) in self.iterate.variables.iter().zip(&mut self.guess) {
            if is_near && !row.is_friction() {
                *state = row.state_of_x();
            } else if row.low < 0.0 && row.high > 0.0 && !row.is_friction() {
                (*x, *state) = (0.0, State::Free);
            }
        }
        self.load_guess();
        self.best.is_current = false;
        expensive && !has_joints && is_near
    }

    /// Brings the impulses within their bounds, keeps them if they are the best so far, and returns their residual.
    pub(super) fn record(&mut self) -> f64 {
        self.iterate.clamp();
        self.record_clamped(true)
    }

    /// The same with impulses within their bounds, and velocities that are new to be found or not.
    fn record_clamped(&mut self, accumulate: bool) -> f64 {
        if accumulate {
            self.iterate.accumulate(&self.rows);
            self.statistics.multiplications += self.layout.pass_cost;
        }
        self.record_current(false)
    }

    /// The same with impulses whose velocities are known, also where friction exceeds its bounds. Of impulses that miss
    /// nothing but friction the residual decides.
    pub(super) fn record_current(&mut self, misses_friction_alone: bool) -> f64 {
        let merit = self.iterate.merit(&self.rows);
        self.statistics.multiplications += self.layout.pass_cost;
        self.best.is_current = if misses_friction_alone {
            merit.residual < self.best.merit.residual
        } else {
            merit.is_better_than(&self.best.merit, self.accepted)
        };
        if self.best.is_current {
            self.best.merit = merit;
            self.best.x.clear();
            self.best.x.extend(self.iterate.variables.iter().map(|row| (row.x, row.state)));
        }
        merit.residual
    }

    fn load_best(&mut self) {
        if self.best.is_current {
            return;
        }
        for (row, &(x, state)) in self.iterate.variables.iter_mut().zip(&self.best.x) {
            (row.x, row.state) = (x, state);
        }
        self.iterate.bound_frictions();
        self.iterate.accumulate(&self.rows);
    }

    fn load_guess(&mut self) {
        for (row, &(x, state)) in self.iterate.variables.iter_mut().zip(&self.guess) {
            (row.x, row.state) = (x, state);
        }
    }

    fn restore_guess(&mut self) {
        self.load_guess();
        self.iterate.clamp();
    }
}
