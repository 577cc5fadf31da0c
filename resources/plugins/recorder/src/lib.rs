//! Two plugins in one library: the trajectory of a body in a CSV file, and a force field around a body.
//!
//! ```yaml
//! # In a model file: the path of BODY Ball every 10 steps, beside the model file.
//! BODY Ball:
//!   name: Ball
//!   mass: 1
//!   plugins: [{name: recorder, filename: libambf_recorder.so}]
//!   record: {file: ball.csv, every: 10}
//!
//! # In a world file: everything within 0.5 m of Magnet is drawn to it, with up to 2 N.
//! plugins: [{name: field, filename: libambf_recorder.so}]
//! force field: {centre: Magnet, radius: 0.5, force: 2}
//! ```

use std::io::Write;
use std::path::PathBuf;

use ambf_plugin::files;
use ambf_plugin::{Host, InitContext, ObjectId, ObjectPlugin, ObjectType, Plugin, PluginError, View, WorldPlugin};
use nalgebra::Vector3;

ambf_plugin::export_plugin! { object: Recorder, world: ForceField }

/// Writes the pose of its body: one row every so many steps, and one at the start.
#[derive(Default)]
struct Recorder {
    body: usize,
    every: u64,
    /// `None` after the end, or when the disk was full.
    file: Option<files::Output>,
    path: PathBuf,
    rows: u64,
    host: Option<Host>,
}

impl Plugin for Recorder {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        self.body = context.own(ObjectType::Body).ok_or("only rigid bodies can be recorded")?;
        let settings = context.settings().map_err(|error| error.to_string())?;
        let record = settings.root().get("record").ok_or("`record` is missing, expected {file, every}")?;
        let file = record.get("file").and_then(|file| file.text()).ok_or("`record / file` is missing")?;
        self.every = match record.get("every").and_then(|every| every.text()) {
            None => 1,
            Some(text) => match text.parse() {
                Ok(every) if every > 0 => every,
                _ => return Err(format!("`record / every` is `{text}`, expected a whole number, 1 or more").into()),
            },
        };
        self.path = context.directory().join(file);
        self.host = Some(context.host());
        // The file is there when the plugin is closed.
        self.file = Some(files::Output::create(&self.path).map_err(|error| error.to_string())?);
        self.write(|file| writeln!(file, "step,time,x,y,z,qx,qy,qz,qw"));
        self.record(&context.world);
        Ok(())
    }

    fn physics_update(&mut self, world: &mut View<'_>, _dt: f64) {
        if world.clock().step.is_multiple_of(self.every) {
            self.record(world);
        }
    }

    fn reset(&mut self, _world: &mut View<'_>) {
        self.write(|file| writeln!(file, "# reset"));
    }

    fn close(&mut self) {
        let Some(file) = self.file.take() else { return };
        match file.finish() {
            Ok(()) => self.say(format!("{} rows are in {}", self.rows, self.path.display())),
            Err(error) => self.say(error.to_string()),
        }
    }
}

impl Recorder {
    fn record(&mut self, world: &View<'_>) {
        let Some(state) = world.body(self.body) else { return };
        let clock = world.clock();
        let (p, q) = (state.pose.translation, state.pose.rotation);
        let (step, time) = (clock.step, clock.sim_time);
        self.write(|file| writeln!(file, "{step},{time},{},{},{},{},{},{},{}", p.x, p.y, p.z, q.i, q.j, q.k, q.w));
        self.rows += 1;
    }

    /// A full disk ends the recording, not the simulation.
    fn write(&mut self, write: impl FnOnce(&mut files::Output) -> std::io::Result<()>) {
        let Some(file) = &mut self.file else { return };
        if let Err(error) = file.add(write) {
            self.file = None;
            self.say(error.to_string());
        }
    }

    fn say(&self, sentence: String) {
        if let Some(host) = &self.host {
            host.say(sentence);
        }
    }
}

impl ObjectPlugin for Recorder {}

/// Draws bodies towards a centre: with the full force there, with none at the radius, in proportion between. Negative
/// forces push.
#[derive(Default)]
struct ForceField {
    name: String,
    radius: f64,
    force: f64,
    /// The body called `name`, while there is one: it may come later, with another model.
    centre: Option<usize>,
    /// Bodies that can be moved, kept up to date as models come and go.
    bodies: Vec<usize>,
}

impl Plugin for ForceField {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        let settings = context.settings().map_err(|error| error.to_string())?;
        let field =
            settings.root().get("force field").ok_or("`force field` is missing, expected {centre, radius, force}")?;
        let text = |key: &str| field.get(key).and_then(|value| value.text());
        let number = |key: &str| match text(key).map(str::parse::<f64>) {
            Some(Ok(value)) if value.is_finite() => Ok(value),
            _ => Err(format!("`force field / {key}` is {:?}, expected a number", text(key).unwrap_or(""))),
        };
        self.name = text("centre").ok_or("`force field / centre` is missing, expected the name of a body")?.to_owned();
        (self.radius, self.force) = (number("radius")?, number("force")?);
        Ok(())
    }

    fn physics_update(&mut self, world: &mut View<'_>, _dt: f64) {
        let Some(centre) = self.centre else { return };
        let Some(goal) = world.body(centre).map(|state| state.inertial_pose.translation.vector) else { return };
        for &body in self.bodies.iter().filter(|&&body| body != centre) {
            let Some(state) = world.body(body) else { continue };
            let away: Vector3<f64> = goal - state.inertial_pose.translation.vector;
            let distance = away.norm();
            if distance > 1e-9 && distance < self.radius {
                let force = away / distance * self.force * (1.0 - distance / self.radius);
                // It is there and the numbers are finite: nothing can go wrong.
                let _ = world.apply_wrench(body, force, Vector3::zeros());
            }
        }
    }
}

impl WorldPlugin for ForceField {
    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        let (ObjectType::Body, index) = (object.kind, object.index) else { return };
        if self.centre.is_none() && world.name(object).is_some_and(|name| name == self.name) {
            self.centre = Some(index);
        }
        if world.body(index).is_some_and(|state| state.mass > 0.0) {
            self.bodies.push(index);
        }
    }

    fn on_object_removal(&mut self, _world: &mut View<'_>, object: ObjectId) {
        let stays = |&body: &usize| object != ObjectId::new(ObjectType::Body, body);
        self.bodies.retain(stays);
        self.centre = self.centre.filter(stays);
    }
}
