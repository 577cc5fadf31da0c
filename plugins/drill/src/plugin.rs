//! The plugin: makes the tools, and does what keys ask for.

use ambf_model::adf::{ToolBall, ToolBurr, VolumeTool};
use ambf_plugin::{
    AnyPlugin, Command, Host, InitContext, ModelPlugin, ObjectId, ObjectType, Plugin, PluginError, PluginKind,
    Registry, SimulatorPlugin, View, WorldPlugin,
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::keys::{action, moved, Action};
use crate::options::Options;

/// Name of the built-in plugin: `filename: builtin:drill`.
pub const NAME: &str = "drill";

/// Keys that wait for a step, as while it is paused; of more, the newest are lost.
const WAITING: usize = 64;

/// Voxels that the burrs of the C++ plugin remove at a time, by their diameter, mm; also of those up to the next one.
const COUNTS: [(f64, u32); 4] = [(6.0, 10), (4.0, 6), (2.0, 3), (0.0, 1)];

/// What a burr cuts for each of these voxels, m³/s: 30 mm³/s with 6 mm, about what the C++ plugin does at 1 kHz with
/// voxels of 0.19 mm.
const RATE: f64 = 3e-9;

/// Radius of the ball next to the tip, and how much more that of the next one is, m.
const SHAFT: (f64, f64) = (0.65e-3, 0.1e-3);

/// The bodies of the C++ plugin's burrs are called after their diameters: `4mm`.
const UNIT: &str = "mm";

/// Diameter of the burr where the scene has no bodies of burrs, mm.
const DIAMETER: f64 = 6.0;

/// Adds the plugin to those of a program.
pub fn register(registry: &mut Registry) {
    registry.add(NAME, |kind| {
        let drill = Drill::default();
        match kind {
            PluginKind::Simulator => Some(AnyPlugin::Simulator(Box::new(drill))),
            PluginKind::World => Some(AnyPlugin::World(Box::new(drill))),
            PluginKind::Model => Some(AnyPlugin::Model(Box::new(drill))),
            PluginKind::Object => None,
        }
    });
}

/// The plugin.
#[derive(Default)]
struct Drill {
    running: Option<Running>,
    /// What keys have asked for since the last step.
    asked: Vec<Action>,
}

struct Running {
    options: Options,
    tool: VolumeTool,
    /// The body that is led.
    body: usize,
    /// Along whose picture keys move the drill.
    camera: Option<ObjectId>,
    /// (volumes x 1).
    tools: Vec<Place>,
    host: Host,
    /// Whether it was said that keys do not move a body with mass.
    has_said: bool,
}

/// The drill among the tools of a volume.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    /// There.
    At(usize),
    /// It is none.
    Nowhere,
}

impl Plugin for Drill {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        let (options, remarks) = Options::read(context.arguments())?;
        let host = context.host();
        remarks.iter().for_each(|remark| host.say(remark));
        let world = &mut context.world;
        let body = find(world, &options.body)?;
        let identifier = |world: &View<'_>, body| world.identifier(ObjectId::new(ObjectType::Body, body));
        let mut burrs = burrs(world, &options);
        if burrs.is_empty() {
            let sizes = COUNTS.iter().filter(|(size, _)| *size > 0.0).map(|(size, _)| format!("`{size}{UNIT}`"));
            let sizes = sizes.collect::<Vec<_>>().join(", ");
            host.say(format!("no body is a burr ({sizes} …): it has one of {DIAMETER} mm that is not shown"));
            burrs.push(burr(String::new(), DIAMETER, options.counts));
        }
        let ball = |place: usize| ToolBall {
            position: Vector3::x() * (options.spacing * place as f64),
            radius: if place == 0 { burrs[0].radius } else { SHAFT.0 + SHAFT.1 * (place - 1) as f64 },
        };
        let tool = VolumeTool {
            body: identifier(world, body).unwrap_or_else(|| options.body.clone()),
            tip: ball(0),
            cursors: (1..options.balls).map(ball).collect(),
            rate: 0.0,
            on: true,
            stiffness: 700.0,
            damping: 0.0,
            friction: 0.0,
            largest_force: 3.3,
            burrs,
        };
        let named = world.find(ObjectType::Camera, "main_camera");
        let camera = named.or_else(|| (world.count(ObjectType::Camera) > 0).then_some(0));
        let camera = camera.map(|camera| ObjectId::new(ObjectType::Camera, camera));
        let mut running = Running { options, tool, body, camera, tools: Vec::new(), host, has_said: false };
        running.add_tools(world);
        if !running.tools.iter().any(|place| matches!(place, Place::At(_))) {
            return Err("there is no volume that it could cut".into());
        }
        self.running = Some(running);
        Ok(())
    }

    fn physics_update(&mut self, world: &mut View<'_>, _dt: f64) {
        let Some(running) = &mut self.running else { return };
        running.add_tools(world);
        let mut pose = None;
        for action in self.asked.drain(..) {
            running.act(world, action, &mut pose);
        }
        if let Some(pose) = pose {
            let _ = world.execute(&Command::FollowPose { body: running.body, pose });
        }
    }

    fn reset(&mut self, _world: &mut View<'_>) {
        self.asked.clear();
    }
}

impl WorldPlugin for Drill {}
impl ModelPlugin for Drill {}

impl SimulatorPlugin for Drill {
    fn keyboard_update(&mut self, _window: u32, key: i32, _scancode: i32, _action: i32, mods: i32) {
        if let Some(action) = action(key, mods).filter(|_| self.asked.len() < WAITING) {
            self.asked.push(action);
        }
    }
}

impl Running {
    /// Makes the drill a tool of the volumes that came since.
    fn add_tools(&mut self, world: &mut View<'_>) {
        for volume in 0..world.count(ObjectType::Volume) {
            let is_there = world.pose(ObjectId::new(ObjectType::Volume, volume)).is_some();
            match self.tools.get(volume) {
                Some(_) if !is_there => continue,
                Some(Place::Nowhere) => continue,
                // Also of one whose model was removed and came again.
                Some(&Place::At(tool)) if world.tool(volume, tool).is_some() => continue,
                Some(Place::At(_)) => {}
                None => self.tools.push(Place::Nowhere),
            }
            let is_other = |named: &String| world.find(ObjectType::Volume, named) != Some(volume);
            if self.options.volume.as_ref().is_some_and(is_other) {
                continue;
            }
            match world.add_tool(volume, &self.tool) {
                Ok(place) => self.tools[volume] = Place::At(place),
                // Once: a volume that is there no longer is asked for again.
                Err(why) if self.tools[volume] == Place::Nowhere => self.host.say(why),
                Err(_) => {}
            }
        }
    }

    fn tools(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.tools.iter().enumerate().filter_map(|(volume, place)| match place {
            Place::At(tool) => Some((volume, *tool)),
            Place::Nowhere => None,
        })
    }

    /// Does what a key asks for; keys that move the drill move `wanted`, which begins where it is. What cannot be done now, as
    /// of a model that has left, is not.
    fn act(&mut self, world: &mut View<'_>, action: Action, wanted: &mut Option<Isometry3<f64>>) {
        let now = self.tools().find_map(|(volume, tool)| world.tool(volume, tool));
        let mut set = |on: Option<bool>, radius: Option<f64>| {
            for (volume, tool) in self.tools() {
                let _ = world.set_tool(volume, tool, on, radius);
            }
        };
        match action {
            Action::Switch => set(now.map(|now| !now.is_on), None),
            Action::NextBurr => {
                let Some(now) = now else { return };
                let sizes = &self.tool.burrs;
                let here = sizes.iter().position(|burr| (burr.radius - now.radius).abs() < 1e-6);
                let next = &sizes[here.map_or(0, |here| (here + 1) % sizes.len())];
                set(None, Some(next.radius));
            }
            Action::Restore => {
                for (volume, _) in self.tools() {
                    let _ = world.restore_voxels(volume);
                }
            }
            Action::Move(_) | Action::Turn(_) => {
                let Some(state) = world.body(self.body) else { return };
                if state.mass != 0.0 {
                    if !std::mem::replace(&mut self.has_said, true) {
                        self.host.say("keys move a drill without mass only; this one follows its controller");
                    }
                    return;
                }
                let camera = self.camera.and_then(|camera| world.pose(camera));
                let camera = camera.map_or_else(UnitQuaternion::identity, |camera| camera.rotation);
                *wanted = Some(moved(&wanted.unwrap_or(state.pose), action, &camera));
            }
        }
    }
}

/// A body by its name.
fn find(world: &View<'_>, name: &str) -> Result<usize, PluginError> {
    let found = world.find(ObjectType::Body, name);
    Ok(found.ok_or_else(|| format!("the scene has no body `{name}`, or several: `--drill_body` names another"))?)
}

/// The burrs of a scene, the largest first: bodies that are called `…mm`.
fn burrs(world: &View<'_>, options: &Options) -> Vec<ToolBurr> {
    let mut burrs = Vec::new();
    for index in 0..world.count(ObjectType::Body) {
        let body = ObjectId::new(ObjectType::Body, index);
        let (Some(name), Some(identifier)) = (world.name(body), world.identifier(body)) else { continue };
        let diameter = name.strip_suffix(UNIT).and_then(|size| size.trim().parse::<f64>().ok());
        if let Some(diameter) = diameter.filter(|diameter| (0.01..100.0).contains(diameter)) {
            burrs.push(burr(identifier, diameter, options.counts));
        }
    }
    burrs.sort_by(|a, b| b.radius.total_cmp(&a.radius));
    burrs.dedup_by(|a, b| a.radius == b.radius);
    burrs
}

/// A burr of a diameter in mm.
fn burr(body: String, diameter: f64, counts: bool) -> ToolBurr {
    let count = COUNTS.iter().find(|(size, _)| diameter >= *size).map_or(1, |(_, count)| *count);
    let (rate, count) = if counts { (0.0, count) } else { (RATE * f64::from(count), 0) };
    ToolBurr { body, radius: 0.5e-3 * diameter, rate, count }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn burrs_have_the_counts_of_the_cpp_plugin_or_rates_that_go_with_them() {
        let counts = [1.0, 2.0, 4.0, 6.0, 3.0, 8.0].map(|diameter| burr("b".into(), diameter, true).count);
        assert_eq!(counts, [1, 3, 6, 10, 3, 10]);
        let largest = burr("b".into(), 6.0, false);
        assert!((largest.rate - 30e-9).abs() < 1e-15 && largest.count == 0 && largest.radius == 0.003);
    }
}
