use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Command, CommandError, Drawing, PluginError, StateSnapshot, View};
use crate::{ObjectId, ObjectType};
use ambf_model::adf::{LoadError, Outline};

/// What a plugin is declared on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Subject {
    /// The simulator: `--plugins`, launch file.
    Simulator,
    /// The world: world file.
    World,
    /// A model, by index: top level of a model file.
    Model(usize),
    /// An object of a model.
    Object(ObjectId),
}

impl Subject {
    /// Kind of the plugins that are declared there.
    pub fn kind(&self) -> PluginKind {
        match self {
            Self::Simulator => PluginKind::Simulator,
            Self::World => PluginKind::World,
            Self::Model(_) => PluginKind::Model,
            Self::Object(_) => PluginKind::Object,
        }
    }
}

/// Kinds of plugins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum PluginKind {
    /// [`SimulatorPlugin`].
    Simulator = 0,
    /// [`WorldPlugin`].
    World = 1,
    /// [`ModelPlugin`].
    Model = 2,
    /// [`ObjectPlugin`].
    Object = 3,
}

impl PluginKind {
    /// The kind with a number.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Simulator, Self::World, Self::Model, Self::Object].get(number as usize).copied()
    }

    /// What a message calls it.
    pub fn words(self) -> &'static str {
        match self {
            Self::Simulator => "simulator",
            Self::World => "world",
            Self::Model => "model",
            Self::Object => "object",
        }
    }
}

/// Callbacks of every plugin. Physics calls them from its thread, one at a time, never two of one plugin at once.
///
/// A callback may panic: it is reported, the simulation goes on, and after the third time the plugin is closed. A
/// callback that takes longer than its budget (0.5 ms, for pictures 4 ms) is reported, not stopped: it holds up the
/// simulation.
///
/// A plugin that works in several threads should be two halves joined by channels: one half is the plugin, the other
/// one a thread of its own that talks to physics through [`Host`].
pub trait Plugin: Send {
    /// Starts. A plugin that fails is dropped without being closed. Default: nothing to do.
    ///
    /// # Errors
    /// Why it cannot work, in a sentence for its user.
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        let _ = context;
        Ok(())
    }

    /// After each step that was made, and only then: not while paused. `dt` is the length of that step, s. What is
    /// commanded acts in the next.
    fn physics_update(&mut self, world: &mut View<'_>, dt: f64) {
        let _ = (world, dt);
    }

    /// Once a frame, after all its pictures were drawn, at 120 Hz at most; also while paused. Frames that are drawn
    /// while physics is busy come as one. Never called without a window. What [`Host::show`] shows here is seen in
    /// the next frame.
    fn graphics_update(&mut self) {}

    /// After all objects were reset, whoever asked for that. Time goes on. A reset of bodies only calls nothing.
    fn reset(&mut self, world: &mut View<'_>) {
        let _ = world;
    }

    /// Ends: once, and only after a successful start; at the end of the program, when its model is removed, or after
    /// the third panic.
    fn close(&mut self) {}
}

/// A plugin of the simulator: called last after each step.
pub trait SimulatorPlugin: Plugin {
    /// A key was pressed (`action` 1) or repeated (2) in a window, after the simulator's own handling. Windows count
    /// from 1, as their titles do. Numbers as in GLFW: [`key_name`](super::key_name) gives the name of a key, `mods` is
    /// a sum of 1 Shift, 2 Ctrl, 4 Alt, 8 Super. Keys that a panel takes, such as those of a search, do not come.
    /// Never called without a window.
    fn keyboard_update(&mut self, window: u32, key: i32, scancode: i32, action: i32, mods: i32) {
        let _ = (window, key, scancode, action, mods);
    }

    /// A mouse button (0 left, 1 right, 2 middle) was pressed (`action` 1) or released (0) in a window, at the position
    /// that came last. Never called without a window.
    fn mouse_buttons_update(&mut self, window: u32, button: i32, action: i32, mods: i32) {
        let _ = (window, button, action, mods);
    }

    /// The pointer moved in a window, to x and y in pixels from its upper left corner. Never called without a window.
    fn mouse_position_update(&mut self, window: u32, x: f64, y: f64) {
        let _ = (window, x, y);
    }

    /// The wheel was turned in a window. Never called without a window.
    fn mouse_scroll_update(&mut self, window: u32, x: f64, y: f64) {
        let _ = (window, x, y);
    }
}

/// A plugin of the world: called first after each step.
pub trait WorldPlugin: Plugin {
    /// A model is in the world. Called once for each model: for those that were there before the plugin, too.
    fn on_model_add(&mut self, world: &mut View<'_>, model: usize) {
        let _ = (world, model);
    }

    /// A model is about to leave the world.
    fn on_model_removal(&mut self, world: &mut View<'_>, model: usize) {
        let _ = (world, model);
    }

    /// An object is in the world. Called once for each object, before its model is.
    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        let _ = (world, object);
    }

    /// An object is about to leave the world.
    fn on_object_removal(&mut self, world: &mut View<'_>, object: ObjectId) {
        let _ = (world, object);
    }
}

/// A plugin of a model: called before those of its objects.
pub trait ModelPlugin: Plugin {
    /// An object of the model is in the world. Called once for each.
    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        let _ = (world, object);
    }

    /// An object of the model is about to leave the world.
    fn on_object_removal(&mut self, world: &mut View<'_>, object: ObjectId) {
        let _ = (world, object);
    }
}

/// A plugin of an object of any type.
pub trait ObjectPlugin: Plugin {}

/// A plugin of any kind.
pub enum AnyPlugin {
    /// Plugin of the simulator.
    Simulator(Box<dyn SimulatorPlugin>),
    /// Plugin of the world.
    World(Box<dyn WorldPlugin>),
    /// Plugin of a model.
    Model(Box<dyn ModelPlugin>),
    /// Plugin of an object.
    Object(Box<dyn ObjectPlugin>),
}

/// A use of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Input {
    /// See [`SimulatorPlugin::keyboard_update`].
    Key {
        /// Window.
        window: u32,
        /// Key.
        key: i32,
        /// Scan code.
        scancode: i32,
        /// Action.
        action: i32,
        /// Modifiers.
        mods: i32,
    },
    /// See [`SimulatorPlugin::mouse_buttons_update`].
    Button {
        /// Window.
        window: u32,
        /// Button.
        button: i32,
        /// Action.
        action: i32,
        /// Modifiers.
        mods: i32,
    },
    /// See [`SimulatorPlugin::mouse_position_update`].
    Position {
        /// Window.
        window: u32,
        /// Pixels.
        x: f64,
        /// Pixels.
        y: f64,
    },
    /// See [`SimulatorPlugin::mouse_scroll_update`].
    Scroll {
        /// Window.
        window: u32,
        /// Across.
        x: f64,
        /// Up.
        y: f64,
    },
}

impl AnyPlugin {
    /// Its kind.
    pub fn kind(&self) -> PluginKind {
        match self {
            Self::Simulator(_) => PluginKind::Simulator,
            Self::World(_) => PluginKind::World,
            Self::Model(_) => PluginKind::Model,
            Self::Object(_) => PluginKind::Object,
        }
    }

    pub(crate) fn common(&mut self) -> &mut dyn Plugin {
        match self {
            Self::Simulator(plugin) => plugin.as_mut(),
            Self::World(plugin) => plugin.as_mut(),
            Self::Model(plugin) => plugin.as_mut(),
            Self::Object(plugin) => plugin.as_mut(),
        }
    }

    pub(crate) fn model_changed(&mut self, world: &mut View<'_>, added: bool, model: usize) {
        match (self, added) {
            (Self::World(plugin), true) => plugin.on_model_add(world, model),
            (Self::World(plugin), false) => plugin.on_model_removal(world, model),
            _ => (),
        }
    }

    pub(crate) fn object_changed(&mut self, world: &mut View<'_>, added: bool, object: ObjectId) {
        match (self, added) {
            (Self::World(plugin), true) => plugin.on_object_add(world, object),
            (Self::World(plugin), false) => plugin.on_object_removal(world, object),
            (Self::Model(plugin), true) => plugin.on_object_add(world, object),
            (Self::Model(plugin), false) => plugin.on_object_removal(world, object),
            _ => (),
        }
    }

    pub(crate) fn input(&mut self, input: &Input) {
        let Self::Simulator(plugin) = self else { return };
        match *input {
            Input::Key { window, key, scancode, action, mods } => {
                plugin.keyboard_update(window, key, scancode, action, mods);
            }
            Input::Button { window, button, action, mods } => {
                plugin.mouse_buttons_update(window, button, action, mods);
            }
            Input::Position { window, x, y } => plugin.mouse_position_update(window, x, y),
            Input::Scroll { window, x, y } => plugin.mouse_scroll_update(window, x, y),
        }
    }
}

/// The way to the host that a plugin may keep and use from any thread.
#[derive(Clone)]
pub struct Host(pub(crate) Arc<dyn Services>);

pub(crate) trait Services: Send + Sync {
    fn say(&self, text: &str);
    fn post(&self, command: &Command) -> Result<(), CommandError>;
    fn snapshot(&self, out: &mut StateSnapshot) -> bool;
    fn show(&self, drawings: &[Drawing]) -> Result<(), CommandError>;
}

impl Host {
    /// Writes a line to the program's log, under the plugin's name, without waiting. While more lines come than can be
    /// written, some are dropped.
    pub fn say(&self, text: impl AsRef<str>) {
        self.0.say(text.as_ref());
    }

    /// Leaves a command for the next step: it is executed right before that, in the order in which commands were left.
    /// What comes of it is reported only if it fails.
    ///
    /// # Errors
    /// [`CommandError::NotFinite`], [`CommandError::Full`].
    pub fn post(&self, command: &Command) -> Result<(), CommandError> {
        self.0.post(command)
    }

    /// Copies the newest states of all bodies and joints to `out`; `false` when there are none yet: they are kept from
    /// the first call on, and are there after the next step.
    pub fn snapshot(&self, out: &mut StateSnapshot) -> bool {
        self.0.snapshot(out)
    }

    /// Shows these markers and texts in the windows, from their next picture on, instead of those that the plugin has
    /// shown before; none: it shows nothing any more. They stay until then, or until the plugin is closed. Pictures
    /// that are published don't have them. Without windows nobody sees them. It never waits; each call copies the
    /// drawings.
    ///
    /// # Errors
    /// [`CommandError::NotFinite`]; [`CommandError::TooMuch`] for more than [`MAX_DRAWINGS`](super::MAX_DRAWINGS)
    /// drawings, [`MAX_POINTS`](super::MAX_POINTS) points or [`MAX_TEXT`](super::MAX_TEXT) bytes of texts. What was
    /// shown before stays then.
    pub fn show(&self, drawings: &[Drawing]) -> Result<(), CommandError> {
        self.0.show(drawings)
    }
}

/// What a plugin gets at its start.
pub struct InitContext<'a> {
    /// The simulation.
    pub world: View<'a>,
    pub(crate) host: Host,
    pub(crate) handle: String,
    pub(crate) node: String,
    pub(crate) directory: PathBuf,
    pub(crate) arguments: Vec<String>,
}

impl InitContext<'_> {
    /// Name given to the plugin.
    pub fn handle(&self) -> &str {
        &self.handle
    }

    /// What it was declared on.
    pub fn subject(&self) -> Subject {
        self.world.subject()
    }

    /// Index of the object it was declared on, if that is of this type.
    pub fn own(&self, kind: ObjectType) -> Option<usize> {
        self.world.own(kind)
    }

    /// The YAML where it was declared: of an object its own mapping, of a model, the world or the launch file the whole
    /// file; empty for `--plugins`. Keys that the simulator does not know are in it too.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// [`node`](Self::node) as a tree of keys and texts.
    ///
    /// # Errors
    /// When it is empty, or not YAML.
    pub fn settings(&self) -> Result<Outline, LoadError> {
        Outline::parse(&self.node, Path::new(&self.handle))
    }

    /// Directory of the file in which it was declared: relative paths belong there. For `--plugins` the working
    /// directory.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// The command line of the program, its name first.
    pub fn arguments(&self) -> &[String] {
        &self.arguments
    }

    /// The way to the host, to keep.
    pub fn host(&self) -> Host {
        self.host.clone()
    }
}
