//! The reports on arms under `/diagnostics`, as data: who publishes diagnostics asks a [`Board`] for it.

use std::sync::{Arc, Weak};

use ambf_plugin::SnapshotSlot;
use crossbeam_channel::Sender;
use parking_lot::Mutex;

use crate::arm::State;
use crate::exchange::{ArmStatus, Status};
use crate::local::End;
use crate::serve::{wall_time, PAUSED};

/// How serious it is; the numbers are those of `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Severity {
    /// As it should be.
    Ok = 0,
    /// Worth a look.
    Warn = 1,
    /// Does not work.
    Error = 2,
}

/// Status of an arm.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmDiagnostic {
    /// Its name space, such as `/PSM1`.
    pub name: String,
    /// How serious it is.
    pub severity: Severity,
    /// In a sentence.
    pub message: String,
    /// Names and values: `state`, `is_homed`, `is_busy`, `simulation_hz`, `snapshot_age_ms`, `state_publish_hz`.
    pub values: Vec<(&'static str, String)>,
}

/// Arms of an instance of the plugin.
pub(crate) struct Shown {
    /// Name space and publications a second of each.
    pub arms: Vec<(String, f64)>,
    pub status: Arc<SnapshotSlot<Status>>,
    /// What clients of this process may ask and command: [`crate::local`].
    pub ends: Vec<End>,
    /// Takes the seed of a run, where something is drawn.
    pub seeds: Option<Sender<u64>>,
}

/// Where all arms of a program are found; clones are the same board.
#[derive(Clone, Default)]
pub struct Board {
    all: Arc<Mutex<Vec<Weak<Shown>>>>,
    /// Clients are in this process, so that arms without a middleware are nothing to be told.
    pub(crate) is_local: bool,
}

impl Board {
    /// A board for clients of this process: [`crate::local`].
    pub fn local() -> Self {
        Self { is_local: true, ..Self::default() }
    }

    /// Shows arms until `shown` is dropped.
    pub(crate) fn add(&self, shown: &Arc<Shown>) {
        let mut all = self.all.lock();
        all.retain(|other| other.strong_count() > 0);
        all.push(Arc::downgrade(shown));
    }

    /// What is there now.
    pub(crate) fn shown(&self) -> Vec<Arc<Shown>> {
        self.all.lock().iter().filter_map(Weak::upgrade).collect()
    }

    /// The present status of each arm, in the order in which they were offered.
    pub fn statuses(&self) -> Vec<ArmDiagnostic> {
        let now = wall_time();
        self.shown().iter().flat_map(|shown| shown.diagnose(now)).collect()
    }
}

impl Shown {
    fn diagnose(&self, now: u64) -> Vec<ArmDiagnostic> {
        let status = self.status.load_full();
        let of = |(index, (name, rate)): (usize, &(String, f64))| {
            let own = status.as_ref().and_then(|status| Some((status.as_ref(), status.arms.get(index)?)));
            match own {
                Some((status, arm)) => diagnose(name, *rate, status, arm, now),
                None => ArmDiagnostic {
                    name: name.clone(),
                    severity: Severity::Warn,
                    message: "the simulation has made no step yet".into(),
                    values: Vec::new(),
                },
            }
        };
        self.arms.iter().enumerate().map(of).collect()
    }
}

fn diagnose(name: &str, rate: f64, status: &Status, arm: &ArmStatus, now: u64) -> ArmDiagnostic {
    let age = now.saturating_sub(status.wall_time);
    let period = status.statistics.period.mean;
    let frequency = if period > 0.0 { 1.0 / period } else { 0.0 };
    let (severity, message) = match (&arm.reading, arm.state.state) {
        (None, _) => (Severity::Error, "parts of the arm have left the scene".to_owned()),
        (_, State::Fault) => (Severity::Error, "it is in the state FAULT".to_owned()),
        _ if age > PAUSED.as_nanos() as u64 => (Severity::Warn, "the simulation stands still".to_owned()),
        (_, State::Enabled) if !arm.state.is_homed => (Severity::Warn, "it is not homed".to_owned()),
        (_, state) => (Severity::Ok, state.to_string()),
    };
    let values = vec![
        ("state", arm.state.state.to_string()),
        ("is_homed", arm.state.is_homed.to_string()),
        ("is_busy", arm.state.is_busy.to_string()),
        ("simulation_hz", format!("{frequency:.1}")),
        ("snapshot_age_ms", format!("{:.1}", age as f64 * 1e-6)),
        ("state_publish_hz", format!("{rate:.1}")),
    ];
    ArmDiagnostic { name: name.to_owned(), severity, message, values }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use ambf_plugin::SnapshotWriter;

    use super::*;
    use crate::arm::tests::psm;
    use crate::arm::{Arm, Dialect};
    use crate::bind::Reading;

    #[test]
    fn arms_are_shown_while_they_are_there() {
        let board = Board::default();
        let slot = Arc::new(SnapshotSlot::empty());
        let arms = vec![("/PSM1".to_owned(), 100.0), ("/PSM2".to_owned(), 100.0)];
        let shown = Arc::new(Shown { arms, status: Arc::clone(&slot), ends: Vec::new(), seeds: None });
        board.add(&shown);
        assert!(board.statuses().iter().all(|status| status.message.contains("no step")));
        let arm = Arm::new(Arc::new(psm(Dialect::Contract)));
        let mut own = ArmStatus {
            reading: Some(Reading::default()),
            set_point: *arm.set_point(),
            state: arm.operating_state(),
            absolute_forces: false,
            reference_name: None,
            has_tool: true,
        };
        let there = own;
        own.state.state = State::Fault;
        let mut writer = SnapshotWriter::new(Status::default());
        writer.publish(&slot, |status| {
            status.wall_time = wall_time();
            status.arms = vec![there, own];
        });
        let [first, second] = board.statuses().try_into().unwrap();
        assert_eq!((first.severity, first.message.as_str()), (Severity::Ok, "ENABLED"));
        assert_eq!((second.severity, second.name.as_str()), (Severity::Error, "/PSM2"));
        assert_eq!(first.values.iter().map(|(name, _)| *name).collect::<Vec<_>>()[3], "simulation_hz");
        writer.publish(&slot, |status| {
            status.wall_time = 1;
            status.arms = vec![ArmStatus { reading: None, ..there }, there];
        });
        let [first, second] = board.statuses().try_into().unwrap();
        assert_eq!((first.severity, second.severity), (Severity::Error, Severity::Warn));
        drop(shown);
        assert!(board.statuses().is_empty());
    }
}
