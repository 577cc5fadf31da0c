//! Solutions against the definition, by enumeration and by dense algebra.

use ambf_dynamics::mlcp::{Budget, Outcome, Solver, State};
use nalgebra::{DMatrix, DVector};

use super::case::{Case, CaseRow, Random};

const NONE: f64 = f64::INFINITY;

fn random_bounds(random: &mut Random) -> [f64; 2] {
    let (a, b) = (random.signed().abs(), random.signed().abs());
    [[-NONE, NONE], [0.0, NONE], [-NONE, 0.0], [-a, b], [0.1 * a, 0.1 * a + b], [-0.3 * a, NONE], [a, a]]
        [random.below(7)]
}

/// The only solution, by trying every active set.
fn enumerate(matrix: &DMatrix<f64>, targets: &DVector<f64>, bounds: &[[f64; 2]]) -> DVector<f64> {
    let n = bounds.len();
    for code in 0..3_usize.pow(n as u32) {
        let digits: Vec<usize> = (0..n).map(|i| code / 3_usize.pow(i as u32) % 3).collect();
        if (0..n).any(|i| digits[i] > 0 && !bounds[i][digits[i] - 1].is_finite()) {
            continue;
        }
        let (mut system, mut right) = (matrix.clone(), targets.clone());
        for i in (0..n).filter(|&i| digits[i] > 0) {
            system.row_mut(i).fill(0.0);
            system[(i, i)] = 1.0;
            right[i] = bounds[i][digits[i] - 1];
        }
        let Some(x) = system.lu().solve(&right) else { continue };
        let w = matrix * &x - targets;
        let holds = |i: usize| match digits[i] {
            0 => bounds[i][0] - 1e-9 <= x[i] && x[i] <= bounds[i][1] + 1e-9,
            _ if bounds[i][0] == bounds[i][1] => true,
            1 => w[i] >= -1e-9,
            _ => w[i] <= 1e-9,
        };
        if (0..n).all(holds) {
            return x;
        }
    }
    panic!("no active set holds");
}

#[test]
fn random_problems_have_the_solution_that_enumeration_finds() {
    let mut at_bounds = 0;
    for seed in 0..120 {
        let random = &mut Random::new(seed + 1);
        let mut case = Case::random(random, 2, &[3, 1]);
        for _ in 0..1 + random.below(if seed % 10 == 0 { 8 } else { 6 }) {
            // Some rows repeat the one before, so that only CFM tells them apart.
            let sides = match case.rows.last() {
                Some(row) if random.below(4) == 0 => row.sides.clone(),
                _ => case.random_sides(random),
            };
            let bounds = random_bounds(random);
            let mut row = CaseRow::new(sides, random.signed(), 1e-3 + 0.01 * random.signed().abs(), bounds);
            row.state = [State::Free, State::Low, State::High][random.below(3)];
            case.rows.push(row);
        }
        let bounds: Vec<[f64; 2]> = case.rows.iter().map(|row| [row.low, row.high]).collect();
        let expected = enumerate(&case.matrix(), &case.targets(), &bounds);
        let mut solver = case.solver();
        assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved, "seed {seed}");
        let found = DVector::from_column_slice(solver.impulses());
        assert!((&found - &expected).amax() < 1e-4 * (1.0 + expected.amax()), "seed {seed}: {found} for {expected}");
        at_bounds += solver.states().iter().filter(|&&state| state != State::Free).count();
        let velocities = case.inverse_mass() * case.jacobian().transpose() * found;
        assert!((velocities - DVector::from_column_slice(solver.velocities())).amax() < 1e-9, "seed {seed}");
    }
    assert!(at_bounds > 50, "{at_bounds}");
}

#[test]
fn friction_is_within_its_cone_and_opposes_sliding() {
    let mut solved = 0;
    for seed in 0..100 {
        let random = &mut Random::new(seed + 1000);
        let mut case = Case::random(random, 4, &[4]);
        for _ in 0..1 + random.below(12) {
            let target = random.signed() + 0.2;
            case.add_contact(random, target);
        }
        let mut solver = case.solver();
        let outcome = solver.solve(Budget::UNLIMITED);
        let residual = case.residual(solver.impulses());
        assert!((residual - solver.statistics().residual).abs() < 1e-9 + 1e-6 * residual, "seed {seed}: {residual}");
        match outcome {
            Outcome::Solved => {
                assert!(residual < 3e-6, "seed {seed}: {residual}");
                solved += 1;
            }
            Outcome::Approximate { residual: reported } => assert_eq!(reported, solver.statistics().residual),
            Outcome::NotFinite => panic!("seed {seed}"),
        }
    }
    // Random directions of friction are far worse than those of a contact, which are at right angles to the normal.
    assert!(solved >= 90, "{solved}");
}

#[test]
fn an_envelope_gives_what_dense_algebra_does() {
    let random = &mut Random::new(5);
    let mut case = Case::random(random, 30, &[7, 2]);
    for body in 0..32 {
        // A chain whose bodies are numbered in disorder.
        let (a, b) = (body * 11 % 32, (body + 1) * 11 % 32);
        for _ in 0..2 {
            let mut sides = vec![(a, random.vector(case.size(a)))];
            if body < 31 {
                sides.push((b, random.vector(case.size(b))));
            }
            case.rows.push(CaseRow::new(sides, random.signed(), 1e-6, [-NONE, NONE]));
        }
    }
    let mut solver = Solver::new();
    case.fill(&mut solver);
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    let expected = case.matrix().cholesky().unwrap().solve(&case.targets());
    let found = DVector::from_column_slice(solver.impulses());
    assert!((found - &expected).amax() < 1e-9 * expected.amax());
    let dense = (case.rows.len() as f64).powi(3) / 6.0;
    assert!(solver.prepare(30, &[7, 2]).unwrap() < dense / 20.0, "the envelope of a chain is narrow");
}

#[test]
fn identical_contacts_share_what_one_would_carry() {
    for cfm in [0.0, 1e-6] {
        let random = &mut Random::new(7);
        let mut case = Case::random(random, 1, &[]);
        let row = CaseRow::new(vec![(0, random.vector(6))], 1.0, cfm, [0.0, NONE]);
        case.rows = vec![row; 20];
        let mut solver = case.solver();
        assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
        let sum: f64 = solver.impulses().iter().sum();
        assert!((sum * case.response()[(0, 0)] - 1.0).abs() < 1e-5, "{sum}");
        assert!(solver.impulses().iter().all(|&x| x >= 0.0));
    }
}

#[test]
fn hard_rows_that_contradict_each_other_are_not_called_solved() {
    let random = &mut Random::new(8);
    let mut case = Case::random(random, 1, &[]);
    let sides = vec![(0, random.vector(6))];
    case.rows = [1.0, -1.0].map(|target| CaseRow::new(sides.clone(), target, 0.0, [-NONE, NONE])).to_vec();
    let mut solver = case.solver();
    let outcome = solver.solve(Budget::UNLIMITED);
    assert!(matches!(outcome, Outcome::Approximate { residual } if residual > 0.9 && residual < 2.1), "{outcome:?}");
}
