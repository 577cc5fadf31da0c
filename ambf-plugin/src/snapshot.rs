//! The newest value for any number of readers, without a lock.

use std::collections::VecDeque;
use std::sync::Arc;

use arc_swap::ArcSwapOption;

/// Where the newest snapshot is found.
pub type SnapshotSlot<T> = ArcSwapOption<T>;

/// The physics thread's end: fills a snapshot that nobody reads and makes it the newest, without waiting or allocating.
pub struct SnapshotWriter<T> {
    pool: VecDeque<Arc<T>>,
    /// Whether what is in the slot may come from another writer, with arrays of other sizes.
    is_new: bool,
}

/// Readers hold a snapshot for microseconds; with this many in turn one is always free.
const POOL: usize = 6;

impl<T: Clone> SnapshotWriter<T> {
    /// A writer of snapshots with the array sizes of `template`.
    pub fn new(template: T) -> Self {
        Self { pool: (0..POOL).map(|_| Arc::new(template.clone())).collect(), is_new: true }
    }

    /// Lets `fill` overwrite a free snapshot and swaps it into `slot`. False, and nothing is published, in the rare
    /// case that readers hold all of them.
    pub fn publish(&mut self, slot: &SnapshotSlot<T>, fill: impl FnOnce(&mut T)) -> bool {
        for _ in 0..self.pool.len() {
            let Some(mut candidate) = self.pool.pop_front() else { break };
            if let Some(snapshot) = Arc::get_mut(&mut candidate) {
                fill(snapshot);
                let old = slot.swap(Some(candidate));
                if !std::mem::take(&mut self.is_new) {
                    self.pool.extend(old);
                }
                return true;
            }
            self.pool.push_back(candidate);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_is_read_and_old_ones_stay_whole_while_held() {
        let slot = SnapshotSlot::empty();
        let mut writer = SnapshotWriter::new(vec![0.0; 2]);
        let fill = |k: u32| move |s: &mut Vec<f64>| s.fill(f64::from(k));
        assert!(writer.publish(&slot, fill(1)));
        let held = slot.load_full().unwrap();
        for k in 2..100 {
            assert!(writer.publish(&slot, fill(k)));
        }
        assert_eq!(*held, [1.0, 1.0]);
        assert_eq!(*slot.load_full().unwrap(), [99.0, 99.0]);
    }

    #[test]
    fn what_another_writer_left_is_not_filled() {
        let slot = SnapshotSlot::empty();
        assert!(SnapshotWriter::new(Vec::<f64>::new()).publish(&slot, |_| ()));
        let mut writer = SnapshotWriter::new(vec![0.0]);
        for _ in 0..2 * POOL {
            assert!(writer.publish(&slot, |numbers| numbers[0] = 1.0));
        }
    }

    #[test]
    fn readers_that_hold_everything_cost_a_publication_not_a_wait() {
        let slot = SnapshotSlot::empty();
        let mut writer = SnapshotWriter::new(0);
        let held: Vec<_> = (0..POOL)
            .map(|k| {
                assert!(writer.publish(&slot, |number| *number = k));
                slot.load_full()
            })
            .collect();
        assert!(!writer.publish(&slot, |_| ()));
        drop(held);
        assert!(writer.publish(&slot, |_| ()));
    }
}
