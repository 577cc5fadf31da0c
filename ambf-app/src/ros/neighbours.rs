//! Other simulators in the same namespace: clients would see the states of both on one topic, and command both.

use std::collections::HashSet;

use dxr::Value;
use ros_node::{entries, node, CallError, Peer};

use crate::report;

/// Says once of each node that publishes the state of our world too that it does.
#[derive(Debug, Default)]
pub(super) struct Neighbours {
    named: HashSet<String>,
}

impl Neighbours {
    /// Asks the master who publishes the topics `worlds`; `own` is the name of our node.
    pub fn look(&mut self, master: &Peer, own: &str, worlds: &[String]) -> Result<(), CallError> {
        let Value::Array(state) = master.call("getSystemState", vec![])? else { return Ok(()) };
        let Some(published) = state.first() else { return Ok(()) };
        let ours = |topic: &str| worlds.iter().any(|world| world == topic);
        for (topic, publishers) in entries(published).filter(|(topic, _)| ours(topic)) {
            for other in publishers.into_iter().filter(|name| *name != own) {
                // One that was killed may be registered still.
                let is_alive = node(master, other).is_ok_and(|other| other.call("getPid", vec![]).is_ok());
                if is_alive && self.named.insert(other.to_owned()) {
                    report!(
                        "ROS: {other} publishes {topic} too: another simulator runs in this namespace. Clients get the states of both and \
                         command both; start one of them with another --ns"
                    );
                }
            }
        }
        Ok(())
    }
}
