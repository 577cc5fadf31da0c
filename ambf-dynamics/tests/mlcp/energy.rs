//! Impulses that are asked to stop what moves never add kinetic energy.

use ambf_dynamics::mlcp::{Budget, Outcome};
use nalgebra::DVector;

use super::case::{Case, CaseRow, Random};

/// Bodies that move, and rows that want them to rest. Returns the case and the velocities.
fn moving(seed: u64, contacts: bool) -> (Case, DVector<f64>) {
    let random = &mut Random::new(seed);
    let mut case = Case::random(random, 4, &[5]);
    for _ in 0..1 + random.below(8) {
        if contacts && random.below(2) == 0 {
            case.add_contact(random, 0.0);
            continue;
        }
        let bound = random.signed().abs();
        let all = [[f64::NEG_INFINITY, f64::INFINITY], [0.0, f64::INFINITY], [-bound, bound], [-bound, 0.0]];
        let (sides, bounds) = (case.random_sides(random), all[random.below(4)]);
        case.rows.push(CaseRow::new(sides, 0.0, 1e-6, bounds));
    }
    let velocities = DVector::from_vec(random.vector(29));
    let along = case.jacobian() * &velocities;
    for (row, speed) in case.rows.iter_mut().zip(along.iter()) {
        row.target = -speed;
    }
    (case, velocities)
}

/// Kinetic energy before and after.
fn energies(case: &Case, before: &DVector<f64>, change: &[f64]) -> [f64; 2] {
    let mass = case.inverse_mass().try_inverse().unwrap();
    let after = before + DVector::from_column_slice(change);
    [before.dot(&(&mass * before)) / 2.0, after.dot(&(&mass * &after)) / 2.0]
}

#[test]
fn a_solution_takes_energy_or_leaves_it() {
    let mut lost = 0;
    for seed in 1..200 {
        let (case, velocities) = moving(seed, true);
        let mut solver = case.solver();
        if solver.solve(Budget::UNLIMITED) != Outcome::Solved {
            continue;
        }
        let [before, after] = energies(&case, &velocities, solver.velocities());
        assert!(after <= before * (1.0 + 1e-9), "seed {seed}: {before} J became {after} J");
        lost += usize::from(after < 0.99 * before);
    }
    assert!(lost > 120, "{lost}");
}

#[test]
fn sweeps_without_friction_take_energy_or_leave_it() {
    for seed in 1..100 {
        let (case, velocities) = moving(seed, false);
        let mut solver = case.solver();
        solver.solve(Budget(0.0));
        assert_eq!(solver.statistics().factorisations, 0);
        let [before, after] = energies(&case, &velocities, solver.velocities());
        assert!(after <= before * (1.0 + 1e-9), "seed {seed}: {before} J became {after} J");
    }
}

#[test]
fn nothing_that_a_small_budget_returns_adds_energy() {
    let mut unsolved = 0;
    for seed in 1..400 {
        let (mut case, velocities) = moving(seed, true);
        let random = &mut Random::new(seed + 1000);
        // Impulses of a step before that have nothing to do with this one.
        for row in &mut case.rows {
            row.x = 10.0 * random.signed();
        }
        let mut solver = case.solver();
        let outcome = solver.solve(Budget(2000.0 * random.signed().abs()));
        let [before, after] = energies(&case, &velocities, solver.velocities());
        assert!(after <= before * (1.0 + 1e-9), "seed {seed}: {before} J became {after} J");
        unsolved += usize::from(outcome != Outcome::Solved);
    }
    assert!(unsolved > 100, "{unsolved}");
}

#[test]
fn aims_are_given_up_where_they_add_energy() {
    let mut given_up = 0;
    for seed in 1..400 {
        let (mut case, velocities) = moving(seed, true);
        let random = &mut Random::new(seed + 2000);
        for row in &mut case.rows {
            // Unilateral rows that ask to be left with up to twice the speed at which they are hit.
            if row.friction.is_none() && row.low == 0.0 && row.target > 0.0 {
                row.bias = row.target * 2.0 * random.signed().abs();
                row.target += row.bias;
            }
        }
        let mut solver = case.solver();
        if solver.solve(Budget::UNLIMITED) != Outcome::Solved {
            continue;
        }
        let [before, after] = energies(&case, &velocities, solver.velocities());
        let asked: f64 = case.rows.iter().zip(solver.impulses()).map(|(row, x)| (row.bias * x).abs()).sum();
        assert!(after <= before + 0.02 * asked + 1e-9, "seed {seed}: {before} J became {after} J");
        let along = case.jacobian() * DVector::from_column_slice(solver.velocities());
        let rests = |(row, (x, along)): (&CaseRow, (&f64, &f64))| {
            row.bias > 0.0 && *x > 1e-6 && (along + row.cfm * x - (row.target - row.bias)).abs() < 1e-6
        };
        given_up += usize::from(case.rows.iter().zip(solver.impulses().iter().zip(along.iter())).any(rests));
    }
    assert!(given_up > 3, "{given_up}");
}
