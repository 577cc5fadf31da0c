//! What the C++ program does differently, where that can be seen from a file.
//!
//! Two tables: problems that the reader reports anyway, and things that are fine here and therefore no problem. What
//! cannot be seen from a file (timing, ROS, resets) is in `docs/differences.md` only.

use ambf_core::adf::{Problem, ProblemKind as K};

/// Something that is fine here and different in the C++ program.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Difference {
    /// A few words that stay the same, for tools.
    pub kind: &'static str,
    /// Key of the element that it is about; empty: the element as a whole.
    pub key: &'static str,
    /// What is done here; completes "`element / key` …".
    pub here: &'static str,
    /// What the C++ program does; empty: the same.
    pub original: &'static str,
}

macro_rules! differences {
    ($($name:ident: $kind:literal, $key:literal, $here:literal, $original:literal;)*) => { $(
        pub(super) const $name: Difference =
            Difference { kind: $kind, key: $key, here: $here, original: $original };
    )*
        #[cfg(test)]
        const ALL: &[&Difference] = &[$(&$name),*];
    };
}

differences! {
    // --- any element
    // ---------------------------------------------------------------------------------------------------
    PUBLISH_FREQUENCY: "publish frequency", "publish frequency",
        "is taken as a pair",
        "sets `low` first and refuses it above the `high` of before, 1000 Hz; then it refuses a `high` below its `low`";
    DAE_MESH: "dae mesh", "",
        "names a DAE, PLY, glTF or MSH mesh, which is read",
        "reads none of these: it drops the element, or does not draw it";
    NAME_CHARACTERS: "name", "name",
        "holds characters that a ROS topic may not hold; they are replaced by `_`",
        "takes them over into the names of topics";
    SAME_TOPICS: "same topics", "name",
        "and namespace are those of another element: both share their topics, and a command reaches both",
        "does the same without a word";
    // --- bodies
    // --------------------------------------------------------------------------------------------------------
    HIDDEN: "hidden", "visible",
        "hides the element",
        "draws it: `visible` counts only beside `color rgba` or `color components`";
    COMPOUND_OFFSET: "compound offset", "compound shape",
        "has parts with an offset",
        "draws all of them without it; what collides is right";
    CAPSULE_DRAWN: "capsule drawn", "geometry",
        "is a capsule",
        "draws an ellipsoid with the half axes radius, radius, height";
    AXIS_DRAWN: "axis drawn", "geometry",
        "has an axis other than z",
        "draws it along z; what collides is right";
    CONVEX_DECOMPOSITION: "convex decomposition", "collision mesh type",
        "divides the mesh into convex hulls",
        "does not know this type: it reports it and collides with the mesh as it is";
    EMPTY_INERTIA: "empty inertia", "inertia",
        "is missing and there is no shape to estimate it from: zero is used, the body does not rotate",
        "uses uninitialised numbers";
    // --- joints
    // --------------------------------------------------------------------------------------------------------
    ENABLE_MOTOR: "enable motor", "enable motor",
        "counts",
        "takes the value of `enable feedback` instead";
    ENABLE_MOTOR_ALONE: "enable motor", "enable motor",
        "counts",
        "looks for `enable feedback` instead, and refuses the file because it is missing";
    COUPLING: "coupling", "coupling",
        "makes the joint follow others",
        "moves the joint on its own";
    DRIVE_TRAIN: "drive train", "drive train",
        "counts",
        "loses nothing by it, and bounds nothing";
    SPRING_LOCKED: "no effect", "joint limits",
        "are missing or not both there: the spring is locked and its stiffness has no effect",
        "";
    // --- sensors, actuators
    // --------------------------------------------------------------------------------------------
    RESISTANCE_SILENT: "resistance silent", "",
        "is a resistance sensor with topics of its own",
        "publishes nothing of resistance sensors";
    RESISTANCE_NORMAL: "resistance normal", "location",
        "turns the rays of a resistance sensor",
        "pushes as if `location` had no orientation; so does the profile `legacy`";
    RESISTANCE_DAMPING: "resistance damping", "contact damping",
        "is given",
        "multiplies it with a difference that is always zero; so does the profile `legacy`";
    CONTACT_SENSOR: "contact sensor", "type",
        "is Contact",
        "knows the type from version 3.0 on; 2.0 goes on with an uninitialised sensor, which may crash";
    SENSOR_MESH: "sensor mesh", "mesh",
        "is found below the resolution path of the model",
        "looks beside the file only and drops the sensor";
    MESH_RAYS: "mesh rays", "mesh",
        "gives one ray for each triangle",
        "leaves the number of rays undefined";
    PARAMETRIC_TWICE: "parametric location", "location",
        "moves the fan once",
        "applies the location to parametric rays twice";
    SHORT_PARENT: "short parent", "parent",
        "is found with the namespace of the element",
        "looks without the namespace, finds the text in several bodies and drops the element";
    SENSOR_PLUGIN: "sensor plugin path", "plugins",
        "have paths relative to the file",
        "takes them relative to the working directory";
    ACTUATOR_FRAME: "actuator frame", "location",
        "stands in the body frame of the parent",
        "takes it in the parent's inertial frame, which differs; so does the profile `legacy`";
    ACTUATOR_LIMIT: "no effect", "max impulse",
        "has no effect",
        "";
    ACTUATOR_TAU: "no effect", "tau",
        "has no effect",
        "";
    // --- vehicles, ghosts, soft bodies, volumes
    // ------------------------------------------------------------------------
    CHASSIS_SAME_FILE: "chassis", "chassis",
        "is a body of the same file",
        "looks among the models loaded before only and drops the vehicle";
    WHEEL_MESH: "wheel mesh", "mesh",
        "is found below a resolution path or beside the file",
        "looks in the working directory only";
    GHOST_GROUPS: "ghost groups", "collision groups",
        "count for the ghost object",
        "crashes if there is another group";
    GHOST_GRAVITY: "ghost gravity", "",
        "gives bodies their own gravity back when they leave it",
        "leaves them with the world's gravity";
    RANDOMIZE: "randomize constraints", "randomize constraints",
        "is false and randomises all the same: any value does",
        "";
    SOFT_PARTS: "soft body parts", "",
        "has a mesh of several parts",
        "keeps the last one only; so does the profile `legacy`";
    NODE_ZERO: "fixed nodes", "config",
        "fixes the first node",
        "leaves the first node free; so does the profile `legacy`";
    VOLUME_EMPTY: "volume images", "",
        "has no `images`: an empty volume",
        "leaves the kind of the volume undefined";
    // --- lights, cameras
    // -----------------------------------------------------------------------------------------------
    SHADOW: "shadow quality", "",
        "has no `shadow quality`: 0 is used",
        "leaves it uninitialised";
    STEREO_MODE: "stereo mode", "stereo",
        "means passive left and right, whatever its mode",
        "";
    DEPTH_RESOLUTION: "depth resolution", "publish depth resolution",
        "is the size of the depth picture",
        "uses `publish image resolution`";
    // --- models, worlds, input devices
    // -----------------------------------------------------------------------------------------
    ROBOT_DESCRIPTION: "robot description", "",
        "the file is a robot description (URDF)",
        "reads none";
    ENCLOSURE: "enclosure", "enclosure",
        "makes five static planes",
        "leaves the environment undefined and crashes";
    NO_ENVIRONMENT: "environment", "",
        "has neither `environment` nor `enclosure`: the environment is empty",
        "leaves it undefined, which may crash";
    MAX_FORCE: "max force", "max force",
        "limits the force, beside what the device is rated for",
        "replaces it by what the device is rated for";
    DEADBAND: "deadband", "",
        "has no `deadband`: 0.001 N is used",
        "leaves it uninitialised";
    BUTTONS: "button mapping", "button mapping",
        "leaves out a button, which then does nothing",
        "leaves its number uninitialised";
    HAPTIC_GAIN: "haptic gain", "haptic gain",
        "is missing: the user feels nothing",
        "uses gains of 10 N/m and 10 N·m/rad with a damping of 1";
    DEVICE_KEY: "device key", "",
        "has keys about its driver or its laws",
        "does not know the keys `driver`, `identity`, `driver settings`, `enable on button`, `time scaled gain` and ignores them";
    BUTTON_ZERO: "button mapping", "button mapping",
        "has the gripper on button 0",
        "takes 0 for no gripper button";
}

/// What comes of a visual mesh that is missing or of no known format.
pub(super) const VISUAL_MESH_MISSING: &str = "drops the element";
/// What comes of images of a volume that are missing.
pub(super) const IMAGES_MISSING: &str = "drops the volume";
/// What comes of a world file that cannot be used.
pub(super) const WORLD_UNUSABLE: &str = "goes on with an undefined environment, which may crash";

/// Sentences for problems of the reader: element, kind, key (empty: any), what the C++ program does.
const PROBLEMS: &[(&str, K, &str, &str)] = &[
    ("", K::NonFinite, "", "computes with it"),
    ("sensor", K::UnknownValue, "type", "goes on with an uninitialised sensor, which may crash"),
    ("actuator", K::UnknownValue, "type", "goes on with an uninitialised actuator, which may crash"),
    ("sensor", K::MissingKey, "type", "skips it without a word"),
    ("actuator", K::MissingKey, "type", "skips it without a word"),
    ("", K::UnknownValue, "shape", "uses an uninitialised shape"),
    ("", K::UnknownValue, "collision shape", "uses an uninitialised shape"),
    ("body", K::OutOfRange, "mass", "does not check it"),
    ("body", K::OutOfRange, "inertia", "does not check it"),
    ("joint", K::OutOfRange, "parent axis", "normalises it to numbers that are none"),
    ("joint", K::OutOfRange, "child axis", "normalises it to numbers that are none"),
    ("", K::OutOfRange, "scale", "does not check it"),
    ("", K::OutOfRange, "radius", "does not check it"),
    ("", K::OutOfRange, "height", "does not check it"),
    ("", K::OutOfRange, "x", "does not check it"),
    ("", K::OutOfRange, "y", "does not check it"),
    ("", K::OutOfRange, "z", "does not check it"),
    ("", K::OutOfRange, "normal", "does not check it"),
    ("", K::OutOfRange, "collision margin", "does not check it"),
    ("vehicle", K::Absent, "radius", "leaves it uninitialised"),
    ("vehicle", K::Absent, "friction", "leaves it uninitialised"),
    ("vehicle", K::Absent, "suspension", "leaves it uninitialised"),
    ("vehicle", K::Absent, "roll influence", "leaves it uninitialised"),
    ("vehicle", K::MissingKey, "body", "adds the wheel to the physics all the same"),
    ("light", K::OutOfRange, "shadow quality", "leaves it uninitialised"),
    ("input device", K::WrongType, "", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "linear", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "angular", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "x", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "y", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "z", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "r", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "p", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "P", "ends with an uncaught exception"),
    ("input device", K::MissingKey, "D", "ends with an uncaught exception"),
    ("input device", K::OutOfRange, "g1", "uses the button for both, unless it is 0, which it takes for none"),
    ("input device", K::OutOfRange, "deadband", "uses it as it is"),
    ("launch file", K::MissingKey, "", "ends with exit status 255"),
    ("colours", K::WrongType, "", "never opens a colour table"),
    ("colours", K::MissingKey, "", "never opens a colour table"),
    ("colours", K::OutOfRange, "", "never opens a colour table"),
];

/// What the C++ program does where the reader found `problem` in an element called `element` (`body`, `joint`, …).
pub(super) fn of_problem(element: &str, problem: &Problem) -> Option<&'static str> {
    sentence(element, problem.kind, &problem.key)
}

fn sentence(element: &str, kind: K, key: &str) -> Option<&'static str> {
    let fits = |row: &&(&str, K, &str, &str)| {
        (row.0.is_empty() || row.0 == element) && row.1 == kind && (row.2.is_empty() || row.2 == key)
    };
    PROBLEMS.iter().find(fits).map(|row| row.3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_problem_has_one_sentence() {
        for (i, row) in PROBLEMS.iter().enumerate() {
            let twice = PROBLEMS[i + 1..].iter().any(|other| (other.0, other.1, other.2) == (row.0, row.1, row.2));
            assert!(!twice, "{row:?}");
        }
        assert!(sentence("sensor", K::UnknownValue, "type").is_some_and(|text| text.contains("crash")));
        assert_eq!(sentence("joint", K::UnknownValue, "type"), None);
        assert_eq!(sentence("input device", K::WrongType, "deadband"), Some("ends with an uncaught exception"));
    }

    #[test]
    fn differences_say_something_and_end_without_a_full_stop() {
        for difference in ALL {
            assert!(!difference.kind.is_empty() && !difference.here.is_empty(), "{difference:?}");
            assert!(!difference.here.ends_with('.') && !difference.original.ends_with('.'), "{difference:?}");
        }
    }
}
