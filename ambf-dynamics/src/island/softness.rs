//! CFM of rows, in the velocity problem and in the position problem.

use super::row::{Kind, Row};
use super::{larger, smaller};

/// CFM of the position problem as a share of the response of joints, and of the diagonal of contacts and limits:
/// infeasible rows end in a least-squares compromise, in which contacts and limits yield to joints and grips. It is at
/// least [`LEAST_POSITION_SOFTNESS`] of the diagonal.
pub(super) const POSITION_SOFTNESS: f64 = 1e-6;
/// See [`POSITION_SOFTNESS`].
pub(super) const YIELDING_POSITION_SOFTNESS: f64 = 1e-4;
/// See [`POSITION_SOFTNESS`].
pub(super) const LEAST_POSITION_SOFTNESS: f64 = 1e-12;
/// CFM of stiff springs, as a share of their response, and the share below which the implicit CFM of a spring falls
/// towards it.
const SPRING_POSITION_SOFTNESS: f64 = 1e-7;
const STIFF_SPRING: f64 = 10.0;
/// The same for soft springs, which are stiffer than what moves with them, and softer than contacts.
const SOFT_SPRING_POSITION_SOFTNESS: f64 = 1e-3;
pub(crate) const SOFT_SPRING: f64 = 1000.0;

/// CFM of the joints of rigid bodies in the velocity problem.
///
/// A row turns with its bodies, by the angle θ = h |ω_a − ω_b| relative to each other in a sub-step of h s. Where a
/// loop goes through a singular configuration some combination of its rows hardly moves any body: its response is s² of
/// that of the rows, with s of the order of the angle to the singular configuration. Where s < θ it is a constraint of
/// a part of the sub-step only. Fully imposed, it turns the error that the curvature leaves into a velocity 1/s times as
/// large, and the loop goes on along another branch. With a CFM of θ² of the response a such combinations are left to
/// the inertia, and all others are imposed. The CFM is
///
/// ```text
/// a max(LEAST, min(θ², MOST, LOADED / (a M))),
/// ```
///
/// with the mass M of the heaviest body of the island, or M r² for angular rows with the longest lever arm r of the
/// island's joints: under the acceleration g of that body the joint opens by at most LOADED g h, m/s, or, where 1/a is
/// small beside M, as for a heavy body on a light link, by LEAST a M g h. A spring or motor with the force F counts as a
/// body of the mass F/g.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointSoftness {
    least: f64,
    heaviest: f64,
    longest: f64,
}

/// See [`JointSoftness`].
const MOST: f64 = 1e-6;
const LOADED: f64 = 2e-6;
const GRAVITY: f64 = 9.81;

impl JointSoftness {
    /// Loads and lever arms of an island. `least`: LEAST; `heaviest`: mass of its heaviest rigid body, kg; `h`: sub-step
    /// in s.
    pub fn new(least: f64, heaviest: f64, rows: &[Row], h: f64) -> Self {
        let mut softness = Self { least, heaviest: larger(0.0, heaviest), longest: 0.0 };
        for row in rows {
            match row.kind {
                // A link that the island touches.
                Kind::Contact if row.is_articulated => {
                    row.link_masses.into_iter().for_each(|mass| softness.add_body(mass))
                }
                Kind::Joint => softness.add_joint(row, h),
                _ => {}
            }
        }
        softness
    }

    fn add_body(&mut self, mass: f64) {
        self.heaviest = larger(self.heaviest, mass);
    }

    fn add_joint(&mut self, row: &Row, h: f64) {
        self.longest = larger(self.longest, row.arm);
        if !row.is_geometric && (row.arm > 0.0 || !row.is_angular) {
            let impulse = row.guess.abs() / if row.is_angular { row.arm } else { 1.0 };
            self.add_body(impulse / (GRAVITY * h));
        }
    }

    /// `response`: a, 1/kg, or of an angular row 1/(kg·m²); `turn_squared`: θ².
    pub fn cfm(&self, response: f64, is_angular: bool, turn_squared: f64) -> f64 {
        let load = if is_angular { self.heaviest * self.longest * self.longest } else { self.heaviest };
        let moving = smaller(turn_squared, MOST) * response;
        larger(self.least * response, if load > 0.0 { smaller(moving, LOADED / load) } else { moving })
    }
}

/// CFM in the position problem of a spring whose implicit row has the CFM `cfm` and the response `response`.
///
/// A spring that is stiff for the sub-step resists like a joint. With its implicit CFM it would resist each correction by
/// the force of that correction alone, without those of the corrections before, and many of them would strain it.
pub(super) fn spring_position_softness(cfm: f64, response: f64) -> f64 {
    let falling = |from: f64, least: f64| {
        let share = if response > 0.0 { smaller(1.0, cfm / (response * from)) } else { 1.0 };
        larger(least * response, cfm * share * share * share * share)
    };
    let stiff = falling(STIFF_SPRING, SPRING_POSITION_SOFTNESS);
    smaller(smaller(cfm, stiff), falling(SOFT_SPRING, SOFT_SPRING_POSITION_SOFTNESS))
}

/// CFM as a share of the diagonal J M⁻¹ Jᵀ.
///
/// Near singular configurations the diagonal of a row on links is small, and an impulse along it would cause large
/// velocities across it. The share is therefore of at least the inverse mass of the link.
pub(super) fn softness_of(row: &Row, share: f64) -> f64 {
    if row.effective_mass <= 0.0 {
        return 0.0;
    }
    if !row.is_articulated {
        return share / row.effective_mass;
    }
    let mut response = 1.0 / row.effective_mass;
    for mass in row.link_masses {
        if mass > 0.0 {
            response = larger(response, 1.0 / mass);
        }
    }
    share * response
}

/// Sets the response of each row of a joint of rigid bodies in the position problem: the mean of the linear, or of the
/// angular, rows of the joint that are neither limits, motors nor springs; of all others their own.
///
/// The sum of their squared errors over it then does not depend on the axes along which Bullet resolves an error, and the
/// compromise between joints that contradict each other is that of the assembly ([`crate::assembly`]).
pub(super) fn average_responses(rows: &mut [Row]) {
    let is_averaged = |row: &Row| row.is_geometric && !row.is_limit;
    for joint in rows.chunk_by_mut(|a, b| a.kind == b.kind && a.joint == b.joint) {
        if joint[0].kind != Kind::Joint {
            continue;
        }
        let (mut sums, mut counts) = ([0.0; 2], [0; 2]);
        for row in joint.iter().filter(|row| is_averaged(row)) {
            sums[usize::from(row.is_angular)] += row.response;
            counts[usize::from(row.is_angular)] += 1;
        }
        for row in joint {
            let k = usize::from(row.is_angular);
            row.position_response = if is_averaged(row) { sums[k] / f64::from(counts[k]) } else { row.response };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 1e-3;

    fn softness(heaviest: f64, rows: &[Row]) -> JointSoftness {
        JointSoftness::new(1e-9, heaviest, rows, H)
    }

    #[test]
    fn a_joint_that_turns_is_softer_up_to_what_its_load_allows() {
        let free = softness(0.0, &[]);
        assert_eq!(free.cfm(2.0, false, 0.0), 2e-9);
        assert_eq!(free.cfm(2.0, false, 1e-7), 2e-7);
        assert_eq!(free.cfm(2.0, false, 1.0), 2e-6);
        // 100 kg: 2e-6 / 100.
        assert_eq!(softness(100.0, &[]).cfm(2.0, false, 1.0), 2e-8);
        // Never below the least.
        assert_eq!(softness(1e6, &[]).cfm(2.0, false, 1.0), 2e-9);
    }

    #[test]
    fn angular_rows_are_loaded_by_the_longest_arm() {
        let arms = [0.5, 2.0].map(|arm| Row { arm, is_geometric: true, ..Row::default() });
        let softness = softness(10.0, &arms);
        assert_eq!(softness.cfm(1.0, true, 1.0), 2e-6 / 40.0);
        assert_eq!(softness.cfm(1.0, false, 1.0), 2e-6 / 10.0);
    }

    #[test]
    fn drives_and_links_are_loads() {
        let mass_of = |row: Row| softness(1.0, &[row]).heaviest;
        let motor = Row { guess: -9.81, arm: 0.5, is_angular: true, ..Row::default() };
        assert_eq!(mass_of(motor), 9.81 / 0.5 / (9.81 * H));
        assert_eq!(mass_of(Row { is_angular: false, ..motor }), 9.81 / (9.81 * H));
        // Without an arm the force of a torque is not known, and the impulse of a joint is no load.
        assert_eq!(mass_of(Row { arm: 0.0, ..motor }), 1.0);
        assert_eq!(mass_of(Row { is_geometric: true, ..motor }), 1.0);
        let link = Row { kind: Kind::Contact, is_articulated: true, link_masses: [0.0, 7.0], ..Row::default() };
        assert_eq!(mass_of(link), 7.0);
        assert_eq!(mass_of(Row { kind: Kind::Friction, ..link }), 1.0);
    }

    #[test]
    fn stiff_springs_resist_corrections_like_joints() {
        // As soft as 1000 times its response: not changed.
        assert_eq!(spring_position_softness(1000.0, 1.0), 1000.0);
        assert_eq!(spring_position_softness(1.0, 0.0), 1.0);
        // 0.1 of its response: (0.1 / 1000)⁴ is below the least of soft springs, (0.1 / 10)⁴ above that of stiff ones.
        assert!((spring_position_softness(0.1, 1.0) / (0.1 * 1e-8) - 1e-7 / 1e-9).abs() < 1e-9);
        assert!((spring_position_softness(5.0, 1.0) - 1e-3).abs() < 1e-12);
        assert_eq!(spring_position_softness(1e-9, 1.0), 1e-9);
    }

    #[test]
    fn the_softness_of_a_row_on_a_light_effective_mass_is_that_of_its_link() {
        let row = Row { effective_mass: 4.0, ..Row::default() };
        assert_eq!(softness_of(&row, 1e-4), 1e-4 / 4.0);
        assert_eq!(softness_of(&Row { effective_mass: 0.0, ..row }, 1e-4), 0.0);
        let on_links = Row { is_articulated: true, link_masses: [0.0, 0.5], ..row };
        assert_eq!(softness_of(&on_links, 1e-4), 1e-4 * 2.0);
        assert_eq!(softness_of(&Row { link_masses: [8.0, 0.0], ..on_links }, 1e-4), 1e-4 * 0.25);
    }

    #[test]
    fn rows_of_a_joint_have_one_response_for_lengths_and_one_for_angles() {
        let geometric = Row { is_geometric: true, ..Row::default() };
        let mut rows = [
            Row { response: 1.0, ..geometric },
            Row { response: 3.0, ..geometric },
            Row { response: 8.0, is_angular: true, ..geometric },
            // A limit and a motor have their own.
            Row { response: 100.0, is_limit: true, ..geometric },
            Row { response: 50.0, ..Row::default() },
            // Another joint.
            Row { response: 7.0, joint: 1, ..geometric },
            Row { response: 6.0, kind: Kind::Contact, joint: 1, ..geometric },
        ];
        average_responses(&mut rows);
        assert_eq!(rows.map(|row| row.position_response), [2.0, 2.0, 8.0, 100.0, 50.0, 7.0, 0.0]);
    }
}
