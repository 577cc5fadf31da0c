//! The world on the wire: `WorldState`, `WorldCmd`, the two reset topics and our own `Timing`.

use std::sync::Arc;

use ambf_core::comm::{Hub, Snapshot, WorldCommand};

use super::messages::{ambf_msgs, header, std_msgs};

/// State of the world. Zeros before the first snapshot: clients wait for the world before anything else. `lost`
/// ([`Hub::lost`]) stands in `header.frame_id`, the only text of the message, which is empty otherwise.
pub(super) fn state(snapshot: Option<&Snapshot>, n_devices: u8, lost: Option<&str>) -> ambf_msgs::WorldState {
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
pub(super) fn timing(snapshot: &Snapshot, lost: Option<&str>) -> ambf_msgs::Timing {
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
pub(super) fn on_command(hub: Arc<Hub>) -> impl Fn(ambf_msgs::WorldCmd) + Send + Sync {
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
pub(super) fn on_reset(hub: Arc<Hub>) -> impl Fn(std_msgs::Empty) + Send + Sync {
    move |_| hub.request_world_reset()
}

/// What is done with a message on `Command/Reset/Bodies`.
pub(super) fn on_body_reset(hub: Arc<Hub>) -> impl Fn(std_msgs::Empty) + Send + Sync {
    move |_| hub.request_body_reset()
}

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
        assert_eq!(hub.take_resets(), Resets { world: true, ..Resets::default() });
        on_body_reset(Arc::clone(&hub))(std_msgs::Empty {});
        assert_eq!(hub.take_resets(), Resets { bodies: true, ..Resets::default() });
    }
}
