//! Up to four trees that move in the registers of AVX2.

use super::algebra::{Matrix, Quaternion, Vector};
use super::drives::World;
use super::ffi::{AmbAbaState, AmbAbaTree};
use super::four::Four;
use super::motion::{cut, Memory, Motion, Spring, Start, NUMBERS, QUATERNIONS, VECTORS};
use super::scalar::Scalar;
use super::step::is_stiff;
use super::together::{Request, SIDE_BY_SIDE};
use super::{Body, Driven, Link, Position, Rate, Tree, Work};

/// Memory of the trees that move side by side, and which of them are alike.
#[derive(Default)]
pub struct Beside {
    bodies: Vec<Body<Four>>,
    rotations: Vec<Matrix<Four>>,
    placed: [Vec<Vector<Four>>; 5],
    work: Vec<Work<Four>>,
    springs: Vec<Spring<Four>>,
    forces: Vec<Four>,
    driven: Vec<Driven<Four>>,
    numbers: Vec<Four>,
    vectors: Vec<Vector<Four>>,
    quaternions: Vec<Quaternion<Four>>,
    /// Positions and rates at the beginning and at the end.
    coordinates: [Vec<Four>; 4],
    balls: [Vec<Quaternion<Four>>; 2],
    /// Pairs of lists of links that are equal.
    equal: Vec<[*const Link; 2]>,
}

/// A tree that moves side by side with others, what is kept of its step, and where it begins and ends.
struct Lane<'a> {
    tree: Tree<'a, f64>,
    springs: &'a [Spring<f64>],
    forces: &'a [f64],
    unbounded: &'a mut [f64],
    mode: &'a mut [f64],
    start_rates: &'a mut [f64],
    start_origins: &'a mut [Vector<f64>],
    state: AmbAbaState,
    from: Position<'a, f64>,
    rate: Rate<'a, f64>,
    to: Position<'a, f64>,
    new_rate: Rate<'a, f64>,
}

impl<'a> Lane<'a> {
    /// # Safety
    /// The request is as the table says; nobody else uses its memory while the result lives.
    #[inline(always)]
    unsafe fn of(request: &Request) -> Self {
        // SAFETY: by the contract of this function.
        unsafe {
            let tree = &*request.tree;
            let (forces, Memory { mut numbers, mut vectors, .. }) = (tree.forces(), tree.memory());
            let mut kept = || cut(&mut numbers, forces.len());
            let (unbounded, mode, start_rates) = (kept(), kept(), kept());
            Lane {
                tree: tree.tree(),
                springs: tree.springs(),
                forces,
                unbounded,
                mode,
                start_rates,
                start_origins: cut(&mut vectors, tree.links as usize + 1),
                state: *tree.state,
                from: (*request.from).position(tree),
                rate: (*request.rate).rate(tree),
                to: (*request.to).position(tree),
                new_rate: (*request.new_rate).rate(tree),
            }
        }
    }
}

impl Beside {
    /// Forgets which trees are alike: others may have taken their memory.
    pub fn begin(&mut self) {
        self.equal.clear();
    }

    /// Answers requests.
    ///
    /// # Safety
    /// The processor has AVX2; the requests are of different trees and as the table of the interface says.
    pub unsafe fn answer(&mut self, mut requests: &[Request]) {
        while let Some((first, others)) = requests.split_first() {
            // SAFETY: by the contract of this function.
            unsafe {
                let is_like_first = |other: &&Request| self.are_alike(first, other);
                let alike = others.iter().take(SIDE_BY_SIDE - 1).take_while(is_like_first).count();
                let (some, rest) = requests.split_at(alike + 1);
                let alone = if alike == 0 { 1 } else { self.answer_alike(some) };
                for (_, request) in some.iter().enumerate().filter(|(world, _)| alone >> world & 1 == 1) {
                    request.answer();
                }
                requests = rest;
            }
        }
    }

    /// Whether two trees have the same joints and springs, and make the same step.
    ///
    /// # Safety
    /// The requests are as the table says.
    unsafe fn are_alike(&mut self, a: &Request, b: &Request) -> bool {
        let lengths = [a.h, b.h];
        // SAFETY: by the contract of this function.
        let (a, b) = unsafe { (&*a.tree, &*b.tree) };
        // SAFETY: as above.
        let flags = |tree: &AmbAbaTree| unsafe {
            let numbers = [tree.links, tree.coordinates, tree.balls, tree.has_fixed_base, tree.springs];
            (numbers, (*tree.state).by_euler)
        };
        if lengths[0] != lengths[1] || flags(a) != flags(b) || a.couplings + b.couplings > 0 {
            return false;
        }
        // SAFETY: as above.
        let [springs, others] = unsafe { [a.springs(), b.springs()] };
        let kind = |spring: &Spring<f64>| (spring.coordinate, spring.is_angle);
        if !springs.iter().map(kind).eq(others.iter().map(kind)) {
            return false;
        }
        let pair = [a.link, b.link];
        if self.equal.contains(&pair) {
            return true;
        }
        // SAFETY: as above.
        let [links, others] = unsafe { [a.links(), b.links()] };
        let are_equal = links.iter().zip(others).all(|(link, other)| link.is_equal(other));
        if are_equal {
            self.equal.push(pair);
        }
        are_equal
    }

    /// Moves two to four trees that are alike. Returns those, a bit each, that have to move alone.
    ///
    /// # Safety
    /// As of [`answer`](Self::answer).
    unsafe fn answer_alike(&mut self, requests: &[Request]) -> u32 {
        // SAFETY: by the contract of this function; the drives are apart from the rest of the memory.
        unsafe {
            let mut lanes: Vec<Lane<'_>> = requests.iter().map(|request| Lane::of(request)).collect();
            let mut worlds: Vec<World<'_>> = requests.iter().map(|request| (*request.tree).world()).collect();
            let alone = self.move_alike(requests[0].h, &mut lanes, &mut worlds);
            for (world, (lane, request)) in lanes.iter_mut().zip(requests).enumerate() {
                if alone >> world & 1 == 0 {
                    let (tree, drives) = (&*request.tree, &worlds[world]);
                    (lane.state.steps_until_probe, lane.state.has_mode) =
                        (drives.steps_until_probe, drives.has_mode.into());
                    *tree.state = lane.state;
                    (*request.to).write(&lane.to);
                    (*request.new_rate).write(&lane.new_rate);
                }
            }
            alone
        }
    }

    #[target_feature(enable = "avx2")]
    fn move_alike(&mut self, h: f64, lanes: &mut [Lane<'_>], worlds: &mut [World<'_>]) -> u32 {
        let mut alone = 0;
        for (world, lane) in lanes.iter().enumerate() {
            alone |= u32::from(is_stiff(lane.tree.bodies, h)) << world;
        }
        self.gather(lanes);
        let first = &lanes[0];
        let (coordinates, balls) = (first.forces.len(), first.from.balls.len());
        let [origins, linear, angular, arms, axes] = &mut self.placed;
        let tree = Tree {
            has_fixed_base: first.tree.has_fixed_base,
            splits_damping: false,
            links: first.tree.links,
            bodies: &self.bodies,
            rotations: &mut self.rotations,
            origins,
            linear,
            angular,
            arms,
            axes,
            work: &mut self.work,
        };
        let of = spread(lanes);
        let zero = Four::splat(0.0);
        let start = Start {
            energy: zero,
            elastic_energy: zero,
            rotation: zero,
            carrying_power: zero,
            centrifugal_energy: zero,
            stiffness: number(of, |lane| lane.state.start.stiffness),
        };
        let [q, rates, new_q, new_rates] = &mut self.coordinates;
        let [ball, new_ball] = &mut self.balls;
        let from = Position {
            rotation: quaternion(of, |lane| lane.from.rotation),
            origin: vector(of, |lane| &lane.from.origin),
            q,
            balls: ball,
        };
        let rate = Rate {
            angular: vector(of, |lane| &lane.rate.angular),
            linear: vector(of, |lane| &lane.rate.linear),
            q: rates,
        };
        let mut to = Position { q: new_q, balls: new_ball, ..Position::default() };
        let mut new_rate = Rate { q: new_rates, ..Rate::default() };
        let memory =
            Memory { numbers: &mut self.numbers, vectors: &mut self.vectors, quaternions: &mut self.quaternions };
        let mut motion = Motion::new(
            tree,
            [coordinates, balls],
            memory,
            &mut self.forces,
            &mut self.driven,
            &self.springs,
            Default::default(),
            worlds,
            start,
        );
        motion.by_euler = first.state.by_euler != 0;
        for (k, mode) in motion.mode.iter_mut().enumerate() {
            *mode = number(of, |lane| lane.mode[k]);
        }
        alone |= motion.straight_step(h, &from, &rate, &mut to, &mut new_rate);
        scatter(lanes, alone, &motion, &to, &new_rate);
        alone
    }

    /// Takes the numbers of the trees.
    #[inline(always)]
    fn gather(&mut self, lanes: &[Lane<'_>]) {
        let (first, of, zero) = (&lanes[0], spread(lanes), Four::splat(0.0));
        let (bodies, vector_zero) = (first.tree.bodies.len(), Vector::<Four>::zero());
        let (coordinates, balls) = (first.from.q.len(), first.from.balls.len());
        let driven = Driven { inertia: zero, pull: zero, is_given: zero, given: zero, force: zero };
        self.rotations.resize(bodies, Matrix([vector_zero; 3]));
        self.placed.iter_mut().for_each(|each| each.resize(bodies, vector_zero));
        self.work.resize(bodies, Work::zero());
        self.driven.resize(coordinates, driven);
        self.numbers.resize(NUMBERS * coordinates, zero);
        self.vectors.resize(VECTORS * bodies, vector_zero);
        self.quaternions.resize(QUATERNIONS * balls, Quaternion::identity());
        self.coordinates.iter_mut().for_each(|each| each.resize(coordinates, zero));
        self.balls.iter_mut().for_each(|each| each.resize(balls, Quaternion::identity()));
        self.forces.resize(coordinates, zero);
        self.bodies.clear();
        for i in 0..bodies {
            self.bodies.push(body(of, i));
        }
        self.springs.clear();
        for (i, spring) in first.springs.iter().enumerate() {
            let each = |read: fn(&Spring<f64>) -> f64| number(of, |lane| read(&lane.springs[i]));
            // What is too stiff in a world has no force there.
            let active = |spring: &Spring<f64>, number: f64| if spring.is_stiff { 0.0 } else { number };
            self.springs.push(Spring {
                coordinate: spring.coordinate,
                is_angle: spring.is_angle,
                sign: each(|spring| spring.sign),
                offset: each(|spring| spring.offset),
                stiffness: number(of, |lane| active(&lane.springs[i], lane.springs[i].stiffness)),
                damping: number(of, |lane| active(&lane.springs[i], lane.springs[i].damping)),
                rest: each(|spring| spring.rest),
                is_stiff: false,
                resists_corrections: spring.resists_corrections,
                settles_in_a_step: spring.settles_in_a_step,
            });
        }
        for k in 0..coordinates {
            self.forces[k] = number(of, |lane| lane.forces[k]);
            self.coordinates[0][k] = number(of, |lane| lane.from.q[k]);
            self.coordinates[1][k] = number(of, |lane| lane.rate.q[k]);
        }
        for k in 0..balls {
            self.balls[0][k] = quaternion(of, |lane| lane.from.balls[k]);
        }
    }
}

/// Gives the trees, but those that have to move `alone`, what a step leaves.
#[inline(always)]
fn scatter(
    lanes: &mut [Lane<'_>],
    alone: u32,
    from: &Motion<'_, '_, Four>,
    to: &Position<'_, Four>,
    new_rate: &Rate<'_, Four>,
) {
    let (start, tree) = (&from.start, &from.equations.tree);
    for (world, lane) in lanes.iter_mut().enumerate().filter(|(world, _)| alone >> world & 1 == 0) {
        lane.unbounded.copy_from_slice(lane.forces);
        lane.start_origins.copy_from_slice(lane.tree.origins);
        lane.start_rates.copy_from_slice(lane.rate.q);
        lane.state = AmbAbaState {
            start: Start {
                energy: start.energy.of(world),
                elastic_energy: start.elastic_energy.of(world),
                rotation: start.rotation.of(world),
                carrying_power: start.carrying_power.of(world),
                centrifugal_energy: start.centrifugal_energy.of(world),
                stiffness: start.stiffness.of(world),
            },
            start_angular: lane.rate.angular,
            start_linear: lane.rate.linear,
            splits_damping: 0,
            has_subspaces: 0,
            ..lane.state
        };
        for k in 0..lane.mode.len() {
            lane.mode[k] = from.mode[k].of(world);
            lane.to.q[k] = to.q[k].of(world);
            lane.new_rate.q[k] = new_rate.q[k].of(world);
        }
    }
    for i in 0..tree.bodies.len() {
        let [x, y, z] = &tree.rotations[i].0;
        let [x, y, z] = [rows(x), rows(y), rows(z)];
        let others = [&*tree.origins, &*tree.linear, &*tree.angular, &*tree.arms, &*tree.axes];
        let [origins, linear, angular, arms, axes] = others.map(|vectors| rows(&vectors[i]));
        for (world, lane) in lanes.iter_mut().enumerate().filter(|(world, _)| alone >> world & 1 == 0) {
            let own = &mut lane.tree;
            own.rotations[i] = Matrix([x[world], y[world], z[world]]);
            own.origins[i] = origins[world];
            own.linear[i] = linear[world];
            own.angular[i] = angular[world];
            own.arms[i] = arms[world];
            own.axes[i] = axes[world];
        }
    }
    let of_base = [to.origin, new_rate.angular, new_rate.linear].map(|vector| rows(&vector));
    for (world, lane) in lanes.iter_mut().enumerate().filter(|(world, _)| alone >> world & 1 == 0) {
        let quaternion = |of: &Quaternion<Four>| Quaternion(of.0.map(|component| component.of(world)));
        lane.to.rotation = quaternion(&to.rotation);
        for (own, ball) in lane.to.balls.iter_mut().zip(&*to.balls) {
            *own = quaternion(ball);
        }
        [lane.to.origin, lane.new_rate.angular, lane.new_rate.linear] = of_base.map(|vectors| vectors[world]);
    }
}

/// A vector of each world.
#[inline(always)]
fn rows(of: &Vector<Four>) -> [Vector<f64>; SIDE_BY_SIDE] {
    let [a, b, c, d] = Four::transposed([of.x, of.y, of.z, Four::splat(0.0)]);
    [a.numbers().into(), b.numbers().into(), c.numbers().into(), d.numbers().into()]
}

/// Four of them; where there are fewer, the first stands for those that are missing.
#[inline(always)]
fn spread<'a, 'b>(lanes: &'a [Lane<'b>]) -> [&'a Lane<'b>; SIDE_BY_SIDE] {
    std::array::from_fn(|world| lanes.get(world).unwrap_or(&lanes[0]))
}

/// One number of each.
#[inline(always)]
fn number<'a, 'b>(of: [&'a Lane<'b>; SIDE_BY_SIDE], read: impl Fn(&'a Lane<'b>) -> f64) -> Four {
    Four::new([read(of[0]), read(of[1]), read(of[2]), read(of[3])])
}

#[inline(always)]
fn vector<'a, 'b>(of: [&'a Lane<'b>; SIDE_BY_SIDE], read: impl Fn(&'a Lane<'b>) -> &'a Vector<f64>) -> Vector<Four> {
    beside([read(of[0]), read(of[1]), read(of[2]), read(of[3])])
}

#[inline(always)]
fn beside([a, b, c, d]: [&Vector<f64>; SIDE_BY_SIDE]) -> Vector<Four> {
    Vector::new(Four::new([a.x, b.x, c.x, d.x]), Four::new([a.y, b.y, c.y, d.y]), Four::new([a.z, b.z, c.z, d.z]))
}

#[inline(always)]
fn quaternion<'a, 'b>(
    of: [&'a Lane<'b>; SIDE_BY_SIDE],
    read: impl Fn(&'a Lane<'b>) -> Quaternion<f64>,
) -> Quaternion<Four> {
    let [a, b, c, d] = [read(of[0]).0, read(of[1]).0, read(of[2]).0, read(of[3]).0];
    Quaternion([
        Four::new([a[0], b[0], c[0], d[0]]),
        Four::new([a[1], b[1], c[1], d[1]]),
        Four::new([a[2], b[2], c[2], d[2]]),
        Four::new([a[3], b[3], c[3], d[3]]),
    ])
}

/// A body of each.
#[inline(always)]
fn body(of: [&Lane<'_>; SIDE_BY_SIDE], i: usize) -> Body<Four> {
    let [a, b, c, d] = [&of[0].tree.bodies[i], &of[1].tree.bodies[i], &of[2].tree.bodies[i], &of[3].tree.bodies[i]];
    Body {
        mass: Four::new([a.mass, b.mass, c.mass, d.mass]),
        inertia: beside([&a.inertia, &b.inertia, &c.inertia, &d.inertia]),
        linear_drag: Four::new([a.linear_drag, b.linear_drag, c.linear_drag, d.linear_drag]),
        angular_drag: Four::new([a.angular_drag, b.angular_drag, c.angular_drag, d.angular_drag]),
        force: beside([&a.force, &b.force, &c.force, &d.force]),
        torque: beside([&a.torque, &b.torque, &c.torque, &d.torque]),
    }
}
