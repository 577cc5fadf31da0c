//! Lists that grow in memory of a fixed size: nothing is allocated in a step.

use std::ops::{Deref, DerefMut};

/// The first elements of its places.
#[derive(Debug)]
pub struct List<'a, T> {
    places: &'a mut [T],
    count: usize,
}

impl<'a, T> List<'a, T> {
    /// An empty list.
    pub fn new(places: &'a mut [T]) -> Self {
        Self { places, count: 0 }
    }

    /// Of elements that are there.
    pub fn full(places: &'a mut [T]) -> Self {
        let count = places.len();
        Self { places, count }
    }

    /// Appends an element, if there is a place for it.
    pub fn push(&mut self, element: T) {
        if let Some(place) = self.places.get_mut(self.count) {
            *place = element;
            self.count += 1;
        }
    }

    /// Removes all elements.
    pub fn clear(&mut self) {
        self.count = 0;
    }
}

impl<T> Default for List<'_, T> {
    fn default() -> Self {
        Self { places: &mut [], count: 0 }
    }
}

impl<T> Deref for List<'_, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.places[..self.count]
    }
}

impl<T> DerefMut for List<'_, T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.places[..self.count]
    }
}
