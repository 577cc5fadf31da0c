//! Drives (motors, controllers, springs, drives of bodies) that yield to joints and contacts in the velocity problem.
//!
//! Files give motors bounds, and springs strains and stiffnesses, that are far beyond anything their bodies can bear. Where
//! such drives contradict joints (motors of a closed loop that ask for different velocities, a spring on a mechanism
//! without degrees of freedom) or contacts (jaws that close on a wall), a joint yields by its CFM times its impulse, and opens
//! faster than the position problem can close it. The CFM of the drives is then raised, until the joints hold. Where that does
//! not help, joints open for other reasons, such as loops with more constraints than they need whose dimensions are inaccurate,
//! and drives do not yield for a while.

use super::{larger, smaller};

/// CFM of drives that yield by 1, as a share of their response.
pub(super) const YIELDING_SOFTNESS: f64 = 1e-7;
/// Opening of joints that is allowed in a sub-step, as a share of their lever arms, or rad.
const MOST_OPENED: f64 = 1e-5;
/// The yielding is a multiple of [`YIELDING_SOFTNESS`], or 0: its least change where it is raised, its change where it is lowered,
/// and its largest value.
const LEAST_RAISED: f64 = 2.0;
const LOWERED: f64 = 1.0 / 1.2;
const MOST: f64 = 1e5;
/// Sub-steps for which drives do not yield again.
const UNYIELDING: u32 = 64;

/// Whether drives are to yield more, where joints open by `opened` of their lever arms, or rad, in a sub-step.
fn is_wanted(yielding: f64, opened: f64) -> bool {
    opened > MOST_OPENED && yielding < MOST
}

/// Whether it did not help that drives yield up to the most: joints opened by `unyielding` without. Drives that yielded in
/// the last sub-step are not tried without: they did help when they began to.
fn is_in_vain(unyielding: f64, opened: f64) -> bool {
    opened > MOST_OPENED && opened > unyielding / 2.0
}

/// Whether drives may yield in this sub-step, where it did not help in the sub-step `in_vain`; 0: none.
fn is_allowed(in_vain: u32, sub_step: u32) -> bool {
    in_vain == 0 || sub_step.wrapping_sub(in_vain) >= UNYIELDING
}

/// With a drive that is much softer than the joint the opening is in inverse proportion to its CFM.
fn raised(yielding: f64, opened: f64) -> f64 {
    smaller(larger(yielding, 1.0) * larger(opened / MOST_OPENED, LEAST_RAISED), MOST)
}

/// After a sub-step that did not need more. It stays where it is just enough.
fn lowered(yielding: f64, opened: f64) -> f64 {
    if opened > LOWERED * MOST_OPENED {
        yielding
    } else if yielding * LOWERED < 1.0 {
        0.0
    } else {
        yielding * LOWERED
    }
}

/// What an island remembers from one sub-step to the next.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Memory {
    /// By how much its drives yield to its joints, as a multiple of 1e-7 of their response; 0: not.
    pub drive_yielding: f64,
    /// Sub-step in which that last did not help; 0: none.
    pub drives_yielded_in_vain: u32,
    /// See [`Statistics::guess_tolerance`](crate::mlcp::Statistics::guess_tolerance).
    pub guess_tolerance: f64,
}

/// Yielding of the drives of an island in one sub-step: the velocity problem is solved with `yielding` until
/// [`Yielding::is_done`].
#[derive(Debug)]
pub(super) struct Yielding {
    pub yielding: f64,
    may_yield: bool,
    is_first: bool,
    /// By how much joints opened where drives did not yield.
    unyielding: f64,
    sub_step: u32,
}

impl Yielding {
    /// `memory`: of an island with drives that may yield.
    pub fn new(memory: Option<&Memory>, sub_step: u32) -> Self {
        Self {
            yielding: memory.map_or(0.0, |memory| memory.drive_yielding),
            may_yield: memory.is_some_and(|memory| is_allowed(memory.drives_yielded_in_vain, sub_step)),
            is_first: true,
            unyielding: f64::INFINITY,
            sub_step,
        }
    }

    /// Whether the last solution, with which joints opened by `opened`, is the one that stays; what is to be remembered is
    /// then in `memory`. Else the problem is to be solved again with another `yielding`.
    ///
    /// `budget`: what is left of the budget, in multiplications. Drives that contradict other rows make the problem hard to
    /// solve: it may cost as much `again` with softer ones.
    pub fn is_done(&mut self, opened: f64, budget: &mut f64, again: f64, memory: &mut Memory) -> bool {
        let is_first = std::mem::replace(&mut self.is_first, false);
        self.may_yield &= is_first || *budget > 0.0;
        if self.yielding == 0.0 {
            self.unyielding = opened;
        }
        let is_in_vain = !is_first && is_in_vain(self.unyielding, opened);
        if self.may_yield && is_wanted(self.yielding, opened) {
            self.yielding = raised(self.yielding, opened);
            if is_first {
                *budget = larger(*budget, again);
            }
            return false;
        }
        if self.may_yield && is_in_vain {
            self.yielding = 0.0;
            self.may_yield = false;
            memory.drives_yielded_in_vain = self.sub_step;
            return false;
        }
        memory.drive_yielding = if is_first { lowered(self.yielding, opened) } else { self.yielding };
        if self.yielding > 0.0 && is_in_vain {
            // The budget ended.
            memory.drive_yielding = 0.0;
            memory.drives_yielded_in_vain = self.sub_step;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUB_STEP: u32 = 100;

    /// The yieldings with which a problem is solved whose joints open by `opening`, and the memory then.
    fn solve(before: Memory, mut budget: f64, opening: impl Fn(f64) -> f64) -> (Vec<f64>, Memory) {
        let (mut memory, mut tried) = (before, vec![]);
        let mut yielding = Yielding::new(Some(&memory), SUB_STEP);
        loop {
            tried.push(yielding.yielding);
            if yielding.is_done(opening(yielding.yielding), &mut budget, 0.0, &mut memory) {
                return (tried, memory);
            }
            assert!(tried.len() < 100);
        }
    }

    #[test]
    fn drives_yield_until_joints_hold() {
        let (tried, memory) = solve(Memory::default(), 1.0, |yielding| 1e-3 / (1.0 + yielding));
        // 100 times the opening that is allowed: 100, which nearly is enough, and at least doubled.
        assert_eq!(tried, [0.0, 100.0]);
        assert_eq!(memory, Memory { drive_yielding: 100.0, ..Memory::default() });
        let (tried, memory) = solve(Memory::default(), 1.0, |yielding| if yielding < 300.0 { 1.1e-5 } else { 1e-6 });
        assert_eq!(tried, [0.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0]);
        assert_eq!(memory.drive_yielding, 512.0);
    }

    #[test]
    fn drives_that_yield_grow_harder_again() {
        let before = Memory { drive_yielding: 100.0, ..Memory::default() };
        assert_eq!(solve(before, 1.0, |_| 0.0).1.drive_yielding, 100.0 / 1.2);
        // It stays where it is just enough, and ends below 1.
        assert_eq!(solve(before, 1.0, |_| 9e-6).1.drive_yielding, 100.0);
        let before = Memory { drive_yielding: 1.1, ..Memory::default() };
        assert_eq!(solve(before, 1.0, |_| 0.0).1.drive_yielding, 0.0);
    }

    #[test]
    fn drives_that_yield_in_vain_stop_for_64_sub_steps() {
        let (tried, memory) = solve(Memory::default(), 1.0, |_| 1e-3);
        assert_eq!(tried, [0.0, 100.0, 1e4, 1e5, 0.0]);
        assert_eq!(memory, Memory { drives_yielded_in_vain: SUB_STEP, ..Memory::default() });
        for (in_vain, solutions) in [(SUB_STEP - 63, 1), (SUB_STEP - 64, 5)] {
            let before = Memory { drives_yielded_in_vain: in_vain, ..Memory::default() };
            assert_eq!(solve(before, 1.0, |_| 1e-3).0.len(), solutions);
        }
        assert!(is_allowed(u32::MAX - 3, 60) && !is_allowed(u32::MAX - 3, 59), "sub-steps wrap around");
    }

    #[test]
    fn drives_that_yielded_before_are_not_judged_by_a_solution_without() {
        // Joints go on opening; it is not known whether they did more without.
        let before = Memory { drive_yielding: 1e5, ..Memory::default() };
        let (tried, memory) = solve(before, 1.0, |_| 1e-3);
        assert_eq!((tried, memory.drives_yielded_in_vain), (vec![1e5], 0));
    }

    #[test]
    fn without_budget_one_more_solution_is_tried() {
        let (tried, memory) = solve(Memory::default(), 0.0, |_| 1e-3);
        assert_eq!(tried, [0.0, 100.0]);
        assert_eq!(memory, Memory { drives_yielded_in_vain: SUB_STEP, ..Memory::default() });
        // The budget of the second solution is at least that of the first.
        let (mut budget, mut memory) = (1.0, Memory::default());
        Yielding::new(Some(&memory), SUB_STEP).is_done(1e-3, &mut budget, 5.0, &mut memory);
        assert_eq!(budget, 5.0);
    }

    #[test]
    fn without_drives_the_first_solution_stays() {
        let mut memory = Memory::default();
        assert!(Yielding::new(None, SUB_STEP).is_done(1.0, &mut 1.0, 1.0, &mut memory));
    }
}
