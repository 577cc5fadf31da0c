//! Plugins in shared libraries, as their authors see them: the C interface around the traits. This part runs in the
//! library.

use std::ffi::c_void;
use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::abi::{
    slice, RawBody, RawClock, RawDrawing, RawHost, RawInit, RawInput, RawJoint, RawPlugin, RawPose, RawText, RawTouch,
    DONE, FAILED, MODEL, PANICKED,
};
use super::command::of_status;
use super::traits::{Host, Services};
use super::view::{Access, TextOf};
use super::{
    AnyPlugin, BodyState, Clock, Command, CommandError, Drawing, Hit, InitContext, Input, JointState, PluginError,
    PluginKind, StateSnapshot, Subject, Touch, View,
};
use crate::{ObjectId, ObjectType};
use ambf_device::caught;

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
        $crate::__export_version! {}

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

/// What libraries of plugins and of drivers have in common.
#[doc(hidden)]
#[macro_export]
macro_rules! __export_version {
    () => {
        /// Version of the plugin interface that this library was made for.
        #[unsafe(no_mangle)]
        pub extern "C" fn ambf_plugin_abi_version() -> u32 {
            $crate::abi::ABI_VERSION
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
    let plugin = match caught(|| make(kind)) {
        Ok(Some(plugin)) => plugin,
        Ok(None) => return std::ptr::null_mut(),
        Err(panic) => {
            remote.fail(&format!("it panicked: {panic}"));
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

/// Status of `work` for the host, to whom its error or panic (`None`) is reported before.
pub(crate) fn guarded<E: ToString>(work: impl FnOnce() -> Result<(), E>, fail: impl FnOnce(Option<&E>, &str)) -> i32 {
    match caught(work) {
        Ok(Ok(())) => DONE,
        Ok(Err(error)) => {
            fail(Some(&error), &error.to_string());
            FAILED
        }
        Err(panic) => {
            fail(None, &panic);
            PANICKED
        }
    }
}

/// Frees what belongs to a plugin or device; `say` tells the host if that panics.
pub(crate) fn free<T>(value: T, say: impl FnOnce(&str)) {
    if let Err(panic) = caught(|| drop(value)) {
        say(&format!("it panicked when it was dropped: {panic}"));
    }
}

struct Instance {
    plugin: AnyPlugin,
    remote: Remote,
    subject: Subject,
}

/// Calls `work`; its error or panic is reported to the host.
///
/// # Safety
/// `instance` comes from [`export`], is alive, and is used by nobody else now.
unsafe fn with_instance(instance: *mut c_void, work: impl FnOnce(&mut Instance) -> Result<(), String>) -> i32 {
    // SAFETY: the caller vouches for it.
    let instance = unsafe { &mut *instance.cast::<Instance>() };
    let remote = instance.remote;
    guarded(|| work(instance), |_, why| remote.fail(why))
}

/// Calls a plugin without the simulation.
///
/// # Safety
/// As for [`with_instance`].
unsafe fn with_plugin(instance: *mut c_void, call: impl FnOnce(&mut AnyPlugin)) -> i32 {
    let work = |instance: &mut Instance| {
        call(&mut instance.plugin);
        Ok(())
    };
    // SAFETY: the caller vouches for it.
    unsafe { with_instance(instance, work) }
}

/// Calls a plugin with the simulation.
///
/// # Safety
/// As for [`with_instance`].
unsafe fn with_world(instance: *mut c_void, call: impl FnOnce(&mut AnyPlugin, &mut View<'_>)) -> i32 {
    let work = |instance: &mut Instance| {
        let mut remote = instance.remote;
        call(&mut instance.plugin, &mut View::new(&mut remote, instance.subject));
        Ok(())
    };
    // SAFETY: the caller vouches for it.
    unsafe { with_instance(instance, work) }
}

unsafe extern "C" fn init(instance: *mut c_void, raw: *const RawInit) -> i32 {
    let start = |instance: &mut Instance| {
        // SAFETY: the host gives a structure whose pointers live until this returns.
        let (raw, arguments) = unsafe {
            let raw = &*raw;
            let words = slice(raw.arguments, raw.argument_count).unwrap_or_default();
            (raw, words.iter().map(|word| word.read()).collect())
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
        instance.plugin.common().init(&mut context).map_err(|error| match error {
            PluginError::Init(said) => said,
            other => other.to_string(),
        })
    };
    // SAFETY: the host calls a plugin that is alive, from one thread at a time.
    unsafe { with_instance(instance, start) }
}

unsafe extern "C" fn physics_update(instance: *mut c_void, dt: f64) -> i32 {
    // SAFETY: as in `init`.
    unsafe { with_world(instance, |plugin, world| plugin.common().physics_update(world, dt)) }
}

unsafe extern "C" fn graphics_update(instance: *mut c_void) -> i32 {
    // SAFETY: as in `init`.
    unsafe { with_plugin(instance, |plugin| plugin.common().graphics_update()) }
}

unsafe extern "C" fn reset(instance: *mut c_void) -> i32 {
    // SAFETY: as in `init`.
    unsafe { with_world(instance, |plugin, world| plugin.common().reset(world)) }
}

unsafe extern "C" fn model_changed(instance: *mut c_void, added: u32, model: u64) -> i32 {
    // SAFETY: as in `init`.
    unsafe { with_world(instance, |plugin, world| plugin.model_changed(world, added != 0, model as usize)) }
}

unsafe extern "C" fn object_changed(instance: *mut c_void, added: u32, kind: u32, index: u64) -> i32 {
    let Some(kind) = ObjectType::from_number(kind) else { return DONE };
    let object = ObjectId { kind, index: index as usize };
    // SAFETY: as in `init`.
    unsafe { with_world(instance, |plugin, world| plugin.object_changed(world, added != 0, object)) }
}

unsafe extern "C" fn input(instance: *mut c_void, raw: *const RawInput) -> i32 {
    // SAFETY: the host gives a structure that lives until this returns.
    let RawInput { code, window, values: [first, scancode, action, mods], x, y } = unsafe { *raw };
    let input = match code {
        0 => Input::Key { window, key: first, scancode, action, mods },
        1 => Input::Button { window, button: first, action, mods },
        2 => Input::Position { window, x, y },
        _ => Input::Scroll { window, x, y },
    };
    // SAFETY: as in `init`.
    unsafe { with_plugin(instance, |plugin| plugin.input(&input)) }
}

unsafe extern "C" fn close(instance: *mut c_void) -> i32 {
    // SAFETY: as in `init`.
    unsafe { with_plugin(instance, |plugin| plugin.common().close()) }
}

unsafe extern "C" fn destroy(plugin: *mut RawPlugin) {
    // SAFETY: both boxes come from `export`; the host calls this once, last.
    let instance = unsafe { Box::from_raw(Box::from_raw(plugin).instance.cast::<Instance>()) };
    let remote = instance.remote;
    free(instance, |sentence| remote.say(sentence));
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

/// What `ask` writes, unless it gives back another status than 0.
fn given<T: Default>(ask: impl FnOnce(&mut T) -> i32) -> Option<T> {
    let mut raw = T::default();
    (ask(&mut raw) == 0).then_some(raw)
}

/// Appends to `out` what `ask` writes to memory for as many elements as its argument says, at first `room`; its result is how
/// many there are, or negative.
fn gathered<T: Copy + Default>(out: &mut Vec<T>, room: usize, ask: impl Fn(*mut T, u64) -> i64) -> Option<()> {
    let begin = out.len();
    // As much as is there already: asked for once more it fits.
    out.resize(out.capacity().max(begin + room), T::default());
    loop {
        let place = &mut out[begin..];
        let count = place.len();
        let Some(n) = found(ask(place.as_mut_ptr(), count as u64)) else {
            out.truncate(begin);
            return None;
        };
        out.resize(begin + n, T::default());
        if n <= count {
            return Some(());
        }
    }
}

impl Services for Remote {
    fn say(&self, text: &str) {
        // SAFETY: the table is alive, the text until the call returns.
        unsafe { (self.0.say)(self.0.context, RawText::of(text)) }
    }

    fn post(&self, command: &Command) -> Result<(), CommandError> {
        // SAFETY: the table is alive, the command until the call returns.
        of_status(unsafe { (self.0.post)(self.0.context, &command.raw()) }).map(drop)
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
        of_status(unsafe { (self.0.show)(self.0.context, raw.as_ptr(), raw.len() as u64) }).map(drop)
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
        let mut bytes = Vec::new();
        // SAFETY: the table is alive; the place has that capacity.
        gathered(&mut bytes, 128, |out, capacity| unsafe {
            (self.0.text)(self.0.context, what, number_of(kind), index as u64, out, capacity)
        })?;
        Some(String::from_utf8_lossy(&bytes).into_owned())
    }

    fn model_of(&self, object: ObjectId) -> Option<usize> {
        // SAFETY: the table is alive.
        found(unsafe { (self.0.model_of)(self.0.context, object.kind as u32, object.index as u64) })
    }

    fn body(&self, index: usize) -> Option<BodyState> {
        // SAFETY: the table is alive; `raw` is ours.
        let raw = given(|raw| unsafe { (self.0.body)(self.0.context, index as u64, raw) });
        raw.as_ref().map(BodyState::from)
    }

    fn joint(&self, index: usize) -> Option<JointState> {
        // SAFETY: the table is alive; `raw` is ours.
        let raw = given(|raw| unsafe { (self.0.joint)(self.0.context, index as u64, raw) });
        raw.as_ref().map(JointState::from)
    }

    fn pose(&self, object: ObjectId) -> Option<Isometry3<f64>> {
        let (kind, index) = (object.kind as u32, object.index as u64);
        // SAFETY: the table is alive; `raw` is ours.
        let raw: RawPose = given(|raw| unsafe { (self.0.pose)(self.0.context, kind, index, raw) })?;
        raw.pose()
    }

    fn values(&self, object: ObjectId, out: &mut Vec<f64>) -> Option<()> {
        let (kind, index) = (object.kind as u32, object.index as u64);
        // SAFETY: the table is alive; the place has that capacity.
        gathered(out, 16, |out, capacity| unsafe { (self.0.values)(self.0.context, kind, index, out, capacity) })
    }

    fn cast_ray(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Hit> {
        let (from, to): ([f64; 3], [f64; 3]) = ((*from).into(), (*to).into());
        let mut raw = RawTouch::default();
        // SAFETY: the table is alive; all pointers are to our own.
        let status = unsafe { (self.0.cast_ray)(self.0.context, &from, &to, &mut raw) };
        (status == 1).then(|| Hit::from(&raw))
    }

    fn contacts(&self, body: usize, out: &mut Vec<Touch>) -> Option<()> {
        let mut raw = Vec::new();
        // SAFETY: the table is alive; the place has that capacity.
        gathered(&mut raw, 16, |out, capacity| unsafe {
            (self.0.contacts)(self.0.context, body as u64, out, capacity)
        })?;
        out.extend(raw.iter().map(Touch::from));
        Some(())
    }

    fn execute(&mut self, command: &Command) -> Result<u64, CommandError> {
        // SAFETY: the table is alive, the command until the call returns.
        of_status(unsafe { (self.0.execute)(self.0.context, &command.raw()) })
    }
}
