//! Accelerations of four trees in the registers of AVX2.

use super::algebra::{Matrix, Vector};
use super::ffi::part;
use super::four::Four;
use super::scalar::Scalar;
use super::together::{Request, SIDE_BY_SIDE};
use super::{Body, Drive, Link, Position, Rate, Tree, Work};

/// Memory of the trees that are computed side by side, and which of them are alike.
#[derive(Default)]
pub struct Beside {
    bodies: Vec<Body<Four>>,
    rotations: Vec<Matrix<Four>>,
    vectors: [Vec<Vector<Four>>; 5],
    work: Vec<Work<Four>>,
    q: Vec<Four>,
    rates: Vec<Four>,
    balls: Vec<[Four; 4]>,
    efforts: Vec<Four>,
    drives: Vec<Drive<Four>>,
    out: Vec<Four>,
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
    /// The processor has AVX2; the requests are of different trees and as the table of the interface says.
    pub unsafe fn answer(&mut self, mut requests: &[Request]) {
        while let Some((first, others)) = requests.split_first() {
            // SAFETY: by the contract of this function.
            unsafe {
                let alike =
                    others.iter().take(SIDE_BY_SIDE - 1).take_while(|other| self.are_alike(first, other)).count();
                if alike == 0 {
                    first.answer(false);
                } else {
                    self.answer_alike(&requests[..=alike]);
                }
                requests = &requests[alike + 1..];
            }
        }
    }

    /// Whether two trees have the same joints.
    ///
    /// # Safety
    /// The requests are as the table says.
    unsafe fn are_alike(&mut self, a: &Request, b: &Request) -> bool {
        let (a, b) = (&a.tree, &b.tree);
        let flags = |tree: &super::ffi::AmbAbaTree| {
            [tree.links, tree.coordinates, tree.balls, tree.has_fixed_base, tree.splits_damping]
        };
        if flags(a) != flags(b) {
            return false;
        }
        let pair = [a.link, b.link];
        if self.equal.contains(&pair) {
            return true;
        }
        // SAFETY: there are so many links.
        let (links, others) = unsafe { (part(a.link, a.links as usize), part(b.link, b.links as usize)) };
        let are_equal = links.iter().zip(others).all(|(link, other)| link.is_equal(other));
        if are_equal {
            self.equal.push(pair);
        }
        are_equal
    }

    /// Computes the accelerations of two to four trees that are alike.
    ///
    /// # Safety
    /// As of [`answer`](Self::answer).
    #[target_feature(enable = "avx2")]
    unsafe fn answer_alike(&mut self, requests: &[Request]) {
        // Where there are fewer than four, the first is computed several times.
        let worlds: [&Request; SIDE_BY_SIDE] = std::array::from_fn(|world| requests.get(world).unwrap_or(&requests[0]));
        let tree = &requests[0].tree;
        let (bodies, coordinates, balls) = (tree.links as usize + 1, tree.coordinates as usize, tree.balls as usize);
        self.resize(bodies, coordinates, balls);
        // SAFETY: there are so many elements, by the contract of the table.
        let (position, rate, links) = unsafe {
            for i in 0..bodies {
                self.bodies[i] = body(worlds, i);
            }
            for k in 0..coordinates {
                self.q[k] = number(worlds, |world| *world.motion.q.add(k));
                self.rates[k] = number(worlds, |world| *world.motion.rates.add(k));
                self.efforts[k] = number(worlds, |world| *world.efforts.add(k));
                let drive = |world: &Request| world.drives.cast_const().wrapping_add(k);
                let of_drive = |world: &Request, read: fn(&Drive<f64>) -> f64| {
                    if world.drives.is_null() {
                        0.0
                    } else {
                        read(&*drive(world))
                    }
                };
                self.drives[k] = Drive {
                    inertia: number(worlds, |world| of_drive(world, |drive| drive.inertia)),
                    pull: number(worlds, |world| of_drive(world, |drive| drive.pull)),
                    is_given: number(worlds, |world| of_drive(world, |drive| drive.is_given)),
                    given: number(worlds, |world| of_drive(world, |drive| drive.given)),
                    force: Four::splat(0.0),
                };
            }
            for k in 0..balls {
                self.balls[k] = quaternion(worlds, |world| *world.motion.balls.add(k));
            }
            let position = Position {
                rotation: quaternion(worlds, |world| *world.motion.rotation),
                origin: vector(worlds, |world| &*world.motion.origin),
                q: &self.q,
                balls: &self.balls,
            };
            let rate = Rate {
                angular: vector(worlds, |world| &*world.motion.angular),
                linear: vector(worlds, |world| &*world.motion.linear),
                q: &self.rates,
            };
            (position, rate, part(tree.link, bodies - 1))
        };
        let [origins, linear, angular, arms, axes] = &mut self.vectors;
        let mut side_by_side = Tree {
            has_fixed_base: tree.has_fixed_base != 0,
            splits_damping: tree.splits_damping != 0,
            links,
            bodies: &self.bodies,
            rotations: &mut self.rotations,
            origins,
            linear,
            angular,
            arms,
            axes,
            work: &mut self.work,
        };
        side_by_side.update_poses(&position);
        side_by_side.update_velocities(&rate);
        let [angular, linear] = side_by_side.accelerate(&self.efforts, &mut self.drives, &mut self.out);
        let (angular, linear) = (components(angular), components(linear));
        for (world, request) in requests.iter().enumerate() {
            let of_world = |of: [[f64; SIDE_BY_SIDE]; 3]| Vector::new(of[0][world], of[1][world], of[2][world]);
            // SAFETY: as above.
            unsafe {
                *request.out.angular = of_world(angular);
                *request.out.linear = of_world(linear);
                for k in 0..coordinates {
                    *request.out.q.add(k) = self.out[k].numbers()[world];
                    if !request.drives.is_null() {
                        (*request.drives.add(k)).force = self.drives[k].force.numbers()[world];
                    }
                }
            }
        }
    }

    #[target_feature(enable = "avx2")]
    fn resize(&mut self, bodies: usize, coordinates: usize, balls: usize) {
        let zero = Four::splat(0.0);
        let vector = Vector::<Four>::zero();
        let drive = Drive { inertia: zero, pull: zero, is_given: zero, given: zero, force: zero };
        let body =
            Body { mass: zero, inertia: vector, linear_drag: zero, angular_drag: zero, force: vector, torque: vector };
        self.bodies.resize(bodies, body);
        self.rotations.resize(bodies, Matrix([vector; 3]));
        self.vectors.iter_mut().for_each(|each| each.resize(bodies, vector));
        self.work.resize(bodies, Work::zero());
        for numbers in [&mut self.q, &mut self.rates, &mut self.efforts, &mut self.out] {
            numbers.resize(coordinates, zero);
        }
        self.drives.resize(coordinates, drive);
        self.balls.resize(balls, [zero; 4]);
    }
}

/// One number of each world.
#[inline(always)]
fn number(worlds: [&Request; SIDE_BY_SIDE], read: impl Fn(&Request) -> f64) -> Four {
    Four::new([read(worlds[0]), read(worlds[1]), read(worlds[2]), read(worlds[3])])
}

#[inline(always)]
fn vector<'a>(worlds: [&'a Request; SIDE_BY_SIDE], read: impl Fn(&'a Request) -> &'a Vector<f64>) -> Vector<Four> {
    let [a, b, c, d] = [read(worlds[0]), read(worlds[1]), read(worlds[2]), read(worlds[3])];
    Vector::new(Four::new([a.x, b.x, c.x, d.x]), Four::new([a.y, b.y, c.y, d.y]), Four::new([a.z, b.z, c.z, d.z]))
}

#[inline(always)]
fn quaternion(worlds: [&Request; SIDE_BY_SIDE], read: impl Fn(&Request) -> [f64; 4]) -> [Four; 4] {
    let [a, b, c, d] = [read(worlds[0]), read(worlds[1]), read(worlds[2]), read(worlds[3])];
    [
        Four::new([a[0], b[0], c[0], d[0]]),
        Four::new([a[1], b[1], c[1], d[1]]),
        Four::new([a[2], b[2], c[2], d[2]]),
        Four::new([a[3], b[3], c[3], d[3]]),
    ]
}

/// Body `i` of each world.
///
/// # Safety
/// Each tree has it.
#[inline(always)]
unsafe fn body(worlds: [&Request; SIDE_BY_SIDE], i: usize) -> Body<Four> {
    // SAFETY: by the contract of this function.
    let of = |world: usize| unsafe { &*worlds[world].tree.body.add(i) };
    let [a, b, c, d] = [of(0), of(1), of(2), of(3)];
    let vector = |a: &Vector<f64>, b: &Vector<f64>, c: &Vector<f64>, d: &Vector<f64>| {
        [[a.x, b.x, c.x, d.x], [a.y, b.y, c.y, d.y], [a.z, b.z, c.z, d.z]]
    };
    let inertia = vector(&a.inertia, &b.inertia, &c.inertia, &d.inertia);
    let force = vector(&a.force, &b.force, &c.force, &d.force);
    let torque = vector(&a.torque, &b.torque, &c.torque, &d.torque);
    Body {
        mass: Four::new([a.mass, b.mass, c.mass, d.mass]),
        inertia: Vector::new(Four::new(inertia[0]), Four::new(inertia[1]), Four::new(inertia[2])),
        linear_drag: Four::new([a.linear_drag, b.linear_drag, c.linear_drag, d.linear_drag]),
        angular_drag: Four::new([a.angular_drag, b.angular_drag, c.angular_drag, d.angular_drag]),
        force: Vector::new(Four::new(force[0]), Four::new(force[1]), Four::new(force[2])),
        torque: Vector::new(Four::new(torque[0]), Four::new(torque[1]), Four::new(torque[2])),
    }
}

#[inline(always)]
fn components(of: Vector<Four>) -> [[f64; SIDE_BY_SIDE]; 3] {
    [of.x.numbers(), of.y.numbers(), of.z.numbers()]
}
