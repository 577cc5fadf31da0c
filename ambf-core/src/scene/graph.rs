//! Which bodies hang below which: the lists that order joint names and joint commands.

use std::collections::HashSet;

use crate::ids::{BodyId, JointId, Table};

/// A body below another, and the joint that leads to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Descendant {
    /// The body.
    pub body: BodyId,
    /// The first joint that reached it.
    pub joint: JointId,
    /// Whether that joint is excluded from the active list.
    pub passive: bool,
}

#[derive(Debug, Clone, Default)]
struct Node {
    ancestors: Vec<BodyId>,
    descendants: Vec<Descendant>,
}

/// Ancestors and descendants of every body, in the order in which joints were made.
#[derive(Debug, Clone, Default)]
pub struct BodyGraph {
    nodes: Table<BodyId, Node>,
    /// What is in the lists, ancestor and descendant: long chains would be searched for ever otherwise.
    listed: HashSet<(BodyId, BodyId)>,
    is_full: bool,
}

/// Descendants that all lists together may hold. They grow with the square of a chain's length; this is a chain of 2000
/// bodies.
const MAX_LISTED: usize = 2_000_000;

impl BodyGraph {
    /// Makes place for `n` bodies in all.
    pub fn grow(&mut self, n: usize) {
        self.nodes.grow(n, Node::default());
    }

    /// Enters a joint from `parent` to `child`. A joint of a body with itself changes nothing; so does, in the lists, a
    /// second path to the same child. A joint with which the lists together would grow beyond two million entries is
    /// listed by `parent` only.
    pub fn add_joint(&mut self, parent: BodyId, child: BodyId, joint: JointId, passive: bool) {
        if parent == child {
            return;
        }
        let (descendants, ancestors) = (&self.nodes[child].descendants, &self.nodes[parent].ancestors);
        let is_full = self.listed.len() + (descendants.len() + 1) * (ancestors.len() + 1) > MAX_LISTED;
        self.is_full |= is_full;
        let (mut below, mut above) = match is_full {
            true => (Vec::new(), Vec::new()),
            false => (descendants.clone(), ancestors.clone()),
        };
        below.push(Descendant { body: child, joint, passive });
        above.push(parent);
        for &body in &above {
            for &entry in below.iter().filter(|entry| self.listed.insert((body, entry.body))) {
                self.nodes[body].descendants.push(entry);
                self.nodes[entry.body].ancestors.push(body);
            }
        }
    }

    /// Whether joints had to be left out of lists because they would have become too long.
    pub fn is_full(&self) -> bool {
        self.is_full
    }

    /// All bodies below `body` with the joints that lead to them.
    pub fn descendants(&self, body: BodyId) -> &[Descendant] {
        &self.nodes[body].descendants
    }

    /// The descendants that count for states and joint commands: those whose joint is not passive.
    pub fn active(&self, body: BodyId) -> impl Iterator<Item = &Descendant> {
        self.nodes[body].descendants.iter().filter(|entry| !entry.passive)
    }

    /// Whether nothing is above `body`.
    pub fn is_root(&self, body: BodyId) -> bool {
        self.nodes[body].ancestors.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(joints: &[(usize, usize, bool)]) -> BodyGraph {
        let mut graph = BodyGraph::default();
        graph.grow(4);
        for (joint, &(parent, child, passive)) in joints.iter().enumerate() {
            graph.add_joint(BodyId::new(parent), BodyId::new(child), JointId::new(joint), passive);
        }
        graph
    }

    fn active(graph: &BodyGraph, body: usize) -> Vec<usize> {
        graph.active(BodyId::new(body)).map(|entry| entry.joint.index()).collect()
    }

    #[test]
    fn top_down_order_is_file_order() {
        let graph = graph(&[(0, 1, false), (1, 2, false), (2, 3, false)]);
        assert_eq!(active(&graph, 0), [0, 1, 2]);
        assert_eq!(active(&graph, 1), [1, 2]);
        assert!(graph.is_root(BodyId::new(0)) && !graph.is_root(BodyId::new(3)));
    }

    #[test]
    fn a_subtree_built_first_comes_first() {
        let graph = graph(&[(1, 2, false), (2, 3, false), (0, 1, false)]);
        assert_eq!(active(&graph, 0), [0, 1, 2]);
        assert_eq!(graph.descendants(BodyId::new(0)).iter().map(|d| d.body.index()).collect::<Vec<_>>(), [2, 3, 1]);
    }

    #[test]
    fn the_first_path_to_a_body_counts_and_passive_joints_are_left_out() {
        let graph = graph(&[(0, 1, false), (0, 2, true), (1, 3, false), (2, 3, false)]);
        assert_eq!(active(&graph, 0), [0, 2]);
        assert_eq!(active(&graph, 2), [3]);
        assert_eq!(graph.descendants(BodyId::new(0)).len(), 3);
    }

    #[test]
    fn long_chains_are_listed_up_to_a_bound() {
        let mut graph = BodyGraph::default();
        graph.grow(10_001);
        (0..10_000).for_each(|i| graph.add_joint(BodyId::new(i), BodyId::new(i + 1), JointId::new(i), false));
        assert!(graph.is_full());
        let listed = graph.descendants(BodyId::new(0)).len();
        assert!((1_990..2_060).contains(&listed), "{listed}");
        assert_eq!(active(&graph, 9_999), [9_999]);
    }

    #[test]
    fn loops_and_self_joints_end() {
        let mut graph = graph(&[(0, 1, false), (1, 0, false)]);
        graph.add_joint(BodyId::new(2), BodyId::new(2), JointId::new(2), false);
        assert!(graph.descendants(BodyId::new(2)).is_empty());
        assert_eq!(graph.descendants(BodyId::new(0)).len(), 2);
    }
}
