//! Links and joints → a tree of rigid bodies.
//!
//! What stands still in the world is known here: a root without a mass, or called `world`, and all that is fixed to it.
//! A link without a mass that moves is a frame: it becomes part of the body it is fixed to.

use nalgebra::Isometry3;

use super::inertia::Inertial;
use super::joint::{couple, Joint, Kind};
use super::link::Link;
use crate::adf::{ProblemKind, Severity};

/// Where a link belongs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Index of the link whose body it is part of; its own when it is a body.
    pub host: usize,
    /// Pose of the link's frame in the body frame.
    pub in_host: Isometry3<f64>,
    /// Pose of the link's frame in the world at the start.
    pub in_world: Isometry3<f64>,
    /// Does not move.
    pub is_static: bool,
    /// Of a body without a mass that moves: what the robot moves with it. `None` for others, and where nothing has a mass.
    pub load: Option<Load>,
}

/// What moves with a link.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Load {
    /// Of all links that it carries, kg; of a link that carries nothing, that of the link with a mass next to it.
    pub mass: f64,
    /// Sum of their smallest principal moments, kg·m²: none of the moments of them all is smaller.
    pub moment: f64,
    /// The link carries it.
    pub is_carried: bool,
}

/// Takes the joints out of `joints` that join nothing, couples the others, and says where each link belongs. Joints beyond
/// those of a tree close loops.
pub(super) fn places(links: &[Link<'_>], joints: &mut Vec<Joint<'_>>) -> Vec<Place> {
    let leading_to = span(links, joints);
    couple(joints);
    let tree = Tree::new(links, joints, leading_to);
    let places = tree.places();
    joints.retain(|joint| {
        let [parent, child] = [joint.parent, joint.child].map(|link| places[link].host);
        let is_idle = parent == child && joint.kind != Kind::Fixed;
        if is_idle {
            let action = "the joint is dropped: it cannot move";
            joint.element.error(ProblemKind::Structure, "", "joins links that are fixed to each other", "", action);
        }
        !is_idle
    });
    places
}

/// Finds a tree of links: the joint that leads to each. Of several it is a fixed one, or else the first. Where all links of a
/// loop have a parent, one of them becomes a root.
fn span(links: &[Link<'_>], joints: &mut Vec<Joint<'_>>) -> Vec<Option<usize>> {
    joints.retain(|joint| {
        let joins = joint.parent != joint.child;
        if !joins {
            let action = "the joint is dropped";
            joint.element.error(ProblemKind::Structure, "", "joins a link with itself", "", action);
        }
        joins
    });
    let mut leading_to: Vec<Option<usize>> = vec![None; links.len()];
    for (index, joint) in joints.iter().enumerate() {
        let leads = &mut leading_to[joint.child];
        match *leads {
            None => *leads = Some(index),
            Some(other) if joint.kind == Kind::Fixed && joints[other].kind != Kind::Fixed => *leads = Some(index),
            Some(_) => (),
        }
    }
    for (index, joint) in joints.iter().enumerate() {
        let leads = leading_to[joint.child].filter(|&leads| leads != index);
        if let Some(leads) = leads {
            closing(joint, &format!("leads to the same link as joint `{}`", joints[leads].name), Severity::Info);
        }
    }
    // Walks towards the root from each link that was not passed yet: a walk that meets itself is in a loop.
    let mut walk_of = vec![usize::MAX; links.len()];
    for start in 0..links.len() {
        let mut link = start;
        while walk_of[link] == usize::MAX {
            walk_of[link] = start;
            match leading_to[link] {
                Some(joint) => link = joints[joint].parent,
                None => break,
            }
        }
        if let (true, Some(joint)) = (walk_of[link] == start, leading_to[link]) {
            leading_to[link] = None;
            let why = format!("closes a loop of links without a root: `{}` becomes one", links[link].name);
            closing(&joints[joint], &why, Severity::Warning);
        }
    }
    leading_to
}

fn closing(joint: &Joint<'_>, why: &str, severity: Severity) {
    let action = match joint.kind {
        Kind::Floating => "the joint joins nothing",
        _ => "the joint closes a loop",
    };
    joint.element.problem(severity, ProblemKind::Structure, "", why, "", action);
}

struct Tree<'t, 'a> {
    links: &'t [Link<'a>],
    joints: &'t [Joint<'a>],
    /// For each link the joint that leads to it.
    leading_to: Vec<Option<usize>>,
    /// For each link the joints of the tree that start there, in file order.
    leaving: Vec<Vec<usize>>,
}

impl<'t, 'a> Tree<'t, 'a> {
    fn new(links: &'t [Link<'a>], joints: &'t [Joint<'a>], leading_to: Vec<Option<usize>>) -> Self {
        let mut leaving = vec![Vec::new(); links.len()];
        for (index, joint) in joints.iter().enumerate() {
            if leading_to[joint.child] == Some(index) {
                leaving[joint.parent].push(index);
            }
        }
        Self { links, joints, leading_to, leaving }
    }

    fn places(&self) -> Vec<Place> {
        let mut places: Vec<Option<Place>> = vec![None; self.links.len()];
        let roots: Vec<_> = (0..self.links.len()).filter(|&link| self.leading_to[link].is_none()).collect();
        for &root in roots.iter().skip(1) {
            let found = format!("is a root beside `{}`: no joint leads to it", self.links[roots[0]].name);
            let action = "it starts a robot of its own at the origin";
            self.links[root].element.problem(Severity::Error, ProblemKind::Structure, "", &found, "", action);
        }
        let mut waiting: Vec<_> = roots.into_iter().rev().collect();
        // Parents before children.
        let mut order = Vec::with_capacity(self.links.len());
        while let Some(link) = waiting.pop() {
            places[link] = Some(self.place(link, &places));
            order.push(link);
            waiting.extend(self.leaving[link].iter().rev().map(|&joint| self.joints[joint].child));
        }
        // Without loops every link hangs below a root.
        let mut places: Vec<Place> = places.into_iter().flatten().collect();
        self.find_loads(&order, &mut places);
        places
    }

    /// What each link without a mass that moves carries. `order`: parents before children.
    fn find_loads(&self, order: &[usize], places: &mut [Place]) {
        // Of each body with all that hangs on it.
        let mut loads = vec![Load::default(); self.links.len()];
        for &link in order.iter().rev() {
            if let Some(Inertial { mass, moments, .. }) = &self.links[link].inertial {
                let load = &mut loads[places[link].host];
                load.mass += mass;
                load.moment += moments.map_or(0.0, |moments| moments.min());
            }
            let joint = self.leading_to[link].map(|joint| &self.joints[joint]);
            // A floating joint carries nothing.
            let Some(joint) = joint.filter(|joint| joint.kind != Kind::Floating) else { continue };
            // One joint leads to each body, whose other links hang on the first.
            let (host, parent) = (places[link].host, places[joint.parent].host);
            if host != parent {
                let own = loads[host];
                loads[parent].mass += own.mass;
                loads[parent].moment += own.moment;
            }
        }
        // What carries nothing is carried by the link with a mass next to it towards the root.
        for &link in order {
            let Place { host, is_static, .. } = places[link];
            if host != link || is_static || self.links[link].inertial.is_some() {
                continue;
            }
            let parent = self.leading_to[link].map(|joint| places[self.joints[joint].parent].host);
            loads[link].is_carried = loads[link].mass > 0.0;
            if !loads[link].is_carried {
                loads[link] = match parent {
                    Some(parent) if !places[parent].is_static => Load { is_carried: false, ..loads[parent] },
                    _ => Load::default(),
                };
            }
            places[link].load = (loads[link].mass > 0.0).then_some(loads[link]);
        }
    }

    /// The place of a link whose parent has one.
    fn place(&self, link: usize, places: &[Option<Place>]) -> Place {
        let joint = self.leading_to[link].map(|joint| &self.joints[joint]);
        let parent = joint.and_then(|joint| places[joint.parent]);
        let has_mass = self.links[link].inertial.is_some();
        let own =
            |in_world, is_static| Place { host: link, in_host: Isometry3::identity(), in_world, is_static, load: None };
        let (in_world, fixed_to) = match (joint, parent) {
            (Some(joint), Some(parent)) => {
                let fixed = joint.kind == Kind::Fixed;
                (parent.in_world * joint.pose(joint.start), fixed.then_some((parent, joint.origin)))
            }
            _ => (Isometry3::identity(), None),
        };
        if let Some((parent, origin)) = fixed_to {
            if has_mass || parent.is_static {
                return own(in_world, parent.is_static);
            }
            return Place { in_host: parent.in_host * origin, in_world, ..parent };
        }
        let is_root = joint.is_none();
        if is_root && self.links[link].name == "world" {
            return own(in_world, true);
        }
        if !has_mass {
            if let Some((host, host_in_link)) = self.mass_fixed_to(link) {
                return Place { host, in_host: host_in_link.inverse(), in_world, is_static: false, load: None };
            }
        }
        own(in_world, is_root && !has_mass)
    }

    /// The first link with a mass that is fixed to a link without, over other links without; and its pose in that link.
    fn mass_fixed_to(&self, link: usize) -> Option<(usize, Isometry3<f64>)> {
        let mut waiting = vec![(link, Isometry3::identity())];
        while let Some((link, pose)) = waiting.pop() {
            if self.links[link].inertial.is_some() {
                return Some((link, pose));
            }
            let fixed = self.leaving[link].iter().rev().map(|&joint| &self.joints[joint]);
            waiting.extend(fixed.filter(|j| j.kind == Kind::Fixed).map(|j| (j.child, pose * j.origin)));
        }
        None
    }
}
