//! Foot pedals, which all arms of a console share.

use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::Thread;

use parking_lot::Mutex;

use crate::dialect::{Dialect, Topics};

/// A pedal or sensor of the console. The number is its bit in the mask of buttons; bit 0 is the closed gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum Pedal {
    /// Clutch.
    Clutch = 1,
    /// Coagulation.
    Coag = 2,
    /// The head of the surgeon is at the viewer.
    OperatorPresent = 3,
    /// Camera.
    Camera = 4,
    /// Camera focus plus.
    CameraPlus = 5,
    /// Camera focus minus.
    CameraMinus = 6,
}

impl Pedal {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Clutch, Self::Coag, Self::OperatorPresent, Self::Camera, Self::CameraPlus, Self::CameraMinus];

    /// Its bit in the mask of buttons.
    pub fn bit(self) -> u32 {
        1 << self as u32
    }
}

/// Which messages tell that the clutch is pressed: setting `clutch_source`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum ClutchSource {
    /// `footpedals/clutch`.
    #[default]
    Pedal,
    /// `console/clutch`, which the console derives from it (CRTK dialects only).
    Console,
}

/// Topics of the pedals below the namespace. `topics` is what is published: in the dialects of CRTK the console says
/// that the operator is there unless a pedal does.
pub fn pedal_topics(dialect: Dialect, root: &str, clutch: ClutchSource, topics: &Topics) -> Vec<(String, Pedal)> {
    use Pedal::{Camera, CameraMinus, CameraPlus, Clutch, Coag, OperatorPresent};
    let operator = format!("{root}/footpedals/operatorpresent");
    let names = match dialect {
        Dialect::Legacy => vec![
            ("footpedals/clutch", Clutch),
            ("footpedals/coag", Coag),
            ("footpedals/camera", Camera),
            ("footpedals/camera_plus", CameraPlus),
            ("footpedals/camera_minus", CameraMinus),
        ],
        _ => vec![
            match clutch {
                ClutchSource::Console if dialect.is_crtk() => ("console/clutch", Clutch),
                _ => ("footpedals/clutch", Clutch),
            },
            ("footpedals/coag", Coag),
            if dialect.is_crtk() && !topics.contains_key(&operator) {
                ("console/operator_present", OperatorPresent)
            } else {
                ("footpedals/operatorpresent", OperatorPresent)
            },
            ("footpedals/camera", Camera),
            ("footpedals/cam_plus", CameraPlus),
            ("footpedals/cam_minus", CameraMinus),
        ],
    };
    names.into_iter().map(|(name, pedal)| (format!("{root}/{name}"), pedal)).collect()
}

/// What the pedals do.
#[derive(Debug, Default)]
pub(crate) struct Pedals {
    pressed: AtomicU32,
    clicks: [AtomicU32; 7],
    /// Threads that want to know at once.
    listeners: Mutex<Vec<Thread>>,
}

impl Pedals {
    /// A message of a pedal: 0 released, 1 pressed, 2 clicked. A click is sent after the release, and latched: it is no
    /// pressed pedal.
    pub fn set(&self, pedal: Pedal, value: i32) {
        match value {
            0 => self.pressed.fetch_and(!pedal.bit(), Ordering::AcqRel),
            2 => {
                self.clicks[pedal as usize].fetch_add(1, Ordering::Relaxed);
                self.pressed.fetch_and(!pedal.bit(), Ordering::AcqRel)
            }
            _ => self.pressed.fetch_or(pedal.bit(), Ordering::AcqRel),
        };
        self.listeners.lock().iter().for_each(Thread::unpark);
    }

    /// Wakes `thread` with every message.
    pub fn wake(&self, thread: Thread) {
        let mut listeners = self.listeners.lock();
        if !listeners.iter().any(|other| other.id() == thread.id()) {
            listeners.push(thread);
        }
    }

    /// Pressed pedals, one bit each.
    pub fn pressed(&self) -> u32 {
        self.pressed.load(Ordering::Acquire)
    }

    /// How often a pedal was clicked.
    pub fn clicks(&self, pedal: Pedal) -> u32 {
        self.clicks[pedal as usize].load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_stay_and_clicks_count() {
        let pedals = Pedals::default();
        pedals.set(Pedal::Clutch, 1);
        pedals.set(Pedal::CameraMinus, 1);
        assert_eq!(pedals.pressed(), 0b100_0010);
        pedals.set(Pedal::Clutch, 0);
        pedals.set(Pedal::Clutch, 2);
        assert_eq!((pedals.pressed(), pedals.clicks(Pedal::Clutch)), (0b100_0000, 1), "a click is no pressed pedal");
    }

    #[test]
    fn the_console_tells_what_no_pedal_tells() {
        let of = |dialect, clutch, topics: &[&str]| -> Vec<String> {
            let topics = topics.iter().map(|topic| ((*topic).to_owned(), "sensor_msgs/Joy".to_owned())).collect();
            pedal_topics(dialect, "/lab", clutch, &topics).into_iter().map(|(topic, _)| topic).collect()
        };
        let topics = of(Dialect::CrtkPose, ClutchSource::Pedal, &[]);
        assert_eq!((&topics[0][..], &topics[2][..]), ("/lab/footpedals/clutch", "/lab/console/operator_present"));
        let topics = of(Dialect::CrtkPose, ClutchSource::Console, &["/lab/footpedals/operatorpresent"]);
        assert_eq!((&topics[0][..], &topics[2][..]), ("/lab/console/clutch", "/lab/footpedals/operatorpresent"));
        let topics = of(Dialect::Ambf, ClutchSource::Console, &[]);
        assert_eq!((&topics[0][..], &topics[2][..]), ("/lab/footpedals/clutch", "/lab/footpedals/operatorpresent"));
        assert!(of(Dialect::Legacy, ClutchSource::Pedal, &[]).contains(&"/lab/footpedals/camera_plus".to_owned()));
    }
}
