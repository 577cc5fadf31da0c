//! A node that behaves like the robot's, without a robot: all dialects, arms that move by themselves or by a
//! [`Script`], pedals, the operating states, and a record of every wrench. For tests, and for those who want to try the
//! simulator; the program `fake_dvrk` runs it.

pub mod cli;
mod kinematics;
mod machine;
mod motion;
mod record;
mod script;
mod wired;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dvrk_arm::{ArmError, Dialect, Frames, Names, Pedal, Wrench};
use nalgebra::Isometry3;
use parking_lot::Mutex;
use ros_node::{LinkOptions, Node, NodeName, OwnMaster, Peer, Report};

pub use machine::Machine;
pub use motion::{Curve, Hand, Motion};
pub use record::Shown;
pub use script::{Script, ScriptError};

use kinematics::Joints;
use motion::HandState;
use record::Record;
use script::Event;
use wired::{Moment, Wired};

/// How a fake node is to be.
#[derive(Clone)]
pub struct FakeOptions {
    /// Names of its arms. Default: MTMR and MTML.
    pub arms: Vec<String>,
    /// How it speaks. Default: [`Dialect::CrtkPose`].
    pub dialect: Dialect,
    /// Namespace of arms and pedals. Default: that of the dialect.
    pub namespace: Option<String>,
    /// Samples a second, 1 to 2000. Default: 100, as the real node.
    pub rate: f64,
    /// How the hands move, where the script does not say. Default: at rest.
    pub motion: Motion,
    /// Hands that give way to forces. Default: none, hands are infinitely strong.
    pub hand: Option<Hand>,
    /// What happens when.
    pub script: Script,
    /// State of the arms at the start. Default: enabled and homed.
    pub machine: Machine,
    /// Samples have no time, which marks them as invalid. Default: `false`.
    pub zero_stamps: bool,
    /// Whether it is there from the start, or comes with [`Fake::start_node`]. Default: `true`.
    pub present: bool,
    /// Whether it starts a ROS master if there is none. Default: `false`.
    pub embedded_master: bool,
    /// Where lines for the user go. Default: nowhere.
    pub report: Report,
}

impl Default for FakeOptions {
    fn default() -> Self {
        Self {
            arms: vec!["MTMR".into(), "MTML".into()],
            dialect: Dialect::CrtkPose,
            namespace: None,
            rate: 100.0,
            motion: Motion::Still(Isometry3::identity()),
            hand: None,
            script: Script::default(),
            machine: Machine::new("ENABLED", true).expect("a state of this name"),
            zero_stamps: false,
            present: true,
            embedded_master: false,
            report: ros_node::silent(),
        }
    }
}

/// A dialect by name.
///
/// # Errors
/// A sentence that lists the names.
pub fn parse_dialect(name: &str) -> Result<Dialect, String> {
    match name {
        "legacy" => Ok(Dialect::Legacy),
        "ambf" => Ok(Dialect::Ambf),
        "crtk-2.0" => Ok(Dialect::CrtkTransform),
        "crtk" | "crtk-2.2" => Ok(Dialect::CrtkPose),
        _ => Err(format!("\"{name}\" is no dialect, expected legacy, ambf, crtk-2.0 or crtk (dVRK 2.2 and later)")),
    }
}

/// A message to an arm.
pub(crate) enum Told {
    Wrench(Wrench),
    Pose(Isometry3<f64>),
    Joints(Vec<f64>),
    OrientationLock(bool),
    Gravity(bool),
    Command(String),
}

/// One arm of the node.
struct FakeArm {
    frames: Frames,
    machine: Machine,
    hand: HandState,
    joints: Joints,
    /// Where it was put, in the device frame; before the script and the curve.
    pose: Option<Isometry3<f64>>,
    gripper: Option<f64>,
    record: Record,
    commands: Vec<String>,
    orientation_lock: Option<bool>,
    gravity: Option<bool>,
    joint_command: Vec<f64>,
}

/// What the threads of the node share.
pub(crate) struct World {
    pub names: Vec<Names>,
    arms: Vec<Mutex<FakeArm>>,
    state: Mutex<State>,
    stop: AtomicBool,
    ended: AtomicBool,
}

/// What concerns the node as a whole.
struct State {
    dialect: Dialect,
    present: bool,
    zero_stamps: bool,
    /// Messages of pedals to be sent, in order.
    pedals: Vec<(Pedal, i32)>,
    /// What each pedal has said last.
    pedal_levels: BTreeMap<u32, (Pedal, i32)>,
    /// Times that all arms were published.
    published: u64,
}

impl World {
    /// An arm got a message.
    pub fn hear(&self, arm: usize, told: Told) {
        let mut arm = self.arms[arm].lock();
        match told {
            Told::Wrench(wrench) => arm.record.push(wrench),
            Told::Pose(pose) => arm.pose = Some(arm.frames.to_device(&pose)),
            Told::Joints(positions) => arm.joint_command = positions,
            Told::OrientationLock(on) => arm.orientation_lock = Some(on),
            Told::Gravity(on) => arm.gravity = Some(on),
            Told::Command(command) => {
                arm.machine.command(&command, Instant::now());
                arm.commands.push(command);
            }
        }
    }

    fn index(&self, arm: &str) -> Option<usize> {
        self.names.iter().position(|names| names.arm() == arm)
    }

    fn of(&self, arm: Option<&str>) -> Vec<usize> {
        match arm {
            Some(arm) => self.index(arm).into_iter().collect(),
            None => (0..self.arms.len()).collect(),
        }
    }
}

/// A fake node. Its methods take the name of one of its arms, and do nothing for names that are none. Dropping it is as
/// if its process was ended.
pub struct Fake {
    world: Arc<World>,
    thread: Option<JoinHandle<()>>,
}

impl Fake {
    /// A node that runs, as soon as there is a master.
    ///
    /// # Errors
    /// [`ArmError::Name`], [`ArmError::Master`], [`ArmError::Thread`].
    pub fn start(options: FakeOptions) -> Result<Self, ArmError> {
        let names = options
            .arms
            .iter()
            .map(|arm| Names::new(options.namespace.as_deref(), arm).ok_or_else(|| ArmError::Name(arm.clone())));
        let names = names.collect::<Result<Vec<_>, _>>()?;
        if names.is_empty() {
            return Err(ArmError::Name(String::new()));
        }
        let master = Peer::new(&ros_node::master_uri(), "/fake_dvrk", Duration::from_secs(1))?;
        let arms = options.arms.iter().map(|name| {
            let frames = Frames::of(name);
            Mutex::new(FakeArm {
                frames,
                machine: options.machine.clone(),
                hand: HandState::default(),
                joints: Joints::new(&frames.to_arm(&Isometry3::identity()), name.starts_with("MTML")),
                pose: None,
                gripper: None,
                record: Record::default(),
                commands: Vec::new(),
                orientation_lock: None,
                gravity: None,
                joint_command: Vec::new(),
            })
        });
        let world = Arc::new(World {
            names,
            arms: arms.collect(),
            state: Mutex::new(State {
                dialect: options.dialect,
                present: options.present,
                zero_stamps: options.zero_stamps,
                pedals: Vec::new(),
                pedal_levels: BTreeMap::new(),
                published: 0,
            }),
            stop: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        });
        let running = Arc::clone(&world);
        let thread = std::thread::Builder::new().name("fake-dvrk".into());
        let thread = thread.spawn(move || run(&running, &options, &master)).map_err(ArmError::Thread)?;
        Ok(Self { world, thread: Some(thread) })
    }

    fn arm<T>(&self, arm: &str, of: impl FnOnce(&mut FakeArm) -> T) -> Option<T> {
        self.world.index(arm).map(|index| of(&mut self.world.arms[index].lock()))
    }

    fn state<T>(&self, of: impl FnOnce(&mut State) -> T) -> T {
        of(&mut self.world.state.lock())
    }

    /// Puts an arm at a pose of the device frame, whatever script and curve say.
    pub fn set_pose(&self, arm: &str, pose: &Isometry3<f64>) {
        self.arm(arm, |arm| arm.pose = Some(*pose));
    }

    /// Lets an arm that was put somewhere move as script and curve say again.
    pub fn release(&self, arm: &str) {
        self.arm(arm, |arm| arm.pose = None);
    }

    /// Where an arm was put or told to go, in the device frame.
    pub fn pose(&self, arm: &str) -> Option<Isometry3<f64>> {
        self.arm(arm, |arm| arm.pose).flatten()
    }

    /// Opens its gripper: 0 closed … 1 open.
    pub fn set_gripper(&self, arm: &str, gripper: f64) {
        self.arm(arm, |arm| arm.gripper = Some(gripper));
    }

    /// Lets a pedal say: 1 pressed, 0 released, 2 clicked.
    pub fn pedal(&self, pedal: Pedal, value: i32) {
        self.state(|state| state.pedals.push((pedal, value)));
    }

    /// Puts the arm into the state `FAULT`.
    pub fn fault(&self, arm: &str) {
        self.arm(arm, |arm| arm.machine.fault());
    }

    /// Its operating state.
    pub fn machine(&self, arm: &str) -> Option<Machine> {
        self.arm(arm, |arm| arm.machine.clone())
    }

    /// Whether samples have no time from now on.
    pub fn set_zero_stamps(&self, on: bool) {
        self.state(|state| state.zero_stamps = on);
    }

    /// Lets the node disappear, with all its topics.
    pub fn stop_node(&self) {
        self.state(|state| state.present = false);
    }

    /// Lets it come, or come back.
    pub fn start_node(&self) {
        self.state(|state| state.present = true);
    }

    /// Lets it be another release of the robot's software; it restarts.
    pub fn set_dialect(&self, dialect: Dialect) {
        self.state(|state| state.dialect = dialect);
    }

    /// Times that all arms were published so far.
    pub fn published(&self) -> u64 {
        self.state(|state| state.published)
    }

    /// The last wrenches that the arm was told to show, in its own frames.
    pub fn wrenches(&self, arm: &str) -> Vec<Shown> {
        self.arm(arm, |arm| arm.record.all()).unwrap_or_default()
    }

    /// The last one.
    pub fn last_wrench(&self, arm: &str) -> Option<Shown> {
        self.arm(arm, |arm| arm.record.last()).flatten()
    }

    /// Those that came since the last call.
    pub fn fresh_wrenches(&self, arm: &str) -> Vec<Shown> {
        self.arm(arm, |arm| arm.record.fresh()).unwrap_or_default()
    }

    /// How many ever came.
    pub fn wrench_count(&self, arm: &str) -> u64 {
        self.arm(arm, |arm| arm.record.count).unwrap_or_default()
    }

    /// Forgets those that came.
    pub fn clear_wrenches(&self, arm: &str) {
        self.arm(arm, |arm| arm.record.clear());
    }

    /// Modes and state commands that it was told.
    pub fn commands(&self, arm: &str) -> Vec<String> {
        self.arm(arm, |arm| arm.commands.clone()).unwrap_or_default()
    }

    /// Joint positions that it was told to go to, rad.
    pub fn joint_command(&self, arm: &str) -> Vec<f64> {
        self.arm(arm, |arm| arm.joint_command.clone()).unwrap_or_default()
    }

    /// Orientation lock and gravity compensation, as it was told; `None`: not told.
    pub fn switches(&self, arm: &str) -> (Option<bool>, Option<bool>) {
        self.arm(arm, |arm| (arm.orientation_lock, arm.gravity)).unwrap_or_default()
    }

    /// Whether its script has come to its end.
    pub fn has_ended(&self) -> bool {
        self.world.ended.load(Ordering::Acquire)
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.world.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Publishes until it is stopped.
fn run(world: &Arc<World>, options: &FakeOptions, master: &Peer) {
    let period = Duration::from_secs_f64(1.0 / options.rate.clamp(1.0, 2000.0));
    let begin = Instant::now();
    let mut node: Option<(Dialect, Node, Wired)> = None;
    let (mut next, mut last) = (begin, -1.0);
    while !world.stop.load(Ordering::Acquire) {
        let now = Instant::now();
        let t = now.saturating_duration_since(begin).as_secs_f64();
        for (arm, event) in options.script.events(last, t) {
            happen(world, arm, event);
        }
        let dt = if last < 0.0 { 0.0 } else { t - last };
        last = t;
        let (dialect, present) = {
            let state = world.state.lock();
            (state.dialect, state.present)
        };
        if node.as_ref().is_some_and(|(speaks, ..)| !present || *speaks != dialect) {
            node = None;
        }
        if node.is_none() && present {
            match connect(world, options, dialect, master) {
                Ok((started, wired)) => node = Some((dialect, started, wired)),
                Err(error) => (options.report)(format_args!("the node could not be started: {error}")),
            }
        }
        if let Some((_, _, wired)) = &mut node {
            publish(world, options, wired, now, t, dt);
        }
        // A late sample is not caught up by a burst.
        next = (next + period).max(Instant::now());
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}

fn happen(world: &World, arm: Option<&str>, event: &Event) {
    let each = |act: &dyn Fn(&mut FakeArm)| world.of(arm).into_iter().for_each(|i| act(&mut world.arms[i].lock()));
    let state = || world.state.lock();
    match event {
        Event::Press(pedal) => state().pedals.push((*pedal, 1)),
        Event::Release(pedal) => state().pedals.push((*pedal, 0)),
        Event::Tap(pedal) => state().pedals.extend([1, 0, 2].map(|value| (*pedal, value))),
        Event::Fault => each(&|arm| arm.machine.fault()),
        Event::Command(command) => each(&|arm| {
            arm.machine.command(command, Instant::now());
        }),
        Event::Stop => state().present = false,
        Event::Start => state().present = true,
        Event::Dialect(dialect) => state().dialect = *dialect,
        Event::ZeroStamps(on) => state().zero_stamps = *on,
        Event::End => world.ended.store(true, Ordering::Release),
    }
}

fn connect(
    world: &Arc<World>,
    options: &FakeOptions,
    dialect: Dialect,
    master: &Peer,
) -> std::io::Result<(Node, Wired)> {
    let node = Node::start(LinkOptions {
        master: master.clone(),
        name: NodeName::Anonymous("fake_dvrk".into()),
        own_master: if options.embedded_master { OwnMaster::InProcess } else { OwnMaster::None },
        parameters: Vec::new(),
        report: Arc::clone(&options.report),
    })?;
    let wired = Wired::new(world, dialect);
    node.link().add(wired.announcements.iter().map(Arc::clone));
    // What is latched is said again by a node that starts.
    let mut state = world.state.lock();
    let levels: Vec<_> = state.pedal_levels.values().copied().collect();
    state.pedals.splice(0..0, levels);
    Ok((node, wired))
}

fn publish(world: &World, options: &FakeOptions, wired: &mut Wired, now: Instant, t: f64, dt: f64) {
    let zero_stamps = {
        let mut state = world.state.lock();
        if wired.is_announced() {
            state.published += 1;
            for (pedal, value) in std::mem::take(&mut state.pedals) {
                wired.pedal(pedal, value);
                state.pedal_levels.insert(pedal as u32, (pedal, value));
            }
        }
        state.zero_stamps
    };
    for (index, names) in world.names.iter().enumerate() {
        let mut arm = world.arms[index].lock();
        let arm = &mut *arm;
        arm.machine.step(now);
        let scripted = || options.script.pose(names.arm(), t);
        let mut pose = arm.pose.or_else(scripted).unwrap_or_else(|| options.motion.pose(t));
        let wrench = arm.record.last().filter(|shown| now.saturating_duration_since(shown.at) < Duration::from_secs(1));
        let wrench = wrench.map_or_else(Wrench::zero, |shown| shown.wrench);
        if let Some(hand) = &options.hand {
            arm.hand.step(hand, &arm.frames.wrench_to_device(&wrench).force, dt.min(0.1));
            pose.translation.vector += arm.hand.deviation;
        }
        let measured = arm.frames.to_arm(&pose);
        arm.joints.follow(&measured);
        let gripper = arm.gripper.or_else(|| options.script.gripper(names.arm(), t)).unwrap_or(0.5);
        let jacobian = arm.joints.jacobian();
        let joints = arm.joints.positions();
        let machine = &arm.machine;
        wired.publish(
            index,
            &Moment { now, pose: measured, gripper, joints, jacobian: &jacobian, wrench, machine, zero_stamps },
        );
    }
}
