//! The world on the wire: `WorldState`, `WorldCmd`, the two reset topics and our own `Timing`.

use std::sync::Arc;

use ambf_core::comm::{Hub, ObjectInfo, Rates, Snapshot, WorldCommand};

use super::{Builder, ServeContext};
use crate::ros::messages::{ambf_msgs, header, rosgraph_msgs, std_msgs, time};
use crate::ros::received::FromClient;
use crate::ros::{diagnostics, frames, models, recordings, step, Extras};

/// How often `/clock` is published, Hz.
const CLOCK_FREQUENCY: u32 = 200;

/// State of the world. Zeros before the first snapshot: clients wait for the world before anything else. `lost`
/// ([`Hub::lost`]) stands in `header.frame_id`, the only text of the message, which is empty otherwise.
pub(in crate::ros) fn state(snapshot: Option<&Snapshot>, n_devices: u8, lost: Option<&str>) -> ambf_msgs::WorldState {
    let mut state = ambf_msgs::WorldState { header: header(snapshot), ..Default::default() };
    lost.unwrap_or_default().clone_into(&mut state.header.frame_id);
    if let Some(snapshot) = snapshot {
        state.dynamic_loop_freq = snapshot.timing.physics_frequency as u64;
        state.n_devices = n_devices;
        state.sim_step = snapshot.sim_step;
        state.wall_time = snapshot.wall_time as f32;
        state.sim_time = snapshot.sim_time as f32;
    }
    state
}

/// How well the simulation keeps up with the clock, and `lost` as in [`state`].
pub(in crate::ros) fn timing(snapshot: &Snapshot, lost: Option<&str>) -> ambf_msgs::Timing {
    let timing = &snapshot.timing;
    let [step_p50, step_p90, step_p99, step_max] = timing.step_cost;
    ambf_msgs::Timing {
        header: header(Some(snapshot)),
        sim_time: snapshot.sim_time,
        wall_time: snapshot.wall_time,
        lost_time: timing.lost_time,
        physics_frequency: timing.physics_frequency,
        sim_step: u64::from(snapshot.sim_step),
        step_p50,
        step_p90,
        step_p99,
        step_max,
        sub_steps_cap: timing.sub_step_cap,
        lost: lost.unwrap_or_default().to_owned(),
    }
}

/// What is done with a message on `Command`.
pub(in crate::ros) fn on_command(hub: Arc<Hub>) -> impl Fn(ambf_msgs::WorldCmd) + Send + Sync {
    move |message| {
        let command = WorldCommand {
            enable_step_throttling: message.enable_step_throttling,
            step_clock: message.step_clock,
            n_skip_steps: message.n_skip_steps,
        };
        hub.throttle().post(command, hub.now_ns());
    }
}

/// What is done with a message on `Command/Reset`.
pub(in crate::ros) fn on_reset(hub: Arc<Hub>) -> impl Fn(std_msgs::Empty) + Send + Sync {
    move |_| hub.request_world_reset()
}

/// What is done with a message on `Command/Reset/Bodies`.
pub(in crate::ros) fn on_body_reset(hub: Arc<Hub>) -> impl Fn(std_msgs::Empty) + Send + Sync {
    move |_| hub.request_body_reset()
}

/// Always this frequency, Hz.
fn at(frequency: u32) -> Rates {
    Rates { min: frequency, max: frequency }
}

impl Builder<'_> {
    pub(super) fn world(&mut self, info: &ObjectInfo, name: String) {
        let (hub, devices) = (Arc::clone(&self.around.hub), Arc::clone(&self.around.extras.devices));
        self.publish(format!("{name}/State"), info.rates, true, move |snapshot| {
            Some(state(snapshot, devices.count(), hub.lost().as_deref().map(String::as_str)))
        });
        let hub = Arc::clone(&self.around.hub);
        self.publish(format!("{name}/Timing"), at(10), false, move |snapshot| {
            Some(timing(snapshot?, hub.lost().as_deref().map(String::as_str)))
        });
        self.diagnostics(name.clone());
        self.time_and_frames();
        self.volumes(&name);
        let on_command = on_command(Arc::clone(&self.around.hub));
        let commanded = self.commanded(&name);
        self.subscribe(format!("{name}/Command"), move |message| {
            commanded.post(|_, _| {
                on_command(message);
                Ok(())
            });
        });
        self.subscribe(format!("{name}/Command/Reset"), on_reset(Arc::clone(&self.around.hub)));
        // The second name never was one, but texts about the competition's scene have it.
        for end in ["Reset/Bodies", "ResetBodies"] {
            self.subscribe(format!("{name}/Command/{end}"), on_body_reset(Arc::clone(&self.around.hub)));
        }
        #[cfg(feature = "ros2")]
        if let Some(ros2) = &self.around.ros2 {
            self.served.parameters.worlds.push(name.clone());
            return ros2.serve_world(self.around, &name);
        }
        let ServeContext { hub, steppables, arguments, .. } = self.around;
        let full_name = |service: &str| arguments.mapped(format!("{name}/{service}"));
        self.served.announcements.push(step::service(full_name("step"), hub, steppables));
        if let Some(host) = &self.around.models {
            self.served.announcements.extend(models::services(full_name, host));
        }
        if let Some(host) = &self.around.recordings {
            self.served.announcements.extend(recordings::services(full_name, host));
        }
        self.served.parameters.world_states.push(full_name("State"));
        self.served.parameters.worlds.push(name);
    }

    /// Reports on the world whose topics begin with `name`, and on devices.
    fn diagnostics(&mut self, name: String) {
        let (hub, extras) = (Arc::clone(&self.around.hub), self.around.extras.clone());
        let (rates, mut lost_before) = (at(diagnostics::FREQUENCY), 0.0);
        self.publish(diagnostics::TOPIC.into(), rates, false, move |snapshot| {
            let lost = hub.lost();
            let lost = lost.as_deref().map(String::as_str);
            Some(diagnostics::message(&name, snapshot?, lost, &mut lost_before, &extras))
        });
    }

    /// `/clock` and `/tf`, where they are wanted.
    fn time_and_frames(&mut self) {
        let Extras { clock, tf, .. } = self.around.extras;
        if clock {
            self.publish("/clock".into(), at(CLOCK_FREQUENCY), false, |snapshot| {
                Some(rosgraph_msgs::Clock { clock: time(snapshot?.stamp) })
            });
        }
        if let (Some(frequency), Some(frames)) = (tf, &self.around.frames) {
            self.publish("/tf".into(), at(frequency), false, frames::source(Arc::clone(frames), clock));
        }
    }
}

impl FromClient for ambf_msgs::WorldCmd {}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{Resets, Timing};

    #[test]
    fn numbers_go_where_they_belong() {
        let snapshot = Snapshot {
            sim_step: 7,
            wall_time: 1.5,
            sim_time: 1.25,
            timing: Timing {
                lost_time: 0.25,
                physics_frequency: 999.9,
                step_cost: [1.0, 2.0, 3.0, 4.0],
                sub_step_cap: 5,
                allowed_cost: 0.0,
            },
            ..Default::default()
        };
        let world = state(Some(&snapshot), 2, None);
        assert_eq!((world.dynamic_loop_freq, world.n_devices, world.sim_step), (999, 2, 7));
        assert_eq!((world.wall_time, world.sim_time), (1.5, 1.25));
        assert_eq!(state(None, 2, None), ambf_msgs::WorldState::default());
        let timing = timing(&snapshot, None);
        assert_eq!(timing.lost, "");
        assert_eq!((timing.lost_time, timing.physics_frequency, timing.sub_steps_cap), (0.25, 999.9, 5));
        assert_eq!((timing.step_p50, timing.step_p90, timing.step_p99, timing.step_max), (1.0, 2.0, 3.0, 4.0));
    }

    #[test]
    fn a_lost_state_is_told_in_both_messages() {
        let why = Some("lost at step 7: …; a reset resumes");
        let snapshot = Snapshot { sim_step: 6, ..Default::default() };
        let world = state(Some(&snapshot), 0, why);
        assert_eq!((Some(world.header.frame_id.as_str()), world.sim_step), (why, 6));
        assert_eq!(Some(timing(&snapshot, why).lost.as_str()), why);
    }

    #[test]
    fn commands_and_resets_reach_the_hub() {
        let hub = Arc::new(Hub::new(Vec::new()));
        let message = ambf_msgs::WorldCmd { enable_step_throttling: true, step_clock: true, n_skip_steps: 3 };
        on_command(Arc::clone(&hub))(message);
        assert!(hub.throttle().is_live(hub.now_ns()));
        on_reset(Arc::clone(&hub))(std_msgs::Empty {});
        let resets = hub.take_resets();
        assert!(resets.world.is_some() && !resets.bodies);
        on_body_reset(Arc::clone(&hub))(std_msgs::Empty {});
        assert_eq!(hub.take_resets(), Resets { bodies: true, ..Resets::default() });
    }
}
