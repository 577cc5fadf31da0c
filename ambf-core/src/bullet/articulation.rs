//! Constraints in reduced coordinates.

use std::collections::{HashMap, HashSet};
use std::ptr::NonNull;

use bullet_sys as sys;

use super::{ArticulationHandle, BodyHandle, ConstraintHandle, ConstraintKind, World};

pub(super) struct OwnedArticulation {
    raw: NonNull<sys::AmbTree>,
    joints: Vec<ConstraintHandle>,
    links: Vec<BodyHandle>,
}

/// Constraints in an order in which each leads from what was reached before to one body more.
struct Tree {
    base: BodyHandle,
    joints: Vec<ConstraintHandle>,
    /// Beside joints, between the same bodies.
    springs: Vec<ConstraintHandle>,
    /// Bodies that move with it.
    links: Vec<BodyHandle>,
}

impl World {
    /// Puts hinges, sliders, fixed constraints and springs about or along one axis that form one tree into reduced coordinates: the
    /// coordinates of the joints and, if no body is static, the pose of the base. Such springs may also lie beside a hinge or slider whose
    /// axis they share. Joints then have no gap, and motion between impacts is integrated by the classical
    /// Runge-Kutta method, fourth order in the sub-step. The base is the static body, else that which is first of a constraint and second
    /// of none. Links take the poses and velocities next to theirs that the joints allow.
    ///
    /// Everything that is done with the bodies and constraints goes on to work: wrenches, gravity, damping, poses and velocities, motors,
    /// limits, readings, feedback, contacts, rays, ghosts. Motion states don't lag.
    ///
    /// `None`, and nothing is changed, when the world was not made [for it](Self::with_articulations); when the constraints are of other
    /// types, form no tree or several, or reach more than one static body; when a body of theirs is held by any other constraint, cannot
    /// turn about all its axes, or is a link already; or when there are vehicles, whose wheels would not find the links.
    pub fn articulate(&mut self, constraints: &[ConstraintHandle]) -> Option<ArticulationHandle> {
        if !self.has_articulations || !self.vehicles.is_empty() {
            return None;
        }
        let Tree { base, mut joints, springs, links } = self.tree_of(constraints)?;
        let pointers = |of: &[ConstraintHandle]| -> Vec<_> {
            of.iter().map(|&constraint| self.constraints[constraint].raw.as_ptr()).collect()
        };
        let (raw_joints, raw_springs) = (pointers(&joints), pointers(&springs));
        // SAFETY: world, base and constraints are alive, the constraints are in the world, lead from the base on one body at a time, and
        // nothing else holds the links. The tree is dissolved before any of them is removed.
        let raw = unsafe {
            sys::amb_world_articulate(
                self.raw.as_ptr(),
                self.raw_body(base)?,
                raw_joints.as_ptr(),
                raw_joints.len() as i32,
                raw_springs.as_ptr(),
                raw_springs.len() as i32,
            )
        };
        let raw = NonNull::new(raw)?;
        joints.extend(springs);
        let handle = self.articulations.insert(OwnedArticulation { raw, joints: joints.clone(), links: links.clone() });
        joints.into_iter().for_each(|joint| self.constraints[joint].articulation = Some(handle));
        links.into_iter().for_each(|link| self.bodies[link].articulation = Some(handle));
        Some(handle)
    }

    /// Puts the bodies and constraints of an articulation back into the world as such, with their present poses and velocities. False
    /// when it is not there.
    pub fn dissolve(&mut self, handle: ArticulationHandle) -> bool {
        let Some(articulation) = self.articulations.remove(handle) else { return false };
        // SAFETY: world and tree are alive, and so are its bodies and constraints; no pointer to the tree is left after this.
        unsafe { sys::amb_world_dissolve(self.raw.as_ptr(), articulation.raw.as_ptr()) }
        articulation.joints.into_iter().for_each(|joint| self.constraints[joint].articulation = None);
        articulation.links.into_iter().for_each(|link| self.bodies[link].articulation = None);
        true
    }

    /// The articulation of which a body is a link.
    pub fn articulation(&self, body: BodyHandle) -> Option<ArticulationHandle> {
        self.bodies.get(body)?.articulation
    }

    /// Whether constraints may be [articulated](Self::articulate).
    pub fn has_articulations(&self) -> bool {
        self.has_articulations
    }

    /// Dissolves what a new constraint between `a` and `b` cannot hold: anything but ties that lead out of their articulation.
    pub(super) fn dissolve_for(&mut self, a: BodyHandle, b: BodyHandle, kind: &ConstraintKind) {
        let of = [a, b].map(|body| self.articulation(body));
        let is_tie = matches!(kind, ConstraintKind::Fixed | ConstraintKind::PointToPoint);
        if !is_tie || of[0] == of[1] {
            of.into_iter().flatten().for_each(|handle| {
                self.dissolve(handle);
            });
        }
    }

    /// Dissolves all articulations.
    pub(super) fn dissolve_all(&mut self) {
        for handle in self.articulations.keys().collect::<Vec<_>>() {
            self.dissolve(handle);
        }
    }

    fn tree_of(&self, constraints: &[ConstraintHandle]) -> Option<Tree> {
        let mut held: HashMap<BodyHandle, usize> = HashMap::new();
        for handle in constraints {
            let constraint = self.constraints.get(*handle)?;
            if !(constraint.is_simple || constraint.is_axis_spring) || constraint.articulation.is_some() {
                return None;
            }
            constraint.bodies.iter().for_each(|&body| *held.entry(body).or_default() += 1);
        }
        let is_static = |body: BodyHandle| !self.bodies[body].dynamic;
        if held.iter().any(|(&body, &n)| !is_static(body) && self.bodies[body].held != n) {
            return None;
        }
        // Of several between the same bodies the joint is that which is no spring.
        let mut between: HashMap<[BodyHandle; 2], ConstraintHandle> = HashMap::new();
        let (mut joints, mut springs) = (Vec::new(), Vec::new());
        let is_simple = |handle: &ConstraintHandle| self.constraints[*handle].is_simple;
        let (simple, others): (Vec<_>, Vec<_>) = constraints.iter().copied().partition(is_simple);
        for handle in simple.into_iter().chain(others) {
            let mut bodies = self.constraints[handle].bodies;
            bodies.sort();
            if between.contains_key(&bodies) {
                if is_simple(&handle) {
                    return None;
                }
                springs.push(handle);
            } else {
                between.insert(bodies, handle);
                joints.push(handle);
            }
        }
        let mut joints_of: HashMap<BodyHandle, Vec<ConstraintHandle>> = HashMap::new();
        let mut children = HashSet::new();
        for &joint in &joints {
            let bodies = self.constraints[joint].bodies;
            bodies.iter().for_each(|&body| joints_of.entry(body).or_default().push(joint));
            children.insert(bodies[1]);
        }
        let ends = || constraints.iter().flat_map(|&handle| self.constraints[handle].bodies);
        let root = || ends().find(|body| !children.contains(body)).or_else(|| ends().next());
        let base = ends().find(|&body| is_static(body)).or_else(root)?;
        let (mut reached, mut seen) = (vec![base], HashSet::new());
        let mut order = Vec::with_capacity(joints.len());
        let mut next = 0;
        while let Some(&body) = reached.get(next) {
            next += 1;
            if next > 1 && is_static(body) {
                return None;
            }
            for &joint in joints_of[&body].iter().filter(|joint| seen.insert(**joint)) {
                let [a, b] = self.constraints[joint].bodies;
                order.push(joint);
                reached.push(if a == body { b } else { a });
            }
        }
        // A tree has one joint fewer than bodies, and all of them are reached.
        let is_tree = reached.len() == held.len() && order.len() == joints.len();
        let links = reached.into_iter().filter(|&body| !is_static(body)).collect();
        is_tree.then_some(Tree { base, joints: order, springs, links })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Matrix2, Vector2, Vector3};

    use super::super::{Constraint, RigidBody, Shape, Solver};
    use super::*;

    const GRAVITY: f64 = 9.81;

    fn link(mass: f64, x: f64) -> RigidBody {
        RigidBody {
            mass,
            inertia: Vector3::new(0.02, 0.03, 0.025) * mass,
            shape: Shape::sphere(0.01, 0.001),
            pose: Isometry3::translation(x, 0.0, 0.0),
            friction: 0.5,
            rolling_friction: 0.0,
            restitution: 0.0,
            linear_damping: 0.0,
            angular_damping: 0.0,
            gravity: None,
        }
    }

    fn hinge(kind: ConstraintKind, a: f64, b: f64) -> Constraint {
        Constraint {
            kind,
            frame_a: Isometry3::translation(a, 0.0, 0.0),
            frame_b: Isometry3::translation(b, 0.0, 0.0),
            parameters: vec![],
            feedback: false,
            disable_collisions: true,
        }
    }

    /// A static body and a chain of links of 1 kg and 1 m along x, gravity along -y; hinges about z.
    pub(super) fn chain(masses: &[f64]) -> (World, Vec<BodyHandle>, Vec<ConstraintHandle>) {
        let mut world = World::with_articulations(Solver::default());
        world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
        world.set_lag(false);
        let mut bodies = vec![world.add_body(link(0.0, 0.0))];
        let mut joints = Vec::new();
        for (i, &mass) in masses.iter().enumerate() {
            bodies.push(world.add_body(link(mass, i as f64 + 0.5)));
            let at = if i == 0 { 0.0 } else { 0.5 };
            let constraint = hinge(ConstraintKind::Hinge { limits: None }, at, -0.5);
            joints.push(world.add_constraint(bodies[i], bodies[i + 1], &constraint).unwrap());
        }
        (world, bodies, joints)
    }

    /// Accelerations of a double pendulum whose angles are absolute, of two such links: m, length 1, I about the centre.
    fn double_pendulum(state: [f64; 4]) -> [f64; 4] {
        let [a, b, da, db] = state;
        let inertia = 0.025;
        let (sin, cos) = (a - b).sin_cos();
        let mass = Matrix2::new(1.25 + inertia, 0.5 * cos, 0.5 * cos, 0.25 + inertia);
        let force =
            Vector2::new(-0.5 * sin * db * db - GRAVITY * 1.5 * a.cos(), 0.5 * sin * da * da - GRAVITY * 0.5 * b.cos());
        let q = mass.try_inverse().unwrap() * force;
        [da, db, q.x, q.y]
    }

    fn runge_kutta(f: impl Fn([f64; 4]) -> [f64; 4], mut y: [f64; 4], h: f64, n: usize) -> [f64; 4] {
        let add = |y: [f64; 4], k: [f64; 4], h: f64| std::array::from_fn(|i| y[i] + h * k[i]);
        for _ in 0..n {
            let k1 = f(y);
            let k2 = f(add(y, k1, h / 2.0));
            let k3 = f(add(y, k2, h / 2.0));
            let k4 = f(add(y, k3, h));
            y = std::array::from_fn(|i| y[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
        }
        y
    }

    #[test]
    fn a_double_pendulum_is_exact_to_fourth_order() {
        let (mut world, bodies, joints) = chain(&[1.0, 1.0]);
        world.articulate(&joints).unwrap();
        for _ in 0..2000 {
            world.step(0.001, 1, 0.001);
        }
        let [a, b, ..] = runge_kutta(double_pendulum, [0.0; 4], 1e-5, 200_000);
        let tip = Vector3::new(a.cos() + 0.5 * b.cos(), a.sin() + 0.5 * b.sin(), 0.0);
        let error = (world.pose(bodies[2]).unwrap().translation.vector - tip).norm();
        assert!(error < 1e-8, "{error}");
        let mut angles = [0.0; 2];
        world.read_constraints(&mut angles);
        let off = [angles[0] - a, angles[1] - (b - a)].map(|off| off.sin().abs());
        assert!(off.iter().all(|&off| off < 1e-7), "{off:?}");
    }

    fn run(world: &mut World, steps: usize) {
        (0..steps).for_each(|_| {
            world.step(0.001, 1, 0.001);
        });
    }

    fn poses(world: &World, bodies: &[BodyHandle]) -> Vec<Isometry3<f64>> {
        bodies.iter().map(|&body| world.pose(body).unwrap()).collect()
    }

    fn farthest(a: &[Isometry3<f64>], b: &[Isometry3<f64>]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a.translation.vector - b.translation.vector).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn a_tree_moves_as_its_constraints_do_and_can_be_dissolved() {
        let motion = |articulated: bool| {
            let (mut world, bodies, joints) = chain(&[1.0, 2.0, 0.5]);
            world.set_iterations(200);
            let tree = articulated.then(|| world.articulate(&joints).unwrap());
            let mut seen = Vec::new();
            for step in 0..1000 {
                world.apply_wrench(bodies[3], &Vector3::new(1.0, 3.0, 0.0), &Vector3::new(0.0, 0.0, 0.5));
                if step == 300 {
                    world.set_body_gravity(bodies[2], &Vector3::new(0.0, 5.0, 0.0));
                }
                if step == 500 {
                    world.set_velocity(bodies[3], &Vector3::new(0.0, 1.0, 0.0), &Vector3::zeros());
                }
                if let (700, Some(tree)) = (step, tree) {
                    assert!(world.dissolve(tree) && !world.dissolve(tree));
                }
                run(&mut world, 1);
                seen.push(poses(&world, &bodies));
            }
            seen
        };
        let (tree, bodies) = (motion(true), motion(false));
        for (step, (a, b)) in tree.iter().zip(&bodies).enumerate() {
            let off = farthest(a, b);
            assert!(off < 0.05, "step {step}: {off} m");
        }
    }

    #[test]
    fn a_reset_gives_the_initial_state_bit_for_bit() {
        let (mut world, bodies, joints) = chain(&[1.0, 2.0, 0.5]);
        world.articulate(&joints).unwrap();
        let initial = poses(&world, &bodies);
        let motion = |world: &mut World| {
            run(world, 400);
            poses(world, &bodies)
        };
        let first = motion(&mut world);
        for (&body, pose) in bodies.iter().zip(&initial) {
            world.clear_forces(body);
            world.set_velocity(body, &Vector3::zeros(), &Vector3::zeros());
            world.set_pose(body, pose);
        }
        assert_eq!(motion(&mut world), first);
    }

    #[test]
    fn what_is_no_tree_is_refused() {
        let (mut world, bodies, joints) = chain(&[1.0, 1.0, 1.0]);
        assert!(world.articulate(&[]).is_none());
        assert!(world.articulate(&joints[..2]).is_none(), "the third holds a link");
        let point = hinge(ConstraintKind::PointToPoint, 0.5, -0.5);
        let loose = world.add_body(link(1.0, 3.5));
        let ball = world.add_constraint(bodies[3], loose, &point).unwrap();
        assert!(world.articulate(&joints).is_none(), "a ball joint holds a link");
        assert!(world.articulate(&[joints[0], joints[1], joints[2], ball]).is_none());
        assert!(world.remove_constraint(ball));
        let anchor = world.add_body(link(0.0, 3.0));
        let closing = world.add_constraint(anchor, bodies[3], &hinge(ConstraintKind::Fixed, 0.0, 0.5)).unwrap();
        assert!(world.articulate(&[joints[0], joints[1], joints[2], closing]).is_none(), "held at both ends");
        assert!(world.remove_constraint(closing));
        let tree = world.articulate(&joints).unwrap();
        assert!(world.articulate(&joints).is_none(), "twice");
        assert_eq!(world.articulation(bodies[1]), Some(tree));
        assert!(!world.remove_body(bodies[1]));
        assert!(world.remove_constraint(joints[1]), "which dissolves it");
        assert_eq!(world.articulation(bodies[1]), None);
        run(&mut world, 10);
        let mut rigid = World::new(Solver::default());
        let [a, b] = [0.0, 1.0].map(|x| rigid.add_body(link(x, x)));
        let joint = rigid.add_constraint(a, b, &hinge(ConstraintKind::Fixed, 0.5, -0.5)).unwrap();
        assert!(rigid.articulate(&[joint]).is_none(), "not made for it");
    }

    #[test]
    fn a_free_tree_keeps_its_momentum() {
        let (mut world, bodies, joints) = chain(&[1.0, 2.0, 0.5]);
        world.remove_constraint(joints[0]);
        world.set_gravity(Vector3::zeros());
        world.articulate(&joints[1..]).unwrap();
        world.set_velocity(bodies[1], &Vector3::new(1.0, 2.0, 3.0), &Vector3::new(2.0, -1.0, 4.0));
        let momentum = |world: &World| -> Vector3<f64> {
            [1.0, 2.0, 0.5].iter().zip(&bodies[1..]).map(|(mass, &body)| world.velocity(body).unwrap().0 * *mass).sum()
        };
        run(&mut world, 1);
        let before = momentum(&world);
        assert!((before - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-12, "{before}");
        run(&mut world, 2000);
        assert!((momentum(&world) - before).norm() < 1e-9);
    }

    /// A link on a hinge or slider, horizontal, with gravity along -y, and what holds it.
    fn pendulum(constraint: Constraint, articulated: bool) -> (World, BodyHandle, ConstraintHandle) {
        let mut world = World::with_articulations(Solver::default());
        world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
        world.set_iterations(100);
        world.set_lag(false);
        let base = world.add_body(link(0.0, 0.0));
        let body = world.add_body(link(2.0, 0.5));
        let joint = world.add_constraint(base, body, &constraint).unwrap();
        if articulated {
            world.articulate(&[joint]).unwrap();
        }
        (world, body, joint)
    }

    fn slider(limits: Option<[f64; 2]>) -> Constraint {
        let mut slider = hinge(ConstraintKind::Slider { limits }, 0.5, 0.0);
        // The axis x turned to y.
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        slider.frame_a.rotation = turn;
        slider.frame_b.rotation = turn;
        slider
    }

    fn position(world: &World) -> f64 {
        let mut position = [0.0];
        world.read_constraints(&mut position);
        position[0]
    }

    #[test]
    fn limits_stop_hinges_and_sliders() {
        for articulated in [true, false] {
            let (mut world, ..) =
                pendulum(hinge(ConstraintKind::Hinge { limits: Some([-0.8, 3.5]) }, 0.0, -0.5), articulated);
            let lowest = (0..3000).map(|_| {
                run(&mut world, 1);
                position(&world)
            });
            let lowest = lowest.fold(f64::MAX, f64::min);
            assert!(lowest > -0.82, "{lowest}");
            assert!((position(&world) + 0.8).abs() < 2e-3, "{articulated}: {}", position(&world));
            let (mut world, body, _) = pendulum(slider(Some([-0.1, 0.2])), articulated);
            run(&mut world, 1000);
            assert!((position(&world) + 0.1).abs() < 1e-3, "{articulated}: {}", position(&world));
            world.set_body_gravity(body, &Vector3::new(0.0, GRAVITY, 0.0));
            run(&mut world, 1000);
            assert!((position(&world) - 0.2).abs() < 1e-3, "{articulated}: {}", position(&world));
        }
    }

    #[test]
    fn motors_hold_what_they_can() {
        for articulated in [true, false] {
            let (mut world, _, joint) = pendulum(hinge(ConstraintKind::Hinge { limits: None }, 0.0, -0.5), articulated);
            assert!(world.set_motor(joint, true, 0.7, 10.0));
            run(&mut world, 1000);
            assert!((position(&world) - 0.7).abs() < 1e-3, "{articulated}: {}", position(&world));
            // Too weak for the weight: impulse a sub-step below torque times step.
            world.set_motor(joint, true, 0.0, 0.5 * 0.001);
            run(&mut world, 200);
            assert!(position(&world) < 0.65, "{articulated}: {}", position(&world));
            world.set_motor(joint, false, 0.0, 10.0);
            let (mut world, _, joint) = pendulum(slider(None), articulated);
            world.set_motor(joint, true, -0.3, 100.0);
            run(&mut world, 1000);
            assert!((position(&world) + 0.3).abs() < 1e-3, "{articulated}: {}", position(&world));
            world.set_motor(joint, true, 0.0, 2.0 * GRAVITY - 2.0);
            run(&mut world, 1000);
            assert!(
                (position(&world) + 1.1).abs() < 5e-3,
                "from 0.3 m/s, 1 m/s² down for 1 s; {articulated}: {}",
                position(&world)
            );
        }
    }

    #[test]
    fn feedback_says_what_the_joint_does() {
        for make in [hinge(ConstraintKind::Hinge { limits: None }, 0.0, -0.5), slider(None)] {
            for reversed in [false, true] {
                for swinging in [false, true] {
                    let wrench = |articulated: bool| {
                        let mut constraint = Constraint { feedback: true, ..make.clone() };
                        if reversed {
                            std::mem::swap(&mut constraint.frame_a, &mut constraint.frame_b);
                        }
                        let mut world = World::with_articulations(Solver::default());
                        world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
                        world.set_iterations(100);
                        let base = world.add_body(link(0.0, 0.0));
                        let body = world.add_body(link(2.0, 0.5));
                        let (a, b) = if reversed { (body, base) } else { (base, body) };
                        let joint = world.add_constraint(a, b, &constraint).unwrap();
                        if articulated {
                            world.articulate(&[joint]).unwrap();
                        }
                        world.set_motor(joint, !swinging, 0.0, 100.0);
                        run(&mut world, 300);
                        world.joint_wrench(joint).unwrap()
                    };
                    let (tree, free) = (wrench(true), wrench(false));
                    let mut pairs = vec![(tree.force_a, free.force_a), (tree.force_b, free.force_b)];
                    // Of the torque that the force of a slider has about a static body Bullet says nothing.
                    if matches!(make.kind, ConstraintKind::Hinge { .. }) {
                        pairs.extend([(tree.torque_a, free.torque_a), (tree.torque_b, free.torque_b)]);
                    }
                    for (a, b) in pairs {
                        assert!((a - b).norm() < 0.3, "reversed {reversed}, swinging {swinging}: {tree:?} {free:?}");
                    }
                }
            }
        }
    }
}
