//! Mixed linear complementarity problems of islands of constraints.
//!
//! A row is one scalar constraint with impulse `x` on the change `v = M⁻¹ Jᵀ x` of generalised velocities. All rows
//! together are
//!
//! ```text
//! w = (J M⁻¹ Jᵀ + diag(cfm)) x − target
//! low < x < high: w = 0      x = low: w ≥ 0      x = high: w ≤ 0
//! ```
//!
//! with the bounds of Coulomb friction in proportion to the normal impulse, one direction at a time. Units are SI.
//!
//! # Methods
//! 1. The free rows are factored in the cheaper of two ways. By rows: Cholesky factor of the matrix, ordered by Cuthill and
//!    McKee's numbering of the bodies and stored by envelope; after a change of the active set it is computed again from the
//!    first changed row on. In velocity space, for many rows on few velocity components: Woodbury's formula in coordinates
//!    in which the mass matrix of each body is the identity, by blocks of bodies in an order of minimum degree; rows whose
//!    state changes are added or removed, the blocks that depend on them are found again, and the result is refined, from the
//!    impulses at hand on. Rows with hardly any CFM are factored by rows.
//! 2. Block principal pivoting (Júdice and Pires 1994), where the bounds of friction follow the normal impulses.
//! 3. If that cycles, staggered projections (Kaufman et al. 2008): alternately the problem within fixed bounds of friction,
//!    which is convex, by Newton's method with an exact line search, and those bounds, as a mean of two turns (Anderson's
//!    acceleration). Newton's method for sliding friction (Alart and Curnier 1991) follows each alternation. What is missed where that does not
//!    converge is friction alone.
//! 4. Where the budget ends before one problem within fixed bounds is solved, the impulses at hand are scaled to where they
//!    add no energy, and joints are solved exactly for all else; bodies without joints get sweeps of projected Gauss–Seidel.
//!
//! A guess that is the solution is returned unchanged if a factorisation is expensive; a guess near the solution gets a
//! smaller share of the budget, and sweeps end when they hardly change velocities.
//!
//! The work is bounded by a [`Budget`], of which the problem without biases may take as much again; problems whose
//! factorisation does not fit are solved by sweeps of projected Gauss–Seidel. The impulses add no energy beyond that of biases and drives. They
//! are within their bounds, except friction in approximations, and [`Outcome`] states their accuracy. The result depends
//! on the rows and the budget only. No memory is allocated while a problem is not larger than those before it.
//!
//! # Limitations
//! With friction, solutions need neither exist nor be unique (Painlevé). The pyramid of friction has the directions of
//! the rows.

mod coordinates;
mod descent;
mod elimination;
mod factor;
mod free;
mod free_factor;
mod iterate;
mod layout;
mod matrix;
mod newton;
mod pivot;
mod problem;
mod solver;
mod sweeps;
#[cfg(test)]
mod tests;
mod vector;
mod velocity_factor;

pub use problem::{ConstraintRow, Friction, ProblemError, Row, Side, State};
pub(crate) use solver::Softness;
pub use solver::{Budget, Outcome, Solver, Statistics};
