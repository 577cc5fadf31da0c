//! The factorisation of the free rows, of which there are two kinds.

use super::coordinates::Coordinates;
use super::factor::EnvelopeFactor;
use super::iterate::{Iterate, Variable};
use super::layout::Layout;
use super::matrix::Matrix;
use super::problem::{Rows, State};
use super::velocity_factor::{Numbers, VelocityFactor};

/// Least share of its diagonal that CFM must have for a row to be solved in velocity space.
const MIN_CFM_SHARE: f64 = 1e-11;

/// Whether a problem is factored by rows or by velocities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Kind {
    /// See [`EnvelopeFactor`].
    #[default]
    Rows,
    /// See [`VelocityFactor`].
    Velocities,
}

/// Solves `(A + cfm) x = b` for the free rows.
#[derive(Debug, Default)]
pub(super) struct FreeFactor {
    kind: Kind,
    matrix: Matrix,
    rows: EnvelopeFactor,
    coordinates: Coordinates,
    velocities: VelocityFactor,
    /// Overrides the choice.
    #[cfg(test)]
    pub forced: Option<Kind>,
}

impl FreeFactor {
    /// To be called where the rows change. Finds the diagonal of `A`.
    pub fn set_rows(&mut self, rows: &Rows, layout: &Layout) {
        self.matrix.begin(rows, layout);
        self.coordinates.reset();
    }

    /// Diagonal of `A`, by place.
    pub fn diagonal(&self) -> &[f64] {
        &self.matrix.diagonal
    }

    /// To be called where CFM changes. Chooses the kind that takes less work.
    pub fn begin(&mut self, layout: &Layout, iterate: &Iterate) {
        self.rows.reset();
        self.velocities.reset();
        let soft = |row: &Variable| row.diagonal <= 0.0 || row.cfm >= MIN_CFM_SHARE * row.diagonal;
        let by_velocities = layout.prefers_velocities() && iterate.variables.iter().all(soft);
        self.kind = if by_velocities { Kind::Velocities } else { Kind::Rows };
        #[cfg(test)]
        if let Some(kind) = self.forced {
            self.kind = kind;
        }
    }

    /// The rows in coordinates in which all mass matrices are the identity, if the problem is factored in these.
    pub fn coordinates(&self) -> Option<&Coordinates> {
        (self.kind == Kind::Velocities).then_some(&self.coordinates)
    }

    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Goes over to the factorisation by rows, which is more accurate.
    pub fn use_rows(&mut self) {
        self.kind = Kind::Rows;
    }

    /// Multiplications before the first factorisation that are still to be done.
    pub fn preparation_cost(&self, layout: &Layout) -> f64 {
        match self.kind {
            Kind::Rows if !self.matrix.is_assembled() => layout.assembly_cost,
            Kind::Velocities if !self.coordinates.are_found() => layout.coordinate_cost,
            _ => 0.0,
        }
    }

    /// Does what [`Self::preparation_cost`] counts.
    pub fn prepare(&mut self, rows: &mut Rows, layout: &Layout) {
        match self.kind {
            Kind::Rows => self.matrix.assemble(rows, layout),
            Kind::Velocities => self.coordinates.find(rows, layout),
        }
    }

    /// Finds what changed. Returns the multiplications that an update will take at most.
    pub fn plan(&mut self, layout: &Layout, iterate: &Iterate) -> f64 {
        let variables = &iterate.variables;
        match self.kind {
            Kind::Rows => self.rows.plan(layout, |p| variables[p].state == State::Free),
            Kind::Velocities => self.velocities.plan(layout, variables),
        }
    }

    /// Brings the factor up to date with the plan, whose multiplications are `planned`. Returns those that it took.
    pub fn update(&mut self, rows: &Rows, layout: &Layout, iterate: &Iterate, planned: f64) -> f64 {
        let variables = &iterate.variables;
        match self.kind {
            Kind::Rows => self.rows.update(layout, &self.matrix, |p| variables[p].cfm),
            Kind::Velocities => {
                self.velocities.update(layout, Numbers { coordinates: &self.coordinates, data: &rows.data }, variables);
                planned
            }
        }
    }

    /// Places of the free rows.
    pub fn places(&self) -> &[u32] {
        match self.kind {
            Kind::Rows => &self.rows.places,
            Kind::Velocities => &self.velocities.places,
        }
    }

    /// Replaces the right-hand side of the free rows, in the order of [`Self::places`], by their impulses. In velocity
    /// space the result needs refinement.
    pub fn solve(&mut self, rows: &Rows, layout: &Layout, unknowns: &mut [f64]) {
        match self.kind {
            Kind::Rows => self.rows.solve(unknowns),
            Kind::Velocities => {
                self.velocities.solve(layout, Numbers { coordinates: &self.coordinates, data: &rows.data }, unknowns);
            }
        }
    }

    /// Multiplications of [`Self::solve`].
    pub fn solve_cost(&self, layout: &Layout) -> f64 {
        match self.kind {
            Kind::Rows => self.rows.solve_cost(),
            Kind::Velocities => 2.0 * (layout.pass_cost + layout.coordinate_entries as f64),
        }
    }
}
