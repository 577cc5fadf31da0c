//! Names of what a scene is made of, a type for each, and lists that only the right one indexes.
//!
//! An id says where something stands in its list, in order of creation. It never names another object: only the same
//! object of the same model gets it again, when that model was removed and is added again. Ids are not positions in a
//! [`Hub`](crate::comm::Hub), which are never used again: those are [`HubIndex`](crate::comm::HubIndex). Interfaces
//! without types, those of plugins and of Python, have the bare number: `new` and `index` convert.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Index, IndexMut};

/// An index of a [`Table`].
pub trait Id: Copy + Eq + Ord + fmt::Debug {
    /// The id with this index.
    fn from_index(index: usize) -> Self;

    /// Place in the list, from 0.
    fn to_index(self) -> usize;
}

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident $(= $object:ident)?;)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name(usize);

        impl $name {
            /// The id with this index.
            pub const fn new(index: usize) -> Self {
                Self(index)
            }

            /// Place in the list, from 0.
            pub const fn index(self) -> usize {
                self.0
            }
        }

        impl $crate::ids::Id for $name {
            fn from_index(index: usize) -> Self {
                Self(index)
            }

            fn to_index(self) -> usize {
                self.0
            }
        }

        $(impl From<$name> for ambf_plugin::ObjectId {
            fn from(id: $name) -> Self {
                Self { kind: ambf_plugin::ObjectType::$object, index: id.0 }
            }
        })?
    )*};
}

pub(crate) use ids;

// Those of objects with a State follow from their list.
pub use crate::comm::object_ids::*;

ids! {
    /// Names a model; the environment is the first.
    ModelId;
    /// Names a joint.
    JointId = Joint;
    /// Names a volume.
    VolumeId = Volume;
}

impl ModelId {
    /// What stands in the world file and in the environment model it names.
    pub const ENVIRONMENT: Self = Self(0);
}

/// A list that is indexed by the ids `I`. It grows at its end, or where entries were [given up](Table::vacate).
///
/// ```
/// use ambf_core::ids::{BodyId, Table};
/// let mut names: Table<BodyId, &str> = Table::default();
/// let base = names.push("base");
/// assert_eq!(names[base], "base");
/// ```
///
/// An id of another type is refused:
///
/// ```compile_fail,E0308
/// use ambf_core::ids::{BodyId, JointId, Table};
/// let names: Table<BodyId, &str> = vec!["base"].into();
/// names[JointId::new(0)];
/// ```
#[derive(Clone, PartialEq)]
pub struct Table<I, T> {
    list: Vec<T>,
    /// Indices of the entries that were given up, the largest first.
    vacant: Vec<usize>,
    id: PhantomData<fn() -> I>,
}

impl<I, T> Default for Table<I, T> {
    fn default() -> Self {
        Self::from(Vec::new())
    }
}

impl<I, T: fmt::Debug> fmt::Debug for Table<I, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.list.fmt(f)
    }
}

impl<I, T> From<Vec<T>> for Table<I, T> {
    fn from(list: Vec<T>) -> Self {
        Self { list, vacant: Vec::new(), id: PhantomData }
    }
}

impl<I: Id, T> Table<I, T> {
    /// `value` for each of `n` ids.
    pub fn filled(value: T, n: usize) -> Self
    where
        T: Clone,
    {
        vec![value; n].into()
    }

    /// Puts an entry at the first place that was given up, else at the end.
    pub fn push(&mut self, entry: T) -> I {
        let id = self.next_id();
        match self.vacant.pop() {
            Some(index) => self.list[index] = entry,
            None => self.list.push(entry),
        }
        id
    }

    /// Gives up the places of `ids`: the entries stay until others are [pushed](Self::push). Replaces what was given up
    /// before.
    pub fn vacate(&mut self, ids: impl IntoIterator<Item = I>) {
        self.vacant = ids.into_iter().map(I::to_index).filter(|&index| index < self.list.len()).collect();
        self.vacant.sort_unstable_by(|a, b| b.cmp(a));
        self.vacant.dedup();
    }

    /// Takes memory for `additional` entries, and no more.
    pub fn reserve_exact(&mut self, additional: usize) {
        self.list.reserve_exact(additional);
    }

    /// The id that the next entry will have.
    pub fn next_id(&self) -> I {
        I::from_index(self.vacant.last().copied().unwrap_or(self.list.len()))
    }

    /// How many entries there are.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// The entry of an id, if there is one.
    pub fn get(&self, id: I) -> Option<&T> {
        self.list.get(id.to_index())
    }

    /// The entry of an id, if there is one.
    pub fn get_mut(&mut self, id: I) -> Option<&mut T> {
        self.list.get_mut(id.to_index())
    }

    /// All ids.
    pub fn ids(&self) -> impl DoubleEndedIterator<Item = I> + use<I, T> {
        (0..self.list.len()).map(I::from_index)
    }

    /// All entries.
    pub fn iter(&self) -> std::slice::Iter<'_, T> {
        self.list.iter()
    }

    /// All entries.
    pub fn iter_mut(&mut self) -> std::slice::IterMut<'_, T> {
        self.list.iter_mut()
    }

    /// All entries with their ids.
    pub fn entries(&self) -> impl DoubleEndedIterator<Item = (I, &T)> + ExactSizeIterator {
        self.list.iter().enumerate().map(|(index, entry)| (I::from_index(index), entry))
    }

    /// All entries with their ids.
    pub fn entries_mut(&mut self) -> impl Iterator<Item = (I, &mut T)> {
        self.list.iter_mut().enumerate().map(|(index, entry)| (I::from_index(index), entry))
    }

    /// The id of the first entry for which `is_it` is true.
    pub fn position(&self, is_it: impl FnMut(&T) -> bool) -> Option<I> {
        self.list.iter().position(is_it).map(I::from_index)
    }

    /// The first entry, if there is one.
    pub fn first(&self) -> Option<&T> {
        self.list.first()
    }

    /// All entries, by index.
    pub fn as_slice(&self) -> &[T] {
        &self.list
    }

    /// All entries, by index.
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.list
    }

    /// Appends `value` until there are `n` entries.
    pub fn grow(&mut self, n: usize, value: T)
    where
        T: Clone,
    {
        self.list.resize(n.max(self.list.len()), value);
    }
}

impl<I: Id, T> Index<I> for Table<I, T> {
    type Output = T;

    fn index(&self, id: I) -> &T {
        &self.list[id.to_index()]
    }
}

impl<I: Id, T> IndexMut<I> for Table<I, T> {
    fn index_mut(&mut self, id: I) -> &mut T {
        &mut self.list[id.to_index()]
    }
}

impl<I, T> FromIterator<T> for Table<I, T> {
    fn from_iter<L: IntoIterator<Item = T>>(entries: L) -> Self {
        Vec::from_iter(entries).into()
    }
}

impl<'a, I, T> IntoIterator for &'a Table<I, T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.list.iter()
    }
}

impl<'a, I, T> IntoIterator for &'a mut Table<I, T> {
    type Item = &'a mut T;
    type IntoIter = std::slice::IterMut<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.list.iter_mut()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_that_were_given_up_are_taken_first_in_ascending_order() {
        let mut names: Table<BodyId, &str> = vec!["a", "b", "c", "d"].into();
        names.vacate([3, 1, 1, 9].map(BodyId::new));
        assert_eq!((names.len(), names[BodyId::new(1)]), (4, "b"), "entries stay until they are replaced");
        let ids = ["e", "f", "g"].map(|name| {
            let next = names.next_id();
            assert_eq!(next, names.push(name));
            next.index()
        });
        assert_eq!(ids, [1, 3, 4]);
        assert_eq!(names.as_slice(), ["a", "e", "c", "f", "g"]);
    }
}
