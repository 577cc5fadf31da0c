//! The island: its rows, the order of its two problems, and what they leave.

use crate::mlcp::{self, Budget, Row as Constraint, Side, Softness, Solver, State};

use super::build::{correction_share, is_at_rest, Builder};
use super::positions::{is_soft, is_uncorrectable, PositionRows, LONG_CORRECTION, MOST_ROUNDS, RAISED_DAMPING};
use super::row::{Kind, Row};
use super::softness::{average_responses, JointSoftness, LEAST_POSITION_SOFTNESS};
use super::yielding::Yielding;
use super::{larger, smaller, Budgets, Limits, Memory};

/// Largest correction velocity of joints and of bodies, m/s and rad/s.
pub(crate) const MAX_CORRECTION_SPEED: f64 = 10.0;
const MAX_CORRECTION_RATE: f64 = 50.0;
/// Largest turn of a body or joint by a correction, rad: the rows are linear in the motion.
const MAX_CORRECTION_TURN: f64 = 0.05;

/// Circumstances of an island in a sub-step, and settings of the solver.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Problem {
    /// Sub-step, s, and its number.
    pub time_step: f64,
    /// See [`time_step`](Self::time_step).
    pub sub_step: u32,
    /// Number of rigid bodies, which come first, and of the bodies after them that consist of several coupled ones.
    pub rigid: u32,
    /// See [`rigid`](Self::rigid).
    pub composites: u32,
    /// Rate at which jointed bodies turn, rad/s.
    pub turn_rate: f64,
    /// Mass of the heaviest rigid body, kg.
    pub heaviest: f64,
    /// Kinetic energy of all bodies before the impulses, J.
    pub kinetic_energy: f64,
    /// Least CFM of rows as a share of their response or diagonal.
    pub joint_softness: f64,
    /// See [`joint_softness`](Self::joint_softness).
    pub contact_softness: f64,
    /// See [`joint_softness`](Self::joint_softness).
    pub friction_softness: f64,
    /// Multiplications a row of a factorisation beyond which the island is not solved; infinite: it is in any case.
    pub most_cost: f64,
    /// Budget of the sub-step.
    pub limits: Limits,
}

/// What became of the velocity problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// All rows are satisfied without impulses.
    AtRest,
    /// It is solved to tolerance.
    Solved,
    /// Its solution is an approximation.
    Approximate,
    /// It is wrong, or a number is not finite: there is no solution.
    Refused,
    /// It is too expensive to be solved.
    Expensive,
}

/// Work of an island.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Counters {
    /// Of all velocity problems, see [`mlcp::Statistics`](crate::mlcp::Statistics).
    pub rows: u32,
    /// See [`rows`](Self::rows).
    pub factorisations: u32,
    /// See [`rows`](Self::rows).
    pub pivots: u32,
    /// See [`rows`](Self::rows).
    pub sweeps: u32,
    /// Position problems whose correction was judged: 0 or 1.
    pub position_problems: u32,
    /// Multiplications of all problems.
    pub multiplications: f64,
    /// Largest violation of complementarity of the solution, m/s or rad/s.
    pub residual: f64,
    /// Largest penetration depth of a contact, m.
    pub depth: f64,
}

/// What the caller keeps from one sub-step to the next.
#[derive(Debug)]
pub struct Kept<'a> {
    /// Of an island that is known from the last sub-step.
    pub memory: Option<&'a mut Memory>,
    /// Of the world.
    pub budgets: &'a mut Budgets,
}

/// What became of an island.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// Of the velocity problem.
    pub outcome: Outcome,
    /// Multiple of [`Island::corrections`] by which rigid bodies move in this sub-step; 0: there is no correction.
    pub correction: f64,
    /// Work.
    pub counters: Counters,
}

/// The articulations of an island, which keep their pseudo-velocities until they move.
pub trait Articulations {
    /// Hands pseudo-velocities over to articulation `i`. Returns how fast its joints and base move by them, as the largest
    /// multiple of 10 m/s or, for what turns, of `most_turned` rad/s.
    fn set_correction(&mut self, i: usize, velocities: &[f64], most_turned: f64) -> f64;
    /// Multiplies the pseudo-velocities of all articulations.
    fn scale_corrections(&mut self, factor: f64);
}

/// No articulations.
impl Articulations for () {
    fn set_correction(&mut self, _: usize, _: &[f64], _: f64) -> f64 {
        0.0
    }
    fn scale_corrections(&mut self, _: f64) {}
}

/// An island of rigid bodies and articulations that rows connect; see the [module](super).
#[derive(Debug, Default)]
pub struct Island {
    solver: Solver,
    /// Guess of each row.
    guesses: Vec<(f64, State)>,
    positions: PositionRows,
    /// Sizes of the velocities of all bodies but the rigid ones.
    sizes: Vec<usize>,
    /// Whether all rows are satisfied without impulses.
    is_at_rest: bool,
    /// Whether drives act on the island that may yield to joints.
    has_drives: bool,
}

impl Island {
    /// An island without rows.
    pub fn new() -> Self {
        Self::default()
    }

    /// Solves both problems. `rows`: those of one joint follow each other, and those of friction come after their contacts;
    /// `sides`: of row i. `sizes`: numbers of velocities of the bodies after the rigid ones: first those that consist of coupled
    /// ones, then articulations.
    ///
    /// Where the outcome is [`Outcome::Refused`] or [`Outcome::Expensive`] there are no results.
    pub fn solve<'a>(
        &mut self,
        problem: &Problem,
        rows: &mut [Row],
        sides: impl Fn(usize) -> [Option<Side<'a>>; 2],
        sizes: impl Iterator<Item = usize>,
        kept: Kept<'_>,
        articulations: &mut dyn Articulations,
    ) -> Solution {
        let Kept { memory, budgets } = kept;
        self.sizes.clear();
        self.sizes.extend(sizes);
        let most = [MAX_CORRECTION_SPEED, max_correction_rate(problem)];
        self.gather(problem, rows, sides, most);
        let mut solution = Solution { outcome: Outcome::AtRest, correction: 0.0, counters: Counters::default() };
        let counters = &mut solution.counters;
        counters.depth = depth(rows);
        let [of_rows, of_positions] = budgets.add_island(&problem.limits, rows.len());
        if self.is_at_rest {
            counters.rows = rows.len() as u32;
        } else {
            let Some(cost) = self.prepare(problem) else { return Solution { outcome: Outcome::Refused, ..solution } };
            if cost > problem.most_cost * rows.len() as f64 {
                return Solution { outcome: Outcome::Expensive, ..solution };
            }
            self.solver.set_kinetic_energy(problem.kinetic_energy);
            solution.outcome = self.solve_velocities(problem, of_rows, memory, budgets, counters);
            if solution.outcome == Outcome::Refused {
                return solution;
            }
        }
        let is_due = self.positions.are_due(problem.sub_step);
        if is_due && (!self.is_at_rest || self.prepare(problem).is_some()) {
            solution.correction =
                self.correct_positions(problem, most, of_positions, budgets, &mut solution.counters, articulations);
        }
        solution
    }

    /// Makes the rows of both problems.
    fn gather<'a>(
        &mut self,
        problem: &Problem,
        rows: &mut [Row],
        sides: impl Fn(usize) -> [Option<Side<'a>>; 2],
        most: [f64; 2],
    ) {
        self.solver.clear();
        self.positions.clear();
        self.guesses.clear();
        self.has_drives = false;
        self.is_at_rest = true;
        average_responses(rows);
        let softness = JointSoftness::new(problem.joint_softness, problem.heaviest, rows, problem.time_step);
        let builder = Builder { problem, softness, share: correction_share(rows, most) };
        for (i, row) in rows.iter().enumerate() {
            let normal = usize::try_from(row.normal).ok().and_then(|normal| self.guesses.get(normal).copied());
            let mut constraint = Constraint { sides: sides(i), ..Constraint::default() };
            let position = builder.build(row, normal, &mut constraint);
            self.guesses.push((constraint.x, constraint.state));
            self.is_at_rest = self.is_at_rest && is_at_rest(&constraint);
            self.has_drives |= constraint.yielding_cfm > 0.0;
            self.positions.add(&constraint, position);
            self.solver.add_row(&constraint);
        }
    }

    /// Multiplications of a factorisation; `None`: the problem is wrong.
    fn prepare(&mut self, problem: &Problem) -> Option<f64> {
        self.solver.prepare(problem.rigid as usize, &self.sizes).ok()
    }

    /// Counts the last solution. Returns what it was.
    fn count(&self, counters: &mut Counters, budgets: &mut Budgets) -> mlcp::Statistics {
        let found = self.solver.statistics();
        counters.multiplications += found.multiplications;
        budgets.work += found.multiplications;
        found
    }

    /// Solves the velocity problem, again with softer drives while these open joints and the budget lasts.
    fn solve_velocities(
        &mut self,
        problem: &Problem,
        of_rows: f64,
        memory: Option<&mut Memory>,
        budgets: &mut Budgets,
        counters: &mut Counters,
    ) -> Outcome {
        if let Some(memory) = &memory {
            self.solver.set_guess_tolerance(memory.guess_tolerance);
        }
        let yields = self.has_drives && memory.is_some();
        let mut kept = memory.as_deref().copied().unwrap_or_default();
        let mut yielding = Yielding::new(yields.then_some(&kept), problem.sub_step);
        let mut budget = of_rows + budgets.shared;
        loop {
            let outcome = self.solver.solve_yielding(yielding.yielding, Budget(budget));
            let found = self.count(counters, budgets);
            budget = larger(budget - found.multiplications, 0.0);
            counters.rows += found.rows;
            counters.factorisations += found.factorisations;
            counters.pivots += found.pivots;
            counters.sweeps += found.sweeps;
            let opened = if yields && outcome != mlcp::Outcome::NotFinite {
                self.positions.opening(self.solver.impulses(), problem.time_step)
            } else {
                0.0
            };
            let before = kept.drive_yielding;
            if !yielding.is_done(opened, &mut budget, of_rows, &mut kept) {
                continue;
            }
            if !yields {
                kept.drive_yielding = before;
            }
            counters.residual = found.residual;
            budgets.shared = budget;
            if let Some(memory) = memory {
                *memory = Memory { guess_tolerance: found.guess_tolerance, ..kept };
            }
            return match outcome {
                mlcp::Outcome::Solved => Outcome::Solved,
                mlcp::Outcome::Approximate { .. } => Outcome::Approximate,
                mlcp::Outcome::NotFinite => Outcome::Refused,
            };
        }
    }

    /// Solves the position problem. Returns the factor of the pseudo-velocities, which is the same for all of the island, so
    /// that bodies keep their joints closed as the solution does; 0: there is no correction.
    fn correct_positions(
        &mut self,
        problem: &Problem,
        most: [f64; 2],
        mut budget: f64,
        budgets: &mut Budgets,
        counters: &mut Counters,
        articulations: &mut dyn Articulations,
    ) -> f64 {
        let mut damping = 1.0;
        let mut round = 0;
        let length = loop {
            let states = self.positions.states();
            let softness = Softness { share: LEAST_POSITION_SOFTNESS, damping };
            let outcome = self.solver.solve_positions_with(|_| None, |row| states[row], softness, Budget(budget));
            if outcome == mlcp::Outcome::NotFinite {
                articulations.scale_corrections(0.0);
                return 0.0;
            }
            budget -= self.count(counters, budgets).multiplications;
            let length = self.correction_length(problem, most, articulations);
            if length <= LONG_CORRECTION || round == MOST_ROUNDS || budget <= 0.0 {
                break length;
            }
            round += 1;
            damping *= RAISED_DAMPING;
        };
        counters.position_problems += 1;
        let left = self.solver.position_errors();
        let (asked, after) = (self.positions.asked(), self.positions.after(left));
        let moved = self.positions.correction_energy(left) / damping;
        let is_made = !is_uncorrectable(&asked, &after) && !is_soft(&asked, &after, moved);
        let factor = if is_made { 1.0 / length } else { 0.0 };
        articulations.scale_corrections(factor);
        factor
    }

    /// How fast the bodies move by the pseudo-velocities, as a multiple of what is allowed, at least 1. Hands those of
    /// articulations over to them.
    fn correction_length(&self, problem: &Problem, most: [f64; 2], articulations: &mut dyn Articulations) -> f64 {
        let composites = self.sizes.len().min(problem.composites as usize);
        let coupled: usize = self.sizes[..composites].iter().sum();
        let (rigid, mut rest) = self.solver.position_velocities().split_at(6 * problem.rigid as usize + coupled);
        let mut fastest = 1.0;
        // Linear and angular velocities, alternately.
        for (&[x, y, z], most) in rigid.as_chunks().0.iter().zip(most.into_iter().cycle()) {
            fastest = larger(fastest, (x * x + y * y + z * z).sqrt() / most);
        }
        for (i, &size) in self.sizes[composites..].iter().enumerate() {
            let (velocities, after) = rest.split_at(size);
            fastest = larger(fastest, articulations.set_correction(i, velocities, most[1]));
            rest = after;
        }
        fastest
    }

    /// Impulses of the velocity problem, N·s or N·m·s, one a row.
    pub fn impulses(&self) -> &[f64] {
        self.solver.impulses()
    }

    /// Its active set, one a row.
    pub fn states(&self) -> &[State] {
        self.solver.states()
    }

    /// Changes of the velocities of all bodies, m/s and rad/s, one body after the other.
    pub fn velocities(&self) -> &[f64] {
        self.solver.velocities()
    }

    /// Pseudo-velocities of the position problem, likewise.
    pub fn corrections(&self) -> &[f64] {
        self.solver.position_velocities()
    }
}

/// Largest angular velocity of a correction, rad/s. Fast motion opens joints fast.
fn max_correction_rate(problem: &Problem) -> f64 {
    smaller(larger(MAX_CORRECTION_RATE, problem.turn_rate), MAX_CORRECTION_TURN / problem.time_step)
}

/// Largest penetration depth of a contact, m.
fn depth(rows: &[Row]) -> f64 {
    let contacts = rows.iter().filter(|row| row.kind == Kind::Contact);
    contacts.fold(0.0, |deepest, contact| larger(deepest, -contact.gap))
}
