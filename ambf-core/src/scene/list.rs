//! What the scene does alike with objects of all types but joints.
//!
//! A type implements [`SceneObject`] in its own file and has one line in [`Scene::lists`](super::Scene). What is done
//! with all objects then goes over these lists.

use std::any::Any;
use std::fmt::Debug;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use nalgebra::Isometry3;

use super::build::Builder;
use super::commands::Commands;
use super::{Identity, NameMap, ObjectType, Scene};
use crate::adf;
use crate::comm::{ObjectKind, Snapshot};
use crate::ids::{BodyId, Id, ModelId, Table};

/// An object, usually one with a State.
pub(super) trait SceneObject: Sized {
    /// What names it.
    type Id: Id;
    /// What of it changes while the simulation runs, beside what Bullet knows.
    type Saved: Debug + Send + Sync + 'static;
    /// Its type for plugins.
    const TYPE: ObjectType;
    /// Place of the type among those of a model, in which commands are executed, objects updated and plugins called.
    const RANK: u8;
    /// Whether [`update`](Self::update) does something.
    const ACTS: bool = false;
    /// Whether it belongs to the bodies: a reset of the bodies resets it, too.
    const RESETS_WITH_BODIES: bool = false;
    /// Whether it is built after the joints of its model, not before.
    const FOLLOWS_JOINTS: bool = false;

    /// Names and publishing rates.
    fn identity(&self) -> &Identity;

    /// Builds all objects of this type in a model. Default: nothing.
    fn add_all(_builder: &mut Builder<'_>, _model: &adf::Model) {}

    /// Its description for clients. Default: none, the type has no State and no Command.
    fn kind(&self, _id: Self::Id, _scene: &Scene) -> Option<ObjectKind> {
        None
    }

    /// The body with which it leaves the scene. Default: none.
    fn stands_on(&self, _id: Self::Id) -> Option<BodyId> {
        None
    }

    /// Appends place for its state.
    fn make_room(&self, scene: &Scene, snapshot: &mut Snapshot);

    /// Writes its state. Default: nothing.
    fn read(&self, _id: Self::Id, _scene: &Scene, _snapshot: &mut Snapshot) {}

    /// The place where its commands are taken and executed. Default: none, commands do nothing to it.
    fn commands(_id: Self::Id) -> Option<Box<dyn Commands>> {
        None
    }

    /// Pose in the world, as plugins see it. Default: none.
    fn pose(&self, _id: Self::Id, _scene: &Scene) -> Option<Isometry3<f64>> {
        None
    }

    /// Appends the numbers that plugins can read of it. Default: none.
    fn values(&self, _scene: &Scene, _out: &mut Vec<f64>) {}

    /// What it does in an iteration after the sub-steps. Sub-step and update in s.
    fn update(_scene: &mut Scene, _id: Self::Id, _sub_step: f64, _interval: f64) {}

    /// Back to the start, in a reset. Bodies have let go of what holds them, and are reset before what stands on them.
    fn reset(scene: &mut Scene, id: Self::Id);

    /// What [`restore`](Self::restore) needs.
    fn save(&self) -> Self::Saved;

    /// Back to a state of before.
    fn restore(&mut self, saved: &Self::Saved);
}

/// All objects `T` of a type, in order of creation, named by ids `I`. What was removed keeps its place.
#[derive(Debug)]
pub struct Objects<I, T> {
    list: Table<I, T>,
    /// By qualified identifier, without what was removed.
    pub names: NameMap<I>,
}

impl<I, T> Default for Objects<I, T> {
    fn default() -> Self {
        Self { list: Table::default(), names: NameMap::default() }
    }
}

impl<I, T> Deref for Objects<I, T> {
    type Target = Table<I, T>;

    fn deref(&self) -> &Self::Target {
        &self.list
    }
}

impl<I, T> DerefMut for Objects<I, T> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.list
    }
}

impl<'a, I, T> IntoIterator for &'a Objects<I, T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        (&self.list).into_iter()
    }
}

impl<'a, I, T> IntoIterator for &'a mut Objects<I, T> {
    type Item = &'a mut T;
    type IntoIter = std::slice::IterMut<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        (&mut self.list).into_iter()
    }
}

/// Updates the object of an index.
pub(super) type Update = fn(&mut Scene, usize, f64, f64);

/// Resets the object of an index.
pub(super) type Reset = fn(&mut Scene, usize);

/// Builds objects of a model.
pub(super) type Add = fn(&mut Builder<'_>, &adf::Model);

/// What was saved of objects of one type.
pub(super) trait SavedObjects: Any + Debug + Send + Sync {}

impl<T: Any + Debug + Send + Sync> SavedObjects for T {}

/// What was saved of a list.
pub(super) type SavedList = Arc<dyn SavedObjects>;

/// [`Objects`] of any type.
pub(super) trait ObjectList {
    fn object_type(&self) -> ObjectType;
    fn rank(&self) -> u8;
    /// `None`: objects of this type do nothing by themselves.
    fn update(&self) -> Option<Update>;
    /// What resets one of them, and whether a reset of the bodies does so.
    fn reset(&self) -> (Reset, bool);
    /// What builds them before the joints of their model, or after; `None` where they are built the other time.
    fn add(&self, follows_joints: bool) -> Option<Add>;
    fn count(&self) -> usize;
    /// The index that the next object will have.
    fn next_index(&self) -> usize;
    fn identity(&self, index: usize) -> Option<&Identity>;
    fn kind(&self, index: usize, scene: &Scene) -> Option<ObjectKind>;
    fn stands_on(&self, index: usize) -> Option<BodyId>;
    fn commands(&self, index: usize) -> Option<Box<dyn Commands>>;
    fn pose(&self, index: usize, scene: &Scene) -> Option<Isometry3<f64>>;
    fn values(&self, index: usize, scene: &Scene, out: &mut Vec<f64>);
    /// By the whole name, and by a part that no other name has.
    fn find(&self, text: &str) -> (Option<usize>, Option<usize>);
    fn make_room(&self, scene: &Scene, snapshot: &mut Snapshot);
    fn read(&self, scene: &Scene, snapshot: &mut Snapshot);
    fn save(&self) -> SavedList;
    fn restore(&mut self, saved: &SavedList);
    /// Enters the objects of a model under their keys, sorted by key, as the C++ program's maps are.
    fn enter_names(&mut self, model: ModelId);
    fn forget_names(&mut self, is_gone: &[bool]);
    /// Gives up the places of these objects.
    fn vacate(&mut self, indices: &[usize]);
}

impl<T: SceneObject> ObjectList for Objects<T::Id, T> {
    fn object_type(&self) -> ObjectType {
        T::TYPE
    }

    fn rank(&self) -> u8 {
        T::RANK
    }

    fn update(&self) -> Option<Update> {
        T::ACTS.then_some(|scene, index, sub_step, interval| {
            T::update(scene, T::Id::from_index(index), sub_step, interval);
        })
    }

    fn reset(&self) -> (Reset, bool) {
        (|scene, index| T::reset(scene, T::Id::from_index(index)), T::RESETS_WITH_BODIES)
    }

    fn add(&self, follows_joints: bool) -> Option<Add> {
        (T::FOLLOWS_JOINTS == follows_joints).then_some(T::add_all)
    }

    fn count(&self) -> usize {
        self.list.len()
    }

    fn next_index(&self) -> usize {
        self.list.next_id().to_index()
    }

    fn identity(&self, index: usize) -> Option<&Identity> {
        self.list.get(T::Id::from_index(index)).map(T::identity)
    }

    fn kind(&self, index: usize, scene: &Scene) -> Option<ObjectKind> {
        let id = T::Id::from_index(index);
        self.list[id].kind(id, scene)
    }

    fn stands_on(&self, index: usize) -> Option<BodyId> {
        let id = T::Id::from_index(index);
        self.list.get(id)?.stands_on(id)
    }

    fn commands(&self, index: usize) -> Option<Box<dyn Commands>> {
        T::commands(T::Id::from_index(index))
    }

    fn pose(&self, index: usize, scene: &Scene) -> Option<Isometry3<f64>> {
        let id = T::Id::from_index(index);
        self.list.get(id)?.pose(id, scene)
    }

    fn values(&self, index: usize, scene: &Scene, out: &mut Vec<f64>) {
        self.list[T::Id::from_index(index)].values(scene, out);
    }

    fn find(&self, text: &str) -> (Option<usize>, Option<usize>) {
        (self.names.exact(text).map(T::Id::to_index), self.names.id(text).map(T::Id::to_index))
    }

    fn make_room(&self, scene: &Scene, snapshot: &mut Snapshot) {
        self.list.iter().for_each(|object| object.make_room(scene, snapshot));
    }

    fn read(&self, scene: &Scene, snapshot: &mut Snapshot) {
        self.list.entries().for_each(|(id, object)| object.read(id, scene, snapshot));
    }

    fn save(&self) -> SavedList {
        Arc::new(self.list.iter().map(T::save).collect::<Vec<_>>())
    }

    fn restore(&mut self, saved: &SavedList) {
        let saved: &dyn Any = &**saved;
        let saved = saved.downcast_ref::<Vec<T::Saved>>().expect("lists are saved and restored in one order");
        self.list.iter_mut().zip(saved).for_each(|(object, saved)| object.restore(saved));
    }

    fn enter_names(&mut self, model: ModelId) {
        let new = self.list.entries().filter(|(_, object)| object.identity().model == model);
        let mut new: Vec<_> = new.map(|(id, object)| (object.identity().key(), id)).collect();
        new.sort();
        new.iter().for_each(|(key, id)| self.names.insert(key, *id));
    }

    fn forget_names(&mut self, is_gone: &[bool]) {
        self.names.remove(|id| is_gone[id.to_index()]);
    }

    fn vacate(&mut self, indices: &[usize]) {
        self.list.vacate(indices.iter().copied().map(T::Id::from_index));
    }
}
