//! C interface, for callers that are linked before this crate: they are given [`table`]. The header is `include/ambf_aba.h`.

use std::ffi::c_int;
use std::slice;

use super::algebra::{Matrix, Quaternion, Vector};
use super::coupling::{Coupled, CoupledCoordinate};
use super::drives::{DistantLimits, Drive, World};
use super::energy::Momentum;
use super::motion::{Memory, Motion, Spring, Start, NUMBERS, QUATERNIONS, VECTORS};
use super::{motion, together, Body, Driven, Link, Position, Rate, Tree, Work};

/// What of the motion of a tree is kept from call to call.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbAbaState {
    /// Of the latest step.
    pub start: Start<f64>,
    /// Velocity of the base at its beginning.
    pub start_angular: Vector<f64>,
    /// See [`start_angular`](Self::start_angular).
    pub start_linear: Vector<f64>,
    /// Steps until the fastest mode is estimated again; whether it was.
    pub steps_until_probe: c_int,
    /// See [`steps_until_probe`](Self::steps_until_probe).
    pub has_mode: c_int,
    /// Drag is no part of the equations of the latest step.
    pub splits_damping: c_int,
    /// Steps are semi-implicit Euler steps.
    pub by_euler: c_int,
    /// Rows of couplings that were found by `factor`.
    pub coupling_rows: c_int,
    /// Motion subspaces and velocity products are those of the poses and velocities: they are not after a step beside other trees.
    pub has_subspaces: c_int,
}

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
    /// Number of springs.
    pub springs: c_int,
    /// Number of couplings.
    pub couplings: c_int,
    /// Number of limits that are distant.
    pub distant_limits: c_int,
    /// Places for drives.
    pub drive_places: c_int,
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
    /// Springs.
    pub spring: *const Spring<f64>,
    /// Terms of all couplings, and the end of each.
    pub coupled: *const CoupledCoordinate,
    /// See `coupled`.
    pub coupling_ends: *const c_int,
    /// For each component of the velocity, six of the base and then the coordinates, the one before on the path to the base; -1: none.
    pub parents: *const c_int,
    /// The factor of the inertia, by rows.
    pub factor: *mut f64,
    /// Inverses of its diagonal.
    pub inverse_diagonal: *mut f64,
    /// Rows of couplings, one after the other.
    pub coupling_row: *mut f64,
    /// Memory for two rows.
    pub rows: *mut f64,
    /// Drives, and how many there are.
    pub drive: *mut Drive,
    /// See [`drive`](Self::drive).
    pub drives: *mut c_int,
    /// Limits that are distant.
    pub distant: *const DistantLimits,
    /// Memory: two elements a coordinate.
    pub driven: *mut Driven<f64>,
    /// Memory: one a coordinate.
    pub given_by: *mut c_int,
    /// Memory: one a coordinate.
    pub rest: *mut f64,
    /// Force on each coordinate, N·m or N, constant over a step.
    pub forces: *mut f64,
    /// Memory, as the table says.
    pub numbers: *mut f64,
    /// See [`numbers`](Self::numbers).
    pub vectors: *mut Vector<f64>,
    /// See [`numbers`](Self::numbers).
    pub quaternions: *mut Quaternion<f64>,
    /// What is kept.
    pub state: *mut AmbAbaState,
}

/// A position in C: a quaternion x, y, z, w and a vector of the base; one number a coordinate; a quaternion a ball joint.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbAbaPosition {
    /// Orientation of the base.
    pub rotation: *mut Quaternion<f64>,
    /// Its centre of mass, m.
    pub origin: *mut Vector<f64>,
    /// Coordinates, rad or m.
    pub q: *mut f64,
    /// Rotations of the joints that turn about three axes.
    pub balls: *mut Quaternion<f64>,
}

/// Rates or accelerations in C.
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
/// as it has coordinates and ball joints, and what is written lies nowhere else. What they do is described where they are in this crate.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AmbAbaTable {
    /// Sizes of what both sides know: intermediate results of a body, link, body, spring, drive, distant limits, state.
    pub sizes: [usize; 7],
    /// Numbers a coordinate, vectors a body and quaternions a ball joint of the memory.
    pub memory: [usize; 3],
    /// Forward kinematics.
    pub update_poses: unsafe extern "C" fn(tree: *const AmbAbaTree, at: *const AmbAbaPosition),
    /// Velocities of all bodies; poses are up to date.
    pub update_velocities: unsafe extern "C" fn(tree: *const AmbAbaTree, rate: *const AmbAbaRates),
    /// `Equations::accelerate`; poses and velocities are up to date.
    pub accelerate: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        at: *const AmbAbaPosition,
        rate: *const AmbAbaRates,
        out: *const AmbAbaRates,
    ),
    /// `Motion::step`.
    pub step: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        h: f64,
        from: *const AmbAbaPosition,
        rate: *const AmbAbaRates,
        to: *const AmbAbaPosition,
        new_rate: *const AmbAbaRates,
    ),
    /// `Motion::tangential_step`.
    pub tangential_step: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        h: f64,
        from: *const AmbAbaPosition,
        rate: *const AmbAbaRates,
        to: *const AmbAbaPosition,
        new_rate: *const AmbAbaRates,
    ) -> f64,
    /// `Motion::project`.
    pub project: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        linear: *const Vector<f64>,
        angular: *const Vector<f64>,
        rate: *const AmbAbaRates,
    ),
    /// `Motion::bound_rotation`.
    pub bound_rotation: unsafe extern "C" fn(tree: *const AmbAbaTree, rate: *const AmbAbaRates, most: f64),
    /// `advance_position`.
    pub advance_position:
        unsafe extern "C" fn(tree: *const AmbAbaTree, at: *const AmbAbaPosition, h: f64, rate: *const AmbAbaRates),
    /// `Equations::factor_inertia`.
    pub factor: unsafe extern "C" fn(tree: *const AmbAbaTree),
    /// `Coupled::response`.
    pub response: unsafe extern "C" fn(tree: *const AmbAbaTree, coordinate: c_int) -> f64,
    /// `Coupled::normalise`.
    pub normalise: unsafe extern "C" fn(tree: *const AmbAbaTree, row: *mut f64),
    /// `Coupled::rates_of`.
    pub rates_of: unsafe extern "C" fn(tree: *const AmbAbaTree, z: *const f64, rate: *const AmbAbaRates),
    /// `Coupled::coordinates_of`.
    pub coordinates_of: unsafe extern "C" fn(tree: *const AmbAbaTree, rate: *const AmbAbaRates, z: *mut f64),
    /// `Tree::add_jacobian`.
    pub add_jacobian: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        body: c_int,
        force: *const Vector<f64>,
        torque: *const Vector<f64>,
        of_joint_only: c_int,
        row: *mut f64,
    ),
    /// `Tree::kinetic_energy`.
    pub kinetic_energy: unsafe extern "C" fn(tree: *const AmbAbaTree) -> f64,
    /// `Tree::internal_energy`.
    pub internal_energy: unsafe extern "C" fn(tree: *const AmbAbaTree) -> f64,
    /// `Tree::mass`.
    pub mass: unsafe extern "C" fn(tree: *const AmbAbaTree) -> f64,
    /// `Tree::mass_centre`.
    pub mass_centre: unsafe extern "C" fn(tree: *const AmbAbaTree, out: *mut Vector<f64>),
    /// `Tree::momentum`: linear and angular.
    pub momentum: unsafe extern "C" fn(tree: *const AmbAbaTree, about: *const Vector<f64>, out: *mut Vector<f64>),
    /// `Tree::set_momentum`.
    pub set_momentum: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        momentum: *const Vector<f64>,
        about: *const Vector<f64>,
        rate: *const AmbAbaRates,
    ),
    /// `Tree::scale_internal_velocity`.
    pub scale_internal_velocity: unsafe extern "C" fn(tree: *const AmbAbaTree, share: f64, rate: *const AmbAbaRates),
    /// `Tree::fastest_rotation`.
    pub fastest_rotation: unsafe extern "C" fn(tree: *const AmbAbaTree, rate: *const AmbAbaRates) -> f64,
    /// `Equations::work_at_rate`.
    pub work_at_rate: unsafe extern "C" fn(
        tree: *const AmbAbaTree,
        h: f64,
        at: *const AmbAbaPosition,
        rate: *const AmbAbaRates,
    ) -> f64,
}

/// The functions.
pub fn table() -> &'static AmbAbaTable {
    static TABLE: AmbAbaTable = AmbAbaTable {
        sizes: [
            size_of::<Work<f64>>(),
            size_of::<Link>(),
            size_of::<Body<f64>>(),
            size_of::<Spring<f64>>(),
            size_of::<Drive>(),
            size_of::<DistantLimits>(),
            size_of::<AmbAbaState>(),
        ],
        memory: [NUMBERS, VECTORS, QUATERNIONS],
        update_poses,
        update_velocities,
        accelerate,
        step,
        tangential_step,
        project,
        bound_rotation,
        advance_position,
        factor,
        response,
        normalise,
        rates_of,
        coordinates_of,
        add_jacobian,
        kinetic_energy,
        internal_energy,
        mass,
        mass_centre,
        momentum,
        set_momentum,
        scale_internal_velocity,
        fastest_rotation,
        work_at_rate,
    };
    &TABLE
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

impl AmbAbaTree {
    fn count(&self) -> usize {
        self.coordinates as usize
    }

    /// # Safety
    /// As the table says; nobody else uses the memory while the result lives.
    pub(super) unsafe fn tree<'a>(&self) -> Tree<'a, f64> {
        let bodies = self.links as usize + 1;
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe {
            Tree {
                has_fixed_base: self.has_fixed_base != 0,
                splits_damping: (*self.state).splits_damping != 0,
                links: self.links(),
                bodies: part(self.body, bodies),
                rotations: part_mut(self.rotations, bodies),
                origins: part_mut(self.origins, bodies),
                linear: part_mut(self.linear, bodies),
                angular: part_mut(self.angular, bodies),
                arms: part_mut(self.arms, bodies),
                axes: part_mut(self.axes, bodies),
                work: part_mut(self.work, bodies),
            }
        }
    }

    /// # Safety
    /// As of [`tree`](Self::tree).
    pub(super) unsafe fn world<'a>(&self) -> World<'a> {
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe {
            World {
                places: part_mut(self.drive, self.drive_places as usize),
                count: *self.drives as usize,
                distant: part(self.distant, self.distant_limits as usize),
                driven: &mut part_mut(self.driven, 2 * self.count())[self.count()..],
                given_by: part_mut(self.given_by, self.count()),
                rest: part_mut(self.rest, self.count()),
                steps_until_probe: (*self.state).steps_until_probe,
                has_mode: (*self.state).has_mode != 0,
            }
        }
    }

    /// # Safety
    /// As of [`tree`](Self::tree).
    pub(super) unsafe fn forces<'a>(&self) -> &'a mut [f64] {
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe { part_mut(self.forces, self.count()) }
    }

    /// # Safety
    /// As of [`tree`](Self::tree).
    pub(super) unsafe fn links<'a>(&self) -> &'a [Link] {
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe { part(self.link, self.links as usize) }
    }

    /// # Safety
    /// As of [`tree`](Self::tree).
    pub(super) unsafe fn springs<'a>(&self) -> &'a [Spring<f64>] {
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe { part(self.spring, self.springs as usize) }
    }

    /// # Safety
    /// As of [`tree`](Self::tree).
    pub(super) unsafe fn memory<'a>(&self) -> Memory<'a, f64> {
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe {
            Memory {
                numbers: part_mut(self.numbers, NUMBERS * self.count()),
                vectors: part_mut(self.vectors, VECTORS * (self.links as usize + 1)),
                quaternions: part_mut(self.quaternions, QUATERNIONS * self.balls as usize),
            }
        }
    }

    /// # Safety
    /// As of [`tree`](Self::tree).
    unsafe fn coupled<'a>(&self) -> Coupled<'a> {
        let (n, couplings) = (self.count() + 6, self.couplings as usize);
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe {
            let ends = part(self.coupling_ends, couplings);
            let [velocity, impulse] = [0, n].map(|first| part_mut(self.rows.add(first), n));
            Coupled {
                has_fixed_base: self.has_fixed_base != 0,
                terms: part(self.coupled, ends.last().map_or(0, |end| *end as usize)),
                ends,
                parents: part(self.parents, n),
                factor: part_mut(self.factor, n * n),
                inverse_diagonal: part_mut(self.inverse_diagonal, n),
                rows: part_mut(self.coupling_row, couplings * n),
                row_count: (*self.state).coupling_rows as usize,
                velocity,
                impulse,
            }
        }
    }

    /// Brings motion subspaces and velocity products up to date, where they are not.
    ///
    /// # Safety
    /// As of [`tree`](Self::tree); the rate is that of the bodies.
    unsafe fn find_subspaces(&self, rate: &Rate<'_, f64>) {
        // SAFETY: by the contract of this function.
        unsafe {
            if std::mem::replace(&mut (*self.state).has_subspaces, 1) == 0 {
                self.tree().update_velocities(rate);
            }
        }
    }

    /// The motion.
    ///
    /// # Safety
    /// As of [`tree`](Self::tree).
    unsafe fn motion<'a, 'w>(&self, worlds: &'a mut [World<'w>]) -> Motion<'a, 'w, f64> {
        // SAFETY: by the contract of the table, there are so many elements.
        unsafe {
            let state = &*self.state;
            let mut motion = Motion::new(
                self.tree(),
                [self.count(), self.balls as usize],
                self.memory(),
                self.forces(),
                part_mut(self.driven, self.count()),
                self.springs(),
                self.coupled(),
                worlds,
                state.start,
            );
            motion.by_euler = state.by_euler != 0;
            (motion.start_rate.angular, motion.start_rate.linear) = (state.start_angular, state.start_linear);
            motion
        }
    }

    /// Keeps what does not lie in the memory of the tree.
    ///
    /// # Safety
    /// As of [`tree`](Self::tree); both are of it.
    unsafe fn keep(&self, motion: &Motion<'_, '_, f64>, world: &World<'_>) {
        // SAFETY: by the contract of this function.
        let (state, drives) = unsafe { (&mut *self.state, &mut *self.drives) };
        state.start = motion.start;
        (state.start_angular, state.start_linear) = (motion.start_rate.angular, motion.start_rate.linear);
        state.splits_damping = motion.equations.tree.splits_damping.into();
        state.coupling_rows = motion.equations.coupled.row_count as c_int;
        state.steps_until_probe = world.steps_until_probe;
        state.has_mode = world.has_mode.into();
        *drives = world.count as c_int;
    }

    /// Lets something happen with the motion of the tree.
    ///
    /// # Safety
    /// As of [`tree`](Self::tree).
    unsafe fn with_motion<R>(&self, act: impl FnOnce(&mut Motion<'_, '_, f64>) -> R) -> R {
        // SAFETY: by the contract of this function.
        unsafe {
            let mut world = self.world();
            let mut motion = self.motion(slice::from_mut(&mut world));
            let result = act(&mut motion);
            self.keep(&motion, &motion.equations.worlds[0]);
            result
        }
    }
}

impl AmbAbaPosition {
    /// # Safety
    /// It is one of a tree with so many elements, and nobody else uses it while the result lives.
    pub(super) unsafe fn position<'a>(&self, tree: &AmbAbaTree) -> Position<'a, f64> {
        // SAFETY: by the contract of this function.
        unsafe {
            Position {
                rotation: *self.rotation,
                origin: *self.origin,
                q: part_mut(self.q, tree.count()),
                balls: part_mut(self.balls, tree.balls as usize),
            }
        }
    }

    /// Writes the pose of the base; the rest is in place.
    ///
    /// # Safety
    /// As of [`position`](Self::position).
    pub(super) unsafe fn write(&self, position: &Position<'_, f64>) {
        // SAFETY: by the contract of this function.
        unsafe { (*self.rotation, *self.origin) = (position.rotation, position.origin) }
    }
}

impl AmbAbaRates {
    /// # Safety
    /// It is one of a tree with so many elements, and nobody else uses it while the result lives.
    pub(super) unsafe fn rate<'a>(&self, tree: &AmbAbaTree) -> Rate<'a, f64> {
        // SAFETY: by the contract of this function.
        unsafe { Rate { angular: *self.angular, linear: *self.linear, q: part_mut(self.q, tree.count()) } }
    }

    /// Writes the velocity of the base; the rest is in place.
    ///
    /// # Safety
    /// As of [`rate`](Self::rate).
    pub(super) unsafe fn write(&self, rate: &Rate<'_, f64>) {
        // SAFETY: by the contract of this function.
        unsafe { (*self.angular, *self.linear) = (rate.angular, rate.linear) }
    }
}

/// Lets something happen with a rate, which is written.
///
/// # Safety
/// As the table says.
unsafe fn with_rate<R>(
    tree: *const AmbAbaTree,
    rates: *const AmbAbaRates,
    act: impl FnOnce(&mut Rate<'_, f64>) -> R,
) -> R {
    // SAFETY: by the contract of the table.
    unsafe {
        let mut rate = (*rates).rate(&*tree);
        let result = act(&mut rate);
        (*rates).write(&rate);
        result
    }
}

unsafe extern "C" fn update_poses(tree: *const AmbAbaTree, at: *const AmbAbaPosition) {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).tree().update_poses(&(*at).position(&*tree)) }
}

unsafe extern "C" fn update_velocities(tree: *const AmbAbaTree, rate: *const AmbAbaRates) {
    // SAFETY: by the contract of the table.
    unsafe {
        (*(*tree).state).has_subspaces = 1;
        (*tree).tree().update_velocities(&(*rate).rate(&*tree));
    }
}

unsafe extern "C" fn accelerate(
    tree: *const AmbAbaTree,
    at: *const AmbAbaPosition,
    rate: *const AmbAbaRates,
    out: *const AmbAbaRates,
) {
    // SAFETY: by the contract of the table.
    unsafe {
        let (at, rate) = ((*at).position(&*tree), (*rate).rate(&*tree));
        with_rate(tree, out, |out| (*tree).with_motion(|motion| motion.equations.accelerate(&at, &rate, out, true)));
    }
}

unsafe extern "C" fn step(
    tree: *const AmbAbaTree,
    h: f64,
    from: *const AmbAbaPosition,
    rate: *const AmbAbaRates,
    to: *const AmbAbaPosition,
    new_rate: *const AmbAbaRates,
) {
    // SAFETY: by the contract of the table, also of what waits: the caller goes on when it is answered.
    unsafe {
        let request = together::Request { tree, h, from, rate, to, new_rate };
        if !together::wait(&request) {
            request.answer();
        }
    }
}

impl together::Request {
    /// Makes the step in the memory of the tree.
    ///
    /// # Safety
    /// As the table says.
    pub(super) unsafe fn answer(&self) {
        // SAFETY: by the contract of the table.
        unsafe {
            let tree = &*self.tree;
            let (from, rate) = ((*self.from).position(tree), (*self.rate).rate(tree));
            let mut to = (*self.to).position(tree);
            tree.find_subspaces(&rate);
            with_rate(tree, self.new_rate, |new_rate| {
                tree.with_motion(|motion| motion.step(self.h, &from, &rate, &mut to, new_rate));
            });
            (*self.to).write(&to);
        }
    }
}

unsafe extern "C" fn tangential_step(
    tree: *const AmbAbaTree,
    h: f64,
    from: *const AmbAbaPosition,
    rate: *const AmbAbaRates,
    to: *const AmbAbaPosition,
    new_rate: *const AmbAbaRates,
) -> f64 {
    // SAFETY: by the contract of the table.
    unsafe {
        let (from, rate, mut end) = ((*from).position(&*tree), (*rate).rate(&*tree), (*to).position(&*tree));
        let energy = with_rate(tree, new_rate, |new_rate| {
            (*tree).with_motion(|motion| motion.tangential_step(h, &from, &rate, &mut end, new_rate))
        });
        (*to).write(&end);
        energy
    }
}

/// # Safety
/// There is place for two vectors.
unsafe fn write_momentum(of: &Momentum<f64>, to: *mut Vector<f64>) {
    // SAFETY: by the contract of this function.
    unsafe { part_mut(to, 2).copy_from_slice(&[of.linear, of.angular]) }
}

unsafe extern "C" fn project(
    tree: *const AmbAbaTree,
    linear: *const Vector<f64>,
    angular: *const Vector<f64>,
    rate: *const AmbAbaRates,
) {
    // SAFETY: by the contract of the table.
    unsafe {
        let bodies = (*tree).links as usize + 1;
        let (linear, angular) = (part(linear, bodies), part(angular, bodies));
        with_rate(tree, rate, |rate| (*tree).with_motion(|motion| motion.project(linear, angular, rate)));
    }
}

unsafe extern "C" fn bound_rotation(tree: *const AmbAbaTree, rate: *const AmbAbaRates, most: f64) {
    // SAFETY: by the contract of the table.
    unsafe {
        with_rate(tree, rate, |rate| {
            let is_fast = (*tree).tree().fastest_coordinate(rate) > most || rate.angular.length() > most;
            if is_fast {
                (*tree).find_subspaces(rate);
                (*tree).with_motion(|motion| motion.bound_rotation(rate, most));
            }
        });
    }
}

unsafe extern "C" fn advance_position(
    tree: *const AmbAbaTree,
    at: *const AmbAbaPosition,
    h: f64,
    rate: *const AmbAbaRates,
) {
    // SAFETY: by the contract of the table.
    unsafe {
        let mut position = (*at).position(&*tree);
        motion::advance_position(&(*tree).tree(), &mut position, h, &(*rate).rate(&*tree));
        (*at).write(&position);
    }
}

unsafe extern "C" fn factor(tree: *const AmbAbaTree) {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).with_motion(|motion| motion.equations.factor_inertia()) }
}

unsafe extern "C" fn response(tree: *const AmbAbaTree, coordinate: c_int) -> f64 {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).coupled().response(coordinate as usize) }
}

unsafe extern "C" fn normalise(tree: *const AmbAbaTree, row: *mut f64) {
    // SAFETY: by the contract of the table.
    unsafe {
        let row = part_mut(row, (*tree).count() + 6);
        (*tree).coupled().normalise(row);
    }
}

unsafe extern "C" fn rates_of(tree: *const AmbAbaTree, z: *const f64, rate: *const AmbAbaRates) {
    // SAFETY: by the contract of the table.
    unsafe {
        let z = part(z, (*tree).count() + 6);
        with_rate(tree, rate, |rate| (*tree).coupled().rates_of(z, rate));
    }
}

unsafe extern "C" fn coordinates_of(tree: *const AmbAbaTree, rate: *const AmbAbaRates, z: *mut f64) {
    // SAFETY: by the contract of the table.
    unsafe {
        let (rate, z) = ((*rate).rate(&*tree), part_mut(z, (*tree).count() + 6));
        (*tree).coupled().coordinates_of(&rate, z);
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
        let row = part_mut(row, (*tree).count() + 6);
        (*tree).tree().add_jacobian(body as usize, *force, *torque, of_joint_only != 0, row);
    }
}

unsafe extern "C" fn kinetic_energy(tree: *const AmbAbaTree) -> f64 {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).tree().kinetic_energy() }
}

unsafe extern "C" fn internal_energy(tree: *const AmbAbaTree) -> f64 {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).tree().internal_energy() }
}

unsafe extern "C" fn mass(tree: *const AmbAbaTree) -> f64 {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).tree().mass() }
}

unsafe extern "C" fn mass_centre(tree: *const AmbAbaTree, out: *mut Vector<f64>) {
    // SAFETY: by the contract of the table.
    unsafe { *out = (*tree).tree().mass_centre() }
}

unsafe extern "C" fn momentum(tree: *const AmbAbaTree, about: *const Vector<f64>, out: *mut Vector<f64>) {
    // SAFETY: by the contract of the table.
    unsafe { write_momentum(&(*tree).tree().momentum(*about), out) }
}

unsafe extern "C" fn set_momentum(
    tree: *const AmbAbaTree,
    momentum: *const Vector<f64>,
    about: *const Vector<f64>,
    rate: *const AmbAbaRates,
) {
    // SAFETY: by the contract of the table.
    unsafe {
        let wanted = Momentum { linear: *momentum, angular: *momentum.add(1) };
        with_rate(tree, rate, |rate| (*tree).tree().set_momentum(&wanted, *about, rate));
    }
}

unsafe extern "C" fn scale_internal_velocity(tree: *const AmbAbaTree, share: f64, rate: *const AmbAbaRates) {
    // SAFETY: by the contract of the table.
    unsafe { with_rate(tree, rate, |rate| (*tree).tree().scale_internal_velocity(share, rate)) }
}

unsafe extern "C" fn fastest_rotation(tree: *const AmbAbaTree, rate: *const AmbAbaRates) -> f64 {
    // SAFETY: by the contract of the table.
    unsafe { (*tree).tree().fastest_rotation(&(*rate).rate(&*tree)) }
}

unsafe extern "C" fn work_at_rate(
    tree: *const AmbAbaTree,
    h: f64,
    at: *const AmbAbaPosition,
    rate: *const AmbAbaRates,
) -> f64 {
    // SAFETY: by the contract of the table.
    unsafe {
        let (at, rate) = ((*at).position(&*tree), (*rate).rate(&*tree));
        (*tree).with_motion(|motion| motion.equations.work_at_rate(h, &at, &rate))
    }
}
