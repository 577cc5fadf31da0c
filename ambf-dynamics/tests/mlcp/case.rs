//! Random problems, and what dense algebra says of them.

use ambf_dynamics::mlcp::{Friction, Row, Side, Solver, State};
use nalgebra::{DMatrix, DVector};

/// Random numbers that are the same in every run (xorshift64*).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    pub fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as usize % n
    }

    /// Between -1 and 1.
    pub fn signed(&mut self) -> f64 {
        self.below(1 << 30) as f64 / f64::from(1 << 29) - 1.0
    }

    pub fn vector(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.signed()).collect()
    }
}

/// A row with what it acts on: bodies and their Jacobians.
#[derive(Clone)]
pub struct CaseRow {
    pub sides: Vec<(usize, Vec<f64>)>,
    pub target: f64,
    pub bias: f64,
    pub cfm: f64,
    pub low: f64,
    pub high: f64,
    pub friction: Option<Friction>,
    pub state: State,
    pub x: f64,
    pub in_positions: bool,
    pub stays_loaded: bool,
}

impl CaseRow {
    pub fn new(sides: Vec<(usize, Vec<f64>)>, target: f64, cfm: f64, [low, high]: [f64; 2]) -> Self {
        let (friction, state) = (None, State::Free);
        Self {
            sides,
            target,
            bias: 0.0,
            cfm,
            low,
            high,
            friction,
            state,
            x: 0.0,
            in_positions: true,
            stays_loaded: false,
        }
    }
}

/// Bodies by their inverse masses, and rows.
pub struct Case {
    pub rigid: usize,
    pub inverse_masses: Vec<DMatrix<f64>>,
    pub rows: Vec<CaseRow>,
}

impl Case {
    /// Bodies of random inertia: rigid ones, then articulations of these sizes.
    pub fn random(random: &mut Random, rigid: usize, articulations: &[usize]) -> Self {
        let sizes = std::iter::repeat_n(6, rigid).chain(articulations.iter().copied());
        let inverse_mass = |size: usize| {
            let root = DMatrix::from_vec(size, size, random.vector(size * size));
            &root * root.transpose() + DMatrix::identity(size, size) * 0.1
        };
        Self { rigid, inverse_masses: sizes.map(inverse_mass).collect(), rows: Vec::new() }
    }

    pub fn size(&self, body: usize) -> usize {
        self.inverse_masses[body].nrows()
    }

    /// Random Jacobians of one or two bodies.
    pub fn random_sides(&self, random: &mut Random) -> Vec<(usize, Vec<f64>)> {
        let bodies = self.inverse_masses.len();
        let (a, b) = (random.below(bodies), random.below(bodies));
        let mut sides = vec![(a, random.vector(self.size(a)))];
        if a != b {
            sides.push((b, random.vector(self.size(b))));
        }
        sides
    }

    /// A normal and two directions of friction.
    pub fn add_contact(&mut self, random: &mut Random, target: f64) {
        let normal = self.rows.len();
        let sides = self.random_sides(random);
        self.rows.push(CaseRow::new(sides.clone(), target, 1e-3, [0.0, f64::INFINITY]));
        for _ in 0..2 {
            let sides = sides.iter().map(|(body, jacobian)| (*body, random.vector(jacobian.len()))).collect();
            let mut row = CaseRow::new(sides, 0.3 * random.signed(), 1e-4, [0.0, 0.0]);
            row.friction = Some(Friction { normal, coefficient: 0.4, cap: 1e18 });
            self.rows.push(row);
        }
    }

    pub fn fill(&self, solver: &mut Solver) {
        solver.clear();
        for row in &self.rows {
            let responses: Vec<DVector<f64>> = (row.sides.iter())
                .map(|(body, jacobian)| &self.inverse_masses[*body] * DVector::from_column_slice(jacobian))
                .collect();
            let mut sides = [None; 2];
            for (out, ((body, jacobian), response)) in sides.iter_mut().zip(row.sides.iter().zip(&responses)) {
                *out = Some(Side { body: *body, jacobian, response: response.as_slice() });
            }
            let CaseRow { target, bias, cfm, low, high, friction, state, x, in_positions, stays_loaded, .. } = *row;
            let position_target = target;
            solver.add_row(&Row {
                sides,
                bias,
                target,
                position_target,
                cfm,
                low,
                high,
                friction,
                state,
                x,
                in_positions,
                stays_loaded,
                ..Row::default()
            });
        }
        let sizes: Vec<usize> = (self.rigid..self.inverse_masses.len()).map(|body| self.size(body)).collect();
        solver.prepare(self.rigid, &sizes).unwrap();
    }

    pub fn solver(&self) -> Solver {
        let mut solver = Solver::new();
        self.fill(&mut solver);
        solver
    }

    /// `J`, rows by components of all velocities.
    pub fn jacobian(&self) -> DMatrix<f64> {
        let mut starts = vec![0];
        for body in 0..self.inverse_masses.len() {
            starts.push(starts[body] + self.size(body));
        }
        let mut matrix = DMatrix::zeros(self.rows.len(), starts[self.inverse_masses.len()]);
        for (i, row) in self.rows.iter().enumerate() {
            for (body, jacobian) in &row.sides {
                for (k, value) in jacobian.iter().enumerate() {
                    matrix[(i, starts[*body] + k)] += value;
                }
            }
        }
        matrix
    }

    /// `M⁻¹` of all bodies.
    pub fn inverse_mass(&self) -> DMatrix<f64> {
        let size = self.inverse_masses.iter().map(DMatrix::nrows).sum();
        let (mut matrix, mut at) = (DMatrix::zeros(size, size), 0);
        for block in &self.inverse_masses {
            matrix.view_mut((at, at), block.shape()).copy_from(block);
            at += block.nrows();
        }
        matrix
    }

    /// `J M⁻¹ Jᵀ`.
    pub fn response(&self) -> DMatrix<f64> {
        let jacobian = self.jacobian();
        &jacobian * self.inverse_mass() * jacobian.transpose()
    }

    /// The same with CFM on the diagonal.
    pub fn matrix(&self) -> DMatrix<f64> {
        let cfm: Vec<f64> = self.rows.iter().map(|row| row.cfm).collect();
        self.response() + DMatrix::from_diagonal(&DVector::from_vec(cfm))
    }

    pub fn targets(&self) -> DVector<f64> {
        DVector::from_iterator(self.rows.len(), self.rows.iter().map(|row| row.target))
    }

    /// Bounds of a row that go with the impulses.
    pub fn bounds(&self, row: usize, x: &[f64]) -> [f64; 2] {
        match self.rows[row].friction {
            Some(Friction { normal, coefficient, cap }) => {
                let bound = (coefficient * x[normal].max(0.0)).min(cap);
                [-bound, bound]
            }
            None => [self.rows[row].low, self.rows[row].high],
        }
    }

    /// Largest violation of complementarity, as a velocity; asserts that impulses other than friction are within their
    /// bounds.
    pub fn residual(&self, x: &[f64]) -> f64 {
        let matrix = self.matrix();
        let w = &matrix * DVector::from_column_slice(x) - self.targets();
        let mut largest: f64 = 0.0;
        for i in 0..x.len() {
            let ([low, high], d) = (self.bounds(i, x), matrix[(i, i)]);
            let is_within = low <= x[i] && x[i] <= high;
            assert!(is_within || self.rows[i].friction.is_some(), "row {i}: {low} <= {} <= {high}", x[i]);
            largest = largest.max(d * (x[i] - (x[i] - w[i] / d).max(low).min(high)).abs());
        }
        largest
    }
}
