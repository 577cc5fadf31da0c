//! Islands as an engine makes them: contacts of six rows, joints with little CFM, a warm start from the solution of the
//! step before.

use ambf_dynamics::mlcp::{Friction, Solver};
use nalgebra::DMatrix;

use super::case::{Case, CaseRow, Random};

/// Velocity that gravity gives in one step, m/s.
const FALL: f64 = 9.81e-3;
/// CFM of normal impulses, of friction and of joints as shares of the diagonal.
const CONTACT: f64 = 1e-4;
const FRICTION: f64 = 1e-7;
const JOINT: f64 = 1e-9;

/// Rigid boxes of 1 kg with edges of 0.1 m.
fn boxes(count: usize) -> Case {
    let inverse = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&[1.0, 1.0, 1.0, 600.0, 600.0, 600.0]));
    Case { rigid: count, inverse_masses: vec![inverse; count], rows: Vec::new() }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Jacobian of the velocity along `axis` of a point at `arm` from the centre.
fn at_point(arm: [f64; 3], axis: [f64; 3], sign: f64) -> Vec<f64> {
    axis.into_iter().chain(cross(arm, axis)).map(|value| sign * value).collect()
}

fn about(axis: [f64; 3], sign: f64) -> Vec<f64> {
    [0.0; 3].into_iter().chain(axis).map(|value| sign * value).collect()
}

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

/// Sets CFM as a share of the diagonal of each row from `first` on.
fn set_cfm(case: &mut Case, first: usize, share: impl Fn(&CaseRow) -> f64) {
    for i in first..case.rows.len() {
        let along = |(body, jacobian): &(usize, Vec<f64>)| {
            let jacobian = nalgebra::DVector::from_column_slice(jacobian);
            jacobian.dot(&(&case.inverse_masses[*body] * &jacobian))
        };
        let diagonal: f64 = case.rows[i].sides.iter().map(along).sum();
        case.rows[i].cfm = share(&case.rows[i]) * diagonal;
    }
}

fn contact_share(row: &CaseRow) -> f64 {
    if row.friction.is_some() {
        FRICTION
    } else {
        CONTACT
    }
}

/// Rows of one contact: a normal, two directions of friction, torsional friction, two directions of rolling friction.
/// `sides` gives what a direction (an angular one or not) acts on.
fn add_contact(case: &mut Case, sides: impl Fn([f64; 3], bool) -> Vec<(usize, Vec<f64>)>, targets: [f64; 6]) {
    let normal = case.rows.len();
    let all = [(Z, false, 0.0), (X, false, 0.5), (Y, false, 0.5), (Z, true, 5e-3), (X, true, 1e-3), (Y, true, 1e-3)];
    for ((axis, angular, coefficient), target) in all.into_iter().zip(targets) {
        let mut row = CaseRow::new(sides(axis, angular), target, 0.0, [0.0, f64::INFINITY]);
        if normal < case.rows.len() {
            row.friction = Some(Friction { normal, coefficient, cap: 1e18 });
        }
        case.rows.push(row);
    }
    set_cfm(case, normal, contact_share);
}

/// Boxes that rest on each other, each with four contacts below.
pub fn stack(count: usize) -> Case {
    let mut case = boxes(count);
    for body in 0..count {
        for corner in 0..4 {
            let (x, y) = (0.05 - 0.1 * f64::from(corner % 2), 0.05 - 0.1 * f64::from(corner / 2));
            let sides = |axis, angular| {
                let mut sides =
                    vec![(body, if angular { about(axis, 1.0) } else { at_point([x, y, -0.05], axis, 1.0) })];
                if body > 0 {
                    let below = if angular { about(axis, -1.0) } else { at_point([x, y, 0.05], axis, -1.0) };
                    sides.push((body - 1, below));
                }
                sides
            };
            let normal = if body > 0 { 0.0 } else { FALL };
            add_contact(&mut case, sides, [normal, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
    }
    case
}

/// Courses of boxes, each box on two of the course below.
pub fn wall(length: usize, height: usize) -> Case {
    let mut case = boxes(length * height);
    for body in 0..length * height {
        let (course, at) = (body / length, body % length);
        for (corner, lean) in [(0, -1.0), (1, -1.0), (2, 1.0), (3, 1.0)] {
            let y = 0.05 - 0.1 * f64::from(corner % 2);
            let arm = [0.04 * lean, y, -0.05];
            let aside = if course % 2 == 1 { f64::from(lean > 0.0) } else { -f64::from(lean < 0.0) };
            let below = (at as f64 + aside).clamp(0.0, (length - 1) as f64) as usize;
            let sides = |axis, angular| {
                let mut sides = vec![(body, if angular { about(axis, 1.0) } else { at_point(arm, axis, 1.0) })];
                if course > 0 {
                    let x = if below as f64 == at as f64 + aside { -0.01 * lean } else { 0.04 * lean };
                    let jacobian = if angular { about(axis, -1.0) } else { at_point([x, y, 0.05], axis, -1.0) };
                    sides.push((body - length + below - at, jacobian));
                }
                sides
            };
            let normal = if course > 0 { 0.0 } else { FALL };
            add_contact(&mut case, sides, [normal, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
    }
    case
}

/// Boxes on hinges, the first of which is fixed.
pub fn hinges(count: usize) -> Case {
    let mut case = boxes(count);
    for body in 0..count {
        for k in 0..5 {
            let axis = [X, Y, Z, X, Z][k];
            let jacobian = |arm, sign| if k < 3 { at_point([arm, 0.0, 0.0], axis, sign) } else { about(axis, sign) };
            let mut sides = vec![(body, jacobian(-0.05, 1.0))];
            if body > 0 {
                sides.push((body - 1, jacobian(0.05, -1.0)));
            }
            let target = if k == 2 && body == 0 { FALL } else { 0.01 * body as f64 * f64::from(u8::from(k == 1)) };
            case.rows.push(CaseRow::new(sides, target, 0.0, [f64::NEG_INFINITY, f64::INFINITY]));
        }
    }
    set_cfm(&mut case, 0, |_| JOINT);
    case
}

/// A link of an articulation: where it is, and its Jacobian (linear velocity of that point, then angular), six rows.
struct Link {
    at: [f64; 3],
    jacobian: DMatrix<f64>,
}

/// An articulation with a free base and revolute joints, a tree of links that get lighter outwards, without rows.
fn articulation(random: &mut Random, size: usize) -> (Case, Vec<Link>) {
    let mut links: Vec<Link> = vec![Link { at: [0.0; 3], jacobian: DMatrix::identity(6, size) }];
    let mut masses = vec![5.0];
    for joint in 6..size {
        let parent = links.len() - 1 - random.below(links.len().min(3));
        let step: [f64; 3] = std::array::from_fn(|_| 0.2 * random.signed());
        let at: [f64; 3] = std::array::from_fn(|k| links[parent].at[k] + step[k]);
        let mut jacobian = links[parent].jacobian.clone();
        for k in 0..size {
            let turn = std::array::from_fn(|i| jacobian[(3 + i, k)]);
            let moved = cross(turn, step);
            (0..3).for_each(|i| jacobian[(i, k)] += moved[i]);
        }
        let axis: [f64; 3] = std::array::from_fn(|_| random.signed());
        let moved = cross(axis, step);
        for k in 0..3 {
            jacobian[(k, joint)] = moved[k];
            jacobian[(3 + k, joint)] = axis[k];
        }
        links.push(Link { at, jacobian });
        masses.push(0.7 * masses[parent]);
    }
    let mut mass = DMatrix::zeros(size, size);
    for (link, m) in links.iter().zip(masses) {
        let inertia: DMatrix<f64> = DMatrix::from_fn(6, 6, |i, j| if i != j { 0.0 } else { [m, 2e-3 * m][i / 3] });
        mass += link.jacobian.transpose() * inertia * &link.jacobian;
    }
    let inverse = mass.cholesky().expect("a mass matrix is positive definite").inverse();
    (Case { rigid: 0, inverse_masses: vec![inverse], rows: Vec::new() }, links)
}

/// An articulation of `size` velocity components that falls onto contacts at its links, `joints` of which are held.
/// Friction is `grip` times the usual one.
pub fn machine(seed: u64, size: usize, joints: usize, contacts: usize, grip: f64) -> Case {
    let random = &mut Random::new(seed);
    let (mut case, links) = articulation(random, size);
    let mut before = random.vector(size);
    before.iter_mut().for_each(|v| *v *= 0.1 * FALL);
    before[2] -= FALL;
    let along = |jacobian: &[f64]| -> f64 { jacobian.iter().zip(&before).map(|(j, v)| j * v).sum() };
    for k in 0..joints {
        let joint = 6 + k * (size - 6) / joints;
        let jacobian: Vec<f64> = (0..size).map(|i| f64::from(u8::from(i == joint))).collect();
        let target = -along(&jacobian);
        case.rows.push(CaseRow::new(vec![(0, jacobian)], target, 0.0, [f64::NEG_INFINITY, f64::INFINITY]));
    }
    set_cfm(&mut case, 0, |_| JOINT);
    for _ in 0..contacts {
        let link = &links[random.below(links.len())];
        let arm: [f64; 3] = std::array::from_fn(|_| 0.05 * random.signed());
        let jacobian = |axis: [f64; 3], angular: bool| -> Vec<f64> {
            let local = if angular { about(axis, 1.0) } else { at_point(arm, axis, 1.0) };
            (link.jacobian.transpose() * nalgebra::DVector::from_vec(local)).as_slice().to_vec()
        };
        let directions = [(Z, false), (X, false), (Y, false), (Z, true), (X, true), (Y, true)];
        let targets = directions.map(|(axis, angular)| -along(&jacobian(axis, angular)));
        let first = case.rows.len();
        add_contact(&mut case, |axis, angular| vec![(0, jacobian(axis, angular))], targets);
        for row in &mut case.rows[first..] {
            if let Some(friction) = &mut row.friction {
                friction.coefficient *= grip;
            }
        }
    }
    case
}

/// Makes the solution the guess of the next problem.
pub fn warm_start(case: &mut Case, solver: &Solver) {
    for (row, (&x, &state)) in case.rows.iter_mut().zip(solver.impulses().iter().zip(solver.states())) {
        (row.x, row.state) = (x, state);
    }
}
