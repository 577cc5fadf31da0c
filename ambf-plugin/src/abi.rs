//! The C interface between the host and a shared library: plain data and tables of functions, nothing else.
//!
//! Everything here has a twin in `resources/plugins/ambf_plugin.h`; `tests.rs` compares them. Texts are UTF-8 without a
//! terminating zero. A change of any item is a new [`ABI_VERSION`].

use std::ffi::c_void;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Version of this interface, which libraries made with it have. Version 2 has one function more, at the end of
/// [`RawHost`]: `show`.
pub const ABI_VERSION: u32 = 2;
/// The oldest version whose libraries this host can load: what has come since is at the end of the host's table, where
/// they don't look.
pub const OLDEST_ABI_VERSION: u32 = 1;

/// Status: done.
pub(crate) const DONE: i32 = 0;
/// Status: it panicked, or threw; what it said is known to the host.
pub(crate) const PANICKED: i32 = 2;
/// Status: it failed; what it said is known to the host.
pub(crate) const FAILED: i32 = 1;

/// Number of the "type" that names models where objects are named by type and index.
pub(crate) const MODEL: u32 = 100;

/// A text.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct RawText {
    /// First byte; may be null if the length is 0.
    pub data: *const u8,
    /// Bytes.
    pub length: u64,
}

impl RawText {
    /// Borrows a text for as long as the caller keeps it.
    pub(crate) fn of(text: &str) -> Self {
        Self { data: text.as_ptr(), length: text.len() as u64 }
    }

    /// The text, with what is no UTF-8 replaced.
    ///
    /// # Safety
    /// `data` points at `length` bytes, or the length is 0.
    pub(crate) unsafe fn read(self) -> String {
        // SAFETY: the caller vouches for the bytes.
        let bytes = unsafe { slice(self.data, self.length) };
        String::from_utf8_lossy(bytes.unwrap_or_default()).into_owned()
    }
}

/// Where time stands.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct RawClock {
    /// Simulated time, s.
    pub sim_time: f64,
    /// The step just made, s.
    pub dt: f64,
    /// Steps made.
    pub step: u64,
}

/// Position and orientation.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct RawPose {
    /// m.
    pub position: [f64; 3],
    /// Quaternion x, y, z, w.
    pub orientation: [f64; 4],
}

impl From<&Isometry3<f64>> for RawPose {
    fn from(pose: &Isometry3<f64>) -> Self {
        Self { position: pose.translation.vector.into(), orientation: pose.rotation.coords.into() }
    }
}

impl RawPose {
    /// The pose, if its numbers are finite and its orientation is one.
    pub(crate) fn pose(&self) -> Option<Isometry3<f64>> {
        let finite = self.position.iter().chain(&self.orientation).all(|x| x.is_finite());
        let rotation = rotation(self.orientation).filter(|_| finite)?;
        Some(Isometry3::from_parts(Translation3::from(Vector3::from(self.position)), rotation))
    }
}

/// The rotation of a quaternion x, y, z, w; `None` if it has no length.
pub(crate) fn rotation(xyzw: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let quaternion = Quaternion::from(xyzw);
    // A unit quaternion is left as it is: normalising it again would change its last bits.
    match quaternion.norm() {
        norm if (norm - 1.0).abs() < 1e-12 => Some(UnitQuaternion::new_unchecked(quaternion)),
        norm if norm > 1e-6 => Some(UnitQuaternion::new_normalize(quaternion)),
        _ => None,
    }
}

/// State of a rigid body.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct RawBody {
    /// Body frame in the world.
    pub pose: RawPose,
    /// Inertial frame in the world.
    pub inertial_pose: RawPose,
    /// Velocity of the centre of mass, m/s, world axes.
    pub linear_velocity: [f64; 3],
    /// rad/s, world axes.
    pub angular_velocity: [f64; 3],
    /// kg; 0 is static.
    pub mass: f64,
    /// Principal moments, kg·m².
    pub inertia: [f64; 3],
}

/// State of a joint.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct RawJoint {
    /// rad or m.
    pub position: f64,
    /// rad/s or m/s.
    pub velocity: f64,
    /// N·m or N.
    pub effort: f64,
    /// Lower limit, rad or m; −∞ without.
    pub lower: f64,
    /// Upper limit, rad or m; ∞ without.
    pub upper: f64,
    /// Parent body.
    pub parent: u64,
    /// Child body.
    pub child: u64,
}

/// What a ray met, or where bodies touch.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct RawTouch {
    /// Rigid body; −1 for anything else.
    pub body: i64,
    /// m, world axes.
    pub point: [f64; 3],
    /// Normal of unit length, world axes.
    pub normal: [f64; 3],
    /// Ray: share of its way, 0 to 1. Contact: m, negative where bodies overlap.
    pub distance: f64,
    /// Contact: N·s along the normal in the last sub-step. Ray: 0.
    pub impulse: f64,
}

/// A command; which fields count follows from the code.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct RawCommand {
    /// What to do.
    pub code: u32,
    /// Type of object, or of command.
    pub kind: u32,
    /// The object.
    pub index: u64,
    /// Another object.
    pub other: i64,
    /// Numbers.
    pub numbers: [f64; 8],
}

/// A key, a button or the pointer of a window.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct RawInput {
    /// 0 key, 1 button, 2 position, 3 scroll.
    pub code: u32,
    /// Window.
    pub window: u32,
    /// Key or button, scan code, action, modifiers.
    pub values: [i32; 4],
    /// Position or scroll.
    pub x: f64,
    /// Position or scroll.
    pub y: f64,
}

/// A marker, a text or a picture in windows.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct RawDrawing {
    /// 0 sphere, 1 box, 2 arrow, 3 frame, 4 points, 5 lines; 6 text in pixels, 7 in shares of the window, 8 in the
    /// scene; 9, 10, 11 the same of pictures.
    pub shape: u32,
    /// Number of the window from 1; 0: all.
    pub window: u32,
    /// In the world; all zeros: the world's frame.
    pub pose: RawPose,
    /// Sphere: radius. Box: edges. Arrow: length, radius. Frame: length. Points: pixels. Texts: x, y, pixels of a line.
    /// Pictures: x, y, height in pixels.
    pub numbers: [f64; 3],
    /// Red, green, blue, alpha, 0 to 1.
    pub color: [f32; 4],
    /// Colour behind a text; alpha 0: none.
    pub panel: [f32; 4],
    /// Coordinates of points and lines, m.
    pub points: *const [f64; 3],
    /// How many.
    pub point_count: u64,
    /// What a text says.
    pub text: RawText,
    /// Pixels of a picture: red, green, blue, alpha, top row first.
    pub pixels: *const [u8; 4],
    /// Pixels of a picture from left to right.
    pub width: u32,
    /// Pixels of a picture from top to bottom.
    pub height: u32,
    /// Place of a picture: 1 behind the scene, else before it.
    pub behind: u32,
}

impl Default for RawDrawing {
    fn default() -> Self {
        Self {
            shape: 0,
            window: 0,
            pose: RawPose::default(),
            numbers: [0.0; 3],
            color: [0.0; 4],
            panel: [0.0; 4],
            points: std::ptr::null(),
            point_count: 0,
            text: RawText { data: std::ptr::null(), length: 0 },
            pixels: std::ptr::null(),
            width: 0,
            height: 0,
            behind: 0,
        }
    }
}

/// What a plugin gets at its start.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct RawInit {
    /// Name given to the plugin.
    pub handle: RawText,
    /// YAML of the declaring node.
    pub node: RawText,
    /// Directory of the declaring file.
    pub directory: RawText,
    /// Words of the command line.
    pub arguments: *const RawText,
    /// How many.
    pub argument_count: u64,
    /// Kind of the plugin: 0 simulator, 1 world, 2 model, 3 object.
    pub kind: u32,
    /// Type of the object.
    pub object_kind: u32,
    /// Model or object.
    pub index: u64,
}

/// What the host offers. Those marked "now" work only in a callback that physics makes, in its thread; the others in
/// any thread as long as the plugin lives. A negative result says that there is no such object (−1), or what is wrong
/// (see `CommandError`).
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct RawHost {
    /// Given back to each function.
    pub context: *const c_void,
    /// Writes a line to the log.
    pub say: unsafe extern "C" fn(context: *const c_void, text: RawText),
    /// Explains the failure that the callback is about to return.
    pub fail: unsafe extern "C" fn(context: *const c_void, text: RawText),
    /// Leaves a command for the next iteration.
    pub post: unsafe extern "C" fn(context: *const c_void, command: *const RawCommand) -> i64,
    /// The newest states, as many as there is place for; the number of bodies and joints goes to `counts`. 0: there are
    /// none yet.
    pub snapshot: unsafe extern "C" fn(
        context: *const c_void,
        clock: *mut RawClock,
        bodies: *mut RawBody,
        body_capacity: u64,
        joints: *mut RawJoint,
        joint_capacity: u64,
        counts: *mut [u64; 2],
    ) -> i32,
    /// Now: the time.
    pub clock: unsafe extern "C" fn(context: *const c_void, out: *mut RawClock) -> i32,
    /// Now: how many objects of a type there ever were.
    pub count: unsafe extern "C" fn(context: *const c_void, kind: u32) -> i64,
    /// Now: the object that a text names.
    pub find: unsafe extern "C" fn(context: *const c_void, kind: u32, text: RawText) -> i64,
    /// Now: name (0), identifier (1) or file (2, of models) of an object, cut to the capacity; the result is its whole
    /// length.
    pub text: unsafe extern "C" fn(
        context: *const c_void,
        what: u32,
        kind: u32,
        index: u64,
        out: *mut u8,
        capacity: u64,
    ) -> i64,
    /// Now: model of an object.
    pub model_of: unsafe extern "C" fn(context: *const c_void, kind: u32, index: u64) -> i64,
    /// Now: state of a body.
    pub body: unsafe extern "C" fn(context: *const c_void, index: u64, out: *mut RawBody) -> i32,
    /// Now: state of a joint.
    pub joint: unsafe extern "C" fn(context: *const c_void, index: u64, out: *mut RawJoint) -> i32,
    /// Now: pose of an object in the world.
    pub pose: unsafe extern "C" fn(context: *const c_void, kind: u32, index: u64, out: *mut RawPose) -> i32,
    /// Now: numbers of an object, as many as there is place for; the result is how many there are. Sensor: a
    /// measurement a ray or contact. Ghost object: the bodies in it. Soft body: x, y, z of each node. Actuator: whether
    /// it holds something.
    pub values:
        unsafe extern "C" fn(context: *const c_void, kind: u32, index: u64, out: *mut f64, capacity: u64) -> i64,
    /// Now: the closest hit of a ray; 0: none.
    pub cast_ray: unsafe extern "C" fn(
        context: *const c_void,
        from: *const [f64; 3],
        to: *const [f64; 3],
        out: *mut RawTouch,
    ) -> i32,
    /// Now: contacts of a body, as many as there is place for; the result is how many there are.
    pub contacts: unsafe extern "C" fn(context: *const c_void, body: u64, out: *mut RawTouch, capacity: u64) -> i64,
    /// Now: executes a command. The result of attaching is a number to detach by, of others 0.
    pub execute: unsafe extern "C" fn(context: *const c_void, command: *const RawCommand) -> i64,
    /// Since version 2, in any thread: shows these markers and texts in windows instead of those that the plugin has
    /// shown before. 0, or what is wrong: nothing has changed then.
    pub show: unsafe extern "C" fn(context: *const c_void, drawings: *const RawDrawing, count: u64) -> i64,
}

/// A plugin. A function that is null does nothing. Each returns 0, 1 if it failed or 2 if it panicked; nothing else may
/// come out of it.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct RawPlugin {
    /// Given back to each function.
    pub instance: *mut c_void,
    /// Starts.
    pub init: Option<unsafe extern "C" fn(instance: *mut c_void, init: *const RawInit) -> i32>,
    /// After each step; `dt` in s.
    pub physics_update: Option<unsafe extern "C" fn(instance: *mut c_void, dt: f64) -> i32>,
    /// After each picture.
    pub graphics_update: Option<unsafe extern "C" fn(instance: *mut c_void) -> i32>,
    /// After a reset.
    pub reset: Option<unsafe extern "C" fn(instance: *mut c_void) -> i32>,
    /// A model is there (`added` 1) or is about to leave (0).
    pub model_changed: Option<unsafe extern "C" fn(instance: *mut c_void, added: u32, model: u64) -> i32>,
    /// An object is there or is about to leave.
    pub object_changed: Option<unsafe extern "C" fn(instance: *mut c_void, added: u32, kind: u32, index: u64) -> i32>,
    /// A window was used.
    pub input: Option<unsafe extern "C" fn(instance: *mut c_void, input: *const RawInput) -> i32>,
    /// Ends; called once, and only after a successful start.
    pub close: Option<unsafe extern "C" fn(instance: *mut c_void) -> i32>,
    /// Frees the plugin and this table; called last.
    pub destroy: Option<unsafe extern "C" fn(plugin: *mut RawPlugin)>,
}

/// Type of the exported function `ambf_plugin_abi_version`.
pub type VersionFn = unsafe extern "C" fn() -> u32;
/// Type of the exported function `ambf_plugin_create`: `kind` as in [`RawInit`]; null: there is no plugin of that kind,
/// or it failed.
pub type CreateFn = unsafe extern "C" fn(kind: u32, host: *const RawHost) -> *mut RawPlugin;

/// What a pointer and a number of elements describe; `None` if the pointer is null although there are some.
///
/// # Safety
/// `data` points at `count` elements that live for `'a`, or is null, or the count is 0.
pub(crate) unsafe fn slice<'a, T>(data: *const T, count: u64) -> Option<&'a [T]> {
    match count {
        0 => Some(&[]),
        _ if data.is_null() => None,
        // SAFETY: the caller vouches for it.
        _ => Some(unsafe { std::slice::from_raw_parts(data, count as usize) }),
    }
}

/// Copies as much of `from` as `to` has place for.
///
/// # Safety
/// `to` points at `capacity` elements, or the capacity is 0.
pub(crate) unsafe fn copy_out<T: Copy>(from: &[T], to: *mut T, capacity: u64) {
    let n = from.len().min(capacity as usize);
    if n > 0 && !to.is_null() {
        // SAFETY: n elements are there on both sides; the caller's memory is not ours.
        unsafe { std::ptr::copy_nonoverlapping(from.as_ptr(), to, n) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_crosses_bit_for_bit() {
        let pose = Isometry3::from_parts(
            Translation3::new(0.1, -2.0, 3e-9),
            UnitQuaternion::from_euler_angles(0.3, 0.2, -3.0),
        );
        assert_eq!(RawPose::from(&pose).pose(), Some(pose));
        let long = RawPose { position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 4.0] };
        assert_eq!(long.pose(), Some(Isometry3::identity()));
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        assert_eq!(RawPose::default().pose(), None, "no orientation");
        let nan = RawPose { position: [f64::NAN, 0.0, 0.0], orientation: [0.0, 0.0, 0.0, 1.0] };
        assert_eq!(nan.pose(), None);
        let infinite = RawPose { position: [0.0; 3], orientation: [f64::INFINITY, 0.0, 0.0, 1.0] };
        assert_eq!(infinite.pose(), None);
    }
}
