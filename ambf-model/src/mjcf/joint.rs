//! Joints as written.

use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};

use super::settings::{choice, direction, finish, Compiler, SOFT};
use crate::adf::{DriveTrain, JointKind, Limits, ProblemKind, Severity};
use crate::xml::{quoted, Element};

/// Types of joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Free,
    Ball,
    Slide,
    Hinge,
}

/// Whether a range counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Limited {
    /// If there is one.
    Auto,
    Yes,
    No,
}

impl Limited {
    pub const WORDS: [(&'static str, Self); 3] = [("auto", Self::Auto), ("true", Self::Yes), ("false", Self::No)];

    pub fn counts(self, range: [f64; 2], compiler: &Compiler) -> bool {
        match self {
            Self::Auto => compiler.auto_limits && range[0] < range[1],
            Self::Yes => true,
            Self::No => false,
        }
    }
}

/// What a joint element and its defaults say; angles as written.
#[derive(Debug, Clone)]
pub(super) struct JointText {
    pub kind: Kind,
    pub position: Vector3<f64>,
    pub axis: [f64; 3],
    pub range: [f64; 2],
    pub limited: Limited,
    pub reference: f64,
    pub spring_reference: f64,
    pub stiffness: f64,
    pub damping: f64,
    pub friction: f64,
    pub armature: f64,
    /// Time constant, s, and damping ratio, which say stiffness and damping where both are above 0.
    pub spring_damper: [f64; 2],
    pub effort_range: [f64; 2],
    pub effort_limited: Limited,
}

impl Default for JointText {
    fn default() -> Self {
        Self {
            kind: Kind::Hinge,
            position: Vector3::zeros(),
            axis: [0.0, 0.0, 1.0],
            range: [0.0; 2],
            limited: Limited::Auto,
            reference: 0.0,
            spring_reference: 0.0,
            stiffness: 0.0,
            damping: 0.0,
            friction: 0.0,
            armature: 0.0,
            spring_damper: [0.0; 2],
            effort_range: [0.0; 2],
            effort_limited: Limited::Auto,
        }
    }
}

impl JointText {
    pub fn apply(&mut self, element: &Element<'_>) {
        let read = [
            "name",
            "class",
            "type",
            "pos",
            "axis",
            "range",
            "limited",
            "ref",
            "springref",
            "stiffness",
            "damping",
            "frictionloss",
            "armature",
            "actuatorfrcrange",
            "actuatorfrclimited",
            "springdamper",
        ];
        let unused =
            [SOFT, ("it changes nothing that moves", &["group", "user", "actuatorgravcomp", "springyield"][..])];
        finish(element, &read, &unused, &[]);
        let kinds = [("free", Kind::Free), ("ball", Kind::Ball), ("slide", Kind::Slide), ("hinge", Kind::Hinge)];
        self.kind = choice(element, "type", &kinds).unwrap_or(self.kind);
        self.position = element.vector("pos").unwrap_or(self.position);
        self.axis = element.numbers("axis").unwrap_or(self.axis);
        self.range = element.numbers("range").unwrap_or(self.range);
        self.limited = choice(element, "limited", &Limited::WORDS).unwrap_or(self.limited);
        self.reference = element.real("ref").unwrap_or(self.reference);
        self.spring_reference = element.real("springref").unwrap_or(self.spring_reference);
        self.effort_range = element.numbers("actuatorfrcrange").unwrap_or(self.effort_range);
        self.effort_limited = choice(element, "actuatorfrclimited", &Limited::WORDS).unwrap_or(self.effort_limited);
        for (name, value) in [
            ("stiffness", &mut self.stiffness),
            ("damping", &mut self.damping),
            ("frictionloss", &mut self.friction),
            ("armature", &mut self.armature),
        ] {
            *value = linear(element, name).unwrap_or(*value);
        }
        self.spring_damper = element.numbers("springdamper").unwrap_or(self.spring_damper);
    }
}

/// The first coefficient of a force that may be a polynomial, at least 0; others are reported.
pub(super) fn linear(element: &Element<'_>, name: &'static str) -> Option<f64> {
    let numbers = element.numbers_in(name, 1..=8)?;
    if numbers[1..].iter().any(|number| *number != 0.0) {
        let found = quoted(element.attribute(name).unwrap_or_default());
        element.error(ProblemKind::OutOfRange, name, &found, "one number", "the first is used");
    }
    if numbers[0] < 0.0 {
        element.warn(ProblemKind::OutOfRange, name, &numbers[0].to_string(), "at least 0", "0 is used");
    }
    Some(numbers[0].max(0.0))
}

/// A joint of a body.
#[derive(Clone)]
pub(super) struct Joint<'a> {
    pub name: String,
    pub element: Element<'a>,
    pub kind: Kind,
    /// A point of the axis in the body's frame, m.
    pub position: Vector3<f64>,
    /// In the body's frame.
    pub axis: Unit<Vector3<f64>>,
    /// rad or m.
    pub limits: Option<Limits>,
    /// Coordinate at which the body stands as it is written, rad or m.
    pub reference: f64,
    pub drive_train: DriveTrain,
    /// N·m/rad or N/m.
    pub stiffness: f64,
    /// Coordinate at which the spring is at rest, rad or m.
    pub rest: f64,
    /// That of the joint's own spring, without what tendons add.
    pub own_rest: f64,
    /// Time constant, s, and damping ratio, both above 0, that its spring and damper are to have. Stiffness and damping above are those of
    /// others then.
    pub spring_damper: Option<[f64; 2]>,
}

impl<'a> Joint<'a> {
    /// The joint whose frame, that of the `frame` elements around it, is `outer` in the body's.
    pub fn new(
        element: Element<'a>,
        name: String,
        text: &JointText,
        outer: &Isometry3<f64>,
        compiler: &Compiler,
    ) -> Self {
        let kind = text.kind;
        let in_si = |written: f64| if kind == Kind::Slide { written } else { compiler.angle(written) };
        let axis = direction(text.axis).unwrap_or_else(|| {
            element.error(ProblemKind::OutOfRange, "axis", &format!("{:?}", text.axis), "a direction", "z is used");
            Vector3::z_axis()
        });
        let mut joint = Self {
            name,
            element,
            kind,
            // That of a free joint is the body's own.
            position: if kind == Kind::Free { text.position } else { (outer * Point3::from(text.position)).coords },
            axis: outer.rotation * axis,
            limits: None,
            reference: 0.0,
            drive_train: DriveTrain::default(),
            stiffness: 0.0,
            rest: 0.0,
            own_rest: 0.0,
            spring_damper: None,
        };
        let is_limited = text.limited.counts(text.range, compiler);
        let spring_damper = Some(text.spring_damper).filter(|numbers| numbers.iter().all(|number| *number > 0.0));
        if !joint.has_coordinate() {
            // Bodies have a damping.
            let (kept, damping) = if kind == Kind::Free { (text.damping, 0.0) } else { (0.0, text.damping) };
            joint.drive_train.damping = kept;
            let lost = [
                ("damping", damping),
                ("stiffness", text.stiffness),
                ("frictionloss", text.friction),
                ("armature", text.armature),
                ("springdamper", spring_damper.map_or(0.0, |[time, _]| time)),
            ];
            for (name, value) in lost.into_iter().filter(|(_, value)| *value != 0.0) {
                joint.lose(name, value);
            }
            if kind == Kind::Ball && is_limited {
                joint.lose("range", in_si(text.range[1]));
            }
            return joint;
        }
        joint.reference = in_si(text.reference);
        joint.own_rest = in_si(text.spring_reference);
        joint.rest = joint.own_rest;
        joint.stiffness = if spring_damper.is_some() { 0.0 } else { text.stiffness };
        joint.spring_damper = spring_damper;
        if is_limited {
            joint.set_limits(Limits { low: in_si(text.range[0]), high: in_si(text.range[1]) });
        }
        let most = text.effort_limited.counts(text.effort_range, compiler);
        joint.drive_train = DriveTrain {
            damping: if spring_damper.is_some() { 0.0 } else { text.damping },
            armature: text.armature,
            friction: text.friction,
            max_effort: most
                .then(|| text.effort_range.map(f64::abs).into_iter().fold(0.0, f64::max))
                .filter(|most| *most > 0.0),
            max_rate: None,
        };
        joint
    }

    /// Says that something has no effect.
    pub fn lose(&self, name: &str, value: f64) {
        let found = format!("{value:.3e}");
        let kind = if self.kind == Kind::Free { "free" } else { "ball" };
        let expected = format!("none of a {kind} joint");
        self.element.warn(ProblemKind::OutOfRange, name, &found, &expected, "the joint moves without");
    }

    /// Adds a spring that is at rest at a coordinate.
    pub fn add_spring(&mut self, stiffness: f64, rest: f64) {
        let sum = self.stiffness + stiffness;
        self.rest += (rest - self.rest) * (stiffness / sum);
        self.stiffness = sum;
    }

    /// Limits it to a range, unless the range is none here.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = Some(limits);
        let Limits { low, high } = limits;
        let found = format!("a range from {low} to {high}");
        if high < low {
            self.element.error(
                ProblemKind::OutOfRange,
                "range",
                &found,
                "the lower end first",
                "the joint is unlimited",
            );
            self.limits = None;
        } else if self.kind == Kind::Hinge && high - low >= std::f64::consts::TAU {
            let expected = "less than a turn, which angles are measured in";
            self.element.problem(
                Severity::Info,
                ProblemKind::OutOfRange,
                "range",
                &found,
                expected,
                "the joint is unlimited",
            );
            self.limits = None;
        }
    }

    /// Whether it has one coordinate.
    pub fn has_coordinate(&self) -> bool {
        matches!(self.kind, Kind::Hinge | Kind::Slide)
    }

    /// Pose of the body in a frame that stands where the body does as written, at coordinate `q`, rad or m.
    pub fn pose(&self, q: f64) -> Isometry3<f64> {
        let moved = q - self.reference;
        match self.kind {
            Kind::Hinge => {
                let turn = UnitQuaternion::from_axis_angle(&self.axis, moved);
                Isometry3::from_parts((self.position - turn * self.position).into(), turn)
            }
            Kind::Slide => Isometry3::from_parts((self.axis.into_inner() * moved).into(), UnitQuaternion::identity()),
            Kind::Free | Kind::Ball => Isometry3::identity(),
        }
    }

    /// What it is in ADF.
    pub fn adf_kind(&self) -> JointKind {
        match self.kind {
            Kind::Hinge => JointKind::Revolute,
            Kind::Slide => JointKind::Prismatic,
            Kind::Ball => JointKind::PointToPoint,
            Kind::Free => JointKind::Unknown("free".into()),
        }
    }
}
