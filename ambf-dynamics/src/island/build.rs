//! What the rows of an island are in its two problems.

use crate::mlcp::{Friction, Row as Constraint, State};

use super::row::{Kind, Row};
use super::softness::{
    softness_of, spring_position_softness, JointSoftness, POSITION_SOFTNESS, YIELDING_POSITION_SOFTNESS,
};
use super::yielding::YIELDING_SOFTNESS;
use super::{larger, smaller, Problem};

/// Velocities up to this count as 0, m/s or rad/s.
const NO_SPEED: f64 = 1e-14;
/// The position problem is solved only if the correction velocity of a joint exceeds MIN_CORRECTION, m/s or rad/s, or
/// the penetration depth of a contact exceeds MIN_DEPTH, m.
const MIN_CORRECTION: f64 = 1e-6;
const MIN_DEPTH: f64 = 1e-5;
/// Share of the bound of friction from which its impulse in the last sub-step is taken to have been at it.
const AT_BOUND: f64 = 1.0 - 1e-6;

/// What a row is in the position problem: it constrains a position on both sides (joint), on one side (limit, contact), or
/// is friction. Motors and springs have the kind of their joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PositionKind {
    Geometric,
    Limit,
    Contact,
    Other,
}

/// What the position problem is told of a row beside the [`Constraint`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Position {
    pub kind: PositionKind,
    pub is_angular: bool,
    /// Lever arm of the joint, m; 0: not known.
    pub arm: f64,
    /// Correction velocity below which the position error is not corrected, m/s or rad/s.
    pub least_correction: f64,
}

/// What rows are made with.
#[derive(Debug)]
pub(super) struct Builder<'a> {
    pub problem: &'a Problem,
    pub softness: JointSoftness,
    /// Share of the joints' position errors that is corrected in this sub-step, see [`correction_share`].
    pub share: f64,
}

impl Builder<'_> {
    /// Sets all of `to` but the sides. `normal`: guess of the contact of a row of friction.
    pub fn build(&self, row: &Row, normal: Option<(f64, State)>, to: &mut Constraint<'_>) -> Position {
        Row { target: to.target, bias: to.bias, cfm: to.cfm, low: to.low, high: to.high, fed: to.fed, .. } = *row;
        to.in_positions = false;
        let mut least_correction = MIN_CORRECTION;
        let kind = match row.kind {
            Kind::Joint => self.joint(row, to),
            Kind::Coupling => self.coupling(row, to),
            Kind::ArticulatedJoint => self.articulated_joint(row, to),
            Kind::Contact => {
                least_correction = self.contact(row, to);
                PositionKind::Contact
            }
            Kind::Friction => {
                self.friction(row, to, normal.unwrap_or_default());
                PositionKind::Other
            }
        };
        Position { kind, is_angular: row.is_angular, arm: row.arm, least_correction }
    }

    fn share_of(&self, is_limit: bool) -> f64 {
        if is_limit {
            1.0
        } else {
            self.share
        }
    }

    fn joint(&self, row: &Row, to: &mut Constraint<'_>) -> PositionKind {
        let is_limit = row.is_limit;
        to.cfm = larger(to.cfm, self.softness.cfm(row.response, row.is_angular, row.turn_squared));
        to.in_positions = row.is_geometric || row.is_spring;
        to.is_drive = !row.is_geometric;
        to.position_target = row.correction * self.share_of(is_limit);
        // If this guess is not the solution, pivoting starts with free rows: a drive that alternates between its bounds
        // would otherwise take many pivots in each sub-step.
        to.x = row.guess;
        if row.is_open && to.x == 0.0 {
            to.state = guess_of(to);
        }
        if is_limit && row.is_known && to.x == 0.0 {
            to.state = if to.low == 0.0 { State::Low } else { State::High };
        }
        to.position_cfm = if is_limit {
            softness_of(row, YIELDING_POSITION_SOFTNESS)
        } else {
            POSITION_SOFTNESS * row.position_response
        };
        if to.is_drive {
            to.yielding_cfm = YIELDING_SOFTNESS * row.response;
            to.position_cfm = spring_position_softness(to.cfm, row.response);
        }
        to.stays_loaded = to.low == 0.0 || to.high == 0.0;
        if is_limit {
            PositionKind::Limit
        } else {
            PositionKind::Geometric
        }
    }

    fn coupling(&self, row: &Row, to: &mut Constraint<'_>) -> PositionKind {
        if row.response > 0.0 {
            to.cfm = self.softness.cfm(row.response, row.is_angular, 0.0);
            to.in_positions = true;
            to.position_target = row.correction * self.share;
            to.position_cfm = POSITION_SOFTNESS * row.response;
            to.x = row.guess;
        } else {
            to.target = 0.0;
        }
        PositionKind::Geometric
    }

    fn articulated_joint(&self, row: &Row, to: &mut Constraint<'_>) -> PositionKind {
        let is_limit = to.low == 0.0 || to.high == 0.0;
        to.is_drive = !row.is_geometric;
        to.in_positions = row.effective_mass > 0.0 && (row.is_geometric || row.is_spring);
        if to.in_positions && row.is_geometric {
            to.position_target = self.share_of(is_limit) * row.correction / row.effective_mass;
        }
        to.x = row.guess;
        if to.x == 0.0 {
            to.state = guess_of(to);
        }
        to.position_cfm = softness_of(row, if is_limit { YIELDING_POSITION_SOFTNESS } else { POSITION_SOFTNESS });
        if to.is_drive {
            to.yielding_cfm = softness_of(row, YIELDING_SOFTNESS);
            to.position_cfm = spring_position_softness(to.cfm, softness_of(row, 1.0));
        }
        to.stays_loaded = is_limit;
        if is_limit {
            PositionKind::Limit
        } else {
            PositionKind::Geometric
        }
    }

    /// Returns the correction velocity below which the contact is not corrected, m/s.
    fn contact(&self, row: &Row, to: &mut Constraint<'_>) -> f64 {
        to.x = larger(0.0, row.guess);
        to.position_cfm = softness_of(row, YIELDING_POSITION_SOFTNESS);
        // It regularises redundant contacts.
        to.cfm = larger(to.cfm, softness_of(row, self.problem.contact_softness));
        let is_open = to.x == 0.0 && (to.target < 0.0 || row.was_open);
        to.state = if is_open { State::Low } else { State::Free };
        to.in_positions = row.effective_mass > 0.0 && to.high > 0.0;
        if row.gap > 0.0 {
            to.position_target = -row.gap / self.problem.time_step;
        } else if to.in_positions {
            to.position_target = row.correction / row.effective_mass;
        }
        let depth = -row.gap;
        if depth > 0.0 {
            to.position_target.abs() * MIN_DEPTH / depth
        } else {
            f64::INFINITY
        }
    }

    fn friction(&self, row: &Row, to: &mut Constraint<'_>, (impulse, state): (f64, State)) {
        let (guess, cap, kept) = (row.guess, row.cap, row.warm_start);
        to.friction =
            usize::try_from(row.normal).ok().map(|normal| Friction { normal, coefficient: row.friction, cap });
        to.x = guess / kept;
        to.cfm = larger(to.cfm, softness_of(row, self.problem.friction_softness));
        let bound = smaller(row.friction * impulse, cap) * AT_BOUND;
        to.state = if guess >= bound * kept {
            State::High
        } else if guess <= -bound * kept {
            State::Low
        } else {
            State::Free
        };
        if state == State::Free && impulse == 0.0 {
            to.state = State::Free;
        }
    }
}

/// Guess of the active set: a unilateral row whose target needs no impulse is at its bound.
fn guess_of(row: &Constraint<'_>) -> State {
    if row.low == 0.0 && row.target < 0.0 {
        State::Low
    } else if row.high == 0.0 && row.target > 0.0 {
        State::High
    } else {
        State::Free
    }
}

/// Whether a row is satisfied without an impulse. A contact may separate. The target of a row with a fixed impulse does not
/// count.
pub(super) fn is_at_rest(row: &Constraint<'_>) -> bool {
    let is_idle = if row.low >= row.high {
        row.low == 0.0
    } else {
        row.target <= NO_SPEED && (row.low == 0.0 || row.target >= -NO_SPEED)
    };
    is_idle && row.low <= 0.0 && row.high >= 0.0
}

/// The share of the joints' position errors that is corrected in this sub-step, so that no row exceeds the largest
/// correction velocity, `[speed, rate]` in m/s and rad/s. It is the same for all joints of the island: a correction by a
/// part of each error goes towards the least sum of squares, and one of clamped errors does not.
pub(super) fn correction_share(rows: &[Row], [most_moved, most_turned]: [f64; 2]) -> f64 {
    let mut fastest = 1.0;
    for row in rows {
        let correction = match row.kind {
            Kind::Joint if row.is_geometric && !row.is_limit => row.correction,
            Kind::Coupling => row.correction,
            Kind::ArticulatedJoint if row.is_geometric && row.effective_mass > 0.0 => {
                row.correction / row.effective_mass
            }
            _ => continue,
        };
        fastest = larger(fastest, correction.abs() / if row.is_angular { most_turned } else { most_moved });
    }
    1.0 / fastest
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 1e-3;

    fn problem() -> Problem {
        Problem { contact_softness: 1e-7, friction_softness: 1e-6, ..super::super::tests::problem() }
    }

    struct Built {
        constraint: Constraint<'static>,
        kind: PositionKind,
        least_correction: f64,
    }

    fn build_on(row: &Row, normal: (f64, State)) -> Built {
        let problem = problem();
        let softness = JointSoftness::new(1e-9, 0.0, &[], H);
        let mut constraint = Constraint::default();
        let builder = Builder { problem: &problem, softness, share: 0.5 };
        let Position { kind, least_correction, .. } = builder.build(row, Some(normal), &mut constraint);
        Built { constraint, kind, least_correction }
    }

    fn build(row: &Row) -> Built {
        build_on(row, Default::default())
    }

    #[test]
    fn limits_that_need_no_impulse_begin_at_their_bounds() {
        let limit = Row { is_geometric: true, is_limit: true, low: 0.0, target: 1.0, ..Row::default() };
        let state = |row: Row| build(&row).constraint.state;
        assert_eq!(state(limit), State::Free);
        assert_eq!(state(Row { is_known: true, ..limit }), State::Low);
        assert_eq!(state(Row { is_known: true, guess: 0.1, ..limit }), State::Free);
        assert_eq!(state(Row { is_known: true, low: -1.0, high: 0.0, ..limit }), State::High);
        // One that is not reached, and that moves away or not.
        assert_eq!(state(Row { is_open: true, target: -1.0, ..limit }), State::Low);
        assert_eq!(state(Row { is_open: true, ..limit }), State::Free);
    }

    #[test]
    fn joints_are_corrected_by_a_share_and_limits_in_full() {
        let joint =
            Row { is_geometric: true, correction: 4.0, response: 2.0, position_response: 3.0, ..Row::default() };
        let Built { constraint, kind, .. } = build(&joint);
        assert_eq!((constraint.position_target, constraint.position_cfm), (2.0, 3e-6));
        assert_eq!((constraint.cfm, constraint.yielding_cfm, kind), (2e-9, 0.0, PositionKind::Geometric));
        let limit = Row { is_limit: true, low: 0.0, effective_mass: 0.5, ..joint };
        let Built { constraint, kind, .. } = build(&limit);
        assert_eq!((constraint.position_target, constraint.position_cfm), (4.0, 2e-4));
        assert!(constraint.stays_loaded && kind == PositionKind::Limit);
    }

    #[test]
    fn drives_yield_and_springs_alone_resist_corrections() {
        let spring = Row { response: 2.0, cfm: 1e-9, is_spring: true, ..Row::default() };
        let built = build(&spring).constraint;
        assert!(built.is_drive && built.in_positions);
        assert_eq!((built.yielding_cfm, built.cfm), (2e-7, 2e-9));
        assert_eq!(built.position_cfm, 2e-9);
        assert!(!build(&Row { is_spring: false, ..spring }).constraint.in_positions);
    }

    #[test]
    fn rows_of_articulations_are_given_by_impulses() {
        let joint = Row {
            kind: Kind::ArticulatedJoint,
            is_articulated: true,
            is_geometric: true,
            effective_mass: 2.0,
            link_masses: [0.25, 0.0],
            correction: 8.0,
            ..Row::default()
        };
        let built = build(&joint).constraint;
        assert_eq!((built.position_target, built.position_cfm), (0.5 * 8.0 / 2.0, 4e-6));
        let limit = build(&Row { low: 0.0, target: -1.0, ..joint });
        assert_eq!((limit.constraint.position_target, limit.constraint.state), (4.0, State::Low));
        assert!(limit.kind == PositionKind::Limit && limit.constraint.stays_loaded);
        let drive = build(&Row { is_geometric: false, ..joint }).constraint;
        assert_eq!((drive.position_target, drive.in_positions), (0.0, false));
        assert!((drive.yielding_cfm - 4e-7).abs() < 1e-20);
        // Nothing moves.
        assert!(!build(&Row { effective_mass: 0.0, ..joint }).constraint.in_positions);
    }

    #[test]
    fn a_coupling_on_which_nothing_moves_asks_for_nothing() {
        let coupling =
            Row { kind: Kind::Coupling, response: 2.0, target: 1.0, correction: 3.0, guess: 4.0, ..Row::default() };
        let built = build(&coupling).constraint;
        assert_eq!((built.target, built.position_target, built.x, built.cfm), (1.0, 1.5, 4.0, 2e-9));
        let built = build(&Row { response: 0.0, ..coupling }).constraint;
        assert_eq!((built.target, built.position_target, built.x, built.in_positions), (0.0, 0.0, 0.0, false));
    }

    #[test]
    fn contacts_close_their_gap_or_are_pushed_out() {
        let contact =
            Row { kind: Kind::Contact, low: 0.0, effective_mass: 2.0, correction: 1.0, gap: -1e-3, ..Row::default() };
        let built = build(&contact);
        assert_eq!((built.constraint.position_target, built.constraint.cfm), (0.5, 1e-7 / 2.0));
        // Deeper than 1e-5 m.
        assert!((built.least_correction - 0.5 * 1e-5 / 1e-3).abs() < 1e-15);
        let above = build(&Row { gap: 2e-3, ..contact });
        assert_eq!((above.constraint.position_target, above.least_correction), (-2.0, f64::INFINITY));
        assert!(!build(&Row { high: 0.0, ..contact }).constraint.in_positions);
    }

    #[test]
    fn contacts_begin_as_they_were() {
        let contact = Row { kind: Kind::Contact, low: 0.0, target: 1.0, ..Row::default() };
        let guess = |row| (build(&row).constraint.x, build(&row).constraint.state);
        assert_eq!(guess(contact), (0.0, State::Free));
        assert_eq!(guess(Row { was_open: true, ..contact }), (0.0, State::Low));
        assert_eq!(guess(Row { target: -1.0, ..contact }), (0.0, State::Low));
        assert_eq!(guess(Row { guess: 2.0, was_open: true, ..contact }), (2.0, State::Free));
        assert_eq!(guess(Row { guess: -2.0, ..contact }), (0.0, State::Free));
    }

    #[test]
    fn friction_begins_at_its_bound_if_it_was_there() {
        let friction = Row {
            kind: Kind::Friction,
            normal: 0,
            friction: 0.5,
            effective_mass: 1.0,
            warm_start: 0.8,
            ..Row::default()
        };
        let guess = |guess, normal| {
            let built = build_on(&Row { guess, ..friction }, normal).constraint;
            (built.x, built.state)
        };
        let closed = (2.0, State::Free);
        assert_eq!(guess(0.4, closed), (0.5, State::Free));
        assert_eq!(guess(0.8, closed), (1.0, State::High));
        assert_eq!(guess(-0.8, closed), (-1.0, State::Low));
        // A contact without impulse bounds friction to 0, but nothing is known where it is new.
        assert_eq!(guess(0.0, (0.0, State::Low)).1, State::High);
        assert_eq!(guess(0.0, (0.0, State::Free)).1, State::Free);
        let capped = build_on(&Row { guess: 0.08, cap: 0.1, ..friction }, closed).constraint;
        assert_eq!(capped.state, State::High);
        assert_eq!(capped.friction, Some(Friction { normal: 0, coefficient: 0.5, cap: 0.1 }));
        assert_eq!(capped.cfm, 1e-6);
    }

    #[test]
    fn rows_that_need_no_impulse_are_at_rest() {
        let joint = Constraint { target: 0.0, ..Constraint::default() };
        let rests = |target, low, high| is_at_rest(&Constraint { target, low, high, ..joint });
        let none = f64::INFINITY;
        assert!(rests(1e-15, -none, none) && !rests(1e-13, -none, none) && !rests(-1e-13, -none, none));
        assert!(rests(-1.0, 0.0, none), "a contact that opens");
        assert!(!rests(1.0, 0.0, none));
        assert!(rests(1.0, 0.0, 0.0), "no impulse is possible");
        assert!(!rests(0.0, 1.0, 1.0) && !rests(0.0, 0.5, none), "there is an impulse in any case");
    }

    #[test]
    fn no_joint_is_corrected_faster_than_allowed() {
        let share = |row| correction_share(&[row], [10.0, 50.0]);
        let joint = Row { is_geometric: true, correction: -40.0, effective_mass: 2.0, ..Row::default() };
        assert_eq!(share(joint), 0.25);
        assert_eq!(share(Row { is_angular: true, ..joint }), 1.0);
        assert_eq!(share(Row { is_angular: true, correction: 100.0, ..joint }), 0.5);
        assert_eq!(share(Row { kind: Kind::Coupling, ..joint }), 0.25);
        assert_eq!(share(Row { kind: Kind::ArticulatedJoint, ..joint }), 0.5);
        for other in [
            Row { is_limit: true, ..joint },
            Row { is_geometric: false, ..joint },
            Row { kind: Kind::Contact, ..joint },
            Row { kind: Kind::ArticulatedJoint, effective_mass: 0.0, ..joint },
        ] {
            assert_eq!(share(other), 1.0);
        }
    }
}
