//! `/diagnostics` (REP 107): how the physics, the input devices and the arms are.

use ambf_core::comm::Snapshot;
use ambf_core::device::host::{DeviceState, DeviceStatus};
use crtk::diagnostics::ArmDiagnostic;
use parking_lot::Mutex;

use super::messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus as Status, KeyValue};
use super::messages::header;
use super::Extras;

/// Topic of all reports on the health of nodes and devices.
pub(super) const TOPIC: &str = "/diagnostics";

/// How often it is published, Hz.
pub(super) const FREQUENCY: u32 = 1;

/// The newest status of each input device, for the threads that tell clients.
#[derive(Default)]
pub struct DeviceReports(Mutex<Vec<DeviceStatus>>);

impl DeviceReports {
    /// Replaces the reports.
    pub fn set(&self, devices: Vec<DeviceStatus>) {
        *self.0.lock() = devices;
    }

    /// Devices that were loaded.
    pub(super) fn count(&self) -> u8 {
        u8::try_from(self.0.lock().len()).unwrap_or(u8::MAX)
    }

    fn statuses(&self) -> Vec<Status> {
        self.0.lock().iter().map(device).collect()
    }
}

/// Reports on the physics of the world whose topics begin with `world`, on all devices and on the arms of `extras`. `lost`: why the state was
/// lost. `lost_before`: [`lost_time`](ambf_core::comm::Timing::lost_time) at the report before, s; it is brought up to
/// date.
pub(super) fn message(
    world: &str,
    snapshot: &Snapshot,
    lost: Option<&str>,
    lost_before: &mut f64,
    extras: &Extras,
) -> DiagnosticArray {
    let mut status = vec![physics(world, snapshot, lost, lost_before)];
    status.extend(extras.devices.statuses());
    status.extend(extras.arms.statuses().into_iter().map(arm));
    // The time of sending: a lost state has an old stamp.
    DiagnosticArray { header: header(None), status }
}

fn physics(world: &str, snapshot: &Snapshot, lost: Option<&str>, lost_before: &mut f64) -> Status {
    let timing = &snapshot.timing;
    let recent = timing.lost_time - std::mem::replace(lost_before, timing.lost_time);
    let (level, message) = match lost {
        Some(why) => (Status::ERROR, why.to_owned()),
        None if recent > 0.0 => (Status::WARN, format!("{recent:.3} s of simulated time were not computed")),
        None if timing.is_slow() => {
            let (cost, allowed) = (timing.step_cost[0], timing.allowed_cost);
            (
                Status::WARN,
                format!("slower than the clock: an iteration costs {cost:.6} s, its period is {allowed:.6} s"),
            )
        }
        None => (Status::OK, "running".to_owned()),
    };
    let [median, _, p99, longest] = timing.step_cost;
    let values = [
        ("simulated time, s", snapshot.sim_time.to_string()),
        ("iterations", snapshot.sim_step.to_string()),
        ("frequency, Hz", timing.physics_frequency.to_string()),
        ("time not computed, s", timing.lost_time.to_string()),
        ("cost of an iteration, median, s", median.to_string()),
        ("cost of an iteration, 99th percentile, s", p99.to_string()),
        ("cost of an iteration, longest, s", longest.to_string()),
    ];
    let name = format!("ambf_simulator: physics of {world}");
    Status { level, name, message, hardware_id: String::new(), values: pairs(values) }
}

fn device(device: &DeviceStatus) -> Status {
    let (level, message) = match device.state {
        DeviceState::Running => (Status::OK, "running"),
        DeviceState::Opening => (Status::WARN, "being opened"),
        DeviceState::Stalled => (Status::WARN, "its driver does not return; its end-effector stays where it is"),
        DeviceState::Lost => (Status::ERROR, "away; it will be opened again"),
        DeviceState::Closed => (Status::ERROR, "not in use"),
    };
    let [median, p99, _, longest] = device.loops.periods;
    let values = [
        ("loop, Hz", device.loops.latest.to_string()),
        ("loop, mean since the start, Hz", device.loops.mean.to_string()),
        ("period of the loop, median, s", median.to_string()),
        ("period of the loop, 99th percentile, s", p99.to_string()),
        ("period of the loop, longest, s", longest.to_string()),
        ("measurements, Hz", device.samples.latest.to_string()),
        ("force, N", device.force.force.norm().to_string()),
    ];
    Status {
        level,
        name: format!("ambf_simulator: device {}", device.name),
        message: message.to_owned(),
        hardware_id: format!("{} {}", device.model, device.identity).trim_end().to_owned(),
        values: pairs(values),
    }
}

fn arm(arm: ArmDiagnostic) -> Status {
    Status {
        level: arm.severity as i8,
        name: format!("ambf_simulator: arm {}", arm.name),
        message: arm.message,
        hardware_id: String::new(),
        values: pairs(arm.values),
    }
}

fn pairs<'k>(values: impl IntoIterator<Item = (&'k str, String)>) -> Vec<KeyValue> {
    values.into_iter().map(|(key, value)| KeyValue { key: key.to_owned(), value }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::Timing;

    #[test]
    fn a_lost_state_is_an_error() {
        let why = "lost at step 7: …; a reset resumes";
        let report = message("/w", &Snapshot::default(), Some(why), &mut 0.0, &Extras::default());
        let [status] = &report.status[..] else { panic!("{report:?}") };
        assert_eq!((status.level, status.message.as_str()), (Status::ERROR, why));
    }

    #[test]
    fn fixed_steps_that_cost_more_than_their_period_are_a_warning() {
        let report = |step_cost: f64, allowed_cost| {
            let timing = Timing { step_cost: [step_cost, 0.1, 0.1, 0.1], allowed_cost, ..Default::default() };
            let snapshot = Snapshot { timing, ..Default::default() };
            message("/w", &snapshot, None, &mut 0.0, &Extras::default()).status.remove(0)
        };
        let slow = report(0.007, 0.005);
        assert_eq!(slow.level, Status::WARN);
        assert!(slow.message.contains("0.007000 s") && slow.message.contains("0.005000 s"), "{}", slow.message);
        assert_eq!((report(0.004, 0.005).level, report(0.007, 0.0).level), (Status::OK, Status::OK));
    }

    #[test]
    fn time_that_was_lost_since_the_report_before_is_a_warning() {
        let (mut before, none) = (0.0, Extras::default());
        let mut report = |lost_time| {
            let timing = Timing { lost_time, ..Default::default() };
            let snapshot = Snapshot { timing, ..Default::default() };
            message("/ambf/env/World", &snapshot, None, &mut before, &none).status.remove(0)
        };
        assert_eq!((report(0.0).level, report(0.25).level, report(0.25).level), (0, 1, 0));
        let status = report(0.75);
        assert!(status.message.starts_with("0.500 s"), "{status:?}");
        assert_eq!(status.name, "ambf_simulator: physics of /ambf/env/World");
        assert!(status.values.iter().any(|value| value.key == "time not computed, s" && value.value == "0.75"));
    }

    #[test]
    fn every_device_has_a_report() {
        let extras = Extras::default();
        let status = |name: &str, state| DeviceStatus {
            name: name.into(),
            model: "Falcon".into(),
            identity: "3".into(),
            cameras: Vec::new(),
            state,
            loops: Default::default(),
            samples: Default::default(),
            force: Default::default(),
        };
        extras.devices.set(vec![status("left", DeviceState::Running), status("right", DeviceState::Lost)]);
        let found = message("/w", &Snapshot::default(), None, &mut 0.0, &extras).status;
        let of = |index: usize| (found[index].name.as_str(), found[index].level, found[index].hardware_id.as_str());
        assert_eq!(of(1), ("ambf_simulator: device left", Status::OK, "Falcon 3"));
        assert_eq!(of(2), ("ambf_simulator: device right", Status::ERROR, "Falcon 3"));
        assert_eq!(extras.devices.count(), 2);
    }
}
