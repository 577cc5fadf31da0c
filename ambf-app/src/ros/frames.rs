//! The frames of bodies for tf, and the URDF that has a link for each.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::SystemTime;

use ambf_core::comm::{Hub, Snapshot};
use ambf_core::ids::BodyId;
use ambf_core::scene::{RobotDescription, WORLD_LINK};
use nalgebra::Isometry3;
use parking_lot::Mutex;

use super::messages::{geometry_msgs, pose, std_msgs, tf2_msgs, time};

/// The frames of all bodies that are published. A frame is called like the body's topics, without the first slash.
#[derive(Default)]
pub(super) struct Frames {
    names: Mutex<Names>,
    described: Mutex<Arc<Described>>,
}

#[derive(Default)]
struct Names {
    /// How often bodies came or went.
    changes: u64,
    of_bodies: BTreeMap<BodyId, String>,
}

/// A description, and what it was made of.
#[derive(Default)]
pub(super) struct Described {
    /// Counts descriptions, from 1; 0: there is none yet.
    pub count: u64,
    /// Changes of the scene and of the names.
    made_of: (u64, u64),
    pub robot: RobotDescription,
}

impl Frames {
    /// A body has come whose topics begin with `name`.
    pub fn insert(&self, body: BodyId, name: &str) {
        let mut names = self.names.lock();
        names.of_bodies.insert(body, name.trim_start_matches('/').to_owned());
        names.changes += 1;
    }

    /// A body has gone.
    pub fn remove(&self, body: BodyId) {
        let mut names = self.names.lock();
        names.of_bodies.remove(&body);
        names.changes += 1;
    }

    /// Describes the scene anew if it has changed.
    pub fn follow(&self, hub: &Hub) {
        let Some(scene) = hub.visuals() else { return };
        let (made_of, names) = {
            let names = self.names.lock();
            let made_of = (scene.generation + 1, names.changes);
            if self.described.lock().made_of == made_of {
                return;
            }
            (made_of, names.of_bodies.clone())
        };
        let robot = RobotDescription::new(&scene, |body| names.get(&body).cloned());
        let mut described = self.described.lock();
        let count = described.count + 1;
        *described = Arc::new(Described { count, made_of, robot });
    }

    /// The newest description.
    pub fn described(&self) -> Arc<Described> {
        Arc::clone(&self.described.lock())
    }

    /// The pose of each frame in the world as of `snapshot`.
    pub fn transforms(&self, snapshot: &Snapshot, stamp: SystemTime) -> tf2_msgs::TFMessage {
        let described = self.described();
        let transform = |frame: &ambf_core::scene::LinkFrame| {
            let body = snapshot.bodies.get(frame.body)?;
            let header =
                std_msgs::Header { stamp: time(stamp), frame_id: WORLD_LINK.to_owned(), ..std_msgs::Header::default() };
            let child_frame_id = frame.link.clone();
            Some(geometry_msgs::TransformStamped {
                header,
                child_frame_id,
                transform: wire(&body.body_pose(&frame.pose)),
            })
        };
        tf2_msgs::TFMessage { transforms: described.robot.frames.iter().filter_map(transform).collect() }
    }
}

/// What is published on `/tf`. While nothing moves, transforms of `snapshot` stay valid and get the time of sending; a
/// simulated time that stands still is sent once, since tf takes each time once.
pub(super) fn source(
    frames: Arc<Frames>,
    is_simulated_time: bool,
) -> impl FnMut(Option<&Snapshot>) -> Option<tf2_msgs::TFMessage> {
    let mut last = None;
    move |snapshot| {
        let snapshot = snapshot?;
        let is_old = last.replace(snapshot.stamp) == Some(snapshot.stamp);
        match (is_old, is_simulated_time) {
            (true, true) => None,
            (true, false) => Some(frames.transforms(snapshot, SystemTime::now())),
            (false, _) => Some(frames.transforms(snapshot, snapshot.stamp)),
        }
    }
}

fn wire(frame: &Isometry3<f64>) -> geometry_msgs::Transform {
    let geometry_msgs::Pose { position, orientation } = pose(frame);
    let geometry_msgs::Point { x, y, z } = position;
    geometry_msgs::Transform { translation: geometry_msgs::Vector3 { x, y, z }, rotation: orientation }
}
