//! Cuts of volumes, on their way to the physics, and what became of them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Instant, SystemTime};

use ambf_volume::{Carved, Rule, Shape};
use crossbeam_channel::{bounded, Receiver, Sender, TrySendError};
use nalgebra::{Isometry3, Vector3};
use parking_lot::Mutex;

use crate::ids::{BodyId, VolumeId};

/// Commands that may wait, and cuts that may wait for one who reads of them.
const WAITING: usize = 1024;

/// A cut: what a shape removes on its way.
#[derive(Debug, Clone, PartialEq)]
pub struct CarveCommand {
    /// What cuts.
    pub shape: Shape,
    /// Where it begins.
    pub from: Isometry3<f64>,
    /// Where it ends.
    pub to: Isometry3<f64>,
    /// Both poses are in the world; else in the volume's frame, whose origin is the centre of the box.
    pub in_world: bool,
    /// How much is removed.
    pub rule: Rule,
}

/// What is done to a volume between two iterations. Each command counts, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum VolumeCommand {
    /// Voxels are removed.
    Carve(CarveCommand),
    /// The voxels of the start come back.
    Restore,
    /// A tool is switched, or gets another burr.
    Tool {
        /// Its place in the list of the volume's tools.
        tool: usize,
        /// Whether it cuts; `None`: as it is.
        on: Option<bool>,
        /// Radius of its tip, m; `None`: as it is.
        radius: Option<f64>,
    },
}

/// What a tool of a volume does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolReading {
    /// Where the centre of its tip would be without the volume, m, world axes.
    pub goal: Vector3<f64>,
    /// Where the volume lets it be, m, world axes.
    pub tip: Vector3<f64>,
    /// On the body, at all of its balls, N, world axes.
    pub force: Vector3<f64>,
    /// Radius of its tip, m.
    pub radius: f64,
    /// Whether its tip touches.
    pub is_touching: bool,
    /// Whether it cuts what it touches.
    pub is_on: bool,
    /// The body that shows its burr; those of its other burrs are not drawn.
    pub burr: Option<BodyId>,
}

/// A cut that was made.
#[derive(Debug, Clone, PartialEq)]
pub struct Cut {
    /// Of which volume.
    pub volume: VolumeId,
    /// As that of the snapshot of the same iteration.
    pub stamp: SystemTime,
    /// Simulated time, s.
    pub sim_time: f64,
    /// Iterations that stepped.
    pub sim_step: u32,
    /// What was removed; at least a voxel.
    pub carved: Carved,
}

/// Commands of volumes that wait, and those who want to know of cuts.
#[derive(Default)]
pub(super) struct Cuts {
    /// 0.2 MB, made by who leaves the first command: most worlds have no volume.
    waiting: OnceLock<(Sender<Order>, Receiver<Order>)>,
    followers: Mutex<Vec<Follower>>,
    has_followers: AtomicBool,
}

/// Who wants to know of cuts, and whether now.
struct Follower {
    cuts: Sender<Arc<Cut>>,
    is_wanted: Box<dyn Fn() -> bool + Send>,
}

/// A command, to which volume, and when it came.
pub(crate) type Order = (Instant, VolumeId, VolumeCommand);

impl Cuts {
    /// Leaves a command; `false`: there is no room for it.
    pub fn post(&self, volume: VolumeId, command: VolumeCommand) -> bool {
        let (commands, _) = self.waiting.get_or_init(|| bounded(WAITING));
        commands.try_send((Instant::now(), volume, command)).is_ok()
    }

    /// Commands that wait.
    pub fn count(&self) -> usize {
        self.waiting.get().map_or(0, |(_, waiting)| waiting.len())
    }

    pub fn take(&self) -> Option<Order> {
        self.waiting.get()?.1.try_recv().ok()
    }

    pub fn follow(&self, is_wanted: Box<dyn Fn() -> bool + Send>) -> Receiver<Arc<Cut>> {
        let (cuts, receiver) = bounded(WAITING);
        self.followers.lock().push(Follower { cuts, is_wanted });
        self.has_followers.store(true, Ordering::Release);
        receiver
    }

    /// Tells of a cut, which is made only if somebody wants it now. Who does not read for so long that there is no room
    /// misses it.
    pub fn tell(&self, make: impl FnOnce() -> Cut) {
        if !self.has_followers.load(Ordering::Acquire) {
            return;
        }
        let mut followers = self.followers.lock();
        let (mut make, mut made) = (Some(make), None);
        followers.retain(|Follower { cuts, is_wanted }| {
            if !is_wanted() {
                return true;
            }
            if let Some(make) = make.take() {
                made = Some(Arc::new(make()));
            }
            let sent = made.as_ref().map(|cut| cuts.try_send(Arc::clone(cut)));
            !matches!(sent, Some(Err(TrySendError::Disconnected(_))))
        });
        self.has_followers.store(!followers.is_empty(), Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_is_made_once_and_only_for_those_who_want_it() {
        let cuts = Cuts::default();
        let made = std::cell::Cell::new(0);
        let tell = || {
            cuts.tell(|| {
                made.set(made.get() + 1);
                let volume = VolumeId::new(0);
                Cut { volume, stamp: SystemTime::UNIX_EPOCH, sim_time: 0.0, sim_step: 0, carved: Carved::default() }
            });
            made.get()
        };
        assert_eq!(tell(), 0, "nobody follows");
        let wants = Arc::new(AtomicBool::new(false));
        let later = Arc::clone(&wants);
        let idle = cuts.follow(Box::new(move || later.load(Ordering::Relaxed)));
        assert_eq!(tell(), 0, "nobody wants it");
        let [one, other] = [(); 2].map(|()| cuts.follow(Box::new(|| true)));
        assert_eq!((tell(), one.len(), other.len(), idle.len()), (1, 1, 1, 0));
        drop(one);
        wants.store(true, Ordering::Relaxed);
        assert_eq!((tell(), other.len(), idle.len()), (2, 2, 1));
        drop((other, idle));
        assert_eq!((tell(), tell()), (3, 3), "who has gone is asked once more");
    }
}
