//! Islands of one or two bodies.

use super::*;
use crate::mlcp::{Side, State};

const H: f64 = 1e-3;
const UP: [f64; 6] = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
const LIMITS: Limits = Limits { base: 1e5, per_row: 1e3, saved: 1e6 };

pub(super) fn problem() -> Problem {
    Problem {
        time_step: H,
        sub_step: 4,
        rigid: 1,
        composites: 0,
        turn_rate: 0.0,
        heaviest: 1.0,
        kinetic_energy: 1.0,
        joint_softness: 1e-9,
        contact_softness: 1e-7,
        friction_softness: 1e-7,
        most_cost: f64::INFINITY,
        limits: LIMITS,
    }
}

/// An island, and what it remembers.
struct Case {
    island: Island,
    rows: Vec<Row>,
    sides: Vec<(usize, Vec<f64>)>,
    problem: Problem,
    memory: Memory,
    budgets: Budgets,
}

impl Case {
    fn new() -> Self {
        let mut budgets = Budgets::default();
        budgets.begin(&LIMITS, false);
        Self {
            island: Island::new(),
            rows: vec![],
            sides: vec![],
            problem: problem(),
            memory: Memory::default(),
            budgets,
        }
    }

    /// Adds a row on a body of 1 kg.
    fn add(&mut self, row: Row) {
        self.add_to(row, 0, &UP);
    }

    fn add_to(&mut self, row: Row, body: usize, jacobian: &[f64]) {
        self.rows.push(row);
        self.sides.push((body, jacobian.to_vec()));
    }

    fn clear(&mut self) {
        self.rows.clear();
        self.sides.clear();
    }

    fn solve(&mut self) -> Solution {
        self.solve_with(&[], &mut ())
    }

    fn solve_with(&mut self, sizes: &[usize], articulations: &mut dyn Articulations) -> Solution {
        let kept = Kept { memory: Some(&mut self.memory), budgets: &mut self.budgets };
        let sides = |row: usize| side(&self.sides[row]);
        let sizes = sizes.iter().copied();
        self.island.solve(&self.problem, &mut self.rows, sides, sizes, kept, articulations)
    }
}

fn side((body, jacobian): &(usize, Vec<f64>)) -> [Option<Side<'_>>; 2] {
    [None, Some(Side { body: *body, jacobian, response: jacobian })]
}

fn joint(target: f64, correction: f64) -> Row {
    Row { is_geometric: true, effective_mass: 1.0, response: 1.0, target, correction, arm: 0.1, ..Row::default() }
}

fn motor(target: f64, most: f64) -> Row {
    Row { effective_mass: 1.0, response: 1.0, target, low: -most, high: most, arm: 0.1, ..Row::default() }
}

fn contact(target: f64, gap: f64) -> Row {
    Row { kind: Kind::Contact, effective_mass: 1.0, target, gap, low: 0.0, ..Row::default() }
}

/// Articulations that move by `length` times what is allowed.
struct Recorded {
    length: f64,
    set: Vec<(usize, Vec<f64>)>,
    factor: Option<f64>,
}

impl Recorded {
    fn new(length: f64) -> Self {
        Self { length, set: vec![], factor: None }
    }
}

impl Articulations for Recorded {
    fn set_correction(&mut self, i: usize, velocities: &[f64], _: f64) -> f64 {
        self.set.push((i, velocities.to_vec()));
        self.length
    }
    fn scale_corrections(&mut self, factor: f64) {
        self.factor = Some(factor);
    }
}

#[test]
fn a_body_lands() {
    let mut case = Case::new();
    case.add(contact(0.25, 0.0));
    let solution = case.solve();
    assert_eq!((solution.outcome, solution.correction), (Outcome::Solved, 0.0));
    assert!((case.island.impulses()[0] - 0.25).abs() < 1e-6);
    assert!((case.island.velocities()[2] - 0.25).abs() < 1e-6);
    assert_eq!(case.island.states(), [State::Free]);
    assert_eq!(solution.counters.rows, 1);
    assert!(case.memory.guess_tolerance > 0.0 || solution.counters.factorisations > 0);
}

#[test]
fn bodies_at_rest_and_contacts_that_open_are_not_solved() {
    let mut case = Case::new();
    case.add(joint(0.0, 0.0));
    case.add(contact(-1.0, 0.1));
    let solution = case.solve();
    assert_eq!((solution.outcome, solution.counters.multiplications), (Outcome::AtRest, 0.0));
    // Their positions are corrected all the same.
    case.clear();
    case.add(joint(0.0, 0.5));
    let solution = case.solve();
    assert_eq!((solution.outcome, solution.correction), (Outcome::AtRest, 1.0));
    assert!((case.island.corrections()[2] - 0.5).abs() < 1e-5);
    assert_eq!(solution.counters.position_problems, 1);
    assert!(case.budgets.work > 0.0);
}

#[test]
fn the_deepest_contact_is_reported() {
    let mut case = Case::new();
    for gap in [0.1, -0.02, -0.01] {
        case.add(contact(-1.0, gap));
    }
    assert_eq!(case.solve().counters.depth, 0.02);
}

#[test]
fn islands_that_are_expensive_or_wrong_are_left() {
    let mut case = Case::new();
    case.problem.most_cost = 1e-3;
    case.add(contact(1.0, 0.0));
    assert_eq!(case.solve().outcome, Outcome::Expensive);
    case.problem.most_cost = f64::INFINITY;
    case.add(contact(f64::NAN, 0.0));
    assert_eq!(case.solve().outcome, Outcome::Refused);
    case.clear();
    case.add_to(contact(1.0, 0.0), 1, &UP);
    assert_eq!(case.solve().outcome, Outcome::Refused, "there is one body");
}

#[test]
fn corrections_have_one_factor() {
    let mut case = Case::new();
    case.problem.rigid = 2;
    // 20 m/s, and half of the share of the other joint.
    case.add_to(joint(0.0, 20.0), 0, &UP);
    case.add_to(joint(0.0, 4.0), 1, &UP);
    let solution = case.solve();
    let speeds = [2, 8].map(|k| case.island.corrections()[k] * solution.correction);
    assert!((speeds[0] - 10.0).abs() < 1e-3 && (speeds[1] - 2.0).abs() < 1e-3, "{speeds:?}");
    // A limit is not part of the share: what moves too far is scaled afterwards.
    case.clear();
    case.add_to(Row { is_limit: true, low: 0.0, ..joint(0.0, 20.0) }, 0, &UP);
    case.add_to(joint(0.0, 4.0), 1, &UP);
    let solution = case.solve();
    assert!((solution.correction - 0.5).abs() < 1e-3, "{solution:?}");
}

#[test]
fn angular_corrections_turn_by_a_twentieth_of_a_radian_at_most() {
    let mut case = Case::new();
    let about = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let correct = |case: &mut Case| {
        case.clear();
        case.add_to(Row { is_limit: true, is_angular: true, low: 0.0, ..joint(0.0, 100.0) }, 0, &about);
        case.solve().correction
    };
    // 50 rad/s for 1 ms; the rate of bodies that turn faster for as long; 0.05 rad.
    assert!((correct(&mut case) - 0.5).abs() < 1e-3);
    case.problem.time_step = H / 4.0;
    case.problem.turn_rate = 60.0;
    assert!((correct(&mut case) - 0.6).abs() < 1e-3);
    case.problem.time_step = 1.25 * H;
    assert!((correct(&mut case) - 0.4).abs() < 1e-3);
}

#[test]
fn long_corrections_are_damped() {
    // An articulation after a body of two coupled ones.
    let z = [1.0, 0.0];
    let corrected = |length| {
        let mut case = Case::new();
        case.problem.composites = 1;
        let row = Row { kind: Kind::ArticulatedJoint, is_articulated: true, correction: 1.0, ..joint(0.0, 0.0) };
        case.add_to(row, 2, &z);
        let mut articulations = Recorded::new(length);
        let solution = case.solve_with(&[12, 2], &mut articulations);
        (solution, articulations)
    };
    let (solution, articulations) = corrected(2.0);
    assert_eq!((articulations.set.len(), articulations.factor), (1, Some(0.5)));
    assert_eq!(solution.correction, 0.5);
    let (_, articulations) = corrected(4.0);
    assert_eq!((articulations.set.len(), articulations.factor), (4, Some(0.25)), "three more rounds");
    // CFM 1e-6, 1e-5, 1e-4 and 1e-3 of the diagonal.
    for (round, (i, velocities)) in articulations.set.iter().enumerate() {
        let softness = 1e-6 * 10_f64.powi(round as i32);
        assert!((velocities[0] - 1.0 / (1.0 + softness)).abs() < 1e-8, "{round}: {velocities:?}");
        assert_eq!(*i, 0);
    }
}

#[test]
fn infeasible_errors_are_left() {
    let mut case = Case::new();
    case.add(joint(0.0, 1.0));
    case.add(joint(0.0, -1.0));
    let mut articulations = Recorded::new(0.0);
    let solution = case.solve_with(&[], &mut articulations);
    assert_eq!((solution.correction, articulations.factor), (0.0, Some(0.0)));
    assert_eq!(solution.counters.position_problems, 1);
}

#[test]
fn a_motor_yields_to_a_joint_that_it_opens() {
    let mut case = Case::new();
    case.add(joint(0.0, 0.0));
    case.add(motor(100.0, 1e8));
    let solution = case.solve();
    assert_eq!(solution.outcome, Outcome::Solved);
    // It opened at 0.1 m/s; with the softer motor by 1e-5 of the arm of 0.1 m in a sub-step.
    let yielding = case.memory.drive_yielding;
    assert!(yielding > 1.0, "{yielding}");
    assert!(H * case.island.velocities()[2] < 1e-6, "{:?}", case.island.velocities());
    assert!(solution.counters.rows > 2, "it was solved more than once");
    let first = case.budgets.shared;
    // The next sub-step begins there.
    case.clear();
    case.add(joint(0.0, 0.0));
    case.add(motor(100.0, 1e8));
    let solution = case.solve();
    assert_eq!(solution.counters.rows, 2);
    assert!(case.memory.drive_yielding <= yielding && case.memory.drive_yielding > 0.5 * yielding);
    assert!(case.budgets.shared <= first + 2.0 * LIMITS.per_row);
}

#[test]
fn without_memory_drives_do_not_yield() {
    let mut case = Case::new();
    case.add(joint(0.0, 0.0));
    case.add(motor(100.0, 1e8));
    let sides = |row: usize| side(&case.sides[row]);
    let none = std::iter::empty();
    let kept = Kept { memory: None, budgets: &mut case.budgets };
    let solution = case.island.solve(&case.problem, &mut case.rows, sides, none, kept, &mut ());
    assert_eq!(solution.counters.rows, 2);
    assert!(case.island.velocities()[2] > 0.09);
}

#[test]
fn an_island_without_drives_keeps_the_yielding_of_others() {
    let mut case = Case::new();
    case.memory.drive_yielding = 100.0;
    case.add(joint(0.1, 0.0));
    case.solve();
    assert_eq!(case.memory.drive_yielding, 100.0);
}

#[test]
fn what_a_solution_leaves_of_its_budget_is_shared() {
    let mut case = Case::new();
    case.add(joint(0.1, 0.0));
    let before = case.budgets.shared;
    let solution = case.solve();
    let used = solution.counters.multiplications;
    assert!(used > 0.0);
    assert_eq!(case.budgets.shared, before + LIMITS.per_row - used);
    assert_eq!((case.budgets.work, case.budgets.largest), (used, LIMITS.base + LIMITS.per_row));
}

#[test]
fn the_table_of_functions_solves_like_the_island() {
    use super::ffi::{self, AmbIslandBodies, AmbIslandSide};
    let table = ffi::table();
    let null = std::ptr::null();
    let sides = [
        AmbIslandSide { body: -1, size: 0, jacobian: null, response: null },
        AmbIslandSide { body: 0, size: 6, jacobian: UP.as_ptr(), response: UP.as_ptr() },
    ];
    let none = AmbIslandBodies { sizes: std::ptr::null(), count: 0, articulations: 0, trees: std::ptr::null() };
    let mut budgets = Budgets::default();
    // SAFETY: the island is used by this thread only, pointers are read before it is freed, no more rows are written than there
    // is space for, and each side that moves has six numbers.
    unsafe {
        (table.begin)(&mut budgets, &LIMITS, false);
        let island = (table.create)();
        let write = |rows: &[Row], sides| {
            let space = (table.reserve)(island, rows.len(), 0);
            for (i, row) in rows.iter().enumerate() {
                space.rows.add(i).write(*row);
                space.sides.add(i).write(sides);
            }
        };
        let solve = |rows: usize, problem: &Problem, budgets: &mut Budgets| {
            let mut out = std::mem::MaybeUninit::uninit();
            (table.solve)(island, rows, problem, &none, std::ptr::null_mut(), budgets, out.as_mut_ptr());
            out.assume_init()
        };
        let row = contact(0.25, -1e-3);
        write(&[row, Row { correction: 0.5, ..row }], sides);
        let solution = solve(2, &problem(), &mut budgets);
        assert_eq!((solution.outcome, *solution.states), (ffi::SOLVED, 0));
        assert!((*solution.impulses + *solution.impulses.add(1) - 0.25).abs() < 1e-6);
        assert!((*solution.velocities.add(2) - 0.25).abs() < 1e-6);
        assert!((*solution.corrections.add(2) * solution.correction - 0.5).abs() < 1e-3);
        assert!((table.may_divide)(&budgets));
        let wrong = solve(2, &Problem { composites: 1, ..problem() }, &mut budgets);
        assert_eq!((wrong.outcome, wrong.impulses), (ffi::REFUSED, null), "a size is missing");
        assert_eq!(solve(100, &problem(), &mut budgets).outcome, ffi::REFUSED, "there is no space for them");
        let expensive = solve(2, &Problem { most_cost: 1e-3, ..problem() }, &mut budgets);
        assert_eq!((expensive.outcome, expensive.velocities), (ffi::EXPENSIVE, null));
        write(&[contact(-1.0, 1.0)], sides);
        let resting = solve(1, &problem(), &mut budgets);
        assert_eq!((resting.outcome, resting.states, resting.corrections), (ffi::AT_REST, null.cast(), null));
        for missing in [AmbIslandSide { size: -1, ..sides[1] }, AmbIslandSide { jacobian: null, ..sides[1] }] {
            write(&[row], [sides[0], missing]);
            assert_eq!(solve(1, &problem(), &mut budgets).outcome, ffi::REFUSED);
        }
        (table.destroy)(island);
        (table.destroy)(std::ptr::null_mut());
    }
}
