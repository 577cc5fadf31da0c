//! The plugin of the simulator: it reads the arms of a scene after each step, tells their joints what to do in the
//! next, and lets a thread of its own publish.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Instant;

use ambf_plugin::{
    AnyPlugin, Host, InitContext, ModelPlugin, ObjectType, Plugin, PluginError, PluginKind, Registry, SimulatorPlugin,
    SnapshotSlot, SnapshotWriter, View, WorldPlugin,
};
use crossbeam_channel::{bounded, Receiver, Sender};

use crate::arm::{Arm, Dialect, Event};
use crate::bind::{self, bind, look_up, Binding, Moving, Reading};
use crate::config::{self, ArmConfig, ClockKind, ConfigError, Configuration, Kind};
use crate::diagnostics::{Board, Shown};
use crate::exchange::{commands, ArmStatus, Inbox, Status};
use crate::kinematics::Coordinates;
use crate::local::End;
use crate::messages::{self, MessageType};
use crate::queries::{answers, services};
use crate::seed::{errors, Random, Scatter};
use crate::serve::{wall_time, Offered, Publisher, Texts, Told};
use crate::socket::Streamer;
use crate::statistics::Meter;
use crate::topics::{topics, Carries, Extras, Input, Output, Topic};
use crate::transport::{Connect, Receive, Transport};

/// Name of the built-in plugin: `filename: builtin:crtk`.
pub const NAME: &str = "crtk";

/// Events that wait for the publishing thread; more are lost, which takes a thread that does not run.
const EVENTS: usize = 4096;

/// Topic by which clients choose the seed: `std_msgs/UInt32`.
pub const SEED_TOPIC: &str = "/crtk/seed";

/// Seeds that wait for a step; only the last counts.
const SEEDS: usize = 16;

/// Adds the plugin to those of a program; `files`: configurations that the command line names. Returns what the command
/// line's list of plugins needs besides. What there is to tell about the arms is asked of `board`. `seed`: draws what
/// differs from run to run; without it nothing does, until a client gives one.
pub fn register(
    registry: &mut Registry,
    files: &[PathBuf],
    connect: &Connect,
    board: &Board,
    seed: Option<u64>,
) -> Vec<PathBuf> {
    let make = |file: Option<PathBuf>| {
        let (connect, board) = (Arc::clone(connect), board.clone());
        move |kind| {
            let (connect, board) = (Arc::clone(&connect), board.clone());
            let plugin = Crtk { connect, board, file: file.clone(), seed, running: None };
            match kind {
                PluginKind::Simulator => Some(AnyPlugin::Simulator(Box::new(plugin))),
                PluginKind::World => Some(AnyPlugin::World(Box::new(plugin))),
                PluginKind::Model => Some(AnyPlugin::Model(Box::new(plugin))),
                PluginKind::Object => None,
            }
        }
    };
    registry.add(NAME, make(None));
    let named = |file: &PathBuf| {
        let name = format!("{NAME}:{}", file.display());
        registry.add(&name, make(Some(file.clone())));
        PathBuf::from(format!("builtin:{name}"))
    };
    files.iter().map(named).collect()
}

/// The plugin.
struct Crtk {
    connect: Connect,
    board: Board,
    /// Configuration that the command line names; `None`: where the plugin is declared.
    file: Option<PathBuf>,
    seed: Option<u64>,
    running: Option<Running>,
}

/// One arm in the physics thread.
struct Live {
    arm: Arm,
    binding: Binding,
    inbox: Inbox,
    clock: ClockKind,
    reading: Option<Reading>,
    /// Bounds of its joints' errors.
    error_bounds: Vec<f64>,
}

struct Running {
    arms: Vec<Live>,
    /// Control points, by place in the configuration; some arms may not be offered.
    tools: Vec<Option<Moving>>,
    /// Place in the configuration of each arm.
    places: Vec<usize>,
    writer: SnapshotWriter<Status>,
    slot: Arc<SnapshotSlot<Status>>,
    events: Sender<(usize, Event)>,
    meter: Meter,
    /// Keeps the arms on the board.
    _shown: Arc<Shown>,
    /// Memory that is used again.
    fresh: Vec<Event>,
    publisher: Option<JoinHandle<()>>,
    /// Arms over UDP.
    _streamers: Vec<Streamer>,
    scatter: Option<Scatter>,
    /// What the run is drawn from.
    seed: Option<u64>,
    seeds: Receiver<u64>,
}

impl Crtk {
    fn configuration(&self, context: &InitContext<'_>) -> Result<Configuration, PluginError> {
        if let Some(file) = &self.file {
            return config::load(file).map_err(|error| error.to_string().into());
        }
        let declared = context.settings().map_err(|error| error.to_string());
        let read = declared.and_then(|settings| {
            match config::from_outline(&settings, context.directory()) {
                // The C++ program names the file on its command line.
                Err(ConfigError::Nothing { .. }) if conf(context.arguments()).is_some() => Ok(None),
                read => read.map(Some).map_err(|error| error.to_string()),
            }
        });
        match (read, conf(context.arguments())) {
            (Ok(Some(read)), _) => Ok(read),
            (Ok(None), Some(file)) => config::load(Path::new(file)).map_err(|error| error.to_string().into()),
            (Ok(None), None) => Err("there is no configuration".into()),
            (Err(_), Some(file)) if context.node().is_empty() => {
                config::load(Path::new(file)).map_err(|error| error.to_string().into())
            }
            (Err(error), _) => Err(error.into()),
        }
    }
}

/// The value of `--conf` on a command line.
fn conf(arguments: &[String]) -> Option<&str> {
    let after = arguments.iter().position(|word| word == "--conf").map(|at| at + 1);
    let attached = arguments.iter().find_map(|word| word.strip_prefix("--conf="));
    attached.or_else(|| after.and_then(|at| arguments.get(at)).map(String::as_str))
}

/// What is needed of an arm to open its topics.
struct Prepared {
    place: usize,
    model: Arc<crate::arm::ArmModel>,
    binding: Binding,
}

impl Plugin for Crtk {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        let Configuration { arms: configs, scatter } = self.configuration(context)?;
        let host = context.host();
        let mut prepared = Vec::new();
        let mut problems = Vec::new();
        for place in 0..configs.len() {
            match bind(&configs, place, &context.world) {
                Ok((model, binding)) => prepared.push(Prepared { place, model: Arc::new(model), binding }),
                Err(error) => problems.push(error.to_string()),
            }
        }
        if prepared.is_empty() {
            return Err(problems.join("; ").into());
        }
        problems.iter().for_each(|problem| host.say(format!("an arm is left out: {problem}")));
        prepared.iter().flat_map(|arm| &arm.binding.notes).for_each(|note| host.say(note));
        let scatter = match scatter {
            None => None,
            Some(config) => {
                let find = |name: &String| look_up(&context.world, ObjectType::Body, name).ok_or_else(|| name.clone());
                let bodies = config.bodies.iter().map(find).collect::<Result<Vec<_>, _>>();
                let bodies = bodies.map_err(|name| format!("`scatter`: the scene has no body `{name}`"))?;
                Scatter::new(&context.world, &bodies, &config.places)
            }
        };
        let transports = (self.connect)().map_err(|error| error.to_string())?;
        if transports.is_empty() && !self.board.is_local {
            host.say("no middleware is running, so no topics are offered");
        }
        let seeding = (scatter, self.seed);
        self.running = Some(Running::start(&configs, prepared, transports, &self.board, (host, seeding))?);
        Ok(())
    }

    fn physics_update(&mut self, world: &mut View<'_>, dt: f64) {
        if let Some(running) = &mut self.running {
            let begin = Instant::now();
            running.update(world, dt);
            running.meter.record(begin, Instant::now());
        }
    }

    fn reset(&mut self, world: &mut View<'_>) {
        let arms = self.running.iter_mut().flat_map(|running| &mut running.arms);
        arms.for_each(|live| {
            live.inbox.take().for_each(drop);
            live.binding.release(world);
            live.arm.reset();
        });
        if let Some(running) = &self.running {
            running.place(world);
        }
    }

    fn close(&mut self) {
        if let Some(Running { events, publisher, _streamers, .. }) = self.running.take() {
            drop((events, _streamers));
            if let Some(publisher) = publisher {
                // A thread that panicked has said so.
                let _ = publisher.join();
            }
        }
    }
}

impl SimulatorPlugin for Crtk {}
impl WorldPlugin for Crtk {}
impl ModelPlugin for Crtk {}

impl Running {
    fn start(
        configs: &[ArmConfig],
        prepared: Vec<Prepared>,
        mut transports: Vec<Box<dyn Transport>>,
        board: &Board,
        (host, (scatter, seed)): (Host, (Option<Scatter>, Option<u64>)),
    ) -> Result<Self, String> {
        let (events, receiver) = bounded(EVENTS);
        let slot = Arc::new(SnapshotSlot::empty());
        let mut arms = Vec::new();
        let mut offered = Vec::new();
        let mut ends = Vec::new();
        let mut places = Vec::new();
        let mut streamers = Vec::new();
        let tools = vec![None; configs.len()];
        for Prepared { place, model, binding } in prepared {
            let config = &configs[place];
            let (outbox, inbox) = commands();
            let tool_type = config.tool.as_ref().and_then(|tool| tool.instrument.clone());
            let has_tool = config.tool.is_some();
            let extras =
                Extras { dvrk: config.extras, tool_type: tool_type.is_some(), gripper: config.kind == Kind::Mtm };
            let own = (Arc::clone(&model), config.space.clone(), config.rate);
            let further = config.also.iter().map(|also| {
                let model = Arc::new(bind::further(&model, config, also));
                (model, also.space.clone(), also.rate)
            });
            for (model, space, rate) in std::iter::once(own).chain(further) {
                let mut topics = fitting(topics(&model, &space, extras), config);
                if !config.errors.is_empty() && space == config.space {
                    topics.push(input(&binding.errors_topic, MessageType::Channel, Input::JointErrors));
                }
                let texts = Texts { info: binding.notes.clone(), tool_type: tool_type.clone() };
                let open = Offered::open((&model, &topics), (rate, config.clock), texts, &outbox, &mut transports);
                offered.push((arms.len(), open.map_err(|error| error.to_string())?));
                ends.push(End { arm: arms.len(), space, model, topics, outbox: Arc::clone(&outbox) });
            }
            if config.extras || model.dialect == Dialect::Dvrk {
                for service in services(&config.space, has_tool) {
                    let answer = answers(service.query, &model, arms.len(), &slot);
                    for transport in &mut transports {
                        transport.serve(&service, Arc::clone(&answer)).map_err(|error| error.to_string())?;
                    }
                }
            }
            if let Some(socket) = &config.socket {
                let host = host.clone();
                let say = move |text: &str| host.say(text);
                let arm = (Arc::clone(&model), arms.len());
                streamers.push(Streamer::start(socket, arm, Arc::clone(&outbox), Arc::clone(&slot), say)?);
            }
            let (clock, error_bounds) = (config.clock, config.errors.clone());
            arms.push(Live { arm: Arm::new(model), binding, inbox, clock, reading: None, error_bounds });
            places.push(place);
        }
        let (seed_sender, seeds) = bounded(SEEDS);
        // As if a client had given it: the first step draws. There is room.
        let _ = seed.map(|seed| seed_sender.try_send(seed));
        let is_drawn = scatter.is_some() || arms.iter().any(|live: &Live| !live.error_bounds.is_empty());
        let takes_seeds = is_drawn.then(|| seed_sender.clone());
        if is_drawn {
            let topic = input(SEED_TOPIC, MessageType::Count, Input::Seed);
            let receive: Receive = Arc::new(move |bytes| {
                if let Some(seed) = messages::read_count(bytes) {
                    // So many in one step that there is no room: the client sends faster than anybody looks.
                    let _ = seed_sender.try_send(u64::from(seed));
                }
            });
            for transport in &mut transports {
                transport.subscribe(&topic, Arc::clone(&receive)).map_err(|error| error.to_string())?;
            }
        }
        let mut clock = Vec::new();
        if configs.iter().any(|config| config.clock == ClockKind::Sim) {
            let topic = Topic {
                name: "/clock".into(),
                message: MessageType::Clock,
                carries: Carries::Out(Output::Info),
                is_latched: false,
                depth: 1,
            };
            for transport in &mut transports {
                clock.push(transport.advertise(&topic).map_err(|error| error.to_string())?);
            }
        }
        let named = |place: &usize| (configs[*place].space.clone(), configs[*place].rate);
        let (arms_shown, status) = (places.iter().map(named).collect(), Arc::clone(&slot));
        let shown = Arc::new(Shown { arms: arms_shown, status, ends, seeds: takes_seeds });
        board.add(&shown);
        let template = Status { arms: arms.iter().map(Live::status).collect(), ..Status::default() };
        let told = Told::new(move |text| host.say(text));
        let publisher =
            Publisher { arms: offered, status: Arc::clone(&slot), events: receiver, clock, transports, told };
        let thread = std::thread::Builder::new().name("crtk-publish".into()).spawn(move || publisher.run());
        Ok(Self {
            arms,
            tools,
            places,
            writer: SnapshotWriter::new(template),
            slot,
            events,
            meter: Meter::default(),
            _shown: shown,
            fresh: Vec::with_capacity(64),
            publisher: Some(thread.map_err(|error| format!("no thread can be made: {error}"))?),
            _streamers: streamers,
            scatter,
            seed: None,
            seeds,
        })
    }

    /// Draws anew what differs from run to run.
    fn draw(&mut self, world: &mut View<'_>, seed: u64) {
        let mut random = Random::new(seed);
        for live in &mut self.arms {
            let drawn = errors(&mut random, &live.error_bounds);
            let mut errors = Coordinates::zeros();
            errors.as_mut_slice()[..drawn.len()].copy_from_slice(&drawn);
            live.arm.set_errors(errors);
        }
        self.seed = Some(seed);
        self.place(world);
    }

    /// Puts bodies where they stand in this run.
    fn place(&self, world: &mut View<'_>) {
        if let (Some(scatter), Some(seed)) = (&self.scatter, self.seed) {
            scatter.apply(world, seed);
        }
    }

    fn update(&mut self, world: &mut View<'_>, dt: f64) {
        if let Some(seed) = self.seeds.try_iter().last() {
            self.draw(world, seed);
        }
        let clock = world.clock();
        let sim_time = (clock.sim_time * 1e9) as u64;
        let wall_time = wall_time();
        for (live, &place) in self.arms.iter_mut().zip(&self.places) {
            live.reading = live.binding.read(world, &live.arm);
            self.tools[place] = live.reading.map(|reading| reading.tool);
        }
        for (index, live) in self.arms.iter_mut().enumerate() {
            let Some(reading) = &mut live.reading else { continue };
            reading.reference = match live.arm.base_frame() {
                Some(base) => reading.base.carried(&base.inverse()),
                None => live.binding.refer(world, reading, &self.tools),
            };
            reading.measured.reference = reading.reference.pose;
            let stamp = if live.clock == ClockKind::Wall { wall_time } else { sim_time };
            live.arm.update(stamp, dt, &reading.measured, live.inbox.take(), &mut self.fresh);
            if live.binding.has_joints() {
                live.binding.command(world, &live.arm);
                live.binding.hold(world, live.arm.set_point(), &reading.tool.pose);
            }
            for event in self.fresh.drain(..) {
                // Never waits: a thread that does not run for so long has lost its clients.
                let _ = self.events.try_send((index, event));
            }
        }
        let (arms, statistics) = (&self.arms, self.meter.statistics());
        self.writer.publish(&self.slot, |status| {
            (status.step, status.sim_time, status.wall_time) = (clock.step, sim_time, wall_time);
            status.statistics = statistics;
            status.arms.clear();
            status.arms.extend(arms.iter().map(Live::status));
        });
    }
}

impl Live {
    fn status(&self) -> ArmStatus {
        ArmStatus {
            reading: self.reading,
            set_point: *self.arm.set_point(),
            state: self.arm.operating_state(),
            absolute_forces: self.arm.has_absolute_forces(),
            reference_name: self.arm.reference_name(),
            has_tool: self.arm.has_tool(),
        }
    }
}

/// Leaves out what an entry cannot have: poses without a tool, joints of an object.
fn fitting(topics: Vec<Topic>, config: &ArmConfig) -> Vec<Topic> {
    let has_tool = config.tool.is_some() || config.body.is_some();
    let fits = |topic: &Topic| {
        let is_pose =
            matches!(topic.message, MessageType::Pose | MessageType::Twist | MessageType::Wrench | MessageType::Matrix);
        match config.kind {
            Kind::Object => matches!(topic.carries, Carries::Out(Output::MeasuredPose { .. } | Output::MeasuredTwist)),
            _ => has_tool || !is_pose,
        }
    };
    let placed = |mut topic: Topic| {
        if config.body.is_some() && topic.carries == Carries::Out(Output::MeasuredPose { is_local: true }) {
            // The challenge tells where the camera is in the world.
            topic.carries = Carries::Out(Output::MeasuredPose { is_local: false });
        }
        topic
    };
    topics.into_iter().filter(fits).map(placed).collect()
}

/// A topic that clients publish, of which the last message counts.
fn input(name: &str, message: MessageType, input: Input) -> Topic {
    Topic { name: name.to_owned(), message, carries: Carries::In(input), is_latched: false, depth: 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_of_the_cpp_program_names_its_configuration() {
        let words = |line: &str| line.split(' ').map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(conf(&words("ambf -l 1 --conf a.yaml -p 5")), Some("a.yaml"));
        assert_eq!(conf(&words("ambf --conf=b.yaml")), Some("b.yaml"));
        assert_eq!(conf(&words("ambf --conf")), None);
        assert_eq!(conf(&words("ambf -l 1")), None);
    }

    #[test]
    fn each_file_of_the_command_line_is_a_plugin() {
        let mut registry = Registry::default();
        let connect: Connect = Arc::new(|| Ok(Vec::new()));
        let paths = register(&mut registry, &["a.yaml".into(), "b.yaml".into()], &connect, &Board::default(), None);
        assert_eq!(paths, ["builtin:crtk:a.yaml", "builtin:crtk:b.yaml"].map(PathBuf::from));
        assert_eq!(registry.names().collect::<Vec<_>>(), ["crtk", "crtk:a.yaml", "crtk:b.yaml"]);
        assert!(registry.make("crtk", PluginKind::Model).is_ok());
        assert!(registry.make("crtk", PluginKind::Object).is_err());
    }
}
