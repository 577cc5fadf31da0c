//! Both factorisations on the same problems.

use nalgebra::{DMatrix, DVector};

use super::free_factor::Kind;
use super::{Budget, Friction, Outcome, Row, Side, Solver, State};

const NONE: f64 = f64::INFINITY;

/// Random numbers between -1 and 1 that are the same in every run (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn below(&mut self, n: usize) -> usize {
        ((self.next() + 1.0) / 2.0 * n as f64) as usize % n
    }

    fn vector(&mut self, n: usize) -> DVector<f64> {
        DVector::from_fn(n, |_, _| self.next())
    }
}

/// Solvers that factor by rows and by velocities, and the bodies' inverse masses.
struct Pair {
    random: Random,
    inverse_masses: Vec<DMatrix<f64>>,
    rigid: usize,
    solvers: [Solver; 2],
}

impl Pair {
    fn new(seed: u64, rigid: usize, articulations: &[usize]) -> Self {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        let sizes: Vec<usize> = std::iter::repeat_n(6, rigid).chain(articulations.iter().copied()).collect();
        let inverse_masses = sizes
            .iter()
            .map(|&n| {
                let root = DMatrix::from_fn(n, n, |_, _| random.next());
                &root * root.transpose() + DMatrix::identity(n, n) * 0.1
            })
            .collect();
        let mut solvers = [Solver::new(), Solver::new()];
        solvers[0].factor.forced = Some(Kind::Rows);
        solvers[1].factor.forced = Some(Kind::Velocities);
        Self { random, inverse_masses, rigid, solvers }
    }

    /// Adds a row to both solvers; CFM is a share of the diagonal.
    fn add(&mut self, sides: &[(usize, DVector<f64>)], row: Row, share: f64) {
        let responses: Vec<DVector<f64>> = sides.iter().map(|(body, j)| &self.inverse_masses[*body] * j).collect();
        let mut given = [None; 2];
        let mut diagonal = 0.0;
        for (given, ((body, jacobian), response)) in given.iter_mut().zip(sides.iter().zip(&responses)) {
            *given = Some(Side { body: *body, jacobian: jacobian.as_slice(), response: response.as_slice() });
            diagonal += jacobian.dot(response);
        }
        for solver in &mut self.solvers {
            solver.add_row(&Row { sides: given, cfm: share * diagonal, ..row });
        }
    }

    /// Jacobians of one or two bodies, at times twice the same one.
    fn sides(&mut self) -> Vec<(usize, DVector<f64>)> {
        let bodies = self.inverse_masses.len();
        (0..1 + self.random.below(2))
            .map(|_| {
                let body = self.random.below(bodies);
                (body, self.random.vector(self.inverse_masses[body].nrows()))
            })
            .collect()
    }

    /// A normal and two directions of friction.
    fn add_contact(&mut self, share: f64) {
        let normal = self.solvers[0].impulses_to_come();
        let sides = self.sides();
        let target = self.random.next();
        self.add(&sides, Row { target, position_target: target, low: 0.0, ..Row::default() }, share);
        for _ in 0..2 {
            let sides: Vec<_> = sides.iter().map(|(body, j)| (*body, self.random.vector(j.len()))).collect();
            let friction = Some(Friction { normal, coefficient: 0.1, cap: NONE });
            let target = 0.1 * self.random.next();
            self.add(&sides, Row { target, friction, ..Row::default() }, share);
        }
    }

    fn add_joint(&mut self, share: f64) {
        let sides = self.sides();
        let target = self.random.next();
        self.add(&sides, Row { target, position_target: target, ..Row::default() }, share);
    }

    fn prepare(&mut self) {
        let sizes: Vec<usize> = self.inverse_masses[self.rigid..].iter().map(DMatrix::nrows).collect();
        for solver in &mut self.solvers {
            solver.prepare(self.rigid, &sizes).unwrap();
        }
    }

    /// Solves by both and compares. Returns whether both solved it.
    fn agree(&mut self, allowed: f64) -> bool {
        let outcomes = self.solvers.each_mut().map(|solver| solver.solve(Budget::UNLIMITED));
        assert_eq!(self.solvers[1].factor.kind(), Kind::Velocities, "there was no need to go over to rows");
        let [rows, velocities] = &self.solvers;
        let both = outcomes == [Outcome::Solved; 2];
        if both {
            compare(rows.impulses(), velocities.impulses(), allowed);
            compare(rows.velocities(), velocities.velocities(), allowed);
            assert_eq!(rows.states(), velocities.states());
        }
        let outcomes = self.solvers.each_mut().map(|s| s.solve_positions(None, None, 1e-4, Budget::UNLIMITED));
        assert_eq!(outcomes, [Outcome::Solved; 2]);
        let [rows, velocities] = &self.solvers;
        compare(rows.position_impulses(), velocities.position_impulses(), 1e-8);
        compare(rows.position_velocities(), velocities.position_velocities(), 1e-8);
        both
    }
}

impl Solver {
    fn impulses_to_come(&self) -> usize {
        self.rows.rows.len()
    }
}

fn compare(a: &[f64], b: &[f64], allowed: f64) {
    let scale = a.iter().fold(0.0, |scale: f64, x| scale.max(x.abs()));
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() <= allowed * scale, "{i}: {a} is not {b} within {scale}");
    }
}

#[test]
fn random_islands_have_the_same_solution_by_rows_and_by_velocities() {
    let mut both = 0;
    for seed in 1..80 {
        let mut pair = Pair::new(seed, 4, &[9, 1]);
        for _ in 0..pair.random.below(4) {
            pair.add_joint(1e-6);
        }
        for _ in 0..1 + pair.random.below(12) {
            pair.add_contact(1e-3);
        }
        pair.prepare();
        both += u32::from(pair.agree(1e-7));
    }
    assert!(both > 60, "{both}");
}

#[test]
fn an_articulation_with_many_contacts_has_the_same_solution_by_both() {
    let mut pair = Pair::new(5, 0, &[20]);
    for _ in 0..3 {
        pair.add_joint(1e-9);
    }
    for _ in 0..120 {
        let sides = pair.sides();
        let target = pair.random.next();
        pair.add(&sides, Row { target, position_target: target, low: 0.0, ..Row::default() }, 1e-4);
    }
    pair.prepare();
    assert!(pair.agree(1e-8));
    let [rows, velocities] = pair.solvers.each_ref().map(|solver| solver.statistics());
    assert!(velocities.pivots > 20, "{velocities:?}");
    assert!(velocities.multiplications < rows.multiplications / 2.0, "{velocities:?} {rows:?}");
}

/// In coordinates in which a mass matrix is the identity rows are their own responses.
#[test]
fn rows_in_unit_coordinates_have_the_same_solution_by_both_and_take_less_work() {
    let mut pair = Pair::new(9, 1, &[24, 5]);
    // The middle one only.
    pair.inverse_masses[1] = DMatrix::identity(24, 24);
    let mut work = [0.0; 2];
    for is_sparse in [true, false] {
        pair.solvers.iter_mut().for_each(Solver::clear);
        for k in 0..90 {
            let mut sides = pair.sides();
            if k % 3 == 0 {
                sides = vec![(1, pair.random.vector(24)); 1 + k % 2];
            }
            // A branch of an articulation.
            for (_, jacobian) in sides.iter_mut().filter(|(body, _)| *body == 1 && is_sparse) {
                jacobian.rows_mut(6 + 6 * (k % 3), 6).fill(0.0);
            }
            let target = pair.random.next();
            pair.add(&sides, Row { target, position_target: target, ..Row::default() }, 1e-3);
        }
        pair.prepare();
        assert!(pair.agree(1e-7));
        let statistics = pair.solvers[1].statistics();
        work[usize::from(!is_sparse)] = statistics.multiplications / f64::from(statistics.factorisations);
    }
    assert!(work[0] < work[1], "{work:?}");
}

#[test]
fn redundant_contacts_share_alike_in_both() {
    let mut pair = Pair::new(6, 2, &[]);
    let (a, b) = (pair.random.vector(6), pair.random.vector(6));
    for _ in 0..30 {
        let row = Row { target: 1.0, position_target: 1.0, low: 0.0, ..Row::default() };
        pair.add(&[(0, a.clone()), (1, b.clone())], row, 1e-4);
    }
    pair.prepare();
    assert!(pair.agree(1e-9));
    let x = pair.solvers[1].impulses();
    assert!(x.iter().all(|value| (value - x[0]).abs() < 1e-9 * x[0]), "{x:?}");
}

#[test]
fn joints_with_hardly_any_cfm_are_refined() {
    for seed in 1..20 {
        let mut pair = Pair::new(seed, 3, &[12]);
        // Fewer rows than velocities: impulses are well defined.
        for _ in 0..10 {
            pair.add_joint(1e-9);
        }
        pair.prepare();
        assert!(pair.agree(1e-6), "seed {seed}");
    }
}

#[test]
fn rows_without_cfm_are_solved_by_rows() {
    let mut pair = Pair::new(8, 1, &[]);
    pair.solvers.iter_mut().for_each(|solver| solver.factor.forced = None);
    for k in 0..40 {
        let sides = vec![(0, pair.random.vector(6))];
        let share = if k == 0 { 0.0 } else { 1e-4 };
        pair.add(&sides, Row { target: 0.1, position_target: 0.1, low: 0.0, ..Row::default() }, share);
    }
    pair.prepare();
    let solver = &mut pair.solvers[0];
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    assert_eq!(solver.factor.kind(), Kind::Rows);
    // CFM of positions is never that small.
    assert_eq!(solver.solve_positions(None, None, 1e-4, Budget::UNLIMITED), Outcome::Solved);
    assert_eq!(solver.factor.kind(), Kind::Velocities);
}

#[test]
fn springs_resist_corrections() {
    // Two coordinates of mass 1 kg whose sum is to change by 1 m/s. A spring with a CFM of 1/kg on the second: the least of
    // (p₁² + p₂² + p₂²) / 2 with p₁ + p₂ = 1.
    let mut solver = Solver::new();
    let row = |jacobian| Row { sides: [Some(Side { body: 0, jacobian, response: jacobian }), None], ..Row::default() };
    solver.add_row(&Row { position_target: 1.0, ..row(&[1.0, 1.0]) });
    solver.add_row(&Row { is_drive: true, cfm: 1.0, target: 7.0, ..row(&[0.0, 1.0]) });
    solver.prepare(0, &[2]).expect("a proper problem");
    assert_eq!(solver.solve_positions(None, None, 1e-13, Budget::UNLIMITED), Outcome::Solved);
    compare(solver.position_velocities(), &[2.0 / 3.0, 1.0 / 3.0], 1e-9);
    // What a spring gives way by is no error.
    assert!(solver.position_errors().iter().all(|error| error.abs() < 1e-9), "{:?}", solver.position_errors());
}

#[test]
fn springs_and_joints_share_a_correction() {
    // A mass of 1 kg that a joint is to move at 1 m/s and a spring holds. With CFM c of the joint and s of the spring the
    // impulses (1 − v)/c and v/s are in balance but for v.
    let (joint, mut solver) = (1e-6, Solver::new());
    let row = Row { sides: [Some(Side { body: 0, jacobian: &[1.0], response: &[1.0] }), None], ..Row::default() };
    for spring in [1e-7, 1e-6, 1e-3] {
        solver.clear();
        solver.add_row(&Row { position_target: 1.0, position_cfm: joint, ..row });
        solver.add_row(&Row { is_drive: true, cfm: 1e-5, position_cfm: spring, ..row });
        solver.prepare(0, &[1]).expect("a proper problem");
        assert_eq!(solver.solve_positions(None, None, 1e-13, Budget::UNLIMITED), Outcome::Solved);
        compare(solver.position_velocities(), &[1.0 / (1.0 + joint + joint / spring)], 1e-9);
    }
}

#[test]
fn drives_yield_to_joints() {
    // A mass of 1 kg that a joint holds and a drive is to move at 1 m/s. With CFM c of the joint and d of the drive the
    // impulses v/c and (1 − v)/d are in balance but for v.
    let (joint, mut solver) = (1e-7, Solver::new());
    let row = Row { sides: [Some(Side { body: 0, jacobian: &[1.0], response: &[1.0] }), None], ..Row::default() };
    solver.add_row(&Row { cfm: joint, ..row });
    solver.add_row(&Row { cfm: joint, yielding_cfm: joint, is_drive: true, target: 1.0, ..row });
    solver.prepare(0, &[1]).expect("a proper problem");
    for yielding in [0.0, 1.0, 10.0, 1e4] {
        let drive = joint * f64::max(yielding, 1.0);
        assert_eq!(solver.solve_yielding(yielding, Budget::UNLIMITED), Outcome::Solved);
        compare(solver.velocities(), &[1.0 / (1.0 + drive + drive / joint)], 1e-9);
    }
}

/// A mass of 1 kg on a contact that is to stop it from 0.01 m/s, with a guess that is wrong by the share `wrong`.
fn resting(solver: &mut Solver, wrong: f64) {
    let row = Row { sides: [Some(Side { body: 0, jacobian: &[1.0], response: &[1.0] }), None], ..Row::default() };
    solver.add_row(&Row { target: 0.01, x: 0.01 * (1.0 - wrong), low: 0.0, ..row });
}

#[test]
fn a_limit_that_is_not_reached_makes_nothing_inaccurate() {
    // The other mass is to stay below a limit, from which it is 75 m/s times the sub-step away.
    let mut solver = Solver::new();
    resting(&mut solver, 1e-5);
    let row = Row { sides: [Some(Side { body: 1, jacobian: &[1.0], response: &[1.0] }), None], ..Row::default() };
    solver.add_row(&Row { target: 75.0, low: -NONE, high: 0.0, state: State::High, ..row });
    solver.prepare(0, &[1, 1]).expect("a proper problem");
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    compare(solver.impulses(), &[0.01, 0.0], 1e-10);
}

#[test]
fn soft_rows_and_weak_drives_make_nothing_inaccurate() {
    let drive = Row { sides: [Some(Side { body: 1, jacobian: &[1.0], response: &[1.0] }), None], ..Row::default() };
    let soft = Row { target: 75.0, cfm: 1e6, is_drive: true, ..drive };
    let weak = Row { target: 75.0, low: -1e-6, high: 1e-6, is_drive: true, ..drive };
    for (row, impulse) in [(soft, 75.0 / (1.0 + 1e6)), (weak, 1e-6)] {
        let mut solver = Solver::new();
        resting(&mut solver, 1e-5);
        solver.add_row(&Row { x: impulse, ..row });
        solver.prepare(0, &[1, 1]).expect("a proper problem");
        assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
        compare(solver.impulses(), &[0.01, impulse], 1e-10);
    }
}

#[test]
fn a_guess_is_accepted_more_easily_after_one_that_was_accepted() {
    let mut solver = Solver::new();
    // The first guess is too inaccurate; the second one would be for a problem that was solved before.
    for (wrong, factorisations, tolerance) in [(5e-8, 1, 0.0), (5e-9, 0, 1e-7), (5e-8, 0, 1e-7), (2e-7, 1, 0.0)] {
        let before = solver.statistics().guess_tolerance;
        solver.clear();
        resting(&mut solver, wrong);
        solver.prepare(0, &[1]).expect("a proper problem");
        solver.set_guess_tolerance(before);
        assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
        let found = solver.statistics();
        assert_eq!(found.factorisations, factorisations, "{wrong}: {found:?}");
        assert!((found.guess_tolerance - tolerance).abs() < 1e-10, "{wrong}: {found:?}");
    }
}

#[test]
fn limits_on_both_sides_keep_their_guess() {
    // Two masses that a joint is to accelerate, and limits that are open, which the guess of the joint is too bad to tell.
    for (low, high, state) in [(0.0, NONE, State::Low), (-NONE, 0.0, State::High)] {
        let mut solver = Solver::new();
        let row = Row { sides: [Some(Side { body: 0, jacobian: &[1.0], response: &[1.0] }), None], ..Row::default() };
        solver.add_row(&Row { target: 1.0, x: 5.0, ..row });
        solver.add_row(&Row { target: if low == 0.0 { -9.0 } else { 9.0 }, low, high, state, ..row });
        solver.prepare(0, &[1]).expect("a proper problem");
        assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
        assert_eq!(solver.statistics().pivots, 0);
        compare(solver.impulses(), &[1.0, 0.0], 1e-10);
    }
}

#[test]
fn drives_without_strength_are_rows_without_effect() {
    let side = Some(Side { body: 0, jacobian: &[1.0, 0.0], response: &[1.0, 0.0] });
    let across = Some(Side { body: 0, jacobian: &[0.0, 1.0], response: &[0.0, 1.0] });
    let row = Row { sides: [side, None], ..Row::default() };
    let idle = Row { target: f64::MAX, low: 0.0, high: 0.0, is_drive: true, in_positions: false, ..row };
    let contact = Row { target: 2.0, position_target: 3.0, low: 0.0, high: NONE, ..row };
    let friction = |normal: usize| Row {
        sides: [across, None],
        target: 5.0,
        in_positions: false,
        friction: Some(Friction { normal, coefficient: 0.5, cap: NONE }),
        ..Row::default()
    };
    let mut solver = Solver::new();
    // Friction of the contact, which comes later, and of one of the drives.
    for row in [idle, friction(3), idle, contact, friction(2)] {
        solver.add_row(&row);
    }
    solver.prepare(0, &[2]).expect("a proper problem");
    assert_eq!(solver.solve(Budget::UNLIMITED), Outcome::Solved);
    compare(solver.impulses(), &[0.0, 1.0, 0.0, 2.0, 0.0], 1e-9);
    assert_eq!(solver.states()[3], State::Free);
    compare(solver.velocities(), &[2.0, 1.0], 1e-9);
    assert_eq!(solver.solve_positions(None, None, 1e-9, Budget::UNLIMITED), Outcome::Solved);
    compare(solver.position_velocities(), &[3.0, 0.0], 1e-6);
    assert_eq!(solver.position_impulses().len(), 5);
    assert!(solver.position_errors()[3].abs() < 1e-6, "{}", solver.position_errors()[3]);
    assert_eq!(solver.statistics().rows, 5);
}
