//! What a budget allows, and what the outcome then says.

use ambf_dynamics::mlcp::{Budget, Outcome};

use nalgebra::DVector;

use super::case::{Case, CaseRow, Random};

/// A chain of bodies that hang on each other, on which sweeps converge badly.
fn chain(bodies: usize) -> Case {
    let random = &mut Random::new(2);
    let mut case = Case::random(random, bodies, &[]);
    for body in 0..bodies {
        for _ in 0..3 {
            let mut sides = vec![(body, random.vector(6))];
            if body > 0 {
                sides.push((body - 1, random.vector(6)));
            }
            case.rows.push(CaseRow::new(sides, random.signed(), 1e-6, [f64::NEG_INFINITY, f64::INFINITY]));
        }
    }
    case
}

#[test]
fn without_a_budget_a_few_sweeps_are_made_and_the_outcome_says_so() {
    let case = chain(40);
    let mut solver = case.solver();
    let outcome = solver.solve(Budget(0.0));
    let statistics = solver.statistics();
    assert_eq!((statistics.rows, statistics.factorisations, statistics.sweeps), (120, 0, 4));
    let residual = case.residual(solver.impulses());
    assert!(residual > 1e-3);
    assert!(matches!(outcome, Outcome::Approximate { residual: told } if (told - residual).abs() < 1e-9));
}

#[test]
fn more_work_gives_smaller_residuals_and_stays_within_the_budget() {
    let random = &mut Random::new(12);
    let mut case = Case::random(random, 0, &[30]);
    // All rows share one body: a factorisation with all that it needs takes as much as twenty sweeps.
    for _ in 0..100 {
        let target = 1.0 + 0.1 * random.signed();
        case.rows.push(CaseRow::new(vec![(0, random.vector(30))], target, 100.0, [0.0, f64::INFINITY]));
    }
    let mut solver = case.solver();
    let mut last = f64::INFINITY;
    for budget in [0.0, 4e4, 6e4, 1.2e5] {
        solver.solve(Budget(budget));
        let statistics = solver.statistics();
        assert_eq!(statistics.factorisations, 0, "{statistics:?}");
        assert!(statistics.multiplications < budget.max(24_400.0) + 6100.0, "{statistics:?}");
        assert!(statistics.residual < last, "{statistics:?} after {last}");
        last = statistics.residual;
    }
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    assert!(solver.statistics().factorisations > 0 && solver.statistics().residual <= 2e-6);
}

#[test]
fn a_chain_takes_one_factorisation() {
    let case = chain(40);
    let mut solver = case.solver();
    assert_eq!(solver.solve(Budget(1e5)), Outcome::Solved);
    let statistics = solver.statistics();
    assert_eq!((statistics.factorisations, statistics.sweeps, statistics.pivots), (1, 0, 0));
    assert!(statistics.residual <= 1e-6 && statistics.multiplications < 1e5);
}

#[test]
fn contacts_stay_within_bounds_and_twice_the_budget_whatever_it_is() {
    let random = &mut Random::new(4);
    let mut case = Case::random(random, 12, &[6]);
    for _ in 0..30 {
        let target = random.signed();
        case.add_contact(random, target);
    }
    let mut solver = case.solver();
    let mut whole = 0;
    for exponent in 0..24 {
        let budget = 100.0 * 2_f64.powi(exponent);
        let outcome = solver.solve(Budget(budget));
        let residual = case.residual(solver.impulses());
        let statistics = solver.statistics();
        assert!((residual - statistics.residual).abs() <= 1e-9 * (1.0 + residual), "{residual} {statistics:?}");
        // As much again for given friction, four sweeps, a last pass and what belongs to the iteration in which the
        // budget ends.
        assert!(statistics.multiplications <= 2.1 * budget + 2e4, "{budget}: {statistics:?}");
        whole += usize::from(outcome == Outcome::Solved);
    }
    assert!(whole > 0);
}

/// Largest error of an approximation in the joints, m/s or rad/s: it was of the order of the targets, and opened joints
/// where contacts had too many solutions.
#[test]
fn approximations_miss_contacts_and_no_joints() {
    let mut approximate = 0;
    for seed in 1..60 {
        let random = &mut Random::new(seed);
        let mut case = Case::random(random, 8, &[4]);
        for _ in 0..9 {
            let sides = case.random_sides(random);
            case.rows.push(CaseRow::new(sides, random.signed(), 1e-6, [f64::NEG_INFINITY, f64::INFINITY]));
        }
        for _ in 0..30 {
            let target = random.signed();
            case.add_contact(random, target);
        }
        let mut solver = case.solver();
        for budget in [4e5, 1e6, 2e6] {
            let outcome = solver.solve(Budget(budget));
            if outcome == Outcome::Solved || solver.statistics().factorisations == 0 {
                continue;
            }
            approximate += 1;
            let errors = case.matrix() * DVector::from_column_slice(solver.impulses()) - case.targets();
            let missed = errors.iter().take(9).fold(0.0, |most: f64, error| most.max(error.abs()));
            assert!(missed <= 1e-6, "seed {seed}, budget {budget}: {missed}");
        }
    }
    assert!(approximate > 20, "{approximate}");
}

/// Where friction has no solution, or none is found, all other rows have theirs: residuals of 1e4 m/s at the limits of
/// joints threw links kilometres away.
#[test]
fn approximations_miss_friction_alone() {
    let (mut approximate, mut exceeding) = (0, 0);
    for seed in 1..400 {
        let random = &mut Random::new(seed);
        let mut case = Case::random(random, 4, &[4]);
        for _ in 0..3 {
            let sides = case.random_sides(random);
            case.rows.push(CaseRow::new(sides, random.signed(), 1e-6, [f64::NEG_INFINITY, f64::INFINITY]));
        }
        for _ in 0..12 {
            let target = 1e3 * random.signed();
            case.add_contact(random, target);
        }
        for row in &mut case.rows {
            if let Some(friction) = &mut row.friction {
                friction.coefficient = 2.0;
            }
        }
        let mut solver = case.solver();
        solver.solve(Budget::UNLIMITED);
        // What is near a solution is left as it is.
        if solver.statistics().residual <= 1.0 {
            continue;
        }
        approximate += 1;
        let x = DVector::from_column_slice(solver.impulses());
        let errors = case.matrix() * &x - case.targets();
        for (row, (&x, &error)) in case.rows.iter().zip(x.iter().zip(&errors)).filter(|(row, _)| row.friction.is_none())
        {
            let missed = if row.low < 0.0 || x > 0.0 { error.abs() } else { (-error).max(0.0) };
            assert!(missed <= 2e-3, "seed {seed}: {missed}");
        }
        let objective = (&case.matrix() * &x / 2.0 - case.targets()).dot(&x);
        assert!(objective <= 0.0, "seed {seed}: {objective}");
        let exceeds = |(row, &x): (usize, &f64)| x.abs() > case.bounds(row, solver.impulses())[1] + 1e-9;
        exceeding += usize::from((0..).zip(&x).filter(|&(row, _)| case.rows[row].friction.is_some()).any(exceeds));
    }
    assert!(approximate > 20 && exceeding > 0, "{approximate}, {exceeding}");
}

#[test]
fn results_do_not_depend_on_earlier_problems() {
    let first = chain(10);
    let random = &mut Random::new(6);
    let mut second = Case::random(random, 5, &[3]);
    for _ in 0..6 {
        let target = random.signed();
        second.add_contact(random, target);
    }
    let mut solver = second.solver();
    solver.solve(Budget::UNLIMITED);
    let (impulses, statistics) = (solver.impulses().to_vec(), solver.statistics());
    solver.solve_positions(None, None, 1e-4, Budget::UNLIMITED);
    first.fill(&mut solver);
    solver.solve(Budget::UNLIMITED);
    second.fill(&mut solver);
    solver.solve(Budget::UNLIMITED);
    assert_eq!(solver.impulses(), impulses);
    assert_eq!(solver.statistics(), statistics);
}
