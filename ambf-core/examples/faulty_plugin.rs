//! A plugin that panics where its handle says (`panics in physics_update`): for tests of what a library's panic does to
//! the simulation.

use ambf_core::plugin::{
    Host, InitContext, ModelPlugin, ObjectId, ObjectPlugin, Plugin, PluginError, SimulatorPlugin, View, WorldPlugin,
};

ambf_core::export_plugin! { simulator: Faulty, world: Faulty, model: Faulty, object: Faulty }

#[derive(Default)]
struct Faulty {
    wanted: String,
    host: Option<Host>,
}

impl Faulty {
    fn pass(&self, what: &str) {
        if let Some(host) = &self.host {
            host.say(what);
        }
        assert!(self.wanted != what, "as told in {what}");
    }
}

impl Plugin for Faulty {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        self.wanted = context.handle().trim_start_matches("panics in ").to_owned();
        self.host = Some(context.host());
        self.pass("init");
        if self.wanted == "an error" {
            return Err("as told".into());
        }
        Ok(())
    }

    fn physics_update(&mut self, _: &mut View<'_>, _: f64) {
        self.pass("physics_update");
    }

    fn graphics_update(&mut self) {
        self.pass("graphics_update");
    }

    fn reset(&mut self, _: &mut View<'_>) {
        self.pass("reset");
    }

    fn close(&mut self) {
        self.pass("close");
    }
}

impl Drop for Faulty {
    fn drop(&mut self) {
        self.pass("drop");
    }
}

impl SimulatorPlugin for Faulty {
    fn keyboard_update(&mut self, _: u32, _: i32, _: i32, _: i32, _: i32) {
        self.pass("keyboard_update");
    }
}

impl WorldPlugin for Faulty {
    fn on_model_add(&mut self, _: &mut View<'_>, _: usize) {
        self.pass("on_model_add");
    }

    fn on_model_removal(&mut self, _: &mut View<'_>, _: usize) {
        self.pass("on_model_removal");
    }

    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        if let (Some(host), Some(identifier)) = (&self.host, world.identifier(object)) {
            host.say(identifier);
        }
        self.pass("on_object_add");
    }

    fn on_object_removal(&mut self, _: &mut View<'_>, _: ObjectId) {
        self.pass("on_object_removal");
    }
}

impl ModelPlugin for Faulty {}

impl ObjectPlugin for Faulty {}
