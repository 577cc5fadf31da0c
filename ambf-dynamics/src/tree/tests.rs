use std::f64::consts::FRAC_PI_2;

use nalgebra::Point3;

use super::inverse::Folding;
use super::*;

/// Numbers between -1 and 1.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.next())
    }

    fn list(&mut self, count: usize) -> Vec<f64> {
        (0..count).map(|_| self.next()).collect()
    }

    fn pose(&mut self) -> Isometry3<f64> {
        Isometry3::new(self.vector(), self.vector() * 2.0)
    }

    /// A tree with branches, of all kinds of joints; its coordinates are not in the order of its links.
    fn tree(&mut self, is_free: bool) -> Tree {
        let count = 9;
        let motions = [
            Motion::Revolute(4),
            Motion::Prismatic(0),
            Motion::Fixed,
            Motion::Revolute(1),
            Motion::Revolute(5),
            Motion::Prismatic(3),
            Motion::Fixed,
            Motion::Revolute(2),
        ];
        let mut links = vec![self.link(0, Motion::Fixed)];
        for index in 1..count {
            let parent = ((self.next() + 1.0) / 2.0 * index as f64) as usize;
            let link = self.link(parent.min(index - 1), motions[index - 1]);
            links.push(link);
        }
        Tree::new(links, is_free)
    }

    fn link(&mut self, parent: usize, motion: Motion) -> Link {
        Link {
            parent,
            motion,
            pivot: self.vector() * 0.5,
            axis: Unit::new_normalize(self.vector()),
            rest: self.pose(),
            mass: 1.5 + self.next(),
            inertia: Vector3::repeat(0.5) + self.vector() * 0.1,
            gravity: Vector3::new(0.3, -0.2, -9.81),
            limits: [-2.0, 2.0],
            armature: if motion == Motion::Fixed { 0.0 } else { 0.3 + 0.2 * self.next() },
        }
    }
}

/// State of a tree: pose of the base, coordinates, rates.
#[derive(Clone)]
struct State {
    base: Isometry3<f64>,
    positions: Vec<f64>,
    rates: Vec<f64>,
}

impl State {
    fn any(tree: &Tree, numbers: &mut Numbers) -> Self {
        Self { base: numbers.pose(), positions: numbers.list(tree.joints()), rates: numbers.list(tree.rates()) }
    }

    /// Where it is after `h` s with these accelerations, to the second order.
    fn after(&self, tree: &Tree, accelerations: &[f64], h: f64) -> Self {
        let ways: Vec<f64> =
            self.rates.iter().zip(accelerations).map(|(rate, by)| h * rate + 0.5 * h * h * by).collect();
        let mut next = self.moved(tree, &ways);
        next.rates.iter_mut().zip(accelerations).for_each(|(rate, by)| *rate += h * by);
        next
    }

    /// With its coordinates, and the pose of a free base, moved.
    fn moved(&self, tree: &Tree, by: &[f64]) -> Self {
        let mut next = self.clone();
        if tree.is_free() {
            next.base.translation.vector += Vector3::from_column_slice(&by[..3]);
            next.base.rotation =
                UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&by[3..6])) * self.base.rotation;
        }
        let joints = &by[by.len() - tree.joints()..];
        next.positions.iter_mut().zip(joints).for_each(|(position, by)| *position += by);
        next
    }

    fn posture<'a>(&self, tree: &'a Tree) -> Posture<'a> {
        tree.posture(&self.base, &self.positions)
    }
}

fn unit(count: usize, index: usize, value: f64) -> Vec<f64> {
    (0..count).map(|i| if i == index { value } else { 0.0 }).collect()
}

const STEP: f64 = 1e-5;
const CLOSE: f64 = 1e-6;

/// A free tree and one that is not, at some states.
fn each(check: impl Fn(&Tree, &State, &mut Numbers)) {
    let mut numbers = Numbers(1);
    for round in 0..20 {
        let tree = numbers.tree(round % 2 == 0);
        let state = State::any(&tree, &mut numbers);
        check(&tree, &state, &mut numbers);
    }
}

#[test]
fn jacobians_are_what_points_and_links_do_when_coordinates_move() {
    each(|tree, state, numbers| {
        for link in 0..tree.links().len() {
            let at = Point3::from(numbers.vector());
            let frame = |state: &State| state.posture(tree).poses()[link];
            let jacobian = state.posture(tree).jacobian(link, &(frame(state) * at).coords);
            for column in 0..tree.rates() {
                let [ahead, behind] =
                    [STEP, -STEP].map(|by| frame(&state.moved(tree, &unit(tree.rates(), column, by))));
                let linear = (ahead * at - behind * at) / (2.0 * STEP);
                let angular = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / (2.0 * STEP);
                assert!((jacobian.fixed_view::<3, 1>(0, column) - linear).norm() < CLOSE);
                assert!((jacobian.fixed_view::<3, 1>(3, column) - angular).norm() < CLOSE);
            }
        }
    });
}

#[test]
fn the_mass_matrix_is_symmetric_positive_and_that_of_the_kinetic_energy() {
    each(|tree, state, _| {
        let posture = state.posture(tree);
        let matrix = posture.mass_matrix();
        assert_eq!(matrix, matrix.transpose());
        assert!(matrix.clone().cholesky().is_some(), "positive");
        let rates = DVector::from_column_slice(&state.rates);
        let energy = posture.kinetic_energy(&state.rates);
        assert!((0.5 * rates.dot(&(&matrix * &rates)) - energy).abs() < 1e-12 * energy);
    });
}

#[test]
fn forces_are_mass_times_acceleration_and_bias() {
    each(|tree, state, numbers| {
        let posture = state.posture(tree);
        let accelerations = numbers.list(tree.rates());
        let forces = posture.inverse_dynamics(&state.rates, &accelerations);
        let bias = posture.bias_forces(&state.rates);
        let by_matrix = posture.mass_matrix() * DVector::from_vec(accelerations) + &bias;
        assert!((forces - by_matrix).norm() < 1e-11);
        let parts = posture.gravity_forces() + posture.coriolis_forces(&state.rates);
        assert!((bias - parts).norm() < 1e-11);
    });
}

#[test]
fn power_goes_into_motion_and_height() {
    each(|tree, state, numbers| {
        let accelerations = numbers.list(tree.rates());
        let energy = |state: &State| {
            let posture = state.posture(tree);
            // A base that stands still does not count.
            let links = tree.links().iter().zip(posture.poses());
            let potential: f64 =
                links.map(|(link, pose)| -link.mass * link.gravity.dot(&pose.translation.vector)).sum();
            posture.kinetic_energy(&state.rates) + potential
        };
        let [ahead, behind] = [STEP, -STEP].map(|by| energy(&state.after(tree, &accelerations, by)));
        let forces = state.posture(tree).inverse_dynamics(&state.rates, &accelerations);
        let power = forces.dot(&DVector::from_column_slice(&state.rates));
        assert!((power - (ahead - behind) / (2.0 * STEP)).abs() < CLOSE, "{power}");
    });
}

/// Lagrange's equations, by differences of the kinetic and the potential energy.
#[test]
fn forces_along_joints_are_those_of_lagrange() {
    each(|tree, state, numbers| {
        let accelerations = numbers.list(tree.rates());
        let forces = state.posture(tree).inverse_dynamics(&state.rates, &accelerations);
        let rates = |state: &State| DVector::from_column_slice(&state.rates);
        let momentum = |state: &State| state.posture(tree).mass_matrix() * rates(state);
        let [ahead, behind] = [STEP, -STEP].map(|by| momentum(&state.after(tree, &accelerations, by)));
        let change = (ahead - behind) / (2.0 * STEP);
        let lagrangian = |state: &State| {
            let posture = state.posture(tree);
            let links = tree.links().iter().zip(posture.poses());
            let potential: f64 =
                links.map(|(link, pose)| -link.mass * link.gravity.dot(&pose.translation.vector)).sum();
            posture.kinetic_energy(&state.rates) - potential
        };
        for number in tree.rates() - tree.joints()..tree.rates() {
            let [ahead, behind] =
                [STEP, -STEP].map(|by| lagrangian(&state.moved(tree, &unit(tree.rates(), number, by))));
            let expected = change[number] - (ahead - behind) / (2.0 * STEP);
            assert!((forces[number] - expected).abs() < CLOSE, "{number}: {} {expected}", forces[number]);
        }
    });
}

/// Newton's law of the whole, and that of its angular momentum about the origin.
#[test]
fn forces_on_a_free_base_change_the_momentum_of_the_whole() {
    each(|tree, state, numbers| {
        if !tree.is_free() {
            return;
        }
        let accelerations = numbers.list(tree.rates());
        let momenta = |state: &State| {
            let posture = state.posture(tree);
            let velocities = posture.velocities(&state.rates);
            let mut sums = [Vector3::zeros(); 2];
            for (index, [linear, angular]) in velocities.iter().enumerate() {
                let momentum = linear * tree.links()[index].mass;
                sums[0] += momentum;
                sums[1] += posture.centre(index).cross(&momentum) + posture.inertia(index) * angular;
            }
            sums
        };
        let [ahead, behind] = [STEP, -STEP].map(|by| momenta(&state.after(tree, &accelerations, by)));
        let posture = state.posture(tree);
        let forces = posture.inverse_dynamics(&state.rates, &accelerations);
        let force = Vector3::from_column_slice(&forces.as_slice()[..3]);
        let torque = Vector3::from_column_slice(&forces.as_slice()[3..6]);
        let mut weights = [Vector3::zeros(); 2];
        for (index, link) in tree.links().iter().enumerate() {
            weights[0] += link.gravity * link.mass;
            weights[1] += posture.centre(index).cross(&(link.gravity * link.mass));
        }
        let change = [0, 1].map(|part| (ahead[part] - behind[part]) / (2.0 * STEP) - weights[part]);
        assert!((force - change[0]).norm() < CLOSE);
        assert!((torque + posture.centre(0).cross(&force) - change[1]).norm() < CLOSE);
    });
}

/// A rod of 2 kg, its centre of mass 0.5 m from the joint about y.
fn pendulum() -> Tree {
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    let rod = Link {
        axis: Vector3::y_axis(),
        motion: Motion::Revolute(0),
        rest: Isometry3::translation(0.0, 0.0, -0.5),
        ..Link::base(2.0, Vector3::new(0.3, 0.1, 0.2), gravity)
    };
    Tree::new(vec![Link::base(0.0, Vector3::zeros(), gravity), rod], false)
}

#[test]
fn a_pendulum_is_that_of_the_textbook() {
    let tree = pendulum();
    let posture = tree.posture(&Isometry3::identity(), &[FRAC_PI_2]);
    assert!((posture.mass_matrix()[(0, 0)] - (0.1 + 2.0 * 0.25)).abs() < 1e-15);
    // It points along -x; its weight turns it on about -y.
    assert!((posture.poses()[1].translation.vector - Vector3::new(-0.5, 0.0, 0.0)).norm() < 1e-15);
    assert!((posture.gravity_forces()[0] - 2.0 * 10.0 * 0.5).abs() < 1e-14);
    assert!(posture.coriolis_forces(&[3.0])[0].abs() < 1e-14);
}

#[test]
fn a_rotor_adds_to_its_joint() {
    let mut tree = pendulum();
    tree.links[1].armature = 0.25;
    let posture = tree.posture(&Isometry3::identity(), &[FRAC_PI_2]);
    assert!((posture.mass_matrix()[(0, 0)] - (0.1 + 2.0 * 0.25 + 0.25)).abs() < 1e-15);
    assert!((posture.inverse_dynamics(&[0.0], &[2.0])[0] - (2.0 * 10.0 * 0.5 + 2.0 * 0.85)).abs() < 1e-14);
    assert!((posture.kinetic_energy(&[2.0]) - 0.5 * 0.85 * 4.0).abs() < 1e-14);
}

#[test]
fn couplings_are_rows_of_the_rates() {
    let mut numbers = Numbers(5);
    for (is_free, first) in [(false, 0), (true, 6)] {
        let followers = vec![
            Follower { coordinate: 2, leaders: vec![(0, 0.5), (5, -3.0)], offset: 0.0 },
            Follower { coordinate: 4, leaders: vec![(2, 2.0)], offset: 0.0 },
        ];
        let tree = numbers.tree(is_free).with_followers(followers);
        let rows = tree.coupling_rows();
        assert_eq!(rows.shape(), (2, tree.rates()));
        let mut rates = numbers.list(tree.rates());
        rates[first + 2] = 0.5 * rates[first] - 3.0 * rates[first + 5];
        rates[first + 4] = 2.0 * rates[first + 2];
        assert!((rows * DVector::from_vec(rates)).amax() < 1e-14);
    }
}

#[test]
fn goals_within_reach_are_reached() {
    let mut reached = 0;
    let mut numbers = Numbers(3);
    let rounds = 50;
    for _ in 0..rounds {
        let tree = numbers.tree(false);
        let state = State::any(&tree, &mut numbers);
        let (link, frame) = (tree.links().len() - 1, numbers.pose());
        let pose = state.posture(&tree).poses()[link] * frame;
        let goal = Goal {
            link,
            frame,
            position: Some(pose.translation.vector),
            rotation: Some(pose.rotation),
            tolerance: [1e-9; 2],
            iterations: 200,
        };
        let start: Vec<f64> = state.positions.iter().map(|position| position + 0.3 * numbers.next()).collect();
        let found = tree.inverse_kinematics(&state.base, &start, &goal).unwrap();
        reached += usize::from(found.reached);
        let there = tree.posture(&state.base, &found.positions).poses()[link] * frame;
        let missed = (there.translation.vector - pose.translation.vector).norm();
        assert!((missed - found.position_error).abs() < 1e-12, "the error is that of the answer");
        assert!(found.positions.iter().all(|position| position.abs() <= 2.0), "within limits");
    }
    assert!(reached >= rounds - 2, "{reached} of {rounds}");
}

#[test]
fn goals_beyond_the_limits_are_come_near() {
    let mut tree = pendulum();
    tree.links[1].limits = [-0.5, 0.25];
    let goal = Goal {
        link: 1,
        frame: Isometry3::identity(),
        position: Some(Vector3::new(-1.0, 0.0, 0.0)),
        rotation: None,
        tolerance: [1e-6; 2],
        iterations: 100,
    };
    let found = tree.inverse_kinematics(&Isometry3::identity(), &[0.0], &goal).unwrap();
    assert_eq!((found.positions, found.reached), (vec![0.25], false));
    // A goal that leads nowhere, and no iteration at all.
    let far = Goal { position: Some(Vector3::repeat(1e6)), ..goal.clone() };
    let found = tree.inverse_kinematics(&Isometry3::identity(), &[7.0], &far).unwrap();
    assert!(!found.reached && found.positions[0].abs() <= 0.5);
    let none = Goal { iterations: 0, ..goal };
    assert!(!tree.inverse_kinematics(&Isometry3::identity(), &[0.1], &none).unwrap().reached);
}

/// A tree in which one joint follows two, and another one that one.
fn coupled(numbers: &mut Numbers, is_free: bool) -> Tree {
    numbers.tree(is_free).with_followers(vec![
        Follower { coordinate: 4, leaders: vec![(2, 0.8)], offset: -0.3 },
        Follower { coordinate: 2, leaders: vec![(0, 0.5), (5, -0.7)], offset: 0.1 },
    ])
}

fn followed(positions: &mut [f64]) {
    positions[2] = 0.5 * positions[0] - 0.7 * positions[5] + 0.1;
    positions[4] = 0.8 * positions[2] - 0.3;
}

#[test]
fn columns_of_followers_are_added_to_those_of_their_leaders() {
    let mut numbers = Numbers(11);
    for is_free in [false, true] {
        let tree = coupled(&mut numbers, is_free);
        let folding = Folding::of(&tree);
        assert_eq!(folding.free, [0, 1, 3, 5]);
        let free = DVector::from_vec(numbers.list(4));
        let state =
            State { positions: folding.positions(&free).as_slice().to_vec(), ..State::any(&tree, &mut numbers) };
        let mut expected = state.positions.clone();
        followed(&mut expected);
        assert!((DVector::from_vec(expected) - DVector::from_column_slice(&state.positions)).amax() < 1e-15);
        let (link, first) = (tree.links().len() - 1, tree.rates() - tree.joints());
        let posture = state.posture(&tree);
        let point = posture.centre(link);
        let jacobian = posture.jacobian(link, &point).columns(first, tree.joints()) * &folding.rates;
        for column in 0..4 {
            let at = |by: f64| {
                let positions = folding.positions(&(&free + DVector::from_vec(unit(4, column, by))));
                tree.posture(&state.base, positions.as_slice()).poses()[link]
            };
            let (before, after) = (at(-STEP), at(STEP));
            let linear = (after.translation.vector - before.translation.vector) / (2.0 * STEP);
            let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * STEP);
            assert!((jacobian.fixed_view::<3, 1>(0, column) - linear).amax() < 1e-8);
            assert!((jacobian.fixed_view::<3, 1>(3, column) - angular).amax() < 1e-8);
        }
    }
}

#[test]
fn followers_follow_in_inverse_kinematics() {
    let mut numbers = Numbers(5);
    let (mut reached, rounds) = (0, 50);
    for _ in 0..rounds {
        let tree = coupled(&mut numbers, false);
        let mut state = State::any(&tree, &mut numbers);
        followed(&mut state.positions);
        let link = tree.links().len() - 1;
        let pose = state.posture(&tree).poses()[link];
        let goal = Goal {
            link,
            frame: Isometry3::identity(),
            position: Some(pose.translation.vector),
            rotation: None,
            tolerance: [1e-9; 2],
            iterations: 200,
        };
        // The followers' numbers are not those that the leaders ask for.
        let start: Vec<f64> = state.positions.iter().map(|position| position + 0.3 * numbers.next()).collect();
        let found = tree.inverse_kinematics(&state.base, &start, &goal).unwrap();
        let mut asked = found.positions.clone();
        followed(&mut asked);
        let apart = found.positions.iter().zip(&asked).map(|(found, asked)| (found - asked).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-12, "{:?}, not {asked:?}", found.positions);
        assert!(found.positions.iter().all(|position| position.abs() <= 2.0), "within limits");
        let there = tree.posture(&state.base, &found.positions).poses()[link].translation.vector;
        assert!(((there - pose.translation.vector).norm() - found.position_error).abs() < 1e-12);
        reached += usize::from(found.reached);
    }
    assert!(reached >= rounds - 2, "{reached} of {rounds}");
}

/// Two jaws on slides along x, the second of which moves against the first, on a carriage along y.
fn gripper(limits: [[f64; 2]; 3]) -> Tree {
    let slide = |number, axis, parent, limits| Link {
        parent,
        motion: Motion::Prismatic(number),
        pivot: Vector3::zeros(),
        axis,
        rest: Isometry3::identity(),
        limits,
        ..Link::base(1.0, Vector3::repeat(1.0), Vector3::zeros())
    };
    let links = vec![
        Link::base(0.0, Vector3::zeros(), Vector3::zeros()),
        slide(0, Vector3::y_axis(), 0, limits[0]),
        slide(1, Vector3::x_axis(), 1, limits[1]),
        slide(2, Vector3::x_axis(), 1, limits[2]),
    ];
    Tree::new(links, false).with_followers(vec![Follower { coordinate: 2, leaders: vec![(1, -1.0)], offset: 0.0 }])
}

#[test]
fn limits_of_followers_stop_their_leaders() {
    let goal = |x: f64, y: f64| Goal {
        link: 2,
        frame: Isometry3::identity(),
        position: Some(Vector3::new(x, y, 0.0)),
        rotation: None,
        tolerance: [1e-9; 2],
        iterations: 200,
    };
    let tree = gripper([[-1.0, 1.0], [-0.1, 0.1], [-0.04, 0.1]]);
    let solve = |start: &[f64], goal: &Goal| tree.inverse_kinematics(&Isometry3::identity(), start, goal).unwrap();
    let found = solve(&[0.0; 3], &goal(0.03, 0.5));
    assert!(found.reached);
    assert!((found.positions[2] + 0.03).abs() < 1e-8, "{:?}", found.positions);
    // Beyond what the second jaw can do, from within and from outside; the carriage goes on.
    for start in [[0.0; 3], [0.0, 0.1, 0.1], [0.0, -0.1, 0.0]] {
        let found = solve(&start, &goal(0.09, 0.5));
        assert!(!found.reached);
        let expected = [0.5, 0.04, -0.04];
        let apart = found.positions.iter().zip(expected).map(|(found, expected)| (found - expected).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-8, "{:?}", found.positions);
        assert!((found.position_error - 0.05).abs() < 1e-8);
    }
    // The goal of the second jaw, which is moved by its leader.
    let found = solve(&[0.0; 3], &Goal { link: 3, ..goal(-0.02, -0.5) });
    assert!(found.reached && (found.positions[1] - 0.02).abs() < 1e-8, "{found:?}");
    let apart = gripper([[-1.0, 1.0], [-0.1, 0.1], [0.2, 0.3]]);
    let problem = apart.inverse_kinematics(&Isometry3::identity(), &[0.0; 3], &goal(0.0, 0.0)).unwrap_err();
    assert_eq!(problem, LimitsContradict { coordinate: 2 });
}

#[test]
#[should_panic(expected = "follows itself")]
fn no_coordinate_follows_itself() {
    let follow = |coordinate, leader| Follower { coordinate, leaders: vec![(leader, 1.0)], offset: 0.0 };
    let _ = Numbers(1).tree(false).with_followers(vec![follow(0, 1), follow(1, 2), follow(2, 0)]);
}
