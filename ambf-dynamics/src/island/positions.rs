//! The rows of an island as its position problem has them, sums of their errors, and which corrections are made.
//!
//! A correction is a Gauss–Newton step towards the least weighted sum of squares of the position errors, damped by the CFM
//! of the position problem (Levenberg–Marquardt; Nocedal and Wright, *Numerical Optimization*, 2006, ch. 10).

use crate::mlcp::{Row as Constraint, State};

use super::build::{Position, PositionKind};
use super::larger;
use super::softness::POSITION_SOFTNESS;

/// A correction is solved again with [`RAISED_DAMPING`] times the damping, up to [`MOST_ROUNDS`] times, while it is more
/// than [`LONG_CORRECTION`] times as long as bodies may move: near singular configurations small errors are corrected by
/// large motions, for which the rows are no longer valid.
pub(super) const LONG_CORRECTION: f64 = 3.0;
/// See [`LONG_CORRECTION`].
pub(super) const MOST_ROUNDS: u32 = 3;
/// See [`LONG_CORRECTION`].
pub(super) const RAISED_DAMPING: f64 = 10.0;
/// Errors below URGENT_CORRECTION times the least that are corrected are so in every CORRECTION_INTERVAL-th sub-step only.
const URGENT_CORRECTION: f64 = 20.0;
const CORRECTION_INTERVAL: u32 = 4;
/// Length that stands for the lever arm at contacts, m: what drives press into each other is corrected at a rate of 10/s and
/// stays some 1e-5 m deep.
const CONTACT_ARM: f64 = 0.01;

/// Sums of squares of the correction velocities of an island's rows, over their responses, J: the parts of the sum that
/// the position problem minimises.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Errors {
    pub linear: f64,
    pub angular: f64,
}

/// Whether a correction lowers neither sum by more than the share LEAST_DECREASE, or one only at the expense of the other.
/// It is not applied: the remaining errors are infeasible.
pub(super) fn is_uncorrectable(asked: &Errors, left: &Errors) -> bool {
    const LEAST_DECREASE: f64 = 0.02;
    let (linear, angular) = (asked.linear - left.linear, asked.angular - left.angular);
    let both = linear + angular;
    let is_lowered = |decrease: f64, before: f64| {
        let least = if both < decrease { both } else { decrease };
        least > LEAST_DECREASE * before
    };
    !is_lowered(linear, asked.linear) && !is_lowered(angular, asked.angular)
}

/// Whether a correction is a long motion that hardly lowers the errors: it leaves most of the sum of squares `asked`, J, and
/// lowers it by less than SOFT of twice the kinetic energy of its pseudo-velocities, `moved`, J. This is the square of the
/// sine of the angle between the motion and those that the rows allow, as a mean over the rows.
pub(super) fn is_soft(asked: &Errors, left: &Errors, moved: f64) -> bool {
    const SOFT: f64 = 1e-3;
    const MOSTLY: f64 = 0.7;
    let (before, after) = (asked.linear + asked.angular, left.linear + left.angular);
    after > MOSTLY * before && before - after < SOFT * moved
}

#[derive(Debug, Clone, Copy)]
struct PositionRow {
    /// Correction velocity asked for in this sub-step, m/s or rad/s.
    target: f64,
    /// Weight in the sum of squared errors.
    weight: f64,
    /// In the velocity problem.
    cfm: f64,
    is_angular: bool,
    is_joint: bool,
    is_contact: bool,
    /// Lever arm of the joint, m; 0: not known.
    arm: f64,
}

/// The rows of an island in its position problem, in the order in which they were added.
#[derive(Debug, Default)]
pub(super) struct PositionRows {
    rows: Vec<PositionRow>,
    states: Vec<State>,
    /// Whether a row has a position error that is to be corrected, and one that is to be corrected in this sub-step.
    needs_correction: bool,
    is_urgent: bool,
}

impl PositionRows {
    pub fn clear(&mut self) {
        self.rows.clear();
        self.states.clear();
        self.needs_correction = false;
        self.is_urgent = false;
    }

    /// Adds the next row.
    pub fn add(&mut self, row: &Constraint<'_>, of: Position) {
        let Constraint { position_target: target, cfm, position_cfm, is_drive, .. } = *row;
        let Position { kind, is_angular, arm, least_correction } = of;
        let is_low = row.low == 0.0 && target < 0.0;
        let is_high = row.high == 0.0 && target > 0.0;
        let counts = row.in_positions && !is_low && !is_high;
        // The inverse of the CFM in the position problem, as the solution has it.
        let solved = if is_drive { position_cfm } else { larger(cfm, position_cfm) };
        let is_contact = kind == PositionKind::Contact;
        self.rows.push(PositionRow {
            target: if counts { target } else { 0.0 },
            weight: if position_cfm > 0.0 { POSITION_SOFTNESS / solved } else { 0.0 },
            cfm,
            is_angular,
            is_joint: kind == PositionKind::Geometric && !is_drive,
            is_contact,
            arm: if is_contact { CONTACT_ARM } else { arm },
        });
        self.states.push(match (is_low, is_high) {
            (true, _) => State::Low,
            (_, true) => State::High,
            _ => State::Free,
        });
        if counts {
            let asked = target.abs() / least_correction;
            self.needs_correction |= asked > 1.0;
            // Limits are corrected at once: drives may push against them in every sub-step.
            self.is_urgent |= asked > URGENT_CORRECTION || (asked > 1.0 && kind == PositionKind::Limit);
        }
    }

    /// Whether a row has a position error that is to be corrected in this sub-step.
    pub fn are_due(&self, sub_step: u32) -> bool {
        self.needs_correction && (self.is_urgent || sub_step.is_multiple_of(CORRECTION_INTERVAL))
    }

    /// Guess of the active set of the position problem.
    pub fn states(&self) -> &[State] {
        &self.states
    }

    /// Of what is to be corrected in this sub-step.
    pub fn asked(&self) -> Errors {
        self.sums(self.rows.iter().map(|row| row.target))
    }

    /// `left`, here and below: what the position problem leaves of the targets, one a row.
    pub fn after(&self, left: &[f64]) -> Errors {
        self.sums(left.iter().copied())
    }

    fn sums(&self, errors: impl Iterator<Item = f64>) -> Errors {
        let mut sums = Errors::default();
        for (row, error) in self.rows.iter().zip(errors) {
            let sum = if row.is_angular { &mut sums.angular } else { &mut sums.linear };
            *sum += row.weight * error * error;
        }
        sums
    }

    /// Twice the kinetic energy of the pseudo-velocities of the position problem that was solved, J, for the least damping:
    /// the sum of the impulses, which are the errors left over the CFM, times the velocities of the rows.
    pub fn correction_energy(&self, left: &[f64]) -> f64 {
        let mut sum = 0.0;
        for (row, left) in self.rows.iter().zip(left) {
            sum += row.weight * left * (row.target - left);
        }
        sum / POSITION_SOFTNESS
    }

    /// By how much the joints of the island open, and its contacts close, by their CFM in a sub-step of h s, as a share of their
    /// lever arms, or rad, with the impulses `impulses`.
    pub fn opening(&self, impulses: &[f64], h: f64) -> f64 {
        let mut largest = 0.0;
        for (row, impulse) in self.rows.iter().zip(impulses) {
            let counts = if row.is_joint { row.is_angular || row.arm > 0.0 } else { row.is_contact };
            if counts {
                let opened = h * row.cfm * impulse.abs();
                largest = larger(largest, if row.is_angular { opened } else { opened / row.arm });
            }
        }
        largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(rows: &[(Constraint<'static>, PositionKind, bool)]) -> PositionRows {
        let mut positions = PositionRows::default();
        for (constraint, kind, is_angular) in rows {
            let (kind, is_angular) = (*kind, *is_angular);
            positions.add(constraint, Position { kind, is_angular, arm: 0.5, least_correction: 1e-6 });
        }
        positions
    }

    fn row(position_target: f64) -> Constraint<'static> {
        Constraint { position_target, cfm: 1e-9, position_cfm: 1e-6, ..Constraint::default() }
    }

    #[test]
    fn small_errors_are_corrected_in_every_fourth_sub_step() {
        use PositionKind::{Geometric, Limit};
        let due = |row, kind, sub_step| of(&[(row, kind, false)]).are_due(sub_step);
        for (target, at_once, later) in [(0.9e-6, false, false), (1.1e-6, false, true), (2.1e-5, true, true)] {
            assert_eq!((due(row(target), Geometric, 5), due(row(-target), Geometric, 8)), (at_once, later), "{target}");
        }
        let limit = Constraint { low: 0.0, ..row(1.1e-6) };
        assert!(due(limit, Limit, 5));
        // One that is not violated, and a row that takes no part.
        assert!(!due(Constraint { position_target: -1.0, ..limit }, Limit, 4));
        assert!(!due(Constraint { in_positions: false, ..row(1.0) }, Geometric, 4));
    }

    #[test]
    fn rows_that_are_not_violated_do_not_count_and_are_guessed_at_their_bounds() {
        use PositionKind::{Contact, Geometric};
        let contact = Constraint { low: 0.0, ..row(-2.0) };
        let upper = Constraint { high: 0.0, ..row(2.0) };
        let rows = of(&[(row(3.0), Geometric, false), (contact, Contact, false), (upper, Contact, true)]);
        assert_eq!(rows.states(), [State::Free, State::Low, State::High]);
        assert_eq!(rows.asked(), Errors { linear: 9.0, angular: 0.0 });
    }

    #[test]
    fn errors_are_weighted_by_their_softness() {
        use PositionKind::Geometric;
        let spring = Constraint { is_drive: true, position_cfm: 1e-3, cfm: 1.0, ..row(2.0) };
        let stiff = Constraint { cfm: 1e-5, ..row(2.0) };
        let rows = of(&[(row(2.0), Geometric, true), (spring, Geometric, false), (stiff, Geometric, false)]);
        let Errors { linear, angular } = rows.asked();
        assert!((angular - 4.0).abs() < 1e-12 && (linear - 4.0 * (1e-3 + 0.1)).abs() < 1e-12, "{linear} {angular}");
        assert_eq!(rows.after(&[1.0, 0.0, 0.0]), Errors { linear: 0.0, angular: 1.0 });
        // Half of the first target is left: an impulse of 1 / 1e-6 moves it at 1.
        assert!((rows.correction_energy(&[1.0, 0.0, 0.0]) - 1e6).abs() < 1e-6);
    }

    #[test]
    fn joints_and_contacts_open_by_their_softness() {
        use PositionKind::{Contact, Geometric, Limit, Other};
        let soft = Constraint { cfm: 1e-4, ..row(0.0) };
        let opening = |row, kind, is_angular| of(&[(row, kind, is_angular)]).opening(&[-10.0], 1e-3);
        assert!((opening(soft, Geometric, true) - 1e-6).abs() < 1e-18);
        assert!((opening(soft, Geometric, false) - 2e-6).abs() < 1e-18, "over the arm of 0.5 m");
        assert!((opening(soft, Contact, false) - 1e-4).abs() < 1e-16);
        let drive = Constraint { is_drive: true, ..soft };
        assert_eq!([opening(soft, Limit, true), opening(soft, Other, true), opening(drive, Geometric, true)], [0.0; 3]);
    }

    #[test]
    fn corrections_that_hardly_lower_the_errors_are_not_made() {
        let errors = |linear, angular| Errors { linear, angular };
        assert!(is_uncorrectable(&errors(1.0, 0.0), &errors(0.981, 0.0)));
        assert!(!is_uncorrectable(&errors(1.0, 0.0), &errors(0.979, 0.0)));
        // One at the expense of the other.
        assert!(is_uncorrectable(&errors(1.0, 1.0), &errors(0.5, 1.49)));
        assert!(!is_uncorrectable(&errors(1.0, 1.0), &errors(0.5, 1.47)));
    }

    #[test]
    fn long_motions_for_little_are_soft() {
        let errors = |linear| Errors { linear, angular: 0.0 };
        assert!(is_soft(&errors(1.0), &errors(0.9), 101.0));
        assert!(!is_soft(&errors(1.0), &errors(0.9), 99.0));
        assert!(!is_soft(&errors(1.0), &errors(0.69), 1e9), "most of the error is gone");
    }
}
