//! Joints as written, and what they become.

use std::collections::HashMap;

use nalgebra::{Isometry3, Vector3};

use crate::adf::{
    ordered, Coupled, Coupling, DriveTrain, JointKind, Leader, Limits, ProblemKind, SixDofLimits, IMPULSE_STEP,
};
use crate::xml::{quoted, Element};

/// A joint as written, with the links it joins.
#[derive(Clone)]
pub(super) struct Joint<'a> {
    pub name: &'a str,
    pub element: Element<'a>,
    pub kind: Kind,
    /// Index of the parent link.
    pub parent: usize,
    /// Index of the child link.
    pub child: usize,
    /// Pose of the child's frame in the parent's at joint position zero.
    pub origin: Isometry3<f64>,
    /// Axis in the child's frame, of length 1.
    pub axis: Vector3<f64>,
    /// Range of the coordinate; `None`: unlimited.
    pub limits: Option<Limits>,
    /// Damping, friction, armature, largest effort and largest rate.
    pub drive_train: DriveTrain,
    /// What it follows.
    pub mimic: Option<Mimic<'a>>,
    /// Position at which the joint starts, rad or m: see [`couple`].
    pub start: f64,
}

/// That a joint follows another one: position = ratio · that of the leader + offset.
#[derive(Clone)]
pub(super) struct Mimic<'a> {
    pub element: Element<'a>,
    /// Name of the leader.
    pub leader: &'a str,
    pub ratio: f64,
    /// rad or m.
    pub offset: f64,
}

/// Types of joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Revolute, or continuous without limits.
    Revolute,
    Prismatic,
    Fixed,
    Floating,
    Planar,
    /// A ball joint.
    Spherical,
}

/// Largest motor impulse of a joint that says nothing about it, as in ADF.
const MOTOR_IMPULSE: f64 = 0.1;

impl<'a> Joint<'a> {
    /// Reads a joint between `links` (their indices by name). `None`, reported, when it joins nothing or is broken.
    pub fn read(element: Element<'a>, links: &HashMap<&'a str, usize>) -> Option<Self> {
        element.finish(
            &["name", "type"],
            &["origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"],
        );
        let name = element.need_name("name", "a name");
        let kind = Kind::read(&element);
        let link = |tag: &'static str| {
            let Some(end) = element.child(tag) else {
                element.problem(
                    crate::adf::Severity::Fatal,
                    ProblemKind::MissingKey,
                    tag,
                    "",
                    "the name of a link",
                    "",
                );
                return None;
            };
            end.finish(&["link"], &[]);
            let link = end.need_name("link", "the name of a link");
            let found = links.get(link).copied();
            if found.is_none() && !link.is_empty() {
                let expected = "the name of a link";
                end.error(ProblemKind::UnknownValue, "link", &quoted(link), expected, "the joint is dropped");
            }
            found
        };
        let (parent, child) = (link("parent"), link("child"));
        let (limits, max_effort, max_rate) = limits(&element, kind);
        let mimic = element.child("mimic").map(Mimic::read);
        let [damping, friction, armature] = losses(&element, kind);
        Some(Self {
            name,
            element,
            kind,
            parent: parent?,
            child: child?,
            origin: element.origin(),
            axis: axis(&element, kind),
            limits,
            drive_train: DriveTrain { damping, armature, friction, max_effort, max_rate },
            mimic,
            start: 0.0,
        })
    }

    /// What it follows, in ADF.
    pub fn coupling(&self) -> Option<Coupling> {
        let Mimic { leader, ratio, offset, .. } = self.mimic.as_ref()?;
        let leaders = vec![Leader { joint: identifier(leader), ratio: *ratio }];
        Some(Coupling { leaders, offset: *offset })
    }

    /// Pose of the child's frame in the parent's at joint position `q`, rad or m.
    pub fn pose(&self, q: f64) -> Isometry3<f64> {
        self.origin
            * match self.kind {
                Kind::Revolute => Isometry3::rotation(self.axis * q),
                Kind::Prismatic => Isometry3::from(self.axis * q),
                Kind::Fixed | Kind::Floating | Kind::Planar | Kind::Spherical => Isometry3::identity(),
            }
    }

    /// What the joint is in ADF.
    pub fn adf_kind(&self) -> JointKind {
        match self.kind {
            Kind::Revolute => JointKind::Revolute,
            Kind::Prismatic => JointKind::Prismatic,
            Kind::Fixed => JointKind::Fixed,
            Kind::Spherical => JointKind::PointToPoint,
            // A joint of unknown type joins nothing, as a floating one.
            Kind::Floating => JointKind::Unknown("floating".into()),
            // The third axis of the joint's frame is the normal of the plane; low above high is free.
            Kind::Planar => {
                let (free, locked) = (Vector3::new(1.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0));
                JointKind::SixDof(SixDofLimits {
                    linear_low: free,
                    linear_high: -free,
                    angular_low: locked,
                    angular_high: -locked,
                })
            }
        }
    }

    /// Largest impulse of the motor, N·m·s or N·s.
    pub fn motor_impulse(&self) -> f64 {
        self.drive_train.max_effort.map_or(MOTOR_IMPULSE, |effort| effort * IMPULSE_STEP)
    }
}

/// Identifier of a joint in ADF.
pub(super) fn identifier(name: &str) -> String {
    format!("JOINT {name}")
}

impl<'a> Mimic<'a> {
    fn read(element: Element<'a>) -> Self {
        element.finish(&["joint", "multiplier", "offset"], &[]);
        let leader = element.need_name("joint", "the name of a joint");
        let ratio = element.real("multiplier").unwrap_or(1.0);
        Self { element, leader, ratio, offset: element.real("offset").unwrap_or(0.0) }
    }
}

/// Takes away what joints cannot follow, with an error, and sets where all joints start: at zero, or at the limit next to it;
/// what follows, where its leader puts it. A leader starts within the limits of its followers, too, if they leave it a range.
pub(super) fn couple(joints: &mut [Joint<'_>]) {
    let described: Vec<Coupled<'_>> = joints
        .iter()
        .map(|joint| Coupled {
            name: joint.name,
            has_coordinate: joint.kind.is_one_dof(),
            leaders: joint.mimic.iter().map(|mimic| mimic.leader).collect(),
        })
        .collect();
    let (followers, faults) = ordered(&described);
    let wrong: Vec<usize> = faults
        .into_iter()
        .filter_map(|(index, fault)| {
            let Mimic { element, leader, .. } = joints[index].mimic.as_ref()?;
            let action = "the joint moves on its own";
            element.error(ProblemKind::UnknownValue, "joint", &quoted(leader), &fault.expected(), action);
            Some(index)
        })
        .collect();
    wrong.into_iter().for_each(|index| joints[index].mimic = None);
    let index_of: HashMap<&str, usize> = joints.iter().enumerate().map(|(index, joint)| (joint.name, index)).collect();
    let mut ranges: Vec<Range> = joints.iter().map(|joint| joint.limits.map_or(Range::ALL, Range::from)).collect();
    let led = |joint: &Joint<'_>| joint.mimic.as_ref().map(|mimic| (index_of[mimic.leader], mimic.ratio, mimic.offset));
    for &follower in followers.iter().rev() {
        let Some((leader, ratio, offset)) = led(&joints[follower]) else { continue };
        ranges[leader] = ranges[leader].meet(ranges[follower].of_leader(ratio, offset)).unwrap_or(ranges[leader]);
    }
    for (joint, range) in joints.iter_mut().zip(&ranges) {
        joint.start = 0.0_f64.max(range.low).min(range.high);
    }
    for follower in followers {
        let Some((leader, ratio, offset)) = led(&joints[follower]) else { continue };
        joints[follower].start = ratio * joints[leader].start + offset;
    }
}

/// Positions that a joint may have, rad or m.
#[derive(Clone, Copy)]
struct Range {
    low: f64,
    high: f64,
}

impl From<Limits> for Range {
    fn from(Limits { low, high }: Limits) -> Self {
        Self { low, high }
    }
}

impl Range {
    const ALL: Self = Self { low: f64::NEG_INFINITY, high: f64::INFINITY };

    /// Positions of its leader that put the joint here.
    fn of_leader(self, ratio: f64, offset: f64) -> Self {
        if ratio == 0.0 {
            return Self::ALL;
        }
        let [a, b] = [self.low, self.high].map(|end| (end - offset) / ratio);
        Self { low: a.min(b), high: a.max(b) }
    }

    /// What two have in common.
    fn meet(self, other: Self) -> Option<Self> {
        let (low, high) = (self.low.max(other.low), self.high.min(other.high));
        (low <= high).then_some(Self { low, high })
    }
}

impl Kind {
    fn read(element: &Element<'_>) -> Self {
        let expected = "revolute, continuous, prismatic, fixed, floating, planar or spherical";
        match element.need("type", expected) {
            "revolute" | "continuous" => Self::Revolute,
            "prismatic" => Self::Prismatic,
            "floating" => Self::Floating,
            "planar" => Self::Planar,
            "spherical" => Self::Spherical,
            "fixed" => Self::Fixed,
            other => {
                if element.attribute("type").is_some() {
                    let action = "the joint is fixed";
                    element.error(ProblemKind::UnknownValue, "type", &quoted(other), expected, action);
                }
                Self::Fixed
            }
        }
    }

    /// Whether the joint has a coordinate.
    pub fn is_one_dof(self) -> bool {
        matches!(self, Self::Revolute | Self::Prismatic)
    }
}

fn axis(element: &Element<'_>, kind: Kind) -> Vector3<f64> {
    let Some(axis) = element.child("axis") else { return Vector3::x() };
    axis.finish(&["xyz"], &[]);
    let xyz = axis.vector("xyz").unwrap_or(Vector3::x());
    // Scaled first: the squares of small and large numbers are none.
    let unit = xyz.unscale(xyz.amax().max(f64::MIN_POSITIVE)).try_normalize(0.5);
    unit.unwrap_or_else(|| {
        if kind.is_one_dof() || kind == Kind::Planar {
            let found = quoted(axis.attribute("xyz").unwrap_or_default());
            axis.error(ProblemKind::OutOfRange, "xyz", &found, "a direction", "1 0 0 is used");
        }
        Vector3::x()
    })
}

/// Damping, friction and armature of a joint, N·m·s/rad, N·m and kg·m², or N·s/m, N and kg.
fn losses(joint: &Element<'_>, kind: Kind) -> [f64; 3] {
    let Some(dynamics) = joint.child("dynamics") else { return [0.0; 3] };
    let names = ["damping", "friction", "armature"];
    dynamics.finish(&names, &[]);
    names.map(|name| {
        let Some(value) = dynamics.real(name).filter(|value| *value != 0.0) else { return 0.0 };
        if !kind.is_one_dof() {
            dynamics.ignored(name, "the joint has no coordinate");
            return 0.0;
        }
        if value < 0.0 {
            dynamics.warn(ProblemKind::OutOfRange, name, &value.to_string(), "at least 0", "0 is used");
        }
        value.max(0.0)
    })
}

/// Range, largest effort and largest rate of a joint.
fn limits(joint: &Element<'_>, kind: Kind) -> (Option<Limits>, Option<f64>, Option<f64>) {
    let continuous = joint.attribute("type") == Some("continuous");
    let Some(limit) = joint.child("limit") else {
        if kind.is_one_dof() && !continuous {
            let expected = "an element with `lower`, `upper`, `effort`, `velocity`";
            joint.error(ProblemKind::Absent, "limit", "", expected, "the joint is unlimited");
        }
        return (None, None, None);
    };
    limit.finish(&["lower", "upper", "effort", "velocity"], &[]);
    let values = ["lower", "upper", "effort", "velocity"].map(|name| limit.real(name));
    let [low, high, effort, velocity] = values;
    if !kind.is_one_dof() {
        return (None, None, None);
    }
    let velocity = velocity.filter(|velocity| {
        let usable = *velocity > 0.0;
        if !usable {
            let (found, expected) = (velocity.to_string(), "a rate above 0 in rad/s or m/s");
            limit.warn(ProblemKind::OutOfRange, "velocity", &found, expected, "the joint has no largest rate");
        }
        usable
    });
    let effort = effort.filter(|effort| {
        let usable = *effort > 0.0;
        if !usable {
            let expected = "an effort above 0 in N·m or N";
            let action = format!("motors have that of a joint without, {}", MOTOR_IMPULSE / IMPULSE_STEP);
            limit.warn(ProblemKind::OutOfRange, "effort", &effort.to_string(), expected, &action);
        }
        usable
    });
    if continuous {
        let bounds = [("lower", low), ("upper", high)];
        bounds.iter().filter(|(_, value)| value.is_some()).for_each(|(name, _)| {
            limit.ignored(name, "a continuous joint has no limits");
        });
        return (None, effort, velocity);
    }
    let limits = Limits { low: low.unwrap_or(0.0), high: high.unwrap_or(0.0) };
    let range = limits.high - limits.low;
    let found = format!("a range from {} to {}", limits.low, limits.high);
    if range < 0.0 {
        limit.error(ProblemKind::OutOfRange, "", &found, "`lower` below `upper`", "the joint is unlimited");
        return (None, effort, velocity);
    }
    if low.is_none() && high.is_none() {
        let expected = "`lower` and `upper`";
        limit.warn(ProblemKind::Absent, "", "", expected, "both are 0, so that the joint cannot move");
    }
    if kind == Kind::Revolute && range >= std::f64::consts::TAU {
        let expected = "less than a turn, which angles are measured in";
        limit.warn(ProblemKind::OutOfRange, "", &found, expected, "the joint is unlimited");
        return (None, effort, velocity);
    }
    (Some(limits), effort, velocity)
}
