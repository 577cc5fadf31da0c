//! Equalities between joints, and fixed tendons: which joints are linear functions of others.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use super::actuator::TendonArms;
use super::body::Bodies;
use super::classes::Classes;
use super::joint::{linear, Joint, Limited};
use super::settings::{choice, finish, Compiler, SOFT};
use super::source::Source;
use crate::adf::{ordered, Coupled, Coupling, Leader, Limits, ProblemKind, MAX_LEADERS};
use crate::xml::{quoted, Element};

/// A sum of coordinates of joints, each times a number.
type Sum = BTreeMap<String, f64>;

/// Largest number that a tendon gives a joint: sums of them still are numbers.
const MOST: f64 = 1e100;

/// Most couplings that are followed to find out which joint a tendon moves.
const MOST_STEPS: usize = 1000;

/// Fixed tendons by name.
pub(super) struct Tendons<'a>(HashMap<&'a str, Sum>);

/// Joints that follow others, by name, or stand still: those without leaders.
pub(super) type Couplings = BTreeMap<String, Coupling>;

/// What a tendon element and its defaults say; lengths of fixed tendons are in rad or m, whatever the unit of angles is.
#[derive(Debug, Clone)]
pub(super) struct TendonText {
    range: [f64; 2],
    limited: Limited,
    /// N per rad or m.
    stiffness: f64,
    /// Lengths between which the spring is at rest; `None`: the length at which the springs of the joints are.
    rest: Option<[f64; 2]>,
    damping: f64,
    friction: f64,
    armature: f64,
}

impl Default for TendonText {
    fn default() -> Self {
        Self {
            range: [0.0; 2],
            limited: Limited::Auto,
            stiffness: 0.0,
            rest: None,
            damping: 0.0,
            friction: 0.0,
            armature: 0.0,
        }
    }
}

impl TendonText {
    pub fn apply(&mut self, element: &Element<'_>) {
        let read =
            ["name", "class", "range", "limited", "stiffness", "springlength", "damping", "frictionloss", "armature"];
        let unused = [
            SOFT,
            ("it changes nothing that moves", &["group", "user", "width", "material", "rgba"][..]),
            ("efforts of actuators are limited by the actuators", &["actuatorfrcrange", "actuatorfrclimited"][..]),
            ("springs do not yield", &["springyield"][..]),
        ];
        finish(element, &read, &unused, &["joint"]);
        self.range = element.numbers("range").unwrap_or(self.range);
        self.limited = choice(element, "limited", &Limited::WORDS).unwrap_or(self.limited);
        if let Some(lengths) = element.numbers_in("springlength", 1..=2) {
            let lengths = [lengths[0], lengths[lengths.len() - 1]];
            self.rest = Some(lengths).filter(|lengths| *lengths != [-1.0; 2]);
        }
        for (name, value) in [
            ("stiffness", &mut self.stiffness),
            ("damping", &mut self.damping),
            ("frictionloss", &mut self.friction),
            ("armature", &mut self.armature),
        ] {
            *value = linear(element, name).unwrap_or(*value);
        }
    }

    /// What it has of its own: attributes, and whether they change anything.
    fn own(&self, compiler: &Compiler) -> [(&'static str, bool); 5] {
        [
            ("range", self.limited.counts(self.range, compiler)),
            ("stiffness", self.stiffness != 0.0),
            ("damping", self.damping != 0.0),
            ("frictionloss", self.friction != 0.0),
            ("armature", self.armature != 0.0),
        ]
    }

    /// Gives the joint that alone moves the tendon what the tendon has, of which `arm` is the length over the joint's coordinate.
    fn give(&self, element: &Element<'_>, joint: &mut Joint<'_>, arm: f64, compiler: &Compiler) {
        let square = arm * arm;
        let friction = arm.abs() * self.friction;
        let [stiffness, damping, armature] = [self.stiffness, self.damping, self.armature].map(|own| square * own);
        let limits = self.range.map(|length| length / arm);
        let [low, high] = self.rest.map_or([joint.own_rest; 2], |lengths| lengths.map(|length| length / arm));
        let numbers = [stiffness, damping, armature, friction, low, high].into_iter().chain(limits);
        if !numbers.map(f64::abs).all(|number| number <= MOST) {
            let expected = "numbers that joints can have";
            element.error(ProblemKind::OutOfRange, "", &format!("{arm:e} long"), expected, "it has nothing of its own");
            return;
        }
        let losses = &mut joint.drive_train;
        losses.damping += damping;
        losses.friction += friction;
        losses.armature += armature;
        if stiffness > 0.0 {
            if low != high {
                let found = quoted(element.attribute("springlength").unwrap_or_default());
                element.warn(ProblemKind::OutOfRange, "springlength", &found, "one length", "their mean is used");
            }
            joint.add_spring(stiffness, (low + high) / 2.0);
        }
        if self.limited.counts(self.range, compiler) {
            let [a, b] = limits;
            let own = joint.limits.unwrap_or(Limits { low: f64::NEG_INFINITY, high: f64::INFINITY });
            let both = Limits { low: own.low.max(a.min(b)), high: own.high.min(a.max(b)) };
            if both.low <= both.high {
                joint.set_limits(both);
            } else {
                let found = format!("outside the range of {}", quoted(&joint.name));
                element.error(ProblemKind::OutOfRange, "range", &found, "a part of that", "it has no effect");
            }
        }
    }
}

/// Reads section `tendon`. What a tendon of one joint has is given to that joint.
pub(super) fn tendons<'a>(
    sections: &[Element<'a>],
    source: &Source<'a>,
    classes: &Classes<'a>,
    compiler: &Compiler,
    bodies: &mut Bodies<'a>,
) -> Tendons<'a> {
    let mut tendons = HashMap::new();
    let joints = bodies.all.iter().enumerate().flat_map(|(body, all)| {
        all.joints.iter().enumerate().map(move |(number, joint)| (joint.name.clone(), (body, number)))
    });
    let places: HashMap<String, (usize, usize)> = joints.collect();
    for section in sections {
        finish(section, &[], &[], &["fixed", "spatial"]);
        for element in source.elements(section) {
            if element.tag() != "fixed" {
                element.error(ProblemKind::IgnoredKey, "", "", "", "only fixed tendons are read");
                continue;
            }
            let mut text = classes.of(&element, None).tendon.clone();
            text.apply(&element);
            let mut sum = Sum::new();
            for part in source.children(&element, "joint") {
                finish(&part, &["joint", "coef"], &[], &[]);
                let joint = part.need("joint", "the name of a joint");
                let coefficient = part.need_real("coef").unwrap_or(0.0);
                if bodies.joints.get(joint) == Some(&true) {
                    *sum.entry(joint.to_owned()).or_default() += coefficient;
                } else if !joint.is_empty() {
                    let expected = "the name of a hinge or slide joint";
                    part.error(ProblemKind::UnknownValue, "joint", &quoted(joint), expected, "the tendon ends there");
                }
            }
            sum.retain(|_, coefficient| *coefficient != 0.0);
            let only = sum.iter().next().filter(|_| sum.len() == 1);
            match only.and_then(|(name, arm)| Some((*places.get(name)?, *arm))) {
                Some(((body, joint), arm)) => text.give(&element, &mut bodies.all[body].joints[joint], arm, compiler),
                None => {
                    for (name, _) in text.own(compiler).into_iter().filter(|(_, acts)| *acts) {
                        element.ignored(name, "tendons of several joints have nothing of their own");
                    }
                }
            }
            if let Some(name) = element.attribute("name") {
                tendons.insert(name, sum);
            }
        }
    }
    Tendons(tendons)
}

/// Reads equalities of kind `joint` and `tendon`.
pub(super) fn couplings<'a>(
    equalities: &[Element<'a>],
    classes: &Classes<'a>,
    tendons: &Tendons<'a>,
    bodies: &Bodies<'a>,
) -> Couplings {
    let references: HashMap<&str, f64> =
        bodies.all.iter().flat_map(|body| &body.joints).map(|joint| (joint.name.as_str(), joint.reference)).collect();
    let mut found: BTreeMap<String, (Coupling, Element<'a>)> = BTreeMap::new();
    for element in equalities {
        let is_joint = element.tag() == "joint";
        if !is_joint && element.tag() != "tendon" {
            continue;
        }
        let keys = if is_joint { ["joint1", "joint2"] } else { ["tendon1", "tendon2"] };
        finish(element, &["name", "class", "active", "polycoef", keys[0], keys[1]], &[SOFT], &[]);
        if !classes.is_active(element) {
            continue;
        }
        let left_out = "the equality is left out";
        let sum = |key: &'static str| -> Option<Sum> {
            let name = element.need(key, "a name");
            let sum = match is_joint {
                true => (bodies.joints.get(name) == Some(&true)).then(|| Sum::from([(name.to_owned(), 1.0)])),
                // Longer ones would be refused below.
                false => tendons.0.get(name).filter(|sum| !sum.is_empty() && sum.len() <= MAX_LEADERS + 1).cloned(),
            };
            if sum.is_none() && !name.is_empty() {
                let tendon = format!("a fixed tendon of 1 to {} joints", MAX_LEADERS + 1);
                let expected = if is_joint { "a hinge or slide joint" } else { &tendon };
                element.error(ProblemKind::UnknownValue, key, &quoted(name), expected, left_out);
            }
            sum
        };
        let Some(first) = sum(keys[0]) else { continue };
        let second = if element.attribute(keys[1]).is_some() {
            match sum(keys[1]) {
                Some(second) => second,
                None => continue,
            }
        } else {
            Sum::new()
        };
        let mut polynomial = [0.0, 1.0, 0.0, 0.0, 0.0];
        if let Some(numbers) = element.numbers_in("polycoef", 1..=5) {
            polynomial[..numbers.len()].copy_from_slice(&numbers);
        }
        if polynomial[2..].iter().any(|number| *number != 0.0) {
            let found = quoted(element.attribute("polycoef").unwrap_or_default());
            element.error(ProblemKind::OutOfRange, "polycoef", &found, "a linear function", left_out);
            continue;
        }
        // Σ c_i (q_i − r_i) = p0 + p1 Σ d_j (q_j − r_j), solved for the last joint of the first sum that follows nothing yet.
        let free = |joint: &&String| !found.contains_key(*joint) && !second.contains_key(*joint);
        let Some(follower) = first.keys().rfind(free).cloned() else {
            element.error(ProblemKind::Structure, "", "joints that all follow others", "a joint of its own", left_out);
            continue;
        };
        let own = first[&follower];
        let mut rest: Sum = second.iter().map(|(joint, by)| (joint.clone(), polynomial[1] * by / own)).collect();
        for (joint, by) in first.iter().filter(|(joint, _)| **joint != follower) {
            *rest.entry(joint.clone()).or_default() -= by / own;
        }
        rest.retain(|_, ratio| *ratio != 0.0);
        let reference = |joint: &String| references.get(joint.as_str()).copied().unwrap_or(0.0);
        let offset = polynomial[0] / own + reference(&follower)
            - rest.iter().map(|(joint, ratio)| ratio * reference(joint)).sum::<f64>();
        if !(offset.is_finite() && rest.values().all(|ratio| ratio.is_finite())) {
            let found = "too large or too small numbers";
            element.error(ProblemKind::OutOfRange, "polycoef", found, "ratios of joints", left_out);
            continue;
        }
        if rest.len() > MAX_LEADERS {
            let found_text = format!("{} joints", rest.len() + 1);
            element.error(ProblemKind::OutOfRange, "", &found_text, &format!("at most {}", MAX_LEADERS + 1), left_out);
            continue;
        }
        let leaders = rest.into_iter().map(|(joint, ratio)| Leader { joint, ratio }).collect();
        found.insert(follower, (Coupling { leaders, offset }, *element));
    }
    without_cycles(found)
}

/// Followers and their leaders, each once.
fn described<'c>(couplings: impl Iterator<Item = (&'c String, &'c Coupling)> + Clone) -> Vec<Coupled<'c>> {
    let leaders_of: BTreeMap<&str, Vec<&str>> = couplings
        .clone()
        .map(|(name, coupling)| (name.as_str(), coupling.leaders.iter().map(|leader| leader.joint.as_str()).collect()))
        .collect();
    let names = couplings.flat_map(|(name, coupling)| {
        std::iter::once(name.as_str()).chain(coupling.leaders.iter().map(|leader| leader.joint.as_str()))
    });
    let names: BTreeSet<&str> = names.collect();
    let leaders = |name: &str| leaders_of.get(name).cloned().unwrap_or_default();
    names.into_iter().map(|name| Coupled { name, has_coordinate: true, leaders: leaders(name) }).collect()
}

/// Takes away what follows itself.
fn without_cycles(mut found: BTreeMap<String, (Coupling, Element<'_>)>) -> Couplings {
    let wrong: Vec<String> = {
        let described = described(found.iter().map(|(name, (coupling, _))| (name, coupling)));
        ordered(&described).1.into_iter().map(|(index, _)| described[index].name.to_owned()).collect()
    };
    for name in wrong {
        if let Some((_, element)) = found.remove(&name) {
            let found = format!("{} follows itself", quoted(&name));
            element.error(ProblemKind::Structure, "", &found, "joints that do not", "the equality is left out");
        }
    }
    found.into_iter().map(|(name, (coupling, _))| (name, coupling)).collect()
}

impl<'a> Tendons<'a> {
    /// Tendons that move one joint, with all that follows it: which, and how far per coordinate of that joint.
    pub fn arms(&self, couplings: &Couplings) -> TendonArms<'a> {
        let described: Vec<Coupled<'_>> = described(couplings.iter());
        let (followers, _) = ordered(&described);
        let rank: HashMap<&str, usize> =
            followers.iter().enumerate().map(|(rank, &index)| (described[index].name, rank)).collect();
        // A tendon over one joint in the end; `None` for others, and those of very many.
        let reduced = |sum: &Sum| {
            let mut followers: BTreeMap<usize, (&str, f64)> = BTreeMap::new();
            let mut free: BTreeMap<&str, f64> = BTreeMap::new();
            let mut waiting: Vec<(&str, f64)> = sum.iter().map(|(joint, by)| (joint.as_str(), *by)).collect();
            for _ in 0..MOST_STEPS {
                for (joint, by) in waiting.drain(..) {
                    match rank.get(joint) {
                        Some(&rank) => followers.entry(rank).or_insert((joint, 0.0)).1 += by,
                        // What stands still does not count.
                        None if couplings.contains_key(joint) => (),
                        None => *free.entry(joint).or_default() += by,
                    }
                }
                // The last of those that follow is replaced by what it follows.
                let Some((_, (joint, by))) = followers.pop_last() else {
                    free.retain(|_, by| *by != 0.0);
                    let mut all = free.into_iter();
                    return all.next().filter(|_| all.next().is_none()).map(|(joint, by)| (joint.to_owned(), by));
                };
                waiting
                    .extend(couplings[joint].leaders.iter().map(|leader| (leader.joint.as_str(), by * leader.ratio)));
            }
            None
        };
        let arms = self.0.iter().filter_map(|(name, sum)| {
            let arm = reduced(sum).filter(|(_, by)| by.is_finite())?;
            Some((*name, arm))
        });
        arms.collect()
    }
}
