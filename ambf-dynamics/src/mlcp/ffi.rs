//! C interface, for callers that are linked before this crate: they are given [`table`]. The header is
//! `include/ambf_mlcp.h`.
//!
//! A panic does not cross the interface: the call answers as it does for a problem that cannot be solved.

use std::ffi::c_int;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::slice;

use super::solver::Softness;
use super::{Budget, Friction, Outcome, Row, Side, Solver, State};

/// [`Outcome::Solved`] in C.
pub const SOLVED: c_int = 0;
/// [`Outcome::Approximate`] in C; its residual is in the statistics.
pub const APPROXIMATE: c_int = 1;
/// [`Outcome::NotFinite`] in C, and the answer after an internal error. All impulses and velocities are 0.
pub const NOT_FINITE: c_int = 2;

/// A [`Row`] in C.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbMlcpRow {
    /// Body of each side, from 0; -1: nothing that moves.
    pub body: [c_int; 2],
    /// Components of each side's velocity.
    pub size: [c_int; 2],
    /// Row of the Jacobian of each side; `size` numbers, copied.
    pub jacobian: [*const f64; 2],
    /// Change of each side's velocity by a unit impulse, `M⁻¹ Jᵀ`; `size` numbers, copied.
    pub response: [*const f64; 2],
    /// See [`Row::target`].
    pub target: f64,
    /// See [`Row::bias`].
    pub bias: f64,
    /// See [`Row::position_target`].
    pub position_target: f64,
    /// See [`Row::cfm`].
    pub cfm: f64,
    /// See [`Row::position_cfm`](super::ConstraintRow::position_cfm).
    pub position_cfm: f64,
    /// See [`Row::yielding_cfm`](super::ConstraintRow::yielding_cfm).
    pub yielding_cfm: f64,
    /// See [`Row::fed`](super::ConstraintRow::fed).
    pub fed: f64,
    /// See [`Row::low`].
    pub low: f64,
    /// See [`Row::high`].
    pub high: f64,
    /// See [`Friction::normal`]; -1: no friction.
    pub normal: c_int,
    /// See [`Friction::coefficient`].
    pub friction: f64,
    /// See [`Friction::cap`].
    pub cap: f64,
    /// Guess of the active set: 0 free, 1 at the lower bound, 2 at the upper bound.
    pub state: c_int,
    /// Guess of the impulse, N·s or N·m·s.
    pub x: f64,
    /// See [`Row::in_positions`]; not 0: true.
    pub in_positions: c_int,
    /// See [`Row::stays_loaded`]; not 0: true.
    pub stays_loaded: c_int,
    /// See [`Row::is_drive`]; not 0: true.
    pub is_drive: c_int,
}

/// [`Statistics`](super::Statistics) in C.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AmbMlcpStatistics {
    /// Rows of the problem.
    pub rows: u32,
    /// Factorisations, whole or in part.
    pub factorisations: u32,
    /// Rows that changed sides.
    pub pivots: u32,
    /// Sweeps of projected Gauss–Seidel.
    pub sweeps: u32,
    /// Multiplications.
    pub multiplications: f64,
    /// Largest violation of complementarity, m/s or rad/s.
    pub residual: f64,
    /// See [`Statistics::guess_tolerance`](super::Statistics::guess_tolerance).
    pub guess_tolerance: f64,
}

/// The functions of the interface. Solvers come from `create`; none may be used by two threads at once.
///
/// Pointers that are read out hold until the next `prepare` or `destroy` of the solver; the numbers behind them change
/// with the next solution of the same kind.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbMlcpTable {
    /// A new solver; null after an internal error.
    pub create: unsafe extern "C" fn() -> *mut Solver,
    /// Frees a solver; null is ignored.
    pub destroy: unsafe extern "C" fn(solver: *mut Solver),
    /// See [`Solver::clear`].
    pub clear: unsafe extern "C" fn(solver: *mut Solver),
    /// See [`Solver::set_kinetic_energy`].
    pub set_energy: unsafe extern "C" fn(solver: *mut Solver, energy: f64),
    /// See [`Solver::set_guess_tolerance`].
    pub set_guess_tolerance: unsafe extern "C" fn(solver: *mut Solver, share: f64),
    /// See [`Solver::add_row`]. Returns the index of the row, -1 after an internal error or for a negative size.
    pub add_row: unsafe extern "C" fn(solver: *mut Solver, row: *const AmbMlcpRow) -> c_int,
    /// See [`Solver::prepare`]; `sizes` has `articulations` elements. Returns the multiplications of a factorisation,
    /// -1 on error.
    pub prepare:
        unsafe extern "C" fn(solver: *mut Solver, rigid: c_int, sizes: *const c_int, articulations: c_int) -> f64,
    /// See [`Solver::solve_yielding`]; `budget` in multiplications. Returns [`SOLVED`], [`APPROXIMATE`] or [`NOT_FINITE`].
    pub solve: unsafe extern "C" fn(solver: *mut Solver, yielding: f64, budget: f64) -> c_int,
    /// See [`Solver::solve_positions`]; `targets` and `states` have one element a row or are null. Returns as `solve`.
    pub solve_positions: unsafe extern "C" fn(
        solver: *mut Solver,
        targets: *const f64,
        states: *const u8,
        cfm_share: f64,
        damping: f64,
        budget: f64,
    ) -> c_int,
    /// See [`Solver::impulses`].
    pub impulses: unsafe extern "C" fn(solver: *const Solver) -> *const f64,
    /// See [`Solver::states`]: 0 free, 1 low, 2 high.
    pub states: unsafe extern "C" fn(solver: *const Solver) -> *const u8,
    /// See [`Solver::velocities`].
    pub velocities: unsafe extern "C" fn(solver: *const Solver) -> *const f64,
    /// See [`Solver::position_impulses`].
    pub position_impulses: unsafe extern "C" fn(solver: *const Solver) -> *const f64,
    /// See [`Solver::position_states`].
    pub position_states: unsafe extern "C" fn(solver: *const Solver) -> *const u8,
    /// See [`Solver::position_velocities`].
    pub position_velocities: unsafe extern "C" fn(solver: *const Solver) -> *const f64,
    /// See [`Solver::position_errors`].
    pub position_errors: unsafe extern "C" fn(solver: *const Solver) -> *const f64,
    /// Writes the statistics of the last solution.
    pub statistics: unsafe extern "C" fn(solver: *const Solver, out: *mut AmbMlcpStatistics),
}

/// The functions of this crate.
pub fn table() -> &'static AmbMlcpTable {
    static TABLE: AmbMlcpTable = AmbMlcpTable {
        create,
        destroy,
        clear,
        set_energy,
        set_guess_tolerance,
        add_row,
        prepare,
        solve,
        solve_positions,
        impulses,
        states,
        velocities,
        position_impulses,
        position_states,
        position_velocities,
        position_errors,
        statistics,
    };
    &TABLE
}

/// The result of `call`, or `failed` after a panic.
fn guarded<T>(failed: T, call: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(call)).unwrap_or(failed)
}

fn state(number: c_int) -> State {
    match number {
        1 => State::Low,
        2 => State::High,
        _ => State::Free,
    }
}

fn answer(outcome: Outcome) -> c_int {
    match outcome {
        Outcome::Solved => SOLVED,
        Outcome::Approximate { .. } => APPROXIMATE,
        Outcome::NotFinite => NOT_FINITE,
    }
}

/// # Safety
/// `pointer` is null or points to `count` elements that live as long as `'a`.
unsafe fn elements<'a, T>(pointer: *const T, count: usize) -> Option<&'a [T]> {
    // SAFETY: by the contract of this function.
    (!pointer.is_null()).then(|| unsafe { slice::from_raw_parts(pointer, count) })
}

unsafe extern "C" fn create() -> *mut Solver {
    guarded(std::ptr::null_mut(), || Box::into_raw(Box::new(Solver::new())))
}

unsafe extern "C" fn destroy(solver: *mut Solver) {
    if solver.is_null() {
        return;
    }
    // SAFETY: the pointer comes from `create` and is given back once.
    guarded((), || drop(unsafe { Box::from_raw(solver) }));
}

unsafe extern "C" fn clear(solver: *mut Solver) {
    // SAFETY: the pointer comes from `create`, and nobody else uses the solver meanwhile.
    guarded((), || unsafe { &mut *solver }.clear());
}

unsafe extern "C" fn set_energy(solver: *mut Solver, energy: f64) {
    // SAFETY: the pointer comes from `create`, and nobody else uses the solver meanwhile.
    guarded((), || unsafe { &mut *solver }.set_kinetic_energy(energy));
}

unsafe extern "C" fn set_guess_tolerance(solver: *mut Solver, share: f64) {
    // SAFETY: the pointer comes from `create`, and nobody else uses the solver meanwhile.
    guarded((), || unsafe { &mut *solver }.set_guess_tolerance(share));
}

unsafe extern "C" fn add_row(solver: *mut Solver, row: *const AmbMlcpRow) -> c_int {
    guarded(-1, || {
        // SAFETY: the pointer comes from `create`, and nobody else uses the solver meanwhile; the row is the caller's,
        // who keeps it still.
        let (solver, row) = unsafe { (&mut *solver, &*row) };
        let mut sides = [None; 2];
        for (k, out) in sides.iter_mut().enumerate() {
            let Ok(body) = usize::try_from(row.body[k]) else { continue };
            let Ok(size) = usize::try_from(row.size[k]) else { return -1 };
            // SAFETY: the caller gives `size` numbers for each side that moves.
            let numbers = unsafe { (elements(row.jacobian[k], size), elements(row.response[k], size)) };
            let (Some(jacobian), Some(response)) = numbers else { return -1 };
            *out = Some(Side { body, jacobian, response });
        }
        let friction = usize::try_from(row.normal).ok();
        let friction = friction.map(|normal| Friction { normal, coefficient: row.friction, cap: row.cap });
        let index = solver.add_row(&Row {
            sides,
            target: row.target,
            bias: row.bias,
            is_drive: row.is_drive != 0,
            position_target: row.position_target,
            cfm: row.cfm,
            position_cfm: row.position_cfm,
            yielding_cfm: row.yielding_cfm,
            fed: row.fed,
            low: row.low,
            high: row.high,
            friction,
            state: state(row.state),
            x: row.x,
            in_positions: row.in_positions != 0,
            stays_loaded: row.stays_loaded != 0,
        });
        c_int::try_from(index).unwrap_or(-1)
    })
}

unsafe extern "C" fn prepare(solver: *mut Solver, rigid: c_int, sizes: *const c_int, articulations: c_int) -> f64 {
    guarded(-1.0, || {
        // SAFETY: the pointer comes from `create`, and nobody else uses the solver meanwhile.
        let solver = unsafe { &mut *solver };
        let (Ok(rigid), Ok(count)) = (usize::try_from(rigid), usize::try_from(articulations)) else { return -1.0 };
        // SAFETY: the caller gives `articulations` sizes.
        let sizes = unsafe { elements(sizes, count) }.unwrap_or_default();
        let sizes = sizes.iter().map(|&size| usize::try_from(size).unwrap_or(0));
        solver.prepare_with(rigid, sizes).unwrap_or(-1.0)
    })
}

unsafe extern "C" fn solve(solver: *mut Solver, yielding: f64, budget: f64) -> c_int {
    // SAFETY: the pointer comes from `create`, and nobody else uses the solver meanwhile.
    guarded(NOT_FINITE, || answer(unsafe { &mut *solver }.solve_yielding(yielding, Budget(budget))))
}

unsafe extern "C" fn solve_positions(
    solver: *mut Solver,
    targets: *const f64,
    states: *const u8,
    cfm_share: f64,
    damping: f64,
    budget: f64,
) -> c_int {
    guarded(NOT_FINITE, || {
        // SAFETY: the pointer comes from `create`, and nobody else uses the solver meanwhile.
        let solver = unsafe { &mut *solver };
        let rows = solver.impulses().len();
        // SAFETY: the caller gives null or one number a row.
        let (targets, states) = unsafe { (elements(targets, rows), elements(states, rows)) };
        let target = |row: usize| targets.map(|targets| targets[row]);
        let guess = |row: usize| states.map_or(State::Free, |states| state(states[row].into()));
        answer(solver.solve_positions_with(target, guess, Softness { share: cfm_share, damping }, Budget(budget)))
    })
}

/// # Safety
/// `solver` comes from [`create`] and is not changed meanwhile.
unsafe fn read<T>(solver: *const Solver, values: fn(&Solver) -> &[T]) -> *const T {
    // SAFETY: by the contract of this function.
    guarded(std::ptr::null(), || values(unsafe { &*solver }).as_ptr())
}

unsafe extern "C" fn impulses(solver: *const Solver) -> *const f64 {
    // SAFETY: the contract of the table is that of `read`.
    unsafe { read(solver, Solver::impulses) }
}

unsafe extern "C" fn states(solver: *const Solver) -> *const u8 {
    // SAFETY: the contract of the table is that of `read`. `State` is an u8.
    unsafe { read(solver, Solver::states) }.cast()
}

unsafe extern "C" fn velocities(solver: *const Solver) -> *const f64 {
    // SAFETY: the contract of the table is that of `read`.
    unsafe { read(solver, Solver::velocities) }
}

unsafe extern "C" fn position_impulses(solver: *const Solver) -> *const f64 {
    // SAFETY: the contract of the table is that of `read`.
    unsafe { read(solver, Solver::position_impulses) }
}

unsafe extern "C" fn position_states(solver: *const Solver) -> *const u8 {
    // SAFETY: the contract of the table is that of `read`. `State` is an u8.
    unsafe { read(solver, Solver::position_states) }.cast()
}

unsafe extern "C" fn position_velocities(solver: *const Solver) -> *const f64 {
    // SAFETY: the contract of the table is that of `read`.
    unsafe { read(solver, Solver::position_velocities) }
}

unsafe extern "C" fn position_errors(solver: *const Solver) -> *const f64 {
    // SAFETY: the contract of the table is that of `read`.
    unsafe { read(solver, Solver::position_errors) }
}

unsafe extern "C" fn statistics(solver: *const Solver, out: *mut AmbMlcpStatistics) {
    // SAFETY: the solver comes from `create` and is not changed meanwhile; `out` is the caller's.
    let (solver, out) = unsafe { (&*solver, &mut *out) };
    let super::Statistics { rows, factorisations, pivots, sweeps, multiplications, residual, guess_tolerance } =
        solver.statistics();
    *out = AmbMlcpStatistics { rows, factorisations, pivots, sweeps, multiplications, residual, guess_tolerance };
}
