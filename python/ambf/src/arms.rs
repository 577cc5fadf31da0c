//! Arms for CRTK clients in this process; Python's side is `ambf/arms.py`.

use crtk::diagnostics::Board;
use crtk::local::{LocalError, Sent};
use crtk::messages::{Header, Message};
use crtk::topics::{Carries, Topic};
use pyo3::prelude::*;

use crate::errors;

/// A message: frame, stamp in s, names or the name of the state, and lists of numbers, as many as its type has.
pub type Read = (String, f64, Vec<String>, Vec<Vec<f64>>);

/// Name space of the arm, name, ROS type and whether clients send it, of each topic.
pub type Listed = (String, String, String, bool);

/// All topics, in the order of the arms.
pub fn topics(arms: &Board) -> Vec<Listed> {
    let row = |(space, topic): (String, Topic)| {
        (space, topic.name, topic.message.definition().0, matches!(topic.carries, Carries::In(_)))
    };
    arms.topics().into_iter().map(row).collect()
}

/// Sends a message to an arm.
pub fn send(py: Python<'_>, arms: &Board, topic: &str, numbers: Vec<f64>, text: String) -> PyResult<()> {
    arms.send(topic, &Sent { numbers, text }).map_err(|problem| refused(py, &problem))
}

/// What a topic says.
pub fn read(py: Python<'_>, arms: &Board, topic: &str) -> PyResult<Option<Read>> {
    let message = arms.read(topic).map_err(|problem| refused(py, &problem))?;
    Ok(message.map(|message| match message {
        Message::Joints(header, joints) => {
            made(header, joints.names, vec![joints.position, joints.velocity, joints.effort])
        }
        Message::Pose(header, pose) => {
            let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).copied().collect();
            made(header, Vec::new(), vec![numbers])
        }
        Message::Twist(header, six) | Message::Wrench(header, six) => {
            made(header, Vec::new(), vec![six.iter().copied().collect()])
        }
        Message::Jacobian { columns, data } => {
            made(Header::default(), Vec::new(), data.chunks(columns.max(1)).map(<[f64]>::to_vec).collect())
        }
        Message::OperatingState { header, state, is_homed, is_busy } => {
            made(header, vec![state], vec![vec![f64::from(is_homed), f64::from(is_busy)]])
        }
        // Not of a state: none of those that are read.
        _ => made(Header::default(), Vec::new(), Vec::new()),
    }))
}

fn made(header: Header, names: Vec<String>, numbers: Vec<Vec<f64>>) -> Read {
    (header.frame, header.stamp as f64 * 1e-9, names, numbers)
}

fn refused(py: Python<'_>, problem: &LocalError) -> PyErr {
    match problem {
        LocalError::NoTopic { .. } => errors::not_found(py, &problem.to_string()),
        _ => errors::invalid_command(py, problem.to_string()),
    }
}
