use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use super::ffi::{table, AmbAbaMotion, AmbAbaRates, AmbAbaTree};
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

    fn quaternion(&mut self) -> [f64; 4] {
        let turn = UnitQuaternion::new(self.three() * 2.0);
        [turn.i, turn.j, turn.k, turn.w]
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

/// A tree with its memory, a state and what acts on it.
#[derive(Clone)]
struct World {
    has_fixed_base: bool,
    links: Vec<Link>,
    bodies: Vec<Body<f64>>,
    vectors: [Vec<Vector<f64>>; 5],
    rotations: Vec<Matrix<f64>>,
    work: Vec<Work<f64>>,
    rotation: [f64; 4],
    origin: Vector<f64>,
    q: Vec<f64>,
    balls: Vec<[f64; 4]>,
    angular: Vector<f64>,
    linear: Vector<f64>,
    rates: Vec<f64>,
    efforts: Vec<f64>,
    drives: Vec<Drive<f64>>,
    found: [Vector<f64>; 2],
    accelerations: Vec<f64>,
}

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
        let still = Vector::zero();
        let (angular, linear) = (vector(&numbers.three()), vector(&numbers.three()));
        Self {
            has_fixed_base,
            vectors: std::array::from_fn(|_| vec![Vector::zero(); bodies.len()]),
            rotations: vec![Matrix([Vector::zero(); 3]); bodies.len()],
            work: vec![Work::zero(); bodies.len()],
            rotation: numbers.quaternion(),
            origin: vector(&numbers.three()),
            q: numbers.list(count),
            balls: (0..balls).map(|_| numbers.quaternion()).collect(),
            angular: if has_fixed_base { still } else { angular },
            linear: if has_fixed_base { still } else { linear },
            rates: numbers.list(count),
            efforts: numbers.list(count),
            drives: Vec::new(),
            found: [still; 2],
            accelerations: vec![f64::NAN; count],
            links,
            bodies,
        }
    }

    /// Adds drives of all kinds.
    fn driven(mut self, seed: u64) -> Self {
        let mut numbers = Numbers(seed);
        let mut drive = |k: usize| Drive {
            inertia: if k.is_multiple_of(3) { 0.5 + 0.4 * numbers.next() } else { 0.0 },
            pull: if k.is_multiple_of(3) { numbers.next() } else { 0.0 },
            is_given: if k % 3 == 1 && numbers.next() > 0.0 { 1.0 } else { 0.0 },
            given: numbers.next(),
            force: f64::NAN,
        };
        self.drives = (0..self.q.len()).map(&mut drive).collect();
        self
    }

    fn accelerate(&mut self) {
        let [origins, linear, angular, arms, axes] = self.vectors.each_mut().map(Vec::as_mut_ptr);
        let all = AmbAbaTree {
            links: self.links.len() as i32,
            coordinates: self.q.len() as i32,
            balls: self.balls.len() as i32,
            has_fixed_base: self.has_fixed_base.into(),
            splits_damping: 0,
            link: self.links.as_ptr(),
            body: self.bodies.as_ptr(),
            rotations: self.rotations.as_mut_ptr(),
            origins,
            linear,
            angular,
            arms,
            axes,
            work: self.work.as_mut_ptr(),
        };
        let motion = AmbAbaMotion {
            rotation: &raw const self.rotation,
            origin: &raw const self.origin,
            q: self.q.as_ptr(),
            balls: self.balls.as_ptr(),
            angular: &raw const self.angular,
            linear: &raw const self.linear,
            rates: self.rates.as_ptr(),
        };
        let [angular, linear] = self.found.each_mut().map(std::ptr::from_mut);
        let out = AmbAbaRates { angular, linear, q: self.accelerations.as_mut_ptr() };
        let drives = if self.drives.is_empty() { std::ptr::null_mut() } else { self.drives.as_mut_ptr() };
        // SAFETY: all arrays have as many elements as the tree needs, and nobody else uses them.
        unsafe {
            (table().accelerate)(&raw const all, &raw const motion, self.efforts.as_ptr(), drives, 0, &raw const out)
        }
    }

    fn bits(&self) -> Vec<u64> {
        let base = self.found.iter().flat_map(|found| [found.x, found.y, found.z]);
        let numbers = base.chain(self.accelerations.iter().copied()).chain(self.drives.iter().map(|drive| drive.force));
        numbers.map(f64::to_bits).collect()
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
                armature: self.drives.get(coordinate).map_or(0.0, |drive| drive.inertia),
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
                let rotor = |_| Drive { inertia: 0.3, pull: 0.0, is_given: 0.0, given: 0.0, force: 0.0 };
                world.drives = (0..world.q.len()).map(rotor).collect();
            }
            world.accelerate();
            let tree = world.tree();
            let [x, y, z, w] = world.rotation;
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            let base = Isometry3::from_parts(Translation3::from(three(&world.origin)), turn);
            let of_base = |linear: &Vector<f64>, angular: &Vector<f64>| match has_fixed_base {
                true => Vec::new(),
                false => [three(linear), three(angular)].iter().flat_map(|each| each.iter().copied()).collect(),
            };
            let rates = [of_base(&world.linear, &world.angular), world.rates.clone()].concat();
            let [angular, linear] = &world.found;
            let accelerations = [of_base(linear, angular), world.accelerations.clone()].concat();
            let forces = tree.posture(&base, &world.q).inverse_dynamics(&rates, &accelerations);
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
            let world = |index: u64| {
                // One in five has other joints, one in three no drives.
                let world = World::new(&kinds, has_fixed_base, if index % 5 == 4 { 8 } else { 7 }, 30 + index);
                if index % 3 == 2 {
                    world
                } else {
                    world.driven(index)
                }
            };
            let mut alone: Vec<World> = (0..count).map(world).collect();
            let mut beside = alone.clone();
            alone.iter_mut().for_each(World::accelerate);
            // Each evaluates as often as its number says.
            let mut number = 0;
            let mut tasks: Vec<_> = beside
                .iter_mut()
                .map(|world| {
                    number += 1;
                    move || (0..number).for_each(|_| world.accelerate())
                })
                .collect();
            together::run(&mut tasks.iter_mut().map(|task| task as &mut dyn FnMut()).collect::<Vec<_>>());
            drop(tasks);
            for (alone, beside) in alone.iter().zip(&beside) {
                assert_eq!(alone.bits(), beside.bits());
                assert!(alone.accelerations.iter().all(|number| number.is_finite()));
            }
        }
    }
}

#[test]
fn the_panic_of_a_world_is_passed_on_when_the_others_have_ended() {
    let kinds = [REVOLUTE, REVOLUTE];
    let mut worlds: Vec<World> = (0..3).map(|index| World::new(&kinds, true, 1, index)).collect();
    let mut ends = 0;
    let [first, second, third] = &mut worlds[..] else { unreachable!() };
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let mut end = |world: &mut World| {
            world.accelerate();
            ends += 1;
        };
        let ends = std::cell::RefCell::new(&mut end);
        let mut one = || ends.borrow_mut()(first);
        let mut other = || {
            second.accelerate();
            panic!("a world");
        };
        let mut last = || {
            third.accelerate();
            third.accelerate();
        };
        together::run(&mut [&mut other, &mut one, &mut last]);
    }));
    assert_eq!(outcome.unwrap_err().downcast_ref::<&str>(), Some(&"a world"));
    assert_eq!(ends, 1);
    assert!(worlds.iter().all(|world| world.accelerations.iter().all(|number| number.is_finite())));
}
