//! Command files: `first|last|kind|body|numbers`, one command a line, `#` starts a comment.

use std::cmp::Reverse;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use ambf_core::comm::{CarveCommand, JointCommandType, VehicleCommand};
use ambf_core::ids::{BodyId, Table, VehicleId, VolumeId};
use ambf_core::scene::{Identity, Scene};
use ambf_core::sim::{Nearness, Simulation};
use ambf_core::volume::{Rule, Shape};
use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

/// Objects that a message names when a name is that of several.
const MAX_CANDIDATES: usize = 5;

/// Error when a line of a command file cannot be used.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("{file}:{line}: {message}")]
pub struct CommandError {
    file: String,
    line: usize,
    message: String,
}

/// What a line of a command file does in each step of its range.
#[derive(Debug, Clone, PartialEq)]
enum Action {
    /// To a body.
    Body(BodyId, BodyAction),
    /// To a vehicle: brake, power and steering of all wheels.
    Drive(VehicleId, VehicleCommand),
    /// To a volume.
    Volume(VolumeId, VolumeAction),
}

/// What a command goes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Addressee {
    /// A body.
    Body(BodyId),
    /// A vehicle.
    Vehicle(VehicleId),
    /// A volume.
    Volume(VolumeId),
}

impl Action {
    fn addressee(&self) -> Addressee {
        match self {
            Self::Body(body, _) => Addressee::Body(*body),
            Self::Drive(vehicle, _) => Addressee::Vehicle(*vehicle),
            Self::Volume(volume, _) => Addressee::Volume(*volume),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
enum BodyAction {
    /// Joint command: index, type, offset, amplitude, frequency (Hz).
    Joint { index: usize, kind: JointCommandType, offset: f64, amplitude: f64, frequency: f64 },
    /// Force (N) and torque (N·m) at the centre of mass, world axes.
    Wrench(Vector3<f64>, Vector3<f64>),
    /// Linear (m/s) and angular (rad/s) velocity.
    Twist(Vector3<f64>, Vector3<f64>),
    /// Pose of the body frame: position (m) and quaternion x, y, z, w.
    Pose(Vector3<f64>, [f64; 4]),
}

#[derive(Debug, Clone, PartialEq)]
enum VolumeAction {
    /// A ball of a radius goes in a straight line, at one speed, over all steps of the range, and cuts all that it covers or,
    /// with a rate, m³/s, as much as that allows. m, world axes.
    Cut { from: Vector3<f64>, to: Vector3<f64>, radius: f64, rate: Option<f64> },
    /// Switches a tool, and gives it a tip of a radius, m.
    Tool { tool: usize, on: bool, radius: Option<f64> },
}

#[derive(Debug, Clone, PartialEq)]
struct TimedCommand {
    line: usize,
    steps: RangeInclusive<u64>,
    action: Action,
}

/// What commands can address.
#[derive(Debug, Default)]
pub struct Targets<'n> {
    /// Names of the bodies, as traces have them.
    bodies: &'n [String],
    /// Qualified identifiers and topics of the bodies.
    qualified: Vec<Qualified>,
    /// Number of active joints of each body.
    active_joints: Table<BodyId, usize>,
    /// Name, qualified names and number of wheels of each vehicle.
    vehicles: Vec<(String, Qualified, usize)>,
    /// Name, qualified names and number of tools of each volume, and whether it may be cut.
    volumes: Vec<(String, Qualified, usize, bool)>,
}

/// The full names of an object.
#[derive(Debug, Default)]
struct Qualified {
    /// Namespace and identifier: `/ambf/env/BODY link`.
    identifier: String,
    /// Namespace and name, what its topics begin with: `/ambf/env/link`.
    topic: String,
}

impl Qualified {
    fn of(identity: &Identity) -> Self {
        let topic = format!("{}{}", identity.namespace, identity.communication_name());
        Self { identifier: format!("{}{}", identity.key(), identity.suffix), topic }
    }
}

impl<'n> Targets<'n> {
    /// The bodies of `scene`, called `names`, and its vehicles.
    pub fn new(scene: &Scene, names: &'n [String]) -> Self {
        Self {
            bodies: names,
            qualified: scene.bodies.iter().map(|body| Qualified::of(&body.identity)).collect(),
            active_joints: scene.bodies.ids().map(|body| scene.active_joints(body).len()).collect(),
            vehicles: (scene.vehicles.iter())
                .map(|v| (v.identity.communication_name(), Qualified::of(&v.identity), v.wheels.len()))
                .collect(),
            volumes: (scene.volumes.entries())
                .map(|(id, volume)| {
                    let identity = &volume.attached.identity;
                    let tools = (0..).take_while(|tool| scene.tool(id, *tool).is_some()).count();
                    let is_carvable = volume.description.carvable && volume.voxels().is_some();
                    (identity.communication_name(), Qualified::of(identity), tools, is_carvable)
                })
                .collect(),
        }
    }
}

/// The object that `text` means: by its qualified identifier or topic, else by its name, else as part of exactly one of
/// those.
///
/// # Errors
/// A sentence when there is none, or several.
fn find<'q>(
    what: &str,
    text: &str,
    names: impl Iterator<Item = &'q str>,
    qualified: impl Iterator<Item = &'q Qualified>,
) -> Result<usize, String> {
    let (names, qualified): (Vec<_>, Vec<_>) = (names.collect(), qualified.collect());
    let full = |wanted: &dyn Fn(&str) -> bool| {
        let holds = |all: &Qualified| wanted(&all.identifier) || wanted(&all.topic);
        (0..qualified.len()).filter(|&index| holds(qualified[index])).collect::<Vec<_>>()
    };
    let mut found = full(&|name| name == text);
    if found.is_empty() {
        // Names are unique, except for those of vehicles, of which the first counts.
        found = names.iter().position(|name| *name == text).into_iter().collect();
    }
    if found.is_empty() && !text.is_empty() {
        found = full(&|name| name.contains(text));
    }
    match found.as_slice() {
        [index] => Ok(*index),
        [] => Err(format!("there is no {what} `{text}`")),
        several => {
            let shown = several.iter().take(MAX_CANDIDATES).map(|&index| format!("`{}`", qualified[index].identifier));
            let shown = shown.collect::<Vec<_>>().join(", ");
            let more = several.len().saturating_sub(MAX_CANDIDATES);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            Err(format!("`{text}` is part of several: {shown}{more}; write more of the name of the {what}"))
        }
    }
}

/// The commands of a file, bound to the bodies of a simulation.
#[derive(Debug, Default)]
pub struct Commands {
    file: String,
    /// In the order of the file.
    list: Vec<TimedCommand>,
}

impl Commands {
    /// Reads the text of `file`.
    ///
    /// # Errors
    /// [`CommandError`] for the first line that cannot be used.
    pub fn parse(text: &str, file: &str, targets: &Targets<'_>) -> Result<Self, CommandError> {
        let mut commands = Vec::new();
        for (number, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() {
                continue;
            }
            let command = parse_line(line, number + 1, targets)
                .and_then(|command| command.check(&targets.active_joints))
                .map_err(|message| CommandError { file: file.into(), line: number + 1, message })?;
            commands.push(command);
        }
        Ok(Self { file: file.into(), list: commands })
    }

    /// The place of the last command that has acted before the end of step `step`, and what it went to; of all commands
    /// that to the nearest, as `near` says.
    pub fn latest(&self, step: u64, near: impl Fn(Addressee) -> Nearness) -> Option<(String, Addressee)> {
        let acted = self.list.iter().filter(|command| *command.steps.start() < step);
        let order = |command: &&TimedCommand| {
            let end = *command.steps.end().min(&step);
            (near(command.action.addressee()), Reverse(end), Reverse(command.line))
        };
        let latest = acted.min_by_key(order)?;
        Some((format!("{}:{}", self.file, latest.line), latest.action.addressee()))
    }

    /// Applies the commands whose range contains `step`, of `dt` s; they act in the step after.
    ///
    /// # Errors
    /// [`CommandError`] for the first one that a volume refuses.
    pub fn apply(&self, simulation: &mut Simulation, step: u64, dt: f64) -> Result<(), CommandError> {
        for command in self.list.iter().filter(|command| command.steps.contains(&step)) {
            match &command.action {
                Action::Body(body, action) => action.apply(simulation, *body),
                Action::Drive(vehicle, drive) => simulation.command_vehicle(*vehicle, drive),
                Action::Volume(volume, action) => {
                    let (first, last) = (*command.steps.start(), *command.steps.end());
                    let share = |step: u64| step as f64 / ((last - first) as f64 + 1.0);
                    let (begin, end) = (share(step - first), share(step - first + 1));
                    action.apply(simulation, *volume, begin, end, dt).map_err(|message| CommandError {
                        file: self.file.clone(),
                        line: command.line,
                        message: format!("step {step}: {message}"),
                    })?;
                }
            }
        }
        Ok(())
    }
}

impl VolumeAction {
    /// Acts between two shares of the range.
    fn apply(
        &self,
        simulation: &mut Simulation,
        volume: VolumeId,
        begin: f64,
        end: f64,
        dt: f64,
    ) -> Result<(), String> {
        match *self {
            Self::Cut { from, to, radius, rate } => {
                let at = |share: f64| Isometry3::from(from + (to - from) * share);
                let rule = rate.map_or(Rule::All, |rate| Rule::Rate { rate, interval: dt });
                let (shape, from, to) = (Shape::Sphere { radius }, at(begin), at(end));
                let command = CarveCommand { shape, from, to, in_world: true, rule };
                simulation.carve(volume, &command).map(drop).map_err(|error| error.to_string())
            }
            Self::Tool { tool, on, radius } => {
                simulation.set_tool(volume, tool, Some(on), radius).map_err(|error| error.to_string())
            }
        }
    }
}

impl BodyAction {
    fn apply(&self, simulation: &mut Simulation, body: BodyId) {
        match *self {
            Self::Joint { index, kind, offset, amplitude, frequency } => {
                let value = offset + amplitude * (TAU * frequency * simulation.sim_time()).sin();
                // As on the wire.
                simulation.command_joint(body, index, kind, f64::from(value as f32));
            }
            Self::Wrench(force, torque) => simulation.apply_wrench(body, force, torque),
            Self::Twist(linear, angular) => simulation.set_velocity(body, linear, angular),
            Self::Pose(position, orientation) => simulation.follow_pose(body, position, orientation),
        }
    }
}

impl TimedCommand {
    /// Refuses what would never do anything.
    fn check(self, active_joints: &Table<BodyId, usize>) -> Result<Self, String> {
        if self.steps.is_empty() {
            return Err(format!("the range ends at {} before it begins at {}", self.steps.end(), self.steps.start()));
        }
        let Action::Body(body, BodyAction::Joint { index, .. }) = self.action else { return Ok(self) };
        match active_joints[body] {
            0 => Err("the body has no active joint to command".into()),
            known if index >= known => {
                Err(format!("there is no joint {index}: the body has {known} active joint(s), counted from 0"))
            }
            _ => Ok(self),
        }
    }
}

fn parse_line(line: &str, number: usize, targets: &Targets<'_>) -> Result<TimedCommand, String> {
    let fields: Vec<_> = line.split('|').map(str::trim).collect();
    let &[first, last, kind, body, numbers] = fields.as_slice() else {
        return Err(format!("expected `first|last|kind|body|numbers`, found {} fields", fields.len()));
    };
    let step = |text: &str| text.parse().map_err(|_| format!("expected a step number, found `{text}`"));
    let numbers = numbers.split_whitespace().map(|text| match text.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("expected a finite number, found `{text}`")),
    });
    let numbers = numbers.collect::<Result<Vec<_>, _>>()?;
    let steps = step(first)?..=step(last)?;
    if kind == "VEH" {
        let vehicles = &targets.vehicles;
        let names = vehicles.iter().map(|(name, ..)| name.as_str());
        let target = find("vehicle", body, names, vehicles.iter().map(|(_, qualified, _)| qualified))?;
        let action = Action::Drive(VehicleId::new(target), drive(&numbers, vehicles[target].2)?);
        return Ok(TimedCommand { line: number, steps, action });
    }
    if matches!(kind, "CUT" | "TOOL") {
        let volumes = &targets.volumes;
        let names = volumes.iter().map(|(name, ..)| name.as_str());
        let target = find("volume", body, names, volumes.iter().map(|(_, qualified, ..)| qualified))?;
        let (_, _, tools, is_carvable) = volumes[target];
        let action = match kind {
            "CUT" if !is_carvable => return Err("the volume is empty or not to be cut".into()),
            "CUT" => cut(&numbers)?,
            _ => tool(&numbers, tools)?,
        };
        return Ok(TimedCommand { line: number, steps, action: Action::Volume(VolumeId::new(target), action) });
    }
    let target = find("body", body, targets.bodies.iter().map(String::as_str), targets.qualified.iter())?;
    let vector = |i: usize| Vector3::new(numbers[i], numbers[i + 1], numbers[i + 2]);
    let action = match (kind, numbers.as_slice()) {
        ("J", &[index, kind, offset]) => joint(index, kind, offset, 0.0, 0.0)?,
        ("JS", &[index, kind, offset, amplitude, frequency]) => joint(index, kind, offset, amplitude, frequency)?,
        ("WR", [_, _, _, _, _, _]) => BodyAction::Wrench(vector(0), vector(3)),
        ("TW", [_, _, _, _, _, _]) => BodyAction::Twist(vector(0), vector(3)),
        ("POSE", &[_, _, _, x, y, z, w]) => BodyAction::Pose(vector(0), [x, y, z, w]),
        ("J", _) => return Err("J takes 3 numbers: index, type, value".into()),
        ("JS", _) => return Err("JS takes 5 numbers: index, type, offset, amplitude, frequency".into()),
        ("WR" | "TW", _) => return Err(format!("{kind} takes 6 numbers")),
        ("POSE", _) => return Err("POSE takes 7 numbers: position, then quaternion x y z w".into()),
        _ => return Err(format!("expected J, JS, WR, TW, POSE, VEH, CUT or TOOL, found `{kind}`")),
    };
    Ok(TimedCommand { line: number, steps, action: Action::Body(BodyId::new(target), action) })
}

/// Brake, then the power of each wheel, then its steering angle.
fn drive(numbers: &[f64], wheels: usize) -> Result<VehicleCommand, String> {
    if numbers.len() != 1 + 2 * wheels {
        let expected = 1 + 2 * wheels;
        return Err(format!("VEH takes {expected} numbers here: brake, then power, then steering of {wheels} wheels"));
    }
    let (power, steering) = numbers[1..].split_at(wheels);
    Ok(VehicleCommand {
        power: power.to_vec(),
        steering: steering.to_vec(),
        full_brake: numbers[0] > 0.0,
        ..VehicleCommand::default()
    })
}

/// Way, radius and, maybe, a rate.
fn cut(numbers: &[f64]) -> Result<VolumeAction, String> {
    let &[a, b, c, x, y, z, radius, ref rate @ ..] = numbers else {
        return Err("CUT takes 7 or 8 numbers: from, to, radius, rate (m³/s)".into());
    };
    let rate = match *rate {
        [] => None,
        [rate] => Some(rate),
        _ => return Err("CUT takes 7 or 8 numbers: from, to, radius, rate (m³/s)".into()),
    };
    if radius <= 0.0 || rate.is_some_and(|rate| rate < 0.0) {
        return Err("expected a radius above 0 and a rate of at least 0".into());
    }
    Ok(VolumeAction::Cut { from: Vector3::new(a, b, c), to: Vector3::new(x, y, z), radius, rate })
}

/// Number of the tool, 0 or 1 and, maybe, the radius of its tip.
fn tool(numbers: &[f64], tools: usize) -> Result<VolumeAction, String> {
    let (number, on, radius) = match *numbers {
        [number, on] => (number, on, None),
        [number, on, radius] => (number, on, Some(radius)),
        _ => return Err("TOOL takes 2 or 3 numbers: index, 0 (off) or 1 (on), radius".into()),
    };
    if number < 0.0 || number.fract() != 0.0 || number >= tools as f64 {
        return Err(format!("there is no tool {number}: the volume has {tools}, counted from 0"));
    }
    if (on != 0.0 && on != 1.0) || radius.is_some_and(|radius| radius <= 0.0) {
        return Err("expected 0 (off) or 1 (on), and a radius above 0".into());
    }
    Ok(VolumeAction::Tool { tool: number as usize, on: on == 1.0, radius })
}

fn joint(index: f64, kind: f64, offset: f64, amplitude: f64, frequency: f64) -> Result<BodyAction, String> {
    if index < 0.0 || index.fract() != 0.0 {
        return Err(format!("expected a joint index, found {index}"));
    }
    let kind = match kind {
        0.0 => JointCommandType::Effort,
        1.0 => JointCommandType::Position,
        2.0 => JointCommandType::Velocity,
        _ => return Err(format!("expected joint command type 0 (effort), 1 (position) or 2 (velocity), found {kind}")),
    };
    // Values are rounded to 32 bits, so what does not fit would be none.
    let largest = f64::from(f32::MAX);
    if let Some(number) = [offset.abs() + amplitude.abs(), frequency.abs()].into_iter().find(|number| *number > largest)
    {
        return Err(format!("expected numbers of at most {largest:e}, found {number:e}"));
    }
    Ok(BodyAction::Joint { index: index as usize, kind, offset, amplitude, frequency })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Commands, CommandError> {
        let bodies = ["Base".into(), "Link".into()];
        let full = |name: &str, kind: &str| Qualified {
            identifier: format!("/ambf/env/psm/{kind} {name}"),
            topic: format!("/ambf/env/psm/{name}"),
        };
        let vehicles = vec![("Car".into(), full("Car", "VEHICLE"), 2)];
        let volumes =
            vec![("Bone".into(), full("Bone", "VOLUME"), 1, true), ("Skin".into(), full("Skin", "VOLUME"), 0, false)];
        let qualified = bodies.iter().map(|name: &String| full(name, "BODY")).collect();
        Commands::parse(
            text,
            "c.txt",
            &Targets { bodies: &bodies, qualified, active_joints: vec![7, 0].into(), vehicles, volumes },
        )
    }

    #[test]
    fn every_kind_is_read() {
        let text = "# comment\n1|30|J|Base|0 2 2.5 # after\n0|5|JS|Base|6 1 0.0 0.5 0.5\n\n1|1|WR|Base|1 2 3 4 5 6\n\
                    1|1|TW|Base|1 2 3 4 5 6\n1|1|POSE|Base|0 0 1 0 0 0 1\n1|9|VEH|Car|0 10 20 0.1 0.2\n\
                    1|9|CUT|Bone|0 0 1 0 0 2 0.003\n1|9|CUT|Bone|0 0 1 0 0 2 0.003 3e-8\n4|4|TOOL|Bone|0 1\n4|4|TOOL|Bone|0 0 0.002\n";
        let commands = parse(text).unwrap();
        assert_eq!(commands.list.len(), 10);
        assert_eq!(commands.list[0].steps, 1..=30);
        let kind = JointCommandType::Velocity;
        let expected = BodyAction::Joint { index: 0, kind, offset: 2.5, amplitude: 0.0, frequency: 0.0 };
        assert_eq!(commands.list[0].action, Action::Body(BodyId::new(0), expected));
        let drive = VehicleCommand { power: vec![10.0, 20.0], steering: vec![0.1, 0.2], ..VehicleCommand::default() };
        assert_eq!(commands.list[5].action, Action::Drive(VehicleId::new(0), drive));
        let (from, to) = (Vector3::z(), 2.0 * Vector3::z());
        let of_bone = |action| Action::Volume(VolumeId::new(0), action);
        let cut = |rate| of_bone(VolumeAction::Cut { from, to, radius: 0.003, rate });
        assert_eq!((&commands.list[6].action, &commands.list[7].action), (&cut(None), &cut(Some(3e-8))));
        let tool = |on, radius| of_bone(VolumeAction::Tool { tool: 0, on, radius });
        assert_eq!(
            (&commands.list[8].action, &commands.list[9].action),
            (&tool(true, None), &tool(false, Some(0.002)))
        );
    }

    #[test]
    fn bodies_are_found_by_full_name_by_name_and_by_a_part_of_one() {
        let target = |name: &str| {
            parse(&format!("1|1|TW|{name}|0 0 0 0 0 0")).map(|commands| match commands.list[0].action {
                Action::Body(body, _) => body.index(),
                Action::Drive(..) | Action::Volume(..) => panic!("TW is for bodies"),
            })
        };
        for (name, index) in
            [("Base", 0), ("/ambf/env/psm/Base", 0), ("/ambf/env/psm/BODY Link", 1), ("psm/Li", 1), ("BODY B", 0)]
        {
            assert_eq!(target(name), Ok(index), "{name}");
        }
        let error = target("psm/").unwrap_err().to_string();
        let expected = "c.txt:1: `psm/` is part of several: `/ambf/env/psm/BODY Base`, `/ambf/env/psm/BODY Link`; write more of the \
                        name of the body";
        assert_eq!(error, expected);
        assert!(target("").is_err());
        let vehicle = parse("1|9|VEH|/ambf/env/psm/Car|0 10 20 0.1 0.2").unwrap();
        assert!(matches!(vehicle.list[0].action, Action::Drive(vehicle, _) if vehicle == VehicleId::new(0)));
    }

    #[test]
    fn the_latest_command_to_the_nearest_is_known() {
        let commands = parse("0|3|TW|Base|0 0 0 0 0 0\n2|9|TW|Link|0 0 0 0 0 0\n4|5|WR|Base|0 0 0 0 0 0\n").unwrap();
        let (none, first, third) = (None, Some(("c.txt:1", 0)), Some(("c.txt:3", 0)));
        let second = Some(("c.txt:2", 1));
        // What a command to another body is named for is a body without any.
        let cases = [
            (0, 0, none),
            (0, 4, first),
            (0, 5, third),
            (1, 2, first),
            (1, 90, second),
            (0, 90, third),
            (7, 90, second),
        ];
        for (body, step, expected) in cases {
            let near =
                |to| if to == Addressee::Body(BodyId::new(body)) { Nearness::Connected } else { Nearness::Apart };
            let expected = expected.map(|(place, to)| (place.to_owned(), Addressee::Body(BodyId::new(to))));
            assert_eq!(commands.latest(step, near), expected, "{body} {step}");
        }
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, part) in [
            ("1|2|J|Nobody|0 1 0", "Nobody"),
            ("1|2|J|Base|0 1", "3 numbers"),
            ("1|2|J|Base|0 9 1", "type"),
            ("1|2|J|Base|-1 1 1", "index"),
            ("1|2|J|Base|7 1 1", "no joint 7"),
            ("1|2|J|Link|0 1 1", "no active joint"),
            ("2|1|J|Base|0 1 1", "before"),
            ("1|2|J|Base|0 0 1e308", "at most"),
            ("1|2|JS|Base|0 0 0 1 1e308", "at most"),
            ("1|2|WR|Base|1 2 3 nan 5 6", "finite"),
            ("1|x|J|Base|0 1 0", "step number"),
            ("1|2|FLY|Base|1", "FLY"),
            ("1|2|VEH|Base|1 0 0 0 0", "no vehicle"),
            ("1|2|VEH|Car|1 0", "5 numbers"),
            ("1|2|CUT|Base|0 0 0 0 0 0 1", "no volume"),
            ("1|2|CUT|Skin|0 0 0 0 0 0 1", "not to be cut"),
            ("1|2|CUT|Bone|0 0 0 0 0 0", "7 or 8"),
            ("1|2|CUT|Bone|0 0 0 0 0 0 0", "above 0"),
            ("1|2|CUT|Bone|0 0 0 0 0 0 1 -1", "at least 0"),
            ("1|2|TOOL|Bone|1 1", "no tool 1"),
            ("1|2|TOOL|Bone|0 2", "0 (off)"),
            ("1|2|TOOL|Bone|0", "2 or 3"),
            ("1|2", "fields"),
        ] {
            let error = parse(&format!("\n{text}")).unwrap_err().to_string();
            assert!(error.starts_with("c.txt:2:") && error.contains(part), "{error}");
        }
    }
}
