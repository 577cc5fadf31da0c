//! Plugins in shared libraries, as their authors see them: the C interface around the traits. This part runs in the
//! library.

use std::any::Any;
use std::ffi::c_void;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::abi::{
    RawBody, RawClock, RawDrawing, RawHost, RawInit, RawInput, RawJoint, RawPlugin, RawPose, RawText, RawTouch, DONE,
    FAILED, MODEL, PANICKED,
};
use super::traits::{Host, Services};
use super::view::{Access, TextOf};
use super::{
    AnyPlugin, BodyState, Clock, Command, CommandError, Drawing, Hit, InitContext, Input, JointState, PluginError,
    PluginKind, StateSnapshot, Subject, Touch, View,
};
use crate::{ObjectId, ObjectType};

/// Makes a shared library of plugins: the crate's type is `cdylib`, and this stands in it once.
///
/// ```
/// use ambf_plugin::{Plugin, SimulatorPlugin, View};
///
/// #[derive(Default)]
/// struct Counter(u64);
///
/// impl Plugin for Counter {
///     fn physics_update(&mut self, world: &mut View<'_>, _dt: f64) {
///         self.0 = world.clock().step;
///     }
/// }
///
/// impl SimulatorPlugin for Counter {}
///
/// ambf_plugin::export_plugin! { simulator: Counter }
/// ```
///
/// The kinds are `simulator`, `world`, `model` and `object`; a library has at most one plugin of each. The types
/// implement [`Default`]: a plugin is made from that, and learns the rest in its `init`.
#[macro_export]
macro_rules! export_plugin {
    ($($kind:ident: $plugin:ty),+ $(,)?) => {
        /// Version of the plugin interface that this library was made for.
        #[unsafe(no_mangle)]
        pub extern "C" fn ambf_plugin_abi_version() -> u32 {
            $crate::abi::ABI_VERSION
        }

        /// Makes a plugin; null for a kind that this library does not have.
        ///
        /// # Safety
        /// `host` is a table of the version above that lives as long as the plugin.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn ambf_plugin_create(
            kind: u32,
            host: *const $crate::abi::RawHost,
        ) -> *mut $crate::abi::RawPlugin {
            let make = |wanted: $crate::PluginKind| {
                $(
                    if let Some(plugin) = $crate::__plugin_of_kind!(wanted, $kind, $plugin) {
                        return Some(plugin);
                    }
                )+
                None
            };
            // SAFETY: the caller vouches for `host`.
            unsafe { $crate::export(kind, host, make) }
        }
    };
}

/// One kind of [`export_plugin!`].
#[doc(hidden)]
#[macro_export]
macro_rules! __plugin_of_kind {
    ($wanted:ident, simulator, $plugin:ty) => {
        $crate::__plugin_of_kind!($wanted, Simulator: $plugin)
    };
    ($wanted:ident, world, $plugin:ty) => {
        $crate::__plugin_of_kind!($wanted, World: $plugin)
    };
    ($wanted:ident, model, $plugin:ty) => {
        $crate::__plugin_of_kind!($wanted, Model: $plugin)
    };
    ($wanted:ident, object, $plugin:ty) => {
        $crate::__plugin_of_kind!($wanted, Object: $plugin)
    };
    ($wanted:ident, $variant:ident: $plugin:ty) => {
        ($wanted == $crate::PluginKind::$variant)
            .then(|| $crate::AnyPlugin::$variant(Box::new(<$plugin as Default>::default())))
    };
}

/// The part of [`export_plugin!`](crate::export_plugin) that is the same in all libraries.
///
/// # Safety
/// `host` is null or a table of this version that lives as long as the plugin.
#[doc(hidden)]
pub unsafe fn export(
    kind: u32,
    host: *const RawHost,
    make: impl FnOnce(PluginKind) -> Option<AnyPlugin>,
) -> *mut RawPlugin {
    // SAFETY: the caller vouches for it.
    let (Some(host), Some(kind)) = (unsafe { host.as_ref() }, PluginKind::from_number(kind)) else {
        return std::ptr::null_mut();
    };
    let remote = Remote(*host);
    let plugin = match catch_unwind(AssertUnwindSafe(|| make(kind))) {
        Ok(Some(plugin)) => plugin,
        Ok(None) => return std::ptr::null_mut(),
        Err(panic) => {
            remote.fail(&format!("it panicked: {}", message_of(panic)));
            return std::ptr::null_mut();
        }
    };
    let instance = Box::new(Instance { plugin, remote, subject: Subject::Simulator });
    Box::into_raw(Box::new(RawPlugin {
        instance: Box::into_raw(instance).cast(),
        init: Some(init),
        physics_update: Some(physics_update),
        graphics_update: Some(graphics_update),
        reset: Some(reset),
        model_changed: Some(model_changed),
        object_changed: Some(object_changed),
        input: Some(input),
        close: Some(close),
        destroy: Some(destroy),
    }))
}

/// What a panic said.
pub(crate) fn message_of(panic: Box<dyn Any + Send>) -> String {
    let text = match panic.downcast_ref::<&str>() {
        Some(text) => (*text).to_owned(),
        None => panic.downcast_ref::<String>().cloned().unwrap_or_else(|| "something that is no text".to_owned()),
    };
    // Dropping it could panic again.
    std::mem::forget(panic);
    text
}

struct Instance {
    plugin: AnyPlugin,
    remote: Remote,
    subject: Subject,
}

/// Calls `work`; what it panics with is told to the host.
///
/// # Safety
/// `instance` comes from [`export`], is alive, and is used by nobody else now.
unsafe fn guarded(instance: *mut c_void, work: impl FnOnce(&mut Instance) -> i32) -> i32 {
    // SAFETY: the caller vouches for it.
    let instance = unsafe { &mut *instance.cast::<Instance>() };
    let remote = instance.remote;
    match catch_unwind(AssertUnwindSafe(|| work(instance))) {
        Ok(status) => status,
        Err(panic) => {
            remote.fail(&message_of(panic));
            PANICKED
        }
    }
}

impl Instance {
    /// Calls the plugin with the simulation.
    fn with_world(&mut self, call: impl FnOnce(&mut AnyPlugin, &mut View<'_>)) -> i32 {
        let mut remote = self.remote;
        call(&mut self.plugin, &mut View::new(&mut remote, self.subject));
        DONE
    }
}

unsafe extern "C" fn init(instance: *mut c_void, raw: *const RawInit) -> i32 {
    let start = |instance: &mut Instance| {
        // SAFETY: the host gives a structure whose pointers live until this returns.
        let (raw, arguments) = unsafe {
            let raw = &*raw;
            let words: &[RawText] = match raw.argument_count {
                0 => &[],
                n => std::slice::from_raw_parts(raw.arguments, n as usize),
            };
            (raw, words.iter().map(|word| word.read()).collect::<Vec<_>>())
        };
        instance.subject = match (PluginKind::from_number(raw.kind), ObjectType::from_number(raw.object_kind)) {
            (Some(PluginKind::Object), Some(kind)) => Subject::Object(ObjectId { kind, index: raw.index as usize }),
            (Some(PluginKind::Model), _) => Subject::Model(raw.index as usize),
            (Some(PluginKind::World), _) => Subject::World,
            _ => Subject::Simulator,
        };
        let mut remote = instance.remote;
        // SAFETY: as above.
        let (handle, node, directory) = unsafe { (raw.handle.read(), raw.node.read(), raw.directory.read()) };
        let mut context = InitContext {
            world: View::new(&mut remote, instance.subject),
            host: Host(Arc::new(instance.remote)),
            handle,
            node,
            directory: PathBuf::from(directory),
            arguments,
        };
        match instance.plugin.common().init(&mut context) {
            Ok(()) => DONE,
            Err(error) => {
                let said = match error {
                    PluginError::Init(said) => said,
                    other => other.to_string(),
                };
                instance.remote.fail(&said);
                FAILED
            }
        }
    };
    // SAFETY: the host calls a plugin that is alive, from one thread at a time.
    unsafe { guarded(instance, start) }
}

unsafe extern "C" fn physics_update(instance: *mut c_void, dt: f64) -> i32 {
    let call = |instance: &mut Instance| instance.with_world(|plugin, world| plugin.common().physics_update(world, dt));
    // SAFETY: as in `init`.
    unsafe { guarded(instance, call) }
}

unsafe extern "C" fn graphics_update(instance: *mut c_void) -> i32 {
    let call = |instance: &mut Instance| {
        instance.plugin.common().graphics_update();
        DONE
    };
    // SAFETY: as in `init`.
    unsafe { guarded(instance, call) }
}

unsafe extern "C" fn reset(instance: *mut c_void) -> i32 {
    let call = |instance: &mut Instance| instance.with_world(|plugin, world| plugin.common().reset(world));
    // SAFETY: as in `init`.
    unsafe { guarded(instance, call) }
}

unsafe extern "C" fn model_changed(instance: *mut c_void, added: u32, model: u64) -> i32 {
    let call = |instance: &mut Instance| {
        instance.with_world(|plugin, world| plugin.model_changed(world, added != 0, model as usize))
    };
    // SAFETY: as in `init`.
    unsafe { guarded(instance, call) }
}

unsafe extern "C" fn object_changed(instance: *mut c_void, added: u32, kind: u32, index: u64) -> i32 {
    let call = |instance: &mut Instance| {
        let Some(kind) = ObjectType::from_number(kind) else { return DONE };
        let object = ObjectId { kind, index: index as usize };
        instance.with_world(|plugin, world| plugin.object_changed(world, added != 0, object))
    };
    // SAFETY: as in `init`.
    unsafe { guarded(instance, call) }
}

unsafe extern "C" fn input(instance: *mut c_void, raw: *const RawInput) -> i32 {
    let call = |instance: &mut Instance| {
        // SAFETY: the host gives a structure that lives until this returns.
        let RawInput { code, window, values: [first, scancode, action, mods], x, y } = unsafe { *raw };
        instance.plugin.input(&match code {
            0 => Input::Key { window, key: first, scancode, action, mods },
            1 => Input::Button { window, button: first, action, mods },
            2 => Input::Position { window, x, y },
            _ => Input::Scroll { window, x, y },
        });
        DONE
    };
    // SAFETY: as in `init`.
    unsafe { guarded(instance, call) }
}

unsafe extern "C" fn close(instance: *mut c_void) -> i32 {
    let call = |instance: &mut Instance| {
        instance.plugin.common().close();
        DONE
    };
    // SAFETY: as in `init`.
    unsafe { guarded(instance, call) }
}

unsafe extern "C" fn destroy(plugin: *mut RawPlugin) {
    // SAFETY: both boxes come from `export`; the host calls this once, last.
    let instance = unsafe { Box::from_raw(Box::from_raw(plugin).instance.cast::<Instance>()) };
    let remote = instance.remote;
    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| drop(instance))) {
        remote.say(&format!("it panicked when it was dropped: {}", message_of(panic)));
    }
}

/// The host through its table.
#[derive(Clone, Copy)]
pub(super) struct Remote(pub RawHost);

// SAFETY: the host's functions may be called from any thread: those that need the simulation refuse in all threads but
// its own.
unsafe impl Send for Remote {}
// SAFETY: as above.
unsafe impl Sync for Remote {}

impl Remote {
    pub fn fail(&self, text: &str) {
        // SAFETY: the table is alive, the text until the call returns.
        unsafe { (self.0.fail)(self.0.context, RawText::of(text)) }
    }
}

fn number_of(kind: Option<ObjectType>) -> u32 {
    kind.map_or(MODEL, |kind| kind as u32)
}

fn found(status: i64) -> Option<usize> {
    usize::try_from(status).ok()
}

impl Services for Remote {
    fn say(&self, text: &str) {
        // SAFETY: the table is alive, the text until the call returns.
        unsafe { (self.0.say)(self.0.context, RawText::of(text)) }
    }

    fn post(&self, command: &Command) -> Result<(), CommandError> {
        // SAFETY: the table is alive, the command until the call returns.
        match unsafe { (self.0.post)(self.0.context, &command.raw()) } {
            status if status < 0 => Err(CommandError::of_status(status)),
            _ => Ok(()),
        }
    }

    fn snapshot(&self, out: &mut StateSnapshot) -> bool {
        let mut clock = RawClock::default();
        let mut counts = [0; 2];
        let mut bodies = vec![RawBody::default(); out.bodies.len()];
        let mut joints = vec![RawJoint::default(); out.joints.len()];
        loop {
            // SAFETY: the table is alive; each array has the length that is given.
            let there = unsafe {
                (self.0.snapshot)(
                    self.0.context,
                    &mut clock,
                    bodies.as_mut_ptr(),
                    bodies.len() as u64,
                    joints.as_mut_ptr(),
                    joints.len() as u64,
                    &mut counts,
                )
            };
            if there == 0 {
                return false;
            }
            let (n_bodies, n_joints) = (counts[0] as usize, counts[1] as usize);
            let fits = n_bodies <= bodies.len() && n_joints <= joints.len();
            bodies.resize(n_bodies, RawBody::default());
            joints.resize(n_joints, RawJoint::default());
            if fits {
                break;
            }
        }
        out.clock = clock.into();
        out.bodies.clear();
        out.bodies.extend(bodies.iter().map(BodyState::from));
        out.joints.clear();
        out.joints.extend(joints.iter().map(JointState::from));
        true
    }

    fn show(&self, drawings: &[Drawing]) -> Result<(), CommandError> {
        let mut points = vec![Vec::new(); drawings.len()];
        let raw: Vec<RawDrawing> =
            drawings.iter().zip(&mut points).map(|(drawing, points)| drawing.raw(points)).collect();
        // SAFETY: the table is alive, all that the drawings point at until the call returns. A library of this version
        // is loaded by hosts that have this function only.
        match unsafe { (self.0.show)(self.0.context, raw.as_ptr(), raw.len() as u64) } {
            status if status < 0 => Err(CommandError::of_status(status)),
            _ => Ok(()),
        }
    }
}

impl Access for Remote {
    fn clock(&self) -> Clock {
        let mut raw = RawClock::default();
        // SAFETY: the table is alive; `raw` is ours.
        unsafe { (self.0.clock)(self.0.context, &mut raw) };
        raw.into()
    }

    fn count(&self, kind: Option<ObjectType>) -> usize {
        // SAFETY: the table is alive.
        found(unsafe { (self.0.count)(self.0.context, number_of(kind)) }).unwrap_or(0)
    }

    fn find(&self, kind: Option<ObjectType>, text: &str) -> Option<usize> {
        // SAFETY: the table is alive, the text until the call returns.
        found(unsafe { (self.0.find)(self.0.context, number_of(kind), RawText::of(text)) })
    }

    fn text(&self, what: TextOf, kind: Option<ObjectType>, index: usize) -> Option<String> {
        let what = match what {
            TextOf::Name => 0,
            TextOf::Identifier => 1,
            TextOf::File => 2,
        };
        let mut bytes = vec![0; 128];
        loop {
            let (out, capacity) = (bytes.as_mut_ptr(), bytes.len() as u64);
            // SAFETY: the table is alive; `bytes` has that capacity.
            let length =
                found(unsafe { (self.0.text)(self.0.context, what, number_of(kind), index as u64, out, capacity) })?;
            let fits = length <= bytes.len();
            bytes.resize(length, 0);
            if fits {
                return Some(String::from_utf8_lossy(&bytes).into_owned());
            }
        }
    }

    fn model_of(&self, object: ObjectId) -> Option<usize> {
        // SAFETY: the table is alive.
        found(unsafe { (self.0.model_of)(self.0.context, object.kind as u32, object.index as u64) })
    }

    fn body(&self, index: usize) -> Option<BodyState> {
        let mut raw = RawBody::default();
        // SAFETY: the table is alive; `raw` is ours.
        let status = unsafe { (self.0.body)(self.0.context, index as u64, &mut raw) };
        (status == 0).then(|| BodyState::from(&raw))
    }

    fn joint(&self, index: usize) -> Option<JointState> {
        let mut raw = RawJoint::default();
        // SAFETY: the table is alive; `raw` is ours.
        let status = unsafe { (self.0.joint)(self.0.context, index as u64, &mut raw) };
        (status == 0).then(|| JointState::from(&raw))
    }

    fn pose(&self, object: ObjectId) -> Option<Isometry3<f64>> {
        let mut raw = RawPose::default();
        // SAFETY: the table is alive; `raw` is ours.
        let status = unsafe { (self.0.pose)(self.0.context, object.kind as u32, object.index as u64, &mut raw) };
        if status == 0 {
            raw.pose()
        } else {
            None
        }
    }

    fn values(&self, object: ObjectId, out: &mut Vec<f64>) -> Option<()> {
        let begin = out.len();
        // As much as is there already: asked for once more it fits.
        out.resize(out.capacity().max(begin + 16), 0.0);
        loop {
            let place = &mut out[begin..];
            let (data, capacity) = (place.as_mut_ptr(), place.len() as u64);
            // SAFETY: the table is alive; the place has that capacity.
            let status =
                unsafe { (self.0.values)(self.0.context, object.kind as u32, object.index as u64, data, capacity) };
            let Some(n) = found(status) else {
                out.truncate(begin);
                return None;
            };
            let fits = n <= out.len() - begin;
            out.resize(begin + n, 0.0);
            if fits {
                return Some(());
            }
        }
    }

    fn cast_ray(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Hit> {
        let (from, to): ([f64; 3], [f64; 3]) = ((*from).into(), (*to).into());
        let mut raw = RawTouch::default();
        // SAFETY: the table is alive; all pointers are to our own.
        let status = unsafe { (self.0.cast_ray)(self.0.context, &from, &to, &mut raw) };
        (status == 1).then(|| Hit::from(&raw))
    }

    fn contacts(&self, body: usize, out: &mut Vec<Touch>) -> Option<()> {
        let mut raw = vec![RawTouch::default(); 16];
        loop {
            let (data, capacity) = (raw.as_mut_ptr(), raw.len() as u64);
            // SAFETY: the table is alive; `raw` has that capacity.
            let n = found(unsafe { (self.0.contacts)(self.0.context, body as u64, data, capacity) })?;
            let fits = n <= raw.len();
            raw.resize(n, RawTouch::default());
            if fits {
                out.extend(raw.iter().map(Touch::from));
                return Some(());
            }
        }
    }

    fn execute(&mut self, command: &Command) -> Result<u64, CommandError> {
        // SAFETY: the table is alive, the command until the call returns.
        let status = unsafe { (self.0.execute)(self.0.context, &command.raw()) };
        u64::try_from(status).map_err(|_| CommandError::of_status(status))
    }
}
