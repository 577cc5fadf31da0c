//! Which node has which publishers and subscriptions: the topic `ros_discovery_info`.

use std::collections::BTreeMap;

use rustdds::GUID;

use crate::cdr::Writer;
use crate::environment::GidLength;

/// What DDS calls the topic.
pub(crate) const TOPIC: &str = "ros_discovery_info";
/// What DDS calls its type.
pub(crate) const TYPE: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// Key of a node in the graph.
pub(crate) type NodeKey = u64;

/// Which list an endpoint of a node is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Reads,
    Writes,
}

#[derive(Debug, Default)]
struct NodeEntities {
    namespace: String,
    name: String,
    readers: Vec<GUID>,
    writers: Vec<GUID>,
}

/// The nodes of a participant.
#[derive(Debug, Default)]
pub(crate) struct Graph {
    nodes: BTreeMap<NodeKey, NodeEntities>,
    changed: bool,
}

impl Graph {
    pub fn add_node(&mut self, key: NodeKey, namespace: &str, name: &str) {
        let node = NodeEntities { namespace: namespace.into(), name: name.into(), ..NodeEntities::default() };
        self.nodes.insert(key, node);
        self.changed = true;
    }

    pub fn remove_node(&mut self, key: NodeKey) {
        self.changed |= self.nodes.remove(&key).is_some();
    }

    pub fn contains(&self, namespace: &str, name: &str) -> bool {
        self.nodes.values().any(|node| node.namespace == namespace && node.name == name)
    }

    pub fn add(&mut self, key: NodeKey, side: Side, endpoint: GUID) {
        if let Some(list) = self.list(key, side) {
            list.push(endpoint);
            self.changed = true;
        }
    }

    pub fn remove(&mut self, key: NodeKey, side: Side, endpoint: GUID) {
        if let Some(list) = self.list(key, side) {
            list.retain(|other| *other != endpoint);
            self.changed = true;
        }
    }

    fn list(&mut self, key: NodeKey, side: Side) -> Option<&mut Vec<GUID>> {
        let node = self.nodes.get_mut(&key)?;
        Some(match side {
            Side::Reads => &mut node.readers,
            Side::Writes => &mut node.writers,
        })
    }

    pub fn has_changed(&self) -> bool {
        self.changed
    }

    /// The message that says all of it, after which nothing has changed.
    pub fn message(&mut self, participant: GUID, length: GidLength) -> Vec<u8> {
        self.changed = false;
        let gid = |writer: &mut Writer, guid: &GUID| {
            let mut bytes = [0; 24];
            bytes[..16].copy_from_slice(&guid.to_bytes());
            writer.bytes(&bytes[..length.bytes()]);
        };
        let mut writer = Writer::default();
        gid(&mut writer, &participant);
        writer.each(self.nodes.values(), |writer, node| {
            writer.text(&node.namespace);
            writer.text(&node.name);
            writer.each(node.readers.iter(), gid);
            writer.each(node.writers.iter(), gid);
        });
        writer.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_lists_nodes_with_their_endpoints() {
        let mut graph = Graph::default();
        graph.add_node(1, "/", "n");
        graph.add(1, Side::Writes, GUID::from_bytes([7; 16]));
        graph.add(2, Side::Writes, GUID::from_bytes([8; 16]));
        assert!(graph.has_changed() && graph.contains("/", "n") && !graph.contains("/n", "n"));
        let message = graph.message(GUID::from_bytes([9; 16]), GidLength::Iron);
        let mut expected = vec![9; 16];
        expected.extend([1, 0, 0, 0, 2, 0, 0, 0, b'/', 0, 0, 0, 2, 0, 0, 0, b'n', 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]);
        expected.extend([7; 16]);
        assert_eq!(message, expected);
        assert!(!graph.has_changed());
        assert_eq!(graph.message(GUID::from_bytes([9; 16]), GidLength::Humble).len(), message.len() + 2 * 8);
        graph.remove_node(1);
        assert!(graph.has_changed());
    }
}
