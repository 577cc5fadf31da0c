//! Up to four trees that move in the registers of AVX2.

use std::mem::take;

use super::algebra::{Matrix, Quaternion, Vector};
use super::articulation::Articulation;
use super::drives::World;
use super::four::Four;
use super::list::List;
use super::motion::{Memory, Motion, Spring, Start, NUMBERS, QUATERNIONS, VECTORS};
use super::scalar::Scalar;
use super::step::is_stiff;
use super::together::{Request, SIDE_BY_SIDE};
use super::{Body, Driven, Link, Position, Rate, Tree, Work};

/// An articulation that moves side by side with others.
type Lane<'a> = &'a mut Articulation<'static>;
/// Four of them.
type Lanes<'a> = [&'a Articulation<'static>; SIDE_BY_SIDE];

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

impl Beside {
    /// Forgets which trees are alike: others may have taken their memory.
    pub fn begin(&mut self) {
        self.equal.clear();
    }

    /// Answers requests.
    ///
    /// # Safety
    /// The processor has AVX2; the requests are of different articulations, which nobody else uses meanwhile.
    pub unsafe fn answer(&mut self, mut requests: &[Request]) {
        while let Some((first, others)) = requests.split_first() {
            // SAFETY: by the contract of this function.
            unsafe {
                let is_like_first = |other: &&Request| self.are_alike(first, other);
                let alike = others.iter().take(SIDE_BY_SIDE - 1).take_while(is_like_first).count();
                let (some, rest) = requests.split_at(alike + 1);
                let mut lanes: Vec<Lane> = some.iter().map(|request| &mut *request.articulation).collect();
                let alone = if alike == 0 { 1 } else { self.move_alike(first.h, &mut lanes) };
                for (_, lane) in lanes.iter_mut().enumerate().filter(|(world, _)| alone >> world & 1 == 1) {
                    lane.step_freely(first.h);
                }
                requests = rest;
            }
        }
    }

    /// Whether two articulations have the same joints and springs, and make the same step.
    ///
    /// # Safety
    /// As of [`answer`](Self::answer).
    unsafe fn are_alike(&mut self, a: &Request, b: &Request) -> bool {
        let lengths = [a.h, b.h];
        // SAFETY: by the contract of this function.
        let [a, b] = unsafe { [&(*a.articulation).motion, &(*b.articulation).motion] };
        let numbers = |of: &Motion<'_, '_, f64>| {
            (of.equations.tree.links.len(), of.unbounded.len(), of.equations.tree.has_fixed_base, of.by_euler)
        };
        let has_couplings = !(a.equations.coupled.is_empty() && b.equations.coupled.is_empty());
        if lengths[0] != lengths[1] || numbers(a) != numbers(b) || has_couplings {
            return false;
        }
        let kind = |spring: &Spring<f64>| (spring.coordinate, spring.is_angle);
        if !a.equations.springs.iter().map(kind).eq(b.equations.springs.iter().map(kind)) {
            return false;
        }
        let [links, others] = [a.equations.tree.links, b.equations.tree.links];
        let pair = [links.as_ptr(), others.as_ptr()];
        if self.equal.contains(&pair) {
            return true;
        }
        let are_equal = links.iter().zip(others).all(|(link, other)| link.is_equal(other));
        if are_equal {
            self.equal.push(pair);
        }
        are_equal
    }

    /// Moves two to four articulations that are alike. Returns those, a bit each, that have to move alone.
    #[target_feature(enable = "avx2")]
    fn move_alike(&mut self, h: f64, lanes: &mut [Lane<'_>]) -> u32 {
        let mut alone = 0;
        for (world, lane) in lanes.iter().enumerate() {
            alone |= u32::from(is_stiff(lane.motion.equations.tree.bodies, h)) << world;
        }
        // The drives are apart from all else that is read and written.
        let worlds = &mut [(); SIDE_BY_SIDE].map(|()| World::default())[..lanes.len()];
        let mut probes = [(0, false); SIDE_BY_SIDE];
        for ((world, probe), lane) in worlds.iter_mut().zip(&mut probes).zip(&mut *lanes) {
            *world = take(&mut lane.motion.equations.worlds[0]);
            *probe = (world.steps_until_probe, world.has_mode);
        }
        self.gather(lanes);
        let first = &lanes[0];
        let (coordinates, balls) = (first.position.q.len(), first.position.balls.len());
        let [origins, linear, angular, arms, axes] = &mut self.placed;
        let tree = Tree {
            has_fixed_base: first.motion.equations.tree.has_fixed_base,
            splits_damping: false,
            links: first.motion.equations.tree.links,
            bodies: &mut self.bodies,
            rotations: &mut self.rotations,
            origins,
            linear,
            angular,
            arms,
            axes,
            work: &mut self.work,
        };
        let of = spread(lanes);
        let [q, rates, new_q, new_rates] = &mut self.coordinates;
        let [ball, new_ball] = &mut self.balls;
        let from = Position {
            rotation: quaternion(of, |lane| lane.position.rotation),
            origin: vector(of, |lane| &lane.position.origin),
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
            List::full(&mut self.springs),
            Default::default(),
            worlds,
        );
        motion.start.stiffness = number(of, |lane| lane.motion.start.stiffness);
        motion.by_euler = first.motion.by_euler;
        for (k, mode) in motion.mode.iter_mut().enumerate() {
            *mode = number(of, |lane| lane.motion.mode[k]);
        }
        alone |= motion.straight_step(h, &from, &rate, &mut to, &mut new_rate);
        scatter(lanes, alone, &motion, &to, &new_rate);
        for (index, (world, lane)) in motion.equations.worlds.iter_mut().zip(lanes).enumerate() {
            if alone >> index & 1 == 1 {
                (world.steps_until_probe, world.has_mode) = probes[index];
            }
            lane.motion.equations.worlds[0] = take(world);
        }
        alone
    }

    /// Takes the numbers of the trees.
    #[inline(always)]
    fn gather(&mut self, lanes: &[Lane<'_>]) {
        let (first, of, zero) = (&lanes[0], spread(lanes), Four::splat(0.0));
        let (bodies, vector_zero) = (first.motion.equations.tree.bodies.len(), Vector::<Four>::zero());
        let (coordinates, balls) = (first.position.q.len(), first.position.balls.len());
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
        for (i, spring) in first.motion.equations.springs.iter().enumerate() {
            let each = |read: fn(&Spring<f64>) -> f64| number(of, |lane| read(&lane.motion.equations.springs[i]));
            // What is too stiff in a world has no force there.
            fn active(spring: &Spring<f64>, number: f64) -> f64 {
                if spring.is_stiff {
                    0.0
                } else {
                    number
                }
            }
            self.springs.push(Spring {
                coordinate: spring.coordinate,
                is_angle: spring.is_angle,
                sign: each(|spring| spring.sign),
                offset: each(|spring| spring.offset),
                stiffness: each(|spring| active(spring, spring.stiffness)),
                damping: each(|spring| active(spring, spring.damping)),
                rest: each(|spring| spring.rest),
                is_stiff: false,
                resists_corrections: spring.resists_corrections,
                settles_in_a_step: spring.settles_in_a_step,
            });
        }
        for k in 0..coordinates {
            self.forces[k] = number(of, |lane| lane.motion.equations.forces[k]);
            self.coordinates[0][k] = number(of, |lane| lane.position.q[k]);
            self.coordinates[1][k] = number(of, |lane| lane.rate.q[k]);
        }
        for k in 0..balls {
            self.balls[0][k] = quaternion(of, |lane| lane.position.balls[k]);
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
        let motion = &mut lane.motion;
        motion.unbounded.copy_from_slice(motion.equations.forces);
        motion.start_origins.copy_from_slice(motion.equations.tree.origins);
        motion.start_rate.copy(&lane.rate);
        motion.start = Start {
            energy: start.energy.of(world),
            elastic_energy: start.elastic_energy.of(world),
            rotation: start.rotation.of(world),
            carrying_power: start.carrying_power.of(world),
            centrifugal_energy: start.centrifugal_energy.of(world),
            stiffness: start.stiffness.of(world),
        };
        motion.equations.tree.splits_damping = false;
        lane.has_subspaces = false;
        for k in 0..motion.mode.len() {
            motion.mode[k] = from.mode[k].of(world);
            lane.free_position.q[k] = to.q[k].of(world);
            lane.free_rate.q[k] = new_rate.q[k].of(world);
        }
    }
    for i in 0..tree.bodies.len() {
        let [x, y, z] = &tree.rotations[i].0;
        let [x, y, z] = [rows(x), rows(y), rows(z)];
        let others = [&*tree.origins, &*tree.linear, &*tree.angular, &*tree.arms, &*tree.axes];
        let [origins, linear, angular, arms, axes] = others.map(|vectors| rows(&vectors[i]));
        for (world, lane) in lanes.iter_mut().enumerate().filter(|(world, _)| alone >> world & 1 == 0) {
            let own = &mut lane.motion.equations.tree;
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
        lane.free_position.rotation = quaternion(&to.rotation);
        for (own, ball) in lane.free_position.balls.iter_mut().zip(&*to.balls) {
            *own = quaternion(ball);
        }
        [lane.free_position.origin, lane.free_rate.angular, lane.free_rate.linear] =
            of_base.map(|vectors| vectors[world]);
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
fn spread<'a>(lanes: &'a [Lane<'_>]) -> Lanes<'a> {
    std::array::from_fn(|world| &**lanes.get(world).unwrap_or(&lanes[0]))
}

/// One number of each.
#[inline(always)]
fn number<'a>(of: Lanes<'a>, read: impl Fn(&'a Articulation<'static>) -> f64) -> Four {
    Four::new([read(of[0]), read(of[1]), read(of[2]), read(of[3])])
}

#[inline(always)]
fn vector<'a>(of: Lanes<'a>, read: impl Fn(&'a Articulation<'static>) -> &'a Vector<f64>) -> Vector<Four> {
    beside([read(of[0]), read(of[1]), read(of[2]), read(of[3])])
}

#[inline(always)]
fn beside([a, b, c, d]: [&Vector<f64>; SIDE_BY_SIDE]) -> Vector<Four> {
    Vector::new(Four::new([a.x, b.x, c.x, d.x]), Four::new([a.y, b.y, c.y, d.y]), Four::new([a.z, b.z, c.z, d.z]))
}

#[inline(always)]
fn quaternion<'a>(of: Lanes<'a>, read: impl Fn(&'a Articulation<'static>) -> Quaternion<f64>) -> Quaternion<Four> {
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
fn body(of: Lanes<'_>, i: usize) -> Body<Four> {
    let [a, b, c, d] = of.map(|lane| &lane.motion.equations.tree.bodies[i]);
    Body {
        mass: Four::new([a.mass, b.mass, c.mass, d.mass]),
        inertia: beside([&a.inertia, &b.inertia, &c.inertia, &d.inertia]),
        linear_drag: Four::new([a.linear_drag, b.linear_drag, c.linear_drag, d.linear_drag]),
        angular_drag: Four::new([a.angular_drag, b.angular_drag, c.angular_drag, d.angular_drag]),
        force: beside([&a.force, &b.force, &c.force, &d.force]),
        torque: beside([&a.torque, &b.torque, &c.torque, &d.torque]),
    }
}
