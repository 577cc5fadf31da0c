//! Wrong problems.

use ambf_dynamics::mlcp::{Budget, Friction, Outcome, ProblemError, Row, Side, Solver};

const JACOBIAN: [f64; 6] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.5];
const RESPONSE: [f64; 6] = [2.0, 0.0, 0.0, 0.0, 0.0, 4.0];

fn row(body: usize, components: usize) -> Row<'static> {
    let side = Side { body, jacobian: &JACOBIAN[..components], response: &RESPONSE[..components] };
    Row { sides: [Some(side), None], target: 1.0, ..Row::default() }
}

#[test]
fn wrong_rows_are_refused_and_solve_to_nothing() {
    let mut solver = Solver::new();
    solver.add_row(&row(1, 6));
    assert_eq!(solver.prepare(1, &[]), Err(ProblemError::NoBody { row: 0, body: 1, bodies: 1 }));
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::NotFinite);
    assert_eq!(solver.impulses(), [0.0]);
    let size = ProblemError::WrongSize { row: 0, body: 1, expected: 4, found: 6 };
    assert_eq!(solver.prepare(1, &[4]), Err(size));
    assert!(solver.prepare(2, &[]).is_ok());
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    solver.clear();
    solver.add_row(&Row { friction: Some(Friction { normal: 3, coefficient: 1.0, cap: 1.0 }), ..row(0, 6) });
    assert_eq!(solver.prepare(1, &[]), Err(ProblemError::NoNormal { row: 0, normal: 3, rows: 1 }));
}

#[test]
fn numbers_that_are_not_finite_move_nothing() {
    let mut solver = Solver::new();
    let bad = [f64::NAN; 6];
    let side = Side { body: 0, jacobian: &bad, response: &RESPONSE };
    for wrong in [
        Row { target: f64::NAN, ..row(0, 6) },
        Row { cfm: f64::INFINITY, ..row(0, 6) },
        Row { low: f64::NAN, ..row(0, 6) },
        Row { sides: [Some(side), None], ..row(0, 6) },
    ] {
        solver.clear();
        solver.add_row(&row(0, 6));
        solver.add_row(&wrong);
        solver.prepare(1, &[]).unwrap();
        assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::NotFinite);
        assert_eq!((solver.impulses(), solver.velocities()), (&[0.0; 2][..], &[0.0; 6][..]));
    }
}
