//! A solver, or an island, that has seen a problem allocates nothing for the next one of its size.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use ambf_dynamics::island::{Budgets, Island, Kept, Kind, Limits, Memory, Outcome, Problem};
use ambf_dynamics::mlcp::{Budget, Friction, Row, Side, Solver};

struct Counting;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: everything is passed on to the system's allocator; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.with(|count| count.set(count.get() + 1));
        // SAFETY: by the contract of this function.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: by the contract of this function.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A stack of bodies with contacts at four corners, pushed aside.
fn fill(solver: &mut Solver, bodies: usize) {
    solver.clear();
    for body in 0..bodies {
        for corner in 0..4 {
            let (x, y) = (0.05 - 0.1 * f64::from(corner % 2), 0.05 - 0.1 * f64::from(corner / 2));
            let directions = [
                ([0.0, 0.0, 1.0, y, -x, 0.0], 0.01),
                ([1.0, 0.0, 0.0, 0.0, -0.05, -y], 0.02),
                ([0.0, 1.0, 0.0, 0.05, 0.0, x], -0.01),
            ];
            let mut normal = None;
            for (jacobian, target) in directions {
                let response: [f64; 6] = std::array::from_fn(|k| if k < 3 { jacobian[k] } else { 600.0 * jacobian[k] });
                let (jacobian_below, response_below) = (jacobian.map(|j| -j), response.map(|r| -r));
                let above = Side { body, jacobian: &jacobian, response: &response };
                let below = |body| Side { body, jacobian: &jacobian_below, response: &response_below };
                let row = solver.add_row(&Row {
                    sides: [Some(above), body.checked_sub(1).map(below)],
                    target,
                    position_target: target,
                    cfm: 1e-4,
                    low: 0.0,
                    friction: normal.map(|normal| Friction { normal, coefficient: 0.3, cap: f64::INFINITY }),
                    ..Row::default()
                });
                normal = normal.or(Some(row));
            }
        }
    }
    solver.prepare(bodies, &[]).unwrap();
}

#[test]
fn a_warm_solver_allocates_nothing() {
    let mut solver = Solver::new();
    let mut solve = || {
        for budget in [0.0, 1e5, f64::INFINITY] {
            fill(&mut solver, 10);
            solver.solve(Budget(budget));
            solver.solve_positions(None, None, 1e-4, Budget(budget));
        }
        fill(&mut solver, 4);
        solver.solve(Budget::UNLIMITED);
        (solver.statistics(), COUNT.with(Cell::get))
    };
    let (_, cold) = solve();
    assert!(cold > 0);
    let (statistics, warm) = solve();
    assert!(statistics.factorisations > 1, "{statistics:?}");
    assert_eq!(warm, cold);
}

#[test]
fn a_warm_island_allocates_nothing() {
    use ambf_dynamics::island::Row;
    let limits = Limits { base: 1e5, per_row: 1e4, saved: 1e6 };
    let problem = Problem {
        time_step: 1e-3,
        sub_step: 0,
        rigid: 2,
        composites: 0,
        turn_rate: 0.0,
        heaviest: 1.0,
        kinetic_energy: 1.0,
        joint_softness: 1e-9,
        contact_softness: 1e-7,
        friction_softness: 1e-7,
        most_cost: f64::INFINITY,
        limits,
    };
    let joint =
        Row { is_geometric: true, effective_mass: 1.0, response: 1.0, correction: 0.1, arm: 0.1, ..Row::default() };
    let motor = Row { is_geometric: false, target: 100.0, low: -1e8, high: 1e8, correction: 0.0, ..joint };
    let contact = Row { kind: Kind::Contact, target: 0.1, gap: -1e-3, low: 0.0, ..joint };
    let friction = Row { kind: Kind::Friction, normal: 2, friction: 0.5, target: 0.1, ..joint };
    let jacobians = [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.1]];
    let mut island = Island::new();
    let mut solve = |memory: &mut Memory| {
        let mut rows = [joint, motor, contact, friction];
        let sides = |row: usize| {
            let jacobian = &jacobians[row / 3][..];
            [0, 1].map(|body| Some(Side { body, jacobian, response: jacobian }).filter(|_| body == row / 2))
        };
        let mut budgets = Budgets::default();
        budgets.begin(&limits, false);
        let kept = Kept { memory: Some(memory), budgets: &mut budgets };
        let solution = island.solve(&problem, &mut rows, sides, std::iter::empty(), kept, &mut ());
        (solution, COUNT.with(Cell::get))
    };
    let (first, cold) = solve(&mut Memory::default());
    assert!(cold > 0);
    // Drives yield and positions are corrected.
    assert!(first.outcome == Outcome::Solved && first.counters.rows > 4 && first.correction > 0.0, "{first:?}");
    let (second, warm) = solve(&mut Memory::default());
    assert_eq!((second, warm), (first, cold));
}
