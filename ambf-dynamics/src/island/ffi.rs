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

use super::{Articulations, Budgets, Counters, Island, Kept, Limits, Memory, Outcome, Problem, Row};

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
    /// Row of the Jacobian; `size` numbers.
    pub jacobian: *const f64,
    /// Change of velocity by a unit impulse, `M⁻¹ Jᵀ`; `size` numbers.
    pub response: *const f64,
}

impl Default for AmbIslandSide {
    /// Nothing that moves.
    fn default() -> Self {
        Self { body: -1, size: 0, jacobian: std::ptr::null(), response: std::ptr::null() }
    }
}

impl AmbIslandSide {
    /// # Safety
    /// There are `size` numbers that live as long as `'a`.
    unsafe fn read<'a>(&self) -> Option<Side<'a>> {
        let body = usize::try_from(self.body).ok()?;
        // SAFETY: by the contract of this function.
        let (jacobian, response) = unsafe { (elements(self.jacobian, self.size), elements(self.response, self.size)) };
        // A side without numbers has the wrong size, and the problem is refused.
        Some(Side { body, jacobian: jacobian.unwrap_or_default(), response: response.unwrap_or_default() })
    }
}

/// An island, and the memory of its rows, which the caller fills.
#[derive(Debug, Default)]
pub struct AmbIsland {
    island: Island,
    rows: Vec<Row>,
    sides: Vec<[AmbIslandSide; 2]>,
    numbers: Vec<f64>,
}

/// Where the caller writes rows; until the next `reserve` or `destroy`.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbIslandSpace {
    /// Rows.
    pub rows: *mut Row,
    /// Two a row.
    pub sides: *mut [AmbIslandSide; 2],
    /// Numbers to which sides may point.
    pub numbers: *mut f64,
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
    /// Sizes of [`Row`], [`AmbIslandSide`], [`Problem`], [`Budgets`] and [`AmbIslandSolution`], which are those of the header.
    pub sizes: [usize; 5],
    /// A new island; null after an internal error.
    pub create: unsafe extern "C" fn() -> *mut AmbIsland,
    /// Frees an island; null is ignored.
    pub destroy: unsafe extern "C" fn(island: *mut AmbIsland),
    /// Makes space for rows and numbers. What was written before is lost. Null after an internal error.
    pub reserve: unsafe extern "C" fn(island: *mut AmbIsland, rows: usize, numbers: usize) -> AmbIslandSpace,
    /// See [`Island::solve`], of the first `rows` rows of the space; `memory` may be null.
    pub solve: unsafe extern "C" fn(
        island: *mut AmbIsland,
        rows: usize,
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
        sizes: [
            size_of::<Row>(),
            size_of::<AmbIslandSide>(),
            size_of::<Problem>(),
            size_of::<Budgets>(),
            size_of::<AmbIslandSolution>(),
        ],
        create,
        destroy,
        reserve,
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

unsafe extern "C" fn create() -> *mut AmbIsland {
    guarded(std::ptr::null_mut(), || Box::into_raw(Box::<AmbIsland>::default()))
}

unsafe extern "C" fn destroy(island: *mut AmbIsland) {
    if island.is_null() {
        return;
    }
    // SAFETY: the pointer comes from `create` and is given back once.
    guarded((), || drop(unsafe { Box::from_raw(island) }));
}

unsafe extern "C" fn reserve(island: *mut AmbIsland, rows: usize, numbers: usize) -> AmbIslandSpace {
    let none =
        AmbIslandSpace { rows: std::ptr::null_mut(), sides: std::ptr::null_mut(), numbers: std::ptr::null_mut() };
    guarded(none, || {
        // SAFETY: the pointer comes from `create`, and nobody else uses the island meanwhile.
        let AmbIsland { rows: to, sides, numbers: values, .. } = unsafe { &mut *island };
        // The space is never made smaller: only what is new is written.
        to.resize(rows.max(to.len()), Row::default());
        sides.resize(rows.max(sides.len()), Default::default());
        values.resize(numbers.max(values.len()), 0.0);
        AmbIslandSpace { rows: to.as_mut_ptr(), sides: sides.as_mut_ptr(), numbers: values.as_mut_ptr() }
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
    island: *mut AmbIsland,
    rows: usize,
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
        let (AmbIsland { island, rows: space, sides, .. }, problem, bodies, memory, budgets) =
            unsafe { (&mut *island, &*problem, &*bodies, memory.as_mut(), &mut *budgets) };
        // SAFETY: the caller gives as many sizes and articulations as it says.
        let (sizes, trees) = unsafe {
            (
                elements(bodies.sizes, bodies.count).unwrap_or_default(),
                elements(bodies.trees, bodies.articulations).unwrap_or_default(),
            )
        };
        let Some(rows) = space.get_mut(..rows) else { return refused };
        if sizes.len() != problem.composites as usize + trees.len() {
            return refused;
        }
        // SAFETY: the caller gives `size` numbers for each side that moves, and keeps them until this call returns.
        let sides = |row: usize| [0, 1].map(|k| unsafe { sides[row][k].read() });
        let sizes = sizes.iter().map(|&size| usize::try_from(size).unwrap_or(0));
        let found = island.solve(problem, rows, sides, sizes, Kept { memory, budgets }, &mut Trees(trees));
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
