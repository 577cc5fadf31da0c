//! C interface, for callers that are linked before this crate: they are given [`table`]. The header is
//! `include/ambf_island.h`, whose structs [`Row`], [`Problem`], [`Memory`], [`Limits`], [`Budgets`] and [`Counters`] are.
//!
//! A panic does not cross the interface: the call answers as it does for an island that cannot be solved.

use std::ffi::c_int;
use std::mem::size_of;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::slice;

use crate::aba::ffi::AmbTree;
use crate::mlcp::Side;

use super::{Articulations, Budgets, Counters, Island, Limits, Memory, Outcome, Problem, Row};

/// [`Outcome::Solved`] in C.
pub const SOLVED: c_int = 0;
/// [`Outcome::Approximate`] in C.
pub const APPROXIMATE: c_int = 1;
/// [`Outcome::Refused`] in C, and the answer after an internal error. There are no results.
pub const REFUSED: c_int = 2;
/// [`Outcome::AtRest`] in C. There are no impulses and velocities.
pub const AT_REST: c_int = 3;
/// [`Outcome::Expensive`] in C. There are no results.
pub const EXPENSIVE: c_int = 4;

/// One side of a row.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbIslandSide {
    /// Body, from 0; -1: nothing that moves.
    pub body: c_int,
    /// Components of its velocity.
    pub size: c_int,
    /// Row of the Jacobian; `size` numbers, copied.
    pub jacobian: *const f64,
    /// Change of velocity by a unit impulse, `M⁻¹ Jᵀ`; `size` numbers, copied.
    pub response: *const f64,
}

/// The bodies of an island after the rigid ones, and those of them that are articulations, which come last.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbIslandBodies {
    /// Components of the velocity of each.
    pub sizes: *const c_int,
    /// Number of `sizes`.
    pub count: c_int,
    /// Number of `trees`.
    pub articulations: c_int,
    /// Articulations.
    pub trees: *const *mut AmbTree,
}

/// What became of an island. Pointers hold until the next `solve` or `destroy`; those of what there is not are null.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbIslandSolution {
    /// [`SOLVED`] and so on.
    pub outcome: c_int,
    /// See [`Solution::correction`](super::Solution::correction).
    pub correction: f64,
    /// Work.
    pub counters: Counters,
    /// See [`Island::impulses`].
    pub impulses: *const f64,
    /// See [`Island::states`]: 0 free, 1 low, 2 high.
    pub states: *const u8,
    /// See [`Island::velocities`].
    pub velocities: *const f64,
    /// See [`Island::corrections`].
    pub corrections: *const f64,
}

/// The functions of the interface. Islands come from `create`; none may be used by two threads at once.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbIslandTable {
    /// Sizes of [`Row`], [`Problem`], [`Budgets`] and [`AmbIslandSolution`], which are those of the header.
    pub sizes: [usize; 4],
    /// A new island; null after an internal error.
    pub create: unsafe extern "C" fn() -> *mut Island,
    /// Frees an island; null is ignored.
    pub destroy: unsafe extern "C" fn(island: *mut Island),
    /// See [`Island::clear`].
    pub clear: unsafe extern "C" fn(island: *mut Island),
    /// See [`Island::add_row`]; there are two `sides`. Returns the index of the row, -1 after an internal error, for a
    /// negative size or without numbers.
    pub add_row: unsafe extern "C" fn(island: *mut Island, row: *const Row, sides: *const AmbIslandSide) -> c_int,
    /// See [`Island::solve`]; `memory` may be null.
    pub solve: unsafe extern "C" fn(
        island: *mut Island,
        problem: *const Problem,
        bodies: *const AmbIslandBodies,
        memory: *mut Memory,
        budgets: *mut Budgets,
        out: *mut AmbIslandSolution,
    ),
    /// See [`Budgets::begin`].
    pub begin: unsafe extern "C" fn(budgets: *mut Budgets, limits: *const Limits, is_continued: bool),
    /// See [`Budgets::may_divide`].
    pub may_divide: unsafe extern "C" fn(budgets: *const Budgets) -> bool,
}

/// The functions of this crate.
pub fn table() -> &'static AmbIslandTable {
    static TABLE: AmbIslandTable = AmbIslandTable {
        sizes: [size_of::<Row>(), size_of::<Problem>(), size_of::<Budgets>(), size_of::<AmbIslandSolution>()],
        create,
        destroy,
        clear,
        add_row,
        solve,
        begin,
        may_divide,
    };
    &TABLE
}

/// The result of `call`, or `failed` after a panic.
fn guarded<T>(failed: T, call: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(call)).unwrap_or(failed)
}

/// # Safety
/// `pointer` is null or points to `count` elements that live as long as `'a`.
unsafe fn elements<'a, T>(pointer: *const T, count: c_int) -> Option<&'a [T]> {
    let count = usize::try_from(count).ok()?;
    // SAFETY: by the contract of this function.
    (!pointer.is_null()).then(|| unsafe { slice::from_raw_parts(pointer, count) })
}

unsafe extern "C" fn create() -> *mut Island {
    guarded(std::ptr::null_mut(), || Box::into_raw(Box::new(Island::new())))
}

unsafe extern "C" fn destroy(island: *mut Island) {
    if island.is_null() {
        return;
    }
    // SAFETY: the pointer comes from `create` and is given back once.
    guarded((), || drop(unsafe { Box::from_raw(island) }));
}

unsafe extern "C" fn clear(island: *mut Island) {
    // SAFETY: the pointer comes from `create`, and nobody else uses the island meanwhile.
    guarded((), || unsafe { &mut *island }.clear());
}

unsafe extern "C" fn add_row(island: *mut Island, row: *const Row, sides: *const AmbIslandSide) -> c_int {
    guarded(-1, || {
        // SAFETY: the pointer comes from `create`, and nobody else uses the island meanwhile; row and sides are the
        // caller's, who keeps them still.
        let (island, row, given) = unsafe { (&mut *island, &*row, &*sides.cast::<[AmbIslandSide; 2]>()) };
        let mut sides = [None; 2];
        for (side, out) in given.iter().zip(&mut sides) {
            let Ok(body) = usize::try_from(side.body) else { continue };
            // SAFETY: the caller gives `size` numbers for each side that moves.
            let numbers = unsafe { (elements(side.jacobian, side.size), elements(side.response, side.size)) };
            let (Some(jacobian), Some(response)) = numbers else { return -1 };
            *out = Some(Side { body, jacobian, response });
        }
        c_int::try_from(island.add_row(row, sides)).unwrap_or(-1)
    })
}

/// The articulations that a caller gives.
struct Trees<'a>(&'a [*mut AmbTree]);

impl Articulations for Trees<'_> {
    fn set_correction(&mut self, i: usize, velocities: &[f64], most_turned: f64) -> f64 {
        // SAFETY: the caller's articulations differ from each other, and nobody else uses them meanwhile.
        unsafe { &mut *(*self.0[i]).articulation }.set_correction(velocities, most_turned)
    }

    fn scale_corrections(&mut self, factor: f64) {
        for &tree in self.0 {
            // SAFETY: the caller's articulations differ from each other, and nobody else uses them meanwhile.
            unsafe { &mut *(*tree).articulation }.scale_correction(factor);
        }
    }
}

unsafe extern "C" fn solve(
    island: *mut Island,
    problem: *const Problem,
    bodies: *const AmbIslandBodies,
    memory: *mut Memory,
    budgets: *mut Budgets,
    out: *mut AmbIslandSolution,
) {
    let null = std::ptr::null();
    let refused = AmbIslandSolution {
        outcome: REFUSED,
        correction: 0.0,
        counters: Counters::default(),
        impulses: null,
        states: null.cast(),
        velocities: null,
        corrections: null,
    };
    let solution = guarded(refused, || {
        // SAFETY: the pointer comes from `create`, and nobody else uses the island meanwhile; the others are the caller's,
        // and null where that is allowed.
        let (island, problem, bodies, memory, budgets) =
            unsafe { (&mut *island, &*problem, &*bodies, memory.as_mut(), &mut *budgets) };
        // SAFETY: the caller gives as many sizes and articulations as it says.
        let (sizes, trees) = unsafe {
            (
                elements(bodies.sizes, bodies.count).unwrap_or_default(),
                elements(bodies.trees, bodies.articulations).unwrap_or_default(),
            )
        };
        if sizes.len() != problem.composites as usize + trees.len() {
            return refused;
        }
        let sizes = sizes.iter().map(|&size| usize::try_from(size).unwrap_or(0));
        let found = island.solve(problem, sizes, memory, budgets, &mut Trees(trees));
        let outcome = match found.outcome {
            Outcome::Solved => SOLVED,
            Outcome::Approximate => APPROXIMATE,
            Outcome::Refused => REFUSED,
            Outcome::AtRest => AT_REST,
            Outcome::Expensive => EXPENSIVE,
        };
        let (is_solved, is_corrected) = (matches!(outcome, SOLVED | APPROXIMATE), found.correction > 0.0);
        AmbIslandSolution {
            outcome,
            correction: found.correction,
            counters: found.counters,
            impulses: if is_solved { island.impulses().as_ptr() } else { null },
            // `State` is an u8.
            states: if is_solved { island.states().as_ptr().cast() } else { null.cast() },
            velocities: if is_solved { island.velocities().as_ptr() } else { null },
            corrections: if is_corrected { island.corrections().as_ptr() } else { null },
        }
    });
    // SAFETY: `out` is the caller's.
    unsafe { out.write(solution) };
}

unsafe extern "C" fn begin(budgets: *mut Budgets, limits: *const Limits, is_continued: bool) {
    // SAFETY: both are the caller's.
    let (budgets, limits) = unsafe { (&mut *budgets, &*limits) };
    budgets.begin(limits, is_continued);
}

unsafe extern "C" fn may_divide(budgets: *const Budgets) -> bool {
    // SAFETY: they are the caller's.
    unsafe { &*budgets }.may_divide()
}
