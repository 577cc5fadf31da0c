//! Section `actuator`: what drives joints.
//!
//! Efforts of MuJoCo's actuators are gear · (gain · control + bias), with an affine bias = b0 + b1 · length + b2 · rate, where length
//! and rate are those of the joint times the gear, or none, which is the default. What drives a joint here is its controller: effort = P · (target − position) − D · rate.

use std::collections::HashMap;

use super::joint::Limited;
use super::settings::{choice, finish, Compiler};
use crate::adf::{Controller, ControllerOutput, DriveTrain, Gains, ProblemKind, IMPULSE_STEP};
use crate::xml::{quoted, Element};

/// What an actuator element and its defaults say.
#[derive(Debug, Clone)]
pub(super) struct ActuatorText {
    gear: f64,
    gain: f64,
    /// Kept, as in MuJoCo, where the type of the bias is none: a class inside, or an element, may say the type. The third one is a
    /// damping ratio if it is above 0 and the gain is minus the second one.
    bias: [f64; 3],
    /// The bias is affine; otherwise there is none, whatever its numbers are.
    is_affine: bool,
    /// What the gain and bias are beyond those numbers; empty: nothing.
    strange: &'static str,
    control_range: [f64; 2],
    control_limited: Limited,
    force_range: [f64; 2],
    force_limited: Limited,
    damping: f64,
    armature: f64,
}

impl Default for ActuatorText {
    fn default() -> Self {
        Self {
            gear: 1.0,
            gain: 1.0,
            bias: [0.0; 3],
            is_affine: false,
            strange: "",
            control_range: [0.0; 2],
            control_limited: Limited::Auto,
            force_range: [0.0; 2],
            force_limited: Limited::Auto,
            damping: 0.0,
            armature: 0.0,
        }
    }
}

/// Actuators that are not read.
const STRANGE: [&str; 9] =
    ["intvelocity", "orientation", "pid", "damper", "cylinder", "muscle", "adhesion", "dcmotor", "plugin"];

impl ActuatorText {
    pub fn is_kind(tag: &str) -> bool {
        matches!(tag, "general" | "motor" | "position" | "velocity") || STRANGE.contains(&tag)
    }

    pub fn apply(&mut self, element: &Element<'_>) {
        let tag = element.tag();
        if let Some(strange) = STRANGE.iter().find(|strange| **strange == tag) {
            self.strange = strange;
            return;
        }
        let read = [
            &[
                "name",
                "class",
                "joint",
                "jointinparent",
                "tendon",
                "site",
                "body",
                "slidersite",
                "cranksite",
                "refsite",
            ][..],
            &["gear", "ctrlrange", "ctrllimited", "forcerange", "forcelimited", "damping", "armature"],
            match tag {
                "general" => &[
                    "gaintype",
                    "gainprm",
                    "biastype",
                    "biasprm",
                    "dyntype",
                    "dynprm",
                    "actlimited",
                    "actrange",
                    "actdim",
                ],
                "position" => &["kp", "kv", "dampratio", "timeconst"],
                "velocity" => &["kv"],
                _ => &[],
            },
        ]
        .concat();
        let unused = [
            ("it changes nothing that moves", &["group", "user", "cranklength", "lengthrange"][..]),
            (
                "commands act at once and as they are",
                &["delay", "interp", "nsample", "actearly", "inheritrange", "input", "ffrange", "velrange"][..],
            ),
        ];
        finish(element, &read, &unused, &[]);
        if let Some(gear) = element.numbers_in("gear", 1..=6) {
            self.gear = gear[0];
        }
        self.control_range = element.numbers("ctrlrange").unwrap_or(self.control_range);
        self.control_limited = choice(element, "ctrllimited", &Limited::WORDS).unwrap_or(self.control_limited);
        self.force_range = element.numbers("forcerange").unwrap_or(self.force_range);
        self.force_limited = choice(element, "forcelimited", &Limited::WORDS).unwrap_or(self.force_limited);
        self.damping = element.real("damping").unwrap_or(self.damping);
        self.armature = element.real("armature").unwrap_or(self.armature);
        match tag {
            "general" => self.apply_general(element),
            "position" => {
                self.strange = "";
                // The gain is inherited, from whatever kind of actuator.
                let kp = element.real("kp").unwrap_or(self.gain);
                (self.gain, self.bias[1], self.is_affine) = (kp, -kp, true);
                let damping = element.real("kv").map(|kv| -kv);
                self.bias[2] = damping.or(element.real("dampratio")).unwrap_or(self.bias[2]);
                if element.real("timeconst").is_some_and(|time| time > 0.0) {
                    element.ignored("timeconst", "commands act at once");
                }
            }
            "velocity" => {
                self.strange = "";
                let kv = element.real("kv").unwrap_or(self.gain);
                (self.gain, self.bias, self.is_affine) = (kv, [0.0, 0.0, -kv], true);
            }
            _ => (self.strange, self.gain, self.is_affine) = ("", 1.0, false),
        }
    }

    fn apply_general(&mut self, element: &Element<'_>) {
        if let Some(numbers) = element.numbers_in("gainprm", 1..=10) {
            self.gain = numbers[0];
        }
        if let Some(numbers) = element.numbers_in("biasprm", 1..=10) {
            for (bias, number) in self.bias.iter_mut().zip(&numbers) {
                *bias = *number;
            }
        }
        let gains =
            [("fixed", ""), ("affine", "gaintype affine"), ("muscle", "gaintype muscle"), ("user", "gaintype user")];
        if let Some(strange) = choice(element, "gaintype", &gains) {
            self.strange = strange;
        }
        let biases = [
            ("none", ("", false)),
            ("affine", ("", true)),
            ("muscle", ("biastype muscle", false)),
            ("user", ("biastype user", false)),
        ];
        if let Some((strange, is_affine)) = choice(element, "biastype", &biases) {
            self.strange = if self.strange.is_empty() { strange } else { self.strange };
            self.is_affine = is_affine;
        }
        if element.attribute("dyntype").is_some_and(|kind| kind != "none") {
            element.warn(
                ProblemKind::UnknownValue,
                "dyntype",
                &quoted(element.attribute("dyntype").unwrap_or_default()),
                "none",
                "commands act at once",
            );
        }
    }

    fn is_limited(&self, compiler: &Compiler) -> bool {
        self.force_limited.counts(self.force_range, compiler)
    }
}

/// What drives a joint, gathered from all its actuators.
#[derive(Debug, Clone, Default)]
pub(super) struct Drive {
    /// N·m/rad or N/m.
    stiffness: f64,
    /// N·m·s/rad or N·s/m.
    damping: f64,
    has_position: bool,
    has_velocity: bool,
    /// Damping over the root of the joint's inertia, √(N·m/rad) or √(N/m).
    ratio: f64,
    /// Of all actuators, kg·m² or kg.
    pub armature: f64,
    own_damping: f64,
    /// N·m or N; `None`: unbounded.
    most: Option<f64>,
}

/// Largest gain, armature or damping of an actuator that is taken for one: sums of them still are numbers.
const MOST: f64 = 1e100;

/// Joints by name that actuators drive.
pub(super) type Drives = HashMap<String, Drive>;

/// The joint that a tendon moves, and its length over that joint's coordinate.
pub(super) type TendonArms<'a> = HashMap<&'a str, (String, f64)>;

/// Adds an actuator to what drives its joint.
pub(super) fn add<'a>(
    element: &Element<'a>,
    text: &ActuatorText,
    compiler: &Compiler,
    joints: &HashMap<String, bool>,
    tendons: &TendonArms<'a>,
    drives: &mut Drives,
) {
    let left_out = "the actuator is left out";
    if !text.strange.is_empty() || STRANGE.contains(&element.tag()) {
        let strange = if text.strange.is_empty() { element.tag() } else { text.strange };
        let expected = "motor, position, velocity, or general with a fixed gain and an affine bias";
        element.error(ProblemKind::UnknownValue, "", &quoted(strange), expected, left_out);
        return;
    }
    let (joint, arm) =
        match (element.attribute("joint").or(element.attribute("jointinparent")), element.attribute("tendon")) {
            (Some(joint), _) => match joints.get(joint) {
                Some(true) => (joint.to_owned(), 1.0),
                found => {
                    let expected = if found.is_some() { "a hinge or slide joint" } else { "the name of a joint" };
                    let key = if element.attribute("joint").is_some() { "joint" } else { "jointinparent" };
                    element.error(ProblemKind::UnknownValue, key, &quoted(joint), expected, left_out);
                    return;
                }
            },
            (None, Some(tendon)) => match tendons.get(tendon) {
                Some((joint, arm)) => (joint.clone(), *arm),
                None => {
                    let expected = "a fixed tendon of one joint, or of joints that equalities couple";
                    element.error(ProblemKind::UnknownValue, "tendon", &quoted(tendon), expected, left_out);
                    return;
                }
            },
            (None, None) => {
                element.error(ProblemKind::Absent, "joint", "", "a joint or a fixed tendon", left_out);
                return;
            }
        };
    let gear = text.gear * arm;
    if gear == 0.0 || text.gain == 0.0 {
        element.warn(ProblemKind::OutOfRange, "gear", "0, as gear or gain", "another number", left_out);
        return;
    }
    let [constant, length, rate] = if text.is_affine { text.bias } else { [0.0; 3] };
    let is_typed = text.is_affine || element.attribute("biastype").is_some();
    if element.tag() == "general" && !is_typed && text.bias != [0.0; 3] {
        let action = "the bias is none, and the numbers of `biasprm` have no effect";
        element.warn(ProblemKind::Absent, "biastype", "", "affine", action);
    }
    let square = gear * gear;
    let is_ratio = rate > 0.0 && length < 0.0 && text.gain == -length;
    let (rate, ratio) = if is_ratio { (0.0, 2.0 * rate * (-length).sqrt() * gear.abs()) } else { (rate, 0.0) };
    let gains =
        [square * length, square * rate, square * text.armature, square * text.damping, gear * text.gain, ratio];
    if !gains.iter().all(|gain| gain.abs() <= MOST) {
        element.error(
            ProblemKind::OutOfRange,
            "gear",
            &format!("{gear:e} with the tendon"),
            "smaller numbers",
            left_out,
        );
        return;
    }
    let drive = drives.entry(joint).or_default();
    if constant != 0.0 {
        let found = format!("{constant} as its first number");
        element.warn(ProblemKind::OutOfRange, "biasprm", &found, "0", "there is no constant effort");
    }
    drive.armature += gear * gear * text.armature.max(0.0);
    drive.own_damping += gear * gear * text.damping.max(0.0);
    if length != 0.0 {
        if (length + text.gain).abs() > 1e-9 * text.gain.abs() {
            let found = format!("gain {} and bias {length}", text.gain);
            let action = "targets are positions, and the bias is the gain";
            element.warn(
                ProblemKind::OutOfRange,
                "gainprm",
                &found,
                "a gain that is minus the bias of the length",
                action,
            );
        }
        drive.has_position = true;
        drive.stiffness += square * -length;
    } else if rate != 0.0 {
        drive.has_velocity = true;
    }
    drive.damping += square * -rate;
    if is_ratio && element.attribute("tendon").is_some() {
        let key = if element.attribute("dampratio").is_some() { "dampratio" } else { "biasprm" };
        element.ignored(key, "damping ratios are those of joints; write the damping");
    } else {
        drive.ratio += ratio;
    }
    let limit = |range: [f64; 2]| range.map(f64::abs).into_iter().fold(0.0, f64::max);
    let is_motor = length == 0.0 && rate == 0.0;
    let own = if text.is_limited(compiler) {
        Some(limit(text.force_range))
    } else if is_motor && text.control_limited.counts(text.control_range, compiler) {
        Some(limit(text.control_range) * text.gain.abs())
    } else {
        None
    };
    let own = own.map(|most| most * gear.abs()).filter(|most| *most > 0.0);
    drive.most = match (drive.most, own) {
        (Some(a), Some(b)) => Some(a + b),
        (a, b) => a.or(b),
    };
}

impl Drive {
    /// Whether a damping ratio is to be made a damping.
    pub fn has_ratio(&self) -> bool {
        self.ratio > 0.0
    }

    /// Makes the damping ratio a damping. `mobility`: that of the joint, 1/(kg·m²) or 1/kg.
    pub fn set_ratio(&mut self, mobility: f64) {
        let damping = std::mem::take(&mut self.ratio) / mobility.sqrt();
        // What has no inertia swings at once, whatever its damping is.
        self.damping += if damping.is_finite() { damping.min(MOST) } else { 0.0 };
    }

    /// What the drive makes of a joint: its controller, losses and most, and the largest impulse of its motor.
    pub fn apply(&self, drive_train: &mut DriveTrain) -> (Controller, f64) {
        drive_train.armature += self.armature;
        drive_train.damping += self.own_damping;
        drive_train.max_effort = match (drive_train.max_effort, self.most) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
        let controller = match self.has_position {
            true => Controller {
                gains: Gains { p: self.stiffness, i: 0.0, d: self.damping },
                output: ControllerOutput::Force,
            },
            false => Controller::default(),
        };
        (controller, motor_impulse(drive_train))
    }
}

/// Largest impulse of a joint's motor, N·m·s or N·s; as in ADF where nothing bounds it.
pub(super) fn motor_impulse(drive_train: &DriveTrain) -> f64 {
    const UNBOUNDED: f64 = 0.1;
    drive_train.max_effort.map_or(UNBOUNDED, |effort| effort * IMPULSE_STEP)
}
