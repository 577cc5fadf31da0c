//! Joints whose coordinate is a linear function of those of other joints.

use std::collections::HashMap;

use super::joint::Joint;
use super::reader::Map;
use super::report::ProblemKind;

/// Largest number of joints that one follows.
pub const MAX_LEADERS: usize = 16;

/// Coupling of a hinge or slider, the follower, to others, its leaders: its coordinate is Σ ratio · coordinate + offset.
/// Coordinates are in rad and m, in any mixture.
#[derive(Clone, Debug, PartialEq)]
pub struct Coupling {
    /// The leaders: at least one, at most [`MAX_LEADERS`]. Each is another hinge or slider of the same file, and no joint
    /// follows itself by way of others.
    pub leaders: Vec<Leader>,
    /// Coordinate of the follower where those of all leaders are 0, rad or m. Default: 0.
    pub offset: f64,
}

/// A joint that another one follows.
#[derive(Clone, Debug, PartialEq)]
pub struct Leader {
    /// Its identifier.
    pub joint: String,
    /// Rate of the follower over that of the leader, rad/rad, m/m, m/rad or rad/m. Default: 1.
    pub ratio: f64,
}

/// What a joint with a wrong coupling does.
const ALONE: &str = "the joint moves on its own";

impl Coupling {
    /// Reads `coupling` of a joint.
    pub(super) fn read(map: &Map<'_>) -> Option<Self> {
        let coupling = map.map_opt("coupling")?;
        let offset = coupling.real("offset").unwrap_or(0.0);
        let leaders = if coupling.has("joints") { several(&coupling) } else { single(&coupling) };
        coupling.finish();
        Some(Self { leaders: leaders?, offset })
    }
}

fn single(coupling: &Map<'_>) -> Option<Vec<Leader>> {
    let ratio = coupling.real("ratio").unwrap_or(1.0);
    let Some(joint) = coupling.filled("joint") else {
        coupling.error(ProblemKind::MissingKey, "joint", "the identifier of a joint", ALONE);
        return None;
    };
    Some(vec![Leader { joint, ratio }])
}

fn several(coupling: &Map<'_>) -> Option<Vec<Leader>> {
    coupling.ignore(&["joint", "ratio"], "`joints` and `ratios` are used");
    let joints = coupling.strings("joints");
    let ratios = coupling.numbers("ratios").unwrap_or_default();
    if joints.is_empty() || joints.len() > MAX_LEADERS {
        let expected = format!("1 to {MAX_LEADERS} identifiers of joints");
        coupling.error(ProblemKind::OutOfRange, "joints", &expected, ALONE);
        return None;
    }
    if ratios.len() != joints.len() {
        let kind = if coupling.has("ratios") { ProblemKind::OutOfRange } else { ProblemKind::MissingKey };
        coupling.error(kind, "ratios", &format!("a list of {} numbers, one for each of `joints`", joints.len()), ALONE);
        return None;
    }
    let leader = |((joint, _), (_, ratio)): ((&str, _), (_, f64))| Leader { joint: joint.to_owned(), ratio };
    Some(joints.into_iter().zip(ratios).map(leader).collect())
}

/// What of a joint matters to couplings.
pub(crate) struct Coupled<'a> {
    /// By which others name it.
    pub name: &'a str,
    /// Whether it is a hinge or slider.
    pub has_coordinate: bool,
    /// Names of its leaders; none: it is no follower.
    pub leaders: Vec<&'a str>,
}

/// What is wrong with a coupling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault<'a> {
    /// The follower has no coordinate.
    NoFollower,
    /// There is no joint of this name.
    Unknown(&'a str),
    /// The joint of this name has no coordinate.
    NoCoordinate(&'a str),
    /// The joint follows itself.
    Itself,
    /// The joint follows itself by way of others.
    Cycle,
}

impl Fault<'_> {
    /// What was expected instead, for a message.
    pub fn expected(&self) -> String {
        match self {
            Self::NoFollower => "a revolute or prismatic joint".to_owned(),
            Self::Unknown(name) => format!("joints of this file: there is no `{}`", short(name)),
            Self::NoCoordinate(name) => {
                format!("revolute or prismatic joints: `{}` has no coordinate", short(name))
            }
            Self::Itself => "another joint: no joint follows itself".to_owned(),
            Self::Cycle => "joints that do not follow this one in turn".to_owned(),
        }
    }
}

fn short(name: &str) -> String {
    name.chars().take(60).flat_map(char::escape_debug).collect()
}

/// Followers in an order in which each comes after its leaders, and the couplings that are wrong: index of the follower, and
/// why.
pub(crate) fn ordered<'a>(joints: &[Coupled<'a>]) -> (Vec<usize>, Vec<(usize, Fault<'a>)>) {
    let mut index_of = HashMap::new();
    for (index, joint) in joints.iter().enumerate() {
        index_of.entry(joint.name).or_insert(index);
    }
    let mut faults = Vec::new();
    // Of each joint the number of its leaders that are followers, and the followers that it leads.
    let mut waits_for = vec![0; joints.len()];
    let mut followed_by: Vec<Vec<usize>> = vec![Vec::new(); joints.len()];
    let mut follows = vec![false; joints.len()];
    for (index, joint) in joints.iter().enumerate().filter(|(_, joint)| !joint.leaders.is_empty()) {
        let fault = |name: &'a str| match index_of.get(name) {
            None => Some(Fault::Unknown(name)),
            Some(&leader) if leader == index => Some(Fault::Itself),
            Some(&leader) if !joints[leader].has_coordinate => Some(Fault::NoCoordinate(name)),
            Some(_) => None,
        };
        let own = (!joint.has_coordinate).then_some(Fault::NoFollower);
        match own.or_else(|| joint.leaders.iter().find_map(|&name| fault(name))) {
            Some(fault) => faults.push((index, fault)),
            None => follows[index] = true,
        }
    }
    for (index, joint) in joints.iter().enumerate().filter(|&(index, _)| follows[index]) {
        for leader in joint.leaders.iter().filter_map(|name| index_of.get(name)).filter(|&&leader| follows[leader]) {
            waits_for[index] += 1;
            followed_by[*leader].push(index);
        }
    }
    let mut order: Vec<usize> = (0..joints.len()).filter(|&index| follows[index] && waits_for[index] == 0).collect();
    release(&mut order, &mut waits_for, &followed_by);
    // What is left is in a cycle or hangs on one; what leads nothing that is left hangs.
    let is_left: Vec<bool> = waits_for.iter().map(|&waits| waits > 0).collect();
    let mut leads: Vec<usize> =
        followed_by.iter().map(|of| of.iter().filter(|&&index| is_left[index]).count()).collect();
    let mut hanging: Vec<usize> = (0..joints.len()).filter(|&index| is_left[index] && leads[index] == 0).collect();
    let mut is_cycle = is_left.clone();
    while let Some(index) = hanging.pop() {
        is_cycle[index] = false;
        for leader in
            joints[index].leaders.iter().filter_map(|name| index_of.get(name)).filter(|&&leader| is_left[leader])
        {
            leads[*leader] -= 1;
            if leads[*leader] == 0 {
                hanging.push(*leader);
            }
        }
    }
    let in_cycles: Vec<usize> = (0..joints.len()).filter(|&index| is_cycle[index]).collect();
    faults.extend(in_cycles.iter().map(|&index| (index, Fault::Cycle)));
    // They move on their own, and others may follow them.
    let mut rest = in_cycles.clone();
    in_cycles.iter().for_each(|&index| waits_for[index] = usize::MAX);
    release(&mut rest, &mut waits_for, &followed_by);
    order.extend(rest.into_iter().skip(in_cycles.len()));
    (order, faults)
}

/// Appends to `order` the followers of what is in it, once nothing else leads them that is not in it.
fn release(order: &mut Vec<usize>, waits_for: &mut [usize], followed_by: &[Vec<usize>]) {
    let mut next = 0;
    while let Some(&leader) = order.get(next) {
        next += 1;
        for &follower in &followed_by[leader] {
            waits_for[follower] -= 1;
            if waits_for[follower] == 0 {
                order.push(follower);
            }
        }
    }
}

/// Indices of the joints of a model that follow others, each after its leaders.
pub fn followers(joints: &[Joint]) -> Vec<usize> {
    ordered(&joints.iter().map(Coupled::of).collect::<Vec<_>>()).0
}

impl<'a> Coupled<'a> {
    fn of(joint: &'a Joint) -> Self {
        let leaders = joint.coupling.iter().flat_map(|coupling| &coupling.leaders);
        Self {
            name: &joint.common.identifier,
            has_coordinate: joint.kind.has_drive(),
            leaders: leaders.map(|leader| leader.joint.as_str()).collect(),
        }
    }
}

/// Reports the couplings of a file that are wrong, and takes them away. `root`: the file.
pub(super) fn check(root: &Map<'_>, joints: &mut [Joint]) {
    let described: Vec<Coupled<'_>> = joints.iter().map(Coupled::of).collect();
    let (_, faults) = ordered(&described);
    let mut wrong = Vec::new();
    for (index, fault) in faults {
        let joint = root.map(&joints[index].common.identifier);
        let coupling = joint.map("coupling");
        let (map, key) = match fault {
            Fault::NoFollower => (&joint, "type"),
            _ if coupling.has("joints") => (&coupling, "joints"),
            _ => (&coupling, "joint"),
        };
        map.error(ProblemKind::UnknownValue, key, &fault.expected(), ALONE);
        wrong.push(index);
    }
    wrong.into_iter().for_each(|index| joints[index].coupling = None);
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::super::Model;
    use super::*;

    const FRAME: &str = "parent: A, child: B, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
                         parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}";

    /// A file of joints: name, type and further keys of each.
    fn text(joints: &[(&str, &str, &str)]) -> String {
        let list: Vec<_> = joints.iter().map(|(name, ..)| *name).collect();
        let mut text = format!("joints: [{}]\n", list.join(", "));
        for (name, kind, keys) in joints {
            text += &format!("{name}: {{{FRAME}, type: {kind}{keys}}}\n");
        }
        text
    }

    #[test]
    fn one_leader_or_several() {
        let model = clean::<Model>(&text(&[
            ("A", "revolute", ""),
            ("B", "prismatic", ", coupling: {joint: A}"),
            ("C", "revolute", ", coupling: {joints: [A, B], ratios: [0.5, -2], offset: 0.1}"),
            ("D", "revolute", ", coupling: {joint: C, ratio: -1, offset: 3}"),
        ]));
        let coupling = |index: usize| model.joints[index].coupling.clone();
        let leader = |joint: &str, ratio| Leader { joint: joint.to_owned(), ratio };
        assert_eq!(coupling(0), None);
        assert_eq!(coupling(1), Some(Coupling { leaders: vec![leader("A", 1.0)], offset: 0.0 }));
        let both = vec![leader("A", 0.5), leader("B", -2.0)];
        assert_eq!(coupling(2), Some(Coupling { leaders: both, offset: 0.1 }));
        assert_eq!(coupling(3), Some(Coupling { leaders: vec![leader("C", -1.0)], offset: 3.0 }));
        assert_eq!(followers(&model.joints), [1, 2, 3]);
    }

    #[test]
    fn wrong_couplings_are_named_and_left_out() {
        for (keys, message) in [
            (
                "{joint: X}",
                "dir/t.yaml:4:192: error: `C / coupling / joint` is `X`, expected joints of this file: there is no `X`",
            ),
            ("{joint: C}", "`C / coupling / joint` is `C`, expected another joint: no joint follows itself"),
            ("{joint: B}", "expected revolute or prismatic joints: `B` has no coordinate"),
            (
                "{joints: [A, X], ratios: [1, 1]}",
                "`C / coupling / joints` is a list of 2, expected joints of this file",
            ),
            ("{joints: [A], ratios: [1, 1]}", "`C / coupling / ratios` is a list of 2, expected a list of 1 numbers"),
            ("{joints: [A, A]}", "`C / coupling / ratios` is missing (a list of 2 numbers"),
            ("{joints: [], ratios: []}", "expected 1 to 16 identifiers of joints"),
            ("{ratio: 2}", "`C / coupling / joint` is missing (the identifier of a joint); the joint moves on its own"),
        ] {
            let of = format!(", coupling: {keys}");
            let (model, problems) =
                read::<Model>(&text(&[("A", "revolute", ""), ("B", "fixed", ""), ("C", "revolute", &of)]));
            assert_eq!(model.joints[2].coupling, None, "{keys}");
            assert!(problems.iter().any(|problem| problem.contains(message)), "{keys}: {problems:#?}");
        }
        let fixed = text(&[("A", "revolute", ""), ("B", "fixed", ", coupling: {joint: A}")]);
        let (model, problems) = read::<Model>(&fixed);
        assert_eq!(model.joints[1].coupling, None);
        assert!(problems[0].contains("`B / type` is `fixed`, expected a revolute or prismatic joint"), "{problems:#?}");
    }

    #[test]
    fn cycles_are_left_out_and_what_follows_them_is_not() {
        let follows = |name: &str| format!(", coupling: {{joint: {name}}}");
        let of = [follows("C"), follows("A"), follows("B"), follows("A"), follows("D")];
        let kind = "revolute";
        let joints: Vec<_> =
            ["A", "B", "C", "D", "E"].into_iter().zip(&of).map(|(name, of)| (name, kind, of.as_str())).collect();
        let (model, problems) = read::<Model>(&text(&joints));
        // What hangs on a cycle follows a joint that moves on its own.
        let coupled: Vec<_> = model.joints.iter().map(|joint| joint.coupling.is_some()).collect();
        assert_eq!(coupled, [false, false, false, true, true], "{problems:#?}");
        assert_eq!(problems.iter().filter(|p| p.contains("joints that do not follow this one in turn")).count(), 3);
        assert_eq!(followers(&model.joints), [3, 4]);
    }
}
