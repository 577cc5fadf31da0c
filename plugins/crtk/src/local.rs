//! Arms for clients in this process, without a middleware and its threads: what is sent is there before the next step, and what is
//! asked is what the last step has left, so that runs repeat. Topics have the names and contents that they have over ROS.

use std::sync::Arc;

use thiserror::Error;

use crate::arm::{ArmModel, Command, JointMessage, PoseMessage, Quantity};
use crate::diagnostics::Board;
use crate::exchange::Outbox;
use crate::messages::Message;
use crate::plugin::SEED_TOPIC;
use crate::serve::Face;
use crate::topics::{Carries, Input, Output, Topic};

/// A set of topics of an arm as clients of this process reach it.
pub(crate) struct End {
    /// Place of the arm in the status.
    pub arm: usize,
    /// Name space.
    pub space: String,
    pub model: Arc<ArmModel>,
    pub topics: Vec<Topic>,
    pub outbox: Arc<Outbox>,
}

/// What a client sends: the fields of a message, of which its type uses some.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sent {
    /// Joint positions, velocities or efforts (as many as the arm has joints, 1 for a jaw); a pose (7: m, quaternion x y z w);
    /// a twist or wrench (6); values of a channel; one number; or 1 and 0 for yes and no.
    pub numbers: Vec<f64>,
    /// The frame of a pose, or what a text says.
    pub text: String,
}

/// Why nothing was sent or is there to be read.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum LocalError {
    /// Error when no arm has such a topic.
    #[error("no arm has a topic {topic} for clients to {verb}; there are {known}")]
    NoTopic {
        /// What was asked for.
        topic: String,
        /// "send" or "read".
        verb: &'static str,
        /// Names of those there are.
        known: String,
    },
    /// Error when a message of that type has another number of numbers.
    #[error("{topic}: expected {expected} numbers, got {got}")]
    Count {
        /// The topic.
        topic: String,
        /// How many there are in its messages.
        expected: usize,
        /// How many were given.
        got: usize,
    },
    /// Error when the seed is no integer from 0 up to 4294967295.
    #[error("{0}: expected an integer from 0 to 4294967295")]
    Seed(&'static str),
}

impl Board {
    /// Topics of all arms, those that clients read and those that they send, in the order in which arms were offered, each with
    /// the name space of its arm.
    pub fn topics(&self) -> Vec<(String, Topic)> {
        let of_end = |end: &End| end.topics.iter().map(|topic| (end.space.clone(), topic.clone())).collect::<Vec<_>>();
        self.shown().iter().flat_map(|shown| &shown.ends).flat_map(of_end).collect()
    }

    /// Sends a message to an arm: it acts in the next step. What an arm refuses it says as over ROS.
    ///
    /// # Errors
    /// [`LocalError`].
    pub fn send(&self, topic: &str, sent: &Sent) -> Result<(), LocalError> {
        let all = self.shown();
        if topic == SEED_TOPIC {
            let [number] = fixed(topic, sent)?;
            if number.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(&number) {
                return Err(LocalError::Seed(SEED_TOPIC));
            }
            let mut takers = all.iter().filter_map(|shown| shown.seeds.as_ref()).peekable();
            if takers.peek().is_some() {
                // More seeds in one step than anybody looks at: any of them is one that was sent.
                for seeds in takers {
                    let _ = seeds.try_send(number as u64);
                }
                return Ok(());
            }
        }
        for end in all.iter().flat_map(|shown| &shown.ends) {
            for Topic { name, carries, .. } in &end.topics {
                if let (true, Carries::In(input)) = (name == topic, carries) {
                    end.outbox.post(command(&end.model, *input, topic, sent)?);
                    return Ok(());
                }
            }
        }
        Err(self.no_topic(topic, "send"))
    }

    /// What a topic says after the last step, stamped with simulated time; `None`: there was no step yet, or the arm is no longer
    /// in the scene. Of what is told when something happens, the operating state can be read.
    ///
    /// # Errors
    /// [`LocalError::NoTopic`].
    pub fn read(&self, topic: &str) -> Result<Option<Message>, LocalError> {
        for shown in self.shown() {
            for end in &shown.ends {
                for Topic { name, carries, .. } in &end.topics {
                    let Carries::Out(output) = *carries else { continue };
                    if name != topic || !is_readable(output) {
                        continue;
                    }
                    let status = shown.status.load_full();
                    let own = status.as_ref().and_then(|status| Some((status.sim_time, status.arms.get(end.arm)?)));
                    return Ok(own.and_then(|(stamp, arm)| {
                        let face = Face { model: Arc::clone(&end.model), reference: arm.reference_name };
                        face.message(output, arm, arm.reading.as_ref()?, stamp)
                    }));
                }
            }
        }
        Err(self.no_topic(topic, "read"))
    }

    fn no_topic(&self, topic: &str, verb: &'static str) -> LocalError {
        let fits = |(_, topic): &(String, Topic)| match topic.carries {
            Carries::In(_) => verb == "send",
            Carries::Out(output) => verb == "read" && is_readable(output),
        };
        let known: Vec<String> = self.topics().into_iter().filter(fits).map(|(_, topic)| topic.name).collect();
        let known = if known.is_empty() { "none".into() } else { known.join(", ") };
        LocalError::NoTopic { topic: topic.to_owned(), verb, known }
    }
}

fn is_readable(output: Output) -> bool {
    output.is_periodic() || output == Output::OperatingState
}

fn fixed<const N: usize>(topic: &str, sent: &Sent) -> Result<[f64; N], LocalError> {
    let got = sent.numbers.len();
    sent.numbers[..].try_into().map_err(|_| LocalError::Count { topic: topic.to_owned(), expected: N, got })
}

/// The command that a message is.
fn command(model: &ArmModel, input: Input, topic: &str, sent: &Sent) -> Result<Command, LocalError> {
    let Sent { numbers, text } = sent;
    let joints = |quantity| {
        let mut message = JointMessage::default();
        *match quantity {
            Quantity::Position | Quantity::Relative => &mut message.position,
            Quantity::Velocity => &mut message.velocity,
            Quantity::Effort => &mut message.effort,
        } = numbers.clone();
        message
    };
    let pose = || -> Result<PoseMessage, LocalError> {
        let [x, y, z, a, b, c, d] = fixed(topic, sent)?;
        Ok(PoseMessage { frame: text.clone(), position: [x, y, z], orientation: [a, b, c, d] })
    };
    let halves = || fixed(topic, sent).map(|[a, b, c, d, e, f]| ([a, b, c], [d, e, f]));
    let number = || fixed(topic, sent).map(|[number]| number);
    let truth = || number().map(|number| number != 0.0);
    let nothing = |command| fixed::<0>(topic, sent).map(|_| command);
    Ok(match input {
        Input::Joints(level, quantity) => model.joint_command(level, quantity, &joints(quantity)),
        Input::Jaw(level, quantity) => model.jaw_command(level, quantity, &joints(quantity)),
        Input::Pose { level, is_local } => model.pose_command(level, &pose()?, is_local),
        Input::Twist => halves().map(|(v, w)| ArmModel::six_command(v, w, Command::Twist))?,
        Input::Wrench(frame) => {
            halves().map(|(f, t)| ArmModel::six_command(f, t, |wrench| Command::Wrench { wrench, frame }))?
        }
        Input::State => Command::State(text.clone()),
        Input::Hold => nothing(Command::Hold)?,
        Input::Free => nothing(Command::Free)?,
        Input::GravityCompensation => Command::GravityCompensation(truth()?),
        Input::AbsoluteForces => Command::AbsoluteForces(truth()?),
        Input::Ratio(of) => ArmModel::ratio_command(of, number()?),
        Input::BaseFrame => model.base_frame_command(&pose()?),
        Input::ToolType => model.tool_type_command(text),
        Input::ToolPresent => Command::ToolPresent(truth()?),
        Input::LockOrientation => ArmModel::orientation_command(fixed(topic, sent)?),
        Input::UnlockOrientation => nothing(Command::UnlockOrientation)?,
        Input::JointErrors => model.errors_command(numbers),
        // Not an arm's: it is none of its topics.
        Input::Seed => Command::Hold,
    })
}
