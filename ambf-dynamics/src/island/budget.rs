//! Budgets of the solutions of a sub-step, in multiplications.

use super::{larger, smaller};

/// Most budgets that the parts of a sub-step share. Solutions that are found mostly take a tenth of their budget: 16
/// parts, the most, about twice the budget of one. With one that is not found a sub-step is not worth dividing.
const MOST_BUDGETS: u32 = 4;

/// Limits of the work of a sub-step, in multiplications.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Budget of all islands.
    pub base: f64,
    /// Further budget of each row.
    pub per_row: f64,
    /// Most that earlier sub-steps leave.
    pub saved: f64,
}

/// Budgets of a world, in multiplications.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Budgets {
    /// Shared by all islands of the sub-step: the base budget, and what earlier solutions have not used, because expensive
    /// problems, such as impacts, are rare.
    pub shared: f64,
    /// Of the islands of this part of the sub-step so far.
    pub part: f64,
    /// The largest one of a part of the sub-step.
    pub largest: f64,
    /// Multiplications of the sub-step so far.
    pub work: f64,
    /// Parts of the sub-step so far.
    pub parts: u32,
}

impl Budgets {
    /// Begins a sub-step, or the next part of it, which goes on with its budget.
    pub fn begin(&mut self, limits: &Limits, is_continued: bool) {
        if !is_continued {
            let shared = smaller(self.shared, limits.saved) + limits.base;
            *self = Self { shared, ..Self::default() };
        }
        self.parts += 1;
        self.part = limits.base;
    }

    /// Whether the sub-step may be divided further: not where its parts so far have used up the budget.
    pub fn may_divide(&self) -> bool {
        self.work <= f64::from(self.parts.min(MOST_BUDGETS)) * self.largest
    }

    /// Adds the budget of an island. Returns that of its rows, and the one of its position problem.
    pub(super) fn add_island(&mut self, limits: &Limits, rows: usize) -> [f64; 2] {
        let of_rows = limits.per_row * rows as f64;
        self.part += of_rows;
        self.largest = larger(self.largest, self.part);
        [of_rows, of_rows + limits.base]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { base: 100.0, per_row: 10.0, saved: 250.0 };

    #[test]
    fn what_a_sub_step_leaves_is_saved_up_to_a_limit() {
        let mut budgets = Budgets::default();
        for shared in [100.0, 200.0, 300.0, 350.0, 350.0] {
            budgets.begin(&LIMITS, false);
            assert_eq!(budgets.shared, shared);
        }
    }

    #[test]
    fn the_parts_of_a_sub_step_have_at_most_four_budgets() {
        let mut budgets = Budgets::default();
        budgets.begin(&LIMITS, false);
        assert_eq!(budgets.add_island(&LIMITS, 5), [50.0, 150.0]);
        assert_eq!(budgets.add_island(&LIMITS, 5), [50.0, 150.0]);
        assert_eq!(budgets.largest, 200.0);
        for parts in [1.0, 2.0, 3.0, 4.0, 4.0] {
            budgets.work = parts * 200.0;
            assert!(budgets.may_divide());
            budgets.work += 1.0;
            assert!(!budgets.may_divide(), "{parts}");
            let shared = budgets.shared;
            budgets.begin(&LIMITS, true);
            assert_eq!((budgets.shared, budgets.part), (shared, 100.0), "one budget for all parts");
        }
        budgets.begin(&LIMITS, false);
        assert_eq!((budgets.work, budgets.largest, budgets.parts), (0.0, 0.0, 1));
    }
}
