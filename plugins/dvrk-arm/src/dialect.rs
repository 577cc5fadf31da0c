//! The four ways in which releases of the robot's software name and type the topics of an arm, and how the one in use
//! is found.

use std::collections::BTreeMap;
use std::fmt;

/// Topics that somebody publishes, and their types, as the master lists them.
pub type Topics = BTreeMap<String, String>;

/// Names and types of an arm's topics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Dialect {
    /// dVRK up to 1.7: `/dvrk/<ARM>/position_cartesian_current` and so on.
    Legacy,
    /// AMBF 2.0 and its proxy: `/<ARM>/measured_cp` as a transform, `robot_state`.
    Ambf,
    /// CRTK as in dVRK 2.0 and 2.1: `measured_cp` as a transform, `operating_state`.
    CrtkTransform,
    /// CRTK as in dVRK 2.2 and later: `measured_cp` as a pose.
    CrtkPose,
}

impl fmt::Display for Dialect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Legacy => "legacy (dVRK up to 1.7)",
            Self::Ambf => "AMBF 2.0",
            Self::CrtkTransform => "CRTK (dVRK 2.0, 2.1)",
            Self::CrtkPose => "CRTK (dVRK 2.2 and later)",
        })
    }
}

impl Dialect {
    /// Whether it is one of the two of CRTK.
    pub fn is_crtk(self) -> bool {
        matches!(self, Self::CrtkTransform | Self::CrtkPose)
    }
}

/// Which dialects may be found: setting `dialect`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DialectChoice {
    /// Any.
    #[default]
    Auto,
    /// [`Dialect::Legacy`] only.
    Legacy,
    /// [`Dialect::Ambf`] only.
    Ambf,
    /// One of the two of CRTK, which its types tell apart.
    Crtk,
}

/// Names of topics of one arm in one namespace.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Names {
    /// As configured, with a leading slash and none at the end; empty: none. `None`: not configured.
    namespace: Option<String>,
    arm: String,
}

impl Names {
    /// Names for an arm; `namespace` with or without slashes around it. `None` for names that are none of ROS.
    pub fn new(namespace: Option<&str>, arm: &str) -> Option<Self> {
        let namespace = namespace.map(|text| text.trim().trim_matches('/'));
        let legal = |name: &str| {
            name.starts_with(|c: char| c.is_ascii_alphabetic())
                && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        };
        let good = legal(arm) && namespace.is_none_or(|text| text.is_empty() || text.split('/').all(legal));
        let with_slash = |text: &str| if text.is_empty() { String::new() } else { format!("/{text}") };
        good.then(|| Self { namespace: namespace.map(with_slash), arm: arm.to_owned() })
    }

    /// Where the arms and the pedals of `dialect` are.
    pub fn root(&self, dialect: Dialect) -> &str {
        self.namespace.as_deref().unwrap_or(if dialect == Dialect::Legacy { "/dvrk" } else { "" })
    }

    /// A topic of the arm.
    pub fn topic(&self, dialect: Dialect, name: &str) -> String {
        format!("{}/{}/{name}", self.root(dialect), self.arm)
    }

    /// Name of the arm.
    pub fn arm(&self) -> &str {
        &self.arm
    }

    /// Name of the arm with its namespace.
    pub fn identity(&self) -> String {
        format!("{}/{}", self.namespace.as_deref().unwrap_or_default(), self.arm)
    }

    /// The dialects in which the arm may speak at present, the likeliest first; none while it does not speak. Two of
    /// them: a node that was killed is still listed beside the one that has taken its place.
    pub fn dialects(&self, choice: DialectChoice, topics: &Topics) -> Vec<Dialect> {
        let kind = |dialect, name: &str| topics.get(&self.topic(dialect, name)).map(String::as_str);
        let of_crtk = match kind(Dialect::CrtkPose, "measured_cp") {
            Some("geometry_msgs/PoseStamped") => Some(Dialect::CrtkPose),
            Some("geometry_msgs/TransformStamped") if kind(Dialect::CrtkTransform, "operating_state").is_some() => {
                Some(Dialect::CrtkTransform)
            }
            Some("geometry_msgs/TransformStamped") => Some(Dialect::Ambf),
            _ => None,
        };
        let legacy = kind(Dialect::Legacy, "position_cartesian_current").map(|_| Dialect::Legacy);
        let wanted = match choice {
            DialectChoice::Auto => [of_crtk, legacy],
            DialectChoice::Legacy => [None, legacy],
            DialectChoice::Ambf => [of_crtk.map(|_| Dialect::Ambf), None],
            DialectChoice::Crtk => {
                let typed = |found| if found == Dialect::Ambf { Dialect::CrtkTransform } else { found };
                [of_crtk.map(typed), None]
            }
        };
        wanted.into_iter().flatten().collect()
    }
}

/// Names of the arms below a namespace that publish their pose, sorted.
pub(crate) fn arms(namespace: Option<&str>, topics: &Topics) -> Vec<String> {
    // Any arm's names know where all arms of the namespace are.
    let Some(names) = Names::new(namespace, "A") else { return Vec::new() };
    let found = topics.keys().filter_map(|topic| {
        let (dialect, arm) = match topic.strip_suffix("/position_cartesian_current") {
            Some(arm) => (Dialect::Legacy, arm),
            None => (Dialect::CrtkPose, topic.strip_suffix("/measured_cp")?),
        };
        let arm = arm.strip_prefix(names.root(dialect))?.strip_prefix('/')?;
        // Deeper ones are frames and grippers of an arm.
        (!arm.contains('/')).then(|| arm.to_owned())
    });
    found.collect::<std::collections::BTreeSet<_>>().into_iter().collect()
}

/// What a topic is read for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reading {
    Pose,
    Joints,
    Wrench,
    Gripper,
    Closed,
    State,
    Jacobian,
}

/// Topics of an arm to listen to. A slave's gripper is called jaw.
pub(crate) fn readings(dialect: Dialect, has_jaw: bool) -> Vec<(&'static str, Reading)> {
    use Reading::{Closed, Gripper, Jacobian, Joints, Pose, State, Wrench};
    let mut readings = match dialect {
        Dialect::Legacy => vec![
            ("position_cartesian_current", Pose),
            ("state_joint_current", Joints),
            ("wrench_body_current", Wrench),
            ("gripper_closed_event", Closed),
            ("robot_state", State),
            ("current_state", State),
            ("jacobian_body", Jacobian),
        ],
        _ => vec![
            ("measured_cp", Pose),
            ("measured_js", Joints),
            ("body/measured_cf", Wrench),
            ("gripper/closed", Closed),
            ("body/jacobian", Jacobian),
        ],
    };
    match dialect {
        Dialect::Legacy => (),
        Dialect::Ambf => readings.extend([("measured_cf", Wrench), ("robot_state", State)]),
        Dialect::CrtkTransform | Dialect::CrtkPose => readings.push(("operating_state", State)),
    }
    readings.extend(match (dialect, has_jaw) {
        (Dialect::Legacy, false) => vec![("state_gripper_current", Gripper), ("gripper_position_current", Gripper)],
        (Dialect::Legacy, true) => vec![("state_jaw_current", Gripper)],
        (_, false) => vec![("gripper/measured_js", Gripper)],
        (_, true) => vec![("jaw/measured_js", Gripper)],
    });
    readings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topics(list: &[(&str, &str)]) -> Topics {
        list.iter().map(|&(topic, kind)| (topic.to_owned(), kind.to_owned())).collect()
    }

    #[test]
    fn the_four_are_told_apart() {
        const TRANSFORM: &str = "geometry_msgs/TransformStamped";
        let names = Names::new(None, "MTMR").unwrap();
        let found = |list: &[(&str, &str)]| names.dialects(DialectChoice::Auto, &topics(list)).first().copied();
        assert_eq!(found(&[("/MTML/measured_cp", TRANSFORM)]), None);
        assert_eq!(found(&[("/MTMR/measured_cp", "geometry_msgs/PoseStamped")]), Some(Dialect::CrtkPose));
        let state = ("/MTMR/operating_state", "crtk_msgs/operating_state");
        assert_eq!(found(&[("/MTMR/measured_cp", TRANSFORM), state]), Some(Dialect::CrtkTransform));
        assert_eq!(found(&[("/MTMR/measured_cp", TRANSFORM)]), Some(Dialect::Ambf));
        let robot_state = ("/MTMR/robot_state", "std_msgs/String");
        assert_eq!(found(&[("/MTMR/measured_cp", TRANSFORM), robot_state]), Some(Dialect::Ambf));
        for kind in ["geometry_msgs/PoseStamped", "geometry_msgs/Pose"] {
            assert_eq!(found(&[("/dvrk/MTMR/position_cartesian_current", kind)]), Some(Dialect::Legacy));
        }
        assert_eq!(found(&[state]), None, "no pose, no dialect");
        assert_eq!(found(&[("/MTMR/measured_cp", "std_msgs/String")]), None);
        let both =
            [("/MTMR/measured_cp", TRANSFORM), ("/dvrk/MTMR/position_cartesian_current", "geometry_msgs/PoseStamped")];
        assert_eq!(names.dialects(DialectChoice::Auto, &topics(&both)), [Dialect::Ambf, Dialect::Legacy]);
    }

    #[test]
    fn a_choice_and_a_namespace_narrow_the_search() {
        let list = [
            ("/lab/MTMR/measured_cp", "geometry_msgs/TransformStamped"),
            ("/lab/MTMR/position_cartesian_current", "geometry_msgs/PoseStamped"),
        ];
        let names = Names::new(Some("lab/"), "MTMR").unwrap();
        let found = |choice| names.dialects(choice, &topics(&list));
        assert_eq!(found(DialectChoice::Auto), [Dialect::Ambf, Dialect::Legacy]);
        assert_eq!(found(DialectChoice::Legacy), [Dialect::Legacy]);
        assert_eq!(found(DialectChoice::Ambf), [Dialect::Ambf]);
        assert_eq!(found(DialectChoice::Crtk), [Dialect::CrtkTransform]);
        assert_eq!(Names::new(None, "MTMR").unwrap().dialects(DialectChoice::Auto, &topics(&list)), []);
        assert_eq!(names.topic(Dialect::Legacy, "set_wrench_body"), "/lab/MTMR/set_wrench_body");
    }

    #[test]
    fn arms_are_listed_by_their_poses() {
        let list = ["/MTMR/measured_cp", "/MTMR/local/measured_cp", "/PSM1/measured_cp", "/lab/ECM/measured_cp"];
        let mut topics = topics(&list.map(|topic| (topic, "geometry_msgs/PoseStamped")));
        topics.insert("/dvrk/MTML/position_cartesian_current".into(), "geometry_msgs/PoseStamped".into());
        topics.insert("/MTML/status".into(), "std_msgs/Empty".into());
        assert_eq!(arms(None, &topics), ["MTML", "MTMR", "PSM1"]);
        assert_eq!(arms(Some("/lab"), &topics), ["ECM"]);
    }

    #[test]
    fn names_are_checked() {
        for bad in ["", "MTM R", "1MTM", "MTM/R", "MTM-R", "é"] {
            assert!(Names::new(None, bad).is_none(), "{bad}");
        }
        assert!(Names::new(Some("a//b"), "MTMR").is_none() && Names::new(Some("a b"), "MTMR").is_none());
        for (namespace, identity) in [(None, "/MTML1"), (Some("/"), "/MTML1"), (Some("/a/b/"), "/a/b/MTML1")] {
            assert_eq!(Names::new(namespace, "MTML1").unwrap().identity(), identity);
        }
    }
}
