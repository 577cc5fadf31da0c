//! Plugins in shared libraries, as the host sees them.

use std::cell::Cell;
use std::ffi::c_void;
use std::panic::resume_unwind;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::Arc;

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
use nalgebra::Vector3;

use super::abi::{
    copy_out, slice, CreateFn, RawBody, RawClock, RawCommand, RawDrawing, RawHost, RawInit, RawInput, RawJoint,
    RawPlugin, RawPose, RawText, RawTouch, VersionFn, ABI_VERSION, DONE, MODEL, OLDEST_ABI_VERSION, PANICKED,
};
use super::command::status_of;
use super::desk::Desk;
use super::traits::Services;
use super::view::{Access, TextOf};
use super::{
    AnyPlugin, Command, CommandError, Drawing, InitContext, ModelPlugin, ObjectPlugin, Plugin, PluginError, PluginKind,
    SimulatorPlugin, StateSnapshot, Subject, View, WorldPlugin,
};
use crate::{ObjectId, ObjectType};
use ambf_device::caught;

const VERSION: &str = "ambf_plugin_abi_version";
const CREATE: &str = "ambf_plugin_create";

/// Opens a library of a version of our interface that this host knows. It is never closed: code of it may be running in
/// threads of its own.
///
/// # Errors
/// [`PluginError::Open`], [`PluginError::Symbol`], [`PluginError::Version`].
pub(super) fn open(file: &Path) -> Result<&'static Library, PluginError> {
    // SAFETY: the user asked for this library; what its constructors do is the library's.
    let library = unsafe { Library::open(Some(file), RTLD_NOW | RTLD_LOCAL) }
        .map_err(|error| PluginError::Open { file: file.to_owned(), why: because(&error) })?;
    let library: &'static Library = Box::leak(Box::new(library));
    // SAFETY: the type is that of the interface; a library that exports another function under this name breaks the
    // contract.
    let version = unsafe { symbol::<VersionFn>(library, file, VERSION)? };
    // SAFETY: it takes nothing and returns a number.
    let found = unsafe { version() };
    if !(OLDEST_ABI_VERSION..=ABI_VERSION).contains(&found) {
        return Err(PluginError::Version { file: file.to_owned(), found, expected: ABI_VERSION });
    }
    Ok(library)
}

/// What the dynamic loader says, without the words of the crate around it.
pub(super) fn because(error: &libloading::Error) -> String {
    std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string)
}

/// A function of a library.
///
/// # Safety
/// `F` is the type of the function.
pub(super) unsafe fn symbol<F: Copy>(library: &'static Library, file: &Path, name: &str) -> Result<F, PluginError> {
    // SAFETY: the caller vouches for the type.
    let found = unsafe { library.get::<F>(name.as_bytes()) };
    let missing = PluginError::Symbol { file: file.to_owned(), symbol: name.to_owned() };
    found.map(|function| *function).map_err(|_| missing)
}

/// Makes a plugin of a library.
///
/// # Errors
/// Those of [`open`], [`PluginError::Nothing`].
pub(super) fn load(file: &Path, kind: PluginKind, desk: &Arc<Desk>) -> Result<AnyPlugin, PluginError> {
    let library = open(file)?;
    // SAFETY: the type is that of the interface, whose version is ours.
    let create = unsafe { symbol::<CreateFn>(library, file, CREATE)? };
    let host = Box::new(host_of(desk));
    // SAFETY: the table lives as long as the plugin; what is returned is null or a table of the interface.
    let raw = unsafe { create(kind as u32, &*host) };
    let said = desk.take_failure();
    let raw = NonNull::new(raw).ok_or_else(|| PluginError::Nothing { file: file.to_owned(), kind, said })?;
    let foreign = Foreign { raw, _host: host, desk: Arc::clone(desk) };
    Ok(match kind {
        PluginKind::Simulator => AnyPlugin::Simulator(Box::new(foreign)),
        PluginKind::World => AnyPlugin::World(Box::new(foreign)),
        PluginKind::Model => AnyPlugin::Model(Box::new(foreign)),
        PluginKind::Object => AnyPlugin::Object(Box::new(foreign)),
    })
}

/// A plugin behind the C interface.
struct Foreign {
    raw: NonNull<RawPlugin>,
    /// The library has its address.
    _host: Box<RawHost>,
    desk: Arc<Desk>,
}

// SAFETY: the interface demands of a plugin that it can be called from any thread, from one at a time.
unsafe impl Send for Foreign {}

impl Foreign {
    fn table(&self) -> RawPlugin {
        // SAFETY: the table lives until `destroy`, which only `drop` calls.
        unsafe { *self.raw.as_ptr() }
    }

    /// Calls a function of the table with the plugin's instance, if there is such a function. What goes wrong in the
    /// library is passed on as the panic that it was.
    fn call<F>(&self, function: impl FnOnce(&RawPlugin) -> Option<F>, call: impl FnOnce(F, *mut c_void) -> i32) {
        let table = self.table();
        let status = function(&table).map_or(DONE, |function| call(function, table.instance));
        if status != DONE {
            let said = self.desk.take_failure();
            let said = if said.is_empty() { format!("it returned {status}") } else { said };
            resume_unwind(Box::new(said));
        }
    }
}

impl Plugin for Foreign {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        let table = self.table();
        let Some(init) = table.init else { return Ok(()) };
        let subject = context.subject();
        let directory = context.directory.to_string_lossy();
        let arguments: Vec<RawText> = context.arguments.iter().map(|word| RawText::of(word)).collect();
        let (object_kind, index) = match subject {
            Subject::Simulator | Subject::World => (MODEL, 0),
            Subject::Model(model) => (MODEL, model),
            Subject::Object(object) => (object.kind as u32, object.index),
        };
        let raw = RawInit {
            handle: RawText::of(&context.handle),
            node: RawText::of(&context.node),
            directory: RawText::of(&directory),
            arguments: arguments.as_ptr(),
            argument_count: arguments.len() as u64,
            kind: subject.kind() as u32,
            object_kind,
            index: index as u64,
        };
        // SAFETY: the plugin is alive; all that `raw` points at lives until the call returns.
        match lend(context.world.access, || unsafe { init(table.instance, &raw) }) {
            DONE => Ok(()),
            PANICKED => Err(PluginError::Panicked(self.desk.take_failure())),
            status => Err(PluginError::Init(match self.desk.take_failure() {
                said if said.is_empty() => format!("its start returned {status}"),
                said => said,
            })),
        }
    }

    fn physics_update(&mut self, world: &mut View<'_>, dt: f64) {
        // SAFETY: the plugin is alive.
        self.call(|table| table.physics_update, |update, it| lend(world.access, || unsafe { update(it, dt) }));
    }

    fn graphics_update(&mut self) {
        // SAFETY: the plugin is alive.
        self.call(|table| table.graphics_update, |update, it| unsafe { update(it) });
    }

    fn reset(&mut self, world: &mut View<'_>) {
        // SAFETY: the plugin is alive.
        self.call(|table| table.reset, |reset, it| lend(world.access, || unsafe { reset(it) }));
    }

    fn close(&mut self) {
        // SAFETY: the plugin is alive.
        self.call(|table| table.close, |close, it| unsafe { close(it) });
    }
}

impl Foreign {
    fn model_changed(&mut self, world: &mut View<'_>, added: bool, model: usize) {
        let (added, model) = (u32::from(added), model as u64);
        // SAFETY: the plugin is alive.
        self.call(
            |table| table.model_changed,
            |changed, it| lend(world.access, || unsafe { changed(it, added, model) }),
        );
    }

    fn object_changed(&mut self, world: &mut View<'_>, added: bool, object: ObjectId) {
        let (added, kind, index) = (u32::from(added), object.kind as u32, object.index as u64);
        self.call(
            |table| table.object_changed,
            // SAFETY: the plugin is alive.
            |changed, it| lend(world.access, || unsafe { changed(it, added, kind, index) }),
        );
    }

    fn input(&mut self, raw: &RawInput) {
        // SAFETY: the plugin is alive; `raw` lives until the call returns.
        self.call(|table| table.input, |input, it| unsafe { input(it, raw) });
    }
}

impl SimulatorPlugin for Foreign {
    fn keyboard_update(&mut self, window: u32, key: i32, scancode: i32, action: i32, mods: i32) {
        self.input(&RawInput { code: 0, window, values: [key, scancode, action, mods], ..RawInput::default() });
    }

    fn mouse_buttons_update(&mut self, window: u32, button: i32, action: i32, mods: i32) {
        self.input(&RawInput { code: 1, window, values: [button, 0, action, mods], ..RawInput::default() });
    }

    fn mouse_position_update(&mut self, window: u32, x: f64, y: f64) {
        self.input(&RawInput { code: 2, window, x, y, ..RawInput::default() });
    }

    fn mouse_scroll_update(&mut self, window: u32, x: f64, y: f64) {
        self.input(&RawInput { code: 3, window, x, y, ..RawInput::default() });
    }
}

impl WorldPlugin for Foreign {
    fn on_model_add(&mut self, world: &mut View<'_>, model: usize) {
        self.model_changed(world, true, model);
    }

    fn on_model_removal(&mut self, world: &mut View<'_>, model: usize) {
        self.model_changed(world, false, model);
    }

    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.object_changed(world, true, object);
    }

    fn on_object_removal(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.object_changed(world, false, object);
    }
}

impl ModelPlugin for Foreign {
    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.object_changed(world, true, object);
    }

    fn on_object_removal(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.object_changed(world, false, object);
    }
}

impl ObjectPlugin for Foreign {}

impl Drop for Foreign {
    fn drop(&mut self) {
        if let Some(destroy) = self.table().destroy {
            // SAFETY: it is called once, last.
            unsafe { destroy(self.raw.as_ptr()) }
        }
    }
}

thread_local! {
    /// The simulation that the callback which runs in this thread may use.
    static LENT: Cell<Option<NonNull<dyn Access>>> = const { Cell::new(None) };
}

/// Calls `call` with `access` within reach of the functions below, in this thread only.
fn lend(access: &mut dyn Access, call: impl FnOnce() -> i32) -> i32 {
    /// Takes it back, also when the call unwinds.
    struct Back(Option<NonNull<dyn Access>>);
    impl Drop for Back {
        fn drop(&mut self) {
            LENT.set(self.0);
        }
    }
    let pointer: *mut (dyn Access + '_) = access;
    // SAFETY: only the lifetime changes, and `Back` takes the pointer away before it ends.
    let pointer = unsafe { std::mem::transmute::<*mut (dyn Access + '_), *mut (dyn Access + 'static)>(pointer) };
    let _back = Back(LENT.replace(NonNull::new(pointer)));
    call()
}

/// Runs `work` with the simulation if this thread is in a callback. Nothing unwinds out of it.
fn now(work: impl FnOnce(&mut dyn Access) -> Result<u64, CommandError>) -> i64 {
    // Taken away meanwhile, so that there are never two.
    let Some(mut lent) = LENT.take() else { return CommandError::Outside.status() };
    // SAFETY: `lend` has put it there, is still running, and nobody else has it.
    let access = unsafe { lent.as_mut() };
    let done = caught(|| work(access));
    LENT.set(Some(lent));
    status_of(done.unwrap_or(Err(CommandError::Refused)))
}

fn type_of(kind: u32) -> Result<Option<ObjectType>, CommandError> {
    match kind {
        MODEL => Ok(None),
        kind => ObjectType::from_number(kind).map(Some).ok_or(CommandError::Unknown),
    }
}

fn object_of(kind: u32, index: u64) -> Result<ObjectId, CommandError> {
    let kind = type_of(kind)?.ok_or(CommandError::NoObject)?;
    Ok(ObjectId { kind, index: index as usize })
}

/// Writes what was found through a pointer of the caller.
///
/// # Safety
/// `out` is null or points at a `T` of the caller.
unsafe fn give<T>(value: Option<T>, out: *mut T) -> Result<u64, CommandError> {
    let value = value.ok_or(CommandError::NoObject)?;
    if out.is_null() {
        return Err(CommandError::Refused);
    }
    // SAFETY: the caller vouches for it.
    unsafe { out.write(value) };
    Ok(0)
}

fn host_of(desk: &Arc<Desk>) -> RawHost {
    RawHost {
        context: Arc::as_ptr(desk).cast(),
        say,
        fail,
        post,
        snapshot,
        clock,
        count,
        find,
        text,
        model_of,
        body,
        joint,
        pose,
        values,
        cast_ray,
        contacts,
        execute,
        show,
    }
}

/// The desk behind the context of a [`RawHost`].
///
/// # Safety
/// `context` comes from [`host_of`], and the plugin is alive.
unsafe fn desk<'a>(context: *const c_void) -> &'a Desk {
    // SAFETY: a plugin's desk lives as long as the plugin.
    unsafe { &*context.cast::<Desk>() }
}

unsafe extern "C" fn say(context: *const c_void, text: RawText) {
    // SAFETY: the library gives the context that it was given, and a text of its own.
    unsafe { desk(context).say(&text.read()) }
}

unsafe extern "C" fn fail(context: *const c_void, text: RawText) {
    // SAFETY: as above.
    unsafe { desk(context).fail(text.read()) }
}

unsafe extern "C" fn post(context: *const c_void, command: *const RawCommand) -> i64 {
    // SAFETY: as above; the command is null or the library's.
    let (desk, Some(command)) = (unsafe { (desk(context), command.as_ref()) }) else {
        return CommandError::Unknown.status();
    };
    status_of(Command::from_raw(command).and_then(|command| desk.post(&command)).map(|()| 0))
}

unsafe extern "C" fn snapshot(
    context: *const c_void,
    clock: *mut RawClock,
    bodies: *mut RawBody,
    body_capacity: u64,
    joints: *mut RawJoint,
    joint_capacity: u64,
    counts: *mut [u64; 2],
) -> i32 {
    let mut states = StateSnapshot::default();
    // SAFETY: the library gives the context that it was given.
    if !unsafe { desk(context).snapshot(&mut states) } {
        return 0;
    }
    let raw_bodies: Vec<RawBody> = states.bodies.iter().map(RawBody::from).collect();
    let raw_joints: Vec<RawJoint> = states.joints.iter().map(RawJoint::from).collect();
    // SAFETY: each pointer is null or leads to as many elements of the library's as it says.
    unsafe {
        copy_out(&[RawClock::from(states.clock)], clock, 1);
        copy_out(&raw_bodies, bodies, body_capacity);
        copy_out(&raw_joints, joints, joint_capacity);
        copy_out(&[[raw_bodies.len() as u64, raw_joints.len() as u64]], counts, 1);
    }
    1
}

unsafe extern "C" fn show(context: *const c_void, drawings: *const RawDrawing, count: u64) -> i64 {
    let read = || {
        if count > super::MAX_DRAWINGS as u64 {
            return Err(CommandError::TooMuch);
        }
        // SAFETY: the library gives as many drawings of its own as it says.
        let raw = unsafe { slice(drawings, count) }.ok_or(CommandError::Refused)?;
        // SAFETY: points and texts are the library's, until it gets its answer.
        raw.iter().map(|raw| unsafe { Drawing::from_raw(raw) }).collect::<Result<Vec<_>, _>>()
    };
    // SAFETY: the library gives the context that it was given.
    status_of(read().and_then(|drawings| unsafe { desk(context) }.show(&drawings)).map(|()| 0))
}

unsafe extern "C" fn clock(_: *const c_void, out: *mut RawClock) -> i32 {
    // SAFETY: `out` is null or the library's.
    now(|access| unsafe { give(Some(access.clock().into()), out) }) as i32
}

unsafe extern "C" fn count(_: *const c_void, kind: u32) -> i64 {
    now(|access| Ok(access.count(type_of(kind)?) as u64))
}

unsafe extern "C" fn find(_: *const c_void, kind: u32, text: RawText) -> i64 {
    // SAFETY: the text is the library's.
    let text = unsafe { text.read() };
    now(|access| access.find(type_of(kind)?, &text).map(|index| index as u64).ok_or(CommandError::NoObject))
}

unsafe extern "C" fn text(_: *const c_void, what: u32, kind: u32, index: u64, out: *mut u8, capacity: u64) -> i64 {
    now(|access| {
        let what = match what {
            0 => TextOf::Name,
            1 => TextOf::Identifier,
            2 => TextOf::File,
            _ => return Err(CommandError::Unknown),
        };
        let text = access.text(what, type_of(kind)?, index as usize).ok_or(CommandError::NoObject)?;
        // SAFETY: `out` is null or has the capacity.
        unsafe { copy_out(text.as_bytes(), out, capacity) };
        Ok(text.len() as u64)
    })
}

unsafe extern "C" fn model_of(_: *const c_void, kind: u32, index: u64) -> i64 {
    now(|access| {
        let model = access.model_of(object_of(kind, index)?);
        model.map(|model| model as u64).ok_or(CommandError::NoObject)
    })
}

unsafe extern "C" fn body(_: *const c_void, index: u64, out: *mut RawBody) -> i32 {
    // SAFETY: `out` is null or the library's.
    now(|access| unsafe { give(access.body(index as usize).map(|state| RawBody::from(&state)), out) }) as i32
}

unsafe extern "C" fn joint(_: *const c_void, index: u64, out: *mut RawJoint) -> i32 {
    // SAFETY: `out` is null or the library's.
    now(|access| unsafe { give(access.joint(index as usize).map(|state| RawJoint::from(&state)), out) }) as i32
}

unsafe extern "C" fn pose(_: *const c_void, kind: u32, index: u64, out: *mut RawPose) -> i32 {
    // SAFETY: `out` is null or the library's.
    now(|access| unsafe { give(access.pose(object_of(kind, index)?).map(|pose| RawPose::from(&pose)), out) }) as i32
}

unsafe extern "C" fn values(_: *const c_void, kind: u32, index: u64, out: *mut f64, capacity: u64) -> i64 {
    now(|access| {
        let mut found = Vec::new();
        access.values(object_of(kind, index)?, &mut found).ok_or(CommandError::NoObject)?;
        // SAFETY: `out` is null or has the capacity.
        unsafe { copy_out(&found, out, capacity) };
        Ok(found.len() as u64)
    })
}

unsafe extern "C" fn cast_ray(_: *const c_void, from: *const [f64; 3], to: *const [f64; 3], out: *mut RawTouch) -> i32 {
    now(|access| {
        // SAFETY: the pointers are null or the library's.
        let (Some(from), Some(to)) = (unsafe { (from.as_ref(), to.as_ref()) }) else {
            return Err(CommandError::Refused);
        };
        let Some(hit) = access.cast_ray(&Vector3::from(*from), &Vector3::from(*to)) else { return Ok(0) };
        // SAFETY: `out` is null or the library's.
        unsafe { give(Some(RawTouch::from(&hit)), out) }.map(|_| 1)
    }) as i32
}

unsafe extern "C" fn contacts(_: *const c_void, body: u64, out: *mut RawTouch, capacity: u64) -> i64 {
    now(|access| {
        let mut touches = Vec::new();
        access.contacts(body as usize, &mut touches).ok_or(CommandError::NoObject)?;
        let raw: Vec<RawTouch> = touches.iter().map(RawTouch::from).collect();
        // SAFETY: `out` is null or has the capacity.
        unsafe { copy_out(&raw, out, capacity) };
        Ok(raw.len() as u64)
    })
}

unsafe extern "C" fn execute(_: *const c_void, command: *const RawCommand) -> i64 {
    now(|access| {
        // SAFETY: the command is null or the library's.
        let command = unsafe { command.as_ref() }.ok_or(CommandError::Unknown)?;
        access.execute(&Command::from_raw(command)?)
    })
}
