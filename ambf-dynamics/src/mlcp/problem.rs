//! Rows of a problem as the caller adds them.

use super::vector::are_finite;

/// Side of its bounds on which an impulse is, or is guessed to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum State {
    /// Between the bounds: the row's velocity equation holds.
    #[default]
    Free = 0,
    /// At the lower bound.
    Low = 1,
    /// At the upper bound.
    High = 2,
}

/// One side of a row: the body on which it acts.
#[derive(Debug, Clone, Copy)]
pub struct Side<'a> {
    /// Number of the body, from 0: rigid bodies first, then articulations, see
    /// [`Solver::prepare`](super::Solver::prepare).
    pub body: usize,
    /// Row of the Jacobian for this body, as long as its generalised velocity (6 for a rigid body: linear, then
    /// angular; the frame is the caller's, the same for all rows of the body).
    pub jacobian: &'a [f64],
    /// Change of the generalised velocity by a unit impulse on the row, `M⁻¹ Jᵀ`, of the same length. Where the
    /// velocities of a body are given in coordinates in which `M` is the identity it is the Jacobian, and the rows of
    /// that body take less work; more so the more of their components are 0.
    pub response: &'a [f64],
}

/// Coulomb friction of a row: its bounds are `±min(coefficient · max(normal impulse, 0), cap)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Friction {
    /// Index of the row of the normal impulse.
    pub normal: usize,
    /// Coefficient of friction; for rolling friction a length, m.
    pub coefficient: f64,
    /// Largest impulse, N·s or N·m·s.
    pub cap: f64,
}

/// One scalar constraint on the change `v` of the bodies' velocities by the impulses: `J v + cfm x = target` with `low
/// ≤ x ≤ high`.
///
/// Where the impulse `x` is at its lower bound `J v + cfm x ≥ target` is enough, at its upper bound `≤`.
pub type Row<'a> = ConstraintRow<Option<Side<'a>>>;

/// A [`Row`] whose sides are given in one way or another.
#[derive(Debug, Clone, Copy)]
pub struct ConstraintRow<S> {
    /// The two bodies of the row; `None` for a static body or none.
    pub sides: [S; 2],
    /// Wanted change of velocity along the row, m/s or rad/s.
    pub target: f64,
    /// Velocity along the row that it asks for beside rest, m/s or rad/s: of restitution, or of the curvature of a
    /// motion. It is part of `target` and is given up where it adds energy, see
    /// [`Solver::solve`](super::Solver::solve).
    pub bias: f64,
    /// Whether the row is a drive, which may do work.
    pub is_drive: bool,
    /// Wanted pseudo-velocity along the row in [`Solver::solve_positions`](super::Solver::solve_positions), m/s or
    /// rad/s.
    pub position_target: f64,
    /// Constraint force mixing: velocity given up per unit of impulse, 1/kg or 1/(kg·m²), ≥ 0.
    pub cfm: f64,
    /// The same in the correction of positions, for a drive instead of `cfm` and for other rows if it is larger: rows
    /// that contradict each other are stronger the less they give up.
    pub position_cfm: f64,
    /// Least CFM, 1/kg or 1/(kg·m²), by which a drive yields to joints that contradict it, for a yielding of 1 in
    /// [`Solver::solve_yielding`](super::Solver::solve_yielding); 0: it doesn't.
    pub yielding_cfm: f64,
    /// Impulse of a drive that is part of the motion before the impulses, N·s or N·m·s. The row solves for the change; what
    /// yields is the sum.
    pub fed: f64,
    /// Lower bound of the impulse, N·s or N·m·s; what is ≤ -1e9 means none.
    pub low: f64,
    /// Upper bound; what is ≥ 1e9 means none.
    pub high: f64,
    /// Replaces both bounds by those of Coulomb friction.
    pub friction: Option<Friction>,
    /// Guess of the active set.
    pub state: State,
    /// Guess of the impulse (warm start). It bounds friction in the first iteration and is where sweeps begin.
    pub x: f64,
    /// Whether the row takes part in the correction of positions. Rows of friction never do. A drive that does, such as
    /// a spring, has the target 0, its CFM, and no bounds: it resists, and what is left of its target is no error.
    pub in_positions: bool,
    /// Whether the row is an equation in the correction of positions where the last
    /// [`Solver::solve`](super::Solver::solve) gave it an impulse: a loaded limit, which a correction would else open
    /// against the force that presses on it.
    pub stays_loaded: bool,
}

impl Default for Row<'_> {
    /// A row between nothing and nothing: target 0, no CFM, an unbounded impulse guessed as 0, in positions too.
    fn default() -> Self {
        Self {
            sides: [None; 2],
            target: 0.0,
            bias: 0.0,
            is_drive: false,
            position_target: 0.0,
            cfm: 0.0,
            position_cfm: 0.0,
            yielding_cfm: 0.0,
            fed: 0.0,
            low: f64::NEG_INFINITY,
            high: f64::INFINITY,
            friction: None,
            state: State::Free,
            x: 0.0,
            in_positions: true,
            stays_loaded: false,
        }
    }
}

impl<S> ConstraintRow<S> {
    fn with_sides<T>(&self, sides: [T; 2]) -> ConstraintRow<T> {
        let &Self { target, bias, is_drive, position_target, cfm, position_cfm, .. } = self;
        let &Self { yielding_cfm, fed, low, high, friction, state, x, in_positions, stays_loaded, .. } = self;
        ConstraintRow {
            sides,
            target,
            bias,
            is_drive,
            position_target,
            cfm,
            position_cfm,
            yielding_cfm,
            fed,
            low,
            high,
            friction,
            state,
            x,
            in_positions,
            stays_loaded,
        }
    }
}

/// Error in the rows of a problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProblemError {
    /// Error when a row names a body beyond the last one.
    #[error("row {row} acts on body {body}, but there are {bodies}")]
    NoBody {
        /// Index of the row.
        row: usize,
        /// Number of the body.
        body: usize,
        /// Count of bodies.
        bodies: usize,
    },
    /// Error when the Jacobian or response of a row is not as long as the velocity of its body.
    #[error("row {row} has {found} components for body {body}, whose velocity has {expected}")]
    WrongSize {
        /// Index of the row.
        row: usize,
        /// Number of the body.
        body: usize,
        /// Length of the body's velocity.
        expected: usize,
        /// Length of the shorter of Jacobian and response.
        found: usize,
    },
    /// Error when friction refers to a row that does not exist.
    #[error("friction of row {row} refers to row {normal}, but there are {rows}")]
    NoNormal {
        /// Index of the row.
        row: usize,
        /// Index of the missing row.
        normal: usize,
        /// Count of rows.
        rows: usize,
    },
    /// Error when a problem is too large for 32-bit indices.
    #[error("the problem is too large")]
    TooLarge,
}

/// Where the Jacobian of a side lies in [`Rows::data`]; its response follows it.
#[derive(Debug, Clone, Copy)]
pub(super) struct StoredSide {
    /// -1: nothing moves.
    pub body: i32,
    pub size: u32,
    pub offset: usize,
    /// Components of the Jacobian that are not 0, where the response is the Jacobian; else `None`.
    pub nonzeros: Option<u32>,
}

impl StoredSide {
    pub const NONE: Self = Self { body: -1, size: 0, offset: 0, nonzeros: None };

    pub fn is_some(&self) -> bool {
        self.body >= 0
    }

    pub fn jacobian<'a>(&self, data: &'a [f64]) -> &'a [f64] {
        &data[self.offset..self.offset + self.size as usize]
    }

    pub fn response<'a>(&self, data: &'a [f64]) -> &'a [f64] {
        let from = self.offset + self.size as usize;
        &data[from..from + self.size as usize]
    }
}

pub(super) type StoredRow = ConstraintRow<StoredSide>;

/// Index of a row that is left out.
const LEFT_OUT: u32 = u32::MAX;

/// Rows in the order in which they were added; the numbers of all Jacobians and responses lie in one vector, then those of
/// [`Coordinates`](super::coordinates::Coordinates).
///
/// Drives without strength, as Bullet sets up for each spring that a joint could have, are left out.
#[derive(Debug, Default)]
pub(super) struct Rows {
    pub rows: Vec<StoredRow>,
    /// Index among all rows of each one that is not left out.
    pub index: Vec<u32>,
    /// The other way round; [`LEFT_OUT`].
    kept: Vec<u32>,
    pub data: Vec<f64>,
    /// Where the coordinates begin in `data`, if that ends with them.
    coordinates: Option<usize>,
    /// Whether a number of the Jacobians and responses is not finite.
    pub not_finite: bool,
    /// First row whose Jacobian and response differ in length.
    uneven: Option<ProblemError>,
}

impl Rows {
    pub fn clear(&mut self) {
        self.rows.clear();
        self.index.clear();
        self.kept.clear();
        self.data.clear();
        self.coordinates = None;
        self.not_finite = false;
        self.uneven = None;
    }

    pub fn add(&mut self, row: &Row) -> usize {
        let index = self.kept.len();
        self.coordinates = None;
        if row.is_drive && row.low == 0.0 && row.high == 0.0 && !row.in_positions && row.friction.is_none() {
            self.kept.push(LEFT_OUT);
            return index;
        }
        self.kept.push(self.rows.len() as u32);
        self.index.push(index as u32);
        let sides = row.sides.map(|side| match side {
            Some(side) => self.add_side(index, &side),
            None => StoredSide::NONE,
        });
        self.rows.push(row.with_sides(sides));
        index
    }

    fn add_side(&mut self, row: usize, side: &Side) -> StoredSide {
        let offset = self.data.len();
        let size = side.jacobian.len().min(side.response.len());
        if side.jacobian.len() != side.response.len() && self.uneven.is_none() {
            let expected = side.jacobian.len().max(side.response.len());
            self.uneven = Some(ProblemError::WrongSize { row, body: side.body, expected, found: size });
        }
        let (jacobian, response) = (&side.jacobian[..size], &side.response[..size]);
        // Most bodies are rigid: copies of known size need no calls.
        if let (Ok(jacobian), Ok(response)) = (<[f64; 6]>::try_from(jacobian), <[f64; 6]>::try_from(response)) {
            let mut both = [0.0; 12];
            both[..6].copy_from_slice(&jacobian);
            both[6..].copy_from_slice(&response);
            self.data.extend_from_slice(&both);
            self.not_finite |= !are_finite(&both);
        } else {
            self.data.extend_from_slice(jacobian);
            self.data.extend_from_slice(response);
            self.not_finite |= !are_finite(&self.data[offset..]);
        }
        let nonzeros = (jacobian == response).then(|| jacobian.iter().filter(|&&value| value != 0.0).count() as u32);
        StoredSide { body: i32::try_from(side.body).unwrap_or(i32::MAX), size: size as u32, offset, nonzeros }
    }

    /// Removes coordinates that were found before, and has new ones begin at the end of `data`.
    pub fn begin_coordinates(&mut self) {
        let start = self.coordinates.unwrap_or(self.data.len());
        self.data.truncate(start);
        self.coordinates = Some(start);
    }

    /// Rows with those that are left out.
    pub fn count(&self) -> usize {
        self.kept.len()
    }

    /// Where the normal row of friction is; `None`: it is left out, and has no impulse.
    pub fn normal(&self, friction: &Friction) -> Option<u32> {
        Some(self.kept[friction.normal]).filter(|&kept| kept != LEFT_OUT)
    }

    /// `velocity_start`: where the velocity of each body begins, and the end of the last.
    pub fn check(&self, velocity_start: &[usize]) -> Result<(), ProblemError> {
        if let Some(error) = self.uneven {
            return Err(error);
        }
        let (bodies, rows) = (velocity_start.len() - 1, self.kept.len());
        if rows >= i32::MAX as usize || bodies >= i32::MAX as usize {
            return Err(ProblemError::TooLarge);
        }
        for (&index, row) in self.index.iter().zip(&self.rows) {
            let index = index as usize;
            for side in row.sides.iter().filter(|side| side.is_some()) {
                let (body, found) = (side.body as usize, side.size as usize);
                if body >= bodies {
                    return Err(ProblemError::NoBody { row: index, body, bodies });
                }
                let expected = velocity_start[body + 1] - velocity_start[body];
                if found != expected {
                    return Err(ProblemError::WrongSize { row: index, body, expected, found });
                }
            }
            if let Some(Friction { normal, .. }) = row.friction.filter(|friction| friction.normal >= rows) {
                return Err(ProblemError::NoNormal { row: index, normal, rows });
            }
        }
        Ok(())
    }
}
