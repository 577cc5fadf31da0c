//! Joints.

use nalgebra::{UnitQuaternion, Vector3};

use super::common::Common;
use super::controller::{Controller, ControllerOutput, Gains};
use super::coupling::Coupling;
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::Base;

/// The sub-step for which `max motor impulse` is given, s.
pub const IMPULSE_STEP: f64 = 0.001;

/// A joint as written. "rad or m": radians for angular joints, metres for linear ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Identity. `passive` excludes the joint and its child from the active lists.
    pub common: Common,
    /// Type with what only that type has.
    pub kind: JointKind,
    /// Identifier of the parent body, blanks kept.
    pub parent: String,
    /// Identifier of the child body, blanks kept.
    pub child: String,
    /// Pivot in the parent's body frame, m, before the parent's scale.
    pub parent_pivot: Vector3<f64>,
    /// Pivot in the child's body frame, m, before the child's scale.
    pub child_pivot: Vector3<f64>,
    /// Joint axis in the parent's body frame: finite, not zero (except for p2p), not normalised.
    pub parent_axis: Vector3<f64>,
    /// Joint axis in the child's body frame: finite, not zero (except for p2p), not normalised.
    pub child_axis: Vector3<f64>,
    /// Rotation of the child about the axis at joint position zero, rad. Default: 0.
    pub child_offset: f64,
    /// Orientation of the child's body frame in the parent's at joint position zero; it turns the child axis into the
    /// parent axis. `None`, as in every ADF file: the least rotation that does so, then `child_offset` about the parent
    /// axis.
    pub child_rotation: Option<UnitQuaternion<f64>>,
    /// Rotation of the joint frame about the parent axis, rad. Default: 0.
    pub joint_offset: f64,
    /// Limits of a one-dof joint; `None`: unlimited.
    pub limits: Option<Limits>,
    /// Position control allowed. Default: `true`.
    pub enable_motor: bool,
    /// Wrench and effort estimation. Default: `false`.
    pub enable_feedback: bool,
    /// Largest motor impulse per 1 ms step for velocity control, N·m·s or N·s, not negative. Default: that of the largest effort
    /// of the drive train, or else 0.1.
    pub max_motor_impulse: f64,
    /// Damping of a one-dof spring, N·m·s/rad or N·s/m; other one-dof joints have no use for it. Default: 0.
    pub damping: f64,
    /// Stiffness of a one-dof spring, N·m/rad or N/m. Default: 0.
    pub stiffness: f64,
    /// Rest position of a one-dof spring, rad or m; `None`: the middle of the limits.
    pub equilibrium_point: Option<f64>,
    /// Error reduction parameter. Default: 0.1.
    pub erp: f64,
    /// Constraint force mixing. Default: 0.1.
    pub cfm: f64,
    /// No collision between the two connected bodies. Default: `true`.
    pub ignore_inter_collision: bool,
    /// Profile `accurate` moves the bodies onto the joint before the first step; `false`: what the file leaves between
    /// them is closed by the constraint while the simulation runs. Not known to the C++ program. Default: `true`.
    pub assemble: bool,
    /// Joint controller. Default output: force with key `controller`, velocity without it.
    pub controller: Controller,
    /// What a hinge or slider loses, and what its drive can do at most. Not known to the C++ program. Default: nothing is lost
    /// or bounded.
    pub drive_train: DriveTrain,
    /// What a hinge or slider follows; `None`: it moves on its own. Not known to the C++ program. Default: `None`.
    pub coupling: Option<Coupling>,
}

/// What a hinge or slider loses, and what its drive can do at most.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveTrain {
    /// Viscous damping, N·m·s/rad or N·s/m, not negative: effort = −damping · rate. Default: 0.
    pub damping: f64,
    /// Inertia of its rotor as the joint has it, that is times the square of the gear ratio, kg·m² or kg, not negative:
    /// effort = −armature · acceleration. Default: 0.
    pub armature: f64,
    /// Dry friction, N·m or N, not negative: the largest effort that holds the joint, and the effort against its motion.
    /// Default: 0.
    pub friction: f64,
    /// Largest effort of commands and controllers, N·m or N, above 0; `None`: unbounded.
    pub max_effort: Option<f64>,
    /// Largest rate, whatever drives the joint, rad/s or m/s, above 0; `None`: unbounded.
    pub max_rate: Option<f64>,
}

/// Range of a one-dof joint, rad or m. `low` may exceed `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lower limit, rad or m.
    pub low: f64,
    /// Upper limit, rad or m.
    pub high: f64,
}

/// Type of a joint.
#[derive(Clone, Debug, PartialEq)]
pub enum JointKind {
    /// `hinge`, `revolute`, `continuous`.
    Revolute,
    /// `slider`, `prismatic`.
    Prismatic,
    /// `fixed`.
    Fixed,
    /// `spring`, `linear spring`.
    LinearSpring,
    /// `torsion spring`, `torsional spring`, `angular spring`.
    TorsionSpring,
    /// `p2p`: ball joint; axes and offsets have no meaning.
    PointToPoint,
    /// `cone twist`.
    ConeTwist(ConeTwistLimits),
    /// `six dof`.
    SixDof(SixDofLimits),
    /// `six dof spring`.
    SixDofSpring(Box<SixDofSpring>),
    /// Another text: the joint exists, creates no constraint, its position is 0.
    Unknown(String),
}

/// Ranges of a cone twist joint about its three axes: each angle within ± the value, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConeTwistLimits {
    /// Twist span about x, rad. Default: 0.7.
    pub twist: f64,
    /// Swing span about y, rad. Default: 0.7.
    pub swing_y: f64,
    /// Swing span about z, rad. Default: 0.7.
    pub swing_z: f64,
}

impl Default for ConeTwistLimits {
    fn default() -> Self {
        Self { twist: 0.7, swing_y: 0.7, swing_z: 0.7 }
    }
}

/// Ranges of a six-dof joint, one a component. `low` above `high` means: free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SixDofLimits {
    /// Lower linear limits, m. Default: -1.2 each.
    pub linear_low: Vector3<f64>,
    /// Upper linear limits, m. Default: 1.2 each.
    pub linear_high: Vector3<f64>,
    /// Lower angular limits, rad. Default: -1.2 each.
    pub angular_low: Vector3<f64>,
    /// Upper angular limits, rad. Default: 1.2 each.
    pub angular_high: Vector3<f64>,
}

impl Default for SixDofLimits {
    fn default() -> Self {
        let high = Vector3::repeat(1.2);
        Self { linear_low: -high, linear_high: high, angular_low: -high, angular_high: high }
    }
}

/// A linear and an angular quantity of a six-dof spring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearAngular {
    /// Along x, y, z.
    pub linear: Vector3<f64>,
    /// About x, y, z.
    pub angular: Vector3<f64>,
}

impl LinearAngular {
    pub(crate) fn repeat(value: f64) -> Self {
        Self { linear: Vector3::repeat(value), angular: Vector3::repeat(value) }
    }
}

/// What a six-dof spring has besides a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SixDofSpring {
    /// Ranges.
    pub limits: SixDofLimits,
    /// Stiffness, N/m and N·m/rad. Default: 1 each.
    pub stiffness: LinearAngular,
    /// Damping, N·s/m and N·m·s/rad. Default: 0.7 each.
    pub damping: LinearAngular,
    /// Rest position, m and rad. Default: 0 each.
    pub equilibrium_point: LinearAngular,
}

impl Default for SixDofSpring {
    fn default() -> Self {
        Self {
            limits: SixDofLimits::default(),
            stiffness: LinearAngular::repeat(1.0),
            damping: LinearAngular::repeat(0.7),
            equilibrium_point: LinearAngular::repeat(0.0),
        }
    }
}

impl Joint {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        let kind = JointKind::read(map);
        let controller = Self::controller(map);
        let body = |key| {
            let identifier = map.filled(key);
            if identifier.is_none() {
                let expected = "the identifier of a body";
                map.reject(ProblemKind::MissingKey, key, expected);
            }
            identifier.unwrap_or_default()
        };
        let one_dof = kind.is_one_dof();
        let scalar = |key, range| one_dof.then(|| map.real_in(key, range)).flatten();
        let drive_train = DriveTrain::read(map, &kind);
        let old_offset = map.real("offset");
        if old_offset.is_some() {
            map.ignore(&["child offset"], "`offset` is used");
        }
        let joint = Self {
            common: map.common(base),
            parent: body("parent"),
            child: body("child"),
            parent_pivot: map.need_vector("parent pivot"),
            child_pivot: map.need_vector("child pivot"),
            parent_axis: map.need_vector("parent axis"),
            child_axis: map.need_vector("child axis"),
            child_offset: old_offset.or_else(|| map.real("child offset")).unwrap_or(0.0),
            child_rotation: None,
            joint_offset: map.real("joint offset").unwrap_or(0.0),
            limits: one_dof.then(|| Limits::read(map)).flatten(),
            // The original takes the value of `enable feedback` here, which no author of a file can have meant.
            enable_motor: map.boolean_or_digit("enable motor").unwrap_or(true),
            enable_feedback: map.boolean("enable feedback").unwrap_or(false),
            max_motor_impulse: map
                .real_in("max motor impulse", Range::NotNegative)
                .unwrap_or_else(|| drive_train.max_effort.map_or(0.1, |effort| effort * IMPULSE_STEP)),
            damping: scalar("damping", Range::Any).unwrap_or(0.0),
            stiffness: scalar("stiffness", Range::Any).unwrap_or(0.0),
            equilibrium_point: scalar("equilibrium point", Range::Any),
            erp: map.real("joint erp").unwrap_or(0.1),
            cfm: map.real("joint cfm").unwrap_or(0.1),
            ignore_inter_collision: map.boolean("ignore inter-collision").unwrap_or(true),
            assemble: map.boolean("assemble").unwrap_or(true),
            controller,
            drive_train,
            coupling: Coupling::read(map),
            kind,
        };
        if !matches!(joint.kind, JointKind::PointToPoint | JointKind::Unknown(_)) {
            map.reject_zero("parent axis", &joint.parent_axis);
            map.reject_zero("child axis", &joint.child_axis);
        }
        if joint.kind.has_drive() && joint.damping != 0.0 {
            map.remark("damping", "only springs have it, here and in the C++ program; that of `drive train` counts");
        }
        let note = "joints have no such property";
        map.ignore(&["detached", "redundant", "origin", "axis"], note);
        map.finish();
        Some(joint)
    }

    fn controller(map: &Map<'_>) -> Controller {
        let mut controller = Controller::default();
        if let Some(gains) = map.map_opt("controller") {
            let default = Gains::default();
            controller.gains = Gains {
                p: gains.real("P").unwrap_or(default.p),
                i: gains.real("I").unwrap_or(default.i),
                d: gains.real("D").unwrap_or(default.d),
            };
            controller.output = ControllerOutput::Force;
            gains.finish();
        }
        if let Some(output) = map.controller_output() {
            controller.output = output;
        }
        controller
    }
}

impl DriveTrain {
    /// Reads `drive train` of a hinge or slider.
    fn read(map: &Map<'_>, kind: &JointKind) -> Self {
        if !kind.has_drive() {
            map.ignore(&["drive train"], "only hinges and sliders have one");
            return Self::default();
        }
        let Some(keys) = map.map_opt("drive train") else { return Self::default() };
        let loss = |key| keys.real_in(key, Range::NotNegative).unwrap_or(0.0);
        let most = |key| keys.real_in(key, Range::Positive);
        let drive_train = Self {
            damping: loss("damping"),
            armature: loss("armature"),
            friction: loss("friction"),
            max_effort: most("max effort"),
            max_rate: most("max rate"),
        };
        keys.finish();
        drive_train
    }
}

impl Limits {
    /// Reads `joint limits` of a one-dof joint: both ends or nothing.
    fn read(map: &Map<'_>) -> Option<Self> {
        let limits = map.map_opt("joint limits")?;
        let (low, high) = (limits.real("low"), limits.real("high"));
        limits.finish();
        if limits.has("low") != limits.has("high") {
            let expected = "both `low` and `high`";
            map.error(ProblemKind::MissingKey, "joint limits", expected, "the joint is unlimited");
        }
        Some(Self { low: low?, high: high? })
    }
}

impl JointKind {
    fn read(map: &Map<'_>) -> Self {
        let text = map.need_string("type");
        match text.as_str() {
            "hinge" | "revolute" | "continuous" => Self::Revolute,
            "slider" | "prismatic" => Self::Prismatic,
            "fixed" => Self::Fixed,
            "spring" | "linear spring" => Self::LinearSpring,
            "torsion spring" | "torsional spring" | "angular spring" => Self::TorsionSpring,
            "p2p" => Self::PointToPoint,
            "cone twist" => {
                ignore_spring(map);
                Self::ConeTwist(ConeTwistLimits::read(map))
            }
            "six dof" => {
                ignore_spring(map);
                Self::SixDof(SixDofLimits::read(map))
            }
            "six dof spring" => Self::SixDofSpring(Box::new(SixDofSpring {
                limits: SixDofLimits::read(map),
                stiffness: LinearAngular::read(map, "stiffness", 1.0),
                damping: LinearAngular::read(map, "damping", 0.7),
                equilibrium_point: LinearAngular::read(map, "equilibrium point", 0.0),
            })),
            _ => {
                if map.has("type") {
                    let expected = "revolute, prismatic, fixed, linear spring, torsion spring, p2p, \
                                    cone twist, six dof or six dof spring";
                    let action = "the joint constrains nothing";
                    map.error(ProblemKind::UnknownValue, "type", expected, action);
                }
                map.skip(&["joint limits", "damping", "stiffness", "equilibrium point"]);
                Self::Unknown(text)
            }
        }
    }

    /// Whether it is a hinge or a slider, which drives move.
    pub(crate) fn has_drive(&self) -> bool {
        matches!(self, Self::Revolute | Self::Prismatic)
    }

    /// True for types whose limits, damping and stiffness are plain numbers, whether or not they have a use for them.
    fn is_one_dof(&self) -> bool {
        !matches!(self, Self::ConeTwist(_) | Self::SixDof(_) | Self::SixDofSpring(_) | Self::Unknown(_))
    }
}

/// Keys of springs, on a multi-dof joint that is none.
fn ignore_spring(map: &Map<'_>) {
    let keys = ["damping", "stiffness", "equilibrium point"];
    map.ignore(&keys, "the joint type has none");
}

impl ConeTwistLimits {
    fn read(map: &Map<'_>) -> Self {
        match map.vector("joint limits") {
            Some(limits) => Self { twist: limits.x, swing_y: limits.y, swing_z: limits.z },
            None => Self::default(),
        }
    }
}

/// Reads a vector of an incomplete block: its default stays when the key is absent.
fn vector_or_note(map: &Map<'_>, key: &'static str, vector: &mut Vector3<f64>) {
    match map.vector(key) {
        Some(value) => *vector = value,
        None => map.error(ProblemKind::MissingKey, key, "a mapping {x, y, z}", "the default is used"),
    }
}

impl SixDofLimits {
    fn read(map: &Map<'_>) -> Self {
        let mut limits = Self::default();
        if let Some(block) = map.map_opt("joint limits") {
            let (linear, angular) = (block.map("linear"), block.map("angular"));
            vector_or_note(&linear, "low", &mut limits.linear_low);
            vector_or_note(&linear, "high", &mut limits.linear_high);
            vector_or_note(&angular, "low", &mut limits.angular_low);
            vector_or_note(&angular, "high", &mut limits.angular_high);
            linear.finish();
            angular.finish();
            block.finish();
        }
        limits
    }
}

impl LinearAngular {
    fn read(map: &Map<'_>, key: &'static str, default: f64) -> Self {
        let mut value = Self::repeat(default);
        if let Some(block) = map.map_opt(key) {
            vector_or_note(&block, "linear", &mut value.linear);
            vector_or_note(&block, "angular", &mut value.angular);
            block.finish();
        } else {
            let expected = "a mapping {linear, angular} of vectors";
            map.warn(ProblemKind::Absent, key, expected, "the default is used");
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read, refused};
    use super::super::Model;
    use super::*;

    const FRAME: &str = "parent: A, child: B, parent pivot: {x: 1, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
                         parent axis: {x: 0, y: 0, z: 2}, child axis: {x: 0, y: 0, z: 1}";

    fn text(keys: &str) -> String {
        format!("joints: [J]\nJ: {{{FRAME}, {keys}}}\n")
    }

    fn joint(keys: &str) -> Joint {
        clean::<Model>(&text(keys)).joints.remove(0)
    }

    #[test]
    fn defaults() {
        let j = joint("type: hinge");
        assert_eq!(j.kind, JointKind::Revolute);
        assert_eq!((j.parent.as_str(), j.child.as_str()), ("A", "B"));
        assert_eq!(j.parent_axis, Vector3::new(0.0, 0.0, 2.0));
        assert_eq!((j.child_offset, j.joint_offset, j.limits), (0.0, 0.0, None));
        assert!(j.enable_motor && !j.enable_feedback && j.ignore_inter_collision);
        assert_eq!((j.max_motor_impulse, j.damping, j.stiffness), (0.1, 0.0, 0.0));
        assert_eq!((j.erp, j.cfm, j.equilibrium_point), (0.1, 0.1, None));
        assert_eq!(j.controller, Controller::default());
    }

    #[test]
    fn all_spellings_of_the_types() {
        use JointKind as K;
        for (name, kind) in [
            ("revolute", K::Revolute),
            ("continuous", K::Revolute),
            ("slider", K::Prismatic),
            ("prismatic", K::Prismatic),
            ("fixed", K::Fixed),
            ("spring", K::LinearSpring),
            ("linear spring", K::LinearSpring),
            ("torsion spring", K::TorsionSpring),
            ("torsional spring", K::TorsionSpring),
            ("angular spring", K::TorsionSpring),
            ("p2p", K::PointToPoint),
            ("cone twist", K::ConeTwist(ConeTwistLimits::default())),
            ("six dof", K::SixDof(SixDofLimits::default())),
        ] {
            assert_eq!(joint(&format!("type: {name}")).kind, kind);
        }
        let (model, problems) = read::<Model>(&text("type: Revolute, joint limits: 3"));
        assert_eq!(model.joints[0].kind, K::Unknown("Revolute".into()));
        assert_eq!(problems.len(), 1);
    }

    #[test]
    fn controllers() {
        let c = joint("type: fixed, controller: {P: 5}").controller;
        assert_eq!((c.gains.p, c.gains.i, c.gains.d), (5.0, 0.0, 1.0));
        assert_eq!(c.output, ControllerOutput::Force);
        let c = joint("type: fixed, controller output type: POSITION").controller;
        assert_eq!(c.output, ControllerOutput::Position);
        let (model, problems) = read::<Model>(&text("type: fixed, controller output type: Force"));
        assert_eq!(model.joints[0].controller.output, ControllerOutput::Force);
        assert_eq!(problems.len(), 1);
    }

    #[test]
    fn drive_trains() {
        let train = "drive train: {damping: 0.1, armature: 0.02, friction: 0.3, max effort: 5, max rate: 2}";
        let j = joint(&format!("type: hinge, {train}"));
        let expected =
            DriveTrain { damping: 0.1, armature: 0.02, friction: 0.3, max_effort: Some(5.0), max_rate: Some(2.0) };
        assert_eq!((j.drive_train, j.max_motor_impulse), (expected, 0.005));
        assert_eq!(joint(&format!("type: slider, max motor impulse: 1, {train}")).max_motor_impulse, 1.0);
        assert_eq!(joint("type: hinge").drive_train, DriveTrain::default());
        let (model, problems) = read::<Model>(&text(&format!("type: fixed, {train}")));
        assert_eq!(model.joints[0].drive_train, DriveTrain::default());
        assert!(
            problems[0].contains("`J / drive train` is not used; only hinges and sliders have one"),
            "{problems:?}"
        );
        for (key, value) in [("armature", "-1"), ("max effort", "0"), ("friction", ".inf")] {
            let (model, problems) = read::<Model>(&text(&format!("type: hinge, drive train: {{{key}: {value}}}")));
            assert!(
                model.joints.is_empty() && problems[0].contains(&format!("`J / drive train / {key}`")),
                "{problems:?}"
            );
        }
        let (_, problems) = read::<Model>(&text("type: hinge, damping: 0.1"));
        assert!(problems[0].contains("info: `J / damping` is not used; only springs have it"), "{problems:?}");
    }

    #[test]
    fn motors_take_booleans_and_digits() {
        assert!(joint("type: fixed, enable motor: 1").enable_motor);
        assert!(!joint("type: fixed, enable motor: 0").enable_motor);
        assert!(!joint("type: fixed, enable motor: No, enable feedback: true").enable_motor);
        assert_eq!(refused::<Model>(&text("type: fixed, enable motor: 2")).len(), 1);
        assert_eq!(refused::<Model>(&text("type: fixed, enable feedback: 1")).len(), 1);
    }

    #[test]
    fn limits_need_both_ends() {
        let j = joint("type: revolute, joint limits: {low: -1, high: 2}");
        assert_eq!(j.limits, Some(Limits { low: -1.0, high: 2.0 }));
        assert_eq!(joint("type: revolute, joint limits: {}").limits, None);
        let (model, problems) = read::<Model>(&text("type: revolute, joint limits: {low: 1}"));
        assert_eq!(model.joints[0].limits, None);
        assert!(problems[0].contains("the joint is unlimited"));
    }

    #[test]
    fn joints_are_assembled_unless_they_say_otherwise() {
        assert!(joint("type: fixed").assemble);
        assert!(!joint("type: fixed, assemble: false").assemble);
        assert_eq!(refused::<Model>(&text("type: fixed, assemble: 1")).len(), 1);
    }

    #[test]
    fn legacy_offset_wins() {
        assert_eq!(joint("type: fixed, child offset: 2").child_offset, 2.0);
        let (model, problems) = read::<Model>(&text("type: fixed, offset: 1, child offset: 2"));
        assert_eq!(model.joints[0].child_offset, 1.0);
        assert!(problems[0].contains("`J / child offset` is not used; `offset` is used"));
    }

    #[test]
    fn multi_dof_blocks() {
        let j = joint("type: cone twist, joint limits: {x: 1, y: 2, z: 3}");
        let limits = ConeTwistLimits { twist: 1.0, swing_y: 2.0, swing_z: 3.0 };
        assert_eq!(j.kind, JointKind::ConeTwist(limits));
        let low = "{low: {x: 0, y: 0, z: 0}}";
        let keys = format!(
            "type: six dof spring, joint limits: {{linear: {low}, angular: {low}}}, \
             stiffness: {{linear: {{x: 1, y: 2, z: 3}}}}"
        );
        let (model, problems) = read::<Model>(&text(&keys));
        let JointKind::SixDofSpring(spring) = &model.joints[0].kind else { panic!() };
        assert_eq!(spring.limits.linear_low, Vector3::zeros());
        assert_eq!(spring.limits.angular_high, Vector3::repeat(1.2));
        assert_eq!(spring.stiffness.linear, Vector3::new(1.0, 2.0, 3.0));
        assert_eq!(spring.stiffness.angular, Vector3::repeat(1.0));
        assert_eq!(spring.damping, LinearAngular::repeat(0.7));
        assert_eq!(problems.len(), 5, "{problems:#?}");
    }

    #[test]
    fn missing_keys_refuse_the_file_and_bad_axes_drop_the_joint() {
        let problems = refused::<Model>("joints: [J]\nJ: {parent: A, child: B}\n");
        assert_eq!(problems.len(), 5, "{problems:#?}");
        let zero = "child axis: {x: 0, y: 0, z: 0}";
        let with = |kind: &str| text(&format!("type: {kind}")).replace("child axis: {x: 0, y: 0, z: 1}", zero);
        let (model, problems) = read::<Model>(&with("revolute"));
        assert!(model.joints.is_empty());
        assert!(problems[0].contains("`J / child axis` is (0, 0, 0), expected a direction that is not zero"));
        assert_eq!(clean::<Model>(&with("p2p")).joints.len(), 1);
        let (model, problems) = read::<Model>(&text("type: fixed").replace("parent: A, ", ""));
        assert!(model.joints.is_empty() && problems[0].contains("`J / parent` is missing"));
    }
}
