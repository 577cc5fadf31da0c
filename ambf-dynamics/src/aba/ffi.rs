//! C interface, for callers that are linked before this crate: they are given [`table`]. The header is `include/ambf_aba.h`.

use std::ffi::c_int;
use std::slice;

use super::algebra::{Matrix, Vector};
use super::together;
use super::{Body, Drive, Link, Position, Rate, Tree, Work};

/// A tree in C. Pointers lead to one element a body, `link` to one a link; vectors have four numbers, matrices three vectors.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbAbaTree {
    /// Number of links.
    pub links: c_int,
    /// Number of coordinates.
    pub coordinates: c_int,
    /// Number of joints that turn about three axes.
    pub balls: c_int,
    /// No force moves the base.
    pub has_fixed_base: c_int,
    /// Drag is no part of the equations.
    pub splits_damping: c_int,
    /// Links and their joints.
    pub link: *const Link,
    /// Bodies.
    pub body: *const Body<f64>,
    /// Orientations, world axes.
    pub rotations: *mut Matrix<f64>,
    /// Centres of mass, m.
    pub origins: *mut Vector<f64>,
    /// Their velocities, m/s.
    pub linear: *mut Vector<f64>,
    /// Angular velocities, rad/s.
    pub angular: *mut Vector<f64>,
    /// From the pivot of the joint to the centre of mass, m.
    pub arms: *mut Vector<f64>,
    /// Axis of a joint of one freedom.
    pub axes: *mut Vector<f64>,
    /// Memory for intermediate results.
    pub work: *mut Work<f64>,
}

/// Position and rates in C: a quaternion x, y, z, w and a vector of the base; one number a coordinate; a quaternion a ball joint; angular
/// and linear velocity of the base.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbAbaMotion {
    /// Orientation of the base.
    pub rotation: *const [f64; 4],
    /// Its centre of mass, m.
    pub origin: *const Vector<f64>,
    /// Coordinates, rad or m.
    pub q: *const f64,
    /// Rotations of the joints that turn about three axes.
    pub balls: *const [f64; 4],
    /// Angular velocity of the base, rad/s.
    pub angular: *const Vector<f64>,
    /// Velocity of its centre of mass, m/s.
    pub linear: *const Vector<f64>,
    /// Rates of the coordinates, rad/s or m/s.
    pub rates: *const f64,
}

/// Rates, or accelerations, that are written.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbAbaRates {
    /// Of the base.
    pub angular: *mut Vector<f64>,
    /// Of the base.
    pub linear: *mut Vector<f64>,
    /// Of the coordinates.
    pub q: *mut f64,
}

/// The functions of the interface. The tree has its memory for itself while one of them runs; positions and rates have as many elements
/// as it has coordinates and ball joints.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbAbaTable {
    /// Size of the intermediate results of a body; those of a link and of a body, which both sides know.
    pub work_size: usize,
    /// See [`work_size`](Self::work_size).
    pub link_size: usize,
    /// See [`work_size`](Self::work_size).
    pub body_size: usize,
    /// Forward kinematics.
    pub update_poses: unsafe extern "C" fn(tree: *const AmbAbaTree, motion: *const AmbAbaMotion),
    /// Velocities of all bodies; poses are up to date.
    pub update_velocities: unsafe extern "C" fn(tree: *const AmbAbaTree, motion: *const AmbAbaMotion),
    /// Accelerations under forces and `efforts`. `drives` has one element a coordinate or is null. Poses and velocities are up to date
    /// where `is_placed` is not 0; else they are found first, and undefined afterwards.
    pub accelerate: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        motion: *const AmbAbaMotion,
        efforts: *const f64,
        drives: *mut Drive<f64>,
        is_placed: c_int,
        out: *const AmbAbaRates,
    ),
    /// Rates with the least kinetic energy of the difference between the velocities of the bodies and those wanted, one vector a body.
    /// Poses are up to date, velocities are those that the base gives to bodies without rates of joints.
    pub project: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        wanted_linear: *const Vector<f64>,
        wanted_angular: *const Vector<f64>,
        efforts: *const f64,
        out: *const AmbAbaRates,
    ),
    /// Writes L, where the generalised inertia is Lᵀ L, by rows, and the inverses of its diagonal; both have six components of the base,
    /// angular first, before the coordinates. Poses and velocities are up to date.
    pub factor: unsafe extern "C" fn(tree: *const AmbAbaTree, factor: *mut f64, inverse_diagonal: *mut f64),
    /// Adds to a row of the Jacobian of those components the part of an impulse along `force` at the centre of mass of a body, and along
    /// `torque`; where `of_joint_only` is not 0, of an impulse between it and its parent.
    pub add_jacobian: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        body: c_int,
        force: *const Vector<f64>,
        torque: *const Vector<f64>,
        of_joint_only: c_int,
        row: *mut f64,
    ),
}

/// The functions.
pub fn table() -> &'static AmbAbaTable {
    static TABLE: AmbAbaTable = AmbAbaTable {
        work_size: size_of::<Work<f64>>(),
        link_size: size_of::<Link>(),
        body_size: size_of::<Body<f64>>(),
        update_poses,
        update_velocities,
        accelerate,
        project,
        factor,
        add_jacobian,
    };
    &TABLE
}

impl AmbAbaTree {
    /// # Safety
    /// As the table says; nobody else uses the memory while the result lives.
    unsafe fn tree<'a>(&self) -> Tree<'a, f64> {
        let bodies = self.links as usize + 1;
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe {
            Tree {
                has_fixed_base: self.has_fixed_base != 0,
                splits_damping: self.splits_damping != 0,
                links: part(self.link, bodies - 1),
                bodies: part(self.body, bodies),
                rotations: slice::from_raw_parts_mut(self.rotations, bodies),
                origins: slice::from_raw_parts_mut(self.origins, bodies),
                linear: slice::from_raw_parts_mut(self.linear, bodies),
                angular: slice::from_raw_parts_mut(self.angular, bodies),
                arms: slice::from_raw_parts_mut(self.arms, bodies),
                axes: slice::from_raw_parts_mut(self.axes, bodies),
                work: slice::from_raw_parts_mut(self.work, bodies),
            }
        }
    }
}

/// Elements at a pointer, which may be null if there are none.
///
/// # Safety
/// There are `count` elements, which nobody changes while the result lives.
pub(super) unsafe fn part<'a, T>(first: *const T, count: usize) -> &'a [T] {
    if count == 0 {
        return &[];
    }
    // SAFETY: by the contract of this function.
    unsafe { slice::from_raw_parts(first, count) }
}

/// As [`part`].
///
/// # Safety
/// As [`part`], and nobody reads them.
pub(super) unsafe fn part_mut<'a, T>(first: *mut T, count: usize) -> &'a mut [T] {
    if count == 0 || first.is_null() {
        return &mut [];
    }
    // SAFETY: by the contract of this function.
    unsafe { slice::from_raw_parts_mut(first, count) }
}

/// # Safety
/// As the table says.
unsafe fn position<'a>(tree: &AmbAbaTree, motion: &AmbAbaMotion) -> Position<'a, f64> {
    // SAFETY: by the contract of the table.
    unsafe {
        Position {
            rotation: *motion.rotation,
            origin: *motion.origin,
            q: part(motion.q, tree.coordinates as usize),
            balls: part(motion.balls, tree.balls as usize),
        }
    }
}

/// # Safety
/// As the table says.
unsafe fn rate<'a>(tree: &AmbAbaTree, motion: &AmbAbaMotion) -> Rate<'a, f64> {
    // SAFETY: by the contract of the table.
    unsafe {
        Rate { angular: *motion.angular, linear: *motion.linear, q: part(motion.rates, tree.coordinates as usize) }
    }
}

unsafe extern "C" fn update_poses(tree: *const AmbAbaTree, motion: *const AmbAbaMotion) {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).tree().update_poses(&position(&*tree, &*motion)) }
}

unsafe extern "C" fn update_velocities(tree: *const AmbAbaTree, motion: *const AmbAbaMotion) {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).tree().update_velocities(&rate(&*tree, &*motion)) }
}

unsafe extern "C" fn accelerate(
    tree: *const AmbAbaTree,
    motion: *const AmbAbaMotion,
    efforts: *const f64,
    drives: *mut Drive<f64>,
    is_placed: c_int,
    out: *const AmbAbaRates,
) {
    // SAFETY: by the contract of the table, also of what waits: the caller goes on when it is answered.
    unsafe {
        let request = together::Request { tree: *tree, motion: *motion, efforts, drives, out: *out };
        if !together::wait(&request) {
            request.answer(is_placed != 0);
        }
    }
}

impl together::Request {
    /// Computes the accelerations in the memory of the tree.
    ///
    /// # Safety
    /// As the table says.
    pub(super) unsafe fn answer(&self, is_placed: bool) {
        let count = self.tree.coordinates as usize;
        // SAFETY: by the contract of the table.
        unsafe {
            let mut tree = self.tree.tree();
            if !is_placed {
                tree.update_poses(&position(&self.tree, &self.motion));
                tree.update_velocities(&rate(&self.tree, &self.motion));
            }
            let (efforts, drives) = (part(self.efforts, count), part_mut(self.drives, count));
            let [angular, linear] = tree.accelerate(efforts, drives, part_mut(self.out.q, count));
            *self.out.angular = angular;
            *self.out.linear = linear;
        }
    }
}

unsafe extern "C" fn project(
    tree: *const AmbAbaTree,
    wanted_linear: *const Vector<f64>,
    wanted_angular: *const Vector<f64>,
    efforts: *const f64,
    out: *const AmbAbaRates,
) {
    // SAFETY: by the contract of the table.
    unsafe {
        let (bodies, count) = ((*tree).links as usize + 1, (*tree).coordinates as usize);
        let (linear, angular) = (part(wanted_linear, bodies), part(wanted_angular, bodies));
        let rates = part_mut((*out).q, count);
        let [angular, linear] = (*tree).tree().project(linear, angular, part(efforts, count), rates);
        *(*out).angular = angular;
        *(*out).linear = linear;
    }
}

unsafe extern "C" fn factor(tree: *const AmbAbaTree, factor: *mut f64, inverse_diagonal: *mut f64) {
    // SAFETY: by the contract of the table.
    unsafe {
        let n = (*tree).coordinates as usize + 6;
        (*tree).tree().factor(part_mut(factor, n * n), part_mut(inverse_diagonal, n));
    }
}

unsafe extern "C" fn add_jacobian(
    tree: *const AmbAbaTree,
    body: c_int,
    force: *const Vector<f64>,
    torque: *const Vector<f64>,
    of_joint_only: c_int,
    row: *mut f64,
) {
    // SAFETY: by the contract of the table.
    unsafe {
        let row = part_mut(row, (*tree).coordinates as usize + 6);
        (*tree).tree().add_jacobian(body as usize, *force, *torque, of_joint_only != 0, row);
    }
}
