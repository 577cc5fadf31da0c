//! Correction of positions on the same rows.

use ambf_dynamics::mlcp::{Budget, Friction, Outcome, Solver, State};
use nalgebra::{DMatrix, DVector};

use super::case::{Case, CaseRow, Random};

const NONE: f64 = f64::INFINITY;
const SHARE: f64 = 1e-4;

#[test]
fn only_the_signs_of_bounds_count_and_friction_takes_no_part() {
    let random = &mut Random::new(3);
    let mut case = Case::random(random, 3, &[4]);
    let all = [[-1e-9, 1e-9], [0.0, 1e-9], [-1e-9, 0.0], [-NONE, NONE], [0.0, NONE], [0.0, 0.0]];
    for bounds in all {
        let sides = case.random_sides(random);
        case.rows.push(CaseRow::new(sides, random.signed(), 0.0, bounds));
    }
    let sides = case.random_sides(random);
    let mut friction = CaseRow::new(sides.clone(), 1.0, 0.0, [0.0, 0.0]);
    friction.friction = Some(Friction { normal: 4, coefficient: 1.0, cap: NONE });
    let mut motor = CaseRow::new(sides, 1.0, 0.0, [-1.0, 1.0]);
    motor.in_positions = false;
    case.rows.extend([friction, motor]);
    let mut solver = case.solver();
    assert_eq!(solver.solve_positions(None, None, SHARE, Budget::UNLIMITED), Outcome::Solved);
    let x = solver.position_impulses().to_vec();
    assert_eq!(x[5..], [0.0; 3], "a row without impulses, friction, a motor");
    assert!(x[0].abs() > 1e-3 && x[1] >= 0.0 && x[2] <= 0.0 && x[4] >= 0.0, "{x:?}");
    let response = case.response();
    let w = &response * DVector::from_column_slice(&x) - case.targets();
    for (i, row) in case.rows.iter().enumerate().take(5) {
        let excess = w[i] + SHARE * response[(i, i)] * x[i];
        let holds = match (x[i] == 0.0, row.low < 0.0, row.high > 0.0) {
            (true, false, true) => excess >= -1e-6,
            (true, true, false) => excess <= 1e-6,
            _ => excess.abs() < 1e-6,
        };
        assert!(holds, "row {i}: {excess}");
    }
    let velocities = case.inverse_mass() * case.jacobian().transpose() * DVector::from_column_slice(&x);
    assert!((velocities - DVector::from_column_slice(solver.position_velocities())).amax() < 1e-12);
    assert!(solver.impulses().iter().all(|&x| x == 0.0), "velocities were not solved for");
}

#[test]
fn a_loaded_limit_stays_closed() {
    let mut case = Case::random(&mut Random::new(3), 1, &[]);
    let along = |axes: [f64; 2]| vec![(0, [axes[0], axes[1], 0.0, 0.0, 0.0, 0.0].to_vec())];
    // A limit that the body approaches, and a row whose correction would move the body off it.
    let limit = CaseRow { stays_loaded: true, ..CaseRow::new(along([1.0, 0.0]), 1.0, 0.0, [0.0, NONE]) };
    case.rows.extend([limit, CaseRow::new(along([1.0, 1.0]), 0.0, 0.0, [-NONE, NONE])]);
    let targets = [-0.2, 0.5];
    let moved = |solver: &mut Solver| {
        assert_eq!(solver.solve_positions(Some(&targets), None, SHARE, Budget::UNLIMITED), Outcome::Solved);
        let velocities = solver.position_velocities();
        assert!((velocities[0] + velocities[1] - 0.5).abs() < 1e-3, "{velocities:?}");
        velocities[0]
    };
    let mut solver = case.solver();
    assert!(moved(&mut solver) > 0.05, "velocities were not solved for: it has no load");
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    assert!(solver.impulses()[0] > 0.0);
    assert!(moved(&mut solver).abs() < 1e-3);
    case.rows[0].target = -1.0;
    let mut solver = case.solver();
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    assert_eq!(solver.impulses()[0], 0.0);
    assert!(moved(&mut solver) > 0.05, "the body leaves the limit");
}

#[test]
fn what_remains_of_the_targets_is_told_apart_from_what_could_not_be_pushed() {
    let mut case = Case::random(&mut Random::new(3), 1, &[]);
    let along = |axis: usize| vec![(0, (0..6).map(|k| f64::from(u8::from(k == axis))).collect())];
    // Two that contradict each other, one alone, one that may open, a drive.
    case.rows.push(CaseRow::new(along(0), 1.0, 0.0, [-NONE, NONE]));
    case.rows.push(CaseRow::new(along(0), -1.0, 0.0, [-NONE, NONE]));
    case.rows.push(CaseRow::new(along(1), 0.5, 0.0, [-NONE, NONE]));
    case.rows.push(CaseRow::new(along(2), -2.0, 0.0, [0.0, NONE]));
    case.rows.push(CaseRow { in_positions: false, ..CaseRow::new(along(3), 3.0, 0.0, [-NONE, NONE]) });
    let mut solver = case.solver();
    assert_eq!(solver.solve_positions(None, None, SHARE, Budget::UNLIMITED), Outcome::Solved);
    let left = solver.position_errors();
    let velocities = solver.position_velocities();
    for (found, expected) in left.iter().zip([1.0 - velocities[0], -1.0 - velocities[0], 0.5 - velocities[1], 0.0, 0.0])
    {
        assert!((found - expected).abs() < 1e-9, "{left:?} of {velocities:?}");
    }
    assert!(velocities[0].abs() < 0.1 && (velocities[1] - 0.5).abs() < 1e-2, "{velocities:?}");
}

#[test]
fn rows_that_contradict_each_other_end_in_a_bounded_compromise() {
    for seed in 1..50 {
        let random = &mut Random::new(seed);
        let mut case = Case::random(random, 2, &[3]);
        for _ in 0..4 {
            let sides = case.random_sides(random);
            let opposite = sides.iter().map(|(body, j)| (*body, j.iter().map(|value| -value).collect())).collect();
            for sides in [sides.clone(), sides, opposite] {
                case.rows.push(CaseRow::new(sides, random.signed().abs(), 0.0, [0.0, NONE]));
            }
        }
        // More rows than coordinates.
        for _ in 0..20 {
            let sides = case.random_sides(random);
            case.rows.push(CaseRow::new(sides, random.signed(), 0.0, [-NONE, NONE]));
        }
        let mut solver = case.solver();
        assert_eq!(solver.solve_positions(None, None, SHARE, Budget::UNLIMITED), Outcome::Solved, "seed {seed}");
        let (response, velocities) = (case.response(), DVector::from_column_slice(solver.position_velocities()));
        let mass: DMatrix<f64> = case.inverse_mass().try_inverse().unwrap();
        let energy = velocities.dot(&(mass * &velocities)) / 2.0;
        let bound = |(i, row): (usize, &CaseRow)| row.target.powi(2) / (2.0 * SHARE * response[(i, i)]);
        let bound: f64 = case.rows.iter().enumerate().map(bound).sum();
        assert!(energy <= bound, "seed {seed}: {energy} J above {bound} J");
    }
}

#[test]
fn two_equal_and_opposite_wishes_cancel() {
    let random = &mut Random::new(9);
    let mut case = Case::random(random, 1, &[]);
    let jacobian = random.vector(6);
    let opposite = jacobian.iter().map(|value| -value).collect();
    case.rows = vec![
        CaseRow::new(vec![(0, jacobian)], 1.0, 0.0, [0.0, NONE]),
        CaseRow::new(vec![(0, opposite)], 1.0, 0.0, [0.0, NONE]),
    ];
    let mut solver = case.solver();
    solver.solve_positions(None, None, SHARE, Budget::UNLIMITED);
    assert!(solver.position_velocities().iter().all(|v| v.abs() < 1e-6), "{:?}", solver.position_velocities());
}

#[test]
fn targets_may_be_given_and_the_active_set_is_a_guess_for_the_next_step() {
    let random = &mut Random::new(11);
    let mut case = Case::random(random, 4, &[]);
    for _ in 0..12 {
        let sides = case.random_sides(random);
        case.rows.push(CaseRow::new(sides, random.signed(), 0.0, [0.0, NONE]));
    }
    let mut solver = case.solver();
    solver.solve_positions(None, None, SHARE, Budget::UNLIMITED);
    let (impulses, states) = (solver.position_impulses().to_vec(), solver.position_states().to_vec());
    assert!(solver.statistics().pivots > 0 && states.contains(&State::Low), "{states:?}");
    let doubled: Vec<f64> = case.rows.iter().map(|row| 2.0 * row.target).collect();
    assert_eq!(solver.solve_positions(Some(&doubled), Some(&states), SHARE, Budget::UNLIMITED), Outcome::Solved);
    assert_eq!((solver.statistics().pivots, solver.statistics().factorisations), (0, 1));
    for (x, half) in solver.position_impulses().iter().zip(&impulses) {
        assert!((x - 2.0 * half).abs() < 1e-9, "{x} {half}");
    }
}
