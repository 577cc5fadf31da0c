//! What islands as an engine makes them take.

use ambf_dynamics::mlcp::{Budget, Outcome, Statistics};

use super::case::Case;
use super::scenes::{hinges, machine, stack, wall, warm_start};

/// Budget of an engine, in multiplications.
fn budget(case: &Case) -> Budget {
    Budget(2e5 + 4000.0 * case.rows.len() as f64)
}

/// Largest violation of complementarity by dense algebra, which the outcome must be right about.
fn checked(case: &Case) -> (f64, Statistics) {
    let mut solver = case.solver();
    let outcome = solver.solve(budget(case));
    let residual = case.residual(solver.impulses());
    let scale = case.rows.iter().fold(0.0, |scale: f64, row| scale.max(row.target.abs()));
    assert_eq!(outcome, Outcome::Solved, "{:?}", solver.statistics());
    assert!(residual <= 1.1e-6 * scale, "{residual} of {scale}: {:?}", solver.statistics());
    (residual, solver.statistics())
}

#[test]
fn boxes_at_rest_and_chains_take_one_factorisation() {
    for (case, most) in [(stack(1), 4e3), (stack(2), 1.2e4), (hinges(10), 1e4)] {
        let (_, statistics) = checked(&case);
        assert_eq!((statistics.factorisations, statistics.pivots, statistics.sweeps), (1, 0, 0));
        assert!(statistics.multiplications < most, "{statistics:?}");
    }
}

#[test]
fn the_work_of_contacts_on_an_articulation_grows_with_their_number_only() {
    let work = |contacts: usize| checked(&machine(3, 44, 2, contacts, 1e3)).1.multiplications;
    let [few, many] = [18, 72].map(work);
    assert!(many < 4.5 * few, "{few} {many}");
}

#[test]
fn the_least_of_both_costs_is_told() {
    let cost = |case: &Case| {
        let sizes: Vec<usize> = (case.rigid..case.inverse_masses.len()).map(|body| case.size(body)).collect();
        case.solver().prepare(case.rigid, &sizes).unwrap()
    };
    // A hinge of five rows on each of the two bodies with six components: rows are the fewer.
    assert!(cost(&hinges(10)) < 2000.0);
    // Rows by squares of six components, and a sixth of their cube.
    assert_eq!(cost(&stack(1)), 24.0 * 21.0 + 45.5);
}

#[test]
fn a_solution_is_not_solved_for_again() {
    let mut case = machine(4, 38, 2, 20, 1e3);
    let mut solver = case.solver();
    assert_eq!(solver.solve(budget(&case)), Outcome::Solved);
    let velocities = solver.velocities().to_vec();
    warm_start(&mut case, &solver);
    case.fill(&mut solver);
    assert_eq!(solver.solve(budget(&case)), Outcome::Solved);
    assert_eq!((solver.statistics().factorisations, solver.statistics().sweeps), (0, 0));
    for (now, before) in solver.velocities().iter().zip(&velocities) {
        assert!((now - before).abs() < 1e-12, "{now} {before}");
    }
}

#[test]
fn a_pile_whose_guess_is_nearly_right_leaves_most_of_the_budget() {
    let mut case = wall(10, 7);
    let mut solver = case.solver();
    let Budget(whole) = budget(&case);
    let mut spent = Vec::new();
    for _ in 0..4 {
        case.fill(&mut solver);
        solver.solve(Budget(whole));
        let statistics = solver.statistics();
        assert!(statistics.residual < 1e-4, "{statistics:?}");
        spent.push(statistics.multiplications / whole);
        warm_start(&mut case, &solver);
    }
    assert!(spent[3] < 0.4, "{spent:?}");
}
