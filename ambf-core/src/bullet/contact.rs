use bullet_sys as sys;
use nalgebra::Vector3;
use slotmap::{Key, KeyData, SecondaryMap};

use super::{BodyHandle, World};

/// A contact point between two bodies, which may have a positive distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The other body.
    pub other: BodyHandle,
    /// Point on the surface of the queried body, m, world axes.
    pub point: Vector3<f64>,
    /// Unit normal, world axes, from the other body to this one.
    pub normal: Vector3<f64>,
    /// Signed distance, m; negative: penetration depth.
    pub distance: f64,
    /// Normal impulse in the last sub-step, N·s, not negative.
    pub impulse: f64,
    /// Impulse of friction on this body in the last sub-step, N·s, world axes.
    pub friction: Vector3<f64>,
    /// Coefficient of friction of the two bodies.
    pub friction_coefficient: f64,
}

impl World {
    /// Fills `contacts` with the contact points of `body` with other bodies at a distance of at most `threshold` m, as
    /// of the last sub-step. Bullet keeps points up to about 0.02 m apart. Empty for a stale handle. Soft bodies and
    /// ghosts do not count.
    ///
    /// Takes time proportional to the number of contact manifolds in the world.
    pub fn contacts(&self, body: BodyHandle, threshold: f64, contacts: &mut Vec<Contact>) {
        contacts.clear();
        let Some(body) = self.raw_body(body) else { return };
        let raw = &mut self.scratch.borrow_mut().contacts;
        // SAFETY: world and body are alive.
        fill(raw, |out, capacity| unsafe { sys::amb_body_contacts(self.raw.as_ptr(), body, threshold, out, capacity) });
        contacts.extend(raw.iter().map(Contact::of));
    }

    /// All contact points of pairs of bodies, each with the body whose surface has the point and onto which the normal leads,
    /// whatever their distance, as of the last sub-step. Soft bodies and ghosts do not count.
    pub fn contact_points(&self) -> Vec<(BodyHandle, Contact)> {
        let mut pairs = Vec::new();
        let pairs = self.touching(&mut pairs);
        let of = |pair: &sys::AmbTouching| {
            let body = KeyData::from_ffi(pair.bodies[0]).into();
            self.contacts_of_pair(pair, 0).map(move |contact| (body, contact))
        };
        pairs.iter().flat_map(of).collect()
    }

    /// Fills `touching` with the pairs of bodies that have contact points, in the order of their manifolds.
    fn touching<'a>(&self, touching: &'a mut Vec<sys::AmbTouching>) -> &'a [sys::AmbTouching] {
        let write = |out: &mut [sys::AmbTouching]| {
            let capacity = i32::try_from(out.len()).unwrap_or(i32::MAX);
            // SAFETY: the world is alive; pointer and length come from one slice.
            unsafe { sys::amb_world_touching(self.raw.as_ptr(), out.as_mut_ptr(), capacity) }.max(0) as usize
        };
        let mut count = write(touching);
        if count > touching.len() {
            touching.resize(count.next_power_of_two(), sys::AmbTouching::default());
            count = write(touching);
        }
        &touching[..count.min(touching.len())]
    }

    /// The contact points of a pair that [`touching`](Self::touching) gave, as its first or second body has them.
    fn contacts_of_pair(&self, pair: &sys::AmbTouching, side: usize) -> impl Iterator<Item = Contact> {
        let mut raw = sys::AmbManifoldContacts::default();
        // SAFETY: the world is alive; `raw` has place for all points of a manifold.
        let count = unsafe { sys::amb_manifold_contacts(self.raw.as_ptr(), pair.manifold, side as i32, &mut raw) };
        raw.points.into_iter().take(count.max(0) as usize).map(|raw| Contact::of(&raw))
    }
}

impl Contact {
    fn of(raw: &sys::AmbContact) -> Self {
        Self {
            other: KeyData::from_ffi(raw.other).into(),
            point: raw.point.into(),
            normal: raw.normal.into(),
            distance: raw.distance,
            impulse: raw.impulse,
            friction: raw.friction.into(),
            friction_coefficient: raw.friction_coefficient,
        }
    }
}

/// The contact points of some bodies, from one pass over the contact manifolds of the world.
///
/// For many bodies this takes much less time than [`World::contacts`] for each of them, and gives the same points in
/// the same order. It allocates only when there are more contact points than ever before, and then for twice as many.
#[derive(Debug, Default)]
pub struct ContactLists {
    /// Ends of the lists, one entry a body that is watched.
    ends: SecondaryMap<BodyHandle, Ends>,
    /// Points of all lists, each with the index of the next one in its list.
    points: Vec<(Contact, usize)>,
    pairs: Vec<sys::AmbTouching>,
}

/// First and last point of a list; [`NONE`]: it is empty.
#[derive(Debug, Clone, Copy)]
struct Ends {
    first: usize,
    last: usize,
}

/// No point of a list.
const NONE: usize = usize::MAX;
/// An empty list.
const EMPTY: Ends = Ends { first: NONE, last: NONE };
/// Pairs of bodies, and points of a watched body, for which there is memory from the start.
const ROOM: (usize, usize) = (1024, 64);

impl ContactLists {
    /// Keeps lists of the contacts of these bodies from the next [`update`](Self::update) on, and of no others.
    pub fn watch(&mut self, bodies: impl IntoIterator<Item = BodyHandle>) {
        self.ends.clear();
        self.points.clear();
        for body in bodies.into_iter().filter(|body| !body.is_null()) {
            self.ends.insert(body, EMPTY);
        }
        if !self.ends.is_empty() {
            self.points.reserve(self.ends.len().saturating_mul(ROOM.1));
            self.pairs.resize(self.pairs.len().max(ROOM.0), sys::AmbTouching::default());
        }
    }

    /// Reads the contacts of the last sub-step. Does nothing if no body is watched.
    pub fn update(&mut self, world: &World) {
        if self.ends.is_empty() {
            return;
        }
        self.points.clear();
        self.ends.values_mut().for_each(|ends| *ends = EMPTY);
        for pair in world.touching(&mut self.pairs) {
            for (side, &body) in pair.bodies.iter().enumerate() {
                let Some(ends) = self.ends.get_mut(KeyData::from_ffi(body).into()) else { continue };
                for contact in world.contacts_of_pair(pair, side) {
                    let place = self.points.len();
                    match self.points.get_mut(ends.last) {
                        Some((_, next)) => *next = place,
                        None => ends.first = place,
                    }
                    ends.last = place;
                    self.points.push((contact, NONE));
                }
            }
        }
    }

    /// The contact points of a watched body with other bodies as of the last [`update`](Self::update), at any distance:
    /// what [`World::contacts`] gives for an infinite threshold. Nothing for a body that is not watched.
    pub fn of(&self, body: BodyHandle) -> impl Iterator<Item = Contact> + '_ {
        let mut place = self.ends.get(body).map_or(NONE, |ends| ends.first);
        std::iter::from_fn(move || {
            let &(contact, next) = self.points.get(place)?;
            place = next;
            Some(contact)
        })
    }
}

/// Fills `out` with all results of `write`, which is called with a buffer and its capacity and returns the number of
/// all results.
pub(super) fn fill<T: Default + Clone>(out: &mut Vec<T>, write: impl Fn(*mut T, i32) -> i32) {
    out.resize(out.capacity(), T::default());
    let capacity = i32::try_from(out.len()).unwrap_or(i32::MAX);
    let count = write(out.as_mut_ptr(), capacity).max(0) as usize;
    let all_fit = count <= out.len();
    out.resize(count, T::default());
    if !all_fit {
        write(out.as_mut_ptr(), count as i32);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::super::tests::ball;
    use super::super::{Axis, RigidBody, Shape, Solver};
    use super::*;

    #[test]
    fn a_resting_ball_presses_with_its_weight() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) });
        let resting = world.add_body(ball(2.0, 0.0));
        for _ in 0..500 {
            world.step(0.001, 1, 0.001);
        }
        let mut found = Vec::new();
        world.contacts(resting, 0.001, &mut found);
        let [contact] = found[..] else { panic!("one point instead of {found:?}") };
        assert_eq!(contact.other, ground);
        assert!((contact.normal - Vector3::z()).norm() < 1e-9, "{contact:?}");
        assert!((contact.point - Vector3::new(0.0, 0.0, -0.1)).norm() < 1e-3, "{contact:?}");
        assert!(contact.distance.abs() < 1e-3, "{contact:?}");
        assert!((contact.impulse - 2.0 * 10.0 * 0.001).abs() < 1e-5, "m g dt, not {}", contact.impulse);

        world.contacts(ground, 0.001, &mut found);
        assert_eq!((found.len(), found[0].other), (1, resting));
        assert!((found[0].normal + Vector3::z()).norm() < 1e-9, "{found:?}");
        world.contacts(ground, -1.0, &mut found);
        assert!(found.is_empty(), "nothing is 1 m deep");

        assert!(world.remove_body(ground));
        world.contacts(ground, 0.001, &mut found);
        assert!(found.is_empty(), "a stale handle");
        world.contacts(resting, 0.001, &mut found);
        assert!(found.is_empty(), "what it lay on is gone");
    }

    #[test]
    fn spheres_without_restitution_meet_with_a_gap_of_zero() {
        // Gap after the sub-step in which they meet, m, and their relative velocity afterwards, m/s. The restitution of the
        // pair is the product; legacy pushes out with ERP / h.
        let cases = [
            (Solver::Accurate, 0.0, 0.0, 0.0),
            (Solver::Accurate, 0.5, -5e-4, 0.25),
            (Solver::default(), 0.0, -5e-4, 0.1),
        ];
        for (solver, restitution, gap, apart) in cases {
            let mut world = World::new(solver);
            let spheres = [0.0, 0.2005].map(|x| world.add_body(RigidBody { restitution, ..ball(1.0, x) }));
            let [first, second] = spheres;
            world.set_velocity(first, &Vector3::x(), &Vector3::zeros());
            world.step(0.001, 1, 0.001);
            let x = |world: &World, body| world.pose(body).expect("it is there").translation.x;
            let found = x(&world, second) - x(&world, first) - 0.2;
            assert!((found - gap).abs() < 1e-6, "{solver:?} {restitution}: {found}");
            world.step(0.001, 1, 0.001);
            let v = |body| world.velocity(body).expect("it is there").0.x;
            let found = v(second) - v(first);
            assert!((found - apart).abs() < 0.02, "{solver:?} {restitution}: {found} m/s");
        }
    }

    #[test]
    fn deep_round_bodies_rest_on_all_points_of_a_plane() {
        const RADIUS: f64 = 0.02;
        const HEIGHT: f64 = 0.05;
        // With the distance from the centre of mass to the lowest points, and their number. Bullet finds the centre of the
        // cone's base first.
        type Case = (fn() -> Shape, f64, usize);
        let cases: [Case; 4] = [
            (|| Shape::cylinder(Axis::X, RADIUS, HEIGHT, 1e-5), RADIUS, 2),
            (|| Shape::capsule(Axis::X, RADIUS, HEIGHT, 1e-5), RADIUS, 2),
            (|| Shape::cylinder(Axis::Z, RADIUS, HEIGHT, 1e-5), HEIGHT / 2.0, 3),
            (|| Shape::cone(Axis::Z, RADIUS, HEIGHT, 1e-5), HEIGHT / 2.0, 4),
        ];
        for (n, (shape, above, all)) in cases.into_iter().enumerate() {
            let (deep, shallow) = (0.1 * RADIUS, 0.001 * RADIUS);
            let expected =
                [(Solver::Accurate, deep, all), (Solver::Accurate, shallow, 1), (Solver::default(), deep, 1)];
            for (solver, depth, expected) in expected {
                let mut world = World::new(solver);
                let ground = Shape::plane(Vector3::z(), 0.0, 0.0);
                let ground = world.add_body(RigidBody { shape: ground, ..ball(0.0, 0.0) });
                let pose = Isometry3::translation(0.0, 0.0, above - depth);
                world.add_body(RigidBody { shape: shape(), pose, ..ball(1.0, 0.0) });
                world.step(1e-6, 1, 1e-6);
                let mut found = Vec::new();
                world.contacts(ground, 0.0, &mut found);
                assert_eq!(found.len(), expected, "{n} {solver:?} {depth}: {found:?}");
            }
        }
    }

    #[test]
    fn more_contacts_than_the_first_try_has_place_for() {
        let mut world = World::new(Solver::default());
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) });
        for i in 0..50 {
            world.add_body(RigidBody { pose: Isometry3::translation(f64::from(i), 0.0, 0.0), ..ball(1.0, 0.0) });
        }
        world.step(0.001, 1, 0.001);
        let mut found = Vec::new();
        world.contacts(ground, 0.001, &mut found);
        assert_eq!(found.len(), 50);
        let mut others: Vec<_> = found.iter().map(|contact| contact.other).collect();
        others.sort_unstable();
        others.dedup();
        assert_eq!(others.len(), 50);
    }

    #[test]
    fn lists_are_what_each_body_would_be_told() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let ground = RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) };
        let mut bodies = vec![world.add_body(ground)];
        for i in 0..60 {
            let place = Isometry3::translation(0.21 * f64::from(i % 8), 0.0, 0.2 * f64::from(i / 8));
            let shape = Shape::cuboid(Vector3::repeat(0.1), 0.001);
            bodies.push(world.add_body(RigidBody { shape, pose: place, ..ball(1.0, 0.0) }));
        }
        let watched: Vec<_> = bodies.iter().copied().step_by(3).collect();
        let mut lists = ContactLists::default();
        lists.watch(watched.iter().copied());
        let mut found = Vec::new();
        for step in 0..200 {
            if step == 150 {
                // Its list becomes empty, and it is nobody's contact any more.
                assert!(world.remove_body(watched[5]));
            }
            world.step(0.001, 1, 0.001);
            lists.update(&world);
            for &body in &watched {
                world.contacts(body, f64::INFINITY, &mut found);
                assert_eq!(lists.of(body).collect::<Vec<_>>(), found, "step {step}");
                assert!(step < 100 || !found.is_empty() || step >= 150 && body == watched[5]);
            }
            assert_eq!(lists.of(bodies[1]).count(), 0, "not watched");
        }
        lists.watch([]);
        lists.update(&world);
        assert_eq!(lists.of(watched[0]).count(), 0);
    }

    #[test]
    fn lists_grow_with_what_touches() {
        let mut world = World::new(Solver::default());
        let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) });
        for i in 0..ROOM.0 + 100 {
            world.add_body(RigidBody { pose: Isometry3::translation(i as f64, 0.0, 0.0), ..ball(1.0, 0.0) });
        }
        world.step(0.001, 1, 0.001);
        let mut lists = ContactLists::default();
        lists.watch([ground]);
        lists.update(&world);
        assert_eq!(lists.of(ground).count(), ROOM.0 + 100);
    }
}
