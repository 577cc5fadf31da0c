//! What crosses between the physics thread and the others: commands in, states and events out. Physics never waits.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::Arc;

use crossbeam_channel::{bounded, Receiver, Sender};
use parking_lot::Mutex;
use triple_buffer::{triple_buffer, Input, Output};

use crate::arm::{refused, Command, FrameName, Level, OperatingState, Refusal, SetPoint};
use crate::bind::Reading;
use crate::statistics::Statistics;

/// Moves and state commands that wait for a step; more are refused.
pub const QUEUE: usize = 32;

/// A command and its place in the order of arrival; `None`: taken.
type Place = Option<(u64, Command)>;

/// The senders' end of an arm's commands, for any thread.
pub struct Outbox {
    order: AtomicU64,
    queue: Sender<(u64, Command)>,
    is_full: AtomicBool,
    /// Newest servo command of the arm, and of its jaw. The lock is for senders only.
    servo: [Mutex<Input<Place>>; 2],
}

/// The physics thread's end.
pub struct Inbox {
    outbox: Arc<Outbox>,
    queue: Receiver<(u64, Command)>,
    servo: [Output<Place>; 2],
    /// What came since the last step, in order; its memory is used again.
    taken: Vec<(u64, Command)>,
}

/// Both ends.
pub fn commands() -> (Arc<Outbox>, Inbox) {
    let (sender, queue) = bounded(QUEUE);
    let (arm_in, arm_out) = triple_buffer::<Place>(&None);
    let (jaw_in, jaw_out) = triple_buffer::<Place>(&None);
    let outbox = Arc::new(Outbox {
        order: AtomicU64::new(0),
        queue: sender,
        is_full: AtomicBool::new(false),
        servo: [Mutex::new(arm_in), Mutex::new(jaw_in)],
    });
    let inbox =
        Inbox { outbox: Arc::clone(&outbox), queue, servo: [arm_out, jaw_out], taken: Vec::with_capacity(QUEUE + 3) };
    (outbox, inbox)
}

impl Outbox {
    /// Leaves a command for the next step. Servo commands take the place of the one before; what else is too much is
    /// dropped, and the arm says so.
    pub fn post(&self, command: Command) {
        let order = self.order.fetch_add(1, Ordering::Relaxed);
        let slot = match &command {
            Command::Joints { level: Level::Move, .. } | Command::Pose { level: Level::Move, .. } => None,
            Command::Joints { .. } | Command::Pose { .. } | Command::Twist(_) | Command::Wrench { .. } => Some(0),
            Command::Jaw { level, .. } if *level != Level::Move => Some(1),
            Command::JawEffort(_) => Some(1),
            _ => None,
        };
        match slot {
            Some(slot) => self.servo[slot].lock().write(Some((order, command))),
            None => {
                if self.queue.try_send((order, command)).is_err() {
                    self.is_full.store(true, Ordering::Release);
                }
            }
        }
    }
}

impl Inbox {
    /// What came since the last call, in the order of arrival.
    pub fn take(&mut self) -> impl Iterator<Item = Command> + '_ {
        self.taken.extend(self.queue.try_iter().take(QUEUE));
        for slot in &mut self.servo {
            if slot.update() {
                self.taken.extend(slot.output_buffer_mut().take());
            }
        }
        self.taken.sort_unstable_by_key(|(order, _)| *order);
        if self.outbox.is_full.swap(false, Ordering::AcqRel) {
            self.taken.push((u64::MAX, refused(Level::Servo, Refusal::Full)));
        }
        self.taken.drain(..).map(|(_, command)| command)
    }
}

/// An arm after a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmStatus {
    /// What was measured; `None`: the arm is not in the scene.
    pub reading: Option<Reading>,
    /// What the joints are to do.
    pub set_point: SetPoint,
    /// Operating state.
    pub state: OperatingState,
    /// Axes of wrenches are those of the base.
    pub absolute_forces: bool,
    /// Name of the reference frame, where a client has set it.
    pub reference_name: Option<FrameName>,
    /// It has an instrument.
    pub has_tool: bool,
}

/// All arms after one step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Status {
    /// Steps made.
    pub step: u64,
    /// Simulated time, ns.
    pub sim_time: u64,
    /// When the step was made, ns since 1970.
    pub wall_time: u64,
    /// How regular steps were.
    pub statistics: Statistics,
    /// In the order of the configuration.
    pub arms: Vec<ArmStatus>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::Quantity;
    use crate::kinematics::Coordinates;

    fn joints(level: Level, value: f64) -> Command {
        Command::Joints { level, quantity: Quantity::Position, value: Coordinates::repeat(value) }
    }

    #[test]
    fn the_last_servo_command_wins_and_moves_stay_in_order() {
        let (outbox, mut inbox) = commands();
        outbox.post(joints(Level::Move, 1.0));
        for k in 0..100 {
            outbox.post(joints(Level::Servo, f64::from(k)));
        }
        outbox.post(Command::Jaw { level: Level::Servo, angle: 0.1 });
        outbox.post(joints(Level::Move, 2.0));
        let taken: Vec<Command> = inbox.take().collect();
        let expected = [
            joints(Level::Move, 1.0),
            joints(Level::Servo, 99.0),
            Command::Jaw { level: Level::Servo, angle: 0.1 },
            joints(Level::Move, 2.0),
        ];
        assert_eq!(taken, expected);
        assert_eq!(inbox.take().count(), 0, "each is taken once");
    }

    #[test]
    fn what_is_too_much_is_named_once() {
        let (outbox, mut inbox) = commands();
        for k in 0..QUEUE + 5 {
            outbox.post(joints(Level::Move, k as f64));
        }
        let taken: Vec<Command> = inbox.take().collect();
        assert_eq!(taken.len(), QUEUE + 1);
        assert_eq!(taken[QUEUE - 1], joints(Level::Move, (QUEUE - 1) as f64));
        assert_eq!(taken[QUEUE], refused(Level::Servo, Refusal::Full));
        assert_eq!(inbox.take().count(), 0);
    }
}
