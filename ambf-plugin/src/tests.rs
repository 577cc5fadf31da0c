//! `resources/plugins/ambf_plugin.h` says the same as the definitions in Rust: the size and place of each field, and
//! each number. Parameters of functions are not compared.

use std::fmt::Write;
use std::mem::offset_of;
use std::path::Path;
use std::process::Command as Process;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use crate::abi::*;
use crate::driver_abi::*;
use crate::{
    Command, CommandError, Drawing, DrawingShape, JointCommandType, ObjectId, ObjectType, Pixels, PluginKind, TextPlace,
};

/// Appends checks of a structure of the header: its size, and place and size of each field. All fields have to be
/// named.
macro_rules! compare {
    ($out:ident, $($name:ident = $raw:ident { $($field:ident),* })*) => {$(
        let _ = |$raw { $($field: _),* }: $raw| ();
        check(&mut $out, concat!("sizeof(", stringify!($name), ")"), size_of::<$raw>());
        $(
            let field = concat!(stringify!($name), ", ", stringify!($field));
            check(&mut $out, &format!("offsetof({field})"), offset_of!($raw, $field));
            let field = concat!("sizeof(((", stringify!($name), " *)0)->", stringify!($field), ")");
            check(&mut $out, field, size_of_field(|raw: &$raw| &raw.$field));
        )*
    )*};
}

fn size_of_field<T, F>(_: impl Fn(&T) -> &F) -> usize {
    size_of::<F>()
}

fn check(out: &mut String, what: &str, value: impl std::fmt::Display) {
    writeln!(out, "static_assert({what} == {value}, \"{what} is {value}\");").unwrap();
}

#[test]
fn the_header_says_what_the_definitions_say() {
    let mut out = String::from("#include <assert.h>\n#include <stddef.h>\n#include \"ambf_plugin.h\"\n");
    compare! { out,
        ambf_text = RawText { data, length }
        ambf_clock = RawClock { sim_time, dt, step }
        ambf_pose = RawPose { position, orientation }
        ambf_body = RawBody { pose, inertial_pose, linear_velocity, angular_velocity, mass, inertia }
        ambf_joint = RawJoint { position, velocity, effort, lower, upper, parent, child }
        ambf_touch = RawTouch { body, point, normal, distance, impulse }
        ambf_command = RawCommand { code, kind, index, other, numbers }
        ambf_input = RawInput { code, window, values, x, y }
        ambf_drawing = RawDrawing {
            shape, window, pose, numbers, color, panel, points, point_count, text, pixels, width, height, behind
        }
        ambf_init = RawInit { handle, node, directory, arguments, argument_count, kind, object_kind, index }
        ambf_host = RawHost {
            context, say, fail, post, snapshot, clock, count, find, text, model_of, body, joint, pose, values, cast_ray,
            contacts, execute, show
        }
        ambf_plugin = RawPlugin {
            instance, init, physics_update, graphics_update, reset, model_changed, object_changed, input, close, destroy
        }
        ambf_answer = RawAnswer { context, fail, found }
        ambf_log = RawLog { context, say }
        ambf_setting = RawSetting { key, value, place }
        ambf_settings = RawSettings { entries, count, directory }
        ambf_spec = RawSpec {
            model, manufacturer, max_force, max_stiffness, max_damping, workspace_radius, gripper_max_angle,
            start_up_hold, sensed, actuated, hands
        }
        ambf_sample = RawSample {
            age, sequence, position, rotation, linear_velocity, angular_velocity, gripper, buttons, flags
        }
        ambf_force = RawForce { force, torque, gripper }
        ambf_device = RawDevice { instance, spec, read, write, close, destroy }
        ambf_driver = RawDriver { instance, name, serves, find, open }
    }

    check(&mut out, "AMBF_PLUGIN_ABI_VERSION", ABI_VERSION);
    for (name, status) in [("DONE", DONE), ("FAILED", FAILED), ("PANICKED", PANICKED)] {
        check(&mut out, &format!("AMBF_{name}"), status);
    }
    for (name, kind) in [
        ("SIMULATOR", PluginKind::Simulator),
        ("WORLD", PluginKind::World),
        ("MODEL_PLUGIN", PluginKind::Model),
        ("OBJECT", PluginKind::Object),
    ] {
        check(&mut out, &format!("AMBF_{name}"), kind as u32);
    }
    for kind in ObjectType::ALL {
        // `SoftBody` is AMBF_SOFT_BODY.
        let mut name = "AMBF".to_owned();
        for letter in format!("{kind:?}").chars() {
            name.extend(letter.is_uppercase().then_some('_'));
            name.push(letter.to_ascii_uppercase());
        }
        check(&mut out, &name, kind as u32);
    }
    check(&mut out, "AMBF_MODEL", MODEL);
    let errors = ["NO_OBJECT", "NOT_FINITE", "REFUSED", "OUTSIDE", "FULL", "UNKNOWN", "TOO_MUCH"];
    for (name, error) in errors.into_iter().zip(CommandError::ALL) {
        check(&mut out, &format!("AMBF_{name}"), error.status());
    }

    let (zero, pose) = (Vector3::zeros(), Isometry3::identity());
    let light = ObjectId::new(ObjectType::Light, 0);
    for (name, command) in [
        ("WRENCH", Command::Wrench { body: 0, force: zero, torque: zero }),
        ("VELOCITY", Command::Velocity { body: 0, linear: zero, angular: zero }),
        ("POSE", Command::Pose { body: 0, pose }),
        ("FOLLOW_POSE", Command::FollowPose { body: 0, pose }),
        ("JOINT_COMMAND", Command::Joint { joint: 0, kind: JointCommandType::Effort, value: 0.0 }),
        ("PLACE", Command::Place { object: light, pose }),
        ("HOLD", Command::Hold { actuator: 0, body: None }),
        ("DRIVE", Command::Drive { vehicle: 0, wheel: 0, steering: 0.0, power: 0.0, brake: 0.0 }),
        ("SOFT_FORCE", Command::SoftForce { soft: 0, force: zero }),
        ("PULL_NODE", Command::PullNode { soft: 0, node: 0, goal: None }),
        ("ATTACH", Command::Attach { body: 0, to: 1 }),
        ("DETACH", Command::Detach { attachment: 0 }),
        ("RESET_WORLD", Command::ResetWorld),
        ("RESET_BODIES", Command::ResetBodies),
        ("PAUSE", Command::Pause(true)),
        ("STEP", Command::Step(1)),
    ] {
        check(&mut out, &format!("AMBF_{name}"), command.raw().code);
    }
    let places = [TextPlace::Pixels(0.0, 0.0), TextPlace::Share(0.0, 0.0), TextPlace::Scene];
    let pixels = Arc::new(Pixels::new(1, 1, vec![[0; 4]]).unwrap());
    let mut shapes = vec![
        ("SPHERE", DrawingShape::Sphere(1.0)),
        ("BOX", DrawingShape::Box([1.0; 3])),
        ("ARROW", DrawingShape::Arrow(1.0, 0.1)),
        ("FRAME", DrawingShape::Frame(1.0)),
        ("POINTS", DrawingShape::Points(Vec::new(), 1.0)),
        ("LINES", DrawingShape::Lines(Vec::new())),
    ];
    for (name, place) in ["TEXT_PIXELS", "TEXT_SHARE", "TEXT_SCENE"].into_iter().zip(places) {
        shapes.push((name, Drawing::text("", place).shape));
    }
    for (name, place) in ["PICTURE_PIXELS", "PICTURE_SHARE", "PICTURE_SCENE"].into_iter().zip(places) {
        let pixels = Arc::clone(&pixels);
        shapes.push((name, DrawingShape::Picture { pixels, place, height: 0.0, is_behind: false }));
    }
    for (name, shape) in shapes {
        let drawing = Drawing::new(shape, pose, [1.0; 4]);
        check(&mut out, &format!("AMBF_SHOW_{name}"), drawing.raw(&mut Vec::new()).shape);
    }

    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/plugins");
    let source = std::env::temp_dir().join(format!("ambf_plugin_header_{}.c", std::process::id()));
    std::fs::write(&source, out).unwrap();
    for language in [["-std=c11", "-xc"], ["-std=c++17", "-xc++"]] {
        let mut compiler = Process::new("cc");
        compiler.args(language).args(["-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-I"]).args([&folder, &source]);
        let output = compiler.output().expect("the C compiler that the simulator is built with");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    std::fs::remove_file(&source).unwrap();
}
