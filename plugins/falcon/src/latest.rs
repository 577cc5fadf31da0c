use std::sync::Arc;

use crossbeam_utils::atomic::AtomicCell;

/// Two boxes at most travel between the ends, so that nothing is allocated once both exist.
struct Shared<T> {
    new: AtomicCell<Option<Box<T>>>,
    used: AtomicCell<Option<Box<T>>>,
}

/// The end of a slot for the newest value that writes.
pub(crate) struct Writer<T>(Arc<Shared<T>>);

/// The end of a slot for the newest value that reads.
pub(crate) struct Reader<T> {
    shared: Arc<Shared<T>>,
    value: T,
}

/// A slot that hands the newest value from one thread to another; neither ever waits.
pub(crate) fn latest<T: Copy>(initial: T) -> (Writer<T>, Reader<T>) {
    let shared = Arc::new(Shared { new: AtomicCell::new(None), used: AtomicCell::new(Some(Box::new(initial))) });
    (Writer(Arc::clone(&shared)), Reader { shared, value: initial })
}

impl<T: Copy> Writer<T> {
    /// Replaces the value, read or not.
    pub fn set(&mut self, value: T) {
        let letter = match self.0.used.take() {
            Some(mut letter) => {
                *letter = value;
                letter
            }
            None => Box::new(value),
        };
        if let Some(unread) = self.0.new.swap(Some(letter)) {
            self.0.used.store(Some(unread));
        }
    }
}

impl<T: Copy> Reader<T> {
    /// The newest value.
    pub fn get(&mut self) -> T {
        if let Some(letter) = self.shared.new.take() {
            self.value = *letter;
            self.shared.used.store(Some(letter));
        }
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_value_is_read_again_and_again() {
        let (mut writer, mut reader) = latest(0);
        assert_eq!(reader.get(), 0);
        writer.set(1);
        writer.set(2);
        assert_eq!([reader.get(), reader.get()], [2, 2]);
    }

    #[test]
    fn values_are_whole_and_in_order_across_threads() {
        let (mut writer, mut reader) = latest([0_u64; 8]);
        std::thread::scope(|scope| {
            scope.spawn(move || (1..=100_000).for_each(|number| writer.set([number; 8])));
            let mut last = 0;
            while last < 100_000 {
                let value = reader.get();
                assert_eq!(value, [value[0]; 8]);
                assert!(value[0] >= last);
                last = value[0];
            }
        });
    }
}
