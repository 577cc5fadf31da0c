use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use super::algebra::Quaternion as Turn;
use super::coupling::CoupledCoordinate;
use super::drives::{DistantLimits, Drive, DriveState, INFINITE};
use super::ffi::{table, AmbAbaPosition, AmbAbaRates, AmbAbaState, AmbAbaTree};
use super::motion::{Spring, Start, NUMBERS, QUATERNIONS, VECTORS};
use super::*;
use crate::tree;

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

/// Position and rates of a tree.
#[derive(Clone)]
struct State {
    rotation: Turn<f64>,
    origin: Vector<f64>,
    q: Vec<f64>,
    balls: Vec<Turn<f64>>,
    angular: Vector<f64>,
    linear: Vector<f64>,
    rates: Vec<f64>,
}

impl State {
    fn raw(&mut self) -> (AmbAbaPosition, AmbAbaRates) {
        let (q, balls) = (self.q.as_mut_ptr(), self.balls.as_mut_ptr());
        let position = AmbAbaPosition { rotation: &raw mut self.rotation, origin: &raw mut self.origin, q, balls };
        let (angular, linear) = (&raw mut self.angular, &raw mut self.linear);
        (position, AmbAbaRates { angular, linear, q: self.rates.as_mut_ptr() })
    }

    fn numbers(&self) -> Vec<f64> {
        let vectors = [self.origin, self.angular, self.linear];
        let vectors = vectors.iter().flat_map(|vector| [vector.x, vector.y, vector.z]);
        let turns = std::iter::once(&self.rotation).chain(&self.balls).flat_map(|turn| turn.0);
        vectors.chain(turns).chain(self.q.iter().copied()).chain(self.rates.iter().copied()).collect()
    }
}

/// A tree with its memory, a state and what acts on it.
#[derive(Clone)]
struct World {
    has_fixed_base: bool,
    links: Vec<Link>,
    bodies: Vec<Body<f64>>,
    placed: [Vec<Vector<f64>>; 5],
    rotations: Vec<Matrix<f64>>,
    work: Vec<Work<f64>>,
    state: State,
    end: State,
    springs: Vec<Spring<f64>>,
    coupled: Vec<CoupledCoordinate>,
    coupling_ends: Vec<i32>,
    parents: Vec<i32>,
    factor: Vec<f64>,
    rows: Vec<f64>,
    drives: Vec<Drive>,
    drive_count: i32,
    distant: Vec<DistantLimits>,
    driven: Vec<Driven<f64>>,
    given_by: Vec<i32>,
    numbers: Vec<f64>,
    vectors: Vec<Vector<f64>>,
    turns: Vec<Turn<f64>>,
    /// Forces on the coordinates, and a memory beside.
    efforts: Vec<f64>,
    rest: Vec<f64>,
    kept: AmbAbaState,
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
        let (count, balls, mut numbers) = (coordinate as usize, ball as usize, Numbers(state));
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
        let (still, n) = (Vector::zero(), count + 6);
        let (angular, linear) = (vector(&numbers.three()), vector(&numbers.three()));
        let state = State {
            rotation: numbers.quaternion(),
            origin: vector(&numbers.three()),
            q: numbers.list(count),
            balls: (0..balls).map(|_| numbers.quaternion()).collect(),
            angular: if has_fixed_base { still } else { angular },
            linear: if has_fixed_base { still } else { linear },
            rates: numbers.list(count),
        };
        let mut parents: Vec<i32> = (0..n as i32).map(|k| k - 1).collect();
        for link in links.iter().filter(|link| link.coordinate >= 0) {
            let mut parent = link.parent();
            while parent > 0 && links[parent - 1].coordinate < 0 {
                parent = links[parent - 1].parent();
            }
            parents[6 + link.coordinate()] = match parent {
                0 if has_fixed_base => -1,
                0 => 5,
                _ => (5 + links[parent - 1].coordinate() + links[parent - 1].freedoms()) as i32,
            };
        }
        let zero = Start {
            energy: 0.0,
            elastic_energy: 0.0,
            rotation: 0.0,
            carrying_power: 0.0,
            centrifugal_energy: 0.0,
            stiffness: 0.0,
        };
        Self {
            has_fixed_base,
            placed: std::array::from_fn(|_| vec![Vector::zero(); bodies.len()]),
            rotations: vec![Matrix([Vector::zero(); 3]); bodies.len()],
            work: vec![Work::zero(); bodies.len()],
            end: state.clone(),
            state,
            springs: Vec::new(),
            coupled: Vec::new(),
            coupling_ends: Vec::new(),
            parents,
            factor: vec![0.0; n * n],
            rows: vec![0.0; 5 * n],
            drives: vec![drive(0, 0.0, 0.0, 0.0); 8 * count],
            drive_count: 0,
            distant: Vec::new(),
            driven: vec![NO_DRIVE; 2 * count],
            given_by: vec![-1; count],
            numbers: vec![0.0; NUMBERS * count],
            vectors: vec![still; VECTORS * bodies.len()],
            turns: vec![Turn::identity(); QUATERNIONS * balls],
            efforts: numbers.list(count),
            rest: vec![0.0; count],
            kept: AmbAbaState {
                start: zero,
                start_angular: still,
                start_linear: still,
                steps_until_probe: 0,
                has_mode: 0,
                splits_damping: 0,
                by_euler: 0,
                coupling_rows: 0,
                has_subspaces: 0,
            },
            found: [still; 2],
            accelerations: vec![f64::NAN; count],
            links,
            bodies,
        }
    }

    /// Adds motors, rigid and soft, springs and limits, some of which are reached.
    fn driven(mut self, seed: u64) -> Self {
        let mut numbers = Numbers(seed);
        for k in 0..self.state.q.len() {
            let (softness, most) = ([0.0, 0.3, 0.0][k % 3], 2e-3 * (1.5 + numbers.next()));
            if k % 4 != 3 {
                self.add_drive(drive(k as i32, numbers.next(), softness, most));
            }
            self.distant.push(DistantLimits {
                coordinate: k as i32,
                is_angle: true,
                below: 2e-3 * (1.0 + numbers.next()),
                above: 2e-3 * (1.0 + numbers.next()),
                backward: INFINITE,
                forward: INFINITE,
            });
            self.springs.push(Spring {
                coordinate: k as i32,
                is_angle: true,
                sign: 1.0,
                offset: 0.1,
                stiffness: 2.0 + numbers.next(),
                damping: 0.02,
                rest: numbers.next(),
                is_stiff: false,
                resists_corrections: false,
                settles_in_a_step: false,
            });
        }
        self
    }

    fn add_drive(&mut self, drive: Drive) {
        self.drives[self.drive_count as usize] = drive;
        self.drive_count += 1;
    }

    fn tree_in_c(&mut self) -> AmbAbaTree {
        let n = self.state.q.len() + 6;
        let [origins, linear, angular, arms, axes] = self.placed.each_mut().map(Vec::as_mut_ptr);
        let (inverse_diagonal, rows) = self.rows.split_at_mut(n);
        let (coupling_row, rows) = rows.split_at_mut(2 * n);
        AmbAbaTree {
            links: self.links.len() as i32,
            coordinates: self.state.q.len() as i32,
            balls: self.state.balls.len() as i32,
            has_fixed_base: self.has_fixed_base.into(),
            springs: self.springs.len() as i32,
            couplings: self.coupling_ends.len() as i32,
            distant_limits: self.distant.len() as i32,
            drive_places: self.drives.len() as i32,
            link: self.links.as_ptr(),
            body: self.bodies.as_ptr(),
            rotations: self.rotations.as_mut_ptr(),
            origins,
            linear,
            angular,
            arms,
            axes,
            work: self.work.as_mut_ptr(),
            spring: self.springs.as_ptr(),
            coupled: self.coupled.as_ptr(),
            coupling_ends: self.coupling_ends.as_ptr(),
            parents: self.parents.as_ptr(),
            factor: self.factor.as_mut_ptr(),
            inverse_diagonal: inverse_diagonal.as_mut_ptr(),
            coupling_row: coupling_row.as_mut_ptr(),
            rows: rows.as_mut_ptr(),
            drive: self.drives.as_mut_ptr(),
            drives: &raw mut self.drive_count,
            distant: self.distant.as_ptr(),
            driven: self.driven.as_mut_ptr(),
            given_by: self.given_by.as_mut_ptr(),
            rest: self.rest.as_mut_ptr(),
            forces: self.efforts.as_mut_ptr(),
            numbers: self.numbers.as_mut_ptr(),
            vectors: self.vectors.as_mut_ptr(),
            quaternions: self.turns.as_mut_ptr(),
            state: &raw mut self.kept,
        }
    }

    /// Accelerations with what `driven` says.
    fn accelerate(&mut self) {
        let mut driven = std::mem::take(&mut self.driven);
        let (efforts, all) = (self.efforts.clone(), self.tree_in_c());
        let (at, rate) = self.state.raw();
        let mut out = Rate { q: &mut self.accelerations, ..Rate::default() };
        // SAFETY: all arrays have as many elements as the tree needs, and nobody else uses them.
        unsafe {
            let (at, rate) = (at.position(&all), rate.rate(&all));
            let forces = Forces { efforts: &efforts, driven: &mut driven[..efforts.len()] };
            all.tree().find_accelerations(Some(&at), &rate, forces, &mut out);
        }
        self.found = [out.angular, out.linear];
        self.driven = driven;
    }

    fn place(&mut self) {
        let all = self.tree_in_c();
        let (at, rate) = self.state.raw();
        // SAFETY: as above.
        unsafe {
            (table().update_poses)(&raw const all, &raw const at);
            (table().update_velocities)(&raw const all, &raw const rate);
        }
    }

    /// Makes a step. Its drives are the first `drives`.
    fn step(&mut self, drives: i32) {
        self.drive_count = drives;
        let all = self.tree_in_c();
        let ((from, rate), (to, new_rate)) = (self.state.raw(), self.end.raw());
        // SAFETY: as above.
        unsafe {
            let (from, rate) = (&raw const from, &raw const rate);
            (table().step)(&raw const all, H, from, rate, &raw const to, &raw const new_rate);
        }
        std::mem::swap(&mut self.state, &mut self.end);
    }

    /// Kinetic energy, J, and momentum.
    fn conserved(&mut self) -> [f64; 7] {
        let all = self.tree_in_c();
        // SAFETY: as above.
        let tree = unsafe { all.tree() };
        let momentum = tree.momentum(Vector::zero());
        let [a, b] = [momentum.linear, momentum.angular];
        [tree.kinetic_energy(), a.x, a.y, a.z, b.x, b.y, b.z]
    }

    /// Of the state, the drives, and the poses and velocities of the bodies.
    fn bits(&self) -> Vec<u64> {
        let drives = self.drives[..self.drive_count as usize].iter();
        let placed = self.placed.iter().flatten().copied().chain(self.rotations.iter().flat_map(|rotation| rotation.0));
        let numbers = self.state.numbers().into_iter().chain(drives.map(Drive::work));
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

/// A motor of at most this impulse, N·m·s or N·s, either way.
fn drive(coordinate: i32, target: f64, softness: f64, most: f64) -> Drive {
    Drive::motor(coordinate, target, softness, most)
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
            let State { rotation: Turn([x, y, z, w]), origin, q, angular, linear, rates, .. } = &world.state;
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(*w, *x, *y, *z));
            let base = Isometry3::from_parts(Translation3::from(three(origin)), turn);
            let of_base = |linear: &Vector<f64>, angular: &Vector<f64>| match has_fixed_base {
                true => Vec::new(),
                false => [three(linear), three(angular)].iter().flat_map(|each| each.iter().copied()).collect(),
            };
            let rates = [of_base(linear, angular), rates.clone()].concat();
            let [angular, linear] = &world.found;
            let accelerations = [of_base(linear, angular), world.accelerations.clone()].concat();
            let forces = tree.posture(&base, q).inverse_dynamics(&rates, &accelerations);
            let wanted = [vec![0.0; if has_fixed_base { 0 } else { 6 }], world.efforts.clone()].concat();
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
            for by_euler in [0, 1] {
                let world = |index: u64| {
                    // One in five has other joints, one in three no drives, and one turns so fast that its steps are divided.
                    let mut world = World::new(&kinds, has_fixed_base, if index % 5 == 4 { 8 } else { 7 }, 30 + index);
                    world.kept.by_euler = by_euler;
                    if index == 3 {
                        world.state.rates.iter_mut().for_each(|rate| *rate *= 600.0);
                    }
                    world.place();
                    if index % 3 == 2 {
                        world
                    } else {
                        world.driven(index)
                    }
                };
                // Each makes as many steps as its number says.
                let steps = |world: &mut World, number: usize| {
                    let drives = world.drive_count;
                    (0..3 * number).for_each(|_| world.step(drives));
                };
                let mut alone: Vec<World> = (0..count).map(world).collect();
                let mut beside = alone.clone();
                alone.iter_mut().zip(1..).for_each(|(world, number)| steps(world, number));
                let mut tasks: Vec<_> =
                    beside.iter_mut().zip(1..).map(|(world, number)| move || steps(world, number)).collect();
                together::run(&mut tasks.iter_mut().map(|task| task as &mut dyn FnMut()).collect::<Vec<_>>());
                drop(tasks);
                for (index, (alone, beside)) in alone.iter().zip(&beside).enumerate() {
                    assert_eq!(alone.bits(), beside.bits(), "world {index} of {count}");
                    assert!(alone.state.numbers().iter().all(|number| number.is_finite()));
                }
            }
        }
    }
}

#[test]
fn the_panic_of_a_world_is_passed_on_when_the_others_have_ended() {
    let kinds = [REVOLUTE, REVOLUTE];
    let mut worlds: Vec<World> = (0..3).map(|index| World::new(&kinds, true, 1, index)).collect();
    worlds.iter_mut().for_each(World::place);
    let before: Vec<Vec<f64>> = worlds.iter().map(|world| world.state.numbers()).collect();
    let mut ends = 0;
    let [first, second, third] = &mut worlds[..] else { unreachable!() };
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let mut end = |world: &mut World| {
            world.step(0);
            ends += 1;
        };
        let ends = std::cell::RefCell::new(&mut end);
        let mut one = || ends.borrow_mut()(first);
        let mut other = || {
            second.step(0);
            panic!("a world");
        };
        let mut last = || {
            third.step(0);
            third.step(0);
        };
        together::run(&mut [&mut other, &mut one, &mut last]);
    }));
    assert_eq!(outcome.unwrap_err().downcast_ref::<&str>(), Some(&"a world"));
    assert_eq!(ends, 1);
    assert!(worlds.iter().zip(before).all(|(world, before)| world.state.numbers() != before));
}

/// Without forces a free tree keeps its energy and momentum, by the order of the method.
#[test]
fn a_free_tree_keeps_its_energy_and_momentum() {
    let kinds = [REVOLUTE, SPHERICAL, FIXED, PRISMATIC, REVOLUTE, REVOLUTE];
    for seed in 0..5 {
        let mut world = World::new(&kinds, false, seed, seed + 50);
        world.bodies.iter_mut().for_each(|body| body.force = Vector::zero());
        world.efforts.fill(0.0);
        world.place();
        let before = world.conserved();
        (0..1000).for_each(|_| world.step(0));
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
        world.place();
        for k in 0..4 {
            world.add_drive(drive(k, 0.2, softness, most));
        }
        world.step(4);
        for (drive, rate) in world.drives.iter().zip(&world.state.rates) {
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
    world.state.rates = vec![3.0, -3.0];
    world.place();
    for coordinate in 0..2 {
        let (is_angle, below, above, backward, forward) = (true, 1e-3, 1e-3, INFINITE, INFINITE);
        world.distant.push(DistantLimits { coordinate, is_angle, below, above, backward, forward });
    }
    let before = world.state.q.clone();
    world.step(0);
    assert_eq!(world.drive_count, 2);
    for ((after, before), side) in world.state.q.iter().zip(before).zip([1.0, -1.0]) {
        // The mean of the rates of the stages is not quite that of the ends.
        assert!((side * (after - before)) < 3e-3 && side * (after - before) > 0.9e-3, "{} rad", after - before);
    }
    assert!(world.state.rates.iter().zip([1.0, -1.0]).all(|(rate, side)| (side * rate - 1.0).abs() < 1e-9));
}

/// Coupled coordinates keep the equation between their rates.
#[test]
fn coupled_rates_keep_their_equation() {
    let mut world = World::new(&[REVOLUTE, REVOLUTE, PRISMATIC], true, 9, 10);
    world.coupled = [(2, 1.0), (0, -0.5), (1, 0.25)].map(CoupledCoordinate::from).to_vec();
    world.coupling_ends = vec![3];
    let rates = &mut world.state.rates;
    rates[2] = 0.5 * rates[0] - 0.25 * rates[1];
    world.place();
    for _ in 0..100 {
        world.step(0);
        let rates = &world.state.rates;
        assert!((rates[2] - 0.5 * rates[0] + 0.25 * rates[1]).abs() < 1e-12, "{rates:?}");
    }
}
