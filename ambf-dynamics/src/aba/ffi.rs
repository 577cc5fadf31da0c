//! C interface, for callers that are linked before this crate: they are given [`table`]. The header is `cpp/articulation_tree.h`, which
//! describes what is shared.

use std::ffi::{c_int, c_void};
use std::mem::{align_of, size_of};
use std::slice;

use super::account::{Energy, Sums};
use super::algebra::{Matrix, Quaternion, Vector};
use super::articulation::{Articulation, Base, Bounds, Circumstances, Plan, Store, Wrench};
use super::coupling::CoupledCoordinate;
use super::motion::Spring;
use super::rows::{Joint, Row, WideRow};
use super::{together, Body, Link};

/// What an articulation is made of, see [`Plan`]. Arrays have as many elements as the numbers say, `body` one more than `link`.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbPlan {
    /// Numbers of links, couplings and places for springs.
    pub links: c_int,
    /// See [`links`](Self::links).
    pub couplings: c_int,
    /// See [`links`](Self::links).
    pub springs: c_int,
    /// No force moves the base.
    pub has_fixed_base: c_int,
    /// Links.
    pub link: *const Link,
    /// Bodies.
    pub body: *const Body<f64>,
    /// Terms of all couplings.
    pub term: *const CoupledCoordinate,
    /// The end of each coupling.
    pub end: *const c_int,
    /// Their offsets, rad or m.
    pub offset: *const f64,
    /// Of corrections.
    pub bounds: Bounds,
    /// Gives memory, aligned to 16 bytes, whose first 16 bytes the caller keeps for itself.
    pub allocate: unsafe extern "C" fn(list: *mut *mut c_void, size: usize) -> *mut c_void,
    /// The blocks that it gave.
    pub blocks: *mut *mut c_void,
}

/// What both sides know of an articulation. Pointers lead to one element a body, the base first; `link` and `joint` to one a link.
#[repr(C)]
pub struct AmbTree {
    /// The articulation.
    pub articulation: *mut Articulation<'static>,
    /// Numbers of links and coordinates.
    pub links: c_int,
    /// See [`links`](Self::links).
    pub coordinates: c_int,
    /// Links.
    pub link: *const Link,
    /// Bodies.
    pub body: *mut Body<f64>,
    /// Springs.
    pub spring: *mut Spring<f64>,
    /// Poses and velocities of the bodies.
    pub rotations: *const Matrix<f64>,
    /// See [`rotations`](Self::rotations).
    pub origins: *const Vector<f64>,
    /// See [`rotations`](Self::rotations).
    pub linear: *const Vector<f64>,
    /// See [`rotations`](Self::rotations).
    pub angular: *const Vector<f64>,
    /// Position: pose of the base, coordinates, rotations of joints that turn about three axes.
    pub rotation: *mut Quaternion<f64>,
    /// See [`rotation`](Self::rotation).
    pub origin: *mut Vector<f64>,
    /// See [`rotation`](Self::rotation).
    pub q: *mut f64,
    /// See [`rotation`](Self::rotation).
    pub balls: *mut Quaternion<f64>,
    /// Velocity of the base and rates of the coordinates.
    pub base_linear: *mut Vector<f64>,
    /// See [`base_linear`](Self::base_linear).
    pub base_angular: *mut Vector<f64>,
    /// See [`base_linear`](Self::base_linear).
    pub rates: *mut f64,
    /// For the next sub-step, see [`Articulation`].
    pub wrenches: *mut Wrench,
    /// See [`wrenches`](Self::wrenches).
    pub gravity: *mut Vector<f64>,
    /// See [`wrenches`](Self::wrenches).
    pub joint: *mut Joint,
    /// See [`wrenches`](Self::wrenches).
    pub circumstances: *mut Circumstances,
    /// Pose and velocity of a fixed base.
    pub base: *mut Base,
    /// Impulses of rows.
    pub applied: *mut Wrench,
    /// Rows of its joints, as many as [`AmbTreeTable::rows`] says.
    pub row: *mut Row,
    /// Reactions of joints, and of springs beside them.
    pub reactions: *const Wrench,
    /// See [`reactions`](Self::reactions).
    pub spring_reactions: *const Wrench,
    /// Of the energy.
    pub energy: *const Energy,
    /// See [`energy`](Self::energy).
    pub sums: *mut Sums,
    /// There are rows in this sub-step.
    pub has_rows: *const bool,
    /// Kinetic energy after the free motion, J.
    pub free_energy: *const f64,
}

/// The functions of the interface. A tree is one that `make` has made and that nobody else uses while one of them runs; arrays have as many
/// elements as it has bodies, coordinates, or six more than these for velocities z. What they do is described at the methods of
/// [`Articulation`] of the same names.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbTreeTable {
    /// Sizes of what both sides know: link, body, spring, joint, row, wide row, circumstances, tree.
    pub sizes: [usize; 8],
    /// `Articulation::new`.
    pub make: unsafe extern "C" fn(plan: *const AmbPlan) -> *mut AmbTree,
    /// `add_spring`.
    pub add_spring: unsafe extern "C" fn(
        tree: *mut AmbTree,
        spring: *const Spring<f64>,
        body: c_int,
        is_beside: c_int,
        low: f64,
        high: f64,
    ),
    /// `forget`.
    pub forget: unsafe extern "C" fn(tree: *mut AmbTree),
    /// `settle`; null: no velocities.
    pub settle: unsafe extern "C" fn(tree: *mut AmbTree, linear: *const Vector<f64>, angular: *const Vector<f64>),
    /// `place`.
    pub place: unsafe extern "C" fn(tree: *mut AmbTree),
    /// Forgets the rows of the limits of joints of several coordinates, and adds one.
    pub clear_wide_rows: unsafe extern "C" fn(tree: *mut AmbTree),
    /// See [`clear_wide_rows`](Self::clear_wide_rows).
    pub add_wide_row: unsafe extern "C" fn(tree: *mut AmbTree, row: *const WideRow),
    /// The free motion over h s.
    pub move_freely: unsafe extern "C" fn(tree: *mut AmbTree, h: f64),
    /// `prepare_rows`.
    pub prepare_rows: unsafe extern "C" fn(tree: *mut AmbTree, h: f64),
    /// Number of rows of its joints in this sub-step.
    pub rows: unsafe extern "C" fn(tree: *const AmbTree) -> c_int,
    /// `Rows::write`: into that many times the number of velocities z, all 0.
    pub write_rows: unsafe extern "C" fn(tree: *mut AmbTree, jacobians: *mut f64),
    /// Adds a unit impulse along a force at the centre of mass of a body, and along a torque, to a row for z.
    pub add_to_row: unsafe extern "C" fn(
        tree: *const AmbTree,
        body: c_int,
        force: *const Vector<f64>,
        torque: *const Vector<f64>,
        row: *mut f64,
    ),
    /// `finish`, with the impulses of the rows of its joints.
    pub finish: unsafe extern "C" fn(tree: *mut AmbTree, h: f64, z: *const f64, impulses: *const f64),
    /// `read_rates`.
    pub read_rates: unsafe extern "C" fn(tree: *const AmbTree, start: *mut f64, free: *mut f64),
    /// `note_energy`.
    pub note_energy: unsafe extern "C" fn(tree: *mut AmbTree),
}

/// The functions.
pub fn table() -> &'static AmbTreeTable {
    static TABLE: AmbTreeTable = AmbTreeTable {
        sizes: [
            size_of::<Link>(),
            size_of::<Body<f64>>(),
            size_of::<Spring<f64>>(),
            size_of::<Joint>(),
            size_of::<Row>(),
            size_of::<WideRow>(),
            size_of::<Circumstances>(),
            size_of::<AmbTree>(),
        ],
        make,
        add_spring,
        forget,
        settle,
        place,
        clear_wide_rows,
        add_wide_row,
        move_freely,
        prepare_rows,
        rows,
        write_rows,
        add_to_row,
        finish,
        read_rates,
        note_energy,
    };
    &TABLE
}

/// Memory that the caller gives: it holds as long as the articulation.
struct Blocks<'p> {
    plan: &'p AmbPlan,
}

impl Blocks<'_> {
    /// A place for elements, which are not written yet.
    fn block<T>(&self, count: usize) -> *mut T {
        const { assert!(align_of::<T>() <= 16, "blocks are aligned to 16 bytes") };
        // SAFETY: by the contract of the plan.
        unsafe { (self.plan.allocate)(self.plan.blocks, count * size_of::<T>()).cast() }
    }

    fn keep<T: 'static>(&self, element: T) -> &'static mut T {
        let place = self.block::<T>(1);
        // SAFETY: the block is large enough and nobody else's.
        unsafe {
            place.write(element);
            &mut *place
        }
    }
}

impl<'a> Store<'a> for Blocks<'_> {
    fn take<T: 'a>(&mut self, count: usize, make: impl Fn() -> T) -> &'a mut [T] {
        if count == 0 {
            return &mut [];
        }
        let first = self.block::<T>(count);
        // SAFETY: the block is large enough and nobody else's; all elements are written.
        unsafe {
            (0..count).for_each(|i| first.add(i).write(make()));
            slice::from_raw_parts_mut(first, count)
        }
    }
}

/// Elements at a pointer, which may be null if there are none.
///
/// # Safety
/// There are `count` elements, which nobody changes while the result lives.
unsafe fn part<'a, T>(first: *const T, count: usize) -> &'a [T] {
    if count == 0 {
        return &[];
    }
    // SAFETY: by the contract of this function.
    unsafe { slice::from_raw_parts(first, count) }
}

/// The articulation of a tree.
///
/// # Safety
/// As of the table; nobody else uses it while the result lives.
unsafe fn of<'a>(tree: *const AmbTree) -> &'a mut Articulation<'static> {
    // SAFETY: by the contract of this function.
    unsafe { &mut *(*tree).articulation }
}

/// As [`part`].
///
/// # Safety
/// As [`part`], and nobody reads them.
unsafe fn part_mut<'a, T>(first: *mut T, count: usize) -> &'a mut [T] {
    if count == 0 {
        return &mut [];
    }
    // SAFETY: by the contract of this function.
    unsafe { slice::from_raw_parts_mut(first, count) }
}

unsafe extern "C" fn make(plan: *const AmbPlan) -> *mut AmbTree {
    // SAFETY: by the contract of the plan.
    let (plan, (links, ends, terms, offsets)) = unsafe {
        let plan = &*plan;
        let couplings = plan.couplings as usize;
        let ends = part(plan.end, couplings);
        let terms = part(plan.term, ends.last().map_or(0, |end| *end as usize));
        (plan, (part(plan.link, plan.links as usize), ends, terms, part(plan.offset, couplings)))
    };
    let plan_of = Plan {
        has_fixed_base: plan.has_fixed_base != 0,
        links,
        // SAFETY: by the contract of the plan.
        bodies: unsafe { part(plan.body, links.len() + 1) },
        springs: plan.springs as usize,
        terms,
        ends,
        offsets,
        bounds: plan.bounds,
    };
    let mut blocks = Blocks { plan };
    let articulation = Articulation::new(&mut blocks, &plan_of);
    let tree = shared(blocks.keep(articulation));
    blocks.keep(tree)
}

/// What the caller sees of an articulation, which stays where it is.
fn shared(of: &'static mut Articulation<'static>) -> AmbTree {
    let tree = &mut of.motion.equations.tree;
    AmbTree {
        links: tree.links.len() as c_int,
        coordinates: of.rate.q.len() as c_int,
        link: tree.links.as_ptr(),
        body: tree.bodies.as_mut_ptr(),
        rotations: tree.rotations.as_ptr(),
        origins: tree.origins.as_ptr(),
        linear: tree.linear.as_ptr(),
        angular: tree.angular.as_ptr(),
        spring: of.motion.equations.springs.as_mut_ptr(),
        rotation: &raw mut of.position.rotation,
        origin: &raw mut of.position.origin,
        q: of.position.q.as_mut_ptr(),
        balls: of.position.balls.as_mut_ptr(),
        base_linear: &raw mut of.rate.linear,
        base_angular: &raw mut of.rate.angular,
        rates: of.rate.q.as_mut_ptr(),
        wrenches: of.wrenches.as_mut_ptr(),
        gravity: of.gravity.as_mut_ptr(),
        joint: of.joints.as_mut_ptr(),
        circumstances: &raw mut of.circumstances,
        base: &raw mut of.base,
        applied: of.applied.as_mut_ptr(),
        row: of.rows.planned.as_mut_ptr(),
        reactions: of.reactions.as_ptr(),
        spring_reactions: of.spring_reactions.as_ptr(),
        energy: &raw const of.account.energy,
        sums: &raw mut of.account.sums,
        has_rows: &raw const of.has_rows,
        free_energy: &raw const of.free_energy,
        articulation: of,
    }
}

unsafe extern "C" fn add_spring(
    tree: *mut AmbTree,
    spring: *const Spring<f64>,
    body: c_int,
    is_beside: c_int,
    low: f64,
    high: f64,
) {
    // SAFETY: by the contract of the table.
    unsafe { of(tree).add_spring(*spring, body as usize, is_beside != 0, [low, high]) }
}

unsafe extern "C" fn forget(tree: *mut AmbTree) {
    // SAFETY: by the contract of the table.
    unsafe { of(tree).forget() }
}

unsafe extern "C" fn settle(tree: *mut AmbTree, linear: *const Vector<f64>, angular: *const Vector<f64>) {
    // SAFETY: by the contract of the table.
    unsafe {
        let bodies = (*tree).links as usize + 1;
        let velocities = (!linear.is_null()).then(|| [part(linear, bodies), part(angular, bodies)]);
        of(tree).settle(velocities);
    }
}

unsafe extern "C" fn place(tree: *mut AmbTree) {
    // SAFETY: by the contract of the table.
    unsafe { of(tree).place() }
}

unsafe extern "C" fn clear_wide_rows(tree: *mut AmbTree) {
    // SAFETY: by the contract of the table.
    unsafe { of(tree).rows.wide.clear() }
}

unsafe extern "C" fn add_wide_row(tree: *mut AmbTree, row: *const WideRow) {
    // SAFETY: by the contract of the table.
    unsafe { of(tree).rows.wide.push(*row) }
}

unsafe extern "C" fn move_freely(tree: *mut AmbTree, h: f64) {
    // SAFETY: by the contract of the table, also of what waits: the caller goes on when it is answered. No reference to the articulation
    // lives while it waits.
    unsafe {
        of(tree).begin_free_motion(h);
        let request = together::Request { articulation: (*tree).articulation, h };
        if !together::wait(&request) {
            request.answer();
        }
        of(tree).end_free_motion(h);
    }
}

unsafe extern "C" fn prepare_rows(tree: *mut AmbTree, h: f64) {
    // SAFETY: by the contract of the table.
    unsafe { of(tree).prepare_rows(h) }
}

unsafe extern "C" fn rows(tree: *const AmbTree) -> c_int {
    // SAFETY: by the contract of the table.
    let rows = unsafe { &of(tree).rows };
    if rows.are_drives {
        0
    } else {
        rows.planned.len() as c_int
    }
}

unsafe extern "C" fn write_rows(tree: *mut AmbTree, jacobians: *mut f64) {
    // SAFETY: by the contract of the table.
    unsafe {
        let of = of(tree);
        let count = of.rows.planned.len() * ((*tree).coordinates as usize + 6);
        of.rows.write(&of.motion, &of.row_rate, part_mut(jacobians, count));
    }
}

unsafe extern "C" fn add_to_row(
    tree: *const AmbTree,
    body: c_int,
    force: *const Vector<f64>,
    torque: *const Vector<f64>,
    row: *mut f64,
) {
    // SAFETY: by the contract of the table.
    unsafe {
        let (equations, row) = (&of(tree).motion.equations, part_mut(row, (*tree).coordinates as usize + 6));
        equations.tree.add_jacobian(body as usize, *force, *torque, false, row);
        equations.coupled.normalise(row);
    }
}

unsafe extern "C" fn finish(tree: *mut AmbTree, h: f64, z: *const f64, impulses: *const f64) {
    // SAFETY: by the contract of the table.
    unsafe {
        let of = of(tree);
        if of.has_rows {
            let rows = &mut of.rows.planned;
            let impulses = part(impulses, rows.len());
            for (row, impulse) in rows.iter_mut().zip(impulses) {
                row.impulse = *impulse;
            }
        }
        of.finish(h, part(z, (*tree).coordinates as usize + 6));
    }
}

unsafe extern "C" fn read_rates(tree: *const AmbTree, start: *mut f64, free: *mut f64) {
    // SAFETY: by the contract of the table.
    unsafe {
        let size = (*tree).coordinates as usize + 6;
        of(tree).read_rates(part_mut(start, size), part_mut(free, size));
    }
}

unsafe extern "C" fn note_energy(tree: *mut AmbTree) {
    // SAFETY: by the contract of the table.
    unsafe { of(tree).note_energy() }
}
