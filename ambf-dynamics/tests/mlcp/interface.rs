//! Wrong problems, and the C interface.

use ambf_dynamics::mlcp::ffi::{self, AmbMlcpRow, AmbMlcpStatistics};
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

#[test]
fn the_table_of_functions_solves_like_the_solver() {
    let table = ffi::table();
    let none = std::ptr::null();
    let c_row = AmbMlcpRow {
        body: [0, -1],
        size: [6, 0],
        jacobian: [JACOBIAN.as_ptr(), none],
        response: [RESPONSE.as_ptr(), none],
        target: 1.0,
        bias: 0.0,
        position_target: 0.5,
        cfm: 0.0,
        position_cfm: 0.0,
        yielding_cfm: 0.0,
        fed: 0.0,
        low: 0.0,
        high: 0.1,
        normal: -1,
        friction: 0.0,
        cap: 0.0,
        state: 0,
        x: 0.0,
        in_positions: 1,
        stays_loaded: 0,
        is_drive: 0,
    };
    let mut statistics = AmbMlcpStatistics::default();
    // SAFETY: the solver is used by this thread only, pointers are read before it is freed, and each row has six
    // numbers.
    unsafe {
        let solver = (table.create)();
        assert_eq!((table.add_row)(solver, &c_row), 0);
        assert_eq!((table.solve)(solver, 0.0, 1e6), ffi::NOT_FINITE, "not prepared");
        assert_eq!((table.prepare)(solver, 0, std::ptr::null(), 0), -1.0, "there is no body");
        assert!((table.prepare)(solver, 1, std::ptr::null(), 0) >= 0.0);
        assert_eq!((table.solve)(solver, 0.0, 1e6), ffi::SOLVED);
        assert_eq!((*(table.impulses)(solver), *(table.states)(solver)), (0.1, 2));
        assert_eq!(*(table.velocities)(solver).add(5), 0.4);
        let null = std::ptr::null();
        assert_eq!((table.solve_positions)(solver, null, std::ptr::null(), 1e-4, 1.0, 1e6), ffi::SOLVED);
        assert!((*(table.position_impulses)(solver) - 0.125 / 1.0001).abs() < 1e-9);
        // Its CFM is multiplied by the damping.
        assert_eq!((table.solve_positions)(solver, null, std::ptr::null(), 1e-4, 100.0, 1e6), ffi::SOLVED);
        assert!((*(table.position_impulses)(solver) - 0.125 / 1.01).abs() < 1e-9);
        let doubled = (table.solve_positions)(solver, [1.0].as_ptr(), [0].as_ptr(), 1e-4, 1.0, 1e6);
        assert_eq!((doubled, *(table.position_states)(solver)), (ffi::SOLVED, 0));
        assert!((*(table.position_velocities)(solver) - 0.5 / 1.0001).abs() < 1e-9);
        (table.statistics)(solver, &mut statistics);
        assert_eq!((statistics.rows, statistics.factorisations), (1, 1));
        (table.clear)(solver);
        let negative = AmbMlcpRow { size: [-1, 0], ..c_row };
        assert_eq!((table.add_row)(solver, &negative), -1);
        (table.destroy)(solver);
        (table.destroy)(std::ptr::null_mut());
    }
}
