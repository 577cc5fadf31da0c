//! What is done to a loaded scene, and its text: lines that begin with `#>` in the model file, so that one file
//! holds all of a run.
//!
//! `#> step 0.001` is the sub-step and `#> span 2` the simulated time, s. A line with `|` is a command as
//! `ambf_batch --commands` takes it, `first|last|kind|body|numbers`, of kind `J`, `WR`, `TW` or `POSE`; further
//! kinds, which that program does not know, are `RESET` (no body; 0 bodies, others world) and `HOLD` (an
//! actuator by index in place of a body; name of the body that it holds from now on, or `-`: it lets go).

use std::fmt::Write;

use ambf_core::comm::{ActuatorCommand, JointCommandType};
use ambf_core::ids::{ActuatorId, BodyId};
use ambf_core::scene;
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

/// What happens before a sub-step; bodies and actuators by index in the loaded scene.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Body, index among its active joints, type, set point.
    Joint(BodyId, usize, JointCommandType, f64),
    /// Body; N; N·m.
    Wrench(BodyId, Vector3<f64>, Vector3<f64>),
    /// Body; m/s; rad/s.
    Twist(BodyId, Vector3<f64>, Vector3<f64>),
    /// Body; position of the body frame, m, and its orientation as a quaternion `[x, y, z, w]`.
    Pose(BodyId, Vector3<f64>, [f64; 4]),
    /// 0 bodies, others world.
    Reset(u8),
    /// Actuator, body.
    Hold(ActuatorId, Option<BodyId>),
}

/// An action before each sub-step from `first` to `last`, both included, counted from 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    pub first: u64,
    pub last: u64,
    pub action: Action,
}

/// Length of a run and what is done in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// Sub-step, s.
    pub step: f64,
    /// Simulated time, s.
    pub span: f64,
    pub events: Vec<Event>,
}

impl Script {
    /// Reads the marked lines of a model file.
    ///
    /// # Errors
    /// The first line that cannot be used.
    #[allow(dead_code, reason = "regression tests read what the search has written")]
    pub fn parse(text: &str, scene: &scene::Scene) -> Result<Self, String> {
        let mut script = Self { step: 0.001, span: 2.0, events: Vec::new() };
        for line in text.lines().filter_map(|line| line.strip_prefix("#>")).map(str::trim) {
            let number =
                |text: &str| text.trim().parse::<f64>().map_err(|_| format!("`{line}`: `{text}` is no number"));
            if let Some(step) = line.strip_prefix("step ") {
                script.step = number(step)?;
            } else if let Some(span) = line.strip_prefix("span ") {
                script.span = number(span)?;
            } else {
                script.events.push(parse_event(line, scene)?);
            }
        }
        Ok(script)
    }

    /// The lines that [`parse`](Self::parse) reads.
    pub fn text(&self, scene: &scene::Scene) -> String {
        let mut text = format!("#> step {:?}\n#> span {:?}\n", self.step, self.span);
        for event in &self.events {
            writeln!(text, "#> {}|{}|{}", event.first, event.last, action_text(&event.action, scene))
                .expect("a text takes everything");
        }
        text
    }

    /// Does what is due before sub-step `n`.
    pub fn apply(&self, simulation: &mut Simulation, n: u64) {
        for event in self.due(n) {
            match event.action {
                Action::Joint(body, joint, kind, value) => {
                    simulation.command_joint(body, joint, kind, value);
                }
                Action::Wrench(body, force, torque) => simulation.apply_wrench(body, force, torque),
                Action::Twist(body, linear, angular) => simulation.set_velocity(body, linear, angular),
                Action::Pose(body, position, orientation) => simulation.follow_pose(body, position, orientation),
                Action::Reset(0) => simulation.reset_bodies(),
                Action::Reset(_) => simulation.reset_world(),
                Action::Hold(actuator, body) => {
                    let name = body.map(|body| simulation.scene().bodies[body].identity.key());
                    let command = ActuatorCommand {
                        actuate: name.is_some(),
                        body_name: name.unwrap_or_default(),
                        ..ActuatorCommand::default()
                    };
                    simulation.command_actuator(actuator, &command);
                }
            }
        }
    }

    /// Events whose range contains `n`.
    pub fn due(&self, n: u64) -> impl Iterator<Item = &Event> {
        self.events.iter().filter(move |event| (event.first..=event.last).contains(&n))
    }

    /// First sub-step after all commands.
    pub fn end(&self) -> u64 {
        self.events.iter().map(|event| event.last + 1).max().unwrap_or(0)
    }
}

fn action_text(action: &Action, scene: &scene::Scene) -> String {
    let name = |body: BodyId| scene.bodies[body].identity.name.to_string();
    let numbers = |list: &[f64]| list.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(" ");
    let two = |a: &Vector3<f64>, b: &Vector3<f64>| numbers(&[a.x, a.y, a.z, b.x, b.y, b.z]);
    match action {
        Action::Joint(body, index, kind, value) => {
            let kind = match kind {
                JointCommandType::Effort => 0,
                JointCommandType::Position => 1,
                _ => 2,
            };
            format!("J|{}|{index} {kind} {value:?}", name(*body))
        }
        Action::Wrench(body, force, torque) => format!("WR|{}|{}", name(*body), two(force, torque)),
        Action::Twist(body, linear, angular) => format!("TW|{}|{}", name(*body), two(linear, angular)),
        Action::Pose(body, p, q) => format!("POSE|{}|{} {}", name(*body), numbers(p.as_slice()), numbers(q)),
        Action::Reset(kind) => format!("RESET||{kind}"),
        Action::Hold(actuator, body) => format!("HOLD|{}|{}", actuator.index(), body.map_or("-".into(), name)),
    }
}

fn parse_event(line: &str, scene: &scene::Scene) -> Result<Event, String> {
    let fields: Vec<_> = line.split('|').map(str::trim).collect();
    let &[first, last, kind, target, numbers] = fields.as_slice() else {
        return Err(format!("`{line}`: expected five fields"));
    };
    let whole = |text: &str| text.parse::<u64>().map_err(|_| format!("`{line}`: `{text}` is no sub-step"));
    let (first, last) = (whole(first)?, whole(last)?);
    let body = |name: &str| {
        let found = scene.bodies.position(|body| body.identity.name.to_string() == name);
        found.ok_or_else(|| format!("`{line}`: there is no body `{name}`"))
    };
    if kind == "HOLD" {
        let held = if numbers == "-" { None } else { Some(body(numbers)?) };
        return Ok(Event { first, last, action: Action::Hold(ActuatorId::new(whole(target)? as usize), held) });
    }
    let numbers = numbers.split_whitespace().map(str::parse::<f64>).collect::<Result<Vec<_>, _>>();
    let numbers = numbers.map_err(|_| format!("`{line}`: expected numbers"))?;
    let vector = |i: usize| Vector3::new(numbers[i], numbers[i + 1], numbers[i + 2]);
    let action = match (kind, numbers.as_slice()) {
        ("J", &[index, kind, value]) => {
            let kind = match kind as i64 {
                0 => JointCommandType::Effort,
                1 => JointCommandType::Position,
                _ => JointCommandType::Velocity,
            };
            Action::Joint(body(target)?, index as usize, kind, value)
        }
        ("WR", [_, _, _, _, _, _]) => Action::Wrench(body(target)?, vector(0), vector(3)),
        ("TW", [_, _, _, _, _, _]) => Action::Twist(body(target)?, vector(0), vector(3)),
        ("POSE", &[_, _, _, x, y, z, w]) => Action::Pose(body(target)?, vector(0), [x, y, z, w]),
        ("RESET", &[kind]) => Action::Reset(kind as u8),
        _ => return Err(format!("`{line}`: not a command")),
    };
    Ok(Event { first, last, action })
}
