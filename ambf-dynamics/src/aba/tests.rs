use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use super::algebra::Quaternion as Turn;
use super::articulation::{Articulation, Bounds, Plan, Store};
use super::coupling::CoupledCoordinate;
use super::drives::{DistantLimits, Drive, DriveState, INFINITE};
use super::motion::Spring;
use super::*;
use crate::tree;

mod articulation;

const SPHERICAL: i32 = 3;

/// Numbers between -1 and 1.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn three(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.next())
    }

    fn list(&mut self, count: usize) -> Vec<f64> {
        (0..count).map(|_| self.next()).collect()
    }

    fn quaternion(&mut self) -> Turn<f64> {
        let turn = UnitQuaternion::new(self.three() * 2.0);
        Turn([turn.i, turn.j, turn.k, turn.w])
    }
}

fn vector(of: &Vector3<f64>) -> Vector<f64> {
    Vector::new(of.x, of.y, of.z)
}

fn three(of: &Vector<f64>) -> Vector3<f64> {
    Vector3::new(of.x, of.y, of.z)
}

fn matrix(of: &nalgebra::Matrix3<f64>) -> Matrix<f64> {
    let row = |i: usize| Vector::new(of[(i, 0)], of[(i, 1)], of[(i, 2)]);
    Matrix([row(0), row(1), row(2)])
}

/// Memory that is not given back.
struct Leaked;

impl<'a> Store<'a> for Leaked {
    fn take<T: 'a>(&mut self, count: usize, make: impl Fn() -> T) -> &'a mut [T] {
        Box::leak((0..count).map(|_| make()).collect())
    }
}

/// An articulation and what acts on it.
struct World {
    has_fixed_base: bool,
    links: Vec<Link>,
    bodies: Vec<Body<f64>>,
    of: Articulation<'static>,
    /// At the beginning of each step.
    drives: Vec<Drive>,
    driven: Vec<Driven<f64>>,
    /// Accelerations.
    found: [Vector<f64>; 2],
    accelerations: Vec<f64>,
}

const NO_DRIVE: Driven<f64> = Driven { inertia: 0.0, pull: 0.0, is_given: 0.0, given: 0.0, force: 0.0 };
/// Step, s.
const H: f64 = 1e-3;

impl World {
    /// With joints of these kinds; `shape` decides on the joints, `state` on the rest.
    fn new(kinds: &[i32], has_fixed_base: bool, shape: u64, state: u64) -> Self {
        Self::coupled(kinds, has_fixed_base, [shape, state], &[])
    }

    /// With an equation between rates.
    fn coupled(kinds: &[i32], has_fixed_base: bool, [shape, state]: [u64; 2], terms: &[(i32, f64)]) -> Self {
        let (mut coordinate, mut ball, mut numbers) = (0, 0, Numbers(shape));
        let mut link = |index: usize, kind: i32| {
            let (sliding, turning) = [(0, 0), (0, 1), (1, 0), (0, 3), (3, 3)][kind as usize];
            let axis = Unit::new_normalize(numbers.three());
            let rotation = UnitQuaternion::new(numbers.three() * 2.0).to_rotation_matrix();
            let turn = axis.cross_matrix() * rotation.matrix();
            let link = Link {
                parent: ((numbers.next() + 1.0) / 2.0 * (index + 1) as f64) as i32,
                kind,
                coordinate: if kind == FIXED { -1 } else { coordinate },
                sliding,
                turning,
                ball: if turning == 3 { ball } else { -1 },
                axis: vector(&axis),
                pivot: vector(&(numbers.three() * 0.5)),
                rotation: matrix(rotation.matrix()),
                arm: vector(&(numbers.three() * 0.5)),
                turn: matrix(&turn),
                turn2: matrix(&(axis.cross_matrix() * turn)),
            };
            coordinate += sliding + turning;
            ball += i32::from(turning == 3);
            link
        };
        let links: Vec<Link> = kinds.iter().enumerate().map(|(index, kind)| link(index, *kind)).collect();
        let (count, mut numbers) = (coordinate as usize, Numbers(state));
        let mut body = |index: usize| {
            let mass = 1.5 + numbers.next();
            Body {
                mass,
                inertia: vector(&(Vector3::repeat(0.5) + numbers.three() * 0.1)),
                linear_drag: 0.0,
                angular_drag: 0.0,
                force: if index == 0 && has_fixed_base { Vector::zero() } else { vector(&(GRAVITY * mass)) },
                torque: Vector::zero(),
            }
        };
        let bodies: Vec<Body<f64>> = (0..=links.len()).map(&mut body).collect();
        let terms: Vec<CoupledCoordinate> = terms.iter().map(|term| CoupledCoordinate::from(*term)).collect();
        let (ends, offsets) = if terms.is_empty() { (vec![], vec![]) } else { (vec![terms.len() as i32], vec![0.0]) };
        let plan = Plan {
            has_fixed_base,
            links: &links,
            bodies: &bodies,
            springs: count,
            terms: &terms,
            ends: &ends,
            offsets: &offsets,
            bounds: Bounds { return_speed: 1.0, return_rate: 5.0, limit_erp: 0.2 },
        };
        let mut of = Articulation::new(&mut Leaked, &plan);
        let (angular, linear) = (vector(&numbers.three()), vector(&numbers.three()));
        if !has_fixed_base {
            (of.rate.angular, of.rate.linear) = (angular, linear);
        }
        (of.position.rotation, of.position.origin) = (numbers.quaternion(), vector(&numbers.three()));
        of.position.q.copy_from_slice(&numbers.list(count));
        of.position.balls.fill_with(|| numbers.quaternion());
        of.rate.q.copy_from_slice(&numbers.list(count));
        of.motion.equations.forces.copy_from_slice(&numbers.list(count));
        Self {
            has_fixed_base,
            of,
            drives: Vec::new(),
            driven: vec![NO_DRIVE; count],
            found: [Vector::zero(); 2],
            accelerations: vec![f64::NAN; count],
            links,
            bodies,
        }
    }

    /// Adds motors, rigid and soft, springs and limits, some of which are reached.
    fn driven(mut self, seed: u64) -> Self {
        let mut numbers = Numbers(seed);
        for k in 0..self.driven.len() {
            let (softness, most) = ([0.0, 0.3, 0.0][k % 3], 2e-3 * (1.5 + numbers.next()));
            if k % 4 != 3 {
                self.drives.push(Drive::motor(k, numbers.next(), softness, most));
            }
            self.limit(k, [2e-3 * (1.0 + numbers.next()), 2e-3 * (1.0 + numbers.next())]);
            let spring = Spring {
                coordinate: k as i32,
                is_angle: true,
                offset: 0.1,
                stiffness: 2.0 + numbers.next(),
                damping: 0.02,
                rest: numbers.next(),
                ..Spring::none()
            };
            self.of.add_spring(spring, 1, false, [1.0, -1.0]);
        }
        self
    }

    fn limit(&mut self, coordinate: usize, [below, above]: [f64; 2]) {
        let limits = DistantLimits { below, above, ..DistantLimits::none(coordinate, true) };
        self.of.motion.equations.worlds[0].distant.push(limits);
    }

    fn rates(&mut self) -> &mut [f64] {
        self.of.rate.q
    }

    /// Accelerations with what `driven` says.
    fn accelerate(&mut self) {
        let (equations, mut out) =
            (&mut self.of.motion.equations, Rate { q: &mut self.accelerations, ..Rate::default() });
        let forces = Forces { efforts: equations.forces, driven: &mut self.driven };
        equations.tree.find_accelerations(Some(&self.of.position), &self.of.rate, forces, &mut out);
        self.found = [out.angular, out.linear];
    }

    /// Makes a step, alone or beside others.
    fn step(&mut self) {
        let drives = &mut self.of.motion.equations.worlds[0].drives;
        drives.clear();
        self.drives.iter().for_each(|drive| drives.push(*drive));
        let request = together::Request { articulation: &raw mut self.of, h: H };
        // SAFETY: nobody else uses the articulation.
        unsafe {
            if !together::wait(&request) {
                request.answer();
            }
        }
        self.of.position.copy(&self.of.free_position);
        self.of.rate.copy(&self.of.free_rate);
    }

    fn ended_drives(&self) -> &[Drive] {
        &self.of.motion.equations.worlds[0].drives
    }

    /// Kinetic energy, J, and momentum.
    fn conserved(&self) -> [f64; 7] {
        let tree = &self.of.motion.equations.tree;
        let momentum = tree.momentum(Vector::zero());
        let [a, b] = [momentum.linear, momentum.angular];
        [tree.kinetic_energy(), a.x, a.y, a.z, b.x, b.y, b.z]
    }

    /// Of the state.
    fn numbers(&self) -> Vec<f64> {
        let (at, rate) = (&self.of.position, &self.of.rate);
        let vectors = [at.origin, rate.angular, rate.linear];
        let vectors = vectors.iter().flat_map(|vector| [vector.x, vector.y, vector.z]);
        let turns = std::iter::once(&at.rotation).chain(&*at.balls).flat_map(|turn| turn.0);
        vectors.chain(turns).chain(at.q.iter().copied()).chain(rate.q.iter().copied()).collect()
    }

    /// Of the state, the drives, and the poses and velocities of the bodies.
    fn bits(&self) -> Vec<u64> {
        let tree = &self.of.motion.equations.tree;
        let placed = [&tree.origins, &tree.linear, &tree.angular, &tree.arms, &tree.axes];
        let placed = placed.into_iter().flat_map(|vectors| vectors.iter().copied());
        let placed = placed.chain(tree.rotations.iter().flat_map(|rotation| rotation.0));
        let numbers = self.numbers().into_iter().chain(self.ended_drives().iter().map(Drive::work));
        numbers.chain(placed.flat_map(|v| [v.x, v.y, v.z])).map(f64::to_bits).collect()
    }

    /// The same tree for inverse dynamics.
    fn tree(&self) -> tree::Tree {
        let link = |(link, body): (&Link, &Body<f64>)| {
            let rotation = UnitQuaternion::from_matrix(&nalgebra::Matrix3::from_rows(
                &link.rotation.0.map(|row| three(&row).transpose()),
            ));
            let coordinate = link.coordinate as usize;
            tree::Link {
                parent: link.parent as usize,
                motion: match link.kind {
                    REVOLUTE => tree::Motion::Revolute(coordinate),
                    PRISMATIC => tree::Motion::Prismatic(coordinate),
                    _ => tree::Motion::Fixed,
                },
                pivot: three(&link.pivot),
                axis: Unit::new_normalize(three(&link.axis)),
                rest: Isometry3::from_parts(Translation3::from(rotation * three(&link.arm)), rotation),
                mass: body.mass,
                inertia: three(&body.inertia),
                gravity: GRAVITY,
                limits: [f64::NEG_INFINITY, f64::INFINITY],
                armature: self.driven.get(coordinate).map_or(0.0, |driven| driven.inertia),
            }
        };
        let base = tree::Link::base(self.bodies[0].mass, three(&self.bodies[0].inertia), GRAVITY);
        let links = std::iter::once(base).chain(self.links.iter().zip(&self.bodies[1..]).map(link)).collect();
        tree::Tree::new(links, !self.has_fixed_base)
    }
}

const GRAVITY: Vector3<f64> = Vector3::new(0.3, -0.2, -9.81);

/// Forces that lead to the accelerations found, by the recursive Newton-Euler algorithm, are those that act.
#[test]
fn accelerations_are_those_of_newton_and_euler() {
    let kinds = [REVOLUTE, PRISMATIC, FIXED, REVOLUTE, REVOLUTE, PRISMATIC, FIXED, REVOLUTE];
    for seed in 0..20 {
        for has_fixed_base in [true, false] {
            let mut world = World::new(&kinds, has_fixed_base, seed, seed + 100);
            if seed % 2 == 1 {
                // Rotors: they add to the inertia and do nothing else.
                world.driven.iter_mut().for_each(|driven| driven.inertia = 0.3);
            }
            world.accelerate();
            let tree = world.tree();
            let Position { rotation: Turn([x, y, z, w]), origin, q, .. } = &world.of.position;
            let Rate { angular, linear, q: rates } = &world.of.rate;
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(*w, *x, *y, *z));
            let base = Isometry3::from_parts(Translation3::from(three(origin)), turn);
            let of_base = |linear: &Vector<f64>, angular: &Vector<f64>| match has_fixed_base {
                true => Vec::new(),
                false => [three(linear), three(angular)].iter().flat_map(|each| each.iter().copied()).collect(),
            };
            let rates = [of_base(linear, angular), rates.to_vec()].concat();
            let [angular, linear] = &world.found;
            let accelerations = [of_base(linear, angular), world.accelerations.clone()].concat();
            let forces = tree.posture(&base, q).inverse_dynamics(&rates, &accelerations);
            let wanted =
                [vec![0.0; if has_fixed_base { 0 } else { 6 }], world.of.motion.equations.forces.to_vec()].concat();
            for (force, wanted) in forces.iter().zip(wanted) {
                assert!(
                    (force - wanted).abs() < 1e-10,
                    "seed {seed}, fixed {has_fixed_base}: {force} N·m, not {wanted}"
                );
            }
        }
    }
}

/// A world has the same bits alone and beside others of any number, alike and not.
#[test]
fn worlds_beside_each_other_have_the_bits_of_worlds_alone() {
    let kinds = [REVOLUTE, SPHERICAL, FIXED, PRISMATIC, FREE, REVOLUTE, REVOLUTE];
    for count in 1..=6 {
        for has_fixed_base in [true, false] {
            for by_euler in [false, true] {
                let world = |index: u64| {
                    // One in five has other joints, one in three no drives, and one turns so fast that its steps are divided.
                    let mut world = World::new(&kinds, has_fixed_base, if index % 5 == 4 { 8 } else { 7 }, 30 + index);
                    world.of.motion.by_euler = by_euler;
                    if index == 3 {
                        world.rates().iter_mut().for_each(|rate| *rate *= 600.0);
                    }
                    world.of.place();
                    if index % 3 == 2 {
                        world
                    } else {
                        world.driven(index)
                    }
                };
                // Each makes as many steps as its number says.
                let steps = |world: &mut World, number: usize| (0..3 * number).for_each(|_| world.step());
                let [mut alone, mut beside]: [Vec<World>; 2] = [(); 2].map(|()| (0..count).map(world).collect());
                alone.iter_mut().zip(1..).for_each(|(world, number)| steps(world, number));
                let mut tasks: Vec<_> =
                    beside.iter_mut().zip(1..).map(|(world, number)| move || steps(world, number)).collect();
                together::run(&mut tasks.iter_mut().map(|task| task as &mut dyn FnMut()).collect::<Vec<_>>());
                drop(tasks);
                for (index, (alone, beside)) in alone.iter().zip(&beside).enumerate() {
                    assert_eq!(alone.bits(), beside.bits(), "world {index} of {count}");
                    assert!(alone.numbers().iter().all(|number| number.is_finite()));
                }
            }
        }
    }
}

#[test]
fn the_panic_of_a_world_is_passed_on_when_the_others_have_ended() {
    let kinds = [REVOLUTE, REVOLUTE];
    let mut worlds: Vec<World> = (0..3).map(|index| World::new(&kinds, true, 1, index)).collect();
    worlds.iter_mut().for_each(|world| world.of.place());
    let before: Vec<Vec<f64>> = worlds.iter().map(|world| world.numbers()).collect();
    let mut ends = 0;
    let [first, second, third] = &mut worlds[..] else { unreachable!() };
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let mut end = |world: &mut World| {
            world.step();
            ends += 1;
        };
        let ends = std::cell::RefCell::new(&mut end);
        let mut one = || ends.borrow_mut()(first);
        let mut other = || {
            second.step();
            panic!("a world");
        };
        let mut last = || {
            third.step();
            third.step();
        };
        together::run(&mut [&mut other, &mut one, &mut last]);
    }));
    assert_eq!(outcome.unwrap_err().downcast_ref::<&str>(), Some(&"a world"));
    assert_eq!(ends, 1);
    assert!(worlds.iter().zip(before).all(|(world, before)| world.numbers() != before));
}

/// Without forces a free tree keeps its energy and momentum, by the order of the method.
#[test]
fn a_free_tree_keeps_its_energy_and_momentum() {
    let kinds = [REVOLUTE, SPHERICAL, FIXED, PRISMATIC, REVOLUTE, REVOLUTE];
    for seed in 0..5 {
        let mut world = World::new(&kinds, false, seed, seed + 50);
        world.of.motion.equations.tree.bodies.iter_mut().for_each(|body| body.force = Vector::zero());
        world.of.motion.equations.forces.fill(0.0);
        world.of.place();
        let before = world.conserved();
        (0..1000).for_each(|_| world.step());
        for (before, after) in before.iter().zip(world.conserved()) {
            assert!((after - before).abs() < 1e-9 * (1.0 + before.abs()), "seed {seed}: {after}, not {before}");
        }
    }
}

/// A drive ends the step with target - softness * impulse, or gives all that it has.
#[test]
fn drives_reach_their_rates_or_bounds() {
    let kinds = [REVOLUTE, PRISMATIC, REVOLUTE, REVOLUTE];
    for (softness, most) in [(0.0, INFINITE), (0.5, INFINITE), (0.0, 1e-4), (0.5, 1e-4)] {
        let mut world = World::new(&kinds, true, 3, 4);
        world.of.place();
        world.drives.extend((0..4).map(|k| Drive::motor(k, 0.2, softness, most)));
        world.step();
        for (drive, rate) in world.ended_drives().iter().zip(&*world.of.rate.q) {
            let (impulse, state) = drive.mean();
            if most < INFINITE {
                assert!((impulse.abs() - most).abs() < 1e-15 && state != DriveState::Free, "{drive:?}");
            } else {
                assert!((rate - (0.2 - softness * impulse)).abs() < 1e-9, "{rate} rad/s, {drive:?}");
            }
        }
    }
}

/// A distant limit that a step passes becomes a drive, which stops the coordinate there.
#[test]
fn limits_stop_coordinates() {
    let mut world = World::new(&[REVOLUTE, REVOLUTE], true, 5, 6);
    world.rates().copy_from_slice(&[3.0, -3.0]);
    world.of.place();
    (0..2).for_each(|k| world.limit(k, [1e-3; 2]));
    let before = world.of.position.q.to_vec();
    world.step();
    assert_eq!(world.ended_drives().len(), 2);
    for ((after, before), side) in world.of.position.q.iter().zip(before).zip([1.0, -1.0]) {
        // The mean of the rates of the stages is not quite that of the ends.
        assert!((side * (after - before)) < 3e-3 && side * (after - before) > 0.9e-3, "{} rad", after - before);
    }
    assert!(world.rates().iter().zip([1.0, -1.0]).all(|(rate, side)| (side * rate - 1.0).abs() < 1e-9));
}

/// Coupled coordinates keep the equation between their rates.
#[test]
fn coupled_rates_keep_their_equation() {
    let terms = [(2, 1.0), (0, -0.5), (1, 0.25)];
    let mut world = World::coupled(&[REVOLUTE, REVOLUTE, PRISMATIC], true, [9, 10], &terms);
    let rates = world.rates();
    rates[2] = 0.5 * rates[0] - 0.25 * rates[1];
    world.of.place();
    for _ in 0..100 {
        world.step();
        let rates = world.rates();
        assert!((rates[2] - 0.5 * rates[0] + 0.25 * rates[1]).abs() < 1e-12, "{rates:?}");
    }
}
